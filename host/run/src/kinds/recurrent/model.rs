//! The model file of minimum generation error training: the trained tables beside the likelihood-trained model that
//! they started from.
use std::path::Path;

use lipstream_core::N_STATIC;
use ndarray::{Array1, Array2, Array3, ArrayView2};

use super::chain::{Chain, VISUAL};
use super::context::Context;
use super::gated::Gated;
use super::parameters::{Feedback, GROUPS, Gate, Group, Parameters, Shape};
use super::step::{log_softmax_rows, softmax};
use crate::error::{Context as _, Error, Result, bail};
use crate::hmm::Hmm;
use crate::hmm::graph::Graph;
use crate::hmm::joint::N_TRANSITION_CLASSES;
use crate::kinds::likelihood::Model;
use crate::tensors::{Tensors, TensorsBuilder};

/// What the file's note `kind` says.
pub const KIND: &str = "mge ph-vi-chmm";
/// Version of the `mge.` part of the file.
pub const VERSION: u32 = 1;
/// Occupancies up to this move nothing.
pub const LEAST: f32 = 1e-4;

/// A trained model, ready to convert.
#[derive(Clone, Debug, PartialEq)]
pub struct RecurrentModel {
    /// The likelihood-trained model: phones, bigram, start mean, mouth, and the start of training.
    pub parent: Model,
    /// What minimum generation error training has learnt.
    pub parameters: Parameters,
    /// A second memory whose mouth is averaged with the first one's.
    pub gated: Option<Gated>,
    /// c̄ `[C]`.
    pub context_mean: Vec<f32>,
    /// What the normalised statics are multiplied with, `[13]`.
    pub scale: Vec<f32>,
    /// What ŷ is multiplied with to be mouth parameters, `[D]`.
    pub deviation: Vec<f32>,
    /// Occupancies up to this are left out of the maps.
    pub least: f32,
    /// AMSE of the clips that chose the parameters, at the full look-ahead; none without such clips.
    pub validation_amse: Option<f64>,
    /// Where the model comes from. For people.
    pub provenance: String,
}

impl RecurrentModel {
    /// The loop over the parent's phones.
    pub fn chain(&self) -> Chain {
        Chain::new(&self.parent.phones, &self.parent.transition, &self.parent.bigram)
    }

    /// Natural logs of the trained transitions, `[phones, 15, 4]`.
    pub fn transition(&self) -> Array3<f32> {
        let logs = log_softmax_rows(self.parameters.of(Group::Transition));
        Array3::from_shape_vec((self.parent.phones.len(), N_TRANSITION_CLASSES, 4), logs)
            .expect("the parameters are of the parent's phones")
    }

    /// The loop over all phones as a graph, and the probability of each arc.
    pub fn phone_loop(&self) -> (Graph, Vec<f64>) {
        Hmm {
            transition: &self.transition(),
            ..Hmm::of_model(&self.parent)
        }
        .phone_loop()
    }

    /// Future that a live mouth waits for, in ms between frame centres.
    pub fn look_ahead_ms(&self) -> u32 {
        10 * self.parameters.shape.context.look_ahead() as u32
    }

    /// Whether a file holds such a model.
    pub fn is_kind(from: &Tensors) -> bool {
        from.noted::<String>("kind").is_ok_and(|k| k == KIND)
    }

