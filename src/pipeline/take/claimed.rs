//! Exclusive reading of an export that several daemons see.

use std::path::Path;

use super::intake;
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_store::ClaimKind;

/// An export that no other daemon reads until it is released.
#[derive(Debug)]
#[must_use = "others may read it when it is released"]
pub(in crate::pipeline) struct ClaimedExport {
    /// Its path in the ledger; `None` for a file that only this daemon sees.
    shared: Option<String>,
}

impl ClaimedExport {
    /// Returns true if other daemons see it too.
    pub(in crate::pipeline) fn is_shared(&self) -> bool {
        self.shared.is_some()
    }
}

impl Pipeline {
    /// Claims the export at a path; `None` if another daemon reads it.
    pub(in crate::pipeline) async fn claim_export(
        &self,
        path: &Path,
    ) -> Result<Option<ClaimedExport>, PipelineError> {
        if !self.store.is_shared(path) {
            return Ok(Some(ClaimedExport { shared: None }));
        }
        let ledger_path = intake::ledger_path(&self.store, path);
        let is_ours = self.store.claim_work(ClaimKind::Export, &ledger_path).await?;
        Ok(is_ours.then_some(ClaimedExport { shared: Some(ledger_path) }))
    }

    pub(in crate::pipeline) async fn release_export(&self, claimed: ClaimedExport) {
        if let Some(ledger_path) = claimed.shared {
            self.store.release_work(&[(ClaimKind::Export, &ledger_path)]).await;
        }
    }
}
