//! How the mouths of a recording look: where the model's rectangle lies on them, their mean at the recording's own resolution, and their fine detail.
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

use super::footage::Footage;
use super::raster::{Floats, coarse_at, luminance, spread};
use crate::affine::Affine;
use crate::error::{Result, bail};
use crate::mouth::MouthSpace;
use crate::opening::{Opening, OpeningReader};
use crate::render::refine::{CANDIDATES, Candidates, typical};

/// Whose mouth is drawn, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Whose {
    /// The recording's own mean, moved by the model's eigenmouths: the model was trained on whom it shows.
    Trained,
    /// The recording's own mouths, of which one is chosen that is as open and as wide as the model's: the model was trained on somebody else.
    Opened,
    /// The model's, in the recording's light, as the paper puts it onto videos of strangers.
    Models,
}

/// Pictures of a recording that its mouths are learnt from, at most.
const MOST_MOUTHS: usize = 1500;
/// Mouths of a recording are drawn with at most so many pixels for one of the rectangle's.
const MOST_SHARP: usize = 4;
/// The model's eigenmouths say at least so much of the variance of a recording of whom it was trained on (measured: docs/rendering.md).
const OWN: f32 = 0.72;
/// A mouth that is closed instead of wide open is as bad as a change of so many levels in every pixel; the same for one that is narrow instead of wide.
const GAP_LEVELS: f32 = 60.0;
const WIDTH_LEVELS: f32 = 15.0;
/// The same for a head that is turned by half of the distance from the nose to an eye.
const TURNED_LEVELS: f32 = 60.0;
/// A mouth is as wide open, as wide or as narrow as it ever is in speech so many deviations from its mean, as in [`crate::opening`].
const FAR: f32 = 2.0;

/// Where the model's mouth lies in the recording's rectangle, and in which light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// From pixels of the recording's rectangle to the model's.
    pub to_model: Affine,
    /// Correlation of the two mean mouths there.
    pub likeness: f32,
    /// What brings the model's levels to the recording's: gain and offset of red, green, blue.
    pub light: [(f32, f32); 3],
}

/// The mouths of a recording.
#[derive(Clone, Debug)]
pub struct Mouths {
    /// Size of the recording's rectangle, pixels.
    size: (usize, usize),
    /// Pixels of a drawn mouth for one of the rectangle's.
    sharp: usize,
    fit: Fit,
    whose: Whose,
    /// `[height·sharp · width·sharp · 3]`: the recording's mean, or the model's in its light.
    mean: Array1<f32>,
    /// Of the recording's mouths, as the model's eigenmouths see them.
    candidates: Candidates,
    /// Share of the variance of the recording's mouths that the model's eigenmouths say.
    explained: f32,
    /// What the mouths of some pictures are found by, and which pictures these are.
    keys: Array2<f32>,
    learnt_from: Vec<usize>,
    /// Reads the keys of [`Whose::Opened`] out of parameters.
    opening: Option<OpeningReader>,
}

