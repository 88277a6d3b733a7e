//! The report end to end on a drawn talker: every measurement, all three files, features out, predictions in.
mod common;

use common::talker::talker;
use lipstream::hmm::system::System;
use lipstream::npy::{read_npy, write_npy};
use lipstream::phones::VISEMES;
use lipstream::render::drawn;
use lipstream::synthetic;
use lipstream_make::evaluate::{
    self, Candidate, Destination, EvaluateSettings, Heading, Heard, Iteration, NoiseSettings, Prediction,
    Report, exchange, models, systems, truths,
};
use lipstream_make::features::{FeatureFolder, Split};
use ndarray::Array2;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// A share of the truth, with visemes that change every tenth frame and iterations that come nearer to the truth.
fn share_of_truth<'a>(folder: &'a FeatureFolder, name: &str, share: f32) -> Candidate<'a> {
    let truth = |heard: &Heard| -> Array2<f32> {
        let truths = truths(folder, Split::Test).unwrap();
        let found = truths.iter().find(|t| t.clip.id == heard.id).unwrap();
        found.visual.clone()
    };
    let mut candidate = Candidate::new(name, None, move |heard: &Heard| {
        let parameters = truth(heard) * share;
        let visemes = Array2::from_shape_fn((parameters.nrows(), VISEMES.len()), |(t, v)| {
            if v == 1 + t / 10 % 2 { 1.0 } else { 0.0 }
        });
        Ok(Prediction {
            parameters,
            visemes: Some(visemes),
        })
    })
    .with_iterations(move |heard: &Heard| {
        let nearer = |n: usize| n as f32 / 4.0;
        let iterations = (1..4).map(|n| Iteration {
            parameters: truth(heard) * nearer(n),
            log_likelihood: -1000.0 / n as f64,
        });
        Ok(iterations.collect())
    });
    candidate.hears = false;
    candidate
}

fn settings() -> EvaluateSettings {
    EvaluateSettings {
        resamples: 200,
        reference: Some("halved".into()),
        noise: Some(NoiseSettings {
            snrs_db: vec![20.0, 0.0],
            ..NoiseSettings::default()
        }),
        cold_starts: true,
        ..EvaluateSettings::default()
    }
}

fn measured(folder: &FeatureFolder) -> Report {
    let mut candidates = vec![models::mean(folder.manifest.visual_size)];
    candidates.extend(models::ridge(folder, true).unwrap());
    candidates.push(share_of_truth(folder, "tenth", 0.1));
    candidates.push(share_of_truth(folder, "halved", 0.5));
    evaluate::measure(folder, Split::Test, &candidates, &settings(), &()).unwrap()
}

fn heading() -> Heading {
    Heading {
        title: "A <drawn> talker".into(),
        command: "lipstream evaluate drawn".into(),
        provenance: String::new(),
    }
}

