//! The part of a long history's plan that the next tests are compared with. A plan of few tests gives the same result
//! for the next tests as that of all tests, as long as these come last, belong to the epochs of the latest test and
//! complete no baseline and no map.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use super::{FrictionPlan, MIN_BASELINE_RUNS, PlannedMap, PlannedTest, first_motion, is_full, test_basis};
use crate::robot::indices::baselines::{FrictionTest, FrictionTests, IndexBasis};
use crate::robot::maintenance::DescriptionKey;
use armwatch_model::anomaly::baseline_runs::{REMEMBERED_S, stages};
use armwatch_model::anomaly::epoch::{Epoch, EpochCause, epochs};
use armwatch_model::robot::JointIndex;

/// Least number of tests in a long history: shorter ones are planned as a whole. The program's own tests have short
/// ones.
const LONG: usize = if cfg!(test) { 12 } else { 500 };

/// Data for comparing the tests after the latest one.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct KnownPlan {
    /// Start of the latest test, microseconds since 1970, and its key.
    pub until: (i64, i64),
    /// Its description.
    pub description: DescriptionKey,
    /// Full tests of each joint, in the epoch of the latest test.
    pub full: Vec<(JointIndex, usize)>,
    /// Maps that the latest test is compared with, and their companions; each companion precedes the maps that it
    /// helps.
    pub maps: Vec<KnownMap>,
    /// Position of the map of each joint.
    pub references: Vec<(usize, JointIndex)>,
}

/// A map of a plan, with the keys of its tests.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct KnownMap {
    /// The joints, each with the ordinal of its epoch.
    pub joints: Vec<(JointIndex, u32)>,
    /// The tests of the baseline, ascending in time.
    pub baseline: Vec<i64>,
    /// The tests that the map is learnt from.
    pub learnt: Vec<i64>,
    /// The tests whose motion affects it, including the learnt ones.
    pub motion: Vec<i64>,
    /// Maps of other joints that help it: position of the map, and the joint.
    pub companions: Vec<(usize, JointIndex)>,
    /// Hash of all of this.
    pub basis: IndexBasis,
}

impl KnownPlan {
    /// Part of the plan of all tests; `None` for a short history.
    pub fn of(found: &FrictionTests, plan: &FrictionPlan) -> Option<Self> {
        let (latest, planned) = (found.tests.last()?, plan.tests.last()?);
        if found.tests.len() < LONG {
            return None;
        }
        let moments: Vec<_> = found.tests.iter().map(|test| test.moment.clone()).collect();
        let mut joints: Vec<JointIndex> = found
            .tests
            .iter()
            .flat_map(|test| test.points.iter().flatten().map(|(joint, _)| *joint))
            .collect();
        joints.sort_unstable();
        joints.dedup();
        let full = |joint: JointIndex| {
            let all = epochs(joint, &moments, &found.work);
            let of_latest = all.into_iter().find(|epoch| epoch.tests.last() == Some(&(moments.len() - 1)));
            let tests = of_latest.map(|epoch| epoch.tests).unwrap_or_default();
            (joint, tests.into_iter().filter(|test| is_full(&found.tests[*test], joint)).count())
        };
        // companions precede those that they help
        let mut needed: Vec<bool> = vec![false; plan.maps.len()];
        planned.references.iter().for_each(|(at, ..)| needed[*at] = true);
        for at in (0..plan.maps.len()).rev().filter(|at| needed[*at]).collect::<Vec<usize>>() {
            mark_companions(plan, at, &mut needed);
        }
        let kept: Vec<usize> = (0..plan.maps.len()).filter(|at| needed[*at]).collect();
        let place = |at: usize| kept.binary_search(&at).ok();
        let keys = |tests: &[usize]| tests.iter().map(|test| found.tests[*test].run_id).collect();
        let known = |map: &PlannedMap| KnownMap {
            joints: map.joints.iter().map(|(joint, ordinal, _)| (*joint, *ordinal)).collect(),
            baseline: keys(&map.baseline),
            learnt: keys(&map.learnt),
            motion: keys(&map.motion),
            companions: map.companions.iter().filter_map(|(at, joint)| Some((place(*at)?, *joint))).collect(),
            basis: map.basis,
        };
        Some(Self {
            until: (start(latest), latest.run_id),
            description: latest.moment.description.clone(),
            full: joints.into_iter().map(full).collect(),
            maps: kept.iter().map(|at| known(&plan.maps[*at])).collect(),
            references: planned
                .references
                .iter()
                .filter_map(|(at, joint, _)| Some((place(*at)?, *joint)))
                .collect(),
        })
    }

    /// Keys of the tests that its maps use.
    pub fn tests(&self) -> Vec<i64> {
        let mut keys: Vec<i64> = self.maps.iter().flat_map(|map| map.motion.iter().copied()).collect();
        keys.sort_unstable();
        keys.dedup();
        keys
    }

    /// Start of the first test whose motion may affect the next test, microseconds since 1970.
    pub fn remembers_from(&self) -> i64 {
        self.until.0 - (REMEMBERED_S * 1e6) as i64
    }

