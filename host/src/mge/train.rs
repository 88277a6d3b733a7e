//! The training loop: batches of clips, gradients through the recursion, validation after every pass.
//!
//! With e = ŷ − y (standardised), weights w_d = σ_d^ρ / Σσ^ρ, and (a_t, v_t) the forced alignment, a batch's loss is
//! ```text
//! E = 1/T Σ_t Σ_d w_d e²_td − κ_a/T Σ ln γᵃ_t(a_t) − κ_v/T Σ ln γᵛ_t(v_t) − κ_h/T_h Σ_heard ln γᵃ_t(a_t)   (M10)
//! ```
//! over the T frames of its clips with video and the T_h frames of those without. Random numbers depend on the seed, the
//! step and the clip's place only, and sums are taken in the order of the clips: neither threads nor interruptions
//! change the result.
use std::path::Path;
use std::time::Instant;

use anyhow::{Result, bail};
use lipstream_core::N_STATIC;
use ndarray::Array2;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::chain::{Chain, ROWS};
use super::checkpoint::{self, Best};
use super::context::Context;
use super::data::{self, Clip, Data};
use super::judge::{centred, judge};
use super::model::{LEAST, MgeModel};
use super::optimise::{Optimiser, Rule};
use super::parameters::{Feedback, Gate, Parameters, Shape, normal};
use super::pass::{Entropy, Masks, Tape, cross_entropy};
use super::start::{Seen, StartSettings, start};
use super::step::Net;
use crate::features::FeatureFolder;
use crate::model::Model;
use crate::train::Say;

/// Choices of a training run.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    pub context: Context,
    pub inputs: usize,
    pub memory: usize,
    pub feedback: Feedback,
    pub maps: Gate,
    pub rates: Gate,
    /// Passes over the clips with video.
    pub passes: usize,
    /// Clips with video in a batch.
    pub batch: usize,
    /// Frames of a crop, and the share of batches that are crops.
    pub crop: usize,
    pub crops: f32,
    /// κ_a, κ_v, κ_h.
    pub audio_entropy: f32,
    pub visual_entropy: f32,
    pub heard_entropy: f32,
    /// Cross-entropy of phones and visemes instead of their states.
    pub atoms: bool,
    /// Greatest change of speed: a clip is played 1 − warp to 1 + warp times as fast.
    pub warp: f32,
    /// Deviation of the noise on the statics, per frame and per clip.
    pub frame_noise: f32,
    pub clip_noise: f32,
    /// Share of memory numbers that a clip's mouth, or its visual emissions, do without.
    pub output_dropout: f32,
    pub feedback_dropout: f32,
    /// ρ: 0 weighs standardised parameters alike, 2 is the plain squared error.
    pub error_power: f32,
    pub rule: Rule,
    pub start: StartSettings,
    pub seed: u64,
    /// At most so many training clips with video.
    pub clips: Option<usize>,
    /// Training clips that join the validation clips.
    pub hold_out: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            context: Context::default(),
            inputs: 80,
            memory: 160,
            feedback: Feedback::Output,
            maps: Gate::Both,
            rates: Gate::Visual,
            passes: 25,
            batch: 20,
            crop: 160,
            crops: 0.5,
            audio_entropy: 0.05,
            visual_entropy: 0.05,
            heard_entropy: 0.05,
            atoms: false,
            warp: 0.0,
            frame_noise: 0.15,
            clip_noise: 0.15,
            output_dropout: 0.2,
            feedback_dropout: 0.1,
            error_power: 1.0,
            rule: Rule::default(),
            start: StartSettings::default(),
            seed: 1,
            clips: None,
            hold_out: 0,
        }
    }
}

/// One clip's part of a batch.
struct Share {
    gradient: Parameters,
    error: f64,
    entropy: f64,
}

struct Trainer<'a> {
    settings: &'a Settings,
    data: &'a Data,
    chain: Chain,
    context_mean: Vec<f32>,
    /// w_d.
    weights: Vec<f32>,
}

