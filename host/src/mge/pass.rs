//! One clip through the model and back: the recursion and its reverse pass.
//!
//! With z_t = V(c_t − c̄), joint states q = (a, v) and the last output ŷ_{t−1}:
//! ```text
//! ℓᵃ_t = U z_t + b,   ℓᵛ_t = F ŷ_{t−1} + f                                                    (M4)
//! π_t  = Aᵀ α_{t−1}  (M3)
//! α_t(a, v) ∝ π_t(a, v)·exp(ℓᵃ_t(a) + ℓᵛ_t(v)),   Σ α_t = 1                                   (M5)
//! γᵃ_t(a) = Σ_v α_t(a, v),   γᵛ_t(v) = Σ_a α_t(a, v)                                          (M6)
//! w_t = Gᵃᵀγᵃ_t + Gᵛᵀγᵛ_t,  r_t = Rᵃᵀγᵃ_t + Rᵛᵀγᵛ_t,  λ_t = Λᵀγ_t                              (M7)
//! h_t = h_{t−1} + λ_t∘(V_d z_t∘w_t + r_t − h_{t−1})                                           (M8)
//! ŷ_t = W₀z_t + b₀ + Bᵃᵀγᵃ_t + Bᵛᵀγᵛ_t + O h_t                                                 (M9)
//! ```
//! Log emissions more than [`FLOOR`] below the best of their chain count as that; the reverse pass ignores the floor.
use ndarray::{Array2, Axis};

use super::chain::{Chain, ROWS, SLOTS, Scratch, VISUAL, Visual, axpy, dot};
use super::parameters::{Feedback, Group, Parameters, Shape, sigmoid};
use crate::model::{Mixtures, N_EMITTING};

/// Natural log below the best emission of a chain.
pub const FLOOR: f32 = 30.0;
/// Probabilities below this are 0 in the forward step.
const SMALLEST: f32 = 1e-25;
/// Added to an occupancy before its logarithm is taken.
const LOG_GUARD: f32 = 1e-5;

/// Parameters laid out for the recursion: probabilities and rates instead of logits.
pub struct Net<'a> {
    pub p: &'a Parameters,
    pub chain: Chain,
    /// Λ, `[states of its chain, H]`.
    rates: Vec<f32>,
    initial: Vec<f32>,
    pub(super) first_alpha: Vec<f32>,
    /// Occupancies up to this are left out of (M7) and (M9).
    pub least: f32,
}

impl<'a> Net<'a> {
    /// `chain` gives the phones and the bigram; its transitions are replaced by the parameters'.
    pub fn new(p: &'a Parameters, chain: &Chain, least: f32) -> Self {
        let mut chain = chain.clone();
        chain.set_transitions(&log_softmax_rows(p.of(Group::Transition)));
        let rates = rate_group(&p.shape);
        let rates = p.of(rates).iter().map(|x| sigmoid(*x)).collect();
        let initial = softmax(p.of(Group::Initial));
        let mut first_alpha = vec![0.0; chain.states()];
        chain.first(&initial, &mut first_alpha);
        Net {
            p,
            chain,
            rates,
            initial,
            first_alpha,
            least,
        }
    }

    fn rate_row(&self, state: usize) -> &[f32] {
        let h = self.p.shape.memory;
        &self.rates[state * h..(state + 1) * h]
    }
}

pub fn rate_group(shape: &Shape) -> Group {
    if shape.rates.audio() {
        Group::AudioRate
    } else {
        Group::VisualRate
    }
}

pub fn softmax(logits: &[f32]) -> Vec<f32> {
    let max = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let e: Vec<f32> = logits.iter().map(|l| (l - max).exp()).collect();
    let sum: f32 = e.iter().sum();
    e.iter().map(|v| v / sum).collect()
}

