//! Clips of feature folders as training sees them: observations at 100 Hz, a network of phones, start labels. They are read
//! when their turn comes.
use std::borrow::Cow;

use lipstream_core::SAMPLE_RATE_HZ;
use ndarray::{Array2, ArrayView2, Axis, concatenate};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use crate::em::source::{Source, Utterance, in_order};
use crate::error::{Error, Result, bail, chain};
use crate::features::{Clip, FeatureFolder, PhoneLabel, Split};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::network::PhoneNetwork;
use lipstream::phones::Phone;
use lipstream::progress::Progress;
use lipstream::time;

/// Centre of audio frame t in seconds.
pub fn frame_time(t: usize) -> f32 {
    time::frame_sample(t) as f32 / SAMPLE_RATE_HZ as f32
}

/// Video frames at the audio's rate, `[frames, D]`: linear between the middles of the exposures, edges held.
pub fn to_audio_rate(visual: ArrayView2<f32>, video_hz: f32, frames: usize) -> Array2<f32> {
    let (n, d) = visual.dim();
    Array2::from_shape_fn((frames, d), |(t, i)| {
        let place = (frame_time(t) * video_hz - 0.5).clamp(0.0, (n - 1) as f32);
        let before = place.floor() as usize;
        let after = (before + 1).min(n - 1);
        let share = place - before as f32;
        visual[[before, i]] * (1.0 - share) + visual[[after, i]] * share
    })
}

/// Phones of a clip with times, from its labels: phone labels, else word times with even phones, else even phones
/// over the whole clip.
pub fn timed_phones(clip: &Clip) -> Vec<PhoneLabel> {
    if !clip.phones.is_empty() {
        return clip.phones.clone();
    }
    let end = frame_time(clip.audio_frames);
    let timed = clip.words.iter().all(|w| w.time.is_some());
    if timed {
        clip.words
            .iter()
            .flat_map(|w| {
                let (from, to) = w.time.unwrap_or((0.0, end));
                even(&w.pronunciations[0], from, to)
            })
            .collect()
    } else {
        let mut said: Vec<String> = vec!["sil".into()];
        said.extend(
            clip.words
                .iter()
                .flat_map(|w| w.pronunciations[0].iter().cloned()),
        );
        said.push("sil".into());
        even(&said, 0.0, end)
    }
}

fn even(phones: &[String], from: f32, to: f32) -> Vec<PhoneLabel> {
    let each = (to - from) / phones.len() as f32;
    phones
        .iter()
        .enumerate()
        .map(|(n, phone)| PhoneLabel {
            phone: phone.clone(),
            start: from + n as f32 * each,
            end: from + (n + 1) as f32 * each,
        })
        .collect()
}

/// Phone (model index) and state of every frame; frames that no label covers are silence.
fn start_labels(
    labels: &[PhoneLabel],
    frames: usize,
    index: &dyn Fn(Phone) -> Option<usize>,
) -> Result<Vec<(usize, usize)>> {
    let Some(silence) = index(Phone::SIL) else {
        bail!(Data, "the model has no phone for silence")
    };
    let mut out = vec![(silence, N_EMITTING / 2); frames];
    for label in labels {
        let Some(phone) = Phone::from_name(&label.phone).and_then(index) else {
            continue;
        };
        for (t, place) in out.iter_mut().enumerate() {
            let time = frame_time(t);
            if time >= label.start && time < label.end {
                let state = (time - label.start) / (label.end - label.start) * N_EMITTING as f32;
                *place = (phone, (state as usize).min(N_EMITTING - 1));
            }
        }
    }
    Ok(out)
}

/// The network that training follows: the labelled phones one by one, or the transcript with its alternatives.
/// None for a clip of which nothing tells what is said.
pub(crate) fn network(clip: &Clip, index: &dyn Fn(Phone) -> Option<usize>) -> Option<PhoneNetwork> {
    if !clip.is_labelled() {
        return None;
    }
    if clip.phones.is_empty() {
        return PhoneNetwork::transcript(&clip.words, index);
    }
    let mut said: Vec<usize> = Vec::new();
    for label in &clip.phones {
        let phone = Phone::from_name(&label.phone).and_then(index)?;
        let pause = label.phone == "sil" || label.phone == "sp";
        if !(pause && said.last() == Some(&phone)) {
            said.push(phone);
        }
    }
    (!said.is_empty()).then(|| PhoneNetwork::chain(&said))
}

/// The network of a clip that can be used; `Err` says why it cannot. Looks at the manifest only.
fn usable(clip: &Clip, index: &dyn Fn(Phone) -> Option<usize>) -> Result<PhoneNetwork> {
    if !clip.is_labelled() {
        bail!(
            Data,
            "clip {}: nothing tells its phones; prepare it with a transcript, or so that they are recognised",
            clip.id
        );
    }
    let Some(network) = network(clip, index) else {
        bail!(
            Data,
            "clip {}: its transcript holds a phone that the model does not have",
            clip.id
        )
    };
    if network.shortest(N_EMITTING) > clip.audio_frames {
        bail!(
            Data,
            "clip {}: {} frames are too few for its phones",
            clip.id,
            clip.audio_frames
        );
    }
    Ok(network)
}

