//! Where the mouth is in every picture of a clip, steady, whatever the head does.
//!
//! The rigid upper face (brows, eyes, bridge of the nose) is registered in every picture to a template that all clips of a
//! speaker share; the mouth itself is never used. The mouth image is then a rectangle of the template's coordinates, sampled through the
//! registration. Where lips are seen the rectangle slowly follows them (a head that turns shifts the mouth against the brows), and what was
//! seen says whether it is on the mouth at all.

use super::colour::{self, ChannelMap};
use super::face::{Detector, FaceBox};
use super::image::{Plane, Pyramid, colour_planes, luminance};
use super::landmarks::{LandmarkFinder, Landmarks, Lips, Outline, Walk};
use super::reference::{Reference, learn};
use super::register::{LEVELS, Registration, Template};
use crate::error::{Result, bail};
use lipstream::affine::Affine;
use lipstream_media::video::Frames;

/// A registration below this correlation with the template has lost the face.
pub(crate) const LEAST_SCORE: f32 = 0.55;
/// One above this needs no second opinion.
const SURE_SCORE: f32 = 0.8;
/// More lost pictures than this share, and the clip is refused.
const MOST_LOST: f32 = 0.1;
/// The same where lips are looked for too: they say whether the rectangle is right in between.
const MOST_LOST_WITH_LIPS: f32 = 0.25;

/// Pictures a second in which the lips are looked for.
const LOOKS_HZ: f32 = 12.5;
/// The rectangle follows the lips as slowly as this (standard deviation of a Gaussian, seconds), so that it does not follow speech.
const FOLLOWS_S: f32 = 0.4;
/// Of the pictures looked at, so many must show lips, and of these so many all of them inside the rectangle.
const LEAST_SEEN: f32 = 0.8;
const LEAST_WHOLE: f32 = 0.9;

/// What was seen of the lips of a clip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LipsSeen {
    /// Pictures that were looked at.
    pub looked: usize,
    /// Of them those with lips.
    pub seen: usize,
    /// Of these those with all of the lips inside the mouth's rectangle.
    pub whole: usize,
    /// How far the lips' surroundings wander in the rectangle, once it has followed them: the 95th percentile of the distance from their
    /// middle place, over the rectangle's width.
    pub wander: f32,
}

/// The mouth of every picture of a clip.
#[derive(Clone, Debug)]
pub struct MouthTrack {
    /// Pixels in a row of a mouth image.
    pub width: usize,
    /// Rows of a mouth image.
    pub height: usize,
    /// `[n, height, width, 3]`, colours brought to the speaker's.
    pub images: Vec<u8>,
    /// From pixels of the mouth image to pixels of the frame, `[n]`.
    pub transforms: Vec<Affine>,
    /// Correlation of the registered upper face with the speaker's, `[n]`, at most 1. Where the face was lost (below 0.55) the
    /// transform is interpolated from its neighbours.
    pub scores: Vec<f32>,
    /// What was done to the frame's colours (red, green, blue).
    pub colour: [ChannelMap; 3],
    /// Pictures a second.
    pub rate_hz: f32,
    /// What was seen of the lips; None where the speaker's were not found and motion says where the mouth is.
    pub lips: Option<LipsSeen>,
    /// The outer lips in pixels of the frame, around, the corners first and eleventh, `[n]`: as seen where they were looked for, in
    /// between on the straight way; None where no lips are near. Empty where none were looked for.
    pub outlines: Vec<Option<Outline>>,
}

impl MouthTrack {
    /// Number of pictures.
    pub fn len(&self) -> usize {
        self.transforms.len()
    }

    /// Whether the clip has no picture.
    pub fn is_empty(&self) -> bool {
        self.transforms.is_empty()
    }

    /// Whether the face was lost in picture `index`, and its place is between its neighbours'.
    pub fn is_lost(&self, index: usize) -> bool {
        self.scores[index] < LEAST_SCORE
    }

    /// Mouth `index`, `[height, width, 3]`.
    pub fn image(&self, index: usize) -> &[u8] {
        let stride = self.width * self.height * 3;
        &self.images[index * stride..][..stride]
    }
}

/// The maps of every picture's rectangle once it follows the lips, what was seen of these, and their outline in every picture.
type Followed = (Vec<Affine>, Option<LipsSeen>, Vec<Option<Outline>>);

/// What is known of a speaker's face: enough to find the same mouth rectangle in any clip.
pub struct Tracker {
    reference: Reference,
}

impl Tracker {
    /// Learns the template, the mouth's place and the colours from some clips of one speaker.
    ///
    /// A dozen clips spread over the corpus are enough, each thinned to a dozen pictures or more ([`Frames::thinned`]). Clips without
    /// a face are left out; an error when no clip has one.
    pub fn reference(clips: &[Frames]) -> Result<Tracker> {
        Ok(Tracker {
            reference: learn(clips)?,
        })
    }

