//! TOML tables read key by key, with every problem at once.

pub(super) mod table;
pub(super) mod range;
pub(super) mod problem;
pub(super) mod suggestion;
pub(super) mod quantity;
pub(super) mod files;
