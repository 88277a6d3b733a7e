use std::f64::consts::TAU;
use std::io::Cursor;

use hound::{SampleFormat, WavSpec, WavWriter};

use super::*;

fn wav<S: hound::Sample + Copy>(
    rate: u32,
    channels: u16,
    bits: u16,
    format: SampleFormat,
    samples: &[S],
) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let spec = WavSpec {
        channels,
        sample_rate: rate,
        bits_per_sample: bits,
        sample_format: format,
    };
    let mut writer = WavWriter::new(&mut bytes, spec).unwrap();
    for &sample in samples {
        writer.write_sample(sample).unwrap();
    }
    writer.finalize().unwrap();
    bytes.into_inner()
}

fn error_of(bytes: &[u8]) -> String {
    let error = format!("{:#}", anyhow::Error::from(decode(bytes).unwrap_err()));
    assert!(!error.contains('\n'), "one line, not: {error}");
    error
}

#[test]
fn sixteen_bits_at_16_khz_pass_unchanged() {
    let samples: Vec<i16> = vec![i16::MIN, -1, 0, 1, 12345, i16::MAX];
    let sound = decode(&wav(16_000, 1, 16, SampleFormat::Int, &samples)).unwrap();
    assert_eq!(sound.samples, samples);
}

#[test]
fn all_sample_sizes_agree() {
    let eight: Vec<i8> = vec![-128, -3, 0, 5, 127];
    let expected: Vec<i16> = eight.iter().map(|&s| i16::from(s) * 256).collect();
    let scaled = |shift: u32| eight.iter().map(|&s| i32::from(s) << shift).collect::<Vec<i32>>();
    let floats: Vec<f32> = eight.iter().map(|&s| f32::from(s) / 128.0).collect();
    for bytes in [
        wav(16_000, 1, 8, SampleFormat::Int, &eight),
        wav(16_000, 1, 16, SampleFormat::Int, &expected),
        wav(16_000, 1, 24, SampleFormat::Int, &scaled(16)),
        wav(16_000, 1, 32, SampleFormat::Int, &scaled(24)),
        wav(16_000, 1, 32, SampleFormat::Float, &floats),
    ] {
        assert_eq!(decode(&bytes).unwrap().samples, expected);
    }
}

#[test]
fn channels_are_averaged() {
    let sound = decode(&wav(16_000, 2, 16, SampleFormat::Int, &[100i16, 300, -50, 50])).unwrap();
    assert_eq!(sound.samples, [200, 0]);
    assert_eq!(sound.source_channels, 2);
}

#[test]
fn loud_floats_are_clipped() {
    let mut samples = [0.0f32; 50];
    samples[..2].copy_from_slice(&[2.0, -2.0]);
    let sound = decode(&wav(16_000, 1, 32, SampleFormat::Float, &samples)).unwrap();
    assert_eq!(sound.samples[..3], [i16::MAX, i16::MIN, 0]);
}

/// A 440 Hz tone of any rate becomes the tone sampled at 16 kHz, in time and to within −60 dB.
#[test]
fn resampled_tones_stay_in_time() {
    for rate in [8_000u32, 11_025, 22_050, 32_000, 44_100, 48_000] {
        let tone = |n: usize, rate: f64| (TAU * 440.0 * n as f64 / rate).sin() * 0.5;
        let samples: Vec<f32> = (0..rate as usize)
            .map(|n| tone(n, f64::from(rate)) as f32)
            .collect();
        let sound = decode(&wav(rate, 1, 32, SampleFormat::Float, &samples)).unwrap();
        assert_eq!(sound.samples.len(), 16_000, "{rate} Hz");
        let (mut signal, mut noise) = (0.0, 0.0);
        for (n, &sample) in sound.samples.iter().enumerate().skip(500).take(15_000) {
            let want = tone(n, 16_000.0) * 32768.0;
            signal += want * want;
            noise += (f64::from(sample) - want).powi(2);
        }
        let snr_db = 10.0 * f64::log10(signal / noise);
        assert!(snr_db > 60.0, "{rate} Hz: {snr_db:.1} dB");
    }
}

#[test]
fn bad_files_get_one_clear_line() {
    let good = wav(16_000, 1, 16, SampleFormat::Int, &[1i16; 1000]);
    assert!(error_of(&[]).contains("empty"));
    assert!(error_of(b"hello, this is text").contains("not a"));
    assert!(error_of(&good[..20]).contains("header"));
    assert!(error_of(&good[..good.len() - 100]).contains("cut short"));
    let mut lying = good.clone();
    lying[40..44].copy_from_slice(&0x7fff_fff0u32.to_le_bytes());
    assert!(error_of(&lying).contains("cut short"));
    assert!(error_of(&wav::<i16>(16_000, 1, 16, SampleFormat::Int, &[])).contains("no samples"));
    let nan = wav(16_000, 1, 32, SampleFormat::Float, &[0.0f32, f32::NAN, 0.0]);
    assert!(error_of(&nan).contains("sample 1 is not a finite number"));
    assert!(error_of(&wav(4_000, 1, 16, SampleFormat::Int, &[1i16])).contains("4000 Hz"));
}

/// Whole blocks of zeros at the end, and none: the pieces are what the resampler makes of the whole.
#[test]
fn pieces_are_resampled_like_the_whole() {
    use rubato::Resampler as _;
    for rate in [8_000u32, 11_025, 22_050, 44_100, 48_000, 96_000] {
        for length in [1usize, 100, 1024, 2048, 5000, 44_100] {
            let samples: Vec<f64> = (0..length).map(|n| (n as f64 * 0.37).sin() * 0.3).collect();
            let (mut to_16_khz, mut pieces) = (To16Khz::new(rate).unwrap(), Vec::new());
            for piece in samples.chunks(777) {
                to_16_khz.push(piece, &mut pieces).unwrap();
            }
            to_16_khz.finish(&mut pieces).unwrap();
            let mut fft = rubato::Fft::<f64>::new(
                rate as usize,
                16_000,
                resample::chunk(rate),
                1,
                rubato::FixedSync::Both,
            )
            .unwrap();
            let input = audioadapter_buffers::owned::InterleavedOwned::new_from(samples, 1, length).unwrap();
            let whole = fft.process_all(&input, length, None).unwrap().take_data();
            assert_eq!(pieces, whole, "{rate} Hz, {length} samples");
        }
    }
}

/// What somebody else hands over, in whatever pieces, becomes what a file of the same samples does.
#[test]
fn a_resampler_gives_what_a_file_gives() {
    for rate in [8_000, 16_000, 44_100, 48_000] {
        let samples: Vec<f32> = (0..rate as usize)
            .map(|k| (0.4 * (TAU * 440.0 * k as f64 / f64::from(rate)).sin()) as f32)
            .collect();
        let file = wav(rate, 1, 32, SampleFormat::Float, &samples);
        let want = decode(&file).unwrap().samples;
        for cut in [1, 128, 441, samples.len()] {
            let mut resampler = Resampler::new(rate).unwrap();
            let mut have = Vec::new();
            for piece in samples.chunks(cut) {
                resampler.push(piece, &mut have).unwrap();
            }
            resampler.finish(&mut have).unwrap();
            assert!(have == want, "{rate} Hz in pieces of {cut}");
        }
    }
    assert!(matches!(
        Resampler::new(7_999).err(),
        Some(SoundError::Rate { rate_hz: 7_999 })
    ));
}
