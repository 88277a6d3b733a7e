//! A layer that is cloned into a picture.
use crate::affine::Affine;

use super::membrane::Membrane;
use super::raster::Bytes;

/// A region of a layer that is cloned into pictures, soft over the last pixels inside its edge.
#[derive(Clone, Debug)]
pub struct Region {
    /// Opacity at the grid's nodes, 0..=1, `[height, width]`; a node is a pixel of the mouth's rectangle.
    opacity: Vec<f32>,
    width: usize,
    height: usize,
    /// Where node (0, 0) lies in pixels of the mouth's rectangle.
    origin: (f32, f32),
    membrane: Membrane,
}

impl Region {
    /// On a grid of `width` × `height` nodes, pixels of the mouth's rectangle, whose first lies at `origin`. `depth` says how far inside a node is, 0 at the
    /// edge, 1 where the layer is opaque.
    pub fn new(width: usize, height: usize, origin: (f32, f32), depth: impl Fn(f32, f32) -> f32) -> Self {
        let mut opacity = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let edge = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
                let depth = depth(x as f32 + origin.0, y as f32 + origin.1).clamp(0.0, 1.0);
                opacity.push(if edge { 0.0 } else { depth });
            }
        }
        let membrane = Membrane::new(width, height, |x, y| opacity[y * width + x] > 0.0);
        Self {
            opacity,
            width,
            height,
            origin,
            membrane,
        }
    }

    /// An oval nearly as large as a mouth's rectangle.
    pub fn of_mouth(width: usize, height: usize) -> Self {
        let (cx, cy) = (0.5 * (width - 1) as f32, 0.5 * (height - 1) as f32);
        let soft = 0.12;
        Self::new(width, height, (0.0, 0.0), |x, y| {
            let (u, v) = ((x - cx) / (cx - 0.5), (y - cy) / (cy - 0.5));
            (1.0 - (u.powi(4) + v.powi(4)).sqrt().sqrt()) / soft
        })
    }

    /// Opacity at a place of the mouth's rectangle, bilinear; 0 outside the grid.
    pub fn opacity(&self, x: f32, y: f32) -> f32 {
        let (x, y) = (x - self.origin.0, y - self.origin.1);
        if !(x > 0.0 && y > 0.0 && x < (self.width - 1) as f32 && y < (self.height - 1) as f32) {
            return 0.0;
        }
        let (left, top) = (x as usize, y as usize);
        let (u, v) = (x - left as f32, y - top as f32);
        let at = |x: usize, y: usize| self.opacity[y * self.width + x];
        (at(left, top) * (1.0 - u) + at(left + 1, top) * u) * (1.0 - v)
            + (at(left, top + 1) * (1.0 - u) + at(left + 1, top + 1) * u) * v
    }

    /// Forgets the picture before, from whose light the next one's is found sooner.
    pub fn begin_anew(&mut self) {
        self.membrane.begin_anew();
    }

    /// Clones `source` (at a place of the mouth's rectangle) into `picture`, in which `map` says where the mouth's rectangle lies. `share` says how much of the source is
    /// shown at a place of the rectangle, 0..=1; where that is nothing the border says nothing of the light either.
    ///
    /// Where the map is singular nothing is drawn.
    pub fn stitch(
        &mut self,
        picture: &mut [u8],
        (width, height): (usize, usize),
        map: &Affine,
        share: impl Fn(f32, f32) -> f32,
        source: impl Fn(f32, f32) -> [f32; 3],
    ) {
        let Some(back) = map.inverse() else { return };
        let [ox, oy] = [self.origin.0, self.origin.1];
        {
            let target = Bytes {
                rgb: picture,
                width,
                height,
            };
            self.membrane.lay(|x, y| {
                let (x, y) = (x as f32 + ox, y as f32 + oy);
                if share(x, y) < 0.5 {
                    return None;
                }
                let (px, py) = map.apply(x, y);
                let (there, here) = (target.sample(px, py), source(x, y));
                Some(std::array::from_fn(|c| there[c] - here[c]))
            });
        }
        let corners = [
            (ox, oy),
            (ox + self.width as f32, oy),
            (ox, oy + self.height as f32),
            (ox + self.width as f32, oy + self.height as f32),
        ]
        .map(|(x, y)| map.apply(x, y));
        let bound = |of: fn(&(f32, f32)) -> f32, most: usize| {
            let (low, high) = corners
                .iter()
                .map(of)
                .fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| {
                    (l.min(v), h.max(v))
                });
            (
                low.floor().max(0.0) as usize,
                (high.ceil().max(0.0) as usize + 1).min(most),
            )
        };
        let (left, right) = bound(|c| c.0, width);
        let (top, bottom) = bound(|c| c.1, height);
        for py in top..bottom {
            for px in left..right {
                let (x, y) = back.apply(px as f32, py as f32);
                let opacity = self.opacity(x, y) * share(x, y);
                if opacity <= 0.0 {
                    continue;
                }
                let (here, lift) = (source(x, y), self.membrane.at(x - ox, y - oy));
                let pixel = &mut picture[3 * (py * width + px)..][..3];
                for c in 0..3 {
                    let wanted = (here[c] + lift[c]).clamp(0.0, 255.0);
                    let there = f32::from(pixel[c]);
                    pixel[c] = (there + opacity * (wanted - there)).round() as u8;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: usize, height: usize, level: impl Fn(usize, usize) -> [u8; 3]) -> Vec<u8> {
        (0..width * height)
            .flat_map(|at| level(at % width, at / width))
            .collect()
    }

    /// What is cloned into the very picture that it comes from, in other light, gives that picture back.
    #[test]
    fn a_patch_in_another_light_comes_back() {
        let (width, height) = (96, 80);
        let rgb = picture(width, height, |x, y| {
            let wave = (20.0 * (0.3 * x as f32).sin() * (0.2 * y as f32).cos()) as i32;
            [(120 + wave) as u8, (90 + wave / 2) as u8, (60 + x / 2) as u8]
        });
        let map = Affine([1.02, 0.05, 18.0, -0.05, 1.02, 20.0]);
        let mut region = Region::of_mouth(48, 36);
        let mut drawn = rgb.clone();
        let from = Bytes {
            rgb: &rgb,
            width,
            height,
        };
        region.stitch(
            &mut drawn,
            (width, height),
            &map,
            |_, _| 1.0,
            |x: f32, y: f32| {
                let (px, py) = map.apply(x, y);
                let [r, g, b] = from.sample(px, py);
                // Darker, and bluer to the right: differences that are harmonic.
                [r - 30.0, g - 10.0, b + 0.5 * x]
            },
        );
        let furthest = drawn.iter().zip(&rgb).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(furthest.unwrap() <= 2, "{furthest:?}");
    }

    /// Nothing changes outside, and at the edge there is no step.
    #[test]
    fn outside_nothing_changes() {
        let (width, height) = (64, 64);
        let rgb = picture(width, height, |x, _| [(2 * x) as u8, 100, 100]);
        let map = Affine::scaled(1.0, 16.0, 20.0);
        let mut drawn = rgb.clone();
        let mut region = Region::of_mouth(32, 24);
        region.stitch(
            &mut drawn,
            (width, height),
            &map,
            |_, _| 1.0,
            |x: f32, y: f32| {
                let hole = ((x - 15.5).powi(2) + (y - 11.5).powi(2) < 25.0).then_some(20.0);
                [hole.unwrap_or(200.0), 30.0, 30.0]
            },
        );
        let at = |of: &[u8], x: usize, y: usize| of[3 * (y * width + x)];
        for y in 0..height {
            for x in 0..width {
                let (u, v) = (x as f32 - 16.0, y as f32 - 20.0);
                if region.opacity(u, v) == 0.0 {
                    assert_eq!(at(&drawn, x, y), at(&rgb, x, y));
                }
            }
        }
        // The hole is there, the skin around it is the background's.
        assert!(at(&drawn, 31, 31) < 20);
        for x in 17..22 {
            assert!(at(&drawn, x, 31).abs_diff(at(&rgb, x, 31)) < 4, "{x}");
        }
        // A map that shrinks everything to a point draws nothing.
        let mut same = rgb.clone();
        region.stitch(
            &mut same,
            (width, height),
            &Affine::scaled(0.0, 1.0, 1.0),
            |_, _| 1.0,
            |_, _| [0.0; 3],
        );
        assert_eq!(same, rgb);
    }
}
