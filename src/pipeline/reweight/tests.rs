//! Databases whose cycles were identified with another estimator than the configured one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use sqlx::{AssertSqlSafe, Connection, SqliteConnection};
use tokio_util::sync::CancellationToken;

use super::Reweighted;
use crate::pipeline::conclude::test_database::assert_summaries_hold;
use crate::pipeline::context::{Outcome, Pipeline, Retry};
use armwatch_config::Config;
use armwatch_model::analysis::Estimator;
use armwatch_simulate::{SimulationSettings, simulate_run};
use armwatch_store::Store;

/// Tests of one robot, with few short cycles: enough for a baseline.
const TESTS: u32 = 4;

struct ReweightFleet {
    folder: tempfile::TempDir,
    exports: Vec<PathBuf>,
}

fn fleet() -> ReweightFleet {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = SimulationSettings {
        cycles: 2,
        warming_s: 2.0,
        first_start: "2026-01-05T08:47:00Z".parse().expect("a time"),
        ..SimulationSettings::default()
    };
    let robot = armwatch_testing::er3a();
    let export =
        |run| simulate_run(&robot, &settings, run, folder.path(), &mut |_| ()).expect("an export").export;
    let exports = (0..TESTS).map(export).collect();
    ReweightFleet { folder, exports }
}

async fn pipeline(path: &Path, estimator: Estimator) -> Pipeline {
    let mut config = Config::shipped().expect("shipped settings");
    config.analysis.estimator = estimator;
    Pipeline::new(Arc::new(config), Store::open(path).await.expect("a store"))
}

