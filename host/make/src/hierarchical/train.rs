//! A feature folder, its videos and landmarks to a hierarchical model.
use std::path::PathBuf;

use lipstream::kinds::hierarchical::guide::Teacher;
use lipstream::kinds::hierarchical::{Appearance, Colours, Hearing, HierarchicalModel, Node, Pieces, Tree};
use lipstream::mouth::MouthSpace;
use lipstream::progress::Progress;
use lipstream::tensors::Tensors;
use ndarray::{Array1, Array2, Axis, concatenate, s};

use super::appearance::{self, Components, Geometry};
use super::guide::{self, Lesson, Tried};
use super::landmarks::Landmarks;
use super::maps::{self, Pairs, Search, Trial};
use super::pictures::{self, Looks, Picked, Which};
use super::principal::{Keep, components};
use crate::error::{Error, Result, ensure};
use crate::features::{FeatureFolder, Split};
use crate::train::local_linear::MapSums;

/// Ridge penalty of the map from appearances to eigenmouths: enough to keep it solvable.
const READING_PENALTY: f64 = 1.0;

/// What may be chosen.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the videos are; None: where the folder was prepared from.
    pub videos: Option<PathBuf>,
    /// Areas; None: the paper's face and mouth.
    pub tree: Option<Tree>,
    /// Hops at which the device's front end is heard; None: the paper's windows.
    pub taps: Option<Vec<i8>>,
    /// What may choose clusters when the model runs.
    pub teacher: Option<Teacher>,
    /// Training pictures, about.
    pub pictures: usize,
    /// Training pictures whose colours are kept, about.
    pub colours: usize,
    /// Components of the appearance models.
    pub components: Components,
    /// Components of speech.
    pub speech: Keep,
    /// What is tried of the clusters.
    pub search: Search,
}

impl Default for Settings {
    /// The paper has about 700 pictures of one day's recording; of more the figures in `docs/hierarchical.md` get better.
    fn default() -> Self {
        Self {
            videos: None,
            tree: None,
            taps: None,
            teacher: None,
            pictures: 3000,
            colours: 300,
            components: Components::default(),
            speech: Keep {
                share: 0.99,
                most: 12,
            },
            search: Search::default(),
        }
    }
}

/// A model, and what came of everything that was tried.
pub struct Trained {
    /// The model.
    pub model: HierarchicalModel,
    /// Trials of each area, by its name.
    pub trials: Vec<(String, Vec<Trial>)>,
    /// What was tried of each area's guidance; nothing without a teacher.
    pub guided: Vec<(String, Vec<Tried>)>,
}

/// Validation clips at most: all of their pictures are looked at.
const JUDGED_CLIPS: usize = 40;

