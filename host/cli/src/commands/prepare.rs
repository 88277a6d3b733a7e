//! `lipstream prepare`: a corpus to features and eigenmouths.
use std::path::PathBuf;

use anyhow::Result;

use crate::progress::Terminal;
use lipstream_make::corpus::discover::Options;
use lipstream_make::corpus::summary::SplitSummary;
use lipstream_make::corpus::{self, Hearing, PrepareSettings, Summary};

/// Turn video, sound and labels into features and eigenmouths
///
/// A clip is a video or WAV file with its labels beside it, under the same name: .align (GRID), .phn and .wrd
/// (TIMIT), .lab (HTK), .TextGrid (Praat) or .txt (a plain transcript). Folders called train, val and test are
/// splits; other folders are speakers; clips without either are each their own speaker. Where no folder says so,
/// speakers are dealt out by their names: a tenth for the test, a tenth for validation. No transcript is needed:
/// a clip without labels gets the phones that are heard in it, a transcript without times is aligned with its
/// sound. An interrupted run continues when it is started again. DIR/sheet.png shows mouths of every clip.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder of the corpus, or one video of somebody who speaks: it is cut between its subtitles (.srt or
    /// .vtt beside it), or at its pauses, with its words (.txt beside it) spread over the pieces
    corpus: PathBuf,
    /// Folder for the features; new, or from an earlier run
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Pronunciations that come before the built-in ones: lines `name  N EY1 M`, variants as `name(2)  N AE1 M`
    #[arg(long, value_name = "FILE")]
    dictionary: Option<PathBuf>,
    /// Model that hears the phones of clips without labels, any that `lipstream align` takes [default: the shipped one]
    #[arg(long, value_name = "MODEL.safetensors")]
    hear_with: Option<PathBuf>,
    /// Hear no phones: clips without labels with times get none
    #[arg(long, conflicts_with = "hear_with")]
    labels_only: bool,
    /// Speakers for the test, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    test_speakers: Vec<String>,
    /// Speakers for validation, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    val_speakers: Vec<String>,
    /// Every clip is for training
    #[arg(long, conflicts_with_all = ["test_speakers", "val_speakers"])]
    all_train: bool,
    /// All clips are of one speaker
    #[arg(long, conflicts_with_all = ["test_speakers", "val_speakers"])]
    one_speaker: bool,
    /// Leave the pictures of videos alone
    #[arg(long)]
    audio_only: bool,
    /// Measure how open and wide the lips are, by landmarks, in place of mouths and eigenmouths: for `train --train mge --watched`
    #[arg(long, conflicts_with_all = ["audio_only", "by_channel", "keep_clip_mean", "overlay"])]
    lips: bool,
    /// Eigenmouths to keep
    #[arg(long, value_name = "N", default_value_t = 30, value_parser = clap::value_parser!(u16).range(1..=1000))]
    eigenmouths: u16,
    /// So many eigenmouths of each colour, as in the paper, instead of joint ones: three times as many parameters
    #[arg(long, conflicts_with = "audio_only")]
    by_channel: bool,
    /// Leave each clip's mean in its mouth weights
    #[arg(long)]
    keep_clip_mean: bool,
    /// Write a film of every clip with the mouth's rectangle and the lips drawn on it, DIR/overlay/CLIP.mp4
    #[arg(long, conflicts_with = "audio_only")]
    overlay: bool,
    /// Milliseconds by which the sound is late against the pictures (negative: early); 0 leaves it where it is [default: what
    /// `lipstream check` finds for each speaker, mended where that is sure and 30 ms or more]
    #[arg(long, value_name = "MS", allow_negative_numbers = true, value_parser = offset)]
    sync_offset: Option<f32>,
    /// Use nothing of an earlier run in the same folder
    #[arg(long)]
    fresh: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// An offset that is no slip of the hand.
fn offset(text: &str) -> Result<f32, String> {
    let ms: f32 = text
        .parse()
        .map_err(|_| "not a number of milliseconds".to_owned())?;
    match ms.abs() <= 5000.0 {
        true => Ok(ms),
        false => Err("more than five seconds".to_owned()),
    }
}

