//! The life of anomalies: the assignment of found ones to stored ones, actions of people, and stored events.

use std::collections::HashSet;
use std::time::Duration;

use AlarmAction::{Acknowledge, FalseAlarm, Resolve, Shelve};
use EventKind::{Corrected, Ended, Opened, Reopened, Unshelved, Withdrawn, Worse};
use jiff::{SignedDuration, Timestamp};
use sqlx::AssertSqlSafe;

use super::support::{
    anomaly, assert_sound, day, findings, fresh, fresh_file, header, joint, number, streaming_run,
};
use crate::handle::Store;
use crate::robot::alarms::alarm_life::{AlarmAction, NotDone};
use crate::robot::alarms::alarm_state::{AlarmState, EventKind};
use crate::robot::alarms::anomalies::Reconciled;
use crate::robot::maintenance::NewMaintenance;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset, Severity};

/// The latest test of a robot, and the store that it is in.
pub(super) struct TestedRobot<'a> {
    store: &'a Store,
    name: String,
    robot_id: i64,
    /// Keys of runs, one per day from day 0 on.
    runs: Vec<i64>,
}

impl<'a> TestedRobot<'a> {
    pub(super) async fn with_runs(store: &'a Store, name: &str, days: usize) -> Self {
        let mut runs = Vec::new();
        for day in 0..days {
            let begun =
                store.begin_run(&header(name, i64::try_from(day).expect("few"))).await.expect("a run");
            runs.push(begun.run_id);
        }
        let robot_id: i64 = sqlx::query_scalar("SELECT robot_id FROM robot WHERE name = $1")
            .bind(name)
            .fetch_one(&store.readers)
            .await
            .expect("the robot");
        Self { store, name: name.into(), robot_id, runs }
    }

    /// Drift of joint 3, seen from one day to another.
    pub(super) fn drift(&self, from: usize, to: usize) -> Anomaly {
        let at = |days: usize| day(i64::try_from(days).expect("few"));
        Anomaly {
            quantity: Quantity::FrictionIndex,
            first_run_id: self.runs[from],
            last_run_id: self.runs[to],
            first_seen_at: at(from),
            last_seen_at: at(to),
            onset: Onset { run_id: self.runs[from], cycle: Some(2), at: at(from) },
            ..anomaly(joint(3), self.runs[from], Severity::Warning)
        }
    }

    pub(super) async fn reconcile(&self, anomalies: Vec<Anomaly>) -> Reconciled {
        let mut conclusion = self.store.conclude(self.robot_id).await.expect("a transaction");
        let outcome = conclusion.reconcile(&findings(anomalies), &[]).await.expect("findings");
        let history = conclusion.history().await.expect("a count");
        conclusion.commit(history).await.expect("a commit");
        outcome
    }

    /// Enters maintenance of a joint, or of the whole arm, and returns its key.
    pub(super) async fn repaired(&self, of: Option<usize>, at: i64) -> i64 {
        let new = NewMaintenance {
            robot: self.name.clone(),
            joint: of.map(joint),
            at: day(at),
            what: "gearbox changed".into(),
            who: Some("mueller".into()),
        };
        self.store.enter_maintenance(&new).await.expect("an entry").expect("the robot is known")
    }

    /// States of the shown anomalies, by number.
    pub(super) async fn states(&self) -> Vec<String> {
        self.shown().await.into_iter().map(|(_, _, state, _)| state).collect()
    }

    /// Anomalies that the next call of `end_shelving` opens.
    async fn looked_at(&self) -> Vec<(i64, EventKind)> {
        let opened = self.store.end_shelving(Timestamp::now()).await.expect("a look");
        opened.iter().map(|event| (event.anomaly_id, event.what)).collect()
    }

    /// Events caused by these findings.
    pub(super) async fn events(&self, anomalies: Vec<Anomaly>) -> Vec<EventKind> {
        self.reconcile(anomalies).await.events.iter().map(|event| event.what).collect()
    }

