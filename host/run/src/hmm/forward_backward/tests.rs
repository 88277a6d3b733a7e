use super::*;
use crate::hmm::network::PhoneNetwork;
use crate::hmm::topology::Topology;
use crate::phones::Phone;
use ndarray::Array3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

struct Tiny {
    graph: Graph,
    probability: Vec<f64>,
    log: Array2<f64>,
}

fn tiny(topology: Topology, frames: usize, whole: bool, seed: u64) -> Tiny {
    let mut rng = Pcg64::seed_from_u64(seed);
    let phones: Vec<Phone> = ["b", "iy", "p"].map(|n| Phone::from_name(n).unwrap()).to_vec();
    let network = if whole {
        let bigram = ndarray::Array2::from_shape_fn((3, 3), |_| (1.0f32 / 3.0).ln());
        PhoneNetwork::phone_loop(&[(1.0f32 / 3.0).ln(); 3], &bigram)
    } else {
        PhoneNetwork::chain(&[0, 1])
    };
    let graph = Graph::build(&network, topology, &phones);
    let table = Array3::from_shape_fn((3, topology.classes_per_phone(), 4), |(_, class, choice)| {
        if topology.allowed(class)[choice] {
            rng.random_range(0.1f32..1.0).ln()
        } else {
            -1e9
        }
    });
    let probability = graph.probabilities(&table);
    let log = Array2::from_shape_fn((frames, graph.states.len()), |_| rng.random_range(-3.0..0.0));
    Tiny {
        graph,
        probability,
        log,
    }
}

/// Likelihood, occupancies and arc occupancies by walking every path.
fn enumerate(tiny: &Tiny) -> (f64, Array2<f64>, Vec<f64>) {
    let (frames, n) = tiny.log.dim();
    let mut total = 0.0;
    let mut gamma = Array2::zeros((frames, n));
    let mut xi = vec![0.0; tiny.graph.arcs.len()];
    let mut stack: Vec<(Vec<usize>, Vec<usize>, f64)> = tiny
        .graph
        .entries
        .iter()
        .map(|&(s, w)| (vec![s], Vec::new(), f64::from(w).exp() * tiny.log[[0, s]].exp()))
        .collect();
    while let Some((path, arcs, p)) = stack.pop() {
        let last = path[path.len() - 1];
        if path.len() == frames {
            if tiny.graph.exits.as_ref().is_none_or(|e| e.contains(&last)) {
                total += p;
                path.iter().enumerate().for_each(|(t, &s)| gamma[[t, s]] += p);
                arcs.iter().for_each(|&a| xi[a] += p);
            }
            continue;
        }
        for arc in tiny.graph.first[last]..tiny.graph.first[last + 1] {
            let to = tiny.graph.arcs[arc].to as usize;
            let q = p * tiny.probability[arc] * tiny.log[[path.len(), to]].exp();
            let (mut path, mut arcs) = (path.clone(), arcs.clone());
            path.push(to);
            arcs.push(arc);
            stack.push((path, arcs, q));
        }
    }
    (total, gamma / total, xi.into_iter().map(|x| x / total).collect())
}

#[test]
fn brute_force_agrees() {
    for (topology, frames, whole) in [
        (Topology::PH_VI_CHMM, 11, false),
        (Topology::PH_VI_CHMM, 5, true),
        (Topology::PH_HMM, 12, false),
        (Topology::PH_HMM, 7, true),
    ] {
        let tiny = tiny(topology, frames, whole, 7);
        let (total, gamma, xi) = enumerate(&tiny);
        let emission = |t: usize, s: usize| tiny.log[[t, s]];
        let f = forward(&tiny.graph, &tiny.probability, frames, &emission).unwrap();
        assert!((f.log_likelihood - total.ln()).abs() < 1e-9);
        let mut arcs = vec![0.0; xi.len()];
        let g = f.backward(&tiny.graph, &tiny.probability, |_, a, x| arcs[a] += x);
        assert!((&g - &gamma).iter().all(|d| d.abs() < 1e-9));
        assert!(arcs.iter().zip(&xi).all(|(a, b)| (a - b).abs() < 1e-9));
        let long = f.fixed_lag(&tiny.graph, &tiny.probability, frames);
        assert!((&long - &gamma).iter().all(|d| d.abs() < 1e-9));
    }
}

/// ln Σ exp of two.
fn log_add(a: f64, b: f64) -> f64 {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    if low == f64::NEG_INFINITY {
        return high;
    }
    high + (low - high).exp().ln_1p()
}

