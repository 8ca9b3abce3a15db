//! `armwatch alerts show`: an anomaly with its evidence.

use jiff::Timestamp;
use serde::Serialize;

use super::anomaly_texts::{figure, find, minute, name, place, state};
use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::plot::PlotFile;
use crate::report::anomaly::{EvidencePoint, anomaly_figure};
use crate::report::figure::day;
use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::anomaly::forecast::{Crossing, Forecast, Trend};
use armwatch_model::anomaly::odds::odds_in_words;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::robot::JointIndex;
use armwatch_model::run::RunKind;
use armwatch_model::text;
use armwatch_store::{AnomalyHistoryRow, AnomalyRow, SeriesRun, Store};

/// Tests that are printed; a picture and JSON contain all.
const TESTS_SHOWN: usize = 20;

pub(super) async fn show(
    global: &Global,
    store: &Store,
    id: i64,
    plot: Option<&PlotFile>,
    now: Timestamp,
) -> Result<u8, CliError> {
    let row = find(store, id, now).await?;
    let mut tests = store.evidence(&row.robot).await?;
    tests.retain(|test| row.joint.is_none_or(|joint| joint == test.joint));
    let history = store.anomaly_history(id).await?;
    let forecast = forecast(store, &row).await?;
    if let Some(file) = plot {
        if tests.is_empty() {
            return Err(CliError::Usage(format!("no complete test of {} has values to draw", row.robot)));
        }
        file.write(&picture(&row, &tests))?;
    }
    if global.json {
        let tests =
            tests.iter().map(|test| EvidenceJson { test, shows_it: is_within(&row, test.started_at) });
        output::json(&AnomalyJson { row: &row, tests: tests.collect(), history: &history, forecast });
        return Ok(EXIT_DONE);
    }
    facts(&row).iter().for_each(|fact| output::line(fact));
    forecast.iter().for_each(|forecast| output::line(&forecast_text(forecast)));
    output::block(&format!("\n{}", tests_text(&row, &tests)));
    output::block(&format!("\n{}", history_text(&history)));
    Ok(EXIT_DONE)
}

/// An anomaly with its evidence, as JSON.
#[derive(Serialize)]
struct AnomalyJson<'a> {
    #[serde(flatten)]
    row: &'a AnomalyRow,
    tests: Vec<EvidenceJson<'a>>,
    history: &'a [AnomalyHistoryRow],
    forecast: Option<Forecast>,
}

#[derive(Serialize)]
struct EvidenceJson<'a> {
    #[serde(flatten)]
    test: &'a SeriesRun,
    /// True if the anomaly was seen in this test.
    shows_it: bool,
}

/// Facts about the anomaly, one per line.
fn facts(row: &AnomalyRow) -> Vec<String> {
    let run = |id: Option<i64>| id.map(|id| format!(", run {id}")).unwrap_or_default();
    let cycle = |number: Option<u32>| number.map(|number| format!(", cycle {number}")).unwrap_or_default();
    let mut lines = vec![format!("anomaly {}: {} {}", row.anomaly_id, row.severity, name(row))];
    let mut fact = |name: &str, text: String| lines.push(format!("{name:<11} {text}"));
    fact("message", row.message.clone());
    let standing = match (row.ended, row.provisional) {
        (true, _) => "; later tests no longer show it",
        (_, true) => "; provisional until its test is complete",
        _ => "",
    };
    fact("state", format!("{}{standing}", state(row)));
    if let Some(assignee) = &row.assignee {
        fact("assigned to", assignee.clone());
    }
    if let Some(onset) = row.onset_at {
        fact("onset", format!("{}{}{}", minute(onset), run(row.onset_run_id), cycle(row.onset_cycle)));
    }
    fact("first seen", format!("{}{}{}", minute(row.first_seen_at), run(row.run_id), cycle(row.cycle)));
    fact("last seen", format!("{}{}", minute(row.last_seen_at), run(row.last_run_id)));
    fact("quantity", in_unit(row.quantity));
    fact(
        "value",
        format!(
            "latest {}, peak {}; expected {}",
            figure(row.value),
            figure(row.peak_value),
            figure(row.baseline)
        ),
    );
    fact(
        "score",
        format!(
            "latest {}, peak {}{}",
            figure(row.score),
            figure(row.peak_score),
            row.threshold
                .filter(|limit| *limit != 0.0)
                .map(|limit| format!("; limit {}", figure(Some(limit))))
                .unwrap_or_default()
        ),
    );
    match row.odds {
        Some(odds) => {
            fact("cause", format!("{}, odds {} against all others together", row.kind, odds_in_words(odds)))
        }
        None => fact("cause", format!("{}; other causes were not compared", row.kind)),
    }
    for rejected in &row.alternatives {
        fact("rather than", format!("{}, odds {}", rejected.cause, odds_in_words(rejected.odds)));
    }
    lines
}

