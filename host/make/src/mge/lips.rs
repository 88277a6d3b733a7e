//! The lip gap in training: a line in the mouth's parameters, and what phones ask of it.
//!
//! A mean squared error draws a mouth that is not sure towards its mean, and a mouth that nearly closes at a p does not close. What everybody sees first is asked for by
//! itself: at p, b and m the lips meet, and at most other phones they do not. Both are known of everybody whose phones are known, filmed or not.
use ndarray::{ArrayView1, ArrayView2, Axis};

use super::data::Deviations;
use super::store::Store;
use crate::em::source::in_order;
use crate::error::{Result, bail};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::likelihood::Model;
use lipstream::opening::OpeningReader;
use lipstream::phones::Phone;

/// How far beyond the border of closed lips a gap is asked to be, in deviations of the person's own.
const MARGIN: f32 = 0.15;
/// States of a p, b or m in which lips meet: they come together in the first and part in the last.
const HELD: std::ops::Range<usize> = 1..N_EMITTING - 1;
/// Frames around a p, b or m in which lips may meet already, or still.
const AROUND: usize = 5;

/// What a phone asks of the lips.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ask {
    Meet,
    Part,
    /// Silence, in which mouths do as they like, and phones with nearly closed lips.
    Nothing,
}

/// The lip gap, in deviations of the person's own.
#[derive(Clone, Debug, PartialEq)]
pub struct Gap {
    /// Of each standardised parameter, `[D]`.
    slopes: Vec<f32>,
    /// Lips are closed below it, where the mean mouth has 0.
    closed: f32,
    /// Of every phone.
    asks: Vec<Ask>,
}

impl Gap {
    /// Of standardised parameters `[D]`, closed below `closed`, in a model of `phones`.
    pub fn new(slopes: Vec<f32>, closed: f32, phones: &[Phone]) -> Self {
        Self {
            slopes,
            closed,
            asks: phones.iter().map(|phone| ask(*phone)).collect(),
        }
    }

    /// Reads the gap off the mouth of `parent`; `train` are the person's clips, standardised by `deviation`.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): nothing in the mouth looks like lips.
    pub(super) fn learn(parent: &Model, train: &Store, deviation: &[f32]) -> Result<Self> {
        let Some(reader) = parent.mouth.as_ref().and_then(OpeningReader::of) else {
            bail!(
                Data,
                "the lips of this mouth cannot be read off its eigenmouths: nothing can be asked of them"
            )
        };
        let slopes = reader.gap_slopes() * &ArrayView1::from(deviation);
        let mut gaps = Deviations::default();
        in_order(
            train.len(),
            |n| train.get(n),
            |clip| {
                if let Some(mouth) = &clip.mouth {
                    gaps.add(mouth.dot(&slopes).insert_axis(Axis(1)).view());
                }
                Ok(())
            },
        )?;
        let deviation = gaps.deviations().next().unwrap_or(1.0);
        let slopes = (slopes / deviation).to_vec();
        Ok(Self::new(
            slopes,
            -reader.gap_offset() / deviation,
            &parent.phones,
        ))
    }

    /// By how much the gap changes with each standardised parameter.
    pub(super) fn slopes(&self) -> ArrayView1<'_, f32> {
        ArrayView1::from(&self.slopes)
    }

    /// By how far the gap of each frame of `mouth` `[T, D]` is on the wrong side of what the phone of its audio state asks: positive where lips should meet and do not, negative
    /// where they should not and do. Where `truth` is known and does what it should not, nothing is asked.
    pub fn wrong(
        &self,
        mouth: ArrayView2<f32>,
        truth: Option<ArrayView2<f32>>,
        states: &[(usize, usize)],
    ) -> Vec<f32> {
        let slopes = self.slopes();
        let said = mouth.dot(&slopes);
        let truth = truth.map(|truth| truth.dot(&slopes));
        let asks: Vec<Ask> = self.of_states(states);
        let wrong = said.iter().zip(&asks).enumerate().map(|(t, (gap, ask))| {
            let beyond = |gap: f32| match ask {
                Ask::Meet => (gap - (self.closed - MARGIN)).max(0.0),
                Ask::Part => (gap - (self.closed + MARGIN)).min(0.0),
                Ask::Nothing => 0.0,
            };
            // The mouth that was filmed knows better, but for the margin.
            let does_not = truth
                .as_ref()
                .is_some_and(|truth| beyond(truth[t]).abs() > MARGIN);
            if does_not { 0.0 } else { beyond(*gap) }
        });
        wrong.collect()
    }

    /// What is asked in every frame.
    fn of_states(&self, states: &[(usize, usize)]) -> Vec<Ask> {
        let asks = |state: usize| self.asks[state / N_EMITTING];
        let mut of: Vec<Ask> = states
            .iter()
            .map(|(audio, _)| match asks(*audio) {
                Ask::Meet if !HELD.contains(&(audio % N_EMITTING)) => Ask::Nothing,
                ask => ask,
            })
            .collect();
        for (t, (audio, _)) in states.iter().enumerate() {
            if asks(*audio) == Ask::Meet {
                let around = t.saturating_sub(AROUND)..(t + AROUND + 1).min(of.len());
                let near = of[around].iter_mut().filter(|ask| **ask == Ask::Part);
                near.for_each(|ask| *ask = Ask::Nothing);
            }
        }
        of
    }
}

fn ask(phone: Phone) -> Ask {
    match phone.name() {
        "p" | "b" | "m" => Ask::Meet,
        "em" | "f" | "v" | "w" => Ask::Nothing,
        _ if phone.is_pause() => Ask::Nothing,
        _ => Ask::Part,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    fn gap() -> Gap {
        let phones = ["sil", "p", "aa"].map(|name| Phone::from_name(name).unwrap());
        Gap::new(vec![1.0, 0.0], -1.0, &phones)
    }

    /// Three frames a state of the phones sil p aa.
    fn states() -> Vec<(usize, usize)> {
        (0..45).map(|t| (t / 3, 0)).collect()
    }

    #[test]
    fn lips_meet_at_p_and_part_elsewhere() {
        let open = gap().wrong(Array2::zeros((45, 2)).view(), None, &states());
        // p has frames 15 to 29, of which the inner three states are asked; open lips are 1.15 too far apart.
        for (t, wrong) in open.iter().enumerate() {
            let wanted = if (18..27).contains(&t) { 1.0 + MARGIN } else { 0.0 };
            assert!((wrong - wanted).abs() < 1e-6, "{t}: {wrong}");
        }
        let closed = gap().wrong(Array2::from_elem((45, 2), -1.0).view(), None, &states());
        for (t, wrong) in closed.iter().enumerate() {
            let wanted = match t {
                18..27 => MARGIN,
                // aa, but for the frames next to p.
                35.. => -MARGIN,
                _ => 0.0,
            };
            assert!((wrong - wanted).abs() < 1e-6, "{t}: {wrong}");
        }
    }

    #[test]
    fn a_filmed_mouth_knows_better() {
        // It stays open at this p.
        let truth = Array2::zeros((45, 2));
        let wrong = gap().wrong(Array2::zeros((45, 2)).view(), Some(truth.view()), &states());
        assert!(wrong.iter().all(|wrong| *wrong == 0.0), "{wrong:?}");
        // It closes, and what is said does not.
        let truth = Array2::from_shape_fn((45, 2), |_| -1.1);
        let wrong = gap().wrong(Array2::zeros((45, 2)).view(), Some(truth.view()), &states());
        assert!(wrong[20] > 1.0 && wrong[40] == 0.0);
        assert_eq!(gap().slopes(), array![1.0, 0.0]);
    }
}
