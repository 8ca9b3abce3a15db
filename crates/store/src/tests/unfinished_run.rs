//! Anomalies of a test that is still being written, from the cycle that shows them to the evaluation of the whole test.

use EventKind::{Corrected, Ended, Opened, Withdrawn, Worse};
use sqlx::AssertSqlSafe;

use super::support::{
    anomaly, assert_sound, day, findings, finish, fresh, joint, number, run_analysis, streaming_run, text,
    totals,
};
use crate::handle::Store;
use crate::robot::alarms::alarm_life::AlarmAction;
use crate::robot::alarms::alarm_state::EventKind;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset, Severity};

/// A step of joint 3 with cycle 3, seen only in this run.
fn step(run_id: i64, days: i64, severity: Severity) -> Anomaly {
    Anomaly {
        kind: AnomalyKind::Step,
        quantity: Quantity::FrictionIndex,
        score: 0.2,
        first_cycle: Some(3),
        last_run_id: run_id,
        first_seen_at: day(days),
        last_seen_at: day(days),
        onset: Onset { run_id, cycle: Some(3), at: day(days) },
        ..anomaly(joint(3), run_id, severity)
    }
}

fn oscillation(run_id: i64, days: i64) -> Anomaly {
    Anomaly {
        kind: AnomalyKind::Oscillation,
        quantity: Quantity::FrictionSwing,
        ..step(run_id, days, Severity::Warning)
    }
}

/// Events caused by the findings of an open test.
async fn judge_open(store: &Store, run_id: i64, found: Vec<Anomaly>) -> Option<Vec<EventKind>> {
    let test = store.open_test(run_id).await.expect("an answer")?;
    let mut conclusion = store.conclude(test.robot_id).await.expect("a transaction");
    let reconciled = conclusion.reconcile_open(&test, &found).await.expect("findings")?;
    conclusion.commit(test.history).await.expect("a commit");
    Some(reconciled.events.iter().map(|event| event.what).collect())
}

/// Number, kind, state, and true if it is provisional.
async fn shown(store: &Store) -> Vec<(i64, String, String, bool)> {
    let rows = store.anomalies_after(0).await.expect("anomalies");
    rows.into_iter()
        .map(|row| (row.anomaly_id, row.kind.to_string(), row.state.name().to_owned(), row.provisional))
        .collect()
}

async fn told(store: &Store) -> String {
    let query = "SELECT string_agg(what || coalesce(': ' || why, ''), ', ') FROM anomaly_history";
    text(store, query).await.unwrap_or_default()
}

/// A complete test of day 0, and one of day 1 that is being written.
async fn one_complete_one_open(store: &Store, found: Vec<Anomaly>) -> (i64, i64) {
    let first = streaming_run(store, "R00", 0, 4).await;
    let found: Vec<Anomaly> = found
        .into_iter()
        .map(|of| Anomaly {
            first_run_id: first,
            last_run_id: first,
            onset: Onset { run_id: first, ..of.onset },
            ..of
        })
        .collect();
    finish(store, first, 4, &findings(found)).await;
    (first, streaming_run(store, "R00", 1, 4).await)
}

#[tokio::test]
async fn an_alarm_opens_with_a_cycle_and_keeps_number_state_and_run_when_the_test_is_complete() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    let test = store.open_test(run_id).await.expect("an answer").expect("an open test");
    assert_eq!((test.cycles, test.is_concluded, test.is_latest, test.robot.as_str()), (4, true, true, "R00"));
    assert_eq!(judge_open(&store, run_id, vec![]).await, Some(vec![]));
    let found = step(run_id, 1, Severity::Critical);
    assert_eq!(judge_open(&store, run_id, vec![found.clone()]).await, Some(vec![Opened]));
    let [(id, ..)] = shown(&store).await[..] else { panic!("one") };
    assert_eq!(shown(&store).await, [(id, "step".into(), "open".into(), true)]);
    let acknowledged = store.act_on_anomalies(&[id], AlarmAction::Acknowledge, "mueller", None).await;
    acknowledged.expect("an answer").expect("possible");
    // the next cycles show the same, or nothing
    for found in [vec![found.clone()], vec![], vec![found.clone()]] {
        assert_eq!(judge_open(&store, run_id, found).await, Some(vec![]));
    }
    assert_eq!(shown(&store).await, [(id, "step".into(), "acknowledged".into(), true)]);
    // the whole test shows slightly more or less of it
    let whole = Anomaly { score: 0.22, quantity: Quantity::WarmFriction, ..found.clone() };
    finish(&store, run_id, 4, &findings(vec![whole])).await;
    assert_eq!(shown(&store).await, [(id, "step".into(), "acknowledged".into(), false)]);
    assert_eq!(told(&store).await, "opened, acknowledged");
    let row = &store.anomalies_after(0).await.expect("anomalies")[0];
    assert_eq!((row.run_id, row.onset_cycle), (Some(run_id), Some(3)));
    assert_eq!(judge_open(&store, run_id, vec![found]).await, None, "it is not open any more");
    assert_sound(&store).await;
}