#[test]
fn every_number_is_sound() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(root.path());
    let report = measured(&folder);
    let system = |name: &str| report.systems.iter().find(|s| s.name == name).unwrap();
    let (mean, ridge, halved) = (system("mean"), system("ridge, −300…80 ms"), system("halved"));
    assert_eq!(
        (report.clips, report.parameters),
        (5, folder.manifest.visual_size)
    );

    // Half the truth: a quarter of its energy is left, and all of its correlation.
    assert!((halved.amse.value - 0.25 * mean.amse.value).abs() < 0.02 * mean.amse.value);
    assert!((halved.acc.value - 1.0).abs() < 1e-3 && mean.acc.value == 0.0);
    // The tone tells the mouth.
    assert!(ridge.amse.value < 0.5 * mean.amse.value, "{ridge:?}");
    for s in &report.systems {
        for i in [&s.amse, &s.acc, &s.mean_distance, &s.acc_of_first_5] {
            assert!(i.low <= i.value + 1e-9 && i.value <= i.high + 1e-9, "{s:?}");
        }
    }
    let against = mean.against_reference.unwrap();
    assert!(against.amse.difference > 0.0 && against.amse.low > 0.0);
    // Five clips: no exchange but all or none reaches the difference, 2 of 32.
    assert!((against.amse.p - 2.0 / 32.0).abs() < 0.06, "{against:?}");
    assert!(halved.against_reference.is_none());

    // A change every ten frames is ten a second.
    assert!((halved.viseme_changes_per_second.unwrap() - 10.0).abs() < 1.0);
    assert!(mean.viseme_changes_per_second.is_none());

    // Ridge's curve: five points, in order.
    let curve = report.look_ahead.iter().find(|c| c.family == "ridge").unwrap();
    let ahead: Vec<u32> = curve.points.iter().map(|p| p.look_ahead_ms.unwrap()).collect();
    assert_eq!(ahead, [20, 40, 80, 120, 200]);

    // Noise hurts, more of it hurts more; what comes from the truth cannot hear.
    assert_eq!(report.noise.len(), 4);
    for pair in report.noise.chunks(2) {
        let amse = |n: usize| {
            pair[n]
                .systems
                .iter()
                .find(|s| s.name == ridge.name)
                .unwrap()
                .amse
                .value
        };
        assert!(amse(1) > amse(0) && amse(1) > 1.05 * ridge.amse.value, "{pair:?}");
        assert!(pair[0].systems.iter().all(|s| s.name != "halved"));
    }

    // The mean is the same cold and warm.
    let cold = report.cold_starts.as_ref().unwrap();
    assert_eq!(cold.clips, 5);
    let row = &cold.systems[0];
    assert_eq!(
        (row.amse.value, row.amse_difference.difference),
        (row.warm_amse.value, 0.0)
    );
    let row = cold.systems.iter().find(|r| r.name == ridge.name).unwrap();
    assert!(row.warm_acc.value > 0.5 && row.acc.value > 0.3, "{row:?}");

    // The true weights tell when the drawn mouth closes, the mean does not.
    let closure = report.closure.as_ref().unwrap();
    assert!(closure.bilabials > 20 && closure.bilabials_closed >= closure.bilabials * 9 / 10);
    let truth = &closure.systems[0];
    assert!(
        truth.correlation > 0.95 && truth.precision.value > 0.8,
        "{truth:?}"
    );
    let near = truth.recall_at_bilabials;
    assert!(
        near.value > 0.6 && near.low < near.value && near.value < near.high,
        "{truth:?}"
    );
    assert_eq!(closure.systems[1].recall.value, 0.0);

    // Two visemes a syllable of 0.3 s; the true mouth opens and closes as often, the mean never does.
    let rates = report.rates;
    assert!((4.0..9.0).contains(&rates.label_visemes), "{rates:?}");
    let turns = rates.true_gap_turns.unwrap();
    assert!((turns / rates.label_visemes - 1.0).abs() < 0.3, "{rates:?}");
    assert_eq!(mean.gap_turns_per_second, Some(0.0));

    // With the clips' means the mean mouth has more to miss, and what follows the truth still correlates.
    let [with_means, _] = mean.with_clip_means.unwrap();
    assert!(with_means.value > 1.0001 * mean.amse.value, "{with_means:?}");
    let [amse, acc] = halved.with_clip_means.unwrap();
    assert!(amse.value > halved.amse.value && acc.value > 0.5 && acc.value < halved.acc.value);

    // Clips are drawn for the reference only.
    assert!(report.convergence[0].name == "tenth" && report.convergence[0].clips.is_empty());
    let convergence = &report.convergence[1];
    assert_eq!(
        (convergence.acc.len(), convergence.falls, convergence.clips.len()),
        (3, 0, 5)
    );
    assert!(convergence.amse[2] < convergence.amse[0]);
    assert_eq!(report.trajectories.len(), 5);
    assert!(report.notes.iter().any(|n| n.starts_with("halved")));

    // Twice the same.
    assert_eq!(
        evaluate::json(&measured(&folder)).unwrap(),
        evaluate::json(&report).unwrap()
    );
}

/// Numbers of a JSON value, trajectories (which are drawn) and settings left out.
fn numbers(value: &serde_json::Value, out: &mut Vec<f64>) {
    match value {
        serde_json::Value::Number(n) => out.push(n.as_f64().unwrap()),
        serde_json::Value::Array(items) => items.iter().for_each(|v| numbers(v, out)),
        serde_json::Value::Object(map) => map
            .iter()
            .filter(|(key, _)| *key != "trajectories")
            .for_each(|(_, v)| numbers(v, out)),
        _ => {}
    }
}

