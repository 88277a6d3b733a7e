//! The desk: the source that is being watched, and what can be done with it.
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use lipstream::engine::Engine;
use lipstream::error::chain;
use lipstream::mouth::MouthSpace;
use lipstream::opening::OpeningReader;

use crate::clock::Clock;
use crate::driver::{Driver, Setup, Source};
use crate::event::{Command, Event, Level, Notice};
use crate::face::Face;
use crate::feed::Speech;
use crate::hub::{Hub, Missed};
use crate::recording::{Recorder, RecordingError};

/// A mouth that can be drawn: the model that it belongs to, and the bytes that a page draws from.
pub struct Mouth {
    /// The id in the model's tables.
    pub model: u32,
    bytes: Arc<Vec<u8>>,
    opening: Option<Arc<OpeningReader>>,
}

impl Mouth {
    /// A mouth for the model of this id.
    pub fn new(model: u32, space: &MouthSpace) -> Self {
        Self {
            model,
            bytes: Arc::new(space.to_bytes()),
            opening: OpeningReader::of(space).map(Arc::new),
        }
    }

    /// What reads how open it is, where there are lips in it.
    pub fn opening(&self) -> Option<&Arc<OpeningReader>> {
        self.opening.as_ref()
    }
}

/// What a desk begins with.
pub struct Equipment {
    /// The host's clock.
    pub clock: Clock,
    /// Mouths of the models that may speak.
    pub mouths: Arc<[Mouth]>,
    /// Where recordings go.
    pub folder: PathBuf,
    /// The shipped model, for the demo.
    pub engine: Arc<Engine>,
    /// A face that one of the models moves.
    pub face: Option<Face>,
}

/// What is attached.
struct Attached {
    driver: Driver,
    obeys: bool,
}

/// The desk.
pub struct Desk {
    hub: Arc<Hub>,
    equipment: Equipment,
    attached: Mutex<Option<Attached>>,
    tape: Mutex<Option<Tape>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Desk {
    /// A desk at which nothing is attached.
    pub fn new(hub: Arc<Hub>, equipment: Equipment) -> Self {
        Self {
            hub,
            equipment,
            attached: Mutex::new(None),
            tape: Mutex::new(None),
        }
    }

    /// Attaches a source in place of the one before.
    pub fn attach(&self, setup: Setup) {
        let mut attached = lock(&self.attached);
        // The one before ends first.
        *attached = None;
        *attached = Some(Attached {
            obeys: setup.source.obeys(),
            driver: Driver::start(setup),
        });
    }

    /// Where events go out.
    pub fn hub(&self) -> &Arc<Hub> {
        &self.hub
    }

    /// The host's clock.
    pub fn clock(&self) -> Clock {
        self.equipment.clock
    }

    /// Whether something is attached.
    pub fn has_source(&self) -> bool {
        lock(&self.attached).is_some()
    }

    /// Asks the source for something.
    pub fn command(&self, command: Command) {
        if let Some(attached) = lock(&self.attached).as_ref() {
            attached.driver.commands().send(command);
        }
    }

    /// What a page may ask for.
    pub fn can(&self) -> Vec<&'static str> {
        match lock(&self.attached).as_ref() {
            None => vec!["demo"],
            Some(attached) if attached.obeys => vec!["start", "stop", "profile", "record"],
            Some(_) => vec!["start", "record"],
        }
    }

    /// Plays the shipped speech through the shipped model, over and over.
    pub fn demo(&self) {
        self.attach(Setup {
            source: Source::Inside(Arc::clone(&self.equipment.engine)),
            speech: Some(Speech::Shipped),
            repeat: true,
            profile: None,
            hub: Arc::clone(&self.hub),
            clock: self.equipment.clock,
            mouths: Arc::clone(&self.equipment.mouths),
        });
    }

    /// Whether there is a mouth for a model.
    pub fn draws(&self, model: u32) -> bool {
        self.equipment.mouths.iter().any(|mouth| mouth.model == model)
    }

