//! Completion in a shell: commands, options, and the names of robots, runs and alarms in the database. The script of
//! `armwatch completions` calls the program with the line as it is written, and [`answer`] prints the candidates.

use std::ffi::OsString;
use std::fmt::Display;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Arg, Args, Command};
use clap_complete::engine::{ArgValueCandidates, CompletionCandidate};
use clap_complete::env::Shells;
use clap_complete::{CompleteEnv, Shell};
use jiff::Timestamp;

use super::alerts::anomaly_texts;
use super::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use super::shared::{output, unknown_robot};
use armwatch_store::Store;

/// Environment variable by which the script asks for candidates.
const VARIABLE: &str = "ARMWATCH_COMPLETE";

/// Longest wait for the database while a person waits for the shell.
const PATIENCE: Duration = Duration::from_secs(2);

/// Most runs that are offered, the newest.
const MOST_RUNS: usize = 100;

/// Bash and fish load a file of this script with the first completion. Zsh runs it as the completion itself, which
/// must then be answered.
const ZSH_FIRST: &str = "[[ $funcstack[1] == _armwatch ]] && _clap_dynamic_completer_armwatch \"$@\" || true";

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch completions bash \\
      > ~/.local/share/bash-completion/completions/armwatch
  armwatch completions zsh > ~/.zfunc/_armwatch
  armwatch completions fish > ~/.config/fish/completions/armwatch.fish

The shell completes commands, options and files, and the robots, runs and alarms of the configured database or of
--config and --db on the line.")]
pub(super) struct CompletionsArgs {
    /// Name of the shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Prints the script of a shell.
pub(super) fn completions(args: &CompletionsArgs) -> Result<u8, CliError> {
    const NAME: &str = env!("CARGO_PKG_NAME");
    let shells = Shells::builtins();
    let unknown = || CliError::Usage(format!("{} has no completions", args.shell));
    let shell = shells.completer(&args.shell.to_string()).ok_or_else(unknown)?;
    let mut script = Vec::new();
    shell
        .write_registration(VARIABLE, NAME, NAME, NAME, &mut script)
        .map_err(|error| CliError::Internal(error.to_string()))?;
    let script = String::from_utf8_lossy(&script);
    let first = (args.shell == Shell::Zsh).then_some(ZSH_FIRST);
    output::lines(script.lines().chain(first).map(str::to_owned));
    Ok(EXIT_DONE)
}

/// Prints the candidates and ends the process if a shell asks for them.
pub(super) fn answer(command: impl Fn() -> Command) {
    CompleteEnv::with_factory(|| with_names(command())).var(VARIABLE).complete();
}

/// The values of an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Named {
    Robots,
    Runs,
    RunsAndRobots,
    Alarms,
}

impl Named {
    /// The values of `arg`, by its option or by the name of its value in the help.
    fn of(arg: &Arg) -> Option<Self> {
        let value = arg.get_value_names().and_then(|names| names.first()).map_or("", |name| name.as_str());
        match value.split([':', '[', '|']).next().unwrap_or_default() {
            "RUN" if value.ends_with("|ROBOT") => Some(Self::RunsAndRobots),
            "RUN" | "RUN_ID" => Some(Self::Runs),
            "ROBOT" => Some(Self::Robots),
            "NAME" if arg.get_long() == Some("robot") => Some(Self::Robots),
            "ID" => Some(Self::Alarms),
            _ => None,
        }
    }

    /// The values in the database of the line; none if it cannot be read in time.
    fn candidates(self) -> Vec<CompletionCandidate> {
        let read = async {
            let store = open_to_read(&global_of_line().read_config()?).await?;
            let found = self.in_store(&store).await;
            store.close().await?;
            found
        };
        let in_time =
            runtime().map(|runtime| runtime.block_on(async { tokio::time::timeout(PATIENCE, read).await }));
        in_time.ok().and_then(Result::ok).and_then(Result::ok).unwrap_or_default()
    }

    async fn in_store(self, store: &Store) -> Result<Vec<CompletionCandidate>, CliError> {
        let mut found = Vec::new();
        if matches!(self, Self::Robots | Self::RunsAndRobots) {
            found.extend(unknown_robot::robots(store).await?.into_iter().map(CompletionCandidate::new));
        }
        if matches!(self, Self::Runs | Self::RunsAndRobots) {
            let mut runs = store.runs().await?;
            runs.sort_by_key(|run| std::cmp::Reverse(run.run_id));
            found.extend(runs.iter().take(MOST_RUNS).map(|run| {
                candidate(
                    run.run_id,
                    format!("{} {} {}", run.robot, anomaly_texts::minute(run.started_at), run.status.name()),
                )
            }));
        }
        if self == Self::Alarms {
            let mut alarms = anomaly_texts::all(store, Timestamp::now()).await?;
            alarms.sort_by_key(|of| (of.state.is_closed(), std::cmp::Reverse(of.anomaly_id)));
            found.extend(alarms.iter().map(|of| {
                let place = of.joint.map(|joint| format!(" joint {joint}")).unwrap_or_default();
                let text = format!("{}{place} {} {}", of.robot, of.kind.name(), of.state.name());
                candidate(of.anomaly_id, text)
            }));
        }
        Ok(found)
    }
}

fn candidate(number: i64, help: impl Display) -> CompletionCandidate {
    CompletionCandidate::new(number.to_string()).help(Some(help.to_string().into()))
}

/// Lets all arguments with names in the database complete them.
fn with_names(command: Command) -> Command {
    let named = |arg: Arg| match Named::of(&arg) {
        Some(named) => arg.add(ArgValueCandidates::new(move || named.candidates())),
        None => arg,
    };
    command.mut_args(named).mut_subcommands(with_names)
}

/// The options of every command that name the database, from the line that a person is writing.
fn global_of_line() -> Global {
    let words: Vec<OsString> = std::env::args_os().skip_while(|word| word != "--").skip(1).collect();
    let value_of = |option: &str| {
        words.iter().enumerate().find_map(|(at, word)| {
            let word = word.to_str()?.strip_prefix(option)?;
            let value = word.strip_prefix('=').map(PathBuf::from);
            value.or_else(|| word.is_empty().then(|| words.get(at + 1).map(PathBuf::from)).flatten())
        })
    };
    Global { db: value_of("--db"), config: value_of("--config"), ..Global::default() }
}
