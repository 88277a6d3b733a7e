//! The floor of what is heard: a room's hiss of 8 LSB rms (−72 dBFS), in its mean, under every sound.
//!
//! ```text
//! E    = ln(Σ x² + 400·8²)
//! m[j] = m[j] + Σ_k W[j, k]·8·√(π/4 · Σ w²)·|1 − 0.97·exp(−2πik/512)|
//! ```
//!
//! A recording between digital zeros, a gated line and a quiet room are then one and the same rest, and the first hiss after zeros is a small step
//! where it was one of 12 nats. The second line adds to each mel channel what white noise of that level brings it on average, as a
//! number, so that silence stays still. HTK has no floor but 1 (`docs/frontend.md` says why we do), so this stage runs where the statics are
//! normalised and nowhere else.
use crate::FRAME_SAMPLES;
use crate::frontend::mel::N_MEL;
use crate::tables::floor::FLOOR;

/// Level of the hiss, LSB rms.
pub const LEVEL: u64 = 8;
/// What it adds to the energy of a window.
pub const ENERGY: u64 = LEVEL * LEVEL * FRAME_SAMPLES as u64;

/// Adds the hiss to channel sums in Q(16 + `fraction_bits`), `fraction_bits` ≤ 9: less than 2³² · 2⁹ more.
pub fn add(sums: &mut [u64; N_MEL], fraction_bits: u32) {
    // A product, which one UMLAL adds; a shift of 64 bits takes six instructions.
    let one = 1u32 << fraction_bits;
    for (sum, floor) in sums.iter_mut().zip(&FLOOR) {
        *sum += u64::from(*floor) * u64::from(one);
    }
}
