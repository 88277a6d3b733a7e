//! Landmarks as a table (`.csv`), a row a picture, to look at and to correct by hand.
//!
//! `clip,picture,confidence,x_lips_outer_0,y_lips_outer_0,…`: pictures are counted from 0, places are in pixels of the video, whose pixels have their centres at whole numbers, and cells of a picture
//! without a face are empty. The columns' names say which runs of landmarks there are; without runs they are `x_0,y_0,x_1,…`. `confidence` may be missing.
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use lipstream_media::files;
use ndarray::{Array3, s};

use super::label::Labels;
use crate::error::{Error, Result, bail, ensure};
use crate::hierarchical::Landmarks;
use crate::hierarchical::landmarks::Groups;

/// Pictures of the longest clip that is read: ten hours of 25 a second. More is a number in the wrong column.
pub(super) const MOST_PICTURES: usize = 900_000;

/// Cells of a table's lines that are not empty, with their numbers counted from 1.
pub(super) fn rows(text: &str) -> impl Iterator<Item = (usize, Vec<&str>)> {
    let lines = text.lines().enumerate();
    lines
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(n, line)| (n + 1, line.split(',').map(str::trim).collect()))
}

/// Refuses a line that has not as many cells as the first line, `head`.
pub(super) fn as_many(name: &str, line: usize, cells: &[&str], head: &[&str]) -> Result<()> {
    ensure!(
        cells.len() == head.len(),
        File,
        "{name}, line {line}: {} cells, the first line has {}",
        cells.len(),
        head.len()
    );
    Ok(())
}

/// The text of a file.
pub(super) fn text(path: &Path) -> Result<String> {
    let bytes = files::read_text(path).map_err(Error::other)?;
    // Tables of spreadsheets begin with a byte order mark.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    String::from_utf8(bytes.to_vec())
        .map_err(|_| Error::File(format!("{} is no text (UTF-8)", path.display())))
}

/// Whether a table's first line is that of this layout.
pub(super) fn is_table(text: &str) -> bool {
    rows(text)
        .next()
        .is_some_and(|(_, head)| head.starts_with(&["clip", "picture"]))
}

/// Reads a table.
///
/// # Errors
///
/// What is wrong with it, and in which line.
pub(crate) fn read(path: &Path) -> Result<Landmarks> {
    parse(&path.display().to_string(), &text(path)?)
}

pub(super) fn parse(name: &str, text: &str) -> Result<Landmarks> {
    ensure!(
        is_table(text),
        File,
        "{name} is no table of landmarks: its first line must begin with clip,picture"
    );
    let mut lines = rows(text);
    let (_, head) = lines.next().unwrap_or_default();
    let first = 2 + usize::from(head.get(2) == Some(&"confidence"));
    let (count, groups) = columns(name, &head[first..])?;
    // Points of a clip by picture, empty where there is no face.
    let mut clips: BTreeMap<&str, BTreeMap<usize, Vec<f32>>> = BTreeMap::new();
    for (line, cells) in lines {
        as_many(name, line, &cells, &head)?;
        let Some(picture) = cells[1].parse().ok().filter(|picture| *picture < MOST_PICTURES) else {
            bail!(
                File,
                "{name}, line {line}: {:?} is no number of a picture",
                cells[1]
            );
        };
        ensure!(
            !cells[0].is_empty(),
            File,
            "{name}, line {line}: the clip has no name"
        );
        let cells = (cells[0], &cells[first..]);
        let points = match cells.1.iter().all(|cell| cell.is_empty()) {
            true => Vec::new(),
            false => numbers(name, line, cells.1)?,
        };
        ensure!(
            clips
                .entry(cells.0)
                .or_default()
                .insert(picture, points)
                .is_none(),
            File,
            "{name}, line {line}: picture {picture} of {} is there twice",
            cells.0
        );
    }
    ensure!(
        !clips.is_empty(),
        File,
        "{name} has no line below the names of its columns"
    );
    let mut found = Landmarks::none(count, groups);
    for (clip, pictures) in clips {
        found.put(clip, dense(count, &pictures)?)?;
    }
    Ok(found)
}

