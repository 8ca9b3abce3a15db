//! A friction map that is held: what the indices of runs are computed from.

use super::map::FittedMap;
use super::record::{CycleMotion, JointRecord, MapRun, RecordPoint, ThermalSensor};
use super::run_effects::{JointScales, RunEffect};
use super::run_record::{activities, level_points};
use super::thermal_source::held_sensor;
use crate::analysis::Estimate;
use crate::analysis::friction::FrictionMap;
use crate::numerics::statistics::descriptive::mean;

/// A joint's friction map, fitted once, with all that indices of runs are computed from.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldMap {
    /// The map.
    pub map: FrictionMap,
    pub(super) fit: FittedMap,
    /// The sensor with its scale and without readings.
    pub(super) sensor: ThermalSensor,
    /// Median of the joint's mean speed in a cycle, rad/s, which has the activity one.
    pub(super) usual_speed: Option<f64>,
    pub(super) scales: JointScales,
    /// Prior scale of the ambient effect that is common to all joints.
    pub(super) ambient_scale: f64,
    pub(super) zero: Zero,
    /// Mean friction of the baseline as measured, by level, Nm.
    pub(super) usual: Vec<Option<f64>>,
}

/// Mean effects over the runs of a baseline, from which those of all runs are counted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Zero {
    wear: f64,
    ambient: f64,
    /// Variance of `wear`.
    variance: f64,
    /// Number of runs.
    runs: f64,
}

/// Effects of a run relative to the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relative {
    pub wear: f64,
    pub variance: f64,
    pub ambient: Estimate,
}

impl Zero {
    pub(super) fn of(effects: &[RunEffect]) -> Self {
        let baseline = identified(effects);
        let of = |what: &dyn Fn(&RunEffect) -> f64| {
            mean(&baseline.iter().map(|run| what(run)).collect::<Vec<f64>>()).unwrap_or(0.0)
        };
        let runs = baseline.len() as f64;
        Self {
            wear: of(&|e| e.wear),
            ambient: of(&|e| e.ambient.value),
            variance: of(&|e| e.variance) / runs.max(1.0),
            runs,
        }
    }

    /// The same with the ambient effect counted from `ambient`.
    pub(super) fn with_ambient(self, ambient: f64) -> Self {
        Self { ambient, ..self }
    }

    /// Wear as `(1 + w) / (1 + mean w) - 1`, the ambient effect as a difference.
    ///
    /// The variance `v` becomes `v + mean v / n` for a baseline of `n` runs, and `(1 - 2 / n) v + mean v / n` for a run
    /// that is one of them, because its own effect is the `n`th part of the mean.
    pub(super) fn relative(&self, effect: &RunEffect, in_baseline: bool) -> Relative {
        let own = if in_baseline { 1.0 - 2.0 / self.runs } else { 1.0 };
        Relative {
            wear: (1.0 + effect.wear) / (1.0 + self.wear) - 1.0,
            variance: (own * effect.variance + self.variance).max(0.0),
            ambient: Estimate { value: effect.ambient.value - self.ambient, ..effect.ambient },
        }
    }
}

/// Runs whose wear the data determine; all runs if there is none.
fn identified(effects: &[RunEffect]) -> Vec<&RunEffect> {
    let in_map = || effects.iter().filter(|effect| effect.in_map);
    let found: Vec<&RunEffect> = in_map().filter(|effect| effect.identified).collect();
    if found.is_empty() { in_map().collect() } else { found }
}

/// Record of a joint over `runs`, at the levels of its map and with the sensor that the map stands on; `None` where a
/// run lacks the temperature that the map needs.
pub(super) fn held_record(
    held: &HeldMap,
    runs: &[&MapRun],
    spans: &[CycleMotion],
    starts: &[f64],
) -> Option<JointRecord> {
    let joint = held.map.joint;
    let levels: Vec<f64> = held.map.levels.iter().map(|level| level.speed_fraction).collect();
    let of_level =
        |(level, speed_fraction): (usize, &f64)| level_points(joint, *speed_fraction, level, runs, starts);
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
