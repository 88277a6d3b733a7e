//! How good a set of parameters is on clips that it was not trained on.
use ndarray::Array2;

use super::pass::{Masks, Tape};
use super::store::Store;
use crate::em::source::in_order;
use crate::error::Result;
use crate::evaluate::metrics::Score;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::recurrent::chain::Chain;
use lipstream::kinds::recurrent::parameters::Parameters;
use lipstream::kinds::recurrent::step::Net;

/// Scores over clips.
#[derive(Clone, Debug)]
pub struct Judgement {
    /// Frames of future that were known.
    pub ahead: usize,
    /// In the units of the visual features.
    pub score: Score,
    /// Number of frames scored.
    pub frames: usize,
    /// Frames whose likeliest phone, viseme and viseme state are those of the forced alignment.
    pub phones: usize,
    /// Frames with the right viseme.
    pub visemes: usize,
    /// Frames with the right state of the viseme.
    pub visual_states: usize,
}

impl Judgement {
    /// `count` as a share of the frames, 0 to 1.
    pub fn share(&self, count: usize) -> f64 {
        count as f64 / self.frames.max(1) as f64
    }

    fn merge(&mut self, other: &Judgement) {
        self.score.merge(&other.score);
        self.frames += other.frames;
        self.phones += other.phones;
        self.visemes += other.visemes;
        self.visual_states += other.visual_states;
    }
}

/// Index of the largest of sums over groups of `size` neighbours.
pub fn largest(values: &[f32], size: usize) -> usize {
    values
        .chunks(size)
        .map(|c| c.iter().sum::<f32>())
        .enumerate()
        .fold(
            (0, f32::NEG_INFINITY),
            |best, (i, v)| if v > best.1 { (i, v) } else { best },
        )
        .0
}

/// Follows every clip, `ahead` frames of its future known, and scores it.
pub fn judge(
    parameters: &Parameters,
    chain: &Chain,
    context_mean: &[f32],
    deviation: &[f32],
    clips: &Store,
    ahead: usize,
    least: f32,
) -> Result<Judgement> {
    let net = Net::new(parameters, chain, least);
    let empty = || Judgement {
        ahead,
        score: Score::new(deviation.len()),
        frames: 0,
        phones: 0,
        visemes: 0,
        visual_states: 0,
    };
    let judge_clip = |n: usize| {
        let clip = clips.get(n)?;
        let mut judged = empty();
        let frames = clip.x.nrows();
        let stacked = parameters.shape.context.stack_within(&clip.x, frames, ahead);
        let context = centred(&stacked, context_mean);
        let tape = Tape::forward(&net, context, Masks::default());
        if let Some(mouth) = &clip.mouth {
            let scaled = |m: &Array2<f32>| m * &ndarray::ArrayView1::from(deviation);
            judged.score.add(&scaled(mouth), &scaled(&tape.output));
        }
        for t in 0..frames {
            let (a, v) = clip.states[t];
            let (audio, visual) = (tape.audio.row(t).to_vec(), tape.visual.row(t).to_vec());
            judged.frames += 1;
            judged.phones += usize::from(largest(&audio, N_EMITTING) == a / N_EMITTING);
            judged.visemes += usize::from(largest(&visual, N_EMITTING) == v / N_EMITTING);
            judged.visual_states += usize::from(largest(&visual, 1) == v);
        }
        Ok(judged)
    };
    let mut total = empty();
    in_order(clips.len(), judge_clip, |judged| {
        total.merge(&judged);
        Ok(())
    })?;
    Ok(total)
}

/// Contexts without their mean.
pub fn centred(context: &Array2<f32>, mean: &[f32]) -> Array2<f32> {
    context - &ndarray::ArrayView1::from(mean)
}
