//! Assignment of torques to joints, their signs, the mounting of the arm and its lengths: decided together, by the fit
//! of all joints.
//!
//! A joint's own fit cannot decide: it contains the noise of its torque but not the errors of its model, and a wrong
//! mounting resembles a wrong sign there. The finding is the single change that explains most of the torques of all
//! joints.

use std::f64::consts::FRAC_PI_4;

use nalgebra::Vector3;

use super::alternatives::{lowest, mistakes, words};
use super::change::ModelChange;
use super::channels::{COARSE_INSTANTS, Channels, FitErrors};
use super::joint_fit::JointFit;
use super::level::{BaseTilt, INSTANTS};
use super::readings::{ChannelReading, MOUNTING, ReadingComparison, across, turned_about};
use crate::least_squares::factor::TriangularFactor;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{JointIndex, Robot};

/// Largest mean weighted square that may remain after a scale of one torque: own fits leave about 1, ripple slightly
/// more.
const WELL: f64 = 10.0;
/// Largest part of the misfit that may remain after a change that is the cause. Fits of single joints leave less than
/// any change, so no change is tried if the description leaves at most 1.5 times their squares.
const CAUSE: f64 = 2.0 / 3.0;
/// Smallest error of a joint's own fit, relative to its RMS torque, for a torque that may be another joint's.
const FOREIGN: f64 = 0.2;
/// Largest ratio of the misfits after and before a change of one more joint for that joint to count.
const ONE_MORE: f64 = 0.9;
/// Factor on the misfit of a changed number of the description, because channels and the mounting are more likely
/// causes.
const HARDLY_MORE: f64 = 1.15;
/// Smallest mean weighted square that a wrong number of the description must cost: 3 % of a torque whose error is the
/// smallest.
const COST: f64 = 2.25;
/// Number of single numbers that are optimised.
const NUMBERS_TRIED: usize = 4;
/// Number of changes that are optimised with their own tilt.
const SETTLED: usize = 5;
/// Scales of a torque to try, evenly spaced in their logarithm.
const SCALES: [f64; 8] = [0.01, 0.03, 0.1, 0.3, 3.0, 10.0, 30.0, 100.0];
/// Number of sweeps over the scales of all torques.
const SCALE_SWEEPS: usize = 3;
/// Smallest factor of another unit or gear: gains of catalogues are accurate to some ten per cent.
const OTHER_UNIT: f64 = 1.5;
/// Largest ratio of misfits of an arm that explains the torques equally well: ripple that depends on the posture
/// resembles gravity.
const AS_WELL: f64 = 2.0;
/// Smallest step, rad, of the search for directions of gravity.
const LEAST_STEP: f64 = 0.05;
/// Largest ratio of the misfit with gravity along an axis, or half-way between two, to that with the best direction.
const ROUNDED: f64 = 1.3;

/// Findings about signs, order, mounting or a length, if one change explains the torques of all joints. `level`
/// receives the tilt of the base if it was estimated.
pub(crate) fn assign(channels: &Channels<'_>, level: &mut Option<BaseTilt>) -> Vec<Finding> {
    let fits = channels.own_fits();
    if fits.iter().all(Option::is_none) || channels.excitation.is_empty() {
        return Vec::new();
    }
    let bounds = channels.bounds(channels.robot, channels.kept_columns);
    let described = channels.stored_fit(&fits, &bounds).misfit(|_| 1.0);
    let least: f64 = fits.iter().flatten().map(|of| of.misfit).sum();
    let foreign = fits.iter().flatten().any(|of| of.relative > FOREIGN);
    if CAUSE * described <= least && !foreign {
        return Vec::new();
    }
    let Some(level) = BaseTilt::of(channels).map(|found| &*level.insert(found)) else { return Vec::new() };
    if CAUSE * level.misfit <= level.own_misfit && !level.is_foreign(FOREIGN) {
        return Vec::new();
    }
    match likeliest(channels, level) {
        Some((change, misfit)) if misfit <= CAUSE * level.misfit => change.findings(misfit / level.misfit),
        _ => Vec::new(),
    }
}

