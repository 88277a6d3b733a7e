//! By how much a mouth image lies beside another: Lucas and Kanade's estimate of a translation.
use super::image::Plane;

/// Steps of Gauss and Newton.
const STEPS: usize = 4;
/// Pixels at the border that are left out.
const BORDER: usize = 2;

/// Luminance of an image `[height, width, 3]`.
pub(crate) fn luminance(image: &[u8], width: usize, height: usize) -> Plane {
    Plane::from_fn(width, height, |x, y| {
        let at = 3 * (y * width + x);
        0.299 * f32::from(image[at]) + 0.587 * f32::from(image[at + 1]) + 0.114 * f32::from(image[at + 2])
    })
}

/// The mean of images of one size; None where there is none.
pub(crate) fn mean(images: &[Plane]) -> Option<Plane> {
    let mut sum = images.first()?.clone();
    for image in &images[1..] {
        sum.data.iter_mut().zip(&image.data).for_each(|(s, v)| *s += v);
    }
    sum.data.iter_mut().for_each(|s| *s /= images.len() as f32);
    Some(sum)
}

/// How far `image` lies to the right of and below `of`, in pixels; None where `of` has no edges to tell it by.
pub(crate) fn shift(image: &Plane, of: &Plane) -> Option<(f32, f32)> {
    let inner =
        || (BORDER..of.height - BORDER).flat_map(|y| (BORDER..of.width - BORDER).map(move |x| (x, y)));
    if of.width <= 2 * BORDER || of.height <= 2 * BORDER {
        return None;
    }
    let (mut xx, mut xy, mut yy) = (0.0f32, 0.0f32, 0.0f32);
    for (x, y) in inner() {
        let (gx, gy) = of.gradient(x, y);
        (xx, xy, yy) = (xx + gx * gx, xy + gx * gy, yy + gy * gy);
    }
    let determinant = xx * yy - xy * xy;
    if determinant < 1e-3 * xx * yy || xx.min(yy) < 1.0 {
        return None;
    }
    let (mut dx, mut dy) = (0.0f32, 0.0f32);
    for _ in 0..STEPS {
        let (mut bx, mut by) = (0.0f32, 0.0f32);
        for (x, y) in inner() {
            let (gx, gy) = of.gradient(x, y);
            let apart = of.at(x as i32, y as i32) - image.sample(x as f32 + dx, y as f32 + dy);
            (bx, by) = (bx + gx * apart, by + gy * apart);
        }
        dx += (yy * bx - xy * by) / determinant;
        dy += (xx * by - xy * bx) / determinant;
    }
    Some((dx, dy))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shift_of_part_of_a_pixel_is_found() {
        let hills = |x: f32, y: f32| 90.0 + 40.0 * (0.35 * x).sin() + 30.0 * (0.3 * y + 0.1 * x).cos();
        let of = Plane::from_fn(48, 36, |x, y| hills(x as f32, y as f32));
        for (right, down) in [(0.0, 0.0), (0.3, -0.2), (1.4, 0.8)] {
            let image = Plane::from_fn(48, 36, |x, y| hills(x as f32 - right, y as f32 - down));
            let (dx, dy) = shift(&image, &of).unwrap();
            assert!((dx - right).abs() < 0.03 && (dy - down).abs() < 0.03, "{dx} {dy}");
        }
        assert_eq!(shift(&of, &Plane::new(48, 36)), None);
    }
}