/// Rows of four logits to log probabilities; impossible choices stay impossible.
pub fn log_softmax_rows(logits: &[f32]) -> Vec<f32> {
    let mut out = logits.to_vec();
    for row in out.chunks_exact_mut(4) {
        let max = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let sum: f32 = row.iter().map(|l| (l - max).exp()).sum();
        let log = max + sum.ln();
        for l in row {
            if *l > Mixtures::NO_WEIGHT / 2.0 {
                *l -= log;
            }
        }
    }
    out
}

/// What a clip shows the model.
#[derive(Clone, Debug, Default)]
pub struct Masks {
    /// Factor of every memory number on its way to the mouth; empty: 1.
    pub output: Vec<f32>,
    /// Factor of every number that is fed back; empty: 1.
    pub feedback: Vec<f32>,
}

/// Everything that the reverse pass needs again.
pub struct Tape {
    pub frames: usize,
    /// Contexts without their mean `[T, C]`.
    context: Array2<f32>,
    z: Array2<f32>,
    drive: Array2<f32>,
    /// α `[T, SLOTS·stride]`.
    alpha: Vec<f32>,
    /// Emissions `[T, 5·stride]` (slot-wise) and `[T, 65]`, already divided by the frame's sum.
    audio_emission: Vec<f32>,
    visual_emission: Vec<f32>,
    /// γ `[T, 5P]`, `[T, 65]`.
    pub audio: Array2<f32>,
    pub visual: Array2<f32>,
    gain: Array2<f32>,
    rate: Array2<f32>,
    /// d∘w + r.
    target: Array2<f32>,
    pub memory: Array2<f32>,
    /// ŷ `[T, D]`, standardised.
    pub output: Array2<f32>,
    masks: Masks,
}

