//! Lower faces that hang as far as the speech asks (X&L section 6.2): what moves around a mouth when it opens.
//!
//! Candidates are lower faces of the recording itself. The paper takes the one whose jaw hangs in proportion to the energy of the sound; the jaw may as well be
//! told by the drawn mouth, by a regression that the recording teaches. Either way it is chosen over time, so that the chin does not jump, and among heads that are turned
//! as the background's is.
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

use super::footage::{Footage, Jaw};
use super::layer::Region;
use super::raster::spread;
use crate::error::Result;
use crate::render::refine::{CANDIDATES, Candidates, Choice};

/// What says how far the jaw hangs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JawBy {
    /// The energy of the sound, as in the paper.
    Energy,
    /// The drawn mouth.
    #[default]
    Mouth,
}

/// Rows and columns that lower faces are compared by.
const THUMB: (usize, usize) = (20, 16);
/// A jaw off by one standard deviation is as bad as a change of so many levels in every pixel compared.
const JAW_LEVELS: f32 = 8.0;
/// The same for a head that is turned otherwise than the background's.
const TURNED_LEVELS: f32 = 8.0;
/// Lower faces are chosen over time, with the distance between two as the charge of a change.
const CHOICE: Choice = Choice::OverTime { change: 1.0 };
/// Ridge of the regression from weights to the jaw, in weights' own variance.
const RIDGE: f32 = 0.05;

/// The lower faces of a recording.
#[derive(Clone, Debug)]
pub(super) struct Jaws {
    pub(super) region: Region,
    candidates: Candidates,
    /// The candidates' pictures.
    pictures: Vec<usize>,
    /// Mean and deviation of the recording's jaw, and of how far the head is turned.
    jaw: (f32, f32),
    turned: (f32, f32),
    /// The recording's jaws, sorted.
    sorted: Vec<f32>,
    /// From weights to the jaw, over its mean.
    slopes: Array1<f32>,
}

/// What each picture asks of the jaw.
pub(super) struct Asked<'a> {
    /// What mouths are found by, `[T, D]`.
    pub(super) tracks: ArrayView2<'a, f32>,
    /// Energy of the sound, in any unit that grows with it, `[T]`.
    pub(super) energy: Option<&'a [f32]>,
    /// How far the background's head is turned, `[T]`.
    pub(super) turned: &'a [f32],
    pub(super) by: JawBy,
}

impl Jaws {
    /// None where the recording's jaw is not seen or does not move. `weights` are what the mouths of `pictures` are found by.
    pub(super) fn learn(
        footage: &mut Footage,
        weights: &Array2<f32>,
        pictures: &[usize],
    ) -> Result<Option<Self>> {
        let Some(outline) = footage.jaw else {
            return Ok(None);
        };
        let with: Vec<(usize, usize, f32)> = pictures
            .iter()
            .enumerate()
            .filter_map(|(row, picture)| Some((row, *picture, footage.places[*picture].jaw?)))
            .collect();
        let jaw = spread(with.iter().map(|(_, _, jaw)| *jaw));
        if with.len() < 10 || jaw.1 < 1e-4 {
            return Ok(None);
        }
        let turned = spread(with.iter().map(|(_, picture, _)| footage.places[*picture].turned));
        let rows: Vec<usize> = with.iter().map(|(row, ..)| *row).collect();
        let wanted: Array1<f32> = with.iter().map(|(_, _, v)| v - jaw.0).collect();
        let slopes = ridge(&weights.select(Axis(0), &rows), &wanted);
        let mut sorted: Vec<f32> = with.iter().map(|(_, _, jaw)| *jaw).collect();
        sorted.sort_by(f32::total_cmp);
        // Evenly over the recording: neighbours in time are neighbours in looks.
        let step = with.len().div_ceil(CANDIDATES).max(1);
        let chosen: Vec<(usize, f32)> = with
            .iter()
            .step_by(step)
            .map(|(_, picture, jaw)| (*picture, *jaw))
            .collect();
        let mut places = Array2::zeros((chosen.len(), 2));
        let mut thumbs = Array2::zeros((chosen.len(), THUMB.0 * THUMB.1 * 3));
        for ((picture, hangs), (mut place, mut thumb)) in chosen
            .iter()
            .zip(places.outer_iter_mut().zip(thumbs.outer_iter_mut()))
        {
            place.assign(&seen((*hangs, jaw), (footage.places[*picture].turned, turned)));
            thumb.assign(&thumbnail(footage, *picture, &outline)?);
        }
        Ok(Some(Self {
            region: region(&outline, footage.mouth),
            candidates: Candidates::new(places, thumbs.view())?,
            pictures: chosen.into_iter().map(|(picture, _)| picture).collect(),
            jaw,
            turned,
            sorted,
            slopes,
        }))
    }

