//! Every system's HMM against enumeration of all paths, written from the definition: two chains that walk along unrolled
//! phones, no border states, no sharing.
use lipstream::hmm::Hmm;
use lipstream::hmm::evaluator::Evaluator;
use lipstream::hmm::joint::{N_EMITTING, choice};
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::hmm::system::{Density, SYSTEMS, Speech, System};
use lipstream::hmm::topology::{Pairing, VisualAtom};
use lipstream::kinds::likelihood::convert;
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::likelihood::{EmSettings, MStep};
use lipstream::phones::Phone;
use lipstream_make::em::density::Floors;
use lipstream_make::em::source::Utterance;
use lipstream_make::em::{self, Parameters};
use ndarray::{Array1, Array2, Array3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Called with a path's probability and its states.
type Visit<'a> = dyn FnMut(f64, &[(usize, usize)]) + 'a;

/// A tiny HMM of everything a system needs: three phones of two visemes, two components a state.
struct Tiny {
    system: System,
    phones: Vec<Phone>,
    audio: Mixtures,
    visual: Mixtures,
    transition: Array3<f32>,
    initial: Vec<f32>,
    bigram: Array2<f32>,
}

fn mixtures(states: usize, size: usize, rng: &mut Pcg64) -> Mixtures {
    let mut log_weight = Array2::zeros((states, 2));
    for mut row in log_weight.outer_iter_mut() {
        let w: f32 = rng.random_range(0.2..0.8);
        row.assign(&ndarray::array![w.ln(), (1.0 - w).ln()]);
    }
    Mixtures {
        mean: Array3::from_shape_fn((states, 2, size), |_| rng.random_range(-2.0f32..2.0)),
        variance: Array3::from_shape_fn((states, 2, size), |_| rng.random_range(0.5f32..2.0)),
        log_weight,
    }
}

impl Tiny {
    fn new(system: System, seed: u64) -> Self {
        let rng = &mut Pcg64::seed_from_u64(seed);
        // b and p share a viseme.
        let phones: Vec<Phone> = ["sil", "b", "p"].map(|n| Phone::from_name(n).unwrap()).to_vec();
        let topology = system.topology;
        let n = phones.len();
        let audio = mixtures(n * N_EMITTING, 2, rng);
        let mut visual = mixtures(topology.n_visual_states(n), 2, rng);
        if system.density == Density::Joint {
            visual.log_weight = audio.log_weight.clone();
        }
        let mut transition = em::start_transitions(topology, n);
        if topology.pairing != Pairing::Free {
            for p in 0..n {
                for class in 0..topology.classes_per_phone() {
                    let allowed = topology.allowed(class);
                    let w: Vec<f32> = allowed
                        .iter()
                        .map(|a| if *a { rng.random_range(0.2f32..1.0) } else { 0.0 })
                        .collect();
                    let sum: f32 = w.iter().sum();
                    for c in (0..4).filter(|&c| allowed[c]) {
                        transition[[p, class, c]] = (w[c] / sum).ln();
                    }
                }
            }
        }
        let bigram = Array2::from_shape_fn((n, n), |(p, q)| {
            [[0.2f32, 0.5, 0.3], [0.6, 0.1, 0.3], [0.7, 0.2, 0.1]][p][q].ln()
        });
        Self {
            system,
            phones,
            audio,
            visual,
            transition,
            initial: vec![0.5f32.ln(), 0.3f32.ln(), 0.2f32.ln()],
            bigram,
        }
    }

    fn hmm(&self) -> Hmm<'_> {
        Hmm {
            topology: self.system.topology,
            density: self.system.density,
            phones: &self.phones,
            audio: &self.audio,
            visual: &self.visual,
            transition: &self.transition,
            initial: &self.initial,
            bigram: &self.bigram,
        }
    }

    fn atom(&self, phone: usize) -> usize {
        match self.system.topology.visual {
            VisualAtom::Phone | VisualAtom::Pair => phone,
            VisualAtom::Viseme => usize::from(self.phones[phone].viseme().0),
        }
    }

    /// Visual state when the chains are in states `i` and `j` of their phones, the mouth's being `phone`.
    fn visual(&self, phone: usize, i: usize, j: usize) -> usize {
        match self.system.topology.visual {
            VisualAtom::Pair => 25 * phone + 5 * i + j,
            _ => N_EMITTING * self.atom(phone) + j,
        }
    }

    /// Row of the transition table when the chains stand at places `a` and `v` of the unrolled `said`.
    fn class(&self, said: &[usize], a: usize, v: usize) -> (usize, usize) {
        let (i, j) = (a % N_EMITTING, v % N_EMITTING);
        let phone = said[a / N_EMITTING];
        let class = match self.system.topology.pairing {
            Pairing::Equal => i,
            Pairing::Free => N_EMITTING * i + j,
            Pairing::Band(_) => {
                let topology = self.system.topology;
                match (a / N_EMITTING).cmp(&(v / N_EMITTING)) {
                    std::cmp::Ordering::Equal => topology.inside_class(i, j),
                    std::cmp::Ordering::Less => topology.mouth_leads_class(i, j),
                    std::cmp::Ordering::Greater => topology.sound_leads_class(i, j),
                }
            }
        };
        (phone, class)
    }

    /// Calls `path` with the probability and the states of every path of `frames` frames over the phone loop.
    fn every_path(&self, frames: usize, path: &mut Visit<'_>) {
        for (p, log) in self.initial.iter().enumerate() {
            let mut said = vec![p];
            let first = vec![(N_EMITTING * p, self.visual(p, 0, 0))];
            self.walk(&mut said, (0, 0), f64::from(log.exp()), first, frames, path);
        }
    }

    fn walk(
        &self,
        said: &mut Vec<usize>,
        (a, v): (usize, usize),
        probability: f64,
        so_far: Vec<(usize, usize)>,
        frames: usize,
        path: &mut Visit<'_>,
    ) {
        if so_far.len() == frames {
            return path(probability, &so_far);
        }
        let (phone, class) = self.class(said, a, v);
        for (c, da, dv) in [
            (choice::STAY, 0, 0),
            (choice::AUDIO_ADVANCES, 1, 0),
            (choice::VISUAL_ADVANCES, 0, 1),
            (choice::BOTH_ADVANCE, 1, 1),
        ] {
            let (a2, v2) = (a + da, v + dv);
            let together = a2 / N_EMITTING == v2 / N_EMITTING;
            let exists = match self.system.topology.pairing {
                Pairing::Equal => a2 == v2,
                Pairing::Free => {
                    together && (a2 % N_EMITTING > 0 || a2 == a || (a % N_EMITTING, v % N_EMITTING) == (4, 4))
                }
                Pairing::Band(width) => a2.abs_diff(v2) <= width,
            };
            if !exists {
                continue;
            }
            let step = probability * f64::from(self.transition[[phone, class, c]]).exp();
            let place = |said: &[usize]| {
                (
                    N_EMITTING * said[a2 / N_EMITTING] + a2 % N_EMITTING,
                    self.visual(said[v2 / N_EMITTING], a2 % N_EMITTING, v2 % N_EMITTING),
                )
            };
            let mut go_on = |said: &mut Vec<usize>, step: f64| {
                let mut next = so_far.clone();
                next.push(place(said));
                self.walk(said, (a2, v2), step, next, frames, path);
            };
            if a2.max(v2) / N_EMITTING < said.len() {
                go_on(said, step);
            } else {
                // The chain in front comes to a new phone.
                let last = said[said.len() - 1];
                for q in 0..self.phones.len() {
                    said.push(q);
                    go_on(said, step * f64::from(self.bigram[[last, q]]).exp());
                    said.pop();
                }
            }
        }
    }
}

