//! The task of one route: pass on events, wait, send, store the result.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use super::message::{Alarm, Message, Origin};
use super::receiver::{Receiver, SendError};
use super::receivers::open;
use super::route::{judge, quiet_until};
use armwatch_config::receivers::{LogSettings, ReceiverSettings};
use armwatch_config::{AlertSettings, Route};
use armwatch_store::{
    Again, AlarmEvent, ClaimKind, DueMessage, Held, RouteEntry, SendDecision, Store, StoreError,
    wait_for_quiet,
};

/// Time between two looks for events, which other processes write too. It is short compared with the seconds that a
/// mail takes.
const LOOK: Duration = Duration::from_secs(2);

/// Pause before the database is queried again after a failure.
const STORE_PAUSE: Duration = Duration::from_secs(1);

/// The period for counting messages.
const HOUR: SignedDuration = SignedDuration::from_hours(1);

/// A route's task.
pub(super) struct Worker {
    store: Store,
    settings: Arc<AlertSettings>,
    route: Route,
    end: CancellationToken,
    /// Opened when it is needed.
    receiver: Option<Box<dyn Receiver>>,
    refreshed: Option<Instant>,
    /// True if the wrong clock was logged.
    is_clock_said: bool,
}

/// State of the route at its start.
struct RouteStart {
    entry: RouteEntry,
    origin: Origin,
}

impl Worker {
    /// Creates the worker of the route at index `place` of the settings.
    pub(super) fn new(
        store: Store,
        settings: Arc<AlertSettings>,
        place: usize,
        end: CancellationToken,
    ) -> Option<Self> {
        let route = settings.routes.get(place)?.clone();
        Some(Self { store, settings, route, end, receiver: None, refreshed: None, is_clock_said: false })
    }

    /// Works until the end is requested, then sends the messages that are due by then.
    pub(super) async fn run(mut self, mut heard: watch::Receiver<()>) {
        let begun = loop {
            match self.begin().await {
                Ok(begun) => break begun,
                Err(error) => {
                    tracing::warn!(route = self.route.name, %error, "the route has not begun; trying again");
                    tokio::select! {
                        () = self.end.cancelled() => return,
                        () = tokio::time::sleep(STORE_PAUSE) => {}
                    }
                }
            }
        };
        loop {
            let is_last = self.end.is_cancelled();
            let pause = match self.step_if_ours(&begun).await {
                Ok(pause) => pause,
                Err(error @ StoreError::LeaseEnded { .. }) => {
                    tracing::debug!(route = self.route.name, %error, "the claim on the route is lost; claiming it again");
                    STORE_PAUSE
                }
                Err(error) => {
                    tracing::warn!(route = self.route.name, %error, "nothing is sent now; trying again");
                    STORE_PAUSE
                }
            };
            if is_last {
                self.store.release_work(&[(ClaimKind::Route, &self.route.name)]).await;
                return;
            }
            tokio::select! {
                () = self.end.cancelled() => {}
                Ok(()) = heard.changed() => {}
                () = tokio::time::sleep(pause.min(LOOK)) => {}
            }
        }
    }

    async fn begin(&mut self) -> Result<RouteStart, StoreError> {
        let now = Timestamp::now();
        let judge = |event: &AlarmEvent| judge(&self.route, &self.settings, event, now);
        let entry = self.store.enter_route(&self.route.name, now, judge).await?;
        let origin = Origin { identity: self.store.identity().await?, link: self.settings.link.clone() };
        let begun = RouteStart { entry, origin };
        if self.route.receiver == ReceiverSettings::Log(LogSettings) && !entry.is_new {
            self.say_open(&begun).await?;
        }
        Ok(begun)
    }

    /// A log begins with its start: alarms that were open before are reported once.
    async fn say_open(&mut self, begun: &RouteStart) -> Result<(), StoreError> {
        let mut open = self.store.told_alarms(begun.entry.route_id).await?;
        open.retain(|event| event.state == "open");
        if !open.is_empty() {
            tracing::info!(alarms = open.len(), "open since before this start:");
            let message = self.message(begun, "start".into(), open, true);
            // a log accepts everything
            let _ = self.send(&message).await;
        }
        Ok(())
    }

    /// Only one of several daemons serves a route: the first one, until it ends. Actions under its claim fail once the
    /// claim is lost.
    async fn step_if_ours(&mut self, begun: &RouteStart) -> Result<Duration, StoreError> {
        if !self.store.claim_work(ClaimKind::Route, &self.route.name).await? {
            return Ok(LOOK);
        }
        let entry = self.store.claimed(begun.entry);
        self.step(begun, entry).await
    }

