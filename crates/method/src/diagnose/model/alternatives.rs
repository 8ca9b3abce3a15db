//! Alternative descriptions with one typical mistake corrected, and the improvement of the torque fit: a doubt with a
//! remedy.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;

use super::description::{DescriptionTest, JudgedRows, NumberScore};
use super::numbers::{DescribedNumber, PlaceNumber, set_standard};
use super::readings::MOUNTING;
use armwatch_model::robot::{
    DhParameters, GeometrySource, JointGeometry, JointIndex, JointKind, Robot, Transform,
};

/// Number of instants for the comparison of alternatives, enough to find the best one.
const INSTANTS: usize = 250;
/// Largest part of the squares that may remain with a tilted base for the tilt to be kept.
const TILTED: f64 = 0.97;
/// Smallest ratio of the residuals of a likely and an unlikely change for the unlikely one to win.
const HARDLY_MORE: f64 = 1.15;
/// Number of single numbers that are tried with the change that fits the torques.
const NUMBERS_TRIED: usize = 4;
/// Number of parabolas in the search for a number.
const PARABOLAS: usize = 3;
/// Shortest length, m, whose sign may be wrong.
const LEAST_LENGTH: f64 = 0.02;

/// Alternative description that explains the torques better.
#[derive(Debug, Clone, PartialEq)]
pub struct DescriptionAlternative {
    /// Difference from the description, to be read after "with".
    pub words: String,
    /// Residual sum of squares, relative to that of the description.
    pub residual_ratio: f64,
    /// Torque error of each joint that the alternative removes `[n]`, RMS, relative to the joint's whole error.
    pub gained: Vec<f64>,
    /// Torque error of each joint that remains `[n]`, in the same unit.
    pub left: Vec<f64>,
    /// True for another value of one number, false for a mistake of sign, convention or mounting.
    pub is_number: bool,
    /// True if the number is the scale of one joint's torque.
    pub is_gain: bool,
    /// Tilt of the base, rad; zero for any other change.
    pub tilt: f64,
}

/// Candidate description.
struct Tried {
    words: String,
    robot: Robot,
    gains: Vec<f64>,
    residual: f64,
    is_number: bool,
    is_gain: bool,
}

/// Descriptions that explain the torques better: a tilted base, and one further change.
#[derive(Debug, Clone, Default)]
pub struct Alternatives {
    /// Base tilted by a small angle, if that explains a part.
    pub tilt: Option<DescriptionAlternative>,
    /// Change of one item of the description that leaves the smallest residual.
    pub change: Option<DescriptionAlternative>,
}

/// Tilt of the base, and the change of one item of the description that, in addition to it, leaves the least of the
/// torques unexplained. Floors are rarely level, and a tilt resembles wrong angles, lengths and scales.
///
/// `test` has the numbers with their best-fitting values, the most significant first.
#[must_use]
pub fn alternatives(robot: &Robot, judged_rows: &JudgedRows<'_>, test: &DescriptionTest) -> Alternatives {
    let judged_rows = &judged_rows.thinned(INSTANTS);
    let gains = vec![1.0; robot.joint_count()];
    let judged = |(words, robot): (String, Robot)| {
        let residual = judged_rows.residual(&robot, &gains);
        Tried { words, robot, gains: gains.clone(), residual, is_number: false, is_gain: false }
    };
    let described = judged((String::new(), robot.clone()));
    let tilted = tilted(robot, test)
        .map(|(other, tilt)| (judged(other), tilt))
        .filter(|(tried, _)| tried.residual < TILTED * described.residual);
    let base = tilted.as_ref().map_or(&described, |(tried, _)| tried);
    let numbers = test.scores.iter().take(NUMBERS_TRIED);
    let numbers = numbers.filter_map(|score| settled(&base.robot, judged_rows, base.residual, score));
    let least = |one: &Tried, other: &Tried| one.residual.total_cmp(&other.residual);
    let mounted = mountings(&base.robot).into_iter().map(judged).min_by(least);
    let other = mistakes(&base.robot).into_iter().map(judged).chain(numbers).min_by(least);
    // of two changes that explain equally much, gravity is more likely wrong
    let least = match (mounted, other) {
        (Some(mounted), Some(other)) if other.residual * HARDLY_MORE < mounted.residual => Some(other),
        (None, other) => other,
        (mounted, _) => mounted,
    };
    let change = least.map(|tried| compared(judged_rows, base, &tried, 0.0));
    let tilt = tilted.as_ref().map(|(tried, tilt)| compared(judged_rows, &described, tried, *tilt));
    Alternatives { tilt, change }
}

