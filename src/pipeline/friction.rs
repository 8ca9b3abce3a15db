//! Friction beyond a run's own warming: over speed by cycle, and the robot's maps with the index of each run.

use std::collections::hash_map::Entry;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::Arc;

use super::conclude::method::INDEX_METHOD;
use super::context::PipelineError;
use armwatch_method::friction::index::baseline::{FormedMaps, fit_maps};
use armwatch_method::friction::index::held_map::HeldMap;
use armwatch_method::friction::index::run_record::coverage;
use armwatch_method::friction::index::{ReferenceMap, run_indices};
use armwatch_method::friction::over_speed::friction_over_speed;
use armwatch_method::signal::filter::independent_fraction;
use armwatch_method::spare_threads::SpareThreads;
use armwatch_model::analysis::FrictionPoint;
use armwatch_model::analysis::map_run::MapRun;
use armwatch_model::analysis::measurements::CyclePoint;
use armwatch_model::anomaly::epoch::Epoch;
use armwatch_model::robot::JointIndex;
use armwatch_store::{
    CycleSpeedFits, FrictionConclusion, FrictionPlan, FrictionTests, KnownPlan, NewBaseline, NewIndices,
    PlannedMap, Store, plan,
};

/// Fits friction over speed of each cycle of run `run_id`, on several threads while some are `spare`.
pub async fn over_speed(
    store: &Store,
    run_id: i64,
    points: &[CyclePoint],
    spare: SpareThreads,
) -> Result<Vec<CycleSpeedFits>, PipelineError> {
    let filters = store.cutoffs_and_rates(run_id).await?;
    let of_rows = |(cycle, [cutoff, rate]): (u32, [f64; 2])| (cycle, independent_fraction(cutoff, rate));
    let fractions: HashMap<u32, f64> = filters.into_iter().map(of_rows).collect();
    let points = points.to_vec();
    Ok(tokio::task::spawn_blocking(move || speed_fits(&spare, &points, &fractions)).await?)
}

/// Friction over speed by cycle; joints with too few speeds already have a cycle remark.
fn speed_fits(
    spare: &SpareThreads,
    points: &[CyclePoint],
    fractions: &HashMap<u32, f64>,
) -> Vec<CycleSpeedFits> {
    let cycles: Vec<&[CyclePoint]> = points.chunk_by(|a, b| a.cycle == b.cycle).collect();
    let fits_of = |of_cycle: &[CyclePoint]| {
        let cycle = of_cycle.first()?.cycle;
        let fraction = *fractions.get(&cycle)?;
        let points: Vec<FrictionPoint> = of_cycle.iter().map(|row| row.point).collect();
        let mut joints: Vec<JointIndex> = points.iter().map(|p| p.joint).collect();
        joints.sort_unstable();
        joints.dedup();
        let fits = joints.into_iter().filter_map(|j| friction_over_speed(j, &points, fraction).ok());
        Some(CycleSpeedFits { cycle, joints: fits.collect() })
    };
    let fits = spare.each(cycles.len(), || (), |(), at| fits_of(cycles[at]));
    fits.into_iter().flatten().collect()
}

/// Tests of a robot that conclusions on friction use, and their plan.
#[derive(Debug)]
pub struct PlannedTests {
    found: FrictionTests,
    plan: FrictionPlan,
    /// Positions of tests whose points were just counted.
    unseen: HashSet<usize>,
    /// True if it is the plan of all tests.
    is_whole: bool,
    /// The known plan that the next tests are compared with.
    pub known: Option<KnownPlan>,
}

/// Reads the tests of a robot that conclusions on friction use. For a long history, these are the latest tests and
/// those that they are compared with, unless `of_all`: their plan gives the same result for the latest tests as the
/// plan of all tests.
pub async fn planned(
    store: &Store,
    robot_id: i64,
    baseline_runs: usize,
    of_all: bool,
) -> Result<PlannedTests, PipelineError> {
    if !of_all && let Some(known) = store.friction_plan(robot_id, baseline_runs, INDEX_METHOD).await? {
        let mut found = store.friction_tests_of(robot_id, &known).await?;
        let unseen = look_at_points(store, &mut found).await?;
        if let Some((plan, known)) = known.extended(&found, baseline_runs, INDEX_METHOD) {
            return Ok(PlannedTests { found, plan, unseen, is_whole: false, known: Some(known) });
        }
    }
    let mut found = store.friction_tests(robot_id).await?;
    let unseen = look_at_points(store, &mut found).await?;
    let plan = plan(&found, baseline_runs, INDEX_METHOD);
    let known = KnownPlan::of(&found, &plan);
    Ok(PlannedTests { found, plan, unseen, is_whole: true, known })
}