    /// The face that a model moves, where there is one.
    pub fn face(&self, model: u32) -> Option<&Face> {
        self.equipment.face.as_ref().filter(|face| face.is_of(model))
    }

    /// What the mouth of the model that speaks is drawn from.
    pub fn mouth(&self) -> Option<Arc<Vec<u8>>> {
        let model = self.hub.hello()?.hello.model;
        let mouth = self.equipment.mouths.iter().find(|mouth| mouth.model == model)?;
        Some(Arc::clone(&mouth.bytes))
    }

    /// Name of the recording that is being made.
    pub fn recording(&self) -> Option<String> {
        lock(&self.tape).as_ref().map(|tape| tape.name.clone())
    }

    /// Begins or ends a recording.
    pub fn record(&self, on: bool) {
        let mut tape = lock(&self.tape);
        match (on, tape.is_some()) {
            (true, false) => match self.begin_tape() {
                Ok(begun) => {
                    let text = format!("recording {}", begun.name);
                    *tape = Some(begun);
                    self.notice(Level::Info, &text);
                }
                Err(error) => self.notice(Level::Error, &chain(&error)),
            },
            (false, true) => {
                if let Some(tape) = tape.take() {
                    let name = tape.name.clone();
                    match tape.end() {
                        Ok(frames) => self.notice(Level::Info, &format!("{name}: {frames} frames recorded")),
                        Err(error) => self.notice(Level::Error, &chain(&error)),
                    }
                }
            }
            _ => {}
        }
    }

    /// A recording under the next name that is free.
    fn begin_tape(&self) -> Result<Tape, RecordingError> {
        let free = |name: &String| {
            let path = self.equipment.folder.join(name);
            // The sound beside it must be free too.
            !path.exists() && !path.with_extension("wav").exists()
        };
        let mut names = (1..).map(|number| format!("mouth-{number:03}.stream"));
        let name = names.find(free).unwrap_or_default();
        let recorder = Recorder::create(&self.equipment.folder.join(&name))?;
        Ok(Tape::begin(&self.hub, name, recorder))
    }

    fn notice(&self, level: Level, text: &str) {
        self.hub.send(Event::Notice(Notice {
            level,
            text: text.into(),
        }));
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        self.record(false);
    }
}

/// How often a recording looks for events.
const LOOK: Duration = Duration::from_millis(5);

/// A recording that is being made, on a thread of its own.
pub struct Tape {
    name: String,
    wanted: Arc<AtomicBool>,
    thread: JoinHandle<Result<u64, RecordingError>>,
}

impl Tape {
    /// Records from now on, beginning with how to read it.
    pub fn begin(hub: &Arc<Hub>, name: String, mut recorder: Recorder) -> Self {
        let wanted = Arc::new(AtomicBool::new(true));
        let still = Arc::clone(&wanted);
        let (before, mut events) = hub.watch();
        let thread = std::thread::spawn(move || {
            for event in before.iter().filter(|e| matches!(e, Event::Hello(_))) {
                recorder.take(event)?;
            }
            loop {
                match events.now() {
                    Ok(Some(Event::End(_))) | Err(Missed::Over) => break,
                    Ok(Some(event)) => recorder.take(&event)?,
                    Ok(None) if still.load(Ordering::Relaxed) => std::thread::sleep(LOOK),
                    Ok(None) => break,
                    // The frames that are missing show by their numbers.
                    Err(Missed::Slow(_)) => {}
                }
            }
            let frames = recorder.frames();
            recorder.finish()?;
            Ok(frames)
        });
        Self { name, wanted, thread }
    }

    /// Ends it, when everything that has happened is written; gives the number of frames.
    ///
    /// # Errors
    ///
    /// What the disk has said.
    pub fn end(self) -> Result<u64, RecordingError> {
        self.wanted.store(false, Ordering::Relaxed);
        self.wait()
    }

    /// Waits until the source has ended.
    ///
    /// # Errors
    ///
    /// What the disk has said.
    pub fn wait(self) -> Result<u64, RecordingError> {
        self.thread.join().unwrap_or(Ok(0))
    }
}
