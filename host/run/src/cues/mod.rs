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

use crate::phones::VISEMES;
use crate::time::border_seconds;

mod blend;
mod formats;
mod rows;
mod targets;

pub use blend::Blender;
pub use formats::{Format, Style, write, write_as};
pub use rows::{Rate, Table};
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

/// ln-weight that a change of shape must gain: a shape has to be clearly likelier for some frames to be shown, so
/// that a drawn mouth does not flutter.
const CHANGE_COST: f32 = 5.0;
/// The same of a change to closed lips, which are short, and missed when they are not there.
const CLOSING_COST: f32 = 2.0;
/// Weight that closed lips have at least until they have lasted [`LEAST_FRAMES`]: most closures are shorter, and one that is held a little longer is seen, where one
/// that is left out is missed.
const HELD: f32 = 0.2;
/// Weights below this are as good as none.
const FLOOR: f32 = 1e-3;

/// The likeliest sequence of shapes for viseme weights `[frames, 13]` at 100 Hz, from 0 to `duration_s`.
///
/// # Errors
///
/// [`CueError`]: there is no frame, or weights are not what they should be.
pub fn cues(weights: ArrayView2<f32>, duration_s: f64) -> Result<Vec<Cue>, CueError> {
    let mut shapes = Shapes::default();
    for frame in weights.outer_iter() {
        shapes.push(&frame.to_vec())?;
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
    /// Weights are shares.
    #[error("a viseme weight of frame {frame} is negative or no number")]
    Weight {
        /// Counted from 0.
        frame: usize,
    },
}

/// Frames that a shape lasts at least: 70 ms, below which pictures at 24 a second show it once or not at all. Only the end of the sound may cut it short.
const LEAST_FRAMES: usize = 7;

/// Viterbi over shapes, frame by frame: Σ ln weight, less a cost for every change of shape (2 for closing lips, 5 for others); a shape that was changed to stays
/// for as long as a shape lasts at least. Keeps 11 bytes a frame: which shape each came from when it began, and which have lasted.
#[derive(Default)]
pub struct Shapes {
    /// Score of every shape by how long it has lasted, in frames less one; the last is for all that may change.
    score: [[f32; LEAST_FRAMES]; SHAPES.len()],
    from: Vec<Step>,
}

/// How the best paths came to a frame.
#[derive(Clone, Copy)]
struct Step {
    /// The shape before, of every shape that begins here.
    began: [u8; SHAPES.len()],
    /// Bits of the shapes that may change here and could so before.
    stayed: u16,
}

impl Shapes {
    /// The viseme weights `[13]` of the next frame.
    ///
    /// # Errors
    ///
    /// [`CueError::Width`] and [`CueError::Weight`].
    pub fn push(&mut self, visemes: &[f32]) -> Result<(), CueError> {
        check(visemes, self.from.len())?;
        let weights = shape_weights(visemes);
        let free: [f32; SHAPES.len()] = std::array::from_fn(|k| self.score[k][LEAST_FRAMES - 1]);
        let best = argmax(&free);
        let mut step = Step {
            began: [best as u8; SHAPES.len()],
            stayed: 0,
        };
        for (k, ages) in self.score.iter_mut().enumerate() {
            let closes = SHAPES[k] == Shape::A;
            let changed = free[best] - if closes { CLOSING_COST } else { CHANGE_COST };
            let (lasting, stayed) = (ages[LEAST_FRAMES - 2], ages[LEAST_FRAMES - 1]);
            if stayed >= lasting {
                step.stayed |= 1 << k;
            }
            ages.copy_within(..LEAST_FRAMES - 1, 1);
            ages[LEAST_FRAMES - 1] = stayed.max(lasting);
            ages[0] = changed;
            let here = weights[k].max(FLOOR).ln();
            let held = if closes { weights[k].max(HELD).ln() } else { here };
            let (held_ages, free_age) = ages.split_at_mut(LEAST_FRAMES - 1);
            held_ages.iter_mut().for_each(|s| *s += held);
            free_age[0] += here;
            if self.from.is_empty() {
                // The first shape begins with the sound.
                ages.fill(f32::NEG_INFINITY);
                ages[0] = here;
            }
        }
        // Only differences count; kept near zero.
        let top = self
            .score
            .iter()
            .flatten()
            .copied()
            .fold(f32::NEG_INFINITY, f32::max);
        self.score.iter_mut().flatten().for_each(|s| *s -= top);
        self.from.push(step);
        Ok(())
    }

    /// The shapes of a sound that lasts `duration_s`; one that is shorter than a window, of which nothing can be said, is a mouth at rest.
    ///
    /// # Errors
    ///
    /// [`CueError::NoFrame`]: it does not last at all.
    pub fn finish(self, duration_s: f64) -> Result<Vec<Cue>, CueError> {
        if self.from.is_empty() {
            return match duration_s > 0.0 {
                true => Ok(vec![Cue {
                    start_s: 0.0,
                    end_s: duration_s,
                    shape: Shape::X,
                }]),
                false => Err(CueError::NoFrame),
            };
        }
        let frames = self.from.len();
        let mut cues: Vec<Cue> = Vec::new();
        for (t, shape) in self.path().into_iter().enumerate() {
            match cues.last_mut() {
                Some(last) if last.shape == shape => {}
                last => {
                    let start_s = if t == 0 { 0.0 } else { border_seconds(t) };
                    if let Some(last) = last {
                        last.end_s = start_s;
                    }
                    cues.push(Cue {
                        start_s,
                        end_s: border_seconds(frames),
                        shape,
                    });
                }
            }
        }
        // The sound ends somewhere in the last window.
        cues.retain(|cue| cue.start_s < duration_s);
        if let Some(last) = cues.last_mut() {
            last.end_s = duration_s;
        }
        Ok(cues)
    }

    /// The best shape of every frame, traced back from the last.
    fn path(&self) -> Vec<Shape> {
        let all: Vec<f32> = self.score.iter().flatten().copied().collect();
        let best = argmax(&all);
        let (mut at, mut age) = (best / LEAST_FRAMES, best % LEAST_FRAMES);
        let mut path = vec![SHAPES[at]; self.from.len()];
        for (shape, step) in path.iter_mut().zip(&self.from).rev() {
            *shape = SHAPES[at];
            match age {
                0 => (at, age) = (usize::from(step.began[at]), LEAST_FRAMES - 1),
                age if age == LEAST_FRAMES - 1 && step.stayed & (1 << at) != 0 => {}
                _ => age -= 1,
            }
        }
        path
    }
}

/// Whether these are the weights of a frame.
fn check(visemes: &[f32], frame: usize) -> Result<(), CueError> {
    if visemes.len() != VISEMES.len() {
        return Err(CueError::Width(visemes.len()));
    }
    if visemes.iter().any(|w| !w.is_finite() || *w < 0.0) {
        return Err(CueError::Weight { frame });
    }
    Ok(())
}

/// Weight of each shape in one frame. E has twice what D and F both have: it is likelier than either where neither is twice the other, and takes nothing from
/// them, so that it is as hard to change to as they are.
fn shape_weights(visemes: &[f32]) -> [f32; SHAPES.len()] {
    let mut out = [0.0f32; SHAPES.len()];
    for (&w, shape) in visemes.iter().zip(SHAPE_OF_VISEME) {
        out[shape as usize] += w;
    }
    out[Shape::E as usize] = 2.0 * out[Shape::D as usize].min(out[Shape::F as usize]);
    out
}

fn argmax(values: &[f32]) -> usize {
    (0..values.len())
        .max_by(|&a, &b| values[a].total_cmp(&values[b]))
        .unwrap_or(0)
}

#[cfg(test)]
mod tests;