/// A quantity and its unit.
fn in_unit(quantity: Quantity) -> String {
    match quantity.unit() {
        None | Some("1") => quantity.to_string(),
        Some(unit) => format!("{quantity}, {unit}"),
    }
}

/// The forecast of the joint, for an anomaly of its friction that the latest test still shows.
async fn forecast(store: &Store, row: &AnomalyRow) -> Result<Option<Forecast>, CliError> {
    let Some(joint) = row.joint.filter(|_| row.kind == AnomalyKind::Drift && !row.ended) else {
        return Ok(None);
    };
    let health = store.fleet_health().await?;
    let of_joint = health.into_iter().find(|health| health.robot == row.robot && health.joint == joint);
    // production logs have a separate drift, and no forecast
    let of_joint = of_joint.filter(|health| health.friction_quantity == Some(row.quantity));
    Ok(of_joint.and_then(|health| health.forecast))
}

fn forecast_text(forecast: &Forecast) -> String {
    let by = |name: &str, crossing: Option<Crossing>| crossing.map(|of| format!("{name} by {}", of.words()));
    let limits = [by("warning", forecast.warning_at), by("critical", forecast.critical_at)];
    let limits: Vec<String> = limits.into_iter().flatten().collect();
    let text = match (forecast.trend, limits.is_empty()) {
        (Trend::None, _) => "no trend that reaches a limit".to_owned(),
        (trend, true) => format!("friction is {}; its limits are exceeded or far away", trend.name()),
        (trend, false) => format!("friction is {}: {}", trend.name(), limits.join("; ")),
    };
    format!("{:<11} {text}", "forecast")
}

fn is_within(row: &AnomalyRow, at: Timestamp) -> bool {
    (row.first_seen_at..=row.last_seen_at).contains(&at)
}

