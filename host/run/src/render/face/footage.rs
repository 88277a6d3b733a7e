//! A recording of somebody as a background: its pictures, and where the face's parts lie in each.
//!
//! Pictures wait in an unnamed file, so that memory does not grow with the recording.
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom, Write as _};

use super::raster::Bytes;
use crate::affine::Affine;
use crate::error::{Context as _, Result, bail};

/// Pictures of one size in an unnamed file.
#[derive(Debug)]
pub struct Pictures {
    file: File,
    width: usize,
    height: usize,
    count: usize,
}

impl Pictures {
    /// None so far, of `width` × `height` pixels; they will lie in the folder for temporary files.
    ///
    /// # Errors
    ///
    /// That no file can be made there.
    pub fn new(width: usize, height: usize) -> Result<Self> {
        let file = tempfile::tempfile()
            .context("there is no room for a background's pictures among temporary files")?;
        Ok(Self {
            file,
            width,
            height,
            count: 0,
        })
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Adds one, `[height, width, 3]`.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): it has another size; and that the disk is full.
    pub fn push(&mut self, rgb: &[u8]) -> Result<()> {
        if rgb.len() != self.width * self.height * 3 {
            bail!(
                Data,
                "a picture of {} bytes among pictures of {}×{}",
                rgb.len(),
                self.width,
                self.height
            );
        }
        self.file
            .seek(SeekFrom::End(0))
            .and_then(|_| self.file.write_all(rgb))
            .context("cannot keep a background's pictures")?;
        self.count += 1;
        Ok(())
    }

    /// Reads one into `rgb`, `[height, width, 3]`, and gives it to sample from.
    ///
    /// # Errors
    ///
    /// That there is none of this number, or the file cannot be read.
    pub fn read<'r>(&mut self, index: usize, rgb: &'r mut Vec<u8>) -> Result<Bytes<'r>> {
        if index >= self.count {
            bail!(
                Data,
                "the background has {} pictures, none of number {index}",
                self.count
            );
        }
        let size = self.width * self.height * 3;
        rgb.resize(size, 0);
        self.file
            .seek(SeekFrom::Start((index * size) as u64))
            .and_then(|_| self.file.read_exact(rgb))
            .context("cannot read a background's picture back")?;
        Ok(Bytes {
            rgb,
            width: self.width,
            height: self.height,
        })
    }
}

/// The face in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// From pixels of the mouth's rectangle to the picture's.
    pub mouth: Affine,
    /// How far the jaw hangs, from the nose's base to the chin, over the distance between the eyes; None where no landmarks are seen.
    pub jaw: Option<f32>,
    /// How far the head is turned to the side: where the nose's base lies between the eyes' outer corners, -1..1 from one to the other; 0 where no landmarks
    /// are seen.
    pub turned: f32,
    /// Gap between the inner lips and distance of the lips' corners, over the distance between the eyes; None where no landmarks are seen.
    pub lips: Option<(f32, f32)>,
    /// Where the face ends; None where no landmarks are seen.
    pub edge: Option<Edge>,
}

/// Points of a face's edge in pixels of the mouth's rectangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// At the height of the lips, left in the picture.
    pub left: (f32, f32),
    /// The same on the right.
    pub right: (f32, f32),
    /// The tip of the chin.
    pub chin: (f32, f32),
}

impl Edge {
    /// Left and right edge in a row: from the lips to the chin the face narrows as a parabola does.
    fn at(&self, y: f32) -> (f32, f32) {
        let lips = 0.5 * (self.left.1 + self.right.1);
        let down = ((y - lips) / (self.chin.1 - lips).max(1.0)).clamp(0.0, 1.0);
        let towards_chin = |x: f32| x + NARROWS * down * down * (self.chin.0 - x);
        (towards_chin(self.left.0), towards_chin(self.right.0))
    }
}

impl Place {
    /// How much a place of the mouth's rectangle belongs to the face, 0..=1: what lies beyond its edge is hair, or the wall.
    pub fn on_face(&self, x: f32, y: f32) -> f32 {
        let Some(edge) = &self.edge else { return 1.0 };
        let (left, right) = edge.at(y);
        let soft = EDGE * (edge.right.0 - edge.left.0);
        ((x - left) / soft).min((right - x) / soft).clamp(0.0, 1.0)
    }
}

/// At the chin a face is narrower by this share than at the lips.
const NARROWS: f32 = 0.55;
/// Landmarks of the edge tremble, and near it a cheek turns away: so much of the face's width is no longer wholly on it.
const EDGE: f32 = 0.08;

/// Where the jaw's outline runs, in pixels of the mouth's rectangle, over the whole recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaw {
    /// Left and right edge of the face at the height of the lips.
    pub sides: (f32, f32),
    /// Height of the nose's base, where the jaw's region begins.
    pub top: f32,
    /// The lowest that the chin comes.
    pub bottom: f32,
}

/// A recording whose face has been found in every picture.
#[derive(Debug)]
pub struct Footage {
    /// The pictures, as recorded.
    pub pictures: Pictures,
    /// Pictures a second.
    pub rate_hz: f32,
    /// Width and height of the mouth's rectangle, in its own pixels.
    pub mouth: (usize, usize),
    /// `[pictures]`.
    pub places: Vec<Place>,
    /// None where no landmarks are seen.
    pub jaw: Option<Jaw>,
}

impl Footage {
    /// Pixels of the picture for one of the mouth's rectangle, in the middle of all pictures.
    pub fn scale(&self) -> f32 {
        let mut scales: Vec<f32> = self
            .places
            .iter()
            .map(|place| {
                let [a, b, _, d, e, _] = place.mouth.0;
                (a * e - b * d).abs().sqrt()
            })
            .collect();
        scales.sort_by(f32::total_cmp);
        scales.get(scales.len() / 2).copied().unwrap_or(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_narrows_towards_the_chin() {
        let edge = Edge {
            left: (-20.0, 20.0),
            right: (80.0, 20.0),
            chin: (30.0, 60.0),
        };
        assert_eq!(edge.at(0.0), (-20.0, 80.0));
        assert_eq!(edge.at(60.0), edge.at(90.0));
        let place = Place {
            mouth: Affine::IDENTITY,
            jaw: None,
            turned: 0.0,
            lips: None,
            edge: Some(edge),
        };
        for (x, y, share) in [
            (30.0, 60.0, 1.0),
            (-14.0, 20.0, 0.75),
            (-14.0, 60.0, 0.0),
            (85.0, 10.0, 0.0),
        ] {
            assert_eq!(place.on_face(x, y), share, "{x} {y}");
        }
    }

    #[test]
    fn pictures_come_back_in_any_order() {
        let mut pictures = Pictures::new(4, 2).unwrap();
        for level in 0..5u8 {
            pictures.push(&[level; 24]).unwrap();
        }
        let mut rgb = Vec::new();
        for index in [3, 0, 4, 4, 1] {
            pictures.read(index, &mut rgb).unwrap();
            assert_eq!(rgb, [index as u8; 24]);
        }
        pictures.push(&[9; 24]).unwrap();
        pictures.read(5, &mut rgb).unwrap();
        assert_eq!(rgb, [9; 24]);
        assert!(pictures.push(&[0; 23]).is_err() && pictures.read(6, &mut rgb).is_err());
    }
}
