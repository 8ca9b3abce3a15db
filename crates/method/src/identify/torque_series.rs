//! Measured and estimated torque of one cycle, row by row.
//!
//! The counted rows are those that [`super::joint_factors::factor_cycle`] folds in, and the estimate uses the same
//! columns, so the RMSD of the rows equals that of the factors.

use super::filtered_columns::{filtered_coulomb_columns, filtered_load_columns, write_filtered_columns};
use super::verify::TorqueSums;
use crate::NumericsError;
use crate::model::dynamics::DynamicModel;
use crate::model::regressor::{Regressor, joint_torque_regressor};
use crate::signal::filter::{FilteredSignals, state};
use armwatch_model::analysis::{Motion, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{JointIndex, ParameterId, Robot};
use armwatch_model::run::{Samples, Stage};

/// Rows that [`peaks`] keeps per bucket: the smallest and the largest of three series.
const ROWS_PER_BUCKET: usize = 6;

/// Selection of the rows of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SeriesRows {
    /// Rows that count in verification: usable, at the rate of the information after the low-pass.
    Counted,
    /// All low-passed rows.
    Filtered,
}

/// Torques of a cycle over time; all vectors have the same length `rows`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TorqueSeries {
    /// Time since the start of the recording, s.
    pub time: Vec<f64>,
    /// Stage of each row.
    pub stage: Vec<Stage>,
    /// True for rows that count in verification.
    pub counted: Vec<bool>,
    /// Channels of the joints `[n]`.
    pub joints: Vec<JointTorqueSeries>,
}

/// Channels of one joint `[rows]`, after the analysis low-pass.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JointTorqueSeries {
    /// Position `q`, rad (m).
    pub q: Vec<f64>,
    /// Velocity `qd`, rad/s (m/s).
    pub qd: Vec<f64>,
    /// Measured torque, Nm (N).
    pub measured: Vec<f64>,
    /// Torque from the parameters and the motion, Nm (N).
    pub estimated: Vec<f64>,
    /// True if the joint is at its low-speed threshold or faster.
    pub moving: Vec<bool>,
}

impl JointTorqueSeries {
    /// Measured minus estimated torque in `row`, Nm (N).
    #[must_use]
    pub fn residual(&self, row: usize) -> f64 {
        self.measured[row] - self.estimated[row]
    }
}

/// Measured torque and the torque from `parameters` for a cycle's motion: `tau = y theta` row by row. Columns with
/// jumps are low-passed like the torque ([`filtered_coulomb_columns`]).
///
/// `samples` are the cycle's rows, and `filtered` the same rows after the low-pass.
///
/// # Errors
/// [`NumericsError::ColumnsDiffer`] for a parameter without a column in the robot's regressor.
pub fn torque_series(
    robot: &Robot,
    parameters: &[(ParameterId, f64)],
    samples: &Samples,
    filtered: &FilteredSignals,
    rows: SeriesRows,
) -> Result<TorqueSeries, NumericsError> {
    let columns = columns_of(robot, parameters)?;
    let n = robot.joint_count();
    let mut counted = vec![false; filtered.rows()];
    filtered.observed_rows().for_each(|row| counted[row] = true);
    let mut filtered_coulomb_columns = filtered_coulomb_columns(robot, filtered);
    if robot.has_load_friction() {
        let model = DynamicModel::from_parameters(robot, parameters.iter().copied());
        filtered_coulomb_columns.extend(filtered_load_columns(robot, filtered, &model));
    }
    let mut series =
        TorqueSeries { joints: vec![JointTorqueSeries::default(); n], ..TorqueSeries::default() };
    let mut y = Regressor::new(robot);
    let (mut q, mut qd, mut qdd, mut tau) = state();
    for row in filtered.filtered_rows().filter(|&row| rows == SeriesRows::Filtered || counted[row]) {
        filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], &mut y);
        write_filtered_columns(&filtered_coulomb_columns, row, &mut y);
        series.time.push(samples.time[row]);
        series.stage.push(samples.stage[row]);
        series.counted.push(counted[row]);
        for (j, joint) in series.joints.iter_mut().enumerate() {
            joint.q.push(q[j]);
            joint.qd.push(qd[j]);
            joint.measured.push(tau[j]);
            joint.estimated.push(columns.iter().map(|&(column, value)| y.column(column)[j] * value).sum());
            joint.moving.push(Motion::of(qd[j], robot.joints[j].counted_speed()) == Motion::Moving);
        }
    }
    Ok(series)
}

