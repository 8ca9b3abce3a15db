//! Warm friction index: friction of each run relative to the robot's own baseline, at equal speed and equal thermal
//! state. If the friction law depends on the load, it is compared at the load of the baseline.
//!
//! In a run, friction of joint `j` at level `l` differs from the map's by the factor `1 + w_j` and by a thermal deficit
//! that the map does not predict. The wear `w_j` is the same at all speeds. The deficit has a part `ambient_j` that is
//! constant through the run, and a part that is present at the start and decays. A deficit adds to each level in
//! proportion to the map's cold part, which distinguishes it from wear within one joint. All joints have the same
//! ambient temperature, which distinguishes the two between joints. For each run, all of them are the solution of one
//! least-squares problem with weak priors, see `run_effects.rs`; its covariance gives the intervals.
//!
//! Maps and priors are held ([`self::baseline`]). The index of a run therefore follows from the map, the run and the
//! motion of the `REMEMBERED_S` before it, and from no later run.

mod jump;
pub mod run_record;
pub mod held_map;
pub mod baseline;

use self::held_map::{HeldMap, held_record};
use self::run_record::{level_mean, timeline};
use super::maps::map::{FittedMap, moment_deficits};
use super::maps::record::JointRecord;
use super::maps::run_effects::{PriorScales, RunEffect, held_effects};
use crate::statistics::descriptive::mean;
use armwatch_model::analysis::Estimate;
use armwatch_model::analysis::friction::FrictionIndex;
use armwatch_model::analysis::map_run::MapRun;

/// Map with which a run is compared.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceMap<'a> {
    /// The map.
    pub held: &'a HeldMap,
    /// True if the run is in the map's baseline, whose mean then contains it.
    pub in_baseline: bool,
}

/// Index of each joint that has points in the run `run` and a map among `references`, which contain at most one map per
/// joint. `before` are the runs that began within `REMEMBERED_S` before it, oldest first; only their motion is used. If
/// a run overlaps the previous one, it counts from the end of that one.
#[must_use]
pub fn run_indices(references: &[ReferenceMap<'_>], before: &[MapRun], run: &MapRun) -> Vec<FrictionIndex> {
    let all: Vec<&MapRun> = before.iter().chain([run]).collect();
    let (spans, starts) = timeline(&all);
    let start = [starts[before.len()]];
    let (references, records): (Vec<ReferenceMap<'_>>, Vec<JointRecord>) =
        references.iter().filter_map(|of| Some((*of, held_record(of.held, &[run], &spans, &start)?))).unzip();
    let fits: Vec<FittedMap> = references.iter().map(|of| of.held.fit.clone()).collect();
    let scales = PriorScales::held(references.iter().map(|of| (&of.held.scales, of.held.ambient_scale)));
    let effects = held_effects(&records, &fits, &start, &scales);
    let of_joint = |((of, record), effects): ((&ReferenceMap<'_>, &JointRecord), &Vec<RunEffect>)| {
        let effect = effects.first().filter(|effect| effect.points > 0 && effect.identified)?;
        Some(joint_index(*of, record, effect, start[0]))
    };
    references.iter().zip(&records).zip(&effects).filter_map(of_joint).collect()
}

/// Index of one joint, from the effects of its run.
fn joint_index(of: ReferenceMap<'_>, record: &JointRecord, effect: &RunEffect, start: f64) -> FrictionIndex {
    let ReferenceMap { held, in_baseline } = of;
    let relative = held.zero.relative(effect, in_baseline);
    let at_start = moment_deficits(record, &held.fit.law, &[(0, start)]);
    FrictionIndex {
        joint: record.joint,
        index: Estimate { value: 1.0 + relative.wear, std_error: relative.variance.sqrt() },
        raw: raw_index(record, &held.usual),
        ambient: relative.ambient,
        coldness_at_start: at_start.first().map_or(f64::NAN, |deficit| held.fit.law.mixed(*deficit)),
        points: effect.points,
        short: !effect.in_map,
    }
}

/// Measured friction of the record's only run as a multiple of the usual friction by level: the mean over the levels of
/// the ratio of mean friction, without regard to the thermal state. NaN without a common level.
fn raw_index(record: &JointRecord, usual: &[Option<f64>]) -> f64 {
    let ratios: Vec<f64> = (0..record.levels.len())
        .filter_map(|level| Some(level_mean(record, 0, level)? / usual[level]?))
        .collect();
    mean(&ratios).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod simulated_arm;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod companion_tests;

#[cfg(test)]
mod coverage_tests;

#[cfg(test)]
mod alarm_tests;

#[cfg(test)]
mod temperature_tests;

#[cfg(test)]
mod part_wear_tests;
