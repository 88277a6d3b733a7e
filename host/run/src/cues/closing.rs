//! How likely lips are closed, from the lip gap of the drawn mouth.
//!
//! The weight of p, b and m says which sound was heard; the gap says whether the mouth that goes with it closes. The gap knows more: with voices that the model has not
//! heard it falls at a closure whose weight goes to another stop. What counts is the mean gap over 50 ms, less half the mean over 170 ms: lips that come together from a
//! wide vowel and part again are closed at a gap at which lips that are narrow for long are not. The numbers were chosen on other voices than those that are
//! measured (`docs/rendering.md`, cue files).
use std::collections::VecDeque;

/// Frames to each side of one whose gap is averaged.
const NEAR: usize = 2;
/// Frames to each side of one that it is compared with.
pub(super) const AROUND: usize = 8;
/// Share of the mean around that is taken off the mean nearby.
const SHARE: f32 = 0.5;
/// The difference, in the unit of the gap, at which it says nothing about the lips.
const BORDER: f32 = 0.2;
/// ln-weight that closed lips gain where the difference is smaller by 1 (loses, where it is greater).
const STRENGTH: f32 = 20.0;

/// Gaps around a frame, as long as they are needed.
#[derive(Default)]
pub(super) struct Gaps {
    /// Of the frames from `AROUND` before the next frame that is judged.
    window: VecDeque<f32>,
    /// Place of that frame in the window.
    at: usize,
}

impl Gaps {
    /// The gap of the next frame; one without is taken to be as the frame before it.
    pub(super) fn push(&mut self, gap: Option<f32>) {
        let last = self.window.back().copied().unwrap_or_default();
        self.window.push_back(gap.unwrap_or(last));
    }

    /// ln-weight that closed lips gain or lose in the next frame; only gaps that have been pushed count, so that `AROUND` frames must have been pushed behind it unless
    /// the sound ends.
    pub(super) fn evidence(&mut self) -> f32 {
        let mean = |reach: usize| {
            let from = self.at.saturating_sub(reach);
            let to = (self.at + reach + 1).min(self.window.len());
            let part = self.window.range(from..to);
            part.sum::<f32>() / (to - from).max(1) as f32
        };
        let difference = mean(NEAR) - SHARE * mean(AROUND);
        match self.at < AROUND {
            true => self.at += 1,
            false => drop(self.window.pop_front()),
        }
        STRENGTH * (BORDER - difference)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Evidence of every frame, each as soon as it can be had.
    fn all(gaps: &[f32]) -> Vec<f32> {
        let mut heard = Gaps::default();
        let mut out = Vec::new();
        for (t, gap) in gaps.iter().enumerate() {
            heard.push(Some(*gap));
            if t >= AROUND {
                out.push(heard.evidence());
            }
        }
        while out.len() < gaps.len() {
            out.push(heard.evidence());
        }
        out
    }

    #[test]
    fn the_means_are_those_of_the_frames_around() {
        let gaps: Vec<f32> = (0..40).map(|t| ((t * 7919) % 101) as f32 / 101.0).collect();
        let mean = |t: usize, reach: usize| {
            let part = &gaps[t.saturating_sub(reach)..(t + reach + 1).min(gaps.len())];
            part.iter().sum::<f32>() / part.len() as f32
        };
        for (t, found) in all(&gaps).into_iter().enumerate() {
            let wanted = STRENGTH * (BORDER - (mean(t, NEAR) - SHARE * mean(t, AROUND)));
            assert!((found - wanted).abs() < 1e-4, "frame {t}: {found}, {wanted}");
        }
    }

    #[test]
    fn a_dip_is_a_closure_and_a_narrow_mouth_is_not_by_itself() {
        let mut gaps = vec![0.7; 40];
        gaps[18..23].fill(0.3);
        let dip = all(&gaps);
        assert!(dip[20] > 0.0 && dip[5] < -2.0, "{dip:?}");
        assert!(all(&[0.45; 40])[20] < 0.0 && all(&[0.0; 40])[20] > 3.0);
    }
}
