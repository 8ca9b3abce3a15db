//! What is settled of a long history holds until something changes that it follows from.

use std::path::Path;

use super::test_database::{Database, assert_sound, change, count, fresh};
use super::windows::{Judged, judged};
use super::work::{JudgedWork, judged_work};
use armwatch_method::detect::window::Lengths;
use armwatch_model::analysis::Estimator;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Findings};
use armwatch_model::run::RunKind;
use armwatch_store::{AlarmAction, AlarmState, Reconciled};

/// Windows so short that a hundred tests have several.
const SHORT: Lengths = Lengths { step: 30, lead: 15, head: 10, around: 6 };

/// Values that are no numbers equal nothing, so that anomalies are compared as text.
fn said<'a>(anomalies: impl IntoIterator<Item = &'a Anomaly>) -> Vec<String> {
    anomalies.into_iter().map(|of| format!("{of:?}")).collect()
}

async fn conclude(store: &Database, settings: &DetectSettings, lengths: &Lengths) -> (Judged, Reconciled) {
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    let found = judged(&mut conclusion, None, &[], settings, lengths).await.expect("findings");
    let reconciled = conclusion.reconcile(&found.findings, &found.settled).await.expect("reconciled");
    conclusion.settle_withdrawn(RunKind::Test, &found.at).await.expect("settled");
    conclusion.commit(history).await.expect("a commit");
    (found, reconciled)
}

async fn short(store: &Database) -> Judged {
    conclude(store, &DetectSettings::default(), &SHORT).await.0
}

async fn boundaries(store: &Database) -> i64 {
    count(store, "SELECT count(*) FROM settled_history").await
}

/// All anomalies that are stored of a robot, without their numbers and what has settled them.
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

/// A load in these tests.
async fn load(store: &Database, first: i64, last: i64) {
    let statement =
        format!("UPDATE parameter_statistic SET mean = mean * 1.05 WHERE run_id BETWEEN {first} AND {last}");
    assert!(change(store, &statement).await > 0);
}

#[tokio::test]
async fn what_is_settled_goes_with_whatever_it_follows_from() {
    let (_folder, store) = synthetic(170, 3).await;
    load(&store, 40, 44).await;
    load(&store, 90, 160).await;
    let first = short(&store).await;
    // boundaries at 30, 60, 90, 120: thirty tests stand behind each
    assert_eq!((boundaries(&store).await, first.at.runs), (4, 120));
    assert!(short(&store).await.settled.is_empty(), "all of it holds");
    let day = 86_400_000_000_i64;
    // the tests of a boundary are those before it and the thirty behind it
    let changes = [
        ("UPDATE run_joint_summary SET relative_rmsd = 0.9 WHERE run_id = 100 AND joint = 1".to_owned(), 2),
        ("UPDATE cycle SET doubtful = 1 WHERE run_id = 70 AND number = 2".into(), 1),
        ("UPDATE run_friction_index SET friction_index = 1.4 WHERE run_id BETWEEN 121 AND 130".into(), 3),
        ("DELETE FROM run WHERE run_id = 149".into(), 3),
        (format!("UPDATE run SET started_at = started_at - {} WHERE run_id = 165", 50 * day), 2),
        ("UPDATE run SET status = 'streaming' WHERE run_id = 61".into(), 1),
        ("UPDATE cycle SET status = 'refused', doubtful = 0, reason = 'stuck' WHERE run_id = 80".into(), 1),
        (
            "INSERT INTO cycle_refusal SELECT cycle_id, 1, 'stuck_channel', 'torque', 1, 'it is stuck' FROM cycle
             WHERE run_id = 80"
                .into(),
            1,
        ),
        ("UPDATE cycle_refusal SET sentence = 'it was stuck'".into(), 1),
        ("UPDATE cycle SET reason = 'it stood' WHERE run_id = 80".into(), 1),
        ("DELETE FROM cycle_refusal".into(), 1),
        // among them the one that was moved
        ("UPDATE run SET figures_hash = CAST(printf('%032d', 7) AS BLOB) WHERE run_id > 125".into(), 2),
        (
            format!(
                "INSERT INTO maintenance (robot_id, joint, at, what)
                 SELECT 1, 2, started_at - {day} / 2, 'new gear' FROM run WHERE run_id = 95"
            ),
            2,
        ),
        ("DELETE FROM maintenance".into(), 2),
    ];
    for (statement, left) in changes {
        short(&store).await;
        assert_eq!(boundaries(&store).await, 4, "{statement}");
        assert!(change(&store, &statement).await > 0, "{statement}");
        assert_eq!(boundaries(&store).await, left, "{statement}");
        let goes_on = short(&store).await;
        let of_all = stored(&store).await;
        assert_eq!(goes_on.settled.len() as i64, 4 - left, "{statement}");
        // the same as from the first test on
        change(&store, "DELETE FROM settled_history").await;
        let at_once = short(&store).await;
        // values that are no numbers equal nothing
        assert_eq!(format!("{:?}", at_once.at), format!("{:?}", goes_on.at), "{statement}");
        assert_eq!(said(&at_once.findings.anomalies), said(&goes_on.findings.anomalies), "{statement}");
        assert_eq!(stored(&store).await, of_all, "{statement}");
    }
    for statement in [
        "INSERT INTO channel_response VALUES (100, '[]', x'01')",
        "UPDATE channel_response SET numbers = x'02'",
        "DELETE FROM channel_response",
    ] {
        change(&store, "INSERT INTO settled_history SELECT 77, 1, 'test', 990, 1 << 60, 7, x'01'").await;
        assert!(change(&store, statement).await > 0, "{statement}");
        assert_eq!(boundaries(&store).await, 2, "{statement}");
    }
    // other settings, and the same again
    let other = DetectSettings { false_alarms_per_robot_year: 5.0, ..DetectSettings::default() };
    assert_eq!(conclude(&store, &other, &SHORT).await.0.settled.len(), 4);
    assert_eq!(conclude(&store, &other, &SHORT).await.0.settled.len(), 0);
    assert_eq!(short(&store).await.settled.len(), 4);
    assert_sound(&store).await;
}

