//! E1.31, "streaming ACN": DMX channels over UDP, for shows whose animatronics hang on DMX (ANSI E1.31-2018).
//!
//! | channel | what it is, 0 to 255 |
//! |---|---|
//! | 1 | how far the jaw is open |
//! | 2 | how far the lips are puckered |
//! | 3 | how far they are pressed together |
//! | 4 to 16 | the 13 visemes in the order of [`lipstream::phones::VISEMES`] |
//! | 17 | how far the lips are apart, 255 as far as in speech |
//! | 18 | how far the corners are apart: 0 as near, 255 as far as in speech, 128 on average |
//!
//! Channels 17 and 18 stay 0 and 128 where the mouth of the device's model is not known.
use std::io;

use lipstream::cues::{ARKIT, BlendSet, Blender};
use lipstream::opening::Opening;
use lipstream::phones::VISEMES;

use super::{Datagrams, Output};
use crate::event::Event;

/// Where receivers listen.
pub(super) const PORT: u16 = 5568;
/// Channels sent.
const CHANNELS: usize = 3 + VISEMES.len() + 2;
/// The identity of this kind of sender: one a program, told apart by its name.
const CID: [u8; 16] = *b"lipstream\0\x40\0\x80\0\0\x01";

/// Frames to one universe.
pub struct E131 {
    to: Datagrams,
    universe: u16,
    sequence: u8,
    arkit: Blender,
}

impl E131 {
    /// Frames go to `universe` at `to`.
    pub fn new(to: Datagrams, universe: u16) -> Self {
        Self {
            to,
            universe,
            sequence: 0,
            arkit: BlendSet::Arkit.blender(),
        }
    }
}

impl Output for E131 {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let Event::Frame(timed) = event else { return Ok(()) };
        let opening = timed.opening();
        let arkit = self.arkit.blend(timed.visemes(), opening);
        let shape = |name: &str| {
            let weight = ARKIT.iter().position(|n| *n == name).map_or(0.0, |k| arkit[k]);
            (weight * 255.0).round() as u8
        };
        let mut channels = [0; CHANNELS];
        channels[..3].copy_from_slice(&[shape("jawOpen"), shape("mouthPucker"), shape("mouthPressLeft")]);
        let visemes = &timed.frame.viseme_weights;
        channels[3..3 + visemes.len()].copy_from_slice(visemes);
        let Opening { gap, width } = opening.unwrap_or_default();
        channels[3 + VISEMES.len()] = (255.0 * gap).round() as u8;
        channels[4 + VISEMES.len()] = (127.5 + 127.5 * width).round() as u8;
        let bytes = packet(self.universe, self.sequence, &channels);
        self.sequence = self.sequence.wrapping_add(1);
        self.to.send(&bytes)
    }
}

/// One data packet: the root, framing and DMP layers, each behind its flags (7) and the length from there to the end.
fn packet(universe: u16, sequence: u8, channels: &[u8]) -> Vec<u8> {
    let dmp = 11 + channels.len();
    let framing = 77 + dmp;
    let root = 22 + framing;
    let length = |length: usize| (0x7000 | length as u16).to_be_bytes();
    let mut bytes = vec![0, 0x10, 0, 0];
    bytes.extend(b"ASC-E1.17\0\0\0");
    bytes.extend(length(root));
    bytes.extend(4u32.to_be_bytes());
    bytes.extend(CID);
    bytes.extend(length(framing));
    bytes.extend(2u32.to_be_bytes());
    let mut name = [0; 64];
    name[..9].copy_from_slice(b"lipstream");
    bytes.extend(name);
    // Priority 100, no synchronisation, no options.
    bytes.extend([100, 0, 0, sequence, 0]);
    bytes.extend(universe.to_be_bytes());
    bytes.extend(length(dmp));
    bytes.extend([2, 0xa1, 0, 0, 0, 1]);
    bytes.extend((1 + channels.len() as u16).to_be_bytes());
    // DMX's start code.
    bytes.push(0);
    bytes.extend(channels);
    bytes
}
