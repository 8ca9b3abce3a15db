//! The Fourier part of the excitation stage: the description's own, or a random one inside all
//! limits.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::motion::{MotionPiece, MotionState, state_at};
use crate::error::SimulateError;
use armwatch_model::robot::{FourierExcitation, JointLimits, Robot};

/// Base frequency of the source's test, Hz.
const BASE_FREQUENCY_HZ: f64 = 0.1;
/// Harmonics of the source's test.
const HARMONICS: usize = 5;
/// Shares of position, speed and acceleration range that random coefficients may use; the full-speed trajectory covers
/// the rest.
const RANDOM_USE: [f64; 3] = [0.85, 0.7, 0.7];
/// Samples of one period for checks against limits: 100 per period of the fifth harmonic.
const CHECK_SAMPLES: u32 = 500;

/// The robot's own series, after a check, or a random one for `seed`. Its own period is `1 / base_frequency`.
///
/// # Errors
/// [`SimulateError::ExcitationShape`] if coefficients are missing, [`SimulateError::ExcitationOutsideLimits`] if the
/// described motion exceeds the limits.
pub fn fourier_excitation(robot: &Robot, seed: u64) -> Result<FourierExcitation, SimulateError> {
    match &robot.excitation {
        Some(series) => {
            check_shape(series, robot.joint_count())?;
            check_limits(series, robot)?;
            Ok(series.clone())
        }
        None => Ok(random_excitation(robot, seed)),
    }
}

/// Coefficients that start and end at rest without acceleration: `sum a_l = 0`, `sum l b_l = 0`.
fn random_excitation(robot: &Robot, seed: u64) -> FourierExcitation {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let n = robot.joint_count();
    let mut series = FourierExcitation {
        base_frequency: BASE_FREQUENCY_HZ,
        a: (0..n).map(|_| random_row(&mut rng, |_| 1.0)).collect(),
        b: (0..n).map(|_| random_row(&mut rng, |l| l as f64)).collect(),
        centre: vec![0.0; n],
    };
    let extremes = extremes(&series, n);
    for (j, joint) in robot.joints.iter().enumerate() {
        let JointLimits { position_min, position_max, velocity, acceleration, jerk } = joint.limits;
        let [low, high, speed, acc] = extremes[j];
        let scale = (RANDOM_USE[0] * (position_max - position_min) / (high - low))
            .min(RANDOM_USE[1] * velocity / speed)
            .min(RANDOM_USE[2] * acceleration / acc)
            .min(jerk.map_or(f64::INFINITY, |jerk| RANDOM_USE[2] * jerk / jerk_bound(&series, j)));
        series.a[j].iter_mut().chain(&mut series.b[j]).for_each(|c| *c *= scale);
        series.centre[j] = 0.5 * (position_min + position_max) - 0.5 * scale * (low + high);
    }
    series
}

/// Upper bound of the jerk of a joint: the sum of its harmonics' amplitudes, rad/s³ (m/s³).
fn jerk_bound(series: &FourierExcitation, joint: usize) -> f64 {
    let w = std::f64::consts::TAU * series.base_frequency;
    let harmonics = (1..).zip(series.a[joint].iter().zip(&series.b[joint]));
    harmonics.map(|(l, (a, b)): (u32, _)| (w * f64::from(l)).powi(2) * a.hypot(*b)).sum()
}

/// Random numbers whose sum, weighted by `weight(l)` with `l` from 1, is zero.
fn random_row(rng: &mut ChaCha8Rng, weight: impl Fn(usize) -> f64) -> Vec<f64> {
    let mut row: Vec<f64> = (1..HARMONICS).map(|_| rng.random_range(-1.0..1.0)).collect();
    let sum: f64 = row.iter().enumerate().map(|(i, c)| weight(i + 1) * c).sum();
    row.push(-sum / weight(HARMONICS));
    row
}

fn check_shape(series: &FourierExcitation, n: usize) -> Result<(), SimulateError> {
    let harmonics = series.a.first().map_or(0, Vec::len);
    let full = |rows: &[Vec<f64>]| rows.len() == n && rows.iter().all(|r| r.len() == harmonics);
    let frequency = series.base_frequency > 0.0 && series.base_frequency.is_finite();
    if full(&series.a) && full(&series.b) && series.centre.len() == n && harmonics > 0 && frequency {
        Ok(())
    } else {
        Err(SimulateError::ExcitationShape { joints: n })
    }
}

