//! Random models and the speech that they would speak, for tests and measurements.
use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::{Array1, Array2, Array3};
use rand::{Rng, RngExt, SeedableRng};

use crate::hmm::joint::{N_EMITTING, N_TRANSITION_CLASSES};
use crate::hmm::mixtures::Mixtures;
use crate::hmm::system::System;
use crate::hmm::topology::Topology;
use crate::kinds::likelihood::{ContextMap, EmSettings, Following, LocalLinear, Model};
use crate::kinds::recurrent::context::Context;
use crate::kinds::recurrent::gated::{Gated, GatedShape, PARTS, Part};
use crate::kinds::recurrent::model::RecurrentModel;
use crate::kinds::recurrent::parameters::{Feedback, GROUPS, Gate, Group, Parameters, Shape};
use crate::phones::{Phone, VISEMES};
use crate::random::{fill_normal, normal};

/// Sizes of a random model.
#[derive(Clone, Debug)]
pub struct Sizes {
    /// Phones that the model knows.
    pub phones: Vec<Phone>,
    /// Components of each state's mixture.
    pub densities: usize,
    /// Frames of the context, relative to the current one.
    pub taps: Vec<i32>,
    /// Numbers in the input of the maps.
    pub inputs: usize,
    /// Mouth parameters D.
    pub parameters: usize,
}

impl Sizes {
    /// Nine phones of six visemes, several of a viseme.
    pub fn small() -> Self {
        Self {
            phones: ["sil", "ah", "er", "p", "b", "s", "t", "n", "w"]
                .map(|n| Phone::from_name(n).expect("table 1 has it"))
                .to_vec(),
            densities: 2,
            taps: vec![-6, -3, -1, 0, 2, 4],
            inputs: 10,
            parameters: 5,
        }
    }

    /// What is trained on GRID: 47 phones, 4 densities, 48 inputs, 30 parameters.
    pub fn full() -> Self {
        Self {
            phones: Phone::all().collect(),
            densities: 4,
            taps: vec![-28, -22, -16, -12, -9, -6, -4, -2, 0, 2, 4, 6, 8],
            inputs: 48,
            parameters: 30,
        }
    }
}

/// A valid model with random numbers of the size that features have. Separation of the audio states: `spread` in
/// standard deviations (1 is hard to tell apart, 3 easy).
pub fn model(sizes: &Sizes, spread: f32, rng: &mut impl Rng) -> Model {
    let p = sizes.phones.len();
    let (d, x, stacked) = (sizes.parameters, sizes.inputs, sizes.taps.len() * N_STATIC);
    // Deviations of the front end's numbers: cepstra, energy, their Δ and ΔΔ.
    let deviation: Vec<f32> = (0..N_OBSERVATION)
        .map(|i| {
            let order = [1.0, 0.2, 0.07][i / N_STATIC];
            order * if i % N_STATIC == N_STATIC - 1 { 2.0 } else { 8.0 }
        })
        .collect();
    let states = p * N_EMITTING;
    let shape = (states, sizes.densities, N_OBSERVATION);
    let audio = Mixtures {
        mean: Array3::from_shape_fn(shape, |(_, _, i)| spread * 0.25 * deviation[i] * normal(rng)),
        variance: Array3::from_shape_fn(shape, |(_, _, i)| {
            (deviation[i] * rng.random_range(0.5..1.2)).powi(2)
        }),
        log_weight: random_logs(states, sizes.densities, 0.2, rng),
    };
    let n_visual = VISEMES.len() * N_EMITTING;
    let visual = Mixtures {
        mean: Array3::from_shape_fn((n_visual, 1, d), |(_, _, i)| 300.0 / (i + 1) as f32 * normal(rng)),
        variance: Array3::from_shape_fn((n_visual, 1, d), |(_, _, i)| (200.0 / (i + 1) as f32).powi(2)),
        log_weight: Array2::zeros((n_visual, 1)),
    };
    Model {
        system: System::LOCAL_LINEAR,
        phones: sizes.phones.clone(),
        start_mean: Array1::from_shape_fn(N_STATIC, |i| if i == 12 { 15.0 } else { 5.0 - i as f32 }),
        audio,
        visual,
        transition: transitions(p, rng),
        bigram: random_logs(p, p, 0.01, rng),
        initial: random_logs(1, p, 0.01, rng).row(0).to_owned(),
        context: ContextMap {
            taps: sizes.taps.clone(),
            mean: Array1::from_shape_fn(stacked, |i| deviation[i % N_STATIC] * 0.3 * normal(rng)),
            projection: Array2::from_shape_fn((x, stacked), |(_, i)| {
                normal(rng) / deviation[i % N_STATIC] / (stacked as f32).sqrt()
            }),
        },
        maps: LocalLinear {
            global: Array2::from_shape_fn((d, x + 1), |(i, _)| 100.0 / (i + 1) as f32 * normal(rng)),
            state: Array3::from_shape_fn((n_visual, d, x + 1), |(_, i, j)| {
                let size = if j == x { 150.0 } else { 30.0 };
                size / (i + 1) as f32 * normal(rng)
            }),
        },
        following: Following {
            acoustic_scale: 1.0,
            lag: 4,
        },
        conversion: EmSettings::default(),
        posterior_scale: EmSettings::default().acoustic_scale,
        mouth: None,
        provenance: "random numbers".to_owned(),
    }
}

