//! What a receiver is told: one alarm, or a digest of several, as text and as JSON.
//!
//! Titles, sentences and details are for people and show hidden characters ([`text::shown`]). Names in JSON are as they are.

use jiff::Timestamp;
use serde_json::{Value, json};

use super::figures::Figures;
use super::trend::Trend;
use armwatch_model::anomaly::odds::odds_in_words;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};
use armwatch_model::text;
use armwatch_store::{AlarmEvent, EventKind};

/// Who sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// What tells this database from others.
    pub identity: String,
    /// Address of the dashboard, for people.
    pub link: Option<String>,
}

impl Origin {
    /// The key of an event, the same in every attempt: what a receiver tells a repetition by.
    #[must_use]
    pub fn key(&self, event_id: i64) -> String {
        format!("armwatch-{}-{event_id}", self.identity)
    }

    /// Address of an anomaly in the dashboard.
    #[must_use]
    pub fn page_of(&self, anomaly_id: i64) -> Option<String> {
        let link = self.link.as_deref()?.trim_end_matches('/');
        Some(format!("{link}/#/alarm/{anomaly_id}"))
    }

    /// What identifies an anomaly at a receiver, whatever happens to it.
    #[must_use]
    pub fn anomaly(&self, anomaly_id: i64) -> String {
        format!("armwatch-{}-anomaly-{anomaly_id}", self.identity)
    }
}

/// An event of an alarm with what is told of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// The event.
    pub event: AlarmEvent,
    /// Where the robot stands.
    pub site: Option<String>,
    /// Where the quantity is going.
    pub trend: Trend,
}

impl Alarm {
    /// An event of a robot at a site.
    #[must_use]
    pub fn new(event: AlarmEvent, site: Option<&str>) -> Self {
        let trend = Trend::of(&event.series);
        Self { event, site: site.map(str::to_owned), trend }
    }

