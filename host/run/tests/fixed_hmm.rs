//! The fixed-point converter against the f64 twin, on random models and the speech that they would speak.
use lipstream::export::{Export, ExportSettings, export};
use lipstream::hmm::Hmm;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::kinds::likelihood::convert::{Lag, convert, smooth};
use lipstream::kinds::likelihood::inversion::Inverter;
use lipstream::kinds::likelihood::{EmSettings, Model as FloatModel};
use lipstream::reference::hmm::{Coupled, log_emissions};
use lipstream::synthetic::{Sizes, model, speech};
use lipstream_core::kinds::Convert;
use lipstream_core::kinds::likelihood::Converter;
use lipstream_core::kinds::likelihood::density::{Scaled, log_likelihood};
use lipstream_core::kinds::likelihood::follower::Follower;
use lipstream_core::logmath::LogProb;
use lipstream_core::{Likelihood, N_OBSERVATION, N_STATIC, ParameterFrame, StreamSettings};
use ndarray::{Array2, Array3, ArrayView1};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

type Model<'a> = lipstream_core::Model<'a, Likelihood<'a>>;

const NO_BEAM: LogProb = LogProb::from_q12(1 << 26);

fn exported(model: &FloatModel) -> Export {
    export(model, &ExportSettings::of(model)).unwrap()
}

fn q8(row: ArrayView1<f32>) -> [i16; N_OBSERVATION] {
    std::array::from_fn(|d| (row[d] * 256.0) as i16)
}

/// Visual occupancies `[frames, 65]` from the fixed-point follower.
fn fixed_occupancies<'m, const T: usize, const F: usize>(
    model: &'m Model<'m>,
    beam: LogProb,
    lag: usize,
    observations: &Array2<f32>,
) -> Array2<f64> {
    let frames = observations.nrows();
    let mut follower = Box::new(Follower::<T, F>::new(
        model.own(),
        beam,
        model.own().settings().acoustic_scale,
        None,
    ));
    let mut out = Array2::zeros((frames, 65));
    let mut put = |t: usize, occupancy: [u32; 65]| {
        for (v, g) in occupancy.iter().enumerate() {
            out[[t, v]] = f64::from(*g) / 65536.0;
        }
    };
    for (n, row) in observations.rows().into_iter().enumerate() {
        follower.follow(&q8(row));
        if n >= lag {
            put(n - lag, follower.occupancies(lag));
        }
    }
    for t in frames.saturating_sub(lag)..frames {
        put(t, follower.occupancies(frames - 1 - t));
    }
    out
}

/// Largest and root-mean-square difference.
fn difference(a: &Array2<f64>, b: &Array2<f64>) -> (f64, f64) {
    let d = a - b;
    let max = d.iter().fold(0f64, |m, v| m.max(v.abs()));
    (
        max,
        (d.iter().map(|v| v * v).sum::<f64>() / d.nrows() as f64).sqrt(),
    )
}

#[test]
fn paths_of_a_tiny_model_add_up_to_the_reference() {
    let mut rng = Pcg64::seed_from_u64(1);
    let mut sizes = Sizes::small();
    sizes.phones.truncate(3);
    let float = model(&sizes, 1.0, &mut rng);
    let mut coupled = Coupled::new(&float);
    // Begin anywhere, so that five frames reach every border.
    coupled.initial.fill(1.0 / coupled.states.len() as f64);
    let observations = speech(&float, 5, 1, &mut rng);
    // A small scale keeps many paths alive.
    let emission = log_emissions(&float, observations.view()) * 0.05;
    let mut sums = Array2::<f64>::zeros((5, coupled.states.len()));
    let mut total = 0.0;
    // Depth first over every path of five joint states.
    let mut stack: Vec<(Vec<usize>, f64)> = coupled
        .initial
        .iter()
        .enumerate()
        .filter(|(_, p)| **p > 0.0)
        .map(|(s, p)| (vec![s], *p))
        .collect();
    let mut paths = 0;
    while let Some((path, p)) = stack.pop() {
        let t = path.len() - 1;
        let state = coupled.states[path[t]];
        let p = p * (emission[[t, 5 * state.phone + state.i]] - emission[[t, 0]]).exp();
        if path.len() == 5 {
            paths += 1;
            total += p;
            for (t, s) in path.iter().enumerate() {
                sums[[t, *s]] += p;
            }
            continue;
        }
        for &(to, share) in &coupled.arcs[path[t]] {
            let mut longer = path.clone();
            longer.push(to);
            stack.push((longer, p * share));
        }
    }
    assert!(paths > 10_000, "{paths}");
    let gamma = coupled.occupancies(emission.view());
    let (worst, _) = difference(&gamma, &(sums / total));
    assert!(worst < 1e-9, "{worst}");
}