/// Change with the smallest squares, and these squares.
fn likeliest(channels: &Channels<'_>, level: &BaseTilt) -> Option<(ModelChange, f64)> {
    let compared = level.compared(channels);
    let coarse = compared.thinned(COARSE_INSTANTS);
    let count = (compared.rows.len() * channels.robot.joint_count()) as f64;
    let mut changes = channel_changes(channels, &compared);
    changes.extend(channel_changes(&compared.channels, &compared));
    changes.extend(described_changes(&coarse, &level.reading));
    // first with the present tilt, because most changes are far from the best
    let mut tried: Vec<(f64, ModelChange)> =
        changes.into_iter().map(|change| (coarse.misfit(&change.reading(level.robot())), change)).collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    tried.truncate(SETTLED);
    let settle = |(_, change)| settled(&compared, &coarse, level, change);
    let mut found: Vec<(ModelChange, f64)> = tried.into_iter().map(settle).collect();
    // a scale decouples a joint from the inertias of the others, and so explains part of any error
    let is_scale =
        |change: &ModelChange| matches!(change, ModelChange::Scaled(..) | ModelChange::Rescaled(_));
    found.retain(|(change, misfit)| !is_scale(change) || *misfit <= WELL * count);
    // a length without an effect on the torque is no cause
    let costs = |misfit: f64| level.misfit - misfit >= COST * compared.rows.len() as f64;
    found.retain(|(change, misfit)| !matches!(change, ModelChange::Described(..)) || costs(*misfit));
    if channels.robot.gravity.norm() > 0.0 {
        found.extend(mounted(&compared, &coarse, level));
        let weightless = compared.misfit(&ModelChange::Weightless.reading(channels.robot));
        found.push((ModelChange::Weightless, weightless));
    }
    let price = |(change, misfit): &(ModelChange, f64)| match change {
        ModelChange::Described(..) => HARDLY_MORE * misfit,
        ModelChange::Rescaled(scales) => misfit * ONE_MORE.powi(-(scales.len() as i32)),
        _ => *misfit,
    };
    found.into_iter().min_by(|a, b| price(a).total_cmp(&price(b)))
}

/// Findings of reversed signs. The candidates are joints that friction would drive; a finding needs a better fit of the
/// arm with their torques reversed. The friction is independent evidence, so a smaller gain is enough.
pub(crate) fn turned_by_friction(
    channels: &Channels<'_>,
    level: &BaseTilt,
    findings: &[Finding],
) -> Vec<Finding> {
    let drives =
        |of: &&Finding| of.kind == FindingKind::NegativeFriction && of.severity == FindingSeverity::Refuse;
    let joints: Vec<usize> =
        findings.iter().filter(drives).filter_map(|of| of.joint).map(JointIndex::index).collect();
    if joints.is_empty() {
        return Vec::new();
    }
    let compared = level.compared(channels);
    let coarse = compared.thinned(COARSE_INSTANTS);
    let (change, misfit) = settled(&compared, &coarse, level, ModelChange::Turned(joints));
    if misfit <= ONE_MORE * level.misfit { change.findings(misfit / level.misfit) } else { Vec::new() }
}

/// Change with its best tilt and scale, and the squares that remain.
fn settled(
    compared: &ReadingComparison<'_>,
    coarse: &ReadingComparison<'_>,
    level: &BaseTilt,
    change: ModelChange,
) -> (ModelChange, f64) {
    let (mut reading, left) = coarse.levelled(&change.reading(level.robot()), &level.described);
    let ModelChange::Scaled(joint, scale) = change else {
        let misfit = compared.misfit(&reading);
        return (change, misfit);
    };
    let at = |change: f64| {
        let mut tried = reading.clone();
        tried.scales[joint] = scale * change.exp();
        coarse.misfit(&tried)
    };
    // the tilt was optimised with the scale of the first search
    let (change, _) = lowest(at, left, 0.05);
    let scale = scale * change.exp();
    reading.scales[joint] = scale;
    let (reading, _) = coarse.levelled(&reading, &level.described);
    (ModelChange::Scaled(joint, scale), compared.misfit(&reading))
}

