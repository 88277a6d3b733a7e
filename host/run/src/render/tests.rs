//! The whole way from parameters to a file, read back by a reader of its own.
use super::*;
use crate::error::chain;
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES};
use lipstream_media::encode::{aac, colour};
use lipstream_media::sink::Sink as _;
use ndarray::Array2;
use rusty_h264_decoder::Decoder;

/// Content of the first box at `path` below `bytes`.
fn find<'a>(bytes: &'a [u8], path: &[&str]) -> Option<&'a [u8]> {
    let [name, below @ ..] = path else {
        return Some(bytes);
    };
    children(bytes)
        .into_iter()
        .find(|(n, _)| n == name)
        .and_then(|(_, content)| find(content, below))
}

/// Names and contents of the boxes that fill `bytes` exactly.
fn children(mut bytes: &[u8]) -> Vec<(String, &[u8])> {
    let mut out = Vec::new();
    while !bytes.is_empty() {
        let length = number(bytes, 0) as usize;
        assert!(length >= 8 && length <= bytes.len(), "box of {length} bytes");
        let name = String::from_utf8(bytes[4..8].to_vec()).unwrap();
        out.push((name, &bytes[8..length]));
        bytes = &bytes[length..];
    }
    out
}

fn number(bytes: &[u8], at: usize) -> u32 {
    u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap())
}

/// What a player learns of one track.
struct Read<'a> {
    scale: u32,
    duration: u32,
    /// Duration in movie units and first unit of media heard or seen.
    edit: (u32, u32),
    /// Units of a sample.
    units: u32,
    samples: Vec<&'a [u8]>,
    table: &'a [u8],
}

fn read<'a>(file: &'a [u8], track: &'a [u8]) -> Read<'a> {
    let media = find(track, &["mdia", "mdhd"]).unwrap();
    let edits = find(track, &["edts", "elst"]).unwrap();
    assert_eq!(number(edits, 4), 1, "one edit");
    let table = find(track, &["mdia", "minf", "stbl"]).unwrap();
    let stts = find(table, &["stts"]).unwrap();
    let stsc = find(table, &["stsc"]).unwrap();
    let stsz = find(table, &["stsz"]).unwrap();
    let stco = find(table, &["stco"]).unwrap();
    let count = number(stsz, 8) as usize;
    assert_eq!((number(stts, 4), number(stts, 8) as usize), (1, count));
    let mut samples = Vec::new();
    for chunk in 0..number(stco, 4) as usize {
        // The last run that starts at this chunk or before.
        let runs = number(stsc, 4) as usize;
        let run = (0..runs)
            .rfind(|r| number(stsc, 8 + 12 * r) as usize <= chunk + 1)
            .unwrap();
        let mut at = number(stco, 8 + 4 * chunk) as usize;
        for _ in 0..number(stsc, 8 + 12 * run + 4) {
            let length = number(stsz, 12 + 4 * samples.len()) as usize;
            samples.push(&file[at..at + length]);
            at += length;
        }
    }
    assert_eq!(samples.len(), count);
    Read {
        scale: number(media, 12),
        duration: number(media, 16),
        edit: (number(edits, 8), number(edits, 12)),
        units: number(stts, 12),
        samples,
        table,
    }
}

fn tone(samples: usize) -> Vec<i16> {
    (0..samples)
        .map(|i| ((i as f32 * 0.17).sin() * 8000.0) as i16)
        .collect()
}

/// How far the work is.
#[derive(Default)]
struct Seen(std::sync::Mutex<(usize, usize)>);

impl Progress for Seen {
    fn say(&self, _: &str) {}

    fn step(&self, _: &str, done: usize, all: usize) {
        *self.0.lock().unwrap() = (done, all);
    }
}

