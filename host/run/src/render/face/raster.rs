//! Pictures to sample from.

/// Rows of interleaved R, G, B, in levels of 0..255, sampled between pixels whose centres lie at whole numbers.
#[derive(Clone, Copy)]
pub struct Raster<'a, Level> {
    /// `[height, width, 3]`.
    pub rgb: &'a [Level],
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// A picture of bytes.
pub type Bytes<'a> = Raster<'a, u8>;
/// A picture of floats.
pub type Floats<'a> = Raster<'a, f32>;

impl<Level: Copy + Into<f32>> Raster<'_, Level> {
    /// The pixel at a place inside.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        let at = 3 * (y * self.width + x);
        std::array::from_fn(|c| self.rgb[at + c].into())
    }

    /// Bilinear, the nearest border outside.
    pub fn sample(&self, x: f32, y: f32) -> [f32; 3] {
        let (width, height) = (self.width, self.height);
        let x = x.clamp(0.0, (width - 1) as f32);
        let y = y.clamp(0.0, (height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
        let (u, v) = (x - left as f32, y - top as f32);
        let [a, b] = [self.pixel(left, top), self.pixel(right, top)];
        let [c, d] = [self.pixel(left, bottom), self.pixel(right, bottom)];
        std::array::from_fn(|k| {
            let (above, below) = (a[k] + u * (b[k] - a[k]), c[k] + u * (d[k] - c[k]));
            above + v * (below - above)
        })
    }

    /// Catmull-Rom's cubic, the nearest border outside: keeps the sharpness that bilinear sampling loses.
    pub fn sample_cubic(&self, x: f32, y: f32) -> [f32; 3] {
        let (width, height) = (self.width, self.height);
        let (left, top) = (x.floor(), y.floor());
        let (across, down) = (catmull_rom(x - left), catmull_rom(y - top));
        let place =
            |at: f32, k: usize, most: usize| (at as i64 + k as i64 - 1).clamp(0, most as i64 - 1) as usize;
        let mut sum = [0.0f32; 3];
        for (j, v) in down.iter().enumerate() {
            let row = place(top, j, height);
            for (i, u) in across.iter().enumerate() {
                let pixel = self.pixel(place(left, i, width), row);
                for c in 0..3 {
                    sum[c] += u * v * pixel[c];
                }
            }
        }
        sum
    }
}

/// Weights of the four neighbours of a place `t` behind the second.
fn catmull_rom(t: f32) -> [f32; 4] {
    [
        0.5 * (-t + 2.0 * t * t - t * t * t),
        0.5 * (2.0 - 5.0 * t * t + 3.0 * t * t * t),
        0.5 * (t + 4.0 * t * t - 3.0 * t * t * t),
        0.5 * (t * t * t - t * t),
    ]
}

/// Where pixel `at` of a picture that is `sharp` times as fine lies, in pixels of the coarse one.
pub(super) fn coarse_at(at: usize, sharp: usize) -> f32 {
    (at as f32 + 0.5) / sharp as f32 - 0.5
}

/// How light a pixel is (ITU-R BT.601).
pub(super) fn luminance([r, g, b]: [f32; 3]) -> f32 {
    0.299 * r + 0.587 * g + 0.114 * b
}

/// Mean and standard deviation.
pub(super) fn spread(values: impl Iterator<Item = f32> + Clone) -> (f32, f32) {
    let n = (values.clone().count() as f32).max(1.0);
    let mean = values.clone().sum::<f32>() / n;
    (mean, (values.map(|v| (v - mean).powi(2)).sum::<f32>() / n).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_keeps_planes_and_pixels() {
        let rgb: Vec<u8> = (0..12 * 10)
            .map(|at| (at % 12, at / 12))
            .flat_map(|(x, y)| [(10 * x + 3 * y) as u8, 7, (x * x) as u8])
            .collect();
        let bytes = Bytes {
            rgb: &rgb,
            width: 12,
            height: 10,
        };
        for (x, y) in [(3.0, 4.0), (5.25, 4.5), (8.9, 7.3)] {
            let [plane, flat, _] = bytes.sample_cubic(x, y);
            assert!((plane - 10.0 * x - 3.0 * y).abs() < 1e-3 && (flat - 7.0).abs() < 1e-4);
        }
        assert!((bytes.sample_cubic(4.0, 5.0)[2] - 16.0).abs() < 1e-4);
        // A parabola is kept too: bilinear sampling would say 30.5.
        assert!((bytes.sample_cubic(5.5, 5.0)[2] - 30.25).abs() < 0.01);
    }
}
