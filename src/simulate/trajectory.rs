//! One cycle of the test as a sequence of motions with their stage signals.
//!
//! Rest, excitation (Fourier series, then full speed over the range, or moves from point to point), friction joint by
//! joint and level by level, warming, rest; moves between them belong to no stage.

use std::f64::consts::TAU;

use super::error::SimulateError;
use super::excitation::fourier_excitation;
use super::motion::{
    MotionPiece, MotionState, PerJoint, Plateaus, RAMP_EDGE, Shuttle, Stroke, quintic, state_at,
};
use super::points::PointToPoint;
use super::still_posture::still_posture;
use crate::robot::{Joint, JointIndex, JointLimits, MAX_JOINTS, Robot};
use crate::run::{FrictionSignal, Stage};

/// Part of the position range that strokes over the whole range use.
const RANGE_USE: f64 = 0.985;
/// Part of the largest acceleration and speed that full-speed motions use.
const FULL_USE: f64 = 0.985;
/// Part of the largest speed and acceleration that moves between stages use.
const MOVE_USE: f64 = 0.9;
/// Shortest move, s; also the shortest ramp of a slow level is a third of it.
const MOVE_MIN_S: f64 = 0.3;
/// Durations tried for a move, each a fifth longer: the last is 30 times the first, and beyond that
/// a start speed only carries further out.
const BLEND_TRIES: usize = 20;
/// Rest before and after the motions of a cycle, s.
const REST_S: f64 = 0.6;
/// Longest way of the full-speed trajectory, s: a joint of many turns needs no more.
const FULL_SPEED_STROKE_S: f64 = 2.5;
/// Intended and longest duration of a friction level, s.
const LEVEL_S: [f64; 2] = [3.6, 5.0];
/// Part of the largest acceleration for ramps that have room.
const GENTLE_RAMP: f64 = 0.7;
/// A plateau shorter than this is lengthened by steeper ramps, s.
const PLATEAU_SHORT_S: f64 = 0.35;
/// Shortest plateau, s: five rows at 50 Hz. A joint whose range is too short for it runs slower.
const PLATEAU_MIN_S: f64 = 0.1;
/// Part of range and of speed of the warming stage.
const WARMING_RANGE: f64 = 0.8;
const WARMING_SPEED: f64 = 0.8;

/// What shapes a cycle, beyond the robot itself.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanSettings {
    /// Duration of the warming stage, s; 0 leaves it out.
    pub warming_s: f64,
    /// Seed of what is random: the excitation of a robot whose description gives none, and drawn points.
    pub seed: u64,
    /// Speed levels of the friction stage, from 1; all of the description if `None`. Without any there is no such stage.
    pub levels: Option<Vec<u8>>,
    /// What the excitation stage is made of.
    pub excitation: ExcitationParts,
    /// Posture of the joints that hold still in the friction stage.
    pub posture: FrictionPosture,
    /// Rest at the end of the cycle, beyond the usual half second, s.
    pub rest_s: f64,
}

impl Default for PlanSettings {
    /// The cycle of the source without warming.
    fn default() -> Self {
        Self {
            warming_s: 0.0,
            seed: 1,
            levels: None,
            excitation: ExcitationParts::default(),
            posture: FrictionPosture::Home,
            rest_s: 0.0,
        }
    }
}

/// What the excitation stage is made of, in this order.
#[derive(Debug, Clone, PartialEq)]
pub struct ExcitationParts {
    /// A period of the Fourier series [4.19-4.21].
    pub series: bool,
    /// Every joint over its range near full speed [4.22-4.24].
    pub additional: bool,
    /// Moves from point to point.
    pub points: Option<PointToPoint>,
}

impl Default for ExcitationParts {
    /// As the source has it.
    fn default() -> Self {
        Self { series: true, additional: true, points: None }
    }
}

/// Posture of the joints that hold still in the friction stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrictionPosture {
    /// That of the start of a cycle.
    #[default]
    Home,
    /// One in which the axis of the joint that moves is vertical, so that its gravity torque stays as it is; home where
    /// the arm has none.
    Still,
}

