//! A clip's own film with what was found drawn on it: the mouth's rectangle, the lips' outline and their corners.
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::vision::MouthTrack;
use lipstream_media::sink::{Film, Mp4, Sink, Soundtrack};
use lipstream_media::video::Frames;

/// The rectangle; the same where the face was lost and the place is a guess; the lips; their corners.
const RECTANGLE: [u8; 3] = [255, 255, 255];
const GUESSED: [u8; 3] = [230, 30, 30];
const LIPS: [u8; 3] = [60, 230, 80];
const CORNERS: [u8; 3] = [255, 210, 0];
/// Pixels on either side of a corner that are drawn over.
const CORNER: i64 = 1;

/// The film of clip `id`.
pub(super) fn path(out: &Path, id: &str) -> PathBuf {
    out.join("overlay").join(format!("{id}.mp4"))
}

/// Writes the film, in the video's size (an odd last column or row is left out) and time.
///
/// # Errors
///
/// What the encoder or the disk says.
pub(super) fn write(path: &Path, frames: &Frames, track: &MouthTrack, sound: &Path) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let fps = frames.rate_hz.round().max(1.0) as u32;
    let film = Film {
        width: frames.width & !1,
        height: frames.height & !1,
        fps,
        sound: Some(Soundtrack::File(sound)),
        comment: None,
    };
    let mut sink = Box::new(Mp4::new(path, &film).map_err(Error::other)?);
    // A film has whole pictures a second: where the video has not, each moment shows the picture that was there.
    let shown = (frames.len() as f32 / frames.rate_hz * fps as f32).round() as usize;
    for n in 0..shown.max(1) {
        let at = (n as f32 + 0.5) / fps as f32 * frames.rate_hz;
        let index = (at as usize).min(frames.len() - 1);
        let mut picture = Picture::of(frames, index, film.width, film.height);
        picture.draw(track, index);
        sink.picture(&picture.rgb).map_err(Error::other)?;
    }
    sink.finish().map_err(Error::other)
}

