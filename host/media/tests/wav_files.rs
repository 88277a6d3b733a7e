//! WAV files whose headers lie, or that can't be: refused in one clear line. Chunks that are no sound: passed over.
mod common;

use common::refused;
use lipstream_media::sound;

/// A chunk of a RIFF file, padded.
fn chunk(name: &[u8; 4], body: &[u8]) -> Vec<u8> {
    let size = (body.len() as u32).to_le_bytes();
    let padding = &[0][..body.len() % 2];
    [&name[..], &size, body, padding].concat()
}

/// A WAV file of chunks.
fn riff(chunks: &[Vec<u8>]) -> Vec<u8> {
    let body = [b"WAVE".to_vec(), chunks.concat()].concat();
    chunk(b"RIFF", &body)
}

/// The chunk `fmt `: 1 is integers, 3 floats.
fn format(tag: u16, channels: u16, rate_hz: u32, block: u16, bits: u16) -> Vec<u8> {
    let mut body = Vec::new();
    body.extend(tag.to_le_bytes());
    body.extend(channels.to_le_bytes());
    body.extend(rate_hz.to_le_bytes());
    body.extend(rate_hz.wrapping_mul(u32::from(block)).to_le_bytes());
    body.extend(block.to_le_bytes());
    body.extend(bits.to_le_bytes());
    chunk(b"fmt ", &body)
}

/// 100 samples 0, 1, 2, …
fn ramp() -> Vec<u8> {
    (0..100i16).flat_map(i16::to_le_bytes).collect()
}

fn plain() -> Vec<u8> {
    format(1, 1, 16_000, 2, 16)
}

/// Chunks that are no sound may stand anywhere, and may have odd lengths.
#[test]
fn other_chunks_of_wav_files_are_passed_over() {
    let expected: Vec<i16> = (0..100).collect();
    let data = chunk(b"data", &ramp());
    for chunks in [
        vec![plain(), data.clone()],
        vec![
            chunk(b"LIST", b"odd"),
            plain(),
            chunk(b"bext", b"x"),
            data.clone(),
        ],
        vec![
            plain(),
            data.clone(),
            chunk(b"LIST", b"INFOISFTodd"),
            chunk(b"id3 ", b"ID3..."),
        ],
        vec![plain(), chunk(b"fact", &[0; 4]), data.clone()],
    ] {
        let sound = sound::decode(&riff(&chunks)).unwrap();
        assert_eq!(sound.samples, expected);
    }
    // The last chunk's padding may be missing, counted or not.
    let eight = riff(&[format(1, 1, 16_000, 1, 8), chunk(b"data", &[128; 99])]);
    for uncounted in [0, 1] {
        for cut in 0..=uncounted {
            let mut bytes = eight[..eight.len() - cut].to_vec();
            bytes[4..8].copy_from_slice(&(eight.len() as u32 - 8 - uncounted as u32).to_le_bytes());
            assert_eq!(sound::decode(&bytes).unwrap().samples, [0; 99]);
        }
    }
}

/// What a pipe's reader makes of the bytes.
fn piped(bytes: &[u8]) -> Result<Vec<i16>, String> {
    let said = |e: sound::SoundError| format!("{:#}", anyhow::Error::from(e));
    let mut reader =
        sound::Reader::of_stream("a pipe", std::io::Cursor::new(bytes.to_vec())).map_err(said)?;
    let mut samples = Vec::new();
    while let Some(piece) = reader.piece().map_err(said)? {
        samples.extend(piece);
    }
    Ok(samples)
}

