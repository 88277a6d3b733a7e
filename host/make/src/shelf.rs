//! Rows of numbers put aside, to be read when their turn comes: in memory, or in a file without a name. Then memory does not
//! grow with their number, and nothing is left behind when a run is killed.
use crate::error::{Context as _, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;
use std::sync::Mutex;

/// Rows of numbers, each of its own length.
pub struct Shelf {
    place: Place,
    /// Where each row ends, in numbers from the beginning.
    ends: Vec<u64>,
}

enum Place {
    Memory(Vec<Vec<f32>>),
    File(Mutex<File>),
}

impl Shelf {
    /// Empty; rows will be in a file in `folder`, or in memory.
    pub fn new(folder: Option<&Path>) -> Result<Self> {
        let place = match folder {
            None => Place::Memory(Vec::new()),
            Some(folder) => {
                // The folder of a bare file name.
                let folder = match folder.as_os_str().is_empty() {
                    true => Path::new("."),
                    false => folder,
                };
                let cannot = || format!("cannot write in {}", folder.display());
                std::fs::create_dir_all(folder).with_context(cannot)?;
                Place::File(Mutex::new(tempfile::tempfile_in(folder).with_context(cannot)?))
            }
        };
        let ends = Vec::new();
        Ok(Self { place, ends })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Puts a row at the end. An error when the file cannot be written.
    pub fn push(&mut self, row: Vec<f32>) -> Result<()> {
        let end = self.ends.last().copied().unwrap_or(0);
        self.ends.push(end + row.len() as u64);
        match &mut self.place {
            Place::Memory(rows) => rows.push(row),
            Place::File(file) => {
                let bytes: Vec<u8> = row.iter().flat_map(|v| v.to_le_bytes()).collect();
                let file = file.get_mut().expect("no thread has panicked");
                file.seek(SeekFrom::Start(4 * end))?;
                file.write_all(&bytes).context("cannot put training data aside")?;
            }
        }
        Ok(())
    }

    /// Reads row `index`; panics where there is none. An error when the file cannot be read.
    pub fn get(&self, index: usize) -> Result<Vec<f32>> {
        let file = match &self.place {
            Place::Memory(rows) => return Ok(rows[index].clone()),
            Place::File(file) => file,
        };
        let from = if index == 0 { 0 } else { self.ends[index - 1] };
        let mut bytes = vec![0; 4 * (self.ends[index] - from) as usize];
        {
            let mut file = file.lock().expect("no thread has panicked");
            file.seek(SeekFrom::Start(4 * from))?;
            file.read_exact(&mut bytes)
                .context("cannot read training data that was put aside")?;
        }
        let words = bytes.chunks_exact(4);
        Ok(words
            .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back_in_any_order_and_the_file_has_no_name() {
        let folder = tempfile::tempdir().unwrap();
        let rows: Vec<Vec<f32>> = (0..5usize)
            .map(|n| (0..n * 3).map(|i| (i * n) as f32 / 7.0).collect())
            .collect();
        for place in [None, Some(folder.path())] {
            let mut shelf = Shelf::new(place).unwrap();
            assert!(shelf.is_empty());
            rows.iter().for_each(|row| shelf.push(row.clone()).unwrap());
            for n in [4, 0, 2, 1, 3, 4] {
                assert_eq!(shelf.get(n).unwrap(), rows[n]);
            }
            shelf.push(vec![1.5]).unwrap();
            assert_eq!((shelf.len(), shelf.get(5).unwrap()), (6, vec![1.5]));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        let nowhere = folder.path().join("a file");
        std::fs::write(&nowhere, b"").unwrap();
        assert!(Shelf::new(Some(&nowhere)).is_err());
    }
}
