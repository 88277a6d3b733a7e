//! The pictures that a hierarchical model is trained and judged on: which, what was heard with each, and what each looks like through the areas' geometries.
use std::path::Path;

use lipstream::kinds::hierarchical::speech::Hearing;
use lipstream::kinds::hierarchical::yiq;
use lipstream::progress::{Progress, Steps};
use lipstream_media::sound;
use lipstream_media::video::{self, Frames};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};
use rayon::prelude::*;

use super::appearance::Geometry;
use super::landmarks::Landmarks;
use crate::corpus::discover::{ClipFiles, Options, discover};
use crate::error::{Context as _, Error, Result, ensure};
use crate::features::{Clip, FeatureFolder, Split};
use crate::vision::{colour_planes, luminance};
use lipstream::kinds::hierarchical::mesh::{Patch, points};

/// Some pictures of one clip.
#[derive(Clone, Debug)]
pub struct Picked {
    /// The clip's files.
    pub files: ClipFiles,
    /// Pictures of the video, in order.
    pub pictures: Vec<usize>,
    /// Landmarks of each, x₀, y₀, x₁, … in pixels of the decoded pictures, which of large videos are reduced ([`video::MAX_LINES`]), `[n, 2 × landmarks]`.
    pub landmarks: Array2<f32>,
    /// What was heard with each, `[n, numbers of the hearing]`.
    pub heard: Array2<f32>,
    /// Eigenmouth weights of each, `[n, D]`.
    pub mouths: Array2<f32>,
}

/// Which pictures of a split are picked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Which {
    /// About so many, evenly from all clips and over each.
    Spread(usize),
    /// All pictures of so many clips at most, evenly spread over all clips.
    Clips(usize),
}

/// Picks pictures of a split's clips that have landmarks.
///
/// # Errors
///
/// A clip whose video is not found or whose landmarks are of another number of pictures; no picture at all.
pub fn pick(
    folder: &FeatureFolder,
    split: Split,
    landmarks: &Landmarks,
    videos: &Path,
    which: Which,
    hearing: &Hearing,
) -> Result<Vec<Picked>> {
    let found = discover(videos, Some(&folder.root), &Options::default())?;
    let clips: Vec<&Clip> = folder.split(split).filter(|clip| clip.video_frames > 0).collect();
    // Where fewer pictures than clips are wanted, evenly spread clips give one each.
    let step = |most: usize| clips.len().div_ceil(most.max(1)).max(1);
    let (each, step) = match which {
        Which::Clips(most) => (usize::MAX, step(most)),
        Which::Spread(most) => {
            let each = (most as f64 / clips.len().max(1) as f64).round().max(1.0);
            (each as usize, step(most))
        }
    };
    let picked: Vec<Picked> = clips
        .into_par_iter()
        .step_by(step)
        .map(|clip| {
            let files = found
                .clips
                .iter()
                .find(|files| files.id == clip.id && files.video.is_some());
            let files = files.ok_or_else(|| {
                Error::Data(format!(
                    "{} holds no video of clip {}: say with --videos where they are",
                    videos.display(),
                    clip.id
                ))
            })?;
            of_clip(folder, clip, files, landmarks, each, hearing)
                .with_context(|| format!("clip {}", clip.id))
        })
        .filter(|picked| !picked.as_ref().is_ok_and(|picked| picked.pictures.is_empty()))
        .collect::<Result<_>>()?;
    ensure!(
        !picked.is_empty(),
        Data,
        "no {} clip of {} has a picture with landmarks",
        split.name(),
        folder.root.display()
    );
    Ok(picked)
}

