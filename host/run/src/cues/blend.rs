//! Viseme weights as weights of the Oculus lip-sync set (15 visemes) and of ARKit's 52 blend shapes, as CSV with one
//! row every 10 ms.
use std::io::{self, Write};

use super::check;
use crate::out::Numbers;
use crate::phones::VISEMES;
use crate::session::Frame;
use crate::time::frame_seconds;

/// The Oculus lip-sync visemes, in their order.
pub const OCULUS: [&str; 15] = [
    "sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E", "I", "O", "U",
];

/// Shares of each viseme, in the order of [`VISEMES`], among the Oculus visemes; each row adds up to 1. A class
/// of ours that is two of theirs is shared out by how often its phones are heard in English.
const TO_OCULUS: [&[(usize, f32)]; VISEMES.len()] = [
    &[(0, 1.0)],
    &[(10, 0.7), (13, 0.3)],
    &[(14, 0.6), (13, 0.4)],
    &[(11, 1.0)],
    &[(12, 1.0)],
    &[(8, 0.45), (9, 0.55)],
    &[(7, 1.0)],
    &[(4, 0.6), (8, 0.4)],
    &[(6, 1.0)],
    &[(1, 1.0)],
    &[(3, 1.0)],
    &[(2, 1.0)],
    &[(5, 0.7), (14, 0.3)],
];

/// ARKit's 52 blend shapes, in the order of Apple's documentation.
pub const ARKIT: [&str; 52] = [
    "eyeBlinkLeft",
    "eyeLookDownLeft",
    "eyeLookInLeft",
    "eyeLookOutLeft",
    "eyeLookUpLeft",
    "eyeSquintLeft",
    "eyeWideLeft",
    "eyeBlinkRight",
    "eyeLookDownRight",
    "eyeLookInRight",
    "eyeLookOutRight",
    "eyeLookUpRight",
    "eyeSquintRight",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawRight",
    "jawOpen",
    "mouthClose",
    "mouthFunnel",
    "mouthPucker",
    "mouthLeft",
    "mouthRight",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "noseSneerLeft",
    "noseSneerRight",
    "tongueOut",
];

/// What each viseme does to ARKit's shapes, in the order of [`VISEMES`]. A name without Left or Right moves both.
const TO_ARKIT: [&[(&str, f32)]; VISEMES.len()] = [
    &[],
    &[("jawOpen", 0.55), ("mouthFunnel", 0.15), ("mouthLowerDown", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.7), ("mouthFunnel", 0.35)],
    &[
        ("jawOpen", 0.4),
        ("mouthStretch", 0.3),
        ("mouthLowerDown", 0.35),
        ("mouthUpperUp", 0.15),
    ],
    &[
        ("jawOpen", 0.15),
        ("mouthStretch", 0.35),
        ("mouthSmile", 0.2),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("jawOpen", 0.2),
        ("mouthFunnel", 0.2),
        ("mouthLowerDown", 0.15),
        ("tongueOut", 0.05),
    ],
    &[
        ("jawOpen", 0.05),
        ("mouthStretch", 0.25),
        ("mouthLowerDown", 0.3),
        ("mouthUpperUp", 0.1),
    ],
    &[
        ("jawOpen", 0.12),
        ("mouthStretch", 0.15),
        ("mouthLowerDown", 0.25),
    ],
    &[
        ("jawOpen", 0.1),
        ("mouthFunnel", 0.5),
        ("mouthPucker", 0.15),
        ("mouthLowerDown", 0.2),
    ],
    &[
        ("mouthPress", 0.4),
        ("mouthRollLower", 0.3),
        ("mouthRollUpper", 0.2),
    ],
    &[("jawOpen", 0.15), ("tongueOut", 0.25), ("mouthLowerDown", 0.2)],
    &[("jawOpen", 0.05), ("mouthRollLower", 0.5), ("mouthUpperUp", 0.25)],
    &[("jawOpen", 0.2), ("mouthPucker", 0.15), ("mouthLowerDown", 0.15)],
];

