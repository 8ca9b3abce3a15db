//! The command line: arguments are parsed once, then passed to one function per command.

pub mod shared;
mod quarantine;
mod alerts;
mod identify;
mod friction;
mod robot;
mod layout;
mod config;
mod simulate;
mod trajectory;
mod calibrate;
mod completions;
pub mod context;
mod help;
mod man;
mod demo;
mod ingest;
mod maintenance;
mod one_run;
mod parameters;
mod payload;
mod report;
mod rmsd;
mod run;
mod lists;
mod sql;
mod snapshot;
mod prune;
mod conclude;
mod backup;
mod doctor;
mod export;
mod status;
mod explain;
mod torque;
mod verify;

use std::fmt::Display;
use std::panic::AssertUnwindSafe;
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use crate::cli::context::{CliError, EXIT_IO, Global};
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
  2    wrong command line or configuration; or the stored data do not contain
       the requested result
  70   internal error of the program
  74   database is missing, or database or file could not be read or written
  130  stopped by a signal; run again to continue

Times are in UTC, units are SI. Results go to standard output, progress and logs to standard error. Output to a
terminal has colours; NO_COLOR=1 in the environment turns them off. Each command has its own examples and
explanations in --help.";

/// Watch exports of robot arms for changes in friction and dynamics
#[derive(Debug, Parser)]
#[command(name = "armwatch", version, long_about = env!("CARGO_PKG_DESCRIPTION"), after_help = EXIT_CODES_HELP)]
pub struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// The command line of this process; ends the process if it is wrong or asks for help, and after the answer to a shell
    /// that completes a line.
    pub fn of_process() -> Self {
        completions::answer(Self::dressed_command);
        parsed()
    }

    /// All commands with their help as displayed.
    pub fn dressed_command() -> clap::Command {
        help::dressed(Self::command())
    }
}

/// The command line of this process as `C`, with help and errors as displayed; ends the process if it is wrong or asks
/// for help.
pub fn parsed<C: Parser>() -> C {
    let mut command = help::dressed(C::command());
    let matches = command
        .try_get_matches_from_mut(std::env::args_os())
        .unwrap_or_else(|error| help::with_what_is_meant(error, &command).exit());
    C::from_arg_matches(&matches).unwrap_or_else(|error| error.format(&mut command).exit())
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Show a small simulated fleet at work, with its dashboard
    Demo(demo::command::DemoArgs),
    /// Watch the configured folders until stopped
    Run(run::RunArgs),
    /// Read exports from files or folders once
    Ingest(ingest::IngestArgs),
    /// Show the fleet: joints, alarms, quarantine, live exports
    Status(status::StatusArgs),
    /// List robots with their tests and state
    Robots(lists::RobotsArgs),
    /// List runs, newest first
    Runs(lists::RunsArgs),
    /// List cycles, newest first
    Cycles(lists::CyclesArgs),
    /// Query the database in SQL, read only
    Sql(sql::SqlArgs),
    /// Write a copy of the database that any user can read
    Snapshot(snapshot::SnapshotArgs),
    /// Write a verified copy of the whole database
    Backup(backup::BackupArgs),
    /// Check the computer, the configuration and the database
    Doctor(doctor::DoctorArgs),
    /// Delete expired factors; results stay
    Prune(prune::PruneArgs),
    /// Write the public views as CSV or Parquet files
    Export(export::ExportArgs),
    /// List, explain, retry or dismiss exports that could not be read
    Quarantine(quarantine::command::QuarantineArgs),
    /// Evaluate a history again from a given time
    Conclude(conclude::ConcludeArgs),
    /// Correct or confirm the start of runs
    RunDate(one_run::RunDateArgs),
    /// Exclude runs from conclusions, or include them again
    SetAside(one_run::SetAsideArgs),
    /// Enter work on a robot and begin a new baseline
    Maintenance(maintenance::MaintenanceArgs),
    /// List, show and answer anomalies
    Alerts(alerts::command::AlertsArgs),
    /// Show how an export would be read; store nothing
    Explain(explain::ExplainArgs),
    /// Identify one parameter set from chosen cycles
    Identify(identify::args::IdentifyArgs),
    /// List, show or delete saved parameter sets
    Parameters(parameters::ParametersArgs),
    /// Estimate mass, centre of mass and inertia of a payload
    Payload(payload::PayloadArgs),
    /// Verify parameters against other runs
    Verify(verify::VerifyArgs),
    /// Show measured and estimated torque of one cycle
    Torque(torque::TorqueArgs),
    /// Show the RMSD of a run by cycle and stage
    Rmsd(rmsd::RmsdArgs),
    /// Show friction over time, speed and runs, or the friction index
    Friction(friction::command::FrictionArgs),
    /// Write a report on a run or a robot, on one page
    Report(report::command::ReportArgs),
    /// Write simulated exports with chosen faults and a truth file
    Simulate(Box<simulate::command::SimulateArgs>),
    /// Design, check, export and plot test motions for an arm
    Trajectory {
        #[command(subcommand)]
        command: TrajectoryCommand,
    },
    /// Check robot descriptions; write drive gains, URDF, MuJoCo, code
    Robot {
        #[command(subcommand)]
        command: RobotCommand,
    },
    /// Propose a layout for an unknown export
    Layout {
        #[command(subcommand)]
        command: LayoutCommand,
    },
    /// Show the smallest change in friction that causes an alarm
    Calibrate(calibrate::CalibrateArgs),
    /// Print shell completions, with robots, runs and alarms
    Completions(completions::CompletionsArgs),
    /// Write manual pages, one per command
    Man(man::ManArgs),
    /// Check, show or create the configuration
    Config {
        #[command(subcommand)]
        command: ConfigCommand,
    },
}