fn of_clip(
    folder: &FeatureFolder,
    clip: &Clip,
    files: &ClipFiles,
    landmarks: &Landmarks,
    each: usize,
    hearing: &Hearing,
) -> Result<Picked> {
    let points = landmarks
        .of(&clip.id)
        .ok_or_else(|| Error::Data("there are no landmarks of it".to_owned()))?;
    // A tracker may have seen a picture more or less at the end than our decoder.
    let count = points.dim().0.min(clip.video_frames);
    ensure!(
        points.dim().0.abs_diff(clip.video_frames) <= 2,
        Data,
        "there are landmarks of {} pictures; its video has {}",
        points.dim().0,
        clip.video_frames
    );
    let whole: Vec<usize> = (0..count)
        .filter(|t| points.index_axis(Axis(0), *t).iter().all(|v| v.is_finite()))
        .collect();
    let keep = each.min(whole.len());
    let pictures: Vec<usize> = (0..keep)
        .map(|i| whole[(2 * i + 1) * whole.len() / (2 * keep)])
        .collect();
    let reduction = match &files.video {
        Some(video) => video::facts(video).map_err(Error::other)?.reduction,
        None => 1.0,
    };
    let of_pictures = points
        .select(Axis(0), &pictures)
        .mapv(|v| (v + 0.5) / reduction - 0.5);
    let samples = sound::read(&folder.wav_path(&clip.id))
        .map_err(Error::other)?
        .samples;
    let heard = hearing.of_pictures(&samples, count, clip.video_hz);
    Ok(Picked {
        files: files.clone(),
        landmarks: of_pictures.into_shape_with_order((keep, 2 * landmarks.count()))?,
        heard: heard.select(Axis(0), &pictures),
        mouths: folder.visual(clip)?.select(Axis(0), &pictures),
        pictures,
    })
}

/// Rows of all clips one under the other.
pub fn stacked(picked: &[Picked], of: impl Fn(&Picked) -> &Array2<f32>) -> Result<Array2<f32>> {
    let views: Vec<_> = picked.iter().map(|clip| of(clip).view()).collect();
    Ok(concatenate(Axis(0), &views)?)
}

/// The rows of each clip among those of all.
pub fn ranges(picked: &[Picked]) -> Vec<std::ops::Range<usize>> {
    let mut begin = 0;
    picked
        .iter()
        .map(|clip| {
            let range = begin..begin + clip.pictures.len();
            begin = range.end;
            range
        })
        .collect()
}

/// What pictures look like: luminances of each area's pixels, `[n, pixels]` for each area; I and Q of the root at half its size for some of them.
pub struct Looks {
    /// For each area.
    pub textures: Vec<Array2<f32>>,
    /// Rows whose colours were kept.
    pub coloured: Vec<usize>,
    /// `[coloured, 2 × pixels]`.
    pub chroma: Array2<f32>,
}

/// Shows all pictures through the geometries of all areas; of about `colours` of them the colours are kept.
///
/// # Errors
///
/// A video that cannot be decoded or is shorter than was said.
pub fn look(
    picked: &[Picked],
    geometries: &[Geometry],
    colours: usize,
    progress: &dyn Progress,
) -> Result<Looks> {
    let half = geometries[0].half()?;
    let total: usize = picked.iter().map(|clip| clip.pictures.len()).sum();
    let apart = total.div_ceil(colours.max(1)).max(1);
    let steps = Steps::begin(progress, "clips looked at", picked.len());
    let of_clips: Vec<OfClip> = picked
        .par_iter()
        .zip(ranges(picked))
        .map(|(clip, rows)| {
            let path = clip.files.video.as_deref().unwrap_or(Path::new(""));
            let frames = video::decode_part(path, clip.files.part).map_err(Error::other)?;
            let coloured = |row: usize| colours > 0 && row.is_multiple_of(apart);
            let said = of_frames(clip, &frames, geometries, &half, |n| coloured(rows.start + n))
                .with_context(|| path.display().to_string())?;
            steps.made();
            Ok(said)
        })
        .collect::<Result<_>>()?;
    let textures = (0..geometries.len()).map(|area| {
        let views: Vec<_> = of_clips.iter().map(|clip| clip.textures[area].view()).collect();
        Ok(concatenate(Axis(0), &views)?)
    });
    let textures = textures.collect::<Result<_>>()?;
    let chroma: Vec<_> = of_clips.iter().map(|clip| clip.chroma.view()).collect();
    Ok(Looks {
        textures,
        coloured: (0..total)
            .filter(|row| colours > 0 && row.is_multiple_of(apart))
            .collect(),
        chroma: concatenate(Axis(0), &chroma)?,
    })
}

