//! Test that torques agree with the description: a test of lack of fit in the direction of its numbers.
//!
//! Base parameters adapt: a model with wrong geometry may explain torques nearly as well as the right one, but its
//! residual is not noise. To first order the residual of a description whose numbers are off by `dp` is `S dp` with
//! `S = d(w theta)/dp`. The part of `S` that the base parameters do not absorb is compared with the residual (Lagrange
//! multiplier test; Rao 1948, Large sample tests of statistical hypotheses concerning several parameters).

use nalgebra::Vector3;

use super::friction_shapes::SHAPES;
use super::numbers::DescribedNumber;
use crate::identify::filtered_columns::{FilteredColumn, filtered_coulomb_columns, write_filtered_columns};
use crate::identify::load_visibility::is_of_load;
use crate::lanes::{LANES, Lanes};
use crate::least_squares::factor::{FactorBuilder, TriangularFactor};
use crate::least_squares::orthonormal::{OrthonormalBasis, dot};
use crate::model::dynamics::DynamicModel;
use crate::model::dynamics_lanes::{JointLanes, torques_of};
use crate::model::regressor::{Regressor, joint_torque_regressor};
use crate::model::regressor_lanes::LaneStates;
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::Identification;
use armwatch_model::robot::{MAX_JOINTS, ParameterId, Robot};

/// Largest number of instants, evenly spaced over the excitation; enough for a yes or no.
const MOST_INSTANTS: usize = 1500;
/// Step of the numeric derivative, m, rad, m/s²: eight digits of a double remain.
const STEP: f64 = 1e-6;
/// Remaining part of a number's effect below which the base parameters absorb it.
const ABSORBED: f64 = 1e-3;
/// New part of a regressor column below which it depends on those before it.
const DEPENDENT: f64 = 1e-7;

/// Result of the test of the description's numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct DescriptionTest {
    /// Part of the weighted residual that changes of all numbers together explain, minus the part expected from noise
    /// alone.
    pub share: f64,
    /// F statistic of the test.
    pub f: f64,
    /// Degrees of freedom: numbers, and remaining independent rows.
    pub freedom: [usize; 2],
    /// Scores of the numbers that have a visible effect, the largest share first.
    pub scores: Vec<NumberScore>,
    /// Numbers whose effect the base parameters absorb, so that torques do not test them.
    pub absorbed: Vec<DescribedNumber>,
    /// Change of gravity, m/s², if its direction were the only wrong number.
    pub gravity_change: Vector3<f64>,
}

/// Best-fitting change of one number of the description, if it were the only wrong one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NumberScore {
    /// The number.
    pub number: DescribedNumber,
    /// Change to first order: m, rad, m/s², s.
    pub change: f64,
    /// Standard error of the change.
    pub std_error: f64,
    /// Part of the weighted residual that the change explains.
    pub share: f64,
}

/// Rows for the test of a description.
#[derive(Debug, Clone)]
pub struct JudgedRows<'a> {
    /// Signals of the cycle after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Rows far enough apart to be independent after the low-pass.
    pub rows: Vec<usize>,
    /// Standard deviation of each joint's residual `[n]`, Nm (N). The weight of a row is the inverse.
    pub noise: Vec<f64>,
    /// Friction of other shapes `[n][SHAPES][rows of the recording]`, allowed for every description
    /// ([`friction_shapes`](super::friction_shapes::friction_shapes)); empty for none.
    pub shapes: &'a [Vec<Vec<f64>>],
    /// Low-passed columns of friction under load, which other descriptions share.
    pub of_load: Vec<&'a FilteredColumn>,
}

impl<'a> JudgedRows<'a> {
    /// Thins the rows of the excitation, given in order, to independent ones.
    #[must_use]
    pub fn new(
        filtered: &'a FilteredSignals,
        excitation: &[usize],
        noise: Vec<f64>,
        shapes: &'a [Vec<Vec<f64>>],
        filtered_coulomb_columns: &'a [FilteredColumn],
    ) -> Self {
        let apart = (filtered.sample_rate / (2.0 * filtered.cutoff)).ceil().max(1.0) as usize;
        let stride = apart.max(excitation.len().div_ceil(MOST_INSTANTS));
        let of_load = filtered_coulomb_columns.iter().filter(|column| is_of_load(column.id)).collect();
        let rows = excitation.iter().copied().step_by(stride).collect();
        Self { filtered, rows, noise, shapes, of_load }
    }

    /// Thins to at most this number of instants.
    #[must_use]
    pub fn thinned(&self, instants: usize) -> Self {
        let stride = self.rows.len().div_ceil(instants.max(1)).max(1);
        Self { rows: self.rows.iter().copied().step_by(stride).collect(), ..self.clone() }
    }

