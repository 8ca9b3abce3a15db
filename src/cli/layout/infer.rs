//! `armwatch layout infer`.

use std::path::{Path, PathBuf};

use clap::Args;

use super::trial;
use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::result_file::{refuse_database, refuse_source};
use crate::cli::shared::{output, paths};
use armwatch_config::{ConfigSource, read_robot};
use armwatch_ingest::bytes::source;
use armwatch_ingest::infer;
use armwatch_ingest::infer::proposal::{Hints, Proposed};
use armwatch_method::model::dynamics::gravity_torque;
use armwatch_model::robot::Robot;

/// Valid sample rates, Hz; those that a layout accepts.
const SAMPLE_RATES: std::ops::RangeInclusive<f64> = 0.1..=1e6;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch layout infer R01_20260301_0800.csv -o config/exports/cell4.toml
  armwatch layout infer log.csv.gz --robot R01 --name cell4
  armwatch layout infer motors.csv --description config/robots/tx40.toml \\
      --sample-rate-hz 5000

The command reads the first rows of an export: CSV with any encoding, delimiter and decimal mark, Parquet or MCAP.
It writes a layout file to standard output or, completely or not at all, to --output. Each choice has its reason
above it. An open question is a comment that begins with \"# ?\": answer it, name the file in armwatch.toml, and
run `armwatch config check`. docs/layouts.md has all keys of a layout. For an export with the columns of several
arms, such as left and right, the command writes one layout per arm, with the arm at the end of its name:
cell4_left.toml.

Before it writes the layout, the command tries it: it reads the whole export with it and, if there is a
description, analyses it. The first lines, and \"trial\" of --json, have the number of rows, cycles and stages,
and the findings.

--robot is the name of a robot as in the exports. Its description, named by the configuration, has the number of
joints, their ranges and the torques of gravity. The layout of the robot need not exist yet; the command ignores
the rest of the configuration. --description names a description file directly. Neither is needed if the columns
have names. Exit status 1 if questions are open or the trial failed, 2 if the file does not exist or has no table.")]
pub(in crate::cli) struct InferArgs {
    /// Export: CSV (plain, .gz or .zst), Parquet or MCAP
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Robot of the export; its entry in the configuration names the description
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Description of the robot, a .toml file
    #[arg(long, value_name = "FILE", conflicts_with = "robot")]
    description: Option<PathBuf>,
    /// Layout file to write; an existing file is not changed
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Replace an existing layout file
    #[arg(long, requires = "output")]
    force: bool,
    /// Name of the layout [default: that of the file]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Rows per second, for exports without time
    #[arg(long, value_name = "HZ")]
    sample_rate_hz: Option<f64>,
}

pub(in crate::cli) fn infer(global: &Global, args: &InferArgs) -> Result<u8, CliError> {
    let description = description(global, args)?;
    if let Some(rate) = args.sample_rate_hz.filter(|rate| !SAMPLE_RATES.contains(rate)) {
        return Err(CliError::Usage(format!("--sample-rate-hz {rate} is not between 0.1 and 1000000 Hz")));
    }
    paths::metadata(&args.file)?;
    refuse_source(args.output.as_deref(), &args.file, "the export itself")?;
    let name = args.name.clone().unwrap_or_else(|| stem(args.output.as_ref().unwrap_or(&args.file)));
    let hints = Hints {
        robot: description.as_ref(),
        gravity_torques: Some(gravity_torques),
        sample_rate: args.sample_rate_hz,
    };
    let proposed =
        source::open(&args.file).and_then(|reader| infer::infer_each_arm(reader, &args.file, &name, hints));
    let proposed = proposed.map_err(|rejection| match rejection.is_passing {
        true => CliError::Io(rejection.to_string()),
        false => CliError::Usage(rejection.to_string()),
    })?;
    let output_of = |arm: &Option<String>| args.output.as_ref().map(|output| for_arm(output, arm.as_deref()));
    for output in proposed.iter().filter_map(|(arm, _)| output_of(arm)) {
        refuse_database(&output)?;
        if !args.force && output.exists() {
            let output = output.display();
            return Err(CliError::Usage(format!("{output} exists and is not changed; --force replaces it")));
        }
    }
    let mut code = EXIT_DONE;
    for (arm, proposed) in &proposed {
        if give(global, args, (arm, output_of(arm)), proposed, description.as_ref())? {
            code = EXIT_FOUND;
        }
    }
    if proposed.len() > 1 {
        output::print_hint(&format!(
            "armwatch: columns of {} arms: give each arm a [[robot]] entry with its layout, and a copy of \
            the export under its name",
            proposed.len()
        ));
    }
    Ok(code)
}

