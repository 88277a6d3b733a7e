//! What moves a mouth (speech, parameters, a recorded stream), and the sound to it.
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use lipstream::engine::{Engine, FloatModel, RunSettings};
use lipstream::mouth::MouthSpace;
use lipstream::parameters;
use lipstream::progress::Steps;
use lipstream::render::{self, Player, Scene};
use lipstream::session::Frame;
use lipstream::tensors::Tensors;
use lipstream_live::recording::Recording;
use lipstream_media::sink::Soundtrack;
use ndarray::Array2;

use super::super::convert;
use super::super::faces::same_model;
use super::super::streams::{ending, name, read_sound};
use super::Args;
use crate::progress::Terminal;

/// What moves the mouth.
pub(super) enum Source {
    /// Parameters that were converted before, `[frames, D]`, 100 a second.
    Parameters(Array2<f32>),
    /// A recorded stream.
    Stream(Box<Recording>),
    /// Speech, which the model hears.
    Speech(Box<Engine>),
}

/// The sound to it, whose length is found once: a file is read to its end for that.
pub(super) struct Sound {
    kept: Kept,
    /// Number of samples, where there is a sound.
    length: Option<usize>,
}

/// Where a sound is.
enum Kept {
    Nowhere,
    Samples(Vec<i16>),
    File(PathBuf),
}

impl Sound {
    fn new(kept: Kept) -> Result<Self> {
        let mut sound = Self { kept, length: None };
        sound.length = sound.track().map(|track| track.samples()).transpose()?;
        Ok(sound)
    }

    /// A sound that has been read.
    pub(super) fn of_samples(samples: Vec<i16>) -> Result<Self> {
        Self::new(Kept::Samples(samples))
    }

    pub(super) fn track(&self) -> Option<Soundtrack<'_>> {
        match &self.kept {
            Kept::Nowhere => None,
            Kept::Samples(samples) => Some(Soundtrack::Samples(samples)),
            Kept::File(path) => Some(Soundtrack::File(path)),
        }
    }
}

/// Source and sound that the arguments name.
pub(super) fn open(args: &Args, tensors: &Tensors) -> Result<(Source, Sound)> {
    match ending(&args.input).as_str() {
        "stream" => of_stream(args, tensors),
        "npy" => {
            let sound = match &args.audio {
                Some(path) => Kept::Samples(read_sound(path)?),
                None => Kept::Nowhere,
            };
            let tracks = parameters::read(&args.input)?;
            let space = MouthSpace::load(tensors)?;
            if let Some(times) = space.beyond(tracks.view()) {
                eprintln!(
                    "warning: the parameters of {} are {times:.0} times as large as those of the model's mouth: the mouth will be torn apart (in another unit, or of another model?)",
                    args.input.display()
                );
            }
            let source = Source::Parameters(tracks);
            Ok((source, Sound::new(sound)?))
        }
        _ => {
            // What can be read only once is kept.
            let sound = match args.input.is_file() {
                true => Kept::File(args.input.clone()),
                false => Kept::Samples(read_sound(&args.input)?),
            };
            // A sound that cannot be read is named before the model is made ready.
            let sound = Sound::new(sound)?;
            let engine = Engine::open_or_shipped(args.model.as_deref(), args.engine.into(), false)?;
            Ok((Source::Speech(Box::new(engine)), sound))
        }
    }
}

/// A recorded stream, with the sound beside it if there is one.
fn of_stream(args: &Args, tensors: &Tensors) -> Result<(Source, Sound)> {
    let recording = Recording::open(&args.input)?;
    check_model(tensors, args.model_name(), recording.hello().model)?;
    let beside = args.input.with_extension("wav");
    let sound = match &args.audio {
        Some(path) => Kept::File(path.clone()),
        None if beside.is_file() => Kept::File(beside),
        None => Kept::Nowhere,
    };
    Ok((Source::Stream(Box::new(recording)), Sound::new(sound)?))
}

/// A stream can only be drawn with the mouth of the model that it came from.
fn check_model(tensors: &Tensors, path: &Path, id: u32) -> Result<()> {
    let Ok(model) = FloatModel::of_tensors(tensors) else {
        // The mouth.safetensors of a feature folder is no model, and knows of none.
        return Ok(());
    };
    let engine = Engine::fixed(model.export(false)?)?;
    same_model(id, engine.model_id().unwrap_or_default(), path)
}

impl Source {
    /// Plays all of it into a scene, behind `begun` pictures that were drawn before; `each` is called with every picture that comes. Gives the number of all.
    pub(super) fn play(
        &mut self,
        args: &Args,
        sound: &Sound,
        (scene, begun): (&mut dyn Scene, usize),
        mut each: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<usize> {
        let mut player = Player::new(scene, args.fps, sound.length).behind(begun);
        match self {
            Source::Parameters(tracks) => player.play(tracks.view(), each, &Terminal::default()),
            Source::Stream(recording) => {
                let played = recording.play(|parameters, _| player.frame(parameters, &mut each))?;
                if played.frames == 0 {
                    bail!("{} holds no frame", args.input.display());
                }
                player.finish(&mut each)?;
                if played.began_anew || played.between > 0 {
                    eprintln!("{}{}", convert::told(&played), convert::anew(&played));
                }
                Ok(player.pictures())
            }
            Source::Speech(engine) => of_speech(engine, args, sound, player, each),
        }
    }
}

/// Speech, which is read piece by piece.
fn of_speech(
    engine: &Engine,
    args: &Args,
    sound: &Sound,
    mut player: Player,
    mut each: impl FnMut(&[u8]) -> Result<()>,
) -> Result<usize> {
    let (Some(track), Some(length)) = (sound.track(), sound.length) else {
        return Ok(0);
    };
    let all = render::length(length, args.fps);
    let mut session = engine.session(&RunSettings::default())?;
    let terminal = Terminal::default();
    let steps = Steps::go_on(&terminal, render::PICTURES, player.begun(), all);
    let mut picture = |rgb: &[u8]| {
        each(rgb)?;
        steps.made();
        Ok(())
    };
    let mut drawn = anyhow::Ok(());
    let mut take = |frame: Frame| {
        if drawn.is_ok() {
            drawn = player.frame(frame.parameters, &mut picture);
        }
    };
    track.each(|piece| Ok::<_, anyhow::Error>(session.push(piece, &mut take)?))?;
    session.finish(&mut take)?;
    drawn
        .and_then(|()| player.finish(&mut picture))
        .with_context(|| format!("{} gives no mouth", name(&args.input)))?;
    Ok(all)
}
