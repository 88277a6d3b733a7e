//! Labelled pictures from files of other programs and of this one.
//!
//! | file | pictures are counted from | places |
//! |---|---|---|
//! | `CLIP_12.pts`, or `12.pts` in a folder called `CLIP` (iBUG: `version: 1`, `n_points: 68`, `{`, a line `x y` for each, `}`) | [`How::first_picture`] | pixels, the first pixel's centre at 1 |
//! | `CLIP.csv` of OpenFace (`frame`, `success`, `x_0` … `y_0` …) | 1 | pixels, the first pixel's centre at 0 |
//! | `CLIP.csv` of MediaPipe's normalised landmarks (`frame,x_0,y_0,z_0,x_1,…`, z may be missing) | [`How::first_picture`] | shares of width and height, from the picture's edge |
//! | our table, `.npz`, folder of `.npy` | 0 | pixels, the first pixel's centre at 0 |
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::table::{self, MOST_PICTURES, as_many, dense, numbers, rows};
use crate::error::{Context as _, Error, Result, bail, ensure};
use crate::hierarchical::Landmarks;

/// What files do not say of themselves.
#[derive(Clone, Debug)]
pub struct How {
    /// The number of a clip's first picture in names of `.pts` and in MediaPipe's `frame`: 1, as ffmpeg names pictures, or 0.
    pub first_picture: usize,
    /// Width and height of the video in pixels, for places in shares of them.
    pub size: Option<(usize, usize)>,
    /// The clip that is meant where a file names none.
    pub clip: Option<String>,
}

/// Points of pictures, by clip and picture; none where a picture has no face.
type Pictures = BTreeMap<String, BTreeMap<usize, Vec<f32>>>;

/// Reads labelled pictures from all files together.
///
/// # Errors
///
/// A file that is none of those that are read, or does not fit the others; a picture that is labelled twice; no labelled picture at all.
pub fn read(paths: &[PathBuf], how: &How) -> Result<Landmarks> {
    let mut pictures = Pictures::new();
    let mut known: Option<Landmarks> = None;
    let mut files = Vec::new();
    for path in paths {
        match path.is_dir() && holds(path, "npy")?.is_empty() {
            false => files.push(path.clone()),
            true => {
                let inside = [holds(path, "pts")?, holds(path, "csv")?].concat();
                ensure!(
                    !inside.is_empty(),
                    Data,
                    "{} holds no landmarks: looked for .pts, .csv and .npy",
                    path.display()
                );
                files.extend(inside);
            }
        }
    }
    for path in &files {
        let found = one(path, how)?;
        match &mut known {
            None => known = Some(Landmarks::none(found.count(), found.groups().clone())),
            Some(known) => {
                ensure!(
                    known.count() == found.count(),
                    Data,
                    "{}: {} landmarks in a picture, those before have {}",
                    path.display(),
                    found.count(),
                    known.count()
                );
                if known.groups().is_empty() {
                    *known = Landmarks::none(found.count(), found.groups().clone());
                }
            }
        }
        for (clip, points) in found.clips() {
            let of_clip = pictures.entry(clip.to_owned()).or_default();
            for (picture, row) in points.outer_iter().enumerate() {
                let has_face = row.iter().all(|v| v.is_finite());
                let before = of_clip.entry(picture).or_default();
                ensure!(
                    before.is_empty() || !has_face,
                    Data,
                    "{}: picture {picture} of clip {clip}, counted from 0, is labelled already by another file",
                    path.display()
                );
                if has_face {
                    *before = row.iter().copied().collect();
                }
            }
        }
    }
    let mut all = known.ok_or_else(|| Error::Choice("no labelled picture was given".to_owned()))?;
    for (clip, of_clip) in &pictures {
        all.put(clip, dense(all.count(), of_clip)?)?;
    }
    ensure!(
        !all.labelled().is_empty(),
        Data,
        "{}: no picture of it has a face",
        paths[0].display()
    );
    Ok(all)
}

