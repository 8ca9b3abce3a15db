//! Runs, cycles and findings for the store's tests, and a dump of everything that users see.

use jiff::{SignedDuration, Timestamp};
use sqlx::{AssertSqlSafe, Row};
use tempfile::TempDir;

use crate::engine::{Dialect, catalog};
use crate::handle::Store;
use crate::ledger::quarantine::ExportFault;
use crate::ledger::run_progress::RunTotals;
use crate::robot::conclude::StaleRobot;
use armwatch_model::analysis::{
    CarriedLoad, CycleAnalysis, CycleFactors, CycleTemperatures, Decay, Estimate, Estimator, FastShown,
    FrictionPoint, GravityRemoval, Identification, IdentifiedParameter, JointResidual, JointSummary,
    ParameterStatistics, Rmsd, RmsdScope, RmsdSwing, RunAnalysis, StatisticsWindow, TorqueNoise, TorqueRmsd,
    WarmFriction, WarmUpFit, WarmUpModel,
};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Findings, JointHealth, Knowledge, Onset, Severity};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};
use armwatch_model::run::{ContentHash, RunHeader, RunKind, Stage};
use armwatch_testing::er3a;

/// A fault at a place, or of the export as a whole.
pub(crate) fn fault(problem: &str, place: Option<(u64, &str)>) -> ExportFault {
    ExportFault {
        reason: problem.into(),
        problem: problem.into(),
        line: place.map(|(line, _)| line),
        column: place.map(|(_, column)| column.into()),
        ..ExportFault::default()
    }
}

/// A fresh database; the folder lives as long as the first value.
///
/// `ARMWATCH_TEST_SERVER=postgres:///{}?host=/run/postgresql&user=armwatch` creates it on that server, in a separate
/// database whose name replaces `{}`. Tests with statements for SQLite use [`fresh_file`].
pub(crate) async fn fresh() -> (TempDir, Store) {
    if let Ok(address) = std::env::var("ARMWATCH_TEST_SERVER") {
        let folder = tempfile::tempdir().expect("a folder");
        let store = on_server(&address, &folder).await;
        return (folder, store);
    }
    fresh_file().await
}

/// A fresh database in a file `fleet.db` of the folder.
pub(crate) async fn fresh_file() -> (TempDir, Store) {
    let folder = tempfile::tempdir().expect("a folder");
    let store = Store::open(&folder.path().join("fleet.db")).await.expect("a store");
    (folder, store)
}

/// A database on a server, named after the folder of the test.
async fn on_server(address: &str, folder: &TempDir) -> Store {
    use sqlx::Connection;
    let name = folder.path().file_name().expect("a name").to_string_lossy().replace('.', "t_");
    let mut server = sqlx::PgConnection::connect(&address.replace("{}", "postgres")).await.expect("a server");
    let made = sqlx::raw_sql(AssertSqlSafe(format!("CREATE DATABASE \"{name}\""))).execute(&mut server).await;
    made.expect("a database");
    Store::open(address.replace("{}", &name).as_ref()).await.expect("a store")
}

/// 2026-01-05T06:00:00Z and `days` later.
pub(crate) fn day(days: i64) -> Timestamp {
    let first: Timestamp = "2026-01-05T06:00:00Z".parse().expect("a time");
    first + SignedDuration::from_hours(24 * days)
}

/// Export of `robot` on a day.
pub(crate) fn header(robot: &str, days: i64) -> RunHeader {
    let name = format!("{robot}_day{days}.csv");
    RunHeader {
        robot: robot.into(),
        model: "er3a".into(),
        started_at: day(days),
        source_path: format!("/exports/{name}"),
        content_hash: ContentHash(*blake3::hash(name.as_bytes()).as_bytes()),
        source_bytes: 123_456_789,
        source_name: name,
    }
}

/// The 64 base parameters of the reference arm, in natural order.
pub(crate) fn kept() -> Vec<ParameterId> {
    let keep = |id: &ParameterId| match (id.kind, id.joint.index()) {
        (ParameterKind::Inertial(k), 0) => k == 9,
        (ParameterKind::Inertial(k), _) => [1, 2, 4, 5, 6, 8, 9].contains(&k),
        (ParameterKind::MotorInertia, joint) => joint >= 2,
        (ParameterKind::Friction(_), _) => true,
        (ParameterKind::Coupling(_) | ParameterKind::Spring(_) | ParameterKind::Crank(_), _) => false,
    };
    ParameterId::natural_order(&er3a()).into_iter().filter(keep).collect()
}

