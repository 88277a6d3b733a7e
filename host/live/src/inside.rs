//! A device inside this program: the device's own stream on the host's processor, with the words of the wire.
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use lipstream::engine::Engine;
use lipstream::time::FRAME_RATE_HZ;
use lipstream_core::wire::{Frame, Hello, Profile, Status, ToHost};
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, StreamSettings};

/// What the device is told.
pub(crate) enum Order {
    Start,
    Stop,
    Profile(Profile),
    Samples(Vec<i16>),
    Hello,
}

/// Starts a device with `engine`'s tables, which must be the fixed engine's. It ends when nobody orders any more, or `say` gives false.
pub(crate) fn start(
    engine: Arc<Engine>,
    profile: Profile,
    say: impl Fn(ToHost) -> bool + Send + 'static,
) -> Sender<Order> {
    let (orders, received) = channel();
    std::thread::spawn(move || {
        if let Some(tables) = engine.tables() {
            run(tables, profile, &received, &say);
        }
    });
    orders
}

fn run(tables: &AnyModel, profile: Profile, orders: &Receiver<Order>, say: &impl Fn(ToHost) -> bool) {
    let mut device = Device {
        tables,
        stream: AnyStream::new(tables, StreamSettings::of(profile)),
        running: false,
        sequence: 0,
        busy_us: 0,
        round: Instant::now(),
    };
    while let Ok(order) = orders.recv() {
        let mut messages = Vec::new();
        device.obey(order, &mut messages);
        if !messages.into_iter().all(say) {
            return;
        }
    }
}

struct Device<'m> {
    tables: &'m AnyModel<'m>,
    stream: AnyStream<'m>,
    running: bool,
    sequence: u32,
    /// Time spent in the stream since the last `Status`.
    busy_us: u64,
    round: Instant,
}

impl Device<'_> {
    fn obey(&mut self, order: Order, say: &mut Vec<ToHost>) {
        match order {
            Order::Start => self.start(say),
            Order::Profile(profile) => {
                self.stream.set(StreamSettings::of(profile));
                self.start(say);
            }
            Order::Hello => say.push(self.hello()),
            Order::Samples(samples) if self.running => {
                let mut rest = &samples[..];
                while !rest.is_empty() {
                    let began = Instant::now();
                    let (consumed, frame) = self.stream.push(rest);
                    self.busy_us += began.elapsed().as_micros() as u64;
                    rest = &rest[consumed..];
                    if let Some(frame) = frame {
                        self.give(&frame, say);
                    }
                }
            }
            Order::Stop if self.running => {
                while let Some(frame) = self.stream.finish() {
                    self.give(&frame, say);
                }
                self.running = false;
                say.push(self.status());
            }
            Order::Samples(_) | Order::Stop => {}
        }
    }

    fn start(&mut self, say: &mut Vec<ToHost>) {
        self.stream.reset();
        self.running = true;
        self.sequence = 0;
        self.busy_us = 0;
        self.round = Instant::now();
        say.push(self.hello());
    }

    fn give(&mut self, frame: &ParameterFrame, say: &mut Vec<ToHost>) {
        say.push(ToHost::Frame(Frame::new(self.sequence, frame)));
        self.sequence = self.sequence.wrapping_add(1);
        if self.sequence.is_multiple_of(FRAME_RATE_HZ as u32) {
            say.push(self.hello());
            say.push(self.status());
        }
    }

    fn hello(&self) -> ToHost {
        let lag = self.stream.delay_samples().min(usize::from(u16::MAX)) as u16;
        ToHost::Hello(Hello::new(
            self.tables.head(),
            self.tables.n_visemes(),
            FRAME_RATE_HZ as u16,
            lag,
        ))
    }

    fn status(&mut self) -> ToHost {
        let elapsed = self.round.elapsed().as_micros().max(1) as u64;
        let load = (self.busy_us * 1000 / elapsed).min(1000) as u16;
        self.busy_us = 0;
        self.round = Instant::now();
        ToHost::Status(Status {
            load_permille: load,
            narrowed: self.stream.narrowed(),
            ..Status::default()
        })
    }
}
