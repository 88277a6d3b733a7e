//! Pictures into slices: a key picture first, every later one by what has changed since the one before it.
use rusty_h264_common::BitWriter;
use rusty_h264_common::cavlc::write_cbp_inter;

use super::blocks::Quantiser;
use super::deblock::Filter;
use super::macroblock::{Counts, Residual, Samples};
use super::motion::{self, Field};
use super::predict::{Around, Way};
use super::stream::{self, Nal};
use crate::encode::colour::Picture;

/// Quantiser of changes, 0..51: 22 keeps mouth pictures 48 dB above the coding error (docs/rendering.md).
pub(super) const QP: u8 = 22;
/// Changes build on key pictures, which are therefore coded more finely.
const KEY_QP: u8 = QP - 3;

static CHANGES: Quantiser = Quantiser::new(QP, 6);
static KEYS: Quantiser = Quantiser::new(KEY_QP, 3);
static FILTER: Filter = Filter::new(QP);
static KEY_FILTER: Filter = Filter::new(KEY_QP);

/// Codes a group of pictures: a key picture and those that follow it.
pub(super) struct Coder {
    columns: usize,
    rows: usize,
    /// What a decoder shows, in whole macroblocks, of the picture at work and of the one before.
    shown: Picture,
    before: Picture,
    /// Motions of the picture at work, and where they have not been found yet, of the one before.
    field: Field,
    counts: Counts,
    /// Pictures since the key picture, that one included.
    number: u32,
    /// Of the group.
    group: u32,
}

impl Coder {
    /// Group `group` of pictures of `width`×`height`, both even.
    pub(super) fn new(width: usize, height: usize, group: u32) -> Self {
        let (columns, rows) = (width.div_ceil(16), height.div_ceil(16));
        let area = columns * rows * 256;
        let blank = Picture {
            width: 16 * columns,
            height: 16 * rows,
            y: vec![0; area],
            cb: vec![0; area / 4],
            cr: vec![0; area / 4],
        };
        Self {
            columns,
            rows,
            shown: blank.clone(),
            before: blank,
            field: Field::new(columns, rows),
            counts: Counts::new(columns, rows),
            number: 0,
            group,
        }
    }

    /// The next picture's NAL unit.
    pub(super) fn code(&mut self, picture: &Picture) -> Vec<u8> {
        let mut w = BitWriter::with_capacity(1 << 14);
        let key = self.number == 0;
        let quantiser = if key { &KEYS } else { &CHANGES };
        let delta = i32::from(quantiser.qp) - i32::from(QP);
        stream::slice(&mut w, self.number, self.group, delta);
        self.counts.clear();
        std::mem::swap(&mut self.shown, &mut self.before);
        let mut skipped = 0;
        for row in 0..self.rows {
            for column in 0..self.columns {
                let samples = load(picture, column, row);
                match key {
                    true => self.key_macroblock(&mut w, &samples, column, row),
                    false => self.changed_macroblock(&mut w, &samples, column, row, &mut skipped),
                }
            }
        }
        if skipped > 0 {
            w.write_ue(skipped);
        }
        match key {
            true => KEY_FILTER.key(&mut self.shown),
            false => FILTER.changed(&mut self.shown, &self.field, &self.counts),
        }
        self.number += 1;
        stream::unit(if key { Nal::Key } else { Nal::Change }, w)
    }

    /// A macroblock that was there before, perhaps elsewhere, and what is different (P_L0_16x16); it is skipped if that is nothing and it is
    /// where it is expected.
    fn changed_macroblock(
        &mut self,
        w: &mut BitWriter,
        samples: &Samples,
        column: usize,
        row: usize,
        skipped: &mut u32,
    ) {
        let expected = self.field.expected(column, row);
        let last = self.field.get(column, row);
        let motion = motion::search(&self.before, samples, &self.field, last, column, row);
        let mut shown = motion::moved(&self.before, column, row, motion).expect("found inside the picture");
        let residual = Residual::new(samples, &shown, false, &CHANGES);
        let pattern = residual.pattern();
        let skip = pattern == 0 && motion == self.field.of_skipped(column, row);
        self.field.set(column, row, motion);
        if skip {
            *skipped += 1;
        } else {
            w.write_ue(*skipped);
            *skipped = 0;
            // P_L0_16x16, and how far its motion is from the expected one in quarters of a pixel.
            w.write_ue(0);
            for (motion, expected) in motion.into_iter().zip(expected) {
                w.write_se(4 * i32::from(motion - expected));
            }
            write_cbp_inter(w, pattern);
            if pattern != 0 {
                // The quantiser stays.
                w.write_bit(true);
                residual.write(w, &mut self.counts, column, row);
                residual.restore(&mut shown, &CHANGES);
            }
        }
        store(&mut self.shown, &shown, column, row);
    }

