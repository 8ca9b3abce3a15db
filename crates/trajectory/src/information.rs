//! Information of recordings about an arm's base parameters under white noise, and its sum over recordings: `w' w` with
//! rows divided by the noise of their joint (the Fisher information of the linear model).

use faer::{Mat, Scale, Side};

use super::recorded_rows::{RecordingPlan, recorded_factors};
use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::{FactorColumns, JointFactor};
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_model::robot::{FourierExcitation, ParameterId, Robot};

/// Standard deviation, in sizes of the parameter, above which the parameter counts as not identified.
pub const UNSEEN: f64 = 10.0;

/// Eigenvalues below this share of the largest are rounding.
const ROUNDING: f64 = 1e-14;

/// Information about the base parameters, symmetric `[b x b]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Information(Mat<f64>);

impl Information {
    /// No information about `parameters` parameters.
    pub fn none(parameters: usize) -> Self {
        Self(Mat::zeros(parameters, parameters))
    }

    /// Information of a recording of a series.
    ///
    /// # Errors
    /// Those of [`recorded_factors`].
    pub fn of_series(
        robot: &Robot,
        base: &BaseParameters,
        series: &FourierExcitation,
        recording: &RecordingPlan,
    ) -> Result<Self, NumericsError> {
        let b = base.kept.len();
        let mut information = Self::none(b);
        let factors = recorded_factors(robot, base, series, recording)?;
        for (factor, noise) in factors.iter().zip(&recording.noise) {
            let own = factor.upper().submatrix(0, 0, b, b);
            information.0 += Scale(1.0 / (noise * noise)) * (own.transpose() * own);
        }
        Ok(information)
    }

