//! `armwatch friction --index`: the friction index by run, and a test of its whiteness for control charts.

use serde_json::json;

use crate::cli::shared::life::{RobotLife, index_points};
use crate::cli::shared::output;
use crate::report::figure::{Figure, FigureEvent, StatusWord};
use crate::report::friction_index::{IndexLimits, IndexPanel, index_figure};
use armwatch_method::statistics::descriptive::standard_deviation;
use armwatch_method::statistics::distributions::normal_quantile;
use armwatch_method::statistics::whiteness::{LARGEST_LAG, MIN_VALUES, Whiteness, common_lag_1, whiteness};
use armwatch_model::text;
use armwatch_store::{IndexRow, ThermalSourceRow, time_in_views};

/// Indices of one joint of one robot, oldest run first.
pub(in crate::cli) struct JointIndexSeries {
    robot: String,
    rows: Vec<IndexRow>,
    /// Status of the joint.
    standing: Option<StatusWord>,
    /// Its events.
    events: Vec<FigureEvent>,
    /// Days between which an alarm on its friction was seen.
    alarms: Vec<[f64; 2]>,
    /// Source of the thermal state, if there is a map now.
    source: Option<ThermalSourceRow>,
}

impl JointIndexSeries {
    /// Splits rows of a robot, ordered by joint.
    pub(in crate::cli) fn of(
        robot: &str,
        rows: &[IndexRow],
        sources: &[ThermalSourceRow],
        life: &RobotLife,
    ) -> Vec<Self> {
        let source = |joint| sources.iter().find(|source| source.joint == joint).cloned();
        let by_joint = rows.chunk_by(|a, b| a.joint == b.joint);
        by_joint
            .map(|rows| Self {
                robot: robot.to_owned(),
                rows: rows.to_vec(),
                standing: rows.first().and_then(|row| life.standing(row.joint)),
                events: rows.first().map_or_else(Vec::new, |row| life.events_of(row.joint)),
                alarms: rows.first().map_or_else(Vec::new, |row| life.alarms_of(row.joint)),
                source: rows.first().and_then(|row| source(row.joint)),
            })
            .collect()
    }

    fn source_name(&self) -> Option<&str> {
        self.source.as_ref().map(|row| row.source.as_str())
    }

    /// Limitations of the joint's map, in sentences.
    fn remarks(&self) -> impl Iterator<Item = &str> {
        self.source.iter().filter_map(|row| row.remarks.as_deref()).flat_map(str::lines)
    }

    fn values(&self) -> Vec<f64> {
        self.rows.iter().map(|row| row.index.value).collect()
    }

    /// Share of the variance of measured friction between runs that the index removes; `None` if fewer than
    /// [`MIN_VALUES`] runs were long enough for a comparison of measured friction.
    fn explained(&self) -> Option<f64> {
        let full = self.rows.iter().filter(|row| !row.short && row.raw.is_some());
        let (raw, index): (Vec<f64>, Vec<f64>) =
            full.filter_map(|row| Some((row.raw?, row.index.value))).unzip();
        let (raw, index) = (standard_deviation(&raw)?, (index.len() >= MIN_VALUES).then_some(index)?);
        (raw > 0.0).then_some(1.0 - (standard_deviation(&index)? / raw).powi(2))
    }
}

/// Prints all series, as tables or, with `json`, one object per line.
pub(in crate::cli) fn print(series: &[JointIndexSeries], json: bool) {
    let long: Vec<Vec<f64>> = series.iter().map(JointIndexSeries::values).collect();
    let together = common_lag_1(&long);
    if json {
        series.iter().for_each(|of_joint| output::json(&as_value(of_joint)));
        output::json(&json!({
            "joint": null,
            "series": long.iter().filter(|values| values.len() >= MIN_VALUES).count(),
            "lag_1": together.map(|lag| lag.value),
            "lag_1_std_error": together.map(|lag| lag.std_error),
            "lag_1_below_limit": together.map(|lag| lag.value < LARGEST_LAG),
        }));
        return;
    }
    for of_robot in series.chunk_by(|a, b| a.robot == b.robot) {
        output::block(&robot_text(of_robot));
    }
    let verdict = together.map_or_else(
        || format!("memory from run to run: unknown, no joint has {MIN_VALUES} runs with an index"),
        |lag| {
            format!(
                "all joints together: lag-1 autocorrelation {:.2}, standard error {:.2}: {} the \
                {LARGEST_LAG} that control charts tolerate",
                lag.value,
                lag.std_error,
                if lag.value < LARGEST_LAG { "below" } else { "above" }
            )
        },
    );
    output::line(&verdict);
}

/// Picture of all series.
pub(in crate::cli) fn figure(series: &[JointIndexSeries], limits: IndexLimits, names: &str) -> Figure {
    let robots = series.chunk_by(|a, b| a.robot == b.robot).count();
    let panel = |of: &JointIndexSeries| {
        let joint = of.rows[0].joint;
        IndexPanel {
            title: if robots > 1 { format!("{}, joint {joint}", of.robot) } else { format!("joint {joint}") },
            standing: of.standing.clone(),
            runs: index_points(&of.rows),
            events: of.events.clone(),
            alarms: of.alarms.clone(),
        }
    };
    let panels: Vec<IndexPanel> = series.iter().map(panel).collect();
    let subtitle = "friction against the joint's own baseline at equal speed and thermal state";
    index_figure(&panels, limits, format!("{names}: friction index by run"), subtitle.into())
}

