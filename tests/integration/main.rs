//! Tests of the program from the user's side: the real binary, real files, a real database.
//!
//! `support` has common helpers; every other module is named after its subject. Unit tests of functions are in the
//! sources.

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stderr,
    clippy::print_stdout,
    reason = "functions that tests call; clippy.toml allows these in tests themselves"
)]

mod http;
mod support;

mod archive;
mod alerts;
mod architecture;
mod bad_input;
mod canon;
mod channel_settings;
mod cli;
mod clock;
mod control;
mod controller_positions;
mod crash;
mod daemon;
mod dates;
mod delivery;
mod demo;
#[cfg(target_os = "linux")]
mod doctor;
mod docs;
mod grafana;
#[cfg(target_os = "linux")]
mod faults;
#[cfg(target_os = "linux")]
mod hanging;
mod quarantine;
mod friction_only;
mod hostile_text;
mod fuzz_seeds;
mod layouts;
mod maker_files;
mod binary_files;
mod maintenance;
mod motion_limits;
#[cfg(target_os = "linux")]
mod memory;
mod estimators;
mod no_result;
mod overdue;
mod own_tls;
mod parts;
mod poison;
#[cfg(target_os = "linux")]
mod postgres;
mod excitation_only;
mod explain;
mod export;
mod fairness;
mod isolation;
mod json_rows;
mod exports;
mod identity;
#[cfg(target_os = "linux")]
mod in_place;
mod production;
mod production_alarms;
mod stage_signals;
mod real_recording;
mod reference_export;
mod resume;
mod robot_code;
mod robot_urdf;
mod shipped;
mod simulate;
mod small;
mod stored_factors;
mod tools;
mod torque_sources;
mod temperatures;
mod torque;
mod trajectories;
mod streaming;
mod odd_rows;
mod open_tests;
#[cfg(unix)]
mod writers;
mod slow_clients;
mod upload;
mod reading;
mod retention;
mod report;
mod api;
mod api_description;
mod wording;
mod sound_recordings;
mod wrong_recordings;
