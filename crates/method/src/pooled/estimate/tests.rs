//! Tests of estimators on cycles' factors against the same cycles' rows, and of intervals against the truth.

use faer::Mat;
use faer::linalg::solvers::SolveLstsq;

use super::{ErrorBasis, PooledEstimate, StackedEstimator, estimate, estimate_essential};
use crate::identify::joint_factors::{FactorColumns, JointFactor};
use crate::least_squares::essential::EssentialSettings;
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::prior::{ParameterPrior, PriorStrength};
use crate::least_squares::rows::{RowSource, SampleRows};
use crate::pooled::per_joint::per_joint_estimates;
use crate::pooled::pool::PooledFactors;
use armwatch_model::analysis::Motion;
use armwatch_model::robot::{FrictionTerm, JointIndex, ParameterId, ParameterKind};
use armwatch_model::run::Stage;
use armwatch_testing::noise::Noise;

/// Tolerance for the rounding of a QR of some thousand rows, times the condition of the problem.
const EQUAL: f64 = 1e-9;
/// Values of the five parameters, in the order of [`kept`].
const TRUTH: [f64; 5] = [2.0, -1.0, 0.5, 4.0, 1.5];
/// Noise of the two joints, Nm.
const SIGMA: [f64; 2] = [0.2, 1.0];

fn id(joint: usize, kind: ParameterKind) -> ParameterId {
    ParameterId { joint: JointIndex::new(joint), kind }
}

fn kept() -> [ParameterId; 5] {
    let f1 = ParameterKind::Friction(FrictionTerm::F1);
    let [moment, inertia] = [1, 9].map(ParameterKind::Inertial);
    [id(0, inertia), id(0, f1), id(1, moment), id(1, inertia), id(1, f1)]
}

/// Columns of each joint among all: the first joint does not depend on the second one's friction.
const PLACES: [&[usize]; 2] = [&[0, 1, 2, 3], &[2, 3, 4]];

/// Cycles of equal length; `tau[cycle][row][joint]`.
struct StackedCycles {
    rows: usize,
    tau: Vec<Vec<[f64; 2]>>,
}

impl StackedCycles {
    /// Creates cycles with the error `error(cycle, row, joint)`, in units of the joint's noise.
    fn new(cycles: usize, rows: usize, mut error: impl FnMut(usize, usize, usize) -> f64) -> Self {
        let mut row = |c: usize, i: usize| {
            [0, 1].map(|j| {
                let clean: f64 = entries(c, i, j).iter().zip(TRUTH).map(|(w, theta)| w * theta).sum();
                clean + SIGMA[j] * error(c, i, j)
            })
        };
        Self { rows, tau: (0..cycles).map(|c| (0..rows).map(|i| row(c, i)).collect()).collect() }
    }

    /// Creates cycles with white noise.
    fn plain(cycles: usize, rows: usize, seed: u64) -> Self {
        let mut noise = Noise(seed);
        Self::new(cycles, rows, |_, _, _| noise.uniform())
    }

    fn union_of(&self, cycles: impl Iterator<Item = usize>) -> PooledFactors {
        let by_joint: Vec<Vec<ParameterId>> =
            PLACES.iter().map(|of| of.iter().map(|&k| kept()[k]).collect()).collect();
        let columns = FactorColumns::of_stored(&by_joint.into());
        let mut union = PooledFactors::new(columns.clone());
        for c in cycles {
            let factors = [0, 1].map(|j| JointFactor {
                joint: JointIndex::new(j),
                stage: Stage::Excitation,
                motion: Motion::Moving,
                factor: self.factor(c, j),
            });
            union.add(&columns, &factors, &[1.0, 1.0]).expect("same columns");
        }
        union
    }

    fn union(&self) -> PooledFactors {
        self.union_of(0..self.tau.len())
    }

    fn factor(&self, c: usize, j: usize) -> TriangularFactor {
        let b = PLACES[j].len();
        let rows = Mat::from_fn(self.rows, b + 1, |i, k| match k < b {
            true => entries(c, i, j)[PLACES[j][k]],
            false => self.tau[c][i][j],
        });
        let mut factor = TriangularFactor::new(b);
        factor.fold(rows.as_ref());
        factor
    }

