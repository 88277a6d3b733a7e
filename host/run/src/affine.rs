//! Affine maps of the plane. Pixel centres lie at whole numbers.

/// x' = a·x + b·y + c, y' = d·x + e·y + f, kept as [a, b, c, d, e, f].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine(pub [f32; 6]);

impl Affine {
    /// The map that leaves every point where it is.
    pub const IDENTITY: Affine = Affine([1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);

    /// p ↦ scale·p + (x, y).
    pub fn scaled(scale: f32, x: f32, y: f32) -> Self {
        Affine([scale, 0.0, x, 0.0, scale, y])
    }

    /// Where the point (x, y) goes.
    pub fn apply(&self, x: f32, y: f32) -> (f32, f32) {
        let [a, b, c, d, e, f] = self.0;
        (a * x + b * y + c, d * x + e * y + f)
    }

    /// The map that does `first`, then `self`.
    pub fn after(&self, first: &Affine) -> Affine {
        let [a, b, c, d, e, f] = self.0;
        let [p, q, r, s, t, u] = first.0;
        Affine([
            a * p + b * s,
            a * q + b * t,
            a * r + b * u + c,
            d * p + e * s,
            d * q + e * t,
            d * r + e * u + f,
        ])
    }

    /// Nothing for a map that is (nearly) singular or not finite.
    pub fn inverse(&self) -> Option<Affine> {
        let [a, b, c, d, e, f] = self.0;
        let determinant = a * e - b * d;
        if !(determinant.is_finite() && determinant.abs() > 1e-6) {
            return None;
        }
        let [p, q, s, t] = [e, -b, -d, a].map(|v| v / determinant);
        Some(Affine([p, q, -(p * c + q * f), s, t, -(s * c + t * f)]))
    }

    /// Σ weight·map / Σ weight, entry by entry.
    pub fn mean<'a>(maps: impl IntoIterator<Item = (&'a Affine, f32)>) -> Option<Affine> {
        let (mut sum, mut total) = ([0.0f64; 6], 0.0f64);
        for (map, weight) in maps {
            for (s, v) in sum.iter_mut().zip(map.0) {
                *s += f64::from(v) * f64::from(weight);
            }
            total += f64::from(weight);
        }
        (total > 0.0).then(|| Affine(sum.map(|s| (s / total) as f32)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_composition() {
        let m = Affine([1.1, 0.2, 5.0, -0.1, 0.9, -3.0]);
        let n = Affine([0.7, -0.3, 1.0, 0.4, 1.2, 2.0]);
        let (x, y) = n.apply(3.0, -7.0);
        let (x, y) = m.apply(x, y);
        let (cx, cy) = m.after(&n).apply(3.0, -7.0);
        assert!((x - cx).abs() < 1e-5 && (y - cy).abs() < 1e-5);
        let (bx, by) = m.inverse().unwrap().apply(x, y);
        let (nx, ny) = n.apply(3.0, -7.0);
        assert!((bx - nx).abs() < 1e-4 && (by - ny).abs() < 1e-4);
        assert!(Affine([1.0, 2.0, 0.0, 2.0, 4.0, 0.0]).inverse().is_none());
    }
}
