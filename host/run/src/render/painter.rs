//! One picture: PCA expansion (X&L eq. 16), camera noise (section 6.1), enlargement.
use ndarray::{ArrayView1, ArrayView2};

use super::enlarge::Enlarger;
use super::refine::{Candidates, Choice};
use super::{Scene, Settings};
use crate::error::{Result, bail};
use crate::mouth::MouthSpace;
use crate::random::{normal, of_picture};

/// The mouth alone, in pictures of one size.
pub struct Painter<'a> {
    space: &'a MouthSpace,
    enlarger: Enlarger,
    /// The mouth at its own size, and what the enlarger reads beyond it.
    native: Vec<f32>,
    width: usize,
    height: usize,
    noise: f32,
    details: Option<Details>,
    /// Pictures drawn so far.
    drawn: usize,
}

/// Fine detail for a film that is known beforehand.
struct Details {
    candidates: Candidates,
    choice: Choice,
    /// Candidate of each picture.
    way: Vec<usize>,
}

impl<'a> Painter<'a> {
    /// Paints mouths of `space` in the size and with the noise that `settings` asks for.
    ///
    /// # Errors
    ///
    /// That the size or the noise is out of range.
    pub fn new(space: &'a MouthSpace, settings: &Settings) -> Result<Self> {
        let (width, height) = settings.size(space)?;
        if !(0.0..=100.0).contains(&settings.noise) {
            bail!(Choice, "noise of {} levels: choose 0 to 100", settings.noise);
        }
        Ok(Self {
            space,
            enlarger: Enlarger::new((space.width, space.height), (width, height)),
            native: vec![0.0; space.mean.len() + Enlarger::MARGIN],
            width,
            height,
            noise: settings.noise,
            details: None,
            drawn: 0,
        })
    }

    /// Puts the fine detail of recorded mouths onto the pictures of `tracks` `[T, D]` (X&L section 6.1), which are to be drawn one after another.
    ///
    /// # Errors
    ///
    /// [`Error::Data`](crate::Error::Data): the candidates are of other eigenmouths.
    pub fn with_details(
        mut self,
        candidates: Candidates,
        tracks: ArrayView2<f32>,
        choice: Choice,
    ) -> Result<Self> {
        let (parameters, levels) = (self.space.size(), self.space.mean.len());
        if (candidates.n_parameters(), candidates.n_levels()) != (parameters, levels) {
            bail!(
                Data,
                "candidates of {} parameters and {} levels for a mouth of {parameters} and {levels}",
                candidates.n_parameters(),
                candidates.n_levels()
            );
        }
        let way = candidates.choose(tracks, choice);
        self.details = Some(Details {
            candidates,
            choice,
            way,
        });
        Ok(self)
    }
}

impl Scene for Painter<'_> {
    fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn n_parameters(&self) -> usize {
        self.space.size()
    }

    fn pass_over(&mut self, pictures: usize) {
        self.drawn += pictures;
    }

    /// From eigenmouth weights `[D]`.
    fn draw(&mut self, weights: ArrayView1<f32>) -> Result<Vec<u8>> {
        let (image, _) = self.native.split_at_mut(self.space.mean.len());
        self.space.expand_into(weights, image);
        if let Some(details) = &self.details
            && self.drawn < details.way.len()
        {
            let detail = details.candidates.shown(&details.way, self.drawn, details.choice);
            image
                .iter_mut()
                .zip(detail)
                .for_each(|(level, more)| *level += more);
        }
        if self.noise > 0.0 {
            let mut random = of_picture(self.drawn);
            for value in image.iter_mut() {
                *value += self.noise * normal(&mut random);
            }
        }
        self.drawn += 1;
        for value in image {
            *value = value.clamp(0.0, 255.0);
        }
        Ok(self.enlarger.enlarge(&self.native))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array1, Array2, array};

    fn flat() -> MouthSpace {
        MouthSpace {
            width: 16,
            height: 16,
            mean: Array1::from_elem(16 * 16 * 3, 100.0),
            basis: Array2::from_elem((1, 16 * 16 * 3), 1.0),
            deviation: array![1.0],
        }
    }

    #[test]
    fn flat_colours_stay_flat_and_are_clipped() {
        let space = flat();
        let mut painter = Painter::new(&space, &Settings::default()).unwrap();
        assert_eq!(painter.size(), (384, 384));
        for (weight, want) in [(0.0, 100), (55.4, 155), (500.0, 255), (-500.0, 0)] {
            let rgb = painter.draw(array![weight].view()).unwrap();
            assert_eq!(rgb.len(), 384 * 384 * 3);
            assert!(rgb.iter().all(|&v| v == want), "{weight}");
        }
    }

    #[test]
    fn noise_has_the_deviation_asked_for() {
        let space = flat();
        let settings = Settings {
            scale: Some(1),
            noise: 5.0,
            ..Settings::default()
        };
        let mut painter = Painter::new(&space, &settings).unwrap();
        let mut values = Vec::new();
        for _ in 0..20 {
            values.extend(painter.draw(array![0.0].view()).unwrap());
        }
        let n = values.len() as f64;
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / n;
        let variance = values.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / n;
        // Rounding to whole levels adds 1/12.
        assert!((mean - 100.0).abs() < 0.2, "{mean}");
        assert!((variance.sqrt() - 5.0).abs() < 0.2, "{variance}");
    }

    #[test]
    fn the_detail_of_the_nearest_mouth_comes_back() {
        let space = flat();
        let settings = Settings {
            scale: Some(1),
            ..Settings::default()
        };
        let levels = space.mean.len();
        let weights = array![[0.0], [50.0]];
        let details = Array2::from_shape_fn(
            (2, levels),
            |(k, p)| if p / 3 == 5 { 20.0 * k as f32 } else { 0.0 },
        );
        let candidates = Candidates::new(weights, details.view()).unwrap();
        let tracks = array![[1.0], [49.0]];
        let painter = Painter::new(&space, &settings).unwrap();
        let mut painter = painter
            .with_details(candidates.clone(), tracks.view(), Choice::FrameWise)
            .unwrap();
        let first = painter.draw(tracks.row(0)).unwrap();
        let second = painter.draw(tracks.row(1)).unwrap();
        assert!(first.iter().all(|level| *level == 101));
        assert_eq!((second[3 * 5], second[3 * 6]), (169, 149));
        // Behind what was planned there is none.
        assert_eq!(painter.draw(tracks.row(1)).unwrap()[3 * 5], 149);
        let other = Candidates::new(array![[0.0]], Array2::zeros((1, 9)).view()).unwrap();
        let painter = Painter::new(&space, &settings).unwrap();
        assert!(
            painter
                .with_details(other, tracks.view(), Choice::FrameWise)
                .is_err()
        );
    }

    #[test]
    fn impossible_sizes_are_refused() {
        let space = flat();
        for settings in [
            Settings {
                scale: Some(0),
                ..Settings::default()
            },
            Settings {
                scale: Some(10_000),
                ..Settings::default()
            },
            Settings {
                fps: 0,
                ..Settings::default()
            },
            Settings {
                noise: f32::NAN,
                ..Settings::default()
            },
        ] {
            assert!(Painter::new(&space, &settings).is_err(), "{settings:?}");
        }
    }
}