impl Tape {
    /// Follows a clip's contexts `[T, C]`, their mean taken off.
    pub fn forward(net: &Net, context: Array2<f32>, masks: Masks) -> Tape {
        let shape = &net.p.shape;
        let frames = context.nrows();
        let (h, d, a) = (shape.memory, shape.outputs, shape.audio_states());
        let z = context.dot(&net.p.matrix(Group::Projection).t());
        let logs = z.dot(&net.p.matrix(Group::Audio).t()) + &net.p.matrix(Group::AudioBias);
        let drive = z.dot(&net.p.matrix(Group::Drive).t());
        let output = z.dot(&net.p.matrix(Group::Global).t()) + &net.p.matrix(Group::GlobalBias);
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

    /// Adds the gradient of a loss to `gradient`: `g_output` `[T, D]` is the loss by ŷ, `targets` the states whose log
    /// occupancy the loss holds with the negative weights `weights` (audio, visual).
    pub fn reverse(
        &self,
        net: &Net,
        g_output: &Array2<f32>,
        targets: Option<&[(usize, usize)]>,
        weights: (f32, f32),
        gradient: &mut Parameters,
    ) {
        let shape = &net.p.shape;
        let (h, d, a) = (shape.memory, shape.outputs, shape.audio_states());
        let stride = net.chain.stride;
        let states = net.chain.states();
        let frames = self.frames;
        let mut g_logs = Array2::<f32>::zeros((frames, a));
        let mut g_drive = Array2::<f32>::zeros((frames, h));
        let mut g_out = g_output.clone();
        let mut room = Room::new(net);
        let mut g_alpha = vec![0.0f32; states];
        let mut g_pi = vec![0.0f32; states];
        let mut g_transition = vec![0.0f32; ROWS * stride];
        let mut g_rates = vec![0.0f32; net.rates.len()];
        // What later frames say about this frame's h, output and α.
        let mut from_h = vec![0.0f32; h];
        let mut from_y = vec![0.0f32; d];
        let first_h = net.p.of(Group::FirstMemory);
        let (mut gh, mut gw, mut gr, mut gl) = (vec![0.0; h], vec![0.0; h], vec![0.0; h], vec![0.0; h]);
        let (mut g_audio, mut g_visual) = (vec![0.0f32; a], vec![0.0f32; VISUAL]);
        let rates = rate_group(shape);
        for t in (0..frames).rev() {
            let gy = {
                let row = g_out.row_mut(t).into_slice().expect("standard layout");
                row.iter_mut().zip(&from_y).for_each(|(g, f)| *g += f);
                &*row
            };
            let memory = row(&self.memory, t);
            let before = if t > 0 { row(&self.memory, t - 1) } else { first_h };
            // (M9) through O.
            gh.copy_from_slice(&from_h);
            room.h.fill(0.0);
            for (i, g) in gy.iter().enumerate() {
                axpy(*g, net.p.row(Group::Output, i), &mut room.h);
            }
            for i in 0..h {
                let mask = self.masks.output.get(i).copied().unwrap_or(1.0);
                gh[i] += room.h[i] * mask;
                room.fed_h[i] = memory[i] * mask;
            }
            for (i, g) in gy.iter().enumerate() {
                axpy(*g, &room.fed_h, gradient.row_mut(Group::Output, i));
            }
            // (M8).
            let (rate, target) = (row(&self.rate, t), row(&self.target, t));
            let (drive, gain) = (row(&self.drive, t), row(&self.gain, t));
            let gd = g_drive.row_mut(t).into_slice().expect("standard layout");
            for i in 0..h {
                gl[i] = gh[i] * (target[i] - before[i]);
                gr[i] = gh[i] * rate[i];
                gw[i] = gr[i] * drive[i];
                gd[i] = gr[i] * gain[i];
                from_h[i] = gh[i] * (1.0 - rate[i]);
            }
            // (M7), (M9): tables and occupancies.
            for (of, g_of, tables) in [
                (row(&self.audio, t), &mut g_audio, Tables::AUDIO),
                (row(&self.visual, t), &mut g_visual, Tables::VISUAL),
            ] {
                g_of.fill(0.0);
                let maps = tables.has_maps(shape);
                let has_rates = rates == tables.rate;
                for (s, &gamma) in of.iter().enumerate() {
                    if gamma <= net.least {
                        continue;
                    }
                    let mut g = 0.0;
                    if maps {
                        g += dot(net.p.row(tables.gain, s), &gw) + dot(net.p.row(tables.drive, s), &gr);
                        g += dot(net.p.row(tables.offset, s), gy);
                        axpy(gamma, &gw, gradient.row_mut(tables.gain, s));
                        axpy(gamma, &gr, gradient.row_mut(tables.drive, s));
                        axpy(gamma, gy, gradient.row_mut(tables.offset, s));
                    }
                    if has_rates {
                        g += dot(net.rate_row(s), &gl);
                        axpy(gamma, &gl, &mut g_rates[s * h..(s + 1) * h]);
                    }
                    g_of[s] = g;
                }
            }
            if let Some(targets) = targets {
                let (ta, tv) = targets[t];
                g_audio[ta] -= weights.0 / (self.audio[[t, ta]] + LOG_GUARD);
                g_visual[tv] -= weights.1 / (self.visual[[t, tv]] + LOG_GUARD);
            }
            // (M6), (M5): g_alpha holds what later frames say, or nothing in the last one.
            let alpha = &self.alpha[t * states..][..states];
            let audio_emission = &self.audio_emission[t * N_EMITTING * stride..][..N_EMITTING * stride];
            let visual_emission = &self.visual_emission[t * VISUAL..][..VISUAL];
            let g_log = g_logs.row_mut(t).into_slice().expect("standard layout");
            room.spread(&net.chain, &g_audio, &g_visual, &mut g_alpha);
            let mean = dot(alpha, &g_alpha);
            g_alpha.iter_mut().for_each(|g| *g -= mean);
            room.through_emissions(&net.chain, alpha, &g_alpha, g_log);
            own(&net.chain, visual_emission, &mut room.own);
            net.chain.for_slots(|k, i, visual| {
                let at = k * stride;
                let e = &audio_emission[i * stride..(i + 1) * stride];
                let g = &g_alpha[at..at + stride];
                let out = &mut g_pi[at..at + stride];
                match visual {
                    Visual::Own(j) => {
                        let v = &room.own[j * stride..(j + 1) * stride];
                        for p in 0..stride {
                            out[p] = g[p] * e[p] * v[p];
                        }
                    }
                    Visual::State(v) => {
                        let v = visual_emission[v];
                        for p in 0..stride {
                            out[p] = g[p] * e[p] * v;
                        }
                    }
                }
            });
            // (M4) into what was fed back.
            let zero;
            let last_y = if t > 0 {
                row(&self.output, t - 1)
            } else {
                zero = vec![0.0; d];
                &zero
            };
            room.fed_back(shape.feedback, last_y, before, &self.masks.feedback);
            room.g_fed.fill(0.0);
            axpy(1.0, &room.g_visual_logs, gradient.of_mut(Group::VisualBias));
            for v in 0..VISUAL {
                let g = room.g_visual_logs[v];
                if g != 0.0 && !room.fed.is_empty() {
                    axpy(g, &room.fed, gradient.row_mut(Group::Visual, v));
                    axpy(g, net.p.row(Group::Visual, v), &mut room.g_fed);
                }
            }
            for (i, g) in room.g_fed.iter_mut().enumerate() {
                *g *= self.masks.feedback.get(i).copied().unwrap_or(1.0);
            }
            from_y.fill(0.0);
            match shape.feedback {
                Feedback::None => {}
                Feedback::Output => from_y.copy_from_slice(&room.g_fed),
                Feedback::Memory => axpy(1.0, &room.g_fed, &mut from_h),
            }
            if t > 0 {
                let before = &self.alpha[(t - 1) * states..][..states];
                net.chain
                    .transposed(before, &g_pi, &mut g_alpha, &mut g_transition, &mut room.scratch);
            } else {
                let mut g_initial = vec![0.0; stride];
                net.chain.first_transposed(&g_pi, &mut g_initial);
                let p = &net.initial;
                let mean: f32 = p.iter().zip(&g_initial).map(|(p, g)| p * g).sum();
                for (i, g) in gradient.of_mut(Group::Initial).iter_mut().enumerate() {
                    *g += p[i] * (g_initial[i] - mean);
                }
                axpy(1.0, &from_h, gradient.of_mut(Group::FirstMemory));
            }
        }
        for ((g, g_rate), rate) in gradient.of_mut(rates).iter_mut().zip(&g_rates).zip(&net.rates) {
            *g += g_rate * rate * (1.0 - rate);
        }
        self.transitions(net, &g_transition, gradient);
        self.matrices(net, &g_logs, &g_drive, &g_out, gradient);
    }

    /// Logits of the transitions from the gradient by their probabilities.
    fn transitions(&self, net: &Net, g: &[f32], gradient: &mut Parameters) {
        let stride = net.chain.stride;
        let logs = log_softmax_rows(net.p.of(Group::Transition));
        let out = gradient.of_mut(Group::Transition);
        for phone in 0..net.chain.phones {
            for class in 0..ROWS / 4 {
                let at = phone * ROWS + 4 * class;
                let p: Vec<f32> = (0..4)
                    .map(|c| match logs[at + c] {
                        l if l > Mixtures::NO_WEIGHT / 2.0 => l.exp(),
                        _ => 0.0,
                    })
                    .collect();
                let by: Vec<f32> = (0..4).map(|c| g[(4 * class + c) * stride + phone]).collect();
                let mean = dot(&p, &by);
                for c in 0..4 {
                    out[at + c] += p[c] * (by[c] - mean);
                }
            }
        }
    }

    /// The matrices outside of the recursion, over all frames at once.
    fn matrices(
        &self,
        net: &Net,
        g_logs: &Array2<f32>,
        g_drive: &Array2<f32>,
        g_out: &Array2<f32>,
        gradient: &mut Parameters,
    ) {
        let mut g_z = Array2::<f32>::zeros(self.z.dim());
        for (group, g) in [
            (Group::Audio, g_logs),
            (Group::Drive, g_drive),
            (Group::Global, g_out),
        ] {
            gradient.add(group, &g.t().dot(&self.z));
            g_z += &g.dot(&net.p.matrix(group));
        }
        let sum = |g: &Array2<f32>| g.sum_axis(Axis(0)).insert_axis(Axis(0));
        gradient.add(Group::AudioBias, &sum(g_logs));
        gradient.add(Group::GlobalBias, &sum(g_out));
        gradient.add(Group::Projection, &g_z.t().dot(&self.context));
    }
}

/// −Σ_t (w_a·ln γᵃ(target) + w_v·ln γᵛ(target)), as [`Tape::reverse`] sees it.
pub fn cross_entropy(tape: &Tape, targets: &[(usize, usize)], weights: (f32, f32)) -> f64 {
    let of = |gamma: f32| f64::from((gamma + LOG_GUARD).ln());
    targets
        .iter()
        .enumerate()
        .map(|(t, &(a, v))| {
            -f64::from(weights.0) * of(tape.audio[[t, a]]) - f64::from(weights.1) * of(tape.visual[[t, v]])
        })
        .sum()
}

fn row(m: &Array2<f32>, t: usize) -> &[f32] {
    let n = m.ncols();
    &m.as_slice().expect("standard layout")[t * n..(t + 1) * n]
}

/// Tables that one chain's states own.
struct Tables {
    gain: Group,
    drive: Group,
    offset: Group,
    rate: Group,
}

impl Tables {
    const AUDIO: Tables = Tables {
        gain: Group::AudioGain,
        drive: Group::AudioDrive,
        offset: Group::AudioOffset,
        rate: Group::AudioRate,
    };
    const VISUAL: Tables = Tables {
        gain: Group::VisualGain,
        drive: Group::VisualDrive,
        offset: Group::VisualOffset,
        rate: Group::VisualRate,
    };

