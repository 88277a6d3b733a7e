//! A drawn person, for trying out and testing what is drawn onto recordings: a wall, a plain face that sways, and on it the drawn mouth.
use ndarray::Array1;

use super::footage::{Edge, Footage, Jaw, Pictures, Place};
use super::raster::Floats;
use crate::affine::Affine;
use crate::render::drawn::{self, HEIGHT, Pose, WIDTH};

/// Width and height of the person's pictures.
pub const SIZE: (usize, usize) = (128, 112);

/// The pose in picture `n` of the recording.
pub fn pose(n: usize) -> Pose {
    let t = n as f32;
    Pose {
        open: 0.5 - 0.5 * (0.5 * t).cos(),
        round: (0.5 + 0.5 * (0.23 * t).sin()).powi(2),
        spread: 0.3,
    }
}

/// Where the mouth lies in picture `n` of a head that sways by `sway` times three pixels.
pub fn place(n: usize, sway: f32) -> Affine {
    let t = n as f32 * 0.2;
    Affine::scaled(
        1.0,
        30.0 + sway * 3.0 * t.sin(),
        34.0 + sway * 2.0 * (0.7 * t).cos(),
    )
}

/// A picture with this mouth, of so many levels less light.
pub fn picture(mouth: &Array1<f32>, map: &Affine, darker: f32) -> Vec<u8> {
    let mouth = Floats {
        rgb: mouth.as_slice().unwrap_or_default(),
        width: WIDTH,
        height: HEIGHT,
    };
    let back = map.inverse().unwrap_or(Affine::IDENTITY);
    let mut rgb = Vec::new();
    for y in 0..SIZE.1 {
        for x in 0..SIZE.0 {
            let (u, v) = back.apply(x as f32, y as f32);
            let on_face = (u - 31.5).hypot(v - 20.0) < 46.0;
            let levels = match on_face {
                // The drawn mouth's skin goes on beyond its rectangle.
                true => mouth.sample(u, v),
                false => [60.0, 90.0, 120.0 + 0.5 * y as f32],
            };
            rgb.extend(levels.map(|level| (level - darker).round().clamp(0.0, 255.0) as u8));
        }
    }
    rgb
}

/// A recording of `count` pictures, 25 a second.
///
/// # Panics
///
/// Where there is no room for temporary files.
pub fn recording(count: usize, darker: f32, sway: f32) -> Footage {
    let mut pictures = Pictures::new(SIZE.0, SIZE.1).expect("room for temporary files");
    let mut places = Vec::new();
    for n in 0..count {
        let map = place(n, sway);
        pictures
            .push(&picture(&drawn::draw(pose(n)), &map, darker))
            .expect("room for a drawn picture");
        places.push(Place {
            mouth: map,
            jaw: Some(1.0 + 0.2 * pose(n).open),
            turned: 0.0,
            lips: Some((0.2 * pose(n).open, 0.6 - 0.1 * pose(n).round)),
            edge: Some(Edge {
                left: (-14.0, 30.0),
                right: (77.0, 30.0),
                chin: (31.5, 60.0),
            }),
        });
    }
    Footage {
        pictures,
        rate_hz: 25.0,
        mouth: (WIDTH, HEIGHT),
        places,
        jaw: Some(Jaw {
            sides: (-8.0, 71.0),
            top: 0.0,
            bottom: 58.0,
        }),
    }
}
