//! Where training stands, so that a killed run goes on to the same bytes.
use std::path::Path;

use ndarray::{Array1, ArrayView1};

use super::optimise::{Learnt, Optimiser};
use crate::error::{Context as _, Error, Result, bail};
use lipstream::kinds::recurrent::parameters::Parameters;
use lipstream::tensors::{Tensors, TensorsBuilder};

/// The best parameters so far.
#[derive(Clone, Debug, PartialEq)]
pub struct Best<P = Parameters> {
    /// Mean squared distance a frame on the validation clips; infinite before the first pass, 0 without such clips.
    pub error: f64,
    /// The running mean of the parameters after that pass.
    pub parameters: P,
    /// Pass after which they were the best.
    pub pass: usize,
}

/// Writes aside, then renames.
pub fn write<P: Learnt>(
    path: &Path,
    optimiser: &Optimiser<P>,
    best: &Best<P>,
    context_mean: &[f32],
    run: u64,
) -> Result<()> {
    let mut out = TensorsBuilder::default();
    out.note("kind", "mge checkpoint");
    out.note("run", format!("{run:016x}"));
    out.note("step", optimiser.step);
    out.note("best.error", format!("{:016x}", best.error.to_bits()));
    out.note("best.pass", best.pass);
    let arrays = [
        ("parameters", optimiser.parameters.values()),
        ("first", &optimiser.first),
        ("second", &optimiser.second),
        ("mean", optimiser.mean.values()),
        ("best", best.parameters.values()),
    ];
    for (name, values) in arrays {
        out.put(name, &ArrayView1::from(values));
    }
    out.put("context_mean", &ArrayView1::from(context_mean));
    out.write(path).map_err(Error::other)
}

/// What a checkpoint holds: the optimiser, the best so far, the contexts' mean.
pub type Kept<P> = (Optimiser<P>, Best<P>, Vec<f32>);

/// Reads what [`write()`] wrote of parameters like `empty`; `None` where there is nothing. A checkpoint of another run is refused.
pub fn read<P: Learnt>(path: &Path, empty: &P, run: u64) -> Result<Option<Kept<P>>> {
    if !path.exists() {
        return Ok(None);
    }
    let from = Tensors::read(path).map_err(Error::other)?;
    let other = || {
        format!(
            "{} is the checkpoint of a training run with other settings or data: remove it to start anew",
            path.display()
        )
    };
    let written: String = from.noted("run").with_context(other)?;
    if written != format!("{run:016x}") {
        bail!(File, "{}", other());
    }
    let values = |name: &str| -> Result<Vec<f32>> {
        let array: Array1<f32> = from.array(name).map_err(Error::other)?;
        Ok(array.to_vec())
    };
    let parameters = |name: &str| -> Result<P> {
        let mut p = empty.clone();
        let read = values(name)?;
        if read.len() != p.values().len() {
            bail!(File, "{}", other());
        }
        *p.values_mut() = read;
        Ok(p)
    };
    let optimiser = Optimiser {
        parameters: parameters("parameters")?,
        first: parameters("first")?.values().to_vec(),
        second: parameters("second")?.values().to_vec(),
        mean: parameters("mean")?,
        step: from.noted("step").map_err(Error::other)?,
    };
    let bits: String = from.noted("best.error").map_err(Error::other)?;
    let best = Best {
        error: f64::from_bits(u64::from_str_radix(&bits, 16).with_context(other)?),
        parameters: parameters("best")?,
        pass: from.noted("best.pass").map_err(Error::other)?,
    };
    Ok(Some((optimiser, best, values("context_mean")?)))
}
