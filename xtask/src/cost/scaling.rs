//! What a stream of a likelihood-trained model costs as its sizes and settings change, one at a time. Smaller models are cut from
//! the one that is given: this measures work, not quality.
use std::path::{Path, PathBuf};

use anyhow::Result;
use lipstream::export::{ExportSettings, export};
use lipstream::hmm::mixtures::Mixtures;
use lipstream::kinds::likelihood::Model;
use ndarray::{Array1, Array2, Array3, ArrayViewMut1, Axis};

/// Prints a table.
pub(crate) fn run(root: &Path, model: &Path, sounds: &[PathBuf]) -> Result<()> {
    let model = Model::read(model)?;
    let own = ExportSettings {
        visual_densities: true,
        ..ExportSettings::of(&model)
    };
    println!("| | tables, KiB | mean | worst | active joint states, mean |\n|---|---|---|---|---|");
    let row = |name: String, model: &Model, with: &ExportSettings, feedback: Option<u32>| -> Result<()> {
        let tables = tempfile::NamedTempFile::new()?;
        let bytes = export(model, with)?.bytes;
        std::fs::write(tables.path(), &bytes)?;
        let numbers = super::measure_stream(root, tables.path(), sounds, feedback)?;
        println!(
            "| {name} | {:.1} | {} | {} | {} |",
            bytes.len() as f64 / 1024.0,
            numbers["instructions mean"],
            numbers["instructions worst"],
            numbers["active mean"]
        );
        Ok(())
    };
    let plain = ExportSettings {
        visual_densities: false,
        ..own
    };
    let (phones, components) = (model.phones.len(), model.audio.mean.dim().1);
    let whole = format!(
        "{phones} phones, {components} densities, {} parameters, beam of {} bits, lag of {}",
        model.visual_size(),
        plain.beam_bits,
        plain.lag
    );
    row(whole, &model, &plain, None)?;
    for n in [36, 24, 12].into_iter().filter(|n| *n < phones) {
        row(format!("{n} phones"), &of_phones(&model, n), &plain, None)?;
    }
    let powers = std::iter::successors(Some(components / 2), |k| Some(k / 2));
    for k in powers.take_while(|k| *k > 0) {
        row(format!("{k} densities"), &of_densities(&model, k), &plain, None)?;
    }
    for d in [20, 10, 5].into_iter().filter(|d| *d < model.visual_size()) {
        row(format!("{d} parameters"), &of_parameters(&model, d), &plain, None)?;
    }
    for beam_bits in [20.0, 16.0, 12.0] {
        let with = ExportSettings { beam_bits, ..plain };
        row(format!("beam of {beam_bits} bits"), &model, &with, None)?;
    }
    for lag in [0, 2, 8] {
        let with = ExportSettings { lag, ..plain };
        row(format!("lag of {lag}"), &model, &with, None)?;
    }
    for lag in [0, 4] {
        let with = ExportSettings { lag, ..own };
        for (name, exponent) in [("0", 0), ("0.1", 6554)] {
            let name = format!("EM in the window, lag of {lag}, exponent {name}");
            row(name, &model, &with, Some(exponent))?;
        }
    }
    Ok(())
}

/// The phones that follow others most often, silence always among them.
fn of_phones(model: &Model, n: usize) -> Model {
    let mut order: Vec<usize> = (0..model.phones.len()).collect();
    let often = |q: usize| model.bigram.column(q).iter().map(|log| log.exp()).sum::<f32>();
    order.sort_by(|a, b| often(*b).total_cmp(&often(*a)));
    let silence = model.phones.iter().position(|p| p.name() == "sil");
    let mut kept: Vec<usize> = silence.into_iter().collect();
    kept.extend(order.into_iter().filter(|p| Some(*p) != silence));
    kept.truncate(n);
    kept.sort_unstable();
    let states: Vec<usize> = kept.iter().flat_map(|p| 5 * p..5 * (p + 1)).collect();
    let mut bigram = model.bigram.select(Axis(0), &kept).select(Axis(1), &kept);
    bigram.rows_mut().into_iter().for_each(normalise);
    let mut initial = model.initial.select(Axis(0), &kept);
    normalise(initial.view_mut());
    Model {
        phones: kept.iter().map(|p| model.phones[*p]).collect(),
        audio: select(&model.audio, &states),
        transition: model.transition.select(Axis(0), &kept),
        bigram,
        initial,
        ..model.clone()
    }
}

/// The heaviest densities of every audio state.
fn of_densities(model: &Model, k: usize) -> Model {
    let of = &model.audio;
    let (states, _, size) = of.mean.dim();
    let mut out = Mixtures {
        mean: Array3::zeros((states, k, size)),
        variance: Array3::zeros((states, k, size)),
        log_weight: Array2::zeros((states, k)),
    };
    for s in 0..states {
        let mut order: Vec<usize> = (0..of.log_weight.ncols()).collect();
        order.sort_by(|a, b| of.log_weight[[s, *b]].total_cmp(&of.log_weight[[s, *a]]));
        order.truncate(k);
        let row = |from: &Array3<f32>| from.index_axis(Axis(0), s).select(Axis(0), &order);
        out.mean.index_axis_mut(Axis(0), s).assign(&row(&of.mean));
        out.variance.index_axis_mut(Axis(0), s).assign(&row(&of.variance));
        let mut weights: Array1<f32> = of.log_weight.row(s).select(Axis(0), &order);
        normalise(weights.view_mut());
        out.log_weight.row_mut(s).assign(&weights);
    }
    Model {
        audio: out,
        ..model.clone()
    }
}

/// The first parameters.
fn of_parameters(model: &Model, d: usize) -> Model {
    let first: Vec<usize> = (0..d).collect();
    let mut out = model.clone();
    out.visual.mean = out.visual.mean.select(Axis(2), &first);
    out.visual.variance = out.visual.variance.select(Axis(2), &first);
    out.maps.global = out.maps.global.select(Axis(0), &first);
    out.maps.state = out.maps.state.select(Axis(1), &first);
    out.mouth = None;
    out
}

fn select(of: &Mixtures, states: &[usize]) -> Mixtures {
    Mixtures {
        mean: of.mean.select(Axis(0), states),
        variance: of.variance.select(Axis(0), states),
        log_weight: of.log_weight.select(Axis(0), states),
    }
}

/// Natural logs that add up to a probability of one.
fn normalise(mut logs: ArrayViewMut1<f32>) {
    let sum: f32 = logs.iter().map(|log| log.exp()).sum();
    logs.mapv_inplace(|log| (log - sum.ln()).max(Mixtures::NO_WEIGHT));
}
