//! EM over utterances (X&L section 3.4 and appendix A): flat start, expectation, re-estimation.
//!
//! Utterances are taken in chunks of fixed size whose sums are added in order, so the result does not depend on how
//! many threads there are.
use std::borrow::Cow;
use std::ops::Range;

use anyhow::Result;
use ndarray::{Array2, Array3, ArrayView1};
use rayon::prelude::*;

use super::density::{self, Accumulator, Floors};
use super::evaluator::{Evaluator, Likelihoods};
use super::forward_backward::{forward, viterbi};
use super::graph::Graph;
use super::network::PhoneNetwork;
use super::topology::Topology;
use crate::model::{Mixtures, N_EMITTING};
use crate::phones::Phone;

mod transitions;

use transitions::maximise_transitions;
pub use transitions::start_transitions;

/// Utterances whose sums are added up before they join the others.
const CHUNK: usize = 8;
/// Chunks in memory at once, for each thread.
const CHUNKS_PER_THREAD: usize = 2;
/// Occupancies below this add nothing worth the work.
const LEAST_OCCUPANCY: f64 = 1e-6;

/// What training sees of one clip.
#[derive(Clone, Debug)]
pub struct Utterance {
    pub id: String,
    /// `[frames, 39]`
    pub audio: Array2<f32>,
    /// `[frames, D]` at the audio's rate, or nothing in an audio-only corpus.
    pub visual: Option<Array2<f32>>,
    pub network: PhoneNetwork,
    /// Phone (model index) and state 0..5 of every frame, from labels or evenly spread: where EM starts.
    pub start: Vec<(usize, usize)>,
}

/// Utterances one by one: in memory, or read when they are asked for.
pub trait Source: Sync {
    fn len(&self) -> usize;

    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn get(&self, index: usize) -> Result<Cow<'_, Utterance>>;
}

impl Source for [Utterance] {
    fn len(&self) -> usize {
        <[Utterance]>::len(self)
    }

    fn get(&self, index: usize) -> Result<Cow<'_, Utterance>> {
        Ok(Cow::Borrowed(&self[index]))
    }
}

/// The parameters that EM re-estimates.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    pub topology: Topology,
    pub phones: Vec<Phone>,
    pub audio: Mixtures,
    /// Absent in an audio HMM.
    pub visual: Option<Mixtures>,
    /// Natural log, `[phones, classes, 4]`.
    pub transition: Array3<f32>,
}

/// Sums of one pass over the data.
#[derive(Clone, Debug, PartialEq)]
pub struct Sums {
    pub audio: Accumulator,
    pub visual: Option<Accumulator>,
    /// Expected number of times that each choice was made, `[phones, classes, 4]`.
    pub transition: Array3<f64>,
    pub log_likelihood: f64,
    pub frames: usize,
    /// Utterances that no path through their network explains (too short, or words that do not fit).
    pub failed: Vec<String>,
}

impl Sums {
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            audio: Accumulator::for_mixtures(&parameters.audio),
            visual: parameters.visual.as_ref().map(Accumulator::for_mixtures),
            transition: Array3::zeros(parameters.transition.dim()),
            log_likelihood: 0.0,
            frames: 0,
            failed: Vec::new(),
        }
    }

    pub fn merge(&mut self, other: Sums) {
        self.audio.merge(&other.audio);
        if let (Some(mine), Some(theirs)) = (&mut self.visual, &other.visual) {
            mine.merge(theirs);
        }
        self.transition += &other.transition;
        self.log_likelihood += other.log_likelihood;
        self.frames += other.frames;
        self.failed.extend(other.failed);
    }

    /// Natural log likelihood per frame.
    pub fn per_frame(&self) -> f64 {
        self.log_likelihood / self.frames.max(1) as f64
    }
}

/// Single Gaussians from the frames' start labels; both chains at the same place.
///
/// States without data get the pooled mean and variance. Floors are 1 % of the pooled variances.
pub fn start(
    utterances: &[Utterance],
    topology: Topology,
    phones: &[Phone],
) -> (Parameters, Floors, Option<Floors>) {
    start_from(utterances, topology, phones).expect("utterances in memory are there")
}

