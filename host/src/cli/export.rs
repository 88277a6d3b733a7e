//! `lipstream export`: a float model to the device's tables.
use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::export::{ExportSettings, MgeSettings, export, export_mge};
use crate::files;
use crate::mge::model::MgeModel;
use crate::model::Model;
use crate::tensors::Tensors;

/// Write the device's quantised tables
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Model that `lipstream train` wrote (.safetensors)
    model: PathBuf,
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
    /// Refuse tables larger than this many KiB
    #[arg(long, value_name = "KIB")]
    flash: Option<usize>,
    /// Print sizes and errors as JSON
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let exported = if MgeModel::is_kind(&Tensors::read(&args.model)?) {
        if args.lag.is_some() || args.acoustic_scale.is_some() || args.no_average {
            bail!(
                "{} was trained on the error of its mouth: it has no lag, no acoustic scale and no average to set",
                args.model.display()
            );
        }
        let own = MgeSettings::default();
        let settings = MgeSettings {
            beam_bits: args.beam.unwrap_or(own.beam_bits),
        };
        export_mge(&MgeModel::read(&args.model)?, &settings)?
    } else {
        let model = Model::read(&args.model)?;
        let own = ExportSettings::of(&model);
        let settings = ExportSettings {
            lag: args.lag.unwrap_or(own.lag),
            beam_bits: args.beam.unwrap_or(own.beam_bits),
            acoustic_scale: args.acoustic_scale.unwrap_or(own.acoustic_scale),
            average: !args.no_average,
        };
        export(&model, &settings)?
    };
    let size = exported.bytes.len();
    if let Some(flash) = args.flash
        && size > flash * 1024
    {
        bail!(
            "the tables take {:.1} KiB, more than {flash}: train with fewer densities, inputs or phones",
            size as f64 / 1024.0
        );
    }
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
