//! Points of the runs with the values of the friction map at them, and their weights.

use super::map::{FittedMap, point_deficits};
use super::record::{JointRecord, ThermalSensor};
use crate::statistics::descriptive::{mean, median};

/// Smallest ratio of the scatter of a run's points to the joint's usual one that reduces their weight.
const FAR_MORE: f64 = 2.5;
/// Smallest number of second differences for this: with eight, normal points exceed the ratio in one or two runs of a
/// hundred.
const FEWEST_DIFFERENCES: usize = 8;
/// Smallest number of second differences per level: a step inside the run spoils two, which must be less than half of
/// them.
const FEWEST_OF_LEVEL: f64 = 5.0;
/// Median magnitude of a normal value of standard deviation 1.
const MEDIAN_OF_NORMAL: f64 = 0.674_489_750_196_082;
/// Smallest scatter of a point, as a fraction of friction.
const MIN_SCATTER: f64 = 1e-4;

/// Points of one joint in one run.
pub(in crate::friction) struct RunPoints {
    pub points: Vec<RunPoint>,
    /// True if the points enter the map.
    pub in_map: bool,
    /// Slope of the map over the thermal deficit at the largest speed, as a fraction of warm friction.
    pub top_slope: f64,
    /// Result of [`viscous_shares`] for the map of the joint.
    pub viscous: Vec<f64>,
    /// True if the map uses a recorded ambient temperature.
    pub has_recorded_ambient: bool,
}

/// Point with the values of the map at it.
pub(in crate::friction) struct RunPoint {
    pub level: usize,
    /// Measured friction, Nm.
    pub torque: f64,
    /// Friction of the map, Nm.
    pub predicted: f64,
    /// Slope of the map over the thermal deficit, Nm.
    pub slope: f64,
    /// Result of [`start_decay`] at the time of the point.
    pub decay: [f64; 2],
}

/// Effect of a thermal deficit of one at the start of a run, in the slow or in the fast part, on the mixed deficit
/// `seconds` later: `share exp(-seconds / T)` for each part.
pub(in crate::friction) fn start_decay(fit: &FittedMap, seconds: f64) -> [f64; 2] {
    let heating = fit.law.rates().heating;
    let share = [fit.law.share, 1.0 - fit.law.share];
    std::array::from_fn(|part| share[part] * (-seconds / heating[part]).exp())
}

/// Part of warm friction that grows with speed, by level, 0 to 1: `1 - least / warm`; the smallest friction of the
/// levels is the Coulomb part.
pub(super) fn viscous_shares(warm: &[f64]) -> Vec<f64> {
    let least = warm.iter().copied().fold(f64::INFINITY, f64::min);
    warm.iter().map(|warm| 1.0 - least / warm).collect()
}

impl RunPoints {
    /// Mean over the levels of the map of the part of friction that grows with speed.
    pub fn viscous_mean(&self) -> f64 {
        mean(&self.viscous).unwrap_or(0.0)
    }

    /// Mean increase of friction by a thermal deficit of one, as a fraction of friction.
    pub fn mean_slope(&self) -> f64 {
        mean(&self.points.iter().map(|p| p.slope / p.predicted).collect::<Vec<f64>>()).unwrap_or(0.0)
    }

    /// Levels with points, ascending and unique.
    pub fn levels(&self) -> impl Iterator<Item = usize> {
        let mut levels: Vec<usize> = self.points.iter().map(|p| p.level).collect();
        levels.sort_unstable();
        levels.dedup();
        levels.into_iter()
    }

    /// Weight of the points, at most 1. It is less if they scatter about their warm-up by far more than `scatter`, by
    /// level. Variation of friction between cycles affects all levels of a cycle equally, so these then count as one
    /// point.
    pub fn weight(&self, scatter: &[f64]) -> f64 {
        let (mut sizes, mut levels) = (Vec::new(), 0.0);
        for level in self.levels() {
            levels += 1.0;
            let relative = relative_friction(&self.points, level);
            sizes.extend(second_differences(&relative).map(|size| size.abs() / scatter[level]));
        }
        match median(&sizes).map(|size| size / MEDIAN_OF_NORMAL) {
            Some(ratio)
                if sizes.len() >= FEWEST_DIFFERENCES
                    && sizes.len() as f64 >= FEWEST_OF_LEVEL * levels
                    && ratio > FAR_MORE =>
            {
                (ratio * ratio * levels).recip()
            }
            _ => 1.0,
        }
    }
}

