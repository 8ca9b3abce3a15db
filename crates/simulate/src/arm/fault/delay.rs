//! A delayed signal.

use std::collections::VecDeque;

/// The latest values of a signal.
#[derive(Debug, Clone, Default)]
pub(super) struct LateSignal {
    /// Times, s, and values, the oldest first; the first is at or before the requested time, if there is one.
    values: VecDeque<(f64, f64)>,
}

impl LateSignal {
    /// Takes the value at `time`, s, which increases, and returns that of `delay` s before: interpolated between two
    /// values, or the first value if there are no earlier ones.
    pub(super) fn push(&mut self, time: f64, value: f64, delay: f64) -> f64 {
        self.values.push_back((time, value));
        let wanted = time - delay;
        while self.values.get(1).is_some_and(|(time, _)| *time <= wanted) {
            self.values.pop_front();
        }
        match (self.values.front(), self.values.get(1)) {
            (Some(&(t0, v0)), Some(&(t1, v1))) if t1 > t0 => {
                v0 + (v1 - v0) * ((wanted - t0) / (t1 - t0)).clamp(0.0, 1.0)
            }
            (Some(&(_, value)), _) => value,
            (None, _) => value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_comes_late_and_begins_with_its_first_value() {
        let mut late = LateSignal::default();
        let rows = (0..100).map(|k| 0.01 * f64::from(k));
        for (place, found) in rows.clone().map(|t| late.push(t, 3.0 * t, 0.025)).enumerate() {
            let expected = (3.0 * (0.01 * place as f64 - 0.025)).max(0.0);
            assert!((found - expected).abs() < 1e-12, "{place}: {found} {expected}");
        }
        let mut in_time = LateSignal::default();
        assert!(rows.map(|t| in_time.push(t, t, 0.0) - t).all(|error| error.abs() < 1e-15));
    }
}
