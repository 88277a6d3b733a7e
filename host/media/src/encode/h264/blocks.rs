//! Sixteen blocks of 4×4 at a time: the integer transform and its inverse (ITU-T H.264, clause 8.5.12), quantiser and back.
//!
//! The same coefficient of all blocks lies side by side, so that every operation is done on all of them at once: compilers make vector
//! instructions of such loops without being asked.

/// `[coefficient, block]`: coefficient 4·row + column of every block.
pub(super) type Lanes<const N: usize> = [[i16; N]; 16];

/// Coefficients in the order in which they are written (frame zig-zag, table 8-2).
pub(super) const ZIGZAG: [usize; 16] = [0, 1, 4, 8, 5, 2, 3, 6, 9, 12, 13, 10, 7, 11, 14, 15];

/// Which of the three scales a coefficient has: 0 in even rows and columns, 1 in odd ones, else 2.
const SCALE: [usize; 16] = [0, 2, 0, 2, 2, 1, 2, 1, 0, 2, 0, 2, 2, 1, 2, 1];

/// Reciprocal scales of the quantiser in Q15, by qp mod 6: those that undo `WIDTH` and the transform's gain.
const RECIPROCAL: [[u32; 3]; 6] = [
    [13_107, 5243, 8066],
    [11_916, 4660, 7490],
    [10_082, 4194, 6554],
    [9362, 3647, 5825],
    [8192, 3355, 5243],
    [7282, 2893, 4559],
];

/// Widths of the quantiser's steps by qp mod 6 (clause 8.5.9).
const WIDTH: [[i32; 3]; 6] = [
    [10, 16, 13],
    [11, 18, 14],
    [13, 20, 16],
    [14, 23, 18],
    [16, 25, 20],
    [18, 29, 23],
];

/// Quantiser and back, for one quantisation parameter.
pub(super) struct Quantiser {
    pub(super) qp: u8,
    /// Levels are (|coefficient| + `round`) · `factor` / 2¹⁶.
    factor: [u16; 16],
    round: [u16; 16],
    /// Coefficients are level · `width`.
    width: [i32; 16],
    /// Of the DC transforms: levels are (|coefficient| · `dc_factor` + `dc_round`) / 2^`dc_shift`, where luma has one bit more.
    dc_factor: u32,
    dc_round: u32,
    dc_shift: u32,
}

impl Quantiser {
    /// For a `qp` of 6 to 29, where chroma has the same as luma. Levels are rounded up from 1 − 1/`dead` of a step.
    pub(super) const fn new(qp: u8, dead: u32) -> Self {
        assert!(qp >= 6 && qp < 30);
        let (six, rest) = (qp as u32 / 6, qp as usize % 6);
        let mut new = Self {
            qp,
            factor: [0; 16],
            round: [0; 16],
            width: [0; 16],
            dc_factor: RECIPROCAL[rest][0],
            dc_round: (1 << (16 + six)) / dead,
            dc_shift: 16 + six,
        };
        let mut i = 0;
        while i < 16 {
            let reciprocal = RECIPROCAL[rest][SCALE[i]];
            let half = (1 << (six - 1)) / 2;
            new.factor[i] = ((reciprocal + half) >> (six - 1)) as u16;
            new.round[i] = ((1 << 16) / dead / new.factor[i] as u32) as u16;
            new.width[i] = WIDTH[rest][SCALE[i]] << six;
            i += 1;
        }
        new
    }

    /// Coefficients to levels in place; bit k of the result says that block k has one that is not 0.
    ///
    /// Coefficients are below 36·255 = 9180, their rounding below 2¹⁶/3/`factor`: sums fit 16 bits.
    pub(super) fn quantise<const N: usize>(&self, lanes: &mut Lanes<N>) -> u32 {
        let mut any = [0i16; N];
        for i in 0..16 {
            let (factor, round) = (u32::from(self.factor[i]), self.round[i]);
            for k in 0..N {
                let coefficient = lanes[i][k];
                let sign = coefficient >> 15;
                let size = u32::from(coefficient.unsigned_abs() + round);
                let level = ((size * factor) >> 16) as i16;
                lanes[i][k] = (level ^ sign) - sign;
                any[k] |= level;
            }
        }
        (0..N).map(|k| u32::from(any[k] != 0) << k).sum()
    }