/// [`start`] from any source; the error is the source's.
pub fn start_from<S: Source + ?Sized>(
    utterances: &S,
    topology: Topology,
    phones: &[Phone],
) -> Result<(Parameters, Floors, Option<Floors>)> {
    let n_audio = phones.len() * N_EMITTING;
    let n_visual = topology.n_visual_states(phones.len());
    let (mut dim_audio, mut dim_visual) = (0, 0);
    if !utterances.is_empty() {
        let first = utterances.get(0)?;
        dim_audio = first.audio.ncols();
        dim_visual = first.visual.as_ref().map_or(0, |v| v.ncols());
    }
    let mut audio = Accumulator::new(n_audio, 1, dim_audio);
    let mut visual = Accumulator::new(n_visual, 1, dim_visual);
    for n in 0..utterances.len() {
        let utterance = utterances.get(n)?;
        for (t, &(phone, i)) in utterance.start.iter().enumerate() {
            audio.add(N_EMITTING * phone + i, 0, 1.0, row(utterance.audio.row(t)));
            if let Some(v) = &utterance.visual {
                let atom = topology.visual_atom(phone, phones[phone]);
                visual.add(N_EMITTING * atom + i, 0, 1.0, row(v.row(t)));
            }
        }
    }
    let from = |sums: &Accumulator, states: usize| {
        let (mean, variance) = sums.pooled();
        let floors = Floors::from_pooled(&variance, 0.01);
        let mut mixtures = density::flat(states, &mean, &variance, &floors);
        density::reestimate(&mut mixtures, sums, &floors);
        (mixtures, floors)
    };
    let (audio, audio_floors) = from(&audio, n_audio);
    let (visual, visual_floors) = match dim_visual {
        0 => (None, None),
        _ => {
            let (mixtures, floors) = from(&visual, n_visual);
            (Some(mixtures), Some(floors))
        }
    };
    let transition = start_transitions(topology, phones.len());
    Ok((
        Parameters {
            topology,
            phones: phones.to_vec(),
            audio,
            visual,
            transition,
        },
        audio_floors,
        visual_floors,
    ))
}

fn row<'a>(row: ArrayView1<'a, f32>) -> &'a [f32] {
    row.to_slice()
        .expect("rows of an array in standard layout are slices")
}

/// Adds occupancies of joint states, shared among the components (eq. A.15), frame by frame.
struct Gatherer<'a> {
    likelihoods: &'a Likelihoods<'a>,
    observations: &'a Array2<f32>,
    /// γ of each column in the present frame, and the columns that have any.
    occupancy: Vec<f64>,
    touched: Vec<usize>,
    powers: Vec<[f64; 2]>,
}

impl<'a> Gatherer<'a> {
    fn new(likelihoods: &'a Likelihoods<'a>, observations: &'a Array2<f32>) -> Self {
        Self {
            likelihoods,
            observations,
            occupancy: vec![0.0; likelihoods.states().len()],
            touched: Vec::new(),
            powers: Vec::new(),
        }
    }

    /// Occupancies `gamma` of the joint states `first..` at frame t.
    fn frame(&mut self, t: usize, first: usize, gamma: &[f64], sums: &mut Accumulator) {
        for (s, &occupancy) in gamma.iter().enumerate() {
            if occupancy > 0.0 {
                let column = self.likelihoods.column(first + s);
                if self.occupancy[column] == 0.0 {
                    self.touched.push(column);
                }
                self.occupancy[column] += occupancy;
            }
        }
        self.powers.clear();
        self.powers.extend(density::powers(row(self.observations.row(t))));
        for column in self.touched.drain(..) {
            let occupancy = std::mem::take(&mut self.occupancy[column]);
            if occupancy < LEAST_OCCUPANCY {
                continue;
            }
            let state = self.likelihoods.states()[column];
            self.likelihoods.shares(t, column, |k, share| {
                let share = occupancy * share;
                if share >= LEAST_OCCUPANCY {
                    sums.add_powers(state, k, share, &self.powers);
                }
            });
        }
    }
}

struct Evaluators {
    audio: Evaluator,
    visual: Option<Evaluator>,
}

impl Evaluators {
    fn new(parameters: &Parameters) -> Self {
        Self {
            audio: Evaluator::new(&parameters.audio),
            visual: parameters.visual.as_ref().map(Evaluator::new),
        }
    }
}

/// One utterance's graph, arcs and likelihoods.
struct Laid<'a> {
    graph: Graph,
    probability: Vec<f64>,
    audio: Likelihoods<'a>,
    visual: Option<Likelihoods<'a>>,
}

