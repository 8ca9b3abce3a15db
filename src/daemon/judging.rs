//! Tests that are evaluated while they are still being written, and which of them have a new cycle.

use std::collections::BTreeSet;

use tokio::task::JoinSet;

use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::conclude::open_conclusion::OpenConclusion;
use crate::pipeline::context::{Pipeline, PipelineError};

/// A test and the result of its evaluation.
type TestConclusion = (i64, Result<OpenConclusion, PipelineError>);

/// Tests that wait for evaluation, by the numbers of their runs. If several cycles arrive in the meantime, a test is
/// evaluated once with all of them.
#[derive(Debug, Default)]
pub struct OpenTests {
    due: BTreeSet<i64>,
    /// Those whose robot needs conclusions first.
    waiting: BTreeSet<i64>,
    judging: JoinSet<TestConclusion>,
}

impl OpenTests {
    /// Notes that a test has one more cycle.
    pub fn grew(&mut self, run_id: i64) {
        self.due.insert(run_id);
    }

    /// Notes that conclusions of a robot were drawn.
    pub fn concluded(&mut self) {
        self.due.append(&mut self.waiting);
    }

    /// Starts to evaluate a test, one at a time.
    pub fn begin(&mut self, pipeline: &Pipeline) {
        if !self.judging.is_empty() {
            return;
        }
        let Some(run_id) = self.due.pop_first() else { return };
        let pipeline = pipeline.clone();
        self.judging.spawn(async move { (run_id, pipeline.conclude_open_isolated(run_id).await) });
    }

    /// The next evaluated test, with its conclusions to report; `None` while none is being evaluated.
    ///
    /// # Errors
    /// [`PipelineError`] if the daemon cannot continue, for example with a full disk.
    pub async fn next(&mut self) -> Option<Result<Option<Concluded>, PipelineError>> {
        let judged = self.judging.join_next().await?;
        Some(judged.map_err(PipelineError::from).and_then(|judged| self.judged(judged)))
    }

    fn judged(&mut self, (run_id, result): TestConclusion) -> Result<Option<Concluded>, PipelineError> {
        match result {
            Ok(OpenConclusion::Drawn(concluded)) => Ok(Some(concluded)),
            Ok(OpenConclusion::Quiet) => Ok(None),
            Ok(OpenConclusion::Waits) => {
                self.waiting.insert(run_id);
                Ok(None)
            }
            Err(PipelineError::Store(error)) if !error.is_fatal() => {
                tracing::debug!(run_id, %error, "not evaluated now; evaluated with the next cycle");
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_store::StoreError;

    #[test]
    fn a_test_whose_robot_is_to_be_concluded_waits_for_that() {
        let mut tests = OpenTests::default();
        tests.grew(7);
        tests.grew(7);
        assert_eq!(tests.due.pop_first(), Some(7));
        assert!(matches!(tests.judged((7, Ok(OpenConclusion::Waits))), Ok(None)));
        assert!(tests.due.is_empty());
        tests.concluded();
        assert_eq!(tests.due, BTreeSet::from([7]));
        assert!(tests.waiting.is_empty());
    }

    #[test]
    fn a_busy_database_is_no_end_and_a_full_disk_is() {
        let mut tests = OpenTests::default();
        let path = || std::path::PathBuf::from("fleet.db");
        let full = StoreError::Full { path: path(), detail: "full".into() };
        assert!(tests.judged((7, Err(full.into()))).is_err());
        let busy = StoreError::Busy { path: path(), detail: "locked".into() };
        assert!(matches!(tests.judged((7, Err(busy.into()))), Ok(None)));
    }
}
