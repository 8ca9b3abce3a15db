//! Robots by their names.

use crate::engine::{EngineConnection, EngineExecutor};
use crate::error::StoreError;
use crate::handle::Store;
use armwatch_model::robot::name::composed;

impl Store {
    /// Names of the robots that have runs which were read, or are being read.
    pub async fn known_robots(&self) -> Result<Vec<String>, StoreError> {
        let names = sqlx::query_scalar(
            "SELECT name FROM robot
             WHERE EXISTS (SELECT 1 FROM run
                           WHERE run.robot_id = robot.robot_id AND run.status IN ('complete', 'streaming'))",
        );
        self.checked(names.fetch_all(&self.readers).await)
    }

    /// Returns true if a robot of this name has runs which were read, or are being read.
    pub async fn knows_robot(&self, name: &str) -> Result<bool, StoreError> {
        let found = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM run JOIN robot USING (robot_id)
                            WHERE robot.name = $1 AND run.status IN ('complete', 'streaming'))",
        );
        self.checked(found.bind(name).fetch_one(&self.readers).await)
    }
}

/// Key of a robot, which is inserted with its first run. A robot whose name an earlier version has stored in another
/// form of Unicode gets this name.
pub(crate) async fn robot_id(connection: &mut EngineConnection, name: &str) -> sqlx::Result<i64> {
    if let Some(known) = find_robot(&mut *connection, name).await? {
        return Ok(known);
    }
    if !name.is_ascii() {
        let names: Vec<(i64, String)> =
            sqlx::query_as("SELECT robot_id, name FROM robot").fetch_all(&mut *connection).await?;
        if let Some((robot_id, _)) = names.into_iter().find(|(_, known)| composed(known) == name) {
            let renamed =
                sqlx::query("UPDATE robot SET name = $2 WHERE robot_id = $1").bind(robot_id).bind(name);
            renamed.execute(connection).await?;
            return Ok(robot_id);
        }
    }
    sqlx::query_scalar("INSERT INTO robot (name) VALUES ($1) RETURNING robot_id")
        .bind(name)
        .fetch_one(connection)
        .await
}

async fn find_robot(executor: impl EngineExecutor<'_>, name: &str) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar("SELECT robot_id FROM robot WHERE name = $1").bind(name).fetch_optional(executor).await
}
