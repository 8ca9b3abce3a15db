//! `armwatch report`.

use std::path::{Path, PathBuf};

use clap::Args;
use jiff::Timestamp;

use super::{browser, robot, run};
use crate::cli::context::{CliError, EXIT_DONE, Global, open_to_read, runtime};
use crate::cli::shared::result_file::{objection, write_lines};
use crate::language::Language;
use crate::report::page::Page;
use armwatch_config::Config;
use armwatch_store::{RunRow, Store};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch report R07 -o r07.html
  armwatch report 12 -o run12.html
  armwatch report R07 -o r07.pdf
  armwatch report R07 -o r07.pdf --browser /opt/chrome/chrome

The report is one page in one file without references to other files, ready to send, archive and print. Its first
sheet is a summary in words: the state of every joint, open alarms, the next checks, and the gaps in the data.

The report of a run has the recording, base parameters with standard errors, RMSD by cycle and stage, residuals,
and friction with its warm-up curves and over speed. The report of a robot has the friction index with its limits,
alarms and maintenance, RMSD over its tests, the latest parameters compared with those of its baseline, and other
arms of its model.

SUBJECT is the name of a robot, or the number of a run if no robot has that name; `armwatch robots` and `armwatch
runs` list them. The command reads only the database; `armwatch torque` reads the export and draws torques over
time. A PDF needs Chromium or Chrome on this computer.")]
pub(in crate::cli) struct ReportArgs {
    /// Name of a robot or number of a run
    #[arg(value_name = "SUBJECT")]
    subject: String,
    /// Write the page into this file, .html or .pdf
    #[arg(short, long, value_name = "FILE", value_parser = ReportFile::parse)]
    output: ReportFile,
    /// Chromium or Chrome program that prints a PDF [default: the first in PATH]
    #[arg(long, value_name = "FILE")]
    browser: Option<PathBuf>,
    /// Language of the page: en, it, de or zh [default: alerts.language]
    #[arg(long, value_name = "LANGUAGE", value_parser = language)]
    language: Option<Language>,
}

fn language(code: &str) -> Result<Language, String> {
    let found = Language::ALL.into_iter().find(|language| language.code() == code);
    found.ok_or_else(|| "write en, it, de or zh".into())
}

/// The file of a report, whose ending determines the format.
#[derive(Debug, Clone, PartialEq, Eq)]
struct ReportFile {
    path: PathBuf,
    as_pdf: bool,
}

impl ReportFile {
    /// Parses a file name that ends in `.html` or `.pdf`. Only an earlier result may exist there.
    fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let file = match ending.as_deref() {
            Some("html" | "htm") => Self { path, as_pdf: false },
            Some("pdf") => Self { path, as_pdf: true },
            _ => return Err("a report is written as .html or .pdf; end the name with one of them".into()),
        };
        objection(&file.path).map_or(Ok(file), Err)
    }
}

pub(in crate::cli) fn report(global: &Global, args: &ReportArgs) -> Result<u8, CliError> {
    let config = global.read_config()?;
    runtime()?.block_on(async {
        let store = open_to_read(&config).await?;
        let page = page(&store, &config, &args.subject, Timestamp::now()).await;
        store.close().await?;
        let language = args.language.unwrap_or(config.alerts.language);
        write(&page?.in_language(language).html(), &args.output, args.browser.as_deref()).await
    })?;
    Ok(EXIT_DONE)
}

async fn write(html: &str, file: &ReportFile, browser: Option<&Path>) -> Result<(), CliError> {
    match file.as_pdf {
        true => browser::print(html, &file.path, browser).await,
        false => write_lines(&file.path, html.lines().map(str::to_owned)),
    }
}

/// The page about `subject`.
async fn page(store: &Store, config: &Config, subject: &str, now: Timestamp) -> Result<Page, CliError> {
    let runs = store.runs().await?;
    if runs.iter().any(|run| run.robot == subject) {
        return robot::page(store, config, subject, &runs, now).await;
    }
    match subject.parse::<i64>() {
        Ok(run_id) => match runs.iter().find(|run| run.run_id == run_id) {
            Some(found) => run::page(store, config, found, &runs, now).await,
            None => Err(CliError::Usage(no_run(run_id, &runs))),
        },
        Err(_) => Err(CliError::Usage(no_robot(subject, &runs))),
    }
}

fn no_run(run_id: i64, runs: &[RunRow]) -> String {
    match runs.iter().map(|run| run.run_id).min_by_key(|known| known.abs_diff(run_id)) {
        Some(near) => {
            format!("there is no run {run_id}; the nearest is {near}, and `armwatch runs` lists all")
        }
        None => {
            format!("there is no run {run_id}: no run is stored yet; `armwatch ingest FILE` reads an export")
        }
    }
}

/// Most names that are proposed instead of an unknown one.
const PROPOSED: usize = 3;

fn no_robot(name: &str, runs: &[RunRow]) -> String {
    let mut known: Vec<&str> = runs.iter().map(|run| run.robot.as_str()).collect();
    known.dedup();
    if known.is_empty() {
        return format!(
            "there is no robot {name}: no run is stored yet; `armwatch ingest FILE` reads an export"
        );
    }
    let distance = |of: &&str| strsim::osa_distance(&of.to_lowercase(), &name.to_lowercase());
    known.sort_by_key(|of| (distance(of), (*of).to_owned()));
    known.truncate(PROPOSED);
    format!("there is no robot {name}; did you mean {}? `armwatch robots` lists all", known.join(" or "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::{RunKind, RunStatus};

    fn run(run_id: i64, robot: &str) -> RunRow {
        RunRow {
            run_id,
            robot: robot.into(),
            started_at: Timestamp::UNIX_EPOCH,
            source_name: String::new(),
            rows: None,
            cycles: 0,
            status: RunStatus::Complete,
            kind: RunKind::Test,
            reason: None,
            reason_line: None,
            reason_column: None,
        }
    }

    #[test]
    fn what_is_not_there_is_answered_with_what_is_near() {
        let runs = [run(1, "Left"), run(2, "Left"), run(7, "Right"), run(9, "Upper")];
        assert_eq!(no_run(8, &runs), "there is no run 8; the nearest is 7, and `armwatch runs` lists all");
        assert!(no_robot("lfet", &runs).starts_with("there is no robot lfet; did you mean Left or "));
        assert!(no_run(8, &[]).contains("no run is stored yet") && no_robot("a", &[]).contains("ingest"));
    }

    #[test]
    fn the_ending_says_what_is_written() {
        let parsed = |text| ReportFile::parse(text).map(|file| file.as_pdf);
        assert_eq!((parsed("a.html"), parsed("b.PDF")), (Ok(false), Ok(true)));
        assert!(parsed("a.svg").is_err() && parsed("pdf").is_err());
    }
}
