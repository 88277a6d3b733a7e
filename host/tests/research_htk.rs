//! The `f64` front end against HTK's HCopy on `golden/htk` : within 1e-3 in every coefficient.
mod common;

use std::path::{Path, PathBuf};

use lipstream::reference::{self, Normalisation};
use lipstream::{audio, frontend, htk};

fn golden() -> Option<PathBuf> {
    let Some(shared) = std::env::var_os("LIPSTREAM_RESEARCH") else {
        println!("skipped: LIPSTREAM_RESEARCH is not set");
        return None;
    };
    Some(Path::new(&shared).join("golden/htk"))
}

#[test]
fn every_coefficient_equals_hcopy() {
    let Some(folder) = golden() else { return };
    let mut sounds = 0;
    for entry in std::fs::read_dir(&folder).expect("golden/htk") {
        let path = entry.expect("golden/htk").path();
        if path.extension().is_none_or(|e| e != "wav") {
            continue;
        }
        let sound = audio::read(&path).unwrap();
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

/// The integer path: 40 dB on c1..c12 over the golden sounds, 30 dB when they are 40 dB quieter.
#[test]
fn integers_are_accurate_at_every_level() {
    let Some(folder) = golden() else { return };
    for (attenuation_db, least_db) in [(0.0, 55.0), (20.0, 50.0), (40.0, 40.0)] {
        for entry in std::fs::read_dir(&folder).expect("golden/htk") {
            let path = entry.expect("golden/htk").path();
            if path.extension().is_none_or(|e| e != "wav") {
                continue;
            }
            let samples = common::quieter(&audio::read(&path).unwrap().samples, attenuation_db);
            let want = reference::statics(&samples);
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