#[derive(Debug, Subcommand)]
enum RobotCommand {
    /// Check a description: kinematics, base parameters with groupings, rank, condition number
    Check(robot::check::RobotCheckArgs),
    /// Estimate drive gains from two recordings, without and with a known load
    DriveGains(robot::drive_gains::DriveGainsArgs),
    /// Write the identified bodies of all links as a URDF file
    Urdf(robot::urdf::RobotUrdfArgs),
    /// Write identified bodies, armature and friction as a MuJoCo file
    Mjcf(robot::mjcf::RobotMjcfArgs),
    /// Write the torque function of a model as C, Rust or Python source
    Code(robot::code::RobotCodeArgs),
}

#[derive(Debug, Subcommand)]
enum TrajectoryCommand {
    /// Design an excitation trajectory within the limits of an arm, and predict its precision
    Design(trajectory::design::DesignArgs),
    /// Check a programme or a CSV of positions against the limits of an arm
    Check(trajectory::check::CheckArgs),
    /// Write a programme as CSV: positions, velocities and accelerations, or waypoints
    Export(trajectory::export::TrajectoryExportArgs),
    /// Plot a programme with the limits of the arm
    Plot(trajectory::plot::PlotArgs),
    /// Write a cycle of the whole test as CSV, with the stage signals
    Test(trajectory::whole_test::WholeTestArgs),
}

#[derive(Debug, Subcommand)]
enum LayoutCommand {
    /// Propose a layout for an export, with its reasons
    Infer(layout::infer::InferArgs),
}

#[derive(Debug, Subcommand)]
enum ConfigCommand {
    /// List every problem of the configuration and its files, with file and line
    #[command(after_help = "\
Examples:
  armwatch config check
  armwatch config check --config /etc/armwatch/armwatch.toml")]
    Check,
    /// Show the settings in force and their sources
    #[command(after_help = "\
Examples:
  armwatch config show
  armwatch config show --config /etc/armwatch/armwatch.toml")]
    Show,
    /// Write the shipped configuration as files to edit
    Init(config::init::InitArgs),
}

/// Runs a command and returns the exit status of the process.
pub fn run(cli: Cli) -> ExitCode {
    // one-shot commands print their results; -v enables their logs
    let usual_verbosity = match cli.command {
        Command::Run(_) => 0,
        Command::Demo(_) => -2,
        _ => -1,
    };
    // the end of a daemon is an entry of its log
    let report = match cli.command {
        Command::Run(_) => log_errors,
        _ => print_errors,
    };
    execute(&cli.global, usual_verbosity, report, || carry_out(&cli.global, cli.command))
}

fn log_errors(errors: &[&dyn Display]) {
    errors.iter().for_each(|error| tracing::error!("{error}"));
}

/// Prints the errors of a command, one per line.
pub fn print_errors(errors: &[&dyn Display]) {
    if let Some((first, others)) = errors.split_first() {
        shared::output::print_error(first);
        others.iter().for_each(|error| shared::output::print_hint(&error.to_string()));
    }
}

