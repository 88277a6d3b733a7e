//! One long take, a video or its sound alone, as a corpus: cut into pieces of some seconds, between its subtitles where there are some, else at
//! its pauses. Where a text without times lies beside it, every piece gets the words of it that are said there.
use std::ops::Range;
use std::path::{Path, PathBuf};

use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};
use lipstream_media::video::{self, Part};
use lipstream_media::{files, sound};

use super::discover::{ClipFiles, Found, SOUND, deal, safe};
use super::labels::subtitles::{self, Subtitle};
use super::labels::{self, transcript};
use super::mend;
use super::prepare::{Labelling, PrepareSettings};
use super::spread;
use crate::error::{Context as _, Error, Result, bail};
use crate::features::{Split, Word};
use lipstream::progress::Progress;

/// Seconds of a piece, at least and at most.
const SHORTEST_S: f64 = 2.0;
const LONGEST_S: f64 = 8.0;
/// A pause is so long, in hops of 10 ms.
pub(crate) const PAUSE: usize = 15;
/// Where speech begins, between the quietest and the loudest tenth (the decibels of their borders).
const SPEECH: f32 = 0.4;
/// Quiet and loud must differ by so many decibels, or nothing in it is a pause.
const LEAST_RANGE_DB: f32 = 10.0;
/// A piece with less speech than this is left out, in hops.
const LEAST_SPEECH: usize = 40;

/// Subtitles closer than this belong together; cuts are so far from what is said.
const NEAR_S: f64 = 0.5;
const MARGIN_S: f64 = 0.2;

/// A piece in hops: from, to, and whether there is speech in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Piece {
    pub(crate) from: usize,
    pub(crate) to: usize,
    pub(crate) speech: bool,
}

/// Whether a file is sound without pictures, by its name.
pub(super) fn is_sound(take: &Path) -> bool {
    let ending = take.extension().unwrap_or_default().to_ascii_lowercase();
    ending.to_str().is_some_and(|ending| SOUND.contains(&ending))
}

impl Piece {
    /// Its samples in a take of `all` samples.
    fn samples(self, all: usize) -> Range<usize> {
        (self.from * HOP_SAMPLES).min(all)..(self.to * HOP_SAMPLES).min(all)
    }
}