    /// Number of columns for the shapes of friction.
    fn shape_columns(&self) -> usize {
        SHAPES * self.shapes.len()
    }

    /// Entries of a joint's row in these columns, times `weight`.
    fn shaped(&self, joint: usize, row: usize, weight: f64) -> impl Iterator<Item = f64> + '_ {
        let own = move |of: usize, k: usize| {
            if of == joint { weight * self.shapes[of][k][row] } else { 0.0 }
        };
        (0..self.shapes.len()).flat_map(move |of| (0..SHAPES).map(move |k| own(of, k)))
    }

    /// Weighted residual sum of squares of a description with refitted parameters, from its whole regressor, with
    /// torques times `gains` `[n]`.
    pub(super) fn residual(&self, robot: &Robot, gains: &[f64]) -> f64 {
        let factor = self.whole_factor(robot, gains);
        let columns = factor.columns();
        let upper = factor.upper();
        let column = |k: usize| -> Vec<f64> { upper.col(k).iter().copied().collect() };
        let mut basis = OrthonormalBasis::default();
        (0..columns).for_each(|k| basis.add(&column(k), DEPENDENT));
        let rest = basis.rest(&column(columns)).vector;
        dot(&rest, &rest)
    }

    /// Mean weighted squares of the same residual over the rows of each joint `[n]`.
    pub(super) fn residual_by_joint(&self, robot: &Robot, gains: &[f64]) -> Vec<f64> {
        let factor = self.whole_factor(robot, gains);
        let theta = factor.basic_solution(DEPENDENT);
        let n = robot.joint_count();
        let (mut squares, mut rows) = (vec![0.0; n], vec![0_usize; n]);
        self.each_entry(robot, gains, |joint, entries| {
            let torque = entries[theta.len()];
            let estimated: f64 = entries.iter().zip(&theta).map(|(entry, theta)| entry * theta).sum();
            squares[joint] += (torque - estimated).powi(2);
            rows[joint] += 1;
        });
        squares.iter().zip(rows).map(|(squares, rows)| squares / rows.max(1) as f64).collect()
    }

    fn whole_factor(&self, robot: &Robot, gains: &[f64]) -> TriangularFactor {
        let mut folder = FactorBuilder::new(robot.parameter_count() + self.shape_columns());
        self.each_entry(robot, gains, |_, entries| folder.push(entries.iter().copied()));
        folder.take()
    }

    /// Calls `take(joint, entries)` with the weighted row: whole regressor, shapes of friction, torque.
    fn each_entry(&self, robot: &Robot, gains: &[f64], mut take: impl FnMut(usize, &[f64])) {
        let mut filtered_coulomb_columns = filtered_coulomb_columns(robot, self.filtered);
        filtered_coulomb_columns.extend(self.of_load.iter().copied().cloned());
        let mut y = Regressor::new(robot);
        let mut entries = Vec::new();
        self.each(robot, &filtered_coulomb_columns, &mut y, |row, j, y, state| {
            let weight = 1.0 / self.noise[j];
            entries.clear();
            entries.extend((0..y.columns()).map(|k| weight * gains[j] * y.column(k)[j]));
            entries.extend(self.shaped(j, row, weight));
            entries.push(weight * state.tau[j]);
            take(j, &entries);
        });
    }

    /// Calls `take(row, joint, regressor, state)` for each moving joint in each row.
    fn each(
        &self,
        robot: &Robot,
        filtered_coulomb_columns: &[FilteredColumn],
        y: &mut Regressor,
        mut take: impl FnMut(usize, usize, &Regressor, &DescribedInstant),
    ) {
        let n = robot.joint_count();
        let mut state = DescribedInstant::default();
        for &row in &self.rows {
            let DescribedInstant { q, qd, qdd, tau } = &mut state;
            self.filtered.row(row, q, qd, qdd, tau);
            joint_torque_regressor(robot, &state.q[..n], &state.qd[..n], &state.qdd[..n], y);
            write_filtered_columns(filtered_coulomb_columns, row, y);
            for j in 0..n {
                if state.qd[j].abs() >= robot.joints[j].counted_speed() {
                    take(row, j, y, &state);
                }
            }
        }
    }
}

/// State of all joints at one instant.
#[derive(Debug, Clone, Copy, Default)]
struct DescribedInstant {
    q: [f64; MAX_JOINTS],
    qd: [f64; MAX_JOINTS],
    qdd: [f64; MAX_JOINTS],
    tau: [f64; MAX_JOINTS],
}

