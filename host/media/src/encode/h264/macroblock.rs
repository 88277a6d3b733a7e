//! A macroblock: the difference between samples and their prediction, quantised, written (CAVLC, ITU-T H.264, clauses 7.3.5 and 9.2) and put
//! back together as a decoder will.
use rusty_h264_common::BitWriter;
use rusty_h264_common::cavlc::encode_residual_block;

use super::blocks::{Lanes, Quantiser, ZIGZAG, hadamard2, hadamard4, transform};

/// Column and row of luma blocks in the order in which they are written.
const LUMA_BLOCKS: [(usize, usize); 16] = {
    let mut places = [(0, 0); 16];
    let mut k = 0;
    while k < 16 {
        places[k] = ((k & 1) | (k >> 1 & 2), (k >> 1 & 1) | (k >> 2 & 2));
        k += 1;
    }
    places
};

/// Samples of a macroblock in rows: luma and both chroma planes.
#[derive(Clone)]
pub(super) struct Samples {
    pub(super) y: [u8; 256],
    pub(super) chroma: [[u8; 64]; 2],
}

/// Quantised difference of a macroblock from its prediction.
pub(super) struct Residual {
    luma: Lanes<16>,
    /// Bit k: luma block k has a level that is not 0, the DC apart where it goes its own way.
    luma_coded: u32,
    /// Levels of the luma DC transform, in rows, in macroblocks that are predicted as 16×16.
    luma_dc: Option<[i32; 16]>,
    /// Blocks 0 to 3 are Cb's, 4 to 7 Cr's.
    chroma: Lanes<8>,
    chroma_coded: u32,
    chroma_dc: [[i32; 4]; 2],
}

impl Residual {
    /// Of `samples` from `prediction`; `intra` macroblocks transform the luma DC coefficients again.
    pub(super) fn new(samples: &Samples, prediction: &Samples, intra: bool, quantiser: &Quantiser) -> Self {
        let mut luma = [[0; 16]; 16];
        for (k, (column, row)) in LUMA_BLOCKS.into_iter().enumerate() {
            difference(
                &mut luma,
                k,
                &samples.y,
                &prediction.y,
                16,
                4 * (16 * row + column),
            );
        }
        transform(&mut luma);
        let luma_dc = intra.then(|| {
            let mut dc = [0; 16];
            for (k, (column, row)) in LUMA_BLOCKS.into_iter().enumerate() {
                dc[4 * row + column] = i32::from(luma[0][k]);
            }
            luma[0] = [0; 16];
            hadamard4(dc).map(|v| quantiser.quantise_dc(v, true))
        });
        let luma_coded = quantiser.quantise(&mut luma);

        let mut chroma = [[0; 8]; 16];
        for k in 0..8 {
            let (of, by) = (&samples.chroma[k / 4], &prediction.chroma[k / 4]);
            difference(&mut chroma, k, of, by, 8, 32 * (k / 2 % 2) + 4 * (k % 2));
        }
        transform(&mut chroma);
        let chroma_dc = [0, 4].map(|from| {
            let dc = std::array::from_fn(|k| i32::from(chroma[0][from + k]));
            hadamard2(dc).map(|v| quantiser.quantise_dc(v, false))
        });
        chroma[0] = [0; 8];
        let chroma_coded = quantiser.quantise(&mut chroma);
        Self {
            luma,
            luma_coded,
            luma_dc,
            chroma,
            chroma_coded,
            chroma_dc,
        }
    }

    /// coded_block_pattern: bits 0 to 3 for the luma quarters; 16 if chroma has only DC levels, 32 if it has others.
    pub(super) fn pattern(&self) -> u32 {
        let quarters = (0..4).map(|q| u32::from(self.luma_coded >> (4 * q) & 15 != 0) << q);
        let mut luma = quarters.sum();
        if self.luma_dc.is_some() && luma != 0 {
            // Macroblocks predicted as 16×16 have all quarters or none.
            luma = 15;
        }
        luma | match (self.chroma_coded, self.chroma_dc) {
            (0, [[0, 0, 0, 0], [0, 0, 0, 0]]) => 0,
            (0, _) => 16,
            _ => 32,
        }
    }

    /// Writes the levels; `counts` are those of the picture, `column` and `row` the macroblock's place.
    pub(super) fn write(&self, w: &mut BitWriter, counts: &mut Counts, column: usize, row: usize) {
        let pattern = self.pattern();
        if let Some(dc) = &self.luma_dc {
            let context = counts.luma.context(4 * column, 4 * row);
            encode_residual_block(w, &ZIGZAG.map(|i| dc[i]), 16, context);
        }
        let first = usize::from(self.luma_dc.is_some());
        for (k, (x, y)) in LUMA_BLOCKS.into_iter().enumerate() {
            if pattern >> (k / 4) & 1 != 0 {
                let coded = self.luma_coded >> k & 1 != 0;
                counts
                    .luma
                    .write(w, &self.luma, k, first, coded, (4 * column + x, 4 * row + y));
            }
        }
        if pattern >= 16 {
            for dc in &self.chroma_dc {
                encode_residual_block(w, dc, 4, -1);
            }
        }
        if pattern >= 32 {
            for k in 0..8 {
                let at = (2 * column + k % 2, 2 * row + k / 2 % 2);
                let coded = self.chroma_coded >> k & 1 != 0;
                counts.chroma[k / 4].write(w, &self.chroma, k, 1, coded, at);
            }
        }
    }

