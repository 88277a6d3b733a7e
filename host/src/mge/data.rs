//! Clips as minimum generation error training sees them: statics, mouth, forced alignment.
use anyhow::{Result, bail};
use lipstream_core::N_STATIC;
use ndarray::{Array2, s};
use rayon::prelude::*;

use super::disturb::{Disturbance, Variant};
use super::settings::Settings;
use crate::audio::{self, noise};
use crate::features::{FeatureFolder, Split};
use crate::hmm::em::{self, Parameters as HmmParameters, Utterance};
use crate::hmm::topology::Topology;
use crate::model::Model;
use crate::phones::Phone;
use crate::train::{Say, data};

/// One clip.
#[derive(Clone, Debug)]
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
#[derive(Clone, Debug)]
pub struct Data {
    pub train: Vec<Clip>,
    /// Clips without video.
    pub heard: Vec<Clip>,
    pub validation: Vec<Clip>,
    /// One over the deviation of each static.
    pub scale: Vec<f32>,
    /// Deviation of each mouth parameter over the training clips.
    pub deviation: Vec<f32>,
}

/// Reads folders and aligns them with the likelihood-trained model `twin`.
///
/// At most `settings.clips` training clips with video are taken; the last `settings.hold_out` of all training clips
/// join the validation clips. Every training clip is heard `settings.variants` times more, disturbed.
pub fn read(
    folder: &FeatureFolder,
    audio_only: &[FeatureFolder],
    twin: &Model,
    settings: &Settings,
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
    let index = |phone: Phone| twin.phones.iter().position(|p| *p == phone);
    let load = |folder: &FeatureFolder, split: Split| -> Vec<Utterance> {
        let (utterances, refused) = data::load(folder, split, &index);
        refused.iter().for_each(|line| say(&format!("left out: {line}")));
        utterances
    };
    let mut train: Vec<Utterance> = load(folder, Split::Train)
        .into_iter()
        .filter(|u| u.visual.is_some())
        .collect();
    let mut validation = load(folder, Split::Val);
    let held = train.len().saturating_sub(settings.hold_out);
    validation.extend(train.drain(held..));
    if let Some(clips) = settings.clips {
        train.truncate(clips);
    }
    let of_each: Vec<Vec<Utterance>> = audio_only
        .iter()
        .map(|f| load(f, Split::Train))
        .map(|of| of.into_iter().map(|u| Utterance { visual: None, ..u }).collect())
        .collect();
    if train.is_empty() {
        bail!("{} has no training clip that can be used", folder.root.display());
    }
    let scale = inverse_deviation(&train);
    let deviation = mouth_deviation(&train);
    let hmm = HmmParameters {
        topology: Topology::PH_VI_CHMM,
        phones: twin.phones.clone(),
        audio: twin.audio.clone(),
        visual: Some(twin.visual.clone()),
        transition: twin.transition.clone(),
    };
    let clips = |utterances: Vec<Utterance>| -> Vec<Clip> {
        let aligned = em::align(&hmm, &utterances);
        utterances
            .into_iter()
            .zip(aligned)
            .filter_map(|(u, states)| {
                let Some(states) = states else {
                    say(&format!("left out: clip {}: no path through its words", u.id));
                    return None;
                };
                let mut x = u.audio.slice(s![.., ..N_STATIC]).to_owned();
                x.outer_iter_mut()
                    .for_each(|mut row| row.iter_mut().zip(&scale).for_each(|(x, s)| *x *= s));
                let mouth = u.visual.map(|mut v| {
                    v.outer_iter_mut()
                        .for_each(|mut row| row.iter_mut().zip(&deviation).for_each(|(v, d)| *v /= d));
                    v
                });
                Some(Clip {
                    id: u.id,
                    x,
                    mouth,
                    states,
                    variants: Vec::new(),
                })
            })
            .collect()
    };
    let mut train = clips(train);
    let mut heard: Vec<Vec<Clip>> = of_each.into_iter().map(clips).collect();
    if settings.variants > 0 {
        let babble = match audio_only {
            [] => voices(folder)?,
            others => {
                let all: Vec<_> = others.iter().map(voices).collect::<Result<_>>()?;
                all.concat()
            }
        };
        disturb(folder, &mut train, &babble, &scale, settings)?;
        for (folder, clips) in audio_only.iter().zip(&mut heard) {
            disturb(folder, clips, &babble, &scale, settings)?;
        }
    }
    Ok(Data {
        train,
        heard: heard.concat(),
        validation: clips(validation),
        scale: scale.clone(),
        deviation: deviation.clone(),
    })
}

/// Sounds of a folder's training clips, at most [`VOICES`] spread over them.
fn voices(folder: &FeatureFolder) -> Result<Vec<Vec<i16>>> {
    let clips: Vec<_> = folder.split(Split::Train).collect();
    let every = clips.len().div_ceil(VOICES).max(1);
    let chosen = clips.into_iter().step_by(every);
    chosen
        .map(|clip| Ok(audio::read(&folder.wav_path(&clip.id))?.samples))
        .collect()
}

/// Hears every clip some times more, disturbed; what happens to it depends on the seed and its name only.
fn disturb(
    folder: &FeatureFolder,
    clips: &mut [Clip],
    babble: &[Vec<i16>],
    scale: &[f32],
    settings: &Settings,
) -> Result<()> {
    let babble: Vec<&[i16]> = babble.iter().map(Vec::as_slice).collect();
    let start_mean: [f32; N_STATIC] = std::array::from_fn(|d| folder.manifest.start_mean[d]);
    clips.par_iter_mut().try_for_each(|clip| {
        let samples = audio::read(&folder.wav_path(&clip.id))?.samples;
        let mut rng = noise::generator(settings.seed, &clip.id, "disturbed");
        clip.variants = (0..settings.variants)
            .map(|_| {
                let disturbance = Disturbance::draw(clip.x.nrows(), &mut rng);
                disturbance.hear(&samples, &babble, &start_mean, scale, &mut rng)
            })
            .collect();
        Ok(())
    })
}

/// Clips of a folder that babble, at most.
const VOICES: usize = 60;

fn inverse_deviation(utterances: &[Utterance]) -> Vec<f32> {
    let columns = (0..N_STATIC).map(|d| utterances.iter().flat_map(move |u| u.audio.column(d).to_vec()));
    columns.map(|c| 1.0 / deviation(c)).collect()
}

fn mouth_deviation(utterances: &[Utterance]) -> Vec<f32> {
    let size = utterances
        .first()
        .and_then(|u| u.visual.as_ref())
        .map_or(0, |v| v.ncols());
    (0..size)
        .map(|d| {
            let values = utterances
                .iter()
                .filter_map(|u| u.visual.as_ref())
                .flat_map(|v| v.column(d).to_vec());
            deviation(values)
        })
        .collect()
}

/// Standard deviation, never 0.
fn deviation(values: impl Iterator<Item = f32>) -> f32 {
    let (mut n, mut sum, mut square) = (0.0f64, 0.0f64, 0.0f64);
    for v in values {
        n += 1.0;
        sum += f64::from(v);
        square += f64::from(v).powi(2);
    }
    let mean = sum / n.max(1.0);
    (square / n.max(1.0) - mean * mean).max(1e-6).sqrt() as f32
}
