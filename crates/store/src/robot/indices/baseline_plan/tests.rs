use std::collections::HashMap;

use jiff::{SignedDuration, Timestamp};

use super::*;
use armwatch_model::anomaly::epoch::{Maintenance, TestMoment};

/// A name, cycles of each test, size of the baseline, and the expected tests of the baseline.
type History<'a> = (&'a str, &'a dyn Fn(usize) -> usize, usize, Vec<i64>);

const JOINTS: usize = 3;
const NEEDED: usize = 5;
const SHORT: usize = 3;
const FULL: usize = 24;

fn joint(index: usize) -> JointIndex {
    JointIndex::new(index)
}

pub(super) fn day(days: i64) -> Timestamp {
    let first: Timestamp = "2026-01-05T06:00:00Z".parse().expect("a time");
    first + SignedDuration::from_hours(24 * days)
}

/// One test per day with this number of friction points in every joint.
pub(super) fn daily(points: impl IntoIterator<Item = usize>) -> FrictionTests {
    let test = |(at, points): (i64, usize)| FrictionTest {
        run_id: at + 1,
        moment: TestMoment { started_at: day(at), description: (Some(1), None) },
        points: Some((0..JOINTS).map(|j| (joint(j), points)).collect()),
        basis: None,
    };
    FrictionTests { tests: (0..).zip(points).map(test).collect(), ..FrictionTests::default() }
}

/// Runs of the baseline of a joint by ordinal of its epoch.
fn baselines(found: &FrictionTests, needed: usize, of: JointIndex) -> Vec<(u32, Vec<i64>)> {
    let plan = plan(found, needed, 7);
    let first = plan.maps.iter().filter(|map| map.is_first());
    let mut all: Vec<(u32, Vec<i64>)> = first
        .flat_map(|map| {
            let run_ids: Vec<i64> = map.baseline.iter().map(|test| found.tests[*test].run_id).collect();
            map.joints
                .iter()
                .filter(|(j, ..)| *j == of)
                .map(move |(_, ordinal, _)| (*ordinal, run_ids.clone()))
        })
        .collect();
    all.sort();
    all
}

/// The basis of each run's indices.
fn bases(found: &FrictionTests) -> HashMap<i64, Option<IndexBasis>> {
    let plan = plan(found, NEEDED, 7);
    found.tests.iter().zip(plan.tests).map(|(test, planned)| (test.run_id, planned.basis)).collect()
}

/// Runs of the baseline in histories with mostly short tests, and in long ones: the same after 37 as after 336 tests.
#[test]
fn the_baseline_is_the_first_full_tests_however_many_short_ones_stand_between() {
    let trial = |at: usize| if at < 12 { SHORT } else { FULL };
    let each = |n: usize| move |at: usize| if (at + 1).is_multiple_of(n) { FULL } else { SHORT };
    let numbers = |runs: std::ops::RangeInclusive<i64>| runs.collect::<Vec<i64>>();
    let weekly = vec![7, 14, 21, 28, 35];
    let tenth = vec![10, 20, 30, 40, 50];
    let histories: [History<'_>; 5] = [
        ("12 short trial runs first", &trial, 5, numbers(13..=17)),
        ("a full test each 7th", &each(7), 5, weekly),
        ("a full test each 10th", &each(10), 5, tenth),
        ("a baseline of 20", &|_| FULL, 20, numbers(1..=20)),
        ("a baseline of 40", &|_| FULL, 40, numbers(1..=40)),
    ];
    for (what, points, needed, expected) in histories {
        for length in [37, 200, 336] {
            let found = baselines(&daily((0..length).map(points)), needed, joint(0));
            let complete = length as i64 >= expected[expected.len() - 1];
            let due = if complete { vec![(0, expected.clone())] } else { Vec::new() };
            assert_eq!(found, due, "{what}, {length} tests");
        }
    }
}

#[test]
fn later_tests_move_no_index_of_earlier_ones() {
    let points = |at: usize| if at.is_multiple_of(4) { FULL } else { SHORT };
    let before = bases(&daily((0..100).map(points)));
    let after = bases(&daily((0..336).map(points)));
    assert!(before.values().all(Option::is_some));
    for (run, basis) in &before {
        assert_eq!(after[run], *basis, "run {run}");
    }
}

