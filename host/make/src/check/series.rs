//! Series of numbers over time: between two of them, through gaps, without what is slow.

/// Between two numbers of a series; its ends go on for ever.
pub(crate) fn at(series: &[f32], place: f64) -> f32 {
    let place = place.clamp(0.0, (series.len() - 1) as f64);
    let (before, part) = (place as usize, place.fract() as f32);
    let after = (before + 1).min(series.len() - 1);
    series[before] * (1.0 - part) + series[after] * part
}

/// Gaps filled linearly.
pub(crate) fn filled(values: &[Option<f32>]) -> Vec<f32> {
    let known: Vec<(usize, f32)> = values
        .iter()
        .enumerate()
        .filter_map(|(k, v)| Some((k, (*v)?)))
        .collect();
    (0..values.len())
        .map(|k| {
            let next = known.partition_point(|(at, _)| *at < k);
            match (next.checked_sub(1).map(|n| known[n]), known.get(next)) {
                (_, Some((at, v))) if *at == k => *v,
                (Some((a, v)), Some((b, w))) => v + (w - v) * (k - a) as f32 / (b - a) as f32,
                (Some((_, v)), None) | (None, Some(&(_, v))) => v,
                (None, None) => 0.0,
            }
        })
        .collect()
}

/// A series less its mean under a Gaussian of so many of its steps.
pub(crate) fn without_slow(series: &[f32], deviation: f32) -> Vec<f32> {
    let slow = smoothed(series, deviation);
    series.iter().zip(slow).map(|(v, slow)| v - slow).collect()
}

/// The mean of a series under a Gaussian of so many of its steps.
pub(crate) fn smoothed(series: &[f32], deviation: f32) -> Vec<f32> {
    let reach = (4.0 * deviation) as usize;
    let weights: Vec<f32> = (0..=reach)
        .map(|k| (-0.5 * (k as f32 / deviation).powi(2)).exp())
        .collect();
    (0..series.len())
        .map(|k| {
            let near = k.saturating_sub(reach)..(k + reach + 1).min(series.len());
            let (sum, total) = near.fold((0.0, 0.0), |(sum, total), n| {
                let weight = weights[k.abs_diff(n)];
                (sum + weight * series[n], total + weight)
            });
            sum / total
        })
        .collect()
}