impl Mouths {
    /// Learns how the mouths of a recording look, `candidates` of them by heart; `whose` mouth is drawn is found out where it is not said.
    ///
    /// # Errors
    ///
    /// That the recording has no picture or cannot be read.
    pub fn learn(
        footage: &mut Footage,
        space: &MouthSpace,
        whose: Option<Whose>,
        candidates: usize,
    ) -> Result<Self> {
        let size = footage.mouth;
        let sharp = (footage.scale().round() as usize).clamp(1, MOST_SHARP);
        let step = footage.places.len().div_ceil(MOST_MOUTHS).max(1);
        let learnt_from: Vec<usize> = (0..footage.places.len()).step_by(step).collect();
        if learnt_from.is_empty() {
            bail!(Data, "a background without pictures");
        }
        let seen = sampled(footage, &learnt_from, sharp)?;
        let wide = (size.0 * sharp, size.1 * sharp);
        let mean = seen.map_axis(Axis(0), |levels| {
            levels.iter().map(|v| f32::from(*v)).sum::<f32>() / levels.len() as f32
        });
        let fit = fitted(&small(&mean, wide, sharp), size, space);
        let brush = Brush { size, sharp, fit };
        // As the model sees them: in its rectangle and its light, without their mean.
        let mut weights = Array2::zeros((learnt_from.len(), space.size()));
        for (image, mut row) in seen.outer_iter().zip(weights.outer_iter_mut()) {
            let difference: Array1<f32> = image.iter().zip(&mean).map(|(v, m)| f32::from(*v) - m).collect();
            row.assign(&brush.weights(&difference, space));
        }
        if let Some(middle) = weights.mean_axis(Axis(0)) {
            weights -= &middle;
        }
        let chosen = typical(weights.view(), candidates);
        let (mut rest, mut all) = (0.0f64, 0.0f64);
        let mut details = Array2::zeros((chosen.len(), mean.len()));
        let mut at = 0;
        for (n, image) in seen.outer_iter().enumerate() {
            let is_chosen = chosen.get(at) == Some(&n);
            // The share is counted on some of them.
            if !is_chosen && n % 7 != 0 {
                continue;
            }
            let moved = brush.moved(space, weights.row(n));
            let detail: Array1<f32> = image
                .iter()
                .zip(&mean)
                .zip(&moved)
                .map(|((v, m), moved)| f32::from(*v) - m - moved)
                .collect();
            rest += detail.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
            all += image
                .iter()
                .zip(&mean)
                .map(|(v, m)| f64::from(f32::from(*v) - m).powi(2))
                .sum::<f64>();
            if is_chosen {
                details.row_mut(at).assign(&detail);
                at += 1;
            }
        }
        let explained = if all > 0.0 { (1.0 - rest / all) as f32 } else { 0.0 };
        let opening = OpeningReader::of(space);
        let openings = openings(footage, &learnt_from);
        let whose = whose.unwrap_or(match (explained >= OWN, &opening, &openings) {
            (true, ..) => Whose::Trained,
            (false, Some(_), Some(_)) => Whose::Opened,
            _ => Whose::Models,
        });
        let mut mouths = Self {
            size,
            sharp,
            fit,
            whose,
            candidates: Candidates::new(weights.select(Axis(0), &chosen), details.view())?,
            mean,
            explained,
            keys: weights,
            learnt_from,
            opening: None,
        };
        match (whose, opening, openings) {
            (Whose::Trained, ..) => {}
            (Whose::Models, ..) => mouths.mean = brush.lit(&space.mean, space),
            (Whose::Opened, Some(opening), Some((rows, openings))) => {
                mouths.open_by(opening, &rows, openings, &seen)?;
            }
            (Whose::Opened, ..) => bail!(
                Choice,
                "the lips are not seen in this recording or this model: its own mouths cannot be chosen by their opening"
            ),
        }
        Ok(mouths)
    }

    /// Finds mouths by their opening: `rows` of what was seen, with their openings `[n, 3]`.
    fn open_by(
        &mut self,
        opening: OpeningReader,
        rows: &[usize],
        openings: Array2<f32>,
        seen: &Array2<u8>,
    ) -> Result<()> {
        let keys = scaled(openings, seen.ncols());
        let step = rows.len().div_ceil(CANDIDATES).max(1);
        let chosen: Vec<usize> = (0..rows.len()).step_by(step).collect();
        let mut details = Array2::zeros((chosen.len(), seen.ncols()));
        for (n, mut detail) in chosen.iter().zip(details.outer_iter_mut()) {
            detail.assign(&(&seen.row(rows[*n]).mapv(f32::from) - &self.mean));
        }
        self.candidates = Candidates::new(keys.select(Axis(0), &chosen), details.view())?;
        self.learnt_from = rows.iter().map(|row| self.learnt_from[*row]).collect();
        self.keys = keys;
        self.opening = Some(opening);
        Ok(())
    }

    /// What mouths are found by, of parameters `[T, D]`: themselves, or what they open.
    ///
    /// `turned` says how far the background's head is turned in each picture, `[T]`.
    pub fn keys(&self, tracks: ArrayView2<f32>, turned: &[f32]) -> Array2<f32> {
        let Some(opening) = &self.opening else {
            return tracks.to_owned();
        };
        let mut openings = Array2::zeros((tracks.nrows(), 3));
        for ((row, turned), mut to) in tracks.outer_iter().zip(turned).zip(openings.outer_iter_mut()) {
            let Opening { gap, width } = opening.read(&row.to_vec());
            to.assign(&ArrayView1::from(&[gap, width, *turned]));
        }
        scaled(openings, self.mean.len())
    }

    /// Where the model's mouth lies on the recording's.
    pub fn fit(&self) -> Fit {
        self.fit
    }