/// A picture that is drawn on.
struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture {
    fn of(frames: &Frames, index: usize, width: usize, height: usize) -> Self {
        let rows = frames.frame(index).chunks_exact(3 * frames.width).take(height);
        Self {
            width,
            height,
            rgb: rows.flat_map(|row| &row[..3 * width]).copied().collect(),
        }
    }

    fn draw(&mut self, track: &MouthTrack, index: usize) {
        let (right, bottom) = ((track.width - 1) as f32, (track.height - 1) as f32);
        let corners = [(0.0, 0.0), (right, 0.0), (right, bottom), (0.0, bottom)];
        let corners = corners.map(|(x, y)| track.transforms[index].apply(x, y));
        let colour = match track.is_lost(index) {
            true => GUESSED,
            false => RECTANGLE,
        };
        self.around(&corners, colour);
        if let Some(Some(outline)) = track.outlines.get(index) {
            self.around(outline, LIPS);
            for (x, y) in [outline[0], outline[outline.len() / 2]] {
                for (dx, dy) in (-CORNER..=CORNER).flat_map(|dx| (-CORNER..=CORNER).map(move |dy| (dx, dy))) {
                    self.put(x.round() as i64 + dx, y.round() as i64 + dy, CORNERS);
                }
            }
        }
    }

    /// A line through points and back to the first.
    fn around(&mut self, points: &[(f32, f32)], colour: [u8; 3]) {
        for (from, to) in points.iter().zip(points.iter().cycle().skip(1)) {
            let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).ceil().max(1.0);
            for step in 0..=steps as usize {
                let share = step as f32 / steps;
                let x = from.0 + share * (to.0 - from.0);
                let y = from.1 + share * (to.1 - from.1);
                self.put(x.round() as i64, y.round() as i64, colour);
            }
        }
    }

    fn put(&mut self, x: i64, y: i64, colour: [u8; 3]) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else {
            return;
        };
        if x < self.width && y < self.height {
            self.rgb[3 * (y * self.width + x)..][..3].copy_from_slice(&colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vision::ChannelMap;
    use lipstream::affine::Affine;
    use lipstream_media::video;

    /// 12 grey pictures of 65 × 48 at 12.5 a second with a mouth of 16 × 12 at (20, 18), in which the lips move to the right.
    fn clip() -> (Frames, MouthTrack) {
        let frames = Frames {
            width: 65,
            height: 48,
            rate_hz: 12.5,
            rgb: vec![100; 12 * 65 * 48 * 3],
        };
        let outline = |n: usize| {
            std::array::from_fn(|k| {
                let turn = std::f32::consts::TAU * k as f32 / 20.0;
                (28.0 + 0.2 * n as f32 - 5.0 * turn.cos(), 24.0 - 2.0 * turn.sin())
            })
        };
        let track = MouthTrack {
            width: 16,
            height: 12,
            images: Vec::new(),
            transforms: vec![Affine::scaled(1.0, 20.0, 18.0); 12],
            scores: (0..12).map(|n| if n == 7 { 0.1 } else { 0.9 }).collect(),
            colour: [ChannelMap::IDENTITY; 3],
            rate_hz: 12.5,
            lips: None,
            outlines: (0..12).map(|n| (n != 3).then(|| outline(n))).collect(),
        };
        (frames, track)
    }

    #[test]
    fn rectangle_lips_and_corners_are_drawn() {
        let (frames, track) = clip();
        let drawn = |index: usize| {
            let mut picture = Picture::of(&frames, index, 64, 48);
            picture.draw(&track, index);
            move |x: usize, y: usize| -> [u8; 3] { picture.rgb[3 * (y * 64 + x)..][..3].try_into().unwrap() }
        };
        let first = drawn(0);
        for (x, y) in [(20, 18), (35, 18), (35, 29), (20, 29), (27, 18), (20, 23)] {
            assert_eq!(first(x, y), RECTANGLE, "{x} {y}");
        }
        assert_eq!((first(23, 24), first(33, 24)), (CORNERS, CORNERS));
        assert_eq!((first(28, 22), first(28, 26)), (LIPS, LIPS));
        assert_eq!((first(28, 24), first(10, 10)), ([100; 3], [100; 3]));
        // No lips are drawn where none were seen, and a guessed place looks otherwise.
        assert_eq!(drawn(3)(23, 24), [100; 3]);
        assert_eq!(drawn(7)(20, 18), GUESSED);
    }

    #[test]
    fn what_lies_outside_is_not_drawn() {
        let (frames, mut track) = clip();
        track.transforms[0] = Affine::scaled(1.0, -5.0, 40.0);
        let mut picture = Picture::of(&frames, 0, 64, 48);
        picture.draw(&track, 0);
        assert_eq!(picture.rgb[3 * (40 * 64 + 10)..][..3], RECTANGLE);
    }

    /// Needs no other program to write; reading it back does.
    #[test]
    fn the_film_is_as_long_as_the_clip() {
        let (frames, track) = clip();
        let folder = tempfile::tempdir().unwrap();
        let sound = folder.path().join("a.wav");
        lipstream_media::sound::write(&sound, &vec![500; 15_360]).unwrap();
        let film = path(folder.path(), "a");
        write(&film, &frames, &track, &sound).unwrap();
        if video::available().is_ok() {
            let back = video::decode(&film).unwrap();
            assert_eq!((back.width, back.height, back.rate_hz), (64, 48, 13.0));
            // 0.96 s.
            assert_eq!(back.len(), 12);
            let at = |x: usize, y: usize| back.frame(0)[3 * (y * 64 + x) + 1];
            assert!(
                at(27, 18) > 150 && at(10, 10) < 130,
                "{} {}",
                at(27, 18),
                at(10, 10)
            );
        }
    }
}
