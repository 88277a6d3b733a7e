//! Where the mouth is in every picture of a clip, steady, whatever the head does.
//!
//! The rigid upper face (brows, eyes, bridge of the nose) is registered in every picture to a template that all clips of a
//! speaker share; the mouth itself is never used. The mouth image is then a fixed rectangle of the template's coordinates,
//! sampled through the registration.

use super::affine::Affine;
use super::colour::{self, ChannelMap};
use super::face::{Detector, FaceBox};
use super::image::{Plane, Pyramid, colour_planes, luminance};
use super::reference::{Reference, learn};
use super::register::{LEVELS, Registration, Template};
use crate::error::{Result, bail};
use lipstream_media::video::Frames;

/// A registration below this correlation with the template has lost the face.
pub(crate) const LEAST_SCORE: f32 = 0.55;
/// One above this needs no second opinion.
const SURE_SCORE: f32 = 0.8;
/// More lost pictures than this share, and the clip is refused.
const MOST_LOST: f32 = 0.1;

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

    /// Mouth `index`, `[height, width, 3]`.
    pub fn image(&self, index: usize) -> &[u8] {
        let stride = self.width * self.height * 3;
        &self.images[index * stride..][..stride]
    }
}

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
        let (maps, scores) = follow(&self.reference.template, &view, face, &mut detector)?;
        let maps = steadied(&maps);
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
        })
    }

    /// The clip's mean colours of the registered face, fitted to the speaker's.
    fn clip_colour(&self, view: &View, maps: &[Affine]) -> [ChannelMap; 3] {
        let seen = view.mean_colours(maps, &self.reference.skin);
        std::array::from_fn(|c| colour::fit(&seen[c], &self.reference.colours[c]))
    }
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

    /// Mean colours over the clip (every third picture) at points of the template, `[channel][point]`.
    pub(crate) fn mean_colours(&self, maps: &[Affine], points: &[(f32, f32)]) -> [Vec<f32>; 3] {
        let mut sums: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; points.len()]);
        let mut count = 0.0f32;
        for (index, map) in maps.iter().enumerate().step_by(3) {
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

/// Registers every picture of a clip, each from the one before; where that fails, from the face's box.
pub(crate) fn follow(
    template: &Template,
    view: &View,
    face: FaceBox,
    detector: &mut Detector,
) -> Result<(Vec<Affine>, Vec<f32>)> {
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
    let lost = found.iter().filter(|f| f.is_none()).count();
    if lost as f32 > MOST_LOST * view.len() as f32 {
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
