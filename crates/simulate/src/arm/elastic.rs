//! Joints with elastic gears: one spring per joint between motor and link.
//!
//! The planned motion is that of the links, `q`. A spring of stiffness `k` that carries the torque `tau` of the links
//! turns by `tau / k`, so that the motor is at `theta = q + tau / k` (Spong 1987, Modeling and control of elastic joint
//! robots). The controller measures the motor; its inertia and the friction of the gear follow the motor's motion.
//! Derivatives of `tau` are central differences.

use super::dynamics::{RigidChain, link_torque};
use crate::plan::motion::{MotionState, PerJoint};

/// Step of the differences, s: an elastic gear oscillates at some ten hertz, a hundredth of this rate.
const STEP_S: f64 = 1e-3;

/// Motion of the motors at `t`, s, seen at the joints, for the motion `links` of the links; `compliance` is
/// 1/stiffness, rad/Nm (m/N), 0 for a stiff joint.
pub(crate) fn motor_state(
    chain: &RigidChain,
    compliance: &PerJoint,
    links: &dyn Fn(f64) -> MotionState,
    t: f64,
) -> MotionState {
    let [before, now, after] = [t - STEP_S, t, t + STEP_S].map(|t| link_torque(chain, &links(t)));
    let mut state = links(t);
    for (j, compliance) in compliance.iter().enumerate().filter(|(_, compliance)| **compliance > 0.0) {
        state.position[j] += compliance * now[j];
        state.velocity[j] += compliance * (after[j] - before[j]) / (2.0 * STEP_S);
        state.acceleration[j] += compliance * (after[j] + before[j] - 2.0 * now[j]) / (STEP_S * STEP_S);
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::dynamics::rigid_chain;
    use crate::plan::trajectory::{PlanSettings, plan_cycle};
    use crate::test_arms::er3a;
    use armwatch_model::robot::MAX_JOINTS;
    use armwatch_model::run::Stage;

    /// Torques of some ten Nm over 1e4 Nm/rad, and differences of them over 1 ms.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn a_spring_turns_by_its_torque_and_a_stiff_joint_does_not() {
        let robot = er3a();
        let chain = rigid_chain(&robot).expect("nominal parameters");
        let settings = PlanSettings { seed: 3, ..PlanSettings::default() };
        let plan = plan_cycle(&robot, &settings).expect("a plan");
        let mut compliance = [0.0; MAX_JOINTS];
        compliance[1] = 1e-4;
        for segment in plan.segments.iter().filter(|segment| segment.stage == Stage::Excitation) {
            let t = segment.start + 0.4 * segment.duration;
            let path = |t: f64| segment.state_at(t);
            let (links, motors) = (path(t), motor_state(&chain, &compliance, &path, t));
            let turned = compliance[1] * link_torque(&chain, &links)[1];
            assert!(
                (motors.position[1] - links.position[1] - turned).abs() < ROUNDING && turned.abs() > 1e-5
            );
            for j in [0, 2, 3, 4, 5] {
                assert_eq!(
                    (motors.position[j], motors.velocity[j], motors.acceleration[j]),
                    (links.position[j], links.velocity[j], links.acceleration[j])
                );
            }
            // velocity and acceleration are those of the motor's own position
            let step = 2e-3;
            let at = |t: f64| motor_state(&chain, &compliance, &path, t);
            let (before, after) = (at(t - step), at(t + step));
            let velocity = (after.position[1] - before.position[1]) / (2.0 * step);
            let acceleration = (after.velocity[1] - before.velocity[1]) / (2.0 * step);
            assert!((velocity / motors.velocity[1] - 1.0).abs() < 1e-3, "{velocity} {}", motors.velocity[1]);
            let scale = robot.joints[1].limits.acceleration;
            assert!(
                (acceleration - motors.acceleration[1]).abs() < 1e-3 * scale,
                "{acceleration} {motors:?}"
            );
        }
    }
}
