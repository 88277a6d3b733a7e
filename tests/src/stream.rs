//! The whole stream, samples to parameter frames: the same bytes on the host and in QEMU.
//!
//! The models, one a kind, are small and random, the sound is made of integers; `cargo xtask
//! bless` writes all vectors anew.
use lipstream_core::kinds::Kind;
use lipstream_core::wire::Profile;
use lipstream_core::{Hierarchical, Likelihood, Model, ParameterFrame, Recurrent, Stream, StreamSettings};

use crate::random::Random;

/// Tables of `lipstream::synthetic` with `Sizes::small`, visual densities too.
pub static TABLES: &[u8] = include_bytes!("../vectors/model/small.tables");
/// Every frame of [`Sound`], each written by [`write`].
pub static FRAMES: &[u8] = include_bytes!("../vectors/stream/small.frames");
/// The same with the mouth re-estimated inside the lag window, see [`with_feedback`].
pub static FEEDBACK_FRAMES: &[u8] = include_bytes!("../vectors/stream/feedback.frames");

/// Tables of a small recurrent model of random numbers.
pub static RECURRENT_TABLES: &[u8] = include_bytes!("../vectors/model/small-recurrent.tables");
/// Every frame of [`Sound`] from it.
pub static RECURRENT_FRAMES: &[u8] = include_bytes!("../vectors/stream/small-recurrent.frames");

/// Tables of a small hierarchical model of random numbers.
pub static HIERARCHICAL_TABLES: &[u8] = include_bytes!("../vectors/model/small-hierarchical.tables");
/// Every frame of [`Sound`] from it.
pub static HIERARCHICAL_FRAMES: &[u8] = include_bytes!("../vectors/stream/small-hierarchical.frames");
/// The same in the live profile, which does not smooth.
pub static HIERARCHICAL_LIVE_FRAMES: &[u8] =
    include_bytes!("../vectors/stream/small-hierarchical-live.frames");

/// EM inside the lag window, exponent 1/4.
pub fn with_feedback() -> StreamSettings {
    StreamSettings {
        feedback: Some(1 << 14),
        ..StreamSettings::default()
    }
}

/// Samples of the sound: 1.2 s.
pub const SOUND_LENGTH: usize = 19_200;

/// Noise through a resonance that moves every 1,280 samples, with pauses and clipping.
pub struct Sound {
    random: Random,
    at: usize,
    before: [i32; 2],
}

impl Sound {
    pub const fn new() -> Self {
        Self {
            random: Random::new(77),
            at: 0,
            before: [0; 2],
        }
    }
}

impl Default for Sound {
    fn default() -> Self {
        Self::new()
    }
}

impl Iterator for Sound {
    type Item = i16;

    fn next(&mut self) -> Option<i16> {
        if self.at == SOUND_LENGTH {
            return None;
        }
        let part = self.at / 1_280;
        self.at += 1;
        let loud = [0, 300, 2_000, 60, 9_000][part % 5];
        let noise = self.random.below(2 * loud + 1) as i32 - loud as i32;
        // y = x + 2r·cos φ·y₁ − r²·y₂, r² = 0.9; 2r·cos φ in 1/64.
        let turn = [110, 60, -20, 95, 20, -80, 118][part % 7];
        let y = noise + (turn * self.before[0]) / 64 - (9 * self.before[1]) / 10;
        let y = y.clamp(-60_000, 60_000);
        self.before = [y, self.before[0]];
        Some(y.clamp(-32_768, 32_767) as i16)
    }
}

/// One frame as bytes, little-endian: frame, sample, values, viseme weights.
pub fn write(frame: &ParameterFrame, mut byte: impl FnMut(u8)) {
    let words = [frame.frame, frame.sample].into_iter().flat_map(u32::to_le_bytes);
    let values = frame.values.iter().flat_map(|v| v.to_le_bytes());
    words
        .chain(values)
        .chain(frame.viseme_weights.iter().copied())
        .for_each(&mut byte);
}

/// Runs `sound` through `stream`, `cut` samples at a time, at most 1,024.
pub fn run<'m, K: Kind<'m>>(
    stream: &mut Stream<'m, K>,
    mut sound: impl Iterator<Item = i16>,
    cut: usize,
    mut on_frame: impl FnMut(&ParameterFrame),
) {
    let mut piece = [0; 1024];
    loop {
        let mut filled = 0;
        for (to, from) in piece[..cut].iter_mut().zip(&mut sound) {
            *to = from;
            filled += 1;
        }
        if filled == 0 {
            break;
        }
        let mut rest = &piece[..filled];
        while !rest.is_empty() {
            let (consumed, frame) = stream.push(rest);
            rest = &rest[consumed..];
            frame.iter().for_each(&mut on_frame);
        }
        if filled < cut {
            break;
        }
    }
    while let Some(frame) = stream.finish() {
        on_frame(&frame);
    }
}

/// Checks that [`Sound`] gives the frames of the vector.
fn check<'m>(stream: &mut Stream<'m, Likelihood<'m>>, cut: usize) {
    check_against(FRAMES, stream, cut);
}

fn check_against<'m, K: Kind<'m>>(frames: &[u8], stream: &mut Stream<'m, K>, cut: usize) {
    let mut expected = frames.iter();
    run(stream, Sound::new(), cut, |frame| {
        write(frame, |byte| {
            let want = expected.next();
            assert_eq!(want, Some(&byte), "frame {}, cut {cut}", frame.frame);
        });
    });
    assert_eq!(expected.next(), None, "frames are missing, cut {cut}");
}

fn likelihood() -> Model<'static, Likelihood<'static>> {
    Model::new_checked(TABLES).expect("the vector is a likelihood-trained model")
}

