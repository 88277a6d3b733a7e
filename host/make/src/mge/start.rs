//! Where minimum generation error training starts: directions and emissions from the forced alignment of the
//! likelihood-trained model, the global map by least squares, the rest small and random.
use nalgebra::DMatrix;
use ndarray::{Array1, Array2};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::em::source::in_order;
use crate::error::{Error, Result, bail};
use lipstream::kinds::recurrent::parameters::{Group, Parameters, Shape};
use lipstream::kinds::recurrent::step::rate_group;
use lipstream::random::fill_normal;

/// One clip for the start: contexts `[T, C]`, states of the alignment, mouth `[T, D]` (standardised) if it has one.
pub struct Seen {
    /// Contexts, `[T, C]`.
    pub context: Array2<f32>,
    /// Audio and visual state of every frame.
    pub states: Vec<(usize, usize)>,
    /// The mouth, standardised, `[T, D]`; `None` without video.
    pub mouth: Option<Array2<f32>>,
}

/// How many clips there are, and what reads one.
pub type Clips<'a> = (usize, &'a (dyn Fn(usize) -> Result<Seen> + Sync));

/// MgeTrainSettings of the start.
#[derive(Clone, Debug, PartialEq)]
pub struct StartSettings {
    /// Factor on the linear discriminants that become emissions.
    pub emission_scale: f32,
    /// Deviation of the gains around their rest.
    pub gain: f32,
    /// Deviation around 0 of the drives that the states own.
    pub drive: f32,
    /// Deviation around 0 of the map from the memory to the mouth.
    pub output: f32,
    /// Logits of the slowest and the fastest rate.
    pub rates: (f32, f32),
}

impl Default for StartSettings {
    fn default() -> Self {
        Self {
            emission_scale: 0.3,
            gain: 0.5,
            drive: 0.3,
            output: 0.02,
            rates: (-3.5, 0.5),
        }
    }
}

/// Added to the eigenvalues of the context's covariance, as a share of their mean.
const SHRINK: f64 = 1e-3;

/// Moments of the contexts.
struct Moments {
    n: f64,
    mean: Array1<f64>,
    covariance: DMatrix<f64>,
}

fn moments(c: usize, clips: &Clips) -> Result<Moments> {
    let mut n = 0.0;
    let mut sum = Array1::<f64>::zeros(c);
    let mut second = Array2::<f64>::zeros((c, c));
    in_order(clips.0, clips.1, |clip| {
        n += clip.context.nrows() as f64;
        sum += &clip.context.sum_axis(ndarray::Axis(0)).mapv(f64::from);
        second += &clip.context.t().dot(&clip.context).mapv(f64::from);
        Ok(())
    })?;
    if n == 0.0 {
        bail!(Data, "no clip to start from")
    }
    let mean = sum / n;
    let covariance = DMatrix::from_fn(c, c, |i, j| second[[i, j]] / n - mean[i] * mean[j]);
    Ok(Moments { n, mean, covariance })
}

/// Eigenvalues, largest first, and eigenvectors as columns, signs fixed.
fn eigen(matrix: DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let n = matrix.nrows();
    let found = matrix.symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|&a, &b| found.eigenvalues[b].total_cmp(&found.eigenvalues[a]));
    let values = order.iter().map(|&i| found.eigenvalues[i]).collect();
    let mut vectors = DMatrix::zeros(n, n);
    for (to, &from) in order.iter().enumerate() {
        let column = found.eigenvectors.column(from);
        let largest = column
            .iter()
            .fold(0.0f64, |m, v| if v.abs() > m.abs() { *v } else { m });
        vectors.set_column(to, &(column * largest.signum()));
    }
    (values, vectors)
}

/// Sums by audio state.
struct ByState {
    count: Vec<f64>,
    sum: DMatrix<f64>,
}

