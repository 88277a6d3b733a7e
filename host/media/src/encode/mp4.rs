//! An MP4 file (ISO/IEC 14496-12, -14, -15) with one H.264 track and at most one AAC track.
//!
//! The header comes first, so that a browser starts before it has everything. The sound track has an edit
//! list that skips the codec's priming: sample 0 of the sound is heard when picture 0 is seen.
use std::io::{Read, Write};

use super::EncodeError;
use super::aac::{self, Sound};
use super::h264::Video;

/// Units a second of the movie header: every usual picture and sampling rate divides it.
const MOVIE_SCALE: u32 = 48_000;
/// Units of a picture in its track.
const PICTURE_UNITS: u32 = 512;
/// Chunks of both tracks alternate after this much time.
const CHUNKS_PER_SECOND: u32 = 2;

/// The identity transformation of ISO/IEC 14496-12, 16.16 and 2.30 fixed point.
const MATRIX: [u32; 9] = [0x1_0000, 0, 0, 0, 0x1_0000, 0, 0, 0, 0x4000_0000];
/// "und", the undetermined language, 5 bits a letter.
const LANGUAGE: u16 = 0x55c4;

/// Writes the whole file. `pictures` and `units` give the encoded samples of the two tracks, one after the other: they are copied chunk
/// by chunk, so that a film takes no more memory than the sizes of its samples. `comment` is what players and `ffprobe` show as such.
///
/// # Errors
///
/// That the film is too large for this kind of file, and what the readers and `out` say.
pub fn write(
    out: &mut dyn Write,
    video: &Video,
    pictures: &mut dyn Read,
    sound: Option<(&Sound, &mut dyn Read)>,
    comment: Option<&str>,
) -> Result<(), EncodeError> {
    let (sound, mut units) = sound.unzip();
    let layout = Layout::new(video, sound);
    if layout.payload > u64::from(u32::MAX) - (1 << 24) {
        return Err(EncodeError::TooLarge);
    }
    let mut head = Vec::new();
    boxed(&mut head, b"ftyp", |b| {
        b.extend(b"isom");
        u32s(b, &[0x200]);
        b.extend(b"isomiso2avc1mp41");
    });
    // The header's length does not depend on the offsets in it.
    let mut header = Vec::new();
    movie(&mut header, video, sound, &layout, 0, comment);
    let first = (head.len() + header.len() + 8) as u32;
    movie(&mut head, video, sound, &layout, first, comment);
    u32s(&mut head, &[8 + layout.payload as u32]);
    head.extend(b"mdat");
    out.write_all(&head)?;
    for chunk in &layout.chunks {
        let from: &mut dyn Read = match chunk.track {
            Track::Video => &mut *pictures,
            Track::Sound => units.as_mut().expect("a sound chunk comes from a sound track"),
        };
        let copied = std::io::copy(&mut from.take(chunk.length), out)?;
        if copied < chunk.length {
            return Err(EncodeError::CutShort);
        }
    }
    Ok(())
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Track {
    Video,
    Sound,
}

/// Samples `from..to` of a track that lie side by side in the file.
struct Chunk {
    track: Track,
    from: usize,
    to: usize,
    /// Bytes after the first chunk's first byte.
    offset: u64,
    /// Bytes of its samples.
    length: u64,
}

struct Layout {
    chunks: Vec<Chunk>,
    /// Bytes of all chunks.
    payload: u64,
}

impl Layout {
    fn new(video: &Video, sound: Option<&Sound>) -> Self {
        let mut layout = Layout {
            chunks: Vec::new(),
            payload: 0,
        };
        let pictures = video.fps.div_ceil(CHUNKS_PER_SECOND) as usize;
        let (mut picture, mut unit) = (0, 0);
        let n_units = sound.map_or(0, |s| s.sizes.len());
        while picture < video.sizes.len() || unit < n_units {
            let to = (picture + pictures).min(video.sizes.len());
            layout.add(Track::Video, &video.sizes, picture, to);
            picture = to;
            if let Some(sound) = sound {
                // As much sound as there are pictures; all that is left after the last picture.
                let to = if picture == video.sizes.len() {
                    n_units
                } else {
                    let heard = picture as u64 * u64::from(sound.rate_hz) / u64::from(video.fps);
                    let units = (heard + u64::from(sound.priming)).div_ceil(u64::from(aac::FRAME_SAMPLES));
                    (units as usize).clamp(unit, n_units)
                };
                layout.add(Track::Sound, &sound.sizes, unit, to);
                unit = to;
            }
        }
        layout
    }

    fn add(&mut self, track: Track, sizes: &[u32], from: usize, to: usize) {
        if from < to {
            let length = sizes[from..to].iter().map(|&s| u64::from(s)).sum();
            self.chunks.push(Chunk {
                track,
                from,
                to,
                offset: self.payload,
                length,
            });
            self.payload += length;
        }
    }
}

fn movie(
    out: &mut Vec<u8>,
    video: &Video,
    sound: Option<&Sound>,
    layout: &Layout,
    first: u32,
    comment: Option<&str>,
) {
    let seen = video.sizes.len() as u64 * u64::from(MOVIE_SCALE) / u64::from(video.fps);
    let heard = sound.map_or(0, |s| s.samples * u64::from(MOVIE_SCALE) / u64::from(s.rate_hz));
    boxed(out, b"moov", |b| {
        full(b, b"mvhd", 0, 0, |b| {
            u32s(b, &[0, 0, MOVIE_SCALE, seen.max(heard) as u32, 0x1_0000]);
            b.extend([1, 0]);
            b.extend([0; 10]);
            u32s(b, &MATRIX);
            b.extend([0; 24]);
            u32s(b, &[3]);
        });
        let size = [u32::from(video.width) << 16, u32::from(video.height) << 16];
        let pictures = TrackHeader {
            id: 1,
            size,
            volume: 0,
            duration: seen as u32,
            media_start: 0,
            scale: video.fps * PICTURE_UNITS,
            media_duration: video.sizes.len() as u32 * PICTURE_UNITS,
            handler: b"vide",
            name: b"VideoHandler\0",
        };
        track(b, &pictures, |b| {
            full(b, b"vmhd", 0, 1, |b| b.extend([0; 8]));
            data_information(b);
            boxed(b, b"stbl", |b| {
                full(b, b"stsd", 0, 0, |b| {
                    u32s(b, &[1]);
                    avc_entry(b, video);
                });
                let key: Vec<u32> = (1..)
                    .zip(&video.key)
                    .filter(|(_, k)| **k)
                    .map(|(i, _)| i)
                    .collect();
                full(b, b"stss", 0, 0, |b| {
                    u32s(b, &[key.len() as u32]);
                    u32s(b, &key);
                });
                sample_tables(b, &video.sizes, PICTURE_UNITS, layout, Track::Video, first);
            });
        });
        if let Some(sound) = sound {
            let header = TrackHeader {
                id: 2,
                size: [0, 0],
                volume: 0x100,
                duration: heard as u32,
                media_start: sound.priming,
                scale: sound.rate_hz,
                media_duration: sound.sizes.len() as u32 * aac::FRAME_SAMPLES,
                handler: b"soun",
                name: b"SoundHandler\0",
            };
            track(b, &header, |b| {
                full(b, b"smhd", 0, 0, |b| b.extend([0; 4]));
                data_information(b);
                boxed(b, b"stbl", |b| {
                    full(b, b"stsd", 0, 0, |b| {
                        u32s(b, &[1]);
                        aac_entry(b, sound);
                    });
                    sample_tables(b, &sound.sizes, aac::FRAME_SAMPLES, layout, Track::Sound, first);
                });
            });
        }
        if let Some(comment) = comment {
            words(b, &[(b"\xa9too", "lipstream"), (b"\xa9cmt", comment)]);
        }
    });
}

/// Words about the film, each under its name, as iTunes writes them and every player reads them (QuickTime File Format, "Metadata").
fn words(out: &mut Vec<u8>, named: &[(&[u8; 4], &str)]) {
    boxed(out, b"udta", |b| {
        full(b, b"meta", 0, 0, |b| {
            full(b, b"hdlr", 0, 0, |b| {
                u32s(b, &[0]);
                b.extend(b"mdirappl");
                u32s(b, &[0, 0]);
                b.push(0);
            });
            boxed(b, b"ilst", |b| {
                for (name, text) in named {
                    boxed(b, name, |b| {
                        boxed(b, b"data", |b| {
                            // UTF-8, of no country or language.
                            u32s(b, &[1, 0]);
                            b.extend(text.as_bytes());
                        });
                    });
                }
            });
        });
    });
}

struct TrackHeader {
    id: u32,
    /// Width and height, 16.16.
    size: [u32; 2],
    /// 8.8.
    volume: u16,
    /// What is played, in movie units.
    duration: u32,
    /// Where playing starts, in the track's units.
    media_start: u32,
    /// Units a second of the track.
    scale: u32,
    media_duration: u32,
    handler: &'static [u8; 4],
    name: &'static [u8],
}

fn track(out: &mut Vec<u8>, t: &TrackHeader, information: impl FnOnce(&mut Vec<u8>)) {
    boxed(out, b"trak", |b| {
        // Enabled and in the movie.
        full(b, b"tkhd", 0, 3, |b| {
            u32s(b, &[0, 0, t.id, 0, t.duration, 0, 0]);
            b.extend([0; 4]);
            b.extend(t.volume.to_be_bytes());
            b.extend([0; 2]);
            u32s(b, &MATRIX);
            u32s(b, &t.size);
        });
        boxed(b, b"edts", |b| {
            full(b, b"elst", 0, 0, |b| {
                u32s(b, &[1, t.duration, t.media_start, 0x1_0000]);
            });
        });
        boxed(b, b"mdia", |b| {
            full(b, b"mdhd", 0, 0, |b| {
                u32s(b, &[0, 0, t.scale, t.media_duration]);
                b.extend(LANGUAGE.to_be_bytes());
                b.extend([0; 2]);
            });
            full(b, b"hdlr", 0, 0, |b| {
                b.extend([0; 4]);
                b.extend(t.handler);
                b.extend([0; 12]);
                b.extend(t.name);
            });
            boxed(b, b"minf", information);
        });
    });
}

/// "The data is in this very file."
fn data_information(out: &mut Vec<u8>) {
    boxed(out, b"dinf", |b| {
        full(b, b"dref", 0, 0, |b| {
            u32s(b, &[1]);
            full(b, b"url ", 0, 1, |_| {});
        });
    });
}

fn avc_entry(out: &mut Vec<u8>, video: &Video) {
    boxed(out, b"avc1", |b| {
        b.extend([0, 0, 0, 0, 0, 0, 0, 1]);
        b.extend([0; 16]);
        b.extend(video.width.to_be_bytes());
        b.extend(video.height.to_be_bytes());
        // 72 dpi both ways, one picture a sample, no compressor name, colour without alpha.
        u32s(b, &[0x48_0000, 0x48_0000, 0]);
        b.extend([0, 1]);
        b.extend([0; 32]);
        b.extend([0, 0x18, 0xff, 0xff]);
        boxed(b, b"avcC", |b| {
            b.push(1);
            b.extend(&video.sps[1..4]);
            // Lengths of 4 bytes; one set of each kind.
            b.extend([0xff, 0xe1]);
            b.extend((video.sps.len() as u16).to_be_bytes());
            b.extend(&video.sps);
            b.push(1);
            b.extend((video.pps.len() as u16).to_be_bytes());
            b.extend(&video.pps);
        });
        // BT.601, limited range, as `colour` computes.
        boxed(b, b"colr", |b| b.extend(b"nclx\0\x06\0\x06\0\x06\0"));
    });
}

fn aac_entry(out: &mut Vec<u8>, sound: &Sound) {
    let largest = sound.sizes.iter().copied().max().unwrap_or(0);
    let bits = 8 * sound.sizes.iter().map(|&u| u64::from(u)).sum::<u64>();
    let spoken = sound.sizes.len() as u64 * u64::from(aac::FRAME_SAMPLES);
    let average = (bits * u64::from(sound.rate_hz) / spoken.max(1)) as u32;
    let peak = 8 * largest * sound.rate_hz / aac::FRAME_SAMPLES;
    boxed(out, b"mp4a", |b| {
        b.extend([0, 0, 0, 0, 0, 0, 0, 1]);
        b.extend([0; 8]);
        // One channel of 16 bits.
        b.extend([0, 1, 0, 16, 0, 0, 0, 0]);
        u32s(b, &[sound.rate_hz << 16]);
        full(b, b"esds", 0, 0, |b| {
            // ES descriptor > decoder configuration (AAC, audio stream) > AudioSpecificConfig; SL: MP4.
            let config = sound.config.len() as u8;
            b.extend([0x03, 3 + 2 + 13 + 2 + config + 3, 0, 2, 0]);
            b.extend([0x04, 13 + 2 + config, 0x40, 0x15]);
            b.extend(&largest.to_be_bytes()[1..]);
            u32s(b, &[peak, average]);
            b.extend([0x05, config]);
            b.extend(&sound.config);
            b.extend([0x06, 1, 2]);
        });
    });
}

/// Durations, sizes, chunks: where each sample is.
fn sample_tables(out: &mut Vec<u8>, sizes: &[u32], units: u32, layout: &Layout, track: Track, first: u32) {
    let count = sizes.len() as u32;
    full(out, b"stts", 0, 0, |b| u32s(b, &[1, count, units]));
    let chunks: Vec<&Chunk> = layout.chunks.iter().filter(|c| c.track == track).collect();
    // A run starts where the number of samples in a chunk changes.
    let mut runs: Vec<[u32; 3]> = Vec::new();
    for (number, chunk) in (1..).zip(&chunks) {
        let held = (chunk.to - chunk.from) as u32;
        if runs.last().is_none_or(|run| run[1] != held) {
            runs.push([number, held, 1]);
        }
    }
    full(out, b"stsc", 0, 0, |b| {
        u32s(b, &[runs.len() as u32]);
        u32s(b, runs.as_flattened());
    });
    full(out, b"stsz", 0, 0, |b| {
        u32s(b, &[0, count]);
        u32s(b, sizes);
    });
    full(out, b"stco", 0, 0, |b| {
        u32s(b, &[chunks.len() as u32]);
        for chunk in &chunks {
            u32s(b, &[first + chunk.offset as u32]);
        }
    });
}

/// A box: its length, its name, what `fill` writes.
fn boxed(out: &mut Vec<u8>, name: &[u8; 4], fill: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend([0; 4]);
    out.extend(name);
    fill(out);
    let length = (out.len() - start) as u32;
    out[start..start + 4].copy_from_slice(&length.to_be_bytes());
}

/// A box with version and flags.
fn full(out: &mut Vec<u8>, name: &[u8; 4], version: u8, flags: u32, fill: impl FnOnce(&mut Vec<u8>)) {
    boxed(out, name, |b| {
        u32s(b, &[u32::from(version) << 24 | flags]);
        fill(b);
    });
}

fn u32s(out: &mut Vec<u8>, values: &[u32]) {
    out.extend(values.iter().flat_map(|v| v.to_be_bytes()));
}
