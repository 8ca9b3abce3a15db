//! The outbox against a real database; moments are given, so that hours pass at once.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use tempfile::TempDir;

use super::alarm::AlarmEvent;
use super::queue::{Again, DueMessage};
use super::routes::{Fate, Held};
use crate::anomaly::Severity;
use crate::store::handle::Store;
use crate::store::tests::support::{assert_sound, day, fresh};

const DAY: Duration = Duration::from_secs(86_400);

struct Outbox {
    _folder: TempDir,
    store: Store,
}

impl Outbox {
    async fn new() -> Self {
        let (folder, store) = fresh().await;
        sqlx::query("INSERT INTO robot (name) VALUES ('R01')").execute(&store.writer).await.expect("a robot");
        Self { _folder: folder, store }
    }

    async fn anomaly(&self) -> i64 {
        sqlx::query_scalar(
            "INSERT INTO anomaly (robot_id, joint, kind, quantity, severity, score, threshold, value, baseline,
                                  peak_value, first_seen_at, last_seen_at, state, message)
             VALUES (1, 3, 'drift', 'friction_index', 'warning', 0.2, 0.05, 1.2, 1.0, 1.3, $1, $1, 'open', 'friction rose')
             RETURNING anomaly_id",
        )
        .bind(day(0).as_microsecond())
        .fetch_one(&self.store.writer)
        .await
        .expect("an anomaly")
    }

    async fn event(&self, anomaly_id: i64, what: &str, at: Timestamp) -> i64 {
        sqlx::query_scalar(
            "INSERT INTO anomaly_event (anomaly_id, at, what, severity, score, value, message)
             VALUES ($1, $2, $3, 'warning', 0.2, 1.2, 'friction rose') RETURNING anomaly_event_id",
        )
        .bind(anomaly_id)
        .bind(at.as_microsecond())
        .bind(what)
        .fetch_one(&self.store.writer)
        .await
        .expect("an event")
    }

    async fn state(&self, anomaly_id: i64, state: &'static str) {
        let statement = sqlx::query("UPDATE anomaly SET state = $1 WHERE anomaly_id = $2");
        statement.bind(state).bind(anomaly_id).execute(&self.store.writer).await.expect("a state");
    }

    async fn route(&self, name: &str, now: Timestamp) -> i64 {
        self.store.enter_route(name, now, |_| now_(now)).await.expect("a route").route_id
    }

    async fn hand_on(&self, route_id: i64, now: Timestamp, judge: impl Fn(&AlarmEvent) -> Fate) {
        while self.store.hand_on(route_id, now, &judge).await.expect("handed on") {}
    }

    async fn next(&self, route_id: i64, now: Timestamp) -> Option<DueMessage> {
        self.store.next_message(route_id, now).await.expect("the queue")
    }

    /// Takes everything that is due, as a receiver that is there; events by message.
    async fn take(&self, route_id: i64, now: Timestamp) -> Vec<Vec<i64>> {
        let mut taken = Vec::new();
        while let Some(message) = self.next(route_id, now).await {
            self.store.begin_attempt(&message, now).await.expect("an attempt");
            self.store.mark_sent(route_id, &message, now).await.expect("a mark");
            taken.push(message.alarms.iter().map(|alarm| alarm.event_id).collect());
        }
        taken
    }

    async fn fail(&self, route_id: i64, message: &DueMessage, again: Again, now: Timestamp) -> bool {
        self.store.begin_attempt(message, now).await.expect("an attempt");
        self.store.mark_failed(route_id, message, "no answer", again, (now, 3 * DAY)).await.expect("a mark")
    }

    async fn states(&self) -> Vec<String> {
        sqlx::query_scalar("SELECT state || coalesce(' ' || held, '') FROM deliveries ORDER BY delivery_id")
            .fetch_all(&self.store.readers)
            .await
            .expect("states")
    }
}

fn now_(now: Timestamp) -> Fate {
    Fate::Send { due_at: now, held: None }
}

#[tokio::test]
async fn a_new_route_begins_with_what_is_open_and_an_old_one_goes_on() {
    let outbox = Outbox::new().await;
    let (open, ended, answered) = (outbox.anomaly().await, outbox.anomaly().await, outbox.anomaly().await);
    outbox.event(open, "opened", day(0)).await;
    let worse = outbox.event(open, "worse", day(1)).await;
    outbox.event(ended, "opened", day(0)).await;
    outbox.event(ended, "ended", day(1)).await;
    outbox.state(ended, "resolved").await;
    outbox.event(answered, "opened", day(0)).await;
    outbox.event(answered, "acknowledged", day(0)).await;
    outbox.state(answered, "acknowledged").await;
    let route = outbox.route("shift", day(2)).await;
    outbox.hand_on(route, day(2), |_| now_(day(2))).await;
    assert_eq!(outbox.take(route, day(2)).await, [[worse]]);
    // started again, nothing is said twice; what happened meanwhile is
    let ended = outbox.event(open, "ended", day(3)).await;
    assert_eq!(outbox.route("shift", day(3)).await, route);
    outbox.hand_on(route, day(3), |_| now_(day(3))).await;
    assert_eq!(outbox.take(route, day(3)).await, [[ended]]);
    outbox.hand_on(route, day(3), |_| now_(day(3))).await;
    assert_eq!(outbox.take(route, day(3)).await, [[0_i64; 0]; 0]);
    assert_sound(&outbox.store).await;
}

