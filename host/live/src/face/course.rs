//! Which pictures of a face are due, as frames come.
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_core::wire::Hello;

use crate::event::Timed;

/// A picture that can be drawn.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Due {
    /// Its number, counted from the stream's first sample.
    pub(super) number: u64,
    /// The sample in the middle of its time.
    pub(super) sample: f64,
    /// Seconds after the background's beginning.
    pub(super) background_s: f64,
    /// The mouth in the middle of its time.
    pub(super) parameters: Vec<f32>,
    pub(super) arrived_ms: f64,
    pub(super) heard_ms: Option<f64>,
}

/// The last two frames, and how far the background has been shown.
#[derive(Clone, Debug)]
pub(super) struct Course {
    fps: u32,
    /// Where the mouth's parameters lie in a frame.
    from: usize,
    size: usize,
    /// Samples over which two neighbours are blended; in a longer gap the mouth waits before it moves, as in the page.
    blend: f64,
    last: Option<Still>,
    /// Middle of the last picture, and what of the background it showed, seconds. The background goes on where a stream begins anew.
    shown: Option<f64>,
    background_s: f64,
}

/// A frame.
#[derive(Clone, Debug)]
struct Still {
    sample: f64,
    parameters: Vec<f32>,
}

/// Longest gap that the background shows in one step, seconds: it has stood still in between, and goes on from there.
const LONGEST_STEP_S: f64 = 1.0;

impl Course {
    pub(super) fn new(fps: u32) -> Self {
        Self {
            fps,
            from: 0,
            size: 0,
            blend: 0.0,
            last: None,
            shown: None,
            background_s: -0.5 / f64::from(fps),
        }
    }

    /// A run begins: samples are counted anew.
    pub(super) fn begin(&mut self, hello: &Hello) {
        let before = hello.groups.iter().take_while(|group| group.name != "mouth");
        self.from = before.map(|group| usize::from(group.size)).sum();
        let mouth = hello.groups.iter().find(|group| group.name == "mouth");
        self.size = mouth.map_or(0, |group| usize::from(group.size));
        self.blend = f64::from(SAMPLE_RATE_HZ) * (2.5 / f64::from(hello.rate_hz.max(1))).max(0.1);
        self.last = None;
        self.shown = None;
    }

