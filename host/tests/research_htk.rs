//! The `f64` front end against HTK's HCopy on `golden/htk` : within 1e-3 in every coefficient.
mod common;

use std::path::{Path, PathBuf};

use lipstream::audio;
use lipstream::reference::{self, Normalisation};

fn golden() -> Option<PathBuf> {
    let Some(shared) = std::env::var_os("LIPSTREAM_RESEARCH") else {
        println!("skipped: LIPSTREAM_RESEARCH is not set");
        return None;
    };
    Some(Path::new(&shared).join("golden/htk"))
}

/// Frames of an HTK file: 12-byte big-endian header, then big-endian f32.
fn read_htk(path: &Path) -> Vec<Vec<f32>> {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let frames = u32::from_be_bytes(bytes[..4].try_into().unwrap()) as usize;
    let size = usize::from(u16::from_be_bytes(bytes[8..10].try_into().unwrap()));
    assert_eq!(bytes.len(), 12 + frames * size);
    bytes[12..]
        .chunks_exact(size)
        .map(|frame| {
            frame
                .chunks_exact(4)
                .map(|v| f32::from_be_bytes(v.try_into().unwrap()))
                .collect()
        })
        .collect()
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
        let htk = read_htk(&path.with_extension("htk"));
        assert_eq!(ours.nrows(), htk.len(), "{}", path.display());
        let mut worst = 0f32;
        for (row, want) in ours.rows().into_iter().zip(&htk) {
            assert_eq!(row.len(), want.len());
            for (a, b) in row.iter().zip(want) {
                worst = worst.max((a - b).abs());
            }
        }
        println!(
            "{}: {} frames, worst difference {worst:.2e}",
            path.display(),
            htk.len()
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
            let got = common::features_fixed(&samples, None);
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
