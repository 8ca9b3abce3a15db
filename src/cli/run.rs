//! `armwatch run`: the daemon.

use clap::Args;

use super::{CliError, EXIT_DONE, Global, open_store, runtime, shared};
use crate::daemon;
use crate::pipeline::Pipeline;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch run
  armwatch run --config /etc/armwatch/armwatch.toml --log-format json

Watches the folders of the configuration, takes exports cycle by cycle while they are written and others
when they have settled, and keeps going until SIGTERM or SIGINT; then it finishes the cycles in hand and
stops. Killed at any moment, it continues after the last stored cycle.")]
pub(super) struct RunArgs {}

pub(super) fn run(global: &Global, _args: &RunArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let folders: Vec<String> = config.watch.folders.iter().map(|f| f.display().to_string()).collect();
        tracing::info!(database = %config.database.display(), folders = folders.join(", "), "watching");
        let pipeline = Pipeline::new(shared(config), store);
        let watched = daemon::watch(&pipeline, &stop, &|| global.reread_config(), |_, _| ()).await;
        watched?;
        pipeline.close().await?;
        tracing::info!("stopped");
        Ok(EXIT_DONE)
    })
}
