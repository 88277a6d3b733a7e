//! How far a mouth is open, and how wide it is, from its parameters: what rigs, servos and blend shapes want of a frame beside its
//! visemes, without drawing it.
//!
//! Both are linear in the parameters. They are learnt from the eigenmouths alone: mouths are drawn whose parameters have the deviations
//! that the model knows, the lips in them are measured ([`crate::lips`]), and a straight line is laid through what was measured. How well that
//! follows landmarks of real videos is in `docs/live.md`: the gap very well (0.96), the width weakly (0.43).
use std::path::Path;

use lipstream_core::model::container::MAGIC;
use lipstream_core::servo::{self, ReadOut};
use lipstream_media::files;
use ndarray::{Array1, Array2, Array4};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::error::Result;
use crate::lips::Lips;
use crate::mouth::MouthSpace;
use crate::random::normal;
use crate::tensors::Tensors;

/// Mouths that are drawn: some for each parameter.
const MOUTHS: usize = 400;
/// Penalty on the weights, as a share of the mouths: what is not linear is not to be followed.
const PENALTY: f64 = 0.02;
/// A mouth as wide open, as wide or as narrow as it ever is in speech: so many deviations from its mean.
const FAR: f32 = 2.0;

/// Most fraction bits of a device's slopes: beyond these nothing is gained.
const DEVICE_SHIFT: u8 = 24;

/// How open and how wide a mouth is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Opening {
    /// Between the lips: 0 closed, 1 as wide open as this mouth is in speech.
    pub gap: f32,
    /// Between the corners: −1 as narrow as this mouth is in speech, 0 its mean, 1 as wide.
    pub width: f32,
}

/// A number that is linear in the parameters.
#[derive(Clone, Debug, PartialEq)]
struct Line {
    offset: f32,
    slopes: Array1<f32>,
}

impl Line {
    fn at(&self, parameters: &[f32]) -> f32 {
        let products = parameters.iter().zip(&self.slopes).map(|(p, s)| p * s);
        self.offset + products.sum::<f32>()
    }

    /// In whole numbers, with as many fraction bits as the steepest slope leaves room for.
    fn for_device(&self, scales: &[f32]) -> Option<servo::Line> {
        let one = f64::from(i16::MAX);
        if self.slopes.len() > scales.len() {
            return None;
        }
        // Parameters of other groups change nothing.
        let slopes = self.slopes.iter().chain(std::iter::repeat(&0.0)).zip(scales);
        let slopes: Vec<f64> = slopes
            .map(|(slope, scale)| one * f64::from(*slope) * f64::from(*scale))
            .collect();
        let steepest = slopes.iter().fold(0.0, |most: f64, slope| most.max(slope.abs()));
        let fits = |shift: &u8| (steepest * f64::from(1_u32 << shift)).round() <= one;
        let shift = (0..=DEVICE_SHIFT).rev().find(fits)?;
        let whole = |slope: &f64| (slope * f64::from(1_u32 << shift)).round() as i16;
        let whole: Vec<i16> = slopes.iter().map(whole).collect();
        servo::Line::of((one * f64::from(self.offset)).round() as i32, shift, &whole)
    }
}

/// Reads openings out of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct OpeningReader {
    gap: Line,
    width: Line,
}

impl OpeningReader {
    /// Learns from a mouth; None where nothing in it looks like lips.
    pub fn of(space: &MouthSpace) -> Option<Self> {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let size = space.size();
        // In deviations, so that one penalty is right for all.
        let drawn = Array2::from_shape_simple_fn((MOUTHS, size), || normal(&mut rng));
        let mut images = Array4::zeros((MOUTHS, space.height, space.width, 3));
        for (mut image, row) in images.outer_iter_mut().zip(drawn.outer_iter()) {
            let weights = &row * &space.deviation;
            let levels = space.expand(weights.view());
            for (to, level) in image.iter_mut().zip(&levels) {
                *to = level.round() as u8; // `as` saturates
            }
        }
        let lips = Lips::learn(images.view())?;
        let gaps = lips.gaps(images.view())?;
        let widths: Vec<f32> = images.outer_iter().map(|image| lips.corners(image)).collect();
        let gap = Fit::of(&drawn, &gaps);
        let width = Fit::of(&drawn, &widths);
        let closed = lips.closed_below();
        let open = gap.mean + FAR * gap.deviation();
        if open - closed < 1.0 || width.deviation() < 0.1 {
            return None;
        }
        Some(Self {
            gap: gap.line(&space.deviation, closed, open - closed),
            width: width.line(&space.deviation, width.mean, FAR * width.deviation()),
        })
    }

