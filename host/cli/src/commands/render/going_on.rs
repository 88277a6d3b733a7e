//! Where pictures go, and what an interrupted run has left there.
use std::fs::File;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io::Read as _;
use std::path::Path;

use anyhow::Result;
use lipstream::progress::Progress;
use lipstream_media::files::FileError;
use lipstream_media::sink::{Begun, Ffmpeg, Film, Mp4, PngFrames, RawFrames, Sink};

use super::super::streams::{ending, is_standard};
use super::Args;

/// Where the pictures go, by the output's name.
pub(super) fn sink(args: &Args, film: &Film) -> Result<Box<dyn Sink>> {
    let output = &args.output;
    if is_standard(output) {
        return Ok(Box::new(RawFrames::new(std::io::BufWriter::new(
            std::io::stdout(),
        ))));
    }
    let is_folder = output
        .as_os_str()
        .to_string_lossy()
        .ends_with(std::path::is_separator);
    if is_folder {
        return Ok(match key(args)? {
            Some(key) => Box::new(PngFrames::going_on(output, film, key)?),
            None => Box::new(PngFrames::new(output, film)?),
        });
    }
    if ending(output) != "mp4" {
        return Ok(Box::new(Ffmpeg::new(output, film)?));
    }
    Ok(match key(args)? {
        Some(key) => Box::new(Mp4::going_on(output, film, key)?),
        None => Box::new(Mp4::new(output, film)?),
    })
}

/// Pictures that need not be drawn again, which the user is told.
pub(super) fn begun(args: &Args, sink: &dyn Sink, progress: &dyn Progress) -> usize {
    let output = args.output.display();
    let begun = sink.begun();
    match begun {
        Begun::Nothing => {}
        Begun::Another => progress.say(&format!(
            "{output}: an interrupted run has left a part of another film there, or of this one made otherwise: it begins anew"
        )),
        Begun::Pictures(count) => progress.say(&format!(
            "{output}: an interrupted run has drawn {count} pictures of this film: it goes on behind them"
        )),
    }
    begun.pictures()
}

/// A number for everything that a film's pictures depend on: the program, its arguments and what is in the files that they name. None where one of them is no file, such as
/// standard input or a pipe: what comes out of that cannot be known again.
fn key(args: &Args) -> Result<Option<u64>, FileError> {
    let mut hash = DefaultHasher::new();
    env!("CARGO_PKG_VERSION").hash(&mut hash);
    format!("{args:?}").hash(&mut hash);
    let manifest = args
        .detail_from
        .as_ref()
        .map(|folder| folder.join("manifest.json"));
    // The sound beside a recorded stream.
    let beside = args.input.with_extension("wav");
    let files = [
        Some(&args.input),
        args.model.as_ref(),
        Some(&beside).filter(|path| ending(&args.input) == "stream" && path.exists()),
        args.audio.as_ref(),
        args.face.background.as_ref(),
        manifest.as_ref(),
    ];
    for path in files.into_iter().flatten() {
        if !path.is_file() {
            return Ok(None);
        }
        eat(path, &mut hash).map_err(|source| FileError::Read {
            path: path.clone(),
            source,
        })?;
    }
    Ok(Some(hash.finish()))
}

fn eat(path: &Path, hash: &mut DefaultHasher) -> std::io::Result<()> {
    let mut file = File::open(path)?;
    let mut piece = vec![0; 1 << 20];
    loop {
        match file.read(&mut piece)? {
            0 => return Ok(()),
            count => hash.write(&piece[..count]),
        }
    }
}
