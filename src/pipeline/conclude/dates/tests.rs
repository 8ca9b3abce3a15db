//! Wrong dates hide no alarm: each of these histories has a load from its tenth test on.

use std::path::Path;
use std::sync::Arc;

use crate::pipeline::conclude::test_database::{Database, assert_sound, change, count, fresh};
use crate::pipeline::context::Pipeline;
use armwatch_config::Config;
use armwatch_store::{NotDecided, RunDecision};

/// Noon of 28 November 2026, s.
const ARRIVAL: i64 = 1_795_867_200;

const DAY: i64 = 86_400;

/// Seconds since 1970 of 08:47 on a day.
fn day(date: &str) -> i64 {
    format!("{date}T08:47:00Z").parse::<jiff::Timestamp>().expect("a time").as_second()
}

/// Twenty-four daily tests from 5 January 2026 on, whose files arrive at noon of 28 November.
async fn tests() -> (tempfile::TempDir, Database, Pipeline) {
    let (folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs: 24, cycles: 3, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    for run in 1..=24 {
        date(&store, run, day("2026-01-05") + DAY * (run - 1)).await;
        arrival(&store, run, ARRIVAL + 3 * run).await;
    }
    change(&store, "UPDATE parameter_statistic SET mean = mean * 1.2 WHERE run_id >= 10").await;
    // nothing was concluded before
    change(&store, "UPDATE robot SET history = history + 1").await;
    let pipeline = Pipeline::new(Arc::new(Config::shipped().expect("settings")), store.clone());
    (folder, store, pipeline)
}

async fn date(store: &Database, run: i64, second: i64) {
    let moved = "UPDATE cycle SET started_at = started_at - (SELECT r.started_at FROM run AS r WHERE r.run_id = cycle.run_id)";
    change(store, &format!("{moved} + {second} * 1000000 WHERE run_id = {run}")).await;
    change(store, &format!("UPDATE run SET started_at = {second} * 1000000 WHERE run_id = {run}")).await;
}

async fn arrival(store: &Database, run: i64, second: i64) {
    change(store, &format!("UPDATE run SET ingested_at = {second} * 1000000 WHERE run_id = {run}")).await;
    change(store, &format!("UPDATE source_file SET modified = {second} * 1000000 WHERE run_id = {run}"))
        .await;
}

/// The tests as far as the first so many have arrived. The others wait in quarantine, where they keep their figures.
async fn arrived(store: &Database, runs: i64) {
    let waits = format!(
        "UPDATE run SET status = CASE WHEN run_id <= {runs} THEN 'complete' ELSE 'quarantined' END,
                        reason = CASE WHEN run_id > {runs} THEN 'has not arrived' END
         WHERE set_aside IS NULL AND status <> CASE WHEN run_id <= {runs} THEN 'complete' ELSE 'quarantined' END"
    );
    change(store, &waits).await;
    change(store, "UPDATE robot SET history = history + 1").await;
}

async fn texts(store: &Database, statement: &'static str) -> Vec<String> {
    sqlx::query_scalar(statement).fetch_all(&store.rows).await.expect("texts")
}

const ALARMS: &str =
    "SELECT count(*) FROM anomaly WHERE severity <> 'info' AND NOT ended AND NOT withdrawn AND state = 'open'
         AND quantity <> 'implausible_date'";
const UNWATCHED: &str = "SELECT count(*) FROM anomaly WHERE severity = 'warning' AND state = 'open' AND quantity = 'implausible_date'";
const NAMED: &str =
    "SELECT message FROM anomaly WHERE quantity = 'implausible_date' AND state = 'open' AND NOT withdrawn";
const OPENED: &str = "SELECT count(*) FROM anomaly_event JOIN anomaly USING (anomaly_id)
                      WHERE what = 'opened' AND anomaly.quantity <> 'implausible_date' AND anomaly.severity <> 'info'";

#[tokio::test]
async fn an_alarm_is_raised_beside_wrong_dates_and_these_are_named() {
    let next = |run: i64| DAY * (run - 1);
    type Wrong = Box<dyn Fn(i64) -> i64>;
    let from = |date: &str| -> Wrong {
        let first = day(date);
        Box::new(move |run| first + next(run))
    };
    let scenarios: [(&str, std::ops::Range<i64>, Wrong, bool); 13] = [
        ("days ahead of the arrival", 7..10, from("2026-11-26"), true),
        ("two days ahead of live tests", 7..10, Box::new(move |run| day("2026-01-08") + next(run)), false),
        ("months ahead", 7..10, from("2026-04-07"), true),
        ("eight tests months ahead", 7..10, from("2026-06-07"), true),
        ("the next year", 7..10, from("2027-03-01"), true),
        ("2099", 7..10, from("2099-03-01"), true),
        ("the past year", 7..10, from("2025-01-05"), true),
        ("a dead battery: 1980", 7..10, from("1980-01-01"), true),
        ("a dead battery: 2000", 7..10, from("2000-01-01"), true),
        ("a dead battery: 2036", 7..10, from("2036-02-07"), true),
        ("day and month swapped", 7..10, Box::new(|run| day(&format!("2026-{:02}-01", run))), true),
        ("a file of 1901", 7..10, from("1901-12-13"), true),
        ("a file of 2106", 7..10, from("2106-02-07"), true),
    ];
    for (name, runs, wrong, copied) in scenarios {
        let (_folder, store, pipeline) = tests().await;
        for run in runs.clone() {
            date(&store, run, wrong(run)).await;
        }
        if !copied {
            for run in 1..=24 {
                arrival(&store, run, day("2026-01-05") + next(run) + 3 * 3600).await;
            }
        }
        for until in [9, 24] {
            arrived(&store, until).await;
            pipeline.conclude().await.expect("conclusions");
        }
        assert!(count(&store, ALARMS).await > 0, "{name}: no alarm");
        assert_eq!(count(&store, OPENED).await, count(&store, ALARMS).await, "{name}: opened, as any alarm");
        let named = texts(&store, NAMED).await;
        assert!(named.len() == 1 && named[0].contains("run 7"), "{name}: {named:?}");
        assert!(named[0].contains("armwatch run-date"), "{name}: {named:?}");
        assert_eq!(count(&store, UNWATCHED).await, 0, "{name}: later tests count");
        let left_out = count(
            &store,
            "SELECT count(*) FROM runs WHERE status = 'set_aside' AND date_problem IS NOT NULL",
        );
        assert_eq!(left_out.await, 3, "{name}");
        let baseline = "SELECT count(*) FROM friction_baseline_run WHERE run_id BETWEEN 7 AND 9";
        assert_eq!(count(&store, baseline).await, 0, "{name}");
        assert_sound(&store).await;
    }
}

#[tokio::test]
async fn one_start_for_all_and_a_wrong_clock_of_the_machine_hide_no_alarm() {
    let (_folder, store, pipeline) = tests().await;
    for run in 1..=24 {
        date(&store, run, day("2000-01-01")).await;
    }
    pipeline.conclude().await.expect("conclusions");
    assert!(count(&store, ALARMS).await > 0, "the order of arrival counts");
    assert!(texts(&store, NAMED).await[0].contains("the same start as 23 other recordings"));
    for clock in ["1970-01-01", "2087-05-05"] {
        let (_folder, store, pipeline) = tests().await;
        for run in 1..=24 {
            arrival(&store, run, day(clock) + run).await;
        }
        for run in 7..10 {
            date(&store, run, day("2099-01-01") + run).await;
        }
        for until in [9, 24] {
            arrived(&store, until).await;
            pipeline.conclude().await.expect("conclusions");
        }
        assert!(count(&store, ALARMS).await > 0, "{clock}");
        assert_eq!(texts(&store, NAMED).await.len(), 1, "{clock}");
        assert_eq!(count(&store, "SELECT count(*) FROM run WHERE set_aside IS NOT NULL").await, 3, "{clock}");
    }
}

#[tokio::test]
async fn wrong_dates_end_no_alarm_and_a_robot_is_not_ok_by_them() {
    let (_folder, store, pipeline) = tests().await;
    // the last three show no load
    change(&store, "UPDATE parameter_statistic SET mean = mean / 1.2 WHERE run_id >= 22").await;
    for run in 22..25 {
        date(&store, run, day("2036-01-01") + run).await;
    }
    arrived(&store, 21).await;
    pipeline.conclude().await.expect("conclusions");
    let before =
        (count(&store, ALARMS).await, texts(&store, "SELECT message FROM anomaly ORDER BY anomaly_id").await);
    assert!(before.0 > 0);
    arrived(&store, 24).await;
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, ALARMS).await, before.0, "it stays open");
    let now =
        texts(&store, "SELECT message FROM anomaly WHERE quantity <> 'implausible_date' ORDER BY anomaly_id")
            .await;
    assert_eq!(now, before.1, "nothing about it has changed");

    let (_folder, store, pipeline) = tests().await;
    change(&store, "UPDATE parameter_statistic SET mean = mean / 1.2 WHERE run_id >= 10").await;
    for run in 20..25 {
        date(&store, run, day("2000-01-01") + run).await;
    }
    pipeline.conclude().await.expect("conclusions");
    let ok = count(&store, "SELECT count(*) FROM fleet_health WHERE status IN ('ok', 'learning')").await;
    assert_eq!(ok, 0, "the latest tests say nothing");
    let why = texts(&store, "SELECT DISTINCT reason FROM fleet_health").await;
    assert!(
        why[0].starts_with("the date of the latest test") && why[0].contains("2026-01-23 08:47Z"),
        "{why:?}"
    );
    assert_eq!(count(&store, ALARMS).await, 0, "they show no load");
}