    /// Dense least squares over all rows times the root of their weight, and over additional rows of `[w | tau]`.
    fn raw(&self, weight: impl Fn(usize, usize) -> f64, further: &[[f64; 6]]) -> Vec<f64> {
        let mut rows: Vec<[f64; 6]> = further.to_vec();
        for (c, cycle) in self.tau.iter().enumerate() {
            for (i, tau) in cycle.iter().enumerate() {
                for j in [0, 1].into_iter().filter(|&j| weight(c, j) > 0.0) {
                    let root = weight(c, j).sqrt();
                    let w = entries(c, i, j).map(|x| root * x);
                    rows.push([w[0], w[1], w[2], w[3], w[4], root * tau[j]]);
                }
            }
        }
        let w = Mat::from_fn(rows.len(), 5, |i, k| rows[i][k]);
        let right = Mat::from_fn(rows.len(), 1, |i, _| rows[i][5]);
        let solved = w.col_piv_qr().solve_lstsq(&right);
        (0..5).map(|k| solved[(k, 0)]).collect()
    }
}

/// Row of `w` of a joint.
fn entries(c: usize, i: usize, j: usize) -> [f64; 5] {
    let t = 0.05 * i as f64 + 0.3 * c as f64;
    match j {
        0 => [t.sin(), (1.7 * t).cos().signum(), (0.7 * t).cos(), (1.3 * t).sin(), 0.0],
        _ => [0.0, 0.0, (0.4 * t).sin(), (2.1 * t).cos(), (1.1 * t).sin().signum()],
    }
}

impl RowSource for StackedCycles {
    fn columns(&self) -> usize {
        5
    }

    fn joint_count(&self) -> usize {
        2
    }

    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>)) {
        for (c, cycle) in self.tau.iter().enumerate() {
            for (i, tau) in cycle.iter().enumerate() {
                let w = [entries(c, i, 0), entries(c, i, 1)];
                visit(&SampleRows { row: c * self.rows + i, w: w.as_flattened(), tau, used: &[true, true] });
            }
        }
    }
}

fn values(found: &PooledEstimate) -> Vec<f64> {
    found.identification.parameters.iter().map(|p| p.value).collect()
}

fn sigma(found: &PooledEstimate) -> Vec<f64> {
    found.identification.parameters.iter().map(|p| p.std_error).collect()
}

fn assert_equal(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= EQUAL * expected.abs(), "{found} {expected}");
    }
}

#[test]
fn ordinary_and_weighted_are_the_dense_solutions_of_the_rows() {
    let test = StackedCycles::plain(3, 400, 1);
    let union = test.union();
    let ordinary = estimate(&union, &StackedEstimator::Ordinary).expect("parameters");
    assert_equal(&values(&ordinary), &test.raw(|_, _| 1.0, &[]));
    let weighted = estimate(&union, &StackedEstimator::Weighted).expect("parameters");
    let by_joint = &weighted.weights.by_joint;
    assert_equal(&values(&weighted), &test.raw(|_, j| by_joint[j], &[]));
    for j in [0, 1] {
        // the scatter of a standard deviation from 1200 rows is 2 %
        assert!((by_joint[j].sqrt() * SIGMA[j] - 1.0).abs() < 0.08, "{by_joint:?}");
    }
    assert!(weighted.settled && matches!(weighted.errors, ErrorBasis::IndependentRows { .. }));
    // both residuals are those of unweighted rows
    assert!((weighted.identification.residual_std / ordinary.identification.residual_std - 1.0).abs() < 0.01);
}

#[test]
fn each_joint_alone_is_the_dense_solution_of_its_rows() {
    let test = StackedCycles::plain(2, 400, 2);
    for (joint, view) in per_joint_estimates(&test.union()) {
        let (j, view) = (joint.index(), view.expect("a view"));
        let (places, b) = (PLACES[j], PLACES[j].len());
        let w = Mat::from_fn(800, b, |i, k| entries(i / 400, i % 400, j)[places[k]]);
        let right = Mat::from_fn(800, 1, |i, _| test.tau[i / 400][i % 400][j]);
        let solved = w.col_piv_qr().solve_lstsq(&right);
        let expected: Vec<f64> = (0..b).map(|k| solved[(k, 0)]).collect();
        let found: Vec<f64> = view.identification.parameters.iter().map(|p| p.value).collect();
        assert_equal(&found, &expected);
        assert_eq!(view.unseen, if j == 0 { vec![kept()[4]] } else { vec![kept()[0], kept()[1]] });
        assert!(view.within_others.is_empty());
    }
}

