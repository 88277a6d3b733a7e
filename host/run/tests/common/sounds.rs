//! Sounds of our own: a synthetic voice with syllables and pauses, and what breaks front ends.
use std::f64::consts::TAU;

const RATE: f64 = 16_000.0;

/// Uniform noise in [−1, 1) that is the same everywhere (a 64-bit linear congruential generator).
pub(crate) fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// A voice: a gliding pulse train and breath noise through three gliding resonances, syllables of about 0.2 s, a pause
/// every second. `peak` is the loudest sample; the noise floor is 60 dB below.
pub(crate) fn voice(seconds: f64, peak: f64) -> Vec<i16> {
    let count = (seconds * RATE) as usize;
    let mut breath = noise(1);
    let mut phase = 0.0;
    // Two samples of memory for each resonance.
    let mut memory = [[0.0f64; 2]; 3];
    let mut out = Vec::with_capacity(count);
    for n in 0..count {
        let time = n as f64 / RATE;
        let pitch = 120.0 + 25.0 * (TAU * 0.7 * time).sin();
        phase += pitch / RATE;
        let pulse = if phase >= 1.0 {
            phase -= 1.0;
            1.0
        } else {
            0.0
        };
        let syllable = (TAU * 2.6 * time).sin().max(0.0).powf(0.7);
        let pause = if (time % 1.1) < 0.3 { 0.0 } else { 1.0 };
        let unvoiced = 0.5 + 0.5 * (TAU * 1.3 * time).sin();
        let mut x = syllable * pause * (pulse * (1.0 - 0.7 * unvoiced) + 0.1 * unvoiced * breath());
        let centres = [
            500.0 + 250.0 * (TAU * 1.9 * time).sin(),
            1500.0 + 600.0 * (TAU * 1.1 * time + 1.0).sin(),
            2700.0 + 300.0 * (TAU * 0.8 * time).cos(),
        ];
        for (m, centre) in memory.iter_mut().zip(centres) {
            let radius = (-TAU * 0.5 * 90.0 / RATE).exp();
            let y = x + 2.0 * radius * (TAU * centre / RATE).cos() * m[0] - radius * radius * m[1];
            *m = [y, m[0]];
            x = y * 0.1 + x * 0.9;
        }
        out.push(x);
    }
    let loudest = out.iter().fold(1e-9f64, |a, x| a.max(x.abs()));
    let mut floor = noise(2);
    out.iter()
        .map(|x| {
            (peak * (x / loudest + 0.001 * floor()))
                .round()
                .clamp(-32768.0, 32767.0) as i16
        })
        .collect()
}

pub(crate) fn hum(seconds: f64, amplitude: f64) -> Vec<i16> {
    (0..(seconds * RATE) as usize)
        .map(|n| {
            let angle = TAU * 50.0 * n as f64 / RATE;
            (amplitude * (angle.sin() + 0.3 * (3.0 * angle).sin())).round() as i16
        })
        .collect()
}

/// White noise of a given amplitude.
pub(crate) fn hiss(seconds: f64, amplitude: f64) -> Vec<i16> {
    let mut noise = noise(3);
    (0..(seconds * RATE) as usize)
        .map(|_| (amplitude * noise()).round() as i16)
        .collect()
}

/// Name, samples, and the error of c1..c12 that is allowed.
pub(crate) fn difficult() -> Vec<(&'static str, Vec<i16>, f64)> {
    let count = 8000;
    let make = |f: &dyn Fn(usize) -> i16| (0..count).map(f).collect::<Vec<i16>>();
    let impulse = |height: i16| make(&|n| if n == 1234 { height } else { 0 });
    vec![
        ("silence", make(&|_| 0), 0.0),
        (
            "full-scale square, 100 Hz",
            make(&|n| if n / 80 % 2 == 0 { i16::MAX } else { i16::MIN }),
            0.05,
        ),
        (
            "full-scale square, 2 kHz",
            make(&|n| if n / 4 % 2 == 0 { i16::MAX } else { i16::MIN }),
            0.02,
        ),
        (
            "alternation, full scale",
            make(&|n| if n % 2 == 0 { i16::MAX } else { i16::MIN }),
            0.02,
        ),
        (
            "alternation of 1 LSB",
            make(&|n| if n % 2 == 0 { 1 } else { -1 }),
            0.1,
        ),
        ("impulse, full scale", impulse(i16::MIN), 0.05),
        ("impulse of 1 LSB", impulse(1), 0.05),
        ("DC, full scale", make(&|_| i16::MIN), 0.02),
        ("DC of 1 LSB", make(&|_| 1), 0.05),
        ("hiss, full scale", hiss(0.5, 32767.0), 0.05),
        ("hiss of 1 LSB", hiss(0.5, 1.4), 0.05),
        (
            "clipped voice",
            voice(1.0, 32767.0).iter().map(|x| x.saturating_mul(20)).collect(),
            0.05,
        ),
    ]
}

/// Six windows: voiced, unvoiced, quiet, nearly nothing, full-scale noise, full-scale alternation.
pub(crate) fn windows() -> [[i16; 400]; 6] {
    let voice = voice(1.0, 12000.0);
    let cut =
        |samples: &[i16], from: usize| -> [i16; 400] { *samples[from..].first_chunk().expect("long enough") };
    let quiet: Vec<i16> = voice.iter().map(|&x| x / 100).collect();
    let faint: Vec<i16> = voice.iter().map(|&x| x / 3000).collect();
    [
        cut(&voice, 7200),
        cut(&voice, 14200),
        cut(&quiet, 7300),
        cut(&faint, 7300),
        cut(&hiss(0.1, 32767.0), 0),
        std::array::from_fn(|n| if n % 2 == 0 { i16::MAX } else { i16::MIN }),
    ]
}
