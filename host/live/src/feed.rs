//! Sound at the pace of life: a file as if it were spoken now.
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use lipstream::shipped;
use lipstream_core::{HOP_SAMPLES, SAMPLE_RATE_HZ};
use lipstream_media::sound::{Reader, SoundError};

use crate::clock::Clock;

/// What is heard.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Speech {
    /// A sound file.
    File(PathBuf),
    /// The speech that comes with the program.
    Shipped,
}

impl Speech {
    /// Opens it from its beginning.
    ///
    /// # Errors
    ///
    /// That the file cannot be read as sound.
    pub fn open(&self) -> Result<Reader<'static>, SoundError> {
        match self {
            Speech::File(path) => Reader::open(path),
            Speech::Shipped => Reader::of_stream("the shipped speech", io::Cursor::new(shipped::SOUND)),
        }
    }
}

/// Ten milliseconds of sound, the last shorter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Hop(pub(crate) Vec<i16>);

/// A sound that is being played.
pub(crate) struct Feed {
    wanted: Arc<AtomicBool>,
}

impl Feed {
    /// Hands out hops from now on, each when its last sample would have been heard, on a thread of its own, until the sound ends, when
    /// `take` gets None, or this value is dropped.
    pub(crate) fn start(
        mut sound: Reader<'static>,
        clock: Clock,
        mut take: impl FnMut(Result<Option<(Hop, f64)>, SoundError>) -> bool + Send + 'static,
    ) -> Self {
        let wanted = Arc::new(AtomicBool::new(true));
        let still = Arc::clone(&wanted);
        std::thread::spawn(move || {
            let began_ms = clock.now_ms();
            let hop_ms = 1000.0 * HOP_SAMPLES as f64 / f64::from(SAMPLE_RATE_HZ);
            let (mut waiting, mut hops): (Vec<i16>, u64) = (Vec::new(), 0);
            loop {
                let ended = loop {
                    if waiting.len() >= HOP_SAMPLES {
                        break false;
                    }
                    match sound.piece() {
                        Ok(Some(piece)) => waiting.extend(piece),
                        Ok(None) => break true,
                        Err(error) => {
                            take(Err(error));
                            return;
                        }
                    }
                };
                if waiting.is_empty() {
                    take(Ok(None));
                    return;
                }
                let rest = waiting.split_off(waiting.len().min(HOP_SAMPLES));
                let hop = Hop(std::mem::replace(&mut waiting, rest));
                let heard_ms = began_ms + hops as f64 * hop_ms;
                hops += 1;
                let due = clock.at(heard_ms + hop_ms);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
                if !still.load(Ordering::Relaxed) || !take(Ok(Some((hop, heard_ms)))) {
                    return;
                }
                if ended && waiting.is_empty() {
                    take(Ok(None));
                    return;
                }
            }
        });
        Self { wanted }
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        self.wanted.store(false, Ordering::Relaxed);
    }
}
