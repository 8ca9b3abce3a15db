//! The ledger and the results of cycles, with a real database.

mod anomalies;
mod windows;
mod factors;
mod plans;
mod retention;
mod copies;
mod series;
mod finish;
mod identity;
mod open;
pub(crate) mod upgrade;
mod unfinished_run;
mod reestimates;
mod verification;
pub(crate) mod support;

use self::support::*;
use super::error::StoreError;
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::interval::half_width;
use armwatch_model::robot::JointIndex;
use armwatch_model::run::{ContentHash, RunStatus};
use armwatch_testing::{change_dh, er3a};

#[tokio::test]
async fn views_have_the_promised_columns_in_order() {
    let promised: &[(&str, &str)] = &[
        ("runs", "run_id robot started_at source_name content_hash rows sample_rate_hz cycles status reason"),
        ("cycles", "run_id robot cycle started_at duration_s rows status reason"),
        ("cycle_parameters", "robot run_id cycle joint parameter value std_error unit"),
        (
            "cycle_rmsd",
            "robot run_id cycle joint stage verification reference_run_id rmsd_nm relative_rmsd moving_rmsd_nm \
             moving_relative_rmsd samples",
        ),
        (
            "friction_points",
            "robot run_id cycle minute joint speed_fraction speed_rad_s direction torque_nm std_nm samples",
        ),
        (
            "warmup_fits",
            "robot run_id joint speed_fraction model a_nm b_nm t1_min c_nm t2_min a_std_error_nm b_std_error_nm \
             t1_std_error_min c_std_error_nm t2_std_error_min rmsd_nm samples first_min last_min \
             a_extrapolated",
        ),
        (
            "friction_speed_fits",
            "robot run_id cycle joint direction model coefficient value std_error at_bound slowest_rad_s \
             fastest_rad_s rmsd_nm reduced_chi_square points asymmetry_nm asymmetry_std_error_nm",
        ),
        (
            "friction_map",
            "robot joint speed_fraction warm_nm warm_std_error_nm cold_nm cold_std_error_nm slow_min \
             slow_std_error_min fast_min fast_std_error_min slow_share slow_share_std_error cooling_ratio \
             cooling_ratio_std_error explained relative_rmsd runs points remarks",
        ),
        (
            "friction_index",
            "robot run_id started_at joint friction_index friction_index_std_error ambient_coldness \
             ambient_coldness_std_error coldness_at_start points raw_index short_run",
        ),
        ("parameter_statistics", "robot run_id joint parameter window mean min max d_mm d_se sdv"),
        (
            "anomalies",
            "anomaly_id robot run_id cycle joint kind quantity severity score threshold value baseline first_seen_at \
             last_seen_at state message",
        ),
        ("fleet_health", "robot joint last_run_at moving_relative_rmsd friction_index open_anomalies status"),
        (
            "warming_contrast",
            "robot run_id cycle joint start_rmsd_nm end_rmsd_nm start_relative_rmsd end_relative_rmsd \
             start_moving_rmsd_nm end_moving_rmsd_nm start_moving_relative_rmsd end_moving_relative_rmsd",
        ),
        (
            "parameter_sets",
            "parameter_set model joint parameter value std_error unit grouping cycles samples",
        ),
        ("parameter_set_sources", "parameter_set robot run_id cycle"),
        ("joint_residuals", "robot run_id cycle joint residual_std_nm independent_share"),
        ("torque_noise", "robot run_id cycle joint noise_nm relative_noise"),
    ];
    let (_folder, store) = fresh().await;
    for &(view, names) in promised {
        let names: Vec<&str> = names.split(' ').collect();
        let found = columns(&store, view).await;
        assert_eq!(found[..names.len()], names, "{view}");
    }
}

