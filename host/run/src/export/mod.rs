//! The float model quantised into the device's tables, and how much was lost on the way.
//!
//! The layout of the tables and the writers of their sections are the core's ([`lipstream_core::model`]); equal models give equal
//! bytes. `tables.rs` has what every model has, `local_linear.rs`, `mge.rs` and `hierarchical.rs` what their kind needs.
pub mod budget;
mod hierarchical;
mod local_linear;
mod mge;
mod tables;

use lipstream_core::kinds::{Kind, Likelihood};
use lipstream_core::model::ModelError;
use serde::Serialize;

use crate::kinds::likelihood::Model;
pub use hierarchical::export as export_hierarchical;
pub use mge::{ExportSettings as MgeSettings, export as export_mge};

/// Why the device cannot run a model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The device speaks by local linear maps only, and this system speaks in another way: train a model of another system.
    #[error("the device cannot run a model of system {0}")]
    System(&'static str),
    /// The model hears its own memory, which the device does not feed back: train one that hears its mouth, or nothing.
    #[error("the device feeds back the mouth, not the memory")]
    MemoryFeedback,
    /// A hierarchical model that hears the paper's windows: train one that hears the device's front end.
    #[error("the model hears windows of 40 ms, which the device has none of: train it with --for-device")]
    Hearing,
    /// The model has more of something than the device has room for: train a smaller one.
    #[error("{0}")]
    Size(String),
    /// A setting is out of its range: choose another value.
    #[error("{0}")]
    Setting(String),
    /// A number of the model is outside what the tables can hold, or missing: the model is unusual or damaged.
    #[error("{0}")]
    Number(String),
    /// The tables that were made are refused by the device's own reader.
    #[error(transparent)]
    Tables(#[from] ModelError),
}

/// What everything here that can fail returns.
type Result<T, E = ExportError> = std::result::Result<T, E>;

/// Run-time settings that go into the tables.
#[derive(Clone, Copy, Debug)]
pub struct ExportSettings {
    /// Hops of fixed-lag smoothing.
    pub lag: u16,
    /// Beam width in bits.
    pub beam_bits: f64,
    /// Exponent on the audio likelihood.
    pub acoustic_scale: f64,
    /// Three-frame moving average (X&L section 6).
    pub average: bool,
    /// Whether the visual densities go in too, so that streams can re-estimate the mouth by EM.
    pub visual_densities: bool,
}

/// Width of the beam where nobody says otherwise, bits. On 400 training clips of GRID talker 1, 16 bits lose the thread now and
/// then and cost 2.6 % AMSE against no beam, 20 bits 0.3 %, 24 bits 0.2 %.
pub const DEFAULT_BEAM_BITS: f64 = 24.0;

impl ExportSettings {
    /// What the model asks for.
    pub fn of(model: &Model) -> Self {
        Self {
            lag: u16::try_from(model.following.lag).unwrap_or(u16::MAX),
            beam_bits: DEFAULT_BEAM_BITS,
            acoustic_scale: f64::from(model.following.acoustic_scale),
            average: true,
            visual_densities: false,
        }
    }
}

/// Tables and what quantising cost.
pub struct Export {
    /// The device's tables: a whole file.
    pub bytes: Vec<u8>,
    /// What became of each section.
    pub report: Vec<SectionReport>,
}

/// Size and error of one section.
#[derive(Clone, Debug, Serialize)]
pub struct SectionReport {
    /// The section's name.
    pub section: String,
    /// Size in bytes.
    pub bytes: usize,
    /// None for sections that are exact.
    pub error: Option<ErrorReport>,
}

/// Quantisation error of one section.
#[derive(Clone, Debug, Serialize)]
pub struct ErrorReport {
    /// What the two numbers are measured in.
    pub unit: &'static str,
    /// Largest error.
    pub max: f64,
    /// Root mean square of the errors.
    pub rms: f64,
    /// Numbers that were outside the range and have been held to it.
    pub clipped: usize,
}

/// Quantises `model`.
///
/// # Errors
///
/// [`ExportError`]: its system, its size or a number in it is none that the device takes, or a setting is out of its range.
pub fn export(model: &Model, with: &ExportSettings) -> Result<Export> {
    if !model.system.is_live() {
        return Err(ExportError::System(model.system.name));
    }
    let mut tables = local_linear::begin(model)?;
    tables.put_phones(&model.phones)?;
    tables.put_start_mean(&model.start_mean);
    let distance_gain = tables.put_audio_densities(&model.audio)?;
    let visual_distance_gain = match with.visual_densities {
        true => tables.put_visual_densities(model)?,
        false => 0,
    };
    tables.put_likelihood_settings(with, distance_gain, visual_distance_gain)?;
    tables.put_transitions(
        &model.phones,
        &model.transition,
        &model.bigram,
        &model.initial.to_vec(),
    )?;
    tables.put_projection(model)?;
    tables.put_maps(model)?;
    tables.finish(<Likelihood as Kind>::TAG)
}