/// Which piece of which clip.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// Index into the clips with video, or into those without.
    clip: usize,
    heard: bool,
    /// First frame, frames of the clip per frame of the piece, and frames of the piece.
    from: f32,
    speed: f32,
    frames: usize,
}

impl Piece {
    /// Frame of the clip under frame t of the piece, the next one, and how far it is towards that.
    fn place(&self, t: usize, all: usize) -> (usize, usize, f32) {
        let place = (self.from + t as f32 * self.speed).clamp(0.0, (all - 1) as f32);
        let before = place as usize;
        (before, (before + 1).min(all - 1), place - before as f32)
    }

    /// Rows of `of` at the piece's speed, `frames` of them, linear between the clip's.
    fn cut(&self, of: &Array2<f32>, frames: usize) -> Array2<f32> {
        Array2::from_shape_fn((frames, of.ncols()), |(t, d)| {
            let (before, after, share) = self.place(t, of.nrows());
            of[[before, d]] + share * (of[[after, d]] - of[[before, d]])
        })
    }
}

impl Trainer<'_> {
    fn steps_per_pass(&self) -> usize {
        self.data.train.len().div_ceil(self.settings.batch)
    }

    fn clip(&self, piece: &Piece) -> &Clip {
        if piece.heard {
            &self.data.heard[piece.clip]
        } else {
            &self.data.train[piece.clip]
        }
    }

    /// The pieces of a step: its share of this pass's shuffled clips, whole or cropped.
    fn pieces(&self, step: usize) -> Vec<Piece> {
        let (pass, index) = (step / self.steps_per_pass(), step % self.steps_per_pass());
        let shuffled = |n: usize, stream: u64| -> Vec<usize> {
            let mut order: Vec<usize> = (0..n).collect();
            order.shuffle(&mut self.random(stream, pass as u64));
            order
        };
        let with_video = shuffled(self.data.train.len(), 1);
        let heard = shuffled(self.data.heard.len(), 2);
        let mut rng = self.random(3, step as u64);
        let crop = rng.random::<f32>() < self.settings.crops;
        let share = |order: &[usize]| -> Vec<usize> {
            let n = self.steps_per_pass();
            order[order.len() * index / n..order.len() * (index + 1) / n].to_vec()
        };
        let mut pieces = Vec::new();
        for (order, heard) in [(share(&with_video), false), (share(&heard), true)] {
            for clip in order {
                let clips = if heard { &self.data.heard } else { &self.data.train };
                let all = clips[clip].x.nrows();
                let warp = self.settings.warp;
                let speed = 1.0 + warp * rng.random_range(-1.0f32..=1.0);
                let whole = ((all - 1) as f32 / speed) as usize + 1;
                let frames = if crop {
                    self.settings.crop.min(whole)
                } else {
                    whole
                };
                let room = (whole - frames) as f32 * speed;
                let from = (room * rng.random::<f32>()).round();
                pieces.push(Piece {
                    clip,
                    heard,
                    from,
                    speed,
                    frames,
                });
            }
        }
        pieces
    }

    fn random(&self, stream: u64, at: u64) -> Pcg64 {
        Pcg64::seed_from_u64(self.settings.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (stream << 56) ^ at)
    }

    /// Loss and gradient of one piece, already divided by the batch's frames (`video`, `heard`).
    fn learn(&self, net: &Net, piece: &Piece, frames: (usize, usize), rng: &mut Pcg64) -> Share {
        let settings = self.settings;
        let clip = self.clip(piece);
        let all = clip.x.nrows();
        let mut x = piece.cut(&clip.x, piece.frames + settings.context.look_ahead());
        let shift: [f32; N_STATIC] = std::array::from_fn(|_| settings.clip_noise * normal(rng));
        for mut row in x.outer_iter_mut() {
            for (x, s) in row.iter_mut().zip(shift) {
                *x += s + settings.frame_noise * normal(rng);
            }
        }
        let mut mask = |n: usize, share: f32| -> Vec<f32> {
            let keep = 1.0 / (1.0 - share);
            (0..n)
                .map(|_| if rng.random::<f32>() < share { 0.0 } else { keep })
                .collect()
        };
        let shape = &net.p.shape;
        let masks = Masks {
            output: mask(shape.memory, settings.output_dropout),
            feedback: mask(shape.fed_back(), settings.feedback_dropout),
        };
        let context = centred(&settings.context.stack(&x, piece.frames), &self.context_mean);
        let tape = Tape::forward(net, context, masks);
        let targets: Vec<(usize, usize)> = (0..piece.frames)
            .map(|t| {
                let (before, after, share) = piece.place(t, all);
                clip.states[if share < 0.5 { before } else { after }]
            })
            .collect();
        let mut g_output = Array2::zeros((piece.frames, shape.outputs));
        let mut error = 0.0;
        let n = if piece.heard { frames.1 } else { frames.0 } as f32;
        let entropy = Entropy {
            audio: if piece.heard {
                settings.heard_entropy
            } else {
                settings.audio_entropy
            } / n,
            visual: if piece.heard { 0.0 } else { settings.visual_entropy } / n,
            atoms: settings.atoms,
        };
        if let (Some(mouth), false) = (&clip.mouth, piece.heard) {
            let mouth = piece.cut(mouth, piece.frames);
            for t in 0..piece.frames {
                for (d, w) in self.weights.iter().enumerate() {
                    let e = tape.output[[t, d]] - mouth[[t, d]];
                    error += f64::from(w * e * e);
                    g_output[[t, d]] = 2.0 * w * e / n;
                }
            }
        }
        let mut gradient = Parameters::zeros(shape);
        tape.reverse(net, &g_output, Some(&targets), entropy, &mut gradient);
        // One clip in which a state hangs by a thread must not steer the whole batch.
        gradient.cut(settings.rule.clip);
        Share {
            gradient,
            error: error / f64::from(n),
            entropy: cross_entropy(&tape, &targets, entropy),
        }
    }

    /// Gradient and losses of a step.
    fn batch(&self, parameters: &Parameters, step: usize) -> Share {
        let pieces = self.pieces(step);
        let count = |heard: bool| pieces.iter().filter(|p| p.heard == heard).map(|p| p.frames).sum();
        let frames: (usize, usize) = (count(false), count(true));
        let net = Net::new(parameters, &self.chain, LEAST);
        let mut total = Share {
            gradient: Parameters::zeros(&parameters.shape),
            error: 0.0,
            entropy: 0.0,
        };
        // In groups, so that not every gradient of the batch lies in memory at once.
        for (group, pieces) in pieces.chunks(GROUP).enumerate() {
            let shares: Vec<Share> = pieces
                .par_iter()
                .enumerate()
                .map(|(i, piece)| {
                    let place = (step as u64) << 16 | (group * GROUP + i) as u64;
                    self.learn(&net, piece, frames, &mut self.random(4, place))
                })
                .collect();
            for share in shares {
                let sum = &mut total.gradient.values;
                sum.iter_mut()
                    .zip(&share.gradient.values)
                    .for_each(|(a, b)| *a += b);
                total.error += share.error;
                total.entropy += share.entropy;
            }
        }
        total
    }
}

