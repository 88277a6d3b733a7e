//! Local linear conversion of a stream: what [`super::convert`] makes of a whole utterance, frame after frame in flat memory.
use std::collections::VecDeque;

use lipstream_core::{N_OBSERVATION, N_STATIC};
use ndarray::{Array1, Array2, s};

use super::convert::{Follower, smooth, viseme_weights};
use super::{Model, NotFinite, local_linear};

/// Frames whose occupancies are settled in one go: the forward pass begins anew with every block, at the price of the lag's frames.
const BLOCK: usize = 64;

/// A frame that has been mapped, not averaged yet: its parameters and viseme weights.
type Mapped = (Array1<f32>, Vec<f32>);

/// One stream through a likelihood-trained model that speaks by local linear maps.
pub struct Live<'a> {
    model: &'a Model,
    follower: Follower,
    lag: usize,
    /// Forward variables of the frame before `heard`; none at the beginning.
    before: Option<Vec<f64>>,
    /// Observations whose occupancies are still to be settled.
    heard: Vec<[f32; N_OBSERVATION]>,
    /// Statics that contexts still reach, from frame `first` on.
    statics: VecDeque<[f32; N_STATIC]>,
    first: usize,
    /// Settled occupancies of the visual states that wait for their context, from frame `mapped` on.
    settled: VecDeque<Array1<f32>>,
    mapped: usize,
    /// The frame before the next one to be given out, that one, and the one after it, as far as they are there.
    said: VecDeque<Mapped>,
    /// Whether `said` begins with a frame that has been given out.
    begun: bool,
}

impl<'a> Live<'a> {
    /// Occupancies wait `lag` frames.
    pub fn new(model: &'a Model, lag: usize) -> Self {
        Self {
            model,
            follower: Follower::of_model(model),
            lag,
            before: None,
            heard: Vec::new(),
            statics: VecDeque::new(),
            first: 0,
            settled: VecDeque::new(),
            mapped: 0,
            said: VecDeque::new(),
            begun: false,
        }
    }

    /// Takes the next frame's observation; `each` is called with the parameters and viseme weights of the frames that are ready.
    pub fn push(
        &mut self,
        observation: [f32; N_OBSERVATION],
        mut each: impl FnMut(&[f32], &[f32]),
    ) -> Result<(), NotFinite> {
        self.heard.push(observation);
        self.statics.push_back(std::array::from_fn(|i| observation[i]));
        if self.heard.len() == BLOCK + self.lag {
            self.settle(BLOCK)?;
            self.speak(false, &mut each);
        }
        Ok(())
    }

    /// The frames that are still owed when the sound has ended.
    pub fn finish(&mut self, mut each: impl FnMut(&[f32], &[f32])) -> Result<(), NotFinite> {
        if !self.heard.is_empty() {
            self.settle(self.heard.len())?;
        }
        self.speak(true, &mut each);
        Ok(())
    }

    /// Occupancies of the first `count` frames of `heard`.
    fn settle(&mut self, count: usize) -> Result<(), NotFinite> {
        let observations =
            Array2::from_shape_fn((self.heard.len(), N_OBSERVATION), |(t, i)| self.heard[t][i]);
        let (alpha, visual) = self
            .follower
            .piece(self.before.as_deref(), &observations, self.lag)
            .ok_or(NotFinite)?;
        self.settled.extend((0..count).map(|t| visual.row(t).to_owned()));
        self.before = Some(alpha.row(count - 1).to_vec());
        self.heard.drain(..count);
        Ok(())
    }

    /// Maps and gives out the frames that are ready.
    fn speak(&mut self, ended: bool, each: &mut impl FnMut(&[f32], &[f32])) {
        let taps = &self.model.context.taps;
        let known = self.first + self.statics.len();
        let ahead = taps.last().map_or(0, |t| (*t).max(0) as usize);
        let behind = taps
            .first()
            .map_or(0, |t| t.unsigned_abs() as usize * usize::from(*t < 0));
        while !self.settled.is_empty() && (ended || self.mapped + ahead < known) {
            let mapped = self.map();
            self.said.push_back(mapped);
            if self.said.len() == 2 + usize::from(self.begun) {
                self.give(each);
            }
            self.mapped += 1;
            while self.first + behind < self.mapped {
                self.statics.pop_front();
                self.first += 1;
            }
        }
        if ended && self.said.len() > usize::from(self.begun) {
            self.give(each);
        }
    }

    /// What the maps say in the next frame.
    fn map(&mut self) -> Mapped {
        let last = (self.first + self.statics.len() - 1) as i64;
        let taps = &self.model.context.taps;
        let stacked = Array2::from_shape_fn((1, taps.len() * N_STATIC), |(_, i)| {
            let frame = (self.mapped as i64 + i64::from(taps[i / N_STATIC])).clamp(0, last);
            self.statics[frame as usize - self.first][i % N_STATIC]
        });
        let x = (stacked - &self.model.context.mean).dot(&self.model.context.projection.t());
        let occupancy = self
            .settled
            .pop_front()
            .expect("the caller has looked")
            .insert_axis(ndarray::Axis(0));
        let said = local_linear::apply(&self.model.maps, &x, &occupancy);
        let visemes = viseme_weights(self.model, &occupancy);
        (said.row(0).to_owned(), visemes.row(0).to_vec())
    }

    /// Gives out the next frame, averaged with the neighbours that `said` holds.
    fn give(&mut self, each: &mut impl FnMut(&[f32], &[f32])) {
        let width = self.said.front().map_or(0, |m| m.0.len());
        let rows = Array2::from_shape_fn((self.said.len(), width), |(t, d)| self.said[t].0[d]);
        let at = usize::from(self.begun);
        let smooth = smooth(&rows);
        each(&smooth.slice(s![at, ..]).to_vec(), &self.said[at].1);
        if self.begun {
            self.said.pop_front();
        }
        self.begun = true;
    }
}
