//! Parameters and deviations of a cycle directly from its rows, without factors: the second method of tests.

use faer::Mat;
use faer::linalg::solvers::SolveLstsq;

use armwatch_method::analyse::Method;
use armwatch_method::identify::filtered_columns::{filtered_coulomb_columns, write_filtered_columns};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_method::model::regressor::{Regressor, joint_torque_regressor};
use armwatch_method::signal::filter::{FilteredSignals, filter_signals};
use armwatch_model::analysis::{Rmsd, RmsdScope, TorqueRmsd};
use armwatch_model::run::{Cycle, Stage};

/// Bound of the rounding error of a QR of some thousand rows, times the condition of the problem.
const EQUAL: f64 = 1e-9;

/// Parameters by another method: the whole observation matrix of moving excitation rows, scaled, in one dense
/// least-squares problem.
pub fn raw_parameters(method: &Method, cycles: &[&Cycle]) -> Vec<f64> {
    let columns = &method.base.kept_columns;
    let (mut w, mut right) = (Vec::new(), Vec::new());
    let mut y = Regressor::new(&method.robot);
    for cycle in cycles {
        let c = filter_signals(&cycle.samples, 12.0).expect("long enough");
        let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &c);
        for row in c.observed_rows().filter(|&row| cycle.samples.stage[row] == Stage::Excitation) {
            let of = |channels: &[Vec<f64>]| channels.iter().map(|ch| ch[row]).collect::<Vec<f64>>();
            let (q, qd, qdd) = (of(&c.q), of(&c.qd), of(&c.qdd));
            joint_torque_regressor(&method.robot, &q, &qd, &qdd, &mut y);
            write_filtered_columns(&filtered_coulomb_columns, row, &mut y);
            for j in (0..6).filter(|&j| qd[j].abs() >= method.robot.joints[j].low_speed) {
                w.push(columns.iter().map(|&column| y.column(column)[j]).collect::<Vec<f64>>());
                right.push(c.tau[j][row]);
            }
        }
    }
    let norm = |k: usize| w.iter().map(|row| row[k] * row[k]).sum::<f64>().sqrt();
    let norms: Vec<f64> = (0..columns.len()).map(norm).collect();
    let scaled = Mat::from_fn(w.len(), columns.len(), |i, k| w[i][k] / norms[k]);
    let right = Mat::from_fn(right.len(), 1, |i, _| right[i]);
    let solved = scaled.col_piv_qr().solve_lstsq(&right);
    (0..columns.len()).map(|k| solved[(k, 0)] / norms[k]).collect()
}

/// Compares relative to the norm of the parameters: parameters near zero have no exact digits.
pub fn assert_equal(found: &[f64], expected: &[f64]) {
    let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= EQUAL * norm, "{found} {expected}");
    }
}

/// RMSD by another method: inverse dynamics with `theta`, row by row.
pub struct Direct<'a> {
    method: &'a Method,
    cycle: &'a Cycle,
    c: FilteredSignals,
    estimated: Vec<Vec<f64>>,
}

impl<'a> Direct<'a> {
    /// Torques of the cycle by the parameters `theta` `[b]`.
    #[must_use]
    pub fn new(method: &'a Method, cycle: &'a Cycle, theta: &[f64]) -> Self {
        let c = filter_signals(&cycle.samples, 12.0).expect("long enough");
        let n = method.robot.joint_count();
        // the torque of filtered columns is added low-passed, in place of their inverse dynamics
        let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &c);
        let parameters = || method.base.kept.iter().copied().zip(theta.iter().copied());
        let steady =
            parameters().filter(|(id, _)| filtered_coulomb_columns.iter().all(|jump| jump.id != *id));
        let model = DynamicModel::from_parameters(&method.robot, steady);
        let mut estimated = vec![vec![0.0; n]; c.rows()];
        for (row, estimated) in estimated.iter_mut().enumerate() {
            let of = |channels: &[Vec<f64>]| channels.iter().map(|ch| ch[row]).collect::<Vec<f64>>();
            model.torque(&method.robot, &of(&c.q), &of(&c.qd), &of(&c.qdd), estimated);
            for (jump, (_, value)) in filtered_coulomb_columns
                .iter()
                .flat_map(|jump| parameters().find(|(id, _)| *id == jump.id).map(|found| (jump, found)))
            {
                estimated[jump.joint.index()] += value * jump.values[row];
            }
        }
        Self { method, cycle, c, estimated }
    }

    /// Compares a deviation of joint `j` with that over the rows chosen by `chosen`.
    pub fn assert_rmsd(&self, j: usize, found: Rmsd, chosen: impl Fn(usize) -> bool) {
        let rows: Vec<usize> = self.c.observed_rows().filter(|&row| chosen(row)).collect();
        assert_eq!(found.samples, rows.len());
        if rows.is_empty() {
            return;
        }
        let rms = |of: &dyn Fn(usize) -> f64| {
            (rows.iter().map(|&row| of(row).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
        };
        let rmsd = rms(&|row| self.estimated[row][j] - self.c.tau[j][row]);
        let relative = rmsd / rms(&|row| self.c.tau[j][row]);
        assert!((found.value - rmsd).abs() <= EQUAL * rmsd, "{found:?} {rmsd}");
        assert!((found.relative - relative).abs() <= EQUAL * relative, "{found:?} {relative}");
    }

    /// Compares all deviations of a self-verification.
    pub fn assert_verification(&self, verification: &[TorqueRmsd]) {
        assert_eq!(verification.len(), 24);
        for found in verification {
            let j = found.joint.index();
            let inside = |row: usize| match found.scope {
                RmsdScope::WholeCycle => true,
                RmsdScope::Stage(stage) => self.cycle.samples.stage[row] == stage,
            };
            let low_speed = self.method.robot.joints[j].low_speed;
            let counted = self.c.observed_rows().filter(|row| inside(*row)).count();
            assert_eq!(found.all_rows.samples, counted, "rows of joint {} in {:?}", found.joint, found.scope);
            self.assert_rmsd(j, found.all_rows, inside);
            self.assert_rmsd(j, found.moving_rows, |row| inside(row) && self.c.qd[j][row].abs() >= low_speed);
        }
    }
}