/// Best change of signs, of order and of one scale, for the gravity of the `channels`.
fn channel_changes(channels: &Channels<'_>, compared: &ReadingComparison<'_>) -> Vec<ModelChange> {
    let n = channels.robot.joint_count();
    let factors = channels.factors(&compared.rows);
    let errors = channels.errors(&factors);
    let bounds = channels.bounds(channels.robot, channels.kept_columns);
    let as_recorded: Vec<usize> = (0..n).collect();
    let fit = channels.ordered_fit(&factors, &compared.sigma, &as_recorded, &vec![1.0; n], &bounds);
    let judged = (channels, &factors[..], &compared.sigma[..], &bounds[..]);
    let scales = [scaled(judged), rescaled(judged)].into_iter().flatten();
    turned(&fit, n).into_iter().chain(swapped(judged, &errors)).chain(scales).collect()
}

/// Channels, factors, errors of the torques, bounds.
type AssignmentCase<'a> = (&'a Channels<'a>, &'a [TriangularFactor], &'a [f64], &'a [Vec<f64>]);

/// Set of reversed torques that explains most; a further joint counts only if it explains much more.
fn turned(fit: &JointFit, n: usize) -> Option<ModelChange> {
    let sign = |set: u32, joint: usize| if set & (1 << joint) == 0 { 1.0 } else { -1.0 };
    let price = |set: u32| fit.misfit(|joint| sign(set, joint)) * ONE_MORE.powi(-(set.count_ones() as i32));
    let best = (1..1_u32 << n).min_by(|&a, &b| price(a).total_cmp(&price(b)))?;
    Some(ModelChange::Turned((0..n).filter(|j| best & (1 << j) != 0).collect()))
}

/// Swap of two torques that explains most, among those that the other joint's columns explain better.
fn swapped(
    (channels, factors, sigma, bounds): AssignmentCase<'_>,
    errors: &FitErrors,
) -> Option<ModelChange> {
    let n = factors.len();
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    let judged = pairs.filter(|&(a, b)| errors.are_swapped(a, b)).map(|(a, b)| {
        let mut order: Vec<usize> = (0..n).collect();
        order.swap(a, b);
        let fit = channels.ordered_fit(factors, sigma, &order, &vec![1.0; n], bounds);
        (ModelChange::Swapped(a, b), fit.misfit(|_| 1.0))
    });
    judged.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(change, _)| change)
}

/// Scale of one torque that explains most, if it is large enough for another unit.
fn scaled(judged: AssignmentCase<'_>) -> Option<ModelChange> {
    let n = judged.1.len();
    let tried = (0..n).map(|joint| (joint, best_scale(judged, &vec![1.0; n], joint)));
    let (joint, (scale, _)) = tried.min_by(|a, b| a.1.1.total_cmp(&b.1.1))?;
    is_other_unit(scale).then_some(ModelChange::Scaled(joint, scale))
}

/// Scales of all torques relative to their median, if several are large enough for other units.
fn rescaled(judged: AssignmentCase<'_>) -> Option<ModelChange> {
    let n = judged.1.len();
    let (mut scales, mut least) = (vec![1.0; n], f64::INFINITY);
    for _sweep in 0..SCALE_SWEEPS {
        let before = least;
        for joint in 0..n {
            (scales[joint], least) = best_scale(judged, &scales, joint);
        }
        if least > 0.99 * before {
            break;
        }
    }
    // a common factor of all torques changes only the parameters
    let mut sorted = scales.clone();
    sorted.sort_unstable_by(f64::total_cmp);
    let common = sorted[n / 2];
    scales.iter_mut().for_each(|scale| *scale /= common);
    (scales.iter().filter(|scale| is_other_unit(**scale)).count() > 1)
        .then_some(ModelChange::Rescaled(scales))
}

/// Scale of one torque with the smallest squares for given scales of the others, and these squares.
fn best_scale(
    (channels, factors, sigma, bounds): AssignmentCase<'_>,
    scales: &[f64],
    joint: usize,
) -> (f64, f64) {
    let order: Vec<usize> = (0..factors.len()).collect();
    let misfit = |scale: f64| {
        let mut scales = scales.to_vec();
        scales[joint] = scale;
        channels.ordered_fit(factors, sigma, &order, &scales, bounds).misfit(|_| 1.0)
    };
    let own = scales[joint];
    let tried = SCALES.iter().map(|factor| own * factor).map(|scale| (scale, misfit(scale)));
    let least = |best: (f64, f64), tried: (f64, f64)| if tried.1 < best.1 { tried } else { best };
    let (mut scale, mut left) = tried.fold((own, misfit(own)), least);
    let mut step = SCALES[1] / SCALES[0];
    while step > 1.01 {
        step = step.sqrt();
        for tried in [scale * step, scale / step] {
            (scale, left) = least((scale, left), (tried, misfit(tried)));
        }
    }
    (scale, left)
}

