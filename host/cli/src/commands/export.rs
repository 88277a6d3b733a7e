//! `lipstream export`: a float model to the device's tables.
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lipstream_core::{Likelihood, Model as Tables};

use lipstream::export::budget::{self, Budget, Candidate};
use lipstream::export::{
    Export, ExportError, ExportSettings, MgeSettings, export, export_hierarchical, export_mge,
};
use lipstream::kinds::hierarchical::HierarchicalModel;
use lipstream::kinds::likelihood::Model;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::shipped;
use lipstream::tensors::Tensors;
use lipstream_media::sound;

use super::streams::{is_standard, keep_apart, write};

/// Write the device's quantised tables
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Model that `lipstream train` wrote (.safetensors); of several the best that fits is written
    #[arg(required = true, value_name = "MODEL.safetensors")]
    models: Vec<PathBuf>,
    /// Tables to write; - is standard output, and what is said of them goes to standard error
    #[arg(short, long)]
    output: PathBuf,
    /// Hops that an occupancy waits for [default: the model's]
    #[arg(long)]
    lag: Option<u16>,
    /// Width of the beam in bits [default: 24; 11 for a model of `--train mge`]
    #[arg(long)]
    beam: Option<f64>,
    /// Exponent on the audio likelihood [default: the model's]
    #[arg(long)]
    acoustic_scale: Option<f64>,
    /// Leave out the average over three frames (10 ms less delay)
    #[arg(long)]
    no_average: bool,
    /// Write the visual densities too, so that a stream can re-estimate the mouth by EM (`convert --feedback`)
    #[arg(long)]
    visual_densities: bool,
    /// Leave out the second memory of a model that has one: fewer instructions and bytes, a mouth that is somewhat further from the true one
    #[arg(long)]
    one_memory: bool,
    /// Take tables of this many KiB at most
    #[arg(long, value_name = "KIB")]
    flash: Option<usize>,
    /// Take a model whose 10 ms hop costs this many instructions of a Cortex-M4 at most, on average over speech, with the
    /// widest beam of 7 to 14 bits that fits if it was trained with `--train mge`
    #[arg(long, value_name = "N")]
    cycles: Option<f64>,
    /// Print sizes and errors as JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<()> {
    keep_apart(&args.output, args.models.iter().map(PathBuf::as_path))?;
    let tell = |line: &str| match is_standard(&args.output) {
        true => eprintln!("{line}"),
        false => println!("{line}"),
    };
    let budget = Budget {
        bytes: args.flash.map(|kib| kib * 1024),
        instructions: args.cycles,
    };
    let (mut sources, candidates) = candidates(&args)?;
    let Some(chosen) = budget::choose(&candidates, &budget) else {
        let limits = [
            args.flash.map(|kib| format!("{kib} KiB")),
            args.cycles.map(|n| format!("{n} instructions a hop")),
        ];
        bail!(
            "no model fits {}; {}: train with fewer densities, inputs, numbers of memory or phones",
            limits.into_iter().flatten().collect::<Vec<_>>().join(" and "),
            candidates
                .iter()
                .map(|c| said(&args, c))
                .collect::<Vec<_>>()
                .join("; ")
        );
    };
    if candidates.len() > 1 && !args.json {
        for (n, candidate) in candidates.iter().enumerate() {
            let fate = match candidate.exceeds(&budget) {
                _ if n == chosen => "chosen",
                None => "fits",
                Some(what) => what,
            };
            tell(&format!("{}: {fate}", said(&args, candidate)));
        }
    }
    let chosen = &candidates[chosen];
    let exported = sources[chosen.model].tables(chosen.beam_bits)?;
    let size = exported.bytes.len();
    write(&args.output, |file| Ok(file.write_all(&exported.bytes)?))?;
    if args.json {
        let report = serde_json::json!({ "bytes": size, "sections": exported.report });
        tell(&report.to_string());
        return Ok(());
    }
    tell(&format!(
        "{:<20} {:>8}  {:>10} {:>10} {:>7}  unit",
        "section", "bytes", "max error", "rms error", "clipped"
    ));
    for section in &exported.report {
        match &section.error {
            Some(e) => tell(&format!(
                "{:<20} {:>8}  {:>10.2e} {:>10.2e} {:>7}  {}",
                section.section, section.bytes, e.max, e.rms, e.clipped, e.unit
            )),
            None => tell(&format!("{:<20} {:>8}", section.section, section.bytes)),
        }
    }
    tell(&format!(
        "{}: {size} bytes ({:.1} KiB)",
        args.output.display(),
        size as f64 / 1024.0
    ));
    Ok(())
}

/// A model and what its tables are made with, but for the beam.
enum Kind {
    Likelihood(Box<Model>, ExportSettings),
    Mge(Box<RecurrentModel>),
    Hierarchical(Box<HierarchicalModel>),
}

/// A model with its tables for the beam that was asked for, or its own.
struct Source {
    kind: Kind,
    beam_bits: f64,
    export: Export,
}

/// Beams that a budget of instructions may choose from, bits, for a model with a memory. What a narrower one costs a
/// likelihood-trained model goes with its acoustic scale: there it is not touched.
const BEAMS: [f64; 8] = [14.0, 13.0, 12.0, 11.0, 10.0, 9.0, 8.0, 7.0];

