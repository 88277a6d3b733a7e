//! A face that follows parameters as they come.
use ndarray::{Array1, ArrayView1, Axis};

use super::footage::Footage;
use super::jaw::JawBy;
use super::mouths::{Mouths, Whose};
use super::portrait::{Portrait, Shown, evenly};
use super::scene::FaceSettings;
use crate::error::{Error, Result, bail};
use crate::mouth::MouthSpace;
use crate::parameters::ParameterError;

/// A recording whose mouth follows parameters that nobody knows beforehand: detail and lower face of each picture are chosen by it and the picture before.
pub struct LiveFace {
    footage: Footage,
    space: MouthSpace,
    portrait: Portrait,
    fps: u32,
    /// Pictures drawn so far.
    drawn: usize,
    /// Candidates that the last picture showed.
    detail: Option<usize>,
    lower: Option<usize>,
}

impl LiveFace {
    /// Learns how the recording's mouths look.
    ///
    /// # Errors
    ///
    /// That the recording has no pictures, cannot be read, or that a setting is out of range, and what [`LiveFace::takes`] says.
    pub fn new(mut footage: Footage, space: MouthSpace, settings: &FaceSettings) -> Result<Self> {
        Self::takes(settings.jaw)?;
        let mut portrait = Portrait::learn(&mut footage, &space, settings)?;
        if settings.noise.is_none() {
            let none = Array1::zeros(space.size());
            let mouths = &portrait.mouths;
            let keys = mouths.seen().0.clone();
            let way = portrait
                .choice
                .map(|choice| mouths.candidates().choose(keys.view(), choice));
            // What will be said is not known: the recording's own mouths are drawn instead.
            let some: Vec<Shown> = evenly(keys.nrows())
                .map(|n| Shown {
                    number: n,
                    weights: match mouths.whose() {
                        Whose::Opened => none.view(),
                        Whose::Trained | Whose::Models => keys.row(n),
                    },
                    moment: portrait.course.at(0.0),
                    detail: portrait
                        .choice
                        .zip(way.as_ref())
                        .map(|(choice, way)| mouths.candidates().shown(way, n, choice)),
                    lower: None,
                })
                .collect();
            portrait.add_lacking_noise(&mut footage, &space, &some)?;
        }
        Ok(Self {
            footage,
            space,
            portrait,
            fps: settings.fps,
            drawn: 0,
            detail: None,
            lower: None,
        })
    }

    /// Refuses a jaw that follows what is not known live.
    ///
    /// # Errors
    ///
    /// It is to follow the energy of the sound.
    pub fn takes(jaw: Option<JawBy>) -> Result<()> {
        if jaw == Some(JawBy::Energy) {
            bail!(
                Choice,
                "the jaw cannot follow the sound live, since its loudness is ranked over the whole of it: let it follow the mouth, or stay still"
            );
        }
        Ok(())
    }

    /// Width and height of the pictures.
    pub fn size(&self) -> (usize, usize) {
        self.footage.pictures.size()
    }

    /// Pictures a second.
    pub fn fps(&self) -> u32 {
        self.fps
    }

    /// Pictures a second that a recording is best drawn at live: its own, of which every second or third is left out where they are more than 30.
    pub fn rate(footage: &Footage) -> u32 {
        const MOST: f32 = 30.0;
        let own = footage.rate_hz.max(1.0);
        (own / (own / MOST).ceil()).round() as u32
    }

    /// How the recording's mouths look.
    pub fn mouths(&self) -> &Mouths {
        &self.portrait.mouths
    }

    /// The next picture, rows of R, G, B: the background of so many seconds after its beginning, with the mouth of `parameters` `[D]`.
    ///
    /// # Errors
    ///
    /// Parameters of another model, and that the recording cannot be read.
    pub fn draw(&mut self, seconds: f64, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        let (width, wanted) = (parameters.len(), self.space.size());
        if width != wanted {
            return Err(Error::from(ParameterError::Width { width, wanted }));
        }
        let Portrait {
            mouths,
            course,
            jaws,
            choice,
            ..
        } = &self.portrait;
        let moment = course.at(seconds);
        let turned = self.footage.places[moment.picture].turned;
        let keys = mouths.keys(parameters.insert_axis(Axis(0)), &[turned]);
        let detail = choice.map(|choice| {
            let now = mouths.candidates().next(self.detail, keys.row(0), choice);
            let before = self.detail.replace(now);
            mouths.candidates().shown_now(before, now, choice)
        });
        let lower = jaws.as_ref().map(|jaws| {
            let now = jaws.next(self.lower, keys.row(0), turned);
            self.lower = Some(now);
            jaws.picture(now)
        });
        let shown = Shown {
            number: self.drawn,
            weights: parameters,
            moment,
            detail,
            lower,
        };
        self.drawn += 1;
        self.portrait.draw(&mut self.footage, &self.space, &shown)
    }
}
