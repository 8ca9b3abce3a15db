//! A layout for an unknown export, proposed from its first rows, with the reasons.
//!
//! `makers` and `topic_echo` compare the file with the shipped layouts. `head` finds the form of the text, `names` and
//! `words` analyse the names of columns, `units` and `stages` their numbers. `sets` combines columns of one quantity,
//! `joints` selects those of the joints by their names and `blocks` by their motion. `motion_units` finds units,
//! `torque_size` compares torques with the arm's, and `motion_sections` and `stage_sections` write their sections.
//! `decide` combines the results, and `write` makes a layout file of them. Every guess is visible: each choice has its
//! reason as a comment, and a choice that is undecided, or has a second candidate, is a commented line with a question.

mod blocks;
mod decide;
mod head;
pub mod proposal;
mod section;
mod arms;
mod sets;
mod stage_sections;
mod joints;
mod motion_sections;
mod motion_units;
mod names;
mod makers;
mod stages;
mod temperatures;
mod time_form;
mod topic_echo;
mod torque_size;
mod units;
mod name_words;
mod write;

#[cfg(test)]
mod choice_tests;
#[cfg(test)]
mod maker_tests;
#[cfg(test)]
mod form_tests;
#[cfg(test)]
mod tests;

#[cfg(test)]
mod time_tests;

use std::io::Read;
use std::path::Path;

use self::proposal::{Hints, Proposed};
pub use self::write::comments;
use crate::rejection::Rejection;

/// Proposes a layout called `name` from the first rows of an export.
///
/// # Errors
/// A rejection of a file that is unreadable or contains no table of numbers.
pub fn infer(reader: impl Read, path: &Path, name: &str, hints: Hints<'_>) -> Result<Proposed, Rejection> {
    let head = head::read(reader, path)?;
    Ok(write::layout(name, path, &head, &decide::propose(&head, hints, None)))
}

/// Like [`infer`], with a layout for each arm and the words that identify it, such as `left`; the words are part of the
/// layout's name. For an export of one arm, one layout without words.
///
/// # Errors
/// Those of [`infer`].
pub fn infer_each_arm(
    reader: impl Read,
    path: &Path,
    name: &str,
    hints: Hints<'_>,
) -> Result<Vec<(Option<String>, Proposed)>, Rejection> {
    let head = head::read(reader, path)?;
    let arms = if head.header { arms::arms(&sets::sets(&head, hints.robot)) } else { Vec::new() };
    let proposed = |arm: Option<&arms::Arm>| {
        let words = arm.map(|arm| arm.join("_"));
        let name = words.as_ref().map_or_else(|| name.to_owned(), |words| format!("{name}_{words}"));
        (words, write::layout(&name, path, &head, &decide::propose(&head, hints, arm)))
    };
    Ok(match arms.is_empty() {
        true => vec![proposed(None)],
        false => arms.iter().map(|arm| proposed(Some(arm))).collect(),
    })
}