struct OfClip {
    textures: Vec<Array2<f32>>,
    chroma: Array2<f32>,
}

fn of_frames(
    clip: &Picked,
    frames: &Frames,
    geometries: &[Geometry],
    half: &Patch,
    coloured: impl Fn(usize) -> bool,
) -> Result<OfClip> {
    let n = clip.pictures.len();
    let mut textures: Vec<Array2<f32>> = geometries
        .iter()
        .map(|g| Array2::zeros((n, g.patch.len())))
        .collect();
    let mut chroma = Vec::new();
    for (row, (picture, landmarks)) in clip.pictures.iter().zip(clip.landmarks.outer_iter()).enumerate() {
        ensure!(
            *picture < frames.len(),
            Data,
            "it has {} pictures, landmarks say that there is one of number {picture}, counted from 0",
            frames.len()
        );
        let planes = colour_planes(frames, *picture, 1);
        let grey = luminance(&planes);
        for (geometry, texture) in geometries.iter().zip(&mut textures) {
            let shape = points(geometry.of_picture(landmarks).view());
            let seen = geometry.patch.texture(&shape, |[x, y]| grey.sample(x, y));
            texture.row_mut(row).assign(&seen);
        }
        if coloured(row) {
            let shape = points(geometries[0].of_picture(landmarks).view());
            let levels = |[x, y]: [f32; 2]| yiq::of_rgb([0, 1, 2].map(|c| planes[c].sample(x, y)));
            let (i, q): (Vec<f32>, Vec<f32>) =
                half.in_shape(&shape).map(levels).map(|[_, i, q]| (i, q)).unzip();
            chroma.push(concatenate![Axis(0), ArrayView1::from(&i), ArrayView1::from(&q)]);
        }
    }
    let mut rows = Array2::zeros((chroma.len(), 2 * half.len()));
    for (mut row, seen) in rows.outer_iter_mut().zip(&chroma) {
        row.assign(seen);
    }
    Ok(OfClip {
        textures,
        chroma: rows,
    })
}

/// How far the inner lips are apart in a shape, in its pixels: between the middles of their upper and their lower edge. `inner` are the landmarks of the inner lips in
/// their order around the mouth, first the corner on the left of the picture, then the upper edge; the other corner is the one farthest to the right.
pub fn lip_gap(shape: ArrayView1<f32>, inner: &[usize]) -> f32 {
    let at = |k: usize| [shape[2 * k], shape[2 * k + 1]];
    let Some(right) = (0..inner.len()).max_by(|a, b| at(inner[*a])[0].total_cmp(&at(inner[*b])[0])) else {
        return 0.0;
    };
    // The middle of an edge is where it crosses half the way between the corners.
    let middle = 0.5 * (at(inner[0])[0] + at(inner[right])[0]);
    let crossing = |edge: &[usize]| -> f32 {
        let ends = edge.windows(2).find(|pair| {
            let (a, b) = (at(pair[0])[0], at(pair[1])[0]);
            a.min(b) <= middle && middle <= a.max(b)
        });
        let Some([a, b]) = ends else {
            return at(inner[0])[1];
        };
        let ([ax, ay], [bx, by]) = (at(*a), at(*b));
        let share = if bx == ax { 0.5 } else { (middle - ax) / (bx - ax) };
        ay + share * (by - ay)
    };
    let lower: Vec<usize> = inner[right..].iter().chain(&inner[..1]).copied().collect();
    crossing(&lower) - crossing(&inner[..=right])
}