#[test]
fn writers_that_did_not_know_the_length_are_understood() {
    let good = riff(&[plain(), chunk(b"data", &ramp())]);
    let want = sound::decode(&good).unwrap().samples;
    assert_eq!(piped(&good).unwrap(), want);
    // ffmpeg writes all ones, which is said of files too; sox, arecord and others write about 2 GiB, or nothing.
    for (file, data) in [
        (u32::MAX, u32::MAX),
        (u32::MAX, 200),
        (0x7fff_f024, 0x7fff_f000),
        (0x7fff_ffff, 0x7fff_ffdb),
        (0, 0),
    ] {
        let mut bytes = good.clone();
        bytes[4..8].copy_from_slice(&file.to_le_bytes());
        bytes[40..44].copy_from_slice(&data.to_le_bytes());
        assert_eq!(piped(&bytes).unwrap(), want, "{file:x} {data:x}");
        if file == u32::MAX {
            assert_eq!(sound::decode(&bytes).unwrap().samples, want, "{file:x} {data:x}");
        }
    }
    // A pipe that ends before its time, and one whose last sample is half there.
    let cut = piped(&good[..good.len() - 20]).unwrap_err();
    assert!(cut.contains("a pipe") && cut.contains("cut short"), "{cut}");
    let mut half = good[..good.len() - 1].to_vec();
    half[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
    half[40..44].copy_from_slice(&u32::MAX.to_le_bytes());
    let half = piped(&half).unwrap_err();
    assert!(half.contains("not a multiple"), "{half}");
}

#[test]
fn wav_headers_that_lie_are_refused() {
    let good = riff(&[plain(), chunk(b"data", &ramp())]);
    assert_eq!(good[40..44], 200u32.to_le_bytes());
    let with = |at: usize, value: u32| {
        let mut bytes = good.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    let length = good.len() as u32 - 8;
    for (what, bytes, words) in [
        (
            "length of the file too large",
            with(4, length + 2),
            "cut short, or the header lies",
        ),
        (
            "length of the file too small",
            with(4, length - 20),
            "20 more bytes follow",
        ),
        ("length of the file 0", with(4, 0), "more bytes follow"),
        (
            "length of the data too large",
            with(40, 202),
            "promises 202 bytes, 200 follow",
        ),
        (
            "length of the data nearly endless",
            with(40, u32::MAX - 1),
            "promises 4294967294 bytes, 200 follow",
        ),
        (
            "length of the data too small",
            with(40, 100),
            "garbage at byte 144",
        ),
        ("length of the data odd", with(40, 199), "not a multiple"),
        ("length of the data 0", with(40, 0), "garbage at byte 44"),
        (
            "length of fmt too large",
            with(16, 5000),
            "chunk 'fmt ' at byte 12 promises 5000 bytes",
        ),
        ("length of fmt too small", with(16, 14), "garbage"),
    ] {
        let error = refused(what, &bytes);
        println!("{what}: {error}");
        assert!(error.contains(words), "{what}: {error}");
    }
}

#[test]
fn impossible_wav_files_are_refused() {
    let data = || chunk(b"data", &ramp());
    let floats = |x: f32| chunk(b"data", &[0.5f32.to_le_bytes(), x.to_le_bytes()].concat());
    for (what, chunks, words) in [
        ("nothing inside", vec![], "no chunk 'fmt '"),
        ("no format", vec![data()], "no chunk 'fmt '"),
        ("no data", vec![plain()], "no chunk 'data'"),
        ("no samples", vec![plain(), chunk(b"data", &[])], "no samples"),
        (
            "data twice",
            vec![plain(), data(), data()],
            "a second chunk 'data'",
        ),
        (
            "garbage",
            vec![plain(), data(), vec![0xff; 50]],
            "garbage at byte 244",
        ),
        (
            "stray bytes",
            vec![plain(), data(), vec![0; 5]],
            "stray bytes at byte 244",
        ),
        (
            "0 channels",
            vec![format(1, 0, 16_000, 2, 16), data()],
            "zero channels",
        ),
        (
            "0 bits",
            vec![format(1, 1, 16_000, 2, 0), data()],
            "bits per sample",
        ),
        (
            "12 bits",
            vec![format(1, 1, 16_000, 2, 12), data()],
            "bits per sample",
        ),
        (
            "64 bits",
            vec![format(3, 1, 16_000, 8, 64), data()],
            "bits per sample is not 32",
        ),
        (
            "blocks of 0 bytes",
            vec![format(1, 1, 16_000, 0, 16), data()],
            "header",
        ),
        (
            "blocks of 3 bytes",
            vec![format(1, 2, 16_000, 3, 16), data()],
            "header",
        ),
        (
            "half a block",
            vec![format(1, 1, 16_000, 2, 16), chunk(b"data", &[1; 3])],
            "multiple",
        ),
        (
            "half a stereo block",
            vec![format(1, 2, 16_000, 4, 16), chunk(b"data", &[1; 6])],
            "data chunk",
        ),
        ("0 Hz", vec![format(1, 1, 0, 2, 16), data()], "rate is 0 Hz"),
        (
            "7999 Hz",
            vec![format(1, 1, 7999, 2, 16), data()],
            "rate is 7999 Hz",
        ),
        (
            "192001 Hz",
            vec![format(1, 1, 192_001, 2, 16), data()],
            "rate is 192001 Hz",
        ),
        (
            "4 GHz",
            vec![format(1, 1, u32::MAX, 1, 8), data()],
            "rate is 4294967295 Hz",
        ),
        (
            "NaN",
            vec![format(3, 1, 16_000, 4, 32), floats(f32::NAN)],
            "sample 1 is not a finite number",
        ),
        (
            "infinity",
            vec![format(3, 1, 16_000, 4, 32), floats(f32::INFINITY)],
            "sample 1 is not a finite",
        ),
        (
            "−infinity",
            vec![format(3, 1, 16_000, 4, 32), floats(f32::NEG_INFINITY)],
            "sample 1 is not a finite",
        ),
        ("A-law", vec![format(6, 1, 16_000, 1, 8), data()], "WAV header"),
    ] {
        let error = refused(what, &riff(&chunks));
        println!("{what}: {error}");
        assert!(error.contains(words), "{what}: {error}");
    }
}
