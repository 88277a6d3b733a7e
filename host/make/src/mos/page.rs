//! A folder of clips to a page.
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lipstream::render::page::{escaped, fill, in_script};
use lipstream_media::files;
use rand::seq::SliceRandom as _;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use serde_json::json;

use super::{CHECKS, Key, QUESTIONS, Shown, VERSION, WORDS};
use crate::error::{Context as _, Error, Result, bail};
use crate::hash::Fnv1a;

const TEMPLATE: &str = include_str!("page.html");

/// Most bytes of clips in a page: a browser holds them several times over, and the page is a third larger.
pub const MAX_BYTES: u64 = 64 << 20;

/// A page and its key.
pub struct Made {
    /// The page.
    pub html: String,
    /// Which clip is whose.
    pub key: Key,
}

/// Makes a page of `folder`, which holds a folder of MP4 files for each system: the same names in each. The same clips under the same names
/// give the same page.
///
/// # Errors
///
/// That the folder cannot be read or is not as described, and that the clips are more than [`MAX_BYTES`].
pub fn make(folder: &Path, title: &str) -> Result<Made> {
    let systems = systems(folder)?;
    let names: Vec<String> = systems.keys().cloned().collect();
    let mut hash = Fnv1a::new();
    let mut films = Vec::new();
    let mut bytes = 0;
    for (system, clips) in &systems {
        for clip in clips {
            let path = folder.join(system).join(format!("{clip}.mp4"));
            bytes += std::fs::metadata(&path).map_or(0, |m| m.len());
            if bytes > MAX_BYTES {
                bail!(
                    Choice,
                    "the clips in {} are more than the {} MiB that a page holds: take fewer or shorter ones, or several pages",
                    folder.display(),
                    MAX_BYTES >> 20
                );
            }
            let film = files::read_bytes(&path).map_err(Error::other)?;
            if film.get(4..8) != Some(b"ftyp") {
                bail!(Data, "{} is no MP4 file, whatever its name says", path.display());
            }
            for part in [system.as_bytes(), &[0], clip.as_bytes(), &[0]] {
                hash.eat(part.iter().copied());
            }
            hash.eat(film.iter().copied());
            let shown = Shown {
                system: system.clone(),
                clip: clip.clone(),
            };
            films.push((shown, film));
        }
    }
    let test = format!("{:016x}", hash.value());
    // Codes and their order say nothing of the systems; who has the clips could draw them again, but has the key as well.
    let mut rng = Pcg64::seed_from_u64(hash.value());
    films.shuffle(&mut rng);
    let mut clips = BTreeMap::new();
    let mut shown_clips = Vec::new();
    for (shown, film) in films {
        let code = loop {
            let code = format!("{:06x}", rng.random_range(0..1 << 24));
            if !clips.contains_key(&code) {
                break code;
            }
        };
        shown_clips.push(json!({ "code": code, "film": STANDARD.encode(&film) }));
        clips.insert(code, shown);
    }
    let questions: Vec<_> = QUESTIONS
        .iter()
        .map(|q| json!({ "name": q.name, "text": q.question }))
        .collect();
    let data = json!({
        "version": VERSION,
        "test": test,
        "checks": CHECKS,
        "questions": questions,
        "words": WORDS,
        "clips": shown_clips,
    });
    Ok(Made {
        html: fill(
            TEMPLATE,
            &[("title", &escaped(title)), ("data", &in_script(&data))],
        ),
        key: Key::new(test, title.to_owned(), names, clips),
    })
}

/// Names of the systems and their clips, which are the same for all.
fn systems(folder: &Path) -> Result<BTreeMap<String, BTreeSet<String>>> {
    let mut systems = BTreeMap::new();
    for (name, is_folder) in entries(folder)? {
        if !is_folder {
            bail!(
                Data,
                "{} is no folder: {} holds one folder of clips for each system",
                folder.join(&name).display(),
                folder.display()
            );
        }
        let mut clips = BTreeSet::new();
        for (file, is_folder) in entries(&folder.join(&name))? {
            match file.strip_suffix(".mp4") {
                Some(clip) if !is_folder => clips.insert(clip.to_owned()),
                _ => bail!(
                    Data,
                    "{} is no .mp4 file",
                    folder.join(&name).join(file).display()
                ),
            };
        }
        systems.insert(name, clips);
    }
    if systems.len() < 2 {
        bail!(
            Data,
            "{} holds {} folders of clips: a test compares two systems at least",
            folder.display(),
            systems.len()
        );
    }
    let all: BTreeSet<&String> = systems.values().flatten().collect();
    if all.is_empty() {
        bail!(Data, "the folders in {} hold no .mp4 file", folder.display());
    }
    for (name, clips) in &systems {
        if let Some(missing) = all.iter().find(|clip| !clips.contains(**clip)) {
            bail!(
                Data,
                "{} has no {missing}.mp4, which another system has: all systems show the same clips",
                folder.join(name).display()
            );
        }
    }
    Ok(systems)
}

/// What is in a folder, hidden files left out, and whether it is a folder.
fn entries(folder: &Path) -> Result<Vec<(String, bool)>> {
    let cannot = || format!("cannot read {}", folder.display());
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(cannot)? {
        let entry = entry.with_context(cannot)?;
        let Ok(name) = entry.file_name().into_string() else {
            bail!(
                Data,
                "a name in {} is no text: name it otherwise",
                folder.display()
            );
        };
        if !name.starts_with('.') {
            found.push((name, entry.path().is_dir()));
        }
    }
    found.sort();
    Ok(found)
}
