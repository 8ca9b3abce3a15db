//! What gearboxes and motors add to the rigid links: friction, and motors that turn with two joints.

use crate::robot::{Coupling, FrictionLaw, FrictionModel};

/// What the friction coefficients of a joint multiply at the speed `qd` (rad/s or m/s), in the order
/// of [`FrictionModel::terms`]; zero beyond them. `sign(0) = 0`.
///
/// - polynomial [3.10]: `sign(qd), qd, qd² sign(qd), qd³`;
/// - viscous and Coulomb: `sign(qd), qd, 1`; smooth: `tanh(qd / speed), qd, 1`;
/// - none: no column;
/// - asymmetric: the sign's positive and its negative part, then those of the speed.
#[inline]
#[must_use]
pub fn friction_columns(model: &FrictionModel, qd: f64) -> [f64; FrictionModel::MAX_TERMS] {
    let sign = smooth_sign(model.law, qd);
    match (model.law, model.asymmetric) {
        (FrictionLaw::None, _) => [0.0; FrictionModel::MAX_TERMS],
        (FrictionLaw::Polynomial, _) => [sign, qd, qd * qd.abs(), qd * qd * qd],
        (_, false) => [sign, qd, 1.0, 0.0],
        (_, true) => [sign.max(0.0), sign.min(0.0), qd.max(0.0), qd.min(0.0)],
    }
}

/// Friction torque, Nm (N), of the coefficients `f` in the order of [`FrictionModel::terms`] at the
/// speed `qd` in rad/s (m/s).
#[inline]
#[must_use]
pub fn friction_torque(model: &FrictionModel, f: &[f64; FrictionModel::MAX_TERMS], qd: f64) -> f64 {
    friction_columns(model, qd).iter().zip(f).map(|(column, f)| f * column).sum()
}

/// What the parameters `Iam`, `fvm`, `fsm` of a coupled motor multiply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CouplingColumns {
    /// In the torque of the other joint.
    pub joint: [f64; 3],
    /// In the torque of the motor's own joint.
    pub motor_joint: [f64; 3],
}

/// Columns of a motor `m` that turns with the joint `j` too: its speed is proportional to
/// `s = c qd_j + qd_m`, where `c` is [`Coupling::ratio`].
///
/// `tau_j = c (Iam qdd_m + fvm qd_m + fsm sign(s))`, `tau_m = c (Iam qdd_j + fvm qd_j) + fsm sign(s)`.
/// Inertia and viscous friction that a joint feels of its own motion are in its own motor inertia and
/// viscous friction.
///
/// `qd`, `qdd` `[n]` in rad/s, rad/s². Reference, for `c = 1`: Gautier, Janot, Vandanjon (2011),
/// DIDIM identification of the Stäubli TX40, whose axis 6 is coupled to axis 5.
#[inline]
#[must_use]
pub fn coupling_columns(coupling: &Coupling, law: FrictionLaw, qd: &[f64], qdd: &[f64]) -> CouplingColumns {
    let (j, m, c) = (coupling.joint.index(), coupling.motor_joint.index(), coupling.ratio);
    let sign = smooth_sign(law, c * qd[j] + qd[m]);
    CouplingColumns { joint: [c * qdd[m], c * qd[m], c * sign], motor_joint: [c * qdd[j], c * qd[j], sign] }
}

#[inline]
fn smooth_sign(law: FrictionLaw, speed: f64) -> f64 {
    match law {
        FrictionLaw::Smooth { speed: scale } => (speed / scale).tanh(),
        _ if speed == 0.0 => 0.0,
        _ => speed.signum(),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::robot::JointIndex;

    /// A few operations.
    const ROUNDING: f64 = 1e-14;

    fn model(law: FrictionLaw, asymmetric: bool) -> FrictionModel {
        FrictionModel { law, asymmetric }
    }

    #[test]
    fn friction_is_odd_and_a_resting_joint_has_none() {
        let f = [1.5, 8.0, -1.2, 0.3];
        let torque = |qd| friction_torque(&FrictionModel::POLYNOMIAL, &f, qd);
        assert_eq!((torque(0.0), torque(-0.0)), (0.0, 0.0));
        let expected = 1.5 + 8.0 * 2.0 - 1.2 * 4.0 + 0.3 * 8.0;
        assert!((torque(2.0) - expected).abs() < ROUNDING * expected);
        assert!((torque(-2.0) + expected).abs() < ROUNDING * expected);
    }

    #[test]
    fn viscous_and_coulomb_friction_has_an_offset_in_both_directions() {
        let f = [1.5, 8.0, 0.25, 99.0];
        for (law, sign) in
            [(FrictionLaw::ViscousCoulomb, 1.0), (FrictionLaw::Smooth { speed: 0.5 }, 4.0_f64.tanh())]
        {
            let torque = |qd| friction_torque(&model(law, false), &f, qd);
            assert!((torque(2.0) - (1.5 * sign + 16.25)).abs() < ROUNDING * 20.0);
            assert!((torque(-2.0) + (1.5 * sign + 15.75)).abs() < ROUNDING * 20.0);
            assert_eq!(torque(0.0), 0.25);
        }
    }

    #[test]
    fn asymmetric_friction_of_equal_directions_is_symmetric_and_an_offset_is_half_the_difference() {
        let symmetric = |law, qd| friction_torque(&model(law, false), &[1.5, 8.0, 0.0, 0.0], qd);
        let coulomb = FrictionLaw::ViscousCoulomb;
        for qd in [-2.0, -0.1, 0.0, 0.3, 4.0] {
            for law in [coulomb, FrictionLaw::Smooth { speed: 0.2 }] {
                let both = friction_torque(&model(law, true), &[1.5, 1.5, 8.0, 8.0], qd);
                assert!((both - symmetric(law, qd)).abs() < ROUNDING * 40.0);
            }
            if qd != 0.0 {
                let skewed = friction_torque(&model(coulomb, true), &[1.75, 1.25, 8.0, 8.0], qd);
                assert!((skewed - symmetric(coulomb, qd) - 0.25).abs() < ROUNDING * 40.0);
            }
        }
    }

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
