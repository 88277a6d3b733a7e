//! A face: the mouth cloned onto a recording.
use std::path::Path;

use anyhow::Result;
use lipstream::mouth::MouthSpace;
use lipstream::progress::{Progress as _, Steps};
use lipstream::render::face::{FaceScene, Wanted};
use lipstream::render::{self, Scene, Tracks, energy};
use lipstream_make::vision;
use ndarray::Array2;

use super::going_on::{begun, sink};
use super::source::{Sound, Source};
use super::{Args, Drawn};
use crate::commands::faces::described;
use crate::progress::Terminal;

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
    let tracks = tracks(args, space.size(), &mut source, sound)?;
    let loudness = match sound.track() {
        Some(track) => Some(energy(&track, args.fps, tracks.nrows())?),
        None => None,
    };
    let mut footage = vision::footage(video, vision::LONGEST_S, &terminal)?;
    let settings = args.face.settings(args.fps, args.noise);
    let wanted = Wanted {
        tracks: tracks.view(),
        energy: loudness.as_deref(),
    };
    let mut scene = FaceScene::new(&mut footage, space, &wanted, &settings)?;
    terminal.say(&described(scene.mouths()));
    film(args, &mut scene, &tracks, sound)
}

/// What every picture shows, `[pictures, size]`.
pub(super) fn tracks(args: &Args, size: usize, source: &mut Source, sound: &Sound) -> Result<Array2<f32>> {
    let mut tracks = Tracks::new(size);
    source.play(args, sound, (&mut tracks, 0), |_| Ok(()))?;
    Ok(tracks.into_rows())
}

/// A film of a scene that knew its pictures beforehand.
pub(super) fn film(args: &Args, scene: &mut dyn Scene, tracks: &Array2<f32>, sound: &Sound) -> Result<Drawn> {
    let mut sink = sink(args, &render::film_of(scene, args.fps, sound.track()))?;
    let terminal = Terminal::default();
    let begun = begun(args, sink.as_ref(), &terminal);
    scene.pass_over(begun);
    let steps = Steps::go_on(&terminal, render::PICTURES, begun, tracks.nrows());
    for row in tracks.outer_iter().skip(begun) {
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
