//! Sums of an E step as files that add up: `lipstream train accumulate` writes one for each shard of a corpus, `merge` adds
//! them.
//!
//! ```text
//! magic "LIPSUMS\0", version u32, length of the header u32
//! header: JSON (which state, corpus, shard; shapes; clips without a path)
//! f64 little-endian: log likelihood, transitions, then occupancy, first, second of the audio and the visual chain
//! CRC-32 of everything before it
//! ```
use std::path::{Path, PathBuf};

use lipstream_core::model::container::checksum;
use ndarray::{Array, Array2, Array3, Dimension};
use serde::{Deserialize, Serialize};

use crate::em::Sums;
use crate::em::density::Accumulator;
use crate::error::{Context as _, Error, Result, bail, ensure};
use lipstream_media::files;

const MAGIC: &[u8; 8] = b"LIPSUMS\0";
const VERSION: u32 = 1;

/// Where sums come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// Checksum of the state that they were made with.
    pub state: u32,
    /// Checksum of the corpus's manifest.
    pub corpus: u32,
    /// 1..=of
    pub shard: usize,
    /// Number of shards that the corpus is dealt into.
    pub of: usize,
}

#[derive(Serialize, Deserialize)]
struct Header {
    origin: Origin,
    frames: usize,
    failed: Vec<String>,
    transition: (usize, usize, usize),
    audio: (usize, usize, usize),
    visual: Option<(usize, usize, usize)>,
}

/// Writes sums, whole or not at all.
pub fn write(path: &Path, origin: &Origin, sums: &Sums) -> Result<()> {
    let header = serde_json::to_vec(&Header {
        origin: origin.clone(),
        frames: sums.frames,
        failed: sums.failed.clone(),
        transition: sums.transition.dim(),
        audio: sums.audio.first.dim(),
        visual: sums.visual.as_ref().map(|v| v.first.dim()),
    })?;
    let mut bytes = MAGIC.to_vec();
    bytes.extend(VERSION.to_le_bytes());
    bytes.extend(u32::try_from(header.len()).map_err(Error::other)?.to_le_bytes());
    bytes.extend(header);
    let mut put = |value: &f64| bytes.extend(value.to_le_bytes());
    put(&sums.log_likelihood);
    sums.transition.iter().for_each(&mut put);
    for chain in std::iter::once(&sums.audio).chain(&sums.visual) {
        chain.occupancy.iter().for_each(&mut put);
        chain.first.iter().for_each(&mut put);
        chain.second.iter().for_each(&mut put);
    }
    bytes.extend(checksum(&bytes).to_le_bytes());
    files::write_bytes(path, &bytes).map_err(Error::other)
}

/// Reads sums.
pub fn read(path: &Path) -> Result<(Origin, Sums)> {
    let bytes = files::read_bytes(path).map_err(Error::other)?;
    parse(&bytes).with_context(|| format!("{} holds no usable sums", path.display()))
}

fn parse(bytes: &[u8]) -> Result<(Origin, Sums)> {
    let word = |at: usize| -> Option<u32> {
        let four = bytes.get(at..at + 4)?;
        Some(u32::from_le_bytes(four.try_into().ok()?))
    };
    if !bytes.starts_with(MAGIC) {
        bail!(File, "it was not written by `lipstream train accumulate`");
    }
    let (Some(version), Some(length)) = (word(8), word(12)) else {
        bail!(File, "it is cut short");
    };
    if version != VERSION {
        bail!(
            File,
            "version {version}, this program reads {VERSION}: accumulate again"
        );
    }
    let body = bytes.len().saturating_sub(4);
    if word(body) != Some(checksum(&bytes[..body])) {
        bail!(File, "its checksum is wrong: it is damaged or cut short");
    }
    let header = bytes[..body]
        .get(16..)
        .and_then(|rest| rest.get(..length as usize))
        .ok_or_else(|| Error::File("it is cut short".into()))?;
    let numbers = &bytes[16 + header.len()..body];
    let header: Header = serde_json::from_slice(header).context("its header is damaged")?;
    let size = |(a, b, c): (usize, usize, usize)| a.checked_mul(b)?.checked_mul(c);
    let chain = |(a, b, c)| size((a, b, c))?.checked_mul(2)?.checked_add(a.checked_mul(b)?);
    let expected = (|| {
        let visual = header.visual.map_or(Some(0), chain)?;
        size(header.transition)?
            .checked_add(1)?
            .checked_add(chain(header.audio)?)?
            .checked_add(visual)?
            .checked_mul(8)
    })();
    ensure!(
        expected == Some(numbers.len()),
        File,
        "its length does not fit its header"
    );
    let mut numbers = numbers.chunks_exact(8).map(|b| {
        let mut eight = [0; 8];
        eight.copy_from_slice(b);
        f64::from_le_bytes(eight)
    });
    let log_likelihood = numbers
        .next()
        .ok_or_else(|| Error::File("it is cut short".into()))?;
    let transition = array(&mut numbers, header.transition)?;
    let mut chain = |(s, k, d): (usize, usize, usize)| -> Result<Accumulator> {
        let occupancy: Array2<f64> = array(&mut numbers, (s, k))?;
        let first: Array3<f64> = array(&mut numbers, (s, k, d))?;
        let second: Array3<f64> = array(&mut numbers, (s, k, d))?;
        Ok(Accumulator {
            occupancy,
            first,
            second,
        })
    };
    let sums = Sums {
        audio: chain(header.audio)?,
        visual: header.visual.map(&mut chain).transpose()?,
        transition,
        log_likelihood,
        frames: header.frames,
        failed: header.failed,
    };
    Ok((header.origin, sums))
}

