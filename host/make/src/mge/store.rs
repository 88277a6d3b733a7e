//! Clips of a training run, read when their turn comes.
use std::path::Path;

use lipstream_core::N_STATIC;
use ndarray::Array2;

use super::data::Clip;
use super::disturb::Variant;
use crate::error::Result;
use crate::shelf::Shelf;

/// What is known of a clip without reading it.
#[derive(Clone, Debug, PartialEq)]
pub struct Note {
    /// Number of frames of the undisturbed clip.
    pub frames: usize,
    /// First frame and number of frames of each variant.
    pub variants: Vec<(usize, usize)>,
    id: String,
    /// Numbers in a frame of the mouth, if there is one.
    mouth: Option<usize>,
}

/// Clips that are read one by one.
pub struct Store {
    notes: Vec<Note>,
    /// One clip a row: statics, mouth, statics of the variants, states.
    shelf: Shelf,
}

impl Store {
    /// Empty; clips will be in a file in `folder`, or in memory.
    pub fn new(folder: Option<&Path>) -> Result<Self> {
        Ok(Self {
            notes: Vec::new(),
            shelf: Shelf::new(folder)?,
        })
    }

    /// Puts a clip at the end. An error when it cannot be written.
    pub fn push(&mut self, clip: &Clip) -> Result<()> {
        self.notes.push(Note {
            frames: clip.x.nrows(),
            variants: clip.variants.iter().map(|v| (v.first, v.x.nrows())).collect(),
            id: clip.id.clone(),
            mouth: clip.mouth.as_ref().map(Array2::ncols),
        });
        let heard = clip.variants.iter().flat_map(|v| &v.x);
        let numbers = clip.x.iter().chain(clip.mouth.iter().flatten()).chain(heard);
        let states = clip.states.iter().flat_map(|&(a, v)| [a as f32, v as f32]);
        self.shelf.push(numbers.copied().chain(states).collect())
    }

    /// Number of clips.
    pub fn len(&self) -> usize {
        self.notes.len()
    }

    /// Whether there is no clip.
    pub fn is_empty(&self) -> bool {
        self.notes.is_empty()
    }

    /// What is known of clip `index`; panics where there is none.
    pub fn note(&self, index: usize) -> &Note {
        &self.notes[index]
    }

    /// Reads clip `index`; panics where there is none. An error when it cannot be read.
    pub fn get(&self, index: usize) -> Result<Clip> {
        let note = &self.notes[index];
        let mut numbers = self.shelf.get(index)?.into_iter();
        let mut array = |frames: usize, size: usize| {
            let values = numbers.by_ref().take(frames * size).collect();
            Array2::from_shape_vec((frames, size), values)
        };
        let x = array(note.frames, N_STATIC)?;
        let mouth = note.mouth.map(|size| array(note.frames, size)).transpose()?;
        let mut variants = Vec::with_capacity(note.variants.len());
        for &(first, frames) in &note.variants {
            let x = array(frames, N_STATIC)?;
            variants.push(Variant { first, x });
        }
        let states: Vec<usize> = numbers.map(|v| v as usize).collect();
        Ok(Clip {
            id: note.id.clone(),
            x,
            mouth,
            states: states.chunks_exact(2).map(|s| (s[0], s[1])).collect(),
            variants,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_come_back_as_they_were() {
        let clip = |n: usize| Clip {
            id: format!("clip {n}"),
            x: Array2::from_shape_fn((20 + n, N_STATIC), |(t, d)| (t * 7 + d + n) as f32 / 3.0),
            mouth: (n != 2).then(|| Array2::from_shape_fn((20 + n, 5), |(t, d)| (t + d * n) as f32 / 7.0)),
            states: (0..20 + n).map(|t| (t, 64 - t)).collect(),
            variants: (0..n)
                .map(|v| Variant {
                    first: v,
                    x: Array2::from_elem((20 + n - v, N_STATIC), v as f32 + 0.1),
                })
                .collect(),
        };
        let mut store = Store::new(None).unwrap();
        (0..4).for_each(|n| store.push(&clip(n)).unwrap());
        for n in [3, 0, 2, 1] {
            assert_eq!(store.get(n).unwrap(), clip(n));
        }
        assert_eq!(store.note(3).variants, [(0, 23), (1, 22), (2, 21)]);
    }
}
