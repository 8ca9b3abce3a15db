//! What a person enters is judged at once, or by the daemon.

use crate::cli::context::{CliError, shared};
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::Pipeline;
use armwatch_config::Config;
use armwatch_store::Store;

/// Whether the history was judged with what has changed.
pub(in crate::cli) enum ConclusionTiming {
    /// It was.
    Now,
    /// A daemon does it within a minute.
    ByDaemon,
    /// It could not be, for this reason.
    Failed(String),
}

impl ConclusionTiming {
    pub(in crate::cli) fn is_now(&self) -> bool {
        matches!(self, Self::Now)
    }

    pub(in crate::cli) fn words(&self) -> String {
        match self {
            Self::Now => "; the history was evaluated with it".into(),
            Self::ByDaemon => "; the running daemon evaluates the history with it within a minute".into(),
            Self::Failed(reason) => format!("; the history could not be evaluated with it: {reason}"),
        }
    }
}

/// Judges the robot's history again, unless a daemon works on the database, which does it.
pub(in crate::cli) async fn judge(
    config: Config,
    store: &Store,
    robot: &str,
) -> Result<ConclusionTiming, CliError> {
    if store.has_daemon().await? {
        return Ok(ConclusionTiming::ByDaemon);
    }
    let pipeline = Pipeline::new(shared(config), store.clone());
    Ok(match pipeline.conclude_isolated(robot).await? {
        Conclusion::Drawn(_) | Conclusion::UpToDate => ConclusionTiming::Now,
        Conclusion::Elsewhere => ConclusionTiming::ByDaemon,
        Conclusion::Faulty(reason) => ConclusionTiming::Failed(reason),
    })
}
