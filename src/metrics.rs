//! Figures that the process keeps of its own work, for Prometheus: counters, gauges and histograms of what is read,
//! analysed, stored, concluded and answered since it started.
//!
//! Whoever does the work counts it here; `serve` writes the figures down when it is asked. What is stored is not
//! counted twice: figures of robots and alarms come from the database. Names and units follow the conventions of
//! Prometheus (prometheus.io/docs/practices/naming). Labels have few values that are known beforehand; the label
//! `robot` has those of growing files alone and goes with them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use prometheus::core::Collector;
use prometheus::{
    Gauge, GaugeVec, Histogram, HistogramOpts, HistogramVec, IntCounter, IntCounterVec, IntGauge,
    IntGaugeVec, Opts, Registry,
};

/// A figure that cannot be kept: a name or label that Prometheus does not allow, or one that is there twice.
pub type MetricsError = prometheus::Error;

/// Upper bounds of the durations of a piece of work, s: from a small transaction to a cycle on a slow machine.
const WORK_SECONDS: [f64; 14] =
    [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 15.0, 60.0];

/// Upper bounds of the time from the last row of a cycle to its commit, s. One second is promised.
const LAG_SECONDS: [f64; 12] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 2.0, 5.0, 15.0, 60.0];

/// Upper bounds of the durations of answers, s.
const ANSWER_SECONDS: [f64; 11] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];

/// What is done with an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Its rows are read and cut into a cycle.
    Read,
    /// A cycle is analysed.
    Analyse,
    /// A cycle is stored.
    Record,
    /// What the whole run says is worked out and stored.
    Finish,
    /// What the robot's history says is worked out and stored.
    Conclude,
}

impl Stage {
    const ALL: [Self; 5] = [Self::Read, Self::Analyse, Self::Record, Self::Finish, Self::Conclude];

    const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Analyse => "analyse",
            Self::Record => "record",
            Self::Finish => "finish",
            Self::Conclude => "conclude",
        }
    }
}

/// Where files wait and are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Queue {
    /// Files that are read as they grow.
    Growing,
    /// Settled files that are read within seconds.
    Small,
    /// Larger settled files.
    Large,
}

impl Queue {
    const ALL: [Self; 3] = [Self::Growing, Self::Small, Self::Large];

    const fn name(self) -> &'static str {
        match self {
            Self::Growing => "growing",
            Self::Small => "small",
            Self::Large => "large",
        }
    }
}

/// What became of an export that was taken up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExportEnd {
    /// Every cycle is stored.
    Stored,
    /// Its content was known before, as stored or as not understood.
    Known,
    /// It was not understood.
    Quarantined,
    /// It is looked at again later: it changed, could not be read, or the program stops.
    Later,
    /// The program failed over it.
    Failed,
}

impl ExportEnd {
    const ALL: [Self; 5] = [Self::Stored, Self::Known, Self::Quarantined, Self::Later, Self::Failed];

    const fn name(self) -> &'static str {
        match self {
            Self::Stored => "stored",
            Self::Known => "known",
            Self::Quarantined => "quarantined",
            Self::Later => "later",
            Self::Failed => "failed",
        }
    }
}

/// Figures of the process. Clones share them. The default keeps none, for commands that nobody asks for them.
#[derive(Debug, Clone, Default)]
pub struct Metrics(Option<Arc<Families>>);

#[derive(Debug)]
struct Families {
    registry: Registry,
    stage_seconds: HistogramVec,
    cycle_lag_seconds: Histogram,
    cycles: IntCounter,
    rows: IntCounter,
    bytes: IntCounter,
    exports: IntCounterVec,
    conclusion_failures: IntCounter,
    waiting: IntGaugeVec,
    reading: IntGaugeVec,
    watched_files: IntGauge,
    scan_seconds: Histogram,
    live: LiveFigures,
    snapshot_time: Gauge,
    snapshot_bytes: IntGauge,
    snapshot_seconds: Histogram,
    snapshot_failures: IntCounter,
    requests: IntCounterVec,
    request_seconds: HistogramVec,
}

#[derive(Debug)]
struct LiveFigures {
    begun: GaugeVec,
    last_read: GaugeVec,
    last_cycle: GaugeVec,
    /// Files that are read, by robot: its samples go with the last of them.
    open: Mutex<HashMap<String, usize>>,
}