/// Columns of the regressor with their parameters' values.
fn columns_of(robot: &Robot, parameters: &[(ParameterId, f64)]) -> Result<Vec<(usize, f64)>, NumericsError> {
    let order = ParameterId::natural_order(robot);
    let column = |&(id, value): &(ParameterId, f64)| {
        let place = order.iter().position(|of| *of == id);
        place.map(|place| (place, value)).ok_or_else(|| {
            NumericsError::ColumnsDiffer(format!("the model of {} has no parameter {id}", robot.model))
        })
    };
    parameters.iter().map(column).collect()
}

impl TorqueSeries {
    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.time.len()
    }

    /// Indices of the rows of a stage, or of all, in order.
    #[must_use]
    pub fn rows_of(&self, scope: RmsdScope) -> Vec<usize> {
        (0..self.rows()).filter(|&row| inside(scope, self.stage[row])).collect()
    }

    /// RMSD [5.1] of a joint over the counted rows of a stage or of the whole cycle; zero samples if there are no such
    /// rows.
    #[must_use]
    pub fn rmsd(&self, joint: JointIndex, scope: RmsdScope) -> TorqueRmsd {
        let (mut all, mut moving) = (TorqueSums::default(), TorqueSums::default());
        let Some(of_joint) = self.joints.get(joint.index()) else {
            return TorqueRmsd { joint, scope, all_rows: all.rmsd(), moving_rows: moving.rmsd() };
        };
        for row in (0..self.rows()).filter(|&row| self.counted[row] && inside(scope, self.stage[row])) {
            let sums = TorqueSums {
                deviation: of_joint.residual(row).powi(2),
                measured: of_joint.measured[row].powi(2),
                rows: 1,
            };
            all = all.joined(sums);
            if of_joint.moving[row] {
                moving = moving.joined(sums);
            }
        }
        TorqueRmsd { joint, scope, all_rows: all.rmsd(), moving_rows: moving.rmsd() }
    }
}

fn inside(scope: RmsdScope, stage: Stage) -> bool {
    match scope {
        RmsdScope::WholeCycle => true,
        RmsdScope::Stage(of) => stage == of,
    }
}

