//! The generated constants of `lipstream_core::tables`: computed here, checked in there.
//!
//! `cargo xtask tables` writes them. `libm` makes them the same on every machine. Each file's
//! header states the largest rounding error of its entries, found while they were made.
use std::f64::consts::{PI, TAU};
use std::fmt::Write;

use fixed::types::{I1F31, I3F13, U0F16, U16F16};
use lipstream_core::frontend::mel::N_MEL;
use lipstream_core::{FRAME_SAMPLES, N_CEPSTRA, SAMPLE_RATE_HZ};

use lipstream::reference::dct::LIFTER;
use lipstream::reference::fft::FFT_POINTS;
use lipstream::reference::floor;
use lipstream::reference::mel::Filterbank;
use lipstream::reference::window::hamming;

/// A generated file: its name in `core/src/tables/` and its text.
pub(crate) struct TableFile {
    pub name: &'static str,
    pub text: String,
}

/// All generated files.
pub(crate) fn generate() -> Vec<TableFile> {
    vec![window(), fft(), root(), mel(), floor(), log(), dct()]
}

/// Rounds to a fixed-point type, saturating, and keeps the largest error.
struct Rounder {
    worst: f64,
}

impl Rounder {
    fn new() -> Self {
        Self { worst: 0.0 }
    }

    fn round<F: fixed::traits::Fixed>(&mut self, x: f64) -> F::Bits {
        let rounded = F::saturating_from_num(x);
        self.worst = self.worst.max((rounded.to_num::<f64>() - x).abs());
        rounded.to_bits()
    }
}

fn header(what: &str, worst: f64) -> String {
    format!(
        "//! {what}\n//!\n//! Made by `cargo xtask tables`; do not edit.\n\
         //! Largest error of an entry: {worst:.1e}.\n"
    )
}

/// Appends one constant array, eight entries a line or so.
fn constant<T: std::fmt::Display>(text: &mut String, doc: &str, declaration: &str, entries: &[T]) {
    let _ = write!(
        text,
        "\n/// {doc}\n#[rustfmt::skip]\npub static {declaration} = ["
    );
    let mut column = usize::MAX;
    for entry in entries {
        let entry = format!("{entry},");
        if column.saturating_add(entry.len() + 1) > 100 {
            text.push_str("\n   ");
            column = 3;
        }
        let _ = write!(text, " {entry}");
        column += entry.len() + 1;
    }
    text.push_str("\n];\n");
}

/// `[a, b, c]`.
fn row<T: std::fmt::Display>(entries: &[T]) -> String {
    let entries: Vec<String> = entries.iter().map(T::to_string).collect();
    format!("[{}]", entries.join(", "))
}

fn window() -> TableFile {
    let mut rounder = Rounder::new();
    let step = TAU / (FRAME_SAMPLES - 1) as f64;
    let weights: Vec<i32> = (0..FRAME_SAMPLES)
        .map(|i| rounder.round::<I1F31>(0.54 - 0.46 * libm::cos(step * i as f64)))
        .collect();
    let mut text = header("Hamming window over N − 1, N = 400.", rounder.worst);
    constant(&mut text, "Weights, Q31.", "WINDOW: [i32; 400]", &weights);
    TableFile {
        name: "window.rs",
        text,
    }
}

fn fft() -> TableFile {
    let mut rounder = Rounder::new();
    let mut turn = |k: usize, points: usize| -> [i32; 2] {
        let angle = TAU * k as f64 / points as f64;
        [
            rounder.round::<I1F31>(libm::cos(angle)),
            rounder.round::<I1F31>(libm::sin(angle)),
        ]
    };
    let stages: Vec<(usize, Vec<String>)> = [256, 64, 16]
        .map(|points| {
            let rows = (0..points / 4)
                .map(|i| row(&[turn(i, points), turn(2 * i, points), turn(3 * i, points)].concat()))
                .collect();
            (points, rows)
        })
        .into();
    let split: Vec<String> = (1..128).map(|k| row(&turn(k, FFT_POINTS))).collect();
    let reversed = |k: usize| (k & 3) << 6 | (k >> 2 & 3) << 4 | (k >> 4 & 3) << 2 | k >> 6;
    let order: Vec<String> = (1..128).map(|k| row(&[reversed(k), reversed(256 - k)])).collect();
    let mut text = header("Rotations of the transform, cos and sin in Q31.", rounder.worst);
    for (points, rows) in &stages {
        constant(
            &mut text,
            &format!("cos, sin of 2πki/{points} for k = 1, 2, 3; one row for each i."),
            &format!("TWIDDLE_{points}: [[i32; 6]; {}]", points / 4),
            rows,
        );
    }
    constant(
        &mut text,
        "cos, sin of 2πk/512 for k = 1..=127.",
        "SPLIT: [[i32; 2]; 127]",
        &split,
    );
    constant(
        &mut text,
        "Where bins k and 256 − k stand after the transform (base-4 digits reversed), k = 1..=127.",
        "ORDER: [[u8; 2]; 127]",
        &order,
    );
    TableFile { name: "fft.rs", text }
}

