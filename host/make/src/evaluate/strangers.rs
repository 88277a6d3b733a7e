//! How well a model's mouth follows people whom no training saw, in whatever they say: its lip gap and width against landmarks of their videos.
//!
//! A correlation asks for no common scale. It is taken at lag 0, as the video's file puts sound and picture together, and at the lag at which it is
//! greatest: recordings of television and of video calls are off by a tenth of a second and more, which says nothing about the model. Beside the
//! model stands the loudness of the sound, which any flapping jaw can follow, and chance: the model's mouth against the next video's.
use std::path::{Path, PathBuf};

use lipstream::engine::{Engine, RunSettings};
use lipstream::opening::OpeningReader;
use lipstream::progress::Progress;
use lipstream::reference;
use lipstream::time::frame_at;
use lipstream_core::{HOP_SAMPLES, N_STATIC, SAMPLE_RATE_HZ};
use lipstream_media::sound as sound_files;
use lipstream_media::video::{self, Part};
use serde::Serialize;

use super::metrics::Score;
use crate::check::series;
use crate::check::watch;
use crate::corpus::lips::lips;
use crate::error::{Error, Result, bail};
use ndarray::Array2;

/// Lags that are tried, in milliseconds on either side, and their distance.
const FARTHEST_MS: i32 = 150;
const STEP_MS: i32 = 10;
/// Deviation of the Gaussian that smooths loudness, frames: as slow as a jaw.
const JAW_FRAMES: f32 = 4.0;
/// A video longer than this must be followed better than by its loudness.
pub const LONG_S: f32 = 10.0;
/// Seconds of a voice after which it counts as known.
pub const KNOWN_S: f32 = 30.0;

/// How well one video is followed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Followed {
    /// The video's file, without its folder.
    pub video: String,
    /// Its length.
    pub seconds: f32,
    /// Correlation of the lip gap at lag 0, by a stream that begins with the video.
    pub gap: f64,
    /// The same where the stream has heard 30 s of the voice before: the video's own sound, again and again.
    pub gap_known: f64,
    /// The greatest correlation of the gap within 150 ms, and how much later than the sound's the pictures' mouth is there (negative: earlier), ms.
    pub best: f64,
    /// See `best`.
    pub best_lag_ms: i32,
    /// Correlation of the distance of the lips' corners at lag 0.
    pub width: f64,
    /// Correlation of the gap with the smoothed level of the sound in dB, at lag 0.
    pub loudness: f64,
    /// Correlation of the gap with what the model says to the next video's sound; None where there is no other.
    pub chance: Option<f64>,
}

/// How well strangers are followed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Strangers {
    /// Every video.
    pub videos: Vec<Followed>,
    /// Videos that could not be used, and why.
    pub left_out: Vec<(String, String)>,
}

/// One video's mouth, and what is heard of it at the same times.
struct Observed {
    name: String,
    rate_hz: f32,
    gap: Vec<f32>,
    width: Vec<f32>,
    heard: Heard,
}

/// A frame each: what the model says, and how loud it is.
struct Heard {
    gap: Vec<f32>,
    gap_known: Vec<f32>,
    width: Vec<f32>,
    loudness: Vec<f32>,
}

/// Measures `engine`, whose mouth `reader` reads, on every one of the videos.
///
/// # Errors
///
/// That `ffmpeg` is not there, or that no video can be used.
pub fn strangers(
    videos: &[PathBuf],
    engine: &Engine,
    reader: &OpeningReader,
    progress: &dyn Progress,
) -> Result<Strangers> {
    video::available().map_err(Error::other)?;
    let (mut observed, mut left_out) = (Vec::new(), Vec::new());
    for path in videos {
        let name = path
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        match observe(path, &name, engine, reader, progress) {
            Ok(one) => observed.push(one),
            Err(why) => {
                progress.warn(&format!("{name} is left out: {}", crate::error::chain(&why)));
                left_out.push((name, crate::error::chain(&why)));
            }
        }
    }
    if observed.is_empty() {
        bail!(Data, "no video can be used of {}", videos.len());
    }
    let count = observed.len();
    let videos = observed.iter().enumerate().map(|(n, one)| {
        let next = &observed[(n + 1) % count];
        one.followed((count > 1).then_some(&next.heard.gap[..]))
    });
    Ok(Strangers {
        videos: videos.collect(),
        left_out,
    })
}