#[tokio::test]
async fn what_the_whole_test_does_not_bear_out_ends_with_a_word() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    judge_open(&store, run_id, vec![step(run_id, 1, Severity::Warning)]).await;
    finish(&store, run_id, 4, &findings(vec![])).await;
    assert_eq!(shown(&store).await, []);
    assert_eq!(told(&store).await, "opened, withdrawn: not borne out by the whole test");
}

#[tokio::test]
async fn more_cycles_and_the_whole_test_may_give_it_another_kind() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    judge_open(&store, run_id, vec![oscillation(run_id, 1)]).await;
    let found = step(run_id, 1, Severity::Warning);
    assert_eq!(judge_open(&store, run_id, vec![found.clone()]).await, Some(vec![Corrected]));
    let drift = Anomaly { kind: AnomalyKind::Drift, ..found };
    finish(&store, run_id, 4, &findings(vec![drift])).await;
    let [(id, ..)] = shown(&store).await[..] else { panic!("one") };
    assert_eq!(shown(&store).await, [(id, "drift".into(), "open".into(), false)]);
    assert_eq!(told(&store).await, "opened, corrected, corrected");
}

#[tokio::test]
async fn conclusions_from_complete_tests_leave_an_open_one_alone() {
    let (_folder, store) = fresh().await;
    let (first, run_id) = one_complete_one_open(&store, vec![]).await;
    judge_open(&store, run_id, vec![step(run_id, 1, Severity::Warning)]).await;
    finish(&store, first, 4, &findings(vec![])).await;
    assert_eq!(shown(&store).await.len(), 1);
    assert_eq!(told(&store).await, "opened");
}

#[tokio::test]
async fn an_open_alarm_of_the_same_cause_is_told_again_only_if_it_is_worse_by_a_step() {
    let (_folder, store) = fresh().await;
    let (first, run_id) = one_complete_one_open(&store, vec![step(0, 0, Severity::Warning)]).await;
    assert_eq!(told(&store).await, "opened");
    let same = Anomaly { score: 0.25, ..step(run_id, 1, Severity::Warning) };
    assert_eq!(judge_open(&store, run_id, vec![same.clone()]).await, Some(vec![]));
    let worse = Anomaly { score: 0.4, ..step(run_id, 1, Severity::Critical) };
    assert_eq!(judge_open(&store, run_id, vec![worse.clone()]).await, Some(vec![Worse]));
    assert_eq!(judge_open(&store, run_id, vec![worse.clone()]).await, Some(vec![]));
    let row = &store.anomalies_after(0).await.expect("anomalies")[0];
    assert_eq!((row.severity, row.run_id, row.last_run_id), (Severity::Critical, Some(first), Some(run_id)));
    assert!(!row.provisional);
    let whole = Anomaly {
        first_run_id: first,
        first_seen_at: day(0),
        onset: Onset { run_id: first, cycle: Some(3), at: day(0) },
        ..worse
    };
    finish(&store, run_id, 4, &findings(vec![whole])).await;
    assert_eq!(told(&store).await, "opened, worse");
    assert_eq!(number(&store, "SELECT count(*) FROM anomaly").await, Some(1.0));
}