    fn has_maps(&self, shape: &Shape) -> bool {
        match self.gain {
            Group::AudioGain => shape.maps.audio(),
            _ => shape.maps.visual(),
        }
    }
}

/// One frame's places for (M7)-(M9).
pub(super) struct Speak<'a> {
    pub(super) gain: &'a mut [f32],
    pub(super) rate: &'a mut [f32],
    pub(super) target: &'a mut [f32],
    pub(super) memory: &'a mut [f32],
    /// Holds W₀z + b₀ at first.
    pub(super) output: &'a mut [f32],
}

impl Speak<'_> {
    pub(super) fn step(
        &mut self,
        net: &Net,
        audio: &[f32],
        visual: &[f32],
        drive: &[f32],
        last: &[f32],
        mask: &[f32],
    ) {
        let shape = &net.p.shape;
        let rates = rate_group(shape);
        self.gain.fill(0.0);
        self.rate.fill(0.0);
        self.target.fill(0.0);
        for (of, tables) in [(audio, Tables::AUDIO), (visual, Tables::VISUAL)] {
            let maps = tables.has_maps(shape);
            let has_rates = rates == tables.rate;
            for (s, &gamma) in of.iter().enumerate() {
                if gamma <= net.least {
                    continue;
                }
                if maps {
                    axpy(gamma, net.p.row(tables.gain, s), self.gain);
                    axpy(gamma, net.p.row(tables.drive, s), self.target);
                    axpy(gamma, net.p.row(tables.offset, s), self.output);
                }
                if has_rates {
                    axpy(gamma, net.rate_row(s), self.rate);
                }
            }
        }
        for i in 0..drive.len() {
            self.target[i] += drive[i] * self.gain[i];
            self.memory[i] = last[i] + self.rate[i] * (self.target[i] - last[i]);
        }
        let masked: Vec<f32>;
        let memory: &[f32] = if mask.is_empty() {
            self.memory
        } else {
            masked = self.memory.iter().zip(mask).map(|(h, m)| h * m).collect();
            &masked
        };
        for (i, y) in self.output.iter_mut().enumerate() {
            *y += dot(net.p.row(Group::Output, i), memory);
        }
    }
}

