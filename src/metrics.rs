//! Metrics of the process's own work, for Prometheus: counters, gauges and histograms of rows read, cycles analysed and
//! stored, conclusions and answers since its start.
//!
//! Each part of the program counts its own work here; `serve` prints the metrics on request. Stored results are not
//! counted twice: metrics of robots and alarms come from the database. Names and units follow the conventions of
//! Prometheus (prometheus.io/docs/practices/naming). Labels have few values that are known beforehand; the label
//! `robot` exists only for growing files and is removed with them.

mod kinds;
mod process;

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jiff::Timestamp;
use prometheus_client::encoding::prometheus_text;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry};

use armwatch_model::text;

pub use kinds::{Disk, ExportEnd, Queue, WorkStage};

/// Upper bounds of the durations of a work stage, s: from a small transaction to a cycle on a slow machine.
const WORK_SECONDS: [f64; 14] =
    [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 15.0, 60.0];

/// Upper bounds of the time from the last row of a cycle to its commit, s. One second is promised.
const LAG_SECONDS: [f64; 12] = [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 2.0, 5.0, 15.0, 60.0];

/// Upper bounds of the durations of answers, s.
const ANSWER_SECONDS: [f64; 11] = [0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0];

/// Metrics of the process, shared by clones. The default keeps none, for commands that are never queried.
#[derive(Debug, Clone, Default)]
pub struct Metrics(Option<Arc<Families>>);

