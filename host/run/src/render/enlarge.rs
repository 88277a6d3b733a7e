//! Pictures larger than they were photographed: a Catmull-Rom cubic along rows, then along columns.
//!
//! R. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. ASSP 29 (6), 1981, eq. 15. It interpolates the
//! pixels that it is given: no blur, and less ringing than Lanczos. The weights depend on the sizes alone and are computed once.

/// Colours of a pixel.
const COLOURS: usize = 3;
/// Sources of a place when pictures grow: the cubic reaches two to either side.
const GROWING: usize = 4;
/// … when they shrink, which only rounding to whole macroblocks makes them do: by 23 to 16 at most.
const SHRINKING: usize = 6;

/// Makes pictures of one size from pictures of another.
pub(super) struct Enlarger {
    across: Taps,
    down: Taps,
    /// Numbers in a row of the pictures that come in.
    row: usize,
    /// The picture with its final width and its own height.
    wide: Vec<f32>,
}

/// What each place of a line is mixed from.
struct Taps {
    /// Places of the line that is mixed from.
    from: usize,
    /// First source of each place.
    first: Vec<usize>,
    /// Weights of the sources from there on, `count` for every place; their sum is 1.
    weights: Vec<f32>,
    count: usize,
}

impl Taps {
    /// For a line of `to` places that are mixed from `from` places.
    fn new(from: usize, to: usize) -> Self {
        let ratio = from as f64 / to as f64;
        // A picture that shrinks must not lose the pixels between its places.
        let stretch = ratio.max(1.0);
        let count = if ratio > 1.0 { SHRINKING } else { GROWING };
        let (mut first, mut weights) = (Vec::new(), Vec::new());
        for place in 0..to {
            let middle = (place as f64 + 0.5) * ratio - 0.5;
            let lowest = (middle - 2.0 * stretch).ceil().max(0.0) as usize;
            let start = lowest.min(from.saturating_sub(count));
            let sources = start..start + count;
            let mix: Vec<f64> = sources
                .map(|source| match source < from {
                    true => cubic((source as f64 - middle) / stretch),
                    false => 0.0,
                })
                .collect();
            let sum: f64 = mix.iter().sum();
            first.push(start);
            weights.extend(mix.iter().map(|w| (w / sum) as f32));
        }
        Self {
            from,
            first,
            weights,
            count,
        }
    }
}

/// Keys' cubic with a = −1/2.
fn cubic(x: f64) -> f64 {
    match x.abs() {
        x if x < 1.0 => (1.5 * x - 2.5) * x * x + 1.0,
        x if x < 2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
        _ => 0.0,
    }
}

impl Enlarger {
    /// From pictures of `from` to pictures of `to`, both width and height.
    pub(super) fn new(from: (usize, usize), to: (usize, usize)) -> Self {
        Self {
            across: Taps::new(from.0, to.0),
            down: Taps::new(from.1, to.1),
            row: COLOURS * from.0,
            // One number more, since a pixel is written as four.
            wide: vec![0.0; COLOURS * to.0 * from.1 + 1],
        }
    }

    /// Numbers after a picture's last that are read, though not used, when it is enlarged.
    pub(super) const MARGIN: usize = COLOURS * SHRINKING + 1;

    /// Rows of interleaved R, G, B in 0..255, with [`Self::MARGIN`] numbers after them, to rows of bytes.
    pub(super) fn enlarge(&mut self, picture: &[f32]) -> Vec<u8> {
        match self.across.count {
            GROWING => self.widen::<GROWING>(picture),
            _ => self.widen::<SHRINKING>(picture),
        }
        match self.down.count {
            GROWING => self.heighten::<GROWING>(),
            _ => self.heighten::<SHRINKING>(),
        }
    }

