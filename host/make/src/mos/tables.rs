//! Viewers' answers to tables 4 and 5 of X&L, with intervals, and a ranking.
use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::statistics::{Opinions, Resampled, holm};
use super::{CRITERIA, Key, QUESTIONS, Results};
use crate::error::{Result, bail};
use crate::evaluate::bootstrap::{Difference, Interval};

/// The system that is no system: it comes last, and nothing is measured against it.
const RECORDING: &str = "recording";
/// Column of the overall opinion, by which systems are ranked.
const OVERALL: usize = CRITERIA - 1;
/// Differences are significant below it.
const ALPHA: f64 = 0.05;

/// How tables are made.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The system that improvements are measured against; `None`: the first one that is not `recording`.
    pub against: Option<String>,
    /// Resamples of the bootstrap.
    pub resamples: usize,
    /// Seed of the resamples.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            against: None,
            resamples: 2000,
            seed: 0,
        }
    }
}

/// The tables of all tests, in Markdown: one for each key, of the answers that belong to it. Results come with the name of their file.
///
/// # Errors
///
/// Results that are of none of the tests, incomplete or twice of the same viewer, tests without an attentive viewer, and a system that is not
/// there.
pub fn tables(keys: &[Key], results: &[(String, Results)], settings: &Settings) -> Result<String> {
    for (k, key) in keys.iter().enumerate() {
        if keys[..k].iter().any(|other| other.test == key.test) {
            bail!(Choice, "two keys are of the same test, {}", key.test);
        }
    }
    let mut viewers = BTreeMap::new();
    for (name, result) in results {
        let Some(key) = keys.iter().find(|key| key.test == result.test) else {
            bail!(
                Choice,
                "{name} is of test {}, of which no key is given: give the key that was made with its page",
                result.test
            );
        };
        result.check(key, name)?;
        if let Some(other) = viewers.insert((&result.test, &result.viewer), name) {
            bail!(
                Choice,
                "{name} is of the same viewer as {other}: give one of them"
            );
        }
    }
    let mut out = String::from("# Mean opinion scores\n\n");
    let _ = writeln!(
        out,
        "5 is excellent, 1 bad. {}. %RI: improvement of the overall score over the first system of a table, in parts of a hundred. Brackets: 95 % \
         intervals, bootstrap over viewers and clips, {} resamples, seed {}.",
        QUESTIONS.map(|q| format!("{}: {}", q.letter, q.name)).join(", "),
        settings.resamples,
        settings.seed
    );
    for key in keys {
        let of_key: Vec<_> = results.iter().filter(|(_, r)| r.test == key.test).collect();
        table(&mut out, key, &of_key, settings)?;
    }
    Ok(out)
}

/// One test.
fn table(out: &mut String, key: &Key, results: &[&(String, Results)], settings: &Settings) -> Result<()> {
    let (heard, left_out): (Vec<_>, Vec<_>) = results.iter().partition(|(_, r)| r.attentive());
    if heard.is_empty() {
        bail!(
            Data,
            "of test {:?} there is no viewer who passed the checks of attention, of {}",
            key.title,
            results.len()
        );
    }
    let systems = order(key, settings)?;
    let resampled = opinions(key, &systems, &heard).resampled(settings.resamples, settings.seed);

    let _ = writeln!(
        out,
        "\n## {}\n\n{} of {}, test {}.",
        key.title,
        counted(heard.len(), "viewer"),
        counted(key.names().len(), "clip"),
        key.test
    );
    if heard.len() == 1 {
        let _ = writeln!(
            out,
            "\nOf one viewer nothing follows for others: the intervals are over clips alone."
        );
    }
    if !left_out.is_empty() {
        let names: Vec<_> = left_out
            .iter()
            .map(|(name, r)| format!("{name} (viewer {})", r.viewer))
            .collect();
        let _ = writeln!(
            out,
            "\nLeft out, because a check of attention failed: {}.",
            names.join(", ")
        );
    }

    let letters = QUESTIONS.map(|q| q.letter).join(" | ");
    let _ = writeln!(
        out,
        "\n| system | {letters} | %RI |\n|---|{}",
        "---|".repeat(CRITERIA + 1)
    );
    for (s, name) in systems.iter().enumerate() {
        let means: Vec<_> = (0..CRITERIA).map(|c| bracketed(&resampled.mean(s, c))).collect();
        let improvement = match s {
            0 => "—".to_owned(),
            _ => bracketed(&resampled.improvement(s, 0, OVERALL)),
        };
        let _ = writeln!(out, "| {} | {} | {improvement} |", cell(name), means.join(" | "));
    }
    ranking(out, &systems, &resampled);
    Ok(())
}

