//! Live Link Face, Apple's face tracking as Unreal Engine takes it over UDP.
//!
//! One datagram a frame: version 6 (u8) · device id, its length (i32) and its ASCII letters · subject's name, likewise · frame number i32 · part of a
//! frame f32 · frames a second i32 · denominator i32 · 61 (u8) · 61 f32: the 52 blend shapes in the order of
//! [`lipstream::cues::ARKIT`], then head and eye rotations, which stay 0 here. High bytes first.
use std::io;

use lipstream::cues::{BlendSet, Blender};

use super::{Datagrams, Output};
use crate::event::Event;

/// Where Unreal Engine listens.
pub(super) const PORT: u16 = 11111;
const VERSION: u8 = 6;
/// Values of a frame: the blend shapes and nine rotations.
const VALUES: u8 = 61;
/// What Unreal Engine's list of subjects shows.
const SUBJECT: &str = "lipstream";

/// Frames to one Unreal Engine.
pub struct LiveLink {
    to: Datagrams,
    arkit: Blender,
}

impl LiveLink {
    /// Frames go to `to`.
    pub fn new(to: Datagrams) -> Self {
        Self {
            to,
            arkit: BlendSet::Arkit.blender(),
        }
    }
}

impl Output for LiveLink {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        let Event::Frame(timed) = event else { return Ok(()) };
        // One device a program: the engine tells devices apart by 36 letters of this form.
        let id = format!("6C697073-7472-6561-6D00-{:012X}", timed.hello.hello.model);
        let mut bytes = vec![VERSION];
        for text in [id.as_str(), SUBJECT] {
            bytes.extend((text.len() as i32).to_be_bytes());
            bytes.extend(text.as_bytes());
        }
        bytes.extend((timed.frame.sequence & 0x7fff_ffff).to_be_bytes());
        bytes.extend(0f32.to_be_bytes());
        bytes.extend(i32::from(timed.hello.hello.rate_hz).to_be_bytes());
        bytes.extend(1i32.to_be_bytes());
        bytes.push(VALUES);
        let mut values = self.arkit.blend(timed.visemes(), timed.opening());
        values.resize(usize::from(VALUES), 0.0);
        for value in values {
            bytes.extend(value.to_be_bytes());
        }
        self.to.send(&bytes)
    }
}
