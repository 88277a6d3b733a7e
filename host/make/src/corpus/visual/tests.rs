//! Everything after the tracker, and the sizes of mouths.
use super::*;
use crate::corpus::discover::ClipFiles;
use lipstream::npy::read_npy;

/// 20 pictures of 8 × 6: three patterns in changing amounts, on a ground that differs from clip to clip.
fn pictures(clip: usize) -> Array4<u8> {
    Array4::from_shape_fn((20, 6, 8, 3), |(t, y, x, c)| {
        let phase = (t * (clip + 2)) as f32 * 0.7;
        let open = phase.sin() * if (2..4).contains(&y) { 40.0 } else { 0.0 };
        let wide = (1.7 * phase).cos() * if !(2..6).contains(&x) { 25.0 } else { 0.0 };
        let teeth = (2.3 * phase).sin() * if c == 1 && y == 3 { 30.0 } else { 0.0 };
        (120.0 + 10.0 * clip as f32 + open + wide + teeth).round() as u8
    })
}

/// Everything after the tracker, on mouth images as an earlier run would have left them.
#[test]
fn weights_keep_the_distances_between_the_images_of_a_clip() {
    let folder = tempfile::tempdir().unwrap();
    let settings = PrepareSettings {
        out: folder.path().join("out"),
        eigenmouths: 5,
        ..PrepareSettings::default()
    };
    let mut clips: Vec<Prepared> = (0..3)
        .map(|i| {
            let video = folder.path().join(format!("c{i}.mpg"));
            std::fs::write(&video, b"already tracked").unwrap();
            let source = ClipFiles {
                id: format!("c{i}"),
                speaker: "s".into(),
                split: if i == 2 { Split::Test } else { Split::Train },
                video: Some(video),
                part: None,
                sound: None,
                labels: Vec::new(),
                stem: format!("c{i}"),
            };
            Prepared::bare(source, 0.8)
        })
        .collect();
    for (i, prepared) in clips.iter().enumerate() {
        let face = &faces(&clips).unwrap()[0];
        let wanted = Wanted {
            size: None,
            settings: &settings,
        };
        let (stamp, done) = tracked(prepared, face, wanted).unwrap();
        assert!(done.is_none());
        write_mouths(&mouths_path(&settings.out, &prepared.clip.id), &pictures(i)).unwrap();
        let notes = Notes::new(&settings.out, &prepared.clip.id);
        notes.note_with("mouths", &stamp, "25").unwrap();
    }
    let mut skipped = Vec::new();
    let size = see(&mut clips, &settings, &(), &mut skipped).unwrap();
    assert_eq!((size, clips.len(), skipped.len()), (5, 3, 0));
    for (i, prepared) in clips.iter().enumerate() {
        assert_eq!((prepared.clip.video_frames, prepared.clip.video_hz), (20, 25.0));
        let weights = read_npy(&settings.out.join(format!("visual/c{i}.npy"))).unwrap();
        assert_eq!(weights.dim(), (20, 5));
        let images = pictures(i).mapv(f32::from);
        for (a, b) in [(0, 1), (3, 11), (19, 4)] {
            let apart = |d: ndarray::Array1<f32>| d.dot(&d).sqrt();
            let of = |t: usize| images.index_axis(ndarray::Axis(0), t).flatten().to_owned();
            let (seen, expected) = (apart(&weights.row(a) - &weights.row(b)), apart(of(a) - of(b)));
            assert!(
                (seen - expected).abs() < 0.03 * expected + 3.0,
                "{i}: {seen} {expected}"
            );
        }
        assert!(
            weights
                .mean_axis(ndarray::Axis(0))
                .unwrap()
                .iter()
                .all(|m| m.abs() < 1e-2)
        );
    }
    // A video that changed is not vouched for any more; this one cannot be decoded, and is reported.
    std::fs::write(folder.path().join("c2.mpg"), b"changed, and no video").unwrap();
    assert_eq!(see(&mut clips, &settings, &(), &mut skipped).unwrap(), 5);
    assert_eq!((clips.len(), skipped.len()), (2, 1));
    assert!(skipped[0].path.ends_with("c2.mpg"), "{}", skipped[0].path);
}

#[test]
fn resampling_keeps_planes_and_their_slope() {
    // A plane 10·x + 5·y, twice as large: inner pixels keep it at half the slope.
    let images = Array4::from_shape_fn((2, 6, 8, 3), |(_, y, x, _)| (10 * x + 5 * y) as u8);
    let large = resampled(&images, (16, 12));
    assert_eq!(large.dim(), (2, 12, 16, 3));
    for y in 1..11 {
        for x in 1..15 {
            let expected = 10.0 * (x as f32 + 0.5) / 2.0 - 5.0 + 5.0 * (y as f32 + 0.5) / 2.0 - 2.5;
            let seen = f32::from(large[(1, y, x, 2)]);
            assert!((seen - expected).abs() <= 0.51, "{x} {y}: {seen} {expected}");
        }
    }
    assert_eq!(resampled(&images, (8, 6)), images);
}
