//! `armwatch-lab benchmark start`: time from the start of a daemon until it knows all files of its folders again.

use std::fs::File;
use std::path::Path;
use std::time::{Duration, Instant};

use clap::Args;
use jiff::Timestamp;
use serde_json::json;

use super::child_daemon::ChildDaemon;
use crate::context::LabOptions;
use armwatch::cli::context::{CliError, EXIT_DONE, runtime};
use armwatch::cli::shared::output;
use armwatch_ingest::bytes::fingerprint::changed_at;
use armwatch_store::{SYNTHETIC_FILE_BYTES, Store, SyntheticSize};

/// Time between two reads of the daemon's messages.
const LOOK: Duration = Duration::from_millis(5);
/// A start that takes longer has failed.
const LONGEST: Duration = Duration::from_secs(600);

#[derive(Debug, Args)]
#[command(after_help = "\
Makes a database with the runs of so many files, and the files; their content is nothing, for a known file is not
opened. Then starts `armwatch run` there, several times, and prints the time until the daemon says that it watches its
folders, and until it has looked through them and no file waits.

Examples:
  armwatch-lab benchmark start
  armwatch-lab benchmark start --files 100000 --robots 200 --rounds 3 --json")]
pub(crate) struct StartArgs {
    /// Files that are known
    #[arg(long, default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    files: u32,
    /// Robots that they are of
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1000))]
    robots: u32,
    /// Starts
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=20))]
    rounds: u32,
}

pub(crate) fn start(global: &LabOptions, args: &StartArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let folder = folder.path().canonicalize().map_err(|error| CliError::Io(error.to_string()))?;
    let size =
        SyntheticSize { robots: args.robots, runs: (args.files / args.robots).max(1), cycles: 1, logs: 0 };
    let files = size.robots * size.runs;
    output::print_hint(&format!("making {files} files"));
    let changed = make_files(&folder.join("inbox"), size).map_err(|error| CliError::Io(error.to_string()))?;
    runtime()?.block_on(async {
        let store = Store::open(&folder.join("armwatch.db")).await?;
        store.fill_synthetic(size, &folder.join("inbox")).await?;
        store.change_synthetic_files(&changed).await?;
        store.close().await
    })?;
    let mut rounds = Vec::new();
    for _ in 0..args.rounds {
        rounds.push(one_start(global, &folder)?);
        std::fs::remove_file(folder.join("notify")).map_err(|error| CliError::Io(error.to_string()))?;
    }
    if global.json {
        let rounds: Vec<_> = rounds
            .iter()
            .map(|(ready, known)| json!({"watches_s": ready.as_secs_f64(), "known_s": known.as_secs_f64()}))
            .collect();
        output::json(&json!({"files": files, "robots": size.robots, "rounds": rounds}));
        return Ok(EXIT_DONE);
    }
    let second = |time: &Duration| format!("{:.2}", time.as_secs_f64());
    let rows: Vec<Vec<String>> =
        rounds.iter().map(|(ready, known)| vec![second(ready), second(known)]).collect();
    output::line(&format!("{files} files of {} robots", size.robots));
    output::line(&output::table(&["watches_s", "all_known_s"], &rows));
    Ok(EXIT_DONE)
}

/// Creates empty files of the size in the database; returns the modification time of each by path, in microseconds
/// since 1970.
fn make_files(inbox: &Path, size: SyntheticSize) -> std::io::Result<Vec<(String, i64)>> {
    std::fs::create_dir_all(inbox)?;
    let make = |name| {
        let path = inbox.join(name);
        let file = File::create_new(&path)?;
        file.set_len(SYNTHETIC_FILE_BYTES)?;
        let changed = Timestamp::try_from(changed_at(&file.metadata()?)).map_err(std::io::Error::other)?;
        Ok((path.display().to_string(), changed.as_microsecond()))
    };
    size.file_names().map(make).collect()
}

/// Times from the start of a daemon until it watches, and until it knows all files.
fn one_start(global: &LabOptions, folder: &Path) -> Result<(Duration, Duration), CliError> {
    let began = Instant::now();
    let mut daemon = ChildDaemon::start(global, folder)?;
    let mut ready = None;
    while began.elapsed() < LONGEST {
        daemon.check()?;
        for said in daemon.said() {
            if said == "READY=1" {
                ready.get_or_insert(began.elapsed());
            }
            if let (Some(ready), Some(status)) = (ready, said.strip_prefix("STATUS=")) {
                let known = began.elapsed();
                daemon.stop()?;
                return match status.starts_with("0 exports being read, 0 wait") {
                    true => Ok((ready, known)),
                    false => Err(CliError::Internal(format!("files are not known: {status}"))),
                };
            }
        }
        std::thread::sleep(LOOK);
    }
    Err(CliError::Internal(format!("the daemon has said nothing for {} s", LONGEST.as_secs())))
}
