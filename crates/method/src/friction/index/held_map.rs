//! Held friction map, for the computation of the indices of runs.

use super::run_record::{SpeedLevel, activities, level_points};
use crate::friction::maps::map::FittedMap;
use crate::friction::maps::record::{JointRecord, RecordPoint, ThermalSensor};
use crate::friction::maps::run_effects::{JointScales, RunEffect};
use crate::friction::maps::thermal_source::held_sensor;
use crate::statistics::descriptive::mean;
use armwatch_model::analysis::Estimate;
use armwatch_model::analysis::friction::FrictionMap;
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};

/// Friction map of a joint, fitted once, with all data for the indices of runs.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldMap {
    /// The map.
    pub map: FrictionMap,
    pub(in crate::friction) fit: FittedMap,
    /// Sensor with its scale, without readings.
    pub(in crate::friction) sensor: ThermalSensor,
    /// Median of the joint's mean speed in a cycle, rad/s, which corresponds to an activity of one.
    pub(super) usual_speed: Option<f64>,
    pub(in crate::friction) scales: JointScales,
    /// Prior scale of the common ambient effect of all joints.
    pub(super) ambient_scale: f64,
    pub(super) zero: Zero,
    /// Measured mean friction of the baseline, by level, Nm.
    pub(in crate::friction) usual: Vec<Option<f64>>,
    /// Mean load of the gear in the baseline, by level, Nm (N), if friction depends on it: runs are compared at this
    /// load.
    pub(super) loads: Vec<Option<f64>>,
}

/// Smallest relative change of friction between runs of a baseline that counts as a jump; only the runs before it are
/// the reference.
const LEAST_CHANGE: f64 = 0.08;
/// Smallest size of the jump, in standard deviations of the runs within the two parts.
const STANDS_OUT: f64 = 4.0;
/// Smallest assumed standard deviation between runs, for a baseline of two or three runs.
const LEAST_DEVIATION: f64 = 0.005;

/// Reference of all runs: mean effects over the runs of a baseline, or over those before a jump of friction.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Zero {
    wear: f64,
    /// Effects by level.
    levels: Vec<f64>,
    ambient: f64,
    /// Variance of `wear`.
    variance: f64,
    /// Twice the share of each run of the baseline in the mean; zero if some have none.
    own_share: f64,
}

/// Effects of a run relative to the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relative {
    pub wear: f64,
    pub variance: f64,
    pub ambient: Estimate,
}

impl Zero {
    pub(in crate::friction) fn of(effects: &[RunEffect]) -> Self {
        let all = identified(effects);
        let change = change_between(&all);
        let baseline = &all[..change.unwrap_or(all.len())];
        let of = |what: &dyn Fn(&RunEffect) -> f64| {
            mean(&baseline.iter().map(|run| what(run)).collect::<Vec<f64>>()).unwrap_or(0.0)
        };
        let runs = baseline.len() as f64;
        Self {
            wear: of(&|e| e.wear),
            levels: (0..baseline.first().map_or(0, |e| e.levels.len()))
                .map(|at| of(&|e| e.levels[at]))
                .collect(),
            ambient: of(&|e| e.ambient.value),
            variance: of(&|e| e.variance) / runs.max(1.0),
            own_share: if change.is_some() || baseline.is_empty() { 0.0 } else { 2.0 / runs },
        }
    }

    /// Replaces the reference of the ambient effect by `ambient`.
    pub(super) fn with_ambient(self, ambient: f64) -> Self {
        Self { ambient, ..self }
    }

    /// Effects relative to the baseline: wear as `(1 + w) / (1 + mean w) - 1`, the ambient effect as a difference.
    ///
    /// The variance `v` becomes `v + mean v / n` for a baseline of `n` runs. For one of these runs it becomes
    /// `(1 - 2 / n) v + mean v / n`, because its own effect is the `n`th part of the mean.
    pub(in crate::friction) fn relative(&self, effect: &RunEffect, in_baseline: bool) -> Relative {
        let own = if in_baseline { 1.0 - self.own_share } else { 1.0 };
        Relative {
            wear: (1.0 + effect.wear) / (1.0 + self.wear) - 1.0,
            variance: (own * effect.variance + self.variance).max(0.0),
            ambient: Estimate { value: effect.ambient.value - self.ambient, ..effect.ambient },
        }
    }
}

impl Zero {
    /// Friction of a run at a level as a multiple of that of the baseline.
    pub(super) fn factor(&self, effect: &RunEffect, level: usize) -> f64 {
        let of = |levels: &[f64]| 1.0 + levels.get(level).copied().unwrap_or(0.0);
        of(&effect.levels) / of(&self.levels)
    }
}

