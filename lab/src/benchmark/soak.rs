//! `armwatch-lab benchmark soak`: memory, open files and latency of a daemon while robots write without pause.

use std::path::Path;
use std::time::{Duration, Instant};

use clap::Args;
use serde_json::{Value, json};

use super::child_daemon::ChildDaemon;
use super::soak_writers::{Pace, Writers, WrittenTest};
use crate::context::LabOptions;
use armwatch::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, runtime};
use armwatch::cli::shared::output;
use armwatch_method::statistics::descriptive::median;
use armwatch_method::statistics::slope::{MedianSlope, median_slope};
use armwatch_store::{Store, StoreError};

/// Time between two writes of the robots.
const TICK: Duration = Duration::from_millis(20);
/// Interval of database queries, which is the resolution of latencies.
const ASKED: Duration = TICK;
/// Time between two measurements of memory and open files.
const LOOK: Duration = Duration::from_secs(1);
/// Longest time for the last tests.
const LAST_TESTS: Duration = Duration::from_secs(60);
/// Initial share of the time that is excluded: threads, caches and memory pools fill in it.
const FIRST_SHARE: f64 = 0.25;
/// Parts of the time whose medians give the slope, so that correlated values count once.
const PARTS: usize = 24;
/// Growth over the whole time that counts as zero, as a share of the quantity's median.
const FLAT: f64 = 0.05;
/// Probability of the interval of a slope.
const LEVEL: f64 = 0.95;
/// Rows of the printed table.
const TABLE_ROWS: usize = 10;

#[derive(Debug, Args)]
#[command(after_help = "\
Starts `armwatch run` in a temporary folder with the shipped configuration and the settings of the allocator that the
unit of the service has (MALLOC_ARENA_MAX and two thresholds), where they are not set. Simulated robots write one test
after the other, each as it grows, so many times as fast as it was recorded; each test is a day later than the one
before. Printed are, over time, the daemon's memory and open files, and the time from the last row of a test until it
is stored, and until the robot is concluded from it. Robots begin one after the other, spread over the time of a test.
The first quarter of the time does not count. The verdict stands on the median of the slopes between all pairs of 24
parts of the rest, with its 95 % interval: `flat` where the interval says that the figure changes by less than 5 % over
the time, `grows` or `falls` where it excludes zero, else `undecided`. Exit status 1 unless all are flat or fall.

Examples:
  armwatch-lab benchmark soak --minutes 15
  armwatch-lab benchmark soak --robots 8 --speed 50 --minutes 60 --json")]
pub(crate) struct SoakArgs {
    /// Time, minutes
    #[arg(long, default_value_t = 10.0, value_parser = minutes)]
    minutes: f64,
    /// Robots that write at once
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=64))]
    robots: u32,
    /// Cycles of each test
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=24))]
    cycles: u32,
    /// Rows a second of recording, Hz, 10 to 5000
    #[arg(long, default_value_t = 50.0, value_name = "HZ", value_parser = rate)]
    rate_hz: f64,
    /// Recording time over time of writing, such as 100; above 0
    #[arg(long, default_value_t = 100.0, value_name = "FACTOR", value_parser = speed)]
    speed: f64,
}

fn rate(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|rate| (10.0..=5000.0).contains(rate)).ok_or("takes 10 to 5000 Hz".into())
}

fn speed(text: &str) -> Result<f64, String> {
    let parsed = text.parse().ok().filter(|speed: &f64| speed.is_finite() && *speed > 0.0);
    parsed.ok_or("takes a number above 0".into())
}

fn minutes(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|minutes| (0.1..=100_000.0).contains(minutes))
        .ok_or("takes 0.1 to 100000".into())
}

/// A quantity over time: minutes since the start, and value.
type SoakSeries = Vec<(f64, f64)>;

/// The measurements.
#[derive(Default)]
struct SoakObservations {
    memory_mb: SoakSeries,
    handles: SoakSeries,
    stored_s: SoakSeries,
    concluded_s: SoakSeries,
}

