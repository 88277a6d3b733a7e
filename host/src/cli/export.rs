//! `lipstream export`: a float model to the device's tables.
use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::export::budget::{self, Budget, Candidate};
use crate::export::{Export, ExportSettings, MgeSettings, export, export_mge};
use crate::files;
use crate::mge::model::MgeModel;
use crate::model::Model;
use crate::tensors::Tensors;

/// Write the device's quantised tables
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Model that `lipstream train` wrote (.safetensors); of several the best that fits is written
    #[arg(required = true, value_name = "MODEL.safetensors")]
    models: Vec<PathBuf>,
    /// Tables to write
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
    /// Take tables of this many KiB at most
    #[arg(long, value_name = "KIB")]
    flash: Option<usize>,
    /// Take a model whose 10 ms hop costs this many instructions of a Cortex-M4 at most, on average over speech; its beam is
    /// narrowed to fit
    #[arg(long, value_name = "N")]
    cycles: Option<f64>,
    /// Print sizes and errors as JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let budget = Budget {
        bytes: args.flash.map(|kib| kib * 1024),
        instructions: args.cycles,
    };
    let (exported, candidates) = candidates(&args)?;
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
            let fate = match candidate.fits(&budget) {
                _ if n == chosen => "chosen",
                true => "fits",
                false => "too large",
            };
            println!("{}: {fate}", said(&args, candidate));
        }
    }
    let chosen = &candidates[chosen];
    let exported = match &exported[chosen.model] {
        Ready::AsIs(exported) => exported,
        Ready::Narrowed(_, exported, widest) if chosen.beam_bits == *widest => exported,
        Ready::Narrowed(model, ..) => &export_mge(
            model,
            &MgeSettings {
                beam_bits: chosen.beam_bits,
            },
        )?,
    };
    let size = exported.bytes.len();
    files::write_bytes(&args.output, &exported.bytes)?;
    if args.json {
        let report = serde_json::json!({ "bytes": size, "sections": exported.report });
        println!("{report}");
        return Ok(());
    }
    println!(
        "{:<20} {:>8}  {:>10} {:>10} {:>7}  unit",
        "section", "bytes", "max error", "rms error", "clipped"
    );
    for section in &exported.report {
        match &section.error {
            Some(e) => println!(
                "{:<20} {:>8}  {:>10.2e} {:>10.2e} {:>7}  {}",
                section.section, section.bytes, e.max, e.rms, e.clipped, e.unit
            ),
            None => println!("{:<20} {:>8}", section.section, section.bytes),
        }
    }
    println!(
        "{}: {size} bytes ({:.1} KiB)",
        args.output.display(),
        size as f64 / 1024.0
    );
    Ok(())
}

/// Tables with the only beam that is in question, or a model whose beam may be narrowed, with those of its widest.
enum Ready {
    AsIs(Export),
    Narrowed(Box<MgeModel>, Export, f64),
}

/// Beams that a budget of instructions may choose from, in bits below the widest.
const NARROWER: [f64; 5] = [0.0, 1.0, 2.0, 3.0, 4.0];

fn candidates(args: &Args) -> Result<(Vec<Ready>, Vec<Candidate>)> {
    let (mut ready, mut all) = (Vec::new(), Vec::new());
    for (n, path) in args.models.iter().enumerate() {
        if MgeModel::is_kind(&Tensors::read(path)?) {
            if args.lag.is_some() || args.acoustic_scale.is_some() || args.no_average || args.visual_densities
            {
                bail!(
                    "{} was trained on the error of its mouth: it has no lag, no acoustic scale, no average and no visual densities to set",
                    path.display()
                );
            }
            let model = MgeModel::read(path)?;
            let widest = args.beam.unwrap_or(MgeSettings::default().beam_bits);
            let exported = export_mge(&model, &MgeSettings { beam_bits: widest })?;
            let narrower = match (args.beam, args.cycles) {
                (None, Some(_)) => &NARROWER[..],
                _ => &NARROWER[..1],
            };
            all.extend(narrower.iter().map(|less| Candidate {
                model: n,
                beam_bits: widest - less,
                bytes: exported.bytes.len(),
                instructions: Some(budget::instructions(&model, widest - less)),
                validation: model.validation_amse,
            }));
            ready.push(Ready::Narrowed(Box::new(model), exported, widest));
        } else {
            let model = Model::read(path)?;
            let own = ExportSettings::of(&model);
            let settings = ExportSettings {
                lag: args.lag.unwrap_or(own.lag),
                beam_bits: args.beam.unwrap_or(own.beam_bits),
                acoustic_scale: args.acoustic_scale.unwrap_or(own.acoustic_scale),
                average: !args.no_average,
                visual_densities: args.visual_densities,
            };
            let exported = export(&model, &settings)?;
            all.push(Candidate {
                model: n,
                beam_bits: settings.beam_bits,
                bytes: exported.bytes.len(),
                instructions: None,
                validation: None,
            });
            ready.push(Ready::AsIs(exported));
        }
    }
    Ok((ready, all))
}

/// A candidate in words.
fn said(args: &Args, candidate: &Candidate) -> String {
    let work = match candidate.instructions {
        Some(n) => format!("about {:.0} k instructions a hop", n / 1000.0),
        None => "instructions unknown".to_owned(),
    };
    let error = match candidate.validation {
        Some(amse) => format!(", validation AMSE {amse:.0}"),
        None => String::new(),
    };
    format!(
        "{}, beam {} bits: {:.1} KiB, {work}{error}",
        args.models[candidate.model].display(),
        candidate.beam_bits,
        candidate.bytes as f64 / 1024.0
    )
}
