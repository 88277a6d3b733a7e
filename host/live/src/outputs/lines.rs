//! Lines of text: JSON and CSV, for scripts.
use std::io::{self, Write};

use lipstream::phones::{VISEME_WORDS, VISEMES};
use lipstream::time::seconds;
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_core::wire::Profile;
use serde_json::{Value, json as object};

use super::Output;
use crate::event::{Event, Level};

/// An event as the object that a line of JSON or the WebSocket carries (`docs/live.md`); None for sound, which is no text.
pub fn json(event: &Event) -> Option<Value> {
    Some(match event {
        Event::Hello(said) => {
            let groups: Vec<Value> = said
                .hello
                .groups
                .iter()
                .map(|group| object!({ "name": group.name.as_str(), "size": group.size }))
                .collect();
            let visemes: Vec<Value> = VISEMES
                .iter()
                .zip(VISEME_WORDS)
                .take(usize::from(said.hello.visemes))
                .map(|(name, words)| object!({ "name": name, "words": words }))
                .collect();
            object!({
                "type": "hello",
                "protocol": PROTOCOL,
                "source": said.source,
                "model": format!("{:08x}", said.hello.model),
                "rate_hz": said.hello.rate_hz,
                "sample_rate_hz": SAMPLE_RATE_HZ,
                "lag_samples": said.hello.lag_samples,
                "groups": groups,
                "visemes": visemes,
                "sound": said.sound,
                "profile": said.profile.map(profile_word),
                "running": said.running,
            })
        }
        Event::Frame(timed) => {
            let opening = timed.opening();
            object!({
                "type": "frame",
                "sequence": timed.frame.sequence,
                "sample": timed.sample,
                "time_s": seconds(timed.sample as usize),
                "parameters": timed.parameters().collect::<Vec<f32>>(),
                "visemes": timed.visemes().collect::<Vec<f32>>(),
                "gap": opening.map(|o| o.gap),
                "width": opening.map(|o| o.width),
            })
        }
        Event::Status(health) => object!({
            "type": "status",
            "load_permille": health.device.load_permille,
            "overruns": health.device.overruns,
            "dropped": health.device.dropped,
            "narrowed": health.device.narrowed,
            "unknown": health.device.unknown,
            "losses": {
                "frames": health.losses.frames,
                "damaged": health.losses.damaged,
                "unknown": health.losses.unknown,
                "unread": health.losses.unread,
                "restarts": health.losses.restarts,
            },
        }),
        Event::Notice(notice) => object!({
            "type": "notice",
            "level": match notice.level {
                Level::Info => "info",
                Level::Warning => "warning",
                Level::Error => "error",
            },
            "text": &*notice.text,
        }),
        Event::End(text) => object!({ "type": "end", "text": &**text }),
        Event::Sound(_) => return None,
    })
}

/// Version of these objects.
const PROTOCOL: u8 = 1;

/// The profile that a word stands for.
pub(crate) fn profile_of(word: &str) -> Option<Profile> {
    let all = [Profile::Live, Profile::Standard, Profile::Studio];
    all.into_iter().find(|profile| profile_word(*profile) == word)
}

/// The word for a profile.
fn profile_word(profile: Profile) -> &'static str {
    match profile {
        Profile::Live => "live",
        Profile::Standard => "standard",
        Profile::Studio => "studio",
    }
}

/// One object a line.
pub struct JsonLines<W>(W);

impl<W: Write + Send> JsonLines<W> {
    /// Lines go to `to`.
    pub fn new(to: W) -> Self {
        Self(to)
    }
}

impl<W: Write + Send> Output for JsonLines<W> {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let Some(value) = json(event) else { return Ok(()) };
        writeln!(self.0, "{value}")?;
        // Whoever reads a pipe wants a frame when it is there.
        self.0.flush()
    }
}

/// A header when a run begins that has other columns, and a row a frame: time, sample, parameters, viseme weights, and the mouth's gap and width
/// where they can be read.
pub struct Csv<W> {
    to: W,
    columns: Option<(usize, usize, bool)>,
}

impl<W: Write + Send> Csv<W> {
    /// Rows go to `to`.
    pub fn new(to: W) -> Self {
        Self { to, columns: None }
    }
}

impl<W: Write + Send> Output for Csv<W> {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        match event {
            Event::Hello(said) => {
                let visemes = usize::from(said.hello.visemes);
                let columns = (said.hello.scales.len(), visemes, said.opening.is_some());
                if self.columns != Some(columns) {
                    self.columns = Some(columns);
                    write!(self.to, "time_s,sample")?;
                    for d in 1..=columns.0 {
                        write!(self.to, ",p{d}")?;
                    }
                    for viseme in VISEMES.iter().take(columns.1) {
                        write!(self.to, ",{viseme}")?;
                    }
                    if columns.2 {
                        write!(self.to, ",gap,width")?;
                    }
                    writeln!(self.to)?;
                }
            }
            Event::Frame(timed) => {
                write!(self.to, "{:.4},{}", seconds(timed.sample as usize), timed.sample)?;
                for value in timed.parameters() {
                    write!(self.to, ",{value}")?;
                }
                for weight in timed.visemes() {
                    write!(self.to, ",{weight:.3}")?;
                }
                if let Some(opening) = timed.opening() {
                    write!(self.to, ",{:.3},{:.3}", opening.gap, opening.width)?;
                }
                writeln!(self.to)?;
            }
            _ => return Ok(()),
        }
        self.to.flush()
    }
}
