//! Named f32 arrays with notes in one `.safetensors` file: the host's float models and eigenmouth spaces.
use std::collections::HashMap;
use std::path::Path;
use std::str::FromStr;

use ndarray::{Array, Array1, ArrayBase, Data, Dimension, Ix1};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};

use lipstream_core::model::container::FRONT_END_FINGERPRINT;
use lipstream_media::files;

use crate::error::{Context as _, Error, Result, bail};

/// A model's array and note of its front end.
const START_MEAN: &str = "start_mean";
const FRONT_END: &str = "front_end";
/// The front end of models that do not say which is theirs.
const BEFORE_IT_WAS_NOTED: u32 = 0x4850_0001;

/// What has been read from a file.
#[derive(Clone, Debug)]
pub struct Tensors {
    path: String,
    arrays: HashMap<String, (Vec<usize>, Vec<f32>)>,
    notes: HashMap<String, String>,
}

/// What is to be written.
#[derive(Default)]
pub struct TensorsBuilder {
    arrays: Vec<(String, Vec<usize>, Vec<u8>)>,
    notes: HashMap<String, String>,
}

impl TensorsBuilder {
    /// Adds an array under a name.
    pub fn put<S: Data<Elem = f32>, D: Dimension>(&mut self, name: &str, array: &ArrayBase<S, D>) {
        let bytes = array.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.arrays.push((name.to_owned(), array.shape().to_vec(), bytes));
    }

    /// Adds a note, or replaces the one of the same key.
    pub fn note(&mut self, key: &str, value: impl ToString) {
        self.notes.insert(key.to_owned(), value.to_string());
    }

    /// Adds the mean that a model's front end starts from, and which front end that is.
    pub fn put_start_mean<S: Data<Elem = f32>>(&mut self, mean: &ArrayBase<S, Ix1>) {
        self.put(START_MEAN, mean);
        self.note(FRONT_END, FRONT_END_FINGERPRINT);
    }

    /// Adds everything that another file holds, `prefix` before every name.
    pub fn put_within(&mut self, prefix: &str, file: &Tensors) {
        for (name, (shape, values)) in &file.arrays {
            let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            self.arrays
                .push((format!("{prefix}{name}"), shape.clone(), bytes));
        }
        for (key, value) in &file.notes {
            self.note(&format!("{prefix}{key}"), value);
        }
    }

    /// Writes the file; equal contents give equal bytes.
    ///
    /// # Errors
    ///
    /// That the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut views = Vec::new();
        for (name, shape, bytes) in &self.arrays {
            views.push((name.as_str(), TensorView::new(Dtype::F32, shape.clone(), bytes)?));
        }
        // Sorted, so that equal contents give equal bytes.
        let notes: std::collections::BTreeMap<_, _> = self.notes.iter().collect();
        let note = serde_json::to_string(&notes)?;
        let metadata = HashMap::from([("lipstream".to_owned(), note)]);
        let bytes = safetensors::serialize(views, Some(metadata))?;
        Ok(files::write_bytes(path, &bytes)?)
    }
}

