//! Clips as minimum generation error training sees them: statics, mouth, forced alignment.
use std::path::Path;

use anyhow::{Result, bail};
use lipstream_core::N_STATIC;
use ndarray::{Array2, ArrayView1, ArrayView2, s};

use super::disturb::{Disturbance, Variant};
use super::settings::Settings;
use super::store::Store;
use crate::em::source::{Source, Utterance, in_order};
use crate::em::{Aligner, Parameters as HmmParameters};
use crate::features::{FeatureFolder, Split};
use crate::noise;
use crate::train::Say;
use crate::train::data::{Clips, Observed};
use lipstream::hmm::topology::Topology;
use lipstream::kinds::likelihood::Model;
use lipstream_media::sound;

/// One clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    pub id: String,
    /// Normalised statics times their scale `[T, 13]`.
    pub x: Array2<f32>,
    /// The mouth, standardised `[T, D]`.
    pub mouth: Option<Array2<f32>>,
    /// Audio and visual state of every frame by forced alignment.
    pub states: Vec<(usize, usize)>,
    /// The clip disturbed.
    pub variants: Vec<Variant>,
}

/// Everything that training reads.
pub struct Data {
    pub train: Store,
    /// Clips without video.
    pub heard: Store,
    pub validation: Store,
    /// One over the deviation of each static.
    pub scale: Vec<f32>,
    /// Deviation of each mouth parameter over the training clips.
    pub deviation: Vec<f32>,
}

/// Reads folders and aligns them with the likelihood-trained model `twin`. The clips are then in a file in `aside`, or in
/// memory.
///
/// At most `settings.clips` training clips with video are taken; the last `settings.hold_out` of all training clips
/// join the validation clips. Every training clip is heard `settings.variants` times more, disturbed.
pub fn read(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    twin: &Model,
    settings: &Settings,
    aside: Option<&Path>,
    say: Say,
) -> Result<Data> {
    if folder.manifest.visual_size != twin.visual_size() {
        bail!(
            "{} holds {} mouth parameters, the model that training starts from speaks {}",
            folder.root.display(),
            folder.manifest.visual_size,
            twin.visual_size()
        );
    }
    let mut train = Clips::new(folder, Split::Train, &twin.phones, say).readable(true, say);
    let mut validation = Clips::new(folder, Split::Val, &twin.phones, say).readable(false, say);
    let held = train.len().saturating_sub(settings.hold_out);
    validation.extend(&train.split_off(held));
    if let Some(clips) = settings.clips {
        train.split_off(clips);
    }
    if train.is_empty() {
        bail!("{} has no training clip that can be used", folder.root.display());
    }
    let (mut sound, mut mouth) = (Deviations::default(), Deviations::default());
    in_order(
        train.len(),
        |n| train.get(n),
        |u| {
            sound.add(u.audio.slice(s![.., ..N_STATIC]));
            u.visual.iter().for_each(|v| mouth.add(v.view()));
            Ok(())
        },
    )?;
    let scale: Vec<f32> = sound.deviations().map(|d| 1.0 / d).collect();
    let deviation: Vec<f32> = mouth.deviations().collect();
    let hmm = HmmParameters {
        topology: Topology::PH_VI_CHMM,
        phones: twin.phones.clone(),
        audio: twin.audio.clone(),
        visual: Some(twin.visual.clone()),
        transition: twin.transition.clone(),
    };
    let reader = Reader {
        aligner: Aligner::new(&hmm),
        babble: match (settings.variants, audio_only) {
            (0, _) => Vec::new(),
            (_, []) => voices(folder)?,
            (_, others) => {
                let all: Vec<_> = others.iter().map(voices).collect::<Result<_>>()?;
                all.concat()
            }
        },
        scale: &scale,
        deviation: &deviation,
        seed: settings.seed,
        say,
    };
    let mut data = Data {
        train: Store::new(aside)?,
        heard: Store::new(aside)?,
        validation: Store::new(aside)?,
        scale: scale.clone(),
        deviation: deviation.clone(),
    };
    reader.read(folder, &train, settings.variants, &mut data.train)?;
    for other in audio_only {
        let clips = Clips::new(other, Split::Train, &twin.phones, say).observed(Observed::Sound);
        let clips = clips.readable(false, say);
        reader.read(other, &clips, settings.variants, &mut data.heard)?;
    }
    reader.read(folder, &validation, 0, &mut data.validation)?;
    Ok(data)
}

