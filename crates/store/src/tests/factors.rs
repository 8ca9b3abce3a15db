//! Factors, unit parameters and cross-verification in the database.

use std::sync::Arc;

use super::support::*;
use crate::kept::parameter_sets::{ParameterSet, SourceCycle};
use crate::results::factors::FactorsWanted;
use armwatch_model::analysis::estimator_kind::{ErrorSource, EstimatorKind};
use armwatch_model::analysis::{
    CycleAnalysis, CycleFactors, Motion, Rmsd, RmsdPair, RmsdScope, TorqueFactor, TorqueRmsd, WarmingContrast,
};
use armwatch_model::run::Stage;
use armwatch_testing::er3a;

/// Two joints with one parameter each, moving and slow; numbers that a text would round.
pub(crate) fn with_factors(number: u32) -> CycleAnalysis {
    let columns = Arc::from(vec![kept()[..1].to_vec(), kept()[1..3].to_vec()]);
    let third = 1.0 / 3.0 + f64::from(number);
    let factor = |joint_number, stage, motion, upper| TorqueFactor {
        joint: joint(joint_number),
        stage,
        motion,
        rows: 4000,
        upper,
    };
    let factors = vec![
        factor(1, Stage::Between, Motion::Slow, vec![third, -0.0, f64::MIN_POSITIVE]),
        factor(1, Stage::Excitation, Motion::Moving, vec![third, 1e300, -third]),
        factor(2, Stage::Excitation, Motion::Moving, vec![third; 6]),
        factor(2, Stage::Excitation, Motion::Slow, vec![-third; 6]),
    ];
    let rmsd = |value| Rmsd { value, relative: value / 10.0, samples: 100 };
    let pair = |value| RmsdPair { all_rows: rmsd(value), moving_rows: Rmsd::default() };
    CycleAnalysis {
        factors: CycleFactors { columns, factors },
        warming_contrast: vec![WarmingContrast { joint: joint(2), start: pair(2.5), end: pair(2.0) }],
        ..cycle(number)
    }
}

#[tokio::test]
async fn factors_come_back_bit_by_bit_with_their_columns() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 0).await;
    for number in [1, 2] {
        assert!(store.record_cycle(run_id, &with_factors(number), &er3a()).await.expect("a cycle"));
    }
    let all = store.factors_of_run(run_id, FactorsWanted::All).await.expect("factors");
    for (cycle, number) in all.iter().zip([1, 2]) {
        assert_eq!((cycle.cycle, cycle.robot.as_str(), cycle.model.name.as_str()), (number, "R00", "er3a"));
        assert_eq!(cycle.factors, with_factors(number).factors);
        assert_eq!((cycle.cutoff, cycle.sample_rate), (12.5, 100.0));
    }
    let some = store.factors_of_run(run_id, FactorsWanted::Identification).await.expect("factors");
    assert!(some.iter().all(|cycle| cycle.factors.factors.len() == 2));
    assert_eq!(number(&store, "SELECT count(*) FROM factor_layout").await, Some(1.0));
    assert_eq!(number(&store, "SELECT end_rmsd_nm FROM warming_contrast WHERE cycle = 1").await, Some(2.0));
    assert_eq!(number(&store, "SELECT max(end_moving_rmsd_nm) FROM warming_contrast").await, None);
    assert_sound(&store).await;
}

#[tokio::test]
async fn factors_go_with_their_run() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 0).await;
    store.record_cycle(run_id, &with_factors(1), &er3a()).await.expect("a cycle");
    assert!(store.discard_run(run_id).await.expect("discarded"));
    for table in ["torque_factor", "cycle_factor_layout", "warming_rmsd"] {
        let rows: i64 = sqlx::query_scalar(sqlx::AssertSqlSafe(format!("SELECT count(*) FROM {table}")))
            .fetch_one(&store.readers)
            .await
            .expect("a count");
        assert_eq!(rows, 0, "{table}");
    }
}

#[tokio::test]
async fn another_description_is_another_model() {
    let (_folder, store) = fresh().await;
    let mut hung = er3a();
    hung.gravity = -hung.gravity;
    let mut models = Vec::new();
    for (day, robot) in [er3a(), hung].iter().enumerate() {
        let run_id = streaming_run(&store, "R00", i64::try_from(day).expect("small"), 0).await;
        store.record_cycle(run_id, &with_factors(1), robot).await.expect("a cycle");
        let read = store.factors_of_run(run_id, FactorsWanted::All).await.expect("factors");
        models.push(read[0].model.clone());
    }
    assert_ne!(models[0], models[1]);
}

#[tokio::test]
async fn a_saved_set_keeps_its_name_and_outlives_its_run() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 0).await;
    store.record_cycle(run_id, &with_factors(1), &er3a()).await.expect("a cycle");
    let read = store.factors_of_run(run_id, FactorsWanted::All).await.expect("factors");
    let mut identification = cycle(1).identification.expect("parameters");
    identification.parameters.sort_by_key(|parameter| parameter.id);
    // residuals of cycles are stored with the cycles
    identification.residuals.clear();
    let set = ParameterSet {
        model: read[0].model.clone(),
        identification,
        sources: vec![SourceCycle { run_id, cycle: 1, robot: "R00".into() }],
        estimator: EstimatorKind::Weighted,
        errors: ErrorSource::Cycles,
    };
    assert!(store.save_parameter_set("warm", &set).await.expect("saved"));
    assert!(!store.save_parameter_set("warm", &set).await.expect("known"));
    store.discard_run(run_id).await.expect("discarded");
    let mut found = store.parameter_set("warm").await.expect("read").expect("there");
    found.identification.parameters.sort_by_key(|parameter| parameter.id);
    assert_eq!(found, set);
    assert_eq!(store.parameter_set("cold").await.expect("read"), None);
    assert_eq!(number(&store, "SELECT count(*) FROM parameter_sets").await, Some(64.0));
}

#[tokio::test]
async fn cross_verification_is_replaced_and_leaves_self_verification() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 1).await;
    let reference = streaming_run(&store, "R00", 1, 1).await;
    let rmsd = |value| TorqueRmsd {
        joint: joint(1),
        scope: RmsdScope::WholeCycle,
        all_rows: Rmsd { value, relative: 0.5, samples: 10 },
        moving_rows: Rmsd::default(),
    };
    for value in [7.0, 8.0] {
        let by_cycle = [(1, vec![rmsd(value)])];
        store
            .store_cross_verification(
                run_id,
                reference,
                armwatch_model::analysis::Estimator::Weighted,
                &by_cycle,
            )
            .await
            .expect("stored");
    }
    let of = |verification| match verification {
        "cross" => {
            "SELECT sum(rmsd_nm) FROM cycle_rmsd WHERE verification = 'cross' AND reference_run_id = 2"
        }
        _ => "SELECT count(*) FROM cycle_rmsd WHERE verification = 'self' AND run_id = 1",
    };
    assert_eq!(number(&store, of("cross")).await, Some(8.0));
    assert_eq!(number(&store, of("self")).await, Some(24.0));
}