    /// Size of the mouth images, (width, height).
    pub fn mouth_size(&self) -> (usize, usize) {
        (self.reference.mouth.width, self.reference.mouth.height)
    }

    /// The mouth in every picture of `frames`.
    pub fn track(&self, frames: &Frames) -> Result<MouthTrack> {
        let mut detector = Detector::new()?;
        let face = detector.find_in_clip(frames)?;
        let view = View::new(frames, face, self.reference.side);
        let (maps, scores) = {
            let most_lost = match self.reference.mouth.anchor {
                Some(_) => MOST_LOST_WITH_LIPS,
                None => MOST_LOST,
            };
            follow(&self.reference.template, &view, face, &mut detector, most_lost)?
        };
        let (maps, lips, outlines) = self.on_the_lips(frames, &view, &mut detector, steadied(&maps))?;
        let colour = self.clip_colour(&view, &maps);
        let mouth = &self.reference.mouth;
        let to_template = Affine::scaled(1.0, mouth.left, mouth.top);
        let mut images = Vec::with_capacity(frames.len() * mouth.width * mouth.height * 3);
        for (index, map) in maps.iter().enumerate() {
            let planes = view.colours(index);
            let map = map.after(&to_template);
            for y in 0..mouth.height {
                for x in 0..mouth.width {
                    let (fx, fy) = map.apply(x as f32, y as f32);
                    for (plane, channel) in planes.iter().zip(&colour) {
                        images.push((channel.apply(plane.sample(fx, fy)) + 0.5).clamp(0.0, 255.0) as u8);
                    }
                }
            }
        }
        Ok(MouthTrack {
            width: mouth.width,
            height: mouth.height,
            images,
            transforms: maps
                .iter()
                .map(|m| view.to_frame().after(m).after(&to_template))
                .collect(),
            scores,
            colour,
            rate_hz: frames.rate_hz,
            lips,
            outlines,
        })
    }

    /// Lets the rectangle follow the lips slowly, and judges whether it is on them.
    fn on_the_lips(
        &self,
        frames: &Frames,
        view: &View,
        detector: &mut Detector,
        mut maps: Vec<Affine>,
    ) -> Result<Followed> {
        let mouth = &self.reference.mouth;
        let Some(anchor) = mouth.anchor else {
            return Ok((maps, None, Vec::new()));
        };
        let to_template = Affine::scaled(1.0, mouth.left, mouth.top);
        let in_rectangle = |map: &Affine| view.to_frame().after(map).after(&to_template).inverse();
        let step = (frames.rate_hz / LOOKS_HZ).round().max(1.0) as usize;
        let mut walk = Walk::new(LandmarkFinder::new()?, frames);
        let looks: Vec<(usize, Option<Landmarks>)> = (0..maps.len())
            .step_by(step)
            .map(|index| {
                let registered = view.face(&maps[index], self.reference.side);
                let detected = std::iter::once_with(|| detector.find(frames, index));
                let faces = std::iter::once(registered).chain(detected.flatten());
                (index, walk.at(index, faces))
            })
            .collect();
        let lips = |maps: &[Affine]| -> Vec<(usize, Lips)> {
            let seen = looks.iter().filter_map(|(index, found)| {
                Some((*index, found.as_ref()?.lips(&in_rectangle(&maps[*index])?)))
            });
            seen.collect()
        };
        let seen = lips(&maps);
        if (seen.len() as f32) < LEAST_SEEN * looks.len() as f32 {
            bail!(
                Data,
                "lips are seen in {} of {} pictures looked at only (turned away, covered, or another face)",
                seen.len(),
                looks.len()
            );
        }
        let away: Vec<(usize, f32, f32)> = seen
            .iter()
            .map(|(index, lips)| (*index, lips.anchor.0 - anchor.0, lips.anchor.1 - anchor.1))
            .collect();
        let width = FOLLOWS_S * frames.rate_hz;
        for (index, map) in maps.iter_mut().enumerate() {
            let (mut dx, mut dy, mut total) = (0.0f32, 0.0f32, 0.0f32);
            for (at, x, y) in &away {
                let weight = (-0.5 * ((*at as f32 - index as f32) / width).powi(2)).exp() + 1e-6;
                (dx, dy, total) = (dx + weight * x, dy + weight * y, total + weight);
            }
            *map = map.after(&Affine::scaled(1.0, dx / total, dy / total));
        }
        let (right, bottom) = ((mouth.width - 1) as f32, (mouth.height - 1) as f32);
        let followed = lips(&maps);
        let inside = |lips: &Lips| {
            let [left, top, to_right, to_bottom] = lips.extent;
            left >= 0.0 && top >= 0.0 && to_right <= right && to_bottom <= bottom
        };
        let whole = followed.iter().filter(|(_, lips)| inside(lips)).count();
        let mut wander: Vec<f32> = followed
            .iter()
            .map(|(_, lips)| (lips.anchor.0 - anchor.0).hypot(lips.anchor.1 - anchor.1))
            .collect();
        wander.sort_by(f32::total_cmp);
        let found = LipsSeen {
            looked: looks.len(),
            seen: followed.len(),
            whole,
            wander: wander.get(wander.len() * 19 / 20).copied().unwrap_or(0.0) / mouth.width as f32,
        };
        if (whole as f32) < LEAST_WHOLE * followed.len() as f32 {
            bail!(
                Data,
                "the mouth's rectangle is not on the mouth: the lips are whole in {whole} of {} pictures only",
                followed.len()
            );
        }
        let outlines = between(&looks, maps.len());
        Ok((maps, Some(found), outlines))
    }

