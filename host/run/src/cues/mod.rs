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
use anyhow::{Result, bail};
use ndarray::{ArrayView1, ArrayView2};

use crate::phones::VISEMES;
use crate::time::border_seconds;

mod blend;
mod formats;

pub use blend::{ARKIT, OCULUS, arkit_csv, oculus_csv};
pub use formats::{Format, write};

/// A mouth shape of Rhubarb Lip Sync (the six of Preston Blair's tradition, and G, H, X).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shape {
    A,
    B,
    C,
    D,
    E,
    F,
    G,
    H,
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

/// The mouth has one shape from `start_s` to `end_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cue {
    pub start_s: f64,
    pub end_s: f64,
    pub shape: Shape,
}

/// ln-weight that a change of shape must gain: a shape has to be clearly likelier for some frames to be shown, so
/// that a drawn mouth does not flutter.
const CHANGE_COST: f32 = 5.0;
/// The same of a change to closed lips, which are short, and missed when they are not there.
const CLOSING_COST: f32 = 2.0;
/// Weights below this are as good as none.
const FLOOR: f32 = 1e-3;

/// The likeliest sequence of shapes for viseme weights `[frames, 13]` at 100 Hz, from 0 to `duration_s`.
pub fn cues(weights: ArrayView2<f32>, duration_s: f64) -> Result<Vec<Cue>> {
    check(weights)?;
    let frames = weights.nrows();
    let path = likeliest(&weights.outer_iter().map(shape_weights).collect::<Vec<_>>());
    let mut cues: Vec<Cue> = Vec::new();
    for (t, &shape) in path.iter().enumerate() {
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

fn check(weights: ArrayView2<f32>) -> Result<()> {
    if weights.ncols() != VISEMES.len() {
        bail!(
            "viseme weights are {} a frame, not {}",
            weights.ncols(),
            VISEMES.len()
        );
    }
    if weights.nrows() == 0 {
        bail!("there is no frame of viseme weights");
    }
    if weights.iter().any(|w| !w.is_finite() || *w < 0.0) {
        bail!("a viseme weight is negative or no number");
    }
    Ok(())
}

/// Weight of each shape in one frame; E takes what D and F share.
fn shape_weights(visemes: ArrayView1<f32>) -> [f32; SHAPES.len()] {
    let mut out = [0.0f32; SHAPES.len()];
    for (&w, shape) in visemes.iter().zip(SHAPE_OF_VISEME) {
        out[shape as usize] += w;
    }
    let (open, round) = (out[Shape::D as usize], out[Shape::F as usize]);
    if open.min(round) * 2.0 > open.max(round) {
        out[Shape::E as usize] = open + round;
        out[Shape::D as usize] = 0.0;
        out[Shape::F as usize] = 0.0;
    }
    out
}

/// Viterbi over shapes: Σ ln weight − [`CHANGE_COST`] or [`CLOSING_COST`] per change.
fn likeliest(weights: &[[f32; SHAPES.len()]]) -> Vec<Shape> {
    let mut score = [0.0f32; SHAPES.len()];
    let mut from = Vec::with_capacity(weights.len());
    for frame in weights {
        let best = argmax(&score);
        let top = score[best];
        let mut step = [0; SHAPES.len()];
        for (k, s) in score.iter_mut().enumerate() {
            let closes = SHAPES[k] == Shape::A;
            let changed = top - if closes { CLOSING_COST } else { CHANGE_COST };
            step[k] = if changed > *s { best } else { k };
            *s = s.max(changed) + frame[k].max(FLOOR).ln();
        }
        // Only differences count; kept near zero.
        let top = score[argmax(&score)];
        score.iter_mut().for_each(|s| *s -= top);
        from.push(step);
    }
    let mut at = argmax(&score);
    let mut path = vec![SHAPES[at]; weights.len()];
    for t in (0..weights.len()).rev() {
        path[t] = SHAPES[at];
        at = from[t][at];
    }
    path
}

fn argmax(values: &[f32]) -> usize {
    (0..values.len())
        .max_by(|&a, &b| values[a].total_cmp(&values[b]))
        .unwrap_or(0)
}

#[cfg(test)]
mod tests;
