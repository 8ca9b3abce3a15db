//! The fit of a hypothesis to a log, and the residual torque of each joint.
//!
//! Least squares with a prior for each size, from products alone. Let `w_j` be the weights of the joints. The product
//! of two columns is the sum of `w_j` times their mean product over the joints that both have. The least cost is
//! `d' W d - b' s` for the deviations `d`, the right-hand side `b` and the sizes `s`.
//!
//! Every hypothesis contains the random effects of temperature, which are eliminated once. Let `M` be their normal
//! matrix with priors and `r_a` their products with a column `a`. The remaining product of two other columns is the
//! Schur complement `a' W b - r_a' M^-1 r_b`.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::cause::{WorkCause, WorkLoad};
use super::hypothesis::{Column, Hypothesis, expected_square, warmth_columns};
use armwatch_model::analysis::work_evidence::{DEVIATION, JointEvidence, WorkDirection};
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::robot::JointIndex;

/// Number of independent values that a log counts as, per joint.
const EFFECTIVE_ROWS: f64 = 60.0;
/// Unexplained part of the torque of a test if it is not known, and its least accepted value.
const USUAL_REST: f64 = 0.02;
const LEAST_REST: f64 = 0.005;
/// Regularisation of the correlation matrix of the directions: relative differences below it have no effect.
const RIDGE: f64 = 1e-6;
/// Parts of friction.
const FRICTION: [WorkDirection; 2] = [WorkDirection::Coulomb, WorkDirection::Viscous];

/// Residuals of a joint of a log under the likeliest causes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::production) struct JointRest {
    /// The joint.
    pub(in crate::detect::production) joint: JointIndex,
    /// Friction beyond the test's, as a multiple of the test's.
    pub(in crate::detect::production) friction: f64,
    /// Part of the measured torque that remains if friction is not subtracted, root mean square.
    pub(in crate::detect::production) with_friction: f64,
    /// Part of the measured torque that remains.
    pub(in crate::detect::production) left: f64,
}

/// A log with the weights of its joints.
pub(super) struct System<'a> {
    evidence: &'a [JointEvidence],
    /// Effective rows over the variance of the noise, by joint.
    weights: Vec<f64>,
    /// Weighted mean square that no cause explains, by joint.
    left: Vec<f64>,
    /// Random effects, common to all hypotheses.
    warmth: Vec<Column>,
    /// Normal matrix of the random effects, priors included.
    normal: Cholesky<f64, Dyn>,
    /// Products of the random effects with the deviation; `whitened` has them multiplied by the inverse factor of
    /// `normal`.
    right: DVector<f64>,
    whitened: DVector<f64>,
}

/// A column in addition to the random effects.
pub(super) struct Beside {
    column: Column,
    /// Its products with the random effects; `whitened` has them multiplied by the inverse factor of their normal
    /// matrix.
    with_warmth: DVector<f64>,
    whitened: DVector<f64>,
    /// Its product with the deviation after elimination of the random effects.
    right: f64,
}

/// The sizes that fit best.
pub(super) struct Solution {
    columns: Vec<Column>,
    sizes: DVector<f64>,
    /// Covariance of `sizes`.
    covariance: DMatrix<f64>,
    /// Part of the products of random effects and deviation that the columns explain.
    taken: DVector<f64>,
    /// Remaining squares plus the price, in units of chi².
    pub(super) cost: f64,
}

impl<'a> System<'a> {
    /// Returns `None` for products that no arm could have.
    pub(super) fn of(log: &'a ProductionSummary) -> Option<Self> {
        let evidence = &log.evidence[..];
        let (mut weights, mut left) = (Vec::new(), Vec::new());
        for of in evidence {
            let own = log.joints.iter().find(|joint| joint.joint == of.joint);
            let relative =
                own.and_then(|joint| joint.test_relative_rmsd).unwrap_or(USUAL_REST).max(LEAST_REST);
            let rest = unexplained(of);
            let used = WorkDirection::ALL.len() as f64;
            let noise = (relative * relative * expected_square(of))
                .max(rest * EFFECTIVE_ROWS / (EFFECTIVE_ROWS - used));
            // a joint without any torque, expected or measured, has no information
            let weight = Some(EFFECTIVE_ROWS / noise).filter(|weight| weight.is_finite()).unwrap_or(0.0);
            weights.push(weight);
            left.push(weight * rest);
        }
        let warmth = warmth_columns(evidence.len());
        let with = |a: &Column, b: &Column| product(evidence, &weights, a, b);
        let mut normal = DMatrix::from_fn(warmth.len(), warmth.len(), |a, b| with(&warmth[a], &warmth[b]));
        for (place, column) in warmth.iter().enumerate() {
            normal[(place, place)] += column.variance.recip();
        }
        let normal = normal.cholesky()?;
        let right = DVector::from_fn(warmth.len(), |place, _| {
            product_with_deviation(evidence, &weights, &warmth[place])
        });
        let whitened = normal.l_dirty().solve_lower_triangular(&right)?;
        Some(Self { evidence, weights, left, warmth, normal, right, whitened })
    }

