//! Temperature of the joints when their friction was identified.

use super::torque::CodeParameter;
use armwatch_method::analyse_run::warm_up_fits;
use armwatch_method::friction::warm_up::warm_up_torque;
use armwatch_model::analysis::{FrictionPoint, WarmUpFit};
use armwatch_model::robot::{JointIndex, ParameterKind, Robot};

/// Warm-up curves of a recording, and the minutes of the cycles that parameters come from.
#[derive(Debug, Clone, PartialEq)]
pub struct WarmUpCurves {
    fits: Vec<WarmUpFit>,
    minutes: Vec<f64>,
}

impl WarmUpCurves {
    /// Curves of the friction points of whole recordings, one recording after another; `minutes` are the middles of the
    /// chosen cycles, min since the start of their recording.
    pub fn new(points: &[FrictionPoint], minutes: Vec<f64>) -> Self {
        Self { fits: warm_up_fits(points), minutes }
    }

    /// First and last middle of the chosen cycles, min; `None` without cycles.
    pub fn minutes(&self) -> Option<[f64; 2]> {
        let first = self.minutes.iter().copied().reduce(f64::min)?;
        let last = self.minutes.iter().copied().reduce(f64::max)?;
        Some([first, last])
    }

    /// Last minute with a measured friction of any joint; `None` without curves.
    pub fn last_minute(&self) -> Option<f64> {
        self.fits.iter().map(|fit| fit.record[1]).reduce(f64::max)
    }

    /// Friction of a joint at a minute, as a multiple of its mean in the chosen cycles: the mean over the speed levels.
    /// `None` if no level has a curve, or a curve gives no positive friction.
    pub fn relative_friction(&self, joint: JointIndex, minute: f64) -> Option<f64> {
        let ratio = |fit: &WarmUpFit| {
            let chosen: f64 = self.minutes.iter().map(|&chosen| warm_up_torque(fit, chosen)).sum();
            warm_up_torque(fit, minute) * self.minutes.len() as f64 / chosen
        };
        let ratios: Vec<f64> = self.of(joint).map(ratio).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        (mean.is_finite() && ratios.iter().all(|ratio| *ratio > 0.0)).then_some(mean)
    }

    fn of(&self, joint: JointIndex) -> impl Iterator<Item = &WarmUpFit> {
        self.fits.iter().filter(move |fit| fit.joint == joint)
    }
}

/// Multiplies the friction of each joint, and of its coupled motor's part, by its factor `[n]`. An offset of the torque
/// signal is not friction and stays.
pub fn scale_friction(robot: &Robot, parameters: &mut [CodeParameter], factors: &[f64]) {
    use armwatch_model::robot::{CouplingTerm, FrictionTerm};
    let is_friction = |kind| match kind {
        ParameterKind::Friction(term) => term != FrictionTerm::Offset,
        ParameterKind::Coupling(term) => term != CouplingTerm::Inertia,
        ParameterKind::Inertial(_)
        | ParameterKind::MotorInertia
        | ParameterKind::Spring(_)
        | ParameterKind::Crank(_) => false,
    };
    let joints = robot.joint_count();
    for of in parameters.iter_mut().filter(|of| is_friction(of.id.kind) && of.id.joint.index() < joints) {
        let factor = factors[of.id.joint.index()];
        of.value *= factor;
        of.std_error = of.std_error.map(|error| error * factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::{Decay, Estimate, WarmUpModel};
    use armwatch_model::robot::ParameterId;
    use armwatch_testing::er3a;

    fn fit(a: f64, b: f64) -> WarmUpFit {
        let estimate = |value| Estimate { value, std_error: 0.01 };
        WarmUpFit {
            joint: JointIndex::new(1),
            speed_fraction: a / 10.0,
            model: WarmUpModel::Single,
            a: estimate(a),
            slow: Some(Decay { amplitude: estimate(b), time_constant: estimate(20.0) }),
            fast: None,
            fast_shown: None,
            rmsd: 0.01,
            samples: 24,
            record: [2.0, 118.0],
        }
    }

    #[test]
    fn friction_at_a_minute_is_relative_to_that_of_the_cycles() {
        let joint = JointIndex::new(1);
        let warm_up = WarmUpCurves { fits: vec![fit(2.0, 1.0), fit(4.0, 2.0)], minutes: vec![0.0, 20.0] };
        // both levels have the same shape: 1 + 0.5 exp(-t / 20)
        let shape = |minute: f64| 1.0 + 0.5 * (-minute / 20.0).exp();
        let expected = shape(60.0) / (0.5 * (shape(0.0) + shape(20.0)));
        let found = warm_up.relative_friction(joint, 60.0).expect("a factor");
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        assert_eq!(warm_up.relative_friction(JointIndex::new(0), 60.0), None);
        assert_eq!((warm_up.minutes(), warm_up.last_minute()), (Some([0.0, 20.0]), Some(118.0)));
        let backwards = WarmUpCurves { fits: vec![fit(2.0, -10.0)], minutes: vec![0.0] };
        assert_eq!(backwards.relative_friction(joint, 60.0), None);
    }

    #[test]
    fn friction_is_scaled_and_nothing_else() {
        let robot = er3a();
        let mut parameters: Vec<CodeParameter> = ParameterId::natural_order(&robot)
            .into_iter()
            .map(|id| CodeParameter { id, value: 1.0, std_error: Some(0.1), stands_for: None })
            .collect();
        scale_friction(&robot, &mut parameters, &[1.0, 1.2, 1.0, 1.0, 1.0, 1.0]);
        let scaled: Vec<String> = parameters
            .iter()
            .filter(|of| of.value != 1.0)
            .map(|of| format!("{} {} {:.2}", of.id, of.value, of.std_error.unwrap_or_default()))
            .collect();
        assert_eq!(scaled, ["J2_f1 1.2 0.12", "J2_f2 1.2 0.12", "J2_f3 1.2 0.12", "J2_f4 1.2 0.12"]);
    }
}