/// Windows of logs so short that a hundred have several.
const SHORT_WORK: Lengths = Lengths { step: 30, lead: 15, head: 3, around: 4 };

async fn conclude_work(store: &Database) -> (JudgedWork, Reconciled) {
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    let settings = DetectSettings::default();
    let found =
        judged_work(&mut conclusion, Estimator::Weighted, &settings, &SHORT_WORK).await.expect("findings");
    let findings = Findings { anomalies: found.anomalies.clone(), ..Findings::default() };
    let reconciled = conclusion.reconcile(&findings, &found.settled).await.expect("reconciled");
    conclusion.settle_withdrawn(RunKind::Production, &found.at).await.expect("settled");
    conclusion.commit(history).await.expect("a commit");
    (found, reconciled)
}

#[tokio::test]
async fn what_is_settled_of_ordinary_work_goes_with_whatever_it_follows_from() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs: 60, cycles: 1, logs: 3 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    // friction by the summaries alone; logs have the numbers from 61 on, three behind each test
    change(&store, "DELETE FROM log_evidence").await;
    let worn = |first: i64, last: i64| {
        format!(
            "UPDATE production_summary SET friction_excess = 0.5
             WHERE joint = 2 AND run_id BETWEEN {first} AND {last}"
        )
    };
    change(&store, &worn(85, 93)).await;
    change(&store, &worn(140, 240)).await;
    let (first, reconciled) = conclude_work(&store).await;
    // boundaries at 30, 60, 90, 120: thirty logs stand behind each, and thirty more behind the last
    assert_eq!((boundaries(&store).await, first.at.runs), (5, 150));
    assert!(reconciled.events.iter().any(|event| event.what.name() == "opened"));
    assert!(first.settled.iter().any(|(_, ended)| !ended.is_empty()), "wear that was over");
    assert!(conclude_work(&store).await.0.settled.is_empty(), "all of it holds");
    let hour = 3_600_000_000_i64;
    let changes = [
        ("UPDATE production_summary SET relative_rmsd = 0.9 WHERE run_id = 160 AND joint = 1".to_owned(), 2),
        ("UPDATE run_joint_summary SET relative_rmsd = 0.04 WHERE run_id = 20 AND joint = 1".into(), 0),
        ("DELETE FROM run WHERE run_id = 215".into(), 4),
        (format!("UPDATE run SET started_at = started_at - {} WHERE run_id = 230", 480 * hour), 2),
        ("UPDATE run SET status = 'streaming' WHERE run_id = 125".into(), 1),
        ("DELETE FROM production_summary WHERE run_id = 200 AND joint = 3".into(), 3),
    ];
    for (statement, left) in changes {
        conclude_work(&store).await;
        let before = boundaries(&store).await;
        assert!(change(&store, &statement).await > 0, "{statement}");
        let held = boundaries(&store).await;
        assert!(held < before, "{statement}");
        assert_eq!(held, left, "{statement}");
        let (goes_on, _) = conclude_work(&store).await;
        let of_all = stored(&store).await;
        // the same as from the first log on
        change(&store, "DELETE FROM settled_history").await;
        let (at_once, again) = conclude_work(&store).await;
        assert_eq!(again.events, [], "{statement}");
        assert_eq!(format!("{:?}", at_once.at), format!("{:?}", goes_on.at), "{statement}");
        assert_eq!(said(&at_once.anomalies), said(&goes_on.anomalies), "{statement}");
        assert_eq!(stored(&store).await, of_all, "{statement}");
    }
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_conclusion_reads_so_many_logs_and_no_more() {
    let mut read = Vec::new();
    for runs in [20, 40, 80] {
        let (_folder, store) = fresh().await;
        let size = armwatch_store::SyntheticSize { robots: 1, runs, cycles: 1, logs: 24 };
        store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
        let mut conclusion = store.conclude(1).await.expect("a transaction");
        let settings = DetectSettings::default();
        let mut judged = Vec::new();
        for _ in 0..2 {
            let found = judged_work(&mut conclusion, Estimator::Weighted, &settings, &Lengths::OF_LOGS).await;
            let found = found.expect("findings");
            judged.push((found.at.runs, found.logs));
        }
        assert_eq!(judged[1].0, ((runs as usize * 24 / 250).max(1) - 1) * 250);
        read.push(judged[1].1);
    }
    assert_eq!(read[0], 480);
    // those of the lead and behind it, and of each test before the first six
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
    // the second came back soon and took eight quiet tests to end, the last goes on
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
    // judged from the first test on, they are what they were, and nothing is told
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
        let (first, _) = conclude(&store, &settings, &lengths).await;
        assert_eq!(first.at.runs, ((runs as usize / 500).max(1) - 1) * 500);
        let (then, _) = conclude(&store, &settings, &lengths).await;
        assert!(then.settled.is_empty());
        read.push((then.tests, then.read));
    }
    // all of a short history; of a longer one the first tests of the epoch and the last one with figures before those that lead
    // in, these, and those behind the boundary
    assert_eq!(read[0].0, 999);
    assert_eq!([read[1].0, read[2].0], [700 + 250 + 64 + 1; 2], "{read:?}");
    assert!(read[2].1 <= 30, "cycles of few tests: {read:?}");
}

/// Findings of a robot of which nothing is settled are told as they always were.
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
