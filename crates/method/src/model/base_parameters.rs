//! Base parameters: the parameters that a motion can show, and the sums that each of them contains.

use std::fmt::Write;

use faer::Mat;

use super::dynamics::DynamicModel;
use super::regressor::{Regressor, joint_torque_regressor, write_load_columns};
use crate::NumericsError;
use crate::least_squares::orthonormal::{OrthonormalBasis, norm};
use armwatch_model::robot::{ParameterId, ParameterKind, Robot, StandardParameters};

/// Smallest independent part of a column of unit norm that makes it a kept column; the threshold of the source [3.2,
/// D].
///
/// Exact dependence leaves about 1e-13, and a useful parameter about 1e-2. Rounded geometry causes values between
/// these: an angle written as 1.5708 rad is off by 4e-6 and would add columns that no recording can distinguish.
const INDEPENDENCE_THRESHOLD: f64 = 1e-4;

/// Length of a column, relative to the longest inertial one, below which it is invisible: a parameter of 1 kg m gives
/// less than 1e-4 Nm in an arm of 100 Nm. Right angles rounded to five digits leave columns of 1e-7.
const INVISIBLE: f64 = 1e-6;

/// Share of a unit-norm column below which its part in a grouping is rounding (about 1e-13) and omitted.
const GROUPING_THRESHOLD: f64 = 1e-10;

/// Number of states of the stacked regressor: each gives `n` rows, which makes 17 rows per column.
pub const PROBE_STATES: usize = 256;

/// Body of 1 kg at a distance from its axis.
const UNIT_BODY: StandardParameters = StandardParameters([1.0, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.1, 0.0, 0.1]);

/// Position, velocity and acceleration of all joints: `[n]` each, rad, rad/s, rad/s² (m).
#[derive(Debug, Clone, PartialEq)]
pub struct JointState {
    /// Position.
    pub q: Vec<f64>,
    /// Velocity.
    pub qd: Vec<f64>,
    /// Acceleration.
    pub qdd: Vec<f64>,
}

/// Base parameters of a robot [3.2, D]: a smallest set that gives every torque of the full set.
///
/// The value of a kept parameter includes *all parameters grouped into it*. It is meaningful only with the formula of
/// [`BaseParameters::grouping_formula`].
#[derive(Debug, Clone, PartialEq)]
pub struct BaseParameters {
    /// Kept parameters `[b]` in natural order.
    pub kept: Vec<ParameterId>,
    /// Regressor columns of the kept parameters `[b]`.
    pub kept_columns: Vec<usize>,
    /// Parameters that never change a torque.
    pub unobservable: Vec<ParameterId>,
    /// Parameters grouped into each kept parameter `[b]`, in natural order.
    pub grouping: Vec<Vec<GroupedParameter>>,
    /// Rank of the inertial columns.
    pub inertial_rank: usize,
    /// Rank of inertial and motor-inertia columns together, without couplings.
    pub inertial_and_motor_rank: usize,
    /// Rank `b` of all columns.
    pub rank: usize,
    /// Singular values that show this rank.
    pub singular_value_gap: SingularValueGap,
    /// Condition number of the kept columns over the probe states, in SI units.
    pub condition_number: f64,
    /// Condition number with each column scaled to unit norm.
    pub scaled_condition_number: f64,
}

/// A dropped parameter within the grouping of a kept one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupedParameter {
    /// The dropped parameter.
    pub id: ParameterId,
    /// Its column in the regressor.
    pub column: usize,
    /// Factor of the dropped parameter in the sum.
    pub coefficient: f64,
}

/// Singular values of the scaled regressor on both sides of its rank.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SingularValueGap {
    /// Smallest singular value that counts.
    pub smallest_kept: f64,
    /// Largest singular value that does not count; 0 if all count.
    pub largest_dropped: f64,
}

