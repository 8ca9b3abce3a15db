//! Drive gains from two recordings of one arm, without and with a known load.
//!
//! A torque that is a current times a gain is wrong by the factor `s_j` = gain used over true gain. A recording without
//! load shows for joint `j` only `tau = w phi` with unknown `phi`, scaled by `s_j`: it does not distinguish parameters
//! from gain. The known change `d` of the parameters does:
//!
//! | recording | torque of joint `j` |
//! |---|---|
//! | without load | `tau = w phi + friction` |
//! | with load | `tau = w phi + s_j (w d) + friction` |
//!
//! The equations are linear in `phi` and `s_j`, and each joint is a separate problem. The noise of the torque stays on
//! its side of the equation. (With the gain as the unknown on the left it would not: Gautier & Briot 2014 need total
//! least squares.) Friction is free in every cycle: it changes with temperature and with the load, and the friction
//! that a load causes must not count as its weight.

use faer::MatRef;

use super::loaded_rows::{JointProblem, LoadedFactor, MIN_CYCLES, NEW_SHARE, RecordedCycle};
use crate::NumericsError;
use crate::identify::joint_factors::FactorColumns;
use crate::least_squares::factor::{TriangularFactor, ZERO_COLUMN_THRESHOLD};
use crate::least_squares::orthonormal::{OrthonormalBasis, dot, norm};
use crate::statistics::distributions::student_quantile;
use armwatch_model::robot::JointIndex;

/// Smallest share of the load's torque that the arm's own parameters cannot reproduce. Below a thousandth, the
/// recording without load does not determine the torque of the arm alone.
const APART_SHARE: f64 = 1e-3;

/// Largest half-width of the 95 % interval, relative to the factor, with which a factor is reported: catalogues give a
/// gain to a third.
pub const MAX_RELATIVE_HALF_WIDTH: f64 = 0.3;

/// Probability of the intervals.
const LEVEL: f64 = 0.95;

/// Drive gain of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct JointGain {
    /// The joint.
    pub joint: JointIndex,
    /// Factor, or the reason why there is none.
    pub estimate: Result<GainEstimate, Unseen>,
}

/// Ratio of the recorded to the true torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainEstimate {
    /// `s_j`: gain used over true gain.
    pub scale: f64,
    /// Standard error of `scale`.
    pub std_error: f64,
    /// Half the width of the 95 % interval of `scale`.
    pub half_width: f64,
    /// Source of the error.
    pub error_from: GainErrorSource,
    /// Root mean square of the load's torque over the rows with load, Nm (N).
    pub load_rms: f64,
    /// Standard deviation of the residual, Nm (N), as recorded.
    pub residual_std: f64,
    /// Number of cycles without and with load.
    pub cycles: [usize; 2],
}

impl GainEstimate {
    /// `1 / s_j`: the true gain is the used gain times this value.
    #[must_use]
    pub fn correction(&self) -> f64 {
        self.scale.recip()
    }

    /// Standard error of the correction: `sigma / s²`.
    #[must_use]
    pub fn correction_std_error(&self) -> f64 {
        self.std_error / (self.scale * self.scale)
    }

    /// 95 % interval of the correction: the interval of `s_j`, end by end.
    #[must_use]
    pub fn correction_interval(&self) -> [f64; 2] {
        [self.scale + self.half_width, self.scale - self.half_width].map(f64::recip)
    }
}

armwatch_model::named_enum! {
    /// Source of a standard error.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum GainErrorSource {
        /// Scatter between cycles, at least four per recording, by leaving out each in turn (jackknife in two strata).
        Cycles = "cycles",
        /// Residual of the rows that are independent after the low-pass, because there are too few cycles.
        Rows = "rows",
    }
}

/// Reason why a joint has no factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unseen {
    /// One of the recordings has no moving rows of the joint, or fewer rows than unknowns.
    NoRows,
    /// The load never causes a torque at the joint: the axis is vertical and the load does not turn about it, or the
    /// load is on the axis.
    NoTorque,
    /// The arm's own parameters can explain the load's torque: the joint moved differently without load.
    NotApart,
    /// The interval is wider than [`MAX_RELATIVE_HALF_WIDTH`] of the factor.
    TooWeak {
        /// Root mean square of the load's torque in the rows with load, Nm (N).
        load_rms: f64,
        /// Standard deviation of the residual, Nm (N).
        residual_std: f64,
        /// Standard error of the factor.
        std_error: f64,
    },
}

/// Factor of each joint, from cycles without and with a load that changes the base parameters by `change` `[b]`, in the
/// order of [`FactorColumns::kept`]. The cycles' factors must have these columns.
///
/// # Errors
/// [`NumericsError::TooShort`] without cycles of either kind, [`NumericsError::ColumnsDiffer`] if `change` does not
/// have one number per column.
pub fn drive_gains(
    columns: &FactorColumns,
    cycles: &[RecordedCycle],
    change: &[f64],
) -> Result<Vec<JointGain>, NumericsError> {
    if change.len() != columns.kept().len() {
        return Err(NumericsError::ColumnsDiffer(format!(
            "the load changes {} parameters, the factors have {}",
            change.len(),
            columns.kept().len()
        )));
    }
    for (loaded, what) in
        [(false, "the recording without load, in cycles,"), (true, "the recording with load, in cycles,")]
    {
        if cycles.iter().all(|cycle| cycle.loaded != loaded) {
            return Err(NumericsError::TooShort { what, rows: 0, needed: 1 });
        }
    }
    let joints = (0..columns.joint_count()).map(JointIndex::new);
    Ok(joints.map(|joint| JointGain { joint, estimate: gain_of(columns, cycles, change, joint) }).collect())
}

