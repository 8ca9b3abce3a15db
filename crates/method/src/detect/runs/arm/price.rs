//! Prices of causes, in units of chi², and what patterns may miss.

/// Advantage of a cause over none, in logarithms, beyond what the rate of false alarms asks for: a baseline of a few runs
/// knows the deviations of the parameters to a fifth, and nothing of a season.
pub(super) const ARM_MARGIN: f64 = 17.0;
/// Part of a change that a pattern may miss: patterns are models.
pub(super) const PATTERN_ERROR: f64 = 0.05;
/// Price of one parameter.
pub(super) const PARAMETER_PRICE: f64 = 4.0;
/// Further price of a torque signal that shows in parameters alone: a load does that too.
pub(super) const SILENT_SIGNAL_PRICE: f64 = 60.0;
/// Further price of a channel whose fault is known but for its size.
pub(super) const CHANNEL_PRICE: f64 = 20.0;
/// Further price of a fault of the mechanics: it says nothing of the parameters, where a channel that reads wrong says how
/// they change.
pub(super) const MECHANICAL_PRICE: f64 = 60.0;
/// Further price of an offset of a torque that comes with a load: two faults at once are rare.
pub(super) const SECOND_FAULT_PRICE: f64 = 60.0;
/// Price of a cause that is not known: it explains anything of the parameters.
pub(super) const UNKNOWN_PRICE: f64 = 150.0;
/// Most that a cause that is not known pays for offsets of torques beside it.
pub(super) const MOST_FOR_OFFSETS: f64 = 300.0;
