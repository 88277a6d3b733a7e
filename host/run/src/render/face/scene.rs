//! The scene: a recording whose mouth says something else.
use ndarray::{Array1, ArrayView1, ArrayView2};
use rand::SeedableRng as _;
use rand_pcg::Pcg32;

use super::course::{Course, Moment};
use super::footage::Footage;
use super::jaw::{Asked, JawBy, Jaws};
use super::layer::Region;
use super::mouths::{Mouths, Whose};
use super::raster::{Bytes, Floats, coarse_at, luminance};
use crate::affine::Affine;
use crate::error::{Result, bail};
use crate::mouth::MouthSpace;
use crate::random::normal;
use crate::render::Scene;
use crate::render::refine::{CANDIDATES, Choice};

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
    mouths: Mouths,
    course: Course,
    region: Region,
    jaws: Option<Jaws>,
    /// How details were chosen, and the candidate of each picture.
    choice: Option<Choice>,
    details: Vec<usize>,
    /// Picture that lends each its lower face.
    lower: Vec<usize>,
    fps: u32,
    noise: f32,
    random: Pcg32,
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
        if !(1..=100).contains(&settings.fps) {
            bail!(Choice, "{} pictures a second: choose 1 to 100", settings.fps);
        }
        if settings
            .noise
            .is_some_and(|noise| !(0.0..=100.0).contains(&noise))
        {
            bail!(Choice, "the camera noise is 0 to 100 levels");
        }
        let mouths = Mouths::learn(footage, space, settings.whose, CANDIDATES)?;
        let course = Course::new(&looks(footage)?, footage.rate_hz)?;
        let choice = match mouths.whose() {
            Whose::Trained => settings.detail,
            // Such a mouth is nothing but what is chosen.
            Whose::Opened => Some(settings.detail.unwrap_or_default()),
            Whose::Models => None,
        };
        let moment = |n: usize| course.at(middle(n, settings.fps));
        let turned: Vec<f32> = (0..wanted.tracks.nrows())
            .map(|n| footage.places[moment(n).picture].turned)
            .collect();
        let keys = mouths.keys(wanted.tracks, &turned);
        let details = choice.map(|choice| mouths.candidates().choose(keys.view(), choice));
        let jaws = match settings.jaw {
            Some(_) => Jaws::learn(footage, mouths.seen().0, mouths.seen().1)?,
            None => None,
        };
        let lower = match (&jaws, settings.jaw) {
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
        let (width, height) = footage.mouth;
        let mut scene = Self {
            footage,
            space,
            mouths,
            course,
            region: Region::of_mouth(width, height),
            jaws,
            choice,
            details: details.unwrap_or_default(),
            lower,
            fps: settings.fps,
            noise: 0.0,
            // The same parameters give the same film.
            random: Pcg32::seed_from_u64(7),
            drawn: 0,
        };
        scene.noise = match settings.noise {
            Some(noise) => noise,
            None => scene.lacking_noise(wanted.tracks)?,
        };
        Ok(scene)
    }

    /// How the recording's mouths look.
    pub fn mouths(&self) -> &Mouths {
        &self.mouths
    }

    /// Which recorded picture is shown when.
    pub fn course(&self) -> &Course {
        &self.course
    }

    /// Picture `n` of the film before anything is drawn onto it, and where the mouth's rectangle lies in it.
    ///
    /// # Errors
    ///
    /// That the recording cannot be read.
    pub fn undrawn(&mut self, n: usize) -> Result<(Vec<u8>, Affine)> {
        self.background(self.course.at(middle(n, self.fps)))
    }

    /// How much of a place of the mouth's rectangle is drawn, 0..=1; the edges of a turned head are not looked at.
    pub fn opacity(&self, x: f32, y: f32) -> f32 {
        let jaw = self.jaws.as_ref().map_or(0.0, |jaws| jaws.region.opacity(x, y));
        jaw.max(self.region.opacity(x, y))
    }

    /// The background at a moment, and where the mouth's rectangle lies in it.
    fn background(&mut self, moment: Moment) -> Result<(Vec<u8>, Affine)> {
        let size = self.footage.pictures.size();
        let mut rgb = Vec::new();
        self.footage.pictures.read(moment.picture, &mut rgb)?;
        let map = self.footage.places[moment.picture].mouth;
        let Some((next, share)) = moment.next else {
            return Ok((rgb, map));
        };
        let mut other = Vec::new();
        self.footage.pictures.read(next, &mut other)?;
        let there = self.footage.places[next].mouth;
        let between = Affine::mean([(&map, 1.0 - share), (&there, share)]).unwrap_or(map);
        Ok((
            dissolved((&rgb, &map), (&other, &there), share, &between, size),
            between,
        ))
    }

    /// The mouth of the picture that is drawn next, at the recording's sharpness.
    fn mouth(&mut self, parameters: ArrayView1<f32>, noise: f32) -> Vec<f32> {
        let detail = self
            .choice
            .map(|choice| self.mouths.candidates().shown(&self.details, self.drawn, choice));
        let mut image = self.mouths.draw(self.space, parameters, detail.as_deref());
        if noise > 0.0 {
            // A camera's noise is in grey more than in colour.
            for pixel in image.chunks_exact_mut(3) {
                let grain = noise * normal(&mut self.random);
                pixel.iter_mut().for_each(|level| *level += grain);
            }
        }
        image
    }

    /// The noise of recorded mouths beyond that of drawn ones.
    fn lacking_noise(&mut self, tracks: ArrayView2<f32>) -> Result<f32> {
        let (width, height) = self.footage.mouth;
        let sharp = self.mouths.sharp();
        let size = (width * sharp, height * sharp);
        let (mut recorded, mut drawn) = (Vec::new(), Vec::new());
        let shown: Vec<usize> = self.mouths.seen().1.to_vec();
        for picture in shown.iter().step_by((shown.len() / LOOKS).max(1)) {
            let image = self.recorded_mouth(*picture, size, sharp)?;
            recorded.push(grain(&image, size));
        }
        let n = tracks.nrows();
        for at in (0..n).step_by((n / LOOKS).max(1)) {
            self.drawn = at;
            let image = self.mouth(tracks.row(at), 0.0);
            drawn.push(grain(&image, size));
        }
        self.drawn = 0;
        let middle = |of: &mut Vec<f32>| {
            of.sort_by(f32::total_cmp);
            of.get(of.len() / 2).copied().unwrap_or(0.0)
        };
        let (recorded, drawn) = (middle(&mut recorded), middle(&mut drawn));
        Ok((recorded * recorded - drawn * drawn).max(0.0).sqrt())
    }

    fn recorded_mouth(
        &mut self,
        picture: usize,
        (across, down): (usize, usize),
        sharp: usize,
    ) -> Result<Vec<f32>> {
        let mut rgb = Vec::new();
        let from = self.footage.pictures.read(picture, &mut rgb)?;
        let map = self.footage.places[picture].mouth;
        let mut image = Vec::with_capacity(across * down * 3);
        for y in 0..down {
            for x in 0..across {
                let (px, py) = map.apply(coarse_at(x, sharp), coarse_at(y, sharp));
                image.extend(from.sample_cubic(px, py));
            }
        }
        Ok(image)
    }
}

