//! Identity of a run, and the inputs of its stored cycles.

use jiff::Timestamp;

use super::support::*;
use crate::handle::Store;
use crate::ledger::quarantine::ExportFault;
use crate::ledger::runs::{Identity, Owner, RunStart};
use crate::ledger::sources::{RecordingName, SourceState};
use crate::ledger::supersession::supersede;
use armwatch_model::run::{ContentHash, ContentPrefix, FileId, RunHeader, RunStatus};
use armwatch_testing::er3a;

const FILE: FileId = FileId { device: 1, inode: 2 };
const SEEN: SourceState = SourceState { bytes: 1, modified: Timestamp::UNIX_EPOCH, file: FILE };

fn content(number: u8) -> ContentHash {
    ContentHash([number; 32])
}

async fn begun(
    store: &Store,
    header: &RunHeader,
    identity: Identity,
    beginning: RunStart,
) -> (i64, u32, bool) {
    let begun = store.begin_source(header, identity, beginning, SEEN).await.expect("a run");
    assert_eq!(begun.run.status, RunStatus::Streaming);
    (begun.run.run_id, begun.run.cycles_stored, begun.afresh)
}

#[tokio::test]
async fn cycles_that_were_made_with_something_else_are_made_anew() {
    let (_folder, store) = fresh().await;
    let header = header("R00", 0);
    let read = ContentPrefix { bytes: 9, hash: content(9) };
    let identity = Identity::Growing(read);
    let with = |continues, made_with| RunStart { continues, made_with, ..RunStart::default() };
    let (run, ..) = begun(&store, &header, identity, with(None, Some(content(1)))).await;
    store.record_cycle(run, &cycle(1), &er3a()).await.expect("a cycle");
    assert_eq!(begun(&store, &header, identity, with(Some(run), Some(content(1)))).await, (run, 1, false));
    assert_eq!(begun(&store, &header, identity, with(Some(run), Some(content(2)))).await, (run, 0, true));
    let earlier = store.earlier_runs(&header.source_path, FILE, None).await.expect("runs");
    let nothing = ContentPrefix { bytes: 0, hash: ContentHash(*blake3::hash(b"").as_bytes()) };
    assert_eq!((earlier.len(), earlier[0].read), (1, nothing), "no cycle was read from any byte");
    assert_eq!(store.counts().await.expect("counts").cycles, 0);

    // cycles stored by an earlier version have unknown inputs
    store.record_cycle(run, &cycle(1), &er3a()).await.expect("a cycle");
    sqlx::query("UPDATE run SET made_with = NULL").execute(&store.writer).await.expect("an update");
    assert_eq!(begun(&store, &header, identity, with(Some(run), Some(content(2)))).await, (run, 0, true));

    // the same is true of a complete run that has become longer
    store.record_cycle(run, &cycle(1), &er3a()).await.expect("a cycle");
    let mut end = store.finish_run(run).await.expect("a transaction");
    end.adopt(&ContentPrefix { bytes: 9, hash: content(8) }, &content(3)).await.expect("adopted");
    end.complete(totals(1)).await.expect("completion");
    end.commit().await.expect("a commit");
    assert_eq!(begun(&store, &header, identity, with(Some(run), Some(content(5)))).await, (run, 0, true));
}

/// Thousands of broken files with one start are not each compared with all others: the run that was read is found among
/// them.
#[tokio::test]
async fn of_many_refused_runs_of_one_recording_few_are_compared() {
    let (_folder, store) = fresh().await;
    let complete = streaming_run(&store, "R00", 0, 1).await;
    let mut end = store.finish_run(complete).await.expect("a transaction");
    end.complete(totals(1)).await.expect("completion");
    end.commit().await.expect("a commit");
    let fault = ExportFault {
        reason: "no rows".into(),
        problem: "no rows".into(),
        line: None,
        column: None,
        byte: None,
        value: None,
        remedy: "export it again".into(),
    };
    for number in 0..40 {
        let name = format!("R00_broken{number}.csv");
        let header = RunHeader {
            source_path: format!("/exports/{name}"),
            content_hash: content(100 + number),
            source_name: name,
            ..header("R00", 0)
        };
        store.quarantine(&header, &fault).await.expect("a run");
    }
    let recording = RecordingName {
        robot: "R00",
        started_at: header("R00", 0).started_at,
        source_name: "R00_broken3.csv",
    };
    let earlier = store.earlier_runs("/exports/new.csv", FILE, Some(recording)).await.expect("runs");
    assert_eq!(earlier.len(), 16);
    let names: Vec<&str> = earlier.iter().map(|run| run.source_name.as_str()).collect();
    assert!(earlier.iter().any(|run| run.run.run_id == complete), "the one that was read: {names:?}");
    assert!(names.contains(&"R00_broken3.csv") && names.contains(&"R00_broken39.csv"), "{names:?}");
}

