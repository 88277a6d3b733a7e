//! How long work tells the user that it goes on: one interface for everything that takes more than a moment.
use std::sync::{Mutex, PoisonError};

/// Who is told how the work goes on. Work on several threads tells it from any of them.
pub trait Progress: Sync {
    /// Something that the user is to hear now, in whole lines: what begins, what came of a pass, a clip that cannot be read.
    fn say(&self, what: &str);

    /// What is not as it should be, though the work goes on: heard by those too who want to hear nothing else.
    fn warn(&self, what: &str) {
        self.say(what);
    }

    /// `done` of the `all` steps of `what` are made. The first call for a `what` is with 0, the last with `all`; in between
    /// `done` never falls. See [`Steps`], which counts.
    fn step(&self, what: &str, done: usize, all: usize);
}

/// Nobody.
impl Progress for () {
    fn say(&self, _: &str) {}
    fn step(&self, _: &str, _: usize, _: usize) {}
}

/// A closure hears what is said and not the steps.
impl<F: Fn(&str) + Sync> Progress for F {
    fn say(&self, what: &str) {
        self(what);
    }
    fn step(&self, _: &str, _: usize, _: usize) {}
}

/// Counts the steps of one piece of work, whichever threads make them.
pub struct Steps<'a> {
    progress: &'a dyn Progress,
    what: &'static str,
    all: usize,
    /// Locked while it is told: two threads would else tell their counts in the wrong order.
    done: Mutex<usize>,
}

impl<'a> Steps<'a> {
    /// Tells `progress` that `what` begins, a piece of work of `all` steps.
    pub fn begin(progress: &'a dyn Progress, what: &'static str, all: usize) -> Self {
        Self::go_on(progress, what, 0, all)
    }

    /// The same where `done` steps were made by an interrupted run.
    pub fn go_on(progress: &'a dyn Progress, what: &'static str, done: usize, all: usize) -> Self {
        progress.step(what, 0, all);
        if done > 0 {
            progress.step(what, done, all);
        }
        Self {
            progress,
            what,
            all,
            done: Mutex::new(done),
        }
    }

    /// One step more is made.
    pub fn made(&self) {
        let mut done = self.done.lock().unwrap_or_else(PoisonError::into_inner);
        *done += 1;
        self.progress.step(self.what, *done, self.all);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn steps_of_many_threads_are_told_in_order() {
        #[derive(Default)]
        struct Heard(Mutex<Vec<(String, usize, usize)>>);
        impl Progress for Heard {
            fn say(&self, _: &str) {}
            fn step(&self, what: &str, done: usize, all: usize) {
                self.0.lock().unwrap().push((what.to_owned(), done, all));
            }
        }
        let heard = Heard::default();
        let steps = Steps::begin(&heard, "work", 500);
        (0..500).into_par_iter().for_each(|_| steps.made());
        let heard = heard.0.into_inner().unwrap();
        let expected: Vec<_> = (0..=500).map(|n| ("work".to_owned(), n, 500)).collect();
        assert_eq!(heard, expected);
    }
}
