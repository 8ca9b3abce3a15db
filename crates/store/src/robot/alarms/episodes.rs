//! Assignment of found episodes to stored ones. Pure.
//!
//! A new fit of the history can move the first run of an episode, its quantity and sometimes its kind. The joint and
//! the time of its runs stay.

use std::cmp::Reverse;

use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::run::RunKind;

/// An episode in time. Times are microseconds since 1970.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::robot) struct Episode {
    /// Number of the joint; `None` if the cause affects the whole arm.
    pub(in crate::robot) joint: Option<i64>,
    pub(in crate::robot) kind: AnomalyKind,
    pub(in crate::robot) quantity: Quantity,
    /// Its onset, or the start of its first run if that is earlier.
    pub(in crate::robot) from: i64,
    /// Start of the latest run that showed it.
    pub(in crate::robot) to: i64,
    pub(in crate::robot) ended: bool,
    /// True if an earlier conclusion withdrew it.
    pub(in crate::robot) withdrawn: bool,
}

/// Starts of the robot's complete runs, ascending: tests and production logs. At least the first [`RUNS_APART`] after
/// each stored episode that has not ended.
#[derive(Debug, Clone, Default)]
pub(in crate::robot) struct Starts {
    pub(in crate::robot) tests: Vec<i64>,
    pub(in crate::robot) production: Vec<i64>,
}

/// Runs without the anomaly after which a new finding is another episode, as in the detectors.
pub(super) const RUNS_APART: usize = 2;

/// Kinds that people see as one fault of a joint, a change of friction, whichever kind the evidence favours.
const FRICTION_KINDS: [AnomalyKind; 2] = [AnomalyKind::Drift, AnomalyKind::Step];

/// For each found episode the stored one that it continues; each stored one is used once. Pairs are formed in three
/// passes, each by the best overlap in time: first those of one cause, then those whose cause was corrected, last those
/// that were withdrawn before.
pub(in crate::robot) fn same(stored: &[Episode], found: &[Episode], starts: &Starts) -> Vec<Option<usize>> {
    let mut chosen = vec![None; found.len()];
    let mut used = vec![false; stored.len()];
    let passes: [fn(&Episode, &Episode) -> bool; 3] = [
        |old, new| !old.withdrawn && is_of_one_cause(old, new),
        |old, new| !old.withdrawn && may_be_corrected(old, new),
        |old, new| old.withdrawn && is_of_one_cause(old, new),
    ];
    for may_be in passes {
        let mut pairs = Vec::new();
        for (o, old) in stored.iter().enumerate().filter(|(o, _)| !used[*o]) {
            for (n, new) in found.iter().enumerate().filter(|(n, _)| chosen[*n].is_none()) {
                if old.joint == new.joint
                    && may_be(old, new)
                    && let Some(overlap) = overlap(old, new, starts)
                {
                    let order = (old.ended != new.ended, Reverse(overlap), old.from.abs_diff(new.from), o, n);
                    pairs.push(order);
                }
            }
        }
        pairs.sort_unstable();
        for (.., o, n) in pairs {
            if !used[o] && chosen[n].is_none() {
                used[o] = true;
                chosen[n] = Some(o);
            }
        }
    }
    chosen
}

/// True if an episode of a test that is still being written continues a stored episode of the same cause. The detectors
/// have judged all earlier tests. An episode that has not ended therefore continues, however many tests without it
/// there were.
pub(in crate::robot) fn goes_on(old: &Episode, new: &Episode) -> bool {
    !old.withdrawn && !old.ended && old.joint == new.joint && is_of_one_cause(old, new) && old.from <= new.to
}

/// Kinds of alarms of the arm that replace the alarms of several joints: an oscillation of any quantity, and a change
/// of the arm's warm-up. If the ambient temperature changes the friction of all joints, no joint has an alarm.
const OF_ALL_JOINTS: [(AnomalyKind, Option<Quantity>); 2] =
    [(AnomalyKind::Oscillation, None), (AnomalyKind::Thermal, Some(Quantity::CommonWarmUpTimeRatio))];

