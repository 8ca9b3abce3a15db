//! Step: the friction of a joint jumps, inside a run or between two.
//!
//! Inside a run the comparison of causes ([`crate::detect::runs::curve`]) finds it and its first cycle, also in the
//! runs of the baseline. Between runs the control chart of [`super::friction_drift`] finds that friction is away from
//! its baseline, and the shape of the runs about the beginning shows a sudden change ([`super::friction_change`]). The
//! episode continues as long as friction stays away. If friction of the joint scattered from cycle to cycle in one of
//! the eight tests before, a step inside a run must also make up for the higher prior of scatter. A step has the
//! severity `info` from a twentieth of friction on, a warning from `drift_warning` on and critical from
//! `drift_critical` on.

use super::friction_change::Shape;
use super::friction_drift::{Judged, episode_shape, episodes, judged, why_level};
use crate::detect::detector::Detector;
use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

pub(in crate::detect::runs) struct FrictionStep;

impl Detector<JointSeries<'_>> for FrictionStep {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Step
    }

    fn quantity(&self, series: &JointSeries<'_>) -> Quantity {
        series.friction.source.quantity()
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let Judged { mut verdicts, rises, changes, .. } = judged(series);
        for (first, last) in episodes(&verdicts, &changes) {
            match episode_shape(series, &rises, &changes, first, last) {
                Shape::Drift { .. } => verdicts[first..=last].fill(Verdict::Quiet),
                Shape::Step { run, cycle, size } => {
                    // odds of the test with the jump, or, between two tests, of each test after it
                    let inside = series.causes.get(run).and_then(Option::as_ref).filter(|_| cycle.is_some());
                    for (place, verdict) in (first..=last).zip(&mut verdicts[first..=last]) {
                        if let Verdict::Out { why, message, .. } = verdict {
                            *why = match inside {
                                Some(of) => Why {
                                    odds: Some(of.odds()),
                                    alternatives: of.alternatives(),
                                    ..Why::default()
                                },
                                None => why_level(series, place),
                            };
                            why.onset = Some((run, cycle));
                            *message = format!(
                                "friction jumped by {:+.0} %{}; {message}",
                                100.0 * size,
                                with(cycle)
                            );
                        }
                    }
                }
            }
        }
        for (run, verdict) in verdicts.iter_mut().enumerate() {
            if !matches!(verdict, Verdict::Out { .. })
                && !series.has_wrong_signal(run)
                && let Some(step) = inside(series, run)
            {
                *verdict = step;
            }
        }
        verdicts
    }
}

fn with(cycle: Option<u32>) -> String {
    cycle.map_or(" between two tests".into(), |cycle| format!(" with cycle {cycle} of a test"))
}

/// The verdict about a step inside a run.
fn inside(series: &JointSeries<'_>, run: usize) -> Option<Verdict> {
    let found = series.causes.get(run)?.as_ref()?;
    let Some(Cause::Step { cycle, size }) = found.clear() else { return None };
    // few cycles with scatter sometimes look like a step
    if series.scattered_before(run) && !found.is_clear_where_it_scatters() {
        return None;
    }
    let change = size.exp_m1();
    let threshold = series.settings.drift_warning;
    Some(Verdict::Out {
        severity: match change.abs() {
            size if size >= series.settings.drift_critical => Severity::Critical,
            size if size >= threshold => Severity::Warning,
            _ => Severity::Info,
        },
        score: change.abs(),
        threshold,
        value: 1.0 + change,
        baseline: 1.0,
        message: format!(
            "friction jumped by {:+.0} % with cycle {cycle} of this test and stayed there; look for what happened \
             then: a contact, a lost seal, a brake that drags",
            100.0 * change
        ),
        why: Why {
            quantity: Some(series.friction.source.quantity_of_jump()),
            onset: Some((run, Some(cycle))),
            odds: Some(found.odds()),
            alternatives: found.alternatives(),
        },
    })
}
