//! Reading and analysis of an export at once: a thread that cuts cycles, and analyses on blocking threads.

use std::sync::Arc;
use std::thread::{self, available_parallelism};
use std::time::Instant;

use tokio::sync::{Semaphore, mpsc};
use tokio::task::{JoinError, JoinHandle};

use super::context::InAnalysis;
use super::production::CycleWork;
use super::take::cutting::CutCycle;
use crate::metrics::{Metrics, WorkStage};
use armwatch_method::buffers::Buffers;
use armwatch_method::spare_threads::SpareThreads;

/// Cycles between the reading thread and analysis; reading pauses until the last one is taken. One is enough to keep
/// both busy; each takes 12 MB at 250 Hz and five minutes.
const CYCLES_READ_AHEAD: usize = 1;

/// Most cycles of one export under analysis at once. Reading a cycle takes a third of the time of its analysis, so that
/// more would wait for rows; each takes 30 MB at 250 Hz and five minutes.
const MOST_IN_ANALYSIS: usize = 4;

/// Threads for analyses in each lane, for any number of exports: the number of processors available to the program.
pub(super) fn analysis_threads() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Cycles of one export under analysis at once.
pub(super) fn cycles_in_analysis() -> usize {
    analysis_threads().clamp(2, MOST_IN_ANALYSIS)
}

/// Threads of `places` that no analysis uses.
pub(super) fn spare_threads(places: &Arc<Semaphore>) -> SpareThreads {
    let places = Arc::clone(places);
    SpareThreads::lent_by(move |most, work| {
        let loans = (0..most).map_while(|_| Arc::clone(&places).try_acquire_owned().ok());
        thread::scope(|scope| {
            for loan in loans {
                let lent = move || {
                    work();
                    drop(loan);
                };
                // if no more threads can be started, this one does all parts
                let _ = thread::Builder::new().name("analysis".into()).spawn_scoped(scope, lent);
            }
            work();
        });
    })
}

/// An export that is being read and analysed. Dropping it ends both.
#[derive(Debug)]
pub(super) struct Streaming<E> {
    /// Analyses in the order of the cycles.
    pub(super) analyses: mpsc::Receiver<InAnalysis>,
    tasks: Tasks<E>,
}

/// The tasks that read and analyse.
#[derive(Debug)]
pub(super) struct Tasks<E> {
    reader: JoinHandle<E>,
    analyser: JoinHandle<()>,
}

impl<E: Send + 'static> Streaming<E> {
    /// Starts both tasks; `read` runs on a blocking thread. The memory of cycles' channels returns to `buffers`, and
    /// from there optionally to `read`.
    pub(super) fn start(
        work: CycleWork,
        places: Arc<Semaphore>,
        metrics: Metrics,
        buffers: Buffers,
        read: impl FnOnce(mpsc::Sender<CutCycle>) -> E + Send + 'static,
    ) -> Self {
        let (to_analysis, cycles) = mpsc::channel::<CutCycle>(CYCLES_READ_AHEAD);
        // the awaited task and those in the channel are the cycles in analysis
        let (to_record, analyses) = mpsc::channel::<InAnalysis>(cycles_in_analysis() - 1);
        let reader = tokio::task::spawn_blocking(move || read(to_analysis));
        let analyser = tokio::spawn(analyse_in_order(work, places, cycles, to_record, (metrics, buffers)));
        Self { analyses, tasks: Tasks { reader, analyser } }
    }

    /// The analyses, and the tasks that make them.
    pub(super) fn into_parts(self) -> (mpsc::Receiver<InAnalysis>, Tasks<E>) {
        (self.analyses, self.tasks)
    }
}

impl<E> Tasks<E> {
    /// How reading ended. The receiver must have taken all analyses or dropped the rest, so that both tasks end.
    ///
    /// # Errors
    /// A panic of either.
    pub(super) async fn ended(self) -> Result<E, JoinError> {
        self.analyser.await?;
        self.reader.await
    }
}

/// Starts analyses as cycles arrive and sends their handles in the order of the cycles.
async fn analyse_in_order(
    work: CycleWork,
    places: Arc<Semaphore>,
    mut cycles: mpsc::Receiver<CutCycle>,
    to_record: mpsc::Sender<InAnalysis>,
    (metrics, buffers): (Metrics, Buffers),
) {
    let mut bytes = 0;
    let spare = spare_threads(&places);
    // a cycle is not taken before its turn: waiting cycles fill the memory
    while let Ok(turn) = to_record.reserve().await {
        let Some(CutCycle { cycle, remarks, read, took, written, mut held }) = cycles.recv().await else {
            return;
        };
        metrics.stage(WorkStage::Read, took);
        let until = read.prefix.bytes;
        metrics.cycle_read(cycle.samples.rows(), until.saturating_sub(bytes));
        bytes = until;
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        held.may_be_analysed().await;
        let (work, metrics) = (work.clone(), metrics.clone());
        let (buffers, spare) = (buffers.clone(), spare.clone());
        let analysis = tokio::task::spawn_blocking(move || {
            let began = Instant::now();
            let mut analysis = work.analyse_in(cycle, &buffers, &spare);
            analysis.remarks.extend(remarks);
            metrics.stage(WorkStage::Analyse, began.elapsed());
            drop(place);
            held.is_analysed(&analysis);
            (analysis, held)
        });
        turn.send(InAnalysis { analysis, read, written });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn free_places_are_threads_that_work_at_once_and_are_given_back() {
        let places = Arc::new(Semaphore::new(2));
        let spare = spare_threads(&places);
        let all_there = Barrier::new(3);
        let threads = spare.each(
            3,
            || (),
            |(), _| {
                all_there.wait();
                thread::current().id()
            },
        );
        assert_eq!(threads.into_iter().collect::<HashSet<_>>().len(), 3);
        assert_eq!(places.available_permits(), 2);
        let both_taken = places.try_acquire_many(2).expect("two places");
        let threads = spare.each(3, || (), |(), _| thread::current().id());
        assert_eq!(threads, vec![thread::current().id(); 3]);
        drop(both_taken);
        let work = || spare.each(4, || (), |(), part| assert!(part != 2, "no part two"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err());
        assert_eq!(places.available_permits(), 2);
    }
}
