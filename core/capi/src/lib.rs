//! `lipstream_core` for C and C++, for Arduino and for every language that calls C: `lipstream.h` and a static library.
//!
//! The caller gives the memory, nothing allocates, and nothing panics: what a caller can get wrong is a [`LipstreamStatus`], what can be wrong with tables
//! is a sentence. `cargo xtask header` writes `lipstream.h` from this file (`docs/c.md`).
#![cfg_attr(target_os = "none", no_std)]
#![warn(missing_docs)]

use core::ffi::{c_char, c_void};
use core::fmt::Write as _;
use core::mem::{align_of, size_of};
use core::ptr::{addr_of, addr_of_mut};
use core::slice;

use lipstream_core::frame::{MAX_PARAMETERS, N_VISEMES};
use lipstream_core::wire::Profile;
use lipstream_core::{AnyModel, AnyStream, ParameterFrame, StreamSettings};

/// Samples a second of the sound that a stream takes.
pub const LIPSTREAM_SAMPLE_RATE: u32 = 16000;
/// Most parameters of a frame.
pub const LIPSTREAM_MAX_PARAMETERS: usize = 96;
/// Visemes of a model that has visemes; docs/visemes.md names them in their order.
pub const LIPSTREAM_VISEMES: usize = 13;

const _: () = assert!(LIPSTREAM_MAX_PARAMETERS == MAX_PARAMETERS && LIPSTREAM_VISEMES == N_VISEMES);
const _: () = assert!(LIPSTREAM_SAMPLE_RATE == lipstream_core::SAMPLE_RATE_HZ);

/// What came of opening a stream.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LipstreamStatus {
    /// All is well.
    LipstreamOk = 0,
    /// The memory is null, too small or not aligned.
    LipstreamBadMemory = 1,
    /// The tables are null, damaged, or of another version or front end.
    LipstreamBadTables = 2,
    /// No such profile.
    LipstreamBadProfile = 3,
}

/// How far a stream looks ahead; docs/design.md section 5.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LipstreamProfile {
    /// 42.5 ms.
    LipstreamLive = 0,
    /// 72.5 ms.
    LipstreamStandard = 1,
    /// All that the model can use: 92.5 ms for the shipped one.
    LipstreamStudio = 2,
}

/// The mouth at one time, a hundred a second.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LipstreamFrame {
    /// Frame of the sound that the parameters belong to.
    pub frame: u32,
    /// Sample at the centre of that frame's window, modulo 2^32.
    pub sample: u32,
    /// Parameters that follow, as many as the model has.
    pub n_values: u16,
    /// Viseme weights that follow: 13, or 0 where the model has no visemes.
    pub n_visemes: u16,
    /// Parameters; lipstream_scale says what one unit of each is.
    pub values: [i16; LIPSTREAM_MAX_PARAMETERS],
    /// Occupancy of each viseme, 255 is 1.
    pub visemes: [u8; LIPSTREAM_VISEMES],
}

/// One stream of sound through a model, in the caller's memory. It points into itself: its memory must not be moved or copied.
pub struct LipstreamStream {
    model: AnyModel<'static>,
    stream: AnyStream<'static>,
}

/// Bytes that a stream takes.
#[unsafe(no_mangle)]
pub extern "C" fn lipstream_stream_bytes() -> usize {
    size_of::<LipstreamStream>()
}

/// What the address of a stream's memory must be a multiple of; a power of two, 8 at most.
#[unsafe(no_mangle)]
pub extern "C" fn lipstream_stream_alignment() -> usize {
    align_of::<LipstreamStream>()
}

/// Text in a caller's buffer, cut where it ends.
struct Sentence<'a> {
    to: &'a mut [u8],
    length: usize,
}

impl core::fmt::Write for Sentence<'_> {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        // The last byte is the zero's.
        for byte in text.bytes() {
            if self.length + 1 < self.to.len() {
                self.to[self.length] = byte;
                self.length += 1;
            }
        }
        Ok(())
    }
}

