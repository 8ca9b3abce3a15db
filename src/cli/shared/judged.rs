//! Conclusions after a person's entry: drawn at once, or by the daemon.

use crate::cli::context::{CliError, shared};
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::Pipeline;
use armwatch_config::Config;
use armwatch_store::Store;

/// Time of the conclusions with the change.
pub(in crate::cli) enum ConclusionTiming {
    /// They are drawn.
    Now,
    /// A daemon draws them within a minute.
    ByDaemon,
    /// They failed, for this reason.
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

/// Draws conclusions from the robot's history again, unless a daemon works on the database, which draws them.
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