    /// Writes the model and its parent to one file.
    ///
    /// # Errors
    ///
    /// That the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut out = TensorsBuilder::default();
        self.parent.store(&mut out);
        out.note("kind", KIND);
        out.note("provenance", &self.provenance);
        out.note("twin.provenance", &self.parent.provenance);
        let shape = &self.parameters.shape;
        out.note("mge.version", VERSION);
        out.note("mge.taps", spaced(&shape.context.taps));
        out.note("mge.mean_shifts", spaced(&shape.context.shifts));
        out.note("mge.feedback", feedback_name(shape.feedback));
        out.note("mge.maps", gate_name(shape.maps));
        out.note("mge.rates", gate_name(shape.rates));
        out.note("mge.least", self.least);
        if let Some(amse) = self.validation_amse {
            out.note("mge.validation_amse", amse);
        }
        out.put("mge.scale", &Array1::from(self.scale.clone()));
        out.put("mge.context_mean", &Array1::from(self.context_mean.clone()));
        out.put("mge.deviation", &Array1::from(self.deviation.clone()));
        for group in GROUPS {
            let name = format!("mge.{}", group.name());
            let (rows, columns) = group.size(shape);
            if rows * columns == 0 {
                continue;
            }
            let values = match group {
                // The file holds log probabilities.
                Group::Transition => log_softmax_rows(self.parameters.of(group)),
                Group::Initial => softmax(self.parameters.of(group))
                    .iter()
                    .map(|p| p.max(1e-30).ln())
                    .collect(),
                _ => self.parameters.of(group).to_vec(),
            };
            if rows == 1 {
                out.put(&name, &Array1::from(values));
            } else {
                let view = ArrayView2::from_shape((rows, columns), &values)?;
                out.put(&name, &view);
            }
        }
        if let Some(gated) = &self.gated {
            gated.store(&mut out)?;
        }
        out.write(path)
    }

    /// Reads a model file.
    ///
    /// # Errors
    ///
    /// That it cannot be read, holds a model of another kind, or is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = Tensors::read(path)?;
        if !Self::is_kind(&tensors) {
            return Err(Error::Kind {
                file: path.display().to_string(),
                kind: tensors.noted("kind").unwrap_or_else(|_| "unknown".into()),
                wanted: KIND,
            });
        }
        Self::from_tensors(&tensors).with_context(|| format!("{} is no usable model", path.display()))
    }

    /// The model in a file that has been read.
    ///
    /// # Errors
    ///
    /// That the file is of another version, or that a note or an array is missing or does not fit.
    pub fn from_tensors(from: &Tensors) -> Result<Self> {
        let version: u32 = from.noted("mge.version")?;
        if version != VERSION {
            bail!(
                File,
                "version {version} of the trained tables, this program reads {VERSION}: train it again"
            );
        }
        let mut parent = Model::from_tensors(from)?;
        parent.provenance = from.noted("twin.provenance")?;
        check_parent(&parent)?;
        let text = |key: &str| from.noted::<String>(key);
        let context = Context {
            taps: numbers(&text("mge.taps")?)?,
            shifts: numbers(&text("mge.mean_shifts")?)?,
        };
        context.check()?;
        let projection: Array2<f32> = from.array("mge.projection")?;
        let drive: Array2<f32> = from.array("mge.drive")?;
        let global: Array2<f32> = from.array("mge.global")?;
        let shape = Shape {
            phones: parent.phones.len(),
            context,
            inputs: projection.nrows(),
            memory: drive.nrows(),
            outputs: global.nrows(),
            feedback: feedback_of(&text("mge.feedback")?)?,
            maps: gate_of(&text("mge.maps")?)?,
            rates: gate_of(&text("mge.rates")?)?,
        };
        if shape.rates == Gate::Both {
            bail!(File, "the rates belong to one chain, not to both");
        }
        let mut parameters = Parameters::zeros(&shape);
        for group in GROUPS {
            let name = format!("mge.{}", group.name());
            let (rows, columns) = group.size(&shape);
            if rows * columns == 0 {
                continue;
            }
            let matrix: Array2<f32> = if rows == 1 {
                from.array::<ndarray::Ix1>(&name)?.insert_axis(ndarray::Axis(0))
            } else {
                from.array(&name)?
            };
            if matrix.dim() != (rows, columns) {
                bail!(
                    File,
                    "tensor {name} has shape {:?}, expected {:?}",
                    matrix.dim(),
                    (rows, columns)
                );
            }
            parameters.assign(group, &matrix);
        }
        let model = RecurrentModel {
            context_mean: from.array::<ndarray::Ix1>("mge.context_mean")?.to_vec(),
            scale: from.array::<ndarray::Ix1>("mge.scale")?.to_vec(),
            deviation: from.array::<ndarray::Ix1>("mge.deviation")?.to_vec(),
            least: from.noted("mge.least")?,
            validation_amse: from.noted("mge.validation_amse").ok(),
            provenance: from.noted("provenance")?,
            gated: Gated::from_tensors(from, shape.inputs, shape.outputs)?,
            parent,
            parameters,
        };
        let sizes = [
            ("mge.context_mean", model.context_mean.len(), shape.context.size()),
            ("mge.scale", model.scale.len(), N_STATIC),
            ("mge.deviation", model.deviation.len(), shape.outputs),
        ];
        for (name, have, want) in sizes {
            if have != want {
                bail!(File, "tensor {name} has {have} numbers, expected {want}");
            }
        }
        if model
            .parent
            .mouth
            .as_ref()
            .is_some_and(|m| m.size() != shape.outputs)
        {
            bail!(
                File,
                "the mouth has another number of eigenmouths than the model speaks"
            );
        }
        Ok(model)
    }
}

/// The step over the phone loop is that of coupled chains over phones and visemes.
///
/// # Errors
///
/// [`Error::Choice`]: the model has other chains.
pub fn check_parent(parent: &Model) -> Result<()> {
    let (_, classes, _) = parent.transition.dim();
    let states = parent.visual.mean.dim().0;
    if classes != N_TRANSITION_CLASSES || states != VISUAL {
        bail!(
            Choice,
            "training starts from a ph-vi-chmm ({N_TRANSITION_CLASSES} transition classes, {VISUAL} visual states), this model has \
             {classes} and {states}"
        );
    }
    Ok(())
}

fn spaced<T: ToString>(items: &[T]) -> String {
    items.iter().map(T::to_string).collect::<Vec<_>>().join(" ")
}

fn numbers<T: std::str::FromStr>(text: &str) -> Result<Vec<T>> {
    text.split_whitespace()
        .map(|word| {
            word.parse()
                .map_err(|_| Error::File(format!("{word:?} in {text:?} is no number of the right kind")))
        })
        .collect()
}

fn feedback_name(feedback: Feedback) -> &'static str {
    match feedback {
        Feedback::None => "none",
        Feedback::Output => "output",
        Feedback::Memory => "memory",
    }
}

fn feedback_of(name: &str) -> Result<Feedback> {
    [Feedback::None, Feedback::Output, Feedback::Memory]
        .into_iter()
        .find(|f| feedback_name(*f) == name)
        .ok_or_else(|| Error::File(format!("unknown feedback {name:?}")))
}

fn gate_name(gate: Gate) -> &'static str {
    match gate {
        Gate::Audio => "audio",
        Gate::Visual => "visual",
        Gate::Both => "both",
    }
}

fn gate_of(name: &str) -> Result<Gate> {
    [Gate::Audio, Gate::Visual, Gate::Both]
        .into_iter()
        .find(|g| gate_name(*g) == name)
        .ok_or_else(|| Error::File(format!("unknown chain {name:?}")))
}
