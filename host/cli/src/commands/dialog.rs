//! What a sound says, where its text is known: mouth shapes at the times of its phones.
use std::path::Path;

use anyhow::{Context as _, Result, bail};
use lipstream::phones::VISEMES;
use lipstream::time;
use lipstream_make::align::fit::Fit;
use lipstream_make::align::{Aligner, Alignment, AudioHmm, Recogniser};
use lipstream_make::corpus::labels::{self, transcript};
use lipstream_make::corpus::pronounce::Pronouncer;
use lipstream_make::features::Word;
use lipstream_media::files;

/// The text of a sound.
pub(super) struct Dialog {
    words: Vec<Word>,
    name: String,
}

impl Dialog {
    /// Reads a text file.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = labels::decode(&files::read_text(path)?)
            .with_context(|| format!("cannot read the text {}", path.display()))?;
        let pronouncer = Pronouncer::new(None)?;
        let spoken = transcript::words(&text);
        let words = spoken.iter().map(|word| Ok(pronouncer.spoken(word)?.0));
        let words: Vec<Word> = words
            .collect::<Result<_>>()
            .with_context(|| format!("the text {}", path.display()))?;
        if words.is_empty() {
            bail!("there is no word in the text {}", path.display());
        }
        Ok(Self {
            words,
            name: path.display().to_string(),
        })
    }

    /// Viseme weights of every frame of a sound that says the text; none where it does not, as far as can be heard, with what is to be said about that.
    pub(super) fn visemes(&self, samples: &[i16]) -> Result<Result<Vec<[f32; VISEMES.len()]>, String>> {
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
