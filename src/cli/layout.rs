//! `armwatch layout infer`.

use std::path::PathBuf;

use clap::Args;

use super::{CliError, EXIT_DONE, EXIT_FOUND, Global, output};
use crate::ingest::infer::{self, Hints};
use crate::ingest::source;

/// Sample rates that may be given, Hz; those that a layout takes.
const SAMPLE_RATES: std::ops::RangeInclusive<f64> = 0.1..=1e6;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch layout infer R01_20260301_0800.csv > config/exports/cell4.toml
  armwatch layout infer log.csv.gz --robot R01 --name cell4
  armwatch layout infer motors.csv --robot TX40 --sample-rate-hz 5000

Reads the first rows of an export, of any encoding, delimiter and decimal mark, and writes a layout file to
standard output, each choice with its reason above it. What cannot be decided stays a comment that begins with
\"# ?\": answer it, name the file in armwatch.toml, and run `armwatch config check`. All keys of a layout are in
docs/layouts.md.

--robot is the name of a robot, as exports carry it: its description says how many joints there are and how far
they go. Exit status 1 if questions are left, or the file holds no table.")]
pub(super) struct InferArgs {
    /// Export, plain, .gz or .zst
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Robot of the export; its entry in the configuration gives the description
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
    /// Name of the layout [default: the file's]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Rows per second, for exports without time
    #[arg(long, value_name = "HZ")]
    sample_rate_hz: Option<f64>,
}

pub(super) fn infer(global: &Global, args: &InferArgs) -> Result<u8, CliError> {
    let description = match &args.robot {
        Some(robot) => {
            let config = global.read_config()?;
            let entry = config.robot_entry(robot).ok_or_else(|| {
                CliError::Usage(format!("no [[robot]] of the configuration is for a robot called {robot}"))
            })?;
            Some(entry.description.clone())
        }
        None => None,
    };
    if let Some(rate) = args.sample_rate_hz.filter(|rate| !SAMPLE_RATES.contains(rate)) {
        return Err(CliError::Usage(format!("--sample-rate-hz {rate} is not between 0.1 and 1000000 Hz")));
    }
    let name = args.name.clone().unwrap_or_else(|| stem(&args.file));
    let hints = Hints { robot: description.as_deref(), sample_rate: args.sample_rate_hz };
    let proposed = source::open(&args.file).and_then(|reader| infer::infer(reader, &args.file, &name, hints));
    let proposed = match proposed {
        Ok(proposed) => proposed,
        Err(rejection) => {
            output::complain(&rejection);
            return Ok(EXIT_FOUND);
        }
    };
    if global.json {
        output::json(&serde_json::json!({
            "layout": proposed.toml, "questions": proposed.questions, "rows": proposed.rows,
        }));
    } else {
        output::line(proposed.toml.trim_end());
    }
    if proposed.questions > 0 {
        let s = if proposed.questions == 1 { "" } else { "s" };
        output::note(&format!("armwatch: {} question{s} left, marked \"# ?\"", proposed.questions));
        return Ok(EXIT_FOUND);
    }
    Ok(EXIT_DONE)
}

/// The file's name without its endings.
fn stem(file: &std::path::Path) -> String {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.split('.').next().unwrap_or_default();
    if stem.is_empty() { "layout".to_owned() } else { stem.to_owned() }
}
