//! `armwatch export`: public views as CSV or Parquet files.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use clap::{ArgGroup, Args};
use indicatif::{HumanCount, ProgressBar, ProgressStyle};
use jiff::tz::TimeZone;
use jiff::{Timestamp, ToSpan};

use super::context::{CliError, EXIT_DONE, EXIT_STOPPED, Global, open_to_read, runtime};
use super::shared::moment::moment;
use super::shared::output;
use super::shared::views::view_names;
use crate::daemon;
use armwatch_store::export::{Destination, Export, ExportError, ExportProgress, SheetFormat, Written};
use armwatch_store::{PublicView, RowFilter, public_views};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch export --parquet fleet
  armwatch export --csv fleet --robot R01 --robot R02 --since 2026-01-01
  armwatch export friction_index fleet_health --parquet fleet
  armwatch export cycle_parameters -o parameters.parquet
  armwatch export --parquet history --by-month --since 2026-10-01

By default every public view is written to a file of its name, such as fleet/runs.parquet. Parquet files have
times as timestamps (UTC). The metadata of each field have its unit and meaning. CSV files have all digits; NULL
is empty. The view view_columns, and `armwatch sql --schema`, describe all columns.

All files show the database at one moment; the daemon may run. The command writes every file before it renames
any, so that an earlier export is replaced as a whole. It replaces a file that is no export of its view only with
--force.

--by-month turns views with rows of runs into folders: fleet/cycles/robot=R01/month=2026-11/cycles.parquet.
DuckDB, polars, Spark and others read them as one table. A file whose rows have not changed is not written again,
so that only new files need to be copied elsewhere.")]
#[command(group(ArgGroup::new("destination").args(["csv", "parquet", "output"]).required(true)))]
pub(super) struct ExportArgs {
    /// Views to write [default: all]
    #[arg(value_name = "VIEW", value_parser = view_names(), hide_possible_values = true)]
    views: Vec<String>,
    /// Write VIEW.csv into this folder; created if missing
    #[arg(help_heading = "Destination", long, value_name = "DIR")]
    csv: Option<PathBuf>,
    /// Write VIEW.parquet into this folder
    #[arg(help_heading = "Destination", long, value_name = "DIR")]
    parquet: Option<PathBuf>,
    /// Write one view to this file; its name ends with .csv or .parquet
    #[arg(help_heading = "Destination", short, long, value_name = "FILE", requires = "views")]
    output: Option<PathBuf>,
    /// Write only rows of this robot; may be repeated
    #[arg(help_heading = "Rows", long, value_name = "NAME")]
    robot: Vec<String>,
    /// Write only runs that began at this time or later, UTC: a date, a date with time, or RFC 3339 with an offset
    #[arg(help_heading = "Rows", long, value_name = "TIME", value_parser = moment)]
    since: Option<Timestamp>,
    /// Write only runs that began before this time
    #[arg(help_heading = "Rows", long, value_name = "TIME", value_parser = moment)]
    until: Option<Timestamp>,
    /// Split views with rows of runs by robot and by month of the run's start; --since and --until are extended to
    /// whole months
    #[arg(help_heading = "Destination", long, conflicts_with = "output")]
    by_month: bool,
    /// Replace files that `armwatch export` did not write
    #[arg(help_heading = "Destination", long)]
    force: bool,
}

pub(super) fn export(global: &Global, args: &ExportArgs) -> Result<u8, CliError> {
    let export = wanted(args)?;
    let config = global.read_config()?;
    let bar = progress_bar(export.destinations.len());
    let written = runtime()?.block_on(async {
        let stop = daemon::stop_on_signal().map_err(|error| CliError::Internal(error.to_string()))?;
        let store = open_to_read(&config).await?;
        let written = export.write(&store, &stop, |at| show(&bar, at)).await;
        store.close().await?;
        Ok::<_, CliError>(written)
    })?;
    bar.finish_and_clear();
    match written {
        Ok(files) => print(global, &files),
        Err(ExportError::Stopped) => {
            output::print_hint(&ExportError::Stopped.to_string());
            return Ok(EXIT_STOPPED);
        }
        Err(error) => return Err(as_cli_error(error)),
    }
    Ok(EXIT_DONE)
}

