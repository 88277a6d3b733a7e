//! The calibration: a little-endian table with a checksum, as it lies in flash.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | [`MAGIC`] |
//! | 2 | [`VERSION`] |
//! | 2 | number of channels, 1 to 6 |
//! | 1 | [`Driver`]: what makes the pulses; 1 byte 0 |
//! | 2 | D, parameters of the read-out, or 0 where there is none |
//! | 46 each | a channel: role, output, reversed (0 or 1), 0; lowest, centre, highest, speed, acceleration (u16); weights of gap, width and 13 visemes (i8), 0; curve (8 × u16) |
//! | 20 + 4 D | the read-out ([`ReadOut`]), if there is one |
//! | 4 | CRC-32 of all before it |
use core::fmt;

use super::Pulse;
use super::bytes::{Bytes, Table};
use super::read_out::{self, ReadOut};
use crate::frame::{MAX_PARAMETERS, N_VISEMES};
use crate::model::container::checksum;

/// Most channels of a calibration.
pub const MAX_CHANNELS: usize = 6;
/// Points of a linkage's curve.
pub const N_CURVE: usize = 8;
/// The curve of a linkage without bends, or of none: equal steps.
pub const STRAIGHT: [u16; N_CURVE] = [
    1 << 12,
    2 << 12,
    3 << 12,
    4 << 12,
    5 << 12,
    6 << 12,
    7 << 12,
    8 << 12,
];
/// The weight that is 1.
pub const WEIGHT_ONE: i8 = 64;
/// First bytes of a calibration.
const MAGIC: [u8; 8] = *b"lipservo";
/// Layout of the table.
const VERSION: u16 = 2;
const HEADER: usize = 16;
const RECORD: usize = 14 + 2 + N_VISEMES + 1 + 2 * N_CURVE;
const CRC_SIZE: usize = 4;
/// Bytes of a calibration with all channels and all parameters.
pub const LONGEST_CALIBRATION: usize = size(MAX_CHANNELS, MAX_PARAMETERS);
/// Pulses that hobby servos understand, ¼ µs: 400 to 2600 µs. What lies outside is a mistake of the table.
const PULSES: core::ops::RangeInclusive<Pulse> = 1_600..=10_400;

const fn size(channels: usize, parameters: usize) -> usize {
    let read_out = if parameters == 0 {
        0
    } else {
        read_out::size(parameters)
    };
    HEADER + channels * RECORD + read_out + CRC_SIZE
}

/// What a channel moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Role {
    /// The lower jaw, up and down.
    Jaw,
    /// The corners of the mouth, in and out.
    Width,
    /// The upper lip, up and down.
    UpperLip,
    /// The lower lip, up and down, on the jaw.
    LowerLip,
    /// The tongue, up and down.
    Tongue,
    /// Anything else.
    Spare,
}

impl Role {
    const ALL: [Self; MAX_CHANNELS] = [
        Self::Jaw,
        Self::Width,
        Self::UpperLip,
        Self::LowerLip,
        Self::Tongue,
        Self::Spare,
    ];
}

/// What makes a device's pulses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Driver {
    /// The board's own pins.
    #[default]
    Pins,
    /// NXP's PCA9685 on the board's I²C bus.
    Pca9685,
    /// Pololu's Maestro on a serial line.
    Maestro,
    /// Another board that reads lines of pulses in µs.
    Csv,
}

impl Driver {
    const ALL: [Self; 4] = [Self::Pins, Self::Pca9685, Self::Maestro, Self::Csv];

    /// The word for it in calibrations that people write, and in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pins => "pins",
            Self::Pca9685 => "pca9685",
            Self::Maestro => "maestro",
            Self::Csv => "csv",
        }
    }

    /// The driver of this name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|driver| driver.name() == name)
    }

    /// Every name, in order.
    pub const NAMES: [&'static str; 4] = {
        let [a, b, c, d] = Self::ALL;
        [a.name(), b.name(), c.name(), d.name()]
    };
}

/// One servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Channel {
    /// What it moves.
    pub role: Role,
    /// Number of the board's output.
    pub output: u8,
    /// A position above 0 goes towards the lowest pulse instead of the highest.
    pub reversed: bool,
    /// End stop, ¼ µs.
    pub lowest: Pulse,
    /// At rest, ¼ µs.
    pub centre: Pulse,
    /// End stop, ¼ µs.
    pub highest: Pulse,
    /// Most ¼ µs a hop of 10 ms, not 0.
    pub speed: u16,
    /// Most ¼ µs a hop that the speed changes by at a hop, not 0.
    pub acceleration: u16,
    /// Of the gap; [`WEIGHT_ONE`] = 1.
    pub gap_weight: i8,
    /// Of the width.
    pub width_weight: i8,
    /// Of each viseme.
    pub viseme_weights: [i8; N_VISEMES],
    /// The linkage: share of the way to an end stop at positions 1/8, 2/8 … 1, Q15, never falling, at most 32768.
    pub curve: [u16; N_CURVE],
}

