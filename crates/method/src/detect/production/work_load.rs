//! Load in production that the test did not carry (`payload`): a body at the last link explains the torque that the
//! test does not predict.
//!
//! The quantity is its mass in kg, compared with the test. The severity is `info`: production uses tools and workpieces
//! that a test does not, and descriptions do not contain the permitted load of an arm.

use jiff::Timestamp;

use super::causes::LogCauses;
use super::causes::odds::Asked;
use crate::detect::episodes::episodes;
use crate::detect::verdict::Verdict;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Severity};

/// Loads over the logs; `runs` has key and start of each.
pub(super) fn work_loads(causes: &[Option<LogCauses>], runs: &[(i64, Timestamp)]) -> Vec<Anomaly> {
    let verdict = |of: &Option<LogCauses>| {
        match of {
        None => Verdict::Unknown,
        Some(of) => of.load().map_or(Verdict::Quiet, |load| {
            let seen = load.has_seen_mass();
            // to the millimetre, without the sign of a zero
            let [x, y, z] = load.centre.map(|part| (1e3 * part).round() / 1e3 + 0.0);
            let ordinary = "nothing is wrong if this is the tool or the workpiece";
            let message = match seen {
                true => format!(
                    "in production the arm carries {:.2} kg {} than in its last test (standard error {:.3} kg), centre \
                     at ({x:.3}, {y:.3}, {z:.3}) m of the last link; {ordinary}",
                    load.mass.abs(),
                    if load.mass > 0.0 { "more" } else { "less" },
                    load.std_error
                ),
                false => format!(
                    "in production the torque differs from that of the last test as a body at the last link makes it; \
                     this motion does not show its mass; {ordinary}"
                ),
            };
            Verdict::Out {
                severity: Severity::Info,
                score: if seen { load.mass.abs() / load.std_error } else { 1.0 },
                threshold: if seen { 5.0 } else { 1.0 },
                value: if seen { load.mass } else { f64::NAN },
                baseline: if seen { 0.0 } else { f64::NAN },
                message,
                why: of.why(Asked::Load),
            }
        }),
    }
    };
    let verdicts = causes.iter().map(verdict).collect();
    episodes(runs, None, AnomalyKind::Payload, Quantity::ProductionLoad, verdicts)
}