/// A set of shapes whose weights an animation program blends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlendSet {
    /// The 15 visemes of Oculus lip sync, [`OCULUS`].
    Oculus,
    /// The 52 blend shapes of ARKit, [`ARKIT`].
    Arkit,
}

impl BlendSet {
    /// Names of the shapes, in their order.
    pub fn names(self) -> &'static [&'static str] {
        match self {
            BlendSet::Oculus => &OCULUS,
            BlendSet::Arkit => &ARKIT,
        }
    }

    /// Writes a header, then one row a frame: seconds of its centre, and the weight of each shape, 0 to 1.
    ///
    /// # Errors
    ///
    /// What `to` says.
    pub fn write<'w>(self, mut to: impl Write + 'w) -> io::Result<Box<dyn Numbers + 'w>> {
        writeln!(to, "time,{}", self.names().join(","))?;
        Ok(Box::new(Csv {
            to,
            blender: self.blender(),
        }))
    }

    /// What turns viseme weights into weights of this set.
    pub fn blender(self) -> Blender {
        Blender { rows: self.rows() }
    }

    /// Weight of every shape, for a weight of 1 of each viseme.
    fn rows(self) -> [Vec<f32>; VISEMES.len()] {
        let shapes = self.names().len();
        match self {
            BlendSet::Oculus => TO_OCULUS.map(|shares| {
                let mut row = vec![0.0; shapes];
                for &(k, share) in shares {
                    row[k] = share;
                }
                row
            }),
            BlendSet::Arkit => TO_ARKIT.map(|effects| {
                let mut row = vec![0.0; shapes];
                for &(name, amount) in effects {
                    for (k, shape) in ARKIT.iter().enumerate() {
                        if matches!(shape.strip_prefix(name), Some("" | "Left" | "Right")) {
                            row[k] = amount;
                        }
                    }
                }
                row
            }),
        }
    }
}

/// Viseme weights into weights of a [`BlendSet`].
#[derive(Clone, Debug)]
pub struct Blender {
    rows: [Vec<f32>; VISEMES.len()],
}

impl Blender {
    /// Weight of each shape of the set, 0 to 1, for viseme weights `[13]`; all 0 where a model has no visemes.
    pub fn blend(&self, visemes: impl IntoIterator<Item = f32>) -> Vec<f32> {
        let mut sums = vec![0.0f32; self.rows[0].len()];
        for (weight, row) in visemes.into_iter().zip(&self.rows) {
            for (sum, share) in sums.iter_mut().zip(row) {
                *sum += weight * share;
            }
        }
        for sum in &mut sums {
            *sum = sum.clamp(0.0, 1.0);
        }
        sums
    }
}

struct Csv<W> {
    to: W,
    blender: Blender,
}

impl<W: Write> Numbers for Csv<W> {
    fn frame(&mut self, frame: &Frame) -> io::Result<()> {
        check(frame.visemes, frame.index).map_err(io::Error::other)?;
        write!(self.to, "{:.4}", frame_seconds(frame.index))?;
        for weight in self.blender.blend(frame.visemes.iter().copied()) {
            write!(self.to, ",{weight:.3}")?;
        }
        writeln!(self.to)
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_and_every_oculus_viseme_is_reached() {
        let mut reached = [0.0; OCULUS.len()];
        for shares in TO_OCULUS {
            let sum: f32 = shares.iter().map(|(_, s)| s).sum();
            assert!((sum - 1.0).abs() < 1e-6);
            for &(k, s) in shares {
                reached[k] += s;
            }
        }
        assert!(reached.iter().all(|r| *r > 0.0), "{reached:?}");
    }

    #[test]
    fn every_effect_names_a_blend_shape() {
        for (name, amount) in TO_ARKIT.iter().flat_map(|e| e.iter()) {
            let found = ARKIT
                .iter()
                .filter(|s| matches!(s.strip_prefix(name), Some("" | "Left" | "Right")))
                .count();
            assert!(found == 1 || found == 2, "{name}");
            assert!((0.0..=1.0).contains(amount));
        }
    }
}
