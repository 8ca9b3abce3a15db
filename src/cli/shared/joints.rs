//! Joints of a robot in words, with reasons that several of them share.

use armwatch_model::robot::JointIndex;

/// Starts of the part of a reason about earlier tests; `armwatch_method::detect` writes it last.
const EARLIER: [&str; 3] = ["; known last: ", "; the latest result is of ", "; no test gave a result yet"];

/// A reason for the status of joints.
#[derive(Debug, PartialEq, Eq)]
pub(in crate::cli) struct Reason<'a> {
    /// Its joints, in order.
    pub(in crate::cli) joints: Vec<JointIndex>,
    /// The reason; without the part about earlier tests, if that differs between joints.
    pub(in crate::cli) why: &'a str,
}

/// `joint 3`, `joints 1 to 3 and 6`, or `all joints` if the robot has `count`; `joints` are in order.
pub(in crate::cli) fn named(joints: &[JointIndex], count: usize) -> String {
    match joints {
        [joint] => format!("joint {joint}"),
        all if all.len() == count => "all joints".to_owned(),
        some => {
            let spans: Vec<String> =
                some.chunk_by(|one, next| one.number() + 1 == next.number()).flat_map(span).collect();
            match &spans[..] {
                [before @ .., last] if !before.is_empty() => {
                    format!("joints {} and {last}", before.join(", "))
                }
                _ => format!("joints {}", spans.concat()),
            }
        }
    }
}

/// Consecutive joints: two by their numbers, more as a range.
fn span(joints: &[JointIndex]) -> Vec<String> {
    match joints {
        [first, _, .., last] => vec![format!("{first} to {last}")],
        few => few.iter().map(|joint| joint.to_string()).collect(),
    }
}

/// Splits a reason into its main part and the part about earlier tests.
pub(in crate::cli) fn apart(reason: &str) -> (&str, Option<&str>) {
    match EARLIER.iter().filter_map(|begin| reason.rfind(*begin)).max() {
        Some(place) => {
            let (why, earlier) = reason.split_at(place);
            (why, earlier.strip_prefix("; "))
        }
        None => (reason, None),
    }
}

/// Each reason once, with its joints, in the order of the first of them.
pub(in crate::cli) fn reasons<'a>(said: impl IntoIterator<Item = (JointIndex, &'a str)>) -> Vec<Reason<'a>> {
    let mut found: Vec<Reason<'a>> = Vec::new();
    for (joint, reason) in said {
        let (shared, _) = apart(reason);
        match found.iter_mut().find(|of| apart(of.why).0 == shared) {
            Some(of) => {
                of.joints.push(joint);
                if of.why != reason {
                    of.why = shared;
                }
            }
            None => found.push(Reason { joints: vec![joint], why: reason }),
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(numbers: &[usize]) -> Vec<JointIndex> {
        numbers.iter().filter_map(|number| JointIndex::from_number(*number)).collect()
    }

    #[test]
    fn joints_are_named_as_people_say_them() {
        let cases: [(&[usize], &str); 6] = [
            (&[3], "joint 3"),
            (&[1, 2, 3, 4, 5, 6], "all joints"),
            (&[1, 2, 3, 4, 5], "joints 1 to 5"),
            (&[1, 2], "joints 1 and 2"),
            (&[1, 2, 3, 6], "joints 1 to 3 and 6"),
            (&[1, 3, 4, 6], "joints 1, 3, 4 and 6"),
        ];
        for (numbers, words) in cases {
            assert_eq!(named(&joints(numbers), 6), words);
        }
        assert_eq!(named(&joints(&[1]), 1), "joint 1");
    }

    #[test]
    fn one_reason_is_said_once_whatever_was_known_of_each_joint_before() {
        let of = |number: usize| JointIndex::new(number - 1);
        let refused = "the latest test gave no result: all 8 cycles were refused: the torque is wrong";
        let known = [0.985, 0.98]
            .map(|index| format!("{refused}; known last: friction index {index:.3} of 2026-01-10 08:47 UTC"));
        let odd = "one test 17 % above the joint's baseline";
        let said = [(of(1), known[0].as_str()), (of(2), odd), (of(3), known[1].as_str())];
        assert_eq!(
            reasons(said),
            [Reason { joints: joints(&[1, 3]), why: refused }, Reason { joints: joints(&[2]), why: odd }]
        );
        // a single reason, or a common part about earlier tests, is unchanged
        assert_eq!(reasons(said[..1].iter().copied())[0].why, known[0]);
        let never = format!("{refused}; no test gave a result yet");
        let all = reasons([1, 2, 3].map(|number| (of(number), never.as_str())));
        assert_eq!(all, [Reason { joints: joints(&[1, 2, 3]), why: &never }]);
        assert_eq!(apart(&never), (refused, Some("no test gave a result yet")));
        assert_eq!(apart(odd), (odd, None));
    }
}