    /// Whose mouth is drawn.
    pub fn whose(&self) -> Whose {
        self.whose
    }

    /// Share of the variance of the recording's mouths that the model's eigenmouths say, at most 1.
    pub fn explained(&self) -> f32 {
        self.explained
    }

    /// Pixels of a drawn mouth for one of the rectangle's.
    pub fn sharp(&self) -> usize {
        self.sharp
    }

    /// The mouths that lend their detail.
    pub fn candidates(&self) -> &Candidates {
        &self.candidates
    }

    /// What recorded mouths are found by, `[N, D]`, and the pictures they are of.
    pub fn seen(&self) -> (&Array2<f32>, &[usize]) {
        (&self.keys, &self.learnt_from)
    }

    /// A mouth `[height·sharp, width·sharp, 3]` from weights `[D]`, with a detail in levels, where there is one.
    pub fn draw(&self, space: &MouthSpace, weights: ArrayView1<f32>, detail: Option<&[f32]>) -> Vec<f32> {
        let brush = Brush {
            size: self.size,
            sharp: self.sharp,
            fit: self.fit,
        };
        let mut image = match self.whose {
            // The detail of such a mouth is all of it.
            Whose::Opened => vec![0.0; self.mean.len()],
            Whose::Trained | Whose::Models => brush.moved(space, weights),
        };
        image.iter_mut().zip(&self.mean).for_each(|(v, m)| *v += m);
        if let Some(detail) = detail {
            image.iter_mut().zip(detail).for_each(|(v, d)| *v += d);
        }
        image
    }
}

/// Rows of those pictures in which lips are seen, and their openings `[n, 3]` as [`Opening`] counts them, with how far the head is turned; None where that is less than half of them.
fn openings(footage: &Footage, pictures: &[usize]) -> Option<(Vec<usize>, Array2<f32>)> {
    let seen: Vec<(usize, (f32, f32))> = pictures
        .iter()
        .enumerate()
        .filter_map(|(row, picture)| Some((row, footage.places[*picture].lips?)))
        .collect();
    if seen.len() < 10 || 2 * seen.len() < pictures.len() {
        return None;
    }
    let of_lips = |of: fn(&(f32, f32)) -> f32| spread(seen.iter().map(move |(_, lips)| of(lips)));
    let (gap, width) = (of_lips(|lips| lips.0), of_lips(|lips| lips.1));
    let mut gaps: Vec<f32> = seen.iter().map(|(_, lips)| lips.0).collect();
    gaps.sort_by(f32::total_cmp);
    // Lips that meet have a gap of nothing, but for what landmarks tremble.
    let closed = gaps[gaps.len() / 20];
    let open = (gap.0 + FAR * gap.1 - closed).max(1e-4);
    let openings = Array2::from_shape_fn((seen.len(), 3), |(row, k)| {
        let (picture, (of_gap, of_width)) = seen[row];
        match k {
            0 => ((of_gap - closed) / open).clamp(0.0, 1.0),
            1 => ((of_width - width.0) / (FAR * width.1).max(1e-4)).clamp(-1.0, 1.0),
            _ => footage.places[pictures[picture]].turned,
        }
    });
    Some((seen.into_iter().map(|(row, _)| row).collect(), openings))
}

/// Openings `[n, 3]` as numbers whose squares are in the unit of squared differences of so many levels.
fn scaled(openings: Array2<f32>, levels: usize) -> Array2<f32> {
    let weights =
        [GAP_LEVELS, WIDTH_LEVELS, 2.0 * TURNED_LEVELS].map(|weight| weight * (levels as f32).sqrt());
    openings * ArrayView1::from(&weights)
}

/// Draws in the recording's rectangle what is of the model's.
struct Brush {
    size: (usize, usize),
    sharp: usize,
    fit: Fit,
}

impl Brush {
    /// What weights move, in the recording's levels `[height·sharp, width·sharp, 3]`.
    fn moved(&self, space: &MouthSpace, weights: ArrayView1<f32>) -> Vec<f32> {
        let change = space.basis.t().dot(&weights);
        let [r, g, b] = self.fit.light.map(|(gain, _)| gain);
        self.spread(&change, space, |[x, y, z]| [r * x, g * y, b * z])
    }