/// Names of labels with the values of a sample.
type Labels<const N: usize> = [(&'static str, String); N];

type Histograms<const N: usize> = Family<Labels<N>, Histogram, fn() -> Histogram>;

/// Seconds since 1970.
type TimeGauge = Gauge<f64, AtomicU64>;

#[derive(Debug)]
struct Families {
    registry: Registry,
    stage_seconds: Histograms<1>,
    cycle_lag_seconds: Histogram,
    cycles: Counter,
    rows: Counter,
    bytes: Counter,
    exports: Family<Labels<1>, Counter>,
    conclusion_failures: Counter,
    waiting: Family<Labels<1>, Gauge>,
    reading: Family<Labels<1>, Gauge>,
    watched_files: Gauge,
    scan_seconds: Histogram,
    folder_looked_at: Family<Labels<1>, TimeGauge>,
    folder_answers: Family<Labels<1>, Gauge>,
    folders: Mutex<BTreeMap<PathBuf, FolderLook>>,
    disk_answers: Family<Labels<1>, Gauge>,
    /// State of each disk: true if it answers.
    disks: Mutex<BTreeMap<Disk, bool>>,
    live: LiveFigures,
    snapshot_time: TimeGauge,
    snapshot_bytes: Gauge,
    snapshot_seconds: Histogram,
    snapshot_failures: Counter,
    requests: Family<Labels<3>, Counter>,
    request_seconds: Histograms<2>,
}

/// State of a watched folder.
#[derive(Debug, Clone, PartialEq)]
pub struct FolderState {
    /// The folder.
    pub folder: String,
    /// When its last scan ended, since this process started.
    pub looked_at: Option<Timestamp>,
    /// True if the last scan ended in time and none hangs.
    pub answers: bool,
}

/// Stored state of a folder.
#[derive(Debug)]
struct FolderLook {
    looked_at: Option<Timestamp>,
    is_silent: bool,
    /// Latest end of the next scan.
    due: Instant,
    interval: Duration,
}

/// A scan of a folder may take this much longer than the one before, and than the interval of scans.
const LOOK_TAKES: Duration = Duration::from_secs(60);

/// A scan of a folder may take this many times as long as the one before.
const LOOK_TAKES_TIMES: u32 = 10;

#[derive(Debug)]
struct LiveFigures {
    begun: Family<Labels<1>, TimeGauge>,
    last_read: Family<Labels<1>, TimeGauge>,
    last_cycle: Family<Labels<1>, TimeGauge>,
    /// Number of files being read, by robot: a robot's samples are removed with the last of them.
    open: Mutex<HashMap<String, usize>>,
}

impl Metrics {
    /// Metrics that count, including those of the process itself if the system reports them (Linux).
    pub fn counting() -> Self {
        Self(Some(Arc::new(Families::new())))
    }

    fn with(&self, count: impl FnOnce(&Families)) {
        if let Some(families) = &self.0 {
            count(families);
        }
    }

    /// Counts a completed piece of a work stage.
    pub fn stage(&self, stage: WorkStage, took: Duration) {
        self.with(|of| {
            of.stage_seconds.get_or_create(&labels([("stage", stage.name())])).observe(took.as_secs_f64());
        });
    }

    /// Counts a cut cycle of `rows` rows and `bytes` bytes of its file.
    pub fn cycle_read(&self, rows: usize, bytes: u64) {
        self.with(|of| {
            of.rows.inc_by(rows as u64);
            of.bytes.inc_by(bytes);
        });
    }

    /// Counts a stored cycle; `written` is when the row that ended it was written, if known.
    pub fn cycle_stored(&self, written: Option<SystemTime>) {
        self.with(|of| {
            of.cycles.inc();
            // ignore the lag if the clock was set back
            if let Some(Ok(lag)) = written.map(|at| SystemTime::now().duration_since(at)) {
                of.cycle_lag_seconds.observe(lag.as_secs_f64());
            }
        });
    }

    /// Counts the outcome of an export.
    pub fn export(&self, end: ExportEnd) {
        self.with(|of| {
            of.exports.get_or_create(&labels([("end", end.name())])).inc();
        });
    }

    /// Counts failed conclusions of a robot.
    pub fn conclusion_failed(&self) {
        self.with(|of| {
            of.conclusion_failures.inc();
        });
    }

    /// Sets the number of files that wait in a queue, and of those being read from it.
    pub fn queue(&self, queue: Queue, waiting: usize, reading: usize) {
        self.with(|of| {
            let labels = labels([("queue", queue.name())]);
            of.waiting.get_or_create(&labels).set(whole(waiting));
            of.reading.get_or_create(&labels).set(whole(reading));
        });
    }

    /// Records a scan of the watched folders, which found `files` exports.
    pub fn scanned(&self, files: usize, took: Duration) {
        self.with(|of| {
            of.watched_files.set(whole(files));
            of.scan_seconds.observe(took.as_secs_f64());
        });
    }

    /// Sets the watched folders, each scanned once per `interval`.
    pub fn keep_folders(&self, folders: &[PathBuf], interval: Duration) {
        self.with(|of| {
            let mut known = of.folders.lock().unwrap_or_else(PoisonError::into_inner);
            known.retain(|folder, _| {
                let stays = folders.contains(folder);
                if !stays {
                    of.folder_looked_at.remove(&folder_labels(folder));
                    of.folder_answers.remove(&folder_labels(folder));
                }
                stays
            });
            for folder in folders {
                let due = Instant::now() + interval + LOOK_TAKES;
                let new = FolderLook { looked_at: None, is_silent: false, due, interval };
                let look = known.entry(folder.clone()).or_insert(new);
                (look.interval, look.due) = (interval, look.due.max(due));
                // 0 before the first look
                drop(of.folder_looked_at.get_or_create(&folder_labels(folder)));
                of.folder_answers.get_or_create(&folder_labels(folder)).set(i64::from(!look.is_silent));
            }
        });
    }

    /// Records that a scan of a watched folder has ended; `looked_at` is the time of the last scan that could read it.
    pub fn folder_answers(&self, folder: &Path, looked_at: Option<Timestamp>, took: Duration) {
        self.note_folder(folder, |look| {
            (look.looked_at, look.is_silent) = (looked_at, false);
            look.due = Instant::now() + look.interval + LOOK_TAKES + LOOK_TAKES_TIMES * took;
        });
    }

    /// Records that a scan of a watched folder hangs.
    pub fn folder_is_silent(&self, folder: &Path) {
        self.note_folder(folder, |look| look.is_silent = true);
    }

    fn note_folder(&self, folder: &Path, change: impl FnOnce(&mut FolderLook)) {
        self.with(|of| {
            let mut known = of.folders.lock().unwrap_or_else(PoisonError::into_inner);
            let Some(look) = known.get_mut(folder) else { return };
            change(look);
            let labels = folder_labels(folder);
            of.folder_answers.get_or_create(&labels).set(i64::from(!look.is_silent));
            if let Some(at) = look.looked_at {
                of.folder_looked_at.get_or_create(&labels).set(at.as_millisecond() as f64 / 1e3);
            }
        });
    }

    /// States of the watched folders.
    pub fn folders(&self) -> Vec<FolderState> {
        let Some(of) = &self.0 else { return Vec::new() };
        let known = of.folders.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let state = |(folder, look): (&PathBuf, &FolderLook)| FolderState {
            folder: folder.display().to_string(),
            looked_at: look.looked_at,
            answers: !look.is_silent && now <= look.due,
        };
        known.iter().map(state).collect()
    }

    /// Records that a disk that the daemon writes to has stopped or begun to answer.
    pub fn disk_answers(&self, disk: Disk, answers: bool) {
        self.with(|of| {
            of.disks.lock().unwrap_or_else(PoisonError::into_inner).insert(disk, answers);
            of.disk_answers.get_or_create(&labels([("disk", disk.name())])).set(i64::from(answers));
        });
    }

    /// False if a disk does not answer.
    pub fn answers(&self, disk: Disk) -> bool {
        let Some(of) = &self.0 else { return true };
        of.disks.lock().unwrap_or_else(PoisonError::into_inner).get(&disk).copied().unwrap_or(true)
    }

    /// Starts metrics of a growing file of a robot; they are removed when the last handle is dropped.
    pub fn live(&self, robot: &str) -> LiveFile {
        // same form as its label
        let robot = text::distinct(robot).into_owned();
        self.with(|of| {
            let mut open = of.live.open.lock().unwrap_or_else(PoisonError::into_inner);
            let files = open.entry(robot.clone()).or_insert(0);
            *files += 1;
            if *files == 1 {
                set_now(&of.live.begun, &robot);
            }
        });
        LiveFile { metrics: self.clone(), robot }
    }

    /// Counts a written copy of the database.
    pub fn snapshot(&self, bytes: u64, took: Duration) {
        self.with(|of| {
            of.snapshot_time.set(now());
            of.snapshot_bytes.set(whole(bytes));
            of.snapshot_seconds.observe(took.as_secs_f64());
        });
    }

    /// Counts a copy of the database that could not be written.
    pub fn snapshot_failed(&self) {
        self.with(|of| {
            of.snapshot_failures.inc();
        });
    }

    /// Counts an answered request. `route` is the pattern of the address, never the address itself.
    pub fn request(&self, method: &str, route: &str, status: &str, took: Duration) {
        self.with(|of| {
            let [method, route] = [("method", method), ("route", route)];
            of.requests.get_or_create(&labels([method, route, ("status", status)])).inc();
            of.request_seconds.get_or_create(&labels([method, route])).observe(took.as_secs_f64());
        });
    }

    /// Writes all metrics in the text format of Prometheus.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn write(&self, text: &mut impl fmt::Write) -> fmt::Result {
        self.0.as_ref().map_or(Ok(()), |of| prometheus_text::encode(text, &of.registry))
    }
}

impl Families {
    // Registering adds the full stop of a help and the `_total` of a counter.
    fn new() -> Self {
        let mut registry = Registry::default();
        let mut live = |name, help| kept(&mut registry, name, help, Family::default());
        let live = LiveFigures {
            begun: live(
                "armwatch_live_begun_timestamp_seconds",
                "When reading of the robot's growing file began, seconds since 1970",
            ),
            last_read: live(
                "armwatch_live_last_read_timestamp_seconds",
                "When rows of the robot's growing file were read last, seconds since 1970",
            ),
            last_cycle: live(
                "armwatch_live_last_cycle_timestamp_seconds",
                "When a cycle of the robot's growing file was stored last, seconds since 1970",
            ),
            open: Mutex::default(),
        };
        registry.register_collector(Box::new(process::Process));
        let families = Self {
            stage_seconds: kept(
                &mut registry,
                "armwatch_stage_duration_seconds",
                "Work of a stage: read, analyse and record of a cycle, finish of a run, conclude of a robot",
                histograms(|| Histogram::new(WORK_SECONDS)),
            ),
            cycle_lag_seconds: kept(
                &mut registry,
                "armwatch_cycle_lag_seconds",
                "From the write of the row that ends a cycle of a growing file to the cycle's commit",
                Histogram::new(LAG_SECONDS),
            ),
            cycles: kept(&mut registry, "armwatch_cycles_stored", "Cycles stored", Counter::default()),
            rows: kept(
                &mut registry,
                "armwatch_rows_read",
                "Rows of the cycles that were cut",
                Counter::default(),
            ),
            bytes: kept(
                &mut registry,
                "armwatch_read_bytes",
                "Bytes of exports as they lie on disk, read up to the last cycle that was cut",
                Counter::default(),
            ),
            exports: kept(
                &mut registry,
                "armwatch_exports",
                "Exports that were taken up, by what became of them",
                Family::default(),
            ),
            conclusion_failures: kept(
                &mut registry,
                "armwatch_conclusion_failures",
                "Conclusions of a robot that failed",
                Counter::default(),
            ),
            waiting: kept(
                &mut registry,
                "armwatch_files_waiting",
                "Files that wait to be read",
                Family::default(),
            ),
            reading: kept(
                &mut registry,
                "armwatch_files_reading",
                "Files that are being read",
                Family::default(),
            ),
            watched_files: kept(
                &mut registry,
                "armwatch_watched_files",
                "Exports in the watched folders at the last look",
                Gauge::default(),
            ),
            scan_seconds: kept(
                &mut registry,
                "armwatch_scan_duration_seconds",
                "A look at the watched folders",
                Histogram::new(WORK_SECONDS),
            ),
            folder_looked_at: kept(
                &mut registry,
                "armwatch_folder_last_scan_timestamp_seconds",
                "When this process last looked into the watched folder, seconds since 1970; 0 before the first look",
                Family::default(),
            ),
            folder_answers: kept(
                &mut registry,
                "armwatch_folder_answers",
                "Whether the watched folder's disk or file server answers: 1, or 0 while a look at it hangs",
                Family::default(),
            ),
            folders: Mutex::default(),
            disk_answers: kept(
                &mut registry,
                "armwatch_disk_answers",
                "Whether the disk of the database, snapshot or spool answers: 1, or 0 while a write to it hangs",
                Family::default(),
            ),
            disks: Mutex::default(),
            live,
            snapshot_time: kept(
                &mut registry,
                "armwatch_snapshot_timestamp_seconds",
                "When this process wrote the last copy of the database, seconds since 1970; 0 before the first",
                TimeGauge::default(),
            ),
            snapshot_bytes: kept(
                &mut registry,
                "armwatch_snapshot_size_bytes",
                "Size of that copy",
                Gauge::default(),
            ),
            snapshot_seconds: kept(
                &mut registry,
                "armwatch_snapshot_duration_seconds",
                "Writing a copy of the database",
                Histogram::new(WORK_SECONDS),
            ),
            snapshot_failures: kept(
                &mut registry,
                "armwatch_snapshot_failures",
                "Copies of the database that could not be written",
                Counter::default(),
            ),
            requests: kept(
                &mut registry,
                "armwatch_http_requests",
                "Requests that were answered",
                Family::default(),
            ),
            request_seconds: kept(
                &mut registry,
                "armwatch_http_request_duration_seconds",
                "From a request's headers to those of its answer; events go on after that",
                histograms(|| Histogram::new(ANSWER_SECONDS)),
            ),
            registry,
        };
        // events that never happened are 0, not missing
        for stage in WorkStage::ALL {
            drop(families.stage_seconds.get_or_create(&labels([("stage", stage.name())])));
        }
        for end in ExportEnd::ALL {
            drop(families.exports.get_or_create(&labels([("end", end.name())])));
        }
        for queue in Queue::ALL {
            let labels = labels([("queue", queue.name())]);
            drop(families.waiting.get_or_create(&labels));
            drop(families.reading.get_or_create(&labels));
        }
        families
    }
}

/// Metrics of a growing file that is being read; they are removed when the last handle of its robot is dropped.
#[derive(Debug)]
pub struct LiveFile {
    metrics: Metrics,
    robot: String,
}

impl LiveFile {
    /// Counts read rows.
    pub fn read(&self) {
        self.metrics.with(|of| set_now(&of.live.last_read, &self.robot));
    }

    /// Counts a stored cycle.
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
                    figure.remove(&labels([("robot", &self.robot)]));
                }
            }
        });
    }
}

/// Registers a family.
fn kept<M: Metric + Clone>(registry: &mut Registry, name: &str, help: &str, family: M) -> M {
    registry.register(name, help, family.clone());
    family
}

fn histograms<const N: usize>(empty: fn() -> Histogram) -> Histograms<N> {
    Family::new_with_constructor(empty)
}

fn labels<const N: usize>(of: [(&'static str, &str); N]) -> Labels<N> {
    of.map(|(name, value)| (name, value.to_owned()))
}

fn whole(count: impl TryInto<i64>) -> i64 {
    count.try_into().unwrap_or(i64::MAX)
}

fn folder_labels(folder: &Path) -> Labels<1> {
    labels([("folder", &folder.display().to_string())])
}

fn set_now(family: &Family<Labels<1>, TimeGauge>, robot: &str) {
    family.get_or_create(&labels([("robot", robot)])).set(now());
}

/// Seconds since 1970.
fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests;
