//! The code of one arm: its input, and its files.

use super::language::{CodeLanguage, SourceFile};
use super::origin::CodeOrigin;
use super::torque::{CodeParameter, TorquePrograms};
use super::vectors::TestVectors;
use super::{header, languages};
use armwatch_model::robot::Robot;

/// Code of an arm's torque.
#[derive(Debug)]
pub struct TorqueCode {
    /// Name of the files and, if the language has no modules, of the functions.
    pub name: String,
    /// States with the torques of the regressor.
    pub vectors: TestVectors,
    header: Vec<String>,
    programs: TorquePrograms,
}

impl TorqueCode {
    /// Code of `robot` with the given parameters. Missing parameters of the robot are zero; none may appear twice.
    /// `name` is converted to an identifier.
    pub fn new(robot: &Robot, parameters: &[CodeParameter], name: &str, origin: &CodeOrigin) -> Self {
        let programs = TorquePrograms::new(robot, parameters);
        let header = header::lines(robot, &programs, origin);
        let vectors = TestVectors::of(robot, parameters);
        Self { name: identifier(name), vectors, header, programs }
    }

    /// Source, self-check and test vectors.
    pub fn files(&self, language: CodeLanguage) -> Vec<SourceFile> {
        let mut files = languages::files(language, &self.name, &self.header, &self.programs);
        files.push(SourceFile { name: "vectors.csv".to_owned(), text: self.vectors.csv() });
        files
    }

    /// Sums, differences, products and quotients of a call.
    pub fn operations(&self) -> usize {
        header::cost(&self.programs).operations
    }

    /// Largest difference between the expressions of the code and the test vectors, as a fraction of the joint's scale
    /// ([`TestVectors::torque_scales`]).
    pub fn largest_difference(&self) -> f64 {
        self.vectors.largest_difference(|of| self.programs.torque_at(&of.q, &of.qd, &of.qdd))
    }
}

/// Lower-case letters, digits and underscores; begins with a letter.
fn identifier(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        match letter.is_ascii_alphanumeric() {
            true => text.push(letter.to_ascii_lowercase()),
            false if !text.ends_with('_') => text.push('_'),
            false => {}
        }
    }
    let text = text.trim_matches('_');
    if text.starts_with(|first: char| first.is_ascii_alphabetic()) {
        text.to_owned()
    } else {
        format!("arm_{text}").trim_end_matches('_').to_owned()
    }
}

#[cfg(test)]
mod tests;