fn compared(
    judged_rows: &JudgedRows<'_>,
    before: &Tried,
    after: &Tried,
    tilt: f64,
) -> DescriptionAlternative {
    let [squares, left] = [before, after].map(|of| judged_rows.residual_by_joint(&of.robot, &of.gains));
    DescriptionAlternative {
        words: after.words.clone(),
        residual_ratio: after.residual / before.residual,
        gained: squares.iter().zip(&left).map(|(before, after)| (before - after).max(0.0).sqrt()).collect(),
        left: left.iter().map(|square| square.sqrt()).collect(),
        is_number: after.is_number,
        is_gain: after.is_gain,
        tilt,
    }
}

/// Base with the tilt that fits the torques.
fn tilted(robot: &Robot, test: &DescriptionTest) -> Option<((String, Robot), f64)> {
    let g = robot.gravity.norm();
    let towards = (robot.gravity + test.gravity_change).try_normalize(f64::MIN_POSITIVE)?;
    let tilt = robot.gravity.angle(&towards);
    let gravity = g * towards;
    let words = format!("{} (the base tilted by {:.1} deg)", gravity_text(&gravity), tilt.to_degrees());
    (tilt > 0.0 && tilt < MOUNTING).then(|| ((words, Robot { gravity, ..robot.clone() }), tilt))
}

/// Text of the description's key for gravity.
pub(super) fn gravity_text(gravity: &Vector3<f64>) -> String {
    // adding 0 turns a negative zero, printed as -0.00, into a positive one
    let g = gravity.map(|x| (100.0 * x).round() / 100.0).add_scalar(0.0);
    format!("gravity_m_s2 = [{:.2}, {:.2}, {:.2}]", g.x, g.y, g.z)
}

/// Changes of a description that correct mistakes of sign, convention or zero.
pub(super) fn mistakes(robot: &Robot) -> Vec<(String, Robot)> {
    let mut found: Vec<(String, Robot)> = other_convention(robot).into_iter().collect();
    for (joint, described) in robot.joint_indices().zip(&robot.joints) {
        let j = joint.index();
        found.extend(turned_lengths(robot, joint));
        if let Some(row) = described.geometry.dh_row().filter(|row| row.alpha.sin().abs() > 1e-3) {
            let number = DescribedNumber::Place(joint, super::numbers::PlaceNumber::Alpha);
            let words = format!(
                "alpha_deg of joint {joint} = {:.0} in place of {:.0}",
                -row.alpha.to_degrees(),
                row.alpha.to_degrees()
            );
            found.push((words, number.changed(robot, -2.0 * row.alpha)));
        }
        if described.kind == JointKind::Revolute {
            for turn in [FRAC_PI_2, -FRAC_PI_2, PI] {
                let words = format!("the zero of joint {joint} turned by {:.0} deg", turn.to_degrees());
                let placement = described.geometry.placement().then(&Transform::about_z(turn));
                found.push((words, with_placements(robot, j, placement, None)));
            }
        }
        // the joint's axis reversed: everything it carries keeps its place
        let over = Transform::about_x(PI);
        let placement = described.geometry.placement().then(&over);
        let next = robot.joints.get(j + 1).map(|next| over.then(next.geometry.placement()));
        let words = format!(
            "joint {joint} turning the other way (signs of its position, velocity and torque, or its alpha_deg)"
        );
        found.push((words, with_placements(robot, j, placement, next)));
    }
    found
}

/// Lengths of a joint's placement, each with the opposite sign.
fn turned_lengths(robot: &Robot, joint: JointIndex) -> impl Iterator<Item = (String, Robot)> + '_ {
    let lengths: &[PlaceNumber] = match robot.joints[joint.index()].geometry.source() {
        GeometrySource::Urdf(_) => &[PlaceNumber::Origin(0), PlaceNumber::Origin(1), PlaceNumber::Origin(2)],
        _ => &[PlaceNumber::A, PlaceNumber::D],
    };
    lengths.iter().filter_map(move |&length| {
        let number = DescribedNumber::Place(joint, length);
        let change = -2.0 * number.value(robot).filter(|value| value.abs() > LEAST_LENGTH)?;
        Some((words(robot, number, change), number.changed(robot, change)))
    })
}

fn other_convention(robot: &Robot) -> Option<(String, Robot)> {
    let rows: Option<Vec<DhParameters>> = robot.joints.iter().map(|joint| joint.geometry.dh_row()).collect();
    let rows = rows?;
    let mut other = robot.clone();
    let name = match robot.joints.first()?.geometry.source() {
        GeometrySource::ModifiedDh(_) => {
            set_standard(&mut other, &rows);
            "standard_dh"
        }
        _ => {
            let places = rows.iter().map(|row| JointGeometry::modified_dh(*row));
            other.joints.iter_mut().zip(places).for_each(|(joint, place)| joint.geometry = place);
            "modified_dh"
        }
    };
    Some((format!("convention = \"{name}\""), other))
}

