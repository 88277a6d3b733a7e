//! One E step and M step in the setting in which HTK's HERest was measured: 39 numbers a frame, 5 states a phone,
//! 8 Gaussians a state, 30,000 frames, left-right utterances, one core. `cargo bench --bench em`.
//!
//! The data are drawn from the model itself, with states about as far apart as those of real speech: a frame is some
//! 20 nats likelier in its own state than in another.
use divan::counter::ItemsCount;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream_make::em::source::Utterance;
use lipstream_make::em::{self, Parameters};
use ndarray::{Array2, Array3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const DIMENSIONS: usize = 39;
const FRAMES: usize = 30_000;
const PHONES_PER_UTTERANCE: usize = 30;

fn main() {
    divan::main();
}

/// Close enough to a Gaussian: the sum of four uniform numbers, variance 1.
fn noise(rng: &mut Pcg64) -> f32 {
    (0..4).map(|_| rng.random_range(-0.5f32..0.5)).sum::<f32>() * 3f32.sqrt()
}

/// A model with `components` Gaussians a state, and utterances of it: 30,000 frames, and what the last one is longer.
fn setting(components: usize) -> (Parameters, Vec<Utterance>) {
    let mut rng = Pcg64::seed_from_u64(1);
    let phones: Vec<Phone> = Phone::all().collect();
    let states = phones.len() * N_EMITTING;
    let centre = Array2::from_shape_fn((states, DIMENSIONS), |_| 0.5 * noise(&mut rng));
    let audio = Mixtures {
        mean: Array3::from_shape_fn((states, components, DIMENSIONS), |(s, _, i)| {
            centre[[s, i]] + 0.4 * noise(&mut rng)
        }),
        variance: Array3::from_shape_fn((states, components, DIMENSIONS), |_| rng.random_range(0.3..0.7)),
        log_weight: Array2::from_elem((states, components), -(components as f32).ln()),
    };
    let mut utterances = Vec::new();
    let mut left = FRAMES;
    while left > 0 {
        let said: Vec<usize> = (0..PHONES_PER_UTTERANCE)
            .map(|_| rng.random_range(0..phones.len()))
            .collect();
        let mut path: Vec<usize> = Vec::new();
        for &phone in &said {
            for i in 0..N_EMITTING {
                path.extend(std::iter::repeat_n(
                    N_EMITTING * phone + i,
                    rng.random_range(1..4),
                ));
            }
        }
        let frames = path.len();
        let chosen: Vec<usize> = (0..frames).map(|_| rng.random_range(0..components)).collect();
        let observations = Array2::from_shape_fn((frames, DIMENSIONS), |(t, i)| {
            let place = [path[t], chosen[t], i];
            audio.mean[place] + audio.variance[place].sqrt() * noise(&mut rng)
        });
        left = left.saturating_sub(frames);
        utterances.push(Utterance {
            id: format!("u{}", utterances.len()),
            audio: observations,
            visual: None,
            network: PhoneNetwork::chain(&said),
            start: path.iter().map(|s| (s / N_EMITTING, s % N_EMITTING)).collect(),
        });
    }
    let parameters = Parameters {
        topology: Topology::PH_HMM,
        transition: em::start_transitions(Topology::PH_HMM, phones.len()),
        phones,
        audio,
        visual: None,
    };
    (parameters, utterances)
}

/// One pass over 30,000 frames on one core; divan prints items a second, and 1 µs a frame is 1 Mitem/s.
#[divan::bench(args = [1, 2, 4, 8, 16], sample_count = 10, sample_size = 1)]
fn pass(bencher: divan::Bencher, components: usize) {
    let (parameters, utterances) = setting(components);
    let frames: usize = utterances.iter().map(|u| u.audio.nrows()).sum();
    let floors = em::start(&utterances[..], Topology::PH_HMM, &parameters.phones)
        .unwrap()
        .1;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool of one thread");
    bencher
        .counter(ItemsCount::new(frames))
        .with_inputs(|| parameters.clone())
        .bench_local_values(|mut parameters| {
            pool.install(|| {
                let sums = em::expect(&parameters, &utterances[..]).unwrap();
                assert!(sums.failed.is_empty());
                em::maximise(&mut parameters, &sums, &floors, None);
                parameters
            })
        });
}
