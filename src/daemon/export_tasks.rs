//! Exports being read: growing ones in places of their own, settled ones a few of each class.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Instant;

use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use super::archive;
use super::file_schedule::{Closing, FileSchedule, NextAttempt};
use super::places::{Place, Places};
use super::turn::{Class, ReadMode, named_robot};
use crate::metrics::{LiveFile, Queue};
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::pipeline::take::follow::{Ends, Followed};
use armwatch_model::run::FileId;

/// Counting the files that wait may take at most one part in so many of the daemon's time.
const COUNTING_SHARE: u32 = 100;

/// A file whose task has ended.
pub(super) struct Closed {
    pub(super) due: NextAttempt,
    pub(super) way: ReadMode,
    pub(super) result: Result<Followed, PipelineError>,
}

/// How far which file has come.
type Progressed = (FileId, Progress);

/// What became of exports that are being read.
pub(super) enum Happened {
    /// The task of one has ended.
    Ended(Box<Closed>),
    /// Cycles of a run that is still being written were stored.
    Grown(i64),
    /// Others can be begun.
    Progressed,
}

/// The tasks that read exports, and how many there may be.
pub(super) struct ExportTasks {
    stop: CancellationToken,
    tasks: JoinSet<Closed>,
    /// Growing files being read.
    places: Places,
    /// When the files that wait are counted again at the earliest.
    next_count: Instant,
    /// Robots with a settled file being read.
    robots: HashSet<String>,
    /// Settled files being read, of each class.
    settled: [usize; Class::ALL.len()],
    /// A settled file of each class whose run has no number yet. One at a time, so that numbers follow names,
    /// and of two files with one content, which have one size, the first by name is taken.
    admitting: [Option<FileId>; Class::ALL.len()],
    progress: (mpsc::UnboundedSender<Progressed>, mpsc::UnboundedReceiver<Progressed>),
}

impl ExportTasks {
    /// None yet; `stop` ends each at its next cycle.
    pub(super) fn new(stop: CancellationToken) -> Self {
        Self {
            stop,
            tasks: JoinSet::new(),
            places: Places::default(),
            next_count: Instant::now(),
            robots: HashSet::new(),
            settled: [0; Class::ALL.len()],
            admitting: [None; Class::ALL.len()],
            progress: mpsc::unbounded_channel(),
        }
    }

    pub(super) fn count(&self) -> usize {
        self.tasks.len()
    }

    /// Whether a settled export of a robot is being read.
    pub(super) fn reads_settled(&self, robot: &str) -> bool {
        self.robots.contains(robot)
    }

    /// Waits for the end of a task; `None` where there is none.
    pub(super) async fn next(&mut self) -> Option<Result<Closed, PipelineError>> {
        Some(self.tasks.join_next().await?.map_err(PipelineError::from))
    }

