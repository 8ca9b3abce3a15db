//! Agreement of estimated torques with measured ones.

use serde::ser::SerializeStruct;
use serde::{Serialize, Serializer};

use crate::robot::JointIndex;
use crate::run::Stage;

/// Rows used for a torque RMSD.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum RmsdScope {
    /// Rows of one stage.
    Stage(Stage),
    /// All rows of the cycle.
    WholeCycle,
}

impl RmsdScope {
    /// Name as in the view `cycle_rmsd`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stage(stage) => stage.name(),
            Self::WholeCycle => "all",
        }
    }
}

/// Root-mean-square deviation between estimated and measured torque of a joint [5.1].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueRmsd {
    /// The joint.
    pub joint: JointIndex,
    /// Rows considered.
    pub scope: RmsdScope,
    /// Over all rows.
    pub all_rows: Rmsd,
    /// Over the moving rows; zero samples if the joint never moves.
    pub moving_rows: Rmsd,
}

impl Serialize for TorqueRmsd {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct RmsdColumns {
            joint: JointIndex,
            stage: &'static str,
            #[serde(flatten)]
            rmsd: RmsdPair,
        }
        let rmsd = RmsdPair { all_rows: self.all_rows, moving_rows: self.moving_rows };
        RmsdColumns { joint: self.joint, stage: self.scope.name(), rmsd }.serialize(serializer)
    }
}

/// An RMSD with its reference.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Rmsd {
    /// Root of the mean squared deviation, Nm.
    pub value: f64,
    /// `value` divided by the RMS of the measured, low-passed torque over the same rows.
    pub relative: f64,
    /// Number of rows.
    pub samples: usize,
}

/// Fit of one parameter set to the first and the last third of a warming stage: friction falls within a cycle (thesis
/// 5.1.6).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WarmingContrast {
    /// The joint.
    pub joint: JointIndex,
    /// The first third, by time.
    pub start: RmsdPair,
    /// The last third.
    pub end: RmsdPair,
}

/// An RMSD with and without low-speed rows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RmsdPair {
    /// Over all rows.
    pub all_rows: Rmsd,
    /// Over the moving rows.
    pub moving_rows: Rmsd,
}

/// The columns of the views `cycle_rmsd` and `warming_contrast`; null without rows.
impl Serialize for RmsdPair {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut columns = serializer.serialize_struct("RmsdPair", 6)?;
        let known = |of: Rmsd, value: f64| (of.samples > 0).then_some(value);
        let (all, moving) = (self.all_rows, self.moving_rows);
        columns.serialize_field("rmsd_nm", &known(all, all.value))?;
        columns.serialize_field("relative_rmsd", &known(all, all.relative))?;
        columns.serialize_field("moving_rmsd_nm", &known(moving, moving.value))?;
        columns.serialize_field("moving_relative_rmsd", &known(moving, moving.relative))?;
        columns.serialize_field("samples", &all.samples)?;
        columns.serialize_field("moving_samples", &moving.samples)?;
        columns.end()
    }
}