/// Thins `rows` of a joint for a plot to at most `most` without losing a peak. It keeps the first and the last row, and
/// from each of several stretches of equal length the rows with the smallest and the largest measured torque, estimated
/// torque and residual. There is at least one stretch, so up to eight rows may remain even if `most` is smaller. The
/// order is kept.
#[must_use]
pub fn peaks(series: &JointTorqueSeries, rows: &[usize], most: usize) -> Vec<usize> {
    if rows.len() <= most {
        return rows.to_vec();
    }
    let buckets = (most.saturating_sub(2) / ROWS_PER_BUCKET).max(1);
    let mut kept: Vec<usize> = rows.first().into_iter().chain(rows.last()).copied().collect();
    for bucket in rows.chunks(rows.len().div_ceil(buckets)) {
        kept.extend(ends(bucket, |row| series.measured[row]));
        kept.extend(ends(bucket, |row| series.estimated[row]));
        kept.extend(ends(bucket, |row| series.residual(row)));
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// Rows with the smallest and the largest value.
fn ends(rows: &[usize], value: impl Fn(usize) -> f64) -> impl Iterator<Item = usize> {
    let by_value = |a: &&usize, b: &&usize| value(**a).total_cmp(&value(**b));
    let (smallest, largest) = (rows.iter().min_by(by_value), rows.iter().max_by(by_value));
    smallest.into_iter().chain(largest).copied().collect::<Vec<_>>().into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::Method;
    use crate::identify::joint_factors::factor_cycle;
    use crate::identify::verify::torque_rmsd;
    use crate::signal::filter::filter_signals;
    use armwatch_model::analysis::settings::AnalysisSettings;
    use armwatch_testing::cycle::cycle;
    use armwatch_testing::er3a;

    /// Tolerance between sums of some hundred squares and norms of triangular factors of the same rows.
    const EQUAL: f64 = 1e-9;

    fn parameters(method: &Method) -> Vec<(ParameterId, f64)> {
        (method.base.kept.iter().enumerate()).map(|(k, id)| (*id, 1.0 + (k * 7919 % 13) as f64)).collect()
    }

    #[test]
    fn rmsd_of_the_rows_is_that_of_the_factors() {
        let method = Method::new(er3a(), AnalysisSettings::default()).expect("base parameters");
        let cycle = cycle(1, 1200);
        let filtered = filter_signals(&cycle.samples, 12.0).expect("long enough");
        let parameters = parameters(&method);
        let theta: Vec<f64> = parameters.iter().map(|(_, value)| *value).collect();
        let kept = &method.base.kept_columns;
        let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &filtered);
        let factored = factor_cycle(
            &method.robot,
            &method.columns,
            kept,
            &filtered,
            &filtered_coulomb_columns,
            &cycle.samples,
        );
        let expected = torque_rmsd(&method.columns, &factored.factors, &theta);
        assert_eq!(expected.len(), 24);
        for rows in [SeriesRows::Counted, SeriesRows::Filtered] {
            let series = torque_series(&method.robot, &parameters, &cycle.samples, &filtered, rows)
                .expect("the robot's parameters");
            for expected in &expected {
                let found = series.rmsd(expected.joint, expected.scope);
                for (found, expected) in
                    [(found.all_rows, expected.all_rows), (found.moving_rows, expected.moving_rows)]
                {
                    assert_eq!(found.samples, expected.samples);
                    assert!((found.value - expected.value).abs() <= EQUAL * expected.value);
                    assert!((found.relative - expected.relative).abs() <= EQUAL * expected.relative);
                }
            }
        }
    }

    #[test]
    fn all_rows_are_the_cycles_and_hold_the_counted_ones() {
        let robot = er3a();
        let cycle = cycle(1, 400);
        let filtered = filter_signals(&cycle.samples, 4.0).expect("long enough");
        let of = |rows| torque_series(&robot, &[], &cycle.samples, &filtered, rows).expect("no parameters");
        let (counted, all) = (of(SeriesRows::Counted), of(SeriesRows::Filtered));
        assert_eq!(all.rows(), 400);
        assert_eq!(counted.rows(), filtered.observed_rows().count());
        let chosen: Vec<f64> =
            (0..400).filter(|&row| all.counted[row]).map(|row| all.joints[2].measured[row]).collect();
        assert_eq!(counted.joints[2].measured, chosen);
        // 60 rows per second and a low-pass at 4 Hz: every second row
        assert!(counted.rows() < 200 && counted.counted.iter().all(|&counted| counted));
    }

    #[test]
    fn a_parameter_of_another_robot_is_refused() {
        let robot = er3a();
        let cycle = cycle(1, 200);
        let filtered = filter_signals(&cycle.samples, 12.0).expect("long enough");
        let kind = ParameterId::natural_order(&robot)[0].kind;
        let foreign = ParameterId { joint: JointIndex::new(7), kind };
        let error = torque_series(&robot, &[(foreign, 1.0)], &cycle.samples, &filtered, SeriesRows::Counted)
            .expect_err("no such joint");
        assert!(error.to_string().contains("no parameter J8"), "{error}");
    }

    #[test]
    fn thinned_rows_keep_every_peak_and_their_order() {
        let rows: Vec<usize> = (0..1000).collect();
        let wave = |i: usize| (i as f64 * 0.013).sin();
        let mut series = JointTorqueSeries {
            measured: rows.iter().map(|&i| wave(i)).collect(),
            estimated: rows.iter().map(|&i| 0.9 * wave(i)).collect(),
            ..JointTorqueSeries::default()
        };
        series.measured[137] = 9.0;
        series.estimated[512] = -7.0;
        let kept = peaks(&series, &rows, 60);
        assert!(kept.len() <= 60 && kept.len() >= 20, "{}", kept.len());
        assert!(kept.windows(2).all(|pair| pair[0] < pair[1]));
        for row in [0, 137, 512, 999] {
            assert!(kept.contains(&row), "{row}");
        }
        assert_eq!(peaks(&series, &rows[..40], 60), &rows[..40]);
        assert!(peaks(&series, &rows, 0).len() <= 8);
        assert!(peaks(&series, &[], 10).is_empty());
    }
}
