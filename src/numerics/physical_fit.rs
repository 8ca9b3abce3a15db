//! Full parameters of an arm from the factors of its joints, and what physics costs each joint.

use super::NumericsError;
use super::base::BaseParameters;
use super::estimate::{WeightRule, joined};
use super::factors::{JointColumns, JointFactor, identifies};
use super::identify::MAX_SCALED_CONDITION;
use super::physical::{PhysicalEstimate, PhysicalSettings, physical};
use super::triangular::TriangularFactor;
use super::uniform_bodies::{Start, start};
use crate::robot::{JointIndex, Robot};

/// Noise of a torque signal relative to its RMS, below which no joint's is taken to be: without noise,
/// rows would weigh without end.
const NOISE_FLOOR: f64 = 1e-4;
/// Largest relative change of a joint's noise at which weights have settled.
const SETTLED: f64 = 1e-6;
/// Weights settle in some five rounds.
const MAX_ROUNDS: usize = 50;

/// The moving excitation rows of chosen cycles, joint by joint, as cycles come in.
#[derive(Debug, Clone)]
pub struct JointRows {
    columns: JointColumns,
    by_joint: Vec<TriangularFactor>,
    independent_rows: f64,
}

impl JointRows {
    /// Of no cycles yet; all must have these columns.
    #[must_use]
    pub fn new(columns: JointColumns) -> Self {
        let by_joint = columns.by_joint().iter().map(|of| TriangularFactor::new(of.len())).collect();
        Self { columns, by_joint, independent_rows: 0.0 }
    }

    /// Joins the rows of a cycle in which joints move during excitation; other factors are passed
    /// over. `independent_fraction` of them are independent after the low-pass.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] if the cycle's columns are others.
    pub fn add(
        &mut self,
        columns: &JointColumns,
        factors: &[JointFactor],
        independent_fraction: f64,
    ) -> Result<(), NumericsError> {
        if columns.by_joint() != self.columns.by_joint() {
            return Err(NumericsError::ColumnsDiffer(
                "the cycles were factored over different parameters: choose cycles of one description".into(),
            ));
        }
        for of in factors.iter().filter(|of| identifies(of.stage, of.motion)) {
            self.by_joint[of.joint.index()].join(&of.factor);
            self.independent_rows += of.factor.rows() as f64 * independent_fraction;
        }
        Ok(())
    }

    /// Each joint's factor over all base parameters, in their order.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] unless the base parameters are those of the columns.
    pub fn over(&self, base: &BaseParameters) -> Result<Vec<TriangularFactor>, NumericsError> {
        if base.kept.len() != self.columns.kept().len() {
            return Err(NumericsError::ColumnsDiffer(format!(
                "the description has {} base parameters, the stored factors {}: they were made with another",
                base.kept.len(),
                self.columns.kept().len()
            )));
        }
        let place = |id: &crate::robot::ParameterId| {
            base.kept.iter().position(|kept| kept == id).ok_or_else(|| {
                NumericsError::ColumnsDiffer(format!("the description has no base parameter {id}"))
            })
        };
        let of_joint = |(factor, ids): (&TriangularFactor, &Vec<crate::robot::ParameterId>)| {
            let places = ids.iter().map(place).collect::<Result<Vec<usize>, _>>()?;
            Ok(TriangularFactor::stacked(base.kept.len(), [(factor, &places[..])]))
        };
        self.by_joint.iter().zip(self.columns.by_joint().iter()).map(of_joint).collect()
    }

    /// Share of the rows that are independent after the low-pass.
    #[must_use]
    pub fn independent_fraction(&self) -> f64 {
        let rows: usize = self.by_joint.iter().map(TriangularFactor::rows).sum();
        self.independent_rows / (rows as f64).max(1.0)
    }
}

/// What physics costs a joint, over the rows that were fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriceOfPhysics {
    /// The joint.
    pub joint: JointIndex,
    /// Its rows.
    pub samples: usize,
    /// RMS of its measured torque, Nm (N).
    pub torque_rms: f64,
    /// RMSD of unconstrained base parameters, Nm (N).
    pub unconstrained_rmsd: f64,
    /// RMSD of the physically consistent parameters, Nm (N).
    pub consistent_rmsd: f64,
}

