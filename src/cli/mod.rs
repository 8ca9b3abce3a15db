//! The command line: what was typed becomes what it means, once; then one function a command.

mod shared;
mod quarantine;
mod alerts;
mod identify;
mod friction;
mod robot;
mod layout;
mod config;
mod simulate;
mod trajectory;
mod benchmark;
mod evaluate;
mod calibrate;
mod completions;
mod context;
mod help;
mod man;
mod demo;
mod ingest;
mod maintenance;
mod parameters;
mod report;
mod rmsd;
mod run;
mod lists;
mod sql;
mod snapshot;
mod prune;
mod backup;
mod doctor;
mod export;
mod status;
mod explain;
mod torque;
mod verify;

use std::panic::AssertUnwindSafe;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

use crate::cli::context::{CliError, EXIT_IO, Global, LogFormat};
use crate::telemetry;
use armwatch_method::lanes;

const EXIT_CODES_HELP: &str = "\
Examples:
  armwatch demo
  armwatch ingest exports/ --db fleet.db
  armwatch status --db fleet.db
  armwatch alerts list --help

Exit status:
  0    done
  1    done, but an export was quarantined or a check found something
  2    wrong command line or configuration; or what the command asks for is not
       there, or cannot be had from what is stored
  70   a fault of the program itself
  74   database is missing, or database or file could not be read or written
  130  stopped by a signal; run again to continue

Times are UTC, units SI. Results go to standard output, progress and logs to standard error. Output is coloured on a
terminal; NO_COLOR=1 in the environment turns that off. Each command has examples and texts of its own in --help.";

/// Watch exports of robot arms for drift of friction and dynamics
#[derive(Debug, Parser)]
#[command(name = "armwatch", version, long_about = env!("CARGO_PKG_DESCRIPTION"), after_help = EXIT_CODES_HELP)]
pub struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// The command line of this process; ends it where that is wrong, or asks for help.
    #[must_use]
    pub fn of_process() -> Self {
        let mut command = Self::dressed_command();
        let matches = command
            .try_get_matches_from_mut(std::env::args_os())
            .unwrap_or_else(|error| help::with_what_is_meant(error, &command).exit());
        Self::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit())
    }

    /// All commands with their help as people see it.
    #[must_use]
    pub fn dressed_command() -> clap::Command {
        help::dressed(Self::command())
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show a small simulated fleet at work, with its dashboard
    Demo(demo::command::DemoArgs),
    /// Watch the configured folders until stopped
    Run(run::RunArgs),
    /// Take files or folders through the pipeline once
    Ingest(ingest::IngestArgs),
    /// The fleet at a glance: joints, alarms, quarantine, live exports
    Status(status::StatusArgs),
    /// Robots, with their tests and where they stand
    Robots(lists::RobotsArgs),
    /// Runs, the newest first
    Runs(lists::RunsArgs),
    /// Cycles, the newest first
    Cycles(lists::CyclesArgs),
    /// Ask the database in SQL, for reading only
    Sql(sql::SqlArgs),
    /// Write a copy of the database that any user can read
    Snapshot(snapshot::SnapshotArgs),
    /// Write a copy of everything that is stored, looked through
    Backup(backup::BackupArgs),
    /// Whether machine, configuration and database are fit
    Doctor(doctor::DoctorArgs),
    /// Take away factors that have had their time; results stay
    Prune(prune::PruneArgs),
    /// Write the public views as CSV or Parquet files
    Export(export::ExportArgs),
    /// Exports that were not understood: list, explain, retry, dismiss
    Quarantine(quarantine::command::QuarantineArgs),
    /// Enter work on a robot, which begins a new baseline
    Maintenance(maintenance::MaintenanceArgs),
    /// Anomalies: list and show them, say what is done about them
    Alerts(alerts::command::AlertsArgs),
    /// What would become of an export; nothing is stored
    Explain(explain::ExplainArgs),
    /// Identify one parameter set on chosen cycles
    Identify(identify::args::IdentifyArgs),
    /// List, show or delete what `identify --save` keeps
    Parameters(parameters::ParametersArgs),
    /// Verify parameters against other runs
    Verify(verify::VerifyArgs),
    /// Measured and estimated torque of one cycle
    Torque(torque::TorqueArgs),
    /// RMSD of a run by cycle and stage
    Rmsd(rmsd::RmsdArgs),
    /// Friction over time, speed and runs; the friction index
    Friction(friction::command::FrictionArgs),
    /// A run or a robot on one page, in words, figures and tables
    Report(report::command::ReportArgs),
    /// Write exports of an arm, with chosen faults and a truth file
    Simulate(Box<simulate::command::SimulateArgs>),
    /// Test motions for an arm: design, check, export, plot
    Trajectory {
        #[command(subcommand)]
        command: TrajectoryCommand,
    },
    /// Robot descriptions: check one, drive gains, URDF, code
    Robot {
        #[command(subcommand)]
        command: RobotCommand,
    },
    /// Layouts of exports: propose one for an unknown export
    Layout {
        #[command(subcommand)]
        command: LayoutCommand,
    },
    /// Measure coverage of intervals, speed and memory
    Benchmark {
        #[command(subcommand)]
        command: BenchmarkCommand,
    },
    /// Measure the detectors on simulated fleets
    Evaluate(evaluate::EvaluateArgs),
    /// From which change of friction on there is an alarm, and how soon
    Calibrate(calibrate::CalibrateArgs),
    /// Completions of commands and options for a shell
    Completions(completions::CompletionsArgs),
    /// Manual pages, one a command
    Man(man::ManArgs),
    /// The configuration: check it, show it, write one to edit
    Config {
        #[command(subcommand)]
        command: ConfigCommand,
    },
}

