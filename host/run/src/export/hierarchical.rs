//! Tables of a hierarchical model: all of them in i16, as they are small (19 KiB for a face and a mouth of 15 clusters each).
//!
//! Speech parameters are brought to standard deviations by the projection, so that eq. 8 is a plain square; components of a cluster to theirs, so that three deviations are 3.
use lipstream_core::N_STATIC;
use lipstream_core::context::tables::MAX_TAPS;
use lipstream_core::frame::{MAX_GROUPS, MAX_PARAMETERS};
use lipstream_core::kinds::hierarchical::tables::*;
use lipstream_core::kinds::{Hierarchical, Kind};
use lipstream_core::model::common::{GROUP_NAME_SIZE, GROUPS, PARAMETER_SCALE, put_group};
use lipstream_core::model::put_f32s;

use super::tables::{Errors, SumRows, Tables};
use super::{Export, ExportError, Result};
use crate::error::ensure;
use crate::kinds::hierarchical::clusters::LIMIT;
use crate::kinds::hierarchical::{Hearing, HierarchicalModel, Node};

/// Statics in LSBs of one: Q7.8.
const STATIC: f64 = 256.0;
/// Speech parameters and d in LSBs of one: Q5.10.
const SIGNAL: f64 = (1 << SIGNAL_FRACTION_BITS) as f64;
/// H in LSBs of a parameter's LSB.
const APPEARANCE: f64 = (1 << APPEARANCE_FRACTION_BITS) as f64;
/// LSBs of a parameter's standard deviation in the training pictures.
const PARAMETER: f64 = 1024.0;

/// Quantises `model`. Its guide stays behind: the device chooses clusters by each picture's own sound.
///
/// # Errors
///
/// [`ExportError`]: it hears other windows than the device's, or its size, a name or a number in it is none that the device takes.
pub fn export(model: &HierarchicalModel) -> Result<Export> {
    let Hearing::Frames { start_mean, taps } = &model.hearing else {
        return Err(ExportError::Hearing);
    };
    let most = |of: &dyn Fn(&Node) -> usize| model.nodes.iter().map(of).max().unwrap_or(0);
    let mut tables = Tables::new(&[
        ("context taps", taps.len(), MAX_TAPS),
        ("speech parameters", model.speech.modes(), MAX_SPEECH),
        ("areas", model.nodes.len(), MAX_GROUPS),
        ("parameters", model.n_parameters(), MAX_PARAMETERS),
        (
            "clusters in an area",
            most(&|node| node.map.clusters.len()),
            MAX_CLUSTERS,
        ),
        // A cluster without components is one that says its mean.
        (
            "components in a cluster",
            most(&|node| node.map.modes()).max(1),
            MAX_MODES,
        ),
    ])?;
    tables.put_start_mean(start_mean);
    let taps: Vec<i32> = taps.iter().map(|tap| i32::from(*tap)).collect();
    tables.put_taps(&taps)?;
    let precision = &model.nodes[0].map.precision;
    ensure!(
        model.nodes.iter().all(|node| node.map.precision == *precision),
        ExportError::Number,
        "the areas of the model measure distances of speech differently"
    );
    let inverse: Vec<f64> = precision.iter().map(|p| f64::from(*p).sqrt()).collect();
    let mut rows = SumRows::new("relative to a row's largest");
    for (component, inverse) in model.speech.components.outer_iter().zip(&inverse) {
        let weights: Vec<f64> = component.iter().map(|w| f64::from(*w) * inverse).collect();
        debug_assert_eq!(weights.len() % N_STATIC, 0);
        let products = weights.iter().zip(&model.speech.mean);
        let offset: f64 = products.map(|(w, m)| w * f64::from(*m)).sum();
        rows.push(&weights, SIGNAL / STATIC, offset * SIGNAL)?;
    }
    rows.store_projection(&mut tables);
    let (mut groups, mut scales, mut areas) = (Vec::new(), Vec::new(), Vec::new());
    let mut written = Written::default();
    for ((name, range), node) in model.groups().into_iter().zip(&model.nodes) {
        ensure!(
            name.len() <= GROUP_NAME_SIZE && name.bytes().all(|b| b.is_ascii_lowercase()),
            ExportError::Size,
            "the device takes names of areas of 1 to {GROUP_NAME_SIZE} lower-case letters, not {name:?}"
        );
        put_group(&mut groups, name, range.len() as u16);
        put_area(
            &mut areas,
            node.map.clusters.len() as u16,
            node.map.modes() as u16,
        );
        let steps: Vec<f64> = (node.appearance.joint.variances.iter())
            .map(|v| f64::from(*v).sqrt() / PARAMETER)
            .collect();
        ensure!(
            steps.iter().all(|step| *step > f64::from(f32::MIN_POSITIVE)),
            ExportError::Number,
            "a parameter of {name} never varies"
        );
        put_f32s(&mut scales, steps.iter().map(|step| *step as f32));
        written.area(node, &inverse, &steps)?;
    }
    tables.put(GROUPS, groups, None);
    tables.put(PARAMETER_SCALE, scales, None);
    tables.put(AREAS, areas, None);
    written.store(&mut tables);
    tables.finish(<Hierarchical as Kind>::TAG)
}

