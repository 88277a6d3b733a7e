//! AMSE and ACC (X&L eq. 20-21) over a whole set of frames.
use ndarray::Array2;

/// Sums over frames, from which every metric follows; two of them add up.
#[derive(Clone, Debug, PartialEq)]
pub struct Score {
    frames: f64,
    /// Σ ‖ô − o‖² and Σ ‖ô − o‖.
    squared: f64,
    norm: f64,
    actual: Vec<f64>,
    predicted: Vec<f64>,
    actual_squared: Vec<f64>,
    predicted_squared: Vec<f64>,
    product: Vec<f64>,
}

impl Score {
    /// Empty sums for a mouth of `size` parameters.
    pub fn new(size: usize) -> Self {
        let zeros = vec![0.0; size];
        Self {
            frames: 0.0,
            squared: 0.0,
            norm: 0.0,
            actual: zeros.clone(),
            predicted: zeros.clone(),
            actual_squared: zeros.clone(),
            predicted_squared: zeros.clone(),
            product: zeros,
        }
    }

    /// The score of one clip.
    pub fn of(actual: &Array2<f32>, predicted: &Array2<f32>) -> Self {
        let mut score = Self::new(actual.ncols());
        score.add(actual, predicted);
        score
    }

    /// Number of parameters D.
    pub fn size(&self) -> usize {
        self.actual.len()
    }

    /// Adds a clip, `[frames, D]` both; extra frames of the longer one are left out.
    pub fn add(&mut self, actual: &Array2<f32>, predicted: &Array2<f32>) {
        for (o, p) in actual.outer_iter().zip(predicted.outer_iter()) {
            let mut squared = 0.0;
            for (i, (&o, &p)) in o.iter().zip(p).enumerate() {
                let (o, p) = (f64::from(o), f64::from(p));
                squared += (o - p) * (o - p);
                self.actual[i] += o;
                self.predicted[i] += p;
                self.actual_squared[i] += o * o;
                self.predicted_squared[i] += p * p;
                self.product[i] += o * p;
            }
            self.frames += 1.0;
            self.squared += squared;
            self.norm += squared.sqrt();
        }
    }

    /// Adds the sums of other frames; both have the same number of parameters.
    pub fn merge(&mut self, other: &Score) {
        self.frames += other.frames;
        self.squared += other.squared;
        self.norm += other.norm;
        for (mine, theirs) in [
            (&mut self.actual, &other.actual),
            (&mut self.predicted, &other.predicted),
            (&mut self.actual_squared, &other.actual_squared),
            (&mut self.predicted_squared, &other.predicted_squared),
            (&mut self.product, &other.product),
        ] {
            mine.iter_mut().zip(theirs).for_each(|(a, b)| *a += b);
        }
    }

    /// Number of frames added so far.
    pub fn frames(&self) -> usize {
        self.frames as usize
    }

    /// Mean squared distance per frame. What the paper's name says (`docs/evaluation.md`).
    pub fn amse(&self) -> f64 {
        self.squared / self.frames
    }

    /// Mean distance per frame: eq. 20 as it is printed, without the square.
    pub fn mean_distance(&self) -> f64 {
        self.norm / self.frames
    }

    /// Correlation of every parameter with its prediction over all frames; 0 for a constant prediction.
    pub fn correlations(&self) -> Vec<f64> {
        (0..self.actual.len())
            .map(|i| {
                let n = self.frames;
                let (mean_o, mean_p) = (self.actual[i] / n, self.predicted[i] / n);
                let var_o = self.actual_squared[i] / n - mean_o * mean_o;
                let var_p = self.predicted_squared[i] / n - mean_p * mean_p;
                let covariance = self.product[i] / n - mean_o * mean_p;
                // Below this share of the actual's variance a prediction is constant but for rounding.
                if var_o > 0.0 && var_p > 1e-9 * var_o {
                    covariance / (var_o * var_p).sqrt()
                } else {
                    0.0
                }
            })
            .collect()
    }

    /// Average correlation coefficient (eq. 21).
    pub fn acc(&self) -> f64 {
        let each = self.correlations();
        each.iter().sum::<f64>() / each.len() as f64
    }

    /// ACC of the first `n` parameters, which carry most of the motion.
    pub fn acc_of_first(&self, n: usize) -> f64 {
        let each = self.correlations();
        let n = n.min(each.len());
        each[..n].iter().sum::<f64>() / n as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn by_hand() {
        let mut score = Score::new(2);
        score.add(
            &array![[0.0f32, 1.0], [2.0, 3.0]],
            &array![[3.0f32, 5.0], [2.0, 3.0]],
        );
        assert!((score.amse() - 12.5).abs() < 1e-12);
        assert!((score.mean_distance() - 2.5).abs() < 1e-12);
        let c = score.correlations();
        assert!((c[0] + 1.0).abs() < 1e-9 && (c[1] + 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_truth_scores_one_and_the_mean_zero() {
        let o = array![[0.0f32, 1.0], [2.0, 3.0], [5.0, -1.0]];
        let (mut truth, mut mean) = (Score::new(2), Score::new(2));
        truth.add(&o, &o);
        mean.add(&o, &array![[1.0f32, 1.0], [1.0, 1.0], [1.0, 1.0]]);
        assert!((truth.acc() - 1.0).abs() < 1e-9 && truth.amse() == 0.0);
        assert_eq!(mean.acc(), 0.0);
    }

    #[test]
    fn clips_add_up() {
        let (a, b) = (
            array![[0.0f32], [2.0], [5.0], [1.0]],
            array![[1.0f32], [2.5], [3.0], [0.0]],
        );
        let mut whole = Score::new(1);
        whole.add(&a, &b);
        let mut first = Score::new(1);
        first.add(
            &a.slice(ndarray::s![..1, ..]).to_owned(),
            &b.slice(ndarray::s![..1, ..]).to_owned(),
        );
        let mut rest = Score::new(1);
        rest.add(
            &a.slice(ndarray::s![1.., ..]).to_owned(),
            &b.slice(ndarray::s![1.., ..]).to_owned(),
        );
        first.merge(&rest);
        assert!((first.acc() - whole.acc()).abs() < 1e-12 && (first.amse() - whole.amse()).abs() < 1e-12);
    }
}