/// A complete six-joint cycle: 64 parameters, 24 deviations, 72 friction points. No two values are equal.
pub(crate) fn cycle(number: u32) -> CycleAnalysis {
    let base = f64::from(number);
    let start = 300.5 * (base - 1.0);
    let parameters = kept()
        .into_iter()
        .zip(1..)
        .map(|(id, place)| IdentifiedParameter {
            id,
            value: base / 3.0 + f64::from(place),
            std_error: f64::from(place) / 700.0,
            degrees_of_freedom: 20.0 + f64::from(place),
        })
        .collect();
    CycleAnalysis {
        cycle: number,
        start,
        duration: 300.25,
        rows: 30_026,
        sample_rate: 100.0,
        mean_speeds: vec![0.5, 0.25],
        temperatures: CycleTemperatures { motor: vec![Some(312.65), None], ambient: Some(294.4) },
        cutoff: 12.5,
        estimator: Estimator::Weighted,
        identification: Ok(Identification {
            parameters,
            residuals: residuals(),
            samples: 6001,
            condition_number: 29.6,
            scaled_condition_number: 9.1,
            residual_std: 1.25,
        }),
        refusal_causes: Vec::new(),
        verification: verification(base),
        warming_contrast: Vec::new(),
        torque_noise: torque_noise(),
        friction_points: friction_points(start),
        factors: CycleFactors::default(),
        response: None,
        kind: RunKind::Test,
        production: None,
        remarks: vec!["velocity is derived".into(), "joint 4 starts late".into()],
        findings: Vec::new(),
    }
}

fn torque_noise() -> Vec<TorqueNoise> {
    let of_joint =
        |joint: JointIndex| TorqueNoise { joint, value: 0.25, relative: 0.01 * joint.number() as f64 };
    er3a().joint_indices().map(of_joint).collect()
}

fn residuals() -> Vec<JointResidual> {
    let residual = |joint: JointIndex| JointResidual {
        joint,
        std: 0.5 + f64::from(joint.number() as u8),
        independent_share: 0.3,
    };
    er3a().joint_indices().map(residual).collect()
}

fn verification(base: f64) -> Vec<TorqueRmsd> {
    let scopes = Stage::ANALYSED.map(RmsdScope::Stage).into_iter().chain([RmsdScope::WholeCycle]);
    er3a()
        .joint_indices()
        .flat_map(|joint| scopes.clone().map(move |scope| (joint, scope)))
        .zip(1..)
        .map(|((joint, scope), place)| TorqueRmsd {
            joint,
            scope,
            all_rows: Rmsd {
                value: base + f64::from(place),
                relative: 0.05 + f64::from(place) / 900.0,
                samples: 6001,
            },
            moving_rows: Rmsd {
                value: base,
                relative: 0.06 + f64::from(place) / 900.0 + base / 1e4,
                samples: 5000,
            },
        })
        .collect()
}

fn friction_points(start: f64) -> Vec<FrictionPoint> {
    let robot = er3a();
    let mut points = Vec::new();
    for joint in robot.joint_indices() {
        for &speed_fraction in &robot.speed_levels {
            for direction in [1, -1] {
                let place = points.len() as f64;
                points.push(FrictionPoint {
                    joint,
                    time: start + 30.0 + place / 3.0,
                    speed_fraction,
                    speed: 3.9 * speed_fraction,
                    direction,
                    torque: f64::from(direction) * (10.0 + place / 7.0),
                    std: 0.3,
                    samples: 200,
                    gravity: if joint.index() == 0 {
                        GravityRemoval::AxisVertical
                    } else {
                        GravityRemoval::Fitted
                    },
                    load: (joint.index() > 0).then_some(CarriedLoad { torque: 20.0 + place, friction: 0.05 }),
                });
            }
        }
    }
    points
}

/// A cycle without parameters.
pub(crate) fn refused_cycle(number: u32) -> CycleAnalysis {
    CycleAnalysis {
        identification: Err("joint 3 stands still".into()),
        verification: Vec::new(),
        remarks: Vec::new(),
        findings: Vec::new(),
        ..cycle(number)
    }
}

pub(crate) fn joint(number: usize) -> JointIndex {
    JointIndex::from_number(number).expect("a joint")
}