pub(crate) fn soak(global: &LabOptions, args: &SoakArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let pace = Pace { robots: args.robots, cycles: args.cycles, rate_hz: args.rate_hz, speed: args.speed };
    output::print_hint("simulating tests");
    let mut writers = Writers::new(folder.path(), folder.path().join("inbox"), pace)?;
    let seen = runtime()?.block_on(watched(global, folder.path(), &mut writers, args.minutes))?;
    let figures = [
        SoakFigure::new("memory, MB", "memory_mb", seen.memory_mb, args.minutes),
        SoakFigure::new("open files", "handles", seen.handles, args.minutes),
        SoakFigure::new("until stored, s", "stored_s", seen.stored_s, args.minutes),
        SoakFigure::new("until concluded, s", "concluded_s", seen.concluded_s, args.minutes),
    ];
    report(global, args, &writers, &figures);
    let is_well = figures.iter().all(|figure| matches!(figure.verdict, Steadiness::Flat | Steadiness::Falls));
    Ok(if is_well { EXIT_DONE } else { EXIT_FOUND })
}

/// Runs a daemon while robots write, and measures it.
async fn watched(
    global: &LabOptions,
    folder: &Path,
    writers: &mut Writers,
    minutes: f64,
) -> Result<SoakObservations, CliError> {
    // create the database before it is queried
    let database = folder.join("armwatch.db");
    Store::open(&database).await?.close().await?;
    let folder = folder.canonicalize().map_err(|error| CliError::Io(error.to_string()))?;
    let mut daemon = ChildDaemon::start(global, &folder)?;
    let store = Store::open_existing(&database).await?;
    let store = store.ok_or_else(|| CliError::Internal("the database is gone".into()))?;
    let (began, mut seen, mut waiting) = (Instant::now(), SoakObservations::default(), Backlog::default());
    let (mut next_look, mut next_asked) = (began, began);
    let length = Duration::from_secs_f64(60.0 * minutes);
    while began.elapsed() < length || (!waiting.is_empty() && began.elapsed() < length + LAST_TESTS) {
        daemon.check()?;
        if began.elapsed() < length {
            waiting.stored.extend(writers.write()?);
        }
        let now = began.elapsed().as_secs_f64() / 60.0;
        if next_look.elapsed() > LOOK && began.elapsed() < length {
            next_look = Instant::now();
            // acts as the service manager; a daemon waits if its messages are not read
            daemon.said();
            seen.memory_mb.extend(daemon.memory_mb().map(|memory| (now, memory)));
            seen.handles.extend(daemon.handles().map(|handles| (now, handles)));
        }
        if next_asked.elapsed() > ASKED && !waiting.is_empty() {
            next_asked = Instant::now();
            waiting.look(&store, &mut seen, now).await?;
        }
        tokio::time::sleep(TICK).await;
    }
    if !waiting.is_empty() {
        return Err(CliError::Internal(format!(
            "{} tests were not stored and concluded within {} s of their end",
            waiting.stored.len() + waiting.concluded.len(),
            LAST_TESTS.as_secs()
        )));
    }
    store.close().await?;
    daemon.stop()?;
    Ok(seen)
}

/// Tests that are written and not yet stored, and those that are stored without conclusions.
#[derive(Default)]
struct Backlog {
    stored: Vec<WrittenTest>,
    concluded: Vec<WrittenTest>,
}

impl Backlog {
    fn is_empty(&self) -> bool {
        self.stored.is_empty() && self.concluded.is_empty()
    }

