//! A layout for an unknown export, proposed from its first rows, with the reasons.
//!
//! `head` finds how the text is written, `names` what the names of columns say, `units` and `stages` what their
//! numbers say; `joints` finds the columns of the joints, `motion_units` their units, `torque_size` whether torques
//! are as large as the arm's, `motion_sections` writes of them; `decide` puts it together, and `write` makes a layout file of it. Nothing is guessed in silence:
//! each choice has its reason as a comment, and what cannot be decided is a commented line with a question.

mod decide;
mod head;
pub mod proposal;
mod section;
mod joints;
mod motion_sections;
mod motion_units;
mod names;
mod stages;
mod temperatures;
mod time_form;
mod torque_size;
mod units;
mod write;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod time_tests;

use std::io::Read;
use std::path::Path;

use super::rejection::Rejection;
use crate::infer::proposal::{Hints, Proposed};

/// Proposes a layout called `name` from the first rows of an export.
///
/// # Errors
/// A rejection of a file that cannot be read or holds no table of numbers.
pub fn infer(reader: impl Read, path: &Path, name: &str, hints: Hints<'_>) -> Result<Proposed, Rejection> {
    let head = head::read(reader, path)?;
    let proposal = decide::propose(&head, hints);
    Ok(write::layout(name, path, &head, &proposal))
}
