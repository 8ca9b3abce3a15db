//! One joint in the runs of a robot.

use std::collections::VecDeque;

use jiff::Timestamp;

use super::arm::cause::{ArmCause, SignalFault};
use super::curve::hypothesis::Cause;
use super::curve::run_cause::RunCause;
use super::curve::warm_up_jump::LEAST_FACTOR;
use super::history::friction_history::FrictionHistory;
use crate::detect::detector::Detector;
use crate::detect::verdict::Verdict;
use crate::statistics::descriptive::median;
use armwatch_model::analysis::{Estimate, JointSummary};
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::peer::Peer;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::JointIndex;

/// Least size of another warm-up in the common part of all joints, in standard errors.
const CLEAR_ERRORS: f64 = 2.0;

/// A detector of a joint's tests.
pub(super) type RunDetector = dyn for<'a> Detector<JointSeries<'a>>;

/// One joint over the complete runs of its robot, oldest first.
pub(super) struct JointSeries<'a> {
    pub(super) joint: JointIndex,
    /// One entry per run; `None` if the run has no summary of the joint.
    pub(super) runs: Vec<Option<&'a JointSummary>>,
    /// Start of each run.
    pub(super) starts: Vec<Timestamp>,
    /// Largest RMS torque among the joints of each run, Nm (N); 0 if unknown.
    largest_torques: Vec<f64>,
    /// Number of joints of the arm.
    pub(super) joints: usize,
    /// Friction of these runs, for the detector of drift and the joint's health.
    pub(super) friction: &'a FrictionHistory,
    /// Cause of the difference between the curve of each run and the usual one.
    pub(super) causes: &'a [Option<RunCause>],
    /// The fault of the whole arm that each run has.
    pub(super) faults: &'a [Option<ArmCause>],
    /// Cause of the difference between the common part of all joints and the usual one in each run, and the verdicts
    /// about their warm-up; empty if they were not evaluated.
    common_causes: &'a [Option<RunCause>],
    common_warm_up: &'a [Verdict],
    pub(super) settings: &'a DetectSettings,
    /// Other robots of the model.
    peers: &'a [Peer],
}

fn largest_torque(run: &RunSummary) -> f64 {
    run.joints.iter().filter_map(|of| of.torque_rms).fold(0.0, f64::max)
}

impl<'a> JointSeries<'a> {
    pub(super) fn new(
        history: &'a [RunSummary],
        joint: JointIndex,
        friction: &'a FrictionHistory,
        causes: &'a [Option<RunCause>],
        faults: &'a [Option<ArmCause>],
        settings: &'a DetectSettings,
    ) -> Self {
        let starts = history.iter().map(|run| run.started_at).collect();
        let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
        Self {
            joint,
            runs: summaries(history, joint),
            starts,
            largest_torques: history.iter().map(largest_torque).collect(),
            joints,
            friction,
            causes,
            faults,
            common_causes: &[],
            common_warm_up: &[],
            settings,
            peers: &[],
        }
    }

    /// Largest RMS torque among the joints in a run, Nm (N); 0 if unknown.
    pub(super) fn largest_torque(&self, run: usize) -> f64 {
        self.largest_torques[run]
    }

    /// The same with other robots of the model to compare with.
    pub(super) fn among(self, peers: &'a [Peer]) -> Self {
        Self { peers, ..self }
    }

    /// The same with the causes of the common part of all joints, and the verdicts about their warm-up.
    pub(super) fn beside(self, common_causes: &'a [Option<RunCause>], common_warm_up: &'a [Verdict]) -> Self {
        Self { common_causes, common_warm_up, ..self }
    }

    /// A value of this joint in each of the other robots of the model: the median of its first tests. Robots without it
    /// in most of these are omitted.
    pub(super) fn of_peers(&self, figure: impl Fn(&JointSummary) -> Option<f64>) -> Vec<f64> {
        let usual = |peer: &Peer| {
            let of_joint = |test: &Vec<JointSummary>| test.iter().find(|of| of.joint == self.joint).copied();
            let known: Vec<f64> =
                peer.tests.iter().filter_map(of_joint).filter_map(|of| figure(&of)).collect();
            median(&known).filter(|_| 2 * known.len() > peer.tests.len())
        };
        self.peers.iter().filter_map(usual).collect()
    }