    async fn look(&mut self, store: &Store, seen: &mut SoakObservations, now: f64) -> Result<(), StoreError> {
        let mut kept = Vec::new();
        for written in self.stored.drain(..) {
            if store.is_complete(&written.name).await? {
                seen.stored_s.push((now, written.at.elapsed().as_secs_f64()));
                self.concluded.push(written);
            } else {
                kept.push(written);
            }
        }
        self.stored = kept;
        let stale = store.stale_robots().await?;
        self.concluded.retain(|written| {
            let waits = stale.iter().any(|robot| written.name.starts_with(&format!("{}_", robot.name)));
            if !waits {
                seen.concluded_s.push((now, written.at.elapsed().as_secs_f64()));
            }
            waits
        });
        Ok(())
    }
}

/// Verdict on the constancy of a quantity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Steadiness {
    Flat,
    Grows,
    Falls,
    Undecided,
}

impl Steadiness {
    const fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::Grows => "grows",
            Self::Falls => "falls",
            Self::Undecided => "undecided",
        }
    }
}

/// A quantity over time with its slope per hour.
struct SoakFigure {
    title: &'static str,
    key: &'static str,
    series: SoakSeries,
    slope: Option<MedianSlope>,
    verdict: Steadiness,
}

impl SoakFigure {
    fn new(title: &'static str, key: &'static str, series: SoakSeries, minutes: f64) -> Self {
        let counted: SoakSeries =
            series.iter().copied().filter(|(at, _)| *at >= FIRST_SHARE * minutes).collect();
        let slope = median_slope(&parts(&counted, FIRST_SHARE * minutes, minutes), LEVEL);
        let typical = median(&values(&counted)).unwrap_or(0.0);
        let verdict = slope.map_or(Steadiness::Undecided, |slope| {
            let span = minutes * (1.0 - FIRST_SHARE);
            verdict(slope.interval.map(|end| end * span), FLAT * typical)
        });
        // the slope per minute is small: report it per hour
        let slope = slope.map(|slope| MedianSlope {
            value: 60.0 * slope.value,
            interval: slope.interval.map(|end| 60.0 * end),
        });
        Self { title, key, series, slope, verdict }
    }

    /// Median of the values between two times.
    fn between(&self, from: f64, to: f64) -> Option<f64> {
        let inside = self.series.iter().filter(|(at, _)| (from..to).contains(at)).map(|(_, value)| *value);
        median(&inside.collect::<Vec<f64>>())
    }
}

/// The verdict from the interval of a change; a change below `flat` counts as zero.
fn verdict([low, high]: [f64; 2], flat: f64) -> Steadiness {
    if low.abs() <= flat && high.abs() <= flat {
        Steadiness::Flat
    } else if low > 0.0 {
        Steadiness::Grows
    } else if high < 0.0 {
        Steadiness::Falls
    } else {
        Steadiness::Undecided
    }
}

fn values(series: &SoakSeries) -> Vec<f64> {
    series.iter().map(|(_, value)| *value).collect()
}

/// Middle and median of each part of the time that has values.
fn parts(series: &SoakSeries, from: f64, to: f64) -> SoakSeries {
    let width = (to - from) / PARTS as f64;
    let part = |place: usize| {
        let begins = from + place as f64 * width;
        let inside = series.iter().filter(|(at, _)| (begins..begins + width).contains(at));
        Some((begins + 0.5 * width, median(&inside.map(|(_, value)| *value).collect::<Vec<f64>>())?))
    };
    (0..PARTS).filter_map(part).collect()
}

