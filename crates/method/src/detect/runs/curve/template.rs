//! The usual curve of a joint: a constant, two decays and their mean residual, from the runs of its baseline.
//!
//! `ln tau = a_r + b exp(-t/T_b) + c exp(-t/T_c)` with a constant of each run `r`; the time constants are those of a
//! grid that fit best. The form is that of [5.4]; in logarithms, since wear is a factor. Two decays differ from a real
//! curve by a percent, most in the first cycle. So the mean residual, cycle by cycle, is a part of the curve.

use nalgebra::{DMatrix, DVector};

use super::points::{Curve, CurvePoint};
use crate::statistics::descriptive::mean;

/// Tried time constants, min. Beyond the largest a decay is a straight line within a test.
const FAST_MIN: [f64; 3] = [2.0, 4.0, 8.0];
pub(super) const SLOW_MIN: [f64; 6] = [12.0, 20.0, 30.0, 45.0, 70.0, 110.0];

/// Fewest cycles of a run that is used for a usual curve.
pub(super) const FEWEST_CYCLES: usize = 5;

/// Least accepted scatter of a cycle about the usual curve.
const MIN_SCATTER: f64 = 0.001;

/// The usual curve of a joint.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::detect::runs) struct Template {
    /// Mean constant.
    pub(super) level: f64,
    /// Size and time constant, min, of the decays; sizes of 0 if friction does not fall.
    pub(super) fast: [f64; 2],
    pub(super) slow: [f64; 2],
    /// Minute and mean residual of each cycle, by minute.
    rest: Vec<(f64, f64)>,
    /// Standard deviation of one cycle about it.
    pub(in crate::detect::runs) scatter: f64,
}

impl Template {
    /// The usual curve of these runs; `None` if fewer than two of them have enough cycles.
    pub(in crate::detect::runs) fn of(runs: &[&Curve]) -> Option<Self> {
        let long: Vec<&Curve> = runs.iter().copied().filter(|run| run.len() >= FEWEST_CYCLES).collect();
        if long.len() < 2 {
            return None;
        }
        let flat = Self::flat(&long)?;
        let decays = FAST_MIN.iter().flat_map(|&fast| SLOW_MIN.iter().map(move |&slow| (fast, slow)));
        let best = decays
            .filter_map(|(fast, slow)| Self::falling(&long, fast, slow))
            .reduce(|best, other| if other.scatter < best.scatter { other } else { best });
        let chosen = match best {
            Some(falling) if falling.scatter < flat.scatter => falling,
            _ => flat,
        };
        Some(chosen.with_rest(&long))
    }

    /// Adds the mean residual of each cycle to the curve.
    fn with_rest(mut self, runs: &[&Curve]) -> Self {
        let left: Vec<Vec<(u32, f64, f64)>> = runs
            .iter()
            .map(|run| {
                let of = |point: &CurvePoint| point.ln_torque - self.value(point.minute);
                let level = mean(&run.iter().map(of).collect::<Vec<f64>>()).unwrap_or(0.0);
                run.iter().map(|point| (point.cycle, point.minute, of(point) - level)).collect()
            })
            .collect();
        let mut cycles: Vec<u32> = left.iter().flatten().map(|(cycle, ..)| *cycle).collect();
        cycles.sort_unstable();
        cycles.dedup();
        let mut squares = 0.0;
        let mut freedom = 0.0;
        for cycle in cycles {
            let of: Vec<(f64, f64)> = left
                .iter()
                .flatten()
                .filter(|(own, ..)| *own == cycle)
                .map(|(_, minute, rest)| (*minute, *rest))
                .collect();
            // one run is no average
            if of.len() < 2 {
                continue;
            }
            let count = of.len() as f64;
            let minute = of.iter().map(|(minute, _)| minute).sum::<f64>() / count;
            let rest = of.iter().map(|(_, rest)| rest).sum::<f64>() / count;
            squares += of.iter().map(|(_, own)| (own - rest).powi(2)).sum::<f64>();
            freedom += count - 1.0;
            self.rest.push((minute, rest));
        }
        self.rest.sort_by(|a, b| a.0.total_cmp(&b.0));
        // one level per run except one was fitted, and the mean has its own error
        let (runs, freedom) = (runs.len() as f64, freedom - (runs.len() as f64 - 1.0));
        if freedom > 0.0 {
            self.scatter = (squares / freedom * (1.0 + runs.recip())).sqrt().max(MIN_SCATTER);
        }
        self
    }

    /// Mean residual of the decays at `minute`: linear between two cycles.
    fn rest(&self, minute: f64) -> f64 {
        let after = self.rest.partition_point(|(at, _)| *at < minute);
        match (after.checked_sub(1).and_then(|before| self.rest.get(before)), self.rest.get(after)) {
            (Some((from, a)), Some((to, b))) => a + (b - a) * (minute - from) / (to - from),
            (Some((_, only)), None) | (None, Some((_, only))) => *only,
            (None, None) => 0.0,
        }
    }

    fn flat(runs: &[&Curve]) -> Option<Self> {
        let levels: Vec<f64> = runs.iter().filter_map(|run| mean(&torques(run))).collect();
        let points: usize = runs.iter().map(|run| run.len()).sum();
        let residuals =
            runs.iter().zip(&levels).flat_map(|(run, level)| run.iter().map(move |p| p.ln_torque - level));
        let freedom = points.checked_sub(runs.len()).filter(|freedom| *freedom > 0)?;
        let scatter = (residuals.map(|r| r * r).sum::<f64>() / freedom as f64).sqrt().max(MIN_SCATTER);
        let [fast, slow] = [[0.0, FAST_MIN[0]], [0.0, SLOW_MIN[0]]];
        Some(Self { level: mean(&levels)?, fast, slow, rest: Vec::new(), scatter })
    }

