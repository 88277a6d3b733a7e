//! A second memory for a model that is trained already: a gated recurrent unit on the model's own inputs z, trained by itself on the error of its own mouth, and
//! averaged with the first.
//!
//! Two memories that were trained together would share their errors; trained apart, the mean of both errs less than either, most of all on words that no
//! training had (`docs/models.md`). The loss is that of the first memory (M10) with one cross-entropy, of phones, since there are no states here. The first
//! memory, and the z that both hear, stay as they are.
use std::path::Path;
use std::time::Instant;

use ndarray::{Array2, ArrayView2, Axis, s};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::batch::{Counts, Heard, Of, Piece, Trainer, mask};
use super::checkpoint::{self, Best};
use super::data::{self, Beside, Data};
use super::judge::centred;
use super::optimise::{Learnt, Optimiser, Rule, Span};
use super::pass::{Masks, Tape};
use super::settings::MgeTrainSettings;
use super::train::{fingerprint, weights};
use crate::error::{Result, bail};
use crate::evaluate::metrics::Score;
use crate::features::FeatureFolder;
use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::recurrent::chain::axpy;
use lipstream::kinds::recurrent::gated::{Cell, Gated, GatedShape, PARTS, Part, STRIDE};
use lipstream::kinds::recurrent::model::{LEAST, RecurrentModel};
use lipstream::kinds::recurrent::parameters::Group;
use lipstream::kinds::recurrent::step::{Net, softmax};
use lipstream::progress::Progress;
use lipstream::random::fill_normal;

/// Shares of the second memory of which the validation clips choose one.
const SHARES: [f32; 7] = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
/// The share without validation clips.
const EVEN: f32 = 0.5;
/// Deviation of the weights that speak, at the start.
const SPEAKING: f32 = 0.02;

impl Learnt for Gated {
    fn values(&self) -> &[f32] {
        &self.values
    }

    fn values_mut(&mut self) -> &mut Vec<f32> {
        &mut self.values
    }

    fn spans(&self, _: &Rule) -> Vec<Span> {
        let span = |part: Part| Span {
            len: self.of(part).len(),
            rate: Some(1.0),
            rest: part.is_matrix().then_some(0.0),
        };
        PARTS.into_iter().map(span).collect()
    }
}

/// The settings of [`train`] for a second memory of as many numbers as `base` says, beside `model`.
pub fn settings(model: &RecurrentModel, base: &MgeTrainSettings) -> MgeTrainSettings {
    base.of_model(&model.parameters.shape)
}

/// Gives `model` a second memory of `base.memory` numbers, trained on the clips that it was trained on. One that it has is replaced.
///
/// # Errors
///
/// That the clips are others than the model's, or what reading them says.
pub fn train(
    folder: &FeatureFolder,
    beside: &Beside,
    model: &RecurrentModel,
    base: &MgeTrainSettings,
    checkpoint: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let settings = settings(model, base);
    settings.check()?;
    progress.say("forced alignment with the likelihood-trained model");
    let aside = checkpoint.and_then(Path::parent);
    let data = data::read(folder, beside, &model.parent, &settings, aside, progress)?;
    train_on(&data, model, &settings, checkpoint, progress)
}

