//! The four formats of Rhubarb Lip Sync 1.x, TSV, XML, JSON, and DAT (Moho's switch layers), and WebVTT (subtitles in browsers, w3.org/TR/webvtt1).
use std::fmt::Write as _;

use super::{Cue, Shape};

/// Pictures a second of a DAT file: Rhubarb's and Moho's own.
const DAT_FPS: f64 = 24.0;

/// A format of cue files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Rows of start time and shape, separated by tabs.
    Tsv,
    /// Rhubarb's XML.
    Xml,
    /// Rhubarb's JSON.
    Json,
    /// A switch layer of Moho, by pictures at 24 a second.
    Dat,
    /// WebVTT, a cue a shape.
    Vtt,
}

impl Format {
    /// Every format.
    pub const ALL: [Format; 5] = [Format::Tsv, Format::Xml, Format::Json, Format::Dat, Format::Vtt];

    /// The file ending, lower case.
    pub fn ending(self) -> &'static str {
        match self {
            Format::Tsv => "tsv",
            Format::Xml => "xml",
            Format::Json => "json",
            Format::Dat => "dat",
            Format::Vtt => "vtt",
        }
    }
}

/// What a cue file may be asked to be otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Style {
    /// Pictures a second of a DAT file.
    pub dat_fps: f64,
    /// Preston Blair's names of the shapes in a DAT file, which OpenToonz wants, in place of letters.
    pub preston_blair: bool,
    /// The closed mouth behind the end: [`Shape::X`], or [`Shape::A`] for a character without one.
    pub closed: Shape,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            dat_fps: DAT_FPS,
            preston_blair: false,
            closed: Shape::X,
        }
    }
}

/// The file's text. `sound` names the sound file in the formats that do.
pub fn write(format: Format, cues: &[Cue], sound: &str) -> String {
    write_as(format, cues, sound, &Style::default())
}

/// [`write()`] in another style.
pub fn write_as(format: Format, cues: &[Cue], sound: &str, style: &Style) -> String {
    let cues = &in_hundredths(cues);
    let end_s = cues.last().map_or(0.0, |c| c.end_s);
    match format {
        Format::Tsv => tsv(cues, end_s, style),
        Format::Xml => xml(cues, sound, end_s),
        Format::Json => json(cues, sound, end_s),
        Format::Dat => dat(cues, end_s, style),
        Format::Vtt => vtt(cues),
    }
}

/// Times as the files have them: rounded to hundredths of seconds, and the last cut off to them, so that no cue ends after the sound. What lasts no
/// hundredth is left out, unless it is all there is.
fn in_hundredths(cues: &[Cue]) -> Vec<Cue> {
    // A number of hundredths may lie a rounding error below itself.
    let end = cues.last().map_or(0.0, |c| (c.end_s * 100.0 + 1e-6).floor());
    let starts = cues.iter().map(|c| (c.start_s * 100.0).round());
    let ends = starts.clone().skip(1).chain([end]);
    let timed = cues.iter().zip(starts.zip(ends)).map(|(cue, (from, to))| Cue {
        start_s: from / 100.0,
        end_s: to.min(end) / 100.0,
        shape: cue.shape,
    });
    let mut timed: Vec<Cue> = timed.collect();
    let first = timed.first().copied();
    timed.retain(|cue| cue.end_s > cue.start_s);
    match timed.is_empty() {
        true => first.into_iter().collect(),
        false => timed,
    }
}

fn tsv(cues: &[Cue], end_s: f64, style: &Style) -> String {
    let mut out = String::new();
    for cue in cues {
        let _ = writeln!(out, "{:.2}\t{}", cue.start_s, cue.shape.letter());
    }
    let _ = writeln!(out, "{end_s:.2}\t{}", style.closed.letter());
    out
}

fn xml(cues: &[Cue], sound: &str, end_s: f64) -> String {
    let mut name = String::new();
    for c in sound.chars() {
        match c {
            '&' => name.push_str("&amp;"),
            '<' => name.push_str("&lt;"),
            '>' => name.push_str("&gt;"),
            c if c.is_control() => name.push('\u{fffd}'),
            c => name.push(c),
        }
    }
    let mut out = format!(
        "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<rhubarbResult>\n  <metadata>\n    <soundFile>{name}</soundFile>\n    \
         <duration>{end_s:.2}</duration>\n  </metadata>\n  <mouthCues>\n"
    );
    for cue in cues {
        let _ = writeln!(
            out,
            "    <mouthCue start=\"{:.2}\" end=\"{:.2}\">{}</mouthCue>",
            cue.start_s,
            cue.end_s,
            cue.shape.letter()
        );
    }
    out.push_str("  </mouthCues>\n</rhubarbResult>\n");
    out
}

fn json(cues: &[Cue], sound: &str, end_s: f64) -> String {
    let lines: Vec<String> = cues
        .iter()
        .map(|cue| {
            format!(
                "    {{ \"start\": {:.2}, \"end\": {:.2}, \"value\": \"{}\" }}",
                cue.start_s,
                cue.end_s,
                cue.shape.letter()
            )
        })
        .collect();
    let name = serde_json::Value::from(sound);
    format!(
        "{{\n  \"metadata\": {{\n    \"soundFile\": {name},\n    \"duration\": {end_s:.2}\n  }},\n  \"mouthCues\": [\n{}\n  ]\n}}\n",
        lines.join(",\n")
    )
}

/// One line a change: the picture, counted from 1, and the shape; of several in one picture the first stays.
fn dat(cues: &[Cue], end_s: f64, style: &Style) -> String {
    let picture = |s: f64| 1 + ((s * 100.0).round() * style.dat_fps / 100.0).floor() as u64;
    let name = |shape: Shape| match style.preston_blair {
        true => shape.preston_blair().to_owned(),
        false => shape.letter().to_string(),
    };
    let mut out = String::from("MohoSwitch1\n");
    let mut last = 0;
    for cue in cues {
        let at = picture(cue.start_s);
        if at > last {
            let _ = writeln!(out, "{at} {}", name(cue.shape));
            last = at;
        }
    }
    let _ = writeln!(out, "{} {}", picture(end_s).max(last + 1), name(style.closed));
    out
}

fn vtt(cues: &[Cue]) -> String {
    let time = |s: f64| {
        let ms = (s * 1000.0).round() as u64;
        let (hours, minutes) = (ms / 3_600_000, ms / 60_000 % 60);
        format!("{hours:02}:{minutes:02}:{:02}.{:03}", ms / 1000 % 60, ms % 1000)
    };
    let mut out = String::from("WEBVTT\n");
    for cue in cues {
        let (from, to) = (time(cue.start_s), time(cue.end_s));
        let _ = write!(out, "\n{from} --> {to}\n{}\n", cue.shape.letter());
    }
    out
}
