//! The firmware in QEMU's mps2-an386, its serial line at hand.
use std::io;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// How long the machine may take to connect its line.
const PATIENCE: Duration = Duration::from_secs(20);

/// A running machine; it ends with this value.
pub struct Machine(Child);

impl Machine {
    /// Starts `program`, an ELF file for the board, and waits until its line is connected.
    ///
    /// # Errors
    ///
    /// That there is no `program` or no QEMU, or that it ends at once.
    pub fn start(program: &Path) -> io::Result<(Self, TcpStream)> {
        if !program.is_file() {
            let what = format!("no firmware at {}", program.display());
            return Err(io::Error::new(io::ErrorKind::NotFound, what));
        }
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let child = Command::new("qemu-system-arm")
            .args(["-machine", "mps2-an386", "-display", "none", "-monitor", "none"])
            .args([
                "-semihosting-config",
                "enable=on,target=native,arg=lipstream",
                "-kernel",
            ])
            .arg(program)
            .args([
                "-chardev",
                &format!("socket,id=line,host=127.0.0.1,port={port},nodelay=on"),
            ])
            .args(["-serial", "chardev:line"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .map_err(|e| match e.kind() {
                io::ErrorKind::NotFound => io::Error::new(
                    e.kind(),
                    "qemu-system-arm is missing (Debian: apt install qemu-system-arm)",
                ),
                _ => e,
            })?;
        let mut machine = Self(child);
        let began = Instant::now();
        loop {
            match listener.accept() {
                Ok((line, _)) => {
                    line.set_nonblocking(false)?;
                    return Ok((machine, line));
                }
                Err(e) if e.kind() == io::ErrorKind::WouldBlock && began.elapsed() < PATIENCE => {
                    if let Some(status) = machine.0.try_wait()? {
                        return Err(io::Error::other(format!("QEMU ended: {status}")));
                    }
                    std::thread::sleep(Duration::from_millis(5));
                }
                Err(e) => return Err(e),
            }
        }
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