#[test]
fn what_no_number_can_carry_does_not_count() {
    // Emissions as far apart as those of speech (the right state some 25 nats above the others, sometimes below):
    // here most states die in every frame. The reference keeps every state of every frame, in logarithms.
    let mut rng = Pcg64::seed_from_u64(8);
    let phones: Vec<Phone> = Phone::all().take(9).collect();
    let said: Vec<usize> = (0..20).map(|_| rng.random_range(0..9)).collect();
    let graph = Graph::build(&PhoneNetwork::chain(&said), Topology::PH_HMM, &phones);
    let n = graph.states.len();
    let table = crate::hmm::topology::start_transitions(Topology::PH_HMM, 9);
    let probability = graph.probabilities(&table);
    let path: Vec<usize> = (0..n)
        .flat_map(|s| std::iter::repeat_n(s, rng.random_range(1..5)))
        .collect();
    let frames = path.len();
    let log = Array2::from_shape_fn((frames, n), |(t, s)| {
        rng.random_range(-50.0..-20.0) + if s == path[t] { 20.0 } else { 0.0 }
    });
    let f = forward(&graph, &probability, frames, &|t: usize, s: usize| log[[t, s]]).unwrap();
    let mut sums = vec![0.0; graph.arcs.len()];
    let gamma = f.backward(&graph, &probability, |_, a, xi| sums[a] += xi);
    let alive = f.alpha.iter().filter(|a| **a > 0.0).count();
    assert!(alive * 3 < frames * n, "{alive} of {}", frames * n);

    let mut ahead = Array2::from_elem((frames, n), f64::NEG_INFINITY);
    let mut after = ahead.clone();
    ahead[[0, 0]] = log[[0, 0]];
    after[[frames - 1, n - 1]] = 0.0;
    for t in 1..frames {
        for (arc, p) in graph.arcs.iter().zip(&probability) {
            let (from, to) = (arc.from as usize, arc.to as usize);
            ahead[[t, to]] = log_add(ahead[[t, to]], ahead[[t - 1, from]] + p.ln() + log[[t, to]]);
        }
        let u = frames - 1 - t;
        for (arc, p) in graph.arcs.iter().zip(&probability) {
            let (from, to) = (arc.from as usize, arc.to as usize);
            after[[u, from]] = log_add(after[[u, from]], p.ln() + log[[u + 1, to]] + after[[u + 1, to]]);
        }
    }
    let total = ahead[[frames - 1, n - 1]];
    assert!((total - f.log_likelihood).abs() < 1e-9 * total.abs());
    for t in 0..frames {
        for s in 0..n {
            let want = (ahead[[t, s]] + after[[t, s]] - total).exp();
            assert!((gamma[[t, s]] - want).abs() < 1e-9, "{t} {s}");
        }
    }
}

#[test]
fn no_lag_is_the_forward_variable() {
    let tiny = tiny(Topology::PH_VI_CHMM, 6, true, 3);
    let emission = |t: usize, s: usize| tiny.log[[t, s]];
    let f = forward(&tiny.graph, &tiny.probability, 6, &emission).unwrap();
    let g = f.fixed_lag(&tiny.graph, &tiny.probability, 0);
    assert!((&g - &f.alpha).iter().all(|d| d.abs() < 1e-12));
}

#[test]
fn the_best_path_is_the_best_of_all() {
    let tiny = tiny(Topology::PH_VI_CHMM, 10, false, 5);
    let emission = |t: usize, s: usize| tiny.log[[t, s]];
    let (path, log) = viterbi(&tiny.graph, &tiny.probability, 10, &emission).unwrap();
    // By hand: the path's own probability, and no neighbour at a single frame is better.
    let score = |path: &[usize]| -> f64 {
        let mut p = f64::from(
            tiny.graph
                .entries
                .iter()
                .find(|e| e.0 == path[0])
                .map_or(f32::NEG_INFINITY, |e| e.1),
        );
        for t in 0..path.len() {
            p += tiny.log[[t, path[t]]];
            if t > 0 {
                let arc = (tiny.graph.first[path[t - 1]]..tiny.graph.first[path[t - 1] + 1])
                    .find(|&a| tiny.graph.arcs[a].to as usize == path[t]);
                p += arc.map_or(f64::NEG_INFINITY, |a| tiny.probability[a].ln());
            }
        }
        p
    };
    assert!((score(&path) - log).abs() < 1e-9);
    for t in 0..10 {
        for s in 0..tiny.graph.states.len() {
            let mut other = path.clone();
            other[t] = s;
            if tiny.graph.exits.as_ref().unwrap().contains(&other[9]) {
                assert!(score(&other) <= log + 1e-9);
            }
        }
    }
}

#[test]
fn just_long_enough_is_long_enough() {
    // Ten frames for ten states: one diagonal path and its neighbours, however unlikely each step is.
    let mut tiny = tiny(Topology::PH_HMM, 10, false, 2);
    tiny.log
        .indexed_iter_mut()
        .for_each(|((t, s), l)| *l = if s == t { -400.0 } else { 0.0 });
    let emission = |t: usize, s: usize| tiny.log[[t, s]];
    let f = forward(&tiny.graph, &tiny.probability, 10, &emission).unwrap();
    let g = f.backward(&tiny.graph, &tiny.probability, |_, _, _| ());
    (0..10).for_each(|t| assert!((g[[t, t]] - 1.0).abs() < 1e-9));
}

#[test]
fn too_short_an_utterance_has_no_path() {
    let tiny = tiny(Topology::PH_VI_CHMM, 9, false, 1);
    let emission = |t: usize, s: usize| tiny.log[[t, s]];
    assert!(forward(&tiny.graph, &tiny.probability, 9, &emission).is_none());
    assert!(viterbi(&tiny.graph, &tiny.probability, 9, &emission).is_none());
}

#[test]
fn a_path_read_off_late_enough_is_the_best_path() {
    let topology = Topology::PH_VI_CHMM;
    let tiny = tiny(topology, 12, true, 17);
    let emission = |t: usize, s: usize| tiny.log[[t, s]];
    let (best, _) = viterbi(&tiny.graph, &tiny.probability, 12, &emission).unwrap();
    let within = |lag| viterbi_within(&tiny.graph, &tiny.probability, 12, &emission, lag).unwrap();
    assert_eq!(within(11), best);
    assert_eq!(within(500), best);
    // Without a lag: the best state so far, whatever comes later.
    for t in 0..12 {
        let (so_far, _) = viterbi(&tiny.graph, &tiny.probability, t + 1, &emission).unwrap();
        assert_eq!(within(0)[t], so_far[t], "frame {t}");
    }
}
