//! The audio HMM trained from sound and labels alone.
//!
//! Where clips are labelled in phones, EM keeps within a few frames of the labels, so that a state learns the part of a
//! sound that people put under its label, and the borders that the model finds are theirs. Mixtures grow by splitting.
use std::borrow::Cow;
use std::path::Path;
use std::time::Instant;

use lipstream_core::N_OBSERVATION;
use ndarray::Array2;
use rayon::prelude::*;

use super::{Aligner, AudioHmm, Bigram, Shifts, frame_time, observations, shifts};
use crate::em;
use crate::em::density;
use crate::em::source::{Source, Utterance, in_order};
use crate::error::{Error, Result, bail, chain};
use crate::features::{Clip, FeatureFolder, Split};
use crate::shelf::Shelf;
use crate::train::{bigram, data};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::topology::Topology;
use lipstream::phones::Phone;
use lipstream::progress::Progress;
use lipstream_media::sound;

/// Choices of a training run.
#[derive(Clone, Debug)]
pub struct AudioHmmSettings {
    /// Gaussians per state, a power of two.
    pub mixtures: usize,
    /// EM passes after the start and after every split.
    pub iterations: usize,
    /// Frames of 5 ms that a phone may reach beyond its label; `None`: labels are only where EM starts.
    pub tolerance: Option<usize>,
    /// Training speakers that are left out, for choosing the rest of the settings.
    pub without: Vec<String>,
}

impl Default for AudioHmmSettings {
    fn default() -> Self {
        Self {
            mixtures: 4,
            iterations: 4,
            tolerance: Some(2),
            without: Vec::new(),
        }
    }
}

/// Trains on the sound and the labels of a folder's training clips. What is heard of them is then in a file in `aside`, or in
/// memory.
pub fn train(
    folder: &FeatureFolder,
    settings: &AudioHmmSettings,
    aside: Option<&Path>,
    progress: &dyn Progress,
) -> Result<AudioHmm> {
    if !settings.mixtures.is_power_of_two() {
        bail!(
            Choice,
            "mixtures grow by splitting: {} components are not a power of two",
            settings.mixtures
        );
    }
    let clips: Vec<&Clip> = folder
        .split(Split::Train)
        .filter(|c| !settings.without.contains(&c.speaker))
        .collect();
    let phones = data::phones_said(clips.iter().copied());
    let utterances = Sounds::hear(folder, clips, &phones, aside, progress)?;
    if utterances.is_empty() {
        bail!(
            Data,
            "{} has no training clip that can be used",
            folder.root.display()
        );
    }
    let used = &utterances.clips;
    let labelled = used.iter().all(|c| !c.labelled_phones().is_empty());
    let tolerance = settings.tolerance.filter(|_| labelled);
    progress.say(&format!("{} phones, {} clips", phones.len(), utterances.len()));
    let (mut parameters, mut floors, _) = em::start(&utterances, Topology::PH_HMM, &phones)?;
    floors.variance *= FLOOR;
    floors.occupancy = LEAST_FRAMES;
    loop {
        let mut last: Option<em::Sums> = None;
        for _ in 0..settings.iterations.max(1) {
            let begun = Instant::now();
            let sums = em::expect_from(&parameters, &utterances, 0..utterances.len(), tolerance)?;
            if sums.frames == 0 {
                bail!(Data, "no utterance fits its transcript: check the labels");
            }
            if last.is_none() && parameters.audio.mean.dim().1 == 1 {
                em::warnings(&parameters, &sums, &floors)
                    .iter()
                    .for_each(|line| progress.say(line));
            }
            em::maximise(&mut parameters, &sums, &floors, None);
            progress.say(&format!(
                "  K = {}: log likelihood {:.4} a frame, {} clips without a path ({:.1} s)",
                parameters.audio.mean.dim().1,
                sums.per_frame(),
                sums.failed.len(),
                begun.elapsed().as_secs_f32()
            ));
            last = Some(sums);
        }
        match last {
            Some(sums) if parameters.audio.mean.dim().1 < settings.mixtures => {
                parameters.audio = density::split(&parameters.audio, &sums.audio, ENOUGH_TO_SPLIT, None);
            }
            _ => break,
        }
    }
    let mut start_mean = [0.0; lipstream_core::N_STATIC];
    start_mean.copy_from_slice(&folder.manifest.start_mean);
    let mut hmm = AudioHmm {
        phones: phones.clone(),
        start_mean,
        audio: parameters.audio,
        transition: parameters.transition,
        bigram: said(used, &phones),
        shifts: Shifts::default(),
        acoustic_scale: super::audio_hmm::ACOUSTIC_SCALE,
        provenance: format!(
            "audio HMM of {} clips of {}, {} components",
            used.len(),
            crate::train::corpus_name(folder),
            settings.mixtures
        ),
    };
    if labelled {
        hmm.shifts = learn_shifts(folder, used, &hmm)?;
    }
    Ok(hmm)
}

/// Variances are floored at this many times what EM takes elsewhere: at 5 % of the pooled variance. Chosen, as the
/// other settings, on training speakers that were held out (docs/models.md).
const FLOOR: f32 = 5.0;
/// A component seen in fewer frames of 5 ms keeps what it had.
const LEAST_FRAMES: f64 = 30.0;
/// Frames that a component must have before it is split.
const ENOUGH_TO_SPLIT: f64 = 30.0;

