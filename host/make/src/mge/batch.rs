//! Batches: which pieces of which clips, what is added to them, their loss (M10) and its gradient.
use crate::error::Result;
use lipstream_core::N_STATIC;
use ndarray::{Array1, Array2, ArrayBase, ArrayView1, ArrayView2, Data, Ix2};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

use super::data;
use super::judge::centred;
use super::losses;
use super::pass::{Entropy, Masks, Tape, cross_entropy};
use super::settings::MgeTrainSettings;
use super::store::Store;
use lipstream::kinds::recurrent::chain::Chain;
use lipstream::kinds::recurrent::model::LEAST;
use lipstream::kinds::recurrent::parameters::Parameters;
use lipstream::kinds::recurrent::step::Net;
use lipstream::random::normal;

/// One clip's part of a batch.
pub(super) struct Share {
    pub(super) gradient: Parameters,
    pub(super) error: f64,
    pub(super) entropy: f64,
}

pub(super) struct Trainer<'a> {
    pub(super) settings: &'a MgeTrainSettings,
    pub(super) data: &'a data::Data,
    pub(super) chain: Chain,
    pub(super) context_mean: Vec<f32>,
    /// w_d.
    pub(super) weights: Vec<f32>,
}

/// What a clip is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Of {
    /// The person whose mouth is trained.
    Person,
    /// Others, whose sound alone is known.
    Heard,
    /// Others, whose lip gap is known too.
    Watched,
}

/// Frames of a batch, by what they are for.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Counts {
    person: usize,
    heard: usize,
    watched: usize,
}

impl Counts {
    pub(super) fn of(self, of: Of) -> usize {
        match of {
            Of::Person => self.person,
            Of::Heard => self.heard,
            Of::Watched => self.watched,
        }
    }

    fn of_mut(&mut self, of: Of) -> &mut usize {
        match of {
            Of::Person => &mut self.person,
            Of::Heard => &mut self.heard,
            Of::Watched => &mut self.watched,
        }
    }
}

/// Which piece of which clip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// Index into the clips of its kind.
    clip: usize,
    pub(super) of: Of,
    /// The clip disturbed; none: as it is.
    variant: Option<usize>,
    /// Frames of future that are known.
    ahead: usize,
    /// First frame, frames of the clip (or of its variant) per frame of the piece, and frames of the piece.
    from: f32,
    speed: f32,
    pub(super) frames: usize,
}

/// A piece as it is heard.
pub(super) struct Heard {
    /// Contexts without their mean `[T, C]`.
    pub(super) context: Array2<f32>,
    /// Audio and visual state of every frame.
    pub(super) targets: Vec<(usize, usize)>,
    /// `[T, D]`, standardised; of other people their lip gap, `[T, 1]`.
    pub(super) mouth: Option<Array2<f32>>,
}

impl Piece {
    /// Frame of the clip under frame t of the piece, the next one, and how far it is towards that.
    fn place(&self, t: usize, all: usize) -> (usize, usize, f32) {
        let place = (self.from + t as f32 * self.speed).clamp(0.0, (all - 1) as f32);
        let before = place as usize;
        (before, (before + 1).min(all - 1), place - before as f32)
    }

    /// Rows of `of` at the piece's speed, `frames` of them, linear between the clip's.
    fn cut<S: Data<Elem = f32>>(&self, of: &ArrayBase<S, Ix2>, frames: usize) -> Array2<f32> {
        Array2::from_shape_fn((frames, of.ncols()), |(t, d)| {
            let (before, after, share) = self.place(t, of.nrows());
            of[[before, d]] + share * (of[[after, d]] - of[[before, d]])
        })
    }
}

