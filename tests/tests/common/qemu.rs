//! QEMU's mps2-an386 with lipstream's firmware in it.
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use lipstream::link::Link;
use lipstream_core::wire::{MAX_ENCODED, Pcm, ToDevice, ToHost, encode};

/// Longest that anything may take; for a machine that is busy with other things.
const PATIENCE: Duration = Duration::from_secs(300);

/// QEMU with `program` in it, `words` as its command line; nothing on the serial lines yet.
fn qemu(program: &Path, words: &[&str]) -> Command {
    let mut semihosting = "enable=on,target=native,arg=lipstream".to_owned();
    for word in words {
        semihosting += &format!(",arg={word}");
    }
    let mut command = Command::new("qemu-system-arm");
    command
        .args(["-machine", "mps2-an386", "-display", "none", "-monitor", "none"])
        .args(["-semihosting-config", &semihosting, "-kernel"])
        .arg(program)
        .stdin(Stdio::null());
    command
}

/// Runs the firmware on a file of samples: what it would have sent, and what it said.
pub(crate) fn run_on_file(program: &Path, folder: &Path, samples: &[i16]) -> (Vec<u8>, String) {
    run_on_file_with(program, folder, samples, &[])
}

/// The same with more words for QEMU.
pub(crate) fn run_on_file_with(
    program: &Path,
    folder: &Path,
    samples: &[i16],
    words: &[&str],
) -> (Vec<u8>, String) {
    let bytes: Vec<u8> = samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    std::fs::write(folder.join("input.pcm"), bytes).expect("write the samples");
    let output = qemu(program, &["--files"])
        .args(words)
        .current_dir(folder)
        .output()
        .expect("run qemu-system-arm");
    let said =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    (
        std::fs::read(folder.join("output.wire")).expect("what was sent"),
        said,
    )
}

/// Runs a program that must end by itself without success; what it said.
pub(crate) fn refuses(program: &Path) -> String {
    let output = qemu(program, &[])
        .args(["-serial", "null"])
        .output()
        .expect("run qemu-system-arm");
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// A machine whose UART0 is at hand.
pub(crate) struct Machine {
    _running: lipstream_live::qemu::Machine,
    line: TcpStream,
}

impl Machine {
    pub(crate) fn boot(program: &Path) -> Self {
        let (running, line) = lipstream_live::qemu::Machine::start(program).expect("run qemu-system-arm");
        line.set_read_timeout(Some(PATIENCE)).expect("a limit");
        line.set_write_timeout(Some(PATIENCE)).expect("a limit");
        Self {
            _running: running,
            line,
        }
    }

    pub(crate) fn send_bytes(&mut self, bytes: &[u8]) {
        self.line.write_all(bytes).expect("the machine takes bytes");
    }

    pub(crate) fn send(&mut self, message: ToDevice) {
        self.send_bytes(&bytes(message));
    }

    /// Sends `line` while messages come in, until `done` says of all so far that no more will come.
    pub(crate) fn talk(
        &mut self,
        line: Vec<u8>,
        link: &mut Link,
        done: impl Fn(&[ToHost]) -> bool,
    ) -> Vec<ToHost> {
        let mut sender = self.line.try_clone().expect("a second handle");
        let sending = std::thread::spawn(move || sender.write_all(&line));
        let mut messages = Vec::new();
        let mut buffer = [0; 4096];
        while !done(&messages) {
            let count = self.line.read(&mut buffer).expect("messages from the machine");
            assert!(count > 0, "the machine hung up after {} messages", messages.len());
            link.push(&buffer[..count], |message| messages.push(message))
                .expect("our own protocol and model");
        }
        sending
            .join()
            .expect("the sender")
            .expect("the machine takes bytes");
        messages
    }
}

/// A message as the device takes it.
pub(crate) fn bytes(message: ToDevice) -> Vec<u8> {
    encode(&message, &mut [0; MAX_ENCODED]).expect("room").to_vec()
}

/// `Pcm` messages of `samples`, `length` in each.
pub(crate) fn pcm(samples: &[i16], length: usize) -> Vec<Vec<u8>> {
    (0..)
        .zip(samples.chunks(length))
        .map(|(sequence, part)| bytes(ToDevice::Pcm(Pcm::new(sequence, part, &mut [0; 320]))))
        .collect()
}