/// True if an episode of the whole arm now replaces a stored episode of a joint: one of the same kind, at the same
/// time.
pub(super) fn is_told_of_arm(old: &Episode, found: &[Episode], starts: &Starts) -> bool {
    let is_joined = |new: &Episode| {
        OF_ALL_JOINTS
            .iter()
            .any(|(kind, quantity)| new.kind == *kind && quantity.is_none_or(|of| new.quantity == of))
    };
    let is_instead = |new: &Episode| {
        new.joint.is_none() && is_joined(new) && new.kind == old.kind && overlap(old, new, starts).is_some()
    };
    old.joint.is_some() && found.iter().any(is_instead)
}

/// True if a kind differs so much from the earlier one that a person's answer to the earlier fault is not valid for it.
pub(in crate::robot) fn is_another_fault(old: AnomalyKind, new: AnomalyKind) -> bool {
    old != new && !(FRICTION_KINDS.contains(&old) && FRICTION_KINDS.contains(&new))
}

fn is_of_one_cause(old: &Episode, new: &Episode) -> bool {
    old.kind == new.kind && old.quantity.is_of_one_cause(new.quantity)
}

/// A comparison with other arms does not correct the arm's own history, and a wrong date does not correct a fault.
fn may_be_corrected(old: &Episode, new: &Episode) -> bool {
    let is_of_dates = |of: &Episode| of.quantity == Quantity::ImplausibleDate;
    ![old.kind, new.kind].contains(&AnomalyKind::Fleet) && !is_of_dates(old) && !is_of_dates(new)
}