    /// Sum of squares that remains under every hypothesis.
    pub(super) fn least_left(&self) -> f64 {
        self.left.iter().sum()
    }

    /// Columns in addition to the random effects.
    pub(super) fn beside(&self, columns: Vec<Column>) -> Option<Vec<Beside>> {
        let beside = |column: Column| {
            let with_warmth = DVector::from_fn(self.warmth.len(), |place, _| {
                product(self.evidence, &self.weights, &self.warmth[place], &column)
            });
            let whitened = self.normal.l_dirty().solve_lower_triangular(&with_warmth)?;
            let right =
                product_with_deviation(self.evidence, &self.weights, &column) - whitened.dot(&self.whitened);
            Some(Beside { column, with_warmth, whitened, right })
        };
        columns.into_iter().map(beside).collect()
    }

    /// The best fit of these columns, at a price in units of chi²; `None` if the log shows too little of them.
    pub(super) fn solve(&self, columns: &[&Beside], price: f64) -> Option<Solution> {
        let mut normal = DMatrix::from_fn(columns.len(), columns.len(), |a, b| {
            let (a, b) = (columns[a], columns[b]);
            product(self.evidence, &self.weights, &a.column, &b.column) - a.whitened.dot(&b.whitened)
        });
        for (place, of) in columns.iter().enumerate() {
            normal[(place, place)] += of.column.variance.recip();
        }
        let right = DVector::from_fn(columns.len(), |place, _| columns[place].right);
        let covariance = normal.cholesky()?.inverse();
        let sizes = &covariance * &right;
        let mut taken = DVector::zeros(self.warmth.len());
        columns.iter().zip(&sizes).for_each(|(of, size)| taken.axpy(*size, &of.with_warmth, 1.0));
        let all: f64 =
            self.evidence.iter().zip(&self.weights).map(|(of, w)| w * of.product(DEVIATION, DEVIATION)).sum();
        let cost = all - self.whitened.norm_squared() - right.dot(&sizes) + price;
        let columns = columns.iter().map(|of| of.column.clone()).collect();
        cost.is_finite().then_some(Solution { columns, sizes, covariance, taken, cost })
    }

