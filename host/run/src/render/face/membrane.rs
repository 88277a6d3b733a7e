//! Poisson cloning (Pérez, Gangnet & Blake 2003; X&L section 6.2, reference 44) as a membrane.
//!
//! Cloned is the gradient of a source g into a background f*: inside a region Δf = Δg, and f = f* at its border. Their difference h = f − g
//! then has Δh = 0 and is f* − g at the border: a membrane over the frame of the border's differences. It is as smooth as can be, so that it is found on a
//! coarse grid (Jacobi's five-point equation, relaxed in place) and added to the source at whatever resolution that has.

/// A region of a grid, and the membrane over it.
#[derive(Clone, Debug)]
pub struct Membrane {
    width: usize,
    height: usize,
    /// Which nodes lie inside, and their numbers.
    within: Vec<bool>,
    inside: Vec<usize>,
    /// Nodes outside that have a neighbour inside.
    border: Vec<usize>,
    /// The membrane at every node, red, green, blue; 0 far outside.
    levels: Vec<[f32; 3]>,
    /// Relaxation factor.
    omega: f32,
    /// Whether nothing is known of a membrane before.
    anew: bool,
}

/// The membrane is found when no node moves further than this in a round, in levels of 0..255.
const STILL: f32 = 0.02;
/// The same where it starts from nothing: it ends as near as one that has followed many pictures.
const STILL_ANEW: f32 = 0.002;
const MOST_ROUNDS: usize = 1000;

