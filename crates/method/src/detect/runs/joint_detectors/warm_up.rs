//! Thermal: the warm-up of a joint, or of all joints, takes another time than in its first runs.
//!
//! The quantity is the slow time constant as a multiple of that of the usual curve. The comparison of causes
//! ([`crate::detect::runs::curve`]) distinguishes it from another level of friction and from another temperature at the
//! start: a time constant changes nothing in the first cycle and most in the middle of the warm-up. A run is out if
//! this cause is clear and moves friction of some cycle by 1.5 % or more. A smaller effect is found over several runs:
//! the likelihood ratio against the best other cause is summed, never below zero (CUSUM, Page 1954), until it reaches
//! the value that one run needs. The factors of the runs are also evaluated as a series
//! ([`crate::detect::runs::curve::warm_up_jump`]).
//!
//! The common part of all joints is checked in the same way, as the warm-up of the arm. If it differs, joints are not
//! checked separately: they differ in the effect of a lubricant.

use jiff::Timestamp;

use crate::detect::detector::Detector;
use crate::detect::episodes::episodes;
use crate::detect::rate::budget::Budget;
use crate::detect::runs::arm::cause::ArmCause;
use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::curve::run_cause::RunCause;
use crate::detect::runs::curve::warm_up_jump::{JumpLimits, LEAST_FACTOR, WarmUpJump};
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Severity};

pub(super) struct WarmUp;

impl Detector<JointSeries<'_>> for WarmUp {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Thermal
    }

    fn quantity(&self, _: &JointSeries<'_>) -> Quantity {
        Quantity::WarmUpTimeRatio
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let is_known = |run: usize| {
            series.runs[run].is_some() && !series.has_wrong_signal(run) && !series.is_warm_up_of_arm(run)
        };
        let warm_ups = WarmUps {
            causes: series.causes,
            of_arm: &|run: usize| series.warm_up_of_arm(run),
            is_known: &is_known,
            alpha: alpha(series.settings, series.joints, &series.starts),
            limits: JumpLimits::OF_JOINT,
            least_lead: 0.0,
            whose: "the joint's",
            remedy: "cold and warm friction fit; check the lubricant and what cools the joint",
        };
        warm_ups.verdicts()
    }
}

/// Verdicts about the warm-up that all joints share, by run. `causes` are those of the common part, `faults` the fault
/// of the arm in each run, `runs` key and start of each.
pub(in crate::detect::runs) fn common_warm_up(
    causes: &[Option<RunCause>],
    faults: &[Option<ArmCause>],
    joints: usize,
    runs: &[(i64, Timestamp)],
    settings: &DetectSettings,
) -> Vec<Verdict> {
    let starts: Vec<Timestamp> = runs.iter().map(|(_, start)| *start).collect();
    let warm_ups = WarmUps {
        causes,
        of_arm: &|_| 0.0,
        is_known: &|run: usize| !matches!(faults.get(run), Some(Some(ArmCause::Load(_)))),
        alpha: alpha(settings, joints, &starts),
        limits: JumpLimits::OF_ARM,
        least_lead: LEAST_LEAD_OF_ARM,
        whose: "the arm's",
        remedy: "friction of the first cycle fits; all joints do so, as with another or an aged lubricant",
    };
    warm_ups.verdicts()
}

/// Anomalies of the warm-up that all joints share, from the verdicts of [`common_warm_up`].
pub(in crate::detect::runs) fn of_common_warm_up(
    verdicts: &[Verdict],
    runs: &[(i64, Timestamp)],
) -> Vec<Anomaly> {
    episodes(runs, None, AnomalyKind::Thermal, Quantity::CommonWarmUpTimeRatio, verdicts.to_vec())
}

fn alpha(settings: &DetectSettings, joints: usize, starts: &[Timestamp]) -> f64 {
    Budget::new(settings.false_alarms_per_robot_year, joints, starts).alpha()
}

/// Warm-ups of successive runs, and the texts for one that differs.
struct WarmUps<'a> {
    causes: &'a [Option<RunCause>],
    /// Returns true if a run shows the warm-ups.
    is_known: &'a dyn Fn(usize) -> bool,
    /// Logarithm of the factor that all joints share in a run; 0 for the common part itself.
    of_arm: &'a dyn Fn(usize) -> f64,
    /// Probability of a false alarm per run.
    alpha: f64,
    limits: JumpLimits,
    /// Least lead, in logarithms, of this cause over the next one in a single run.
    least_lead: f64,
    /// For the message: the robot or joint of the first tests, other explanations and the remedy.
    whose: &'static str,
    remedy: &'static str,
}

