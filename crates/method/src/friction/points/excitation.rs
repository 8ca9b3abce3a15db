//! Friction from a run's excitation: the identified friction coefficients at one speed.
//!
//! Recordings without a friction stage have no friction points. Their identified coefficients still follow the friction
//! of the joints, so they are comparable with those of the same arm's earlier runs.

use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::measurements::CycleParameters;
use armwatch_model::analysis::{Estimate, IdentifiedParameter, WarmFriction};
use armwatch_model::robot::{FrictionTerm, JointIndex, ParameterKind, Robot};

/// Largest assumed speed of a joint in the excitation, as a multiple of its mean speed: a sine reaches 1.57 times its
/// mean, sums of sines more. Beyond it, a polynomial is an extrapolation.
const REACHED: f64 = 2.0;

/// Friction of a joint in a run's excitation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExcitationFriction {
    /// Friction at the largest known speed.
    pub friction: WarmFriction,
    /// Friction at half that speed, Nm (N). A run that reaches a lower speed is compared there.
    pub at_half_speed: Option<Estimate>,
}

/// Friction torque of each joint over the last third of a run's cycles, `[n]`: the median over these cycles of the
/// identified friction, as the mean of both directions. The speed is `reference_fraction` of the joint's largest speed,
/// or a half, a quarter or an eighth of it, so that it does not exceed twice the joint's mean speed. The standard error
/// assumes uncorrelated coefficients, which is too large for neighbouring powers of the speed. `None` for a joint
/// without friction coefficients.
#[must_use]
pub fn excitation_friction(
    robot: &Robot,
    reference_fraction: f64,
    cycles: &[CycleParameters],
) -> Vec<Option<ExcitationFriction>> {
    let last = cycles.iter().map(|of| of.cycle).max().unwrap_or(0);
    let warm: Vec<&CycleParameters> =
        cycles.iter().filter(|of| of.cycle >= (last - last / 3).max(1)).collect();
    robot.joint_indices().map(|joint| of_joint(robot, joint, reference_fraction, &warm)).collect()
}

fn of_joint(
    robot: &Robot,
    joint: JointIndex,
    reference_fraction: f64,
    cycles: &[&CycleParameters],
) -> Option<ExcitationFriction> {
    let largest = robot.joints[joint.index()].limits.velocity;
    let speeds: Vec<f64> =
        cycles.iter().filter_map(|of| of.mean_speeds.get(joint.index()).copied()).collect();
    let reached = mean(&speeds).filter(|speed| *speed > 0.0).map_or(f64::INFINITY, |mean| REACHED * mean);
    let speed = reference_fraction * largest * halved(reference_fraction * largest, reached);
    let at = |speed: f64| {
        let found: Vec<(f64, f64)> =
            cycles.iter().filter_map(|of| friction_at(robot, joint, speed, &of.parameters)).collect();
        let torques: Vec<f64> = found.iter().map(|(torque, _)| *torque).collect();
        let errors: Vec<f64> = found.iter().map(|(_, error)| *error).collect();
        let value = median(&torques).filter(|torque| *torque > 0.0)?;
        Some(Estimate { value, std_error: median(&errors)? / (errors.len() as f64).sqrt() })
    };
    let Estimate { value: torque, std_error } = at(speed)?;
    let minutes: Vec<f64> = cycles.iter().map(|of| of.minute).collect();
    Some(ExcitationFriction {
        friction: WarmFriction {
            torque,
            std_error,
            minute: mean(&minutes)?,
            speed_fraction: speed / largest,
        },
        at_half_speed: at(0.5 * speed),
    })
}

/// Largest of 1, 1/2 and 1/4 that reduces `speed` to `reached` or below, otherwise 1/8. A separate speed for each mean
/// speed would differ between runs.
fn halved(speed: f64, reached: f64) -> f64 {
    [1.0, 0.5, 0.25].into_iter().find(|part| part * speed <= reached).unwrap_or(0.125)
}

