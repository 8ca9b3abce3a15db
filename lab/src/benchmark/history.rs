//! `armwatch-lab benchmark history`: time of the queries of a conclusion, and of the shipped queries, on a long
//! history.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Args;
use jiff::{SignedDuration, Timestamp};
use serde_json::json;

use super::shipped_queries::shipped_queries;
use crate::context::LabOptions;
use armwatch::cli::context::{CliError, EXIT_DONE, runtime};
use armwatch::cli::shared::output;
use armwatch::pipeline::conclude::method::{INDEX_METHOD, METHOD};
use armwatch::pipeline::conclude::windows::{judge_logs, judge_tests};
use armwatch::pipeline::context::PipelineError;
use armwatch::pipeline::friction::planned;
use armwatch_method::detect::window::Lengths;
use armwatch_model::analysis::Estimator;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_store::{Store, SyntheticSize};

/// A query that took longer is not repeated.
const ASKED_AGAIN: Duration = Duration::from_secs(5);

/// Tests of a baseline in the shipped configuration.
const BASELINE_RUNS: usize = 5;

/// Conclusions after the first. Their median is printed, because in one of them SQLite moves the writes of the first
/// into its file.
const LATER: usize = 5;

/// Queries that are printed.
const SLOWEST: usize = 12;

/// Start of the first test of a synthetic history.
const FIRST_START: &str = "2020-01-01T00:00:00Z";

#[derive(Debug, Args)]
#[command(after_help = "\
Fills a new database in a temporary folder with a history that nobody recorded, six joints a robot, and prints how long
the questions take that conclusions of one robot ask, and its detectors, the first time and once all that they find is
stored (the median of five conclusions, and the slowest), and the shipped queries: those of examples/questions.sql, of dashboards/ with their defaults, and the panels for Grafana
over the last 90 days, each about one robot where it names one. A thousand tests of 24 cycles, 144,000 joint-cycles, take
130 MB and some seconds to make.

Examples:
  armwatch-lab benchmark history
  armwatch-lab benchmark history --runs 10000
  armwatch-lab benchmark history --robots 200 --runs 500 --keep /tmp/history.db
  armwatch-lab benchmark history --robots 200 --runs 175 --json")]
pub(crate) struct HistoryArgs {
    /// Robots
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    robots: u32,
    /// Tests of each robot
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    runs: u32,
    /// Cycles of each test
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=100))]
    cycles: u32,
    /// Logs of production behind each test, of a window each
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=144))]
    logs: u32,
    /// Make the database there and keep it; one that is there already is asked as it is
    #[arg(long, value_name = "FILE")]
    keep: Option<PathBuf>,
}

/// A query and its duration.
struct TimedQuestion {
    collection: &'static str,
    question: String,
    first: Duration,
    then: Duration,
}

pub(crate) fn history(global: &LabOptions, args: &HistoryArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let path = args.keep.clone().unwrap_or_else(|| folder.path().join("history.db"));
    let size = SyntheticSize { robots: args.robots, runs: args.runs, cycles: args.cycles, logs: args.logs };
    let (made, bytes, conclusion, queries) = runtime()?.block_on(async {
        let is_there = path.exists();
        let store = Store::open(&path).await?;
        let began = Instant::now();
        if !is_there {
            store.fill_synthetic(size, Path::new("/inbox")).await?;
        }
        let made = began.elapsed();
        let conclusion = of_conclusion(&store).await?;
        let queries = of_queries(&store, size).await?;
        let bytes = store.size().await.map_or(0, |size| size.database + size.log);
        store.close().await?;
        Ok::<_, CliError>((made, bytes, conclusion, queries))
    })?;
    report(global, size, made, bytes, &conclusion, queries);
    Ok(EXIT_DONE)
}

/// The shipped queries about the first robot.
async fn of_queries(store: &Store, size: SyntheticSize) -> Result<Vec<TimedQuestion>, CliError> {
    let robot = "S001";
    // one test per day
    let began = FIRST_START.parse::<Timestamp>().map_err(|error| CliError::Internal(error.to_string()))?;
    let until = began + SignedDuration::from_hours(24 * i64::from(size.runs));
    let mut asked = Vec::new();
    for query in shipped_queries(robot, until)? {
        let mut times = Vec::new();
        while times.is_empty() || (times.len() == 1 && times[0] < ASKED_AGAIN) {
            let began = Instant::now();
            let answered = store.ask(&query.statement).await;
            answered.map_err(|error| CliError::Internal(format!("{}: {error}", query.name)))?;
            times.push(began.elapsed());
        }
        let (first, then) = (times[0], times[times.len() - 1]);
        asked.push(TimedQuestion { collection: query.collection, question: query.name, first, then });
    }
    Ok(asked)
}

