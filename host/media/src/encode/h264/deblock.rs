//! The filter that smooths the edges of blocks (ITU-T H.264, clause 8.7), for pictures whose macroblocks all have one quantiser.
//!
//! Pictures are predicted from filtered ones, so that it also keeps coding errors from adding up: without it, mouths came out 1 dB worse
//! at the same size.
use super::macroblock::Counts;
use super::motion::Field;
use crate::encode::colour::Picture;

/// How far the samples on both sides of an edge may differ, and how much they may change, at one quantiser (tables 8-16 and 8-17).
pub(super) struct Filter {
    /// Differences across an edge from here on are no coding errors.
    alpha: i16,
    /// Differences beside an edge from here on are none either.
    beta: i16,
    /// Largest change by strength 1 to 3.
    change: [i16; 3],
}

impl Filter {
    /// For a `qp` of 16 to 25.
    pub(super) const fn new(qp: u8) -> Self {
        const ALPHA: [i16; 10] = [4, 4, 5, 6, 7, 8, 9, 10, 12, 13];
        const BETA: [i16; 10] = [2, 2, 2, 3, 3, 3, 3, 4, 4, 4];
        const CHANGE: [[i16; 3]; 10] = [
            [0, 0, 0],
            [0, 0, 1],
            [0, 0, 1],
            [0, 0, 1],
            [0, 0, 1],
            [0, 1, 1],
            [0, 1, 1],
            [1, 1, 1],
            [1, 1, 1],
            [1, 1, 1],
        ];
        let at = qp as usize - 16;
        Self {
            alpha: ALPHA[at],
            beta: BETA[at],
            change: CHANGE[at],
        }
    }

    /// Filters a key picture.
    pub(super) fn key(&self, picture: &mut Picture) {
        self.picture(picture, |_, _, _, edge| match edge {
            0 => [4; 4],
            _ => [3; 4],
        });
    }

    /// Filters a picture of macroblocks that were moved by `field` and changed where `counts` are not 0.
    pub(super) fn changed(&self, picture: &mut Picture, field: &Field, counts: &Counts) {
        self.picture(picture, |direction, column, row, edge| {
            let (back, along) = match direction {
                Direction::Right => ((1, 0), (0, 1)),
                Direction::Down => ((0, 1), (1, 0)),
            };
            let apart = edge == 0 && field.apart((column, row), (column - back.0, row - back.1));
            std::array::from_fn(|k| {
                let x = 4 * column + edge * back.0 + k * along.0;
                let y = 4 * row + edge * back.1 + k * along.1;
                match counts.coded(x, y) || counts.coded(x - back.0, y - back.1) {
                    true => 2,
                    false => u8::from(apart),
                }
            })
        });
    }

    /// Filters all edges, macroblock by macroblock; `strengths` gives those of the four pieces of an edge 0 to 3 of a macroblock.
    fn picture(&self, picture: &mut Picture, strengths: impl Fn(Direction, usize, usize, usize) -> [u8; 4]) {
        let width = picture.width;
        for row in 0..picture.height / 16 {
            for column in 0..width / 16 {
                for direction in [Direction::Right, Direction::Down] {
                    let outside = match direction {
                        Direction::Right => column == 0,
                        Direction::Down => row == 0,
                    };
                    for edge in usize::from(outside)..4 {
                        let strengths = strengths(direction, column, row, edge);
                        if strengths == [0; 4] {
                            continue;
                        }
                        let (at, lines) = direction.edge(16, width, (column, row), 4 * edge);
                        self.luma(&mut picture.y, at, lines, strengths);
                        if edge % 2 == 0 {
                            let (at, lines) = direction.edge(8, width / 2, (column, row), 2 * edge);
                            self.chroma(&mut picture.cb, at, lines, strengths);
                            self.chroma(&mut picture.cr, at, lines, strengths);
                        }
                    }
                }
            }
        }
    }

    /// Whether the samples beside an edge are close enough to each other for it to be filtered.
    #[inline(always)]
    fn applies(&self, [p1, p0, q0, q1]: [i16; 4]) -> bool {
        (p0 - q0).abs() < self.alpha && (p1 - p0).abs() < self.beta && (q1 - q0).abs() < self.beta
    }

