//! What the history of a robot says.

mod dates;
pub mod history;
pub mod in_brief;
pub mod isolation;
pub mod open_test;
pub mod windows;
pub mod work;

#[cfg(test)]
mod judged_in_brief_tests;
#[cfg(test)]
mod test_database;
#[cfg(test)]
mod settled_windows_tests;
