//! Throughput of the two front ends on this machine, and of another MFCC crate beside them, on the project's own speech.
//!
//! ```text
//! cargo bench -p lipstream --bench frontend
//! ```
//!
//! "Items" are frames of 10 ms. Ours give 39 numbers a frame, the other crate 13 (no Δ, no ΔΔ, no normalisation); all have
//! windows of 25 ms, a 512-point transform and 26 channels.
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use kaldi_native_fbank::mfcc::{MfccComputer, MfccOptions};
use kaldi_native_fbank::online::{FeatureComputer, OnlineFeature};
use lipstream::frontend;
use lipstream::reference::{self, Normalisation};
use lipstream_core::N_STATIC;
use lipstream_media::sound;

const CAUSAL: Normalisation = Normalisation::Causal {
    start_mean: [0.0; N_STATIC],
};

fn main() {
    divan::main();
}

fn hello() -> Vec<i16> {
    let sound = sound::decode(include_bytes!("../../../data/hello.wav"));
    sound.expect("the project's own speech").samples
}

fn frames(samples: &[i16]) -> ItemsCount {
    ItemsCount::new(reference::frame_count(samples.len()))
}

/// The device's integers, sample by sample as the device gets them.
#[divan::bench]
fn lipstream_fixed(bencher: Bencher) {
    let samples = hello();
    let bencher = bencher.counter(frames(&samples));
    bencher.bench_local(|| frontend::observations(black_box(&samples), CAUSAL));
}

/// The reference in `f64`.
#[divan::bench]
fn lipstream_float(bencher: Bencher) {
    let samples = hello();
    let bencher = bencher.counter(frames(&samples));
    bencher.bench_local(|| reference::observations(black_box(&samples), CAUSAL));
}

/// The MFCC of `kaldi-native-fbank` in `f32`, with energy.
#[divan::bench]
fn kaldi_native_fbank_f32(bencher: Bencher) {
    let samples: Vec<f32> = hello().into_iter().map(f32::from).collect();
    let mut options = MfccOptions::default();
    options.frame_opts.dither = 0.0;
    options.frame_opts.window_type = "hamming".to_owned();
    options.mel_opts.num_bins = 26;
    options.htk_compat = true;
    let count = reference::frame_count(samples.len());
    bencher.counter(ItemsCount::new(count)).bench_local(|| {
        let computer = MfccComputer::new(options.clone()).expect("usual settings");
        let mut online = OnlineFeature::new(FeatureComputer::Mfcc(computer));
        online.accept_waveform(16_000.0, black_box(&samples));
        online.input_finished();
        assert_eq!(online.num_frames_ready(), count);
        online.features
    });
}