/// Mean friction of both directions at `speed` and its standard error, Nm (N).
fn friction_at(
    robot: &Robot,
    joint: JointIndex,
    speed: f64,
    parameters: &[IdentifiedParameter],
) -> Option<(f64, f64)> {
    let (forth, back) = (robot.friction.columns(speed), robot.friction.columns(-speed));
    // an offset of the torque signal is no friction, and cancels in the mean of both directions
    let wanted = robot.friction.terms().iter().filter(|term| **term != FrictionTerm::Offset).count();
    let mut known = 0;
    let (mut torque, mut variance) = (0.0, 0.0);
    for parameter in parameters.iter().filter(|of| of.id.joint == joint && of.is_shown()) {
        let ParameterKind::Friction(term) = parameter.id.kind else { continue };
        let place = robot.friction.terms().iter().position(|of| *of == term && term != FrictionTerm::Offset);
        let Some(place) = place else { continue };
        let column = 0.5 * (forth[place] - back[place]);
        torque += column * parameter.value;
        variance += (column * parameter.std_error).powi(2);
        known += 1;
    }
    (known > 0 && known == wanted).then_some((torque, variance.sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::ParameterId;
    use armwatch_testing::er3a;

    fn cycle(number: u32, factor: f64, mean_speed: f64) -> CycleParameters {
        let robot = er3a();
        let joint = JointIndex::new(2);
        let values = [2.0, 8.0, -2.5, 0.3];
        let parameters = robot.friction.terms().iter().zip(values).map(|(term, value)| IdentifiedParameter {
            id: ParameterId { joint, kind: ParameterKind::Friction(*term) },
            value: factor * value,
            std_error: 0.1,
            degrees_of_freedom: 50.0,
        });
        CycleParameters {
            cycle: number,
            minute: 5.0 * f64::from(number),
            mean_speeds: vec![mean_speed; 6],
            parameters: parameters.collect(),
        }
    }

    #[test]
    fn the_last_third_gives_the_law_at_the_reference_speed() {
        let cycles: Vec<_> =
            (1..=6).map(|number| cycle(number, 1.0 + 1.0 / f64::from(number), 5.0)).collect();
        let found = excitation_friction(&er3a(), 0.6, &cycles);
        assert_eq!(found[0], None, "no coefficients, no friction");
        let found = found[2].expect("friction");
        let third = found.friction;
        let speed = 0.6 * er3a().joints[2].limits.velocity;
        let law = 2.0 + 8.0 * speed - 2.5 * speed * speed + 0.3 * speed.powi(3);
        let factor = median(&[1.0 + 1.0 / 4.0, 1.0 + 1.0 / 5.0, 1.0 + 1.0 / 6.0]).expect("three");
        assert!((third.torque - factor * law).abs() < 1e-9, "{third:?}");
        let error = (1.0 + speed * speed + speed.powi(4) + speed.powi(6)).sqrt() * 0.1 / 3.0_f64.sqrt();
        assert!((third.std_error - error).abs() < 1e-9, "{third:?}");
        let half = 0.5 * speed;
        let law_at_half = 2.0 + 8.0 * half - 2.5 * half * half + 0.3 * half.powi(3);
        assert!((found.at_half_speed.expect("friction").value - factor * law_at_half).abs() < 1e-9);
        assert!((third.minute - 25.0).abs() < 1e-9 && (third.speed_fraction - 0.6).abs() < 1e-9, "{third:?}");
    }

    #[test]
    fn a_slow_excitation_is_not_extrapolated() {
        let found = excitation_friction(&er3a(), 0.6, &[cycle(1, 1.0, 0.4)]);
        let slow = found[2].expect("friction").friction;
        // a quarter of 0.6 is the first that is below 0.8 rad/s
        let speed = 0.15 * er3a().joints[2].limits.velocity;
        assert!((slow.torque - (2.0 + 8.0 * speed - 2.5 * speed * speed + 0.3 * speed.powi(3))).abs() < 1e-9);
        assert!((slow.speed_fraction - 0.15).abs() < 1e-9, "{slow:?}");
    }
}
