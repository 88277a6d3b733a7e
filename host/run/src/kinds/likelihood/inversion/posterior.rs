//! Conversion by the posterior mean: what the mouth is on average, given the sound.
//!
//! ôᵛ_t = Σ_v γ_t(v) Σ_k w_vk μ_vk, with γ from forward-backward on the sound alone. Where densities are joint the sound has
//! its say in the components too: Σ_k P(k | v, oᵃ_t) μ_vk in place of the weights. There is nothing to iterate: EM
//! seeks the likeliest mouth, a mode, while the mean squared error is smallest at the mean.
use ndarray::{Array2, Axis, s};

use super::{Inverter, LEAST_OCCUPANCY, Result};
use crate::hmm::graph::log_sum;
use crate::kinds::likelihood::convert::Lag;

impl Inverter {
    /// The mean of the mouth given the sound, `[frames, D]`, and the occupancies of the visual states, `[frames, visual states]`.
    ///
    /// `acoustic_scale` is the exponent of the sound's likelihood; occupancies know as much of the future as `lag` says.
    pub fn posterior_mean(
        &self,
        observations: &Array2<f32>,
        acoustic_scale: f32,
        lag: Lag,
    ) -> Result<(Array2<f32>, Array2<f32>)> {
        let heard = self.hear(observations, acoustic_scale);
        let frames = observations.nrows();
        let forward = self.follow(&heard, &self.unseen(&heard), None, frames)?;
        let gamma = match lag {
            Lag::Whole => forward.backward(&self.graph, &self.probability, |_, _, _| ()),
            Lag::Frames(lag) => forward.fixed_lag(&self.graph, &self.probability, lag),
        };
        let occupancy = self.visual_occupancy(&gamma);
        let mouth = match &heard.component {
            None => occupancy.dot(&self.centre),
            Some(component) => {
                let mut mouth = Array2::<f32>::zeros((frames, self.centre.ncols()));
                for ((t, state), &share) in occupancy.indexed_iter() {
                    if share < LEAST_OCCUPANCY {
                        continue;
                    }
                    let parts = component.slice(s![t, state, ..]);
                    let total = log_sum(parts.iter().copied());
                    let means = self.mixtures.mean.index_axis(Axis(0), state);
                    for (part, mean) in parts.iter().zip(means.outer_iter()) {
                        mouth.row_mut(t).scaled_add(share * (part - total).exp(), &mean);
                    }
                }
                mouth
            }
        };
        Ok((mouth, occupancy))
    }
}
