//! How drawn pictures compare with recorded ones: likeness, sharpness, steadiness.
//!
//! Pictures are rows of interleaved R, G, B in levels of 0..255. Likeness is PSNR over all channels and SSIM (Wang et al. 2004) of the luminance, in windows of
//! 8 × 8 pixels; sharpness and steadiness are ratios of drawn to recorded, so that 1 is as recorded.
use ndarray::{ArrayView1, ArrayView2, ArrayView3, Axis};

/// Sums over pictures, of one way of drawing.
#[derive(Clone, Debug, Default)]
pub struct PictureScore {
    squares: f64,
    levels: f64,
    ssim: f64,
    windows: f64,
    /// Energy of the finest structure, drawn and recorded.
    fine: (f64, f64),
    /// Energy of the second difference over time, drawn and recorded.
    jerk: (f64, f64),
}

/// Side of SSIM's windows, and how far they are apart, pixels.
const WINDOW: usize = 8;
const APART: usize = 4;

impl PictureScore {
    /// Adds a clip: drawn and recorded pictures `[n, P]` of `(width, height)`. The shorter of the two counts.
    pub fn add(
        &mut self,
        drawn: ArrayView2<f32>,
        recorded: ArrayView2<f32>,
        (width, height): (usize, usize),
    ) {
        let count = drawn.nrows().min(recorded.nrows());
        let mut greys = (Vec::new(), Vec::new());
        for n in 0..count {
            let (a, b) = (drawn.row(n), recorded.row(n));
            // A screen shows whole levels in range.
            let shown = |v: f32| f64::from(v.round().clamp(0.0, 255.0));
            self.squares += a
                .iter()
                .zip(b)
                .map(|(x, y)| (shown(*x) - shown(*y)).powi(2))
                .sum::<f64>();
            self.levels += a.len() as f64;
            let (a, b) = (luminance(a), luminance(b));
            let (sum, windows) = ssim(&a, &b, width, height);
            self.ssim += sum;
            self.windows += windows;
            self.fine.0 += finest(&a, width, height);
            self.fine.1 += finest(&b, width, height);
            greys.0.push(a);
            greys.1.push(b);
        }
        self.jerk.0 += second_differences(&greys.0);
        self.jerk.1 += second_differences(&greys.1);
    }

    /// Adds what was summed over other clips.
    pub fn merge(&mut self, other: &PictureScore) {
        self.squares += other.squares;
        self.levels += other.levels;
        self.ssim += other.ssim;
        self.windows += other.windows;
        self.fine = (self.fine.0 + other.fine.0, self.fine.1 + other.fine.1);
        self.jerk = (self.jerk.0 + other.jerk.0, self.jerk.1 + other.jerk.1);
    }

    /// Peak signal-to-noise ratio, decibels.
    pub fn psnr_db(&self) -> f64 {
        10.0 * (255.0f64.powi(2) / (self.squares / self.levels.max(1.0)).max(1e-12)).log10()
    }

    /// Mean structural similarity of the luminance, at most 1.
    pub fn ssim(&self) -> f64 {
        self.ssim / self.windows.max(1.0)
    }

    /// Energy of the finest structure (Laplacian of the luminance) over the recording's.
    pub fn sharpness(&self) -> f64 {
        self.fine.0 / self.fine.1.max(1e-12)
    }

    /// Energy of the second difference over time of the luminance over the recording's: motion, flicker and noise.
    pub fn jerk(&self) -> f64 {
        self.jerk.0 / self.jerk.1.max(1e-12)
    }
}

fn luminance(rgb: ArrayView1<f32>) -> Vec<f64> {
    let levels: Vec<f64> = rgb
        .iter()
        .map(|v| f64::from(v.round().clamp(0.0, 255.0)))
        .collect();
    levels
        .chunks_exact(3)
        .map(|p| 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2])
        .collect()
}

/// Sum of SSIM over windows, and their number.
fn ssim(a: &[f64], b: &[f64], width: usize, height: usize) -> (f64, f64) {
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let (mut sum, mut windows) = (0.0, 0.0);
    let Some((right, bottom)) = width.checked_sub(WINDOW).zip(height.checked_sub(WINDOW)) else {
        return (0.0, 0.0);
    };
    for top in (0..=bottom).step_by(APART) {
        for left in (0..=right).step_by(APART) {
            let (mut sa, mut sb, mut saa, mut sbb, mut sab) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for y in top..top + WINDOW {
                for x in left..left + WINDOW {
                    let (p, q) = (a[y * width + x], b[y * width + x]);
                    (sa, sb) = (sa + p, sb + q);
                    (saa, sbb, sab) = (saa + p * p, sbb + q * q, sab + p * q);
                }
            }
            let n = (WINDOW * WINDOW) as f64;
            let (ma, mb) = (sa / n, sb / n);
            let (va, vb, cov) = (saa / n - ma * ma, sbb / n - mb * mb, sab / n - ma * mb);
            sum += (2.0 * ma * mb + c1) * (2.0 * cov + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            windows += 1.0;
        }
    }
    (sum, windows)
}

/// Energy of the Laplacian.
fn finest(grey: &[f64], width: usize, height: usize) -> f64 {
    let mut sum = 0.0;
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let at = y * width + x;
            let around = grey[at - 1] + grey[at + 1] + grey[at - width] + grey[at + width];
            sum += (around - 4.0 * grey[at]).powi(2);
        }
    }
    sum
}

