//! The colour space that COS separates grey from colour in: NTSC's YIQ. Y is luminance, I and Q carry hue and saturation.

/// Y, I, Q of R, G, B, all in levels of 0..255.
pub fn of_rgb([r, g, b]: [f32; 3]) -> [f32; 3] {
    [
        0.299 * r + 0.587 * g + 0.114 * b,
        0.5959 * r - 0.2746 * g - 0.3213 * b,
        0.2115 * r - 0.5227 * g + 0.3112 * b,
    ]
}

/// R, G, B of Y, I, Q; not held to 0..255.
pub fn to_rgb([y, i, q]: [f32; 3]) -> [f32; 3] {
    [
        y + 0.956 * i + 0.619 * q,
        y - 0.272 * i - 0.647 * q,
        y - 1.106 * i + 1.703 * q,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_come_back_and_grey_has_none() {
        for rgb in [[12.0, 200.0, 90.0], [255.0, 0.0, 0.0], [0.0, 10.0, 255.0]] {
            let back = to_rgb(of_rgb(rgb));
            // The two matrices are published with three and four digits.
            assert!(
                std::iter::zip(back, rgb).all(|(a, b)| (a - b).abs() < 0.5),
                "{back:?}"
            );
        }
        let [y, i, q] = of_rgb([80.0; 3]);
        assert!((y - 80.0).abs() < 1e-3 && i.abs() < 0.02 && q.abs() < 0.02);
    }
}