/// The motions of one cycle in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct CyclePlan {
    /// Motions, each starting where and when the one before ends.
    pub segments: Vec<Segment>,
    /// Duration, s.
    pub duration: f64,
    /// Duration without the rest that was asked for at its end, s.
    pub working_s: f64,
}

/// A motion with the signals that the controller shows during it.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    /// Start within the cycle, s.
    pub start: f64,
    /// Duration, s.
    pub duration: f64,
    /// Stage signal.
    pub stage: Stage,
    /// Joint and level during the friction stage.
    pub signal: Option<FrictionSignal>,
    /// The motion, in its own time from 0.
    pub motion: MotionPiece,
}

impl Segment {
    /// State at time `t` within the cycle, s.
    #[must_use]
    pub fn state_at(&self, t: f64) -> MotionState {
        state_at(&self.motion, (t - self.start).clamp(0.0, self.duration))
    }
}

/// Plans one cycle inside the limits of every joint.
///
/// # Errors
/// [`SimulateError::JointCount`], [`SimulateError::BadLimits`], [`SimulateError::NoSuchLevel`], those of the description's
/// own excitation, or [`SimulateError::NoBlend`] if its start cannot be reached from rest.
pub fn plan_cycle(robot: &Robot, settings: &PlanSettings) -> Result<CyclePlan, SimulateError> {
    check_robot(robot)?;
    let levels = chosen_levels(robot, settings.levels.as_deref())?;
    let mut plan = Builder { robot, segments: Vec::new(), clock: 0.0, state: home(robot) };
    plan.rest(REST_S);
    plan.excitation(&settings.excitation, settings.seed)?;
    plan.friction(&levels, settings.posture)?;
    plan.warming(settings.warming_s)?;
    plan.move_to(&home(robot), Stage::Between)?;
    plan.rest(REST_S);
    let working_s = plan.clock;
    if settings.rest_s > 0.0 {
        plan.rest(settings.rest_s);
    }
    Ok(CyclePlan { duration: plan.clock, working_s, segments: plan.segments })
}

impl CyclePlan {
    /// State at time `t` within the cycle, s: that of its start before it, that of its end behind it.
    #[must_use]
    pub fn state_at(&self, t: f64) -> MotionState {
        let at = self.segments.partition_point(|segment| segment.start <= t).saturating_sub(1);
        self.segments.get(at).map_or_else(MotionState::default, |segment| segment.state_at(t))
    }
}

/// The posture in which `joint` is tested for friction; the joint itself stands at the lower end of its way.
#[must_use]
pub fn friction_posture(robot: &Robot, joint: JointIndex, posture: FrictionPosture) -> PerJoint {
    let home = home(robot).position;
    let mut held = match posture {
        FrictionPosture::Home => home,
        FrictionPosture::Still => still_posture(robot, joint, &home).unwrap_or(home),
    };
    let (middle, range) = middle_and_range(&robot.joints[joint.index()].limits);
    held[joint.index()] = middle - 0.5 * RANGE_USE * range;
    held
}

/// Number and part of the top speed of each chosen level, in the order of the description.
fn chosen_levels(robot: &Robot, chosen: Option<&[u8]>) -> Result<Vec<(u8, f64)>, SimulateError> {
    let all: Vec<(u8, f64)> = (1..=u8::MAX).zip(robot.speed_levels.iter().copied()).collect();
    let is_known = |level: &u8| all.iter().any(|(known, _)| known == level);
    match chosen {
        None => Ok(all),
        Some(chosen) => match chosen.iter().find(|level| !is_known(level)) {
            Some(&level) => Err(SimulateError::NoSuchLevel { level, levels: all.len() }),
            None => Ok(all.into_iter().filter(|(level, _)| chosen.contains(level)).collect()),
        },
    }
}

