//! How well the mouth closes: the gap between the inner lips, of the true mouth and of a predicted one.
//!
//! The true gap is measured on the mouth images ([`lipstream::lips`]). A prediction is a row of eigenmouth weights; its gap is read out of them
//! by ridge regression fitted on the training clips' own weights and gaps, so that every system is judged by the same
//! read-out and no image has to be drawn. What the read-out itself loses is the first row of the table: the true
//! weights.
//!
//! Closed is a gap below 5 % of the mouth's width. Precision: of the frames shown closed, those that are. Recall: of the closed
//! frames, those shown so. Both over all frames (where silence counts for much) and near p, b, m: from 20 ms before to 20 ms
//! after their labels, or after where they are aligned with the sound.
use std::collections::HashMap;

use nalgebra::{DMatrix, DVector};
use ndarray::{Array1, Array2, Array4, ArrayView2, Axis, s};
use rayon::prelude::*;
use serde::Serialize;

use super::bootstrap::{Draws, Interval};
use super::metrics::Score;
use crate::error::{Context as _, Error, Result, bail};
use crate::features::{Clip, FeatureFolder, PhoneLabel, Split, read_mouths};
use crate::train::data;
use lipstream::lips::{IMAGES, Lips};
use lipstream::phones::Phone;

/// Training clips that the read-out is fitted on, at most.
const CLIPS: usize = 120;
/// Penalty of the read-out, on weights scaled to variance one.
const PENALTY: f64 = 10.0;
/// Half a picture, in seconds: a label's border lies between two pictures.
const MARGIN_S: f32 = 0.02;

/// What is known of a folder's mouths: the lips of each speaker, and the gap as a function of the weights.
pub struct Gaps {
    lips: HashMap<String, Lips>,
    weights: Array1<f32>,
    offset: f32,
}

/// The true mouth of one clip at 100 Hz.
pub struct TrueGap {
    gap: Vec<f32>,
    closed_below: f32,
    /// Frames near each p, b, m.
    bilabials: Vec<std::ops::Range<usize>>,
}

/// How the mouths of all systems close.
#[derive(Clone, Debug, Serialize)]
pub struct Closure {
    /// Share of frames in which the true mouth is closed.
    pub closed_share: f64,
    /// p, b, m in the labels, and those at which the true mouth closes.
    pub bilabials: usize,
    /// Labelled p, b, m at which the true mouth closes.
    pub bilabials_closed: usize,
    /// The true eigenmouth weights first, then the systems.
    pub systems: Vec<Row>,
}

/// How one system's mouth closes.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What the system is called in the report.
    pub name: String,
    /// Of the gap with the true one, over all frames.
    pub correlation: f64,
    /// Mean gap less the true one, in pixels.
    pub bias_px: f64,
    /// Share of the frames shown closed that are closed, 0 to 1; 0 where none is shown closed.
    pub precision: Interval,
    /// Share of the closed frames that are shown closed, 0 to 1; 0 where none is closed.
    pub recall: Interval,
    /// Precision near p, b, m.
    pub precision_at_bilabials: Interval,
    /// Recall near p, b, m.
    pub recall_at_bilabials: Interval,
}

impl Gaps {
    /// Learns from the mouth images of `folder`. The error says why closure cannot be measured there.
    pub fn learn(folder: &FeatureFolder) -> Result<Self> {
        let mut lips = HashMap::new();
        for clip in filmed(folder) {
            if !lips.contains_key(&clip.speaker) {
                let learnt = learn_lips(folder, &clip.speaker)?;
                lips.insert(clip.speaker.clone(), learnt);
            }
        }
        let train: Vec<&Clip> = filmed(folder).filter(|c| c.split == Split::Train).collect();
        if train.is_empty() {
            bail!(Data, "no training clip has video");
        }
        let step = train.len().div_ceil(CLIPS);
        let pairs: Vec<(Array2<f32>, Vec<f32>)> = train
            .into_par_iter()
            .step_by(step)
            .map(|clip| Ok((folder.visual(clip)?, image_gaps(folder, clip, &lips)?)))
            .collect::<Result<_>>()?;
        let (weights, offset) = fit(&pairs)?;
        Ok(Self {
            lips,
            weights,
            offset,
        })
    }

