//! Content for a receiver: one alarm, or a digest of several, as text and as JSON.
//!
//! Titles, sentences and details are for people and show hidden characters ([`text::shown`]). Names in JSON are
//! unchanged.

use jiff::Timestamp;
use serde_json::{Value, json};

use super::figures::Figures;
use super::trend::TrendFigures;
use crate::language::{Language, clauses, finding, say, translated};
use armwatch_model::anomaly::odds::odds_in_words;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};
use armwatch_model::text;
use armwatch_store::{AlarmEvent, EventKind};

/// The sender.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// Distinguishes this database from others.
    pub identity: String,
    /// Address of the dashboard, for people.
    pub link: Option<String>,
}

impl Origin {
    /// The key of an event. It is the same in every attempt, so that a receiver detects repetitions.
    pub fn key(&self, event_id: i64) -> String {
        format!("armwatch-{}-{event_id}", self.identity)
    }

    /// Address of an anomaly in the dashboard.
    pub fn page_of(&self, anomaly_id: i64) -> Option<String> {
        let link = self.link.as_deref()?.trim_end_matches('/');
        Some(format!("{link}/#/alarm/{anomaly_id}"))
    }

    /// Identity of an anomaly at a receiver, independent of its state.
    pub fn anomaly(&self, anomaly_id: i64) -> String {
        format!("armwatch-{}-anomaly-{anomaly_id}", self.identity)
    }
}

/// An alarm event with the data that is sent with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// The event.
    pub event: AlarmEvent,
    /// Site of the robot.
    pub site: Option<String>,
    /// Trend of the quantity.
    pub trend: TrendFigures,
    /// Language of the texts for people.
    pub language: Language,
}

impl Alarm {
    /// Creates an alarm from an event of a robot at a site, with texts in `language`.
    pub fn new(event: AlarmEvent, site: Option<&str>, language: Language) -> Self {
        let trend = TrendFigures::of(&event.series);
        Self { event, site: site.map(str::to_owned), trend, language }
    }

    fn say(&self, english: &str, values: &[&str]) -> String {
        say(self.language, english, values)
    }

    /// Returns true if the alarm has ended.
    pub fn is_closed(&self) -> bool {
        self.event.what.closes()
    }

    /// How soon a person should act.
    pub fn urgency(&self) -> String {
        let urgency = match self.event.severity {
            _ if self.is_closed() => "nothing to do",
            Severity::Info => "worth knowing",
            Severity::Warning => "plan an inspection",
            Severity::Critical => "inspect before the next shift",
        };
        self.say(urgency, &[])
    }

    /// Robot and joint in words.
    pub fn place(&self) -> String {
        let joint = match self.event.joint {
            Some(joint) => self.say("joint {0}", &[&joint.to_string()]),
            None => self.say("whole arm", &[]),
        };
        let site = self.site.as_ref().map(|site| format!(" ({site})")).unwrap_or_default();
        text::shown(&format!("{}{site}, {joint}", self.event.robot)).into_owned()
    }

    /// One line: severity, robot, joint, quantity and event.
    pub fn title(&self) -> String {
        let AlarmEvent { severity, kind, .. } = &self.event;
        let (place, happened) = (self.place(), self.say(happened(self.event.what), &[]));
        let (severity, kind) = match self.language {
            Language::English => (severity.name().to_owned(), kind.name().to_owned()),
            _ => (self.say(severity.name(), &[]), self.say(kind.label(), &[])),
        };
        match (self.is_closed(), self.language) {
            (true, _) => format!("{happened}: {place}: {kind}"),
            (false, Language::English) => format!("{severity}: {place}: {kind} {happened}"),
            (false, _) => format!("{severity}: {place}: {kind}, {happened}"),
        }
    }

    /// What a technician should read. Of an alarm that is over it is what was found, without figures of the latest test
    /// and without advice.
    pub fn sentence(&self) -> String {
        let message = text::shown(&self.event.message);
        if self.is_closed() {
            let found = clauses(&message).first().map(|found| finding(self.language, found).into_owned());
            return self.say("was: {0}", &[&found.unwrap_or_default()]);
        }
        finding(self.language, &message).into_owned()
    }

