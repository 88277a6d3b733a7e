//! The drawn face of [`drawn`], and what is said to models and trees that are none.
use ndarray::{Array1, Array2, array};

use super::drawn::{FACE, MOUTH, linear};
use super::*;

/// Two clusters whose mean appearances lie apart, and which speech tells apart.
fn map() -> SpeechMap {
    let cluster = |c: f32, s: f32| Cluster {
        joint: Linear {
            mean: array![c, 0.0, s],
            components: Array2::zeros((0, 3)),
            variances: Array1::zeros(0),
        },
        deviation: array![0.0, 0.0],
    };
    SpeechMap {
        weight: 1.0,
        precision: array![1.0],
        clusters: vec![cluster(-1.0, -5.0), cluster(1.0, 5.0)],
    }
}

fn model() -> HierarchicalModel {
    let speech = linear(Array1::zeros(12), |k| f32::from(u8::from(k == 0)), 1.0);
    drawn::model(Hearing::Window, speech, [map(), map()]).unwrap()
}

#[test]
fn appearance_parameters_come_back_from_shape_and_texture() {
    let model = model();
    let appearance = &model.nodes[0].appearance;
    let c = array![1.5, -2.0];
    let (x, g) = (appearance.shape_of(c.view()), appearance.texture_of(c.view()));
    // Eq. 1 by hand: W_s is 2, so that a c of 1.5 drops the third landmark by 0.75.
    assert!((x[5] - (34.0 + 0.75)).abs() < 1e-5);
    let back = appearance.project(x.view(), g.view());
    assert!((back - c).iter().all(|d| d.abs() < 1e-4));
}

#[test]
fn a_child_moves_its_landmarks_and_its_parent_only_the_rest() {
    let model = model();
    let root = model.compose(array![2.0, 0.0, 3.0, 0.0].view());
    let shape = mesh::points(root.shape.view());
    // The parent drops its corner by 2 / W_s; the mouth its lower lip by 3 / W_s.
    assert!((shape[2][1] - (FACE[2][1] + 1.0)).abs() < 1e-5);
    assert!((shape[7][1] - (FACE[7][1] + 1.5)).abs() < 1e-5);
    for k in [0, 1, 3, 4, 5, 6, 8] {
        assert_eq!(shape[k], FACE[k]);
    }
    let rows = array![[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 3.0, 0.0]];
    assert_eq!(model.shapes(&rows).row(1), root.shape);
}

/// What comes out is the parent's own projection of its texture with the mouth's levels laid over it.
#[test]
fn the_parent_approximates_the_child() {
    let model = model();
    let root = model.compose(array![0.0, 0.0, 0.0, 0.0].view());
    // The root knows one texture component, all pixels alike: each pixel gets the mean of the rough texture, in which the mouth alone is not 0.
    let patch = &model.nodes[0].appearance.patch;
    let inside = |x: usize, y: usize| {
        let shape = MOUTH.map(|k| FACE[k]);
        mesh::Patch::new(
            &shape,
            &model.nodes[1].appearance.triangles,
            (patch.width, patch.height),
        )
        .places()
        .any(|place| place == (x, y))
    };
    let covered = patch.places().filter(|(x, y)| inside(*x, *y)).count();
    assert!(covered > 20);
    let wanted = -0.5 * covered as f32 / patch.len() as f32;
    assert!(root.texture.iter().all(|level| (level - wanted).abs() < 1e-4));
}

#[test]
fn speech_chooses_and_what_is_said_is_smoothed() {
    let model = model();
    let mut cepstra = Array2::zeros((4, 12));
    for (n, heard) in [-4.0, -6.0, 5.0, 5.0].into_iter().enumerate() {
        cepstra[(n, 0)] = heard;
    }
    let said = model.convert_alone(&model.speech_parameters(&cepstra));
    assert_eq!(said.column(0).to_vec(), [-1.0, -0.5, 0.5, 1.0]);
    assert_eq!(said.column(2), said.column(0));
    assert_eq!(model.eigenmouths(&said).row(0).to_vec(), [-1.0, -1.0]);
    assert_eq!(model.convert(&[], Choice::Mahalanobis).unwrap().dim(), (0, 4));
    assert_eq!(
        model.convert(&[100; 641], Choice::Mahalanobis).unwrap().nrows(),
        2
    );
    let refused = model.convert(&[100; 641], Choice::Chmm).unwrap_err().to_string();
    assert!(refused.contains("--guide"), "{refused}");
    assert_eq!(model.groups(), [("face", 0..2), ("mouth", 2..4)]);
}