fn array<D: Dimension, S: ndarray::ShapeArg<Dim = D> + Clone>(
    numbers: &mut impl Iterator<Item = f64>,
    shape: S,
) -> Result<Array<f64, D>> {
    let (shape, _) = shape.into_shape_and_order();
    let values: Vec<f64> = numbers.take(shape.size()).collect();
    ensure!(
        values.iter().all(|v| v.is_finite()),
        File,
        "it holds a number that is not finite"
    );
    Ok(Array::from_shape_vec(shape, values)?)
}

/// Adds the sums of all shards, whatever order they are given in; refuses sums that do not belong together.
pub fn merge(paths: &[PathBuf], state: u32) -> Result<Sums> {
    let mut shards = Vec::new();
    for path in paths {
        let (origin, sums) = read(path)?;
        if origin.state != state {
            bail!(
                Choice,
                "{} was made with another state: accumulate it again with this one",
                path.display()
            );
        }
        shards.push((path, origin, sums));
    }
    shards.sort_by_key(|(_, origin, _)| origin.shard);
    let Some((first, head, _)) = shards.first() else {
        bail!(Choice, "no sums to merge");
    };
    for (path, origin, _) in &shards {
        if origin.corpus != head.corpus {
            bail!(
                Choice,
                "{} and {} are of different corpora",
                first.display(),
                path.display()
            );
        }
        if origin.of != head.of {
            bail!(
                Choice,
                "{} is a shard of {}, {} a shard of {}: cut the corpus once",
                first.display(),
                head.of,
                path.display(),
                origin.of
            );
        }
    }
    for pair in shards.windows(2) {
        if pair[0].1.shard == pair[1].1.shard {
            bail!(
                Choice,
                "{} and {} are both shard {} of {}: it would count twice",
                pair[0].0.display(),
                pair[1].0.display(),
                head.shard,
                head.of
            );
        }
    }
    let missing: Vec<String> = (1..=head.of)
        .filter(|n| shards.iter().all(|(_, origin, _)| origin.shard != *n))
        .map(|n| n.to_string())
        .collect();
    if !missing.is_empty() {
        bail!(Choice, "shard {} of {} is missing", missing.join(", "), head.of);
    }
    let mut sums = shards.into_iter().map(|(_, _, sums)| sums);
    let mut total = sums
        .next()
        .ok_or_else(|| Error::File("no sums to merge".into()))?;
    for part in sums {
        let fits = part.transition.dim() == total.transition.dim()
            && part.audio.first.dim() == total.audio.first.dim()
            && part.visual.as_ref().map(|v| v.first.dim()) == total.visual.as_ref().map(|v| v.first.dim());
        ensure!(fits, File, "the shards' sums have different shapes");
        total.merge(part);
    }
    Ok(total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::chain;

    fn sums(seed: f64) -> Sums {
        let fill =
            |k: f64| move |(a, b, c): (usize, usize, usize)| seed + k + (a * 7 + b * 3 + c) as f64 / 3.0;
        let chain = |s, k, d, by: f64| Accumulator {
            occupancy: Array2::from_shape_fn((s, k), |(a, b)| seed + by + (a + b) as f64),
            first: Array3::from_shape_fn((s, k, d), fill(by)),
            second: Array3::from_shape_fn((s, k, d), fill(by + 1.0)),
        };
        Sums {
            audio: chain(10, 2, 3, 0.1),
            visual: Some(chain(5, 1, 2, 0.2)),
            transition: Array3::from_shape_fn((2, 5, 4), fill(0.3)),
            log_likelihood: -1_234.567_890_123 * seed,
            frames: 100,
            failed: vec!["a".into()],
        }
    }

    fn origin(shard: usize, of: usize) -> Origin {
        Origin {
            state: 7,
            corpus: 9,
            shard,
            of,
        }
    }

    #[test]
    fn sums_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sums");
        write(&path, &origin(2, 3), &sums(1.0)).unwrap();
        assert_eq!(read(&path).unwrap(), (origin(2, 3), sums(1.0)));
    }

    #[test]
    fn damage_is_noticed_and_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sums");
        write(&path, &origin(1, 1), &sums(1.0)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for cut in (0..bytes.len()).step_by(7) {
            assert!(parse(&bytes[..cut]).is_err(), "{cut}");
        }
        for at in (0..bytes.len()).step_by(5) {
            let mut other = bytes.clone();
            other[at] ^= 0x20;
            assert!(parse(&other).is_err(), "{at}");
        }
    }

    #[test]
    fn only_what_belongs_together_is_merged() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, origin: Origin| {
            let path = folder.path().join(name);
            write(&path, &origin, &sums(origin.shard as f64)).unwrap();
            path
        };
        let (a, b) = (file("a", origin(1, 2)), file("b", origin(2, 2)));
        let forth = merge(&[a.clone(), b.clone()], 7).unwrap();
        assert_eq!(merge(&[b.clone(), a.clone()], 7).unwrap(), forth);
        let mut want = sums(1.0);
        want.merge(sums(2.0));
        assert_eq!(forth, want);
        let other_corpus = Origin {
            corpus: 8,
            ..origin(2, 2)
        };
        for (paths, state, says) in [
            (vec![a.clone(), b.clone()], 6, "another state"),
            (vec![a.clone()], 7, "shard 2 of 2 is missing"),
            (vec![a.clone(), file("c", origin(1, 2)), b.clone()], 7, "twice"),
            (vec![a.clone(), file("d", origin(2, 3))], 7, "cut the corpus once"),
            (vec![a.clone(), file("e", other_corpus)], 7, "different corpora"),
            (vec![], 7, "no sums"),
            (vec![folder.path().join("none")], 7, "none"),
        ] {
            let error = chain(&merge(&paths, state).unwrap_err());
            assert!(error.contains(says) && !error.contains('\n'), "{error}");
        }
    }
}
