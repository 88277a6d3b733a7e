//! `lipstream align`: when each word and phone of a known text is said, or which phones are said where there is no text.
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use rayon::prelude::*;
use serde::Serialize;

use lipstream::time;
use lipstream_make::align::fit::Fit;
use lipstream_make::align::judge::{self, Judged, Judgement};
use lipstream_make::align::recognise::RecognitionSettings;
use lipstream_make::align::score::{Errors, Summary, table};
use lipstream_make::align::write::Format;
use lipstream_make::align::{Aligner, Alignment, AudioHmm, Recogniser};
use lipstream_make::corpus::discover;
use lipstream_make::corpus::labels;
use lipstream_make::corpus::pronounce::Pronouncer;
use lipstream_make::features::{Clip, FeatureFolder, PhoneLabel, PhonesFrom, Split, Word};

use super::choices;
use super::streams::{is_standard, keep_apart, name, read_sound, write};

/// Find when each word and phone of a known text is said
///
/// Takes sound files, a corpus, or a feature folder. The text of a sound is in --transcript or in a label file of the same
/// name beside it: .txt (plain), .lab, .TextGrid, .align, .wrd; times in it are not looked at. With --recognise no text is
/// needed: the phones are those that are heard. With --score what is found is compared with the labels.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Sound files, or one folder; - is a sound on standard input
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Model: of `lipstream train`, best with --sound-only [default: the shipped one]
    #[arg(short, long, value_name = "MODEL.safetensors")]
    model: Option<PathBuf>,
    /// Text of the one sound file
    #[arg(short, long, value_name = "FILE")]
    transcript: Option<PathBuf>,
    /// Find phones without a text
    #[arg(long, conflicts_with = "transcript")]
    recognise: bool,
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
    /// Print how far what is found is from the labels
    #[arg(long)]
    score: bool,
    /// Labels to compare phones with instead of the clips' own: lines `clip start end phone`, in samples at 16 kHz
    #[arg(long, value_name = "TABLE", requires = "score")]
    against: Option<PathBuf>,
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
    /// Files with its text, which nothing may be written onto: somebody may have labelled them by hand.
    texts: Vec<PathBuf>,
}

impl Job {
    fn samples(&self) -> Result<Vec<i16>> {
        match &self.samples {
            Some(samples) => Ok(samples.clone()),
            None => read_sound(&self.sound),
        }
    }
}

/// What listens, and what its phones are compared with.
struct Ears {
    aligner: Aligner,
    /// Where phones are found without a text.
    recogniser: Option<Recogniser>,
    /// Hears whether a text is said. The margins by which that is judged are the shipped model's, so others have none.
    judge: Option<Recogniser>,
    /// Phones by clip, in place of the clips' own.
    against: Option<HashMap<String, Vec<PhoneLabel>>>,
}

impl Ears {
    fn new(args: &Args) -> Result<Self> {
        let hmm = match &args.model {
            Some(path) => AudioHmm::read(path)?,
            None => AudioHmm::shipped()?,
        };
        Ok(Self {
            judge: match args.model.is_none() && !args.recognise {
                true => Some(Recogniser::shipped()?),
                false => None,
            },
            recogniser: args
                .recognise
                .then(|| Recogniser::new(hmm.clone(), RecognitionSettings::default())),
            aligner: Aligner::new(hmm),
            against: args.against.as_deref().map(labels::read_table).transpose()?,
        })
    }

    /// The phones that a clip's are compared with; none where nobody labelled it.
    fn labels<'a>(&'a self, clip: &'a Clip) -> &'a [PhoneLabel] {
        match &self.against {
            Some(table) => table.get(&clip.id).map_or(&[], Vec::as_slice),
            None => clip.labelled_phones(),
        }
    }
}

/// What was compared with labels.
#[derive(Default)]
struct Compared {
    words: Errors,
    phones: Errors,
    aligned: Judgement,
    recognised: Judgement,
}

impl Compared {
    fn merge(&mut self, other: Self) {
        self.words.merge(other.words);
        self.phones.merge(other.phones);
        self.aligned.merge(other.aligned);
        self.recognised.merge(other.recognised);
    }
}

