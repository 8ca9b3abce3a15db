//! Decides if and when a route sends an event.

use jiff::civil::{DateTime, Time};
use jiff::{Timestamp, ToSpan, Zoned};

use armwatch_config::{AlertSettings, QuietHours, Route};
use armwatch_model::anomaly::Severity;
use armwatch_store::{AlarmEvent, EventFate, EventKind, Held};

/// States of an alarm that people want no more messages about.
const SILENT: [&str; 3] = ["shelved", "maintenance", "false_alarm"];

/// Decides the fate of an event on a route.
pub fn judge(route: &Route, settings: &AlertSettings, event: &AlarmEvent, now: Timestamp) -> EventFate {
    let site = settings.site_of(&event.robot);
    // the store sends the end of an alarm to every route that reported it, even if its kind or severity has changed
    if !event.what.closes() && !route.takes(&event.robot, site, event.kind, event.severity) {
        return EventFate::Nothing;
    }
    let is_silent = SILENT.contains(&event.state.as_str());
    if is_silent && !event.what.closes() && event.what != EventKind::Unshelved {
        return EventFate::Suppress;
    }
    if let Some(at) = route.digest_at {
        return EventFate::Send { due_at: next(route, now, at), held: Some(Held::Digest) };
    }
    match quiet_until(route, event.severity, now) {
        Some(due_at) => EventFate::Send { due_at, held: Some(Held::Quiet) },
        None => EventFate::Send { due_at: now, held: None },
    }
}

/// The end of the quiet hours that delay a message of this severity; `None` if it does not wait.
pub fn quiet_until(route: &Route, severity: Severity, now: Timestamp) -> Option<Timestamp> {
    let quiet = route.quiet?;
    if severity == Severity::Critical {
        return None;
    }
    let time = now.to_zoned(route.zone.clone()).time();
    is_quiet(quiet, time).then(|| next(route, now, quiet.to))
}

fn is_quiet(quiet: QuietHours, time: Time) -> bool {
    if quiet.from < quiet.to {
        (quiet.from..quiet.to).contains(&time)
    } else {
        time >= quiet.from || time < quiet.to
    }
}

/// The next time after `now` when the clocks of the route show a time of day. If the clocks skip that time, the result
/// is the moment of the skip.
fn next(route: &Route, now: Timestamp, at: Time) -> Timestamp {
    let today = now.to_zoned(route.zone.clone()).date();
    let moment = |date| -> Option<Zoned> { route.zone.to_zoned(DateTime::from_parts(date, at)).ok() };
    let candidates = [Some(today), today.checked_add(1.day()).ok()];
    candidates
        .into_iter()
        .flatten()
        .filter_map(moment)
        .map(|zoned| zoned.timestamp())
        .find(|moment| *moment > now)
        .unwrap_or(now)
}

#[cfg(test)]
mod tests {
    use jiff::tz::TimeZone;

    use super::*;
    use crate::alert::message::example;

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    fn route() -> Route {
        Route { severity: Severity::Warning, ..Route::log() }
    }

    fn settings() -> AlertSettings {
        let sites = vec![armwatch_config::Site { name: "Turin".into(), robots: vec!["T*".into()] }];
        AlertSettings { sites, ..AlertSettings::default() }
    }

    fn fate(route: &Route, event: &AlarmEvent, now: &str) -> EventFate {
        judge(route, &settings(), event, at(now))
    }

