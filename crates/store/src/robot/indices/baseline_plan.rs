//! Plan of a robot's friction indices: the tests of each joint's baseline by the stated rule, and the inputs of each
//! index. Pure: the same history gives the same plan, whatever the order of arrival.
//!
//! The baseline of a joint in an epoch consists of its first full tests by recording time. Its map is learnt from them,
//! and again each time the number of full tests has doubled. A test is compared by the map that is in force when it is
//! recorded. Joints with the same tests are fitted together. An index depends on maps, its own test and the motion
//! before it. A hash of these, its basis, shows if a stored index is still valid.

use std::collections::{BTreeMap, BTreeSet};

pub mod known;

use super::baselines::{FrictionTest, FrictionTests, IndexBasis};
use armwatch_model::anomaly::baseline_runs::FULL_RUN_POINTS;
use armwatch_model::anomaly::baseline_runs::REMEMBERED_S;
use armwatch_model::anomaly::baseline_runs::learnt_runs;
use armwatch_model::anomaly::baseline_runs::stages;
use armwatch_model::anomaly::epoch::{Epoch, epochs};
use armwatch_model::robot::JointIndex;

/// Fewest tests of a baseline: a single test has no scatter.
const MIN_BASELINE_RUNS: usize = 2;

/// Maps of a robot, and the comparisons of its tests.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionPlan {
    /// Maps; each companion precedes the maps that it helps.
    pub maps: Vec<PlannedMap>,
    /// One entry per test.
    pub tests: Vec<PlannedTest>,
}

/// Maps of joints that are learnt from the same tests.
#[derive(Debug, Clone, PartialEq)]
pub struct PlannedMap {
    /// The joints, each with the ordinal of its epoch and the epoch.
    pub joints: Vec<(JointIndex, u32, Epoch)>,
    /// Positions of the tests of the baseline, ascending.
    pub baseline: Vec<usize>,
    /// Positions of the tests that the map is learnt from, ascending; the first are the baseline.
    pub learnt: Vec<usize>,
    /// Positions of the tests whose motion affects it, ascending, including the learnt ones.
    pub motion: Vec<usize>,
    /// Maps of other joints that are valid over all learnt tests: position of the map, and the joint.
    pub companions: Vec<(usize, JointIndex)>,
    /// Hash of all of this.
    pub basis: IndexBasis,
}

impl PlannedMap {
    /// True if it is learnt from the baseline alone, as the first map of an epoch is.
    pub fn is_first(&self) -> bool {
        self.learnt.len() == self.baseline.len()
    }
}

/// The maps that a test is compared with.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlannedTest {
    /// Position of the map of each joint, and true if the test belongs to its baseline.
    pub references: Vec<(usize, JointIndex, bool)>,
    /// Position of the first test whose motion affects it.
    pub first_motion: usize,
    /// Hash of all of this; `None` without references.
    pub basis: Option<IndexBasis>,
}

/// A map of one joint.
struct JointMap {
    joint: JointIndex,
    ordinal: u32,
    epoch: Epoch,
    baseline: Vec<usize>,
    learnt: Vec<usize>,
}

/// The plan for a robot, with baselines of `baseline_runs` tests, at least two. The points of all tests have been
/// counted. `method` identifies the sources that compute indices.
pub fn plan(found: &FrictionTests, baseline_runs: usize, method: u64) -> FrictionPlan {
    let tests = &found.tests;
    let maps = grouped(joint_maps(found, baseline_runs.max(MIN_BASELINE_RUNS)), tests, method);
    let mut by_test = vec![PlannedTest::default(); tests.len()];
    for (joint, epoch, of_epoch) in by_epoch(&maps) {
        for test in &epoch.tests {
            // maps are ordered by their last test
            let held = of_epoch.iter().rev().find(|at| maps[**at].learnt.last() <= Some(test));
            if let Some(at) = held.or(of_epoch.first()) {
                by_test[*test].references.push((*at, joint, maps[*at].baseline.contains(test)));
            }
        }
    }
    for (at, planned) in by_test.iter_mut().enumerate() {
        planned.references.sort_by_key(|(_, joint, _)| *joint);
        planned.first_motion = first_motion(tests, at);
        planned.basis = test_basis(tests, at, planned, &maps, method);
    }
    FrictionPlan { maps, tests: by_test }
}

/// Each joint and epoch with the positions of its maps, in their order.
fn by_epoch(maps: &[PlannedMap]) -> Vec<(JointIndex, &Epoch, Vec<usize>)> {
    let mut found: BTreeMap<(JointIndex, u32), (&Epoch, Vec<usize>)> = BTreeMap::new();
    for (at, map) in maps.iter().enumerate() {
        for (joint, ordinal, epoch) in &map.joints {
            found.entry((*joint, *ordinal)).or_insert((epoch, Vec::new())).1.push(at);
        }
    }
    found.into_iter().map(|((joint, _), (epoch, maps))| (joint, epoch, maps)).collect()
}

