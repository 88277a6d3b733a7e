//! `lipstream align`: when each word and phone of a known text is said.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use rayon::prelude::*;
use serde::Serialize;

use lipstream::time;
use lipstream_make::align::score::{Errors, Summary, table};
use lipstream_make::align::write::Format;
use lipstream_make::align::{Aligner, Alignment, AudioHmm};
use lipstream_make::corpus::discover;
use lipstream_make::corpus::labels;
use lipstream_make::corpus::pronounce::Pronouncer;
use lipstream_make::features::{Clip, FeatureFolder, PhoneLabel, Split, Word};

use super::choices;
use super::streams::{is_standard, name, read_sound, write};

/// Find when each word and phone of a known text is said
///
/// Takes sound files, a corpus, or a feature folder. The text of a sound is in --transcript or in a label file of the same
/// name beside it: .txt (plain), .lab, .TextGrid, .align, .wrd; times in it are not looked at. With --score the borders
/// that are found are compared with the labels'.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound files, or one folder; - is a sound on standard input
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Model: of `lipstream train`, best with --sound-only
    #[arg(short, long, value_name = "MODEL.safetensors")]
    model: PathBuf,
    /// Text of the one sound file
    #[arg(short, long, value_name = "FILE")]
    transcript: Option<PathBuf>,
    /// File for one sound, else folder; - is standard output
    #[arg(short, long, value_name = "OUT", required_unless_present = "score")]
    output: Option<PathBuf>,
    /// Format [default: by OUT's extension, else textgrid]
    #[arg(long)]
    format: Option<choices::Labels>,
    /// Pronunciations that come before the built-in ones: lines `name  N EY1 M`, variants as `name(2)  N AE1 M`
    #[arg(long, value_name = "FILE")]
    dictionary: Option<PathBuf>,
    /// Only clips of this split of a feature folder
    #[arg(long)]
    split: Option<choices::Split>,
    /// Only clips of these speakers, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    speakers: Vec<String>,
    /// Print how far the borders are from the labels
    #[arg(long)]
    score: bool,
    /// Print the score as JSON
    #[arg(long, requires = "score")]
    json: bool,
}

/// One sound to align.
struct Job {
    clip: Clip,
    sound: PathBuf,
    /// What came on standard input, which can be read only once.
    samples: Option<Vec<i16>>,
}

impl Job {
    fn samples(&self) -> Result<Vec<i16>> {
        match &self.samples {
            Some(samples) => Ok(samples.clone()),
            None => read_sound(&self.sound),
        }
    }
}

#[derive(Serialize)]
struct Scores {
    clips: usize,
    words: Option<Summary>,
    phones: Option<Summary>,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let hmm = AudioHmm::read(&args.model)?;
    let aligner = Aligner::new(&hmm);
    let mut jobs = jobs(&args)?;
    if !args.speakers.is_empty() {
        jobs.retain(|j| args.speakers.contains(&j.clip.speaker));
    }
    if jobs.is_empty() {
        bail!("no clips to align");
    }
    let format = match (args.format.map(Format::from), &args.output) {
        (Some(format), _) => format,
        (None, Some(out)) => extension(out)
            .and_then(|e| Format::of_extension(&e))
            .unwrap_or(Format::Textgrid),
        (None, None) => Format::Textgrid,
    };
    let to_file = match &args.output {
        Some(out) if is_standard(out) => {
            if jobs.len() > 1 {
                bail!(
                    "standard output takes one alignment, but there are {} clips: give a folder",
                    jobs.len()
                );
            }
            if format == Format::Phn {
                bail!(
                    "the words of .phn are in a file of their own: give a file's name, or another --format"
                );
            }
            true
        }
        Some(out) => {
            let known = extension(out).and_then(|e| Format::of_extension(&e));
            if known.is_some() && jobs.len() > 1 {
                bail!(
                    "{} is one file, but there are {} clips: give a folder and --format",
                    out.display(),
                    jobs.len()
                );
            }
            known.is_some()
        }
        None => false,
    };
    let results: Vec<Result<(Errors, Errors)>> = jobs
        .par_iter()
        .map(|job| {
            one(job, &aligner, &args, format, to_file)
                .with_context(|| format!("cannot align {}", name(&job.sound)))
        })
        .collect();
    let (mut words, mut phones, mut failed) = (Errors::default(), Errors::default(), 0);
    let mut last = None;
    for result in results {
        match result {
            Ok((w, p)) => {
                words.merge(w);
                phones.merge(p);
            }
            Err(error) => {
                failed += 1;
                if jobs.len() > 1 {
                    eprintln!("skipped: {error:#}");
                }
                last = Some(error);
            }
        }
    }
    if let (Some(error), 1) = (last, jobs.len()) {
        return Err(error);
    }
    if args.score {
        report(&args, jobs.len() - failed, &words, &phones)?;
    }
    if let Some(out) = args.output.as_ref().filter(|out| !is_standard(out)) {
        eprintln!("aligned {} clips into {}", jobs.len() - failed, out.display());
    }
    if failed > 0 {
        bail!("{failed} of {} clips could not be aligned", jobs.len());
    }
    Ok(())
}

fn report(args: &Args, clips: usize, words: &Errors, phones: &Errors) -> Result<()> {
    let scores = Scores {
        clips,
        words: words.summary(),
        phones: phones.summary(),
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&scores)?);
        return Ok(());
    }
    let mut rows = Vec::new();
    rows.extend(scores.words.map(|s| ("words, from the transcript", s)));
    rows.extend(scores.phones.map(|s| ("phones, from their order", s)));
    if rows.is_empty() {
        bail!("nothing to compare with: these clips have no labels with times");
    }
    println!("{clips} clips\n\n{}", table(&rows));
    Ok(())
}

