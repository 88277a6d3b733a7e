//! One HTML file that plays the mouth with its sound and draws what the model thinks. It needs nothing outside
//! itself: the video is a data: URI, the numbers are JSON.
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, SAMPLE_RATE_HZ};
use ndarray::{ArrayView1, ArrayView2};
use serde_json::json;

use crate::cues::Cue;
use crate::error::{Result, bail};
use crate::phones::{Phone, VISEMES};

const TEMPLATE: &str = include_str!("page.html");
/// Parameters drawn, the most important first.
const TRACES: usize = 6;
/// Bars of the waveform at most.
const MAX_PEAKS: usize = 2000;

/// What the page shows.
pub struct Page<'a> {
    /// Heading of the page.
    pub title: &'a str,
    /// The video: an MP4 file's bytes.
    pub mp4: &'a [u8],
    /// 16 kHz.
    pub sound: &'a [i16],
    /// `[frames, 13]` at 100 Hz, 0..1.
    pub viseme_weights: ArrayView2<'a, f32>,
    /// `[frames, D]` at 100 Hz.
    pub parameters: ArrayView2<'a, f32>,
    /// Standard deviation of each parameter, `[D]`.
    pub deviation: ArrayView1<'a, f32>,
    /// Mouth shapes with their times.
    pub cues: &'a [Cue],
}

/// The page's text.
///
/// # Errors
///
/// [`Error::Data`](crate::Error::Data): viseme weights, deviations and parameters are of different sizes.
pub fn write(page: &Page) -> Result<String> {
    let frames = page.parameters.nrows();
    if page.viseme_weights.dim() != (frames, VISEMES.len()) || page.deviation.len() != page.parameters.ncols()
    {
        bail!(
            Data,
            "the viseme weights or deviations do not belong to the parameters"
        );
    }
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
    let weights: Vec<u8> = page.viseme_weights.iter().map(|&w| byte(w)).collect();
    // In hundredths of a deviation.
    let traces: Vec<Vec<i32>> = (0..page.parameters.ncols().min(TRACES))
        .map(|k| {
            let unit = page.deviation[k].max(f32::MIN_POSITIVE) / 100.0;
            page.parameters
                .column(k)
                .iter()
                .map(|v| (v / unit).round().clamp(-1e6, 1e6) as i32)
                .collect()
        })
        .collect();
    let cues: Vec<_> = page
        .cues
        .iter()
        .map(|c| json!([c.start_s, c.end_s, c.shape.letter()]))
        .collect();
    let data = json!({
        "rate": SAMPLE_RATE_HZ,
        "hop": HOP_SAMPLES,
        "window": FRAME_SAMPLES,
        "duration": page.sound.len() as f64 / f64::from(SAMPLE_RATE_HZ),
        "frames": frames,
        "peaks": peaks(page.sound),
        "visemes": viseme_names(),
        "weights": weights,
        "parameters": traces,
        "cues": cues,
    });
    // Inside a script element only `<` could end it.
    let data = data.to_string().replace('<', "\\u003c");
    let video = format!("data:video/mp4;base64,{}", STANDARD.encode(page.mp4));
    let mut title = String::new();
    for c in page.title.chars() {
        match c {
            '&' => title.push_str("&amp;"),
            '<' => title.push_str("&lt;"),
            '>' => title.push_str("&gt;"),
            '"' => title.push_str("&quot;"),
            c => title.push(c),
        }
    }
    let mut out = String::with_capacity(TEMPLATE.len() + video.len() + data.len());
    let mut rest = TEMPLATE;
    while let Some(at) = rest.find("{{") {
        let (before, slot) = rest.split_at(at);
        out.push_str(before);
        let (name, after) = slot[2..].split_once("}}").expect("a slot of the template ends");
        out.push_str(match name {
            "title" => &title,
            "video" => &video,
            "data" => &data,
            _ => unreachable!("the template has no other slot"),
        });
        rest = after;
    }
    out.push_str(rest);
    Ok(out)
}

/// Loudest sample of each stretch, 0..255 on a square-root scale, which shows quiet consonants.
fn peaks(sound: &[i16]) -> Vec<u8> {
    let stretch = sound.len().div_ceil(MAX_PEAKS).max(HOP_SAMPLES);
    sound
        .chunks(stretch)
        .map(|chunk| {
            let peak = chunk.iter().map(|s| s.unsigned_abs()).max().unwrap_or(0);
            ((f32::from(peak) / 32768.0).sqrt() * 255.0) as u8
        })
        .collect()
}

/// Name of every viseme and the phones that look like it.
fn viseme_names() -> Vec<[String; 2]> {
    VISEMES
        .iter()
        .enumerate()
        .map(|(v, name)| {
            let phones: Vec<&str> = Phone::all()
                .filter(|p| usize::from(p.viseme().0) == v)
                .map(Phone::name)
                .collect();
            [name.to_string(), phones.join(" ")]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array1, Array2};

    fn page(title: &str) -> String {
        let frames = 50;
        let weights = Array2::from_elem((frames, VISEMES.len()), 1.0 / 13.0);
        let parameters = Array2::from_shape_fn((frames, 8), |(t, k)| (t * k) as f32);
        let deviation = Array1::from_elem(8, 2.0);
        write(&Page {
            title,
            mp4: b"not really a film",
            sound: &[1000; 8320],
            viseme_weights: weights.view(),
            parameters: parameters.view(),
            deviation: deviation.view(),
            cues: &[],
        })
        .unwrap()
    }

    #[test]
    fn nothing_outside_is_asked_for() {
        let text = page("hello.wav");
        assert!(!text.contains("http:") && !text.contains("https:") && !text.contains("//cdn"));
        for attribute in ["src=\"", "href=\""] {
            for found in text.split(attribute).skip(1) {
                assert!(found.starts_with("data:"), "{}", &found[..20]);
            }
        }
        assert!(!text.contains("@import") && !text.contains("url(") && !text.contains("{{"));
    }

    #[test]
    fn the_numbers_are_there() {
        let text = page("hello.wav");
        let json = text
            .split_once("type=\"application/json\">")
            .and_then(|(_, rest)| rest.split_once("</script>"))
            .unwrap()
            .0;
        let data: serde_json::Value = serde_json::from_str(json).unwrap();
        assert_eq!(data["frames"], 50);
        assert_eq!(data["weights"].as_array().unwrap().len(), 50 * 13);
        assert_eq!(data["weights"][0], 20);
        // Parameter 2 at frame 3 is 6 = 3 deviations.
        assert_eq!(data["parameters"][2][3], 300);
        assert_eq!(data["parameters"].as_array().unwrap().len(), TRACES);
        assert_eq!(data["duration"], 0.52);
        assert_eq!(data["visemes"][9][1], "p b m");
    }

    #[test]
    fn names_cannot_break_out() {
        let text = page("</title><script>alert(1)</script>");
        assert!(!text.contains("<script>alert"));
        assert!(text.contains("&lt;script&gt;alert(1)"));
    }
}
