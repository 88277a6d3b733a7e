//! `lipstream view`: the mouth in a browser, as it is spoken.
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context as _, Result};
use lipstream::engine::Engine;
use lipstream_live::address::Address;
use lipstream_live::clock::Clock;
use lipstream_live::desk::{Desk, Equipment, Tape};
use lipstream_live::driver::{Setup, Source};
use lipstream_live::face::Face;
use lipstream_live::hub::Hub;
use lipstream_live::recording::{Recorder, Recording};
use lipstream_live::serve::{Place, Server};
use serde_json::json;

use super::answer::Answer;
use super::faces::{FaceArgs, same_model};
use super::sources::{self, Model, SourceArgs};

/// Watch a mouth live in a browser
///
/// Takes a device on a serial line, the firmware in QEMU, a recording, or speech. With nothing attached the page offers a demo.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    face: FaceArgs,
    /// Record to this file from the beginning (and the sound to a .wav beside it)
    #[arg(long, value_name = "FILE.stream")]
    record: Option<PathBuf>,
    /// Folder for recordings that the page begins
    #[arg(long, value_name = "DIR", default_value = ".")]
    folder: PathBuf,
    /// Address to listen on; one that others reach wants the token in the address that is printed
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    host: IpAddr,
    /// Port of the page; 0 is any
    #[arg(long, default_value_t = 7341)]
    port: u16,
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let clock = Clock::start();
    let hub = Arc::new(Hub::default());
    let shipped = Arc::new(Engine::shipped());
    let model = args.source.model()?;
    let mouths = model.mouths(&shipped)?;
    let setup = args.source.setup(&model, &mouths, &hub, clock)?;
    let face = face(&args.face, &model, setup.as_ref(), &hub)?;
    // What has been begun is brought to its end; until now there was nothing to be lost.
    let interrupted = sources::interrupted()?;
    sources::print_notices(&hub);
    args.source.start_outputs(&hub)?;
    let tape = match &args.record {
        Some(path) => {
            let name = path.display().to_string();
            Some(Tape::begin(&hub, name, Recorder::create(path)?))
        }
        None => None,
    };
    let desk = Arc::new(Desk::new(
        Arc::clone(&hub),
        Equipment {
            clock,
            mouths,
            folder: args.folder,
            engine: shipped,
            face,
        },
    ));
    let place = Place {
        address: args.host,
        port: args.port,
    };
    let server = Server::start(Arc::clone(&desk), &place).with_context(|| {
        format!(
            "cannot serve a page on {}:{} (--port 0 takes any port that is free)",
            args.host, args.port
        )
    })?;
    let attached = setup.is_some();
    if let Some(setup) = setup {
        desk.attach(setup);
    }
    let lines = match (args.answer.json, attached) {
        (true, _) => json!({ "address": server.url(), "attached": attached }).to_string(),
        (false, true) => format!("open {} in a browser; Ctrl-C ends", server.url()),
        (false, false) => format!(
            "open {} in a browser; Ctrl-C ends\nno device is attached: the page offers a demo; name a source, or --wav SOUND",
            server.url()
        ),
    };
    match args.source.takes_standard_output() {
        true => eprintln!("{lines}"),
        false => println!("{lines}"),
    }
    while !interrupted.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(100));
    }
    drop(server);
    desk.record(false);
    if let Some(tape) = tape {
        let frames = tape.end()?;
        crate::progress::say(&format!("{frames} frames recorded"));
    }
    Ok(())
}

/// The face that the stream moves; None where no background is given.
fn face(args: &FaceArgs, model: &Model, setup: Option<&Setup>, hub: &Arc<Hub>) -> Result<Option<Face>> {
    if args.background.is_none() {
        return Ok(None);
    }
    let (id, space, path) = model.mouth()?;
    // Whose stream a device's is shows when it speaks; a recording can be asked now.
    if let Some(Setup {
        source: Source::Line(Address::Recording(recorded)),
        ..
    }) = setup
    {
        same_model(Recording::open(recorded)?.hello().model, id, path)?;
    }
    args.start(hub, id, space)
}
