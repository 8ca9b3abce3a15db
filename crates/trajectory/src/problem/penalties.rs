//! Penalties of limits in a search, with their gradients.

use super::{MISSED, SearchProblem, SeriesSlope};
use crate::clearance::nearest_of_series;
use crate::observation::{JointRows, MotionSlope};
use crate::series::between_instants;
use armwatch_method::lanes::{LANES, Lanes};
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes};
use armwatch_model::robot::FourierExcitation;

/// Unit of the penalty for missing distances, m.
const CLEARANCE_SCALE_M: f64 = 0.05;

/// Additional distance that a search keeps, m, because it checks fewer instants than the final check.
const CLEARANCE_ROOM_M: f64 = 0.005;

impl SearchProblem<'_> {
    /// Penalty of exceeded limits of position, velocity and acceleration, squared.
    pub(super) fn exceeding(&self, states: &[LaneStates], penalty: f64, slopes: &mut [MotionSlope]) -> f64 {
        let instants = self.basis.instants();
        let margin = between_instants(self.settings.harmonics, instants);
        let weight = penalty / instants as f64;
        let mut cost = 0.0;
        for (group, (states, slopes)) in states.iter().zip(slopes).enumerate() {
            let present = self.basis.present(group);
            for (j, limits) in self.settings.limits.iter().enumerate() {
                let mut each = |value: f64, limit: f64, slope: &mut f64| {
                    let excess = value.abs() * margin / limit - 1.0;
                    if excess > 0.0 {
                        cost += weight * excess * excess;
                        *slope += 2.0 * weight * excess * margin / limit * value.signum();
                    }
                };
                for lane in (0..LANES).filter(|lane| present.0[*lane] > 0.0) {
                    let off_middle = states.q[j].0[lane] - limits.middle();
                    each(off_middle, limits.half_range(), &mut slopes.q[j].0[lane]);
                    each(states.qd[j].0[lane], limits.velocity, &mut slopes.qd[j].0[lane]);
                    each(states.qdd[j].0[lane], limits.acceleration, &mut slopes.qdd[j].0[lane]);
                }
            }
        }
        cost
    }

    /// Penalty of each joint's missing largest speed, squared.
    pub(super) fn too_slow(&self, states: &[LaneStates], penalty: f64, slopes: &mut [MotionSlope]) -> f64 {
        let share = self.settings.reached_speed;
        if share <= 0.0 {
            return 0.0;
        }
        let weight = penalty / self.robot.joint_count() as f64;
        let mut cost = 0.0;
        for (j, limits) in self.settings.limits.iter().enumerate() {
            let speeds = states
                .iter()
                .enumerate()
                .flat_map(|(group, states)| (0..LANES).map(move |lane| (group, lane, states.qd[j].0[lane])));
            let fastest = speeds.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
            let Some((group, lane, speed)) = fastest else { continue };
            let lacking = 1.0 - speed.abs() / (share * limits.velocity);
            if lacking > 0.0 {
                cost += weight * lacking * lacking;
                slopes[group].qd[j].0[lane] -=
                    2.0 * weight * lacking / (share * limits.velocity) * speed.signum();
            }
        }
        cost
    }

    /// Penalty of exceeded limits of torque, squared: its root mean square over the period, and its magnitude.
    pub(super) fn torque_exceeding(
        &self,
        states: &[LaneStates],
        penalty: f64,
        regressors: &mut RegressorLanes,
        slopes: &mut [MotionSlope],
    ) -> f64 {
        let (Some(limits), Some(observation)) = (&self.settings.torque, &self.torque) else { return 0.0 };
        let n = self.robot.joint_count();
        let instants = self.basis.instants() as f64;
        let rows = self.present_rows(observation, states, regressors);
        let torque = |row: &[Lanes], joint: usize| {
            let entries = observation.entries(joint).iter().zip(row);
            entries.fold(Lanes::ZERO, |sum, (&k, x)| sum + *x * limits.parameters[k])
        };
        let torques: Vec<Vec<Lanes>> =
            rows.iter().map(|rows| (0..n).map(|j| torque(&rows[j], j)).collect()).collect();
        let mut cost = 0.0;
        let mut by_torque = vec![vec![Lanes::ZERO; n]; states.len()];
        for j in 0..n {
            if let Some(limit) = limits.mean_square_root[j] {
                let weights: Vec<(usize, f64)> = limits
                    .duty
                    .row(j)
                    .iter()
                    .copied()
                    .enumerate()
                    .filter(|(_, weight)| *weight != 0.0)
                    .collect();
                let duty = |of: &Vec<Lanes>| {
                    weights.iter().fold(Lanes::ZERO, |sum, &(k, weight)| sum + of[k] * weight)
                };
                let duty: Vec<Lanes> = torques.iter().map(duty).collect();
                let squares: f64 = duty.iter().map(|of| (*of * *of).sum()).sum();
                let effective = (squares / instants).sqrt();
                let excess = effective / limit - 1.0;
                if excess > 0.0 {
                    cost += penalty * excess * excess;
                    let factor = 2.0 * penalty * excess / (limit * effective * instants);
                    for (by, of) in by_torque.iter_mut().zip(&duty) {
                        weights.iter().for_each(|&(k, weight)| by[k] += *of * (factor * weight));
                    }
                }
            }
            let Some(limit) = limits.peak[j] else { continue };
            let weight = penalty / instants;
            for (by, of) in by_torque.iter_mut().zip(&torques) {
                for lane in 0..LANES {
                    let excess = of[j].0[lane].abs() / limit - 1.0;
                    if excess > 0.0 {
                        cost += weight * excess * excess;
                        by[j].0[lane] += 2.0 * weight * excess / limit * of[j].0[lane].signum();
                    }
                }
            }
        }
        if cost > 0.0 {
            for (group, (by, slope)) in by_torque.iter().zip(slopes).enumerate() {
                if by.iter().all(|of| *of == Lanes::ZERO) {
                    continue;
                }
                let entries: JointRows = (0..n)
                    .map(|j| observation.entries(j).iter().map(|&k| by[j] * limits.parameters[k]).collect())
                    .collect();
                let own = observation.motion_slope(&states[group], &entries, regressors);
                for j in 0..n {
                    slope.q[j] += own.q[j];
                    slope.qd[j] += own.qd[j];
                    slope.qdd[j] += own.qdd[j];
                }
            }
        }
        cost
    }

    /// Penalty of exceeded limits of the jerk, squared; adds its gradient to that along the variables of the search.
    pub(super) fn jerk_exceeding(&self, series: &FourierExcitation, penalty: f64, slope: &mut [f64]) -> f64 {
        let instants = self.basis.instants();
        let margin = between_instants(self.settings.harmonics, instants);
        let weight = penalty / instants as f64;
        let mut cost = 0.0;
        for (j, limits) in self.settings.limits.iter().enumerate() {
            let Some(limit) = limits.jerk else { continue };
            let mut by = SeriesSlope::new(self.settings.harmonics);
            for group in 0..self.basis.groups() {
                let mut by_jerk = self.basis.jerk(&series.a[j], &series.b[j], group);
                let present = self.basis.present(group);
                for (value, present) in by_jerk.0.iter_mut().zip(present.0) {
                    let excess = (value.abs() * margin / limit - 1.0).max(0.0) * present;
                    cost += weight * excess * excess;
                    *value = 2.0 * weight * excess * margin / limit * value.signum();
                }
                for (l, &[sine, cosine]) in self.basis.waves(group).iter().enumerate() {
                    let squared = self.basis.angular_frequency(l + 1).powi(2);
                    by.a[l] -= by_jerk * cosine * squared;
                    by.b[l] -= by_jerk * sine * squared;
                }
            }
            let own = by.along_numbers(limits, self.settings.form);
            slope[j * own.len()..].iter_mut().zip(own).for_each(|(slope, own)| *slope += own);
        }
        cost
    }

    /// Penalty of missing distances, squared.
    pub(super) fn too_near(&self, states: &[LaneStates], penalty: f64, slopes: &mut [MotionSlope]) -> f64 {
        let Some(limit) = &self.settings.clearance else { return 0.0 };
        let wanted = limit.distance + CLEARANCE_ROOM_M;
        let weight = penalty / self.basis.instants() as f64;
        let n = self.robot.joint_count();
        let mut cost = 0.0;
        let mut posture = vec![0.0; n];
        for (group, (states, slopes)) in states.iter().zip(slopes).enumerate() {
            let present = self.basis.present(group);
            for lane in (0..LANES).filter(|lane| present.0[*lane] > 0.0) {
                posture.iter_mut().zip(&states.q).for_each(|(q, of)| *q = of.0[lane]);
                limit.clearance.distances(self.robot, &posture, wanted, |near| {
                    let lacking = (wanted - near.distance) / CLEARANCE_SCALE_M;
                    if lacking <= 0.0 {
                        return;
                    }
                    cost += weight * lacking * lacking;
                    for (slope, by) in slopes.q.iter_mut().zip(&near.slope[..n]) {
                        slope.0[lane] -= 2.0 * weight * lacking / CLEARANCE_SCALE_M * by;
                    }
                });
            }
        }
        cost
    }

    /// Penalty of a series that comes closer than allowed, including between the instants of the search.
    pub(super) fn nearer_than_allowed(&self, series: &FourierExcitation) -> f64 {
        let Some(limit) = &self.settings.clearance else { return 0.0 };
        let nearest = nearest_of_series(self.robot, &limit.clearance, series);
        let lacking = nearest.iter().map(|near| (limit.distance - near.at_least).max(0.0));
        lacking.map(|lacking| MISSED * (lacking / CLEARANCE_SCALE_M).powi(2)).sum()
    }
}
