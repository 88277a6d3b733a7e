//! Random numbers of a normal distribution, by Box and Muller from two even ones.
//!
//! A crate would draw them otherwise. The shipped model's training depends on these very sequences: where it starts, what
//! is added to its clips, how they are disturbed. Another method, another order of the two draws or another lower bound
//! would make another model from the same seed.
use rand::{Rng, RngExt, SeedableRng as _};
use rand_pcg::Pcg32;

/// What draws the camera noise of picture `number` of a film: the same for the same number, whatever was drawn before, so that a film can be gone on with.
pub(crate) fn of_picture(number: usize) -> Pcg32 {
    // Seeds that differ in a few bits are spread over all of the state.
    Pcg32::seed_from_u64((number as u64) << 8 | 7)
}

/// Mean 0, variance 1. At most 5.7: the first of the two even numbers is never below 1e-7.
pub fn normal(rng: &mut impl Rng) -> f32 {
    let (u, v): (f32, f32) = (rng.random_range(1e-7..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}

/// The same in double precision, for sound; at most 7.5.
pub fn normal_f64(rng: &mut impl Rng) -> f64 {
    let (u, v): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random());
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

/// Fills with mean + deviation·N(0, 1).
pub fn fill_normal(values: &mut [f32], mean: f32, deviation: f32, rng: &mut impl Rng) {
    for v in values {
        *v = mean + deviation * normal(rng);
    }
}