impl Metrics {
    /// Figures that are kept, with those of the process itself where the system tells them (Linux).
    ///
    /// # Errors
    /// [`MetricsError`] of a family that cannot be registered; a fault of the program.
    pub fn counting() -> Result<Self, MetricsError> {
        Ok(Self(Some(Arc::new(Families::new()?))))
    }

    fn with(&self, count: impl FnOnce(&Families)) {
        if let Some(families) = &self.0 {
            count(families);
        }
    }

    /// A piece of a stage is done.
    pub fn stage(&self, stage: Stage, took: Duration) {
        self.with(|of| observe(&of.stage_seconds, &[stage.name()], took));
    }

    /// A cycle of so many rows was cut, for which so many bytes of its file were read.
    pub fn cycle_read(&self, rows: usize, bytes: u64) {
        self.with(|of| {
            of.rows.inc_by(rows as u64);
            of.bytes.inc_by(bytes);
        });
    }

    /// A cycle is stored; `written` is when the row that ended it was written, where that is known.
    pub fn cycle_stored(&self, written: Option<SystemTime>) {
        self.with(|of| {
            of.cycles.inc();
            // a clock that was set back says nothing
            if let Some(Ok(lag)) = written.map(|at| SystemTime::now().duration_since(at)) {
                of.cycle_lag_seconds.observe(lag.as_secs_f64());
            }
        });
    }

    /// What became of an export.
    pub fn export(&self, end: ExportEnd) {
        self.with(|of| count(&of.exports, &[end.name()]));
    }

    /// Conclusions of a robot failed.
    pub fn conclusion_failed(&self) {
        self.with(|of| of.conclusion_failures.inc());
    }

    /// Files that wait in a queue, and that are being read from it.
    pub fn queue(&self, queue: Queue, waiting: usize, reading: usize) {
        self.with(|of| {
            set(&of.waiting, queue.name(), waiting);
            set(&of.reading, queue.name(), reading);
        });
    }

    /// The watched folders were looked at, and have so many exports.
    pub fn scanned(&self, files: usize, took: Duration) {
        self.with(|of| {
            of.watched_files.set(i64::try_from(files).unwrap_or(i64::MAX));
            of.scan_seconds.observe(took.as_secs_f64());
        });
    }

    /// Begins figures of a growing file of a robot, which end when the last handle is dropped.
    #[must_use]
    pub fn live(&self, robot: &str) -> LiveFile {
        self.with(|of| {
            let mut open = of.live.open.lock().unwrap_or_else(PoisonError::into_inner);
            let files = open.entry(robot.to_owned()).or_insert(0);
            *files += 1;
            if *files == 1 {
                set_now(&of.live.begun, robot);
            }
        });
        LiveFile { metrics: self.clone(), robot: robot.to_owned() }
    }

    /// A copy of the database was written.
    pub fn snapshot(&self, bytes: u64, took: Duration) {
        self.with(|of| {
            of.snapshot_time.set(now());
            of.snapshot_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
            of.snapshot_seconds.observe(took.as_secs_f64());
        });
    }

    /// A copy of the database could not be written.
    pub fn snapshot_failed(&self) {
        self.with(|of| of.snapshot_failures.inc());
    }

    /// A request was answered. `route` is the pattern of the address, never the address itself.
    pub fn request(&self, method: &str, route: &str, status: &str, took: Duration) {
        self.with(|of| {
            count(&of.requests, &[method, route, status]);
            observe(&of.request_seconds, &[method, route], took);
        });
    }

    /// All figures as they are now.
    #[must_use]
    pub fn gather(&self) -> Vec<prometheus::proto::MetricFamily> {
        self.0.as_ref().map(|of| of.registry.gather()).unwrap_or_default()
    }
}

