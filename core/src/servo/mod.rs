//! Hobby servos that move a mouth: from lip gap, width and visemes to pulses that no calibrated servo is hurt by.
//!
//! A [`Calibration`] is a checked table: which channels there are, what moves them, their end stops and their limits of speed and
//! acceleration. [`Servos`] holds where each channel is and takes one step a hop. What leaves is a pulse in quarters of a microsecond,
//! the unit of Pololu's Maestro; [`output`] writes it for boards that make pulses.
//!
//! A hobby servo does not say where it is. The first pulse is therefore the centre of the table, and the limits hold for the pulses from
//! then on, not for the way from wherever the horn was found. What is switched on together with its servos begins slowly ([`Servos::slowly`]): one
//! servo after the other, so that the supply is not asked for all their starting currents at once, and then at a quarter of their speed.
mod bytes;
mod calibration;
mod motion;
pub mod output;
mod read_out;

pub use calibration::{
    Calibration, CalibrationError, Channel, Driver, LONGEST_CALIBRATION, MAX_CHANNELS, N_CURVE, Role,
    STRAIGHT, WEIGHT_ONE, stated_length,
};
pub use motion::Axis;
pub use read_out::{Line, ReadOut};

use crate::fixed::saturate_i16;

/// Pulse width in units of ¼ µs.
pub type Pulse = u16;

/// What moves the servos at one hop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Mouth<'a> {
    /// Between the lips, Q15: 0 closed, 32767 as wide open as this mouth is in speech.
    pub gap: i16,
    /// Between the corners, Q15: −32768 as narrow as this mouth is in speech, 0 its mean, 32767 as wide.
    pub width: i16,
    /// Occupancy of each viseme, 255 = 1; those that are missing count as 0.
    pub viseme_weights: &'a [u8],
}

/// Hops between the first pulses of two channels that begin slowly. A hobby servo is where it was sent in less.
pub const STAGGER_HOPS: u16 = 25;
/// Hops that it then takes from a quarter of the speed to all of it.
pub const RAMP_HOPS: u16 = 100;

/// Where every channel of a calibration is.
#[derive(Clone, Debug)]
pub struct Servos {
    channels: heapless::Vec<(Channel, Axis), MAX_CHANNELS>,
    /// Hops since the beginning, of those that begin slowly, as far as they can be counted; others are as old as can be.
    age: u16,
}

impl Servos {
    /// All channels at their centres, at rest, and free to move.
    pub fn new(calibration: &Calibration) -> Self {
        let channels = calibration.channels().iter();
        Self {
            channels: channels
                .map(|channel| (*channel, Axis::at(channel.centre)))
                .collect(),
            age: u16::MAX,
        }
    }

    /// The same for servos that were without pulses so far: at the first hop channel 0 gets its first pulse, [`STAGGER_HOPS`] later the next one, and as long
    /// after the last all begin to move, during [`RAMP_HOPS`] slower than they may.
    pub fn slowly(calibration: &Calibration) -> Self {
        Self {
            age: 0,
            ..Self::new(calibration)
        }
    }

    /// One hop of 10 ms towards what `mouth` asks for.
    pub fn step(&mut self, mouth: &Mouth) {
        self.advance(|channel| channel.target(mouth));
    }

    /// One hop towards the centres, for a stream that has ended.
    pub fn rest(&mut self) {
        self.advance(|channel| channel.centre);
    }

    fn advance(&mut self, target: impl Fn(&Channel) -> Pulse) {
        // At most 6 · 25.
        let awake = self.channels.len() as u16 * STAGGER_HOPS;
        if let Some(ramp) = self.age.checked_sub(awake) {
            let ramp = u32::from(ramp.min(RAMP_HOPS));
            for (channel, axis) in &mut self.channels {
                // A quarter, and the other three with time; at most 2¹⁶ · 100.
                let share = u32::from(RAMP_HOPS) + 3 * ramp;
                let speed = u32::from(channel.speed) * share / (4 * u32::from(RAMP_HOPS));
                axis.step_at(channel, target(channel), speed.max(1) as u16);
            }
        }
        self.age = self.age.saturating_add(1);
    }

    /// Number of the output, and its pulse if the channel has begun, channel by channel.
    pub fn driven(&self) -> impl ExactSizeIterator<Item = (u8, Option<Pulse>)> {
        self.channels.iter().enumerate().map(|(k, (channel, axis))| {
            let begun = usize::from(self.age) > k * usize::from(STAGGER_HOPS);
            (channel.output, begun.then(|| axis.pulse()))
        })
    }

    /// Number of the output and its pulse, channel by channel.
    pub fn pulses(&self) -> impl Iterator<Item = (u8, Pulse)> {
        self.channels
            .iter()
            .map(|(channel, axis)| (channel.output, axis.pulse()))
    }
}

impl Channel {
    /// The pulse that `mouth` asks for, between the end stops, before limits of speed and acceleration.
    pub fn target(&self, mouth: &Mouth) -> Pulse {
        let visemes = mouth.viseme_weights.iter().zip(&self.viseme_weights);
        // 255 becomes 32767. At most 15 products below 2²²: the sum fits in 26 bits.
        let seen: i32 = visemes
            .map(|(x, w)| (i32::from(*x) * 128 + i32::from(*x) / 2) * i32::from(*w))
            .sum();
        let measured = i32::from(mouth.gap) * i32::from(self.gap_weight)
            + i32::from(mouth.width) * i32::from(self.width_weight);
        let position = saturate_i16((seen + measured) / i32::from(WEIGHT_ONE));
        let travel = self.travel(position.unsigned_abs());
        let towards_highest = (position >= 0) != self.reversed;
        // The checked table has lowest ≤ centre ≤ highest, and a travel is at most 1: no difference is negative, no pulse outside.
        if towards_highest {
            self.centre + share(self.highest - self.centre, travel)
        } else {
            self.centre - share(self.centre - self.lowest, travel)
        }
    }

    /// The linkage: share of the way to the end stop, Q15, for a `position` of 0..=32768 in Q15, by straight lines between the curve's points.
    fn travel(&self, position: u16) -> u16 {
        const SEGMENT: u32 = (1 << 15) / N_CURVE as u32;
        let segment = u32::from(position) / SEGMENT;
        let point = |k: u32| match k.checked_sub(1) {
            None => 0,
            // Beyond the last point lies nothing: its own value.
            Some(k) => u32::from(self.curve[(k as usize).min(N_CURVE - 1)]),
        };
        let (from, to) = (point(segment), point(segment + 1));
        // Rising curve of at most 2¹⁵: the product is below 2²⁷.
        (from + (to - from) * (u32::from(position) % SEGMENT) / SEGMENT) as u16
    }
}

/// `travel` (Q15, at most 1) of `way`, to the nearest.
fn share(way: u16, travel: u16) -> u16 {
    ((u32::from(way) * u32::from(travel) + (1 << 14)) >> 15) as u16
}