/// Pieces whose gradients are held at once.
const GROUP: usize = 8;

/// Trains, beginning at the likelihood-trained `twin`. `checkpoint` is where an interrupted run left off and will
/// leave off.
pub fn train(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    twin: &Model,
    settings: &Settings,
    checkpoint: Option<&Path>,
    say: Say,
) -> Result<MgeModel> {
    check(settings)?;
    say("forced alignment with the likelihood-trained model");
    let data = data::read(folder, audio_only, twin, settings.clips, settings.hold_out, say)?;
    say(&format!(
        "{} clips with video, {} with sound only, {} to validate on",
        data.train.len(),
        data.heard.len(),
        data.validation.len()
    ));
    train_on(&data, twin, settings, checkpoint, say)
}

fn check(settings: &Settings) -> Result<()> {
    let ok = settings.inputs > 0
        && settings.memory > 0
        && settings.passes > 0
        && settings.batch > 0
        && settings.batch < 1 << 16
        && settings.crop > 0
        && settings.rates != Gate::Both;
    if !ok {
        bail!("inputs, memory, passes, batch and crop must be at least 1, and one chain owns the rates");
    }
    for (name, share) in [
        ("dropout of the memory", settings.output_dropout),
        ("dropout of the feedback", settings.feedback_dropout),
        ("change of speed", settings.warp),
    ] {
        if !(0.0..1.0).contains(&share) {
            bail!("the {name} is {share}: give 0 or more, less than 1");
        }
    }
    let positive = [
        settings.audio_entropy,
        settings.visual_entropy,
        settings.heard_entropy,
        settings.frame_noise,
        settings.clip_noise,
        settings.rule.rate,
        settings.rule.decay,
        settings.rule.transition_rate,
    ];
    if positive.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
        bail!("weights, noise, rates and decay must be 0 or more");
    }
    Ok(())
}