    /// For the shipped model; None as in [`OpeningReader::of`].
    ///
    /// # Errors
    ///
    /// None, as long as the shipped model is whole.
    pub fn shipped() -> Result<Option<Self>> {
        let tensors = Tensors::read_or_shipped(None)?;
        Ok(Self::of(&MouthSpace::load(&tensors)?))
    }

    /// For the model in a file; None where the file has no mouth, as tables have none, and as in [`OpeningReader::of`].
    ///
    /// # Errors
    ///
    /// That the file cannot be read.
    pub fn of_file(path: &Path) -> Result<Option<Self>> {
        let bytes = files::read_bytes(path)?;
        if bytes.starts_with(&MAGIC) {
            return Ok(None);
        }
        let tensors = Tensors::parse(&bytes, &path.display().to_string())?;
        match tensors.has("mouth.mean") {
            true => Ok(Self::of(&MouthSpace::load(&tensors)?)),
            false => Ok(None),
        }
    }

    /// The same for a device, whose parameters `[D]` are whole numbers of `scales`: what a servo's calibration carries. None where there are no
    /// parameters, more than a frame has, or a line too steep to be written down.
    pub fn read_out(&self, model: u32, scales: &[f32]) -> Option<ReadOut> {
        ReadOut::of(
            model,
            self.gap.for_device(scales)?,
            self.width.for_device(scales)?,
        )
    }

    /// The gap of the mean mouth, whose parameters are 0; lips are closed at 0.
    pub fn gap_offset(&self) -> f32 {
        self.gap.offset
    }

    /// By how much the gap changes with each parameter `[D]`, in its unit a real unit.
    pub fn gap_slopes(&self) -> &Array1<f32> {
        &self.gap.slopes
    }

    /// The opening of a frame's parameters `[D]`, in real units; those of other groups behind the mouth's are left alone.
    pub fn read(&self, parameters: &[f32]) -> Opening {
        Opening {
            gap: self.gap.at(parameters).clamp(0.0, 1.0),
            width: self.width.at(parameters).clamp(-1.0, 1.0),
        }
    }
}

/// A straight line through numbers over parameters in deviations.
struct Fit {
    mean: f32,
    slopes: Array1<f32>,
}

impl Fit {
    /// Least squares with a penalty, by conjugate gradients: the matrix is nearly a multiple of one, so that few steps are enough.
    fn of(drawn: &Array2<f32>, values: &[f32]) -> Self {
        let x = drawn.mapv(f64::from);
        let n = values.len() as f64;
        let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / n;
        let centred: Array1<f64> = values.iter().map(|v| f64::from(*v) - mean).collect();
        let times = |v: &Array1<f64>| x.t().dot(&x.dot(v)) + v * (PENALTY * n);
        let mut slopes = Array1::zeros(x.ncols());
        let mut rest = x.t().dot(&centred);
        let mut direction = rest.clone();
        let mut square = rest.dot(&rest);
        for _ in 0..30 {
            if square < 1e-12 {
                break;
            }
            let image = times(&direction);
            let step = square / direction.dot(&image);
            slopes.scaled_add(step, &direction);
            rest.scaled_add(-step, &image);
            let next = rest.dot(&rest);
            direction = &rest + &(direction * (next / square));
            square = next;
        }
        Self {
            mean: mean as f32,
            slopes: slopes.mapv(|s| s as f32),
        }
    }

    /// Deviation of what the line gives.
    fn deviation(&self) -> f32 {
        self.slopes.dot(&self.slopes).sqrt()
    }

