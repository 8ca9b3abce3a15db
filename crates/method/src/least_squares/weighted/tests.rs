//! Tests of estimators with known answers.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::{WeightRule, joined, per_joint, weighted};
use crate::identify::cycle::{identify_factors, identify_rows};
use crate::least_squares::clustered::clustered;
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::huber::{RobustSettings, huber};
use crate::least_squares::rows::{RowSource, SampleRows, joint_factors};
use crate::model::base_parameters::{BaseParameters, PROBE_STATES, base_parameters, probe_state};
use crate::model::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use crate::physical::bodies::{NominalModel, PhysicalEstimate, PhysicalSettings, physical};
use crate::physical::pseudo_inertia::POSITIVE;
use crate::pooled::nominal_prior::nominal_value;
use armwatch_model::analysis::{Estimator, Identification};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind, Robot, StandardParameters};
use armwatch_testing::er3a;
use armwatch_testing::noise::Noise;

/// Rounding of sums over some thousand rows.
const ROUNDING: f64 = 1e-8;
const TRUTH: [f64; 3] = [2.0, -1.0, 0.5];

/// Two joints that depend on the same three parameters.
struct TwoJoints {
    rows: Vec<[[f64; 3]; 2]>,
    tau: Vec<[f64; 2]>,
}

impl TwoJoints {
    fn new(rows: usize, sigma: [f64; 2], mut error: impl FnMut(usize, usize) -> f64) -> Self {
        let mut problem = Self { rows: Vec::new(), tau: Vec::new() };
        for i in 0..rows {
            let t = 0.05 * i as f64;
            let w = [[t.sin(), (0.7 * t).cos(), 1.0], [(1.3 * t).cos(), (0.4 * t).sin(), t.cos()]];
            let clean = w.map(|row| row.iter().zip(TRUTH).map(|(w, theta)| w * theta).sum::<f64>());
            problem.tau.push([0, 1].map(|j| clean[j] + sigma[j] * error(i, j)));
            problem.rows.push(w);
        }
        problem
    }
}

impl RowSource for TwoJoints {
    fn columns(&self) -> usize {
        3
    }

    fn joint_count(&self) -> usize {
        2
    }

    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>)) {
        for (row, (w, tau)) in self.rows.iter().zip(&self.tau).enumerate() {
            visit(&SampleRows { row, w: w.as_flattened(), tau, used: &[true, true] });
        }
    }
}

#[test]
fn weights_find_the_noise_of_each_joint_and_solve_the_weighted_problem() {
    let mut noise = Noise(1);
    let problem = TwoJoints::new(4000, [0.1, 2.0], |_, _| noise.uniform());
    let found = weighted(&joint_factors(&problem), 1e6, |k| k.to_string()).expect("an estimate");
    assert!(found.settled);
    // The scatter of a standard deviation from 4000 rows is 1 %.
    assert!((found.rule.sigma[0] / 0.1 - 1.0).abs() < 0.04, "{:?}", found.rule);
    assert!((found.rule.sigma[1] / 2.0 - 1.0).abs() < 0.04, "{:?}", found.rule);
    // The same by another method: all rows divided by their joint's deviation, in one factor.
    let rows = Mat::from_fn(8000, 4, |i, k| {
        let (row, j) = (i / 2, i % 2);
        let value = if k < 3 { problem.rows[row][j][k] } else { problem.tau[row][j] };
        value / found.rule.sigma[j]
    });
    let mut whole = TriangularFactor::new(3);
    whole.fold(rows.as_ref());
    let expected = whole.solve(1e6, |k| k.to_string()).expect("solves");
    for ((found, expected), truth) in found.theta.iter().zip(&expected.theta).zip(TRUTH) {
        assert!((found - expected).abs() < ROUNDING);
        assert!((found - truth).abs() < 0.02);
    }
    // In units of the noise the residual has variance 1.
    let variance = whole.residual_sum_of_squares(&found.theta) / (8000.0 - 3.0);
    assert!((variance - 1.0).abs() < 1e-3, "{variance}");
}

