//! Frequent statements find their rows by keys and indices: none scans a table that grows with the history.

use sqlx::{AssertSqlSafe, Row};
use syn::visit::Visit;

use super::support::*;
use crate::kept::estimates::{ANY_TO_MARK, OTHERS};
use crate::lists::UNSETTLED;
use crate::monitoring::UNSETTLED_COUNTS;

/// Sources whose statements run with each conclusion or each scan of the folders.
const SOURCES: [&str; 18] = [
    "robot/alarms/anomalies.rs",
    "robot/indices/baselines.rs",
    "robot/conclude.rs",
    "robot/figures/cycle_friction.rs",
    "robot/cycle_friction_rows.rs",
    "robot/figures/cycle_rmsd.rs",
    "robot/indices/friction.rs",
    "robot/figures/friction_series.rs",
    "robot/history.rs",
    "robot/figures/joint_summary.rs",
    "robot/maintenance.rs",
    "robot/unfinished_run.rs",
    "robot/peers.rs",
    "robot/figures/run_summary.rs",
    "robot/settled.rs",
    "robot/summaries.rs",
    "results/production.rs",
    "ledger/sources.rs",
];

/// Tables with at least one row per run, and their names in statements.
const GROWING: [&str; 21] = [
    "run",
    "test",
    "cycle",
    "last",
    "torque_rmsd",
    "friction_point",
    "cycle_parameter",
    "cycle_friction_level",
    "level",
    "cycle_refusal",
    "why",
    "parameter_statistic",
    "run_joint_summary",
    "summary",
    "run_friction_index",
    "run_friction",
    "run_friction_points",
    "run_summary",
    "run_friction_series",
    "source_file",
    "production_check",
];

#[derive(Default)]
struct Statements(Vec<String>);

impl Visit<'_> for Statements {
    fn visit_lit_str(&mut self, text: &syn::LitStr) {
        let text = text.value();
        if ["SELECT", "WITH", "UPDATE", "DELETE", "INSERT"].iter().any(|verb| text.starts_with(verb)) {
            self.0.push(text);
        }
    }
}

/// True if a line of a plan scans a growing table without an index.
fn looks_through(step: &str) -> bool {
    let Some(rest) = step.strip_prefix("SCAN ") else { return false };
    let name = rest.split(' ').next().unwrap_or_default();
    GROWING.contains(&name) && !rest.contains("USING INDEX run_unfinished")
}

#[tokio::test]
async fn no_statement_of_a_conclusion_looks_through_a_table_that_grows() {
    let (_folder, store) = fresh_file().await;
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut planned = 0;
    for source in SOURCES {
        let text = std::fs::read_to_string(root.join(source)).expect(source);
        let mut statements = Statements::default();
        statements.visit_file(&syn::parse_file(&text).expect(source));
        for statement in statements.0 {
            let plan = sqlx::query(AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}")));
            // the beginnings of composed statements are no statements
            let Ok(steps) = plan.fetch_all(&store.writer).await else { continue };
            planned += 1;
            for step in steps {
                let step: String = step.get("detail");
                assert!(!looks_through(&step), "{source}: {step}, of:\n{statement}");
            }
        }
    }
    assert!(planned > 60, "{planned} statements were understood");
}

/// Queries of monitoring, the dashboard and each conclusion read rows that are open or not yet marked, and not the rows
/// that were settled in years.
#[tokio::test]
async fn settled_anomalies_and_kept_estimates_are_not_read() {
    let (_folder, store) = fresh_file().await;
    // the second index only contains open rows, so reading all of it is fine
    let anomalies = ["anomaly_by_state (state=?", "INDEX anomaly_in_force"];
    let cycles = ["cycle_by_estimator (estimator=? AND estimator_wanted=?"];
    for (statement, table, indices) in [
        (UNSETTLED_COUNTS, "anomaly", &anomalies[..]),
        (UNSETTLED, "anomaly", &anomalies),
        ("SELECT * FROM fleet_health", "anomaly", &anomalies),
        ("SELECT count(*) FROM anomalies WHERE state = 'open'", "anomaly", &anomalies),
        (ANY_TO_MARK, "cycle", &cycles),
        (OTHERS, "cycle", &cycles),
    ] {
        let plan = sqlx::query(AssertSqlSafe(format!("EXPLAIN QUERY PLAN {statement}")));
        let steps = plan.fetch_all(&store.writer).await.expect("a plan");
        let steps: Vec<String> = steps.iter().map(|step| step.get("detail")).collect();
        let of_table =
            |step: &&String| step.split(' ').nth(1) == Some(table) && !step.starts_with("CO-ROUTINE");
        let found: Vec<&String> = steps.iter().filter(of_table).collect();
        assert!(!found.is_empty(), "{steps:?}, of:\n{statement}");
        for step in found {
            let is_bounded = indices.iter().any(|index| step.contains(index));
            assert!(is_bounded, "{step}, of:\n{statement}");
        }
    }
}

#[test]
fn a_look_through_a_growing_table_is_seen() {
    assert!(looks_through("SCAN run"));
    assert!(looks_through("SCAN cycle USING INDEX cycle_by_estimator"));
    assert!(!looks_through("SCAN run USING INDEX run_unfinished"));
    assert!(!looks_through("SCAN robot"));
    assert!(!looks_through("SEARCH run USING INDEX run_by_robot (robot_id=?)"));
}
