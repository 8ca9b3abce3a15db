//! Exports being read: growing ones in places of their own, settled ones a few of each class.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio::task::{JoinHandle, JoinSet};
use tokio_util::sync::CancellationToken;

use super::archive;
use super::file_schedule::{Closing, FileSchedule, NextAttempt};
use super::places::{FilePlaces, HANGING, Place, SAID_AFTER, hangs_for, say_hanging};
use super::turn::{Class, ReadMode, named_robot};
use crate::metrics::{LiveFile, Queue};
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::pipeline::take::follow::{Ends, Followed};
use armwatch_config::Config;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_model::run::FileId;

/// Counting the waiting files may take at most this fraction (1/n) of the daemon's time.
const COUNTING_SHARE: u32 = 100;

/// Time between two checks during a stop that file systems answer.
const ANSWERS_LOOKED_AT: Duration = Duration::from_millis(500);

/// A file whose task has ended.
pub(super) struct Closed {
    pub(super) due: NextAttempt,
    pub(super) way: ReadMode,
    pub(super) result: Result<Followed, PipelineError>,
}

/// Progress of a file.
type Progressed = (FileId, Progress);

/// An event of an export that is being read.
pub(super) enum Happened {
    /// A task has ended.
    Ended(Box<Closed>),
    /// Cycles of a run that is still being written were stored.
    Grown(i64),
    /// Other exports can start.
    Progressed,
}

/// A settled file that is being read.
struct SettledFile {
    path: PathBuf,
    robot: String,
    class: Class,
    access: FileAccess,
    /// Its run has no number yet. Only one per class may be in this state, so that numbers follow names, and of two
    /// files with the same content (and size) the first by name is read.
    is_admitting: bool,
    /// Its hanging read was logged.
    said: bool,
}

impl SettledFile {
    fn hangs(&self, now: Instant) -> bool {
        hangs_for(&self.access, HANGING, now)
    }
}

/// The tasks that read exports, and their limits.
pub(super) struct ExportTasks {
    stop: CancellationToken,
    tasks: JoinSet<Closed>,
    /// Growing files being read.
    places: FilePlaces,
    /// Earliest time of the next count of waiting files.
    next_count: Instant,
    /// Settled files being read.
    settled: HashMap<FileId, SettledFile>,
    progress: (mpsc::UnboundedSender<Progressed>, mpsc::UnboundedReceiver<Progressed>),
}

impl ExportTasks {
    /// Starts without tasks; `stop` ends each at its next cycle.
    pub(super) fn new(stop: CancellationToken) -> Self {
        Self {
            stop,
            tasks: JoinSet::new(),
            places: FilePlaces::default(),
            next_count: Instant::now(),
            settled: HashMap::new(),
            progress: mpsc::unbounded_channel(),
        }
    }

    pub(super) fn count(&self) -> usize {
        self.tasks.len()
    }

    /// Returns true if a settled export of a robot is being read.
    pub(super) fn reads_settled(&self, robot: &str) -> bool {
        self.settled.values().any(|of| of.robot == robot)
    }

    /// Settled files being read that delay others: a file whose file system does not answer does not.
    fn reading(&self, now: Instant) -> impl Iterator<Item = &SettledFile> {
        self.settled.values().filter(move |of| !of.hangs(now))
    }

    /// Waits for the end of a task; `None` if there is none.
    pub(super) async fn next(&mut self) -> Option<Result<Closed, PipelineError>> {
        Some(self.tasks.join_next().await?.map_err(PipelineError::from))
    }

    /// Like [`ExportTasks::next`]; `None` also if the file systems of all remaining exports have not answered for
    /// `time`.
    pub(super) async fn next_answering(&mut self, time: Duration) -> Option<Result<Closed, PipelineError>> {
        loop {
            if let Ok(next) = tokio::time::timeout(ANSWERS_LOOKED_AT, self.next()).await {
                return next;
            }
            let now = Instant::now();
            let settled =
                self.settled.values().filter(|of| hangs_for(&of.access, time, now)).map(|of| &*of.path);
            let hanging: Vec<&Path> = settled.chain(self.places.hanging_for(time, now)).collect();
            if hanging.len() < self.tasks.len() {
                continue;
            }
            for path in hanging {
                tracing::warn!(file = %path.display(), "not finished, its disk or file server does not answer; stored cycles stay");
            }
            return None;
        }
    }

