//! Limits of a motion, its margins to them, and its breaches.

use std::fmt;

use nalgebra::DMatrix;

use super::series::{between_instants, jerk_at, state_at};
use armwatch_model::robot::{FourierExcitation, Joint, JointIndex, JointKind, Robot};

/// Instants per period for each harmonic at which a series is compared with its limits; its largest magnitude between
/// them is at most 1.2e-4 larger.
const INSTANTS_PER_HARMONIC: usize = 200;

/// Limits of one joint for a search: rad, rad/s, rad/s², rad/s³ (m).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionLimits {
    /// Smallest position.
    pub position_min: f64,
    /// Largest position.
    pub position_max: f64,
    /// Largest speed.
    pub velocity: f64,
    /// Largest acceleration.
    pub acceleration: f64,
    /// Largest jerk, if there is such a limit.
    pub jerk: Option<f64>,
}

/// Shares of a joint's limits that a search may use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shares {
    /// Share of the range, about its middle.
    pub position: f64,
    /// Share of the largest speed.
    pub velocity: f64,
    /// Share of the largest acceleration and the largest jerk.
    pub acceleration: f64,
}

impl MotionLimits {
    /// Limits as shares of those in the description.
    pub fn of(joint: &Joint, shares: &Shares) -> Self {
        let limits = &joint.limits;
        let middle = 0.5 * (limits.position_min + limits.position_max);
        let half = 0.5 * shares.position * (limits.position_max - limits.position_min);
        Self {
            position_min: middle - half,
            position_max: middle + half,
            velocity: shares.velocity * limits.velocity,
            acceleration: shares.acceleration * limits.acceleration,
            jerk: limits.jerk.map(|jerk| shares.acceleration * jerk),
        }
    }

    /// Middle of the range.
    pub fn middle(&self) -> f64 {
        0.5 * (self.position_min + self.position_max)
    }

    /// Half the range.
    pub fn half_range(&self) -> f64 {
        0.5 * (self.position_max - self.position_min)
    }
}

/// Limits of the torque of a known model.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueLimits {
    /// Base parameters `[b]`.
    pub parameters: Vec<f64>,
    /// Weights of the joints' torques in the torques for continuous duty, `[n x n]`, a row per torque: that of a joint,
    /// or that of its motor through its own gear.
    pub duty: DMatrix<f64>,
    /// Largest root mean square of these over the period, `[n]`, Nm (N).
    pub mean_square_root: Vec<Option<f64>>,
    /// Largest magnitude of the joints' torques, `[n]`, Nm (N).
    pub peak: Vec<Option<f64>>,
}

/// A value and its time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TimedValue {
    /// The value.
    pub value: f64,
    /// Time from the start, s.
    pub time: f64,
}

/// Extremes of a joint's motion over one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extremes {
    /// Lowest position, rad (m).
    pub low: TimedValue,
    /// Highest position.
    pub high: TimedValue,
    /// Velocity of the largest magnitude, rad/s (m/s).
    pub speed: TimedValue,
    /// Acceleration of the largest magnitude, rad/s² (m/s²).
    pub acceleration: TimedValue,
    /// Jerk of the largest magnitude, rad/s³ (m/s³).
    pub jerk: TimedValue,
    /// Number of instants that were checked.
    pub instants: usize,
}

/// Extremes of a joint's motion over one period of a series, among the checked instants.
///
/// # Panics
/// If the series has no such joint.
pub fn extremes(series: &FourierExcitation, joint: usize) -> Extremes {
    let own = FourierExcitation {
        base_frequency: series.base_frequency,
        a: vec![series.a[joint].clone()],
        b: vec![series.b[joint].clone()],
        centre: vec![series.centre[joint]],
    };
    let instants = INSTANTS_PER_HARMONIC * own.a[0].len().max(1);
    let states = (0..instants).map(|k| {
        let time = k as f64 / instants as f64 / series.base_frequency;
        (time, state_at(&own, time)[0], jerk_at(&own, 0, time))
    });
    let start = TimedValue { value: 0.0, time: 0.0 };
    let mut found = Extremes {
        low: TimedValue { value: f64::INFINITY, time: 0.0 },
        high: TimedValue { value: f64::NEG_INFINITY, time: 0.0 },
        speed: start,
        acceleration: start,
        jerk: start,
        instants,
    };
    for (time, [q, qd, qdd], jerk) in states {
        if q < found.low.value {
            found.low = TimedValue { value: q, time };
        }
        if q > found.high.value {
            found.high = TimedValue { value: q, time };
        }
        if qd.abs() > found.speed.value.abs() {
            found.speed = TimedValue { value: qd, time };
        }
        if qdd.abs() > found.acceleration.value.abs() {
            found.acceleration = TimedValue { value: qdd, time };
        }
        if jerk.abs() > found.jerk.value.abs() {
            found.jerk = TimedValue { value: jerk, time };
        }
    }
    found
}

