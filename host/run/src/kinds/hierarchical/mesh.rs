//! Triangles between landmarks, and piecewise-affine warps through them.
//!
//! A texture is the list of the pixels that lie inside the triangles of a shape. To warp an image to that shape, every pixel's barycentric
//! coordinates in its triangle are looked up in the same triangle of the image's own shape: inside a triangle that is one affine map, and along the
//! edges the maps of both neighbours agree.
use ndarray::{Array1, ArrayView1};

/// Corners of the triangles, as indices of landmarks.
pub type Triangles = Vec<[usize; 3]>;

/// Landmarks x₀, y₀, x₁, y₁, … as points.
pub fn points(shape: ArrayView1<f32>) -> Vec<[f32; 2]> {
    (0..shape.len() / 2)
        .map(|k| [shape[2 * k], shape[2 * k + 1]])
        .collect()
}

/// A pixel inside the triangles.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    x: usize,
    y: usize,
    corners: [usize; 3],
    weights: [f32; 3],
}

/// The pixels that a shape covers on a grid whose centres lie at whole numbers.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Pixels in a row of the grid.
    pub width: usize,
    /// Rows.
    pub height: usize,
    pixels: Vec<Pixel>,
    /// For every place of the grid, the pixel whose level stands there: its own inside, the nearest one's outside.
    fill: Vec<u32>,
}

impl Patch {
    /// Of a shape on a grid of `width` × `height`; what lies outside is left out. Where triangles overlap, the later one is seen.
    pub fn new(shape: &[[f32; 2]], triangles: &[[usize; 3]], (width, height): (usize, usize)) -> Self {
        let mut of_grid: Vec<Option<Pixel>> = vec![None; width * height];
        for corners in triangles {
            let [a, b, c] = corners.map(|k| shape[k]);
            let (bx, by, cx, cy) = (b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]);
            let area = bx * cy - by * cx;
            if area.is_nan() || area.abs() < 1e-6 {
                continue;
            }
            let range = |axis: usize, most: usize| {
                let values = [a[axis], b[axis], c[axis]];
                let least = values.iter().copied().fold(f32::INFINITY, f32::min);
                let largest = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                // Casts saturate: what lies left of the grid begins at 0.
                (least.ceil().max(0.0) as usize)..((largest.floor() + 1.0).max(0.0) as usize).min(most)
            };
            for y in range(1, height) {
                for x in range(0, width) {
                    let (px, py) = (x as f32 - a[0], y as f32 - a[1]);
                    let v = (px * cy - py * cx) / area;
                    let w = (bx * py - by * px) / area;
                    let weights = [1.0 - v - w, v, w];
                    // Pixels on an edge belong to both of its triangles, in which they have the same place.
                    if weights.iter().all(|w| *w >= -1e-5) {
                        of_grid[y * width + x] = Some(Pixel {
                            x,
                            y,
                            corners: *corners,
                            weights,
                        });
                    }
                }
            }
        }
        let mut fill = vec![u32::MAX; width * height];
        let mut pixels = Vec::new();
        for (at, pixel) in of_grid.into_iter().enumerate() {
            if let Some(pixel) = pixel {
                fill[at] = pixels.len() as u32;
                pixels.push(pixel);
            }
        }
        spread(&mut fill, width);
        Self {
            width,
            height,
            pixels,
            fill,
        }
    }

    /// Number of pixels inside, the length of a texture.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// Whether the shape covers no pixel.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Where each pixel lies on the grid.
    pub fn places(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.pixels.iter().map(|pixel| (pixel.x, pixel.y))
    }

    /// Where each pixel lies when the landmarks are those of `shape`.
    pub fn in_shape<'a>(&'a self, shape: &'a [[f32; 2]]) -> impl Iterator<Item = [f32; 2]> + 'a {
        self.pixels.iter().map(|pixel| {
            let mut place = [0.0; 2];
            for (corner, weight) in pixel.corners.iter().zip(pixel.weights) {
                place[0] += weight * shape[*corner][0];
                place[1] += weight * shape[*corner][1];
            }
            place
        })
    }

    /// A texture's level between pixels, bilinear; outside the shape the nearest pixel's.
    pub fn sample(&self, texture: ArrayView1<f32>, [x, y]: [f32; 2]) -> f32 {
        let x = x.clamp(0.0, (self.width - 1) as f32);
        let y = y.clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let (right, bottom) = ((left + 1).min(self.width - 1), (top + 1).min(self.height - 1));
        let (u, v) = (x - left as f32, y - top as f32);
        let at = |x: usize, y: usize| texture[self.fill[y * self.width + x] as usize];
        let above = at(left, top) + u * (at(right, top) - at(left, top));
        let below = at(left, bottom) + u * (at(right, bottom) - at(left, bottom));
        above + v * (below - above)
    }

    /// The shape-free texture of an image: `level` of the image at each pixel's place in the image's own `shape`.
    pub fn texture(&self, shape: &[[f32; 2]], mut level: impl FnMut([f32; 2]) -> f32) -> Array1<f32> {
        self.in_shape(shape).map(&mut level).collect()
    }
}

