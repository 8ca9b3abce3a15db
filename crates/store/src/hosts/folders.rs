//! Watched folders that do not answer their daemon, for display by commands.

use jiff::Timestamp;
use serde::Serialize;
use sqlx::Row;

use crate::engine::EngineRow;
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{known_in_views, time};

/// A watched folder whose disk or file server does not answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct UnansweredFolder {
    /// The daemon that watches it; empty for one without a name.
    pub host: String,
    /// The folder.
    pub folder: String,
    /// Time of the daemon's last scan; `None` if there was none since its start.
    #[serde(rename = "last_scan_at", serialize_with = "known_in_views")]
    pub looked_at: Option<Timestamp>,
}

impl Store {
    /// Stores that a watched folder does not answer, with the time of its last scan, or that it answers again.
    pub async fn note_folder(
        &self,
        folder: &str,
        looked_at: Option<Timestamp>,
        answers: bool,
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let statement = match answers {
            true => sqlx::query("DELETE FROM unanswered_folder WHERE host = $1 AND folder = $2"),
            false => sqlx::query(
                "INSERT INTO unanswered_folder (host, folder, looked_at) VALUES ($1, $2, $3)
                 ON CONFLICT (host, folder) DO UPDATE SET looked_at = excluded.looked_at",
            ),
        };
        let mut statement = statement.bind(self.own_host.place().host()).bind(folder);
        if !answers {
            statement = statement.bind(looked_at.map(Timestamp::as_microsecond));
        }
        self.checked(statement.execute(&mut *transaction).await)?;
        self.commit(transaction).await
    }

    /// Deletes the entries of this host's last daemon by [`Store::note_folder`].
    pub async fn forget_folders(&self) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let forgotten =
            sqlx::query("DELETE FROM unanswered_folder WHERE host = $1").bind(self.own_host.place().host());
        self.checked(forgotten.execute(&mut *transaction).await)?;
        self.commit(transaction).await
    }

    /// The watched folders that do not answer, by host and name.
    pub async fn unanswered_folders(&self) -> Result<Vec<UnansweredFolder>, StoreError> {
        let rows = sqlx::query("SELECT host, folder, looked_at FROM unanswered_folder ORDER BY host, folder");
        let rows = rows.try_map(|row: EngineRow| {
            let looked_at: Option<i64> = row.try_get("looked_at")?;
            Ok(UnansweredFolder {
                host: row.try_get("host")?,
                folder: row.try_get("folder")?,
                looked_at: looked_at.map(|_| time(&row, "looked_at")).transpose()?,
            })
        });
        self.checked(rows.fetch_all(&self.readers).await)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_folder_is_told_until_it_answers_or_the_daemon_starts_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("fleet.db")).await.expect("a database");
        let looked_at = Timestamp::from_second(1_772_352_000).ok();
        let told = async || store.unanswered_folders().await.expect("folders");
        for (path, at) in [("/mnt/b", None), ("/mnt/a", None), ("/mnt/a", looked_at)] {
            store.note_folder(path, at, false).await.expect("written");
        }
        let rows: Vec<_> = told().await.into_iter().map(|of| (of.host, of.folder, of.looked_at)).collect();
        let row = |path: &str, at| (String::new(), path.to_owned(), at);
        assert_eq!(rows, [row("/mnt/a", looked_at), row("/mnt/b", None)]);
        store.note_folder("/mnt/a", None, true).await.expect("written");
        assert_eq!(told().await.len(), 1);
        store.forget_folders().await.expect("forgotten");
        assert_eq!(told().await, []);
    }
}
