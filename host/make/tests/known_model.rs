//! Data drawn from a known ph-vi-CHMM whose chains truly run apart: training must find that model again, it must explain unseen
//! data best and convert best, and each of the simpler systems must be worse by what it cannot say.
use lipstream::hmm::Hmm;
use lipstream::hmm::graph::Graph;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::hmm::system::Density;
use lipstream::hmm::topology::Topology;
use lipstream::kinds::likelihood::convert::Lag;
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::likelihood::{EmSettings, MStep};
use lipstream::phones::Phone;
use lipstream::random::normal;
use lipstream_make::em::source::Utterance;
use lipstream_make::em::{self, Parameters};
use lipstream_make::evaluate::metrics::Score;
use ndarray::{Array2, Array3, Axis, concatenate, s};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const AUDIO: usize = 4;
const VISUAL: usize = 6;
const PASSES: usize = 15;

/// Single Gaussians of variance 1 whose means lie `spread` apart.
fn gaussians(states: usize, size: usize, spread: f32, rng: &mut Pcg64) -> Mixtures {
    Mixtures {
        mean: Array3::from_shape_fn((states, 1, size), |_| spread * normal(rng)),
        variance: Array3::ones((states, 1, size)),
        log_weight: Array2::zeros((states, 1)),
    }
}

/// Ten phones of four visemes. A chain advances alone more often than both do together.
fn truth(rng: &mut Pcg64) -> Parameters {
    let phones: Vec<Phone> = ["sil", "p", "b", "m", "iy", "ih", "ax", "t", "d", "n"]
        .map(|n| Phone::from_name(n).unwrap())
        .to_vec();
    let topology = Topology::PH_VI_CHMM;
    let mut transition = em::start_transitions(topology, phones.len());
    for mut row in transition.rows_mut() {
        // Stay, sound, mouth, both.
        let weights = [2.0, 1.0, 1.0, 0.3f32].map(|w| w * rng.random_range(0.6..1.4f32));
        let allowed: Vec<usize> = (0..4).filter(|&c| row[c] > Mixtures::NO_WEIGHT).collect();
        let sum: f32 = allowed.iter().map(|&c| weights[c]).sum();
        allowed.iter().for_each(|&c| row[c] = (weights[c] / sum).ln());
    }
    Parameters {
        topology,
        audio: gaussians(phones.len() * N_EMITTING, AUDIO, 2.0, rng),
        visual: Some(gaussians(
            topology.n_visual_states(phones.len()),
            VISUAL,
            3.0,
            rng,
        )),
        transition,
        phones,
    }
}

/// What the model says, phones drawn evenly; the labels put the phones where their sound is, evenly over their states.
fn spoken(truth: &Parameters, name: String, rng: &mut Pcg64) -> Utterance {
    let said: Vec<usize> = (0..8).map(|_| rng.random_range(0..truth.phones.len())).collect();
    let network = PhoneNetwork::chain(&said);
    let graph = Graph::build(&network, truth.topology, &truth.phones);
    let probability = graph.probabilities(&truth.transition);
    let end = graph.exits.as_ref().unwrap()[0];
    let mut path = vec![graph.entries[0].0];
    while path[path.len() - 1] != end {
        let here = path[path.len() - 1];
        let leaving = graph.first[here]..graph.first[here + 1];
        // Near the end some choices lead nowhere.
        let total: f64 = probability[leaving.clone()].iter().sum();
        let mut left = rng.random_range(0.0..total);
        let arc = leaving.clone().find(|&arc| {
            left -= probability[arc];
            left <= 0.0
        });
        path.push(graph.arcs[arc.unwrap_or(leaving.end - 1)].to as usize);
    }
    let draw = |mixtures: &Mixtures, state: usize, rng: &mut Pcg64| -> Vec<f32> {
        let mean = mixtures.mean.slice(s![state, 0, ..]).to_vec();
        mean.into_iter().map(|m| m + normal(rng)).collect()
    };
    let visual = truth.visual.as_ref().unwrap();
    let (mut heard, mut seen) = (Vec::new(), Vec::new());
    for &at in &path {
        heard.extend(draw(&truth.audio, graph.states[at].audio, rng));
        seen.extend(draw(visual, graph.states[at].visual, rng));
    }
    let node = |t: usize| graph.states[path[t]].node;
    let start = (0..path.len()).map(|t| {
        let of_phone = (0..path.len()).filter(|&u| node(u) == node(t));
        let (first, length) = (of_phone.clone().next().unwrap(), of_phone.count());
        (said[node(t)], (t - first) * N_EMITTING / length)
    });
    Utterance {
        id: name,
        start: start.collect(),
        audio: Array2::from_shape_vec((path.len(), AUDIO), heard).unwrap(),
        visual: Some(Array2::from_shape_vec((path.len(), VISUAL), seen).unwrap()),
        network,
    }
}