#[tokio::test]
async fn a_cycle_reads_back_as_it_was_given() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let read = store.run_measurements(run_id).await.expect("measurements");

    let given = [cycle(1), cycle(2)];
    let points: Vec<_> = given.iter().flat_map(|c| c.friction_points.iter().map(|p| (c.cycle, *p))).collect();
    assert_eq!(read.friction_points.iter().map(|p| (p.cycle, p.point)).collect::<Vec<_>>(), points);
    for (cycle, read) in given.iter().zip(&read.parameters) {
        let identification = cycle.identification.as_ref().expect("parameters");
        assert_eq!((read.cycle, &read.parameters), (cycle.cycle, &identification.parameters));
    }
    let excitation: Vec<_> = given
        .iter()
        .flat_map(|c| c.verification.iter().map(move |v| (c.cycle, v)))
        .filter(|(_, v)| v.scope.name() == "excitation")
        .map(|(cycle, v)| (cycle, v.joint, v.moving_rows.relative))
        .collect();
    let read: Vec<_> = read.relative_rmsd.iter().map(|r| (r.cycle, r.joint, r.relative_rmsd)).collect();
    assert_eq!(read, excitation);
    let noises = store.run_measurements(run_id).await.expect("measurements").torque_noise;
    let noises: Vec<_> = noises.iter().map(|n| (n.cycle, n.joint, n.relative_noise)).collect();
    let of_cycle =
        |c: &CycleAnalysis| c.torque_noise.iter().map(|n| (c.cycle, n.joint, n.relative)).collect::<Vec<_>>();
    assert_eq!(noises, given.iter().flat_map(of_cycle).collect::<Vec<_>>());
}

#[tokio::test]
async fn views_show_a_cycle_in_the_units_of_people() {
    let (_folder, store) = fresh().await;
    streaming_run(&store, "R00", 0, 2).await;
    let rows: Vec<String> = dump(&store).await;
    let of = |view: &str| rows.iter().filter(|r| r.starts_with(&format!("{view}:"))).count();
    assert_eq!((of("cycle_parameters"), of("cycle_rmsd"), of("friction_points")), (2 * 64, 2 * 24, 2 * 72));

    assert_eq!(
        text(&store, "SELECT started_at FROM runs").await.as_deref(),
        Some("2026-01-05T06:00:00.000Z")
    );
    let second = text(&store, "SELECT started_at FROM cycles WHERE cycle = 2").await;
    assert_eq!(second.as_deref(), Some("2026-01-05T06:05:00.500Z"));
    assert_eq!(
        text(&store, "SELECT content_hash FROM runs").await,
        Some(header("R00", 0).content_hash.to_string())
    );
    let unit = text(&store, "SELECT unit FROM cycle_parameters WHERE joint = 3 AND parameter = 'f2'").await;
    assert_eq!(unit.as_deref(), Some("Nm s/rad"));
    assert_eq!(text(&store, "SELECT DISTINCT estimator FROM cycles").await.as_deref(), Some("weighted"));
    let first = &cycle(1).identification.expect("parameters").parameters[0];
    let interval = "SELECT interval_high - interval_low FROM cycle_parameters WHERE cycle = 1 LIMIT 1";
    let width = number(&store, interval).await.expect("an interval");
    // the program computes the normal quantile to 4.5e-4
    assert!((width / (2.0 * half_width(first, 0.95)) - 1.0).abs() < 5e-4, "{width}");
    let relative = "SELECT max(abs(relative_std_error * value - std_error)) FROM cycle_parameters";
    assert!(number(&store, relative).await.expect("a figure") < 1e-12);
    assert_eq!(number(&store, "SELECT count(*) FROM joint_residuals").await, Some(12.0));
    assert_eq!(number(&store, "SELECT min(minute) FROM friction_points").await, Some(0.5));
    assert_eq!(number(&store, "SELECT min(joint) * 10 + max(joint) FROM friction_points").await, Some(16.0));
    let remarks = text(&store, "SELECT remarks FROM cycles WHERE cycle = 1").await;
    assert_eq!(remarks.as_deref(), Some("velocity is derived\njoint 4 starts late"));
}

