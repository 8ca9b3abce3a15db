//! Prices of causes, in units of chi², and tolerances of patterns.

/// Advantage of a cause over none, in logarithms, in addition to the part for the rate of false alarms. A baseline of a
/// few runs gives the deviations of the parameters to a fifth, and does not contain the seasons.
pub(super) const ARM_MARGIN: f64 = 17.0;
/// Part of a change that may differ from a pattern: patterns are models.
pub(super) const PATTERN_ERROR: f64 = 0.05;
/// Price of one parameter.
pub(super) const PARAMETER_PRICE: f64 = 4.0;
/// Additional price of a torque signal that shows only in parameters: a load does that too.
pub(super) const SILENT_SIGNAL_PRICE: f64 = 60.0;
/// Additional price of a channel whose fault is known except for its size.
pub(super) const CHANNEL_PRICE: f64 = 20.0;
/// Additional price of a mechanical fault: it predicts no change of the parameters, in contrast to a wrong channel.
pub(super) const MECHANICAL_PRICE: f64 = 60.0;
/// Additional price of a torque offset together with a load: two faults at once are rare.
pub(super) const SECOND_FAULT_PRICE: f64 = 60.0;
/// Price of an unknown cause: it explains any change of the parameters.
pub(super) const UNKNOWN_PRICE: f64 = 150.0;
/// Upper limit of the price of torque offsets in addition to an unknown cause.
pub(super) const MOST_FOR_OFFSETS: f64 = 300.0;
