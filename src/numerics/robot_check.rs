//! stub
use crate::robot::Robot; use super::base::{BaseParameters, base_parameters}; use super::NumericsError;
pub struct RobotCheck { pub base: BaseParameters }
impl std::fmt::Display for RobotCheck { fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result { write!(f, "{}", self.base.kept.len()) } }
impl RobotCheck { pub fn is_consistent(&self) -> bool { true } }
pub struct ReferenceRow { pub q: Vec<f64>, pub qd: Vec<f64>, pub qdd: Vec<f64>, pub tau: Vec<f64>, pub pose: Option<Vec<f64>> }
pub struct ReferenceAgreement { pub rows: usize, pub torque: f64, pub pose: f64 }
impl ReferenceAgreement { pub fn within(&self, _t: f64) -> bool { true } }
impl std::fmt::Display for ReferenceAgreement { fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result { write!(f, "") } }
pub fn check(robot: &Robot) -> Result<RobotCheck, NumericsError> { Ok(RobotCheck { base: base_parameters(robot)? }) }
pub fn compare_with_reference(_r: &Robot, _rows: &[ReferenceRow]) -> Result<ReferenceAgreement, NumericsError> { Ok(ReferenceAgreement { rows: 0, torque: 0.0, pose: 0.0 }) }