    /// Number, kind, state and first run of the shown anomalies.
    pub(super) async fn shown(&self) -> Vec<(i64, String, String, usize)> {
        let rows = self.store.anomalies_after(0).await.expect("anomalies");
        let of_robot = rows.into_iter().filter(|row| row.robot == self.name);
        let place = |run: Option<i64>| self.runs.iter().position(|id| Some(*id) == run).expect("a run");
        of_robot
            .map(|row| (row.anomaly_id, row.kind.to_string(), row.state.name().to_owned(), place(row.run_id)))
            .collect()
    }
}

async fn act(store: &Store, id: i64, action: AlarmAction) -> Result<(), NotDone> {
    store.act_on_anomalies(&[id], action, "mueller", Some("a reason")).await.expect("an answer").map(|_| ())
}

fn ended(of: Anomaly) -> Anomaly {
    Anomaly { ended: true, ..of }
}

#[tokio::test]
async fn an_episode_keeps_its_number_and_acknowledgement_while_the_history_is_refitted() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    let warm = Anomaly { quantity: Quantity::WarmFriction, ..robot.drift(6, 7) };
    assert_eq!(robot.events(vec![warm]).await, [Opened]);
    let [(id, ..)] = robot.shown().await[..] else { panic!("one") };
    act(&store, id, Acknowledge).await.expect("possible");
    // the first run moves either way, the quantity improves, the cause becomes clearer
    for first in [7, 5, 6] {
        assert_eq!(robot.events(vec![robot.drift(first, 8)]).await, []);
        assert_eq!(robot.shown().await, [(id, "drift".into(), "acknowledged".into(), first)]);
    }
    let step = Anomaly { kind: AnomalyKind::Step, odds: Some(900.0), ..robot.drift(6, 9) };
    assert_eq!(robot.events(vec![step.clone()]).await, [Corrected]);
    assert_eq!(robot.shown().await, [(id, "step".into(), "acknowledged".into(), 6)]);
    assert_eq!(robot.events(vec![ended(step)]).await, [Ended]);
    // a new episode after it is another one
    let later = robot.drift(11, 11);
    let step = ended(Anomaly { kind: AnomalyKind::Step, ..robot.drift(6, 9) });
    assert_eq!(robot.events(vec![step, later]).await, [Opened]);
    assert_eq!(robot.shown().await.len(), 2);
    let history = store.anomaly_history(id).await.expect("a history");
    let told: Vec<_> = history.iter().map(|row| (row.what, row.who.as_deref(), row.run_id)).collect();
    assert_eq!(
        told,
        [
            (Opened, None, Some(robot.runs[7])),
            (EventKind::Acknowledged, Some("mueller"), Some(robot.runs[7])),
            (Corrected, None, Some(robot.runs[9])),
            (Ended, None, Some(robot.runs[9])),
        ]
    );
    assert_eq!(history[1].why.as_deref(), Some("a reason"));
    assert_sound(&store).await;
}

#[tokio::test]
async fn what_gets_worse_is_written_down_once_a_step_and_never_by_a_refit_alone() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 4).await;
    let with = |score, severity| Anomaly { score, severity, ..robot.drift(0, 1) };
    assert_eq!(robot.events(vec![with(0.06, Severity::Warning)]).await, [Opened]);
    for (score, severity, expected) in [
        (0.06, Severity::Warning, vec![]),
        (0.08, Severity::Warning, vec![]),
        (0.091, Severity::Warning, vec![Worse]),
        (0.07, Severity::Warning, vec![]),
        (0.092, Severity::Warning, vec![]),
        (0.12, Severity::Critical, vec![Worse]),
        (0.10, Severity::Warning, vec![]),
        (0.12, Severity::Critical, vec![]),
        (-0.20, Severity::Critical, vec![Worse]),
    ] {
        assert_eq!(robot.events(vec![with(score, severity)]).await, expected, "{score} {severity}");
    }
    let rows = store.anomalies_after(0).await.expect("anomalies");
    assert_eq!((rows[0].score, rows[0].peak_score, rows[0].value), (Some(-0.20), Some(7.0), Some(13.0)));
}