    /// Gap in pixels of every row of eigenmouth weights, `[frames, D]`. May be a little below 0.
    pub fn read_out(&self, weights: ArrayView2<f32>) -> Vec<f32> {
        (weights.dot(&self.weights) + self.offset).to_vec()
    }

    /// The true gaps of a clip whose phones are `phones`, from its images.
    pub fn truth(&self, folder: &FeatureFolder, clip: &Clip, phones: &[PhoneLabel]) -> Result<TrueGap> {
        let gaps = Array2::from_shape_vec((clip.video_frames, 1), image_gaps(folder, clip, &self.lips)?)?;
        let gap = data::to_audio_rate(gaps.view(), clip.video_hz, clip.audio_frames);
        Ok(TrueGap {
            gap: gap.iter().copied().collect(),
            closed_below: self.lips[&clip.speaker].closed_below(),
            bilabials: bilabials(phones, clip.audio_frames, MARGIN_S),
        })
    }
}

impl TrueGap {
    /// A smaller gap is a closed mouth, in pixels.
    pub fn closed_below(&self) -> f32 {
        self.closed_below
    }

    /// In pixels, 100 a second.
    pub fn gap(&self) -> &[f32] {
        &self.gap
    }
}

/// Clips with video.
fn filmed(folder: &FeatureFolder) -> impl Iterator<Item = &Clip> {
    folder.manifest.clips.iter().filter(|c| c.video_frames > 0)
}

/// Mouth images of a clip, `[video frames, height, width, 3]`.
fn images(folder: &FeatureFolder, clip: &Clip) -> Result<Array4<u8>> {
    let images = read_mouths(&folder.mouths_path(&clip.id))?;
    if images.dim().0 != clip.video_frames {
        bail!(
            Data,
            "clip {} has {} mouth images for {} frames of video",
            clip.id,
            images.dim().0,
            clip.video_frames
        );
    }
    Ok(images)
}

/// From at most [`IMAGES`] images, spread over the speaker's training clips (or over all that he has).
/// The lips of a speaker, from some of his mouth images: of training clips, where he has any.
///
/// # Errors
///
/// [`Error::Data`]: no lips stand out in them, or they differ in size; and files that cannot be read.
pub fn learn_lips(folder: &FeatureFolder, speaker: &str) -> Result<Lips> {
    let own: Vec<&Clip> = filmed(folder).filter(|c| c.speaker == speaker).collect();
    let train: Vec<&Clip> = own.iter().copied().filter(|c| c.split == Split::Train).collect();
    let clips = if train.is_empty() { own } else { train };
    let each = 10.max(IMAGES.div_ceil(clips.len()));
    let step = clips.len().div_ceil(IMAGES / 10);
    let mut chosen: Vec<Array4<u8>> = Vec::new();
    for clip in clips.iter().step_by(step) {
        let images = images(folder, clip)?;
        let every = images.dim().0.div_ceil(each);
        chosen.push(images.slice(s![..;every, .., .., ..]).to_owned());
    }
    let views: Vec<_> = chosen.iter().map(|c| c.view()).collect();
    let images = ndarray::concatenate(Axis(0), &views)
        .with_context(|| format!("the mouth images of {speaker} differ in size"))?;
    Lips::learn(images.view())
        .ok_or_else(|| Error::Data(format!("no lips stand out in the mouth images of {speaker}")))
}

fn image_gaps(folder: &FeatureFolder, clip: &Clip, lips: &HashMap<String, Lips>) -> Result<Vec<f32>> {
    lips[&clip.speaker]
        .gaps(images(folder, clip)?.view())
        .ok_or_else(|| Error::Data(format!("no lips are seen in clip {}", clip.id)))
}