    fn widen<const N: usize>(&mut self, picture: &[f32]) {
        let to = COLOURS * self.across.first.len();
        for row in 0..self.down.from {
            let from = &picture[row * self.row..];
            let wide = &mut self.wide[row * to..(row + 1) * to + 1];
            let weights = self.across.weights.as_chunks::<N>().0;
            for ((place, &first), weights) in self.across.first.iter().enumerate().zip(weights) {
                // Four numbers at a time, as vector registers hold them: the fourth is the next pixel's, and is overwritten by it.
                let mut pixel = [0.0; 4];
                for (k, weight) in weights.iter().enumerate() {
                    let at = COLOURS * (first + k);
                    let source: [f32; 4] = from[at..at + 4].try_into().expect("four numbers");
                    for (sum, level) in pixel.iter_mut().zip(source) {
                        *sum += weight * level;
                    }
                }
                wide[COLOURS * place..COLOURS * place + 4].copy_from_slice(&pixel);
            }
        }
    }

    fn heighten<const N: usize>(&self) -> Vec<u8> {
        let width = COLOURS * self.across.first.len();
        let mut out = vec![0; width * self.down.first.len()];
        let weights = self.down.weights.as_chunks::<N>().0;
        let places = self.down.first.iter().zip(weights);
        for (line, (&first, weights)) in out.chunks_exact_mut(width).zip(places) {
            let rows: [&[f32]; N] = std::array::from_fn(|k| {
                let row = (first + k).min(self.down.from - 1);
                &self.wide[row * width..(row + 1) * width]
            });
            for (i, byte) in line.iter_mut().enumerate() {
                let sum: f32 = (0..N).map(|k| weights[k] * rows[k][i]).sum();
                *byte = rounded(sum);
            }
        }
        out
    }
}

/// The nearest of 0..255.
///
/// The sum with 2²³ has no bits after the point, so its lowest byte is the rounded number: what `as` does besides costs more than all
/// the rest.
fn rounded(level: f32) -> u8 {
    (level.clamp(0.0, 255.0) + 8_388_608.0).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enlarged(from: (usize, usize), to: (usize, usize), level: impl Fn(f64, f64) -> f64) -> Vec<u8> {
        let mut picture = Vec::new();
        for row in 0..from.1 {
            for column in 0..from.0 {
                let value = level(column as f64 + 0.5, row as f64 + 0.5) as f32;
                picture.extend([value, value / 2.0, 255.0 - value]);
            }
        }
        picture.extend([0.0; Enlarger::MARGIN]);
        Enlarger::new(from, to).enlarge(&picture)
    }

    #[test]
    fn a_picture_of_the_same_size_is_the_same() {
        let level = |x: f64, y: f64| (7.0 * x + 31.0 * y) % 250.0;
        let same = enlarged((20, 16), (20, 16), level);
        for (i, pixel) in same.chunks_exact(3).enumerate() {
            let value = level((i % 20) as f64 + 0.5, (i / 20) as f64 + 0.5);
            let want = [value, value / 2.0, 255.0 - value];
            for (have, want) in pixel.iter().zip(want) {
                assert!((f64::from(*have) - want).abs() <= 0.5, "{i}: {pixel:?} {want:?}");
            }
        }
    }

    #[test]
    fn what_is_even_stays_so_to_the_edges_and_slopes_go_on_between_pixels() {
        for (from, to) in [((12, 9), (48, 48)), ((3, 2), (16, 16)), ((23, 20), (16, 16))] {
            assert!(
                enlarged(from, to, |_, _| 100.0)
                    .chunks_exact(3)
                    .all(|p| p == [100, 50, 155])
            );
        }
        let (width, height) = (48, 32);
        let slope = enlarged((12, 8), (width, height), |x, y| 10.0 + 8.0 * x + 12.0 * y);
        // The two outermost pixels on each side have not got all their neighbours.
        for y in 8..height - 8 {
            for x in 8..width - 8 {
                let want = 10.0 + 2.0 * (x as f64 + 0.5) + 3.0 * (y as f64 + 0.5);
                let have = f64::from(slope[3 * (y * width + x)]);
                assert!((have - want).abs() <= 0.5001, "{x} {y}: {have} {want}");
            }
        }
    }

    #[test]
    fn levels_beyond_the_scale_are_held() {
        assert_eq!([-9.0, 0.49, 0.51, 254.6, 300.0].map(rounded), [0, 0, 1, 255, 255]);
        // Beside a step a cubic swings over.
        let step = enlarged((8, 8), (32, 32), |x, _| if x < 4.0 { 0.0 } else { 255.0 });
        assert_eq!((step[0], step[3 * 31]), (0, 255));
    }
}
