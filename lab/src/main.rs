//! Measures armwatch: how good its detectors are, and what its work costs. For developers; not shipped.

mod benchmark;
mod context;
mod detection_figure;
mod evaluate;
mod evaluation;
mod plain_read;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::context::LabOptions;
use armwatch::cli::context::CliError;
use armwatch::cli::{execute, parsed, print_errors};

/// Measure armwatch: detection on simulated fleets, speed and memory
#[derive(Debug, Parser)]
#[command(name = "armwatch-lab", version)]
struct LabCli {
    #[command(flatten)]
    global: LabOptions,
    #[command(subcommand)]
    command: LabCommand,
}

#[derive(Debug, Subcommand)]
enum LabCommand {
    /// Measure coverage of intervals, speed and memory
    Benchmark {
        #[command(subcommand)]
        command: Benchmark,
    },
    /// Measure the detectors on simulated fleets
    Evaluate(evaluation::EvaluateArgs),
}

#[derive(Debug, Subcommand)]
enum Benchmark {
    /// How often 95 % intervals of the parameters hold the truth
    Coverage(benchmark::coverage::CoverageArgs),
    /// Exports per minute of one daemon and of several on one database server
    Daemons(benchmark::daemons::DaemonsArgs),
    /// Time of queries on a long history
    History(benchmark::history::HistoryArgs),
    /// Time and memory of `ingest`, compared with a plain read of the same export
    Ingest(benchmark::throughput::IngestBenchmarkArgs),
    /// Memory, open files and latency of a daemon while robots write without pause
    Soak(benchmark::soak::SoakArgs),
    /// Processor time of each stage of a cycle
    Stages(benchmark::stages::StagesArgs),
    /// Time of a start with many known files
    Start(benchmark::start::StartArgs),
    /// Read a file with polars alone and print the number of its rows
    #[command(hide = true)]
    PlainRead(benchmark::throughput::PlainReadArgs),
}

fn main() -> ExitCode {
    let cli: LabCli = parsed();
    execute(&cli.global, -1, print_errors, || carry_out(&cli))
}

fn carry_out(cli: &LabCli) -> Result<u8, CliError> {
    let global = &cli.global;
    match &cli.command {
        LabCommand::Evaluate(args) => evaluation::evaluate(global, args),
        LabCommand::Benchmark { command } => match command {
            Benchmark::Coverage(args) => benchmark::coverage::coverage(global, args),
            Benchmark::Daemons(args) => benchmark::daemons::daemons(global, args),
            Benchmark::History(args) => benchmark::history::history(global, args),
            Benchmark::Ingest(args) => benchmark::throughput::throughput(global, args),
            Benchmark::Soak(args) => benchmark::soak::soak(global, args),
            Benchmark::Stages(args) => benchmark::stages::stages(global, args),
            Benchmark::Start(args) => benchmark::start::start(global, args),
            Benchmark::PlainRead(args) => benchmark::throughput::plain_read(args),
        },
    }
}
