//! Histories evaluated window by window, without a database.

use super::{Lengths, Windowed, is_over, next, put_together};
use armwatch_model::anomaly::Anomaly;
use armwatch_model::anomaly::settled::{Moment, Settled};

/// Results of a history: settled anomalies, boundary by boundary, and the others.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::detect) struct Said {
    pub(in crate::detect) settled: Vec<(Settled, Vec<Anomaly>)>,
    pub(in crate::detect) others: Vec<Anomaly>,
    /// Runs of the longest window.
    pub(in crate::detect) longest: usize,
}

impl Said {
    pub(in crate::detect) fn all(&self) -> Vec<&Anomaly> {
        self.settled.iter().flat_map(|(_, ended)| ended).chain(&self.others).collect()
    }
}

/// A run whose window can be evaluated.
pub(in crate::detect) trait Judged: Clone {
    /// Its place in time.
    fn moment_of(&self) -> Moment;
    /// The detectors.
    fn found(window: &[Self]) -> Vec<Anomaly>;
    /// Calls `with` with the runs as windows see them.
    fn as_windowed<T>(window: &[Self], with: impl WithRuns<T>) -> T;
}

/// A function of runs of any kind.
pub(in crate::detect) trait WithRuns<T> {
    fn call(self, runs: &[impl Windowed]) -> T;
}

/// Evaluates one window: its anomalies, and the state at the next boundary if that is in force.
struct OneWindow<'a> {
    settled: &'a Settled,
    found: Vec<Anomaly>,
    lengths: &'a Lengths,
}

impl WithRuns<(Vec<Anomaly>, Option<(Settled, Vec<Anomaly>)>)> for OneWindow<'_> {
    fn call(self, runs: &[impl Windowed]) -> (Vec<Anomaly>, Option<(Settled, Vec<Anomaly>)>) {
        let together = put_together(self.settled, runs, self.found);
        let next = is_over(self.settled, runs, self.lengths)
            .then(|| next(self.settled, runs, &together, self.lengths));
        (together, next)
    }
}

/// Runs of the window of a boundary, at most as many as the store would read.
fn window<Run: Judged>(history: &[Run], settled: &Settled, lengths: &Lengths) -> Vec<Run> {
    let read = history.iter().filter(|run| settled.read.contains(&run.moment_of().1));
    let leads_in = |run: &&Run| {
        let at = Some(run.moment_of());
        settled.leads_from <= at && at < settled.boundary
    };
    let behind = history.iter().filter(|run| settled.boundary.is_none_or(|of| run.moment_of() >= of));
    let leads_in = history.iter().filter(leads_in);
    read.chain(leads_in).chain(behind.take(2 * lengths.step)).cloned().collect()
}

/// Results of a history with some settled boundaries.
pub(in crate::detect) fn said<Run: Judged>(
    history: &[Run],
    known: Vec<(Settled, Vec<Anomaly>)>,
    lengths: &Lengths,
) -> Said {
    let mut said = Said { settled: known, ..Said::default() };
    loop {
        let settled = said.settled.last().map(|(settled, _)| settled.clone()).unwrap_or_default();
        let runs = window(history, &settled, lengths);
        said.longest = said.longest.max(runs.len());
        let found = Run::found(&runs);
        let one = OneWindow { settled: &settled, found, lengths };
        match Run::as_windowed(&runs, one) {
            (_, Some(next)) => said.settled.push(next),
            (together, None) => {
                said.others = together;
                return said;
            }
        }
    }
}

/// Anomalies as text for comparisons, since NaN values equal nothing.
pub(in crate::detect) fn words(of: &[&Anomaly]) -> Vec<String> {
    of.iter().map(|of| format!("{of:?}")).collect()
}
