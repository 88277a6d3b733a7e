//! Ways for bytes, opened.
use std::io::{self, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::time::Duration;

use serial2::SerialPort;

use crate::qemu::Machine;

/// How long a reader waits for bytes before it looks whether it is still wanted.
const PATIENCE: Duration = Duration::from_millis(100);
/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(3);

/// Both ways of a line.
pub(crate) struct Port {
    pub(crate) read: Box<dyn Read + Send>,
    /// None where nobody listens at the other end.
    pub(crate) write: Option<Box<dyn Write + Send>>,
    /// What runs as long as the line is used.
    pub(crate) machine: Option<Machine>,
}

/// A serial port.
pub(crate) fn serial(port: &Path, baud: u32) -> io::Result<Port> {
    let mut read = SerialPort::open(port, baud)?;
    read.set_read_timeout(PATIENCE)?;
    // What the system kept for whoever read before is of no use.
    let _ = read.discard_input_buffer();
    let write = read.try_clone()?;
    Ok(Port {
        read: Box::new(read),
        write: Some(Box::new(write)),
        machine: None,
    })
}

/// A TCP connection to `HOST:PORT`.
pub(crate) fn tcp(place: &str) -> io::Result<Port> {
    let found = place.to_socket_addrs()?.next();
    let place = found.ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such host"))?;
    of_tcp(TcpStream::connect_timeout(&place, CONNECT)?, None)
}

/// The firmware's line, in a machine that is started for it.
pub(crate) fn qemu(program: &Path) -> io::Result<Port> {
    let (machine, line) = Machine::start(program)?;
    of_tcp(line, Some(machine))
}

/// Standard input: nobody listens at its other end.
pub(crate) fn stdin() -> Port {
    Port {
        read: Box::new(io::stdin()),
        write: None,
        machine: None,
    }
}

fn of_tcp(line: TcpStream, machine: Option<Machine>) -> io::Result<Port> {
    line.set_nodelay(true)?;
    line.set_read_timeout(Some(PATIENCE))?;
    Ok(Port {
        write: Some(Box::new(line.try_clone()?)),
        read: Box::new(line),
        machine,
    })
}

/// Whether a reader only has to try again.
pub(crate) fn is_patience(error: &io::Error) -> bool {
    use io::ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), TimedOut | WouldBlock | Interrupted)
}
