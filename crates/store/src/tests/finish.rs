//! The end of a run: analysis, history, anomalies, health.

use jiff::civil::date;
use sqlx::AssertSqlSafe;

use super::support::*;
use crate::error::StoreError;
use crate::ledger::supersession::supersede;
use crate::robot::indices::baselines::{FrictionConclusion, NewIndices};
use crate::views::HealthStatus;
use armwatch_model::analysis::friction::FrictionIndex;
use armwatch_model::analysis::refusal::{Channel, RefusalCause};
use armwatch_model::analysis::{CycleAnalysis, Estimate};
use armwatch_model::anomaly::forecast::{Crossing, Forecast, Trend};
use armwatch_model::anomaly::{Anomaly, Findings, JointHealth, Knowledge, Severity};
use armwatch_model::run::RunStatus;
use armwatch_testing::er3a;

#[tokio::test]
async fn the_end_of_a_run_reads_what_it_needs_and_stores_the_rest() {
    let (_folder, store) = fresh().await;
    // The later run arrives first; the history is by start, not by arrival.
    let later = streaming_run(&store, "R00", 1, 2).await;
    finish(&store, later, 2, &findings(vec![])).await;
    let other = streaming_run(&store, "R01", 0, 1).await;
    finish(&store, other, 1, &findings(vec![])).await;
    let unfinished = streaming_run(&store, "R00", 2, 1).await;
    let run_id = streaming_run(&store, "R00", 0, 3).await;

    let mut end = store.finish_run(run_id).await.expect("a transaction");
    assert_eq!(
        end.measurements().await.expect("measurements"),
        store.run_measurements(run_id).await.expect("same")
    );
    end.store_analysis(&run_analysis(10.0)).await.expect("an analysis");
    end.complete(totals(3)).await.expect("completion");
    end.commit().await.expect("a commit");
    let row = store.runs().await.expect("runs").into_iter().find(|r| r.run_id == run_id).expect("the run");
    assert_eq!((row.status, row.cycles, row.rows), (RunStatus::Complete, 3, Some(90_078)));
    assert_eq!(store.counts().await.expect("counts").streaming_runs, 1);

    let robot = stale(&store, run_id).await;
    let history = store.run_summaries(robot.robot_id).await.expect("summaries");
    assert_eq!(history.iter().map(|r| (r.run_id, r.cycles)).collect::<Vec<_>>(), [(run_id, 3), (later, 2)]);
    assert_eq!(history[0].joints, run_analysis(10.0).summaries);
    assert_eq!((history[0].started_at, history[1].started_at), (day(0), day(1)));

    let points = store.friction_history(robot.robot_id, 0.2 * 3.0, 7).await.expect("points").points();
    let expected: Vec<_> = [1, 2, 3, 1, 2]
        .into_iter()
        .flat_map(|number| cycle(number).friction_points)
        .filter(|p| p.speed_fraction == 0.6)
        .collect();
    assert_eq!(points, expected);
    let mut conclusion = store.conclude(robot.robot_id).await.expect("a transaction");
    conclusion.replace_mixed_fits(&fits(20.0)).await.expect("fits");
    conclusion.reconcile(&findings(vec![]), &[]).await.expect("findings");
    conclusion.commit(robot.history).await.expect("a commit");
    assert_eq!(store.stale_robots().await.expect("robots"), []);
    assert!(store.discard_run(unfinished).await.expect("an answer"));
    assert_sound(&store).await;
}