/// Runs `command` with the logs that `global` requests, `usual_verbosity` without -v and -q, passes its errors to
/// `report`, and returns the exit status of the process.
pub fn execute(
    global: &Global,
    usual_verbosity: i8,
    report: fn(&[&dyn Display]),
    command: impl FnOnce() -> Result<u8, CliError>,
) -> ExitCode {
    let verbosity = i8::try_from(global.verbose).unwrap_or(2) - i8::try_from(global.quiet).unwrap_or(2);
    telemetry::start(global.log_format, verbosity.saturating_add(usual_verbosity));
    lanes::run_as_on_any_processor(std::env::var_os(context::ANY_PROCESSOR).is_some());
    let status = or_internal(command).unwrap_or_else(|error| {
        match &error {
            // one line for each, unlike the combined text
            CliError::Config(errors) => {
                report(&errors.0.iter().map(|problem| problem as &dyn Display).collect::<Vec<_>>());
            }
            error => report(&[error]),
        }
        error.exit_code()
    });
    ExitCode::from(match shared::output::failure() {
        Some(detail) => {
            let text = format!(
                "standard output cannot be written: {detail}; free space there, or redirect the \
                    output elsewhere"
            );
            shared::output::print_error(&text);
            EXIT_IO
        }
        None => status,
    })
}

/// Result of a command. A panic is a defect of the program: the hook has printed the place, and the exit status is that
/// of a defect.
fn or_internal(command: impl FnOnce() -> Result<u8, CliError>) -> Result<u8, CliError> {
    // no data of a command is used after its panic
    std::panic::catch_unwind(AssertUnwindSafe(command)).unwrap_or_else(|_| {
        Err(CliError::Internal("the program stopped at the place in the line above; please report it".into()))
    })
}

fn carry_out(global: &Global, command: Command) -> Result<u8, CliError> {
    match command {
        Command::Demo(args) => demo::command::demo(global, &args),
        Command::Run(args) => run::run(global, &args),
        Command::Ingest(args) => ingest::ingest(global, &args),
        Command::Status(args) => status::status(global, &args),
        Command::Robots(args) => lists::robots(global, &args),
        Command::Runs(args) => lists::runs(global, &args),
        Command::Cycles(args) => lists::cycles(global, &args),
        Command::Sql(args) => sql::sql(global, &args),
        Command::Snapshot(args) => snapshot::snapshot(global, &args),
        Command::Backup(args) => backup::backup(global, &args),
        Command::Doctor(args) => doctor::doctor(global, &args),
        Command::Prune(args) => prune::prune(global, &args),
        Command::Conclude(args) => conclude::conclude(global, &args),
        Command::Export(args) => export::export(global, &args),
        Command::Quarantine(args) => quarantine::command::quarantine(global, &args),
        Command::RunDate(args) => one_run::run_date(global, &args),
        Command::SetAside(args) => one_run::set_aside(global, &args),
        Command::Maintenance(args) => maintenance::maintenance(global, &args),
        Command::Alerts(args) => alerts::command::alerts(global, &args),
        Command::Explain(args) => explain::explain(global, &args),
        Command::Identify(args) => identify::command::identify(global, &args),
        Command::Parameters(args) => parameters::parameters(global, &args),
        Command::Payload(args) => payload::payload(global, &args),
        Command::Verify(args) => verify::verify(global, &args),
        Command::Torque(args) => torque::torque(global, &args),
        Command::Rmsd(args) => rmsd::rmsd(global, &args),
        Command::Friction(args) => friction::command::friction(global, &args),
        Command::Report(args) => report::command::report(global, &args),
        Command::Simulate(args) => simulate::command::simulate(global, &args),
        Command::Robot { command: RobotCommand::Check(args) } => robot::check::check(global, &args),
        Command::Robot { command: RobotCommand::DriveGains(args) } => {
            robot::drive_gains::drive_gains(global, &args)
        }
        Command::Robot { command: RobotCommand::Urdf(args) } => robot::urdf::urdf(global, &args),
        Command::Robot { command: RobotCommand::Mjcf(args) } => robot::mjcf::mjcf(global, &args),
        Command::Robot { command: RobotCommand::Code(args) } => robot::code::code(global, &args),
        Command::Trajectory { command: TrajectoryCommand::Design(args) } => {
            trajectory::design::design(global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Check(args) } => {
            trajectory::check::check(global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Export(args) } => {
            trajectory::export::export(global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Plot(args) } => {
            trajectory::plot::plot(global, &args)
        }
        Command::Trajectory { command: TrajectoryCommand::Test(args) } => {
            trajectory::whole_test::whole_test(global, &args)
        }
        Command::Layout { command: LayoutCommand::Infer(args) } => layout::infer::infer(global, &args),
        Command::Calibrate(args) => calibrate::calibrate(global, &args),
        Command::Config { command: ConfigCommand::Check } => config::check::check(global),
        Command::Config { command: ConfigCommand::Show } => config::show::show(global),
        Command::Config { command: ConfigCommand::Init(args) } => config::init::init(global, &args),
        Command::Completions(args) => completions::completions(&args),
        Command::Man(args) => man::man(global, &args, Cli::dressed_command()),
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