#[test]
fn the_file_holds_what_was_drawn_and_said_in_step() {
    let space = drawn::space(12);
    let sound = tone(34_567);
    let frames = (sound.len() - FRAME_SAMPLES) / HOP_SAMPLES + 1;
    let tracks = drawn::babble(&space, frames);
    let settings = Settings::default();
    let seen = Seen::default();
    let done = to_mp4(&space, tracks.view(), Some(&sound), &settings, &seen).unwrap();
    let pictures = 55;
    let seen = *seen.0.lock().unwrap();
    assert_eq!((done.pictures, seen), (pictures, (pictures, pictures)));
    let file = &done.mp4;

    let top: Vec<String> = children(file).into_iter().map(|(n, _)| n).collect();
    assert_eq!(top, ["ftyp", "moov", "mdat"]);
    let movie = find(file, &["moov"]).unwrap();
    let header = find(movie, &["mvhd"]).unwrap();
    let movie_scale = number(header, 12);
    let tracks_in: Vec<&[u8]> = children(movie)
        .into_iter()
        .filter(|(n, _)| n == "trak")
        .map(|(_, t)| t)
        .collect();
    assert_eq!(tracks_in.len(), 2);
    let (video, heard) = (read(file, tracks_in[0]), read(file, tracks_in[1]));

    // Lengths: pictures cover the sound and overhang by less than one picture.
    assert_eq!(video.samples.len(), pictures);
    assert_eq!(video.scale, 25 * video.units);
    assert_eq!(video.duration, pictures as u32 * video.units);
    let seen_s = f64::from(video.edit.0) / f64::from(movie_scale);
    let heard_s = f64::from(heard.edit.0) / f64::from(movie_scale);
    assert!((heard_s - sound.len() as f64 / 16_000.0).abs() < 1e-4);
    assert!(seen_s >= heard_s && seen_s < heard_s + 0.04);
    assert_eq!(number(header, 16), video.edit.0);

    // Step: picture 0 and sample 0 at time 0, the codec's priming taken off.
    assert_eq!((heard.scale, heard.units), (16_000, 1024));
    assert_eq!((video.edit.1, heard.edit.1), (0, 1024));
    assert!(heard.samples.len() * 1024 >= 1024 + sound.len());

    check_pictures(&space, &tracks, &settings, &video);
    check_sound(&sound, &heard);
}

/// Decoded, every picture is the one meant, 35 dB or better; key pictures are those listed.
fn check_pictures(space: &MouthSpace, tracks: &Array2<f32>, settings: &Settings, video: &Read) {
    let entry = &find(video.table, &["stsd"]).unwrap()[8..];
    let (name, content) = children(entry).remove(0);
    assert_eq!(name, "avc1");
    let (width, height) = settings.size(space).unwrap();
    assert_eq!(number(content, 24), (width << 16 | height) as u32);
    let sets = find(&content[78..], &["avcC"]).unwrap();
    let sps_length = usize::from(u16::from_be_bytes([sets[6], sets[7]]));
    let sps = &sets[8..8 + sps_length];
    let pps = &sets[8 + sps_length + 3..];
    assert_eq!(&sets[1..4], &sps[1..4]);

    let stss = find(video.table, &["stss"]).unwrap();
    let key: Vec<u32> = (0..number(stss, 4) as usize)
        .map(|k| number(stss, 8 + 4 * k))
        .collect();
    assert_eq!(key, [1, 26, 51]);

    let meant = at_pictures(tracks.view(), settings.fps, video.samples.len() * 640);
    assert_eq!(meant.nrows(), video.samples.len());
    let mut painter = Painter::new(space, settings).unwrap();
    let mut decoder = Decoder::new();
    for (n, sample) in video.samples.iter().enumerate() {
        let mut stream = Vec::new();
        for set in [sps, pps] {
            stream.extend([0, 0, 0, 1]);
            stream.extend(set);
        }
        let mut rest = *sample;
        while !rest.is_empty() {
            let length = number(rest, 0) as usize;
            stream.extend([0, 0, 0, 1]);
            stream.extend(&rest[4..4 + length]);
            rest = &rest[4 + length..];
        }
        let got = decoder.decode(&stream).unwrap().expect("a picture");
        let got = colour::to_rgb(&colour::Picture {
            width,
            height,
            y: got.y,
            cb: got.u,
            cr: got.v,
        });
        let want = painter.draw(meant.row(n)).unwrap();
        let error: f64 = got
            .iter()
            .zip(&want)
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
            .sum::<f64>()
            / want.len() as f64;
        let psnr = 10.0 * (255.0 * 255.0 / error).log10();
        assert!(psnr > 35.0, "picture {n}: {psnr:.1} dB");
    }
}

/// Decoded, the sound after the edit's start is the sound given.
fn check_sound(sound: &[i16], heard: &Read) {
    let mut adts = Vec::new();
    for unit in &heard.samples {
        adts.extend(aac::adts_header(unit.len()));
        adts.extend(*unit);
    }
    let back = syom::decode_with(&adts, &syom::DecodeOptions::unbounded()).unwrap();
    let (mut error, mut power) = (0.0, 0.0);
    for (i, &s) in sound.iter().enumerate() {
        let want = f64::from(s) / 32768.0;
        error += (f64::from(back.channels[0][i + heard.edit.1 as usize]) - want).powi(2);
        power += want * want;
    }
    assert!(10.0 * (power / error).log10() > 25.0);
}