/// The beam of a model that follows nothing.
const NO_BEAM: f64 = 0.0;

impl Kind {
    fn read(path: &Path, args: &Args) -> Result<Self> {
        let tensors = Tensors::read(path)?;
        if HierarchicalModel::is_kind(&tensors) {
            let follows = args.lag.is_some() || args.beam.is_some() || args.acoustic_scale.is_some();
            if follows || args.no_average || args.visual_densities || args.one_memory {
                bail!(
                    "{} is a hierarchical model, which follows nothing: it has no lag, no beam, no acoustic scale, no average, no visual densities and no memory to set",
                    path.display()
                );
            }
            return Ok(Self::Hierarchical(Box::new(HierarchicalModel::read(path)?)));
        }
        if RecurrentModel::is_kind(&tensors) {
            if args.lag.is_some() || args.acoustic_scale.is_some() || args.no_average || args.visual_densities
            {
                bail!(
                    "{} was trained on the error of its mouth: it has no lag, no acoustic scale, no average and no visual densities to set",
                    path.display()
                );
            }
            let mut model = RecurrentModel::read(path)?;
            if args.one_memory && model.gated.take().is_none() {
                bail!("{} has no second memory to leave out", path.display());
            }
            return Ok(Self::Mge(Box::new(model)));
        }
        if args.one_memory {
            bail!("{} was trained by likelihood: it has no memory", path.display());
        }
        let model = Model::read(path)?;
        let own = ExportSettings::of(&model);
        let settings = ExportSettings {
            lag: args.lag.unwrap_or(own.lag),
            acoustic_scale: args.acoustic_scale.unwrap_or(own.acoustic_scale),
            average: !args.no_average,
            visual_densities: args.visual_densities,
            ..own
        };
        Ok(Self::Likelihood(Box::new(model), settings))
    }

    fn own_beam_bits(&self) -> f64 {
        match self {
            Self::Likelihood(_, settings) => settings.beam_bits,
            Self::Mge(_) => MgeSettings::default().beam_bits,
            Self::Hierarchical(_) => NO_BEAM,
        }
    }

    fn export(&self, beam_bits: f64) -> Result<Export, ExportError> {
        match self {
            Self::Likelihood(model, settings) => export(
                model,
                &ExportSettings {
                    beam_bits,
                    ..*settings
                },
            ),
            Self::Mge(model) => export_mge(model, &MgeSettings { beam_bits }),
            Self::Hierarchical(model) => export_hierarchical(model),
        }
    }
}

impl Source {
    fn read(path: &Path, args: &Args) -> Result<Self> {
        let kind = Kind::read(path, args)?;
        let beam_bits = args.beam.unwrap_or(kind.own_beam_bits());
        let export = kind.export(beam_bits)?;
        Ok(Self {
            kind,
            beam_bits,
            export,
        })
    }

    /// Every beam that is in question.
    fn candidates(&self, n: usize, args: &Args) -> Result<Vec<Candidate>> {
        let candidate = |beam_bits: f64, instructions: f64, validation: Option<f64>| Candidate {
            model: n,
            beam_bits,
            bytes: self.export.bytes.len(),
            instructions,
            validation,
        };
        Ok(match &self.kind {
            Kind::Likelihood(..) => {
                let tables = Tables::<Likelihood>::new_checked(&self.export.bytes)?;
                let active = budget::mean_active(&tables, &sound::decode(shipped::SOUND)?.samples);
                let instructions = budget::instructions_by_likelihood(&tables, active);
                vec![candidate(self.beam_bits, instructions, None)]
            }
            Kind::Hierarchical(model) => {
                vec![candidate(NO_BEAM, budget::instructions_of_pictures(model), None)]
            }
            Kind::Mge(model) => {
                let beams = match (args.beam, args.cycles) {
                    (None, Some(_)) => &BEAMS[..],
                    _ => &[self.beam_bits],
                };
                let cost =
                    |beam: &f64| candidate(*beam, budget::instructions(model, *beam), model.validation_amse);
                beams.iter().map(cost).collect()
            }
        })
    }

    /// The tables for one of the beams.
    fn tables(&mut self, beam_bits: f64) -> Result<&Export> {
        if beam_bits != self.beam_bits {
            self.export = self.kind.export(beam_bits)?;
            self.beam_bits = beam_bits;
        }
        Ok(&self.export)
    }
}

fn candidates(args: &Args) -> Result<(Vec<Source>, Vec<Candidate>)> {
    let (mut sources, mut all) = (Vec::new(), Vec::new());
    for (n, path) in args.models.iter().enumerate() {
        let source = Source::read(path, args)?;
        all.extend(source.candidates(n, args)?);
        sources.push(source);
    }
    Ok((sources, all))
}

/// A candidate in words.
fn said(args: &Args, candidate: &Candidate) -> String {
    let error = match candidate.validation {
        Some(amse) => format!(", validation AMSE {amse:.0}"),
        None => String::new(),
    };
    let beam = match candidate.beam_bits {
        NO_BEAM => String::new(),
        bits => format!(", beam {bits} bits"),
    };
    format!(
        "{}{beam}: {:.1} KiB, about {:.0} k instructions a hop{error}",
        args.models[candidate.model].display(),
        candidate.bytes as f64 / 1024.0,
        candidate.instructions / 1000.0
    )
}
