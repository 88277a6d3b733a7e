//! The reverse pass against finite differences, in every parameter group, on tiny models.
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::pass::{Entropy, Masks, Tape, cross_entropy};
use super::second::GatedTape;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::recurrent::chain::{Chain, ROWS, VISUAL};
use lipstream::kinds::recurrent::context::Context;
use lipstream::kinds::recurrent::gated::{Gated, GatedShape, PARTS};
use lipstream::kinds::recurrent::parameters::{Feedback, GROUPS, Gate, Group, Parameters, Shape};
use lipstream::kinds::recurrent::step::Net;
use lipstream::random::{fill_normal, normal};
use lipstream::synthetic::phones_and_arcs;

struct Problem {
    parameters: Parameters,
    chain: Chain,
    context: Array2<f32>,
    mouth: Array2<f32>,
    targets: Vec<(usize, usize)>,
    masks: Masks,
    entropy: Entropy,
}

fn problem(feedback: Feedback, maps: Gate, rates: Gate, seed: u64) -> Problem {
    let (phones, transition, bigram): (_, Array3<f32>, _) = phones_and_arcs(4, seed);
    let chain = Chain::new(&phones, &transition, &bigram);
    let shape = Shape {
        phones: 4,
        context: Context {
            taps: vec![1, 0],
            shifts: vec![2],
        },
        inputs: 5,
        memory: 6,
        outputs: 3,
        feedback,
        maps,
        rates,
    };
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut parameters = Parameters::zeros(&shape);
    for group in GROUPS {
        let deviation = match group {
            Group::Projection => 0.2,
            Group::Transition => 0.0,
            _ => 0.5,
        };
        fill_normal(parameters.of_mut(group), 0.0, deviation, &mut rng);
    }
    let logs: Vec<f32> = transition.iter().copied().collect();
    parameters.assign(
        Group::Transition,
        &Array2::from_shape_vec((4, ROWS), logs).unwrap(),
    );
    let frames = 12;
    let context = Array2::from_shape_fn((frames, shape.context.size()), |_| normal(&mut rng));
    let mouth = Array2::from_shape_fn((frames, 3), |_| normal(&mut rng));
    let targets = (0..frames)
        .map(|_| (rng.random_range(0..4 * N_EMITTING), rng.random_range(0..VISUAL)))
        .collect();
    let mask = |n: usize| {
        (0..n)
            .map(|i| if i % 4 == 3 { 0.0 } else { 1.25 })
            .collect::<Vec<f32>>()
    };
    let masks = Masks {
        output: mask(shape.memory),
        feedback: mask(shape.fed_back()),
    };
    Problem {
        parameters,
        chain,
        context,
        mouth,
        targets,
        masks,
        entropy: Entropy {
            audio: 0.3,
            visual: 0.2,
            atoms: maps == Gate::Audio,
        },
    }
}

impl Problem {
    fn tape(&self, parameters: &Parameters) -> Tape {
        let net = Net::new(parameters, &self.chain, 0.0);
        Tape::forward(&net, self.context.clone(), self.masks.clone())
    }

    fn loss(&self, parameters: &Parameters) -> f64 {
        let tape = self.tape(parameters);
        let squares = (&tape.output - &self.mouth).mapv(|e| f64::from(e).powi(2)).sum();
        squares + cross_entropy(&tape, &self.targets, self.entropy)
    }

    fn gradient(&self) -> Parameters {
        let net = Net::new(&self.parameters, &self.chain, 0.0);
        let tape = self.tape(&self.parameters);
        let mut gradient = Parameters::zeros(&self.parameters.shape);
        let g_output = (&tape.output - &self.mouth) * 2.0;
        tape.reverse(&net, &g_output, Some(&self.targets), self.entropy, &mut gradient);
        gradient
    }

    /// Slope of the loss along `direction` by central differences of two widths (Richardson).
    fn slope(&self, direction: &Parameters) -> f64 {
        let at = |step: f32| {
            let mut p = self.parameters.clone();
            p.values
                .iter_mut()
                .zip(&direction.values)
                .for_each(|(v, d)| *v += step * d);
            self.loss(&p)
        };
        let central = |h: f32| (at(h) - at(-h)) / (2.0 * f64::from(h));
        (4.0 * central(0.01) - central(0.02)) / 3.0
    }

