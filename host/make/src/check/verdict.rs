//! What a take's figures mean, in words, and what to do about them.
//!
//! `docs/check.md` has the thresholds in a table, and what they were set by.
use serde::Serialize;

use super::Report;
use super::phones::PhoneReport;
use super::picture::{FramingReport, LightReport, SharpnessReport};
use super::sound::SoundReport;
use super::stillness::StillnessReport;
use super::sync::SyncReport;

/// How fit for training a take is; the worst first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Grade {
    /// Record it again.
    Bad,
    /// It can be trained on; better is possible.
    Usable,
    /// Nothing to do.
    Good,
}

/// One line of the verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// What is judged.
    pub what: &'static str,
    /// None where this take does not tell.
    pub grade: Option<Grade>,
    /// What was found, with its figures.
    pub found: String,
    /// What to do about it; None where nothing is to be done.
    pub advice: Option<String>,
}

/// A figure against its bounds: what it must reach to be good and to be usable.
fn at_least(value: f32, good: f32, usable: f32) -> Grade {
    match value {
        v if v >= good => Grade::Good,
        v if v >= usable => Grade::Usable,
        _ => Grade::Bad,
    }
}

fn at_most(value: f32, good: f32, usable: f32) -> Grade {
    at_least(-value, -good, -usable)
}

/// The worst of some grades, and the advice that goes with it; none where all are good.
fn worst<const N: usize>(graded: [(Grade, &str); N]) -> (Grade, Option<String>) {
    let worst = graded.iter().min_by_key(|(grade, _)| *grade);
    match worst {
        Some((grade, advice)) if *grade < Grade::Good => (*grade, Some((*advice).to_owned())),
        _ => (Grade::Good, None),
    }
}

fn verdict(what: &'static str, found: String, (grade, advice): (Grade, Option<String>)) -> Verdict {
    Verdict {
        what,
        grade: Some(grade),
        found,
        advice,
    }
}

/// Something that this take does not tell.
fn untold(what: &'static str, found: &str, advice: &str) -> Verdict {
    Verdict {
        what,
        grade: None,
        found: found.to_owned(),
        advice: Some(advice.to_owned()),
    }
}

/// All lines of a report, and the worst of their grades.
pub(super) fn judge(report: &Report) -> (Vec<Verdict>, Grade) {
    let mut verdicts = Vec::new();
    match (&report.light, &report.framing, &report.sharpness) {
        (Some(of_light), Some(of_framing), Some(of_sharpness)) => {
            verdicts.push(light(of_light));
            verdicts.push(framing(of_framing));
            verdicts.push(sharpness(of_sharpness));
        }
        _ => verdicts.push(Verdict {
            what: "face",
            grade: Some(Grade::Bad),
            found: "no face is seen in any picture looked at".to_owned(),
            advice: Some(
                "look into the camera, with a face that fills a third of the picture's height".to_owned(),
            ),
        }),
    }
    verdicts.push(level(&report.sound));
    verdicts.push(noise(&report.sound));
    verdicts.push(amount(&report.sound));
    match &report.sync {
        Some(sync) => {
            verdicts.push(offset(sync));
            verdicts.push(mouth(sync));
        }
        None => verdicts.push(untold(
            "sync",
            "no stretch has both speech and a face",
            "nothing tells whether sound and picture belong together: look at it yourself",
        )),
    }
    verdicts.push(match &report.stillness {
        Some(stillness) => still(stillness),
        None => untold(
            "silence",
            "no pause of a quarter of a second in which the face can be followed",
            "pause for a second between sentences, lips at rest",
        ),
    });
    verdicts.push(match &report.phones {
        Some(phones) => said(phones),
        None => untold(
            "phones",
            "there is no transcript beside the video (.srt, .vtt, .txt), and its sound is too short to hear phones in",
            "read aloud sentences that have every sound of English",
        ),
    });
    let overall = verdicts.iter().filter_map(|verdict| verdict.grade).min();
    (verdicts, overall.unwrap_or(Grade::Usable))
}

