//! Channels that have a value in some rows of a recording only.

/// The value of a slower channel in a row that has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Slower {
    /// That of the last row with one.
    Hold,
    /// On the straight line between the rows with one around it.
    Resample,
}

/// Which channels may have rows without a value; `None` for those that have one in each row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SlowerChannels {
    /// Torques.
    pub torque: Option<Slower>,
    /// Velocities.
    pub velocity: Option<Slower>,
}
