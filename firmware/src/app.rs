//! The application: one stream of speech, its messages, and what it tells of itself.
use lipstream_core::HOP_SAMPLES;
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_core::kinds::Kind;
use lipstream_core::logmath::LogProb;
use lipstream_core::model::ModelError;
use lipstream_core::wire::{
    Frame, Hello, MAX_ENCODED, MAX_PCM_SAMPLES, Notice, Pcm, Profile, Receiver, Status, ToDevice, ToHost,
    WireError, encode,
};
use lipstream_core::{Model, ParameterFrame, Stream, StreamSettings};

use crate::pace::Pace;
use crate::servo::{Follower, NoServos};

/// Parameter frames that are made in a second.
pub(crate) const RATE_HZ: u16 = (SAMPLE_RATE_HZ / HOP_SAMPLES as u32) as u16;
/// Frames between two rounds of `Hello` and `Status`: a second.
const ROUND_FRAMES: u32 = RATE_HZ as u32;

/// The way to the host.
pub trait Line {
    /// Sends all of `bytes`, one frame; or, when there is no room for it, nothing, and returns false.
    fn send(&mut self, bytes: &[u8]) -> bool;

    /// How many bytes it carries in a second; None where it is never the narrow place, or the device waits for it. A slow one gets fewer
    /// frames ([`Pace`]).
    fn bytes_per_second(&self) -> Option<u32> {
        None
    }
}

/// A counter that runs at an even pace and starts again at 0 after 2³² − 1.
pub trait Clock {
    /// The count; always 0 where the board has no such counter.
    fn ticks(&self) -> u32;
}

/// Samples without a frame after which servos go back to rest: half a second.
const STANDSTILL_SAMPLES: usize = SAMPLE_RATE_HZ as usize / 2;

/// The device's end of the line, with a model of kind `K` and what follows its frames.
pub struct App<'m, K: Kind<'m>, L, C, F = NoServos> {
    receiver: Receiver,
    engine: Engine<'m, K, L, C, F>,
}

impl<'m, K: Kind<'m>, L: Line, C: Clock> App<'m, K, L, C> {
    /// Waits for `Start`, without servos. Inlined into the place that it is made for, as the stream is.
    #[inline(always)]
    pub fn new(model: &'m Model<'m, K>, line: L, clock: C) -> Self {
        Self::followed_by(model, line, clock, NoServos)
    }
}

impl<'m, K: Kind<'m>, L: Line, C: Clock, F: Follower> App<'m, K, L, C, F> {
    /// The same with servos that follow its frames.
    #[inline(always)]
    pub fn followed_by(model: &'m Model<'m, K>, line: L, clock: C, follower: F) -> Self {
        let now = clock.ticks();
        let pace = pace(model, &line);
        Self {
            receiver: Receiver::new(),
            engine: Engine {
                model,
                refused: None,
                widest_beam: None,
                stream: Stream::new(model, StreamSettings::of(Profile::Standard)),
                line,
                clock,
                pace,
                running: false,
                from_host: false,
                made: 0,
                sequence: 0,
                next_pcm: 0,
                status: Status::default(),
                busy_ticks: 0,
                round_began: now,
                follower,
                still: 0,
            },
        }
    }

    /// Why another model than the one that runs, the board's own, was not taken: said to every host that comes.
    pub fn model_refused(&mut self, why: Option<ModelError>) {
        self.engine.refused = why;
    }

    /// From now on no beam is wider than `widest`, whatever the model's tables say: for processors that have not the time for it.
    pub fn narrow(&mut self, widest: LogProb) {
        self.engine.widest_beam = Some(widest);
        self.engine.set(Profile::Standard);
    }

    /// A byte from the host.
    pub fn receive(&mut self, byte: u8) {
        match self.receiver.push(byte) {
            Some(Ok(message)) => self.engine.obey(&message),
            Some(Err(WireError::Protocol { .. })) => self.engine.refuse(),
            Some(Err(WireError::Unknown { .. })) => self.engine.skip(),
            // Bytes that are no message show as a gap in the sequence of `Pcm`.
            Some(Err(_)) | None => {}
        }
    }

    /// As the message `Start`; boards with a microphone call it when they are ready.
    pub fn start(&mut self) {
        self.engine.start();
    }

    /// Between a start and a stop, whoever asked for it.
    pub fn is_running(&self) -> bool {
        self.engine.running
    }

    /// As the message `Stop`.
    pub fn stop(&mut self) {
        self.engine.stop();
    }

    /// Sound from the board itself, cut anywhere. Ignored before [`App::start`], and from the first `Pcm` to the next start: the host's
    /// sound is not mixed with the room's.
    ///
    /// The board's own sound is also what tells the time to servos that get no frames: they go back to rest.
    pub fn samples(&mut self, samples: &[i16]) {
        self.engine.stand_still(samples.len());
        if !self.engine.from_host {
            self.engine.samples(samples);
        }
    }

    /// The board had to throw away so many hops of sound.
    pub fn overrun(&mut self, hops: u32) {
        if !self.engine.from_host {
            self.engine.overrun(hops);
        }
    }

    /// The line, for a board that has to tend to it.
    pub fn line(&mut self) -> &mut L {
        &mut self.engine.line
    }
}

