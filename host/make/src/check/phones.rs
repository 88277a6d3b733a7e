//! Which phones are heard in a take, and which are not: what a mouth never showed cannot be learnt from it.
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::align::recognise::Recogniser;
use crate::corpus::labels::{self, Labels, transcript};
use crate::corpus::pronounce::Pronouncer;
use crate::corpus::take;
use crate::error::Result;
use lipstream::phones::Phone;

/// Phones that come less often than this are rare.
pub const RARE: usize = 3;

/// Syllabic consonants, which dictionaries have as another way of saying two phones: counted, and never missing.
const SYLLABIC: [&str; 3] = ["em", "el", "en"];

/// How often each phone of X&L's table 1 is said, silences left out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PhoneReport {
    /// What tells them: a file, or how they were recognised.
    pub from: String,
    /// Phones that are said, and how often.
    pub counts: BTreeMap<String, usize>,
    /// Of them those said less than [`RARE`] times.
    pub rare: Vec<String>,
    /// Phones that are not said at all.
    pub missing: Vec<String>,
}

impl PhoneReport {
    /// Counts phones, whoever found them: a transcript's pronunciations, labels, or recognition. `from` says which.
    pub fn of(phones: impl IntoIterator<Item = Phone>, from: impl Into<String>) -> Self {
        let mut counts: BTreeMap<Phone, usize> = Phone::all()
            .filter(|phone| *phone != Phone::SIL && *phone != Phone::SP)
            .map(|phone| (phone, 0))
            .collect();
        for phone in phones {
            if let Some(count) = counts.get_mut(&phone) {
                *count += 1;
            }
        }
        let names = |chosen: &dyn Fn(usize) -> bool| -> Vec<String> {
            let some = counts.iter().filter(|(_, count)| chosen(**count));
            some.map(|(phone, _)| phone.name().to_owned()).collect()
        };
        Self {
            from: from.into(),
            rare: names(&|count| (1..RARE).contains(&count)),
            missing: names(&|count| count == 0)
                .into_iter()
                .filter(|name| !SYLLABIC.contains(&name.as_str()))
                .collect(),
            counts: counts
                .iter()
                .filter(|(_, count)| **count > 0)
                .map(|(phone, count)| (phone.name().to_owned(), *count))
                .collect(),
        }
    }

    /// Counts what the shipped model hears in 16 kHz mono samples; None where they are too short to hear anything in.
    ///
    /// It errs: of talkers whom it has not heard three in five phones (`docs/alignment.md`), so that counts are rough, and a rare phone may be another.
    pub(crate) fn heard(samples: &[i16]) -> Result<Option<Self>> {
        let Ok(heard) = Recogniser::shipped()?.recognise(samples) else {
            return Ok(None);
        };
        let phones = heard.phones.iter().map(|spoken| spoken.phone);
        Ok(Some(Self::of(
            phones,
            "as far as the shipped model hears; a transcript beside the video tells exactly",
        )))
    }

    /// Counts what stands beside a video of `seconds`: subtitles, else labels or a transcript of the same name; None where there are none.
    pub(crate) fn beside(video: &Path, seconds: f64) -> Result<Option<Self>> {
        let (labels, from) = match take::subtitles(video)? {
            Some((path, said)) => {
                let words = said.iter().flat_map(|subtitle| transcript::words(&subtitle.text));
                let words = words.collect();
                (
                    Labels {
                        words,
                        phones: Vec::new(),
                    },
                    path,
                )
            }
            None => {
                let beside = labels::EXTENSIONS.map(|ending| video.with_extension(ending));
                let files: Vec<PathBuf> = beside.into_iter().filter(|path| path.is_file()).collect();
                let Some(first) = files.first() else {
                    return Ok(None);
                };
                (labels::read(&files, seconds)?, first.clone())
            }
        };
        let from = from.display().to_string();
        if !labels.phones.is_empty() {
            return Ok(Some(Self::of(
                labels.phones.iter().map(|(_, _, phone)| *phone),
                from,
            )));
        }
        let pronouncer = Pronouncer::new(None)?;
        let mut phones = Vec::new();
        for word in &labels.words {
            let (pronunciations, _) = pronouncer.word(word)?;
            phones.extend(pronunciations.into_iter().next().unwrap_or_default());
        }
        Ok(Some(Self::of(phones, from)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::corpus::prompts::PROMPTS;

    #[test]
    fn phones_are_counted_and_the_others_named() {
        let said = ["sil", "b", "iy", "b", "b", "sp", "m"];
        let report = PhoneReport::of(said.iter().filter_map(|p| Phone::from_name(p)), "a test");
        assert_eq!(report.counts["b"], 3);
        assert_eq!(report.rare, ["iy", "m"]);
        assert_eq!(report.missing.len(), 45 - 3 - SYLLABIC.len());
        assert!(!report.missing.iter().any(|p| p == "sil" || p == "sp" || p == "b"));
    }

    #[test]
    fn what_stands_beside_a_video_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let video = folder.path().join("me.mp4");
        assert_eq!(PhoneReport::beside(&video, 9.0).unwrap(), None);
        std::fs::write(folder.path().join("me.txt"), PROMPTS.join("\n")).unwrap();
        let all = PhoneReport::beside(&video, 120.0).unwrap().unwrap();
        assert!(all.missing.is_empty(), "{:?}", all.missing);
        std::fs::write(
            folder.path().join("me.srt"),
            "1\n00:00:01,000 --> 00:00:02,000\nBlue bees\n",
        )
        .unwrap();
        let said = PhoneReport::beside(&video, 9.0).unwrap().unwrap();
        assert!(said.from.ends_with("me.srt"));
        assert_eq!(said.counts["b"], 2);
        assert_eq!(said.counts["z"], 1);
    }
}
