//! The paper's re-estimation of the mouth inside the lag window (Xie & Liu 2007 (X&L), section 4; docs/design.md section 5), for
//! tables with visual densities: the mouth is not mapped from the sound, it is the one that the coupled HMM finds likeliest.
//!
//! With every incoming frame one sweep:
//!
//! - the new frame's mouth begins at the centres of the states that its sound leaves, Σ_v γ(v)·Σ_k w_vk μ_vk;
//! - E step: α over the window, on from the frame that has left it last, with emissions bᵃ(o)^α · bᵛ(ô)^κ, then β back to the
//!   window's oldest frame, over the joint states that the beam has left active;
//! - M step in every frame: ô = [Σ γ(v, k) Σ⁻¹_vk]⁻¹ Σ γ(v, k) Σ⁻¹_vk μ_vk (eq. 9 without its second weight).
//!
//! A frame is given out as it leaves the window, and its α stays what it was. With κ = 0 the mouth says nothing about the states.
use super::Likelihood;
use super::density::{log_of, place, powered, squared_distance};
use super::tables::{MAX_DENSITIES, MEAN_SHIFT};
use crate::fixed::{round_shift, saturate_i16, saturate_i32};
use crate::frame::{MAX_PARAMETERS, VisemeWeights};
use crate::hmm::gates::viseme_weights;
use crate::hmm::token::Token;
use crate::hmm::transition::N_VISUAL_STATES;
use crate::logmath::{FRACTION_BITS, LogProb, NEVER_I16};

/// Fraction bits of a kept emission.
const EMISSION_FRACTION_BITS: u32 = 5;

/// What is known of the mouth in one frame of the window.
#[derive(Clone, Debug)]
pub struct Seen {
    /// ô, parameter LSBs.
    pub mouth: [i16; MAX_PARAMETERS],
    /// Occupancy of each viseme, 255 = 1.
    pub viseme_weights: VisemeWeights,
    /// κ·log2 bᵛ(ô) by visual state, relative to the largest, Q10.5 (narrow densities are hundreds of bits apart);
    /// [`NEVER_I16`] where nothing was active.
    emission: [i16; N_VISUAL_STATES],
}

impl Seen {
    /// Nothing seen yet.
    pub const NONE: Self = Self {
        mouth: [0; MAX_PARAMETERS],
        viseme_weights: VisemeWeights::new(),
        emission: [0; N_VISUAL_STATES],
    };

    /// What the last [`Seen::see`] found for a visual state.
    #[inline]
    pub fn emission(&self, visual: usize) -> LogProb {
        match self.emission.get(visual) {
            Some(&log) if log != NEVER_I16 => {
                LogProb::from_q12(i32::from(log) << (FRACTION_BITS - EMISSION_FRACTION_BITS))
            }
            _ => LogProb::NEVER,
        }
    }

    /// The mouth at the centres of the states, by their occupancies (Q0.16, sum about 1).
    pub fn begin(&mut self, model: &Likelihood, occupancy: &[u32; N_VISUAL_STATES]) {
        let mut sums = [0i64; MAX_PARAMETERS];
        for (state, &gamma) in occupancy.iter().enumerate().filter(|(_, g)| **g > 0) {
            for (sum, centre) in sums.iter_mut().zip(model.visual_centre(state).iter()) {
                *sum += i64::from(gamma) * i64::from(centre);
            }
        }
        for (to, sum) in self.mouth.iter_mut().zip(sums) {
            *to = saturate_i16(saturate_i32((sum + (1 << 15)) >> 16));
        }
    }