/// Numbers of a line, finite all of them.
pub(super) fn numbers(name: &str, line: usize, cells: &[&str]) -> Result<Vec<f32>> {
    let number = |cell: &&str| match cell.parse::<f32>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(Error::File(format!("{name}, line {line}: {cell:?} is no number"))),
    };
    cells.iter().map(number).collect()
}

/// Points by picture as an array, not finite where a picture has none.
pub(super) fn dense(count: usize, pictures: &BTreeMap<usize, Vec<f32>>) -> Result<Array3<f32>> {
    let length = pictures.keys().next_back().map_or(0, |last| last + 1);
    let mut points = Array3::from_elem((length, count, 2), f32::NAN);
    for (picture, of_picture) in pictures.iter().filter(|(_, points)| !points.is_empty()) {
        let row = ndarray::ArrayView2::from_shape((count, 2), of_picture)?;
        points.slice_mut(s![*picture, .., ..]).assign(&row);
    }
    Ok(points)
}

/// How many points, and which runs of them, the names of columns say: `x_NAME_0`, `y_NAME_0`, `x_NAME_1`, …
fn columns(name: &str, head: &[&str]) -> Result<(usize, Groups)> {
    let mut groups: Groups = Vec::new();
    let (pairs, rest) = head.as_chunks::<2>();
    ensure!(
        rest.is_empty() && pairs.len() >= 3,
        File,
        "{name}: {} columns of places; a face needs three points at least, each with x and y",
        head.len()
    );
    for (point, [x, y]) in pairs.iter().enumerate() {
        let of = |cell: &str, axis: &str| {
            let run = cell.strip_prefix(axis)?.strip_prefix('_')?;
            Some(match run.rsplit_once('_') {
                Some((run, index)) => (run.to_owned(), index.parse::<usize>().ok()?),
                None => (String::new(), run.parse::<usize>().ok()?),
            })
        };
        let (Some((run, index)), Some(other)) = (of(x, "x"), of(y, "y")) else {
            bail!(
                File,
                "{name}: the columns {x} and {y} are not the x and y of a point, such as x_jaw_0 and y_jaw_0"
            );
        };
        let begins = groups.last().is_none_or(|(last, _)| *last != run);
        let expected = match begins {
            true => 0,
            false => groups.last().map_or(0, |(_, range)| range.len()),
        };
        ensure!(
            other == (run.clone(), index) && index == expected,
            File,
            "{name}: the columns {x} and {y} are not those of point {expected} of their run"
        );
        match groups.last_mut() {
            Some((_, range)) if !begins => range.end = point + 1,
            _ => groups.push((run, point..point + 1)),
        }
    }
    groups.retain(|(run, _)| !run.is_empty());
    Ok((pairs.len(), groups))
}

/// Writes the whole table or none.
///
/// # Errors
///
/// What the disk says.
pub(super) fn write(path: &Path, labels: &Labels) -> Result<()> {
    let landmarks = &labels.landmarks;
    let mut names = vec![String::new(); landmarks.count()];
    for point in 0..landmarks.count() {
        let run = landmarks
            .groups()
            .iter()
            .find(|(_, range)| range.contains(&point));
        names[point] = match run {
            Some((run, range)) => format!("{run}_{}", point - range.start),
            None => point.to_string(),
        };
    }
    let mut out = "clip,picture,confidence".to_owned();
    for name in &names {
        let _ = write!(out, ",x_{name},y_{name}");
    }
    out.push('\n');
    for (clip, points) in landmarks.clips() {
        if clip.contains([',', '\n', '\r']) {
            bail!(Data, "the clip {clip:?} cannot be named in a table: write .npz");
        }
        for (picture, row) in points.outer_iter().enumerate() {
            let confidence = labels.confidence(clip).get(picture).copied().unwrap_or(0.0);
            let _ = write!(out, "{clip},{picture},{confidence:.3}");
            for place in &row {
                let _ = match place.is_finite() {
                    true => write!(out, ",{place:.3}"),
                    false => write!(out, ","),
                };
            }
            out.push('\n');
        }
    }
    files::write_bytes(path, out.as_bytes()).map_err(Error::other)
}
