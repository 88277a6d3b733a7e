//! What one speaker's clips have in common: the upper-face template, the mouth's place, the colours.

use super::colour;
use super::face::{Detector, FaceBox, median};
use super::image::{Plane, luminance};
use super::landmarks::{LandmarkFinder, Lips, Walk};
use super::register::Template;
use super::tracker::{View, follow_some};
use crate::error::{Error, Result};
use lipstream::affine::Affine;
use lipstream_media::video::Frames;

/// Widest face box of a template: a mouth of 90 × 68 pixels.
const MAX_SIDE: f32 = 160.0;
/// The registered region, in sides of the face box from its left upper corner: left, top, right, bottom.
const UPPER_FACE: [f32; 4] = [0.02, -0.05, 0.98, 0.62];
/// The mouth rectangle's width over the face box's side, where no lips are seen; it is three quarters as high.
const MOUTH_WIDTH: f32 = 0.56;
/// The lips' width, in the middle of all pictures, over the rectangle's.
const LIPS_WIDTH: f32 = 0.6;
/// Lips may reach so far, over half of the rectangle's sides, in all but a fiftieth of the pictures.
const LIPS_REACH: f32 = 0.92;
/// Of the pictures that are looked at, so many must show lips, or motion says where the mouth is.
const LEAST_LIPS: f32 = 0.5;
/// Where the mouth's centre is expected.
const MOUTH_CENTRE: (f32, f32) = (0.5, 0.84);
/// Pictures of a clip that go into the template.
const PICKS: usize = 8;
const ROUNDS: usize = 3;
/// Pictures of a clip in which the face must be found.
const LEAST_PICTURES: usize = 6;

/// The mouth rectangle in template coordinates: pixel (0, 0) lies at (left, top), the scale is the template's.
pub(crate) struct MouthPlace {
    pub left: f32,
    pub top: f32,
    pub width: usize,
    pub height: usize,
    /// Where speech moves the lips' surroundings least ([`Lips::anchor`]), in pixels of the rectangle; None where no lips were seen.
    pub anchor: Option<(f32, f32)>,
}

pub(crate) struct Reference {
    pub template: Template,
    /// Side of the face box in template pixels; the box's corner is the template's origin.
    pub side: f32,
    pub mouth: MouthPlace,
    /// Points of the face whose colours are compared.
    pub skin: Vec<(f32, f32)>,
    /// The speaker's colours there, `[channel][point]`.
    pub colours: [Vec<f32>; 3],
}

/// A clip, and those of its pictures in which the face was found: their numbers and the map from the template.
struct Seen<'a> {
    view: &'a View<'a>,
    pictures: Vec<(usize, Affine)>,
}

/// A clip with its face.
struct Sample<'a> {
    view: View<'a>,
    face: FaceBox,
    /// Template to reduced pixels, one per pick.
    maps: Vec<Option<Affine>>,
    picks: Vec<usize>,
}

pub(crate) fn learn(clips: &[Frames]) -> Result<Reference> {
    let mut detector = Detector::new()?;
    let mut faces = Vec::new();
    let mut reason = Error::Data("there is no clip to learn the face from".into());
    for (index, clip) in clips.iter().enumerate() {
        match detector.find_in_clip(clip) {
            Ok(face) => faces.push((index, face)),
            Err(error) => reason = error,
        }
    }
    if faces.is_empty() {
        return Err(reason);
    }
    // The clip whose face is of the middle size gives the first template.
    faces.sort_by(|a, b| a.1.side.total_cmp(&b.1.side));
    let middle = faces.len() / 2;
    let side = faces[middle].1.side.min(MAX_SIDE);
    let mut samples: Vec<Sample> = faces
        .iter()
        .map(|&(index, face)| {
            let view = View::new(&clips[index], face, side);
            let count = view.len();
            let number = count.min(PICKS);
            Sample {
                picks: (0..number).map(|i| (2 * i + 1) * count / (2 * number)).collect(),
                maps: vec![None; number],
                view,
                face,
            }
        })
        .collect();
    let template = common_template(&mut samples, middle, side)
        .ok_or_else(|| Error::Data("the upper face has too little structure to hold on to".into()))?;

    // Every picture of every clip, with the final template.
    let mut tracks = Vec::new();
    for sample in &samples {
        // A bad picture is left out; it does not spoil the others.
        let found = follow_some(&template, &sample.view, sample.face, &mut detector);
        let pictures: Vec<(usize, Affine)> = found
            .iter()
            .enumerate()
            .filter_map(|(index, found)| Some((index, found.as_ref()?.map)))
            .collect();
        if pictures.len() < LEAST_PICTURES.min(found.len()) {
            reason = Error::Data(format!(
                "the face is lost in {} of {} pictures (turned away, covered, or another person)",
                found.len() - pictures.len(),
                found.len()
            ));
            continue;
        }
        tracks.push(Seen {
            view: &sample.view,
            pictures,
        });
    }
    if tracks.is_empty() {
        return Err(reason);
    }
    let mouth = match mouth_of_lips(&seen_lips(&tracks, side)?, side) {
        Some(place) => place,
        None => mouth_of_motion(&tracks, side),
    };
    let skin = skin_points(&mouth, side);
    let colours = common_colours(&tracks, &skin);
    Ok(Reference {
        template,
        side,
        mouth,
        skin,
        colours,
    })
}