/// Cuts a video, writes the sound of every piece to `out`, and deals the pieces out.
///
/// # Errors
///
/// That it has no sound or no speech, and what the disk says.
///
/// `late_ms` is by how much its sound is late against its pictures (mend.rs).
pub(super) fn cut(
    settings: &PrepareSettings,
    late_ms: f32,
    labelling: &Labelling,
    progress: &dyn Progress,
) -> Result<Found> {
    let take = settings.corpus.as_path();
    let sound_only = is_sound(take);
    let mut samples = match sound_only && sound::knows(take) {
        true => sound::read(take).map_err(Error::other)?.samples,
        false => {
            video::available().map_err(Error::other)?;
            let bytes = video::decode_sound(take).map_err(Error::other)?;
            sound::decode(&bytes).map_err(Error::other)?.samples
        }
    };
    mend::moved(&mut samples, late_ms);
    let mut said = subtitles(take)?;
    for subtitle in said.iter_mut().flat_map(|(_, said)| said) {
        let moved = |seconds: f64| (seconds - f64::from(late_ms) * 1e-3).max(0.0);
        subtitle.time = (moved(subtitle.time.0), moved(subtitle.time.1));
    }
    let (pieces, texts) = match &said {
        None => (pieces(&samples), Vec::new()),
        Some((_, said)) => pieces_of(said, samples.len() / HOP_SAMPLES).into_iter().unzip(),
    };
    let mut texts: Vec<String> = texts;
    let spoken: Vec<Piece> = pieces.iter().copied().filter(|piece| piece.speech).collect();
    if spoken.is_empty() {
        bail!(
            Data,
            "no speech is heard in {}: nothing in it is louder than the rest",
            take.display()
        );
    }
    let beside = take.with_extension("txt");
    if said.is_none() && beside.is_file() {
        texts = texts_of(&beside, &samples, &spoken, labelling, progress)
            .with_context(|| format!("cannot tell where the words of {} are said", beside.display()))?;
    }
    let stem = take
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let folder = settings.out.join("take");
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let mut clips = Vec::new();
    for (number, piece) in (1..).zip(&spoken) {
        let id = format!("{}-{number:04}", safe(&stem));
        let path = folder.join(format!("{id}.wav"));
        let of = &samples[piece.samples(samples.len())];
        write_if_other(&path, of)?;
        let seconds = |hops: usize| hops as f64 * HOP_SAMPLES as f64 / f64::from(SAMPLE_RATE_HZ);
        let mut labels = Vec::new();
        if let Some(text) = texts.get(number - 1).filter(|text| !text.is_empty()) {
            let path = folder.join(format!("{id}.txt"));
            files::write_bytes(&path, text.as_bytes()).map_err(Error::other)?;
            labels.push(path);
        }
        clips.push(ClipFiles {
            id,
            speaker: stem.clone(),
            split: Split::Train,
            video: (!sound_only).then(|| take.to_owned()),
            part: Some(Part {
                begins_s: seconds(piece.from),
                seconds: of.len() as f64 / f64::from(SAMPLE_RATE_HZ),
            }),
            sound: Some(path),
            labels,
            stem: String::new(),
        });
    }
    let seconds = |of: &[Piece]| of.iter().map(|p| (p.to - p.from) as f64 / 100.0).sum::<f64>();
    progress.say(&format!(
        "{}: {} pieces, {:.0} s; {:.0} s without speech left out",
        take.display(),
        spoken.len(),
        seconds(&spoken),
        seconds(&pieces) - seconds(&spoken)
    ));
    if let Some((path, _)) = &said {
        progress.say(&format!("what is said comes from {}", path.display()));
    }
    let split_by = deal(&mut clips, false, &settings.clips)?;
    Ok(Found {
        clips,
        left_alone: Vec::<PathBuf>::new(),
        split_by,
    })
}

/// What is said in each piece, from a text without times; nothing where nobody listens.
fn texts_of(
    path: &Path,
    samples: &[i16],
    pieces: &[Piece],
    labelling: &Labelling,
    progress: &dyn Progress,
) -> Result<Vec<String>> {
    let Some(ears) = labelling.listener.ears()? else {
        progress.say(&format!(
            "{} is not read: where its words are said is heard, and nobody listens",
            path.display()
        ));
        return Ok(Vec::new());
    };
    let bytes = files::read_bytes(path).map_err(Error::other)?;
    let words = transcript::words(&labels::decode(&bytes)?);
    let words = words
        .iter()
        .map(|word| Ok(labelling.pronouncer.spoken(word)?.0))
        .collect::<Result<Vec<Word>>>()?;
    if words.is_empty() {
        bail!(Data, "there are no words in it");
    }
    progress.say(&format!("what is said comes from {}", path.display()));
    let pieces: Vec<_> = pieces.iter().map(|piece| piece.samples(samples.len())).collect();
    let spread = spread::spread(ears, samples, &pieces, &words)?;
    let text = |range: Range<usize>| {
        let texts: Vec<&str> = words[range].iter().map(|w| w.text.as_str()).collect();
        texts.join(" ")
    };
    Ok(spread.into_iter().map(text).collect())
}

/// The subtitles beside a take, and which file they are in; those without words are left out.
pub(crate) fn subtitles(take: &Path) -> Result<Option<(PathBuf, Vec<Subtitle>)>> {
    let beside = ["srt", "vtt"].map(|ending| take.with_extension(ending));
    let Some(path) = beside.into_iter().find(|path| path.is_file()) else {
        return Ok(None);
    };
    let bytes = files::read_bytes(&path).map_err(Error::other)?;
    let mut said = subtitles::read(&String::from_utf8_lossy(&bytes))
        .with_context(|| format!("{} cannot be read as subtitles", path.display()))?;
    said.retain(|subtitle| subtitle.text.chars().any(char::is_alphabetic));
    Ok(Some((path, said)))
}

