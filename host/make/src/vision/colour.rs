//! Colour of a clip brought to the speaker's: white balance and exposure differ from clip to clip.
//!
//! A gain and an offset per channel are fitted, pixel by pixel of the registered face (skin, eyes, nose: everything but the
//! mouth), so that the clip's mean colours become the speaker's. Pixels that differ for another reason (a shadow, a strand
//! of hair) lose their say in a few rounds of reweighting.

/// What brings one channel to the speaker's: gain·value + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChannelMap {
    /// Factor of the value.
    pub gain: f32,
    /// What is added after the gain, in grey levels.
    pub offset: f32,
}

impl ChannelMap {
    /// The map that leaves every value as it is.
    pub const IDENTITY: ChannelMap = ChannelMap {
        gain: 1.0,
        offset: 0.0,
    };

    /// A value of the clip in the speaker's colours; it is not cut to the range of a pixel.
    pub fn apply(&self, value: f32) -> f32 {
        self.gain * value + self.offset
    }
}

/// Gain is pulled towards 1 as if this many grey levels squared of variance had said so.
const PRIOR_VARIANCE: f64 = 4.0;
const GAIN_LIMITS: (f64, f64) = (0.4, 2.5);

/// The map of `values` to `wanted` by robust least squares (Cauchy weights at the median error); identity where nothing can be said.
pub(crate) fn fit(values: &[f32], wanted: &[f32]) -> ChannelMap {
    let mut map = ChannelMap::IDENTITY;
    if values.len() < 8 || values.len() != wanted.len() {
        return map;
    }
    let mut weights = vec![1.0f64; values.len()];
    for _ in 0..6 {
        let total: f64 = weights.iter().sum();
        let mean = |of: &[f32]| {
            of.iter()
                .zip(&weights)
                .map(|(v, w)| f64::from(*v) * w)
                .sum::<f64>()
                / total
        };
        let (mean_value, mean_wanted) = (mean(values), mean(wanted));
        let (mut square, mut cross) = (0.0, 0.0);
        for ((&v, &u), w) in values.iter().zip(wanted).zip(&weights) {
            let (v, u) = (f64::from(v) - mean_value, f64::from(u) - mean_wanted);
            square += w * v * v;
            cross += w * v * u;
        }
        let (square, cross) = (square / total, cross / total);
        let gain = ((cross + PRIOR_VARIANCE) / (square + PRIOR_VARIANCE)).clamp(GAIN_LIMITS.0, GAIN_LIMITS.1);
        map = ChannelMap {
            gain: gain as f32,
            offset: (mean_wanted - gain * mean_value) as f32,
        };
        let errors = || values.iter().zip(wanted).map(|(&v, &u)| (map.apply(v) - u).abs());
        let scale = f64::from(super::face::median(errors())).max(0.5) * 2.0;
        for (weight, error) in weights.iter_mut().zip(errors()) {
            *weight = 1.0 / (1.0 + (f64::from(error) / scale).powi(2));
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_and_an_offset_are_undone_despite_a_shadow() {
        let wanted: Vec<f32> = (0..400).map(|i| 60.0 + (i * 37 % 101) as f32).collect();
        let mut values: Vec<f32> = wanted.iter().map(|v| (v - 12.0) / 1.25).collect();
        let map = fit(&values, &wanted);
        assert!(
            (map.gain - 1.25).abs() < 0.01 && (map.offset - 12.0).abs() < 0.6,
            "{map:?}"
        );
        // A fifth of the pixels in the shade.
        values[..80].iter_mut().for_each(|v| *v -= 40.0);
        let map = fit(&values, &wanted);
        let worst = values[80..]
            .iter()
            .zip(&wanted[80..])
            .map(|(v, u)| (map.apply(*v) - u).abs())
            .fold(0.0, f32::max);
        assert!(worst < 2.0, "{worst} {map:?}");
    }

    #[test]
    fn a_flat_patch_moves_the_offset_only() {
        let map = fit(&[100.0; 50], &[110.0; 50]);
        assert!((map.gain - 1.0).abs() < 1e-3 && (map.apply(100.0) - 110.0).abs() < 1e-3);
        assert_eq!(fit(&[], &[]), ChannelMap::IDENTITY);
    }
}
