//! Sufficient statistics of a cycle: one triangular factor for each joint, stage and motion.
//!
//! A joint's torque depends only on some base parameters: in a serial arm on those of the joint's link and the outer
//! links, and of the joint's friction and motor. So the rows of one joint are factored over the columns that can differ
//! from zero, which takes a third of the time and memory of factors over all columns. A union of rows is a join of
//! factors, and sums of squares need no recording.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::filtered_columns::FilteredColumn;
use super::row_lanes::RowLanes;
use crate::NumericsError;
use crate::least_squares::factor::{FactorBuilder, TriangularFactor, ZERO_COLUMN_THRESHOLD};
use crate::model::base_parameters::{BaseParameters, PROBE_STATES, ProbeRegressor};
use crate::signal::filter::FilteredSignals;
use crate::spare_threads::SpareThreads;
use armwatch_model::analysis::{CycleFactors, Motion, TorqueFactor};
use armwatch_model::robot::{JointIndex, ParameterId, Robot};
use armwatch_model::run::{Samples, Stage};

/// Parameters in the columns of each joint's factor, and their indices among all parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FactorColumns {
    kept: Vec<ParameterId>,
    by_joint: Arc<[Vec<ParameterId>]>,
    places: Vec<Vec<usize>>,
}

impl FactorColumns {
    /// Columns of a robot's joints, from its structure: a parameter that causes no torque at a joint in any probe state
    /// never does.
    #[must_use]
    pub fn new(robot: &Robot, base: &BaseParameters) -> Self {
        let n = robot.joint_count();
        let mut largest = vec![vec![0.0_f64; n]; base.kept_columns.len()];
        let mut probe = ProbeRegressor::new(robot);
        for index in 0..PROBE_STATES {
            probe.write(index);
            for (largest, &column) in largest.iter_mut().zip(&base.kept_columns) {
                largest.iter_mut().zip(probe.y.column(column)).for_each(|(max, x)| *max = max.max(x.abs()));
            }
        }
        let seen = |of: &[f64], joint: usize| {
            of[joint] > ZERO_COLUMN_THRESHOLD * of.iter().copied().fold(0.0, f64::max)
        };
        let places: Vec<Vec<usize>> =
            (0..n).map(|j| (0..largest.len()).filter(|&k| seen(&largest[k], j)).collect()).collect();
        let by_joint = places.iter().map(|of| of.iter().map(|&k| base.kept[k]).collect()).collect();
        Self { kept: base.kept.clone(), by_joint, places }
    }

    /// Columns of stored factors. The order of all parameters is by joint.
    #[must_use]
    pub fn of_stored(by_joint: &Arc<[Vec<ParameterId>]>) -> Self {
        let mut kept: Vec<ParameterId> = by_joint.iter().flatten().copied().collect();
        kept.sort_unstable();
        kept.dedup();
        let place = |id: &ParameterId| kept.binary_search(id).unwrap_or(0);
        let places = by_joint.iter().map(|of| of.iter().map(place).collect()).collect();
        Self { kept, by_joint: Arc::clone(by_joint), places }
    }

    /// Number of joints `n`.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.places.len()
    }

    /// All parameters `[b]`.
    #[must_use]
    pub fn kept(&self) -> &[ParameterId] {
        &self.kept
    }

    /// The parameters of each joint's factor, in the order of its columns.
    #[must_use]
    pub fn by_joint(&self) -> &Arc<[Vec<ParameterId>]> {
        &self.by_joint
    }

    /// Indices of a joint's columns among all `b`; empty for a joint that the arm does not have.
    #[must_use]
    pub fn places(&self, joint: JointIndex) -> &[usize] {
        self.places.get(joint.index()).map_or(&[], Vec::as_slice)
    }

    /// Values of `theta` `[b]` for a joint's factor.
    #[must_use]
    pub fn select(&self, joint: JointIndex, theta: &[f64]) -> Vec<f64> {
        self.places(joint).iter().map(|&place| theta[place]).collect()
    }

    /// Parameters as `theta` `[b]`.
    ///
    /// # Errors
    /// [`NumericsError::ColumnsDiffer`] unless the parameters are exactly those of the columns.
    pub fn theta(
        &self,
        parameters: impl IntoIterator<Item = (ParameterId, f64)>,
    ) -> Result<Vec<f64>, NumericsError> {
        let mut theta = vec![None; self.kept.len()];
        for (id, value) in parameters {
            let place = self.kept.iter().position(|kept| *kept == id).ok_or_else(|| {
                NumericsError::ColumnsDiffer(format!("parameter {id} has no column in these factors"))
            })?;
            theta[place] = Some(value);
        }
        let missing = |place: usize| {
            NumericsError::ColumnsDiffer(format!("these factors need parameter {}", self.kept[place]))
        };
        theta.into_iter().enumerate().map(|(place, value)| value.ok_or_else(|| missing(place))).collect()
    }
}