#[test]
fn the_reference_conserves_probability() {
    let mut rng = Pcg64::seed_from_u64(2);
    let float = model(&Sizes::small(), 1.0, &mut rng);
    let coupled = Coupled::new(&float);
    for (state, arcs) in coupled.states.iter().zip(&coupled.arcs) {
        let sum: f64 = arcs.iter().map(|a| a.1).sum();
        assert!((sum - 1.0).abs() < 1e-5, "{state:?}: {sum}");
    }
}

#[test]
fn densities_agree_with_the_twin() {
    let mut rng = Pcg64::seed_from_u64(3);
    for densities in [1, 4] {
        let mut sizes = Sizes::small();
        sizes.densities = densities;
        let float = model(&sizes, 2.0, &mut rng);
        let bytes = exported(&float).bytes;
        let tables = Model::new_checked(&bytes).unwrap();
        let observations = speech(&float, 200, 3, &mut rng);
        let twin = log_emissions(&float, observations.view()) / std::f64::consts::LN_2;
        let (mut square, mut n, mut worst) = (0.0, 0.0, 0f64);
        for (t, row) in observations.rows().into_iter().enumerate() {
            let scaled = Scaled::new(tables.own().audio(), &q8(row));
            let best = twin.row(t).fold(f64::NEG_INFINITY, |m, v| m.max(*v));
            for state in 0..float.n_audio_states() {
                // States that matter: within 20 bits of the best.
                if twin[[t, state]] > best - 20.0 {
                    let fixed = log_likelihood(tables.own().audio(), state, &scaled, 1 << 16);
                    let error = f64::from(fixed.q12()) / 4096.0 - twin[[t, state]];
                    square += error * error;
                    n += 1.0;
                    worst = worst.max(error.abs());
                }
            }
        }
        let rms = (square / n).sqrt();
        println!("K = {densities}: log likelihood error rms {rms:.3}, max {worst:.3} bits");
        assert!(rms < 0.25 && worst < 1.5, "rms {rms}, max {worst} bits");
    }
}

/// Infinite beam, lag longer than the utterance: the offline forward-backward. The difference is quantisation.
#[test]
fn without_beam_and_lag_the_occupancies_are_the_twins() {
    let mut rng = Pcg64::seed_from_u64(4);
    for (spread, scale) in [(1.0, 1.0), (1.0, 0.1), (2.0, 0.25), (3.0, 1.0)] {
        let mut float = model(&Sizes::small(), spread, &mut rng);
        float.following.acoustic_scale = scale;
        let bytes = exported(&float).bytes;
        let tables = Model::new_checked(&bytes).unwrap();
        let observations = speech(&float, 80, 3, &mut rng);
        let twin =
            Coupled::new(&float).visual_occupancies(log_emissions(&float, observations.view()).view(), 99);
        // Every joint state of 99 frames: more than a test's stack has room for.
        let fixed = std::thread::scope(|scope| {
            std::thread::Builder::new()
                .stack_size(64 << 20)
                .spawn_scoped(scope, || {
                    fixed_occupancies::<1872, 100>(&tables, NO_BEAM, 99, &observations)
                })
                .unwrap()
                .join()
                .unwrap()
        });
        let (max, rms) = difference(&fixed, &twin);
        println!("spread {spread}, scale {scale}: occupancy error max {max:.4}, rms a frame {rms:.4}");
        assert!(
            max < 0.05 && rms < 0.01,
            "spread {spread}, scale {scale}: max {max}, rms {rms}"
        );
    }
}

