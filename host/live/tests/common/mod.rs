//! What the tests of this crate share.
#![allow(dead_code, reason = "every test uses a part")]
use std::sync::Arc;
use std::time::{Duration, Instant};

use lipstream_core::wire::{Frame, Group, Hello, MAX_ENCODED, PROTOCOL, ToHost, encode};
use lipstream_live::event::{Announcement, Event, Timed};
use lipstream_live::hub::Watch;

/// A device with two parameters.
pub(crate) fn hello() -> Hello {
    Hello {
        protocol: PROTOCOL,
        model: 0x1234_abcd,
        rate_hz: 100,
        lag_samples: 1000,
        visemes: 13,
        groups: [Group {
            name: "mouth".try_into().unwrap(),
            size: 2,
        }]
        .into_iter()
        .collect(),
        scales: [0.5, 2.0].into_iter().collect(),
    }
}

pub(crate) fn announcement() -> Arc<Announcement> {
    Arc::new(Announcement {
        source: "a test".to_owned(),
        hello: hello(),
        profile: None,
        sound: false,
        running: true,
        opening: None,
    })
}

/// The frame of a hop, all weight on one viseme.
pub(crate) fn frame(hop: u32, viseme: usize) -> Frame {
    Frame {
        sequence: hop,
        sample: 160 * hop + 200,
        parameters: [hop as i16, -3].into_iter().collect(),
        viseme_weights: (0..13).map(|v| if v == viseme { 255 } else { 0 }).collect(),
    }
}

pub(crate) fn timed(hop: u32, viseme: usize) -> Event {
    timed_of(announcement(), frame(hop, viseme))
}

/// A frame as watchers get it.
pub(crate) fn timed_of(hello: Arc<Announcement>, frame: Frame) -> Event {
    Event::Frame(Arc::new(Timed {
        sample: u64::from(frame.sample),
        frame,
        hello,
        arrived_ms: 12.5,
        heard_ms: None,
    }))
}

/// A message as it is on the line.
pub(crate) fn bytes(message: &ToHost) -> Vec<u8> {
    encode(message, &mut [0; MAX_ENCODED]).unwrap().to_vec()
}

/// Events until one is as wanted, which is among them; panics where it does not come.
pub(crate) fn until(watch: &mut Watch, mut wanted: impl FnMut(&Event) -> bool) -> Vec<Event> {
    let began = Instant::now();
    let mut seen = Vec::new();
    while began.elapsed() < Duration::from_secs(20) {
        match watch.now().expect("a watcher that keeps up") {
            Some(event) => {
                let found = wanted(&event);
                seen.push(event);
                if found {
                    return seen;
                }
            }
            None => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    panic!(
        "it does not come; last {:?}",
        seen.iter().rev().take(5).collect::<Vec<_>>()
    );
}

/// The text of a notice.
pub(crate) fn notice(event: &Event) -> Option<&str> {
    match event {
        Event::Notice(notice) => Some(&notice.text),
        _ => None,
    }
}
