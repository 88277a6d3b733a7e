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
/// Some writers forget the byte behind an odd chunk, and some the length of the samples alone.
#[test]
fn chunks_without_padding_and_lengths_of_nothing_cost_no_sound() {
    let expected: Vec<i16> = (0..100).collect();
    let read = |bytes: &[u8]| sound::decode(bytes).unwrap().samples;
    let unpadded = |name: &[u8; 4]| {
        let mut bytes = chunk(name, b"odd");
        bytes.pop();
        bytes
    };
    let data = chunk(b"data", &ramp());
    for name in [b"junk", b"LIST"] {
        assert_eq!(read(&riff(&[plain(), unpadded(name), data.clone()])), expected);
        assert_eq!(read(&riff(&[unpadded(name), plain(), data.clone()])), expected);
    }
    let mut no_length = data.clone();
    no_length[4..8].fill(0);
    assert_eq!(read(&riff(&[plain(), no_length.clone()])), expected);
    // Where a chunk follows, there is no sound.
    let empty = riff(&[plain(), chunk(b"data", &[]), chunk(b"LIST", b"INFO")]);
    assert!(refused("empty", &empty).contains("no samples"));
    // The same in RF64, whose own length was never written.
    let mut streamed = data;
    streamed[4..8].fill(0xff);
    let mut bytes = riff(&[chunk(b"ds64", &[0; 28]), plain(), streamed]);
    bytes[..4].copy_from_slice(b"RF64");
    bytes[4..8].fill(0xff);
    assert_eq!(read(&bytes), expected);
}

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
        if file != 0x7fff_f024 || data != 200 {
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
    // A header that was written before the sound and not gone back to.
    let mut unsaid = good.clone();
    unsaid[4..8].copy_from_slice(&36u32.to_le_bytes());
    unsaid[40..44].fill(0);
    assert_eq!(sound::decode(&unsaid).unwrap().samples, want);
}

/// The length of the file in its header is nobody's concern where the chunks are whole, and what follows the end is another program's.
#[test]
fn a_wrong_length_of_the_whole_file_costs_no_sound() {
    let good = riff(&[plain(), chunk(b"data", &ramp())]);
    let want = sound::decode(&good).unwrap().samples;
    let length = good.len() as u32 - 8;
    for said in [length + 8, length + 2, length - 20, 36] {
        let mut bytes = good.clone();
        bytes[4..8].copy_from_slice(&said.to_le_bytes());
        assert_eq!(sound::decode(&bytes).unwrap().samples, want, "{said}");
    }
    let mut tagged = good.clone();
    tagged.extend(b"TAGa title of some program's".iter().chain(&[0; 100]));
    assert_eq!(sound::decode(&tagged).unwrap().samples, want);
}

/// An extensible `fmt ` chunk: `tag` is the coding of its GUID, `valid` the bits that are meant.
fn extensible(tag: u16, channels: u16, width: u16, valid: u16) -> Vec<u8> {
    let mut body = format(0xfffe, channels, 16_000, channels * width, width * 8)[8..].to_vec();
    body.extend(22u16.to_le_bytes());
    body.extend(valid.to_le_bytes());
    body.extend([0; 4]);
    body.extend(tag.to_le_bytes());
    body.extend([0, 0, 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71]);
    chunk(b"fmt ", &body)
}

/// Whatever the width, the upper bits count: 24 valid ones of 32 are worth what 32 are.
#[test]
fn integers_of_every_width_are_the_same_sound() {
    let ramp: Vec<i16> = (0..100).map(|n| n * 300 - 15_000).collect();
    for width in 2..=8u16 {
        let bytes: Vec<u8> = ramp
            .iter()
            .flat_map(|&s| (i64::from(s) << 48).to_le_bytes()[8 - usize::from(width)..].to_vec())
            .collect();
        for valid in [8 * width, 8 * width - 4, 16] {
            let file = riff(&[extensible(1, 1, width, valid), chunk(b"data", &bytes)]);
            assert_eq!(
                sound::decode(&file).unwrap().samples,
                ramp,
                "{valid} bits in {width} bytes"
            );
        }
        let file = riff(&[format(1, 1, 16_000, width, 8 * width), chunk(b"data", &bytes)]);
        assert_eq!(sound::decode(&file).unwrap().samples, ramp, "{width} bytes");
    }
    // Without an extensible header nobody can know which bits are meant.
    let file = riff(&[format(1, 1, 16_000, 4, 24), chunk(b"data", &[0; 400])]);
    assert!(refused("24 in 4", &file).contains("24 bits in 4 bytes"));
}