/// Friction of the points of a level over that of the map, in order.
fn relative_friction(points: &[RunPoint], level: usize) -> Vec<f64> {
    points.iter().filter(|p| p.level == level).map(|p| p.torque / p.predicted).collect()
}

/// Second differences, scaled to the standard deviation of one value: `var(y[i-1] - 2 y[i] + y[i+1]) = 6 sigma²`.
fn second_differences(values: &[f64]) -> impl Iterator<Item = f64> {
    values.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]) / 6.0_f64.sqrt())
}

/// Points of a joint by run, with the values of its map.
pub(in crate::friction) fn run_points(
    record: &JointRecord,
    fit: &FittedMap,
    starts: &[f64],
) -> Vec<RunPoints> {
    let top = record.levels.len() - 1;
    let top_slope = fit.cold[top].max(f64::MIN_POSITIVE) / fit.warm[top];
    let viscous = viscous_shares(&fit.warm);
    let has_recorded_ambient = matches!(record.sensor, ThermalSensor::Ambient(_));
    let empty = || RunPoints {
        points: Vec::new(),
        in_map: false,
        top_slope,
        viscous: viscous.clone(),
        has_recorded_ambient,
    };
    let mut runs: Vec<RunPoints> = starts.iter().map(|_| empty()).collect();
    for (p, x) in record.points.iter().zip(point_deficits(record, &fit.law)) {
        let run = &mut runs[p.run];
        run.points.push(RunPoint {
            level: p.level,
            torque: p.torque,
            predicted: fit.warm[p.level] + fit.cold[p.level] * fit.law.mixed(x),
            slope: fit.cold[p.level],
            decay: start_decay(fit, p.time - starts[p.run]),
        });
        run.in_map |= p.in_map;
    }
    runs
}

/// Standard deviation of the points of each level about a smooth curve, as a fraction of friction.
///
/// It follows from second differences within runs, which neither warm-up nor a constant offset affects; `unknown` for a
/// level without any.
pub(in crate::friction) fn scatter(runs: &[RunPoints], levels: usize, unknown: f64) -> Vec<f64> {
    (0..levels)
        .map(|level| {
            let (mut squares, mut count) = (0.0, 0.0);
            for run in runs {
                for difference in second_differences(&relative_friction(&run.points, level)) {
                    squares += difference * difference;
                    count += 1.0;
                }
            }
            if count > 0.0 { (squares / count).sqrt().max(MIN_SCATTER) } else { unknown }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_scatter_far_more_than_usual_weigh_less() {
        let mut points = RunPoints {
            points: Vec::new(),
            in_map: true,
            top_slope: 0.1,
            viscous: vec![0.0; 2],
            has_recorded_ambient: false,
        };
        let of = |level: usize, cycle: usize, scatter: f64| RunPoint {
            level,
            // the same at both levels of a cycle
            torque: 10.0 * (1.0 + scatter * [0.3, -1.1, 0.8, 1.2, -0.9, -0.4, 1.0, -0.7][cycle]),
            predicted: 10.0,
            slope: 1.0,
            decay: [0.5, 0.5],
        };
        let mut weight = |scatter: f64| {
            points.points = (0..16).map(|i| of(i % 2, i / 2, scatter)).collect();
            points.weight(&[0.003, 0.003])
        };
        assert_eq!(weight(0.003), 1.0);
        let mean = weight(0.08) / (0.003_f64 / 0.08).powi(2);
        assert!((0.2..1.0).contains(&mean), "{mean}");
    }

    #[test]
    fn a_step_inside_a_run_takes_no_weight() {
        let mut points = RunPoints {
            points: Vec::new(),
            in_map: true,
            top_slope: 0.1,
            viscous: vec![0.0; 2],
            has_recorded_ambient: false,
        };
        let of = |cycle: usize| if cycle < 4 { 10.0 } else { 12.5 };
        let point = |cycle: usize| RunPoint {
            level: 0,
            torque: of(cycle),
            predicted: 10.0,
            slope: 1.0,
            decay: [0.5, 0.5],
        };
        points.points = (0..8).map(point).collect();
        assert_eq!(points.weight(&[0.003]), 1.0);
    }
}
