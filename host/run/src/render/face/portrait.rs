//! What draws one picture of a recording whose mouth says something else. What the picture shows is chosen by [`FaceScene`](super::FaceScene), which knows the whole film,
//! or by [`LiveFace`](super::LiveFace), which knows what has been said so far.
use ndarray::{Array1, ArrayView1};

use super::course::{Course, Moment};
use super::footage::Footage;
use super::jaw::Jaws;
use super::layer::Region;
use super::mouths::{Mouths, Whose};
use super::raster::{Bytes, Floats, coarse_at, luminance};
use super::scene::FaceSettings;
use crate::affine::Affine;
use crate::error::{Result, bail};
use crate::mouth::MouthSpace;
use crate::random::{normal, of_picture};
use crate::render::refine::{CANDIDATES, Choice};

/// What one picture shows.
pub(super) struct Shown<'a> {
    /// Number of the picture in the film, which its camera noise depends on.
    pub(super) number: usize,
    /// Weights of the eigenmouths, `[D]`.
    pub(super) weights: ArrayView1<'a, f32>,
    /// Which recorded picture lies behind.
    pub(super) moment: Moment,
    /// Fine detail in levels.
    pub(super) detail: Option<Vec<f32>>,
    /// The recorded picture that lends its lower face.
    pub(super) lower: Option<usize>,
}

/// What has been learnt from a recording, and draws onto it.
pub(super) struct Portrait {
    pub(super) mouths: Mouths,
    pub(super) course: Course,
    pub(super) jaws: Option<Jaws>,
    /// How details are chosen.
    pub(super) choice: Option<Choice>,
    /// Standard deviation of the camera noise in levels.
    pub(super) noise: f32,
    region: Region,
}

impl Portrait {
    /// Learns how the recording's mouths look; without camera noise yet, where the settings do not say it.
    ///
    /// # Errors
    ///
    /// That the recording has no pictures, cannot be read, or that a setting is out of range.
    pub(super) fn learn(footage: &mut Footage, space: &MouthSpace, settings: &FaceSettings) -> Result<Self> {
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
        let jaws = match settings.jaw {
            Some(_) => Jaws::learn(footage, mouths.seen().0, mouths.seen().1)?,
            None => None,
        };
        let (width, height) = footage.mouth;
        Ok(Self {
            mouths,
            course,
            jaws,
            choice,
            noise: settings.noise.unwrap_or(0.0),
            region: Region::of_mouth(width, height),
        })
    }

    /// Forgets the picture before: the next one depends on nothing but itself.
    pub(super) fn begin_anew(&mut self) {
        self.region.begin_anew();
        if let Some(jaws) = &mut self.jaws {
            jaws.region.begin_anew();
        }
    }

    /// How much of a place of the mouth's rectangle is drawn, 0..=1; the edges of a turned head are not looked at.
    pub(super) fn opacity(&self, x: f32, y: f32) -> f32 {
        let jaw = self.jaws.as_ref().map_or(0.0, |jaws| jaws.region.opacity(x, y));
        jaw.max(self.region.opacity(x, y))
    }

    /// A picture, rows of R, G, B.
    ///
    /// # Errors
    ///
    /// That the recording cannot be read.
    pub(super) fn draw(
        &mut self,
        footage: &mut Footage,
        space: &MouthSpace,
        shown: &Shown,
    ) -> Result<Vec<u8>> {
        let size = footage.pictures.size();
        let (mut rgb, map) = background(footage, shown.moment)?;
        let here = footage.places[shown.moment.picture].clone();
        if let (Some(jaws), Some(picture)) = (&mut self.jaws, shown.lower) {
            let mut lender = Vec::new();
            let from = footage.pictures.read(picture, &mut lender)?;
            let there = &footage.places[picture];
            let share = |x: f32, y: f32| here.on_face(x, y).min(there.on_face(x, y));
            jaws.region.stitch(&mut rgb, size, &map, share, |x, y| {
                let (px, py) = there.mouth.apply(x, y);
                from.sample_cubic(px, py)
            });
        }
        let image = self.mouth(space, shown);
        let sharp = self.mouths.sharp();
        let mouth = Floats {
            rgb: &image,
            width: footage.mouth.0 * sharp,
            height: footage.mouth.1 * sharp,
        };
        let fine = |at: f32| (at + 0.5) * sharp as f32 - 0.5;
        let share = |x: f32, y: f32| here.on_face(x, y);
        self.region.stitch(&mut rgb, size, &map, share, |x, y| {
            mouth.sample_cubic(fine(x), fine(y))
        });
        Ok(rgb)
    }