fn robot_text(series: &[JointIndexSeries]) -> String {
    let mut lines = vec![format!("friction index of {}", text::shown(&series[0].robot))];
    let half = normal_quantile(0.975);
    let cells = |of_joint: &JointIndexSeries, row: &IndexRow| {
        let (low, high) =
            (row.index.value - half * row.index.std_error, row.index.value + half * row.index.std_error);
        vec![
            of_joint.rows[0].joint.to_string(),
            row.run_id.to_string(),
            row.started_at.strftime("%Y-%m-%d %H:%MZ").to_string(),
            format!("{:.4}", row.index.value),
            format!("{low:.4} .. {high:.4}"),
            row.raw.map_or_else(|| "-".into(), |raw| format!("{raw:.3}")),
            if row.short { "short run".into() } else { String::new() },
        ]
    };
    let rows: Vec<Vec<String>> =
        series.iter().flat_map(|of| of.rows.iter().map(move |row| cells(of, row))).collect();
    lines.push(output::table(&["joint", "run", "start", "index", "95 %", "as measured", ""], &rows));
    lines.push(String::new());
    let rows: Vec<Vec<String>> = series.iter().map(summary_cells).collect();
    let header = [
        "joint",
        "runs",
        "mean",
        "std",
        "lag-1",
        "p white",
        "white enough",
        "warm-up explains",
        "thermal state",
    ];
    lines.push(output::table(&header, &rows));
    lines.extend(series.iter().flat_map(JointIndexSeries::remarks).map(str::to_owned));
    lines.join("\n")
}

fn summary_cells(of_joint: &JointIndexSeries) -> Vec<String> {
    let mut cells = vec![of_joint.rows[0].joint.to_string(), of_joint.rows.len().to_string()];
    match whiteness(&of_joint.values()) {
        Some(white) => cells.extend([
            format!("{:.4}", white.mean),
            format!("{:.4}", white.std),
            format!("{:.2} ({:.2})", white.lag_1.value, white.lag_1.std_error),
            format!("{:.2}", white.p_value),
            white.verdict().name().to_owned(),
        ]),
        None => cells.extend(["-", "-", "-", "-", "too few runs"].map(str::to_owned)),
    }
    let explained = of_joint.explained();
    cells.push(explained.map_or_else(|| "-".into(), |part| format!("{:.0} %", 100.0 * part)));
    cells.push(of_joint.source_name().unwrap_or("-").to_owned());
    cells
}

fn as_value(of_joint: &JointIndexSeries) -> serde_json::Value {
    let half = normal_quantile(0.975);
    let runs: Vec<serde_json::Value> = (of_joint.rows.iter())
        .map(|row| {
            json!({
                "run_id": row.run_id, "started_at": time_in_views(row.started_at),
                "friction_index": row.index.value, "friction_index_std_error": row.index.std_error,
                "low": row.index.value - half * row.index.std_error,
                "high": row.index.value + half * row.index.std_error,
                "raw_index": row.raw, "short_run": row.short,
            })
        })
        .collect();
    let white = whiteness(&of_joint.values());
    let known = |of: fn(&Whiteness) -> f64| white.as_ref().map(of);
    json!({
        "robot": of_joint.robot, "joint": of_joint.rows[0].joint.number(), "runs": runs,
        "mean": known(|w| w.mean), "std": known(|w| w.std),
        "lag_1": known(|w| w.lag_1.value), "lag_1_std_error": known(|w| w.lag_1.std_error),
        "ljung_box": known(|w| w.ljung_box), "lags": white.map(|w| w.lags), "p_white": known(|w| w.p_value),
        "white_enough": white.map_or("too few runs", |w| w.verdict().name()),
        "warm_up_explains": of_joint.explained(),
        "thermal_source": of_joint.source_name(), "remarks": of_joint.remarks().collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::Estimate;
    use armwatch_model::robot::JointIndex;
    use jiff::Timestamp;

    fn rows(joint: usize, runs: i64, value: impl Fn(i64) -> f64) -> Vec<IndexRow> {
        (0..runs)
            .map(|run_id| IndexRow {
                run_id,
                started_at: Timestamp::UNIX_EPOCH,
                joint: JointIndex::new(joint),
                index: Estimate { value: value(run_id), std_error: 0.01 },
                raw: Some(1.0 + 10.0 * (value(run_id) - 1.0)),
                short: run_id == 0,
            })
            .collect()
    }

    #[test]
    fn memory_and_too_few_runs_are_said_and_the_explained_part_is_that_of_the_variances() {
        let mut all = rows(0, 20, |run| 1.0 + 0.01 * f64::from(u8::from(run > 9)));
        all.extend(rows(1, 5, |run| 1.0 + 0.001 * run as f64));
        let source = ThermalSourceRow {
            joint: JointIndex::new(0),
            source: "motor_temperature".into(),
            remarks: Some("joint 1: the fast time constant is assumed".into()),
        };
        let series = JointIndexSeries::of("R01", &all, &[source], &RobotLife::default());
        assert_eq!(series.len(), 2);
        let text = robot_text(&series);
        assert!(text.contains("too few runs") && text.contains("  no  "), "{text}");
        // measured friction scatters ten times as much
        assert!((series[0].explained().expect("enough runs") - 0.99).abs() < 1e-9);
        assert_eq!(series[1].explained(), None);
        let limits = IndexLimits { warning: 0.05, critical: 0.15 };
        assert_eq!(figure(&series, limits, "R01").panels.len(), 2);
        let value = as_value(&series[0]);
        assert_eq!((value["joint"].as_u64(), value["white_enough"].as_str()), (Some(1), Some("no")));
        assert_eq!(value["runs"].as_array().map(Vec::len), Some(20));
        assert_eq!(value["thermal_source"].as_str(), Some("motor_temperature"));
        assert!(
            text.contains("motor_temperature") && text.contains("joint 1: the fast time constant"),
            "{text}"
        );
        assert!(as_value(&series[1])["thermal_source"].is_null());
    }
}