impl Tensors {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// That it cannot be read, was not written by lipstream, or is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(&files::read_bytes(path)?, &path.display().to_string())
    }

    /// [`Tensors::read`] of the file that is named, or else the shipped model.
    ///
    /// # Errors
    ///
    /// As [`Tensors::read`].
    pub fn read_or_shipped(path: Option<&Path>) -> Result<Self> {
        match path {
            Some(path) => Self::read(path),
            None => Self::parse(crate::shipped::MODEL, crate::shipped::NAME),
        }
    }

    /// A file's bytes; `name` says in errors where they are from.
    ///
    /// # Errors
    ///
    /// That they were not written by lipstream, or are damaged.
    pub fn parse(bytes: &[u8], name: &str) -> Result<Self> {
        if bytes.starts_with(&lipstream_core::model::container::MAGIC) {
            bail!(
                File,
                "{name} holds the device's tables; give the model (.safetensors) that they were exported from"
            );
        }
        let parsed =
            SafeTensors::deserialize(bytes).with_context(|| format!("{name} is no safetensors file"))?;
        let (_, header) = SafeTensors::read_metadata(bytes)?;
        let note = header
            .metadata()
            .as_ref()
            .and_then(|m| m.get("lipstream"))
            .ok_or_else(|| {
                Error::File(format!(
                    "{name} was not written by lipstream (its header has no `lipstream` note)"
                ))
            })?;
        let notes =
            serde_json::from_str(note).with_context(|| format!("{name}: damaged `lipstream` note"))?;
        let mut arrays = HashMap::new();
        for (key, view) in parsed.tensors() {
            if view.dtype() != Dtype::F32 {
                bail!(File, "{name}: tensor {key} is not f32");
            }
            let values: Vec<f32> = view
                .data()
                .chunks_exact(4)
                .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect();
            if values.iter().any(|v| !v.is_finite()) {
                bail!(File, "{name}: tensor {key} holds a number that is not finite");
            }
            arrays.insert(key, (view.shape().to_vec(), values));
        }
        Ok(Self {
            path: name.to_owned(),
            arrays,
            notes,
        })
    }

    /// What was added by [`TensorsBuilder::put_within`].
    pub fn within(&self, prefix: &str) -> Self {
        let strip = |name: &String| name.strip_prefix(prefix).map(str::to_owned);
        let arrays = self.arrays.iter();
        let notes = self.notes.iter();
        Self {
            path: self.path.clone(),
            arrays: arrays
                .filter_map(|(name, array)| Some((strip(name)?, array.clone())))
                .collect(),
            notes: notes
                .filter_map(|(key, value)| Some((strip(key)?, value.clone())))
                .collect(),
        }
    }

    /// The array called `name`, of as many dimensions as the caller's type says.
    ///
    /// # Errors
    ///
    /// That there is no such array, or that it has another number of dimensions.
    pub fn array<D: Dimension>(&self, name: &str) -> Result<Array<f32, D>> {
        let (shape, values) = self
            .arrays
            .get(name)
            .ok_or_else(|| Error::File(format!("{}: no tensor {name}", self.path)))?;
        Array::from_shape_vec(shape.clone(), values.clone())?
            .into_dimensionality()
            .map_err(|_| {
                Error::File(format!(
                    "{}: tensor {name} has {} dimensions",
                    self.path,
                    shape.len()
                ))
            })
    }

    /// The mean that a model's front end starts from, `[13]`.
    ///
    /// # Errors
    ///
    /// That the model has none, or was trained for a front end whose numbers were others.
    pub fn start_mean(&self) -> Result<Array1<f32>> {
        let front_end = if self.has_note(FRONT_END) {
            self.noted(FRONT_END)?
        } else {
            BEFORE_IT_WAS_NOTED
        };
        if front_end != FRONT_END_FINGERPRINT {
            bail!(
                File,
                "{} was trained for a front end that hears otherwise ({front_end:#x}, this program's is {FRONT_END_FINGERPRINT:#x}): \
                 prepare its corpus and train it again",
                self.path
            );
        }
        self.array(START_MEAN)
    }

    /// Whether there is an array of this name.
    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// Whether there is a note under `key`.
    pub fn has_note(&self, key: &str) -> bool {
        self.notes.contains_key(key)
    }

    /// The note under `key`, as the type that the caller asks for.
    ///
    /// # Errors
    ///
    /// That there is no such note, or that it does not read as this type.
    pub fn noted<T: FromStr>(&self, key: &str) -> Result<T> {
        let text = self
            .notes
            .get(key)
            .ok_or_else(|| Error::File(format!("{}: no note {key}", self.path)))?;
        text.parse()
            .map_err(|_| Error::File(format!("{}: note {key} is {text:?}", self.path)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn what_was_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        let mut out = TensorsBuilder::default();
        out.put("x", &array![[1.0f32, 2.0], [3.0, 4.5]]);
        out.note("n", 7);
        out.write(&path).unwrap();
        let mut around = TensorsBuilder::default();
        around.note("n", 8);
        around.put_within("inner.", &Tensors::read(&path).unwrap());
        around.write(&folder.path().join("b.safetensors")).unwrap();
        let both = Tensors::read(&folder.path().join("b.safetensors")).unwrap();
        assert_eq!(both.noted::<usize>("n").unwrap(), 8);
        let inner = both.within("inner.");
        assert_eq!(inner.noted::<usize>("n").unwrap(), 7);
        assert_eq!(
            inner.array::<ndarray::Ix2>("x").unwrap(),
            array![[1.0f32, 2.0], [3.0, 4.5]]
        );
        let back = Tensors::read(&path).unwrap();
        let x: Array2<f32> = back.array("x").unwrap();
        assert_eq!(x, array![[1.0f32, 2.0], [3.0, 4.5]]);
        assert_eq!(back.noted::<usize>("n").unwrap(), 7);
        assert!(back.array::<ndarray::Ix2>("y").is_err());
    }

    /// A model that hears otherwise is refused by name, not run.
    #[test]
    fn a_model_of_another_front_end_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        let mean = Array1::from_elem(13, 2.5);
        let mut out = TensorsBuilder::default();
        out.put_start_mean(&mean);
        out.write(&path).unwrap();
        assert_eq!(Tensors::read(&path).unwrap().start_mean().unwrap(), mean);
        let mut older = TensorsBuilder::default();
        older.put(START_MEAN, &mean);
        older.write(&path).unwrap();
        let refused = Tensors::read(&path)
            .unwrap()
            .start_mean()
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("a.safetensors was trained for a front end"),
            "{refused}"
        );
    }

    #[test]
    fn damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.safetensors");
        std::fs::write(&path, b"not a model").unwrap();
        assert!(Tensors::read(&path).is_err());
    }
}