#[tokio::test]
async fn what_people_said_holds_as_long_as_the_episode_and_no_longer() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 10).await;
    robot.reconcile(vec![robot.drift(2, 4)]).await;
    let [(id, ..)] = robot.shown().await[..] else { panic!("one") };
    let state = async || robot.shown().await[0].2.clone();

    act(&store, id, Resolve).await.expect("possible");
    assert_eq!(robot.events(vec![robot.drift(1, 4)]).await, [], "no later run shows it");
    assert_eq!(state().await, "resolved");
    assert_eq!(robot.events(vec![robot.drift(1, 5)]).await, [Reopened]);
    assert_eq!(state().await, "open");

    let soon = Timestamp::now() + SignedDuration::from_hours(1);
    act(&store, id, Shelve(soon)).await.expect("possible");
    assert_eq!(robot.events(vec![robot.drift(1, 6)]).await, []);
    assert_eq!(store.end_shelving(soon - SignedDuration::from_secs(1)).await.expect("a look"), []);
    assert_eq!(state().await, "shelved");
    let unshelved = store.end_shelving(soon).await.expect("a look");
    assert_eq!(unshelved.iter().map(|event| event.what).collect::<Vec<_>>(), [Unshelved]);
    assert_eq!(store.end_shelving(soon).await.expect("a look"), [], "said once");
    assert_eq!(state().await, "open");

    let in_days = |days: i64| soon + SignedDuration::from_hours(24 * days);
    act(&store, id, Shelve(in_days(3000))).await.expect("possible: a rise of its severity ends it");
    let critical = Anomaly { severity: Severity::Critical, ..robot.drift(1, 7) };
    assert_eq!(robot.events(vec![critical.clone()]).await, [Unshelved, Worse]);
    assert_eq!(act(&store, id, Shelve(in_days(90))).await, Err(NotDone::TooLong(id)));
    assert_eq!(state().await, "open");
    act(&store, id, Shelve(in_days(89))).await.expect("possible");

    act(&store, id, FalseAlarm).await.expect("possible");
    for found in [critical.clone(), ended(critical.clone()), critical.clone()] {
        assert_eq!(robot.events(vec![found]).await, []);
        assert_eq!(state().await, "false_alarm");
    }
    // withdrawn and found again, it stays one
    assert_eq!(robot.events(vec![]).await, [Withdrawn]);
    assert_eq!(robot.shown().await, []);
    assert_eq!(robot.events(vec![critical]).await, []);
    assert_eq!(robot.shown().await[0], (id, "drift".into(), "false_alarm".into(), 1));
}

#[tokio::test]
async fn work_puts_what_began_before_it_into_maintenance_until_a_later_run_shows_it_or_none_does() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    let at_joint =
        |number: Option<usize>, to: usize| Anomaly { joint: number.map(joint), ..robot.drift(2, to) };
    let found = |of_third: usize| vec![at_joint(Some(1), 4), at_joint(Some(3), of_third), at_joint(None, 4)];
    assert_eq!(robot.events(found(4)).await, [Opened; 3]);
    let [(first, ..), (third, ..), (arm, ..)] = robot.shown().await[..] else { panic!("three") };
    act(&store, first, Acknowledge).await.expect("possible");
    act(&store, third, Shelve(Timestamp::now() + SignedDuration::from_hours(1))).await.expect("possible");
    // maintenance does not apply to an anomaly that began with it or after it
    robot.repaired(Some(3), 2).await;
    assert_eq!(robot.states().await, ["acknowledged", "shelved", "open"]);
    robot.repaired(Some(3), 5).await;
    assert_eq!(robot.states().await, ["acknowledged", "maintenance", "open"]);
    let history = store.anomaly_history(third).await.expect("a history");
    let entered = history.last().expect("an event");
    assert_eq!(
        (entered.what, entered.who.as_deref(), entered.why.as_deref()),
        (EventKind::Maintenance, Some("mueller"), Some("gearbox changed"))
    );
    // no one is reminded of it, and it gets worse without an event
    let later = Timestamp::now() + SignedDuration::from_hours(48);
    let reminded = store.remind(later, Duration::from_secs(86_400)).await.expect("a look");
    assert_eq!(reminded, 1, "of the whole arm's");
    let worse = Anomaly { severity: Severity::Critical, score: 70.0, ..at_joint(Some(3), 4) };
    assert_eq!(robot.events(vec![at_joint(Some(1), 4), worse, at_joint(None, 4)]).await, []);
    assert!(robot.looked_at().await.is_empty(), "no run was after the work");
    // a test after the maintenance still shows it
    assert_eq!(robot.events(found(6)).await, []);
    assert_eq!(robot.looked_at().await, [(third, Reopened)]);
    assert!(robot.looked_at().await.is_empty(), "said once");
    assert_eq!(robot.states().await, ["acknowledged", "open", "open"]);
    // maintenance of the arm is maintenance of all joints
    robot.repaired(None, 8).await;
    assert_eq!(robot.states().await, ["maintenance"; 3]);
    assert_eq!(robot.events(found(6).into_iter().map(ended).collect()).await, [Ended; 3]);
    assert_eq!(robot.states().await, ["resolved"; 3]);
    let told = store.anomaly_history(arm).await.expect("a history");
    let told: Vec<EventKind> = told.iter().map(|row| row.what).collect();
    assert_eq!(told, [Opened, EventKind::Overdue, EventKind::Maintenance, Ended]);
    assert_sound(&store).await;
}