/// Pieces of subtitles that follow each other closely, and what is said in each. Between two pieces the cut is half-way, a fifth of a second
/// from what is said at most.
fn pieces_of(said: &[Subtitle], hops: usize) -> Vec<(Piece, String)> {
    let hop = |seconds: f64| ((100.0 * seconds).round().max(0.0) as usize).min(hops);
    let mut groups: Vec<(f64, f64, String)> = Vec::new();
    for Subtitle {
        time: (from, to),
        text,
    } in said
    {
        match groups.last_mut() {
            Some((begins, ends, texts)) if from - *ends < NEAR_S && to - *begins <= LONGEST_S => {
                *ends = ends.max(*to);
                *texts += &format!(" {text}");
            }
            _ => groups.push((*from, *to, text.clone())),
        }
    }
    (0..groups.len())
        .filter_map(|n| {
            let (begins, ends, text) = &groups[n];
            let before = n.checked_sub(1).map_or(0.0, |n| groups[n].1);
            let after = groups.get(n + 1).map_or(f64::INFINITY, |next| next.0);
            let from = hop((begins - MARGIN_S).max(0.5 * (before + begins)).min(*begins));
            let to = hop((ends + MARGIN_S).min(0.5 * (ends + after)).max(*ends));
            (to >= from + LEAST_SPEECH).then(|| {
                (
                    Piece {
                        from,
                        to,
                        speech: true,
                    },
                    text.clone(),
                )
            })
        })
        .collect()
}

/// Leaves a file alone that holds these samples already, so that what was made of it still holds.
fn write_if_other(path: &Path, samples: &[i16]) -> Result<()> {
    if sound::read(path).is_ok_and(|there| there.samples == samples) {
        return Ok(());
    }
    sound::write(path, samples).map_err(Error::other)
}

/// Decibels of every whole hop.
pub(crate) fn levels(samples: &[i16]) -> Vec<f32> {
    let power = |hop: &[i16]| hop.iter().map(|s| f32::from(*s).powi(2)).sum::<f32>() / hop.len() as f32;
    samples
        .chunks_exact(HOP_SAMPLES)
        .map(|hop| 10.0 * (power(hop) + 1.0).log10())
        .collect()
}

/// Which hops have speech in them: those louder than part of the way from quiet to loud.
pub(crate) fn speech(levels: &[f32]) -> Vec<bool> {
    let mut sorted = levels.to_vec();
    sorted.sort_by(f32::total_cmp);
    let at = |tenth: usize| sorted.get(sorted.len() * tenth / 10).copied().unwrap_or(0.0);
    let (quiet, loud) = (at(1), at(9));
    let border = quiet + SPEECH * (loud - quiet);
    match loud - quiet < LEAST_RANGE_DB {
        // All alike: either nobody speaks, or nobody pauses.
        true => vec![loud > 40.0; levels.len()],
        false => levels.iter().map(|level| *level > border).collect(),
    }
}