/// A quantity that has a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limited {
    /// Lowest position.
    LowestPosition,
    /// Highest position.
    HighestPosition,
    /// Magnitude of the velocity.
    Speed,
    /// Magnitude of the acceleration.
    Acceleration,
    /// Magnitude of the jerk.
    Jerk,
}

impl Limited {
    /// Unit of its values.
    pub fn unit(self, kind: JointKind) -> &'static str {
        match (self, kind) {
            (Self::LowestPosition | Self::HighestPosition, JointKind::Revolute) => "rad",
            (Self::LowestPosition | Self::HighestPosition, JointKind::Prismatic) => "m",
            (Self::Speed, JointKind::Revolute) => "rad/s",
            (Self::Speed, JointKind::Prismatic) => "m/s",
            (Self::Acceleration, JointKind::Revolute) => "rad/s^2",
            (Self::Acceleration, JointKind::Prismatic) => "m/s^2",
            (Self::Jerk, JointKind::Revolute) => "rad/s^3",
            (Self::Jerk, JointKind::Prismatic) => "m/s^3",
        }
    }
}

impl fmt::Display for Limited {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::LowestPosition => "lowest position",
            Self::HighestPosition => "highest position",
            Self::Speed => "speed",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        })
    }
}

/// A broken limit of a motion, at its worst.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Breach {
    /// The joint.
    pub joint: JointIndex,
    /// The quantity.
    pub quantity: Limited,
    /// Time of the worst value, s.
    pub time: f64,
    /// Start of the breach, s.
    pub since: f64,
    /// The worst value: rad, rad/s, rad/s² (m).
    pub value: f64,
    /// The limit; the negative limit if the value is negative.
    pub limit: f64,
}

impl Breach {
    /// Excess over the limit, positive.
    pub fn excess(&self) -> f64 {
        (self.value - self.limit).abs()
    }
}

/// Limits of the arm that a series breaks, also between the checked instants.
pub fn broken_by_series(robot: &Robot, series: &FourierExcitation) -> Vec<Breach> {
    let mut breaches = Vec::new();
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let whole = Shares { position: 1.0, velocity: 1.0, acceleration: 1.0 };
        let limits = MotionLimits::of(joint, &whole);
        let found = extremes(series, index.index());
        let harmonics = series.a.get(index.index()).map_or(0, Vec::len);
        let margin = between_instants(harmonics, found.instants);
        let off_middle = |moment: TimedValue| TimedValue {
            value: limits.middle() + margin * (moment.value - limits.middle()),
            time: moment.time,
        };
        let widened = |moment: TimedValue| TimedValue { value: margin * moment.value, time: moment.time };
        let signed = |limit: f64, of: TimedValue| limit.copysign(of.value);
        let checks = [
            (Limited::LowestPosition, off_middle(found.low), limits.position_min, -1.0),
            (Limited::HighestPosition, off_middle(found.high), limits.position_max, 1.0),
            (Limited::Speed, widened(found.speed), signed(limits.velocity, found.speed), found.speed.value),
            (
                Limited::Acceleration,
                widened(found.acceleration),
                signed(limits.acceleration, found.acceleration),
                found.acceleration.value,
            ),
        ];
        let jerk = limits
            .jerk
            .map(|jerk| (Limited::Jerk, widened(found.jerk), signed(jerk, found.jerk), found.jerk.value));
        for (quantity, TimedValue { value, time }, limit, side) in checks.into_iter().chain(jerk) {
            // NaN counts as a breach too
            let inside = (value - limit) * side.signum() <= 0.0;
            if !inside {
                breaches.push(Breach { joint: index, quantity, time, since: time, value, limit });
            }
        }
    }
    breaches
}

