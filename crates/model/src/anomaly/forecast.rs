//! When a joint's friction is expected to reach its limits.

use jiff::civil::Date;
use serde::Serialize;

/// Where friction of a joint is going, from its tests until the latest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Forecast {
    /// Whether it goes anywhere.
    pub trend: Trend,
    /// When it is expected to reach the limit of a warning; `None` without a trend, where the limit is passed, and
    /// where it is not expected within the horizon.
    #[serde(rename = "warning")]
    pub warning_at: Option<Crossing>,
    /// The same for the critical limit.
    #[serde(rename = "critical")]
    pub critical_at: Option<Crossing>,
}

/// Whether friction changes from test to test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Trend {
    /// No trend that could be told from chance, or none that reaches a limit within the horizon.
    #[default]
    None,
    /// Friction rises.
    Rising,
    /// Friction falls.
    Falling,
}

crate::serialize_by_name!(Trend);

impl Trend {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::None, Self::Rising, Self::Falling];

    /// Name as in the view `fleet_health`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Rising => "rising",
            Self::Falling => "falling",
        }
    }
}

/// When a limit is expected to be reached, UTC.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Crossing {
    /// As likely before this day as after it.
    pub by: Date,
    /// Begin of the interval of 80 %.
    pub lower: Date,
    /// Its end; `None` if it lies beyond the horizon.
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
