//! Delays of channels of a recording.

/// How much later than the positions of the same row a channel's values were true, s, `[n]`; empty for no delay.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelDelays {
    /// Of torques.
    pub torque: Vec<f64>,
    /// Of velocities.
    pub velocity: Vec<f64>,
}

impl ChannelDelays {
    /// Whether no channel is late.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.torque.iter().chain(&self.velocity).all(|delay| *delay == 0.0)
    }
}
