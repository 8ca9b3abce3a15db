//! Permitted ranges of numbers, with unit.

use std::fmt;

/// A range of valid numbers. Its text completes "must be ...".
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Limits {
    min: f64,
    max: f64,
    min_excluded: bool,
    unit: &'static str,
}

impl Limits {
    /// From `min` to `max`, both permitted.
    pub const fn between(min: f64, max: f64, unit: &'static str) -> Self {
        Self { min, max, min_excluded: false, unit }
    }

    /// Above `min`, which is itself invalid, up to `max`.
    pub const fn above(min: f64, max: f64, unit: &'static str) -> Self {
        Self { min, max, min_excluded: true, unit }
    }

    /// From `-max` to `max`.
    pub const fn within(max: f64, unit: &'static str) -> Self {
        Self::between(-max, max, unit)
    }

    /// Returns true if `value` is a finite number in the range.
    pub fn admit(&self, value: f64) -> bool {
        let above_min = if self.min_excluded { value > self.min } else { value >= self.min };
        above_min && value <= self.max && value.is_finite()
    }
}

impl fmt::Display for Limits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.min_excluded {
            true => write!(f, "above {} and at most {}", self.min, self.max)?,
            false => write!(f, "between {} and {}", self.min, self.max)?,
        }
        if self.unit.is_empty() { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_excluded_bound_is_excluded_in_text_and_deed() {
        let limits = Limits::above(0.0, 3600.0, "s");
        assert!(!limits.admit(0.0) && limits.admit(1e-9) && limits.admit(3600.0) && !limits.admit(3600.1));
        assert_eq!(limits.to_string(), "above 0 and at most 3600 s");
    }

    #[test]
    fn what_is_not_finite_is_in_no_range() {
        let limits = Limits::within(f64::MAX, "");
        assert!(!limits.admit(f64::NAN) && !limits.admit(f64::INFINITY) && limits.admit(f64::MAX));
        assert_eq!(Limits::between(0.0, 1.0, "").to_string(), "between 0 and 1");
    }
}