/// Files of a folder with an ending, in order.
fn holds(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry?.path();
        if path.extension().is_some_and(|e| e == ending) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

fn one(path: &Path, how: &How) -> Result<Landmarks> {
    let name = path.display().to_string();
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("pts") => pts(path, &name, how),
        Some("csv") => {
            let text = table::text(path)?;
            match rows(&text).next() {
                _ if table::is_table(&text) => table::parse(&name, &text),
                Some((_, head)) if head.contains(&"frame") && head.contains(&"success") => {
                    openface(path, &name, &text)
                }
                Some((_, head)) if head.contains(&"frame") && head.contains(&"x_0") => {
                    mediapipe(path, &name, &text, how)
                }
                _ => bail!(
                    File,
                    "{name} is no table of landmarks: its first line must begin with clip,picture (ours), or have the columns frame and success (OpenFace) or frame and x_0 (MediaPipe)"
                ),
            }
        }
        Some("npz") => Landmarks::read(path),
        _ if path.is_dir() => Landmarks::read(path),
        _ => bail!(
            File,
            "{name} holds no landmarks that are known: .pts, .csv, .npz or a folder of them"
        ),
    }
}

fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// All pictures of one clip.
fn of_clip(clip: String, count: usize, pictures: &BTreeMap<usize, Vec<f32>>) -> Result<Landmarks> {
    let mut found = Landmarks::none(count, Vec::new());
    found.put(&clip, dense(count, pictures)?)?;
    Ok(found)
}

/// A picture's number counted from 0.
fn counted(name: &str, number: usize, first: usize) -> Result<usize> {
    match number.checked_sub(first) {
        Some(picture) if picture < MOST_PICTURES => Ok(picture),
        _ => bail!(
            Data,
            "{name}: there is no picture {number} where the first has the number {first}: say with --first-picture what number the first has"
        ),
    }
}

fn pts(path: &Path, name: &str, how: &How) -> Result<Landmarks> {
    let stem = stem(path);
    let digits = stem.len() - stem.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let (before, number) = stem.split_at(stem.len() - digits);
    let Ok(number) = number.parse::<usize>() else {
        bail!(
            Data,
            "{name}: its name must end with the number of a picture, as clip_12.pts does"
        );
    };
    let before = before.trim_end_matches(['_', '-', '.']);
    let folder = || {
        let folder = std::path::absolute(path).ok()?;
        Some(folder.parent()?.file_name()?.to_string_lossy().into_owned())
    };
    let clip = match before.is_empty() {
        false => before.to_owned(),
        true => how.clip.clone().or_else(folder).unwrap_or_default(),
    };
    let text = table::text(path)?;
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(n, line)| (n + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty());
    let mut said = None;
    for (line, words) in lines.by_ref() {
        match words
            .split_once(':')
            .map(|(key, value)| (key.trim(), value.trim()))
        {
            Some(("n_points", value)) => said = value.parse::<usize>().ok(),
            Some(("version", "1")) => {}
            Some(("version", other)) => {
                bail!(
                    File,
                    "{name}, line {line}: version {other} of .pts; version 1 is read"
                );
            }
            None if words == "{" => break,
            _ => bail!(
                File,
                "{name}, line {line}: {words:?}; before the points stand version, n_points and {{"
            ),
        }
    }
    let mut points = Vec::new();
    let mut ended = false;
    for (line, words) in lines {
        if words == "}" {
            ended = true;
            break;
        }
        let cells: Vec<&str> = words.split_whitespace().collect();
        ensure!(
            cells.len() == 2,
            File,
            "{name}, line {line}: {words:?}; a point is x and y"
        );
        // The first pixel's centre is at 1 in the files, at 0 here.
        points.extend(numbers(name, line, &cells)?.iter().map(|v| v - 1.0));
    }
    ensure!(
        ended,
        File,
        "{name}: the }} behind the last point is missing: the file is cut short, or is no .pts"
    );
    let count = points.len() / 2;
    ensure!(
        said == Some(count) && count >= 3,
        File,
        "{name}: n_points is {}, but it holds {count} points; a face needs three at least",
        said.map_or("missing".to_owned(), |n| n.to_string())
    );
    let picture = counted(name, number, how.first_picture)?;
    of_clip(clip, count, &BTreeMap::from([(picture, points)]))
}