/// A run that ends or is deleted during a conclusion is not in it: the robot needs another conclusion.
#[tokio::test]
async fn conclusions_are_stale_until_they_stand_on_the_whole_history() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.stale_robots().await.expect("robots"), []);
    let first = streaming_run(&store, "R00", 0, 1).await;
    assert_eq!(store.stale_robots().await.expect("robots"), [], "an unfinished run says nothing");
    finish(&store, first, 1, &findings(vec![])).await;

    let second = streaming_run(&store, "R00", 1, 1).await;
    let mut end = store.finish_run(second).await.expect("a transaction");
    end.complete(totals(1)).await.expect("completion");
    end.commit().await.expect("a commit");
    let seen = stale(&store, second).await;
    let third = streaming_run(&store, "R00", 2, 1).await;
    let mut end = store.finish_run(third).await.expect("a transaction");
    end.complete(totals(1)).await.expect("completion");
    end.commit().await.expect("a commit");
    let conclusion = store.conclude(seen.robot_id).await.expect("a transaction");
    conclusion.commit(seen.history).await.expect("a commit");
    let still = stale(&store, third).await;
    assert!(still.history > seen.history, "{still:?}");
    let conclusion = store.conclude(still.robot_id).await.expect("a transaction");
    conclusion.commit(still.history).await.expect("a commit");
    assert_eq!(store.stale_robots().await.expect("robots"), []);

    supersede(&store.writer, third, second).await.expect("an update");
    assert_eq!(store.stale_robots().await.expect("robots").len(), 1, "a run has left the history");
}

/// Every call can be part of a separate task, on any thread.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_whole_run_may_be_stored_from_a_spawned_task() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    let task = tokio::spawn(async move {
        let store = crate::handle::Store::open(&path).await?;
        let run_id = store.begin_run(&header("R00", 0)).await?.run_id;
        store.describe_model(&er3a(), &[]).await?;
        store.record_cycle(run_id, &cycle(1), &er3a()).await?;
        store.run_measurements(run_id).await?;
        let mut end = store.finish_run(run_id).await?;
        end.measurements().await?;
        end.store_analysis(&run_analysis(1.0)).await?;
        end.complete(totals(1)).await?;
        end.commit().await?;
        for robot in store.stale_robots().await? {
            store.run_summaries(robot.robot_id).await?;
            store.friction_history(robot.robot_id, 0.6, 7).await?;
            store.friction_tests(robot.robot_id).await?;
            let mut conclusion = store.conclude(robot.robot_id).await?;
            conclusion.replace_mixed_fits(&fits(1.0)).await?;
            conclusion.reconcile(&findings(vec![]), &[]).await?;
            conclusion.commit(robot.history).await?;
        }
        store.quarantine(&header("R00", 1), &fault("no rows", None)).await?;
        store.lookup(&header("R00", 1).content_hash).await?;
        store.discard_run(run_id).await?;
        let answers = (store.runs().await?.len(), store.fleet_health().await?.len());
        store.anomalies_after(0).await?;
        store.counts().await?;
        store.close().await?;
        Ok::<_, StoreError>(answers)
    });
    assert_eq!(task.await.expect("no panic").expect("no error"), (2, 6));
}

#[tokio::test]
async fn ending_a_run_again_replaces_its_results() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    finish(&store, run_id, 2, &findings(vec![anomaly(joint(1), run_id, Severity::Info)])).await;
    let once = dump(&store).await;
    finish(&store, run_id, 2, &findings(vec![anomaly(joint(1), run_id, Severity::Info)])).await;
    assert_eq!(dump(&store).await, once);
}

#[tokio::test]
async fn fits_of_each_shape_show_their_own_columns() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    finish(&store, run_id, 1, &findings(vec![])).await;
    let shape = |model: &str| {
        AssertSqlSafe(format!(
            "SELECT concat(count(a_nm), count(b_nm), count(t1_min), count(c_nm), count(t2_min), count(a_std_error_nm),
                           count(b_std_error_nm), count(t1_std_error_min), count(c_std_error_nm), count(t2_std_error_min))
             FROM warmup_fits WHERE model = '{model}' AND run_id IS NOT NULL"
        ))
    };
    for (model, expected) in [("double", "1111111111"), ("single", "1110011100"), ("constant", "1000010000")]
    {
        let found: String = sqlx::query_scalar(shape(model)).fetch_one(&store.readers).await.expect("a row");
        assert_eq!(found, expected, "{model}");
    }
    assert_eq!(number(&store, "SELECT count(*) FROM warmup_fits WHERE run_id IS NULL").await, Some(3.0));
    let t1 = "SELECT t1_min FROM warmup_fits WHERE run_id IS NULL AND joint = 1";
    assert_eq!(number(&store, t1).await, Some(40.0));
    assert_eq!(
        number(&store, "SELECT max(t2_std_error_min) FROM warmup_fits WHERE t2_min > 0").await,
        Some(5.0 / 16.0)
    );
    let windows = "SELECT min(\"window\") || ',' || max(\"window\") FROM parameter_statistics WHERE parameter = 'Izz' AND d_se IS NULL";
    assert_eq!(text(&store, windows).await.as_deref(), Some("after_5,all"));
}

