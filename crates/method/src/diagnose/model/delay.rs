//! Search for a delay between torques and positions: the model is fitted to torques of earlier and later rows, all
//! joints together, with friction of any shape.

use super::friction_shapes::SHAPES;
use crate::identify::filtered_columns::FilteredColumn;
use crate::identify::joint_factors::FactorColumns;
use crate::identify::row_lanes::RowLanes;
use crate::lanes::{LANES, Lanes};
use crate::least_squares::factor::FactorBuilder;
use crate::signal::filter::FilteredSignals;
use crate::signal::time_grid::{POINTS, between};
use armwatch_model::robot::{JointIndex, Robot};

/// Largest delay of the search, s. Beyond it torque and motion are unrelated, which other checks find.
const LONGEST_S: f64 = 0.16;
/// Factor on the largest delay and on the steps, if no delay within the usual range is the best.
const FURTHER: f64 = 2.0;
/// Distance between the tried delays, s; a parabola interpolates.
const STEP_S: f64 = 0.01;

/// Best delay between the torque of a joint and its motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueDelay {
    /// The joint.
    pub joint: JointIndex,
    /// Delay of the torque, s; negative if it is early.
    pub delay: f64,
    /// Residual sum of squares at that delay, relative to that without a delay.
    pub residual_ratio: f64,
}

/// Best common delay between the torques of all joints and the motion.
#[derive(Debug, Clone, PartialEq)]
pub struct JointDelay {
    /// Delays of single joints, if the best one is inside the range.
    pub joints: Vec<TorqueDelay>,
    /// Number of joints with enough rows.
    pub judged: usize,
    /// Delay of all torques, s; negative if they are early.
    pub delay: f64,
    /// Geometric mean over the judged joints, weighted by rows, of the residual sum of squares at that delay,
    /// relative to that of the torques as recorded.
    pub residual_ratio: f64,
}

/// Common delay with which the joints' own columns explain all torques best, by the likelihood of each joint's residual
/// with a separate variance.
///
/// `filtered_coulomb_columns` are the low-passed columns of the robot that have jumps, `excitation` are usable rows in
/// order, and `shapes` `[n][SHAPES][rows]` are further columns of each joint, or empty. `None` if no joint has enough
/// rows, or if the outermost delay is the best.
#[must_use]
pub fn torque_delays(
    robot: &Robot,
    columns: &FactorColumns,
    kept_columns: &[usize],
    (filtered, filtered_coulomb_columns): (&FilteredSignals, &[FilteredColumn]),
    excitation: &[usize],
    shapes: &[Vec<Vec<f64>>],
) -> Option<JointDelay> {
    let within = |wider: f64| {
        delays_within(
            robot,
            columns,
            kept_columns,
            (filtered, filtered_coulomb_columns),
            excitation,
            (shapes, wider),
        )
    };
    within(1.0).or_else(|| within(FURTHER))
}

/// Searches delays up to `wider` times the usual range.
fn delays_within(
    robot: &Robot,
    columns: &FactorColumns,
    kept_columns: &[usize],
    (filtered, filtered_coulomb_columns): (&FilteredSignals, &[FilteredColumn]),
    excitation: &[usize],
    (shapes, wider): (&[Vec<Vec<f64>>], f64),
) -> Option<JointDelay> {
    let shifts = Shift::all(filtered.sample_rate, wider * STEP_S);
    let reach = (wider * LONGEST_S * filtered.sample_rate).ceil() as usize + POINTS;
    let apart = (filtered.sample_rate / (2.0 * filtered.cutoff)).ceil().max(1.0) as usize;
    let inside = |row: usize| {
        filtered.usable.iter().any(|s| s.contains(&(row.saturating_sub(reach))) && s.contains(&(row + reach)))
    };
    let rows: Vec<usize> =
        excitation.iter().copied().step_by(apart).filter(|&row| row >= reach && inside(row)).collect();
    let profiles =
        profiles(robot, columns, kept_columns, (filtered, filtered_coulomb_columns), &rows, &shifts, shapes);
    let judged: Vec<(JointIndex, Profile)> =
        robot.joint_indices().zip(profiles).filter_map(|(joint, profile)| Some((joint, profile?))).collect();
    let weight: f64 = judged.iter().map(|(_, profile)| profile.freedom).sum();
    let together = |k: usize| {
        let of_joint = |(_, profile): &(JointIndex, Profile)| profile.freedom * profile.squares[k].ln();
        (judged.iter().map(of_joint).sum::<f64>() / weight).exp()
    };
    let all: Vec<f64> = (0..shifts.len()).map(together).collect();
    let [delay, residual_ratio] = best(&all, wider * STEP_S)?;
    let of_joint = |(joint, profile): &(JointIndex, Profile)| {
        let [delay, residual_ratio] = best(&profile.squares, wider * STEP_S)?;
        Some(TorqueDelay { joint: *joint, delay, residual_ratio })
    };
    let joints = judged.iter().filter_map(of_joint).collect();
    Some(JointDelay { joints, judged: judged.len(), delay, residual_ratio })
}

