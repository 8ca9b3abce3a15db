//! The settled part of a long history is unchanged until a person opens it.

use std::path::Path;

use super::test_database::{Database, assert_sound, change, count, fresh};
use super::windows::{WindowFindings, judge_logs, judge_tests};
use armwatch_method::detect::window::Lengths;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Findings};
use armwatch_model::run::RunKind;
use armwatch_store::{AlarmAction, AlarmState, NewMaintenance, Reconciled};

/// Windows so short that a hundred tests have several.
const SHORT: Lengths = Lengths { step: 30, lead: 15, head: 10, around: 6 };

/// Anomalies as text, for comparison: NaN equals nothing.
fn said<'a>(anomalies: impl IntoIterator<Item = &'a Anomaly>) -> Vec<String> {
    anomalies.into_iter().map(|of| format!("{of:?}")).collect()
}

/// Stores findings; returns the changes of anomalies.
async fn reconcile(store: &Database, found: &WindowFindings) -> Reconciled {
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    let reconciled = conclusion.reconcile(&found.findings, &found.settled).await.expect("reconciled");
    conclusion.commit(history).await.expect("a commit");
    reconciled
}

async fn conclude(
    store: &Database,
    settings: &DetectSettings,
    lengths: &Lengths,
) -> (WindowFindings, Reconciled) {
    let found = judge_tests(store, 1, None, &[], settings, lengths).await.expect("findings");
    let reconciled = reconcile(store, &found).await;
    (found, reconciled)
}

/// Runs before the latest boundary.
async fn settled_runs(store: &Database, kind: RunKind) -> usize {
    store.settled(1, kind).await.expect("a boundary").runs
}

/// The start of a run.
async fn start(store: &Database, run_id: i64) -> jiff::Timestamp {
    let micros = sqlx::query_scalar("SELECT started_at FROM run WHERE run_id = $1").bind(run_id);
    jiff::Timestamp::from_microsecond(micros.fetch_one(&store.rows).await.expect("a run")).expect("a time")
}

async fn short(store: &Database) -> WindowFindings {
    conclude(store, &DetectSettings::default(), &SHORT).await.0
}

async fn boundaries(store: &Database) -> i64 {
    count(store, "SELECT count(*) FROM settled_history").await
}

/// All stored anomalies of a robot, without their numbers and the boundary that settled them.
async fn stored(store: &Database) -> Vec<String> {
    sqlx::query_scalar(
        "SELECT concat_ws(' ', joint, kind, quantity, severity, score, value, baseline, peak_score, first_run_id, first_cycle,
                          last_run_id, onset_run_id, message, ended, withdrawn)
         FROM anomaly WHERE robot_id = 1 AND NOT withdrawn ORDER BY 1",
    )
    .fetch_all(&store.rows)
    .await
    .expect("anomalies")
}

