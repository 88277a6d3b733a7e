//! The two files of a listening test: the key, which stays with who made it, and a viewer's answers.
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use lipstream_media::files;
use serde::{Deserialize, Serialize};

use super::{BEST, CHECKS, CRITERIA, Format, VERSION};
use crate::error::{Context as _, Error, Result, bail};

/// Which clip is whose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Key {
    format: Format,
    version: u32,
    /// Which test: the same clips under the same names have the same.
    pub test: String,
    /// What the test is called.
    pub title: String,
    /// Names of the systems, in their tables' order.
    pub systems: Vec<String>,
    /// What each code of the page stands for.
    pub clips: BTreeMap<String, Shown>,
}

/// A clip of a system.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shown {
    /// Whose.
    pub system: String,
    /// The file's name without its ending: what is said.
    pub clip: String,
}

/// A viewer's answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Results {
    format: Format,
    version: u32,
    /// Which test it belongs to.
    pub test: String,
    /// Drawn by the page, once for each browser.
    pub viewer: String,
    /// What the order of the clips was drawn with.
    pub seed: u32,
    /// When the viewer began.
    pub started: String,
    /// When the viewer was done.
    pub finished: String,
    /// In the order in which the clips were shown.
    pub answers: Vec<Answer>,
}

/// What a viewer thought of one clip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Answer {
    /// The clip's code.
    pub code: String,
    /// The answer that the page asked for, where it only looked whether somebody reads it.
    pub check: Option<u8>,
    /// 1 to 5, in the order of the questions.
    pub scores: [u8; CRITERIA],
    /// How often the clip was played to its end.
    pub plays: u32,
    /// From the clip's appearance to the answer, in seconds.
    pub seconds: f64,
}

impl Key {
    /// The key of a test.
    pub fn new(test: String, title: String, systems: Vec<String>, clips: BTreeMap<String, Shown>) -> Self {
        Self {
            format: Format::Key,
            version: VERSION,
            test,
            title,
            systems,
            clips,
        }
    }

    /// Reads a key.
    ///
    /// # Errors
    ///
    /// That the file cannot be read, is no key or contradicts itself.
    pub fn read(path: &Path) -> Result<Self> {
        let key: Key = parsed(path, "key of a page")?;
        if key.format != Format::Key {
            bail!(File, "{} is a viewer's answers, no key", path.display());
        }
        if key.version != VERSION {
            bail!(
                File,
                "{} is of version {}, not {VERSION}",
                path.display(),
                key.version
            );
        }
        let names = key.names();
        let pairs: BTreeSet<_> = key.clips.values().collect();
        let whole = names.len() * key.systems.len();
        let known = key
            .clips
            .values()
            .all(|shown| key.systems.contains(&shown.system));
        if key.systems.len() < 2 || pairs.len() != whole || key.clips.len() != whole || !known {
            bail!(
                File,
                "the key {} is damaged: its systems have not got the same clips",
                path.display()
            );
        }
        Ok(key)
    }

    /// Names of the clips, each once.
    pub fn names(&self) -> BTreeSet<&str> {
        self.clips.values().map(|shown| shown.clip.as_str()).collect()
    }
}

impl Results {
    /// A viewer's answers, as the page writes them.
    pub fn new(test: &str, viewer: &str, seed: u32, answers: Vec<Answer>) -> Self {
        Self {
            format: Format::Results,
            version: VERSION,
            test: test.to_owned(),
            viewer: viewer.to_owned(),
            seed,
            started: String::new(),
            finished: String::new(),
            answers,
        }
    }

    /// Reads a viewer's answers.
    ///
    /// # Errors
    ///
    /// That the file cannot be read, or is no file of answers.
    pub fn read(path: &Path) -> Result<Self> {
        let results: Results = parsed(path, "file of a viewer's answers")?;
        if results.format != Format::Results {
            bail!(File, "{} is a key, no viewer's answers", path.display());
        }
        if results.version != VERSION {
            bail!(
                File,
                "{} is of version {}, not {VERSION}",
                path.display(),
                results.version
            );
        }
        Ok(results)
    }

    /// That every clip of `key` was judged once, with scores that there are.
    ///
    /// # Errors
    ///
    /// What is missing, twice or unknown; `name` is the file's.
    pub(super) fn check(&self, key: &Key, name: &str) -> Result<()> {
        let mut seen = BTreeSet::new();
        for answer in &self.answers {
            if !key.clips.contains_key(&answer.code) {
                bail!(
                    File,
                    "{name} judges a clip {:?} that its test has not got",
                    answer.code
                );
            }
            if let Some(score) = answer.scores.iter().find(|score| !(1..=BEST).contains(*score)) {
                bail!(
                    File,
                    "{name} gives clip {} a score of {score}: 1 to {BEST} are possible",
                    answer.code
                );
            }
            if answer.check.is_none() && !seen.insert(&answer.code) {
                bail!(File, "{name} judges clip {} twice", answer.code);
            }
        }
        if seen.len() != key.clips.len() {
            bail!(
                File,
                "{name} judges {} of {} clips: the viewer has not come to the end",
                seen.len(),
                key.clips.len()
            );
        }
        let checks = self.answers.len() - seen.len();
        if checks != CHECKS {
            bail!(
                File,
                "{name} has {checks} checks of attention: the page makes {CHECKS}"
            );
        }
        Ok(())
    }

    /// Whether the viewer read what stands on the page: every check has the answer that was asked for.
    pub fn attentive(&self) -> bool {
        let mut checks = self.answers.iter().filter_map(|a| Some((a.check?, a.scores)));
        checks.all(|(asked, scores)| scores == [asked; CRITERIA])
    }
}

/// A file of ours in JSON.
fn parsed<T: for<'de> Deserialize<'de>>(path: &Path, what: &str) -> Result<T> {
    let bytes = files::read_bytes(path).map_err(Error::other)?;
    serde_json::from_slice(&bytes).with_context(|| format!("{} is no {what}, or damaged", path.display()))
}
