//! Whether routes work: their secrets and certificates, and a message that says that it is a try.

use std::time::Duration;

use jiff::Timestamp;

use super::message::{Alarm, Message, Origin, example};
use super::receiver::{SendError, Unusable};
use super::receivers::open;
use armwatch_config::{AlertSettings, Route};
use armwatch_model::anomaly::Severity;

/// What keeps routes from working as they are configured, by their names.
#[must_use]
pub fn problems(settings: &AlertSettings) -> Vec<(String, Unusable)> {
    let problem = |route: &Route| Some((route.name.clone(), open(route).err()?));
    settings.routes.iter().filter_map(problem).collect()
}

/// Sends a message over a route that says that it is a try, whatever its filters and hours are.
///
/// # Errors
/// `SendError`, also for a receiver that cannot be used as it is configured.
pub async fn send(
    settings: &AlertSettings,
    route: &Route,
    identity: &str,
    severity: Severity,
) -> Result<Duration, SendError> {
    let receiver = open(route).map_err(|error| SendError::unreached(error.to_string()))?;
    let now = Timestamp::now();
    let origin = Origin { identity: identity.to_owned(), link: settings.link.clone() };
    let event = example(severity, now);
    let message = Message {
        // each try is a message of its own
        key: format!("armwatch-{identity}-test-{}", now.as_microsecond()),
        route: route.name.clone(),
        origin,
        alarms: vec![Alarm::new(
            event,
            settings.site_of("TEST"),
            route.language.unwrap_or(settings.language),
        )],
        is_digest: false,
        is_trial: true,
    };
    let started = std::time::Instant::now();
    receiver.send(&message).await?;
    Ok(started.elapsed())
}
