//! Thermal: alarms of joints' warm-ups that have a common cause.
//!
//! Another lubricant changes the warm-up of all joints, of some more than of others. It shows in one joint before the
//! part that all joints share is beyond chance ([`crate::detect::runs::joint_detectors::warm_up`]). Alarms of two
//! joints to the same side, at the same time or soon after one another, become one alarm of the arm: one cause is
//! likelier than two. So does an alarm of one joint if the median over all joints jumped with it to the same side, by
//! [`LEAST_FACTOR`] or more, [`LEAST_PART`] of the joint's own factor and [`CLEAR_ERRORS`] standard errors. The place
//! of that jump is given, so chance has one try.

use super::one_of_several::{joints_of, one_of_arm};
use crate::detect::runs::curve::run_cause::RunCause;
use crate::detect::runs::curve::warm_up_jump::{LEAST_FACTOR, jump_at};
use crate::detect::runs::parts::Part;
use crate::statistics::descriptive::mean;
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind};

/// The quantities of warm-ups, of a joint and of the arm.
const OF_JOINT: Quantity = Quantity::WarmUpTimeRatio;
const OF_ARM: Quantity = Quantity::CommonWarmUpTimeRatio;
/// Least jump of the common part of all joints, as a part of the joint's, in logarithms.
const LEAST_PART: f64 = 0.6;
/// Least size of that jump in standard errors.
const CLEAR_ERRORS: f64 = 3.0;
/// Most tests from the last one of an alarm to the first one of the next, for alarms in succession.
const APART: usize = 2;
/// Most tests between the onsets of two alarms of one cause.
const TOGETHER: usize = 10;

/// An alarm of a warm-up with the places of its tests.
struct WarmUpAlarm {
    alarm: Anomaly,
    /// Places of its onset and of its last test.
    span: (usize, usize),
    is_longer: bool,
    /// True if the common part of all joints shows it too.
    is_shared: bool,
}

/// Joins the alarms of the arm's warm-up and those of joints in the same tests that belong to it. All other anomalies
/// are unchanged.
pub(in crate::detect::runs) fn joined(found: Vec<Anomaly>, part: &Part<'_>) -> Vec<Anomaly> {
    let place = |run_id: i64| part.moments.iter().position(|(id, _)| *id == run_id);
    let seen = |of: &Anomaly| {
        let is_warm_up = of.kind == AnomalyKind::Thermal && [OF_JOINT, OF_ARM].contains(&of.quantity);
        let span = is_warm_up.then(|| Some((place(of.onset.run_id)?, place(of.last_run_id)?)))??;
        let is_shared = of.joint.is_none() || all_jumped_with(of, span, &part.common_causes);
        Some(WarmUpAlarm { alarm: of.clone(), span, is_longer: of.value > 1.0, is_shared })
    };
    let (mut warm_ups, mut rest) = (Vec::new(), Vec::new());
    for of in found {
        match seen(&of) {
            Some(seen) => warm_ups.push(seen),
            None => rest.push(of),
        }
    }
    warm_ups.sort_by_key(|of| (of.span.0, of.alarm.joint));
    let mut groups: Vec<Vec<WarmUpAlarm>> = Vec::new();
    for of in warm_ups {
        let meets = |other: &WarmUpAlarm| {
            let is_soon = of.span.0 <= (other.span.1 + APART).min(other.span.0 + TOGETHER);
            is_soon && of.is_longer == other.is_longer
        };
        match groups.iter_mut().find(|group| group.iter().any(meets)) {
            Some(group) => group.push(of),
            None => groups.push(vec![of]),
        }
    }
    for group in groups {
        let is_of_one = group.iter().all(|of| of.alarm.joint == group[0].alarm.joint);
        let is_shared = group.iter().any(|of| of.is_shared);
        let is_own = is_of_one && (group[0].alarm.joint.is_none() || !is_shared);
        let alarms: Vec<Anomaly> = group.into_iter().map(|of| of.alarm).collect();
        match one_alarm(&alarms, is_shared).filter(|_| !is_own) {
            Some(of_arm) => rest.push(of_arm),
            None => rest.extend(alarms),
        }
    }
    rest
}

/// Returns true if the common part of all joints jumped with an alarm of one of them, so that it is the arm's.
fn all_jumped_with(of: &Anomaly, (begin, last): (usize, usize), causes: &[Option<RunCause>]) -> bool {
    let known = |at: usize| Some((at, causes.get(at)?.as_ref()?.warm_up?.ln_factor));
    let tests: Vec<(usize, Estimate)> = (0..=last).filter_map(known).collect();
    let before = tests.iter().filter(|(at, _)| *at < begin).count();
    let values: Vec<Estimate> = tests.into_iter().map(|(_, value)| value).collect();
    let own = of.value.ln();
    jump_at(&values, before).is_some_and(|jump| {
        let least = LEAST_FACTOR.ln().max(LEAST_PART * own.abs()).max(CLEAR_ERRORS * jump.std_error);
        jump.value * own.signum() >= least
    })
}