/// Why bytes, or channels, are no calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(missing_docs)]
pub enum CalibrationError {
    /// Does not begin with the magic bytes.
    NoCalibration,
    /// Layout of another version.
    Version { have: u16, want: u16 },
    /// None, or more than [`MAX_CHANNELS`].
    Channels { have: usize },
    /// Not as long as its channels take.
    Length { have: usize, need: usize },
    /// The bytes have changed since they were written.
    Checksum { stated: u32, computed: u32 },
    /// A number of a channel that no servo can be driven by.
    Channel { channel: usize, what: &'static str },
    /// Two channels of one output.
    SameOutput { output: u8 },
    /// A driver that this program does not know, or bytes beside it that are not 0.
    Driver,
    /// A number of the read-out that cannot be, or too many parameters.
    ReadOut,
}

impl fmt::Display for CalibrationError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::NoCalibration => f.write_str("no servo calibration: the first bytes are others"),
            Self::Version { have, want } => {
                write!(
                    f,
                    "a servo calibration of version {have}; this program reads {want}"
                )
            }
            Self::Channels { have } => write!(
                f,
                "a servo calibration of {have} channels; 1 to {MAX_CHANNELS} are possible"
            ),
            Self::Length { have, need } => write!(
                f,
                "a servo calibration of {have} bytes, where its channels take {need}"
            ),
            Self::Checksum { stated, computed } => write!(
                f,
                "a damaged servo calibration: its checksum is {computed:08x}, and {stated:08x} is stated; write it again"
            ),
            Self::Channel { channel, what } => write!(f, "servo calibration, channel {channel}: {what}"),
            Self::SameOutput { output } => write!(f, "servo calibration: two channels have output {output}"),
            Self::Driver => f.write_str("servo calibration: a driver that this program does not know"),
            Self::ReadOut => f.write_str("servo calibration: a read-out of gap and width that cannot be"),
        }
    }
}

impl core::error::Error for CalibrationError {}

/// Channels that have been checked, what makes their pulses, and how gap and width are read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Calibration {
    channels: heapless::Vec<Channel, MAX_CHANNELS>,
    driver: Driver,
    read_out: Option<ReadOut>,
}

/// How long the table says it is that these bytes begin with; none where they begin with no table of this version. For one that lies in a
/// larger region of memory: everything else about it is still to be checked.
pub fn stated_length(bytes: &[u8]) -> Option<usize> {
    let (channels, _, parameters) = header(&mut Bytes(bytes)).ok()?;
    Some(size(channels, parameters))
}

/// Number of channels, number of the driver, number of parameters; what is wrong with the first of them that is.
fn header(from: &mut Bytes) -> Result<(usize, u8, usize), CalibrationError> {
    let have = from.0.len();
    if from.take() != Some(MAGIC) {
        return Err(CalibrationError::NoCalibration);
    }
    let cut = CalibrationError::Length {
        have,
        need: size(1, 0),
    };
    let version = from.u16().ok_or(cut)?;
    if version != VERSION {
        return Err(CalibrationError::Version {
            have: version,
            want: VERSION,
        });
    }
    let channels = usize::from(from.u16().ok_or(cut)?);
    if channels == 0 || channels > MAX_CHANNELS {
        return Err(CalibrationError::Channels { have: channels });
    }
    let [driver, zero] = from.take().ok_or(cut)?;
    let parameters = usize::from(from.u16().ok_or(cut)?);
    if zero != 0 {
        return Err(CalibrationError::Driver);
    }
    if parameters > MAX_PARAMETERS {
        return Err(CalibrationError::ReadOut);
    }
    Ok((channels, driver, parameters))
}

impl Calibration {
    /// Checks `channels`. They are driven by the board's pins, and nothing reads gap and width, until it is said otherwise.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`]: their number, or a number in one of them.
    pub fn of(channels: &[Channel]) -> Result<Self, CalibrationError> {
        let have = channels.len();
        let all = heapless::Vec::from_slice(channels).map_err(|_| CalibrationError::Channels { have })?;
        if all.is_empty() {
            return Err(CalibrationError::Channels { have });
        }
        for (k, channel) in all.iter().enumerate() {
            check(channel).map_err(|what| CalibrationError::Channel { channel: k, what })?;
            if all
                .iter()
                .take(k)
                .any(|other: &Channel| other.output == channel.output)
            {
                return Err(CalibrationError::SameOutput {
                    output: channel.output,
                });
            }
        }
        Ok(Self {
            channels: all,
            driver: Driver::default(),
            read_out: None,
        })
    }