/// Compares the residual of the identified parameters with the effects of the description's numbers.
///
/// `kept_columns` `[b]` are the regressor's columns of the identified parameters, `filtered_coulomb_columns` the
/// low-passed columns of the robot that have jumps. `None` if there are too few rows.
#[must_use]
pub fn test_description(
    robot: &Robot,
    kept_columns: &[usize],
    identified: &Identification,
    judged_rows: &JudgedRows<'_>,
    filtered_coulomb_columns: &[FilteredColumn],
) -> Option<DescriptionTest> {
    let numbers = DescribedNumber::all(robot);
    let (b, m) = (kept_columns.len() + judged_rows.shape_columns(), numbers.len());
    let parameters = identified.parameters.iter().map(|p| (p.id, p.value));
    let model = DynamicModel::from_parameters(robot, parameters);
    let theta: Vec<f64> = values_of(robot, kept_columns, identified);
    let mut slopes = TorqueSlopes::new(robot, &numbers, &model, judged_rows);
    let mut folder = FactorBuilder::new(b + m);
    let mut y = Regressor::new(robot);
    let mut slope = vec![[0.0; MAX_JOINTS]; m];
    let mut written = None;
    let mut rows = 0;
    judged_rows.each(robot, filtered_coulomb_columns, &mut y, |row, j, y, state| {
        if written != Some(row) {
            slopes.write(row, &mut slope);
            written = Some(row);
        }
        let weight = 1.0 / judged_rows.noise[j];
        let estimated: f64 = kept_columns.iter().zip(&theta).map(|(&k, theta)| y.column(k)[j] * theta).sum();
        let entry = |(number, slope): (&DescribedNumber, &[f64; MAX_JOINTS])| match number {
            DescribedNumber::TorqueGain(of) if of.index() == j => weight * estimated,
            DescribedNumber::TorqueGain(_) => 0.0,
            _ => weight * slope[j],
        };
        let w = kept_columns.iter().map(|&k| weight * y.column(k)[j]);
        let w = w.chain(judged_rows.shaped(j, row, weight));
        folder.push(w.chain(numbers.iter().zip(&slope).map(entry)).chain([weight * state.tau[j]]));
        rows += 1;
    });
    (rows > 2 * (b + m)).then(|| judged(&numbers, &folder.take(), b, rows))
}

/// Values of the identified parameters in the order of `kept_columns`.
fn values_of(robot: &Robot, kept_columns: &[usize], identified: &Identification) -> Vec<f64> {
    let order = ParameterId::natural_order(robot);
    let value =
        |id: &ParameterId| identified.parameters.iter().find(|p| p.id == *id).map_or(0.0, |p| p.value);
    kept_columns.iter().map(|&column| value(&order[column])).collect()
}

fn judged(numbers: &[DescribedNumber], factor: &TriangularFactor, b: usize, rows: usize) -> DescriptionTest {
    let upper = factor.upper();
    let m = numbers.len();
    let end = b + m;
    // rows below the base parameters' contain the unexplained part of the slopes and of the torque
    let left =
        |k: usize| -> Vec<f64> { (b..=end).map(|i| if i <= k { upper[(i, k)] } else { 0.0 }).collect() };
    let residual = left(end);
    let total = dot(&residual, &residual);
    let whole = |k: usize| (0..=k.min(end)).map(|i| upper[(i, k)].powi(2)).sum::<f64>();
    let (mut scores, mut absorbed) = (Vec::new(), Vec::new());
    let mut basis = OrthonormalBasis::default();
    for (at, &number) in numbers.iter().enumerate() {
        let slope = left(b + at);
        let square = dot(&slope, &slope);
        if square <= ABSORBED * ABSORBED * whole(b + at) {
            absorbed.push(number);
            continue;
        }
        basis.add(&slope, ABSORBED);
        let change = dot(&slope, &residual) / square;
        let explained = change * change * square;
        let freedom = rows - b - 1;
        scores.push(NumberScore {
            number,
            change,
            std_error: ((total - explained) / freedom as f64 / square).sqrt(),
            share: explained / total,
        });
    }
    scores.sort_by(|a, b| b.share.total_cmp(&a.share));
    let gravity_change = gravity_change(numbers, |at| left(b + at), &residual);
    let rest = basis.rest(&residual).vector;
    let unexplained = dot(&rest, &rest);
    let freedom = [basis.rank().max(1), rows - b - m];
    let mean_unexplained = unexplained / freedom[1] as f64;
    let explained = (total - unexplained).max(0.0);
    DescriptionTest {
        share: ((explained - freedom[0] as f64 * mean_unexplained) / total).max(0.0),
        f: explained / freedom[0] as f64 / mean_unexplained,
        freedom,
        scores,
        absorbed,
        gravity_change,
    }
}