impl BaseParameters {
    /// Sum that the kept parameter at `index` represents, such as `J2_mPx + 0.27 J3_m`. Coefficients have six digits.
    /// Empty beyond the last parameter.
    #[must_use]
    pub fn grouping_formula(&self, index: usize) -> String {
        let (Some(kept), Some(terms)) = (self.kept.get(index), self.grouping.get(index)) else {
            return String::new();
        };
        terms.iter().fold(kept.to_string(), |mut formula, term| {
            let sign = if term.coefficient < 0.0 { '-' } else { '+' };
            let factor = match six_digits(term.coefficient.abs()) {
                1.0 => String::new(),
                factor => format!("{factor} "),
            };
            // Writing to a string cannot fail.
            let _ = write!(formula, " {sign} {factor}{}", term.id);
            formula
        })
    }

    /// Base values `theta` `[b]` of a full set of parameters `phi` `[p]` in natural order.
    ///
    /// # Panics
    /// If `phi` is shorter than `p`.
    #[must_use]
    pub fn group(&self, phi: &[f64]) -> Vec<f64> {
        self.kept_columns
            .iter()
            .zip(&self.grouping)
            .map(|(&column, terms)| {
                phi[column] + terms.iter().map(|term| term.coefficient * phi[term.column]).sum::<f64>()
            })
            .collect()
    }
}

/// Base parameters of a robot within its limits [3.2, D].
///
/// The regressor is stacked over [`PROBE_STATES`] states and its columns are scaled to unit norm. The columns are
/// examined in natural order. A zero column is unobservable, a column that is independent of those kept so far is kept,
/// and any other column is grouped into them. So the kept parameters and the coefficients are the same on every
/// machine, and like the source's for its arm.
///
/// # Errors
/// [`NumericsError::TooShort`] for a robot without joints, [`NumericsError::NotFinite`] if geometry or limits give no
/// finite numbers, [`NumericsError::RankUnclear`] if the singular values disagree with the number of columns kept.
pub fn base_parameters(robot: &Robot) -> Result<BaseParameters, NumericsError> {
    let n = robot.joint_count();
    if n == 0 {
        return Err(NumericsError::TooShort { what: "the chain of joints", rows: 0, needed: 1 });
    }
    let r = probe_factor(robot)?;
    let ids = ParameterId::natural_order(robot);
    let norms: Vec<f64> = (0..r.ncols()).map(|c| norm(&column(&r, c))).collect();
    let inertial = |c: &usize| matches!(ids[*c].kind, ParameterKind::Inertial(_));
    let longest = (0..r.ncols()).filter(inertial).map(|c| norms[c]).fold(0.0, f64::max);
    let (seen, zero): (Vec<usize>, Vec<usize>) =
        (0..r.ncols()).partition(|&c| norms[c] > INVISIBLE * longest);
    let scaled: Vec<Vec<f64>> =
        seen.iter().map(|&c| column(&r, c).iter().map(|x| x / norms[c]).collect()).collect();
    let selection = independent_columns(&scaled);

    let kept_columns: Vec<usize> = selection.kept.iter().map(|&k| seen[k]).collect();
    // Each set of columns is examined separately: a friction column of the full set may make a motor's inertia
    // dependent, such as the offset of a lift that carries its mass.
    let rank_of = |wanted: fn(ParameterKind) -> bool| {
        let of_kind = seen.iter().zip(&scaled).filter(|(c, _)| wanted(ids[**c].kind));
        let columns: Vec<Vec<f64>> = of_kind.map(|(_, column)| column.clone()).collect();
        confirm_rank(independent_columns(&columns).kept.len(), &columns)
    };
    let inertial = rank_of(|kind| matches!(kind, ParameterKind::Inertial(_)))?;
    let with_motor =
        rank_of(|kind| matches!(kind, ParameterKind::Inertial(_) | ParameterKind::MotorInertia))?;
    let all = confirm_rank(selection.kept.len(), &scaled)?;

    let kept_raw: Vec<Vec<f64>> = kept_columns.iter().map(|&c| column(&r, c)).collect();
    let kept_scaled: Vec<&[f64]> = selection.kept.iter().map(|&k| &scaled[k][..]).collect();
    Ok(BaseParameters {
        kept: kept_columns.iter().map(|&c| ids[c]).collect(),
        unobservable: zero.iter().map(|&c| ids[c]).collect(),
        grouping: groupings(&selection, &seen, &norms, &ids),
        inertial_rank: inertial.rank,
        inertial_and_motor_rank: with_motor.rank,
        rank: all.rank,
        singular_value_gap: all.gap,
        condition_number: condition_number(&kept_raw.iter().map(Vec::as_slice).collect::<Vec<_>>())?,
        scaled_condition_number: condition_number(&kept_scaled)?,
        kept_columns,
    })
}

