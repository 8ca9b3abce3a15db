//! Compares a motion with all limits of the arm and its surroundings.

use serde_json::{Value, json};

use super::limit_texts;
use super::torque::{TorqueUse, heating, peaks_beyond, torque_use, without_coupled_motors};
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
    /// Torques of the motors, or the reason why they cannot be computed.
    torques: Result<Vec<TorqueUse>, String>,
    /// True if the speeds are known, by the motion or its file.
    has_speeds: bool,
}

/// A limit of the description that was not checked.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Unchecked {
    /// Its joint; `None` for a limit of the arm.
    pub joint: Option<JointIndex>,
    /// The limited quantity.
    pub quantity: String,
    /// Why, with the remedy.
    pub reason: String,
}

impl Unchecked {
    /// In one sentence.
    pub fn sentence(&self) -> String {
        let joint = self.joint.map_or_else(String::new, |joint| format!("joint {joint}: "));
        format!("{joint}{}; {}", self.quantity, self.reason)
    }

    /// For scripts.
    pub fn as_value(&self) -> Value {
        json!({
            "joint": self.joint.map(JointIndex::number), "quantity": self.quantity, "reason": self.reason,
        })
    }
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
            has_speeds: true,
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
            _ => Err("the file has no velocities and accelerations of all joints".to_owned()),
        };
        let postures = rows.map(|k| (motion.times[k], row(k, &motion.positions)));
        Ok(Self {
            robot,
            limit,
            check: broken_by_samples(robot, motion),
            nearest: limit
                .map_or_else(Vec::new, |limit| nearest_of_postures(robot, &limit.clearance, postures)),
            torques,
            has_speeds: motion.velocities.is_some(),
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

    /// Limits of the description that were not checked: of motion, then torque, then distances.
    pub fn unchecked(&self) -> Vec<Unchecked> {
        let motion = self.check.unjudged.iter().map(|&(joint, quantity, _)| Unchecked {
            joint: Some(joint),
            quantity: quantity.to_string(),
            reason: match (quantity, self.has_speeds) {
                (Limited::Jerk, false) => {
                    format!("positions alone do not show it, give velocities (vel_{joint})")
                }
                _ => format!(
                    "the file has too few digits for it, give velocities (vel_{joint}), accelerations (acc_{joint}) or \
                     more digits"
                ),
            },
        });
        let peaks = self.torques.as_ref().err().into_iter().flat_map(|reason| {
            let limited = self
                .robot
                .joint_indices()
                .filter(|joint| self.robot.joints[joint.index()].peak_torque.is_some());
            limited.map(|joint| Unchecked {
                joint: Some(joint),
                quantity: "peak torque".to_owned(),
                reason: reason.clone(),
            })
        });
        let clearance = (self.limit.is_none() && self.has_shape()).then(|| Unchecked {
            joint: None,
            quantity: "clearance".to_owned(),
            reason:
                "the description has capsules, but no pairs of links (self_collision), and no --cell is given"
                    .to_owned(),
        });
        motion.chain(peaks).chain(clearance).collect()
    }

    /// Returns true if a link that moves has a described shape.
    fn has_shape(&self) -> bool {
        self.robot.shape.capsules.iter().any(|capsule| capsule.link > 0)
    }

    /// Returns true if every limit was checked and kept.
    pub fn is_kept(&self) -> bool {
        self.unchecked().is_empty() && self.broken().is_empty()
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
            ("peak torque", has_peak && self.torques.is_ok()),
            ("clearance", self.limit.is_some()),
        ];
        let names: Vec<&str> =
            judged.into_iter().filter(|(_, judged)| *judged).map(|(name, _)| name).collect();
        names.join(", ")
    }

    /// Remarks on torques, and quantities without a described limit, which must not be mistaken for kept ones.
    pub fn hints(&self) -> Vec<String> {
        let mut hints = Vec::new();
        if self.limit.is_none() && !self.has_shape() {
            hints.push(
                "clearance is not judged: the description has no pairs of links to check, and no --cell is \
                given"
                    .to_owned(),
            );
        }
        hints.extend(self.torque_hints());
        hints
    }

    /// Remarks on torques.
    pub fn torque_hints(&self) -> Vec<String> {
        let mut hints = Vec::new();
        match &self.torques {
            Ok(joints) => {
                hints.extend(heating(joints));
                hints.extend(without_coupled_motors(self.robot));
            }
            Err(reason) if self.robot.joints.iter().all(|joint| joint.peak_torque.is_none()) => {
                hints.push(format!("torques are not judged: {reason}"));
            }
            Err(_) => {}
        }
        hints
    }

    /// Prints the limits of the description that were not checked.
    pub fn print_unchecked(&self) {
        for unchecked in self.unchecked() {
            output::print_hint(&format!("not judged: {}", unchecked.sentence()));
        }
    }

    /// Prints torques and smallest distances as tables, with an empty line before each.
    pub fn print(&self) {
        if let Ok(joints) = &self.torques {
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
        self.torques.as_deref().ok().map(super::torque::as_value)
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
