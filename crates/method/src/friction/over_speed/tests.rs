//! Tests of friction over speed with known truth.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{fit_speed_model, friction_at_speed, friction_over_speed};
use crate::NumericsError;
use armwatch_model::analysis::friction::SpeedModel;
use armwatch_model::analysis::{FrictionPoint, GravityRemoval};
use armwatch_model::robot::JointIndex;

const JOINT: JointIndex = JointIndex::new(0);
const LEVELS: [f64; 6] = [0.05, 0.2, 0.4, 0.6, 0.8, 1.0];
const TOP: f64 = 4.0;
/// Number of rows: half a second at 250 Hz after a low-pass of 12 Hz.
const ROWS: usize = 125;
const FRACTION: f64 = 24.0 / 250.0;
const SEEDS: u64 = 200;
/// Accepted coverage of nominal 95 % in 200 draws; the lower end is three standard deviations away.
const HONEST: [f64; 2] = [0.90, 0.98];

type Curve = fn(f64) -> f64;

fn polynomial(v: f64) -> f64 {
    5.68 + 13.76 * v - 4.486 * v * v + 0.56 * v.powi(3)
}
fn coulomb_viscous(v: f64) -> f64 {
    5.0 + 4.0 * v
}
fn stribeck(v: f64) -> f64 {
    5.0 + 3.0 * v + 4.0 * (-(v / 0.6).powi(2)).exp()
}
fn power_law(v: f64) -> f64 {
    4.0 + 12.0 * (v / TOP).powf(0.5)
}

/// Plateaus with a row noise of `sigma`; the forward direction has `more` Nm of friction.
fn points(curve: Curve, levels: &[f64], sigma: f64, more: f64, seed: u64) -> Vec<FrictionPoint> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { rng.sample(StandardNormal) };
    let independent = (ROWS as f64 * FRACTION) as usize;
    let mut found = Vec::new();
    for &level in levels {
        for direction in [-1_i8, 1] {
            let rows: Vec<f64> = (0..independent).map(|_| sigma * normal()).collect();
            let mean = rows.iter().sum::<f64>() / independent as f64;
            let squares: f64 = rows.iter().map(|r| (r - mean).powi(2)).sum();
            let along = curve(level * TOP) + mean + if direction > 0 { more } else { 0.0 };
            found.push(FrictionPoint {
                joint: JOINT,
                time: 60.0,
                speed_fraction: level,
                speed: level * TOP,
                direction,
                torque: along * f64::from(direction),
                std: (squares / (independent - 1) as f64).sqrt(),
                samples: ROWS,
                gravity: GravityRemoval::AxisVertical,
                load: None,
            });
        }
    }
    found
}

fn truths() -> [(SpeedModel, Curve, Vec<f64>); 4] {
    [
        (SpeedModel::CoulombViscous, coulomb_viscous, vec![5.0, 4.0]),
        (SpeedModel::PowerLaw, power_law, vec![4.0, 12.0, 0.5]),
        (SpeedModel::Stribeck, stribeck, vec![5.0, 3.0, 4.0, 0.6]),
        (SpeedModel::Polynomial, polynomial, vec![5.68, 13.76, -4.486, 0.56]),
    ]
}

#[test]
fn the_truth_lies_inside_its_intervals_as_often_as_they_say() {
    for (model, curve, truth) in truths() {
        let mut held = vec![0_usize; truth.len()];
        for seed in 0..SEEDS {
            let fit = fit_speed_model(JOINT, &points(curve, &LEVELS, 0.15, 0.0, seed), FRACTION, model, 1)
                .expect("fits");
            for (k, (c, truth)) in fit.coefficients.iter().zip(&truth).enumerate() {
                held[k] += usize::from((c.estimate.value - truth).abs() < 1.96 * c.estimate.std_error);
            }
        }
        let parts: Vec<f64> = held.iter().map(|h| *h as f64 / SEEDS as f64).collect();
        let mean = parts.iter().sum::<f64>() / parts.len() as f64;
        assert!((HONEST[0]..=HONEST[1]).contains(&mean), "{}: {parts:?}", model.name());
    }
}