#[tokio::test]
async fn an_alarm_ends_once_and_only_where_it_was_told() {
    let outbox = Outbox::new().await;
    let (told, other) = (outbox.route("told", day(0)).await, outbox.route("other", day(0)).await);
    let anomaly = outbox.anomaly().await;
    let opened = outbox.event(anomaly, "opened", day(0)).await;
    let ended = outbox.event(anomaly, "ended", day(1)).await;
    outbox.event(anomaly, "resolved", day(1)).await;
    for (route, wants) in [(told, true), (other, false)] {
        // as routes do: they want every end, and the store knows whether there was a beginning
        let judge = |event: &AlarmEvent| {
            if wants || event.what.closes() { now_(day(1)) } else { Fate::Nothing }
        };
        outbox.hand_on(route, day(1), judge).await;
    }
    assert_eq!(outbox.take(told, day(1)).await, [[opened], [ended]]);
    assert_eq!(outbox.take(other, day(1)).await, [[0_i64; 0]; 0]);
}

#[tokio::test]
async fn what_is_taken_back_before_it_was_sent_is_not_sent() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let anomaly = outbox.anomaly().await;
    outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| Fate::Send { due_at: day(1), held: Some(Held::Quiet) }).await;
    outbox.event(anomaly, "withdrawn", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    assert_eq!(outbox.take(route, day(2)).await, [[0_i64; 0]; 0]);
    assert_eq!(outbox.states().await, ["suppressed quiet"]);
}

#[tokio::test]
async fn a_refused_message_lets_others_pass_and_keeps_its_own_anomaly_in_order() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let (first, second) = (outbox.anomaly().await, outbox.anomaly().await);
    let opened = outbox.event(first, "opened", day(0)).await;
    let worse = outbox.event(first, "worse", day(0)).await;
    let other = outbox.event(second, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    let message = outbox.next(route, day(0)).await.expect("a message");
    assert_eq!(message.alarms[0].event_id, opened);
    assert!(!outbox.fail(route, &message, Again::Message(day(1)), day(0)).await);
    assert_eq!(outbox.take(route, day(0)).await, [[other]]);
    assert_eq!(outbox.take(route, day(1)).await, [[opened], [worse]]);
}

#[tokio::test]
async fn a_receiver_that_is_away_is_tried_for_days_and_then_given_up() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let anomaly = outbox.anomaly().await;
    outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    for days in 0..3 {
        let message = outbox.next(route, day(days)).await.expect("still there");
        assert!(!outbox.fail(route, &message, Again::Route(day(days + 1)), day(days)).await);
        let state = outbox.store.route_state(route, day(0)).await.expect("a state");
        assert_eq!((i64::from(state.failures), state.retry_at), (days + 1, Some(day(days + 1))));
    }
    let message = outbox.next(route, day(3)).await.expect("still there");
    assert_eq!(message.attempts, 3);
    assert!(outbox.fail(route, &message, Again::Route(day(4)), day(3)).await, "given up after three days");
    assert_eq!(outbox.next(route, day(9)).await, None);
    assert_eq!(outbox.states().await, ["failed"]);
}

#[tokio::test]
async fn what_a_flood_holds_becomes_one_message_that_stays_the_same() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let mut events = Vec::new();
    for _ in 0..5 {
        let anomaly = outbox.anomaly().await;
        events.push(outbox.event(anomaly, "opened", day(0)).await);
    }
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    for event in &events[..2] {
        let message = outbox.next(route, day(0)).await.expect("a message");
        outbox.store.mark_sent(route, &message, day(0)).await.expect("a mark");
        assert_eq!(message.alarms[0].event_id, *event);
    }
    let hour = SignedDuration::from_hours(1);
    let state = outbox.store.route_state(route, day(0) - hour).await.expect("a state");
    assert_eq!((state.sent, state.first_sent_at), (2, Some(day(0))));
    assert_eq!(outbox.store.hold(route, day(0), day(0) + hour, Held::Flood).await.expect("held"), 3);
    assert_eq!(outbox.next(route, day(0)).await, None);
    let digest = outbox.next(route, day(0) + hour).await.expect("a digest");
    let of = |message: &DueMessage| message.alarms.iter().map(|alarm| alarm.event_id).collect::<Vec<_>>();
    assert_eq!((of(&digest), digest.digest), (events[2..].to_vec(), Some(events[4])));
    // one that comes later is not in it, whatever became of the first attempt
    outbox.store.begin_attempt(&digest, day(0) + hour).await.expect("an attempt");
    let anomaly = outbox.anomaly().await;
    let late = outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0) + hour, |_| now_(day(0))).await;
    let first = outbox.next(route, day(0) + hour).await.expect("a message");
    assert_eq!(of(&first), [late], "what was tried less comes first");
    outbox.store.mark_sent(route, &first, day(0) + hour).await.expect("a mark");
    let again = outbox.next(route, day(0) + hour).await.expect("the digest");
    assert_eq!((of(&again), again.digest), (of(&digest), digest.digest));
    outbox.store.mark_sent(route, &again, day(0) + hour).await.expect("a mark");
    let state = outbox.store.route_state(route, day(0)).await.expect("a state");
    assert_eq!(state.sent, 2, "a digest counts once");
}

