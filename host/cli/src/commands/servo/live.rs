//! Servos behind a source that speaks in its own time.
//!
//! Pulses leave every 10 ms by the clock of this computer, whatever the source does: each hop goes towards the newest frame. Where none comes for half
//! a second servos go back to rest, and wait there.
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crate::progress::say;
use anyhow::{Result, bail};
use lipstream::engine::Engine;
use lipstream_core::servo::{Calibration, Servos};
use lipstream_live::clock::Clock;
use lipstream_live::driver::Driver;
use lipstream_live::event::{Event, Timed};
use lipstream_live::hub::{Hub, Missed};

use super::{Args, Follow, Out, read_out, scales};
use crate::commands::sources;

/// How long a frame is worth following.
const PATIENCE: Duration = Duration::from_millis(500);

/// Follows the source to its end, or until somebody presses Ctrl-C; then the servos rest.
pub(super) fn follow(args: &Args, calibration: &Calibration, out: &mut Out) -> Result<()> {
    let clock = Clock::start();
    let hub = Arc::new(Hub::default());
    let model = args.source.model()?;
    let engine = model.engine();
    let mut follow = Follow {
        servos: Servos::new(calibration),
        read_out: read_out(args.source.model_path(), engine)?,
        scales: scales(engine),
        out,
        frames: 0,
    };
    let id = engine.model_id();
    let mouths = model.mouths(&Engine::shipped())?;
    let Some(setup) = args.source.setup(&model, &mouths, &hub, clock)? else {
        bail!("no device is attached: name a source, or give --mic or --wav SOUND");
    };
    let interrupted = sources::interrupted()?;
    sources::print_notices(&hub);
    args.source.start_outputs(&hub)?;
    let (_, mut events) = hub.watch();
    let driver = Driver::start(setup);
    // Opening the source may have taken a while, which is no reason to hurry now.
    if let Some(next) = &mut follow.out.next {
        *next = Instant::now();
    }
    let mut newest: Option<(Instant, Arc<Timed>)> = None;
    let mut over = false;
    while !over && !interrupted.load(Ordering::Relaxed) {
        loop {
            match events.now() {
                Ok(Some(Event::Frame(timed))) => newest = Some((Instant::now(), timed)),
                Ok(Some(Event::Hello(said))) if Some(said.hello.model) != id => bail!(
                    "{} runs model {:08x}, and {:08x} is at hand: name its model (--model)",
                    said.source,
                    said.hello.model,
                    id.unwrap_or_default()
                ),
                Ok(Some(Event::End(_))) | Err(Missed::Over) => over = true,
                Ok(Some(_)) | Err(Missed::Slow(_)) => continue,
                Ok(None) => break,
            }
            if over {
                break;
            }
        }
        match &newest {
            Some((came, timed)) if came.elapsed() < PATIENCE => {
                follow.step(&timed.frame.parameters, &timed.frame.viseme_weights)?;
            }
            _ => follow.idle()?,
        }
    }
    drop(driver);
    let frames = follow.frames;
    follow.rest(calibration)?;
    match newest {
        None if !interrupted.load(Ordering::Relaxed) => bail!("no frame came"),
        _ => {
            let seconds = frames as f64 / 100.0;
            say(&format!("the servos followed for {seconds:.2} s"));
            Ok(())
        }
    }
}
