//! Predicts the results of a test before it is run: standard deviations of parameters and the smallest detectable
//! changes, at given noise of the torque.
//!
//! With rows `w` of one test divided by the noise of their joint, `(w' w)⁻¹` is the covariance of the weighted least
//! squares estimate under white noise. The low-pass removes noise at frequencies where the rows have almost no content,
//! and does not change the covariance. The rows are those of the analysis ([`recorded_rows`](super::recorded_rows)).
//! Not included are noise of positions and velocities, and deviations other than noise, such as friction that changes
//! while the arm warms up.

use super::observation::ObservationColumns;
use super::recorded_rows::{RecordingPlan, recorded_factors};
use super::series::Basis;
use armwatch_method::NumericsError;
use armwatch_method::least_squares::conditioning::identifiability;
use armwatch_method::least_squares::factor::TriangularFactor;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_model::robot::{
    FourierExcitation, JointIndex, ParameterId, ParameterKind, Robot, StandardParameters,
};

/// Condition numbers of an observation matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditioning {
    /// In SI units.
    pub condition_number: f64,
    /// The same with columns scaled to unit norm.
    pub scaled_condition_number: f64,
}

/// Predicted results of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    /// Standard deviation of each base parameter `[b]`, in its own unit.
    pub standard_deviations: Vec<f64>,
    /// Standard deviation of a change of each joint's whole friction as a fraction of it, `[n]`; `None` without nominal
    /// friction. It assumes that nothing else has changed, and that the state before is known.
    pub friction_change: Vec<Option<f64>>,
    /// The same of a mass at the tool frame, kg; `None` if it has no effect on the arm.
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
    let observation = ObservationColumns::new(robot, base, chosen);
    let factors = observation.joint_factors(series, &basis_of(series, sample_rate_hz));
    let found = identifiability(&stacked(chosen.len(), &factors))?;
    Ok(Conditioning {
        condition_number: found.condition_number,
        scaled_condition_number: found.scaled_condition_number,
    })
}

/// Predicts the results of a test with this series for all base parameters.
///
/// # Errors
/// [`NumericsError::NotFinite`] if the motion does not identify every parameter, and those of [`recorded_factors`].
pub fn predict(
    robot: &Robot,
    base: &BaseParameters,
    series: &FourierExcitation,
    recording: &RecordingPlan,
) -> Result<Prediction, NumericsError> {
    let b = base.kept.len();
    let factors = recorded_factors(robot, base, series, recording)?;
    let weighted: Vec<TriangularFactor> =
        factors.iter().zip(&recording.noise).map(|(factor, noise)| factor.scaled(1.0 / noise)).collect();
    let factor = stacked(b, &weighted);
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
        standard_deviations: (0..b).map(|k| inverse.row(k).norm_l2()).collect(),
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
    // an offset of the torque signal is not friction
    Some(base.kept.iter().map(|id| own(id).unwrap_or(0.0)).collect())
}

/// Change of the base parameters `[b]` by 1 kg at the tool frame.
pub fn load_direction(robot: &Robot, base: &BaseParameters) -> Vec<f64> {
    let body =
        StandardParameters::from_centre_of_mass(1.0, &robot.tool.translation, &nalgebra::Matrix3::zeros());
    let mut full = vec![0.0; robot.parameter_count()];
    let last = StandardParameters::COUNT * (robot.joint_count() - 1);
    full[last..last + StandardParameters::COUNT].copy_from_slice(&body.0);
    base.group(&full)
}

pub(super) fn basis_of(series: &FourierExcitation, sample_rate_hz: f64) -> Basis {
    let harmonics = series.a.first().map_or(1, Vec::len);
    let instants = (sample_rate_hz / series.base_frequency).round().max(1.0) as usize;
    Basis::new(series.base_frequency, harmonics, instants)
}