fn one(job: &Job, aligner: &Aligner, args: &Args, format: Format, to_file: bool) -> Result<(Errors, Errors)> {
    let samples = job.samples()?;
    let clip = &job.clip;
    // Labels without words: their phones are the text.
    let said: Alignment = if clip.words.is_empty() {
        aligner.phones(&samples, &clip.phones)?
    } else {
        aligner.words(&samples, &clip.words)?
    };
    if let Some(out) = args.output.as_deref().filter(|out| is_standard(out)) {
        let text = format.text(&said)?;
        write(out, |file| Ok(file.write_all(&text)?))?;
    } else if let Some(out) = &args.output {
        let path = if to_file {
            out.clone()
        } else {
            out.join(format!("{}.{}", clip.id, format.extension()))
        };
        format.write(&path, &said)?;
    }
    let (mut words, mut phones) = (Errors::default(), Errors::default());
    if args.score {
        if clip.words.iter().all(|w| w.time.is_some()) {
            words.add_words(clip, &said);
        }
        if !clip.phones.is_empty() {
            phones.add_phones(clip, &aligner.phones(&samples, &clip.phones)?);
        }
    }
    Ok((words, phones))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_lowercase())
}

fn jobs(args: &Args) -> Result<Vec<Job>> {
    if let [folder] = args.inputs.as_slice()
        && folder.is_dir()
    {
        if args.transcript.is_some() {
            bail!(
                "--transcript is the text of one sound file, and {} is a folder",
                folder.display()
            );
        }
        if folder.join("manifest.json").is_file() {
            return from_features(args, folder);
        }
        let pronouncer = Pronouncer::new(args.dictionary.as_deref())?;
        let found = discover::discover(folder, None, &discover::Options::default())?;
        return found
            .clips
            .iter()
            .map(|c| job(&c.id, &c.speaker, c.sound_path(), &c.labels, &pronouncer))
            .collect();
    }
    let pronouncer = Pronouncer::new(args.dictionary.as_deref())?;
    if args.transcript.is_some() && args.inputs.len() > 1 {
        bail!(
            "--transcript is the text of one sound file, and there are {}: put each text beside its sound as .txt",
            args.inputs.len()
        );
    }
    args.inputs
        .iter()
        .map(|sound| {
            if sound.is_dir() {
                bail!("{} is a folder: give one folder, or sound files", sound.display());
            }
            let texts: Vec<PathBuf> = match &args.transcript {
                Some(text) => vec![text.clone()],
                None if is_standard(sound) => Vec::new(),
                None => beside(sound),
            };
            if texts.is_empty() && is_standard(sound) {
                bail!("standard input has no text beside it: give --transcript");
            }
            if texts.is_empty() {
                bail!(
                    "{} has no text: give --transcript, or put it beside the sound as {}",
                    sound.display(),
                    sound.with_extension("txt").display()
                );
            }
            let id = match is_standard(sound) {
                true => "stdin".into(),
                false => sound.file_stem().unwrap_or_default().to_string_lossy(),
            };
            job(&id, "", sound, &texts, &pronouncer)
        })
        .collect()
}

/// Label files of the same name.
fn beside(sound: &Path) -> Vec<PathBuf> {
    let folder = match sound.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let Ok(entries) = std::fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut out: Vec<PathBuf> = entries
        .filter_map(|e| Some(e.ok()?.path()))
        .filter(|p| p.file_stem() == sound.file_stem())
        .filter(|p| extension(p).is_some_and(|e| labels::EXTENSIONS.contains(&e.as_str())))
        .collect();
    out.sort();
    out
}

fn job(id: &str, speaker: &str, sound: &Path, texts: &[PathBuf], pronouncer: &Pronouncer) -> Result<Job> {
    let samples = read_sound(sound)?;
    let seconds = time::seconds(samples.len());
    let labels = labels::read(texts, seconds)?;
    let words: Vec<Word> = labels
        .words
        .iter()
        .map(|word| Ok(pronouncer.spoken(word)?.0))
        .collect::<Result<_>>()
        .with_context(|| format!("the text of {}", name(sound)))?;
    let phones: Vec<PhoneLabel> = labels
        .phones
        .iter()
        .map(|(start, end, phone)| PhoneLabel {
            phone: phone.name().to_owned(),
            start: *start as f32,
            end: *end as f32,
        })
        .collect();
    if words.is_empty() && phones.is_empty() {
        bail!("{}: no words in {}", name(sound), texts[0].display());
    }
    Ok(Job {
        sound: sound.to_owned(),
        samples: is_standard(sound).then_some(samples),
        clip: Clip {
            id: id.to_owned(),
            speaker: speaker.to_owned(),
            split: Split::Test,
            audio_frames: 0,
            video_frames: 0,
            video_hz: 0.0,
            words,
            phones,
        },
    })
}

fn from_features(args: &Args, root: &Path) -> Result<Vec<Job>> {
    if args.dictionary.is_some() {
        bail!(
            "{} holds its pronunciations already: give --dictionary to `lipstream prepare`",
            root.display()
        );
    }
    let folder = FeatureFolder::open(root)?;
    Ok(folder
        .manifest
        .clips
        .iter()
        .filter(|c| args.split.is_none_or(|s| c.split == s.into()))
        .filter(|c| !(c.words.is_empty() && c.phones.is_empty()))
        .map(|c| Job {
            clip: c.clone(),
            samples: None,
            sound: folder.wav_path(&c.id),
        })
        .collect())
}