/// Tests a layout and writes it; returns true if questions are left or it failed.
fn give(
    global: &Global,
    args: &InferArgs,
    (arm, output): (&Option<String>, Option<PathBuf>),
    proposed: &Proposed,
    description: Option<&Robot>,
) -> Result<bool, CliError> {
    let trial = trial::run(&args.file, proposed, description)?;
    let layout = infer::comments(&trial.sentences) + "#\n" + &proposed.toml;
    if let Some(output) = &output {
        write_whole(output, &layout).map_err(|error| paths::not_written(output, &error))?;
    }
    if global.json {
        let mut value = serde_json::json!({
            "layout": layout, "questions": proposed.questions, "rows": proposed.rows,
            "shipped": proposed.shipped, "trial": trial.value,
        });
        if let Some(arm) = arm {
            value["arm"] = arm.as_str().into();
        }
        output::json(&value);
    } else if let Some(output) = &output {
        output::print_hint(&format!("wrote {}", output.display()));
    } else {
        output::block(layout.trim_end());
    }
    if proposed.questions > 0 {
        let questions = output::counted(proposed.questions, "question");
        output::print_hint(&format!("armwatch: {questions} left, marked \"# ?\""));
    }
    if let Some(fault) = &trial.fault {
        output::print_hint(&format!("armwatch: {fault}"));
    }
    Ok(proposed.questions > 0 || trial.fault.is_some())
}

/// The file of an arm's layout, if an export has several arms: `cell4_left.toml` for `cell4.toml`.
fn for_arm(output: &Path, arm: Option<&str>) -> PathBuf {
    let Some(arm) = arm else { return output.to_owned() };
    let ending = output.extension().map_or_else(String::new, |ending| format!(".{}", ending.display()));
    output.with_file_name(format!("{}_{arm}{ending}", stem(output)))
}

/// The arm of the export, from the named file, or from that of the robot's entry.
fn description(global: &Global, args: &InferArgs) -> Result<Option<Robot>, CliError> {
    match (&args.description, &args.robot) {
        (Some(file), _) => Ok(Some(read_robot(file)?)),
        (None, Some(robot)) => {
            let source = ConfigSource::locate(global.config.as_deref());
            let found = source.read_description(robot)?;
            found.map(Some).ok_or_else(|| {
                CliError::Usage(format!(
                    "no [[robot]] in {source} matches the robot {robot}; --description FILE names a \
                    description directly, and neither is needed if columns have names"
                ))
            })
        }
        (None, None) => Ok(None),
    }
}

/// Torques that hold an arm with nominal masses against gravity, Nm (N).
fn gravity_torques(robot: &Robot, q: &[f64]) -> Option<Vec<f64>> {
    let bodies: Option<Vec<_>> =
        robot.joints.iter().map(|joint| joint.nominal.as_ref().map(|nominal| nominal.inertial)).collect();
    let mut torques = vec![0.0; q.len()];
    gravity_torque(robot, &bodies?, q, &mut torques);
    Some(torques)
}

/// Writes a file completely or not at all: first next to it, then in its place.
fn write_whole(path: &Path, text: &str) -> std::io::Result<()> {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let beside = path.with_file_name(format!(".{name}.{}.tmp", std::process::id()));
    let written = std::fs::write(&beside, text.trim_end().to_owned() + "\n")
        .and_then(|()| std::fs::File::open(&beside)?.sync_all())
        .and_then(|()| std::fs::rename(&beside, path));
    if written.is_err() {
        // the failure is reported; the partial file is of no use
        let _ = std::fs::remove_file(&beside);
    }
    written
}

/// The file's name without its endings.
fn stem(file: &std::path::Path) -> String {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.split('.').next().unwrap_or_default();
    if stem.is_empty() { "layout".to_owned() } else { stem.to_owned() }
}
