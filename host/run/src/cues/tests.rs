use super::*;
use crate::phones::Phone;
use ndarray::Array2;

/// Weights of 1 for the visemes of `phones`, each for so many frames.
fn spoken(phones: &[(&str, usize)]) -> Array2<f32> {
    let frames = phones.iter().map(|p| p.1).sum();
    let mut weights = Array2::zeros((frames, VISEMES.len()));
    let mut t = 0;
    for &(name, length) in phones {
        let viseme = Phone::from_name(name).unwrap().viseme();
        for _ in 0..length {
            weights[[t, usize::from(viseme.0)]] = 1.0;
            t += 1;
        }
    }
    weights
}

fn letters(cues: &[Cue]) -> String {
    cues.iter().map(|c| c.shape.letter()).collect()
}

#[test]
fn a_word_becomes_its_shapes() {
    // "move fat lid", as table 1 and the table above say.
    let weights = spoken(&[
        ("sil", 20),
        ("m", 8),
        ("uw", 12),
        ("v", 8),
        ("f", 8),
        ("ae", 12),
        ("t", 8),
        ("l", 8),
        ("ih", 8),
        ("d", 8),
        ("sil", 20),
    ]);
    let duration = (119.0 * 160.0 + 400.0) / 16_000.0;
    let found = cues(weights.view(), None, duration).unwrap();
    assert_eq!(letters(&found), "XAFGCBHBX");
    assert_eq!(found[0].start_s, 0.0);
    assert_eq!(found.last().unwrap().end_s, duration);
    for pair in found.windows(2) {
        assert_eq!(pair[0].end_s, pair[1].start_s);
        assert!(pair[0].start_s < pair[0].end_s);
    }
    // Frame 20's window is centred at sample 3400; it takes over half a hop earlier.
    assert!((found[1].start_s - (20.0 * 160.0 + 200.0 - 80.0) / 16_000.0).abs() < 1e-9);
}

#[test]
fn a_flicker_is_not_shown_but_a_short_closure_is() {
    let mut weights = spoken(&[("sil", 10), ("aa", 20), ("m", 3), ("aa", 20), ("sil", 10)]);
    // A doubtful frame inside the vowel.
    let (open, teeth) = (1, 11);
    weights[[18, open]] = 0.45;
    weights[[18, teeth]] = 0.55;
    let found = cues(weights.view(), None, 0.64).unwrap();
    // Between the closed mouth and the wide open one it is half open; after the closure the vowel is long enough for that on one side.
    assert_eq!(letters(&found), "XCDACDX");
}

/// A voice whose m is heard as n all but a little: the mouth that closes shows it. One that does not close shows nothing, nor does silence.
#[test]
fn lips_that_meet_are_closed_whatever_was_heard() {
    let mut weights = spoken(&[("sil", 20), ("ae", 20), ("n", 8), ("ae", 20), ("sil", 20)]);
    let (bilabial, alveolar) = (9, 7);
    for t in 40..48 {
        weights[[t, alveolar]] = 0.9;
        weights[[t, bilabial]] = 0.1;
    }
    let said = |gaps: Option<&[f32]>| letters(&cues(weights.view(), gaps, 0.88).unwrap());
    assert_eq!(said(None), "XCBCX");
    let mut gaps = vec![0.0f32; 88];
    gaps[20..68].fill(0.6);
    assert_eq!(said(Some(&gaps)), "XCBCX");
    gaps[41..47].fill(0.1);
    assert_eq!(said(Some(&gaps)), "XCACX");
    assert_eq!(
        cues(weights.view(), Some(&gaps[1..]), 0.88),
        Err(CueError::Gaps { gaps: 87, frames: 88 })
    );
    gaps[5] = f32::NAN;
    assert_eq!(
        cues(weights.view(), Some(&gaps), 0.88),
        Err(CueError::Gap { frame: 5 })
    );
}

#[test]
fn half_open_half_round_is_e() {
    let mut weights = Array2::zeros((20, VISEMES.len()));
    weights.column_mut(1).fill(0.55);
    weights.column_mut(2).fill(0.45);
    assert_eq!(letters(&cues(weights.view(), None, 0.2).unwrap()), "E");
}

#[test]
fn weights_that_are_none_are_refused() {
    assert!(cues(Array2::zeros((0, 13)).view(), None, 0.0).is_err());
    // What is shorter than a window is a mouth at rest.
    let rest = cues(Array2::zeros((0, 13)).view(), None, 0.02).unwrap();
    assert_eq!(
        rest,
        [Cue {
            start_s: 0.0,
            end_s: 0.02,
            shape: Shape::X
        }]
    );
    assert!(cues(Array2::zeros((5, 12)).view(), None, 1.0).is_err());
    let mut weights = Array2::zeros((5, 13));
    weights[[2, 3]] = f32::NAN;
    assert!(cues(weights.view(), None, 1.0).is_err());
}