/// The template's grid: origin, width, height.
fn grid(side: f32) -> ((f32, f32), usize, usize) {
    let [left, top, right, bottom] = UPPER_FACE.map(|v| (v * side).round());
    ((left, top), (right - left) as usize, (bottom - top) as usize)
}

/// Soft-edged ellipse over the grid: its corners are background and hair.
fn window(width: usize, height: usize) -> Plane {
    let (cx, cy) = (0.5 * (width - 1) as f32, 0.5 * (height - 1) as f32);
    Plane::from_fn(width, height, |x, y| {
        let (u, v) = ((x as f32 - cx) / cx, (y as f32 - cy) / cy);
        let r = (u.abs().powi(4) + v.abs().powi(4)).sqrt().sqrt();
        (1.0 - r).clamp(0.0, 0.15) / 0.15
    })
}

/// Registers picks of all clips to a template, averages them into the next, three times over.
fn common_template(samples: &mut [Sample], first: usize, side: f32) -> Option<Template> {
    let (origin, width, height) = grid(side);
    let window = window(width, height);
    let sample_at = |plane: &Plane, map: &Affine| {
        Plane::from_fn(width, height, |x, y| {
            let (x, y) = map.apply(origin.0 + x as f32, origin.1 + y as f32);
            plane.sample(x, y)
        })
    };
    let pick = samples[first].picks.len() / 2;
    let start = samples[first].view.start(samples[first].face, side);
    let picture = samples[first].view.pyramid(samples[first].picks[pick]);
    let mut image = sample_at(&picture.levels[0], &start);
    let mut weights = window.clone();
    for round in 0..ROUNDS {
        let template = Template::new(&image, &weights, origin, side)?;
        for sample in samples.iter_mut() {
            let start = sample.view.start(sample.face, side);
            for (map, &index) in sample.maps.iter_mut().zip(&sample.picks) {
                let picture = sample.view.pyramid(index);
                let found = [*map, Some(start)]
                    .into_iter()
                    .flatten()
                    .filter_map(|s| template.register(&picture, s))
                    .max_by(|a, b| a.score.total_cmp(&b.score));
                *map = found
                    .filter(|f| f.score >= super::tracker::LEAST_SCORE)
                    .map(|f| f.map);
            }
        }
        if round == 0 {
            centre_on_average(samples, side);
        }
        // Mean and variance of the registered picks, each with its gain and level brought to one.
        let mut sum = Plane::new(width, height);
        let mut square = Plane::new(width, height);
        let mut count = 0.0f32;
        for sample in samples.iter() {
            for (map, &index) in sample.maps.iter().zip(&sample.picks) {
                let Some(map) = map else { continue };
                let mut patch = sample_at(&sample.view.pyramid(index).levels[0], map);
                normalise(&mut patch, &window);
                for ((s, q), v) in sum.data.iter_mut().zip(&mut square.data).zip(&patch.data) {
                    *s += v;
                    *q += v * v;
                }
                count += 1.0;
            }
        }
        if count == 0.0 {
            return None;
        }
        for ((s, q), (w, edge)) in sum
            .data
            .iter_mut()
            .zip(&square.data)
            .zip(weights.data.iter_mut().zip(&window.data))
        {
            *s /= count;
            let variance = (q / count - *s * *s).max(0.0);
            // A tenth of the patch's variance is camera noise and light.
            *w = edge / (0.1 + variance);
        }
        image = sum;
    }
    Template::new(&image, &weights, origin, side)
}

/// Zero mean and unit variance inside the window.
fn normalise(patch: &mut Plane, window: &Plane) {
    let total: f32 = window.data.iter().sum();
    let mean = patch
        .data
        .iter()
        .zip(&window.data)
        .map(|(v, w)| v * w)
        .sum::<f32>()
        / total;
    let square = patch
        .data
        .iter()
        .zip(&window.data)
        .map(|(v, w)| (v - mean).powi(2) * w)
        .sum::<f32>()
        / total;
    let scale = 1.0 / square.sqrt().max(1e-3);
    patch.data.iter_mut().for_each(|v| *v = (*v - mean) * scale);
}