    /// A picture of the model's in the recording's light.
    fn lit(&self, image: &Array1<f32>, space: &MouthSpace) -> Array1<f32> {
        let light = self.fit.light;
        self.spread(image, space, |levels| {
            std::array::from_fn(|c| light[c].0 * levels[c] + light[c].1)
        })
        .into()
    }

    fn spread(
        &self,
        image: &Array1<f32>,
        space: &MouthSpace,
        levels: impl Fn([f32; 3]) -> [f32; 3],
    ) -> Vec<f32> {
        let of_model = Floats {
            rgb: image.as_slice().unwrap_or_default(),
            width: space.width,
            height: space.height,
        };
        let mut out = Vec::with_capacity(self.size.0 * self.size.1 * self.sharp * self.sharp * 3);
        for y in 0..self.size.1 * self.sharp {
            for x in 0..self.size.0 * self.sharp {
                let (u, v) = self
                    .fit
                    .to_model
                    .apply(coarse_at(x, self.sharp), coarse_at(y, self.sharp));
                out.extend(levels(of_model.sample_cubic(u, v)));
            }
        }
        out
    }

    /// Weights of a difference from the mean mouth, `[height·sharp, width·sharp, 3]` in the recording's levels.
    fn weights(&self, difference: &Array1<f32>, space: &MouthSpace) -> Array1<f32> {
        let wide = (self.size.0 * self.sharp, self.size.1 * self.sharp);
        let reduced = small(difference, wide, self.sharp);
        let of_recording = Floats {
            rgb: &reduced,
            width: self.size.0,
            height: self.size.1,
        };
        let Some(back) = self.fit.to_model.inverse() else {
            return Array1::zeros(space.size());
        };
        let mut image = Vec::with_capacity(space.mean.len());
        for y in 0..space.height {
            for x in 0..space.width {
                let (u, v) = back.apply(x as f32, y as f32);
                let levels = of_recording.sample(u, v);
                image.extend((0..3).map(|c| levels[c] / self.fit.light[c].0));
            }
        }
        space.basis.dot(&Array1::from(image))
    }
}

/// A picture of `size` reduced by `sharp`, each pixel the mean of what it covers.
fn small(image: &Array1<f32>, size: (usize, usize), sharp: usize) -> Vec<f32> {
    let (width, height) = (size.0 / sharp, size.1 / sharp);
    let mut out = vec![0.0f32; width * height * 3];
    let share = 1.0 / (sharp * sharp) as f32;
    for (at, value) in image.iter().enumerate() {
        let (pixel, c) = (at / 3, at % 3);
        let (x, y) = (pixel % size.0 / sharp, pixel / size.0 / sharp);
        out[3 * (y * width + x) + c] += share * value;
    }
    out
}

/// The mouths of some pictures of a recording, `[n, height·sharp·width·sharp·3]`.
fn sampled(footage: &mut Footage, pictures: &[usize], sharp: usize) -> Result<Array2<u8>> {
    let (across, down) = (footage.mouth.0 * sharp, footage.mouth.1 * sharp);
    let mut out = Array2::zeros((pictures.len(), across * down * 3));
    let mut rgb = Vec::new();
    for (index, mut row) in pictures.iter().zip(out.outer_iter_mut()) {
        let picture = footage.pictures.read(*index, &mut rgb)?;
        let map = footage.places[*index].mouth;
        let places = (0..down).flat_map(|y| (0..across).map(move |x| (x, y)));
        for ((x, y), pixel) in places.zip(row.exact_chunks_mut(3)) {
            let (px, py) = map.apply(coarse_at(x, sharp), coarse_at(y, sharp));
            let levels = picture.sample(px, py);
            for (to, from) in pixel.into_iter().zip(levels) {
                *to = from.round() as u8;
            }
        }
    }
    Ok(out)
}

