//! Rows of recordings without and with a load, with friction removed.

use faer::Mat;

use crate::identify::joint_factors::{JointFactor, used_for_identification};
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::orthonormal::{OrthonormalBasis, dot};
use crate::model::base_parameters::BaseParameters;
use armwatch_model::robot::{
    CouplingTerm, JointIndex, ParameterId, ParameterKind, Robot, StandardParameters,
};

/// Smallest new share of a unit-norm column for it to count as independent: far above the rounding of a factor (1e-13),
/// far below the new share of any parameter that a motion shows.
pub(super) const NEW_SHARE: f64 = 1e-8;

/// Smallest number of cycles of each recording whose scatter gives an error: Student's quantile for three degrees of
/// freedom is still useful.
pub(super) const MIN_CYCLES: usize = 4;

/// Factors of a cycle, and its load state.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCycle {
    /// True if the load was on.
    pub loaded: bool,
    /// Factors of the cycle; only those of moving rows of the excitation stage are used.
    pub factors: Vec<JointFactor>,
    /// Share of each joint's rows that are independent, `[n]`
    /// ([`JointResidual::independent_share`](armwatch_model::analysis::JointResidual::independent_share)); a missing
    /// one counts as 1.
    pub independent_shares: Vec<f64>,
}

/// Change of the base parameters `[b]` by a load, in the order of [`BaseParameters::kept`]. `load` are its ten
/// parameters about the frame of the last link; [`StandardParameters::seen_from`] transforms them to it.
#[must_use]
pub fn load_change(robot: &Robot, base: &BaseParameters, load: &StandardParameters) -> Vec<f64> {
    let mut phi = vec![0.0; robot.parameter_count()];
    let first = StandardParameters::COUNT * robot.joint_count().saturating_sub(1);
    if let Some(last) = phi.get_mut(first..first + StandardParameters::COUNT) {
        last.copy_from_slice(&load.0);
    }
    base.group(&phi)
}

/// Columns of one joint: those of the arm, those of friction, and the changes by the loads,
/// `[loads][columns of the joint]`.
pub(super) struct JointProblem {
    pub(super) arm: Vec<usize>,
    friction: Vec<usize>,
    changes: Vec<Vec<f64>>,
}

/// Factor of one joint in one cycle, with friction removed.
pub(super) struct LoadedFactor {
    /// Index of the cycle among all.
    pub(super) cycle: usize,
    pub(super) loaded: bool,
    /// Factor of `[w_arm, w d.. | tau]`, each without the part that the cycle's friction columns explain; `w d` is zero
    /// without load.
    pub(super) factor: TriangularFactor,
    pub(super) rows: f64,
    pub(super) independent_rows: f64,
    pub(super) friction_columns: usize,
    /// Sum of squares of the torque of all loads, Nm².
    pub(super) load_squares: f64,
    /// Sum of squares of the torque, Nm².
    pub(super) torque_squares: f64,
}

impl JointProblem {
    pub(super) fn new(ids: &[ParameterId], changes: Vec<Vec<f64>>) -> Self {
        let (friction, arm) = (0..ids.len()).partition(|&k| is_friction(ids[k].kind));
        Self { arm, friction, changes }
    }

    /// Columns of the factors of [`LoadedFactor`]: the arm's, then one per load.
    pub(super) fn columns(&self) -> usize {
        self.arm.len() + self.changes.len()
    }

    /// Parts of all cycles with rows of the joint.
    pub(super) fn parts(&self, cycles: &[RecordedCycle], joint: JointIndex) -> Vec<LoadedFactor> {
        let chosen = |of: &&JointFactor| of.joint == joint && used_for_identification(of.stage, of.motion);
        let of_cycle = |(place, cycle)| {
            let cycle: &RecordedCycle = cycle;
            cycle.factors.iter().filter(chosen).map(move |of| self.part(place, cycle, of))
        };
        cycles.iter().enumerate().flat_map(of_cycle).collect()
    }

    fn part(&self, place: usize, cycle: &RecordedCycle, of: &JointFactor) -> LoadedFactor {
        let share = cycle.independent_shares.get(of.joint.index()).copied().unwrap_or(1.0);
        let of = &of.factor;
        let (r, b) = (of.upper(), of.columns());
        let column = |k: usize| r.col(k).iter().copied().collect::<Vec<f64>>();
        let load = |change: &Vec<f64>| {
            let mut load = vec![0.0; b + 1];
            for (k, d) in change.iter().enumerate().filter(|(_, d)| cycle.loaded && **d != 0.0) {
                load.iter_mut().zip(column(k)).for_each(|(sum, w)| *sum += w * d);
            }
            load
        };
        let loads: Vec<Vec<f64>> = self.changes.iter().map(load).collect();
        let load_squares = loads.iter().map(|load| dot(load, load)).sum();
        let torque = column(b);
        let torque_squares = dot(&torque, &torque);
        let mut basis = OrthonormalBasis::default();
        self.friction.iter().for_each(|&k| basis.add(&column(k), NEW_SHARE));
        let others = self.arm.iter().map(|&k| column(k)).chain(loads).chain([torque]);
        let left: Vec<Vec<f64>> = others.map(|x| basis.rest(&x).vector).collect();
        let mut factor = TriangularFactor::new(left.len() - 1);
        factor.fold(Mat::from_fn(b + 1, left.len(), |i, k| left[k][i]).as_ref());
        let rows = of.rows() as f64;
        LoadedFactor {
            cycle: place,
            loaded: cycle.loaded,
            factor,
            rows,
            independent_rows: rows * share,
            friction_columns: basis.rank(),
            load_squares,
            torque_squares,
        }
    }
}

/// Returns true if a parameter may change from cycle to cycle.
pub(super) fn is_friction(kind: ParameterKind) -> bool {
    match kind {
        ParameterKind::Friction(_) => true,
        ParameterKind::Coupling(term) => term != CouplingTerm::Inertia,
        ParameterKind::Inertial(_)
        | ParameterKind::MotorInertia
        | ParameterKind::Spring(_)
        | ParameterKind::Crank(_) => false,
    }
}
