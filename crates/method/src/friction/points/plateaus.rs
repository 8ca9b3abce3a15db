//! Friction on the constant-speed plateaus of the friction stage [5.2], with gravity removed [5.3].

use super::gravity::Gravity;
use super::plateau::{Plateau, SPEED_TOLERANCE};
use crate::model::dynamics::DynamicModel;
use crate::segment::cycles::ranges_where;
use crate::signal::filter::FilteredSignals;
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::{CarriedLoad, FrictionPoint};
use armwatch_model::robot::{JointIndex, LoadFriction, MAX_JOINTS, Robot};
use armwatch_model::run::{Samples, Stage};

/// Largest difference between thirds of a plateau, as a fraction of its speed. On a ramp through the tolerance band
/// they differ by more than a tenth. At a turning point inside the band, which thirds show and halves do not, they
/// differ by more than this unless the speed is practically constant.
const THIRDS_TOLERANCE: f64 = 0.025;

/// Shortest plateau, s. Shorter ones are ramps through a level.
const MIN_PLATEAU_S: f64 = 0.12;

/// Quantile of speed, among the rows of one level and direction, that is on the plateau: ramps and reversals are
/// slower, and overshoot is short.
const PLATEAU_QUANTILE: f64 = 0.7;

/// Smallest relative difference between measured and nominal speed of a level that a remark reports.
const NOMINAL_TOLERANCE: f64 = 0.15;

/// Steps of reduced speed in controllers, as a fraction. The speed of a stage is rounded to them, so that tests with
/// one override have the same levels.
const REDUCED_STEP: f64 = 0.05;

/// Largest relative difference between the reductions of a stage's levels.
const REDUCED_TOLERANCE: f64 = 0.04;

/// Relative difference below which two levels are the same speed.
const SAME_LEVEL: f64 = 0.02;

/// Largest speed of the joints that are not under test, as a fraction of their largest speed.
const STILL_FRACTION: f64 = 0.01;

/// Friction points of a cycle, and remarks about missing ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionPoints {
    /// At most one point for each joint, speed level and direction.
    pub points: Vec<FrictionPoint>,
    /// Remarks, such as levels without a plateau.
    pub remarks: Vec<String>,
}

/// Mean friction torque by joint, level and direction over the friction stage of one cycle.
///
/// The controller's signals assign rows to a joint and level if they were recorded, otherwise the motion does: one
/// joint moves, the others are at rest, and the speed is near a level. `model` removes gravity if the fit of [5.3]
/// cannot.
#[must_use]
pub fn friction_points(
    robot: &Robot,
    samples: &Samples,
    filtered: &FilteredSignals,
    model: Option<&DynamicModel>,
) -> FrictionPoints {
    let mut found = FrictionPoints::default();
    let mut untested = Vec::new();
    for joint in robot.joint_indices().filter(|joint| robot.joints[joint.index()].has_torque) {
        if !joint_points(robot, samples, filtered, model, joint, &mut found) {
            untested.push(joint);
        }
    }
    if samples.stage.contains(&Stage::Friction) {
        found.remarks.extend(untested_remark(robot, &untested));
    }
    found
}

/// Remark about joints that the friction stage does not test; each file may test one joint.
fn untested_remark(robot: &Robot, untested: &[JointIndex]) -> Option<String> {
    let listed = |joints: &mut dyn Iterator<Item = JointIndex>| -> String {
        joints.map(|joint| joint.to_string()).collect::<Vec<_>>().join(", ")
    };
    let s = |count: usize| if count == 1 { "" } else { "s" };
    let measured = |joint: &JointIndex| robot.joints[joint.index()].has_torque;
    let tested = robot.joint_indices().filter(measured).count() - untested.len();
    match (untested, tested) {
        ([], _) => None,
        ([joint], _) => Some(format!("joint {joint} does not move alone in the friction stage")),
        (_, 0) => Some("no joint moves alone in the friction stage".into()),
        (_, tested) => Some(format!(
            "the friction stage tests joint{} {} only; joints {} do not move alone in it",
            s(tested),
            listed(&mut robot.joint_indices().filter(measured).filter(|joint| !untested.contains(joint))),
            listed(&mut untested.iter().copied())
        )),
    }
}

