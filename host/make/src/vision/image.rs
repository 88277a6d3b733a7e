//! Single-channel images in floats: reduction, smoothing, pyramids, sampling between pixels.
use lipstream_media::video::Frames;

/// `[height, width]`, row by row.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Plane {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            data: vec![0.0; width * height],
        }
    }

    pub(crate) fn from_fn(width: usize, height: usize, mut f: impl FnMut(usize, usize) -> f32) -> Self {
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend((0..width).map(|x| f(x, y)));
        }
        Self { width, height, data }
    }

    /// The value at a pixel; outside, that of the nearest pixel.
    pub(crate) fn at(&self, x: i32, y: i32) -> f32 {
        let x = x.clamp(0, self.width as i32 - 1) as usize;
        let y = y.clamp(0, self.height as i32 - 1) as usize;
        self.data[y * self.width + x]
    }

    /// Bilinear value between pixels; outside, that of the nearest border.
    pub(crate) fn sample(&self, x: f32, y: f32) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let (row0, row1) = (y0 * self.width, y1 * self.width);
        let top = self.data[row0 + x0] + fx * (self.data[row0 + x1] - self.data[row0 + x0]);
        let bottom = self.data[row1 + x0] + fx * (self.data[row1 + x1] - self.data[row1 + x0]);
        top + fy * (bottom - top)
    }

    /// Half the size, each pixel the mean of four.
    pub(crate) fn half(&self) -> Plane {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        Plane::from_fn(width, height, |x, y| {
            let (x, y) = (2 * x as i32, 2 * y as i32);
            0.25 * (self.at(x, y) + self.at(x + 1, y) + self.at(x, y + 1) + self.at(x + 1, y + 1))
        })
    }

    /// Three passes of a running mean over 2·`radius`+1 pixels: nearly a Gaussian of that radius's standard deviation.
    pub(crate) fn smoothed(&self, radius: usize) -> Plane {
        let mut plane = self.clone();
        let mut line = Vec::new();
        for _ in 0..3 {
            for row in plane.data.chunks_exact_mut(self.width) {
                line.clear();
                line.extend_from_slice(row);
                running_mean(&line, radius, |i, v| row[i] = v);
            }
        }
        for _ in 0..3 {
            for x in 0..self.width {
                line.clear();
                line.extend((0..self.height).map(|y| plane.data[y * self.width + x]));
                running_mean(&line, radius, |y, v| plane.data[y * self.width + x] = v);
            }
        }
        plane
    }

    /// What is left when everything coarser than `radius` is taken away: shading and exposure go, edges stay.
    pub(crate) fn without_shading(&self, radius: usize) -> Plane {
        let mut plane = self.smoothed(radius);
        for (coarse, value) in plane.data.iter_mut().zip(&self.data) {
            *coarse = value - *coarse;
        }
        plane
    }

    /// Central differences, (∂/∂x, ∂/∂y), per pixel.
    pub(crate) fn gradient(&self, x: usize, y: usize) -> (f32, f32) {
        let (x, y) = (x as i32, y as i32);
        (
            0.5 * (self.at(x + 1, y) - self.at(x - 1, y)),
            0.5 * (self.at(x, y + 1) - self.at(x, y - 1)),
        )
    }
}

/// Means over `line[i-radius..=i+radius]`, the line's ends repeated outside.
fn running_mean(line: &[f32], radius: usize, mut put: impl FnMut(usize, f32)) {
    let last = line.len() - 1;
    let at = |i: isize| line[i.clamp(0, last as isize) as usize];
    let reach = radius as isize;
    let mut sum: f32 = (-reach..=reach).map(at).sum();
    let scale = 1.0 / (2 * radius + 1) as f32;
    for i in 0..line.len() {
        put(i, sum * scale);
        sum += at(i as isize + reach + 1) - at(i as isize - reach);
    }
}