    /// A value of each run, `None` if it was not measured.
    pub(super) fn figures(&self, figure: impl Fn(&JointSummary) -> Option<f64>) -> Vec<Option<f64>> {
        self.runs.iter().map(|summary| summary.and_then(&figure)).collect()
    }

    /// The clear cause of a run's friction curve.
    pub(super) fn clear_cause(&self, run: usize) -> Option<Cause> {
        self.causes.get(run)?.as_ref()?.clear()
    }

    /// Returns true if the friction of a run has a clear cause other than its level: another time constant, or a signal
    /// of this joint with a wrong scale or offset.
    pub(super) fn is_level_explained(&self, run: usize) -> bool {
        let is_noise =
            matches!(self.fault(run), Some(ArmCause::TorqueSignal { fault: SignalFault::Noise(_), .. }));
        matches!(self.clear_cause(run), Some(Cause::TimeConstant(_)))
            || self.has_wrong_signal(run) && !is_noise
    }

    /// Returns true if friction of a run scatters from cycle to cycle, as a separate cause.
    pub(super) fn is_scattered(&self, run: usize) -> bool {
        matches!(self.clear_cause(run), Some(Cause::Scatter(_)))
    }

    /// Returns true if one of the latest tests before a run scatters from cycle to cycle.
    pub(super) fn scattered_before(&self, run: usize) -> bool {
        (run.saturating_sub(LATEST_WITH_SCATTER)..run).any(|before| self.is_scattered(before))
    }

    /// Returns true if the warm-up of all joints differs, or may differ, in a run, to the same side as the joint's.
    pub(super) fn is_warm_up_of_arm(&self, run: usize) -> bool {
        let is_longer = self.causes[run].as_ref().and_then(|of| of.slowing).map(|(factor, _)| factor > 1.0);
        let may_be = |of: &RunCause| {
            let is_likeliest = of.is_beyond_margin() && matches!(of.likeliest(), Cause::TimeConstant(_));
            let is_same = |Estimate { value, std_error }: Estimate| {
                let is_clear = value.abs() >= LEAST_FACTOR.ln().max(CLEAR_ERRORS * std_error);
                is_clear && is_longer == Some(value > 0.0)
            };
            is_likeliest || of.warm_up.is_some_and(|of| is_same(of.ln_factor))
        };
        matches!(self.common_warm_up.get(run), Some(Verdict::Out { .. }))
            || self.common_causes.get(run).is_some_and(|of| of.as_ref().is_some_and(may_be))
    }

    /// Natural logarithm of the factor of the slow time constant that all joints share in a run; 0 if unknown.
    pub(super) fn warm_up_of_arm(&self, run: usize) -> f64 {
        let cause = self.common_causes.get(run).and_then(Option::as_ref);
        cause.and_then(|of| of.warm_up).map_or(0.0, |of| of.ln_factor.value)
    }

    fn fault(&self, run: usize) -> Option<ArmCause> {
        *self.faults.get(run)?
    }

    /// Returns true if a signal of this joint is wrong in a run.
    pub(super) fn has_wrong_signal(&self, run: usize) -> bool {
        matches!(
            self.fault(run),
            Some(ArmCause::TorqueSignal { joint, .. } | ArmCause::PositionSignal { joint, .. })
                if joint == self.joint
        )
    }

    /// Returns true if a wrong signal in a run explains the torque of this joint beyond its model: the joint's own
    /// signal, the torque of the next joint, since this joint is part of its fit, or a position, since every joint's
    /// torque depends on it.
    pub(super) fn is_rest_of_wrong_signal(&self, run: usize) -> bool {
        match self.fault(run) {
            Some(ArmCause::TorqueSignal { joint, .. }) => {
                joint == self.joint || joint.index() == self.joint.index() + 1
            }
            Some(ArmCause::PositionSignal { .. }) => true,
            _ => false,
        }
    }