#[test]
fn huber_shrugs_off_outliers_that_pull_least_squares_away() {
    let mut noise = Noise(2);
    let problem =
        TwoJoints::new(2000, [0.2, 0.2], |i, _| noise.uniform() + if i % 20 == 0 { 60.0 } else { 0.0 });
    let least_squares = weighted(&joint_factors(&problem), 1e6, |k| k.to_string()).expect("an estimate");
    let robust = huber(&problem, &RobustSettings::default(), |k| k.to_string()).expect("an estimate");
    let worst = |theta: &[f64]| {
        theta.iter().zip(TRUTH).map(|(found, truth)| (found - truth).abs()).fold(0.0, f64::max)
    };
    assert!(robust.settled, "{robust:?}");
    assert!(worst(&least_squares.theta) > 0.2, "{:?}", least_squares.theta);
    assert!(worst(&robust.solution.theta) < 0.04, "{:?}", robust.solution.theta);
    assert!((0.049..0.25).contains(&robust.outlier_share), "{}", robust.outlier_share);
}

#[test]
fn without_outliers_huber_is_nearly_least_squares() {
    let mut noise = Noise(3);
    let problem = TwoJoints::new(2000, [0.2, 0.4], |_, _| noise.uniform());
    let plain = weighted(&joint_factors(&problem), 1e6, |k| k.to_string()).expect("an estimate");
    let robust = huber(&problem, &RobustSettings::default(), |k| k.to_string()).expect("an estimate");
    for k in 0..3 {
        assert!((plain.theta[k] - robust.solution.theta[k]).abs() < 0.01);
    }
}

#[test]
fn clustered_errors_are_the_classical_ones_for_white_noise_and_larger_for_slow_noise() {
    let mut noise = Noise(4);
    let white = TwoJoints::new(8000, [0.5, 0.5], |_, _| noise.uniform());
    let mut slow = [0.0; 2];
    let mut noise = Noise(5);
    let red = TwoJoints::new(8000, [0.5, 0.5], |_, j| {
        slow[j] = 0.98 * slow[j] + (1.0_f64 - 0.98 * 0.98).sqrt() * noise.uniform();
        slow[j]
    });
    let rule = WeightRule::equal(2);
    let ratio = |problem: &TwoJoints| {
        let solution =
            joined(&joint_factors(problem), &rule, 3).solve(1e6, |k| k.to_string()).expect("solves");
        let clustered = clustered(problem, &solution.theta, &rule).expect("a covariance");
        let variance = solution.residual_sum_of_squares / 16_000.0;
        let classical = solution.unscaled_variance.iter().map(|u| (u * variance).sqrt());
        let ratios: Vec<f64> =
            classical.enumerate().map(|(k, b)| clustered.matrix[(k, k)].sqrt() / b).collect();
        (ratios, clustered)
    };
    let (ratios, covariance) = ratio(&white);
    // 33 degrees of freedom leave a scatter of 12 % per standard error; the tolerance is three times that.
    assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() < 0.37), "{ratios:?}");
    assert!(covariance.freedom.iter().all(|freedom| (28.0..36.0).contains(freedom)), "{covariance:?}");
    let (ratios, _) = ratio(&red);
    // AR(1) with 0.98 has a correlation time of 99 rows. A constant's error grows by the root of that; the other
    // joint's column, a cosine, halves it.
    assert!(ratios[2] > 3.0, "{ratios:?}");
}

