//! Stored values of a test equal those of the tables.

use std::path::Path;

use super::support::*;
use crate::handle::Store;
use crate::robot::indices::baselines::{FrictionConclusion, NewIndices};
use armwatch_model::analysis::Estimate;
use armwatch_model::analysis::friction::FrictionIndex;
use armwatch_model::anomaly::settled::Settled;
use armwatch_model::run::RunKind;

const METHOD: u64 = 7;

/// The tests of the first robot from the tables; a window of stored summaries must give the same.
async fn summaries(store: &Store) -> String {
    let of_tables = format!("{:?}", store.run_summaries(1).await.expect("summaries"));
    assert_eq!(format!("{:?}", store.latest_window(1, METHOD).await.expect("a window")), of_tables);
    of_tables
}

async fn change(store: &Store, statement: &'static str) -> u64 {
    sqlx::query(statement).execute(&store.writer).await.expect("a change").rows_affected()
}

/// Number of valid summaries.
async fn held(store: &Store) -> i64 {
    let count = sqlx::query_scalar(
        "SELECT count(*) FROM run_summary JOIN run USING (run_id)
         WHERE run_summary.revision = run.revision AND status = 'complete'",
    );
    count.fetch_one(&store.readers).await.expect("a count")
}

/// Stores the summaries of all complete tests of the first robot.
async fn summarise(store: &Store) {
    let keys =
        store.window_keys(1, RunKind::Test, &Settled::default(), usize::MAX).await.expect("keys").concat();
    store.summarise_tests(&keys, METHOD).await.expect("summaries");
}

#[tokio::test]
async fn summaries_are_those_of_the_tables_whatever_changes() {
    let (_folder, store) = fresh_file().await;
    for day in 0..3 {
        let run_id = streaming_run(&store, "R00", day, 2).await;
        finish(&store, run_id, 2, &findings(vec![])).await;
        assert_eq!(run_id, day + 1);
    }
    summarise(&store).await;
    assert_eq!(held(&store).await, 3);
    assert!(summaries(&store).await.contains("cycle_friction: [CycleSeries"));

    // rows of a cycle change together with it, as the program writes them; each statement concerns one run
    let changes = [
        "UPDATE torque_rmsd SET moving_relative_rmsd = 0.5 WHERE stage = 'all' AND cycle_id = 3 AND joint = 1;
         UPDATE cycle SET estimator = estimator WHERE cycle_id = 3",
        "UPDATE cycle_friction_level SET ln_torque = 0.25 WHERE cycle_id = 3 AND joint = 1;
         UPDATE cycle SET status = status WHERE cycle_id = 3",
        "UPDATE run_joint_summary SET relative_rmsd = 0.9 WHERE run_id = 2 AND joint = 1",
        "UPDATE run_joint_summary SET estimator = 'ordinary' WHERE run_id = 2 AND joint = 2",
        "UPDATE cycle SET doubtful = TRUE WHERE cycle_id = 3",
        "DELETE FROM cycle WHERE cycle_id = 4; UPDATE run SET cycles_stored = 1, cycles_total = 1 WHERE run_id = 2",
        "UPDATE run SET status = 'streaming' WHERE run_id = 2",
        "DELETE FROM run WHERE run_id = 3",
    ];
    for statement in changes {
        summarise(&store).await;
        let (before, complete) = (summaries(&store).await, held(&store).await);
        assert!(change(&store, statement).await > 0, "{statement}");
        assert_eq!(held(&store).await, complete - 1, "{statement}");
        assert_ne!(summaries(&store).await, before, "{statement} changes nothing");
    }
    // a summary by another method, or an unreadable one, is ignored
    for statement in
        ["UPDATE run_summary SET method = 8", "UPDATE run_summary SET method = 7, numbers = x'01'"]
    {
        change(&store, statement).await;
        summaries(&store).await;
    }
}

#[tokio::test]
async fn a_synthetic_history_is_read_as_one_that_was_recorded() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 2, runs: 3, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let runs = store.run_summaries(2).await.expect("summaries");
    assert_eq!(runs.len(), 3);
    assert!(runs.iter().all(|run| run.joints.len() == 6 && run.cycles == 2 && run.parameters.len() == 24));
    assert!(runs.iter().all(|run| run.cycle_friction.len() == 12 && run.whole_cycle_rmsd.len() == 12));
    assert!(store.fill_synthetic(size, Path::new("/inbox")).await.is_err(), "there are runs");
    assert_sound(&store).await;
}