#[test]
fn with_a_lag_the_occupancies_are_the_twins() {
    let mut rng = Pcg64::seed_from_u64(5);
    let mut float = model(&Sizes::small(), 2.0, &mut rng);
    float.following.acoustic_scale = 0.3;
    let bytes = exported(&float).bytes;
    let tables = Model::new_checked(&bytes).unwrap();
    let observations = speech(&float, 60, 3, &mut rng);
    let coupled = Coupled::new(&float);
    let emissions = log_emissions(&float, observations.view());
    for lag in [0, 1, 4, 8] {
        let twin = coupled.visual_occupancies(emissions.view(), lag);
        let exact = fixed_occupancies::<1872, 9>(&tables, NO_BEAM, lag, &observations);
        let (max, rms) = difference(&exact, &twin);
        println!("lag {lag}: occupancy error max {max:.4}, rms a frame {rms:.4}");
        assert!(max < 0.05 && rms < 0.01, "lag {lag}: max {max}, rms {rms}");
        let beamed = fixed_occupancies::<384, 9>(&tables, LogProb::from_q12(20 << 12), lag, &observations);
        let (max, rms) = difference(&beamed, &exact);
        println!("lag {lag}: a beam of 20 bits and 384 tokens change it by max {max:.4}, rms {rms:.4}");
        assert!(max < 0.02 && rms < 0.005, "lag {lag}: max {max}, rms {rms}");
    }
}

fn converted<'m, const T: usize, const F: usize>(
    model: &'m Model<'m>,
    settings: StreamSettings,
    observations: &Array2<f32>,
) -> (Vec<ParameterFrame>, usize) {
    let mut converter = Box::new(Converter::<T, F>::new(model, settings));
    let frames = run(&mut converter, observations);
    (frames, converter.delay_hops())
}

/// Drives a converter as the front end would: observation n − 4 with statics n, then the four held back.
fn run<const T: usize, const F: usize>(
    converter: &mut Converter<T, F>,
    observations: &Array2<f32>,
) -> Vec<ParameterFrame> {
    let n = observations.nrows();
    let mut out = Vec::new();
    for hop in 0..n + 4 {
        let statics: Option<[i16; N_STATIC]> = (hop < n).then(|| {
            let all = q8(observations.row(hop));
            std::array::from_fn(|i| all[i])
        });
        let observation = (4..n + 4).contains(&hop).then(|| q8(observations.row(hop - 4)));
        let frame = converter.push(statics.as_ref(), observation.as_ref());
        if let Some(frame) = &frame {
            let late = hop - frame.frame as usize;
            assert!(hop >= n || late == converter.delay_hops(), "{late} hops late");
        }
        out.extend(frame);
    }
    while !converter.is_done() {
        out.extend(converter.push(None, None));
    }
    assert_eq!(out.len(), n);
    for (t, frame) in out.iter().enumerate() {
        assert_eq!((frame.frame as usize, frame.sample as usize), (t, 160 * t + 200));
    }
    out
}

fn real(model: &Model, frames: &[ParameterFrame]) -> Array2<f64> {
    let scales: Vec<f32> = model.head().parameter_scales().collect();
    Array2::from_shape_fn((frames.len(), scales.len()), |(t, d)| {
        f64::from(frames[t].values[d]) * f64::from(scales[d])
    })
}

/// The parameters against the float conversion, in units of their standard deviation over the clip.
#[test]
fn parameters_are_those_of_the_float_conversion() {
    let mut rng = Pcg64::seed_from_u64(6);
    for (scale, lag) in [(0.3f32, 4usize), (1.0, 2), (0.3, 0)] {
        let mut float = model(&Sizes::small(), 2.0, &mut rng);
        float.following.acoustic_scale = scale;
        float.following.lag = lag;
        let bytes = exported(&float).bytes;
        let tables = Model::new_checked(&bytes).unwrap();
        let observations = speech(&float, 120, 3, &mut rng);
        let (twin, visemes) = convert(&float, &observations, Lag::Frames(lag)).unwrap();
        let settings = StreamSettings {
            beam: Some(NO_BEAM),
            ..StreamSettings::default()
        };
        let (frames, delay) = converted::<1872, 9>(&tables, settings, &observations);
        assert_eq!(delay, (lag + 4).max(4) + 1);
        let fixed = real(&tables, &frames);
        for d in 0..5 {
            let want = twin.column(d).mapv(f64::from);
            let deviation = want.std(0.0);
            let error = &fixed.column(d) - &want;
            let rms = (error.mapv(|e| e * e).mean().unwrap()).sqrt() / deviation;
            println!("scale {scale} lag {lag} parameter {d}: rms error {rms:.4} deviations");
            assert!(rms < 0.03, "parameter {d}: rms error {rms} deviations");
        }
        for (t, frame) in frames.iter().enumerate() {
            for (v, weight) in frame.viseme_weights.iter().enumerate() {
                let error = f64::from(*weight) / 255.0 - f64::from(visemes[[t, v]]);
                assert!(error.abs() < 0.1, "frame {t} viseme {v}: {error}");
            }
        }
    }
}