impl ReweightFleet {
    fn database(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A database of all exports with an estimator, and its conclusions.
    async fn ingested(&self, name: &str, estimator: Estimator) -> PathBuf {
        let path = self.database(name);
        let pipeline = pipeline(&path, estimator).await;
        for export in &self.exports {
            let stop = CancellationToken::new();
            let outcome = pipeline.process(export, Retry::Never, &stop, |_| ()).await.expect("an outcome");
            assert!(matches!(outcome, Outcome::Stored(_)), "{outcome:?}");
        }
        pipeline.conclude().await.expect("conclusions");
        pipeline.close().await.expect("closed");
        path
    }
}

async fn rows(path: &Path, sql: &str) -> Vec<(String, f64)> {
    let mut connection = connect(path).await;
    sqlx::query_as(AssertSqlSafe(sql.to_owned())).fetch_all(&mut connection).await.expect("rows")
}

async fn connect(path: &Path) -> SqliteConnection {
    SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.expect("a connection")
}

async fn count(path: &Path, sql: &str) -> i64 {
    let mut connection = connect(path).await;
    sqlx::query_scalar(AssertSqlSafe(sql.to_owned())).fetch_one(&mut connection).await.expect("a count")
}

async fn execute(path: &Path, sql: &str) {
    let mut connection = connect(path).await;
    sqlx::raw_sql(AssertSqlSafe(sql.to_owned())).execute(&mut connection).await.expect("done");
}

/// Results that depend on an estimator, by name; errors are separate.
const FIGURES: [&str; 5] = [
    "SELECT run_id || '/' || cycle || '/' || joint || parameter, value FROM cycle_parameters ORDER BY 1",
    "SELECT run_id || '/' || cycle || '/' || joint || stage, moving_relative_rmsd FROM cycle_rmsd
     WHERE moving_relative_rmsd IS NOT NULL ORDER BY 1",
    "SELECT run_id || '/' || cycle || '/' || joint, residual_std_nm FROM joint_residuals ORDER BY 1",
    "SELECT run_id || '/' || joint || parameter || \"window\", mean FROM parameter_statistics ORDER BY 1",
    "SELECT run_id || '/' || joint, relative_rmsd FROM run_joint_summary WHERE relative_rmsd IS NOT NULL ORDER BY 1",
];

async fn assert_alike(ours: &Path, fresh: &Path) {
    for figure in FIGURES {
        let (ours, fresh) = (rows(ours, figure).await, rows(fresh, figure).await);
        assert_eq!(ours.len(), fresh.len(), "{figure}");
        assert!(!ours.is_empty(), "{figure}");
        for ((name, ours), (same, fresh)) in ours.iter().zip(&fresh) {
            assert_eq!(name, same);
            assert!((ours - fresh).abs() <= 1e-7 * fresh.abs().max(1e-3), "{figure}: {name} {ours} {fresh}");
        }
    }
}

#[tokio::test]
async fn an_existing_database_comes_out_as_if_it_had_been_read_with_the_new_estimator() {
    let fleet = fleet();
    let old = fleet.ingested("old.db", Estimator::Ordinary).await;
    let fresh = fleet.ingested("fresh.db", Estimator::Weighted).await;
    let cycles = i64::from(2 * TESTS);
    assert_eq!(count(&old, "SELECT count(*) FROM cycles WHERE estimator = 'ordinary'").await, cycles);
    let anomalies = count(&old, "SELECT count(*) FROM anomalies").await;

    let pipeline = pipeline(&old, Estimator::Weighted).await;
    let mut heard = Vec::new();
    let done = pipeline.reweight(&CancellationToken::new(), &mut |at| heard.push(at)).await.expect("done");
    assert_eq!(done, Reweighted { cycles: cycles as u64, kept: 0, interrupted: false });
    assert!(
        heard.last().is_some_and(|at| (at.done, at.total) == (cycles as u64, cycles as u64)),
        "{heard:?}"
    );
    let concluded = pipeline.conclude().await.expect("conclusions");
    assert_eq!(concluded.len(), 1, "the history has changed");
    assert_summaries_hold(pipeline.store()).await;
    assert!(concluded[0].new_anomalies.is_empty(), "{concluded:?}");
    let again = pipeline.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done");
    assert_eq!(again, Reweighted::default());
    pipeline.close().await.expect("closed");

    assert_alike(&old, &fresh).await;
    assert_eq!(count(&old, "SELECT count(*) FROM anomalies").await, anomalies);
    let weighted =
        "SELECT count(*) FROM cycles WHERE estimator = 'weighted' AND error_basis = 'independent_rows'";
    assert_eq!(count(&old, weighted).await, cycles);
    // the rows of the thirds of the warming stage are not stored: their results stay, marked with their estimator
    assert_eq!(count(&old, "SELECT count(*) FROM warming_contrast WHERE estimator <> 'ordinary'").await, 0);
    // errors by the stored shares are those of blocks on average
    let errors = "SELECT run_id || '/' || cycle || '/' || joint || parameter, std_error FROM cycle_parameters
                  ORDER BY 1";
    let (ours, fresh) = (rows(&old, errors).await, rows(&fresh, errors).await);
    let mean = ours.iter().zip(&fresh).map(|(a, b)| (a.1 / b.1).ln()).sum::<f64>() / ours.len() as f64;
    assert!(mean.abs() < 0.2, "{mean}");
    let without = "SELECT count(*) FROM cycle_parameters WHERE interval_low IS NULL";
    assert_eq!(count(&old, without).await, 0);
}

#[tokio::test]
async fn a_stop_leaves_whole_runs_and_the_rest_follows() {
    let fleet = fleet();
    let path = fleet.ingested("stopped.db", Estimator::Ordinary).await;
    let pipeline = pipeline(&path, Estimator::Weighted).await;
    let stop = CancellationToken::new();
    let done = pipeline
        .reweight(&stop, &mut |at| {
            if at.done == 4 {
                stop.cancel();
            }
        })
        .await
        .expect("done");
    assert_eq!(done, Reweighted { cycles: 4, kept: 0, interrupted: true });
    let by_run = "SELECT count(*) FROM (SELECT run_id FROM cycles GROUP BY run_id HAVING count(DISTINCT estimator) > 1)";
    assert_eq!(count(&path, by_run).await, 0);
    assert_eq!(count(&path, "SELECT count(*) FROM cycles WHERE estimator = 'weighted'").await, 4);
    // conclusions never compare two estimators: they convert the remaining cycles
    let concluded = pipeline.conclude().await.expect("conclusions");
    assert!(concluded.iter().all(|of| of.new_anomalies.is_empty()), "{concluded:?}");
    assert_eq!(count(&path, "SELECT count(*) FROM cycles WHERE estimator = 'ordinary'").await, 0);
}

#[tokio::test]
async fn cycles_without_factors_keep_their_estimator_and_are_not_compared_with_others() {
    let fleet = fleet();
    let path = fleet.ingested("old.db", Estimator::Ordinary).await;
    execute(
        &path,
        "DELETE FROM torque_factor WHERE cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 1);
         DELETE FROM cycle_factor_layout WHERE cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 1);",
    )
    .await;
    let before = rows(&path, "SELECT parameter || joint, value FROM cycle_parameters WHERE run_id = 1").await;
    let pipeline = pipeline(&path, Estimator::Weighted).await;
    let done = pipeline.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done");
    assert_eq!(done, Reweighted { cycles: u64::from(2 * TESTS - 2), kept: 2, interrupted: false });
    let after = rows(&path, "SELECT parameter || joint, value FROM cycle_parameters WHERE run_id = 1").await;
    assert_eq!(before, after);
    let said = "SELECT count(*) FROM cycles
                WHERE run_id = 1 AND estimator = 'ordinary' AND estimator_reason LIKE 'not changed: no factors%'";
    assert_eq!(count(&path, said).await, 2);
    let robots = pipeline.store().stale_robots().await.expect("robots");
    let summaries = pipeline.store().run_summaries(robots[0].robot_id).await.expect("summaries");
    let compared: Vec<bool> =
        summaries.iter().map(|run| run.joints.iter().any(|joint| joint.relative_rmsd.is_some())).collect();
    assert_eq!(compared, [false, true, true, true]);
    assert!(summaries[0].joints.iter().all(|joint| joint.rmsd_swing.is_none()));
    let again = pipeline.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done");
    assert_eq!(again, Reweighted::default(), "said once");
}

