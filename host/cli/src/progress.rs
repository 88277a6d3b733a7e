//! Progress on the terminal: lines, and a bar for work that comes in steps.
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};

use lipstream::progress::Progress;

/// Whether the user wants to hear of nothing but what is wrong.
static QUIET: AtomicBool = AtomicBool::new(false);

/// From now on [`say`], and what a [`Terminal`] says and shows, is left out; results, warnings and errors are not.
pub(crate) fn be_quiet(quiet: bool) {
    QUIET.store(quiet, Ordering::Relaxed);
}

pub(crate) fn is_quiet() -> bool {
    QUIET.load(Ordering::Relaxed)
}

/// A line on standard error about what was done, for people.
pub(crate) fn say(what: &str) {
    if !is_quiet() {
        eprintln!("{what}");
    }
}

/// Standard error, with a bar below the lines while steps are counted; the bar is hidden where it is no terminal.
#[derive(Default)]
pub(crate) struct Terminal {
    bar: Mutex<Option<ProgressBar>>,
    hidden: bool,
}

impl Terminal {
    /// Without a bar unless it is `shown`; lines are said either way.
    pub(crate) fn shown(shown: bool) -> Self {
        Self {
            bar: Mutex::default(),
            hidden: !shown,
        }
    }
}

impl Progress for Terminal {
    fn say(&self, what: &str) {
        if !is_quiet() {
            self.warn(what);
        }
    }

    fn warn(&self, what: &str) {
        match self.bar.lock().as_deref() {
            // The bar makes way for the line.
            Ok(Some(bar)) => bar.suspend(|| eprintln!("{what}")),
            _ => eprintln!("{what}"),
        }
    }

    fn step(&self, what: &str, done: usize, all: usize) {
        let Ok(mut place) = self.bar.lock() else { return };
        if done == 0 && !self.hidden && !is_quiet() {
            *place = Some(bar(what, all));
        }
        let Some(bar) = place.as_ref() else { return };
        bar.set_position(done as u64);
        if done == all {
            bar.finish();
        }
    }
}

/// A bar that shows how many steps are made, how fast, and how long the rest will take.
fn bar(what: &str, all: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg:18} {bar:40} {pos}/{len} {per_sec} {eta}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::new(all as u64)
        .with_style(style)
        .with_message(what.to_owned());
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}
