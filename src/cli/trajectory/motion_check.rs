//! Compares a motion with all limits of the arm and its surroundings.

use serde_json::{Value, json};

use super::limit_texts;
use super::torque::{TorqueUse, heating, peaks_beyond, torque_use};
use crate::cli::context::CliError;
use crate::cli::shared::output;
use armwatch_model::robot::{FourierExcitation, JointIndex, Robot};
use armwatch_trajectory::clearance::{ClearanceLimit, Nearest, nearest_of_postures, nearest_of_series};
use armwatch_trajectory::limits::{Limited, SampleCheck, SampledMotion, broken_by_samples, broken_by_series};
use armwatch_trajectory::series::state_at;

/// Instants per second for computing torques.
const TORQUE_RATE_HZ: f64 = 1000.0;

/// Result of the check.
pub(super) struct MotionCheck<'a> {
    robot: &'a Robot,
    limit: Option<&'a ClearanceLimit>,
    /// Limits of the motion.
    pub check: SampleCheck,
    /// Smallest distance of each pair.
    nearest: Vec<Nearest>,
    /// Torques of the motors, if they can be computed.
    torques: Option<Vec<TorqueUse>>,
}

impl<'a> MotionCheck<'a> {
    /// A series over its period.
    pub fn of_series(
        robot: &'a Robot,
        series: &FourierExcitation,
        limit: Option<&'a ClearanceLimit>,
    ) -> Result<Self, CliError> {
        let instants = (TORQUE_RATE_HZ / series.base_frequency).ceil();
        let states = (0..instants as u64).map(|k| {
            let state = state_at(series, k as f64 / instants / series.base_frequency);
            std::array::from_fn(|quantity| state.iter().map(|of| of[quantity]).collect())
        });
        Ok(Self {
            robot,
            limit,
            check: SampleCheck { breaches: broken_by_series(robot, series), ..SampleCheck::default() },
            nearest: limit.map_or_else(Vec::new, |limit| nearest_of_series(robot, &limit.clearance, series)),
            torques: torque_use(robot, states)?,
        })
    }

    /// Checks samples. Torques are computed if velocities and accelerations are given.
    pub fn of_samples(
        robot: &'a Robot,
        motion: &SampledMotion,
        limit: Option<&'a ClearanceLimit>,
    ) -> Result<Self, CliError> {
        let row = |k: usize, of: &[Vec<f64>]| -> Vec<f64> { of.iter().map(|joint| joint[k]).collect() };
        let rows = 0..motion.times.len();
        let torques = match (&motion.velocities, &motion.accelerations) {
            (Some(qd), Some(qdd)) => {
                torque_use(robot, rows.clone().map(|k| [row(k, &motion.positions), row(k, qd), row(k, qdd)]))?
            }
            _ => None,
        };
        let postures = rows.map(|k| (motion.times[k], row(k, &motion.positions)));
        Ok(Self {
            robot,
            limit,
            check: broken_by_samples(robot, motion),
            nearest: limit
                .map_or_else(Vec::new, |limit| nearest_of_postures(robot, &limit.clearance, postures)),
            torques,
        })
    }

    /// Broken limits, one sentence each.
    pub fn broken(&self) -> Vec<String> {
        let motion = self.check.breaches.iter().map(|breach| limit_texts::sentence(self.robot, breach));
        let near = self.too_near().map(|(name, near, limit)| {
            format!(
                "{name}: {:.1} mm apart at {:.3} s, at least {:.1} mm are required",
                1e3 * near.at_least,
                near.time,
                1e3 * limit
            )
        });
        let torques = self.torques.iter().flat_map(|joints| peaks_beyond(joints));
        motion.chain(near).chain(torques).collect()
    }

    fn too_near(&self) -> impl Iterator<Item = (String, &Nearest, f64)> {
        self.limit.into_iter().flat_map(|limit| {
            let near = self.nearest.iter().filter(|near| near.at_least < limit.distance);
            near.map(|near| (limit.clearance.name(near.pair), near, limit.distance))
        })
    }

