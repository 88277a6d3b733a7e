//! The host's live half: from the byte on a serial line to whoever watches.
//!
//! ```text
//!  serial, TCP, QEMU, pipe ─ bytes ─┐
//!  recording ───────────── messages ┼─► Driver ── Event ──► Hub ─┬─► serve: a page in the browser (WebSocket) ◄─ pictures ─┐
//!  sound ► the model in this program┘     ▲                      ├─► face: a recording that says it, drawn on a thread ─┘
//!                                         │                      ├─► recording: a file that plays again
//!  sound ─ Pcm ─► the device              └──── Command ◄────────┴─► outputs: OSC, Live Link Face, E1.31, JSON lines, CSV
//! ```
//!
//! One thread, the [`driver`], owns the device; readers, the sound's clock and clients hand it what happens over one queue, so that nothing here
//! is shared but the [`hub`], from which every watcher takes its own copy. A watcher that is too slow loses its place, never the device's time.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod address;
pub mod board;
pub mod clock;
pub mod desk;
mod device;
pub mod driver;
pub mod event;
pub mod face;
pub mod feed;
pub mod hub;
mod inside;
#[cfg(feature = "mic")]
mod microphone;
pub mod outputs;
mod port;
pub mod qemu;
pub mod recording;
pub mod serve;
