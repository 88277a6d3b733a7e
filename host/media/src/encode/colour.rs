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

/// Rows of interleaved R, G, B bytes to a picture. Width and height are even.
pub fn from_rgb(rgb: &[u8], width: usize, height: usize) -> Picture {
    debug_assert!(width.is_multiple_of(2) && height.is_multiple_of(2) && rgb.len() == width * height * 3);
    let luma = |r: f32, g: f32, b: f32| 16.0 + (65.481 * r + 128.553 * g + 24.966 * b) / 255.0;
    let y = rgb
        .chunks_exact(3)
        .map(|p| byte(luma(p[0].into(), p[1].into(), p[2].into())))
        .collect();
    let mut cb = Vec::with_capacity(width * height / 4);
    let mut cr = Vec::with_capacity(width * height / 4);
    for row in (0..height).step_by(2) {
        for column in (0..width).step_by(2) {
            let mean = |channel: usize| {
                let at = |r: usize, c: usize| f32::from(rgb[3 * (r * width + c) + channel]);
                (at(row, column) + at(row, column + 1) + at(row + 1, column) + at(row + 1, column + 1)) / 4.0
            };
            let (r, g, b) = (mean(0), mean(1), mean(2));
            cb.push(byte(128.0 + (-37.797 * r - 74.203 * g + 112.0 * b) / 255.0));
            cr.push(byte(128.0 + (112.0 * r - 93.786 * g - 18.214 * b) / 255.0));
        }
    }
    Picture {
        width,
        height,
        y,
        cb,
        cr,
    }
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
    fn there_and_back() {
        for rgb in [[200u8, 120, 100], [30, 60, 90], [128, 128, 128], [250, 240, 230]] {
            let back = to_rgb(&from_rgb(&rgb.repeat(4), 2, 2));
            for (a, b) in back.iter().zip(rgb.iter().cycle()) {
                assert!(a.abs_diff(*b) <= 2, "{back:?} {rgb:?}");
            }
        }
    }
}
