//! Sends anomalies to people: routes select, receivers accept, the outbox in the database remembers.
//!
//! Events of anomalies are written in the transaction that changes them. The [`dispatcher`] passes them to the routes
//! that select them and sends due messages: it first stores the attempt, then sends, then stores that the message has
//! arrived. A process that dies between the last two steps sends the message again, with the same key.

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

/// Logs that the next test of a robot is overdue.
pub fn log_overdue(overdue: &OverdueRobot) {
    let OverdueRobot { robot, expected_by } = overdue;
    tracing::warn!(
        robot,
        expected_by,
        "overdue: no test of this robot came by {expected_by}; check that it runs and that its exports arrive"
    );
}