    /// Quantities that could not be checked.
    pub fn unjudged(&self) -> &[(JointIndex, Limited, f64)] {
        &self.check.unjudged
    }

    /// Returns true if every limit was checked and kept.
    pub fn is_kept(&self) -> bool {
        self.unjudged().is_empty() && self.broken().is_empty()
    }

    /// Quantities with limits that were checked: `position, speed, acceleration`.
    pub fn quantities(&self) -> String {
        let has_jerk = self.robot.joints.iter().any(|joint| joint.limits.jerk.is_some());
        let has_peak = self.robot.joints.iter().any(|joint| joint.peak_torque.is_some());
        let judged = [
            ("position", true),
            ("speed", true),
            ("acceleration", true),
            ("jerk", has_jerk),
            ("peak torque", has_peak && self.torques.is_some()),
            ("clearance", self.limit.is_some()),
        ];
        let names: Vec<&str> =
            judged.into_iter().filter(|(_, judged)| *judged).map(|(name, _)| name).collect();
        names.join(", ")
    }

    /// Quantities without a known limit, which must not be mistaken for kept ones.
    pub fn hints(&self) -> Vec<String> {
        let mut hints = Vec::new();
        if self.limit.is_none() {
            hints.push(
                "clearance is not judged: the description has no pairs of links to check, and no --cell is \
                given"
                    .to_owned(),
            );
        }
        match &self.torques {
            Some(joints) => hints.extend(heating(joints)),
            None => hints.push(
                "torques are not judged: they need nominal parameters of all joints, and velocities and accelerations"
                    .to_owned(),
            ),
        }
        hints
    }

    /// Prints torques and smallest distances as tables, with an empty line before each.
    pub fn print(&self) {
        if let Some(joints) = &self.torques {
            output::line("");
            super::torque::print_torques(joints);
        }
        let Some(limit) = self.limit else { return };
        let mut nearest: Vec<&Nearest> = self.nearest.iter().collect();
        nearest.sort_by(|a, b| a.at_least.total_cmp(&b.at_least));
        let rows: Vec<Vec<String>> = nearest
            .into_iter()
            .map(|near| {
                vec![
                    limit.clearance.name(near.pair),
                    format!("{:.1}", 1e3 * near.at_least),
                    format!("{:.3}", near.time),
                ]
            })
            .collect();
        output::line("");
        output::print_table(&["clearance of", "at least, mm", "at, s"], &rows, &[]);
    }

    /// Torques and distances for scripts.
    pub fn torque_value(&self) -> Option<Value> {
        self.torques.as_deref().map(super::torque::as_value)
    }

    /// Smallest distances for scripts.
    pub fn clearance_value(&self) -> Option<Value> {
        let limit = self.limit?;
        let each = self.nearest.iter().map(|near| {
            json!({
                "between": limit.clearance.name(near.pair), "distance_m": near.distance,
                "at_least_m": near.at_least, "limit_m": limit.distance, "time_s": near.time,
            })
        });
        Some(each.collect())
    }

    /// Broken limits for scripts: those of joints, then distances, then torques.
    pub fn broken_value(&self) -> Vec<Value> {
        let motion = self.check.breaches.iter().map(|breach| limit_texts::as_value(self.robot, breach));
        let near = self.too_near().map(|(name, near, limit)| {
            json!({
                "between": name, "quantity": "clearance", "unit": "m", "value": near.at_least, "limit": limit,
                "excess": limit - near.at_least, "time_s": near.time,
            })
        });
        let torques =
            self.torques.iter().flatten().zip(1..).filter_map(|(of, joint): (&TorqueUse, usize)| {
                let limit = of.peak_limit.filter(|limit| of.peak > *limit)?;
                Some(json!({
                    "joint": joint, "quantity": "torque", "unit": "Nm (N)", "value": of.peak, "limit": limit,
                    "excess": of.peak - limit,
                }))
            });
        motion.chain(near).chain(torques).collect()
    }
}
