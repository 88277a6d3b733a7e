//! What minimum generation error training learns: one flat vector, cut into named matrices.
use ndarray::{Array2, ArrayView2};

use super::chain::{ROWS, VISUAL};
use super::context::Context;
use crate::hmm::joint::N_EMITTING;

/// What the mouth's last output feeds into the visual emissions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feedback {
    /// Nothing: the sound alone moves the states
    None,
    /// The last mouth parameters
    Output,
    /// The last memory
    Memory,
}

/// Which chain's states own tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gate {
    /// The phone states
    Audio,
    /// The viseme states
    Visual,
    /// Both
    Both,
}

impl Gate {
    /// Whether the phone states own tables.
    pub fn audio(self) -> bool {
        self != Gate::Visual
    }
    /// Whether the viseme states own tables.
    pub fn visual(self) -> bool {
        self != Gate::Audio
    }
}

/// Sizes and options; everything else follows from them.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Number of phones P.
    pub phones: usize,
    /// Which frames and means a frame's context is made of.
    pub context: Context,
    /// Numbers in z.
    pub inputs: usize,
    /// Numbers in the memory h.
    pub memory: usize,
    /// Mouth parameters.
    pub outputs: usize,
    /// What the mouth feeds back into the visual emissions.
    pub feedback: Feedback,
    /// Who owns the gains G, the drives R and the offsets B.
    pub maps: Gate,
    /// Who owns the rates Λ: one of the chains.
    pub rates: Gate,
}

impl Shape {
    /// Number of audio states, 5P.
    pub fn audio_states(&self) -> usize {
        N_EMITTING * self.phones
    }

    /// Numbers that the mouth feeds back.
    pub fn fed_back(&self) -> usize {
        match self.feedback {
            Feedback::None => 0,
            Feedback::Output => self.outputs,
            Feedback::Memory => self.memory,
        }
    }
}

/// The matrices, in the order in which they lie in the vector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// V `[Z, C]`: context to input.
    Projection,
    /// U `[5P, Z]`: emissions of the audio states.
    Audio,
    /// b `[5P]`.
    AudioBias,
    /// F `[65, D or H]`: emissions of the visual states from what is fed back.
    Visual,
    /// f `[65]`.
    VisualBias,
    /// V_d `[H, Z]`: what is to be remembered.
    Drive,
    /// W₀ `[D, Z]`: the global map.
    Global,
    /// b₀ `[D]`.
    GlobalBias,
    /// Gᵃ `[5P, H]` and Gᵛ `[65, H]`: gains.
    AudioGain,
    /// Gᵛ `[65, H]`: gains of the viseme states.
    VisualGain,
    /// Rᵃ, Rᵛ: drives.
    AudioDrive,
    /// Rᵛ `[65, H]`: drives of the viseme states.
    VisualDrive,
    /// Logits of Λᵃ or Λᵛ: rates.
    AudioRate,
    /// Logits of Λᵛ `[65, H]`: rates of the viseme states.
    VisualRate,
    /// Bᵃ `[5P, D]`, Bᵛ `[65, D]`: offsets.
    AudioOffset,
    /// Bᵛ `[65, D]`: offsets of the viseme states.
    VisualOffset,
    /// O `[D, H]`: memory to mouth.
    Output,
    /// h before the first frame `[H]`.
    FirstMemory,
    /// Logits of the first phone `[P]`.
    Initial,
    /// Logits of the transitions `[P, 60]`.
    Transition,
}

/// Every group, in the order in which they lie in the vector.
pub const GROUPS: [Group; 20] = [
    Group::Projection,
    Group::Audio,
    Group::AudioBias,
    Group::Visual,
    Group::VisualBias,
    Group::Drive,
    Group::Global,
    Group::GlobalBias,
    Group::AudioGain,
    Group::VisualGain,
    Group::AudioDrive,
    Group::VisualDrive,
    Group::AudioRate,
    Group::VisualRate,
    Group::AudioOffset,
    Group::VisualOffset,
    Group::Output,
    Group::FirstMemory,
    Group::Initial,
    Group::Transition,
];

