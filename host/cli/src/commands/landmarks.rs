//! `lipstream landmarks`: the points of a face in every picture of a video, from a few that are labelled.
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use lipstream::progress::Progress as _;
use lipstream_make::corpus::discover::ClipFiles;
use lipstream_make::hierarchical::Landmarks;
use lipstream_make::landmarks::import::{self, How};
use lipstream_make::landmarks::{Labels, label};
use serde::Serialize;

use super::check::clips_of;
use super::landmarks_page::{self, Told};
use super::streams;
use crate::progress::Terminal;

/// Pictures that are named when they are to be looked at; of more only the number is said.
const NAMED: usize = 20;

/// Find the points of a face in every picture of videos, from a few pictures that are labelled
///
/// An active shape model learns the labelled pictures, about 40 of them, of any number of points, and finds the points in all others; what it is unsure of is named. Labels come from
/// .pts files (iBUG), tables of OpenFace and MediaPipe (normalised: --size), or what this command writes. Without VIDEO the labels are only rewritten, as .npz or .csv. What comes out
/// is what `train --system hierarchical --landmarks` reads. docs/hierarchical.md has the forms, and how far points are off.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A video, or a folder of them
    video: Option<PathBuf>,
    /// Labelled pictures: .pts, .csv, .npz or folders of them
    #[arg(long, value_name = "FILE", required = true, num_args = 1..)]
    labelled: Vec<PathBuf>,
    /// Landmarks of every picture: .npz, or .csv to be looked at and corrected
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Number of a clip's first picture in names of .pts and in MediaPipe's column frame
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=1))]
    first_picture: u8,
    /// Size of the video in pixels, for labels in shares of it (MediaPipe)
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Serve a page on which points can be dragged: it shows the least sure picture, learns what is accepted and shows the next. The table gets all labels, old and new
    #[arg(long, value_name = "LABELS.csv", requires = "video")]
    page: Option<PathBuf>,
    /// Port of the page; 0 is any
    #[arg(long, default_value_t = 7341, requires = "page")]
    port: u16,
    /// Print what was found as JSON, on standard output
    #[arg(long)]
    json: bool,
}

/// What `--json` prints.
#[derive(Debug, Serialize)]
pub(super) struct Report {
    output: PathBuf,
    clips: usize,
    pictures: usize,
    /// Pictures that have points.
    with_points: usize,
    /// Pictures whose points were given.
    labelled: usize,
    /// Median distance that may be expected of a point, in shares of the face's width; null where nothing says it.
    expected_error: Option<f32>,
    /// Pictures that are to be looked at.
    unsure: Vec<Unsure>,
}

#[derive(Debug, Serialize)]
struct Unsure {
    clip: String,
    /// Counted from 0.
    picture: usize,
    confidence: f32,
}

impl Report {
    pub(super) fn new(
        labels: &Labels,
        labelled: &Landmarks,
        expected_error: Option<f32>,
        output: &Path,
    ) -> Self {
        let (unsure, without) = labels.unsure();
        let pictures = labels.landmarks.pictures();
        let unsure = unsure.into_iter().flat_map(|(clip, pictures)| {
            pictures.into_iter().map(move |picture| Unsure {
                clip: clip.to_owned(),
                picture,
                confidence: labels.confidence(clip)[picture],
            })
        });
        Self {
            output: output.to_owned(),
            clips: labels.landmarks.clips().count(),
            pictures,
            with_points: pictures - without,
            labelled: labelled.labelled().len(),
            expected_error,
            unsure: unsure.collect(),
        }
    }
}

/// A size such as 1280x720.
fn size(words: &str) -> Result<(usize, usize), String> {
    let number = |digits: &str| digits.parse().ok().filter(|n| *n > 0);
    words
        .split_once('x')
        .and_then(|(width, height)| Some((number(width)?, number(height)?)))
        .ok_or_else(|| "write width and height in pixels, such as 1280x720".to_owned())
}

pub(crate) fn run(args: Args) -> Result<()> {
    // Refused before the work, not after it.
    label::form(&args.output)?;
    let read = args.labelled.iter().chain(&args.video);
    streams::keep_apart(&args.output, read.map(PathBuf::as_path))?;
    let clips = args.video.as_deref().map(clips_of).transpose()?;
    let how = How {
        first_picture: args.first_picture.into(),
        size: args.size,
        clip: match clips.as_deref() {
            Some([only]) => Some(only.id.clone()),
            _ => None,
        },
    };
    let labelled = import::read(&args.labelled, &how)?;
    let report = match (clips, &args.page) {
        (Some(clips), Some(table)) => {
            landmarks_page::keeps(table, &args.labelled, &args.output)?;
            let told = Told {
                port: args.port,
                keep_standard_output: args.json,
            };
            landmarks_page::run(clips, labelled, table, &args.output, &told)?
        }
        (Some(clips), None) => {
            let (labels, expected) = found(&clips, &labelled)?;
            labels.write(&args.output)?;
            Report::new(&labels, &labelled, expected, &args.output)
        }
        (None, _) => {
            let labels = Labels::known(labelled);
            labels.write(&args.output)?;
            Report::new(&labels, &labels.landmarks, None, &args.output)
        }
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    }
    Ok(())
}

/// What a model of the labels finds, and what may be expected of it.
fn found(clips: &[ClipFiles], labelled: &Landmarks) -> Result<(Labels, Option<f32>)> {
    let terminal = Terminal::default();
    let labeller = label::learn(clips, labelled, &terminal)?;
    let by_hand = labelled.labelled().len();
    match labeller.expected() {
        Some(expected) => terminal.say(&format!(
            "{by_hand} labelled pictures; one that the others know nothing of is found with a median error of {:.2} % of the face's width",
            100.0 * expected
        )),
        None => terminal.say("1 labelled picture: nothing says how far points will be off; label more"),
    }
    let labels = label::label(clips, labelled, &labeller, &terminal)?;
    summary(&labels, &terminal)?;
    Ok((labels, labeller.expected()))
}

/// Says what was found, and which pictures are to be looked at.
///
/// # Errors
///
/// That there is no face at all.
pub(super) fn summary(labels: &Labels, terminal: &Terminal) -> Result<()> {
    let all = labels.landmarks.pictures();
    let (unsure, lost) = labels.unsure();
    let doubtful: usize = unsure.values().map(Vec::len).sum();
    if lost == all {
        bail!("no picture has a face that looks like the labelled ones: label pictures of these videos");
    }
    terminal.say(&format!(
        "{all} pictures of {} clips: {} found, {doubtful} of them unsure; {lost} without a face",
        labels.landmarks.clips().count(),
        all - lost
    ));
    let pictures = unsure
        .iter()
        .flat_map(|(clip, pictures)| pictures.iter().map(move |picture| format!("{clip} {picture}")));
    let named: Vec<String> = pictures.take(NAMED).collect();
    if doubtful > 0 {
        terminal.warn(&format!(
            "look at these pictures, counted from 0, and label some of them: {}{}",
            named.join(", "),
            match doubtful > NAMED {
                true => ", …",
                false => "",
            }
        ));
    }
    Ok(())
}
