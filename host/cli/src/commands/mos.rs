//! `lipstream mos`: what people think of mouths.
use std::path::PathBuf;

use anyhow::{Result, bail};

use super::answer::{Answer, Done, path};
use super::streams::ending;
use lipstream_make::mos::{self, Key, Made, Results, Settings};
use lipstream_media::files;
use serde_json::json;

/// Ask people how good mouths are: a page with blinded clips, and tables of mean opinion scores
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    Make(Make),
    Tables(Tables),
}

/// Make the page that viewers open, and beside it its key, which they must not see
#[derive(Debug, clap::Args)]
struct Make {
    /// Folder with one folder of .mp4 files for each system, `recording` among them; the same names in each
    folder: PathBuf,
    /// Page to write; its key gets the same name with the ending .key.json
    #[arg(short, long, value_name = "PAGE.html")]
    output: PathBuf,
    /// Heading of the page and of its table
    #[arg(long, default_value = "How does this mouth speak?")]
    title: String,
    #[command(flatten)]
    answer: Answer,
}

/// Turn viewers' answers into tables with intervals and a ranking
#[derive(Debug, clap::Args)]
struct Tables {
    /// Files that viewers' pages gave
    #[arg(required = true)]
    results: Vec<PathBuf>,
    /// Key of the page; may be given many times: one table for each
    #[arg(short, long, required = true, value_name = "PAGE.key.json")]
    key: Vec<PathBuf>,
    /// Report to write
    #[arg(short, long, value_name = "REPORT.md")]
    output: PathBuf,
    /// System that improvements are measured against [default: the first by name that is not `recording`]
    #[arg(long, value_name = "SYSTEM")]
    against: Option<String>,
    /// Resamples of the bootstrap
    #[arg(long, default_value_t = Settings::default().resamples, value_parser = resamples)]
    resamples: usize,
    /// Seed of the resamples
    #[arg(long, default_value_t = Settings::default().seed)]
    seed: u64,
    #[command(flatten)]
    answer: Answer,
}

fn resamples(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(n @ 100..=1_000_000) => Ok(n),
        _ => Err("choose 100 to 1000000".into()),
    }
}

pub(crate) fn run(args: Args) -> Result<()> {
    match args.what {
        What::Make(args) => make(&args),
        What::Tables(args) => tables(&args),
    }
}

fn make(args: &Make) -> Result<()> {
    if ending(&args.output) != "html" {
        bail!("{} is no page: name it .html", args.output.display());
    }
    let Made { html, key } = mos::make(&args.folder, &args.title)?;
    let beside = args.output.with_extension("key.json");
    let text = serde_json::to_string_pretty(&key)? + "\n";
    files::write_bytes(&beside, text.as_bytes())?;
    files::write_bytes(&args.output, html.as_bytes())?;
    let (clips, systems) = (key.names().len(), key.systems.len());
    let done = Done::new(
        format!(
            "{clips} clips of {systems} systems, {:.1} MB; the key, for you alone: {}",
            html.len() as f64 / 1e6,
            beside.display()
        ),
        json!({ "key": path(&beside), "clips": clips, "systems": systems }),
    );
    args.answer.tell(&args.output, &done);
    Ok(())
}

fn tables(args: &Tables) -> Result<()> {
    let keys: Vec<Key> = args
        .key
        .iter()
        .map(|path| Key::read(path))
        .collect::<Result<_, _>>()?;
    let mut results = Vec::new();
    for path in &args.results {
        results.push((path.display().to_string(), Results::read(path)?));
    }
    let settings = Settings {
        against: args.against.clone(),
        resamples: args.resamples,
        seed: args.seed,
    };
    let text = mos::tables(&keys, &results, &settings)?;
    files::write_bytes(&args.output, text.as_bytes())?;
    let done = Done::new(
        format!("{} files of answers", results.len()),
        json!({ "answers": results.len() }),
    );
    args.answer.tell(&args.output, &done);
    Ok(())
}