    /// The line over parameters in real units, less `zero`, in parts of `one`.
    fn line(&self, deviation: &Array1<f32>, zero: f32, one: f32) -> Line {
        let unit = |(slope, deviation): (&f32, &f32)| match *deviation > 0.0 {
            true => slope / deviation / one,
            false => 0.0,
        };
        Line {
            offset: (self.mean - zero) / one,
            slopes: self.slopes.iter().zip(deviation).map(unit).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::drawn::{Pose, draw};

    fn shipped() -> MouthSpace {
        MouthSpace::load(&Tensors::read_or_shipped(None).unwrap()).unwrap()
    }

    #[test]
    fn the_shipped_mouth_opens_and_widens() {
        let space = shipped();
        let reader = OpeningReader::of(&space).unwrap();
        // Its mean mouth is neither shut nor wide open.
        let mean = reader.read(&vec![0.0; space.size()]);
        assert!(
            (0.1..0.7).contains(&mean.gap) && mean.width.abs() < 0.05,
            "{mean:?}"
        );
        // The direction in which the line rises fastest opens the drawn mouth as well.
        let towards = |line: &Line, amount: f32| -> Vec<f32> {
            let steep: Array1<f32> = &line.slopes * &space.deviation * &space.deviation;
            let length = (&steep / &space.deviation).mapv(|v| v * v).sum().sqrt();
            (steep * (amount / length)).to_vec()
        };
        let gaps: Vec<f32> = [-2.0, -1.0, 0.0, 1.0, 2.0]
            .map(|amount| reader.read(&towards(&reader.gap, amount)).gap)
            .to_vec();
        assert!(gaps.is_sorted() && gaps[0] == 0.0 && gaps[4] > 0.95, "{gaps:?}");
        let widths = [-2.0, 2.0].map(|amount| reader.read(&towards(&reader.width, amount)).width);
        assert!(widths[0] < -0.95 && widths[1] > 0.95, "{widths:?}");
    }

    #[test]
    fn drawn_mouths_are_read_as_they_were_drawn() {
        let space = crate::render::drawn::space(6);
        let reader = OpeningReader::of(&space).unwrap();
        let read = |pose| reader.read(&space.project(draw(pose).view()).to_vec());
        let pose = |open, round, spread| Pose { open, round, spread };
        assert!(read(pose(0.0, 0.0, 0.0)).gap < 0.15);
        assert!(read(pose(1.0, 0.0, 0.0)).gap > 0.7);
        let half = read(pose(0.5, 0.0, 0.0)).gap;
        assert!((0.25..0.75).contains(&half), "{half}");
        let (narrow, wide) = (read(pose(0.3, 1.0, 0.0)).width, read(pose(0.3, 0.0, 1.0)).width);
        assert!(narrow < -0.2 && wide > 0.15, "{narrow} {wide}");
    }

    /// What a device reads is what is read here, to half a thousandth.
    #[test]
    fn a_device_reads_the_same() {
        use rand::RngExt as _;

        let space = shipped();
        let reader = OpeningReader::of(&space).unwrap();
        let engine = crate::engine::Engine::shipped();
        let scales: Vec<f32> = engine.tables().unwrap().head().parameter_scales().collect();
        let device = reader.read_out(7, &scales).unwrap();
        assert_eq!((device.model(), device.n_parameters()), (7, space.size()));
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let (mut worst, mut seen) = (0.0_f32, [f32::MAX, f32::MIN]);
        for _ in 0..2_000 {
            let times = rng.random_range(0.0..3.0_f32);
            let values: Vec<i16> = std::iter::zip(&space.deviation, &scales)
                .map(|(deviation, scale)| (times * normal(&mut rng) * deviation / scale) as i16)
                .collect();
            let real: Vec<f32> = values
                .iter()
                .zip(&scales)
                .map(|(v, s)| f32::from(*v) * s)
                .collect();
            let (want, (gap, width)) = (reader.read(&real), device.read(&values));
            for (want, have) in [(want.gap, gap), (want.width, width)] {
                worst = worst.max((want - f32::from(have) / 32_767.0).abs());
                seen = [seen[0].min(want), seen[1].max(want)];
            }
        }
        println!("at most {worst} off");
        assert!(worst < 5e-4, "{worst}");
        assert_eq!(seen, [-1.0, 1.0]);
        assert_eq!(reader.read_out(7, &vec![1e9; space.size()]), None);
        assert_eq!(reader.read_out(7, &scales[1..]), None);
        // A group behind the mouth's.
        let two = reader.read_out(7, &[&scales[..], &[1.0]].concat()).unwrap();
        let mut values = vec![100; space.size()];
        let mouth = device.read(&values);
        values.push(i16::MAX);
        assert_eq!(two.read(&values), mouth);
    }

    #[test]
    fn a_wall_has_no_opening() {
        let mut space = shipped();
        space.mean.fill(128.0);
        space.basis.fill(0.0);
        assert_eq!(OpeningReader::of(&space), None);
    }
}