    /// Fit with these time constants; `None` if a decay would rise.
    fn falling(runs: &[&Curve], fast: f64, slow: f64) -> Option<Self> {
        let rows: Vec<(usize, &CurvePoint)> = runs
            .iter()
            .enumerate()
            .flat_map(|(run, curve)| curve.iter().map(move |point| (run, point)))
            .collect();
        let count = runs.len();
        let freedom = rows.len().checked_sub(count + 2).filter(|freedom| *freedom > 0)?;
        let x = DMatrix::from_fn(rows.len(), count + 2, |i, k| match k {
            _ if k == count => (-rows[i].1.minute / fast).exp(),
            _ if k == count + 1 => (-rows[i].1.minute / slow).exp(),
            _ => f64::from(u8::from(rows[i].0 == k)),
        });
        let y = DVector::from_fn(rows.len(), |i, _| rows[i].1.ln_torque);
        let solved = x.clone().svd(true, true).solve(&y, 1e-9).ok()?;
        let residuals = &y - &x * &solved;
        let (b, c) = (solved[count], solved[count + 1]);
        // friction that rises briefly is noise of the first cycle
        (c > 0.0 && b > -0.25 * c).then(|| Self {
            level: solved.rows(0, count).mean(),
            fast: [b, fast],
            slow: [c, slow],
            rest: Vec::new(),
            scatter: (residuals.norm_squared() / freedom as f64).sqrt().max(MIN_SCATTER),
        })
    }

    /// The usual value at `minute`.
    pub(super) fn value(&self, minute: f64) -> f64 {
        self.level + self.excess(minute) + self.rest(minute)
    }

    /// Friction above the warm value at `minute`, in logarithms.
    pub(super) fn excess(&self, minute: f64) -> f64 {
        decay(self.fast, minute) + decay(self.slow, minute)
    }

    /// Change at `minute` if the slow time constant is `factor` times as long.
    pub(super) fn slower(&self, factor: f64, minute: f64) -> f64 {
        let [size, constant] = self.slow;
        decay([size, constant * factor], minute) - decay(self.slow, minute)
    }

    /// The same for a small factor, per unit of its logarithm.
    pub(super) fn slowing(&self, minute: f64) -> f64 {
        decay(self.slow, minute) * minute / self.slow[1]
    }

    /// Differences of a curve from the usual one, by cycle.
    pub(in crate::detect::runs) fn difference(&self, curve: &Curve) -> Vec<(u32, f64)> {
        curve.iter().map(|point| (point.cycle, point.ln_torque - self.value(point.minute))).collect()
    }
}

pub(super) fn decay([size, constant]: [f64; 2], minute: f64) -> f64 {
    size * (-minute / constant).exp()
}

fn torques(curve: &Curve) -> Vec<f64> {
    curve.iter().map(|point| point.ln_torque).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run of eight cycles of three minutes whose friction falls from a half above to the warm value.
    fn run(seed: u32, level: f64) -> Curve {
        let noise = |cycle: u32| 0.002 * (f64::from((seed * 31 + cycle * 17) % 13) / 6.0 - 1.0);
        let point = |cycle: u32| {
            let minute = 3.0 * f64::from(cycle) - 1.5;
            let ln_torque = level + 0.2 * (-minute / 4.0).exp() + 0.3 * (-minute / 45.0).exp() + noise(cycle);
            CurvePoint { cycle, minute, ln_torque }
        };
        (1..=8).map(point).collect()
    }

    #[test]
    fn the_usual_curve_is_found_whatever_the_levels_of_the_runs() {
        let runs = [run(1, 1.0), run(2, 1.02), run(3, 0.98), run(4, 1.0)];
        let found = Template::of(&runs.each_ref()).unwrap();
        for minute in [1.5, 6.0, 12.0, 22.5] {
            let truth = 1.0 + 0.2 * (-minute / 4.0_f64).exp() + 0.3 * (-minute / 45.0_f64).exp();
            assert!((found.value(minute) - truth).abs() < 0.005, "{minute} {found:?}");
        }
        assert!(found.scatter < 0.003, "{found:?}");
    }

    #[test]
    fn a_curve_that_two_decays_miss_is_the_mean_of_the_runs() {
        let odd = |seed: u32| -> Curve {
            let mut curve = run(seed, 1.0);
            curve[0].ln_torque += 0.05;
            curve[3].ln_torque -= 0.02;
            curve
        };
        let runs = [odd(1), odd(2), odd(3), odd(4), odd(5)];
        let found = Template::of(&runs.each_ref()).unwrap();
        for (cycle, extra) in [(0, 0.05), (3, -0.02), (5, 0.0)] {
            let minute = 3.0 * f64::from(cycle) + 1.5;
            let truth = 1.0 + 0.2 * (-minute / 4.0_f64).exp() + 0.3 * (-minute / 45.0_f64).exp() + extra;
            assert!((found.value(minute) - truth).abs() < 0.003, "{minute} {found:?}");
        }
        assert!(found.scatter < 0.003, "{found:?}");
    }

    #[test]
    fn friction_that_does_not_fall_has_a_flat_curve_and_one_run_none() {
        let flat = |level: f64| -> Curve {
            (1..=6).map(|cycle| CurvePoint { cycle, minute: f64::from(cycle), ln_torque: level }).collect()
        };
        let found = Template::of(&[&flat(1.0), &flat(1.5)]).unwrap();
        assert!((found.value(3.0) - 1.25).abs() < 1e-9);
        assert_eq!(Template::of(&[&flat(1.0)]), None);
    }
}
