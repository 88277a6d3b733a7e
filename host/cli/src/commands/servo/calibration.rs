//! The calibration as people write it: JSON in microseconds and seconds, one object a channel. `docs/servos.md` explains its words.
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use lipstream::linkage::JawLinkage;
use lipstream::phones::VISEMES;
use lipstream_core::servo::{Calibration, Channel, Driver, Role, STRAIGHT, WEIGHT_ONE};
use lipstream_media::files;
use serde::Deserialize;

/// Units of a pulse in a µs.
const PER_US: f64 = 4.0;
/// Hops in a second.
const HOPS: f64 = 100.0;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    driver: Option<String>,
    channels: Vec<WrittenChannel>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenChannel {
    #[serde(with = "WrittenRole")]
    role: Role,
    output: u8,
    #[serde(default)]
    reversed: bool,
    lowest_us: f64,
    centre_us: f64,
    highest_us: f64,
    speed_us_per_s: f64,
    acceleration_us_per_s2: f64,
    #[serde(default)]
    gap: f64,
    #[serde(default)]
    width: f64,
    #[serde(default)]
    visemes: std::collections::BTreeMap<String, f64>,
    linkage: Option<WrittenLinkage>,
}

/// What serde reads a [`Role`] by.
#[derive(Deserialize)]
#[serde(remote = "Role", rename_all = "snake_case")]
enum WrittenRole {
    Jaw,
    Width,
    UpperLip,
    LowerLip,
    Tongue,
    Spare,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenLinkage {
    lips_mm: f64,
    lever_mm: f64,
    horn_mm: f64,
    widest_gap_mm: f64,
}

/// What people call a role.
pub(super) fn role_name(role: Role) -> &'static str {
    match role {
        Role::Jaw => "jaw",
        Role::Width => "width",
        Role::UpperLip => "upper_lip",
        Role::LowerLip => "lower_lip",
        Role::Tongue => "tongue",
        Role::Spare => "spare",
    }
}

/// Reads a calibration: JSON, or the table that `--write-table` writes.
pub(super) fn read(path: &Path) -> Result<Calibration> {
    let bytes = files::read_bytes(path)?;
    let checked = match bytes.iter().find(|b| !b.is_ascii_whitespace()) {
        Some(b'{') => of_json(&bytes),
        _ => Calibration::new_checked(&bytes).map_err(Into::into),
    };
    checked.with_context(|| format!("{} is no usable calibration", path.display()))
}

fn of_json(bytes: &[u8]) -> Result<Calibration> {
    let written: Written = serde_json::from_slice(bytes)?;
    let channels = written.channels.iter().enumerate();
    let channels: Vec<Channel> = channels
        .map(|(k, channel)| channel.checked().with_context(|| format!("channel {k}")))
        .collect::<Result<_>>()?;
    let driver = match &written.driver {
        None => Driver::default(),
        Some(name) => Driver::of_name(name)
            .with_context(|| format!("{name:?} is no driver; there are {}", Driver::NAMES.join(", ")))?,
    };
    Ok(Calibration::of(&channels)?.driven_by(driver))
}

/// A limit of the file in the table's unit, rounded down, so that a limit is never more than what was asked for.
fn whole(what: &str, number: f64, scale: f64) -> Result<u16> {
    // A limit that is exact in decimals must not fall below itself by the rounding of floats.
    let scaled = (number * scale + 1e-6).floor();
    if !(0.0..=f64::from(u16::MAX)).contains(&scaled) {
        bail!("{what} {number} is out of range");
    }
    Ok(scaled as u16)
}

/// A pulse in the table's unit: none is moved by rounding, since it may be an end stop.
fn pulse(what: &str, us: f64) -> Result<u16> {
    let pulse = us * PER_US;
    if pulse.fract() != 0.0 || !(0.0..=f64::from(u16::MAX)).contains(&pulse) {
        bail!("{what} {us} is no pulse: 400 to 2600 µs in steps of 0.25");
    }
    Ok(pulse as u16)
}

fn weight(what: &str, number: f64) -> Result<i8> {
    let scaled = (number * f64::from(WEIGHT_ONE)).round();
    if !(f64::from(i8::MIN)..=f64::from(i8::MAX)).contains(&scaled) {
        bail!("the weight of {what} is {number}; it must lie between -2 and 1.98");
    }
    Ok(scaled as i8)
}

impl WrittenChannel {
    fn checked(&self) -> Result<Channel> {
        let mut viseme_weights = [0; VISEMES.len()];
        for (name, number) in &self.visemes {
            let Some(k) = VISEMES.iter().position(|viseme| viseme == name) else {
                bail!("{name:?} is no viseme; there are {}", VISEMES.join(", "));
            };
            viseme_weights[k] = weight(name, *number)?;
        }
        Ok(Channel {
            role: self.role,
            output: self.output,
            reversed: self.reversed,
            lowest: pulse("lowest_us", self.lowest_us)?,
            centre: pulse("centre_us", self.centre_us)?,
            highest: pulse("highest_us", self.highest_us)?,
            speed: whole("speed_us_per_s", self.speed_us_per_s, PER_US / HOPS)?,
            acceleration: whole(
                "acceleration_us_per_s2",
                self.acceleration_us_per_s2,
                PER_US / HOPS / HOPS,
            )?,
            gap_weight: weight("gap", self.gap)?,
            width_weight: weight("width", self.width)?,
            viseme_weights,
            curve: match &self.linkage {
                Some(jaw) => JawLinkage {
                    lips_mm: jaw.lips_mm,
                    lever_mm: jaw.lever_mm,
                    horn_mm: jaw.horn_mm,
                    widest_gap_mm: jaw.widest_gap_mm,
                }
                .curve()?,
                None => STRAIGHT,
            },
        })
    }
}
