//! Oscillation: the friction of a joint varies from cycle to cycle.
//!
//! The quantity is the standard deviation of a cycle's friction about the smooth curve of its run, as a fraction of
//! friction. Each cycle is identified separately, so the torque's RMSD stays quiet. The comparison of causes
//! ([`crate::detect::runs::curve`]) distinguishes scatter from a step and from warm-up. A run is out from 3 % on,
//! whatever the joint's own history: a joint that always swung is found in its first run. Below 5 %, one run has the
//! severity `info`, and is a warning if the run before shows it too. It is critical from 10 % on.

use crate::detect::detector::Detector;
use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Swings for a warning and for critical, as fractions of friction.
const WARNING: f64 = 0.03;
const CRITICAL: f64 = 0.10;
/// Swing that needs no confirmation by a second run.
const PLAIN: f64 = 0.05;

pub(in crate::detect::runs) struct FrictionSwing;

impl Detector<JointSeries<'_>> for FrictionSwing {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Oscillation
    }

    fn quantity(&self, _: &JointSeries<'_>) -> Quantity {
        Quantity::FrictionSwing
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let mut before = false;
        let verdict = |run: usize| {
            let Some(found) = series.causes[run].as_ref() else { return Verdict::Unknown };
            if series.has_wrong_signal(run) {
                return Verdict::Unknown;
            }
            let Some(Cause::Scatter(size)) = found.clear() else {
                // few cycles do not always show it clearly: a run that may show it does not end it
                before = before && found.may_scatter();
                return if before { Verdict::Unknown } else { Verdict::Quiet };
            };
            let is_confirmed = std::mem::replace(&mut before, true) || size >= PLAIN;
            Verdict::Out {
                severity: match size {
                    _ if size >= CRITICAL => Severity::Critical,
                    _ if is_confirmed => Severity::Warning,
                    _ => Severity::Info,
                },
                score: size,
                threshold: WARNING,
                value: size,
                baseline: found.scatter,
                message: format!(
                    "friction varies by {:.0} % (standard deviation over {} cycles) from cycle to cycle, where {:.1} % \
                     is usual; look for a loose bearing, belt or coupling, or a brake that does not open fully",
                    100.0 * size,
                    found.cycles,
                    100.0 * found.scatter
                ),
                why: Why { odds: Some(found.odds()), alternatives: found.alternatives(), ..Why::default() },
            }
        };
        (0..series.causes.len()).map(verdict).collect()
    }
}