    /// The values: name and text. The sentence, robot and joint are not included.
    pub fn facts(&self) -> Vec<(String, String)> {
        let AlarmEvent { quantity, score, threshold, value, baseline, peak_value, peak_score, .. } =
            &self.event;
        let figures = Figures(*quantity, self.language);
        let is_closed = self.is_closed();
        let mut facts = Vec::new();
        let mut fact = |name: &str, text: Option<String>| {
            facts.extend(text.map(|text| (self.say(name, &[]), text)));
        };
        fact("urgency", Some(self.urgency()));
        let quantity = match self.language {
            Language::English => quantity.to_string(),
            _ => self.say(quantity.label(), &[]),
        };
        fact("quantity", Some(quantity));
        fact(
            if is_closed { "latest test that shows it" } else { "latest test" },
            value.map(|value| match baseline {
                Some(baseline) => {
                    self.say("{0}, expected {1}", &[&figures.value(value), &figures.value(*baseline)])
                }
                None => figures.value(value),
            }),
        );
        // the trend is useless when no action is needed
        let trend = if is_closed { TrendFigures::default() } else { self.trend };
        fact("smoothed over 3 tests", trend.smoothed.map(|smoothed| figures.value(smoothed)));
        // without a value there is no score; some anomalies have no limit
        let score = score.filter(|_| value.is_some());
        let limit = threshold.filter(|limit| *limit != 0.0);
        fact(
            if is_closed { "was out by" } else { "out by" },
            score.map(|score| match limit {
                Some(limit) => {
                    self.say("{0}, alarm from {1}", &[&figures.score(score), &figures.score(limit)])
                }
                None => figures.score(score),
            }),
        );
        fact(
            "peak",
            peak_value.map(|peak| match peak_score {
                Some(score) => self.say("{0}, out by {1}", &[&figures.value(peak), &figures.score(*score)]),
                None => figures.value(peak),
            }),
        );
        fact("trend", trend.slope_30_d.map(|slope| self.say("{0} in 30 days", &[&figures.change(slope)])));
        let AlarmEvent { onset_at, onset_run_id, onset_cycle, first_seen_at, last_seen_at, .. } = &self.event;
        fact(
            "onset",
            onset_at.map(|at| {
                let run = onset_run_id.map(|run| format!(", {}", self.say("run {0}", &[&run.to_string()])));
                let cycle =
                    onset_cycle.map(|cycle| format!(", {}", self.say("cycle {0}", &[&cycle.to_string()])));
                format!("{}{}{}", seconds(&at), run.unwrap_or_default(), cycle.unwrap_or_default())
            }),
        );
        fact("seen", Some(self.say("{0} to {1}", &[&seconds(first_seen_at), &seconds(last_seen_at)])));
        let odds = self.event.odds.map(odds_in_words);
        fact("odds of this cause", odds.map(|odds| translated(self.language, &odds).into_owned()));
        fact("why", self.event.why.as_deref().map(|why| text::shown(why).into_owned()));
        fact("anomaly", Some(self.event.anomaly_id.to_string()));
        facts
    }

    /// The sentence and the values, one per line.
    pub fn details(&self) -> Vec<String> {
        let facts = self.facts().into_iter().map(|(name, text)| format!("{name}: {text}"));
        std::iter::once(self.sentence()).chain(facts).collect()
    }

    /// The alarm as JSON for MQTT and commands.
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

/// One message to a receiver.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Key, the same in every attempt.
    pub key: String,
    /// The route.
    pub route: String,
    /// The sender.
    pub origin: Origin,
    /// Its alarms, in chronological order.
    pub alarms: Vec<Alarm>,
    /// True if it combines several delayed alarms.
    pub is_digest: bool,
    /// True if it is marked as a test.
    pub is_trial: bool,
}

impl Message {
    /// Language of all alarms in it.
    pub fn language(&self) -> Language {
        self.alarms.first().map(|alarm| alarm.language).unwrap_or_default()
    }

    fn say(&self, english: &str, values: &[&str]) -> String {
        say(self.language(), english, values)
    }

    /// Title in one line.
    pub fn title(&self) -> String {
        match self.alarms.as_slice() {
            [alarm] if !self.is_digest => alarm.title(),
            alarms => {
                let latest = latest(alarms);
                let open = latest.iter().filter(|alarm| !alarm.is_closed());
                let worst = open.clone().map(|alarm| alarm.event.severity).max();
                let (open, all) = (open.count(), latest.len());
                let (open, ended) = (open.to_string(), (all - open).to_string());
                let noun = if open == "1" {
                    "digest: {0} alarm, {1} ended"
                } else {
                    "digest: {0} alarms, {1} ended"
                };
                let digest = self.say(noun, &[&open, &ended]);
                match worst {
                    Some(worst) => self.say("{0}, worst {1}", &[&digest, &self.say(worst.name(), &[])]),
                    None => digest,
                }
            }
        }
    }

    /// The whole message for people.
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

    /// The message as JSON text for MQTT and commands.
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
    pub fn status(&self) -> &'static str {
        if latest(&self.alarms).iter().any(|alarm| !alarm.is_closed()) { "firing" } else { "resolved" }
    }

    /// The largest severity of an alarm in it.
    pub fn severity(&self) -> Severity {
        self.alarms.iter().map(|alarm| alarm.event.severity).max().unwrap_or(Severity::Info)
    }
}

/// The text of JSON for receivers, see [`text::json`].
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

/// The latest event of each alarm, from events in chronological order.
fn latest(events: &[Alarm]) -> Vec<&Alarm> {
    let is_last = |place: usize, of: &Alarm| {
        events[place + 1..].iter().all(|later| later.event.anomaly_id != of.event.anomaly_id)
    };
    events.iter().enumerate().filter(|(place, of)| is_last(*place, of)).map(|(_, of)| of).collect()
}

fn seconds(time: &Timestamp) -> String {
    time.strftime("%Y-%m-%d %H:%M:%S UTC").to_string()
}

/// An example alarm, for a test of a route.
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
        message: "this is a test of the route and concerns no robot; friction at equal speed and temperature would be 24 % above \
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
mod tests;
