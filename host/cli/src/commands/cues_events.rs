//! What `lipstream cues` says about its work: Rhubarb Lip Sync's machine-readable messages, its log levels and its log file.
use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::sync::Mutex;

use anyhow::{Context as _, Result};
use serde_json::{Value, json};

/// How much something matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub(super) enum Level {
    /// Every step
    Trace,
    /// What helps to find a fault
    Debug,
    /// What is done
    Info,
    /// What may not be as you wish
    Warning,
    /// What went wrong
    Error,
    /// What ended the program
    Fatal,
}

impl Level {
    /// As Rhubarb writes it.
    fn word(self) -> &'static str {
        match self {
            Level::Trace => "Trace",
            Level::Debug => "Debug",
            Level::Info => "Info",
            Level::Warning => "Warning",
            Level::Error => "Error",
            Level::Fatal => "Fatal",
        }
    }
}

/// Whom to tell what.
pub(super) struct Events {
    /// Standard error is for a program: a JSON object a line.
    pub(super) machine: bool,
    /// The least level that standard error gets.
    console: Level,
    log: Option<(Mutex<File>, Level)>,
    /// The last hundredth that was told, so that an hour of sound is not a million lines.
    percent: Mutex<Option<u32>>,
}

impl Events {
    /// # Errors
    ///
    /// That the log file cannot be written.
    pub(super) fn new(machine: bool, console: Level, log: Option<&Path>, level: Level) -> Result<Self> {
        let open = |path: &Path| {
            let file = File::create(path)
                .with_context(|| format!("cannot write the log file {}", path.display()))?;
            Ok::<_, anyhow::Error>((Mutex::new(file), level))
        };
        Ok(Self {
            machine,
            console,
            log: log.map(open).transpose()?,
            percent: Mutex::new(None),
        })
    }

    /// One of Rhubarb's "machine-readable status messages", of which each says `what` besides; for people it is a line of the log.
    pub(super) fn event(&self, kind: &str, level: Level, message: &str, what: (&str, Value)) {
        self.log(level, message);
        if self.machine {
            let log = json!({ "level": level.word(), "message": message });
            eprintln!("{}", json!({ "type": kind, what.0: what.1, "log": log }));
        }
    }

    /// A line of the log.
    pub(super) fn say(&self, level: Level, message: &str) {
        self.log(level, message);
        if level < self.console {
            return;
        }
        match self.machine {
            true => {
                let log = json!({ "level": level.word(), "message": message });
                eprintln!("{}", json!({ "type": "log", "text": message, "log": log }));
            }
            false => eprintln!("{}: {message}", level.word().to_lowercase()),
        }
    }

    /// How much is done, 0 to 1; told when it is another hundredth.
    pub(super) fn progress(&self, value: f64) {
        let value = value.clamp(0.0, 1.0);
        let percent = (100.0 * value) as u32; // between 0 and 100
        let mut last = self
            .percent
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        if last.is_none_or(|last| last < percent) {
            *last = Some(percent);
            let told = f64::from(percent) / 100.0;
            self.event(
                "progress",
                Level::Trace,
                &format!("Progress: {percent}%"),
                ("value", json!(told)),
            );
        }
    }

    /// For the log file alone.
    pub(super) fn log(&self, level: Level, message: &str) {
        if let Some((file, least)) = &self.log
            && level >= *least
        {
            let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            // What is asked for are the cues: a full disk costs the log, not them.
            let _ = writeln!(file, "[{}] {message}", level.word());
        }
    }
}