/// Pieces that cover the sound, cut in the middle of the longest pause that comes in time; where none does, at the quietest hop.
pub(crate) fn pieces(samples: &[i16]) -> Vec<Piece> {
    let levels = levels(samples);
    let speech = speech(&levels);
    let hops = |seconds: f64| (seconds * f64::from(SAMPLE_RATE_HZ) / HOP_SAMPLES as f64) as usize;
    let (shortest, longest) = (hops(SHORTEST_S), hops(LONGEST_S));
    // Pauses: middle and length.
    let mut pauses = Vec::new();
    let mut quiet_from = None;
    for (hop, speaks) in speech.iter().copied().chain([true]).enumerate() {
        match (speaks, quiet_from) {
            (false, None) => quiet_from = Some(hop),
            (true, Some(from)) => {
                if hop - from >= PAUSE {
                    pauses.push(((from + hop) / 2, hop - from));
                }
                quiet_from = None;
            }
            _ => {}
        }
    }
    let (mut pieces, mut from) = (Vec::new(), 0);
    while from < levels.len() {
        let to = if levels.len() - from <= longest {
            levels.len()
        } else {
            let window = from + shortest..from + longest;
            let pause = pauses
                .iter()
                .filter(|(middle, _)| window.contains(middle))
                .max_by_key(|(_, length)| *length);
            let quietest = window.clone().min_by(|a, b| levels[*a].total_cmp(&levels[*b]));
            pause
                .map(|(middle, _)| *middle)
                .or(quietest)
                .unwrap_or(levels.len())
        };
        let spoken = speech[from..to].iter().filter(|s| **s).count();
        pieces.push(Piece {
            from,
            to,
            speech: spoken >= LEAST_SPEECH,
        });
        from = to;
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of a level for some seconds.
    fn noise(level: f32, seconds: f32) -> Vec<i16> {
        let count = (seconds * SAMPLE_RATE_HZ as f32) as usize;
        (0..count)
            .map(|n| (level * ((n * n * 7919 % 2003) as f32 / 1001.5 - 1.0)) as i16)
            .collect()
    }

    fn spoken(parts: &[(f32, f32)]) -> Vec<i16> {
        parts
            .iter()
            .flat_map(|(level, seconds)| noise(*level, *seconds))
            .collect()
    }

    #[test]
    fn cuts_lie_in_pauses_and_pieces_are_of_some_seconds() {
        let mut parts = Vec::new();
        for k in 0..12 {
            parts.extend([(4000.0, 1.7 + 0.2 * k as f32), (20.0, 0.3)]);
        }
        let samples = spoken(&parts);
        let pieces = pieces(&samples);
        assert!(pieces.len() >= 5 && pieces.iter().all(|p| p.speech));
        assert_eq!(
            (pieces[0].from, pieces.last().unwrap().to),
            (0, samples.len() / HOP_SAMPLES)
        );
        let levels = levels(&samples);
        for pair in pieces.windows(2) {
            assert_eq!(pair[0].to, pair[1].from);
            assert!(levels[pair[0].to] < 35.0, "cut at {} in speech", pair[0].to);
            assert!((200..=800).contains(&(pair[0].to - pair[0].from)));
        }
    }

    #[test]
    fn subtitles_cut_where_they_say() {
        let say = |from: f64, to: f64, text: &str| Subtitle {
            time: (from, to),
            text: text.to_owned(),
        };
        let said = [
            say(1.0, 3.0, "one two"),
            say(3.2, 6.0, "three"),
            say(8.0, 12.0, "four"),
            say(12.1, 17.0, "five"),
            say(30.0, 30.1, "six"),
        ];
        let pieces = pieces_of(&said, 2900);
        let places: Vec<(usize, usize, &str)> = pieces
            .iter()
            .map(|(p, text)| (p.from, p.to, text.as_str()))
            .collect();
        assert_eq!(
            places,
            [
                (80, 620, "one two three"),
                (780, 1205, "four"),
                (1205, 1720, "five")
            ]
        );
    }

    #[test]
    fn silence_is_left_out_and_speech_without_pauses_is_cut_anyhow() {
        let pieces_of = |parts: &[(f32, f32)]| pieces(&spoken(parts));
        let with_silence = pieces_of(&[(20.0, 20.0), (4000.0, 5.0), (20.0, 20.0)]);
        let speech: Vec<&Piece> = with_silence.iter().filter(|p| p.speech).collect();
        assert!((1..=2).contains(&speech.len()), "{with_silence:?}");
        assert!(speech.iter().any(|p| p.from <= 2250 && p.to >= 2250));
        let without_pauses = pieces_of(&[(4000.0, 30.0)]);
        assert!(without_pauses.len() >= 4 && without_pauses.iter().all(|p| p.speech && p.to - p.from <= 800));
        assert!(pieces_of(&[(3.0, 30.0)]).iter().all(|p| !p.speech));
        assert!(pieces(&[]).is_empty());
    }
}