/// Mouths whose noise is looked at.
const LOOKS: usize = 40;

impl Scene for FaceScene<'_> {
    fn size(&self) -> (usize, usize) {
        self.footage.pictures.size()
    }

    fn n_parameters(&self) -> usize {
        self.space.size()
    }

    fn draw(&mut self, parameters: ArrayView1<f32>) -> Result<Vec<u8>> {
        let size = self.size();
        let moment = self.course.at(middle(self.drawn, self.fps));
        let (mut rgb, map) = self.background(moment)?;
        let here = self.footage.places[moment.picture].clone();
        if let (Some(jaws), Some(picture)) = (&mut self.jaws, self.lower.get(self.drawn)) {
            let mut lender = Vec::new();
            let from = self.footage.pictures.read(*picture, &mut lender)?;
            let there = &self.footage.places[*picture];
            let share = |x: f32, y: f32| here.on_face(x, y).min(there.on_face(x, y));
            jaws.region.stitch(&mut rgb, size, &map, share, |x, y| {
                let (px, py) = there.mouth.apply(x, y);
                from.sample_cubic(px, py)
            });
        }
        let image = self.mouth(parameters, self.noise);
        let sharp = self.mouths.sharp();
        let mouth = Floats {
            rgb: &image,
            width: self.footage.mouth.0 * sharp,
            height: self.footage.mouth.1 * sharp,
        };
        let fine = |at: f32| (at + 0.5) * sharp as f32 - 0.5;
        let share = |x: f32, y: f32| here.on_face(x, y);
        self.region.stitch(&mut rgb, size, &map, share, |x, y| {
            mouth.sample_cubic(fine(x), fine(y))
        });
        self.drawn += 1;
        Ok(rgb)
    }
}

