//! Code in each language.

mod body;
mod c;
mod python;
mod rust;

use super::language::{CodeLanguage, SourceFile};
use super::torque::TorquePrograms;

/// Source and self-check.
pub(super) fn files(
    language: CodeLanguage,
    name: &str,
    header: &[String],
    programs: &TorquePrograms,
) -> Vec<SourceFile> {
    match language {
        CodeLanguage::C => c::files(name, header, programs),
        CodeLanguage::Rust => rust::files(name, header, programs),
        CodeLanguage::Python => python::files(name, header, programs),
    }
}
