//! `armwatch benchmark history`: time of the questions of a conclusion, and of those of the cookbook, on a long history.

use std::time::{Duration, Instant};

use clap::Args;
use serde_json::json;

use crate::analysis::Estimator;
use crate::cli::context::{CliError, EXIT_DONE, Global, runtime};
use crate::cli::shared::output;
use crate::store::{Store, StoreError, SyntheticSize};

/// The queries that people are shown.
const COOKBOOK: &str = include_str!("../../../docs/cookbook.md");

/// Tests of a baseline, as the shipped configuration has it.
const BASELINE_RUNS: usize = 5;

#[derive(Debug, Args)]
#[command(after_help = "\
Fills a new database in a temporary folder with a history that nobody recorded, six joints a robot, and prints how long
the questions take that conclusions of one robot ask, the first time and once its series are stored, and the queries of
docs/cookbook.md. A thousand tests of 24 cycles take 80 MB and some seconds to make.

Examples:
  armwatch benchmark history
  armwatch benchmark history --runs 10000
  armwatch benchmark history --robots 200 --runs 500 --cycles 8 --json")]
pub(in crate::cli) struct HistoryArgs {
    /// Robots
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    robots: u32,
    /// Tests of each robot
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    runs: u32,
    /// Cycles of each test
    #[arg(long, default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=100))]
    cycles: u32,
}

/// A question and how long its answer took.
struct Asked {
    question: String,
    first: Duration,
    then: Duration,
}

pub(in crate::cli) fn history(global: &Global, args: &HistoryArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let path = folder.path().join("history.db");
    let size = SyntheticSize { robots: args.robots, runs: args.runs, cycles: args.cycles };
    let (made, bytes, conclusion, cookbook) = runtime()?.block_on(async {
        let store = Store::open(&path).await?;
        let began = Instant::now();
        store.fill_synthetic(size).await?;
        let made = began.elapsed();
        let conclusion = of_conclusion(&store).await?;
        let mut cookbook = Vec::new();
        for (question, statement) in questions(COOKBOOK) {
            let mut times = [Duration::ZERO; 2];
            for time in &mut times {
                let began = Instant::now();
                let answered = store.ask(statement).await;
                answered.map_err(|error| CliError::Internal(format!("{question}: {error}")))?;
                *time = began.elapsed();
            }
            cookbook.push(Asked { question: question.to_owned(), first: times[0], then: times[1] });
        }
        let bytes = store.size().await.map_or(0, |size| size.database + size.log);
        store.close().await?;
        Ok::<_, CliError>((made, bytes, conclusion, cookbook))
    })?;
    report(global, size, made, bytes, &conclusion, cookbook);
    Ok(EXIT_DONE)
}

/// The questions of a conclusion of the first robot, in its order.
async fn of_conclusion(store: &Store) -> Result<Vec<Asked>, StoreError> {
    let names = [
        "latest warm friction",
        "friction of the first and latest tests",
        "tests of baselines",
        "peers",
        "windows of ordinary work",
        "summaries of all tests",
    ];
    let mut times = [[Duration::ZERO; 6]; 2];
    for times in &mut times {
        let mut began = Instant::now();
        let mut lap = |place: usize| {
            times[place] = began.elapsed();
            began = Instant::now();
        };
        store.latest_warm_levels(1).await?;
        lap(0);
        store.friction_history(1, 1.0).await?;
        lap(1);
        store.friction_tests(1).await?;
        lap(2);
        store.peers(1, BASELINE_RUNS).await?;
        lap(3);
        store.production_windows(1, Estimator::Weighted).await?;
        lap(4);
        let mut conclusion = store.conclude(1).await?;
        let history = conclusion.history().await?;
        conclusion.run_summaries().await?;
        conclusion.commit(history).await?;
        lap(5);
    }
    let [first, then] = times;
    let asked = names.into_iter().zip(first.into_iter().zip(then));
    Ok(asked.map(|(name, (first, then))| Asked { question: name.into(), first, then }).collect())
}

/// Headings with the statement below each.
fn questions(text: &str) -> Vec<(&str, &str)> {
    let mut heading = "";
    let mut found = Vec::new();
    let mut rest = text;
    while let Some((line, after)) = rest.split_once('\n') {
        rest = after;
        if let Some(words) = line.strip_prefix("### ") {
            heading = words;
        } else if line == "```sql"
            && let Some((statement, after)) = after.split_once("\n```")
        {
            found.push((heading, statement));
            rest = after;
        }
    }
    found
}

fn report(
    global: &Global,
    size: SyntheticSize,
    made: Duration,
    bytes: u64,
    conclusion: &[Asked],
    mut cookbook: Vec<Asked>,
) {
    let ms = |time: Duration| (time.as_secs_f64() * 1e5).round() / 100.0;
    let together = |of: fn(&Asked) -> Duration| ms(conclusion.iter().map(of).sum());
    let (first, then) = (together(|asked| asked.first), together(|asked| asked.then));
    cookbook.sort_by_key(|asked| asked.then);
    // the time that 95 of 100 do not exceed
    let p95 = cookbook.get((cookbook.len() * 95).div_ceil(100).saturating_sub(1)).map(|asked| ms(asked.then));
    if global.json {
        let rows = |asked: &[Asked]| -> Vec<_> {
            let row = |of: &Asked| json!({"question": of.question, "first_ms": ms(of.first), "then_ms": ms(of.then)});
            asked.iter().map(row).collect()
        };
        return output::json(&json!({
            "robots": size.robots, "runs": size.runs, "cycles": size.cycles, "bytes": bytes,
            "made_s": made.as_secs_f64(), "conclusion": rows(conclusion), "conclusion_first_ms": first,
            "conclusion_then_ms": then, "cookbook": rows(&cookbook), "cookbook_p95_ms": p95,
        }));
    }
    let SyntheticSize { robots, runs, cycles } = size;
    output::line(&format!(
        "{robots} robots, {runs} tests of each with {cycles} cycles: {:.0} MB, made in {:.0} s",
        bytes as f64 / 1e6,
        made.as_secs_f64()
    ));
    let row =
        |of: &Asked| vec![of.question.clone(), format!("{:.1}", ms(of.first)), format!("{:.1}", ms(of.then))];
    let mut rows: Vec<Vec<String>> = conclusion.iter().map(row).collect();
    rows.push(vec!["together".into(), format!("{first:.1}"), format!("{then:.1}")]);
    output::line(&output::table(&["conclusion of one robot", "first_ms", "then_ms"], &rows));
    let rows: Vec<Vec<String>> = cookbook.iter().rev().take(5).map(row).collect();
    output::line(&output::table(&["cookbook, the slowest five", "first_ms", "then_ms"], &rows));
    let p95 = p95.map_or_else(|| "-".to_owned(), |p95| format!("{p95:.1}"));
    output::line(&format!("cookbook: {} queries, 95 % of them within {p95} ms", cookbook.len()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_statement_of_the_cookbook_is_found_with_its_question() {
        let found = questions(COOKBOOK);
        assert_eq!(found.len(), COOKBOOK.matches("\n```sql\n").count());
        assert!(found.iter().all(|(question, statement)| !question.is_empty() && statement.contains("FROM")));
    }
}
