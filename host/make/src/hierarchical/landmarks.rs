//! Landmarks of every picture of a corpus, from files.
//!
//! Two layouts are read. A folder holds `ID.npy` for each clip: f32 `[pictures, landmarks, 2]`, x and y in pixels of the video, whose pixels have their centres at whole
//! numbers, not finite where there is no face; and, where it says so, `groups.json`: `[["lips_outer", 20], ["lips_inner", 16], …]`. A NumPy archive (`.npz`) holds all clips: `clips`, their names; `points_x32`, i16 `[clips, pictures, landmarks, 2]`, pixels × 32, −32768
//! where there is none, or `points`, f32, not finite where there is none; and, where it says so, `pictures`, how many of them each clip has, and `groups` and `group_sizes`, names and sizes of runs of landmarks that belong together, such as `lips_outer`, 20.
//! The table that `lipstream landmarks` writes (`.csv`) is read too.
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use lipstream::kinds::hierarchical::Tree;
use lipstream::npy;
use lipstream_media::files;
use ndarray::{Array1, Array3, Array4, Axis, s};

use crate::error::{Context as _, Error, Result, bail, ensure};
use crate::landmarks::table;

/// Runs of landmarks that belong together, and their names.
pub type Groups = Vec<(String, std::ops::Range<usize>)>;

/// In a `.npz`: units in a pixel.
const UNITS: f32 = 32.0;
/// Largest array of a `.npz` that is read.
const MOST_BYTES: u64 = 1 << 30;

/// Landmarks by clip.
#[derive(Clone, Debug, Default)]
pub struct Landmarks {
    of: BTreeMap<String, Array3<f32>>,
    count: usize,
    groups: Groups,
}

impl Landmarks {
    /// Reads a folder or an archive.
    ///
    /// # Errors
    ///
    /// What is missing or does not fit, and in which file.
    pub fn read(path: &Path) -> Result<Self> {
        let is_table = path.extension().is_some_and(|ending| ending == "csv");
        let found = match path.is_dir() {
            true => folder(path)?,
            false if is_table => table::read(path)?,
            false => archive(path)?,
        };
        ensure!(
            found.count >= 3,
            Data,
            "{}: {} landmarks in a picture; a face needs three at least",
            path.display(),
            found.count
        );
        Ok(found)
    }

    /// No clip yet, of so many landmarks.
    pub fn none(count: usize, groups: Groups) -> Self {
        Self {
            of: BTreeMap::new(),
            count,
            groups,
        }
    }

    /// Puts a clip's landmarks `[pictures, landmarks, 2]` in.
    ///
    /// # Errors
    ///
    /// That they are of another number.
    pub fn put(&mut self, clip: &str, points: Array3<f32>) -> Result<()> {
        ensure!(
            (points.dim().1, points.dim().2) == (self.count, 2),
            Data,
            "clip {clip} has {} landmarks in a picture, not {}",
            points.dim().1,
            self.count
        );
        self.of.insert(clip.to_owned(), points);
        Ok(())
    }

    /// Puts the landmarks of one picture in; pictures before it of which nothing is known have numbers that are not finite.
    ///
    /// # Errors
    ///
    /// That they are of another number.
    pub fn put_picture(&mut self, clip: &str, picture: usize, points: &[[f32; 2]]) -> Result<()> {
        ensure!(
            points.len() == self.count,
            Data,
            "clip {clip} has {} landmarks in picture {picture}, not {}",
            points.len(),
            self.count
        );
        let before = self.of.remove(clip);
        let length = before.as_ref().map_or(0, |points| points.dim().0);
        let mut all = Array3::from_elem((length.max(picture + 1), self.count, 2), f32::NAN);
        if let Some(before) = before {
            all.slice_mut(s![..length, .., ..]).assign(&before);
        }
        let row = ndarray::ArrayView2::from_shape((points.len(), 2), points.as_flattened())?;
        all.slice_mut(s![picture, .., ..]).assign(&row);
        self.put(clip, all)
    }

    /// Clips and their landmarks, by name.
    pub fn clips(&self) -> impl Iterator<Item = (&str, &Array3<f32>)> {
        self.of.iter().map(|(clip, points)| (clip.as_str(), points))
    }