/// Friction of a robot by its present history: baselines and maps by the rule of [`plan`], and the index of every test
/// whose stored index has another basis. A test is computed once, so that the effort depends on new data only; tests
/// are read one at a time. If the history is long, the result contains the plan that the next tests are compared with.
/// `of_all` has the same meaning as in [`planned`].
pub async fn friction_conclusion(
    store: &Store,
    robot_id: i64,
    baseline_runs: usize,
    of_all: bool,
) -> Result<(FrictionConclusion, Option<KnownPlan>), PipelineError> {
    let PlannedTests { found, plan, unseen, is_whole, known } =
        planned(store, robot_id, baseline_runs, of_all).await?;
    let is_due = |at: usize| {
        let basis = plan.tests[at].basis;
        unseen.contains(&at) || (basis != found.tests[at].basis && (is_whole || basis.is_some()))
    };
    let due: Vec<usize> = (0..found.tests.len()).filter(|at| is_due(*at)).collect();
    let current = if is_whole { current_maps(&plan) } else { Vec::new() };
    let mut maps = HeldMaps::default();
    let needed = match is_whole {
        true => needed_maps(&plan, &found, &due, &current),
        false if due.is_empty() => BTreeSet::new(),
        false => (0..plan.maps.len()).collect(),
    };
    for at in needed {
        maps.form(store, &found, &plan, at).await?;
    }
    let mut conclusion = FrictionConclusion {
        run_ids: found.tests.iter().map(|test| test.run_id).collect(),
        baselines: if is_whole { baselines(&plan, &found, &maps) } else { Vec::new() },
        remarks: maps.remarks(),
        is_whole,
        ..FrictionConclusion::default()
    };
    for (at, joint) in current {
        let basis = plan.maps[at].basis;
        let stored = found.maps.get(&joint) == Some(&basis);
        match maps.of(at).and_then(|formed| formed.map(joint)) {
            Some(held) => conclusion.maps.push((joint, basis, Some(held.map.clone()))),
            // a joint may have a baseline and no map
            None if stored => conclusion.maps.push((joint, basis, None)),
            None => {}
        }
    }
    conclusion.indices = compare(store, &found, &plan, &Arc::new(maps), &due).await?;
    Ok((conclusion, known))
}

/// Counts the friction points of tests that were not counted yet; returns their positions.
async fn look_at_points(store: &Store, found: &mut FrictionTests) -> Result<HashSet<usize>, PipelineError> {
    let mut unseen = HashSet::new();
    for (at, test) in found.tests.iter_mut().enumerate().filter(|(_, test)| test.points.is_none()) {
        let run = store.friction_run(test, true).await?;
        test.points = Some(coverage(&run));
        unseen.insert(at);
    }
    Ok(unseen)
}

/// The maps that the latest test is compared with.
fn current_maps(plan: &FrictionPlan) -> Vec<(usize, JointIndex)> {
    let references = plan.tests.last().map(|test| &test.references[..]).unwrap_or_default();
    references.iter().map(|(at, joint, _)| (*at, *joint)).collect()
}

/// Maps that must be fitted now, each after its companions.
fn needed_maps(
    plan: &FrictionPlan,
    found: &FrictionTests,
    due: &[usize],
    current: &[(usize, JointIndex)],
) -> BTreeSet<usize> {
    let references = due.iter().flat_map(|test| plan.tests[*test].references.iter().map(|(at, ..)| *at));
    let is_stored = |map: &PlannedMap, joint: JointIndex| {
        found.baselines.iter().any(|stored| (stored.joint, stored.basis) == (joint, map.basis))
    };
    let unknown = |at: &usize| {
        let map = &plan.maps[*at];
        map.is_first() && map.joints.iter().any(|(joint, ..)| !is_stored(map, *joint))
    };
    let without_map = |of: &&(usize, JointIndex)| {
        let basis = &plan.maps[of.0].basis;
        found.maps.get(&of.1).is_some_and(|stored| stored != basis)
    };
    let mut needed: BTreeSet<usize> = references.collect();
    needed.extend((0..plan.maps.len()).filter(unknown));
    needed.extend(current.iter().filter(without_map).map(|(at, _)| *at));
    // companions come before the maps that they help
    for at in (0..plan.maps.len()).rev() {
        if needed.contains(&at) {
            needed.extend(plan.maps[at].companions.iter().map(|(companion, _)| *companion));
        }
    }
    needed
}

/// Maps that were just fitted, by their position in the plan.
#[derive(Debug, Default)]
struct HeldMaps(HashMap<usize, Formed>);

/// Maps that were fitted together.
#[derive(Debug)]
struct Formed(FormedMaps);

impl Formed {
    fn map(&self, joint: JointIndex) -> Option<&HeldMap> {
        self.0.maps.iter().find(|held| held.map.joint == joint)
    }

