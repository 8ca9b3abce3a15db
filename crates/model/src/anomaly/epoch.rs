//! Epochs of a joint: tests between two changes are comparable, and each epoch has its own baseline.

use jiff::Timestamp;

use super::RunSummary;
use crate::robot::JointIndex;

/// Maintenance of a robot or one of its joints, which begins new baselines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Maintenance {
    /// Database key.
    pub maintenance_id: i64,
    /// The joint; `None` for the whole arm.
    pub joint: Option<JointIndex>,
    /// Time of the maintenance. A test that starts at this time counts as after it.
    pub at: Timestamp,
    /// Work that was done.
    pub what: String,
    /// Person who entered it.
    pub who: Option<String>,
}

/// Data of one test that determine its epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TestMoment<D> {
    /// Start of the recording.
    pub started_at: Timestamp,
    /// The description that its results were computed with.
    pub description: D,
}

/// Reason why an epoch began.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EpochCause {
    /// The joint's first test.
    FirstTest,
    /// Maintenance of the joint or the whole arm: its key.
    Maintenance(i64),
    /// Another description than that of the test before.
    Description,
}

impl EpochCause {
    /// Name as in the view `baselines`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FirstTest => "first_test",
            Self::Maintenance(_) => "maintenance",
            Self::Description => "description",
        }
    }
}

/// Tests of one joint that are comparable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Epoch {
    /// Reason why it began.
    pub cause: EpochCause,
    /// Time of the maintenance that began it, otherwise the start of its first test.
    pub begins_at: Timestamp,
    /// Positions of its tests, ascending.
    pub tests: Vec<usize>,
}

/// Epochs of a joint, ordered by their first test. `tests` are those of the robot, oldest first.
///
/// Two tests are in one epoch if there was no maintenance of the joint or the whole arm between them and their results
/// were computed with the same description. A description that returns, as after a withdrawn correction, continues its
/// earlier epoch.
#[must_use]
pub fn epochs<D: PartialEq>(joint: JointIndex, tests: &[TestMoment<D>], work: &[Maintenance]) -> Vec<Epoch> {
    let mut work: Vec<&Maintenance> = work.iter().filter(|of| of.joint.is_none_or(|j| j == joint)).collect();
    work.sort_by_key(|of| (of.at, of.maintenance_id));
    let done_before = |test: &TestMoment<D>| work.partition_point(|of| of.at <= test.started_at);
    let mut found: Vec<Epoch> = Vec::new();
    for (at, test) in tests.iter().enumerate() {
        let done = done_before(test);
        let same = |epoch: &&mut Epoch| {
            epoch.tests.first().is_some_and(|first| {
                tests[*first].description == test.description && done_before(&tests[*first]) == done
            })
        };
        if let Some(epoch) = found.iter_mut().find(same) {
            epoch.tests.push(at);
            continue;
        }
        let latest = work[..done].last();
        let done_since = match at.checked_sub(1) {
            None => latest,
            Some(before) => latest.filter(|_| done_before(&tests[before]) < done),
        };
        let (cause, begins_at) = match (done_since, at) {
            (Some(of), _) => (EpochCause::Maintenance(of.maintenance_id), of.at),
            (None, 0) => (EpochCause::FirstTest, test.started_at),
            (None, _) => (EpochCause::Description, test.started_at),
        };
        found.push(Epoch { cause, begins_at, tests: vec![at] });
    }
    found
}

impl RunSummary {
    /// Ordinal of the epoch of a joint that the test belongs to, 0 for the first.
    #[must_use]
    pub fn epoch(&self, joint: JointIndex) -> u32 {
        self.epochs.get(joint.index()).copied().unwrap_or(0)
    }
}

/// Reason why the friction index of a joint's latest test is not compared with a baseline, in words that end a
/// sentence; `None` if it is compared, or if the joint never had an index. `history` is oldest first.
#[must_use]
pub fn not_compared(history: &[RunSummary], joint: JointIndex) -> Option<String> {
    let has_index =
        |run: &RunSummary| run.joints.iter().any(|of| of.joint == joint && of.friction_index.is_some());
    let latest = history.last()?;
    let last = history.iter().rfind(|run| has_index(run))?;
    if last.run_id == latest.run_id {
        return None;
    }
    let day = last.started_at.strftime("%Y-%m-%d %H:%M");
    Some(if last.epoch(joint) == latest.epoch(joint) {
        format!("no comparable run since {day} UTC")
    } else {
        format!(
            "the baseline after maintenance or a changed description is not complete; the last run that compared with \
             the baseline before is of {day} UTC"
        )
    })
}

#[cfg(test)]
mod tests {
    use jiff::SignedDuration;

    use super::*;
    use crate::analysis::{Estimate, JointSummary};

    const JOINT: JointIndex = JointIndex::new(2);
    const OTHER: JointIndex = JointIndex::new(0);

