//! Sound to mouth parameters: `fixed` is the very code of the device, `float` the offline arithmetic that it stands for.
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use lipstream_core::hmm::search::MAX_BEAM;
use lipstream_core::kinds::likelihood::FRAMES;
use lipstream_core::kinds::likelihood::tables::MAX_ACOUSTIC_SCALE;
use lipstream_core::logmath::{FRACTION_BITS, LogProb};
use lipstream_core::model::container::MAGIC;
use lipstream_core::settings::Setting;
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel as Tables, AnyStream, ParameterFrame, StreamSettings};
use ndarray::{Array2, Axis};

use crate::export::{ExportSettings, MgeSettings, export, export_mge};
use crate::hmm::Hmm;
use crate::kinds::likelihood::convert::{Follower, Lag, convert, smooth, viseme_weights};
use crate::kinds::likelihood::inversion::Inverter;
use crate::kinds::likelihood::{EmSettings, Model};
use crate::kinds::recurrent::live;
use crate::kinds::recurrent::model::MgeModel;
use crate::kinds::recurrent::settle::settle;
use crate::reference::{self, Normalisation};
use crate::tensors::Tensors;
use lipstream_media::files;

/// Which arithmetic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The device's own code and tables
    Fixed,
    /// 64-bit floats, no beam
    Float,
}

/// What may be asked for at run time; None is the model's own.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunSettings {
    /// Hops.
    pub lag: Option<u16>,
    /// Width of the beam; `fixed` only.
    pub beam_bits: Option<f64>,
    /// The mouth by EM inside the lag window, with this exponent on its likelihood; the maps' where none is given.
    pub feedback: Option<f64>,
    /// How much of the future may be waited for; all that the model can use where none is given.
    pub profile: Option<Profile>,
    /// Whether a mouth that hardly moves is followed slowly; models trained on the error of their mouth only.
    pub settle: Option<bool>,
}

const NO_SETTLING: &str =
    "only models trained on the error of their mouth settle it: leave --no-settling out";

/// A model made ready.
pub enum Engine {
    /// Tables that have been checked.
    Fixed(Vec<u8>),
    Float(Box<Model>),
    /// A model trained on the error of its mouth.
    Mge(Box<MgeModel>),
}

/// What a sound became: one row a frame, 100 a second.
#[derive(Clone, Debug)]
pub struct Converted {
    /// `[frames, D]`, in the units of the visual features.
    pub parameters: Array2<f32>,
    /// Occupancy of each viseme, `[frames, 13]`.
    pub visemes: Array2<f32>,
}

impl Engine {
    /// Reads tables or a float model. The fixed engine quantises a float model first; the float engine needs one.
    pub fn open(path: &Path, kind: Kind) -> Result<Self> {
        Self::open_with(path, kind, false)
    }

    /// [`Engine::open`]; whether a float model is quantised with its visual densities, which [`RunSettings::feedback`] needs.
    pub fn open_with(path: &Path, kind: Kind, visual_densities: bool) -> Result<Self> {
        let bytes = files::read_bytes(path)?;
        let is_tables = bytes.starts_with(&MAGIC);
        match kind {
            Kind::Fixed if is_tables => {
                Self::fixed(bytes).with_context(|| format!("{} cannot be used", path.display()))
            }
            Kind::Fixed if MgeModel::is_kind(&Tensors::read(path)?) => {
                let model = MgeModel::read(path)?;
                Ok(Self::Fixed(export_mge(&model, &MgeSettings::default())?.bytes))
            }
            Kind::Fixed => {
                let model = Model::read(path)?;
                let with = ExportSettings {
                    visual_densities,
                    ..ExportSettings::of(&model)
                };
                Ok(Self::Fixed(export(&model, &with)?.bytes))
            }
            Kind::Float if is_tables => bail!(
                "{} holds the device's tables; `--engine float` needs the model they were exported from",
                path.display()
            ),
            Kind::Float if MgeModel::is_kind(&Tensors::read(path)?) => {
                Ok(Self::Mge(Box::new(MgeModel::read(path)?)))
            }
            Kind::Float => Ok(Self::Float(Box::new(Model::read(path)?))),
        }
    }

    /// The fixed engine on tables in memory.
    pub fn fixed(tables: Vec<u8>) -> Result<Self> {
        Tables::new_checked(&tables)?;
        Ok(Self::Fixed(tables))
    }

