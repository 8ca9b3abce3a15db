//! The outbox with a real database; times are passed as arguments, so no test has to wait.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use tempfile::TempDir;

use super::alarm::AlarmEvent;
use super::queue::{Again, DueMessage, RouteState, SendDecision};
use super::routes::{EventFate, Held, RouteEntry};
use crate::engine::Bind;
use crate::handle::Store;
use crate::tests::support::{assert_sound, day, fresh};
use armwatch_model::anomaly::Severity;

const DAY: Duration = Duration::from_secs(86_400);
const HOUR: SignedDuration = SignedDuration::from_hours(1);

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
        .bind_all((anomaly_id, at.as_microsecond(), what))
        .fetch_one(&self.store.writer)
        .await
        .expect("an event")
    }

    async fn state(&self, anomaly_id: i64, state: &'static str) {
        let statement = sqlx::query("UPDATE anomaly SET state = $1 WHERE anomaly_id = $2");
        statement.bind(state).bind(anomaly_id).execute(&self.store.writer).await.expect("a state");
    }

    async fn route(&self, name: &str, now: Timestamp) -> RouteEntry {
        self.store.enter_route(name, now, |_| now_(now)).await.expect("a route")
    }

    async fn hand_on(&self, route: RouteEntry, now: Timestamp, judge: impl Fn(&AlarmEvent) -> EventFate) {
        while self.store.hand_on(route.route_id, now, &judge).await.expect("handed on") {}
    }

    async fn next(&self, route: RouteEntry, now: Timestamp) -> Option<DueMessage> {
        self.store.next_message(route, now).await.expect("the queue")
    }

    async fn route_state(&self, route: RouteEntry, now: Timestamp) -> RouteState {
        self.store.route_state(route.route_id, now, HOUR).await.expect("a state")
    }

    async fn told_alarms(&self, route: RouteEntry) -> Vec<AlarmEvent> {
        self.store.told_alarms(route.route_id).await.expect("alarms")
    }

    /// Accepts everything that is due, as a receiver that can be reached; events by message.
    async fn take(&self, route: RouteEntry, now: Timestamp) -> Vec<Vec<i64>> {
        let mut taken = Vec::new();
        while let Some(message) = self.next(route, now).await {
            assert_eq!(
                self.store.begin_attempt(route, &message, now).await.expect("an attempt"),
                SendDecision::Begun
            );
            self.store.mark_sent(route, &message, now).await.expect("a mark");
            taken.push(message.alarms.iter().map(|alarm| alarm.event_id).collect());
        }
        taken
    }

    async fn fail(&self, route: RouteEntry, message: &DueMessage, again: Again, now: Timestamp) -> bool {
        assert_eq!(
            self.store.begin_attempt(route, message, now).await.expect("an attempt"),
            SendDecision::Begun
        );
        self.store.mark_failed(route, message, "no answer", again, (now, 3 * DAY)).await.expect("a mark")
    }

    async fn states(&self) -> Vec<String> {
        sqlx::query_scalar("SELECT state || coalesce(' ' || held, '') FROM deliveries ORDER BY delivery_id")
            .fetch_all(&self.store.readers)
            .await
            .expect("states")
    }
}

fn now_(now: Timestamp) -> EventFate {
    EventFate::Send { due_at: now, held: None }
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
    // after a restart, nothing is sent twice, but later events are sent
    let ended = outbox.event(open, "ended", day(3)).await;
    assert_eq!(outbox.route("shift", day(3)).await.route_id, route.route_id);
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
        // like routes: they select every end, and the store knows if there was a beginning
        let judge = |event: &AlarmEvent| {
            if wants || event.what.closes() { now_(day(1)) } else { EventFate::Nothing }
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
    outbox.hand_on(route, day(0), |_| EventFate::Send { due_at: day(1), held: Some(Held::Quiet) }).await;
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
        let state = outbox.route_state(route, day(days)).await;
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
    let hour = HOUR;
    let state = outbox.route_state(route, day(0)).await;
    assert_eq!((state.sent, state.first_sent_at), (2, Some(day(0))));
    assert_eq!(outbox.store.hold(route, day(0), day(0) + hour, Held::Flood).await.expect("held"), 3);
    assert_eq!(outbox.next(route, day(0)).await, None);
    let digest = outbox.next(route, day(0) + hour).await.expect("a digest");
    let of = |message: &DueMessage| message.alarms.iter().map(|alarm| alarm.event_id).collect::<Vec<_>>();
    assert_eq!((of(&digest), digest.digest), (events[2..].to_vec(), Some(events[4])));
    // a later one is not in it, whatever the outcome of the first attempt
    assert_eq!(
        outbox.store.begin_attempt(route, &digest, day(0) + hour).await.expect("an attempt"),
        SendDecision::Begun
    );
    let anomaly = outbox.anomaly().await;
    let late = outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0) + hour, |_| now_(day(0))).await;
    let first = outbox.next(route, day(0) + hour).await.expect("a message");
    assert_eq!(of(&first), [late], "what was tried less comes first");
    outbox.store.mark_sent(route, &first, day(0) + hour).await.expect("a mark");
    let again = outbox.next(route, day(0) + hour).await.expect("the digest");
    assert_eq!((of(&again), again.digest), (of(&digest), digest.digest));
    outbox.store.mark_sent(route, &again, day(0) + hour).await.expect("a mark");
    let state = outbox.route_state(route, day(0) + hour).await;
    assert_eq!(state.sent, 2, "a digest counts once");
}