    fn remark(&self, joint: JointIndex) -> Option<&str> {
        self.0.remarks.iter().find(|(of, _)| *of == joint).map(|(_, words)| words.as_str())
    }
}

impl HeldMaps {
    fn of(&self, at: usize) -> Option<&Formed> {
        self.0.get(&at)
    }

    fn map(&self, at: usize, joint: JointIndex) -> Option<&HeldMap> {
        self.of(at)?.map(joint)
    }

    fn remarks(&self) -> Vec<String> {
        self.0.values().flat_map(|formed| formed.0.remarks.iter().map(|(_, words)| words.clone())).collect()
    }

    async fn form(
        &mut self,
        store: &Store,
        found: &FrictionTests,
        plan: &FrictionPlan,
        at: usize,
    ) -> Result<(), PipelineError> {
        let map = &plan.maps[at];
        let mut runs = Vec::with_capacity(map.motion.len());
        for test in &map.motion {
            let with_points = map.learnt.binary_search(test).is_ok();
            runs.push(store.friction_run(&found.tests[*test], with_points).await?);
        }
        let learnt: Vec<usize> =
            map.learnt.iter().filter_map(|test| map.motion.binary_search(test).ok()).collect();
        let joints: Vec<JointIndex> = map.joints.iter().map(|(joint, ..)| *joint).collect();
        let companions: Vec<HeldMap> =
            map.companions.iter().filter_map(|(at, joint)| self.map(*at, *joint).cloned()).collect();
        let baseline_runs = map.baseline.len();
        let formed = tokio::task::spawn_blocking(move || {
            let companions: Vec<&HeldMap> = companions.iter().collect();
            fit_maps(&joints, &companions, &runs, &learnt, baseline_runs)
        })
        .await?;
        self.0.insert(at, Formed(formed));
        Ok(())
    }
}

/// The baselines in force, one entry per joint and epoch.
fn baselines(plan: &FrictionPlan, found: &FrictionTests, maps: &HeldMaps) -> Vec<NewBaseline> {
    let first_maps = plan.maps.iter().enumerate().filter(|(_, map)| map.is_first());
    let of_map = |(at, map): (usize, &PlannedMap)| {
        let run_ids: Vec<i64> = map.baseline.iter().map(|test| found.tests[*test].run_id).collect();
        let of_joint = |(joint, ordinal, epoch): &(JointIndex, u32, Epoch)| NewBaseline {
            joint: *joint,
            epoch: *ordinal,
            cause: epoch.cause,
            begins_at: epoch.begins_at.as_microsecond(),
            basis: map.basis,
            run_ids: run_ids.clone(),
            formed: maps.of(at).map(|formed| {
                let levels = formed.map(*joint).map(|held| held.map.levels.clone());
                (levels.unwrap_or_default(), formed.remark(*joint).map(str::to_owned))
            }),
        };
        map.joints.iter().map(of_joint).collect::<Vec<NewBaseline>>()
    };
    let mut found: Vec<NewBaseline> = first_maps.flat_map(of_map).collect();
    found.sort_by_key(|of| (of.joint, of.epoch));
    found
}

/// Indices of the tests at `due`.
async fn compare(
    store: &Store,
    found: &FrictionTests,
    plan: &FrictionPlan,
    maps: &Arc<HeldMaps>,
    due: &[usize],
) -> Result<Vec<NewIndices>, PipelineError> {
    let mut motion: HashMap<usize, MapRun> = HashMap::new();
    let mut compared = Vec::with_capacity(due.len());
    for &at in due {
        let planned = &plan.tests[at];
        let test = &found.tests[at];
        let mut indices = Vec::new();
        if !planned.references.is_empty() {
            motion.retain(|before, _| *before >= planned.first_motion);
            for before in planned.first_motion..at {
                if let Entry::Vacant(entry) = motion.entry(before) {
                    entry.insert(store.friction_run(&found.tests[before], false).await?);
                }
            }
            let before: Vec<MapRun> =
                (planned.first_motion..at).filter_map(|before| motion.get(&before).cloned()).collect();
            let run = store.friction_run(test, true).await?;
            let (maps, references) = (Arc::clone(maps), planned.references.clone());
            indices = tokio::task::spawn_blocking(move || {
                let reference = |(at, joint, in_baseline): &(usize, JointIndex, bool)| {
                    Some(ReferenceMap { held: maps.map(*at, *joint)?, in_baseline: *in_baseline })
                };
                let references: Vec<ReferenceMap<'_>> = references.iter().filter_map(reference).collect();
                run_indices(&references, &before, &run)
            })
            .await?;
        }
        compared.push(NewIndices {
            run_id: test.run_id,
            points: test.points.clone().unwrap_or_default(),
            basis: planned.basis,
            indices,
        });
    }
    Ok(compared)
}

#[cfg(test)]
mod tests;
