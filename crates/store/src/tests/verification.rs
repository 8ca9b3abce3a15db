//! Self-verification, states of cycles and paths of exports, read back.

use jiff::Timestamp;

use super::support::*;
use crate::ledger::sources::SourceState;
use crate::models::description_hash;
use crate::results::verification::{CycleState, OfCycle};
use armwatch_model::analysis::{Rmsd, RmsdPair, WarmingContrast};
use armwatch_model::run::FileId;
use armwatch_testing::er3a;

const FILE: FileId = FileId { device: 1, inode: 1 };

#[tokio::test]
async fn self_verification_comes_back_by_cycle_joint_and_stage() {
    let (_folder, store) = fresh().await;
    let run_id = streaming_run(&store, "R00", 0, 0).await;
    let rmsd = |value| Rmsd { value, relative: value / 10.0, samples: 100 };
    let pair = |value| RmsdPair { all_rows: rmsd(value), moving_rows: Rmsd::default() };
    let contrast = WarmingContrast { joint: joint(2), start: pair(2.5), end: pair(2.0) };
    let mut first = cycle(1);
    first.warming_contrast = vec![contrast];
    // a joint that never moves has no value for moving rows
    first.verification[3].moving_rows = Rmsd::default();
    let cycles = [first, refused_cycle(2), cycle(3)];
    for cycle in &cycles {
        assert!(store.record_cycle(run_id, cycle, &er3a()).await.expect("a cycle"));
    }
    let found = store.self_rmsd(run_id).await.expect("figures");
    let expected = cycles.iter().flat_map(|of| of.verification.iter().map(|rmsd| (of.cycle, *rmsd)));
    let expected: Vec<_> = expected.map(|(cycle, value)| OfCycle { cycle, value }).collect();
    assert_eq!(found, expected);
    let found = store.warming_contrasts(run_id).await.expect("figures");
    assert_eq!(found, [OfCycle { cycle: 1, value: contrast }]);

    let states = store.cycle_states(run_id).await.expect("states");
    let state = |cycle, reason| CycleState {
        cycle,
        rows: 30_026,
        cutoff: Some(12.5),
        remarks: match reason {
            None => Some("velocity is derived\njoint 4 starts late".to_owned()),
            Some(_) => None,
        },
        reason,
        factors_gone: None,
    };
    let refused = Some("joint 3 stands still".to_string());
    assert_eq!(states, [state(1, None), state(2, refused), state(3, None)]);
    let points = store.friction_points(run_id).await.expect("points");
    assert_eq!(points, store.run_measurements(run_id).await.expect("measurements").friction_points);
}

#[tokio::test]
async fn an_export_is_known_by_content_and_by_the_places_where_it_was_seen() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.run_source(1).await.expect("an answer"), None);
    let run_id = streaming_run(&store, "R00", 0, 0).await;
    let source = store.run_source(run_id).await.expect("an answer").expect("a run");
    assert_eq!((source.robot.as_str(), source.content_hash), ("R00", header("R00", 0).content_hash));
    assert_eq!(source.model, None);

    store.record_cycle(run_id, &cycle(1), &er3a()).await.expect("a cycle");
    let seen = |day_number| SourceState { bytes: 7, modified: day(day_number), file: FILE };
    let first = header("R00", 0).source_path;
    for (path, at) in [(first.as_str(), 0), ("/older.csv", 1), ("/newer.csv", 2)] {
        store.remember_source(path, seen(at), run_id).await.expect("remembered");
    }
    let other = streaming_run(&store, "R01", 1, 0).await;
    let state = SourceState { bytes: 1, modified: Timestamp::UNIX_EPOCH, file: FILE };
    store.remember_source("/other.csv", state, other).await.expect("remembered");
    let source = store.run_source(run_id).await.expect("an answer").expect("a run");
    let paths: Vec<String> = source.paths.iter().map(|path| path.display().to_string()).collect();
    assert_eq!(paths, [first.as_str(), "/newer.csv", "/older.csv"]);
    let model = source.model.expect("a description");
    assert_eq!((model.name.as_str(), model.description_hash), ("er3a", description_hash(&er3a()).to_vec()));
}
