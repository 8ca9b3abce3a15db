use faer::Mat;
use faer::linalg::solvers::SolveLstsq;

use super::*;
use crate::analysis::settings::AnalysisSettings;
use crate::analysis::{Estimator, RmsdScope, TorqueRmsd};
use crate::numerics::analyse::Method;
use crate::numerics::identify::cycle::identify_factors;
use crate::numerics::identify::filtered_columns::{filtered_coulomb_columns, write_filtered_columns};
use crate::numerics::identify::verify::{torque_rmsd, warming_contrast};
use crate::numerics::model::dynamics::DynamicModel;
use crate::numerics::pooled::pool::PooledFactors;
use crate::numerics::signal::filter::filter_signals;
use crate::run::Cycle;
use crate::testing::er3a;

/// Rounding of a QR of some thousand rows, times the condition of the problem, stays below.
const EQUAL: f64 = 1e-9;

const RATE: f64 = 60.0;

fn method() -> Method {
    Method::new(er3a(), AnalysisSettings::default()).expect("base parameters")
}

/// All joints swing, in the friction stage one after the other; torque that no model explains.
pub(crate) fn cycle(number: u32, rows: usize) -> Cycle {
    let channel = || vec![Vec::new(); 6];
    let (mut position, mut torque) = (channel(), channel());
    let mut samples = Samples::default();
    for i in 0..rows {
        let t = i as f64 / RATE;
        let stage = match 20 * i / rows {
            0..8 => Stage::Excitation,
            8 | 13 => Stage::Between,
            9..13 => Stage::Friction,
            _ => Stage::Warming,
        };
        samples.time.push(t);
        samples.stage.push(stage);
        for j in 0..6 {
            let w = 1.3 + 0.41 * j as f64 + 0.1 * f64::from(number);
            let moves = stage != Stage::Friction || i / 40 % 6 == j;
            let (sine, cosine) = ((w * t).sin(), (2.3 * w * t).cos());
            // at rest the encoder still trembles
            let q = if moves { sine + 0.3 * cosine } else { 0.3 + 1e-4 * sine };
            let qd = if moves { w * (w * t).cos() - 0.69 * w * (2.3 * w * t).sin() } else { 0.0 };
            position[j].push(q);
            torque[j].push(10.0 * qd.signum() + 3.0 * qd + 20.0 * q + ((i * 7919 % 101) as f64 - 50.0));
        }
    }
    samples.position = position;
    // rows jump between stages, so velocity is left to the position's derivative
    samples.torque = torque;
    Cycle { number, samples }
}

/// Parameters by another road: the whole observation matrix of moving excitation rows, scaled, in
/// one dense least-squares problem.
pub(crate) fn raw_parameters(method: &Method, cycles: &[&Cycle]) -> Vec<f64> {
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

/// Factors and parameters of a cycle, whose made-up torque no judgement of the data would let pass.
fn unjudged(method: &Method, cycle: &Cycle) -> (Factored, Vec<f64>) {
    let c = filter_signals(&cycle.samples, 12.0).expect("long enough");
    let (columns, kept) = (&method.columns, &method.base.kept_columns);
    let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &c);
    let factored = factor_cycle(&method.robot, columns, kept, &c, &filtered_coulomb_columns, &cycle.samples);
    let factors =
        embedded(columns, factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion)));
    let shares = [c.independent_fraction(); 6];
    let found = identify_factors(&method.base.kept, &factors, &shares, Estimator::Ordinary);
    let found = found.expect("parameters");
    (factored, found.parameters.iter().map(|p| p.value).collect())
}

/// Relative to the largest parameter of its kind of unit: parameters near zero have no digits.
pub(crate) fn assert_equal(found: &[f64], expected: &[f64]) {
    let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= EQUAL * norm, "{found} {expected}");
    }
}

#[test]
fn a_joint_has_the_columns_of_its_own_and_the_outer_links() {
    let method = method();
    for (j, of_joint) in method.columns.by_joint().iter().enumerate() {
        assert!(of_joint.iter().all(|id| id.joint.index() >= j), "{of_joint:?}");
        let own = of_joint.iter().filter(|id| id.joint.index() == j && id.name().starts_with('f'));
        assert_eq!(own.count(), 4);
        let foreign = |id: &&ParameterId| id.joint.index() != j && id.name().starts_with('f');
        assert_eq!(of_joint.iter().filter(foreign).count(), 0);
    }
    // turning about the horizontal axes of joints 2 and 3 has no moment about the vertical joint 1
    let missing = |name: &str| method.columns.by_joint()[0].iter().all(|id| id.to_string() != name);
    assert!(missing("J2_Izz") && missing("J3_Izz"));
    let widths: Vec<usize> = method.columns.by_joint().iter().map(Vec::len).collect();
    assert_eq!(widths, [38, 39, 33, 26, 19, 12]);
}

#[test]
fn identification_from_factors_is_that_from_the_rows() {
    let method = method();
    let cycle = cycle(1, 2000);
    let (_, theta) = unjudged(&method, &cycle);
    assert_equal(&theta, &raw_parameters(&method, &[&cycle]));
}

