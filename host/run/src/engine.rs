//! Sound to mouth parameters: `fixed` is the very code of the device, `float` the offline arithmetic that it stands for.
use std::borrow::Cow;
use std::path::Path;

use lipstream_core::hmm::search::MAX_BEAM;
use lipstream_core::kinds::likelihood::FRAMES;
use lipstream_core::kinds::likelihood::tables::MAX_ACOUSTIC_SCALE;
use lipstream_core::logmath::{FRACTION_BITS, LogProb};
use lipstream_core::model::ModelError;
use lipstream_core::model::container::MAGIC;
use lipstream_core::settings::Setting;
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel as Tables, AnyStream, ParameterFrame, StreamSettings};
use lipstream_media::files;
use ndarray::{Array2, ArrayView1, Axis};

use crate::error::{Context as _, Error, Result, bail};
use crate::export::{ExportError, ExportSettings, MgeSettings, export, export_mge};
use crate::hmm::Hmm;
use crate::hmm::system::Speech;
use crate::kinds::hierarchical::HierarchicalModel;
use crate::kinds::likelihood::convert::{Follower, Lag, convert_as, smooth, viseme_weights};
use crate::kinds::likelihood::inversion::Inverter;
use crate::kinds::likelihood::live::Live as LocalLinear;
use crate::kinds::likelihood::{EmSettings, Model, NotFinite};
use crate::kinds::recurrent::live::Live;
use crate::kinds::recurrent::model::RecurrentModel;
use crate::opening::OpeningReader;
use crate::phones::VISEMES;
use crate::reference::Normalisation;
use crate::reference::observer::Observer;
use crate::session::{Frame, Running, Session, Whole};
use crate::tensors::Tensors;

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
    /// Hops that an occupancy waits for.
    pub lag: Option<u16>,
    /// Width of the beam in bits; `fixed` only.
    pub beam_bits: Option<f64>,
    /// The mouth by EM inside the lag window, with this exponent on its likelihood; the maps' where none is given.
    pub feedback: Option<f64>,
    /// How the mouth is found from the states, in place of the model's own way; likelihood-trained models in floats only.
    pub speech: Option<Speech>,
    /// How much of the future may be waited for; all that the model can use where none is given.
    pub profile: Option<Profile>,
    /// Whether a mouth that hardly moves is followed slowly; recurrent models only.
    pub settle: Option<bool>,
}

/// A setting that the engine or the model does not have, or that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SettingError {
    /// `settle` is for recurrent models only.
    #[error("only models trained on the error of their mouth settle it")]
    Settle,
    /// `feedback` needs tables with visual densities.
    #[error("the tables have no visual densities to re-estimate the mouth with")]
    Feedback,
    /// `beam_bits` is for the fixed engine only.
    #[error("the float engine has no beam")]
    FloatBeam,
    /// `profile` does not go with a float model that has a lag.
    #[error("in floats a model with a lag has no profiles")]
    FloatProfile,
    /// `speech` is for likelihood-trained models in floats only.
    #[error("only a likelihood-trained model in floats finds the mouth in another way than its own")]
    Speech,
    /// `speech` and `feedback` exclude each other.
    #[error("EM inside the lag window is a way of its own to find the mouth")]
    SpeechFeedback,
    /// A recurrent model in floats takes neither `beam_bits`, `lag` nor `feedback`.
    #[error("a model trained on the error of its mouth has neither beam, lag nor EM in floats")]
    FloatRecurrent,
    /// The lag is too long.
    #[error("a lag of {lag} hops is too long: the device has room for {most}")]
    Lag {
        /// The lag that was asked for, in hops.
        lag: u16,
        /// The longest lag, in hops.
        most: usize,
    },
    /// The beam's width is out of range.
    #[error("a beam of {bits} bits is out of range")]
    Beam {
        /// The width that was asked for.
        bits: f64,
    },
    /// The exponent of the mouth's likelihood is out of range.
    #[error("an exponent of {exponent} is out of range: 0 to 4")]
    Exponent {
        /// The exponent that was asked for.
        exponent: f64,
    },
}

/// A float model of whichever kind.
pub enum FloatModel {
    /// Trained by likelihood.
    Likelihood(Box<Model>),
    /// Trained on the error of its mouth.
    Recurrent(Box<RecurrentModel>),
}