/// Adds the points of one joint; returns `false` if it is not tested.
fn joint_points(
    robot: &Robot,
    samples: &Samples,
    filtered: &FilteredSignals,
    model: Option<&DynamicModel>,
    joint: JointIndex,
    found: &mut FrictionPoints,
) -> bool {
    let tested = tested_rows(robot, samples, filtered, joint);
    if tested.is_empty() {
        return false;
    }
    let mut remarks = Vec::new();
    let mut plateaus = plateaus(robot, samples, filtered, joint, &tested, &mut remarks);
    if plateaus.is_empty() && samples.friction_signal.is_none() {
        let passes = super::slow_passes::slow_passes(robot, filtered, joint, &tested);
        if !passes.is_empty() {
            remarks = vec![super::slow_passes::slow_remark(robot, joint, &passes)];
            plateaus = passes;
        }
    }
    found.remarks.extend(remarks);
    let gravity = Gravity::new(robot, filtered, model, joint, &tested);
    let mut unclear = Vec::new();
    for plateau in plateaus {
        let speed: Vec<f64> = plateau.rows.iter().map(|&row| filtered.qd[joint.index()][row].abs()).collect();
        let time: Vec<f64> = plateau.rows.iter().map(|&row| samples.time[row]).collect();
        let Some(freed) = gravity.remove(&plateau.rows) else {
            unclear.push(format!("{:.0} % {:+}", 100.0 * plateau.speed_fraction, plateau.direction));
            continue;
        };
        let (Some(speed), Some(time)) = (mean(&speed), mean(&time)) else { continue };
        found.points.push(FrictionPoint {
            joint,
            time,
            speed_fraction: plateau.speed_fraction,
            speed,
            direction: plateau.direction,
            torque: freed.torque,
            std: freed.std,
            samples: plateau.rows.len(),
            gravity: freed.how,
            load: model.and_then(|model| carried_load(robot, filtered, model, joint, &plateau.rows)),
        });
    }
    if !unclear.is_empty() {
        found.remarks.push(format!(
            "friction of joint {joint} left out at {}: its motion in the friction stage does not tell friction from the \
             load of gravity, and the cycle has no identified parameters; move it back and forth over the same travel",
            unclear.join(", ")
        ));
    }
    true
}

/// Mean load of a joint's gear in these rows, if its friction depends on the load.
fn carried_load(
    robot: &Robot,
    filtered: &FilteredSignals,
    model: &DynamicModel,
    joint: JointIndex,
    rows: &[usize],
) -> Option<CarriedLoad> {
    if robot.friction_of(joint).load == LoadFriction::None {
        return None;
    }
    let (n, j) = (robot.joint_count(), joint.index());
    let [mut q, mut qd, mut qdd, mut tau, mut load] = [[0.0; MAX_JOINTS]; 5];
    let (mut carried, mut lost) = (0.0, 0.0);
    for &row in rows {
        filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        model.gear_load(robot, &q[..n], &qd[..n], &qdd[..n], &mut load[..n]);
        carried += load[j].abs();
        lost += model.load_friction(robot, joint, load[j], qd[j]) * qd[j].signum();
    }
    let friction = if carried > 0.0 { lost / carried } else { 0.0 };
    Some(CarriedLoad { torque: carried / rows.len().max(1) as f64, friction })
}

/// Rows with `joint` under test.
fn tested_rows(
    robot: &Robot,
    samples: &Samples,
    filtered: &FilteredSignals,
    joint: JointIndex,
) -> Vec<usize> {
    let usable = filtered.usable.iter().flat_map(Clone::clone);
    let in_stage = usable.filter(|&row| samples.stage[row] == Stage::Friction);
    match &samples.friction_signal {
        Some(signal) => in_stage.filter(|&row| signal[row].is_some_and(|s| s.joint == joint)).collect(),
        None => in_stage.filter(|&row| moves_alone(robot, filtered, joint, row)).collect(),
    }
}

fn moves_alone(robot: &Robot, filtered: &FilteredSignals, joint: JointIndex, row: usize) -> bool {
    robot.joint_indices().all(|k| {
        let moves =
            filtered.qd[k.index()][row].abs() > STILL_FRACTION * robot.joints[k.index()].limits.velocity;
        moves == (k == joint)
    })
}

