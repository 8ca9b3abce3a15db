//! Backlash in a gear: if the torque that it carries changes its sign, the driven side is free until it hits the other
//! flank.

use std::f64::consts::TAU;

use crate::arm::dynamics::{RigidChain, joint_torque};
use crate::plan::motion::MotionState;
use armwatch_model::robot::{JointIndex, MAX_JOINTS};

/// First natural frequency of a drive train, Hz, and its damping ratio: 10 to 30 Hz and some per cent are usual of
/// industrial arms (Siciliano, Khatib, Handbook of Robotics, 2016, chapter 11).
const MODE_HZ: f64 = 15.0;
const DAMPING: f64 = 0.08;
/// Longest step of the free motion, s.
const STEP_S: f64 = 1e-3;

/// A gear with backlash, from row to row.
#[derive(Debug, Clone, Default)]
pub(super) struct LooseGear {
    /// Time of the row before, s.
    time: Option<f64>,
    /// Sign of the torque that the touching flank carries.
    flank: f64,
    /// While no flank touches: distance from the last touching flank, rad (m), and its rate.
    free: Option<[f64; 2]>,
    /// The latest impact: its time, s, and the initial size of its oscillation, Nm (N).
    blow: Option<[f64; 2]>,
}

impl LooseGear {
    /// Takes the motion at `time`, s, and returns the additional torque of the motor compared with no backlash, Nm (N).
    pub(super) fn step(
        &mut self,
        chain: &RigidChain,
        state: &MotionState,
        joint: JointIndex,
        play: f64,
        time: f64,
    ) -> f64 {
        let carried = driven_torque(chain, state, joint);
        let passed = self.time.replace(time).map_or(0.0, |before| time - before);
        if self.flank == 0.0 {
            self.flank = carried.signum();
        }
        if self.free.is_none() && carried * self.flank < 0.0 {
            self.free = Some([0.0; 2]);
        }
        if self.free.is_some() {
            let inertia = driven_inertia(chain, state, joint);
            self.fall(carried, inertia, play, passed, time);
        }
        let missing = if self.free.is_some() { -carried } else { 0.0 };
        missing + self.blow.map_or(0.0, |[since, size]| rings(time - since, size))
    }

    /// Moves the free side for `passed` s, until it meets a flank.
    fn fall(&mut self, carried: f64, inertia: f64, play: f64, passed: f64, time: f64) {
        let steps = (passed / STEP_S).ceil().max(1.0);
        let dt = passed / steps;
        // a torque against the last touching flank drives away from it
        let acceleration = -carried * self.flank / inertia;
        for _ in 0..steps as u32 {
            let Some([way, rate]) = self.free else { return };
            let rate = rate + acceleration * dt;
            let way = way + rate * dt;
            let met = if way >= play { -self.flank } else { self.flank };
            if way >= play || way < 0.0 {
                self.free = None;
                self.flank = met;
                self.blow = Some([time, met * inertia * rate.abs() * TAU * MODE_HZ]);
            } else {
                self.free = Some([way, rate]);
            }
        }
    }
}

/// A decaying oscillation, `since` s after it began with `size`.
fn rings(since: f64, size: f64) -> f64 {
    let angle = TAU * MODE_HZ * since;
    size * (-DAMPING * angle).exp() * angle.sin()
}

/// Torque that the gear passes on: that of the links, without the motor's inertia and friction.
fn driven_torque(chain: &RigidChain, state: &MotionState, joint: JointIndex) -> f64 {
    let j = joint.index();
    joint_torque(chain, state)[j] - chain.motor_inertia(joint) * state.acceleration[j]
}

/// Inertia of the links at a joint, with all others at rest.
fn driven_inertia(chain: &RigidChain, state: &MotionState, joint: JointIndex) -> f64 {
    let still = MotionState::at_rest(state.position);
    let mut speeding = still;
    let mut unit = [0.0; MAX_JOINTS];
    unit[joint.index()] = 1.0;
    speeding.acceleration = unit;
    driven_torque(chain, &speeding, joint) - driven_torque(chain, &still, joint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::dynamics::rigid_chain;
    use crate::test_arms::er3a;

    /// Additional torque over time by backlash of joint 1, which carries no gravity: its load changes sides as it
    /// accelerates back and forth.
    fn added(play: f64, amplitude: f64) -> Vec<(f64, f64, f64)> {
        let chain = rigid_chain(&er3a()).unwrap();
        let joint = JointIndex::new(0);
        let mut gear = LooseGear::default();
        (0..4000)
            .map(|k| {
                let time = 0.5e-3 * f64::from(k);
                let mut state = MotionState::at_rest([0.1; MAX_JOINTS]);
                state.acceleration[0] = amplitude * (TAU * time).cos();
                let more = gear.step(&chain, &state, joint, play, time);
                (time, driven_torque(&chain, &state, joint), more)
            })
            .collect()
    }

    #[test]
    fn without_play_nothing_is_lost_for_long() {
        let worst = |play: f64| {
            let rows = added(play, 3.0);
            let squares: f64 = rows.iter().map(|(.., more)| more * more).sum();
            (squares / rows.len() as f64).sqrt()
        };
        let (none, some, more) = (worst(0.0), worst(1e-3), worst(4e-3));
        assert!(none < 0.1 * some && some < more, "{none} {some} {more}");
    }

    #[test]
    fn the_gear_carries_nothing_while_it_is_free_and_free_time_is_that_of_constant_acceleration() {
        // a torque of constant size that changes its sign once
        let chain = rigid_chain(&er3a()).unwrap();
        let joint = JointIndex::new(0);
        let inertia = driven_inertia(&chain, &MotionState::at_rest([0.1; MAX_JOINTS]), joint);
        let (play, amplitude, dt) = (2e-3, 4.0, 1e-4);
        let mut gear = LooseGear::default();
        let mut free = 0;
        for k in 0..4000 {
            let time = dt * f64::from(k);
            let mut state = MotionState::at_rest([0.1; MAX_JOINTS]);
            state.acceleration[0] = if time < 0.1 { amplitude } else { -amplitude };
            let carried = driven_torque(&chain, &state, joint);
            let more = gear.step(&chain, &state, joint, play, time);
            if gear.free.is_some() {
                assert!((more + carried).abs() < 1e-9 * carried.abs());
                free += 1;
            }
        }
        assert!(inertia > 0.0);
        // travel = a t^2 / 2, for any inertia, if the gear carries only inertia
        let expected = (2.0 * play / amplitude).sqrt();
        assert!((f64::from(free) * dt / expected - 1.0).abs() < 0.05, "{free} {expected}");
    }
}
