//! Parameters to a moving mouth: pictures (eq. 16 of X&L), video with sound, a page.
//!
//! Time: parameters of frame t belong to sample 160·t + 200 of the sound; picture n is on the
//! screen from n/fps to (n + 1)/fps seconds and shows the parameters of the middle of that time, as training takes picture n
//! of a recording for the middle of its exposure.
use lipstream_core::SAMPLE_RATE_HZ;
use lipstream_media::sink::{Film, Mp4Bytes, Soundtrack};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2};

use crate::error::{Error, Result, bail};
use crate::mouth::MouthSpace;
use crate::parameters::ParameterError;
use crate::progress::{Progress, Steps};
use crate::{parameters, time};

pub mod drawn;
mod enlarge;
pub mod face;
pub mod hierarchical;
pub mod page;
mod painter;
pub mod refine;

pub use painter::Painter;

/// How pictures are made.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Pictures a second.
    pub fps: u32,
    /// Times the size of the eigenmouths; `None`: about 384 pixels wide.
    pub scale: Option<usize>,
    /// Standard deviation of the camera noise in levels of 0..255 (X&L section 6.1).
    pub noise: f32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            fps: 25,
            scale: None,
            noise: 0.0,
        }
    }
}

/// Largest side of a picture.
const MAX_SIDE: usize = 4096;

impl Settings {
    /// Width and height of the pictures of `space`: multiples of 16, as video codecs like them.
    ///
    /// # Errors
    ///
    /// [`Error::Choice`]: a setting is out of its range.
    pub fn size(&self, space: &MouthSpace) -> Result<(usize, usize)> {
        if !(1..=100).contains(&self.fps) {
            bail!(Choice, "{} pictures a second: choose 1 to 100", self.fps);
        }
        let scale = match self.scale {
            Some(0) => bail!(Choice, "a scale of 0 leaves nothing to see: choose 1 or more"),
            Some(scale) => scale,
            None => (384 / space.width).max(1),
        };
        let side = |native: usize| (native.saturating_mul(scale).saturating_add(8) / 16 * 16).max(16);
        let (width, height) = (side(space.width), side(space.height));
        if width > MAX_SIDE || height > MAX_SIDE {
            bail!(
                Choice,
                "pictures of {width}×{height}: choose a smaller scale (largest side {MAX_SIDE})"
            );
        }
        Ok((width, height))
    }
}

/// Number of pictures that last as long as `samples` samples of sound.
pub fn picture_count(samples: usize, fps: u32) -> usize {
    (samples as u64 * u64::from(fps)).div_ceil(u64::from(SAMPLE_RATE_HZ)) as usize
}

/// Pictures of a film with so many samples of sound: one at least.
pub fn length(samples: usize, fps: u32) -> usize {
    picture_count(samples, fps).max(1)
}

/// What draws: parameters of one moment in, a picture out. It does not know where pictures go.
///
/// To add one: a file here with its `Scene`.
pub trait Scene {
    /// Width and height of the pictures.
    fn size(&self) -> (usize, usize);

    /// Numbers that a picture is drawn from.
    fn n_parameters(&self) -> usize;

    /// Rows of interleaved R, G, B for parameters `[D]`.
    ///
    /// # Errors
    ///
    /// What keeps the picture from being drawn; [`Error::other`] takes an error of the scene's own.
    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>>;

    /// So many pictures, whole seconds, were drawn by an interrupted run: what comes next is the picture behind them, as it would have been. A scene in which no picture
    /// depends on its number has nothing to do.
    fn pass_over(&mut self, _pictures: usize) {}
}

/// Plays parameter frames, 100 a second, into pictures of a scene: each shows the parameters in the middle of its time, linear in
/// between. Frames may come from a stream; two of them are kept.
pub struct Player<'a> {
    scene: &'a mut dyn Scene,
    fps: u32,
    /// Frames that came so far.
    frames: usize,
    /// The last of them, and the one before.
    last: Vec<f32>,
    before: Vec<f32>,
    pictures: usize,
    /// Pictures that were drawn before.
    begun: usize,
    /// Length of the sound, where there is one.
    samples: Option<usize>,
}

impl<'a> Player<'a> {
    /// Draws `scene` at `fps` pictures a second, to the end of a sound of `samples` samples where there is one: it may end before the
    /// frames do, and after them.
    pub fn new(scene: &'a mut dyn Scene, fps: u32, samples: Option<usize>) -> Self {
        Self {
            samples,
            scene,
            fps,
            frames: 0,
            last: Vec::new(),
            before: Vec::new(),
            pictures: 0,
            begun: 0,
        }
    }