impl WarmUps<'_> {
    fn verdicts(&self) -> Vec<Verdict> {
        // evidence over the runs for a longer and for a shorter time constant
        let mut evidence = [0.0_f64; 2];
        let mut jumps = WarmUpJump::new(self.alpha, self.limits);
        let verdict = |run: usize| {
            let Some(found) = self.causes[run].as_ref().filter(|_| (self.is_known)(run)) else {
                return Verdict::Unknown;
            };
            let slowing = found.slowing;
            for (side, sum) in evidence.iter_mut().enumerate() {
                let own = slowing.filter(|(factor, _)| (*factor > 1.0) == (side == 0));
                *sum =
                    (*sum + own.map_or(AGAINST, |(_, gain)| gain)).clamp(0.0, MOST_EVIDENCE * found.needed());
            }
            let jump = jumps.add(run, found, (self.of_arm)(run));
            let clear = match found.clear() {
                Some(Cause::TimeConstant(factor)) if found.lead >= self.least_lead => Some(factor),
                _ => slowing
                    .map(|(factor, _)| factor)
                    .filter(|factor| evidence[usize::from(*factor < 1.0)] >= found.needed()),
            };
            let (factor, usual) = match (clear, jump) {
                (Some(factor), _) => (factor, format!("in {} first tests", self.whose)),
                (None, Some(jump)) => (jump.size.exp(), format!("before, for {} tests now", jump.tests)),
                (None, None) => return Verdict::Quiet,
            };
            // a single test that shows it may be the first of several
            let onset = jump.map(|jump| (jump.since, None));
            let side = if factor > 1.0 { "longer" } else { "less" };
            let is_own = matches!(found.likeliest(), Cause::TimeConstant(_));
            Verdict::Out {
                severity: Severity::Warning,
                score: factor.ln().abs(),
                threshold: LEAST_FACTOR.ln(),
                value: factor,
                baseline: 1.0,
                message: format!(
                    "warming up takes {side} than {usual}, about {factor:.1} times as long, while {}",
                    self.remedy
                ),
                why: Why {
                    quantity: None,
                    onset,
                    odds: is_own.then(|| found.odds()),
                    alternatives: if is_own { found.alternatives() } else { Vec::new() },
                },
            }
        };
        (0..self.causes.len()).map(verdict).collect()
    }
}

/// Least lead for the common part of all joints. It also depends on starts and ambient temperatures, whose patterns are
/// less exact than a joint's own.
const LEAST_LEAD_OF_ARM: f64 = 8.0;
/// Evidence of a run without the change, in logarithms of likelihood.
const AGAINST: f64 = -3.0;
/// Upper limit of the sum of evidence, as a multiple of that for an alarm, so that an alarm ends with its cause.
const MOST_EVIDENCE: f64 = 1.5;

#[cfg(test)]
mod tests {
    use crate::detect::runs::cause_tests::{State, alarms, fleet, only};
    use armwatch_model::anomaly::AnomalyKind;
    use armwatch_model::anomaly::quantity::Quantity;

    #[test]
    fn another_warm_up_of_all_joints_is_one_alarm_of_the_arm() {
        for (seed, factor) in [(1, 2.0), (2, 2.0), (3, 2.0), (4, 0.5), (5, 0.5)] {
            let history =
                fleet(24, seed, |run| State { lubricant: (run >= 12).then_some(factor), ..State::default() });
            let alarm = only(&history, AnomalyKind::Thermal, None);
            assert_eq!(alarm.quantity, Quantity::CommonWarmUpTimeRatio, "{alarm:?}");
            assert!((12..=18).contains(&alarm.first_run_id), "{alarm:?}");
            assert!(!alarm.ended, "{alarm:?}");
            assert!((alarm.value / factor).ln().abs() < 0.5, "{alarm:?}");
        }
    }

    #[test]
    fn starts_that_are_half_warm_and_a_warmer_hall_are_no_other_warm_up() {
        fn excess(cycle: u32) -> f64 {
            let minute = 3.1 * f64::from(cycle) - 1.2;
            0.15 * (-minute / 5.0).exp() + 0.25 * (-minute / 25.0).exp()
        }
        /// Production before each test: a fifth of the warm-up is over when it begins.
        fn half_warm(_: usize, cycle: u32) -> f64 {
            -0.2 * excess(cycle)
        }
        /// A higher ambient temperature; a joint that heats itself keeps half of its effect when warm.
        fn warmer(_: usize, cycle: u32) -> f64 {
            -0.07 * (0.5 + 0.5 * excess(cycle) / excess(1))
        }
        for (seed, friction) in [half_warm as fn(usize, u32) -> f64, warmer]
            .into_iter()
            .flat_map(|of| (1..=4).map(move |s| (s, of)))
        {
            let history = fleet(30, seed, |run| State {
                friction: (run >= 12).then_some(friction),
                ..State::default()
            });
            let alarms = alarms(&history);
            assert!(alarms.iter().all(|of| of.kind != AnomalyKind::Thermal), "{seed}: {alarms:?}");
        }
    }
}
