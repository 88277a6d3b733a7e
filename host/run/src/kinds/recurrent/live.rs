//! Conversion one frame at a time: what a live stream does, without batches and without a reverse pass.
use lipstream_core::N_STATIC;
use ndarray::{Array2, ArrayView2, Axis};

use super::chain::{Scratch, VISUAL, axpy, dot};
use super::context::Window;
use super::gated::{Part, STRIDE};
use super::log_sums::{LogSums, Sums};
use super::model::RecurrentModel;
use super::parameters::{Feedback, Group};
use super::step::{Net, Room, Speak, emissions_audio, emissions_visual, marginals, observe, visual_logs};
use crate::hmm::joint::N_EMITTING;
use crate::phones::VISEMES;

/// What one frame of sound became.
#[derive(Clone, Debug)]
pub struct Spoken {
    /// Mouth parameters in the units of the visual features.
    pub parameters: Vec<f32>,
    /// γᵃ and γᵛ.
    pub audio: Vec<f32>,
    /// γᵛ: occupancies of the visual states, `[65]`.
    pub visual: Vec<f32>,
}

/// A model following one stream of normalised statics.
pub struct Live<'a> {
    model: &'a RecurrentModel,
    net: Net<'a>,
    window: Window,
    room: Room,
    alpha: Vec<f32>,
    next: Vec<f32>,
    scratch: Scratch,
    /// Adds probabilities as logarithms.
    sums: Option<LogSums>,
    memory: Vec<f32>,
    output: Vec<f32>,
    /// The second memory; empty where there is none.
    gated: Vec<f32>,
    /// Frames given.
    given: usize,
    started: bool,
    /// Frames of end that are still to be invented.
    left: usize,
}

impl<'a> Live<'a> {
    /// Waits for `ahead` frames of future, at most the model's look-ahead.
    pub fn new(model: &'a RecurrentModel, ahead: usize) -> Self {
        let shape = &model.parameters.shape;
        let net = Net::new(&model.parameters, &model.chain(), model.least);
        let room = Room::new(&net);
        let states = net.chain.states();
        Live {
            model,
            room,
            window: Window::new(shape.context.clone(), ahead),
            alpha: vec![0.0; states],
            next: vec![0.0; states],
            scratch: net.chain.scratch(),
            sums: None,
            memory: model.parameters.of(Group::FirstMemory).to_vec(),
            output: vec![0.0; shape.outputs],
            gated: model
                .gated
                .as_ref()
                .map_or_else(Vec::new, |gated| gated.of(Part::First).to_vec()),
            given: 0,
            started: false,
            left: ahead.min(shape.context.look_ahead()),
            net,
        }
    }

    /// The same with probabilities added as logarithms.
    pub fn with_sums(model: &'a RecurrentModel, ahead: usize, sums: Sums) -> Self {
        let mut live = Self::new(model, ahead);
        let (graph, probability) = model.phone_loop();
        live.sums = Some(LogSums::new(&live.net.chain, &graph, &probability, sums));
        live
    }

    /// Takes frame n's 13 statics; gives frame n − look-ahead.
    pub fn push(&mut self, statics: [f32; N_STATIC]) -> Option<Spoken> {
        let x = std::array::from_fn(|d| statics[d] * self.model.scale[d]);
        let ready = self.window.push(x);
        ready.then(|| self.step())
    }

    /// The frames that are still owed, one a call.
    pub fn finish(&mut self) -> Option<Spoken> {
        while self.left > 0 {
            self.left -= 1;
            if self.window.push_last() {
                return Some(self.step());
            }
        }
        None
    }

