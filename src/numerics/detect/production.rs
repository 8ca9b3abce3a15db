//! Detectors on logs of ordinary work: robots watched between their tests.
//!
//! Pure functions over what all complete logs of a robot come to against its tests, oldest first. A joint is compared
//! with its own first logs after the test that they are held against: work that moves otherwise than a test, or a load
//! that the test did not carry, is there from the first log on and is no change. So that first logs are not normal
//! whatever they are, each log is held against the test's own error too.

use jiff::Timestamp;

use super::runs::episodes;
use super::verdict::{EWMA_WEIGHT, Verdict};
use crate::analysis::ProductionJoint;
use crate::anomaly::{Anomaly, AnomalyKind, ProductionSummary, Severity};
use crate::numerics::statistics::descriptive::{median, robust_deviation};
use crate::robot::JointIndex;

/// Logs after a test that say how a joint's work compares with it. One of three may be odd.
const LEARNING_LOGS: usize = 3;

/// Joints that must move for what is common to them to be called warmth: of three, one that wears does not move the
/// median by more than the others differ.
const FEWEST_JOINTS: usize = 3;

/// Friction beyond the other joints' that is a warning, and that is critical. Tests warn at a third of it: they
/// move all joints alike and know how warm each is.
const WARNING: f64 = 0.15;
const CRITICAL: f64 = 0.30;

/// Standard deviations of the smoothed change that could be chance.
const SIGMA: f64 = 4.0;

/// Smallest standard deviation from log to log that a few logs are believed to have: joints of one arm warm
/// up at different rates, and a morning's log of a cold arm shows it.
const MIN_SPREAD: f64 = 0.03;

/// Deviation that friction does not explain, against its usual, that is another load: as a ratio, and as a part of
/// the torque, below which a good fit only wobbles.
const LOAD_RATIO: f64 = 1.5;
const LOAD_CHANGE: f64 = 0.02;

/// Deviation from the test, as a part of the torque, that is said from the first log on: what friction does not explain,
/// and all of it. Cold gearboxes need half as much friction again, which is less than a third of the torque.
const OFF_UNEXPLAINED: f64 = 0.25;
const OFF: f64 = 0.5;

/// The same as multiples of the test's own error: a test that explains its own torque badly explains other motion worse.
const OFF_UNEXPLAINED_RATIO: f64 = 4.0;
const OFF_RATIO: f64 = 8.0;

/// From here on no torque at all would be the better estimate; no load that is only carried along does that.
const OFF_WARNING: f64 = 1.0;

/// Looks at the complete logs of one robot, oldest first.
#[must_use]
pub fn detect_production(history: &[ProductionSummary]) -> Vec<Anomaly> {
    let moments: Vec<(i64, Timestamp)> = history.iter().map(|log| (log.run_id, log.started_at)).collect();
    let joints = history.iter().flat_map(|log| &log.joints).map(|of| of.joint.index() + 1).max().unwrap_or(0);
    let mut found = Vec::new();
    for joint in (0..joints).map(JointIndex::new) {
        let loads = loads(history, joint);
        let friction = friction(history, joint, &loads);
        for (kind, quantity, verdicts) in [
            (AnomalyKind::Drift, "production_friction", friction),
            (AnomalyKind::Payload, "production_relative_rmsd", loads),
            (AnomalyKind::Accuracy, "production_relative_rmsd", against_the_test(history, joint)),
        ] {
            found.extend(episodes(&moments, joint, kind, quantity, &verdicts));
        }
    }
    found
}

/// Friction of each log as a multiple of the test's, over that of the other joints: what all joints have in
/// common is how warm the arm was. `None` where the joint does not move.
fn friction_ratio(log: &ProductionSummary, joint: JointIndex) -> Option<f64> {
    let multiple = |of: &ProductionJoint| 1.0 + of.friction.excess;
    let own = log.joints.iter().find(|of| of.joint == joint).map(multiple)?;
    if log.joints.len() < FEWEST_JOINTS {
        return Some(own);
    }
    let common = median(&log.joints.iter().map(multiple).collect::<Vec<_>>())?;
    (common > 0.0).then_some(own / common)
}

/// Part of the torque that neither the test's model nor more friction explains.
fn unexplained(of: &ProductionJoint) -> f64 {
    of.relative_rmsd * (1.0 - of.friction.share).max(0.0).sqrt()
}

/// Logs by the test that they are held against, as ranges.
fn by_test(history: &[ProductionSummary]) -> impl Iterator<Item = std::ops::Range<usize>> {
    let mut start = 0;
    history.chunk_by(|a, b| a.reference_run_id == b.reference_run_id).map(move |logs| {
        let range = start..start + logs.len();
        start = range.end;
        range
    })
}