/// State number `index` of a fixed sequence that fills the robot's limits evenly: multiples of the square roots of
/// primes, modulo 1, with one prime per coordinate (Kronecker sequence; Niederreiter 1992, chapter 3). The states are
/// the same on every machine.
#[must_use]
pub fn probe_state(robot: &Robot, index: usize) -> JointState {
    let mut coordinate = (2_u32..).filter(|p| is_prime(*p)).map(|p| {
        // Starting at 1 avoids the corner of all smallest values.
        ((index + 1) as f64 * f64::from(p).sqrt()).fract()
    });
    let mut within = |low: f64, high: f64| low + (high - low) * coordinate.next().unwrap_or(0.5);
    let mut state = JointState { q: Vec::new(), qd: Vec::new(), qdd: Vec::new() };
    for joint in &robot.joints {
        let limits = &joint.limits;
        state.q.push(within(limits.position_min, limits.position_max));
        state.qd.push(within(-limits.velocity, limits.velocity));
        state.qdd.push(within(-limits.acceleration, limits.acceleration));
    }
    state
}

/// Regressor of the probe states, `[n x p]` each, including friction under load. The bodies are those of the
/// description, or unit bodies: the choice does not change which columns depend on each other.
pub(crate) struct ProbeRegressor<'a> {
    robot: &'a Robot,
    bodies: DynamicModel,
    load: Vec<f64>,
    /// Regressor of the latest state.
    pub y: Regressor,
}

impl<'a> ProbeRegressor<'a> {
    pub(crate) fn new(robot: &'a Robot) -> Self {
        let mut bodies = DynamicModel::from_parameters(robot, std::iter::empty());
        for (body, joint) in bodies.inertial.iter_mut().zip(&robot.joints) {
            *body = joint.nominal.map_or(UNIT_BODY, |nominal| nominal.inertial);
        }
        bodies.grouped_motor_inertia.fill(0.0);
        Self { robot, bodies, load: vec![0.0; robot.joint_count()], y: Regressor::new(robot) }
    }

    /// Writes the regressor of [`probe_state`] number `index`.
    pub(crate) fn write(&mut self, index: usize) {
        let (robot, JointState { q, qd, qdd }) = (self.robot, probe_state(self.robot, index));
        joint_torque_regressor(robot, &q, &qd, &qdd, &mut self.y);
        if robot.has_load_friction() {
            self.bodies.gear_load(robot, &q, &qd, &qdd, &mut self.load);
            write_load_columns(robot, &qd, &self.load, &mut self.y);
        }
    }
}

fn is_prime(p: u32) -> bool {
    (2..p).take_while(|d| d * d <= p).all(|d| !p.is_multiple_of(d))
}

/// Triangular factor `[p x p]` of the regressor stacked over the probe states. Lengths of columns and angles between
/// them are the same, with a seventeenth of the rows.
fn probe_factor(robot: &Robot) -> Result<Mat<f64>, NumericsError> {
    let n = robot.joint_count();
    let mut w = Mat::<f64>::zeros(n * PROBE_STATES, robot.parameter_count());
    let mut probe = ProbeRegressor::new(robot);
    for index in 0..PROBE_STATES {
        probe.write(index);
        for c in 0..probe.y.columns() {
            for (j, value) in probe.y.column(c).iter().enumerate() {
                w[(n * index + j, c)] = *value;
            }
        }
    }
    let r = w.qr().thin_R().to_owned();
    if r.is_all_finite() {
        Ok(r)
    } else {
        Err(NumericsError::NotFinite("the regressor within the robot's limits"))
    }
}

fn column(r: &Mat<f64>, c: usize) -> Vec<f64> {
    r.col(c).iter().copied().collect()
}

