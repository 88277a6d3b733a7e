//! The calibration: a little-endian table with a checksum, as it lies in flash.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | [`MAGIC`] |
//! | 2 | [`VERSION`] |
//! | 2 | number of channels, 1 to 6 |
//! | 46 each | a channel: role, output, reversed (0 or 1), 0; lowest, centre, highest, speed, acceleration (u16); weights of gap, width and 13 visemes (i8), 0; curve (8 × u16) |
//! | 4 | CRC-32 of all before it |
use core::fmt;

use super::Pulse;
use crate::frame::N_VISEMES;

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
const VERSION: u16 = 1;
const HEADER: usize = 12;
const RECORD: usize = 14 + 2 + N_VISEMES + 1 + 2 * N_CURVE;
const CRC_SIZE: usize = 4;
/// Bytes of a calibration with all channels.
pub const LONGEST_CALIBRATION: usize = HEADER + MAX_CHANNELS * RECORD + CRC_SIZE;
/// Pulses that hobby servos understand, ¼ µs: 400 to 2600 µs. What lies outside is a mistake of the table.
const PULSES: core::ops::RangeInclusive<Pulse> = 1_600..=10_400;

static CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);

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
        }
    }
}

impl core::error::Error for CalibrationError {}

/// Channels that have been checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Calibration {
    channels: heapless::Vec<Channel, MAX_CHANNELS>,
}

impl Calibration {
    /// Checks `channels`.
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
        Ok(Self { channels: all })
    }

    /// Reads a table and checks it.
    ///
    /// # Errors
    ///
    /// [`CalibrationError`]: what is wrong with the bytes.
    pub fn new_checked(bytes: &[u8]) -> Result<Self, CalibrationError> {
        let mut from = Reader(bytes);
        if from.take() != Some(MAGIC) {
            return Err(CalibrationError::NoCalibration);
        }
        let cut = CalibrationError::Length {
            have: bytes.len(),
            need: HEADER + RECORD + CRC_SIZE,
        };
        let have = from.u16().ok_or(cut)?;
        if have != VERSION {
            return Err(CalibrationError::Version { have, want: VERSION });
        }
        let n = usize::from(from.u16().ok_or(cut)?);
        if n == 0 || n > MAX_CHANNELS {
            return Err(CalibrationError::Channels { have: n });
        }
        let need = HEADER + n * RECORD + CRC_SIZE;
        let wrong = CalibrationError::Length {
            have: bytes.len(),
            need,
        };
        if bytes.len() != need {
            return Err(wrong);
        }
        let (body, stated) = bytes.split_last_chunk::<CRC_SIZE>().ok_or(wrong)?;
        let (stated, computed) = (u32::from_le_bytes(*stated), CRC.checksum(body));
        if stated != computed {
            return Err(CalibrationError::Checksum { stated, computed });
        }
        let mut channels = heapless::Vec::<Channel, MAX_CHANNELS>::new();
        for channel in 0..n {
            let read = from.channel().ok_or(wrong)?;
            let read = read.map_err(|what| CalibrationError::Channel { channel, what })?;
            channels.push(read).map_err(|_| wrong)?;
        }
        Self::of(&channels)
    }

    /// The table.
    pub fn to_bytes(&self) -> heapless::Vec<u8, LONGEST_CALIBRATION> {
        let mut bytes = heapless::Vec::new();
        let mut put = |piece: &[u8]| {
            let fits = bytes.extend_from_slice(piece);
            debug_assert!(fits.is_ok(), "LONGEST_CALIBRATION holds all channels");
        };
        put(&MAGIC);
        put(&VERSION.to_le_bytes());
        put(&(self.channels.len() as u16).to_le_bytes());
        for c in &self.channels {
            put(&[c.role as u8, c.output, u8::from(c.reversed), 0]);
            for number in [c.lowest, c.centre, c.highest, c.speed, c.acceleration] {
                put(&number.to_le_bytes());
            }
            put(&[c.gap_weight, c.width_weight].map(i8::cast_unsigned));
            put(&c.viseme_weights.map(i8::cast_unsigned));
            put(&[0]);
            for point in c.curve {
                put(&point.to_le_bytes());
            }
        }
        let sum = CRC.checksum(&bytes);
        let fits = bytes.extend_from_slice(&sum.to_le_bytes());
        debug_assert!(fits.is_ok(), "LONGEST_CALIBRATION holds the checksum");
        bytes
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

/// Bytes from the front.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    /// None where the bytes end; what is wrong where they say something impossible.
    fn channel(&mut self) -> Option<Result<Channel, &'static str>> {
        let [role, output, reversed, zero] = self.take()?;
        let [lowest, centre, highest] = [self.u16()?, self.u16()?, self.u16()?];
        let [speed, acceleration] = [self.u16()?, self.u16()?];
        let [gap_weight, width_weight] = self.take()?.map(u8::cast_signed);
        let viseme_weights = self.take()?.map(u8::cast_signed);
        let [last] = self.take()?;
        let mut curve = [0; N_CURVE];
        for point in &mut curve {
            *point = self.u16()?;
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
}