/// Ridge regression of gaps on weights: slope per weight and offset.
fn fit(pairs: &[(Array2<f32>, Vec<f32>)]) -> Result<(Array1<f32>, f32)> {
    let size = pairs.first().map_or(0, |(weights, _)| weights.ncols());
    let n: f64 = pairs.iter().map(|(_, gaps)| gaps.len() as f64).sum();
    let rows = || {
        pairs
            .iter()
            .flat_map(|(weights, gaps)| weights.outer_iter().zip(gaps.iter().map(|g| f64::from(*g))))
    };
    let (mut mean, mut gap) = (vec![0.0; size], 0.0);
    for (row, g) in rows() {
        mean.iter_mut()
            .zip(row)
            .for_each(|(m, &v)| *m += f64::from(v) / n);
        gap += g / n;
    }
    let mut deviation = vec![0.0f64; size];
    for (row, _) in rows() {
        for ((d, &v), m) in deviation.iter_mut().zip(row).zip(&mean) {
            *d += (f64::from(v) - m).powi(2) / n;
        }
    }
    deviation.iter_mut().for_each(|d| *d = d.sqrt().max(1e-6));
    let mut normal = DMatrix::<f64>::identity(size, size) * PENALTY;
    let mut right = DVector::<f64>::zeros(size);
    for (row, g) in rows() {
        let x = DVector::from_iterator(
            size,
            row.iter()
                .zip(&mean)
                .zip(&deviation)
                .map(|((&v, m), d)| (f64::from(v) - m) / d),
        );
        normal.ger(1.0, &x, &x, 1.0);
        right.axpy(g - gap, &x, 1.0);
    }
    let Some(solved) = normal.cholesky() else {
        bail!(
            Data,
            "the eigenmouth weights of the training clips are not finite"
        );
    };
    let slope = solved.solve(&right);
    let weights: Array1<f32> = slope
        .iter()
        .zip(&deviation)
        .map(|(w, d)| (w / d) as f32)
        .collect();
    let offset = gap
        - weights
            .iter()
            .zip(&mean)
            .map(|(w, m)| f64::from(*w) * m)
            .sum::<f64>();
    Ok((weights, offset as f32))
}

/// Frames within `margin_s` of each p, b, m.
pub(super) fn bilabials(phones: &[PhoneLabel], frames: usize, margin_s: f32) -> Vec<std::ops::Range<usize>> {
    let viseme = Phone::from_name("p").map(Phone::viseme);
    phones
        .iter()
        .filter(|label| Phone::from_name(&label.phone).map(Phone::viseme) == viseme)
        .map(|label| {
            let frame = |time: f32| {
                (0..frames)
                    .position(|t| data::frame_time(t) >= time)
                    .unwrap_or(frames)
            };
            frame(label.start - margin_s)..frame(label.end + margin_s)
        })
        .filter(|span| !span.is_empty())
        .collect()
}

/// Counts of closed frames.
#[derive(Clone, Copy, Default)]
struct Counts {
    both: f64,
    shown: f64,
    real: f64,
}

impl Counts {
    fn add(&mut self, shown: bool, real: bool) {
        self.both += f64::from(u8::from(shown && real));
        self.shown += f64::from(u8::from(shown));
        self.real += f64::from(u8::from(real));
    }

    fn of_all(clips: &mut dyn Iterator<Item = &Counts>) -> Self {
        clips.fold(Self::default(), |mut sum, clip| {
            sum.both += clip.both;
            sum.shown += clip.shown;
            sum.real += clip.real;
            sum
        })
    }

    /// 0 where nothing is shown closed.
    fn precision(&self) -> f64 {
        if self.shown > 0.0 {
            self.both / self.shown
        } else {
            0.0
        }
    }

    fn recall(&self) -> f64 {
        if self.real > 0.0 {
            self.both / self.real
        } else {
            0.0
        }
    }
}

