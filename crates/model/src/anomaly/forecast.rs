//! Forecasts of a joint's friction reaching its limits.

use jiff::civil::Date;
use serde::Serialize;

/// Forecast of a joint's friction, from its tests until the latest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Forecast {
    /// Trend of friction.
    pub trend: Trend,
    /// Forecast of reaching the limit of a warning; `None` without a trend, if the limit is already exceeded, and if it
    /// is not expected within the horizon.
    #[serde(rename = "warning")]
    pub warning_at: Option<Crossing>,
    /// The same for the critical limit.
    #[serde(rename = "critical")]
    pub critical_at: Option<Crossing>,
}

crate::named_enum! {
    /// Trend of friction from test to test.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Trend {
        /// No significant trend, or none that reaches a limit within the horizon.
        #[default]
        None = "none",
        /// Friction rises.
        Rising = "rising",
        /// Friction falls.
        Falling = "falling",
    }
}

crate::serialize_by_name!(Trend);

/// Expected day of reaching a limit, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Crossing {
    /// Day before and after which reaching it is equally likely.
    pub by: Date,
    /// Start of the 80 % interval.
    pub lower: Date,
    /// End of the interval; `None` if it is beyond the horizon.
    pub upper: Option<Date>,
}

impl Crossing {
    /// `2026-05-03 (80 %: 2026-04-11 to 2026-06-20)`.
    #[must_use]
    pub fn words(&self) -> String {
        match self.upper {
            Some(upper) => format!("{} (80 %: {} to {upper})", self.by, self.lower),
            None => format!("{} (80 %: not before {})", self.by, self.lower),
        }
    }
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;

    use super::*;

    #[test]
    fn an_interval_without_end_says_so() {
        let mut crossing =
            Crossing { by: date(2026, 5, 3), lower: date(2026, 4, 11), upper: Some(date(2026, 6, 20)) };
        assert_eq!(crossing.words(), "2026-05-03 (80 %: 2026-04-11 to 2026-06-20)");
        crossing.upper = None;
        assert_eq!(crossing.words(), "2026-05-03 (80 %: not before 2026-04-11)");
    }
}