    /// Goes on behind `pictures` pictures that an interrupted run has drawn: of those only the frames are looked at.
    pub fn behind(mut self, pictures: usize) -> Self {
        self.scene.pass_over(pictures);
        self.begun = pictures;
        self
    }

    /// Pictures that were there.
    pub fn begun(&self) -> usize {
        self.begun
    }

    /// Pictures so far, those that were there included.
    pub fn pictures(&self) -> usize {
        self.pictures
    }

    /// The next frame; `each` is called with the pictures that it completes.
    ///
    /// # Errors
    ///
    /// Parameters that are no numbers or not as many as the scene draws from, and what scene and `each` say.
    pub fn frame<E: From<Error>>(
        &mut self,
        parameters: &[f32],
        mut each: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.check(parameters).map_err(Error::from)?;
        std::mem::swap(&mut self.before, &mut self.last);
        self.last.clear();
        self.last.extend(parameters);
        self.frames += 1;
        // A picture between two frames needs both; one at or before the first needs the first alone.
        while self.frames > 1 && self.place().floor() as usize + 1 < self.frames && self.goes_on() {
            self.picture(&mut each)?;
        }
        Ok(())
    }

    /// All frames, `[frames, D]`, from the first to the end of the sound; `each` is called with every picture. Gives their number.
    ///
    /// # Errors
    ///
    /// Parameters that cannot be drawn, and what scene and `each` say.
    pub fn play<E: From<Error>>(
        mut self,
        tracks: ArrayView2<f32>,
        mut each: impl FnMut(&[u8]) -> Result<(), E>,
        progress: &dyn Progress,
    ) -> Result<usize, E> {
        parameters::check(tracks).map_err(Error::from)?;
        let samples = self
            .samples
            .unwrap_or_else(|| time::samples_covered(tracks.nrows()));
        let all = length(samples, self.fps);
        let steps = Steps::go_on(progress, PICTURES, self.begun, all);
        let mut each = |rgb: &[u8]| -> Result<(), E> {
            each(rgb)?;
            steps.made();
            Ok(())
        };
        for row in tracks.outer_iter() {
            self.frame(&row.to_vec(), &mut each)?;
        }
        self.finish(&mut each)?;
        Ok(all)
    }

    /// Whether the sound has not ended before the next picture.
    fn goes_on(&self) -> bool {
        self.samples
            .is_none_or(|samples| self.pictures < length(samples, self.fps))
    }

    /// Refuses what the scene cannot draw.
    fn check(&self, parameters: &[f32]) -> Result<(), ParameterError> {
        let (width, wanted) = (parameters.len(), self.scene.n_parameters());
        if width != wanted {
            return Err(ParameterError::Width { width, wanted });
        }
        parameters::check_frame(self.frames, parameters)
    }

    /// There are no more frames: the pictures up to the end of the sound, in which the mouth rests where the last frame has left it.
    ///
    /// # Errors
    ///
    /// That there was no frame, and what scene and `each` say.
    pub fn finish<E: From<Error>>(&mut self, mut each: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        if self.frames == 0 {
            return Err(Error::from(ParameterError::NoFrame).into());
        }
        let samples = self.samples.unwrap_or_else(|| time::samples_covered(self.frames));
        while self.pictures < length(samples, self.fps) {
            self.picture(&mut each)?;
        }
        Ok(())
    }

    /// The frame, fractions included, in the middle of the next picture's time; held to those that are there.
    fn place(&self) -> f32 {
        let middle = (self.pictures as f64 + 0.5) / f64::from(self.fps);
        (time::frame_at(middle) as f32).max(0.0)
    }

    fn picture<E: From<Error>>(&mut self, each: &mut impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        if self.pictures < self.begun {
            self.pictures += 1;
            return Ok(());
        }
        let last = self.frames - 1;
        let place = self.place().min(last as f32);
        let (at, part) = (place.floor() as usize, place.fract());
        let parameters: Array1<f32> = match at == last || self.before.is_empty() {
            true => self.last.iter().copied().collect(),
            false => std::iter::zip(&self.before, &self.last)
                .map(|(a, b)| a + part * (b - a))
                .collect(),
        };
        each(&self.scene.draw(parameters.view())?)?;
        self.pictures += 1;
        Ok(())
    }
}

/// A scene that draws nothing and keeps what each picture would have shown: for scenes that want to know beforehand.
pub struct Tracks {
    n_parameters: usize,
    values: Vec<f32>,
}

impl Tracks {
    /// Of `n_parameters` each.
    pub fn new(n_parameters: usize) -> Self {
        Self {
            n_parameters,
            values: Vec::new(),
        }
    }

    /// `[pictures, D]`.
    pub fn into_rows(self) -> Array2<f32> {
        let pictures = self.values.len() / self.n_parameters.max(1);
        Array2::from_shape_vec((pictures, self.n_parameters), self.values).unwrap_or_default()
    }
}

