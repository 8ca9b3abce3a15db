//! Identifies stored cycles of another estimator than the configured one again, before `ingest` processes its first
//! export.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};
use tokio_util::sync::CancellationToken;

use super::output;
use crate::cli::context::CliError;
use crate::pipeline::context::Pipeline;
use crate::pipeline::reweight::{Reweighted, Reweighting};

/// Identifies them again from their factors; returns `false` if a stop was requested before all were done.
pub(in crate::cli) async fn reweight(
    pipeline: &Pipeline,
    stop: &CancellationToken,
) -> Result<bool, CliError> {
    let bar = progress_bar();
    let mut progress = |at: Reweighting| {
        bar.set_length(at.total);
        bar.set_position(at.done);
    };
    let done = pipeline.reweight(stop, &mut progress).await;
    bar.finish_and_clear();
    let Reweighted { cycles, kept, interrupted } = done?;
    let estimator = pipeline.config().analysis.estimator.name();
    if cycles > 0 {
        output::print_hint(&format!(
            "{cycles} stored cycles identified again from their factors as {estimator}"
        ));
    }
    if kept > 0 {
        output::print_hint(&format!(
            "{kept} stored cycles keep another estimator than {estimator}: `SELECT run_id, cycle, estimator, \
             estimator_reason FROM cycles WHERE estimator_reason IS NOT NULL` says why"
        ));
    }
    if interrupted {
        output::print_hint(
            "stopped while stored cycles were identified again; the rest follows at the next start",
        );
    }
    Ok(!interrupted)
}

fn progress_bar() -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(0);
    if let Ok(style) =
        ProgressStyle::with_template("identified again [{bar:30}] {pos}/{len} {per_sec} eta {eta}")
    {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}