#[tokio::test]
async fn a_run_is_complete_only_with_all_its_cycles() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    let error = end.complete(totals(3)).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Refused { .. }), "{error}");
}

#[tokio::test]
async fn a_statistic_of_an_unknown_parameter_is_refused() {
    let (_folder, store) = fresh().await;
    let run_id = store.begin_run(&header("R00", 0)).await.expect("a run").run_id;
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    let error = end.store_analysis(&run_analysis(1.0)).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Refused { .. }), "{error}");
}

#[tokio::test]
async fn a_transaction_dropped_half_way_leaves_nothing() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let before = dump(&store).await;
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    end.store_analysis(&run_analysis(1.0)).await.expect("an analysis");
    end.complete(totals(2)).await.expect("completion");
    drop(end);
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let found = findings(vec![anomaly(joint(1), run_id, Severity::Critical)]);
    conclusion.reconcile(&found, &[]).await.expect("findings");
    drop(conclusion);
    // The writer is free again, and nothing of the dropped work is stored.
    assert!(!store.record_cycle(run_id, &cycle(1), &er3a()).await.expect("the writer"));
    assert_eq!(dump(&store).await, before);
    assert_sound(&store).await;
}

#[tokio::test]
async fn findings_of_a_robot_leave_other_robots_alone() {
    let (_folder, store) = fresh().await;
    for robot in ["R00", "R01"] {
        let run_id = streaming_run(&store, robot, 0, 1).await;
        finish(&store, run_id, 1, &findings(vec![anomaly(joint(1), run_id, Severity::Warning)])).await;
    }
    assert_eq!(states(&store).await, ["open", "open"]);
    let error = {
        let run_id = streaming_run(&store, "R02", 0, 1).await;
        finish(&store, run_id, 1, &findings(vec![])).await;
        let mut conclusion = store.conclude(1).await.expect("a transaction");
        let found = findings(vec![anomaly(joint(1), 999, Severity::Info)]);
        conclusion.reconcile(&found, &[]).await.expect_err("no such run")
    };
    assert!(matches!(error, StoreError::Refused { .. }), "{error}");
}

#[tokio::test]
async fn health_is_the_worst_that_is_not_resolved() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let mut resolved = anomaly(joint(4), run_id, Severity::Critical);
    resolved.ended = true;
    let mut found = findings(vec![
        anomaly(joint(1), run_id, Severity::Info),
        anomaly(joint(2), run_id, Severity::Warning),
        anomaly(joint(3), run_id, Severity::Critical),
        resolved,
        anomaly(joint(6), run_id, Severity::Warning),
    ]);
    found.health[4] = health(joint(5), Knowledge::Learning);
    found.health[5].knowledge = Knowledge::Learning;
    finish(&store, run_id, 1, &found).await;
    acknowledge(&store, 5).await;

    let rows = store.fleet_health().await.expect("health");
    let shown: Vec<_> = rows.iter().map(|r| (r.joint.number(), r.open_anomalies, r.status)).collect();
    use HealthStatus::{Critical, Learning, Ok, Warning};
    assert_eq!(
        shown,
        [(1, 1, Ok), (2, 1, Warning), (3, 1, Critical), (4, 0, Ok), (5, 0, Learning), (6, 0, Warning)]
    );
    assert_eq!((rows[0].friction_index, rows[4].friction_index), (Some(1.1), None));
    assert_eq!(
        (rows[0].moving_relative_rmsd, rows[5].moving_relative_rmsd),
        (Some(0.05 + 1.0 / 1000.0), None)
    );
    assert_eq!(rows[0].last_run_at, day(0));

    // The latest run is the one that started last, whenever it arrived.
    let later = streaming_run(&store, "R00", 9, 1).await;
    finish(&store, later, 1, &found).await;
    let earlier = streaming_run(&store, "R00", 3, 1).await;
    finish(&store, earlier, 1, &found).await;
    let rows = store.fleet_health().await.expect("health");
    assert_eq!((rows.len(), rows[0].last_run_at), (6, day(9)));
    assert_eq!(rows[0].moving_relative_rmsd, Some(0.05 + later as f64 / 1000.0));
}