/// A motion as samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledMotion {
    /// Times, s, rising.
    pub times: Vec<f64>,
    /// Positions of each joint `[n][rows]`, rad (m).
    pub positions: Vec<Vec<f64>>,
    /// Velocities, where given: rad/s (m/s).
    pub velocities: Option<Vec<Vec<f64>>>,
    /// Accelerations, where given: rad/s² (m/s²).
    pub accelerations: Option<Vec<Vec<f64>>>,
    /// Step of the last digit of positions, rad (m); 0 if they are exact.
    pub position_step: f64,
    /// Step of the last digit of velocities, rad/s (m/s).
    pub velocity_step: f64,
    /// Step of the last digit of accelerations, rad/s² (m/s²).
    pub acceleration_step: f64,
}

/// Result of checking a sampled motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampleCheck {
    /// Limits that are broken, by joint.
    pub breaches: Vec<Breach>,
    /// Joints and quantities for which the samples are too coarse, with the uncertainty of the derived values.
    pub unjudged: Vec<(JointIndex, Limited, f64)>,
    /// Largest used share of each joint's limits `[n]`: position about the middle, speed, acceleration, jerk. `None`
    /// for a quantity that is not checked or has no limit.
    pub used: Vec<[Option<f64>; 4]>,
}

/// Largest uncertainty of a derived value from rounding of samples, as a share of the limit.
const ROUNDING_SHARE: f64 = 0.02;
/// Largest rounding error of a position after an offset is subtracted and added again, rad (m).
const OFFSET_ROUNDING: f64 = 1e-12;
/// Longest interval of a derivative, s: a tenth of the period of a 2 Hz motion.
const LONGEST_INTERVAL_S: f64 = 0.05;

/// Compares samples with the limits of the arm. Missing velocities and accelerations are central differences, over
/// intervals so long that the rounding of the last digit has little effect.
///
/// # Panics
/// If there are fewer joints than the robot has or columns of another length than the times.
pub fn broken_by_samples(robot: &Robot, motion: &SampledMotion) -> SampleCheck {
    let mut check = SampleCheck::default();
    let whole = Shares { position: 1.0, velocity: 1.0, acceleration: 1.0 };
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let limits = MotionLimits::of(joint, &whole);
        let j = index.index();
        let positions = &motion.positions[j];
        let speeds = match &motion.velocities {
            Some(velocities) => Some(at_times(&motion.times, &velocities[j])),
            None => differences(&motion.times, positions, motion.position_step, limits.velocity),
        };
        let accelerations = match (&motion.accelerations, &motion.velocities) {
            (Some(accelerations), _) => Some(at_times(&motion.times, &accelerations[j])),
            (None, Some(velocities)) => {
                differences(&motion.times, &velocities[j], motion.velocity_step, limits.acceleration)
            }
            (None, None) => {
                second_differences(&motion.times, positions, motion.position_step, limits.acceleration)
            }
        };
        let own = at_times(&motion.times, positions);
        let below = |m: &TimedValue| limits.position_min - m.value - OFFSET_ROUNDING;
        let above = |m: &TimedValue| m.value - limits.position_max - OFFSET_ROUNDING;
        let jerks = limits.jerk.map(|limit| {
            let derived = match (&motion.accelerations, &motion.velocities) {
                (Some(accelerations), _) => {
                    differences(&motion.times, &accelerations[j], motion.acceleration_step, limit)
                }
                (None, Some(velocities)) => {
                    second_differences(&motion.times, &velocities[j], motion.velocity_step, limit)
                }
                // a third difference of rounded positions is meaningless
                (None, None) => None,
            };
            (Limited::Jerk, derived, limit)
        });
        check.breaches.extend(worst(index, Limited::LowestPosition, &own, below, |_| limits.position_min));
        check.breaches.extend(worst(index, Limited::HighestPosition, &own, above, |_| limits.position_max));
        let off_middle = own.iter().map(|m| (m.value - limits.middle()).abs()).fold(0.0, f64::max);
        let mut used = [Some(off_middle / limits.half_range()), None, None, None];
        let derived = [
            (Limited::Speed, speeds, limits.velocity),
            (Limited::Acceleration, accelerations, limits.acceleration),
        ];
        for (k, (quantity, values, limit)) in derived.into_iter().chain(jerks).enumerate() {
            let Some(values) = values else {
                check.unjudged.push((index, quantity, motion.position_step));
                continue;
            };
            check.breaches.extend(worst(
                index,
                quantity,
                &values,
                |m| m.value.abs() - limit,
                |m| limit.copysign(m.value),
            ));
            used[k + 1] = Some(values.iter().map(|m| m.value.abs()).fold(0.0, f64::max) / limit);
        }
        check.used.push(used);
    }
    check
}