    fn luma(&self, plane: &mut [u8], at: usize, lines: Lines, strengths: [u8; 4]) {
        for line in 0..16 {
            let strength = strengths[line / 4];
            if strength == 0 {
                continue;
            }
            let at = at + line * lines.along;
            let get = |plane: &[u8], k: usize| i16::from(plane[at + k * lines.across - 4 * lines.across]);
            let [p2, p1, p0, q0, q1, q2] = std::array::from_fn(|k| get(plane, k + 1));
            if !self.applies([p1, p0, q0, q1]) {
                continue;
            }
            let flat = ((p2 - p0).abs() < self.beta, (q2 - q0).abs() < self.beta);
            let mut set =
                |k: usize, value: i16| plane[at + k * lines.across - 4 * lines.across] = value as u8;
            if strength < 4 {
                let most = self.change[usize::from(strength) - 1];
                let delta = step([p1, p0, q0, q1], most + i16::from(flat.0) + i16::from(flat.1));
                let middle = (p0 + q0 + 1) >> 1;
                if flat.0 {
                    set(2, p1 + ((p2 + middle - 2 * p1) >> 1).clamp(-most, most));
                }
                if flat.1 {
                    set(5, q1 + ((q2 + middle - 2 * q1) >> 1).clamp(-most, most));
                }
                set(3, (p0 + delta).clamp(0, 255));
                set(4, (q0 - delta).clamp(0, 255));
                continue;
            }
            let close = (p0 - q0).abs() < (self.alpha >> 2) + 2;
            let (p3, q3) = (get(plane, 0), get(plane, 7));
            for (flat, [x3, x2, x1, x0, y0, y1], places) in [
                (flat.0, [p3, p2, p1, p0, q0, q1], [1, 2, 3]),
                (flat.1, [q3, q2, q1, q0, p0, p1], [6, 5, 4]),
            ] {
                let mut set =
                    |k: usize, value: i16| plane[at + k * lines.across - 4 * lines.across] = value as u8;
                if close && flat {
                    set(places[0], (2 * x3 + 3 * x2 + x1 + x0 + y0 + 4) >> 3);
                    set(places[1], (x2 + x1 + x0 + y0 + 2) >> 2);
                    set(places[2], (x2 + 2 * x1 + 2 * x0 + 2 * y0 + y1 + 4) >> 3);
                } else {
                    set(places[2], (2 * x1 + x0 + y1 + 2) >> 2);
                }
            }
        }
    }

    fn chroma(&self, plane: &mut [u8], at: usize, lines: Lines, strengths: [u8; 4]) {
        for line in 0..8 {
            let strength = strengths[line / 2];
            let at = at + line * lines.along;
            let place = |k: usize| at + k * lines.across - 2 * lines.across;
            let [p1, p0, q0, q1] = std::array::from_fn(|k| i16::from(plane[place(k)]));
            if strength == 0 || !self.applies([p1, p0, q0, q1]) {
                continue;
            }
            let (p, q) = if strength < 4 {
                let delta = step([p1, p0, q0, q1], self.change[usize::from(strength) - 1] + 1);
                (p0 + delta, q0 - delta)
            } else {
                ((2 * p1 + p0 + q1 + 2) >> 2, (2 * q1 + q0 + p1 + 2) >> 2)
            };
            plane[place(1)] = p.clamp(0, 255) as u8;
            plane[place(2)] = q.clamp(0, 255) as u8;
        }
    }
}

/// What the samples at an edge come closer by, `most` at most.
#[inline(always)]
fn step([p1, p0, q0, q1]: [i16; 4], most: i16) -> i16 {
    ((4 * (q0 - p0) + (p1 - q1) + 4) >> 3).clamp(-most, most)
}

/// Across which edges.
#[derive(Clone, Copy)]
enum Direction {
    Right,
    Down,
}

/// From sample to sample across an edge and along it.
#[derive(Clone, Copy)]
struct Lines {
    across: usize,
    along: usize,
}

impl Direction {
    /// The first sample beyond the edge that is `off` samples inside the macroblock of `size` samples at (column, row), and the ways from
    /// there.
    fn edge(self, size: usize, width: usize, (column, row): (usize, usize), off: usize) -> (usize, Lines) {
        let corner = size * (row * width + column);
        match self {
            Direction::Right => (
                corner + off,
                Lines {
                    across: 1,
                    along: width,
                },
            ),
            Direction::Down => (
                corner + off * width,
                Lines {
                    across: width,
                    along: 1,
                },
            ),
        }
    }
}
