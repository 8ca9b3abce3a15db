//! Data that retention keeps, and data that it deletes.

use jiff::{SignedDuration, Timestamp};

use super::factors::with_factors;
use super::support::*;
use crate::handle::Store;
use crate::results::verification::FactorsGone;
use crate::retention::{DueRun, KeptSince, MOST_REFERENCES};
use armwatch_model::analysis::work_evidence::{JointEvidence, PRODUCTS};
use armwatch_model::analysis::{
    CycleFactors, Estimator, FrictionExcess, JointCheck, ProductionCheck, Rmsd, RmsdPair,
};
use armwatch_model::run::RunKind;
use armwatch_testing::er3a;

/// All factors are due.
fn nothing_kept() -> KeptSince {
    let later = Some(Timestamp::now() + SignedDuration::from_hours(1));
    KeptSince { tests: later, production: later }
}

/// A concluded test with two cycles.
async fn test_of_day(store: &Store, robot: &str, days: i64) -> i64 {
    let run_id = open_run(store, robot, days, 2).await;
    finish(store, run_id, 2, &findings(Vec::new())).await;
    run_id
}

async fn open_run(store: &Store, robot: &str, days: i64, cycles: u32) -> i64 {
    let run_id = streaming_run(store, robot, days, 0).await;
    for number in 1..=cycles {
        assert!(store.record_cycle(run_id, &with_factors(number), &er3a()).await.expect("a cycle"));
    }
    run_id
}

/// A window that is compared with `test`.
fn check(test: i64, number: u32) -> ProductionCheck {
    let all_rows = Rmsd { value: f64::from(number), relative: 0.1, samples: 9 };
    let products = [f64::from(number); PRODUCTS];
    ProductionCheck {
        reference_run_id: test,
        estimator: Estimator::Weighted,
        joints: vec![JointCheck {
            joint: joint(1),
            rmsd: RmsdPair { all_rows, ..RmsdPair::default() },
            friction: None,
        }],
        evidence: vec![JointEvidence { joint: joint(1), windows: 1, samples: 100, products }],
    }
}

/// A concluded log with three windows that are compared with `test`.
async fn log_of_day(store: &Store, days: i64, test: i64) -> i64 {
    let run_id = streaming_run(store, "R00", days, 0).await;
    store.set_run_kind(run_id, RunKind::Production).await.expect("a kind");
    let check = |number: u32| check(test, number);
    for number in 1..=3 {
        let mut window = with_factors(number);
        window.kind = RunKind::Production;
        window.production = Some(check(number));
        assert!(store.record_cycle(run_id, &window, &er3a()).await.expect("a window"));
    }
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    end.complete(totals(3)).await.expect("completion");
    end.commit().await.expect("a commit");
    let robot = stale(store, run_id).await;
    let mut conclusion = store.conclude(robot.robot_id).await.expect("a transaction");
    conclusion
        .settle_production(run_id, &[(1, check(1)), (2, check(2)), (3, check(3))])
        .await
        .expect("settled");
    conclusion.commit(robot.history).await.expect("a commit");
    run_id
}

async fn due(store: &Store, kept: &KeptSince) -> Vec<DueRun> {
    store.due_runs(kept).await.expect("runs")
}

fn runs(due: &[DueRun]) -> Vec<i64> {
    due.iter().map(|run| run.run_id).collect()
}

async fn execute(store: &Store, statement: &'static str) {
    sqlx::query(statement).execute(&store.writer).await.expect("done");
}