/// Components of gravity that together explain most of a residual, from the `slope` of each number.
fn gravity_change(
    numbers: &[DescribedNumber],
    slope: impl Fn(usize) -> Vec<f64>,
    residual: &[f64],
) -> Vector3<f64> {
    let of_axis = |axis| numbers.iter().position(|of| *of == DescribedNumber::Gravity(axis)).map(&slope);
    let slopes: [Vec<f64>; 3] = std::array::from_fn(|axis| of_axis(axis).unwrap_or_default());
    let products = nalgebra::Matrix3::from_fn(|a, b| dot(&slopes[a], &slopes[b]));
    let right = Vector3::from_fn(|a, _| dot(&slopes[a], residual));
    let inverse = products.pseudo_inverse(ABSORBED * ABSORBED * products.trace());
    inverse.map_or_else(|_| Vector3::zeros(), |inverse| inverse * right)
}

/// Derivatives of the torques with respect to the description's numbers.
struct TorqueSlopes<'a> {
    robot: &'a Robot,
    model: &'a DynamicModel,
    /// Robot with each number larger by one step; `None` for a change of the torque itself.
    changed: Vec<Option<Robot>>,
    filtered: &'a FilteredSignals,
    /// Rows in use, ascending.
    rows: &'a [usize],
    /// Index in `rows` of the first of the loaded rows, one per lane.
    first: Option<usize>,
    /// Slopes in the loaded rows, for each changed robot.
    slopes: Vec<JointLanes>,
    /// Derivative of each measured torque over time `[n][rows]`, if rows are not evenly spaced.
    rates: Vec<Vec<f64>>,
}

impl<'a> TorqueSlopes<'a> {
    fn new(
        robot: &'a Robot,
        numbers: &[DescribedNumber],
        model: &'a DynamicModel,
        judged_rows: &'a JudgedRows<'_>,
    ) -> Self {
        let changed = |number: &DescribedNumber| match number {
            DescribedNumber::TorqueGain(_) | DescribedNumber::TorqueDelay => None,
            _ => Some(number.changed(robot, STEP)),
        };
        let filtered = judged_rows.filtered;
        let rate = |tau: &Vec<f64>| filtered.derivative(tau);
        Self {
            robot,
            model,
            changed: numbers.iter().map(changed).collect(),
            filtered,
            rows: &judged_rows.rows,
            first: None,
            slopes: Vec::new(),
            rates: if filtered.is_even() { Vec::new() } else { filtered.tau.iter().map(rate).collect() },
        }
    }

    /// Minus the derivative of a measured torque over time, Nm/s (N/s).
    fn late(&self, joint: usize, row: usize) -> f64 {
        let at_row = self.filtered.derivative_at(&self.filtered.tau[joint], row);
        -at_row.unwrap_or_else(|| self.rates[joint][row])
    }

    /// Writes the slopes in a row, `[numbers][n]`.
    fn write(&mut self, row: usize, slope: &mut [[f64; MAX_JOINTS]]) {
        let n = self.robot.joint_count();
        let place = self.rows.partition_point(|of| *of < row);
        let first = match self.first.filter(|first| (*first..first + LANES).contains(&place)) {
            Some(first) => first,
            None => self.take_up(place),
        };
        let mut of_changed = self.slopes.iter();
        for (changed, slope) in self.changed.iter().zip(slope) {
            match changed {
                Some(_) => {
                    let lanes = of_changed.next();
                    (0..n).for_each(|j| slope[j] = lanes.map_or(0.0, |lanes| lanes[j].0[place - first]));
                }
                None => (0..n).for_each(|j| slope[j] = self.late(j, row)),
            }
        }
    }

    /// Computes the slopes in the rows from `first` on.
    fn take_up(&mut self, first: usize) -> usize {
        let mut states = LaneStates::default();
        for lane in 0..LANES {
            let row = self.rows[(first + lane).min(self.rows.len() - 1)];
            for j in 0..self.robot.joint_count() {
                states.q[j].0[lane] = self.filtered.q[j][row];
                states.qd[j].0[lane] = self.filtered.qd[j][row];
                states.qdd[j].0[lane] = self.filtered.qdd[j][row];
            }
        }
        let robots = std::iter::once(self.robot).chain(self.changed.iter().flatten());
        let mut torques = torques_of(robots, &self.model.inertial, &states);
        self.slopes.clear();
        if let Some(described) = torques.next() {
            let slope = |changed: JointLanes| -> JointLanes {
                std::array::from_fn(|j| Lanes((changed[j] - described[j]).0.map(|change| change / STEP)))
            };
            self.slopes.extend(torques.map(slope));
        }
        self.first = Some(first);
        first
    }
}
