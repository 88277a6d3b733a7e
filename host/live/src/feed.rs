//! Sound at the pace of life: a file as if it were spoken now, or a microphone.
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
    /// A microphone of this computer: the one with this in its name, or the system's own choice.
    Microphone(Option<String>),
}

/// Why there is nothing to hear, or nothing any more.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SpeechError {
    /// The sound cannot be read, or not any further.
    #[error(transparent)]
    Sound(#[from] SoundError),
    /// This build knows no microphones.
    #[error(
        "this build has no microphones (build it with `--features mic`; on Linux that needs ALSA's headers, libasound2-dev)"
    )]
    NotBuilt,
    /// The computer has none.
    #[error("this computer has no microphone that can be opened")]
    NoMicrophone,
    /// None of those that there are is called so.
    #[error("no microphone has \"{wanted}\" in its name; there are: {}", names.join(", "))]
    OtherMicrophones {
        /// What was looked for.
        wanted: String,
        /// What there is.
        names: Vec<String>,
    },
    /// It cannot be used.
    #[error("the microphone {name} cannot be used: {why}")]
    Microphone {
        /// What the system calls it.
        name: String,
        /// What the system says.
        why: String,
    },
}

impl Speech {
    /// Opens it from its beginning.
    ///
    /// # Errors
    ///
    /// That the file cannot be read as sound, or the microphone not opened.
    pub fn open(&self) -> Result<Reader<'static>, SpeechError> {
        match self {
            Speech::File(path) => Ok(Reader::open(path)?),
            Speech::Shipped => {
                let speech = io::Cursor::new(shipped::SOUND);
                Ok(Reader::of_stream("the shipped speech", speech)?)
            }
            #[cfg(feature = "mic")]
            Speech::Microphone(name) => crate::microphone::open(name.as_deref()),
            #[cfg(not(feature = "mic"))]
            Speech::Microphone(_) => Err(SpeechError::NotBuilt),
        }
    }

    /// Whether it comes at its own pace and may break off and come back.
    pub fn is_live(&self) -> bool {
        matches!(self, Speech::Microphone(_))
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
    /// `take` gets None, or this value is dropped. Sound that is `live` comes at its own pace.
    pub(crate) fn start(
        mut sound: Reader<'static>,
        live: bool,
        clock: Clock,
        mut take: impl FnMut(Result<Option<(Hop, f64)>, SpeechError>) -> bool + Send + 'static,
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
                            take(Err(error.into()));
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
                let heard_ms = match live {
                    // What waits behind this hop was heard after it.
                    true => {
                        clock.now_ms() - hop_ms - waiting.len() as f64 * 1000.0 / f64::from(SAMPLE_RATE_HZ)
                    }
                    false => began_ms + hops as f64 * hop_ms,
                };
                hops += 1;
                if !live {
                    let due = clock.at(heard_ms + hop_ms);
                    std::thread::sleep(due.saturating_duration_since(Instant::now()));
                }
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