impl Trainer<'_> {
    pub(super) fn steps_per_pass(&self) -> usize {
        self.data.train.len().div_ceil(self.settings.batch)
    }

    fn clips(&self, of: Of) -> &Store {
        match of {
            Of::Person => &self.data.train,
            Of::Heard => &self.data.heard,
            Of::Watched => &self.data.watched,
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
        let watched = shuffled(self.data.watched.len(), 5);
        let mut rng = self.random(3, step as u64);
        let crop = rng.random::<f32>() < self.settings.crops;
        let share = |order: &[usize]| -> Vec<usize> {
            let n = self.steps_per_pass();
            order[order.len() * index / n..order.len() * (index + 1) / n].to_vec()
        };
        let mut pieces = Vec::new();
        let kinds = [
            (share(&with_video), Of::Person),
            (share(&heard), Of::Heard),
            (share(&watched), Of::Watched),
        ];
        for (order, of) in kinds {
            for clip in order {
                let note = self.clips(of).note(clip);
                let variants = &note.variants;
                let variant = (!variants.is_empty() && rng.random::<f32>() < self.settings.disturbed)
                    .then(|| rng.random_range(0..variants.len()));
                let ahead = match self.settings.look_aheads.as_slice() {
                    [] => self.settings.context.look_ahead(),
                    some => some[rng.random_range(0..some.len())].min(self.settings.context.look_ahead()),
                };
                let length = variant.map_or(note.frames, |v| variants[v].1);
                let warp = self.settings.warp;
                let speed = 1.0 + warp * rng.random_range(-1.0f32..=1.0);
                let whole = ((length - 1) as f32 / speed) as usize + 1;
                let frames = if crop {
                    self.settings.crop.min(whole)
                } else {
                    whole
                };
                let room = (whole - frames) as f32 * speed;
                // A variant that begins in mid-clip is a cold start: its beginning is what there is to learn.
                let is_cold = variant.is_some_and(|v| variants[v].0 > 0);
                let from = if is_cold {
                    0.0
                } else {
                    (room * rng.random::<f32>()).round()
                };
                pieces.push(Piece {
                    clip,
                    of,
                    variant,
                    ahead,
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

    /// The sound of one piece with noise on it, and what is known of it.
    pub(super) fn hear(&self, piece: &Piece, rng: &mut Pcg64) -> Result<Heard> {
        let settings = self.settings;
        let clip = self.clips(piece.of).get(piece.clip)?;
        let (of, first) = match piece.variant {
            None => (&clip.x, 0),
            Some(v) => (&clip.variants[v].x, clip.variants[v].first),
        };
        let length = of.nrows();
        let mut x = piece.cut(of, piece.frames + settings.context.look_ahead());
        let shift: [f32; N_STATIC] = std::array::from_fn(|_| settings.clip_noise * normal(rng));
        for mut row in x.outer_iter_mut() {
            for (x, s) in row.iter_mut().zip(shift) {
                *x += s + settings.frame_noise * normal(rng);
            }
        }
        let targets = (0..piece.frames)
            .map(|t| {
                let (before, after, share) = piece.place(t, length);
                let place = first + if share < 0.5 { before } else { after };
                // In a pause behind the clip all stays as it was.
                clip.states[place.min(clip.states.len() - 1)]
            })
            .collect();
        let mouth = clip.mouth.as_ref();
        Ok(Heard {
            context: centred(
                &settings.context.stack_within(&x, piece.frames, piece.ahead),
                &self.context_mean,
            ),
            targets,
            mouth: mouth.map(|mouth| piece.cut(&held(mouth, first, length), piece.frames)),
        })
    }

    /// By how much `said` `[T, D]`, the mouth of a piece, is wrong, summed over its frames; the gradient, divided by the batch's `n` frames of its kind, is added to `pull`.
    pub(super) fn wrong(
        &self,
        piece: &Piece,
        heard: &Heard,
        said: ArrayView2<f32>,
        n: f32,
        pull: &mut Array2<f32>,
    ) -> f64 {
        let settings = self.settings;
        let mut error = 0.0;
        if let (Some(gap), Of::Person | Of::Heard) = (&self.data.gap, piece.of)
            && settings.closure_error > 0.0
        {
            let filmed = heard.mouth.as_ref().filter(|_| piece.of == Of::Person);
            let wrong = gap.wrong(said, filmed.map(|mouth| mouth.view()), &heard.targets);
            for (t, e) in wrong.iter().enumerate() {
                error += f64::from(settings.closure_error * e * e);
                let by = 2.0 * settings.closure_error * e / n;
                pull.row_mut(t).scaled_add(by, &gap.slopes());
            }
        }
        match (&heard.mouth, piece.of, &self.data.gap) {
            (Some(mouth), Of::Person | Of::Heard, _) => {
                let share = match piece.of {
                    Of::Heard => settings.taught_error,
                    _ => 1.0,
                };
                for t in 0..piece.frames {
                    for (d, w) in self.weights.iter().enumerate() {
                        let w = share * w;
                        let e = said[[t, d]] - mouth[[t, d]];
                        error += f64::from(w * e * e);
                        pull[[t, d]] += 2.0 * w * e / n;
                    }
                }
                if piece.of == Of::Person {
                    let wrong = &said - mouth;
                    error += losses::motion(wrong.view(), &self.weights, settings.motion_error, n, pull);
                    if let Some(gap) = &self.data.gap {
                        let slopes = gap.slopes();
                        error += losses::along(wrong.view(), slopes.view(), settings.gap_error, n, pull);
                    }
                }
            }
            (Some(mouth), Of::Watched, Some(gap)) => {
                let gap = gap.slopes();
                let wrong = gap_error(said.dot(&gap).view(), mouth.column(0));
                for (t, e) in wrong.iter().enumerate() {
                    error += f64::from(settings.lip_error * e * e);
                    let by = 2.0 * settings.lip_error * e / n;
                    pull.row_mut(t).scaled_add(by, &gap);
                }
            }
            _ => {}
        }
        error
    }

    /// Weights of the cross-entropies of audio and visual states in pieces of this kind.
    pub(super) fn entropies(&self, of: Of) -> (f32, f32) {
        let settings = self.settings;
        match of {
            Of::Person => (settings.audio_entropy, settings.visual_entropy),
            Of::Heard => (settings.heard_entropy, 0.0),
            Of::Watched => (0.0, 0.0),
        }
    }

    /// Loss and gradient of one piece, already divided by the batch's frames of its kind.
    fn learn(&self, net: &Net, piece: &Piece, frames: Counts, rng: &mut Pcg64) -> Result<Share> {
        let settings = self.settings;
        let heard = self.hear(piece, rng)?;
        let shape = &net.p.shape;
        let masks = Masks {
            output: mask(shape.memory, settings.output_dropout, rng),
            feedback: mask(shape.fed_back(), settings.feedback_dropout, rng),
        };
        let n = frames.of(piece.of) as f32;
        let (audio, visual) = self.entropies(piece.of);
        let entropy = Entropy {
            audio: audio / n,
            visual: visual / n,
            atoms: settings.atoms,
        };
        let tape = Tape::forward(net, heard.context.clone(), masks);
        let mut g_output = Array2::zeros((piece.frames, shape.outputs));
        let error = self.wrong(piece, &heard, tape.output.view(), n, &mut g_output);
        let mut gradient = Parameters::zeros(shape);
        tape.reverse(net, &g_output, Some(&heard.targets), entropy, &mut gradient);
        // One clip in which a state hangs by a thread must not steer the whole batch.
        gradient.cut(settings.rule.clip);
        Ok(Share {
            gradient,
            error: error / f64::from(n),
            entropy: cross_entropy(&tape, &heard.targets, entropy),
        })
    }

    /// The pieces of a step, and their frames by what they are for.
    pub(super) fn counted_pieces(&self, step: usize) -> (Vec<Piece>, Counts) {
        let pieces = self.pieces(step);
        let mut frames = Counts::default();
        for piece in &pieces {
            *frames.of_mut(piece.of) += piece.frames;
        }
        (pieces, frames)
    }

    /// Gradient and losses of every piece of a step, in their order, in groups, so that not every gradient of the batch lies in memory at once.
    pub(super) fn in_groups<T: Send>(
        &self,
        pieces: &[Piece],
        step: usize,
        learn: impl Fn(&Piece, &mut Pcg64) -> Result<T> + Sync,
        mut add: impl FnMut(T),
    ) -> Result<()> {
        for (group, pieces) in pieces.chunks(GROUP).enumerate() {
            let shares: Vec<T> = pieces
                .par_iter()
                .enumerate()
                .map(|(i, piece)| {
                    let place = (step as u64) << 16 | (group * GROUP + i) as u64;
                    learn(piece, &mut self.random(4, place))
                })
                .collect::<Result<_>>()?;
            shares.into_iter().for_each(&mut add);
        }
        Ok(())
    }

    /// Gradient and losses of a step.
    pub(super) fn batch(&self, parameters: &Parameters, step: usize) -> Result<Share> {
        let (pieces, frames) = self.counted_pieces(step);
        let net = Net::new(parameters, &self.chain, LEAST);
        let mut total = Share {
            gradient: Parameters::zeros(&parameters.shape),
            error: 0.0,
            entropy: 0.0,
        };
        let learn = |piece: &Piece, rng: &mut Pcg64| self.learn(&net, piece, frames, rng);
        self.in_groups(&pieces, step, learn, |share: Share| {
            let sum = &mut total.gradient.values;
            sum.iter_mut()
                .zip(&share.gradient.values)
                .for_each(|(a, b)| *a += b);
            total.error += share.error;
            total.entropy += share.entropy;
        })?;
        Ok(total)
    }
}

/// A factor for each of `n` numbers: 0 for a `share` of them, drawn by `rng`, and what keeps the mean for the others.
pub(super) fn mask(n: usize, share: f32, rng: &mut Pcg64) -> Vec<f32> {
    let keep = 1.0 / (1.0 - share);
    (0..n)
        .map(|_| if rng.random::<f32>() < share { 0.0 } else { keep })
        .collect()
}

/// `frames` rows from row `first` on; the last one is held where there are no more.
fn held(rows: &Array2<f32>, first: usize, frames: usize) -> Array2<f32> {
    let last = rows.nrows() - 1;
    Array2::from_shape_fn((frames, rows.ncols()), |(t, d)| rows[[(first + t).min(last), d]])
}

/// By how much a gap is wrong in each frame of a piece. How open a stranger's mouth is on average says nothing: of both the mean is taken off.
fn gap_error(said: ArrayView1<f32>, truth: ArrayView1<f32>) -> Array1<f32> {
    let mut wrong = &said - &truth;
    let mean = wrong.mean().unwrap_or(0.0);
    wrong -= mean;
    wrong
}

/// Pieces whose gradients are held at once.
const GROUP: usize = 8;