/// The image and its halves; level l's pixel x lies at 2ˡ(x + ½) − ½ of the image.
#[derive(Clone)]
pub(crate) struct Pyramid {
    pub levels: Vec<Plane>,
}

impl Pyramid {
    pub(crate) fn new(image: Plane, levels: usize) -> Self {
        let mut planes = vec![image];
        while planes.len() < levels {
            planes.push(planes[planes.len() - 1].half());
        }
        Self { levels: planes }
    }

    /// The level whose pixels are about `spacing` pixels of the image apart, and how many of them exactly.
    pub(crate) fn at_spacing(&self, spacing: f32) -> (&Plane, f32) {
        let level = (spacing.max(1.0).log2().round() as usize).min(self.levels.len() - 1);
        (&self.levels[level], (1u32 << level) as f32)
    }
}

/// One picture, reduced `factor` times by averaging: its three colours, 0..255.
pub(crate) fn colour_planes(frames: &Frames, index: usize, factor: usize) -> [Plane; 3] {
    let (width, height) = (frames.width / factor, frames.height / factor);
    let rgb = frames.frame(index);
    let scale = 1.0 / (factor * factor) as f32;
    std::array::from_fn(|channel| {
        Plane::from_fn(width, height, |x, y| {
            let mut sum = 0u32;
            for dy in 0..factor {
                let row = ((y * factor + dy) * frames.width + x * factor) * 3 + channel;
                sum += (0..factor).map(|dx| u32::from(rgb[row + 3 * dx])).sum::<u32>();
            }
            sum as f32 * scale
        })
    })
}

/// Luminance, Rec. 601.
pub(crate) fn luminance(planes: &[Plane; 3]) -> Plane {
    let [r, g, b] = planes;
    let data = r
        .data
        .iter()
        .zip(&g.data)
        .zip(&b.data)
        .map(|((r, g), b)| 0.299 * r + 0.587 * g + 0.114 * b)
        .collect();
    Plane {
        width: r.width,
        height: r.height,
        data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sampling_a_ramp_is_exact_and_clamped() {
        let ramp = Plane::from_fn(8, 6, |x, y| 2.0 * x as f32 + 10.0 * y as f32);
        assert_eq!(ramp.sample(3.25, 2.5), 6.5 + 25.0);
        assert_eq!(ramp.sample(-9.0, -9.0), 0.0);
        assert_eq!(ramp.sample(99.0, 99.0), 64.0);
        assert_eq!(ramp.gradient(3, 3), (2.0, 10.0));
        // Level 1's pixel (1, 1) lies at (2.5, 2.5).
        assert_eq!(ramp.half().at(1, 1), ramp.sample(2.5, 2.5));
    }

    #[test]
    fn smoothing_keeps_a_constant_and_spreads_an_impulse_as_a_gaussian() {
        let flat = Plane::from_fn(9, 7, |_, _| 3.0);
        assert!(flat.smoothed(2).data.iter().all(|v| (v - 3.0).abs() < 1e-5));
        let mut dot = Plane::new(41, 41);
        dot.data[20 * 41 + 20] = 1.0;
        let spread = dot.smoothed(2);
        let variance: f32 = (0..41)
            .flat_map(|y| (0..41).map(move |x| (x, y)))
            .map(|(x, y)| spread.at(x, y) * (x as f32 - 20.0).powi(2))
            .sum();
        // Three uniform windows of five: variance 3·(25 − 1)/12.
        assert!((variance - 6.0).abs() < 1e-3, "{variance}");
    }

    #[test]
    fn colours_are_reduced_by_averaging() {
        let frames = Frames {
            width: 4,
            height: 2,
            rate_hz: 25.0,
            rgb: (0..24).map(|i| i * 10).collect(),
        };
        let [r, _, b] = colour_planes(&frames, 0, 2);
        assert_eq!(r.data, [300.0 / 4.0, (60 + 90 + 180 + 210) as f32 / 4.0]);
        assert_eq!(b.data[0], r.data[0] + 20.0);
    }
}
