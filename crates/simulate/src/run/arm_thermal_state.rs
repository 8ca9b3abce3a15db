//! Temperature state of the gears from row to row: by the time since a cold start, or by their work.
//!
//! By time, the remaining coldness falls as `exp(-t / t1)` and `exp(-t / t2)` for any motion [5.4]. By work, each of
//! these parts follows `dc/dt = (1 - p - c) / t1`, with `p` the friction power of the joint relative to its usual one:
//! usual motion gives [5.4] again, rest restores the coldness with the same constants, and harder work warms further.

use super::heat::usual_losses;
use super::recording::{Heating, Recording};
use crate::arm::friction::{ThermalState, cold_parts, multiplier_of, thermal_multiplier};
use crate::plan::motion::PerJoint;
use armwatch_model::robot::MAX_JOINTS;

/// Largest power that counts, in units of the usual one: the first row after rest must not overheat.
const POWER_MOST: f64 = 3.0;

/// The gears of a run.
#[derive(Debug, Clone)]
pub(super) struct ArmThermalState {
    /// By work: usual friction power, W, and remaining coldness, of each joint.
    worked: Option<Vec<(f64, [f64; 2])>>,
}

impl ArmThermalState {
    /// Creates the state at the first row of a run.
    pub fn new(recording: &Recording) -> Self {
        let of_joint = |(usual, friction): ([f64; 2], &crate::arm::friction::JointFriction)| {
            (usual[1], cold_parts(&friction.warm_up, recording.initial.seconds))
        };
        let by_work = || usual_losses(recording).into_iter().zip(&recording.friction).map(of_joint).collect();
        Self { worked: (recording.heating == Heating::Work).then(by_work) }
    }

    /// Friction of each joint at `time`, s, relative to its warm friction at the usual ambient temperature.
    pub fn multipliers(&self, recording: &Recording, time: f64) -> PerJoint {
        let mut found = [1.0; MAX_JOINTS];
        let state = ThermalState { seconds: recording.initial.seconds + time, ..recording.initial };
        for (j, friction) in recording.friction.iter().enumerate() {
            found[j] = match &self.worked {
                None => thermal_multiplier(&friction.warm_up, state),
                Some(joints) => {
                    // friction never falls below a tenth, however hot
                    multiplier_of(&friction.warm_up, joints[j].1, state.ambient_offset_k).max(0.1)
                }
            };
        }
        found
    }

    /// Advances by `dt`, s, at a friction power of `power`, W.
    pub fn step(&mut self, recording: &Recording, dt: f64, power: &PerJoint) {
        let Some(joints) = &mut self.worked else { return };
        for ((usual, cold), (friction, power)) in joints.iter_mut().zip(recording.friction.iter().zip(power))
        {
            let part = (power / *usual).clamp(0.0, POWER_MOST);
            for (cold, constant) in cold.iter_mut().zip([friction.warm_up.t1, friction.warm_up.t2]) {
                if constant > 0.0 {
                    *cold += (dt / constant).min(1.0) * (1.0 - part - *cold);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_arms::er3a;
    use crate::{SimulationSettings, recording_of_run};

    fn recording(heating: Heating) -> Recording {
        let settings = SimulationSettings { heating, ambient_std_k: 0.0, ..SimulationSettings::default() };
        recording_of_run(&er3a(), &settings, 0).unwrap()
    }

    #[test]
    fn usual_work_has_the_friction_of_gears_that_carry_a_load() {
        let losses = |friction_load: f64| {
            let settings = SimulationSettings { friction_load, ..SimulationSettings::default() };
            usual_losses(&recording_of_run(&er3a(), &settings, 0).unwrap())
        };
        for ([_, plain], [_, loaded]) in losses(0.0).iter().zip(losses(0.1)) {
            assert!(loaded > *plain, "{loaded} {plain}");
        }
    }

    #[test]
    fn usual_work_warms_as_time_does_and_rest_cools_again() {
        let (by_time, by_work) = (recording(Heating::Time), recording(Heating::Work));
        let (clock, mut worked) = (ArmThermalState::new(&by_time), ArmThermalState::new(&by_work));
        let mut usual = [0.0; MAX_JOINTS];
        usual_losses(&by_work).iter().zip(&mut usual).for_each(|(of, usual)| *usual = of[1]);
        (0..3000).for_each(|_| worked.step(&by_work, 0.5, &usual));
        let (expected, warm) = (clock.multipliers(&by_time, 1500.0), worked.multipliers(&by_work, 1500.0));
        for j in 0..6 {
            assert!((warm[j] - expected[j]).abs() < 1e-3, "joint {}: {} {}", j + 1, warm[j], expected[j]);
            assert!(warm[j] < 1.2);
        }
        // an hour of rest restores most of the coldness, harder work removes more than all of it
        let mut rested = worked.clone();
        (0..7200).for_each(|_| rested.step(&by_work, 0.5, &[0.0; MAX_JOINTS]));
        let cold = rested.multipliers(&by_work, 0.0);
        (0..20_000).for_each(|_| worked.step(&by_work, 0.5, &usual.map(|of| 1.5 * of)));
        let hot = worked.multipliers(&by_work, 0.0);
        for j in 0..6 {
            assert!(cold[j] > 1.5 && hot[j] < 1.0, "joint {}: {} {}", j + 1, cold[j], hot[j]);
        }
    }
}
