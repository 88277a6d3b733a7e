//! How far the lips are apart in a mouth image, and how far its corners, in pixels, from colour alone.
//!
//! Lips are redder than skin and teeth: ln(R/G) lies half-way between skin and lips at their border. Between the upper lip's first
//! row and the lower lip's last one, in the middle half of the mouth's width, what is not lip is the open mouth: teeth (too
//! little red) or the dark inside (too little light). The gap is that part of the rows, softly counted and averaged over columns.
//!
//! Levels are a speaker's own, learnt from his images without labels. Against landmarks made by another program
//! (GRID talker 1, 40 test clips; `tests/research_gap.rs` of `lipstream-make`) the correlation is 0.97. Of eleven other talkers, ten
//! sort rightly by eye; a bearded one with yellow teeth in yellow light does not, which the read-out's own correlation
//! shows (`closure` there).
//!
//! The width is the number of columns in which the lips are seen, softly counted.
use ndarray::{Array2, ArrayView3, ArrayView4, Axis, s};

/// Added to a channel before its logarithm, in levels: noise of dark pixels shall not count as colour.
const FLOOR: f32 = 8.0;
/// Share of the way from skin to lips over which a pixel turns from one to the other.
const SOFTNESS: f32 = 0.25;
/// Share of the way from skin to lips at which the corners of the mouth lie: lips pale towards them. Best of 0.3 to 0.7 on training clips of
/// GRID talker 1.
const CORNER: f32 = 0.3;
/// Of the lips' own luminance: the mouth's inside is darker than the first, no lip is darker than the second. The
/// line between closed lips has about 0.8, an open mouth without teeth 0.55 to 0.75.
const DARK: f32 = 0.58;
const LIGHT: f32 = 0.76;
/// Fewer rows of lips than this are no mouth.
const LEAST_ROWS: usize = 3;
/// Images from which the levels are learnt, at most.
pub const IMAGES: usize = 600;
/// Lips are closed at a gap below this share of the mouth's width: the best F1 against landmarks less than 1 px apart, on
/// training clips of GRID talker 1.
const CLOSED: f32 = 0.05;

/// A speaker's colours and the place of the mouth in his images.
#[derive(Clone, Debug, PartialEq)]
pub struct Lips {
    /// ln(R/G).
    skin: f32,
    lip: f32,
    /// Luminance of the lips, 0..255.
    light: f32,
    /// Rows and columns that are looked at.
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
    width: usize,
}

fn redness(pixel: &[u8; 3]) -> f32 {
    ((f32::from(pixel[0]) + FLOOR) / (f32::from(pixel[1]) + FLOOR)).ln()
}

fn luminance(pixel: &[u8; 3]) -> f32 {
    0.30 * f32::from(pixel[0]) + 0.59 * f32::from(pixel[1]) + 0.11 * f32::from(pixel[2])
}

fn at(image: &ArrayView3<u8>, row: usize, column: usize) -> [u8; 3] {
    std::array::from_fn(|k| image[[row, column, k]])
}

fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

impl Lips {
    /// Learns from images `[n, height, width, 3]`; `None` where nothing in them looks like lips.
    pub fn learn(images: ArrayView4<u8>) -> Option<Self> {
        let (n, height, width, _) = images.dim();
        if n == 0 || height < 8 || width < 8 {
            return None;
        }
        let red: Vec<Array2<f32>> = images
            .outer_iter()
            .map(|image| Array2::from_shape_fn((height, width), |(y, x)| redness(&at(&image, y, x))))
            .collect();
        let mut mean = Array2::zeros((height, width));
        red.iter().for_each(|r| mean += r);
        mean /= n as f32;
        let smooth = averaged(&mean);
        let inner =
            (height / 8..height * 7 / 8).flat_map(|y| (width / 4..width * 3 / 4).map(move |x| (y, x)));
        let seed = inner.max_by(|&a, &b| smooth[a].total_cmp(&smooth[b]))?;
        let skin = median(mean.iter().copied().collect());
        let lip = smooth[seed];
        if lip - skin < 0.05 {
            return None;
        }
        let middle = (skin + lip) / 2.0;
        let (centre, across) = extent(&blob(&mean, seed, middle))?;
        let half = across as f32 / 4.0;
        let columns =
            (centre - half).round().max(0.0) as usize..((centre + half).round() as usize + 1).min(width);
        // A row that the lips reach in one image of twenty belongs to the mouth.
        let reached: Vec<bool> = (0..height)
            .map(|y| {
                let mut values: Vec<f32> = red
                    .iter()
                    .map(|r| r.slice(s![y, columns.clone()]).mean().unwrap_or(0.0))
                    .collect();
                let place = values.len() * 19 / 20;
                *values.select_nth_unstable_by(place, f32::total_cmp).1 > middle
            })
            .collect();
        let top = (0..=seed.0).rev().take_while(|&y| reached[y]).last()?;
        let bottom = (seed.0..height).take_while(|&y| reached[y]).last()?;
        let lit: Vec<f32> = images
            .outer_iter()
            .zip(&red)
            .flat_map(|(image, red)| {
                let lips = red.indexed_iter().filter(|(_, r)| **r > (skin + 3.0 * lip) / 4.0);
                lips.map(|((y, x), _)| luminance(&at(&image, y, x)))
                    .collect::<Vec<_>>()
            })
            .collect();
        (!lit.is_empty()).then(|| Self {
            skin,
            lip,
            light: median(lit),
            rows: top..bottom + 1,
            columns,
            width: across,
        })
    }