#[tokio::test]
async fn an_alarm_is_raised_where_no_test_with_the_load_has_a_right_date() {
    let wrong = [
        "1970-01-01",
        "1980-01-06",
        "2000-01-01",
        "2019-03-01",
        "2025-01-05",
        "2026-11-20",
        "2027-03-01",
        "2036-02-07",
        "2099-03-01",
        "2106-02-07",
    ];
    for first in wrong {
        let (_folder, store, pipeline) = tests().await;
        for run in 10..25 {
            date(&store, run, day(first) + 10 * DAY * run).await;
        }
        for until in [9, 12, 18, 24] {
            arrived(&store, until).await;
            pipeline.conclude().await.expect("conclusions");
        }
        assert!(count(&store, ALARMS).await > 0, "{first}: no alarm");
        assert_eq!(count(&store, OPENED).await, count(&store, ALARMS).await, "{first}: opened, as any alarm");
        let named = texts(&store, NAMED).await;
        assert!(named.len() == 1 && named[0].contains("--as-arrived"), "{first}: {named:?}");
        let of_baseline = "SELECT count(*) FROM friction_baseline_run WHERE run_id >= 10";
        assert_eq!(count(&store, of_baseline).await, 0, "{first}");
        let recorded = count(
            &store,
            "SELECT count(*) FROM runs WHERE recorded_start_at < started_at OR recorded_start_at > started_at",
        );
        assert_eq!(recorded.await, 15, "{first}");
        assert_sound(&store).await;
    }
}