/// A system trained otherwise stands in the report under a name of its own; one of another mouth is refused.
#[test]
fn a_model_is_measured_under_another_name() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(root.path());
    let sizes = synthetic::Sizes {
        parameters: folder.manifest.visual_size,
        ..synthetic::Sizes::small()
    };
    let mut model = synthetic::model(&sizes, 2.0, &mut Pcg64::seed_from_u64(3));
    model.system = System::PH_VI_CHMM;
    let candidates = systems::also("fewer clips", &model, &folder).unwrap();
    let report = evaluate::measure(
        &folder,
        Split::Test,
        &candidates,
        &EvaluateSettings::default(),
        &(),
    )
    .unwrap();
    let names: Vec<&str> = report.systems.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["fewer clips", "fewer clips, posterior mean"]);
    assert_ne!(report.systems[0].amse.value, report.systems[1].amse.value);
    let other = synthetic::model(&synthetic::Sizes::small(), 2.0, &mut Pcg64::seed_from_u64(3));
    let error = systems::also("another mouth", &other, &folder)
        .err()
        .unwrap()
        .to_string();
    assert!(error.contains("another mouth"), "{error}");
}

#[test]
fn the_page_holds_every_number_and_needs_nothing() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(root.path());
    let report = measured(&folder);
    let out = root.path().join("report");
    let written = Destination::of(&out).unwrap().write(&heading(), &report).unwrap();
    assert_eq!(written.len(), 3);
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let (page, markdown, json) = (read("index.html"), read("report.md"), read("report.json"));

    for outside in [
        "http:",
        "https:",
        "src=",
        "url(",
        "@import",
        "<link rel=\"style",
        "xmlns",
    ] {
        assert!(!page.contains(outside), "{outside}");
    }
    assert!(page.contains("<link rel=\"icon\" href=\"data:,\">") && page.matches("href=").count() == 1);
    assert!(page.contains("A &lt;drawn&gt; talker"));
    assert!(
        page.matches("<figure>").count() >= 7,
        "every figure has its numbers here"
    );

    // The JSON itself, and each of its numbers as a reader sees them in the tables.
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    let (text, embedded) = page
        .split_once("<script id=\"report\" type=\"application/json\">")
        .unwrap();
    let embedded = embedded.split_once("</script>").unwrap().0;
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(embedded).unwrap(),
        value
    );
    let mut all = Vec::new();
    numbers(&value, &mut all);
    assert!(all.len() > 200, "{}", all.len());
    for number in all {
        let shown = [0, 1, 2, 3, 4].iter().any(|&digits| {
            let plain = format!("{number:.digits$}");
            let signed = format!("{number:+.digits$}");
            [&text, &markdown.as_str()]
                .iter()
                .all(|t| t.contains(&plain) || t.contains(&signed))
        });
        assert!(shown, "{number}");
    }
}

#[test]
fn one_file_of_each_form() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(root.path());
    let settings = EvaluateSettings {
        resamples: 100,
        ..EvaluateSettings::default()
    };
    // Without mouth images everything but closure and the clips' means is measured, and the report says so.
    std::fs::remove_dir_all(root.path().join("mouths")).unwrap();
    let candidates = [models::mean(folder.manifest.visual_size)];
    let report = evaluate::measure(&folder, Split::Val, &candidates, &settings, &()).unwrap();
    assert!(report.closure.is_none() && report.noise.is_empty() && report.cold_starts.is_none());
    assert!(
        report
            .notes
            .iter()
            .any(|n| n.starts_with("Closure was not measured")),
        "{:?}",
        report.notes
    );
    for (name, start) in [
        ("r.md", "# A <drawn> talker"),
        ("r.html", "<!doctype html>"),
        ("r.json", "{"),
    ] {
        let path = root.path().join(name);
        let destination = Destination::of(&path).unwrap();
        assert!(!destination.is_folder());
        destination.write(&heading(), &report).unwrap();
        assert!(
            std::fs::read_to_string(&path).unwrap().starts_with(start),
            "{name}"
        );
    }
    assert!(Destination::of(&root.path().join("r.pdf")).is_err());
}