#[test]
fn a_silent_film_has_one_track() {
    let space = drawn::space(6);
    let tracks = drawn::babble(&space, 100);
    let settings = Settings {
        fps: 50,
        scale: Some(1),
        noise: 2.0,
    };
    let done = to_mp4(&space, tracks.view(), None, &settings, &()).unwrap();
    assert_eq!((done.width, done.height), (64, 48));
    // 99 hops and a window: 1.015 s.
    assert_eq!(done.pictures, 51);
    let movie = find(&done.mp4, &["moov"]).unwrap();
    let n_tracks = children(movie).iter().filter(|(n, _)| n == "trak").count();
    assert_eq!(n_tracks, 1);
}

#[test]
fn what_cannot_be_drawn_is_refused_in_words() {
    let space = drawn::space(6);
    let said = |tracks: Array2<f32>| {
        let error = to_mp4(&space, tracks.view(), None, &Settings::default(), &())
            .err()
            .unwrap();
        chain(&error)
    };
    assert!(said(Array2::zeros((0, 6))).contains("no frame"));
    assert!(said(Array2::zeros((3, 5))).contains("another model"));
    let mut tracks = Array2::zeros((3, 6));
    tracks[[1, 2]] = f32::INFINITY;
    assert!(said(tracks).contains("parameter 2 of frame 1 is inf"));
}

#[test]
fn other_formats_need_ffmpeg_and_say_so() {
    let space = drawn::space(6);
    let tracks = drawn::babble(&space, 50);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mouth.gif");
    let settings = Settings {
        scale: Some(1),
        ..Settings::default()
    };
    let sound = tone(8000);
    let written = || -> Result<usize> {
        let mut scene = Painter::new(&space, &settings)?;
        let film = film(&scene, &settings, Some(Soundtrack::Samples(&sound)));
        let mut sink = Box::new(lipstream_media::sink::Ffmpeg::new(&path, &film)?);
        let pictures = play(
            &mut scene,
            tracks.view(),
            film.fps,
            Some(sound.len()),
            |rgb| sink.picture(rgb).map_err(Error::from),
            &(),
        )?;
        sink.finish()?;
        Ok(pictures)
    };
    match written() {
        Ok(pictures) => {
            assert_eq!(pictures, 13);
            assert!(std::fs::read(&path).unwrap().starts_with(b"GIF89a"));
        }
        Err(error) => {
            let line = chain(&error);
            assert!(line.contains("install it") && !line.contains('\n'), "{line}");
            assert!(!path.exists());
        }
    }
    // Nothing is left beside it.
    let left = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, usize::from(path.exists()));
}

/// A scene that notes what it is to draw.
struct Noted {
    width: usize,
    seen: Vec<f32>,
}

impl Scene for Noted {
    fn size(&self) -> (usize, usize) {
        (16, 16)
    }

    fn n_parameters(&self) -> usize {
        self.width
    }

    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        self.seen.extend(parameters);
        Ok(Vec::new())
    }
}

/// The parameters of each picture of a sound of so many samples.
fn at_pictures(tracks: ArrayView2<f32>, fps: u32, samples: usize) -> Array2<f32> {
    let mut scene = Noted {
        width: tracks.ncols(),
        seen: Vec::new(),
    };
    let count = play(
        &mut scene,
        tracks,
        fps,
        Some(samples),
        |_| Ok::<_, Error>(()),
        &(),
    )
    .unwrap();
    scene.seen.truncate(count * tracks.ncols());
    Array2::from_shape_vec((count, tracks.ncols()), scene.seen).unwrap()
}

#[test]
fn a_ramp_is_read_at_the_right_time() {
    // Parameter = the sample that the frame belongs to, so picture n must read 16000·(n + ½)/fps.
    let ramp = Array2::from_shape_fn((300, 1), |(t, _)| (160 * t + 200) as f32);
    for fps in [25, 30, 50] {
        let seen = at_pictures(ramp.view(), fps, 50 * 16_000 / fps as usize);
        for (n, value) in seen.column(0).iter().enumerate().skip(1) {
            let want = 16_000.0 * (n as f32 + 0.5) / fps as f32;
            assert!((value - want).abs() < 0.5, "{fps} {n}: {value} {want}");
        }
    }
}

#[test]
fn pictures_last_as_long_as_the_sound() {
    assert_eq!(picture_count(16_000, 25), 25);
    assert_eq!(picture_count(16_001, 25), 26);
    assert_eq!(time::samples_covered(1), 400);
    assert_eq!(time::samples_covered(98), 97 * 160 + 400);
}