/// A run that ends too early continues, and may end in quarantine: no result of its first end is left.
#[tokio::test]
async fn a_run_that_is_opened_again_says_nothing_as_a_whole() {
    let (_folder, store) = fresh().await;
    let run = streaming_run(&store, "R00", 0, 2).await;
    let mut end = store.finish_run(run).await.expect("a transaction");
    end.store_analysis(&run_analysis(10.0)).await.expect("an analysis");
    end.complete(totals(2)).await.expect("completion");
    end.commit().await.expect("a commit");
    sqlx::query(
        "INSERT INTO cycle_friction_level (cycle_id, joint, minute, ln_torque, offset_nm, levels, speed_fraction)
         SELECT cycle_id, 1, 1.0, 2.0, 0.0, 3, 0.5 FROM cycle",
    )
    .execute(&store.writer)
    .await
    .expect("rows as conclusions write them");
    let rows = "SELECT (SELECT count(*) FROM parameter_statistics) + (SELECT count(*) FROM warmup_fits)
                       + (SELECT count(*) FROM run_joint_summary) + (SELECT count(*) FROM cycle_friction)";
    assert!(number(&store, rows).await > Some(3.0));

    let goes_on = RunStart { continues: Some(run), ..RunStart::default() };
    let identity = Identity::Growing(ContentPrefix { bytes: 9, hash: content(9) });
    assert_eq!(begun(&store, &header("R00", 0), identity, goes_on).await, (run, 1, false));
    assert_eq!(number(&store, rows).await, Some(0.0));
    assert_sound(&store).await;
}

/// A known content that arrives in another way takes over the runs that its run had superseded.
#[tokio::test]
async fn what_a_run_has_superseded_stays_so_when_that_run_gives_way() {
    let (_folder, store) = fresh().await;
    let begin = async |number: u8, onwards_content: Identity| {
        let header = RunHeader { content_hash: content(number), ..header("R00", 0) };
        begun(&store, &header, onwards_content, RunStart::default()).await.0
    };
    let complete = async |run: i64, number: u8| {
        store.record_cycle(run, &cycle(1), &er3a()).await.expect("a cycle");
        let mut end = store.finish_run(run).await.expect("a transaction");
        let whole = ContentPrefix { bytes: 9, hash: content(number) };
        assert_eq!(end.adopt(&whole, &content(number)).await.expect("adopted"), Owner::Ours);
        end.complete(totals(1)).await.expect("completion");
        end.commit().await.expect("a commit");
    };
    let mut runs = Vec::new();
    for number in 1..=3 {
        let run = begin(number, Identity::Content(content(number))).await;
        complete(run, number).await;
        if let Some(old) = runs.last() {
            supersede(&store.writer, run, *old).await.expect("superseded");
        }
        runs.push(run);
    }
    let growing = begin(9, Identity::Growing(ContentPrefix { bytes: 0, hash: content(0) })).await;
    complete(growing, 2).await;
    let statuses = sqlx::query_as::<_, (i64, String, Option<i64>)>(
        "SELECT run_id, status, superseded_by_run_id FROM runs ORDER BY run_id",
    );
    assert_eq!(
        statuses.fetch_all(&store.readers).await.expect("runs"),
        [
            (runs[0], "superseded".to_owned(), Some(growing)),
            (runs[2], "complete".to_owned(), None),
            (growing, "complete".to_owned(), None),
        ]
    );
}
