//! Bytes between the application and the interrupts that serve a serial port: a queue each way, neither side ever waits for the other.
use core::sync::atomic::{AtomicBool, Ordering};

use heapless::spsc::{Consumer, Producer, Queue};

use crate::Line;
use crate::pace::uart_bytes_per_second;

/// Bytes that wait for the host: a frame is 100 bytes at most with the shipped model, so some ten of them.
pub const OUT: usize = 1024;
/// Bytes that wait for the application: one longest message and more.
pub const IN: usize = 1024;

/// The queues of a port, in a static.
#[derive(Debug)]
pub struct Queues {
    out: Queue<u8, OUT>,
    inward: Queue<u8, IN>,
    /// Whether somebody may listen.
    open: AtomicBool,
}

impl Queues {
    /// Empty, for a port that is open until it says otherwise.
    pub const fn new() -> Self {
        Self {
            out: Queue::new(),
            inward: Queue::new(),
            open: AtomicBool::new(true),
        }
    }

    /// The application's end and the port's.
    pub fn split(&mut self) -> (AppEnd<'_>, PortEnd<'_>) {
        let (out_in, out_out) = self.out.split();
        let (inward_in, inward_out) = self.inward.split();
        let app = AppEnd {
            out: out_in,
            inward: inward_out,
            open: &self.open,
        };
        let port = PortEnd {
            out: out_out,
            inward: inward_in,
            open: &self.open,
            piece: [0; 64],
            filled: 0,
            taken: 0,
        };
        (app, port)
    }
}

/// What the application holds.
pub struct AppEnd<'q> {
    out: Producer<'q, u8>,
    inward: Consumer<'q, u8>,
    open: &'q AtomicBool,
}

impl AppEnd<'_> {
    /// All of `bytes`, or none of them and false where there is no room for all. Where nobody listens nobody misses anything: true.
    pub fn send(&mut self, bytes: &[u8]) -> bool {
        if !self.open.load(Ordering::Relaxed) {
            return true;
        }
        let fits = self.out.capacity() - self.out.len() >= bytes.len();
        // The other end only takes away: what fits now still fits when it is written.
        fits && bytes.iter().all(|byte| self.out.enqueue(*byte).is_ok())
    }

    /// A byte from the host.
    pub fn receive(&mut self) -> Option<u8> {
        self.inward.dequeue()
    }
}

impl Default for Queues {
    fn default() -> Self {
        Self::new()
    }
}

/// What the interrupt holds.
pub struct PortEnd<'q> {
    out: Consumer<'q, u8>,
    inward: Producer<'q, u8>,
    open: &'q AtomicBool,
    /// Bytes out of the queue, of which the line took the first `taken`.
    piece: [u8; 64],
    filled: usize,
    taken: usize,
}

impl PortEnd<'_> {
    /// Gives waiting bytes to `write`, which says how many of them it took, until it takes none or there are no more. Whether all are gone.
    pub fn drain(&mut self, mut write: impl FnMut(&[u8]) -> usize) -> bool {
        loop {
            if self.taken == self.filled {
                (self.taken, self.filled) = (0, 0);
                while let Some(to) = self.piece.get_mut(self.filled) {
                    let Some(byte) = self.out.dequeue() else { break };
                    *to = byte;
                    self.filled += 1;
                }
            }
            let rest = &self.piece[self.taken..self.filled];
            if rest.is_empty() {
                return true;
            }
            let taken = write(rest).min(rest.len());
            self.taken += taken;
            if taken == 0 {
                return false;
            }
        }
    }

    /// Whether a program on the host has the port open.
    pub fn set_open(&mut self, open: bool) {
        self.open.store(open, Ordering::Relaxed);
    }

    /// Forgets what waits for a host that is not there.
    pub fn discard(&mut self) {
        self.taken = self.filled;
        while self.out.dequeue().is_some() {}
    }

    /// Bytes that [`PortEnd::received`] has room for.
    pub fn room(&self) -> usize {
        self.inward.capacity() - self.inward.len()
    }

    /// Bytes from the host; those past [`PortEnd::room`] are lost, which its CRC shows the receiver.
    pub fn received(&mut self, bytes: &[u8]) {
        for byte in bytes {
            if self.inward.enqueue(*byte).is_err() {
                break;
            }
        }
    }
}

/// Two ports that say the same; either may be left unplugged.
pub struct Ports {
    /// USB: as fast as may be.
    pub usb: AppEnd<'static>,
    /// A UART of so many baud, which sets the pace.
    pub uart: AppEnd<'static>,
    /// The UART's.
    pub baud: u32,
    /// Tells both to take what waits.
    pub serve: fn(),
}

impl Line for Ports {
    fn send(&mut self, bytes: &[u8]) -> bool {
        let usb = self.usb.send(bytes);
        let uart = self.uart.send(bytes);
        (self.serve)();
        usb && uart
    }

    fn bytes_per_second(&self) -> Option<u32> {
        Some(uart_bytes_per_second(self.baud))
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    #[test]
    fn frames_go_whole_or_not_at_all() {
        let mut queues = Queues::new();
        let (mut app, mut port) = queues.split();
        let frame = [7; 100];
        let sent = (0..20).take_while(|_| app.send(&frame)).count();
        assert_eq!(sent, (OUT - 1) / 100);
        // A line that takes 30 bytes a call, and then no more.
        let (mut seen, mut calls) = (0, 0);
        let gone = port.drain(|bytes| {
            calls += 1;
            assert!(bytes.iter().all(|byte| *byte == 7));
            let taken = if calls <= 4 { bytes.len().min(30) } else { 0 };
            seen += taken;
            taken
        });
        assert!(!gone);
        // Pieces of 64 bytes: 30, 30 and the 4 left over, then 30 of the next.
        assert_eq!(seen, 94);
        assert!(app.send(&frame), "there is room again");
        assert!(port.drain(<[u8]>::len));
        assert!(app.send(&frame));
        port.discard();
        assert!(port.drain(|_| panic!("nothing waits")));
        // Whoever is not there misses nothing, however much it is.
        port.set_open(false);
        assert!((0..50).all(|_| app.send(&frame)));
        assert!(port.drain(|_| panic!("nothing waits")));
    }

    #[test]
    fn bytes_come_in_order_and_too_many_do_no_harm() {
        let mut queues = Queues::new();
        let (mut app, mut port) = queues.split();
        let room = port.room();
        assert_eq!(room, IN - 1);
        let bytes: Vec<u8> = (0..IN + 50).map(|i| i as u8).collect();
        port.received(&bytes);
        assert_eq!(port.room(), 0);
        let got: Vec<u8> = std::iter::from_fn(|| app.receive()).collect();
        assert_eq!(got, bytes[..room]);
    }
}