fn observe(
    path: &Path,
    name: &str,
    engine: &Engine,
    reader: &OpeningReader,
    progress: &dyn Progress,
) -> Result<Observed> {
    let facts = video::facts(path).map_err(Error::other)?;
    let bytes = video::decode_sound(path).map_err(Error::other)?;
    let samples = sound_files::decode(&bytes).map_err(Error::other)?.samples;
    let whole = Part {
        begins_s: 0.0,
        seconds: samples.len() as f64 / f64::from(SAMPLE_RATE_HZ),
    };
    let watched = watch::watch(path, facts, &[whole], progress)?;
    let Some(watched) = watched.into_iter().next() else {
        bail!(Data, "the video has no picture")
    };
    let [gap, width] = lips(&watched)?;
    Ok(Observed {
        name: name.to_owned(),
        rate_hz: watched.rate_hz,
        gap,
        width,
        heard: hear(&samples, engine, reader)?,
    })
}

fn hear(samples: &[i16], engine: &Engine, reader: &OpeningReader) -> Result<Heard> {
    let say = |samples: &[i16]| -> Result<Vec<_>> {
        let said = engine
            .convert(samples, &RunSettings::default())
            .map_err(Error::other)?;
        let rows = said.parameters.outer_iter();
        Ok(rows.map(|row| reader.read(&row.to_vec())).collect())
    };
    let said = say(samples)?;
    if said.is_empty() {
        bail!(Data, "the sound is too short for a frame");
    }
    // Whole hops, so that the frames of the last time are those of the first.
    let whole = samples.len() / HOP_SAMPLES * HOP_SAMPLES;
    let wanted = (KNOWN_S * SAMPLE_RATE_HZ as f32) as usize;
    let times = wanted.div_ceil(whole.max(1));
    let mut known = samples[..whole].repeat(times);
    known.extend_from_slice(samples);
    let gap_known = say(&known)?[times * whole / HOP_SAMPLES..].to_vec();
    let statics = reference::live_statics(samples);
    let energy: Vec<f32> = statics.column(N_STATIC - 1).iter().map(|e| *e as f32).collect();
    Ok(Heard {
        gap: said.iter().map(|opening| opening.gap).collect(),
        gap_known: gap_known.iter().map(|opening| opening.gap).collect(),
        width: said.iter().map(|opening| opening.width).collect(),
        loudness: series::smoothed(&energy, JAW_FRAMES),
    })
}

impl Observed {
    /// `series` of frames at the middle of every picture's time, as if the pictures were `late_ms` later than they are.
    fn at_pictures(&self, series: &[f32], late_ms: i32) -> Vec<f32> {
        let seconds = |k: usize| (k as f64 + 0.5) / f64::from(self.rate_hz) - f64::from(late_ms) * 1e-3;
        let at = |k: usize| series::at(series, frame_at(seconds(k)));
        (0..self.gap.len()).map(at).collect()
    }

    fn correlation(&self, truth: &[f32], series: &[f32], late_ms: i32) -> f64 {
        correlation(truth, &self.at_pictures(series, late_ms))
    }

    fn followed(&self, next: Option<&[f32]>) -> Followed {
        let lags = (-FARTHEST_MS..=FARTHEST_MS).step_by(STEP_MS as usize);
        let (best, best_lag_ms) = lags
            .map(|lag| (self.correlation(&self.gap, &self.heard.gap, lag), lag))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((0.0, 0));
        Followed {
            video: self.name.clone(),
            seconds: self.gap.len() as f32 / self.rate_hz,
            gap: self.correlation(&self.gap, &self.heard.gap, 0),
            gap_known: self.correlation(&self.gap, &self.heard.gap_known, 0),
            best,
            best_lag_ms,
            width: self.correlation(&self.width, &self.heard.width, 0),
            loudness: self.correlation(&self.gap, &self.heard.loudness, 0),
            chance: next.map(|next| self.correlation(&self.gap, next, 0)),
        }
    }
}

fn correlation(truth: &[f32], said: &[f32]) -> f64 {
    let column = |values: &[f32]| Array2::from_shape_fn((values.len(), 1), |(t, _)| values[t]);
    Score::of(&column(truth), &column(said)).acc()
}