#[test]
fn every_test_is_compared_by_the_map_that_is_held_when_it_comes() {
    let found = daily([FULL; 100]);
    let plan = plan(&found, NEEDED, 7);
    let learnt: Vec<usize> = plan.maps.iter().map(|map| map.learnt.len()).collect();
    // 36 tests of the first 40 and of the first 80
    assert_eq!(learnt, [5, 10, 20, 36, 36]);
    for map in &plan.maps {
        assert_eq!(map.baseline, [0, 1, 2, 3, 4]);
        assert!(map.learnt.windows(2).all(|pair| pair[0] < pair[1]), "{:?}", map.learnt);
    }
    assert_eq!(plan.maps[4].learnt.last(), Some(&79));
    let held = |test: usize| plan.tests[test].references[0].0;
    assert_eq!([0, 4, 8, 9, 18, 19, 39, 78, 79, 99].map(held), [0, 0, 0, 1, 1, 2, 3, 3, 4, 4]);
    let own = |test: usize| plan.tests[test].references[0].2;
    assert_eq!([0, 4, 5, 99].map(own), [true, true, false, false]);
}

#[test]
fn a_late_test_inside_the_baseline_forms_it_anew_and_one_behind_it_changes_what_its_motion_reaches() {
    let all = daily([FULL; 40]);
    let without = |gone: i64| {
        let mut found = all.clone();
        found.tests.retain(|test| test.run_id != gone);
        found
    };
    assert_eq!(baselines(&without(3), NEEDED, joint(0)), [(0, vec![1, 2, 4, 5, 6])]);
    assert_eq!(baselines(&all, NEEDED, joint(0)), [(0, vec![1, 2, 3, 4, 5])]);
    let (before, after) = (bases(&without(3)), bases(&all));
    assert!(before.iter().all(|(run, basis)| after[run] != *basis), "all indices stand on the baseline");
    let short = |at: usize| if at == 36 { SHORT } else { FULL };
    let all = daily((0..40).map(short));
    let mut late = all.clone();
    late.tests.retain(|test| test.run_id != 37);
    let (before, after) = (bases(&late), bases(&all));
    let mut moved: Vec<i64> =
        before.iter().filter(|(run, basis)| after[run] != **basis).map(|(run, _)| *run).collect();
    moved.sort_unstable();
    assert_eq!(moved, [38, 39, 40], "the motion of a test lasts a week");
}

#[test]
fn work_on_a_joint_gives_it_a_baseline_with_the_others_as_companions() {
    let mut found = daily([FULL; 30]);
    found.work = vec![Maintenance {
        maintenance_id: 1,
        joint: Some(joint(1)),
        at: day(12),
        what: "gearbox changed".into(),
        who: None,
    }];
    let first = (0, vec![1, 2, 3, 4, 5]);
    assert_eq!(baselines(&found, NEEDED, joint(1)), [first.clone(), (1, vec![13, 14, 15, 16, 17])]);
    assert_eq!(baselines(&found, NEEDED, joint(0)), [first]);
    let plan = plan(&found, NEEDED, 7);
    let new = plan.maps.iter().find(|map| map.baseline[0] == 12 && map.is_first()).expect("a map");
    let helped: Vec<JointIndex> = new.companions.iter().map(|(_, joint)| *joint).collect();
    assert_eq!(helped, [joint(0), joint(2)]);
    let before = bases(&daily([FULL; 30]));
    let after = bases(&found);
    assert!((1..=9).all(|run| before[&run] == after[&run]), "work changes no index before it");
}

#[test]
fn tests_right_after_work_have_no_reference_of_that_joint_until_its_baseline_is_complete() {
    let mut found = daily([FULL; 15]);
    found.work = vec![Maintenance {
        maintenance_id: 1,
        joint: Some(joint(1)),
        at: day(12),
        what: "new grease".into(),
        who: None,
    }];
    let of = |found: &FrictionTests, test: usize| {
        plan(found, NEEDED, 7).tests[test].references.iter().map(|(_, joint, _)| *joint).collect::<Vec<_>>()
    };
    assert_eq!(of(&found, 11), [joint(0), joint(1), joint(2)]);
    assert_eq!(of(&found, 13), [joint(0), joint(2)]);
}

#[test]
fn a_joint_without_points_in_a_test_has_a_baseline_of_its_own() {
    let mut found = daily([FULL; 12]);
    found.tests[2].points = Some(vec![(joint(0), FULL), (joint(1), FULL), (joint(2), SHORT)]);
    assert_eq!(baselines(&found, NEEDED, joint(0)), [(0, vec![1, 2, 3, 4, 5])]);
    assert_eq!(baselines(&found, NEEDED, joint(2)), [(0, vec![1, 2, 4, 5, 6])]);
}

#[test]
fn a_changed_description_begins_anew() {
    let mut found = daily([FULL; 20]);
    for test in &mut found.tests[11..] {
        test.moment.description = (Some(1), Some(vec![1; 32]));
    }
    let expected = [(0, vec![1, 2, 3, 4, 5]), (1, vec![12, 13, 14, 15, 16])];
    assert_eq!(baselines(&found, NEEDED, joint(0)), expected);
}
