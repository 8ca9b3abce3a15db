//! Counts the outcomes of all exports.

use std::time::Duration;

use serde_json::json;

use super::export_texts::lasting;
use crate::cli::context::{EXIT_DONE, EXIT_FOUND};
use crate::cli::shared::output;
use crate::pipeline::context::Outcome;
use armwatch_model::anomaly::Severity;

/// Counts of the outcomes of all exports.
#[derive(Debug, Default)]
pub(super) struct Tally {
    stored: usize,
    known: usize,
    quarantined: usize,
    without_result: usize,
    /// Exports to try again.
    not_read: usize,
    /// Cycles of the stored exports, and those of them without parameters.
    cycles: usize,
    refused: usize,
    /// Anomalies that opened, by severity.
    pub(super) opened: [usize; 3],
}

/// Severities, the worst first.
const SEVERITIES: [Severity; 3] = [Severity::Critical, Severity::Warning, Severity::Info];

impl Tally {
    pub(super) fn add(&mut self, outcome: &Outcome, without_result: bool) {
        let counted = match outcome {
            Outcome::Stored(_) => &mut self.stored,
            Outcome::AlreadyStored { .. } => &mut self.known,
            Outcome::Quarantined { .. } => &mut self.quarantined,
            Outcome::Unreadable { .. } | Outcome::Changed | Outcome::InWork { .. } | Outcome::Interrupted => {
                &mut self.not_read
            }
        };
        *counted += 1;
        self.without_result += usize::from(without_result);
        if let Outcome::Stored(run) = outcome {
            self.cycles += run.cycles as usize;
            self.refused += run.refused.len();
        }
    }

    /// Exports with a final outcome.
    pub(super) fn decided(&self) -> usize {
        self.stored + self.known + self.quarantined
    }

    pub(super) fn as_text(&self, took: Duration) -> String {
        let Self { stored, known, quarantined, without_result, not_read, cycles, refused, opened } = self;
        let mut text = format!(
            "{stored} stored, {known} known, {quarantined} quarantined, {without_result} without result"
        );
        if *not_read > 0 {
            text.push_str(&format!(", {not_read} not read"));
        }
        if *stored > 0 {
            text.push_str(&format!("; {}, {refused} refused", output::counted(*cycles, "cycle")));
        }
        let alarms: Vec<String> = SEVERITIES
            .into_iter()
            .filter(|severity| opened[*severity as usize] > 0)
            .map(|severity| format!("{} {}", opened[severity as usize], output::coloured(severity.name())))
            .collect();
        if !alarms.is_empty() {
            text.push_str(&format!("; opened: {}", alarms.join(", ")));
        }
        text + &format!("; {}", lasting(took))
    }

    /// The counts for scripts; `is_interrupted` is true if exports are left because a stop was requested.
    pub(super) fn as_value(&self, took: Duration, is_interrupted: bool) -> serde_json::Value {
        let opened: serde_json::Map<_, _> = SEVERITIES
            .into_iter()
            .map(|severity| (severity.name().to_owned(), self.opened[severity as usize].into()))
            .collect();
        json!({
            "outcome": "summary", "stored": self.stored, "known": self.known, "quarantined": self.quarantined,
            "without_result": self.without_result, "not_read": self.not_read, "cycles": self.cycles,
            "refused_cycles": self.refused, "anomalies_opened": opened, "interrupted": is_interrupted,
            "took_s": took.as_secs_f64(),
        })
    }

    pub(super) fn exit_code(&self) -> u8 {
        match self.quarantined + self.without_result + self.not_read {
            0 => EXIT_DONE,
            _ => EXIT_FOUND,
        }
    }
}
#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::context::StoredRun;

    fn stored(cycles: u32) -> Outcome {
        Outcome::Stored(StoredRun { run_id: 1, robot: "R".into(), cycles, refused: Vec::new(), rows: 1 })
    }

    #[test]
    fn the_closing_line_counts_alarms_and_cycles() {
        let mut tally = Tally::default();
        tally.add(&stored(3), false);
        tally.add(&Outcome::AlreadyStored { run_id: 2 }, false);
        let second = Duration::from_millis(1900);
        let line = "1 stored, 1 known, 0 quarantined, 0 without result; 3 cycles, 0 refused; 1 s";
        assert_eq!(tally.as_text(second), line);
        tally.opened[Severity::Critical as usize] = 2;
        assert!(tally.as_text(Duration::from_secs(3750)).ends_with("; opened: 2 critical; 1 h 2 min"));
        let value = tally.as_value(second, false);
        assert_eq!(
            (&value["outcome"], &value["anomalies_opened"]["critical"], &value["interrupted"]),
            (&"summary".into(), &2.into(), &false.into())
        );
        tally.add(&Outcome::Interrupted, false);
        assert_eq!((tally.decided(), &tally.as_value(second, true)["interrupted"]), (2, &true.into()));
    }
}
