//! Every stage of the integer front end on its own against `f64`, with the error that its module states.
mod common;

use std::f64::consts::TAU;

use common::sounds;
use lipstream::reference::{self, dct, delta, mel, preemphasis, window};
use lipstream_core::N_STATIC;
use lipstream_core::frontend::delta::Deltas;
use lipstream_core::frontend::energy::{self, Energy};
use lipstream_core::frontend::fft::{self, Complex, FFT_HALF};
use lipstream_core::frontend::magnitude::{MAGNITUDE_SHIFT, magnitude};
use lipstream_core::frontend::{self, log};

/// The vectors' windows and tones of every eighth bin.
fn windows() -> Vec<[i16; 400]> {
    let tones = (1..256).step_by(8).map(|bin| {
        std::array::from_fn(|n| (20_000.0 * (TAU * f64::from(bin) * n as f64 / 512.0).sin()) as i16)
    });
    sounds::windows().into_iter().chain(tones).collect()
}

fn loaded(samples: &[i16; 400]) -> ([Complex; FFT_HALF], u32) {
    let headroom = energy::headroom(Energy::default().next(samples));
    let mut points = [Complex::default(); FFT_HALF];
    frontend::window::load(samples, headroom, &mut points);
    (points, headroom)
}

#[test]
fn energy_is_exact_and_its_logarithm_within_half_an_lsb() {
    for samples in windows() {
        let sum = Energy::default().next(&samples);
        let exact: u64 = samples
            .iter()
            .map(|&x| (i64::from(x) * i64::from(x)) as u64)
            .sum();
        assert_eq!(sum, exact);
        let raw: Vec<f64> = samples.iter().map(|&x| f64::from(x)).collect();
        let error = reference::energy::log_energy(&raw, 0.0) - f64::from(energy::log_energy(sum)) / 256.0;
        assert!(error.abs() <= 0.0021, "{error}");
        assert!(sum << (2 * energy::headroom(sum)) < 1 << 39);
    }
}

#[test]
fn the_window_loses_two_lsb_and_the_coefficient() {
    for samples in windows() {
        let mut want: Vec<f64> = samples.iter().map(|&x| f64::from(x)).collect();
        let loudest = want.iter().fold(0f64, |a, x| a.max(x.abs()));
        preemphasis::apply(&mut want);
        window::apply(&mut want, &window::hamming());
        let (points, headroom) = loaded(&samples);
        let lsb = 2f64.powi(-9 - headroom as i32);
        for (z, pair) in points.iter().zip(want.chunks_exact(2)) {
            for (got, want) in [(z.re, pair[0]), (z.im, pair[1])] {
                let error = (f64::from(got) * lsb - want).abs();
                assert!(
                    error <= 2.0 * lsb + 1.3e-6 * loudest,
                    "{error} with an LSB of {lsb}"
                );
            }
        }
    }
}

#[test]
fn the_transform_is_off_by_24_lsb_at_most() {
    let (mut worst, mut squares, mut count) = (0f64, 0.0, 0.0);
    for samples in windows() {
        let (input, _) = loaded(&samples);
        let mut points = input;
        fft::transform(&mut points);
        for k in 0..FFT_HALF {
            let (mut re, mut im) = (0.0, 0.0);
            for (n, z) in input.iter().enumerate() {
                let (sin, cos) = (-TAU * (k * n % FFT_HALF) as f64 / FFT_HALF as f64).sin_cos();
                // Three stages halve.
                re += (f64::from(z.re) * cos - f64::from(z.im) * sin) / 8.0;
                im += (f64::from(z.re) * sin + f64::from(z.im) * cos) / 8.0;
            }
            let at = (k & 3) << 6 | (k >> 2 & 3) << 4 | (k >> 4 & 3) << 2 | k >> 6;
            for error in [f64::from(points[at].re) - re, f64::from(points[at].im) - im] {
                worst = worst.max(error.abs());
                squares += error * error;
                count += 1.0;
            }
        }
    }
    let rms = f64::sqrt(squares / count);
    println!("worst {worst:.1} LSB, rms {rms:.2} LSB");
    assert!(worst <= 24.0 && rms <= 3.5, "worst {worst}, rms {rms}");
}

