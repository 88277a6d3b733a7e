//! To other programs, live: what their characters take, as their makers publish it.
//!
//! To add one: a file here with its [`Output`], and its word in [`Target`].
use std::fmt;
use std::io::{self, BufWriter, Write};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

use lipstream_media::files;

use crate::event::{Event, Level, Notice};
use crate::hub::{Hub, Missed};

mod e131;
mod lines;
mod live_link;
mod vmc;

pub use e131::E131;
pub(crate) use lines::profile_of;
pub use lines::{Csv, JsonLines, json};
pub use live_link::LiveLink;
pub use vmc::Vmc;

/// Something that takes events.
pub trait Output: Send {
    /// Takes an event.
    ///
    /// # Errors
    ///
    /// That it cannot be passed on.
    fn event(&mut self, event: &Event) -> io::Result<()>;
}

/// Where to, in words of a command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// Avatars that speak the VMC protocol.
    Vmc(String),
    /// Unreal Engine's Live Link Face.
    LiveLink(String),
    /// DMX over Ethernet: one channel a shape.
    E131 {
        /// Host and port.
        place: String,
        /// 1 to 63999.
        universe: u16,
    },
    /// JSON, one object a line; None is standard output.
    Json(Option<PathBuf>),
    /// Rows of numbers; None is standard output.
    Csv(Option<PathBuf>),
}

/// Why words are no target.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0}: a target is vmc://HOST:PORT, livelink://HOST:PORT, e131://HOST/UNIVERSE, json:FILE or csv:FILE (- is standard output)"
)]
pub struct TargetError(String);

impl FromStr for Target {
    type Err = TargetError;

    fn from_str(words: &str) -> Result<Self, TargetError> {
        let error = || TargetError(words.to_owned());
        if let Some(place) = words.strip_prefix("vmc://") {
            return with_port(place, vmc::PORT).map(Target::Vmc).ok_or_else(error);
        }
        if let Some(place) = words.strip_prefix("livelink://") {
            return with_port(place, live_link::PORT)
                .map(Target::LiveLink)
                .ok_or_else(error);
        }
        if let Some(rest) = words.strip_prefix("e131://") {
            let (place, universe) = rest.split_once('/').ok_or_else(error)?;
            let universe = universe.parse().ok().filter(|u| (1..64_000).contains(u));
            return Ok(Target::E131 {
                place: with_port(place, e131::PORT).ok_or_else(error)?,
                universe: universe.ok_or_else(error)?,
            });
        }
        let file = |name: &str| match name {
            "" => Err(error()),
            "-" => Ok(None),
            name => Ok(Some(PathBuf::from(name))),
        };
        match words.split_once(':') {
            Some(("json", name)) => file(name).map(Target::Json),
            Some(("csv", name)) => file(name).map(Target::Csv),
            _ => Err(error()),
        }
    }
}

/// `HOST` or `HOST:PORT` with its port.
fn with_port(place: &str, port: u16) -> Option<String> {
    let bracketed_or_none = place
        .rsplit_once(':')
        .is_none_or(|(host, _)| host.contains(':') && place.ends_with(']'));
    match place {
        "" => None,
        place if bracketed_or_none => Some(format!("{place}:{port}")),
        place => {
            let (host, port) = place.rsplit_once(':')?;
            (!host.is_empty() && port.parse::<u16>().is_ok()).then(|| place.to_owned())
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::Vmc(place) => write!(f, "vmc://{place}"),
            Target::LiveLink(place) => write!(f, "livelink://{place}"),
            Target::E131 { place, universe } => write!(f, "e131://{place}/{universe}"),
            Target::Json(Some(path)) | Target::Csv(Some(path)) => write!(f, "{}", path.display()),
            Target::Json(None) | Target::Csv(None) => write!(f, "standard output"),
        }
    }
}

impl Target {
    /// Whether it writes to standard output.
    pub fn is_standard(&self) -> bool {
        matches!(self, Target::Json(None) | Target::Csv(None))
    }

