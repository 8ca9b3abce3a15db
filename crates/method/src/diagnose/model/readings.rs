//! Readings of a recording, fitted to all joints: a description, and torques of some order, sign and scale.

use nalgebra::{Matrix2, Rotation3, Unit, Vector2, Vector3};

use super::channels::{ChannelInstant, Channels};
use super::joint_fit::JointFit;
use super::numbers::DescribedNumber;
use crate::least_squares::factor::{FactorBuilder, TriangularFactor};
use crate::least_squares::orthonormal::dot;
use crate::model::dynamics::{DynamicModel, inverse_dynamics};
use crate::model::regressor::Regressor;
use armwatch_model::robot::{MAX_JOINTS, ParameterId, Robot};

/// Step of the numeric derivative, m, rad, m/s².
const STEP: f64 = 1e-6;
/// New part of a column of the regressor below which it depends on those before it, as in
/// [`base_parameters`](crate::model::base_parameters::base_parameters): a parameter that is hardly visible under one
/// gravity may become infinite under another.
const DEPENDENT: f64 = 1e-4;
/// Remaining part of a number's effect below which the parameters absorb it.
const ABSORBED: f64 = 1e-3;
/// Number of steps in the estimate of gravity's direction, each from the tangent at the previous one.
const LEVELLING_STEPS: usize = 5;
/// Rotation of gravity, rad, that does not change the findings.
const LEVEL: f64 = 5e-4;
/// Usual tilt of a floor, rad. A joint about a vertical axis shows only the product of the tilt and the first moment of
/// its link, so among tilts with equal misfit the smaller one is more likely.
const USUAL_TILT: f64 = 0.035;
/// Number of independent values of a joint's torque in about ten seconds, with ripple that depends on the posture.
pub(super) const INDEPENDENT: f64 = 25.0;
/// Smallest angle between gravity and its description, rad, that is another mounting and not a tilted floor.
pub(super) const MOUNTING: f64 = 0.17;

/// Description with the order, signs and scales of the recorded torques.
#[derive(Debug, Clone)]
pub(super) struct ChannelReading {
    pub(super) robot: Robot,
    /// Index of the recorded torque of each joint.
    pub(super) order: Vec<usize>,
    /// Ratio of the recorded to the true torque of each joint; negative for a reversed sign.
    pub(super) scales: Vec<f64>,
}

impl ChannelReading {
    /// Reading without changes.
    pub(super) fn of(robot: &Robot) -> Self {
        let n = robot.joint_count();
        Self { robot: robot.clone(), order: (0..n).collect(), scales: vec![1.0; n] }
    }

    fn under(&self, gravity: Vector3<f64>) -> Self {
        Self { robot: Robot { gravity, ..self.robot.clone() }, ..self.clone() }
    }
}

/// Rows and weights for the comparison of readings.
#[derive(Debug, Clone)]
pub(super) struct ReadingComparison<'a> {
    pub(super) channels: Channels<'a>,
    pub(super) rows: Vec<usize>,
    /// Standard deviation of the error of each recorded torque, Nm (N).
    pub(super) sigma: Vec<f64>,
    /// Mean power of friction of each joint, as sums of all parameters.
    friction: Vec<Vec<f64>>,
}

impl<'a> ReadingComparison<'a> {
    pub(super) fn new(channels: Channels<'a>, rows: Vec<usize>, sigma: Vec<f64>) -> Self {
        let whole: Vec<usize> = (0..channels.robot.parameter_count()).collect();
        Self { channels, rows, sigma, friction: channels.friction_bounds(&whole) }
    }

    /// Thins to at most this number of rows.
    pub(super) fn thinned(&self, rows: usize) -> Self {
        let stride = self.rows.len().div_ceil(rows.max(1)).max(1);
        Self { rows: self.rows.iter().copied().step_by(stride).collect(), ..self.clone() }
    }

    /// Weighted squares that remain of a reading's torques with the best parameters.
    pub(super) fn misfit(&self, reading: &ChannelReading) -> f64 {
        let (n, b) = (reading.robot.joint_count(), reading.robot.parameter_count());
        let whole: Vec<usize> = (0..b).collect();
        let bounds = [&self.friction[..], &self.channels.inertia_bounds(&reading.robot, &whole)].concat();
        let mut builder = FactorBuilder::new(b + n - 1);
        self.each(reading, |j, y, _, [weight, torque]| {
            let torques = (0..n).map(|of| if of == j { torque } else { 0.0 });
            builder.push((0..b).map(|column| weight * y.column(column)[j]).chain(torques));
        });
        JointFit::new(&builder.take(), b, n, &bounds).misfit(|_| 1.0)
    }