fn gain_of(
    columns: &FactorColumns,
    cycles: &[RecordedCycle],
    change: &[f64],
    joint: JointIndex,
) -> Result<GainEstimate, Unseen> {
    let problem = JointProblem::new(&columns.by_joint()[joint.index()], vec![columns.select(joint, change)]);
    let parts = problem.parts(cycles, joint);
    let count = |loaded: bool| parts.iter().filter(|part| part.loaded == loaded).count();
    let counts = [count(false), count(true)];
    if counts.contains(&0) {
        return Err(Unseen::NoRows);
    }
    let load_rows: f64 = parts.iter().filter(|part| part.loaded).map(|part| part.rows).sum();
    let load_rms = (parts.iter().map(|part| part.load_squares).sum::<f64>() / load_rows).sqrt();
    let rms = |sum: f64| (sum / parts.iter().map(|part| part.rows).sum::<f64>()).sqrt();
    let torque_rms = rms(parts.iter().map(|part| part.torque_squares).sum());
    if load_rms <= ZERO_COLUMN_THRESHOLD.sqrt() * torque_rms {
        return Err(Unseen::NoTorque);
    }
    let solved =
        scale_of(&joined(parts.iter().map(|part| &part.factor), &problem)).ok_or(Unseen::NotApart)?;
    let spent = solved.columns + parts.iter().map(|part| part.friction_columns).sum::<usize>();
    let rows: f64 = parts.iter().map(|part| part.rows).sum();
    let independent: f64 = parts.iter().map(|part| part.independent_rows).sum();
    let freedom = independent - spent as f64;
    if freedom < 1.0 {
        return Err(Unseen::NoRows);
    }
    let residual_std = (solved.residual_squares / (rows - spent as f64)).sqrt();
    let of_rows =
        ((solved.residual_squares / freedom / solved.information).sqrt(), freedom, GainErrorSource::Rows);
    let (std_error, freedom, error_from) = match jackknife(&parts, &problem) {
        Some((std_error, freedom)) => (std_error, freedom, GainErrorSource::Cycles),
        None => of_rows,
    };
    let half_width = student_quantile(0.5 + 0.5 * LEVEL, freedom) * std_error;
    let sharp = half_width <= MAX_RELATIVE_HALF_WIDTH * solved.scale.abs();
    if !sharp {
        return Err(Unseen::TooWeak { load_rms, residual_std, std_error });
    }
    let scale = solved.scale;
    Ok(GainEstimate { scale, std_error, half_width, error_from, load_rms, residual_std, cycles: counts })
}

fn joined<'a>(
    factors: impl Iterator<Item = &'a TriangularFactor>,
    problem: &JointProblem,
) -> TriangularFactor {
    let mut all = TriangularFactor::new(problem.columns());
    factors.for_each(|factor| all.join(factor));
    all
}

/// Solution for the last column of `w`.
struct LoadScale {
    scale: f64,
    /// Squared length of the load's column after the part that the others explain is removed.
    information: f64,
    residual_squares: f64,
    /// Number of columns used, including the load's.
    columns: usize,
}

/// Regression on the last column after the part that the others explain is removed (Frisch & Waugh 1933). Columns of
/// the arm that one joint's rows do not distinguish do no harm here, unlike in a solution for all columns. `None` if
/// too little of the column remains.
fn scale_of(factor: &TriangularFactor) -> Option<LoadScale> {
    let (r, b) = (factor.upper(), factor.columns());
    let column = |k: usize, r: MatRef<'_, f64>| r.col(k).iter().copied().collect::<Vec<f64>>();
    let mut basis = OrthonormalBasis::default();
    (0..b - 1).for_each(|k| basis.add(&column(k, r), NEW_SHARE));
    let load = column(b - 1, r);
    let whole = norm(&load);
    let load = basis.rest(&load).vector;
    let information = dot(&load, &load);
    if information.sqrt() <= APART_SHARE * whole {
        return None;
    }
    let torque = basis.rest(&column(b, r)).vector;
    let scale = load.iter().zip(&torque).map(|(l, t)| l * t).sum::<f64>() / information;
    let residual_squares = load.iter().zip(&torque).map(|(l, t)| (t - scale * l).powi(2)).sum();
    Some(LoadScale { scale, information, residual_squares, columns: basis.rank() + 1 })
}

/// Standard error and its degrees of freedom from leaving out each cycle in turn: in each recording `(n-1)/n` times the
/// sum of squared deviations (Shao & Tu 1995, 6.2), and the degrees of freedom of Satterthwaite (1946). `None` with too
/// few cycles, or if a single cycle decides everything.
fn jackknife(parts: &[LoadedFactor], problem: &JointProblem) -> Option<(f64, f64)> {
    let mut before = vec![TriangularFactor::new(problem.columns())];
    for part in parts {
        before.push(joined([before.last()?, &part.factor].into_iter(), problem));
    }
    let mut after = TriangularFactor::new(problem.columns());
    let mut without = [Vec::new(), Vec::new()];
    for (part, before) in parts.iter().zip(&before).rev() {
        let scale = scale_of(&joined([before, &after].into_iter(), problem))?.scale;
        without[usize::from(part.loaded)].push(scale);
        after.join(&part.factor);
    }
    let (mut variance, mut spread) = (0.0, 0.0);
    for scales in &without {
        let n = scales.len() as f64;
        if scales.len() < MIN_CYCLES {
            return None;
        }
        let mean = scales.iter().sum::<f64>() / n;
        let of_recording = (n - 1.0) / n * scales.iter().map(|s| (s - mean).powi(2)).sum::<f64>();
        variance += of_recording;
        spread += of_recording * of_recording / (n - 1.0);
    }
    (variance > 0.0 && variance.is_finite()).then(|| (variance.sqrt(), variance * variance / spread))
}

#[cfg(test)]
mod tests;