fn check_limits(series: &FourierExcitation, robot: &Robot) -> Result<(), SimulateError> {
    let extremes = extremes(series, robot.joint_count());
    for ((joint, index), [low, high, speed, acceleration]) in
        robot.joints.iter().zip(robot.joint_indices()).zip(extremes)
    {
        let limits = joint.limits;
        let checks = [
            ("lowest position", low, limits.position_min, low >= limits.position_min),
            ("highest position", high, limits.position_max, high <= limits.position_max),
            ("speed", speed, limits.velocity, speed <= limits.velocity),
            ("acceleration", acceleration, limits.acceleration, acceleration <= limits.acceleration),
        ];
        if let Some(&(what, value, limit, _)) = checks.iter().find(|(.., inside)| !inside) {
            return Err(SimulateError::ExcitationOutsideLimits { joint: index, what, value, limit });
        }
    }
    Ok(())
}

/// Lowest and highest position, largest speed and acceleration of each joint over one period.
fn extremes(series: &FourierExcitation, n: usize) -> Vec<[f64; 4]> {
    let motion = MotionPiece::Fourier(series.clone());
    let mut extremes = vec![[f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0]; n];
    for k in 0..=CHECK_SAMPLES {
        let t = f64::from(k) / f64::from(CHECK_SAMPLES) / series.base_frequency;
        let MotionState { position, velocity, acceleration } = state_at(&motion, t);
        for (j, [low, high, speed, acc]) in extremes.iter_mut().enumerate() {
            *low = low.min(position[j]);
            *high = high.max(position[j]);
            *speed = speed.max(velocity[j].abs());
            *acc = acc.max(acceleration[j].abs());
        }
    }
    extremes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_arms::er3a;
    use crate::test_arms::{er3a_with_excitation, nine_joints};

    #[test]
    fn the_published_series_reaches_the_stated_speeds() {
        let robot = er3a_with_excitation();
        let series = fourier_excitation(&robot, 0).unwrap();
        let percent: Vec<f64> = extremes(&series, 6)
            .iter()
            .zip(&robot.joints)
            .map(|(e, joint)| (100.0 * e[2] / joint.limits.velocity).round())
            .collect();
        assert_eq!(percent, [66.0, 61.0, 59.0, 52.0, 46.0, 39.0]);
    }

    #[test]
    fn the_published_series_starts_at_rest_with_the_corrected_acceleration() {
        let series = fourier_excitation(&er3a_with_excitation(), 0).unwrap();
        let start = state_at(&MotionPiece::Fourier(series), 0.0);
        // Coefficients are printed with four decimals; five of them, weighted by up to 5.
        let rounding = 0.5e-4 * 15.0;
        for j in 0..6 {
            assert!(start.velocity[j].abs() < rounding, "joint {}: {}", j + 1, start.velocity[j]);
            assert!(start.acceleration[j].abs() < rounding, "joint {}: {}", j + 1, start.acceleration[j]);
        }
    }

    #[test]
    fn random_series_start_at_rest_inside_limits_and_depend_on_the_seed() {
        for robot in [er3a(), nine_joints()] {
            let series = fourier_excitation(&robot, 7).unwrap();
            check_limits(&series, &robot).unwrap();
            let start = state_at(&MotionPiece::Fourier(series.clone()), 0.0);
            for j in 0..robot.joint_count() {
                assert!(start.velocity[j].abs() < 1e-12 && start.acceleration[j].abs() < 1e-12);
            }
            assert_eq!(series, fourier_excitation(&robot, 7).unwrap());
            assert_ne!(series, fourier_excitation(&robot, 8).unwrap());
        }
    }

    #[test]
    fn a_series_outside_limits_or_with_missing_rows_is_refused() {
        let mut robot = er3a_with_excitation();
        robot.joints[4].limits.velocity = 1.0;
        let message = fourier_excitation(&robot, 0).unwrap_err().to_string();
        assert!(message.contains("joint 5") && message.contains("speed"), "{message}");

        let mut robot = er3a_with_excitation();
        robot.excitation.as_mut().unwrap().b.pop();
        assert!(matches!(fourier_excitation(&robot, 0), Err(SimulateError::ExcitationShape { joints: 6 })));
    }
}
