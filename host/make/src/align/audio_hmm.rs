//! The audio HMM by itself: what alignment needs of a model. From a file of its own (`lipstream train --sound-only`), or
//! out of any model with a mouth.
use std::path::Path;

use crate::error::{Context as _, Error, Result, bail};
use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::{Array1, Array2, Array3};

use super::Shifts;
use lipstream::engine::FloatModel;
use lipstream::hmm::joint::{N_EMITTING, choice};
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::topology::Topology;
use lipstream::kinds::likelihood::Model;
use lipstream::phones::Phone;
use lipstream::tensors::{Tensors, TensorsBuilder};

/// Version of the file.
const VERSION: u32 = 1;
/// What tells the file from other models.
const KIND: &str = "audio hmm";

/// Which phone is said first, and which after which.
#[derive(Clone, Debug, PartialEq)]
pub struct Bigram {
    /// Natural log of P(first phone), `[phones]`.
    pub initial: Array1<f32>,
    /// Natural log of P(next | phone), `[phones, phones]`.
    pub next: Array2<f32>,
}

impl Bigram {
    /// Every phone is as likely as every other.
    pub fn even(phones: usize) -> Self {
        let share = -(phones.max(1) as f32).ln();
        Self {
            initial: Array1::from_elem(phones, share),
            next: Array2::from_elem((phones, phones), share),
        }
    }
}

/// One chain over the phones, heard every 5 ms.
#[derive(Clone, Debug, PartialEq)]
pub struct AudioHmm {
    /// The phones of the model, in the order of its states.
    pub phones: Vec<Phone>,
    /// Mean of the raw statics that causal normalisation starts from.
    pub start_mean: [f32; N_STATIC],
    /// One per state: 5·phone + i.
    pub audio: Mixtures,
    /// Natural log, `[phones, 5, 4]`, for frames of 5 ms.
    pub transition: Array3<f32>,
    /// What follows what where no text says it.
    pub bigram: Bigram,
    /// What is taken off borders after alignment, by kind of border.
    pub shifts: Shifts,
    /// Exponent of the likelihood: frames 5 ms apart share four fifths of their window and are no five witnesses.
    pub acoustic_scale: f64,
    /// Where the model comes from, in words.
    pub provenance: String,
}

/// Chosen on training speakers that were held out (docs/models.md).
pub const ACOUSTIC_SCALE: f64 = 0.1;

impl AudioHmm {
    /// The audio chain of a model with a mouth: the chance to advance from each state, whatever the mouth does, halved
    /// because frames come twice as often.
    pub fn of_model(model: &Model) -> Result<Self> {
        let start_mean = start_mean(&model.start_mean)?;
        let topology = model.system.topology;
        let mut transition = crate::em::start_transitions(Topology::PH_HMM, model.phones.len());
        for p in 0..model.phones.len() {
            for i in 0..N_EMITTING {
                let rows: Vec<usize> = topology
                    .inside_pairs()
                    .into_iter()
                    .filter(|pair| pair.0 == i)
                    .map(|(i, j)| topology.inside_class(i, j))
                    .collect();
                let advance = |row: &usize| {
                    model.transition[[p, *row, choice::AUDIO_ADVANCES]].exp()
                        + model.transition[[p, *row, choice::BOTH_ADVANCE]].exp()
                };
                let chance = 0.5 * rows.iter().map(advance).sum::<f32>() / rows.len() as f32;
                let chance = chance.clamp(0.01, 0.99);
                transition[[p, i, choice::STAY]] = (1.0 - chance).ln();
                transition[[p, i, choice::BOTH_ADVANCE]] = chance.ln();
            }
        }
        Ok(Self {
            phones: model.phones.clone(),
            start_mean,
            audio: model.audio.clone(),
            transition,
            bigram: Bigram {
                initial: model.initial.clone(),
                next: model.bigram.clone(),
            },
            shifts: Shifts::default(),
            acoustic_scale: ACOUSTIC_SCALE,
            provenance: model.provenance.clone(),
        })
    }

