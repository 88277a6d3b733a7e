//! The float model: a coupled HMM over phones and visemes, local linear visual maps, and the mouth that it
//! moves. What `lipstream train` writes (`.safetensors`) and `lipstream export` quantises.
use std::path::Path;

use ndarray::{Array1, Array2, Array3};

pub mod convert;
pub mod inversion;
pub mod live;
pub mod local_linear;

use crate::error::{Context as _, Error, Result, bail};
use crate::hmm::joint::N_EMITTING;
use crate::hmm::mixtures::Mixtures;
use crate::hmm::system::{Density, System};
use crate::mouth::MouthSpace;
use crate::phones::Phone;
use crate::tensors::{Tensors, TensorsBuilder};

/// Version of the float model file.
pub const MODEL_VERSION: u32 = 2;
/// What the file's note `kind` says.
pub const KIND: &str = "hmm";

/// The projection of stacked statics that the local linear maps read.
#[derive(Clone, Debug, PartialEq)]
pub struct ContextMap {
    /// Taps in hops relative to the frame, increasing; the last one is the look-ahead.
    pub taps: Vec<i32>,
    /// Mean of the stacked statics, `[taps·13]`, tap-major.
    pub mean: Array1<f32>,
    /// Whitened PCA, `[X, taps·13]`.
    pub projection: Array2<f32>,
}

/// Local linear visual densities (`docs/design.md` section 6):
/// ôᵛ = W₀x + b₀ + Σ_v γ(v)·(W_v x + b_v).
#[derive(Clone, Debug, PartialEq)]
pub struct LocalLinear {
    /// `[D, X + 1]`, the bias in the last column.
    pub global: Array2<f32>,
    /// `[visual states, D, X + 1]`, residual maps.
    pub state: Array3<f32>,
}

/// How the model wants to be followed: chosen on validation data, overridable at run time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Following {
    /// Exponent of the audio likelihood. Diagonal Gaussians over overlapping windows are overconfident at 1.
    pub acoustic_scale: f32,
    /// Frames after a frame that its occupancies wait for, beyond the look-ahead of ΔΔ.
    pub lag: usize,
}

/// Which M step conversion takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MStep {
    /// The exact one: a component counts by its occupancy.
    Exact,
    /// X&L eq. 9 as printed: a component counts by its occupancy times its weight.
    Printed,
}

/// How conversion by means goes (X&L section 4): chosen on validation data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmSettings {
    /// Exponent of the audio likelihood.
    pub acoustic_scale: f32,
    /// Exponent of the visual likelihood; 0: the mouth says nothing about the states.
    pub visual_exponent: f32,
    /// EM iterations after the best path's centres.
    pub iterations: usize,
    /// Which M step an iteration takes.
    pub m_step: MStep,
}

impl Default for EmSettings {
    fn default() -> Self {
        Self {
            acoustic_scale: 0.1,
            visual_exponent: 0.0,
            iterations: 1,
            m_step: MStep::Exact,
        }
    }
}

/// The sound is such that no path through the model explains it: it holds numbers that are none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the audio observations are not finite")]
pub struct NotFinite;

/// Everything that training learns.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// What it is: which joint states exist, and how it speaks.
    pub system: System,
    /// Phones that the model knows, in table order; audio state = 5·(index here) + i.
    pub phones: Vec<Phone>,
    /// Causal normalisation: mean of the raw statics that a stream starts from, `[13]`.
    pub start_mean: Array1<f32>,
    /// One mixture per audio state: 5·phone + i.
    pub audio: Mixtures,
    /// One per visual state: 5·viseme + j, or 5·phone + j where both chains are over phones. In a joint density its
    /// components belong to those of `audio`.
    pub visual: Mixtures,
    /// Natural log, `[phones, classes, 4]` by class and choice; 15 classes where the chains are coupled.
    pub transition: Array3<f32>,
    /// Natural log of P(next | phone), `[phones, phones]`.
    pub bigram: Array2<f32>,
    /// Natural log of P(first phone), `[phones]`.
    pub initial: Array1<f32>,
    /// From a frame and its neighbours to the input of the maps.
    pub context: ContextMap,
    /// The local linear maps, from that input to mouth parameters.
    pub maps: LocalLinear,
    /// How the states are followed while converting: acoustic scale and lag.
    pub following: Following,
    /// How conversion by means goes.
    pub conversion: EmSettings,
    /// Exponent of the sound's likelihood in conversion by the posterior mean, chosen on validation data.
    pub posterior_scale: f32,
    /// Absent in a model trained on plain visual numbers.
    pub mouth: Option<MouthSpace>,
    /// Where the model comes from: corpus, settings, date. For people.
    pub provenance: String,
}

impl Model {
    /// Number of audio states, five per phone.
    pub fn n_audio_states(&self) -> usize {
        self.phones.len() * N_EMITTING
    }