    /// How far the jaw is to hang in each picture.
    pub(super) fn wanted(&self, asked: &Asked) -> Vec<f32> {
        match (asked.by, asked.energy) {
            (JawBy::Energy, Some(energy)) => self.by_energy(energy),
            _ => asked.tracks.outer_iter().map(|row| self.by_mouth(row)).collect(),
        }
    }

    /// How far the jaw hangs that goes with a mouth, of what mouths are found by, `[D]`.
    fn by_mouth(&self, key: ArrayView1<f32>) -> f32 {
        self.jaw.0 + key.dot(&self.slopes)
    }

    /// The loudest picture gets the lowest jaw of the recording, and so on down: in proportion, whatever the two distributions.
    fn by_energy(&self, energy: &[f32]) -> Vec<f32> {
        let mut order: Vec<usize> = (0..energy.len()).collect();
        order.sort_by(|a, b| energy[*a].total_cmp(&energy[*b]));
        let mut wanted = vec![0.0; energy.len()];
        let last = energy.len().saturating_sub(1).max(1);
        for (rank, at) in order.into_iter().enumerate() {
            wanted[at] = self.sorted[rank * (self.sorted.len() - 1) / last];
        }
        wanted
    }

    /// The recording's picture that lends each picture its lower face.
    pub(super) fn choose(&self, asked: &Asked) -> Vec<usize> {
        let wanted = self.wanted(asked);
        let mut tracks = Array2::zeros((wanted.len(), 2));
        for ((mut row, jaw), turned) in tracks.outer_iter_mut().zip(&wanted).zip(asked.turned) {
            row.assign(&seen((*jaw, self.jaw), (*turned, self.turned)));
        }
        let chosen = self.candidates.choose(tracks.view(), CHOICE);
        chosen.into_iter().map(|at| self.pictures[at]).collect()
    }

    /// The lower face that follows the one `before`, for a mouth of this key before a head that is turned so far, where the next pictures are not known.
    pub(super) fn next(&self, before: Option<usize>, key: ArrayView1<f32>, turned: f32) -> usize {
        let wanted = seen((self.by_mouth(key), self.jaw), (turned, self.turned));
        self.candidates.next(before, wanted.view(), CHOICE)
    }

    /// The recording's picture of a lower face.
    pub(super) fn picture(&self, lower: usize) -> usize {
        self.pictures[lower]
    }
}

/// Jaw and turning as numbers whose squares are in the unit of the thumbnails' squared differences.
fn seen((jaw, of): (f32, (f32, f32)), (turned, of_turned): (f32, (f32, f32))) -> Array1<f32> {
    let pixels = ((THUMB.0 * THUMB.1 * 3) as f32).sqrt();
    let scaled = |value: f32, (mean, deviation): (f32, f32), levels: f32| {
        (value - mean) / deviation.max(1e-4) * levels * pixels
    };
    Array1::from(vec![
        scaled(jaw, of, JAW_LEVELS),
        scaled(turned, of_turned, TURNED_LEVELS),
    ])
}