    /// The clip's mean colours of the registered face, fitted to the speaker's.
    fn clip_colour(&self, view: &View, maps: &[Affine]) -> [ChannelMap; 3] {
        let seen = view.mean_colours(maps.iter().enumerate(), &self.reference.skin);
        std::array::from_fn(|c| colour::fit(&seen[c], &self.reference.colours[c]))
    }
}

/// The lips' outline in every one of `count` pictures, from those looked at.
fn between(looks: &[(usize, Option<Landmarks>)], count: usize) -> Vec<Option<Outline>> {
    let mut out = vec![None; count];
    let seen = |look: &(usize, Option<Landmarks>)| Some((look.0, look.1.as_ref()?.outline()));
    for (n, look) in looks.iter().enumerate() {
        let Some((from, here)) = seen(look) else { continue };
        let next = looks.get(n + 1);
        let until = next.map_or(count, |next| next.0);
        let there = next.and_then(seen).map_or(here, |(_, there)| there);
        for (index, outline) in out.iter_mut().enumerate().take(until).skip(from) {
            let share = (index - from) as f32 / (until - from) as f32;
            let on_the_way = |k: usize| {
                let ((x, y), (to_x, to_y)) = (here[k], there[k]);
                (x + share * (to_x - x), y + share * (to_y - y))
            };
            *outline = Some(std::array::from_fn(on_the_way));
        }
    }
    out
}

/// A clip at the resolution at which it is worked on: reduced so that its face is about as large as the template's.
pub(crate) struct View<'a> {
    frames: &'a Frames,
    factor: usize,
    /// Pixels over which shading is taken away.
    shading: usize,
}

impl<'a> View<'a> {
    pub(crate) fn new(frames: &'a Frames, face: FaceBox, template_side: f32) -> Self {
        let factor = (face.side / template_side).round().max(1.0) as usize;
        Self {
            frames,
            factor,
            shading: (face.side / factor as f32 * 0.08).round() as usize,
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    pub(crate) fn frames(&self) -> &'a Frames {
        self.frames
    }

    pub(crate) fn colours(&self, index: usize) -> [Plane; 3] {
        colour_planes(self.frames, index, self.factor)
    }

    /// What is registered: luminance without shading.
    pub(crate) fn pyramid(&self, index: usize) -> Pyramid {
        Pyramid::new(
            luminance(&self.colours(index)).without_shading(self.shading),
            LEVELS,
        )
    }

    /// From reduced pixels to the frame's.
    pub(crate) fn to_frame(&self) -> Affine {
        let k = self.factor as f32;
        Affine::scaled(k, 0.5 * (k - 1.0), 0.5 * (k - 1.0))
    }

    /// From the template to reduced pixels, as the face's box says.
    pub(crate) fn start(&self, face: FaceBox, template_side: f32) -> Affine {
        let to_view = self.to_frame().inverse().unwrap_or(Affine::IDENTITY);
        to_view.after(&Affine::scaled(face.side / template_side, face.left, face.top))
    }

    /// The face's box in a picture whose map from the template this is.
    pub(crate) fn face(&self, map: &Affine, template_side: f32) -> FaceBox {
        let map = self.to_frame().after(map);
        let (left, top) = map.apply(0.0, 0.0);
        FaceBox {
            left,
            top,
            side: template_side * map.0[0].hypot(map.0[3]),
        }
    }

    /// Mean colours over pictures of the clip (every third of `maps`) at points of the template, `[channel][point]`.
    pub(crate) fn mean_colours<'m>(
        &self,
        maps: impl Iterator<Item = (usize, &'m Affine)>,
        points: &[(f32, f32)],
    ) -> [Vec<f32>; 3] {
        let mut sums: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; points.len()]);
        let mut count = 0.0f32;
        for (index, map) in maps.step_by(3) {
            let planes = self.colours(index);
            for (plane, sum) in planes.iter().zip(&mut sums) {
                for (&(x, y), s) in points.iter().zip(sum) {
                    let (x, y) = map.apply(x, y);
                    *s += plane.sample(x, y);
                }
            }
            count += 1.0;
        }
        sums.iter_mut().flatten().for_each(|s| *s /= count.max(1.0));
        sums
    }
}

