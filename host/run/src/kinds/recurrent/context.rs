//! The context of a frame: sparse taps and exponential means of the cepstra.
//!
//! With x the 13 statics times their scale,
//! ```text
//! m_n(α) = m_{n−1}(α) + α·(x_n − m_{n−1}(α)),  m_0(α) = x_0                                  (M1)
//! c_t = [x_{t+τ} for every tap τ; m_{t+a}(α) for every α],  a = the first tap, the look-ahead   (M2)
//! ```
//! Before the first frame stands the first frame, after the last one the last. A stream that waits for fewer frames than a
//! holds its newest frame instead of those that it does not know, and its means end there. The means' rates are powers of two:
//! shifts on the device.
use lipstream_core::N_STATIC;
use ndarray::Array2;

use crate::error::{Result, bail};

/// Taps in frames, the largest (the look-ahead) first, and the means' rates as shifts: α = 2^−shift.
#[derive(Clone, Debug, PartialEq)]
pub struct Context {
    /// Frames τ of the taps, relative to the current frame, the largest first.
    pub taps: Vec<i32>,
    /// Shifts of the exponential means: α = 2^−shift per frame.
    pub shifts: Vec<u32>,
}

impl Default for Context {
    fn default() -> Self {
        Self {
            taps: vec![8, 6, 4, 2, 0, -3, -6, -10, -16],
            shifts: vec![3, 4, 5, 6],
        }
    }
}

impl Context {
    /// Refuses what no window can hold.
    ///
    /// # Errors
    ///
    /// [`Error::Choice`](crate::Error::Choice) says in words what that is.
    pub fn check(&self) -> Result<()> {
        if self.taps.is_empty() || self.taps.windows(2).any(|w| w[0] <= w[1]) {
            bail!(
                Choice,
                "the taps {:?} do not fall from one to the next",
                self.taps
            );
        }
        if self.taps.iter().any(|t| t.abs() > 1000) || self.shifts.iter().any(|s| *s > 20) {
            bail!(Choice, "the context {self:?} reaches too far");
        }
        Ok(())
    }

    /// Numbers in a context.
    pub fn size(&self) -> usize {
        (self.taps.len() + self.shifts.len()) * N_STATIC
    }

    /// Frames of future that a context needs.
    pub fn look_ahead(&self) -> usize {
        self.taps.first().map_or(0, |t| (*t).max(0) as usize)
    }

    /// Contexts of the first `frames` frames of `x` `[≥ frames, 13]`; frames beyond `frames` serve as future.
    pub fn stack(&self, x: &Array2<f32>, frames: usize) -> Array2<f32> {
        self.stack_within(x, frames, self.look_ahead())
    }

    /// [`Self::stack`] where only `ahead` frames of the future are known: the last known one stands for those behind it.
    pub fn stack_within(&self, x: &Array2<f32>, frames: usize, ahead: usize) -> Array2<f32> {
        let available = x.nrows();
        let mut out = Array2::zeros((frames, self.size()));
        let ahead = ahead.min(self.look_ahead());
        for (k, &tap) in self.taps.iter().enumerate() {
            let tap = i64::from(tap).min(ahead as i64);
            for t in 0..frames {
                let from = (t as i64 + tap).clamp(0, available as i64 - 1) as usize;
                for d in 0..N_STATIC {
                    out[[t, k * N_STATIC + d]] = x[[from, d]];
                }
            }
        }
        for (k, &shift) in self.shifts.iter().enumerate() {
            let rate = rate(shift);
            let column = (self.taps.len() + k) * N_STATIC;
            for d in 0..N_STATIC {
                let mut mean = x[[0, d]];
                for n in 0..frames + ahead {
                    mean += rate * (x[[n.min(available - 1), d]] - mean);
                    if n >= ahead {
                        out[[n - ahead, column + d]] = mean;
                    }
                }
            }
        }
        out
    }
}

/// α of a mean.
pub fn rate(shift: u32) -> f32 {
    1.0 / (1u64 << shift.min(63)) as f32
}