/// The lower face as an egg: from the nose's base to under the chin, within the cheeks.
fn region(outline: &Jaw, mouth: (usize, usize)) -> Region {
    let (left, right) = outline.sides;
    let centre = (0.5 * (left + right), 0.5 * mouth.1 as f32);
    let across = 0.46 * (right - left);
    let up = (centre.1 - outline.top).max(4.0);
    let down = 1.06 * (outline.bottom - centre.1).max(4.0);
    let origin = ((centre.0 - across).floor() - 2.0, (centre.1 - up).floor() - 2.0);
    let size = (
        (2.0 * across).ceil() as usize + 5,
        (up + down).ceil() as usize + 5,
    );
    Region::new(size.0, size.1, origin, |x, y| {
        let u = (x - centre.0) / across;
        let v = (y - centre.1) / if y < centre.1 { up } else { down };
        (1.0 - (u.abs().powf(2.5) + v.abs().powf(2.5)).powf(0.4)) / 0.15
    })
}

/// A lower face in few pixels, without its own mean level.
fn thumbnail(footage: &mut Footage, picture: usize, outline: &Jaw) -> Result<Array1<f32>> {
    let mut rgb = Vec::new();
    let from = footage.pictures.read(picture, &mut rgb)?;
    let map = footage.places[picture].mouth;
    let mut levels = Vec::with_capacity(THUMB.0 * THUMB.1 * 3);
    for y in 0..THUMB.1 {
        for x in 0..THUMB.0 {
            let share = |at: usize, of: usize| (at as f32 + 0.5) / of as f32;
            let u = outline.sides.0 + share(x, THUMB.0) * (outline.sides.1 - outline.sides.0);
            let v = outline.top + share(y, THUMB.1) * (outline.bottom - outline.top);
            let (px, py) = map.apply(u, v);
            levels.extend(from.sample(px, py));
        }
    }
    let thumb = Array1::from(levels);
    let mean = thumb.mean().unwrap_or(0.0);
    Ok(thumb - mean)
}

/// Ridge regression without an offset: columns `[N, D]` to `wanted` `[N]`, by conjugate gradients.
fn ridge(columns: &Array2<f32>, wanted: &Array1<f32>) -> Array1<f32> {
    let mut square = columns.t().dot(columns).mapv(f64::from);
    let ridge = f64::from(RIDGE) * square.diag().sum() / square.nrows().max(1) as f64 + 1e-9;
    square.diag_mut().mapv_inplace(|v| v + ridge);
    let mut found = Array1::<f64>::zeros(square.nrows());
    let mut rest = columns.t().dot(wanted).mapv(f64::from);
    let mut along = rest.clone();
    let mut size = rest.dot(&rest);
    let enough = 1e-12 * size;
    // In exact arithmetic as many steps as there are columns; a few more for rounding.
    for _ in 0..2 * square.nrows() {
        if size <= enough {
            break;
        }
        let bent = square.dot(&along);
        let step = size / along.dot(&bent).max(f64::MIN_POSITIVE);
        found.scaled_add(step, &along);
        rest.scaled_add(-step, &bent);
        let next = rest.dot(&rest);
        along = &rest + &(along * (next / size));
        size = next;
    }
    found.mapv(|v| v as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_line_is_found() {
        let columns = Array2::from_shape_fn((200, 3), |(n, d)| ((7 * n + 13 * d * n + d) % 17) as f32 - 8.0);
        let line = Array1::from(vec![0.5, -2.0, 0.25]);
        let found = ridge(&columns, &columns.dot(&line));
        // The ridge pulls a little towards nothing.
        for (a, b) in found.iter().zip(&line) {
            assert!((a - b).abs() < 0.12, "{found}");
        }
    }

    #[test]
    fn the_egg_ends_under_the_nose_and_under_the_chin() {
        let outline = Jaw {
            sides: (-10.0, 74.0),
            top: 2.0,
            bottom: 70.0,
        };
        let region = region(&outline, (64, 48));
        for (x, y, inside) in [
            (32.0, 24.0, true),
            (32.0, 66.0, true),
            (0.0, 30.0, true),
            (32.0, 0.0, false),
            (32.0, 82.0, false),
            (-9.0, 24.0, false),
            (0.0, 75.0, false),
        ] {
            assert_eq!(region.opacity(x, y) > 0.0, inside, "{x} {y}");
        }
    }
}
