//! Where a macroblock was in the picture before: whole pixels, the smallest sum of absolute differences.
//!
//! Mouths are enlarged about four times, so that whole pixels are as fine as the quarter pixels of a film that is not; finer steps
//! have saved one byte in a hundred (docs/rendering.md).
use super::macroblock::Samples;
use crate::encode::colour::Picture;

/// Right and down, in pixels.
pub(super) type Motion = [i16; 2];

/// What a bit costs in the sum of differences: √λ of the quantiser in use.
const BIT: u32 = 3;
/// Steps of the search, each by one pixel.
const STEPS: usize = 24;

/// Motions of the macroblocks of a picture, which say what to expect of the next one.
pub(super) struct Field {
    columns: usize,
    motions: Vec<Motion>,
}

impl Field {
    pub(super) fn new(columns: usize, rows: usize) -> Self {
        Self {
            columns,
            motions: vec![[0; 2]; columns * rows],
        }
    }

    pub(super) fn get(&self, column: usize, row: usize) -> Motion {
        self.motions[row * self.columns + column]
    }

    pub(super) fn set(&mut self, column: usize, row: usize, motion: Motion) {
        self.motions[row * self.columns + column] = motion;
    }

    /// Whether two macroblocks moved differently.
    pub(super) fn apart(&self, a: (usize, usize), b: (usize, usize)) -> bool {
        self.get(a.0, a.1) != self.get(b.0, b.1)
    }

    /// The motion that a decoder expects: the median of those to the left, above, and above to the right, or else to the left
    /// (ITU-T H.264, clause 8.4.1.3, where all macroblocks look back at the same picture).
    pub(super) fn expected(&self, column: usize, row: usize) -> Motion {
        let left = (column > 0).then(|| self.get(column - 1, row));
        if row == 0 {
            return left.unwrap_or_default();
        }
        let above = self.get(column, row - 1);
        let corner = if column + 1 < self.columns {
            Some(self.get(column + 1, row - 1))
        } else {
            (column > 0).then(|| self.get(column - 1, row - 1))
        };
        match (left, corner) {
            (None, None) => above,
            _ => {
                let (left, corner) = (left.unwrap_or_default(), corner.unwrap_or_default());
                std::array::from_fn(|i| median(left[i], above[i], corner[i]))
            }
        }
    }

    /// The motion of a macroblock that is skipped (clause 8.4.1.1).
    pub(super) fn of_skipped(&self, column: usize, row: usize) -> Motion {
        if column == 0 || row == 0 {
            return [0; 2];
        }
        let still = self.get(column - 1, row) == [0; 2] || self.get(column, row - 1) == [0; 2];
        if still { [0; 2] } else { self.expected(column, row) }
    }
}

fn median(a: i16, b: i16, c: i16) -> i16 {
    a.max(b).min(a.min(b).max(c))
}

/// The luma of the picture before, around one macroblock.
struct Search<'a> {
    before: &'a Picture,
    samples: &'a Samples,
    /// Place of the macroblock.
    x: usize,
    y: usize,
    expected: Motion,
    skipped: Motion,
}

/// The best motion of the macroblock at `column`, `row` from where `before` had it; `last` is that of the same macroblock a picture ago.
pub(super) fn search(
    before: &Picture,
    samples: &Samples,
    field: &Field,
    last: Motion,
    column: usize,
    row: usize,
) -> Motion {
    let search = Search {
        before,
        samples,
        x: 16 * column,
        y: 16 * row,
        expected: field.expected(column, row),
        skipped: field.of_skipped(column, row),
    };
    let mut best = ([0; 2], u32::MAX);
    let mut tried: [Option<Motion>; 4] = [None; 4];
    for (k, motion) in [search.skipped, [0; 2], search.expected, last]
        .into_iter()
        .enumerate()
    {
        if !tried.contains(&Some(motion)) {
            tried[k] = Some(motion);
            search.compare(motion, &mut best);
        }
    }
    // Downhill, one pixel at a time. A way back is not looked at again.
    let mut from = best.0;
    for _ in 0..STEPS {
        let centre = best.0;
        for [right, down] in [[1, 0], [-1, 0], [0, 1], [0, -1]] {
            let motion = [centre[0] + right, centre[1] + down];
            if motion != from {
                search.compare(motion, &mut best);
            }
        }
        if best.0 == centre {
            break;
        }
        from = centre;
    }
    best.0
}

impl Search<'_> {
    /// Takes `motion` if it costs less.
    fn compare(&self, motion: Motion, best: &mut (Motion, u32)) {
        let Some((x, y)) = place(self.before, self.x, self.y, motion) else {
            return;
        };
        let mut cost = if motion == self.skipped {
            0
        } else {
            BIT * self.bits(motion)
        };
        let width = self.before.width;
        for (i, row) in self.samples.y.as_chunks::<16>().0.iter().enumerate() {
            let at = (y + i) * width + x;
            cost += apart(row, &self.before.y[at..at + 16]);
            if cost >= best.1 {
                return;
            }
        }
        *best = (motion, cost);
    }

    /// Bits of a motion, where two of its own say that the macroblock is not skipped.
    fn bits(&self, motion: Motion) -> u32 {
        let bits = |i: usize| {
            let off = 4 * u32::from((motion[i] - self.expected[i]).unsigned_abs());
            2 * (2 * off + 1).ilog2() + 1
        };
        2 + bits(0) + bits(1)
    }
}

/// Sum of absolute differences of 16 samples.
fn apart(a: &[u8; 16], b: &[u8]) -> u32 {
    a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum()
}

/// Where the macroblock at (`x`, `y`) was, if it was inside the picture as a whole.
fn place(before: &Picture, x: usize, y: usize, motion: Motion) -> Option<(usize, usize)> {
    let x = x.checked_add_signed(isize::from(motion[0]))?;
    let y = y.checked_add_signed(isize::from(motion[1]))?;
    (x + 16 <= before.width && y + 16 <= before.height).then_some((x, y))
}

/// The macroblock at `column`, `row` as it was in the picture before; `None` if `motion` leaves the picture. Chroma has half the
/// pixels: between two of them it is their mean (clause 8.4.2.2.2).
pub(super) fn moved(before: &Picture, column: usize, row: usize, motion: Motion) -> Option<Samples> {
    let (x, y) = place(before, 16 * column, 16 * row, motion)?;
    let mut samples = Samples {
        y: [0; 256],
        chroma: [[0; 64]; 2],
    };
    for (i, line) in samples.y.as_chunks_mut::<16>().0.iter_mut().enumerate() {
        let at = (y + i) * before.width + x;
        line.copy_from_slice(&before.y[at..at + 16]);
    }
    let width = before.width / 2;
    let (right, down) = (x % 2, y % 2 * width);
    for (plane, out) in [&before.cb, &before.cr].into_iter().zip(&mut samples.chroma) {
        for (i, line) in out.as_chunks_mut::<8>().0.iter_mut().enumerate() {
            let at = (y / 2 + i) * width + x / 2;
            // Where a coordinate is even, its two neighbours are one.
            let corners = [0, right, down, right + down].map(|off| &plane[at + off..at + off + 8]);
            for (k, sample) in line.iter_mut().enumerate() {
                let sum: u16 = corners.iter().map(|corner| u16::from(corner[k])).sum();
                *sample = ((sum + 2) >> 2) as u8;
            }
        }
    }
    Some(samples)
}