    /// Reading with the most likely direction of gravity at most [`MOUNTING`] away from `from`, m/s², and the squares
    /// that remain.
    pub(super) fn levelled(&self, reading: &ChannelReading, from: &Vector3<f64>) -> (ChannelReading, f64) {
        let price = self.rows.len() as f64 / INDEPENDENT / USUAL_TILT.powi(2);
        let cost = |misfit: f64, gravity: &Vector3<f64>| misfit + price * gravity.angle(from).powi(2);
        let (mut best, mut least) = (reading.clone(), self.misfit(reading));
        for _step in 0..LEVELLING_STEPS {
            let Some(change) = self.gravity_step(&best, from, price) else { break };
            let before = cost(least, &best.robot.gravity);
            let tried = [1.0, 0.5, 0.25].into_iter().find_map(|part| {
                let gravity = towards(from, &(best.robot.gravity + part * change))?;
                let turned = gravity.angle(&best.robot.gravity);
                let tried = best.under(gravity);
                let left = self.misfit(&tried);
                (cost(left, &gravity) < before).then_some((tried, left, turned))
            });
            let Some((tried, left, turned)) = tried else { break };
            (best, least) = (tried, left);
            if turned < LEVEL {
                break;
            }
        }
        (best, least)
    }

    /// Best change of gravity, m/s², across its direction, to first order. `price` is the cost per squared angle from
    /// `from`.
    fn gravity_step(
        &self,
        reading: &ChannelReading,
        from: &Vector3<f64>,
        price: f64,
    ) -> Option<Vector3<f64>> {
        let gravity = reading.robot.gravity;
        let side = gravity.cross(&across(&gravity)).try_normalize(f64::MIN_POSITIVE)?;
        let sides = [side, gravity.normalize().cross(&side)];
        let changed = sides.map(|side| reading.under(gravity + STEP * side).robot);
        let lacking = self.lacking(reading, &changed);
        let [a, b] = [&lacking.slopes[0], &lacking.slopes[1]];
        let price = price / gravity.norm_squared();
        let products = Matrix2::new(dot(a, a) + price, dot(a, b), dot(a, b), dot(b, b) + price);
        let away = gravity - from;
        let right = Vector2::new(dot(a, &lacking.residual), dot(b, &lacking.residual))
            - price * Vector2::new(sides[0].dot(&away), sides[1].dot(&away));
        let change = products.try_inverse()? * right;
        Some(sides[0] * change.x + sides[1] * change.y)
    }