#[test]
fn features_go_out_and_predictions_come_in() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(&root.path().join("features"));
    let out = root.path().join("out");
    assert_eq!(exchange::export(&folder, &out).unwrap(), 18);
    let index: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("index.json")).unwrap()).unwrap();
    assert_eq!(index["clips"].as_array().unwrap().len(), 18);
    // Somebody's model: a third of the truth, in the same frames.
    let said = root.path().join("said");
    for clip in index["clips"].as_array().unwrap() {
        let frames = clip["frames"].as_u64().unwrap() as usize;
        assert_eq!(
            read_npy(&out.join(clip["audio"].as_str().unwrap()))
                .unwrap()
                .dim(),
            (frames, 39)
        );
        let mouth = read_npy(&out.join(clip["visual"].as_str().unwrap())).unwrap();
        assert_eq!(mouth.dim(), (frames, 6));
        if clip["split"] == "test" {
            write_npy(
                &said.join(format!("{}.npy", clip["id"].as_str().unwrap())),
                &(mouth / 3.0),
            )
            .unwrap();
        }
    }
    let candidates = [models::mean(6), exchange::predictions("theirs", &said).unwrap()];
    let settings = EvaluateSettings {
        resamples: 100,
        ..EvaluateSettings::default()
    };
    let report = evaluate::measure(&folder, Split::Test, &candidates, &settings, &()).unwrap();
    let (mean, theirs) = (&report.systems[0].amse.value, &report.systems[1]);
    assert!((theirs.acc.value - 1.0).abs() < 1e-3);
    assert!(theirs.amse.value < 0.5 * mean);

    // What does not fit is refused in one line.
    let refused = |candidates: &[Candidate], settings: &EvaluateSettings| {
        let error = evaluate::measure(&folder, Split::Test, candidates, settings, &()).unwrap_err();
        let text = lipstream_make::error::chain(&error);
        assert!(!text.contains('\n') && text.len() > 20, "{text}");
        text
    };
    std::fs::remove_file(said.join("clip13.npy")).unwrap();
    assert!(refused(&candidates, &settings).contains("clip13"));
    write_npy(&said.join("clip13.npy"), &Array2::zeros((10, 6))).unwrap();
    assert!(refused(&candidates, &settings).contains("clip13"));
    assert!(exchange::predictions("theirs", &root.path().join("nowhere")).is_err());
    let twice = [models::mean(6), models::mean(6)];
    assert!(refused(&twice, &settings).contains("two systems"));
    let unknown = EvaluateSettings {
        reference: Some("nobody".into()),
        ..settings
    };
    assert!(refused(&[models::mean(6)], &unknown).contains("nobody"));
}