/// Sandwich estimate by another method: from the whole observation matrix, and the covariance that all residuals would
/// have with independent rows.
#[test]
fn clustered_errors_are_those_of_the_whole_matrix() {
    let mut noise = Noise(6);
    let problem = TwoJoints::new(200, [0.5, 0.2], |_, _| noise.uniform());
    let rule = WeightRule { sigma: vec![0.4, 0.3], huber: None };
    let w = Mat::from_fn(400, 3, |i, k| problem.rows[i / 2][i % 2][k] / rule.sigma[i % 2]);
    let tau = Mat::from_fn(400, 1, |i, _| problem.tau[i / 2][i % 2] / rule.sigma[i % 2]);
    let whole = w.transpose() * &w;
    let inverse = whole.partial_piv_lu().solve(Mat::<f64>::identity(3, 3));
    let theta = &inverse * w.transpose() * &tau;
    let e = &tau - &w * &theta;
    let of_residuals = Mat::<f64>::identity(400, 400) - &w * &inverse * w.transpose();
    let theta: Vec<f64> = theta.col(0).iter().copied().collect();
    let found = clustered(&problem, &theta, &rule).expect("a covariance");
    let (mut scatter, mut expected) = (Mat::<f64>::zeros(3, 3), Mat::<f64>::zeros(3, 3));
    for block in 0..41 {
        // taper over ten samples; the first and the last block have half of it
        let taper = |i: usize| {
            let inside = (i / 2 + 5).checked_sub(5 * block).filter(|at| *at < 10);
            inside.map_or(0.0, |at| (std::f64::consts::PI * (at as f64 + 0.5) / 10.0).sin())
        };
        let rows = Mat::from_fn(400, 3, |i, k| taper(i) * w[(i, k)]);
        let without = &whole - rows.transpose() * &rows;
        let to_shift = without.partial_piv_lu().solve(rows.transpose());
        let shift = &to_shift * &e;
        scatter += &shift * shift.transpose();
        expected += &to_shift * &of_residuals * to_shift.transpose();
    }
    let bias = |k: usize| expected[(k, k)] / inverse[(k, k)];
    for i in 0..3 {
        for k in 0..3 {
            let (found, expected) = (found.matrix[(i, k)], scatter[(i, k)] / (bias(i) * bias(k)).sqrt());
            assert!((found - expected).abs() < ROUNDING * expected.abs(), "{found} {expected}");
        }
    }
}

/// A tenth of the record decides one parameter: stated errors are right on average, even without many blocks of equal
/// weight.
#[test]
fn leverage_does_not_swell_the_errors() {
    let problems = 300;
    let (mut squares, mut stated) = (0.0, 0.0);
    for seed in 0..problems {
        let mut noise = Noise(700 + seed);
        let mut problem = TwoJoints::new(400, [0.5, 0.5], |_, _| 0.0);
        for (row, (w, tau)) in problem.rows.iter_mut().zip(&mut problem.tau).enumerate() {
            for j in 0..2 {
                w[j][2] = if (200..240).contains(&row) { 1.0 } else { 0.0 };
                tau[j] = (0..3).map(|k| w[j][k] * TRUTH[k]).sum::<f64>() + 0.5 * noise.uniform();
            }
        }
        let rule = WeightRule::equal(2);
        let solution =
            joined(&joint_factors(&problem), &rule, 3).solve(1e6, |k| k.to_string()).expect("solves");
        let found = clustered(&problem, &solution.theta, &rule).expect("errors");
        squares += (solution.theta[2] - TRUTH[2]).powi(2);
        stated += found.matrix[(2, 2)];
    }
    // a variance of 300 values scatters by 8 %: three times that, halved by the root
    let ratio = (stated / squares).sqrt();
    assert!((ratio - 1.0).abs() < 0.12, "stated over true error {ratio}");
}

/// Noise of a differentiated signal hardly affects parameters whose columns change slowly.
#[test]
fn noise_that_takes_back_what_it_gave_counts_little() {
    let mut ratios = Vec::new();
    for seed in 0..20 {
        let mut noise = Noise(300 + seed);
        let mut before = [0.0; 2];
        let problem = TwoJoints::new(2000, [0.5, 0.5], |_, j| {
            let fresh = noise.uniform();
            fresh - std::mem::replace(&mut before[j], fresh)
        });
        let rule = WeightRule::equal(2);
        let solution =
            joined(&joint_factors(&problem), &rule, 3).solve(1e6, |k| k.to_string()).expect("solves");
        let found = clustered(&problem, &solution.theta, &rule).expect("errors");
        // for the constant, the sum of differences depends only on the ends; rectangular blocks of 100 rows would state
        // twenty times as much
        let error = found.matrix[(2, 2)].sqrt();
        let variance = solution.residual_sum_of_squares / 4000.0;
        ratios.push(error / (variance * solution.unscaled_variance[2]).sqrt());
        assert!(found.independent_share.iter().all(|share| *share > 1.0), "{:?}", found.independent_share);
    }
    let mean = ratios.iter().sum::<f64>() / 20.0;
    // a taper of 100 rows passes (pi / 100)² / 2 of the power of differences, in addition to the constant's own
    assert!(mean < 0.12, "{ratios:?}");
}