#[tokio::test]
async fn work_that_is_entered_late_waits_for_the_conclusions_that_it_changes() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 8).await;
    robot.reconcile(vec![robot.drift(2, 6)]).await;
    robot.repaired(Some(3), 4).await;
    assert_eq!((robot.states().await, robot.looked_at().await), (vec!["maintenance".to_owned()], vec![]));
    // the maintenance begins an epoch, and runs from then on do not show it
    assert_eq!(robot.events(vec![ended(robot.drift(2, 3))]).await, [Ended]);
    assert_eq!((robot.states().await, robot.looked_at().await), (vec!["resolved".to_owned()], vec![]));
}

#[tokio::test]
async fn work_that_is_taken_back_opens_what_is_in_maintenance_by_nothing_else() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 8).await;
    let found = || vec![robot.drift(2, 4)];
    robot.reconcile(found()).await;
    let [(id, ..)] = robot.shown().await[..] else { panic!("one") };
    let taken_back = async |entry: i64| {
        store.remove_maintenance(entry).await.expect("an answer").expect("the entry");
    };
    let (of_joint, of_arm) = (robot.repaired(Some(3), 5).await, robot.repaired(None, 6).await);
    taken_back(of_joint).await;
    assert_eq!(robot.states().await, ["maintenance"], "by the other entry");
    taken_back(of_arm).await;
    assert_eq!(robot.states().await, ["open"]);
    let history = store.anomaly_history(id).await.expect("a history");
    let told: Vec<EventKind> = history.iter().map(|row| row.what).collect();
    assert_eq!(told, [Opened, EventKind::Maintenance, Reopened]);
    // later answers of people stay
    let entry = robot.repaired(Some(3), 5).await;
    act(&store, id, Acknowledge).await.expect("possible");
    taken_back(entry).await;
    assert_eq!(robot.states().await, ["acknowledged"]);
    // an anomaly withdrawn because of the maintenance is found again as open
    let entry = robot.repaired(None, 3).await;
    assert_eq!(robot.events(vec![]).await, [Withdrawn]);
    taken_back(entry).await;
    assert_eq!(robot.events(found()).await, [Reopened]);
    assert_eq!(robot.states().await, ["open"]);
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_withdrawn_anomaly_colours_nothing_and_comes_back_as_it_was() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let critical = findings(vec![anomaly(joint(1), run_id, Severity::Critical)]);
    super::support::finish(&store, run_id, 1, &critical).await;
    let id = store.anomalies_after(0).await.expect("anomalies")[0].anomaly_id;
    act(&store, id, Acknowledge).await.expect("possible");
    let status = async || {
        let rows = store.fleet_health().await.expect("health");
        (
            rows[0].status.name(),
            rows[0].reason.is_some(),
            store.counts().await.expect("counts").open_anomalies,
        )
    };
    assert_eq!(status().await, ("critical", true, 0));
    super::support::finish(&store, run_id, 1, &findings(vec![])).await;
    assert_eq!(status().await, ("ok", false, 0));
    assert_eq!(store.anomalies_after(0).await.expect("anomalies"), []);
    let gone = store.act_on_anomalies(&[id], Resolve, "mueller", None).await.expect("an answer");
    assert_eq!(gone, Err(NotDone::Withdrawn(id)));
    super::support::finish(&store, run_id, 1, &critical).await;
    let back = &store.anomalies_after(0).await.expect("anomalies")[0];
    assert_eq!((back.anomaly_id, back.state.name()), (id, "acknowledged"));
    let events = "SELECT count(*) FROM anomaly_history WHERE what IN ('opened', 'withdrawn', 'reopened')";
    assert_eq!(number(&store, events).await, Some(3.0));
}