/// Moves the template's coordinates to the average pose and place of all clips' faces: the first template's are one picture's.
fn centre_on_average(samples: &mut [Sample], side: f32) {
    let mut linear = Vec::new();
    let mut corners = Vec::new();
    for sample in samples.iter() {
        let start = sample.view.start(sample.face, side);
        let Some(mean) = Affine::mean(sample.maps.iter().flatten().map(|m| (m, 1.0))) else {
            continue;
        };
        // The registered map relative to the box's: what the box's middle is in the template, and the pose.
        let Some(inverse) = mean.inverse() else { continue };
        let (x, y) = start.apply(0.5 * side, 0.5 * side);
        corners.push(inverse.apply(x, y));
        let scale = 1.0 / start.0[0];
        let [a, b, _, d, e, _] = mean.0.map(|v| v * scale);
        linear.push(Affine([a, b, 0.0, d, e, 0.0]));
    }
    let Some(average) = Affine::mean(linear.iter().map(|m| (m, 1.0))).and_then(|m| m.inverse()) else {
        return;
    };
    let x = median(corners.iter().map(|c| c.0));
    let y = median(corners.iter().map(|c| c.1));
    // New template coordinates to old: turned and scaled about the box's middle.
    let (dx, dy) = average.apply(0.5 * side, 0.5 * side);
    let change = Affine::scaled(1.0, x - dx, y - dy).after(&average);
    for map in samples.iter_mut().flat_map(|s| s.maps.iter_mut()).flatten() {
        *map = map.after(&change);
    }
}

/// The lips in every picture, in template coordinates; None where the network sees no face.
fn seen_lips(tracks: &[Seen], side: f32) -> Result<Vec<Option<Lips>>> {
    let mut all = Vec::new();
    for Seen { view, pictures } in tracks {
        let mut walk = Walk::new(LandmarkFinder::new()?, view.frames());
        for (index, map) in pictures {
            let found = walk.at(*index, [view.face(map, side)]);
            let to_template = view.to_frame().after(map).inverse();
            all.push(
                found
                    .zip(to_template)
                    .map(|(landmarks, map)| landmarks.lips(&map)),
            );
        }
    }
    Ok(all)
}

/// The mouth's rectangle: around the lips, as large as they need.
fn mouth_of_lips(lips: &[Option<Lips>], side: f32) -> Option<MouthPlace> {
    let seen: Vec<Lips> = lips.iter().flatten().copied().collect();
    if seen.is_empty() || (seen.len() as f32) < LEAST_LIPS * lips.len() as f32 {
        return None;
    }
    let middle = |of: fn(&Lips) -> f32| median(seen.iter().map(of));
    let (cx, cy) = (
        middle(|l| 0.5 * (l.extent[0] + l.extent[2])),
        middle(|l| 0.5 * (l.extent[1] + l.extent[3])),
    );
    let lips_width = middle(|l| l.extent[2] - l.extent[0]);
    // How far the lips reach from there, sideways and up or down as the rectangle is three quarters as high.
    let reach = |l: &Lips| {
        let across = (l.extent[2] - cx).max(cx - l.extent[0]);
        let down = (l.extent[3] - cy).max(cy - l.extent[1]);
        across.max(down / 0.75)
    };
    let mut reaches: Vec<f32> = seen.iter().map(reach).collect();
    let place = reaches.len() * 49 / 50;
    let reach = *reaches
        .select_nth_unstable_by(place.min(seen.len() - 1), f32::total_cmp)
        .1;
    let wanted = (lips_width / LIPS_WIDTH)
        .max(2.0 * reach / LIPS_REACH)
        .min(0.9 * side);
    let anchor = (middle(|l| l.anchor.0), middle(|l| l.anchor.1));
    let place = MouthPlace::around((cx, cy), wanted);
    Some(MouthPlace {
        anchor: Some((anchor.0 - place.left, anchor.1 - place.top)),
        ..place
    })
}

impl MouthPlace {
    /// About so wide, a multiple of eight pixels, and three quarters as high.
    fn around((cx, cy): (f32, f32), wanted: f32) -> Self {
        let width = ((wanted / 8.0).round() * 8.0).max(16.0);
        let height = 0.75 * width;
        Self {
            left: (cx - 0.5 * (width - 1.0)).round(),
            top: (cy - 0.5 * (height - 1.0)).round(),
            width: width as usize,
            height: height as usize,
            anchor: None,
        }
    }
}

