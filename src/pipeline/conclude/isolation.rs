//! If the conclusions of one robot fail, only that robot is affected: the reason is stored, and the other robots
//! continue.

use tokio::task::JoinError;

use super::history::Concluded;
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_store::{Attempt, AttemptKind, AttemptOn, ClaimKind, StoreError, wait_for_quiet};

/// The result of drawing conclusions.
#[derive(Debug, Clone, PartialEq)]
pub enum Conclusion {
    /// They are stored.
    Drawn(Concluded),
    /// The stored conclusions are as new as the history.
    UpToDate,
    /// They fail for this history; the robot's row gives the reason.
    Faulty(String),
    /// Another daemon draws them.
    Elsewhere,
}

impl Pipeline {
    /// Like [`Pipeline::conclude_named`], but values that the database refuses and panics are stored as a fault of this
    /// robot and logged once.
    ///
    /// # Errors
    /// Those of the store that affect every robot, such as a full disk, and a lock that stays.
    pub async fn conclude_isolated(&self, robot: &str) -> Result<Conclusion, PipelineError> {
        if !self.store.claim_work(ClaimKind::Robot, robot).await? {
            return Ok(Conclusion::Elsewhere);
        }
        let concluded = self.conclude_claimed(robot).await;
        self.store.release_work(&[(ClaimKind::Robot, robot)]).await;
        concluded
    }

    async fn conclude_claimed(&self, robot: &str) -> Result<Conclusion, PipelineError> {
        let reason = if self.begin_conclusion(robot).await?.is_spent() {
            SPENT.to_owned()
        } else {
            let (pipeline, name) = (self.clone(), robot.to_owned());
            let drawn = isolated(async move { pipeline.conclude_named(&name).await }).await?;
            self.store.end_attempt(AttemptKind::Conclusion, robot).await?;
            match drawn {
                Ok(Some(concluded)) => return Ok(Conclusion::Drawn(concluded)),
                Ok(None) => return Ok(Conclusion::UpToDate),
                Err(reason) => reason,
            }
        };
        if self.store().note_conclusion_fault(robot, &reason).await? {
            tracing::error!(
                robot,
                "no new conclusion for this robot: {reason}; its stored results stay, and other robots \
                continue; report it with the log (view conclusion_faults)"
            );
        } else {
            tracing::debug!(robot, reason, "still no new conclusion");
        }
        Ok(Conclusion::Faulty(reason))
    }
}

/// The reason for drawing no conclusions that have crashed the program.
const SPENT: &str = concat!(
    "drawing conclusions has ended the program three times; version ",
    env!("CARGO_PKG_VERSION"),
    " does not try it again before maintenance of the robot is entered"
);

impl Pipeline {
    /// Counts an attempt at conclusions before they are drawn. `subject` is the robot, or the test that is being
    /// written.
    pub(super) async fn begin_conclusion(&self, subject: &str) -> Result<Attempt, PipelineError> {
        let next =
            Attempt { number: self.store.failed_attempts(AttemptKind::Conclusion, subject).await? + 1 };
        if let Some(rest) = wait_for_quiet().filter(|_| next.is_last()) {
            tokio::time::sleep(rest).await;
        }
        Ok(self.store.begin_attempt_at(AttemptKind::Conclusion, subject, AttemptOn::default()).await?)
    }
}

/// Awaits a future in a separate task. The inner error is the reason if it fails because of its input: values that the
/// database refuses, and panics.
async fn isolated<T: Send + 'static>(
    future: impl Future<Output = Result<T, PipelineError>> + Send + 'static,
) -> Result<Result<T, String>, PipelineError> {
    match tokio::spawn(future).await {
        Ok(Ok(done)) => Ok(Ok(done)),
        Ok(Err(PipelineError::Store(StoreError::Refused { detail, .. }))) => {
            Ok(Err(format!("the database refuses the values ({detail})")))
        }
        Ok(Err(PipelineError::Task(error))) | Err(error) => panic_reason(error).map(Err),
        Ok(Err(error)) => Err(error),
    }
}

/// The message of a task that has panicked.
///
/// # Errors
/// The end of a task that has not panicked: the program is ending.
pub fn panic_reason(error: JoinError) -> Result<String, PipelineError> {
    let panic = error.try_into_panic().map_err(PipelineError::from)?;
    let said = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
    Ok(format!("internal error: {}", said.unwrap_or("a computation panicked")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn refused_values_and_panics_are_reasons_and_the_rest_are_errors() {
        let path = || std::path::PathBuf::from("fleet.db");
        let refused = StoreError::Refused { path: path(), detail: "NOT NULL".into() };
        let reason = isolated::<()>(async { Err(refused.into()) }).await.expect("a reason");
        assert_eq!(reason, Err("the database refuses the values (NOT NULL)".into()));
        let full = StoreError::Full { path: path(), detail: "full".into() };
        assert!(isolated::<()>(async { Err(full.into()) }).await.is_err());
        let outer = isolated::<()>(async { panic!("index 7 of {}", 3) }).await.expect("a reason");
        assert_eq!(outer, Err("internal error: index 7 of 3".into()));
        let inner = isolated::<()>(async { Ok(tokio::task::spawn_blocking(|| panic!("no inverse")).await?) });
        assert_eq!(inner.await.expect("a reason"), Err("internal error: no inverse".into()));
        assert_eq!(isolated(async { Ok(5) }).await.expect("done"), Ok(5));
    }
}
