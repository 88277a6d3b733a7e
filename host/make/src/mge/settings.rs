//! Choices of a training run.

use super::optimise::Rule;
use super::start::StartSettings;
use crate::error::{Error, Result, bail};
use lipstream::kinds::recurrent::context::Context;
use lipstream::kinds::recurrent::parameters::{Feedback, Gate, Shape};

/// Choices of a training run.
#[derive(Clone, Debug, PartialEq)]
pub struct MgeTrainSettings {
    /// What the model hears around the present frame.
    pub context: Context,
    /// Numbers that are left of a context after its projection.
    pub inputs: usize,
    /// Numbers in the memory.
    pub memory: usize,
    /// What the mouth's last output feeds into the visual emissions.
    pub feedback: Feedback,
    /// Which chain's states own the gains, drives and offsets.
    pub maps: Gate,
    /// Which chain's states own the memory's rates: one of the two.
    pub rates: Gate,
    /// Passes over the clips with video.
    pub passes: usize,
    /// Clips with video in a batch.
    pub batch: usize,
    /// Frames of a crop, and the share of batches that are crops.
    pub crop: usize,
    /// Share of batches that are crops, 0 to 1.
    pub crops: f32,
    /// κ_a, κ_v, κ_h.
    pub audio_entropy: f32,
    /// κ_v: weight of the cross-entropy of visual states, per frame.
    pub visual_entropy: f32,
    /// κ_h: weight of the cross-entropy in clips without video, per frame.
    pub heard_entropy: f32,
    /// Cross-entropy of phones and visemes instead of their states.
    pub atoms: bool,
    /// Greatest change of speed: a clip is played 1 − warp to 1 + warp times as fast.
    pub warp: f32,
    /// Deviation of the noise on the statics, per frame and per clip.
    pub frame_noise: f32,
    /// Deviation of the shift of the statics that is the same all through a clip.
    pub clip_noise: f32,
    /// Share of memory numbers that a clip's mouth, or its visual emissions, do without.
    pub output_dropout: f32,
    /// Share of the fed-back numbers that a clip's visual emissions do without, 0 to below 1.
    pub feedback_dropout: f32,
    /// Times that every training clip is heard more, disturbed, and the share of pieces that are.
    pub variants: usize,
    /// Share of pieces that are heard disturbed, 0 to below 1.
    pub disturbed: f32,
    /// Share of the disturbed hearings that are as somebody else would say them, 0 to 1.
    pub other_voices: f32,
    /// Share of the disturbed hearings in which something clicks, breathes or hums that is no speech, 0 to 1.
    pub other_sounds: f32,
    /// Share of the disturbed hearings behind which nobody speaks for half a second to two and a half, and the mouth stays where it was, 0 to 1.
    pub pauses: f32,
    /// κ_t: weight of the error towards what the phones of clips without video say of their mouth ([`teach`](super::teach)), per frame; 0: they say nothing.
    pub taught_error: f32,
    /// κ_c: weight of lips that do not meet at p, b and m, or meet elsewhere, per frame, with video and without; 0: nothing is asked of them.
    pub closure_error: f32,
    /// κ_w: weight of the error's change from frame to frame, in clips with video; 0: each frame stands for itself.
    pub motion_error: f32,
    /// κ_g: weight of the lip gap's error in clips with video, per frame, beside that of the mouth; 0: it counts as what it has of the mouth.
    pub gap_error: f32,
    /// κ_l: weight of the lip gap's error in videos of other people, per frame.
    pub lip_error: f32,
    /// Look-aheads in frames of which every piece has one, at random; empty: the context's own.
    pub look_aheads: Vec<usize>,
    /// ρ: 0 weighs standardised parameters alike, 2 is the plain squared error.
    pub error_power: f32,
    /// How a step is taken.
    pub rule: Rule,
    /// Where the parameters start.
    pub start: StartSettings,
    /// Seed of everything that is drawn at random.
    pub seed: u64,
    /// So many training clips with video, drawn by the seed; all where `None`.
    pub clips: Option<usize>,
    /// Training clips that join the validation clips.
    pub hold_out: usize,
}

impl Default for MgeTrainSettings {
    fn default() -> Self {
        Self {
            context: Context::default(),
            inputs: 72,
            memory: 144,
            feedback: Feedback::Output,
            maps: Gate::Both,
            rates: Gate::Visual,
            passes: 70,
            batch: 20,
            crop: 160,
            crops: 0.5,
            audio_entropy: 0.05,
            visual_entropy: 0.05,
            heard_entropy: 0.05,
            atoms: false,
            warp: 0.0,
            frame_noise: 0.15,
            clip_noise: 0.15,
            output_dropout: 0.2,
            feedback_dropout: 0.1,
            variants: 6,
            disturbed: 0.3,
            other_voices: 0.0,
            other_sounds: 0.0,
            pauses: 0.0,
            taught_error: 0.0,
            closure_error: 0.0,
            motion_error: 0.0,
            gap_error: 0.0,
            lip_error: 0.3,
            look_aheads: vec![3, 6, 8],
            error_power: 1.0,
            rule: Rule::default(),
            start: StartSettings::default(),
            seed: 1,
            clips: None,
            hold_out: 0,
        }
    }
}

impl MgeTrainSettings {
    /// These for a model of `shape` that is trained already: it hears as it does, what learns has its own number of memory numbers, and look-aheads beyond its context are left out.
    pub(super) fn of_model(&self, shape: &Shape) -> Self {
        let mut settings = Self {
            context: shape.context.clone(),
            inputs: shape.inputs,
            feedback: shape.feedback,
            maps: shape.maps,
            rates: shape.rates,
            ..self.clone()
        };
        settings
            .look_aheads
            .retain(|frames| *frames <= shape.context.look_ahead());
        settings
    }

    /// Refuses in words what cannot be trained with.
    pub fn check(&self) -> Result<()> {
        self.context.check().map_err(Error::other)?;
        let ok = self.inputs > 0
            && self.memory > 0
            && self.passes > 0
            && self.batch > 0
            && self.batch < 1 << 16
            && self.crop > 0
            && self.rates != Gate::Both;
        if !ok {
            bail!(
                Choice,
                "inputs, memory, passes, batch and crop must be at least 1, and one chain owns the rates"
            );
        }
        for (name, share) in [
            ("dropout of the memory", self.output_dropout),
            ("dropout of the feedback", self.feedback_dropout),
            ("change of speed", self.warp),
            ("share of disturbed pieces", self.disturbed),
        ] {
            if !(0.0..1.0).contains(&share) {
                bail!(Choice, "the {name} is {share}: give 0 or more, less than 1");
            }
        }
        for (name, share) in [
            ("other voices", self.other_voices),
            ("other sounds", self.other_sounds),
            ("pauses", self.pauses),
        ] {
            if !(0.0..=1.0).contains(&share) {
                bail!(Choice, "the share of {name} is {share}: give 0 to 1");
            }
        }
        let positive = [
            self.lip_error,
            self.taught_error,
            self.closure_error,
            self.motion_error,
            self.gap_error,
            self.audio_entropy,
            self.visual_entropy,
            self.heard_entropy,
            self.frame_noise,
            self.clip_noise,
            self.rule.rate,
            self.rule.decay,
            self.rule.transition_rate,
        ];
        if positive.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
            bail!(Choice, "weights, noise, rates and decay must be 0 or more");
        }
        Ok(())
    }
}
