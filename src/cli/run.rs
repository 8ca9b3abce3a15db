//! `armwatch run`: the daemon.

use std::sync::Arc;

use clap::Args;

use super::{CliError, EXIT_DONE, Global, open_store, runtime, shared};
use crate::daemon;
use crate::daemon::overdue::OverdueWatch;
use crate::pipeline::Pipeline;
use crate::serve::{self, ServeError};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch run
  armwatch run --config /etc/armwatch/armwatch.toml --log-format json

Watches the folders of the configuration, takes exports cycle by cycle while they are written and others
when they have settled, and keeps going until SIGTERM or SIGINT; then it finishes the cycles in hand and
stops. Killed at any moment, it continues after the last stored cycle. With [serve] in the configuration
it takes exports over HTTP too, see docs/upload.md:
  curl -T R00_20260105_0847.csv.gz -H \"Authorization: Bearer $TOKEN\" \\
       http://127.0.0.1:8650/v1/exports/")]
pub(super) struct RunArgs {}

pub(super) fn run(global: &Global, _args: &RunArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_store(&config).await?;
        let folders: Vec<String> = config.watch.folders.iter().map(|f| f.display().to_string()).collect();
        tracing::info!(database = %config.database.display(), folders = folders.join(", "), "watching");
        let config = shared(config);
        let pipeline = Pipeline::new(Arc::clone(&config), store.clone());
        // the server ends with the daemon, whatever ends that
        let serving = stop.child_token();
        let server = match &config.serve {
            Some(settings) => Some(
                serve::start(settings, Arc::clone(&config), store, serving.clone()).await.map_err(refused)?,
            ),
            None => None,
        };
        let overdue = OverdueWatch::start(pipeline.store().clone(), serving.clone());
        let watched =
            daemon::watch(&pipeline, &stop, &|| global.reread_config(), |event| overdue.note(&event)).await;
        serving.cancel();
        overdue.ended().await;
        if let Some(server) = server {
            server.ended().await;
        }
        watched?;
        pipeline.close().await?;
        tracing::info!("stopped");
        Ok(EXIT_DONE)
    })
}

fn refused(error: ServeError) -> CliError {
    if error.is_configuration() {
        CliError::Usage(error.to_string())
    } else {
        CliError::Io(error.to_string())
    }
}
