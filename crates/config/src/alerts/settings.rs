//! What the configuration says of the delivery of alarms, read and checked.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use jiff::civil::Time;
use jiff::tz::TimeZone;

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
            zone: TimeZone::UTC,
            quiet: None,
            digest_at: None,
            most_per_h: u32::MAX,
            receiver: ReceiverSettings::Log,
        }
    }

    /// Whether it is for a robot at a site with an anomaly of a kind, given by its name, and a severity.
    #[must_use]
    pub fn takes(&self, robot: &str, site: Option<&str>, kind: &str, severity: Severity) -> bool {
        let of_robot =
            |patterns: &Vec<String>| patterns.iter().any(|pattern| pattern::matches(pattern, robot));
        severity >= self.severity
            && self.robots.as_ref().is_none_or(of_robot)
            && self.kinds.as_ref().is_none_or(|kinds| kinds.iter().any(|known| known.name() == kind))
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

/// Where messages go.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReceiverSettings {
    /// The log of the program.
    Log,
    /// An address that takes the payload of Alertmanager's webhooks, version 4.
    Webhook(WebhookSettings),
    /// An Alertmanager, by its API version 2.
    Alertmanager(AlertmanagerSettings),
    /// Mail by SMTP.
    Email(EmailSettings),
    /// A topic of an MQTT 5 broker.
    Mqtt(MqttSettings),
    /// A program.
    Command(CommandSettings),
}

impl ReceiverSettings {
    /// Name as in the configuration.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Log => "log",
            Self::Webhook(_) => "webhook",
            Self::Alertmanager(_) => "alertmanager",
            Self::Email(_) => "email",
            Self::Mqtt(_) => "mqtt",
            Self::Command(_) => "command",
        }
    }

    /// Where to, without what is secret.
    #[must_use]
    pub fn target(&self) -> String {
        match self {
            Self::Log => "the log".into(),
            Self::Webhook(to) => match &to.url {
                Address::Plain(url) => url.clone(),
                Address::Secret(secret) => format!("the address in {secret}"),
            },
            Self::Alertmanager(to) => to.url.clone(),
            Self::Email(to) => format!("{} by {}:{}", to.to.join(", "), to.host, to.port),
            Self::Mqtt(to) => format!("{} at {}:{}", to.topic, to.host, to.port),
            Self::Command(to) => to.arguments.first().cloned().unwrap_or_default(),
        }
    }
}

impl ReceiverSettings {
    /// The secrets that the receiver needs.
    pub fn secrets(&self) -> impl Iterator<Item = &Secret> {
        let of_http = |login| match login {
            &HttpLogin::None => None,
            HttpLogin::Bearer(secret) | HttpLogin::Basic { password: secret, .. } => Some(secret),
        };
        let secrets = match self {
            Self::Log | Self::Command(_) => [None, None, None],
            Self::Webhook(WebhookSettings { url, signing_secret, login, .. }) => {
                let url = if let Address::Secret(secret) = url { Some(secret) } else { None };
                [url, signing_secret.as_ref(), of_http(login)]
            }
            Self::Alertmanager(settings) => [of_http(&settings.login), None, None],
            Self::Email(EmailSettings { login, .. }) | Self::Mqtt(MqttSettings { login, .. }) => {
                [login.as_ref().map(|(_, secret)| secret), None, None]
            }
        };
        secrets.into_iter().flatten()
    }
}

/// Where something stands that is not to be read by everybody.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Secret {
    /// A file; its first line.
    File(PathBuf),
    /// A variable of the environment.
    Environment(String),
}

impl fmt::Display for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "the file {}", path.display()),
            Self::Environment(name) => write!(f, "the environment variable {name}"),
        }
    }
}

/// An address; some are secret, since who knows them may write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// As it stands in the configuration.
    Plain(String),
    /// Kept elsewhere.
    Secret(Secret),
}

/// Who we are to an HTTP server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HttpLogin {
    /// Nobody.
    None,
    /// A bearer token.
    Bearer(Secret),
    /// User and password, RFC 7617.
    Basic {
        /// The user.
        user: String,
        /// The password.
        password: Secret,
    },
}

/// An address that takes webhooks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebhookSettings {
    /// Where to, `http://` or `https://`.
    pub url: Address,
    /// Key of the signature; `None`: unsigned.
    pub signing_secret: Option<Secret>,
    /// Who we are.
    pub login: HttpLogin,
    /// Certificates, PEM, that are trusted in place of the system's.
    pub ca_file: Option<PathBuf>,
    /// Longest time for an answer.
    pub timeout: Duration,
}

/// An Alertmanager.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlertmanagerSettings {
    /// Its address, without `/api/v2/alerts`.
    pub url: String,
    /// Who we are.
    pub login: HttpLogin,
    /// Certificates, PEM, that are trusted in place of the system's.
    pub ca_file: Option<PathBuf>,
    /// Longest time for an answer.
    pub timeout: Duration,
    /// Time after which open alarms are told again: an Alertmanager that starts anew has forgotten them.
    pub refresh: Duration,
}

/// How a connection is encrypted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encryption {
    /// From the first byte on.
    Tls,
    /// After the server has offered it; refused without.
    StartTls,
    /// Not at all.
    None,
}

/// Mail.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EmailSettings {
    /// Server.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// How it is spoken to.
    pub encryption: Encryption,
    /// Who we are, where the server asks.
    pub login: Option<(String, Secret)>,
    /// Certificates, PEM, that are trusted beside the system's.
    pub ca_file: Option<PathBuf>,
    /// Sender, as `armwatch <armwatch@example.org>`.
    pub from: String,
    /// Receivers.
    pub to: Vec<String>,
    /// Longest time for a mail.
    pub timeout: Duration,
}

/// A topic of a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// Broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// [`Encryption::Tls`] or [`Encryption::None`].
    pub encryption: Encryption,
    /// Who we are, where the broker asks.
    pub login: Option<(String, Secret)>,
    /// Certificates, PEM, that are trusted in place of the system's.
    pub ca_file: Option<PathBuf>,
    /// First levels of the topic; robot and number of the anomaly follow.
    pub topic: String,
    /// Longest time for an acknowledgement.
    pub timeout: Duration,
}

/// A program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandSettings {
    /// The program and its arguments; no shell.
    pub arguments: Vec<String>,
    /// It is killed after this time.
    pub timeout: Duration,
}
