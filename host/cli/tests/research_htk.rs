//! The `f64` front end against HTK's HCopy on `golden/htk` : within 1e-3 in every coefficient.
#[path = "../../run/tests/common/mod.rs"]
mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use lipstream::reference::{self, Normalisation};
use lipstream::{frontend, htk};
use lipstream_media::sound;

fn golden() -> Option<PathBuf> {
    let Some(shared) = std::env::var_os("LIPSTREAM_RESEARCH") else {
        println!("skipped: LIPSTREAM_RESEARCH is not set");
        return None;
    };
    Some(Path::new(&shared).join("golden/htk"))
}

/// The recordings in a folder.
fn wavs(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("golden/htk");
    let paths = entries.map(|entry| entry.expect("golden/htk").path());
    paths
        .filter(|path| path.extension().is_some_and(|e| e == "wav"))
        .collect()
}

#[test]
fn every_coefficient_equals_hcopy() {
    let Some(folder) = golden() else { return };
    let mut sounds = 0;
    for path in wavs(&folder) {
        let sound = sound::read(&path).unwrap();
        let ours = reference::observations(&sound.samples, Normalisation::None);
        let hcopy = htk::read(&path.with_extension("htk")).unwrap();
        assert_eq!(ours.dim(), hcopy.dim(), "{}", path.display());
        let worst = (&ours - &hcopy).iter().fold(0f32, |w, d| w.max(d.abs()));
        println!(
            "{}: {} frames, worst difference {worst:.2e}",
            path.display(),
            hcopy.nrows()
        );
        assert!(worst <= 1e-3, "{}: {worst}", path.display());
        sounds += 1;
    }
    assert!(sounds >= 3, "golden/htk holds {sounds} sounds");
}

/// The same through the program, in both formats: header words and numbers of HCopy's own files.
#[test]
fn the_program_writes_what_hcopy_writes() {
    let Some(golden) = golden() else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut sounds = 0;
    for wav in wavs(&golden) {
        let hcopy = std::fs::read(wav.with_extension("htk")).unwrap();
        for out in ["out.htk", "out.npy"] {
            let status = Command::new(env!("CARGO_BIN_EXE_lipstream"))
                .current_dir(&folder)
                .args(["features", wav.to_str().unwrap(), "--norm", "none", "-o", out])
                .status();
            assert!(status.unwrap().success(), "{}", wav.display());
        }
        let ours = std::fs::read(folder.path().join("out.htk")).unwrap();
        assert_eq!(
            ours[..12],
            hcopy[..12],
            "{}: frames, period, size, kind",
            wav.display()
        );
        assert_eq!(ours.len(), hcopy.len(), "{}", wav.display());
        let ours = htk::read(&folder.path().join("out.htk")).unwrap();
        let npy: ndarray::Array2<f32> = ndarray_npy::read_npy(folder.path().join("out.npy")).unwrap();
        assert_eq!(ours, npy, "{}", wav.display());
        let hcopy = htk::read(&wav.with_extension("htk")).unwrap();
        let worst = (&ours - &hcopy).iter().fold(0f32, |w, d| w.max(d.abs()));
        println!(
            "{}: {} frames, worst difference {worst:.2e}",
            wav.display(),
            ours.nrows()
        );
        assert!(worst <= 1e-3, "{}: {worst}", wav.display());
        sounds += 1;
    }
    assert!(sounds >= 3, "golden/htk holds {sounds} sounds");
}

/// The integer path: 40 dB on c1..c12 over the golden sounds, 30 dB when they are 40 dB quieter.
#[test]
fn integers_are_accurate_at_every_level() {
    let Some(folder) = golden() else { return };
    for (attenuation_db, least_db) in [(0.0, 55.0), (20.0, 50.0), (40.0, 40.0)] {
        for path in wavs(&folder) {
            let samples = common::quieter(&sound::read(&path).unwrap().samples, attenuation_db);
            let want = reference::statics(&samples);
            let cepstra = want.slice(ndarray::s![.., ..lipstream_core::N_CEPSTRA]);
            let largest = cepstra.iter().fold(0f64, |a, c| a.max(c.abs()));
            assert!(largest <= 60.0, "{}: a cepstrum of {largest}", path.display());
            let got = frontend::observations(&samples, Normalisation::None).mapv(f64::from);
            let snr = common::snr_db(&want, &got, 0..lipstream_core::N_CEPSTRA);
            println!("{} at −{attenuation_db} dB: {snr:.1} dB", path.display());
            assert!(
                snr >= least_db,
                "{} at −{attenuation_db} dB: {snr:.1} dB",
                path.display()
            );
        }
    }
}

/// Which share of recorded sentences the gate calls speech: the time constant of 256 such frames is four to seven seconds of talk.
#[test]
fn the_gate_passes_half_of_recorded_talk() {
    let Some(folder) = golden() else { return };
    for path in wavs(&folder) {
        let raw = reference::statics(&sound::read(&path).unwrap().samples);
        let mut gate = reference::normalise::Gate::default();
        let open = raw.column(12).iter().filter(|&&e| gate.next(e)).count();
        let seconds = 2.56 * raw.nrows() as f64 / open as f64;
        println!("{}: {seconds:.1} s of talk", path.display());
        assert!((3.5..7.0).contains(&seconds), "{}: {seconds} s", path.display());
    }
}