    /// The pictures whose middle is not after this frame, and was after the one before.
    pub(super) fn frame(&mut self, frame: &Timed) -> Vec<Due> {
        let sample = frame.sample as f64;
        let parameters = frame.parameters().skip(self.from).take(self.size).collect();
        let now = Still { sample, parameters };
        let Some(before) = self.last.replace(now.clone()) else {
            return Vec::new();
        };
        let step = f64::from(SAMPLE_RATE_HZ) / f64::from(self.fps);
        let middle = |number: f64| (number + 0.5) * step;
        let first = (before.sample / step - 0.5).floor() + 1.0;
        let end = (sample / step - 0.5).floor() + 1.0;
        // After a long silence of the line what has passed is not drawn.
        let first = first.max(end - f64::from(self.fps));
        let mut due = Vec::new();
        let mut number = first.max(0.0);
        while number < end {
            let middle = middle(number);
            let from = before.sample.max(sample - self.blend);
            let part = ((middle - from) / (sample - from).max(1.0)).clamp(0.0, 1.0) as f32;
            let seconds = middle / f64::from(SAMPLE_RATE_HZ);
            let passed = self
                .shown
                .map_or(1.0 / f64::from(self.fps), |last| seconds - last);
            self.background_s += passed.clamp(0.0, LONGEST_STEP_S);
            self.shown = Some(seconds);
            due.push(Due {
                number: number as u64,
                sample: middle,
                background_s: self.background_s,
                parameters: std::iter::zip(&before.parameters, &now.parameters)
                    .map(|(a, b)| a + part * (b - a))
                    .collect(),
                arrived_ms: frame.arrived_ms,
                heard_ms: frame
                    .heard_ms
                    .map(|ms| ms - (sample - middle) * 1000.0 / f64::from(SAMPLE_RATE_HZ)),
            });
            number += 1.0;
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use lipstream_core::wire::{Frame, Group, PROTOCOL};

    use super::*;
    use crate::event::Announcement;

    /// Two groups, of which the second is the mouth.
    fn hello(rate_hz: u16) -> Hello {
        let group = |name: &str, size| Group {
            name: name.try_into().unwrap(),
            size,
        };
        Hello {
            protocol: PROTOCOL,
            model: 1,
            rate_hz,
            lag_samples: 0,
            visemes: 0,
            groups: [group("brows", 1), group("mouth", 2)].into_iter().collect(),
            scales: [1.0, 1.0, 0.5].into_iter().collect(),
        }
    }

    /// A frame whose parameters are its sample in hops.
    fn frame(hop: u32) -> Timed {
        let value = hop as i16;
        let announcement = Announcement {
            source: String::new(),
            hello: hello(100),
            profile: None,
            sound: false,
            running: true,
            opening: None,
        };
        Timed {
            frame: Frame {
                sequence: hop,
                sample: 160 * hop,
                parameters: [99, value, value].into_iter().collect(),
                viseme_weights: Default::default(),
            },
            hello: Arc::new(announcement),
            sample: 160 * u64::from(hop),
            arrived_ms: f64::from(hop) * 10.0,
            heard_ms: Some(f64::from(hop) * 10.0 - 50.0),
        }
    }

    #[test]
    fn pictures_are_due_when_their_middle_has_come_and_lie_between_their_neighbours() {
        let mut course = Course::new(25);
        course.begin(&hello(100));
        let due: Vec<Due> = (1..=101).flat_map(|hop| course.frame(&frame(hop))).collect();
        // Middles at hops 2, 6, 10, …
        let numbers: Vec<u64> = due.iter().map(|due| due.number).collect();
        assert_eq!(numbers, (0..25).collect::<Vec<u64>>());
        for (n, due) in (0u8..).zip(&due) {
            let hop = f32::from(4 * n + 2);
            assert_eq!(due.parameters, [hop, 0.5 * hop]);
            assert_eq!(due.sample, 160.0 * f64::from(hop));
            assert!((due.background_s - (f64::from(n) + 0.5) / 25.0).abs() < 1e-9);
            assert_eq!(
                (due.arrived_ms, due.heard_ms),
                (f64::from(hop) * 10.0, Some(f64::from(hop) * 10.0 - 50.0))
            );
        }
        let mut between = Course::new(30);
        between.begin(&hello(100));
        let due: Vec<Due> = (0..20).flat_map(|hop| between.frame(&frame(hop))).collect();
        // The middle of picture 1 is 50 ms after the beginning, that of picture 2 83 1/3: a third of the way from hop 8 to 9.
        assert!((due[2].parameters[0] - 8.333).abs() < 1e-3, "{:?}", due[2]);
        assert!((due[2].heard_ms.unwrap() - 33.333).abs() < 1e-2);
    }

    #[test]
    fn a_run_that_begins_anew_goes_on_with_the_background() {
        let mut course = Course::new(25);
        course.begin(&hello(100));
        let before: Vec<Due> = (0..50).flat_map(|hop| course.frame(&frame(hop))).collect();
        course.begin(&hello(100));
        let after: Vec<Due> = (1000..1050).flat_map(|hop| course.frame(&frame(hop))).collect();
        let step = after[0].background_s - before.last().unwrap().background_s;
        assert!((step - 0.04).abs() < 1e-9, "{step}");
        assert_eq!(after[0].number, 250);
    }

    /// After a gap the mouth waits before it moves, and no more than a second of pictures is due.
    #[test]
    fn a_gap_is_no_slow_motion() {
        let mut course = Course::new(25);
        course.begin(&hello(100));
        course.frame(&frame(0));
        let due = course.frame(&frame(30));
        let hops: Vec<f32> = due.iter().map(|due| due.parameters[0]).collect();
        assert_eq!(hops, [0.0, 0.0, 0.0, 0.0, 0.0, 6.0, 18.0, 30.0]);
        assert_eq!(course.frame(&frame(10_000)).len(), 25);
        // A device that falls back without a word gives nothing.
        assert_eq!(course.frame(&frame(100)), []);
    }
}
