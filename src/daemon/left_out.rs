//! Places of the watched folders that scans skip, such as links that lead out: listed in quarantine, so that people see
//! them who do not read the log.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use super::folders::FolderLooks;
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_ingest::find::watch::Skipped;
use armwatch_ingest::rejection::Rejection;

/// Most places that one scan stores. Others wait for the next scan, so that a folder full of links does not stop the
/// daemon.
const WRITTEN_AT_ONCE: usize = 50;

/// The stored places.
#[derive(Debug, Default)]
pub(super) struct LeftOutPlaces(HashSet<PathBuf>);

impl LeftOutPlaces {
    /// Stores the places that are skipped now, and deletes the others.
    pub(super) async fn note(
        &mut self,
        pipeline: &Pipeline,
        look: &FolderLooks<'_>,
    ) -> Result<(), PipelineError> {
        let now: BTreeMap<&Path, &Skipped> = look.skipped.iter().map(|of| (of.path(), *of)).collect();
        let gone: Vec<PathBuf> =
            self.0.iter().filter(|path| !now.contains_key(path.as_path())).cloned().collect();
        for path in gone {
            pipeline.unlist_skipped(&path).await?;
            self.0.remove(&path);
        }
        let new: Vec<&Skipped> =
            now.into_values().filter(|of| !self.0.contains(of.path())).take(WRITTEN_AT_ONCE).collect();
        for skipped in new {
            let rejection = Rejection::of_file(skipped.path(), skipped.problem(), skipped.remedy());
            pipeline.list_skipped(skipped.path(), rejection).await?;
            self.0.insert(skipped.path().to_owned());
        }
        Ok(())
    }
}
