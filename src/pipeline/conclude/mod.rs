//! What the history of a robot says.

pub mod history;
pub mod in_brief;
pub mod isolation;
pub mod open_test;
pub mod windows;
pub mod work;

#[cfg(test)]
mod briefs_tests;
#[cfg(test)]
mod test_database;
#[cfg(test)]
mod windows_tests;