impl<'a> Laid<'a> {
    fn new(parameters: &Parameters, evaluators: &'a Evaluators, utterance: &Utterance) -> Self {
        let graph = Graph::build(&utterance.network, parameters.topology, &parameters.phones);
        let probability = graph.probabilities(&parameters.transition);
        let audio = Likelihoods::new(
            graph.states.iter().map(|s| s.audio),
            &evaluators.audio,
            utterance.audio.view(),
        );
        let visual = match (&evaluators.visual, &utterance.visual) {
            (Some(evaluator), Some(observations)) => Some(Likelihoods::new(
                graph.states.iter().map(|s| s.visual),
                evaluator,
                observations.view(),
            )),
            _ => None,
        };
        Self {
            graph,
            probability,
            audio,
            visual,
        }
    }

    fn emission(&self) -> impl Fn(usize, usize) -> f64 + '_ {
        |t, s| {
            let audio = f64::from(self.audio.log(t, s));
            audio + self.visual.as_ref().map_or(0.0, |v| f64::from(v.log(t, s)))
        }
    }
}

/// Frames that are added to the tolerance where labels are too short for their states.
const MORE_ROOM: usize = 4;

/// Phones that each frame may belong to, `[frames, phones]`: those labelled within `tolerance` frames.
fn labelled(utterance: &Utterance, phones: usize, tolerance: usize) -> Array2<bool> {
    let frames = utterance.audio.nrows();
    let mut near = Array2::from_elem((frames, phones), false);
    for (t, &(phone, _)) in utterance.start.iter().enumerate() {
        for u in t.saturating_sub(tolerance)..(t + tolerance + 1).min(frames) {
            near[[u, phone]] = true;
        }
    }
    near
}

fn expect_one(
    parameters: &Parameters,
    evaluators: &Evaluators,
    utterance: &Utterance,
    tolerance: Option<usize>,
    sums: &mut Sums,
) {
    let laid = Laid::new(parameters, evaluators, utterance);
    let frames = utterance.audio.nrows();
    let free = laid.emission();
    let held = |tolerance: usize| {
        let near = labelled(utterance, parameters.phones.len(), tolerance);
        let emission = |t: usize, s: usize| match near[[t, laid.graph.states[s].phone]] {
            false => f64::NEG_INFINITY,
            true => free(t, s),
        };
        forward(&laid.graph, &laid.probability, frames, &emission)
    };
    // Labels shorter than their states need more room.
    let forward = tolerance
        .and_then(|tolerance| held(tolerance).or_else(|| held(tolerance + MORE_ROOM)))
        .or_else(|| forward(&laid.graph, &laid.probability, frames, &free));
    let Some(forward) = forward else {
        sums.failed.push(utterance.id.clone());
        return;
    };
    sums.log_likelihood += forward.log_likelihood;
    sums.frames += frames;
    let mut sound = Gatherer::new(&laid.audio, &utterance.audio);
    let mut mouth = match (&laid.visual, &utterance.visual, &mut sums.visual) {
        (Some(likelihoods), Some(observations), Some(sums)) => {
            Some((Gatherer::new(likelihoods, observations), sums))
        }
        _ => None,
    };
    let mut taken = vec![0.0; laid.graph.arcs.len()];
    forward.backward_each(
        &laid.graph,
        &laid.probability,
        |t, first, gamma| {
            sound.frame(t, first, gamma, &mut sums.audio);
            if let Some((mouth, sums)) = &mut mouth {
                mouth.frame(t, first, gamma, sums);
            }
        },
        |_, index, xi| taken[index] += xi,
    );
    for (arc, xi) in laid.graph.arcs.iter().zip(taken) {
        let state = laid.graph.states[arc.from as usize];
        sums.transition[[state.phone, state.class, usize::from(arc.choice)]] += xi;
    }
}

/// E step over all utterances.
pub fn expect(parameters: &Parameters, utterances: &[Utterance], done: &(dyn Fn(usize) + Sync)) -> Sums {
    expect_within(parameters, utterances, None, done)
}

/// [`expect`] that keeps to the labels: a phone is said only within so many frames of where its label puts it (or, in
/// utterances where no path does that, anywhere).
pub fn expect_within(
    parameters: &Parameters,
    utterances: &[Utterance],
    tolerance: Option<usize>,
    done: &(dyn Fn(usize) + Sync),
) -> Sums {
    expect_from(parameters, utterances, 0..utterances.len(), tolerance, done)
        .expect("utterances in memory are there")
}