/// Buffers of one pass.
pub(super) struct Room {
    scratch: Scratch,
    /// Visual emissions of each phone's own viseme, `[5][stride]`.
    pub(super) own: Vec<f32>,
    sums: Vec<f32>,
    pub(super) visual_logs: Vec<f32>,
    g_visual_logs: Vec<f32>,
    pub(super) fed: Vec<f32>,
    g_fed: Vec<f32>,
    h: Vec<f32>,
    fed_h: Vec<f32>,
}

impl Room {
    pub(super) fn new(net: &Net) -> Self {
        let wide = N_EMITTING * net.chain.stride;
        let shape = &net.p.shape;
        Room {
            scratch: net.chain.scratch(),
            own: vec![0.0; wide],
            sums: vec![0.0; 2 * wide],
            visual_logs: vec![0.0; VISUAL],
            g_visual_logs: vec![0.0; VISUAL],
            fed: vec![0.0; shape.fed_back()],
            g_fed: vec![0.0; shape.fed_back()],
            h: vec![0.0; shape.memory],
            fed_h: vec![0.0; shape.memory],
        }
    }

    pub(super) fn fed_back(&mut self, what: Feedback, y: &[f32], h: &[f32], mask: &[f32]) {
        let from = match what {
            Feedback::None => return,
            Feedback::Output => y,
            Feedback::Memory => h,
        };
        for (i, (to, from)) in self.fed.iter_mut().zip(from).enumerate() {
            *to = from * mask.get(i).copied().unwrap_or(1.0);
        }
    }

