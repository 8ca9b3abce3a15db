//! One cycle of the test as a sequence of motions with their stage signals.
//!
//! Rest, excitation (Fourier series, then full speed over the range, or moves from point to point), friction joint by
//! joint and level by level, warming, rest; moves between them belong to no stage.

use super::blend::blend;
use super::excitation::fourier_excitation;
use super::motion::{MotionPiece, MotionState, PerJoint, Shuttle, state_at};
use super::points::PointToPoint;
use super::still_posture::still_posture;
use super::strokes::{RANGE_USE, full_speed, level_motion, middle_and_range, warming_shuttle};
use crate::error::SimulateError;
use armwatch_model::robot::{JointIndex, JointLimits, MAX_JOINTS, Robot};
use armwatch_model::run::{FrictionSignal, Stage};

/// Rest before and after the motions of a cycle, s.
pub(crate) const REST_S: f64 = 0.6;

/// Settings of a cycle, in addition to the robot itself.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanSettings {
    /// Duration of the warming stage, s; 0 omits it.
    pub warming_s: f64,
    /// Seed of random parts: the excitation of a robot whose description gives none, and random points.
    pub seed: u64,
    /// Speed levels of the friction stage, from 1; `None` for all of the description. An empty list omits the stage.
    pub levels: Option<Vec<u8>>,
    /// Parts of the excitation stage.
    pub excitation: ExcitationParts,
    /// Posture of the joints that hold still in the friction stage.
    pub posture: FrictionPosture,
    /// Rest at the end of the cycle, beyond the usual 0.6 s, s.
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

/// Parts of the excitation stage, in this order.
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
    /// The parts in the source.
    fn default() -> Self {
        Self { series: true, additional: true, points: None }
    }
}

/// Posture of the joints that hold still in the friction stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FrictionPosture {
    /// The posture at the start of a cycle.
    #[default]
    Home,
    /// A posture with a vertical axis of the moving joint, so that its gravity torque is constant; home if the arm has
    /// none.
    Still,
}

/// The motions of one cycle in their order.
#[derive(Debug, Clone, PartialEq)]
pub struct CyclePlan {
    /// Motions, each starting where and when the one before ends.
    pub segments: Vec<Segment>,
    /// Duration, s.
    pub duration: f64,
    /// Duration without the requested rest at its end, s.
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
    /// Speed of the motion as a part of the planned one.
    pub speed: f64,
}

impl Segment {
    /// State at time `t` within the cycle, s.
    pub fn state_at(&self, t: f64) -> MotionState {
        let mut state = state_at(&self.motion, self.own_time(t).clamp(0.0, self.duration * self.speed));
        state.velocity = state.velocity.map(|of| of * self.speed);
        state.acceleration = state.acceleration.map(|of| of * self.speed * self.speed);
        state
    }

    /// Time of the motion at time `t` within the cycle, s.
    pub fn own_time(&self, t: f64) -> f64 {
        (t - self.start) * self.speed
    }
}

/// Plans one cycle inside the limits of every joint.
///
/// # Errors
/// [`SimulateError::JointCount`], [`SimulateError::BadLimits`], [`SimulateError::NoSuchLevel`], those of the
/// description's own excitation, or [`SimulateError::NoBlend`] if its start cannot be reached from rest.
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
    /// The same motions at the part `speed` of their speeds, as a controller with an override drives them.
    #[must_use]
    pub fn at_speed(mut self, speed: f64) -> Self {
        for segment in &mut self.segments {
            segment.start /= speed;
            segment.duration /= speed;
            segment.speed *= speed;
        }
        Self { duration: self.duration / speed, working_s: self.working_s / speed, ..self }
    }

    /// State at time `t` within the cycle, s: that of its start before it, that of its end behind it.
    pub fn state_at(&self, t: f64) -> MotionState {
        let at = self.segments.partition_point(|segment| segment.start <= t).saturating_sub(1);
        self.segments.get(at).map_or_else(MotionState::default, |segment| segment.state_at(t))
    }
}

/// The posture for the friction test of `joint`; the joint itself is at the lower end of its travel.
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

/// Number and fraction of the top speed of each chosen level, in the order of the description.
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

struct Builder<'a> {
    robot: &'a Robot,
    segments: Vec<Segment>,
    clock: f64,
    state: MotionState,
}

impl Builder<'_> {
    fn push(&mut self, stage: Stage, signal: Option<FrictionSignal>, duration: f64, motion: MotionPiece) {
        self.state = state_at(&motion, duration);
        self.segments.push(Segment { start: self.clock, duration, stage, signal, motion, speed: 1.0 });
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
            // the approach belongs to the excitation if it continues from the series
            let approach = if parts.series { Stage::Excitation } else { Stage::Between };
            self.shuttle(shuttles, approach, Stage::Excitation)?;
        }
        match &parts.points {
            Some(points) => self.points(points, seed),
            None => Ok(()),
        }
    }

    /// To each point and a rest there; the move to the first point belongs to no stage.
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

    /// Each joint alone through these levels, the others still.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::strokes::PLATEAU_MIN_S;
    use crate::test_arms::er3a;
    use crate::test_arms::{er3a_with_excitation, nine_joints, one_joint};

    /// Step of central differences, s; their error is of the order of the step squared times the third derivative, and
    /// of first order at the kinks of the acceleration.
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
            // the published excitation has its own jerk
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
    fn an_override_drives_the_same_motions_slower() {
        for robot in arms() {
            let [plan, slow] = [plan(&robot, 20.0), plan(&robot, 20.0).at_speed(0.5)];
            assert!((slow.duration / plan.duration - 2.0).abs() < 1e-12);
            for k in 0..500 {
                let t = plan.duration * f64::from(k) / 500.0;
                let [usual, state] = [plan.state_at(t), slow.state_at(2.0 * t)];
                for j in 0..robot.joint_count() {
                    assert!((state.position[j] - usual.position[j]).abs() < 1e-9);
                    assert!((2.0 * state.velocity[j] - usual.velocity[j]).abs() < 1e-9);
                    assert!((4.0 * state.acceleration[j] - usual.acceleration[j]).abs() < 1e-9);
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
