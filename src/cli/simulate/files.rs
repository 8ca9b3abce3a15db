//! Checks names and times of a simulation's exports before it begins.

use std::path::{Path, PathBuf};

use jiff::Timestamp;
use jiff::tz::TimeZone;

use crate::cli::context::CliError;
use crate::cli::shared::output;
use armwatch_simulate::{SimulationSettings, file_stem};

/// Valid years in the name of an export: `ingest` accepts no others.
const YEARS: std::ops::RangeInclusive<i16> = 1980..=2199;

/// Checks the exports of all these robots, each of `joint_count` joints, before the first is written to `folder`.
/// Returns a sentence about existing ones that will be replaced.
///
/// # Errors
/// [`CliError::Usage`] for a start in an invalid year.
pub(super) fn replaced(
    joint_count: usize,
    robots: &[SimulationSettings],
    folder: &Path,
) -> Result<Option<String>, CliError> {
    let mut there: Vec<PathBuf> = Vec::new();
    for settings in robots {
        for run_index in 0..settings.runs {
            let file = export_of_run(joint_count, settings, run_index, folder)?;
            there.extend(Some(file).filter(|file| file.symlink_metadata().is_ok()));
        }
    }
    Ok(there.first().map(|first| {
        let more = match there.len() {
            1 => " is".into(),
            count => format!(" and {} are", output::counted(count - 1, "more export")),
        };
        format!("{}{more} there already and will be replaced", first.display())
    }))
}

/// Export of run `run_index`, counted from 0, with the simulator's file name.
fn export_of_run(
    joint_count: usize,
    settings: &SimulationSettings,
    run_index: u32,
    folder: &Path,
) -> Result<PathBuf, CliError> {
    let stem = file_stem(joint_count, settings, start_of_run(settings, run_index)?);
    let ending = if settings.gzip { "csv.gz" } else { "csv" };
    Ok(folder.join(format!("{stem}.{ending}")))
}

/// Start of run `run_index`, counted from 0.
fn start_of_run(settings: &SimulationSettings, run_index: u32) -> Result<Timestamp, CliError> {
    let SimulationSettings { first_start, interval, .. } = settings;
    let after = interval.checked_mul(run_index);
    let start = after.and_then(|after| first_start.checked_add(after).ok());
    let is_taken = |start: &Timestamp| YEARS.contains(&TimeZone::UTC.to_datetime(*start).year());
    start.filter(is_taken).ok_or_else(|| {
        let (from, to) = (*YEARS.start(), *YEARS.end());
        CliError::Usage(match run_index {
            0 => format!(
                "--start {first_start}: exports of the years {from} to {to} are accepted; choose a \
                start in these years"
            ),
            _ => format!(
                "run {} would not begin in the years {from} to {to}, which are accepted for exports; choose \
                an earlier --start, a shorter --interval-h or fewer --runs",
                u64::from(run_index) + 1
            ),
        })
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use armwatch_simulate::simulate_run;
    use armwatch_testing::er3a;

    fn settings() -> SimulationSettings {
        // without a friction stage: only names are checked, not rows
        let levels = Some(Vec::new());
        SimulationSettings { cycles: 1, warming_s: 0.0, levels, ..SimulationSettings::default() }
    }

    #[test]
    fn files_are_named_as_the_simulator_names_them() {
        let folder = tempfile::tempdir().expect("a folder");
        for gzip in [false, true] {
            let settings = SimulationSettings { gzip, runs: 2, ..settings() };
            let robots = [settings.clone()];
            assert_eq!(replaced(6, &robots, folder.path()).expect("nothing is there"), None);
            let made = simulate_run(&er3a(), &settings, 0, folder.path(), &mut |_| ()).expect("an export");
            assert_eq!(export_of_run(6, &settings, 0, folder.path()).expect("a name"), made.export);
            let told = replaced(6, &robots, folder.path()).expect("a start").expect("it is there");
            assert!(told.ends_with("is there already and will be replaced"), "{told}");
            simulate_run(&er3a(), &settings, 1, folder.path(), &mut |_| ()).expect("an export");
            let told = replaced(6, &robots, folder.path()).expect("a start").expect("they are there");
            assert!(told.contains("and 1 more export are there"), "{told}");
        }
        let elsewhere = tempfile::tempdir().expect("a folder");
        let other = SimulationSettings { robot_name: "R02".into(), ..settings() };
        assert_eq!(replaced(6, &[other], folder.path()).expect("another robot"), None);
        assert_eq!(replaced(6, &[settings()], elsewhere.path()).expect("another folder"), None);
    }

    #[test]
    fn starts_are_in_years_that_exports_have() {
        let check = |start: &str, runs: u32| {
            let first_start = start.parse().expect("a time");
            let interval = Duration::from_secs(24 * 60 * 60);
            let settings = SimulationSettings { first_start, interval, runs, ..settings() };
            replaced(6, &[settings], Path::new("none")).map_err(|error| error.to_string())
        };
        for start in ["1980-01-01T00:00:00Z", "2199-12-31T23:59:00Z"] {
            assert_eq!(check(start, 1), Ok(None));
        }
        for start in ["1979-12-31T23:59:00Z", "2200-01-01T00:00:00Z", "9000-01-01T00:00:00Z"] {
            let said = check(start, 1).expect_err(start);
            assert!(said.contains(&format!("--start {start}")) && said.contains("1980 to 2199"), "{said}");
        }
        let said = check("2199-12-31T23:59:00Z", 2).expect_err("the next year");
        assert!(said.contains("run 2 would not begin") && said.contains("1980 to 2199"), "{said}");
    }
}