#[tokio::test]
async fn recording_a_cycle_again_changes_nothing() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let before = dump(&store).await;
    let mut other = cycle(2);
    other.duration = 1.0;
    assert!(!store.record_cycle(run_id, &other, &er3a()).await.expect("no error"));
    assert_eq!(dump(&store).await, before);
    let known = store.lookup(&header("R00", 0).content_hash).await.expect("an answer").expect("the run");
    assert_eq!((known.cycles_stored, known.status), (2, RunStatus::Streaming));
}

#[tokio::test]
async fn a_refused_cycle_keeps_its_reason_and_its_friction() {
    let (_folder, store) = fresh().await;
    let run_id = store.begin_run(&header("R00", 0)).await.expect("a run").run_id;
    assert!(store.record_cycle(run_id, &refused_cycle(1), &er3a()).await.expect("a cycle"));
    assert_eq!(
        text(&store, "SELECT status || ': ' || reason FROM cycles").await.as_deref(),
        Some("refused: joint 3 stands still")
    );
    let read = store.run_measurements(run_id).await.expect("measurements");
    assert_eq!((read.parameters.len(), read.friction_points.len()), (0, 72));
}

#[tokio::test]
async fn figures_that_are_not_finite_are_null_and_values_may_not_be() {
    let (_folder, store) = fresh().await;
    let run_id = store.begin_run(&header("R00", 0)).await.expect("a run").run_id;
    let mut analysis = cycle(1);
    let identification = analysis.identification.as_mut().expect("parameters");
    identification.condition_number = f64::INFINITY;
    identification.parameters[0].std_error = f64::NAN;
    analysis.verification[0].moving_rows.samples = 0;
    assert!(store.record_cycle(run_id, &analysis, &er3a()).await.expect("a cycle"));
    for query in [
        "SELECT count(*) FROM cycles WHERE condition_number IS NULL",
        "SELECT count(*) FROM cycle_rmsd WHERE moving_rmsd_nm IS NULL AND moving_relative_rmsd IS NULL",
    ] {
        assert_eq!(number(&store, query).await, Some(1.0), "{query}");
    }
    // a parameter without an error is one that the motion does not show
    let stored = cycle(1).identification.expect("parameters").parameters.len() - 1;
    assert_eq!(number(&store, "SELECT count(*) FROM cycle_parameters").await, Some(stored as f64));

    let before = dump(&store).await;
    let mut analysis = cycle(2);
    analysis.friction_points[71].torque = f64::NAN;
    let error = store.record_cycle(run_id, &analysis, &er3a()).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Refused { .. }) && !error.is_fatal(), "{error}");
    assert_eq!(dump(&store).await, before, "half a cycle was stored");
    assert!(store.record_cycle(run_id, &cycle(2), &er3a()).await.expect("the store still works"));
}

#[tokio::test]
async fn a_parameter_of_no_joint_is_refused() {
    let (_folder, store) = fresh().await;
    let run_id = store.begin_run(&header("R00", 0)).await.expect("a run").run_id;
    let mut analysis = cycle(1);
    analysis.identification.as_mut().expect("parameters").parameters[0].id.joint = JointIndex::new(6);
    let error = store.record_cycle(run_id, &analysis, &er3a()).await.expect_err("a refusal");
    assert!(matches!(error, StoreError::Refused { .. }) && error.to_string().contains("6 joints"), "{error}");
}

#[tokio::test]
async fn a_run_begun_before_goes_on_where_it_stood() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.lookup(&ContentHash([7; 32])).await.expect("an answer"), None);
    let run_id = streaming_run(&store, "R00", 0, 3).await;
    let again = store.begin_run(&header("R00", 0)).await.expect("the run");
    assert_eq!((again.run_id, again.cycles_stored, again.status), (run_id, 3, RunStatus::Streaming));
    // The same bytes under another name are the same run.
    let mut renamed = header("R00", 0);
    renamed.source_name = "copy.csv".into();
    assert_eq!(store.begin_run(&renamed).await.expect("the run").run_id, run_id);
    assert_eq!(store.runs().await.expect("runs").len(), 1);
}