#[test]
fn stated_errors_of_a_robust_estimate_are_its_scatter() {
    let problems = 100;
    let (mut sum, mut squares, mut stated) = ([0.0; 3], [0.0; 3], [0.0; 3]);
    for seed in 0..problems {
        let mut noise = Noise(100 + seed);
        // sums of uniform numbers are close enough to normal for a scale by the median
        let mut normal = || (0..6).map(|_| noise.uniform()).sum::<f64>() / 6_f64.sqrt();
        let problem = TwoJoints::new(500, [0.5, 0.2], |_, _| normal());
        let found = huber(&problem, &RobustSettings::default(), |k| k.to_string()).expect("an estimate");
        let errors = clustered(&problem, &found.solution.theta, &found.rule);
        let errors = errors.expect("a covariance");
        for k in 0..3 {
            let deviation = found.solution.theta[k] - TRUTH[k];
            sum[k] += deviation;
            squares[k] += deviation * deviation;
            stated[k] += errors.matrix[(k, k)];
        }
    }
    let count = problems as f64;
    for k in 0..3 {
        let scatter = (squares[k] - sum[k] * sum[k] / count) / (count - 1.0);
        // a standard deviation of 100 values scatters by 7 %: three times that
        let ratio = (stated[k] / count / scatter).sqrt();
        assert!((ratio - 1.0).abs() < 0.21, "parameter {k}: stated over true error {ratio}");
    }
}

/// Parameters of a problem as if they were a robot's.
fn three_parameters() -> Vec<ParameterId> {
    (7..10)
        .map(|k| ParameterId {
            joint: armwatch_model::robot::JointIndex::new(0),
            kind: ParameterKind::Inertial(k),
        })
        .collect()
}

/// Noise that is slow in one joint only.
fn half_slow(seed: u64, sigma: [f64; 2]) -> TwoJoints {
    let mut noise = Noise(seed);
    let mut slow = 0.0;
    TwoJoints::new(4000, sigma, |_, j| {
        let fresh = noise.uniform();
        slow = if j == 1 { 0.9 * slow + (1.0_f64 - 0.81).sqrt() * fresh } else { slow };
        if j == 1 { slow } else { fresh }
    })
}

#[test]
fn errors_from_factors_and_shares_are_nearly_those_from_the_rows() {
    let problem = half_slow(8, [0.3, 0.6]);
    let (kept, factors) = (three_parameters(), joint_factors(&problem));
    for estimator in [Estimator::Ordinary, Estimator::Weighted] {
        let rows = identify_rows(&kept, &factors, &problem, estimator).expect("parameters");
        let shares: Vec<f64> = rows.residuals.iter().map(|residual| residual.independent_share).collect();
        // An AR(1) with 0.9 has 0.1 / 1.9 independent rows for slow columns. A variance of three parameters with 33
        // degrees of freedom scatters by an eighth; leaving out blocks adds to this.
        assert!((0.6..1.4).contains(&shares[0]) && (0.03..0.12).contains(&shares[1]), "{shares:?}");
        let stored = identify_factors(&kept, &factors, &shares, estimator).expect("parameters");
        assert_eq!(rows.residuals, stored.residuals);
        for (rows, stored) in rows.parameters.iter().zip(&stored.parameters) {
            assert_eq!(rows.value, stored.value);
            // all parameters of a joint share one value, although each has its own frequencies
            let ratio = stored.std_error / rows.std_error;
            assert!((0.6..1.6).contains(&ratio), "{} {ratio}", rows.id);
        }
    }
    let error = identify_factors(&kept, &factors, &[1.0; 2], Estimator::Huber).expect_err("no rows");
    assert!(error.to_string().contains("weighs single rows"), "{error}");
}