/// Lays the model's mean mouth onto the recording's: the size and shift at which their luminances correlate best.
fn fitted(mean: &[f32], size: (usize, usize), space: &MouthSpace) -> Fit {
    let recording = Floats {
        rgb: mean,
        width: size.0,
        height: size.1,
    };
    let of_model = space.mean.as_slice().unwrap_or_default();
    let model = Floats {
        rgb: of_model,
        width: space.width,
        height: space.height,
    };
    // Both rectangles are about the lips, and lips take as much of the one as of the other.
    let natural = space.width as f32 / size.0 as f32;
    let centre = |of: (usize, usize)| (0.5 * (of.0 - 1) as f32, 0.5 * (of.1 - 1) as f32);
    let (from, to) = (centre(size), centre((space.width, space.height)));
    let map = |scale: f32, x: f32, y: f32| {
        Affine::scaled(
            scale,
            to.0 - scale * from.0 + x * space.width as f32,
            to.1 - scale * from.1 + y * space.height as f32,
        )
    };
    let like = |scale: f32, x: f32, y: f32| likeness(&recording, &model, &map(scale, x, y));
    let mut best = (like(natural, 0.0, 0.0), natural, 0.0f32, 0.0f32);
    let mut reach = (0.24f32, 0.18f32);
    for _ in 0..5 {
        let (_, scale, x, y) = best;
        for i in -3..=3i8 {
            for j in -3..=3i8 {
                for k in -3..=3i8 {
                    let at = |n: i8| f32::from(n) / 3.0;
                    let tried = (
                        scale * (1.0 + reach.0 * at(i)),
                        x + reach.1 * at(j),
                        y + reach.1 * at(k),
                    );
                    let found = like(tried.0, tried.1, tried.2);
                    if found > best.0 {
                        best = (found, tried.0, tried.1, tried.2);
                    }
                }
            }
        }
        reach = (0.4 * reach.0, 0.4 * reach.1);
    }
    let (likeness, scale, x, y) = best;
    let to_model = map(scale, x, y);
    Fit {
        to_model,
        likeness,
        light: light(&recording, &model, &to_model),
    }
}

/// Places of a recording's rectangle that the fit looks at: every second pixel, those whose place lies in the model's rectangle.
fn common<'a>(
    recording: &'a Floats,
    model: &'a Floats,
    map: &'a Affine,
) -> impl Iterator<Item = ([f32; 3], [f32; 3])> + 'a {
    let (width, height) = (recording.width, recording.height);
    let (right, bottom) = (model.width as f32 - 1.0, model.height as f32 - 1.0);
    let places = (0..height)
        .step_by(2)
        .flat_map(move |y| (0..width).step_by(2).map(move |x| (x, y)));
    places.filter_map(move |(x, y)| {
        let (u, v) = map.apply(x as f32, y as f32);
        let inside = u >= 0.0 && v >= 0.0 && u <= right && v <= bottom;
        inside.then(|| (recording.pixel(x, y), model.sample(u, v)))
    })
}

/// Correlation of the luminances of a recording's rectangle and the model's.
fn likeness(recording: &Floats, model: &Floats, map: &Affine) -> f32 {
    let (mut n, mut sums, mut squares, mut cross) = (0.0f32, (0.0f32, 0.0f32), (0.0f32, 0.0f32), 0.0f32);
    for (a, b) in common(recording, model, map) {
        let (a, b) = (luminance(a), luminance(b));
        n += 1.0;
        sums = (sums.0 + a, sums.1 + b);
        squares = (squares.0 + a * a, squares.1 + b * b);
        cross += a * b;
    }
    // Little in common says nothing.
    if n < 0.15 * (recording.width * recording.height) as f32 {
        return -1.0;
    }
    let variance = (squares.0 - sums.0 * sums.0 / n) * (squares.1 - sums.1 * sums.1 / n);
    (cross - sums.0 * sums.1 / n) / variance.max(1e-6).sqrt()
}

/// Gain and offset per channel that bring the model's levels to the recording's mean and contrast.
fn light(recording: &Floats, model: &Floats, map: &Affine) -> [(f32, f32); 3] {
    std::array::from_fn(|c| {
        let pairs: Vec<(f32, f32)> = common(recording, model, map).map(|(a, b)| (a[c], b[c])).collect();
        let n = (pairs.len() as f32).max(1.0);
        let mean = |of: fn(&(f32, f32)) -> f32| pairs.iter().map(of).sum::<f32>() / n;
        let (here, there) = (mean(|p| p.0), mean(|p| p.1));
        let spread = |of: fn(&(f32, f32)) -> f32, middle: f32| {
            (pairs.iter().map(|p| (of(p) - middle).powi(2)).sum::<f32>() / n).sqrt()
        };
        let gain = (spread(|p| p.0, here) / spread(|p| p.1, there).max(1e-3)).clamp(0.4, 2.5);
        (gain, here - gain * there)
    })
}