fn stacked(columns: usize, factors: &[TriangularFactor]) -> TriangularFactor {
    let places: Vec<usize> = (0..columns).collect();
    TriangularFactor::embedded(columns, factors.iter().map(|factor| (factor, &places[..])))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use nalgebra::{DMatrix, DVector};

    use super::super::series::state_at;
    use super::*;
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_method::model::regressor::{Regressor, joint_torque_regressor};
    use armwatch_model::robot::FrictionTerm;
    use armwatch_testing::{er3a, er3a_of};

    /// The observation matrix by the regressor of single instants and states of the closed form.
    fn dense(robot: &Robot, columns: &[usize], series: &FourierExcitation, rate_hz: f64) -> DMatrix<f64> {
        let n = robot.joint_count();
        let instants = (rate_hz / series.base_frequency).round() as usize;
        let mut w = DMatrix::zeros(n * instants, columns.len());
        let mut y = Regressor::new(robot);
        for k in 0..instants {
            let states = state_at(series, k as f64 / rate_hz);
            let of = |quantity: usize| states.iter().map(|state| state[quantity]).collect::<Vec<f64>>();
            joint_torque_regressor(robot, &of(0), &of(1), &of(2), &mut y);
            for (c, &column) in columns.iter().enumerate() {
                for (j, value) in y.column(column).iter().enumerate() {
                    w[(n * k + j, c)] = *value;
                }
            }
        }
        w
    }

    fn inertial(base: &BaseParameters) -> Vec<usize> {
        let is_friction = |k: &usize| matches!(base.kept[*k].kind, ParameterKind::Friction(_));
        (0..base.kept.len()).filter(|k| !is_friction(k)).collect()
    }

    /// The stated condition numbers of the published series, and those by singular values of the whole matrix.
    #[test]
    fn the_published_series_has_the_published_condition_numbers() {
        let robot = er3a();
        let series = robot.excitation.clone().expect("Table 4.1");
        let base = base_parameters(&robot).expect("base parameters");
        let chosen = inertial(&base);
        let found = conditioning(&robot, &base, &chosen, &series, 25.0).expect("condition numbers");
        assert_eq!(chosen.len(), 40);
        assert!((found.condition_number - 29.6).abs() < 0.05, "{found:?}");
        assert!((found.scaled_condition_number - 9.1).abs() < 0.05, "{found:?}");
        let columns: Vec<usize> = chosen.iter().map(|&k| base.kept_columns[k]).collect();
        let mut w = dense(&robot, &columns, &series, 25.0);
        let ratio = |w: &DMatrix<f64>| {
            let values = w.singular_values();
            values[0] / values[values.len() - 1]
        };
        assert_eq!(w.rank(1e-6), 40);
        assert!((found.condition_number / ratio(&w) - 1.0).abs() < 1e-9);
        w.column_iter_mut().for_each(|mut column| {
            let length = column.norm();
            column /= length;
        });
        assert!((found.scaled_condition_number / ratio(&w) - 1.0).abs() < 1e-9);
    }

    /// Rows of one period through the low-pass, as weights of rows around the circle `[instants]`: its response is
    /// `1 / (1 + (tan(pi f / rate) / tan(pi cutoff / rate))⁸)`, without phase.
    fn low_pass_kernel(instants: usize, rate_hz: f64, cutoff_hz: f64) -> Vec<f64> {
        let share = |m: usize| {
            let ratio =
                (PI * m.min(instants - m) as f64 / instants as f64).tan() / (PI * cutoff_hz / rate_hz).tan();
            1.0 / (1.0 + ratio.powi(8))
        };
        let shares: Vec<f64> = (0..instants).map(share).collect();
        let weight = |row: usize| {
            let wave = |m: usize| (TAU * ((row * m) % instants) as f64 / instants as f64).cos();
            (0..instants).map(|m| shares[m] * wave(m)).sum::<f64>() / instants as f64
        };
        (0..instants).map(weight).collect()
    }

    /// The scatter of weighted least squares over tests with white noise, by the dense matrix: rows of a slow joint are
    /// excluded, noise and columns with jumps are low-passed around the period. It uses no part of the recording's
    /// analysis.
    fn scatter_of_tests(
        robot: &Robot,
        base: &BaseParameters,
        series: &FourierExcitation,
        recording: &RecordingPlan,
    ) -> Vec<f64> {
        let (n, rate) = (robot.joint_count(), recording.sample_rate_hz);
        let mut w = dense(robot, &base.kept_columns, series, rate);
        let instants = w.nrows() / n;
        let kernel = low_pass_kernel(instants, rate, recording.cutoff_hz);
        let turned = |k: usize, row: usize| kernel[(row + instants - k) % instants];
        for (c, id) in base.kept.iter().enumerate() {
            let ParameterKind::Friction(FrictionTerm::F1 | FrictionTerm::F3) = id.kind else { continue };
            for j in 0..n {
                let column: Vec<f64> = (0..instants).map(|k| w[(n * k + j, c)]).collect();
                for row in 0..instants {
                    w[(n * row + j, c)] = (0..instants).map(|k| column[k] * turned(k, row)).sum();
                }
            }
        }
        for k in 0..instants {
            let states = state_at(series, k as f64 / rate);
            for (j, [_, speed, _]) in states.into_iter().enumerate() {
                let moves = speed.abs() >= robot.joints[j].low_speed;
                w.row_mut(n * k + j).scale_mut(if moves { 1.0 / recording.noise[j] } else { 0.0 });
            }
        }
        let solve = w.pseudo_inverse(1e-12).expect("an inverse");
        // sensitivity of each parameter to the noise of a row, before the low-pass
        let along = |c: usize, j: usize, k: usize| {
            (0..instants).map(|row| solve[(c, n * row + j)] * turned(k, row)).sum::<f64>()
        };
        let variance =
            |c: usize| (0..n).flat_map(|j| (0..instants).map(move |k| along(c, j, k).powi(2))).sum::<f64>();
        (0..base.kept.len()).map(|c| variance(c).sqrt()).collect()
    }

    #[test]
    fn predicted_standard_deviations_are_the_scatter_of_tests() {
        let robot = er3a_of(3);
        let base = base_parameters(&robot).expect("base parameters");
        let mut series = er3a().excitation.expect("Table 4.1");
        [&mut series.a, &mut series.b].into_iter().for_each(|rows| rows.truncate(3));
        series.centre.truncate(3);
        // every second row is observed
        let (rate, noise) = (160.0, vec![0.45, 0.5, 0.28]);
        let recording = RecordingPlan { sample_rate_hz: rate, periods: 1, cutoff_hz: 12.0, noise };
        let found = predict(&robot, &base, &series, &recording).expect("a prediction");
        let scatter = scatter_of_tests(&robot, &base, &series, &recording);
        let mut ratios: Vec<f64> = found
            .standard_deviations
            .iter()
            .zip(&scatter)
            .map(|(predicted, scatter)| predicted / scatter)
            .collect();
        ratios.sort_by(f64::total_cmp);
        let median = ratios[ratios.len() / 2];
        assert!((0.97..=1.03).contains(&median), "{median}");
        assert!(ratios.iter().all(|ratio| (0.9..=1.1).contains(ratio)), "{ratios:?}");

        // four periods halve them; one direction alone is never less certain than within all
        let four = RecordingPlan { periods: 4, ..recording.clone() };
        let longer = predict(&robot, &base, &series, &four).expect("a prediction");
        let halves = longer.standard_deviations.iter().zip(&found.standard_deviations);
        assert!(halves.into_iter().all(|(four, one)| (2.0 * four / one - 1.0).abs() < 1e-9));
        let change = found.friction_change[1].expect("nominal friction");
        let direction = friction_direction(&robot, &base, JointIndex::new(1)).expect("nominal friction");
        let all_rows = dense(&robot, &base.kept_columns, &series, rate) * DVector::from_vec(direction);
        let weighted =
            all_rows.iter().enumerate().map(|(i, x)| (x / recording.noise[i % 3]).powi(2)).sum::<f64>();
        // except for slow rows and smeared columns
        assert!((change * weighted.sqrt() - 1.0).abs() < 0.05, "{change}");
        assert!(found.load_change.is_some_and(|load| load > 0.0 && load < 1.0), "{:?}", found.load_change);
    }

    #[test]
    fn a_motion_of_one_joint_does_not_tell_of_the_others() {
        let robot = er3a_of(2);
        let base = base_parameters(&robot).expect("base parameters");
        let series = FourierExcitation {
            base_frequency: 0.2,
            a: vec![vec![0.5, -0.5], vec![0.0, 0.0]],
            b: vec![vec![0.2, -0.1], vec![0.0, 0.0]],
            centre: vec![0.0, 0.1],
        };
        let recording =
            RecordingPlan { sample_rate_hz: 50.0, periods: 1, cutoff_hz: 12.0, noise: vec![1.0; 2] };
        assert!(predict(&robot, &base, &series, &recording).is_err());
    }
}