#[tokio::test]
async fn a_digest_route_sends_one_message_a_day() {
    let outbox = Outbox::new().await;
    let route = outbox.route("daily", day(0)).await;
    let hour = HOUR;
    let mut events = Vec::new();
    for _ in 0..3 {
        let anomaly = outbox.anomaly().await;
        events.push(outbox.event(anomaly, "opened", day(0)).await);
        outbox
            .hand_on(route, day(0), |_| EventFate::Send { due_at: day(0) + hour, held: Some(Held::Digest) })
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
    assert_eq!(outbox.route("shift", day(2)).await.route_id, route.route_id);
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
    assert_eq!(open(outbox.told_alarms(route).await), [first, second]);
    // the next event has another severity: the receiver has to end the alert that it has
    let statement = "INSERT INTO anomaly_event (anomaly_id, what, severity, message) VALUES ($1, 'worse', 'critical', 'more')";
    sqlx::query(statement).bind(first).execute(&outbox.store.writer).await.expect("an event");
    outbox.event(second, "ended", day(1)).await;
    outbox.hand_on(route, day(1), |_| now_(day(1))).await;
    let worse = outbox.next(route, day(1)).await.expect("a message").alarms.remove(0);
    assert_eq!((worse.anomaly_id, worse.severity), (first, Severity::Critical));
    assert_eq!(worse.told_before, [("drift".to_owned(), "warning".to_owned())]);
    outbox.take(route, day(1)).await;
    assert_eq!(open(outbox.told_alarms(route).await), [first]);
}

#[tokio::test]
async fn a_message_that_waits_no_more_is_not_begun() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let anomaly = outbox.anomaly().await;
    outbox.event(anomaly, "opened", day(0)).await;
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    let message = outbox.next(route, day(0)).await.expect("a message");
    outbox.store.mark_sent(route, &message, day(0)).await.expect("a mark");
    assert_eq!(
        outbox.store.begin_attempt(route, &message, day(1)).await.expect("an answer"),
        SendDecision::NotWaiting
    );
    let attempts: i64 = sqlx::query_scalar("SELECT attempts FROM deliveries")
        .fetch_one(&outbox.store.readers)
        .await
        .expect("attempts");
    assert_eq!((attempts, outbox.states().await), (0, vec!["sent".to_owned()]));
}

