//! The eigenmouth space (X&L section 5, eq. 12-13): mean mouth image, eigenmouths, and both ways through them.
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

use crate::error::{Result, bail};
use crate::tensors::{Tensors, TensorsBuilder};

/// Mean and eigenmouths of colour images, rows of interleaved R, G, B in 0..255.
#[derive(Clone, Debug, PartialEq)]
pub struct MouthSpace {
    /// Width of an image in pixels.
    pub width: usize,
    /// Height of an image in pixels.
    pub height: usize,
    /// `[height·width·3]`, 0..255.
    pub mean: Array1<f32>,
    /// Orthonormal rows, `[D, height·width·3]`, largest variance first.
    pub basis: Array2<f32>,
    /// Standard deviation of every weight over the training images, `[D]`.
    pub deviation: Array1<f32>,
}

/// Weights that move a mouth in speech are about as large as those of the training images, over a whole sound; a shout's are not so many times as large.
const MOST_TIMES: f32 = 4.0;

/// Numbers of an image that are expanded at a time.
const BLOCK: usize = 512;

impl MouthSpace {
    /// How far parameters of this mouth mean the same in another one: the cosine between each eigenmouth and the other's of the same number, on average by variance. 1 where they are the
    /// same, about 0 for another person's, and 0 where their pictures or numbers differ in size.
    pub fn likeness(&self, other: &Self) -> f32 {
        if self.basis.dim() != other.basis.dim() || (self.width, self.height) != (other.width, other.height) {
            return 0.0;
        }
        let length = |row: ArrayView1<f32>| row.dot(&row).sqrt();
        let (mut sum, mut all) = (0.0, 0.0);
        for ((a, b), deviation) in self
            .basis
            .outer_iter()
            .zip(other.basis.outer_iter())
            .zip(&self.deviation)
        {
            let lengths = length(a) * length(b);
            let variance = deviation * deviation;
            all += variance;
            if lengths > 0.0 {
                sum += variance * a.dot(&b) / lengths;
            }
        }
        if all > 0.0 { sum / all } else { 0.0 }
    }

    /// How many times as large as over the training images weights `[frames, D]` are (roots of mean squares), where that is far more than any speech asks for: such
    /// weights are in another unit or of another mouth. None where it is not, or where they are not D a frame.
    pub fn beyond(&self, weights: ArrayView2<f32>) -> Option<f32> {
        if weights.is_empty() || weights.ncols() != self.size() {
            return None;
        }
        let mean = |sum: f64| sum / weights.nrows() as f64;
        let square = |v: &f32| f64::from(*v).powi(2);
        let have = mean(weights.iter().map(square).sum());
        let usual: f64 = self.deviation.iter().map(square).sum();
        let times = (have / usual.max(f64::from(f32::MIN_POSITIVE))).sqrt() as f32;
        (times > MOST_TIMES).then_some(times)
    }

    /// Weights g = Ãᵀ(I − Ī) of one image (eq. 13).
    pub fn project(&self, image: ArrayView1<f32>) -> Array1<f32> {
        self.basis.dot(&(&image - &self.mean))
    }

    /// Weights of all images of a clip, `[n, D]`, from `[n, height, width, 3]` bytes.
    ///
    /// Without their mean over the clip (`remove_mean`, the default of `prepare`): what stays the same for a whole clip is light
    /// and stubble, not speech, and [`MouthSpace::expand`] then puts the mouth on the speaker's own mean.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): the bytes are no whole number of images of this size.
    pub fn project_clip(&self, images: &[u8], remove_mean: bool) -> Result<Array2<f32>> {
        let pixels = self.mean.len();
        if pixels == 0 || !images.len().is_multiple_of(pixels) {
            bail!(
                Data,
                "{} bytes are no mouth images of {}×{}",
                images.len(),
                self.width,
                self.height
            );
        }
        let mut rows = Array2::from_shape_fn((images.len() / pixels, pixels), |(n, p)| {
            f32::from(images[n * pixels + p]) - self.mean[p]
        })
        .dot(&self.basis.t());
        if remove_mean && let Some(mean) = rows.mean_axis(Axis(0)) {
            rows -= &mean;
        }
        Ok(rows)
    }

    /// Image Ī + Ã g (eq. 12), not clipped to 0..255.
    pub fn expand(&self, weights: ArrayView1<f32>) -> Array1<f32> {
        &self.mean + &self.basis.t().dot(&weights)
    }