    /// Opens it.
    ///
    /// # Errors
    ///
    /// That the host has no address, or the file cannot be made.
    pub fn open(&self) -> io::Result<Box<dyn Output>> {
        Ok(match self {
            Target::Vmc(place) => Box::new(Vmc::new(Datagrams::to(place)?)),
            Target::LiveLink(place) => Box::new(LiveLink::new(Datagrams::to(place)?)),
            Target::E131 { place, universe } => Box::new(E131::new(Datagrams::to(place)?, *universe)),
            Target::Json(path) => Box::new(JsonLines::new(writer(path.as_ref())?)),
            Target::Csv(path) => Box::new(Csv::new(writer(path.as_ref())?)),
        })
    }
}

fn writer(path: Option<&PathBuf>) -> io::Result<Box<dyn Write + Send>> {
    Ok(match path {
        Some(path) => Box::new(BufWriter::new(files::create_anew(path)?)),
        None => Box::new(io::stdout()),
    })
}

/// Datagrams to one address. That nobody hears them is no error: whoever listens may come later.
pub struct Datagrams {
    socket: UdpSocket,
    to: SocketAddr,
}

impl Datagrams {
    /// Datagrams to `HOST:PORT`.
    ///
    /// # Errors
    ///
    /// That the host has no address.
    pub fn to(place: &str) -> io::Result<Self> {
        let found = place.to_socket_addrs()?.next();
        let to = found.ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such host"))?;
        let any = match to {
            SocketAddr::V4(_) => "0.0.0.0:0",
            SocketAddr::V6(_) => "[::]:0",
        };
        Ok(Self {
            socket: UdpSocket::bind(any)?,
            to,
        })
    }

    fn send(&self, bytes: &[u8]) -> io::Result<()> {
        match self.socket.send_to(bytes, self.to) {
            // The last datagram found nobody there.
            Err(e) if e.kind() == io::ErrorKind::ConnectionRefused => Ok(()),
            Err(e) => Err(e),
            Ok(_) => Ok(()),
        }
    }
}

/// Passes on what the hub says, on a thread of its own. An output that fails says so once and ends; one that is slow loses events, and is told.
pub fn start(hub: &Arc<Hub>, name: &str, mut output: Box<dyn Output>) -> std::thread::JoinHandle<()> {
    let (before, mut events) = hub.watch();
    let hub = Arc::downgrade(hub);
    let name = name.to_owned();
    std::thread::spawn(move || {
        let tell = |level, text: String| {
            if let Some(hub) = hub.upgrade() {
                hub.send(Event::Notice(Notice {
                    level,
                    text: text.into(),
                }));
            }
        };
        for event in before {
            if output.event(&event).is_err() {
                break;
            }
        }
        loop {
            let result = match events.wait() {
                Ok(event) => output.event(&event),
                Err(Missed::Slow(lost)) => {
                    tell(
                        Level::Warning,
                        format!("{name} is too slow: {lost} events left out"),
                    );
                    Ok(())
                }
                Err(Missed::Over) => return,
            };
            if let Err(error) = result {
                tell(Level::Error, format!("{name}: {error}"));
                return;
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_targets() {
        let parse = |words: &str| words.parse::<Target>().map_err(|e| e.to_string());
        assert_eq!(parse("vmc://box"), Ok(Target::Vmc("box:39539".to_owned())));
        assert_eq!(parse("vmc://box:1"), Ok(Target::Vmc("box:1".to_owned())));
        assert_eq!(
            parse("livelink://[::1]"),
            Ok(Target::LiveLink("[::1]:11111".to_owned()))
        );
        let universe = |place: &str, universe| {
            Ok(Target::E131 {
                place: place.to_owned(),
                universe,
            })
        };
        assert_eq!(parse("e131://10.0.0.7/3"), universe("10.0.0.7:5568", 3));
        assert_eq!(parse("json:-"), Ok(Target::Json(None)));
        assert_eq!(parse("csv:a.csv"), Ok(Target::Csv(Some("a.csv".into()))));
        for wrong in [
            "",
            "vmc://",
            "vmc://a:b",
            "e131://box",
            "e131://box/0",
            "json:",
            "osc://box:1",
        ] {
            let error = parse(wrong).unwrap_err();
            assert!(error.starts_with(&format!("{wrong}: a target is")), "{error}");
        }
    }
}
