//! Bytes between the application and the interrupts that serve a serial port: a queue each way, neither side ever waits for the other.
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};

use crate::Line;
use crate::pace::uart_bytes_per_second;

/// Bytes that wait for the host: a frame is 100 bytes at most with the shipped model, so some ten of them.
pub const OUT: usize = 1024;
/// Bytes that wait for the application: one longest message and more.
pub const IN: usize = 1024;

/// Bytes from one end to the other, N of them at most, a power of two. One end writes, one reads; each may be interrupted by the other.
#[derive(Debug)]
struct ByteQueue<const N: usize> {
    bytes: [AtomicU8; N],
    /// Bytes written and read since the start, modulo 2³².
    written: AtomicU32,
    read: AtomicU32,
}

impl<const N: usize> ByteQueue<N> {
    const MASK: usize = {
        assert!(N.is_power_of_two());
        N - 1
    };

    const fn new() -> Self {
        Self {
            bytes: [const { AtomicU8::new(0) }; N],
            written: AtomicU32::new(0),
            read: AtomicU32::new(0),
        }
    }

    fn len(&self) -> usize {
        let written = self.written.load(Ordering::Acquire);
        written.wrapping_sub(self.read.load(Ordering::Acquire)) as usize
    }

    fn room(&self) -> usize {
        N - self.len()
    }

    /// As many of the bytes as there is room for.
    fn write(&self, bytes: &[u8]) {
        let written = self.written.load(Ordering::Relaxed);
        let count = bytes.len().min(self.room());
        for (i, byte) in bytes.iter().enumerate().take(count) {
            self.bytes[(written as usize + i) & Self::MASK].store(*byte, Ordering::Relaxed);
        }
        // Only now does the other end see them.
        self.written
            .store(written.wrapping_add(count as u32), Ordering::Release);
    }

    /// As many bytes as there are and fit; how many.
    fn read(&self, to: &mut [u8]) -> usize {
        let read = self.read.load(Ordering::Relaxed);
        let count = to.len().min(self.len());
        for (i, to) in to.iter_mut().enumerate().take(count) {
            *to = self.bytes[(read as usize + i) & Self::MASK].load(Ordering::Relaxed);
        }
        self.read
            .store(read.wrapping_add(count as u32), Ordering::Release);
        count
    }

    fn discard(&self) {
        self.read
            .store(self.written.load(Ordering::Acquire), Ordering::Release);
    }
}

/// The queues of a port, in a static.
#[derive(Debug)]
pub struct Queues {
    out: ByteQueue<OUT>,
    inward: ByteQueue<IN>,
    /// Nobody listens. This way round all of it is zeros at first.
    closed: AtomicBool,
}

impl Queues {
    /// Empty, for a port that is open until it says otherwise.
    pub const fn new() -> Self {
        Self {
            out: ByteQueue::new(),
            inward: ByteQueue::new(),
            closed: AtomicBool::new(false),
        }
    }

    /// The application's end and the port's.
    pub fn split(&mut self) -> (AppEnd<'_>, PortEnd<'_>) {
        let queues = &*self;
        let port = PortEnd {
            queues,
            piece: [0; 64],
            filled: 0,
            taken: 0,
        };
        (AppEnd { queues }, port)
    }
}

/// What the application holds.
#[derive(Debug)]
pub struct AppEnd<'q> {
    queues: &'q Queues,
}

impl AppEnd<'_> {
    /// All of `bytes`, or none of them and false where there is no room for all. Where nobody listens nobody misses anything: true.
    pub fn send(&mut self, bytes: &[u8]) -> bool {
        if self.queues.closed.load(Ordering::Relaxed) {
            return true;
        }
        // The other end only takes away: what fits now still fits when it is written.
        let fits = self.queues.out.room() >= bytes.len();
        if fits {
            self.queues.out.write(bytes);
        }
        fits
    }

    /// A byte from the host.
    pub fn receive(&mut self) -> Option<u8> {
        let mut byte = [0];
        (self.queues.inward.read(&mut byte) == 1).then_some(byte[0])
    }
}

impl Default for Queues {
    fn default() -> Self {
        Self::new()
    }
}

/// What the interrupt holds.
#[derive(Debug)]
pub struct PortEnd<'q> {
    queues: &'q Queues,
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
                self.taken = 0;
                self.filled = self.queues.out.read(&mut self.piece);
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
        self.queues.closed.store(!open, Ordering::Relaxed);
    }

    /// Forgets what waits for a host that is not there.
    pub fn discard(&mut self) {
        self.taken = self.filled;
        self.queues.out.discard();
    }

    /// Bytes that [`PortEnd::received`] has room for.
    pub fn room(&self) -> usize {
        self.queues.inward.room()
    }

    /// Bytes from the host; those past [`PortEnd::room`] are lost, which its CRC shows the receiver.
    pub fn received(&mut self, bytes: &[u8]) {
        self.queues.inward.write(bytes);
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
        assert_eq!(sent, OUT / 100);
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
        assert_eq!(room, IN);
        let bytes: Vec<u8> = (0..IN + 50).map(|i| i as u8).collect();
        port.received(&bytes);
        assert_eq!(port.room(), 0);
        let got: Vec<u8> = std::iter::from_fn(|| app.receive()).collect();
        assert_eq!(got, bytes[..room]);
    }
}