#[tokio::test]
async fn huber_needs_rows_and_the_way_back_is_open() {
    let fleet = fleet();
    let path = fleet.ingested("old.db", Estimator::Ordinary).await;
    let untouched = rows(&path, FIGURES[0]).await;
    let cycles = u64::from(2 * TESTS);
    let huber = pipeline(&path, Estimator::Huber).await;
    let done = huber.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done");
    assert_eq!(done, Reweighted { cycles: 0, kept: cycles, interrupted: false });
    huber.close().await.expect("closed");
    assert_eq!(rows(&path, FIGURES[0]).await, untouched);
    let said =
        "SELECT count(*) FROM cycles WHERE estimator_reason LIKE 'not changed: huber weights single rows%'";
    assert_eq!(count(&path, said).await, cycles as i64);

    let weighted = pipeline(&path, Estimator::Weighted).await;
    let done = weighted.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done");
    assert_eq!(done.cycles, cycles);
    weighted.close().await.expect("closed");
    let back = pipeline(&path, Estimator::Ordinary).await;
    assert_eq!(back.reweight(&CancellationToken::new(), &mut |_| ()).await.expect("done").cycles, cycles);
    assert_eq!(count(&path, "SELECT count(*) FROM cycles WHERE estimator_reason IS NOT NULL").await, 0);
    for ((name, ours), (_, before)) in rows(&path, FIGURES[0]).await.iter().zip(&untouched) {
        assert!((ours - before).abs() <= 1e-7 * before.abs().max(1e-3), "{name}: {ours} {before}");
    }
}
