//! One clip through the model: the recursion over its frames, and everything that the reverse pass needs again.
use ndarray::Array2;

use lipstream::hmm::joint::N_EMITTING;
use lipstream::kinds::recurrent::chain::VISUAL;
use lipstream::kinds::recurrent::parameters::Group;
use lipstream::kinds::recurrent::step::{
    Net, Room, Speak, emissions_audio, emissions_visual, marginals, observe, visual_logs,
};

/// Added to an occupancy before its logarithm is taken.
const LOG_GUARD: f32 = 1e-5;

/// How much the cross-entropy towards the forced alignment counts, per frame (M10).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Entropy {
    /// Weight for the audio states.
    pub audio: f32,
    /// Weight for the visual states.
    pub visual: f32,
    /// Of phones and visemes instead of their states.
    pub atoms: bool,
}

impl Entropy {
    /// States that count for the target `state`.
    pub(super) fn counted(self, state: usize) -> std::ops::Range<usize> {
        if self.atoms {
            let first = state / N_EMITTING * N_EMITTING;
            first..first + N_EMITTING
        } else {
            state..state + 1
        }
    }

    /// Occupancy that the target has.
    pub(super) fn held(self, gamma: &[f32], state: usize) -> f32 {
        gamma[self.counted(state)].iter().sum::<f32>() + LOG_GUARD
    }
}

/// What is left out of a clip.
#[derive(Clone, Debug, Default)]
pub struct Masks {
    /// Factor of every memory number on its way to the mouth; empty: 1.
    pub output: Vec<f32>,
    /// Factor of every number that is fed back; empty: 1.
    pub feedback: Vec<f32>,
}

/// Everything that the reverse pass needs again.
pub struct Tape {
    /// Number of frames T.
    pub frames: usize,
    /// Contexts without their mean `[T, C]`.
    pub(super) context: Array2<f32>,
    pub(super) z: Array2<f32>,
    pub(super) drive: Array2<f32>,
    /// α `[T, SLOTS·stride]`.
    pub(super) alpha: Vec<f32>,
    /// Emissions `[T, 5·stride]` (slot-wise) and `[T, 65]`, already divided by the frame's sum.
    pub(super) audio_emission: Vec<f32>,
    pub(super) visual_emission: Vec<f32>,
    /// γ `[T, 5P]`, `[T, 65]`.
    pub audio: Array2<f32>,
    /// Occupancies of the visual states, `[T, 65]`.
    pub visual: Array2<f32>,
    pub(super) gain: Array2<f32>,
    pub(super) rate: Array2<f32>,
    /// d∘w + r.
    pub(super) target: Array2<f32>,
    /// The memory h after each frame, `[T, H]`.
    pub memory: Array2<f32>,
    /// ŷ `[T, D]`, standardised.
    pub output: Array2<f32>,
    pub(super) masks: Masks,
}

impl Tape {
    /// Follows a clip's contexts `[T, C]`, their mean taken off.
    pub fn forward(net: &Net, context: Array2<f32>, masks: Masks) -> Tape {
        let shape = &net.p.shape;
        let frames = context.nrows();
        let (h, d, a) = (shape.memory, shape.outputs, shape.audio_states());
        let z = context.dot(&net.p.matrix(Group::Projection).t());
        let logs = z.dot(&net.p.matrix(Group::Audio).t()) + net.p.matrix(Group::AudioBias);
        let drive = z.dot(&net.p.matrix(Group::Drive).t());
        let output = z.dot(&net.p.matrix(Group::Global).t()) + net.p.matrix(Group::GlobalBias);
        let stride = net.chain.stride;
        let states = net.chain.states();
        let mut tape = Tape {
            frames,
            context,
            z,
            drive,
            alpha: vec![0.0; frames * states],
            audio_emission: vec![0.0; frames * N_EMITTING * stride],
            visual_emission: vec![0.0; frames * VISUAL],
            audio: Array2::zeros((frames, a)),
            visual: Array2::zeros((frames, VISUAL)),
            gain: Array2::zeros((frames, h)),
            rate: Array2::zeros((frames, h)),
            target: Array2::zeros((frames, h)),
            memory: Array2::zeros((frames, h)),
            output,
            masks,
        };
        let mut room = Room::new(net);
        let mut last_h = net.p.of(Group::FirstMemory).to_vec();
        let mut last_y = vec![0.0; d];
        for t in 0..frames {
            let (before, now) = tape.alpha.split_at_mut(t * states);
            let alpha = &mut now[..states];
            if t == 0 {
                alpha.copy_from_slice(&net.first_alpha);
            } else {
                net.chain
                    .predict(&before[(t - 1) * states..], alpha, &mut room.scratch);
            }
            room.fed_back(shape.feedback, &last_y, &last_h, &tape.masks.feedback);
            visual_logs(net, &room.fed, &mut room.visual_logs);
            let audio_emission = &mut tape.audio_emission[t * N_EMITTING * stride..][..N_EMITTING * stride];
            let visual_emission = &mut tape.visual_emission[t * VISUAL..][..VISUAL];
            let row = logs.row(t);
            emissions_audio(net, row.as_slice().expect("standard layout"), audio_emission);
            emissions_visual(&room.visual_logs, visual_emission);
            observe(&net.chain, alpha, audio_emission, visual_emission, &mut room.own);
            let mut audio = tape.audio.row_mut(t);
            let mut visual = tape.visual.row_mut(t);
            marginals(
                &net.chain,
                alpha,
                audio.as_slice_mut().expect("standard layout"),
                visual.as_slice_mut().expect("standard layout"),
                &mut room,
            );
            let mut speak = Speak {
                gain: tape.gain.row_mut(t).into_slice().expect("standard layout"),
                rate: tape.rate.row_mut(t).into_slice().expect("standard layout"),
                target: tape.target.row_mut(t).into_slice().expect("standard layout"),
                memory: tape.memory.row_mut(t).into_slice().expect("standard layout"),
                output: tape.output.row_mut(t).into_slice().expect("standard layout"),
            };
            speak.step(
                net,
                tape.audio.row(t).as_slice().expect("standard layout"),
                tape.visual.row(t).as_slice().expect("standard layout"),
                tape.drive.row(t).as_slice().expect("standard layout"),
                &last_h,
                &tape.masks.output,
            );
            last_h.copy_from_slice(speak.memory);
            last_y.copy_from_slice(speak.output);
        }
        tape
    }
}

/// −Σ_t (κ_a·ln γᵃ(target) + κ_v·ln γᵛ(target)), as [`Tape::reverse`] sees it.
pub fn cross_entropy(tape: &Tape, targets: &[(usize, usize)], entropy: Entropy) -> f64 {
    targets
        .iter()
        .enumerate()
        .map(|(t, &(a, v))| {
            let audio = entropy.held(row(&tape.audio, t), a).ln();
            let visual = entropy.held(row(&tape.visual, t), v).ln();
            -f64::from(entropy.audio * audio) - f64::from(entropy.visual * visual)
        })
        .sum()
}

pub(super) fn row(m: &Array2<f32>, t: usize) -> &[f32] {
    let n = m.ncols();
    &m.as_slice().expect("standard layout")[t * n..(t + 1) * n]
}