fn plateaus(
    robot: &Robot,
    samples: &Samples,
    filtered: &FilteredSignals,
    joint: JointIndex,
    tested: &[usize],
    remarks: &mut Vec<String>,
) -> Vec<Plateau> {
    let qd = &filtered.qd[joint.index()];
    let fastest = robot.joints[joint.index()].limits.velocity;
    let (mut plateaus, mut ratios, mut other_speeds) = (Vec::new(), Vec::new(), Vec::new());
    for (index, &speed_fraction) in robot.speed_levels.iter().enumerate() {
        let nominal = speed_fraction * fastest;
        let mut missing = Vec::new();
        for direction in [-1_i8, 1] {
            let along = |row: usize| qd[row] * f64::from(direction);
            let rows: Vec<usize> = match &samples.friction_signal {
                Some(signal) => tested
                    .iter()
                    .copied()
                    .filter(|&row| signal[row].is_some_and(|s| usize::from(s.level) == index + 1))
                    .filter(|&row| along(row) > 0.3 * nominal)
                    .collect(),
                None => tested.iter().copied().filter(|&row| along(row) > 0.0).collect(),
            };
            let speed = match samples.friction_signal {
                Some(_) => quantile(rows.iter().map(|&row| along(row)).collect(), PLATEAU_QUANTILE),
                None => Some(nominal),
            };
            let on_plateau =
                speed.map_or_else(Vec::new, |speed| constant_rows(filtered, &rows, along, speed));
            let Some(speed) = speed.filter(|_| !on_plateau.is_empty()) else {
                missing.push(format!("{direction:+}"));
                continue;
            };
            if (speed - nominal).abs() > NOMINAL_TOLERANCE * nominal {
                other_speeds.push(format!(
                    "joint {joint} moves at {speed:.3} rad/s on its {:.0} % level, {nominal:.3} rad/s by its description",
                    100.0 * speed_fraction
                ));
            }
            ratios.push(speed / nominal);
            plateaus.push(Plateau { speed_fraction, direction, rows: on_plateau });
        }
        if !missing.is_empty() {
            remarks.push(format!(
                "joint {joint} holds no constant speed at its {:.0} % level ({nominal:.3} rad/s), direction {}",
                100.0 * speed_fraction,
                missing.join(" and ")
            ));
        }
    }
    match reduced_speed(&ratios) {
        Some(reduced) => {
            for plateau in &mut plateaus {
                plateau.speed_fraction = level_at(&robot.speed_levels, reduced * plateau.speed_fraction);
            }
            remarks.push(format!(
                "joint {joint} moves at {:.0} % of the speeds of its description; its friction is compared at equal speed only",
                100.0 * reduced
            ));
        }
        None => remarks.extend(other_speeds),
    }
    plateaus
}

/// Speed of a test at reduced speed (override), as a part of the described speed, a multiple of [`REDUCED_STEP`].
/// `None` if the stage has the described speeds, or if its levels do not agree on another one.
fn reduced_speed(ratios: &[f64]) -> Option<f64> {
    let middle = median(ratios)?;
    let reduced = ((middle / REDUCED_STEP).round() * REDUCED_STEP).max(REDUCED_STEP);
    let agrees = |ratio: &f64| (ratio - middle).abs() <= REDUCED_TOLERANCE * middle;
    ((reduced - 1.0).abs() > 0.5 * REDUCED_STEP && ratios.iter().all(agrees)).then_some(reduced)
}

/// Level at `fraction` of the largest speed, within [`SAME_LEVEL`]; without one, `fraction` rounded to four digits.
fn level_at(levels: &[f64], fraction: f64) -> f64 {
    let same = levels.iter().copied().find(|level| (level - fraction).abs() <= SAME_LEVEL * level);
    same.unwrap_or((fraction * 1e4).round() / 1e4)
}

/// Rows of all plateaus at `speed` among `rows`, without their ends, because the low-passed torque still contains the
/// ramp there.
fn constant_rows(
    filtered: &FilteredSignals,
    rows: &[usize],
    along: impl Fn(usize) -> f64,
    speed: f64,
) -> Vec<usize> {
    let near = |i: usize| (along(rows[i]) - speed).abs() <= SPEED_TOLERANCE * speed;
    let margin = (0.5 * filtered.sample_rate / filtered.cutoff).ceil() as usize;
    let shortest = (MIN_PLATEAU_S * filtered.sample_rate).ceil().max(4.0) as usize;
    let mut found = Vec::new();
    for near_range in ranges_where(rows.len(), near) {
        for part in ranges_where(near_range.len(), |i| {
            let at = near_range.start + i;
            // neighbours in `rows` are neighbours in time unless a reversal separates them
            at == near_range.start || rows[at] == rows[at - 1] + 1
        }) {
            let part = near_range.start + part.start..near_range.start + part.end;
            let inner = part.start + margin..part.end.saturating_sub(margin);
            if inner.len() >= shortest && thirds_agree(&rows[inner.clone()], &along, speed) {
                found.extend_from_slice(&rows[inner]);
            }
        }
    }
    found
}