/// A fit of each shape, statistics of two parameters, a summary of each joint.
pub(crate) fn run_analysis(seed: f64) -> RunAnalysis {
    let statistics = [StatisticsWindow::All, StatisticsWindow::AfterFive].map(|window| ParameterStatistics {
        id: kept()[0],
        window,
        mean: seed,
        min: seed - 1.0,
        max: seed + 1.0,
        d_mm: Some(0.125),
        d_se: None,
        sdv: Some(0.5),
        cycles: 3,
    });
    RunAnalysis {
        warm_up_fits: fits(seed),
        statistics: statistics.to_vec(),
        summaries: er3a().joint_indices().map(|j| summary(j, seed)).collect(),
    }
}

pub(crate) fn fits(seed: f64) -> Vec<WarmUpFit> {
    let estimate = |value| Estimate { value, std_error: value / 16.0 };
    let slow = Decay { amplitude: estimate(8.0), time_constant: estimate(40.0) };
    let fast = Decay { amplitude: estimate(4.0), time_constant: estimate(5.0) };
    let shapes = [
        (WarmUpModel::Double, Some(slow), Some(fast)),
        (WarmUpModel::Single, Some(slow), None),
        (WarmUpModel::Constant, None, None),
    ];
    (1..)
        .zip(shapes)
        .map(|(number, (model, slow, fast))| WarmUpFit {
            joint: joint(number),
            speed_fraction: 0.6,
            model,
            a: estimate(seed),
            slow,
            fast,
            fast_shown: fast
                .map(|fast| FastShown { at_first: estimate(3.0), longest: 2.0 * fast.time_constant.value }),
            rmsd: 0.25,
            samples: 48,
            record: [1.0, 120.0],
        })
        .collect()
}

fn summary(joint: JointIndex, seed: f64) -> JointSummary {
    // Joint 6 is unknown in every respect, so that absence is stored and read too.
    let known = joint.number() < 6;
    JointSummary {
        joint,
        warm_friction: known.then_some(WarmFriction {
            torque: seed,
            std_error: 0.1,
            minute: 100.0,
            speed_fraction: 0.6,
        }),
        excitation_friction: known.then_some(WarmFriction {
            torque: 2.0 * seed,
            std_error: 0.2,
            minute: 90.0,
            speed_fraction: 0.5,
        }),
        half_speed_friction: known.then_some(Estimate { value: 1.5 * seed, std_error: 0.3 }),
        friction_index: None,
        relative_rmsd: known.then_some(0.05 + seed / 1000.0),
        rmsd_swing: known.then_some(RmsdSwing { value: 0.002, cycles: 24 }),
        relative_noise: known.then_some(0.01 + seed / 1e4),
        torque_rms: known.then_some(3.0 * seed),
    }
}

pub(crate) fn anomaly(joint: JointIndex, first_run_id: i64, severity: Severity) -> Anomaly {
    Anomaly {
        joint: Some(joint),
        kind: AnomalyKind::Drift,
        quantity: Quantity::WarmFriction,
        severity,
        score: 6.5,
        threshold: 5.0,
        value: 13.0,
        baseline: 10.0,
        peak_value: 14.0,
        peak_score: 7.0,
        peak_severity: severity,
        first_cycle: None,
        first_run_id,
        last_run_id: first_run_id,
        first_seen_at: day(0),
        last_seen_at: day(0),
        onset: Onset { run_id: first_run_id, cycle: None, at: day(0) },
        odds: None,
        alternatives: Vec::new(),
        ended: false,
        message: format!("joint {joint} needs more torque"),
    }
}

/// Findings with these anomalies; every joint has its baseline.
pub(crate) fn findings(anomalies: Vec<Anomaly>) -> Findings {
    let health = er3a().joint_indices().map(|joint| health(joint, Knowledge::Compared)).collect();
    Findings { anomalies, health, expected_by: None }
}

pub(crate) fn health(joint: JointIndex, knowledge: Knowledge) -> JointHealth {
    JointHealth {
        joint,
        friction_index: (knowledge == Knowledge::Compared).then_some(1.1),
        friction_quantity: None,
        knowledge,
        reason: None,
        last_result_run_id: None,
        forecast: None,
    }
}

/// Begins a run of `robot` and stores `cycles` cycles.
pub(crate) async fn streaming_run(store: &Store, robot: &str, days: i64, cycles: u32) -> i64 {
    let run_id = store.begin_run(&header(robot, days)).await.expect("a run").run_id;
    for number in 1..=cycles {
        assert!(store.record_cycle(run_id, &cycle(number), &er3a()).await.expect("a cycle"));
    }
    run_id
}

