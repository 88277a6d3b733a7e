//! Servos of a board: frames in, pulses out, by the calibration in flash.
//!
//! A board brings [`Outputs`] for each driver that it has: [`pins`] over `embedded-hal`'s PWM, [`pca9685`] over its I²C, [`lines`] over anything that takes
//! bytes. [`Rig`] checks the calibration against the model and the board, and lets them follow the frames. Nothing moves before the first frame; where the
//! calibration is of no use nothing ever does, and the [`Notice`] says why.
pub mod lines;
pub mod pca9685;
pub mod pins;

use core::fmt;

use lipstream_core::ParameterFrame;
use lipstream_core::model::Head;
use lipstream_core::servo::{
    Calibration, CalibrationError, Driver, Mouth, Pulse, ReadOut, Servos, stated_length,
};
use lipstream_core::wire::Notice;

/// A channel's output and its pulse; None as long as it is to have none.
pub type Wanted = (u8, Option<Pulse>);

/// What makes pulses. A pulse stays until the next one.
pub trait Outputs {
    /// Whether there is an output of this number.
    fn has(&self, output: u8) -> bool;

    /// These pulses from now on, once a hop; an error where they may not have arrived.
    ///
    /// # Errors
    ///
    /// [`NoAnswer`] from what does not answer.
    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer>;

    /// No pulses on any output: hobby servos let go.
    fn release(&mut self);
}

/// What makes the pulses does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoAnswer;

/// What follows an application's frames.
pub trait Follower {
    /// A frame was made.
    fn frame(&mut self, frame: &ParameterFrame);

    /// A hop without a frame, of a stream that has ended or stands still.
    fn idle(&mut self);

    /// What people should know.
    fn notice(&self) -> Option<&Notice>;

    /// Whether that is new since this was last asked.
    fn has_news(&mut self) -> bool;
}

impl<F: Follower + ?Sized> Follower for &mut F {
    fn frame(&mut self, frame: &ParameterFrame) {
        (**self).frame(frame);
    }

    fn idle(&mut self) {
        (**self).idle();
    }

    fn notice(&self) -> Option<&Notice> {
        (**self).notice()
    }

    fn has_news(&mut self) -> bool {
        (**self).has_news()
    }
}

/// A board without servos.
#[derive(Clone, Copy, Debug)]
pub struct NoServos;

impl Follower for NoServos {
    fn frame(&mut self, _: &ParameterFrame) {}

    fn idle(&mut self) {}

    fn notice(&self) -> Option<&Notice> {
        None
    }

    fn has_news(&mut self) -> bool {
        false
    }
}

/// One of two kinds of outputs, for a board that has both.
pub enum Either<A, B> {
    /// The first.
    A(A),
    /// The other.
    B(B),
}

impl<A: Outputs, B: Outputs> Outputs for Either<A, B> {
    fn has(&self, output: u8) -> bool {
        match self {
            Self::A(outputs) => outputs.has(output),
            Self::B(outputs) => outputs.has(output),
        }
    }

    fn give(&mut self, pulses: &mut dyn Iterator<Item = Wanted>) -> Result<(), NoAnswer> {
        match self {
            Self::A(outputs) => outputs.give(pulses),
            Self::B(outputs) => outputs.give(pulses),
        }
    }

    fn release(&mut self) {
        match self {
            Self::A(outputs) => outputs.release(),
            Self::B(outputs) => outputs.release(),
        }
    }
}

/// Why servos stay off.
enum Refusal {
    Calibration(CalibrationError),
    Driver(Driver, &'static str),
    Output(Driver, u8),
    NoReadOut,
    OtherModel { have: u32, want: u32 },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            // What a region of flash is that nobody wrote to.
            Self::Calibration(CalibrationError::NoCalibration) => {
                f.write_str("there is no calibration in flash")
            }
            Self::Calibration(error) => error.fmt(f),
            Self::Driver(driver, why) => write!(f, "{}: {why}", driver.name()),
            Self::Output(driver, output) => write!(f, "{} has no output {output}", driver.name()),
            Self::NoReadOut => {
                f.write_str("the calibration does not say how gap and width are read: write its table again")
            }
            Self::OtherModel { have, want } => write!(
                f,
                "the calibration is for model {have:08x} and this is {want:08x}: write its table with this one"
            ),
        }
    }
}