impl Scene for Tracks {
    fn size(&self) -> (usize, usize) {
        (0, 0)
    }

    fn n_parameters(&self) -> usize {
        self.n_parameters
    }

    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        self.values.extend(parameters);
        Ok(Vec::new())
    }
}

/// What the pictures of a film show of parameters `[frames, D]` at 100 Hz, `[pictures, D]`: as [`play`] has it.
///
/// # Errors
///
/// Parameters that cannot be drawn.
pub fn at_pictures(tracks: ArrayView2<f32>, fps: u32, samples: Option<usize>) -> Result<Array2<f32>> {
    let mut shown = Tracks::new(tracks.ncols());
    play(&mut shown, tracks, fps, samples, |_| Ok::<(), Error>(()), &())?;
    Ok(shown.into_rows())
}

/// Energy of a sound around each of `pictures` pictures, decibels over one step of a sample.
///
/// # Errors
///
/// That the sound cannot be read.
pub fn energy(sound: &Soundtrack, fps: u32, pictures: usize) -> Result<Vec<f32>> {
    let mut sums = vec![(0.0f64, 0u32); pictures];
    let mut at = 0u64;
    sound
        .each(|samples| {
            for sample in samples {
                let picture = (at * u64::from(fps) / u64::from(SAMPLE_RATE_HZ)) as usize;
                if let Some((sum, count)) = sums.get_mut(picture) {
                    (*sum, *count) = (*sum + f64::from(*sample).powi(2), *count + 1);
                }
                at += 1;
            }
            Ok::<(), lipstream_media::sound::SoundError>(())
        })
        .map_err(Error::other)?;
    let loud = |(sum, count): (f64, u32)| (10.0 * (sum / f64::from(count.max(1)) + 1.0).log10()) as f32;
    Ok(sums.into_iter().map(loud).collect())
}

/// A finished video and what was drawn for it.
pub struct Rendered {
    /// The video file's bytes.
    pub mp4: Vec<u8>,
    /// Width of a picture in pixels.
    pub width: usize,
    /// Height of a picture in pixels.
    pub height: usize,
    /// Number of pictures.
    pub pictures: usize,
}

/// Draws parameters `[frames, D]` at 100 Hz into `sink`, `fps` pictures a second, with pictures to the end of a sound of `samples` samples
/// where there is one; gives their number.
///
/// # Errors
///
/// Parameters that cannot be drawn, and what scene and sink say.
pub fn play<E: From<Error>>(
    scene: &mut dyn Scene,
    tracks: ArrayView2<f32>,
    fps: u32,
    samples: Option<usize>,
    sink: impl FnMut(&[u8]) -> Result<(), E>,
    progress: &dyn Progress,
) -> Result<usize, E> {
    Player::new(scene, fps, samples).play(tracks, sink, progress)
}

/// What is counted while a film is drawn.
pub const PICTURES: &str = "pictures";

/// Draws parameters `[frames, D]` at 100 Hz and gives them as MP4 in memory, with `sound` (16 kHz) where there is one.
///
/// # Errors
///
/// As [`play`].
pub fn to_mp4(
    space: &MouthSpace,
    tracks: ArrayView2<f32>,
    sound: Option<&[i16]>,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Rendered> {
    let mut scene = Painter::new(space, settings)?;
    let film = film(&scene, settings, sound.map(Soundtrack::Samples));
    let mut mp4 = Mp4Bytes::new(&film)?;
    let samples = sound.map(<[i16]>::len);
    let sink = |rgb: &[u8]| mp4.picture(rgb).map_err(Error::from);
    let pictures = play(&mut scene, tracks, film.fps, samples, sink, progress)?;
    Ok(Rendered {
        mp4: mp4.bytes()?,
        width: film.width,
        height: film.height,
        pictures,
    })
}

/// What every film says of itself, where its format has room for words: pictures of a mouth that looks real and says what it never said should not be
/// taken for a recording.
pub const SYNTHETIC: &str =
    "Synthetic: this mouth was drawn by lipstream from speech or parameters. It is not a recording.";

/// What a sink has to know of a scene.
pub fn film<'s>(scene: &dyn Scene, settings: &Settings, sound: Option<Soundtrack<'s>>) -> Film<'s> {
    film_of(scene, settings.fps, sound)
}

/// What a sink has to know of a scene that has no settings of the mouth's.
pub fn film_of<'s>(scene: &dyn Scene, fps: u32, sound: Option<Soundtrack<'s>>) -> Film<'s> {
    let (width, height) = scene.size();
    Film {
        width,
        height,
        fps,
        sound,
        comment: Some(SYNTHETIC),
    }
}

#[cfg(test)]
mod tests;
