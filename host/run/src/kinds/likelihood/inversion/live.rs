//! Conversion by EM while the sound comes in (X&L section 4 inside a window).
use ndarray::{Array2, s};

use super::{Inverter, Result};
use crate::kinds::likelihood::EmSettings;

impl Inverter {
    /// The paper's re-estimation inside a stream's window: with every incoming frame one E and one M step over the last
    /// `lag` frames and the new one, whose mouth begins at what the sound alone says. A frame is given out as it leaves the
    /// window, and the forward variable moves on with what it was.
    pub fn convert_live(
        &self,
        observations: &Array2<f32>,
        settings: &EmSettings,
        lag: usize,
    ) -> Result<Array2<f32>> {
        let heard = self.hear(observations, settings.acoustic_scale);
        let frames = observations.nrows();
        let mut mouth = Array2::<f32>::zeros((frames, self.centre.ncols()));
        // α of the frame before the window, and of the frame before the new one.
        let (mut before, mut newest): (Option<Vec<f64>>, Option<Vec<f64>>) = (None, None);
        for t in 0..frames {
            let first = t.saturating_sub(lag);
            // The new frame is heard, not seen yet: its mouth is the centres of the states that its sound leaves.
            let alone = heard.part(t, t);
            let state = self.unseen(&alone);
            let alpha = self.follow(&alone, &state, newest.as_deref(), 1)?.alpha;
            let mut centre = vec![0.0f64; mouth.ncols()];
            for (at, weight) in self.graph.states.iter().zip(alpha.row(0)) {
                for (c, m) in centre.iter_mut().zip(self.centre.row(at.visual)) {
                    *c += weight * f64::from(*m);
                }
            }
            mouth
                .row_mut(t)
                .iter_mut()
                .zip(&centre)
                .for_each(|(to, c)| *to = *c as f32);
            let part = heard.part(first, t);
            let window = mouth.slice(s![first..=t, ..]).to_owned();
            let (state, component) = self.see(&part, &window, settings.visual_exponent);
            let seen = self.follow(&part, &state, before.as_deref(), window.nrows())?;
            let gamma = seen.backward(&self.graph, &self.probability, |_, _, _| ());
            let (_, next) = self.maximise(&gamma, &component, settings.m_step);
            mouth.slice_mut(s![first..=t, ..]).assign(&next);
            newest = Some(seen.alpha.row(t - first).to_vec());
            if t >= lag {
                before = Some(seen.alpha.row(0).to_vec());
            }
        }
        Ok(mouth)
    }
}
