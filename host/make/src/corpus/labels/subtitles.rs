//! Subtitles, SubRip (.srt) and WebVTT (.vtt): what is said from when to when.
use crate::error::{Result, bail};

/// One subtitle.
#[derive(Clone, Debug, PartialEq)]
pub struct Subtitle {
    /// Start and end in seconds.
    pub time: (f64, f64),
    /// What is said, in one line, without mark-up.
    pub text: String,
}

/// All subtitles of a file, in the order of their starts.
///
/// # Errors
///
/// Which line is no time, and that there is none at all.
pub fn read(text: &str) -> Result<Vec<Subtitle>> {
    let mut all: Vec<Subtitle> = Vec::new();
    let mut open = false;
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if let Some((from, to)) = line.split_once("-->") {
            // Behind the end WebVTT may say where on the screen.
            let to = to.split_whitespace().next().unwrap_or_default();
            let (Some(from), Some(to)) = (seconds(from.trim()), seconds(to)) else {
                bail!(
                    Data,
                    "line {number}: {line:?} is no time of a subtitle (00:01:02,500 --> 00:01:04,000)"
                );
            };
            if to <= from {
                bail!(Data, "line {number}: the subtitle ends before it begins");
            }
            all.push(Subtitle {
                time: (from, to),
                text: String::new(),
            });
            open = true;
        } else if line.is_empty() {
            open = false;
        } else if let Some(last) = all.last_mut().filter(|_| open) {
            let words = plain(line);
            if !words.is_empty() {
                let space = if last.text.is_empty() { "" } else { " " };
                last.text += &format!("{space}{words}");
            }
        }
    }
    if all.is_empty() {
        bail!(
            Data,
            "there is no subtitle in it: no line with --> between two times"
        );
    }
    all.sort_by(|a, b| a.time.0.total_cmp(&b.time.0));
    Ok(all)
}

/// Hours, minutes and seconds, the hours left out where there are none.
fn seconds(text: &str) -> Option<f64> {
    let text = text.replace(',', ".");
    let mut sum = 0.0;
    let parts: Vec<&str> = text.split(':').collect();
    if !(2..=3).contains(&parts.len()) {
        return None;
    }
    for part in parts {
        let number: f64 = part.parse().ok().filter(|n: &f64| n.is_finite() && *n >= 0.0)?;
        sum = 60.0 * sum + number;
    }
    Some(sum)
}

/// Without mark-up (`<i>`, `{\\an8}`), without what is no speech (`[music]`, `(laughs)`), without who speaks (`- `).
fn plain(line: &str) -> String {
    let mut out = String::new();
    let mut until = None;
    for c in line.chars() {
        match (until, c) {
            (None, '<') => until = Some('>'),
            (None, '{') => until = Some('}'),
            (None, '[') => until = Some(']'),
            (None, '(') => until = Some(')'),
            (None, c) => out.push(c),
            (Some(end), c) if c == end => until = None,
            (Some(_), _) => {}
        }
    }
    out.trim()
        .trim_start_matches('-')
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subrip_and_webvtt_are_read() {
        let srt = "\u{feff}1\r\n00:00:01,500 --> 00:00:03,000\r\n<i>Hello there,</i>\r\n- my [door slams] friend\r\n\r\n2\r\n00:01:00,000 --> 00:01:02,250\r\nBye.\r\n";
        let vtt = "WEBVTT\n\nNOTE not this\n\n00:01.500 --> 00:03.000 line:0\nHello there, my friend\n\nintro\n01:00.000 --> 01:02.250\n{\\an8}Bye.\n";
        let want = [
            Subtitle {
                time: (1.5, 3.0),
                text: "Hello there, my friend".into(),
            },
            Subtitle {
                time: (60.0, 62.25),
                text: "Bye.".into(),
            },
        ];
        assert_eq!(read(srt).unwrap(), want);
        assert_eq!(read(vtt).unwrap(), want);
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, expected) in [
            ("", "no subtitle"),
            ("just words", "no subtitle"),
            ("1\n00:00:01 --> soon\nx", "line 2"),
            (
                "00:00:05,000 --> 00:00:04,000\nx",
                "line 1: the subtitle ends before it begins",
            ),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text:?}: {error}");
        }
    }
}