    /// Numbers of the mouth in a frame, D.
    pub fn visual_size(&self) -> usize {
        self.maps.global.nrows()
    }

    /// Future that a live mouth waits for, in ms between frame centres: the context's last tap or the lag behind ΔΔ
    /// (whichever is later), and the frame that the 3-frame smoothing adds.
    pub fn look_ahead_ms(&self) -> u32 {
        const DELTA_FRAMES: usize = 4;
        let context = self.context.taps.last().map_or(0, |t| (*t).max(0) as usize);
        let frames = context.max(self.following.lag + DELTA_FRAMES) + 1;
        10 * frames as u32
    }

    /// Writes the model to a file.
    ///
    /// # Errors
    ///
    /// That the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut out = TensorsBuilder::default();
        self.store(&mut out);
        out.write(path)
    }

    /// Puts everything into a file that may hold more.
    pub(crate) fn store(&self, out: &mut TensorsBuilder) {
        out.note("kind", KIND);
        out.note("system", self.system.name);
        out.note("version", MODEL_VERSION);
        out.note("provenance", &self.provenance);
        out.note("phones", join(self.phones.iter().map(|p| p.name())));
        out.note(
            "context.taps",
            join(self.context.taps.iter().map(|t| t.to_string())),
        );
        out.note("following.acoustic_scale", self.following.acoustic_scale);
        out.note("following.lag", self.following.lag);
        out.note("conversion.acoustic_scale", self.conversion.acoustic_scale);
        out.note("conversion.visual_exponent", self.conversion.visual_exponent);
        out.note("conversion.iterations", self.conversion.iterations);
        out.note("conversion.posterior_scale", self.posterior_scale);
        out.put_start_mean(&self.start_mean);
        for (name, mixtures) in [("audio", &self.audio), ("visual", &self.visual)] {
            out.put(&format!("{name}.mean"), &mixtures.mean);
            out.put(&format!("{name}.variance"), &mixtures.variance);
            out.put(&format!("{name}.log_weight"), &mixtures.log_weight);
        }
        out.put("transition", &self.transition);
        out.put("bigram", &self.bigram);
        out.put("initial", &self.initial);
        out.put("context.mean", &self.context.mean);
        out.put("context.projection", &self.context.projection);
        out.put("maps.global", &self.maps.global);
        out.put("maps.state", &self.maps.state);
        if let Some(mouth) = &self.mouth {
            mouth.store(out);
        }
    }

    /// Reads a model file of this kind.
    ///
    /// # Errors
    ///
    /// [`Error::Kind`] for a file of another kind; that it cannot be read, is of another version or is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = Tensors::read(path)?;
        let kind: String = tensors
            .noted("kind")
            .with_context(|| format!("{} is no usable model", path.display()))?;
        check_kind(&path.display().to_string(), kind)?;
        Self::from_tensors(&tensors).with_context(|| format!("{} is no usable model", path.display()))
    }

    /// The model in a file that has been read; refuses another kind.
    ///
    /// # Errors
    ///
    /// As [`Model::read`].
    pub fn of_tensors(from: &Tensors) -> Result<Self> {
        check_kind("it", from.noted("kind")?)?;
        Self::from_tensors(from)
    }

    pub(crate) fn from_tensors(from: &Tensors) -> Result<Self> {
        let version: u32 = from.noted("version")?;
        if version != MODEL_VERSION {
            bail!(
                File,
                "model version {version}, this program reads {MODEL_VERSION}: train it again"
            );
        }
        let name: String = from.noted("system")?;
        let Some(system) = System::from_name(&name) else {
            bail!(File, "it holds the unknown system {name:?}");
        };
        let names: String = from.noted("phones")?;
        let mut phones = Vec::new();
        for name in names.split_whitespace() {
            match Phone::from_name(name) {
                Some(phone) => phones.push(phone),
                None => bail!(File, "unknown phone {name:?}"),
            }
        }
        let taps: String = from.noted("context.taps")?;
        let taps = taps
            .split_whitespace()
            .map(str::parse)
            .collect::<Result<Vec<i32>, _>>()
            .map_err(Error::other)?;
        let mixtures = |name: &str| -> Result<Mixtures> {
            Ok(Mixtures {
                mean: from.array(&format!("{name}.mean"))?,
                variance: from.array(&format!("{name}.variance"))?,
                log_weight: from.array(&format!("{name}.log_weight"))?,
            })
        };
        // Files of before there was such a conversion lack it.
        let posterior_scale = match from.has_note("conversion.posterior_scale") {
            true => "conversion.posterior_scale",
            false => "conversion.acoustic_scale",
        };
        let model = Model {
            system,
            phones,
            start_mean: from.start_mean()?,
            audio: mixtures("audio")?,
            visual: mixtures("visual")?,
            transition: from.array("transition")?,
            bigram: from.array("bigram")?,
            initial: from.array("initial")?,
            context: ContextMap {
                taps,
                mean: from.array("context.mean")?,
                projection: from.array("context.projection")?,
            },
            maps: LocalLinear {
                global: from.array("maps.global")?,
                state: from.array("maps.state")?,
            },
            following: Following {
                acoustic_scale: from.noted("following.acoustic_scale")?,
                lag: from.noted("following.lag")?,
            },
            conversion: EmSettings {
                acoustic_scale: from.noted("conversion.acoustic_scale")?,
                visual_exponent: from.noted("conversion.visual_exponent")?,
                iterations: from.noted("conversion.iterations")?,
                m_step: MStep::Exact,
            },
            posterior_scale: from.noted(posterior_scale)?,
            mouth: if from.has("mouth.mean") {
                Some(MouthSpace::load(from)?)
            } else {
                None
            },
            provenance: from.noted("provenance")?,
        };
        model.check()?;
        Ok(model)
    }

    /// Every shape fits every other, every variance is positive.
    fn check(&self) -> Result<()> {
        use lipstream_core::{N_OBSERVATION, N_STATIC};
        let (p, s) = (self.phones.len(), self.n_audio_states());
        let n_visual = self.system.topology.n_visual_states(p);
        let (d, x) = (self.visual_size(), self.context.projection.nrows());
        let stacked = self.context.taps.len() * N_STATIC;
        let shapes = [
            ("start_mean", vec![N_STATIC], self.start_mean.shape().to_vec()),
            (
                "audio.mean",
                vec![s, self.audio.mean.dim().1, N_OBSERVATION],
                self.audio.mean.shape().to_vec(),
            ),
            (
                "visual.mean",
                vec![n_visual, self.visual.mean.dim().1, d],
                self.visual.mean.shape().to_vec(),
            ),
            (
                "transition",
                vec![p, self.system.topology.classes_per_phone(), 4],
                self.transition.shape().to_vec(),
            ),
            ("bigram", vec![p, p], self.bigram.shape().to_vec()),
            ("initial", vec![p], self.initial.shape().to_vec()),
            ("context.mean", vec![stacked], self.context.mean.shape().to_vec()),
            (
                "context.projection",
                vec![x, stacked],
                self.context.projection.shape().to_vec(),
            ),
            ("maps.global", vec![d, x + 1], self.maps.global.shape().to_vec()),
            (
                "maps.state",
                vec![n_visual, d, x + 1],
                self.maps.state.shape().to_vec(),
            ),
        ];
        for (name, want, have) in shapes {
            if want != have || want.contains(&0) {
                bail!(File, "tensor {name} has shape {have:?}, expected {want:?}");
            }
        }
        for (name, mixtures) in [("audio", &self.audio), ("visual", &self.visual)] {
            let (states, k, _) = mixtures.mean.dim();
            if mixtures.variance.shape() != mixtures.mean.shape() || mixtures.log_weight.dim() != (states, k)
            {
                bail!(File, "the {name} mixtures' shapes do not agree");
            }
            if mixtures.variance.iter().any(|v| *v <= 0.0) {
                bail!(File, "the {name} mixtures hold a variance that is not positive");
            }
        }
        if self.system.density == Density::Joint && self.audio.mean.dim().1 != self.visual.mean.dim().1 {
            bail!(
                File,
                "a joint density has as many components for the sound as for the mouth"
            );
        }
        if self.mouth.as_ref().is_some_and(|m| m.size() != d) {
            bail!(
                File,
                "the mouth has another number of eigenmouths than the maps have rows"
            );
        }
        for scale in [
            self.following.acoustic_scale,
            self.conversion.acoustic_scale,
            self.posterior_scale,
        ] {
            if !(scale > 0.0 && scale <= 1.0) {
                bail!(File, "the acoustic scale {scale} is not in (0, 1]");
            }
        }
        if !(0.0..=1.0).contains(&self.conversion.visual_exponent) {
            bail!(
                File,
                "the visual exponent {} is not in [0, 1]",
                self.conversion.visual_exponent
            );
        }
        if !self.context.taps.is_sorted() {
            bail!(File, "the context taps are not in increasing order");
        }
        Ok(())
    }
}

/// Refuses a file that is of another kind than this model's.
fn check_kind(file: &str, kind: String) -> Result<()> {
    match kind == KIND {
        true => Ok(()),
        false => Err(Error::Kind {
            file: file.to_owned(),
            kind,
            wanted: KIND,
        }),
    }
}

fn join<T: AsRef<str>>(items: impl Iterator<Item = T>) -> String {
    items.map(|i| i.as_ref().to_owned()).collect::<Vec<_>>().join(" ")
}
