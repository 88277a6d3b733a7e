//! Cue files for animation programs, from the viseme weights: mouth shapes over time in the formats of Rhubarb Lip
//! Sync, and tables for the Oculus (15 visemes) and ARKit (52 blend shapes) sets.
//!
//! | shape | mouth | visemes of X&L table 1 |
//! |---|---|---|
//! | A | lips closed | bi (p b m) |
//! | B | slightly open, teeth together | af (s z), al (t d n), pa (sh zh ch jh), de (th dh), ve (k g ng w), lr4 (ih iy) |
//! | C | open | lr3 (ae eh ey ay) |
//! | D | wide open | lr1 (ao aa ah er oy aw hh) |
//! | E | between D and F | lr1 and lr2 at once, neither twice the other |
//! | F | puckered | lr2 (uw uh ow) |
//! | G | teeth on the lip | ld (f v) |
//! | H | tongue raised | as (l r y) |
//! | X | rest | sip |
use ndarray::ArrayView2;

use crate::phones::{VISEMES, Viseme};

mod between;
mod blend;
mod closing;
mod formats;
mod rows;
mod search;
mod targets;

pub use blend::Blender;
pub use formats::{Format, Style, write, write_as};
pub use rows::{Rate, Table};
pub use search::Shapes;
pub use targets::{ARKIT, AZURE, BlendSet, FACS, OCULUS, POLLY, VRM};

/// A mouth shape of Rhubarb Lip Sync (the six of Preston Blair's tradition, and G, H, X).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shape {
    /// Lips closed: p, b, m.
    A,
    /// Slightly open with the teeth together: most consonants, and "ee".
    B,
    /// Open, as in "men".
    C,
    /// Wide open, as in "father".
    D,
    /// Between D and F: open and rounded.
    E,
    /// Lips puckered, as in "who".
    F,
    /// Upper teeth on the lower lip: f, v.
    G,
    /// Tongue raised: l, r, y.
    H,
    /// At rest: silence.
    X,
}

const SHAPES: [Shape; 9] = [
    Shape::A,
    Shape::B,
    Shape::C,
    Shape::D,
    Shape::E,
    Shape::F,
    Shape::G,
    Shape::H,
    Shape::X,
];

/// Shape of every viseme, in the order of [`VISEMES`].
const SHAPE_OF_VISEME: [Shape; VISEMES.len()] = [
    Shape::X,
    Shape::D,
    Shape::F,
    Shape::C,
    Shape::B,
    Shape::H,
    Shape::B,
    Shape::B,
    Shape::B,
    Shape::A,
    Shape::B,
    Shape::G,
    Shape::B,
];

impl Shape {
    /// The shape that shows a viseme.
    pub fn of(viseme: Viseme) -> Self {
        SHAPE_OF_VISEME[usize::from(viseme.0)]
    }

    /// The capital letter that stands for the shape in cue files.
    pub fn letter(self) -> char {
        match self {
            Shape::A => 'A',
            Shape::B => 'B',
            Shape::C => 'C',
            Shape::D => 'D',
            Shape::E => 'E',
            Shape::F => 'F',
            Shape::G => 'G',
            Shape::H => 'H',
            Shape::X => 'X',
        }
    }
}

impl Shape {
    /// The name of Preston Blair's tradition, as Rhubarb Lip Sync's documentation has it.
    pub fn preston_blair(self) -> &'static str {
        match self {
            Shape::A => "MBP",
            Shape::B => "etc",
            Shape::C => "E",
            Shape::D => "AI",
            Shape::E => "O",
            Shape::F => "U",
            Shape::G => "FV",
            Shape::H => "L",
            Shape::X => "rest",
        }
    }

    /// The shape of the six that every character has which comes nearest.
    pub fn basic(self) -> Shape {
        match self {
            Shape::G => Shape::B,
            Shape::H => Shape::C,
            Shape::X => Shape::A,
            basic => basic,
        }
    }
}

/// Cues for a character that has the six basic shapes and of G, H and X only those in `extended`: the others become the nearest basic ones.
pub fn drawn_with(cues: &[Cue], extended: &[Shape]) -> Vec<Cue> {
    let mut out: Vec<Cue> = Vec::new();
    for cue in cues {
        let shape = match extended.contains(&cue.shape) {
            true => cue.shape,
            false => cue.shape.basic(),
        };
        match out.last_mut().filter(|last| last.shape == shape) {
            Some(last) => last.end_s = cue.end_s,
            None => out.push(Cue { shape, ..*cue }),
        }
    }
    out
}

/// The mouth has one shape from `start_s` to `end_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cue {
    /// Start in seconds of the sound.
    pub start_s: f64,
    /// End in seconds of the sound.
    pub end_s: f64,
    /// What the mouth shows meanwhile.
    pub shape: Shape,
}

/// The likeliest sequence of shapes for viseme weights `[frames, 13]` at 100 Hz and the lip gap of each frame ([`crate::opening::Opening::gap`]), where it is
/// known, from 0 to `duration_s`. See [`Shapes`].
///
/// # Errors
///
/// [`CueError`]: there is no frame, or weights and gaps are not what they should be.
pub fn cues(weights: ArrayView2<f32>, gaps: Option<&[f32]>, duration_s: f64) -> Result<Vec<Cue>, CueError> {
    let frames = weights.nrows();
    if let Some(gaps) = gaps.filter(|gaps| gaps.len() != frames) {
        return Err(CueError::Gaps {
            gaps: gaps.len(),
            frames,
        });
    }
    let mut shapes = Shapes::default();
    for (t, frame) in weights.outer_iter().enumerate() {
        shapes.push(&frame.to_vec(), gaps.map(|gaps| gaps[t]))?;
    }
    shapes.finish(duration_s)
}

/// What keeps viseme weights from being shown as mouth shapes.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CueError {
    /// Every frame has 13 weights.
    #[error("viseme weights are {0} a frame, not {all}", all = VISEMES.len())]
    Width(usize),
    /// A sound shorter than one window has no frame.
    #[error("there is no frame of viseme weights")]
    NoFrame,
    /// There is a lip gap for every frame, or none at all.
    #[error("there are {gaps} lip gaps for {frames} frames of viseme weights")]
    Gaps {
        /// Lip gaps that were given.
        gaps: usize,
        /// Frames of weights that were given.
        frames: usize,
    },
    /// A lip gap is a number.
    #[error("the lip gap of frame {frame} is no number")]
    Gap {
        /// Counted from 0.
        frame: usize,
    },
    /// Weights are shares.
    #[error("a viseme weight of frame {frame} is negative or no number")]
    Weight {
        /// Counted from 0.
        frame: usize,
    },
}

/// Whether these are the weights of a frame.
fn check(visemes: &[f32], frame: usize) -> Result<(), CueError> {
    if visemes.len() != VISEMES.len() {
        return Err(CueError::Width(visemes.len()));
    }
    match visemes.iter().any(|w| !w.is_finite() || *w < 0.0) {
        true => Err(CueError::Weight { frame }),
        false => Ok(()),
    }
}

#[cfg(test)]
mod tests;