    /// The plan of the tests after the latest, and the updated known part. `found` has the tests of the maps, those
    /// that are remembered and all later ones, with their points. `None` if only all tests together determine the plan.
    pub fn extended(
        &self,
        found: &FrictionTests,
        baseline_runs: usize,
        method: u64,
    ) -> Option<(FrictionPlan, Self)> {
        let needed = baseline_runs.max(MIN_BASELINE_RUNS);
        let tests = &found.tests;
        let moment = |at: usize| (start(&tests[at]), tests[at].run_id);
        let new: Vec<usize> = (0..tests.len()).filter(|at| moment(*at) > self.until).collect();
        let mut known = self.clone();
        for at in &new {
            let test = &tests[*at];
            let is_worked_on = found.work.iter().any(|of| {
                let at = of.at.as_microsecond();
                at > self.until.0 && at <= start(test)
            });
            if is_worked_on || test.moment.description != self.description {
                return None;
            }
            for (joint, _) in test.points.as_ref()? {
                let (_, full) = known.full.iter_mut().find(|(of, _)| of == joint)?;
                if is_full(test, *joint) {
                    *full += 1;
                }
            }
            known.until = moment(*at);
        }
        let completed = self.full.iter().zip(&known.full).any(|((_, before), (_, after))| {
            stages(needed, *before).count() != stages(needed, *after).count()
        });
        if completed {
            return None;
        }
        let places: HashMap<i64, usize> =
            tests.iter().enumerate().map(|(at, test)| (test.run_id, at)).collect();
        let maps: Option<Vec<PlannedMap>> = self.maps.iter().map(|map| map.planned(found, &places)).collect();
        let maps = maps?;
        let mut by_test = vec![PlannedTest::default(); tests.len()];
        for at in new {
            let planned = &mut by_test[at];
            planned.references = self.references.iter().map(|(map, joint)| (*map, *joint, false)).collect();
            planned.first_motion = first_motion(tests, at);
            planned.basis = test_basis(tests, at, planned, &maps, method);
        }
        Some((FrictionPlan { maps, tests: by_test }, known))
    }
}

fn start(test: &FrictionTest) -> i64 {
    test.moment.started_at.as_microsecond()
}

fn mark_companions(plan: &FrictionPlan, at: usize, needed: &mut [bool]) {
    for (companion, _) in &plan.maps[at].companions {
        if !std::mem::replace(&mut needed[*companion], true) {
            mark_companions(plan, *companion, needed);
        }
    }
}

impl KnownMap {
    /// The map with the positions of its tests in `found`. Its epochs have no tests there, since those are already
    /// known.
    fn planned(&self, found: &FrictionTests, places: &HashMap<i64, usize>) -> Option<PlannedMap> {
        let positions = |keys: &[i64]| -> Option<Vec<usize>> {
            keys.iter().map(|key| places.get(key).copied()).collect()
        };
        let begins_at = found.tests.first()?.moment.started_at;
        let epoch = Epoch { cause: EpochCause::FirstTest, begins_at, tests: Vec::new() };
        Some(PlannedMap {
            joints: self.joints.iter().map(|(joint, ordinal)| (*joint, *ordinal, epoch.clone())).collect(),
            baseline: positions(&self.baseline)?,
            learnt: positions(&self.learnt)?,
            motion: positions(&self.motion)?,
            companions: self.companions.clone(),
            basis: self.basis,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::indices::baseline_plan::plan;
    use crate::robot::indices::baseline_plan::tests::{daily, day};
    use armwatch_model::anomaly::epoch::Maintenance;

    const NEEDED: usize = 5;

    /// The tests of a plan and the remembered ones among all tests.
    fn few(all: &FrictionTests, known: &KnownPlan) -> FrictionTests {
        let keys = known.tests();
        let is_read =
            |test: &FrictionTest| keys.contains(&test.run_id) || start(test) >= known.remembers_from();
        FrictionTests { tests: all.tests.iter().filter(|of| is_read(of)).cloned().collect(), ..all.clone() }
    }

    fn first(all: &FrictionTests, count: usize) -> FrictionTests {
        FrictionTests { tests: all.tests[..count].to_vec(), ..all.clone() }
    }

    #[test]
    fn the_plan_of_few_tests_says_of_the_latest_what_that_of_all_says() {
        let mut all = daily((0..400).map(|at| if at % 3 == 1 { 3 } else { 24 }));
        let (a, b) = (JointIndex::new(0), JointIndex::new(1));
        let work = |key: i64, joint, at: i64| Maintenance {
            maintenance_id: key,
            joint,
            at: day(at),
            what: "grease".into(),
            who: None,
        };
        all.work = vec![work(1, Some(a), 150), work(2, None, 230)];
        all.tests[300].points = Some(vec![(b, 24)]);
        for test in &mut all.tests[350..] {
            test.moment.description = (Some(2), None);
        }
        let mut known: Option<KnownPlan> = None;
        let (mut extended, mut read, mut again) = (0, 0, Vec::new());
        for count in 12..all.tests.len() {
            let of_all = first(&all, count);
            let whole = plan(&of_all, NEEDED, 7);
            let expected = KnownPlan::of(&of_all, &whole).expect("a long history");
            if let Some(before) = known.take() {
                let few = few(&of_all, &before);
                match before.extended(&few, NEEDED, 7) {
                    Some((planned, now)) => {
                        let (own, latest) = (planned.tests.last(), whole.tests.last());
                        assert_eq!(own.map(|of| of.basis), latest.map(|of| of.basis), "{count} tests");
                        assert_eq!(now, expected, "{count} tests");
                        extended += 1;
                        read = few.tests.len();
                    }
                    None => again.push(count),
                }
            }
            known = Some(expected);
        }
        // at the first test after maintenance, at another description, and when a joint's full tests have doubled
        assert!([151, 231, 351].iter().all(|of| again.contains(of)), "{again:?}");
        assert!(extended > 360 && again.len() < 28 && read < 40 * 8, "{extended}, {read}, {again:?}");
    }
}
