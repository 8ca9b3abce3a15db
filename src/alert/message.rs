//! What a receiver is told: one alarm, or a digest of several, as text and as JSON.

use jiff::Timestamp;
use serde_json::{Value, json};

use super::trend::Trend;
use crate::anomaly::Severity;
use crate::store::{AlarmEvent, EventKind};

/// Who sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// What tells this database from others.
    pub identity: String,
    /// Address that messages refer people to.
    pub link: Option<String>,
}

impl Origin {
    /// The key of an event, the same in every attempt: what a receiver tells a repetition by.
    #[must_use]
    pub fn key(&self, event_id: i64) -> String {
        format!("armwatch-{}-{event_id}", self.identity)
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
        format!("{}{site}, {joint}", self.event.robot)
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

    /// The figures, a line each.
    #[must_use]
    pub fn details(&self) -> Vec<String> {
        let AlarmEvent { quantity, score, threshold, value, baseline, peak_value, peak_score, .. } =
            &self.event;
        let mut lines = vec![self.event.message.clone()];
        let mut line = |name: &str, text: Option<String>| {
            lines.extend(text.map(|text| format!("{name}: {text}")));
        };
        line("urgency", Some(self.urgency().to_owned()));
        line("quantity", Some(quantity.clone()));
        line(
            "latest test",
            value.map(|value| match baseline {
                Some(baseline) => format!("{}, expected {}", figure(value), figure(*baseline)),
                None => figure(value),
            }),
        );
        line("smoothed over 3 tests", self.trend.smoothed.map(figure));
        line(
            "out by",
            score.map(|score| match threshold {
                Some(threshold) => format!("{}, alarm from {}", figure(score), figure(*threshold)),
                None => figure(score),
            }),
        );
        line(
            "peak",
            peak_value.map(|peak| match peak_score {
                Some(score) => format!("{}, out by {}", figure(peak), figure(*score)),
                None => figure(peak),
            }),
        );
        line("trend", self.trend.slope_30_d.map(|slope| format!("{} in 30 days", signed(slope))));
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
        line("odds of this cause", self.event.odds.map(figure));
        line("why", self.event.why.clone());
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
            "message": event.message,
            "urgency": self.urgency(),
            "severity": event.severity.name(),
            "anomaly_id": event.anomaly_id,
            "robot": event.robot,
            "joint": event.joint,
            "site": self.site,
            "kind": event.kind,
            "quantity": event.quantity,
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
                let open = alarms.iter().filter(|alarm| !alarm.is_closed()).count();
                let worst =
                    alarms.iter().filter(|alarm| !alarm.is_closed()).map(|alarm| alarm.event.severity);
                let worst = worst.max().map(|worst| format!(", worst {worst}")).unwrap_or_default();
                format!("digest: {open} alarms, {} ended{worst}", alarms.len() - open)
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
            lines.push(String::new());
        }
        lines.extend(self.origin.link.clone());
        lines.push(format!("key: {}", self.key));
        lines.join("\n") + "\n"
    }

    /// The message as JSON: what MQTT and commands get.
    #[must_use]
    pub fn json(&self) -> Value {
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
        if self.alarms.iter().any(|alarm| !alarm.is_closed()) { "firing" } else { "resolved" }
    }

    /// The largest severity of an alarm in it.
    #[must_use]
    pub fn severity(&self) -> Severity {
        self.alarms.iter().map(|alarm| alarm.event.severity).max().unwrap_or(Severity::Info)
    }
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
        EventKind::Corrected | EventKind::Acknowledged | EventKind::Shelved | EventKind::Maintenance => {
            what.name()
        }
    }
}

/// A figure with four digits that count.
fn figure(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    // between -300 and 300
    let before_point = value.abs().log10().floor() as i32;
    let decimals = usize::try_from(3 - before_point).unwrap_or(0).min(12);
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn signed(value: f64) -> String {
    if value > 0.0 { format!("+{}", figure(value)) } else { figure(value) }
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
        kind: "drift".into(),
        quantity: "friction_index".into(),
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
            "  out by: 0.24, alarm from 0.05",
            "  peak: 1.24, out by 0.24",
            "  onset: 2026-02-25 06:00:00 UTC",
            "  seen: 2026-02-26 06:00:00 UTC to 2026-03-01 06:00:00 UTC",
            "  anomaly: 4",
            "http://armwatch.example.org",
            "key: armwatch-0a1b2c-7",
        ] {
            assert!(text.lines().any(|line| line == expected), "{expected}\nnot in\n{text}");
        }
        assert!(text.contains("  trend: +1.65 in 30 days"), "{text}");
    }

    #[test]
    fn an_alarm_that_ended_keeps_its_peak_and_asks_for_nothing() {
        let mut ended = alarm();
        ended.event.what = EventKind::Ended;
        ended.event.value = Some(1.01);
        let message = message(vec![ended]);
        assert_eq!(message.title(), "ended: TEST (Turin), joint 3: drift");
        assert!(message.text().contains("peak: 1.24, out by 0.24"), "{}", message.text());
        assert!(message.text().contains("urgency: nothing to do"), "{}", message.text());
        assert_eq!(message.json()["status"], "resolved");
        assert_eq!(message.json()["alarms"][0]["peak_value"], 1.24);
    }

    #[test]
    fn a_digest_counts_what_is_open_and_what_ended() {
        let mut ended = alarm();
        ended.event.what = EventKind::Ended;
        let message = message(vec![alarm(), ended]);
        assert_eq!(message.title(), "digest: 1 alarms, 1 ended, worst critical");
        assert_eq!(message.json()["alarms"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn figures_have_four_digits() {
        let shown: Vec<String> = [1.0, 0.012_345_6, 123.456, 12_345.6, -0.5, 0.0].map(figure).into();
        assert_eq!(shown, ["1", "0.01235", "123.5", "12346", "-0.5", "0"]);
    }
}