#[derive(Serialize)]
struct Scores {
    clips: usize,
    words: Option<Summary>,
    phones: Option<Summary>,
    aligned: Option<Judged>,
    recognised: Option<Judged>,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let ears = Ears::new(&args)?;
    let found = jobs(&args)?;
    let (mut jobs, mut failed, alone) = (Vec::new(), 0, found.len() == 1);
    for job in found {
        match job {
            Ok(job) => jobs.push(job),
            Err(error) if alone => return Err(error),
            Err(error) => {
                failed += 1;
                eprintln!("skipped: {error:#}");
            }
        }
    }
    if !args.speakers.is_empty() {
        jobs.retain(|j| args.speakers.contains(&j.clip.speaker));
    }
    if jobs.is_empty() {
        bail!("no clips to align");
    }
    let all = jobs.len() + failed;
    let format = match (args.format.map(Format::from), &args.output) {
        (Some(format), _) => format,
        (None, Some(out)) => extension(out)
            .and_then(|e| Format::of_extension(&e))
            .unwrap_or(Format::Textgrid),
        (None, None) => Format::Textgrid,
    };
    let to_file = match &args.output {
        Some(out) if is_standard(out) => {
            if all > 1 {
                bail!(
                    "standard output takes one alignment, but there are {} clips: give a folder",
                    all
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
            if known.is_some() && all > 1 {
                bail!(
                    "{} is one file, but there are {} clips: give a folder and --format",
                    out.display(),
                    all
                );
            }
            // A slash behind the name, or a folder that is there, says that one is meant.
            let folder = out.is_dir() || out.as_os_str().as_encoded_bytes().ends_with(b"/");
            if known.is_none() && !folder && extension(out).is_some() {
                bail!(
                    "{}: write .lab, .TextGrid, .phn or .json; a folder with a dot in its name ends in /",
                    out.display()
                );
            }
            known.is_some()
        }
        None => false,
    };
    let results: Vec<Result<Compared>> = jobs
        .par_iter()
        .map(|job| {
            one(job, &ears, &args, format, to_file)
                .with_context(|| format!("cannot align {}", name(&job.sound)))
        })
        .collect();
    let mut compared = Compared::default();
    let mut last = None;
    for result in results {
        match result {
            Ok(of) => compared.merge(of),
            Err(error) => {
                failed += 1;
                if all > 1 {
                    eprintln!("skipped: {error:#}");
                }
                last = Some(error);
            }
        }
    }
    if let (Some(error), 1) = (last, all) {
        return Err(error);
    }
    if args.score {
        report(&args, all - failed, &compared)?;
    }
    if let Some(out) = args.output.as_ref().filter(|out| !is_standard(out)) {
        let found = if args.recognise { "recognised" } else { "aligned" };
        crate::progress::say(&format!("{found} {} clips into {}", all - failed, out.display()));
    }
    if failed > 0 {
        bail!("{failed} of {} clips could not be aligned", all);
    }
    Ok(())
}

fn report(args: &Args, clips: usize, compared: &Compared) -> Result<()> {
    let scores = Scores {
        clips,
        words: compared.words.summary(),
        phones: compared.phones.summary(),
        aligned: compared.aligned.summary(),
        recognised: compared.recognised.summary(),
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&scores)?);
        return Ok(());
    }
    let mut borders = Vec::new();
    borders.extend(scores.words.map(|s| ("words, from the transcript", s)));
    borders.extend(scores.phones.map(|s| ("phones, from their order", s)));
    let mut phones = Vec::new();
    phones.extend(scores.aligned.map(|s| ("from the transcript", s)));
    phones.extend(scores.recognised.map(|s| ("recognised", s)));
    if borders.is_empty() && phones.is_empty() {
        bail!("nothing to compare with: these clips have no labels with times");
    }
    println!("{clips} clips");
    if !borders.is_empty() {
        println!("\n{}", table(&borders));
    }
    if !phones.is_empty() {
        println!("\n{}", judge::table(&phones));
    }
    Ok(())
}

fn one(job: &Job, ears: &Ears, args: &Args, format: Format, to_file: bool) -> Result<Compared> {
    let samples = job.samples()?;
    let clip = &job.clip;
    let heard = ears
        .recogniser
        .as_ref()
        .map(|r| r.recognise(&samples))
        .transpose()?;
    // With the recogniser's, the transcript's alignment is wanted for comparison only.
    let from_words = match clip.words.is_empty() || (heard.is_some() && !args.score) {
        true => None,
        false => Some(ears.aligner.words(&samples, &clip.words)?),
    };
    if let (Some(judge), Some(said)) = (&ears.judge, &from_words)
        && let Some(fit) = Fit::of(said, &judge.recognise(&samples)?)
        && !fit.says()
    {
        eprintln!(
            "warning: the words of {} do not fit what is heard ({fit})",
            name(&job.sound)
        );
    }
    let from_phones = match from_words.is_none() && heard.is_none() {
        // Labels without words: their phones are the text.
        true => Some(ears.aligner.phones(&samples, &clip.phones)?),
        false => None,
    };
    let said = heard.as_ref().or(from_words.as_ref()).or(from_phones.as_ref());
    if let (Some(out), Some(said)) = (&args.output, said) {
        // Who names one file for what is heard says that it may go.
        let kept = match heard.is_some() && to_file {
            true => &[][..],
            false => &job.texts,
        };
        let read = kept.iter().chain([&job.sound]);
        put(said, out, (&clip.id, read), format, to_file)?;
    }
    let mut compared = Compared::default();
    if args.score {
        compare(
            &mut compared,
            ears,
            job,
            &samples,
            (from_words.as_ref(), heard.as_ref()),
        )?;
    }
    Ok(compared)
}

