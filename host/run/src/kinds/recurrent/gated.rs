//! The second memory of a recurrent model, in floats: a gated recurrent unit that hears z ([`lipstream_core::kinds::recurrent::gated`] has its
//! equations and runs it on the device).
use std::ops::Range;

use lipstream_core::kinds::recurrent::gated;
use ndarray::{ArrayView2, Axis};

use super::chain::dot;
use crate::error::{Result, bail};
use crate::tensors::{Tensors, TensorsBuilder};

/// Frames from one step to the next.
pub const STRIDE: usize = gated::STRIDE as usize;

/// Numbers of a second memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatedShape {
    /// Z, numbers that it hears.
    pub inputs: usize,
    /// K, numbers in it.
    pub memory: usize,
    /// D, mouth parameters.
    pub outputs: usize,
    /// Phones that it names while it is trained; 0 afterwards.
    pub phones: usize,
}

/// What is learnt, in the order of [`PARTS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// W_g `[3K, Z]`: resets, updates, news.
    Input,
    /// b_g `[3K]`.
    InputBias,
    /// R_g `[3K, K]`.
    Again,
    /// b_r `[3K]`.
    AgainBias,
    /// O_g `[D, K]`: the mouth in the frame of a step.
    Output,
    /// b_o `[D]`.
    OutputBias,
    /// O'_g `[D, K]`: the mouth in the frame after.
    Later,
    /// b'_o `[D]`.
    LaterBias,
    /// h before the first frame, `[K]`.
    First,
    /// `[P, K]`: logits of the phone, in training only.
    Phone,
    /// `[P]`.
    PhoneBias,
}

/// All parts.
pub const PARTS: [Part; 11] = [
    Part::Input,
    Part::InputBias,
    Part::Again,
    Part::AgainBias,
    Part::Output,
    Part::OutputBias,
    Part::Later,
    Part::LaterBias,
    Part::First,
    Part::Phone,
    Part::PhoneBias,
];

impl Part {
    /// Rows and columns; one column where it is a vector.
    pub fn size(self, of: &GatedShape) -> (usize, usize) {
        let k = of.memory;
        match self {
            Part::Input => (3 * k, of.inputs),
            Part::Again => (3 * k, k),
            Part::InputBias | Part::AgainBias => (3 * k, 1),
            Part::Output | Part::Later => (of.outputs, k),
            Part::OutputBias | Part::LaterBias => (of.outputs, 1),
            Part::First => (k, 1),
            Part::Phone => (of.phones, k),
            Part::PhoneBias => (of.phones, 1),
        }
    }

    /// Whether it is a matrix, not a vector.
    pub fn is_matrix(self) -> bool {
        matches!(
            self,
            Part::Input | Part::Again | Part::Output | Part::Later | Part::Phone
        )
    }

    /// Name of its tensor in a model file.
    fn name(self) -> &'static str {
        match self {
            Part::Input => "gated.input",
            Part::InputBias => "gated.input_bias",
            Part::Again => "gated.again",
            Part::AgainBias => "gated.again_bias",
            Part::Output => "gated.output",
            Part::OutputBias => "gated.output_bias",
            Part::Later => "gated.later",
            Part::LaterBias => "gated.later_bias",
            Part::First => "gated.first",
            Part::Phone => "gated.phone",
            Part::PhoneBias => "gated.phone_bias",
        }
    }
}

/// A second memory: its numbers, in standardised units of the mouth.
#[derive(Clone, Debug, PartialEq)]
pub struct Gated {
    /// How many there are of what.
    pub shape: GatedShape,
    /// All parts, one behind the other, matrices row by row.
    pub values: Vec<f32>,
    /// s, its share of the mouth, above 0 and below 1.
    pub share: f32,
}

/// What one step leaves behind.
#[derive(Clone, Debug, Default)]
pub struct Cell {
    /// r, u, n, `[3K]`.
    pub gates: Vec<f32>,
    /// n' = R_n h + b, `[K]`.
    pub again: Vec<f32>,
    /// h after the step, `[K]`.
    pub memory: Vec<f32>,
}

impl Gated {
    /// All zeros, an even share.
    pub fn zeros(shape: GatedShape) -> Self {
        let size = PARTS
            .iter()
            .map(|part| part.size(&shape))
            .map(|(r, c)| r * c)
            .sum();
        Self {
            shape,
            values: vec![0.0; size],
            share: 0.5,
        }
    }

    fn range(&self, part: Part) -> Range<usize> {
        let size = |p: &Part| {
            let (rows, columns) = p.size(&self.shape);
            rows * columns
        };
        let from = PARTS.iter().take_while(|p| **p != part).map(size).sum();
        from..from + size(&part)
    }