    /// g_α += the gradients of the marginals (transpose of M6).
    fn spread(&mut self, chain: &Chain, g_audio: &[f32], g_visual: &[f32], g_alpha: &mut [f32]) {
        let stride = chain.stride;
        let (audio, visual) = self.sums.split_at_mut(N_EMITTING * stride);
        for p in 0..chain.phones {
            for i in 0..N_EMITTING {
                audio[i * stride + p] = g_audio[N_EMITTING * p + i];
                visual[i * stride + p] = g_visual[N_EMITTING * chain.atom[p] + i];
            }
        }
        chain.for_slots(|k, i, v| {
            let g = &mut g_alpha[k * stride..(k + 1) * stride];
            axpy(1.0, &audio[i * stride..(i + 1) * stride], g);
            match v {
                Visual::Own(j) => axpy(1.0, &visual[j * stride..(j + 1) * stride], g),
                Visual::State(v) => g.iter_mut().for_each(|g| *g += g_visual[v]),
            }
        });
    }

    /// Gradients of the log emissions: Σ α·(g − ḡ) over the joint states of each.
    fn through_emissions(&mut self, chain: &Chain, alpha: &[f32], g: &[f32], g_audio: &mut [f32]) {
        let stride = chain.stride;
        self.sums.fill(0.0);
        let (audio, visual) = self.sums.split_at_mut(N_EMITTING * stride);
        let g_visual = &mut self.g_visual_logs;
        g_visual.fill(0.0);
        chain.for_slots(|k, i, v| {
            let (alpha, g) = (
                &alpha[k * stride..(k + 1) * stride],
                &g[k * stride..(k + 1) * stride],
            );
            let to = &mut audio[i * stride..(i + 1) * stride];
            match v {
                Visual::Own(j) => {
                    let own = &mut visual[j * stride..(j + 1) * stride];
                    for p in 0..stride {
                        let x = alpha[p] * g[p];
                        to[p] += x;
                        own[p] += x;
                    }
                }
                Visual::State(v) => {
                    for p in 0..stride {
                        to[p] += alpha[p] * g[p];
                    }
                    g_visual[v] += dot(alpha, g);
                }
            }
        });
        for p in 0..chain.phones {
            for i in 0..N_EMITTING {
                g_audio[N_EMITTING * p + i] = audio[i * stride + p];
                g_visual[N_EMITTING * chain.atom[p] + i] += visual[i * stride + p];
            }
        }
    }
}