/// Writes what was found, and not onto a file of `read`.
fn put<'p>(
    said: &Alignment,
    out: &Path,
    (id, read): (&str, impl Iterator<Item = &'p PathBuf>),
    format: Format,
    to_file: bool,
) -> Result<()> {
    if is_standard(out) {
        let text = format.text(said)?;
        return write(out, |file| Ok(file.write_all(&text)?));
    }
    let path = match to_file {
        true => out.to_owned(),
        false => out.join(format!("{id}.{}", format.extension())),
    };
    keep_apart(&path, read.map(PathBuf::as_path))?;
    Ok(format.write(&path, said)?)
}

/// Compares what the transcript and the recogniser gave with the labels.
fn compare(
    compared: &mut Compared,
    ears: &Ears,
    job: &Job,
    samples: &[i16],
    (from_words, heard): (Option<&Alignment>, Option<&Alignment>),
) -> Result<()> {
    let clip = &job.clip;
    let labels = ears.labels(clip);
    if let Some(said) = from_words {
        if clip.words.iter().all(|w| w.time.is_some()) {
            compared.words.add_words(clip, said);
        }
        if !labels.is_empty() {
            compared.aligned.add(labels, said);
        }
    }
    match heard {
        Some(heard) if !labels.is_empty() => compared.recognised.add(labels, heard),
        None if !clip.labelled_phones().is_empty() => {
            let found = ears.aligner.phones(samples, &clip.phones)?;
            compared.phones.add_phones(clip, &found);
        }
        _ => {}
    }
    Ok(())
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_str()?.to_lowercase())
}

/// What is to be aligned, of each sound; the error of one that cannot be names it.
fn jobs(args: &Args) -> Result<Vec<Result<Job>>> {
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
            return Ok(from_features(args, folder)?.into_iter().map(Ok).collect());
        }
        let pronouncer = Pronouncer::new(args.dictionary.as_deref())?;
        let found = discover::discover(folder, None, &discover::Options::default())?;
        return Ok(found
            .clips
            .iter()
            .map(|c| job(args, (&c.id, &c.speaker), c.sound_path(), &c.labels, &pronouncer))
            .collect());
    }
    let pronouncer = Pronouncer::new(args.dictionary.as_deref())?;
    if args.transcript.is_some() && args.inputs.len() > 1 {
        bail!(
            "--transcript is the text of one sound file, and there are {}: put each text beside its sound as .txt",
            args.inputs.len()
        );
    }
    let jobs = args
        .inputs
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
            if texts.is_empty() && is_standard(sound) && !args.recognise {
                bail!("standard input has no text beside it: give --transcript");
            }
            if texts.is_empty() && !args.recognise {
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
            job(args, (&id, ""), sound, &texts, &pronouncer)
        })
        .collect();
    Ok(jobs)
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

fn job(
    args: &Args,
    (id, speaker): (&str, &str),
    sound: &Path,
    texts: &[PathBuf],
    pronouncer: &Pronouncer,
) -> Result<Job> {
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
    if words.is_empty() && phones.is_empty() && !args.recognise {
        let Some(text) = texts.first() else {
            bail!("{} has no text beside it", name(sound));
        };
        bail!("{}: no words in {}", name(sound), text.display());
    }
    Ok(Job {
        sound: sound.to_owned(),
        samples: is_standard(sound).then_some(samples),
        texts: texts.to_vec(),
        clip: Clip {
            id: id.to_owned(),
            speaker: speaker.to_owned(),
            split: Split::Test,
            audio_frames: 0,
            video_frames: 0,
            phones_from: PhonesFrom::Labels,
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
        .filter(|c| args.recognise || c.is_labelled())
        .map(|c| Job {
            clip: c.clone(),
            samples: None,
            texts: Vec::new(),
            sound: folder.wav_path(&c.id),
        })
        .collect())
}