/// Selection among unit-norm columns in order; values are indices of those columns.
struct Selection {
    /// Kept columns.
    kept: Vec<usize>,
    /// Each other column with its shares of the kept ones that precede it.
    dropped: Vec<(usize, Vec<f64>)>,
}

/// Parameters grouped into each kept column, in units of the parameters. `seen` are the regressor columns that the
/// selection indexes; `norms` and `ids` are those of all columns.
fn groupings(
    selection: &Selection,
    seen: &[usize],
    norms: &[f64],
    ids: &[ParameterId],
) -> Vec<Vec<GroupedParameter>> {
    let mut grouping = vec![Vec::new(); selection.kept.len()];
    for (dropped, shares) in &selection.dropped {
        let column = seen[*dropped];
        for (k, share) in shares.iter().enumerate().filter(|(_, share)| share.abs() > GROUPING_THRESHOLD) {
            let coefficient = share * norms[column] / norms[seen[selection.kept[k]]];
            grouping[k].push(GroupedParameter { id: ids[column], column, coefficient });
        }
    }
    grouping
}

/// Keeps the columns that are independent of those before them.
fn independent_columns(columns: &[Vec<f64>]) -> Selection {
    let mut basis = OrthonormalBasis::default();
    let mut factor: Vec<Vec<f64>> = Vec::new();
    let mut selection = Selection { kept: Vec::new(), dropped: Vec::new() };
    for (index, column) in columns.iter().enumerate() {
        let rest = basis.rest(column);
        if rest.length > INDEPENDENCE_THRESHOLD {
            factor.push(rest.along.iter().copied().chain([rest.length]).collect());
            basis.take(rest);
            selection.kept.push(index);
        } else {
            selection.dropped.push((index, back_substitute(&factor, rest.along)));
        }
    }
    selection
}

/// Solves `T x = b` for the upper triangular `T`, given by its columns down to the diagonal.
fn back_substitute(factor: &[Vec<f64>], mut b: Vec<f64>) -> Vec<f64> {
    for (k, column) in factor.iter().enumerate().take(b.len()).rev() {
        b[k] /= column[k];
        let x = b[k];
        b[..k].iter_mut().zip(column).for_each(|(b, t)| *b -= t * x);
    }
    b
}

struct ConfirmedRank {
    rank: usize,
    gap: SingularValueGap,
}

/// Counts the singular values of unit-norm columns and compares the count with the number of kept columns.
fn confirm_rank(kept: usize, columns: &[Vec<f64>]) -> Result<ConfirmedRank, NumericsError> {
    let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
    let values = singular_values(&columns)?;
    let rank = values.iter().filter(|&&s| s > INDEPENDENCE_THRESHOLD).count();
    let gap = SingularValueGap {
        smallest_kept: values.get(kept.wrapping_sub(1)).copied().unwrap_or(0.0),
        largest_dropped: values.get(kept).copied().unwrap_or(0.0),
    };
    if rank == kept {
        Ok(ConfirmedRank { rank, gap })
    } else {
        Err(NumericsError::RankUnclear {
            kept,
            rank,
            smallest_kept: gap.smallest_kept,
            largest_dropped: gap.largest_dropped,
        })
    }
}

/// Singular values, largest first.
fn singular_values(columns: &[&[f64]]) -> Result<Vec<f64>, NumericsError> {
    let rows = columns.first().map_or(0, |column| column.len());
    let matrix = Mat::from_fn(rows, columns.len(), |i, j| columns[j][i]);
    matrix.singular_values().map_err(|_| NumericsError::NotFinite("the singular values"))
}

/// Ratio of the largest to the smallest singular value; 1 without columns.
fn condition_number(columns: &[&[f64]]) -> Result<f64, NumericsError> {
    let values = singular_values(columns)?;
    Ok(match (values.first(), values.last()) {
        (Some(largest), Some(smallest)) => largest / smallest,
        _ => 1.0,
    })
}

/// Rounds to six significant digits for short output.
fn six_digits(x: f64) -> f64 {
    format!("{x:.5e}").parse().unwrap_or(x)
}

#[cfg(test)]
mod tests;
