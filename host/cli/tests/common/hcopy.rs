//! The front end against HCopy's files: for every `X.htk` in a folder, what we make of the `X.wav` beside it.
//!
//! Two folders hold such pairs: `tests/golden/htk`, which is in the repository and stands in for HCopy, and HCopy's own files among
//! the research data. Both are judged by this code.
use std::path::{Path, PathBuf};
use std::process::Command;

use lipstream::reference::{self, Normalisation};
use lipstream::{frontend, htk};
use lipstream_core::N_CEPSTRA;
use lipstream_media::sound;
use ndarray::{Array2, s};

/// Most that a coefficient may differ by from HCopy's.
const TOLERANCE: f32 = 1e-3;

/// A sound and HCopy's features of it.
pub(crate) struct Pair {
    pub(crate) name: String,
    pub(crate) wav: PathBuf,
    pub(crate) htk: PathBuf,
    pub(crate) samples: Vec<i16>,
}

/// The pairs of a folder. Fewer than `least` are a failure: a test that finds nothing to compare would pass.
pub(crate) fn pairs(folder: &Path, least: usize) -> Vec<Pair> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let files = entries.map(|entry| entry.expect("a readable folder").path());
    let pairs: Vec<Pair> = files
        .filter(|path| path.extension().is_some_and(|e| e == "htk"))
        .map(|htk| {
            let wav = htk.with_extension("wav");
            Pair {
                name: htk.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
                samples: sound::read(&wav).unwrap().samples,
                wav,
                htk,
            }
        })
        .collect();
    assert!(
        pairs.len() >= least,
        "{} holds {} pairs, not {least}",
        folder.display(),
        pairs.len()
    );
    pairs
}

/// No coefficient of `ours` is further than [`TOLERANCE`] from HCopy's.
fn close_to_hcopy(pair: &Pair, ours: &Array2<f32>) {
    let hcopy = htk::read(&pair.htk).unwrap();
    assert_eq!(ours.dim(), hcopy.dim(), "{}", pair.name);
    let worst = (ours - &hcopy).iter().fold(0f32, |w, d| w.max(d.abs()));
    println!(
        "{}: {} frames, worst difference {worst:.2e}",
        pair.name,
        hcopy.nrows()
    );
    assert!(worst <= TOLERANCE, "{}: {worst}", pair.name);
}

/// The `f64` front end: every coefficient.
pub(crate) fn every_coefficient_equals_hcopy(pairs: &[Pair]) {
    for pair in pairs {
        close_to_hcopy(pair, &reference::observations(&pair.samples, Normalisation::None));
    }
}

/// `program` is the path of `lipstream`: both its file formats hold HCopy's numbers, and its HTK file HCopy's header.
pub(crate) fn the_program_writes_what_hcopy_writes(pairs: &[Pair], program: &str) {
    let folder = tempfile::tempdir().unwrap();
    for pair in pairs {
        for out in ["out.htk", "out.npy"] {
            let status = Command::new(program)
                .current_dir(&folder)
                .arg("features")
                .arg(pair.wav.canonicalize().unwrap())
                .args(["--norm", "none", "-o", out])
                .status();
            assert!(status.unwrap().success(), "{}", pair.name);
        }
        let hcopy = std::fs::read(&pair.htk).unwrap();
        let ours = std::fs::read(folder.path().join("out.htk")).unwrap();
        let header = "frames, period, size, kind";
        assert_eq!(ours[..12], hcopy[..12], "{}: {header}", pair.name);
        assert_eq!(ours.len(), hcopy.len(), "{}", pair.name);
        let ours = htk::read(&folder.path().join("out.htk")).unwrap();
        let npy: Array2<f32> = ndarray_npy::read_npy(folder.path().join("out.npy")).unwrap();
        assert_eq!(ours, npy, "{}", pair.name);
        close_to_hcopy(pair, &ours);
    }
}

/// The integers on c1..c12 against HCopy's own numbers.
pub(crate) fn integers_are_close_to_hcopy(pairs: &[Pair], least_db: f64) {
    for pair in pairs {
        let hcopy = htk::read(&pair.htk).unwrap().mapv(f64::from);
        let ours = frontend::observations(&pair.samples, Normalisation::None).mapv(f64::from);
        let snr = super::snr_db(&hcopy, &ours, 0..N_CEPSTRA);
        println!("{}: {snr:.1} dB", pair.name);
        assert!(snr >= least_db, "{}: {snr:.1} dB", pair.name);
    }
}

/// The integers on c1..c12 against the `f64` front end, which stands for HCopy where the sound is made quieter; and no
/// cepstrum is near the end of its range.
pub(crate) fn integers_are_accurate_at_every_level(pairs: &[Pair]) {
    for (attenuation_db, least_db) in [(0.0, 55.0), (20.0, 50.0), (40.0, 40.0)] {
        for pair in pairs {
            let samples = super::quieter(&pair.samples, attenuation_db);
            let want = reference::statics(&samples);
            let cepstra = want.slice(s![.., ..N_CEPSTRA]);
            let largest = cepstra.iter().fold(0f64, |a, c| a.max(c.abs()));
            assert!(largest <= 60.0, "{}: a cepstrum of {largest}", pair.name);
            let got = frontend::observations(&samples, Normalisation::None).mapv(f64::from);
            let snr = super::snr_db(&want, &got, 0..N_CEPSTRA);
            println!("{} at −{attenuation_db} dB: {snr:.1} dB", pair.name);
            assert!(
                snr >= least_db,
                "{} at −{attenuation_db} dB: {snr:.1} dB",
                pair.name
            );
        }
    }
}
