//! Delays of channels of a recording.

/// Delay of a channel's values relative to the positions of the same row, s, `[n]`; empty for no delay.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelDelays {
    /// Delays of torques.
    pub torque: Vec<f64>,
    /// Delays of velocities.
    pub velocity: Vec<f64>,
}

impl ChannelDelays {
    /// True if no channel is delayed.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.torque.iter().chain(&self.velocity).all(|delay| *delay == 0.0)
    }
}
