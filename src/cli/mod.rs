//! The command line: what was typed becomes what it means, once; then one function a command.

mod config_check;
mod coverage;
mod demo;
mod drive_gains;
mod each_cycle;
mod export_format;
mod friction;
mod friction_index;
mod identify;
mod identify_output;
mod ingest;
mod layout;
mod load;
mod output;
mod parameters;
mod plot;
mod prior_choice;
mod quarantine;
mod quarantine_story;
mod rmsd;
mod reweight;
mod robot_check;
mod robot_urdf;
mod run;
mod selection;
mod simulate;
mod throughput;
mod stage_signal;
mod explain;
mod torque;
mod verify;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::config::{Config, ConfigErrors};
use crate::pipeline::PipelineError;
use crate::store::{Store, StoreError};
use crate::telemetry;

/// All done.
pub const EXIT_DONE: u8 = 0;
/// Done, but something was quarantined, or a check found a difference.
pub const EXIT_FOUND: u8 = 1;
/// The command line or the configuration is wrong.
pub const EXIT_USAGE: u8 = 2;
/// A fault of the program itself.
pub const EXIT_INTERNAL: u8 = 70;
/// The database or a file could not be read or written.
pub const EXIT_IO: u8 = 74;
/// Stopped by a signal before everything was done; what is stored stays.
pub const EXIT_STOPPED: u8 = 130;

const EXIT_CODES_HELP: &str = "\
Exit status:
  0    done
  1    done, but an export was quarantined or a check found a difference
  2    wrong command line or configuration
  70   a fault of the program itself
  74   database or file could not be read or written
  130  stopped by a signal; run again to continue

Times are UTC, units SI. Results go to standard output, progress and logs to standard error.";

/// Watches robot arms' test exports, identifies dynamics and friction per cycle, stores them in
/// SQLite and flags drift and oscillation.
#[derive(Debug, Parser)]
#[command(name = "armwatch", version, about, max_term_width = 100, after_help = EXIT_CODES_HELP)]
pub struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

