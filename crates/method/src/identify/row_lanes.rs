//! Several rows of a cycle at once, one per lane.

use super::filtered_columns::{FilteredColumn, write_filtered_lanes};
use crate::lanes::{LANES, Lanes};
use crate::model::regressor_lanes::{LaneStates, RegressorLanes, joint_torque_regressors};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::Motion;
use armwatch_model::robot::{MAX_JOINTS, Robot};

/// Motion, torque and regressor of several rows.
pub(crate) struct RowLanes {
    /// Motion.
    pub states: LaneStates,
    /// Torque, `[n]`.
    pub tau: [Lanes; MAX_JOINTS],
    /// Regressor, with low-passed columns for those with jumps.
    pub y: RegressorLanes,
}

impl RowLanes {
    pub(crate) fn new(robot: &Robot) -> Self {
        Self { states: LaneStates::default(), tau: [Lanes::ZERO; MAX_JOINTS], y: RegressorLanes::new(robot) }
    }

    /// Passes `rows` to `visit`, [`LANES`] at a time, with the rows that count: the last ones may be fewer.
    pub(crate) fn each(
        &mut self,
        robot: &Robot,
        filtered: &FilteredSignals,
        filtered_coulomb_columns: &[FilteredColumn],
        rows: impl Iterator<Item = usize>,
        mut visit: impl FnMut(&Self, &[usize]),
    ) {
        let mut rows = rows.peekable();
        while let Some(&first) = rows.peek() {
            let mut at = [first; LANES];
            let mut count = 0;
            for (at, row) in at.iter_mut().zip(&mut rows) {
                *at = row;
                count += 1;
            }
            let [a, b, c, d] = at;
            for j in 0..robot.joint_count() {
                let lanes = |channels: &[Vec<f64>]| {
                    let channel = &channels[j];
                    Lanes([channel[a], channel[b], channel[c], channel[d]])
                };
                self.states.q[j] = lanes(&filtered.q);
                self.states.qd[j] = lanes(&filtered.qd);
                self.states.qdd[j] = lanes(&filtered.qdd);
                self.tau[j] = lanes(&filtered.tau);
            }
            joint_torque_regressors(robot, &self.states, &mut self.y);
            write_filtered_lanes(filtered_coulomb_columns, &at, &mut self.y);
            visit(self, &at[..count]);
        }
    }

    /// Flags of the first `count` rows: true if a joint moves.
    pub(crate) fn moving(&self, robot: &Robot, joint: usize, count: usize) -> [bool; LANES] {
        let (speeds, low_speed) = (self.states.qd[joint].0, robot.joints[joint].counted_speed());
        let mut moving = [false; LANES];
        for (moving, speed) in moving.iter_mut().zip(speeds).take(count) {
            *moving = Motion::of(speed, low_speed) == Motion::Moving;
        }
        moving
    }
}
