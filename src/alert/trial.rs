//! Tests of routes: their secrets and certificates, and a message that is marked as a test.

use std::time::Duration;

use jiff::Timestamp;

use super::message::{Alarm, Message, Origin, example};
use super::receiver::{SendError, Unusable};
use super::receivers::open;
use armwatch_config::{AlertSettings, Route};
use armwatch_model::anomaly::Severity;

/// Problems that prevent routes from working as configured, by route name.
pub fn problems(settings: &AlertSettings) -> Vec<(String, Unusable)> {
    let problem = |route: &Route| Some((route.name.clone(), open(route).err()?));
    settings.routes.iter().filter_map(problem).collect()
}

/// Sends a message that is marked as a test over a route, ignoring its filters and hours.
///
/// # Errors
/// `SendError`, also for a receiver that cannot be used as configured.
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
        // each test message is distinct
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
