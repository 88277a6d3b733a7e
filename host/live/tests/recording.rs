//! Recordings: what was recorded is played, and what is none is refused.
mod common;

use std::path::Path;
use std::sync::Arc;

use common::{bytes, hello};
use lipstream_core::wire::{Frame, Status, ToHost};
use lipstream_live::event::{Announcement, Event, Sound};
use lipstream_live::recording::{Recorder, Recording, RecordingError};

/// A device whose sound the host has.
fn announcement() -> Arc<Announcement> {
    Arc::new(Announcement {
        sound: true,
        ..Announcement::clone(&common::announcement())
    })
}

/// The frame of a hop, which names its own number.
fn spoken(hop: u32) -> Frame {
    let mut frame = common::frame(hop, 0);
    frame.parameters = [hop as i16 * 10, 4].into_iter().collect();
    frame
}

fn sound(hop: u64) -> Event {
    Event::Sound(Arc::new(Sound {
        sample: 160 * hop,
        samples: vec![hop as i16; 160],
        heard_ms: 0.0,
    }))
}

#[test]
fn what_was_recorded_is_played_and_its_sound_begins_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.stream");
    let mut recorder = Recorder::create(&path).unwrap();
    recorder.take(&Event::Hello(announcement())).unwrap();
    // Recording begins in the middle: frames come six hops behind the sound, and one is lost.
    for hop in 10..30 {
        recorder.take(&sound(hop)).unwrap();
        if hop != 20 + 6 {
            recorder
                .take(&common::timed_of(announcement(), spoken(hop as u32 - 6)))
                .unwrap();
        }
    }
    assert!(Recorder::create(&path).is_err(), "overwritten");
    recorder.finish().unwrap();
    let mut played = Vec::new();
    let done = Recording::open(&path)
        .unwrap()
        .play(|parameters, visemes| {
            assert_eq!(visemes.len(), 13);
            played.push(parameters.to_vec());
            Ok::<_, RecordingError>(())
        })
        .unwrap();
    // Hops 10 to 23, the lost one between its neighbours.
    let want: Vec<Vec<f32>> = (10..24).map(|hop| vec![hop as f32 * 5.0, 8.0]).collect();
    assert_eq!(played, want);
    assert_eq!((done.frames, done.between, done.began_anew), (14, 1, false));
    let heard = lipstream_media::sound::read(&path.with_extension("wav")).unwrap();
    assert_eq!((heard.samples.len(), heard.samples[0]), (20 * 160, 10));
}

#[test]
fn a_run_that_begins_anew_ends_the_first() {
    let messages = [ToHost::Hello(hello()), ToHost::Status(Status::default())];
    let mut line: Vec<u8> = messages.iter().flat_map(bytes).collect();
    for hop in [5, 6, 7, 0, 1] {
        line.extend(bytes(&ToHost::Frame(spoken(hop))));
    }
    let mut recording = Recording::of_bytes(Path::new("x"), Box::new(std::io::Cursor::new(line))).unwrap();
    let done = recording.play(|_, _| Ok::<_, RecordingError>(())).unwrap();
    assert_eq!((done.frames, done.began_anew), (3, true));
}

#[test]
fn what_is_no_stream_is_refused_in_words() {
    let other = |bytes: Vec<u8>| {
        let error = Recording::of_bytes(Path::new("x.stream"), Box::new(std::io::Cursor::new(bytes)));
        error.err().unwrap().to_string()
    };
    for bytes in [vec![], vec![0; 100], vec![7; 1_000_000], b"words\n".to_vec()] {
        assert_eq!(
            other(bytes),
            "x.stream is no recorded stream: no device introduces itself in it"
        );
    }
}