#[tokio::test]
async fn the_program_counts_a_revision_with_whatever_it_writes() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let revision = async || {
        let of = sqlx::query_scalar("SELECT revision FROM run WHERE run_id = $1").bind(run_id);
        of.fetch_one(&store.readers).await.expect("a revision")
    };
    let mut last: i64 = revision().await;
    assert_eq!(last, 2, "one with each cycle");
    finish(&store, run_id, 2, &findings(vec![])).await;
    assert!(revision().await > last, "its end");
    for indices in [1, 0] {
        last = revision().await;
        let index = FrictionIndex {
            joint: joint(2),
            index: Estimate { value: 1.03, std_error: 0.004 },
            raw: 1.2,
            ambient: Estimate { value: 0.1, std_error: 0.02 },
            coldness_at_start: 0.9,
            points: 12,
            short: true,
        };
        let indices = NewIndices { run_id, points: Vec::new(), basis: None, indices: vec![index; indices] };
        let found = FrictionConclusion {
            run_ids: vec![run_id],
            indices: vec![indices],
            ..FrictionConclusion::default()
        };
        let mut conclusion = store.conclude(1).await.expect("a transaction");
        conclusion.replace_friction(&found).await.expect("indices");
        conclusion.commit_figures().await.expect("a commit");
        assert!(revision().await > last, "indices, or none any more");
    }
    // the past of the robot is unchanged: its only test was the latest
    let past = || sqlx::query_scalar::<_, i64>("SELECT past_revision FROM robot").fetch_one(&store.readers);
    assert_eq!(past().await.expect("a revision"), 0);
    for (days, expected) in [(2, 0), (1, 1)] {
        let run_id = streaming_run(&store, "R00", days, 1).await;
        finish(&store, run_id, 1, &findings(vec![])).await;
        assert_eq!(past().await.expect("a revision"), expected);
    }
}

/// Friction points used by fits over tests, and the number of tests that have them in one row.
async fn over_tests(store: &Store) -> (String, usize) {
    let read = store.friction_history(1, 0.6, METHOD).await.expect("points");
    // by test, since tests of a synthetic history have equal points
    let points: Vec<_> = read.tests.iter().map(|test| (test.run_id, &test.points)).collect();
    (format!("{points:?}"), read.tests.iter().filter(|test| test.is_stored).count())
}

async fn keep_friction_points(store: &Store) {
    let read = store.friction_history(1, 0.6, METHOD).await.expect("points");
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    conclusion.keep_friction_points(&read, METHOD).await.expect("kept");
    conclusion.commit(history).await.expect("a commit");
}

#[tokio::test]
async fn friction_points_over_tests_are_those_of_the_tables_whatever_changes() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 40, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let changes = [
        "UPDATE friction_point SET torque_nm = 7 WHERE cycle_id = 3 AND joint = 1;
         UPDATE cycle SET estimator = estimator WHERE cycle_id = 3",
        "UPDATE cycle SET doubtful = TRUE WHERE cycle_id = 3",
        "UPDATE cycle SET status = 'refused', doubtful = FALSE, reason = 'stuck' WHERE cycle_id = 3",
        "INSERT INTO cycle_refusal VALUES (3, 1, 'stuck_channel', 'torque', 1, 'it is stuck');
         UPDATE cycle SET status = status WHERE cycle_id = 3",
        "DELETE FROM cycle WHERE cycle_id = 4; UPDATE run SET cycles_stored = 1, cycles_total = 1 WHERE run_id = 2",
        "UPDATE run SET status = 'streaming' WHERE run_id = 2",
        "DELETE FROM run WHERE run_id = 3",
    ];
    for statement in changes {
        keep_friction_points(&store).await;
        let (before, stored) = over_tests(&store).await;
        // the first dozen and the latest two dozen
        assert_eq!(stored, 36, "{statement}");
        assert!(change(&store, statement).await > 0, "{statement}");
        let (read, stored) = over_tests(&store).await;
        assert_eq!(stored, 35, "{statement}");
        change(&store, "DELETE FROM run_friction_series").await;
        assert_eq!(over_tests(&store).await, (read.clone(), 0), "{statement}");
        assert_ne!(read, before, "{statement} changes nothing");
    }
    // at another level, and with other tests, others are stored
    keep_friction_points(&store).await;
    let read = store.friction_history(1, 1.0, METHOD).await.expect("points");
    assert!(read.tests.iter().all(|test| !test.is_stored));
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    conclusion.keep_friction_points(&read, METHOD).await.expect("kept");
    conclusion.commit(history).await.expect("a commit");
    assert_eq!(over_tests(&store).await.1, 0);
    assert_eq!(change(&store, "DELETE FROM run_friction_series").await, 36);
    assert_sound(&store).await;
}

#[tokio::test]
async fn the_parameters_of_one_cycle_have_its_standard_error() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 1, cycles: 1, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    change(&store, "UPDATE parameter_statistic SET sdv = NULL, cycles = 1").await;
    change(&store, "UPDATE cycle_parameter SET std_error = 0.5 + model_parameter_id").await;
    let read = |run: &armwatch_model::anomaly::RunSummary| -> Vec<f64> {
        let mut found: Vec<f64> = run.parameters.iter().map(|of| of.std_dev - 0.5).collect();
        found.sort_by(f64::total_cmp);
        found
    };
    let runs = store.run_summaries(1).await.expect("summaries");
    let found = read(&runs[0]);
    assert!(found.len() == 24 && found.iter().all(|key| *key >= 1.0 && key.fract() == 0.0), "{found:?}");
    // a cycle that does not count has no effect
    change(&store, "UPDATE cycle SET doubtful = TRUE").await;
    let runs = store.run_summaries(1).await.expect("summaries");
    assert!(runs[0].parameters.iter().all(|of| of.std_dev.is_nan()), "{runs:?}");
}