/// Makes clips of utterances.
struct Reader<'a> {
    aligner: Aligner<'a>,
    /// Sounds that babble.
    babble: Vec<Vec<i16>>,
    scale: &'a [f32],
    deviation: &'a [f32],
    seed: u64,
    say: Say<'a>,
}

impl Reader<'_> {
    /// Reads, aligns and stores clips of `folder`, each heard `variants` times more.
    fn read(&self, folder: &FeatureFolder, clips: &Clips, variants: usize, store: &mut Store) -> Result<()> {
        let Self {
            aligner,
            babble,
            scale,
            deviation,
            seed,
            ..
        } = self;
        let work = |n: usize| {
            let u = clips.get(n)?.into_owned();
            let Some(states) = aligner.path(&u) else {
                return Ok(Err(u.id));
            };
            let variants = disturbed(folder, &u, babble, scale, variants, *seed)?;
            let x = u.audio.slice(s![.., ..N_STATIC]).to_owned() * ArrayView1::from(*scale);
            let mouth = u.visual.map(|v| v / ArrayView1::from(*deviation));
            Ok(Ok(Clip {
                id: u.id,
                x,
                mouth,
                states,
                variants,
            }))
        };
        in_order(clips.len(), work, |clip| match clip {
            Ok(clip) => store.push(&clip),
            Err(id) => {
                (self.say)(&format!("left out: clip {id}: no path through its words"));
                Ok(())
            }
        })
    }
}

/// Sounds of a folder's training clips, at most [`VOICES`] spread over them.
fn voices(folder: &FeatureFolder) -> Result<Vec<Vec<i16>>> {
    let clips: Vec<_> = folder.split(Split::Train).collect();
    let every = clips.len().div_ceil(VOICES).max(1);
    let chosen = clips.into_iter().step_by(every);
    chosen
        .map(|clip| Ok(sound::read(&folder.wav_path(&clip.id))?.samples))
        .collect()
}

/// The clip heard some times more, disturbed; what happens to it depends on the seed and its name only.
fn disturbed(
    folder: &FeatureFolder,
    clip: &Utterance,
    babble: &[Vec<i16>],
    scale: &[f32],
    variants: usize,
    seed: u64,
) -> Result<Vec<Variant>> {
    if variants == 0 {
        return Ok(Vec::new());
    }
    let babble: Vec<&[i16]> = babble.iter().map(Vec::as_slice).collect();
    let start_mean: [f32; N_STATIC] = std::array::from_fn(|d| folder.manifest.start_mean[d]);
    let samples = sound::read(&folder.wav_path(&clip.id))?.samples;
    let mut rng = noise::generator(seed, &clip.id, "disturbed");
    let variants = (0..variants).map(|_| {
        let disturbance = Disturbance::draw(clip.audio.nrows(), &mut rng);
        disturbance.hear(&samples, &babble, &start_mean, scale, &mut rng)
    });
    Ok(variants.collect())
}

/// Clips of a folder that babble, at most.
const VOICES: usize = 60;

/// Sums for the standard deviation of each column.
#[derive(Default)]
struct Deviations {
    n: f64,
    /// Sum and sum of squares.
    columns: Vec<(f64, f64)>,
}

impl Deviations {
    fn add(&mut self, rows: ArrayView2<f32>) {
        self.n += rows.nrows() as f64;
        self.columns.resize(rows.ncols(), (0.0, 0.0));
        for row in rows.outer_iter() {
            for ((sum, square), v) in self.columns.iter_mut().zip(row) {
                *sum += f64::from(*v);
                *square += f64::from(*v).powi(2);
            }
        }
    }

    /// Never 0.
    fn deviations(&self) -> impl Iterator<Item = f32> {
        let n = self.n.max(1.0);
        self.columns.iter().map(move |(sum, square)| {
            let mean = sum / n;
            (square / n - mean * mean).max(1e-6).sqrt() as f32
        })
    }
}