/// Queries of a conclusion, and its other work.
struct ConclusionCost {
    asked: Vec<TimedQuestion>,
    /// Detectors of tests, and of production.
    detectors: [TimedQuestion; 2],
    /// All questions of the slowest conclusion after the first.
    slowest: Duration,
    /// Production logs that were evaluated, the first time and afterwards.
    logs: [usize; 2],
    /// Tests whose cycles were evaluated again, the first time and afterwards.
    recomputed: [usize; 2],
    /// Tests that were passed to the detectors.
    judged: [usize; 2],
}

/// The queries of a conclusion of the first robot, in order, and its detectors.
async fn of_conclusion(store: &Store) -> Result<ConclusionCost, PipelineError> {
    let names = [
        "latest warm friction",
        "friction of the first and latest tests",
        "tests of baselines",
        "peers",
        "windows of production",
        "tests of the window",
        "logs, stored anomalies",
    ];
    let settings = DetectSettings::default();
    let mut turns = Vec::with_capacity(1 + LATER);
    for _ in 0..=LATER {
        let mut times = [Duration::ZERO; 7];
        let mut began = Instant::now();
        let mut lap = |place: usize| {
            times[place] += began.elapsed();
            began = Instant::now();
        };
        store.latest_warm_levels(1).await?;
        lap(0);
        let over_tests = store.friction_history(1, 1.0, METHOD).await?;
        lap(1);
        let friction = planned(store, 1, BASELINE_RUNS, false).await?;
        lap(2);
        let peers = store.peers(1, BASELINE_RUNS).await?;
        lap(3);
        store.production_windows(1, Estimator::Weighted).await?;
        lap(4);
        let mut figures = store.conclude(1).await?;
        let history = figures.history().await?;
        figures.keep_friction_points(&over_tests, METHOD).await?;
        if let Some(plan) = &friction.known {
            figures.keep_friction_plan(plan, BASELINE_RUNS, INDEX_METHOD).await?;
        }
        figures.summarise_settled_logs().await?;
        figures.commit_figures().await?;
        let found = judge_tests(store, 1, None, &peers, &settings, &Lengths::OF_TESTS).await?;
        lap(5);
        let logs = judge_logs(store, 1, &settings, &Lengths::OF_LOGS).await?;
        let mut findings = found.findings;
        findings.anomalies.extend(logs.findings.anomalies);
        let mut conclusion = store.conclude(1).await?;
        conclusion.reconcile(&findings, &[found.settled, logs.settled].concat()).await?;
        conclusion.commit(history).await?;
        lap(6);
        times[5] = times[5].saturating_sub(found.computing);
        times[6] = times[6].saturating_sub(logs.computing);
        turns.push(TimedConclusion {
            times,
            detectors: [found.computing, logs.computing],
            logs: logs.runs,
            recomputed: found.recomputed,
            judged: found.runs,
        });
    }
    let first = turns.remove(0);
    turns.sort_by_key(TimedConclusion::asking);
    let slowest = turns[turns.len() - 1].asking();
    let then = turns.swap_remove(turns.len() / 2);
    let asked = names.into_iter().zip(first.times.into_iter().zip(then.times));
    let row = |(name, (first, then)): (&str, (Duration, Duration))| TimedQuestion {
        collection: "conclusion",
        question: name.into(),
        first,
        then,
    };
    let detectors = [("detectors of tests", 0), ("detectors of production", 1)]
        .map(|(name, of)| row((name, (first.detectors[of], then.detectors[of]))));
    Ok(ConclusionCost {
        asked: asked.map(row).collect(),
        detectors,
        slowest,
        logs: [first.logs, then.logs],
        recomputed: [first.recomputed, then.recomputed],
        judged: [first.judged, then.judged],
    })
}

/// One conclusion: times of its queries and of its detectors (of tests and of production), and the amount of their
/// data.
struct TimedConclusion {
    times: [Duration; 7],
    detectors: [Duration; 2],
    logs: usize,
    recomputed: usize,
    judged: usize,
}

