//! `armwatch alerts`

pub(super) mod command;
mod act;
mod list;
mod show;
mod test;
mod words;