fn mountings(robot: &Robot) -> Vec<(String, Robot)> {
    let g = robot.gravity.norm();
    let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
    axes.into_iter()
        .flat_map(|axis| [g * axis, -g * axis])
        .filter(|gravity| (gravity - robot.gravity).norm() > 0.1 * g)
        .map(|gravity| {
            let words = format!("{} (how the arm is mounted)", gravity_text(&gravity));
            (words, Robot { gravity, ..robot.clone() })
        })
        .collect()
}

/// Robot with another placement of a joint, and of the next one if given.
fn with_placements(robot: &Robot, joint: usize, placement: Transform, next: Option<Transform>) -> Robot {
    let mut other = robot.clone();
    let moved = |geometry: &JointGeometry, placement: Transform| {
        let xyz = placement.translation.into();
        let origin = match *geometry.source() {
            GeometrySource::Urdf(origin) => origin,
            _ => armwatch_model::robot::UrdfOrigin { xyz, rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] },
        };
        JointGeometry::urdf(placement, origin)
    };
    other.joints[joint].geometry = moved(&robot.joints[joint].geometry, placement);
    if let Some(next) = next {
        other.joints[joint + 1].geometry = moved(&robot.joints[joint + 1].geometry, next);
    }
    other
}

/// Changes one number to the value that fits the torques, by parabolas through three residuals.
fn settled(
    robot: &Robot,
    judged_rows: &JudgedRows<'_>,
    described: f64,
    score: &NumberScore,
) -> Option<Tried> {
    if score.number == DescribedNumber::TorqueDelay {
        return None;
    }
    let gains = |change: f64| {
        let mut gains = vec![1.0; robot.joint_count()];
        if let DescribedNumber::TorqueGain(joint) = score.number {
            gains[joint.index()] += change;
        }
        gains
    };
    let at = |change: f64| judged_rows.residual(&score.number.changed(robot, change), &gains(change));
    let (change, residual) = lowest(at, described, score.change);
    // a wrong sign shows as friction that drives; as a scale it would only decouple a joint from the others' inertias
    let turned = matches!(score.number, DescribedNumber::TorqueGain(_)) && 1.0 + change <= 0.0;
    (!turned).then(|| Tried {
        words: words(robot, score.number, change),
        robot: score.number.changed(robot, change),
        gains: gains(change),
        residual,
        is_number: true,
        is_gain: matches!(score.number, DescribedNumber::TorqueGain(_)),
    })
}

/// Change of a number with the smallest squares, and these squares. The first parabola passes through the squares
/// without the change, with the given `change` and with twice that; later ones pass through the smallest and its
/// neighbours.
pub(super) fn lowest(at: impl Fn(f64) -> f64, described: f64, change: f64) -> (f64, f64) {
    let mut known = vec![(0.0, described), (change, at(change)), (2.0 * change, at(2.0 * change))];
    for _parabola in 0..PARABOLAS {
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(least) = (0..known.len()).min_by(|&a, &b| known[a].1.total_cmp(&known[b].1)) else { break };
        let first = least.saturating_sub(1).min(known.len() - 3);
        let [(a, at_a), (b, at_b), (c, at_c)] = [known[first], known[first + 1], known[first + 2]];
        let (left, right) = ((at_b - at_a) / (b - a), (at_c - at_b) / (c - b));
        let bend = (right - left) / (c - a);
        // beyond the outermost point, by at most the distance between the outer points
        let lowest = 0.5 * (a + b - left / bend);
        let next = match bend > 0.0 {
            true => lowest.clamp(2.0 * a - c, 2.0 * c - a),
            false if at_a < at_c => 2.0 * a - c,
            false => 2.0 * c - a,
        };
        if known.iter().any(|(change, _)| *change == next) || !next.is_finite() {
            break;
        }
        known.push((next, at(next)));
    }
    known.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0.0, described))
}

/// Number with its described value and the value that fits the torques.
pub(super) fn words(robot: &Robot, number: DescribedNumber, change: f64) -> String {
    let (scale, unit) = if number.is_angle() { (180.0 / PI, " deg") } else { (1.0, "") };
    let sentence = match number.value(robot) {
        Some(value) => {
            format!("{number} = {:.3}{unit} in place of {:.3}{unit}", scale * (value + change), scale * value)
        }
        None => format!("{number} turned by {:.1}{unit}", scale * change),
    };
    sentence + &time_text(robot, number, change).unwrap_or_default()
}

/// Hint at a clock with the wrong rate, which makes gravity appear larger or smaller: accelerations scale with the
/// square of time, gravity does not.
fn time_text(robot: &Robot, number: DescribedNumber, change: f64) -> Option<String> {
    let DescribedNumber::Gravity(axis) = number else { return None };
    let described = robot.gravity[axis];
    let factor = (described / (described + change)).sqrt();
    let alone = described.abs() > 0.9 * robot.gravity.norm();
    (alone && factor.is_finite()).then(|| format!(" (or a clock that counts {factor:.2} s for every second)"))
}