fn root() -> TableFile {
    // Only steps 128.. are met, and 0 for zero itself.
    let mut worst = 0f64;
    let entries: Vec<u16> = (0..1024)
        .map(|i| match i {
            0..128 => 0,
            _ => {
                let root = |x: f64| libm::sqrt(x * libm::exp2(21.0));
                let middle = root(f64::from(i) + 0.5).round();
                for end in [i, i + 1] {
                    worst = worst.max((middle / root(f64::from(end)) - 1.0).abs());
                }
                middle as u16
            }
        })
        .collect();
    let mut text = header("Square roots; errors are relative, at the ends of a step.", worst);
    constant(
        &mut text,
        "√((i + ½)·2²¹) for i = 128..1024, 0 below.",
        "ROOT: [u16; 1024]",
        &entries,
    );
    TableFile {
        name: "root.rs",
        text,
    }
}

fn mel() -> TableFile {
    let mel = |hz: f64| 1127.0 * libm::log(1.0 + hz / 700.0);
    let rate = f64::from(SAMPLE_RATE_HZ);
    let spacing = mel(rate / 2.0) / (N_MEL + 1) as f64;
    let mut rounder = Rounder::new();
    let mut edges = vec![1usize];
    let mut shares = Vec::new();
    for bin in 1..FFT_POINTS / 2 {
        let position = mel(bin as f64 * rate / FFT_POINTS as f64) / spacing;
        let channel = libm::floor(position) as usize;
        while edges.len() <= channel {
            edges.push(bin);
        }
        shares.push(rounder.round::<U0F16>((channel + 1) as f64 - position));
    }
    edges.push(FFT_POINTS / 2);
    assert_eq!(edges.len(), N_MEL + 2, "a channel without a bin");
    let widths: Vec<usize> = edges.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut text = header(
        "The mel filterbank of 26 channels over 0 Hz to 8 kHz.",
        rounder.worst,
    );
    constant(
        &mut text,
        "Bins between the centre of channel i − 1 and that of channel i; the band's edges count as centres.",
        "WIDTHS: [u8; 27]",
        &widths,
    );
    constant(
        &mut text,
        "Share of each bin that belongs to the channel below it, Q16; bins 1..=255.",
        "SHARES: [u16; 255]",
        &shares,
    );
    TableFile { name: "mel.rs", text }
}

fn floor() -> TableFile {
    let mut rounder = Rounder::new();
    let hiss = floor::channels(&Filterbank::default(), &hamming());
    let entries = hiss.map(|sum| rounder.round::<U16F16>(sum));
    let mut text = header("The hiss under every sound.", rounder.worst);
    constant(
        &mut text,
        "Mean sum of each mel channel in white noise of `LEVEL` LSB rms, Q16.",
        "FLOOR: [u32; 26]",
        &entries,
    );
    TableFile {
        name: "floor.rs",
        text,
    }
}

fn log() -> TableFile {
    let mut rounder = Rounder::new();
    let entries: Vec<u32> = (0..=64)
        .map(|i| rounder.round::<U16F16>(libm::log2(1.0 + f64::from(i) / 64.0)))
        .collect();
    let mut text = header("Base-2 logarithms of one octave.", rounder.worst);
    constant(
        &mut text,
        "log₂(1 + i/64), Q16, for i = 0..=64.",
        "LOG2: [u32; 65]",
        &entries,
    );
    TableFile { name: "log.rs", text }
}

fn dct() -> TableFile {
    let mut rounder = Rounder::new();
    let scale = libm::sqrt(2.0 / N_MEL as f64) * std::f64::consts::LN_2;
    let rows: Vec<String> = (1..=N_CEPSTRA)
        .map(|n| {
            let lifter = 1.0 + LIFTER / 2.0 * libm::sin(PI * n as f64 / LIFTER);
            let entries: Vec<i16> = (0..N_MEL / 2)
                .map(|j| {
                    let angle = PI * n as f64 * (j as f64 + 0.5) / N_MEL as f64;
                    rounder.round::<I3F13>(scale * lifter * libm::cos(angle))
                })
                .collect();
            row(&entries)
        })
        .collect();
    let mut text = header("DCT-II, lifter and ln 2 in one matrix.", rounder.worst);
    constant(
        &mut text,
        "ln 2·√(2/26)·(1 + 11·sin(πn/22))·cos(πn(j + ½)/26), Q13; n = 1..=12, j = 0..=12.",
        "COSINES: [[i16; 13]; 12]",
        &rows,
    );
    TableFile { name: "dct.rs", text }
}
