//! The coupled HMM grown up: trained through its forward pass on the error of its own mouth (minimum generation error), with
//! a memory that its states gate. Live, in fixed point; the twin in floats is the host's `mge`.
//!
//! With c_t the context of frame t, α the forward variable over joint states (a, v) and ŷ the mouth:
//!
//! ```text
//! z_t = V c_t − b_z                                              [`context`]
//! α_t(a, v) ∝ (Aᵀα_{t−1})(a, v) · 2^(U_a z_t + b_a + F_v ŷ_{t−1} + f_v)   [`crate::hmm::follower`]
//! γᵃ, γᵛ: sums of α_t                                            [`occupancy`]
//! w = Σγ G,  r = Σγ R,  λ = Σγ Λ                                 [`memory`]
//! h_t = h_{t−1} + λ∘(V_d z_t ∘ w + r − h_{t−1})
//! ŷ_t = W₀ z_t + b₀ + Σγ B + O h_t
//! s_t = s_{t−1} + k_t·(ŷ_t − s_{t−1})                            [`settle`]
//! ```
//!
//! V is in i16, as its columns are strongly correlated; every other matrix in i8 ([`rows`]). Sums over states take the
//! largest occupancies only, see [`crate::hmm::gates`]. z, ŷ and what the output reads of h are Q5.10 in 16 bits; h
//! itself is Q15.16; log likelihoods are [`crate::logmath::LogProb`].
pub mod context;
pub mod memory;
pub mod occupancy;
pub mod rate;
pub mod rows;
pub mod settle;