/// [`train`] on data that has been read, with [`settings`].
///
/// # Errors
///
/// That the data's statics or mouth have other deviations than those that the model was trained on.
pub fn train_on(
    data: &Data,
    model: &RecurrentModel,
    settings: &MgeTrainSettings,
    checkpoint_path: Option<&Path>,
    progress: &dyn Progress,
) -> Result<RecurrentModel> {
    let alike = |a: &[f32], b: &[f32]| {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-3 * b.abs())
    };
    if !alike(&data.scale, &model.scale) || !alike(&data.deviation, &model.deviation) {
        bail!(
            Data,
            "the clips are not those that the model was trained on: a second memory hears and speaks in the first one's units"
        );
    }
    let trainer = Trainer {
        settings,
        data,
        chain: model.chain(),
        context_mean: model.context_mean.clone(),
        weights: weights(&data.deviation, settings.error_power),
    };
    let projection = model.parameters.matrix(Group::Projection);
    let judge = Judge::new(&trainer, model)?;
    let steps = settings.passes * trainer.steps_per_pass();
    let rule = settings.rule.over(steps);
    let run = fingerprint(settings, data)? ^ u64::from(projection.sum().to_bits());
    let empty = Gated::zeros(GatedShape {
        inputs: settings.inputs,
        memory: settings.memory,
        outputs: data.deviation.len(),
        phones: model.parent.phones.len(),
    });
    let found = match checkpoint_path {
        Some(path) => checkpoint::read(path, &empty, run)?,
        None => None,
    };
    let (mut optimiser, mut best) = match found {
        Some((optimiser, best, _)) => {
            progress.say(&format!("going on after step {} of {steps}", optimiser.step));
            (optimiser, best)
        }
        None => {
            let start = begin(empty, settings.seed);
            let best = Best {
                error: f64::INFINITY,
                parameters: start.clone(),
                pass: 0,
            };
            (Optimiser::new(start), best)
        }
    };
    let (mut error, mut entropy, mut count, mut begun) = (0.0, 0.0, 0, Instant::now());
    while optimiser.step < steps {
        let share = batch(&trainer, &projection, &optimiser.parameters, optimiser.step)?;
        if optimiser.step(&rule, &share.gradient).is_none() {
            bail!(
                Numbers,
                "training diverged at step {} of {steps}: lower the learning rate, now {}",
                optimiser.step + 1,
                rule.rate
            );
        }
        error += share.error;
        entropy += share.entropy;
        count += 1;
        if optimiser.step % trainer.steps_per_pass() == 0 {
            let pass = optimiser.step / trainer.steps_per_pass();
            let said = judge.validate(&optimiser.mean, pass, &mut best);
            progress.say(&format!(
                "pass {pass}/{}: error {:.4}, entropy {:.4}; {said}; {:.1} s",
                settings.passes,
                error / f64::from(count),
                entropy / f64::from(count),
                begun.elapsed().as_secs_f32()
            ));
            if let Some(path) = checkpoint_path {
                checkpoint::write(path, &optimiser, &best, &trainer.context_mean, run)?;
            }
            (error, entropy, count, begun) = (0.0, 0.0, 0, Instant::now());
        }
    }
    let mut gated = best.parameters.trained();
    let said = judge.said(&gated);
    gated.share = judge.share(&said);
    progress.say(&format!(
        "the parameters after pass {} are kept; the second memory has {:.1} of the mouth",
        best.pass, gated.share
    ));
    let ahead = settings.context.look_ahead();
    Ok(RecurrentModel {
        validation_amse: judge.amse_at(&said, gated.share, ahead).or(model.validation_amse),
        provenance: format!(
            "beside it a second memory, a gated recurrent unit of {} numbers trained by itself; {} clips with video, {} with sound only; {} passes, seed {}; \
             the first: {}",
            settings.memory,
            data.train.len(),
            data.heard.len(),
            settings.passes,
            settings.seed,
            model.provenance
        ),
        gated: Some(gated),
        ..model.clone()
    })
}

/// Small random numbers; h begins at 0.
fn begin(mut gated: Gated, seed: u64) -> Gated {
    let mut rng = Pcg64::seed_from_u64(seed);
    let reach = 1.0 / (gated.shape.memory as f32).sqrt();
    for part in [Part::Input, Part::InputBias, Part::Again, Part::AgainBias] {
        for v in gated.of_mut(part) {
            *v = rng.random_range(-reach..=reach);
        }
    }
    for part in [Part::Output, Part::Later, Part::Phone] {
        fill_normal(gated.of_mut(part), 0.0, SPEAKING, &mut rng);
    }
    gated
}

/// Losses and gradient.
struct Share {
    gradient: Gated,
    error: f64,
    entropy: f64,
}

fn batch(trainer: &Trainer, projection: &ArrayView2<f32>, gated: &Gated, step: usize) -> Result<Share> {
    let (pieces, frames) = trainer.counted_pieces(step);
    let mut total = Share {
        gradient: Gated::zeros(gated.shape),
        error: 0.0,
        entropy: 0.0,
    };
    let learn = |piece: &Piece, rng: &mut Pcg64| learn(trainer, projection, gated, piece, frames, rng);
    trainer.in_groups(&pieces, step, learn, |share: Share| {
        axpy(1.0, &share.gradient.values, &mut total.gradient.values);
        total.error += share.error;
        total.entropy += share.entropy;
    })?;
    Ok(total)
}