    /// Width of the mouth at rest and speaking, on average, in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Gap in pixels below which the lips count as closed.
    pub fn closed_below(&self) -> f32 {
        CLOSED * self.width as f32
    }

    /// Gap of one image `[height, width, 3]` in pixels; `None` where no lips are seen.
    pub fn gap(&self, image: ArrayView3<u8>) -> Option<f32> {
        let middle = (self.skin + self.lip) / 2.0;
        let contrast = self.lip - self.skin;
        // Per row: how much of it is lip, and how much is the mouth's inside.
        let rows: Vec<(f32, f32)> = self
            .rows
            .clone()
            .map(|y| {
                let (mut lips, mut inside) = (0.0, 0.0);
                for x in self.columns.clone() {
                    let pixel = at(&image, y, x);
                    let lip = ((redness(&pixel) - middle) / contrast / SOFTNESS + 0.5).clamp(0.0, 1.0);
                    let dark = ((LIGHT - luminance(&pixel) / self.light) / (LIGHT - DARK)).clamp(0.0, 1.0);
                    lips += lip;
                    inside += dark.max(1.0 - lip);
                }
                let n = self.columns.len() as f32;
                (lips / n, inside / n)
            })
            .collect();
        let is_lip = |row: &(f32, f32)| row.0 > 0.5;
        if rows.iter().filter(|row| is_lip(row)).count() < LEAST_ROWS {
            return None;
        }
        let first = rows.iter().position(is_lip)?;
        let last = rows.iter().rposition(is_lip)?;
        Some(rows[first..=last].iter().map(|row| row.1).sum())
    }

    /// Distance of the corners in one image `[height, width, 3]` in pixels: of every column the share of lip in its three reddest neighbouring
    /// rows, added up over all columns.
    pub fn corners(&self, image: ArrayView3<u8>) -> f32 {
        let contrast = self.lip - self.skin;
        let border = self.skin + CORNER * contrast;
        let columns = 0..image.dim().1;
        let reddest = |x: usize| {
            let red: Vec<f32> = self.rows.clone().map(|y| redness(&at(&image, y, x))).collect();
            let three = red.windows(3).map(|w| (w[0] + w[1] + w[2]) / 3.0);
            three.fold(f32::NEG_INFINITY, f32::max)
        };
        columns
            .map(|x| ((reddest(x) - border) / contrast / SOFTNESS + 0.5).clamp(0.0, 1.0))
            .sum()
    }

    /// Gaps of images `[n, height, width, 3]`; where no lips are seen, that of the nearest image before (at the start: after).
    pub fn gaps(&self, images: ArrayView4<u8>) -> Option<Vec<f32>> {
        let found: Vec<Option<f32>> = images.axis_iter(Axis(0)).map(|image| self.gap(image)).collect();
        let mut last = found.iter().flatten().next().copied()?;
        Some(
            found
                .into_iter()
                .map(|gap| {
                    last = gap.unwrap_or(last);
                    last
                })
                .collect(),
        )
    }
}

/// Mean over 5 × 5 pixels, edges over what there is.
fn averaged(map: &Array2<f32>) -> Array2<f32> {
    let (height, width) = map.dim();
    Array2::from_shape_fn((height, width), |(y, x)| {
        let (top, bottom) = (y.saturating_sub(2), (y + 3).min(height));
        let (left, right) = (x.saturating_sub(2), (x + 3).min(width));
        map.slice(s![top..bottom, left..right]).mean().unwrap_or(0.0)
    })
}