    /// Numbers of a part.
    pub fn of(&self, part: Part) -> &[f32] {
        &self.values[self.range(part)]
    }

    /// Numbers of a part, to be changed.
    pub fn of_mut(&mut self, part: Part) -> &mut [f32] {
        let range = self.range(part);
        &mut self.values[range]
    }

    /// A part as a matrix.
    pub fn matrix(&self, part: Part) -> ArrayView2<'_, f32> {
        ArrayView2::from_shape(part.size(&self.shape), self.of(part)).expect("of its size")
    }

    /// Without what names phones.
    pub fn trained(mut self) -> Self {
        let end = self.range(Part::Phone).start;
        self.values.truncate(end);
        self.shape.phones = 0;
        self
    }

    /// One step from `drive` = W_g z + b_g `[3K]` and h before it.
    pub fn step(&self, drive: &[f32], before: &[f32]) -> Cell {
        let k = self.shape.memory;
        let (again, bias) = (self.of(Part::Again), self.of(Part::AgainBias));
        let sum = |row: usize| dot(&again[row * k..(row + 1) * k], before) + bias[row];
        let logistic = |x: f32| 1.0 / (1.0 + (-x).exp());
        let mut gates = vec![0.0; 3 * k];
        for row in 0..2 * k {
            gates[row] = logistic(drive[row] + sum(row));
        }
        let news: Vec<f32> = (0..k).map(|i| sum(2 * k + i)).collect();
        let memory = (0..k)
            .map(|i| {
                let new = (drive[2 * k + i] + gates[i] * news[i]).tanh();
                gates[2 * k + i] = new;
                new + gates[k + i] * (before[i] - new)
            })
            .collect();
        Cell {
            gates,
            again: news,
            memory,
        }
    }

    /// ĝ `[D]` that `memory` says in the frame of a step (`after` 0) or in the frame after (1).
    pub fn said(&self, memory: &[f32], after: usize) -> Vec<f32> {
        let (weights, bias) = Self::speaks(after);
        let k = self.shape.memory;
        let rows = self.of(weights).chunks_exact(k);
        rows.zip(self.of(bias))
            .map(|(row, b)| dot(row, memory) + b)
            .collect()
    }

    /// Which parts speak in the frame of a step (0) or in the frame after (1).
    pub fn speaks(after: usize) -> (Part, Part) {
        match after {
            0 => (Part::Output, Part::OutputBias),
            _ => (Part::Later, Part::LaterBias),
        }
    }

    /// Puts it into a model file.
    pub(super) fn store(&self, out: &mut TensorsBuilder) -> Result<()> {
        out.note("gated.share", self.share);
        for part in PARTS {
            let view = self.matrix(part);
            if view.is_empty() {
                continue;
            }
            match part.is_matrix() {
                true => out.put(part.name(), &view),
                false => out.put(part.name(), &view.index_axis(Axis(1), 0)),
            }
        }
        Ok(())
    }

    /// The second memory in a model file that hears `inputs` numbers and says `outputs`; `None` where there is none.
    ///
    /// # Errors
    ///
    /// That a tensor is missing or has another shape.
    pub(super) fn from_tensors(from: &Tensors, inputs: usize, outputs: usize) -> Result<Option<Self>> {
        let Ok(share) = from.noted::<f32>("gated.share") else {
            return Ok(None);
        };
        if !(share > 0.0 && share < 1.0) {
            bail!(
                File,
                "the second memory's share of the mouth is {share}, expected more than 0 and less than 1"
            );
        }
        let first: ndarray::Array1<f32> = from.array(Part::First.name())?;
        let shape = GatedShape {
            inputs,
            memory: first.len(),
            outputs,
            phones: 0,
        };
        let mut gated = Self::zeros(shape);
        gated.share = share;
        for part in PARTS {
            let want = part.size(&shape);
            if want.0 * want.1 == 0 {
                continue;
            }
            let have: ndarray::Array2<f32> = match part.is_matrix() {
                true => from.array(part.name())?,
                false => from.array::<ndarray::Ix1>(part.name())?.insert_axis(Axis(1)),
            };
            if have.dim() != want {
                bail!(
                    File,
                    "tensor {} has shape {:?}, expected {want:?}",
                    part.name(),
                    have.dim()
                );
            }
            gated
                .of_mut(part)
                .iter_mut()
                .zip(&have)
                .for_each(|(to, from)| *to = *from);
        }
        Ok(Some(gated))
    }
}