    /// Sizes of the columns of a solution, followed by those of the random effects.
    fn sizes<'s>(&'s self, solution: &'s Solution) -> impl Iterator<Item = (&'s Column, f64)> {
        let of_warmth = self.normal.solve(&(&self.right - &solution.taken));
        let own = solution.columns.iter().zip(solution.sizes.iter().copied());
        own.chain(self.warmth.iter().zip(of_warmth.data.as_vec().clone()))
    }

    /// The cause of a hypothesis with its fitted sizes.
    pub(super) fn cause(&self, hypothesis: Hypothesis, solution: &Solution) -> WorkCause {
        match hypothesis {
            Hypothesis::None => WorkCause::None,
            Hypothesis::Friction(place) => {
                let sizes = self.sizes(solution);
                let added =
                    sizes.filter(|(of, _)| of.is_friction && of.along.len() == 1 && of.along[0].0 == place);
                let own: Vec<(WorkDirection, f64)> = added.map(|(of, size)| (of.along[0].1, size)).collect();
                WorkCause::Friction(self.evidence[place].joint, self.friction(place, &own))
            }
            Hypothesis::Gain(place) => WorkCause::Gain(self.evidence[place].joint, solution.sizes[0]),
            Hypothesis::Offset(place) => WorkCause::Offset(self.evidence[place].joint, solution.sizes[0]),
        }
    }

    /// Parts of friction as one multiple of the joint's friction torque.
    fn friction(&self, place: usize, parts: &[(WorkDirection, f64)]) -> f64 {
        let of = &self.evidence[place];
        let both = FRICTION.map(WorkDirection::place);
        let with_all = |part: usize| both.iter().map(|other| of.product(part, *other)).sum::<f64>();
        let square: f64 = both.iter().map(|part| with_all(*part)).sum();
        let sum: f64 = parts.iter().map(|(part, size)| size * with_all(part.place())).sum();
        if square > 0.0 { sum / square } else { 0.0 }
    }

    /// The load of a solution that has one.
    pub(super) fn load(&self, solution: &Solution) -> WorkLoad {
        let own = |column: &Column| matches!(column.along[0].1, WorkDirection::Load(0));
        let first = solution.columns.iter().position(own).unwrap_or(0);
        let mass = solution.sizes[first];
        let centre = [1, 2, 3].map(|k| solution.sizes[first + k] / mass);
        WorkLoad { mass, std_error: solution.covariance[(first, first)].sqrt(), centre }
    }

    /// Residuals of the joints.
    pub(super) fn rest(&self, solution: &Solution) -> Vec<JointRest> {
        let sizes: Vec<(&Column, f64)> = self.sizes(solution).collect();
        let of_joint = |(place, of): (usize, &JointEvidence)| {
            let mut all = [0.0; DEVIATION];
            for (column, size) in &sizes {
                for (_, direction) in column.along.iter().filter(|(other, _)| *other == place) {
                    all[direction.place()] += size;
                }
            }
            let mut but_friction = all;
            FRICTION.iter().for_each(|part| but_friction[part.place()] = 0.0);
            let gain = WorkDirection::Gain.place();
            let measured =
                expected_square(of) + 2.0 * of.product(gain, DEVIATION) + of.product(DEVIATION, DEVIATION);
            let relative =
                |sizes: &[f64; DEVIATION]| (left_by(of, sizes) / measured.max(f64::MIN_POSITIVE)).sqrt();
            JointRest {
                joint: of.joint,
                friction: self.friction(place, &FRICTION.map(|part| (part, all[part.place()]))),
                with_friction: relative(&but_friction),
                left: relative(&all),
            }
        };
        self.evidence.iter().enumerate().map(of_joint).collect()
    }
}

/// Weighted product of two columns.
fn product(evidence: &[JointEvidence], weights: &[f64], a: &Column, b: &Column) -> f64 {
    let mut sum = 0.0;
    for (place, of_a) in &a.along {
        for (_, of_b) in b.along.iter().filter(|(other, _)| other == place) {
            sum += weights[*place] * evidence[*place].product(of_a.place(), of_b.place());
        }
    }
    sum
}

/// Weighted product of a column and the deviation.
fn product_with_deviation(evidence: &[JointEvidence], weights: &[f64], column: &Column) -> f64 {
    let part = |(place, of): &(usize, WorkDirection)| {
        weights[*place] * evidence[*place].product(of.place(), DEVIATION)
    };
    column.along.iter().map(part).sum()
}

/// Mean square of the deviation after subtraction of the directions with these sizes.
fn left_by(of: &JointEvidence, sizes: &[f64; DEVIATION]) -> f64 {
    let mut sum = of.product(DEVIATION, DEVIATION);
    for (a, size) in sizes.iter().enumerate() {
        sum -= 2.0 * size * of.product(a, DEVIATION);
        sum += sizes.iter().enumerate().map(|(b, other)| size * other * of.product(a, b)).sum::<f64>();
    }
    sum.max(0.0)
}

/// Mean square of a joint's deviation that no direction explains, each with any size.
fn unexplained(of: &JointEvidence) -> f64 {
    let scale: Vec<f64> = (0..DEVIATION).map(|place| of.product(place, place).sqrt()).collect();
    let seen: Vec<usize> = (0..DEVIATION).filter(|place| scale[*place] > 0.0).collect();
    let normal = DMatrix::from_fn(seen.len(), seen.len(), |a, b| {
        let alike = of.product(seen[a], seen[b]) / (scale[seen[a]] * scale[seen[b]]);
        if a == b { alike + RIDGE } else { alike }
    });
    let right =
        DVector::from_fn(seen.len(), |place, _| of.product(seen[place], DEVIATION) / scale[seen[place]]);
    let explained = normal.cholesky().map_or(0.0, |normal| right.dot(&normal.solve(&right)));
    (of.product(DEVIATION, DEVIATION) - explained).max(0.0)
}
