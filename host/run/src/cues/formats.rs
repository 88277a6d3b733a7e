//! The four formats of Rhubarb Lip Sync 1.x: TSV, XML, JSON, and DAT (Moho's switch layers).
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
}

impl Format {
    /// Every format.
    pub const ALL: [Format; 4] = [Format::Tsv, Format::Xml, Format::Json, Format::Dat];

    /// The file ending, lower case.
    pub fn ending(self) -> &'static str {
        match self {
            Format::Tsv => "tsv",
            Format::Xml => "xml",
            Format::Json => "json",
            Format::Dat => "dat",
        }
    }
}

/// The file's text. `sound` names the sound file in the formats that do.
pub fn write(format: Format, cues: &[Cue], sound: &str) -> String {
    let end_s = cues.last().map_or(0.0, |c| c.end_s);
    match format {
        Format::Tsv => tsv(cues, end_s),
        Format::Xml => xml(cues, sound, end_s),
        Format::Json => json(cues, sound, end_s),
        Format::Dat => dat(cues, end_s),
    }
}

fn tsv(cues: &[Cue], end_s: f64) -> String {
    let mut out = String::new();
    for cue in cues {
        let _ = writeln!(out, "{:.2}\t{}", cue.start_s, cue.shape.letter());
    }
    let _ = writeln!(out, "{end_s:.2}\t{}", Shape::X.letter());
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
fn dat(cues: &[Cue], end_s: f64) -> String {
    // Of the time as the other formats write it, in hundredths.
    let picture = |s: f64| 1 + ((s * 100.0).round() * DAT_FPS / 100.0).floor() as u64;
    let mut out = String::from("MohoSwitch1\n");
    let mut last = 0;
    for cue in cues {
        let at = picture(cue.start_s);
        if at > last {
            let _ = writeln!(out, "{at} {}", cue.shape.letter());
            last = at;
        }
    }
    let _ = writeln!(out, "{} {}", picture(end_s).max(last + 1), Shape::X.letter());
    out
}