/// [`train`] on data that has been read.
pub fn train_on(
    data: &Data,
    twin: &Model,
    settings: &Settings,
    checkpoint_path: Option<&Path>,
    say: Say,
) -> Result<MgeModel> {
    let shape = Shape {
        phones: twin.phones.len(),
        context: settings.context.clone(),
        inputs: settings.inputs,
        memory: settings.memory,
        outputs: data.deviation.len(),
        feedback: settings.feedback,
        maps: settings.maps,
        rates: settings.rates,
    };
    let powers: Vec<f32> = data
        .deviation
        .iter()
        .map(|d| d.powf(settings.error_power))
        .collect();
    let sum: f32 = powers.iter().sum();
    let mut trainer = Trainer {
        settings,
        data,
        chain: Chain::new(&twin.phones, &twin.transition, &twin.bigram),
        context_mean: Vec::new(),
        weights: powers.iter().map(|p| p / sum).collect(),
    };
    let steps = settings.passes * trainer.steps_per_pass();
    let rule = Rule {
        steps,
        warm_up: settings.rule.warm_up.min(steps / 4),
        ..settings.rule.clone()
    };
    let run = fingerprint(settings, data);
    let found = match checkpoint_path {
        Some(path) => checkpoint::read(path, &shape, run)?,
        None => None,
    };
    let (mut optimiser, mut best) = match found {
        Some((optimiser, best, context_mean)) => {
            say(&format!("going on after step {} of {steps}", optimiser.step));
            trainer.context_mean = context_mean;
            (optimiser, best)
        }
        None => {
            let (parameters, mean) = begin(&shape, data, twin, settings)?;
            trainer.context_mean = mean;
            let best = Best {
                error: f64::INFINITY,
                parameters: parameters.clone(),
                pass: 0,
            };
            (Optimiser::new(parameters), best)
        }
    };
    say(&format!(
        "{} parameters, {:.1} KiB of tables in i8; {steps} steps",
        optimiser.parameters.values.len(),
        optimiser.parameters.table_size() as f64 / 1024.0
    ));
    let mut begun = Instant::now();
    let (mut error, mut entropy, mut length, mut count) = (0.0, 0.0, 0.0f32, 0);
    while optimiser.step < steps {
        let step = optimiser.step;
        let share = trainer.batch(&optimiser.parameters, step);
        let moved = if share.error.is_finite() && share.entropy.is_finite() {
            optimiser.step(&rule, &share.gradient)
        } else {
            None
        };
        let Some(moved) = moved else {
            bail!(
                "training diverged at step {} of {steps} (loss {}): lower the learning rate, now {}",
                step + 1,
                share.error,
                rule.rate
            );
        };
        error += share.error;
        entropy += share.entropy;
        length = length.max(moved);
        count += 1;
        if optimiser.step % trainer.steps_per_pass() == 0 {
            let pass = optimiser.step / trainer.steps_per_pass();
            let seen = validate(&trainer, &optimiser, pass, &mut best)?;
            say(&format!(
                "pass {pass}/{}: error {:.4}, entropy {:.4}, gradient up to {length:.2}; {seen}; {:.1} s",
                settings.passes,
                error / f64::from(count),
                entropy / f64::from(count),
                begun.elapsed().as_secs_f32()
            ));
            if let Some(path) = checkpoint_path {
                checkpoint::write(path, &optimiser, &best, &trainer.context_mean, run)?;
            }
            begun = Instant::now();
            (error, entropy, length, count) = (0.0, 0.0, 0.0, 0);
        }
    }
    say(&format!("the parameters after pass {} are kept", best.pass));
    Ok(MgeModel {
        twin: twin.clone(),
        parameters: best.parameters,
        context_mean: trainer.context_mean,
        scale: data.scale.clone(),
        deviation: data.deviation.clone(),
        least: LEAST,
        provenance: format!(
            "coupled HMM trained on the error of its mouth; {} clips with video, {} with sound only, {} passes, seed {}; \
             started from: {}",
            data.train.len(),
            data.heard.len(),
            settings.passes,
            settings.seed,
            twin.provenance
        ),
    })
}

