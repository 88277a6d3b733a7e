//! A face: the mouth cloned onto a recording.
use std::path::Path;

use anyhow::Result;
use lipstream::mouth::MouthSpace;
use lipstream::progress::{Progress as _, Steps};
use lipstream::render::face::{FaceScene, FaceSettings, Wanted, Whose};
use lipstream::render::refine::Choice;
use lipstream::render::{self, Scene, Tracks, energy};
use lipstream_make::vision;
use ndarray::Array2;

use super::source::{Sound, Source};
use super::{Args, Drawn, sink};
use crate::commands::choices;
use crate::progress::Terminal;

/// How a face is drawn
#[derive(Debug, clap::Args)]
pub(super) struct FaceArgs {
    /// Put the mouth onto this recording of a face, which goes on as long as the sound: its first minute, in a loop
    #[arg(long, value_name = "VIDEO")]
    pub(super) background: Option<std::path::PathBuf>,
    /// Put the fine detail that eigenmouths leave out onto the mouth alone, from the mouths of this feature folder, on which the model was trained
    #[arg(long, value_name = "FEATURES", conflicts_with = "background")]
    pub(super) detail_from: Option<std::path::PathBuf>,
    /// How fine detail is chosen: that of --detail-from, or that of the recording's own mouths
    #[arg(long, value_enum, default_value_t = choices::Detail::Smooth)]
    detail: choices::Detail,
    /// What the lower face of the recording follows
    #[arg(long, value_enum, default_value_t = choices::Jaw::Mouth, requires = "background")]
    jaw: choices::Jaw,
    /// Whose mouth is drawn [default: trained or opened, whichever fits the recording]
    #[arg(long, value_enum, requires = "background")]
    mouth: Option<choices::Whose>,
}

impl FaceArgs {
    /// How fine detail is chosen.
    pub(super) fn detail(&self) -> Option<Choice> {
        match self.detail {
            choices::Detail::None => None,
            choices::Detail::Nearest => Some(Choice::FrameWise),
            choices::Detail::Smooth => Some(Choice::default()),
        }
    }
}

/// Draws a face onto `video`.
pub(super) fn draw(
    args: &Args,
    video: &Path,
    space: &MouthSpace,
    mut source: Source,
    sound: &Sound,
) -> Result<Drawn> {
    let terminal = Terminal::default();
    // What is said first: a sound that gives no mouth is told before a minute of video is looked at.
    let tracks = tracks(args, space, &mut source, sound)?;
    let loudness = match sound.track() {
        Some(track) => Some(energy(&track, args.fps, tracks.nrows())?),
        None => None,
    };
    let mut footage = vision::footage(video, vision::LONGEST_S, &terminal)?;
    let settings = FaceSettings {
        fps: args.fps,
        detail: args.face.detail(),
        jaw: match args.face.jaw {
            choices::Jaw::Still => None,
            choices::Jaw::Sound => Some(render::face::JawBy::Energy),
            choices::Jaw::Mouth => Some(render::face::JawBy::Mouth),
        },
        whose: args.face.mouth.map(Whose::from),
        noise: args.noise,
    };
    let wanted = Wanted {
        tracks: tracks.view(),
        energy: loudness.as_deref(),
    };
    let mut scene = FaceScene::new(&mut footage, space, &wanted, &settings)?;
    terminal.say(&described(&scene));
    film(args, &mut scene, &tracks, sound)
}

/// What every picture shows, `[pictures, D]`.
pub(super) fn tracks(
    args: &Args,
    space: &MouthSpace,
    source: &mut Source,
    sound: &Sound,
) -> Result<Array2<f32>> {
    let mut tracks = Tracks::new(space.size());
    source.play(args, sound, &mut tracks, |_| Ok(()))?;
    Ok(tracks.into_rows())
}

/// A film of a scene that knew its pictures beforehand.
pub(super) fn film(args: &Args, scene: &mut dyn Scene, tracks: &Array2<f32>, sound: &Sound) -> Result<Drawn> {
    let mut sink = sink(&args.output, &render::film_of(scene, args.fps, sound.track()))?;
    let terminal = Terminal::default();
    let steps = Steps::begin(&terminal, render::PICTURES, tracks.nrows());
    for row in tracks.outer_iter() {
        sink.picture(&scene.draw(row)?)?;
        steps.made();
    }
    sink.finish()?;
    Ok(Drawn {
        pictures: tracks.nrows(),
        size: scene.size(),
        sound: sound.track().is_some(),
    })
}

/// What was found out of the recording, for people.
fn described(scene: &FaceScene) -> String {
    let mouths = scene.mouths();
    let whose = match mouths.whose() {
        Whose::Trained => "the recording's own mouth is moved by the model's eigenmouths",
        Whose::Opened => "the recording's own mouths are shown, as open and wide as the model's",
        Whose::Models => "the model's mouth is shown in the recording's light",
    };
    format!(
        "{whose} (they say {:.0} % of how it moves)",
        100.0 * mouths.explained()
    )
}
