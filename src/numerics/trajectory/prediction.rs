//! What a test will tell before it is run: standard deviations of parameters and the smallest changes that it shows,
//! at given noise of the torque.
//!
//! With rows `w` of one test divided by the noise of their joint, `(w' w)⁻¹` is the covariance of the weighted least
//! squares estimate under white noise. A low-pass that leaves the motion alone does not change it: it takes away noise
//! where the rows have nothing. What is not noise, such as friction that changes while the arm warms up, is not in it.

use super::observation::Observation;
use super::series::Basis;
use crate::numerics::NumericsError;
use crate::numerics::least_squares::conditioning::identifiability;
use crate::numerics::least_squares::factor::TriangularFactor;
use crate::numerics::model::base_parameters::BaseParameters;
use crate::robot::{FourierExcitation, JointIndex, ParameterId, ParameterKind, Robot, StandardParameters};

/// Condition numbers of an observation matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditioning {
    /// In SI units.
    pub condition_number: f64,
    /// With columns of unit norm.
    pub scaled_condition_number: f64,
}

/// How a test is recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Rows a second, Hz.
    pub sample_rate_hz: f64,
    /// Periods of the series.
    pub periods: u32,
    /// Standard deviation of each joint's torque signal, `[n]`, Nm (N); above 0.
    pub noise: Vec<f64>,
}

/// What a test will tell.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Standard deviation of each base parameter `[b]`, in its own unit.
    pub standard_deviations: Vec<f64>,
    /// Standard deviation of a change of each joint's whole friction as a fraction of it, `[n]`; `None` without
    /// nominal friction. Nothing else has changed, and the state before is known.
    pub friction_change: Vec<Option<f64>>,
    /// The same of a mass at the tool frame, kg; `None` where the arm does not feel one.
    pub load_change: Option<f64>,
}

/// Condition numbers of the columns `chosen` of the base parameters over one period at about `sample_rate_hz`.
///
/// # Errors
/// [`NumericsError::NotFinite`] if singular values cannot be had.
pub fn conditioning(
    robot: &Robot,
    base: &BaseParameters,
    chosen: &[usize],
    series: &FourierExcitation,
    sample_rate_hz: f64,
) -> Result<Conditioning, NumericsError> {
    let observation = Observation::new(robot, base, chosen);
    let factors = observation.joint_factors(series, &basis_of(series, sample_rate_hz));
    let found = identifiability(&stacked(chosen.len(), &factors))?;
    Ok(Conditioning {
        condition_number: found.condition_number,
        scaled_condition_number: found.scaled_condition_number,
    })
}

/// What a test with this series will tell of all base parameters.
///
/// # Errors
/// [`NumericsError::NotFinite`] where the motion does not show every parameter.
pub fn predict(
    robot: &Robot,
    base: &BaseParameters,
    series: &FourierExcitation,
    recording: &Recording,
) -> Result<Prediction, NumericsError> {
    let all: Vec<usize> = (0..base.kept.len()).collect();
    let observation = Observation::new(robot, base, &all);
    let factors = observation.joint_factors(series, &basis_of(series, recording.sample_rate_hz));
    let weighted: Vec<TriangularFactor> =
        factors.iter().zip(&recording.noise).map(|(factor, noise)| factor.scaled(1.0 / noise)).collect();
    let factor = stacked(all.len(), &weighted).scaled(f64::from(recording.periods).sqrt());
    let inverse = factor.inverse_of_upper()?;
    let upper = factor.upper();
    // a change along `direction` alone: 1 / |r direction|
    let along = |direction: &[f64]| {
        let squares: f64 = (0..direction.len())
            .map(|i| (i..direction.len()).map(|k| upper[(i, k)] * direction[k]).sum::<f64>().powi(2))
            .sum();
        (squares > 0.0).then(|| 1.0 / squares.sqrt())
    };
    Ok(Prediction {
        standard_deviations: (0..all.len()).map(|k| inverse.row(k).norm_l2()).collect(),
        friction_change: robot
            .joint_indices()
            .map(|joint| friction_direction(robot, base, joint).and_then(|of| along(&of)))
            .collect(),
        load_change: along(&load_direction(robot, base)),
    })
}

/// The base parameters of a joint's nominal friction, all others zero.
fn friction_direction(robot: &Robot, base: &BaseParameters, joint: JointIndex) -> Option<Vec<f64>> {
    let nominal = robot.joints[joint.index()].nominal.as_ref()?;
    let own = |id: &ParameterId| match id.kind {
        ParameterKind::Friction(term) if id.joint == joint => term.nominal(&nominal.friction),
        _ => Some(0.0),
    };
    // an offset of the torque signal is no friction
    Some(base.kept.iter().map(|id| own(id).unwrap_or(0.0)).collect())
}

/// What 1 kg at the tool frame adds to the base parameters.
fn load_direction(robot: &Robot, base: &BaseParameters) -> Vec<f64> {
    let body =
        StandardParameters::from_centre_of_mass(1.0, &robot.tool.translation, &nalgebra::Matrix3::zeros());
    let mut full = vec![0.0; robot.parameter_count()];
    let last = StandardParameters::COUNT * (robot.joint_count() - 1);
    full[last..last + StandardParameters::COUNT].copy_from_slice(&body.0);
    base.group(&full)
}

fn basis_of(series: &FourierExcitation, sample_rate_hz: f64) -> Basis {
    let harmonics = series.a.first().map_or(1, Vec::len);
    let instants = (sample_rate_hz / series.base_frequency).round().max(1.0) as usize;
    Basis::new(series.base_frequency, harmonics, instants)
}

fn stacked(columns: usize, factors: &[TriangularFactor]) -> TriangularFactor {
    let places: Vec<usize> = (0..columns).collect();
    TriangularFactor::embedded(columns, factors.iter().map(|factor| (factor, &places[..])))
}