/// Jackknife error: root of `(C - 1) / C sum (theta without c - theta)²`.
fn jackknife(theta: &[f64], left_out: &[Vec<f64>]) -> Vec<f64> {
    let count = left_out.len() as f64;
    let of = |k: usize| left_out.iter().map(|other| (other[k] - theta[k]).powi(2)).sum::<f64>();
    (0..theta.len()).map(|k| ((count - 1.0) / count * of(k)).sqrt()).collect()
}

#[test]
fn errors_between_cycles_are_those_of_leaving_cycles_out() {
    let mut noise = Noise(4);
    // an error of whole cycles, so that none is repeated
    let mut slow = 0.0;
    let test = StackedCycles::new(9, 100, |_, i, _| {
        slow = if i == 0 { 2.0 * noise.uniform() } else { slow };
        slow + noise.uniform()
    });
    for estimator in [StackedEstimator::Ordinary, StackedEstimator::Weighted] {
        let whole = estimate(&test.union(), &estimator).expect("parameters");
        assert_eq!(whole.errors, ErrorBasis::Cycles { count: 9, repeated: 0.0 });
        let without = |out: usize| {
            let rest = test.union_of((0..9).filter(|&c| c != out)).stacked(&whole.weights);
            rest.solve(f64::INFINITY, |k| k.to_string()).expect("parameters").theta
        };
        let left_out: Vec<Vec<f64>> = (0..9).map(without).collect();
        assert_equal(&sigma(&whole), &jackknife(&values(&whole), &left_out));
    }
}

#[test]
fn a_prior_is_further_rows_and_its_share_is_said() {
    let test = StackedCycles::plain(3, 200, 5);
    let id = test.union().columns().kept()[2];
    let priors = vec![(id, ParameterPrior { value: 0.7, std: 0.02 })];
    let estimator = StackedEstimator::Prior { priors, strength: PriorStrength::AsGiven };
    let found = estimate(&test.union(), &estimator).expect("parameters");
    let by_joint = &found.weights.by_joint;
    let expected = test.raw(|_, j| by_joint[j], &[[0.0, 0.0, 1.0 / 0.02, 0.0, 0.0, 0.7 / 0.02]]);
    assert_equal(&values(&found), &expected);
    let report = found.prior.expect("a report");
    assert!(report.data_share[2] > 0.05 && report.data_share[2] < 0.95, "{report:?}");
    assert!(report.data_share.iter().enumerate().all(|(k, share)| k == 2 || *share > 1.0 - EQUAL));
}

#[test]
fn a_prior_carries_what_the_motion_does_not_show() {
    let mut test = StackedCycles::plain(8, 200, 6);
    // without rows of the second joint, its friction is not visible
    test.tau.iter_mut().flatten().for_each(|tau| tau[1] = 0.0);
    let columns = test.union().columns().clone();
    let mut union = PooledFactors::new(columns.clone());
    for c in 0..8 {
        let first = JointFactor {
            joint: JointIndex::new(0),
            stage: Stage::Excitation,
            motion: Motion::Moving,
            factor: test.factor(c, 0),
        };
        union.add(&columns, &[first], &[1.0, 1.0]).expect("same columns");
    }
    let without = estimate(&union, &StackedEstimator::Weighted).expect("the others");
    let shown: Vec<bool> = without.identification.parameters.iter().map(|of| of.is_shown()).collect();
    assert_eq!(shown, [true, true, true, true, false]);
    let priors = vec![(columns.kept()[4], ParameterPrior { value: 1.4, std: 0.25 })];
    let estimator = StackedEstimator::Prior { priors, strength: PriorStrength::AsGiven };
    let found = estimate(&union, &estimator).expect("parameters");
    assert!((values(&found)[4] - 1.4).abs() < EQUAL && (sigma(&found)[4] - 0.25).abs() < EQUAL);
    // the prior is the only information: the normal quantile, to 4.5e-4
    assert!((found.half_width[4] / 0.25 - 1.96).abs() < 0.001, "{found:?}");
    assert!(found.prior.expect("a report").data_share[4] < EQUAL);
    assert!(matches!(found.errors, ErrorBasis::Cycles { count: 8, .. }));
}

