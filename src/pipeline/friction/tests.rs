//! Baselines and indices of whole histories, through the store.

use std::collections::BTreeMap;

use jiff::{SignedDuration, Timestamp};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::pipeline::conclude::test_database::assert_summaries_hold;
use crate::pipeline::context::Pipeline;
use armwatch_config::Config;
use armwatch_model::analysis::{
    CycleAnalysis, CycleFactors, CycleTemperatures, Estimator, FrictionPoint, GravityRemoval, JointSummary,
    RunAnalysis,
};
use armwatch_model::anomaly::Severity;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{ContentHash, RunHeader, RunKind};
use armwatch_store::{NewMaintenance, RunTotals, Store};
use armwatch_testing::er3a;

const ROBOT: &str = "Left";
const JOINTS: usize = 3;
/// The joint that wears.
const WORN: usize = 2;
const CYCLE_S: f64 = 300.0;
const LEVELS: [f64; 3] = [0.2, 0.6, 1.0];
/// Deviation of an index from its true value that is accepted: three standard errors of a test of three cycles. The
/// wear to be detected is 0.1.
const TOLERANCE: f64 = 0.025;

/// A test on a day: its cycles, and the friction of the worn joint as a multiple of its initial friction.
#[derive(Clone, Copy)]
struct DatedTest {
    day: i64,
    cycles: u32,
    factor: f64,
}

struct WornFleet {
    _folder: tempfile::TempDir,
    pipeline: Pipeline,
    robot: Robot,
}

fn at(day: i64) -> Timestamp {
    let first: Timestamp = "2026-01-05T06:00:00Z".parse().expect("a time");
    first + SignedDuration::from_hours(24 * day)
}

/// Plateaus of a cycle of a joint that warms with a time constant of half an hour, with scatter of half a percent.
fn points(test: DatedTest, cycle: u32) -> Vec<FrictionPoint> {
    let mut rng = ChaCha8Rng::seed_from_u64(1000 * test.day as u64 + u64::from(cycle));
    let mut found = Vec::new();
    for joint in 0..JOINTS {
        for (level, speed_fraction) in LEVELS.into_iter().enumerate() {
            for direction in [1_i8, -1] {
                let time = CYCLE_S * f64::from(cycle - 1) + 40.0 + 8.0 * found.len() as f64;
                let cold = (4.0 + 2.0 * level as f64) * (-time / 1800.0).exp();
                let worn = if joint == WORN { test.factor } else { 1.0 };
                let scatter = 1.0 + 0.005 * rng.sample::<f64, _>(StandardNormal);
                let torque = (10.0 + 5.0 * level as f64 + cold) * worn * scatter;
                found.push(FrictionPoint {
                    joint: JointIndex::new(joint),
                    time,
                    speed_fraction,
                    speed: 4.0 * speed_fraction,
                    direction,
                    torque: f64::from(direction) * torque,
                    std: 0.1,
                    samples: 100,
                    gravity: GravityRemoval::AxisVertical,
                    load: None,
                });
            }
        }
    }
    found
}

/// A cycle with friction and without parameters.
fn cycle(test: DatedTest, number: u32) -> CycleAnalysis {
    CycleAnalysis {
        cycle: number,
        start: CYCLE_S * f64::from(number - 1),
        duration: CYCLE_S,
        rows: 3000,
        sample_rate: 10.0,
        mean_speeds: vec![0.5; JOINTS],
        temperatures: CycleTemperatures::default(),
        cutoff: 2.0,
        estimator: Estimator::Weighted,
        identification: Err("the arm does not move in the excitation".into()),
        refusal_causes: Vec::new(),
        verification: Vec::new(),
        warming_contrast: Vec::new(),
        torque_noise: Vec::new(),
        friction_points: points(test, number),
        factors: CycleFactors::default(),
        response: None,
        kind: RunKind::Test,
        production: None,
        remarks: Vec::new(),
        findings: Vec::new(),
    }
}