/// A clock that was a year fast put off an attempt and a message, held two, and sent one.
#[tokio::test]
async fn what_a_clock_that_was_ahead_put_off_is_due_now() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let ahead = day(365);
    let mut events = Vec::new();
    for held in [None, None, None, Some(Held::Quiet), Some(Held::Flood)] {
        let anomaly = outbox.anomaly().await;
        events.push(outbox.event(anomaly, "opened", day(0)).await);
        let due_at = if held.is_some() { ahead + HOUR } else { ahead };
        outbox.hand_on(route, ahead, |_| EventFate::Send { due_at, held }).await;
    }
    let first = outbox.next(route, ahead).await.expect("a message");
    outbox.store.mark_sent(route, &first, ahead).await.expect("a mark");
    let second = outbox.next(route, ahead).await.expect("a message");
    outbox.fail(route, &second, Again::Message(ahead + HOUR), ahead).await;
    let third = outbox.next(route, ahead).await.expect("a message");
    outbox.fail(route, &third, Again::Route(ahead + HOUR), ahead).await;

    let mend = || outbox.store.mend_moments(route, (day(0), Duration::from_secs(3600)));
    assert_eq!(outbox.next(route, day(0)).await, None, "silent for a year");
    assert_eq!(mend().await.expect("mended"), Some(ahead + HOUR));
    let state = outbox.route_state(route, day(0)).await;
    assert_eq!((state.retry_at, state.next_due_at), (None, Some(day(0))));
    assert_eq!((state.sent, state.first_sent_at), (0, None), "what was sent in a year is not of this hour");
    // messages held for a digest become one, and messages with an attempt follow those without
    let taken = outbox.take(route, day(0)).await.concat();
    assert_eq!(taken, [events[3], events[4], events[1], events[2]]);
    assert_eq!(mend().await.expect("a look"), Some(ahead), "the message that was sent stays as it is");
    assert_eq!(outbox.route_state(route, day(0)).await.sent, 3, "the digest counts once");
    assert_sound(&outbox.store).await;
}

#[tokio::test]
async fn what_waits_as_long_as_anything_may_goes_on_waiting() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    let longest = 2 * HOUR;
    for (held, wait) in [
        (None, longest),
        (Some(Held::Flood), longest),
        (Some(Held::Quiet), SignedDuration::from_hours(25)),
        (Some(Held::Digest), SignedDuration::from_hours(25)),
    ] {
        let anomaly = outbox.anomaly().await;
        outbox.event(anomaly, "opened", day(0)).await;
        outbox.hand_on(route, day(0), |_| EventFate::Send { due_at: day(0) + wait, held }).await;
    }
    let limit = (day(0), longest.unsigned_abs());
    assert_eq!(outbox.store.mend_moments(route, limit).await.expect("a look"), None);
    assert_eq!(outbox.route_state(route, day(0)).await.next_due_at, Some(day(0) + longest));
    assert_eq!(outbox.next(route, day(0)).await, None);
    // the clock is set back by two minutes: messages due at once are now further in the future than any delay allows
    let before = day(0) - SignedDuration::from_mins(2);
    let found = outbox.store.mend_moments(route, (before, limit.1)).await.expect("mended");
    assert_eq!(found, Some(day(0) + longest));
    let waiting = "SELECT count(*) FROM delivery WHERE due_at > $1";
    let waiting = sqlx::query_scalar(waiting).bind(before.as_microsecond()).fetch_one(&outbox.store.readers);
    let waiting: i64 = waiting.await.expect("a count");
    assert_eq!(waiting, 2, "the night and the digest");
}

/// Makes the stored attempts those of a process that was killed.
async fn killed(outbox: &Outbox) {
    sqlx::query("UPDATE attempt SET process = 0")
        .execute(&outbox.store.writer)
        .await
        .expect("another process");
}

#[tokio::test]
async fn a_message_that_ends_the_program_three_times_is_given_up_and_the_next_one_goes_out() {
    let outbox = Outbox::new().await;
    let route = outbox.route("shift", day(0)).await;
    for _ in 0..2 {
        let anomaly = outbox.anomaly().await;
        outbox.event(anomaly, "opened", day(0)).await;
    }
    outbox.hand_on(route, day(0), |_| now_(day(0))).await;
    let poison = outbox.next(route, day(0)).await.expect("a message");
    for attempt in 1..=3 {
        assert_eq!(outbox.store.is_last_attempt(&poison).await.expect("a count"), attempt == 3);
        let sending = outbox.store.begin_attempt(route, &poison, day(0)).await.expect("an attempt");
        assert_eq!(sending, SendDecision::Begun);
        killed(&outbox).await;
    }
    let sending = outbox.store.begin_attempt(route, &poison, day(0)).await.expect("an attempt");
    assert_eq!(sending, SendDecision::GivenUp);
    assert_eq!(outbox.states().await, ["failed", "pending"]);
    let next = outbox.next(route, day(0)).await.expect("the next message");
    assert_ne!(next.delivery_ids, poison.delivery_ids);
    assert_eq!(
        outbox.store.begin_attempt(route, &next, day(0)).await.expect("an attempt"),
        SendDecision::Begun
    );
    outbox.store.mark_sent(route, &next, day(0)).await.expect("a mark");
    let left: i64 = sqlx::query_scalar("SELECT count(*) FROM attempt WHERE work = 'delivery'")
        .fetch_one(&outbox.store.readers)
        .await
        .expect("a count");
    assert_eq!(left, 0);
}