/// Registers every picture of a clip, each from the one before; where that fails, from the face's box. None where the face is lost.
pub(crate) fn follow_some(
    template: &Template,
    view: &View,
    face: FaceBox,
    detector: &mut Detector,
) -> Vec<Option<Registration>> {
    let side = template.side();
    let mut found: Vec<Option<Registration>> = Vec::with_capacity(view.len());
    for index in 0..view.len() {
        let picture = view.pyramid(index);
        let before = found.iter().rev().flatten().next().map(|r| r.map);
        let mut best = before.and_then(|map| template.register(&picture, map));
        if best.is_none_or(|b| b.score < SURE_SCORE) {
            let seen = detector.find(view.frames, index);
            for start in starts(view, face, seen, side) {
                let other = template.register(&picture, start);
                if other.map_or(-1.0, |o| o.score) > best.map_or(-1.0, |b| b.score) {
                    best = other;
                }
                if best.is_some_and(|b| b.score >= SURE_SCORE) {
                    break;
                }
            }
        }
        found.push(best.filter(|b| b.score >= LEAST_SCORE));
    }
    found
}

/// [`follow_some`] with the gaps filled, and the scores; in error where there are many.
fn follow(
    template: &Template,
    view: &View,
    face: FaceBox,
    detector: &mut Detector,
    most_lost: f32,
) -> Result<(Vec<Affine>, Vec<f32>)> {
    let found = follow_some(template, view, face, detector);
    let lost = found.iter().filter(|f| f.is_none()).count();
    if lost as f32 > most_lost * view.len() as f32 {
        bail!(
            Data,
            "the face is lost in {lost} of {} pictures (turned away, covered, or another person)",
            view.len()
        );
    }
    let scores = found.iter().map(|f| f.map_or(0.0, |r| r.score)).collect();
    Ok((filled(&found), scores))
}

/// Starts to try: the boxes themselves, then somewhat beside, larger and smaller.
fn starts(view: &View, clip: FaceBox, seen: Option<FaceBox>, side: f32) -> Vec<Affine> {
    let mut starts = Vec::new();
    for face in seen.into_iter().chain([clip]) {
        starts.push(view.start(face, side));
    }
    for (dx, dy, scale) in [
        (0.0, 0.06, 1.0),
        (0.0, -0.06, 1.0),
        (0.06, 0.0, 1.0),
        (-0.06, 0.0, 1.0),
        (0.0, 0.0, 0.9),
        (0.0, 0.0, 1.1),
    ] {
        let grown = clip.side * scale;
        let beside = FaceBox {
            left: clip.left + dx * clip.side - 0.5 * (grown - clip.side),
            top: clip.top + dy * clip.side - 0.5 * (grown - clip.side),
            side: grown,
        };
        starts.push(view.start(beside, side));
    }
    starts
}

/// Gaps filled from the nearest pictures that were found, linearly in between.
fn filled(found: &[Option<Registration>]) -> Vec<Affine> {
    let at = |i: usize| found[i].map(|r| r.map);
    (0..found.len())
        .map(|i| {
            if let Some(map) = at(i) {
                return map;
            }
            let before = (0..i).rev().find_map(|j| at(j).map(|m| (j, m)));
            let after = (i + 1..found.len()).find_map(|j| at(j).map(|m| (j, m)));
            let near = match (before, after) {
                (Some((j, b)), Some((k, a))) => Affine::mean([(&b, (k - i) as f32), (&a, (i - j) as f32)]),
                (Some((_, m)), None) | (None, Some((_, m))) => Some(m),
                (None, None) => None,
            };
            near.unwrap_or(Affine::IDENTITY)
        })
        .collect()
}

/// Registration's own noise taken out: each map a weighted mean over two pictures on either side.
fn steadied(maps: &[Affine]) -> Vec<Affine> {
    (0..maps.len())
        .map(|i| {
            let near = (i.saturating_sub(2)..(i + 3).min(maps.len())).map(|j| {
                let weight = [3.0, 2.0, 1.0][i.abs_diff(j)];
                (&maps[j], weight)
            });
            Affine::mean(near).unwrap_or(maps[i])
        })
        .collect()
}