/// Pixels above `level` that hang together with `seed`.
fn blob(map: &Array2<f32>, seed: (usize, usize), level: f32) -> Array2<bool> {
    let (height, width) = map.dim();
    let mut found = Array2::from_elem((height, width), false);
    found[seed] = true;
    let mut open = vec![seed];
    while let Some((y, x)) = open.pop() {
        let neighbours = [
            (y.wrapping_sub(1), x),
            (y + 1, x),
            (y, x.wrapping_sub(1)),
            (y, x + 1),
        ];
        for place in neighbours {
            if place.0 < height && place.1 < width && map[place] > level && !found[place] {
                found[place] = true;
                open.push(place);
            }
        }
    }
    found
}

/// Mean column of a blob, and the number of columns that it touches.
fn extent(blob: &Array2<bool>) -> Option<(f32, usize)> {
    let (mut sum, mut n, mut touched) = (0.0, 0.0, 0);
    for (x, column) in blob.axis_iter(Axis(1)).enumerate() {
        let count = column.iter().filter(|b| **b).count();
        sum += (x * count) as f32;
        n += count as f32;
        touched += usize::from(count > 0);
    }
    (n > 0.0).then(|| (sum / n, touched))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::drawn::{HEIGHT, Pose, WIDTH, draw};
    use ndarray::Array4;

    fn poses() -> Vec<Pose> {
        (0..60)
            .map(|n| Pose {
                open: (n % 10) as f32 / 9.0,
                round: (n / 10 % 3) as f32 / 2.0 * 0.8,
                spread: if n / 30 == 1 { 0.7 } else { 0.0 },
            })
            .collect()
    }

    fn images(poses: &[Pose], colours: [f32; 3]) -> Array4<u8> {
        let mut out = Array4::zeros((poses.len(), HEIGHT, WIDTH, 3));
        for (mut image, &pose) in out.outer_iter_mut().zip(poses) {
            for (k, (to, from)) in image.iter_mut().zip(&draw(pose)).enumerate() {
                *to = (from * colours[k % 3]).round() as u8; // `as` saturates
            }
        }
        out
    }

    /// Height of the drawn opening in the middle half of the mouth; see `render::drawn::draw`.
    fn drawn_gap(pose: Pose) -> f32 {
        let gap = 0.4 + 11.0 * pose.open * (1.0 - 0.35 * pose.round);
        // The mean of √(1 − x²) over |x| ≤ ½.
        0.957 * gap
    }

    fn correlation(a: &[f32], b: &[f32]) -> f32 {
        let n = a.len() as f32;
        let mean = |v: &[f32]| v.iter().sum::<f32>() / n;
        let (ma, mb) = (mean(a), mean(b));
        let sum = |f: &dyn Fn(f32, f32) -> f32| a.iter().zip(b).map(|(x, y)| f(x - ma, y - mb)).sum::<f32>();
        sum(&|x, y| x * y) / (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt()
    }

    /// White, warm and cool light.
    #[test]
    fn drawn_gaps_are_found_in_any_light() {
        let poses = poses();
        let true_gaps: Vec<f32> = poses.iter().map(|&p| drawn_gap(p)).collect();
        for colours in [[1.0; 3], [1.0, 0.8, 0.6], [0.7, 0.75, 0.9], [0.5; 3]] {
            let images = images(&poses, colours);
            let lips = Lips::learn(images.view()).unwrap();
            let found = lips.gaps(images.view()).unwrap();
            let r = correlation(&found, &true_gaps);
            assert!(r > 0.95, "{colours:?}: {r} {lips:?} {found:?} {true_gaps:?}");
            for (pose, gap) in poses.iter().zip(&found) {
                assert_eq!(pose.open == 0.0, *gap < lips.closed_below(), "{pose:?}: {gap}");
            }
        }
    }

    #[test]
    fn a_wall_has_no_lips() {
        assert_eq!(Lips::learn(Array4::from_elem((5, 48, 64, 3), 128).view()), None);
        assert_eq!(Lips::learn(Array4::zeros((0, 48, 64, 3)).view()), None);
        assert_eq!(Lips::learn(Array4::zeros((3, 2, 2, 3)).view()), None);
    }

    #[test]
    fn hidden_lips_keep_the_gap_before() {
        let poses = poses();
        let mut images = images(&poses, [1.0; 3]);
        let lips = Lips::learn(images.view()).unwrap();
        let before = lips.gap(images.index_axis(Axis(0), 6)).unwrap();
        images.index_axis_mut(Axis(0), 7).fill(128);
        assert_eq!(lips.gap(images.index_axis(Axis(0), 7)), None);
        assert_eq!(lips.gaps(images.view()).unwrap()[7], before);
    }
}