impl Families {
    fn new() -> Result<Self, MetricsError> {
        let registry = Registry::new();
        let live = |name, help| kept(&registry, GaugeVec::new(Opts::new(name, help), &["robot"])?);
        let live = LiveFigures {
            begun: live(
                "armwatch_live_begun_timestamp_seconds",
                "When reading of the robot's growing file began, seconds since 1970.",
            )?,
            last_read: live(
                "armwatch_live_last_read_timestamp_seconds",
                "When rows of the robot's growing file were read last, seconds since 1970.",
            )?,
            last_cycle: live(
                "armwatch_live_last_cycle_timestamp_seconds",
                "When a cycle of the robot's growing file was stored last, seconds since 1970.",
            )?,
            open: Mutex::default(),
        };
        let families = Self {
            stage_seconds: histograms(
                &registry,
                "armwatch_stage_duration_seconds",
                "Work of a stage: read, analyse and record of a cycle, finish of a run, conclude of a robot.",
                &["stage"],
                &WORK_SECONDS,
            )?,
            cycle_lag_seconds: histogram(
                &registry,
                "armwatch_cycle_lag_seconds",
                "From the write of the row that ends a cycle of a growing file to the cycle's commit.",
                &LAG_SECONDS,
            )?,
            cycles: counter(&registry, "armwatch_cycles_stored_total", "Cycles stored.")?,
            rows: counter(&registry, "armwatch_rows_read_total", "Rows of the cycles that were cut.")?,
            bytes: counter(
                &registry,
                "armwatch_read_bytes_total",
                "Bytes of exports as they lie on disk, read up to the last cycle that was cut.",
            )?,
            exports: counters(
                &registry,
                "armwatch_exports_total",
                "Exports that were taken up, by what became of them.",
                &["end"],
            )?,
            conclusion_failures: counter(
                &registry,
                "armwatch_conclusion_failures_total",
                "Conclusions of a robot that failed.",
            )?,
            waiting: gauges(&registry, "armwatch_files_waiting", "Files that wait to be read.", &["queue"])?,
            reading: gauges(&registry, "armwatch_files_reading", "Files that are being read.", &["queue"])?,
            watched_files: gauge(
                &registry,
                "armwatch_watched_files",
                "Exports in the watched folders at the last look.",
            )?,
            scan_seconds: histogram(
                &registry,
                "armwatch_scan_duration_seconds",
                "A look at the watched folders.",
                &WORK_SECONDS,
            )?,
            live,
            snapshot_time: kept(
                &registry,
                Gauge::new(
                    "armwatch_snapshot_timestamp_seconds",
                    "When this process wrote the last copy of the database, seconds since 1970; 0 before the first.",
                )?,
            )?,
            snapshot_bytes: gauge(&registry, "armwatch_snapshot_size_bytes", "Size of that copy.")?,
            snapshot_seconds: histogram(
                &registry,
                "armwatch_snapshot_duration_seconds",
                "Writing a copy of the database.",
                &WORK_SECONDS,
            )?,
            snapshot_failures: counter(
                &registry,
                "armwatch_snapshot_failures_total",
                "Copies of the database that could not be written.",
            )?,
            requests: counters(
                &registry,
                "armwatch_http_requests_total",
                "Requests that were answered.",
                &["method", "route", "status"],
            )?,
            request_seconds: histograms(
                &registry,
                "armwatch_http_request_duration_seconds",
                "From a request's headers to those of its answer; events go on after that.",
                &["method", "route"],
                &ANSWER_SECONDS,
            )?,
            registry,
        };
        #[cfg(target_os = "linux")]
        families.registry.register(Box::new(prometheus::process_collector::ProcessCollector::for_self()))?;
        // what never happened is 0, not missing
        for stage in Stage::ALL {
            families.stage_seconds.get_metric_with_label_values(&[stage.name()])?;
        }
        for end in ExportEnd::ALL {
            families.exports.get_metric_with_label_values(&[end.name()])?;
        }
        for queue in Queue::ALL {
            set(&families.waiting, queue.name(), 0);
            set(&families.reading, queue.name(), 0);
        }
        Ok(families)
    }
}

/// Figures of a growing file that is being read; they go when the last of its robot's is dropped.
#[derive(Debug)]
pub struct LiveFile {
    metrics: Metrics,
    robot: String,
}

impl LiveFile {
    /// Rows were read.
    pub fn read(&self) {
        self.metrics.with(|of| set_now(&of.live.last_read, &self.robot));
    }

