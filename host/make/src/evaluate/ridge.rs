//! The plain baseline: one linear map from stacked cepstra, no states.
use lipstream_core::N_STATIC;
use ndarray::{Array1, Array2, Axis, s};
use rayon::prelude::*;

use super::Truth;
use super::metrics::Score;
use crate::error::{Result, bail};
use crate::train::local_linear::MapSums;
use lipstream::kinds::likelihood::LocalLinear;
use lipstream::kinds::likelihood::local_linear;

/// Ridge regression from the normalised statics around a frame to the mouth.
pub struct RidgeMap {
    taps: Vec<i32>,
    mean: Array1<f32>,
    deviation: Array1<f32>,
    maps: LocalLinear,
}

impl RidgeMap {
    /// Fits on `train`; the penalty with the smallest error on `validation` is taken.
    pub fn fit(train: &[Truth], validation: &[Truth], taps: Vec<i32>) -> Result<Self> {
        let stacked = taps.len() * N_STATIC;
        let Some(size) = train.first().map(|t| t.visual.ncols()) else {
            bail!(Data, "no training clip has video")
        };
        let mut n = 0.0;
        let (mut first, mut second) = (Array1::<f64>::zeros(stacked), Array1::<f64>::zeros(stacked));
        for truth in train {
            let rows = local_linear::stack(truth.audio.slice(s![.., ..N_STATIC]), &taps);
            n += rows.nrows() as f64;
            first += &rows.sum_axis(Axis(0)).mapv(f64::from);
            second += &rows.mapv(|v| f64::from(v).powi(2)).sum_axis(Axis(0));
        }
        let mean = &first / n;
        let deviation = (&second / n - &mean * &mean).mapv(|v| v.max(1e-9).sqrt() as f32);
        let mut map = RidgeMap {
            taps,
            mean: mean.mapv(|v| v as f32),
            deviation,
            maps: LocalLinear {
                global: Array2::zeros((size, stacked + 1)),
                state: ndarray::Array3::zeros((0, size, stacked + 1)),
            },
        };
        let parts: Vec<MapSums> = train
            .par_chunks(32)
            .map(|chunk| {
                let mut sums = MapSums::new(stacked, size, 0);
                for truth in chunk {
                    sums.add(
                        &map.inputs(&truth.audio),
                        &truth.visual,
                        &Array2::zeros((truth.visual.nrows(), 0)),
                    );
                }
                sums
            })
            .collect();
        let mut sums = MapSums::new(stacked, size, 0);
        parts.iter().for_each(|part| sums.merge(part));
        let mut best = f64::INFINITY;
        for penalty in [3e2, 1e3, 3e3, 1e4, 3e4, 1e5] {
            let maps = std::mem::replace(&mut map.maps, sums.solve(penalty, 1.0)?);
            let mut score = Score::new(size);
            let judges = if validation.is_empty() { train } else { validation };
            judges
                .iter()
                .for_each(|truth| score.add(&truth.visual, &map.predict(&truth.audio)));
            if score.amse() < best {
                best = score.amse();
            } else {
                map.maps = maps;
            }
        }
        Ok(map)
    }

    fn inputs(&self, audio: &Array2<f32>) -> Array2<f32> {
        (local_linear::stack(audio.slice(s![.., ..N_STATIC]), &self.taps) - &self.mean) / &self.deviation
    }

    /// Mouth parameters of every frame.
    pub fn predict(&self, audio: &Array2<f32>) -> Array2<f32> {
        local_linear::apply(
            &self.maps,
            &self.inputs(audio),
            &Array2::zeros((audio.nrows(), 0)),
        )
    }
}
