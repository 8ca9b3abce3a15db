//! Joints that oscillate together: one alarm of the arm that names them.
//!
//! A belt, a coupled wrist or an unsteady supply moves the friction of several joints in the same cycles. Joints whose
//! friction oscillates in the same tests belong together if the residuals of their cycles about a smooth course of the
//! test are correlated: by [`LEAST_CORRELATION`] or more, and beyond chance for two independent joints (Fisher's z over
//! all tests that both oscillate in). The sign does not matter: friction of one joint may rise while that of the other
//! falls.

use super::one_of_several::{joints_of, one_of_arm};
use crate::detect::runs::curve::points::{Curve, curves};
use crate::detect::runs::curve::within_run;
use crate::statistics::distributions::normal_quantile;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary};
use armwatch_model::robot::JointIndex;

/// Least correlation: each joint then explains half of the variance of the other.
const LEAST_CORRELATION: f64 = 0.7;
/// Probability that a pair of independent joints counts as coupled.
const BY_CHANCE: f64 = 1e-3;

/// Coupling of two joints in the cycles of the tests with oscillations of both.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SwingCoupling {
    correlation: f64,
    cycles: usize,
    tests: usize,
}

/// Joins the oscillations of joints that swing together; `runs` are the tests of the robot, oldest first. All other
/// anomalies are unchanged.
pub(in crate::detect::runs) fn joined(
    mut found: Vec<Anomaly>,
    runs: &[RunSummary],
    joints: usize,
) -> Vec<Anomaly> {
    let is_swing = |of: &Anomaly| of.kind == AnomalyKind::Oscillation && of.joint.is_some();
    let mut free: Vec<usize> = (0..found.len()).filter(|place| is_swing(&found[*place])).collect();
    if free.len() < 2 {
        return found;
    }
    let residuals: Vec<Vec<Vec<(u32, f64)>>> =
        (0..joints).map(|joint| residuals(runs, JointIndex::new(joint))).collect();
    let place = |run_id: i64| runs.iter().position(|run| run.run_id == run_id).unwrap_or(0);
    let span = |of: &Anomaly| (place(of.first_run_id), place(of.last_run_id));
    let mut of_arm = Vec::new();
    let mut joined = Vec::new();
    while let Some(first) = free.pop() {
        let mut group = vec![first];
        let mut couplings: Vec<SwingCoupling> = Vec::new();
        // a joint that swings with one of the group belongs to it
        while let Some((at, coupling)) = free.iter().enumerate().find_map(|(at, &other)| {
            let with = |&one: &usize| coupled(&found[one], &found[other], &residuals, &span);
            Some((at, group.iter().find_map(with)?))
        }) {
            group.push(free.swap_remove(at));
            couplings.push(coupling);
        }
        let Some(coupling) = couplings.into_iter().max_by_key(|of| of.cycles) else { continue };
        // the other oscillations of these joints in these tests have the same cause
        let is_same = |&other: &usize| {
            let (from, to) = span(&found[other]);
            let meets = |one: &usize| {
                let (first, last) = span(&found[*one]);
                found[*one].joint == found[other].joint && from <= last && first <= to
            };
            is_swing(&found[other]) && !joined.contains(&other) && group.iter().any(meets)
        };
        let same: Vec<usize> =
            (0..found.len()).filter(is_same).filter(|other| !group.contains(other)).collect();
        free.retain(|of| !same.contains(of));
        let all = |places: &[usize]| places.iter().map(|&place| &found[place]).collect::<Vec<&Anomaly>>();
        of_arm.push(one_alarm(&all(&group), &all(&same), coupling));
        joined.extend(group.into_iter().chain(same));
    }
    let mut place = 0;
    found.retain(|_| {
        place += 1;
        !joined.contains(&(place - 1))
    });
    found.extend(of_arm);
    found
}

/// The coupling of two oscillations of friction, if there is one.
fn coupled(
    one: &Anomaly,
    other: &Anomaly,
    residuals: &[Vec<Vec<(u32, f64)>>],
    span: &dyn Fn(&Anomaly) -> (usize, usize),
) -> Option<SwingCoupling> {
    let (a, b) = (one.joint?, other.joint?);
    let ((from, to), (from_other, to_other)) = (span(one), span(other));
    let (first, last) = (from.max(from_other), to.min(to_other));
    if a == b || [one, other].iter().any(|of| of.quantity != Quantity::FrictionSwing) || first > last {
        return None;
    }
    let [mut own, mut others, mut products] = [0.0; 3];
    let (mut cycles, mut tests, mut freedom) = (0, 0, 0.0);
    let both = residuals[a.index()].iter().zip(&residuals[b.index()]);
    for (of_a, of_b) in both.take(last + 1).skip(first) {
        let pairs: Vec<(f64, f64)> = of_a
            .iter()
            .filter_map(|(cycle, x)| of_b.iter().find(|(of, _)| of == cycle).map(|(_, y)| (*x, *y)))
            .collect();
        // the smooth course used some degrees of freedom
        let left = pairs.len() as f64 - within_run::COURSE_PARAMETERS;
        if left < 2.0 {
            continue;
        }
        for (x, y) in &pairs {
            own += x * x;
            others += y * y;
            products += x * y;
        }
        cycles += pairs.len();
        tests += 1;
        freedom += left;
    }
    let correlation = products / (own * others).sqrt().max(f64::MIN_POSITIVE);
    // of n degrees of freedom about a known mean, atanh r has the variance 1 / (n - 2)
    let z = correlation.clamp(-0.9999, 0.9999).atanh().abs() * (freedom - 2.0).max(0.0).sqrt();
    let joints = residuals.len() as f64;
    let pairs = 0.5 * joints * (joints - 1.0);
    let is_coupled = correlation.abs() >= LEAST_CORRELATION
        && z >= normal_quantile(1.0 - 0.5 * BY_CHANCE / pairs.max(1.0));
    is_coupled.then_some(SwingCoupling { correlation, cycles, tests })
}