impl WornFleet {
    async fn new(baseline_runs: usize) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("fleet.db")).await.expect("a store");
        let mut config = Config::shipped().expect("shipped settings");
        config.detect.baseline_runs = baseline_runs;
        Self { _folder: folder, pipeline: Pipeline::new(std::sync::Arc::new(config), store), robot: er3a() }
    }

    fn store(&self) -> &Store {
        self.pipeline.store()
    }

    async fn store_test(&self, test: DatedTest) {
        let name = format!("{ROBOT}_{}.csv", test.day);
        let header = RunHeader {
            robot: ROBOT.into(),
            model: "er3a".into(),
            started_at: at(test.day),
            source_path: format!("/exports/{name}"),
            content_hash: ContentHash(std::array::from_fn(|byte| (test.day >> (8 * (byte % 8))) as u8)),
            source_bytes: 1,
            source_name: name,
        };
        let run_id = self.store().begin_run(&header).await.expect("a run").run_id;
        for number in 1..=test.cycles {
            self.store().record_cycle(run_id, &cycle(test, number), &self.robot).await.expect("a cycle");
        }
        let summary = |joint| JointSummary {
            joint: JointIndex::new(joint),
            warm_friction: None,
            excitation_friction: None,
            half_speed_friction: None,
            friction_index: None,
            relative_rmsd: None,
            rmsd_swing: None,
            relative_noise: None,
            torque_rms: None,
        };
        let summaries = (0..JOINTS).map(summary).collect();
        let mut end = self.store().finish_run(run_id).await.expect("a transaction");
        end.store_analysis(&RunAnalysis { summaries, ..RunAnalysis::default() }).await.expect("an analysis");
        let totals = RunTotals {
            rows: 3000 * test.cycles as usize,
            rows_skipped: 0,
            sample_rate: 10.0,
            cycles: test.cycles,
        };
        end.complete(totals).await.expect("completion");
        end.commit().await.expect("a commit");
    }

    async fn conclude(&self) {
        self.pipeline.conclude_named(ROBOT).await.expect("conclusions");
        assert_summaries_hold(self.store()).await;
    }

    /// Indices of a joint by day.
    async fn indices(&self, joint: usize) -> BTreeMap<i64, f64> {
        let rows = self.store().friction_indices(ROBOT).await.expect("indices");
        let of_joint = rows.into_iter().filter(|row| row.joint.index() == joint);
        of_joint.map(|row| (row.started_at.duration_since(at(0)).as_hours() / 24, row.index.value)).collect()
    }

    /// Kind, joint and days of the first and the latest test of each warning.
    async fn alarms(&self) -> Vec<(String, Option<usize>, i64, i64)> {
        let rows = self.store().anomalies_after(0).await.expect("anomalies");
        let day = |of: Timestamp| of.duration_since(at(0)).as_hours() / 24;
        let warnings = rows.into_iter().filter(|row| row.severity >= Severity::Warning);
        warnings
            .map(|row| {
                let joint = row.joint.map(|joint| joint.index());
                (row.kind.to_string(), joint, day(row.first_seen_at), day(row.last_seen_at))
            })
            .collect()
    }

    /// Days of the baselines of a joint by epoch, with the cause of each.
    async fn baselines(&self, joint: usize) -> Vec<(String, Vec<i64>)> {
        let rows = self.store().baselines(ROBOT).await.expect("baselines");
        let of_joint = rows.into_iter().filter(|row| row.joint.index() == joint);
        of_joint
            .map(|row| {
                let days = row.tests.iter().map(|start| start.duration_since(at(0)).as_hours() / 24);
                (row.cause, days.collect())
            })
            .collect()
    }

    async fn repair(&self, joint: usize, day: i64) -> i64 {
        let new = NewMaintenance {
            robot: ROBOT.into(),
            joint: Some(JointIndex::new(joint)),
            at: at(day) - SignedDuration::from_hours(1),
            what: "gearbox changed".into(),
            who: None,
        };
        self.store().enter_maintenance(&new).await.expect("an entry").expect("the robot is known")
    }
}

/// 12 short trial runs, then a short check per day and a full test per week.
fn year(days: i64, factor: impl Fn(i64) -> f64) -> Vec<DatedTest> {
    let cycles = |day: i64| match day {
        0..12 => 2,
        _ if day % 7 == 0 => 8,
        _ => 3,
    };
    (0..days).map(|day| DatedTest { day, cycles: cycles(day), factor: factor(day) }).collect()
}

