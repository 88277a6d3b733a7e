//! One HTML file that plays the mouth with its sound and draws what the model thinks. It needs nothing outside
//! itself: the video is a data: URI, the numbers are JSON.
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lipstream_core::{FRAME_SAMPLES, HOP_SAMPLES, SAMPLE_RATE_HZ};
use ndarray::{ArrayView1, ArrayView2};
use serde_json::json;

use crate::cues::Cue;
use crate::error::{Result, bail};
use crate::phones::{Phone, VISEME_WORDS, VISEMES};

const TEMPLATE: &str = include_str!("page.html");
/// Parameters drawn, the most important first.
const TRACES: usize = 6;

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
    let video = format!("data:video/mp4;base64,{}", STANDARD.encode(page.mp4));
    let title = escaped(page.title);
    Ok(fill(
        TEMPLATE,
        &[
            ("title", &title),
            ("note", &escaped(super::SYNTHETIC)),
            ("video", &video),
            ("data", &in_script(&data)),
        ],
    ))
}

/// Numbers and texts as they may stand in a script element of a page, which only `<` could end.
pub fn in_script(data: &serde_json::Value) -> String {
    data.to_string().replace('<', "\\u003c")
}

/// Text as it may stand between the tags and in the attributes of a page.
pub fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            c => out.push(c),
        }
    }
    out
}

/// A template whose slots, a name in two pairs of braces, hold what `slots` gives for them. What is put in is not looked at again.
///
/// # Panics
///
/// If the template has a slot that `slots` does not know.
pub fn fill(template: &str, slots: &[(&str, &str)]) -> String {
    let mut out = String::with_capacity(template.len() + slots.iter().map(|s| s.1.len()).sum::<usize>());
    let mut rest = template;
    while let Some(at) = rest.find("{{") {
        let (before, slot) = rest.split_at(at);
        out.push_str(before);
        let (name, after) = slot[2..].split_once("}}").expect("a slot of the template ends");
        let known = slots.iter().find(|(known, _)| *known == name);
        out.push_str(known.unwrap_or_else(|| panic!("nothing for slot {name}")).1);
        rest = after;
    }
    out.push_str(rest);
    out
}

/// Loudest sample of each hop, 0..255 on a square-root scale, which shows quiet consonants.
fn peaks(sound: &[i16]) -> Vec<u8> {
    sound
        .chunks(HOP_SAMPLES)
        .map(|chunk| {
            let peak = chunk.iter().map(|s| s.unsigned_abs()).max().unwrap_or(0);
            ((f32::from(peak) / 32768.0).sqrt() * 255.0) as u8
        })
        .collect()
}

/// Name of every viseme, the phones that look like it, and what it looks like.
fn viseme_names() -> Vec<[String; 3]> {
    VISEMES
        .iter()
        .enumerate()
        .map(|(v, name)| {
            let phones: Vec<&str> = Phone::all()
                .filter(|p| usize::from(p.viseme().0) == v)
                .map(Phone::name)
                .collect();
            [name.to_string(), phones.join(" "), VISEME_WORDS[v].to_owned()]
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
    fn it_says_that_it_is_synthetic() {
        let said = format!(
            "<meta name=\"description\" content=\"{}\">",
            super::super::SYNTHETIC
        );
        assert!(page("hello.wav").contains(&said));
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
        assert_eq!(data["peaks"].as_array().unwrap().len(), 52);
        assert_eq!(data["duration"], 0.52);
        assert_eq!(data["visemes"][9][1], "p b m");
        assert_eq!(data["visemes"][9][2], "lips closed (p, b, m)");
    }

    #[test]
    fn names_cannot_break_out() {
        let text = page("</title><script>alert(1)</script>");
        assert!(!text.contains("<script>alert"));
        assert!(text.contains("&lt;script&gt;alert(1)"));
    }
}