/// Full parameters with where they started from and what they cost.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalFit {
    /// The fit.
    pub estimate: PhysicalEstimate,
    /// What it leaned on.
    pub start: Start,
    /// Price of physics for each joint with rows.
    pub price: Vec<PriceOfPhysics>,
    /// Condition number of the unconstrained problem, columns scaled.
    pub scaled_condition_number: f64,
}

/// Fits full parameters to the joints' `factors` `[n]` of `[w | tau]` over all base parameters, each
/// joint weighted by its own residual, from the description's nominal bodies or uniform ones.
///
/// # Errors
/// Those of [`physical`] and [`TriangularFactor::solve`]: rows that do not show all base parameters are
/// refused, though bodies could be had from the assumption alone.
pub fn physical_fit(
    robot: &Robot,
    base: &BaseParameters,
    factors: &[TriangularFactor],
    independent_fraction: f64,
) -> Result<PhysicalFit, NumericsError> {
    let b = base.kept.len();
    let (rule, theta, scaled_condition_number) = weights(base, factors)?;
    let factor = joined(factors, &rule, b);
    let start = start(robot, base, &factor)?;
    let settings = PhysicalSettings { independent_fraction, ..PhysicalSettings::default() };
    let estimate = physical(robot, base, &factor, &start.nominal, &settings)?;
    let consistent = base.group(&estimate.phi);
    let price = factors.iter().enumerate().filter(|(_, factor)| factor.rows() > 0).map(|(j, factor)| {
        let rms = |sum: f64| (sum / factor.rows() as f64).sqrt();
        PriceOfPhysics {
            joint: JointIndex::new(j),
            samples: factor.rows(),
            torque_rms: rms(factor.torque_sum_of_squares()),
            unconstrained_rmsd: rms(factor.residual_sum_of_squares(&theta)),
            consistent_rmsd: rms(factor.residual_sum_of_squares(&consistent)),
        }
    });
    Ok(PhysicalFit { price: price.collect(), estimate, start, scaled_condition_number })
}

/// Noise of each joint, the unconstrained parameters at it, and their condition number. As
/// [`weighted`](super::estimate::weighted), but no joint is without noise.
fn weights(
    base: &BaseParameters,
    factors: &[TriangularFactor],
) -> Result<(WeightRule, Vec<f64>, f64), NumericsError> {
    let b = base.kept.len();
    let rows: usize = factors.iter().map(TriangularFactor::rows).sum();
    if rows <= b {
        return Err(NumericsError::TooShort {
            what: "the excitation stage, joints stacked,",
            rows,
            needed: b + 1,
        });
    }
    let solve = |rule: &WeightRule| {
        joined(factors, rule, b).solve(MAX_SCALED_CONDITION, |k| base.kept[k].to_string())
    };
    let mut rule = WeightRule::equal(factors.len());
    let mut solution = solve(&rule)?;
    for _ in 0..MAX_ROUNDS {
        let mut change = 0.0_f64;
        for (sigma, factor) in rule.sigma.iter_mut().zip(factors).filter(|(_, factor)| factor.rows() > 0) {
            let share = (1.0 - b as f64 / rows as f64).max(f64::EPSILON);
            let rms = |sum: f64| (sum / factor.rows() as f64).sqrt();
            let residual = rms(factor.residual_sum_of_squares(&solution.theta) / share);
            let found = residual.max(NOISE_FLOOR * rms(factor.torque_sum_of_squares()));
            if !(found.is_finite() && found > 0.0) {
                return Err(NumericsError::NotFinite("a joint's residual standard deviation"));
            }
            change = change.max((found / *sigma - 1.0).abs());
            *sigma = found;
        }
        solution = solve(&rule)?;
        if change < SETTLED {
            break;
        }
    }
    Ok((rule, solution.theta, solution.scaled_condition_number))
}