/// The mouth by EM inside the lag window, in units of its standard deviation over the clip.
#[test]
fn live_feedback_is_the_twins() {
    let mut rng = Pcg64::seed_from_u64(11);
    for (exponent, lag) in [(0.0f32, 4u16), (0.05, 4), (0.5, 2), (1.0, 4), (1.0, 0)] {
        let mut float = model(&Sizes::small(), 2.0, &mut rng);
        float.following.acoustic_scale = 0.3;
        float.visual = two_densities(&float.visual);
        let bytes = with_visual_densities(&float);
        let tables = Model::new_checked(&bytes).unwrap();
        let observations = speech(&float, 120, 3, &mut rng);
        let em = EmSettings {
            acoustic_scale: 0.3,
            visual_exponent: exponent,
            ..EmSettings::default()
        };
        let inverter = Inverter::new(Hmm::of_model(&float));
        let twin = smooth(
            &inverter
                .convert_live(&observations, &em, usize::from(lag))
                .unwrap(),
        );
        let settings = StreamSettings {
            lag: Some(lag),
            beam: Some(NO_BEAM),
            feedback: Some((exponent * 65536.0) as u32),
            ..StreamSettings::default()
        };
        let (frames, delay) = converted::<1872, 9>(&tables, settings, &observations);
        assert_eq!(delay, usize::from(lag) + 5);
        let fixed = real(&tables, &frames);
        for d in 0..5 {
            let want = twin.column(d).mapv(f64::from);
            let deviation = want.std(0.0);
            let error = &fixed.column(d) - &want;
            let mut off: Vec<f64> = error.iter().map(|e| e.abs() / deviation).collect();
            off.sort_by(f64::total_cmp);
            let (most, worst) = (off[off.len() * 9 / 10], off[off.len() - 1]);
            println!(
                "exponent {exponent} lag {lag} parameter {d}: 90 % within {most:.4}, worst {worst:.4} deviations"
            );
            // At full weight the mouth holds on to what it has begun with: in floats too a change of the means by one
            // hundredth of their spread moves some frames by a third of a deviation.
            let bound = if exponent < 1.0 { 0.7 } else { 3.0 };
            assert!(most < 0.1, "parameter {d}: {most} deviations off");
            assert!(worst < bound, "parameter {d}: {worst} deviations off");
        }
        // Without visual densities in the tables the maps speak.
        let plain = exported(&float).bytes;
        let plain = Model::new_checked(&plain).unwrap();
        let deaf = StreamSettings {
            feedback: None,
            ..settings
        };
        assert_eq!(
            converted::<384, 9>(&plain, settings, &observations).0,
            converted::<384, 9>(&tables, deaf, &observations).0
        );
    }
}

/// Every density as two of unequal weight, a deviation apart.
fn two_densities(single: &Mixtures) -> Mixtures {
    let (states, _, size) = single.mean.dim();
    let (weights, shifts) = ([0.3f32, 0.7], [-0.7f32, 0.3]);
    Mixtures {
        mean: Array3::from_shape_fn((states, 2, size), |(s, k, d)| {
            single.mean[[s, 0, d]] + shifts[(k + d) % 2] * single.variance[[s, 0, d]].sqrt()
        }),
        variance: Array3::from_shape_fn((states, 2, size), |(s, k, d)| {
            single.variance[[s, 0, d]] * (0.6 + 0.4 * k as f32)
        }),
        log_weight: Array2::from_shape_fn((states, 2), |(_, k)| weights[k].ln()),
    }
}

fn with_visual_densities(model: &FloatModel) -> Vec<u8> {
    let with = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(model)
    };
    export(model, &with).unwrap().bytes
}

