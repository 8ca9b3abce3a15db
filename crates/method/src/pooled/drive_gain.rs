//! Drive gains from two recordings of one arm, without and with a known load.
//!
//! A torque that is a current times a gain is wrong by the factor `s_j` = gain used over true gain. All that
//! a recording without load shows of joint `j` is then `tau = w phi` with unknown `phi`, scaled by `s_j`
//! itself: parameters and gain cannot be told apart. The known change `d` of the parameters can:
//!
//! | recording | torque of joint `j` |
//! |---|---|
//! | without load | `tau = w phi + friction` |
//! | with load | `tau = w phi + s_j (w d) + friction` |
//!
//! It is linear in `phi` and `s_j`, each joint is a problem of its own, and the noise of the torque stays on
//! its side of the equation (with the gain as the unknown on the left it would not: Gautier & Briot 2014
//! need total least squares). Friction is free in every cycle: it changes with warmth and with the load, and
//! what a load adds to friction must not pass for its weight.

use faer::{Mat, MatRef};

use crate::NumericsError;
use crate::identify::joint_factors::{FactorColumns, JointFactor, used_for_identification};
use crate::least_squares::factor::{TriangularFactor, ZERO_COLUMN_THRESHOLD};
use crate::least_squares::orthonormal::{OrthonormalBasis, dot, norm};
use crate::model::base_parameters::BaseParameters;
use crate::statistics::distributions::student_quantile;
use armwatch_model::robot::{
    CouplingTerm, JointIndex, ParameterId, ParameterKind, Robot, StandardParameters,
};

/// Share of a unit-norm column that must be new for it to count as another one: far above the rounding of
/// a factor (1e-13), far below what any motion leaves of a parameter that it shows.
const NEW_SHARE: f64 = 1e-8;

/// Share of the load's torque that must differ from what the arm's own parameters could do: below a
/// thousandth, the recording without load does not say what the arm alone would need.
const APART_SHARE: f64 = 1e-3;

/// Half the 95 % interval over the factor beyond which none is given: catalogues know a gain to a third.
pub const MAX_RELATIVE_HALF_WIDTH: f64 = 0.3;

/// Fewest cycles of each recording whose scatter gives the error: Student's quantile for three degrees of
/// freedom is still worth having.
const MIN_CYCLES: usize = 4;

/// Probability of the intervals.
const LEVEL: f64 = 0.95;

/// What one cycle says: its factors and whether the load was on.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedCycle {
    /// Whether the load was on.
    pub loaded: bool,
    /// The cycle's factors; those of moving rows of the excitation stage are used.
    pub factors: Vec<JointFactor>,
    /// Share of each joint's rows that are independent, `[n]`
    /// ([`JointResidual::independent_share`](armwatch_model::analysis::JointResidual::independent_share)); a missing one
    /// counts as 1.
    pub independent_shares: Vec<f64>,
}

/// Drive gain of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct JointGain {
    /// The joint.
    pub joint: JointIndex,
    /// The factor, or why there is none.
    pub estimate: Result<GainEstimate, Unseen>,
}

/// The factor between the torque as recorded and the true one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GainEstimate {
    /// `s_j`: gain used over true gain.
    pub scale: f64,
    /// Its standard error.
    pub std_error: f64,
    /// Half the width of its 95 % interval.
    pub half_width: f64,
    /// Where the error comes from.
    pub error_from: GainErrorSource,
    /// Root mean square of the load's torque over the rows with load, Nm (N).
    pub load_rms: f64,
    /// Standard deviation of the residual, Nm (N), as recorded.
    pub residual_std: f64,
    /// Cycles without and with load.
    pub cycles: [usize; 2],
}

impl GainEstimate {
    /// `1 / s_j`: the true gain is the one used times this.
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

/// What a standard error stands on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GainErrorSource {
    /// The scatter from cycle to cycle, of which both recordings have at least four: each is left out in
    /// turn (jackknife in two strata).
    Cycles,
    /// The residual of the rows, as many as the low-pass leaves independent: too few cycles.
    Rows,
}

impl GainErrorSource {
    /// Name for people and scripts.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Cycles => "cycles",
            Self::Rows => "rows",
        }
    }
}

/// Why a joint has no factor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unseen {
    /// One of the recordings has no rows in which the joint moves, or fewer than unknowns.
    NoRows,
    /// The load never gives the joint torque: a vertical axis that the load does not turn about, or a load
    /// on the axis.
    NoTorque,
    /// The load's torque is one that the arm's own parameters could give: without load the joint did not
    /// move as with it.
    NotApart,
    /// The interval is wider than [`MAX_RELATIVE_HALF_WIDTH`] of the factor.
    TooWeak {
        /// Root mean square of the load's torque with load, Nm (N).
        load_rms: f64,
        /// Standard deviation of the residual, Nm (N).
        residual_std: f64,
        /// Standard error of the factor.
        std_error: f64,
    },
}

/// The change of the base parameters `[b]` that a load brings, in the order of [`BaseParameters::kept`].
/// `load` are its ten parameters about the frame of the last link: [`StandardParameters::seen_from`] takes
/// them there.
#[must_use]
pub fn load_change(robot: &Robot, base: &BaseParameters, load: &StandardParameters) -> Vec<f64> {
    let mut phi = vec![0.0; robot.parameter_count()];
    let first = StandardParameters::COUNT * robot.joint_count().saturating_sub(1);
    if let Some(last) = phi.get_mut(first..first + StandardParameters::COUNT) {
        last.copy_from_slice(&load.0);
    }
    base.group(&phi)
}