/// [oᵃ; oᵛ] as one observation.
fn stacked(utterances: &[Utterance]) -> Vec<Utterance> {
    let both = |u: &Utterance| {
        let visual = u.visual.as_ref().unwrap();
        Utterance {
            audio: concatenate![Axis(1), u.audio, *visual]
                .as_standard_layout()
                .into_owned(),
            visual: None,
            ..u.clone()
        }
    };
    utterances.iter().map(both).collect()
}

fn trained(topology: Topology, phones: &[Phone], utterances: &[Utterance]) -> Parameters {
    let (mut parameters, audio, visual) = em::start(utterances, topology, phones).unwrap();
    for _ in 0..PASSES {
        let sums = em::expect(&parameters, utterances).unwrap();
        assert!(sums.failed.is_empty());
        em::maximise(&mut parameters, &sums, &audio, visual.as_ref());
    }
    parameters
}

/// How well a system predicts unseen mouths, in the loop over all phones: by the posterior mean, and by EM's first and last estimate.
struct Converted {
    posterior: f64,
    path: f64,
    em: f64,
}

fn converted(parameters: &Parameters, density: Density, unseen: &[Utterance]) -> Converted {
    let n = parameters.phones.len();
    let initial = vec![-(n as f32).ln(); n];
    let bigram = Array2::from_elem((n, n), -(n as f32).ln());
    let part = |m: &Mixtures, from: usize, to: usize| Mixtures {
        mean: m.mean.slice(s![.., .., from..to]).to_owned(),
        variance: m.variance.slice(s![.., .., from..to]).to_owned(),
        log_weight: m.log_weight.clone(),
    };
    let (audio, visual) = match &parameters.visual {
        Some(visual) => (parameters.audio.clone(), visual.clone()),
        None => (
            part(&parameters.audio, 0, AUDIO),
            part(&parameters.audio, AUDIO, AUDIO + VISUAL),
        ),
    };
    let inverter = Inverter::new(Hmm {
        topology: parameters.topology,
        density,
        phones: &parameters.phones,
        audio: &audio,
        visual: &visual,
        transition: &parameters.transition,
        initial: &initial,
        bigram: &bigram,
    });
    let paper = EmSettings {
        acoustic_scale: 1.0,
        visual_exponent: 1.0,
        iterations: 6,
        m_step: MStep::Exact,
    };
    let mut scores = [(); 3].map(|()| Score::new(VISUAL));
    for u in unseen {
        let actual = u.visual.as_ref().unwrap();
        let (mean, _) = inverter.posterior_mean(&u.audio, 1.0, Lag::Whole).unwrap();
        let em = inverter.iterations(&u.audio, &paper).unwrap();
        for (score, said) in scores
            .iter_mut()
            .zip([&mean, &em[0].parameters, &em[em.len() - 1].parameters])
        {
            score.add(actual, said);
        }
    }
    let [posterior, path, em] = scores.map(|score| score.amse());
    Converted { posterior, path, em }
}