impl Strangers {
    /// Mean of a figure over the videos, each counted once.
    pub fn mean(&self, figure: impl Fn(&Followed) -> f64) -> f64 {
        self.videos.iter().map(figure).sum::<f64>() / self.videos.len() as f64
    }

    /// Videos longer than ten seconds, and how many of them are followed better than by their loudness.
    pub fn loudness_beaten(&self) -> (usize, usize) {
        let long = self.videos.iter().filter(|one| one.seconds > LONG_S);
        (
            long.clone().count(),
            long.filter(|one| one.gap > one.loudness).count(),
        )
    }

    /// The tables, in Markdown.
    pub fn markdown(&self) -> String {
        let mut out = String::from(
            "| video | seconds | lip gap | after 30 s | at its best lag | width | loudness | chance |\n|---|---|---|---|---|---|---|---|\n",
        );
        let chance = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.2}"));
        for one in &self.videos {
            out += &format!(
                "| {} | {:.1} | {:.2} | {:.2} | {:.2} ({:+} ms) | {:.2} | {:.2} | {} |\n",
                one.video,
                one.seconds,
                one.gap,
                one.gap_known,
                one.best,
                one.best_lag_ms,
                one.width,
                one.loudness,
                chance(one.chance)
            );
        }
        let seconds: f32 = self.videos.iter().map(|one| one.seconds).sum();
        out += &format!(
            "| mean of {} | {seconds:.0} in all | **{:.3}** | **{:.3}** | {:.3} | {:.3} | {:.3} | {} |\n",
            self.videos.len(),
            self.mean(|one| one.gap),
            self.mean(|one| one.gap_known),
            self.mean(|one| one.best),
            self.mean(|one| one.width),
            self.mean(|one| one.loudness),
            chance(
                self.videos
                    .iter()
                    .all(|one| one.chance.is_some())
                    .then(|| self.mean(|one| one.chance.unwrap_or(0.0)))
            )
        );
        let (long, beaten) = self.loudness_beaten();
        if long > 0 {
            out += &format!("\nLoudness is beaten in {beaten} of {long} videos longer than {LONG_S:.0} s.\n");
        }
        for (name, why) in &self.left_out {
            out += &format!("\nLeft out: {name}: {why}.\n");
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A mouth at 25 pictures a second whose gap is a sine, heard `late_ms` after it is seen.
    fn observed(late_ms: f64) -> Observed {
        let wave = |seconds: f64| (std::f64::consts::TAU * 2.3 * seconds).sin() as f32;
        let frames: Vec<f32> = (0..400)
            .map(|t| wave(f64::from(crate::train::data::frame_time(t)) - late_ms * 1e-3))
            .collect();
        let gap: Vec<f32> = (0..90).map(|k| wave((f64::from(k) + 0.5) / 25.0)).collect();
        let flat = vec![0.0; frames.len()];
        Observed {
            name: "sine".into(),
            rate_hz: 25.0,
            width: gap.clone(),
            gap,
            heard: Heard {
                gap_known: frames.iter().map(|v| -v).collect(),
                width: flat.clone(),
                loudness: flat,
                gap: frames,
            },
        }
    }

    #[test]
    fn a_late_sound_is_told_from_a_wrong_mouth() {
        let in_time = observed(0.0).followed(None);
        assert!(in_time.gap > 0.99 && in_time.best_lag_ms == 0, "{in_time:?}");
        assert!(in_time.gap_known < -0.99 && in_time.width == 0.0 && in_time.chance.is_none());
        // The pictures' mouth is earlier than the sound's.
        let late = observed(60.0).followed(None);
        assert!(
            late.gap < 0.8 && late.best > 0.99 && late.best_lag_ms == -60,
            "{late:?}"
        );
    }

    #[test]
    fn a_table_has_every_video_and_the_means() {
        let videos = vec![
            observed(0.0).followed(None),
            observed(60.0).followed(Some(&[0.0; 9])),
        ];
        let report = Strangers {
            videos,
            left_out: vec![("b.mp4".into(), "no face".into())],
        };
        let table = report.markdown();
        assert!(table.contains("| sine | 3.6 | 1.00 |"), "{table}");
        assert!(table.contains("mean of 2") && table.contains("Left out: b.mp4: no face."));
        assert_eq!(report.loudness_beaten(), (0, 0));
    }
}
