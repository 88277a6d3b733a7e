//! `lipstream check`: whether videos are fit to be trained on.
use std::path::{Path, PathBuf};

use anyhow::Result;
use lipstream_make::check::{self, CheckSettings, Grade, Report};
use lipstream_make::corpus::discover::{ClipFiles, Options, discover};
use lipstream_make::error::chain;

use super::streams;
use crate::progress::Terminal;

/// Say whether videos are fit to be trained on, and what to do about it
///
/// Looks at light, framing and sharpness, listens to level and noise, estimates by how much sound and picture are apart, whether the mouth is the
/// speaker's and how still it is in pauses, and counts the phones of a transcript beside the video (.srt, .vtt or labels as for `prepare`).
/// `lipstream prompts` has sentences with every sound of English. docs/check.md says what each figure means. The exit code is 0 when every
/// video could be checked, whatever the verdict; the verdict is in the text, and `overall` in the JSON.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Videos, or folders of them
    #[arg(required = true, value_name = "VIDEO")]
    videos: Vec<PathBuf>,
    /// Seconds of pictures to look at in each video, spread over it; its sound is heard whole
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u16).range(1..=3600))]
    look: u16,
    /// Print a JSON array of reports instead of words
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let mut videos = Vec::new();
    for path in &args.videos {
        videos.extend(videos_of(path)?);
    }
    let settings = CheckSettings {
        look_s: args.look.into(),
    };
    let progress = Terminal::default();
    let (mut reports, mut failed) = (Vec::new(), Vec::new());
    let one = videos.len() == 1;
    for video in &videos {
        match check::check(video, &settings, &progress) {
            Ok(report) => {
                if !args.json {
                    print(&words(&report))?;
                }
                reports.push(report);
            }
            Err(error) if one => return Err(error.into()),
            Err(error) => failed.push(format!("{}: {}", video.display(), chain(&error))),
        }
    }
    if args.json {
        print(&(serde_json::to_string_pretty(&reports)? + "\n"))?;
    } else if !one {
        print(&summary(&reports))?;
    }
    anyhow::ensure!(
        failed.is_empty(),
        "{} of {} videos could not be checked: {}",
        failed.len(),
        videos.len(),
        failed.join("; ")
    );
    Ok(())
}

/// The clips of a folder that have a video; or the video that is given.
pub(super) fn clips_of(path: &Path) -> Result<Vec<ClipFiles>> {
    if !path.is_dir() {
        return Ok(vec![ClipFiles::of_video(path)]);
    }
    let found = discover(path, None, &Options::default())?.clips;
    let clips: Vec<ClipFiles> = found.into_iter().filter(|clip| clip.video.is_some()).collect();
    anyhow::ensure!(!clips.is_empty(), "{} holds no videos", path.display());
    Ok(clips)
}

/// The videos of a folder; or the one that is given.
pub(super) fn videos_of(path: &Path) -> Result<Vec<PathBuf>> {
    let clips = clips_of(path)?.into_iter();
    Ok(clips.filter_map(|clip| clip.video).collect())
}

fn print(text: &str) -> Result<()> {
    streams::write("-".as_ref(), |out| Ok(out.write_all(text.as_bytes())?))
}

fn word(grade: Option<Grade>) -> &'static str {
    match grade {
        Some(Grade::Good) => "good",
        Some(Grade::Usable) => "usable",
        Some(Grade::Bad) => "bad",
        None => "?",
    }
}

/// One report: a line for each verdict, what to do below it.
fn words(report: &Report) -> String {
    let (all, looked) = (report.sound.seconds, report.looked_seconds);
    let mut text = format!(
        "{} ({all:.0} s, pictures of {looked:.0} s looked at)\n",
        report.video
    );
    for verdict in &report.verdicts {
        text += &format!(
            "  {:<10}{:<8}{}\n",
            verdict.what,
            word(verdict.grade),
            verdict.found
        );
        if let Some(advice) = &verdict.advice {
            text += &format!("{:20}→ {advice}\n", "");
        }
    }
    text + &format!("  {:<10}{}\n", "overall", word(Some(report.overall)))
}

/// How many of several videos are how good.
fn summary(reports: &[Report]) -> String {
    let count = |grade| reports.iter().filter(|report| report.overall == grade).count();
    let speech: f64 = reports.iter().map(|report| report.sound.speech_seconds).sum();
    format!(
        "{} videos, {speech:.0} s of speech: {} good, {} usable, {} bad\n",
        reports.len(),
        count(Grade::Good),
        count(Grade::Usable),
        count(Grade::Bad)
    )
}