    /// Whether it is over.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.event.what.closes()
    }

    /// How soon a person should look.
    #[must_use]
    pub fn urgency(&self) -> &'static str {
        if self.is_closed() {
            return "nothing to do";
        }
        match self.event.severity {
            Severity::Info => "worth knowing",
            Severity::Warning => "plan a look",
            Severity::Critical => "look before the next shift",
        }
    }

    /// Robot and joint, as people say them.
    #[must_use]
    pub fn place(&self) -> String {
        let joint = self.event.joint.map_or_else(|| "whole arm".to_owned(), |joint| format!("joint {joint}"));
        let site = self.site.as_ref().map(|site| format!(" ({site})")).unwrap_or_default();
        text::shown(&format!("{}{site}, {joint}", self.event.robot)).into_owned()
    }

    /// One line: how bad, where, what, what happened.
    #[must_use]
    pub fn title(&self) -> String {
        let AlarmEvent { severity, kind, .. } = &self.event;
        let happened = happened(self.event.what);
        if self.is_closed() {
            return format!("{happened}: {}: {kind}", self.place());
        }
        format!("{severity}: {}: {kind} {happened}", self.place())
    }

    /// What a technician should read. Of an alarm that is over it is what was found, without figures of the latest test
    /// and without advice.
    #[must_use]
    pub fn sentence(&self) -> String {
        let message = text::shown(&self.event.message);
        if self.is_closed() { format!("was: {}", finding(&message)) } else { message.into_owned() }
    }

    /// The figures, a line each.
    #[must_use]
    pub fn details(&self) -> Vec<String> {
        let AlarmEvent { quantity, score, threshold, value, baseline, peak_value, peak_score, .. } =
            &self.event;
        let figures = Figures(*quantity);
        let is_closed = self.is_closed();
        let mut lines = vec![self.sentence()];
        let mut line = |name: &str, text: Option<String>| {
            lines.extend(text.map(|text| format!("{name}: {text}")));
        };
        line("urgency", Some(self.urgency().to_owned()));
        line("quantity", Some(quantity.to_string()));
        line(
            if is_closed { "latest test that shows it" } else { "latest test" },
            value.map(|value| match baseline {
                Some(baseline) => format!("{}, expected {}", figures.value(value), figures.value(*baseline)),
                None => figures.value(value),
            }),
        );
        // where it went is of no use to who has nothing to do
        let trend = if is_closed { Trend::default() } else { self.trend };
        line("smoothed over 3 tests", trend.smoothed.map(|smoothed| figures.value(smoothed)));
        // what no figure measures is not out by one; some have no limit
        let score = score.filter(|_| value.is_some());
        let limit = threshold.filter(|limit| *limit != 0.0);
        line(
            if is_closed { "was out by" } else { "out by" },
            score.map(|score| match limit {
                Some(limit) => format!("{}, alarm from {}", figures.score(score), figures.score(limit)),
                None => figures.score(score),
            }),
        );
        line(
            "peak",
            peak_value.map(|peak| match peak_score {
                Some(score) => format!("{}, out by {}", figures.value(peak), figures.score(*score)),
                None => figures.value(peak),
            }),
        );
        line("trend", trend.slope_30_d.map(|slope| format!("{} in 30 days", figures.change(slope))));
        let AlarmEvent { onset_at, onset_run_id, onset_cycle, first_seen_at, last_seen_at, .. } = &self.event;
        line(
            "onset",
            onset_at.map(|at| {
                let run = onset_run_id.map(|run| format!(", run {run}")).unwrap_or_default();
                let cycle = onset_cycle.map(|cycle| format!(", cycle {cycle}")).unwrap_or_default();
                format!("{}{run}{cycle}", seconds(&at))
            }),
        );
        line("seen", Some(format!("{} to {}", seconds(first_seen_at), seconds(last_seen_at))));
        line("odds of this cause", self.event.odds.map(odds_in_words));
        line("why", self.event.why.as_deref().map(|why| text::shown(why).into_owned()));
        line("anomaly", Some(self.event.anomaly_id.to_string()));
        lines
    }

    /// The alarm as JSON: what MQTT and commands get.
    #[must_use]
    pub fn json(&self, origin: &Origin) -> Value {
        let event = &self.event;
        json!({
            "key": origin.key(event.event_id),
            "alarm": origin.anomaly(event.anomaly_id),
            "status": if self.is_closed() { "resolved" } else { "firing" },
            "event": event.what.name(),
            "at": event.at.to_string(),
            "title": self.title(),
            "message": self.sentence(),
            "urgency": self.urgency(),
            "severity": event.severity.name(),
            "anomaly_id": event.anomaly_id,
            "link": origin.page_of(event.anomaly_id),
            "robot": event.robot,
            "joint": event.joint,
            "site": self.site,
            "kind": event.kind,
            "quantity": event.quantity,
            "unit": event.quantity.unit(),
            "value": event.value,
            "smoothed_value": self.trend.smoothed,
            "baseline": event.baseline,
            "score": event.score,
            "threshold": event.threshold,
            "peak_value": event.peak_value,
            "peak_score": event.peak_score,
            "trend_30_d": self.trend.slope_30_d,
            "onset_at": event.onset_at.map(|at| at.to_string()),
            "onset_run_id": event.onset_run_id,
            "onset_cycle": event.onset_cycle,
            "first_seen_at": event.first_seen_at.to_string(),
            "last_seen_at": event.last_seen_at.to_string(),
            "odds": event.odds,
            "state": event.state,
            "why": event.why,
        })
    }
}

/// What is sent at once.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// The same in every attempt.
    pub key: String,
    /// The route.
    pub route: String,
    /// Who sends.
    pub origin: Origin,
    /// What it says, in the order in which it happened.
    pub alarms: Vec<Alarm>,
    /// Whether it stands for several that were held.
    pub is_digest: bool,
    /// Whether it says that it is a try.
    pub is_trial: bool,
}

impl Message {
    /// One line.
    #[must_use]
    pub fn title(&self) -> String {
        match self.alarms.as_slice() {
            [alarm] if !self.is_digest => alarm.title(),
            alarms => {
                let latest = latest(alarms);
                let open = latest.iter().filter(|alarm| !alarm.is_closed());
                let worst = open.clone().map(|alarm| alarm.event.severity).max();
                let worst = worst.map(|worst| format!(", worst {worst}")).unwrap_or_default();
                let (open, all) = (open.count(), latest.len());
                let noun = if open == 1 { "alarm" } else { "alarms" };
                format!("digest: {open} {noun}, {} ended{worst}", all - open)
            }
        }
    }

