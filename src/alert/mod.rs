//! Anomalies to people: routes choose, receivers take, the outbox in the database remembers.
//!
//! Events of anomalies are written in the transaction that changes them. The [`dispatcher`] hands them to the routes
//! that want them and sends what is due: first it writes down that it tries, then it sends, then it writes down that
//! the message has arrived. A process that dies between the two last steps sends the message again, with the same key.

mod figures;
mod message;
mod picture;
mod trend;
mod receiver;
mod receivers;
mod secret;
mod tls;
mod http;
mod route;
mod worker;
pub mod dispatcher;
pub mod trial;

use armwatch_store::OverdueRobot;

/// Logs that the next test of a robot should have come.
pub fn log_overdue(overdue: &OverdueRobot) {
    let OverdueRobot { robot, expected_by } = overdue;
    tracing::warn!(
        robot,
        expected_by,
        "overdue: no test of this robot came by {expected_by}; check that it runs and that its exports arrive"
    );
}
