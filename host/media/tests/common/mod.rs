//! What the tests of sound files share.
use lipstream_media::sound;

/// The error of bytes that must be refused: one line.
pub(crate) fn refused(name: &str, bytes: &[u8]) -> String {
    let error = match sound::decode(bytes) {
        Ok(sound) => panic!("{name}: read as {} samples", sound.samples.len()),
        Err(error) => format!("{:#}", anyhow::Error::from(error)),
    };
    assert!(!error.contains('\n') && error.len() > 10, "{name}: {error:?}");
    error
}
