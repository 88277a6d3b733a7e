//! What `prepare` tells at its end.
use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::discover::{Found, SplitBy};
use super::heard::Heard;
use super::prepare::{PrepareSettings, Prepared};
use super::pronounce;
use crate::features::{Clip, Manifest, Skipped, Split};
use lipstream::phones::Phone;

/// Clips, hours and speakers of one split.
#[derive(Clone, Debug, Default, Serialize)]
pub struct SplitSummary {
    /// Number of clips.
    pub clips: usize,
    /// Those of them that have video.
    pub with_video: usize,
    /// Number of different speakers.
    pub speakers: usize,
    /// Length of all clips together, in seconds.
    pub seconds: f64,
    /// Number of words in the labels, repeated ones counted each time.
    pub words: usize,
}

/// What came out.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Folder that was prepared, as the user gave it.
    pub corpus: String,
    /// Feature folder that was written, as the user gave it.
    pub folder: String,
    /// Where the split came from.
    pub split_by: String,
    /// The training clips.
    pub train: SplitSummary,
    /// The validation clips.
    pub val: SplitSummary,
    /// The test clips.
    pub test: SplitSummary,
    /// Numbers in a visual frame; 0 without video.
    pub visual_size: usize,
    /// Whether these are the lips' gap and width.
    pub lips: bool,
    /// Clips without any label, in which nobody heard phones.
    pub unlabelled: usize,
    /// Clips without any label whose phones were recognised.
    pub recognised: usize,
    /// Clips whose transcript was aligned with their sound.
    pub aligned: usize,
    /// Clips whose sentence was read from their GRID file name.
    pub named_sentences: usize,
    /// Different words, by where their pronunciation came from.
    pub words_from_user_dictionary: usize,
    /// Different words that CMUdict or the table of letter names has.
    pub words_from_dictionary: usize,
    /// Different words that are an inflected form of a word in a dictionary.
    pub words_inflected: usize,
    /// Words that no dictionary has, spoken by rule.
    pub words_by_rule: Vec<String>,
    /// Phones of X&L table 1 in the training clips, with how often they occur, and those that do not occur.
    pub phones: BTreeMap<String, usize>,
    /// Phones of X&L table 1 that no training clip holds.
    pub phones_missing: Vec<String>,
    /// Files of the corpus that belong to no clip.
    pub left_alone: Vec<String>,
    /// Clips that could not be read, with the reason.
    pub skipped: Vec<Skipped>,
    /// Time that the preparation took, in seconds.
    pub seconds_taken: f64,
}

/// Counts what was prepared; the time taken is the caller's to fill in.
pub(super) fn summarise(
    settings: &PrepareSettings,
    found: &Found,
    clips: &[Prepared],
    manifest: Manifest,
) -> Summary {
    let split = |split: Split| {
        let of: Vec<&Prepared> = clips.iter().filter(|c| c.clip.split == split).collect();
        SplitSummary {
            clips: of.len(),
            with_video: of.iter().filter(|c| c.clip.video_frames > 0).count(),
            speakers: of.iter().map(|c| &c.clip.speaker).collect::<BTreeSet<_>>().len(),
            seconds: of.iter().fold(0.0, |sum, c| sum + c.seconds),
            words: of.iter().map(|c| c.clip.words.len()).sum(),
        }
    };
    let mut words: BTreeMap<&str, pronounce::Origin> = BTreeMap::new();
    let mut phones: BTreeMap<String, usize> = BTreeMap::new();
    for prepared in clips {
        words.extend(prepared.words.iter().map(|(w, s)| (w.as_str(), *s)));
        if prepared.clip.split == Split::Train {
            for phone in phones_of(&prepared.clip) {
                *phones.entry(phone.to_owned()).or_default() += 1;
            }
        }
    }
    let heard = |heard| clips.iter().filter(|c| c.heard == heard).count();
    let from = |source| words.iter().filter(move |(_, s)| **s == source);
    Summary {
        corpus: manifest.corpus,
        folder: settings.out.display().to_string(),
        split_by: match found.split_by {
            SplitBy::Folders => "folders",
            SplitBy::Options => "options",
            SplitBy::Speaker => "speaker",
            SplitBy::Clip => "clip",
            SplitBy::AllTrain => "all for training",
        }
        .into(),
        train: split(Split::Train),
        val: split(Split::Val),
        test: split(Split::Test),
        visual_size: manifest.visual_size,
        lips: manifest.lips,
        unlabelled: clips.iter().filter(|c| !c.clip.is_labelled()).count(),
        recognised: heard(Heard::Recognised),
        aligned: heard(Heard::Aligned),
        named_sentences: clips.iter().filter(|c| c.named_sentence).count(),
        words_from_user_dictionary: from(pronounce::Origin::User).count(),
        words_from_dictionary: from(pronounce::Origin::Dictionary).count(),
        words_inflected: from(pronounce::Origin::Inflected).count(),
        words_by_rule: from(pronounce::Origin::Letters)
            .map(|(w, _)| (*w).to_owned())
            .collect(),
        phones_missing: Phone::all()
            .map(|p| p.name().to_owned())
            .filter(|p| !phones.contains_key(p))
            .collect(),
        phones,
        left_alone: found.left_alone.iter().map(|p| p.display().to_string()).collect(),
        skipped: manifest.skipped,
        seconds_taken: 0.0,
    }
}

/// The phones of a clip: as labelled, else of the words' usual pronunciations between silences.
fn phones_of(clip: &Clip) -> Vec<&str> {
    if !clip.phones.is_empty() {
        return clip.phones.iter().map(|p| p.phone.as_str()).collect();
    }
    let words = clip.words.iter().filter_map(|w| w.pronunciations.first());
    let spoken = words.flatten().map(String::as_str);
    match clip.words.is_empty() {
        true => Vec::new(),
        false => std::iter::once("sil").chain(spoken).chain(["sil"]).collect(),
    }
}