const FRAMES: usize = 7;

fn observations(seed: u64) -> (Array2<f32>, Array2<f32>) {
    let rng = &mut Pcg64::seed_from_u64(seed);
    let mut noise = || Array2::from_shape_fn((FRAMES, 2), |_| rng.random_range(-2.0f32..2.0));
    (noise(), noise())
}

/// The paper's six and their variants; the others share their HMMs.
fn hmms() -> impl Iterator<Item = System> {
    SYSTEMS
        .into_iter()
        .filter(|system| system.speech == Speech::Means)
}

/// Density of a component at an observation, from the definition.
fn normal(m: &Mixtures, state: usize, k: usize, o: &[f32]) -> f64 {
    (0..o.len())
        .map(|i| {
            let (mean, variance) = (
                f64::from(m.mean[[state, k, i]]),
                f64::from(m.variance[[state, k, i]]),
            );
            let x = f64::from(o[i]) - mean;
            (-x * x / (2.0 * variance)).exp() / (std::f64::consts::TAU * variance).sqrt()
        })
        .product()
}

#[test]
fn occupancies_of_the_loop_are_those_of_all_paths() {
    for (n, system) in hmms().enumerate() {
        let tiny = Tiny::new(system, n as u64);
        let (sound, _) = observations(40 + n as u64);
        let scale = 0.7f32;
        let (audio, visual) = convert::Follower::new(&tiny.hmm(), scale)
            .occupancies(&sound, convert::Lag::Whole)
            .unwrap();
        let evaluator = Evaluator::new(&tiny.audio);
        let states: Vec<usize> = (0..tiny.phones.len() * N_EMITTING).collect();
        let log = evaluator.log_likelihoods(&states, sound.view());
        let (mut want_audio, mut want_visual) = (audio.clone() * 0.0, visual.clone() * 0.0);
        let mut total = 0.0;
        tiny.every_path(FRAMES, &mut |probability, path| {
            let heard: f64 = path
                .iter()
                .enumerate()
                .map(|(t, at)| f64::from(scale) * f64::from(log[[t, at.0]]))
                .sum();
            let weight = probability * heard.exp();
            total += weight;
            for (t, &(a, v)) in path.iter().enumerate() {
                want_audio[[t, a]] += weight as f32;
                want_visual[[t, v]] += weight as f32;
            }
        });
        assert!(total > 0.0);
        for (have, want) in [(&audio, &want_audio), (&visual, &want_visual)] {
            for (h, w) in have.iter().zip(want) {
                let w = w / total as f32;
                assert!((h - w).abs() < 1e-4, "{}: {h} against {w}", system.name);
            }
        }
    }
}