/// Seconds in the middle of picture `n`.
fn middle(n: usize, fps: u32) -> f64 {
    (n as f64 + 0.5) / f64::from(fps)
}

/// Two pictures, each moved so that its mouth lies at `between`, and one dissolved into the other.
fn dissolved(
    (a, of_a): (&[u8], &Affine),
    (b, of_b): (&[u8], &Affine),
    share: f32,
    between: &Affine,
    (width, height): (usize, usize),
) -> Vec<u8> {
    let Some(back) = between.inverse() else {
        return a.to_vec();
    };
    let (to_a, to_b) = (of_a.after(&back), of_b.after(&back));
    let picture = |rgb| Bytes { rgb, width, height };
    let (a, b) = (picture(a), picture(b));
    let mut out = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let at = |map: &Affine, from: &Bytes| {
                let (u, v) = map.apply(x as f32, y as f32);
                from.sample_cubic(u, v)
            };
            let (here, there) = (at(&to_a, &a), at(&to_b, &b));
            out.extend((0..3).map(|c| (here[c] + share * (there[c] - here[c])).round() as u8));
        }
    }
    out
}

/// How each picture of a recording looks: the picture in few pixels, and where its face is.
fn looks(footage: &mut Footage) -> Result<Vec<Vec<f32>>> {
    /// Columns and rows of the reduced picture.
    const SMALL: (usize, usize) = (32, 24);
    /// A face that is off by one of the rectangle's pixels is as bad as a change of so many levels everywhere.
    const LEVELS: f32 = 4.0;
    let (width, height) = footage.pictures.size();
    let scale = footage.scale();
    let mut all = Vec::with_capacity(footage.places.len());
    let mut rgb = Vec::new();
    for index in 0..footage.places.len() {
        footage.pictures.read(index, &mut rgb)?;
        let mut sums = vec![0.0f32; SMALL.0 * SMALL.1];
        let mut counts = sums.clone();
        for y in (0..height).step_by(2) {
            for x in (0..width).step_by(2) {
                let at = y * SMALL.1 / height * SMALL.0 + x * SMALL.0 / width;
                sums[at] += f32::from(rgb[3 * (y * width + x) + 1]);
                counts[at] += 1.0;
            }
        }
        let mut look: Vec<f32> = sums.iter().zip(&counts).map(|(s, n)| s / n.max(1.0)).collect();
        let pixels = (look.len() as f32).sqrt();
        let (mx, my) = (0.5 * footage.mouth.0 as f32, 0.5 * footage.mouth.1 as f32);
        let place = &footage.places[index];
        for (x, y) in [(0.0, 0.0), (mx, my)] {
            let (px, py) = place.mouth.apply(x, y);
            look.extend([px, py].map(|v| v / scale * LEVELS * pixels));
        }
        all.push(look);
    }
    Ok(all)
}

/// Standard deviation of the noise of an image `[height, width, 3]` in luminance: what a mask that kills planes and slopes leaves (Immerkær 1996).
fn grain(image: &[f32], (width, height): (usize, usize)) -> f32 {
    let grey: Array1<f32> = image
        .chunks_exact(3)
        .map(|p| luminance([p[0], p[1], p[2]]))
        .collect();
    let at = |x: usize, y: usize| grey[y * width + x];
    let mut rest = Vec::with_capacity(grey.len());
    for y in 1..height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let corners = at(x - 1, y - 1) + at(x + 1, y - 1) + at(x - 1, y + 1) + at(x + 1, y + 1);
            let sides = at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1);
            rest.push((corners - 2.0 * sides + 4.0 * at(x, y)).abs());
        }
    }
    // The middle one, not the mean: lips and teeth have edges that are no noise. Of Gaussian noise it is 0.6745 · 6 σ.
    rest.sort_by(f32::total_cmp);
    rest.get(rest.len() / 2).copied().unwrap_or(0.0) / (0.6745 * 6.0)
}