    /// Pictures of all clips, with landmarks or without.
    pub fn pictures(&self) -> usize {
        self.clips().map(|(_, points)| points.dim().0).sum()
    }

    /// Runs of landmarks that belong together; none where the file names none.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// The landmarks x₀, y₀, x₁, … of a picture, None where it has no face or is not labelled.
    pub fn picture(&self, clip: &str, picture: usize) -> Option<Array1<f32>> {
        let points = self.of(clip)?;
        (picture < points.dim().0)
            .then(|| points.index_axis(Axis(0), picture))
            .filter(|row| row.iter().all(|v| v.is_finite()))
            .map(|row| row.iter().copied().collect())
    }

    /// Clips and pictures that have landmarks, in order.
    pub fn labelled(&self) -> Vec<(&str, usize)> {
        self.clips()
            .flat_map(|(clip, points)| {
                let whole = |t: &usize| points.index_axis(Axis(0), *t).iter().all(|v| v.is_finite());
                (0..points.dim().0).filter(whole).map(move |t| (clip, t))
            })
            .collect()
    }

    /// Landmarks of a picture.
    pub fn count(&self) -> usize {
        self.count
    }

    /// A clip's landmarks `[pictures, landmarks, 2]`; a picture without a face has numbers that are not finite.
    pub fn of(&self, clip: &str) -> Option<&Array3<f32>> {
        self.of.get(clip)
    }

    /// The paper's tree, where the file says which landmarks are lips.
    ///
    /// # Errors
    ///
    /// That it does not, and what to do.
    pub fn tree(&self) -> Result<Tree> {
        let lips: Vec<usize> = self
            .groups
            .iter()
            .filter(|(name, _)| name.starts_with("lips"))
            .flat_map(|(_, range)| range.clone())
            .collect();
        ensure!(
            !lips.is_empty(),
            Choice,
            "the landmark file does not say which landmarks are lips: say with --tree FILE.json which belong to the mouth"
        );
        Ok(Tree::face_and_mouth(lips))
    }

    /// Where the runs of landmarks begin; none where the file names no groups.
    pub fn starts(&self) -> Vec<usize> {
        self.groups.iter().map(|(_, range)| range.start).collect()
    }

    /// The landmarks of the inner lips, in their order around the mouth, where the file names them.
    pub fn inner_lips(&self) -> Option<std::ops::Range<usize>> {
        let group = self.groups.iter().find(|(name, _)| name == "lips_inner");
        group.map(|(_, range)| range.clone())
    }
}

fn folder(path: &Path) -> Result<Landmarks> {
    let mut found = Landmarks::default();
    let entries = std::fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))?;
    for entry in entries {
        let file = entry?.path();
        let (Some(stem), true) = (
            file.file_stem().and_then(|stem| stem.to_str()),
            file.extension().is_some_and(|ending| ending == "npy"),
        ) else {
            continue;
        };
        let points: Array3<f32> = npy::read_array(&file).map_err(Error::other)?;
        let (_, count, axes) = points.dim();
        found.count = if found.of.is_empty() { count } else { found.count };
        ensure!(
            axes == 2 && count == found.count,
            File,
            "{}: shape {:?}; landmarks are [pictures, landmarks, 2], and every clip has as many as the others ({})",
            file.display(),
            points.dim(),
            found.count
        );
        found.of.insert(stem.to_owned(), points);
    }
    ensure!(
        !found.of.is_empty(),
        Data,
        "{} holds no landmarks: a folder of them has ID.npy for each clip",
        path.display()
    );
    let file = path.join("groups.json");
    if file.is_file() {
        let wrong = || format!("{} cannot be used", file.display());
        let groups: Vec<(String, i64)> =
            serde_json::from_slice(&files::read_bytes(&file).map_err(Error::other)?).with_context(wrong)?;
        let (names, sizes): (Vec<String>, Vec<i64>) = groups.into_iter().unzip();
        found.groups = runs(names, &sizes, found.count).with_context(wrong)?;
    }
    Ok(found)
}