    fn step(&mut self) -> Spoken {
        let p = &self.model.parameters;
        let shape = &p.shape;
        let mut context = vec![0.0; shape.context.size()];
        self.window.read(&mut context);
        context
            .iter_mut()
            .zip(&self.model.context_mean)
            .for_each(|(c, m)| *c -= m);
        let apply = |group: Group, x: &[f32]| -> Vec<f32> {
            let (rows, _) = group.size(shape);
            (0..rows).map(|r| dot(p.row(group, r), x)).collect()
        };
        let z = apply(Group::Projection, &context);
        let mut logs = apply(Group::Audio, &z);
        axpy(1.0, p.of(Group::AudioBias), &mut logs);
        let drive = apply(Group::Drive, &z);
        let mut output = apply(Group::Global, &z);
        axpy(1.0, p.of(Group::GlobalBias), &mut output);

        let chain = &self.net.chain;
        if self.started {
            match &self.sums {
                None => chain.predict(&self.alpha, &mut self.next, &mut self.scratch),
                Some(sums) => sums.predict(&self.alpha, &mut self.next),
            }
            std::mem::swap(&mut self.alpha, &mut self.next);
        } else {
            self.alpha.copy_from_slice(&self.net.first_alpha);
            self.started = true;
        }
        self.room
            .fed_back(shape.feedback, &self.output, &self.memory, &[]);
        visual_logs(&self.net, &self.room.fed, &mut self.room.visual_logs);
        let mut audio_emission = vec![0.0; N_EMITTING * chain.stride];
        let mut visual_emission = vec![0.0; VISUAL];
        emissions_audio(&self.net, &logs, &mut audio_emission);
        emissions_visual(&self.room.visual_logs, &mut visual_emission);
        observe(
            chain,
            &mut self.alpha,
            &mut audio_emission,
            &visual_emission,
            &mut self.room.own,
        );
        let mut audio = vec![0.0; shape.audio_states()];
        let mut visual = vec![0.0; VISUAL];
        marginals(chain, &self.alpha, &mut audio, &mut visual, &mut self.room);
        let h = shape.memory;
        let (mut gain, mut rate, mut target) = (vec![0.0; h], vec![0.0; h], vec![0.0; h]);
        let mut memory = vec![0.0; h];
        Speak {
            gain: &mut gain,
            rate: &mut rate,
            target: &mut target,
            memory: &mut memory,
            output: &mut output,
        }
        .step(&self.net, &audio, &visual, &drive, &self.memory, &[]);
        self.memory = memory;
        let said = self.second(&z, &output);
        let parameters = said
            .iter()
            .zip(&self.model.deviation)
            .map(|(y, d)| y * d)
            .collect();
        if shape.feedback == Feedback::Output {
            self.output.copy_from_slice(&output);
        }
        Spoken {
            parameters,
            audio,
            visual,
        }
    }
}

impl Live<'_> {
    /// The mean of what the first memory has `said` and what the second says to `z`.
    fn second(&mut self, z: &[f32], said: &[f32]) -> Vec<f32> {
        let Some(gated) = &self.model.gated else {
            return said.to_vec();
        };
        let after = self.given % STRIDE;
        self.given += 1;
        if after == 0 {
            let rows = gated.of(Part::Input).chunks_exact(gated.shape.inputs);
            let drive: Vec<f32> = rows
                .zip(gated.of(Part::InputBias))
                .map(|(row, b)| dot(row, z) + b)
                .collect();
            self.gated = gated.step(&drive, &self.gated).memory;
        }
        let second = gated.said(&self.gated, after);
        let mean = |(first, second): (&f32, f32)| first + gated.share * (second - first);
        said.iter().zip(second).map(mean).collect()
    }
}

/// What a whole sound became, one row a frame.
#[derive(Clone, Debug)]
pub struct Converted {
    /// `[frames, D]`, in the units of the visual features.
    pub parameters: Array2<f32>,
    /// γᵃ `[frames, 5P]` and γᵛ `[frames, 65]`.
    pub audio: Array2<f32>,
    /// γᵛ: occupancies of the visual states, `[frames, 65]`.
    pub visual: Array2<f32>,
    /// Occupancy of each viseme `[frames, 13]`.
    pub visemes: Array2<f32>,
}

/// Streams normalised statics `[frames, ≥ 13]` through the model, frame by frame, at its full look-ahead.
pub fn convert(model: &RecurrentModel, statics: ArrayView2<f32>) -> Converted {
    convert_within(model, statics, model.parameters.shape.context.look_ahead())
}

/// [`convert`] with `ahead` frames of future only.
pub fn convert_within(model: &RecurrentModel, statics: ArrayView2<f32>, ahead: usize) -> Converted {
    hear(model, statics, Live::new(model, ahead))
}

/// [`convert`] with probabilities added as logarithms.
pub fn convert_with_sums(model: &RecurrentModel, statics: ArrayView2<f32>, sums: Sums) -> Converted {
    let ahead = model.parameters.shape.context.look_ahead();
    hear(model, statics, Live::with_sums(model, ahead, sums))
}

fn hear(model: &RecurrentModel, statics: ArrayView2<f32>, mut live: Live) -> Converted {
    let shape = &model.parameters.shape;
    let frames = statics.nrows();
    let mut parameters = Array2::zeros((frames, shape.outputs));
    let mut audio = Array2::zeros((frames, shape.audio_states()));
    let mut visual = Array2::zeros((frames, VISUAL));
    let mut t = 0;
    let mut take = |spoken: Spoken| {
        for (row, from) in [
            (&mut parameters, &spoken.parameters),
            (&mut audio, &spoken.audio),
            (&mut visual, &spoken.visual),
        ] {
            row.row_mut(t)
                .iter_mut()
                .zip(from)
                .for_each(|(to, from)| *to = *from);
        }
        t += 1;
    };
    for row in statics.outer_iter() {
        if let Some(spoken) = live.push(std::array::from_fn(|d| row[d])) {
            take(spoken);
        }
    }
    while let Some(spoken) = live.finish() {
        take(spoken);
    }
    let by_viseme = visual
        .to_shape((frames, VISEMES.len(), N_EMITTING))
        .expect("five states of each viseme stand side by side")
        .sum_axis(Axis(2));
    Converted {
        parameters,
        audio,
        visual,
        visemes: by_viseme,
    }
}
