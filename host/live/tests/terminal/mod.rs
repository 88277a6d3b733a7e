//! A pseudo-terminal as a serial device: the host opens one end by its name, the test holds the other.
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd as _, OwnedFd};
use std::path::PathBuf;
use std::time::{Duration, Instant};

use lipstream_live::address::Address;
use nix::fcntl::OFlag;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};

use super::{Plug, Socket};

/// A name that stays, as `/dev/serial/by-id` has them, for terminals that come and go.
pub(crate) struct Terminal {
    folder: tempfile::TempDir,
    /// Made before anybody opens it.
    next: Option<Master>,
}

impl Terminal {
    pub(crate) fn new() -> Self {
        let mut terminal = Self {
            folder: tempfile::tempdir().unwrap(),
            next: None,
        };
        terminal.next = Some(terminal.make());
        terminal
    }

    fn name(&self) -> PathBuf {
        self.folder.path().join("ttyTEST0")
    }

    fn make(&self) -> Master {
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname_r(&master).unwrap();
        let link = self.name();
        let _ = std::fs::remove_file(&link);
        std::os::unix::fs::symlink(name, &link).unwrap();
        Master(owned(master))
    }
}

fn owned(master: PtyMaster) -> File {
    let fd: OwnedFd = master.into();
    File::from(fd)
}

impl Socket for Terminal {
    fn address(&self) -> Address {
        Address::Serial {
            port: self.name(),
            baud: 115_200,
        }
    }

    /// The host is there when it has said its greeting.
    fn plug(&mut self) -> Box<dyn Plug> {
        let master = self.next.take().unwrap_or_else(|| self.make());
        let began = Instant::now();
        while !master.says_something(50u16).is_ok_and(|says| says) {
            assert!(
                began.elapsed() < Duration::from_secs(10),
                "nobody opens the terminal"
            );
            std::thread::sleep(Duration::from_millis(5));
        }
        Box::new(master)
    }
}

/// The device's end.
struct Master(File);

impl Plug for Master {}

impl Master {
    /// Whether there is something to read, within so many milliseconds.
    fn says_something(&self, within: u16) -> io::Result<bool> {
        let mut wanted = [PollFd::new(self.0.as_fd(), PollFlags::POLLIN)];
        poll(&mut wanted, PollTimeout::from(within))?;
        Ok(wanted[0]
            .revents()
            .is_some_and(|events| events.contains(PollFlags::POLLIN)))
    }
}

impl Read for Master {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        // Nothing for ten seconds is an error, as on the TCP line.
        match self.says_something(10_000)? {
            true => self.0.read(buffer),
            false => Err(io::ErrorKind::TimedOut.into()),
        }
    }
}

impl Write for Master {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