/// Residual of each cycle of a joint about a smooth course of its test, by test.
fn residuals(runs: &[RunSummary], joint: JointIndex) -> Vec<Vec<(u32, f64)>> {
    let of = |curve: &Curve| {
        let left = within_run::residuals(curve).unwrap_or_default();
        curve.iter().zip(left).map(|(point, of)| (point.cycle, of)).collect()
    };
    curves(runs, joint).iter().map(of).collect()
}

/// The alarm of the arm for the oscillations of joints that swing together; `same` are additional ones of these joints.
fn one_alarm(group: &[&Anomaly], same: &[&Anomaly], coupling: SwingCoupling) -> Anomaly {
    let mut by_joint: Vec<&Anomaly> = group.to_vec();
    by_joint.sort_by_key(|of| of.joint);
    by_joint.dedup_by_key(|of| of.joint);
    let figures: Vec<String> = by_joint
        .iter()
        .filter_map(|of| Some(format!("joint {} by {:.1} %", of.joint?, 100.0 * of.value)))
        .collect();
    let all: Vec<&Anomaly> = group.iter().chain(same).copied().collect();
    let strongest =
        group.iter().copied().max_by(|a, b| a.peak_score.total_cmp(&b.peak_score)).unwrap_or(group[0]);
    let sense = if coupling.correlation > 0.0 { "in the same sense" } else { "against each other" };
    let tests = if coupling.tests == 1 { "one test".into() } else { format!("{} tests", coupling.tests) };
    Anomaly {
        message: format!(
            "joints {} oscillate together, {sense}: friction from cycle to cycle varies ({}; correlation {:+.2} over {} \
             cycles of {tests}); one cause is likelier than two: look at what couples them, a belt, a wrist gear, brakes \
             of one circuit or the supply",
            joints_of(group).join(" and "),
            figures.join(", "),
            coupling.correlation,
            coupling.cycles
        ),
        ..one_of_arm(&all, strongest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::cause_tests::{State, fleet};
    use crate::detect::runs::detect;
    use armwatch_model::anomaly::settings::DetectSettings;

    /// Oscillations of a fleet with two joints that swing from the ninth test on.
    fn oscillations(seed: u64, swing: fn(usize, u32) -> f64) -> Vec<Anomaly> {
        let state = |run: i64| State { friction: (run >= 8).then_some(swing), ..State::default() };
        let mut found = detect(&fleet(12, seed, state), &DetectSettings::default()).anomalies;
        found.retain(|of| of.kind == AnomalyKind::Oscillation);
        found
    }

    /// A pseudo-random number between -1 and 1 for a cycle.
    fn drawn(cycle: u32, salt: u32) -> f64 {
        let hash = cycle.wrapping_mul(2_654_435_761).rotate_left(7) ^ salt.wrapping_mul(40_503);
        f64::from(hash.wrapping_mul(2_246_822_519) >> 16) / 32_767.5 - 1.0
    }

    #[test]
    fn a_pair_that_swings_together_is_one_alarm_that_names_both() {
        for (seed, sign) in [(3, 1.0), (4, -1.0), (5, 1.0)] {
            let swing = if sign > 0.0 {
                |joint: usize, cycle: u32| match joint {
                    2 => 0.10 * drawn(cycle, 1),
                    3 => 0.07 * drawn(cycle, 1),
                    _ => 0.0,
                }
            } else {
                |joint: usize, cycle: u32| match joint {
                    2 => 0.10 * drawn(cycle, 1),
                    3 => -0.07 * drawn(cycle, 1),
                    _ => 0.0,
                }
            };
            let found = oscillations(seed, swing);
            let [of] = &found[..] else { panic!("one alarm: {found:?}") };
            assert_eq!((of.joint, of.first_run_id), (None, 9), "{of:?}");
            assert!(of.message.contains("joints 3 and 4"), "{}", of.message);
            assert!(of.message.contains("against each other") == (sign < 0.0), "{}", of.message);
        }
    }

    #[test]
    fn joints_that_swing_by_themselves_are_two_alarms() {
        for seed in [3, 4, 5] {
            let found = oscillations(seed, |joint, cycle| match joint {
                2 => 0.10 * drawn(cycle, 1),
                3 => 0.07 * drawn(cycle, 77),
                _ => 0.0,
            });
            let joints: Vec<Option<JointIndex>> = found.iter().map(|of| of.joint).collect();
            assert_eq!(joints, [Some(JointIndex::new(2)), Some(JointIndex::new(3))], "{found:?}");
        }
    }
}