    /// Passes on events, and sends all due messages. Returns the time until the next possible work.
    async fn step(&mut self, begun: &RouteStart, entry: RouteEntry) -> Result<Duration, StoreError> {
        self.mend_moments(entry).await?;
        loop {
            let now = Timestamp::now();
            let judge = |event: &AlarmEvent| judge(&self.route, &self.settings, event, now);
            if !self.store.hand_on(entry.route_id, now, judge).await? {
                break;
            }
        }
        loop {
            let now = Timestamp::now();
            let state = self.store.route_state(entry.route_id, now, HOUR).await?;
            if let Some(retry_at) = state.retry_at.filter(|at| *at > now) {
                return Ok(until(now, retry_at));
            }
            let Some(due_at) = state.next_due_at else { break };
            if due_at > now {
                self.refresh(begun).await?;
                return Ok(until(now, due_at));
            }
            if state.sent >= self.route.most_per_h {
                let free_at = state.first_sent_at.unwrap_or(now) + HOUR;
                let held = self.store.hold(entry, now, free_at, Held::Flood).await?;
                if held > 0 {
                    let most = self.route.most_per_h;
                    tracing::warn!(
                        route = self.route.name,
                        held,
                        "{most} messages within an hour; the others wait until {free_at} and become one"
                    );
                    continue;
                }
            }
            let Some(due) = self.store.next_message(entry, now).await? else { break };
            let worst = due.alarms.iter().map(|alarm| alarm.severity).max();
            if let Some(until) = worst.and_then(|severity| quiet_until(&self.route, severity, now)) {
                self.store.hold_message(entry, &due, until, Held::Quiet).await?;
                continue;
            }
            if self.store.is_last_attempt(&due).await?
                && let Some(rest) = wait_for_quiet()
            {
                tokio::select! {
                    () = self.end.cancelled() => break,
                    () = tokio::time::sleep(rest) => {}
                }
            }
            self.attempt(begun, entry, &due, state.failures).await?;
            if self.end.is_cancelled() && state.failures > 0 {
                break;
            }
        }
        self.refresh(begun).await?;
        Ok(LOOK)
    }

    /// Prevents messages from waiting for a date that a wrong clock in the future has set, and logs that once.
    async fn mend_moments(&mut self, entry: RouteEntry) -> Result<(), StoreError> {
        let longest = longest_pause(self.settings.retry);
        let ahead = self.store.mend_moments(entry, (Timestamp::now(), longest)).await?;
        if let Some(furthest) = ahead
            && !self.is_clock_said
        {
            tracing::warn!(
                route = self.route.name,
                "the clock was ahead when messages of this route were sent or put off, up to {furthest}: what waited for \
                 such a moment is due now"
            );
        }
        self.is_clock_said = ahead.is_some();
        Ok(())
    }

    /// Sends one message and stores the result.
    async fn attempt(
        &mut self,
        begun: &RouteStart,
        entry: RouteEntry,
        due: &DueMessage,
        failures: u32,
    ) -> Result<(), StoreError> {
        let route = self.route.name.clone();
        let message = self.due_message(begun, due);
        let key = &message.key;
        match self.store.begin_attempt(entry, due, Timestamp::now()).await? {
            SendDecision::Begun => {}
            SendDecision::NotWaiting => {
                tracing::debug!(route, key, "not sent: it does not wait any more");
                return Ok(());
            }
            SendDecision::GivenUp => {
                tracing::error!(
                    route,
                    key,
                    "given up: sending it has ended the program three times; the view deliveries lists what failed"
                );
                return Ok(());
            }
            SendDecision::TakenApart => {
                tracing::warn!(
                    route,
                    key,
                    "sending this digest has ended the program three times: its alarms are sent one by one"
                );
                return Ok(());
            }
        }
        let sent = self.send(&message).await;
        let now = Timestamp::now();
        let error = match sent {
            Ok(()) => {
                tracing::debug!(route, key = message.key, "sent");
                if failures > 0 {
                    tracing::info!(route, failures, "the receiver answers again");
                }
                return self.mark_sent(entry, due).await;
            }
            Err(error) => error,
        };
        let (again, retry_at) = match &error {
            SendError::Unreached { retry_after, .. } => {
                let pause = pause(failures, self.settings.retry).max(retry_after.unwrap_or_default());
                let at = later(now, pause);
                (Again::Route(at), at)
            }
            SendError::Refused { .. } => {
                let at = later(now, pause(due.attempts, self.settings.retry));
                (Again::Message(at), at)
            }
        };
        let detail = error.to_string();
        let is_final = matches!(error, SendError::Refused { is_final: true, .. });
        let limit = (now, if is_final { Duration::ZERO } else { self.settings.give_up_after });
        let given_up = self.store.mark_failed(entry, due, &detail, again, limit).await?;
        let (key, attempts) = (&message.key, due.attempts + 1);
        if given_up {
            let alarms = due.alarms.len();
            tracing::error!(
                route,
                key,
                attempts,
                alarms,
                error = detail,
                "not delivered, and given up; the view deliveries lists what failed"
            );
        } else if failures == 0 || matches!(error, SendError::Refused { .. }) {
            tracing::warn!(route, key, attempts, error = detail, %retry_at, "not delivered; trying again");
        } else {
            tracing::debug!(route, key, attempts, error = detail, %retry_at, "not delivered; trying again");
        }
        Ok(())
    }

