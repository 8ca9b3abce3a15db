//! Torques of motors that turn with two joints.

use armwatch_model::robot::{Coupling, FrictionLaw};

/// Columns of the parameters `Iam`, `fvm`, `fsm` of a coupled motor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CouplingColumns {
    /// Columns in the torque of the other joint.
    pub joint: [f64; 3],
    /// Columns in the torque of the motor's own joint.
    pub motor_joint: [f64; 3],
}

/// Columns of a motor `m` that also turns with the joint `j`. Its speed is proportional to `s = c qd_j + qd_m`, where
/// `c` is [`Coupling::ratio`].
///
/// `tau_j = c (Iam qdd_m + fvm qd_m + fsm sign(s))`, `tau_m = c (Iam qdd_j + fvm qd_j) + fsm sign(s)`.
/// Inertia and viscous friction due to a joint's own motion are part of this joint's motor inertia and viscous
/// friction.
///
/// `qd`, `qdd` `[n]` in rad/s, rad/s². Reference, for `c = 1`: Gautier, Janot, Vandanjon (2011), DIDIM identification
/// of the Stäubli TX40, whose axis 6 is coupled to axis 5.
#[inline]
#[must_use]
pub fn coupling_columns(coupling: &Coupling, law: FrictionLaw, qd: &[f64], qdd: &[f64]) -> CouplingColumns {
    let (j, m, c) = (coupling.joint.index(), coupling.motor_joint.index(), coupling.ratio);
    let sign = law.sign(c * qd[j] + qd[m]);
    CouplingColumns { joint: [c * qdd[m], c * qd[m], c * sign], motor_joint: [c * qdd[j], c * qd[j], sign] }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use armwatch_model::robot::JointIndex;

    proptest! {
        #[test]
        fn a_coupled_motor_loses_what_its_own_speed_says(
            ratio in -2.0..2.0_f64, qd in proptest::array::uniform2(-5.0..5.0_f64), fs in 0.0..3.0_f64, fv in 0.0..3.0_f64,
        ) {
            // A motor at speed s = c qd_0 + qd_1 loses (fs sign(s) + fv s) s, and its inertia takes s sd.
            let coupling =
                Coupling { joint: JointIndex::new(0), motor_joint: JointIndex::new(1), ratio };
            let qdd = [1.5, -0.7];
            let (s, sd) = (ratio * qd[0] + qd[1], ratio * qdd[0] + qdd[1]);
            let columns = coupling_columns(&coupling, FrictionLaw::ViscousCoulomb, &qd, &qdd);
            let own = [ratio * ratio * qd[0], qd[1]];
            let own_inertia = [ratio * ratio * qdd[0], qdd[1]];
            let power = |k: usize| columns.joint[k] * qd[0] + columns.motor_joint[k] * qd[1];
            let coulomb = fs * power(2);
            let viscous = fv * (power(1) + own[0] * qd[0] + own[1] * qd[1]);
            let inertia = power(0) + own_inertia[0] * qd[0] + own_inertia[1] * qd[1];
            prop_assert!((coulomb - fs * s.abs()).abs() < 1e-12);
            prop_assert!((viscous - fv * s * s).abs() < 1e-12 * (1.0 + 600.0));
            prop_assert!((inertia - s * sd).abs() < 1e-12 * (1.0 + 100.0));
        }
    }
}