#[tokio::test]
async fn quarantine_says_why_and_where_and_keeps_cycles() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    let same = store.quarantine(&header("R00", 0), &fault("not a number", Some((60_123, "trq_3")))).await;
    assert_eq!(same.expect("the run"), run_id);
    let row = &store.runs().await.expect("runs")[0];
    assert_eq!(
        (row.status, row.cycles, row.reason.as_deref()),
        (RunStatus::Quarantined, 2, Some("not a number"))
    );
    assert_eq!((row.reason_line, row.reason_column.as_deref()), (Some(60_123), Some("trq_3")));
    let error = store.record_cycle(run_id, &cycle(3), &er3a()).await.expect_err("a closed run");
    assert!(matches!(error, StoreError::RunNotOpen { .. }) && !error.is_fatal(), "{error}");
    assert!(matches!(store.finish_run(run_id).await, Err(StoreError::RunNotOpen { .. })));

    // The layout was corrected: the export is read from its beginning.
    let again = store.begin_run(&header("R01", 0)).await.expect("a run");
    assert_ne!(again.run_id, run_id, "another export");
    let again = store.begin_run(&header("R00", 0)).await.expect("the run");
    assert_eq!((again.run_id, again.cycles_stored, again.reason), (run_id, 0, None));
    assert_eq!(number(&store, "SELECT count(*) FROM friction_points").await, Some(0.0));
    assert!(store.record_cycle(run_id, &cycle(1), &er3a()).await.expect("a cycle"));
    assert_sound(&store).await;
}

#[tokio::test]
async fn an_export_of_an_unknown_robot_is_in_the_ledger_and_not_in_the_fleet() {
    let (_folder, store) = fresh().await;
    store.quarantine(&header("unknown", 0), &fault("no robot has this name", None)).await.expect("a run");
    let known = store.lookup(&header("unknown", 0).content_hash).await.expect("an answer").expect("the run");
    assert_eq!(
        (known.status, known.reason.as_deref()),
        (RunStatus::Quarantined, Some("no robot has this name"))
    );
    assert_eq!(store.fleet_health().await.expect("health"), []);
}

#[tokio::test]
async fn a_complete_run_cannot_be_quarantined_or_discarded() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    finish(&store, run_id, 1, &findings(vec![])).await;
    let before = dump(&store).await;
    assert_eq!(store.quarantine(&header("R00", 0), &fault("late", None)).await.expect("the run"), run_id);
    assert!(!store.discard_run(run_id).await.expect("an answer"));
    assert_eq!(store.begin_run(&header("R00", 0)).await.expect("the run").status, RunStatus::Complete);
    assert_eq!(dump(&store).await, before);
}

#[tokio::test]
async fn a_discarded_run_leaves_nothing_and_its_number_is_not_used_again() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 2).await;
    assert!(store.discard_run(run_id).await.expect("an answer"));
    assert!(!store.discard_run(run_id).await.expect("an answer"));
    assert_eq!(dump(&store).await, Vec::<String>::new());
    for table in ["cycle", "cycle_parameter", "torque_rmsd", "friction_point"] {
        let query = sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}"));
        let left: i64 = sqlx::query_scalar(query).fetch_one(&store.readers).await.expect("a count");
        assert_eq!(left, 0, "{table}");
    }
    assert!(store.begin_run(&header("R00", 0)).await.expect("a run").run_id > run_id);
    assert_sound(&store).await;
}