/// Trains a model.
///
/// # Errors
///
/// What the folder, the videos or the landmarks lack.
pub fn train(
    folder: &FeatureFolder,
    landmarks: &Landmarks,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Trained> {
    let corpus = PathBuf::from(&folder.manifest.corpus);
    let videos = settings.videos.as_deref().unwrap_or(&corpus);
    let tree = match &settings.tree {
        Some(tree) => tree.clone(),
        None => landmarks.tree()?,
    };
    let tree = tree.over(landmarks.count()).map_err(Error::other)?;
    let tensors = Tensors::read(&folder.mouth_path()).map_err(Error::other)?;
    let mouth = MouthSpace::load(&tensors).map_err(Error::other)?;
    // Without validation clips what is chosen is judged on training clips, as elsewhere in training.
    let judged = match folder.split(Split::Val).any(|clip| clip.video_frames > 0) {
        true => Split::Val,
        false => Split::Train,
    };
    let hearing = match &settings.taps {
        None => Hearing::Window,
        Some(taps) => Hearing::frames(Array1::from(folder.manifest.start_mean.clone()), taps.clone())
            .map_err(Error::other)?,
    };
    let pick = |split, which| pictures::pick(folder, split, landmarks, videos, which, &hearing);
    let train = pick(Split::Train, Which::Spread(settings.pictures))?;
    let validation = pick(judged, Which::Clips(JUDGED_CLIPS))?;

    let all = pictures::stacked(&train, |clip| &clip.landmarks)?;
    let (geometries, shapes): (Vec<Geometry>, Vec<_>) =
        appearance::geometries(&all, &tree)?.into_iter().unzip();
    let Looks {
        mut textures,
        coloured,
        chroma,
    } = pictures::look(&train, &geometries, settings.colours, progress)?;
    progress.say(&format!(
        "{} training pictures of {} clips, {} to choose by; the mean face has {}×{} pixels",
        all.nrows(),
        train.len(),
        validation.iter().map(|clip| clip.pictures.len()).sum::<usize>(),
        geometries[0].patch.width,
        geometries[0].patch.height
    ));
    let levels = appearance::normalise(&mut textures, &tree);
    let sounds = pictures::stacked(&train, |clip| &clip.heard)?;
    let speech = components(&sounds, settings.speech)?;
    ensure!(
        speech.modes() > 0,
        Data,
        "all training pictures sound alike: there is nothing to learn from"
    );
    let heard = |sounds: &Array2<f32>| (sounds - &speech.mean).dot(&speech.components.t());
    let mut judge = Judge::of(&validation, &tree, &geometries, &levels, progress)?;

    let (mut nodes, mut trials, mut all_pairs) = (Vec::new(), Vec::new(), Vec::new());
    for (index, area) in tree.areas.iter().enumerate() {
        let (appearance, c) = appearance::fit(
            &area.name,
            &geometries[index],
            &shapes[index],
            &textures[index],
            levels[index],
            &settings.components,
        )?;
        // Its pixels take the most memory of all, and are not looked at again.
        textures[index] = Array2::zeros((0, 0));
        let pairs = Pairs {
            appearance: c,
            speech: heard(&sounds),
            clips: pictures::ranges(&train),
        };
        let ranges = pictures::ranges(&validation);
        let validation = Pairs {
            appearance: judge.appearances(index, &geometries[index], &appearance),
            speech: heard(&judge.sounds),
            clips: ranges,
        };
        let (map, tried) = maps::fit(&pairs, &validation, &settings.search)?;
        progress.say(&format!(
            "{}: {} components of shape, {} of texture, {} of both; {} clusters with {} components at most, error {:.3} of the variance",
            area.name,
            appearance.shape.modes(),
            appearance.texture.modes(),
            appearance.size(),
            map.clusters.len(),
            map.modes(),
            maps::error(&map, &validation)
        ));
        nodes.push(Node { appearance, map });
        trials.push((area.name.clone(), tried));
        all_pairs.push((pairs, validation));
    }
    let names = tree.areas.iter().map(|area| area.name.clone());
    let (guide, guided) = match &settings.teacher {
        None => (None, Vec::new()),
        Some(teacher) => {
            let lesson = Lesson {
                folder,
                train: &train,
                validation: &validation,
                pairs: &all_pairs,
            };
            let (guide, tried) = guide::fit(teacher.clone(), &nodes, &lesson)?;
            (Some(guide), names.zip(tried).collect())
        }
    };
    let appearances: Vec<Array2<f32>> = all_pairs.into_iter().map(|(train, _)| train.appearance).collect();
    let reading = reading(
        &tree,
        &appearances,
        &pictures::stacked(&train, |clip| &clip.mouths)?,
        &pictures::ranges(&train),
    )?;
    let colours = Colours {
        appearances: appearances[0].select(Axis(0), &coloured),
        chroma,
    };
    let model = HierarchicalModel::new(Pieces {
        provenance: provenance(folder, train.len(), all.nrows()),
        tree,
        nodes,
        hearing,
        speech,
        guide,
        colours,
        reading,
        mouth,
    });
    Ok(Trained {
        model: model.map_err(Error::other)?,
        trials,
        guided,
    })
}

fn provenance(folder: &FeatureFolder, clips: usize, pictures: usize) -> String {
    format!(
        "hierarchical: clusters of appearance and speech, chosen picture by picture; {pictures} pictures of {clips} clips of {}",
        folder.name()
    )
}

/// The map from appearances of all areas to eigenmouth weights, rows of \[bias; c\], `[1 + C, D]`, by least squares.
///
/// Only areas without parts are read: a part covers what its parent says of its place. Weights carry no mean of their clip; so the map is fitted to what moves within clips,
/// and the mean appearance of all has the mean weights.
fn reading(
    tree: &Tree,
    appearances: &[Array2<f32>],
    mouths: &Array2<f32>,
    clips: &[std::ops::Range<usize>],
) -> Result<Array2<f32>> {
    let is_leaf = |index: usize| {
        let name = &tree.areas[index].name;
        tree.areas.iter().all(|area| area.parent.as_ref() != Some(name))
    };
    let (mut columns, mut begin) = (Vec::new(), 0);
    for (index, c) in appearances.iter().enumerate() {
        if is_leaf(index) {
            columns.extend(begin..begin + c.ncols());
        }
        begin += c.ncols();
    }
    let views: Vec<_> = appearances.iter().map(|c| c.view()).collect();
    let read = concatenate(Axis(1), &views)?.select(Axis(1), &columns);
    let within = |rows: &Array2<f32>| {
        let mut rows = rows.clone();
        for clip in clips {
            let mut of_clip = rows.slice_mut(s![clip.clone(), ..]);
            if let Some(mean) = of_clip.mean_axis(Axis(0)) {
                of_clip -= &mean;
            }
        }
        rows
    };
    let outputs = mouths.ncols();
    let mut sums = MapSums::new(columns.len(), outputs, 0);
    sums.add(
        &within(&read),
        &within(mouths),
        &Array2::zeros((mouths.nrows(), 0)),
    );
    // Rows of outputs, the bias behind the inputs; here it is nothing.
    let solved = sums.solve(READING_PENALTY, 1.0)?.global;
    let slopes = solved.slice(s![.., ..columns.len()]).t().to_owned();
    let mean = |rows: &Array2<f32>| {
        rows.mean_axis(Axis(0))
            .unwrap_or_else(|| Array1::zeros(rows.ncols()))
    };
    let mut out = Array2::zeros((1 + begin, outputs));
    out.row_mut(0).assign(&(mean(mouths) - mean(&read).dot(&slopes)));
    for (slope, column) in slopes.outer_iter().zip(&columns) {
        out.row_mut(1 + column).assign(&slope);
    }
    Ok(out)
}

/// What pictures that take no part in the fit look and sound like.
struct Judge {
    landmarks: Array2<f32>,
    sounds: Array2<f32>,
    /// Textures of each area at the training pictures' levels.
    textures: Vec<Array2<f32>>,
}

impl Judge {
    fn of(
        picked: &[Picked],
        tree: &Tree,
        geometries: &[Geometry],
        levels: &[(f32, f32)],
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut textures = pictures::look(picked, geometries, 0, progress)?.textures;
        appearance::normalise_as(&mut textures, tree, levels);
        Ok(Self {
            landmarks: pictures::stacked(picked, |clip| &clip.landmarks)?,
            sounds: pictures::stacked(picked, |clip| &clip.heard)?,
            textures,
        })
    }

    /// Their true appearances in an area, whose textures are then given back.
    fn appearances(&mut self, area: usize, geometry: &Geometry, appearance: &Appearance) -> Array2<f32> {
        let shapes = geometry.shapes(&self.landmarks);
        let textures = std::mem::replace(&mut self.textures[area], Array2::zeros((0, 0)));
        appearance::project(appearance, &shapes, &textures)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenmouths_are_read_from_the_mouth_whatever_the_face_does() {
        let tree = Tree::face_and_mouth([0, 1, 2]).over(4).unwrap();
        let face = Array2::from_shape_fn((60, 2), |(t, k)| 30.0 * ((t * (k + 3)) as f32).cos());
        let moves = Array2::from_shape_fn((60, 3), |(t, k)| 40.0 * ((t * (k + 2)) as f32).sin());
        let map = ndarray::array![[2.0f32, 0.0], [0.5, -1.0], [0.0, 3.0]];
        let mouths = moves.dot(&map);
        // The second clip was recorded in another pose, of which the weights know nothing.
        let mut mouth = moves.clone();
        mouth.slice_mut(s![30.., ..]).mapv_inplace(|v| v + 25.0);
        let clips = [0..30, 30..60];
        let found = reading(&tree, &[face, mouth.clone()], &mouths, &clips).unwrap();
        assert!(found.slice(s![1..3, ..]).iter().all(|v| *v == 0.0));
        assert!((&found.slice(s![3.., ..]) - &map).iter().all(|d| d.abs() < 1e-2));
        // The mean appearance has the mean weights.
        let at_mean = mouth.mean_axis(Axis(0)).unwrap().dot(&found.slice(s![3.., ..])) + found.row(0);
        let wanted = mouths.mean_axis(Axis(0)).unwrap();
        assert!((at_mean - wanted).iter().all(|d| d.abs() < 1e-2));
    }
}
