//! Files of landmarks: what is read of other programs', what is written and read again, and what is said of those that are none.
use std::path::{Path, PathBuf};

use ndarray::{Array3, array};

use super::Labels;
use super::import::{How, read};
use crate::error::chain;
use crate::hierarchical::Landmarks;

const HOW: How = How {
    first_picture: 1,
    size: None,
    clip: None,
};
const PTS: &str = "version: 1\nn_points:  3\n{\n11 21\n31.5 21\n21 41\n}\n";

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path
}

/// The one line in which a file is refused.
fn refused(name: &str, text: &str, how: &How) -> String {
    let folder = folder();
    let said = chain(&read(&[file(folder.path(), name, text)], how).unwrap_err());
    assert!(!said.contains('\n') && said.contains(name), "{said}");
    said
}

#[test]
fn points_of_single_pictures_are_read_by_the_name_of_the_file() {
    let folder = folder();
    let paths = [
        file(folder.path(), "walk_0003.pts", PTS),
        file(folder.path(), "run/000001.pts", &PTS.replace("11 21", "1 1")),
    ];
    let found = read(&paths, &HOW).unwrap();
    assert_eq!(found.labelled(), [("run", 0), ("walk", 2)]);
    // The first pixel's centre is at 1 in the file.
    assert_eq!(
        found.picture("walk", 2).unwrap(),
        array![10.0, 20.0, 30.5, 20.0, 20.0, 40.0]
    );
    assert_eq!(found.picture("run", 0).unwrap()[0], 0.0);
    // A folder of them, and the clip that was meant.
    let how = How {
        clip: Some("film".into()),
        ..HOW
    };
    let found = read(&[folder.path().join("run")], &how).unwrap();
    assert_eq!(found.labelled(), [("film", 0)]);
}

#[test]
fn damaged_point_files_are_refused_in_a_line() {
    for (text, words) in [
        (
            PTS.replace("n_points:  3", "n_points: 4"),
            "n_points is 4, but it holds 3",
        ),
        (PTS.replace('}', ""), "cut short"),
        (PTS.replace("31.5 21", "31.5"), "line 5"),
        (PTS.replace("31.5", "x"), "\"x\" is no number"),
        (PTS.replace("31.5", "nan"), "\"nan\" is no number"),
        (PTS.replace("version: 1", "version: 2"), "version 2"),
        (String::new(), "is missing"),
        ("hello".into(), "line 1"),
    ] {
        let said = refused("a_1.pts", &text, &HOW);
        assert!(said.contains(words), "{said}");
    }
    assert!(refused("a.pts", PTS, &HOW).contains("number of a picture"));
    assert!(refused("a_0.pts", PTS, &HOW).contains("--first-picture"));
}

#[test]
fn tables_of_openface_and_mediapipe_are_read() {
    let folder = folder();
    let openface = "frame, face_id, confidence, success, x_0, x_1, x_2, y_0, y_1, y_2\n\
        1, 0, 0.98, 1, 10, 30, 20, 20, 21, 40\n2, 0, 0.1, 0, 0, 0, 0, 0, 0, 0\n";
    let path = file(folder.path(), "a.csv", openface);
    let found = read(&[path], &HOW).unwrap();
    assert_eq!(found.labelled(), [("a", 0)]);
    assert_eq!(found.of("a").unwrap().dim(), (2, 3, 2));
    assert_eq!(
        found.picture("a", 0).unwrap(),
        array![10.0, 20.0, 30.0, 21.0, 20.0, 40.0]
    );
    let twice = openface.replace("\n2, 0, 0.1, 0", "\n1, 1, 0.9, 1");
    assert!(refused("a.csv", &twice, &HOW).contains("two faces"));
    assert!(refused("a.csv", &openface.replace(" success", " s"), &HOW).contains("--size"));
    assert!(refused("a.csv", &openface.replace("1, 0, 0.98, 1", "1, 0, 0.98, 7"), &HOW).contains("success"));
    assert!(refused("a.csv", &openface.replace(" y_2", " w_2"), &HOW).contains("of which 2 have their y"));
    let nobody = openface.replace("0.98, 1,", "0.98, 0,");
    assert!(refused("a.csv", &nobody, &HOW).contains("no picture of it has a face"));

    let mediapipe =
        "frame,x_0,y_0,z_0,x_1,y_1,z_1,x_2,y_2,z_2\n0,0.25,0.5,0,0.5,0.5,0,0.4,0.75,0\n1,,,,,,,,,\n";
    let path = file(folder.path(), "b.csv", mediapipe);
    let how = How {
        first_picture: 0,
        size: Some((200, 100)),
        clip: None,
    };
    let found = read(&[path], &how).unwrap();
    assert_eq!((found.labelled(), found.count()), (vec![("b", 0)], 3));
    assert_eq!(found.picture("b", 0).unwrap()[0], 49.5);
    assert_eq!(found.picture("b", 0).unwrap()[5], 74.5);
    assert!(refused("b.csv", mediapipe, &HOW).contains("--size"));
    let pixels = mediapipe.replace("0.25", "50");
    assert!(refused("b.csv", &pixels, &how).contains("no share"));
    assert!(refused("b.csv", "time,value\n1,2\n", &how).contains("is no table of landmarks"));
    assert!(refused("b.txt", mediapipe, &how).contains("no landmarks that are known"));
}