fn light(light: &LightReport) -> Verdict {
    let found = format!(
        "face at {:.0} of 255, {:.1} % of it white, {:.1} % black; {} half {:.2} times as bright; flicker {:.1} %",
        light.mean,
        100.0 * light.white,
        100.0 * light.black,
        light.brighter,
        light.side_ratio,
        100.0 * light.flicker
    );
    let judged = worst([
        (
            at_least(light.mean, 60.0, 35.0),
            "more light on the face, or a longer exposure",
        ),
        (
            at_most(light.mean, 210.0, 230.0),
            "less light on the face, or a shorter exposure",
        ),
        (
            at_most(light.white, 0.01, 0.08),
            "parts of the face are burnt out: less light, or a shorter exposure",
        ),
        (
            at_most(light.black, 0.02, 0.10),
            "parts of the face are black: light it from the front",
        ),
        (
            at_most(light.side_ratio, 1.5, 2.5),
            "turn the light so that both halves of the face are equally bright",
        ),
        (
            at_most(light.flicker, 0.01, 0.03),
            "the light flickers: use daylight or another lamp, or an exposure of 1/50 s (1/60 s where the mains have 60 Hz)",
        ),
    ]);
    verdict("light", found, judged)
}

fn framing(framing: &FramingReport) -> Verdict {
    let found = format!(
        "face {:.0} pixels wide, mouth {:.0}; nose {:.0} % of the way to a cheek (at most {:.0} %); face seen in {:.0} % of the pictures, \
         whole in {:.0} %; alone in {:.0} %",
        framing.face_width,
        framing.mouth_width,
        100.0 * framing.turn.abs(),
        100.0 * framing.turn_95,
        100.0 * framing.seen,
        100.0 * framing.inside,
        100.0 * framing.alone
    );
    let judged = worst([
        (
            at_least(framing.face_width, 150.0, 75.0),
            "go nearer to the camera, or zoom in: the face shall be 150 pixels wide or more",
        ),
        (
            at_most(framing.turn.abs(), 0.2, 0.4),
            "look straight into the camera",
        ),
        (
            at_most(framing.turn_95, 0.4, 0.7),
            "keep the head towards the camera all the time",
        ),
        (
            at_least(framing.seen, 0.98, 0.8),
            "the face is not always seen: keep hands and paper away from it",
        ),
        (
            at_least(framing.inside, 0.98, 0.8),
            "the face leaves the picture: frame it with some room on every side",
        ),
        (
            at_least(framing.alone, 0.95, 0.5),
            "other faces are in the picture: only the speaker's shall be",
        ),
    ]);
    verdict("framing", found, judged)
}

fn sharpness(sharpness: &SharpnessReport) -> Verdict {
    let found = format!(
        "detail of the mouth {:.3}; {:.2} pictures a second",
        sharpness.mouth, sharpness.rate_hz
    );
    let judged = worst([
        (
            at_least(sharpness.mouth, 0.02, 0.006),
            "focus on the face, clean the lens, or compress the video less",
        ),
        (
            at_least(sharpness.rate_hz, 23.9, 14.9),
            "record 25 pictures a second or more",
        ),
    ]);
    verdict("sharpness", found, judged)
}

fn level(sound: &SoundReport) -> Verdict {
    let found = format!(
        "speech at {:.0} dBFS, {:.2} % of it clipped",
        sound.speech_dbfs,
        100.0 * sound.clipped
    );
    let judged = worst([
        (
            at_least(sound.speech_dbfs, -38.0, -55.0),
            "record louder, or nearer to the microphone",
        ),
        (
            at_most(sound.speech_dbfs, -9.0, -4.0),
            "turn the recording level down",
        ),
        (
            at_most(sound.clipped, 0.001, 0.02),
            "the sound is clipped: turn the recording level down",
        ),
    ]);
    verdict("level", found, judged)
}

fn noise(sound: &SoundReport) -> Verdict {
    let hum = sound
        .hum_dbfs
        .map_or(String::new(), |hum| format!(", hum at {hum:.0} dBFS"));
    let found = format!(
        "speech {:.0} dB above the noise (at {:.0} dBFS){hum}, offset at {:.0} dBFS",
        sound.speech_to_noise_db, sound.noise_dbfs, sound.offset_dbfs
    );
    let hum = sound.hum_dbfs.map_or(-99.0, |hum| hum - sound.speech_dbfs);
    let judged = worst([
        (
            at_least(sound.speech_to_noise_db, 22.0, 10.0),
            "a quieter room, or nearer to the microphone",
        ),
        (
            at_most(hum, -20.0, -6.0),
            "the mains hum: use another cable, or run on battery",
        ),
        (
            at_most(sound.offset_dbfs - sound.speech_dbfs, -10.0, 10.0),
            "the sound card adds a constant to the sound: use another input",
        ),
    ]);
    verdict("noise", found, judged)
}