fn at_times(times: &[f64], values: &[f64]) -> Vec<TimedValue> {
    times.iter().zip(values).map(|(&time, &value)| TimedValue { value, time }).collect()
}

/// The worst moment of a quantity, if it breaks its limit; `excess` is positive for a breach.
fn worst(
    joint: JointIndex,
    quantity: Limited,
    moments: &[TimedValue],
    excess: impl Fn(&TimedValue) -> f64,
    limit: impl Fn(&TimedValue) -> f64,
) -> Option<Breach> {
    let since = moments.iter().find(|m| excess(m) > 0.0 || m.value.is_nan())?.time;
    let worst = moments.iter().max_by(|a, b| excess(a).total_cmp(&excess(b)))?;
    Some(Breach { joint, quantity, time: worst.time, since, value: worst.value, limit: limit(worst) })
}

/// Rows on each side of a derivative, so that an error of half a step in each value changes it by at most
/// [`ROUNDING_SHARE`] of the limit; `None` if that takes longer than [`LONGEST_INTERVAL_S`].
fn rows_aside(times: &[f64], enough_s: f64) -> Option<usize> {
    let step = (times.last()? - times.first()?) / (times.len().checked_sub(1)? as f64);
    let rows = (enough_s / step).ceil().max(1.0);
    // one row on each side is always allowed, as the shortest interval
    (rows <= 1.0 || rows * step <= LONGEST_INTERVAL_S).then_some(rows as usize)
}

/// Central differences; the error is half a step in each of two values over twice the interval.
fn differences(times: &[f64], values: &[f64], step: f64, limit: f64) -> Option<Vec<TimedValue>> {
    let rows = rows_aside(times, 0.5 * step / (ROUNDING_SHARE * limit))?;
    let slope = |k: usize| {
        let (before, after) = (k - rows, k + rows);
        TimedValue {
            value: (values[after] - values[before]) / (times[after] - times[before]),
            time: times[k],
        }
    };
    Some((rows..times.len().saturating_sub(rows)).map(slope).collect())
}

