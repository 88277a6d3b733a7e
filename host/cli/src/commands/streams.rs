//! Standard input and output, which `-` stands for, and files: one place for both.
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::session::{Frame, Session};
use lipstream_media::files;
use lipstream_media::sound::Reader;

use crate::progress::is_quiet;

/// Whether a name stands for standard input or output.
pub(crate) fn is_standard(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// What messages call a file.
pub(crate) fn name(path: &Path) -> String {
    match is_standard(path) {
        true => "standard input".to_owned(),
        false => path.display().to_string(),
    }
}

/// Opens a sound file, or standard input.
pub(crate) fn open_sound(path: &Path) -> Result<Reader<'static>> {
    Ok(match is_standard(path) {
        true => Reader::of_stream("standard input", io::stdin())?,
        false => Reader::open(path)?,
    })
}

/// A whole sound, 16 kHz mono: of a file, or of standard input.
pub(crate) fn read_sound(path: &Path) -> Result<Vec<i16>> {
    Ok(open_sound(path)?.rest()?.samples)
}

/// Calls `each` with every frame of a sound whose first samples, `head`, have been read; gives the number of samples.
pub(crate) fn hear(
    session: Session,
    head: &[i16],
    sound: &mut Reader,
    each: impl FnMut(&Frame) -> Result<()>,
) -> Result<usize> {
    hear_telling(session, head, sound, |_| {}, each)
}

/// [`hear`], and calls `part` with how much of a file has been heard, 0 to 1, from time to time.
pub(crate) fn hear_telling(
    mut session: Session,
    head: &[i16],
    sound: &mut Reader,
    mut part: impl FnMut(f64),
    mut each: impl FnMut(&Frame) -> Result<()>,
) -> Result<usize> {
    let (mut samples, mut heard) = (head.len(), Ok(()));
    let mut take = |frame: Frame| {
        if heard.is_ok() {
            heard = each(&frame);
        }
    };
    session.push(head, &mut take)?;
    while let Some(piece) = sound.piece()? {
        samples += piece.len();
        session.push(piece, &mut take)?;
        if let Some(read) = sound.part_read() {
            part(read);
        }
    }
    session.finish(&mut take)?;
    heard?;
    Ok(samples)
}

/// Writes a file, whole or not at all, or standard output as it comes.
pub(crate) fn write(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    if path.is_dir() {
        bail!("cannot write {}: there is a folder of this name", path.display());
    }
    if !is_standard(path) {
        return Ok(files::write_whole(path, write)?);
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    write(&mut out).and_then(|()| Ok(out.flush()?)).or_else(|error| {
        // Whoever was reading has had enough.
        let closed = error
            .downcast_ref::<io::Error>()
            .is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe);
        match closed {
            true => std::process::exit(128 + 13),
            false => Err(error).context("cannot write to standard output"),
        }
    })
}

/// Refuses to write onto a file that is read: a recording would be gone.
pub(crate) fn keep_apart<'p>(output: &Path, inputs: impl IntoIterator<Item = &'p Path>) -> Result<()> {
    // Only what is replaced can be lost: devices and pipes stay what they are.
    let Some(written) = output.canonicalize().ok().filter(|path| path.is_file()) else {
        return Ok(());
    };
    let lost = |input: &&Path| input.canonicalize().is_ok_and(|read| read == written);
    match inputs.into_iter().find(lost) {
        Some(input) => bail!(
            "{} is read from, and writing onto it would lose it: name another output than {}",
            input.display(),
            output.display()
        ),
        None => Ok(()),
    }
}

/// Says what was written; on standard error where the numbers went to standard output, and not at all with --quiet.
pub(crate) fn say(output: &Path, what: &str) {
    match is_standard(output) {
        _ if is_quiet() => {}
        true => eprintln!("{what}"),
        false => println!("{}: {what}", output.display()),
    }
}

/// Ending of a file's name in lower case, without the dot.
pub(crate) fn ending(path: &Path) -> String {
    path.extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase()
}

/// A file's name without its folder.
pub(crate) fn file_name(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| PathBuf::from(path), PathBuf::from)
        .to_string_lossy()
        .into_owned()
}