/// Channel at a later time, by a polynomial through the neighbouring rows. Signals after the low-pass are smooth, so
/// delays of less than a row are measurable.
struct Shift {
    first: isize,
    weights: [f64; POINTS],
}

impl Shift {
    /// Shifts from [`LONGEST_S`] earlier to [`LONGEST_S`] later in steps of `step` s; wider steps extend the range.
    fn all(sample_rate: f64, step: f64) -> Vec<Self> {
        let steps = (LONGEST_S / STEP_S).round() as i32;
        let shift = |k: i32| {
            let rows = f64::from(k) * step * sample_rate;
            // shifts by whole rows reproduce the channel exactly
            let rows = if (rows - rows.round()).abs() < 1e-6 { rows.round() } else { rows };
            let before = rows.floor();
            Self { first: before as isize - 2, weights: between(rows - before) }
        };
        (-steps..=steps).map(shift).collect()
    }

    fn of(&self, channel: &[f64], rows: &[usize; LANES]) -> Lanes {
        let at = |row: usize| {
            let start = row.saturating_add_signed(self.first);
            let mut sum = 0.0;
            for (weight, value) in self.weights.iter().zip(&channel[start..][..POINTS]) {
                sum += weight * value;
            }
            sum
        };
        Lanes(rows.map(at))
    }
}

/// Residual sums of squares of a joint over the shifts, earliest first, and the degrees of freedom.
struct Profile {
    squares: Vec<f64>,
    freedom: f64,
}

/// Profiles of the joints with at least twice as many rows as columns.
fn profiles(
    robot: &Robot,
    columns: &FactorColumns,
    kept_columns: &[usize],
    (filtered, filtered_coulomb_columns): (&FilteredSignals, &[FilteredColumn]),
    rows: &[usize],
    shifts: &[Shift],
    shapes: &[Vec<Vec<f64>>],
) -> Vec<Option<Profile>> {
    let of_joint: Vec<Vec<usize>> = robot
        .joint_indices()
        .map(|joint| columns.places(joint).iter().map(|&place| kept_columns[place]).collect())
        .collect();
    let targets = shifts.len();
    let more = if shapes.is_empty() { 0 } else { SHAPES };
    let mut folders: Vec<FactorBuilder> =
        of_joint.iter().map(|columns| FactorBuilder::new(columns.len() + more + targets - 1)).collect();
    let rows = rows.iter().copied();
    RowLanes::new(robot).each(robot, filtered, filtered_coulomb_columns, rows, |at, taken| {
        let mut rows = [taken[0]; LANES];
        rows[..taken.len()].copy_from_slice(taken);
        for (j, folder) in folders.iter_mut().enumerate() {
            let w = of_joint[j].iter().map(|&column| at.y.get(j, column));
            let shaped = shapes.get(j).into_iter().flatten().map(|shape| Lanes(rows.map(|row| shape[row])));
            let torques = shifts.iter().map(|shift| shift.of(&filtered.tau[j], &rows));
            folder.push_lanes(w.chain(shaped).chain(torques), at.moving(robot, j, taken.len()));
        }
    });
    let profile = |(folder, columns): (&mut FactorBuilder, &Vec<usize>)| {
        let factor = folder.take();
        let b = columns.len() + more;
        let upper = factor.upper();
        let residual = |k: usize| (b..=b + k).map(|i| upper[(i, b + k)].powi(2)).sum::<f64>();
        (factor.rows() > 2 * b).then(|| Profile {
            squares: (0..targets).map(residual).collect(),
            freedom: (factor.rows() - b) as f64,
        })
    };
    folders.iter_mut().zip(&of_joint).map(profile).collect()
}

/// Delay, s, and residual relative to that without a delay, at the minimum of the parabola through the smallest
/// residual and its neighbours; `None` if the smallest is at either end.
fn best(profile: &[f64], step: f64) -> Option<[f64; 2]> {
    let middle = profile.len() / 2;
    let least = (0..profile.len()).min_by(|&a, &b| profile[a].total_cmp(&profile[b]))?;
    if least == 0 || least + 1 == profile.len() {
        return None;
    }
    let [before, at, after] = [profile[least - 1], profile[least], profile[least + 1]];
    let bend = before - 2.0 * at + after;
    let part = if bend > 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    let lowest = at - 0.25 * (before - after) * part;
    let delay = (least as f64 - middle as f64 + part) * step;
    let ratio = (lowest / profile[middle]).clamp(0.0, 1.0);
    ratio.is_finite().then_some([delay, ratio])
}