#[test]
fn cycles_joined_from_what_is_stored_are_the_problem_of_all_their_rows() {
    let method = method();
    let cycles = [cycle(1, 1500), cycle(2, 1000)];
    let mut union: Option<PooledFactors> = None;
    for cycle in &cycles {
        let (stored, _) = pack(&method.columns, &unjudged(&method, cycle).0.factors);
        let columns = FactorColumns::of_stored(&stored.columns);
        let union = union.get_or_insert_with(|| PooledFactors::new(columns.clone()));
        union.add(&columns, &unpack(&stored).expect("sound"), &[0.24; 6]).expect("same columns");
    }
    let found = union.expect("cycles").identify().expect("parameters");
    let value = |id: &ParameterId| found.parameters.iter().find(|p| p.id == *id).expect("kept").value;
    let in_order: Vec<f64> = method.base.kept.iter().map(value).collect();
    assert_equal(&in_order, &raw_parameters(&method, &[&cycles[0], &cycles[1]]));
}

/// RMSD by another road: inverse dynamics with `theta`, row by row.
pub(crate) struct Direct<'a> {
    method: &'a Method,
    cycle: &'a Cycle,
    c: FilteredSignals,
    estimated: Vec<Vec<f64>>,
}

impl<'a> Direct<'a> {
    pub(crate) fn new(method: &'a Method, cycle: &'a Cycle, theta: &[f64]) -> Self {
        let c = filter_signals(&cycle.samples, 12.0).expect("long enough");
        let n = method.robot.joint_count();
        // what jumps is added low-passed, in place of what inverse dynamics would give of it
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

    fn assert_rmsd(&self, j: usize, found: crate::analysis::Rmsd, chosen: impl Fn(usize) -> bool) {
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

    pub(crate) fn assert_verification(&self, verification: &[TorqueRmsd]) {
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

#[test]
fn rmsd_from_factors_is_that_of_inverse_dynamics_over_the_rows() {
    let method = method();
    let cycle = cycle(1, 2000);
    let (factored, theta) = unjudged(&method, &cycle);
    let direct = Direct::new(&method, &cycle, &theta);
    direct.assert_verification(&torque_rmsd(&method.columns, &factored.factors, &theta));
    let contrast = warming_contrast(&method.columns, &factored, &theta);
    // rows 1400 to 1999 are the warming stage, without the six at the end 198 rows a third
    assert_eq!(contrast.len(), 6);
    for found in &contrast {
        let j = found.joint.index();
        direct.assert_rmsd(j, found.start.all_rows, |row| (1400..1598).contains(&row));
        direct.assert_rmsd(j, found.end.all_rows, |row| row >= 1796);
    }
}

#[test]
fn joined_factors_are_those_of_all_rows_of_their_cycles() {
    let method = method();
    let cycles = [cycle(1, 1500), cycle(2, 1000), cycle(3, 700)];
    let of_each: Vec<Vec<JointFactor>> =
        cycles.iter().map(|cycle| unjudged(&method, cycle).0.factors).collect();
    let (_, theta) = unjudged(&method, &cycles[0]);
    // two at once and then the third, as a log is joined part by part
    let first = joined(&method.columns, &of_each[..2].concat());
    let all = joined(&method.columns, &[first, of_each[2].clone()].concat());
    let parts = (all.iter()).map(|of| (of.joint, of.stage as usize, of.motion as usize));
    assert!(parts.is_sorted(), "one of each, in order");
    assert_eq!(
        all.iter().map(|of| of.factor.rows()).sum::<usize>(),
        of_each.iter().flatten().map(|of| of.factor.rows()).sum::<usize>()
    );
    // the other road: sums over the cycles, whose factors are held against their rows above
    let mut sums = crate::numerics::identify::verify::StageSums::default();
    of_each.iter().for_each(|factors| sums.add(&method.columns, factors, &theta));
    for (found, expected) in torque_rmsd(&method.columns, &all, &theta).iter().zip(sums.rmsd()) {
        assert_eq!((found.joint, found.scope), (expected.joint, expected.scope));
        for (found, expected) in
            [(found.all_rows, expected.all_rows), (found.moving_rows, expected.moving_rows)]
        {
            assert_eq!(found.samples, expected.samples);
            assert!((found.value - expected.value).abs() <= EQUAL * expected.value);
            assert!((found.relative - expected.relative).abs() <= EQUAL * expected.relative);
        }
    }
}

#[test]
fn columns_of_another_description_are_refused() {
    let method = method();
    let mut narrower: Vec<Vec<ParameterId>> = method.columns.by_joint().to_vec();
    narrower[5].pop();
    let narrower = FactorColumns::of_stored(&narrower.into());
    let mut union = PooledFactors::new(method.columns.clone());
    let error = union.add(&narrower, &[], &[1.0; 6]).expect_err("other columns");
    assert!(error.to_string().contains("different parameters"), "{error}");
    let error = method.columns.theta([]).expect_err("no values");
    assert!(error.to_string().contains("need parameter J1_Izz"), "{error}");
}

#[test]
fn thirds_are_of_equal_time_and_lose_no_row() {
    let time: Vec<f64> = (0..10).map(f64::from).collect();
    let rows: Vec<usize> = (0..10).collect();
    assert_eq!(thirds(&rows, &time), [&rows[..3], &rows[3..7], &rows[7..]]);
    assert_eq!(thirds(&rows[..1], &time), [&rows[..0], &rows[..1], &rows[..0]]);
    assert_eq!(thirds(&[], &time), [&[] as &[usize]; 3]);
}