    /// Reads a table and checks it.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`]: what is wrong with the bytes.
    pub fn new_checked(bytes: &[u8]) -> Result<Self, CalibrationError> {
        let mut from = Bytes(bytes);
        let (n, driver, parameters) = header(&mut from)?;
        let need = size(n, parameters);
        let wrong = CalibrationError::Length {
            have: bytes.len(),
            need,
        };
        if bytes.len() != need {
            return Err(wrong);
        }
        let (body, stated) = bytes.split_last_chunk::<CRC_SIZE>().ok_or(wrong)?;
        let (stated, computed) = (u32::from_le_bytes(*stated), checksum(body));
        if stated != computed {
            return Err(CalibrationError::Checksum { stated, computed });
        }
        let mut channels = heapless::Vec::<Channel, MAX_CHANNELS>::new();
        for channel in 0..n {
            let read = self::channel(&mut from).ok_or(wrong)?;
            let read = read.map_err(|what| CalibrationError::Channel { channel, what })?;
            channels.push(read).map_err(|_| wrong)?;
        }
        let mut calibration = Self::of(&channels)?;
        let known = Driver::ALL.get(usize::from(driver));
        calibration.driver = *known.ok_or(CalibrationError::Driver)?;
        if parameters > 0 {
            calibration.read_out = Some(ReadOut::parse(&mut from, parameters).ok_or(wrong)??);
        }
        Ok(calibration)
    }

    /// The table.
    pub fn to_bytes(&self) -> heapless::Vec<u8, LONGEST_CALIBRATION> {
        let mut to = Table::default();
        to.put(&MAGIC);
        to.put(&VERSION.to_le_bytes());
        to.put(&(self.channels.len() as u16).to_le_bytes());
        to.put(&[self.driver as u8, 0]);
        let parameters = self.read_out.as_ref().map_or(0, ReadOut::n_parameters);
        to.put(&(parameters as u16).to_le_bytes());
        for c in &self.channels {
            to.put(&[c.role as u8, c.output, u8::from(c.reversed), 0]);
            for number in [c.lowest, c.centre, c.highest, c.speed, c.acceleration] {
                to.put(&number.to_le_bytes());
            }
            to.put(&[c.gap_weight, c.width_weight].map(i8::cast_unsigned));
            to.put(&c.viseme_weights.map(i8::cast_unsigned));
            to.put(&[0]);
            for point in c.curve {
                to.put(&point.to_le_bytes());
            }
        }
        if let Some(read_out) = &self.read_out {
            read_out.put(&mut to);
        }
        let sum = checksum(&to.0);
        to.put(&sum.to_le_bytes());
        to.0
    }

    /// The same channels with another driver.
    pub fn driven_by(self, driver: Driver) -> Self {
        Self { driver, ..self }
    }

    /// The same channels, gap and width read so, or not at all.
    pub fn reading(self, read_out: Option<ReadOut>) -> Self {
        Self { read_out, ..self }
    }

    /// What makes a device's pulses.
    pub fn driver(&self) -> Driver {
        self.driver
    }

    /// How gap and width are read out of parameters, if that is said.
    pub fn read_out(&self) -> Option<&ReadOut> {
        self.read_out.as_ref()
    }

    /// Whether any channel moves by gap or width, so that they must be read.
    pub fn needs_read_out(&self) -> bool {
        self.channels
            .iter()
            .any(|c| c.gap_weight != 0 || c.width_weight != 0)
    }

    /// The channels.
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }
}

fn check(channel: &Channel) -> Result<(), &'static str> {
    let c = channel;
    let complaints = [
        (
            !PULSES.contains(&c.lowest) || !PULSES.contains(&c.highest),
            "an end stop outside 400 to 2600 µs",
        ),
        (
            c.lowest > c.centre || c.centre > c.highest,
            "the centre is not between the end stops",
        ),
        (c.lowest == c.highest, "the end stops are the same"),
        (c.speed == 0, "a speed of 0"),
        (c.acceleration == 0, "an acceleration of 0"),
        (!c.curve.is_sorted(), "the linkage's curve falls"),
        (
            c.curve.iter().any(|point| *point > 1 << 15),
            "the linkage's curve goes beyond the end stop",
        ),
        // Maestro's channels are numbered in seven bits.
        (c.output > 0x7f, "an output above 127"),
    ];
    complaints
        .iter()
        .find(|(wrong, _)| *wrong)
        .map_or(Ok(()), |(_, what)| Err(what))
}

/// The next channel. None where the bytes end; what is wrong where they say something impossible.
fn channel(from: &mut Bytes) -> Option<Result<Channel, &'static str>> {
    let [role, output, reversed, zero] = from.take()?;
    let [lowest, centre, highest] = [from.u16()?, from.u16()?, from.u16()?];
    let [speed, acceleration] = [from.u16()?, from.u16()?];
    let [gap_weight, width_weight] = from.take()?.map(u8::cast_signed);
    let viseme_weights = from.take()?.map(u8::cast_signed);
    let [last] = from.take()?;
    let mut curve = [0; N_CURVE];
    for point in &mut curve {
        *point = from.u16()?;
    }
    let Some(role) = Role::ALL.get(usize::from(role)).copied() else {
        return Some(Err("a role that this program does not know"));
    };
    if reversed > 1 || zero != 0 || last != 0 {
        return Some(Err("a direction or a filling byte that is not 0 or 1"));
    }
    Some(Ok(Channel {
        role,
        output,
        reversed: reversed == 1,
        lowest,
        centre,
        highest,
        speed,
        acceleration,
        gap_weight,
        width_weight,
        viseme_weights,
        curve,
    }))
}