/// The latest tests; for an anomaly of the whole arm, the RMSD of each joint.
fn tests_text(row: &AnomalyRow, tests: &[SeriesRun]) -> String {
    if tests.is_empty() {
        return format!("no complete test of {} has values of it", text::shown(&row.robot));
    }
    let by_run: Vec<&[SeriesRun]> = tests.chunk_by(|a, b| a.run_id == b.run_id).collect();
    let shown = &by_run[by_run.len().saturating_sub(TESTS_SHOWN)..];
    let mut header: Vec<String> = vec!["run".into(), "start (UTC)".into(), "".into()];
    match row.joint {
        Some(_) => header.extend(
            ["friction_index", "std_error", "warm_friction_nm", "moving_relative_rmsd", "rmsd_swing"]
                .map(String::from),
        ),
        None => {
            let joints = tests.iter().map(|test| test.joint.number()).max().unwrap_or(0);
            header.extend((1..=joints).map(|joint| format!("rmsd {joint}")));
        }
    }
    let cells = |joints: &&[SeriesRun]| {
        let test = &joints[0];
        let mark = if is_within(row, test.started_at) { "*" } else { "" };
        let mut cells = vec![test.run_id.to_string(), minute(test.started_at), mark.to_owned()];
        match row.joint {
            Some(_) => cells.extend([
                figure(test.friction_index),
                figure(test.friction_index_std_error),
                figure(test.warm_friction_nm),
                figure(test.moving_relative_rmsd),
                figure(test.rmsd_swing),
            ]),
            None => cells.extend((3..header.len()).map(|column| {
                let of_joint = joints.iter().find(|test| test.joint == JointIndex::new(column - 3));
                figure(of_joint.and_then(|test| test.moving_relative_rmsd))
            })),
        }
        cells
    };
    let rows: Vec<Vec<String>> = shown.iter().map(cells).collect();
    let earlier = by_run.len() - shown.len();
    let earlier = if earlier > 0 { format!("; {earlier} earlier ones are not shown") } else { String::new() };
    let mut text = format!("tests, {} (* from first to last seen{earlier})\n", text::shown(&place(row)));
    text.push_str(&output::table(&header.iter().map(String::as_str).collect::<Vec<_>>(), &rows));
    if row.quantity.history() == RunKind::Production {
        text.push_str(&format!(
            "\nthe logs of production that show it: `SELECT * FROM production_trend WHERE robot = '{}'`",
            row.robot
        ));
    }
    text
}

fn history_text(history: &[AnomalyHistoryRow]) -> String {
    if history.is_empty() {
        return "history: none; it had ended when it was found, or an earlier version found it".to_owned();
    }
    let cells = |event: &AnomalyHistoryRow| {
        vec![
            minute(event.at),
            event.what.name().replace('_', " "),
            output::coloured(event.severity.name()),
            figure(event.score),
            event.run_id.map_or_else(|| "-".into(), |id| id.to_string()),
            event.who.clone().unwrap_or_else(|| "armwatch".into()),
            event.why.clone().unwrap_or_default(),
        ]
    };
    let header = ["time (UTC)", "what", "severity", "score", "run", "who", "why"];
    format!("history\n{}", output::table(&header, &history.iter().map(cells).collect::<Vec<_>>()))
}

fn picture(row: &AnomalyRow, tests: &[SeriesRun]) -> crate::report::figure::Figure {
    let point = |test: &SeriesRun| EvidencePoint {
        day: day(test.started_at),
        joint: test.joint,
        friction_index: test.friction_index,
        friction_index_std_error: test.friction_index_std_error,
        warm_friction_nm: test.warm_friction_nm,
        relative_rmsd: test.moving_relative_rmsd,
    };
    let points: Vec<EvidencePoint> = tests.iter().map(point).collect();
    let span = [row.onset_at.unwrap_or(row.first_seen_at).min(row.first_seen_at), row.last_seen_at].map(day);
    let title = format!("anomaly {}: {}", row.anomaly_id, name(row));
    anomaly_figure(&points, span, title, row.message.clone())
}

#[cfg(test)]
mod tests {
    use jiff::civil::date;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_forecast_names_the_limits_that_are_ahead() {
        let crossing = Crossing { by: date(2026, 5, 3), lower: date(2026, 4, 11), upper: None };
        let rising = Forecast { trend: Trend::Rising, warning_at: None, critical_at: Some(crossing) };
        let text = "forecast    friction is rising: critical by 2026-05-03 (80 %: not before 2026-04-11)";
        assert_eq!(forecast_text(&rising), text);
        let value = json!({
            "trend": "rising", "warning": null,
            "critical": {"by": "2026-05-03", "lower": "2026-04-11", "upper": null},
        });
        assert_eq!(serde_json::to_value(rising).expect("JSON"), value);
        let passed = Forecast { critical_at: None, ..rising };
        assert!(forecast_text(&passed).ends_with("its limits are exceeded or far away"));
        assert!(forecast_text(&Forecast::default()).ends_with("no trend that reaches a limit"));
    }
}
