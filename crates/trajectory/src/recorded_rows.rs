//! The rows that the analysis makes of a recording of a trajectory: all except those of a slow joint, with jumping
//! columns smoothed by its low-pass.
//!
//! Both reduce the information about Coulomb friction, which differs from viscous friction at low speed: the first
//! parameter of the law has a standard deviation up to a quarter larger than that of all unfiltered rows.

use super::series::state_at;
use armwatch_method::NumericsError;
use armwatch_method::identify::filtered_columns::filtered_coulomb_columns;
use armwatch_method::identify::joint_factors::{
    FactorColumns, embedded, factor_cycle, used_for_identification,
};
use armwatch_method::least_squares::factor::TriangularFactor;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_method::signal::filter::{carried_cutoff, filter_signals, row_step};
use armwatch_model::robot::{FourierExcitation, Robot};
use armwatch_model::run::{Samples, Stage};

/// Settling time of the low-pass before and after the motion, in periods of the cut-off.
const LEAD_PERIODS: f64 = 6.0;

/// Settings of a test's recording.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingPlan {
    /// Rows per second, Hz.
    pub sample_rate_hz: f64,
    /// Periods of the series.
    pub periods: u32,
    /// Cut-off of the analysis's low-pass, Hz; a sample rate that is too low for it gets a lower one.
    pub cutoff_hz: f64,
    /// Standard deviation of each joint's torque signal, `[n]`, Nm (N); above 0.
    pub noise: Vec<f64>,
}

/// Triangular factor of each joint's rows over the periods of a recording without noise, `[n]`, over all base
/// parameters; the torque is zero. A joint that is always slow has a factor without rows.
///
/// # Errors
/// Those of [`filter_signals`].
pub fn recorded_factors(
    robot: &Robot,
    base: &BaseParameters,
    series: &FourierExcitation,
    recording: &RecordingPlan,
) -> Result<Vec<TriangularFactor>, NumericsError> {
    let rate = recording.sample_rate_hz;
    let cutoff = carried_cutoff(recording.cutoff_hz, rate);
    let samples = one_period(robot, series, rate, LEAD_PERIODS / cutoff);
    let filtered = filter_signals(&samples, cutoff)?;
    let jumping = filtered_coulomb_columns(robot, &filtered);
    let columns = FactorColumns::new(robot, base);
    let found = factor_cycle(robot, &columns, &base.kept_columns, &filtered, &jumping, &samples);
    let used = found.factors.iter().filter(|of| used_for_identification(of.stage, of.motion));
    // rows that are not observed repeat the information; together they have the noise of one row less
    let rows = row_step(cutoff, rate) as f64 * f64::from(recording.periods);
    Ok(embedded(&columns, used).iter().map(|factor| factor.scaled(rows.sqrt())).collect())
}

/// One period of a series as the excitation, with `lead_s` of it before and after, s, as moves between stages.
fn one_period(robot: &Robot, series: &FourierExcitation, rate: f64, lead_s: f64) -> Samples {
    let lead = (lead_s * rate).ceil() as usize;
    let period = (rate / series.base_frequency).round().max(1.0) as usize;
    let rows = lead + period + lead;
    let mut samples = Samples {
        time: (0..rows).map(|row| row as f64 / rate).collect(),
        position: vec![Vec::with_capacity(rows); robot.joint_count()],
        torque: vec![vec![0.0; rows]; robot.joint_count()],
        ..Samples::default()
    };
    let mut velocity = samples.position.clone();
    for row in 0..rows {
        let in_period = (lead..lead + period).contains(&row);
        samples.stage.push(if in_period { Stage::Excitation } else { Stage::Between });
        let states = state_at(series, (row as f64 - lead as f64) / rate);
        for (j, [q, qd, _]) in states.into_iter().enumerate() {
            samples.position[j].push(q);
            velocity[j].push(qd);
        }
    }
    samples.velocity = Some(velocity);
    samples
}