/// Options of every command.
#[derive(Debug, Args)]
struct Global {
    /// Configuration file [default: $ARMWATCH_CONFIG, else config/armwatch.toml, else
    /// armwatch.toml, else the shipped settings]
    #[arg(long, global = true, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Database file, instead of the configuration's
    #[arg(long, global = true, value_name = "FILE")]
    db: Option<PathBuf>,
    /// How log lines look
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    log_format: LogFormat,
    /// More log lines; twice for all
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Fewer log lines; twice for errors only
    #[arg(short, long, global = true, action = clap::ArgAction::Count, conflicts_with = "verbose")]
    quiet: u8,
    /// Print results as JSON, one object a line
    #[arg(long, global = true)]
    json: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum LogFormat {
    /// Lines for people
    Text,
    /// One JSON object a line
    Json,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Simulate a small fleet, ingest it while it is being written, and print what is found
    Demo(demo::DemoArgs),
    /// Watch the configured folders until stopped
    Run(run::RunArgs),
    /// Take files or folders through the pipeline once
    Ingest(ingest::IngestArgs),
    /// Exports that were not understood: list and explain them, have them read again
    Quarantine(quarantine::QuarantineArgs),
    /// Say what would become of an export, without storing anything
    Explain(explain::ExplainArgs),
    /// Identify one parameter set on chosen cycles from what is stored of them
    Identify(identify::IdentifyArgs),
    /// List, show or delete what `identify --save` keeps
    Parameters(parameters::ParametersArgs),
    /// Verify parameters against other runs from what is stored of them
    Verify(verify::VerifyArgs),
    /// Measured and estimated torque of one cycle, as rows or as a picture
    Torque(torque::TorqueArgs),
    /// RMSD of a run by cycle: each stage, the whole cycle, start and end of warming
    Rmsd(rmsd::RmsdArgs),
    /// Friction of runs over time, with warm-up curves fitted to it
    Friction(friction::FrictionArgs),
    /// Write exports of a described arm, with chosen faults and a truth file
    Simulate(simulate::SimulateArgs),
    /// Look at a robot description
    Robot {
        #[command(subcommand)]
        command: RobotCommand,
    },
    /// Layouts of exports
    Layout {
        #[command(subcommand)]
        command: LayoutCommand,
    },
    /// Measure how good and how fast the program is, on simulated exports
    Benchmark {
        #[command(subcommand)]
        command: BenchmarkCommand,
    },
    /// Look at a configuration
    Config {
        #[command(subcommand)]
        command: ConfigCommand,
    },
}

#[derive(Debug, Subcommand)]
enum RobotCommand {
    /// Kinematics, base parameters with their groupings, rank and condition number
    Check(robot_check::RobotCheckArgs),
    /// Drive gains from two recordings, without and with a known load
    DriveGains(drive_gains::DriveGainsArgs),
    /// Identified bodies of all links as a URDF file, from what is stored of chosen cycles
    Urdf(robot_urdf::RobotUrdfArgs),
}

#[derive(Debug, Subcommand)]
enum LayoutCommand {
    /// Propose a layout for an export, with its reasons
    Infer(layout::InferArgs),
}

#[derive(Debug, Subcommand)]
enum BenchmarkCommand {
    /// How often 95 % intervals of the parameters hold the truth
    Coverage(coverage::CoverageArgs),
    /// Time and memory of `ingest` beside a plain read of the same export
    Ingest(throughput::IngestBenchmarkArgs),
    /// Read a file with polars alone and print its rows
    #[command(hide = true)]
    PlainRead(throughput::PlainReadArgs),
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Every problem of the configuration and the files it names, with file and line
    #[command(after_help = "\
Examples:
  armwatch config check
  armwatch config check --config /etc/armwatch/armwatch.toml")]
    Check,
}

/// Why a command ended early.
#[derive(Debug, thiserror::Error)]
enum CliError {
    /// The configuration is wrong.
    #[error("{0}")]
    Config(#[from] ConfigErrors),
    /// The command line asks for something that cannot be.
    #[error("{0}")]
    Usage(String),
    /// A file could not be read or written.
    #[error("{0}")]
    Io(String),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The pipeline cannot go on.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A fault of the program itself.
    #[error("internal error: {0}")]
    Internal(String),
}

impl CliError {
    fn exit_code(&self) -> u8 {
        match self {
            Self::Config(_) | Self::Usage(_) => EXIT_USAGE,
            Self::Io(_) | Self::Store(_) | Self::Pipeline(PipelineError::Store(_)) => EXIT_IO,
            Self::Pipeline(PipelineError::Task(_)) | Self::Internal(_) => EXIT_INTERNAL,
        }
    }
}

/// Runs a command and returns the exit status of the process.
#[must_use]
pub fn run(cli: Cli) -> ExitCode {
    let format = match cli.global.log_format {
        LogFormat::Text => telemetry::LogFormat::Text,
        LogFormat::Json => telemetry::LogFormat::Json,
    };
    let verbosity =
        i8::try_from(cli.global.verbose).unwrap_or(2) - i8::try_from(cli.global.quiet).unwrap_or(2);
    // one-shot commands print their results; their logs are asked for with -v
    let usual = match cli.command {
        Command::Run(_) => 0,
        Command::Demo(_) => -2,
        _ => -1,
    };
    telemetry::start(format, verbosity.saturating_add(usual));
    let done = match cli.command {
        Command::Demo(args) => demo::demo(&cli.global, &args),
        Command::Run(args) => run::run(&cli.global, &args),
        Command::Ingest(args) => ingest::ingest(&cli.global, &args),
        Command::Quarantine(args) => quarantine::quarantine(&cli.global, &args),
        Command::Explain(args) => explain::explain(&cli.global, &args),
        Command::Identify(args) => identify::identify(&cli.global, &args),
        Command::Parameters(args) => parameters::parameters(&cli.global, &args),
        Command::Verify(args) => verify::verify(&cli.global, &args),
        Command::Torque(args) => torque::torque(&cli.global, &args),
        Command::Rmsd(args) => rmsd::rmsd(&cli.global, &args),
        Command::Friction(args) => friction::friction(&cli.global, &args),
        Command::Simulate(args) => simulate::simulate(&cli.global, &args),
        Command::Robot { command: RobotCommand::Check(args) } => robot_check::check(&cli.global, &args),
        Command::Robot { command: RobotCommand::DriveGains(args) } => {
            drive_gains::drive_gains(&cli.global, &args)
        }
        Command::Robot { command: RobotCommand::Urdf(args) } => robot_urdf::urdf(&cli.global, &args),
        Command::Layout { command: LayoutCommand::Infer(args) } => layout::infer(&cli.global, &args),
        Command::Benchmark { command: BenchmarkCommand::Coverage(args) } => {
            coverage::coverage(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Ingest(args) } => {
            throughput::throughput(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::PlainRead(args) } => throughput::plain_read(&args),
        Command::Config { command: ConfigCommand::Check } => config_check::check(&cli.global),
    };
    ExitCode::from(done.unwrap_or_else(|error| {
        output::complain(&error);
        error.exit_code()
    }))
}

impl Global {
    /// The configuration, with the command line's database.
    fn read_config(&self) -> Result<Config, CliError> {
        let (mut config, _) = Config::find(self.config.as_deref())?;
        if let Some(db) = &self.db {
            config.database.clone_from(db);
        }
        Ok(config)
    }
}

/// The asynchronous runtime of a command.
fn runtime() -> Result<tokio::runtime::Runtime, CliError> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| CliError::Internal(format!("no runtime: {error}")))
}

async fn open_store(config: &Config) -> Result<Store, CliError> {
    Ok(Store::open(&config.database).await?)
}

fn shared(config: Config) -> Arc<Config> {
    Arc::new(config)
}