/// Factor of the rows of one joint in one stage, moving or slow.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFactor {
    /// The joint.
    pub joint: JointIndex,
    /// The stage.
    pub stage: Stage,
    /// Motion of the joint.
    pub motion: Motion,
    /// Factor of `[regressor | torque]` over the joint's columns.
    pub factor: TriangularFactor,
}

/// Factors of a cycle, without empty ones.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Factored {
    /// All rows of the cycle, each in one factor.
    pub factors: Vec<JointFactor>,
    /// Factors of the first third of the warming stage, by time, in addition to the above.
    pub warming_start: Vec<JointFactor>,
    /// Factors of its last third.
    pub warming_end: Vec<JointFactor>,
}

/// Folds the observed rows of a cycle into the factors of their joint, stage and motion. `regressor_columns` `[b]` are
/// the regressor's columns of [`FactorColumns::kept`]; `filtered_coulomb_columns` are those of them with jumps,
/// low-passed.
///
/// A joint's row is slow while the joint is below its low-speed threshold: at rest friction takes any value up to
/// breakaway, which no column describes (thesis 5.1.3).
#[must_use]
pub fn factor_cycle(
    robot: &Robot,
    columns: &FactorColumns,
    regressor_columns: &[usize],
    filtered: &FilteredSignals,
    filtered_coulomb_columns: &[FilteredColumn],
    samples: &Samples,
) -> Factored {
    let rows =
        FactoredRows { robot, columns, regressor_columns, filtered, filtered_coulomb_columns, samples };
    rows.factored(&SpareThreads::default())
}

/// Rows of a cycle to be factored: the arguments of [`factor_cycle`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct FactoredRows<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a FactorColumns,
    /// Regressor columns of [`FactorColumns::kept`], `[b]`.
    pub regressor_columns: &'a [usize],
    /// Signals after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Regressor columns with jumps, low-passed.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Recorded rows.
    pub samples: &'a Samples,
}

impl FactoredRows<'_> {
    /// Factors of the excitation only.
    #[must_use]
    pub fn factored_excitation(&self) -> Factored {
        let rows = self.filtered.observed_rows().filter(|&row| self.samples.stage[row] == Stage::Excitation);
        let factors = JointFactorBuilders::new(self).factor(Stage::Excitation, self.filtered, rows);
        Factored { factors, ..Factored::default() }
    }

    /// Factors of the excitation in `parts` consecutive parts of equal length.
    #[must_use]
    pub fn factored_parts(&self, parts: usize) -> Vec<Vec<JointFactor>> {
        let excitation = |row: &usize| self.samples.stage[*row] == Stage::Excitation;
        let rows: Vec<usize> = self.filtered.observed_rows().filter(excitation).collect();
        let mut builders = JointFactorBuilders::new(self);
        let length = rows.len().div_ceil(parts).max(1);
        rows.chunks(length)
            .map(|part| builders.factor(Stage::Excitation, self.filtered, part.iter().copied()))
            .collect()
    }

    /// Factors as from [`factor_cycle`], with stages on more threads while some are `spare`.
    #[must_use]
    pub fn factored(&self, spare: &SpareThreads) -> Factored {
        let of_stage = |stage: Stage| -> Vec<usize> {
            self.filtered.observed_rows().filter(|&row| self.samples.stage[row] == stage).collect()
        };
        let warming = of_stage(Stage::Warming);
        let [start, middle, end] = thirds(&warming, &self.samples.time);
        let others = [Stage::Friction, Stage::Excitation, Stage::Between].map(of_stage);
        let [friction, excitation, between] = &others;
        // longest first, so that threads end together
        let parts: [(Stage, &[usize]); 6] = [
            (Stage::Friction, friction),
            (Stage::Warming, start),
            (Stage::Warming, middle),
            (Stage::Warming, end),
            (Stage::Excitation, excitation),
            (Stage::Between, between),
        ];
        let begin = || JointFactorBuilders::new(self);
        let factors = spare.each(parts.len(), begin, |builders, part| {
            let (stage, rows) = parts[part];
            builders.factor(stage, self.filtered, rows.iter().copied())
        });
        let mut factors = factors.into_iter();
        let [friction, start, middle, end, excitation, between] =
            std::array::from_fn(|_| factors.next().unwrap_or_default());
        let mut factored =
            Factored { factors: [between, excitation, friction].concat(), ..Factored::default() };
        let parts = [&start, &middle, &end];
        for joint in self.robot.joint_indices() {
            for motion in Motion::BOTH {
                let mut factors = parts.iter().flat_map(|part| find(part, joint, motion));
                let Some(mut whole) = factors.next().cloned() else { continue };
                factors.for_each(|more| whole.factor.join(&more.factor));
                factored.factors.push(whole);
            }
        }
        factored.warming_start = start;
        factored.warming_end = end;
        factored
    }
}