/// A year: wear of 10 % until a repair on day 211. The new gearbox has a fifth less friction. A corrected torque
/// constant from day 287 on increases all torques by a tenth.
#[tokio::test]
async fn a_year_of_short_checks_and_full_tests_has_baselines_that_stay() {
    const REPAIR: i64 = 211;
    const CORRECTION: i64 = 287;
    let factor = |day: i64| match day {
        ..REPAIR => 1.0 + 0.1 * day as f64 / REPAIR as f64,
        REPAIR..CORRECTION => 0.8,
        _ => 0.88,
    };
    let mut fleet = WornFleet::new(5).await;
    let tests = year(365, factor);
    for test in &tests[..100] {
        fleet.store_test(*test).await;
    }
    fleet.conclude().await;
    let early = fleet.indices(WORN).await;
    let first = ("first_test".to_owned(), vec![14, 21, 28, 35, 42]);
    assert_eq!(fleet.baselines(WORN).await, std::slice::from_ref(&first));
    for test in &tests[100..REPAIR as usize] {
        fleet.store_test(*test).await;
    }
    fleet.conclude().await;
    let worn = fleet.indices(WORN).await;
    assert!(early.iter().all(|(day, index)| worn[day] == *index), "later tests move no index");
    // the baseline itself is worn by 1.3 %
    let baseline = (14..=42).step_by(7).map(factor).sum::<f64>() / 5.0;
    for day in REPAIR - 10..REPAIR {
        let due = factor(day) / baseline;
        assert!((worn[&day] - due).abs() < TOLERANCE, "day {day}: {} instead of {due}", worn[&day]);
    }
    let found = fleet.alarms().await;
    let is_wear = |(kind, joint, first, last): &(String, Option<usize>, i64, i64)| {
        // at most 8 % and still there
        kind == "drift" && *joint == Some(WORN) && (42..170).contains(first) && *last == REPAIR - 1
    };
    assert!(found.len() == 1 && is_wear(&found[0]), "{found:?}");
    fleet.repair(WORN, REPAIR).await;
    fleet.conclude().await;
    assert_eq!(fleet.indices(WORN).await, worn, "a repair changes nothing before it");
    for test in &tests[REPAIR as usize..CORRECTION as usize] {
        fleet.store_test(*test).await;
    }
    fleet.conclude().await;
    let repaired = ("maintenance".to_owned(), vec![217, 224, 231, 238, 245]);
    assert_eq!(fleet.baselines(WORN).await, [first.clone(), repaired.clone()]);
    let after = fleet.indices(WORN).await;
    for day in REPAIR..CORRECTION {
        assert!((after[&day] - 1.0).abs() < TOLERANCE, "day {day}: {}", after[&day]);
    }
    for joint in (0..JOINTS).filter(|joint| *joint != WORN) {
        assert_eq!(fleet.baselines(joint).await, std::slice::from_ref(&first));
        let found = fleet.indices(joint).await;
        assert_eq!(found.len(), CORRECTION as usize, "every test of two cycles or more has an index");
        assert!(found.values().all(|index| (index - 1.0).abs() < TOLERANCE), "joint {joint}: {found:?}");
    }
    fleet.robot.joints[0].gear_ratio *= 1.1;
    for test in &tests[CORRECTION as usize..] {
        fleet.store_test(*test).await;
    }
    fleet.conclude().await;
    let corrected = ("description".to_owned(), vec![287, 294, 301, 308, 315]);
    assert_eq!(fleet.baselines(WORN).await, [first.clone(), repaired, corrected.clone()]);
    assert_eq!(fleet.baselines(0).await, [first, corrected]);
    let last = fleet.indices(WORN).await;
    for day in CORRECTION..365 {
        assert!((last[&day] - 1.0).abs() < TOLERANCE, "day {day}: {}", last[&day]);
    }
    assert!(after.iter().all(|(day, index)| last[day] == *index), "a correction changes nothing before it");
    assert_eq!(fleet.alarms().await, found, "no alarm after the repair and the corrected description");
    // the only robot of the database
    let robot_id = 1;
    let summaries = fleet.store().run_summaries(robot_id).await.expect("summaries");
    let epochs: Vec<Vec<u32>> = summaries.into_iter().map(|run| run.epochs).collect();
    assert_eq!(
        [0, 210, 211, 286, 287, 364].map(|day| &epochs[day][..]),
        [[0, 0, 0], [0, 0, 0], [0, 0, 1], [0, 0, 1], [1, 1, 2], [1, 1, 2]]
    );
}

