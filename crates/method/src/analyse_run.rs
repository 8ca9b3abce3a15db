//! Analysis of a whole run: warm-up fits, statistics of parameters, one summary per joint.

use super::friction::points::level_means::{SAME_PASS_S, at_level, direction_difference, nearest_level};
use super::friction::warm_up::{WarmUpPoint, fit_warm_up, warm_up_rmsd};
use super::spare_threads::SpareThreads;
use super::statistics::descriptive::{mean, median, parameter_statistics, standard_deviation, swing};
use armwatch_model::analysis::measurements::{ByCycle, CyclePoint, RunMeasurements};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{FrictionPoint, JointSummary, RunAnalysis, WarmFriction, WarmUpFit};
use armwatch_model::robot::JointIndex;

/// Analyses a whole run: warm-up fits, statistics of parameters, one summary per joint.
#[must_use]
pub fn analyse_run(
    joint_count: usize,
    settings: &AnalysisSettings,
    measurements: &RunMeasurements,
) -> RunAnalysis {
    analyse_run_on(&SpareThreads::default(), joint_count, settings, measurements)
}

/// Same as [`analyse_run`], with fits on more threads while some are `spare`.
#[must_use]
pub fn analyse_run_on(
    spare: &SpareThreads,
    joint_count: usize,
    settings: &AnalysisSettings,
    measurements: &RunMeasurements,
) -> RunAnalysis {
    let points: Vec<FrictionPoint> = measurements.friction_points.iter().map(|of| of.point).collect();
    let rmsd_by_joint = measurements.rmsd_by_joint();
    let summary = |joint| JointSummary {
        relative_noise: median(&measurements.noise_of(joint)),
        torque_rms: median(&measurements.torque_of(joint)),
        ..summary(joint, settings, &measurements.friction_points, &rmsd_by_joint)
    };
    RunAnalysis {
        warm_up_fits: warm_up_fits_on(spare, &points),
        statistics: measurements
            .by_parameter()
            .iter()
            .flat_map(|(id, values)| parameter_statistics(*id, values))
            .collect(),
        summaries: (0..joint_count).map(JointIndex::new).map(summary).collect(),
    }
}

/// Warm-up curves of the given friction points: one for each joint and speed with enough of them. Points of several
/// runs are consecutive: the next run begins where time decreases.
#[must_use]
pub fn warm_up_fits(points: &[FrictionPoint]) -> Vec<WarmUpFit> {
    warm_up_fits_on(&SpareThreads::default(), points)
}

/// Same as [`warm_up_fits`], on more threads while some are `spare`.
#[must_use]
pub fn warm_up_fits_on(spare: &SpareThreads, points: &[FrictionPoint]) -> Vec<WarmUpFit> {
    let mut keys: Vec<(JointIndex, f64)> = points.iter().map(|p| (p.joint, p.speed_fraction)).collect();
    keys.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    keys.dedup();
    let fits = spare.each(keys.len(), || (), |(), key| warm_up_fit(points, keys[key]));
    fits.into_iter().flatten().collect()
}

fn warm_up_fit(points: &[FrictionPoint], (joint, speed_fraction): (JointIndex, f64)) -> Option<WarmUpFit> {
    // a constant difference of the directions is no scatter in time
    let half = 0.5 * direction_difference(points, joint, speed_fraction);
    let curve = |half: f64| -> Vec<WarmUpPoint> {
        let (mut run, mut before) = (0, f64::NEG_INFINITY);
        at_level(points, joint, speed_fraction)
            .map(|p| {
                run += usize::from(p.time < before - SAME_PASS_S);
                before = p.time;
                let torque = p.torque.abs() - half * f64::from(p.direction);
                WarmUpPoint { run, minute: p.time / 60.0, torque }
            })
            .collect()
    };
    let fit = fit_warm_up(joint, speed_fraction, &curve(half)).ok()?;
    Some(WarmUpFit { rmsd: warm_up_rmsd(&fit, &curve(0.0)), ..fit })
}

fn summary(
    joint: JointIndex,
    settings: &AnalysisSettings,
    points: &[CyclePoint],
    rmsd_by_joint: &[(JointIndex, ByCycle)],
) -> JointSummary {
    let rmsd: Vec<f64> = rmsd_by_joint
        .iter()
        .filter(|(of, _)| *of == joint)
        .flat_map(|(_, values)| values.iter().map(|(_, value)| *value))
        .collect();
    JointSummary {
        joint,
        warm_friction: warm_friction(joint, settings, points),
        excitation_friction: None,
        half_speed_friction: None,
        friction_index: None,
        relative_rmsd: median(&rmsd),
        rmsd_swing: swing(&rmsd),
        relative_noise: None,
        torque_rms: None,
    }
}

/// Friction over the last third of the cycles at the level nearest to the reference speed: the mean
/// over both directions, so that a torque offset cancels.
fn warm_friction(
    joint: JointIndex,
    settings: &AnalysisSettings,
    points: &[CyclePoint],
) -> Option<WarmFriction> {
    let of_joint = || points.iter().filter(|of| of.point.joint == joint);
    let levels = of_joint().map(|of| of.point.speed_fraction);
    let level = nearest_level(levels, settings.reference_speed_fraction)?;
    let last_cycle = of_joint().map(|of| of.cycle).max()?;
    let warm_from = last_cycle - last_cycle / 3;
    let warm: Vec<FrictionPoint> =
        of_joint().filter(|of| of.cycle >= warm_from.max(1)).map(|of| of.point).collect();
    let by_direction = |direction: i8| -> Vec<f64> {
        at_level(&warm, joint, level).filter(|p| p.direction == direction).map(|p| p.torque.abs()).collect()
    };
    let (up, down) = (by_direction(1), by_direction(-1));
    let means: Vec<f64> = [&up, &down].into_iter().filter_map(|values| mean(values)).collect();
    let minutes: Vec<f64> = at_level(&warm, joint, level).map(|p| p.time / 60.0).collect();
    let scatter = |values: &[f64]| standard_deviation(values).map(|sd| sd * sd / values.len() as f64);
    let variances: Vec<f64> = [&up, &down].into_iter().filter_map(|values| scatter(values)).collect();
    Some(WarmFriction {
        torque: mean(&means)?,
        std_error: variances.iter().sum::<f64>().sqrt() / means.len() as f64,
        minute: mean(&minutes)?,
        speed_fraction: level,
    })
}