    /// One level of a DC transform.
    pub(super) fn quantise_dc(&self, coefficient: i32, luma: bool) -> i32 {
        let more = u32::from(luma);
        let size = u64::from(coefficient.unsigned_abs()) * u64::from(self.dc_factor);
        let level = (size + u64::from(self.dc_round << more)) >> (self.dc_shift + more);
        level as i32 * coefficient.signum()
    }

    /// The DC coefficients of the 16 luma blocks, back from the transform of their levels (clause 8.5.10).
    pub(super) fn luma_dc(&self, transformed: i32) -> i32 {
        (transformed * self.width[0] + 2) >> 2
    }

    /// The DC coefficients of the 4 blocks of a chroma plane, back from the transform of their levels (clause 8.5.11).
    pub(super) fn chroma_dc(&self, transformed: i32) -> i32 {
        (transformed * self.width[0]) >> 1
    }

    /// Levels to residuals: what the decoder adds to its prediction. `dc` takes the place of coefficient 0 where it went its own way.
    pub(super) fn restore<const N: usize>(&self, levels: &Lanes<N>, dc: Option<&[i32; N]>) -> Lanes<N> {
        let mut x = [[0i32; N]; 16];
        for i in 0..16 {
            for k in 0..N {
                x[i][k] = i32::from(levels[i][k]) * self.width[i];
            }
        }
        if let Some(dc) = dc {
            x[0] = *dc;
        }
        // Rows first: the halving rounds, so the order matters.
        for row in 0..4 {
            inverse(&mut x, [4 * row, 4 * row + 1, 4 * row + 2, 4 * row + 3]);
        }
        for column in 0..4 {
            inverse(&mut x, [column, 4 + column, 8 + column, 12 + column]);
        }
        x.map(|lanes| lanes.map(|v| ((v + 32) >> 6) as i16))
    }
}

/// The forward transform of differences, in place. Sizes grow from 255 to 36·255.
pub(super) fn transform<const N: usize>(x: &mut Lanes<N>) {
    for row in 0..4 {
        forward(x, [4 * row, 4 * row + 1, 4 * row + 2, 4 * row + 3]);
    }
    for column in 0..4 {
        forward(x, [column, 4 + column, 8 + column, 12 + column]);
    }
}

#[inline(always)]
fn forward<const N: usize>(x: &mut Lanes<N>, at: [usize; 4]) {
    let [a, b, c, d] = at.map(|i| x[i]);
    for k in 0..N {
        let (outer, inner) = (a[k] + d[k], b[k] + c[k]);
        let (wide, narrow) = (a[k] - d[k], b[k] - c[k]);
        x[at[0]][k] = outer + inner;
        x[at[1]][k] = 2 * wide + narrow;
        x[at[2]][k] = outer - inner;
        x[at[3]][k] = wide - 2 * narrow;
    }
}

#[inline(always)]
fn inverse<const N: usize>(x: &mut [[i32; N]; 16], at: [usize; 4]) {
    let [a, b, c, d] = at.map(|i| x[i]);
    for k in 0..N {
        let (even, odd) = (a[k] + c[k], a[k] - c[k]);
        let (low, high) = ((b[k] >> 1) - d[k], b[k] + (d[k] >> 1));
        x[at[0]][k] = even + high;
        x[at[1]][k] = odd + low;
        x[at[2]][k] = odd - low;
        x[at[3]][k] = even - high;
    }
}

/// The 4×4 Hadamard transform of numbers in rows.
pub(super) fn hadamard4(x: [i32; 16]) -> [i32; 16] {
    let line = |a: i32, b: i32, c: i32, d: i32| [a + b + c + d, a + b - c - d, a - b - c + d, a - b + c - d];
    let mut rows = [0; 16];
    for r in 0..4 {
        rows[4 * r..4 * r + 4].copy_from_slice(&line(x[4 * r], x[4 * r + 1], x[4 * r + 2], x[4 * r + 3]));
    }
    let mut out = [0; 16];
    for c in 0..4 {
        for (r, v) in line(rows[c], rows[4 + c], rows[8 + c], rows[12 + c])
            .into_iter()
            .enumerate()
        {
            out[4 * r + c] = v;
        }
    }
    out
}

/// The 2×2 Hadamard transform of numbers in rows.
pub(super) fn hadamard2([a, b, c, d]: [i32; 4]) -> [i32; 4] {
    [a + b + c + d, a - b + c - d, a + b - c - d, a - b - c + d]
}