/// Judges the gaps of one system, one row of `said` a clip; intervals by `draws` of these clips.
pub fn judge(name: &str, truths: &[TrueGap], said: &[Vec<f32>], draws: &Draws) -> Row {
    let (mut all_of_clips, mut near_of_clips) = (Vec::new(), Vec::new());
    let mut score = Score::new(1);
    let (mut bias, mut frames) = (0.0, 0.0);
    for (truth, said) in truths.iter().zip(said) {
        let (mut all, mut near) = (Counts::default(), Counts::default());
        let is_closed = |gap: f32| gap < truth.closed_below;
        let column = |values: &[f32]| ArrayView2::from_shape((values.len(), 1), values).map(|v| v.to_owned());
        if let (Ok(real), Ok(shown)) = (column(&truth.gap), column(said)) {
            score.add(&real, &shown);
        }
        for (&real, &shown) in truth.gap.iter().zip(said) {
            all.add(is_closed(shown), is_closed(real));
            bias += f64::from(shown - real);
            frames += 1.0;
        }
        // A prediction may lack the last frames.
        let length = said.len().min(truth.gap.len());
        let mut is_near = vec![false; length];
        for span in &truth.bilabials {
            let span = span.start.min(length)..span.end.min(length);
            is_near[span].fill(true);
        }
        for t in (0..length).filter(|&t| is_near[t]) {
            near.add(is_closed(said[t]), is_closed(truth.gap[t]));
        }
        all_of_clips.push(all);
        near_of_clips.push(near);
    }
    let interval = |clips: &[Counts], share: fn(&Counts) -> f64| {
        draws.interval(clips, |drawn| share(&Counts::of_all(drawn)))
    };
    Row {
        name: name.to_owned(),
        correlation: score.acc(),
        bias_px: bias / f64::max(frames, 1.0),
        precision: interval(&all_of_clips, Counts::precision),
        recall: interval(&all_of_clips, Counts::recall),
        precision_at_bilabials: interval(&near_of_clips, Counts::precision),
        recall_at_bilabials: interval(&near_of_clips, Counts::recall),
    }
}