/// Maps of all joints with a complete baseline.
fn joint_maps(found: &FrictionTests, needed: usize) -> Vec<JointMap> {
    let moments: Vec<_> = found.tests.iter().map(|test| test.moment.clone()).collect();
    let mut joints: Vec<JointIndex> =
        found.tests.iter().flat_map(|test| test.points.iter().flatten().map(|(joint, _)| *joint)).collect();
    joints.sort_unstable();
    joints.dedup();
    let is_full = |test: usize, joint: JointIndex| is_full(&found.tests[test], joint);
    let mut maps = Vec::new();
    for joint in joints {
        for (ordinal, epoch) in (0..).zip(epochs(joint, &moments, &found.work)) {
            let full: Vec<usize> = epoch.tests.iter().copied().filter(|test| is_full(*test, joint)).collect();
            let mut learnt: Vec<Vec<usize>> =
                stages(needed, full.len()).map(|stage| learnt_runs(&full[..stage], needed)).collect();
            // a baseline that contains all full tests stays the only map
            learnt.dedup();
            let baseline = &full[..needed.min(full.len())];
            maps.extend(learnt.into_iter().map(|learnt| JointMap {
                joint,
                ordinal,
                epoch: epoch.clone(),
                baseline: baseline.to_vec(),
                learnt,
            }));
        }
    }
    maps
}

/// True if a baseline of the joint may be learnt from a test.
fn is_full(test: &FrictionTest, joint: JointIndex) -> bool {
    let mut points = test.points.iter().flatten();
    points.any(|(of, points)| *of == joint && *points >= FULL_RUN_POINTS)
}

/// Maps of joints, grouped by equal tests, in the order of their completion.
fn grouped(maps: Vec<JointMap>, tests: &[FrictionTest], method: u64) -> Vec<PlannedMap> {
    let mut groups: BTreeMap<(Option<usize>, Vec<usize>), Vec<JointMap>> = BTreeMap::new();
    for map in maps {
        groups.entry((map.learnt.last().copied(), map.learnt.clone())).or_default().push(map);
    }
    let mut found: Vec<PlannedMap> = Vec::new();
    for ((_, learnt), of_group) in groups {
        let baseline = of_group.first().map(|map| map.baseline.clone()).unwrap_or_default();
        let joints: Vec<(JointIndex, u32, Epoch)> =
            of_group.into_iter().map(|of| (of.joint, of.ordinal, of.epoch)).collect();
        let companions = companions(&found, &joints, &learnt);
        let motion = motion(tests, &learnt);
        let mut planned =
            PlannedMap { joints, baseline, learnt, motion, companions, basis: IndexBasis::default() };
        planned.basis = map_basis(tests, &planned, &found, method);
        found.push(planned);
    }
    found
}

/// The latest map of each other joint that is valid over all of `learnt`.
fn companions(
    earlier: &[PlannedMap],
    own: &[(JointIndex, u32, Epoch)],
    learnt: &[usize],
) -> Vec<(usize, JointIndex)> {
    let mut found: BTreeMap<JointIndex, usize> = BTreeMap::new();
    for (at, map) in earlier.iter().enumerate() {
        for (joint, _, epoch) in &map.joints {
            let is_own = own.iter().any(|(of, ..)| of == joint);
            if !is_own && learnt.iter().all(|test| epoch.tests.binary_search(test).is_ok()) {
                found.insert(*joint, at);
            }
        }
    }
    found.into_iter().map(|(joint, at)| (at, joint)).collect()
}

/// Tests whose motion affects the thermal state in one of `learnt`, including these.
fn motion(tests: &[FrictionTest], learnt: &[usize]) -> Vec<usize> {
    let of_one = learnt.iter().flat_map(|test| first_motion(tests, *test)..=*test);
    of_one.collect::<BTreeSet<usize>>().into_iter().collect()
}

/// The first test whose motion affects the thermal state at the start of test `at`.
fn first_motion(tests: &[FrictionTest], at: usize) -> usize {
    let micros = |test: &FrictionTest| test.moment.started_at.as_microsecond();
    let from = micros(&tests[at]) - (REMEMBERED_S * 1e6) as i64;
    tests[..at].partition_point(|test| micros(test) < from)
}

/// Adds the keys and starts of tests.
fn add_tests<'a>(hasher: &mut blake3::Hasher, tests: impl Iterator<Item = &'a FrictionTest>) {
    for test in tests {
        hasher.update(&test.run_id.to_le_bytes());
        hasher.update(&test.moment.started_at.as_microsecond().to_le_bytes());
    }
    // no key of a run is negative, so this ends the list unambiguously
    hasher.update(&(-1_i64).to_le_bytes());
}

fn add_joint(hasher: &mut blake3::Hasher, joint: JointIndex) {
    hasher.update(&(joint.number() as u64).to_le_bytes());
}

fn map_basis(tests: &[FrictionTest], map: &PlannedMap, earlier: &[PlannedMap], method: u64) -> IndexBasis {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&method.to_le_bytes());
    map.joints.iter().for_each(|(joint, ..)| add_joint(&mut hasher, *joint));
    for positions in [&map.baseline, &map.learnt, &map.motion] {
        add_tests(&mut hasher, positions.iter().map(|test| &tests[*test]));
    }
    for (at, joint) in &map.companions {
        add_joint(&mut hasher, *joint);
        hasher.update(&earlier[*at].basis);
    }
    *hasher.finalize().as_bytes()
}

fn test_basis(
    tests: &[FrictionTest],
    at: usize,
    planned: &PlannedTest,
    maps: &[PlannedMap],
    method: u64,
) -> Option<IndexBasis> {
    if planned.references.is_empty() {
        return None;
    }
    let mut hasher = blake3::Hasher::new();
    hasher.update(&method.to_le_bytes());
    add_tests(&mut hasher, tests[planned.first_motion..=at].iter());
    for (map, joint, is_own) in &planned.references {
        add_joint(&mut hasher, *joint);
        hasher.update(&maps[*map].basis);
        hasher.update(&[u8::from(*is_own)]);
    }
    Some(*hasher.finalize().as_bytes())
}
#[cfg(test)]
mod tests;
