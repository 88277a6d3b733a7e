//! What a board with a microphone and two ports does over and over.
use lipstream_core::kinds::Kind;
use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};

use crate::port::{IN, Ports};
use crate::servo::Follower;
use crate::{App, Clock};

/// Microphones need up to 256 ms after their clock began until their output has settled; what comes before must not open the mouth.
const SETTLE_SAMPLES: usize = SAMPLE_RATE_HZ as usize * 3 / 10;
/// Samples between two changes of the LED while everything is well: half a second.
const HEARTBEAT_SAMPLES: u32 = SAMPLE_RATE_HZ / 2;

/// Sound that comes by itself.
pub trait Microphone {
    /// Fills the beginning of `samples` with what has come: how many, and how many were lost before them.
    fn read(&mut self, samples: &mut [i16]) -> (usize, u32);
}

/// Where the loop stands.
#[derive(Clone, Debug)]
pub struct Turn {
    unsettled: usize,
    /// Samples since the last change of the LED.
    beat: u32,
}

impl Default for Turn {
    fn default() -> Self {
        Self::new()
    }
}

impl Turn {
    /// Just switched on.
    pub const fn new() -> Self {
        Self {
            unsettled: SETTLE_SAMPLES,
            beat: 0,
        }
    }

    /// Takes what came from the host and from the microphone; `heartbeat` is called twice a second of sound. Whether there was any sound: if
    /// not, the processor may sleep.
    pub fn take<'m, K: Kind<'m>, C: Clock, F: Follower>(
        &mut self,
        app: &mut App<'m, K, Ports, C, F>,
        microphone: &mut impl Microphone,
        heartbeat: impl FnOnce(),
    ) -> bool {
        // A host that never stops sending must not keep the microphone waiting.
        for _ in 0..IN {
            let Some(byte) = app.line().usb.receive() else {
                break;
            };
            app.receive(byte);
        }
        for _ in 0..IN {
            let Some(byte) = app.line().uart.receive() else {
                break;
            };
            app.receive(byte);
        }
        // There is room again for what waits in the host.
        (app.line().serve)();
        let mut samples = [0; HOP_SAMPLES];
        let (count, lost) = microphone.read(&mut samples);
        if lost > 0 {
            app.overrun(lost.div_ceil(HOP_SAMPLES as u32));
        }
        let early = count.min(self.unsettled);
        self.unsettled -= early;
        // A host may have started it before.
        if early > 0 && self.unsettled == 0 && !app.is_running() {
            app.start();
        }
        app.samples(&samples[early..count]);
        self.beat += count as u32;
        if self.beat >= HEARTBEAT_SAMPLES {
            self.beat -= HEARTBEAT_SAMPLES;
            heartbeat();
        }
        count > 0
    }
}