    /// The whole message for people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut lines = Vec::new();
        for alarm in &self.alarms {
            lines.push(alarm.title());
            lines.extend(alarm.details().into_iter().map(|line| format!("  {line}")));
            lines.extend(self.origin.page_of(alarm.event.anomaly_id).map(|page| format!("  {page}")));
            lines.push(String::new());
        }
        lines.push(format!("key: {}", self.key));
        lines.join("\n") + "\n"
    }

    /// The message as the text of JSON: what MQTT and commands get.
    #[must_use]
    pub fn json_text(&self) -> String {
        json_text(&self.json())
    }

    fn json(&self) -> Value {
        json!({
            "version": 1,
            "key": self.key,
            "route": self.route,
            "digest": self.is_digest,
            "status": self.status(),
            "title": self.title(),
            "link": self.origin.link,
            "alarms": self.alarms.iter().map(|alarm| alarm.json(&self.origin)).collect::<Vec<_>>(),
        })
    }

    /// `firing` while one of its alarms is open, else `resolved`.
    #[must_use]
    pub fn status(&self) -> &'static str {
        if latest(&self.alarms).iter().any(|alarm| !alarm.is_closed()) { "firing" } else { "resolved" }
    }

    /// The largest severity of an alarm in it.
    #[must_use]
    pub fn severity(&self) -> Severity {
        self.alarms.iter().map(|alarm| alarm.event.severity).max().unwrap_or(Severity::Info)
    }
}

/// The text of JSON for receivers, see [`text::json`].
#[must_use]
pub fn json_text(value: &Value) -> String {
    text::json(&value.to_string()).into_owned()
}

fn happened(what: EventKind) -> &'static str {
    match what {
        EventKind::Opened => "opened",
        EventKind::Worse => "is worse",
        EventKind::Reopened => "is back",
        EventKind::Overdue => "is still unanswered",
        EventKind::Unshelved => "is no longer shelved",
        EventKind::Ended => "ended",
        EventKind::Withdrawn => "withdrawn",
        EventKind::Resolved => "resolved",
        EventKind::FalseAlarm => "false alarm",
        EventKind::Corrected
        | EventKind::Acknowledged
        | EventKind::Shelved
        | EventKind::Maintenance
        | EventKind::Commented
        | EventKind::Assigned => what.name(),
    }
}

/// The last word on each alarm, of events in the order in which they happened.
fn latest(events: &[Alarm]) -> Vec<&Alarm> {
    let is_last = |place: usize, of: &Alarm| {
        events[place + 1..].iter().all(|later| later.event.anomaly_id != of.event.anomaly_id)
    };
    events.iter().enumerate().filter(|(place, of)| is_last(*place, of)).map(|(_, of)| of).collect()
}

/// What was found, without the figures and the advice that follow it in the message of a detector: up to the first
/// semicolon outside of brackets.
fn finding(message: &str) -> &str {
    let mut depth = 0_i32;
    let end = message.char_indices().find(|(_, letter)| {
        match letter {
            '(' => depth += 1,
            ')' => depth -= 1,
            _ => {}
        }
        *letter == ';' && depth <= 0
    });
    end.map_or(message, |(place, _)| &message[..place])
}

fn seconds(time: &Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}