/// One alarm of the arm for these. The factor is that of the arm's alarm, otherwise the geometric mean of the joints'.
fn one_alarm(parts: &[Anomaly], is_shared: bool) -> Option<Anomaly> {
    let all: Vec<&Anomaly> = parts.iter().collect();
    let own = parts.iter().filter(|of| of.joint.is_none()).max_by_key(|of| of.last_seen_at);
    let like = own.or(parts.iter().min_by_key(|of| (of.first_seen_at, of.joint)))?;
    let factors: Vec<f64> = parts.iter().filter(|of| of.joint.is_some()).map(|of| of.value.ln()).collect();
    let value = own.map_or_else(|| mean(&factors).unwrap_or(0.0).exp(), |of| of.value);
    let side = if value > 1.0 { "longer" } else { "less" };
    let shown = match &joints_of(&all)[..] {
        [one] => format!("joint {one} shows it by itself"),
        all => format!("joints {} show it by themselves", all.join(", ")),
    };
    let cause = match is_shared {
        true => "and all joints share it, as with another or an aged lubricant",
        false => {
            "at about the same time, so that one cause is likelier than two: check the lubricant and what cools the arm"
        }
    };
    Some(Anomaly {
        quantity: OF_ARM,
        value,
        score: value.ln().abs(),
        peak_value: own.map_or(value, |of| of.peak_value),
        peak_score: own.map_or(value.ln().abs(), |of| of.peak_score),
        // the compared causes of one joint are not those of the arm
        odds: own.and_then(|of| of.odds),
        alternatives: own.map_or_else(Vec::new, |of| of.alternatives.clone()),
        message: format!(
            "warming up takes {side} than before, about {value:.1} times as long; {shown}, {cause}"
        ),
        ..one_of_arm(&all, like)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::cause_tests::{State, fleet, only};
    use crate::detect::runs::curve::run_cause::WarmUpOfRun;

    /// Two of six joints whose slow time constant is 55 instead of 25 minutes.
    fn two_slower(joint: usize, cycle: u32) -> f64 {
        let minute = 3.1 * f64::from(cycle) - 1.2;
        let is_slower = joint == 1 || joint == 4;
        if is_slower { 0.25 * ((-minute / 55.0).exp() - (-minute / 25.0).exp()) } else { 0.0 }
    }

    #[test]
    fn two_joints_that_warm_up_otherwise_at_once_are_one_alarm_of_the_arm() {
        for seed in 1..=4 {
            let mut history = fleet(30, seed, |run| State {
                friction: (run >= 12).then_some(two_slower),
                ..State::default()
            });
            // the index is friction at equal thermal state
            for (run, healthy) in history.iter_mut().zip(fleet(30, seed, |_| State::default())) {
                for (joint, healthy) in run.joints.iter_mut().zip(healthy.joints) {
                    joint.friction_index = healthy.friction_index;
                }
            }
            let alarm = only(&history, AnomalyKind::Thermal, None);
            assert_eq!(alarm.quantity, OF_ARM, "{alarm:?}");
            assert!(alarm.message.contains("joints 2, 5 show it by themselves"), "{}", alarm.message);
            assert!((alarm.value / 2.2).ln().abs() < 0.5 && !alarm.ended, "{alarm:?}");
        }
    }

    #[test]
    fn a_joint_alone_stays_the_joint_that_is_blamed() {
        for seed in 1..=6 {
            let history =
                fleet(30, seed, |run| State { slower: (run >= 12).then_some((2, 2.2)), ..State::default() });
            let alarm = only(&history, AnomalyKind::Thermal, Some(3));
            assert_eq!(alarm.quantity, OF_JOINT, "{alarm:?}");
        }
    }

    #[test]
    fn a_joint_is_not_blamed_where_what_all_share_jumped_with_it() {
        let history =
            fleet(30, 1, |run| State { slower: (run >= 12).then_some((2, 2.2)), ..State::default() });
        let alarm = only(&history, AnomalyKind::Thermal, Some(3));
        // the common part of all joints: a scatter of 0.05, and a jump with the thirteenth test
        let is_of_arm = |jump: f64| {
            let of = |run: usize| {
                let value =
                    if run.is_multiple_of(2) { 0.05 } else { -0.05 } + if run < 12 { 0.0 } else { jump };
                let ln_factor = Estimate { value, std_error: 0.1 };
                Some(RunCause {
                    warm_up: Some(WarmUpOfRun { ln_factor, common: 0.0 }),
                    ..RunCause::of_nothing()
                })
            };
            all_jumped_with(&alarm, (12, 29), &(0..30).map(of).collect::<Vec<_>>())
        };
        let own = alarm.value.ln();
        assert!(is_of_arm(own) && is_of_arm(0.7 * own));
        assert!(!is_of_arm(0.0) && !is_of_arm(-own), "no jump, and one to the other side");
        assert!(!is_of_arm(0.5 * own), "the joint's own is twice as large");
    }
}
