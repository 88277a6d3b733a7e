//! What JavaScript calls. Numbers are pointers into the module's memory and lengths; nothing is ever freed but a vector that grows, since a page makes
//! a new instance of the module for every stream and the browser takes the old one's memory back as a whole.
use std::cell::RefCell;
use std::slice;

use lipstream_core::wire::Profile;

use crate::Talker;

thread_local! {
    /// What the last call has to say.
    static TEXT: RefCell<String> = const { RefCell::new(String::new()) };
}

fn say(words: String) {
    TEXT.with_borrow_mut(|text| *text = words);
}

/// Keeps what is wrong for `lipstream_text`.
fn told<T>(said: Result<T, String>) -> Option<T> {
    said.map_err(say).ok()
}

/// Memory that the page may write to and that a [`Talker`] may keep; its address is a multiple of 8.
#[unsafe(no_mangle)]
pub extern "C" fn lipstream_room(bytes: usize) -> *mut u8 {
    Box::leak(vec![0_u64; bytes.div_ceil(8)].into_boxed_slice())
        .as_mut_ptr()
        .cast()
}

/// Where the text of the last call begins; `lipstream_text_bytes` is its length.
#[unsafe(no_mangle)]
pub extern "C" fn lipstream_text() -> *const u8 {
    TEXT.with_borrow(|text| text.as_ptr())
}

/// Bytes of the text of the last call, UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn lipstream_text_bytes() -> usize {
    TEXT.with_borrow(String::len)
}

/// Makes a stream over tables, `profile` 0 `live`, 1 `standard`, else `studio`; the text says what the model is (see [`Talker::about`]), or, when this is null, what is wrong.
///
/// # Safety
///
/// `tables` came from [`lipstream_room`], holds `bytes` bytes, and is not written again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_open(
    tables: *const u8,
    bytes: usize,
    profile: u32,
    rate_hz: u32,
) -> *mut Talker {
    let profile = match profile {
        0 => Profile::Live,
        1 => Profile::Standard,
        _ => Profile::Studio,
    };
    // SAFETY: the caller's promise; memory of `lipstream_room` stays for good.
    let tables = unsafe { slice::from_raw_parts(tables, bytes) };
    match told(Talker::new(tables, profile, rate_hz)) {
        Some(talker) => {
            say(talker.about());
            Box::leak(Box::new(talker))
        }
        None => std::ptr::null_mut(),
    }
}

/// Takes `count` samples of a microphone; gives the frames that they brought out, or -1 and a text.
///
/// # Safety
///
/// `talker` came from [`lipstream_open`]; `sound` has `count` samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_hear(talker: *mut Talker, sound: *const f32, count: usize) -> i32 {
    // SAFETY: the caller's promises; a page has one thread.
    let (talker, sound) = unsafe { (&mut *talker, slice::from_raw_parts(sound, count)) };
    match told(talker.hear(sound)) {
        Some(()) => talker.frames().centres.len() as i32,
        None => -1,
    }
}

/// Decodes a sound file; gives its samples of 16 kHz, or -1 and a text.
///
/// # Safety
///
/// As for [`lipstream_hear`]; `file` has `bytes` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_decode(talker: *mut Talker, file: *const u8, bytes: usize) -> i32 {
    // SAFETY: the caller's promises.
    let (talker, file) = unsafe { (&mut *talker, slice::from_raw_parts(file, bytes)) };
    told(talker.decode(file)).map_or(-1, |samples| samples as i32)
}

/// Converts samples `from` to `to` of the decoded file; gives the frames that they brought out.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_convert(talker: *mut Talker, from: usize, to: usize) -> i32 {
    // SAFETY: the caller's promise.
    let talker = unsafe { &mut *talker };
    talker.convert(from, to);
    talker.frames().centres.len() as i32
}

/// The frames that are still owed when the sound has ended; gives how many.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_finish(talker: *mut Talker) -> i32 {
    // SAFETY: the caller's promise.
    let talker = unsafe { &mut *talker };
    talker.finish();
    talker.frames().centres.len() as i32
}

/// Parameters of the frames of the last call, frame by frame.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_parameters(talker: *const Talker) -> *const f32 {
    // SAFETY: the caller's promise.
    unsafe { &*talker }.frames().parameters.as_ptr()
}

/// Viseme weights of the frames of the last call, frame by frame.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_visemes(talker: *const Talker) -> *const u8 {
    // SAFETY: the caller's promise.
    unsafe { &*talker }.frames().visemes.as_ptr()
}

/// The sample at the centre of each frame of the last call.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_centres(talker: *const Talker) -> *const u32 {
    // SAFETY: the caller's promise.
    unsafe { &*talker }.frames().centres.as_ptr()
}

/// Samples of the decoded file, or of the last piece of a microphone, 16 kHz.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_samples(talker: *const Talker) -> *const i16 {
    // SAFETY: the caller's promise.
    unsafe { &*talker }.samples().as_ptr()
}

/// How many samples [`lipstream_samples`] has.
///
/// # Safety
///
/// As for [`lipstream_hear`].
#[unsafe(no_mangle)]
pub unsafe extern "C" fn lipstream_sample_count(talker: *const Talker) -> usize {
    // SAFETY: the caller's promise.
    unsafe { &*talker }.samples().len()
}
