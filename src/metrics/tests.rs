use super::*;

fn text(metrics: &Metrics) -> String {
    let mut text = String::new();
    metrics.write(&mut text).unwrap();
    text
}

fn has(metrics: &Metrics, line: &str) -> bool {
    text(metrics).lines().any(|one| one == line)
}

#[test]
fn what_is_counted_is_told_and_what_never_happened_is_zero() {
    let metrics = Metrics::counting();
    assert!(has(&metrics, "armwatch_exports_total{end=\"quarantined\"} 0"));
    assert!(has(&metrics, "armwatch_stage_duration_seconds_count{stage=\"conclude\"} 0"));
    metrics.stage(WorkStage::Read, Duration::from_millis(20));
    metrics.cycle_read(75_000, 1 << 20);
    metrics.cycle_read(5, 10);
    metrics.export(ExportEnd::Stored);
    metrics.queue(Queue::Large, 3, 1);
    metrics.request("GET", "/v1/fleet", "200", Duration::from_millis(3));
    for line in [
        "armwatch_stage_duration_seconds_bucket{stage=\"read\",le=\"0.01\"} 0",
        "armwatch_stage_duration_seconds_bucket{stage=\"read\",le=\"0.025\"} 1",
        "armwatch_rows_read_total 75005",
        "armwatch_read_bytes_total 1048586",
        "armwatch_exports_total{end=\"stored\"} 1",
        "armwatch_files_waiting{queue=\"large\"} 3",
        "armwatch_files_reading{queue=\"large\"} 1",
        "armwatch_http_requests_total{method=\"GET\",route=\"/v1/fleet\",status=\"200\"} 1",
    ] {
        assert!(has(&metrics, line), "{line} is not in\n{}", text(&metrics));
    }
}

#[test]
fn lag_is_counted_where_the_time_of_the_row_is_known() {
    let metrics = Metrics::counting();
    metrics.cycle_stored(None);
    metrics.cycle_stored(Some(SystemTime::now() - Duration::from_secs(3)));
    // a clock that was set back
    metrics.cycle_stored(Some(SystemTime::now() + Duration::from_secs(100)));
    assert!(has(&metrics, "armwatch_cycles_stored_total 3"));
    assert!(has(&metrics, "armwatch_cycle_lag_seconds_bucket{le=\"2\"} 0"));
    assert!(has(&metrics, "armwatch_cycle_lag_seconds_count 1"));
}

#[test]
fn figures_of_a_growing_file_go_with_the_last_of_its_robot() {
    let metrics = Metrics::counting();
    let begun = |robot| {
        let begin = format!("armwatch_live_begun_timestamp_seconds{{robot=\"{robot}\"}}");
        text(&metrics).lines().any(|line| line.starts_with(&begin))
    };
    let (one, two, other) = (metrics.live("R1"), metrics.live("R1"), metrics.live("R2"));
    one.read();
    two.stored();
    assert!(begun("R1") && begun("R2"));
    drop(one);
    assert!(begun("R1"));
    drop(two);
    assert!(!text(&metrics).contains("R1") && begun("R2"));
    drop(other);
    assert!(!text(&metrics).contains("robot="));
}

#[test]
fn a_folder_answers_as_long_as_looks_end_and_goes_when_it_is_not_watched_any_more() {
    let metrics = Metrics::counting();
    let folders = ["/in", "/share"].map(PathBuf::from);
    metrics.keep_folders(&folders, Duration::from_secs(5));
    assert!(
        has(&metrics, "armwatch_folder_last_scan_timestamp_seconds{folder=\"/share\"} 0.0"),
        "{}",
        text(&metrics)
    );
    let at = Timestamp::from_second(1_772_352_000).ok();
    metrics.folder_answers(&folders[0], at, Duration::from_secs(1));
    metrics.folder_is_silent(&folders[1]);
    assert!(has(&metrics, "armwatch_folder_last_scan_timestamp_seconds{folder=\"/in\"} 1772352000.0"));
    assert!(has(&metrics, "armwatch_folder_answers{folder=\"/in\"} 1"));
    assert!(has(&metrics, "armwatch_folder_answers{folder=\"/share\"} 0"));
    let states: Vec<_> =
        metrics.folders().into_iter().map(|of| (of.folder, of.looked_at, of.answers)).collect();
    assert_eq!(states, [("/in".to_owned(), at, true), ("/share".to_owned(), None, false)]);
    metrics.keep_folders(&folders[..1], Duration::from_secs(5));
    assert!(!text(&metrics).contains("/share"));
    // the scans have stopped, although no scan is hanging
    metrics.note_folder(&folders[0], |look| look.due = Instant::now() - Duration::from_secs(1));
    assert!(!metrics.folders()[0].answers);
}

#[test]
fn nothing_is_kept_where_nobody_asks() {
    let metrics = Metrics::default();
    metrics.cycle_read(1, 1);
    metrics.live("R1").read();
    assert_eq!(text(&metrics), "");
}