fn recurrent() -> Model<'static, Recurrent<'static>> {
    Model::new_checked(RECURRENT_TABLES).expect("the vector is a recurrent model")
}

fn hierarchical() -> Model<'static, Hierarchical<'static>> {
    Model::new_checked(HIERARCHICAL_TABLES).expect("the vector is a hierarchical model")
}

pub fn same_bytes_everywhere() {
    let model = likelihood();
    check(&mut Stream::new(&model, StreamSettings::default()), 160);
}

pub fn feedback_gives_the_same_bytes_everywhere() {
    let model = likelihood();
    let mut stream = Stream::new(&model, with_feedback());
    check_against(FEEDBACK_FRAMES, &mut stream, 160);
    // Once more on the same stream, cut otherwise.
    check_against(FEEDBACK_FRAMES, &mut stream, 399);
}

pub fn a_recurrent_model_gives_the_same_bytes_everywhere() {
    let model = recurrent();
    let mut stream = Stream::new(&model, StreamSettings::default());
    // Once more on the same stream after its end, cut otherwise.
    for cut in [160, 1, 399, 1024] {
        check_against(RECURRENT_FRAMES, &mut stream, cut);
    }
    stream.push(&[9_999; 700]);
    stream.reset();
    check_against(RECURRENT_FRAMES, &mut stream, 160);
}

pub fn a_hierarchical_model_gives_the_same_bytes_everywhere() {
    let model = hierarchical();
    let mut stream = Stream::new(&model, StreamSettings::default());
    for cut in [160, 1, 399, 1024] {
        check_against(HIERARCHICAL_FRAMES, &mut stream, cut);
    }
    stream.push(&[9_999; 700]);
    stream.set(StreamSettings::of(Profile::Live));
    check_against(HIERARCHICAL_LIVE_FRAMES, &mut stream, 160);
    // Its frames are the groups of a face.
    let sizes = model.head().groups().map(|group| (group.name, group.place.len()));
    assert!(sizes.eq([("face", 2), ("mouth", 2)]));
}

pub fn cuts_do_not_matter() {
    let model = likelihood();
    for cut in [1, 7, 399, 400, 1024] {
        check(&mut Stream::new(&model, StreamSettings::default()), cut);
    }
}

pub fn a_reset_stream_is_a_new_one() {
    let model = likelihood();
    let mut stream = Stream::new(&model, StreamSettings::default());
    run(&mut stream, Sound::new().skip(5_000).take(7_000), 333, |_| {});
    // Samples after `finish` start a new stream by themselves.
    check(&mut stream, 160);
    stream.push(&[9_999; 400]);
    stream.reset();
    check(&mut stream, 160);
}

pub fn a_sound_shorter_than_a_window_gives_nothing() {
    let model = likelihood();
    let mut stream = Stream::new(&model, StreamSettings::default());
    for length in [0, 1, 399] {
        run(&mut stream, Sound::new().take(length), 160, |frame| {
            panic!("{frame:?}")
        });
        stream.reset();
    }
    let mut frames = 0;
    run(&mut stream, Sound::new().take(400), 160, |_| frames += 1);
    assert_eq!(frames, 1);
}

/// Silence, full scale and impulses: every frame comes, weights add up.
pub fn extremes() {
    survives_extremes(&likelihood());
    survives_extremes(&recurrent());
    survives_extremes(&hierarchical());
}

fn survives_extremes<'m, K: Kind<'m>>(model: &'m Model<'m, K>) {
    let sounds: [fn(usize) -> i16; 5] = [
        |_| 0,
        |_| i16::MAX,
        |n| if n.is_multiple_of(2) { i16::MAX } else { i16::MIN },
        |n| {
            if (n / 40).is_multiple_of(2) {
                i16::MAX
            } else {
                i16::MIN
            }
        },
        |n| if n % 1_000 == 999 { i16::MIN } else { 0 },
    ];
    let mut stream = Stream::new(model, StreamSettings::default());
    for (i, sound) in sounds.into_iter().enumerate() {
        let mut frames = 0;
        run(&mut stream, (0..400 + 60 * 160).map(sound), 160, |frame| {
            assert_eq!(frame.frame, frames);
            frames += 1;
            if model.own().n_visemes() == 0 {
                assert!(frame.viseme_weights.is_empty());
                return;
            }
            let sum: u32 = frame.viseme_weights.iter().map(|w| u32::from(*w)).sum();
            assert!(sum.abs_diff(255) <= 13, "sound {i}: weights add up to {sum}");
        });
        assert_eq!(frames, 61, "sound {i}");
    }
}

/// The vectors say something: values and visemes change.
pub fn the_vectors_move() {
    moves(&likelihood());
    moves(&recurrent());
    let model = hierarchical();
    let (mut last, mut least, mut most) = ([0; 4], [i16::MAX; 4], [i16::MIN; 4]);
    run(
        &mut Stream::new(&model, StreamSettings::default()),
        Sound::new(),
        160,
        |frame| {
            last.copy_from_slice(&frame.values);
            for k in 0..4 {
                (least[k], most[k]) = (least[k].min(last[k]), most[k].max(last[k]));
            }
        },
    );
    // A deviation is 1,024.
    assert!(
        least.iter().zip(&most).all(|(least, most)| most - least > 500),
        "{least:?} {most:?}"
    );
}

fn moves<'m, K: Kind<'m>>(model: &'m Model<'m, K>) {
    let mut stream = Stream::new(model, StreamSettings::default());
    let mut last = 0;
    let mut changes = 0;
    run(&mut stream, Sound::new(), 160, |frame| {
        let weights = frame.viseme_weights.iter().enumerate();
        let best = weights.max_by_key(|w| *w.1).map_or(0, |w| w.0);
        changes += u32::from(best != last);
        last = best;
    });
    assert!(changes > 2, "{changes} changes of viseme");
}
