//! A mouth at rest is still: where it hardly moves it is followed slowly, which takes away the quiver that hiss, breath and hum
//! leave in it. What moves in speech moves on at once.
//!
//! ```text
//! r² = mean over the parameters of (ŷ_t − s_{t−1})²,  in standard deviations
//! s_t = s_{t−1} + min(1, max(r² / 0.1², 1/16))·(ŷ_t − s_{t−1}),  s_0 = ŷ_0
//! ```
//!
//! s is what the stream gives out; the memory goes on from ŷ. `docs/models.md` says what it costs and brings.
use crate::fixed::{round_shift, saturate_i16};

/// r of a mouth that is followed at once, 0.1, squared, in units of the parameters' LSB of 2⁻¹⁰.
const LEAST_MOTION: u32 = 10_486;
/// Largest difference that is counted, four deviations: a mouth that has gone as far is followed at once whatever the others do.
const LIMIT: i32 = 1 << 12;
/// Fraction bits of the share that is followed, and the least share, 1/16.
const SHARE_BITS: u32 = 12;
const LEAST_SHARE: u32 = 1 << (SHARE_BITS - 4);

/// Moves `mouth` (LSB 2⁻¹⁰ deviations, at most 64 of them) to where the stream shows it after `before`, the mouth that it has
/// shown last. Values come to rest within 1/128 deviation of where they go.
pub fn settle(before: &[i16], mouth: &mut [i16]) {
    let mut sum = 0u32;
    // What the sum is for a mouth that is followed at once.
    let mut enough = 0u32;
    for (s, y) in before.iter().zip(mouth.iter()) {
        let way = (i32::from(*y) - i32::from(*s)).clamp(-LIMIT, LIMIT);
        // 64 of at most 2²⁴.
        sum += (way * way) as u32;
        enough += LEAST_MOTION;
    }
    if sum >= enough {
        return;
    }
    // sum < 64·10486 < 2²⁰.
    let share = ((sum << SHARE_BITS) / enough).max(LEAST_SHARE) as i32;
    for (s, y) in before.iter().zip(mouth) {
        // Below 2¹² · 2¹⁰, as the sum is small.
        let way = (i32::from(*y) - i32::from(*s)) * share;
        *y = saturate_i16(i32::from(*s) + round_shift(way, SHARE_BITS));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speech_moves_at_once() {
        let mut mouth = [110, -110, 105, 0];
        settle(&[0; 4], &mut mouth);
        // A root mean square of 94 of 102: not quite.
        assert_eq!(mouth, [92, -92, 88, 0]);
        let mut mouth = [i16::MAX, i16::MIN, 0, 7];
        settle(&[i16::MIN, i16::MAX, 0, 0], &mut mouth);
        assert_eq!(mouth, [i16::MAX, i16::MIN, 0, 7]);
    }

    #[test]
    fn a_quiver_dies() {
        let mut shown = [500i16, -300];
        let mut most = 0;
        for t in 0..200 {
            let mut mouth = [500 + [20, -20][t % 2], -300 - [15, -15][t % 2]];
            let before = shown;
            settle(&before, &mut mouth);
            most = most.max((mouth[0] - before[0]).abs());
            shown = mouth;
        }
        assert!(most <= 2, "{most}");
    }

    #[test]
    fn a_mouth_comes_to_rest_near_where_it_goes() {
        let mut shown = [90i16; 30];
        for _ in 0..100 {
            let mut mouth = [0; 30];
            settle(&shown, &mut mouth);
            shown = mouth;
        }
        assert!(shown.iter().all(|v| v.abs() <= 8), "{shown:?}");
    }

    #[test]
    fn without_a_mouth_before_it_stays() {
        let mut mouth = [3, 4];
        settle(&[], &mut mouth);
        assert_eq!(mouth, [3, 4]);
    }
}
