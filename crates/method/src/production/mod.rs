//! Windows of ordinary work against the parameters of a test, without identification.

pub mod reference;
mod evidence;
pub mod window;
