//! A program that ends between the last cycle of an export and the end of its run, while the export grows.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use sqlx::{Connection, SqliteConnection};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::pipeline::context::{Outcome, Pipeline, Progress, Retry};
use crate::pipeline::take::follow::{Ends, Followed};
use armwatch_config::Config;
use armwatch_simulate::{SimulationSettings, simulate_run};
use armwatch_store::Store;
use armwatch_testing::er3a;

async fn pipeline(database: &Path) -> Pipeline {
    let store = Store::open(database).await.expect("a store");
    Pipeline::new(Arc::new(Config::shipped().expect("shipped settings")), store)
}

/// Key, rows, duration and residual of each cycle.
async fn cycles(database: &Path) -> Vec<(i64, i64, f64, f64)> {
    let url = format!("sqlite://{}", database.display());
    let mut connection = SqliteConnection::connect(&url).await.expect("a connection");
    sqlx::query_as("SELECT cycle_id, rows, duration_s, residual_std_nm FROM cycle ORDER BY number")
        .fetch_all(&mut connection)
        .await
        .expect("cycles")
}

/// The same without keys.
async fn contents(database: &Path) -> Vec<(i64, f64, f64)> {
    cycles(database)
        .await
        .into_iter()
        .map(|(_, rows, duration, residual)| (rows, duration, residual))
        .collect()
}

/// Processes an export, and is dropped as soon as its cycle `last` is stored.
async fn take_and_end(pipeline: &Pipeline, export: &Path, last: u32) {
    let (stored, stop) = (Arc::new(Notify::new()), CancellationToken::new());
    let told = Arc::clone(&stored);
    let progress = move |of| {
        if of == Progress::Cycle(last) {
            told.notify_one();
        }
    };
    tokio::select! {
        biased;
        () = stored.notified() => {}
        outcome = pipeline.process(export, Retry::Never, &stop, progress) => panic!("ended: {outcome:?}"),
    }
}

#[tokio::test]
async fn a_cycle_that_the_end_has_cut_is_read_anew_where_the_export_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let first_start = "2026-01-05T08:47:00Z".parse().expect("a time");
    let settings =
        SimulationSettings { cycles: 2, warming_s: 5.0, first_start, ..SimulationSettings::default() };
    let made = simulate_run(&er3a(), &settings, 0, folder.path(), &mut |_| ()).expect("an export");
    let whole = std::fs::read(&made.export).expect("an export");
    let stop = CancellationToken::new();

    let database = |name: &str| folder.path().join(name);
    let expected = pipeline(&database("expected.db")).await;
    expected.process(&made.export, Retry::Never, &stop, |_| ()).await.expect("an outcome");
    let expected = contents(&database("expected.db")).await;

    // some rows and half a cell of the last cycle are not written yet
    let begun = &whole[..whole.len() - 2000];
    for name in ["settled.db", "grown.db"] {
        std::fs::write(&made.export, begun).expect("written");
        take_and_end(&pipeline(&database(name)).await, &made.export, 2).await;
        let short = contents(&database(name)).await;
        assert!(short.len() == 2 && short != expected, "{short:?}");
    }

    // the reached end stays the end: the cycle is not read again
    let before = cycles(&database("settled.db")).await;
    let settled = pipeline(&database("settled.db")).await;
    let outcome = settled.process(&made.export, Retry::Never, &stop, |_| ()).await.expect("an outcome");
    assert!(matches!(outcome, Outcome::Stored(_)), "{outcome:?}");
    assert_eq!(cycles(&database("settled.db")).await, before);

    // the cycle is read again, both if the run had ended and if it had not
    std::fs::write(&made.export, &whole).expect("written");
    for name in ["settled.db", "grown.db"] {
        let pipeline = pipeline(&database(name)).await;
        pipeline.process(&made.export, Retry::Never, &stop, |_| ()).await.expect("an outcome");
        assert_eq!(contents(&database(name)).await, expected, "{name}");
    }
}

#[tokio::test]
async fn a_complete_export_that_counts_as_growing_stays_complete() {
    let folder = tempfile::tempdir().expect("a folder");
    let first_start = "2026-01-05T08:47:00Z".parse().expect("a time");
    let settings =
        SimulationSettings { cycles: 2, warming_s: 5.0, first_start, ..SimulationSettings::default() };
    let made = simulate_run(&er3a(), &settings, 0, folder.path(), &mut |_| ()).expect("an export");
    let database = folder.path().join("complete.db");
    let pipeline = pipeline(&database).await;
    let ends = Ends { stop: CancellationToken::new(), give_way: CancellationToken::new() };
    pipeline.process(&made.export, Retry::Never, &ends.stop, |_| ()).await.expect("an outcome");
    let before = cycles(&database).await;

    let followed = pipeline.follow(&made.export, Duration::from_millis(100), &ends, |_| ()).await;
    assert!(
        matches!(followed, Ok(Followed::Outcome(Outcome::AlreadyStored { run_id: 1 }))),
        "it is read again"
    );
    assert!(before.len() == 2 && cycles(&database).await == before);
}
