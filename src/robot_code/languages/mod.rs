//! Code in each language.

mod body;
mod c;
mod python;
mod rust;

use super::language::{Language, SourceFile};
use super::torque::TorquePrograms;

/// Source and self-check.
pub(super) fn files(
    language: Language,
    name: &str,
    header: &[String],
    programs: &TorquePrograms,
) -> Vec<SourceFile> {
    match language {
        Language::C => c::files(name, header, programs),
        Language::Rust => rust::files(name, header, programs),
        Language::Python => python::files(name, header, programs),
    }
}
