//! What is known of tests in brief, and what was found in their cycles, says what the cycles say, whatever changes.

use std::path::Path;

use super::in_brief::{Detected, detected};
use super::test_database::{Database, assert_sound, change, fresh};
use armwatch_method::detect::runs::detect_among;
use armwatch_model::anomaly::brief::{Brief, brief};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::settled::Settled;
use armwatch_model::anomaly::{AnomalyKind, Findings};

/// Values that are no numbers equal nothing, so that findings are compared as text.
fn said(findings: &Findings) -> Vec<String> {
    let anomalies = findings.anomalies.iter().map(|of| format!("{of:?}"));
    let health = findings.health.iter().map(|of| format!("{of:?}"));
    anomalies.chain(health).chain([format!("{:?}", findings.expected_by)]).collect()
}

async fn in_brief(store: &Database) -> Detected {
    let mut conclusion = store.conclude(1).await.expect("a transaction");
    let history = conclusion.history().await.expect("a history");
    let mut tests = conclusion.window(&Settled::default(), usize::MAX).await.expect("tests in brief");
    assert!(tests.iter().all(|test| test.is_brief && test.cycle_friction.is_empty()));
    let settings = DetectSettings::default();
    let found = detected(&mut conclusion, &mut tests, &[], &settings).await.expect("findings");
    conclusion.commit(history).await.expect("a commit");
    found
}

async fn of_all_cycles(store: &Database) -> Findings {
    let tests = store.run_summaries(1).await.expect("summaries");
    // what readers see in brief is of the same cycles
    let mut briefs = store.latest_window(1).await.expect("briefs");
    for (test, of) in tests.iter().zip(&mut briefs) {
        let stored = of.brief.take().expect("a brief");
        assert_eq!(Brief { judgements: Vec::new(), ..(*stored).clone() }, brief(test));
        assert_eq!((of.run_id, &of.joints, &of.epochs), (test.run_id, &test.joints, &test.epochs));
    }
    detect_among(&tests, &[], &DetectSettings::default())
}

#[tokio::test]
async fn findings_in_brief_are_those_of_all_cycles_whatever_changes() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 2, runs: 40, cycles: 7, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let first = in_brief(&store).await;
    assert_eq!(said(&first.findings), said(&of_all_cycles(&store).await));
    assert_eq!(first.read, 40, "nothing was kept");
    assert_eq!(in_brief(&store).await.read, 5, "those of the baseline");
    // tests of the robot have odd keys, its latest is 79
    let day = 86_400_000_000_i64;
    let changes = [
        (
            "a step in a test",
            "UPDATE cycle_friction_level SET ln_torque = ln_torque + 0.3 WHERE joint = 2
             AND cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 41 AND number > 4)"
                .to_owned(),
        ),
        ("a test of the baseline goes", "DELETE FROM run WHERE run_id = 3".into()),
        (
            "one comes late",
            format!("UPDATE run SET started_at = started_at - {} WHERE run_id = 75", 30 * day),
        ),
        ("other parameters", "UPDATE parameter_statistic SET mean = mean * 1.05 WHERE run_id > 60".into()),
        (
            "a push",
            "UPDATE torque_rmsd SET moving_relative_rmsd = 0.2 WHERE stage = 'all' AND joint = 4
             AND cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = 77 AND number = 4)"
                .into(),
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
            "UPDATE run_friction_index SET friction_index = friction_index * 1.3
             WHERE run_id > 73"
                .into(),
        ),
    ];
    let mut kinds = Vec::new();
    for (place, (what, statement)) in changes.into_iter().enumerate() {
        assert!(change(&store, &statement).await > 0, "{what}");
        let found = in_brief(&store).await;
        let expected = of_all_cycles(&store).await;
        assert_eq!(said(&found.findings), said(&expected), "{what}");
        // the eight tests whose parameters are looked at with those of the changed one, the seven before it, the baseline
        assert!(place > 0 || found.read == 20, "{what}: {} tests were read", found.read);
        kinds.extend(expected.anomalies.iter().map(|of| of.kind));
        // what was kept says the same once more
        assert_eq!(said(&in_brief(&store).await.findings), said(&expected), "{what}");
    }
    for kind in [AnomalyKind::Step, AnomalyKind::Accuracy] {
        assert!(kinds.contains(&kind), "{kinds:?}");
    }
    assert_sound(&store).await;
}

#[tokio::test]
async fn what_is_known_in_brief_goes_with_the_series() {
    let (_folder, store) = fresh().await;
    let size = armwatch_store::SyntheticSize { robots: 1, runs: 6, cycles: 2, logs: 0 };
    store.fill_synthetic(size, Path::new("/inbox")).await.expect("a history");
    let count = || sqlx::query_scalar::<_, i64>("SELECT count(*) FROM run_brief").fetch_one(&store.rows);
    in_brief(&store).await;
    assert_eq!(count().await.expect("a count"), 6);
    for (statement, left) in [
        ("UPDATE cycle SET doubtful = 1 WHERE cycle_id = 3", 5),
        ("UPDATE run_joint_summary SET relative_rmsd = 0.9 WHERE run_id = 3 AND joint = 1", 4),
        ("DELETE FROM run WHERE run_id = 6", 3),
    ] {
        change(&store, statement).await;
        assert_eq!(count().await.expect("a count"), left, "{statement}");
    }
}