fn check_robot(robot: &Robot) -> Result<(), SimulateError> {
    let n = robot.joint_count();
    if n == 0 || n > MAX_JOINTS {
        return Err(SimulateError::JointCount { joints: n });
    }
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let JointLimits { position_min, position_max, velocity, acceleration, jerk } = joint.limits;
        let finite = [position_min, position_max, velocity, acceleration].iter().all(|x| x.is_finite());
        let jerk_is_positive = jerk.is_none_or(|jerk| jerk > 0.0);
        if !(finite
            && position_min < position_max
            && velocity > 0.0
            && acceleration > 0.0
            && jerk_is_positive)
        {
            return Err(SimulateError::BadLimits { joint: index });
        }
    }
    Ok(())
}

/// Rest at zero, or as near to zero as the middle 90 % of each joint's range allows.
fn home(robot: &Robot) -> MotionState {
    let mut posture = [0.0; MAX_JOINTS];
    for (q, joint) in posture.iter_mut().zip(&robot.joints) {
        let (middle, range) = middle_and_range(&joint.limits);
        *q = 0.0_f64.clamp(middle - 0.45 * range, middle + 0.45 * range);
    }
    MotionState::at_rest(posture)
}

fn middle_and_range(limits: &JointLimits) -> (f64, f64) {
    (0.5 * (limits.position_min + limits.position_max), limits.position_max - limits.position_min)
}

struct Builder<'a> {
    robot: &'a Robot,
    segments: Vec<Segment>,
    clock: f64,
    state: MotionState,
}

impl Builder<'_> {
    fn push(&mut self, stage: Stage, signal: Option<FrictionSignal>, duration: f64, motion: MotionPiece) {
        self.state = state_at(&motion, duration);
        self.segments.push(Segment { start: self.clock, duration, stage, signal, motion });
        self.clock += duration;
    }

    fn rest(&mut self, duration: f64) {
        self.push(Stage::Between, None, duration, MotionPiece::Hold(self.state.position));
    }

    fn move_to(&mut self, target: &MotionState, stage: Stage) -> Result<(), SimulateError> {
        let (duration, motion) = blend(self.robot, &self.state, target)?;
        self.push(stage, None, duration, motion);
        Ok(())
    }

    /// One period of the Fourier series, then every joint over its range near full speed, then moves between points.
    fn excitation(&mut self, parts: &ExcitationParts, seed: u64) -> Result<(), SimulateError> {
        if parts.series {
            let series = fourier_excitation(self.robot, seed)?;
            let period = 1.0 / series.base_frequency;
            let motion = MotionPiece::Fourier(series);
            self.move_to(&state_at(&motion, 0.0), Stage::Between)?;
            self.push(Stage::Excitation, None, period, motion);
        }
        if parts.additional {
            let joints = self.robot.joints.iter().enumerate();
            let shuttles: Vec<Shuttle> = joints.map(|(j, joint)| full_speed(joint, j % 2 == 1)).collect();
            // the way there belongs to the excitation where it goes on from the series
            let approach = if parts.series { Stage::Excitation } else { Stage::Between };
            self.shuttle(shuttles, approach, Stage::Excitation)?;
        }
        match &parts.points {
            Some(points) => self.points(points, seed),
            None => Ok(()),
        }
    }

    /// To each point and a rest there; the way to the first belongs to no stage.
    fn points(&mut self, points: &PointToPoint, seed: u64) -> Result<(), SimulateError> {
        let mut stage = Stage::Between;
        for posture in points.postures(self.robot, seed)? {
            self.move_to(&MotionState::at_rest(posture), stage)?;
            stage = Stage::Excitation;
            if points.dead_s > 0.0 {
                self.push(stage, None, points.dead_s, MotionPiece::Hold(posture));
            }
        }
        Ok(())
    }

    /// Each joint alone through these levels, the others held.
    fn friction(&mut self, levels: &[(u8, f64)], held: FrictionPosture) -> Result<(), SimulateError> {
        let robot = self.robot;
        if levels.is_empty() {
            return Ok(());
        }
        for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
            let posture = friction_posture(robot, index, held);
            self.move_to(&MotionState::at_rest(posture), Stage::Between)?;
            for &(level, fraction) in levels {
                let plateaus = level_motion(joint, index, posture, fraction);
                let signal = FrictionSignal { joint: index, level };
                self.push(
                    Stage::Friction,
                    Some(signal),
                    plateaus.duration(),
                    MotionPiece::Plateaus(plateaus),
                );
            }
        }
        Ok(())
    }

    fn warming(&mut self, warming_s: f64) -> Result<(), SimulateError> {
        if warming_s <= 0.0 {
            return Ok(());
        }
        let shuttles: Vec<Shuttle> =
            self.robot.joints.iter().map(|j| warming_shuttle(j, warming_s)).collect();
        self.move_to(&shuttle_start(&shuttles), Stage::Between)?;
        self.push(Stage::Warming, None, warming_s, MotionPiece::Shuttle(shuttles));
        Ok(())
    }

    fn shuttle(
        &mut self,
        shuttles: Vec<Shuttle>,
        approach: Stage,
        stage: Stage,
    ) -> Result<(), SimulateError> {
        self.move_to(&shuttle_start(&shuttles), approach)?;
        let duration = shuttles.iter().map(|s| f64::from(s.strokes) * s.stroke_s).fold(0.0, f64::max);
        self.push(stage, None, duration, MotionPiece::Shuttle(shuttles));
        Ok(())
    }
}