/// The mouth's rectangle where no lips are seen, as in a drawing: where the lower face moves most, about where a mouth is expected.
fn mouth_of_motion(tracks: &[Seen], side: f32) -> MouthPlace {
    let motion = motion_map(tracks, side);
    let (mut cx, mut cy) = (MOUTH_CENTRE.0 * side, MOUTH_CENTRE.1 * side);
    let (ox, oy) = LOWER_FACE_ORIGIN;
    let (ox, oy) = ((ox * side).round(), (oy * side).round());
    // Mean shift with a window of the size of the lips.
    let (rx, ry) = (0.2 * side, 0.11 * side);
    let threshold = median(motion.data.iter().copied());
    for _ in 0..20 {
        let (mut sx, mut sy, mut total) = (0.0f32, 0.0f32, 0.0f32);
        for y in 0..motion.height {
            for x in 0..motion.width {
                let (px, py) = (ox + x as f32, oy + y as f32);
                let near = (-0.5 * (((px - cx) / rx).powi(2) + ((py - cy) / ry).powi(2))).exp();
                let weight = near * (motion.data[y * motion.width + x] - threshold).max(0.0);
                sx += weight * px;
                sy += weight * py;
                total += weight;
            }
        }
        if total <= 0.0 {
            break;
        }
        // Never further from the expected place than a mouth can be.
        cx = (sx / total).clamp(0.38 * side, 0.62 * side);
        cy = (sy / total).clamp(0.72 * side, 0.96 * side);
    }
    MouthPlace::around((cx, cy), MOUTH_WIDTH * side)
}

/// Left upper corner of the region searched for motion, in box sides, and its size.
const LOWER_FACE_ORIGIN: (f32, f32) = (0.1, 0.58);
const LOWER_FACE_SIZE: (f32, f32) = (0.8, 0.55);

/// Standard deviation over time of the luminance, averaged over clips.
fn motion_map(tracks: &[Seen], side: f32) -> Plane {
    let (ox, oy) = (
        (LOWER_FACE_ORIGIN.0 * side).round(),
        (LOWER_FACE_ORIGIN.1 * side).round(),
    );
    let width = (LOWER_FACE_SIZE.0 * side) as usize;
    let height = (LOWER_FACE_SIZE.1 * side) as usize;
    let mut motion = Plane::new(width, height);
    for Seen { view, pictures, .. } in tracks {
        let mut sum = Plane::new(width, height);
        let mut square = Plane::new(width, height);
        for (index, map) in pictures {
            let grey = luminance(&view.colours(*index));
            for y in 0..height {
                for x in 0..width {
                    let (fx, fy) = map.apply(ox + x as f32, oy + y as f32);
                    let value = grey.sample(fx, fy);
                    sum.data[y * width + x] += value;
                    square.data[y * width + x] += value * value;
                }
            }
        }
        let count = pictures.len() as f32;
        for ((m, s), q) in motion.data.iter_mut().zip(&sum.data).zip(&square.data) {
            let mean = s / count;
            *m += (q / count - mean * mean).max(0.0).sqrt() / tracks.len() as f32;
        }
    }
    motion
}

/// Every second pixel of the face outside the mouth rectangle.
fn skin_points(mouth: &MouthPlace, side: f32) -> Vec<(f32, f32)> {
    let mut points = Vec::new();
    let (right, bottom) = (mouth.left + mouth.width as f32, mouth.top + mouth.height as f32);
    let mut y = (0.15 * side).round();
    while y < 1.0 * side {
        let mut x = (0.12 * side).round();
        while x < 0.88 * side {
            let in_mouth = x >= mouth.left && x < right && y >= mouth.top && y < bottom;
            if !in_mouth {
                points.push((x, y));
            }
            x += 2.0;
        }
        y += 2.0;
    }
    points
}

/// Colours of the speaker: the mean of all clips, after each has been brought to the mean.
fn common_colours(tracks: &[Seen], skin: &[(f32, f32)]) -> [Vec<f32>; 3] {
    let seen: Vec<[Vec<f32>; 3]> = tracks
        .iter()
        .map(|seen| {
            seen.view
                .mean_colours(seen.pictures.iter().map(|(index, map)| (*index, map)), skin)
        })
        .collect();
    std::array::from_fn(|c| {
        let mean_of = |clips: &[Vec<f32>]| -> Vec<f32> {
            (0..skin.len())
                .map(|p| clips.iter().map(|v| v[p]).sum::<f32>() / clips.len() as f32)
                .collect()
        };
        let clips: Vec<Vec<f32>> = seen.iter().map(|s| s[c].clone()).collect();
        let mut mean = mean_of(&clips);
        for _ in 0..2 {
            let brought: Vec<Vec<f32>> = clips
                .iter()
                .map(|v| {
                    let map = colour::fit(v, &mean);
                    v.iter().map(|x| map.apply(*x)).collect()
                })
                .collect();
            mean = mean_of(&brought);
        }
        mean
    })
}
