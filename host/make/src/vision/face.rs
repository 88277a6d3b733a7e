//! Where the face is, roughly: the SeetaFace detector (crate `rustface`), its model carried inside the program.

use crate::error::{Error, Result, bail};
use lipstream_media::video::Frames;

/// The detector's own model file, distributed with it; its licence is beside it.
const MODEL: &[u8] = include_bytes!("../../assets/face/seeta_fd_frontal_v1.0.bin");
/// Pictures are reduced below this many pixels a side before the search: a talking head fills much of its picture.
const SEARCH_SIDE: usize = 400;
/// The detector's window.
const LEAST_SIDE: usize = 40;

/// The square around a face, in pixels of the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FaceBox {
    pub left: f32,
    pub top: f32,
    pub side: f32,
}

/// Finds faces in single pictures.
pub(crate) struct Detector {
    inner: Box<dyn rustface::Detector>,
}

impl Detector {
    pub(crate) fn new() -> Result<Self> {
        let model = rustface::read_model(MODEL)
            .map_err(|e| Error::File(format!("the face model is damaged: {e}")))?;
        let mut inner = rustface::create_detector_with_model(model);
        inner.set_min_face_size(LEAST_SIDE as u32);
        inner.set_score_thresh(2.0);
        inner.set_pyramid_scale_factor(0.8);
        inner.set_slide_window_step(4, 4);
        Ok(Self { inner })
    }

    /// The largest face of one picture.
    pub(crate) fn find(&mut self, frames: &Frames, index: usize) -> Option<FaceBox> {
        self.find_all(frames, index).into_iter().next()
    }

    /// All faces of one picture, the largest first.
    pub(crate) fn find_all(&mut self, frames: &Frames, index: usize) -> Vec<FaceBox> {
        let factor = frames.width.max(frames.height).div_ceil(SEARCH_SIDE);
        let (width, height) = (frames.width / factor, frames.height / factor);
        if width < 2 * LEAST_SIDE || height < 2 * LEAST_SIDE {
            return Vec::new();
        }
        let grey = reduced_grey(frames.frame(index), frames.width, width, height, factor);
        let image = rustface::ImageData::new(&grey, width as u32, height as u32);
        let mut faces = self.inner.detect(&image);
        // Of faces of one size the one that was found last comes first.
        faces.reverse();
        faces.sort_by_key(|face| std::cmp::Reverse(face.bbox().width()));
        let scale = factor as f32;
        let in_picture = |face: &rustface::FaceInfo| FaceBox {
            left: face.bbox().x() as f32 * scale,
            top: face.bbox().y() as f32 * scale,
            side: face.bbox().width() as f32 * scale,
        };
        faces.iter().map(in_picture).collect()
    }

    /// The face of a clip: the median box over up to nine of its pictures.
    pub(crate) fn find_in_clip(&mut self, frames: &Frames) -> Result<FaceBox> {
        let count = frames.len();
        if count == 0 {
            bail!(Data, "there is no picture in it");
        }
        let looks = count.min(9);
        let boxes: Vec<FaceBox> = (0..looks)
            .filter_map(|i| self.find(frames, (2 * i + 1) * count / (2 * looks)))
            .collect();
        if 2 * boxes.len() < looks {
            bail!(
                Data,
                "no face found: the detector sees one in {} of {looks} pictures looked at \
                 (a face must look into the camera and be more than {LEAST_SIDE} pixels wide)",
                boxes.len()
            );
        }
        Ok(FaceBox {
            left: median(boxes.iter().map(|b| b.left)),
            top: median(boxes.iter().map(|b| b.top)),
            side: median(boxes.iter().map(|b| b.side)),
        })
    }
}

/// The middle value; of an even number, the upper middle.
pub(crate) fn median(values: impl Iterator<Item = f32>) -> f32 {
    let mut values: Vec<f32> = values.collect();
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Luminance (Rec. 601) averaged over `factor`×`factor` pixels.
fn reduced_grey(rgb: &[u8], source_width: usize, width: usize, height: usize, factor: usize) -> Vec<u8> {
    let mut grey = Vec::with_capacity(width * height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0u32;
            for dy in 0..factor {
                let row = ((y * factor + dy) * source_width + x * factor) * 3;
                for p in rgb[row..row + 3 * factor].chunks_exact(3) {
                    sum += 299 * u32::from(p[0]) + 587 * u32::from(p[1]) + 114 * u32::from(p[2]);
                }
            }
            grey.push((sum / (1000 * (factor * factor) as u32)) as u8);
        }
    }
    grey
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_without_a_face_has_none() {
        let frames = Frames {
            width: 200,
            height: 160,
            rate_hz: 25.0,
            rgb: vec![128; 200 * 160 * 3 * 2],
        };
        let error = Detector::new().unwrap().find_in_clip(&frames).unwrap_err();
        assert!(error.to_string().contains("no face found"), "{error}");
    }

    #[test]
    fn tiny_and_empty_pictures_are_no_panic() {
        let mut detector = Detector::new().unwrap();
        for (width, height, count) in [(1, 1, 1), (40, 40, 2), (79, 400, 1), (100, 100, 0)] {
            let frames = Frames {
                width,
                height,
                rate_hz: 25.0,
                rgb: vec![9; width * height * 3 * count],
            };
            assert!(detector.find_in_clip(&frames).is_err());
        }
    }

    #[test]
    fn reduction_averages() {
        // 4×2 grey pixels to 2×1.
        let rgb: Vec<u8> = [10u8, 20, 100, 100, 30, 40, 100, 104]
            .iter()
            .flat_map(|v| [*v; 3])
            .collect();
        assert_eq!(reduced_grey(&rgb, 4, 2, 1, 2), [25, 101]);
    }
}