/// Of the tests that follow the first of a robot, fewer than the baseline has tests are right.
#[tokio::test]
async fn tests_without_a_right_date_are_no_baseline() {
    let (_folder, store, pipeline) = tests().await;
    for run in 4..25 {
        date(&store, run, day("2000-01-01") + DAY * run).await;
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!((count(&store, ALARMS).await, count(&store, UNWATCHED).await), (0, 1));
    let named = texts(&store, NAMED).await;
    assert!(
        named[0].starts_with("the last 21 tests are excluded") && named[0].contains("--as-arrived"),
        "{named:?}"
    );
}

#[tokio::test]
async fn a_corrected_date_counts_and_can_be_taken_back() {
    let (_folder, store, pipeline) = tests().await;
    // all tests with the load have lost their clock
    for run in 10..25 {
        date(&store, run, day("2000-01-01") + DAY * run).await;
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, "SELECT count(*) FROM run WHERE set_aside = 'arrival_order'").await, 15);
    let before = count(&store, ALARMS).await;
    assert!(before > 0);
    let nothing = store.decide_about_run(24, &RunDecision::StartAsRecorded).await.expect("decided");
    assert_eq!(nothing, Err(NotDecided::NothingToUndo), "no person has corrected it");
    for run in 10..25 {
        let decided = store.decide_about_run(run, &RunDecision::StartedAtArrival).await.expect("decided");
        assert!(decided.is_ok(), "{decided:?}");
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, ALARMS).await, before, "the load is seen");
    assert!(texts(&store, NAMED).await.is_empty(), "no date is questioned");
    let recorded = count(&store, "SELECT count(*) FROM runs WHERE recorded_start_at LIKE '2000-01-%'").await;
    assert_eq!(
        (count(&store, "SELECT count(*) FROM run WHERE set_aside IS NOT NULL").await, recorded),
        (0, 15)
    );

    let undone =
        store.decide_about_run(24, &RunDecision::StartAsRecorded).await.expect("decided").expect("undone");
    assert_eq!(undone.recorded_start, None);
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(
        texts(&store, "SELECT started_at FROM runs WHERE status = 'set_aside'").await,
        ["2000-01-25T08:47:00.000Z"]
    );
    let again = store.decide_about_run(24, &RunDecision::StartAsRecorded).await.expect("decided");
    assert_eq!(again, Err(NotDecided::NothingToUndo));
    let confirmed = store.decide_about_run(24, &RunDecision::Confirm).await.expect("decided");
    assert!(confirmed.is_ok());
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, "SELECT count(*) FROM runs WHERE status = 'set_aside'").await, 0);
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_run_that_is_set_aside_counts_no_more_until_it_is_taken_back() {
    let (_folder, store, pipeline) = tests().await;
    pipeline.conclude().await.expect("conclusions");
    let before = count(&store, ALARMS).await;
    assert!(before > 0);
    let by = RunDecision::SetAside("mueller".into());
    for run in 10..25 {
        assert!(store.decide_about_run(run, &by).await.expect("decided").is_ok());
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, ALARMS).await, 0);
    assert_eq!(
        texts(&store, "SELECT DISTINCT reason FROM runs WHERE status = 'set_aside'").await,
        ["set aside by mueller"]
    );
    assert_eq!(count(&store, "SELECT count(*) FROM runs WHERE superseded_by_run_id IS NOT NULL").await, 0);
    for run in 10..25 {
        assert!(store.decide_about_run(run, &RunDecision::TakeBack).await.expect("decided").is_ok());
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, ALARMS).await, before);
    // a robot without any other run is not in the fleet
    for run in 1..25 {
        assert!(store.decide_about_run(run, &by).await.expect("decided").is_ok());
    }
    pipeline.conclude().await.expect("conclusions");
    assert_eq!(count(&store, "SELECT count(*) FROM fleet_health").await, 0);
    assert_sound(&store).await;
}
