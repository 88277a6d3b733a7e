//! How far a servo must turn for a jaw to open so far: the curve of a servo calibration ([`lipstream_core::servo`]), from lengths that a ruler
//! measures.
//!
//! A jaw that turns by θ about its hinge opens its lips, at a distance l of the hinge, by the chord g = 2·l·sin(θ/2). A push rod between
//! the servo's horn (r) and a lever on the jaw (q), at right angles to both while the mouth is closed and long beside them, shifts both ends by the same way:
//! q·sin θ = r·sin φ, with φ the angle of the horn.
use std::f64::consts::FRAC_PI_2;

use lipstream_core::servo::N_CURVE;

use crate::error::{Error, Result, ensure};

/// A jaw and the rod that moves it. All lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JawLinkage {
    /// From the jaw's hinge to the lips.
    pub lips_mm: f64,
    /// From the jaw's hinge to the rod.
    pub lever_mm: f64,
    /// From the servo's axle to the rod.
    pub horn_mm: f64,
    /// Between the lips when the servo is at its end stop.
    pub widest_gap_mm: f64,
}

impl JawLinkage {
    /// The horn's angle φ in radians at a gap of `gap_mm`; not a number where the rod does not reach.
    fn horn_angle(&self, gap_mm: f64) -> f64 {
        let jaw = 2.0 * (gap_mm / (2.0 * self.lips_mm)).asin();
        // Beyond a right angle the lever would come back.
        if jaw > FRAC_PI_2 {
            return f64::NAN;
        }
        (self.lever_mm * jaw.sin() / self.horn_mm).asin()
    }

    /// The horn's angle in degrees when the mouth is as wide open as it gets: what lies between a jaw's end stops.
    ///
    /// # Errors
    ///
    /// [`Error::Choice`]: a length is not above 0, or the jaw cannot open so far by this rod.
    pub fn widest_angle_degrees(&self) -> Result<f64> {
        let lengths = [self.lips_mm, self.lever_mm, self.horn_mm, self.widest_gap_mm];
        ensure!(
            lengths.iter().all(|length| length.is_finite() && *length > 0.0),
            Error::Choice,
            "a jaw's lengths must be above 0 mm; they are {lengths:?}"
        );
        let angle = self.horn_angle(self.widest_gap_mm);
        ensure!(
            angle.is_finite(),
            Error::Choice,
            "this jaw cannot open by {} mm: take a longer horn, a shorter lever or a smaller gap",
            self.widest_gap_mm
        );
        Ok(angle.to_degrees())
    }

    /// The curve for a channel that moves this jaw: shares of the horn's way, Q15, at an eighth, two eighths … of the widest gap.
    ///
    /// # Errors
    ///
    /// As [`JawLinkage::widest_angle_degrees`].
    pub fn curve(&self) -> Result<[u16; N_CURVE]> {
        let widest = self.widest_angle_degrees()?.to_radians();
        let gap = |k: usize| self.widest_gap_mm * (k + 1) as f64 / N_CURVE as f64;
        Ok(std::array::from_fn(|k| {
            (self.horn_angle(gap(k)) / widest * f64::from(1 << 15)).round() as u16
        }))
    }
}

#[cfg(test)]
mod tests {
    use lipstream_core::servo::{Calibration, Channel, Mouth, Role, STRAIGHT, WEIGHT_ONE};

    use super::*;

    /// A horn that is hardly longer than what it must pull: much out of proportion.
    const TIGHT: JawLinkage = JawLinkage {
        lips_mm: 80.0,
        lever_mm: 30.0,
        horn_mm: 12.0,
        widest_gap_mm: 30.0,
    };

    /// Largest error of the gap that a jaw opens by, as a share of the widest: from the pulse back through the geometry, solved the other way.
    fn gap_error(linkage: &JawLinkage, curve: [u16; N_CURVE]) -> f64 {
        let channel = Channel {
            role: Role::Jaw,
            output: 0,
            reversed: false,
            lowest: 4_000,
            centre: 4_000,
            highest: 8_000,
            speed: 240,
            acceleration: 60,
            gap_weight: WEIGHT_ONE,
            width_weight: 0,
            viseme_weights: [0; 13],
            curve,
        };
        Calibration::of(&[channel]).unwrap();
        let widest = linkage.widest_angle_degrees().unwrap().to_radians();
        let errors = (0..=i16::MAX).step_by(97).map(|gap| {
            let pulse = channel.target(&Mouth {
                gap,
                ..Mouth::default()
            });
            let horn = widest * (f64::from(pulse) - 4_000.0) / 4_000.0;
            let jaw = (linkage.horn_mm * horn.sin() / linkage.lever_mm).asin();
            let opened = 2.0 * linkage.lips_mm * (jaw / 2.0).sin() / linkage.widest_gap_mm;
            (opened - f64::from(gap) / 32_768.0).abs()
        });
        errors.fold(0.0, f64::max)
    }

    #[test]
    fn a_jaw_opens_in_proportion_to_the_gap() {
        let (with, without) = (
            gap_error(&TIGHT, TIGHT.curve().unwrap()),
            gap_error(&TIGHT, STRAIGHT),
        );
        println!(
            "error of the gap {:.2} % with the curve, {:.2} % without",
            100.0 * with,
            100.0 * without
        );
        assert!(with < 0.015 && without > 0.08, "{with} {without}");
        // Equal arms turn alike: an angle of 2·asin(30/160).
        let equal = JawLinkage {
            horn_mm: 30.0,
            ..TIGHT
        };
        assert!((equal.widest_angle_degrees().unwrap() - 21.614).abs() < 1e-3);
    }

    #[test]
    fn a_jaw_that_cannot_open_so_far_is_refused() {
        let refused = |linkage: JawLinkage| linkage.curve().unwrap_err().to_string();
        let far = "this jaw cannot open by 30 mm: take a longer horn, a shorter lever or a smaller gap";
        assert_eq!(
            refused(JawLinkage {
                horn_mm: 10.0,
                ..TIGHT
            }),
            far
        );
        assert_eq!(
            refused(JawLinkage {
                lips_mm: 14.0,
                ..TIGHT
            }),
            far
        );
        // The jaw at 90° or more.
        assert_eq!(
            refused(JawLinkage {
                lips_mm: 20.0,
                horn_mm: 60.0,
                ..TIGHT
            }),
            far
        );
        for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let words = refused(JawLinkage {
                lever_mm: wrong,
                ..TIGHT
            });
            assert!(words.starts_with("a jaw's lengths must be above 0 mm"), "{words}");
        }
    }
}
