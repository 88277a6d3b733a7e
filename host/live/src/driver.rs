//! What owns the device: reads it, feeds it, waits for it when it is gone, and tells everyone.
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use lipstream::engine::Engine;
use lipstream::error::chain;
use lipstream::link::{Link, Losses};
use lipstream_core::wire::{Frame, Hello, MAX_PCM_SAMPLES, PROTOCOL, Pcm, Profile, Status, ToDevice, ToHost};
use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};

use crate::address::Address;
use crate::clock::Clock;
use crate::desk::Mouth;
use crate::device::{Device, Said};
use crate::event::{Announcement, Command, Event, Health, Level, Notice, Sound, Timed};
use crate::feed::{Feed, Hop, Speech, SpeechError};
use crate::hub::Hub;

/// Time between two tries to open a device that is away.
const RETRY: Duration = Duration::from_millis(500);
/// Time between two reports of [`Health`].
const REPORT: Duration = Duration::from_secs(1);
/// Frames that fail to come for so long are worth a word.
const STALL: Duration = Duration::from_secs(2);
/// Sound that a device may have before it and not answered, in samples: half a second. What it is behind by waits somewhere, in buffers of the
/// line or of the system, and would be delay for ever.
const MOST_BEHIND: u64 = SAMPLE_RATE_HZ as u64 / 2;
/// Hops of sound whose time is remembered: half a minute.
const REMEMBERED: usize = 3000;

/// Who makes frames.
pub enum Source {
    /// A device at the end of a line, or a recording of one.
    Line(Address),
    /// The device's own code in this program; the engine must be the fixed one.
    Inside(Arc<Engine>),
}

impl Source {
    /// Whether it listens to commands.
    pub fn obeys(&self) -> bool {
        match self {
            Source::Line(address) => address.obeys(),
            Source::Inside(_) => true,
        }
    }
}

/// What a driver is to do.
pub struct Setup {
    /// Who makes frames.
    pub source: Source,
    /// What is spoken to it, in real time.
    pub speech: Option<Speech>,
    /// Whether the speech begins again when it has ended.
    pub repeat: bool,
    /// Which trade of delay against quality is asked for at first; the device's own where none is.
    pub profile: Option<Profile>,
    /// Who is told.
    pub hub: Arc<Hub>,
    /// The host's clock.
    pub clock: Clock,
    /// Mouths of the models that may speak.
    pub mouths: Arc<[Mouth]>,
}

/// A running driver; it ends when this value is dropped.
pub struct Driver {
    inputs: Sender<Input>,
    thread: Option<JoinHandle<()>>,
}

impl Driver {
    /// Starts a driver on a thread of its own.
    pub fn start(setup: Setup) -> Self {
        let (inputs, received) = channel();
        let own = inputs.clone();
        let thread = std::thread::spawn(move || Running::new(setup, own).run(&received));
        Self {
            inputs,
            thread: Some(thread),
        }
    }