#[tokio::test]
async fn factors_of_tests_have_their_time_except_what_conclusions_need() {
    let (_folder, store) = fresh_file().await;
    let mut tests = Vec::new();
    for day in 0..12 {
        tests.push(test_of_day(&store, "R00", day).await);
    }
    open_run(&store, "R01", 0, 2).await;
    // the oldest belongs to a baseline, and production is compared with the last eight
    execute(
        &store,
        "INSERT INTO friction_baseline (friction_baseline_id, robot_id, joint, epoch, cause, begins_at, basis)
         VALUES (1, 1, 1, 0, 'first_test', 0, zeroblob(32))",
    )
    .await;
    execute(&store, "INSERT INTO friction_baseline_run (friction_baseline_id, run_id) VALUES (1, 1)").await;
    let found = due(&store, &nothing_kept()).await;
    assert_eq!(runs(&found), tests[1..12 - MOST_REFERENCES]);
    // two cycles with 3, 3, 6 and 6 numbers
    assert_eq!((found[0].cycles, found[0].bytes, found[0].kind), (2, 2 * 18 * 8, RunKind::Test));
    assert!(due(&store, &KeptSince { tests: None, ..nothing_kept() }).await.is_empty(), "kept for ever");
    let young = KeptSince { tests: Some(Timestamp::now() - SignedDuration::from_hours(1)), production: None };
    assert!(due(&store, &young).await.is_empty(), "stored just now, however old the recording");

    let before = dump(&store).await;
    assert_eq!(store.remove_factors(tests[1], 1).await.expect("removed"), 1);
    assert_eq!(
        runs(&due(&store, &nothing_kept()).await),
        tests[1..12 - MOST_REFERENCES],
        "one cycle is left"
    );
    assert_eq!(store.remove_factors(tests[1], 200).await.expect("removed"), 1);
    assert_eq!(store.remove_factors(tests[1], 200).await.expect("removed"), 0);
    assert_eq!(runs(&due(&store, &nothing_kept()).await), tests[2..12 - MOST_REFERENCES]);
    assert_eq!(dump(&store).await, before, "results are kept");
    let states = store.cycle_states(tests[1]).await.expect("states");
    assert!(states.iter().all(|state| state.factors_gone == Some(FactorsGone::Removed)));
    // windows that were compared with it stay with it
    let known = store.reference_tests(1, i64::MIN, &[], 0).await.expect("tests");
    assert_eq!(known.iter().map(|test| test.run_id).collect::<Vec<_>>(), tests);
    assert_sound(&store).await;

    // runs without a conclusion are not touched
    execute(&store, "UPDATE robot SET history = history + 1").await;
    assert!(due(&store, &nothing_kept()).await.is_empty());
}

#[tokio::test]
async fn windows_are_joined_part_by_part_and_by_one_program_only() {
    let (_folder, store) = fresh_file().await;
    let test = test_of_day(&store, "R00", 0).await;
    let log = log_of_day(&store, 1, test).await;
    assert_eq!(runs(&due(&store, &nothing_kept()).await), [log]);
    let before = dump(&store).await;

    let first = store.windows_to_join(log, 2).await.expect("read").expect("windows");
    assert_eq!((first.windows(), first.factors.len()), (2, 8));
    let joined = CycleFactors { columns: first.columns.clone(), factors: first.factors[..4].to_vec() };
    assert!(store.join_windows(&first, &joined).await.expect("joined"));
    assert!(!store.join_windows(&first, &joined).await.expect("looked"), "joined before");
    let stored = store.joined_factors(log).await.expect("factors");
    assert_eq!((stored.len(), &stored[0].factors), (1, &joined));

    let rest = store.windows_to_join(log, 2).await.expect("read").expect("a window");
    assert_eq!((rest.windows(), rest.factors.len()), (1, 8), "with what was joined");
    assert!(store.join_windows(&rest, &joined).await.expect("joined"));
    assert!(store.windows_to_join(log, 2).await.expect("read").is_none());
    assert!(due(&store, &nothing_kept()).await.is_empty());
    assert_eq!(dump(&store).await, before, "results are kept");
    assert_sound(&store).await;
}

#[tokio::test]
async fn checks_of_joined_windows_outlive_a_change_of_their_test() {
    let (_folder, store) = fresh_file().await;
    let test = test_of_day(&store, "R00", 0).await;
    let log = log_of_day(&store, 1, test).await;
    let first = store.windows_to_join(log, 2).await.expect("read").expect("windows");
    let joined = CycleFactors { columns: first.columns.clone(), factors: first.factors[..4].to_vec() };
    assert!(store.join_windows(&first, &joined).await.expect("joined"));
    execute(&store, "UPDATE run SET status = 'streaming' WHERE run_id = 1").await;
    // the third window keeps its factors, and is compared with later tests
    let checked = "SELECT group_concat(cycle) FROM production_checks WHERE joint IS NOT NULL";
    assert_eq!(text(&store, checked).await.as_deref(), Some("1,2"));
}