#[test]
fn probability_over_all_paths_is_one() {
    for system in hmms() {
        let mut total = 0.0;
        Tiny::new(system, 9).every_path(FRAMES, &mut |p, _| total += p);
        assert!((total - 1.0).abs() < 1e-5, "{}: {total}", system.name);
    }
}

/// ln Σ_q P(q) Π b(o) with exponents, and the occupancies γ_t(v, k), by enumeration.
fn inverted(tiny: &Tiny, sound: &Array2<f32>, mouth: &Array2<f32>, with: &EmSettings) -> (f64, Array3<f64>) {
    let (alpha, kappa) = (f64::from(with.acoustic_scale), f64::from(with.visual_exponent));
    let part = |m: &Mixtures, s: usize, k: usize, o: &Array2<f32>, t: usize| {
        normal(m, s, k, o.row(t).as_slice().unwrap())
    };
    let weight = |m: &Mixtures, s: usize, k: usize| f64::from(m.log_weight[[s, k]]).exp();
    // Emission of (a, v) at t, and the share of each visual component in it.
    let emission = |t: usize, a: usize, v: usize| -> (f64, [f64; 2]) {
        let seen = |k: usize| match tiny.system.density {
            Density::Streams => weight(&tiny.visual, v, k) * part(&tiny.visual, v, k, mouth, t),
            Density::Joint => {
                let heard = weight(&tiny.audio, a, k) * part(&tiny.audio, a, k, sound, t);
                heard.powf(alpha) * part(&tiny.visual, v, k, mouth, t).powf(kappa)
            }
        };
        let parts = [seen(0), seen(1)];
        let sum = parts[0] + parts[1];
        let share = parts.map(|p| p / sum);
        match tiny.system.density {
            Density::Joint => (sum, share),
            Density::Streams => {
                let heard: f64 = (0..2)
                    .map(|k| weight(&tiny.audio, a, k) * part(&tiny.audio, a, k, sound, t))
                    .sum();
                (heard.powf(alpha) * sum.powf(kappa), share)
            }
        }
    };
    let states = tiny.visual.mean.dim().0;
    let mut gamma = Array3::zeros((FRAMES, states, 2));
    let mut total = 0.0;
    tiny.every_path(FRAMES, &mut |probability, path| {
        let all: Vec<(f64, [f64; 2])> = path
            .iter()
            .enumerate()
            .map(|(t, &(a, v))| emission(t, a, v))
            .collect();
        let weight = probability * all.iter().map(|e| e.0).product::<f64>();
        total += weight;
        for (t, &(_, v)) in path.iter().enumerate() {
            for k in 0..2 {
                gamma[[t, v, k]] += weight * all[t].1[k];
            }
        }
    });
    (total.ln(), gamma / total)
}