/// A recurrent model of random numbers of the sizes that trained ones have, grown from `parent`, whose chains own what the gates say.
pub fn recurrent(
    parent: Model,
    outputs: usize,
    feedback: Feedback,
    maps: Gate,
    rates: Gate,
    rng: &mut impl Rng,
) -> RecurrentModel {
    let shape = Shape {
        phones: parent.phones.len(),
        context: Context::default(),
        inputs: 22,
        memory: 17,
        outputs,
        feedback,
        maps,
        rates,
    };
    let mut parameters = Parameters::zeros(&shape);
    for group in GROUPS {
        let (mean, deviation) = match group {
            Group::Projection => (0.0, 0.1),
            Group::Audio => (0.0, 1.0),
            // Few states at the beginning: the device lets six of each chain speak.
            Group::Initial => (0.0, 8.0),
            Group::AudioGain | Group::VisualGain => (0.5, 0.5),
            Group::AudioRate | Group::VisualRate => (-1.0, 1.5),
            _ => (0.0, 0.3),
        };
        fill_normal(parameters.of_mut(group), mean, deviation, rng);
    }
    let transition = parent.transition.iter();
    parameters
        .of_mut(Group::Transition)
        .iter_mut()
        .zip(transition)
        .for_each(|(to, from)| *to = *from);
    RecurrentModel {
        context_mean: (0..shape.context.size())
            .map(|_| rng.random_range(-0.5f32..0.5))
            .collect(),
        scale: (0..13).map(|_| rng.random_range(0.05f32..0.2)).collect(),
        deviation: (0..outputs).map(|d| 100.0 / (d + 1) as f32).collect(),
        least: 1e-4,
        validation_amse: None,
        provenance: "random numbers".to_owned(),
        gated: None,
        parent,
        parameters,
    }
}

/// A second memory of `memory` random numbers for `model`.
pub fn second_memory(model: &RecurrentModel, memory: usize, rng: &mut impl Rng) -> Gated {
    let shape = &model.parameters.shape;
    let mut gated = Gated::zeros(GatedShape {
        inputs: shape.inputs,
        memory,
        outputs: shape.outputs,
        phones: 0,
    });
    for part in PARTS {
        fill_normal(gated.of_mut(part), 0.0, 0.3, rng);
    }
    gated.of_mut(Part::First).iter_mut().for_each(|h| *h = h.tanh());
    gated.share = 0.4;
    gated
}

