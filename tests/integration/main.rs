//! Tests of the program as its users meet it: the real binary, real files, a real database.
//!
//! `support` starts things; every other module is named after what it looks at. Tests of one
//! function stand beside the function.

mod support;

mod architecture;
mod bad_input;
mod cli;
mod daemon;
mod docs;
mod explain;
mod production;
mod stage_signals;
mod real_recording;
mod reference_export;
mod robot_urdf;
mod shipped;
mod stored_factors;
mod torque_sources;
mod torque;
mod streaming;
mod wrong_recordings;
