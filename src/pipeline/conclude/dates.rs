//! Recordings with implausible starts: they are reported, and excluded if they are out of order.

use jiff::Timestamp;

use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset, Severity};
use armwatch_model::run::RunKind;
use armwatch_model::run::arrival::{Arrival, DateProblem, ImplausibleDate, implausible_dates};
use armwatch_store::{DatedRun, StaleRobot};

/// Most recordings that a message names.
const MOST_NAMED: usize = 3;

/// A robot is unwatched if this many of its latest arrived tests are all excluded.
const UNWATCHED: usize = 3;

/// A recording with an implausible start.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Misdated {
    run: DatedRun,
    date: ImplausibleDate,
    /// Latest start of the included recordings that had arrived before: its place in the history.
    place: Timestamp,
}

/// The result of checking the starts of a robot's recordings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct JudgedDates {
    misdated: Vec<Misdated>,
    /// Number of latest tests that are all excluded.
    tests_left_out: usize,
    /// True if recordings left the history or came back, so that it must be read again.
    pub(super) changes_history: bool,
}

impl Pipeline {
    /// Checks the starts of a robot's recordings, and stores the changes.
    ///
    /// # Errors
    /// Those of the store.
    pub(super) async fn judge_dates(&self, robot: &StaleRobot) -> Result<JudgedDates, PipelineError> {
        let runs = self.store.dated_runs(&robot.name).await?;
        let mut judged = JudgedDates { misdated: Vec::new(), tests_left_out: 0, changes_history: false };
        let mut changed = Vec::new();
        for kind in [RunKind::Test, RunKind::Production] {
            let of_kind: Vec<&DatedRun> = runs.iter().filter(|run| run.kind == kind).collect();
            let mut latest = None;
            for (&run, date) in of_kind.iter().zip(self.implausible(&robot.name, &of_kind)) {
                let is_set_aside = date.is_some_and(|date| !date.is_in_order);
                if run.problem != date.map(|date| date.to_string()) || run.is_set_aside != is_set_aside {
                    judged.changes_history |= run.is_set_aside != is_set_aside;
                    changed.push((run.run_id, date));
                }
                if !is_set_aside {
                    latest = latest.max(Some(run.started_at));
                }
                if kind == RunKind::Test {
                    judged.tests_left_out = if is_set_aside { judged.tests_left_out + 1 } else { 0 };
                }
                if let Some(date) = date {
                    let place = latest.unwrap_or(run.started_at);
                    judged.misdated.push(Misdated { run: run.clone(), date, place });
                }
            }
        }
        if !changed.is_empty() {
            self.store.mark_dates(&changed).await?;
        }
        let is_new = |of: &&Misdated| changed.iter().any(|(run_id, _)| *run_id == of.run.run_id);
        for Misdated { run, date, .. } in judged.misdated.iter().filter(is_new) {
            let effect = if date.is_in_order { "its order of arrival counts" } else { "it is excluded" };
            tracing::warn!(
                robot = robot.name,
                run_id = run.run_id,
                "{} is {date}: {effect}; `armwatch run-date {} --at TIME` corrects its start",
                run.source_name,
                run.run_id
            );
        }
        Ok(judged)
    }

    /// Implausible starts among recordings of one kind, in the order of their arrival.
    fn implausible(&self, robot: &str, runs: &[&DatedRun]) -> Vec<Option<ImplausibleDate>> {
        let mut arrivals: Vec<Arrival<'_>> =
            runs.iter().map(|run| Arrival { file_time: None, ..run.arrival() }).collect();
        let found = implausible_dates(&arrivals);
        if found.iter().all(Option::is_none) {
            return found;
        }
        // the time of a file is evidence for a start only if the start does not follow from it
        for (arrival, run) in arrivals.iter_mut().zip(runs) {
            arrival.file_time = run.file_time.filter(|_| self.config.names_start(robot, &run.source_name));
        }
        implausible_dates(&arrivals)
    }
}

impl JudgedDates {
    /// The anomaly that names them.
    pub(super) fn anomaly(&self) -> Option<Anomaly> {
        let (first, last) = (self.misdated.first()?, self.misdated.last()?);
        let (from, to) =
            (self.misdated.iter().map(|of| of.place).min()?, self.misdated.iter().map(|of| of.place).max()?);
        let days = |of: &Misdated| match of.date.problem {
            DateProblem::AfterArrival(by)
            | DateProblem::AheadOfLater(by)
            | DateProblem::YearsBefore(by)
            | DateProblem::OutOfOrder(by) => by.as_hours() as f64 / 24.0,
            DateProblem::SameStart(_) => 0.0,
        };
        let most = self.misdated.iter().map(days).fold(0.0, f64::max);
        // no other message reports that alarms cannot open any more
        let severity = if self.is_unwatched() { Severity::Warning } else { Severity::Info };
        Some(Anomaly {
            joint: None,
            kind: AnomalyKind::Sensor,
            quantity: Quantity::ImplausibleDate,
            severity,
            score: most,
            threshold: 1.0,
            value: f64::NAN,
            baseline: f64::NAN,
            peak_value: f64::NAN,
            peak_score: most,
            peak_severity: severity,
            first_cycle: None,
            first_run_id: first.run.run_id,
            last_run_id: last.run.run_id,
            first_seen_at: from,
            last_seen_at: to,
            onset: Onset { run_id: first.run.run_id, cycle: None, at: from },
            odds: None,
            alternatives: Vec::new(),
            ended: false,
            message: self.message(),
        })
    }

    fn is_unwatched(&self) -> bool {
        self.tests_left_out >= UNWATCHED
    }

    fn message(&self) -> String {
        let all = self.misdated.len();
        let mut named: Vec<String> = self
            .misdated
            .iter()
            .take(MOST_NAMED)
            .map(|of| format!("{} (run {}) is {}", of.run.source_name, of.run.run_id, of.date))
            .collect();
        if all > MOST_NAMED {
            named.push(format!("and {} more", all - MOST_NAMED));
        }
        let effect = match self.misdated.iter().filter(|of| !of.date.is_in_order).count() {
            0 => "the order of arrival counts".to_owned(),
            left_out if left_out == all => "no conclusion uses such a recording".to_owned(),
            left_out => {
                format!("{left_out} of {all} are excluded; the others count in the order of arrival")
            }
        };
        let unwatched = match self.is_unwatched() {
            true => format!(
                "the last {} tests are excluded, so the robot is not watched; if the order of arrival is \
                right, include them with `armwatch run-date RUN.. --as-arrived`; ",
                self.tests_left_out
            ),
            false => String::new(),
        };
        format!(
            "{unwatched}the recorded start cannot be right: {}; {effect}; `armwatch run-date RUN --at TIME` corrects a \
             start",
            named.join("; ")
        )
    }
}

#[cfg(test)]
mod tests;
