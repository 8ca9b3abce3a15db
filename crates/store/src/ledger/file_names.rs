//! Runs by the names of files with their content. The query scans all paths; it is for a caller that looks for an
//! upload by its name.

use crate::engine::{Bind, EngineExecutor};
use crate::error::StoreError;
use crate::handle::Store;

impl Store {
    /// The latest run whose content was seen in a file of this name, in any folder. The run may have been read from a
    /// file of another name.
    pub async fn run_of_file_named(&self, name: &str) -> Result<Option<i64>, StoreError> {
        self.checked(run_of_file_named(&self.readers, name).await)
    }
}

/// Most paths, equal except for upper and lower case, that are searched for a name.
const MOST_ALIKE: i64 = 64;

async fn run_of_file_named(executor: impl EngineExecutor<'_>, name: &str) -> sqlx::Result<Option<i64>> {
    let mut literal = String::with_capacity(name.len());
    for character in name.chars() {
        if ['%', '_', '!'].contains(&character) {
            literal.push('!');
        }
        literal.push(character);
    }
    let found: Vec<(String, i64)> = sqlx::query_as(
        "SELECT path, run_id FROM source_file
         WHERE path = $1 OR path LIKE $2 ESCAPE '!'
         ORDER BY run_id DESC
         LIMIT $3",
    )
    .bind_all((name, format!("%/{literal}"), MOST_ALIKE))
    .fetch_all(executor)
    .await?;
    // SQLite ignores the difference between upper and lower case
    let is_named =
        |path: &str| path.strip_suffix(name).is_some_and(|rest| rest.is_empty() || rest.ends_with('/'));
    Ok(found.into_iter().find(|(path, _)| is_named(path)).map(|(_, run_id)| run_id))
}
