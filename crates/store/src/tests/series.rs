//! The series of a test says what the tables say that it follows from.

use std::path::Path;

use super::support::*;
use crate::handle::Store;
use armwatch_model::anomaly::settled::Settled;

async fn summaries(store: &Store) -> String {
    format!("{:?}", store.run_summaries(1).await.expect("summaries"))
}

async fn change(store: &Store, statement: &'static str) -> u64 {
    sqlx::query(statement).execute(&store.writer).await.expect("a change").rows_affected()
}

async fn series(store: &Store) -> i64 {
    let count = sqlx::query_scalar("SELECT count(*) FROM run_series");
    count.fetch_one(&store.readers).await.expect("a count")
}

/// Draws conclusions that store the series of all complete tests.
async fn conclude(store: &Store) {
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    conclusion.window(&Settled::default(), usize::MAX).await.expect("summaries");
    conclusion.commit(history).await.expect("a commit");
}

#[tokio::test]
async fn summaries_are_those_of_the_tables_whatever_changes() {
    let (_folder, store) = fresh().await;
    for day in 0..3 {
        let run_id = streaming_run(&store, "R00", day, 2).await;
        finish(&store, run_id, 2, &findings(vec![])).await;
        assert_eq!(run_id, day + 1);
    }
    conclude(&store).await;
    assert_eq!(series(&store).await, 3);
    let of_series = summaries(&store).await;
    change(&store, "DELETE FROM run_series").await;
    assert_eq!(summaries(&store).await, of_series, "the tables say the same");
    assert!(of_series.contains("cycle_friction: [CycleSeries"), "{of_series}");

    // each takes away the series of the run that it changes, and of no other
    let changes = [
        "UPDATE torque_rmsd SET moving_relative_rmsd = 0.5 WHERE stage = 'all' AND cycle_id = 3 AND joint = 1",
        "DELETE FROM torque_rmsd WHERE stage = 'all' AND verification = 'self' AND cycle_id = 3 AND joint = 2",
        "UPDATE cycle_friction_level SET ln_torque = 0.25 WHERE cycle_id = 3 AND joint = 1",
        "DELETE FROM cycle_friction_level WHERE cycle_id = 3 AND joint = 1",
        "UPDATE parameter_statistic SET mean = mean + 1 WHERE run_id = 2",
        "DELETE FROM parameter_statistic WHERE run_id = 2 AND \"window\" = 'all'",
        "UPDATE cycle SET doubtful = TRUE WHERE cycle_id = 3",
        "DELETE FROM cycle WHERE cycle_id = 4",
        "UPDATE run SET status = 'streaming' WHERE run_id = 2",
        "DELETE FROM run WHERE run_id = 3",
    ];
    for (place, statement) in changes.into_iter().enumerate() {
        conclude(&store).await;
        let before = summaries(&store).await;
        let complete = series(&store).await;
        assert!(change(&store, statement).await > 0, "{statement}");
        assert_eq!(series(&store).await, complete - 1, "{statement}");
        let read = summaries(&store).await;
        change(&store, "DELETE FROM run_series").await;
        assert_eq!(summaries(&store).await, read, "{statement}");
        // one level more or less is made again by the next conclusion, and the mean of a parameter without inertia is none
        assert!(read != before || place == 4 || place == 5, "{statement} changes nothing");
    }
}

#[tokio::test]
async fn a_synthetic_history_is_read_as_one_that_was_recorded() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 2, runs: 3, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    conclude(&store).await;
    let runs = store.run_summaries(2).await.expect("summaries");
    assert_eq!(runs.len(), 3);
    assert!(runs.iter().all(|run| run.joints.len() == 6 && run.cycles == 2 && run.parameters.len() == 24));
    assert!(runs.iter().all(|run| run.cycle_friction.len() == 12 && run.whole_cycle_rmsd.len() == 12));
    assert!(store.fill_synthetic(size, Path::new("/inbox")).await.is_err(), "there are runs");
    assert_sound(&store).await;
}

