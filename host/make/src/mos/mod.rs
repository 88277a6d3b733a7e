//! What people think of mouths: mean opinion scores (X&L section 7.3, tables 4 and 5).
//!
//! [`make`] turns a folder of clips into one page that viewers open in a browser and a key that tells which clip is whose; each viewer's page
//! gives a file of answers; [`tables()`] turns those and the keys into tables with intervals and a ranking. docs/mos.md says why it
//! is done this way.
use serde::{Deserialize, Serialize};

mod answers;
mod page;
mod statistics;
mod tables;

pub use answers::{Answer, Key, Results, Shown};
pub use page::{MAX_BYTES, Made, make};
pub use tables::{Settings, tables};

/// What is asked about each clip, in the order of X&L's tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Criterion {
    /// Its column in the tables.
    pub letter: &'static str,
    /// Its name.
    pub name: &'static str,
    /// The question that a viewer reads.
    pub question: &'static str,
}

/// How many questions there are.
pub const CRITERIA: usize = 5;

/// X&L's four criteria and the whole.
pub const QUESTIONS: [Criterion; CRITERIA] = [
    Criterion {
        letter: "S",
        name: "smoothness",
        question: "Smoothness: does the mouth move evenly, without jumps or trembling?",
    },
    Criterion {
        letter: "C",
        name: "closure",
        question: "Closure: do the lips close when they should, as for p, b and m?",
    },
    Criterion {
        letter: "P",
        name: "protrusion",
        question: "Protrusion: are the lips rounded and pushed forward when they should be, as in “who”?",
    },
    Criterion {
        letter: "T",
        name: "turning",
        question: "Turning: does the mouth pass from one sound to the next as a real mouth does?",
    },
    Criterion {
        letter: "O",
        name: "overall",
        question: "Overall: how natural is the mouth together with the sound?",
    },
];

/// Best score.
pub const BEST: u8 = 5;

/// Words for 1 to 5.
pub const WORDS: [&str; BEST as usize] = ["bad", "poor", "fair", "good", "excellent"];

/// Clips of each viewer's that only look whether somebody reads the page.
const CHECKS: usize = 2;

/// Version of the files of answers and of keys.
const VERSION: u32 = 1;

/// First words of a file: what it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Format {
    #[serde(rename = "lipstream mos key")]
    Key,
    #[serde(rename = "lipstream mos results")]
    Results,
}

#[cfg(test)]
mod tests;