/// Natural logs of random distributions, one a row, every probability at least `least`/columns.
fn random_logs(rows: usize, columns: usize, least: f32, rng: &mut impl Rng) -> Array2<f32> {
    let mut p = Array2::from_shape_fn((rows, columns), |_| {
        least / columns as f32 + rng.random_range(0.0f32..1.0).powi(3)
    });
    for mut row in p.rows_mut() {
        let sum = row.sum();
        row.mapv_inplace(|v| (v / sum).ln());
    }
    p
}

fn transitions(phones: usize, rng: &mut impl Rng) -> Array3<f32> {
    let mut out = Array3::from_elem((phones, N_TRANSITION_CLASSES, 4), Mixtures::NO_WEIGHT);
    for p in 0..phones {
        for class in 0..N_TRANSITION_CLASSES {
            let allowed = Topology::PH_VI_CHMM.allowed(class);
            let weights: Vec<f32> = allowed
                .iter()
                .map(|a| f32::from(u8::from(*a)) * rng.random_range(0.1..1.0))
                .collect();
            let sum: f32 = weights.iter().sum();
            for (choice, w) in weights.iter().enumerate().filter(|(_, w)| **w > 0.0) {
                out[[p, class, choice]] = (w / sum).ln();
            }
        }
    }
    out
}

/// Observations `[frames, 39]` that the model could have spoken, in whole LSBs of Q7.8: walks through phones drawn from
/// the bigram, about `hold` frames a state, samples from the mixtures.
pub fn speech(model: &Model, frames: usize, hold: usize, rng: &mut impl Rng) -> Array2<f32> {
    let mut out = Array2::zeros((frames, N_OBSERVATION));
    let mut phone = draw(model.initial.iter().copied(), rng);
    let mut i = 0;
    for mut row in out.rows_mut() {
        let state = N_EMITTING * phone + i;
        let k = draw(model.audio.log_weight.row(state).iter().copied(), rng);
        for (d, value) in row.iter_mut().enumerate() {
            let sample =
                model.audio.mean[[state, k, d]] + model.audio.variance[[state, k, d]].sqrt() * normal(rng);
            *value = (sample * 256.0).round().clamp(-32768.0, 32767.0) / 256.0;
        }
        if rng.random_range(0..hold) == 0 {
            i += 1;
            if i == N_EMITTING {
                i = 0;
                phone = draw(model.bigram.row(phone).iter().copied(), rng);
            }
        }
    }
    out
}

/// An index with the probabilities whose logs are given.
fn draw(logs: impl Iterator<Item = f32>, rng: &mut impl Rng) -> usize {
    let mut left: f32 = rng.random();
    let mut last = 0;
    for (i, log) in logs.enumerate() {
        last = i;
        left -= log.exp();
        if left <= 0.0 {
            break;
        }
    }
    last
}

/// Random transitions and bigram over the first `n` phones.
pub fn phones_and_arcs(n: usize, seed: u64) -> (Vec<Phone>, Array3<f32>, Array2<f32>) {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let phones: Vec<Phone> = Phone::all().take(n).collect();
    let topology = Topology::PH_VI_CHMM;
    let mut transition = Array3::from_elem((n, N_TRANSITION_CLASSES, 4), Mixtures::NO_WEIGHT);
    for p in 0..n {
        for class in 0..N_TRANSITION_CLASSES {
            let allowed = topology.allowed(class);
            let raw: Vec<f32> = (0..4).map(|_| rng.random_range(0.1f32..1.0)).collect();
            let sum: f32 = (0..4).filter(|c| allowed[*c]).map(|c| raw[c]).sum();
            for c in (0..4).filter(|c| allowed[*c]) {
                transition[[p, class, c]] = (raw[c] / sum).ln();
            }
        }
    }
    let raw = Array2::from_shape_fn((n, n), |_| rng.random_range(0.05f32..1.0));
    let bigram = Array2::from_shape_fn((n, n), |(p, q)| (raw[[p, q]] / raw.row(p).sum()).ln());
    (phones, transition, bigram)
}