    #[test]
    fn routes_choose_by_severity_robot_kind_and_site() {
        let now = "2026-03-01T12:00:00Z";
        let send = EventFate::Send { due_at: at(now), held: None };
        let event = |severity| example(severity, at(now));
        assert_eq!(fate(&route(), &event(Severity::Info), now), EventFate::Nothing);
        assert_eq!(fate(&route(), &event(Severity::Warning), now), send);
        let mut ended = event(Severity::Info);
        ended.what = EventKind::Ended;
        assert_eq!(fate(&route(), &ended, now), send, "the store asks whether it was told");
        for (fits, route) in [
            (true, Route { robots: Some(vec!["A*".into(), "T*".into()]), ..route() }),
            (false, Route { robots: Some(vec!["A*".into()]), ..route() }),
            (true, Route { kinds: Some(vec![armwatch_model::anomaly::AnomalyKind::Drift]), ..route() }),
            (false, Route { kinds: Some(vec![armwatch_model::anomaly::AnomalyKind::Step]), ..route() }),
            (true, Route { sites: Some(vec!["Turin".into()]), ..route() }),
            (false, Route { sites: Some(vec!["Lyon".into()]), ..route() }),
        ] {
            let found = fate(&route, &event(Severity::Critical), now);
            assert_eq!(found, if fits { send } else { EventFate::Nothing }, "{route:?}");
        }
    }

    #[test]
    fn what_a_person_has_shelved_is_silent_until_it_ends() {
        let now = "2026-03-01T12:00:00Z";
        let mut event = example(Severity::Critical, at(now));
        event.state = "shelved".into();
        event.what = EventKind::Worse;
        assert_eq!(fate(&route(), &event, now), EventFate::Suppress);
        event.what = EventKind::Ended;
        assert_eq!(fate(&route(), &event, now), EventFate::Send { due_at: at(now), held: None });
    }

    #[test]
    fn while_work_goes_on_neither_a_reminder_nor_a_worse_alarm_is_sent() {
        let now = "2026-03-01T12:00:00Z";
        let mut event = example(Severity::Critical, at(now));
        event.state = "maintenance".into();
        for what in [EventKind::Overdue, EventKind::Worse, EventKind::Reopened] {
            event.what = what;
            assert_eq!(fate(&route(), &event, now), EventFate::Suppress, "{what:?}");
        }
        event.what = EventKind::Ended;
        assert_eq!(fate(&route(), &event, now), EventFate::Send { due_at: at(now), held: None });
    }

    #[test]
    fn in_quiet_hours_only_what_is_critical_goes() {
        let zone = TimeZone::get("Europe/Rome").unwrap();
        let hours =
            |from: &str, to: &str| Some(QuietHours { from: from.parse().unwrap(), to: to.parse().unwrap() });
        let night = Route { quiet: hours("22:00", "06:00"), zone, ..route() };
        let until = |now: &str| quiet_until(&night, Severity::Warning, at(now));
        // 23:30 and 05:59 in Rome
        assert_eq!(until("2026-03-01T22:30:00Z"), Some(at("2026-03-02T05:00:00Z")));
        assert_eq!(until("2026-03-02T04:59:00Z"), Some(at("2026-03-02T05:00:00Z")));
        assert_eq!(until("2026-03-02T05:00:00Z"), None);
        assert_eq!(quiet_until(&night, Severity::Critical, at("2026-03-01T22:30:00Z")), None);
        // clocks change from 2 to 3 on 29 March: the night is an hour shorter
        assert_eq!(until("2026-03-28T21:30:00Z"), Some(at("2026-03-29T04:00:00Z")));
        let noon = Route { quiet: hours("12:00", "13:00"), zone: TimeZone::UTC, ..route() };
        assert_eq!(
            quiet_until(&noon, Severity::Info, at("2026-03-01T12:59:59Z")),
            Some(at("2026-03-01T13:00:00Z"))
        );
        assert_eq!(quiet_until(&noon, Severity::Info, at("2026-03-01T13:00:00Z")), None);
    }

    #[test]
    fn a_digest_goes_out_once_a_day() {
        let daily = Route { digest_at: Some("07:00".parse().unwrap()), ..route() };
        let due = |now: &str| fate(&daily, &example(Severity::Critical, at(now)), now);
        let send = |due_at: &str| EventFate::Send { due_at: at(due_at), held: Some(Held::Digest) };
        assert_eq!(due("2026-03-01T06:59:59Z"), send("2026-03-01T07:00:00Z"));
        assert_eq!(due("2026-03-01T07:00:00Z"), send("2026-03-02T07:00:00Z"));
    }
}
