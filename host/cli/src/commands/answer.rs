//! How a command tells what it has done: in words for people, or with `--json` in one object for programs.
use std::path::Path;

use anyhow::Result;
use serde_json::{Map, Value, json};

use super::batch::Job;
use super::streams::{is_standard, say};
use crate::progress;

/// How it is told.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub(crate) struct Answer {
    /// Standard output is JSON: what was written if it goes there, else what was done; where standard output carries something else, what was done
    /// is told on standard error
    #[arg(long)]
    pub(crate) json: bool,
}

/// What was done.
pub(crate) struct Done {
    /// For people, without the name of what was written.
    words: String,
    fields: Map<String, Value>,
}

impl Done {
    /// `fields` is an object.
    pub(crate) fn new(words: String, fields: Value) -> Self {
        let fields = match fields {
            Value::Object(fields) => fields,
            _ => Map::new(),
        };
        Self { words, fields }
    }

    /// For people.
    pub(crate) fn words(&self) -> &str {
        &self.words
    }

    /// The fields behind others.
    fn behind<const N: usize>(&self, first: [(&str, Value); N]) -> Value {
        let first = first.map(|(name, value)| (name.to_owned(), value));
        let fields = self.fields.clone();
        Value::Object(first.into_iter().chain(fields).collect())
    }
}

impl Answer {
    /// Whether the result itself is wanted as JSON: it goes to standard output, and nothing else was asked for.
    pub(crate) fn wants_result(self, output: &Path) -> bool {
        self.json && is_standard(output)
    }

    /// Tells what was written to `output`.
    pub(crate) fn tell(self, output: &Path, done: &Done) {
        match self.json {
            true => tell_object(output, &done.behind([("output", path(output))])),
            false => say(output, &done.words),
        }
    }

    /// Tells what was done where standard output is free; the words are a note on standard error.
    pub(crate) fn note(self, done: &Done) {
        match self.json {
            true => println!("{}", Value::Object(done.fields.clone())),
            false => progress::say(&done.words),
        }
    }

    /// Tells what became of many sounds whose files were to go into the folder `output`; people are told of failures as they happen.
    pub(crate) fn tell_many(self, output: &Path, jobs: &[Job], outcomes: &[Result<Done>]) {
        if self.json {
            let files: Vec<Value> = std::iter::zip(jobs, outcomes)
                .map(|(job, outcome)| match outcome {
                    Ok(done) => done.behind([("input", path(&job.input)), ("output", path(&job.output))]),
                    Err(why) => json!({ "input": path(&job.input), "error": format!("{why:#}") }),
                })
                .collect();
            tell_object(output, &json!({ "output": path(output), "files": files }));
        } else if outcomes.iter().all(Result::is_ok) {
            say(output, &format!("{} files", jobs.len()));
        }
    }
}

/// A path as programs get it.
pub(crate) fn path(path: &Path) -> Value {
    json!(path.to_string_lossy())
}

fn tell_object(output: &Path, object: &Value) {
    match is_standard(output) {
        true => eprintln!("{object}"),
        false => println!("{object}"),
    }
}