fn begin(shape: &Shape, data: &Data, twin: &Model, settings: &Settings) -> Result<(Parameters, Vec<f32>)> {
    let seen: Vec<Seen> = data
        .train
        .iter()
        .chain(&data.heard)
        .map(|clip| Seen {
            context: shape.context.stack(&clip.x, clip.x.nrows()),
            states: clip.states.clone(),
            mouth: clip.mouth.clone(),
        })
        .collect();
    let transition = Array2::from_shape_vec(
        (shape.phones, ROWS),
        twin.transition.iter().copied().collect::<Vec<f32>>(),
    )?;
    let (parameters, mean) = start(
        shape,
        &seen,
        &transition,
        &twin.initial.to_vec(),
        &settings.start,
        settings.seed,
    )?;
    Ok((parameters, mean.to_vec()))
}

/// Scores the mean of the parameters and keeps it if it is the best; without validation clips the last one is kept.
fn validate(trainer: &Trainer, optimiser: &Optimiser, pass: usize, best: &mut Best) -> Result<String> {
    let data = trainer.data;
    if data.validation.is_empty() {
        *best = Best {
            error: 0.0,
            parameters: optimiser.mean.clone(),
            pass,
        };
        return Ok("no clips to validate on".into());
    }
    let seen = judge(
        &optimiser.mean,
        &trainer.chain,
        &trainer.context_mean,
        &data.deviation,
        &data.validation,
        0,
        LEAST,
    );
    let amse = seen.score.amse();
    if !amse.is_finite() {
        bail!(
            "training diverged in pass {pass}: lower the learning rate, now {}",
            trainer.settings.rule.rate
        );
    }
    if amse < best.error {
        *best = Best {
            error: amse,
            parameters: optimiser.mean.clone(),
            pass,
        };
    }
    Ok(format!(
        "validation AMSE {amse:.0}, ACC {:.4}, phones {:.1} %, visemes {:.1} %, viseme states {:.1} %",
        seen.score.acc(),
        100.0 * seen.share(seen.phones),
        100.0 * seen.share(seen.visemes),
        100.0 * seen.share(seen.visual_states)
    ))
}

/// A number that settings and data share with no other run (FNV-1a).
fn fingerprint(settings: &Settings, data: &Data) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut eat = |bytes: &[u8]| {
        for b in bytes {
            hash = (hash ^ u64::from(*b)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    eat(format!("{settings:?}").as_bytes());
    for clip in data.train.iter().chain(&data.heard).chain(&data.validation) {
        eat(clip.id.as_bytes());
        eat(&clip.x.sum().to_bits().to_le_bytes());
        eat(&(clip.x.nrows() as u64).to_le_bytes());
        let states: usize = clip
            .states
            .iter()
            .enumerate()
            .map(|(t, (a, v))| (t + 1) * (a + 7 * v))
            .sum();
        eat(&(states as u64).to_le_bytes());
        if let Some(mouth) = &clip.mouth {
            eat(&mouth.sum().to_bits().to_le_bytes());
        }
    }
    hash
}