fn wanted(args: &ExportArgs) -> Result<Export, CliError> {
    if let (Some(since), Some(until)) = (args.since, args.until)
        && since >= until
    {
        return Err(CliError::Usage(format!("--until {until} is not after --since {since}")));
    }
    let is_asked = |name: &str| args.views.is_empty() || args.views.iter().any(|view| view == name);
    let views = public_views().iter().filter(|view| is_asked(&view.name));
    let (format, destinations) = match (&args.csv, &args.parquet, &args.output) {
        (Some(folder), _, _) => (SheetFormat::Csv, in_folder(views, folder, SheetFormat::Csv)),
        (_, Some(folder), _) => (SheetFormat::Parquet, in_folder(views, folder, SheetFormat::Parquet)),
        (_, _, Some(path)) => {
            let format = [SheetFormat::Csv, SheetFormat::Parquet]
                .into_iter()
                .find(|format| path.extension().is_some_and(|suffix| suffix == format.suffix()));
            let format = format.ok_or_else(|| {
                CliError::Usage(format!("the name of {} must end with .csv or .parquet", path.display()))
            })?;
            let destinations: Vec<_> = views.map(|view| Destination { view, path: path.clone() }).collect();
            if destinations.len() > 1 {
                return Err(CliError::Usage(
                    "--output accepts one view; use --csv or --parquet for a folder with several".into(),
                ));
            }
            (format, destinations)
        }
        (None, None, None) => {
            return Err(CliError::Usage(
                "give the destination: --csv DIR, --parquet DIR or --output FILE".into(),
            ));
        }
    };
    let (since, until) = match args.by_month {
        true => (args.since.and_then(start_of_month), args.until.and_then(end_of_month)),
        false => (args.since, args.until),
    };
    let filter = RowFilter { robots: args.robot.clone(), since, until };
    Ok(Export { destinations, format, filter, force: args.force, by_month: args.by_month })
}

/// The start of a month, UTC, from a time in it; `None` beyond the range of times.
fn start_of_month(time: Timestamp) -> Option<Timestamp> {
    let day = time.to_zoned(TimeZone::UTC).date().first_of_month();
    day.to_zoned(TimeZone::UTC).ok().map(|start| start.timestamp())
}

/// The start of the next month, or the time itself if a month begins with it.
fn end_of_month(time: Timestamp) -> Option<Timestamp> {
    let start = start_of_month(time)?;
    if start == time {
        return Some(start);
    }
    start.to_zoned(TimeZone::UTC).checked_add(1.month()).ok().map(|next| next.timestamp())
}

fn in_folder(
    views: impl Iterator<Item = &'static PublicView>,
    folder: &Path,
    format: SheetFormat,
) -> Vec<Destination> {
    views
        .map(|view| Destination { view, path: folder.join(format!("{}.{}", view.name, format.suffix())) })
        .collect()
}

fn print(global: &Global, files: &[Written]) {
    if global.json {
        files.iter().for_each(output::json);
        return;
    }
    let row = |of: &Written| {
        let mut row = vec![of.path.display().to_string(), of.rows.to_string(), of.bytes.to_string()];
        if files.iter().any(|of| of.parts.is_some()) {
            let parts =
                of.parts.map(|of| [of.written, of.unchanged, of.removed].map(|count| count.to_string()));
            row.extend(parts.unwrap_or_default());
        }
        row
    };
    let rows: Vec<Vec<String>> = files.iter().map(row).collect();
    let columns = ["file", "rows", "bytes", "files written", "as before", "removed"];
    output::block(&output::table(&columns[..rows.first().map_or(3, Vec::len)], &rows));
}

fn as_cli_error(error: ExportError) -> CliError {
    match error {
        ExportError::Store(error) => CliError::Store(error),
        error @ (ExportError::NoRobot { .. } | ExportError::Foreign { .. }) => {
            CliError::Usage(error.to_string())
        }
        error @ ExportError::Value { .. } => CliError::Internal(error.to_string()),
        error @ (ExportError::File { .. } | ExportError::Taken { .. } | ExportError::Stopped) => {
            CliError::Io(error.to_string())
        }
    }
}

fn progress_bar(views: usize) -> ProgressBar {
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(views as u64);
    if let Ok(style) = ProgressStyle::with_template("views [{bar:30}] {pos}/{len} {elapsed} {wide_msg}") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar
}

fn show(bar: &ProgressBar, at: ExportProgress<'_>) {
    bar.set_position(at.views_done as u64);
    bar.set_message(format!("{}: {} rows", at.view, HumanCount(at.rows)));
}