    /// A cycle was stored.
    pub fn stored(&self) {
        self.metrics.with(|of| set_now(&of.live.last_cycle, &self.robot));
    }
}

impl Drop for LiveFile {
    fn drop(&mut self) {
        self.metrics.with(|of| {
            let mut open = of.live.open.lock().unwrap_or_else(PoisonError::into_inner);
            let left = open.get_mut(&self.robot).map_or(0, |files| {
                *files -= 1;
                *files
            });
            if left == 0 {
                open.remove(&self.robot);
                for figure in [&of.live.begun, &of.live.last_read, &of.live.last_cycle] {
                    // one that was never set is not there
                    let _ = figure.remove_label_values(&[&self.robot]);
                }
            }
        });
    }
}

/// Registers a family.
fn kept<C: Collector + Clone + 'static>(registry: &Registry, family: C) -> Result<C, MetricsError> {
    registry.register(Box::new(family.clone()))?;
    Ok(family)
}

fn counter(registry: &Registry, name: &str, help: &str) -> Result<IntCounter, MetricsError> {
    kept(registry, IntCounter::new(name, help)?)
}

fn counters(
    registry: &Registry,
    name: &str,
    help: &str,
    labels: &[&str],
) -> Result<IntCounterVec, MetricsError> {
    kept(registry, IntCounterVec::new(Opts::new(name, help), labels)?)
}

fn gauge(registry: &Registry, name: &str, help: &str) -> Result<IntGauge, MetricsError> {
    kept(registry, IntGauge::new(name, help)?)
}

fn gauges(registry: &Registry, name: &str, help: &str, labels: &[&str]) -> Result<IntGaugeVec, MetricsError> {
    kept(registry, IntGaugeVec::new(Opts::new(name, help), labels)?)
}

fn histogram(registry: &Registry, name: &str, help: &str, bounds: &[f64]) -> Result<Histogram, MetricsError> {
    kept(registry, Histogram::with_opts(HistogramOpts::new(name, help).buckets(bounds.to_vec()))?)
}

fn histograms(
    registry: &Registry,
    name: &str,
    help: &str,
    labels: &[&str],
    bounds: &[f64],
) -> Result<HistogramVec, MetricsError> {
    kept(registry, HistogramVec::new(HistogramOpts::new(name, help).buckets(bounds.to_vec()), labels)?)
}

// Labels are given in the number that a family has: there is no other error.

fn observe(family: &HistogramVec, labels: &[&str], took: Duration) {
    if let Ok(histogram) = family.get_metric_with_label_values(labels) {
        histogram.observe(took.as_secs_f64());
    }
}

fn count(family: &IntCounterVec, labels: &[&str]) {
    if let Ok(counter) = family.get_metric_with_label_values(labels) {
        counter.inc();
    }
}

fn set(family: &IntGaugeVec, label: &str, value: usize) {
    if let Ok(gauge) = family.get_metric_with_label_values(&[label]) {
        gauge.set(i64::try_from(value).unwrap_or(i64::MAX));
    }
}

fn set_now(family: &GaugeVec, label: &str) {
    if let Ok(gauge) = family.get_metric_with_label_values(&[label]) {
        gauge.set(now());
    }
}

/// Seconds since 1970.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(metrics: &Metrics) -> String {
        prometheus::TextEncoder::new().encode_to_string(&metrics.gather()).unwrap()
    }

    fn has(metrics: &Metrics, line: &str) -> bool {
        text(metrics).lines().any(|one| one == line)
    }

    #[test]
    fn what_is_counted_is_told_and_what_never_happened_is_zero() {
        let metrics = Metrics::counting().unwrap();
        assert!(has(&metrics, "armwatch_exports_total{end=\"quarantined\"} 0"));
        assert!(has(&metrics, "armwatch_stage_duration_seconds_count{stage=\"conclude\"} 0"));
        metrics.stage(Stage::Read, Duration::from_millis(20));
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
        let metrics = Metrics::counting().unwrap();
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
        let metrics = Metrics::counting().unwrap();
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
    fn nothing_is_kept_where_nobody_asks() {
        let metrics = Metrics::default();
        metrics.cycle_read(1, 1);
        metrics.live("R1").read();
        assert!(metrics.gather().is_empty());
    }
}