/// Second central differences; the error is half a step in each value, twice that of the middle, over the squared
/// interval.
fn second_differences(times: &[f64], values: &[f64], step: f64, limit: f64) -> Option<Vec<TimedValue>> {
    let rows = rows_aside(times, (2.0 * step / (ROUNDING_SHARE * limit)).sqrt())?;
    let curvature = |k: usize| {
        let (before, after) = (k - rows, k + rows);
        let (first, second) = (times[k] - times[before], times[after] - times[k]);
        let slopes = [(values[k] - values[before]) / first, (values[after] - values[k]) / second];
        TimedValue { value: 2.0 * (slopes[1] - slopes[0]) / (first + second), time: times[k] }
    };
    Some((rows..times.len().saturating_sub(rows)).map(curvature).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::{er3a, er3a_of};

    #[test]
    fn the_published_series_keeps_the_limits_at_the_stated_speeds() {
        let robot = er3a();
        let series = robot.excitation.clone().expect("Table 4.1");
        assert!(broken_by_series(&robot, &series).is_empty());
        let percent: Vec<f64> = (0..6)
            .map(|j| {
                let speed = extremes(&series, j).speed.value.abs();
                (100.0 * speed / robot.joints[j].limits.velocity).round()
            })
            .collect();
        assert_eq!(percent, [66.0, 61.0, 59.0, 52.0, 46.0, 39.0]);
    }

    #[test]
    fn each_broken_limit_is_named_once_with_its_worst_moment() {
        let robot = er3a();
        let series = robot.excitation.clone().expect("Table 4.1");
        let mut tight = robot.clone();
        tight.joints[2].limits.velocity = 1.0;
        tight.joints[4].limits.acceleration = 0.5;
        tight.joints[0].limits.position_min = -0.5;
        let found = broken_by_series(&tight, &series);
        let what: Vec<(usize, Limited)> = found.iter().map(|b| (b.joint.number(), b.quantity)).collect();
        assert_eq!(what, [(1, Limited::LowestPosition), (3, Limited::Speed), (5, Limited::Acceleration)]);
        let speed = &found[1];
        assert!((state_at(&series, speed.time)[2][1] / speed.value - 1.0).abs() < 2e-4);
        assert_eq!(speed.limit.signum(), speed.value.signum());
        assert!((speed.excess() - (speed.value.abs() - 1.0)).abs() < 1e-12);
    }

    /// Samples of the published series, rounded to a number of decimals.
    fn sampled(rate_hz: f64, decimals: i32, with_velocities: bool) -> SampledMotion {
        let series = er3a().excitation.expect("Table 4.1");
        let times: Vec<f64> = (0..=(10.0 * rate_hz) as usize).map(|k| k as f64 / rate_hz).collect();
        let step = 10_f64.powi(-decimals);
        let rounded = |value: f64| (value / step).round() * step;
        let of = |quantity: usize| -> Vec<Vec<f64>> {
            (0..6)
                .map(|j| times.iter().map(|&t| rounded(state_at(&series, t)[j][quantity])).collect())
                .collect()
        };
        SampledMotion {
            positions: of(0),
            velocities: with_velocities.then(|| of(1)),
            accelerations: None,
            times,
            position_step: step,
            velocity_step: step,
            acceleration_step: step,
        }
    }

    #[test]
    fn samples_show_the_limits_that_the_series_breaks_and_no_other() {
        let mut robot = er3a();
        assert!(broken_by_samples(&robot, &sampled(250.0, 12, false)).breaches.is_empty());
        let series = robot.excitation.clone().expect("Table 4.1");
        robot.joints[2].limits.velocity = 1.0;
        robot.joints[4].limits.acceleration = 2.0;
        robot.joints[0].limits.position_max = 0.3;
        let exact = broken_by_series(&robot, &series);
        for (decimals, with_velocities) in [(12, false), (5, false), (4, true)] {
            let motion = sampled(250.0, decimals, with_velocities);
            let found = broken_by_samples(&robot, &motion);
            assert!(found.unjudged.is_empty(), "{:?}", found.unjudged);
            assert_eq!(found.breaches.len(), exact.len(), "{decimals} {:?}", found.breaches);
            for (found, exact) in found.breaches.iter().zip(&exact) {
                assert_eq!((found.joint, found.quantity), (exact.joint, exact.quantity));
                // rounding may add its share of the limit, a difference over 0.1 s reduces the value slightly
                let slack = 2.0 * ROUNDING_SHARE * exact.limit.abs();
                assert!((found.value - exact.value).abs() < slack, "{found:?} {exact:?}");
                assert!(found.since <= found.time);
            }
        }
    }

    #[test]
    fn positions_that_are_too_coarse_for_accelerations_are_not_judged() {
        let robot = er3a();
        let found = broken_by_samples(&robot, &sampled(250.0, 1, false));
        assert_eq!(found.unjudged.len(), 12, "{:?}", found.unjudged);
        assert_eq!(found.used[0][1..], [None, None, None]);
    }

    #[test]
    fn uneven_times_give_the_same_accelerations() {
        let robot = er3a_of(1);
        let times: Vec<f64> = (0..200).map(|k| 0.01 * f64::from(k) + 0.002 * f64::from(k % 3)).collect();
        let acceleration = 2.0;
        let positions = vec![times.iter().map(|t| 0.5 * acceleration * (t - 1.0) * (t - 1.0)).collect()];
        let motion = SampledMotion { times, positions, ..SampledMotion::default() };
        let used = broken_by_samples(&robot, &motion).used[0][2].expect("judged");
        assert!((used * robot.joints[0].limits.acceleration - acceleration).abs() < 1e-6);
    }
}