    /// Numbers of the description, each with its best change to first order if it were the only wrong one. The number
    /// that explains most comes first.
    pub(super) fn asked_for(&self, reading: &ChannelReading) -> Vec<(DescribedNumber, f64)> {
        let numbers: Vec<DescribedNumber> = DescribedNumber::all(&reading.robot)
            .into_iter()
            .filter(|number| matches!(number, DescribedNumber::Place(..)))
            .collect();
        let changed: Vec<Robot> = numbers.iter().map(|of| of.changed(&reading.robot, STEP)).collect();
        let lacking = self.lacking(reading, &changed);
        let mut scored: Vec<(f64, (DescribedNumber, f64))> = numbers
            .into_iter()
            .zip(lacking.slopes.iter().zip(&lacking.whole))
            .filter_map(|(number, (slope, whole))| {
                let square = dot(slope, slope);
                let both = dot(slope, &lacking.residual);
                (square > ABSORBED * ABSORBED * whole)
                    .then_some((both * both / square, (number, both / square)))
            })
            .collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0));
        scored.into_iter().map(|(_, asked)| asked).collect()
    }

    /// Parts of the torque, and of its derivatives by descriptions that are one [`STEP`] away, that the parameters do
    /// not explain.
    fn lacking(&self, reading: &ChannelReading, changed: &[Robot]) -> Lacking {
        let robot = &reading.robot;
        let (n, b, m) = (robot.joint_count(), robot.parameter_count(), changed.len());
        let mut builder = FactorBuilder::new(b);
        self.each(reading, |j, y, _, [weight, torque]| {
            builder.push((0..b).map(|column| weight * y.column(column)[j]).chain([torque]));
        });
        let factor = builder.take();
        let theta = factor.basic_solution(DEPENDENT);
        let ids = ParameterId::natural_order(robot);
        let model = DynamicModel::from_parameters(robot, ids.into_iter().zip(theta));
        let mut builder = FactorBuilder::new(b + m);
        let mut slopes = vec![[0.0; MAX_JOINTS]; m];
        let mut written = None;
        self.each(reading, |j, y, state, [weight, torque]| {
            if written != Some(state.row) {
                written = Some(state.row);
                let of = |robot: &Robot| {
                    let mut tau = [0.0; MAX_JOINTS];
                    let [q, qd, qdd] = [&state.q[..n], &state.qd[..n], &state.qdd[..n]];
                    inverse_dynamics(robot, &model.inertial, q, qd, qdd, &mut tau[..n]);
                    tau
                };
                let described = of(robot);
                for (slope, changed) in slopes.iter_mut().zip(changed) {
                    let changed = of(changed);
                    *slope = std::array::from_fn(|j| (changed[j] - described[j]) / STEP);
                }
            }
            let w = (0..b).map(|column| weight * y.column(column)[j]);
            builder.push(w.chain(slopes.iter().map(|slope| weight * slope[j])).chain([torque]));
        });
        let kept = factor.independent_columns(b, DEPENDENT);
        let columns: Vec<usize> = kept.iter().copied().chain(b..b + m).collect();
        Lacking::new(&builder.take().restricted(&columns), kept.len())
    }

    /// Calls `take(joint, regressor, state, [weight of its columns, weighted torque])` for each moving joint in each
    /// row.
    fn each(
        &self,
        reading: &ChannelReading,
        mut take: impl FnMut(usize, &Regressor, &ChannelInstant, [f64; 2]),
    ) {
        let robot = &reading.robot;
        let mut y = Regressor::new(robot);
        let mut state = ChannelInstant::default();
        for &row in &self.rows {
            self.channels.regressor(robot, row, &mut state, &mut y);
            for (j, (&torque, scale)) in reading.order.iter().zip(&reading.scales).enumerate() {
                if state.qd[j].abs() >= robot.joints[j].counted_speed() {
                    let sigma = self.sigma[torque];
                    take(j, &y, &state, [scale / sigma, state.tau[torque] / sigma]);
                }
            }
        }
    }
}

/// Parts that the parameters do not explain.
struct Lacking {
    /// Remainder of the derivative by each change.
    slopes: Vec<Vec<f64>>,
    /// Squares of each derivative as a whole.
    whole: Vec<f64>,
    /// Remainder of the torque.
    residual: Vec<f64>,
}

impl Lacking {
    /// Creates the parts from a factor of `b` columns of parameters, the derivatives, and the torque.
    fn new(factor: &TriangularFactor, b: usize) -> Self {
        let (upper, end) = (factor.upper(), factor.columns());
        let left =
            |k: usize| -> Vec<f64> { (b..=end).map(|i| if i <= k { upper[(i, k)] } else { 0.0 }).collect() };
        let whole = |k: usize| (0..=k).map(|i| upper[(i, k)].powi(2)).sum();
        Self {
            slopes: (b..end).map(left).collect(),
            whole: (b..end).map(whole).collect(),
            residual: left(end),
        }
    }
}

/// Direction of `gravity` with the length of `from`, at most [`MOUNTING`] away from it.
fn towards(from: &Vector3<f64>, gravity: &Vector3<f64>) -> Option<Vector3<f64>> {
    let angle = from.angle(gravity);
    if angle <= MOUNTING {
        return Some(from.norm() * gravity.try_normalize(f64::MIN_POSITIVE)?);
    }
    Some(turned_about(&from.cross(gravity), MOUNTING) * from)
}

/// Direction that is not parallel to `of`.
pub(super) fn across(of: &Vector3<f64>) -> Vector3<f64> {
    if of.x.abs() < 0.7 * of.norm() { Vector3::x() } else { Vector3::y() }
}

pub(super) fn turned_about(axis: &Vector3<f64>, angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle)
}