/// Common duration of both, in microseconds; 0 if one continues the other, `None` if they are separate.
fn overlap(old: &Episode, new: &Episode, starts: &Starts) -> Option<i64> {
    let both = old.to.min(new.to) - old.from.max(new.from);
    if both >= 0 {
        return Some(both);
    }
    let runs = match new.quantity.history() {
        RunKind::Production => &starts.production,
        RunKind::Test => &starts.tests,
    };
    let between = runs.iter().filter(|start| (old.to + 1..new.from).contains(start)).count();
    (!old.ended && old.to < new.from && between < RUNS_APART).then_some(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(kind: AnomalyKind, quantity: Quantity, from: i64, to: i64) -> Episode {
        Episode { joint: Some(3), kind, quantity, from, to, ended: false, withdrawn: false }
    }

    fn drift(from: i64, to: i64) -> Episode {
        episode(AnomalyKind::Drift, Quantity::FrictionIndex, from, to)
    }

    fn ended(of: Episode) -> Episode {
        Episode { ended: true, ..of }
    }

    fn starts() -> Starts {
        Starts { tests: (0..20).collect(), production: vec![5, 6, 7, 8] }
    }

    fn pairs(stored: &[Episode], found: &[Episode]) -> Vec<Option<usize>> {
        same(stored, found, &starts())
    }

    #[test]
    fn an_episode_whose_first_run_moves_or_whose_quantity_gets_better_is_the_same() {
        assert_eq!(pairs(&[drift(5, 9)], &[drift(7, 10)]), [Some(0)]);
        assert_eq!(pairs(&[drift(5, 9)], &[drift(2, 5)]), [Some(0)], "they touch");
        let warm = episode(AnomalyKind::Drift, Quantity::WarmFriction, 4, 6);
        assert_eq!(pairs(&[warm], &[drift(5, 9)]), [Some(0)]);
        let production = episode(AnomalyKind::Drift, Quantity::ProductionFriction, 4, 6);
        assert_eq!(
            pairs(&[drift(4, 6), production.clone()], &[production, drift(4, 6)]),
            [Some(1), Some(0)],
            "they stand beside each other"
        );
        let of_arm = Episode { joint: None, ..drift(5, 9) };
        assert_eq!(pairs(&[drift(5, 9)], &[of_arm]), [None]);
    }

    #[test]
    fn an_alarm_of_a_joint_is_told_of_the_arm_where_joints_are_joined_at_the_time() {
        let is_told = |old: &Episode, new: Episode| is_told_of_arm(old, &[new], &starts());
        let of_arm = |of: Episode| Episode { joint: None, ..of };
        let swing = |from, to| episode(AnomalyKind::Oscillation, Quantity::FrictionSwing, from, to);
        let warm_up = episode(AnomalyKind::Thermal, Quantity::WarmUpTimeRatio, 5, 9);
        assert!(is_told(&swing(5, 9), of_arm(swing(6, 10))));
        assert!(is_told(
            &warm_up,
            of_arm(episode(AnomalyKind::Thermal, Quantity::CommonWarmUpTimeRatio, 6, 10))
        ));
        assert!(
            !is_told(&warm_up, of_arm(episode(AnomalyKind::Thermal, Quantity::CommonFrictionRatio, 6, 10))),
            "the hall"
        );
        assert!(!is_told(&ended(swing(1, 3)), of_arm(swing(6, 10))), "it was before");
        assert!(!is_told(&warm_up, of_arm(swing(6, 10))), "another kind");
        assert!(!is_told(&swing(5, 9), swing(6, 10)), "of a joint");
        assert!(!is_told(&drift(5, 9), of_arm(drift(6, 10))), "drifts are not joined");
    }

    #[test]
    fn an_open_one_goes_on_over_a_quiet_run_and_an_ended_one_does_not() {
        assert_eq!(pairs(&[drift(5, 9)], &[drift(11, 12)]), [Some(0)]);
        assert_eq!(pairs(&[drift(5, 9)], &[drift(12, 13)]), [None], "two runs lie between");
        assert_eq!(pairs(&[ended(drift(5, 9))], &[drift(11, 12)]), [None]);
        assert_eq!(pairs(&[drift(11, 12)], &[drift(5, 9)]), [None], "nothing goes on backwards");
    }

    #[test]
    fn the_best_overlap_comes_first_and_each_is_used_once() {
        let stored = [ended(drift(1, 3)), ended(drift(6, 12))];
        assert_eq!(pairs(&stored, &[ended(drift(2, 11))]), [Some(1)]);
        let open = [ended(drift(1, 9)), drift(11, 12)];
        assert_eq!(pairs(&open, &[drift(1, 12)]), [Some(1)], "what is open stays what it is");
        assert_eq!(pairs(&[drift(1, 12)], &[ended(drift(1, 5)), drift(8, 12)]), [None, Some(0)]);
    }

    #[test]
    fn a_kind_is_corrected_where_the_old_one_vanishes_at_once() {
        let step = episode(AnomalyKind::Step, Quantity::FrictionIndex, 6, 9);
        assert_eq!(pairs(&[drift(5, 9)], std::slice::from_ref(&step)), [Some(0)]);
        assert_eq!(pairs(&[drift(5, 9)], &[step.clone(), drift(5, 9)]), [None, Some(0)], "both are found");
        assert_eq!(
            pairs(&[episode(AnomalyKind::Fleet, Quantity::FrictionIndex, 5, 9)], &[drift(5, 9)]),
            [None]
        );
        let withdrawn = Episode { withdrawn: true, ..drift(5, 9) };
        assert_eq!(
            pairs(std::slice::from_ref(&withdrawn), std::slice::from_ref(&step)),
            [None],
            "it had vanished before"
        );
        assert_eq!(
            pairs(std::slice::from_ref(&withdrawn), &[drift(6, 10)]),
            [Some(0)],
            "and comes back as what it was"
        );
        assert_eq!(pairs(&[withdrawn, step], &[drift(6, 10)]), [Some(1)], "what is shown goes first");
        assert!(
            !is_another_fault(AnomalyKind::Drift, AnomalyKind::Step)
                && is_another_fault(AnomalyKind::Oscillation, AnomalyKind::Drift)
        );
    }
}