/// ℓᵛ = F·fed + f.
pub(super) fn visual_logs(net: &Net, fed: &[f32], out: &mut [f32]) {
    for (v, (out, bias)) in out.iter_mut().zip(net.p.of(Group::VisualBias)).enumerate() {
        *out = bias
            + if fed.is_empty() {
                0.0
            } else {
                dot(net.p.row(Group::Visual, v), fed)
            };
    }
}

/// exp(ℓ − max), floored, laid out by slots `[5][stride]`.
pub(super) fn emissions_audio(net: &Net, logs: &[f32], out: &mut [f32]) {
    let max = logs.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let stride = net.chain.stride;
    for (p, of_phone) in logs.chunks_exact(N_EMITTING).enumerate() {
        for (i, log) in of_phone.iter().enumerate() {
            out[i * stride + p] = (log - max).max(-FLOOR).exp();
        }
    }
}

pub(super) fn emissions_visual(logs: &[f32], out: &mut [f32]) {
    let max = logs.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for (out, log) in out.iter_mut().zip(logs) {
        *out = (log - max).max(-FLOOR).exp();
    }
}

/// Emissions of each phone's own viseme `[5][stride]`.
fn own(chain: &Chain, visual: &[f32], out: &mut [f32]) {
    for (p, &atom) in chain.atom.iter().enumerate() {
        for j in 0..N_EMITTING {
            out[j * chain.stride + p] = visual[N_EMITTING * atom + j];
        }
    }
}

/// (M5): π to α in place; the sum is divided into the audio emissions, so that α = π·eᵃ·eᵛ.
pub(super) fn observe(chain: &Chain, alpha: &mut [f32], audio: &mut [f32], visual: &[f32], room: &mut [f32]) {
    let stride = chain.stride;
    own(chain, visual, room);
    chain.for_slots(|k, i, v| {
        let alpha = &mut alpha[k * stride..(k + 1) * stride];
        let e = &audio[i * stride..(i + 1) * stride];
        match v {
            Visual::Own(j) => {
                let v = &room[j * stride..(j + 1) * stride];
                for p in 0..stride {
                    alpha[p] *= e[p] * v[p];
                }
            }
            Visual::State(v) => {
                let v = visual[v];
                for p in 0..stride {
                    alpha[p] *= e[p] * v;
                }
            }
        }
    });
    let mut lanes = [0.0f32; 8];
    for chunk in alpha.chunks_exact(8) {
        for l in 0..8 {
            lanes[l] += chunk[l];
        }
    }
    let scale = 1.0 / lanes.iter().sum::<f32>();
    for a in alpha.iter_mut() {
        let scaled = *a * scale;
        *a = if scaled < SMALLEST { 0.0 } else { scaled };
    }
    audio.iter_mut().for_each(|e| *e *= scale);
}

/// (M6).
pub(super) fn marginals(
    chain: &Chain,
    alpha: &[f32],
    audio: &mut [f32],
    visual: &mut [f32],
    room: &mut Room,
) {
    debug_assert_eq!(alpha.len(), SLOTS * chain.stride);
    let stride = chain.stride;
    room.sums.fill(0.0);
    let (by_audio, by_own) = room.sums.split_at_mut(N_EMITTING * stride);
    visual.fill(0.0);
    chain.for_slots(|k, i, v| {
        let alpha = &alpha[k * stride..(k + 1) * stride];
        axpy(1.0, alpha, &mut by_audio[i * stride..(i + 1) * stride]);
        match v {
            Visual::Own(j) => axpy(1.0, alpha, &mut by_own[j * stride..(j + 1) * stride]),
            Visual::State(v) => visual[v] += alpha.iter().sum::<f32>(),
        }
    });
    for p in 0..chain.phones {
        for i in 0..N_EMITTING {
            audio[N_EMITTING * p + i] = by_audio[i * stride + p];
            visual[N_EMITTING * chain.atom[p] + i] += by_own[i * stride + p];
        }
    }
}
