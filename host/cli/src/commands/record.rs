//! `lipstream record`: a live stream to a file.
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use lipstream::engine::Engine;
use lipstream_live::clock::Clock;
use lipstream_live::desk::Tape;
use lipstream_live::driver::Driver;
use lipstream_live::event::{Event, Health};
use lipstream_live::hub::{Hub, Missed};
use lipstream_live::recording::Recorder;
use serde_json::json;

use super::answer::{self, Answer};
use super::sources::{self, SourceArgs};

/// Record a live stream to a file, without a page
///
/// Ends with the source, after --seconds, or with Ctrl-C. `render`, `convert` and `view` read the file.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: SourceArgs,
    /// Where to; the sound, where there is any, goes to a .wav beside it
    #[arg(short, long, value_name = "FILE.stream")]
    output: PathBuf,
    /// End after so many seconds
    #[arg(long)]
    seconds: Option<f64>,
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    if args.seconds.is_some_and(|s| !(s > 0.0 && s < 1e7)) {
        bail!("--seconds {}: more than 0", args.seconds.unwrap_or_default());
    }
    let interrupted = sources::interrupted()?;
    let clock = Clock::start();
    let hub = Arc::new(Hub::default());
    let model = args.source.model()?;
    let mouths = model.mouths(&Engine::shipped())?;
    let Some(setup) = args.source.setup(&model, &mouths, &hub, clock)? else {
        bail!("no device is attached: name a source, or give --wav SOUND");
    };
    sources::print_notices(&hub);
    args.source.start_outputs(&hub)?;
    let recorder = Recorder::create(&args.output)?;
    let (_, mut events) = hub.watch();
    let tape = Tape::begin(&hub, args.output.display().to_string(), recorder);
    let driver = Driver::start(setup);
    let until = args.seconds.map(|s| Instant::now() + Duration::from_secs_f64(s));
    let mut health = Health::default();
    let mut why = None;
    while !interrupted.load(Ordering::Relaxed) && until.is_none_or(|until| Instant::now() < until) {
        match events.now() {
            Ok(Some(Event::End(text))) => {
                why = Some(text);
                break;
            }
            Ok(Some(Event::Status(now))) => health = now,
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            Ok(Some(_)) | Err(Missed::Slow(_)) => {}
            Err(Missed::Over) => break,
        }
    }
    drop(driver);
    let frames = match why {
        Some(_) => tape.wait()?,
        None => tape.end()?,
    };
    if frames == 0 {
        bail!("{}: no frame came", args.output.display());
    }
    let lost = health.losses;
    let line = match args.answer.json {
        true => {
            let (output, lost) = (answer::path(&args.output), health.losses);
            json!({ "output": output, "frames": frames, "lost": lost.frames, "damaged": lost.damaged })
                .to_string()
        }
        false => format!(
            "{}: {frames} frames, {} lost, {} damaged",
            args.output.display(),
            lost.frames,
            lost.damaged
        ),
    };
    match args.source.takes_standard_output() {
        true => eprintln!("{line}"),
        false => println!("{line}"),
    }
    Ok(())
}
