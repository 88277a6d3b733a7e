//! Utterances one by one, and work on many whose results come in order: what keeps memory and results of training
//! independent of how many utterances and threads there are.
use std::borrow::Cow;

use ndarray::Array2;
use rayon::prelude::*;

use crate::error::Result;
use lipstream::hmm::network::PhoneNetwork;

/// What training sees of one clip.
#[derive(Clone, Debug)]
pub struct Utterance {
    /// The clip's name in its feature folder.
    pub id: String,
    /// `[frames, 39]`
    pub audio: Array2<f32>,
    /// `[frames, D]` at the audio's rate, or nothing in an audio-only corpus.
    pub visual: Option<Array2<f32>>,
    /// The phones that may be said, by the clip's labels.
    pub network: PhoneNetwork,
    /// Phone (model index) and state 0..5 of every frame, from labels or evenly spread: where EM starts.
    pub start: Vec<(usize, usize)>,
}

/// Utterances one by one: in memory, or read when they are asked for.
pub trait Source: Sync {
    /// Number of utterances.
    fn len(&self) -> usize;

    /// Whether there is no utterance at all.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Utterance `index`, from 0. An error when it cannot be read.
    fn get(&self, index: usize) -> Result<Cow<'_, Utterance>>;
}

impl Source for [Utterance] {
    fn len(&self) -> usize {
        <[Utterance]>::len(self)
    }

    fn get(&self, index: usize) -> Result<Cow<'_, Utterance>> {
        Ok(Cow::Borrowed(&self[index]))
    }
}

/// Results in memory at once, for each thread.
const RESULTS_PER_THREAD: usize = 2;

/// Does `work` on 0..`n` on all threads, and hands what comes of it to `then` in order. No more than a few results are in
/// memory at once; the first error ends it.
pub fn in_order<T: Send>(
    n: usize,
    work: impl Fn(usize) -> Result<T> + Sync,
    mut then: impl FnMut(T) -> Result<()>,
) -> Result<()> {
    let at_once = RESULTS_PER_THREAD * rayon::current_num_threads();
    for first in (0..n).step_by(at_once) {
        let results: Vec<T> = (first..(first + at_once).min(n))
            .into_par_iter()
            .map(&work)
            .collect::<Result<_>>()?;
        results.into_iter().try_for_each(&mut then)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ensure;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Counts itself while it lives.
    struct Counted<'a>(usize, &'a AtomicUsize);

    impl Drop for Counted<'_> {
        fn drop(&mut self) {
            self.1.fetch_sub(1, Ordering::SeqCst);
        }
    }

    #[test]
    fn results_come_in_order_and_few_are_alive() {
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let (alive, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
            let mut seen = Vec::new();
            let work = |n: usize| {
                most.fetch_max(alive.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                Ok(Counted(n, &alive))
            };
            let all = || {
                in_order(100, work, |one| {
                    seen.push(one.0);
                    Ok(())
                })
            };
            pool.build().unwrap().install(all).unwrap();
            assert!(seen.into_iter().eq(0..100));
            assert!(most.into_inner() <= RESULTS_PER_THREAD * threads);
        }
    }

    #[test]
    fn the_first_error_ends_it() {
        let mut seen = 0;
        let work = |n: usize| {
            ensure!(n < 20, Data, "{n} is too much");
            Ok(n)
        };
        let all = in_order(1000, work, |_| {
            seen += 1;
            Ok(())
        });
        assert!(all.unwrap_err().to_string().contains("too much"));
        assert!(seen <= 20);
    }
}
