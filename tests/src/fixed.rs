//! Arithmetic that is one instruction on some targets: it has to agree with what the other targets do.
use lipstream_core::fixed::{mul_halves, mul_halves_plain};

use crate::random::Random;

/// `mul_halves`, by corners of both halves and at random.
pub fn products_of_halves() {
    const CORNERS: [i16; 7] = [i16::MIN, i16::MIN + 1, -1, 0, 1, i16::MAX - 1, i16::MAX];
    let words = || {
        CORNERS
            .iter()
            .flat_map(|a| CORNERS.map(|b| u32::from(*a as u16) | u32::from(b as u16) << 16))
    };
    for a in words() {
        for b in words() {
            for sum in [i32::MIN, -1, 0, i32::MAX] {
                assert_eq!(
                    mul_halves(sum, a, b),
                    mul_halves_plain(sum, a, b),
                    "{sum} {a:#x} {b:#x}"
                );
            }
        }
    }
    let mut random = Random::new(3);
    for _ in 0..10_000 {
        let [sum, a, b] = core::array::from_fn(|_| random.next_u32());
        assert_eq!(mul_halves(sum as i32, a, b), mul_halves_plain(sum as i32, a, b));
    }
}
