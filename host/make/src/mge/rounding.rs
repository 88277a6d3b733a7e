//! Tables of few bits, in floats: what quantisation of the weights costs before any integer arithmetic.
//!
//! Every row of a matrix has its own scale, max|row| / (2^(bits−1) − 1); rates are stored as λ itself, unsigned. Biases,
//! means and the transitions stay as they are: they are small and of 16 bits on the device.
use lipstream::kinds::recurrent::gated::PARTS;
use lipstream::kinds::recurrent::model::RecurrentModel;
use lipstream::kinds::recurrent::parameters::{Group, sigmoid};
use lipstream::kinds::recurrent::step::rate_group;

/// Matrices that are stored by rows.
pub const ROUNDED: [Group; 12] = [
    Group::Projection,
    Group::Audio,
    Group::Visual,
    Group::Drive,
    Group::Global,
    Group::AudioGain,
    Group::VisualGain,
    Group::AudioDrive,
    Group::VisualDrive,
    Group::AudioOffset,
    Group::VisualOffset,
    Group::Output,
];

/// The model with tables of `bits` bits, 2 to 16.
pub fn rounded(model: &RecurrentModel, bits: u32) -> RecurrentModel {
    let mut out = model.clone();
    let shape = out.parameters.shape.clone();
    let most = ((1u32 << (bits.clamp(2, 16) - 1)) - 1) as f32;
    for group in ROUNDED {
        let (rows, _) = group.size(&shape);
        for r in 0..rows {
            let row = out.parameters.row_mut(group, r);
            round_row(row, most);
        }
    }
    if let Some(gated) = &mut out.gated {
        for part in PARTS.into_iter().filter(|part| part.is_matrix()) {
            let (_, columns) = part.size(&gated.shape);
            for row in gated.of_mut(part).chunks_exact_mut(columns) {
                round_row(row, most);
            }
        }
    }
    let steps = 2.0 * most + 1.0;
    for logit in out.parameters.of_mut(rate_group(&shape)) {
        // Half a step from 0 and 1, where the logit would be infinite.
        let rate = (sigmoid(*logit) * steps).round().clamp(0.25, steps - 0.25) / steps;
        *logit = (rate / (1.0 - rate)).ln();
    }
    out
}

/// A row in whole steps of its largest number over `most`.
fn round_row(row: &mut [f32], most: f32) {
    let largest = row.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    if largest > 0.0 {
        let step = largest / most;
        row.iter_mut().for_each(|v| *v = (*v / step).round() * step);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lipstream::kinds::recurrent::context::Context;
    use lipstream::kinds::recurrent::parameters::{Feedback, Gate, Parameters, Shape};
    use lipstream::random::fill_normal;
    use lipstream::synthetic::{self, Sizes};
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    #[test]
    fn no_number_moves_by_more_than_half_a_step() {
        let mut rng = Pcg64::seed_from_u64(1);
        let parent = synthetic::model(&Sizes::small(), 2.0, &mut rng);
        let mut parameters = Parameters::zeros(&Shape {
            phones: parent.phones.len(),
            context: Context::default(),
            inputs: 4,
            memory: 6,
            outputs: 5,
            feedback: Feedback::Output,
            maps: Gate::Both,
            rates: Gate::Visual,
        });
        fill_normal(&mut parameters.values, 0.0, 1.0, &mut rng);
        let shape = parameters.shape.clone();
        let model = RecurrentModel {
            context_mean: vec![0.0; shape.context.size()],
            scale: vec![1.0; 13],
            deviation: vec![1.0; 5],
            least: 0.0,
            validation_amse: None,
            provenance: String::new(),
            gated: None,
            parent,
            parameters,
        };
        for bits in [4, 8] {
            let small = rounded(&model, bits);
            let most = ((1 << (bits - 1)) - 1) as f32;
            for group in ROUNDED {
                for r in 0..group.size(&shape).0 {
                    let (before, after) = (model.parameters.row(group, r), small.parameters.row(group, r));
                    let largest = before.iter().fold(0.0f32, |m, v| m.max(v.abs()));
                    for (a, b) in before.iter().zip(after) {
                        assert!((a - b).abs() <= 0.5001 * largest / most, "{}", group.name());
                    }
                }
            }
            for (a, b) in std::iter::zip(
                model.parameters.of(Group::VisualRate),
                small.parameters.of(Group::VisualRate),
            ) {
                assert!((sigmoid(*a) - sigmoid(*b)).abs() <= 0.51 / (2.0 * most + 1.0));
            }
            assert_eq!(
                model.parameters.of(Group::AudioBias),
                small.parameters.of(Group::AudioBias)
            );
        }
    }
}
