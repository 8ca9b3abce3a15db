//! `armwatch doctor`: checks that machine, configuration and database are fit for the daemon.

mod clock;
mod copies;
mod database;
mod disk;
mod finding;
mod folders;
mod limits;
mod machine;
mod permissions;
mod unit;

use clap::Args;
use finding::{CheckLevel, DoctorFinding};
use machine::Machine;
use serde_json::json;

use super::context::{CliError, EXIT_DONE, EXIT_FOUND, EXIT_USAGE, Global, runtime};
use super::shared::output;
use crate::daemon::preflight::{preflight, unanswered};
use armwatch_config::{Config, ConfigProblem};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch doctor --config /etc/armwatch/armwatch.toml
  armwatch doctor --quick --json

The command checks the configuration, its disks and folders, the clock, the limits of the system, the systemd unit
and the database. It changes nothing. It checks the permissions of the current user: run it as the user of the
service (sudo -u armwatch). It reads the whole database, which takes some seconds per gigabyte.

Exit status: 0 without a problem, even with warnings; 1 with a problem; 2 if the configuration cannot be used, and
then nothing else is checked. docs/operations.md lists the checks.")]
pub(super) struct DoctorArgs {
    /// Do not read the whole database
    #[arg(long)]
    quick: bool,
    /// Also show checks without a problem
    #[arg(long)]
    all: bool,
}

/// All checks, in the order of the report. Each returns a finding for everything that it checked.
const CHECKS: [fn(&Config, &Machine) -> Vec<DoctorFinding>; 7] = [
    disk::check,
    folders::check,
    permissions::check,
    limits::check,
    clock::check,
    unit::check,
    copies::check,
];

pub(super) fn doctor(global: &Global, args: &DoctorArgs) -> Result<u8, CliError> {
    let mut config = match global.read_config() {
        Ok(config) => config,
        Err(CliError::Config(errors)) => {
            let found =
                errors.0.iter().map(|problem| DoctorFinding::problem("configuration", problem, "correct it"));
            report(global, &found.collect::<Vec<_>>(), true);
            return Ok(EXIT_USAGE);
        }
        Err(error) => return Err(error),
    };
    let machine = Machine::here();
    // a check of these would hang
    let silent = unanswered(&config.watch);
    config.watch.folders.retain(|folder| !silent.contains(folder));
    let mut found = of_configuration(&config);
    found.extend(silent.iter().map(|folder| folders::silent(folder)));
    for check in CHECKS {
        found.extend(check(&config, &machine));
    }
    found.extend(runtime()?.block_on(database::check(&config, args.quick)));
    report(global, &found, args.all);
    let is_fit = found.iter().all(|finding| finding.level != CheckLevel::Problem);
    Ok(if is_fit { EXIT_DONE } else { EXIT_FOUND })
}

/// Findings about settings that `armwatch run` would refuse or warn of.
fn of_configuration(config: &Config) -> Vec<DoctorFinding> {
    let found = preflight(config);
    let refused =
        found.refusals.iter().map(|of| DoctorFinding::problem("configuration", said(of), remedy(of)));
    let odd = found.missing.iter().chain(&found.remarks);
    let odd = odd.map(|of| DoctorFinding::warning("configuration", said(of), remedy(of)));
    let mut findings: Vec<DoctorFinding> = refused.chain(odd).collect();
    if findings.is_empty() {
        findings.push(DoctorFinding::ok("configuration", "no problems"));
    }
    let zone = &config.recognition.time_zone;
    findings.push(DoctorFinding::ok("time zone", format!("times in file names are of {zone}")));
    findings
}

/// Key, value and sentence of a problem.
fn said(of: &ConfigProblem) -> String {
    let named = [Some(of.key.as_str()), of.value.as_deref(), Some(of.problem.as_str())];
    let words: Vec<&str> = named.into_iter().flatten().filter(|word| !word.is_empty()).collect();
    words.join(" ")
}

fn remedy(of: &ConfigProblem) -> &str {
    of.hint.as_deref().unwrap_or("correct the configuration")
}

fn report(global: &Global, found: &[DoctorFinding], all: bool) {
    if global.json {
        for DoctorFinding { check, level, said, remedy } in found {
            output::json(&json!({"check": check, "level": level.name(), "said": said, "remedy": remedy}));
        }
        return;
    }
    for finding in found.iter().filter(|finding| all || finding.level != CheckLevel::Ok) {
        output::line(&finding.line());
    }
    let count = |level: CheckLevel| found.iter().filter(|finding| finding.level == level).count();
    output::line(&format!(
        "{} checked: {} ok, {}, {}",
        found.len(),
        count(CheckLevel::Ok),
        output::counted(count(CheckLevel::Warning), "warning"),
        output::counted(count(CheckLevel::Problem), "problem")
    ));
}
