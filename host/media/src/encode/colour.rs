//! R, G, B to Y′CbCr 4:2:0 of limited range (ITU-R BT.601), which video codecs take, and back.

/// One picture, planes of bytes; chroma is halved in both directions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width in pixels, even.
    pub width: usize,
    /// Height in pixels, even.
    pub height: usize,
    /// `[height·width]`, 16..235.
    pub y: Vec<u8>,
    /// `[height/2·width/2]`, 16..240.
    pub cb: Vec<u8>,
    /// `[height/2·width/2]`, 16..240.
    pub cr: Vec<u8>,
}

/// Bits after the point of the sums in [`SHARES`].
const POINT: u32 = 11;
/// Bits of one of the three sums in a word of [`SHARES`]: four pixels' 240.5 · 2¹¹ fit.
const FIELD: u32 = 21;

/// What each level of R, G and B adds to Y, Cb and Cr: side by side in one word from the lowest bits up, so that a pixel costs three look-ups and
/// two additions. R's also has the offsets, and one half to round by. Errors of a sum are below 3/2¹²: rounded levels differ
/// from exact ones where those are that near to one half.
static SHARES: [[u64; 256]; 3] = {
    // ITU-R BT.601, section 2.5: levels of 219 and 224 steps for 255.
    const WEIGHTS: [[f64; 3]; 3] = [
        [65.481, -37.797, 112.0],
        [128.553, -74.203, -93.786],
        [24.966, 112.0, -18.214],
    ];
    const OFFSETS: [f64; 3] = [16.5, 128.5, 128.5];
    let mut shares = [[0; 256]; 3];
    let mut colour = 0;
    while colour < 3 {
        let mut level = 0;
        while level < 256 {
            let mut field = 0;
            while field < 3 {
                let offset = if colour == 0 { OFFSETS[field] } else { 0.0 };
                let share = WEIGHTS[colour][field] * level as f64 / 255.0 + offset;
                let scaled = share * (1 << POINT) as f64;
                let rounded = (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i64;
                // Shares may be negative and then borrow from the field above; no sum of three is, which gives it back.
                shares[colour][level] =
                    (rounded << (FIELD * field as u32)).wrapping_add(shares[colour][level] as i64) as u64;
                field += 1;
            }
            level += 1;
        }
        colour += 1;
    }
    shares
};

/// Rows of interleaved R, G, B bytes to a picture. Width and height are even.
pub fn from_rgb(rgb: &[u8], width: usize, height: usize) -> Picture {
    debug_assert!(width.is_multiple_of(2) && height.is_multiple_of(2) && rgb.len() == width * height * 3);
    let mut picture = Picture {
        width,
        height,
        y: vec![0; width * height],
        cb: vec![0; width * height / 4],
        cr: vec![0; width * height / 4],
    };
    let pairs = rgb
        .chunks_exact(6 * width)
        .zip(picture.y.chunks_exact_mut(2 * width));
    let chroma = picture
        .cb
        .chunks_exact_mut(width / 2)
        .zip(picture.cr.chunks_exact_mut(width / 2));
    for ((rgb, y), (cb, cr)) in pairs.zip(chroma) {
        let (rgb, y) = (rgb.split_at(3 * width), y.split_at_mut(width));
        let above = rgb.0.as_chunks::<6>().0.iter().zip(y.0.as_chunks_mut::<2>().0);
        let below = rgb.1.as_chunks::<6>().0.iter().zip(y.1.as_chunks_mut::<2>().0);
        for (((rgb, y), (rgb_below, y_below)), (cb, cr)) in above.zip(below).zip(cb.iter_mut().zip(cr)) {
            let four = two(rgb, y).wrapping_add(two(rgb_below, y_below));
            *cb = (four >> (FIELD + POINT + 2)) as u8;
            *cr = (four >> (2 * FIELD + POINT + 2)) as u8;
        }
    }
    picture
}

/// Luma of two pixels, and the sum of their shares.
#[inline(always)]
fn two(rgb: &[u8; 6], y: &mut [u8; 2]) -> u64 {
    let share = |r: u8, g: u8, b: u8| {
        SHARES[0][usize::from(r)]
            .wrapping_add(SHARES[1][usize::from(g)])
            .wrapping_add(SHARES[2][usize::from(b)])
    };
    let [r, g, b, s, h, c] = *rgb;
    let (first, second) = (share(r, g, b), share(s, h, c));
    *y = [(first >> POINT) as u8, (second >> POINT) as u8];
    first.wrapping_add(second)
}

/// The picture as rows of interleaved R, G, B bytes, chroma repeated.
pub fn to_rgb(picture: &Picture) -> Vec<u8> {
    let mut rgb = Vec::with_capacity(picture.y.len() * 3);
    for (i, &y) in picture.y.iter().enumerate() {
        let (row, column) = (i / picture.width, i % picture.width);
        let half = row / 2 * (picture.width / 2) + column / 2;
        let y = (f32::from(y) - 16.0) * 255.0 / 219.0;
        let cb = (f32::from(picture.cb[half]) - 128.0) * 255.0 / 224.0;
        let cr = (f32::from(picture.cr[half]) - 128.0) * 255.0 / 224.0;
        rgb.push(byte(y + 1.402 * cr));
        rgb.push(byte(y - 0.344_136 * cb - 0.714_136 * cr));
        rgb.push(byte(y + 1.772 * cb));
    }
    rgb
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_colours() {
        // The primaries at full level, as BT.601 tabulates them.
        for (rgb, want) in [
            ([255, 255, 255], (235, 128, 128)),
            ([0, 0, 0], (16, 128, 128)),
            ([255, 0, 0], (81, 90, 240)),
            ([0, 255, 0], (145, 54, 34)),
            ([0, 0, 255], (41, 240, 110)),
        ] {
            let p = from_rgb(&rgb.repeat(4), 2, 2);
            assert_eq!((p.y[0], p.cb[0], p.cr[0]), want);
        }
    }

    #[test]
    fn every_level_of_every_colour_is_the_nearest() {
        for (k, (r, g, b)) in (0..256)
            .flat_map(|v| [(v, 0, 0), (0, v, 255), (255, 255 - v, v), (v, v, v)])
            .enumerate()
        {
            let p = from_rgb(&[r as u8, g as u8, b as u8].repeat(4), 2, 2);
            let (r, g, b) = (f64::from(r), f64::from(g), f64::from(b));
            let exact = [
                16.0 + (65.481 * r + 128.553 * g + 24.966 * b) / 255.0,
                128.0 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255.0,
                128.0 + (112.0 * r - 93.786 * g - 18.214 * b) / 255.0,
            ];
            for (have, want) in [p.y[3], p.cb[0], p.cr[0]].into_iter().zip(exact) {
                assert!((f64::from(have) - want).abs() < 0.501, "{k}: {have} {want}");
            }
        }
        // Chroma is that of the mean of four.
        let four = from_rgb(&[255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0], 2, 2);
        assert_eq!((four.y[0], four.y[1], four.cb[0], four.cr[0]), (81, 16, 119, 156));
    }

    #[test]
    fn there_and_back() {
        for rgb in [[200u8, 120, 100], [30, 60, 90], [128, 128, 128], [250, 240, 230]] {
            let back = to_rgb(&from_rgb(&rgb.repeat(4), 2, 2));
            for (a, b) in back.iter().zip(rgb.iter().cycle()) {
                assert!(a.abs_diff(*b) <= 2, "{back:?} {rgb:?}");
            }
        }
    }
}