/// Writes a sentence and a zero into `why`, as much of it as there is room for.
///
/// # Safety
///
/// `why` is null, or `bytes` bytes from it on may be written.
unsafe fn say(why: *mut c_char, bytes: usize, what: core::fmt::Arguments) {
    if why.is_null() || bytes == 0 {
        return;
    }
    // SAFETY: the caller's promise; every byte is written before it is read.
    let to = unsafe { slice::from_raw_parts_mut(why.cast::<u8>(), bytes) };
    to.fill(0);
    let _ = Sentence { to, length: 0 }.write_fmt(what);
}

/// Makes a stream in `memory`, of `memory_bytes` bytes, over the tables that `lipstream export` wrote. `profile` is a LipstreamProfile. On success `*stream` is
/// the stream; otherwise it is null, and `why`, if it is not null, holds a sentence of at most `why_bytes` bytes with its zero.
///
/// # Safety
///
/// `memory` and `tables` are null or have so many bytes; the tables must stay where they are, unchanged, and the memory must not be moved or used
/// otherwise, as long as the stream is used. `stream` may be written; `why` is null or has `why_bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_open(
    memory: *mut c_void,
    memory_bytes: usize,
    tables: *const u8,
    tables_bytes: usize,
    profile: u32,
    stream: *mut *mut LipstreamStream,
    why: *mut c_char,
    why_bytes: usize,
) -> LipstreamStatus {
    if !stream.is_null() {
        // SAFETY: the caller lets us write there.
        unsafe { stream.write(core::ptr::null_mut()) };
    }
    let need = size_of::<LipstreamStream>();
    let place = memory.cast::<LipstreamStream>();
    if stream.is_null() || place.is_null() || !place.is_aligned() || memory_bytes < need {
        let alignment = align_of::<LipstreamStream>();
        // SAFETY: the caller's promise about `why`.
        unsafe {
            say(
                why,
                why_bytes,
                format_args!("a stream needs {need} bytes at a multiple of {alignment}"),
            );
        }
        return LipstreamStatus::LipstreamBadMemory;
    }
    let profile = match profile {
        0 => Profile::Live,
        1 => Profile::Standard,
        2 => Profile::Studio,
        _ => {
            // SAFETY: the caller's promise about `why`.
            unsafe { say(why, why_bytes, format_args!("there is no profile {profile}")) };
            return LipstreamStatus::LipstreamBadProfile;
        }
    };
    // SAFETY: the caller promises so many bytes, unchanged as long as the stream lives.
    let bytes: &'static [u8] = match tables.is_null() {
        true => &[],
        false => unsafe { slice::from_raw_parts(tables, tables_bytes) },
    };
    let model = match AnyModel::new_checked(bytes) {
        Ok(model) => model,
        Err(wrong) => {
            // SAFETY: the caller's promise about `why`.
            unsafe { say(why, why_bytes, format_args!("{wrong}")) };
            return LipstreamStatus::LipstreamBadTables;
        }
    };
    // SAFETY: `place` is aligned and large enough, and its memory stays where it is: a reference to the model that is written there holds as long as
    // the stream, and nobody writes the model again.
    unsafe {
        addr_of_mut!((*place).model).write(model);
        let model: &'static AnyModel<'static> = &*addr_of!((*place).model);
        addr_of_mut!((*place).stream).write(AnyStream::new(model, StreamSettings::of(profile)));
        stream.write(place);
    }
    LipstreamStatus::LipstreamOk
}

/// The part of a stream that moves.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`], and nobody else uses it now.
unsafe fn moving<'a>(stream: *mut LipstreamStream) -> Option<&'a mut AnyStream<'static>> {
    // SAFETY: the caller's promise; the model beside it is only ever read.
    (!stream.is_null()).then(|| unsafe { &mut *addr_of_mut!((*stream).stream) })
}

/// The model of a stream.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`].
unsafe fn model<'a>(stream: *const LipstreamStream) -> Option<&'a AnyModel<'static>> {
    // SAFETY: the caller's promise.
    (!stream.is_null()).then(|| unsafe { &*addr_of!((*stream).model) })
}