fn second_differences(pictures: &[Vec<f64>]) -> f64 {
    let of = |w: &[Vec<f64>]| -> f64 {
        (0..w[0].len())
            .map(|p| (w[0][p] - 2.0 * w[1][p] + w[2][p]).powi(2))
            .sum()
    };
    pictures.windows(3).map(of).sum()
}

/// Colour step across the border of a region against the same border in the recording, in levels, root mean square: (drawn, recorded).
///
/// `drawn` and `recorded` are `[height, width, 3]`; `inside` says which pixels were drawn. Steps are those between neighbours of which one is inside.
pub fn seam(
    drawn: ArrayView3<u8>,
    recorded: ArrayView3<u8>,
    inside: impl Fn(usize, usize) -> bool,
) -> (f64, f64) {
    let (height, width, _) = drawn.dim();
    let (mut sums, mut count) = ((0.0f64, 0.0f64), 0.0f64);
    let mut step = |a: (usize, usize), b: (usize, usize)| {
        if inside(a.1, a.0) == inside(b.1, b.0) {
            return;
        }
        let energy = |of: &ArrayView3<u8>| -> f64 {
            let (p, q) = (of.index_axis(Axis(0), a.0), of.index_axis(Axis(0), b.0));
            let (p, q) = (p.index_axis(Axis(0), a.1), q.index_axis(Axis(0), b.1));
            p.iter()
                .zip(q)
                .map(|(x, y)| (f64::from(*x) - f64::from(*y)).powi(2))
                .sum()
        };
        sums = (sums.0 + energy(&drawn), sums.1 + energy(&recorded));
        count += 3.0;
    };
    for y in 0..height.saturating_sub(1) {
        for x in 0..width.saturating_sub(1) {
            step((y, x), (y, x + 1));
            step((y, x), (y + 1, x));
        }
    }
    let root = |sum: f64| (sum / count.max(1.0)).sqrt();
    (root(sums.0), root(sums.1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Array3};

    const SIZE: (usize, usize) = (24, 16);

    /// A pattern that moves.
    fn pictures(count: usize, noise: f32) -> Array2<f32> {
        Array2::from_shape_fn((count, SIZE.0 * SIZE.1 * 3), |(t, p)| {
            let (x, y) = ((p / 3 % SIZE.0) as f32, (p / 3 / SIZE.0) as f32);
            let grain = if (p / 3 + t) % 2 == 0 { noise } else { -noise };
            120.0 + 60.0 * (0.4 * x + 0.2 * t as f32).sin() * (0.3 * y).cos() + grain
        })
    }

    fn score(drawn: &Array2<f32>, recorded: &Array2<f32>) -> PictureScore {
        let mut score = PictureScore::default();
        score.add(drawn.view(), recorded.view(), SIZE);
        score
    }

    #[test]
    fn the_recording_itself_is_perfect() {
        let all = pictures(5, 0.0);
        let score = score(&all, &all);
        assert!(score.psnr_db() > 100.0);
        for ratio in [score.ssim(), score.sharpness(), score.jerk()] {
            assert!((ratio - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_off_by_so_many_levels_has_that_psnr() {
        let all = pictures(5, 0.0);
        let score = score(&(&all + 5.0), &all);
        // 20 log10(255 / 5)
        assert!((score.psnr_db() - 34.15).abs() < 0.1, "{}", score.psnr_db());
        assert!(score.ssim() > 0.99 && (score.jerk() - 1.0).abs() < 0.05);
    }

    #[test]
    fn clips_add_up() {
        let (drawn, recorded) = (pictures(6, 4.0), pictures(6, 0.0));
        let mut merged = score(&drawn, &recorded);
        merged.merge(&score(&recorded, &recorded));
        // Half of the pictures are perfect: half the squared error.
        let halved = score(&drawn, &recorded).psnr_db() + 10.0 * 2.0f64.log10();
        assert!((merged.psnr_db() - halved).abs() < 1e-6);
        assert!((merged.ssim() - 0.5 * (1.0 + score(&drawn, &recorded).ssim())).abs() < 1e-9);
    }

    #[test]
    fn noise_is_sharp_and_jerky_and_blur_is_neither() {
        let all = pictures(8, 0.0);
        let noisy = score(&pictures(8, 6.0), &all);
        assert!(noisy.sharpness() > 2.0 && noisy.jerk() > 2.0 && noisy.ssim() < 0.99);
        let flat = score(&Array2::from_elem(all.dim(), 120.0), &all);
        assert!(flat.sharpness() < 1e-6 && flat.jerk() < 1e-6 && flat.ssim() < 0.6);
    }

    #[test]
    fn a_step_at_the_border_is_a_seam() {
        let recorded = Array3::from_elem((10, 10, 3), 100u8);
        let inside = |x: usize, y: usize| (3..7).contains(&x) && (3..7).contains(&y);
        let drawn = Array3::from_shape_fn((10, 10, 3), |(y, x, _)| if inside(x, y) { 108u8 } else { 100 });
        assert_eq!(seam(drawn.view(), recorded.view(), inside), (8.0, 0.0));
    }
}