    fn check(&self, name: &str) {
        let gradient = self.gradient();
        let mut rng = Pcg64::seed_from_u64(77);
        for group in GROUPS {
            let n = gradient.of(group).len();
            if n == 0 {
                continue;
            }
            // Along the gradient itself, where an error in its length shows, and along random directions.
            for trial in 0..4 {
                let mut direction = Parameters::zeros(&self.parameters.shape);
                if trial == 0 {
                    direction.of_mut(group).copy_from_slice(gradient.of(group));
                } else {
                    fill_normal(direction.of_mut(group), 0.0, 1.0, &mut rng);
                }
                if group == Group::Transition {
                    // Impossible choices have no logit to move.
                    let logs = self.parameters.of(group).to_vec();
                    for (d, l) in direction.of_mut(group).iter_mut().zip(logs) {
                        *d = if l < -1e8 { 0.0 } else { *d };
                    }
                }
                let length = direction.values.iter().map(|d| d * d).sum::<f32>().sqrt();
                assert!(length > 1e-4, "{name}: no gradient in {}", group.name());
                direction.values.iter_mut().for_each(|d| *d /= length);
                let expected = self.slope(&direction);
                let have: f64 = gradient
                    .values
                    .iter()
                    .zip(&direction.values)
                    .map(|(g, d)| f64::from(*g) * f64::from(*d))
                    .sum();
                let size: f64 = gradient
                    .of(group)
                    .iter()
                    .map(|g| f64::from(g * g))
                    .sum::<f64>()
                    .sqrt();
                assert!(
                    (have - expected).abs() < 2e-3 * size.max(0.1),
                    "{name}, {}, trial {trial}: {have} by the reverse pass, {expected} by differences",
                    group.name()
                );
            }
        }
    }
}

#[test]
fn every_group_has_the_right_gradient() {
    for feedback in [Feedback::None, Feedback::Output, Feedback::Memory] {
        for (maps, rates) in [
            (Gate::Both, Gate::Visual),
            (Gate::Both, Gate::Audio),
            (Gate::Audio, Gate::Audio),
            (Gate::Visual, Gate::Visual),
        ] {
            let problem = problem(feedback, maps, rates, 3);
            if feedback == Feedback::None && problem.parameters.of(Group::Visual).is_empty() {
                assert_eq!(problem.parameters.shape.fed_back(), 0);
            }
            problem.check(&format!("{feedback:?} {maps:?} {rates:?}"));
        }
    }
}

#[test]
fn occupancies_sum_to_one() {
    let problem = problem(Feedback::Output, Gate::Both, Gate::Visual, 4);
    let tape = problem.tape(&problem.parameters);
    for t in 0..tape.frames {
        assert!((tape.audio.row(t).sum() - 1.0).abs() < 1e-5);
        assert!((tape.visual.row(t).sum() - 1.0).abs() < 1e-5);
    }
}

#[test]
fn the_second_memory_has_the_right_gradient() {
    let shape = GatedShape {
        inputs: 4,
        memory: 5,
        outputs: 3,
        phones: 6,
    };
    let mut rng = Pcg64::seed_from_u64(12);
    let mut gated = Gated::zeros(shape);
    fill_normal(&mut gated.values, 0.0, 0.5, &mut rng);
    // An odd number of frames: the last step has no frame after it.
    let z = Array2::from_shape_fn((13, 4), |_| normal(&mut rng));
    let mouth = Array2::from_shape_fn((13, 3), |_| normal(&mut rng));
    let phones: Vec<usize> = (0..7).map(|_| rng.random_range(0..6)).collect();
    let keep = [1.25, 0.0, 1.25, 1.25, 1.25];
    let loss = |gated: &Gated| {
        let tape = GatedTape::forward(gated, &z, &keep);
        let squares = (&tape.output - &mouth).mapv(|e| f64::from(e).powi(2)).sum();
        let mut gradient = Gated::zeros(shape);
        let pull = (&tape.output - &mouth) * 2.0;
        let entropy = tape.reverse(gated, &pull, &phones, 0.7, &mut gradient);
        (squares + entropy, gradient)
    };
    let (_, gradient) = loss(&gated);
    for part in PARTS {
        for _ in 0..3 {
            let mut direction = Gated::zeros(shape);
            fill_normal(direction.of_mut(part), 0.0, 1.0, &mut rng);
            let at = |step: f32| {
                let mut moved = gated.clone();
                moved
                    .values
                    .iter_mut()
                    .zip(&direction.values)
                    .for_each(|(v, d)| *v += step * d);
                loss(&moved).0
            };
            let central = |h: f32| (at(h) - at(-h)) / (2.0 * f64::from(h));
            let expected = (4.0 * central(0.01) - central(0.02)) / 3.0;
            let products = gradient.values.iter().zip(&direction.values);
            let have: f64 = products.map(|(g, d)| f64::from(*g) * f64::from(*d)).sum();
            assert!(
                (have - expected).abs() < 2e-3 * expected.abs().max(1.0),
                "{part:?}: {have} by the reverse pass, {expected} by differences"
            );
        }
    }
}
