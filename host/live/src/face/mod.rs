//! A face that says what is streamed: pictures for those pages that watch it.
//!
//! ```text
//! hub ─ frames ─► Course: which pictures are due ─► LiveFace draws ─► JPEG ─► the last picture ─► each page that watches
//! ```
//!
//! One thread does all of it. Only the last picture is kept, so that a page which is slow loses pictures and nobody waits for it; where the thread is slow, it leaves
//! pictures out evenly. While no page watches, nothing is drawn.
use std::collections::VecDeque;
use std::sync::{Arc, Weak};
use std::time::Instant;

use lipstream::error::chain;
use lipstream::render::SYNTHETIC;
use lipstream::render::face::LiveFace;
use lipstream_media::encode::jpeg;
use ndarray::ArrayView1;
use tokio::sync::watch::{self, Receiver, Sender};

use crate::event::{Event, Level, Notice};
use crate::hub::{Hub, Missed, Watch};

mod course;
mod pace;

use course::{Course, Due};
use pace::Pace;

/// Quality of the pictures, of 1 to 100: edges of lips and teeth without blocks; half of what 95 takes.
pub const QUALITY: u8 = 85;
/// Pictures that may be due at once, where a device of a low rate owes several by one frame.
const MOST_DUE: usize = 3;

/// A picture of a face.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Its number, counted from the stream's first sample.
    pub number: u64,
    /// The sample in the middle of its time, fractions included.
    pub sample: f64,
    /// When the frame came after which it could be drawn, host's clock, milliseconds.
    pub arrived_ms: f64,
    /// When its sample was heard or sent to the device, where the host knows.
    pub heard_ms: Option<f64>,
    /// What it looks like; its comment says that it is synthetic.
    pub jpeg: Vec<u8>,
}

/// A face that is drawn while somebody watches; it ends with its hub.
pub struct Face {
    model: u32,
    size: (usize, usize),
    fps: u32,
    pictures: Arc<Sender<Option<Arc<Picture>>>>,
}

impl Face {
    /// Starts to draw what a model of this id says.
    pub fn start(hub: &Arc<Hub>, model: u32, face: LiveFace) -> Self {
        let pictures = Arc::new(watch::channel(None).0);
        let (before, events) = hub.watch();
        let begun = Self {
            model,
            size: face.size(),
            fps: face.fps(),
            pictures: Arc::clone(&pictures),
        };
        let drawing = Drawing {
            hub: Arc::downgrade(hub),
            course: Course::new(face.fps()),
            pace: Pace::new(face.fps()),
            face,
            model,
            strange: None,
            due: VecDeque::new(),
            pictures,
        };
        std::thread::spawn(move || drawing.run(&before, events));
        begun
    }

    /// Whether it says what a model of this id streams.
    pub fn is_of(&self, model: u32) -> bool {
        self.model == model
    }

    /// Width and height of its pictures.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Its pictures a second, where the computer keeps up.
    pub fn fps(&self) -> u32 {
        self.fps
    }

    /// Whether somebody watches, so that it is drawn.
    pub fn is_watched(&self) -> bool {
        self.pictures.receiver_count() > 0
    }

    /// Every picture from now on, for one who looks in time; it is drawn as long as somebody holds this.
    pub fn watch(&self) -> Receiver<Option<Arc<Picture>>> {
        let mut pictures = self.pictures.subscribe();
        // The last one was drawn for somebody else, who knows how long ago.
        pictures.mark_unchanged();
        pictures
    }
}

/// The thread's own.
struct Drawing {
    hub: Weak<Hub>,
    face: LiveFace,
    model: u32,
    /// The other model that streams now.
    strange: Option<u32>,
    course: Course,
    pace: Pace,
    due: VecDeque<Due>,
    pictures: Arc<Sender<Option<Arc<Picture>>>>,
}

impl Drawing {
    fn run(mut self, before: &[Event], mut events: Watch) {
        before.iter().for_each(|event| self.take(event));
        loop {
            let event = match self.due.is_empty() {
                true => events.wait().map(Some),
                // What has come meanwhile may make a picture more urgent than the one that waits.
                false => events.now(),
            };
            match event {
                Ok(Some(event)) => self.take(&event),
                Ok(None) => {
                    if let Some(due) = self.due.pop_front()
                        && let Err(why) = self.draw(&due)
                    {
                        self.say(Level::Error, format!("the face is drawn no more: {why}"));
                        return;
                    }
                }
                // The pictures of what is gone are gone with it.
                Err(Missed::Slow(_)) => self.due.clear(),
                Err(Missed::Over) => return,
            }
        }
    }

    fn take(&mut self, event: &Event) {
        match event {
            Event::Hello(said) => {
                self.course.begin(&said.hello);
                self.due.clear();
                let model = said.hello.model;
                let strange = (model != self.model).then_some(model);
                if let Some(other) = strange.filter(|_| strange != self.strange) {
                    let ours = self.model;
                    self.say(
                        Level::Warning,
                        format!(
                            "the stream is of model {other:08x}, the face is moved by {ours:08x}: draw it with the model that the device runs"
                        ),
                    );
                }
                self.strange = strange;
            }
            Event::Frame(frame) if self.strange.is_none() => {
                let watched = self.pictures.receiver_count() > 0;
                for due in self.course.frame(frame) {
                    if watched && self.pace.wants(due.number) {
                        self.due.push_back(due);
                    }
                }
                while self.due.len() > MOST_DUE {
                    self.due.pop_front();
                }
            }
            _ => {}
        }
    }

    fn draw(&mut self, due: &Due) -> Result<(), String> {
        let began = Instant::now();
        let rgb = self
            .face
            .draw(due.background_s, ArrayView1::from(&due.parameters))
            .map_err(|error| chain(&error))?;
        let (width, height) = self.face.size();
        let jpeg = jpeg(&rgb, (width, height), QUALITY, SYNTHETIC).map_err(|error| chain(&error))?;
        self.pictures.send_replace(Some(Arc::new(Picture {
            number: due.number,
            sample: due.sample,
            arrived_ms: due.arrived_ms,
            heard_ms: due.heard_ms,
            jpeg,
        })));
        let took_ms = began.elapsed().as_secs_f64() * 1000.0;
        if let Some(every) = self.pace.took(took_ms) {
            let rate = f64::from(self.face.fps()) / f64::from(every);
            let (level, text) = match every {
                1 => (Level::Info, "every picture of the face is drawn again".to_owned()),
                _ => (
                    Level::Warning,
                    format!(
                        "this computer takes {:.0} ms for a picture of {width}×{height}: one of {every} is drawn, {rate:.1} a second",
                        self.pace.picture_ms()
                    ),
                ),
            };
            self.say(level, text);
        }
        Ok(())
    }

    fn say(&self, level: Level, text: String) {
        if let Some(hub) = self.hub.upgrade() {
            hub.send(Event::Notice(Notice {
                level,
                text: text.into(),
            }));
        }
    }
}
