//! The reverse pass: the gradient of a loss by every parameter, through the recursion (M3-M9).
//!
//! With g the loss by α_t and ḡ = Σ α_t g, the gradient by a log emission is Σ α_t (g − ḡ) over its joint states, and the
//! gradient by π_t is (g − ḡ)·α_t / π_t.
use ndarray::{Array2, Axis};

use super::pass::{Entropy, Tape, row};
use lipstream::hmm::joint::N_EMITTING;
use lipstream::hmm::mixtures::Mixtures;
use lipstream::kinds::recurrent::chain::{Chain, ROWS, VISUAL, Visual, axpy, dot};
use lipstream::kinds::recurrent::parameters::{Feedback, Group, Parameters};
use lipstream::kinds::recurrent::step::{Net, Room, Tables, log_softmax_rows, own, rate_group};

impl Tape {
    /// Adds the gradient of a loss to `gradient`: `g_output` `[T, D]` is the loss by ŷ, `targets` the states of the
    /// forced alignment, which [`cross_entropy`](super::pass::cross_entropy) weighs with `entropy`.
    pub fn reverse(
        &self,
        net: &Net,
        g_output: &Array2<f32>,
        targets: Option<&[(usize, usize)]>,
        entropy: Entropy,
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
                let by = entropy.audio / entropy.held(row(&self.audio, t), ta);
                g_audio[entropy.counted(ta)].iter_mut().for_each(|g| *g -= by);
                let by = entropy.visual / entropy.held(row(&self.visual, t), tv);
                g_visual[entropy.counted(tv)].iter_mut().for_each(|g| *g -= by);
            }
            // (M6), (M5): g_alpha holds what later frames say, or nothing in the last one.
            let alpha = &self.alpha[t * states..][..states];
            let audio_emission = &self.audio_emission[t * N_EMITTING * stride..][..N_EMITTING * stride];
            let visual_emission = &self.visual_emission[t * VISUAL..][..VISUAL];
            let g_log = g_logs.row_mut(t).into_slice().expect("standard layout");
            spread(&mut room, &net.chain, &g_audio, &g_visual, &mut g_alpha);
            let mean = dot(alpha, &g_alpha);
            for (g, alpha) in g_alpha.iter_mut().zip(alpha) {
                // A state that fell out of the beam is moved by nothing.
                *g = if *alpha > 0.0 { *g - mean } else { 0.0 };
            }
            through_emissions(&mut room, &net.chain, alpha, &g_alpha, g_log);
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

/// g_α += the gradients of the marginals (transpose of M6).
fn spread(room: &mut Room, chain: &Chain, g_audio: &[f32], g_visual: &[f32], g_alpha: &mut [f32]) {
    let stride = chain.stride;
    let (audio, visual) = room.sums.split_at_mut(N_EMITTING * stride);
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
fn through_emissions(room: &mut Room, chain: &Chain, alpha: &[f32], g: &[f32], g_audio: &mut [f32]) {
    let stride = chain.stride;
    room.sums.fill(0.0);
    let (audio, visual) = room.sums.split_at_mut(N_EMITTING * stride);
    let g_visual = &mut room.g_visual_logs;
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