#[derive(Debug, Subcommand)]
enum RobotCommand {
    /// Kinematics, base parameters with their groupings, rank and condition number
    Check(robot::check::RobotCheckArgs),
    /// Drive gains from two recordings, without and with a known load
    DriveGains(robot::drive_gains::DriveGainsArgs),
    /// Identified bodies of all links as a URDF file, from what is stored of chosen cycles
    Urdf(robot::urdf::RobotUrdfArgs),
    /// Feed-forward code: the torque function of a model as C, Rust or Python source
    Code(robot::code::RobotCodeArgs),
}

#[derive(Debug, Subcommand)]
enum TrajectoryCommand {
    /// Search an excitation trajectory within the limits of an arm, and predict what it tells
    Design(trajectory::design::DesignArgs),
    /// Which limits a programme or a CSV of positions breaks, where and by how much
    Check(trajectory::check::CheckArgs),
    /// A programme as CSV of positions, velocities and accelerations, or as waypoints
    Export(trajectory::export::ExportArgs),
    /// A programme in a picture, with the limits
    Plot(trajectory::plot::PlotArgs),
    /// A cycle of the whole test as CSV: excitation, friction joint by joint, warming, with the stage signals
    Test(trajectory::whole_test::WholeTestArgs),
}

#[derive(Debug, Subcommand)]
enum LayoutCommand {
    /// Propose a layout for an export, with its reasons
    Infer(layout::infer::InferArgs),
}

#[derive(Debug, Subcommand)]
enum BenchmarkCommand {
    /// How often 95 % intervals of the parameters hold the truth
    Coverage(benchmark::coverage::CoverageArgs),
    /// Exports a minute of one daemon and of several on one database of a server
    Daemons(benchmark::daemons::DaemonsArgs),
    /// Time of questions about a long history
    History(benchmark::history::HistoryArgs),
    /// Time and memory of `ingest` beside a plain read of the same export
    Ingest(benchmark::throughput::IngestBenchmarkArgs),
    /// Memory, open files and latency of a daemon before robots that write without pause
    Soak(benchmark::soak::SoakArgs),
    /// Processor time of each stage of taking a cycle
    Stages(benchmark::stages::StagesArgs),
    /// Time of a start with many known files
    Start(benchmark::start::StartArgs),
    /// Read a file with polars alone and print its rows
    #[command(hide = true)]
    PlainRead(benchmark::throughput::PlainReadArgs),
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// Every problem of the configuration and the files it names, with file and line
    #[command(after_help = "\
Examples:
  armwatch config check
  armwatch config check --config /etc/armwatch/armwatch.toml")]
    Check,
    /// The settings in force, and where they come from
    #[command(after_help = "\
Examples:
  armwatch config show
  armwatch config show --config /etc/armwatch/armwatch.toml")]
    Show,
    /// Write the shipped configuration as files to edit
    Init(config::init::InitArgs),
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
    lanes::run_as_on_any_processor(std::env::var_os(benchmark::throughput::ANY_PROCESSOR).is_some());
    let done = or_internal(|| carry_out(cli));
    let status = done.unwrap_or_else(|error| {
        shared::output::print_error(&error);
        error.exit_code()
    });
    ExitCode::from(match shared::output::failure() {
        Some(detail) => {
            let text =
                format!("standard output cannot be written: {detail}; free space there, or print elsewhere");
            shared::output::print_error(&text);
            EXIT_IO
        }
        None => status,
    })
}

/// What a command ends with. A panic is a defect of the program: the hook has said where, and the exit status is that of one.
fn or_internal(command: impl FnOnce() -> Result<u8, CliError>) -> Result<u8, CliError> {
    // nothing of a command is looked at after its panic
    std::panic::catch_unwind(AssertUnwindSafe(command)).unwrap_or_else(|_| {
        Err(CliError::Internal("the program has stopped where the line above says; please report it".into()))
    })
}

