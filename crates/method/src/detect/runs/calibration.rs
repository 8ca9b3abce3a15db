//! Limits of a robot and their consequences.

use super::joint_detectors::friction_drift::judged;
use super::other_unit::with_units;
use super::parts::{Parts, grouped};
use super::series::JointSeries;
use crate::detect::control_chart::{EWMA_WEIGHT, steady_variance};
use crate::detect::rate::OWN_FROM;
use crate::detect::rate::average::mean_run_length;
use crate::detect::rate::budget::{Budget, advantage};
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::JointIndex;

/// Changes of friction for the reported delays, as fractions.
pub const CHANGES: [f64; 3] = [0.05, 0.10, 0.15];

/// Limits of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Division of the rate.
    pub budget: Budget,
    /// Least log-likelihood of a cause over no change, in one test.
    pub advantage: f64,
    /// Complete tests.
    pub tests: usize,
    /// The level of friction of each joint.
    pub joints: Vec<LevelCalibration>,
}

/// Knowledge that a limit is based on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Almost none.
    NoHistory,
    /// A prior, or few tests.
    Short,
    /// The joint's own tests.
    Own,
}

impl Phase {
    /// Name for users and in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoHistory => "no history",
            Self::Short => "short",
            Self::Own => "own",
        }
    }
}

/// Limit of the level of a joint's friction.
#[derive(Debug, Clone, PartialEq)]
pub struct LevelCalibration {
    /// The joint.
    pub joint: JointIndex,
    /// The quantity that is checked, as in the view `anomalies`.
    pub quantity: Quantity,
    /// Number of learnt tests, of the joint's latest epoch.
    pub learnt: usize,
    /// Knowledge that the limit is based on.
    pub phase: Phase,
    /// The limit; `None` while the joint has no baseline.
    pub limit: Option<LevelFigures>,
}

/// Values of a limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelFigures {
    /// Standard deviation from test to test, as a fraction of friction.
    pub scatter: f64,
    /// Standard deviations of the smoothed change that are still chance.
    pub sigma: f64,
    /// Smoothed change that raises an alarm, as a fraction of friction.
    pub change: f64,
    /// Expected number of tests until an alarm after a step by each of [`CHANGES`], including the first test with it;
    /// infinite if the step is not found.
    pub delays: [f64; CHANGES.len()],
}

/// Limits after the tests of `history`, oldest first.
#[must_use]
pub fn calibration(history: &[RunSummary], settings: &DetectSettings) -> Calibration {
    let apart = with_units(history, settings);
    let history = &apart[..];
    let starts: Vec<_> = history.iter().map(|run| run.started_at).collect();
    let mut parts = Parts::new(history, settings, None);
    let joints = parts.joints;
    let of_joint = |joint: JointIndex| {
        let epoch = |run: &RunSummary| run.epochs.get(joint.index()).copied().unwrap_or(0);
        let places =
            grouped(history, epoch).into_iter().find(|of| of.last() == Some(&(history.len() - 1)))?;
        parts.add(&places);
        let part = parts.of(&places)?;
        let (friction, causes) = (&part.friction[joint.index()], &part.causes[joint.index()]);
        Some(level(&JointSeries::new(&part.runs, joint, friction, causes, &part.faults, settings)))
    };
    Calibration {
        budget: Budget::new(settings.false_alarms_per_robot_year, joints, &starts),
        advantage: advantage(settings, history),
        tests: history.len(),
        joints: (0..joints).map(JointIndex::new).filter_map(of_joint).collect(),
    }
}

fn level(series: &JointSeries<'_>) -> LevelCalibration {
    let friction = series.friction;
    let limit = judged(series).limit;
    let is_judged = friction.runs.iter().any(|of| !friction.is_learnt_from(of))
        || limit.learnt() >= series.settings.baseline_runs.max(1);
    let figures = || {
        let (scatter, change) = (limit.scatter(), limit.threshold(steady_variance(friction.spread)));
        let delay = |of: f64| mean_run_length(EWMA_WEIGHT, change / scatter, of / scatter);
        LevelFigures { scatter, sigma: limit.limits().sigma, change, delays: CHANGES.map(delay) }
    };
    LevelCalibration {
        joint: series.joint,
        quantity: friction.source.quantity(),
        learnt: limit.learnt(),
        phase: match is_judged {
            false => Phase::NoHistory,
            true if limit.learnt() < OWN_FROM => Phase::Short,
            true => Phase::Own,
        },
        limit: is_judged.then(figures),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::fixtures::{history, wobble};

    #[test]
    fn a_robot_without_a_baseline_has_no_limit_yet() {
        let settings = DetectSettings::default();
        assert_eq!(calibration(&[], &settings).joints, vec![]);
        let found = calibration(&history(3, |_| 12.0), &settings);
        assert_eq!((found.joints[2].phase, found.joints[2].limit), (Phase::NoHistory, None));
        assert_eq!(found.joints.len(), 3);
    }

    #[test]
    fn limits_become_those_of_the_own_history_and_delays_those_of_the_chart() {
        let settings = DetectSettings::default();
        let of =
            |tests: usize| calibration(&history(tests, |i| 12.0 * wobble(i)), &settings).joints[2].clone();
        let (short, own) = (of(12), of(60));
        assert_eq!((short.phase, own.phase, own.learnt), (Phase::Short, Phase::Own, 40));
        let figures = own.limit.expect("a limit");
        assert!(figures.sigma < short.limit.expect("a limit").sigma, "{figures:?}");
        assert!((figures.change - 0.05).abs() < 1e-12, "{figures:?}");
        // 0.6^k below a half and below two thirds; a change equal to the limit takes longer
        let [five, ten, fifteen] = figures.delays;
        assert!((ten - 2.0).abs() < 0.1 && (fifteen - 1.0).abs() < 0.2 && five > 3.0, "{figures:?}");
    }
}
