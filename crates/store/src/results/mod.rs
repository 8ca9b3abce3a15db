//! Results of cycles and runs.

pub(super) mod record;
pub(super) mod factors;
pub(super) mod joined_factors;
pub(super) mod channel_response;
pub(super) mod temperatures;
pub(super) mod torque_noise;
pub(super) mod verification;
pub(crate) mod production_evidence;
pub(super) mod production;
pub(crate) mod log_summaries;
pub(super) mod run_analysis;