fn shuttle_start(shuttles: &[Shuttle]) -> MotionState {
    let mut posture: PerJoint = [0.0; MAX_JOINTS];
    for (q, shuttle) in posture.iter_mut().zip(shuttles) {
        *q = shuttle.start;
    }
    MotionState::at_rest(posture)
}

/// The shortest polynomial between two states that keeps inside all limits.
fn blend(robot: &Robot, from: &MotionState, to: &MotionState) -> Result<(f64, MotionPiece), SimulateError> {
    // Peaks of the rest-to-rest polynomial: 15/8 D/T, 10/sqrt(3) D/T² and 60 D/T³.
    let mut duration = robot.joints.iter().enumerate().fold(MOVE_MIN_S, |longest, (j, joint)| {
        let distance = (to.position[j] - from.position[j]).abs();
        let by_speed = 1.875 * distance / (MOVE_USE * joint.limits.velocity);
        let by_acceleration =
            (10.0 / 3.0_f64.sqrt() * distance / (MOVE_USE * joint.limits.acceleration)).sqrt();
        let by_jerk = joint.limits.jerk.map_or(0.0, |jerk| (60.0 * distance / (MOVE_USE * jerk)).cbrt());
        longest.max(by_speed).max(by_acceleration).max(by_jerk)
    });
    let mut blocked = JointIndex::new(0);
    for _ in 0..BLEND_TRIES {
        let motion = quintic(from, to, robot.joint_count(), duration);
        match first_outside(robot, &motion, duration) {
            None => return Ok((duration, motion)),
            Some(joint) => blocked = joint,
        }
        duration *= 1.2;
    }
    Err(SimulateError::NoBlend { joint: blocked })
}

fn first_outside(robot: &Robot, motion: &MotionPiece, duration: f64) -> Option<JointIndex> {
    const STEPS: u32 = 100;
    let step = duration / f64::from(STEPS);
    let states: Vec<MotionState> = (0..=STEPS).map(|k| state_at(motion, step * f64::from(k))).collect();
    (0..states.len()).find_map(|k| {
        let (before, state) = (&states[k.saturating_sub(1)], &states[k]);
        robot.joint_indices().find(|index| {
            let (j, limits) = (index.index(), &robot.joints[index.index()].limits);
            let jerk = (state.acceleration[j] - before.acceleration[j]) / step;
            state.position[j] < limits.position_min
                || state.position[j] > limits.position_max
                || state.velocity[j].abs() > limits.velocity
                || state.acceleration[j].abs() > limits.acceleration
                || limits.jerk.is_some_and(|limit| jerk.abs() > limit)
        })
    })
}

