//! A mouth for what is only heard: phones in their context to mouth parameters, learnt from the person with video, said of everybody whose phones are known.
//!
//! One man's sentences tie his mouth to his words: a model that learns from them alone hears words. The phones around a frame say where a mouth is, too,
//! and they are known of many speakers who say anything. The teacher is a ridge regression on which phone and which viseme lies at each of some
//! offsets from the frame; a phone that the video lacks is said by its viseme. What it says is smoothed, since phones change in steps and mouths do not.
use nalgebra::DMatrix;
use ndarray::{Array2, Axis};

use super::store::Store;
use crate::em::source::in_order;
use crate::error::{Error, Result};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::phones::{Phone, VISEMES};

/// Offsets from the frame, in frames of 10 ms.
const OFFSETS: [i32; 15] = [-30, -22, -16, -12, -8, -5, -2, 0, 2, 5, 8, 12, 16, 22, 30];
/// Penalty of the ridge, in frames.
const PENALTY: f64 = 30.0;
/// Deviation of the Gaussian that smooths what is said, frames.
const SMOOTH: f32 = 2.0;

/// Says a mouth of phones.
pub struct Teacher {
    /// Viseme of each phone.
    visemes: Vec<usize>,
    /// `[features, D]`, the constant last.
    weights: Array2<f32>,
}

impl Teacher {
    /// Learns from clips whose mouth and alignment are known.
    ///
    /// # Errors
    ///
    /// That a clip cannot be read, or none has a mouth.
    pub fn learn(clips: &Store, phones: &[Phone]) -> Result<Self> {
        let visemes: Vec<usize> = phones.iter().map(|p| usize::from(p.viseme().0)).collect();
        let size = OFFSETS.len() * (phones.len() + VISEMES.len()) + 1;
        let mut gram = DMatrix::<f64>::zeros(size, size);
        let mut cross: Option<DMatrix<f64>> = None;
        in_order(
            clips.len(),
            |n| clips.get(n),
            |clip| {
                let Some(mouth) = &clip.mouth else { return Ok(()) };
                let cross = cross.get_or_insert_with(|| DMatrix::zeros(size, mouth.ncols()));
                for (t, row) in mouth.outer_iter().enumerate() {
                    let active = active(&clip.states, t, &visemes);
                    for &i in &active {
                        for &j in &active {
                            gram[(i, j)] += 1.0;
                        }
                        for (d, v) in row.iter().enumerate() {
                            cross[(i, d)] += f64::from(*v);
                        }
                    }
                }
                Ok(())
            },
        )?;
        let cross =
            cross.ok_or_else(|| Error::Data("no clip with a mouth to learn phones' looks from".into()))?;
        for i in 0..size {
            gram[(i, i)] += PENALTY;
        }
        let weights = gram
            .cholesky()
            .ok_or_else(|| Error::Numbers("the phones' covariance is singular".into()))?
            .solve(&cross);
        Ok(Self {
            visemes,
            weights: Array2::from_shape_fn((size, cross.ncols()), |(i, d)| weights[(i, d)] as f32),
        })
    }

    /// The mouth `[T, D]` that goes with audio and visual states.
    pub fn say(&self, states: &[(usize, usize)]) -> Array2<f32> {
        let mut said = Array2::zeros((states.len(), self.weights.ncols()));
        for (t, mut row) in said.outer_iter_mut().enumerate() {
            for i in active(states, t, &self.visemes) {
                row += &self.weights.row(i);
            }
        }
        smoothed(&said)
    }
}

/// Numbers of the features that are 1 at frame t; the others are 0.
fn active(states: &[(usize, usize)], t: usize, visemes: &[usize]) -> Vec<usize> {
    let each = visemes.len() + VISEMES.len();
    let last = states.len() as i32 - 1;
    let mut active = Vec::with_capacity(2 * OFFSETS.len() + 1);
    for (k, offset) in OFFSETS.iter().enumerate() {
        let at = (t as i32 + offset).clamp(0, last) as usize;
        let phone = states[at].0 / N_EMITTING;
        active.push(k * each + phone);
        active.push(k * each + visemes.len() + visemes[phone]);
    }
    active.push(OFFSETS.len() * each);
    active
}

/// Rows under a Gaussian over time.
fn smoothed(rows: &Array2<f32>) -> Array2<f32> {
    let reach = (3.0 * SMOOTH) as usize;
    let weight = |k: usize| (-0.5 * (k as f32 / SMOOTH).powi(2)).exp();
    let mut out = Array2::zeros(rows.dim());
    for (t, mut to) in out.axis_iter_mut(Axis(0)).enumerate() {
        let mut total = 0.0;
        for near in t.saturating_sub(reach)..(t + reach + 1).min(rows.nrows()) {
            to.scaled_add(weight(near.abs_diff(t)), &rows.row(near));
            total += weight(near.abs_diff(t));
        }
        to /= total;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mge::data::Clip;

    fn phones() -> Vec<Phone> {
        let named = |name| Phone::from_name(name).unwrap();
        ["sil", "b", "p", "aa", "iy"].map(named).to_vec()
    }

    /// Phones of 12 frames each, in an order drawn from `seed`.
    fn states(seed: usize, of: &[usize]) -> Vec<(usize, usize)> {
        (0..20)
            .flat_map(|n| {
                let phone = of[(seed * 7 + n * n + 3 * n * seed) % of.len()];
                (0..12).map(move |t| (N_EMITTING * phone + t * N_EMITTING / 12, 0))
            })
            .collect()
    }

    /// A mouth that goes towards what the phone wants, some frames late.
    fn mouth(states: &[(usize, usize)]) -> Array2<f32> {
        let wants = |t: usize| match states[t].0 / N_EMITTING {
            1 | 2 => -2.0,
            3 => 2.0,
            4 => 0.5,
            _ => 0.0,
        };
        let mut now = 0.0f32;
        Array2::from_shape_fn((states.len(), 1), |(t, _)| {
            now += 0.3 * (wants(t) - now);
            now
        })
    }

    fn correlation(a: &Array2<f32>, b: &Array2<f32>) -> f64 {
        crate::evaluate::metrics::Score::of(a, b).acc()
    }

    #[test]
    fn phones_that_were_never_seen_look_like_their_viseme() {
        let mut store = Store::new(None).unwrap();
        // B, never P.
        for seed in 0..8 {
            let states = states(seed, &[0, 1, 3, 4]);
            store
                .push(&Clip {
                    id: seed.to_string(),
                    x: Array2::zeros((states.len(), lipstream_core::N_STATIC)),
                    mouth: Some(mouth(&states)),
                    states,
                    variants: Vec::new(),
                })
                .unwrap();
        }
        let teacher = Teacher::learn(&store, &phones()).unwrap();
        let known = states(11, &[0, 1, 3, 4]);
        let seen = correlation(&mouth(&known), &teacher.say(&known));
        assert!(seen > 0.95, "{seen}");
        let unknown = states(12, &[0, 2, 3, 4]);
        let unseen = correlation(&mouth(&unknown), &teacher.say(&unknown));
        assert!(unseen > 0.9, "{unseen}");
    }
}