fn carry_out(cli: Cli) -> Result<u8, CliError> {
    match cli.command {
        Command::Demo(args) => demo::command::demo(&cli.global, &args),
        Command::Run(args) => run::run(&cli.global, &args),
        Command::Ingest(args) => ingest::ingest(&cli.global, &args),
        Command::Status(args) => status::status(&cli.global, &args),
        Command::Robots(args) => lists::robots(&cli.global, &args),
        Command::Runs(args) => lists::runs(&cli.global, &args),
        Command::Cycles(args) => lists::cycles(&cli.global, &args),
        Command::Sql(args) => sql::sql(&cli.global, &args),
        Command::Snapshot(args) => snapshot::snapshot(&cli.global, &args),
        Command::Backup(args) => backup::backup(&cli.global, &args),
        Command::Doctor(args) => doctor::doctor(&cli.global, &args),
        Command::Prune(args) => prune::prune(&cli.global, &args),
        Command::Export(args) => export::export(&cli.global, &args),
        Command::Quarantine(args) => quarantine::command::quarantine(&cli.global, &args),
        Command::Maintenance(args) => maintenance::maintenance(&cli.global, &args),
        Command::Alerts(args) => alerts::command::alerts(&cli.global, &args),
        Command::Explain(args) => explain::explain(&cli.global, &args),
        Command::Identify(args) => identify::command::identify(&cli.global, &args),
        Command::Parameters(args) => parameters::parameters(&cli.global, &args),
        Command::Verify(args) => verify::verify(&cli.global, &args),
        Command::Torque(args) => torque::torque(&cli.global, &args),
        Command::Rmsd(args) => rmsd::rmsd(&cli.global, &args),
        Command::Friction(args) => friction::command::friction(&cli.global, &args),
        Command::Report(args) => report::command::report(&cli.global, &args),
        Command::Simulate(args) => simulate::command::simulate(&cli.global, &args),
        Command::Robot { command: RobotCommand::Check(args) } => robot::check::check(&cli.global, &args),
        Command::Robot { command: RobotCommand::DriveGains(args) } => {
            robot::drive_gains::drive_gains(&cli.global, &args)
        }
        Command::Robot { command: RobotCommand::Urdf(args) } => robot::urdf::urdf(&cli.global, &args),
        Command::Robot { command: RobotCommand::Code(args) } => robot::code::code(&cli.global, &args),
        Command::Trajectory { command: TrajectoryCommand::Design(args) } => {
            trajectory::design::design(&cli.global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Check(args) } => {
            trajectory::check::check(&cli.global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Export(args) } => {
            trajectory::export::export(&cli.global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Plot(args) } => {
            trajectory::plot::plot(&cli.global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Test(args) } => {
            trajectory::whole_test::whole_test(&cli.global, &args)
        }
        Command::Layout { command: LayoutCommand::Infer(args) } => layout::infer::infer(&cli.global, &args),
        Command::Benchmark { command: BenchmarkCommand::Coverage(args) } => {
            benchmark::coverage::coverage(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Daemons(args) } => {
            benchmark::daemons::daemons(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::History(args) } => {
            benchmark::history::history(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Ingest(args) } => {
            benchmark::throughput::throughput(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Soak(args) } => {
            benchmark::soak::soak(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Stages(args) } => {
            benchmark::stages::stages(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::Start(args) } => {
            benchmark::start::start(&cli.global, &args)
        }
        Command::Benchmark { command: BenchmarkCommand::PlainRead(args) } => {
            benchmark::throughput::plain_read(&args)
        }
        Command::Evaluate(args) => evaluate::evaluate(&cli.global, &args),
        Command::Calibrate(args) => calibrate::calibrate(&cli.global, &args),
        Command::Config { command: ConfigCommand::Check } => config::check::check(&cli.global),
        Command::Config { command: ConfigCommand::Show } => config::show::show(&cli.global),
        Command::Config { command: ConfigCommand::Init(args) } => config::init::init(&cli.global, &args),
        Command::Completions(args) => completions::completions(&args, &mut Cli::dressed_command()),
        Command::Man(args) => man::man(&cli.global, &args, Cli::dressed_command()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::context::EXIT_INTERNAL;

    #[test]
    fn a_panic_is_an_internal_error() {
        let error = or_internal(|| panic!("tried")).expect_err("a panic");
        assert_eq!(error.exit_code(), EXIT_INTERNAL);
        assert_eq!(or_internal(|| Ok(3)).expect("no panic"), 3);
    }
}