/// Number of chunks that so many utterances are summed in.
pub fn chunks(utterances: usize) -> usize {
    utterances.div_ceil(CHUNK)
}

/// The utterances of chunks `from..to` of [`chunks`].
pub fn chunk_range(from: usize, to: usize, utterances: usize) -> Range<usize> {
    (from * CHUNK).min(utterances)..(to * CHUNK).min(utterances)
}

/// E step over the utterances `range` of a source, which begins at a chunk. No more than a few chunks are in memory at
/// once; the error is the source's.
pub fn expect_from<S: Source + ?Sized>(
    parameters: &Parameters,
    utterances: &S,
    range: Range<usize>,
    tolerance: Option<usize>,
    done: &(dyn Fn(usize) + Sync),
) -> Result<Sums> {
    let evaluators = Evaluators::new(parameters);
    let firsts: Vec<usize> = range.clone().step_by(CHUNK).collect();
    let mut total = Sums::new(parameters);
    for wave in firsts.chunks(CHUNKS_PER_THREAD * rayon::current_num_threads()) {
        let parts: Vec<Sums> = wave
            .par_iter()
            .map(|&first| {
                let mut sums = Sums::new(parameters);
                let chunk = first..(first + CHUNK).min(range.end);
                done(chunk.len());
                for n in chunk {
                    expect_one(
                        parameters,
                        &evaluators,
                        &*utterances.get(n)?,
                        tolerance,
                        &mut sums,
                    );
                }
                Ok(sums)
            })
            .collect::<Result<_>>()?;
        // In the order of the chunks, whatever the number of threads.
        parts.into_iter().for_each(|part| total.merge(part));
    }
    Ok(total)
}

/// What the data cannot teach, a line each: phones that are hardly ever said, numbers that never change.
pub fn warnings(parameters: &Parameters, sums: &Sums, floors: &Floors) -> Vec<String> {
    let mut out = Vec::new();
    for (p, phone) in parameters.phones.iter().enumerate() {
        let states = N_EMITTING * p..N_EMITTING * (p + 1);
        let rows = states.map(|s| sums.audio.occupancy.row(s).sum());
        let (frames, untaught) = rows.fold((0.0, 0), |(frames, untaught), n| {
            (frames + n, untaught + usize::from(n < floors.occupancy))
        });
        if untaught > 0 && frames > 0.5 {
            out.push(format!(
                "warning: {} is said in {frames:.0} frames only; {untaught} of its {N_EMITTING} states keep what they had",
                phone.name()
            ));
        }
    }
    let (_, variance) = sums.audio.pooled();
    let constant: Vec<String> = (0..variance.len())
        .filter(|&i| variance[i] < CONSTANT)
        .map(|i| i.to_string())
        .collect();
    if !constant.is_empty() {
        out.push(format!(
            "warning: audio numbers {} never change; their variances are floored",
            constant.join(", ")
        ));
    }
    out
}

/// A smaller pooled variance is that of a number that does not change.
const CONSTANT: f64 = 1e-9;

/// M step: densities and transitions.
pub fn maximise(parameters: &mut Parameters, sums: &Sums, audio: &Floors, visual: Option<&Floors>) {
    density::reestimate(&mut parameters.audio, &sums.audio, audio);
    if let (Some(mixtures), Some(sums), Some(floors)) = (&mut parameters.visual, &sums.visual, visual) {
        density::reestimate(mixtures, sums, floors);
    }
    maximise_transitions(parameters, &sums.transition);
}

/// Forced alignment: audio state and visual state of every frame; `None` where no path fits.
pub fn align(parameters: &Parameters, utterances: &[Utterance]) -> Vec<Option<Vec<(usize, usize)>>> {
    let evaluators = Evaluators::new(parameters);
    utterances
        .par_iter()
        .map(|utterance| {
            let laid = Laid::new(parameters, &evaluators, utterance);
            let frames = utterance.audio.nrows();
            let (path, _) = viterbi(&laid.graph, &laid.probability, frames, &laid.emission())?;
            Some(
                path.iter()
                    .map(|&s| (laid.graph.states[s].audio, laid.graph.states[s].visual))
                    .collect(),
            )
        })
        .collect()
}

#[cfg(test)]
mod tests;
