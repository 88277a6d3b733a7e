//! One area of one picture: the cluster that is nearest to the speech, and what it makes of it.
use super::tables::{APPEARANCE_FRACTION_BITS, Area, MAX_SPEECH, SIGNAL_FRACTION_BITS};
use crate::fixed::{round_shift, saturate_i16};
use crate::frame::MAX_PARAMETERS;

/// Largest difference of a speech parameter from a cluster's mean that is counted, 16 deviations.
pub const MAX_OFF: i32 = (1 << 14) - 1;
/// Three deviations of a component.
const LIMIT: i32 = 3 << SIGNAL_FRACTION_BITS;

/// s − s̄, within ±[`MAX_OFF`].
#[inline(always)]
fn off(speech: i16, mean: i16) -> i32 {
    (i32::from(speech) - i32::from(mean)).clamp(-MAX_OFF, MAX_OFF)
}

/// The cluster nearest to `speech` (Q5.10 deviations); the first of several (eq. 8).
pub fn choose(area: &Area, speech: &[i16]) -> usize {
    let mut best = (0, u32::MAX);
    let mut means = area.speech_means().iter();
    for cluster in 0..area.clusters {
        // 16 squares of at most (2¹⁴ − 1)² are less than 2³².
        let mut distance = 0u32;
        for (s, mean) in speech.iter().zip(&mut means) {
            let off = off(*s, mean);
            distance = distance.wrapping_add((off * off) as u32);
        }
        if distance < best.1 {
            best = (cluster, distance);
        }
    }
    best.0
}

/// The appearance that a cluster gives `speech`, in parameter LSBs, into the first C numbers of `to` (eq. 9 to 11).
pub fn estimate(area: &Area, cluster: usize, speech: &[i16], to: &mut [i16]) {
    let mut offs = [0; MAX_SPEECH];
    let means = area.speech_means().row(cluster, area.speech);
    for ((to, s), mean) in offs.iter_mut().zip(speech).zip(means.iter()) {
        *to = off(*s, mean);
    }
    // d·H: 16 products of 3·2¹⁰ and 2¹⁵ are less than 2³¹.
    let mut sums = [0i32; MAX_PARAMETERS];
    for mode in 0..area.modes {
        let (row, shift) = area.speech_row(cluster, mode);
        // 2¹⁴ times less than 2¹⁶.
        let sum: i32 = row.iter().zip(&offs).map(|(w, off)| i32::from(w) * off).sum();
        let d = round_shift(sum, shift).clamp(-LIMIT, LIMIT);
        for (sum, h) in sums.iter_mut().zip(area.appearance_row(cluster, mode).iter()) {
            *sum += d * i32::from(h);
        }
    }
    let (means, limits) = area.appearance(cluster);
    for (((to, sum), mean), limit) in to.iter_mut().zip(&sums).zip(means.iter()).zip(limits.iter()) {
        let moved = round_shift(*sum, SIGNAL_FRACTION_BITS + APPEARANCE_FRACTION_BITS);
        let most = i32::from(limit);
        *to = saturate_i16(i32::from(mean) + moved.clamp(-most, most));
    }
}
