//! Which files there are, and when one may be read: watching, settling, growing, archiving.

pub mod watch;
pub mod join;
pub mod settle;
pub mod tail;
pub mod archive;
pub mod durable;