/// Nominal parameters in natural order.
fn natural(robot: &Robot) -> Vec<f64> {
    let value = |id| nominal_value(robot, id).expect("nominal");
    ParameterId::natural_order(robot).into_iter().map(value).collect()
}

/// Each joint's factor of torques over states inside the limits, with noise of `sigma` Nm.
fn probed(robot: &Robot, base: &BaseParameters, sigma: f64) -> Vec<TriangularFactor> {
    let (n, b) = (robot.joint_count(), base.kept.len());
    let (kept, phi) = (KeptColumns::new(&base.kept_columns), natural(robot));
    let mut noise = Noise(7);
    let mut rows = vec![Mat::<f64>::zeros(PROBE_STATES, b + 1); n];
    let (mut y, mut block, mut tau) = (Regressor::new(robot), vec![0.0; n * b], vec![0.0; n]);
    for index in 0..PROBE_STATES {
        let state = probe_state(robot, index);
        joint_torque_regressor(robot, &state.q, &state.qd, &state.qdd, &mut y);
        kept.write(&y, &mut block, n, 0);
        y.torque(&phi, &mut tau);
        for j in 0..n {
            for k in 0..b {
                rows[j][(index, k)] = block[k * n + j];
            }
            rows[j][(index, b)] = tau[j] + sigma * noise.uniform();
        }
    }
    let factor = |rows: &Mat<f64>| {
        let mut factor = TriangularFactor::new(b);
        factor.fold(rows.as_ref());
        factor
    };
    rows.iter().map(factor).collect()
}

#[test]
fn the_last_joint_alone_gives_its_own_friction() {
    let robot = er3a();
    let base = base_parameters(&robot).expect("base parameters");
    let factors = probed(&robot, &base, 0.0);
    let truth = base.group(&natural(&robot));
    let found = per_joint(&factors[5], 1e6, |k| base.kept[k].to_string()).expect("an estimate");
    // Only the last link and its joint contribute to the last joint's torque.
    assert!(found.kept.iter().chain(&found.grouped).all(|&k| base.kept[k].joint.index() == 5));
    for (&column, theta) in found.kept.iter().zip(&found.solution.theta) {
        if let ParameterKind::Friction(_) = base.kept[column].kind {
            assert!((theta - truth[column]).abs() < ROUNDING, "{} {theta}", base.kept[column]);
        }
    }
}

fn nominal(robot: &Robot, factor: f64) -> NominalModel {
    let joints = || robot.joints.iter().map(|joint| joint.nominal.expect("nominal"));
    NominalModel {
        inertial: joints().map(|n| StandardParameters(n.inertial.0.map(|x| factor * x))).collect(),
        motor_inertia: joints().map(|n| factor * n.motor_inertia).collect(),
    }
}

fn fitted(
    robot: &Robot,
    base: &BaseParameters,
    factors: &[TriangularFactor],
    sigma: f64,
    start: &NominalModel,
) -> PhysicalEstimate {
    let rule = WeightRule { sigma: vec![sigma; factors.len()], huber: None };
    let factor = joined(factors, &rule, base.kept.len());
    physical(robot, base, &factor, start, &PhysicalSettings::default()).expect("a fit")
}

#[test]
fn exact_torques_of_a_body_are_reproduced_from_a_wrong_start() {
    let robot = er3a();
    let base = base_parameters(&robot).expect("base parameters");
    // If the noise is small, the data drive a link to the border of physical bodies, and a plain descent stalls.
    for sigma in [0.05, 1e-2, 1e-3] {
        let fit = fitted(&robot, &base, &probed(&robot, &base, 0.0), sigma, &nominal(&robot, 1.6));
        assert!(fit.settled, "{} steps", fit.steps);
        assert!(fit.definiteness.iter().all(|d| *d > POSITIVE), "{:?}", fit.definiteness);
        // The remainder is the effect of the wrong start, far below the stated noise.
        let rms = sigma * (fit.residual_sum_of_squares / (6 * PROBE_STATES) as f64).sqrt();
        assert!(rms < 0.01 * sigma, "{sigma} {rms} Nm");
    }
}

