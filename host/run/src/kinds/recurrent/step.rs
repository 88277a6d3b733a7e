//! One frame of the model: emissions, the HMM's step, maps and memory (M4-M9). What training, batches and live streams
//! share.
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
use super::chain::{Chain, SLOTS, Scratch, VISUAL, Visual, axpy, dot};
use super::parameters::{Feedback, Group, Parameters, Shape, sigmoid};
use crate::hmm::joint::N_EMITTING;
use crate::hmm::mixtures::Mixtures;

/// Natural log below the best emission of a chain.
pub const FLOOR: f32 = 30.0;
/// Probabilities below this are 0 after a frame: a beam of 40 bits.
const SMALLEST: f32 = 1e-12;
/// Parameters laid out for the recursion: probabilities and rates instead of logits.
pub struct Net<'a> {
    /// The parameters as they were learnt.
    pub p: &'a Parameters,
    /// The HMM, with the parameters' transitions.
    pub chain: Chain,
    /// Λ, `[states of its chain, H]`.
    pub rates: Vec<f32>,
    /// Probability of the first phone, `[P]`.
    pub initial: Vec<f32>,
    /// Probabilities of the joint states that a clip begins with, by slots `[SLOTS·stride]`.
    pub first_alpha: Vec<f32>,
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

    /// Row of Λ of one state of the chain that owns the rates, `[H]`.
    pub fn rate_row(&self, state: usize) -> &[f32] {
        let h = self.p.shape.memory;
        &self.rates[state * h..(state + 1) * h]
    }
}

/// The group of the rates: that of the chain that owns them.
pub fn rate_group(shape: &Shape) -> Group {
    if shape.rates.audio() {
        Group::AudioRate
    } else {
        Group::VisualRate
    }
}

/// Logits to probabilities, which sum to 1.
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

/// Tables that one chain's states own.
pub struct Tables {
    /// Gains G.
    pub gain: Group,
    /// Drives R.
    pub drive: Group,
    /// Offsets B.
    pub offset: Group,
    /// Logits of the rates Λ.
    pub rate: Group,
}

impl Tables {
    /// Tables of the phone states.
    pub const AUDIO: Tables = Tables {
        gain: Group::AudioGain,
        drive: Group::AudioDrive,
        offset: Group::AudioOffset,
        rate: Group::AudioRate,
    };
    /// Tables of the viseme states.
    pub const VISUAL: Tables = Tables {
        gain: Group::VisualGain,
        drive: Group::VisualDrive,
        offset: Group::VisualOffset,
        rate: Group::VisualRate,
    };

    /// Whether this chain's states own gains, drives and offsets.
    pub fn has_maps(&self, shape: &Shape) -> bool {
        match self.gain {
            Group::AudioGain => shape.maps.audio(),
            _ => shape.maps.visual(),
        }
    }
}

/// One frame's places for (M7)-(M9).
pub struct Speak<'a> {
    /// w_t, `[H]`.
    pub gain: &'a mut [f32],
    /// λ_t, `[H]`.
    pub rate: &'a mut [f32],
    /// What the memory moves towards, V_d z_t∘w_t + r_t, `[H]`.
    pub target: &'a mut [f32],
    /// h_t, `[H]`.
    pub memory: &'a mut [f32],
    /// Holds W₀z + b₀ at first.
    pub output: &'a mut [f32],
}

impl Speak<'_> {
    /// (M7)-(M9) of one frame from γᵃ (`audio`), γᵛ (`visual`), V_d z_t (`drive`) and h_{t−1} (`last`). `mask` multiplies the
    /// memory that O reads; empty: none.
    pub fn step(
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
pub struct Room {
    /// Room for the HMM's step.
    pub scratch: Scratch,
    /// Visual emissions of each phone's own viseme, `[5][stride]`.
    pub own: Vec<f32>,
    /// Sums over joint states, by audio and then by own visual state, `[2][5][stride]`.
    pub sums: Vec<f32>,
    /// ℓᵛ, `[65]`.
    pub visual_logs: Vec<f32>,
    /// Gradient by ℓᵛ, `[65]`.
    pub g_visual_logs: Vec<f32>,
    /// What the mouth feeds back, of [`Shape::fed_back`] numbers.
    pub fed: Vec<f32>,
    /// Gradient by `fed`.
    pub g_fed: Vec<f32>,
    /// Gradient by the memory that O reads, `[H]`.
    pub h: Vec<f32>,
    /// The memory that O reads, times its mask, `[H]`.
    pub fed_h: Vec<f32>,
}

impl Room {
    /// Buffers of the size that `net` needs.
    pub fn new(net: &Net) -> Self {
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

    /// Fills `fed` from the last output `y` or the last memory `h`, times `mask` (1 beyond its end).
    pub fn fed_back(&mut self, what: Feedback, y: &[f32], h: &[f32], mask: &[f32]) {
        let from = match what {
            Feedback::None => return,
            Feedback::Output => y,
            Feedback::Memory => h,
        };
        for (i, (to, from)) in self.fed.iter_mut().zip(from).enumerate() {
            *to = from * mask.get(i).copied().unwrap_or(1.0);
        }
    }
}

/// ℓᵛ = F·fed + f.
pub fn visual_logs(net: &Net, fed: &[f32], out: &mut [f32]) {
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
pub fn emissions_audio(net: &Net, logs: &[f32], out: &mut [f32]) {
    let max = logs.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let stride = net.chain.stride;
    for (p, of_phone) in logs.chunks_exact(N_EMITTING).enumerate() {
        for (i, log) in of_phone.iter().enumerate() {
            out[i * stride + p] = (log - max).max(-FLOOR).exp();
        }
    }
}

/// exp(ℓ − max) of the visual states, floored.
pub fn emissions_visual(logs: &[f32], out: &mut [f32]) {
    let max = logs.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for (out, log) in out.iter_mut().zip(logs) {
        *out = (log - max).max(-FLOOR).exp();
    }
}

/// Emissions of each phone's own viseme `[5][stride]`.
pub fn own(chain: &Chain, visual: &[f32], out: &mut [f32]) {
    for (p, &atom) in chain.atom.iter().enumerate() {
        for j in 0..N_EMITTING {
            out[j * chain.stride + p] = visual[N_EMITTING * atom + j];
        }
    }
}

/// (M5): π to α in place; the sum is divided into the audio emissions, so that α = π·eᵃ·eᵛ.
pub fn observe(chain: &Chain, alpha: &mut [f32], audio: &mut [f32], visual: &[f32], room: &mut [f32]) {
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
pub fn marginals(chain: &Chain, alpha: &[f32], audio: &mut [f32], visual: &mut [f32], room: &mut Room) {
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