/// Weights that flutter every three frames still give shapes of 70 ms, all the way but at the end of the sound; and the best path is the best of all.
#[test]
fn no_shape_is_shorter_than_seventy_milliseconds() {
    let mut state = 7u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (state >> 40) as usize
    };
    let mut weights = Array2::from_elem((300, 13), 0.001f32);
    let mut viseme = 0;
    for t in 0..300 {
        if t % 3 == 0 {
            viseme = random() % 13;
        }
        weights[[t, viseme]] = 1.0;
    }
    let duration = 3.0;
    let found = cues(weights.view(), None, duration).unwrap();
    assert!(found.len() > 5, "{found:?}");
    for pair in found.windows(2) {
        assert!(pair[0].end_s - pair[0].start_s > 0.0699, "{pair:?}");
        assert_ne!(pair[0].shape, pair[1].shape);
        assert_eq!(pair[0].end_s, pair[1].start_s);
    }
    // One frame of another shape is none.
    let mut weights = spoken(&[("f", 20), ("aa", 1), ("f", 20)]);
    weights.row_mut(20).fill(0.0);
    weights[[20, 1]] = 0.5;
    weights[[20, 2]] = 0.5;
    assert_eq!(letters(&cues(weights.view(), None, 0.4).unwrap()), "G");
}

#[test]
fn characters_without_some_shapes_get_the_nearest_ones() {
    let cue = |start_s: f64, shape| Cue {
        start_s,
        end_s: start_s + 1.0,
        shape,
    };
    let said = [
        cue(0.0, Shape::X),
        cue(1.0, Shape::A),
        cue(2.0, Shape::G),
        cue(3.0, Shape::B),
        cue(4.0, Shape::H),
    ];
    assert_eq!(
        letters(&drawn_with(&said, &[Shape::G, Shape::H, Shape::X])),
        "XAGBH"
    );
    let six = drawn_with(&said, &[]);
    assert_eq!(letters(&six), "ABC");
    assert_eq!((six[0].end_s, six[1].start_s, six[1].end_s), (2.0, 2.0, 4.0));
    let style = Style {
        dat_fps: 30.0,
        preston_blair: true,
        closed: Shape::A,
    };
    assert_eq!(
        write_as(Format::Dat, &six, "a.wav", &style),
        "MohoSwitch1\n1 MBP\n61 etc\n121 E\n151 MBP\n"
    );
}

/// No cue ends after the sound.
#[test]
fn the_end_is_cut_off_to_hundredths() {
    let cue = |start_s, end_s, shape| Cue {
        start_s,
        end_s,
        shape,
    };
    let said = [
        cue(0.0, 0.5675, Shape::D),
        cue(0.5675, 0.8725, Shape::B),
        cue(0.8725, 0.875, Shape::X),
    ];
    assert_eq!(write(Format::Tsv, &said, ""), "0.00\tD\n0.57\tB\n0.87\tX\n");
    let short = [cue(0.0, 0.004, Shape::X)];
    assert_eq!(write(Format::Tsv, &short, ""), "0.00\tX\n0.00\tX\n");
    let value: serde_json::Value = serde_json::from_str(&write(Format::Json, &said, "")).unwrap();
    assert_eq!(value["metadata"]["duration"], 0.87);
    // 0.29 is a little less than 29 hundredths.
    assert!(write(Format::Tsv, &[cue(0.0, 0.29, Shape::D)], "").ends_with("0.29\tX\n"));
}

fn two() -> [Cue; 2] {
    [
        Cue {
            start_s: 0.0,
            end_s: 0.51,
            shape: Shape::X,
        },
        Cue {
            start_s: 0.51,
            end_s: 1.25,
            shape: Shape::D,
        },
    ]
}

#[test]
fn tsv_ends_with_the_mouth_at_rest() {
    assert_eq!(write(Format::Tsv, &two(), "a.wav"), "0.00\tX\n0.51\tD\n1.25\tX\n");
}

#[test]
fn dat_counts_pictures_from_one() {
    assert_eq!(
        write(Format::Dat, &two(), "a.wav"),
        "MohoSwitch1\n1 X\n13 D\n31 X\n"
    );
}

#[test]
fn json_is_json() {
    let text = write(Format::Json, &two(), "C:\\a \"b\".wav");
    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["metadata"]["soundFile"], "C:\\a \"b\".wav");
    assert_eq!(value["metadata"]["duration"], 1.25);
    assert_eq!(value["mouthCues"][1]["start"], 0.51);
    assert_eq!(value["mouthCues"][1]["value"], "D");
    assert_eq!(value["mouthCues"].as_array().unwrap().len(), 2);
}

#[test]
fn xml_escapes_names() {
    let text = write(Format::Xml, &two(), "a<b>&c.wav");
    assert!(text.contains("<soundFile>a&lt;b&gt;&amp;c.wav</soundFile>"));
    assert!(text.contains("<mouthCue start=\"0.51\" end=\"1.25\">D</mouthCue>"));
    assert!(text.starts_with("<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<rhubarbResult>"));
}

#[test]
fn subtitles_have_times_of_their_own_kind() {
    let mut cues = two();
    cues[1].start_s = 3_723.456;
    cues[0].end_s = cues[1].start_s;
    cues[1].end_s = 3_724.0;
    assert_eq!(
        write(Format::Vtt, &cues, "a.wav"),
        "WEBVTT\n\n00:00:00.000 --> 01:02:03.460\nX\n\n01:02:03.460 --> 01:02:04.000\nD\n"
    );
}