#[test]
fn a_reset_converter_is_a_new_one() {
    let mut rng = Pcg64::seed_from_u64(7);
    let float = model(&Sizes::small(), 2.0, &mut rng);
    let bytes = with_visual_densities(&float);
    let tables = Model::new_checked(&bytes).unwrap();
    let (first, second) = (speech(&float, 70, 3, &mut rng), speech(&float, 50, 2, &mut rng));
    for feedback in [None, Some(1 << 14)] {
        let settings = StreamSettings {
            feedback,
            ..StreamSettings::default()
        };
        let mut converter = Box::new(Converter::<384, 9>::new(&tables, settings));
        run(&mut converter, &first);
        converter.reset();
        let again = run(&mut converter, &second);
        assert_eq!(again, converted::<384, 9>(&tables, settings, &second).0);
        // Cut off in the middle.
        converter.reset();
        let row = q8(first.row(0));
        let statics: [i16; N_STATIC] = std::array::from_fn(|i| row[i]);
        for _ in 0..20 {
            converter.push(Some(&statics), Some(&row));
        }
        converter.reset();
        assert_eq!(run(&mut converter, &second), again);
    }
}

#[test]
fn utterances_of_every_short_length_give_every_frame() {
    let mut rng = Pcg64::seed_from_u64(8);
    let float = model(&Sizes::small(), 2.0, &mut rng);
    let bytes = with_visual_densities(&float);
    let tables = Model::new_checked(&bytes).unwrap();
    for n in 0..24 {
        let observations = speech(&float, n, 3, &mut rng);
        for lag in [0, 3, 8] {
            for (average, feedback) in [(false, None), (true, None), (true, Some(1 << 12))] {
                let settings = StreamSettings {
                    lag: Some(lag),
                    average: Some(average),
                    feedback,
                    ..StreamSettings::default()
                };
                assert_eq!(converted::<384, 9>(&tables, settings, &observations).0.len(), n);
            }
        }
    }
}

/// A beam so narrow that no arc passes it, and a buffer of one token: the best token is kept and life goes on.
#[test]
fn an_emptied_beam_keeps_the_best_token() {
    let mut rng = Pcg64::seed_from_u64(9);
    let float = model(&Sizes::small(), 2.0, &mut rng);
    let bytes = exported(&float).bytes;
    let tables = Model::new_checked(&bytes).unwrap();
    let observations = speech(&float, 60, 3, &mut rng);
    let mut follower = Box::new(Follower::<384, 9>::new(
        tables.own(),
        LogProb::from_q12(1),
        tables.own().settings().acoustic_scale,
        None,
    ));
    for row in observations.rows() {
        follower.follow(&q8(row));
        assert_eq!(follower.active().len(), 1);
        let sum: u32 = follower.occupancies(5).iter().sum();
        assert!(sum.abs_diff(65536) <= 65, "{sum}");
    }
    let (frames, _) = converted::<1, 9>(&tables, StreamSettings::default(), &observations);
    assert_eq!(frames.len(), 60);
    for frame in frames {
        let sum: u32 = frame.viseme_weights.iter().map(|w| u32::from(*w)).sum();
        assert_eq!(sum, 255, "one token, one viseme");
    }
}

#[test]
fn extreme_observations_leave_a_distribution() {
    let mut rng = Pcg64::seed_from_u64(10);
    let mut float = model(&Sizes::small(), 2.0, &mut rng);
    for scale in [0.01, 1.0] {
        float.following.acoustic_scale = scale;
        let bytes = exported(&float).bytes;
        let tables = Model::new_checked(&bytes).unwrap();
        let mut follower = Box::new(Follower::<384, 9>::new(
            tables.own(),
            LogProb::from_q12(16 << 12),
            tables.own().settings().acoustic_scale,
            None,
        ));
        for n in 0..300u32 {
            let observation = std::array::from_fn(|d| match (n / 50) % 6 {
                0 => 0,
                1 => i16::MAX,
                2 => i16::MIN,
                3 => rng.random(),
                4 if (d + n as usize).is_multiple_of(2) => i16::MAX,
                4 => i16::MIN,
                _ => rng.random_range(-100..100),
            });
            follower.follow(&observation);
            assert!(!follower.active().is_empty());
            let sum: u32 = follower.occupancies(8).iter().sum();
            assert!(sum.abs_diff(65536) <= 65, "frame {n}: {sum}");
        }
    }
}
