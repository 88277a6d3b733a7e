//! A feature folder, its videos and landmarks to a hierarchical model.
use std::path::PathBuf;

use lipstream::kinds::hierarchical::{Appearance, Colours, HierarchicalModel, Node, Pieces, Tree};
use lipstream::mouth::MouthSpace;
use lipstream::progress::Progress;
use lipstream::tensors::Tensors;
use ndarray::{Array2, Axis, concatenate, s};

use super::appearance::{self, Components, Geometry};
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
    let pick = |split, which| pictures::pick(folder, split, landmarks, videos, which);
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
    let cepstra = pictures::stacked(&train, |clip| &clip.cepstra)?;
    let speech = components(&cepstra, settings.speech)?;
    ensure!(
        speech.modes() > 0,
        Data,
        "all training pictures sound alike: there is nothing to learn from"
    );
    let heard = |cepstra: &Array2<f32>| (cepstra - &speech.mean).dot(&speech.components.t());
    let mut judge = Judge::of(&validation, &tree, &geometries, &levels, progress)?;

    let (mut nodes, mut trials, mut appearances) = (Vec::new(), Vec::new(), Vec::new());
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
            speech: heard(&cepstra),
            clips: pictures::ranges(&train),
        };
        let validation = Pairs {
            appearance: judge.appearances(index, &geometries[index], &appearance),
            speech: heard(&judge.cepstra),
            clips: pictures::ranges(&validation),
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
        appearances.push(pairs.appearance);
    }
    let views: Vec<_> = appearances.iter().map(|c| c.view()).collect();
    let reading = reading(
        &concatenate(Axis(1), &views)?,
        &pictures::stacked(&train, |clip| &clip.mouths)?,
    )?;
    let colours = Colours {
        appearances: appearances[0].select(Axis(0), &coloured),
        chroma,
    };
    let model = HierarchicalModel::new(Pieces {
        provenance: provenance(folder, train.len(), all.nrows()),
        tree,
        nodes,
        speech,
        colours,
        reading,
        mouth,
    });
    Ok(Trained {
        model: model.map_err(Error::other)?,
        trials,
    })
}

fn provenance(folder: &FeatureFolder, clips: usize, pictures: usize) -> String {
    format!(
        "hierarchical: clusters of appearance and speech, chosen picture by picture; {pictures} pictures of {clips} clips of {}",
        folder.name()
    )
}

/// The map from appearances of all areas to eigenmouth weights, rows of \[bias; c\], `[1 + C, D]`, by least squares.
fn reading(appearances: &Array2<f32>, mouths: &Array2<f32>) -> Result<Array2<f32>> {
    let (inputs, outputs) = (appearances.ncols(), mouths.ncols());
    let mut sums = MapSums::new(inputs, outputs, 0);
    sums.add(appearances, mouths, &Array2::zeros((mouths.nrows(), 0)));
    // Rows of outputs, the bias behind the inputs.
    let solved = sums.solve(READING_PENALTY, 1.0)?.global;
    let mut out = Array2::zeros((1 + inputs, outputs));
    out.row_mut(0).assign(&solved.column(inputs));
    out.slice_mut(s![1.., ..])
        .assign(&solved.slice(s![.., ..inputs]).t());
    Ok(out)
}

/// What pictures that take no part in the fit look and sound like.
struct Judge {
    landmarks: Array2<f32>,
    cepstra: Array2<f32>,
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
            cepstra: pictures::stacked(picked, |clip| &clip.cepstra)?,
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
    fn eigenmouths_are_read_from_appearances() {
        let appearances = Array2::from_shape_fn((60, 3), |(t, k)| 40.0 * ((t * (k + 2)) as f32).sin());
        let map = ndarray::array![[2.0f32, 0.0], [0.5, -1.0], [0.0, 3.0]];
        let mouths = appearances.dot(&map) + &ndarray::array![7.0, -2.0];
        let found = reading(&appearances, &mouths).unwrap();
        assert!((&found.slice(s![1.., ..]) - &map).iter().all(|d| d.abs() < 1e-2));
        // The penalty of 1 against 60 pictures.
        assert!(
            (&found.row(0) - &ndarray::array![7.0, -2.0])
                .iter()
                .all(|d| d.abs() < 0.2)
        );
    }
}
