//! Windows of production compared with the parameters of a test, without identification.

pub mod reference;
mod evidence;
pub mod window;
