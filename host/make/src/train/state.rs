//! The state of EM between two passes, in a file of its own: what `lipstream train accumulate` reads and `merge` writes.
use std::path::Path;

use lipstream_core::model::container::checksum;

use crate::em::Parameters;
use crate::em::density::Floors;
use crate::error::{Context as _, Error, Result, bail};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::hmm::system::System;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream::tensors::{Tensors, TensorsBuilder};
use lipstream_media::files;

/// Version of the file.
const VERSION: u32 = 1;
/// What tells the file from models.
const KIND: &str = "em state";

/// Parameters, and what an M step needs beside sums.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Kind of model that is trained.
    pub system: System,
    /// What EM re-estimates, as the last pass left it.
    pub parameters: Parameters,
    /// Floors of the audio densities.
    pub audio_floors: Floors,
    /// Floors of the visual densities, if there are any.
    pub visual_floors: Option<Floors>,
    /// EM passes that led here.
    pub passes: usize,
}

/// Puts parameters among a file's tensors.
pub(super) fn put_parameters(out: &mut TensorsBuilder, parameters: &Parameters) {
    let names: Vec<&str> = parameters.phones.iter().map(|p| p.name()).collect();
    out.note("phones", names.join(" "));
    out.put("transition", &parameters.transition);
    let chains = [
        ("audio", Some(&parameters.audio)),
        ("visual", parameters.visual.as_ref()),
    ];
    for (name, mixtures) in chains {
        if let Some(mixtures) = mixtures {
            out.put(&format!("{name}.mean"), &mixtures.mean);
            out.put(&format!("{name}.variance"), &mixtures.variance);
            out.put(&format!("{name}.log_weight"), &mixtures.log_weight);
        }
    }
}

/// Reads what [`put_parameters`] put.
pub(super) fn take_parameters(from: &Tensors, topology: Topology) -> Result<Parameters> {
    let names: String = from.noted("phones").map_err(Error::other)?;
    let phones: Vec<Phone> = names
        .split_whitespace()
        .map(|name| Phone::from_name(name).ok_or_else(|| Error::File(format!("unknown phone {name:?}"))))
        .collect::<Result<_>>()?;
    let mixtures = |name: &str, states: usize| -> Result<Mixtures> {
        let mixtures = Mixtures {
            mean: from.array(&format!("{name}.mean")).map_err(Error::other)?,
            variance: from.array(&format!("{name}.variance")).map_err(Error::other)?,
            log_weight: from.array(&format!("{name}.log_weight")).map_err(Error::other)?,
        };
        let (s, k, d) = mixtures.mean.dim();
        let fits = s == states && mixtures.variance.dim() == (s, k, d) && mixtures.log_weight.dim() == (s, k);
        if !fits || k == 0 || d == 0 {
            bail!(File, "the shapes of the {name} mixtures do not agree");
        }
        if mixtures.variance.iter().any(|v| *v <= 0.0) {
            bail!(File, "the {name} mixtures hold a variance that is not positive");
        }
        Ok(mixtures)
    };
    let parameters = Parameters {
        topology,
        audio: mixtures("audio", phones.len() * N_EMITTING)?,
        visual: match from.has("visual.mean") {
            true => Some(mixtures("visual", topology.n_visual_states(phones.len()))?),
            false => None,
        },
        transition: from.array("transition").map_err(Error::other)?,
        phones,
    };
    if parameters.transition.dim() != (parameters.phones.len(), topology.classes_per_phone(), 4) {
        bail!(File, "the transitions do not fit the phones");
    }
    Ok(parameters)
}

impl State {
    /// Writes the file that [`State::read`] reads. An error when the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut out = TensorsBuilder::default();
        out.note("kind", KIND);
        out.note("version", VERSION);
        out.note("system", self.system.name);
        out.note("passes", self.passes);
        put_parameters(&mut out, &self.parameters);
        out.note("floors.audio.occupancy", self.audio_floors.occupancy);
        out.put("floors.audio.variance", &self.audio_floors.variance);
        if let Some(floors) = &self.visual_floors {
            out.note("floors.visual.occupancy", floors.occupancy);
            out.put("floors.visual.variance", &floors.variance);
        }
        out.write(path).map_err(Error::other)
    }

    /// The state, and the checksum by which sums name it.
    pub fn read(path: &Path) -> Result<(Self, u32)> {
        let bytes = files::read_bytes(path).map_err(Error::other)?;
        let tensors = Tensors::parse(&bytes, &path.display().to_string()).map_err(Error::other)?;
        let state = Self::from_tensors(&tensors)
            .with_context(|| format!("{} is no state of training", path.display()))?;
        Ok((state, checksum(&bytes)))
    }

    fn from_tensors(from: &Tensors) -> Result<Self> {
        let kind: String = from.noted("kind").map_err(Error::other)?;
        if kind != KIND {
            bail!(File, "it holds {kind:?}; `lipstream train start` makes a state");
        }
        let version: u32 = from.noted("version").map_err(Error::other)?;
        if version != VERSION {
            bail!(
                File,
                "version {version}, this program reads {VERSION}: start training again"
            );
        }
        let name: String = from.noted("system").map_err(Error::other)?;
        let system =
            System::from_name(&name).ok_or_else(|| Error::File(format!("unknown system {name:?}")))?;
        let parameters = take_parameters(from, system.topology)?;
        let floors = |name: &str, mixtures: &Mixtures| -> Result<Floors> {
            let floors = Floors {
                variance: from
                    .array(&format!("floors.{name}.variance"))
                    .map_err(Error::other)?,
                occupancy: from
                    .noted(&format!("floors.{name}.occupancy"))
                    .map_err(Error::other)?,
            };
            if floors.variance.len() != mixtures.mean.dim().2 {
                bail!(File, "the {name} floors do not fit the mixtures");
            }
            Ok(floors)
        };
        Ok(Self {
            system,
            audio_floors: floors("audio", &parameters.audio)?,
            visual_floors: match &parameters.visual {
                Some(visual) => Some(floors("visual", visual)?),
                None => None,
            },
            parameters,
            passes: from.noted("passes").map_err(Error::other)?,
        })
    }
}