/// Findings with the next test of the robot expected by this time.
fn expecting(expected_by: jiff::Timestamp) -> Findings {
    Findings { expected_by: Some(expected_by), ..findings(vec![]) }
}

#[tokio::test]
async fn only_a_robot_that_was_seen_in_time_becomes_overdue_and_a_new_test_ends_it() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    finish(&store, run_id, 1, &expecting(day(4))).await;
    let state = async || {
        let row = store.fleet_health().await.expect("health").remove(0);
        (row.status, row.expected_by, row.reason)
    };
    // the program did not see it arrive
    assert_eq!(store.mark_overdue(day(30)).await.expect("a look"), []);
    // a copy of an old export does not count
    store.watch_for_tests("R00", day(5)).await.expect("noted");
    assert_eq!(store.mark_overdue(day(30)).await.expect("a look"), []);
    assert_eq!(state().await, (HealthStatus::Ok, Some(day(4)), None));

    store.watch_for_tests("R00", day(1)).await.expect("noted");
    assert_eq!(store.mark_overdue(day(3)).await.expect("a look"), []);
    let overdue = store.mark_overdue(day(5)).await.expect("a look");
    assert_eq!(overdue.iter().map(|of| of.robot.as_str()).collect::<Vec<_>>(), ["R00"]);
    assert_eq!(store.mark_overdue(day(6)).await.expect("a look"), [], "said once");
    let (status, _, reason) = state().await;
    assert_eq!(status, HealthStatus::Overdue);
    let words = "no test since that of 2026-01-05 06:00Z; the next was expected by 2026-01-09 06:00Z";
    assert_eq!(reason.as_deref(), Some(words));

    // another conclusion from the same tests changes nothing, a new test does
    let again = |expected_by| {
        let store = &store;
        async move {
            let mut conclusion = store.conclude(1).await.expect("a transaction");
            conclusion.reconcile(&expecting(expected_by), &[]).await.expect("findings");
            conclusion.commit(0).await.expect("a commit");
        }
    };
    again(day(4)).await;
    assert_eq!(state().await.0, HealthStatus::Overdue);
    again(day(9)).await;
    assert_eq!(state().await.0, HealthStatus::Ok);
    assert_eq!(store.mark_overdue(day(10)).await.expect("a look").len(), 1, "and then again");
}

#[tokio::test]
async fn what_is_not_known_goes_before_what_was() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let whole_arm = Anomaly { joint: None, ..anomaly(joint(1), run_id, Severity::Warning) };
    let mut found = findings(vec![whole_arm, anomaly(joint(3), run_id, Severity::Critical)]);
    for place in [0, 2] {
        found.health[place] =
            JointHealth { reason: Some("no result".into()), ..health(joint(place + 1), Knowledge::NoResult) };
    }
    found.health[3].last_result_run_id = Some(run_id);
    finish(&store, run_id, 1, &found).await;
    let rows = store.fleet_health().await.expect("health");
    let shown: Vec<_> =
        rows[..4].iter().map(|row| (row.status, row.open_anomalies, row.reason.as_deref())).collect();
    assert_eq!(shown[0], (HealthStatus::Unknown, 1, Some("no result")));
    assert_eq!(shown[1], (HealthStatus::Warning, 1, Some("joint 1 needs more torque")));
    assert_eq!(shown[2], (HealthStatus::Unknown, 2, Some("no result")));
    assert_eq!((rows[2].last_result_at, rows[3].last_result_at), (None, Some(day(0))));
    let row = &store.anomalies_after(0).await.expect("anomalies")[0];
    assert_eq!((row.joint, row.peak_value), (None, Some(14.0)));
}

