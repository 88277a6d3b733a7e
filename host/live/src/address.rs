//! Where a device is: the words of a command line, and the search for one that is plugged in.
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Bytes a second on a serial line divided by 10, unless asked for: what the boards' firmware uses.
pub const BAUD: u32 = 115_200;

/// Where bytes come from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// A serial port.
    Serial {
        /// The port's name: `/dev/ttyACM0`, `COM3`.
        port: PathBuf,
        /// Bits a second.
        baud: u32,
    },
    /// A device, or another program, behind a TCP port.
    Tcp(String),
    /// A recorded stream.
    Recording(PathBuf),
    /// Standard input.
    Stdin,
    /// The firmware in QEMU, which is started for it.
    Qemu(PathBuf),
}

/// Why words are no address.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AddressError {
    /// Neither a port nor a file.
    #[error(
        "{0}: no such port or file; a source is a serial port (/dev/ttyACM0, /dev/ttyACM0@1000000), tcp://HOST:PORT, a recorded stream, or -"
    )]
    Unknown(String),
    /// What follows `@` is no rate.
    #[error("{0}: what follows @ is no number of bits a second")]
    Baud(String),
    /// A TCP address without its port.
    #[error("tcp://{0}: the port is missing (tcp://HOST:PORT)")]
    Port(String),
    /// Several devices are there.
    #[error("{} devices are attached: name one of {}", .0.len(), list(.0))]
    Several(Vec<PathBuf>),
    /// None is.
    #[error("no device is attached")]
    None,
}

fn list(ports: &[PathBuf]) -> String {
    let names: Vec<String> = ports.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(words: &str) -> Result<Self, AddressError> {
        if words == "-" {
            return Ok(Address::Stdin);
        }
        if let Some(place) = words.strip_prefix("tcp://") {
            let has_port = place
                .rsplit_once(':')
                .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok());
            return match has_port {
                true => Ok(Address::Tcp(place.to_owned())),
                false => Err(AddressError::Port(place.to_owned())),
            };
        }
        let (port, baud) = match words.rsplit_once('@') {
            Some((port, baud)) if !Path::new(words).exists() => {
                let baud = baud.parse().ok().filter(|baud| *baud > 0);
                (port, baud.ok_or_else(|| AddressError::Baud(words.to_owned()))?)
            }
            _ => (words, BAUD),
        };
        let serial = Address::Serial {
            port: PathBuf::from(port),
            baud,
        };
        if is_port_name(port) {
            // A port may be named before the device is plugged in.
            return Ok(serial);
        }
        match std::fs::metadata(port) {
            Ok(about) if about.is_file() => Ok(Address::Recording(PathBuf::from(port))),
            Ok(about) if !about.is_dir() => Ok(serial),
            _ => Err(AddressError::Unknown(words.to_owned())),
        }
    }
}

/// Whether a name is one that serial ports have.
fn is_port_name(name: &str) -> bool {
    let windows = name.strip_prefix("COM").is_some_and(|n| n.parse::<u8>().is_ok());
    windows
        || ["/dev/tty", "/dev/cu.", "/dev/serial/"]
            .iter()
            .any(|start| name.starts_with(start))
}

impl Address {
    /// The one device that is plugged in.
    ///
    /// # Errors
    ///
    /// [`AddressError::None`] or [`AddressError::Several`].
    pub fn find() -> Result<Self, AddressError> {
        let mut ports: Vec<PathBuf> = serial2::SerialPort::available_ports()
            .unwrap_or_default()
            .into_iter()
            .filter(|port| is_device(&port.to_string_lossy()))
            .collect();
        ports.sort();
        match ports.len() {
            0 => Err(AddressError::None),
            1 => Ok(Address::Serial {
                port: ports.remove(0),
                baud: BAUD,
            }),
            _ => Err(AddressError::Several(ports)),
        }
    }

    /// Whether it listens.
    pub fn obeys(&self) -> bool {
        !matches!(self, Address::Recording(_) | Address::Stdin)
    }

    /// Whether one can wait for it to come back.
    pub fn comes_back(&self) -> bool {
        matches!(self, Address::Serial { .. } | Address::Tcp(_))
    }
}

/// Whether a port is one that boards have: the computer's own sockets (`ttyS0`) are there whether or not something is plugged in.
fn is_device(port: &str) -> bool {
    ["ttyACM", "ttyUSB", "cu.usb", "tty.usb", "COM"]
        .iter()
        .any(|part| port.contains(part))
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Address::Serial { port, baud } if *baud == BAUD => write!(f, "{}", port.display()),
            Address::Serial { port, baud } => write!(f, "{}@{baud}", port.display()),
            Address::Tcp(place) => write!(f, "tcp://{place}"),
            Address::Recording(path) => write!(f, "{}", path.display()),
            Address::Stdin => write!(f, "standard input"),
            Address::Qemu(_) => write!(f, "the firmware in QEMU"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_become_addresses() {
        let parse = |words: &str| words.parse::<Address>();
        let serial = |port: &str, baud| {
            Ok(Address::Serial {
                port: port.into(),
                baud,
            })
        };
        assert_eq!(parse("-"), Ok(Address::Stdin));
        assert_eq!(parse("/dev/ttyACM7"), serial("/dev/ttyACM7", BAUD));
        assert_eq!(parse("/dev/ttyUSB0@1000000"), serial("/dev/ttyUSB0", 1_000_000));
        assert_eq!(parse("COM3"), serial("COM3", BAUD));
        assert_eq!(parse("tcp://box:4000"), Ok(Address::Tcp("box:4000".to_owned())));
        assert_eq!(parse("tcp://box"), Err(AddressError::Port("box".to_owned())));
        assert!(matches!(parse("/dev/ttyACM0@fast"), Err(AddressError::Baud(_))));
        assert!(matches!(parse("no/such/thing"), Err(AddressError::Unknown(_))));
        let file = tempfile::NamedTempFile::new().unwrap();
        let path = file.path().to_owned();
        assert_eq!(parse(path.to_str().unwrap()), Ok(Address::Recording(path)));
        for address in ["/dev/ttyACM0@1000000", "/dev/ttyACM0", "tcp://[::1]:80"] {
            assert_eq!(parse(address).unwrap().to_string(), address);
        }
    }

    #[test]
    fn the_computers_own_ports_are_no_devices() {
        assert!(is_device("/dev/ttyACM0") && is_device("COM4") && !is_device("/dev/ttyS0"));
        let several = AddressError::Several(vec!["/dev/ttyACM0".into(), "/dev/ttyACM1".into()]);
        assert_eq!(
            several.to_string(),
            "2 devices are attached: name one of /dev/ttyACM0, /dev/ttyACM1"
        );
    }
}
