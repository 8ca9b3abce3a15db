//! Several arms in one export, distinguished by a word in the names of their columns.

use super::names::{self, ColumnKind};
use super::sets::Set;

/// Words for sides; those of an export come from one row.
const SIDES: [&[&str]; 6] = [
    &["left", "right"],
    &["l", "r"],
    &["links", "rechts"],
    &["li", "re"],
    &["sinistro", "destro"],
    &["sx", "dx"],
];

/// Words before the number of an arm.
const ARMS: [&str; 5] = ["arm", "robot", "rob", "manipulator", "roboter"];

/// The tokens of an arm: a side, or a word and a number.
pub(super) type Arm = Vec<String>;

/// The arms of an export, if several have measured positions and torques; empty for an export of one arm.
pub(super) fn arms(sets: &[Set]) -> Vec<Arm> {
    let of = |kinds: &[ColumnKind]| -> Vec<Arm> {
        let mut found: Vec<Arm> = sets
            .iter()
            .filter(|set| {
                set.said.intent.is_none() && set.said.kind.is_some_and(|kind| kinds.contains(&kind))
            })
            .filter_map(|set| arm_of(&set.template))
            .collect();
        found.sort();
        found.dedup();
        found
    };
    let positions = of(&[ColumnKind::Position]);
    let torques = of(&[ColumnKind::Torque, ColumnKind::Current]);
    let both: Vec<Arm> = positions.into_iter().filter(|arm| torques.contains(arm)).collect();
    let is_of =
        |words: &[&str]| both.iter().all(|arm| matches!(&arm[..], [side] if words.contains(&side.as_str())));
    let is_numbered = both.iter().all(|arm| arm.len() == 2);
    if both.len() > 1 && (is_numbered || SIDES.iter().any(|words| is_of(words))) { both } else { Vec::new() }
}

/// Returns true if a set of columns belongs to this arm, or to none.
pub(super) fn is_of(set: &Set, arm: &Arm) -> bool {
    arm_of(&set.template).is_none_or(|own| own == *arm)
}

fn arm_of(template: &str) -> Option<Arm> {
    let tokens = names::tokens(&template.replace("{joint}", "_"));
    let is_numbered = |pair: &&[String]| {
        ARMS.contains(&pair[0].as_str()) && pair[1].bytes().all(|byte| byte.is_ascii_digit())
    };
    let numbered = tokens.windows(2).find(is_numbered).map(<[String]>::to_vec);
    let is_side = |token: &&String| SIDES.iter().any(|words| words.contains(&token.as_str()));
    numbered.or_else(|| tokens.iter().find(is_side).map(|side| vec![side.clone()]))
}
