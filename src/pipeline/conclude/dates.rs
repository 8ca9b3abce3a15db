//! Recordings with implausible starts: they are reported, and excluded if they are out of order.

use std::collections::HashSet;

use jiff::{SignedDuration, Timestamp};

use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset, Severity};
use armwatch_model::run::RunKind;
use armwatch_model::run::arrival::{Arrival, DateProblem, ImplausibleDate, implausible_dates};
use armwatch_store::{DatedPlace, DatedRun, StaleRobot};

/// Most recordings that a message names.
const MOST_NAMED: usize = 3;

/// So many tests that arrived last and are all out of order leave a robot unwatched, unless their order of arrival counts.
const UNWATCHED: usize = 3;

/// Tests that arrived together follow each other by this.
const STEP: SignedDuration = SignedDuration::from_secs(1);

/// A recording whose start cannot be right.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Misdated {
    run: DatedRun,
    date: ImplausibleDate,
    /// Latest start of the included recordings that had arrived before: its place in the history.
    place: Timestamp,
}

/// Judgement on the starts of a robot's recordings.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct JudgedDates {
    misdated: Vec<Misdated>,
    /// Tests that arrived last and are all out of order.
    latest_out_of_order: usize,
    /// Those of them whose order of arrival counts.
    by_arrival: HashSet<i64>,
    /// Recordings left the history, came back or moved, so that it has to be read again.
    pub(super) changes_history: bool,
}

impl Pipeline {
    /// Checks the starts of a robot's recordings, and stores the changes.
    pub(super) async fn judge_dates(&self, robot: &StaleRobot) -> Result<JudgedDates, PipelineError> {
        let runs = self.store.dated_runs(&robot.name).await?;
        let mut judged = JudgedDates {
            misdated: Vec::new(),
            latest_out_of_order: 0,
            by_arrival: HashSet::new(),
            changes_history: false,
        };
        let mut changed = Vec::new();
        for kind in [RunKind::Test, RunKind::Production] {
            let of_kind: Vec<&DatedRun> = runs.iter().filter(|run| run.kind == kind).collect();
            let dates = self.implausible(&robot.name, &of_kind);
            let is_out = |date: &Option<ImplausibleDate>| date.is_some_and(|date| !date.is_in_order);
            let latest_out = dates.iter().rev().take_while(|date| is_out(date)).count();
            let in_order = dates.iter().filter(|date| !is_out(date)).count();
            // no other test shows the present state of the arm; baselines consist of other tests
            let by_arrival = kind == RunKind::Test
                && latest_out >= UNWATCHED
                && in_order >= self.config.detect.baseline_runs.max(1);
            if kind == RunKind::Test {
                judged.latest_out_of_order = latest_out;
            }
            let mut latest: Option<Timestamp> = None;
            for (at, (&run, date)) in of_kind.iter().zip(dates).enumerate() {
                let place = match (is_out(&date), latest) {
                    (false, _) => DatedPlace::Start,
                    (true, Some(latest)) if by_arrival && at >= of_kind.len() - latest_out => {
                        DatedPlace::Arrival(run.arrived_at.max(latest + STEP))
                    }
                    (true, _) => DatedPlace::LeftOut,
                };
                if run.problem != date.map(|date| date.to_string()) || run.place != place {
                    judged.changes_history |= run.place != place;
                    changed.push((run.run_id, date, place));
                }
                match place {
                    DatedPlace::Start => latest = latest.max(Some(run.started_at)),
                    DatedPlace::Arrival(at) => {
                        latest = Some(at);
                        judged.by_arrival.insert(run.run_id);
                    }
                    DatedPlace::LeftOut => {}
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
        let is_new = |of: &&Misdated| changed.iter().any(|(run_id, ..)| *run_id == of.run.run_id);
        for Misdated { run, date, .. } in judged.misdated.iter().filter(is_new) {
            let effect = match (date.is_in_order, judged.by_arrival.contains(&run.run_id)) {
                (true, _) => "its order of arrival counts",
                (false, true) => "it can open alarms, in the order of arrival",
                (false, false) => "it is excluded",
            };
            tracing::warn!(
                robot = robot.name,
                run_id = run.run_id,
                "{} is {date}: {effect}; `armwatch run-date {} --at TIME` corrects its start, --as-recorded confirms that \
                 an export only came late",
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
    /// Tests that only open alarms, in the order of their arrival.
    pub(super) const fn by_arrival(&self) -> &HashSet<i64> {
        &self.by_arrival
    }

    /// The alarms that only the tests in the order of arrival show. `with` are the anomalies of the history with these tests;
    /// `in_order` are those without them, which stay as they are: a joint that has an alarm gets no other one.
    pub(super) fn shown_by_arrival(&self, with: Vec<Anomaly>, in_order: &[Anomaly]) -> Vec<Anomaly> {
        let is_known = |of: &Anomaly| {
            in_order.iter().any(|known| {
                let is_same = (known.joint, known.quantity, known.first_run_id)
                    == (of.joint, of.quantity, of.first_run_id);
                // the arm is every joint
                let is_there = known.joint.is_none() || of.joint.is_none() || known.joint == of.joint;
                is_same || (is_there && known.severity > Severity::Info && !known.ended)
            })
        };
        let is_shown = |of: &Anomaly| {
            of.severity > Severity::Info && self.by_arrival.contains(&of.last_run_id) && !is_known(of)
        };
        let mut shown: Vec<Anomaly> = with.into_iter().filter(is_shown).collect();
        for of in &mut shown {
            of.message.push_str(
                "; tests whose recorded starts cannot be right show it, in the order of their arrival",
            );
        }
        shown
    }

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
        self.latest_out_of_order >= UNWATCHED && self.by_arrival.is_empty()
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
        let is_left_out = |of: &&Misdated| !of.date.is_in_order && !self.by_arrival.contains(&of.run.run_id);
        let effect = match self.misdated.iter().filter(is_left_out).count() {
            0 => "the order of arrival counts".to_owned(),
            left_out if left_out == all => "no conclusion uses such a recording".to_owned(),
            left_out => {
                format!("{left_out} of {all} are excluded; the others count in the order of arrival")
            }
        };
        let tests = self.latest_out_of_order;
        let latest = match self.by_arrival.is_empty() {
            false => format!(
                "the last {tests} tests have no place in the order of the others: they open alarms in the order of their \
                 arrival, and change or end no earlier alarm; `armwatch run-date RUN.. --as-arrived` confirms this order; "
            ),
            true if self.is_unwatched() => format!(
                "the last {tests} tests are excluded, so the robot is not watched; if the order of arrival is right, \
                 include them with `armwatch run-date RUN.. --as-arrived`; "
            ),
            true => String::new(),
        };
        format!(
            "{latest}the recorded start cannot be right: {}; {effect}; `armwatch run-date RUN --at TIME` corrects a \
             start, `--as-recorded` confirms that an export only came late",
            named.join("; ")
        )
    }
}

#[cfg(test)]
mod tests;