impl FloatModel {
    /// Reads a model file, once; its note `kind` says what it holds.
    ///
    /// # Errors
    ///
    /// That it cannot be read, holds no model or a damaged one.
    pub fn read(path: &Path) -> Result<Self> {
        let tensors = Tensors::read(path)?;
        Self::of_tensors(&tensors).with_context(|| format!("{} is no usable model", path.display()))
    }

    /// The model in a file that has been read.
    ///
    /// # Errors
    ///
    /// That it holds no model or a damaged one.
    pub fn of_tensors(tensors: &Tensors) -> Result<Self> {
        if HierarchicalModel::is_kind(tensors) {
            bail!(
                Choice,
                "it is a hierarchical model, which `render` draws, `evaluate` measures and `export` writes tables of: give those, or a model of another system"
            );
        }
        Ok(match RecurrentModel::is_kind(tensors) {
            true => Self::Recurrent(Box::new(RecurrentModel::from_tensors(tensors)?)),
            false => Self::Likelihood(Box::new(Model::of_tensors(tensors)?)),
        })
    }

    /// Its tables for the device; of a likelihood-trained model with its visual densities if asked for.
    ///
    /// # Errors
    ///
    /// As [`export`] and [`export_mge`].
    pub fn export(&self, visual_densities: bool) -> Result<Vec<u8>, ExportError> {
        Ok(match self {
            Self::Recurrent(model) => export_mge(model, &MgeSettings::default())?.bytes,
            Self::Likelihood(model) => {
                let with = ExportSettings {
                    visual_densities,
                    ..ExportSettings::of(model)
                };
                export(model, &with)?.bytes
            }
        })
    }
}

self_cell::self_cell!(
    /// Tables that have been checked, and the view of them.
    struct Checked {
        owner: Cow<'static, [u8]>,
        #[covariant]
        dependent: Tables,
    }
);

/// A model made ready to run.
pub struct Engine(Ready);

enum Ready {
    Fixed(Checked),
    Float(FloatModel),
}

impl From<FloatModel> for Engine {
    fn from(model: FloatModel) -> Self {
        Self(Ready::Float(model))
    }
}

/// What a sound became: one row a frame, 100 a second.
#[derive(Clone, Debug)]
pub struct Converted {
    /// `[frames, D]`, in the units of the visual features.
    pub parameters: Array2<f32>,
    /// Occupancy of each viseme, `[frames, 13]`.
    pub visemes: Array2<f32>,
}

impl Converted {
    /// The lip gap of every frame, as `reader` reads it.
    pub fn gaps(&self, reader: &OpeningReader) -> Vec<f32> {
        let gap = |row: ArrayView1<f32>| reader.read(&row.to_vec()).gap;
        self.parameters.outer_iter().map(gap).collect()
    }
}

impl Engine {
    /// Reads tables or a float model. The fixed engine quantises a float model first; the float engine needs one.
    ///
    /// # Errors
    ///
    /// [`Error::NoFloats`] for the float engine on tables, [`Error::Export`] for the fixed engine on a model that the device cannot
    /// run; that the file cannot be read, or holds neither tables nor a model.
    pub fn open(path: &Path, kind: Kind) -> Result<Self> {
        Self::open_with(path, kind, false)
    }

    /// [`Engine::open`]; whether a float model is quantised with its visual densities, which [`RunSettings::feedback`] needs.
    ///
    /// # Errors
    ///
    /// As [`Engine::open`].
    pub fn open_with(path: &Path, kind: Kind, visual_densities: bool) -> Result<Self> {
        let bytes = files::read_bytes(path)?;
        if bytes.starts_with(&MAGIC) {
            if kind == Kind::Float {
                return Err(Error::NoFloats(path.to_owned()));
            }
            return Self::fixed(bytes).with_context(|| format!("{} cannot be used", path.display()));
        }
        let model = FloatModel::read(path)?;
        match kind {
            Kind::Fixed => Ok(Self::fixed(model.export(visual_densities)?)?),
            Kind::Float => Ok(model.into()),
        }
    }

