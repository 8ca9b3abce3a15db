//! Checked configuration of the delivery of alarms.

use std::time::Duration;

use jiff::civil::Time;
use jiff::tz::TimeZone;

use super::language::Language;
use super::receivers::{LogSettings, ReceiverSettings};
use crate::pattern;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Name of the route that is used if the configuration has none.
pub const DEFAULT_ROUTE: &str = "log";

/// Delivery of alarms.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertSettings {
    /// Sites of robots; the first whose pattern matches a robot applies.
    pub sites: Vec<Site>,
    /// Time after which an open alarm without an answer is sent again; `None` for never.
    pub remind_after: Option<Duration>,
    /// Time until a failing delivery ends.
    pub give_up_after: Duration,
    /// Shortest and longest pause before another attempt.
    pub retry: (Duration, Duration),
    /// Language of messages, unless a route has its own.
    pub language: Language,
    /// Address of the dashboard in messages.
    pub link: Option<String>,
    /// The routes.
    pub routes: Vec<Route>,
}

impl AlertSettings {
    /// The site of a robot.
    pub fn site_of(&self, robot: &str) -> Option<&str> {
        let of_robot = |site: &&Site| site.robots.iter().any(|pattern| pattern::matches(pattern, robot));
        self.sites.iter().find(of_robot).map(|site| site.name.as_str())
    }
}

/// A place with its robots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Site {
    /// Its name.
    pub name: String,
    /// Patterns over the names of robots.
    pub robots: Vec<String>,
}

/// A rule that selects alarms, a receiver, and times.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Its name, under which the database stores its deliveries.
    pub name: String,
    /// Least severity.
    pub severity: Severity,
    /// Patterns over the names of robots; `None`: all.
    pub robots: Option<Vec<String>>,
    /// Kinds of anomalies; `None`: all.
    pub kinds: Option<Vec<AnomalyKind>>,
    /// Names of sites; `None` for all robots, including those without a site.
    pub sites: Option<Vec<String>>,
    /// Language of its messages; `None`: that of all routes.
    pub language: Option<Language>,
    /// Time zone of `quiet` and `digest_at`.
    pub zone: TimeZone,
    /// Hours during which messages that are not critical wait.
    pub quiet: Option<QuietHours>,
    /// Time of day for one message with all alarms of the last day; `None` to send each at once.
    pub digest_at: Option<Time>,
    /// Most messages within an hour; the others wait and are combined.
    pub most_per_h: u32,
    /// The receiver.
    pub receiver: ReceiverSettings,
}

impl Route {
    /// The route of a configuration without one: the log receives everything.
    pub fn log() -> Self {
        Self {
            name: DEFAULT_ROUTE.to_owned(),
            severity: Severity::Info,
            robots: None,
            kinds: None,
            sites: None,
            language: None,
            zone: TimeZone::UTC,
            quiet: None,
            digest_at: None,
            most_per_h: u32::MAX,
            receiver: ReceiverSettings::Log(LogSettings),
        }
    }

    /// Returns true if the route takes anomalies of this kind and severity from robots at this site.
    pub fn takes(&self, robot: &str, site: Option<&str>, kind: AnomalyKind, severity: Severity) -> bool {
        let of_robot =
            |patterns: &Vec<String>| patterns.iter().any(|pattern| pattern::matches(pattern, robot));
        severity >= self.severity
            && self.robots.as_ref().is_none_or(of_robot)
            && self.kinds.as_ref().is_none_or(|kinds| kinds.contains(&kind))
            && self.sites.as_ref().is_none_or(|sites| sites.iter().any(|name| Some(name.as_str()) == site))
    }
}

/// Hours of the day during which messages that are not critical wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuietHours {
    /// Start.
    pub from: Time,
    /// End; on the next day if it is not later than `from`.
    pub to: Time,
}