#[tokio::test]
async fn a_joined_window_that_goes_takes_the_factor_of_its_log_along() {
    let (_folder, store) = fresh_file().await;
    let test = test_of_day(&store, "R00", 0).await;
    let log = log_of_day(&store, 1, test).await;
    let first = store.windows_to_join(log, 2).await.expect("read").expect("windows");
    let joined = CycleFactors { columns: first.columns.clone(), factors: first.factors[..4].to_vec() };
    assert!(store.join_windows(&first, &joined).await.expect("joined"));
    // the last window has its own, and the others keep theirs
    execute(&store, "DELETE FROM cycle WHERE run_id = 2 AND number = 3").await;
    assert_eq!(store.joined_factors(log).await.expect("factors").len(), 1);
    execute(&store, "DELETE FROM cycle WHERE run_id = 2 AND number = 2").await;
    assert!(store.joined_factors(log).await.expect("factors").is_empty());
    let states = store.cycle_states(log).await.expect("states");
    assert_eq!(
        states.iter().map(|state| state.factors_gone).collect::<Vec<_>>(),
        [Some(FactorsGone::Removed)]
    );
    // all at once, as when a log is read again from its start
    let again = log_of_day(&store, 2, test).await;
    let all = store.windows_to_join(again, 9).await.expect("read").expect("windows");
    assert!(store.join_windows(&all, &joined).await.expect("joined"));
    execute(&store, "DELETE FROM cycle WHERE run_id = 3").await;
    assert!(store.joined_factors(again).await.expect("factors").is_empty());
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_new_database_gives_free_pages_back() {
    let (_folder, store) = fresh_file().await;
    let tests = [test_of_day(&store, "R00", 0).await];
    let before = store.free_space().await.expect("space");
    assert!(before.can_shrink && before.free_pages < 4, "{before:?}");
    execute(&store, "CREATE TABLE filler AS SELECT zeroblob(1000000) AS filler").await;
    execute(&store, "DROP TABLE filler").await;
    let emptied = store.free_space().await.expect("space");
    assert!(emptied.bytes() >= 1_000_000, "{emptied:?}");
    store.give_back(100).await.expect("given back");
    let some = store.free_space().await.expect("space");
    assert_eq!((emptied.free_pages - some.free_pages, emptied.pages - some.pages), (100, 100));
    store.give_back(100_000).await.expect("given back");
    assert_eq!(store.free_space().await.expect("space").free_pages, 0);
    assert_eq!(store.cycle_states(tests[0]).await.expect("states").len(), 2);
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_log_that_ends_again_without_a_new_window_has_its_summary_again() {
    let (_folder, store) = fresh_file().await;
    let test = test_of_day(&store, "R00", 0).await;
    log_of_day(&store, 1, test).await;
    execute(
        &store,
        "UPDATE production_check
         SET moving_rmsd_nm = 1, moving_relative_rmsd = 0.1, moving_samples = 9, friction_excess = 0.1, friction_share = 0.5",
    )
    .await;
    let summaries = "SELECT count(*) FROM production_summary WHERE windows = 3";
    for _ in 0..2 {
        execute(&store, "UPDATE run SET status = 'streaming' WHERE kind = 'production'").await;
        execute(&store, "UPDATE run SET status = 'complete' WHERE kind = 'production'").await;
        assert_eq!(number(&store, summaries).await, Some(0.0));
        let mut conclusion = store.conclude(1).await.expect("a transaction");
        conclusion.summarise_settled_logs().await.expect("summaries");
        conclusion.commit(0).await.expect("a commit");
        assert_eq!(number(&store, summaries).await, Some(1.0));
    }
}

#[tokio::test]
async fn a_window_at_rest_leaves_a_log_the_evidence_of_its_other_windows() {
    let (_folder, store) = fresh_file().await;
    let test = test_of_day(&store, "R00", 0).await;
    let log = log_of_day(&store, 1, test).await;
    let moving = |number: u32| {
        let mut check = check(test, number);
        check.joints[0].rmsd.moving_rows = check.joints[0].rmsd.all_rows;
        check.joints[0].friction = Some(FrictionExcess { excess: 0.1, share: 0.5 });
        check
    };
    let at_rest = ProductionCheck { evidence: Vec::new(), ..check(test, 2) };
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    conclusion
        .settle_production(log, &[(1, moving(1)), (2, at_rest), (3, moving(3))])
        .await
        .expect("settled");
    conclusion.commit_figures().await.expect("a commit");
    let summaries = store.log_window(&[log]).await.expect("summaries");
    let [of] = &summaries[..] else { panic!("one test: {summaries:?}") };
    let [evidence] = &of.evidence[..] else { panic!("one joint: {of:?}") };
    assert_eq!((evidence.windows, evidence.samples, evidence.products), (2, 200, [2.0; PRODUCTS]));
}
