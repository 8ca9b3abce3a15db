//! Thermal state of gearboxes from the history of their motion.
//!
//! The state is a thermal deficit `x` of a slow and of a fast part of the gearbox. A deficit is 1 if the part is at
//! ambient temperature, and 0 at its temperature in steady motion in the standard test. Each part follows
//!
//! `T dx/dt = (1 - u) - x`
//!
//! with the activity `u`, 0 at rest and 1 in the standard test. `T` is the part's time constant: `heating` in motion,
//! `cooling_ratio heating` at rest. The state continues through the rest between two runs, so that it predicts the
//! deficit at a warm start.

use armwatch_model::analysis::friction::ThermalLaw;

/// Stretch of motion. The robot is at rest outside all stretches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionSpan {
    /// Start, s.
    pub start: f64,
    /// End, s.
    pub end: f64,
    /// Heat of the motion, as a multiple of that of the standard test; 0 or more.
    pub activity: f64,
}

/// Time constants of a [`ThermalLaw`] without their errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rates {
    /// Time constants in motion, slow and fast, s.
    pub heating: [f64; 2],
    /// Time constants at rest as a multiple of those in motion.
    pub cooling_ratio: f64,
}

impl Rates {
    /// Time constants of a law.
    #[must_use]
    pub fn of(law: &ThermalLaw) -> Self {
        Self { heating: [law.slow_s.value, law.fast_s.value], cooling_ratio: law.cooling_ratio.value }
    }
}

/// Thermal deficit of the slow and of the fast part; 1 is at ambient temperature.
pub type ThermalDeficit = [f64; 2];

/// Thermal deficit of a joint that has rested for a long time.
pub const COLD: ThermalDeficit = [1.0, 1.0];

/// Thermal deficit after `seconds` of the activity `u`: `x = (1 - u) + (from - (1 - u)) exp(-seconds / T)`.
#[must_use]
pub fn after(rates: &Rates, from: ThermalDeficit, seconds: f64, u: f64) -> ThermalDeficit {
    let target = 1.0 - u;
    let ratio = if u > 0.0 { 1.0 } else { rates.cooling_ratio };
    std::array::from_fn(|part| {
        target + (from[part] - target) * (-seconds / (ratio * rates.heating[part])).exp()
    })
}

/// Thermal deficit at each of `times`, s.
///
/// `spans` and `times` must be in ascending order, and spans must not overlap. The joint is cold before the first span.
#[must_use]
pub fn thermal_deficits(rates: &Rates, spans: &[MotionSpan], times: &[f64]) -> Vec<ThermalDeficit> {
    let (mut state, mut now) = (COLD, f64::NEG_INFINITY);
    let mut ahead = spans.iter().copied().peekable();
    let advance = |state: &mut ThermalDeficit, now: &mut f64, to: f64, u: f64| {
        if to > *now {
            // the stretch before the first span or time has no beginning; the joint is cold at its end
            if now.is_finite() {
                *state = after(rates, *state, to - *now, u);
            }
            *now = to;
        }
    };
    let mut found = Vec::with_capacity(times.len());
    for &time in times {
        while let Some(span) = ahead.peek().copied().filter(|span| span.end <= time) {
            advance(&mut state, &mut now, span.start, 0.0);
            advance(&mut state, &mut now, span.end, span.activity);
            ahead.next();
        }
        match ahead.peek().filter(|span| span.start < time) {
            Some(span) => {
                advance(&mut state, &mut now, span.start, 0.0);
                advance(&mut state, &mut now, time, span.activity);
            }
            None => advance(&mut state, &mut now, time, 0.0),
        }
        found.push(state);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATES: Rates = Rates { heating: [2000.0, 200.0], cooling_ratio: 2.0 };
    /// Tolerance for states between 0 and 1, after a dozen exponentials.
    const TOLERANCE: f64 = 1e-12;

    fn span(start: f64, end: f64) -> MotionSpan {
        MotionSpan { start, end, activity: 1.0 }
    }

    #[test]
    fn a_cold_start_in_steady_motion_is_the_double_exponential_of_the_thesis() {
        let times = [0.0, 500.0, 3000.0];
        for (time, x) in times.iter().zip(thermal_deficits(&RATES, &[span(0.0, 7200.0)], &times)) {
            assert!((x[0] - (-time / 2000.0).exp()).abs() < TOLERANCE, "{time} {x:?}");
            assert!((x[1] - (-time / 200.0).exp()).abs() < TOLERANCE, "{time} {x:?}");
        }
    }

    #[test]
    fn the_state_is_carried_through_rest_and_the_way_of_asking_changes_nothing() {
        let spans = [span(0.0, 3600.0), span(6300.0, 9900.0)];
        let end = thermal_deficits(&RATES, &spans, &[3600.0])[0];
        let start = thermal_deficits(&RATES, &spans, &[6300.0])[0];
        for part in 0..2 {
            let cooled = 1.0 - (1.0 - end[part]) * (-2700.0 / (2.0 * RATES.heating[part])).exp();
            assert!((start[part] - cooled).abs() < TOLERANCE);
        }
        let often: Vec<f64> = (0..200).map(|k| 50.0 * f64::from(k)).collect();
        let (sparse, dense) =
            (thermal_deficits(&RATES, &spans, &[9950.0]), thermal_deficits(&RATES, &spans, &often));
        let last = thermal_deficits(&RATES, &spans, &[9950.0, 9950.0]);
        assert_eq!(sparse[0], last[1]);
        assert!((dense[199][0] - sparse[0][0]).abs() < TOLERANCE, "{:?} {sparse:?}", dense[199]);
    }

    #[test]
    fn a_long_rest_is_a_cold_start_and_half_the_activity_ends_half_warm() {
        let spans = [span(0.0, 7200.0), MotionSpan { activity: 0.5, ..span(1e6, 2e6) }];
        let found = thermal_deficits(&RATES, &spans, &[1e6, 2e6]);
        assert!((found[0][0] - 1.0).abs() < TOLERANCE && (found[1][0] - 0.5).abs() < TOLERANCE, "{found:?}");
    }
}
