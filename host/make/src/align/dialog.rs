//! What a sound says, where its text is known: mouth shapes at the times of its phones.
use std::path::Path;

use lipstream::phones::VISEMES;
use lipstream::time;
use lipstream_media::files;

use super::fit::Fit;
use super::{Aligner, Alignment, AudioHmm, Recogniser};
use crate::corpus::labels::{self, SpokenWord, transcript};
use crate::corpus::pronounce::Pronouncer;
use crate::error::{Context as _, Error, Result, bail};
use crate::features::Word;

/// The text of a sound.
pub struct Dialog {
    words: Vec<Word>,
    name: String,
}

impl Dialog {
    /// Reads a text file.
    ///
    /// # Errors
    ///
    /// That it cannot be read, has no word, or has one that nothing tells how to say.
    pub fn read(path: &Path) -> Result<Self> {
        let text = labels::decode(&files::read_text(path).map_err(Error::other)?)
            .with_context(|| format!("cannot read the text {}", path.display()))?;
        Self::of(&transcript::words(&text), &format!("the text {}", path.display()))
    }

    /// Words that have been read; `name` says where, in messages.
    ///
    /// # Errors
    ///
    /// That there is none, or one that nothing tells how to say.
    pub fn of(words: &[SpokenWord], name: &str) -> Result<Self> {
        let pronouncer = Pronouncer::new(None)?;
        let words = words.iter().map(|word| Ok(pronouncer.spoken(word)?.0));
        let words: Vec<Word> = words.collect::<Result<_>>().with_context(|| name.to_owned())?;
        if words.is_empty() {
            bail!(Data, "there is no word in {name}");
        }
        Ok(Self {
            words,
            name: name.to_owned(),
        })
    }

    /// Viseme weights of every frame of a sound that says the text; none where it does not, as far as can be heard, with what is to be said about that.
    ///
    /// # Errors
    ///
    /// That the sound is too short to be heard.
    pub fn visemes(&self, samples: &[i16]) -> Result<Result<Vec<[f32; VISEMES.len()]>, String>> {
        let aligner = Aligner::new(AudioHmm::shipped()?).with_long_pauses();
        let aligned = match aligner.words(samples, &self.words) {
            Ok(aligned) => aligned,
            Err(error) => return Ok(Err(format!("{}: {error}; the sound alone decides", self.name))),
        };
        let heard = Recogniser::shipped()?.recognise(samples)?;
        match Fit::of(&aligned, &heard) {
            Some(fit) if !fit.says() => Ok(Err(format!(
                "the words of {} do not fit what is heard ({fit}): the sound alone decides",
                self.name
            ))),
            _ => Ok(Ok(weights(&aligned, time::frame_count(samples.len())))),
        }
    }
}

/// The viseme of the phone that is said at every frame's centre.
fn weights(aligned: &Alignment, frames: usize) -> Vec<[f32; VISEMES.len()]> {
    let mut phones = aligned.phones.iter().filter(|p| p.end > p.start).peekable();
    let mut now = None;
    (0..frames)
        .map(|frame| {
            let at = time::frame_seconds(frame);
            while let Some(phone) = phones.next_if(|phone| phone.start <= at) {
                now = Some(phone.phone);
            }
            let mut row = [0.0; VISEMES.len()];
            // Before the first phone and behind the last the mouth is at rest, which is the first viseme.
            row[now.map_or(0, |phone| usize::from(phone.viseme().0))] = 1.0;
            row
        })
        .collect()
}