/// Loss and gradient of one piece, already divided by the batch's frames of its kind.
fn learn(
    trainer: &Trainer,
    projection: &ArrayView2<f32>,
    gated: &Gated,
    piece: &Piece,
    frames: Counts,
    rng: &mut Pcg64,
) -> Result<Share> {
    let heard = trainer.hear(piece, rng)?;
    let keep = mask(gated.shape.memory, trainer.settings.output_dropout, rng);
    let tape = GatedTape::forward(gated, &heard.context.dot(&projection.t()), &keep);
    let n = frames.of(piece.of) as f32;
    let mut pull = Array2::zeros(tape.output.dim());
    let error = trainer.wrong(piece, &heard, tape.output.view(), n, &mut pull);
    let (weight, _) = trainer.entropies(piece.of);
    // A step stands for the frame that follows it too.
    let weight = weight * STRIDE as f32 / n;
    let mut gradient = Gated::zeros(gated.shape);
    let entropy = tape.reverse(gated, &pull, &phones(piece.of, &heard), weight, &mut gradient);
    Ok(Share {
        gradient,
        error: error / f64::from(n),
        entropy,
    })
}

/// The phone of every step, where phones are known.
fn phones(of: Of, heard: &Heard) -> Vec<usize> {
    match of {
        Of::Person | Of::Heard => heard
            .targets
            .iter()
            .step_by(STRIDE)
            .map(|(audio, _)| audio / N_EMITTING)
            .collect(),
        Of::Watched => Vec::new(),
    }
}

/// A piece through the second memory, and what the reverse pass needs again.
pub struct GatedTape {
    /// z at the steps, `[S, Z]`.
    z: Array2<f32>,
    cells: Vec<Cell>,
    /// What the products that speak read, `[S, K]`: h, where it is not left out.
    read: Array2<f32>,
    /// Factor of every number of h on its way to them, `[K]`.
    keep: Vec<f32>,
    /// ĝ, standardised, `[T, D]`.
    pub output: Array2<f32>,
}

impl GatedTape {
    /// Follows z `[T, Z]`; `keep` `[K]` multiplies what is read of h, empty: 1.
    pub fn forward(gated: &Gated, z: &Array2<f32>, keep: &[f32]) -> Self {
        let k = gated.shape.memory;
        let bias = |part: Part| gated.matrix(part).index_axis_move(Axis(1), 0).to_owned();
        let frames = z.nrows();
        let z = z.slice(s![..;STRIDE, ..]).to_owned();
        let drive = z.dot(&gated.matrix(Part::Input).t()) + bias(Part::InputBias);
        let keep = if keep.is_empty() {
            vec![1.0; k]
        } else {
            keep.to_vec()
        };
        let mut cells: Vec<Cell> = Vec::with_capacity(z.nrows());
        let mut read = Array2::zeros((z.nrows(), k));
        for (s, drive) in drive.outer_iter().enumerate() {
            let before = cells.last().map_or(gated.of(Part::First), |cell| &cell.memory);
            let cell = gated.step(drive.as_slice().expect("standard layout"), before);
            for ((to, h), keep) in read.row_mut(s).iter_mut().zip(&cell.memory).zip(&keep) {
                *to = h * keep;
            }
            cells.push(cell);
        }
        let mut output = Array2::zeros((frames, gated.shape.outputs));
        for after in 0..STRIDE {
            let (weights, biases) = Gated::speaks(after);
            let said = read.dot(&gated.matrix(weights).t()) + bias(biases);
            let mut places = output.slice_mut(s![after..;STRIDE, ..]);
            let n = places.nrows();
            places.assign(&said.slice(s![..n, ..]));
        }
        Self {
            z,
            cells,
            read,
            keep,
            output,
        }
    }