/// Out and back over the range in the shortest time that limits allow [4.22-4.24]. Neighbours run
/// against each other, which tells their parameters apart.
fn full_speed(joint: &Joint, from_the_top: bool) -> Shuttle {
    let (middle, range) = middle_and_range(&joint.limits);
    let (speed, acceleration) = (FULL_USE * joint.limits.velocity, FULL_USE * joint.limits.acceleration);
    let jerk = usable_jerk(&joint.limits);
    let travel = (RANGE_USE * range).min(0.5 * speed * FULL_SPEED_STROKE_S);
    let direction = if from_the_top { -1.0 } else { 1.0 };
    Shuttle {
        start: middle - 0.5 * direction * travel,
        travel: direction * travel,
        stroke_s: cycloid_s(travel, speed, acceleration, jerk),
        strokes: 2,
    }
}

/// Shortest cycloid over `travel`: its peaks are `2 D/T`, `2 pi D/T²` [4.23, 4.24] and `4 pi² D/T³`.
fn cycloid_s(travel: f64, speed: f64, acceleration: f64, jerk: f64) -> f64 {
    let by_acceleration = (TAU * travel / acceleration).sqrt();
    (2.0 * travel / speed).max(by_acceleration).max((TAU * TAU * travel / jerk).cbrt())
}

/// Jerk that motions use; infinite for a joint without such a limit.
fn usable_jerk(limits: &JointLimits) -> f64 {
    limits.jerk.map_or(f64::INFINITY, |jerk| FULL_USE * jerk)
}

/// To and fro for exactly `warming_s` seconds; over less of the range if even one round trip over
/// it takes longer.
fn warming_shuttle(joint: &Joint, warming_s: f64) -> Shuttle {
    let (middle, range) = middle_and_range(&joint.limits);
    let (speed, acceleration) = (WARMING_SPEED * joint.limits.velocity, FULL_USE * joint.limits.acceleration);
    let (travel, jerk) = (WARMING_RANGE * range, usable_jerk(&joint.limits));
    let rounds = (warming_s / (2.0 * cycloid_s(travel, speed, acceleration, jerk))).floor().max(1.0);
    let stroke_s = 0.5 * warming_s / rounds;
    let reachable = (0.5 * speed * stroke_s)
        .min(acceleration * stroke_s * stroke_s / TAU)
        .min(jerk * stroke_s.powi(3) / (TAU * TAU));
    let travel = travel.min(reachable);
    Shuttle { start: middle - 0.5 * travel, travel, stroke_s, strokes: 2 * rounds as u32 }
}

/// The strokes of one friction level, from the posture upwards and back.
fn level_motion(joint: &Joint, index: JointIndex, posture: PerJoint, fraction: f64) -> Plateaus {
    let room = RANGE_USE * (joint.limits.position_max - joint.limits.position_min);
    let stroke = level_stroke(&joint.limits, room, fraction.clamp(1e-3, 1.0));
    let pairs = (LEVEL_S[1] / (2.0 * stroke.duration())).floor();
    let wanted = (LEVEL_S[0] / (2.0 * stroke.duration())).ceil();
    Plateaus { posture, joint: index.index(), stroke, strokes: 2 * pairs.min(wanted).max(1.0) as u32 }
}

