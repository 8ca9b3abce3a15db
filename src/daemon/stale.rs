//! Robots whose history has changed since conclusions were drawn, and their order. It reads no clock: the time is an
//! argument.

use std::collections::{HashMap, HashSet};
use std::time::{Duration, Instant};

use crate::pipeline::conclude::history::RUNS_AT_ONCE;
use armwatch_store::{ConclusionFault, StaleRobot};

/// Longest delay of a robot's conclusions while settled files of it wait: a backlog of a thousand runs needs neither a
/// thousand conclusions nor a single one at the end.
const CONCLUDE_WITHIN: Duration = Duration::from_secs(10);

/// Pause after conclusions that failed; it doubles each time, up to [`LONGEST_REST`]. A completed run ends it, since
/// the history has changed then.
const FIRST_REST: Duration = Duration::from_secs(10);

/// Longest pause after conclusions that failed.
const LONGEST_REST: Duration = Duration::from_secs(3600);

/// If another program has changed a robot's history, such as `armwatch ingest`, that program draws the conclusions
/// while the history keeps changing, and for this time afterwards.
const LEFT_BY_OTHERS: Duration = Duration::from_secs(30);

#[derive(Debug, Clone, Copy)]
struct Waiting {
    since: Instant,
    /// Runs that have completed since.
    runs: usize,
    rests_until: Option<Instant>,
}

/// The robots that wait for conclusions.
#[derive(Debug, Default)]
pub struct Stale {
    waiting: HashMap<String, Waiting>,
    /// Number of consecutive failures of conclusions.
    failures: HashMap<String, u32>,
    /// Robots whose history other programs have changed: change count, and time of the last change.
    by_others: HashMap<String, (i64, Instant)>,
}

impl Stale {
    /// Takes over robots from an earlier daemon: those that wait, and those whose conclusions failed. The latter pause
    /// first.
    pub fn take_over(&mut self, stale: &[StaleRobot], faults: &[ConclusionFault], now: Instant) {
        for robot in stale {
            let failures =
                faults.iter().find(|fault| fault.robot == robot.name).map_or(0, |fault| fault.tries);
            if failures == 0 {
                self.waiting.insert(robot.name.clone(), Waiting { since: now, runs: 0, rests_until: None });
            } else {
                self.failures.insert(robot.name.clone(), failures - 1);
                self.failed(robot.name.clone(), now);
            }
        }
    }

    /// Notes that a run of a robot is complete.
    pub fn completed(&mut self, robot: &str, now: Instant) {
        let new = Waiting { since: now, runs: 0, rests_until: None };
        let waiting = self.waiting.entry(robot.to_owned()).or_insert(new);
        waiting.runs += 1;
        waiting.rests_until = None;
    }

    /// Updates the robots that the database reports as stale. `concluding` is the one whose conclusions are being
    /// drawn.
    pub fn look(&mut self, stale: &[StaleRobot], concluding: Option<&str>, now: Instant) {
        let names: HashSet<&str> = stale.iter().map(|robot| robot.name.as_str()).collect();
        self.by_others.retain(|robot, _| names.contains(robot.as_str()));
        for robot in stale {
            if self.waiting.contains_key(&robot.name) || concluding == Some(robot.name.as_str()) {
                self.by_others.remove(&robot.name);
                continue;
            }
            let (history, since) = self.by_others.entry(robot.name.clone()).or_insert((robot.history, now));
            if *history != robot.history {
                (*history, *since) = (robot.history, now);
            } else if now.duration_since(*since) >= LEFT_BY_OTHERS {
                self.by_others.remove(&robot.name);
                self.waiting.insert(robot.name.clone(), Waiting { since: now, runs: 0, rests_until: None });
            }
        }
    }

    /// The robot whose turn it is; it stops waiting then. Candidates have finished their backlog, or waited long
    /// enough; the one that has waited longest is chosen.
    pub fn next(&mut self, now: Instant, is_through: impl Fn(&str) -> bool) -> Option<String> {
        let is_due = |robot: &str, waiting: &Waiting| {
            waiting.rests_until.is_none_or(|end| end <= now)
                && (is_through(robot)
                    || now.duration_since(waiting.since) > CONCLUDE_WITHIN
                    || waiting.runs >= RUNS_AT_ONCE)
        };
        let due = self.waiting.iter().filter(|(robot, waiting)| is_due(robot, waiting));
        let (robot, _) = due.min_by_key(|(robot, waiting)| (waiting.since, robot.as_str()))?;
        let robot = robot.clone();
        self.waiting.remove(&robot);
        Some(robot)
    }

    /// Notes that conclusions of a robot were drawn.
    pub fn concluded(&mut self, robot: &str) {
        self.failures.remove(robot);
    }