    /// Adds the gradient of a loss to `gradient`: `pull` `[T, D]` is the loss's by ĝ, `weight` that of the cross-entropy, summed over steps, towards `phones` (of every step; empty: none). Gives
    /// the weighted cross-entropy.
    pub fn reverse(
        &self,
        gated: &Gated,
        pull: &Array2<f32>,
        phones: &[usize],
        weight: f32,
        gradient: &mut Gated,
    ) -> f64 {
        let k = gated.shape.memory;
        let steps = self.cells.len();
        let mut add = |part: Part, matrix: ArrayView2<f32>| {
            let to = gradient.of_mut(part);
            to.iter_mut().zip(&matrix).for_each(|(to, from)| *to += from);
        };
        // From what was said to h.
        let mut of_read = Array2::<f32>::zeros((steps, k));
        for after in 0..STRIDE {
            let (weights, biases) = Gated::speaks(after);
            let pull = pull.slice(s![after..;STRIDE, ..]);
            let n = pull.nrows();
            add(weights, pull.t().dot(&self.read.slice(s![..n, ..])).view());
            add(biases, pull.sum_axis(Axis(0)).insert_axis(Axis(1)).view());
            let mut to = of_read.slice_mut(s![..n, ..]);
            to += &pull.dot(&gated.matrix(weights));
        }
        let mut entropy = 0.0;
        if weight > 0.0 && !phones.is_empty() {
            let bias = gated.matrix(Part::PhoneBias).index_axis_move(Axis(1), 0);
            let mut logits = self.read.dot(&gated.matrix(Part::Phone).t()) + bias;
            for (mut row, phone) in logits.outer_iter_mut().zip(phones) {
                let likely = softmax(row.as_slice().expect("standard layout"));
                entropy -= f64::from(weight * likely[*phone].max(f32::MIN_POSITIVE).ln());
                row.iter_mut().zip(likely).for_each(|(to, p)| *to = weight * p);
                row[*phone] -= weight;
            }
            add(Part::Phone, logits.t().dot(&self.read).view());
            add(
                Part::PhoneBias,
                logits.sum_axis(Axis(0)).insert_axis(Axis(1)).view(),
            );
            of_read += &logits.dot(&gated.matrix(Part::Phone));
        }
        // Through time, to the sums before the gates (`of_input`) and to R_g h + b_r (`of_again`).
        let again = gated.of(Part::Again);
        let (mut of_input, mut of_again) = (
            Array2::<f32>::zeros((steps, 3 * k)),
            Array2::<f32>::zeros((steps, 3 * k)),
        );
        let mut befores = Array2::<f32>::zeros((steps, k));
        let mut of_next = vec![0.0f32; k];
        for s in (0..steps).rev() {
            let cell = &self.cells[s];
            let before: &[f32] = match s {
                0 => gated.of(Part::First),
                _ => &self.cells[s - 1].memory,
            };
            let mut of_before = vec![0.0; k];
            for i in 0..k {
                befores[[s, i]] = before[i];
                let of_h = of_next[i] + of_read[[s, i]] * self.keep[i];
                let (r, u, n) = (cell.gates[i], cell.gates[k + i], cell.gates[2 * k + i]);
                let of_new = of_h * (1.0 - u) * (1.0 - n * n);
                of_before[i] = of_h * u;
                of_input[[s, i]] = of_new * cell.again[i] * r * (1.0 - r);
                of_input[[s, k + i]] = of_h * (before[i] - n) * u * (1.0 - u);
                of_input[[s, 2 * k + i]] = of_new;
                of_again[[s, i]] = of_input[[s, i]];
                of_again[[s, k + i]] = of_input[[s, k + i]];
                of_again[[s, 2 * k + i]] = of_new * r;
            }
            for (row, g) in again.chunks_exact(k).zip(of_again.row(s)) {
                axpy(*g, row, &mut of_before);
            }
            of_next = of_before;
        }
        add(Part::Input, of_input.t().dot(&self.z).view());
        add(
            Part::InputBias,
            of_input.sum_axis(Axis(0)).insert_axis(Axis(1)).view(),
        );
        add(Part::Again, of_again.t().dot(&befores).view());
        add(
            Part::AgainBias,
            of_again.sum_axis(Axis(0)).insert_axis(Axis(1)).view(),
        );
        axpy(1.0, &of_next, gradient.of_mut(Part::First));
        entropy
    }
}

/// What the validation clips say of a second memory.
struct Judge<'a> {
    deviation: &'a [f32],
    look_aheads: Vec<usize>,
    /// Of every clip with a mouth at every look-ahead.
    clips: Vec<Judged>,
}