/// Through the command line: features out, predictions in, a folder of reports; what is wrong is said in one line.
#[test]
fn by_command() {
    let root = tempfile::tempdir().unwrap();
    talker(&root.path().join("features"));
    let path = |name: &str| root.path().join(name).to_string_lossy().into_owned();
    let run = |args: &[&str]| lipstream_cli::run(["lipstream"].iter().chain(args).map(Into::into));
    let (features, out, said) = (path("features"), path("out"), path("said"));
    run(&["features", &features, "-o", &out]).unwrap();
    for n in 13..18 {
        let mouth = read_npy(&root.path().join(format!("out/test/clip{n}.visual.npy"))).unwrap();
        write_npy(&root.path().join(format!("said/clip{n}.npy")), &mouth).unwrap();
    }
    let (report, given) = (path("report"), format!("mine@40={said}"));
    run(&[
        "evaluate",
        &features,
        "--predictions",
        &given,
        "--against",
        "mine",
        "--noise-system",
        "mean",
        "--resamples",
        "100",
        "-o",
        &report,
    ])
    .unwrap();
    let json = std::fs::read_to_string(root.path().join("report/report.json")).unwrap();
    let value: serde_json::Value = serde_json::from_str(&json).unwrap();
    let mine = value["systems"]
        .as_array()
        .unwrap()
        .iter()
        .find(|s| s["name"] == "mine")
        .unwrap();
    assert_eq!(
        (&mine["look_ahead_ms"], &mine["amse"]["value"]),
        (&40.into(), &0.0.into())
    );
    assert_eq!(value["noise"].as_array().unwrap().len(), 10);
    assert_eq!(value["noise"][0]["systems"].as_array().unwrap().len(), 1);
    assert!(
        !std::fs::read_to_string(root.path().join("report/report.md"))
            .unwrap()
            .contains(&said)
    );

    // The shipped model, whatever it makes of tones: every clip is counted, or those of one split.
    let counted = |split: &[&str]| -> serde_json::Value {
        let voices = path("voices.json");
        let asked = ["evaluate", &features, "--voices", "-o", &voices];
        run(&[&asked, split].concat()).unwrap();
        serde_json::from_str(&std::fs::read_to_string(voices).unwrap()).unwrap()
    };
    let all = counted(&[]);
    assert_eq!(all["voices"][0]["speaker"], "drawn");
    assert_eq!(all["voices"][0]["counts"]["clips"], 18);
    let some = counted(&["--split", "test"]);
    assert_eq!(some["voices"][0]["counts"]["clips"], 5);
    let bilabials = |of: &serde_json::Value| of["voices"][0]["counts"]["bilabials"].as_u64().unwrap();
    assert!(bilabials(&some) >= 5 && bilabials(&all) > 3 * bilabials(&some));

    let (pdf, nowhere) = (path("r.pdf"), format!("x={}", path("nowhere")));
    let tables = path("mouth.tables");
    std::fs::write(&tables, lipstream::shipped::TABLES).unwrap();
    let strange: [&[&str]; 6] = [
        // No videos; a form of report that there is not; tables, which have no mouth.
        &["evaluate", &said, "--strangers"],
        &["evaluate", &said, "--strangers", "-o", &pdf],
        &["evaluate", &said, "--strangers", "-m", &tables],
        &["evaluate", &said, "--voices"],
        &["evaluate", &features, "--voices", "-o", &pdf],
        &["evaluate", &features, "--voices", "-m", &tables],
    ];
    let wrong: [&[&str]; 8] = [
        &["evaluate", &features, "-o", &pdf],
        &["evaluate", &features, "--predictions", "mine"],
        &["evaluate", &features, "--predictions", &nowhere],
        &["evaluate", &features, "--predictions", "mine@soon=x"],
        &["evaluate", &features, "--against", "nobody"],
        &["evaluate", &features, "--noise-system", "nobody"],
        &["evaluate", &said],
        &[
            "features", &features, "-o", &out, "--norm", "causal", "--start", &features,
        ],
    ];
    for args in wrong.into_iter().chain(strange) {
        let text = format!("{:#}", run(args).unwrap_err());
        assert!(!text.contains('\n') && text.len() > 20, "{args:?}: {text}");
    }
}

/// A model that draws another mouth is refused with the score: as many numbers say nothing of what they mean.
#[test]
fn a_model_of_other_eigenmouths_is_refused() {
    let root = tempfile::tempdir().unwrap();
    let folder = talker(root.path());
    let sizes = synthetic::Sizes {
        parameters: folder.manifest.visual_size,
        ..synthetic::Sizes::small()
    };
    let mut model = synthetic::model(&sizes, 2.0, &mut Pcg64::seed_from_u64(3));
    let space = drawn::space(folder.manifest.visual_size);
    let mut other = space.clone();
    for (k, row) in space.basis.outer_iter().rev().enumerate() {
        other.basis.row_mut(k).assign(&row);
    }
    for (name, mouth, is_own) in [("own", &space, true), ("other", &other, false)] {
        model.mouth = Some(mouth.clone());
        let path = root.path().join(format!("{name}.safetensors"));
        model.write(&path).unwrap();
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
            .arg("evaluate")
            .arg(root.path())
            .arg("-m")
            .arg(&path)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.success(), is_own, "{said}");
        let refused = said.contains("other.safetensors: the model's eigenmouths are not those of");
        assert_eq!(refused, !is_own, "{said}");
        assert_eq!(said.contains("0.00 of 1)"), !is_own, "{said}");
    }
    // Nor does it take fine detail from that folder's mouths.
    let parameters = folder.visual_path("clip00");
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_lipstream"))
        .args(["render", "--scale", "1", "-m"])
        .arg(root.path().join("other.safetensors"))
        .arg("--detail-from")
        .arg(root.path())
        .arg("-o")
        .arg(root.path().join("film.mp4"))
        .arg(parameters)
        .output()
        .unwrap();
    let said = common::program::one_line(output);
    assert!(
        said.contains("the model's eigenmouths are not those of"),
        "{said}"
    );
}
