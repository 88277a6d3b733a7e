//! A mouth that is drawn, not photographed: pictures and an eigenmouth space with nobody's face in them, for
//! trying out and testing everything from parameters to video.
use ndarray::{Array1, Array2, Axis};

use crate::mouth::MouthSpace;

/// What the drawn mouth does. All in 0..1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Lips apart.
    pub open: f32,
    /// Corners drawn together and lips pushed forward, as in "who".
    pub round: f32,
    /// Corners drawn apart, as in "see".
    pub spread: f32,
}

/// Width of a drawn mouth in pixels.
pub const WIDTH: usize = 64;
/// Height of a drawn mouth in pixels.
pub const HEIGHT: usize = 48;

const SKIN: [f32; 3] = [214.0, 168.0, 146.0];
const LIPS: [f32; 3] = [178.0, 92.0, 92.0];
const INSIDE: [f32; 3] = [62.0, 22.0, 26.0];
const TEETH: [f32; 3] = [236.0, 230.0, 218.0];
const TONGUE: [f32; 3] = [176.0, 84.0, 88.0];

/// Rows of interleaved R, G, B in 0..255, `[HEIGHT·WIDTH·3]`.
pub fn draw(pose: Pose) -> Array1<f32> {
    let half_width = 20.0 - 9.0 * pose.round + 4.0 * pose.spread;
    let gap = 0.4 + 11.0 * pose.open * (1.0 - 0.35 * pose.round);
    let lip = 3.6 + 2.2 * pose.round - 0.8 * pose.spread;
    let mut image = Array1::zeros(WIDTH * HEIGHT * 3);
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let x = (column as f32 + 0.5 - WIDTH as f32 / 2.0) / half_width;
            let y = row as f32 + 0.5 - HEIGHT as f32 * 0.46;
            // Half height of opening and lips at this column: arcs that close at the corners.
            let arc = (1.0 - x * x).max(0.0).sqrt();
            let (up, down) = (-gap * 0.4 * arc, gap * 0.6 * arc);
            let bow = 1.0 - 0.35 * (-(x / 0.16).powi(2)).exp();
            let (top, bottom) = (up - lip * 0.8 * bow * arc, down + lip * 1.25 * arc);
            let shade = 1.0 - 0.10 * (row as f32 / HEIGHT as f32 - 0.3).abs() - 0.05 * x.abs().min(1.5);
            let mut colour = SKIN;
            blend(&mut colour, LIPS, within(y, top, bottom));
            let inside = within(y, up, down) * smooth(gap - 0.9);
            blend(&mut colour, INSIDE, inside);
            blend(&mut colour, TEETH, inside * within(y, up - 1.0, up + 2.6));
            blend(
                &mut colour,
                TONGUE,
                inside * within(y, down - 2.4 * pose.open, down + 1.0) * 0.8,
            );
            let pixel = 3 * (row * WIDTH + column);
            for k in 0..3 {
                image[pixel + k] = (colour[k] * shade).clamp(0.0, 255.0);
            }
        }
    }
    image
}

fn blend(colour: &mut [f32; 3], with: [f32; 3], amount: f32) {
    for (c, w) in colour.iter_mut().zip(with) {
        *c += amount * (w - *c);
    }
}

/// 0 below −½, 1 above ½, smooth between: an edge one pixel soft.
fn smooth(x: f32) -> f32 {
    let x = (x + 0.5).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn within(y: f32, from: f32, to: f32) -> f32 {
    (smooth(y - from) * smooth(to - y)).min(smooth(to - from))
}

/// Orthonormal directions in which the rows of `centred` differ, `[size, pixels]`: the row that is least explained by the
/// directions so far gives the next one.
fn directions(centred: &Array2<f32>, size: usize) -> Array2<f32> {
    let mut left = centred.clone();
    let mut basis = Array2::zeros((size, centred.ncols()));
    for mut direction in basis.outer_iter_mut() {
        let norms = left.outer_iter().map(|row| row.dot(&row));
        let Some((most, square)) = norms.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) else {
            break;
        };
        direction.assign(&(&left.row(most) / square.sqrt().max(1e-6)));
        for mut row in left.outer_iter_mut() {
            let along = row.dot(&direction);
            row.scaled_add(-along, &direction);
        }
    }
    basis
}

/// A space of `size` numbers spanned by from drawn mouths in 5 × 5 × 3 poses.
pub fn space(size: usize) -> MouthSpace {
    let mut poses = Vec::new();
    for open in 0..5 {
        for round in 0..5 {
            for spread in 0..3 {
                poses.push(Pose {
                    open: open as f32 / 4.0,
                    round: round as f32 / 4.0,
                    spread: spread as f32 / 2.0 * (1.0 - round as f32 / 4.0),
                });
            }
        }
    }
    let pixels = WIDTH * HEIGHT * 3;
    let mut images = Array2::zeros((poses.len(), pixels));
    for (mut row, &pose) in images.outer_iter_mut().zip(&poses) {
        row.assign(&draw(pose));
    }
    let mean = images.mean_axis(Axis(0)).expect("there are poses");
    let centred = &images - &mean;
    let size = size.min(poses.len() - 1);
    let basis = directions(&centred, size);
    let weights = centred.dot(&basis.t());
    let deviation = weights
        .mapv(|w| w * w)
        .mean_axis(Axis(0))
        .expect("there are poses")
        .mapv(f32::sqrt);
    MouthSpace {
        width: WIDTH,
        height: HEIGHT,
        mean,
        basis,
        deviation,
    }
}

/// `frames` frames of somebody saying nothing in particular, `[frames, D]` at 100 Hz in the numbers of `space`.
pub fn babble(space: &MouthSpace, frames: usize) -> Array2<f32> {
    let mut tracks = Array2::zeros((frames, space.size()));
    for (t, mut row) in tracks.outer_iter_mut().enumerate() {
        let s = t as f32 / 100.0;
        let round = (0.5 + 0.5 * (s * 4.1).sin()).powi(2);
        let pose = Pose {
            open: (0.5 - 0.5 * (s * 17.0).cos()) * (0.6 + 0.4 * (s * 2.3).sin()),
            round,
            spread: (1.0 - round) * (0.5 + 0.5 * (s * 5.3).cos()),
        };
        row.assign(&space.project(draw(pose).view()));
    }
    tracks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_space_is_orthonormal_and_holds_its_mouths() {
        let space = space(20);
        let gram = space.basis.dot(&space.basis.t());
        for ((i, j), value) in gram.indexed_iter() {
            let want = if i == j { 1.0 } else { 0.0 };
            assert!((value - want).abs() < 1e-3, "{i} {j} {value}");
        }
        let image = draw(Pose {
            open: 0.6,
            round: 0.3,
            spread: 0.2,
        });
        let back = space.expand(space.project(image.view()).view());
        let error = (&back - &image).mapv(|v| v * v).mean().unwrap().sqrt();
        assert!(error < 6.0, "{error} levels");
    }

    #[test]
    fn an_open_mouth_is_darker_inside_than_a_closed_one() {
        let middle = 3 * ((HEIGHT / 2 + 1) * WIDTH + WIDTH / 2);
        let pose = |open| Pose {
            open,
            round: 0.0,
            spread: 0.0,
        };
        assert!(draw(pose(1.0))[middle] + 40.0 < draw(pose(0.0))[middle]);
    }
}
