//! The recorded temperatures, and the properties of their sensors.

use armwatch_model::run::temperature::ZERO_CELSIUS;

/// The usual ambient temperature, K.
pub const USUAL_AMBIENT: f64 = ZERO_CELSIUS + 22.0;

/// The recorded temperatures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TemperatureColumns {
    /// True for the motor temperature of each joint.
    pub motor: bool,
    /// True for the ambient temperature.
    pub ambient: bool,
}

impl TemperatureColumns {
    /// Number of columns for `joint_count` joints.
    pub fn count(self, joint_count: usize) -> usize {
        if self.motor { joint_count + usize::from(self.ambient) } else { usize::from(self.ambient) }
    }
}

/// The recorded temperatures and the properties of their sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureSettings {
    /// The recorded temperatures.
    pub columns: TemperatureColumns,
    /// Step of the values, K: drives round to 0.1 or 1.
    pub step_k: f64,
    /// Standard deviation of a reading before it is rounded, K.
    pub noise_k: f64,
    /// Time constant between motor and housing, s: the delay of the sensor behind the gear.
    pub lag_s: f64,
}

impl Default for TemperatureSettings {
    /// Nothing recorded; sensors with a resolution of 0.1 K and as much noise, ten minutes behind the housing.
    fn default() -> Self {
        Self { columns: TemperatureColumns::default(), step_k: 0.1, noise_k: 0.1, lag_s: 600.0 }
    }
}