/// The columns `x_0`, `x_1`, …, as long as there are more, and those of y.
fn places(name: &str, head: &[&str]) -> Result<Vec<[usize; 2]>> {
    let column = |wanted: String| head.iter().position(|cell| *cell == wanted);
    let pair = |k: usize| Some([column(format!("x_{k}"))?, column(format!("y_{k}"))?]);
    let found: Vec<[usize; 2]> = (0..).map_while(pair).collect();
    let xs = head
        .iter()
        .filter(|cell| {
            cell.strip_prefix("x_")
                .is_some_and(|n| n.parse::<usize>().is_ok())
        })
        .count();
    ensure!(
        xs == found.len() && xs >= 3,
        File,
        "{name}: {xs} columns x_0, x_1, …, of which {} have their y; a face needs three points at least",
        found.len()
    );
    Ok(found)
}

/// Numbers of the columns of a line, and its picture.
fn places_of(name: &str, line: usize, cells: &[&str], places: &[[usize; 2]]) -> Result<Vec<f32>> {
    let chosen: Vec<&str> = places.iter().flatten().map(|column| cells[*column]).collect();
    numbers(name, line, &chosen)
}

fn openface(path: &Path, name: &str, text: &str) -> Result<Landmarks> {
    pictures(path, name, text, 1, |line, cells, head, places| {
        let cell = |wanted: &str| head.iter().position(|cell| *cell == wanted).map(|n| cells[n]);
        match cell("success") {
            Some("0") => Ok(Vec::new()),
            Some("1") => places_of(name, line, cells, places),
            other => bail!(File, "{name}, line {line}: success is {other:?}; it is 0 or 1"),
        }
    })
}

fn mediapipe(path: &Path, name: &str, text: &str, how: &How) -> Result<Landmarks> {
    let Some((width, height)) = how.size else {
        bail!(
            Choice,
            "{name} has places in shares of the picture (MediaPipe): say with --size WIDTHxHEIGHT how large the video is"
        );
    };
    pictures(path, name, text, how.first_picture, |line, cells, _, places| {
        if places.iter().flatten().all(|column| cells[*column].is_empty()) {
            return Ok(Vec::new());
        }
        let mut points = places_of(name, line, cells, places)?;
        if let Some(far) = points.iter().find(|v| v.abs() > 3.0) {
            bail!(
                File,
                "{name}, line {line}: {far} is no share of the picture: MediaPipe's normalised landmarks are read, not pixels"
            );
        }
        for (k, v) in points.iter_mut().enumerate() {
            // Shares count from the picture's edge, half a pixel before the first centre.
            *v = *v * [width, height][k % 2] as f32 - 0.5;
        }
        Ok(points)
    })
}

/// The pictures of a table that has a column `frame`, counted from `first`.
fn pictures(
    path: &Path,
    name: &str,
    text: &str,
    first: usize,
    mut points: impl FnMut(usize, &[&str], &[&str], &[[usize; 2]]) -> Result<Vec<f32>>,
) -> Result<Landmarks> {
    let mut lines = rows(text);
    let (_, head) = lines.next().unwrap_or_default();
    let places = places(name, &head)?;
    let frame = head.iter().position(|cell| *cell == "frame").unwrap_or(0);
    let mut found = BTreeMap::new();
    for (line, cells) in lines {
        as_many(name, line, &cells, &head)?;
        let Ok(number) = cells[frame].parse::<usize>() else {
            bail!(File, "{name}, line {line}: frame {:?} is no number", cells[frame]);
        };
        let picture = counted(&format!("{name}, line {line}"), number, first)?;
        let of_picture = points(line, &cells, &head, &places)?;
        ensure!(
            found.insert(picture, of_picture).is_none(),
            Data,
            "{name}, line {line}: frame {number} is there twice, perhaps with two faces: keep the lines of one"
        );
    }
    of_clip(stem(path), places.len(), &found)
}