#[tokio::test]
async fn another_fault_of_the_joint_is_an_alarm_of_its_own() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![oscillation(0, 0)]).await;
    let found = step(run_id, 1, Severity::Warning);
    assert_eq!(judge_open(&store, run_id, vec![found]).await, Some(vec![Opened]));
    assert_eq!(shown(&store).await.len(), 2);
}

#[tokio::test]
async fn a_test_that_is_not_read_to_its_end_takes_its_alarm_with_it() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    judge_open(&store, run_id, vec![step(run_id, 1, Severity::Warning)]).await;
    assert_eq!(store.stale_robots().await.expect("robots"), []);
    assert!(store.give_up_run(run_id, "the file vanished").await.expect("an answer"));
    let stale = store.stale_robots().await.expect("robots");
    assert_eq!(stale.len(), 1, "it is judged without it");
    let mut conclusion = store.conclude(stale[0].robot_id).await.expect("a transaction");
    let events = conclusion.reconcile(&findings(vec![]), &[]).await.expect("findings").events;
    conclusion.commit(stale[0].history).await.expect("a commit");
    assert_eq!(events.iter().map(|event| event.what).collect::<Vec<_>>(), [Withdrawn]);
    assert_eq!(told(&store).await, "opened, withdrawn: the test was not read to its end");

    // a deleted test leaves no alarm either
    let run_id = streaming_run(&store, "R00", 2, 4).await;
    judge_open(&store, run_id, vec![step(run_id, 2, Severity::Warning)]).await;
    assert_eq!(store.stale_robots().await.expect("robots"), []);
    assert!(store.discard_run(run_id).await.expect("an answer"));
    assert_eq!(store.stale_robots().await.expect("robots").len(), 1);
}

#[tokio::test]
async fn a_start_that_is_known_at_the_end_makes_no_other_episode() {
    for hours in [-9, 9] {
        let (_folder, store) = fresh().await;
        let (_, run_id) = one_complete_one_open(&store, vec![]).await;
        judge_open(&store, run_id, vec![step(run_id, 1, Severity::Warning)]).await;
        let mut end = store.finish_run(run_id).await.expect("a transaction");
        let start = day(1) + jiff::SignedDuration::from_hours(hours);
        end.set_start(start).await.expect("a start");
        end.store_analysis(&run_analysis(1.0)).await.expect("an analysis");
        end.complete(totals(4)).await.expect("completion");
        end.commit().await.expect("a commit");
        let moved = Anomaly {
            first_seen_at: start,
            last_seen_at: start,
            onset: Onset { run_id, cycle: Some(3), at: start },
            ..step(run_id, 1, Severity::Warning)
        };
        let stale = store.stale_robots().await.expect("robots").remove(0);
        let mut conclusion = store.conclude(stale.robot_id).await.expect("a transaction");
        conclusion.reconcile(&findings(vec![moved]), &[]).await.expect("findings");
        conclusion.commit(stale.history).await.expect("a commit");
        assert_eq!(told(&store).await, "opened", "{hours} hours");
    }
}

#[tokio::test]
async fn an_alarm_that_ended_with_the_test_says_so() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    judge_open(&store, run_id, vec![step(run_id, 1, Severity::Warning)]).await;
    let ended = Anomaly { ended: true, ..step(run_id, 1, Severity::Warning) };
    finish(&store, run_id, 4, &findings(vec![ended])).await;
    assert_eq!(told(&store).await, format!("opened, {}", Ended.name()));
}

#[tokio::test]
async fn an_old_recording_is_not_the_latest_and_a_new_history_comes_first() {
    let (_folder, store) = fresh().await;
    let (_, run_id) = one_complete_one_open(&store, vec![]).await;
    let later = streaming_run(&store, "R00", 2, 1).await;
    sqlx::query(AssertSqlSafe(format!(
        "UPDATE run SET status = 'complete', rows = 1, cycles_total = cycles_stored WHERE run_id = {later}"
    )))
    .execute(&store.writer)
    .await
    .expect("an update");
    let test = store.open_test(run_id).await.expect("an answer").expect("an open test");
    assert!(!test.is_latest && !test.is_concluded);
}
