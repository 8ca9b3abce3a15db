//! `armwatch run`: the daemon.

use std::mem::ManuallyDrop;
use std::sync::Arc;

use clap::{Args, Subcommand};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::context::{CliError, EXIT_DONE, Global, open_store_until, runtime, shared};
use super::one_run::{RunDateArgs, SetAsideArgs, run_date, set_aside};
use crate::alert::dispatcher::Dispatcher;
use crate::daemon::disks::Disks;
use crate::daemon::overdue::OverdueWatch;
use crate::daemon::preflight::{NO_ANSWER, create_folders, preflight};
use crate::daemon::retention::Pruning;
use crate::daemon::snapshots::Snapshots;
use crate::daemon::{Control, DaemonEvent};
use crate::metrics::{Disk, Metrics};
use crate::pipeline::context::Pipeline;
use crate::serve::ServeError;
use crate::{daemon, serve};
use armwatch_config::{Config, ConfigErrors, host_name, shown_database};
use armwatch_store::SessionKind;

#[derive(Debug, Clone, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "\
Examples:
  armwatch run
  armwatch run --config /etc/armwatch/armwatch.toml --log-format json
  armwatch run --db postgres://armwatch@db.plant/fleet --host line1

The daemon watches the folders of the configuration. It reads exports cycle by cycle while they are written, and
others after they have settled. It continues until SIGTERM or SIGINT, then finishes the current cycles and stops.
After a kill at any moment, the next start continues after the last stored cycle. SIGHUP reads the configuration
again; if it has problems, the daemon logs them and keeps the earlier one. [serve] in the configuration adds
uploads over HTTP, see docs/api.md:
  curl -T R00_20260105_0847.csv.gz -H \"Authorization: Bearer $TOKEN\" \\
       http://127.0.0.1:8650/v1/exports/

Several daemons, each with its own name, can share a database on a PostgreSQL server: see docs/operations.md."
)]
pub(super) struct RunArgs {
    /// Name of this daemon if several share a database on a server, instead of the configured name
    #[arg(long, value_name = "NAME", value_parser = host_name)]
    host: Option<String>,
    #[command(subcommand)]
    of_run: Option<OfRun>,
}

/// Commands about single runs, for those who look for them here.
#[derive(Debug, Clone, Subcommand)]
enum OfRun {
    /// Correct or confirm the start of runs, as `armwatch run-date`
    #[command(hide = true)]
    Date(RunDateArgs),
    /// Exclude runs from conclusions, as `armwatch set-aside`
    #[command(hide = true)]
    SetAside(SetAsideArgs),
}

pub(super) fn run(global: &Global, args: &RunArgs) -> Result<u8, CliError> {
    match &args.of_run {
        Some(OfRun::Date(args)) => return run_date(global, args),
        Some(OfRun::SetAside(args)) => return set_aside(global, args),
        None => {}
    }
    // SIGHUP reads the same file again: if it is missing then, the shipped settings must not replace it
    let global = &global.pinned();
    let config = checked(as_host(global.read_config()?, args))?;
    // Never shut down: the process must end regardless of its threads, even if a file system does not answer. A thread
    // whose timer is shut down would panic.
    let runtime = ManuallyDrop::new(runtime()?);
    runtime.block_on(until_stopped(global, args, config))
}

async fn until_stopped(global: &Global, args: &RunArgs, config: Config) -> Result<u8, CliError> {
    let internal = |error: std::io::Error| CliError::Internal(error.to_string());
    let stop = daemon::stop_on_signal().map_err(internal)?;
    let reload = daemon::reload_on_hangup(&stop).map_err(internal)?;
    let metrics = Metrics::counting();
    let disks = Disks::watch(&config, metrics.clone(), stop.clone());
    let work = DaemonParts { metrics, stop: stop.clone(), reload, disks: &disks };
    let ended = tokio::select! {
        ended = at_work(global, args, config, work) => ended,
        why = disks.abandoned(&stop) => Err(CliError::Io(why)),
    };
    // wakes threads that wait for a file to grow
    stop.cancel();
    ended
}

/// Parts of the daemon that exist before it opens its database.
struct DaemonParts<'d> {
    metrics: Metrics,
    stop: CancellationToken,
    reload: mpsc::Receiver<()>,
    disks: &'d Disks,
}

