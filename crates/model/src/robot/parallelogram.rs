//! Parallelograms, as in palletisers: a crank next to the upper arm moves the forearm.

use super::joint_index::JointIndex;
use super::standard_parameters::StandardParameters;
use super::{Joint, JointKind};

/// Cosine of the largest angle between parallel axes: rounded descriptions are off by 1e-4 rad.
const PARALLEL: f64 = 1.0 - 1e-7;

/// A parallelogram whose crank turns about the axis of the upper arm's joint, parallel to the forearm.
///
/// The crank is a separate body with ten parameters. The rod between crank and forearm needs none: its inertia is
/// included in the upper arm, and its mass in crank and forearm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parallelogram {
    /// Joint of the upper arm, about whose axis the crank turns.
    pub upper_arm: JointIndex,
    /// Joint of the forearm, the next one; the parameters are named after it.
    pub forearm: JointIndex,
    /// 1 if the two axes have the same direction, -1 if they are opposite: the position of the crank is `q_upper_arm +
    /// sense q_forearm`.
    pub sense: f64,
    /// Parameters of the crank, if known; the simulator uses them. Its frame is that of the upper arm's joint, turned
    /// with the crank.
    pub nominal: Option<StandardParameters>,
}

impl Parallelogram {
    /// The parallelogram that moves the forearm of `joints`; `None` unless it and the joint before it turn about
    /// parallel axes.
    #[must_use]
    pub fn new(joints: &[Joint], forearm: JointIndex, nominal: Option<StandardParameters>) -> Option<Self> {
        let upper_arm = JointIndex::new(forearm.index().checked_sub(1)?);
        let pair = [joints.get(upper_arm.index())?, joints.get(forearm.index())?];
        let along = pair[1].geometry.placement().rotation.m33;
        let turn = pair.iter().all(|joint| joint.kind == JointKind::Revolute);
        (turn && along.abs() > PARALLEL).then(|| Self { upper_arm, forearm, sense: along.signum(), nominal })
    }

    /// Names of the crank's parameters, in the order of [`StandardParameters::NAMES`].
    pub(super) const NAMES: [&'static str; StandardParameters::COUNT] =
        ["c_m", "c_mPx", "c_mPy", "c_mPz", "c_Ixx", "c_Ixy", "c_Ixz", "c_Iyy", "c_Iyz", "c_Izz"];

    /// Position, velocity or acceleration of the crank about the upper arm's axis, from those of all joints.
    #[inline]
    #[must_use]
    pub fn crank(&self, of_joints: &[f64]) -> f64 {
        of_joints[self.upper_arm.index()] + self.sense * of_joints[self.forearm.index()]
    }
}
