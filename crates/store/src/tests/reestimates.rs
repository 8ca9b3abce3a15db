//! Re-estimates of histories, and the names of kept estimates.

use super::support::*;
use crate::handle::Store;
use crate::kept::parameter_sets::{ParameterSet, SourceCycle};
use crate::kept::reestimates::{CycleView, KeptKind, Reestimate, ReestimatedCycle, ReestimatedStatistics};
use crate::models::StoredModel;
use crate::results::factors::FactorsWanted;
use armwatch_model::analysis::estimator_kind::{ErrorSource, EstimatorKind};
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_testing::er3a;

async fn model(store: &Store) -> StoredModel {
    let run_id = streaming_run(store, "R00", 0, 0).await;
    let analysis = super::factors::with_factors(1);
    store.record_cycle(run_id, &analysis, &er3a()).await.expect("a cycle");
    store.factors_of_run(run_id, FactorsWanted::All).await.expect("factors")[0].model.clone()
}

fn source(cycle: u32) -> SourceCycle {
    SourceCycle { run_id: 1, cycle, robot: "R00".into() }
}

fn view(seen_by: Option<JointIndex>, count: usize) -> CycleView {
    let mut identification = cycle(1).identification.expect("parameters");
    identification.parameters.truncate(count);
    CycleView { seen_by, half_width: vec![0.5; count], data_share: None, identification }
}

fn by_joint(model: StoredModel) -> Reestimate {
    let views = vec![view(Some(joint(1)), 64), view(Some(joint(2)), 3)];
    let statistics = run_analysis(2.0).statistics.into_iter().map(|statistics| ReestimatedStatistics {
        robot: "R00".into(),
        run_id: 1,
        seen_by: Some(joint(2)),
        statistics,
    });
    Reestimate {
        model,
        estimator: EstimatorKind::PerJoint,
        cycles: vec![
            ReestimatedCycle { source: source(1), views, reason: None },
            ReestimatedCycle { source: source(2), views: Vec::new(), reason: Some("too poor".into()) },
        ],
        statistics: statistics.collect(),
    }
}

#[tokio::test]
async fn a_history_is_kept_with_its_reasons_and_deleted_whole() {
    let (_folder, store) = fresh().await;
    let found = by_joint(model(&store).await);
    assert!(store.save_reestimate("again", &found).await.expect("saved"));
    assert!(!store.save_reestimate("again", &found).await.expect("known"));
    for (sql, expected) in [
        ("SELECT count(*) FROM reestimated_parameters WHERE seen_by_joint = 1", 64.0),
        ("SELECT count(*) FROM reestimated_parameters WHERE seen_by_joint = 2", 3.0),
        ("SELECT max(interval_high - interval_low) FROM reestimated_parameters", 1.0),
        ("SELECT count(*) FROM reestimated_cycles WHERE cycle = 2 AND reason = 'too poor'", 1.0),
        ("SELECT count(*) FROM reestimated_statistics WHERE \"window\" = 'after_5' AND mean = 2.0", 1.0),
    ] {
        assert_eq!(number(&store, sql).await, Some(expected), "{sql}");
    }
    assert!(store.delete_estimate("again").await.expect("deleted"));
    assert!(!store.delete_estimate("again").await.expect("nothing"));
    let left = "SELECT (SELECT count(*) FROM reestimate_value) + (SELECT count(*) FROM reestimate_view)
                     + (SELECT count(*) FROM reestimate_statistic) + 0.0";
    assert_eq!(number(&store, left).await, Some(0.0));
    assert_sound(&store).await;
}

#[tokio::test]
async fn one_name_means_one_thing_and_is_listed() {
    let (_folder, store) = fresh().await;
    let model = model(&store).await;
    let set = ParameterSet {
        model: model.clone(),
        identification: cycle(1).identification.expect("parameters"),
        sources: vec![source(1), source(2)],
        estimator: EstimatorKind::Huber,
        errors: ErrorSource::IndependentRows,
    };
    assert!(store.save_parameter_set("warm", &set).await.expect("saved"));
    let found = by_joint(model);
    assert!(!store.save_reestimate("warm", &found).await.expect("taken"));
    assert!(store.save_reestimate("again", &found).await.expect("saved"));
    assert!(!store.save_parameter_set("again", &set).await.expect("taken"));
    let kept = store.kept_estimates().await.expect("a list");
    let shown: Vec<_> = kept.iter().map(|of| (of.name.as_str(), of.kind, of.estimator, of.cycles)).collect();
    assert_eq!(
        shown,
        [
            ("again", KeptKind::EachCycle, EstimatorKind::PerJoint, 2),
            ("warm", KeptKind::Set, EstimatorKind::Huber, 2)
        ]
    );
    assert!(kept.iter().all(|of| of.robots == "R00" && of.model == "er3a"));
    assert!(store.delete_estimate("warm").await.expect("deleted"));
    assert_eq!(store.parameter_set("warm").await.expect("read"), None);
    assert_eq!(store.kept_estimates().await.expect("a list").len(), 1);
}

#[tokio::test]
async fn a_model_knows_its_description_units_and_groupings() {
    let (_folder, store) = fresh().await;
    let model = model(&store).await;
    let mut hung: Robot = er3a();
    assert!(model.describes(&hung));
    hung.gravity = -hung.gravity;
    assert!(!model.describes(&hung));
    store.describe_model(&er3a(), &[(kept()[0], "J1_Izz + J2_Iyy".into())]).await.expect("described");
    let parameters = store.model_parameters(&model).await.expect("parameters");
    assert_eq!(parameters.len(), 64);
    let first = &parameters[&kept()[0]];
    assert_eq!((first.unit.as_str(), first.grouping.as_deref()), ("kg m^2", Some("J1_Izz + J2_Iyy")));
}