    /// A macroblock that continues its neighbours (I_16x16), and what is different.
    fn key_macroblock(&mut self, w: &mut BitWriter, samples: &Samples, column: usize, row: usize) {
        let width = self.shown.width;
        let luma = around::<16>(&self.shown.y, width, 16 * column, 16 * row);
        let chroma =
            [&self.shown.cb, &self.shown.cr].map(|plane| around::<8>(plane, width / 2, 8 * column, 8 * row));
        let (way, y) = best(|way| Some([luma.continued(way)?]), [&samples.y]);
        let (chroma_way, chroma) = best(
            |way| Some([chroma[0].continued(way)?, chroma[1].continued(way)?]),
            [&samples.chroma[0], &samples.chroma[1]],
        );
        let [y] = y;
        let mut shown = Samples { y, chroma };
        let residual = Residual::new(samples, &shown, true, &KEYS);
        let pattern = residual.pattern();
        w.write_ue(1 + way.luma() + 4 * (pattern >> 4) + if pattern & 15 != 0 { 12 } else { 0 });
        w.write_ue(chroma_way.chroma());
        // The quantiser stays.
        w.write_bit(true);
        residual.write(w, &mut self.counts, column, row);
        residual.restore(&mut shown, &KEYS);
        store(&mut self.shown, &shown, column, row);
    }

    /// What a decoder shows of the last picture.
    #[cfg(test)]
    pub(super) fn shown(&self) -> &Picture {
        &self.shown
    }
}

/// The way whose prediction of `P` planes is nearest to the samples, and that prediction.
fn best<const AREA: usize, const P: usize>(
    predict: impl Fn(Way) -> Option<[[u8; AREA]; P]>,
    samples: [&[u8; AREA]; P],
) -> (Way, [[u8; AREA]; P]) {
    Way::ALL
        .into_iter()
        .filter_map(|way| Some((way, predict(way)?)))
        .min_by_key(|(_, predicted)| {
            predicted
                .iter()
                .flatten()
                .zip(samples.into_iter().flatten())
                .map(|(a, b)| u32::from(a.abs_diff(*b)))
                .sum::<u32>()
        })
        .expect("a mean needs no neighbours")
}

/// The samples around the square at (`x`, `y`) of a plane.
fn around<const N: usize>(plane: &[u8], width: usize, x: usize, y: usize) -> Around<N> {
    let at = |x: usize, y: usize| plane[y * width + x];
    Around {
        above: (y > 0).then(|| std::array::from_fn(|i| at(x + i, y - 1))),
        left: (x > 0).then(|| std::array::from_fn(|i| at(x - 1, y + i))),
        corner: if x > 0 && y > 0 { at(x - 1, y - 1) } else { 0 },
    }
}

/// A macroblock of a picture; beyond the picture its last samples go on.
fn load(picture: &Picture, column: usize, row: usize) -> Samples {
    let (width, height) = (picture.width, picture.height);
    let (x, y) = (column, row);
    let mut samples = Samples {
        y: [0; 256],
        chroma: [[0; 64]; 2],
    };
    square::<16>(&picture.y, width, height, (16 * x, 16 * y), &mut samples.y);
    for (plane, to) in [&picture.cb, &picture.cr].into_iter().zip(&mut samples.chroma) {
        square::<8>(plane, width / 2, height / 2, (8 * x, 8 * y), to);
    }
    samples
}

/// The square of `N`×`N` samples at `(x, y)`.
fn square<const N: usize>(plane: &[u8], width: usize, height: usize, (x, y): (usize, usize), to: &mut [u8]) {
    let inside = N.min(width - x);
    for (i, row) in to.chunks_exact_mut(N).enumerate() {
        let from = (y + i).min(height - 1) * width + x;
        if inside == N {
            row.copy_from_slice(&plane[from..from + N]);
        } else {
            row[..inside].copy_from_slice(&plane[from..from + inside]);
            row[inside..].fill(plane[from + inside - 1]);
        }
    }
}

/// Puts a macroblock into a picture of whole ones.
fn store(picture: &mut Picture, samples: &Samples, column: usize, row: usize) {
    let width = picture.width;
    for (i, line) in samples.y.chunks_exact(16).enumerate() {
        let to = (16 * row + i) * width + 16 * column;
        picture.y[to..to + 16].copy_from_slice(line);
    }
    for (plane, lines) in [&mut picture.cb, &mut picture.cr]
        .into_iter()
        .zip(&samples.chroma)
    {
        for (i, line) in lines.chunks_exact(8).enumerate() {
            let to = (8 * row + i) * (width / 2) + 8 * column;
            plane[to..to + 8].copy_from_slice(line);
        }
    }
}