impl Group {
    /// Name in the model file.
    pub fn name(self) -> &'static str {
        match self {
            Group::Projection => "projection",
            Group::Audio => "audio",
            Group::AudioBias => "audio_bias",
            Group::Visual => "visual",
            Group::VisualBias => "visual_bias",
            Group::Drive => "drive",
            Group::Global => "global",
            Group::GlobalBias => "global_bias",
            Group::AudioGain => "audio_gain",
            Group::VisualGain => "visual_gain",
            Group::AudioDrive => "audio_drive",
            Group::VisualDrive => "visual_drive",
            Group::AudioRate => "audio_rate",
            Group::VisualRate => "visual_rate",
            Group::AudioOffset => "audio_offset",
            Group::VisualOffset => "visual_offset",
            Group::Output => "output",
            Group::FirstMemory => "first_memory",
            Group::Initial => "initial",
            Group::Transition => "transition",
        }
    }

    /// Rows and columns; no rows where the shape does without.
    pub fn size(self, shape: &Shape) -> (usize, usize) {
        let (a, z, h, d) = (shape.audio_states(), shape.inputs, shape.memory, shape.outputs);
        let when = |has: bool, rows: usize| if has { rows } else { 0 };
        match self {
            Group::Projection => (z, shape.context.size()),
            Group::Audio => (a, z),
            Group::AudioBias => (1, a),
            Group::Visual => (VISUAL, shape.fed_back()),
            Group::VisualBias => (1, VISUAL),
            Group::Drive => (h, z),
            Group::Global => (d, z),
            Group::GlobalBias => (1, d),
            Group::AudioGain | Group::AudioDrive => (when(shape.maps.audio(), a), h),
            Group::VisualGain | Group::VisualDrive => (when(shape.maps.visual(), VISUAL), h),
            Group::AudioRate => (when(shape.rates.audio(), a), h),
            Group::VisualRate => (when(!shape.rates.audio(), VISUAL), h),
            Group::AudioOffset => (when(shape.maps.audio(), a), d),
            Group::VisualOffset => (when(shape.maps.visual(), VISUAL), d),
            Group::Output => (d, h),
            Group::FirstMemory => (1, h),
            Group::Initial => (1, shape.phones),
            Group::Transition => (shape.phones, ROWS),
        }
    }

    /// Learning rate as a multiple of the common one.
    pub fn rate(self) -> f32 {
        match self {
            Group::Projection => 0.2,
            Group::AudioGain | Group::VisualGain | Group::AudioRate | Group::VisualRate => 3.0,
            Group::AudioDrive | Group::VisualDrive => 2.0,
            _ => 1.0,
        }
    }

    /// Where decay pulls to, if it does.
    pub fn rest(self, shape: &Shape) -> Option<f32> {
        match self {
            Group::AudioGain => Some(1.0),
            Group::VisualGain => Some(if shape.maps.audio() { 0.0 } else { 1.0 }),
            Group::Output | Group::AudioOffset | Group::VisualOffset | Group::Drive | Group::Global => {
                Some(0.0)
            }
            _ => None,
        }
    }
}

/// A vector with its layout: parameters, a gradient, a mean of gradients.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Sizes and options that the layout follows from.
    pub shape: Shape,
    offsets: Vec<usize>,
    /// All groups one after the other, matrices row by row.
    pub values: Vec<f32>,
}

impl Parameters {
    /// All zeros, laid out for `shape`.
    pub fn zeros(shape: &Shape) -> Self {
        let mut offsets = vec![0];
        for group in GROUPS {
            let (rows, columns) = group.size(shape);
            offsets.push(offsets[offsets.len() - 1] + rows * columns);
        }
        let n = offsets[GROUPS.len()];
        Self {
            shape: shape.clone(),
            offsets,
            values: vec![0.0; n],
        }
    }

    fn range(&self, group: Group) -> std::ops::Range<usize> {
        let g = group as usize;
        self.offsets[g]..self.offsets[g + 1]
    }

    /// A group's numbers, row by row.
    pub fn of(&self, group: Group) -> &[f32] {
        &self.values[self.range(group)]
    }

    /// A group's numbers to be changed, row by row.
    pub fn of_mut(&mut self, group: Group) -> &mut [f32] {
        let range = self.range(group);
        &mut self.values[range]
    }

    /// A group as a matrix of the shape that [`Group::size`] says.
    pub fn matrix(&self, group: Group) -> ArrayView2<'_, f32> {
        ArrayView2::from_shape(group.size(&self.shape), self.of(group)).expect("the layout gives the shape")
    }

    /// Row `row` of a matrix.
    pub fn row(&self, group: Group, row: usize) -> &[f32] {
        let (_, columns) = group.size(&self.shape);
        let at = self.offsets[group as usize] + row * columns;
        &self.values[at..at + columns]
    }

    /// Row `row` of a matrix, to be changed.
    pub fn row_mut(&mut self, group: Group, row: usize) -> &mut [f32] {
        let (_, columns) = group.size(&self.shape);
        let at = self.offsets[group as usize] + row * columns;
        &mut self.values[at..at + columns]
    }

    /// Sets a group to `matrix`, which must have the group's shape.
    pub fn assign(&mut self, group: Group, matrix: &Array2<f32>) {
        assert_eq!(matrix.dim(), group.size(&self.shape), "{}", group.name());
        for (to, from) in self.of_mut(group).iter_mut().zip(matrix) {
            *to = *from;
        }
    }

    /// Adds `matrix`, which must have the group's shape, to a group.
    pub fn add(&mut self, group: Group, matrix: &Array2<f32>) {
        assert_eq!(matrix.dim(), group.size(&self.shape), "{}", group.name());
        for (to, from) in self.of_mut(group).iter_mut().zip(matrix) {
            *to += *from;
        }
    }

    /// Makes the vector at most `length` long; returns how long it was.
    pub fn cut(&mut self, length: f32) -> f32 {
        let square: f64 = self.values.iter().map(|g| f64::from(*g).powi(2)).sum();
        let was = square.sqrt() as f32;
        if was > length {
            let share = length / was;
            self.values.iter_mut().for_each(|g| *g *= share);
        }
        was
    }

    /// Numbers that a device's tables hold, without the transitions and the start.
    pub fn table_size(&self) -> usize {
        GROUPS
            .iter()
            .filter(|g| !matches!(g, Group::Initial | Group::FirstMemory))
            .map(|g| self.of(*g).len())
            .sum()
    }
}

/// The logistic function 1/(1 + e⁻ˣ), from logits to rates.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}
