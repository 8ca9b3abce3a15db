//! What several unit tests share.

use crate::config::parse_robot;
use crate::robot::Robot;

/// The ER3A as its shipped description has it.
pub fn er3a() -> Robot {
    let text = include_str!("../config/robots/er3a.toml");
    parse_robot("config/robots/er3a.toml", text).unwrap_or_else(|errors| panic!("{errors}"))
}
