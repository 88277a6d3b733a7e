//! `lipstream export`: a float model to the device's tables.
use std::path::PathBuf;

use anyhow::{Result, bail};

use crate::export::{DEFAULT_BEAM_BITS, ExportSettings, export};
use crate::files;
use crate::model::Model;

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
    /// Width of the beam in bits
    #[arg(long, default_value_t = DEFAULT_BEAM_BITS)]
    beam: f64,
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
    let model = Model::read(&args.model)?;
    let own = ExportSettings::of(&model);
    let settings = ExportSettings {
        lag: args.lag.unwrap_or(own.lag),
        beam_bits: args.beam,
        acoustic_scale: args.acoustic_scale.unwrap_or(own.acoustic_scale),
        average: !args.no_average,
    };
    let exported = export(&model, &settings)?;
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