    /// Marks a delivered message before anything else, because it would otherwise be sent again. If the claim is lost,
    /// the daemon that serves the route sends it again.
    async fn mark_sent(&self, entry: RouteEntry, due: &DueMessage) -> Result<(), StoreError> {
        loop {
            match self.store.mark_sent(entry, due, Timestamp::now()).await {
                Err(error @ StoreError::LeaseEnded { .. }) => return Err(error),
                Err(error) if !error.is_fatal() && !self.end.is_cancelled() => {
                    tracing::debug!(route = self.route.name, %error, "sent and not marked; trying again");
                    tokio::time::sleep(STORE_PAUSE).await;
                }
                marked => return marked,
            }
        }
    }

    /// Sends open alarms again to a receiver that forgets them.
    async fn refresh(&mut self, begun: &RouteStart) -> Result<(), StoreError> {
        let interval = self.receiver.as_ref().and_then(|receiver| receiver.refresh());
        let Some(interval) = interval.filter(|_| !self.end.is_cancelled()) else { return Ok(()) };
        if self.refreshed.is_some_and(|at| at.elapsed() < interval) {
            return Ok(());
        }
        self.refreshed = Some(Instant::now());
        let open = self.store.told_alarms(begun.entry.route_id).await?;
        if open.is_empty() {
            return Ok(());
        }
        let message = self.message(begun, "refresh".into(), open, true);
        if let Err(error) = self.send(&message).await {
            tracing::debug!(route = self.route.name, %error, "open alarms not told again");
        }
        Ok(())
    }

    async fn send(&mut self, message: &Message) -> Result<(), SendError> {
        let receiver = match &self.receiver {
            Some(receiver) => receiver,
            None => {
                let opened = open(&self.route).map_err(|error| SendError::unreached(error.to_string()))?;
                self.receiver.insert(opened)
            }
        };
        receiver.send(message).await
    }

    fn due_message(&self, begun: &RouteStart, due: &DueMessage) -> Message {
        let key = match (due.digest, due.alarms.as_slice()) {
            (Some(digest), _) => format!("{}-digest-{}", begun.origin.key(digest), self.route.name),
            (None, [alarm, ..]) => begun.origin.key(alarm.event_id),
            (None, []) => begun.origin.key(0),
        };
        self.message(begun, key, due.alarms.clone(), due.digest.is_some())
    }

    fn message(&self, begun: &RouteStart, key: String, events: Vec<AlarmEvent>, is_digest: bool) -> Message {
        let alarm = |event: AlarmEvent| {
            let site = self.settings.site_of(&event.robot).map(str::to_owned);
            Alarm::new(event, site.as_deref(), self.route.language.unwrap_or(self.settings.language))
        };
        Message {
            key,
            route: self.route.name.clone(),
            origin: begun.origin.clone(),
            alarms: events.into_iter().map(alarm).collect(),
            is_digest,
            is_trial: false,
        }
    }
}

/// The pause after `failures` failures: doubled each time up to a limit, and up to a fifth shorter or longer, so that
/// routes that failed together do not retry together.
fn pause(failures: u32, (first, most): (Duration, Duration)) -> Duration {
    let doubled = first.saturating_mul(2_u32.saturating_pow(failures.min(20))).min(most);
    let random = f64::from(u8::try_from(RandomState::new().build_hasher().finish() % 201).unwrap_or(100));
    doubled.mul_f64(0.8 + random / 500.0)
}

/// The longest delay of a message without quiet hours and digests: by [`pause`], by a receiver that requests an hour
/// (the most that is granted), or by a flood.
fn longest_pause((_, most): (Duration, Duration)) -> Duration {
    most.mul_f64(1.2).max(HOUR.unsigned_abs())
}

fn until(now: Timestamp, moment: Timestamp) -> Duration {
    moment.duration_since(now).try_into().unwrap_or_default()
}

fn later(now: Timestamp, pause: Duration) -> Timestamp {
    SignedDuration::try_from(pause).ok().and_then(|pause| now.checked_add(pause).ok()).unwrap_or(now)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_double_up_to_their_limit_and_scatter_by_a_fifth() {
        let retry = (Duration::from_secs(5), Duration::from_secs(900));
        for (failures, expected) in
            [(0, 5.0), (1, 10.0), (3, 40.0), (7, 640.0), (8, 900.0), (u32::MAX, 900.0)]
        {
            let found: Vec<f64> = (0..200).map(|_| pause(failures, retry).as_secs_f64() / expected).collect();
            assert!(found.iter().all(|share| (0.799..=1.201).contains(share)), "{failures}: {found:?}");
            let spread = |share: &f64| (share * 100.0).round();
            assert!(found.iter().any(|share| spread(share) != spread(&found[0])), "no scatter: {found:?}");
        }
    }

    #[test]
    fn no_pause_is_longer_than_the_longest() {
        for most in [0.05, 900.0, 86_400.0].map(Duration::from_secs_f64) {
            let longest = longest_pause((Duration::from_millis(50), most));
            assert!(longest >= Duration::from_secs(3600), "a flood and a receiver may ask for an hour");
            assert!((0..200).all(|_| pause(u32::MAX, (most, most)) <= longest + Duration::from_micros(1)));
        }
    }
}