fn find(factors: &[JointFactor], joint: JointIndex, motion: Motion) -> Option<&JointFactor> {
    factors.iter().find(|of| of.joint == joint && of.motion == motion)
}

/// Divides rows in order into three parts of equal time.
fn thirds<'a>(rows: &'a [usize], time: &[f64]) -> [&'a [usize]; 3] {
    let (Some(&first), Some(&last)) = (rows.first(), rows.last()) else { return [&[]; 3] };
    let third = (time[last] - time[first]) / 3.0;
    let start = rows.partition_point(|&row| time[row] < time[first] + third);
    let end = rows.partition_point(|&row| time[row] <= time[last] - third).max(start);
    [&rows[..start], &rows[start..end], &rows[end..]]
}

/// Builders for each joint and motion, reused for each stage.
struct JointFactorBuilders<'a> {
    robot: &'a Robot,
    /// Regressor columns in each joint's rows.
    regressor_columns: Vec<Vec<usize>>,
    filtered_coulomb_columns: &'a [FilteredColumn],
    lanes: RowLanes,
    by_joint: Vec<[FactorBuilder; 2]>,
}

impl<'a> JointFactorBuilders<'a> {
    fn new(rows: &FactoredRows<'a>) -> Self {
        let FactoredRows { robot, columns, regressor_columns, filtered_coulomb_columns, .. } = *rows;
        let of_joint = |places: &Vec<usize>| places.iter().map(|&k| regressor_columns[k]).collect();
        let regressor_columns: Vec<Vec<usize>> = columns.places.iter().map(of_joint).collect();
        let by_joint =
            regressor_columns.iter().map(|of| Motion::BOTH.map(|_| FactorBuilder::new(of.len()))).collect();
        Self { robot, regressor_columns, filtered_coulomb_columns, lanes: RowLanes::new(robot), by_joint }
    }

    fn factor(
        &mut self,
        stage: Stage,
        filtered: &FilteredSignals,
        rows: impl Iterator<Item = usize>,
    ) -> Vec<JointFactor> {
        let Self { robot, regressor_columns, filtered_coulomb_columns, lanes, by_joint } = self;
        lanes.each(robot, filtered, filtered_coulomb_columns, rows, |at, taken| {
            for (j, (folders, columns)) in by_joint.iter_mut().zip(&*regressor_columns).enumerate() {
                if !robot.joints[j].has_torque {
                    continue;
                }
                let low_speed = robot.joints[j].counted_speed();
                let motions = at.states.qd[j].0.map(|qd| Motion::of(qd, low_speed));
                for motion in Motion::BOTH {
                    let chosen = std::array::from_fn(|lane| lane < taken.len() && motions[lane] == motion);
                    let entries = columns.iter().map(|&column| at.y.get(j, column));
                    folders[motion as usize].push_lanes(entries.chain([at.tau[j]]), chosen);
                }
            }
        });
        let mut factors = Vec::new();
        for (joint, folders) in self.robot.joint_indices().zip(&mut self.by_joint) {
            for (motion, folder) in Motion::BOTH.into_iter().zip(folders) {
                let factor = folder.take();
                if factor.rows() > 0 {
                    factors.push(JointFactor { joint, stage, motion, factor });
                }
            }
        }
        factors
    }
}