    /// Waits for the next event of an export; may be dropped before.
    pub(super) async fn happened(&mut self) -> Result<Happened, PipelineError> {
        tokio::select! {
            Some(closed) = self.tasks.join_next() => Ok(Happened::Ended(Box::new(closed?))),
            Some((file, progress)) = self.progress.1.recv() => Ok(self.progressed(file, progress)),
            else => std::future::pending().await,
        }
    }

    fn progressed(&mut self, file: FileId, progress: Progress) -> Happened {
        match progress {
            Progress::Begun => self.admitted(file),
            Progress::CaughtUp => self.places.caught_up(file, Instant::now()),
            Progress::Grown(run_id) => return Happened::Grown(run_id),
            Progress::Read(_) | Progress::Cycle(_) => {}
        }
        Happened::Progressed
    }

    /// Time when a place becomes free without an event.
    pub(super) fn next_look(&self, schedule: &FileSchedule, now: Instant) -> Option<Instant> {
        let settled = self.settled.values().filter_map(|of| Some(of.access.asks_since()? + HANGING));
        let places = self.places.next_look(schedule.growing_waiting() > 0, now);
        settled.filter(|end| *end > now).chain(places).min()
    }

    /// Returns true if another settled export of a class may start, with `most` read at once.
    pub(super) fn has_place(&self, class: Class, most: usize) -> bool {
        let now = Instant::now();
        let of_class = || self.reading(now).filter(move |of| of.class == class);
        of_class().count() < most && !of_class().any(|of| of.is_admitting)
    }

    /// Gives a settled export its place.
    pub(super) fn admit(&mut self, due: &NextAttempt, robot: &str, class: Class, access: FileAccess) {
        let (path, robot) = (due.path.clone(), robot.to_owned());
        let settled = SettledFile { path, robot, class, access, is_admitting: true, said: false };
        self.settled.insert(due.file, settled);
    }

    /// Frees the place of an export whose task has ended. Returns how many bytes of a growing one were read.
    pub(super) fn free(&mut self, due: &NextAttempt, way: &ReadMode) -> u64 {
        match way {
            ReadMode::Growing => self.places.take_back(due.file),
            ReadMode::Settled(..) => {
                self.settled.remove(&due.file);
                0
            }
        }
    }

    /// Watched folders with a hanging read: opening more of their files would hang too.
    fn hanging_folders(&mut self, config: &Config, now: Instant) -> Vec<PathBuf> {
        for of in self.settled.values_mut().filter(|of| !of.said && hangs_for(&of.access, SAID_AFTER, now)) {
            of.said = true;
            say_hanging(&of.path);
        }
        let settled = self.settled.values().filter(|of| of.hangs(now)).map(|of| &*of.path);
        let hanging: Vec<&Path> = settled.chain(self.places.hanging_for(HANGING, now)).collect();
        if hanging.is_empty() {
            return Vec::new();
        }
        let folders: Vec<PathBuf> =
            config.watch.folders.iter().map(|folder| archive::from_root(folder)).collect();
        let around = |path: &Path| {
            folders
                .iter()
                .filter(|folder| path.starts_with(folder))
                .max_by_key(|of| of.components().count())
                .cloned()
        };
        hanging.into_iter().filter_map(around).collect()
    }

    /// Starts as many tasks as the limits allow, for growing files first.
    pub(super) fn begin(&mut self, pipeline: &Pipeline, schedule: &mut FileSchedule) {
        let (now, most) = (Instant::now(), pipeline.config().watch.live_files);
        self.places.say_hanging(now);
        let hanging = self.hanging_folders(pipeline.config(), now);
        let answers = |path: &Path| !hanging.iter().any(|folder| path.starts_with(folder));
        while self.places.has_free(most, now)
            && let Some(due) = schedule.next_growing(answers)
        {
            self.follow(pipeline, due, now);
        }
        let waiting = schedule.growing_waiting();
        if waiting > 0 && self.places.are_taken(most, now) {
            self.places.say_short(waiting, most);
            self.places.ask(waiting, now);
        }
        let config = pipeline.config();
        let most = config.limits.backlog_files;
        for class in Class::ALL {
            let busy: HashSet<String> = self.reading(now).map(|of| of.robot.clone()).collect();
            if self.has_place(class, most)
                && let Some((due, robot)) =
                    schedule.next_settled(&busy, answers, |bytes| Class::of(bytes, config) == class)
            {
                self.take(pipeline, due, robot, class);
            }
        }
    }