/// What an utterance's observations are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Observed {
    /// Sound, and mouth where there is one.
    Apart,
    /// [oᵃ; oᵛ] as one observation.
    Stacked,
    /// Sound only, also where there is a mouth.
    Sound,
}

/// Clips of one split of feature folders, read one by one.
#[derive(Clone)]
pub struct Clips<'a> {
    clips: Vec<(&'a FeatureFolder, &'a Clip)>,
    phones: &'a [Phone],
    observed: Observed,
    /// Whether what is said counts; where not, every clip is one phone, silence.
    labels: bool,
}

impl<'a> Clips<'a> {
    /// No clips at all, for a model of these phones.
    pub fn none(phones: &'a [Phone]) -> Self {
        Self {
            clips: Vec::new(),
            phones,
            observed: Observed::Apart,
            labels: true,
        }
    }

    /// The clips that can be used; `progress` hears of the others. Looks at the manifest only.
    pub fn new(
        folder: &'a FeatureFolder,
        split: Split,
        phones: &'a [Phone],
        progress: &dyn Progress,
    ) -> Self {
        let mut clips = Self::unlabelled(folder, split, phones);
        clips.labels = true;
        let fit = clips
            .clips
            .iter()
            .map(|(_, clip)| usable(clip, &clips.index()).map(drop));
        let fit: Vec<Result<()>> = fit.collect();
        clips.leave_out(fit, progress);
        clips
    }

    /// All clips, whatever is known of what is said in them, for training that does not ask.
    pub fn unlabelled(folder: &'a FeatureFolder, split: Split, phones: &'a [Phone]) -> Self {
        Self {
            clips: folder.split(split).map(|clip| (folder, clip)).collect(),
            labels: false,
            ..Self::none(phones)
        }
    }

    /// Those whose files can be read, and have a mouth if they are to.
    pub fn readable(mut self, with_video: bool, progress: &dyn Progress) -> Self {
        let mut read = Vec::new();
        let try_clip = |n: usize| {
            let utterance = self.get(n);
            Ok(utterance.and_then(|u| match with_video && u.visual.is_none() {
                true => bail!(Data, "clip {}: it has no video", u.id),
                false => Ok(()),
            }))
        };
        let outcome = in_order(self.len(), try_clip, |tried| {
            read.push(tried);
            Ok(())
        });
        debug_assert!(outcome.is_ok(), "what cannot be read is no error here");
        self.leave_out(read, progress);
        self
    }

    fn leave_out(&mut self, fit: Vec<Result<()>>, progress: &dyn Progress) {
        let before = self.len();
        for error in fit.iter().filter_map(|f| f.as_ref().err()) {
            progress.warn(&format!("left out: {}", chain(error)));
        }
        self.keep(&fit.iter().map(Result::is_ok).collect::<Vec<_>>());
        if self.len() < before {
            progress.warn(&format!(
                "{} clips left out, {} used",
                before - self.len(),
                self.len()
            ));
        }
    }

    /// Keeps the clips that `kept` says.
    pub fn keep(&mut self, kept: &[bool]) {
        let mut kept = kept.iter();
        self.clips.retain(|_| kept.next().is_some_and(|k| *k));
    }

    /// Keeps so many of the clips, drawn by the seed, in their order.
    pub fn draw(&mut self, clips: usize, seed: u64) {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.shuffle(&mut Pcg64::seed_from_u64(seed));
        let mut kept = vec![false; self.len()];
        order.iter().take(clips).for_each(|&n| kept[n] = true);
        self.keep(&kept);
    }

    /// The clips from `at` on, which are taken away.
    pub fn split_off(&mut self, at: usize) -> Self {
        Self {
            clips: self.clips.split_off(at.min(self.len())),
            ..*self
        }
    }

    /// The same clips, otherwise observed.
    pub fn observed(&self, observed: Observed) -> Self {
        Self {
            observed,
            ..self.clone()
        }
    }

    /// Adds the clips of another folder.
    pub fn extend(&mut self, other: &Self) {
        self.clips.extend(&other.clips);
    }

    /// The names of the clips.
    pub fn ids(&self) -> impl Iterator<Item = &str> {
        self.clips.iter().map(|(_, clip)| clip.id.as_str())
    }

    /// The networks of the clips; reads none.
    pub fn networks(&self) -> impl Iterator<Item = PhoneNetwork> {
        let clips = self.clips.iter();
        clips.filter_map(|(_, clip)| network(clip, &self.index()))
    }

    fn index(&self) -> impl Fn(Phone) -> Option<usize> {
        |phone| self.phones.iter().position(|p| *p == phone)
    }
}