impl TimedConclusion {
    /// Time of all queries.
    fn asking(&self) -> Duration {
        self.times.iter().sum()
    }
}

fn report(
    global: &LabOptions,
    size: SyntheticSize,
    made: Duration,
    bytes: u64,
    conclusion: &ConclusionCost,
    mut queries: Vec<TimedQuestion>,
) {
    let ms = |time: Duration| (time.as_secs_f64() * 1e5).round() / 100.0;
    let ConclusionCost { asked: conclusion, detectors, slowest, logs: judged_logs, recomputed, judged } =
        conclusion;
    let together = |of: fn(&TimedQuestion) -> Duration| ms(conclusion.iter().map(of).sum());
    let (first, then) = (together(|asked| asked.first), together(|asked| asked.then));
    queries.sort_by_key(|asked| asked.then);
    // the time that 95 of 100 do not exceed
    let p95 = |of: &[&TimedQuestion]| {
        of.get((of.len() * 95).div_ceil(100).saturating_sub(1)).map(|asked| ms(asked.then))
    };
    let all: Vec<&TimedQuestion> = queries.iter().collect();
    let SyntheticSize { robots, runs, cycles, logs } = size;
    let joint_cycles = 6 * u64::from(robots) * u64::from(runs) * u64::from(cycles);
    if global.json {
        let rows = |asked: &[TimedQuestion]| -> Vec<_> {
            let row = |of: &TimedQuestion| json!({"collection": of.collection, "question": of.question, "first_ms": ms(of.first), "then_ms": ms(of.then)});
            asked.iter().map(row).collect()
        };
        return output::json(&json!({
            "robots": robots, "runs": runs, "cycles": cycles, "logs": logs, "joint_cycles": joint_cycles, "bytes": bytes,
            "made_s": made.as_secs_f64(), "conclusion": rows(conclusion), "conclusion_first_ms": first,
            "conclusion_then_ms": then, "conclusion_slowest_ms": ms(*slowest), "detectors": rows(detectors), "tests_judged_again": recomputed, "tests_judged": judged, "logs_judged": judged_logs,
            "queries": rows(&queries), "queries_p95_ms": p95(&all),
        }));
    }
    output::line(&format!(
        "{robots} robots, {runs} tests of each with {cycles} cycles, {joint_cycles} joint-cycles, {logs} logs behind each test: {:.0} MB, \
         made in {:.0} s",
        bytes as f64 / 1e6,
        made.as_secs_f64()
    ));
    let row = |of: &TimedQuestion| {
        vec![of.question.clone(), format!("{:.1}", ms(of.first)), format!("{:.1}", ms(of.then))]
    };
    let mut rows: Vec<Vec<String>> = conclusion.iter().map(row).collect();
    rows.push(vec!["together".into(), format!("{first:.1}"), format!("{then:.1}")]);
    rows.extend(detectors.iter().map(row));
    output::line(&output::table(&["conclusion of one robot", "first_ms", "then_ms"], &rows));
    output::line(&format!(
        "the slowest of {LATER} conclusions after the first took {:.1} ms; cycles of {} tests were judged again the first time, then of {}; \
         {} tests and {} logs were judged, then {} and {}",
        ms(*slowest),
        recomputed[0],
        recomputed[1],
        judged[0],
        judged_logs[0],
        judged[1],
        judged_logs[1]
    ));
    let rows: Vec<Vec<String>> = queries.iter().rev().take(SLOWEST).map(row).collect();
    output::line(&output::table(&["shipped queries, the slowest", "first_ms", "then_ms"], &rows));
    let number = |p95: Option<f64>| p95.map_or_else(|| "-".to_owned(), |p95| format!("{p95:.1}"));
    let mut rows = Vec::new();
    for collection in ["questions", "dashboards", "Grafana"] {
        let of: Vec<&TimedQuestion> =
            all.iter().copied().filter(|asked| asked.collection == collection).collect();
        rows.push(vec![collection.to_owned(), of.len().to_string(), number(p95(&of))]);
    }
    rows.push(vec!["all".into(), all.len().to_string(), number(p95(&all))]);
    output::line(&output::table(&["shipped queries", "count", "p95_ms"], &rows));
}