    /// Notes that conclusions could not be stored now, for a reason unrelated to the robot.
    pub fn again(&mut self, robot: String, now: Instant) {
        let rests_until = Some(now + FIRST_REST);
        self.waiting.entry(robot).or_insert(Waiting { since: now, runs: 0, rests_until });
    }

    /// Notes that conclusions for a robot failed: it pauses.
    pub fn failed(&mut self, robot: String, now: Instant) {
        let failures = self.failures.entry(robot.clone()).or_insert(0);
        let rest = FIRST_REST.saturating_mul(1 << (*failures).min(16)).min(LONGEST_REST);
        *failures += 1;
        // a run that completed in the meantime has changed the history
        let rests_until = Some(now + rest);
        self.waiting.entry(robot).or_insert(Waiting { since: now, runs: 0, rests_until });
    }

    /// Number of robots that wait for conclusions.
    pub fn count(&self) -> usize {
        self.waiting.len()
    }

    /// When a pause or the longest delay ends.
    pub fn next_look(&self, now: Instant) -> Option<Instant> {
        let moments = self.waiting.values().map(|waiting| match waiting.rests_until {
            Some(end) if end > now => end,
            _ => waiting.since + CONCLUDE_WITHIN,
        });
        moments.filter(|moment| *moment > now).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stale(robots: &[(&str, i64)]) -> Vec<StaleRobot> {
        robots
            .iter()
            .map(|(name, history)| StaleRobot { robot_id: 1, name: (*name).into(), history: *history })
            .collect()
    }

    #[test]
    fn who_has_waited_longest_comes_first_and_not_the_first_of_the_alphabet() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut robots = Stale::default();
        for (robot, second) in [("Z", 0), ("A", 1), ("M", 2), ("A", 3)] {
            robots.completed(robot, at(second));
        }
        assert_eq!(robots.next(at(4), |robot| robot != "Z").as_deref(), Some("A"));
        assert_eq!(robots.next(at(4), |_| false), None, "they have a backlog");
        robots.completed("A", at(5));
        assert_eq!(robots.next(at(11), |_| false).as_deref(), Some("Z"));
        assert_eq!(robots.next_look(at(11)), Some(at(12)));
        assert_eq!(robots.next(at(13), |_| false).as_deref(), Some("M"));
        (1..RUNS_AT_ONCE).for_each(|_| robots.completed("A", at(13)));
        assert_eq!(robots.next(at(13), |_| false).as_deref(), Some("A"));
        assert_eq!(robots.next(at(99), |_| true), None);
    }

    #[test]
    fn a_robot_that_fails_rests_longer_each_time_and_a_new_run_ends_the_rest() {
        let start = Instant::now();
        let mut robots = Stale::default();
        robots.completed("A", start);
        let mut tries = Vec::new();
        for second in 0..500 {
            let now = start + Duration::from_secs(second);
            if let Some(robot) = robots.next(now, |_| true) {
                tries.push(second);
                robots.failed(robot, now);
            }
        }
        assert_eq!(tries, [0, 10, 30, 70, 150, 310]);
        let now = start + Duration::from_secs(500);
        robots.completed("A", now);
        assert_eq!(robots.next(now, |_| true).as_deref(), Some("A"));
        robots.concluded("A");
        robots.failed("A".into(), now);
        assert_eq!(robots.next_look(now), Some(now + FIRST_REST));
    }

    #[test]
    fn what_failed_before_a_restart_rests_after_it() {
        let start = Instant::now();
        let mut robots = Stale::default();
        let fault = ConclusionFault { robot: "A".into(), reason: "NaN".into(), tries: 3 };
        robots.take_over(&stale(&[("A", 4), ("B", 1)]), &[fault], start);
        assert_eq!(robots.next(start, |_| true).as_deref(), Some("B"));
        assert_eq!(robots.next(start + Duration::from_secs(39), |_| true), None);
        assert_eq!(robots.next(start + Duration::from_secs(40), |_| true).as_deref(), Some("A"));
    }

    #[test]
    fn what_another_program_leaves_is_taken_up_when_it_stands_still() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut robots = Stale::default();
        robots.look(&stale(&[("A", 1)]), None, at(0));
        robots.look(&stale(&[("A", 2)]), None, at(20));
        robots.look(&stale(&[("A", 2), ("B", 1)]), Some("B"), at(49));
        assert_eq!(robots.next(at(49), |_| true), None, "it has changed 29 seconds ago");
        robots.look(&stale(&[("A", 2)]), None, at(50));
        assert_eq!(robots.next(at(50), |_| true).as_deref(), Some("A"));
        robots.look(&stale(&[("A", 2)]), Some("A"), at(90));
        assert_eq!(robots.next(at(99), |_| true), None);
    }
}