/// The sections of all areas.
struct Written {
    speech_means: (Vec<u8>, Errors),
    speech: SumRows,
    appearance_means: (Vec<u8>, Errors),
    limits: (Vec<u8>, Errors),
    rows: (Vec<u8>, Errors),
}

impl Default for Written {
    fn default() -> Self {
        let of = |unit| (Vec::new(), Errors::new(unit));
        Self {
            speech_means: of("deviation of speech"),
            speech: SumRows::within("relative to a row's largest", MAX_SPEECH_SHIFT),
            appearance_means: of("deviation of a parameter"),
            limits: of("deviation of a parameter"),
            rows: of("deviation of a parameter"),
        }
    }
}

/// `value` in whole numbers of `1/lsb` within ±`limit`.
fn whole(errors: &mut Errors, value: f64, lsb: f64, limit: f64) -> f64 {
    let q = errors.round(value * lsb, limit);
    errors.add(q / lsb - value);
    q
}

impl Written {
    /// `inverse`: one over the deviations of speech; `steps`: what an LSB of each parameter is.
    fn area(&mut self, node: &Node, inverse: &[f64], steps: &[f64]) -> Result<()> {
        let (map, n) = (&node.map, steps.len());
        let weight = f64::from(map.weight);
        for cluster in &map.clusters {
            let joint = &cluster.joint;
            let (means, errors) = &mut self.speech_means;
            let speech = joint.mean.iter().skip(n).zip(inverse);
            put_speech_mean(
                means,
                speech.map(|(m, inverse)| whole(errors, f64::from(*m) * inverse, SIGNAL, 32767.0) as i16),
            );
            // In deviations of a parameter: a step is 1/1024 of one.
            let to_deviations = |value: f64, step: f64| value / (step * PARAMETER);
            let appearance = joint.mean.iter().zip(steps);
            let mean: Vec<i16> = appearance
                .map(|(m, step)| {
                    let value = to_deviations(f64::from(*m) / weight, *step);
                    whole(&mut self.appearance_means.1, value, PARAMETER, 32767.0) as i16
                })
                .collect();
            let limits = cluster.deviation.iter().zip(steps).map(|(deviation, step)| {
                let value = to_deviations(f64::from(LIMIT * deviation), *step);
                whole(&mut self.limits.1, value, PARAMETER, 65535.0) as u16
            });
            put_appearance([&mut self.appearance_means.0, &mut self.limits.0], mean, limits);
            for mode in 0..map.modes() {
                let deviation = joint.variances.get(mode).map_or(0.0, |v| f64::from(*v).sqrt());
                let known = deviation > 0.0;
                let component = |k: usize| match known {
                    true => f64::from(joint.components[(mode, k)]),
                    false => 0.0,
                };
                let row: Vec<f64> = inverse
                    .iter()
                    .enumerate()
                    .map(|(j, inverse)| match known && *inverse > 0.0 {
                        true => component(n + j) / (inverse * deviation),
                        false => 0.0,
                    })
                    .collect();
                self.speech.push(&row, 1.0, 0.0)?;
                let (rows, errors) = &mut self.rows;
                let column = steps.iter().enumerate().map(|(i, step)| {
                    let value = to_deviations(component(i) * deviation / weight, *step);
                    whole(errors, value, PARAMETER * APPEARANCE, 32767.0) as i16
                });
                put_appearance_row(rows, column);
            }
        }
        Ok(())
    }

    fn store(self, tables: &mut Tables) {
        tables.put(SPEECH_MEANS, self.speech_means.0, self.speech_means.1.report());
        self.speech
            .store_without_offsets(tables, [SPEECH_WEIGHTS, SPEECH_SHIFTS]);
        for (section, (bytes, errors)) in [
            (APPEARANCE_MEANS, self.appearance_means),
            (APPEARANCE_LIMITS, self.limits),
            (APPEARANCE_WEIGHTS, self.rows),
        ] {
            tables.put(section, bytes, errors.report());
        }
    }
}
