//! What a macroblock of a key picture is expected to look like, from its neighbours (ITU-T H.264, clauses 8.3.3 and 8.3.4).

/// The samples around a square of `N`×`N`, as far as there are any.
pub(super) struct Around<const N: usize> {
    pub(super) above: Option<[u8; N]>,
    pub(super) left: Option<[u8; N]>,
    /// Above and to the left of the first sample; only looked at where there are both.
    pub(super) corner: u8,
}

/// Ways to continue the neighbours' samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Vertical,
    Horizontal,
    Mean,
    Plane,
}

impl Way {
    pub(super) const ALL: [Way; 4] = [Way::Mean, Way::Vertical, Way::Horizontal, Way::Plane];

    /// Its number for luma (table 8-4).
    pub(super) fn luma(self) -> u32 {
        match self {
            Way::Vertical => 0,
            Way::Horizontal => 1,
            Way::Mean => 2,
            Way::Plane => 3,
        }
    }

    /// Its number for chroma (table 8-5).
    pub(super) fn chroma(self) -> u32 {
        match self {
            Way::Mean => 0,
            Way::Horizontal => 1,
            Way::Vertical => 2,
            Way::Plane => 3,
        }
    }
}

impl<const N: usize> Around<N> {
    /// Rows of samples continued in one way; `None` where the neighbours for it are missing.
    pub(super) fn continued<const AREA: usize>(&self, way: Way) -> Option<[u8; AREA]> {
        let mut out = [0; AREA];
        match way {
            Way::Vertical => {
                let above = self.above?;
                out.chunks_exact_mut(N)
                    .for_each(|row| row.copy_from_slice(&above));
            }
            Way::Horizontal => {
                let left = self.left?;
                out.chunks_exact_mut(N).zip(left).for_each(|(row, v)| row.fill(v));
            }
            Way::Mean if N == 8 => self.means_of_quarters(&mut out),
            Way::Mean => {
                let mean = mean(self.above.iter().chain(&self.left).map(|side| &side[..]));
                out.fill(mean);
            }
            Way::Plane => self.plane(&mut out)?,
        }
        Some(out)
    }

    /// Chroma's means: each quarter by the neighbours beside it, where the upper right one prefers those above and the lower left one those
    /// to the left.
    fn means_of_quarters(&self, out: &mut [u8]) {
        for (quarter, (x, y)) in [(0, 0), (4, 0), (0, 4), (4, 4)].into_iter().enumerate() {
            let above = self.above.as_ref().map(|side| &side[x..x + 4]);
            let left = self.left.as_ref().map(|side| &side[y..y + 4]);
            let value = match (quarter, above, left) {
                (1, Some(above), _) => mean([above]),
                (2, _, Some(left)) => mean([left]),
                _ => mean(above.into_iter().chain(left)),
            };
            for row in y..y + 4 {
                out[row * N + x..row * N + x + 4].fill(value);
            }
        }
    }

    /// The plane through the neighbours.
    fn plane(&self, out: &mut [u8]) -> Option<()> {
        let half = N / 2;
        let slope = |side: &[u8; N]| -> i32 {
            (0..half)
                .map(|i| {
                    let before = if i + 1 == half {
                        self.corner
                    } else {
                        side[half - 2 - i]
                    };
                    (i as i32 + 1) * (i32::from(side[half + i]) - i32::from(before))
                })
                .sum()
        };
        let (above, left) = (self.above?, self.left?);
        let (h, v) = (slope(&above), slope(&left));
        let (b, c) = match N {
            16 => ((5 * h + 32) >> 6, (5 * v + 32) >> 6),
            _ => ((17 * h + 16) >> 5, (17 * v + 16) >> 5),
        };
        let a = 16 * (i32::from(above[N - 1]) + i32::from(left[N - 1]));
        let middle = half as i32 - 1;
        for (i, sample) in out.iter_mut().enumerate() {
            let (x, y) = ((i % N) as i32 - middle, (i / N) as i32 - middle);
            *sample = ((a + b * x + c * y + 16) >> 5).clamp(0, 255) as u8;
        }
        Some(())
    }
}

/// The rounded mean of all samples; 128 of none. Their number is a power of two.
fn mean<'s>(sides: impl IntoIterator<Item = &'s [u8]>) -> u8 {
    let (mut sum, mut count) = (0, 0);
    for side in sides {
        sum += side.iter().map(|&v| u32::from(v)).sum::<u32>();
        count += side.len() as u32;
    }
    match count {
        0 => 128,
        _ => ((sum + count / 2) / count) as u8,
    }
}