#[test]
fn floats_of_other_units_and_opposite_channels_are_noticed() {
    let ramp: Vec<i16> = (0..100).map(|n| n * 300 - 15_000).collect();
    let floats = |scale: f64| -> Vec<u8> {
        ramp.iter()
            .flat_map(|&s| (f64::from(s) / 32768.0 * scale).to_le_bytes())
            .collect()
    };
    let file = |scale: f64| riff(&[extensible(3, 1, 8, 64), chunk(b"data", &floats(scale))]);
    assert_eq!(sound::decode(&file(1.0)).unwrap().samples, ramp);
    assert!(refused("in units of integers", &file(32768.0)).contains("where full scale is ±1"));
    let error = refused("four times too loud", &file(4.0));
    assert!(
        error.contains("% of its samples are beyond full scale"),
        "{error}"
    );
    let opposite: Vec<u8> = ramp
        .iter()
        .flat_map(|&s| [s.to_le_bytes(), (-s).to_le_bytes()].concat())
        .collect();
    let stereo = riff(&[format(1, 2, 16_000, 4, 16), chunk(b"data", &opposite)]);
    let heard = sound::decode(&stereo).unwrap().samples;
    let turned: Vec<i16> = ramp.iter().map(|s| -s).collect();
    assert!(heard == ramp || heard == turned, "{heard:?}");
}

/// More than 4 GiB can be promised; no more is read than is there.
#[test]
fn rf64_says_its_length_in_a_chunk_of_its_own() {
    let data = ramp();
    let with = |samples: u64| {
        let mut sizes = 0u64.to_le_bytes().to_vec();
        sizes.extend(samples.to_le_bytes());
        sizes.extend([0; 12]);
        let mut file = riff(&[
            chunk(b"ds64", &sizes),
            plain(),
            chunk(b"data", &data),
            chunk(b"LIST", b"tail"),
        ]);
        let at = 12 + 8 + sizes.len() + 24 + 4;
        assert_eq!(file[at..at + 4], 200u32.to_le_bytes());
        file[at..at + 4].fill(0xff);
        file[..4].copy_from_slice(b"RF64");
        file[4..8].fill(0xff);
        file
    };
    assert_eq!(
        sound::decode(&with(200)).unwrap().samples,
        (0..100).collect::<Vec<i16>>()
    );
    let error = refused("RF64 that lies", &with(1 << 40));
    assert!(
        error.contains("promises 1099511627776 bytes, 212 follow"),
        "{error}"
    );
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
    for (what, bytes, words) in [
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
        (
            "length of fmt too large",
            with(16, 5000),
            "chunk 'fmt ' at byte 12 promises 5000 bytes",
        ),
        ("length of fmt too small", with(16, 14), "has 14 bytes, not 16"),
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
        (
            "the format behind the samples",
            vec![data(), plain()],
            "no chunk 'fmt ' before its samples at byte 20",
        ),
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
            "64 bits",
            vec![format(3, 1, 16_000, 8, 32), data()],
            "floats of 32 bits per sample in 8 bytes",
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
            "multiple",
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
        (
            "A-law of 16 bits",
            vec![format(6, 1, 16_000, 2, 16), data()],
            "A-law of 16 bits",
        ),
    ] {
        let error = refused(what, &riff(&chunks));
        println!("{what}: {error}");
        assert!(error.contains(words), "{what}: {error}");
    }
}