fn archive(path: &Path) -> Result<Landmarks> {
    let name = path.display();
    let file = File::open(path).with_context(|| format!("cannot read {name}"))?;
    let mut zip = zip::ZipArchive::new(file)
        .with_context(|| format!("{name} is no NumPy archive (.npz), and no folder of ID.npy"))?;
    let mut member = |member: &str| -> Result<Vec<u8>> {
        let entry = zip
            .by_name(&format!("{member}.npy"))
            .with_context(|| format!("{name} holds no array {member}"))?;
        let mut bytes = Vec::new();
        entry.take(MOST_BYTES).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    let wrong = |array: &str| format!("{name}: its array {array} cannot be used");
    let clips = words(&member("clips")?).with_context(|| wrong("clips"))?;
    let array = match member("points") {
        Ok(_) => "points",
        Err(_) => "points_x32",
    };
    let bytes = member(array)?;
    let points: Array4<f32> = match array {
        "points" => npy::parse(&bytes),
        _ => npy::parse(&bytes).map(|units: Array4<i16>| units.mapv(pixels)),
    }
    .map_err(Error::File)
    .with_context(|| wrong(array))?;
    let (n, most, count, axes) = points.dim();
    ensure!(
        n == clips.len() && axes == 2,
        File,
        "{name}: {} clips are named, the shape of {array} is {:?}; it must be [clips, pictures, landmarks, 2]",
        clips.len(),
        points.dim()
    );
    // Clips are as long as the longest where nothing else is said.
    let lengths: Vec<usize> = match member("pictures") {
        Err(_) => vec![most; n],
        Ok(bytes) => {
            let said: Array1<i64> = npy::parse(&bytes)
                .map_err(Error::File)
                .with_context(|| wrong("pictures"))?;
            let lengths: Vec<usize> = said
                .iter()
                .filter_map(|length| usize::try_from(*length).ok().filter(|length| *length <= most))
                .collect();
            ensure!(
                lengths.len() == n,
                File,
                "{name}: its array pictures does not say for each of {n} clips how many of {most} pictures it has"
            );
            lengths
        }
    };
    let groups = match (member("groups"), member("group_sizes")) {
        (Ok(names), Ok(sizes)) => {
            let names = words(&names).with_context(|| wrong("groups"))?;
            let sizes: Array1<i64> = npy::parse(&sizes)
                .map_err(Error::File)
                .with_context(|| wrong("group_sizes"))?;
            runs(names, sizes.as_slice().unwrap_or_default(), count).with_context(|| wrong("group_sizes"))?
        }
        _ => Vec::new(),
    };
    let of_clip =
        |(clip, length): (ndarray::ArrayView3<f32>, usize)| clip.slice(s![..length, .., ..]).to_owned();
    let of = clips
        .into_iter()
        .zip(points.outer_iter().zip(lengths).map(of_clip));
    Ok(Landmarks {
        of: of.collect(),
        count,
        groups,
    })
}

/// A number of `points_x32`.
fn pixels(units: i16) -> f32 {
    match units {
        i16::MIN => f32::NAN,
        units => f32::from(units) / UNITS,
    }
}

/// Runs of landmarks that follow each other.
fn runs(names: Vec<String>, sizes: &[i64], count: usize) -> Result<Groups> {
    let mut begin = 0usize;
    let mut out = Vec::new();
    for (name, size) in names.into_iter().zip(sizes) {
        let end = usize::try_from(*size)
            .ok()
            .and_then(|size| begin.checked_add(size));
        let Some(end) = end.filter(|end| *end <= count) else {
            bail!(File, "the group {name} reaches beyond the {count} landmarks");
        };
        out.push((name, begin..end));
        begin = end;
    }
    Ok(out)
}

/// The words of a NumPy array of Unicode strings (`<U6`): four bytes a letter, zeros behind a shorter word.
fn words(bytes: &[u8]) -> Result<Vec<String>> {
    let refused = || Error::File("it is no array of Unicode words".to_owned());
    let length = match bytes.get(6..10) {
        Some(&[1, _, low, high]) if bytes.starts_with(b"\x93NUMPY") => {
            usize::from(u16::from_le_bytes([low, high]))
        }
        _ => return Err(refused()),
    };
    let header = bytes.get(10..10 + length).ok_or_else(refused)?;
    let header = std::str::from_utf8(header).map_err(|_| refused())?;
    let (_, kind) = header.split_once("'<U").ok_or_else(refused)?;
    let letters: usize = kind
        .split('\'')
        .next()
        .and_then(|digits| digits.parse().ok())
        .filter(|letters| *letters > 0)
        .ok_or_else(refused)?;
    let data = &bytes[10 + length..];
    let width = letters
        .checked_mul(4)
        .filter(|width| data.len().is_multiple_of(*width))
        .ok_or_else(refused)?;
    let word = |word: &[u8]| -> Option<String> {
        let codes = word
            .chunks(4)
            .map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]]));
        codes.take_while(|c| *c != 0).map(char::from_u32).collect()
    };
    data.chunks(width).map(|w| word(w).ok_or_else(refused)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;
    use crate::landmarks::archive::word_bytes;
    use ndarray_npy::WriteNpyExt as _;
    use std::io::Write as _;

    fn npz(path: &Path, members: &[(&str, Vec<u8>)]) {
        let mut zip = zip::ZipWriter::new(File::create(path).unwrap());
        for (name, bytes) in members {
            zip.start_file(*name, zip::write::SimpleFileOptions::default())
                .unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
    }

    fn bytes<D: ndarray::Dimension, T: ndarray_npy::WritableElement>(
        array: &ndarray::Array<T, D>,
    ) -> Vec<u8> {
        let mut out = Vec::new();
        array.write_npy(&mut out).unwrap();
        out
    }

    #[test]
    fn an_archive_is_read_with_its_groups_and_its_gaps() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("l.npz");
        let mut points = Array4::<i16>::from_shape_fn((2, 3, 4, 2), |(c, t, k, axis)| {
            (((c * 3 + t) * 4 + k) * 2 + axis) as i16 * 16
        });
        points[(1, 2, 3, 0)] = i16::MIN;
        let sizes = ndarray::array![1i64, 3];
        let members = [
            ("clips.npy", word_bytes(&["ab", "abcd"])),
            ("points_x32.npy", bytes(&points)),
            ("groups.npy", word_bytes(&["jaw", "lips_inner"])),
            ("group_sizes.npy", bytes(&sizes)),
        ];
        npz(&path, &members);
        let read = Landmarks::read(&path).unwrap();
        assert_eq!((read.count(), read.inner_lips()), (4, Some(1..4)));
        assert_eq!(read.of("ab").unwrap()[(2, 3, 1)], 23.0 * 0.5);
        assert!(read.of("abcd").unwrap()[(2, 3, 0)].is_nan() && read.of("a").is_none());
        assert_eq!(read.tree().unwrap().areas[1].landmarks, [1, 2, 3]);
        // Without groups nobody knows where the mouth is.
        npz(&path, &members[..2]);
        let refused = Landmarks::read(&path).unwrap().tree().unwrap_err().to_string();
        assert!(refused.contains("--tree"), "{refused}");
        npz(&path, &members[1..]);
        let refused = chain(&Landmarks::read(&path).unwrap_err());
        assert!(refused.contains("l.npz holds no array clips"), "{refused}");
    }

    #[test]
    fn a_folder_is_read_and_what_does_not_fit_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, landmarks: usize| {
            let points = Array3::<f32>::from_elem((2, landmarks, 2), 1.5);
            std::fs::write(folder.path().join(name), bytes(&points)).unwrap();
        };
        let refused = Landmarks::read(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("holds no landmarks"), "{refused}");
        write("a.npy", 5);
        write("b.npy", 5);
        let read = Landmarks::read(folder.path()).unwrap();
        assert_eq!((read.count(), read.of("b").unwrap().dim()), (5, (2, 5, 2)));
        assert!(read.tree().is_err());
        let groups = |text: &str| std::fs::write(folder.path().join("groups.json"), text).unwrap();
        groups(r#"[["jaw", 1], ["lips_inner", 4]]"#);
        let read = Landmarks::read(folder.path()).unwrap();
        assert_eq!(read.inner_lips(), Some(1..5));
        for wrong in [r#"[["jaw", 1], ["lips_inner", 5]]"#, r#"[["jaw", -1]]"#, "{"] {
            groups(wrong);
            let refused = chain(&Landmarks::read(folder.path()).unwrap_err());
            assert!(refused.contains("groups.json cannot be used"), "{refused}");
        }
        groups("[]");
        write("c.npy", 6);
        let refused = Landmarks::read(folder.path()).unwrap_err().to_string();
        assert!(refused.contains(".npy: shape"), "{refused}");
    }
}
