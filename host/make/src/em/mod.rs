//! EM over utterances (X&L section 3.4 and appendix A): flat start, expectation, re-estimation.
//!
//! Utterances are taken in chunks of fixed size whose sums are added in order: neither memory nor the result depends on how
//! many utterances or threads there are.
use std::ops::Range;

use ndarray::{Array2, Array3, ArrayView1};

use crate::error::{Result, ensure};
use density::{Accumulator, Floors};
use lipstream::hmm::evaluator::{Evaluator, Likelihoods};
use lipstream::hmm::forward_backward::{forward, viterbi};
use lipstream::hmm::graph::Graph;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use source::{Source, Utterance, in_order};

mod best_path;
pub mod density;
pub mod source;
mod transitions;

pub use best_path::expect_by_best_path;
pub use lipstream::hmm::topology::start_transitions;
use transitions::maximise_transitions;

/// Utterances whose sums are added up before they join the others.
const CHUNK: usize = 8;
/// Occupancies below this add nothing worth the work.
const LEAST_OCCUPANCY: f64 = 1e-6;

/// The parameters that EM re-estimates.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Which states each chain has, and how the two may move against each other.
    pub topology: Topology,
    /// The phones of the model, in the order of its states.
    pub phones: Vec<Phone>,
    /// Densities of the audio states (or of joint states, where both streams are one observation).
    pub audio: Mixtures,
    /// Absent in an audio HMM.
    pub visual: Option<Mixtures>,
    /// Natural log, `[phones, classes, 4]`.
    pub transition: Array3<f32>,
}

/// Sums of one pass over the data.
#[derive(Clone, Debug, PartialEq)]
pub struct Sums {
    /// Sums for the audio densities.
    pub audio: Accumulator,
    /// Sums for the visual densities, if the parameters have any.
    pub visual: Option<Accumulator>,
    /// Expected number of times that each choice was made, `[phones, classes, 4]`.
    pub transition: Array3<f64>,
    /// Natural log likelihood of all utterances that a path explains.
    pub log_likelihood: f64,
    /// Frames of those utterances.
    pub frames: usize,
    /// Utterances that no path through their network explains (too short, or words that do not fit).
    pub failed: Vec<String>,
}

impl Sums {
    /// Empty sums of the shape of `parameters`.
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

    /// Adds the sums of other utterances, made with the same parameters.
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

/// Sums from which EM starts: a single Gaussian a state, both chains at the same place.
#[derive(Clone, Debug)]
pub struct Start {
    topology: Topology,
    phones: Vec<Phone>,
    audio: Accumulator,
    /// Of no numbers where there is no video.
    visual: Accumulator,
}

impl Start {
    /// `sizes`: numbers of an audio and of a visual observation.
    pub fn new(topology: Topology, phones: &[Phone], sizes: (usize, usize)) -> Self {
        Self {
            topology,
            phones: phones.to_vec(),
            audio: Accumulator::new(phones.len() * N_EMITTING, 1, sizes.0),
            visual: Accumulator::new(topology.n_visual_states(phones.len()), 1, sizes.1),
        }
    }

    /// Adds an utterance whose frames belong to these phones and states.
    pub fn add(&mut self, utterance: &Utterance, labels: &[(usize, usize)]) {
        for (t, &(phone, i)) in labels.iter().enumerate() {
            self.audio
                .add(N_EMITTING * phone + i, 0, 1.0, row(utterance.audio.row(t)));
            if let Some(v) = &utterance.visual {
                let atom = self.topology.visual_atom(phone, self.phones[phone]);
                for state in self.topology.visual_states_at(atom, i) {
                    self.visual.add(state, 0, 1.0, row(v.row(t)));
                }
            }
        }
    }

    /// Adds all utterances by their start labels.
    pub fn add_all<S: Source + ?Sized>(&mut self, utterances: &S) -> Result<()> {
        in_order(
            utterances.len(),
            |n| utterances.get(n),
            |utterance| {
                self.add(&utterance, &utterance.start);
                Ok(())
            },
        )
    }

