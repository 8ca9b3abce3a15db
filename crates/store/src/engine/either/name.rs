//! The engine that is SQLite or PostgreSQL, by the connection.

/// Either engine, for statements that both understand.
#[derive(Debug)]
pub(crate) struct Engine;
