//! The scene: a recording whose mouth says something else.
use ndarray::{ArrayView1, ArrayView2};

use super::course::Course;
use super::footage::Footage;
use super::jaw::{Asked, JawBy};
use super::mouths::{Mouths, Whose};
use super::portrait::{Portrait, Shown, background, evenly};
use crate::affine::Affine;
use crate::error::Result;
use crate::mouth::MouthSpace;
use crate::render::Scene;
use crate::render::refine::Choice;

/// How a face is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FaceSettings {
    /// Pictures a second.
    pub fps: u32,
    /// How the fine detail of a mouth is chosen; None: eigenmouths alone.
    pub detail: Option<Choice>,
    /// What says how far the jaw hangs; None: the recording's lower face stays as it is.
    pub jaw: Option<JawBy>,
    /// Whose mouth it is; None: found out from the recording.
    pub whose: Option<Whose>,
    /// Standard deviation of the camera noise in levels; None: what the drawn mouths lack against the recording's.
    pub noise: Option<f32>,
}

impl Default for FaceSettings {
    fn default() -> Self {
        Self {
            fps: 25,
            detail: Some(Choice::default()),
            jaw: Some(JawBy::default()),
            whose: None,
            noise: None,
        }
    }
}

/// What is to be shown, picture by picture.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// Weights of the eigenmouths, `[T, D]`.
    pub tracks: ArrayView2<'a, f32>,
    /// Energy of the sound around each picture, in any unit that grows with it, `[T]`.
    pub energy: Option<&'a [f32]>,
}

/// A recording whose mouth follows parameters, which it is told beforehand: details and jaws are chosen over time.
pub struct FaceScene<'a> {
    footage: &'a mut Footage,
    space: &'a MouthSpace,
    portrait: Portrait,
    /// Candidate whose detail each picture has.
    details: Vec<usize>,
    /// Picture that lends each its lower face.
    lower: Vec<usize>,
    fps: u32,
    /// Pictures drawn so far.
    drawn: usize,
}

impl<'a> FaceScene<'a> {
    /// Learns how the recording's mouths look, and plans the pictures that are `wanted`.
    ///
    /// # Errors
    ///
    /// That the recording has no pictures, cannot be read, or that a setting is out of range.
    pub fn new(
        footage: &'a mut Footage,
        space: &'a MouthSpace,
        wanted: &Wanted,
        settings: &FaceSettings,
    ) -> Result<Self> {
        let portrait = Portrait::learn(footage, space, settings)?;
        let turned: Vec<f32> = (0..wanted.tracks.nrows())
            .map(|n| portrait.course.at(middle(n, settings.fps)))
            .map(|moment| footage.places[moment.picture].turned)
            .collect();
        let mouths = &portrait.mouths;
        let keys = mouths.keys(wanted.tracks, &turned);
        let details = portrait
            .choice
            .map(|choice| mouths.candidates().choose(keys.view(), choice));
        let lower = match (&portrait.jaws, settings.jaw) {
            (Some(jaws), Some(by)) => jaws.choose(&Asked {
                tracks: keys.view(),
                energy: wanted.energy,
                turned: &turned,
                // What a stranger's mouth says of this jaw is not known.
                by: if mouths.whose() == Whose::Models && wanted.energy.is_some() {
                    JawBy::Energy
                } else {
                    by
                },
            }),
            _ => Vec::new(),
        };
        let mut scene = Self {
            footage,
            space,
            portrait,
            details: details.unwrap_or_default(),
            lower,
            fps: settings.fps,
            drawn: 0,
        };
        if settings.noise.is_none() {
            let some: Vec<Shown> = evenly(wanted.tracks.nrows())
                .map(|n| scene.shown(n, wanted.tracks.row(n)))
                .collect();
            scene
                .portrait
                .add_lacking_noise(scene.footage, scene.space, &some)?;
        }
        Ok(scene)
    }

    /// How the recording's mouths look.
    pub fn mouths(&self) -> &Mouths {
        &self.portrait.mouths
    }

    /// Which recorded picture is shown when.
    pub fn course(&self) -> &Course {
        &self.portrait.course
    }

    /// Picture `n` of the film before anything is drawn onto it, and where the mouth's rectangle lies in it.
    ///
    /// # Errors
    ///
    /// That the recording cannot be read.
    pub fn undrawn(&mut self, n: usize) -> Result<(Vec<u8>, Affine)> {
        background(self.footage, self.course().at(middle(n, self.fps)))
    }

    /// How much of a place of the mouth's rectangle is drawn, 0..=1; the edges of a turned head are not looked at.
    pub fn opacity(&self, x: f32, y: f32) -> f32 {
        self.portrait.opacity(x, y)
    }

    /// What picture `n` shows.
    fn shown<'t>(&self, n: usize, weights: ArrayView1<'t, f32>) -> Shown<'t> {
        let candidates = self.portrait.mouths.candidates();
        Shown {
            number: n,
            weights,
            moment: self.course().at(middle(n, self.fps)),
            detail: self
                .portrait
                .choice
                .map(|choice| candidates.shown(&self.details, n, choice)),
            lower: self.lower.get(n).copied(),
        }
    }
}

impl Scene for FaceScene<'_> {
    fn size(&self) -> (usize, usize) {
        self.footage.pictures.size()
    }

    fn n_parameters(&self) -> usize {
        self.space.size()
    }

    fn pass_over(&mut self, pictures: usize) {
        self.drawn += pictures;
    }

    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        if self.drawn.is_multiple_of(self.fps as usize) {
            // Seconds know nothing of each other, so that a film can be gone on with behind any of them.
            self.portrait.begin_anew();
        }
        let shown = self.shown(self.drawn, parameters);
        let rgb = self.portrait.draw(self.footage, self.space, &shown)?;
        self.drawn += 1;
        Ok(rgb)
    }
}

/// Seconds in the middle of picture `n`.
fn middle(n: usize, fps: u32) -> f64 {
    (n as f64 + 0.5) / f64::from(fps)
}