struct Judged {
    ahead: usize,
    z: Array2<f32>,
    /// What the first memory says, and the true mouth, standardised.
    first: Array2<f32>,
    mouth: Array2<f32>,
}

impl<'a> Judge<'a> {
    fn new(trainer: &Trainer<'a>, model: &RecurrentModel) -> Result<Self> {
        let settings = trainer.settings;
        let own = settings.context.look_ahead();
        let mut look_aheads = settings.look_aheads.clone();
        if !look_aheads.contains(&own) {
            look_aheads.push(own);
        }
        let net = Net::new(&model.parameters, &trainer.chain, LEAST);
        let validation = &trainer.data.validation;
        let judged = |n: usize| -> Result<Vec<Judged>> {
            let clip = validation.get(n)?;
            let Some(mouth) = &clip.mouth else {
                return Ok(Vec::new());
            };
            let at = |&ahead: &usize| {
                let stacked = settings.context.stack_within(&clip.x, clip.x.nrows(), ahead);
                let context = centred(&stacked, &trainer.context_mean);
                let tape = Tape::forward(&net, context, Masks::default());
                Judged {
                    ahead,
                    first: tape.output,
                    z: tape.z,
                    mouth: mouth.clone(),
                }
            };
            Ok(look_aheads.iter().map(at).collect())
        };
        let clips: Vec<Vec<Judged>> = (0..validation.len())
            .into_par_iter()
            .map(judged)
            .collect::<Result<_>>()?;
        Ok(Self {
            deviation: &trainer.data.deviation,
            look_aheads,
            clips: clips.into_iter().flatten().collect(),
        })
    }

    /// What the second memory says of every clip.
    fn said(&self, gated: &Gated) -> Vec<Array2<f32>> {
        self.clips
            .par_iter()
            .map(|clip| GatedTape::forward(gated, &clip.z, &[]).output)
            .collect()
    }

    /// Score of the mean with `share` of what was `said`, at one look-ahead or all.
    fn score(&self, said: &[Array2<f32>], share: f32, ahead: Option<usize>) -> Score {
        let mut score = Score::new(self.deviation.len());
        let scale = ndarray::ArrayView1::from(self.deviation);
        for (clip, said) in self.clips.iter().zip(said) {
            if ahead.is_none_or(|ahead| ahead == clip.ahead) {
                let mean = &clip.first + &((said - &clip.first) * share);
                score.add(&(&clip.mouth * &scale), &(mean * scale));
            }
        }
        score
    }

    /// Keeps `gated` if it is the best at an even share; the last one where nothing judges.
    fn validate(&self, gated: &Gated, pass: usize, best: &mut Best<Gated>) -> String {
        let now = |error: f64| Best {
            error,
            parameters: gated.clone(),
            pass,
        };
        if self.clips.is_empty() {
            *best = now(0.0);
            return "no clips to validate on".into();
        }
        let said = self.said(gated);
        let amse = self.score(&said, EVEN, None).amse();
        if amse < best.error {
            *best = now(amse);
        }
        let at = |ahead: &usize| {
            let [first, both, second] = [0.0, EVEN, 1.0].map(|share| self.score(&said, share, Some(*ahead)));
            format!(
                "at {} ms AMSE {:.0}, both {:.0}, the second alone {:.0}, ACC {:.4}, both {:.4}",
                10 * ahead,
                first.amse(),
                both.amse(),
                second.amse(),
                first.acc(),
                both.acc()
            )
        };
        let said: Vec<String> = self.look_aheads.iter().map(at).collect();
        format!("validation {}", said.join("; "))
    }

    /// The share of what was `said` with which the mean is nearest to the true mouths.
    fn share(&self, said: &[Array2<f32>]) -> f32 {
        if self.clips.is_empty() {
            return EVEN;
        }
        let of = |share: &f32| self.score(said, *share, None).amse();
        SHARES
            .into_iter()
            .min_by(|a, b| of(a).total_cmp(&of(b)))
            .unwrap_or(EVEN)
    }

    fn amse_at(&self, said: &[Array2<f32>], share: f32, ahead: usize) -> Option<f64> {
        (!self.clips.is_empty()).then(|| self.score(said, share, Some(ahead)).amse())
    }
}