/// Clips heard every 5 ms.
struct Sounds<'a> {
    clips: Vec<&'a Clip>,
    phones: &'a [Phone],
    /// The observations of each clip.
    heard: Shelf,
}

impl<'a> Sounds<'a> {
    /// Hears the clips that can be used; `progress` hears of the others.
    fn hear(
        folder: &FeatureFolder,
        clips: Vec<&'a Clip>,
        phones: &'a [Phone],
        aside: Option<&Path>,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let mut sounds = Self {
            clips: Vec::new(),
            phones,
            heard: Shelf::new(aside)?,
        };
        let index = |phone: Phone| phones.iter().position(|p| *p == phone);
        let hear = |n: usize| Ok((clips[n], hear(folder, clips[n], &index)));
        in_order(clips.len(), hear, |(clip, heard)| {
            match heard {
                Ok(audio) => {
                    sounds.heard.push(audio.into_raw_vec_and_offset().0)?;
                    sounds.clips.push(clip);
                }
                Err(error) => progress.warn(&format!("left out: {}", chain(&error))),
            }
            Ok(())
        })?;
        Ok(sounds)
    }
}

impl Source for Sounds<'_> {
    fn len(&self) -> usize {
        self.clips.len()
    }

    fn get(&self, n: usize) -> Result<Cow<'_, Utterance>> {
        let heard = self.heard.get(n)?;
        let audio = Array2::from_shape_vec((heard.len() / N_OBSERVATION, N_OBSERVATION), heard)?;
        let index = |phone: Phone| self.phones.iter().position(|p| *p == phone);
        utterance(self.clips[n], audio, &index).map(Cow::Owned)
    }
}

/// The observations of a clip that can be used, `[frames, 39]`.
fn hear(folder: &FeatureFolder, clip: &Clip, index: &dyn Fn(Phone) -> Option<usize>) -> Result<Array2<f32>> {
    let samples = sound::read(&folder.wav_path(&clip.id))
        .map_err(Error::other)?
        .samples;
    let mut start_mean = [0.0; lipstream_core::N_STATIC];
    start_mean.copy_from_slice(&folder.manifest.start_mean);
    Ok(utterance(clip, observations(&samples, start_mean), index)?.audio)
}

fn utterance(clip: &Clip, audio: Array2<f32>, index: &dyn Fn(Phone) -> Option<usize>) -> Result<Utterance> {
    let (Some(network), Some(silence)) = (data::network(clip, index), index(Phone::SIL)) else {
        bail!(Data, "clip {}: it has no labels and no transcript", clip.id);
    };
    if network.shortest(N_EMITTING) > audio.nrows() {
        bail!(Data, "clip {}: too short for its phones", clip.id);
    }
    let mut start = vec![(silence, N_EMITTING / 2); audio.nrows()];
    for label in data::timed_phones(clip) {
        let Some(phone) = Phone::from_name(&label.phone).and_then(index) else {
            continue;
        };
        let (from, to) = (f64::from(label.start), f64::from(label.end));
        for (t, place) in start.iter_mut().enumerate() {
            let time = frame_time(t);
            if time >= from && time < to {
                let state = (time - from) / (to - from) * N_EMITTING as f64;
                *place = (phone, (state as usize).min(N_EMITTING - 1));
            }
        }
    }
    Ok(Utterance {
        id: clip.id.clone(),
        audio,
        visual: None,
        network,
        start,
    })
}

/// What follows what in the labels, or in each word's usual pronunciation.
fn said(clips: &[&Clip], phones: &[Phone]) -> Bigram {
    let mut said = bigram::Said::none(phones.len());
    let index = |phone: Phone| phones.iter().position(|p| *p == phone);
    for network in clips.iter().filter_map(|clip| data::network(clip, &index)) {
        said.add(&network.usual());
    }
    let (initial, next) = bigram::bigram(phones.len(), &said, &data::Clips::none(phones));
    Bigram {
        initial: initial.into(),
        next,
    }
}

/// Aligns the labelled phones of the training clips and compares.
fn learn_shifts(folder: &FeatureFolder, clips: &[&Clip], hmm: &AudioHmm) -> Result<Shifts> {
    let aligner = Aligner::new(hmm.clone());
    let borders: Vec<Vec<(usize, usize, f64)>> = clips
        .par_iter()
        .map(|clip| {
            let samples = sound::read(&folder.wav_path(&clip.id))
                .map_err(Error::other)?
                .samples;
            let Ok(alignment) = aligner.phones(&samples, &clip.phones) else {
                return Ok(Vec::new());
            };
            let pairs = clip.phones.windows(2).zip(alignment.phones.windows(2));
            Ok(pairs
                .map(|(label, found)| {
                    (
                        shifts::class(found[0].phone),
                        shifts::class(found[1].phone),
                        f64::from(label[1].start) - found[1].start,
                    )
                })
                .collect())
        })
        .collect::<Result<_>>()?;
    Ok(Shifts::learn(&borders.concat()))
}