/// Writes what came out, if anything did.
///
/// # Safety
///
/// `to` is null or may be written.
unsafe fn hand_out(said: Option<ParameterFrame>, to: *mut LipstreamFrame) -> bool {
    let Some(said) = said else { return false };
    let mut frame = LipstreamFrame {
        frame: said.frame,
        sample: said.sample,
        n_values: said.values.len() as u16,
        n_visemes: said.viseme_weights.len() as u16,
        values: [0; LIPSTREAM_MAX_PARAMETERS],
        visemes: [0; LIPSTREAM_VISEMES],
    };
    frame
        .values
        .iter_mut()
        .zip(&said.values)
        .for_each(|(to, v)| *to = *v);
    frame
        .visemes
        .iter_mut()
        .zip(&said.viseme_weights)
        .for_each(|(to, v)| *to = *v);
    if !to.is_null() {
        // SAFETY: the caller's promise.
        unsafe { to.write(frame) };
    }
    true
}

/// Takes samples, mono, 16 kHz, cut anywhere, up to the end of the next window; gives how many. Where they brought a frame, it is in `*frame` and
/// `*has_frame` is true. Call it until all are taken. Samples after lipstream_finish begin a new stream.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`] and nobody else uses it now; `samples` has `n_samples` samples; `frame` and `has_frame` may be written, or are null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_push(
    stream: *mut LipstreamStream,
    samples: *const i16,
    n_samples: usize,
    frame: *mut LipstreamFrame,
    has_frame: *mut bool,
) -> usize {
    // SAFETY: the caller's promises.
    unsafe {
        let samples = match samples.is_null() {
            true => &[][..],
            false => slice::from_raw_parts(samples, n_samples),
        };
        let (taken, said) = moving(stream).map_or((n_samples, None), |stream| stream.push(samples));
        let has = hand_out(said, frame);
        if !has_frame.is_null() {
            has_frame.write(has);
        }
        taken
    }
}

/// The frames that are still owed when the sound has ended, one a call into `*frame`; false when all are out.
///
/// # Safety
///
/// As for [`lipstream_push`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_finish(stream: *mut LipstreamStream, frame: *mut LipstreamFrame) -> bool {
    // SAFETY: the caller's promises.
    unsafe { hand_out(moving(stream).and_then(AnyStream::finish), frame) }
}

/// Forgets everything; the next frame is frame 0.
///
/// # Safety
///
/// As for [`lipstream_push`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_reset(stream: *mut LipstreamStream) {
    // SAFETY: the caller's promise.
    if let Some(stream) = unsafe { moving(stream) } {
        stream.reset();
    }
}

/// Samples from the centre of a frame's window to the last sample that it waits for.
///
/// # Safety
///
/// As for [`lipstream_push`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_delay_samples(stream: *mut LipstreamStream) -> usize {
    // SAFETY: the caller's promise.
    unsafe { moving(stream) }.map_or(0, |stream| stream.delay_samples())
}

/// Number that tells models apart: what `Hello` on the wire has, and `lipstream render` asks for.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_model_id(stream: *const LipstreamStream) -> u32 {
    // SAFETY: the caller's promise.
    unsafe { model(stream) }.map_or(0, |model| model.head().id())
}

/// Parameters of a frame.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_parameters(stream: *const LipstreamStream) -> usize {
    // SAFETY: the caller's promise.
    unsafe { model(stream) }.map_or(0, |model| model.head().n_parameters())
}

/// What one unit of a parameter is in real units; 0 where there is no such parameter.
///
/// # Safety
///
/// `stream` came from [`lipstream_open`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_scale(stream: *const LipstreamStream, parameter: usize) -> f32 {
    // SAFETY: the caller's promise.
    let model = unsafe { model(stream) };
    model
        .and_then(|model| model.head().parameter_scales().nth(parameter))
        .unwrap_or(0.0)
}

/// A device without an operating system has nobody to tell, and the core has nothing to tell: it stands still until the watchdog comes.
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {
        core::hint::spin_loop();
    }
}