    /// Returns true if the joint's unexplained torque in a run has a cause that is reported separately.
    pub(super) fn is_rest_explained(&self, run: usize) -> bool {
        matches!(self.fault(run), Some(ArmCause::UnexplainedTorque { joint, .. }) if joint == self.joint)
            || self.is_rest_of_wrong_signal(run)
    }
}

/// Friction of a joint over the runs. A jump inside a run of the baseline ends the baseline there.
pub(super) fn friction_history(
    history: &[RunSummary],
    joint: JointIndex,
    causes: &[Option<RunCause>],
    baseline_runs: usize,
) -> FrictionHistory {
    let mut friction = FrictionHistory::new(&summaries(history, joint), baseline_runs);
    let jumps =
        |of: &Option<RunCause>| matches!(of.as_ref().and_then(RunCause::clear), Some(Cause::Step { .. }));
    if let Some(run) = causes.iter().position(jumps).filter(|run| friction.is_learnt_at(*run)) {
        friction.learn_before(run);
    }
    let errors = level_errors(history, causes);
    friction.widen(|run| errors.get(run).copied().flatten());
    friction
}

/// Number of latest tests with scatter from cycle to cycle that are averaged.
const LATEST_WITH_SCATTER: usize = 8;

/// Standard error of each test's level by scatter from cycle to cycle, as a fraction: the mean of few cycles with
/// scatter is that uncertain. The scatter of a joint is the mean variance of the latest tests that show it, since the
/// few cycles of one test are not enough. A test that may have scatter without showing it clearly gets the same error.
fn level_errors(history: &[RunSummary], causes: &[Option<RunCause>]) -> Vec<Option<f64>> {
    // variance and degrees of freedom
    let mut latest: VecDeque<(f64, f64)> = VecDeque::new();
    let error = |(run, cause): (&RunSummary, &Option<RunCause>)| {
        let may_scatter = match cause {
            // too few cycles to decide
            None => true,
            Some(of) => match of.clear() {
                Some(Cause::Scatter(size)) => {
                    latest.push_front((size * size, of.cycles.max(2) as f64 - 1.0));
                    latest.truncate(LATEST_WITH_SCATTER);
                    true
                }
                _ => of.may_scatter(),
            },
        };
        let freedom: f64 = latest.iter().map(|(_, freedom)| freedom).sum();
        let squares: f64 = latest.iter().map(|(variance, freedom)| variance * freedom).sum();
        let cycles = cause.as_ref().map_or(run.cycles as usize, |of| of.cycles).max(1) as f64;
        (may_scatter && freedom > 0.0).then(|| (squares / freedom / cycles).sqrt())
    };
    history.iter().zip(causes).map(error).collect()
}

fn summaries(history: &[RunSummary], joint: JointIndex) -> Vec<Option<&JointSummary>> {
    history.iter().map(|run| run.joints.iter().find(|summary| summary.joint == joint)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::curve::run_cause::Kind;

    #[test]
    fn a_test_that_may_scatter_knows_its_level_as_badly_as_one_that_did() {
        let scattered = RunCause {
            kinds: vec![Kind { cause: Cause::Scatter(0.12), weight: 1.0 }],
            advantage: 100.0,
            lead: 50.0,
            cycles: 9,
            ..RunCause::of_nothing()
        };
        let unclear = RunCause { advantage: 5.0, lead: 0.1, cycles: 4, ..scattered.clone() };
        let quiet = RunCause::of_nothing();
        let history = vec![RunSummary { cycles: 16, ..RunSummary::default() }; 6];
        let causes = [None, Some(unclear.clone()), Some(scattered), Some(unclear), Some(quiet), None];
        let errors = level_errors(&history, &causes);
        let near = |of: Option<f64>, wanted: f64| of.is_some_and(|of| (of - wanted).abs() < 1e-12);
        assert_eq!(
            [errors[0], errors[1], errors[4]],
            [None; 3],
            "nothing is known of scatter, or there is none"
        );
        assert!(near(errors[2], 0.04) && near(errors[3], 0.06) && near(errors[5], 0.03), "{errors:?}");
    }
}
