//! `lipstream demo`: the shipped model on the shipped speech.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream_core::SAMPLE_RATE_HZ;

use super::answer::{self, Answer};
use super::streams::file_name as name;
use crate::progress::{Terminal, is_quiet};
use lipstream::cues::{self, Format};
use lipstream::engine::{Converted, Engine, Kind, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::opening::OpeningReader;
use lipstream::render::{self, Settings, page};
use lipstream::shipped::SOUND;
use lipstream::tensors::Tensors;
use lipstream_media::{files, sound};
use serde_json::json;

/// Run the shipped model on the shipped speech: video, page, cues
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder to write to [default: out, or a temporary folder where that cannot be written]
    #[arg(short, long)]
    output: Option<PathBuf>,
    /// Another model (.safetensors)
    #[arg(short, long)]
    model: Option<PathBuf>,
    /// Other speech: WAV, FLAC, MP3, Ogg, M4A, WebM, AIFF and others
    #[arg(long)]
    wav: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

pub(crate) fn run(args: Args) -> Result<()> {
    let (sound, wav_name) = match &args.wav {
        Some(wav) => (sound::read(wav)?.samples, name(wav)),
        None => (sound::decode(SOUND)?.samples, "hello.wav".to_owned()),
    };
    let tensors = Tensors::read_or_shipped(args.model.as_deref())?;
    let engine = Engine::open_or_shipped(args.model.as_deref(), Kind::Fixed, false)?;
    if !tensors.has("mouth.mean") {
        bail!("the model has no mouth, there is nothing to draw");
    }
    let space = MouthSpace::load(&tensors)?;
    let converted = engine.convert(&sound, &RunSettings::default())?;
    let folder = folder(args.output.as_deref())?;
    let written = write(&folder, &wav_name, &sound, &space, &converted)?;
    written.tell(args.answer);
    Ok(())
}

/// Makes the folder; one that was not asked for by name may be a temporary one.
fn folder(asked: Option<&Path>) -> Result<PathBuf> {
    let folder = asked.unwrap_or(Path::new("out"));
    let made = std::fs::create_dir_all(folder).and_then(|()| {
        // A folder may exist and not be ours to write in.
        tempfile::tempfile_in(folder).map(drop)
    });
    match made {
        Ok(()) => Ok(folder.to_owned()),
        Err(_) if asked.is_none() => {
            let temporary = tempfile::Builder::new().prefix("lipstream-").tempdir()?;
            Ok(temporary.keep())
        }
        Err(error) => Err(error).with_context(|| format!("cannot write in {}", folder.display())),
    }
}

/// What was written, and of the film its seconds, width and height.
struct Written {
    video: PathBuf,
    page: PathBuf,
    cues: Vec<PathBuf>,
    seconds: f64,
    size: (usize, usize),
}

impl Written {
    fn tell(&self, answer: Answer) {
        let (width, height) = self.size;
        let cues = self.cues.iter().map(|path| path.display().to_string());
        let cues = cues.collect::<Vec<_>>();
        if answer.json {
            let film = json!({ "seconds": self.seconds, "width": width, "height": height });
            let files = json!({
                "video": answer::path(&self.video), "page": answer::path(&self.page), "cues": cues, "film": film
            });
            println!("{files}");
        } else if !is_quiet() {
            println!(
                "video  {}  ({:.1} s, {width}×{height}, with sound)",
                self.video.display(),
                self.seconds
            );
            println!("page   {}  (open it in a browser)", self.page.display());
            println!("cues   {}", cues.join(" "));
        }
    }
}

/// Video, page and cue files.
fn write(
    folder: &Path,
    wav_name: &str,
    sound: &[i16],
    space: &MouthSpace,
    converted: &Converted,
) -> Result<Written> {
    let stem = Path::new(wav_name)
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy();
    let file = |ending: &str| folder.join(format!("{stem}.{ending}"));
    let seconds = sound.len() as f64 / f64::from(SAMPLE_RATE_HZ);
    let gaps = OpeningReader::of(space).map(|reader| converted.gaps(&reader));
    let cues = cues::cues(converted.visemes.view(), gaps.as_deref(), seconds)
        .with_context(|| format!("{wav_name} gives no mouth"))?;
    let settings = Settings::default();
    let tracks = converted.parameters.view();
    let rendered = render::to_mp4(space, tracks, Some(sound), &settings, &Terminal::default())?;

    let video = file("mp4");
    files::write_bytes(&video, &rendered.mp4)?;
    let html = file("html");
    let text = page::write(&page::Page {
        title: wav_name,
        mp4: &rendered.mp4,
        sound,
        viseme_weights: converted.visemes.view(),
        parameters: converted.parameters.view(),
        deviation: space.deviation.view(),
        cues: &cues,
    })?;
    files::write_bytes(&html, text.as_bytes())?;
    let mut cue_files = Vec::new();
    for format in Format::ALL {
        let path = file(format.ending());
        files::write_bytes(&path, cues::write(format, &cues, wav_name).as_bytes())?;
        cue_files.push(path);
    }
    Ok(Written {
        video,
        page: html,
        cues: cue_files,
        seconds,
        size: (rendered.width, rendered.height),
    })
}
