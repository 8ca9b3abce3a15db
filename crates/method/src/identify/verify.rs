//! Estimated and measured torque: RMSD per joint and stage [5.1], from factors alone.

use super::joint_factors::{FactorColumns, Factored, JointFactor};
use crate::least_squares::factor::TriangularFactor;
use armwatch_model::analysis::{Motion, Rmsd, RmsdPair, RmsdScope, TorqueRmsd, WarmingContrast};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::Stage;

/// Sums over rows of one joint, which determine an RMSD and add up over stages and cycles.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct TorqueSums {
    /// Sum of squares of estimated minus measured torque, Nm².
    pub deviation: f64,
    /// Sum of squares of the measured torque, Nm².
    pub measured: f64,
    /// Number of rows.
    pub rows: usize,
}

impl TorqueSums {
    /// Sums over the rows of `factor` with the parameters `theta` of its columns.
    ///
    /// # Panics
    /// If `theta` has fewer entries than the factor columns.
    #[must_use]
    pub fn of(factor: &TriangularFactor, theta: &[f64]) -> Self {
        Self {
            deviation: factor.residual_sum_of_squares(theta),
            measured: factor.torque_sum_of_squares(),
            rows: factor.rows(),
        }
    }

    /// Sums over the rows of both.
    #[must_use]
    pub fn joined(self, other: Self) -> Self {
        Self {
            deviation: self.deviation + other.deviation,
            measured: self.measured + other.measured,
            rows: self.rows + other.rows,
        }
    }

    /// RMSD; zero with zero samples if there are no rows.
    #[must_use]
    pub fn rmsd(self) -> Rmsd {
        if self.rows == 0 {
            return Rmsd::default();
        }
        let value = (self.deviation / self.rows as f64).sqrt();
        let measured = (self.measured / self.rows as f64).sqrt();
        let relative = if measured > 0.0 { value / measured } else { 0.0 };
        Rmsd { value, relative, samples: self.rows }
    }
}

/// Sums of one joint over moving and over slow rows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct MotionSums([TorqueSums; 2]);

impl MotionSums {
    /// Adds rows of one motion.
    pub fn add(&mut self, motion: Motion, sums: TorqueSums) {
        let of_motion = &mut self.0[motion as usize];
        *of_motion = of_motion.joined(sums);
    }

    /// RMSD over all rows and over the moving ones.
    #[must_use]
    pub fn rmsd(self) -> RmsdPair {
        let [moving, slow] = self.0;
        RmsdPair { all_rows: moving.joined(slow).rmsd(), moving_rows: moving.rmsd() }
    }
}

/// Sums by joint and stage, which determine every RMSD of one or more cycles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StageSums {
    by_joint: Vec<[MotionSums; 4]>,
}

impl StageSums {
    /// Adds the rows of `factors` with the parameters `theta` `[b]` of all columns.
    pub fn add(&mut self, columns: &FactorColumns, factors: &[JointFactor], theta: &[f64]) {
        self.by_joint.resize(columns.joint_count().max(self.by_joint.len()), Default::default());
        let selected: Vec<Vec<f64>> =
            (0..columns.joint_count()).map(|j| columns.select(JointIndex::new(j), theta)).collect();
        for of in factors {
            let sums = TorqueSums::of(&of.factor, &selected[of.joint.index()]);
            self.by_joint[of.joint.index()][of.stage as usize].add(of.motion, sums);
        }
    }

    /// RMSD of every joint over the excitation, friction and warming stages with rows, and over the whole cycle
    /// including rows between stages. Each is over all rows, and over those with the joint at its low-speed threshold
    /// or faster.
    #[must_use]
    pub fn rmsd(&self) -> Vec<TorqueRmsd> {
        let of_joint = |(j, stages): (usize, &[MotionSums; 4])| {
            let joint = JointIndex::new(j);
            let mut whole = MotionSums::default();
            for stage in stages {
                Motion::BOTH.into_iter().for_each(|motion| whole.add(motion, stage.0[motion as usize]));
            }
            let by_stage = Stage::ANALYSED.map(|stage| (RmsdScope::Stage(stage), stages[stage as usize]));
            by_stage.into_iter().chain([(RmsdScope::WholeCycle, whole)]).map(move |(scope, sums)| {
                let RmsdPair { all_rows, moving_rows } = sums.rmsd();
                TorqueRmsd { joint, scope, all_rows, moving_rows }
            })
        };
        let all = self.by_joint.iter().enumerate().flat_map(of_joint);
        all.filter(|rmsd| rmsd.all_rows.samples > 0).collect()
    }
}

/// RMSD of the parameters `theta` `[b]` on a cycle's factors; see [`StageSums::rmsd`].
#[must_use]
pub fn torque_rmsd(columns: &FactorColumns, factors: &[JointFactor], theta: &[f64]) -> Vec<TorqueRmsd> {
    let mut sums = StageSums::default();
    sums.add(columns, factors, theta);
    sums.rmsd()
}

/// RMSD of `theta` `[b]` at the start and at the end of the warming stage, for every joint; empty without a warming
/// stage.
#[must_use]
pub fn warming_contrast(columns: &FactorColumns, factored: &Factored, theta: &[f64]) -> Vec<WarmingContrast> {
    let pair = |factors: &[JointFactor], joint: JointIndex| {
        let theta = columns.select(joint, theta);
        let mut sums = MotionSums::default();
        for of in factors.iter().filter(|of| of.joint == joint) {
            sums.add(of.motion, TorqueSums::of(&of.factor, &theta));
        }
        sums.rmsd()
    };
    (0..columns.joint_count())
        .map(JointIndex::new)
        .map(|joint| WarmingContrast {
            joint,
            start: pair(&factored.warming_start, joint),
            end: pair(&factored.warming_end, joint),
        })
        .filter(|contrast| contrast.start.all_rows.samples > 0 && contrast.end.all_rows.samples > 0)
        .collect()
}
