//! Which temperatures are recorded, and how their sensors measure.

use armwatch_model::run::temperature::ZERO_CELSIUS;

/// The usual hall, K.
pub const USUAL_AMBIENT: f64 = ZERO_CELSIUS + 22.0;

/// Which temperatures are recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TemperatureColumns {
    /// Of each joint's motor.
    pub motor: bool,
    /// Of the hall.
    pub ambient: bool,
}

impl TemperatureColumns {
    /// Number of columns for `joint_count` joints.
    #[must_use]
    pub fn count(self, joint_count: usize) -> usize {
        if self.motor { joint_count + usize::from(self.ambient) } else { usize::from(self.ambient) }
    }
}

/// What a controller records of temperatures, and how.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureSettings {
    /// Which.
    pub columns: TemperatureColumns,
    /// Step of the values, K: drives round to 0.1 or 1.
    pub step_k: f64,
    /// Standard deviation of a reading before it is rounded, K.
    pub noise_k: f64,
    /// Time constant between motor and housing, s: how far the sensor is behind the gear.
    pub lag_s: f64,
}

impl Default for TemperatureSettings {
    /// Nothing recorded; sensors to 0.1 K with as much noise, ten minutes behind the housing.
    fn default() -> Self {
        Self { columns: TemperatureColumns::default(), step_k: 0.1, noise_k: 0.1, lag_s: 600.0 }
    }
}