/// An exponentially weighted mean of the friction ratio against that of the first logs after the test.
fn friction(history: &[ProductionSummary], joint: JointIndex, loads: &[Verdict]) -> Vec<Verdict> {
    let mut verdicts = vec![Verdict::Unknown; history.len()];
    // changes from log to log that were no anomaly
    let mut usual: Vec<f64> = Vec::new();
    for logs in by_test(history) {
        let ratios: Vec<(usize, f64)> = logs
            .filter(|&log| !matches!(loads[log], Verdict::Out { .. }))
            .filter_map(|log| Some((log, friction_ratio(&history[log], joint)?)))
            .collect();
        let first: Vec<f64> = ratios.iter().take(LEARNING_LOGS).map(|(_, ratio)| *ratio).collect();
        let Some(level) = median(&first).filter(|_| first.len() == LEARNING_LOGS) else { continue };
        let mut smoothed = 0.0;
        for (place, &(log, ratio)) in ratios.iter().enumerate() {
            let change = ratio - level;
            if place < LEARNING_LOGS {
                verdicts[log] = Verdict::Quiet;
                usual.push(change);
                continue;
            }
            smoothed = EWMA_WEIGHT * change + (1.0 - EWMA_WEIGHT) * smoothed;
            let spread = robust_deviation(&usual).unwrap_or(0.0).max(MIN_SPREAD);
            let threshold = WARNING.max(SIGMA * spread * smoothed_deviation());
            if smoothed < threshold {
                verdicts[log] = Verdict::Quiet;
                usual.push(change);
                continue;
            }
            let critical = smoothed >= CRITICAL.max(threshold);
            verdicts[log] = Verdict::Out {
                severity: if critical { Severity::Critical } else { Severity::Warning },
                score: smoothed,
                threshold,
                value: ratio,
                baseline: level,
                message: format!(
                    "in ordinary work friction is {:.0} % above that of the first logs since the last test{}; check \
                     lubrication, gearbox and brake, and run a test",
                    100.0 * change / level,
                    if history[log].joints.len() < FEWEST_JOINTS {
                        ""
                    } else {
                        ", and not in the other joints"
                    }
                ),
            };
        }
    }
    verdicts
}

/// Standard deviation of the smoothed change over that of one log: the weighted mean's, and that of the median of
/// the first logs, pi/2 of a mean's variance.
fn smoothed_deviation() -> f64 {
    let mean = EWMA_WEIGHT / (2.0 - EWMA_WEIGHT);
    (mean + std::f64::consts::FRAC_PI_2 / LEARNING_LOGS as f64).sqrt()
}

/// Deviation of each log against the error of the test itself.
fn against_the_test(history: &[ProductionSummary], joint: JointIndex) -> Vec<Verdict> {
    let verdict = |log: &ProductionSummary| {
        let Some(of) = log.joints.iter().find(|of| of.joint == joint) else { return Verdict::Unknown };
        let own = of.test_relative_rmsd.unwrap_or(0.0);
        let (all, part) = (of.relative_rmsd, unexplained(of));
        let of_part = OFF_UNEXPLAINED.max(OFF_UNEXPLAINED_RATIO * own);
        let of_all = OFF.max(OFF_RATIO * own);
        if part < of_part && all < of_all {
            return Verdict::Quiet;
        }
        let cause = match part >= of_part {
            true => "a load or tool that the test did not carry, a contact, or a torque signal that is off",
            false => "friction: check lubrication, gearbox and brake",
        };
        let itself = match of.test_relative_rmsd {
            Some(own) => format!("the test itself leaves {:.1} %", 100.0 * own),
            None => "the test's own error is not known".to_owned(),
        };
        Verdict::Out {
            severity: if all >= OFF_WARNING { Severity::Warning } else { Severity::Info },
            score: all,
            threshold: if part >= of_part { of_part } else { of_all },
            value: all,
            baseline: own,
            message: format!(
                "in ordinary work {:.0} % of the torque is not what the last test leads to expect; {itself}: {cause}",
                100.0 * all
            ),
        }
    };
    history.iter().map(verdict).collect()
}

/// Deviation that friction does not explain against that of the first logs after the test, log by log.
fn loads(history: &[ProductionSummary], joint: JointIndex) -> Vec<Verdict> {
    let mut verdicts = vec![Verdict::Unknown; history.len()];
    for logs in by_test(history) {
        let parts: Vec<(usize, f64)> = logs
            .filter_map(|log| {
                let of = history[log].joints.iter().find(|of| of.joint == joint)?;
                Some((log, unexplained(of)))
            })
            .collect();
        let first: Vec<f64> = parts.iter().take(LEARNING_LOGS).map(|(_, part)| *part).collect();
        let Some(level) = median(&first).filter(|_| first.len() == LEARNING_LOGS) else { continue };
        let threshold = (LOAD_RATIO * level).max(level + LOAD_CHANGE);
        for (place, &(log, part)) in parts.iter().enumerate() {
            verdicts[log] = if place < LEARNING_LOGS || part < threshold {
                Verdict::Quiet
            } else {
                Verdict::Out {
                    severity: Severity::Info,
                    score: part,
                    threshold,
                    value: part,
                    baseline: level,
                    message: format!(
                        "in ordinary work {:.1} % of the torque is neither what the last test leads to expect nor \
                         friction, {:.1} % in the first logs since; nothing is wrong if the tool, the load or the \
                         program changed, else look for a contact or a torque signal that is off",
                        100.0 * part,
                        100.0 * level
                    ),
                }
            };
        }
    }
    verdicts
}

#[cfg(test)]
mod tests;