impl Source for Clips<'_> {
    fn len(&self) -> usize {
        self.clips.len()
    }

    fn get(&self, n: usize) -> Result<Cow<'_, Utterance>> {
        let (folder, clip) = self.clips[n];
        let (network, labels) = match self.labels {
            true => (usable(clip, &self.index())?, timed_phones(clip)),
            false => (PhoneNetwork::chain(&[0]), Vec::new()),
        };
        // The manifest's number of frames is held against the file's before room is made for so many.
        let audio = folder.audio(clip)?;
        let start = start_labels(&labels, clip.audio_frames, &self.index())?;
        let visual = match clip.video_frames {
            _ if self.observed == Observed::Sound => None,
            0 => None,
            _ => {
                let visual = folder.visual(clip)?;
                Some(to_audio_rate(visual.view(), clip.video_hz, clip.audio_frames))
            }
        };
        let apart = Utterance {
            id: clip.id.clone(),
            audio,
            visual,
            network,
            start,
        };
        Ok(Cow::Owned(match self.observed {
            Observed::Stacked => stacked(apart)?,
            Observed::Apart | Observed::Sound => apart,
        }))
    }
}

/// [oᵃ; oᵛ] as one observation.
pub(super) fn stacked(apart: Utterance) -> Result<Utterance> {
    let visual = apart
        .visual
        .ok_or_else(|| Error::Data(format!("clip {} has no video", apart.id)))?;
    let audio: Array2<f32> = concatenate(Axis(1), &[apart.audio.view(), visual.view()])?;
    Ok(Utterance {
        audio: audio.as_standard_layout().into_owned(),
        visual: None,
        ..apart
    })
}

/// Phones that a split's clips may progress, in table order, silence always among them.
pub fn phones_said<'a>(clips: impl Iterator<Item = &'a Clip>) -> Vec<Phone> {
    let mut said: Vec<Phone> = vec![Phone::SIL, Phone::SP];
    for clip in clips {
        let labelled = clip.phones.iter().map(|l| l.phone.as_str());
        let spoken = clip
            .words
            .iter()
            .flat_map(|w| w.pronunciations.iter().flatten())
            .map(String::as_str);
        said.extend(labelled.chain(spoken).filter_map(Phone::from_name));
    }
    said.sort_unstable();
    said.dedup();
    said
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::{MANIFEST_VERSION, Manifest, PhonesFrom};
    use ndarray::array;

    #[test]
    fn video_is_read_at_the_middle_of_its_exposures() {
        let visual = array![[0.0f32], [4.0], [8.0]];
        let up = to_audio_rate(visual.view(), 25.0, 12);
        // Frame 1 is exposed around 60 ms; audio frame 4 is centred at 52.5 ms, frame 5 at 62.5 ms.
        assert!((up[[4, 0]] - (4.0 - 0.75)).abs() < 1e-4);
        assert!((up[[5, 0]] - (4.0 + 0.25)).abs() < 1e-4);
        assert_eq!((up[[0, 0]], up[[11, 0]]), (0.0, 8.0));
    }

    /// A clip of which nothing tells its phones is no silence: it is left out by name, unless nobody asks for phones.
    #[test]
    fn clips_without_labels_are_left_out() {
        let clip = |id: &str, phones: &[&str], from: PhonesFrom| Clip {
            id: id.into(),
            speaker: String::new(),
            split: Split::Train,
            audio_frames: 100,
            video_frames: 0,
            video_hz: 0.0,
            words: Vec::new(),
            phones: even(
                &phones.iter().map(|p| (*p).to_owned()).collect::<Vec<_>>(),
                0.0,
                1.0,
            ),
            phones_from: from,
        };
        let folder = FeatureFolder {
            root: "nowhere".into(),
            manifest: Manifest {
                version: MANIFEST_VERSION,
                corpus: String::new(),
                start_mean: vec![0.0; lipstream_core::N_STATIC],
                visual_size: 0,
                lips: false,
                clips: vec![
                    clip("labelled", &["sil", "b", "sil"], PhonesFrom::Labels),
                    clip("unknown", &[], PhonesFrom::Labels),
                    clip("heard", &["sil", "b"], PhonesFrom::Recognised),
                ],
                skipped: Vec::new(),
            },
        };
        let phones = phones_said(folder.split(Split::Train));
        let said = std::sync::Mutex::new(Vec::new());
        let clips = Clips::new(&folder, Split::Train, &phones, &|line: &str| {
            said.lock().unwrap().push(line.to_owned());
        });
        assert_eq!(clips.ids().collect::<Vec<_>>(), ["labelled", "heard"]);
        assert_eq!(clips.networks().count(), 2);
        assert!(said.lock().unwrap()[0].contains("left out: clip unknown: nothing tells its phones"));
        assert_eq!(Clips::unlabelled(&folder, Split::Train, &phones).len(), 3);
    }

    #[test]
    fn labels_spread_evenly_over_states() {
        let labels = even(&["b".into(), "iy".into()], 0.1, 0.3);
        let index = |p: Phone| Some(usize::from(p.0));
        let start = start_labels(&labels, 40, &index).unwrap();
        let b = usize::from(Phone::from_name("b").unwrap().0);
        assert_eq!(start[0].0, 0);
        assert_eq!(start.iter().filter(|(p, _)| *p == b).count(), 10);
        for state in 0..N_EMITTING {
            assert_eq!(start.iter().filter(|(p, i)| (*p, *i) == (b, state)).count(), 2);
        }
    }
}