#[test]
fn a_cycle_with_a_collision_loses_its_weight() {
    let mut noise = Noise(7);
    let test =
        StackedCycles::new(9, 200, |c, i, _| noise.uniform() + if c == 4 && i < 60 { 30.0 } else { 0.0 });
    let union = test.union();
    let robust = estimate(&union, &StackedEstimator::Huber).expect("parameters");
    let plain = estimate(&union, &StackedEstimator::Weighted).expect("parameters");
    let kept = robust.weights.kept.clone().expect("weights of cycles");
    assert!(robust.settled);
    for (c, of_cycle) in kept.iter().enumerate() {
        for share in of_cycle {
            assert!(if c == 4 { *share < 0.1 } else { *share > 0.9 }, "{kept:?}");
        }
    }
    let worst = |found: &PooledEstimate| {
        values(found).iter().zip(TRUTH).map(|(found, truth)| (found - truth).abs()).fold(0.0, f64::max)
    };
    assert!(worst(&robust) < 0.2 * worst(&plain), "{} {}", worst(&robust), worst(&plain));
    let by_joint = &robust.weights.by_joint;
    assert_equal(&values(&robust), &test.raw(|c, j| by_joint[j] * kept[c][j], &[]));
    let few = test.union_of(0..4);
    let error = estimate(&few, &StackedEstimator::Huber).expect_err("too few");
    assert!(error.to_string().contains("at least 5"), "{error}");
}

#[test]
fn a_parameter_that_is_nothing_is_not_essential() {
    let mut noise = Noise(8);
    // the torque does not contain the third parameter
    let test =
        StackedCycles::new(10, 200, |c, i, j| noise.uniform() - TRUTH[2] * entries(c, i, j)[2] / SIGMA[j]);
    let found = estimate_essential(&test.union(), &StackedEstimator::Weighted, &EssentialSettings::default());
    let found = found.expect("parameters");
    let report = found.essential.clone().expect("a report");
    assert_eq!(report.removed, vec![kept()[2]]);
    assert!(report.f_statistic <= report.f_limit && report.full.len() == 5);
    let removed = found.identification.parameters[2];
    assert!(removed.value == 0.0 && removed.std_error.is_nan());
    for k in [0, 1, 3, 4] {
        let parameter = found.identification.parameters[k];
        assert!((parameter.value - TRUTH[k]).abs() < 4.0 * parameter.std_error, "{parameter:?}");
    }
    assert!(matches!(found.errors, ErrorBasis::Cycles { count: 10, .. }));
}

/// Share of 95 % intervals that contain the truth over `repeats` tests of `cycles` cycles, whose noise is correlated
/// within each cycle and has a slow part that only whole cycles show.
fn coverage(cycles: usize, repeats: u64, estimator: &StackedEstimator) -> f64 {
    let mut held = 0;
    for seed in 0..repeats {
        let mut noise = Noise(1000 + 7919 * seed);
        let mut state = [0.0; 2];
        let mut slow = [0.0; 2];
        let test = StackedCycles::new(cycles, 60, |_, i, j| {
            if i == 0 {
                state[j] = noise.normal();
                slow[j] = noise.normal();
            }
            state[j] = 0.9 * state[j] + (1.0_f64 - 0.81).sqrt() * noise.normal();
            state[j] + 0.5 * slow[j] * (0.02 * i as f64).cos()
        });
        let found = estimate(&test.union(), estimator).expect("parameters");
        let inside = |(k, truth): &(usize, f64)| (values(&found)[*k] - truth).abs() <= found.half_width[*k];
        held += TRUTH.into_iter().enumerate().filter(inside).count();
    }
    held as f64 / (5.0 * repeats as f64)
}

#[test]
fn intervals_between_cycles_hold_the_truth_as_often_as_they_say() {
    // 1500 intervals; those of one test depend on each other: a standard error of at most 1 %
    for (cycles, estimator) in [(8, StackedEstimator::Ordinary), (24, StackedEstimator::Weighted)] {
        let found = coverage(cycles, 300, &estimator);
        assert!((0.93..=0.97).contains(&found), "{cycles} cycles: {found}");
    }
    // the noise of rows alone does not show the effect of their correlation
    let few = coverage(7, 100, &StackedEstimator::Ordinary);
    assert!(few < 0.8, "{few}");
}