/// [`lip_gap`] of every row of shapes.
pub fn lip_gaps(shapes: &Array2<f32>, inner: &[usize]) -> Array1<f32> {
    shapes
        .outer_iter()
        .map(|shape| lip_gap(shape.slice(s![..]), inner))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::kinds::hierarchical::Tree;
    use ndarray::array;

    #[test]
    fn a_picture_is_seen_through_its_landmarks_in_grey_and_colour() {
        // A picture whose red grows to the right; a square that the second picture shows two pixels further on.
        let (width, height) = (24, 20);
        let rgb: Vec<u8> = (0..2 * width * height)
            .flat_map(|p| [4 * (p % width) as u8 + 50, 80, 40])
            .collect();
        let frames = Frames {
            width,
            height,
            rate_hz: 25.0,
            rgb,
        };
        let square = array![4.0, 3.0, 14.0, 3.0, 14.0, 13.0, 4.0, 13.0, 9.0, 8.0];
        let mut landmarks = Array2::zeros((2, 10));
        landmarks.row_mut(0).assign(&square);
        let moved: Array1<f32> = square
            .iter()
            .enumerate()
            .map(|(k, v)| v + 2.0 * ((k + 1) % 2) as f32)
            .collect();
        landmarks.row_mut(1).assign(&moved);
        let tree = Tree::face_and_mouth([0, 1, 4]).over(5).unwrap();
        let found = super::super::appearance::geometries(&landmarks, &tree).unwrap();
        let geometries: Vec<Geometry> = found.into_iter().map(|(geometry, _)| geometry).collect();
        let clip = Picked {
            files: discover_nothing(),
            pictures: vec![0, 1],
            heard: Array2::zeros((2, 12)),
            mouths: Array2::zeros((2, 1)),
            landmarks,
        };
        let half = geometries[0].half().unwrap();
        let said = of_frames(&clip, &frames, &geometries, &half, |n| n == 1).unwrap();
        // Two pixels further to the right red is 8 levels more, and luminance 0.299 of that; I 0.5959 of that at the same place.
        let off = &said.textures[0].row(1) - &said.textures[0].row(0);
        assert!(off.iter().all(|d| (d - 0.299 * 8.0).abs() < 1e-2), "{off}");
        assert_eq!(said.textures[1].dim(), (2, geometries[1].patch.len()));
        assert_eq!(said.chroma.dim(), (1, 2 * half.len()));
        // Half-size place (x, y) lies at 2·(x, y) on the mean's grid, whose (1, 1) is the square's corner at (6, 3).
        let (x, _) = half.places().next().unwrap();
        let red = 4.0 * (2.0 * x as f32 - 1.0 + 6.0) + 50.0;
        let wanted = 0.5959 * red - 0.2746 * 80.0 - 0.3213 * 40.0;
        assert!(
            (said.chroma[(0, 0)] - wanted).abs() < 0.1,
            "{} {wanted}",
            said.chroma[(0, 0)]
        );
        let late = Picked {
            pictures: vec![0, 2],
            ..clip
        };
        let refused = of_frames(&late, &frames, &geometries, &half, |_| false)
            .err()
            .unwrap()
            .to_string();
        assert!(refused.contains("has 2 pictures"), "{refused}");
    }

    fn discover_nothing() -> ClipFiles {
        ClipFiles {
            id: "a".into(),
            speaker: "s".into(),
            split: Split::Train,
            video: None,
            part: None,
            sound: None,
            labels: Vec::new(),
            stem: "a".into(),
        }
    }

    #[test]
    fn the_gap_is_between_the_middles_of_both_edges() {
        // A corner on the left, two points above, a corner on the right, two below; turned a little it stays about the same.
        let shape = array![0.0, 5.0, 3.0, 2.0, 7.0, 2.0, 10.0, 5.0, 7.0, 9.0, 3.0, 9.0];
        let inner: Vec<usize> = (0..6).collect();
        assert!((lip_gap(shape.view(), &inner) - 7.0).abs() < 1e-5);
        let closed = array![0.0, 5.0, 3.0, 5.0, 7.0, 5.0, 10.0, 5.0, 7.0, 5.0, 3.0, 5.0];
        assert!(lip_gap(closed.view(), &inner).abs() < 1e-5);
        assert_eq!(lip_gap(shape.view(), &[]), 0.0);
        let rows = ndarray::stack![Axis(0), shape, closed];
        assert!(
            (lip_gaps(&rows, &inner) - array![7.0, 0.0])
                .iter()
                .all(|d| d.abs() < 1e-5)
        );
    }
}
