//! The host's clock: milliseconds since the program began, the same for everything that is measured against each other.
use std::time::{Duration, Instant};

/// Where time is counted from.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Instant);

impl Clock {
    /// Begins to count now.
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Milliseconds since the start.
    pub fn now_ms(&self) -> f64 {
        self.0.elapsed().as_secs_f64() * 1000.0
    }

    /// The moment that is so many milliseconds after the start.
    pub fn at(&self, ms: f64) -> Instant {
        self.0 + Duration::from_secs_f64((ms / 1000.0).max(0.0))
    }
}
