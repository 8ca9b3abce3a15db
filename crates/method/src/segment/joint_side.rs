//! Conversion from motors to joints: `theta = R q`, and by virtual power `tau = R' tau_m`.

use nalgebra::DMatrix;

use crate::NumericsError;
use armwatch_model::robot::Robot;
use armwatch_model::robot::transmission::joint_per_motor;
use armwatch_model::run::Rows;

/// Error for a transmission without an inverse.
const NO_INVERSE: NumericsError =
    NumericsError::NotFinite("the inverse of the transmission, in which motors repeat each other,");

/// Conversion of a recording's channels to those of the joints: motor-side channels through the transmission, then the
/// position offsets. Created once per recording.
#[derive(Debug, Clone, PartialEq)]
pub struct JointSide {
    /// Matrix from motor to joint positions and velocities, if the motors' are recorded.
    motion: Option<DMatrix<f64>>,
    /// Matrix from motor to joint torques, if the motors' are recorded.
    torque: Option<DMatrix<f64>>,
    offsets: Vec<f64>,
}

impl JointSide {
    /// Creates the conversion for a recording of `robot` whose positions and velocities, or torques, are the motors'.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if the transmission has no inverse.
    pub fn new(robot: &Robot, motor_position: bool, motor_torque: bool) -> Result<Self, NumericsError> {
        let motion = match motor_position {
            true => Some(joint_per_motor(&robot.transmission).ok_or(NO_INVERSE)?),
            false => None,
        };
        Ok(Self {
            motion,
            torque: motor_torque.then(|| robot.transmission.transpose()),
            offsets: robot.joints.iter().map(|joint| joint.position_offset).collect(),
        })
    }

    /// Converts the channels of `samples`, `[n][rows]`, in place.
    pub fn apply<S>(&self, samples: &mut Rows<S>) {
        if let Some(map) = &self.motion {
            samples.position = mapped(map, &samples.position);
            samples.velocity = samples.velocity.as_ref().map(|velocity| mapped(map, velocity));
        }
        if let Some(map) = &self.torque {
            samples.torque = mapped(map, &samples.torque);
        }
        for (position, offset) in samples.position.iter_mut().zip(&self.offsets).filter(|(_, o)| **o != 0.0) {
            position.iter_mut().for_each(|q| *q += offset);
        }
    }
}