#[tokio::test]
async fn forecasts_are_shown_as_they_were_found() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let day = |day| date(2026, 5, day);
    let warning = Crossing { by: day(3), lower: day(1), upper: Some(day(9)) };
    let critical = Crossing { by: day(20), lower: day(10), upper: None };
    let forecasts = [
        Some(Forecast { trend: Trend::Rising, warning_at: Some(warning), critical_at: Some(critical) }),
        Some(Forecast { trend: Trend::Falling, warning_at: None, critical_at: Some(critical) }),
        Some(Forecast::default()),
        None,
    ];
    let mut found = findings(vec![]);
    for (health, forecast) in found.health.iter_mut().zip(forecasts) {
        health.forecast = forecast;
    }
    finish(&store, run_id, 1, &found).await;
    let rows = store.fleet_health().await.expect("health");
    assert_eq!(rows[..4].iter().map(|row| row.forecast).collect::<Vec<_>>(), forecasts);
    let shown: (String, String, String, Option<String>) = sqlx::query_as(
        "SELECT trend, warning_by_upper, critical_by_lower, critical_by_upper FROM fleet_health WHERE joint = 1",
    )
    .fetch_one(&store.readers)
    .await
    .expect("a row");
    assert_eq!(shown, ("rising".into(), "2026-05-09".into(), "2026-05-10".into(), None));
}

#[tokio::test]
async fn causes_of_refused_cycles_come_back_with_the_summaries() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let cause = |joint, channel| RefusalCause {
        finding: "stuck_channel".into(),
        channel,
        joint,
        sentence: format!("the {channel} stands still"),
    };
    for (number, causes) in [
        (2, vec![cause(Some(joint(4)), Channel::Torque)]),
        (3, vec![cause(None, Channel::Time), cause(Some(joint(4)), Channel::Torque)]),
        (4, vec![]),
    ] {
        let refused = CycleAnalysis { refusal_causes: causes, ..refused_cycle(number) };
        assert!(store.record_cycle(run_id, &refused, &er3a()).await.expect("a cycle"));
    }
    let points = store.run_measurements(run_id).await.expect("measurements").friction_points;
    let counted: std::collections::BTreeSet<u32> = points.iter().map(|point| point.cycle).collect();
    assert_eq!(Vec::from_iter(counted), [1, 4], "what a finding refused has no say");
    finish(&store, run_id, 4, &findings(vec![])).await;
    let summaries = store.run_summaries(1).await.expect("summaries");
    assert_eq!(summaries[0].refused_cycles, 3);
    let shown: Vec<_> = summaries[0]
        .refusals
        .iter()
        .map(|of| (of.cause.channel, of.cause.joint, of.first_cycle, of.cycles))
        .collect();
    assert_eq!(
        shown,
        [(Channel::Torque, Some(joint(4)), 2, 2), (Channel::Motion, None, 4, 1), (Channel::Time, None, 3, 1),]
    );
    let result = store.run_result(run_id).await.expect("a look").expect("complete");
    assert_eq!((result.without_result, result.cycles, result.refused), (false, 4, 3));
}

#[tokio::test]
async fn a_robot_without_findings_is_learning() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    finish(&store, run_id, 1, &Findings::default()).await;
    let rows = store.fleet_health().await.expect("health");
    assert_eq!(rows.iter().map(|r| r.status).collect::<Vec<_>>(), [HealthStatus::Learning; 6]);
}

#[tokio::test]
async fn the_same_inputs_give_the_same_views() {
    let mut dumps = Vec::new();
    for _ in 0..2 {
        let (_folder, store) = fresh().await;
        for days in 0..3 {
            for robot in ["R00", "R01"] {
                let run_id = streaming_run(&store, robot, days, 2).await;
                finish(&store, run_id, 2, &findings(vec![anomaly(joint(1), run_id, Severity::Warning)]))
                    .await;
            }
        }
        store.quarantine(&header("unknown", 1), &fault("no such robot", None)).await.expect("a run");
        assert_sound(&store).await;
        dumps.push(dump(&store).await);
    }
    assert!(dumps[0].len() > 1000);
    assert_eq!(dumps[0], dumps[1]);
}

/// Views that are small, or queried by the name of a kept estimate and not by robot or run.
const ASKED_BY_NAME: [&str; 5] = [
    "fleet_health",
    "parameter_set_sources",
    "reestimated_cycles",
    "reestimated_parameters",
    "reestimated_statistics",
];