/// An alarm that never was, for a try of a route.
#[must_use]
pub fn example(severity: Severity, now: Timestamp) -> AlarmEvent {
    let day = |days: i64| now - jiff::SignedDuration::from_hours(24 * days);
    let series = [1.0, 1.01, 1.06, 1.12, 1.19, 1.24];
    AlarmEvent {
        // no event has this number
        event_id: 0,
        anomaly_id: 0,
        what: EventKind::Opened,
        at: now,
        robot: "TEST".into(),
        joint: Some(3),
        kind: AnomalyKind::Drift,
        quantity: Quantity::FrictionIndex,
        severity,
        message: "this is a try of the route, no robot is meant; friction at equal speed and warmth would be 24 % above \
                  the joint's baseline"
            .into(),
        score: Some(0.24),
        threshold: Some(0.05),
        value: Some(1.24),
        baseline: Some(1.0),
        peak_value: Some(1.24),
        peak_score: Some(0.24),
        onset_at: Some(day(4)),
        onset_run_id: None,
        onset_cycle: None,
        first_seen_at: day(3),
        last_seen_at: now,
        odds: Some(900.0),
        state: "open".into(),
        why: None,
        series: (0..).zip(series).map(|(place, value)| (day(5 - place), value)).collect(),
        told_before: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn origin() -> Origin {
        Origin { identity: "0a1b2c".into(), link: Some("http://armwatch.example.org".into()) }
    }

    fn alarm() -> Alarm {
        let now = "2026-03-01T06:00:00Z".parse().unwrap();
        let event = AlarmEvent { event_id: 7, anomaly_id: 4, ..example(Severity::Critical, now) };
        Alarm::new(event, Some("Turin"))
    }

    fn message(alarms: Vec<Alarm>) -> Message {
        let key = origin().key(7);
        Message {
            key,
            route: "shift".into(),
            origin: origin(),
            is_digest: alarms.len() > 1,
            alarms,
            is_trial: false,
        }
    }

    #[test]
    fn a_message_says_figures_onset_peak_trend_and_urgency() {
        let text = message(vec![alarm()]).text();
        for expected in [
            "critical: TEST (Turin), joint 3: drift opened",
            "  urgency: look before the next shift",
            "  latest test: 1.24, expected 1",
            "  smoothed over 3 tests: 1.19",
            "  out by: 24 %, alarm from 5 %",
            "  peak: 1.24, out by 24 %",
            "  odds of this cause: 900 to 1",
            "  onset: 2026-02-25 06:00:00 UTC",
            "  seen: 2026-02-26 06:00:00 UTC to 2026-03-01 06:00:00 UTC",
            "  anomaly: 4",
            "  http://armwatch.example.org/#/alarm/4",
            "key: armwatch-0a1b2c-7",
        ] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
        assert!(text.contains("  trend: +1.65 in 30 days"), "{text}");
    }

    #[test]
    fn an_alarm_that_ended_keeps_its_peak_and_asks_for_nothing() {
        for (what, name) in [
            (EventKind::Ended, "ended"),
            (EventKind::Resolved, "resolved"),
            (EventKind::Withdrawn, "withdrawn"),
            (EventKind::FalseAlarm, "false alarm"),
        ] {
            let mut ended = alarm();
            ended.event.what = what;
            ended.event.value = Some(0.9964);
            ended.event.message = "joint 2: friction jumped by +25 % between two tests; friction at equal speed and \
                                   warmth is 12 % above the joint's baseline (limit 5 %); latest test: friction index \
                                   0.996; check lubrication, gearbox and brake"
                .into();
            let message = message(vec![ended]);
            assert_eq!(message.title(), format!("{name}: TEST (Turin), joint 3: drift"));
            let text = message.text();
            for expected in [
                "  was: joint 2: friction jumped by +25 % between two tests",
                "  urgency: nothing to do",
                "  latest test that shows it: 0.9964, expected 1",
                "  was out by: 24 %, alarm from 5 %",
                "  peak: 1.24, out by 24 %",
                "  seen: 2026-02-26 06:00:00 UTC to 2026-03-01 06:00:00 UTC",
            ] {
                assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
            }
            for advice in ["check", "latest test:", "in 30 days"] {
                assert!(!text.contains(advice), "{advice} in\n{text}");
            }
            let json = message.json();
            assert_eq!(json["status"], "resolved");
            assert_eq!(json["alarms"][0]["peak_value"], 1.24);
            assert_eq!(
                json["alarms"][0]["message"],
                "was: joint 2: friction jumped by +25 % between two tests"
            );
        }
    }

    #[test]
    fn a_finding_ends_where_figures_and_advice_begin() {
        for (message, found) in [
            (
                "the torque signal has 2.5 times the usual noise; check sensor",
                "the torque signal has 2.5 times the usual noise",
            ),
            (
                "varies (joint 3 by 4 %; correlation +0.90); one cause is likelier",
                "varies (joint 3 by 4 %; correlation +0.90)",
            ),
            (
                "the test gave no result: the signal stands still",
                "the test gave no result: the signal stands still",
            ),
            ("", ""),
        ] {
            assert_eq!(finding(message), found);
        }
    }

    #[test]
    fn a_limit_and_figures_that_there_are_not_are_left_out() {
        let mut offset = alarm();
        offset.event.quantity = Quantity::TorqueOffset;
        offset.event.kind = AnomalyKind::Sensor;
        (offset.event.value, offset.event.baseline) = (Some(-3.25), Some(0.0));
        (offset.event.score, offset.event.threshold) = (Some(3.25), Some(0.0));
        let text = message(vec![offset.clone()]).text();
        for expected in ["  latest test: -3.25 Nm, expected 0 Nm", "  out by: 3.25 Nm"] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
        let mut stuck = offset;
        (stuck.event.value, stuck.event.baseline, stuck.event.peak_value) = (None, None, None);
        (stuck.event.score, stuck.event.threshold) = (Some(1.0), Some(1.0));
        let text = message(vec![stuck]).text();
        assert!(!text.contains("out by") && !text.contains("latest test"), "{text}");
    }

    #[test]
    fn a_load_is_told_in_kg_and_standard_errors_and_its_odds_in_words() {
        let mut load = alarm();
        (load.event.quantity, load.event.kind) = (Quantity::Load, AnomalyKind::Payload);
        (load.event.value, load.event.baseline) = (Some(0.7974), Some(0.0));
        (load.event.score, load.event.threshold, load.event.odds) = (Some(151.0), Some(5.0), Some(1e9));
        let text = message(vec![load]).text();
        for expected in [
            "  latest test: 0.7974 kg, expected 0 kg",
            "  out by: 151 standard errors, alarm from 5 standard errors",
            "  odds of this cause: more than a million to 1",
        ] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
    }

    #[test]
    fn names_and_notes_make_no_line_and_stay_the_same_in_json() {
        let mut hostile = alarm();
        hostile.event.robot = "R\n\u{202e}01\u{1b}[31m".into();
        hostile.event.message = "joint 3\r\nSubject: forged\u{200b}".into();
        hostile.event.why = Some("seen\nurgency: none\u{2028}".into());
        let plain = message(vec![alarm()]).text().lines().count();
        let message = message(vec![hostile.clone()]);
        let text = message.text();
        assert_eq!(text.lines().count(), plain + 1, "the reason is one line more\n{text}");
        assert!(!text.replace('\n', "").contains(text::is_hidden), "{text:?}");
        assert!(!message.title().contains(text::is_hidden), "{}", message.title());
        let json = message.json_text();
        assert!(!json.contains(text::is_hidden), "{json:?}");
        let read: Value = serde_json::from_str(&json).unwrap();
        assert_eq!(read["alarms"][0]["robot"], hostile.event.robot);
    }

    #[test]
    fn a_digest_counts_alarms_by_their_last_word_and_not_events() {
        let of = |anomaly_id: i64, what: EventKind| {
            let mut alarm = alarm();
            (alarm.event.anomaly_id, alarm.event.what) = (anomaly_id, what);
            alarm
        };
        let digest =
            message(vec![of(4, EventKind::Opened), of(5, EventKind::Opened), of(5, EventKind::Ended)]);
        assert_eq!(digest.title(), "digest: 1 alarm, 1 ended, worst critical");
        assert_eq!((digest.status(), digest.json()["alarms"].as_array().unwrap().len()), ("firing", 3));
        let mut reminded = Vec::new();
        for _ in 0..5 {
            reminded.extend((1..=4).map(|anomaly_id| of(anomaly_id, EventKind::Overdue)));
        }
        assert_eq!(message(reminded).title(), "digest: 4 alarms, 0 ended, worst critical");
        let over = message(vec![of(4, EventKind::Opened), of(4, EventKind::Ended)]);
        assert_eq!((over.title().as_str(), over.status()), ("digest: 0 alarms, 1 ended", "resolved"));
    }
}