    /// [`Engine::open_with`] on the file that is named, or else on the shipped model.
    ///
    /// # Errors
    ///
    /// As [`Engine::open`].
    pub fn open_or_shipped(path: Option<&Path>, kind: Kind, visual_densities: bool) -> Result<Self> {
        if let Some(path) = path {
            return Self::open_with(path, kind, visual_densities);
        }
        if kind == Kind::Fixed && !visual_densities {
            return Ok(Self::shipped());
        }
        let model = FloatModel::of_tensors(&Tensors::read_or_shipped(None)?)?;
        match kind {
            Kind::Fixed => Ok(Self::fixed(model.export(visual_densities)?)?),
            Kind::Float => Ok(model.into()),
        }
    }

    /// The fixed engine on tables in memory.
    ///
    /// # Errors
    ///
    /// [`ModelError`]: they are no tables, or damaged.
    pub fn fixed(tables: impl Into<Cow<'static, [u8]>>) -> Result<Self, ModelError> {
        let checked = Checked::try_new(tables.into(), |bytes| Tables::new_checked(bytes))?;
        Ok(Self(Ready::Fixed(checked)))
    }

    /// The fixed engine on the shipped model.
    pub fn shipped() -> Self {
        Self::fixed(crate::shipped::TABLES).expect("the shipped tables are a model")
    }

    /// A session of its own for one stream of speech.
    ///
    /// # Errors
    ///
    /// [`SettingError`] names the setting that this engine or model does not have.
    pub fn session(&self, with: &RunSettings) -> Result<Session<'_>, SettingError> {
        let running = match &self.0 {
            Ready::Fixed(tables) => {
                let tables = tables.borrow_dependent();
                refuse(with.speech.is_some(), SettingError::Speech)?;
                refuse(
                    with.feedback.is_some() && !tables.understands(Setting::Feedback),
                    SettingError::Feedback,
                )?;
                refuse(
                    with.settle.is_some() && !tables.understands(Setting::Settle),
                    SettingError::Settle,
                )?;
                Running::Fixed {
                    stream: Box::new(AnyStream::new(tables, core_settings(with)?)),
                    scales: tables.head().parameter_scales().collect(),
                }
            }
            Ready::Float(FloatModel::Likelihood(model)) => follow(model, with)?,
            Ready::Float(FloatModel::Recurrent(model)) => {
                let other = with.beam_bits.is_some() || with.lag.is_some() || with.feedback.is_some();
                refuse(other, SettingError::FloatRecurrent)?;
                refuse(with.speech.is_some(), SettingError::Speech)?;
                let own = model.parameters.shape.context.look_ahead();
                let ahead = with.profile.and_then(|p| StreamSettings::of(p).look_ahead);
                Running::Recurrent {
                    observer: observer(&model.parent),
                    live: Box::new(Live::new(model, ahead.map_or(own, usize::from))),
                    settle: with.settle.unwrap_or(true).then_some(&model.deviation[..]),
                    before: Vec::new(),
                }
            }
        };
        Ok(Session::new(running))
    }

    /// Converts a whole sound, 16 kHz mono.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] as [`Engine::session`], [`Error::NotFinite`] as [`Session::push`].
    pub fn convert(&self, samples: &[i16], with: &RunSettings) -> Result<Converted> {
        let mut session = self.session(with)?;
        let (mut parameters, mut visemes) = (Rows::default(), Rows::default());
        let mut take = |frame: Frame| {
            parameters.push(frame.parameters);
            visemes.push(frame.visemes);
        };
        session.push(samples, &mut take)?;
        session.finish(&mut take)?;
        Ok(Converted {
            parameters: parameters.array(self.n_parameters()),
            visemes: visemes.array(VISEMES.len()),
        })
    }

    /// The device's tables that the fixed engine runs.
    pub fn tables(&self) -> Option<&Tables<'_>> {
        match &self.0 {
            Ready::Fixed(tables) => Some(tables.borrow_dependent()),
            Ready::Float(_) => None,
        }
    }

    /// The id of the device's tables that the fixed engine runs, by which frames name their model.
    pub fn model_id(&self) -> Option<u32> {
        self.tables().map(|tables| tables.head().id())
    }

    /// Parameters of a frame.
    pub fn n_parameters(&self) -> usize {
        match &self.0 {
            Ready::Fixed(tables) => tables.borrow_dependent().head().parameter_scales().len(),
            Ready::Float(FloatModel::Likelihood(model)) => model.visual_size(),
            Ready::Float(FloatModel::Recurrent(model)) => model.parameters.shape.outputs,
        }
    }
}

