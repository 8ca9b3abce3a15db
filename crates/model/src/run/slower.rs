//! Channels that have a value in only some rows of a recording.

/// The value of a slower channel in a row that has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slower {
    /// The value of the last row with one.
    Hold,
    /// A value on the straight line between the nearest rows with one.
    Resample,
}

/// Channels that may have rows without a value; `None` for those with a value in each row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SlowerChannels {
    /// Torques.
    pub torque: Option<Slower>,
    /// Velocities.
    pub velocity: Option<Slower>,
}
