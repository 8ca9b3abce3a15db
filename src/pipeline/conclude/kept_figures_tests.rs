//! Findings from stored summaries and kept evaluations equal those from the tables, after any change.

use std::path::Path;

use super::method::METHOD;
use super::test_database::{Database, assert_sound, change, count, fresh};
use super::windows::{WindowFindings, judge_tests};
use armwatch_method::detect::runs::detect_among;
use armwatch_method::detect::window::Lengths;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{AnomalyKind, Findings};

/// Findings as text, for comparison: NaN equals nothing.
fn said(findings: &Findings) -> Vec<String> {
    let anomalies = findings.anomalies.iter().map(|of| format!("{of:?}"));
    let health = findings.health.iter().map(|of| format!("{of:?}"));
    anomalies.chain(health).chain([format!("{:?}", findings.expected_by)]).collect()
}

async fn from_kept(store: &Database) -> WindowFindings {
    let settings = DetectSettings::default();
    judge_tests(store, 1, None, &[], &settings, &Lengths::OF_TESTS).await.expect("findings")
}

async fn from_tables(store: &Database) -> Findings {
    let tests = store.run_summaries(1).await.expect("summaries");
    assert_eq!(
        format!("{:?}", store.latest_window(1, METHOD).await.expect("a window")),
        format!("{tests:?}")
    );
    detect_among(&tests, &[], &DetectSettings::default())
}

#[tokio::test]
async fn findings_from_kept_figures_are_those_of_the_tables_whatever_changes() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 2, runs: 40, cycles: 7, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let first = from_kept(&store).await;
    assert_eq!(said(&first.findings), said(&from_tables(&store).await));
    assert_eq!(first.recomputed, 40, "nothing was kept");
    assert_eq!(from_kept(&store).await.recomputed, 0);
    // tests of the robot have odd keys, its latest is 79; cycles and their rows change together, as the program writes
    // them
    let day = 86_400_000_000_i64;
    let with_cycles = |change: &str, runs: &str| {
        format!("{change}; UPDATE cycle SET estimator = estimator WHERE run_id {runs}")
    };
    let changes = [
        (
            "a step in a test",
            with_cycles(
                "UPDATE cycle_friction_level SET ln_torque = ln_torque + 0.3 WHERE joint = 2
                 AND cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 41 AND number > 4)",
                "= 41",
            ),
        ),
        ("a test of the baseline goes", "DELETE FROM run WHERE run_id = 3".to_owned()),
        (
            "one comes late",
            format!("UPDATE run SET started_at = started_at - {} WHERE run_id = 75", 30 * day),
        ),
        (
            "other parameters",
            with_cycles("UPDATE parameter_statistic SET mean = mean * 1.05 WHERE run_id > 60", "> 60"),
        ),
        (
            "a push",
            with_cycles(
                "UPDATE torque_rmsd SET moving_relative_rmsd = 0.2 WHERE stage = 'all' AND joint = 4
                 AND cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 77 AND number = 4)",
                "= 77",
            ),
        ),
        ("another estimator", "UPDATE run_joint_summary SET estimator = 'ordinary' WHERE run_id > 70".into()),
        (
            "work on a joint",
            format!(
                "INSERT INTO maintenance (robot_id, joint, at, what)
                 SELECT 1, 2, started_at - {day} / 2, 'new gear' FROM run WHERE run_id = 31"
            ),
        ),
        (
            "another description",
            "UPDATE run SET figures_hash = CAST(printf('%032d', 7) AS BLOB) WHERE run_id > 55".into(),
        ),
        ("a test is read on", "UPDATE run SET status = 'streaming' WHERE run_id = 11".into()),
        (
            "friction of all joints",
            "UPDATE run_friction_index SET friction_index = friction_index * 1.3 WHERE run_id > 73;
             DELETE FROM run_friction WHERE run_id > 73; INSERT INTO run_friction (run_id) SELECT run_id FROM run WHERE run_id > 73"
                .into(),
        ),
    ];
    let mut kinds = Vec::new();
    for (place, (what, statement)) in changes.into_iter().enumerate() {
        assert!(change(&store, &statement).await > 0, "{what}");
        let found = from_kept(&store).await;
        let expected = from_tables(&store).await;
        assert_eq!(said(&found.findings), said(&expected), "{what}");
        // the changed test, and the seven after it, whose parameters are evaluated together with its own
        assert!(place > 0 || found.recomputed == 8, "{what}: {} tests were judged again", found.recomputed);
        kinds.extend(expected.anomalies.iter().map(|of| of.kind));
        assert_eq!(said(&from_kept(&store).await.findings), said(&expected), "{what}, once more");
    }
    for kind in [AnomalyKind::Step, AnomalyKind::Accuracy] {
        assert!(kinds.contains(&kind), "{kinds:?}");
    }
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_summary_of_an_older_revision_or_method_is_made_again_and_none_is_deleted() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs: 6, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    from_kept(&store).await;
    let held =
        "SELECT count(*) FROM run_summary JOIN run USING (run_id) WHERE run_summary.revision = run.revision";
    for statement in [
        "UPDATE cycle SET doubtful = TRUE WHERE cycle_id = 3",
        "UPDATE run_joint_summary SET relative_rmsd = 0.9 WHERE run_id = 3 AND joint = 1",
        "UPDATE run SET cycles_stored = cycles_stored WHERE run_id = 4",
        "INSERT OR REPLACE INTO parameter_statistic SELECT * FROM parameter_statistic WHERE run_id = 5 LIMIT 1",
    ] {
        change(&store, statement).await;
        assert_eq!(count(&store, held).await, 5, "{statement}");
        assert_eq!(count(&store, "SELECT count(*) FROM run_summary").await, 6, "{statement}");
        from_kept(&store).await;
        assert_eq!(count(&store, held).await, 6, "{statement}");
    }
    change(&store, "UPDATE run_summary SET method = 7, numbers = x'01', judgements = x'01'").await;
    assert_eq!(from_kept(&store).await.recomputed, 6);
    assert_eq!(count(&store, "SELECT count(*) FROM run_summary WHERE method = 7").await, 0);
}