#[tokio::test]
async fn summaries_follow_figures_by_joint_and_friction_indices() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 3, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let changes = [
        "UPDATE run_joint_summary SET relative_rmsd = 0.9 WHERE run_id = 2 AND joint = 1",
        "UPDATE run_joint_summary SET estimator = 'ordinary' WHERE run_id = 2 AND joint = 2",
        "DELETE FROM run_joint_summary WHERE run_id = 2 AND joint = 3",
        "UPDATE run_friction_index SET friction_index = 3 WHERE run_id = 2 AND joint = 1",
        "DELETE FROM run_friction_index WHERE run_id = 2 AND joint = 2",
        "INSERT INTO run_friction_index SELECT run_id, 2, 9, friction_index_std_error, ambient_coldness,
             ambient_coldness_std_error, coldness_at_start, points, raw_index, short_run
         FROM run_friction_index WHERE run_id = 2 AND joint = 1",
    ];
    for statement in changes {
        conclude(&store).await;
        let (before, complete) = (summaries(&store).await, series(&store).await);
        assert!(change(&store, statement).await > 0, "{statement}");
        assert_eq!(series(&store).await, complete - 1, "{statement}");
        let read = summaries(&store).await;
        change(&store, "DELETE FROM run_series").await;
        assert_eq!(summaries(&store).await, read, "{statement}");
        assert_ne!(read, before, "{statement} changes nothing");
    }
}

/// Friction points that fits over tests stand on, and how many tests have them in one row.
async fn over_tests(store: &Store) -> (String, usize) {
    let read = store.friction_history(1, 0.6).await.expect("points");
    // of each test, since tests of a synthetic history have equal points
    let points: Vec<_> = read.tests.iter().map(|test| (test.run_id, &test.points)).collect();
    (format!("{points:?}"), read.tests.iter().filter(|test| test.is_stored).count())
}

async fn keep_friction_points(store: &Store) {
    let read = store.friction_history(1, 0.6).await.expect("points");
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    conclusion.keep_friction_points(&read).await.expect("kept");
    conclusion.commit(history).await.expect("a commit");
}

#[tokio::test]
async fn friction_points_over_tests_are_those_of_the_tables_whatever_changes() {
    let (_folder, store) = fresh_file().await;
    let size = crate::SyntheticSize { robots: 1, runs: 40, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let changes = [
        "UPDATE friction_point SET torque_nm = 7 WHERE cycle_id = 3 AND joint = 1",
        "DELETE FROM friction_point WHERE cycle_id = 3 AND joint = 2",
        "INSERT INTO friction_point SELECT cycle_id, speed_fraction, 99, joint, time_s, speed_rad_s, direction, 5.0, std_nm,
             samples, gravity FROM friction_point WHERE cycle_id = 3 AND joint = 1",
        "UPDATE cycle SET doubtful = TRUE WHERE cycle_id = 3",
        "UPDATE cycle SET status = 'refused', doubtful = FALSE, reason = 'stuck' WHERE cycle_id = 3",
        "INSERT INTO cycle_refusal VALUES (3, 1, 'stuck_channel', 'torque', 1, 'it is stuck')",
        "DELETE FROM cycle_refusal WHERE cycle_id = 3",
        "DELETE FROM cycle WHERE cycle_id = 4",
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
    // at another level, and with other tests, others are kept
    keep_friction_points(&store).await;
    let read = store.friction_history(1, 1.0).await.expect("points");
    assert!(read.tests.iter().all(|test| !test.is_stored));
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    conclusion.keep_friction_points(&read).await.expect("kept");
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
    // a cycle that does not count says nothing
    change(&store, "UPDATE cycle SET doubtful = TRUE").await;
    let runs = store.run_summaries(1).await.expect("summaries");
    assert!(runs[0].parameters.iter().all(|of| of.std_dev.is_nan()), "{runs:?}");
}