    /// Waits until something becomes of an export; may be dropped before.
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
            Progress::Reading | Progress::Read(_) | Progress::Cycle(_) => {}
        }
        Happened::Progressed
    }

    /// When a place falls free though nothing happens.
    pub(super) fn next_look(&self, schedule: &FileSchedule, now: Instant) -> Option<Instant> {
        self.places.next_look(schedule.growing_waiting() > 0, now)
    }

    /// Whether another settled export of a class may be begun, where so many are read at once.
    pub(super) fn has_place(&self, class: Class, most: usize) -> bool {
        self.settled[class as usize] < most && self.admitting[class as usize].is_none()
    }

    /// Gives a settled export its place.
    pub(super) fn admit(&mut self, file: FileId, robot: &str, class: Class) {
        self.robots.insert(robot.to_owned());
        self.settled[class as usize] += 1;
        self.admitting[class as usize] = Some(file);
    }

    /// Frees the place of an export whose task has ended. Returns how many bytes were read of one that grows.
    pub(super) fn free(&mut self, due: &NextAttempt, way: &ReadMode) -> u64 {
        self.admitted(due.file);
        match way {
            ReadMode::Growing => self.places.take_back(due.file),
            ReadMode::Settled(robot, class) => {
                self.robots.remove(robot);
                self.settled[*class as usize] -= 1;
                0
            }
        }
    }

    /// Starts as many tasks as there may be, for growing files first.
    pub(super) fn begin(&mut self, pipeline: &Pipeline, schedule: &mut FileSchedule) {
        let (now, most) = (Instant::now(), pipeline.config().watch.live_files);
        self.places.say_hanging(now);
        while self.places.has_free(most, now)
            && let Some(due) = schedule.next_growing()
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
        let mut starting = Vec::new();
        for class in Class::ALL {
            if self.has_place(class, most)
                && let Some((due, robot)) =
                    schedule.next_settled(&self.robots, |bytes| Class::of(bytes, config) == class)
            {
                self.admit(due.file, &robot, class);
                starting.push((due, robot, class));
            }
        }
        starting.into_iter().for_each(|(due, robot, class)| self.take(pipeline, due, robot, class));
    }

    /// Tells how many files wait and are being read. Each file that waits is looked at, so that of a long queue it is
    /// not told with every event.
    pub(super) fn count_queues(&mut self, pipeline: &Pipeline, schedule: &FileSchedule) {
        let began = Instant::now();
        if began < self.next_count {
            return;
        }
        let (metrics, config) = (pipeline.metrics(), pipeline.config());
        metrics.queue(Queue::Growing, schedule.growing_waiting(), self.places.count());
        for (class, queue) in [(Class::Small, Queue::Small), (Class::Large, Queue::Large)] {
            let waiting = schedule.settled_waiting(|bytes| Class::of(bytes, config) == class);
            metrics.queue(queue, waiting, self.settled[class as usize]);
        }
        self.next_count = Instant::now() + COUNTING_SHARE * began.elapsed();
    }

    /// Notes that the run of a file has its number, or that the file is closed.
    fn admitted(&mut self, file: FileId) {
        for place in &mut self.admitting {
            place.take_if(|admitting| *admitting == file);
        }
    }

    /// Begins to read a growing file.
    fn follow(&mut self, pipeline: &Pipeline, due: NextAttempt, now: Instant) {
        let Place { sign, give_way } = self.places.give(due.file, &due.path, &self.stop, now);
        let (pipeline, sender) = (pipeline.clone(), self.progress.0.clone());
        let (ends, file) = (Ends { stop: self.stop.clone(), give_way }, due.file);
        let live = named_robot(pipeline.config(), &due.path).map(|robot| pipeline.metrics().live(&robot));
        let live = Arc::new(live);
        let progress = move |progress| {
            match progress {
                Progress::Reading => sign.reads(Instant::now()),
                Progress::Read(bytes) => {
                    if sign.has_read(bytes) {
                        live.iter().for_each(LiveFile::read);
                    }
                }
                Progress::Begun | Progress::CaughtUp => {
                    sign.waits_for_others();
                    // nobody listens any more when the daemon ends
                    let _ = sender.send((file, progress));
                }
                Progress::Grown(_) => {
                    let _ = sender.send((file, progress));
                }
                Progress::Cycle(_) => live.iter().for_each(LiveFile::stored),
            }
        };
        self.tasks.spawn(async move {
            let (path, patience) = (due.path.clone(), due.patience);
            let reading =
                tokio::spawn(async move { pipeline.follow(&path, patience, &ends, progress).await });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Growing, result }
        });
    }

    /// Begins to read a settled file.
    fn take(&mut self, pipeline: &Pipeline, due: NextAttempt, robot: String, class: Class) {
        let (pipeline, stop) = (pipeline.clone(), self.stop.clone());
        let (sender, file) = (self.progress.0.clone(), due.file);
        let progress = move |progress| {
            if progress == Progress::Begun {
                // nobody listens any more when the daemon ends
                let _ = sender.send((file, progress));
            }
        };
        self.tasks.spawn(async move {
            let path = due.path.clone();
            let reading = tokio::spawn(async move {
                let outcome = pipeline.process(&path, Retry::Never, &stop, progress).await?;
                archive::after(&pipeline, &path, &outcome).await;
                Ok(Followed::Outcome(outcome))
            });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Settled(robot, class), result }
        });
    }
}

/// What becomes of a file of which so many bytes were read while it grew.
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
        (Followed::Outcome(_), ReadMode::Growing) => Closing::Done,
        (Followed::Outcome(_), ReadMode::Settled(..)) => Closing::Taken,
    }
}
