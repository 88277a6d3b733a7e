//! The search for the shapes of a sound: dynamic programming over its frames.
use std::collections::VecDeque;

use super::closing::{AROUND, Gaps};
use super::{Cue, CueError, SHAPE_OF_VISEME, SHAPES, Shape, between, check};
use crate::time::border_seconds;

/// ln-weight that a change of shape must gain: a shape has to be clearly likelier for some frames to be shown, so
/// that a drawn mouth does not flutter.
const CHANGE_COST: f32 = 6.0;
/// The same of a change to or from closed lips, which are short, and missed when they are not there.
const CLOSING_COST: f32 = 4.0;
/// Where no lip gap tells more, the weight that closed lips have at least until they have lasted [`LEAST_FRAMES`]: most closures are shorter, and one that is held a
/// little longer is seen, where one that is left out is missed.
const HELD: f32 = 0.2;
/// Weight of silence above which a closed mouth is one at rest.
const AT_REST: f32 = 0.1;
/// Weights below this are as good as none.
const FLOOR: f32 = 1e-3;

/// Frames that a shape lasts at least: 70 ms, below which pictures at 24 a second show it once or not at all. Only the end of the sound may cut it short.
const LEAST_FRAMES: usize = 7;

/// Viterbi over shapes, frame by frame: Σ ln weight, less a cost for every change of shape (4 to and from closed lips, 6 for others); a shape that was changed to
/// stays for as long as a shape lasts at least. Where the lip gap is known, it adds to the ln weight of closed lips (`closing.rs`). Keeps 11 bytes a frame: which shape
/// each came from when it began, and which have lasted. Shapes in between are put into what was found (`between.rs`).
#[derive(Default)]
pub struct Shapes {
    /// Frames that wait for the gaps behind them: their weights, and whether they have a gap.
    waiting: VecDeque<([f32; SHAPES.len()], bool)>,
    gaps: Gaps,
    pushed: usize,
    search: Search,
}

impl Shapes {
    /// The viseme weights `[13]` of the next frame and, where a mouth is drawn that can be measured, its lip gap ([`crate::opening::Opening::gap`]). Weights that are
    /// known for certain, such as those of aligned phones, need none.
    ///
    /// # Errors
    ///
    /// [`CueError::Width`], [`CueError::Weight`] and [`CueError::Gap`].
    pub fn push(&mut self, visemes: &[f32], gap: Option<f32>) -> Result<(), CueError> {
        check(visemes, self.pushed)?;
        if gap.is_some_and(|gap| !gap.is_finite()) {
            return Err(CueError::Gap { frame: self.pushed });
        }
        self.pushed += 1;
        self.gaps.push(gap);
        self.waiting.push_back((shape_weights(visemes), gap.is_some()));
        if self.waiting.len() > AROUND {
            self.advance();
        }
        Ok(())
    }

    /// Takes the frame that has waited longest into the search.
    fn advance(&mut self) {
        let Some((weights, has_gap)) = self.waiting.pop_front() else {
            return;
        };
        let evidence = self.gaps.evidence();
        let mut scores = weights.map(|weight| weight.max(FLOOR).ln());
        let (closed, rest) = (Shape::A as usize, Shape::X as usize);
        let mut held = scores;
        if has_gap {
            scores[closed] += evidence;
            if weights[rest] > AT_REST {
                scores[closed] = scores[closed].min(scores[rest]);
            }
            held[closed] = scores[closed];
        } else {
            held[closed] = held[closed].max(HELD.ln());
        }
        self.search.push(&scores, &held);
    }

    /// The shapes of a sound that lasts `duration_s`; one that is shorter than a window, of which nothing can be said, is a mouth at rest.
    ///
    /// # Errors
    ///
    /// [`CueError::NoFrame`]: it does not last at all.
    pub fn finish(mut self, duration_s: f64) -> Result<Vec<Cue>, CueError> {
        if self.pushed == 0 {
            return match duration_s > 0.0 {
                true => Ok(vec![Cue {
                    start_s: 0.0,
                    end_s: duration_s,
                    shape: Shape::X,
                }]),
                false => Err(CueError::NoFrame),
            };
        }
        while !self.waiting.is_empty() {
            self.advance();
        }
        let frames = self.pushed;
        let mut cues: Vec<Cue> = Vec::new();
        for (t, shape) in self.search.path().into_iter().enumerate() {
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
        Ok(between::with_shapes_between(&cues))
    }
}

/// The best paths to every shape.
#[derive(Default)]
struct Search {
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

/// What a change from shape `from` to shape `to` costs; a shape does not change to itself.
fn change_cost(from: usize, to: usize) -> f32 {
    if from == to {
        return f32::INFINITY;
    }
    match from == Shape::A as usize || to == Shape::A as usize {
        true => CLOSING_COST,
        false => CHANGE_COST,
    }
}

impl Search {
    /// ln weights of the next frame: of shapes that have lasted, and of those that have not yet.
    fn push(&mut self, lasting: &[f32; SHAPES.len()], young: &[f32; SHAPES.len()]) {
        let free: [f32; SHAPES.len()] = std::array::from_fn(|k| self.score[k][LEAST_FRAMES - 1]);
        let mut step = Step {
            began: [0; SHAPES.len()],
            stayed: 0,
        };
        for (k, ages) in self.score.iter_mut().enumerate() {
            let changed: [f32; SHAPES.len()] = std::array::from_fn(|from| free[from] - change_cost(from, k));
            let best = argmax(&changed);
            step.began[k] = best as u8;
            let (grown_up, stayed) = (ages[LEAST_FRAMES - 2], ages[LEAST_FRAMES - 1]);
            if stayed >= grown_up {
                step.stayed |= 1 << k;
            }
            ages.copy_within(..LEAST_FRAMES - 1, 1);
            ages[LEAST_FRAMES - 1] = stayed.max(grown_up);
            ages[0] = changed[best];
            let (young_ages, free_age) = ages.split_at_mut(LEAST_FRAMES - 1);
            young_ages.iter_mut().for_each(|s| *s += young[k]);
            free_age[0] += lasting[k];
            if self.from.is_empty() {
                // The first shape begins with the sound.
                ages.fill(f32::NEG_INFINITY);
                ages[0] = lasting[k];
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
