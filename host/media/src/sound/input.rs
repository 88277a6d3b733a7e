//! Bytes that come once and in order, from a file, a pipe or memory, of which the first can be looked at before they are taken.
use std::io::{self, BufReader, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes that are asked of the source at a time.
const AT_A_TIME: usize = 1 << 16;

/// A source whose bytes are counted as they are read, for whoever holds the counter: a decoder keeps the source itself.
pub(super) struct Counted<R>(pub(super) R, pub(super) Arc<AtomicU64>);

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let read = self.0.read(to)?;
        self.1.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

/// A source of bytes.
pub(super) struct Input<'a> {
    source: BufReader<Box<dyn Read + Send + 'a>>,
    /// Bytes that have been looked at and not yet taken, from `taken` on.
    seen: Vec<u8>,
    taken: usize,
    /// Bytes taken so far.
    at: u64,
    length: Option<u64>,
}

impl<'a> Input<'a> {
    /// `length` is None where it shows only at the end, as on a pipe.
    pub(super) fn new(source: Box<dyn Read + Send + 'a>, length: Option<u64>) -> Self {
        Self {
            source: BufReader::with_capacity(AT_A_TIME, source),
            seen: Vec::new(),
            taken: 0,
            at: 0,
            length,
        }
    }

    /// Bytes of the whole source, where that is known.
    pub(super) fn length(&self) -> Option<u64> {
        self.length
    }

    /// Bytes taken so far.
    pub(super) fn at(&self) -> u64 {
        self.at
    }

    /// The next `count` bytes, fewer only where the source ends before; they stay to be taken.
    pub(super) fn peek(&mut self, count: usize) -> io::Result<&[u8]> {
        if self.taken > 0 {
            self.seen.drain(..self.taken);
            self.taken = 0;
        }
        if let Some(more) = count.checked_sub(self.seen.len()).filter(|more| *more > 0) {
            (&mut self.source).take(more as u64).read_to_end(&mut self.seen)?;
        }
        Ok(&self.seen[..count.min(self.seen.len())])
    }

    /// Takes up to `count` bytes and forgets them; gives how many there were.
    pub(super) fn skip(&mut self, count: u64) -> io::Result<u64> {
        io::copy(&mut self.take(count), &mut io::sink())
    }

    /// Appends up to `count` bytes to `to`; fewer only where the source ends before. Room is made for what comes, not for what was
    /// asked for.
    pub(super) fn append(&mut self, count: usize, to: &mut Vec<u8>) -> io::Result<usize> {
        self.take(count as u64).read_to_end(to)
    }
}

impl Read for Input<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let seen = &self.seen[self.taken..];
        let read = match seen.is_empty() {
            true => self.source.read(to)?,
            false => {
                let n = seen.len().min(to.len());
                to[..n].copy_from_slice(&seen[..n]);
                self.taken += n;
                n
            }
        };
        self.at += read as u64;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_looked_at_is_still_there() {
        let bytes: Vec<u8> = (0..100).collect();
        let mut input = Input::new(Box::new(&bytes[..]), None);
        assert_eq!(input.peek(3).unwrap(), &bytes[..3]);
        let mut first = [0; 2];
        input.read_exact(&mut first).unwrap();
        assert_eq!((first, input.at()), ([0, 1], 2));
        assert_eq!(input.peek(4).unwrap(), &bytes[2..6]);
        assert_eq!(input.skip(10).unwrap(), 10);
        let mut rest = Vec::new();
        assert_eq!(input.append(1000, &mut rest).unwrap(), 88);
        assert_eq!(rest, &bytes[12..]);
        assert_eq!((input.at(), input.peek(1).unwrap().len()), (100, 0));
    }
}