/// Sessions of daemons and their claims, in a file instead of a server.
mod sessions {
    use super::*;
    use crate::error::StoreError;

    impl Outbox {
        async fn write(&self, statement: &'static str) {
            sqlx::query(statement).execute(&self.store.writer).await.expect(statement);
        }

        /// An outbox with sessions 1, which has the route, 2 and 3.
        async fn with_sessions() -> Self {
            let outbox = Self::new().await;
            outbox
                .write(
                    "INSERT INTO host_session (host_session_id, host, kind, version, started_at, seen_at, alive_until)
                     VALUES (1, 'a', 'daemon', '1', 0, 0, 1), (2, 'b', 'daemon', '1', 0, 0, 1),
                            (3, 'a', 'daemon', '1', 0, 0, 1)",
                )
                .await;
            outbox
                .write(
                    "INSERT INTO claim (kind, subject, host_session_id, claimed_at) VALUES ('route', 'shift', 1, 0)",
                )
                .await;
            outbox.store.own_host.set_session(1);
            outbox
        }
    }

    fn lost<T: std::fmt::Debug>(done: Result<T, StoreError>) {
        assert!(matches!(done, Err(StoreError::LeaseEnded { .. })), "{done:?}");
    }

    /// A daemon is frozen between two messages, another one claims the route, and the first one wakes and joins again.
    #[tokio::test]
    async fn a_daemon_that_has_lost_its_claim_takes_no_message_under_its_next_session() {
        let outbox = Outbox::with_sessions().await;
        let first = &outbox.store;
        let entered = outbox.route("shift", day(0)).await;
        for _ in 0..3 {
            let anomaly = outbox.anomaly().await;
            outbox.event(anomaly, "opened", day(0)).await;
        }
        outbox.hand_on(entered, day(0), |_| now_(day(0))).await;
        let route = first.claimed(entered);
        let message = outbox.next(route, day(0)).await.expect("a message");
        assert_eq!(
            first.begin_attempt(route, &message, day(0)).await.expect("an attempt"),
            SendDecision::Begun
        );
        first.mark_sent(route, &message, day(0)).await.expect("a mark");
        let message = outbox.next(route, day(0)).await.expect("the next message");

        outbox
            .write(
                "UPDATE host_session SET ended_at = 1, end_reason = 'lease_ended' WHERE host_session_id = 1",
            )
            .await;
        lost(first.next_message(route, day(0)).await);
        outbox.write("UPDATE claim SET host_session_id = 2").await;
        let second = Store { own_host: first.own_host.to_look(), ..first.clone() };
        second.own_host.set_session(2);
        let of_second = second.claimed(entered);
        let same =
            second.next_message(of_second, day(0)).await.expect("the queue").expect("the same message");
        assert_eq!(same.delivery_ids, message.delivery_ids);
        assert_eq!(
            second.begin_attempt(of_second, &same, day(0)).await.expect("an attempt"),
            SendDecision::Begun
        );

        first.own_host.set_session(3);
        // attempts begun under the first session, and attempts begun without the claim
        for route in [route, first.claimed(entered)] {
            lost(first.next_message(route, day(0)).await);
            lost(first.begin_attempt(route, &message, day(0)).await);
            lost(first.mark_sent(route, &message, day(0)).await);
            let again = Again::Route(day(1));
            lost(first.mark_failed(route, &message, "no answer", again, (day(0), DAY)).await);
            lost(first.hold(route, day(0), day(1), Held::Flood).await);
            lost(first.hold_message(route, &message, day(1), Held::Quiet).await);
        }
        second.mark_sent(of_second, &same, day(0)).await.expect("a mark");
        assert_eq!(outbox.states().await, ["sent", "sent", "pending"]);
        let attempts: Vec<i64> = sqlx::query_scalar("SELECT attempts FROM deliveries ORDER BY delivery_id")
            .fetch_all(&first.readers)
            .await
            .expect("attempts");
        assert_eq!(attempts, [1, 1, 0]);

        // after its release, the route belongs to the first daemon again
        outbox.write("UPDATE claim SET host_session_id = 3").await;
        lost(first.next_message(route, day(0)).await);
        assert_eq!(outbox.take(first.claimed(entered), day(0)).await.len(), 1);
        lost(second.next_message(of_second, day(0)).await);
    }
}