/// Index of the first run after a jump of friction between two runs: there are at least two runs before it, and the
/// change exceeds the scatter on both sides. `None` if there is none.
fn change_between(runs: &[&RunEffect]) -> Option<usize> {
    let level = |of: &[&RunEffect]| mean(&of.iter().map(|run| run.wear.ln_1p()).collect::<Vec<f64>>());
    let stands_out = |at: &usize| {
        let (before, after) = runs.split_at(*at);
        let (from, to) = (level(before)?, level(after)?);
        let squares = |of: &[&RunEffect], level: f64| {
            of.iter().map(|run| (run.wear.ln_1p() - level).powi(2)).sum::<f64>()
        };
        let freedom = runs.len().saturating_sub(2).max(1) as f64;
        let deviation = ((squares(before, from) + squares(after, to)) / freedom).sqrt().max(LEAST_DEVIATION);
        let change = (to - from).abs();
        (change >= LEAST_CHANGE && change >= STANDS_OUT * deviation).then_some((*at, change / deviation))
    };
    let found = (2..runs.len()).filter_map(|at| stands_out(&at)).max_by(|a, b| a.1.total_cmp(&b.1));
    found.map(|(at, _)| at)
}

/// Runs whose wear the data determine; all runs if there is none.
fn identified(effects: &[RunEffect]) -> Vec<&RunEffect> {
    let in_map = || effects.iter().filter(|effect| effect.in_map);
    let found: Vec<&RunEffect> = in_map().filter(|effect| effect.identified).collect();
    if found.is_empty() { in_map().collect() } else { found }
}

/// Record of a joint over `runs`, at the levels and with the sensor of its map; `None` if a run lacks the temperature
/// that the map needs.
pub(super) fn held_record(
    held: &HeldMap,
    runs: &[&MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
) -> Option<JointRecord> {
    let joint = held.map.joint;
    let levels: Vec<f64> = held.map.levels.iter().map(|level| level.speed_fraction).collect();
    let of_level = |(place, &speed_fraction): (usize, &f64)| {
        let load = held.loads.get(place).copied().flatten();
        level_points(joint, SpeedLevel { place, speed_fraction, load }, runs, starts)
    };
    let mut points: Vec<RecordPoint> = levels.iter().enumerate().flat_map(of_level).collect();
    points.sort_by(|a, b| a.time.total_cmp(&b.time));
    Some(JointRecord {
        joint,
        spans: activities(joint, spans, held.usual_speed),
        levels,
        points,
        sensor: held_sensor(&held.sensor, joint, runs, starts)?,
        remarks: Vec::new(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effects(wears: &[f64]) -> Vec<RunEffect> {
        let effect = |wear: &f64| RunEffect {
            points: 48,
            in_map: true,
            identified: true,
            wear: *wear,
            variance: 1e-5,
            levels: vec![*wear],
            ambient: Estimate { value: 0.0, std_error: 0.01 },
            start: [0.0; 2],
        };
        wears.iter().map(effect).collect()
    }

    #[test]
    fn indices_are_counted_from_the_runs_before_a_jump() {
        for (wears, before) in [
            ([-0.10, -0.09, -0.10, 0.14, 0.15], -0.29 / 3.0),
            ([0.1, 0.1, -0.1, -0.1, -0.1], 0.1),
            ([0.0, 0.01, 0.0, 0.01, 0.2], 0.005),
        ] {
            let effects = effects(&wears);
            let zero = Zero::of(&effects);
            assert!((zero.wear - before).abs() < 1e-12, "{wears:?}: {zero:?}");
            let last = zero.relative(&effects[4], true);
            assert!((last.wear - ((1.0 + wears[4]) / (1.0 + before) - 1.0)).abs() < 1e-12);
            assert!(last.variance >= effects[4].variance, "a run after the jump has no part in the mean");
        }
    }

    #[test]
    fn wear_scatter_and_a_single_first_run_are_no_jump() {
        for wears in [
            [0.0, 0.04, 0.08, 0.12, 0.16],
            [0.03, -0.04, 0.05, -0.02, 0.04],
            [0.2, 0.0, 0.01, 0.0, 0.01],
            [0.0, 0.01, 0.0, 0.01, 0.06],
        ] {
            let zero = Zero::of(&effects(&wears));
            let mean = wears.iter().sum::<f64>() / 5.0;
            assert!((zero.wear - mean).abs() < 1e-12, "{wears:?}: {zero:?}");
            assert_eq!(zero.own_share, 0.4);
        }
    }
}