/// The systems by their overall score, and which differences are more than chance.
fn ranking(out: &mut String, systems: &[&str], resampled: &Resampled) {
    let overall = |s: usize| resampled.mean(s, OVERALL);
    let mut places: Vec<usize> = (0..systems.len()).collect();
    places.sort_by(|&a, &b| overall(b).value.total_cmp(&overall(a).value));
    let mut pairs = Vec::new();
    for (k, &better) in places.iter().enumerate() {
        for &worse in &places[k + 1..] {
            pairs.push((better, worse, resampled.difference(better, worse, OVERALL)));
        }
    }
    let p = holm(
        &pairs
            .iter()
            .map(|(.., difference)| difference.p)
            .collect::<Vec<_>>(),
    );

    let _ = writeln!(
        out,
        "\nBy the overall score; two systems differ if p is at most {ALPHA}, two-sided, by Holm's correction for {}.\n\n\
         | place | system | overall | does not differ from |\n|---|---|---|---|",
        counted(pairs.len(), "pair")
    );
    for (place, &s) in (1..).zip(&places) {
        let alike = pairs.iter().zip(&p).filter(|(_, p)| **p > ALPHA);
        let alike: Vec<_> = alike
            .filter_map(|((a, b, _), _)| match (*a == s, *b == s) {
                (true, _) => Some(cell(systems[*b])),
                (_, true) => Some(cell(systems[*a])),
                _ => None,
            })
            .collect();
        let alike = if alike.is_empty() {
            "—".to_owned()
        } else {
            alike.join(", ")
        };
        let _ = writeln!(
            out,
            "| {place} | {} | {} | {alike} |",
            cell(systems[s]),
            bracketed(&overall(s))
        );
    }
    let _ = writeln!(out, "\n| better | worse | difference | p |\n|---|---|---|---|");
    for ((better, worse, difference), p) in pairs.iter().zip(&p) {
        let Difference {
            difference: value,
            low,
            high,
            ..
        } = *difference;
        let (better, worse) = (cell(systems[*better]), cell(systems[*worse]));
        let _ = writeln!(
            out,
            "| {better} | {worse} | {} | {p:.3} |",
            bracketed(&Interval { value, low, high })
        );
    }
}

/// The systems as their table lists them: what is measured against, the others by name, recordings.
fn order<'k>(key: &'k Key, settings: &Settings) -> Result<Vec<&'k str>> {
    let names = || key.systems.iter().map(String::as_str);
    let first = match &settings.against {
        Some(name) => names().find(|system| system == name),
        None => names().find(|system| *system != RECORDING),
    };
    let Some(first) = first else {
        bail!(
            Choice,
            "test {:?} has no system {}: it has {}",
            key.title,
            settings.against.as_deref().unwrap_or_default(),
            key.systems.join(", ")
        );
    };
    let others = names().filter(|name| *name != first && *name != RECORDING);
    let last = names().filter(|name| *name != first && *name == RECORDING);
    Ok([first].into_iter().chain(others).chain(last).collect())
}

/// The attentive viewers' scores.
fn opinions(key: &Key, systems: &[&str], results: &[&&(String, Results)]) -> Opinions {
    let clips: Vec<&str> = key.names().into_iter().collect();
    let by_place: Vec<BTreeMap<(&str, &str), [u8; CRITERIA]>> = results
        .iter()
        .map(|(_, results)| {
            let counted = results.answers.iter().filter(|answer| answer.check.is_none());
            counted
                .map(|answer| {
                    let shown = &key.clips[&answer.code];
                    ((shown.clip.as_str(), shown.system.as_str()), answer.scores)
                })
                .collect()
        })
        .collect();
    let size = (results.len(), clips.len(), systems.len());
    Opinions::new(size, |viewer, clip, system| {
        by_place[viewer][&(clips[clip], systems[system])]
    })
}

fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

fn bracketed(interval: &Interval) -> String {
    let Interval { value, low, high } = interval;
    format!("{value:.2} [{low:.2}, {high:.2}]")
}

/// A name that does not end its cell.
fn cell(name: &str) -> String {
    name.replace('|', "\\|")
}