#[test]
fn what_is_written_is_read_again() {
    let folder = folder();
    let groups = vec![("jaw".to_owned(), 0..2), ("lips_inner".to_owned(), 2..5)];
    let mut landmarks = Landmarks::none(5, groups.clone());
    let points =
        |pictures: usize| Array3::from_shape_fn((pictures, 5, 2), |(t, k, a)| 0.125 * (t + 3 * k + a) as f32);
    // Clips of different lengths, places beyond a thousand pixels, pictures without a face at the end.
    let mut long = points(4) + 1900.0;
    long.slice_mut(ndarray::s![3, .., ..]).fill(f32::NAN);
    landmarks.put("long", long.clone()).unwrap();
    landmarks.put("short", points(2)).unwrap();
    let labels = Labels::known(landmarks);
    for name in ["l.csv", "l.npz"] {
        let path = folder.path().join(name);
        labels.write(&path).unwrap();
        for found in [
            Landmarks::read(&path).unwrap(),
            read(std::slice::from_ref(&path), &HOW).unwrap(),
        ] {
            assert_eq!(found.groups(), &groups, "{name}");
            assert_eq!(found.of("short").unwrap(), &points(2));
            assert_eq!(found.labelled().len(), 5);
            assert_eq!(found.picture("long", 2).unwrap()[9], long[(2, 4, 1)]);
        }
        // A clip's last pictures count though they have no face.
        assert_eq!(
            Landmarks::read(&path).unwrap().of("long").unwrap().dim().0,
            4,
            "{name}"
        );
    }
    assert!(labels.write(&folder.path().join("l.txt")).is_err());
    // Together with other points of the same pictures nothing says which are right.
    let path = folder.path().join("l.csv");
    let twice = read(&[path.clone(), folder.path().join("l.npz")], &HOW).unwrap_err();
    assert!(chain(&twice).contains("labelled already"), "{twice}");
    let other = file(folder.path(), "short_9.pts", PTS);
    assert!(
        chain(&read(&[path, other], &HOW).unwrap_err())
            .contains("3 landmarks in a picture, those before have 5")
    );
}

#[test]
fn damaged_tables_are_refused_in_a_line() {
    let table = "clip,picture,confidence,x_0,y_0,x_1,y_1,x_2,y_2\na,0,1,1,2,3,4,5,6\na,2,0,,,,,,\n";
    for (from, to, words) in [
        ("a,2,0,,,,,,", "a,2,0,,,", "line 3: 6 cells"),
        ("a,2,0,,,,,,", "a,0,0,,,,,,", "twice"),
        ("a,2,0,,,,,,", "a,-1,0,,,,,,", "no number of a picture"),
        ("a,2,0,,,,,,", "a,99999999,0,,,,,,", "no number of a picture"),
        ("a,0,1,1,2", "a,0,1,,2", "\"\" is no number"),
        ("a,0,1,1,2", "a,0,1,inf,2", "\"inf\" is no number"),
        ("a,0,1,1,2", ",0,1,1,2", "no name"),
        ("x_1,y_1", "x_1,y_2", "x_1 and y_2"),
        ("x_1,y_1", "x_7,y_7", "point 1"),
        ("x_1,y_1", "u_1,v_1", "not the x and y"),
        (",x_2,y_2", ",x_2", "columns of places"),
    ] {
        let said = refused("t.csv", &table.replacen(from, to, 1), &HOW);
        assert!(said.contains(words), "{to}: {said}");
    }
    let head = table.lines().next().unwrap();
    assert!(refused("t.csv", head, &HOW).contains("no line below"));
}
