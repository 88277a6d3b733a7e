//! Typical mouths of a feature folder and their fine detail: the candidates of performance refinement (X&L section 6.1).
use lipstream::mouth::MouthSpace;
use lipstream::progress::{Progress, Steps};
use lipstream::render::refine::{CANDIDATES, Candidates, typical};
use ndarray::{Array1, Array2, Axis, concatenate};

use crate::error::{Context as _, Error, Result, bail};
use crate::features::{self, Clip, FeatureFolder, Split};

/// The paper's 500 candidates from the training clips of a folder (from all, where none of them has video), as the eigenmouths of `space` see them.
///
/// # Errors
///
/// [`Error::Data`]: the folder has no mouth images, or they are of another size than the eigenmouths; [`Error::Choice`]: its eigenmouths are others
/// ([`FeatureFolder::has_mouth`]); and files that cannot be read.
pub fn candidates(folder: &FeatureFolder, space: &MouthSpace, progress: &dyn Progress) -> Result<Candidates> {
    folder.has_mouth(space)?;
    let clips = clips(folder)?;
    let steps = Steps::begin(progress, "mouths", 2 * clips.len());
    let mut all = Vec::with_capacity(clips.len());
    for clip in &clips {
        all.push(Seen::read(folder, clip, space)?.weights);
        steps.made();
    }
    let views: Vec<_> = all.iter().map(|rows| rows.view()).collect();
    let weights = concatenate(Axis(0), &views)?;
    let chosen = typical(weights.view(), CANDIDATES);
    let mut details = Array2::zeros((chosen.len(), space.mean.len()));
    let (mut begins, mut row) = (0, 0);
    for (clip, of_clip) in clips.iter().zip(&all) {
        let ends = begins + of_clip.nrows();
        let inside: Vec<usize> = chosen
            .iter()
            .copied()
            .filter(|n| (begins..ends).contains(n))
            .collect();
        if !inside.is_empty() {
            let seen = Seen::read(folder, clip, space)?;
            for n in inside {
                details.row_mut(row).assign(&seen.detail(n - begins, space));
                row += 1;
            }
        }
        begins = ends;
        steps.made();
    }
    Candidates::new(weights.select(Axis(0), &chosen), details.view()).map_err(Error::other)
}

fn clips(folder: &FeatureFolder) -> Result<Vec<&Clip>> {
    let with_video = |clip: &&Clip| clip.video_frames > 0;
    let mut clips: Vec<&Clip> = folder.split(Split::Train).filter(with_video).collect();
    if clips.is_empty() {
        clips = folder.manifest.clips.iter().filter(with_video).collect();
    }
    if clips.is_empty() {
        bail!(Data, "{} has no mouth images", folder.root.display());
    }
    Ok(clips)
}

/// The mouths of a clip, as eigenmouths see them.
pub struct Seen {
    /// Mean mouth of the clip, `[P]`.
    pub mean: Array1<f32>,
    /// Every picture's difference from it, `[n, P]`.
    pub differences: Array2<f32>,
    /// Weights of these differences, `[n, D]`.
    pub weights: Array2<f32>,
}

impl Seen {
    /// Reads the mouths of a clip.
    ///
    /// # Errors
    ///
    /// [`Error::Data`]: they are of another size than the eigenmouths; and files that cannot be read.
    pub fn read(folder: &FeatureFolder, clip: &Clip, space: &MouthSpace) -> Result<Self> {
        let path = folder.mouths_path(&clip.id);
        let images = features::read_mouths(&path)?;
        let (count, height, width, _) = images.dim();
        if (width, height) != (space.width, space.height) {
            bail!(
                Data,
                "{} has mouths of {width}×{height} pixels, the model's are {}×{}: it was not trained on this folder",
                folder.root.display(),
                space.width,
                space.height
            );
        }
        let mut differences = images
            .mapv(f32::from)
            .into_shape_with_order((count, width * height * 3))
            .with_context(|| format!("{} cannot be read", path.display()))?;
        let mean = differences
            .mean_axis(Axis(0))
            .unwrap_or_else(|| Array1::zeros(space.mean.len()));
        differences -= &mean;
        let weights = differences.dot(&space.basis.t());
        Ok(Self {
            mean,
            differences,
            weights,
        })
    }

    /// What the eigenmouths leave of picture `n`, `[P]`, levels.
    pub fn detail(&self, n: usize, space: &MouthSpace) -> Array1<f32> {
        &self.differences.row(n) - &space.basis.t().dot(&self.weights.row(n))
    }
}