    /// What the visual states that `tokens` hold emit with the present mouth, to the power of `exponent` (Q16.16).
    pub fn see(&mut self, model: &Likelihood, exponent: u32, tokens: &[Token]) {
        let scaled = scaled(model, &self.mouth);
        let mut logs = [LogProb::NEVER; N_VISUAL_STATES];
        let mut best = LogProb::NEVER;
        for token in tokens {
            let visual = token.state.visual(model.hmm().viseme(token.state.phone()));
            let Some(log) = logs.get_mut(visual).filter(|log| log.is_never()) else {
                continue;
            };
            let mut sum = LogProb::NEVER;
            if exponent > 0 {
                components(model, visual, &scaled, |_, component| sum = sum.plus(component));
            }
            *log = powered(sum, exponent);
            best = best.max(*log);
        }
        for (to, log) in self.emission.iter_mut().zip(&logs) {
            *to = match log.over(best) {
                never if never.is_never() => NEVER_I16,
                log => saturate_i16(round_shift(log.q12(), FRACTION_BITS - EMISSION_FRACTION_BITS))
                    .max(NEVER_I16 + 1),
            };
        }
    }

    /// M step: the mouth from the occupancies of the visual states (Q0.16).
    pub fn maximise(&mut self, model: &Likelihood, occupancy: &[u32; N_VISUAL_STATES]) {
        self.viseme_weights = viseme_weights(occupancy);
        let scaled = scaled(model, &self.mouth);
        // Σ γ·w² and Σ γ·w²·μ, w inverse deviations and μ means as in the tables: below 2³⁴ and 2⁴¹.
        let mut precision = [0i64; MAX_PARAMETERS];
        let mut weighted = [0i64; MAX_PARAMETERS];
        for (state, &gamma) in occupancy.iter().enumerate().filter(|(_, g)| **g > 0) {
            let mut logs = [LogProb::NEVER; MAX_DENSITIES];
            let mut total = LogProb::NEVER;
            components(model, state, &scaled, |k, log| {
                if let Some(to) = logs.get_mut(k) {
                    *to = log;
                }
                total = total.plus(log);
            });
            for (density, log) in model.visual().of(state).zip(&logs) {
                let share = u64::from(log.over(total).exp2());
                // At most 2¹⁶ (and a little) · 2¹⁶.
                let gamma = ((u64::from(gamma) * share) >> 16) as i64;
                if gamma == 0 {
                    continue;
                }
                let sums = precision.iter_mut().zip(&mut weighted);
                let tables = density.mean.iter().zip(density.inverse_deviation);
                for ((precision, weighted), (mean, w)) in sums.zip(tables) {
                    let weight = gamma * i64::from(*w) * i64::from(*w);
                    *precision += weight;
                    *weighted += weight * i64::from(*mean as i8);
                }
            }
        }
        let sums = precision.iter().zip(weighted);
        let scaling = model.visual().scaling();
        for ((to, (precision, weighted)), (centre, gain)) in self.mouth.iter_mut().zip(sums).zip(scaling) {
            // Mean steps in Q12: at most 2¹⁹. A mouth that no state speaks for stays as it was.
            let Some(steps) = (weighted << 12).checked_div(*precision) else {
                continue;
            };
            // In sixteenths of a step, Q12, over a gain in Q16: at most 2³⁹ before the division.
            let offset = ((steps << (MEAN_SHIFT + 4)) / i64::from(gain.max(1))).clamp(-(1 << 17), 1 << 17);
            *to = saturate_i16(i32::from(centre) + offset as i32);
        }
    }
}

/// A mouth centred and scaled for the visual densities: sixteenths of a mean step.
fn scaled(model: &Likelihood, mouth: &[i16; MAX_PARAMETERS]) -> [i16; MAX_PARAMETERS] {
    let mut out = [0; MAX_PARAMETERS];
    for ((to, value), (centre, gain)) in out.iter_mut().zip(mouth).zip(model.visual().scaling()) {
        *to = place(*value, centre, gain);
    }
    out
}

/// Calls `each` with the index and the log of weight times likelihood of every density of a visual state that is used.
fn components(
    model: &Likelihood,
    state: usize,
    scaled: &[i16; MAX_PARAMETERS],
    mut each: impl FnMut(usize, LogProb),
) {
    let gain = model.visual().distance_gain();
    for (k, density) in model.visual().of(state).enumerate() {
        if let Some(constant) = density.constant {
            let distance = squared_distance(scaled, density.mean, density.inverse_deviation);
            each(k, log_of(constant, distance, gain));
        }
    }
}