    /// Converts 16 kHz mono samples.
    pub fn convert(&self, samples: &[i16], with: &RunSettings) -> Result<Converted> {
        match self {
            Self::Fixed(tables) => {
                let tables = Tables::new_checked(tables)?;
                ensure!(
                    with.feedback.is_none() || tables.understands(Setting::Feedback),
                    "the tables have no visual densities to re-estimate the mouth with: give the model that they were exported \
                     from, or export it with --visual-densities"
                );
                ensure!(
                    with.settle.is_none() || tables.understands(Setting::Settle),
                    NO_SETTLING
                );
                stream(&tables, samples, core_settings(with)?)
            }
            Self::Float(model) => {
                ensure!(
                    with.beam_bits.is_none(),
                    "the float engine has no beam: leave --beam out"
                );
                ensure!(
                    with.profile.is_none(),
                    "in floats a model with a lag has no profiles: give --lag instead of --profile"
                );
                ensure!(with.settle.is_none(), NO_SETTLING);
                let start_mean = std::array::from_fn(|i| model.start_mean[i]);
                let observations = reference::observations(samples, Normalisation::Causal { start_mean });
                let lag = with.lag.map_or(model.following.lag, usize::from);
                if let Some(exponent) = with.feedback {
                    return live_em(model, &observations, lag, exponent);
                }
                let (parameters, visemes) = convert(model, &observations, Lag::Frames(lag))?;
                Ok(Converted { parameters, visemes })
            }
            Self::Mge(model) => {
                ensure!(
                    with.beam_bits.is_none() && with.lag.is_none() && with.feedback.is_none(),
                    "a model trained on the error of its mouth has neither beam, lag nor EM in floats: leave --beam, --lag and \
                     --feedback out"
                );
                let start_mean = std::array::from_fn(|i| model.twin.start_mean[i]);
                let observations = reference::observations(samples, Normalisation::Causal { start_mean });
                let own = model.parameters.shape.context.look_ahead();
                let ahead = with.profile.and_then(|p| StreamSettings::of(p).look_ahead);
                let mut said =
                    live::convert_within(model, observations.view(), ahead.map_or(own, usize::from));
                if with.settle.unwrap_or(true) {
                    settle(&mut said.parameters, &model.deviation);
                }
                Ok(Converted {
                    parameters: said.parameters,
                    visemes: said.visemes,
                })
            }
        }
    }
}

/// The paper's EM inside a window of `lag` frames, in floats.
fn live_em(model: &Model, observations: &Array2<f32>, lag: usize, exponent: f64) -> Result<Converted> {
    let hmm = Hmm::of_model(model);
    let settings = EmSettings {
        acoustic_scale: model.following.acoustic_scale,
        visual_exponent: exponent as f32,
        ..EmSettings::default()
    };
    let said = Inverter::new(hmm).convert_live(observations, &settings, lag)?;
    let (_, visual) = Follower::of_model(model).occupancies(observations, Lag::Frames(lag))?;
    Ok(Converted {
        parameters: smooth(&said),
        visemes: viseme_weights(model, &visual),
    })
}

/// Settings for the core, refused in words where it would hold them to its limits.
pub fn core_settings(with: &RunSettings) -> Result<StreamSettings> {
    if let Some(lag) = with.lag {
        ensure!(
            usize::from(lag) < FRAMES,
            "a lag of {lag} hops is too long: the device has room for {}",
            FRAMES - 1
        );
    }
    let beam = with.beam_bits.map(|bits| {
        let q12 = bits * f64::from(1 << FRACTION_BITS);
        ensure!(
            q12 >= 1.0 && q12 <= f64::from(MAX_BEAM),
            "a beam of {bits} bits is out of range"
        );
        Ok(LogProb::from_q12(q12 as i32))
    });
    let feedback = with.feedback.map(|exponent| {
        let q16 = exponent * 65536.0;
        ensure!(
            (0.0..=f64::from(MAX_ACOUSTIC_SCALE)).contains(&q16),
            "an exponent of {exponent} is out of range: 0 to 4"
        );
        Ok(q16.round() as u32)
    });
    let own = with.profile.map_or(StreamSettings::default(), StreamSettings::of);
    Ok(StreamSettings {
        feedback: feedback.transpose()?,
        lag: with.lag.or(own.lag),
        beam: beam.transpose()?,
        settle: with.settle,
        ..own
    })
}

/// A whole sound through the device's own stream.
pub fn stream(tables: &Tables, samples: &[i16], settings: StreamSettings) -> Result<Converted> {
    let mut stream = AnyStream::new(tables, settings);
    let mut rest = samples;
    let frames = std::iter::from_fn(|| {
        while !rest.is_empty() {
            let (consumed, frame) = stream.push(rest);
            rest = &rest[consumed..];
            if frame.is_some() {
                return frame;
            }
        }
        stream.finish()
    });
    converted(tables, frames)
}

/// What the frames of a stream of these tables say, in real units.
pub fn converted(tables: &Tables, frames: impl IntoIterator<Item = ParameterFrame>) -> Result<Converted> {
    let scales: Vec<f32> = tables.head().parameter_scales().collect();
    let mut parameters = Array2::zeros((0, scales.len()));
    let mut visemes = Array2::zeros((0, tables.n_visemes()));
    for frame in frames {
        let values = frame.values.iter().zip(&scales);
        let row: ndarray::Array1<f32> = values.map(|(v, scale)| f32::from(*v) * scale).collect();
        parameters.push(Axis(0), row.view())?;
        let weights = frame.viseme_weights.iter().map(|w| f32::from(*w) / 255.0);
        visemes.push(Axis(0), weights.collect::<ndarray::Array1<f32>>().view())?;
    }
    Ok(Converted { parameters, visemes })
}