fn amount(sound: &SoundReport) -> Verdict {
    let share = sound.speech_seconds / sound.seconds.max(1e-3);
    let found = format!(
        "{:.0} s of speech in {:.0} s ({:.0} %)",
        sound.speech_seconds,
        sound.seconds,
        100.0 * share
    );
    let judged = worst([(
        at_least(sound.speech_seconds as f32, 60.0, 1.0),
        "a new mouth wants a minute or two: record more, or give several clips",
    )]);
    verdict("amount", found, judged)
}

/// Offsets below this are as good as none: half a picture's time at 25 a second, and what the estimate itself is off by.
pub const NO_OFFSET_MS: f32 = 30.0;

fn offset(sync: &SyncReport) -> Verdict {
    let offset = sync.offset_ms;
    let side = if offset > 0.0 { "late" } else { "early" };
    let parts: Vec<String> = sync.parts_ms.iter().map(|ms| format!("{ms:.0}")).collect();
    let parts = match parts.is_empty() {
        true => String::new(),
        false => format!("; its thirds {} ms", parts.join(", ")),
    };
    // Draws of one or two blocks are all alike.
    let spread = match sync.above_chance {
        Some(_) => format!(" (± {:.0})", sync.spread_ms),
        None => String::new(),
    };
    let found = format!("sound {:.0} ms {side}{spread}{parts}", offset.abs());
    if !sync.is_sure() {
        return untold(
            "sync",
            &format!("{:.0} s do not tell (best guess: {found})", sync.seconds),
            "read aloud for half a minute or more, face towards the camera; or look at a clap of the hands",
        );
    }
    let judged = match (offset.abs() < NO_OFFSET_MS, sync.is_constant()) {
        (_, Some(false)) => (
            Grade::Bad,
            Some("sound and picture drift apart: record both with one device".to_owned()),
        ),
        (true, _) => (Grade::Good, None),
        (false, _) => (
            Grade::Usable,
            Some("it is mended when the take is prepared".to_owned()),
        ),
    };
    verdict("sync", found, judged)
}

/// Above chance: surely, and less than which it is hardly so; and the seconds without which nothing is said against a mouth.
const FOLLOWS: f32 = 3.0;
const HARDLY: f32 = 1.8;
const ENOUGH_S: f32 = 40.0;

fn mouth(sync: &SyncReport) -> Verdict {
    let found = format!(
        "the lips' opening correlates with the sound's at {:.2}, with its energy at {:.2}{}",
        sync.correlation,
        sync.energy_correlation,
        sync.above_chance
            .map_or(String::new(), |above| format!("; {above:.1} times chance"))
    );
    match sync.above_chance {
        Some(above) if above >= FOLLOWS => verdict("mouth", found, (Grade::Good, None)),
        Some(above) if above < HARDLY && sync.seconds >= ENOUGH_S => verdict(
            "mouth",
            found,
            (
                Grade::Bad,
                Some(
                    "this may not be the speaker's mouth, or it is no mouth: look at it, and at its sound"
                        .to_owned(),
                ),
            ),
        ),
        _ => untold(
            "mouth",
            &found,
            "too little to tell whether it is the speaker's mouth",
        ),
    }
}

fn still(stillness: &StillnessReport) -> Verdict {
    let found = format!(
        "in {} pauses ({} pictures) the mouth moves by {:.2} % of the face's width, 95 % of the time by less than {:.2} %",
        stillness.pauses,
        stillness.pictures,
        100.0 * stillness.deviation,
        100.0 * stillness.percentile_95
    );
    let judged = worst([(
        at_most(stillness.deviation, 0.005, 0.02),
        "keep head and lips still in pauses",
    )]);
    verdict("silence", found, judged)
}

fn said(phones: &PhoneReport) -> Verdict {
    let list = |what: &str, names: &[String]| match names.is_empty() {
        true => String::new(),
        false => format!("; {what}: {}", names.join(" ")),
    };
    let found = format!(
        "{} of {} phones are said{}{} ({})",
        phones.counts.len(),
        phones.counts.len() + phones.missing.len(),
        list("missing", &phones.missing),
        list("rare", &phones.rare),
        phones.from
    );
    let grade = match (phones.missing.is_empty(), phones.rare.is_empty()) {
        (true, true) => (Grade::Good, None),
        _ => (
            Grade::Usable,
            Some("say more: read aloud sentences that have every sound of English".to_owned()),
        ),
    };
    verdict("phones", found, grade)
}