/// Gives every empty place of a grid what its nearest filled neighbour has, in rings around what is there.
fn spread(fill: &mut [u32], width: usize) {
    let height = fill.len() / width.max(1);
    let mut ring: Vec<usize> = (0..fill.len()).filter(|at| fill[*at] != u32::MAX).collect();
    while !ring.is_empty() {
        let mut next = Vec::new();
        for at in ring {
            let (x, y) = (at % width, at / width);
            let mut give = |to: usize| {
                if fill[to] == u32::MAX {
                    fill[to] = fill[at];
                    next.push(to);
                }
            };
            if x > 0 {
                give(at - 1);
            }
            if x + 1 < width {
                give(at + 1);
            }
            if y > 0 {
                give(at - width);
            }
            if y + 1 < height {
                give(at + width);
            }
        }
        ring = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f32; 2]; 5] = [[2.0, 2.0], [17.0, 2.0], [17.0, 12.0], [2.0, 12.0], [8.0, 7.0]];
    const FAN: [[usize; 3]; 4] = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]];

    /// Landmarks that all moved by one affine map move every pixel by it.
    #[test]
    fn a_known_affine_map_is_followed_everywhere() {
        let patch = Patch::new(&SQUARE, &FAN, (20, 15));
        assert_eq!(patch.len(), 16 * 11);
        let map = |[x, y]: [f32; 2]| [1.3 * x - 0.2 * y + 4.0, 0.1 * x + 0.8 * y - 1.0];
        let moved = SQUARE.map(map);
        for ((x, y), place) in patch.places().zip(patch.in_shape(&moved)) {
            let wanted = map([x as f32, y as f32]);
            assert!((place[0] - wanted[0]).abs() < 1e-3 && (place[1] - wanted[1]).abs() < 1e-3);
        }
    }

    /// A plane stays a plane through a warp there and back.
    #[test]
    fn a_texture_is_the_image_seen_through_the_map() {
        let patch = Patch::new(&SQUARE, &FAN, (20, 15));
        let moved = SQUARE.map(|[x, y]| [2.0 * x + 1.0, y + 3.0]);
        let texture = patch.texture(&moved, |[x, y]| 10.0 * x - 3.0 * y);
        for ((x, y), level) in patch.places().zip(&texture) {
            let wanted = 10.0 * (2.0 * x as f32 + 1.0) - 3.0 * (y as f32 + 3.0);
            assert!((level - wanted).abs() < 1e-2, "{x} {y}");
        }
        let between = patch.sample(texture.view(), [5.5, 6.25]);
        assert!((between - (10.0 * 12.0 - 3.0 * 9.25)).abs() < 1e-2);
        // Outside, the nearest pixel.
        assert_eq!(patch.sample(texture.view(), [-5.0, 2.0]), texture[0]);
    }

    #[test]
    fn flat_triangles_and_shapes_off_the_grid_cover_nothing() {
        let flat = [[1.0, 1.0], [5.0, 5.0], [9.0, 9.0]];
        assert!(Patch::new(&flat, &[[0, 1, 2]], (10, 10)).is_empty());
        let off = [[-9.0, -9.0], [-5.0, -9.0], [-5.0, -2.0]];
        assert!(Patch::new(&off, &[[0, 1, 2]], (10, 10)).is_empty());
        let wrong = [[f32::NAN, 1.0], [5.0, 5.0], [1.0, 9.0]];
        assert!(Patch::new(&wrong, &[[0, 1, 2]], (10, 10)).is_empty());
    }
}
