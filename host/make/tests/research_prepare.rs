//! `prepare` on real clips: some TIMIT sentences and some GRID videos. Needs LIPSTREAM_RESEARCH and `ffmpeg`.
use std::path::Path;

use lipstream_make::corpus::{self, PrepareSettings};
use lipstream_make::features::{self, FeatureFolder, Split};
use lipstream_media::video;

mod common;

use common::data;

fn copy(from: &Path, to: &Path, names: impl Iterator<Item = String>) {
    std::fs::create_dir_all(to).unwrap();
    for name in names {
        std::fs::copy(from.join(&name), to.join(&name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    }
}

/// Length of the longest common subsequence.
fn common(a: &[&str], b: &[&str]) -> usize {
    let mut row = vec![0; b.len() + 1];
    for x in a {
        let mut diagonal = 0;
        for (j, y) in b.iter().enumerate() {
            let above = row[j + 1];
            row[j + 1] = if x == y { diagonal + 1 } else { above.max(row[j]) };
            diagonal = above;
        }
    }
    row[b.len()]
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn timit_sentences() {
    let folder = tempfile::tempdir().unwrap();
    let corpus_path = folder.path().join("timit");
    for speaker in ["dr1-fvmh0", "dr3-madc0"] {
        let from = data().join("timit-sample").join(speaker);
        let names = ["sa1", "sa2"]
            .into_iter()
            .flat_map(|s| ["wav", "phn", "wrd", "txt"].map(|e| format!("{s}.{e}")));
        copy(&from, &corpus_path.join(speaker), names);
    }
    let settings = PrepareSettings {
        corpus: corpus_path.clone(),
        out: folder.path().join("features"),
        clips: corpus::discover::Options {
            test_speakers: vec!["dr3-madc0".into()],
            ..Default::default()
        },
        ..Default::default()
    };
    let summary = corpus::prepare(&settings, &()).unwrap();
    assert_eq!((summary.train.clips, summary.test.clips), (2, 2));
    assert!(summary.words_by_rule.is_empty(), "{:?}", summary.words_by_rule);

    let features = FeatureFolder::open(&settings.out).unwrap();
    for clip in &features.manifest.clips {
        assert_eq!(features.audio(clip).unwrap().nrows(), clip.audio_frames);
        // Phones follow each other without a gap, from silence to silence.
        assert_eq!(clip.phones.first().unwrap().phone, "sil");
        assert_eq!(clip.phones.last().unwrap().phone, "sil");
        for pair in clip.phones.windows(2) {
            assert!(
                (pair[0].end - pair[1].start).abs() < 1e-6,
                "{}: {pair:?}",
                clip.id
            );
        }
        // The words are those of the transcript, which is a file of its own.
        let (speaker, sentence) = clip.id.split_once('_').unwrap();
        let text =
            std::fs::read_to_string(corpus_path.join(speaker).join(format!("{sentence}.txt"))).unwrap();
        let transcript = text.split_whitespace().skip(2).map(|w| {
            let letters = w.to_lowercase();
            letters.trim_matches(|c: char| !c.is_alphabetic()).to_owned()
        });
        let words: Vec<_> = clip.words.iter().map(|w| w.text.clone()).collect();
        assert_eq!(words, transcript.collect::<Vec<_>>(), "{}", clip.id);
        // What the annotators heard is mostly what the dictionary says.
        let heard: Vec<_> = clip.phones.iter().map(|p| p.phone.as_str()).collect();
        let said: Vec<_> = clip
            .words
            .iter()
            .flat_map(|w| w.pronunciations[0].iter().map(String::as_str))
            .collect();
        let share = common(&heard, &said) as f64 / said.len() as f64;
        println!(
            "{}: {:.0} % of the dictionary's phones were heard",
            clip.id,
            100.0 * share
        );
        assert!(share > 0.55, "{}: {share}", clip.id);
    }
}

#[test]
#[ignore = "needs the research data: tests/run --research"]
fn grid_videos() {
    let folder = tempfile::tempdir().unwrap();
    let grid = data().join("grid-s1");
    let corpus_path = folder.path().join("grid");
    for (split, count) in [("train", 5), ("test", 1)] {
        let mut stems: Vec<String> = std::fs::read_dir(grid.join(split))
            .unwrap()
            .filter_map(|e| e.unwrap().file_name().into_string().ok())
            .filter_map(|n| n.strip_suffix(".mpg").map(str::to_owned))
            .collect();
        stems.sort();
        let names = stems
            .into_iter()
            .take(count)
            .flat_map(|s| [format!("{s}.mpg"), format!("{s}.align")]);
        copy(&grid.join(split), &corpus_path.join(split), names);
    }
    std::fs::write(corpus_path.join("train/broken.mpg"), b"no video").unwrap();
    let settings = PrepareSettings {
        corpus: corpus_path,
        out: folder.path().join("features"),
        eigenmouths: 10,
        overlay: true,
        ..Default::default()
    };
    let summary = corpus::prepare(&settings, &()).unwrap();
    assert_eq!((summary.train.with_video, summary.test.with_video), (5, 1));
    assert_eq!(summary.visual_size, 10);
    assert_eq!(summary.skipped.len(), 1);
    assert!(summary.skipped[0].path.contains("broken.mpg"));

    let features = FeatureFolder::open(&settings.out).unwrap();
    let (mut in_silence, mut in_speech) = ((0.0f64, 0usize), (0.0f64, 0usize));
    for clip in &features.manifest.clips {
        assert_eq!(clip.words.len(), 6);
        assert!((clip.video_hz - 25.0).abs() < 0.01 && (70..=76).contains(&clip.video_frames));
        let weights = features.visual(clip).unwrap();
        for column in weights.columns() {
            assert!(column.mean().unwrap().abs() < 0.05 * (1.0 + column.std(0.0)));
        }
        let images = features::read_mouths(&features.mouths_path(&clip.id)).unwrap();
        assert_eq!(images.dim().0, clip.video_frames);
        // Its film is its video with something drawn on it: the rectangle's white and the lips' green are nowhere else.
        let film = video::decode(&settings.out.join(format!("overlay/{}.mp4", clip.id))).unwrap();
        assert_eq!(
            (film.width, film.height, film.len()),
            (360, 288, clip.video_frames)
        );
        let green = |p: &[u8]| p[1] > 150 && p[0] < 140 && p[2] < 140;
        assert!(
            film.frame(10).chunks(3).filter(|p| green(p)).count() > 10,
            "{}",
            clip.id
        );
        // The mouth moves while words are spoken and rests before and after them.
        let span = (clip.words[0].time.unwrap().0, clip.words[5].time.unwrap().1);
        for t in 1..clip.video_frames {
            let moved: f64 = (&weights.row(t) - &weights.row(t - 1))
                .iter()
                .map(|d| f64::from(d * d))
                .sum();
            let at = t as f32 / clip.video_hz;
            let place = if at > span.0 && at < span.1 {
                &mut in_speech
            } else {
                &mut in_silence
            };
            place.0 += moved;
            place.1 += 1;
        }
    }
    let mean = |(sum, count): (f64, usize)| sum / count as f64;
    let ratio = mean(in_speech) / mean(in_silence);
    println!("the mouth moves {ratio:.1} times as much (squared) in speech as in silence");
    assert!(ratio > 2.0, "{ratio}");
    let train = features.split(Split::Train).count();
    assert_eq!(train, 5);

    // A second run has nothing to do but to say the same.
    let manifest = std::fs::read(settings.out.join("manifest.json")).unwrap();
    let again = corpus::prepare(&settings, &()).unwrap();
    assert_eq!(
        std::fs::read(settings.out.join("manifest.json")).unwrap(),
        manifest
    );
    assert!(again.seconds_taken < summary.seconds_taken);
}

/// One take with a bad part behind it: the good pieces are kept, each with its mouth, the bad ones named.
#[test]
#[ignore = "needs the research data: tests/run --research"]
fn a_bad_minute_does_not_spoil_a_take() {
    let folder = tempfile::tempdir().unwrap();
    let grid = data().join("grid-s1/train");
    let mut names: Vec<_> = std::fs::read_dir(&grid)
        .unwrap()
        .filter_map(|e| Some(e.ok()?.path()))
        .collect();
    names.retain(|path| path.extension().is_some_and(|e| e == "mpg"));
    names.sort();
    let list = folder.path().join("list.txt");
    let lines: Vec<String> = names
        .iter()
        .step_by(40)
        .take(8)
        .map(|path| format!("file '{}'\n", path.display()))
        .collect();
    std::fs::write(&list, lines.concat()).unwrap();
    let take = folder.path().join("take.mp4");
    let made = std::process::Command::new("ffmpeg")
        .args(["-nostdin", "-v", "error", "-f", "concat", "-safe", "0", "-i"])
        .arg(&list)
        .args([
            "-f",
            "lavfi",
            "-t",
            "9",
            "-i",
            "testsrc=s=360x288:r=25",
            "-f",
            "lavfi",
            "-t",
            "9",
            "-i",
            "anoisesrc=a=0.3",
        ])
        .args([
            "-filter_complex",
            "[0:v]fps=25,scale=360:288,setsar=1[v];[1:v]setsar=1[w];[v][0:a][w][2:a]concat=n=2:v=1:a=1[p][s]",
        ])
        .args([
            "-map", "[p]", "-map", "[s]", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-c:a", "aac",
        ])
        .arg(&take)
        .output()
        .unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let settings = PrepareSettings {
        corpus: take,
        out: folder.path().join("features"),
        ..PrepareSettings::default()
    };
    let summary = corpus::prepare(&settings, &()).unwrap();
    let kept = summary.train.with_video + summary.val.with_video + summary.test.with_video;
    println!("{kept} pieces kept; left out: {:?}", summary.skipped);
    assert!(kept >= 3 && !summary.skipped.is_empty());
    let good = summary.train.seconds + summary.val.seconds + summary.test.seconds;
    assert!((16.0..28.0).contains(&good), "{good} s of 24 s are good");
    assert!(settings.out.join("sheet.png").is_file());
}