#[test]
fn magnitudes_are_off_by_a_fifth_of_a_percent_at_most() {
    let mut noise = sounds::noise(7);
    let (mut squares, mut count) = (0.0, 0.0);
    for round in 0..200_000 {
        let scale = 2f64.powi(round % 31);
        let (a, b) = ((noise() * scale) as i32, (noise() * scale) as i32);
        let want = f64::from(a).hypot(f64::from(b)) / f64::from(1 << MAGNITUDE_SHIFT);
        let error = f64::from(magnitude(a, b)) - want;
        assert!(error.abs() <= 0.0021 * want + 1.5, "|{a} + j{b}|: off by {error}");
        if want > 1e6 {
            squares += (error / want).powi(2);
            count += 1.0;
        }
    }
    let rms = f64::sqrt(squares / count);
    println!("relative, rms: {rms:.1e}");
    assert!(rms <= 0.001);
    for extreme in [i32::MIN, i32::MIN + 1, i32::MAX, -1, 0, 1] {
        for other in [i32::MIN, i32::MAX, 0] {
            let want = f64::from(extreme).hypot(f64::from(other)) / 4.0;
            let error = f64::from(magnitude(extreme, other)) - want;
            assert!(
                error.abs() <= 0.0021 * want + 1.5,
                "|{extreme} + j{other}|: off by {error}"
            );
        }
    }
}

#[test]
fn channel_sums_are_off_by_their_shares_rounding() {
    let mut noise = sounds::noise(8);
    let twin = mel::Filterbank::default();
    for _ in 0..200 {
        let bins: [u32; FFT_HALF] = std::array::from_fn(|_| (noise().abs() * 1e7) as u32);
        let magnitudes: Vec<f64> = bins.iter().map(|&b| f64::from(b)).chain([0.0]).collect();
        let mut sums = [0u64; mel::N_MEL];
        frontend::mel::filterbank(&bins, &mut sums);
        for (got, want) in sums.iter().zip(twin.apply(&magnitudes)) {
            let error = (*got as f64 / 65536.0 - want).abs();
            assert!(error <= 2e-5 * want, "{error} of {want}");
        }
    }
}

#[test]
fn logarithms_are_off_by_seven_in_a_hundred_thousand() {
    let mut x = 1.0f64;
    while x < 2f64.powi(52) {
        let error = f64::from(log::log2_q16(x as u64)) / 65536.0 - (x.floor()).log2();
        assert!(error.abs() <= 7e-5, "log₂ {x}: off by {error}");
        x *= 1.003;
    }
    assert_eq!(log::log2_q16(0), 0);
    assert_eq!(log::log_mel(&[3; mel::N_MEL], 16), [0; mel::N_MEL]);
}

#[test]
fn cepstra_are_off_by_two_lsb() {
    let mut noise = sounds::noise(9);
    let twin = dct::Cosines::default();
    for _ in 0..500 {
        let logs: [i32; mel::N_MEL] = std::array::from_fn(|_| ((8.0 + 8.0 * noise()) * 65536.0) as i32);
        let natural = logs.map(|l| f64::from(l) / 65536.0 * std::f64::consts::LN_2);
        let mut cepstra = [0; 12];
        frontend::dct::cepstra(&logs, &mut cepstra);
        for (got, want) in cepstra.iter().zip(twin.cepstra(&natural)) {
            let error = f64::from(*got) / 256.0 - want.clamp(-128.0, 32767.0 / 256.0);
            assert!(error.abs() <= 0.008, "{want}: off by {error}");
        }
    }
}

#[test]
fn deltas_are_off_by_their_rounding() {
    let mut noise = sounds::noise(10);
    let frames: Vec<[i16; N_STATIC]> = (0..60)
        .map(|_| std::array::from_fn(|_| (noise() * 20_000.0) as i16))
        .collect();
    let raw = ndarray::Array2::from_shape_fn((60, N_STATIC), |(t, i)| f64::from(frames[t][i]));
    let first = delta::deltas(raw.view());
    let second = delta::deltas(first.view());
    let mut deltas = Deltas::default();
    let (mut d, mut dd) = ([0; N_STATIC], [0; N_STATIC]);
    for t in 0..64 {
        let ready = match t {
            0..60 => deltas.next(&frames[t], &mut d, &mut dd),
            _ => deltas.next_past_end(t - 59, &mut d, &mut dd),
        };
        assert_eq!(ready, t >= 4);
        for i in 0..if ready { N_STATIC } else { 0 } {
            assert!((f64::from(d[i]) - first[[t - 4, i]]).abs() <= 0.501);
            assert!((f64::from(dd[i]) - second[[t - 4, i]]).abs() <= 0.81);
        }
    }
}