/// Each row of `channels` `[n][rows]` times `map` `[n x n]`; most entries are zero.
fn mapped(map: &DMatrix<f64>, channels: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let rows = channels.first().map_or(0, Vec::len);
    map.row_iter()
        .map(|weights| {
            let mut sum = vec![0.0; rows];
            for (weight, channel) in weights.iter().zip(channels).filter(|(weight, _)| **weight != 0.0) {
                sum.iter_mut().zip(channel).for_each(|(sum, value)| *sum += weight * value);
            }
            sum
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::DVector;
    use proptest::prelude::*;

    use super::*;
    use armwatch_model::run::Samples;

    /// Joint positions `q` `[n]` in rad from the motor positions `theta` `[n]` in rad: solves `theta = R q`. The same
    /// for velocities and accelerations, since `R` is constant.
    ///
    /// For many rows, invert once with [`joint_per_motor`].
    ///
    /// # Errors
    /// [`NumericsError::TooShort`] if `theta` does not have one value per motor, [`NumericsError::NotFinite`] if `R` is
    /// singular.
    fn joint_position_from_motor(r: &DMatrix<f64>, theta: &[f64]) -> Result<Vec<f64>, NumericsError> {
        check_length("the motor positions", r.nrows(), theta)?;
        let q = joint_per_motor(r).ok_or(NO_INVERSE)? * DVector::from_column_slice(theta);
        Ok(q.as_slice().to_vec())
    }

    /// Joint torques `tau = R' tau_m` `[n]` in Nm from the motor torques `tau_m` `[n]` in Nm: the work at the motor
    /// shafts equals that at the joints.
    ///
    /// # Errors
    /// [`NumericsError::TooShort`] if `tau_m` does not have one value per motor.
    fn joint_torque_from_motor(r: &DMatrix<f64>, tau_m: &[f64]) -> Result<Vec<f64>, NumericsError> {
        check_length("the motor torques", r.nrows(), tau_m)?;
        Ok((0..r.ncols()).map(|j| r.column(j).iter().zip(tau_m).map(|(r, tau)| r * tau).sum()).collect())
    }

    fn check_length(what: &'static str, needed: usize, values: &[f64]) -> Result<(), NumericsError> {
        match values.len() == needed {
            true => Ok(()),
            false => Err(NumericsError::TooShort { what, rows: values.len(), needed }),
        }
    }

    /// Rounding of six-by-six products of numbers that differ by at most a factor of a hundred.
    const ROUNDING: f64 = 1e-12;

    fn wrist() -> DMatrix<f64> {
        let mut r =
            DMatrix::from_diagonal(&DVector::from_column_slice(&[32.0, 32.0, 45.0, -48.0, 45.0, 32.0]));
        r[(5, 4)] = 32.0;
        r
    }

    proptest! {
        #[test]
        fn power_and_positions_are_conserved(
            couplings in proptest::collection::vec(-20.0..20.0_f64, 36),
            qd in proptest::collection::vec(-5.0..5.0_f64, 6),
            tau_m in proptest::collection::vec(-3.0..3.0_f64, 6),
        ) {
            // every motor may turn with every joint; the gear ratios dominate
            let r = wrist() * 4.0 + DMatrix::from_column_slice(6, 6, &couplings) * 0.5;
            let theta_d = &r * DVector::from_column_slice(&qd);
            let back = joint_position_from_motor(&r, theta_d.as_slice())
                .map_err(|e| TestCaseError::fail(e.to_string()))?;
            for (back, qd) in back.iter().zip(&qd) {
                prop_assert!((back - qd).abs() < ROUNDING * 100.0);
            }
            let tau = joint_torque_from_motor(&r, &tau_m).map_err(|e| TestCaseError::fail(e.to_string()))?;
            let at_joints: f64 = tau.iter().zip(&qd).map(|(tau, qd)| tau * qd).sum();
            let at_motors: f64 = tau_m.iter().zip(theta_d.iter()).map(|(tau, qd)| tau * qd).sum();
            let size: f64 = tau_m.iter().zip(theta_d.iter()).map(|(tau, qd)| (tau * qd).abs()).sum();
            prop_assert!((at_joints - at_motors).abs() < ROUNDING * (1.0 + size));
        }
    }

    #[test]
    fn the_motor_of_axis_6_turns_with_axis_5() {
        let tau = joint_torque_from_motor(&wrist(), &[0.0, 0.0, 0.0, 0.0, 2.0, 3.0]).expect("torques");
        assert_eq!(tau, [0.0, 0.0, 0.0, 0.0, 45.0 * 2.0 + 32.0 * 3.0, 96.0]);
        let q = joint_position_from_motor(&wrist(), &[0.0, 0.0, 0.0, 0.0, 90.0, 0.0]).expect("positions");
        assert!((q[4] - 2.0).abs() < ROUNDING && (q[5] + 2.0).abs() < ROUNDING, "{q:?}");
    }

    #[test]
    fn motors_that_repeat_each_other_are_refused() {
        let mut r = wrist();
        let fifth = r.row(4).into_owned();
        r.set_row(5, &(fifth * 2.0));
        assert!(joint_position_from_motor(&r, &[0.0; 6]).is_err());
        assert!(joint_position_from_motor(&wrist(), &[0.0; 5]).is_err());
        assert!(joint_torque_from_motor(&wrist(), &[0.0; 7]).is_err());
        assert!(joint_per_motor(&DMatrix::zeros(3, 3)).is_none());
        assert!(joint_per_motor(&DMatrix::zeros(3, 2)).is_none());
    }

    #[test]
    fn a_motor_side_recording_becomes_the_joints_row_by_row() {
        let mut robot = armwatch_testing::er3a();
        robot.transmission = wrist();
        robot.joints[1].position_offset = -0.5;
        let value = |joint: usize, row: usize| (1 + joint * 7 + row) as f64;
        let channels: Vec<Vec<f64>> = (0..6).map(|j| (0..4).map(|row| value(j, row)).collect()).collect();
        let mut samples = Samples {
            time: vec![0.0, 0.1, 0.2, 0.3],
            position: channels.clone(),
            velocity: Some(channels.clone()),
            torque: channels.clone(),
            ..Samples::default()
        };
        JointSide::new(&robot, true, true).expect("invertible").apply(&mut samples);
        let velocity = samples.velocity.as_ref().expect("kept");
        let row_of =
            |channels: &[Vec<f64>], row: usize| channels.iter().map(|c| c[row]).collect::<Vec<f64>>();
        for row in 0..4 {
            let motor = row_of(&channels, row);
            let q = joint_position_from_motor(&robot.transmission, &motor).expect("solves");
            let tau = joint_torque_from_motor(&robot.transmission, &motor).expect("fits");
            for j in 0..6 {
                let offset = if j == 1 { -0.5 } else { 0.0 };
                assert!((samples.position[j][row] - q[j] - offset).abs() < ROUNDING);
                assert!((row_of(velocity, row)[j] - q[j]).abs() < ROUNDING);
                assert!((samples.torque[j][row] - tau[j]).abs() < ROUNDING * tau[j].abs());
            }
        }
    }
}
