//! Rows of `[w | tau]` that can be gone through again and again, a sample at a time, so that
//! estimators with several passes never hold the observation matrix.

use super::factor::{FactorBuilder, TriangularFactor};

/// All joints' rows of one sample.
#[derive(Debug, Clone, Copy)]
pub struct SampleRows<'a> {
    /// Number of the observation; neighbours in time differ by one, more where rows are left out.
    pub row: usize,
    /// Rows of `w`, joint after joint, `[n * b]`.
    pub w: &'a [f64],
    /// Torque, `[n]`.
    pub tau: &'a [f64],
    /// Whether a joint's row takes part, `[n]`.
    pub used: &'a [bool],
}

impl SampleRows<'_> {
    /// The row of `w` that belongs to `joint`, `[b]`.
    #[must_use]
    pub fn of_joint(&self, joint: usize) -> &[f64] {
        let b = self.w.len() / self.tau.len().max(1);
        &self.w[joint * b..(joint + 1) * b]
    }

    /// `tau - w theta` of `joint`, Nm.
    #[must_use]
    pub fn residual(&self, joint: usize, theta: &[f64]) -> f64 {
        self.tau[joint] - self.of_joint(joint).iter().zip(theta).map(|(w, theta)| w * theta).sum::<f64>()
    }
}

/// A least-squares problem whose rows come in order of time, as often as asked.
pub trait RowSource {
    /// Columns `b` of `w`.
    fn columns(&self) -> usize;
    /// Rows of a sample, `n`.
    fn joint_count(&self) -> usize;
    /// Hands every sample to `visit`, in order of time.
    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>));
}

/// Triangular factor of each joint's rows, `[n]`.
#[must_use]
pub fn joint_factors(source: &dyn RowSource) -> Vec<TriangularFactor> {
    let n = source.joint_count();
    let mut folders: Vec<FactorBuilder> = (0..n).map(|_| FactorBuilder::new(source.columns())).collect();
    source.each(&mut |sample| {
        for (j, folder) in folders.iter_mut().enumerate().filter(|(j, _)| sample.used[*j]) {
            folder.push(sample.of_joint(j).iter().copied().chain([sample.tau[j]]));
        }
    });
    folders.iter_mut().map(FactorBuilder::take).collect()
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;

    #[test]
    fn temporary_measure_of_the_change() {
        let (rows, b) = (20_000, 12);
        let value = |i: usize, k: usize| {
            ((i as f64) * 0.0137 * (k as f64 + 1.3)).sin() * (1.0 + k as f64)
                + ((i * 7919 + k * 104_729) % 1009) as f64 * 1e-3
        };
        let mut new = FactorBuilder::new(b);
        let mut old = TriangularFactor::new(b);
        for i in 0..rows {
            new.push((0..=b).map(|k| value(i, k)));
        }
        for from in (0..rows).step_by(2048) {
            let count = 2048.min(rows - from);
            old.fold(Mat::from_fn(count, b + 1, |i, k| value(from + i, k)).as_ref());
        }
        let theta = |of: &TriangularFactor| of.solve(1e12, |k| k.to_string()).expect("solved").theta;
        let (x, y) = (theta(&old), theta(&new.take()));
        let change = x.iter().zip(&y).map(|(x, y)| ((x - y) / x).abs()).fold(0.0, f64::max);
        eprintln!("largest relative change {change:e}");
    }
}
