//! The hiss under every sound.
//!
//! Made by `cargo xtask tables`; do not edit.
//! Largest error of an entry: 7.5e-6.

/// Mean sum of each mel channel in white noise of `LEVEL` LSB rms, Q16.
#[rustfmt::skip]
pub static FLOOR: [u32; 26] = [
    554754, 935883, 1507283, 2277723, 3188329, 4440990, 5890762, 7849909, 10096169, 12954397,
    16542888, 20726792, 26102490, 32297976, 39977548, 49147047, 60237431, 73219033, 88597532,
    106623567, 127437395, 151267571, 177829315, 207214372, 238024569, 269503694,
];
