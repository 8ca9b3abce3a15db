//! Loss of a strain wave gear's teeth from the power that they transmit.
//!
//! Catalogues give the efficiency of such a gear over load and speed. It decreases towards small loads, since the
//! gear's loss without load ([`super::friction`]) is constant. The efficiency of the teeth alone decreases towards low
//! speed, because the grease no longer separates the tooth flanks. At the motor, the loss of the teeth is
//! `|L| (1/e - 1)` while it drives the load `L` and `|L| (1 - e)` while the load drives it.

/// Loss of the teeth at rest as a multiple of that at speed.
const BOUNDARY_FACTOR: f64 = 1.3;
/// Speed of decay to 1/e of the additional loss, as a fraction of the joint's largest speed.
const BOUNDARY_SPEED: f64 = 0.1;

/// Teeth of a gear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Teeth {
    /// Fraction of the transmitted power that they lose at speed, 0 to below 0.5.
    pub loss: f64,
    /// Largest speed of the joint, rad/s (m/s).
    pub top_speed: f64,
}

impl Teeth {
    /// Efficiency at a speed, rad/s (m/s).
    pub fn efficiency(&self, qd: f64) -> f64 {
        let slow = (-qd.abs() / (BOUNDARY_SPEED * self.top_speed)).exp();
        1.0 - self.loss * (1.0 + (BOUNDARY_FACTOR - 1.0) * slow)
    }

    /// Additional torque of the motor beyond the load `carried`, Nm (N), or reduction of it while the load drives, at
    /// the speed `qd`, rad/s (m/s); against the motion.
    pub fn lost(&self, carried: f64, qd: f64) -> f64 {
        let efficiency = self.efficiency(qd);
        let part = if carried * qd > 0.0 { 1.0 / efficiency - 1.0 } else { 1.0 - efficiency };
        carried.abs() * part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motor_supplies_the_load_over_the_efficiency_and_holds_it_times_the_efficiency() {
        let teeth = Teeth { loss: 0.1, top_speed: 4.0 };
        let efficiency = teeth.efficiency(4.0);
        assert!((efficiency - 0.9).abs() < 1e-5 && (teeth.efficiency(0.0) - 0.87).abs() < 1e-12);
        for (carried, qd) in [(40.0, 4.0), (-40.0, -4.0), (40.0, -4.0), (-40.0, 4.0)] {
            let motor: f64 = carried + teeth.lost(carried, qd) * f64::signum(qd);
            let expected = if carried * qd > 0.0 { carried / efficiency } else { carried * efficiency };
            assert!((motor - expected).abs() < 1e-12, "{carried} {qd}: {motor} {expected}");
        }
        assert_eq!(Teeth { loss: 0.0, top_speed: 4.0 }.lost(40.0, 1.0), 0.0);
    }
}