/// Ends a run with an analysis, and stores these conclusions.
pub(crate) async fn finish(store: &Store, run_id: i64, cycles: u32, findings: &Findings) {
    let mut end = store.finish_run(run_id).await.expect("a transaction");
    end.store_analysis(&run_analysis(run_id as f64)).await.expect("an analysis");
    end.complete(totals(cycles)).await.expect("completion");
    end.commit().await.expect("a commit");
    let robot = stale(store, run_id).await;
    let mut conclusion = store.conclude(robot.robot_id).await.expect("a transaction");
    conclusion.replace_mixed_fits(&fits(50.0)).await.expect("fits");
    conclusion.reconcile(findings, &[]).await.expect("findings");
    conclusion.commit(robot.history).await.expect("a commit");
}

/// The robot of a run that was completed just now.
pub(crate) async fn stale(store: &Store, run_id: i64) -> StaleRobot {
    let robot_id: i64 = sqlx::query_scalar("SELECT robot_id FROM run WHERE run_id = $1")
        .bind(run_id)
        .fetch_one(&store.readers)
        .await
        .expect("the run");
    let stale = store.stale_robots().await.expect("robots");
    stale.into_iter().find(|robot| robot.robot_id == robot_id).expect("its robot")
}

pub(crate) fn totals(cycles: u32) -> RunTotals {
    RunTotals { rows: 30_026 * cycles as usize, rows_skipped: 0, sample_rate: 100.0, cycles }
}

pub(crate) async fn columns(store: &Store, view: &str) -> Vec<String> {
    catalog::columns_of_view(&store.readers, view).await.expect("columns")
}

/// The public views of the schema, by name.
pub(crate) async fn views(store: &Store) -> Vec<String> {
    let mut views: Vec<String> =
        catalog::views(&store.readers).await.expect("views").into_iter().map(|(view, _)| view).collect();
    views.dedup();
    views
}

/// Columns with times of the machine's clock, which differ between tests.
const CLOCK: [(&str, &str); 6] = [
    ("quarantine", "first_at"),
    ("quarantine", "last_at"),
    ("quarantine", "retry_asked_at"),
    ("baseline_changes", "formed_at"),
    ("baseline_changes", "replaced_at"),
    ("anomaly_history", "at"),
];

/// Everything that users see except times of the machine's clock, one line per row; rows of a view are sorted.
pub(crate) async fn dump(store: &Store) -> Vec<String> {
    let mut lines = Vec::new();
    // the meaning of columns does not depend on the stored data
    for view in views(store).await.into_iter().filter(|view| view != "view_columns") {
        let columns = columns(store, &view).await;
        let compared = columns.iter().filter(|column| !CLOCK.contains(&(view.as_str(), column.as_str())));
        let quoted = |column: &String| match store.dialect() {
            Dialect::Sqlite => format!("quote(\"{column}\")"),
            Dialect::Postgres => format!("coalesce(quote_literal(\"{column}\"), 'NULL')"),
        };
        let cells: Vec<String> = compared.map(quoted).collect();
        let query = format!("SELECT {} FROM {view}", cells.join(" || ' ' || "));
        let mut rows: Vec<String> = sqlx::query_scalar(AssertSqlSafe(query))
            .fetch_all(&store.readers)
            .await
            .expect("a readable view");
        rows.sort_unstable();
        lines.extend(rows.into_iter().map(|row| format!("{view}: {row}")));
    }
    lines
}

/// One value.
pub(crate) async fn number(store: &Store, query: &'static str) -> Option<f64> {
    sqlx::query_scalar(AssertSqlSafe(format!("SELECT CAST(({query}) AS DOUBLE PRECISION)")))
        .fetch_one(&store.readers)
        .await
        .expect("a figure")
}

/// One text.
pub(crate) async fn text(store: &Store, query: &'static str) -> Option<String> {
    sqlx::query_scalar(query).fetch_one(&store.readers).await.expect("a text")
}

/// Checks that no reference is broken and nothing is damaged.
pub(crate) async fn assert_sound(store: &Store) {
    if store.dialect() == Dialect::Postgres {
        return;
    }
    let dangling = sqlx::query("PRAGMA foreign_key_check").fetch_all(&store.readers).await.expect("a check");
    assert!(dangling.is_empty(), "{} rows refer to nothing", dangling.len());
    let integrity = sqlx::query("PRAGMA integrity_check").fetch_one(&store.readers).await.expect("a check");
    assert_eq!(integrity.get::<String, _>(0), "ok");
}