fn thirds_agree(rows: &[usize], along: impl Fn(usize) -> f64, speed: f64) -> bool {
    let mean = |rows: &[usize]| rows.iter().map(|&row| along(row)).sum::<f64>() / rows.len() as f64;
    let means: Vec<f64> = rows.chunks_exact(rows.len() / 3).take(3).map(mean).collect();
    let spread = means.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - means.iter().copied().fold(f64::INFINITY, f64::min);
    spread <= THIRDS_TOLERANCE * speed
}

fn quantile(mut values: Vec<f64>, fraction: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let (_, value, _) = values.select_nth_unstable_by((fraction * last as f64) as usize, f64::total_cmp);
    Some(*value)
}

#[cfg(test)]
pub(in crate::friction) mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::signal::filter::filter_signals;
    use armwatch_model::analysis::GravityRemoval;
    use armwatch_model::run::FrictionSignal;

    pub(in crate::friction) const RATE: f64 = 250.0;
    /// Tolerance of a mean over a second of noise-free torque: the remaining effect of the low-pass on the ramps.
    pub(in crate::friction) const TOLERANCE: f64 = 2e-3;

    /// First joint of the ER3A, with a vertical axis, or a horizontal one if `lying`.
    pub(in crate::friction) fn one_joint(lying: bool) -> Robot {
        let mut robot = armwatch_testing::er3a();
        robot.joints.truncate(1);
        if lying {
            robot.gravity = Vector3::new(9.81, 0.0, 0.0);
        }
        robot
    }

    /// Position, speed and acceleration of a motion back and forth at `speed`, with ramps of `acceleration` and `hold`
    /// seconds of constant speed in each direction.
    fn shuttle(speed: f64, acceleration: f64, hold: f64) -> Vec<[f64; 3]> {
        let ramp = speed / acceleration;
        let way = 2.0 * ramp + hold;
        let (mut rows, mut q) = (Vec::new(), -0.5 * speed * (hold + ramp));
        for row in 0..(2.0 * way * RATE) as usize {
            let t = row as f64 / RATE;
            let (sign, t) = if t < way { (1.0, t) } else { (-1.0, t - way) };
            let (v, a) = if t < ramp {
                (acceleration * t, acceleration)
            } else if t < ramp + hold {
                (speed, 0.0)
            } else {
                (acceleration * (way - t), -acceleration)
            };
            rows.push([q, sign * v, sign * a]);
            q += sign * v / RATE;
        }
        rows
    }

    pub(in crate::friction) fn friction(v: f64) -> f64 {
        2.0 * v.signum() + 3.0 * v
    }

    /// Friction stage through the given levels, with the torque of `load` added to friction.
    fn stage(robot: &Robot, levels: &[usize], signals: bool, load: impl Fn(f64) -> f64) -> Samples {
        let mut samples = Samples { position: vec![vec![]], torque: vec![vec![]], ..Samples::default() };
        let (mut velocity, mut signal) = (Vec::new(), Vec::new());
        for &level in levels {
            let speed = robot.speed_levels[level - 1] * robot.joints[0].limits.velocity;
            for [q, v, a] in shuttle(speed, 8.0, 0.6) {
                samples.time.push(samples.time.len() as f64 / RATE);
                samples.position[0].push(q);
                velocity.push(v);
                samples.torque[0].push(0.4 * a + friction(v) + load(q));
                samples.stage.push(Stage::Friction);
                let level = u8::try_from(level).expect("few levels");
                signal.push(Some(FrictionSignal { joint: JointIndex::new(0), level }));
            }
        }
        samples.velocity = Some(vec![velocity]);
        samples.friction_signal = signals.then_some(signal);
        samples
    }

    pub(in crate::friction) fn points(robot: &Robot, samples: &Samples) -> FrictionPoints {
        friction_points(robot, samples, &filter_signals(samples, 12.0).expect("conditions"), None)
    }

    fn assert_friction(robot: &Robot, found: &FrictionPoints, levels: &[usize]) {
        assert_eq!(found.points.len(), 2 * levels.len(), "{:?}", found.remarks);
        for point in &found.points {
            let truth = friction(point.speed);
            let along = point.torque * f64::from(point.direction);
            assert!((along - truth).abs() < TOLERANCE * truth, "{point:?} {truth}");
            let nominal = point.speed_fraction * robot.joints[0].limits.velocity;
            assert!((point.speed - nominal).abs() < TOLERANCE * nominal, "{point:?}");
        }
    }

    #[test]
    fn plateaus_give_friction_by_level_and_direction_with_signals_or_without() {
        let robot = one_joint(false);
        let levels = [2, 3, 4, 5, 6];
        for signals in [true, false] {
            let found = points(&robot, &stage(&robot, &levels, signals, |_| 0.0));
            assert_friction(&robot, &found, &levels);
            assert!(found.points.iter().all(|p| p.gravity == GravityRemoval::AxisVertical));
        }
    }

    /// The same programme at another override: friction belongs to the measured speed.
    #[test]
    fn a_stage_at_reduced_speed_has_the_levels_that_it_moves_at() {
        let robot = one_joint(false);
        let levels = [2, 3, 4, 5, 6];
        for (part, tolerance) in [(0.5, 0.0), (0.8, 0.01), (0.9, 0.0), (1.0, 0.02)] {
            let mut described = robot.clone();
            // the program gives levels by number; its speeds are a part of the described ones
            described.speed_levels =
                robot.speed_levels.iter().map(|level| level / (part * (1.0 + tolerance))).collect();
            let found = points(&described, &stage(&robot, &levels, true, |_| 0.0));
            assert_eq!(found.points.len(), 2 * levels.len(), "{part}: {:?}", found.remarks);
            for point in &found.points {
                let along = point.torque * f64::from(point.direction);
                assert!((along - friction(point.speed)).abs() < TOLERANCE * along, "{point:?}");
                let nominal = point.speed_fraction * robot.joints[0].limits.velocity;
                assert!((point.speed - nominal).abs() < 0.025 * nominal, "{part}: {point:?}");
            }
            let is_said = found.remarks.iter().any(|said| said.contains("of the speeds of its description"));
            assert_eq!(is_said, part < 1.0, "{:?}", found.remarks);
        }
    }

    #[test]
    fn the_load_of_gravity_is_fitted_and_taken_off() {
        let robot = one_joint(true);
        let levels = [2, 4, 6];
        let found = points(&robot, &stage(&robot, &levels, true, |q| 11.0 * q.cos() - 4.0 * q.sin()));
        assert_friction(&robot, &found, &levels);
        assert!(found.points.iter().all(|p| p.gravity == GravityRemoval::Fitted));
    }

    #[test]
    fn an_offset_of_the_torque_is_no_load() {
        let robot = one_joint(true);
        let load = |q: f64| 11.0 * q.cos() - 4.0 * q.sin() + 3.0;
        let found = points(&robot, &stage(&robot, &[2, 4, 6], true, load));
        let mean =
            |level: &[FrictionPoint]| level.iter().map(|of| of.torque).sum::<f64>() / level.len() as f64;
        let mut by_level = found.points.clone();
        by_level.sort_by(|a, b| a.speed_fraction.total_cmp(&b.speed_fraction));
        let offsets: Vec<f64> = by_level.chunks(2).map(mean).collect();
        assert!(offsets.len() == 3 && offsets.iter().all(|of| (of - 3.0).abs() < 0.03), "{offsets:?}");
    }

    #[test]
    fn levels_in_another_order_or_missing_are_told_apart() {
        let robot = one_joint(false);
        let found = points(&robot, &stage(&robot, &[6, 2, 4], false, |_| 0.0));
        assert_friction(&robot, &found, &[6, 2, 4]);
        let missing = found.remarks.iter().filter(|r| r.contains("holds no constant speed")).count();
        assert_eq!(missing, 3, "{:?}", found.remarks);
    }

    #[test]
    fn a_ramp_through_a_level_is_no_plateau() {
        let robot = one_joint(false);
        // 0.6 s in the band around 60 %, but never constant
        let mut samples = stage(&robot, &[6], false, |_| 0.0);
        let velocity: Vec<f64> =
            (0..samples.rows()).map(|row| 4.0 * row as f64 / samples.rows() as f64).collect();
        samples.velocity = Some(vec![velocity]);
        let found = points(&robot, &samples);
        assert_eq!(found.points, vec![], "{:?}", found.points);
    }

    #[test]
    fn a_joint_that_never_moves_alone_is_said() {
        let robot = one_joint(false);
        let mut samples = stage(&robot, &[2], false, |_| 0.0);
        samples.velocity = Some(vec![vec![0.0; samples.rows()]]);
        let found = points(&robot, &samples);
        assert!(found.points.is_empty() && found.remarks[0].contains("does not move alone"), "{found:?}");
    }
}
