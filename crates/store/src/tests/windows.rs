//! Planned windows, comments, assignees and corrected entries of maintenance.

use EventKind::{Opened, Reopened};
use jiff::{SignedDuration, Timestamp};

use super::anomalies::TestedRobot;
use super::support::{day, fresh, joint};
use crate::robot::alarms::alarm_life::NotDone;
use crate::robot::alarms::alarm_state::{AlarmState, EventKind};
use crate::robot::maintenance::NewMaintenance;
use crate::robot::windows::NewWindow;
use armwatch_model::anomaly::Anomaly;

#[tokio::test]
async fn a_window_holds_alarms_of_its_place_until_its_end() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    let now = Timestamp::now();
    let in_hours = |hours: i64| now + SignedDuration::from_hours(hours);
    let window = |of: usize, from: i64, until: i64| NewWindow {
        robot: "R00".into(),
        joint: Some(joint(of)),
        from: in_hours(from),
        until: in_hours(until),
        what: "gearbox is changed".into(),
        who: "mueller".into(),
    };
    store.plan_window(&window(3, -1, 2), now).await.expect("a plan").expect("the robot is known");
    store.plan_window(&window(4, 1, 2), now).await.expect("a plan").expect("the robot is known");
    let unknown = NewWindow { robot: "R99".into(), ..window(3, 0, 1) };
    assert_eq!(store.plan_window(&unknown, now).await.expect("an answer"), None);
    let of_fourth = || Anomaly { joint: Some(joint(4)), ..robot.drift(2, 4) };
    let found = |to: usize| vec![robot.drift(2, to), of_fourth()];
    // found in the window: put into maintenance in the same transaction, so that no message is sent in between
    assert_eq!(robot.events(found(4)).await, [Opened, Opened, EventKind::Maintenance]);
    assert_eq!(robot.states().await, ["maintenance", "open"]);
    let [(third, ..), (fourth, ..)] = robot.shown().await[..] else { panic!("two") };
    assert_eq!(robot.events(found(5)).await, [], "a later test in the window changes nothing");
    let look = async |hours: i64| -> Vec<(i64, EventKind)> {
        let events = store.end_shelving(in_hours(hours)).await.expect("a look");
        events.iter().map(|event| (event.anomaly_id, event.what)).collect()
    };
    // the second window begins, then both end
    assert_eq!(look(1).await, [(fourth, EventKind::Maintenance)]);
    assert_eq!(look(2).await, [(third, Reopened), (fourth, Reopened)]);
    assert_eq!(robot.states().await, ["open", "open"]);
    assert_eq!(look(3).await, []);
}

#[tokio::test]
async fn work_done_in_a_window_outlasts_it_and_a_cancelled_window_holds_nothing() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    let now = Timestamp::now();
    let until = now + SignedDuration::from_hours(1);
    let (from, what) = (now - SignedDuration::from_hours(1), "gearbox is changed".to_owned());
    let window = NewWindow { robot: "R00".into(), joint: None, from, until, what, who: "mueller".into() };
    robot.reconcile(vec![robot.drift(2, 4)]).await;
    let planned = store.plan_window(&window, now).await.expect("a plan").expect("the robot is known");
    assert_eq!(robot.states().await, ["maintenance"], "it was open when the window was planned");
    assert!(store.cancel_window(planned, now).await.expect("an answer"));
    assert!(!store.cancel_window(planned, now).await.expect("an answer"), "it is gone");
    assert_eq!(robot.states().await, ["open"]);
    store.plan_window(&window, now).await.expect("a plan");
    robot.repaired(Some(3), 5).await;
    assert_eq!(store.end_shelving(until).await.expect("a look"), [], "the work holds it");
    assert_eq!(robot.states().await, ["maintenance"]);
}

#[tokio::test]
async fn a_comment_and_a_person_change_no_state() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    robot.reconcile(vec![robot.drift(2, 4)]).await;
    let [(id, ..)] = robot.shown().await[..] else { panic!("one") };
    store.comment_on_anomaly(id, "mueller", "grease is ordered").await.expect("an answer").expect("possible");
    store.assign_anomaly(id, Some("Lena"), "mueller").await.expect("an answer").expect("possible");
    let row = store.anomalies_after(0).await.expect("anomalies").remove(0);
    assert_eq!((row.state, row.assignee.as_deref()), (AlarmState::Open, Some("Lena")));
    let history = store.anomaly_history(id).await.expect("a history");
    let told: Vec<_> = history.iter().skip(1).map(|row| (row.what.name(), row.why.as_deref())).collect();
    assert_eq!(told, [("commented", Some("grease is ordered")), ("assigned", Some("Lena"))]);
    // conclusions keep the assignee
    assert_eq!(robot.events(vec![robot.drift(2, 6)]).await, []);
    assert_eq!(store.anomalies_after(0).await.expect("anomalies")[0].assignee.as_deref(), Some("Lena"));
    store.assign_anomaly(id, None, "mueller").await.expect("an answer").expect("possible");
    assert_eq!(store.anomalies_after(0).await.expect("anomalies")[0].assignee, None);
    let unknown = store.comment_on_anomaly(99, "mueller", "none").await.expect("an answer");
    assert_eq!(unknown.expect_err("no such anomaly"), NotDone::Unknown(99));
}

#[tokio::test]
async fn a_corrected_entry_of_work_stands_as_if_it_had_been_entered_so() {
    let (_folder, store) = fresh().await;
    let robot = TestedRobot::with_runs(&store, "R00", 12).await;
    robot.reconcile(vec![robot.drift(2, 4), Anomaly { joint: Some(joint(4)), ..robot.drift(2, 4) }]).await;
    let entered = robot.repaired(Some(3), 5).await;
    assert_eq!(robot.states().await, ["maintenance", "open"]);
    let work = |of: usize, what: &str| NewMaintenance {
        robot: "R00".into(),
        joint: Some(joint(of)),
        at: day(5),
        what: what.into(),
        who: Some("Lena".into()),
    };
    let edited = store.edit_maintenance(entered, &work(3, "grease renewed")).await.expect("an answer");
    assert_eq!(edited, Some(Ok(entered)), "words alone change");
    assert_eq!(robot.states().await, ["maintenance", "open"]);
    let moved = store.edit_maintenance(entered, &work(4, "grease renewed")).await.expect("an answer");
    assert!(matches!(moved, Some(Ok(other)) if other != entered), "{moved:?}");
    assert_eq!(robot.states().await, ["open", "maintenance"]);
    let rows = store.maintenance(Some("R00")).await.expect("entries");
    let said: Vec<_> = rows.iter().map(|row| (row.work.joint, row.work.what.as_str())).collect();
    assert_eq!(said, [(Some(joint(4)), "grease renewed")]);
    assert_eq!(store.edit_maintenance(entered, &work(3, "none")).await.expect("an answer"), None);
}