#[tokio::test]
async fn an_alarm_of_a_joint_that_is_told_of_the_arm_says_so_when_it_is_withdrawn() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 6).await;
    let swing = |from, to| Anomaly {
        kind: AnomalyKind::Oscillation,
        quantity: Quantity::FrictionSwing,
        ..robot.drift(from, to)
    };
    robot.reconcile(vec![swing(1, 4)]).await;
    let of_arm = Anomaly { joint: None, ..swing(2, 5) };
    robot.reconcile(vec![of_arm]).await;
    let events: Vec<(String, Option<String>)> =
        sqlx::query_as("SELECT what, why FROM anomaly_history ORDER BY anomaly_event_id")
            .fetch_all(&store.readers)
            .await
            .expect("events");
    let expected =
        [("opened", None), ("withdrawn", Some("part of one alarm of the arm now")), ("opened", None)];
    assert_eq!(events, expected.map(|(what, why)| (what.to_owned(), why.map(str::to_owned))));
}

#[tokio::test]
async fn what_monitoring_and_the_dashboard_hear_is_what_is_not_settled() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let of = |number: usize, severity: Severity| anomaly(joint(number), run_id, severity);
    let mut found = vec![
        of(1, Severity::Critical),
        of(2, Severity::Warning),
        of(3, Severity::Warning),
        ended(of(4, Severity::Critical)),
        of(5, Severity::Info),
        of(6, Severity::Info),
    ];
    super::support::finish(&store, run_id, 1, &findings(found.clone())).await;
    let key = async |number: usize| {
        let rows = store.anomalies_after(0).await.expect("anomalies");
        rows.iter().find(|row| row.joint == Some(joint(number))).map(|row| row.anomaly_id)
    };
    act(&store, key(3).await.expect("found"), Acknowledge).await.expect("possible");
    act(&store, key(5).await.expect("found"), FalseAlarm).await.expect("possible");
    // withdrawn
    found.pop();
    super::support::finish(&store, run_id, 1, &findings(found)).await;
    let counts = store.unsettled_counts().await.expect("counts");
    let counts: Vec<_> =
        counts.iter().map(|of| (of.severity.name(), of.state.as_str(), of.anomalies)).collect();
    assert_eq!(counts, [("critical", "open", 1), ("warning", "acknowledged", 1), ("warning", "open", 1)]);
    let told = store.unsettled_anomalies(10).await.expect("rows");
    let mut joints: Vec<u64> = told.objects().filter_map(|row| row["joint"].as_u64()).collect();
    joints.sort_unstable();
    assert_eq!(joints, [1, 2, 3]);
    assert_eq!(store.unsettled_anomalies(2).await.expect("rows").rows.len(), 2);
}