fn is_other_unit(scale: f64) -> bool {
    scale.max(1.0 / scale) > OTHER_UNIT
}

/// Mistake in a description with the smallest squares, and the best change of one number.
fn described_changes(compared: &ReadingComparison<'_>, level: &ChannelReading) -> Vec<ModelChange> {
    let robot = &level.robot;
    let misfit = |robot: &Robot| compared.misfit(&ChannelReading::of(robot));
    let least = |a: &(f64, ModelChange), b: &(f64, ModelChange)| a.0.total_cmp(&b.0);
    let mistaken = mistakes(robot)
        .into_iter()
        .map(|(words, other)| (misfit(&other), ModelChange::Described(words, Box::new(other))));
    let described = misfit(robot);
    let numbers = compared.asked_for(level).into_iter().take(NUMBERS_TRIED).map(|(number, change)| {
        let (change, left) = lowest(|change| misfit(&number.changed(robot, change)), described, change);
        let other = Box::new(number.changed(robot, change));
        (left, ModelChange::Described(words(robot, number, change), other))
    });
    [mistaken.min_by(least), numbers.min_by(least)].into_iter().flatten().map(|(_, change)| change).collect()
}

/// Best direction of gravity, if it is another mounting.
fn mounted(
    compared: &ReadingComparison<'_>,
    coarse: &ReadingComparison<'_>,
    level: &BaseTilt,
) -> Option<(ModelChange, f64)> {
    let described = level.described;
    let reading = |gravity: Vector3<f64>| ModelChange::Mounted(gravity).reading(level.robot());
    let misfit = |gravity: &Vector3<f64>| coarse.misfit(&reading(*gravity));
    let grid = directions().into_iter().map(|towards| described.norm() * towards);
    let rounded = grid.map(|gravity| (misfit(&gravity), gravity)).min_by(|a, b| a.0.total_cmp(&b.0))?.1;
    let (mut best, mut least, mut step) = (rounded, misfit(&rounded), 0.5 * FRAC_PI_4);
    while step > LEAST_STEP {
        let side = best.cross(&across(&best)).normalize();
        let axes = [side, best.cross(&side)];
        let near = axes.iter().flat_map(|axis| [step, -step].map(|angle| turned_about(axis, angle) * best));
        let nearest = near.map(|towards| (towards, misfit(&towards))).min_by(|a, b| a.1.total_cmp(&b.1));
        match nearest {
            Some((towards, found)) if found < least => (best, least) = (towards, found),
            _ => step *= 0.5,
        }
    }
    let (settled, _) = coarse.levelled(&reading(best), &best);
    let least = compared.misfit(&settled);
    let at_rounded = compared.misfit(&reading(rounded));
    let (gravity, found) = match at_rounded <= ROUNDED * least {
        true => (rounded, at_rounded),
        false => (settled.robot.gravity, least),
    };
    // first moments that turn with gravity may make a tilted floor resemble a wall
    let is_floor = level.misfit <= ROUNDED * least;
    (described.angle(&gravity) > MOUNTING && !is_floor).then_some((ModelChange::Mounted(gravity), found))
}

/// Returns true if an arm without gravity explains the torques as well as the description.
pub(crate) fn is_weightless(channels: &Channels<'_>) -> bool {
    let rows = channels.rows(INSTANTS);
    let sigma = channels.errors(&channels.factors(&rows)).least();
    let compared = ReadingComparison::new(*channels, rows, sigma);
    let [described, weightless] =
        [ChannelReading::of(channels.robot), ModelChange::Weightless.reading(channels.robot)]
            .map(|reading| compared.misfit(&reading));
    weightless <= AS_WELL * described
}

/// Axes of the base and directions half-way between two of them, 18 in all.
fn directions() -> Vec<Vector3<f64>> {
    let steps = [-1.0, 0.0, 1.0];
    let all =
        steps.iter().flat_map(|&x| steps.iter().flat_map(move |&y| steps.map(|z| Vector3::new(x, y, z))));
    all.filter(|of| (1.0..2.5).contains(&of.norm_squared())).map(|of| of.normalize()).collect()
}