/// Rows of an array that grows.
#[derive(Default)]
struct Rows {
    values: Vec<f32>,
    rows: usize,
}

impl Rows {
    fn push(&mut self, row: &[f32]) {
        self.values.extend(row);
        self.rows += 1;
    }

    /// The array; `columns` is its width where there is no row.
    fn array(self, columns: usize) -> Array2<f32> {
        let columns = self.values.len().checked_div(self.rows).unwrap_or(columns);
        Array2::from_shape_vec((self.rows, columns), self.values).expect("rows of one width")
    }
}

fn refuse(so: bool, error: SettingError) -> Result<(), SettingError> {
    if so { Err(error) } else { Ok(()) }
}

fn observer(model: &Model) -> Observer {
    let start_mean = std::array::from_fn(|i| model.start_mean[i]);
    Observer::new(Normalisation::Causal { start_mean })
}

/// A likelihood-trained model in floats.
fn follow<'m>(model: &'m Model, with: &RunSettings) -> Result<Running<'m>, SettingError> {
    refuse(with.beam_bits.is_some(), SettingError::FloatBeam)?;
    refuse(with.profile.is_some(), SettingError::FloatProfile)?;
    refuse(with.settle.is_some(), SettingError::Settle)?;
    let observer = observer(model);
    let lag = with.lag.map_or(model.following.lag, usize::from);
    refuse(
        with.speech.is_some() && with.feedback.is_some(),
        SettingError::SpeechFeedback,
    )?;
    let speech = with.speech.unwrap_or(model.system.speech);
    let convert: Whole<'m> = match (with.feedback, speech) {
        (None, Speech::LocalLinear) => {
            return Ok(Running::LocalLinear {
                observer,
                live: Box::new(LocalLinear::new(model, lag)),
            });
        }
        (None, speech) => Box::new(move |heard| {
            let (parameters, visemes) = convert_as(model, speech, heard, Lag::Frames(lag))?;
            Ok(Converted { parameters, visemes })
        }),
        (Some(exponent), _) => Box::new(move |heard| live_em(model, heard, lag, exponent)),
    };
    Ok(Running::Whole {
        observer,
        heard: Vec::new(),
        convert,
    })
}

/// The paper's EM inside a window of `lag` frames, in floats.
fn live_em(
    model: &Model,
    observations: &Array2<f32>,
    lag: usize,
    exponent: f64,
) -> Result<Converted, NotFinite> {
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

/// Settings for the core, refused where it would hold them to its limits.
///
/// # Errors
///
/// [`SettingError`] names the setting that is out of its range.
pub fn core_settings(with: &RunSettings) -> Result<StreamSettings, SettingError> {
    if let Some(lag) = with.lag {
        let most = FRAMES - 1;
        refuse(usize::from(lag) > most, SettingError::Lag { lag, most })?;
    }
    let beam = match with.beam_bits {
        None => None,
        Some(bits) => {
            let q12 = bits * f64::from(1 << FRACTION_BITS);
            let fits = q12 >= 1.0 && q12 <= f64::from(MAX_BEAM);
            refuse(!fits, SettingError::Beam { bits })?;
            Some(LogProb::from_q12(q12 as i32))
        }
    };
    let feedback = match with.feedback {
        None => None,
        Some(exponent) => {
            let q16 = exponent * 65536.0;
            let fits = (0.0..=f64::from(MAX_ACOUSTIC_SCALE)).contains(&q16);
            refuse(!fits, SettingError::Exponent { exponent })?;
            Some(q16.round() as u32)
        }
    };
    let own = with.profile.map_or(StreamSettings::default(), StreamSettings::of);
    Ok(StreamSettings {
        feedback,
        lag: with.lag.or(own.lag),
        beam,
        settle: with.settle,
        ..own
    })
}

/// A whole sound through the device's own stream.
///
/// # Errors
///
/// As [`converted`].
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
///
/// # Errors
///
/// Frames of other tables, which have another number of parameters or visemes.
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