    /// A handle by which watchers ask for something.
    pub fn commands(&self) -> Commands {
        Commands(self.inputs.clone())
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.inputs.send(Input::Quit);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Asks the source for something.
#[derive(Clone)]
pub struct Commands(Sender<Input>);

impl Commands {
    /// Asks; a driver that has ended hears nothing.
    pub fn send(&self, command: Command) {
        let _ = self.0.send(Input::Command(command));
    }
}

/// What happens to a driver. Lines and feeds are counted, so that what an old one still says is not taken for the new one's.
enum Input {
    Line(u64, Said),
    Hop(u64, Hop, f64),
    SpeechEnded(u64, Option<SpeechError>),
    Command(Command),
    Quit,
}

struct Running {
    setup: Setup,
    inputs: Sender<Input>,
    device: Option<Device>,
    link: Link,
    /// Losses on lines that were closed.
    before: Losses,
    line: u64,
    /// When a device that is away is looked for again.
    retry: Option<Instant>,
    away_said: bool,
    /// When a microphone that broke off is opened again.
    again: Option<Instant>,
    profile: Option<Profile>,
    announcement: Option<Arc<Announcement>>,
    /// The next `Hello` begins a new run.
    fresh: bool,
    running: bool,
    /// Sample of the last frame, not wrapped.
    sample: Option<u64>,
    sequence: u32,
    last_frame: Instant,
    stalled: bool,
    status: Status,
    feed: Option<Feed>,
    feeds: u64,
    /// Number of the next sample that is fed, and when the last hops were heard.
    fed: u64,
    heard: VecDeque<(u64, f64)>,
    pcm: u32,
    /// Whether the device has been told that the sound has ended.
    ending: bool,
    said: Option<Arc<str>>,
}

impl Running {
    fn new(setup: Setup, inputs: Sender<Input>) -> Self {
        Self {
            profile: setup.profile,
            setup,
            inputs,
            device: None,
            link: Link::new(None),
            before: Losses::default(),
            line: 0,
            retry: Some(Instant::now()),
            away_said: false,
            again: None,
            announcement: None,
            fresh: true,
            running: false,
            sample: None,
            sequence: 0,
            last_frame: Instant::now(),
            stalled: false,
            status: Status::default(),
            feed: None,
            feeds: 0,
            fed: 0,
            heard: VecDeque::new(),
            pcm: 0,
            ending: false,
            said: None,
        }
    }

    fn run(mut self, inputs: &Receiver<Input>) {
        let mut report = Instant::now() + REPORT;
        loop {
            let now = Instant::now();
            if self.retry.is_some_and(|at| at <= now) {
                self.retry = None;
                self.open();
            }
            if self.again.is_some_and(|at| at <= now) {
                self.begin();
            }
            if report <= now {
                report = now + REPORT;
                self.report();
            }
            let until = [self.retry, self.again]
                .into_iter()
                .flatten()
                .fold(report, Instant::min);
            let goes_on = match inputs.recv_timeout(until.saturating_duration_since(now)) {
                Ok(input) => self.take(input),
                Err(RecvTimeoutError::Timeout) => true,
                Err(RecvTimeoutError::Disconnected) => false,
            };
            if !goes_on {
                return;
            }
        }
    }

    /// Takes what happened; false when there is nothing more to wait for.
    fn take(&mut self, input: Input) -> bool {
        match input {
            Input::Line(line, said) if line == self.line => match said {
                Said::Bytes(bytes) => self.bytes(&bytes),
                Said::Message(message) => self.message(*message),
                Said::Closed(why) => self.closed(why),
            },
            Input::Hop(feed, hop, heard_ms) if feed == self.feeds => self.hop(hop, heard_ms),
            Input::SpeechEnded(feed, error) if feed == self.feeds => self.speech_ended(error),
            Input::Command(command) => self.obey(command),
            Input::Quit => return false,
            Input::Line(..) | Input::Hop(..) | Input::SpeechEnded(..) => {}
        }
        true
    }

    /// Opens the line, and begins.
    fn open(&mut self) {
        self.line += 1;
        self.before = self.before + self.link.losses();
        self.link = Link::new(None);
        self.fresh = true;
        let (line, inputs) = (self.line, self.inputs.clone());
        let hear = move |said| inputs.send(Input::Line(line, said)).is_ok();
        let opened = match &self.setup.source {
            Source::Inside(engine) => Ok(Device::inside(
                engine,
                self.profile.unwrap_or(Profile::Standard),
                hear,
            )),
            Source::Line(address) => Device::open(address, hear),
        };
        let device = match opened {
            Ok(device) => device,
            Err(why) => {
                self.away(&why);
                return;
            }
        };
        if std::mem::take(&mut self.away_said) {
            self.notice(Level::Info, format!("{} is back", self.name()));
        }
        self.device = Some(device);
        self.last_frame = Instant::now();
        self.tell(ToDevice::Hello { protocol: PROTOCOL });
        if self.setup.speech.is_some() || self.profile.is_some() {
            self.begin();
        }
    }

    /// A device that cannot be opened is waited for, if it is one that comes back.
    fn away(&mut self, why: &str) {
        let comes_back = matches!(&self.setup.source, Source::Line(address) if address.comes_back());
        let name = self.name();
        if comes_back {
            self.retry = Some(Instant::now() + RETRY);
            if !std::mem::replace(&mut self.away_said, true) {
                self.notice(Level::Warning, format!("waiting for {name}: {why}"));
            }
        } else {
            self.notice(Level::Error, format!("{name} cannot be opened: {why}"));
            self.end(&format!("{name} cannot be opened: {why}"));
        }
    }

    fn name(&self) -> String {
        match &self.setup.source {
            Source::Line(address) => address.to_string(),
            Source::Inside(_) => "the model in this program".to_owned(),
        }
    }

    /// Starts a run from its beginning.
    fn begin(&mut self) {
        self.fresh = true;
        self.running = true;
        self.again = None;
        self.ending = false;
        self.fed = 0;
        self.pcm = 0;
        self.heard.clear();
        self.feed = None;
        self.feeds += 1;
        match self.profile {
            Some(profile) => self.tell(ToDevice::Profile(profile)),
            None => self.tell(ToDevice::Start),
        };
        let Some(speech) = &self.setup.speech else { return };
        let (feed, inputs) = (self.feeds, self.inputs.clone());
        match speech.open() {
            Ok(sound) => {
                self.feed = Some(Feed::start(
                    sound,
                    speech.is_live(),
                    self.setup.clock,
                    move |hop| {
                        let input = match hop {
                            Ok(Some((hop, heard_ms))) => Input::Hop(feed, hop, heard_ms),
                            Ok(None) => Input::SpeechEnded(feed, None),
                            Err(error) => Input::SpeechEnded(feed, Some(error)),
                        };
                        inputs.send(input).is_ok()
                    },
                ));
            }
            Err(error) => {
                let _ = inputs.send(Input::SpeechEnded(feed, Some(error)));
            }
        }
    }

    /// Says something to the device; false where it does not take it in time. That is lost then, and shows in the device's own counts.
    fn tell(&mut self, message: ToDevice) -> bool {
        let taken = self.device.as_ref().is_none_or(|device| device.tell(message));
        if !taken {
            self.say_once(Level::Warning, "the device does not take what it is sent");
        }
        taken
    }

    fn bytes(&mut self, bytes: &[u8]) {
        let mut messages = Vec::new();
        let read = self.link.push(bytes, |message| messages.push(message));
        for message in messages {
            self.message(message);
        }
        if let Err(error) = read {
            self.say_once(Level::Error, &error.to_string());
        }
    }

    fn message(&mut self, message: ToHost) {
        match message {
            ToHost::Hello(hello) => self.hello(hello),
            ToHost::Frame(frame) => self.frame(frame),
            // It may be from afar: whatever is no ordinary letter could turn a terminal's colours.
            ToHost::Notice(notice) => {
                let words: String = notice.words.chars().filter(|c| !c.is_control()).collect();
                self.say_once(Level::Warning, &format!("the device says: {words}"));
            }
            ToHost::Status(status) => {
                self.status = status;
                if std::mem::take(&mut self.ending) {
                    self.running = false;
                    match self.setup.repeat {
                        true => self.begin(),
                        false => self.end("the sound has ended"),
                    }
                }
            }
        }
    }

    fn hello(&mut self, hello: Hello) {
        let known = self.announcement.as_ref().is_some_and(|a| a.hello == hello);
        if known && !self.fresh {
            return;
        }
        if let Some(before) = &self.announcement
            && before.hello.model != hello.model
        {
            let (then, now) = (before.hello.model, hello.model);
            self.notice(
                Level::Warning,
                format!("the device runs another model: {now:08x} in place of {then:08x}"),
            );
        }
        self.announce(hello);
    }

    /// Tells everyone that a run begins.
    fn announce(&mut self, hello: Hello) {
        self.fresh = false;
        self.sample = None;
        let mouth = self.setup.mouths.iter().find(|mouth| mouth.model == hello.model);
        let announcement = Arc::new(Announcement {
            opening: mouth.and_then(Mouth::opening).cloned(),
            source: self.name(),
            hello,
            profile: self.profile,
            sound: self.setup.speech.is_some(),
            running: self.running || self.setup.speech.is_none(),
        });
        self.announcement = Some(Arc::clone(&announcement));
        self.setup.hub.send(Event::Hello(announcement));
    }

    fn frame(&mut self, frame: Frame) {
        let Some(announcement) = self.announcement.clone() else {
            return;
        };
        let goes_back = frame.sequence.wrapping_sub(self.sequence) > u32::MAX / 2;
        if self.sample.is_some() && goes_back {
            self.notice(Level::Info, "the device began anew".to_owned());
            self.announce(announcement.hello.clone());
        }
        self.sequence = frame.sequence;
        let sample = match self.sample {
            None => u64::from(frame.sample),
            Some(last) => last.wrapping_add_signed(i64::from(frame.sample.wrapping_sub(last as u32) as i32)),
        };
        self.sample = Some(sample);
        self.last_frame = Instant::now();
        self.stalled = false;
        let timed = Timed {
            heard_ms: self.heard_ms(sample),
            arrived_ms: self.setup.clock.now_ms(),
            hello: self.announcement.clone().unwrap_or(announcement),
            frame,
            sample,
        };
        self.setup.hub.send(Event::Frame(Arc::new(timed)));
    }

    /// When a sample was heard, where the host spoke it.
    fn heard_ms(&self, sample: u64) -> Option<f64> {
        let after = self.heard.partition_point(|(first, _)| *first <= sample);
        let (first, ms) = self.heard.get(after.checked_sub(1)?)?;
        let offset = sample - first;
        (offset < HOP_SAMPLES as u64).then(|| ms + offset as f64 * 1000.0 / f64::from(SAMPLE_RATE_HZ))
    }

    /// Whether the device owes frames for more sound than it should.
    fn is_behind(&self) -> bool {
        let answered = match (self.sample, self.announcement.as_deref()) {
            // Until its next frame comes a device of a low rate owes nothing.
            (Some(sample), Some(Announcement { hello, .. })) if !self.fresh => {
                let next = SAMPLE_RATE_HZ / u32::from(hello.rate_hz.max(1));
                sample + u64::from(hello.lag_samples) + u64::from(next)
            }
            _ => 0,
        };
        self.fed > answered + MOST_BEHIND
    }

    /// A hop of sound to the device. One that it has no time for is left out: the device counts it as an overrun, and its samples and ours go
    /// on with the next.
    fn hop(&mut self, Hop(samples): Hop, heard_ms: f64) {
        let (sequence, first) = (self.pcm, self.fed);
        self.pcm = self.pcm.wrapping_add(1);
        if self.is_behind() {
            let text = "the device does not keep up with the sound: some of it is left out";
            self.say_once(Level::Warning, text);
            return;
        }
        let mut bytes = [0; 2 * MAX_PCM_SAMPLES];
        if !self.tell(ToDevice::Pcm(Pcm::new(sequence, &samples, &mut bytes))) {
            return;
        }
        self.fed += samples.len() as u64;
        self.heard.push_back((first, heard_ms));
        if self.heard.len() > REMEMBERED {
            self.heard.pop_front();
        }
        self.setup.hub.send(Event::Sound(Arc::new(Sound {
            sample: first,
            samples,
            heard_ms,
        })));
    }

    fn speech_ended(&mut self, error: Option<SpeechError>) {
        self.feed = None;
        match error {
            Some(error) => {
                let text = chain(&error);
                if self.setup.speech.as_ref().is_some_and(Speech::is_live) {
                    self.say_once(Level::Warning, &format!("{text}; waiting for it"));
                    self.tell(ToDevice::Stop);
                    self.again = Some(Instant::now() + RETRY);
                    return;
                }
                self.notice(Level::Error, text.clone());
                self.end(&text);
            }
            None => {
                self.ending = true;
                self.tell(ToDevice::Stop);
            }
        }
    }

    /// The line has broken off.
    fn closed(&mut self, why: Option<String>) {
        self.device = None;
        self.feed = None;
        self.feeds += 1;
        let Source::Line(address) = &self.setup.source else {
            return;
        };
        let name = address.to_string();
        if address.comes_back() {
            self.away_said = true;
            self.retry = Some(Instant::now() + RETRY);
            let why = why.map_or(String::new(), |why| format!(" ({why})"));
            self.notice(Level::Warning, format!("{name} is gone{why}; waiting for it"));
            return;
        }
        match why {
            Some(why) => {
                self.notice(Level::Error, format!("{name}: {why}"));
                self.end(&format!("{name} ended: {why}"));
            }
            None => self.end(&format!("{name} has ended")),
        }
    }

    fn obey(&mut self, command: Command) {
        match command {
            Command::Start => match self.setup.source {
                // A recording begins anew by being opened anew.
                Source::Line(Address::Recording(_)) => {
                    self.device = None;
                    self.open();
                }
                _ => self.begin(),
            },
            Command::Stop => {
                self.again = None;
                self.feed = None;
                self.feeds += 1;
                self.running = false;
                self.tell(ToDevice::Stop);
            }
            Command::Profile(profile) => {
                self.profile = Some(profile);
                self.begin();
            }
        }
    }

    fn report(&mut self) {
        let expected = self.device.is_some() && self.running && !self.ending;
        if expected && self.last_frame.elapsed() > STALL && !std::mem::replace(&mut self.stalled, true) {
            self.notice(
                Level::Warning,
                format!("{} has said nothing for 2 s", self.name()),
            );
        }
        self.setup.hub.send(Event::Status(Health {
            device: self.status,
            losses: self.before + self.link.losses(),
        }));
    }

    fn notice(&self, level: Level, text: String) {
        self.setup.hub.send(Event::Notice(Notice {
            level,
            text: text.into(),
        }));
    }

    /// A notice whose cause may go on and on.
    fn say_once(&mut self, level: Level, text: &str) {
        if self.said.as_deref() != Some(text) {
            self.said = Some(text.into());
            self.notice(level, text.to_owned());
        }
    }

    fn end(&self, text: &str) {
        self.setup.hub.send(Event::End(text.into()));
    }
}
