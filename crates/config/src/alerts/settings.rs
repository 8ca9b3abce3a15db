//! What the configuration says of the delivery of alarms, read and checked.

use std::time::Duration;

use jiff::civil::Time;
use jiff::tz::TimeZone;

use super::language::Language;
use super::receivers::{LogSettings, ReceiverSettings};
use crate::pattern;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Name of the route that stands where the configuration has none.
pub const DEFAULT_ROUTE: &str = "log";

/// Delivery of alarms.
#[derive(Debug, Clone, PartialEq)]
pub struct AlertSettings {
    /// Where which robots stand; the first whose pattern matches a robot is its own.
    pub sites: Vec<Site>,
    /// After this time without an answer an open alarm speaks again; `None`: never.
    pub remind_after: Option<Duration>,
    /// A delivery that has failed for so long is given up.
    pub give_up_after: Duration,
    /// Shortest and longest pause before another attempt.
    pub retry: (Duration, Duration),
    /// Language of messages, unless a route has its own.
    pub language: Language,
    /// Address that messages refer people to.
    pub link: Option<String>,
    /// To whom.
    pub routes: Vec<Route>,
}

impl AlertSettings {
    /// The site of a robot.
    #[must_use]
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

/// Which alarms go to which receiver, and when.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    /// Its name, by which the database knows what it has had.
    pub name: String,
    /// Least severity.
    pub severity: Severity,
    /// Patterns over the names of robots; `None`: all.
    pub robots: Option<Vec<String>>,
    /// Kinds of anomalies; `None`: all.
    pub kinds: Option<Vec<AnomalyKind>>,
    /// Names of sites; `None`: all, and robots of none.
    pub sites: Option<Vec<String>>,
    /// Language of its messages; `None`: that of all routes.
    pub language: Option<Language>,
    /// Time zone of the two below.
    pub zone: TimeZone,
    /// When what is not critical waits.
    pub quiet: Option<QuietHours>,
    /// Time of day at which all of the last day goes out as one message; `None`: each at once.
    pub digest_at: Option<Time>,
    /// Most messages within an hour; the others wait and become one.
    pub most_per_h: u32,
    /// Where to.
    pub receiver: ReceiverSettings,
}

impl Route {
    /// The route of a configuration without one: everything into the log.
    #[must_use]
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
    #[must_use]
    pub fn takes(&self, robot: &str, site: Option<&str>, kind: AnomalyKind, severity: Severity) -> bool {
        let of_robot =
            |patterns: &Vec<String>| patterns.iter().any(|pattern| pattern::matches(pattern, robot));
        severity >= self.severity
            && self.robots.as_ref().is_none_or(of_robot)
            && self.kinds.as_ref().is_none_or(|kinds| kinds.contains(&kind))
            && self.sites.as_ref().is_none_or(|sites| sites.iter().any(|name| Some(name.as_str()) == site))
    }
}

/// Hours of the day in which what is not critical waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QuietHours {
    /// First moment.
    pub from: Time,
    /// First moment after; on the next day if it is not later than `from`.
    pub to: Time,
}