/// The start of every parameter, and the contexts' mean.
///
/// `transition` `[P, 60]` and `initial` `[P]` are natural logs of the likelihood-trained model.
pub fn start(
    shape: &Shape,
    clips: &Clips,
    transition: &Array2<f32>,
    initial: &[f32],
    settings: &StartSettings,
    seed: u64,
) -> Result<(Parameters, Array1<f32>)> {
    let c = shape.context.size();
    let (z, h, d, a) = (shape.inputs, shape.memory, shape.outputs, shape.audio_states());
    if z > c {
        bail!(Choice, "{z} inputs are more than the {c} numbers of a context");
    }
    let Moments { n, mean, covariance } = moments(c, clips)?;
    let mut sums = ByState {
        count: vec![0.0; a],
        sum: DMatrix::zeros(c, a),
    };
    let (mut seen, mut cross) = (0.0, DMatrix::<f64>::zeros(c, d));
    in_order(clips.0, clips.1, |clip| {
        for (t, row) in clip.context.outer_iter().enumerate() {
            let state = clip.states[t].0;
            sums.count[state] += 1.0;
            let mut column = sums.sum.column_mut(state);
            for (i, v) in row.iter().enumerate() {
                column[i] += f64::from(*v) - mean[i];
            }
        }
        if let Some(mouth) = &clip.mouth {
            seen += mouth.nrows() as f64;
            let centred = &clip.context - &mean.mapv(|m| m as f32);
            let product = centred.t().dot(mouth);
            cross += DMatrix::from_fn(c, d, |i, j| f64::from(product[[i, j]]));
        }
        Ok(())
    })?;
    if seen == 0.0 {
        bail!(Data, "no clip with a mouth to start from");
    }
    // Whitening.
    let (values, vectors) = eigen(covariance.clone());
    let floor = SHRINK * values.iter().sum::<f64>() / c as f64;
    let whiten = DMatrix::from_fn(c, c, |i, j| vectors[(j, i)] / (values[i].max(0.0) + floor).sqrt());
    // Between-state scatter of white contexts.
    let mut between = DMatrix::<f64>::zeros(c, c);
    for s in 0..a {
        if sums.count[s] > 0.0 {
            let m = &whiten * sums.sum.column(s) / sums.count[s];
            between += &m * m.transpose() * (sums.count[s] / n);
        }
    }
    let towards_mouth = &whiten * &cross / seen;
    let (_, ridge) = eigen(&towards_mouth * towards_mouth.transpose());
    let (_, discriminant) = eigen(between);
    // Gram-Schmidt over [mouth: a quarter, discriminants: half, principal components: the rest].
    let candidates = (0..(z / 4).min(d))
        .map(|i| ridge.column(i).into_owned())
        .chain((0..z / 2).map(|i| discriminant.column(i).into_owned()))
        .chain((0..c).map(|i| {
            let mut e = nalgebra::DVector::zeros(c);
            e[i] = 1.0;
            e
        }));
    let mut rows: Vec<nalgebra::DVector<f64>> = Vec::with_capacity(z);
    for mut v in candidates {
        if rows.len() == z {
            break;
        }
        for _ in 0..2 {
            for row in &rows {
                let along = row.dot(&v);
                v -= row * along;
            }
        }
        let length = v.norm();
        if length > 1e-3 {
            rows.push(v / length);
        }
    }
    let basis = DMatrix::from_fn(z, c, |i, j| rows[i][j]);
    let projection = &basis * &whiten;

    // Means and within-state covariance of z.
    let total = &projection * &covariance * projection.transpose();
    let mut means = DMatrix::<f64>::zeros(z, a);
    let mut within = total.clone();
    for s in 0..a {
        if sums.count[s] > 0.0 {
            let m = &projection * sums.sum.column(s) / sums.count[s];
            within -= &m * m.transpose() * (sums.count[s] / n);
            means.set_column(s, &m);
        }
    }
    for i in 0..z {
        within[(i, i)] += 1e-3;
    }
    let factor = within
        .cholesky()
        .ok_or_else(|| Error::Numbers("the within-state covariance is singular".into()))?;
    let discriminants = factor.solve(&means);
    let scale = settings.emission_scale;

    // W₀ by ridge.
    let mut gram = total;
    for i in 0..z {
        gram[(i, i)] += 1e-3;
    }
    let global = gram
        .cholesky()
        .ok_or_else(|| Error::Numbers("the inputs' covariance is singular".into()))?
        .solve(&(&projection * &cross / seen));

    let mut p = Parameters::zeros(shape);
    let mut rng = Pcg64::seed_from_u64(seed);
    p.assign(
        Group::Projection,
        &Array2::from_shape_fn((z, c), |(i, j)| projection[(i, j)] as f32),
    );
    p.assign(
        Group::Audio,
        &Array2::from_shape_fn((a, z), |(s, i)| scale * discriminants[(i, s)] as f32),
    );
    for s in 0..a {
        let square = means.column(s).dot(&discriminants.column(s));
        p.of_mut(Group::AudioBias)[s] = -0.5 * scale * square as f32;
    }
    p.assign(
        Group::Global,
        &Array2::from_shape_fn((d, z), |(j, i)| global[(i, j)] as f32),
    );
    fill_normal(p.of_mut(Group::Drive), 0.0, (z as f32).sqrt().recip(), &mut rng);
    fill_normal(p.of_mut(Group::Visual), 0.0, 0.05, &mut rng);
    for group in [Group::AudioGain, Group::VisualGain] {
        let rest = group.rest(shape).unwrap_or(1.0);
        fill_normal(p.of_mut(group), rest, settings.gain, &mut rng);
    }
    for group in [Group::AudioDrive, Group::VisualDrive] {
        fill_normal(p.of_mut(group), 0.0, settings.drive, &mut rng);
    }
    fill_normal(p.of_mut(Group::Output), 0.0, settings.output, &mut rng);
    let (slow, fast) = settings.rates;
    for (i, logit) in p.of_mut(rate_group(shape)).iter_mut().enumerate() {
        let place = (i % h) as f32 / (h.max(2) - 1) as f32;
        *logit = slow + (fast - slow) * place + 0.1 * rng.random_range(-1.0f32..1.0);
    }
    p.of_mut(Group::Initial).copy_from_slice(initial);
    p.assign(Group::Transition, transition);
    Ok((p, mean.mapv(|m| m as f32)))
}
