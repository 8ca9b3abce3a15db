//! The handle of an open database.

use std::path::Path;
use std::sync::Arc;

use sqlx::SqlitePool;

/// An open database. Clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) path: Arc<Path>,
    pub(super) writer: SqlitePool,
    pub(super) readers: SqlitePool,
    /// A reader for questions about the database's health: it takes no turn of the others.
    pub(super) probe: SqlitePool,
}
