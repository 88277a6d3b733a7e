//! Which pictures are drawn where a computer cannot draw all of them.

/// Of the time between two pictures so much may be spent on drawing one.
const MOST_BUSY: f64 = 0.9;
/// Only where no more than this would be spent is the next picture drawn again, so that it does not go to and fro.
const AT_EASE: f64 = 0.65;
/// Weight of a picture in the mean of what they take: about four seconds of them, so that a join of the background alone, of 0.4 s, changes nothing.
const WEIGHT: f64 = 0.01;
/// Pictures after a change before the next: the mean must have seen it.
const PATIENCE: u32 = 50;

/// Leaves pictures out evenly.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// Time from one picture to the next.
    budget_ms: f64,
    /// One of so many is drawn.
    every: u32,
    picture_ms: f64,
    /// Pictures drawn since the last change.
    drawn: u32,
}

impl Pace {
    pub(super) fn new(fps: u32) -> Self {
        Self {
            budget_ms: 1000.0 / f64::from(fps.max(1)),
            every: 1,
            picture_ms: 0.0,
            drawn: 0,
        }
    }

    /// Whether the picture of this number is drawn.
    pub(super) fn wants(&self, number: u64) -> bool {
        number.is_multiple_of(u64::from(self.every))
    }

    /// Milliseconds that a picture takes.
    pub(super) fn picture_ms(&self) -> f64 {
        self.picture_ms
    }

    /// Learns what a picture took; where that changes something, gives of how many one is drawn from now on.
    pub(super) fn took(&mut self, ms: f64) -> Option<u32> {
        self.drawn += 1;
        // A mean over fewer pictures counts each as much as the others.
        let weight = WEIGHT.max(1.0 / f64::from(self.drawn));
        self.picture_ms += weight * (ms - self.picture_ms);
        if self.drawn < PATIENCE {
            return None;
        }
        let share = self.picture_ms / self.budget_ms;
        let least = |of: f64| (share / of).ceil().clamp(1.0, 1000.0) as u32;
        let every = least(MOST_BUSY).max(self.every.min(least(AT_EASE)));
        if every == self.every {
            return None;
        }
        self.every = every;
        self.drawn = 0;
        Some(every)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws pictures that take so long; gives what was said.
    fn drawn(pace: &mut Pace, pictures: u64, ms: impl Fn(u64) -> f64) -> Vec<u32> {
        let mut said = Vec::new();
        for n in 0..pictures {
            if pace.wants(n) {
                said.extend(pace.took(ms(n)));
            }
        }
        said
    }

    #[test]
    fn what_is_too_slow_is_thinned_evenly_and_comes_back() {
        let mut pace = Pace::new(25);
        assert!(drawn(&mut pace, 200, |_| 30.0).is_empty());
        // 90 ms of the 120 that three pictures have.
        assert_eq!(drawn(&mut pace, 3000, |_| 90.0).last(), Some(&3));
        let kept: Vec<u64> = (0..12).filter(|n| pace.wants(*n)).collect();
        assert_eq!(kept, [0, 3, 6, 9]);
        // Slow enough for two of three, not for all: it stays until there is room to spare.
        assert!(drawn(&mut pace, 3000, |_| 68.0).is_empty());
        assert_eq!(drawn(&mut pace, 6000, |_| 10.0).last(), Some(&1));
        assert!((0..10).all(|n| pace.wants(n)));
    }

    #[test]
    fn a_join_of_the_background_changes_nothing() {
        let mut pace = Pace::new(25);
        // Ten of a hundred pictures are dissolves, which take three times as long.
        let said = drawn(&mut pace, 2000, |n| if n % 100 < 10 { 75.0 } else { 25.0 });
        assert!(said.is_empty(), "{said:?}");
    }
}
