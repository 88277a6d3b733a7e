//! The device at the other end, wherever that is: what it is told, and the threads that hear it.
use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

use lipstream::engine::Engine;
use lipstream::error::chain;
use lipstream::link::greeting;
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_core::wire::{MAX_ENCODED, Profile, ToDevice, ToHost, encode};

use crate::address::Address;
use crate::inside::{self, Order};
use crate::port::{self, Port};
use crate::qemu::Machine;
use crate::recording::Recording;

/// Messages to a device that does not take them now: two seconds of sound.
const BACKLOG: usize = 200;

/// What comes from a device.
pub(crate) enum Said {
    /// As the line carries it.
    Bytes(Vec<u8>),
    Message(Box<ToHost>),
    /// The line has broken off: why, where that is known.
    Closed(Option<String>),
}

/// The device at the other end. It falls silent with this value.
pub(crate) enum Device {
    Line {
        /// None where nobody listens.
        write: Option<SyncSender<Vec<u8>>>,
        wanted: Arc<AtomicBool>,
        _machine: Option<Machine>,
    },
    Inside(Sender<Order>),
}

impl Drop for Device {
    fn drop(&mut self) {
        if let Device::Line { wanted, .. } = self {
            wanted.store(false, Ordering::Relaxed);
        }
    }
}

impl Device {
    /// The device's own code in this program. `hear` gives false when nobody hears any more.
    pub(crate) fn inside(
        engine: &Arc<Engine>,
        profile: Profile,
        hear: impl Fn(Said) -> bool + Send + 'static,
    ) -> Self {
        let say = move |message| hear(Said::Message(Box::new(message)));
        Self::Inside(inside::start(Arc::clone(engine), profile, say))
    }

    /// Opens a line and starts what reads and writes it; else why it cannot be opened.
    pub(crate) fn open(
        address: &Address,
        hear: impl Fn(Said) -> bool + Send + 'static,
    ) -> Result<Self, String> {
        let wanted = Arc::new(AtomicBool::new(true));
        let still = Arc::clone(&wanted);
        let opened = match address {
            Address::Recording(path) => {
                let recording = Recording::open(path).map_err(|e| chain(&e))?;
                std::thread::spawn(move || replay(recording, hear, &still));
                return Ok(Self::Line {
                    write: None,
                    wanted,
                    _machine: None,
                });
            }
            Address::Serial { port, baud } => port::serial(port, *baud),
            Address::Tcp(place) => port::tcp(place),
            Address::Qemu(program) => port::qemu(program),
            Address::Stdin => Ok(port::stdin()),
        };
        let Port { read, write, machine } = opened.map_err(|e| e.to_string())?;
        let write = write.map(|write| {
            let (sender, messages) = sync_channel(BACKLOG);
            std::thread::spawn(move || write_on(write, &messages));
            sender
        });
        std::thread::spawn(move || read_on(read, hear, &still));
        Ok(Self::Line {
            write,
            wanted,
            _machine: machine,
        })
    }

    /// Says something to the device; false where it does not take it in time.
    pub(crate) fn tell(&self, message: ToDevice) -> bool {
        match self {
            Device::Inside(orders) => {
                let order = match message {
                    ToDevice::Start => Order::Start,
                    ToDevice::Stop => Order::Stop,
                    ToDevice::Profile(profile) => Order::Profile(profile),
                    ToDevice::Pcm(pcm) => Order::Samples(pcm.samples().collect()),
                    ToDevice::Hello { .. } => Order::Hello,
                };
                let _ = orders.send(order);
                true
            }
            Device::Line {
                write: Some(write), ..
            } => {
                let bytes = match message {
                    ToDevice::Hello { .. } => greeting(),
                    message => {
                        encode(&message, &mut [0; MAX_ENCODED]).map_or_else(|_| Vec::new(), |b| b.to_vec())
                    }
                };
                !matches!(write.try_send(bytes), Err(TrySendError::Full(_)))
            }
            Device::Line { write: None, .. } => true,
        }
    }
}

/// Hands over bytes as they come.
fn read_on(mut read: impl Read, hear: impl Fn(Said) -> bool, wanted: &AtomicBool) {
    let mut buffer = [0; 4096];
    while wanted.load(Ordering::Relaxed) {
        let why = match read.read(&mut buffer) {
            Ok(0) => None,
            Ok(count) => {
                if !hear(Said::Bytes(buffer[..count].to_vec())) {
                    return;
                }
                continue;
            }
            Err(error) if port::is_patience(&error) => continue,
            Err(error) => Some(error.to_string()),
        };
        hear(Said::Closed(why));
        return;
    }
}

/// Writes messages as they come. That the line has broken shows at its reader.
fn write_on(mut write: impl Write, messages: &Receiver<Vec<u8>>) {
    while let Ok(bytes) = messages.recv() {
        if let Err(error) = write.write_all(&bytes)
            && !port::is_patience(&error)
        {
            return;
        }
    }
}

/// Hands over the messages of a recording, each frame when its sample comes.
fn replay(mut recording: Recording, hear: impl Fn(Said) -> bool, wanted: &AtomicBool) {
    let mut first: Option<(u32, Instant)> = None;
    loop {
        let message = match recording.message() {
            Ok(Some(message)) => message,
            Ok(None) => {
                hear(Said::Closed(None));
                return;
            }
            Err(error) => {
                hear(Said::Closed(Some(chain(&error))));
                return;
            }
        };
        if let ToHost::Frame(frame) = &message {
            let (sample, began) = *first.get_or_insert((frame.sample, Instant::now()));
            let after = frame.sample.wrapping_sub(sample);
            match after > u32::MAX / 2 {
                // A run that began anew.
                true => first = Some((frame.sample, Instant::now())),
                false => {
                    let due = began + Duration::from_secs_f64(f64::from(after) / f64::from(SAMPLE_RATE_HZ));
                    // In pieces, so that one who is not wanted any more ends soon, and a gap of hours in the file is not slept through.
                    while let Some(left) = due.checked_duration_since(Instant::now()) {
                        if left > Duration::from_secs(3) {
                            first = Some((frame.sample, Instant::now()));
                            break;
                        }
                        std::thread::sleep(left.min(Duration::from_millis(100)));
                        if !wanted.load(Ordering::Relaxed) {
                            return;
                        }
                    }
                }
            }
        }
        if !wanted.load(Ordering::Relaxed) || !hear(Said::Message(Box::new(message))) {
            return;
        }
    }
}
