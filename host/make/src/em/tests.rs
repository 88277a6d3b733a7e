use super::*;
use lipstream::hmm::network::PhoneNetwork;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Two phones whose sound and look differ, said in turn, with noise.
fn corpus() -> (Vec<Utterance>, Vec<Phone>) {
    let phones: Vec<Phone> = ["sil", "b", "iy"].map(|n| Phone::from_name(n).unwrap()).to_vec();
    let mut rng = Pcg64::seed_from_u64(11);
    let utterances = (0..20)
        .map(|n| {
            let said = [0, 1, 2, 1, 2, 0];
            let mut rows = Vec::new();
            for &p in &said {
                for i in 0..N_EMITTING {
                    for _ in 0..rng.random_range(1..4) {
                        rows.push((p, i));
                    }
                }
            }
            let noise = |rng: &mut Pcg64| rng.random_range(-0.5f32..0.5);
            let audio = Array2::from_shape_fn((rows.len(), 3), |(t, d)| {
                let (p, i) = rows[t];
                [p as f32 * 2.0, i as f32, (p * i) as f32][d] + noise(&mut rng)
            });
            let visual = Array2::from_shape_fn((rows.len(), 2), |(t, d)| {
                let (p, i) = rows[t];
                [p as f32, i as f32 * 0.5][d] + noise(&mut rng)
            });
            let frames = rows.len();
            let start = (0..frames)
                .map(|t| {
                    let place = t * said.len() * N_EMITTING / frames;
                    (said[place / N_EMITTING], place % N_EMITTING)
                })
                .collect();
            Utterance {
                id: format!("u{n}"),
                audio,
                visual: Some(visual),
                network: PhoneNetwork::chain(&said),
                start,
            }
        })
        .collect();
    (utterances, phones)
}

#[test]
fn likelihood_never_falls() {
    for topology in [
        Topology::PH_HMM,
        Topology::PH_FHMM,
        Topology::PH_VI_FHMM,
        Topology::PH_CHMM,
        Topology::PH_VI_CHMM,
        Topology::PH_VI_CHMM.within(3),
        Topology::PH_FHMM_PAIRS,
    ] {
        let (utterances, phones) = corpus();
        let (mut parameters, audio, visual) = start(&utterances[..], topology, &phones).unwrap();
        // With the transition prior EM climbs the posterior; without data floors the likelihood dominates.
        let mut last = f64::NEG_INFINITY;
        for round in 0..8 {
            let sums = expect(&parameters, &utterances[..]).unwrap();
            assert!(sums.failed.is_empty());
            assert!(
                sums.per_frame() >= last - 1e-3,
                "{topology:?} round {round}: {} < {last}",
                sums.per_frame()
            );
            last = sums.per_frame();
            maximise(&mut parameters, &sums, &audio, visual.as_ref());
        }
    }
}

/// By the best path alone: each frame counts once, the path grows likelier with every pass, and EM goes on from there.
#[test]
fn the_best_path_gives_a_start() {
    let (utterances, phones) = corpus();
    let (mut parameters, audio, visual) = start(&utterances[..], Topology::PH_VI_CHMM, &phones).unwrap();
    let mut last = f64::NEG_INFINITY;
    for _ in 0..4 {
        let sums = expect_by_best_path(&parameters, &utterances[..]).unwrap();
        assert!(sums.failed.is_empty());
        let frames: usize = utterances.iter().map(|u| u.audio.nrows()).sum();
        assert_eq!(sums.frames, frames);
        assert!((sums.audio.occupancy.sum() - frames as f64).abs() < 1e-6);
        let steps = (frames - utterances.len()) as f64;
        assert!((sums.transition.sum() - steps).abs() < 1e-6);
        let all = expect(&parameters, &utterances[..]).unwrap().per_frame();
        assert!(sums.per_frame() <= all + 1e-9, "one path is likelier than all");
        assert!(
            sums.per_frame() > last - 1e-3,
            "{} after {last}",
            sums.per_frame()
        );
        last = sums.per_frame();
        maximise(&mut parameters, &sums, &audio, visual.as_ref());
    }
    let path = expect(&parameters, &utterances[..]).unwrap();
    maximise(&mut parameters, &path, &audio, visual.as_ref());
    let after = expect(&parameters, &utterances[..]).unwrap();
    assert!(after.per_frame() > path.per_frame());
}

#[test]
fn shards_add_up_to_the_whole() {
    let (utterances, phones) = corpus();
    let (parameters, ..) = start(&utterances[..], Topology::PH_VI_CHMM, &phones).unwrap();
    let whole = expect(&parameters, &utterances[..]).unwrap();
    let mut parts = expect(&parameters, &utterances[..8]).unwrap();
    parts.merge(expect(&parameters, &utterances[8..]).unwrap());
    assert!((whole.log_likelihood - parts.log_likelihood).abs() < 1e-9 * whole.log_likelihood.abs());
    assert!(
        (&whole.transition - &parts.transition)
            .iter()
            .all(|d| d.abs() < 1e-9)
    );
    assert!(
        (&whole.audio.first - &parts.audio.first)
            .iter()
            .all(|d| d.abs() < 1e-7)
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let (utterances, phones) = corpus();
    let (parameters, ..) = start(&utterances[..], Topology::PH_VI_CHMM, &phones).unwrap();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| expect(&parameters, &utterances[..]).unwrap())
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.log_likelihood.to_bits(), three.log_likelihood.to_bits());
    assert_eq!(one.audio, three.audio);
}

#[test]
fn alignment_finds_the_borders() {
    let (utterances, phones) = corpus();
    let (mut parameters, audio, visual) = start(&utterances[..], Topology::PH_VI_CHMM, &phones).unwrap();
    for _ in 0..6 {
        let sums = expect(&parameters, &utterances[..]).unwrap();
        maximise(&mut parameters, &sums, &audio, visual.as_ref());
    }
    let aligner = Aligner::new(&parameters);
    for utterance in &utterances {
        let path = aligner.path(utterance).unwrap();
        assert_eq!(path.len(), utterance.audio.nrows());
        let right = path
            .iter()
            .zip(utterance.audio.outer_iter())
            .filter(|((audio, _), row)| {
                (*audio / N_EMITTING) as f32 * 2.0 - row[0] < 1.0
                    && row[0] - (*audio / N_EMITTING) as f32 * 2.0 < 1.0
            })
            .count();
        assert!(right * 10 >= path.len() * 9, "{right} of {}", path.len());
    }
}

#[test]
fn an_utterance_shorter_than_its_states_is_named() {
    let (mut utterances, phones) = corpus();
    let (parameters, ..) = start(&utterances[..], Topology::PH_VI_CHMM, &phones).unwrap();
    utterances[3].audio = utterances[3].audio.slice(ndarray::s![..7, ..]).to_owned();
    utterances[3].visual = utterances[3]
        .visual
        .as_ref()
        .map(|v| v.slice(ndarray::s![..7, ..]).to_owned());
    let sums = expect(&parameters, &utterances[..]).unwrap();
    assert_eq!(sums.failed, ["u3"]);
    assert!(sums.log_likelihood.is_finite());
}