    /// [`MouthSpace::expand`] into numbers that are there already, for those who draw many pictures: faster, and not in the same order, so
    /// that the last bits differ. What is measured or exported is computed by `expand`.
    pub fn expand_into(&self, weights: ArrayView1<f32>, image: &mut [f32]) {
        let (Some(mean), Some(basis)) = (self.mean.as_slice(), self.basis.as_slice()) else {
            // Rows that do not lie one after the other.
            return image.copy_from_slice(&self.expand(weights).to_vec());
        };
        let weights = weights.to_vec();
        let (fours, rest) = weights.as_chunks::<4>();
        // Pixels by the hundred, which stay in the fastest memory while the eigenmouths pass.
        for (start, image) in (0..).step_by(BLOCK).zip(image.chunks_mut(BLOCK)) {
            let length = image.len();
            let of = |row: usize| &basis[row * mean.len() + start..][..length];
            image.copy_from_slice(&mean[start..start + length]);
            for (k, [a, b, c, d]) in fours.iter().enumerate() {
                let rows = [of(4 * k), of(4 * k + 1), of(4 * k + 2), of(4 * k + 3)];
                for (i, value) in image.iter_mut().enumerate() {
                    *value += (a * rows[0][i] + b * rows[1][i]) + (c * rows[2][i] + d * rows[3][i]);
                }
            }
            for (k, weight) in rest.iter().enumerate() {
                let row = of(4 * fours.len() + k);
                for (value, level) in image.iter_mut().zip(row) {
                    *value += weight * level;
                }
            }
        }
    }

    /// Number of eigenmouths D.
    pub fn size(&self) -> usize {
        self.basis.nrows()
    }

    /// Puts the space into a file, under names that begin with `mouth.`.
    pub fn store(&self, to: &mut TensorsBuilder) {
        to.put("mouth.mean", &self.mean);
        to.put("mouth.basis", &self.basis);
        to.put("mouth.deviation", &self.deviation);
        to.note("mouth.width", self.width);
        to.note("mouth.height", self.height);
    }

    /// What a page draws with (`mouth.js` of `lipstream view` reads it): the length of a JSON text in four bytes, low first, that text (width, height, size,
    /// deviations), zeros up to a multiple of four, then mean and eigenmouths as `f32`.
    pub fn to_bytes(&self) -> Vec<u8> {
        let about = serde_json::json!({
            "width": self.width,
            "height": self.height,
            "size": self.size(),
            "deviation": self.deviation.to_vec(),
        })
        .to_string();
        let mut bytes = (about.len() as u32).to_le_bytes().to_vec();
        bytes.extend(about.as_bytes());
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        for value in self.mean.iter().chain(&self.basis) {
            bytes.extend(value.to_le_bytes());
        }
        bytes
    }

    /// The space in a file that has been read.
    ///
    /// # Errors
    ///
    /// That a note or an array is missing, or that they do not fit each other.
    pub fn load(from: &Tensors) -> Result<Self> {
        let space = MouthSpace {
            width: from.noted("mouth.width")?,
            height: from.noted("mouth.height")?,
            mean: from.array("mouth.mean")?,
            basis: from.array("mouth.basis")?,
            deviation: from.array("mouth.deviation")?,
        };
        let pixels = space.width.saturating_mul(space.height).saturating_mul(3);
        if pixels == 0
            || space.mean.len() != pixels
            || space.basis.ncols() != pixels
            || space.deviation.len() != space.basis.nrows()
        {
            bail!(
                File,
                "the mouth tensors do not fit a {}×{} image",
                space.width,
                space.height
            );
        }
        Ok(space)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::drawn;

    #[test]
    fn likeness_tells_whose_parameters_they_are() {
        let space = drawn::space(4);
        assert!((space.likeness(&space) - 1.0).abs() < 1e-5);
        let mut turned = space.clone();
        turned.basis.mapv_inplace(|v| -v);
        assert!((space.likeness(&turned) + 1.0).abs() < 1e-5);
        let mut swapped = space.clone();
        for (k, row) in space.basis.outer_iter().rev().enumerate() {
            swapped.basis.row_mut(k).assign(&row);
        }
        assert!(space.likeness(&swapped).abs() < 0.01);
        assert_eq!(space.likeness(&drawn::space(3)), 0.0);
    }

    #[test]
    fn weights_of_another_unit_are_told() {
        let space = drawn::space(6);
        let usual = Array2::from_shape_fn((40, 6), |(t, k)| {
            space.deviation[k] * 1.4 * (t as f32 * 0.7 + k as f32).sin()
        });
        assert_eq!(space.beyond(usual.view()), None);
        assert_eq!(space.beyond((&usual * 3.0).view()), None);
        let times = space.beyond((&usual * 50.0).view()).unwrap();
        assert!((45.0..55.0).contains(&times), "{times}");
        assert_eq!(space.beyond(Array2::from_elem((4, 5), 1e9).view()), None);
    }

    #[test]
    fn both_ways_to_an_image_agree() {
        for size in [2, 4, 7, 30] {
            let space = drawn::space(size);
            let weights = Array1::from_shape_fn(space.size(), |k| 40.0 * (k as f32 * 1.7).sin());
            let want = space.expand(weights.view());
            // A basis that does not lie row after row as well.
            let turned = MouthSpace {
                basis: space.basis.t().as_standard_layout().into_owned().reversed_axes(),
                ..space.clone()
            };
            assert!(turned.basis.as_slice().is_none());
            for space in [space, turned] {
                let mut image = vec![f32::NAN; want.len()];
                space.expand_into(weights.view(), &mut image);
                for (have, want) in image.iter().zip(&want) {
                    assert!((have - want).abs() < 1e-3, "{size}: {have} {want}");
                }
            }
        }
    }
}