/// A board's servos.
pub struct Rig<O> {
    /// None where they stay off.
    moving: Option<Moving<O>>,
    notice: Option<Notice>,
    news: bool,
}

/// Servos that follow.
struct Moving<O> {
    outputs: O,
    driver: Driver,
    read_out: Option<ReadOut>,
    servos: Servos,
    /// The last pulses may not have arrived.
    mute: bool,
}

impl<O: Outputs> Rig<O> {
    /// The servos of the calibration that `region`, a part of flash, begins with, for frames of the model with this head. `outputs` makes the board's
    /// outputs for a driver, or says why it has none.
    pub fn new(region: &[u8], head: &Head, outputs: impl FnOnce(Driver) -> Result<O, &'static str>) -> Self {
        let (moving, notice) = match Moving::of(region, head, outputs) {
            Ok(moving) => (Some(moving), None),
            Err(refusal) => {
                let words = format_args!("servos stay off: {refusal}");
                (None, Some(Notice::new(words)))
            }
        };
        // The first `Hello` brings it.
        Self {
            moving,
            notice,
            news: false,
        }
    }

    fn move_by(&mut self, step: impl FnOnce(&mut Moving<O>)) {
        let Some(moving) = &mut self.moving else {
            return;
        };
        step(moving);
        let mute = moving.outputs.give(&mut moving.servos.driven()).is_err();
        if mute != moving.mute {
            moving.mute = mute;
            let name = moving.driver.name();
            let words = match mute {
                true => " does not answer: servos are not moved; look at its wires and its supply",
                false => " answers again",
            };
            self.notice = Some(Notice::new(format_args!("{name}{words}")));
            self.news = true;
        }
    }
}

impl<O: Outputs> Moving<O> {
    fn of(
        region: &[u8],
        head: &Head,
        outputs: impl FnOnce(Driver) -> Result<O, &'static str>,
    ) -> Result<Self, Refusal> {
        let length = stated_length(region).unwrap_or(region.len());
        let table = &region[..length.min(region.len())];
        let calibration = Calibration::new_checked(table).map_err(Refusal::Calibration)?;
        if calibration.needs_read_out() {
            let read_out = calibration.read_out().ok_or(Refusal::NoReadOut)?;
            let (have, want) = (read_out.model(), head.id());
            if have != want || read_out.n_parameters() != head.n_parameters() {
                return Err(Refusal::OtherModel { have, want });
            }
        }
        let driver = calibration.driver();
        let mut outputs = outputs(driver).map_err(|why| Refusal::Driver(driver, why))?;
        outputs.release();
        let missing = calibration.channels().iter().find(|c| !outputs.has(c.output));
        if let Some(channel) = missing {
            return Err(Refusal::Output(driver, channel.output));
        }
        Ok(Self {
            outputs,
            driver,
            read_out: calibration.read_out().cloned(),
            servos: Servos::slowly(&calibration),
            mute: false,
        })
    }

    fn follow(&mut self, frame: &ParameterFrame) {
        let read = |lines: &ReadOut| lines.read(&frame.values);
        let (gap, width) = self.read_out.as_ref().map_or((0, 0), read);
        self.servos.step(&Mouth {
            gap,
            width,
            viseme_weights: &frame.viseme_weights,
        });
    }
}

impl<O: Outputs> Follower for Rig<O> {
    fn frame(&mut self, frame: &ParameterFrame) {
        self.move_by(|moving| moving.follow(frame));
    }

    fn idle(&mut self) {
        // What never got a pulse gets none for a stream that has not begun.
        let begun = |moving: &Moving<O>| moving.servos.driven().any(|(_, pulse)| pulse.is_some());
        if self.moving.as_ref().is_some_and(begun) {
            self.move_by(|moving| moving.servos.rest());
        }
    }

    fn notice(&self) -> Option<&Notice> {
        self.notice.as_ref()
    }

    fn has_news(&mut self) -> bool {
        core::mem::take(&mut self.news)
    }
}

#[cfg(test)]
mod tests;
