//! A face of nine landmarks with a mouth of four in its middle, drawn, for tests and measurements: a chin that drops, a mouth that opens and darkens.
use ndarray::{Array1, Array2, Axis, array};
use rand::{Rng, RngExt};

use super::{
    Appearance, Cluster, Colours, Hearing, HierarchicalModel, Linear, Node, Pieces, SpeechMap, Tree,
    appearance, half_patch, mesh, speech,
};
use crate::error::Result;
use crate::mouth::MouthSpace;
use crate::random::normal;

/// The face's corners, the middles of its sides are left out; landmarks 4 to 7 are the mouth, 8 is above it.
pub const FACE: [[f32; 2]; 9] = [
    [1.0, 1.0],
    [30.0, 1.0],
    [30.0, 34.0],
    [1.0, 34.0],
    [10.0, 20.0],
    [15.0, 17.0],
    [20.0, 20.0],
    [15.0, 24.0],
    [15.0, 8.0],
];
/// The mouth's landmarks.
pub const MOUTH: [usize; 4] = [4, 5, 6, 7];

fn flat(points: &[[f32; 2]]) -> Array1<f32> {
    points.iter().flatten().copied().collect()
}

/// One component of a size; `at` are its entries that are not 0, before they are made of unit length.
pub fn linear(mean: Array1<f32>, at: impl Fn(usize) -> f32, variance: f32) -> Linear {
    let raw: Array1<f32> = (0..mean.len()).map(at).collect();
    let norm = raw.dot(&raw).sqrt();
    Linear {
        components: (raw / norm).insert_axis(Axis(0)),
        variances: array![variance],
        mean,
    }
}

fn of_landmarks(
    landmarks: &[[f32; 2]],
    triangles: mesh::Triangles,
    moves: usize,
    level: (f32, f32),
    parameters: usize,
) -> Result<Appearance> {
    let mean = flat(landmarks);
    let patch = appearance::patch(mean.view(), &triangles)?;
    let joint = Linear {
        mean: Array1::zeros(2),
        components: Array2::from_shape_fn((parameters, 2), |(k, i)| f32::from(u8::from(k == i))),
        variances: Array1::from_shape_fn(parameters, |k| [4.0, 9.0][k % 2]),
    };
    Ok(Appearance {
        shape: linear(mean, |k| f32::from(u8::from(k == 2 * moves + 1)), 4.0),
        texture: linear(Array1::zeros(patch.len()), |_| 1.0, 9.0),
        weight: 2.0,
        joint,
        triangles,
        level,
        patch,
    })
}

/// A face and its mouth that hear in this way and are moved by these maps. The first two numbers of each are its shape and its texture; more change nothing that is seen.
///
/// # Errors
///
/// That the maps, the speech and the hearing do not fit each other.
pub fn model(hearing: Hearing, speech: Linear, maps: [SpeechMap; 2]) -> Result<HierarchicalModel> {
    let tree = Tree::face_and_mouth(MOUTH).over(FACE.len())?;
    let around = vec![
        [0, 1, 8],
        [0, 8, 4],
        [0, 4, 3],
        [3, 4, 7],
        [3, 7, 2],
        [7, 6, 2],
        [6, 1, 2],
        [8, 1, 6],
        [8, 5, 4],
        [8, 6, 5],
        [4, 5, 7],
        [5, 6, 7],
    ];
    let own = MOUTH.map(|k| [FACE[k][0] - 9.0, FACE[k][1] - 16.0]);
    let sizes = maps.each_ref().map(SpeechMap::appearance_size);
    let [face, mouth] = maps;
    let nodes = vec![
        Node {
            appearance: of_landmarks(&FACE, around, 2, (120.0, 30.0), sizes[0])?,
            map: face,
        },
        Node {
            appearance: of_landmarks(&own, vec![[0, 1, 3], [1, 2, 3]], 3, (-0.5, 0.8), sizes[1])?,
            map: mouth,
        },
    ];
    let half = half_patch(&nodes[0].appearance)?.len();
    HierarchicalModel::new(Pieces {
        tree,
        nodes,
        hearing,
        guide: None,
        speech,
        colours: Colours {
            appearances: Array2::from_shape_fn(
                (2, sizes[0]),
                |(n, k)| if k < 2 { 3.0 * n as f32 } else { 0.0 },
            ),
            chroma: Array2::zeros((2, 2 * half)),
        },
        reading: Array2::ones((1 + sizes[0] + sizes[1], 2)),
        mouth: MouthSpace {
            width: 1,
            height: 1,
            mean: Array1::zeros(3),
            basis: Array2::zeros((2, 3)),
            deviation: Array1::ones(2),
        },
        provenance: "drawn".to_owned(),
    })
}

/// Sizes of a random model, of its face and its mouth.
#[derive(Clone, Debug)]
pub struct Sizes {
    /// Clusters of each.
    pub clusters: [usize; 2],
    /// Components of a cluster.
    pub modes: [usize; 2],
    /// Numbers of an appearance.
    pub parameters: [usize; 2],
    /// Speech parameters.
    pub speech: usize,
}

impl Sizes {
    /// For tests.
    pub fn small() -> Self {
        Self {
            clusters: [12, 5],
            modes: [3, 1],
            parameters: [2, 2],
            speech: 6,
        }
    }

    /// What is trained on GRID for the device.
    pub fn full() -> Self {
        Self {
            clusters: [15, 15],
            modes: [3, 8],
            parameters: [40, 24],
            speech: 12,
        }
    }
}

/// A face of random clusters that hears the device's front end; the first cluster of each area has no component.
///
/// # Errors
///
/// Sizes of nothing.
pub fn random(sizes: &Sizes, rng: &mut impl Rng) -> Result<HierarchicalModel> {
    let hearing = Hearing::frames(Array1::zeros(lipstream_core::N_STATIC), speech::OWN_TAPS.to_vec())?;
    let (heard, size) = (sizes.speech, hearing.size());
    let mut components = Array2::from_shape_fn((heard, size), |_| normal(rng));
    for k in 0..heard {
        for before in 0..k {
            let along = components.row(before).dot(&components.row(k));
            let other = components.row(before).to_owned();
            components.row_mut(k).scaled_add(-along, &other);
        }
        let norm = components.row(k).dot(&components.row(k)).sqrt();
        components.row_mut(k).mapv_inplace(|v| v / norm);
    }
    let variances = Array1::from_shape_fn(heard, |k| 400.0 / (k + 1) as f32);
    let speech = Linear {
        mean: Array1::from_shape_fn(size, |_| 2.0 * normal(rng)),
        components,
        variances: variances.clone(),
    };
    let mut map = |area: usize| {
        let n = sizes.parameters[area];
        let clusters = (0..sizes.clusters[area]).map(|k| {
            let kept = if k == 0 { 0 } else { sizes.modes[area] };
            let spread = |i: usize| if i < n { 12.0 } else { variances[i - n].sqrt() };
            let components = Array2::from_shape_fn((kept, n + heard), |_| normal(rng) / 3.0);
            Cluster {
                joint: Linear {
                    mean: (0..n + heard).map(|i| spread(i) * normal(rng)).collect(),
                    components,
                    variances: Array1::from_shape_fn(kept, |m| rng.random_range(20.0..60.0) / (m + 1) as f32),
                },
                deviation: (0..n).map(|_| rng.random_range(0.3f32..1.5)).collect(),
            }
        });
        SpeechMap {
            weight: 6.0,
            precision: variances.mapv(|v| 1.0 / v),
            clusters: clusters.collect(),
        }
    };
    let maps = [map(0), map(1)];
    model(hearing, speech, maps)
}
