//! Light, framing and sharpness of a take, from looks at its pictures.
use serde::Serialize;

use super::looks::Look;
use super::watch::Watched;

/// The light on the face. Levels are luminance, 0 to 255.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LightReport {
    /// Mean over the face and the take.
    pub mean: f32,
    /// Share of the face that is white (250 and more).
    pub white: f32,
    /// Share of the face that is black (5 and less).
    pub black: f32,
    /// Median ratio of the brighter to the darker half of the face.
    pub side_ratio: f32,
    /// Which half is the brighter one, as the picture shows it: `left` or `right`.
    pub brighter: &'static str,
    /// Deviation of a picture's mean from the mean of its two neighbours', as a share of the level.
    pub flicker: f32,
}

/// Where the face is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FramingReport {
    /// Median width between the cheeks, in the video's own pixels.
    pub face_width: f32,
    /// Median width between the lips' corners, in the video's own pixels.
    pub mouth_width: f32,
    /// Where the tip of the nose is between the cheeks, 0 in the middle, ±1 at a cheek: the median over the take.
    pub turn: f32,
    /// The 95th percentile of its absolute value.
    pub turn_95: f32,
    /// Share of the pictures looked at in which a face is seen.
    pub seen: f32,
    /// Of these the share in which all of it is inside the picture.
    pub inside: f32,
    /// Share of the pictures searched in which there is one face only.
    pub alone: f32,
}

/// How sharp the mouth is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SharpnessReport {
    /// Variance of the Laplacian over the variance of the mouth's luminance, at a face of 160 pixels: the median.
    pub mouth: f32,
    /// Pictures a second.
    pub rate_hz: f32,
}

/// The three of a take; None where no face is seen.
pub(crate) fn measure(
    watched: &[Watched],
    reduction: f32,
    rate_hz: f32,
) -> Option<(LightReport, FramingReport, SharpnessReport)> {
    let all: usize = watched.iter().map(|stretch| stretch.looks.len()).sum();
    let looks: Vec<&Look> = watched
        .iter()
        .flat_map(|stretch| stretch.looks.iter().flatten())
        .collect();
    if looks.is_empty() {
        return None;
    }
    let mean =
        |of: &dyn Fn(&Look) -> f32| looks.iter().map(|look| of(look)).sum::<f32>() / looks.len() as f32;
    let middle = |of: &dyn Fn(&Look) -> f32| quantile(looks.iter().map(|look| of(look)).collect(), 0.5);
    let right = |look: &Look| (look.light.halves[1].max(1.0) / look.light.halves[0].max(1.0)).ln();
    let side = middle(&right);
    let light = LightReport {
        mean: mean(&|look| look.light.mean),
        white: mean(&|look| look.light.white),
        black: mean(&|look| look.light.black),
        side_ratio: side.abs().exp(),
        brighter: if side > 0.0 { "right" } else { "left" },
        flicker: flicker(watched),
    };
    let faces: Vec<usize> = watched
        .iter()
        .flat_map(|stretch| stretch.faces.iter().copied())
        .collect();
    let alone = faces.iter().filter(|count| **count == 1).count();
    let found = faces.iter().filter(|count| **count > 0).count();
    let framing = FramingReport {
        face_width: reduction * middle(&|look| look.face_width),
        mouth_width: reduction * middle(&|look| look.mouth_width),
        turn: middle(&|look| look.turn),
        turn_95: quantile(looks.iter().map(|look| look.turn.abs()).collect(), 0.95),
        seen: looks.len() as f32 / all as f32,
        inside: mean(&|look| f32::from(u8::from(look.inside))),
        alone: alone as f32 / found.max(1) as f32,
    };
    let sharpness = SharpnessReport {
        mouth: middle(&|look| look.sharpness),
        rate_hz,
    };
    Some((light, framing, sharpness))
}

/// Independent deviations d of pictures make d[t] − (d[t−1] + d[t+1]) / 2 of a variance 1.5 times theirs.
fn flicker(watched: &[Watched]) -> f32 {
    let (mut sum, mut count) = (0.0f32, 0.0f32);
    for three in watched.iter().flat_map(|stretch| stretch.looks.windows(3)) {
        if let [Some(before), Some(look), Some(after)] = three {
            let near = 0.5 * (before.light.mean + after.light.mean);
            sum += ((look.light.mean - near) / near.max(1.0)).powi(2) / 1.5;
            count += 1.0;
        }
    }
    (sum / count.max(1.0)).sqrt()
}

/// The value that this share of the values lies below.
pub(crate) fn quantile(mut values: Vec<f32>, share: f32) -> f32 {
    if values.is_empty() {
        return 0.0;
    }
    let place = ((values.len() - 1) as f32 * share).round() as usize;
    *values.select_nth_unstable_by(place, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::looks::Light;

    fn watched(looks: impl IntoIterator<Item = Option<Look>>) -> Watched {
        Watched {
            begins_s: 0.0,
            rate_hz: 25.0,
            looks: looks.into_iter().collect(),
            faces: vec![1, 2, 0],
        }
    }

    fn lit(left: f32, right: f32) -> Look {
        Look {
            face_width: 100.0,
            light: Light {
                mean: 0.5 * (left + right),
                halves: [left, right],
                ..Light::default()
            },
            inside: true,
            ..Look::default()
        }
    }

    #[test]
    fn sides_flicker_and_shares_are_found() {
        let steady = watched((0..40).map(|_| Some(lit(120.0, 60.0))));
        let (light, framing, _) = measure(&[steady], 2.0, 25.0).unwrap();
        assert!((light.side_ratio - 2.0).abs() < 1e-4 && light.brighter == "left");
        assert!(light.flicker < 1e-6 && light.mean == 90.0);
        assert_eq!(
            (framing.face_width, framing.seen, framing.alone),
            (200.0, 1.0, 0.5)
        );
        // Every other picture is 4 % darker.
        let blinking = watched((0..40).map(|k| (k < 30).then(|| lit(100.0, [96.0, 104.0][k % 2]))));
        let (light, framing, _) = measure(&[blinking], 1.0, 25.0).unwrap();
        assert!(
            (light.flicker - 0.04 / 1.5f32.sqrt()).abs() < 0.001,
            "{}",
            light.flicker
        );
        assert_eq!((framing.seen, framing.inside), (0.75, 1.0));
        assert!(measure(&[watched([None, None])], 1.0, 25.0).is_none());
    }
}