/// Factor of each joint `[n]` over the chosen rows, `b` columns in the order of [`FactorColumns::kept`]; empty for a
/// joint without rows.
#[must_use]
pub fn embedded<'a>(
    columns: &FactorColumns,
    factors: impl IntoIterator<Item = &'a JointFactor>,
) -> Vec<TriangularFactor> {
    let b = columns.kept.len();
    let mut wide = vec![TriangularFactor::new(b); columns.joint_count()];
    for of in factors {
        let factor = TriangularFactor::embedded(b, [(&of.factor, columns.places(of.joint))]);
        let joint = &mut wide[of.joint.index()];
        if joint.rows() == 0 { *joint = factor } else { joint.join(&factor) }
    }
    wide
}

/// Returns true if a row is used for identification: in the excitation stage, while the joint moves.
#[must_use]
pub fn used_for_identification(stage: Stage, motion: Motion) -> bool {
    stage == Stage::Excitation && motion == Motion::Moving
}

/// Joins factors of cycles with the same columns into one for each joint, stage and motion, in this order. It gives
/// sums of squares over all cycles, but nothing about single cycles.
#[must_use]
pub fn joined(columns: &FactorColumns, factors: &[JointFactor]) -> Vec<JointFactor> {
    let mut groups: BTreeMap<(JointIndex, usize, usize), Vec<&JointFactor>> = BTreeMap::new();
    for of in factors {
        groups.entry((of.joint, of.stage as usize, of.motion as usize)).or_default().push(of);
    }
    let whole = |of: Vec<&JointFactor>| {
        let JointFactor { joint, stage, motion, .. } = *of[0];
        let places: Vec<usize> = (0..columns.places(joint).len()).collect();
        let parts = of.iter().map(|part| (&part.factor, &places[..]));
        JointFactor { joint, stage, motion, factor: TriangularFactor::embedded(places.len(), parts) }
    };
    groups.into_values().map(whole).collect()
}

/// Packs factors for storage. Factors with values that are not finite are omitted; the flag is `false` if there are
/// any.
#[must_use]
pub fn pack(columns: &FactorColumns, factors: &[JointFactor]) -> (CycleFactors, bool) {
    let sound = factors.iter().filter(|of| of.factor.is_finite());
    let packed: Vec<TorqueFactor> = sound
        .map(|of| TorqueFactor {
            joint: of.joint,
            stage: of.stage,
            motion: of.motion,
            rows: of.factor.rows(),
            upper: of.factor.packed(),
        })
        .collect();
    let complete = packed.len() == factors.len();
    (CycleFactors { columns: Arc::clone(&columns.by_joint), factors: packed }, complete)
}

/// Unpacks stored factors.
///
/// # Errors
/// Those of [`TriangularFactor::from_packed`], and [`NumericsError::ColumnsDiffer`] for a joint without columns.
pub fn unpack(stored: &CycleFactors) -> Result<Vec<JointFactor>, NumericsError> {
    let of_stored = |packed: &TorqueFactor| {
        let columns = stored.columns.get(packed.joint.index()).ok_or_else(|| {
            NumericsError::ColumnsDiffer(format!("no columns are known for joint {}", packed.joint))
        })?;
        let factor = TriangularFactor::from_packed(columns.len(), packed.rows, &packed.upper)?;
        let TorqueFactor { joint, stage, motion, .. } = *packed;
        Ok(JointFactor { joint, stage, motion, factor })
    };
    stored.factors.iter().map(of_stored).collect()
}

#[cfg(test)]
mod tests {
    use super::thirds;

    #[test]
    fn thirds_are_of_equal_time_and_lose_no_row() {
        let time: Vec<f64> = (0..10).map(f64::from).collect();
        let rows: Vec<usize> = (0..10).collect();
        assert_eq!(thirds(&rows, &time), [&rows[..3], &rows[3..7], &rows[7..]]);
        assert_eq!(thirds(&rows[..1], &time), [&rows[..0], &rows[..1], &rows[..0]]);
        assert_eq!(thirds(&[], &time), [&[] as &[usize]; 3]);
    }
}