#[test]
fn the_nearest_training_picture_lends_its_colour() {
    let model = model();
    let appearance = &model.nodes[0].appearance;
    for (c, wanted) in [(array![0.2, -0.5], 0), (array![2.5, 2.0], 1)] {
        let root = Part {
            shape: appearance.shape_of(c.view()),
            texture: appearance.texture_of(c.view()),
        };
        assert_eq!(model.nearest(&root), wanted);
    }
}

#[test]
fn what_was_written_is_read_and_damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.safetensors");
    let model = model();
    model.write(&path).unwrap();
    let back = HierarchicalModel::read(&path).unwrap();
    assert_eq!(back.tree, model.tree);
    let c = array![1.0, -2.0, 0.5, 3.0];
    assert_eq!(back.compose(c.view()), model.compose(c.view()));
    assert_eq!(back.nodes[1].map, model.nodes[1].map);
    std::fs::write(&path, b"words").unwrap();
    assert!(HierarchicalModel::read(&path).is_err());
}

#[test]
fn a_tree_is_held_against_the_landmarks() {
    let read = |text: &str| serde_json::from_str::<Tree>(text).unwrap().over(9);
    assert!(
        read(r#"{"areas":[{"name":"face"},{"name":"mouth","parent":"face","landmarks":[4,5,6]}]}"#).is_ok()
    );
    for (text, words) in [
        (r#"{"areas":[]}"#, "no area"),
        (r#"{"areas":[{"name":"a b"}]}"#, "name of its own"),
        (
            r#"{"areas":[{"name":"face"},{"name":"face","parent":"face"}]}"#,
            "name of its own",
        ),
        (
            r#"{"areas":[{"name":"face"},{"name":"mouth"}]}"#,
            "stands before it",
        ),
        (
            r#"{"areas":[{"name":"face","parent":"head"}]}"#,
            "stands before it",
        ),
        (r#"{"areas":[{"name":"face","landmarks":[0,1,9]}]}"#, "landmark 9"),
        (r#"{"areas":[{"name":"face","landmarks":[0,1,1]}]}"#, "twice"),
        (
            r#"{"areas":[{"name":"face","landmarks":[0,1,2]},{"name":"mouth","parent":"face","landmarks":[1,2,3]}]}"#,
            "none of its parent",
        ),
    ] {
        let refused = read(text).unwrap_err().to_string();
        assert!(refused.contains(words), "{refused}");
    }
}

#[test]
fn pictures_become_frames_at_their_middles() {
    let rows = array![[0.0], [4.0], [8.0]];
    let frames = at_frames(&rows, 25.0, 14);
    // Picture 1 lies in the middle of 40 to 80 ms: frame 4.75. A frame is a quarter of a picture.
    assert!((frames[(4, 0)] - 3.25).abs() < 1e-4 && (frames[(5, 0)] - 4.25).abs() < 1e-4);
    assert_eq!((frames[(0, 0)], frames[(13, 0)]), (0.0, 8.0));
    assert_eq!(
        at_frames(&Array2::zeros((0, 2)), 25.0, 3),
        Array2::<f32>::zeros((3, 2))
    );
}

#[test]
fn a_face_is_drawn_in_the_colour_of_the_nearest_picture_and_moves() {
    use crate::render::Scene as _;
    use crate::render::hierarchical::HierarchicalScene;
    let mut model = model();
    let half = model.colours.chroma.ncols() / 2;
    // The second training picture is reddish all over.
    model.pieces.colours.chroma.slice_mut(s![1, ..half]).fill(40.0);
    let mut scene = HierarchicalScene::new(&model, Some(2)).unwrap();
    let (width, height) = scene.size();
    assert_eq!((width, height), (64, 80));
    let pixel =
        |rgb: &[u8], x: usize, y: usize| -> [u8; 3] { std::array::from_fn(|c| rgb[3 * (y * width + x) + c]) };
    let still = scene.draw(array![0.0, 0.0, 0.0, 0.0].view()).unwrap();
    assert_eq!(still.len(), width * height * 3);
    let [r, g, b] = pixel(&still, 30, 10);
    assert!(r == g && g == b && (90..=125).contains(&r), "{r} {g} {b}");
    assert_eq!(pixel(&still, 63, 79), [16; 3]);
    // A dropped corner covers what lay below the face, and a lit face is the second picture.
    let moved = scene.draw(array![8.0, 8.0, 0.0, 0.0].view()).unwrap();
    assert_eq!(pixel(&still, 58, 72), [16; 3]);
    assert!(pixel(&moved, 58, 72) != [16; 3]);
    let [r, g, b] = pixel(&moved, 30, 10);
    assert!(r > g && g > b, "{r} {g} {b}");
    assert!(HierarchicalScene::new(&model, Some(0)).is_err());
    assert!(HierarchicalScene::new(&model, Some(9999)).is_err());
}