    /// States without data get the pooled mean and variance. Floors are 1 % of the pooled variances.
    pub fn finish(self) -> (Parameters, Floors, Option<Floors>) {
        let from = |sums: &Accumulator| {
            let (states, _, size) = sums.first.dim();
            (size > 0).then(|| {
                let (mean, variance) = sums.pooled();
                let floors = Floors::from_pooled(&variance, 0.01);
                let mut mixtures = density::flat(states, &mean, &variance, &floors);
                density::reestimate(&mut mixtures, sums, &floors);
                (mixtures, floors)
            })
        };
        let (audio, audio_floors) = from(&self.audio).expect("an audio observation has numbers");
        let (visual, visual_floors) = from(&self.visual).unzip();
        let transition = start_transitions(self.topology, self.phones.len());
        let parameters = Parameters {
            topology: self.topology,
            phones: self.phones,
            audio,
            visual,
            transition,
        };
        (parameters, audio_floors, visual_floors)
    }
}

/// [`Start`] from the start labels of all utterances.
pub fn start<S: Source + ?Sized>(
    utterances: &S,
    topology: Topology,
    phones: &[Phone],
) -> Result<(Parameters, Floors, Option<Floors>)> {
    ensure!(
        !utterances.is_empty(),
        Data,
        "there is no utterance to start from"
    );
    let first = utterances.get(0)?;
    let sizes = (
        first.audio.ncols(),
        first.visual.as_ref().map_or(0, |v| v.ncols()),
    );
    let mut sums = Start::new(topology, phones, sizes);
    sums.add_all(utterances)?;
    Ok(sums.finish())
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
pub fn expect<S: Source + ?Sized>(parameters: &Parameters, utterances: &S) -> Result<Sums> {
    expect_from(parameters, utterances, 0..utterances.len(), None)
}

/// Number of chunks that so many utterances are summed in.
pub fn chunks(utterances: usize) -> usize {
    utterances.div_ceil(CHUNK)
}

/// The utterances of chunks `from..to` of [`chunks`].
pub fn chunk_range(from: usize, to: usize, utterances: usize) -> Range<usize> {
    (from * CHUNK).min(utterances)..(to * CHUNK).min(utterances)
}

/// E step over the utterances `range`, which begins at a chunk.
///
/// With a `tolerance` it keeps to the labels: a phone is said only within so many frames of where its label puts it (or, in
/// utterances where no path does that, anywhere).
pub fn expect_from<S: Source + ?Sized>(
    parameters: &Parameters,
    utterances: &S,
    range: Range<usize>,
    tolerance: Option<usize>,
) -> Result<Sums> {
    let evaluators = Evaluators::new(parameters);
    let one = |utterance: &Utterance, sums: &mut Sums| {
        expect_one(parameters, &evaluators, utterance, tolerance, sums);
    };
    sum_up(parameters, utterances, range, one)
}

/// Sums over the utterances `range`, of which `one` adds each.
fn sum_up<S: Source + ?Sized>(
    parameters: &Parameters,
    utterances: &S,
    range: Range<usize>,
    one: impl Fn(&Utterance, &mut Sums) + Sync,
) -> Result<Sums> {
    let mut total = Sums::new(parameters);
    in_order(
        chunks(range.len()),
        |chunk| {
            let mut sums = Sums::new(parameters);
            let first = range.start + chunk * CHUNK;
            for n in first..(first + CHUNK).min(range.end) {
                one(&*utterances.get(n)?, &mut sums);
            }
            Ok(sums)
        },
        |sums| {
            total.merge(sums);
            Ok(())
        },
    )?;
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
    maximise_visual(parameters, sums, visual);
    maximise_transitions(parameters, &sums.transition);
}

/// M step of the visual densities alone.
pub fn maximise_visual(parameters: &mut Parameters, sums: &Sums, visual: Option<&Floors>) {
    if let (Some(mixtures), Some(sums), Some(floors)) = (&mut parameters.visual, &sums.visual, visual) {
        density::reestimate(mixtures, sums, floors);
    }
}

/// Audio and visual state of every frame.
pub type Path = Vec<(usize, usize)>;

/// Forced alignment.
pub struct Aligner<'a> {
    parameters: &'a Parameters,
    evaluators: Evaluators,
}

impl<'a> Aligner<'a> {
    /// Prepares the densities of `parameters` for evaluation.
    pub fn new(parameters: &'a Parameters) -> Self {
        Self {
            parameters,
            evaluators: Evaluators::new(parameters),
        }
    }

    /// The best path through an utterance; `None` where none fits.
    pub fn path(&self, utterance: &Utterance) -> Option<Path> {
        let laid = Laid::new(self.parameters, &self.evaluators, utterance);
        let frames = utterance.audio.nrows();
        let (path, _) = viterbi(&laid.graph, &laid.probability, frames, &laid.emission())?;
        let states = path.iter().map(|&s| laid.graph.states[s]);
        Some(states.map(|s| (s.audio, s.visual)).collect())
    }
}

#[cfg(test)]
mod tests;