    fn day(days: i64) -> Timestamp {
        Timestamp::UNIX_EPOCH + SignedDuration::from_hours(24 * days)
    }

    fn tests(descriptions: &[char]) -> Vec<TestMoment<char>> {
        let moment =
            |(at, description): (i64, &char)| TestMoment { started_at: day(at), description: *description };
        (0..).zip(descriptions).map(moment).collect()
    }

    fn work(maintenance_id: i64, joint: Option<JointIndex>, at: Timestamp) -> Maintenance {
        Maintenance { maintenance_id, joint, at, what: "new grease".into(), who: None }
    }

    fn of(
        joint: JointIndex,
        tests: &[TestMoment<char>],
        work: &[Maintenance],
    ) -> Vec<(EpochCause, Vec<usize>)> {
        epochs(joint, tests, work).into_iter().map(|epoch| (epoch.cause, epoch.tests)).collect()
    }

    #[test]
    fn work_on_a_joint_is_no_matter_of_the_others() {
        let tests = tests(&['a'; 5]);
        let on_joint = [work(7, Some(JOINT), day(2))];
        let first = (EpochCause::FirstTest, vec![0, 1]);
        assert_eq!(
            of(JOINT, &tests, &on_joint),
            [first.clone(), (EpochCause::Maintenance(7), vec![2, 3, 4])]
        );
        assert_eq!(of(OTHER, &tests, &on_joint), [(EpochCause::FirstTest, vec![0, 1, 2, 3, 4])]);
        let on_arm = [work(8, None, day(2))];
        for joint in [JOINT, OTHER] {
            assert_eq!(of(joint, &tests, &on_arm)[1], (EpochCause::Maintenance(8), vec![2, 3, 4]));
        }
    }

    #[test]
    fn work_without_tests_between_is_one_change_and_the_order_of_entry_does_not_matter() {
        let tests = tests(&['a'; 4]);
        let hours = |hours| day(1) + SignedDuration::from_hours(hours);
        let entered = [work(9, None, hours(5)), work(10, Some(JOINT), hours(1)), work(11, None, day(90))];
        let found = epochs(JOINT, &tests, &entered);
        assert_eq!(found.len(), 2);
        assert_eq!((found[1].cause, found[1].begins_at), (EpochCause::Maintenance(9), hours(5)));
        let reversed: Vec<Maintenance> = entered.iter().rev().cloned().collect();
        assert_eq!(epochs(JOINT, &tests, &reversed), found);
    }

    #[test]
    fn a_changed_description_begins_an_epoch_and_one_that_comes_back_continues_its_own() {
        let found = of(JOINT, &tests(&['a', 'a', 'b', 'a', 'b']), &[]);
        assert_eq!(found, [(EpochCause::FirstTest, vec![0, 1, 3]), (EpochCause::Description, vec![2, 4])]);
        let both = of(JOINT, &tests(&['a', 'a', 'b', 'b']), &[work(1, None, day(2))]);
        assert_eq!(both[1], (EpochCause::Maintenance(1), vec![2, 3]));
        assert!(of(JOINT, &[], &[]).is_empty());
    }

    /// A daily test with or without an index of the joint, in an epoch of the joint.
    fn test(at: i64, index: Option<f64>, epoch: u32) -> RunSummary {
        let summary = JointSummary {
            joint: JOINT,
            warm_friction: None,
            excitation_friction: None,
            half_speed_friction: None,
            friction_index: index.map(|value| Estimate { value, std_error: 0.01 }),
            relative_rmsd: None,
            rmsd_swing: None,
            relative_noise: None,
            torque_rms: None,
        };
        RunSummary {
            run_id: at,
            started_at: day(at),
            cycles: 8,
            refused_cycles: 0,
            refusals: Vec::new(),
            joints: vec![summary],
            epochs: vec![0, 0, epoch],
            ..RunSummary::default()
        }
    }

    #[test]
    fn a_joint_without_a_comparable_test_is_told_since_when() {
        let compared = [test(0, Some(1.0), 0), test(1, Some(1.0), 0)];
        assert_eq!(not_compared(&compared, JOINT), None);
        assert_eq!(not_compared(&compared, OTHER), None, "it never had an index");
        assert_eq!(not_compared(&[], JOINT), None);
        let [first, _] = compared;
        let stopped = [first.clone(), test(1, None, 0), test(2, None, 0)];
        assert_eq!(
            not_compared(&stopped, JOINT).as_deref(),
            Some("no comparable run since 1970-01-01 00:00 UTC")
        );
        let repaired = [first, test(1, None, 1)];
        let words = not_compared(&repaired, JOINT).expect("words");
        assert!(words.contains("not complete") && words.contains("1970-01-01"), "{words}");
        assert_eq!((repaired[1].epoch(JOINT), repaired[1].epoch(JointIndex::new(9))), (1, 0));
    }
}
