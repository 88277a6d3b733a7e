//! The VMC protocol (protocol.vmc.info): Open Sound Control over UDP, to programs that move VRM avatars.
//!
//! A frame is `/VMC/Ext/Blend/Val` with a clip's name and its weight for every clip, then `/VMC/Ext/Blend/Apply`. Sent are the shapes of jaw,
//! mouth and tongue under ARKit's names, which avatars with "perfect sync" have, and A, I, U, E, O, which every VRM avatar has. Eyes and brows are
//! left to whoever moves them.
//!
//! An OSC message is its address, its types and its arguments; texts end in zeros up to a multiple of 4 bytes, numbers have their high byte
//! first. A bundle is `#bundle`, a time (1: at once), and messages, each behind its length (opensoundcontrol.stanford.edu/spec-1_0.html).
use std::io;

use lipstream::cues::{ARKIT, BlendSet, Blender};

use super::{Datagrams, Output};
use crate::event::Event;

/// Where a program that moves an avatar listens.
pub(super) const PORT: u16 = 39539;
/// A datagram is kept below what a network passes on in one piece.
const MOST: usize = 1400;
/// What VRM 0, whose names the protocol has, calls the vowels of [`lipstream::cues::VRM`].
const VOWELS: [&str; 5] = ["A", "I", "U", "E", "O"];

/// Frames to one avatar.
pub struct Vmc {
    to: Datagrams,
    arkit: Blender,
    vowels: Blender,
}

impl Vmc {
    /// Frames go to `to`.
    pub fn new(to: Datagrams) -> Self {
        Self {
            to,
            arkit: BlendSet::Arkit.blender(),
            vowels: BlendSet::Vrm.blender(),
        }
    }
}

impl Output for Vmc {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let Event::Frame(timed) = event else { return Ok(()) };
        let opening = timed.opening();
        let arkit = self.arkit.blend(timed.visemes(), opening);
        let vowels = self.vowels.blend(timed.visemes(), opening);
        let mut bundle = Bundle::new();
        for (name, weight) in ARKIT.iter().zip(&arkit) {
            if ["jaw", "mouth", "tongue"]
                .iter()
                .any(|part| name.starts_with(part))
            {
                bundle.put(&value(name, *weight), &self.to)?;
            }
        }
        for (clip, weight) in VOWELS.into_iter().zip(vowels) {
            bundle.put(&value(clip, weight), &self.to)?;
        }
        bundle.put(&message("/VMC/Ext/Blend/Apply", ",", &[]), &self.to)?;
        bundle.send(&self.to)
    }
}

/// One clip's weight.
fn value(clip: &str, weight: f32) -> Vec<u8> {
    let arguments = [padded(clip), weight.to_be_bytes().to_vec()].concat();
    message("/VMC/Ext/Blend/Val", ",sf", &arguments)
}

fn message(address: &str, types: &str, arguments: &[u8]) -> Vec<u8> {
    [&padded(address)[..], &padded(types), arguments].concat()
}

/// A text with at least one zero behind it.
fn padded(text: &str) -> Vec<u8> {
    let mut bytes = text.as_bytes().to_vec();
    bytes.resize((bytes.len() + 1).next_multiple_of(4), 0);
    bytes
}

/// Messages that go together.
struct Bundle(Vec<u8>);

impl Bundle {
    const HEAD: &'static [u8] = b"#bundle\0\0\0\0\0\0\0\0\x01";

    fn new() -> Self {
        Self(Self::HEAD.to_vec())
    }

    /// Appends a message; sends what there is before if both are too much.
    fn put(&mut self, message: &[u8], to: &Datagrams) -> io::Result<()> {
        if self.0.len() + 4 + message.len() > MOST {
            std::mem::replace(self, Self::new()).send(to)?;
        }
        self.0.extend((message.len() as u32).to_be_bytes());
        self.0.extend(message);
        Ok(())
    }

    fn send(self, to: &Datagrams) -> io::Result<()> {
        to.send(&self.0)
    }
}