/// The factor of each joint, from cycles without and with a load that changes the base parameters by
/// `change` `[b]`, in the order of [`FactorColumns::kept`]. The cycles' factors must have these columns.
///
/// # Errors
/// [`NumericsError::TooShort`] without cycles of either kind, [`NumericsError::ColumnsDiffer`] if
/// `change` is not one number a column.
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
    let problem = JointProblem::new(&columns.by_joint()[joint.index()], columns.select(joint, change));
    let parts: Vec<Part> = cycles.iter().flat_map(|cycle| problem.parts(cycle, joint)).collect();
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

/// The columns of one joint: those of its rows that are the arm's, those that are friction, and the
/// change that the load brings, `[columns of the joint]`.
struct JointProblem {
    arm: Vec<usize>,
    friction: Vec<usize>,
    change: Vec<f64>,
}

/// What one cycle says of one joint, friction taken out.
struct Part {
    loaded: bool,
    /// Of `[w_arm, w d | tau]`, each less what the cycle's friction columns explain of it; `w d` is zero
    /// without load.
    factor: TriangularFactor,
    rows: f64,
    independent_rows: f64,
    friction_columns: usize,
    /// Sum of squares of the load's torque, Nm².
    load_squares: f64,
    /// Sum of squares of the torque, Nm².
    torque_squares: f64,
}

impl JointProblem {
    fn new(ids: &[ParameterId], change: Vec<f64>) -> Self {
        let (friction, arm) = (0..ids.len()).partition(|&k| is_friction(ids[k].kind));
        Self { arm, friction, change }
    }

    fn parts<'a>(&'a self, cycle: &'a RecordedCycle, joint: JointIndex) -> impl Iterator<Item = Part> + 'a {
        let chosen =
            move |of: &&JointFactor| of.joint == joint && used_for_identification(of.stage, of.motion);
        cycle.factors.iter().filter(chosen).map(|of| self.part(cycle, of))
    }

    fn part(&self, cycle: &RecordedCycle, of: &JointFactor) -> Part {
        let share = cycle.independent_shares.get(of.joint.index()).copied().unwrap_or(1.0);
        let of = &of.factor;
        let (r, b) = (of.upper(), of.columns());
        let column = |k: usize| r.col(k).iter().copied().collect::<Vec<f64>>();
        let mut load = vec![0.0; b + 1];
        for (k, d) in self.change.iter().enumerate().filter(|(_, d)| cycle.loaded && **d != 0.0) {
            load.iter_mut().zip(column(k)).for_each(|(sum, w)| *sum += w * d);
        }
        let squares = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>();
        let (load_squares, torque_squares) = (squares(&load), squares(&column(b)));
        let mut basis = OrthonormalBasis::default();
        self.friction.iter().for_each(|&k| basis.add(&column(k), NEW_SHARE));
        let others = self.arm.iter().map(|&k| column(k)).chain([load, column(b)]);
        let left: Vec<Vec<f64>> = others.map(|x| basis.rest(&x).vector).collect();
        let mut factor = TriangularFactor::new(left.len() - 1);
        factor.fold(Mat::from_fn(b + 1, left.len(), |i, k| left[k][i]).as_ref());
        let rows = of.rows() as f64;
        Part {
            loaded: cycle.loaded,
            factor,
            rows,
            independent_rows: rows * share,
            friction_columns: basis.rank(),
            load_squares,
            torque_squares,
        }
    }
}

/// Whether a parameter may change from cycle to cycle.
fn is_friction(kind: ParameterKind) -> bool {
    match kind {
        ParameterKind::Friction(_) => true,
        ParameterKind::Coupling(term) => term != CouplingTerm::Inertia,
        ParameterKind::Inertial(_)
        | ParameterKind::MotorInertia
        | ParameterKind::Spring(_)
        | ParameterKind::Crank(_) => false,
    }
}

fn joined<'a>(
    factors: impl Iterator<Item = &'a TriangularFactor>,
    problem: &JointProblem,
) -> TriangularFactor {
    let mut all = TriangularFactor::new(problem.arm.len() + 1);
    factors.for_each(|factor| all.join(factor));
    all
}

/// Solution for the last column of `w` alone.
struct LoadScale {
    scale: f64,
    /// Squared length of the load's column, less what the others explain.
    information: f64,
    residual_squares: f64,
    /// Columns used, the load's included.
    columns: usize,
}

/// Regression on the last column less what the others explain of it (Frisch & Waugh 1933): columns of
/// the arm that one joint's rows do not tell apart do no harm, as they would to solving for all. `None`
/// if too little of the column is left.
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

/// Standard error and its degrees of freedom from leaving out one cycle after the other: in each
/// recording `(n-1)/n` times the sum of squared deviations (Shao & Tu 1995, 6.2), the degrees of
/// freedom after Satterthwaite (1946). `None` with too few cycles, or where a single cycle decides
/// everything.
fn jackknife(parts: &[Part], problem: &JointProblem) -> Option<(f64, f64)> {
    let mut before = vec![TriangularFactor::new(problem.arm.len() + 1)];
    for part in parts {
        before.push(joined([before.last()?, &part.factor].into_iter(), problem));
    }
    let mut after = TriangularFactor::new(problem.arm.len() + 1);
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
