//! `[retention]`: how long factors of single cycles are kept.

use super::toml::range::Limits;
use super::toml::table::{Table, Value};

/// Replaces the number of days for "for ever".
const FOR_EVER: &str = "forever";

/// Four months: some 0.6 GB of a six-joint arm that is tested daily.
const DEFAULT_TESTS_DAYS: f64 = 120.0;

/// A week: a test that arrives late, or is corrected, comes within days. Some 0.5 GB for an arm that is watched around
/// the clock.
const DEFAULT_PRODUCTION_DAYS: f64 = 7.0;

/// Retention time of factors of single cycles, days; `None` for ever. Results are always kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetentionSettings {
    /// Retention time of tests' factors, which are then removed.
    pub tests_days: Option<f64>,
    /// Retention time of production's factors, which are then joined to one factor per log.
    pub production_days: Option<f64>,
}

impl Default for RetentionSettings {
    fn default() -> Self {
        Self { tests_days: Some(DEFAULT_TESTS_DAYS), production_days: Some(DEFAULT_PRODUCTION_DAYS) }
    }
}

/// Reads `[retention]`; `None` after a problem.
pub(super) fn read_retention(table: Option<&Table<'_>>) -> Option<RetentionSettings> {
    let default = RetentionSettings::default();
    let Some(table) = table else { return Some(default) };
    let days = |key, default| match table.optional(key) {
        Some(value) => read_days(&value),
        None => Some(default),
    };
    let tests_days = days("factors_of_tests_days", default.tests_days);
    let production_days = days("factors_of_production_days", default.production_days);
    Some(RetentionSettings { tests_days: tests_days?, production_days: production_days? })
}

/// Days, or for ever.
fn read_days(value: &Value<'_>) -> Option<Option<f64>> {
    match value.peek_text() {
        Some(FOR_EVER) => Some(None),
        Some(_) => {
            let hint = format!("write a number of days, or \"{FOR_EVER}\"");
            value.refuse("is not a number of days".into(), Some(hint));
            None
        }
        None => value.number(&Limits::between(0.0, 36_500.0, "days")).map(Some),
    }
}