fn pace<'m, K: Kind<'m>>(model: &Model<'m, K>, line: &impl Line) -> Pace {
    let parameters = model.head().parameter_scales().count();
    Pace::new(line.bytes_per_second(), parameters, model.own().n_visemes())
}

/// Everything but the receiver, whose buffer a message borrows while it is obeyed.
struct Engine<'m, K: Kind<'m>, L, C, F> {
    model: &'m Model<'m, K>,
    refused: Option<ModelError>,
    widest_beam: Option<LogProb>,
    stream: Stream<'m, K>,
    line: L,
    clock: C,
    pace: Pace,
    /// Between `Start` and `Stop`.
    running: bool,
    /// Sound came in `Pcm` since the start.
    from_host: bool,
    /// Frames made since `Start`, those that the pace leaves out too.
    made: u32,
    /// Frames for the line since `Start`.
    sequence: u32,
    /// Sequence that the next `Pcm` should have.
    next_pcm: u32,
    status: Status,
    /// Ticks spent in the stream since the last `Status`.
    busy_ticks: u32,
    /// When the last `Status` was sent.
    round_began: u32,
    follower: F,
    /// Samples of the board's own sound since the last frame or hop of rest.
    still: usize,
}

impl<'m, K: Kind<'m>, L: Line, C: Clock, F: Follower> Engine<'m, K, L, C, F> {
    fn obey(&mut self, message: &ToDevice) {
        match *message {
            ToDevice::Start => self.start(),
            ToDevice::Stop => self.stop(),
            ToDevice::Profile(profile) => {
                self.set(profile);
                self.start();
            }
            ToDevice::Pcm(pcm) => self.pcm(pcm),
            ToDevice::Hello { .. } => self.introduce(),
        }
    }

    fn set(&mut self, profile: Profile) {
        let own = self.model.own().beam();
        let beam = self.widest_beam.zip(own).map(|(widest, own)| widest.min(own));
        self.stream.set(StreamSettings {
            beam,
            ..StreamSettings::of(profile)
        });
    }

    /// A host of another protocol: it gets to know ours, and nothing else that it would misread.
    fn refuse(&mut self) {
        self.running = false;
        self.line.send(&[0]);
        self.say_hello();
    }

    /// A message of a number that this protocol does not have.
    fn skip(&mut self) {
        self.status.unknown = self.status.unknown.saturating_add(1);
    }

    fn start(&mut self) {
        self.stream.reset();
        self.pace = pace(self.model, &self.line);
        self.running = true;
        self.from_host = false;
        self.made = 0;
        self.sequence = 0;
        self.next_pcm = 0;
        self.status = Status::default();
        self.busy_ticks = 0;
        self.round_began = self.clock.ticks();
        // Ends whatever stands half sent on the line.
        self.line.send(&[0]);
        self.introduce();
    }

    fn stop(&mut self) {
        if !self.running {
            return;
        }
        loop {
            let began = self.clock.ticks();
            let frame = self.stream.finish();
            self.worked_since(began);
            let Some(frame) = frame else { break };
            self.give(&frame);
        }
        self.running = false;
        self.say_status();
    }

    fn pcm(&mut self, pcm: Pcm) {
        if !self.running {
            return;
        }
        self.from_host = true;
        let ahead = pcm.sequence.wrapping_sub(self.next_pcm);
        // Half the numbers lie ahead and mean lost hops. The other half lie behind: a host that sends something twice or counts anew loses none.
        if ahead <= u32::MAX / 2 {
            self.overrun(ahead);
        }
        self.next_pcm = pcm.sequence.wrapping_add(1);
        let mut samples = [0; MAX_PCM_SAMPLES];
        let mut count = 0;
        for (to, sample) in samples.iter_mut().zip(pcm.samples()) {
            *to = sample;
            count += 1;
        }
        self.samples(&samples[..count]);
    }

    fn samples(&mut self, mut samples: &[i16]) {
        if !self.running {
            return;
        }
        while !samples.is_empty() {
            let began = self.clock.ticks();
            let (consumed, frame) = self.stream.push(samples);
            self.worked_since(began);
            samples = &samples[consumed..];
            if let Some(frame) = frame {
                self.give(&frame);
            }
        }
    }

    fn overrun(&mut self, hops: u32) {
        self.status.overruns = self.status.overruns.saturating_add(hops);
    }

    /// So many samples went by. When none of them has brought a frame for a while, servos go on towards rest, a hop at a time.
    fn stand_still(&mut self, samples: usize) {
        self.still += samples;
        while self.still >= STANDSTILL_SAMPLES + HOP_SAMPLES {
            self.still -= HOP_SAMPLES;
            self.follower.idle();
        }
    }

    fn worked_since(&mut self, began: u32) {
        let ticks = self.clock.ticks().wrapping_sub(began);
        self.busy_ticks = self.busy_ticks.saturating_add(ticks);
    }

    /// Sends a frame, if it is one for the line, and, once a second, how to read it and how it goes.
    fn give(&mut self, frame: &ParameterFrame) {
        let began = self.clock.ticks();
        self.follower.frame(frame);
        self.still = 0;
        self.worked_since(began);
        if self.follower.has_news() {
            self.say_notice();
        }
        if self.made.is_multiple_of(self.pace.every()) {
            let message = ToHost::Frame(Frame::new(self.sequence, frame));
            if !self.say(&message) {
                self.status.dropped = self.status.dropped.saturating_add(1);
            }
            self.sequence = self.sequence.wrapping_add(1);
        }
        self.made = self.made.wrapping_add(1);
        if self.made.is_multiple_of(ROUND_FRAMES) {
            self.pace.round();
            self.say_hello();
            self.say_status();
        }
    }

    /// Who this is, to a host that may be new, and what it should know.
    fn introduce(&mut self) {
        self.say_hello();
        if let Some(error) = self.refused {
            let words = format_args!("the model in flash is refused, the built-in one runs: {error}");
            self.say(&ToHost::Notice(Notice::new(words)));
        }
        self.say_notice();
    }

    fn say_hello(&mut self) {
        let lag = self.stream.delay_samples().min(usize::from(u16::MAX)) as u16;
        let hello = Hello::new(
            self.model.head(),
            self.model.own().n_visemes(),
            self.pace.rate_hz(),
            lag,
        );
        self.say(&ToHost::Hello(hello));
    }

    /// What the servos have to say, if they have.
    fn say_notice(&mut self) {
        if let Some(notice) = self.follower.notice().cloned() {
            self.say(&ToHost::Notice(notice));
        }
    }

    fn say_status(&mut self) {
        let now = self.clock.ticks();
        let elapsed = u64::from(now.wrapping_sub(self.round_began)).max(1);
        // At most 1000 where the counter is not slower than 2³² ticks a round.
        self.status.narrowed = self.stream.narrowed();
        self.status.load_permille = (u64::from(self.busy_ticks) * 1000 / elapsed).min(1000) as u16;
        self.say(&ToHost::Status(self.status));
        self.busy_ticks = 0;
        self.round_began = now;
    }

    fn say(&mut self, message: &ToHost) -> bool {
        #[cfg(feature = "defmt")]
        log(message);
        let mut buffer = [0; MAX_ENCODED];
        match encode(message, &mut buffer) {
            Ok(bytes) => {
                self.pace.says(bytes.len());
                self.line.send(bytes)
            }
            // Cannot be: MAX_ENCODED is enough for every message.
            Err(_) => false,
        }
    }
}

/// What a debug probe sees of a message: all but the frames, which are a hundred a second.
#[cfg(feature = "defmt")]
fn log(message: &ToHost) {
    match message {
        ToHost::Notice(notice) => defmt::warn!("{=str}", notice.words.as_str()),
        ToHost::Status(status) => defmt::info!("{}", status),
        ToHost::Hello(hello) => defmt::debug!("{}", hello),
        ToHost::Frame(_) => {}
    }
}