#[tokio::test]
async fn a_digest_route_sends_one_message_a_day() {
    let outbox = Outbox::new().await;
    let route = outbox.route("daily", day(0)).await;
    let hour = SignedDuration::from_hours(1);
    let mut events = Vec::new();
    for _ in 0..3 {
        let anomaly = outbox.anomaly().await;
        events.push(outbox.event(anomaly, "opened", day(0)).await);
        outbox
            .hand_on(route, day(0), |_| Fate::Send { due_at: day(0) + hour, held: Some(Held::Digest) })
            .await;
    }
    assert_eq!(outbox.next(route, day(0)).await, None);
    assert_eq!(outbox.take(route, day(0) + hour).await, [events]);
}

#[tokio::test]
async fn an_open_alarm_without_an_answer_speaks_again_and_again() {
    let outbox = Outbox::new().await;
    let (silent, answered) = (outbox.anomaly().await, outbox.anomaly().await);
    for anomaly in [silent, answered] {
        outbox.event(anomaly, "opened", day(0)).await;
    }
    outbox.state(answered, "acknowledged").await;
    let almost = day(1) - SignedDuration::from_secs(1);
    let remind = |now| outbox.store.remind(now, DAY);
    assert_eq!(remind(almost).await.expect("a look"), 0);
    assert_eq!(remind(day(1)).await.expect("a look"), 1);
    assert_eq!(remind(day(1)).await.expect("a look"), 0, "once a day");
    assert_eq!(remind(day(2)).await.expect("a look"), 1);
    let told: Vec<String> = sqlx::query_scalar(
        "SELECT anomaly_id || ' ' || what || ' ' || at FROM anomaly_history WHERE what = 'overdue' ORDER BY at",
    )
    .fetch_all(&outbox.store.readers)
    .await
    .expect("a history");
    let expected = ["2026-01-06", "2026-01-07"].map(|day| format!("{silent} overdue {day}T06:00:00.000Z"));
    assert_eq!(told, expected);
}

#[tokio::test]
async fn a_route_that_is_gone_is_silent_and_begins_anew_when_it_comes_back() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let anomaly = outbox.anomaly().await;
    let opened = outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    assert_eq!(outbox.store.retire_routes(&["log"]).await.expect("retired"), 1);
    assert_eq!(outbox.states().await, ["suppressed"]);
    let gone = outbox.anomaly().await;
    outbox.event(gone, "opened", day(1)).await;
    outbox.event(gone, "ended", day(1)).await;
    outbox.state(gone, "resolved").await;
    assert_eq!(outbox.route("shift", day(2)).await, route);
    outbox.hand_on(route, day(2), |_| now_(day(2))).await;
    assert_eq!(outbox.take(route, day(2)).await, [[opened]]);
}

#[tokio::test]
async fn what_a_receiver_holds_for_open_and_under_which_labels() {
    let outbox = Outbox::new().await;
    let route = outbox.route("alertmanager", day(0)).await;
    let (first, second) = (outbox.anomaly().await, outbox.anomaly().await);
    outbox.event(first, "opened", day(0)).await;
    outbox.event(second, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    outbox.take(route, day(0)).await;
    let open = |alarms: Vec<AlarmEvent>| alarms.iter().map(|alarm| alarm.anomaly_id).collect::<Vec<_>>();
    assert_eq!(open(outbox.store.told_alarms(route).await.expect("alarms")), [first, second]);
    // the next event has another severity: the receiver has to end the alert that it has
    let statement = "INSERT INTO anomaly_event (anomaly_id, what, severity, message) VALUES ($1, 'worse', 'critical', 'more')";
    sqlx::query(statement).bind(first).execute(&outbox.store.writer).await.expect("an event");
    outbox.event(second, "ended", day(1)).await;
    outbox.hand_on(route, day(1), |_| now_(day(1))).await;
    let worse = outbox.next(route, day(1)).await.expect("a message").alarms.remove(0);
    assert_eq!((worse.anomaly_id, worse.severity), (first, Severity::Critical));
    assert_eq!(worse.told_before, [("drift".to_owned(), "warning".to_owned())]);
    outbox.take(route, day(1)).await;
    assert_eq!(open(outbox.store.told_alarms(route).await.expect("alarms")), [first]);
}