#[test]
fn the_true_form_is_chosen_in_most_seeds_and_the_chosen_curve_holds_the_truth() {
    for (model, curve, _) in truths() {
        let (mut right, mut held, mut asked) = (0, 0, 0);
        let mut others = std::collections::BTreeMap::new();
        for seed in 0..SEEDS {
            let fits =
                friction_over_speed(JOINT, &points(curve, &LEVELS, 0.15, 0.0, seed), FRACTION).expect("fits");
            let chosen = fits.directions[0].model;
            *others.entry(chosen.name()).or_insert(0) += 1;
            right += u64::from(chosen == model);
            for fit in &fits.directions {
                for level in [0.1, 0.3, 0.6, 0.9] {
                    let found = friction_at_speed(fit, level * TOP);
                    held += u64::from((found.value - curve(level * TOP)).abs() < 1.96 * found.std_error);
                    asked += 1;
                }
            }
        }
        assert!(2 * right > SEEDS, "{}: {others:?}", model.name());
        // the choice of a form costs some of the coverage
        assert!(held as f64 / f64::from(asked) > 0.85, "{}: {held} of {asked}", model.name());
    }
}

#[test]
fn without_noise_every_form_gives_back_its_coefficients() {
    for (model, curve, truth) in truths() {
        let fit =
            fit_speed_model(JOINT, &points(curve, &LEVELS, 0.0, 0.0, 1), FRACTION, model, -1).expect("fits");
        for (c, truth) in fit.coefficients.iter().zip(&truth) {
            // a golden section finds a minimum to the root of the resolution of its cost
            assert!((c.estimate.value - truth).abs() < 1e-3 * truth.abs(), "{model:?} {c:?} {truth}");
        }
        for v in [0.3, 1.7, 4.0] {
            assert!((friction_at_speed(&fit, v).value - curve(v)).abs() < 1e-3 * curve(v));
        }
    }
}

#[test]
fn asymmetry_is_found_with_an_interval_and_symmetry_is_not_called_one() {
    for more in [0.0, 0.4] {
        let held = (0..SEEDS)
            .filter(|&seed| {
                let fits =
                    friction_over_speed(JOINT, &points(polynomial, &LEVELS, 0.15, more, seed), FRACTION);
                let difference = fits.expect("fits").asymmetry.expect("both directions").difference;
                (difference.value - more).abs() < 1.96 * difference.std_error
            })
            .count();
        let part = held as f64 / SEEDS as f64;
        assert!((HONEST[0]..=HONEST[1]).contains(&part), "{more} Nm: {part}");
    }
}

#[test]
fn fewer_levels_fall_back_and_say_so() {
    for (levels, widest) in
        [(5, SpeedModel::Polynomial), (4, SpeedModel::PowerLaw), (3, SpeedModel::CoulombViscous)]
    {
        let fits = friction_over_speed(JOINT, &points(polynomial, &LEVELS[..levels], 0.02, 0.0, 3), FRACTION)
            .expect("fits");
        assert!(fits.directions[0].model <= widest, "{levels}: {:?}", fits.directions[0].model);
        assert!(fits.criteria.iter().all(|(model, _)| *model <= widest), "{levels}: {:?}", fits.criteria);
        assert_eq!(fits.remarks.is_empty(), widest == SpeedModel::Polynomial, "{:?}", fits.remarks);
    }
}

#[test]
fn one_speed_is_refused_and_one_direction_is_said() {
    let one = points(polynomial, &LEVELS[3..4], 0.1, 0.0, 3);
    let error = friction_over_speed(JOINT, &one, FRACTION).expect_err("one speed");
    assert!(matches!(error, NumericsError::TooFewSpeeds { speeds: 1, .. }));
    assert!(error.to_string().contains("more levels"), "{error}");
    let mut forward = points(polynomial, &LEVELS, 0.1, 0.0, 3);
    forward.retain(|p| p.direction == 1);
    let fits = friction_over_speed(JOINT, &forward, FRACTION).expect("fits");
    assert_eq!((fits.directions.len(), fits.asymmetry), (1, None));
    assert!(fits.remarks.iter().any(|r| r.contains("direction -1")), "{:?}", fits.remarks);
}

#[test]
fn friction_that_would_drive_is_held_at_zero() {
    // falls so steeply with speed that a line would end below zero
    let falling: Curve = |v| 0.5 * v;
    let mut noisy = points(falling, &LEVELS, 0.05, 0.0, 4);
    for p in &mut noisy {
        p.torque -= f64::from(p.direction) * 0.3;
    }
    let fit = fit_speed_model(JOINT, &noisy, FRACTION, SpeedModel::CoulombViscous, 1).expect("fits");
    assert!(fit.coefficients[0].at_bound && fit.coefficients[0].estimate.value == 0.0, "{fit:?}");
    assert!(!fit.coefficients[1].at_bound && fit.coefficients[1].estimate.value > 0.0);
}