#[test]
fn noise_that_makes_least_squares_unphysical_leaves_a_body() {
    let robot = er3a();
    let base = base_parameters(&robot).expect("base parameters");
    let sigma = 20.0;
    let factors = probed(&robot, &base, sigma);
    let rule = WeightRule { sigma: vec![sigma; 6], huber: None };
    let plain = joined(&factors, &rule, base.kept.len()).solve(1e6, |k| k.to_string()).expect("solves");
    // A motor inertia without grouped parameters must be positive.
    let motor = |k: &usize| base.kept[*k].kind == ParameterKind::MotorInertia && base.grouping[*k].is_empty();
    let motors: Vec<usize> = (0..base.kept.len()).filter(motor).collect();
    assert!(motors.iter().any(|&k| plain.theta[k] < 0.0), "the noise is too small to show anything");
    let fit = fitted(&robot, &base, &factors, sigma, &nominal(&robot, 1.2));
    assert!(
        fit.definiteness.iter().all(|d| *d > POSITIVE) && fit.model.motor_inertia.iter().all(|i| *i > 0.0)
    );
    assert!(fit.residual_sum_of_squares >= fit.unconstrained_sum_of_squares);
    // Torques without noise: the constraint must not cost more than the noise.
    let clean = joined(&probed(&robot, &base, 0.0), &rule, base.kept.len());
    let error = |theta: &[f64]| clean.residual_sum_of_squares(theta);
    let (physical, free) = (error(&base.group(&fit.phi)), error(&plain.theta));
    assert!(physical <= 1.05 * free, "{physical} {free}");
}

/// Two columns of two joints. The first joint's rows show both, with noise `coarse`; the second's show only their sum,
/// with noise `fine`.
fn coarse_and_fine(coarse: f64, fine: f64, truth: [f64; 2]) -> Vec<TriangularFactor> {
    let mut white = Noise(7);
    let mut factor = |sees: &dyn Fn(usize) -> [f64; 2], noise: f64| {
        let mut rows = faer::Mat::<f64>::zeros(400, 3);
        for i in 0..400 {
            let [a, b] = sees(i);
            (rows[(i, 0)], rows[(i, 1)]) = (a, b);
            rows[(i, 2)] = a * truth[0] + b * truth[1] + noise * (white.even() - 0.5);
        }
        let mut factor = TriangularFactor::new(2);
        factor.fold(rows.as_ref());
        factor
    };
    let both = |i: usize| [(0.1 * i as f64).sin(), (0.23 * i as f64).cos()];
    let sum = |i: usize| [(0.1 * i as f64).cos(); 2];
    vec![factor(&both, coarse), factor(&sum, fine)]
}

#[test]
fn a_joint_of_fine_or_perfect_torques_refuses_nothing() {
    let kept =
        [0, 1].map(|joint| ParameterId { joint: JointIndex::new(joint), kind: ParameterKind::MotorInertia });
    let truth = [2.0, -1.0];
    for (coarse, fine) in [(1.0, 1e-3), (1.0, 1e-5), (1.0, 0.0), (1e-2, 1e-2), (0.0, 0.0)] {
        let factors = coarse_and_fine(coarse, fine, truth);
        let find = |estimator| identify_factors(&kept, &factors, &[1.0; 2], estimator);
        let ordinary = find(Estimator::Ordinary).expect("parameters");
        let weighted = find(Estimator::Weighted).expect("parameters");
        let sum = |of: &Identification| of.parameters.iter().map(|p| p.value).sum::<f64>();
        // the rows of the fine joint count, and nothing else suffers
        let off = |of: &Identification| (sum(of) - 1.0).abs();
        assert!(fine >= coarse || off(&weighted) <= off(&ordinary) + 1e-9, "{coarse} {fine}");
        for (parameter, truth) in weighted.parameters.iter().zip(truth) {
            assert!((parameter.value - truth).abs() < 0.2 * coarse + 1e-6, "{coarse} {fine}: {parameter:?}");
        }
    }
}