async fn synthetic(runs: u32, cycles: u32) -> (tempfile::TempDir, Database) {
    let (folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs, cycles, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    (folder, store)
}

/// A load alarm in these tests.
async fn load(store: &Database, first: i64, last: i64) {
    let statement = format!(
        "UPDATE parameter_statistic SET mean = mean * 1.05 WHERE run_id BETWEEN {first} AND {last};
         UPDATE cycle SET estimator = estimator WHERE run_id BETWEEN {first} AND {last}"
    );
    assert!(change(store, &statement).await > 0);
}

#[tokio::test]
async fn what_is_settled_stays_until_a_person_opens_it() {
    let (_folder, store) = synthetic(170, 3).await;
    load(&store, 40, 44).await;
    load(&store, 90, 160).await;
    short(&store).await;
    // boundaries at 30, 60, 90, 120: thirty tests are after each
    assert_eq!((boundaries(&store).await, settled_runs(&store, RunKind::Test).await), (4, 120));
    assert!(short(&store).await.settled.is_empty());
    let before = stored(&store).await;
    let day = 86_400_000_000_i64;
    // delete a settled fault and a test, insert a late test, and change settings
    for statement in [
        "UPDATE parameter_statistic SET mean = mean / 1.05 WHERE run_id BETWEEN 40 AND 44;
         UPDATE cycle SET estimator = estimator WHERE run_id BETWEEN 40 AND 44"
            .to_owned(),
        "DELETE FROM run WHERE run_id = 20".into(),
        format!("UPDATE run SET started_at = started_at - {} WHERE run_id = 165", 90 * day),
    ] {
        assert!(change(&store, &statement).await > 0, "{statement}");
        short(&store).await;
        assert_eq!(boundaries(&store).await, 4, "{statement}");
        assert_eq!(stored(&store).await, before, "{statement}");
    }
    let other = DetectSettings { false_alarms_per_robot_year: 5.0, ..DetectSettings::default() };
    assert!(conclude(&store, &other, &SHORT).await.0.settled.is_empty());
    assert_eq!(stored(&store).await, before);
    // opened from a test between the first boundary and the runs that determine it
    let robots = store.reopen_history(Some("S001"), start(&store, 50).await).await.expect("opened");
    assert_eq!((robots, boundaries(&store).await), (vec!["S001".to_owned()], 0));
    let again = short(&store).await;
    assert_eq!(again.settled.len(), 4);
    let after = stored(&store).await;
    assert_ne!(after, before, "the settled fault is gone");
    // the same as from the first test on
    change(&store, "DELETE FROM settled_history").await;
    let at_once = short(&store).await;
    assert_eq!(said(&at_once.findings.anomalies), said(&again.findings.anomalies));
    assert_eq!(stored(&store).await, after);
    // boundaries that depend only on earlier tests stay
    store.reopen_history(None, start(&store, 125).await).await.expect("opened");
    assert_eq!(boundaries(&store).await, 3);
    assert_eq!(short(&store).await.settled.len(), 1);
    assert_eq!(stored(&store).await, after);
    assert!(
        store.reopen_history(Some("nobody"), start(&store, 1).await).await.expect("an answer").is_empty()
    );
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_test_that_arrives_before_the_boundary_is_named_and_counts_once_opened() {
    let (_folder, store) = synthetic(170, 3).await;
    load(&store, 40, 41).await;
    // the second of two tests with a load arrives late
    change(&store, "UPDATE run SET status = 'streaming' WHERE run_id = 41").await;
    short(&store).await;
    let boundary = start(&store, 121).await;
    assert_eq!(store.arrived_too_late(40).await.expect("an answer"), None);
    // its key is that of a run that arrived later
    change(
        &store,
        "PRAGMA foreign_keys = OFF; UPDATE run SET run_id = 1041, status = 'complete' WHERE run_id = 41;
         UPDATE cycle SET run_id = 1041 WHERE run_id = 41; UPDATE parameter_statistic SET run_id = 1041 WHERE run_id = 41;
         UPDATE run_joint_summary SET run_id = 1041 WHERE run_id = 41; UPDATE run_friction_index SET run_id = 1041 WHERE run_id = 41",
    )
    .await;
    let loads = "SELECT count(*) FROM anomaly WHERE last_run_id = 1041 AND NOT withdrawn";
    short(&store).await;
    assert_eq!(count(&store, loads).await, 0);
    // the boundary moved by one test, which had not arrived
    let late = store.arrived_too_late(1041).await.expect("an answer").expect("too late");
    assert!(late >= boundary && late < start(&store, 123).await);
    store.reopen_history(None, start(&store, 1041).await).await.expect("opened");
    short(&store).await;
    assert!(count(&store, loads).await > 0);
    assert_eq!(store.arrived_too_late(1041).await.expect("an answer"), None);
}

#[tokio::test]
async fn work_that_is_entered_late_opens_the_history_from_its_time() {
    let (_folder, store) = synthetic(170, 2).await;
    short(&store).await;
    let work = NewMaintenance {
        robot: "S001".into(),
        joint: None,
        at: start(&store, 95).await,
        what: "new gear".into(),
        who: None,
    };
    let entered = store.enter_maintenance(&work).await.expect("an answer").expect("entered");
    assert_eq!(boundaries(&store).await, 2);
    short(&store).await;
    assert_eq!(boundaries(&store).await, 4);
    store.remove_maintenance(entered).await.expect("removed");
    assert_eq!(boundaries(&store).await, 2);
}

#[tokio::test]
async fn nothing_is_settled_while_a_test_is_left_out() {
    let (_folder, store) = synthetic(170, 2).await;
    load(&store, 40, 44).await;
    let settings = DetectSettings::default();
    let known = (1..=170).filter(|run_id| *run_id != 168).collect();
    let found = judge_tests(&store, 1, Some(&known), &[], &settings, &SHORT).await.expect("findings");
    assert!(found.settled.is_empty());
    let latest = found.findings.health.first().and_then(|of| of.last_result_run_id);
    assert_eq!(latest, Some(170), "all others are judged");
    let whole = short(&store).await;
    let ended = whole.settled.iter().flat_map(|of| &of.ended);
    assert!(!whole.settled.is_empty() && ended.clone().count() > 0);
    let early = |of: &&Anomaly| of.last_run_id < 60;
    assert_eq!(said(found.findings.anomalies.iter().filter(early)), said(ended.filter(early)));
}

/// Windows of logs so short that a hundred have several.
const SHORT_WORK: Lengths = Lengths { step: 30, lead: 15, head: 3, around: 4 };

async fn conclude_work(store: &Database) -> (WindowFindings, Reconciled) {
    let found = judge_logs(store, 1, &DetectSettings::default(), &SHORT_WORK).await.expect("findings");
    let reconciled = reconcile(store, &found).await;
    (found, reconciled)
}

#[tokio::test]
async fn settled_production_stays_until_a_person_opens_it() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs: 60, cycles: 1, logs: 3 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    // friction from the summaries alone; logs have the numbers from 61 on, three after each test
    change(&store, "DELETE FROM log_evidence").await;
    let worn = |first: i64, last: i64, by: f64| {
        format!(
            "UPDATE production_summary SET friction_excess = {by}
             WHERE joint = 2 AND run_id BETWEEN {first} AND {last}"
        )
    };
    change(&store, &worn(85, 93, 0.5)).await;
    change(&store, &worn(140, 240, 0.5)).await;
    let (first, reconciled) = conclude_work(&store).await;
    // boundaries at 30, 60, 90, 120, 150: thirty logs are after each, and thirty more after the last
    assert_eq!((boundaries(&store).await, settled_runs(&store, RunKind::Production).await), (5, 150));
    assert!(reconciled.events.iter().any(|event| event.what.name() == "opened"));
    assert!(first.settled.iter().any(|of| !of.ended.is_empty()), "wear that was over");
    assert!(conclude_work(&store).await.0.settled.is_empty());
    let before = stored(&store).await;
    change(&store, &worn(85, 93, 0.0)).await;
    conclude_work(&store).await;
    assert_eq!((boundaries(&store).await, stored(&store).await), (5, before.clone()));
    store.reopen_history(None, start(&store, 85).await).await.expect("opened");
    let (again, _) = conclude_work(&store).await;
    let after = stored(&store).await;
    assert!(again.settled.len() >= 4 && after != before);
    // the same as from the first log on
    change(&store, "DELETE FROM settled_history").await;
    let (at_once, events) = conclude_work(&store).await;
    assert_eq!(events.events, []);
    assert_eq!(said(&at_once.findings.anomalies), said(&again.findings.anomalies));
    assert_eq!(stored(&store).await, after);
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_conclusion_reads_so_many_logs_and_no_more() {
    let mut read = Vec::new();
    for runs in [20, 40, 80] {
        let (_folder, store) = fresh().await;
        let size = armwatch_store::SyntheticSize { robots: 1, runs, cycles: 1, logs: 24 };
        store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
        let mut logs = 0;
        for _ in 0..2 {
            let found = judge_logs(&store, 1, &DetectSettings::default(), &Lengths::OF_LOGS).await;
            let found = found.expect("findings");
            reconcile(&store, &found).await;
            logs = found.runs;
        }
        let settled = settled_runs(&store, RunKind::Production).await;
        assert_eq!(settled, ((runs as usize * 24 / 250).max(1) - 1) * 250);
        read.push(logs);
    }
    assert_eq!(read[0], 480);
    // those of the lead and after it, and of each test before the first six
    assert!(read[1] <= 125 + 499 + 24 * 6 && read[2] <= 125 + 499 + 24 * 6, "{read:?}");
}

#[tokio::test]
async fn a_settled_anomaly_keeps_its_number_and_what_people_said() {
    let (_folder, store) = synthetic(200, 3).await;
    load(&store, 40, 44).await;
    load(&store, 75, 76).await;
    load(&store, 95, 200).await;
    // tests come day by day
    change(&store, "UPDATE run SET kind = 'production' WHERE run_id > 45").await;
    conclude(&store, &DetectSettings::default(), &SHORT).await;
    let loads = "SELECT anomaly_id FROM anomaly WHERE kind = 'payload' OR quantity = 'inertial_parameters' ORDER BY 1";
    let known = || sqlx::query_scalar::<_, i64>(loads).fetch_all(&store.rows);
    let [first] = known().await.expect("anomalies")[..] else { panic!("one") };
    let act = store.act_on_anomalies(&[first], AlarmAction::Acknowledge, "Ada", Some("a new tool")).await;
    act.expect("an answer").expect("acknowledged");
    let mut events = Vec::new();
    for until in (46..=200).step_by(11) {
        change(&store, &format!("UPDATE run SET kind = 'test' WHERE run_id <= {until} AND kind <> 'test'"))
            .await;
        let (_, reconciled) = conclude(&store, &DetectSettings::default(), &SHORT).await;
        events.extend(reconciled.events.iter().map(|event| (event.anomaly_id, event.what.name())));
    }
    let all = known().await.expect("anomalies");
    assert_eq!(all.len(), 3, "{events:?}");
    // the second came back soon and needed eight quiet tests to end, the last is still open
    let expected = [(first, "ended"), (all[1], "opened"), (all[1], "ended"), (all[2], "opened")];
    let of_loads: Vec<(i64, &str)> = events.into_iter().filter(|(id, _)| all.contains(id)).collect();
    assert_eq!(of_loads, expected);
    let states: Vec<(String, bool, bool)> = sqlx::query_as(
        "SELECT state, settled_history_id IS NOT NULL, withdrawn FROM anomaly WHERE kind = 'payload' OR quantity = 'inertial_parameters'
         ORDER BY anomaly_id",
    )
    .fetch_all(&store.rows)
    .await
    .expect("states");
    let resolved = AlarmState::Resolved.name().to_owned();
    let settled = (resolved, true, false);
    assert_eq!(states, [settled.clone(), settled, (AlarmState::Open.name().into(), false, false)]);
    // evaluated from the first test on, they are unchanged, and no event is reported
    change(&store, "DELETE FROM settled_history").await;
    assert_eq!(count(&store, "SELECT count(*) FROM anomaly WHERE settled_history_id IS NOT NULL").await, 0);
    let (_, reconciled) = conclude(&store, &DetectSettings::default(), &SHORT).await;
    assert_eq!((reconciled.events.len(), known().await.expect("anomalies")), (0, all));
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_conclusion_reads_so_many_tests_and_no_more() {
    let lengths = Lengths::OF_TESTS;
    let settings = DetectSettings::default();
    let mut read = Vec::new();
    for runs in [999, 1700, 3200] {
        let (_folder, store) = synthetic(runs, 1).await;
        conclude(&store, &settings, &lengths).await;
        let settled = settled_runs(&store, RunKind::Test).await;
        assert_eq!(settled, ((runs as usize / 500).max(1) - 1) * 500);
        let (then, _) = conclude(&store, &settings, &lengths).await;
        assert!(then.settled.is_empty() && then.recomputed == 0);
        read.push(then.runs);
    }
    // all tests of a short history; of a longer one, the first tests of the epoch, the last one with values before the
    // lead, the lead, and the tests after the boundary
    assert_eq!(read, [999, 700 + 250 + 64 + 1, 700 + 250 + 64 + 1]);
}

/// Findings of a robot without settled history are reported as before.
#[tokio::test]
async fn a_short_history_is_judged_as_a_whole() {
    let (_folder, store) = synthetic(70, 3).await;
    load(&store, 30, 35).await;
    let found = conclude(&store, &DetectSettings::default(), &Lengths::OF_TESTS).await.0;
    let tests = store.run_summaries(1).await.expect("summaries");
    let whole: Findings = armwatch_method::detect::runs::detect(&tests, &DetectSettings::default());
    assert_eq!(said(&found.findings.anomalies), said(&whole.anomalies));
    assert!(whole.anomalies.iter().any(|of| matches!(of.kind, AnomalyKind::Payload | AnomalyKind::Accuracy)));
    assert_eq!(boundaries(&store).await, 0);
}