    /// Information of the rows of `factors`, at the noise of each joint's torque signal `[n]`, Nm (N).
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] for a factor with other columns than its joint has.
    pub fn of_factors(
        base: &BaseParameters,
        columns: &FactorColumns,
        factors: &[JointFactor],
        noise: &[f64],
    ) -> Result<Self, NumericsError> {
        let mut information = Self::none(base.kept.len());
        for JointFactor { joint, factor, .. } in factors {
            let ids = columns.by_joint().get(joint.index()).filter(|ids| ids.len() == factor.columns());
            let Some(ids) = ids else {
                return Err(NumericsError::ColumnsDiffer(format!(
                    "joint {joint} has factors of other columns"
                )));
            };
            let place = |id: &ParameterId| base.kept.iter().position(|kept| kept == id);
            let known: Vec<(usize, usize)> =
                ids.iter().enumerate().filter_map(|(k, id)| Some((k, place(id)?))).collect();
            let (upper, weight) = (factor.upper(), 1.0 / (noise[joint.index()] * noise[joint.index()]));
            for &(i, row) in &known {
                for &(k, column) in &known {
                    let sum: f64 = (0..=i.min(k)).map(|l| upper[(l, i)] * upper[(l, k)]).sum();
                    information.0[(row, column)] += weight * sum;
                }
            }
        }
        Ok(information)
    }

    /// Indices of the essential parameters. The parameter with the largest standard deviation relative to its entry in
    /// `values` is assumed to be zero and dropped, then the next, until none is above `relative` (Pham & Gautier 1991,
    /// Essential parameters of robots).
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if the eigenvalues cannot be computed.
    ///
    /// # Panics
    /// If there are fewer values than parameters.
    pub fn essential(&self, values: &[f64], relative: f64) -> Result<Vec<usize>, NumericsError> {
        // a parameter with the value zero has an infinite relative deviation
        let mut left: Vec<usize> = (0..values.len()).filter(|k| values[*k] != 0.0).collect();
        while !left.is_empty() {
            let own = Self(Mat::from_fn(left.len(), left.len(), |i, k| self.0[(left[i], left[k])]));
            let sizes: Vec<f64> = left.iter().map(|k| values[*k].abs()).collect();
            let deviations = own.standard_deviations(&sizes)?;
            let ratio = |k: usize| deviations[k].map_or(f64::INFINITY, |std| std / sizes[k]);
            let worst = (0..left.len()).max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)));
            match worst.filter(|worst| ratio(*worst) > relative) {
                Some(worst) => left.remove(worst),
                None => break,
            };
        }
        Ok(left)
    }

    /// Combined information, if the noise of both is independent.
    ///
    /// # Panics
    /// If they have different numbers of parameters.
    pub fn with(&self, other: &Self) -> Self {
        Self(&self.0 + &other.0)
    }

    /// Information of `rows` times as many rows.
    pub fn times(&self, rows: f64) -> Self {
        Self(Scale(rows) * &self.0)
    }

    /// The matrix, to be added to a product of rows.
    pub(super) fn matrix(&self) -> &Mat<f64> {
        &self.0
    }

    /// Standard deviations of the parameters `[b]`, each compared with a size above 0; `None` if one is more than
    /// [`UNSEEN`] sizes.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if eigenvalues cannot be computed.
    pub fn standard_deviations(&self, sizes: &[f64]) -> Result<Vec<Option<f64>>, NumericsError> {
        let b = sizes.len();
        let scaled = Mat::from_fn(b, b, |i, k| sizes[i] * self.0[(i, k)] * sizes[k]);
        let eigen = scaled
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| NumericsError::NotFinite("what is known of the parameters"))?;
        let values: Vec<f64> = eigen.S().column_vector().iter().copied().collect();
        let floor = ROUNDING * values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let deviation = |k: usize| {
            let variance: f64 = (0..b).map(|i| eigen.U()[(k, i)].powi(2) / values[i].max(floor)).sum();
            Some(variance.sqrt()).filter(|of| *of <= UNSEEN).map(|of| sizes[k] * of)
        };
        Ok((0..b).map(deviation).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::prediction::predict;
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_testing::er3a;

    #[test]
    fn two_recordings_tell_what_one_of_both_periods_does() {
        let robot = er3a();
        let base = base_parameters(&robot).expect("base parameters");
        let series = robot.excitation.clone().expect("Table 4.1");
        let recording = |periods: u32| RecordingPlan {
            sample_rate_hz: 50.0,
            periods,
            cutoff_hz: 12.0,
            noise: vec![0.3; 6],
        };
        let one = Information::of_series(&robot, &base, &series, &recording(1)).expect("rows");
        let sizes = vec![1e3; base.kept.len()];
        let by_hand = one.with(&one.times(2.0)).standard_deviations(&sizes).expect("deviations");
        let expected = predict(&robot, &base, &series, &recording(3)).expect("a prediction");
        for (found, expected) in by_hand.iter().zip(&expected.standard_deviations) {
            let found = found.expect("seen");
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
        }
    }

    /// Checked by hand: of two parameters that appear together, dropping one makes the other certain.
    #[test]
    fn parameters_that_are_not_worth_their_uncertainty_are_left_out_one_by_one() {
        let matrix =
            Mat::from_fn(3, 3, |i, k| [[100.0, 99.0, 0.0], [99.0, 100.0, 0.0], [0.0, 0.0, 1.0]][i][k]);
        let information = Information(matrix);
        // together, the first two have standard deviations of 0.71 each, alone 0.1
        let together = information.standard_deviations(&[1.0; 3]).expect("deviations");
        assert!((together[0].expect("seen") - (100.0_f64 / 199.0).sqrt()).abs() < 1e-12, "{together:?}");
        let of = |values: [f64; 3]| information.essential(&values, 0.2).expect("a choice");
        assert_eq!(of([1.0, 0.5, 100.0]), [0, 2]);
        assert_eq!(of([10.0, 5.0, 100.0]), [0, 1, 2]);
        assert_eq!(of([1.0, 0.5, 1.0]), [0]);
        assert!(of([0.0, 0.0, 0.0]).is_empty());
    }

    #[test]
    fn what_a_motion_does_not_show_is_not_seen() {
        let robot = er3a();
        let base = base_parameters(&robot).expect("base parameters");
        let mut series = robot.excitation.clone().expect("Table 4.1");
        // the first joint is at rest
        series.a[0].iter_mut().chain(&mut series.b[0]).for_each(|of| *of = 0.0);
        let recording =
            RecordingPlan { sample_rate_hz: 50.0, periods: 1, cutoff_hz: 12.0, noise: vec![0.3; 6] };
        let found = Information::of_series(&robot, &base, &series, &recording).expect("rows");
        let deviations = found.standard_deviations(&vec![1.0; base.kept.len()]).expect("deviations");
        let seen = |name: &str| {
            let place = base.kept.iter().position(|id| id.to_string() == name).expect("a parameter");
            deviations[place].is_some()
        };
        assert!(!seen("J1_f1") && !seen("J1_f2") && seen("J2_f1") && seen("J3_f2"), "{deviations:?}");
        assert!(Information::none(2).standard_deviations(&[1.0; 2]).expect("none") == [None, None]);
    }
}