/// The same, one frame at a time: what a live stream keeps.
#[derive(Clone, Debug)]
pub struct Window {
    context: Context,
    /// Frames of future that are waited for.
    ahead: usize,
    /// The last frames, newest last; `reach + look-ahead + 1` of them.
    recent: std::collections::VecDeque<[f32; N_STATIC]>,
    means: Vec<[f32; N_STATIC]>,
    /// Frames that have arrived.
    arrived: usize,
}

impl Window {
    /// Waits for `ahead` frames of future, at most the context's look-ahead.
    pub fn new(context: Context, ahead: usize) -> Self {
        let means = vec![[0.0; N_STATIC]; context.shifts.len()];
        Self {
            ahead: ahead.min(context.look_ahead()),
            context,
            recent: Default::default(),
            means,
            arrived: 0,
        }
    }

    /// Takes the next frame. True when the context of frame `arrived − 1 − look-ahead` can be read.
    pub fn push(&mut self, x: [f32; N_STATIC]) -> bool {
        let ahead = self.ahead;
        let reach = self.context.taps.last().map_or(0, |t| (-t).max(0) as usize);
        if self.arrived == 0 {
            self.recent.extend(std::iter::repeat_n(x, reach + ahead + 1));
            self.means.fill(x);
        }
        self.recent.pop_front();
        self.recent.push_back(x);
        for (mean, &shift) in self.means.iter_mut().zip(&self.context.shifts) {
            for (m, x) in mean.iter_mut().zip(x) {
                *m += rate(shift) * (x - *m);
            }
        }
        self.arrived += 1;
        self.arrived > ahead
    }

    /// The last frame again: what stands behind the end. False before the first frame.
    pub fn push_last(&mut self) -> bool {
        match self.recent.back().copied() {
            Some(last) => self.push(last),
            None => false,
        }
    }

    /// The context, `[taps then means, 13 each]`.
    pub fn read(&self, out: &mut [f32]) {
        let ahead = self.ahead as i64;
        let newest = self.recent.len() as i64 - 1;
        let taps = self
            .context
            .taps
            .iter()
            .map(|&tap| &self.recent[(newest - ahead + i64::from(tap).min(ahead)) as usize]);
        for (place, row) in out.chunks_exact_mut(N_STATIC).zip(taps.chain(&self.means)) {
            place.copy_from_slice(row);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_frame_at_a_time_gives_the_same() {
        let context = Context::default();
        for (frames, ahead) in [(1, 8), (5, 8), (60, 8), (60, 3), (2, 3), (60, 0)] {
            let x = Array2::from_shape_fn((frames, N_STATIC), |(t, d)| ((t * 7 + d * 3) % 11) as f32 - 5.0);
            let whole = context.stack_within(&x, frames, ahead);
            let mut window = Window::new(context.clone(), ahead);
            let mut row = vec![0.0; context.size()];
            let mut t = 0;
            for n in 0..frames + ahead {
                let ready = if n < frames {
                    window.push(std::array::from_fn(|d| x[[n, d]]))
                } else {
                    window.push_last()
                };
                if ready {
                    window.read(&mut row);
                    for (a, b) in row.iter().zip(whole.row(t)) {
                        assert!((a - b).abs() < 1e-5);
                    }
                    t += 1;
                }
            }
            assert_eq!(t, frames);
        }
    }

    #[test]
    fn contexts_that_cannot_be_are_refused() {
        assert!(Context::default().check().is_ok());
        for taps in [vec![], vec![0, 0], vec![-3, 2], vec![5000, 0]] {
            let context = Context {
                taps,
                ..Context::default()
            };
            assert!(context.check().is_err(), "{context:?}");
        }
    }

    #[test]
    fn future_frames_serve_a_piece() {
        let context = Context::default();
        let x = Array2::from_shape_fn((40, N_STATIC), |(t, _)| t as f32);
        let piece = context.stack(&x, 20);
        assert_eq!(piece[[19, 0]], 27.0);
        assert_eq!(piece[[0, 8 * N_STATIC]], 0.0);
    }
}