    /// Reads any kind of model; of one trained on the error of its mouth the likelihood-trained parent.
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = Tensors::read(path).map_err(Error::other)?;
        if tensors.noted::<String>("kind").map_err(Error::other)? == KIND {
            return Self::from_tensors(&tensors)
                .with_context(|| format!("{} is no usable audio HMM", path.display()));
        }
        Self::of_any(&FloatModel::of_tensors(&tensors).map_err(Error::other)?)
    }

    /// The audio half of the shipped model.
    pub fn shipped() -> Result<Self> {
        let tensors = Tensors::read_or_shipped(None).map_err(Error::other)?;
        Self::of_any(&FloatModel::of_tensors(&tensors).map_err(Error::other)?)
    }

    fn of_any(model: &FloatModel) -> Result<Self> {
        Self::of_model(match model {
            FloatModel::Likelihood(model) => model,
            FloatModel::Recurrent(model) => &model.parent,
        })
    }

    /// Writes the file that [`AudioHmm::read`] reads. An error when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut out = TensorsBuilder::default();
        out.note("kind", KIND);
        out.note("version", VERSION);
        out.note("acoustic_scale", self.acoustic_scale);
        out.note("provenance", &self.provenance);
        let names: Vec<&str> = self.phones.iter().map(|p| p.name()).collect();
        out.note("phones", names.join(" "));
        out.put_start_mean(&Array1::from(self.start_mean.to_vec()));
        out.put("audio.mean", &self.audio.mean);
        out.put("audio.variance", &self.audio.variance);
        out.put("audio.log_weight", &self.audio.log_weight);
        out.put("transition", &self.transition);
        out.put("initial", &self.bigram.initial);
        out.put("bigram", &self.bigram.next);
        out.put("shifts", &self.shifts.0);
        out.write(path).map_err(Error::other)
    }

    fn from_tensors(from: &Tensors) -> Result<Self> {
        let version: u32 = from.noted("version").map_err(Error::other)?;
        if version != VERSION {
            bail!(
                File,
                "version {version}, this program reads {VERSION}: train it again"
            );
        }
        let names: String = from.noted("phones").map_err(Error::other)?;
        let phones: Vec<Phone> = names
            .split_whitespace()
            .map(|name| Phone::from_name(name).ok_or_else(|| Error::File(format!("unknown phone {name:?}"))))
            .collect::<Result<_>>()?;
        let hmm = Self {
            start_mean: start_mean(&from.start_mean().map_err(Error::other)?)?,
            audio: Mixtures {
                mean: from.array("audio.mean").map_err(Error::other)?,
                variance: from.array("audio.variance").map_err(Error::other)?,
                log_weight: from.array("audio.log_weight").map_err(Error::other)?,
            },
            transition: from.array("transition").map_err(Error::other)?,
            // Files of older builds have none.
            bigram: match from.has("bigram") {
                true => Bigram {
                    initial: from.array("initial").map_err(Error::other)?,
                    next: from.array("bigram").map_err(Error::other)?,
                },
                false => Bigram::even(phones.len()),
            },
            shifts: Shifts(from.array("shifts").map_err(Error::other)?),
            acoustic_scale: from.noted("acoustic_scale").map_err(Error::other)?,
            provenance: from.noted("provenance").map_err(Error::other)?,
            phones,
        };
        if !(hmm.acoustic_scale > 0.0 && hmm.acoustic_scale <= 1.0) {
            bail!(File, "the acoustic scale {} is not in (0, 1]", hmm.acoustic_scale);
        }
        let (states, components, size) = hmm.audio.mean.dim();
        let fits = states == hmm.phones.len() * N_EMITTING
            && states > 0
            && components > 0
            && size == N_OBSERVATION
            && hmm.audio.variance.dim() == (states, components, size)
            && hmm.audio.log_weight.dim() == (states, components)
            && hmm.transition.dim() == (hmm.phones.len(), N_EMITTING, 4)
            && hmm.bigram.initial.len() == hmm.phones.len()
            && hmm.bigram.next.dim() == (hmm.phones.len(), hmm.phones.len())
            && hmm.shifts.0.dim() == Shifts::default().0.dim();
        if !fits {
            bail!(File, "the shapes of its tensors do not agree");
        }
        if hmm.audio.variance.iter().any(|v| *v <= 0.0) {
            bail!(File, "it holds a variance that is not positive");
        }
        Ok(hmm)
    }
}

fn start_mean(mean: &Array1<f32>) -> Result<[f32; N_STATIC]> {
    match mean.as_slice().and_then(|s| s.try_into().ok()) {
        Some(mean) => Ok(mean),
        None => bail!(File, "the start mean is not {N_STATIC} numbers"),
    }
}
