//! The E step by the best path alone (X&L appendix A: the Viterbi algorithm gives EM reasonable initial values).
use super::source::{Source, Utterance};
use super::{Evaluators, Gatherer, Laid, Parameters, Sums, sum_up};
use crate::error::Result;
use lipstream::hmm::forward_backward::viterbi;

/// [`expect`](super::expect) in which every frame belongs to the one joint state that the best path is in. Components share
/// a frame as they do in EM.
pub fn expect_by_best_path<S: Source + ?Sized>(parameters: &Parameters, utterances: &S) -> Result<Sums> {
    let evaluators = Evaluators::new(parameters);
    let one = |utterance: &Utterance, sums: &mut Sums| add(parameters, &evaluators, utterance, sums);
    sum_up(parameters, utterances, 0..utterances.len(), one)
}

fn add(parameters: &Parameters, evaluators: &Evaluators, utterance: &Utterance, sums: &mut Sums) {
    let laid = Laid::new(parameters, evaluators, utterance);
    let graph = &laid.graph;
    let frames = utterance.audio.nrows();
    let Some((path, log_likelihood)) = viterbi(graph, &laid.probability, frames, &laid.emission()) else {
        sums.failed.push(utterance.id.clone());
        return;
    };
    sums.log_likelihood += log_likelihood;
    sums.frames += frames;
    let mut sound = Gatherer::new(&laid.audio, &utterance.audio);
    for (t, &state) in path.iter().enumerate() {
        sound.frame(t, state, &[1.0], &mut sums.audio);
    }
    if let (Some(likelihoods), Some(observations), Some(sums)) =
        (&laid.visual, &utterance.visual, &mut sums.visual)
    {
        let mut mouth = Gatherer::new(likelihoods, observations);
        for (t, &state) in path.iter().enumerate() {
            mouth.frame(t, state, &[1.0], sums);
        }
    }
    for step in path.windows(2) {
        let (from, leaving) = (
            graph.states[step[0]],
            graph.first[step[0]]..graph.first[step[0] + 1],
        );
        let taken = graph.arcs[leaving].iter().find(|arc| arc.to as usize == step[1]);
        if let Some(arc) = taken {
            sums.transition[[from.phone, from.class, usize::from(arc.choice)]] += 1.0;
        }
    }
}