pub(crate) fn run(args: Args) -> Result<()> {
    let settings = PrepareSettings {
        corpus: args.corpus,
        out: args.output,
        clips: Options {
            val_speakers: args.val_speakers,
            test_speakers: args.test_speakers,
            all_train: args.all_train,
            one_speaker: args.one_speaker,
        },
        dictionary: args.dictionary,
        hearing: match (args.labels_only, args.hear_with) {
            (true, _) => Hearing::Nobody,
            (false, Some(model)) => Hearing::Model(model),
            (false, None) => Hearing::Shipped,
        },
        audio_only: args.audio_only,
        lips: args.lips,
        eigenmouths: args.eigenmouths.into(),
        by_channel: args.by_channel,
        keep_clip_mean: args.keep_clip_mean,
        overlay: args.overlay,
        sync_offset_ms: args.sync_offset,
        fresh: args.fresh,
    };
    let summary = corpus::prepare(&settings, &Terminal::default())?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print!("{}", words(&summary));
    }
    Ok(())
}

/// The summary in words.
fn words(s: &Summary) -> String {
    use std::fmt::Write;
    let mut out = String::new();
    // Writing to a String cannot fail.
    let mut line = |text: String| {
        let _ = writeln!(out, "{text}");
    };
    line(format!(
        "{}: features of {} (split by {})",
        s.folder, s.corpus, s.split_by
    ));
    line(format!(
        "{:>8} {:>7} {:>11} {:>9} {:>8} {:>7}",
        "split", "clips", "with video", "speakers", "minutes", "words"
    ));
    for (name, split) in [("train", &s.train), ("val", &s.val), ("test", &s.test)] {
        let SplitSummary {
            clips,
            with_video,
            speakers,
            seconds,
            words,
        } = split;
        line(format!(
            "{name:>8} {clips:>7} {with_video:>11} {speakers:>9} {:>8.1} {words:>7}",
            seconds / 60.0
        ));
    }
    if s.split_by == "speaker" && s.train.speakers == s.train.clips {
        line("Every clip counts as its own speaker; if they are one person's, say --one-speaker.".into());
    }
    match s.visual_size {
        0 => {}
        _ if s.lips => line("gap and width of the lips, by landmarks".into()),
        size => line(format!("{size} eigenmouths")),
    }
    if s.named_sentences > 0 {
        line(format!(
            "{} clips without labels: their GRID file names say what is spoken",
            s.named_sentences
        ));
    }
    if s.recognised > 0 {
        line(format!(
            "{} clips without labels: their phones are those that were heard",
            s.recognised
        ));
    }
    if s.aligned > 0 {
        line(format!("{} transcripts were aligned with their sound", s.aligned));
    }
    if s.unlabelled > 0 {
        line(format!(
            "{} clips have no labels: nothing tells their phones",
            s.unlabelled
        ));
    }
    if !s.words_by_rule.is_empty() {
        line(format!(
            "{} words are in no dictionary and pronounced by rule (check, or add them to --dictionary): {}",
            s.words_by_rule.len(),
            first(&s.words_by_rule)
        ));
    }
    line(format!(
        "phones in the training clips: {} of {}{}",
        s.phones.len(),
        s.phones.len() + s.phones_missing.len(),
        if s.phones_missing.is_empty() {
            String::new()
        } else {
            format!("; missing: {}", s.phones_missing.join(" "))
        }
    ));
    if !s.left_alone.is_empty() {
        line(format!(
            "{} files belong to no clip and were left alone: {}",
            s.left_alone.len(),
            first(&s.left_alone)
        ));
    }
    if s.skipped.is_empty() {
        line(format!("no clip was skipped; {:.1} s", s.seconds_taken));
    } else {
        line(format!(
            "{} clips were skipped, see above and `skipped` in manifest.json; {:.1} s",
            s.skipped.len(),
            s.seconds_taken
        ));
    }
    out
}

/// The first few of a list.
fn first(list: &[String]) -> String {
    let shown = list
        .iter()
        .take(8)
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(", ");
    if list.len() > 8 {
        format!("{shown}, ...")
    } else {
        shown
    }
}