/// Typical queries of a big database use indexes: only `robot`, a table of some dozens of rows, may be read completely.
#[tokio::test]
async fn natural_questions_are_answered_from_indexes() {
    let (_folder, store) = fresh_file().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    finish(&store, run_id, 1, &findings(vec![])).await;
    let mut questions = Vec::new();
    for view in views(&store).await.iter().filter(|view| !ASKED_BY_NAME.contains(&view.as_str())) {
        let columns = columns(&store, view).await;
        for (column, value) in [("run_id", "1"), ("robot", "'R00'")] {
            if columns.iter().any(|name| name == column) {
                questions.push(format!("SELECT * FROM {view} WHERE {column} = {value}"));
            }
        }
    }
    assert!(questions.len() > 20, "{questions:?}");
    questions
        .push("SELECT * FROM cycle_rmsd WHERE robot = 'R00' AND joint = 5 AND stage = 'excitation'".into());
    questions
        .push("SELECT * FROM cycle_parameters WHERE robot = 'R00' AND joint = 1 AND parameter = 'f1'".into());
    questions.push("SELECT * FROM anomalies WHERE anomaly_id > 7".into());
    questions.push("DELETE FROM warmup_fit WHERE robot_id = 1 AND coalesce(run_id, 0) = 0".into());
    for question in questions {
        let plan: Vec<(i64, i64, i64, String)> =
            sqlx::query_as(AssertSqlSafe(format!("EXPLAIN QUERY PLAN {question}")))
                .fetch_all(&store.writer)
                .await
                .expect("a plan");
        let scans: Vec<&str> = plan
            .iter()
            .map(|step| step.3.as_str())
            // these have one row per robot, and one row
            .filter(|s| s.starts_with("SCAN") && !["SCAN robot", "SCAN database_identity"].contains(s))
            .collect();
        assert!(scans.is_empty(), "{question}: {scans:?} in {plan:?}");
    }
}

#[tokio::test]
async fn detectors_get_the_index_of_each_run_and_people_too() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let index = FrictionIndex {
        joint: joint(2),
        index: Estimate { value: 1.03, std_error: 0.004 },
        raw: 1.2,
        ambient: Estimate { value: 0.1, std_error: 0.02 },
        coldness_at_start: 0.9,
        points: 12,
        short: true,
    };
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    end.store_analysis(&run_analysis(1.0)).await.expect("an analysis");
    end.complete(totals(1)).await.expect("completion");
    end.commit().await.expect("a commit");
    let robot = stale(&store, run_id).await;
    let mut conclusion = store.conclude(robot.robot_id).await.expect("a transaction");
    let new = NewIndices { run_id, points: vec![(joint(2), 12)], basis: Some([7; 32]), indices: vec![index] };
    let found =
        FrictionConclusion { run_ids: vec![run_id], indices: vec![new], ..FrictionConclusion::default() };
    conclusion.replace_friction(&found).await.expect("an index");
    conclusion.commit_figures().await.expect("a commit");
    let summaries = store.latest_window(robot.robot_id, 7).await.expect("summaries");
    let known: Vec<_> =
        summaries[0].joints.iter().filter_map(|of| Some((of.joint, of.friction_index?))).collect();
    assert_eq!(known, [(joint(2), index.index)]);
    assert_eq!(store.stale_robots().await.expect("robots"), [robot], "findings are still to come");
    let rows = store.friction_indices("R00").await.expect("rows");
    let [row] = &rows[..] else { panic!("one row: {rows:?}") };
    assert_eq!(
        (row.run_id, row.joint, row.index, row.raw, row.short),
        (run_id, joint(2), index.index, Some(1.2), true)
    );
}

async fn states(store: &crate::handle::Store) -> Vec<String> {
    store
        .anomalies_after(0)
        .await
        .expect("anomalies")
        .into_iter()
        .map(|row| row.state.name().to_owned())
        .collect()
}

async fn acknowledge(store: &crate::handle::Store, anomaly_id: i64) {
    let acted = store
        .act_on_anomalies(&[anomaly_id], crate::AlarmAction::Acknowledge, "mueller", None)
        .await
        .expect("an answer");
    assert!(acted.is_ok(), "{acted:?}");
}