fn level_stroke(limits: &JointLimits, room: f64, fraction: f64) -> Stroke {
    let speed = fraction * limits.velocity;
    // the jerk of a ramp's edge is speed / (edge (1 - edge) ramp²), with the edge as a part of the ramp
    let jerk = RAMP_EDGE * (1.0 - RAMP_EDGE) * usable_jerk(limits);
    let by_jerk = |speed: f64| (speed / jerk).sqrt();
    let ramp = |part: f64| {
        let by_acceleration = speed / ((1.0 - RAMP_EDGE) * part * limits.acceleration);
        by_acceleration.max(by_jerk(speed)).max(MOVE_MIN_S / 3.0)
    };
    let plateau = |ramp_s: f64| (room / speed - ramp_s).min(0.5 * LEVEL_S[0] - 2.0 * ramp_s);
    let gentle = ramp(GENTLE_RAMP);
    if plateau(gentle) >= PLATEAU_SHORT_S {
        return Stroke { speed, ramp_s: gentle, plateau_s: plateau(gentle) };
    }
    let steep = ramp(FULL_USE);
    let plateau_s = room / speed - steep;
    if plateau_s >= PLATEAU_MIN_S {
        return Stroke { speed, ramp_s: steep, plateau_s: plateau_s.min(PLATEAU_SHORT_S) };
    }
    // speed (plateau + speed / a) = room: as fast as the shortest plateau leaves room for.
    let a = (1.0 - RAMP_EDGE) * FULL_USE * limits.acceleration;
    let reachable = 0.5 * a * ((PLATEAU_MIN_S * PLATEAU_MIN_S + 4.0 * room / a).sqrt() - PLATEAU_MIN_S);
    // speed (plateau + sqrt(speed / jerk)) = room grows with the speed
    let mut speed = speed.min(reachable);
    while speed * (PLATEAU_MIN_S + by_jerk(speed)) > room {
        speed *= 0.99;
    }
    let ramp_s = (speed / a).max(by_jerk(speed));
    Stroke { speed, ramp_s, plateau_s: (room / speed - ramp_s).max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::test_arms::er3a;
    use crate::simulate::test_arms::{er3a_with_excitation, nine_joints, one_joint};

    /// Step of central differences, s; their error is of the order of the step squared times the
    /// third derivative, except at the kinks of the acceleration's slope, where it is of first order.
    const STEP_S: f64 = 1e-6;
    /// Positions of up to 10 rad divided by two steps leave 1e-9 rad/s of rounding; kinks of a
    /// jerk of 1000 rad/s³ leave 1e-9 rad/s, and 1e-3 rad/s² in the acceleration.
    const VELOCITY_TOLERANCE: f64 = 1e-7;
    const ACCELERATION_TOLERANCE: f64 = 5e-3;
    /// Rounding of states that are equal on paper.
    const ROUNDING: f64 = 1e-8;

    fn arms() -> [Robot; 4] {
        [er3a(), er3a_with_excitation(), one_joint(), nine_joints()]
    }

    fn plan(robot: &Robot, warming_s: f64) -> CyclePlan {
        plan_cycle(robot, &PlanSettings { warming_s, seed: 11, ..PlanSettings::default() }).unwrap()
    }

    fn stage_s(plan: &CyclePlan, stage: Stage) -> f64 {
        plan.segments.iter().filter(|s| s.stage == stage).map(|s| s.duration).sum()
    }

    #[test]
    fn motion_keeps_inside_all_limits() {
        for robot in arms() {
            let plan = plan(&robot, 20.0);
            for segment in &plan.segments {
                for k in 0..=2000 {
                    let state = state_at(&segment.motion, segment.duration * f64::from(k) / 2000.0);
                    for (j, joint) in robot.joints.iter().enumerate() {
                        let limits = &joint.limits;
                        assert!(state.position[j] >= limits.position_min - ROUNDING);
                        assert!(state.position[j] <= limits.position_max + ROUNDING);
                        assert!(state.velocity[j].abs() <= limits.velocity + ROUNDING);
                        assert!(state.acceleration[j].abs() <= limits.acceleration + ROUNDING);
                    }
                }
            }
        }
    }

    /// Differences of accelerations over a step are means of the jerk.
    #[test]
    fn motion_keeps_inside_limits_of_the_jerk() {
        for mut robot in arms() {
            for joint in &mut robot.joints {
                joint.limits.jerk = Some(4.0 * joint.limits.acceleration);
            }
            // the published excitation has a jerk of its own
            robot.excitation = None;
            for segment in &plan(&robot, 20.0).segments {
                let step = segment.duration / 2000.0;
                let states: Vec<MotionState> =
                    (0..=2000).map(|k| state_at(&segment.motion, step * f64::from(k))).collect();
                for pair in states.windows(2) {
                    for (j, joint) in robot.joints.iter().enumerate() {
                        let jerk = (pair[1].acceleration[j] - pair[0].acceleration[j]).abs() / step;
                        let limit = 4.0 * joint.limits.acceleration;
                        assert!(
                            jerk <= limit * (1.0 + 1e-6),
                            "joint {}: {jerk} {limit} {:?}",
                            j + 1,
                            segment.motion
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn each_motion_starts_where_the_one_before_ends() {
        for robot in arms() {
            let plan = plan(&robot, 20.0);
            let pairs = plan.segments.windows(2);
            for pair in pairs {
                assert!((pair[0].start + pair[0].duration - pair[1].start).abs() < ROUNDING);
                let end = state_at(&pair[0].motion, pair[0].duration);
                let start = state_at(&pair[1].motion, 0.0);
                for j in 0..robot.joint_count() {
                    assert!((end.position[j] - start.position[j]).abs() < ROUNDING);
                    assert!((end.velocity[j] - start.velocity[j]).abs() < ROUNDING);
                    assert!((end.acceleration[j] - start.acceleration[j]).abs() < ROUNDING * 100.0);
                }
            }
            let first = plan.segments[0].state_at(0.0);
            let last = plan.segments[plan.segments.len() - 1].state_at(plan.duration);
            for j in 0..robot.joint_count() {
                assert!((first.position[j] - last.position[j]).abs() < ROUNDING, "cycles must join");
            }
        }
    }

    #[test]
    fn velocity_and_acceleration_are_the_derivatives() {
        for robot in arms() {
            for segment in &plan(&robot, 20.0).segments {
                for k in 1..400 {
                    let t = segment.duration * f64::from(k) / 400.0;
                    let [before, now, after] =
                        [t - STEP_S, t, t + STEP_S].map(|t| state_at(&segment.motion, t));
                    for j in 0..robot.joint_count() {
                        let qd = (after.position[j] - before.position[j]) / (2.0 * STEP_S);
                        let qdd = (after.velocity[j] - before.velocity[j]) / (2.0 * STEP_S);
                        assert!((qd - now.velocity[j]).abs() < VELOCITY_TOLERANCE, "{:?}", segment.motion);
                        assert!(
                            (qdd - now.acceleration[j]).abs() < ACCELERATION_TOLERANCE,
                            "{:?}: {qdd} against {}",
                            segment.motion,
                            now.acceleration[j]
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn every_level_has_a_plateau_at_its_speed_in_both_directions() {
        for robot in arms() {
            let plan = plan(&robot, 0.0);
            let levels: Vec<&Segment> = plan.segments.iter().filter(|s| s.signal.is_some()).collect();
            assert_eq!(levels.len(), robot.joint_count() * robot.speed_levels.len());
            for segment in levels {
                let MotionPiece::Plateaus(plateaus) = segment.motion else { panic!("{:?}", segment.motion) };
                let signal = segment.signal.unwrap();
                let limit = robot.joints[signal.joint.index()].limits.velocity;
                let wanted = robot.speed_levels[usize::from(signal.level) - 1] * limit;
                assert!((plateaus.stroke.speed / wanted - 1.0).abs() < 1e-12, "{signal:?}");
                assert!(plateaus.stroke.plateau_s >= PLATEAU_MIN_S);
                assert!((2.0..=5.0).contains(&segment.duration), "{signal:?}: {} s", segment.duration);
                for direction in [-1, 1] {
                    let rows = (0..)
                        .map(|k| f64::from(k) / 50.0)
                        .take_while(|t| *t < segment.duration)
                        .filter(|t| plateaus.plateau_direction(*t) == Some(direction))
                        .inspect(|t| {
                            let velocity = state_at(&segment.motion, *t).velocity[signal.joint.index()];
                            assert!((velocity - f64::from(direction) * wanted).abs() < ROUNDING);
                        });
                    assert!(rows.count() >= 5, "{signal:?} has too few rows at 50 Hz");
                }
            }
        }
    }

    #[test]
    fn a_range_too_short_for_a_level_slows_it_down() {
        let limits = JointLimits {
            position_min: -0.2,
            position_max: 0.2,
            velocity: 4.0,
            acceleration: 8.0,
            jerk: None,
        };
        let room = RANGE_USE * 0.4;
        let stroke = level_stroke(&limits, room, 1.0);
        assert!(stroke.speed < 4.0 && (stroke.plateau_s - PLATEAU_MIN_S).abs() < 1e-12);
        assert!((stroke.travel() - room).abs() < 1e-12);
        assert!(stroke.peak_acceleration() <= 8.0);
    }

    #[test]
    fn the_excitation_comes_near_full_speed() {
        let robot = er3a_with_excitation();
        let plan = plan(&robot, 0.0);
        let mut fastest = [0.0_f64; 6];
        for segment in plan.segments.iter().filter(|s| s.stage == Stage::Excitation) {
            for k in 0..=1000 {
                let state = state_at(&segment.motion, segment.duration * f64::from(k) / 1000.0);
                for (j, f) in fastest.iter_mut().enumerate() {
                    *f = f.max(state.velocity[j].abs() / robot.joints[j].limits.velocity);
                }
            }
        }
        // Joint 3 has the shortest range for its speed.
        assert!(fastest.iter().all(|f| *f > 0.9), "{fastest:?}");
    }

    #[test]
    fn warming_lasts_as_asked_and_covers_the_range() {
        let robot = er3a();
        assert_eq!(stage_s(&plan(&robot, 0.0), Stage::Warming), 0.0);
        for warming_s in [1.0, 20.0, 180.0] {
            let plan = plan(&robot, warming_s);
            assert!((stage_s(&plan, Stage::Warming) - warming_s).abs() < 1e-12);
            let shuttles = plan.segments.iter().find_map(|s| match &s.motion {
                MotionPiece::Shuttle(shuttles) if s.stage == Stage::Warming => Some(shuttles.clone()),
                _ => None,
            });
            for (shuttle, joint) in shuttles.unwrap().iter().zip(&robot.joints) {
                let limits = &joint.limits;
                let part = shuttle.travel / (limits.position_max - limits.position_min);
                if warming_s > 10.0 {
                    assert!((part - 0.8).abs() < 1e-9);
                }
                assert!(2.0 * shuttle.travel / shuttle.stroke_s <= 0.8 * limits.velocity + ROUNDING);
            }
        }
    }

    #[test]
    fn a_check_has_the_chosen_levels_alone_with_their_numbers() {
        let robot = er3a();
        let settings =
            |levels: &[u8]| PlanSettings { levels: Some(levels.into()), ..PlanSettings::default() };
        let plan = plan_cycle(&robot, &settings(&[6, 3])).unwrap();
        let levels: Vec<u8> = plan.segments.iter().filter_map(|of| of.signal).map(|of| of.level).collect();
        assert_eq!(levels, [3, 6].repeat(6));
        let none = plan_cycle(&robot, &settings(&[])).unwrap();
        assert_eq!(stage_s(&none, Stage::Friction), 0.0);
        assert!(none.duration < plan.duration && plan.duration < 120.0, "{}", plan.duration);
        let message = plan_cycle(&robot, &settings(&[7])).unwrap_err().to_string();
        assert!(message.contains("level 7") && message.contains("1 to 6"), "{message}");
    }

    #[test]
    fn impossible_robots_are_refused() {
        let settings = PlanSettings::default();
        let mut none = er3a();
        none.joints.clear();
        assert!(matches!(plan_cycle(&none, &settings), Err(SimulateError::JointCount { joints: 0 })));
        let mut flat = er3a();
        flat.joints[2].limits.position_max = flat.joints[2].limits.position_min;
        let message = plan_cycle(&flat, &settings).unwrap_err().to_string();
        assert!(message.contains("joint 3"), "{message}");
    }
}