#[tokio::test]
async fn groupings_belong_to_a_description() {
    let (_folder, store) = fresh().await;
    let grouping = vec![(kept()[0], "Izz1 + Iyy2 + I_m1".to_owned())];
    store.describe_model(&er3a(), &grouping).await.expect("a description");
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let shown = "SELECT grouping FROM cycle_parameters WHERE joint = 1 AND parameter = 'Izz' AND cycle = 1";
    assert_eq!(text(&store, shown).await.as_deref(), Some("Izz1 + Iyy2 + I_m1"));

    // Limits do not determine the meaning of a parameter; geometry does.
    let models = "SELECT count(*) FROM robot_model";
    let mut slower = er3a();
    slower.joints[0].limits.velocity /= 2.0;
    store.record_cycle(run_id, &cycle(2), &slower).await.expect("a cycle");
    assert_eq!(number(&store, models).await, Some(1.0));
    let mut longer = er3a();
    change_dh(&mut longer, 2, |row| row.a += 1e-9);
    store.record_cycle(run_id, &cycle(3), &longer).await.expect("a cycle");
    assert_eq!(number(&store, models).await, Some(2.0));
    assert_eq!(
        number(&store, "SELECT count(grouping) FROM cycle_parameters WHERE cycle = 3").await,
        Some(0.0)
    );
}

/// Results need a small part of a percent of the exports' size.
#[tokio::test]
async fn results_stay_compact() {
    // Measured: 9.3 kB over 3600 cycles, and later 0.7 kB of degrees of freedom and residuals. The rest is for pages
    // that are not full.
    const BYTES_PER_CYCLE: u64 = 10_800;
    let (folder, store) = fresh_file().await;
    let run_id = streaming_run(&store, "R00", 0, 48).await;
    finish(&store, run_id, 48, &findings(vec![])).await;
    let path = folder.path().join("fleet.db");
    // Every table and index needs a page before its first row; their text and that of the migrations need some more.
    let trees = number(&store, "SELECT count(*) + 0.0 FROM sqlite_schema WHERE rootpage > 0").await;
    let text = number(&store, "SELECT sum(length(sql)) + 0.0 FROM sqlite_schema").await;
    // so do the texts about columns, which are the same in every database
    let described = number(
        &store,
        "SELECT sum(2 * length(view_name) + length(column_name) + length(meaning) + \
         coalesce(length(unit) + length(null_when), 0) + 40.0) FROM view_column",
    );
    let texts = text.expect("a length") + described.await.expect("a length");
    let pages_of_schema = (trees.expect("a count") * 4096.0 + 1.5 * texts) as u64;
    store.close().await.expect("closed");
    let bytes = std::fs::metadata(path).expect("a file").len();
    assert!(bytes < pages_of_schema + 48 * BYTES_PER_CYCLE, "{bytes} bytes for 48 cycles");
}

#[tokio::test]
async fn a_fault_found_again_is_counted_and_another_one_is_kept_beside_it() {
    let (_folder, store) = fresh().await;
    let run_id = store.begin_run(&header("R00", 0)).await.expect("a run").run_id;
    for problem in ["one", "one", "another"] {
        store.quarantine(&header("R00", 0), &fault(problem, Some((3, "trq_3")))).await.expect("the run");
    }
    let faults = store.faults().await.expect("faults");
    let told: Vec<_> = faults.iter().map(|f| (f.problem.as_str(), f.tries, f.state.name())).collect();
    assert_eq!(told, [("another", 1, "open"), ("one", 2, "earlier")]);
    assert_eq!(store.paths_to_retry().await.expect("paths"), [""; 0].map(std::path::PathBuf::from));

    assert!(store.ask_retry(run_id).await.expect("asked"));
    assert_eq!(store.paths_to_retry().await.expect("paths").len(), 1);
    assert!(store.known_run(run_id).await.expect("a look").expect("a run").retry_asked);
    store.quarantine(&header("R00", 0), &fault("another", Some((3, "trq_3")))).await.expect("the run");
    assert!(store.paths_to_retry().await.expect("paths").is_empty(), "the try was made");
    assert!(!store.ask_retry(run_id + 1).await.expect("asked"), "there is no such run");
    assert!(store.known_run(run_id + 1).await.expect("a look").is_none());
}