impl Membrane {
    /// Over the nodes of a grid of `width` × `height` that `is_inside` names; those at the grid's edge never are.
    pub fn new(width: usize, height: usize, is_inside: impl Fn(usize, usize) -> bool) -> Self {
        let mut within = vec![false; width * height];
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                within[y * width + x] = is_inside(x, y);
            }
        }
        let inside: Vec<usize> = (0..within.len()).filter(|at| within[*at]).collect();
        let has_neighbour = |at: usize| {
            let (x, y) = (at % width, at / width);
            (x > 0 && within[at - 1])
                || (x + 1 < width && within[at + 1])
                || (y > 0 && within[at - width])
                || (y + 1 < height && within[at + width])
        };
        let border = (0..within.len())
            .filter(|at| !within[*at] && has_neighbour(*at))
            .collect();
        // The factor that is best for a square of the region's size.
        let size = (inside.len() as f32).sqrt().max(1.0);
        Self {
            width,
            height,
            within,
            inside,
            border,
            levels: vec![[0.0; 3]; width * height],
            omega: 2.0 / (1.0 + (std::f32::consts::PI / (size + 1.0)).sin()),
            anew: true,
        }
    }

    /// Forgets the membrane before: what is laid next depends on its own border alone.
    pub fn begin_anew(&mut self) {
        self.levels.fill([0.0; 3]);
        self.anew = true;
    }

    /// Lays the membrane over the border's differences, `difference(x, y)` at each of its nodes, in levels; where there is none the border is free and follows the
    /// membrane. It starts from the one before, which is near where pictures follow each other.
    pub fn lay(&mut self, difference: impl Fn(usize, usize) -> Option<[f32; 3]>) {
        let still = if std::mem::take(&mut self.anew) {
            STILL_ANEW
        } else {
            STILL
        };
        let mut free = Vec::new();
        for at in &self.border {
            match difference(at % self.width, at / self.width) {
                Some(levels) => self.levels[*at] = levels,
                None => free.push(*at),
            }
        }
        for _ in 0..MOST_ROUNDS {
            let mut furthest = 0.0f32;
            for at in &free {
                self.levels[*at] = self.beside(*at);
            }
            for &at in &self.inside {
                let [left, right] = [self.levels[at - 1], self.levels[at + 1]];
                let [above, below] = [self.levels[at - self.width], self.levels[at + self.width]];
                let level = &mut self.levels[at];
                for c in 0..3 {
                    let step = 0.25 * (left[c] + right[c] + above[c] + below[c]) - level[c];
                    level[c] += self.omega * step;
                    furthest = furthest.max(step.abs());
                }
            }
            if furthest < still {
                break;
            }
        }
    }

    /// Mean of those neighbours of a node that lie inside.
    fn beside(&self, at: usize) -> [f32; 3] {
        let (x, y) = (at % self.width, at / self.width);
        let neighbours = [
            (x > 0).then(|| at - 1),
            (x + 1 < self.width).then(|| at + 1),
            (y > 0).then(|| at - self.width),
            (y + 1 < self.height).then(|| at + self.width),
        ];
        let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
        for neighbour in neighbours.into_iter().flatten().filter(|at| self.within[*at]) {
            let levels = self.levels[neighbour];
            sum = std::array::from_fn(|c| sum[c] + levels[c]);
            count += 1.0;
        }
        sum.map(|sum| sum / count.max(1.0))
    }

    /// The membrane between nodes, bilinear.
    pub fn at(&self, x: f32, y: f32) -> [f32; 3] {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (
            (x as usize).min(self.width.saturating_sub(2)),
            (y as usize).min(self.height.saturating_sub(2)),
        );
        let (u, v) = (x - left as f32, y - top as f32);
        let row = |y: usize| [left, (left + 1).min(self.width - 1)].map(|x| self.levels[y * self.width + x]);
        let [[a, b], [c, d]] = [row(top), row((top + 1).min(self.height - 1))];
        std::array::from_fn(|k| (a[k] * (1.0 - u) + b[k] * u) * (1.0 - v) + (c[k] * (1.0 - u) + d[k] * u) * v)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A harmonic function is its own membrane: x² − y², xy and a slope solve the five-point equation exactly.
    #[test]
    fn harmonic_functions_are_found() {
        let inside = |x: usize, y: usize| {
            let (u, v) = ((x as f32 - 31.5) / 28.0, (y as f32 - 23.5) / 20.0);
            u.powi(4) + v.powi(4) < 1.0
        };
        let mut membrane = Membrane::new(64, 48, inside);
        let harmonic = |x: usize, y: usize| {
            let (x, y) = (x as f32 - 30.0, y as f32 - 20.0);
            [(x * x - y * y) / 10.0, x * y / 10.0, 40.0 + x - 2.0 * y]
        };
        membrane.lay(|x, y| Some(harmonic(x, y)));
        for y in 0..48 {
            for x in 0..64 {
                if inside(x, y) {
                    let (found, wanted) = (membrane.at(x as f32, y as f32), harmonic(x, y));
                    for c in 0..3 {
                        assert!(
                            (found[c] - wanted[c]).abs() < 0.5,
                            "{x} {y} {c}: {found:?} {wanted:?}"
                        );
                    }
                }
            }
        }
    }

    /// The membrane never leaves the range of its border (the maximum principle), and a flat border gives a flat membrane.
    #[test]
    fn it_stays_within_its_border() {
        let mut membrane = Membrane::new(40, 30, |x, y| x > 2 && y > 2 && x < 35 && y < 25);
        membrane.lay(|x, _| Some([if x < 20 { 50.0 } else { -10.0 }, 7.0, 0.0]));
        for y in 3..25 {
            for x in 3..35 {
                let [a, b, c] = membrane.at(x as f32, y as f32);
                assert!((-10.1..=50.1).contains(&a) && (b - 7.0).abs() < 0.3 && c == 0.0);
            }
        }
        // From where it was, another border is reached as well.
        membrane.lay(|_, _| Some([3.0; 3]));
        assert!(membrane.at(20.0, 15.0).iter().all(|v| (v - 3.0).abs() < 0.3));
        // A border that is free on one side is what the other sides say.
        membrane.lay(|x, _| (x < 30).then_some([9.0; 3]));
        assert!(membrane.at(33.0, 15.0).iter().all(|v| (v - 9.0).abs() < 0.5));
    }
}