async fn at_work(
    global: &Global,
    args: &RunArgs,
    config: Config,
    work: DaemonParts<'_>,
) -> Result<u8, CliError> {
    let DaemonParts { metrics, stop, reload, disks } = work;
    let Some(store) = open_store_until(&stop, &config).await? else { return Ok(EXIT_DONE) };
    // before anything listens: a second daemon then gets an error about the first, not about its port
    let claim = store.claim().await?;
    let session = store.join(SessionKind::Daemon).await?;
    let folders: Vec<String> = config.watch.folders.iter().map(|f| f.display().to_string()).collect();
    tracing::info!(database = shown_database(&config.database), folders = folders.join(", "), "watching");
    let config = shared(config);
    let (in_force, configs) = watch::channel(Arc::clone(&config));
    let pipeline = Pipeline::new(Arc::clone(&config), store.clone()).counting(metrics.clone());
    // the server ends with the daemon in all cases
    let serving = stop.child_token();
    let pruning = Pruning::start(store.clone(), configs.clone(), serving.clone());
    let dispatcher = Dispatcher::start(store.clone(), configs.clone(), serving.clone());
    let server = match &config.serve {
        Some(settings) => {
            let started = serve::start(settings, configs, store, metrics.clone(), serving.clone());
            Some(started.await.map_err(refused)?)
        }
        None => None,
    };
    let reread = {
        let (global, args, config) = (global.clone(), args.clone(), Arc::clone(&config));
        move || {
            let config = keep_what_runs(reread(&global, &args)?, &config);
            in_force.send_replace(shared(config.clone()));
            Some(config)
        }
    };
    let overdue = OverdueWatch::start(pipeline.store().clone(), serving.clone());
    // the last copy contains the conclusions that are drawn after the stop
    let concluded = CancellationToken::new();
    let snapshots = config.snapshot.clone().map(|settings| {
        Snapshots::start(pipeline.store().clone(), settings, metrics.clone(), concluded.clone())
    });
    let control = Control { claim, stop, reload, reread: Arc::new(reread) };
    let watched = daemon::watch(&pipeline, control, |event| {
        overdue.note(&event);
        dispatcher.nudge();
        if let (Some(snapshots), DaemonEvent::Concluded(_)) = (&snapshots, &event) {
            snapshots.note();
        }
    });
    let watched = watched.await;
    serving.cancel();
    concluded.cancel();
    overdue.ended().await;
    pruning.ended().await;
    if let Some(snapshots) = snapshots {
        disks.unless_silent(Disk::Snapshot, snapshots.ended()).await;
    }
    dispatcher.ended().await;
    if let Some(server) = server {
        disks.unless_silent(Disk::Spool, server.ended()).await;
    }
    session.leave().await;
    watched?;
    pipeline.close().await?;
    tracing::info!("stopped");
    Ok(EXIT_DONE)
}

/// The configuration, if the daemon can work with it on this machine.
fn checked(config: Config) -> Result<Config, CliError> {
    let found = preflight(&config);
    if found.refusals.is_empty() {
        for folder in create_folders(&config) {
            tracing::info!(folder = %folder.display(), "created a watched folder");
        }
    }
    for remark in found.remarks.iter().chain(found.missing.iter().filter(|of| of.problem == NO_ANSWER)) {
        tracing::warn!("{remark}");
    }
    if found.refusals.is_empty() { Ok(config) } else { Err(ConfigErrors(found.refusals).into()) }
}

/// The configuration, with the command line's name of this daemon.
fn as_host(mut config: Config, args: &RunArgs) -> Config {
    if let Some(host) = &args.host {
        config.cluster.host = Some(host.clone());
    }
    config
}

/// The present configuration, for a running daemon; every problem of an invalid one is logged.
fn reread(global: &Global, args: &RunArgs) -> Option<Config> {
    match global.read_config().and_then(|config| checked(as_host(config, args))) {
        Ok(config) => Some(config),
        Err(CliError::Config(ConfigErrors(problems))) => {
            for problem in problems {
                tracing::error!("configuration not usable: {problem}");
            }
            tracing::error!("the earlier configuration stays in force");
            None
        }
        Err(error) => {
            tracing::error!(%error, "configuration not usable; the earlier one stays in force");
            None
        }
    }
}

/// A configuration that was read again, except for settings that take effect only at the next start.
fn keep_what_runs(mut config: Config, running: &Config) -> Config {
    if config.database != running.database {
        tracing::warn!("`database` has changed; this takes effect at the next start");
        config.database.clone_from(&running.database);
    }
    if config.cluster != running.cluster {
        tracing::warn!("[cluster] has changed; this takes effect at the next start");
        config.cluster.clone_from(&running.cluster);
    }
    if config.snapshot != running.snapshot {
        tracing::warn!("[snapshot] has changed; this takes effect at the next start");
        config.snapshot.clone_from(&running.snapshot);
    }
    if config.serve != running.serve {
        tracing::warn!("[serve] has changed; this takes effect at the next start");
        config.serve.clone_from(&running.serve);
    }
    let spool = running.serve.as_ref().and_then(|serve| serve.upload.as_ref()).map(|upload| &upload.spool);
    if let Some(spool) = spool.filter(|spool| !config.watch.folders.contains(spool)) {
        config.watch.folders.push(spool.clone());
    }
    config
}

fn refused(error: ServeError) -> CliError {
    if error.is_configuration() {
        CliError::Usage(error.to_string())
    } else {
        CliError::Io(error.to_string())
    }
}