#[tokio::test]
async fn what_ended_before_it_was_found_is_no_news_until_it_goes_on() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 10).await;
    assert_eq!(robot.events(vec![ended(robot.drift(2, 4))]).await, []);
    assert_eq!(robot.shown().await[0].2, "resolved");
    assert_eq!(robot.events(vec![]).await, [], "nor is that it is none");
    assert_eq!(robot.events(vec![ended(robot.drift(2, 4))]).await, []);
    assert_eq!(robot.events(vec![robot.drift(2, 6)]).await, [Opened]);
}

#[tokio::test]
async fn an_action_is_done_to_all_or_to_none_and_only_where_it_makes_sense() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 5).await;
    let other = Anomaly { joint: None, ..ended(robot.drift(1, 2)) };
    robot.reconcile(vec![robot.drift(1, 4), other]).await;
    let [(open, ..), (past, ..)] = robot.shown().await[..] else { panic!("two") };
    let answer = async |ids: &[i64], action| {
        store
            .act_on_anomalies(ids, action, "mueller", None)
            .await
            .expect("an answer")
            .map(|events| events.len())
    };
    let not_from = |anomaly_id, state, ended| Err(NotDone::NotFrom { anomaly_id, state, ended });
    let events = "SELECT count(*) FROM anomaly_event WHERE who IS NOT NULL";
    assert_eq!(answer(&[open, 99], Acknowledge).await, Err(NotDone::Unknown(99)));
    assert_eq!(answer(&[open, past], Acknowledge).await, not_from(past, AlarmState::Resolved, true));
    assert_eq!((number(&store, events).await, robot.shown().await[0].2.as_str()), (Some(0.0), "open"));
    assert_eq!(answer(&[open], Acknowledge).await, Ok(1));
    assert_eq!(answer(&[open], Acknowledge).await, not_from(open, AlarmState::Acknowledged, false));
    assert_eq!(answer(&[open, past], FalseAlarm).await, Ok(2));
    assert_eq!(answer(&[open], Shelve(day(900))).await, not_from(open, AlarmState::FalseAlarm, false));
    assert_eq!(answer(&[open], Acknowledge).await, Ok(1), "a false alarm is taken back");
    assert_eq!(number(&store, events).await, Some(4.0));
}