    /// Updates the counts of waiting files and of files being read. Each waiting file is examined, so that a long queue
    /// is not counted at every event.
    pub(super) fn count_queues(&mut self, pipeline: &Pipeline, schedule: &FileSchedule) {
        let began = Instant::now();
        if began < self.next_count {
            return;
        }
        let (metrics, config) = (pipeline.metrics(), pipeline.config());
        metrics.queue(Queue::Growing, schedule.growing_waiting(), self.places.count());
        for (class, queue) in [(Class::Small, Queue::Small), (Class::Large, Queue::Large)] {
            let waiting = schedule.settled_waiting(|bytes| Class::of(bytes, config) == class);
            let reading = self.settled.values().filter(|of| of.class == class).count();
            metrics.queue(queue, waiting, reading);
        }
        self.next_count = Instant::now() + COUNTING_SHARE * began.elapsed();
    }

    /// Notes that the run of a file has its number.
    fn admitted(&mut self, file: FileId) {
        if let Some(settled) = self.settled.get_mut(&file) {
            settled.is_admitting = false;
        }
    }

    /// Starts to read a growing file.
    fn follow(&mut self, pipeline: &Pipeline, due: NextAttempt, now: Instant) {
        let access = access(pipeline.config());
        let place = self.places.give(due.file, &due.path, access.clone(), &self.stop, now);
        let Place { sign, give_way } = place;
        let (pipeline, sender) = (pipeline.opening(&access), self.progress.0.clone());
        let (ends, file) = (Ends { stop: self.stop.clone(), give_way }, due.file);
        let live = named_robot(pipeline.config(), &due.path).map(|robot| pipeline.metrics().live(&robot));
        let live = Arc::new(live);
        let progress = move |progress| {
            match progress {
                Progress::Read(bytes) => {
                    if sign.has_read(bytes) {
                        live.iter().for_each(LiveFile::read);
                    }
                }
                Progress::Begun | Progress::CaughtUp | Progress::Grown(_) => {
                    // the receiver is gone when the daemon ends
                    let _ = sender.send((file, progress));
                }
                Progress::Cycle(_) => live.iter().for_each(LiveFile::stored),
            }
        };
        self.tasks.spawn(async move {
            let (path, patience) = (due.path.clone(), due.patience);
            let reading =
                on_own_thread(access, async move { pipeline.follow(&path, patience, &ends, progress).await });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Growing, result }
        });
    }

    /// Starts to read a settled file.
    fn take(&mut self, pipeline: &Pipeline, due: NextAttempt, robot: String, class: Class) {
        let access = access(pipeline.config());
        self.admit(&due, &robot, class, access.clone());
        let (pipeline, stop) = (pipeline.opening(&access), self.stop.clone());
        let (sender, file) = (self.progress.0.clone(), due.file);
        let progress = move |progress| {
            if progress == Progress::Begun {
                // the receiver is gone when the daemon ends
                let _ = sender.send((file, progress));
            }
        };
        self.tasks.spawn(async move {
            let (path, bytes) = (due.path.clone(), due.seen.size);
            let reading = on_own_thread(access, async move {
                let outcome = pipeline.process(&path, Retry::Never, &stop, progress).await?;
                archive::after(&pipeline, &path, bytes, &outcome).await?;
                Ok(Followed::Outcome(outcome))
            });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Settled(robot, class), result }
        });
    }
}

/// How the daemon opens the files that it finds.
fn access(config: &Config) -> FileAccess {
    match config.watch.follow_links {
        true => FileAccess::default(),
        false => FileAccess::within(config.watch.folders.iter().map(|folder| archive::from_root(folder))),
    }
}

/// Runs a task on a separate thread, so that a file system without an answer blocks no other task.
pub(super) fn on_own_thread<T: Send + 'static>(
    access: FileAccess,
    task: impl Future<Output = T> + Send + 'static,
) -> JoinHandle<T> {
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || access.during(|| runtime.block_on(task)))
}

/// The result for a file after `read` of its bytes were read while it grew.
pub(super) fn closing(followed: &Followed, way: &ReadMode, read: u64) -> Closing {
    match (followed, way) {
        (Followed::GaveWay, _) => Closing::GaveWay(read),
        (Followed::UntilSettled, _) => Closing::UntilSettled,
        (Followed::Blocked(_), _) => Closing::Blocked,
        (Followed::NotYet, _) => Closing::Again,
        (Followed::Outcome(Outcome::Changed | Outcome::InWork { .. } | Outcome::Interrupted), _) => {
            Closing::Again
        }
        (Followed::Outcome(Outcome::Unreadable { .. }), _) => Closing::Unreadable,
        (Followed::Outcome(_), ReadMode::Growing) => Closing::Done(read),
        (Followed::Outcome(_), ReadMode::Settled(..)) => Closing::Taken,
    }
}
