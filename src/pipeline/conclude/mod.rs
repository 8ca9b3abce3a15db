//! Conclusions from the history of a robot.

mod dates;
pub mod history;
pub mod isolation;
mod load;
pub mod method;
pub mod open_conclusion;
pub mod windows;

#[cfg(test)]
mod kept_figures_tests;
#[cfg(test)]
pub(in crate::pipeline) mod test_database;
#[cfg(test)]
mod settled_windows_tests;