#[tokio::test]
async fn an_anomaly_outlives_its_runs_with_what_people_said() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 5).await;
    robot.reconcile(vec![robot.drift(1, 3)]).await;
    let [(id, ..)] = robot.shown().await[..] else { panic!("one") };
    act(&store, id, Acknowledge).await.expect("possible");
    assert!(store.discard_run(robot.runs[1]).await.expect("an answer"));
    let row = &store.anomalies_after(0).await.expect("anomalies")[0];
    assert_eq!((row.anomaly_id, row.run_id, row.state.name()), (id, None, "acknowledged"));
    assert_eq!(robot.events(vec![robot.drift(2, 3)]).await, []);
    assert_eq!(robot.shown().await, [(id, "drift".into(), "acknowledged".into(), 2)]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn programs_that_conclude_the_same_at_once_write_it_down_once() {
    let (folder, store) = fresh_file().await;
    let robot = TestedRobot::with_runs(&store, "R00", 8).await;
    let path = folder.path().join("fleet.db");
    for last in [3, 5, 7] {
        let found = Anomaly { score: f64::from(1_u32 << last), ..robot.drift(2, last) };
        let tasks: Vec<_> = (0..4)
            .map(|_| {
                let (path, robot_id, found) = (path.clone(), robot.robot_id, findings(vec![found.clone()]));
                tokio::spawn(async move {
                    let own = Store::open(&path).await.expect("a store of its own");
                    let mut conclusion = own.conclude(robot_id).await.expect("a transaction");
                    let events = conclusion.reconcile(&found, &[]).await.expect("findings").events.len();
                    conclusion.commit(0).await.expect("a commit");
                    events
                })
            })
            .collect();
        let mut events = 0;
        for task in tasks {
            events += task.await.expect("no panic");
        }
        assert_eq!(events, 1, "with run {last}");
    }
    assert_eq!(number(&store, "SELECT count(*) FROM anomaly").await, Some(1.0));
    let told = super::support::text(&store, "SELECT string_agg(what, ',') FROM anomaly_history").await;
    assert_eq!(told.as_deref(), Some("opened,worse,worse"));
}

/// Possible findings of a detector for the known runs. It compares with the mean of the first two, so a run that
/// arrives late changes the findings of later ones. Two quiet runs end an episode.
fn judged(robot: &TestedRobot<'_>, known: &[usize], levels: &[f64]) -> Vec<Anomaly> {
    let mut known = known.to_vec();
    known.sort_unstable();
    let Some([first, second]) = known.first_chunk() else { return Vec::new() };
    let baseline = (levels[*first] + levels[*second]) / 2.0;
    let mut found: Vec<Anomaly> = Vec::new();
    let mut quiet = 2;
    for &run in &known[2..] {
        let score = (levels[run] / baseline - 1.0).abs();
        if score < 0.05 {
            quiet += 1;
            if quiet >= 2 {
                found.iter_mut().for_each(|anomaly| anomaly.ended = true);
            }
            continue;
        }
        let severity = if score > 0.15 { Severity::Critical } else { Severity::Warning };
        let kind = if known.len() > 4 { AnomalyKind::Step } else { AnomalyKind::Drift };
        let now = Anomaly { severity, kind, score, peak_score: score, baseline, ..robot.drift(run, run) };
        match found.last_mut().filter(|_| quiet < 2) {
            Some(open) => open.go_on(now),
            None => found.push(now),
        }
        quiet = 0;
    }
    found
}

/// Every order of `0..count`.
fn orders(count: usize) -> Vec<Vec<usize>> {
    if count == 0 {
        return vec![Vec::new()];
    }
    let inserted = |order: Vec<usize>| {
        (0..count).map(move |place| {
            let mut longer = order.clone();
            longer.insert(place, count - 1);
            longer
        })
    };
    orders(count - 1).into_iter().flat_map(inserted).collect()
}

#[tokio::test]
async fn runs_in_any_order_show_what_all_at_once_show() {
    for levels in [[1.0, 1.0, 1.2, 1.0, 1.0, 1.1], [1.0, 1.02, 1.07, 1.1, 1.2, 1.3]] {
        let (_folder, store) = fresh().await;
        let shown = async |name: &str| -> Vec<String> {
            let query = format!(
                "SELECT joint || kind || quantity || severity || score || threshold || value || baseline || first_seen_at
                        || last_seen_at || state || message || peak_value || onset_at || peak_score || ended
                        || (SELECT started_at FROM runs WHERE runs.run_id = anomalies.run_id)
                        || (SELECT started_at FROM runs WHERE runs.run_id = anomalies.last_run_id)
                        || (SELECT started_at FROM runs WHERE runs.run_id = anomalies.onset_run_id)
                 FROM anomalies WHERE robot = '{name}' ORDER BY 1"
            );
            sqlx::query_scalar(AssertSqlSafe(query)).fetch_all(&store.readers).await.expect("rows")
        };
        let at_once = TestedRobot::with_runs(&store, "once", levels.len()).await;
        at_once.reconcile(judged(&at_once, &[0, 1, 2, 3, 4, 5], &levels)).await;
        let expected = shown("once").await;
        assert!(!expected.is_empty() && expected.iter().all(|row| row.len() > 100), "{expected:?}");
        let mut lives = HashSet::new();
        for (n, order) in orders(levels.len()).iter().enumerate().step_by(7) {
            let robot = TestedRobot::with_runs(&store, &format!("R{n}"), levels.len()).await;
            let mut life = String::new();
            for arrived in 1..=order.len() {
                let events = robot.events(judged(&robot, &order[..arrived], &levels)).await;
                let again = robot.events(judged(&robot, &order[..arrived], &levels)).await;
                assert_eq!(again, [], "{order:?} up to {arrived}");
                events.iter().for_each(|what| life.push_str(what.name()));
            }
            lives.insert(life);
            assert_eq!(shown(&robot.name).await, expected, "{order:?}");
        }
        assert!(lives.len() > 5, "the orders differ on the way: {lives:?}");
        assert_sound(&store).await;
    }
}