    /// The mouth of a picture, at the recording's sharpness.
    fn mouth(&self, space: &MouthSpace, shown: &Shown) -> Vec<f32> {
        let mut image = self.mouths.draw(space, shown.weights, shown.detail.as_deref());
        if self.noise > 0.0 {
            let mut random = of_picture(shown.number);
            // A camera's noise is in grey more than in colour.
            for pixel in image.chunks_exact_mut(3) {
                let grain = self.noise * normal(&mut random);
                pixel.iter_mut().for_each(|level| *level += grain);
            }
        }
        image
    }

    /// Adds the camera noise that recorded mouths have beyond drawn ones, of which these are some.
    ///
    /// # Errors
    ///
    /// That the recording cannot be read.
    pub(super) fn add_lacking_noise(
        &mut self,
        footage: &mut Footage,
        space: &MouthSpace,
        some: &[Shown],
    ) -> Result<()> {
        let sharp = self.mouths.sharp();
        let size = (footage.mouth.0 * sharp, footage.mouth.1 * sharp);
        let mut recorded = Vec::new();
        for picture in evenly(self.mouths.seen().1.len()).map(|at| self.mouths.seen().1[at]) {
            let image = recorded_mouth(footage, picture, size, sharp)?;
            recorded.push(grain(&image, size));
        }
        let mut drawn = Vec::new();
        for shown in some {
            drawn.push(grain(&self.mouth(space, shown), size));
        }
        let middle = |of: &mut Vec<f32>| {
            of.sort_by(f32::total_cmp);
            of.get(of.len() / 2).copied().unwrap_or(0.0)
        };
        let (recorded, drawn) = (middle(&mut recorded), middle(&mut drawn));
        self.noise = (recorded * recorded - drawn * drawn).max(0.0).sqrt();
        Ok(())
    }
}

/// Numbers of some forty of `count`, evenly: as many mouths as noise is looked at in.
pub(super) fn evenly(count: usize) -> impl Iterator<Item = usize> {
    const LOOKS: usize = 40;
    (0..count).step_by((count / LOOKS).max(1))
}

/// The mouth in a recorded picture, as sharp as it is drawn.
fn recorded_mouth(
    footage: &mut Footage,
    picture: usize,
    (across, down): (usize, usize),
    sharp: usize,
) -> Result<Vec<f32>> {
    let mut rgb = Vec::new();
    let from = footage.pictures.read(picture, &mut rgb)?;
    let map = footage.places[picture].mouth;
    let mut image = Vec::with_capacity(across * down * 3);
    for y in 0..down {
        for x in 0..across {
            let (px, py) = map.apply(coarse_at(x, sharp), coarse_at(y, sharp));
            image.extend(from.sample_cubic(px, py));
        }
    }
    Ok(image)
}

/// The background at a moment, and where the mouth's rectangle lies in it.
///
/// # Errors
///
/// That the recording cannot be read.
pub(super) fn background(footage: &mut Footage, moment: Moment) -> Result<(Vec<u8>, Affine)> {
    let size = footage.pictures.size();
    let mut rgb = Vec::new();
    footage.pictures.read(moment.picture, &mut rgb)?;
    let map = footage.places[moment.picture].mouth;
    let Some((next, share)) = moment.next else {
        return Ok((rgb, map));
    };
    let mut other = Vec::new();
    footage.pictures.read(next, &mut other)?;
    let there = footage.places[next].mouth;
    let between = Affine::mean([(&map, 1.0 - share), (&there, share)]).unwrap_or(map);
    Ok((
        dissolved((&rgb, &map), (&other, &there), share, &between, size),
        between,
    ))
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
    let row = |y: usize, out: &mut [u8]| {
        for (x, pixel) in out.chunks_exact_mut(3).enumerate() {
            let at = |map: &Affine, from: &Bytes| {
                let (u, v) = map.apply(x as f32, y as f32);
                from.sample_cubic(u, v)
            };
            let (here, there) = (at(&to_a, &a), at(&to_b, &b));
            for (c, level) in pixel.iter_mut().enumerate() {
                *level = (here[c] + share * (there[c] - here[c])).round() as u8;
            }
        }
    };
    // Twice the samples of a whole picture take several times as long as all that is drawn onto it: live it would come late.
    let mut out = vec![0; width * height * 3];
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let rows = height.div_ceil(cores).max(1);
    std::thread::scope(|scope| {
        for (band, out) in out.chunks_mut((rows * width * 3).max(1)).enumerate() {
            scope.spawn(move || {
                for (y, line) in out.chunks_mut(width * 3).enumerate() {
                    row(band * rows + y, line);
                }
            });
        }
    });
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