#[test]
fn conversion_by_means_is_the_em_of_all_paths_and_never_less_likely() {
    for (n, system) in hmms().enumerate() {
        let tiny = Tiny::new(system, 20 + n as u64);
        let (sound, _) = observations(60 + n as u64);
        for (visual_exponent, m_step) in [(1.0, MStep::Exact), (0.3, MStep::Exact), (1.0, MStep::Printed)] {
            let with = EmSettings {
                acoustic_scale: 0.6,
                visual_exponent,
                iterations: 3,
                m_step,
            };
            let estimates = Inverter::new(tiny.hmm()).iterations(&sound, &with).unwrap();
            for pair in estimates.windows(2) {
                let (log, gamma) = inverted(&tiny, &sound, &pair[0].parameters, &with);
                let have = pair[0].log_likelihood * FRAMES as f64;
                assert!((have - log).abs() < 1e-3, "{}: {have} against {log}", system.name);
                for t in 0..FRAMES {
                    for i in 0..2 {
                        let (mut precision, mut weighted) = (0.0, 0.0);
                        for ((v, k), g) in gamma.index_axis(ndarray::Axis(0), t).indexed_iter() {
                            let again = match m_step {
                                MStep::Exact => 1.0,
                                MStep::Printed => f64::from(tiny.visual.log_weight[[v, k]]).exp(),
                            };
                            let p = g * again / f64::from(tiny.visual.variance[[v, k, i]]);
                            precision += p;
                            weighted += p * f64::from(tiny.visual.mean[[v, k, i]]);
                        }
                        let (have, want) = (f64::from(pair[1].parameters[[t, i]]), weighted / precision);
                        assert!(
                            (have - want).abs() < 1e-3,
                            "{}: {have} against {want}",
                            system.name
                        );
                    }
                }
                if m_step == MStep::Exact {
                    let (before, after) = (pair[0].log_likelihood, pair[1].log_likelihood);
                    assert!(after >= before - 1e-6, "{}: {after} after {before}", system.name);
                }
            }
        }
    }
}

/// What the mouth is on average over all paths, given the sound: each component by its weight, or by its share in the sound
/// where densities are joint.
#[test]
fn the_posterior_mean_is_the_mean_over_all_paths() {
    for (n, system) in hmms().enumerate() {
        let tiny = Tiny::new(system, 30 + n as u64);
        let (sound, unseen) = observations(70 + n as u64);
        let with = EmSettings {
            acoustic_scale: 0.6,
            visual_exponent: 0.0,
            iterations: 0,
            m_step: MStep::Exact,
        };
        // Without exponent the occupancies of states do not depend on the mouth, nor do a joint density's components.
        let (_, gamma) = inverted(&tiny, &sound, &unseen, &with);
        let (said, _) = Inverter::new(tiny.hmm())
            .posterior_mean(&sound, with.acoustic_scale, convert::Lag::Whole)
            .unwrap();
        for t in 0..FRAMES {
            for i in 0..2 {
                let mut want = 0.0;
                for ((v, k), g) in gamma.index_axis(ndarray::Axis(0), t).indexed_iter() {
                    let share = match system.density {
                        Density::Joint => *g,
                        Density::Streams => {
                            let state: f64 = gamma.slice(ndarray::s![t, v, ..]).sum();
                            state * f64::from(tiny.visual.log_weight[[v, k]]).exp()
                        }
                    };
                    want += share * f64::from(tiny.visual.mean[[v, k, i]]);
                }
                let have = f64::from(said[[t, i]]);
                assert!(
                    (have - want).abs() < 1e-3,
                    "{}: {have} against {want}",
                    system.name
                );
            }
        }
    }
}

/// With a window as long as the utterance and no exponent on the mouth, the last sweep is one EM step over all paths, from what
/// the sweeps before it and the last frame's sound have left.
#[test]
fn live_feedback_ends_in_a_step_over_all_paths() {
    for (n, system) in hmms().enumerate() {
        let tiny = Tiny::new(system, 40 + n as u64);
        let (sound, _) = observations(80 + n as u64);
        let with = EmSettings {
            acoustic_scale: 0.6,
            visual_exponent: 0.0,
            iterations: 1,
            m_step: MStep::Exact,
        };
        let inverter = Inverter::new(tiny.hmm());
        let earlier = sound.slice(ndarray::s![..FRAMES - 1, ..]).to_owned();
        let mut mouth = Array2::<f32>::zeros((FRAMES, 2));
        mouth
            .slice_mut(ndarray::s![..FRAMES - 1, ..])
            .assign(&inverter.convert_live(&earlier, &with, FRAMES).unwrap());
        // Without exponent the occupancies of states do not depend on the mouth.
        let (_, gamma) = inverted(&tiny, &sound, &mouth, &with);
        for ((v, _), g) in gamma.index_axis(ndarray::Axis(0), FRAMES - 1).indexed_iter() {
            for k in 0..tiny.visual.mean.dim().1 {
                let weight = f64::from(tiny.visual.log_weight[[v, k]]).exp();
                for i in 0..2 {
                    mouth[[FRAMES - 1, i]] += (g * weight * f64::from(tiny.visual.mean[[v, k, i]])) as f32;
                }
            }
        }
        let (_, gamma) = inverted(&tiny, &sound, &mouth, &with);
        let said = inverter.convert_live(&sound, &with, FRAMES).unwrap();
        for t in 0..FRAMES {
            for i in 0..2 {
                let (mut precision, mut weighted) = (0.0, 0.0);
                for ((v, k), g) in gamma.index_axis(ndarray::Axis(0), t).indexed_iter() {
                    let p = g / f64::from(tiny.visual.variance[[v, k, i]]);
                    precision += p;
                    weighted += p * f64::from(tiny.visual.mean[[v, k, i]]);
                }
                let (have, want) = (f64::from(said[[t, i]]), weighted / precision);
                assert!(
                    (have - want).abs() < 1e-3,
                    "{}: frame {t}: {have} against {want}",
                    system.name
                );
            }
        }
    }
}

