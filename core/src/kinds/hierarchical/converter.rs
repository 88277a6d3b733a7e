//! The converter: statics of the front end in, a picture every fourth frame, frames on the lines between pictures out.
//!
//! Frame t has its middle at sample 160·t + 200, picture n at 640·n + 320: frames 4n + 1 to 4n + 4 lie 1, 5, 9 and 13 sixteenths of the way from picture n to the next.
//! Before the first picture stands the first, behind the last one the last.
use super::area::{choose, estimate};
use super::tables::MAX_SPEECH;
use super::{Hierarchical, PICTURE_FRAMES, Sealed};
use crate::context::History;
use crate::context::projection::{MAX_CONTEXT, project};
use crate::context::tables::LAST_TAP;
use crate::fixed::{round_shift, saturate_i16};
use crate::frame::{MAX_PARAMETERS, ParameterFrame, VisemeWeights};
use crate::kinds::Convert;
use crate::model::Model;
use crate::settings::StreamSettings;
use crate::{N_OBSERVATION, N_STATIC};

/// Pictures that are kept: a frame between two of them takes one more on either side.
const KEPT: usize = 4;
/// Hops between the frame that begins a picture and the first frame behind the middle of the picture before, and one picture more for smoothing.
const BETWEEN: usize = PICTURE_FRAMES as usize - 1;
const SMOOTHING: usize = PICTURE_FRAMES as usize;

/// The state of one stream.
#[derive(Clone, Debug)]
pub struct Converter<'m> {
    model: &'m Hierarchical<'m>,
    smooth: bool,
    history: History,
    /// Appearances of the last pictures, not smoothed; picture n lies at n modulo their number.
    pictures: [[i16; MAX_PARAMETERS]; KEPT],
    /// Pictures made, modulo 2³⁰.
    made: u32,
    /// Frames given out, modulo 2³².
    given: u32,
    ended: bool,
}

impl Sealed for Converter<'_> {}

impl<'m> Convert<'m, Hierarchical<'m>> for Converter<'m> {
    const HELD_BACK: usize = BETWEEN + SMOOTHING + LAST_TAP as usize;

    #[inline(always)]
    fn new(model: &'m Model<'m, Hierarchical<'m>>, settings: StreamSettings) -> Self {
        Self {
            model: model.own(),
            smooth: settings.average.unwrap_or(true),
            history: History::new(),
            pictures: [[0; MAX_PARAMETERS]; KEPT],
            made: 0,
            given: 0,
            ended: false,
        }
    }

    fn set(&mut self, settings: StreamSettings) {
        self.smooth = settings.average.unwrap_or(true);
        self.reset();
    }

    fn reset(&mut self) {
        self.history.reset();
        self.made = 0;
        self.given = 0;
        self.ended = false;
    }

    fn push(
        &mut self,
        statics: Option<&[i16; N_STATIC]>,
        _: Option<&[i16; N_OBSERVATION]>,
    ) -> Option<ParameterFrame> {
        match statics {
            Some(statics) => self.history.push(statics),
            None => self.ended = true,
        }
        let ahead = self.history.count().wrapping_sub(self.given) as usize;
        if ahead == 0 || (ahead <= self.delay_hops() && !self.ended) {
            return None;
        }
        let frame = self.given;
        self.given = frame.wrapping_add(1);
        let values = self.between(frame);
        Some(ParameterFrame::numbered(frame, values, VisemeWeights::new()))
    }

    fn has_ended(&self) -> bool {
        self.ended
    }

    fn is_done(&self) -> bool {
        self.ended && self.given == self.history.count()
    }

    fn delay_hops(&self) -> usize {
        let smoothing = if self.smooth { SMOOTHING } else { 0 };
        BETWEEN + smoothing + self.model.context().look_ahead()
    }

    fn active(&self) -> usize {
        0
    }

    fn narrowed(&self) -> u32 {
        0
    }
}

impl Converter<'_> {
    /// The values of a frame. Every picture that it needs can be made: all that has been heard of them has been waited for, or the sound has ended.
    fn between(&mut self, frame: u32) -> heapless::Vec<i16, MAX_PARAMETERS> {
        // In sixteenths of a picture, from the middle of the first one on.
        let place = 4 * i64::from(frame) - 3;
        // The last picture that the sound has begun.
        let last = (i64::from(self.history.count()) - 1) / i64::from(PICTURE_FRAMES);
        let (before, part) = match (place >> 4, (place & 15) as i32) {
            // The first frame lies before the middle of the first picture: it is that picture's.
            (before, _) if before < 0 => (-1, 16),
            (before, part) if before < last => (before, part),
            _ => (last, 0),
        };
        let newest = before + if self.smooth { 2 } else { 1 };
        while i64::from(self.made) <= newest.min(last) {
            self.make();
        }
        // What four pictures count for the frame, in 64ths: before − 1 to before + 2.
        let weights = match self.smooth {
            true => [16 - part, 32 - part, 16 + part, part],
            false => [0, 4 * (16 - part), 4 * part, 0],
        };
        let known = i64::from(self.made) - 1;
        let rows = [-1, 0, 1, 2].map(|step| {
            let picture = (before + step).min(known).max(0);
            self.pictures
                .get(picture as usize % KEPT)
                .unwrap_or(&[0; MAX_PARAMETERS])
        });
        let size: usize = self.model.areas().iter().map(|area| area.size).sum();
        let [a, b, c, d] = rows;
        let four = a.iter().zip(b).zip(c).zip(d).take(size);
        four.map(|(((a, b), c), d)| {
            let products = [a, b, c, d].into_iter().zip(weights);
            // 64 times 2¹⁵.
            let sum = products.map(|(value, weight)| i32::from(*value) * weight).sum();
            saturate_i16(round_shift(sum, 6))
        })
        .collect()
    }

    /// The next picture: speech parameters, then every area.
    fn make(&mut self) {
        let frame = i64::from(self.made) * i64::from(PICTURE_FRAMES);
        let tables = self.model.context();
        let mut context = [0; MAX_CONTEXT];
        let taps = tables.taps().map(|tap| self.history.at(frame + i64::from(tap)));
        for (to, from) in context.as_chunks_mut::<N_STATIC>().0.iter_mut().zip(taps) {
            *to = from;
        }
        let speech = project(tables, context.get(..tables.size()).unwrap_or(&[]));
        let speech = speech.get(..tables.n_inputs().min(MAX_SPEECH)).unwrap_or(&[]);
        let mut rest = &mut self.pictures[self.made as usize % KEPT][..];
        for area in self.model.areas() {
            let Some((own, behind)) = rest.split_at_mut_checked(area.size) else {
                break;
            };
            estimate(area, choose(area, speech), speech, own);
            rest = behind;
        }
        self.made += 1;
    }
}