    /// Adds to `prediction` what a decoder will.
    pub(super) fn restore(&self, prediction: &mut Samples, quantiser: &Quantiser) {
        if self.luma_coded != 0 || self.luma_dc.is_some_and(|dc| dc != [0; 16]) {
            let dc = self.luma_dc.map(|levels| {
                let dc = hadamard4(levels).map(|v| quantiser.luma_dc(v));
                LUMA_BLOCKS.map(|(column, row)| dc[4 * row + column])
            });
            let residual = quantiser.restore(&self.luma, dc.as_ref());
            for (k, (column, row)) in LUMA_BLOCKS.into_iter().enumerate() {
                if dc.is_some() || self.luma_coded >> k & 1 != 0 {
                    add(&residual, k, &mut prediction.y, 16, 4 * (16 * row + column));
                }
            }
        }
        if self.pattern() >= 16 {
            let mut dc = [0; 8];
            for (plane, levels) in dc.chunks_exact_mut(4).zip(self.chroma_dc) {
                plane.copy_from_slice(&hadamard2(levels).map(|v| quantiser.chroma_dc(v)));
            }
            let residual = quantiser.restore(&self.chroma, Some(&dc));
            for k in 0..8 {
                add(
                    &residual,
                    k,
                    &mut prediction.chroma[k / 4],
                    8,
                    32 * (k / 2 % 2) + 4 * (k % 2),
                );
            }
        }
    }
}

/// The block at `at` of `samples` less that of `prediction`, as block `k`.
#[inline(always)]
fn difference<const N: usize>(
    lanes: &mut Lanes<N>,
    k: usize,
    samples: &[u8],
    prediction: &[u8],
    stride: usize,
    at: usize,
) {
    for row in 0..4 {
        let from = at + row * stride;
        let (samples, prediction) = (&samples[from..from + 4], &prediction[from..from + 4]);
        for column in 0..4 {
            lanes[4 * row + column][k] = i16::from(samples[column]) - i16::from(prediction[column]);
        }
    }
}

/// Adds block `k` to the samples at `at`.
#[inline(always)]
fn add<const N: usize>(lanes: &Lanes<N>, k: usize, samples: &mut [u8], stride: usize, at: usize) {
    for row in 0..4 {
        let from = at + row * stride;
        for (column, sample) in samples[from..from + 4].iter_mut().enumerate() {
            *sample = (i16::from(*sample) + lanes[4 * row + column][k]).clamp(0, 255) as u8;
        }
    }
}

/// How many levels of each block of a picture are not 0: what the code of the next one depends on.
pub(super) struct Counts {
    luma: Plane,
    chroma: [Plane; 2],
}

struct Plane {
    columns: usize,
    counts: Vec<u8>,
}

impl Counts {
    pub(super) fn new(columns: usize, rows: usize) -> Self {
        let plane = |blocks: usize| Plane {
            columns: columns * blocks,
            counts: vec![0; columns * rows * blocks * blocks],
        };
        Self {
            luma: plane(4),
            chroma: [plane(2), plane(2)],
        }
    }

    /// Whether luma block (`x`, `y`) has levels.
    pub(super) fn coded(&self, x: usize, y: usize) -> bool {
        self.luma.counts[y * self.luma.columns + x] != 0
    }

    /// Nothing has been written of the next picture. A macroblock that writes nothing leaves zeros.
    pub(super) fn clear(&mut self) {
        self.luma.counts.fill(0);
        self.chroma.iter_mut().for_each(|plane| plane.counts.fill(0));
    }
}

impl Plane {
    /// The rounded mean of the counts to the left and above (clause 9.2.1).
    fn context(&self, x: usize, y: usize) -> i32 {
        let at = y * self.columns + x;
        let left = (x > 0).then(|| i32::from(self.counts[at - 1]));
        let above = (y > 0).then(|| i32::from(self.counts[at - self.columns]));
        match (left, above) {
            (Some(left), Some(above)) => (left + above + 1) >> 1,
            (one, other) => one.or(other).unwrap_or(0),
        }
    }

    /// Writes block `k` of `lanes` from level `first` on, which lies at block `(x, y)` of the picture.
    fn write<const N: usize>(
        &mut self,
        w: &mut BitWriter,
        lanes: &Lanes<N>,
        k: usize,
        first: usize,
        coded: bool,
        (x, y): (usize, usize),
    ) {
        let context = self.context(x, y);
        let mut levels = [0; 16];
        if coded {
            levels = ZIGZAG.map(|i| i32::from(lanes[i][k]));
        }
        let count = encode_residual_block(w, &levels[first..], 16 - first, context);
        self.counts[y * self.columns + x] = count as u8;
    }
}