/// What is true whatever anybody predicts; rows are to be added.
pub fn summary(truths: &[TrueGap]) -> Closure {
    let frames: usize = truths.iter().map(|t| t.gap.len()).sum();
    let is_closed = |t: &TrueGap, span: &[f32]| span.iter().filter(|g| **g < t.closed_below).count();
    let spans = || {
        truths
            .iter()
            .flat_map(|t| t.bilabials.iter().map(move |span| (t, span.clone())))
    };
    Closure {
        closed_share: truths.iter().map(|t| is_closed(t, &t.gap)).sum::<usize>() as f64
            / frames.max(1) as f64,
        bilabials: spans().count(),
        bilabials_closed: spans()
            .filter(|(t, span)| is_closed(t, &t.gap[span.clone()]) > 0)
            .count(),
        systems: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::render::drawn;
    use ndarray::array;

    fn truth(gap: &[f32], bilabials: Vec<std::ops::Range<usize>>) -> TrueGap {
        TrueGap {
            gap: gap.to_vec(),
            closed_below: 1.0,
            bilabials,
        }
    }

    #[test]
    fn counted_by_hand() {
        // Closed in frames 0, 1, 4, 5; bilabials at 1..3 and 4..6; the second is missed.
        let truths = [truth(&[0.0, 0.5, 3.0, 3.0, 0.0, 0.5], vec![1..3, 4..6])];
        let draws = Draws::new(1, 100, 1);
        let row = judge("x", &truths, &[vec![0.0, 0.0, 0.9, 5.0, 2.0, 2.0]], &draws);
        let is = |i: Interval, want: f64| (i.value - want).abs() < 1e-9;
        assert!(is(row.precision, 2.0 / 3.0) && is(row.recall, 0.5));
        assert!(is(row.precision_at_bilabials, 0.5) && is(row.recall_at_bilabials, 1.0 / 3.0));
        assert!((row.bias_px - 2.9 / 6.0).abs() < 1e-6);
        let whole = summary(&truths);
        assert_eq!((whole.bilabials, whole.bilabials_closed), (2, 2));
        assert!((whole.closed_share - 4.0 / 6.0).abs() < 1e-9);
    }

    /// One clip is kept whole, another missed whole: an interval over clips goes from nothing to everything.
    #[test]
    fn intervals_are_over_clips() {
        let clip = || truth(&[0.0, 3.0], std::iter::once(0..2).collect());
        let draws = Draws::new(2, 1000, 1);
        let row = judge("x", &[clip(), clip()], &[vec![0.0, 3.0], vec![3.0, 3.0]], &draws);
        let recall = row.recall_at_bilabials;
        assert_eq!((recall.low, recall.value, recall.high), (0.0, 0.5, 1.0));
    }

    #[test]
    fn a_mouth_that_never_closes_has_no_precision() {
        let draws = Draws::new(1, 100, 1);
        let row = judge(
            "x",
            &[truth(&[0.0, 2.0], std::iter::once(0..2).collect())],
            &[vec![5.0, 5.0]],
            &draws,
        );
        assert_eq!((row.precision.value, row.recall.value), (0.0, 0.0));
        // A prediction that ends early is judged as far as it goes.
        let row = judge(
            "x",
            &[truth(&[0.0, 2.0, 0.0], std::iter::once(0..3).collect())],
            &[vec![0.0]],
            &draws,
        );
        assert_eq!((row.precision.value, row.recall.value), (1.0, 1.0));
    }

    #[test]
    fn labels_of_p_b_m_become_frames() {
        let label = |phone: &str, start, end| PhoneLabel {
            phone: phone.into(),
            start,
            end,
        };
        let phones = [
            label("b", 0.3, 0.35),
            label("iy", 0.35, 0.8),
            label("m", 0.97, 1.2),
        ];
        // Frame t is centred on 0.0125 + t/100 s.
        assert_eq!(bilabials(&phones, 100, MARGIN_S), [27..36, 94..100]);
    }

    /// Drawn mouths: the read-out of their weights follows the gap that was drawn.
    #[test]
    fn weights_tell_the_gap() {
        let space = drawn::space(12);
        let pose = |open| drawn::Pose {
            open,
            round: 0.2,
            spread: 0.3,
        };
        let opens: Vec<f32> = (0..50).map(|n| (n * 7 % 50) as f32 / 49.0).collect();
        let mut rows = Array2::zeros((opens.len(), space.size()));
        for (mut row, &open) in rows.outer_iter_mut().zip(&opens) {
            row.assign(&space.project(drawn::draw(pose(open)).view()));
        }
        let gaps: Vec<f32> = opens.iter().map(|open| 10.0 * open).collect();
        let (weights, offset) = fit(&[(rows, gaps)]).unwrap();
        let probe = Gaps {
            lips: HashMap::new(),
            weights,
            offset,
        };
        let said = |open| {
            let row = space.project(drawn::draw(pose(open)).view());
            probe.read_out(row.insert_axis(Axis(0)).view())[0]
        };
        for open in [0.1, 0.5, 0.9] {
            assert!((said(open) - 10.0 * open).abs() < 1.0, "{open}: {}", said(open));
        }
    }

    #[test]
    fn a_plane_is_fitted() {
        let rows = Array2::from_shape_fn((20_000, 2), |(n, k)| (n * (k + 3) % 17) as f32);
        let gaps = rows
            .outer_iter()
            .map(|r| 2.0 + 0.5 * r[0] - 0.25 * r[1])
            .collect();
        let (weights, offset) = fit(&[(rows, gaps)]).unwrap();
        let said = array![[4.0f32, 8.0]].dot(&weights)[0] + offset;
        // The penalty counts for nothing among so many rows.
        assert!((said - 2.0).abs() < 0.01, "{said}");
    }
}