#[tokio::test]
async fn the_order_of_arrival_and_of_conclusions_moves_no_index() {
    let tests: Vec<DatedTest> = year(70, |day| 1.0 + 0.001 * day as f64)
        .into_iter()
        .filter(|test| test.day % 3 != 1 || test.cycles == 8)
        .collect();
    let in_order = WornFleet::new(3).await;
    for (count, test) in tests.iter().enumerate() {
        in_order.store_test(*test).await;
        if count % 12 == 0 {
            in_order.conclude().await;
        }
    }
    in_order.repair(WORN, 45).await;
    in_order.conclude().await;
    let shuffled = WornFleet::new(3).await;
    for (count, place) in (0..tests.len()).map(|k| (k * 17 + 5) % tests.len()).enumerate() {
        shuffled.store_test(tests[place]).await;
        if count == 20 {
            shuffled.repair(WORN, 45).await;
        }
        if count % 9 == 0 {
            shuffled.conclude().await;
        }
    }
    shuffled.conclude().await;
    for joint in 0..JOINTS {
        let found = in_order.indices(joint).await;
        assert!(found.len() > 30, "{found:?}");
        assert_eq!(shuffled.indices(joint).await, found);
        assert_eq!(shuffled.baselines(joint).await, in_order.baselines(joint).await);
    }
}

#[tokio::test]
async fn a_late_test_inside_a_baseline_forms_it_anew_and_the_audit_says_so() {
    let fleet = WornFleet::new(3).await;
    let full = |day| DatedTest { day, cycles: 8, factor: 1.0 };
    for day in [0, 1, 3, 4, 5] {
        fleet.store_test(full(day)).await;
    }
    fleet.conclude().await;
    assert_eq!(fleet.baselines(0).await, [("first_test".to_owned(), vec![0, 1, 3])]);
    fleet.store_test(full(2)).await;
    fleet.conclude().await;
    assert_eq!(fleet.baselines(0).await, [("first_test".to_owned(), vec![0, 1, 2])]);
    let changes = fleet.store().baseline_changes(ROBOT).await.expect("changes");
    let of_joint: Vec<Option<String>> =
        changes.into_iter().filter(|row| row.joint.index() == 0).map(|row| row.replaced_because).collect();
    assert_eq!(of_joint, [Some("run 6 arrived later but was recorded before its last one".to_owned()), None]);
    // an entry that was wrong is taken back, and all is as before
    let before = fleet.indices(0).await;
    let entry = fleet.repair(0, 3).await;
    fleet.conclude().await;
    assert_eq!(fleet.baselines(0).await.len(), 2);
    assert_ne!(fleet.indices(0).await, before);
    let removed = fleet.store().remove_maintenance(entry).await.expect("an answer").expect("the entry");
    assert_eq!((removed.robot.as_str(), removed.work.maintenance_id), (ROBOT, entry));
    fleet.conclude().await;
    assert_eq!(fleet.indices(0).await, before);
}

#[tokio::test]
async fn epochs_are_counted_anew_where_an_entry_before_them_goes() {
    let fleet = WornFleet::new(2).await;
    for day in 0..12 {
        fleet.store_test(DatedTest { day, cycles: 8, factor: 1.0 }).await;
    }
    let mut entries = Vec::new();
    for day in [3, 6, 9] {
        entries.push(fleet.repair(0, day).await);
    }
    fleet.conclude().await;
    let days = |found: Vec<(String, Vec<i64>)>| found.into_iter().map(|(_, days)| days).collect::<Vec<_>>();
    assert_eq!(days(fleet.baselines(0).await), [[0, 1], [3, 4], [6, 7], [9, 10]]);
    fleet.store().remove_maintenance(entries[0]).await.expect("an answer");
    fleet.conclude().await;
    assert_eq!(days(fleet.baselines(0).await), [[0, 1], [6, 7], [9, 10]]);
}