fn report(global: &LabOptions, args: &SoakArgs, writers: &Writers, figures: &[SoakFigure]) {
    let speed = writers.recorded_s / (60.0 * args.minutes) / f64::from(args.robots);
    let tests = writers.tests();
    if global.json {
        let figures: serde_json::Map<String, Value> = figures
            .iter()
            .map(|figure| {
                let slope =
                    figure.slope.map(|slope| json!({"value": slope.value, "interval": slope.interval}));
                let said = json!({
                    "series": figure.series, "slope_per_hour": slope, "verdict": figure.verdict.name(),
                    "median": median(&values(&figure.series)), "p99": quantile(&figure.series, 0.99),
                });
                (figure.key.to_owned(), said)
            })
            .collect();
        return output::json(&json!({
            "minutes": args.minutes, "robots": args.robots, "cycles": args.cycles, "rate_hz": args.rate_hz,
            "speed": speed, "tests": tests, "figures": figures,
        }));
    }
    output::line(&format!(
        "{} robots, {tests} tests of {} cycles at {} Hz in {} minutes: {speed:.0} times as fast as recorded",
        args.robots, args.cycles, args.rate_hz, args.minutes
    ));
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.2}"));
    let width = args.minutes / TABLE_ROWS as f64;
    let rows: Vec<Vec<String>> = (0..TABLE_ROWS)
        .map(|row| {
            let (from, to) = (row as f64 * width, (row + 1) as f64 * width);
            let cells = figures.iter().map(|figure| number(figure.between(from, to)));
            std::iter::once(format!("{to:.1}")).chain(cells).collect()
        })
        .collect();
    let header: Vec<&str> =
        std::iter::once("minute").chain(figures.iter().map(|figure| figure.key)).collect();
    output::line(&output::table(&header, &rows));
    let rows: Vec<Vec<String>> = figures
        .iter()
        .map(|figure| {
            let slope = figure.slope.map_or_else(
                || "-".to_owned(),
                |slope| {
                    format!("{:+.3} ({:+.3} to {:+.3})", slope.value, slope.interval[0], slope.interval[1])
                },
            );
            vec![
                figure.title.to_owned(),
                number(median(&values(&figure.series))),
                number(quantile(&figure.series, 0.99)),
                slope,
                figure.verdict.name().to_owned(),
            ]
        })
        .collect();
    output::line(&output::table(&["", "median", "p99", "change an hour (95 %)", "verdict"], &rows));
}

/// The quantile of the values for this share.
fn quantile(series: &SoakSeries, share: f64) -> Option<f64> {
    let mut values = values(series);
    values.sort_unstable_by(f64::total_cmp);
    let place = (share * values.len() as f64).ceil() as usize;
    values.get(place.saturating_sub(1)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_is_flat_grows_falls_or_is_undecided() {
        assert_eq!(verdict([-1.0, 1.5], 2.0), Steadiness::Flat);
        assert_eq!(verdict([0.5, 1.5], 2.0), Steadiness::Flat);
        assert_eq!(verdict([0.5, 2.5], 2.0), Steadiness::Grows);
        assert_eq!(verdict([-2.5, -0.1], 2.0), Steadiness::Falls);
        assert_eq!(verdict([-2.5, 0.1], 2.0), Steadiness::Undecided);
    }

    #[test]
    fn the_first_quarter_does_not_count_and_growth_after_it_does() {
        let series = |rise: f64| -> SoakSeries {
            let value = |place: i32| {
                let at = f64::from(place) / 60.0;
                (at, if at < 2.0 { 20.0 * at } else { 40.0 + rise * at + f64::from(place % 3) })
            };
            (0..600).map(value).collect()
        };
        let still = SoakFigure::new("memory", "memory_mb", series(0.0), 10.0);
        assert_eq!(still.verdict, Steadiness::Flat, "{:?}", still.slope);
        let leak = SoakFigure::new("memory", "memory_mb", series(1.0), 10.0);
        assert_eq!(leak.verdict, Steadiness::Grows);
        let slope = leak.slope.expect("a slope");
        assert!((slope.value - 60.0).abs() < 6.0, "{slope:?}");
        assert_eq!(SoakFigure::new("memory", "memory_mb", Vec::new(), 10.0).verdict, Steadiness::Undecided);
    }

    #[test]
    fn quantiles_are_values_that_were_seen() {
        let series: SoakSeries = (1..=200).map(|value| (0.0, f64::from(value))).collect();
        assert_eq!(quantile(&series, 0.99), Some(198.0));
        assert_eq!(quantile(&Vec::new(), 0.99), None);
    }
}
