//! Inaccuracy in production: the torque of a log is far from the prediction of the last test.
//!
//! The quantities are the relative RMSD of a log against the parameters of the test, a fraction of the torque, and the
//! part of it that friction does not explain. The limits are absolute and hold from the first log on. A log is out from
//! 0.5 on ([`OFF`]) or, for the unexplained part, from 0.25 on ([`OFF_UNEXPLAINED`]). Both limits rise with the test's
//! own relative RMSD, to 8 times ([`OFF_RATIO`]) and 4 times it ([`OFF_UNEXPLAINED_RATIO`]). Below 1.0 the severity is
//! `info`, from there on it is a warning ([`OFF_WARNING`]). If causes of the deviation of a log were compared, both
//! quantities are the residual of the likeliest cause. Section "Alarms between tests" of docs/exports.md gives the
//! reasons.

use super::causes::cause::WorkCause;
use super::causes::odds::Asked;
use super::series::{JointLogs, unexplained};
use crate::detect::detector::Detector;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::analysis::ProductionJoint;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Least deviation from the test, as a part of the torque, that is reported from the first log on: the part that
/// friction does not explain, and all of it. Cold gearboxes need half as much friction again, which is less than a
/// third of the torque.
const OFF_UNEXPLAINED: f64 = 0.25;
const OFF: f64 = 0.5;

/// The same limits as multiples of the test's own error: a test that explains its own torque badly explains other
/// motion worse.
const OFF_UNEXPLAINED_RATIO: f64 = 4.0;
const OFF_RATIO: f64 = 8.0;

/// Limit of a warning: zero torque would be a better estimate. A load that is only carried along does not reach it.
const OFF_WARNING: f64 = 1.0;

/// Remedy if friction explains a deviation.
const FRICTION: &str = "friction: check lubrication, gearbox and brake";

pub(super) struct TestDeviation;

impl Detector<JointLogs<'_>> for TestDeviation {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Accuracy
    }

    fn quantity(&self, _: &JointLogs<'_>) -> Quantity {
        Quantity::ProductionRelativeRmsd
    }

    fn judge(&self, series: &JointLogs<'_>) -> Vec<Verdict> {
        let verdict = |log| {
            let of = series.of(log);
            of.map_or(Verdict::Unknown, |of| match (series.rest(log), series.causes[log].as_ref()) {
                (Some(rest), Some(causes)) => {
                    // the residual is no compared cause
                    let why = Why { odds: None, ..causes.why(Asked::Cause) };
                    against_the_test(of, rest.with_friction, rest.left, Some(causes.likeliest()), why)
                }
                _ => against_the_test(of, of.relative_rmsd, unexplained(of), None, Why::default()),
            })
        };
        (0..series.history.len()).map(verdict).collect()
    }
}

/// Verdict from the residuals of the test: `part` without the torque that friction explains, `all` with it. `likeliest`
/// is the cause that explains most, if causes were compared.
fn against_the_test(
    of: &ProductionJoint,
    all: f64,
    part: f64,
    likeliest: Option<WorkCause>,
    why: Why,
) -> Verdict {
    let own = of.test_relative_rmsd.unwrap_or(0.0);
    let of_part = OFF_UNEXPLAINED.max(OFF_UNEXPLAINED_RATIO * own);
    let of_all = OFF.max(OFF_RATIO * own);
    if part < of_part && all < of_all {
        return Verdict::Quiet;
    }
    let cause = match likeliest {
        _ if part >= of_part => {
            "a load or tool that the test did not carry, a contact, or a torque signal that is off".to_owned()
        }
        // the effect of temperature is friction too
        None | Some(WorkCause::None) => FRICTION.to_owned(),
        Some(WorkCause::Friction(joint, _)) if joint == of.joint => FRICTION.to_owned(),
        Some(other) => format!("{} explains most of it", other.words()),
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
            "in production {:.0} % of the torque is not what the last test predicts; {itself}: \
             {cause}",
            100.0 * all
        ),
        why,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::production::fixtures::{USUAL, detected, history, wobble};
    use armwatch_model::robot::JointIndex;

    #[test]
    fn the_remedy_goes_with_the_likeliest_cause() {
        let logs = history(1, |_, _| (0.0, USUAL));
        let of = &logs[0].joints[1];
        let other = JointIndex::new(0);
        let told = |likeliest| match against_the_test(of, 0.75, 0.1, likeliest, Why::default()) {
            Verdict::Out { message, .. } => message,
            verdict => panic!("{verdict:?}"),
        };
        for of_friction in [None, Some(WorkCause::None), Some(WorkCause::Friction(of.joint, 0.5))] {
            assert!(told(of_friction).contains("check lubrication"), "{of_friction:?}");
        }
        for another in [WorkCause::Friction(other, 0.5), WorkCause::Gain(of.joint, 0.4), WorkCause::Unknown] {
            let message = told(Some(another));
            assert!(!message.contains("lubrication") && message.contains(&another.words()), "{message}");
        }
    }

    #[test]
    fn the_first_logs_after_a_test_are_held_against_the_test() {
        // joint 2 is off from the first log on: its level must not be learnt as normal
        for (off, severity) in [(0.3, Severity::Info), (1.15, Severity::Warning)] {
            let logs = history(12, |i, j| (wobble(i, j), if j == 1 && i < 12 { off } else { USUAL }));
            let found = detected(&logs);
            let [anomaly] = &found[..] else { panic!("one anomaly: {found:?}") };
            assert_eq!(
                (anomaly.kind, anomaly.quantity),
                (AnomalyKind::Accuracy, Quantity::ProductionRelativeRmsd)
            );
            assert_eq!(
                (anomaly.joint.map(JointIndex::number), anomaly.severity, anomaly.first_run_id),
                (Some(2), severity, 1)
            );
            assert!(anomaly.message.contains("the test itself leaves 1.5 %"), "{}", anomaly.message);
        }
        // limits are higher after a test that explains its own torque badly
        let mut poor = history(12, |i, j| (wobble(i, j), if j == 1 { 0.3 } else { USUAL }));
        poor.iter_mut().flat_map(|log| &mut log.joints).for_each(|of| of.test_relative_rmsd = Some(0.12));
        assert_eq!(detected(&poor), vec![]);
    }
}