/// Expected counts of one utterance over all paths: choices of every row, occupancy of every component, and their sums.
#[test]
fn re_estimates_are_those_of_all_paths() {
    // One phone of five states in nine frames; then what EM says it saw.
    let streams = |s: &System| s.density == Density::Streams && s.topology.visual != VisualAtom::Pair;
    for (n, system) in hmms().enumerate().filter(|(_, s)| streams(s)) {
        let tiny = Tiny::new(system, 80 + n as u64);
        let (sound, mouth) = observations(90 + n as u64);
        let said = [1usize];
        let utterance = Utterance {
            id: "u".into(),
            audio: sound.clone(),
            visual: Some(mouth.clone()),
            network: PhoneNetwork::chain(&said),
            start: vec![(1, 0); FRAMES],
        };
        let parameters = Parameters {
            topology: system.topology,
            phones: tiny.phones.clone(),
            audio: tiny.audio.clone(),
            visual: Some(tiny.visual.clone()),
            transition: tiny.transition.clone(),
        };
        let sums = em::expect(&parameters, std::slice::from_ref(&utterance)).unwrap();
        let mixture = |m: &Mixtures, s: usize, o: &Array2<f32>, t: usize| -> f64 {
            (0..2)
                .map(|k| {
                    f64::from(m.log_weight[[s, k]]).exp() * normal(m, s, k, o.row(t).as_slice().unwrap())
                })
                .sum()
        };
        let (mut total, mut counts) = (0.0, Array3::<f64>::zeros(tiny.transition.dim()));
        let mut occupancy = Array1::<f64>::zeros(tiny.phones.len() * N_EMITTING);
        let last = N_EMITTING - 1;
        let mut one = Tiny::new(system, 80 + n as u64);
        one.initial = vec![-1e9, 0.0, -1e9];
        one.every_path(FRAMES, &mut |probability, path| {
            let ends = (N_EMITTING + last, N_EMITTING * tiny.atom(1) + last);
            let inside = path
                .iter()
                .all(|&(a, v)| a / N_EMITTING == 1 && v / N_EMITTING == tiny.atom(1))
                && path.windows(2).all(|w| w[1].0 >= w[0].0 && w[1].1 >= w[0].1);
            if path[FRAMES - 1] != ends || !inside {
                return;
            }
            let seen: f64 = path
                .iter()
                .enumerate()
                .map(|(t, &(a, v))| mixture(&tiny.audio, a, &sound, t) * mixture(&tiny.visual, v, &mouth, t))
                .product();
            let weight = probability * seen;
            total += weight;
            for pair in path.windows(2) {
                let ((a, v), (a2, v2)) = (pair[0], pair[1]);
                let (phone, class) = tiny.class(&said, a % N_EMITTING, v % N_EMITTING);
                assert_eq!(phone, 1);
                counts[[1, class, (a2 - a) + 2 * (v2 - v)]] += weight;
            }
            path.iter().for_each(|&(a, _)| occupancy[a] += weight);
        });
        assert!((sums.log_likelihood - total.ln()).abs() < 1e-3, "{}", system.name);
        for (have, want) in sums.transition.iter().zip(&counts) {
            assert!(
                (have - want / total).abs() < 1e-4,
                "{}: {have} {}",
                system.name,
                want / total
            );
        }
        for (have, want) in sums
            .audio
            .occupancy
            .sum_axis(ndarray::Axis(1))
            .iter()
            .zip(&occupancy)
        {
            assert!((have - want / total).abs() < 1e-4, "{}", system.name);
        }
        // The M step makes the utterance likelier.
        let floors = Floors {
            variance: ndarray::array![0.3, 0.3],
            occupancy: 0.0,
        };
        let mut better = parameters.clone();
        em::maximise(&mut better, &sums, &floors, Some(&floors));
        let after = em::expect(&better, std::slice::from_ref(&utterance)).unwrap();
        assert!(after.log_likelihood > sums.log_likelihood, "{}", system.name);
    }
}