#[test]
fn the_model_that_made_the_data_is_found_and_is_best() {
    let mut rng = Pcg64::seed_from_u64(7);
    let truth = truth(&mut rng);
    let mut draw = |n: usize| -> Vec<Utterance> {
        (0..n)
            .map(|k| spoken(&truth, format!("u{k}"), &mut rng))
            .collect()
    };
    let (train, unseen) = (draw(200), draw(80));
    let frames: usize = train.iter().map(|u| u.audio.nrows()).sum();
    let found = trained(Topology::PH_VI_CHMM, &truth.phones, &train);

    // Means by root mean square, in deviations; transitions by their mean distance, each as often as it is made.
    let apart = |a: &Mixtures, b: &Mixtures, used: &[usize]| {
        let pairs = used.iter().flat_map(|&s| {
            let row = |m: &Mixtures| m.mean.slice(s![s, 0, ..]).to_vec();
            row(a).into_iter().zip(row(b))
        });
        let squares: Vec<f64> = pairs.map(|(x, y)| f64::from(x - y).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let audio_states: Vec<usize> = (0..truth.audio.mean.dim().0).collect();
    let visual_states: Vec<usize> = truth
        .phones
        .iter()
        .flat_map(|phone| (0..N_EMITTING).map(|j| N_EMITTING * usize::from(phone.viseme().0) + j))
        .collect();
    let audio = apart(&truth.audio, &found.audio, &audio_states);
    let visual = apart(
        truth.visual.as_ref().unwrap(),
        found.visual.as_ref().unwrap(),
        &visual_states,
    );
    let made = em::expect(&truth, &train[..]).unwrap().transition;
    let distance: f64 = made
        .iter()
        .zip(truth.transition.iter().zip(&found.transition))
        .map(|(n, (a, b))| n * f64::from(a.exp() - b.exp()).abs())
        .sum();
    let transition = distance / made.sum();
    println!(
        "{frames} frames: audio means {audio:.3}, visual means {visual:.3}, transitions {transition:.3}"
    );

    // With few data it tells that phones which look alike are taught alike.
    let few = &train[..40];
    let learn = |topology| trained(topology, &truth.phones, few);
    let (right, wide) = (learn(Topology::PH_VI_CHMM), learn(Topology::PH_VI_CHMM.within(2)));
    let (phones, one) = (learn(Topology::PH_CHMM), learn(Topology::PH_HMM));
    let joint = trained(Topology::PH_HMM, &truth.phones, &stacked(few));
    let likely =
        |parameters: &Parameters, data: &[Utterance]| em::expect(parameters, data).unwrap().per_frame();
    let row = |name, of: &Parameters| {
        (
            name,
            likely(of, &unseen),
            converted(of, Density::Streams, &unseen),
        )
    };
    let rows = [
        row("truth", &truth),
        row("ph-vi-chmm", &right),
        row("ph-vi-chmm-2", &wide),
        row("ph-chmm", &phones),
        row("ph-mshmm", &one),
        (
            "ph-hmm",
            likely(&joint, &stacked(&unseen)),
            converted(&joint, Density::Joint, &unseen),
        ),
    ];
    for (name, likelihood, said) in &rows {
        println!(
            "{name:12} {likelihood:8.3} a frame, AMSE: posterior mean {:.2}, path {:.2}, EM {:.2}",
            said.posterior, said.path, said.em
        );
    }
    // What made the data is found again.
    assert!(audio < 0.06 && visual < 0.04 && transition < 0.04);
    let [truth, right, wide, phones, one, joint] = &rows;
    // It explains what it has not seen better than what has more to learn, and far better than one chain.
    assert!(right.1 > truth.1 - 0.16, "much is left to be learnt");
    assert!(right.1 > phones.1 + 0.02);
    // A band wider than need be costs little.
    assert!((right.1 - wide.1).abs() < 0.01);
    assert!(right.1 > one.1 + 2.0 && right.1 > joint.1 + 2.0);
    // The mean of the mouth is best said by it, too. The tie of visemes gains hardly anything there.
    let best = right.2.posterior;
    assert!(best < 1.08 * truth.2.posterior && best <= 1.002 * phones.2.posterior.min(wide.2.posterior));
    assert!(best < 0.75 * one.2.posterior.min(joint.2.posterior));
    // Under the true model itself, X&L's EM never leaves the path that it begins with, which is far from the mean.
    assert!((truth.2.em - truth.2.path).abs() < 0.01 * truth.2.path);
    assert!(truth.2.em > 1.6 * truth.2.posterior);
}
