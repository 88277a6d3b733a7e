//! Phones of clips that nobody labelled: by forced alignment where there is a transcript, by recognition where there is none.
use std::path::PathBuf;
use std::sync::OnceLock;

use crate::align::fit::Fit;
use crate::align::recognise::RecognitionSettings;
use crate::align::{Aligner, Alignment, AudioHmm, Recogniser};
use crate::error::{Error, Result};
use crate::features::{Clip, PhonesFrom};

/// By whom clips are heard that have no labels with times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Hearing {
    /// By the shipped model.
    #[default]
    Shipped,
    /// By a model of the user's own, any that aligns.
    Model(PathBuf),
    /// By none: such clips stay without phones.
    Nobody,
}

/// The model, read when the first clip needs it.
pub(super) struct Listener {
    hearing: Hearing,
    ears: OnceLock<Result<Ears, String>>,
}

pub(super) struct Ears {
    pub(super) aligner: Aligner,
    pub(super) recogniser: Recogniser,
}

/// What was heard in a clip, and whether its transcript is what is said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Heard {
    /// It has labels of its own, or nobody listens.
    Nothing,
    Recognised,
    Aligned,
    /// The transcript is not what is said; nothing was written.
    Otherwise,
}

impl Listener {
    pub(super) fn new(hearing: &Hearing) -> Self {
        Self {
            hearing: hearing.clone(),
            ears: OnceLock::new(),
        }
    }

    /// None where nobody listens.
    pub(super) fn ears(&self) -> Result<Option<&Ears>> {
        let read = || -> Result<Ears> {
            let hmm = match &self.hearing {
                Hearing::Model(path) => AudioHmm::read(path)?,
                Hearing::Shipped | Hearing::Nobody => AudioHmm::shipped()?,
            };
            Ok(Ears {
                recogniser: Recogniser::new(hmm.clone(), RecognitionSettings::default()),
                aligner: Aligner::new(hmm).with_long_pauses(),
            })
        };
        if self.hearing == Hearing::Nobody {
            return Ok(None);
        }
        let ears = self
            .ears
            .get_or_init(|| read().map_err(|e| crate::error::chain(&e)));
        ears.as_ref().map(Some).map_err(|e| Error::Data(e.clone()))
    }

    /// Fills in the phones of a clip that has none with times.
    pub(super) fn hear(&self, clip: &mut Clip, samples: &[i16]) -> Result<Heard> {
        let timed = !clip.words.is_empty() && clip.words.iter().all(|w| w.time.is_some());
        if timed || !clip.phones.is_empty() {
            return Ok(Heard::Nothing);
        }
        let Some(ears) = self.ears()? else {
            return Ok(Heard::Nothing);
        };
        let heard = ears.recogniser.recognise(samples)?;
        if clip.words.is_empty() {
            (clip.phones, clip.phones_from) = (heard.labels(), PhonesFrom::Recognised);
            return Ok(Heard::Recognised);
        }
        let aligned = ears.aligner.words(samples, &clip.words);
        let says = |aligned: &Alignment| Fit::of(aligned, &heard).is_some_and(Fit::says);
        match aligned {
            Ok(aligned) if says(&aligned) => {
                (clip.phones, clip.phones_from) = (aligned.labels(), PhonesFrom::Aligned);
                Ok(Heard::Aligned)
            }
            _ => Ok(Heard::Otherwise),
        }
    }
}
