//! Payload of an arm, from recordings of the same motion without and with it.
//!
//! The torque that a load adds to joint `j` is linear in its ten parameters `d`, and the drive's gain is off by an
//! unknown factor `s_j` = gain used over true gain ([`super::drive_gain`]):
//!
//! ```text
//! tau_j = w_j phi_j + s_j X_j d + friction of the cycle
//! ```
//!
//! Each joint has its own arm parameters `phi_j`, since its gain scales them too, so the error of the empty model is
//! part of the error of `d`. Products `s_j d` do not change if all gains grow by `c` and the load shrinks by it. The
//! ratios of the gains follow from the joints that carry the same load; their common factor `c` follows only from the
//! stated bound `u`: each `s_j` is anywhere within `1 ± u`, with equal probability. With `ŝ_j ± e_j` from the rows:
//!
//! ```text
//! p(c) ~ c^(n-1) prod_j [ Phi((1 + u - c ŝ_j) / (c e_j)) - Phi((1 - u - c ŝ_j) / (c e_j)) ]
//! ```
//!
//! Intervals are quantiles of the mixture over `c`. The prior of the ratios is a normal distribution with the
//! variance of the uniform one, which makes intervals of centre and inertia too wide. That of the mass is the hull of the mixture
//! and of the one that follows if all gains have one error in common.

use nalgebra::{DMatrix, DVector, Vector3};

use super::loaded_rows::{JointProblem, LoadedFactor, MIN_CYCLES, NEW_SHARE, RecordedCycle, load_change};
use crate::NumericsError;
use crate::identify::joint_factors::FactorColumns;
use crate::least_squares::orthonormal::{OrthonormalBasis, dot};
use crate::model::base_parameters::BaseParameters;
use crate::statistics::distributions::{normal_probability, student_quantile};
use armwatch_model::robot::{JointIndex, Robot, StandardParameters};

/// Prior standard deviations of a load: mass, kg, first moments, kg m, and inertia, kg m². They are wide for the load
/// of an arm of about ten kilograms.
pub(crate) const LOAD_PRIOR: [f64; LOAD] = [20.0, 5.0, 5.0, 5.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0];
/// Number of parameters of a load.
const LOAD: usize = StandardParameters::COUNT;

/// Probability of the intervals.
const LEVEL: f64 = 0.95;
/// Smallest bound of a gain; keeps the sums finite for exact gains.
const LEAST_BOUND: f64 = 1e-4;
/// Largest bound: gains with a larger error are wrong settings.
const LARGEST_BOUND: f64 = 0.9;
/// Factor for widening a bound if the joints contradict it.
const WIDER: f64 = 1.1;
/// Logarithm of the agreement of gains with their bounds below which the joints contradict them.
const LEAST_AGREEMENT: f64 = -8.0;
/// Standard deviation of a ratio without any other information, in bounds.
const FREE_BOUNDS: f64 = 10.0;
/// Number of points in sums over the common factor of the gains.
const PLACES: u32 = 400;
/// Largest number of steps of the fit; about six are usual.
const MAX_STEPS: usize = 60;
/// Largest change, relative to its scale, of a converged fit.
const CONVERGED: f64 = 1e-10;
/// Number of halvings in the search for a quantile.
const HALVINGS: usize = 60;
/// Largest half-width of the interval of a mass, kg, that shows even a mass of zero.
const SHOWN_MASS: f64 = 1.0;
/// Largest half-width of the interval of a centre, m, that shows it: the size of a hand.
const SHOWN_CENTRE: f64 = 0.1;

/// Quantity with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
    /// True if the motion shows the quantity.
    pub is_shown: bool,
}

impl Interval {
    fn half_width(&self) -> f64 {
        0.5 * (self.high - self.low)
    }
}

/// Payload of an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct Payload {
    /// Mass, kg.
    pub mass: Interval,
    /// Centre of mass in the tool frame, m.
    pub centre: [Interval; 3],
    /// Inertia about the centre of mass, axes of the tool frame, kg m²: `xx`, `xy`, `xz`, `yy`, `yz`, `zz`.
    pub inertia: [Interval; 6],
    /// Bound of the relative error of each gain in the intervals: the stated one, or the smallest that agrees with the
    /// joints.
    pub gain_bound: f64,
    /// Number of cycles without and with the load.
    pub cycles: [usize; 2],
}

/// Load that the loaded recordings have and the others lack. `gain_bound` is the largest relative error of a drive
/// gain, 0 to below 1.
///
/// # Errors
/// [`NumericsError::TooShort`] without moving rows of either kind, [`NumericsError::ColumnsDiffer`] if the factors are
/// not over the base parameters of `robot`, [`NumericsError::NotFinite`] if the rows give no finite result.
pub fn payload(
    robot: &Robot,
    base: &BaseParameters,
    columns: &FactorColumns,
    cycles: &[RecordedCycle],
    gain_bound: f64,
) -> Result<Payload, NumericsError> {
    let mut changes = Vec::new();
    for (k, scale) in LOAD_PRIOR.iter().enumerate() {
        let mut unit = StandardParameters::default();
        unit.0[k] = *scale;
        let change = load_change(robot, base, &unit.seen_from(&robot.tool));
        changes.push(columns.theta(base.kept.iter().copied().zip(change))?);
    }
    let joint = |j: usize| JointLoad::of(columns, cycles, &changes, JointIndex::new(j));
    let joints: Vec<JointLoad> = (0..columns.joint_count()).filter_map(joint).collect();
    if joints.is_empty() {
        return Err(NumericsError::TooShort {
            what: "the excitation without and with the load, in moving rows of any joint,",
            rows: 0,
            needed: LOAD,
        });
    }
    let counts = [false, true].map(|loaded| cycles.iter().filter(|cycle| cycle.loaded == loaded).count());
    let bound = gain_bound.clamp(LEAST_BOUND, LARGEST_BOUND);
    GainFit::of(&joints, bound)?.payload(&joints, bound, counts)
}

/// Rows of one joint as a function of the load, without the part that the arm's own parameters explain.
struct JointLoad {
    /// Cycles: index, true if loaded, `XᵀX` `[10 x 10]` and `Xᵀtau` `[10]` over its rows.
    cycles: Vec<(usize, bool, DMatrix<f64>, DVector<f64>)>,
    /// Sums of these over all cycles.
    gram: DMatrix<f64>,
    score: DVector<f64>,
    /// Inverse variance of a row that counts as independent, 1/Nm².
    weight: f64,
}

impl JointLoad {
    /// Collects the rows of a joint; `None` for a joint without rows of either kind, or with fewer rows than unknowns.
    fn of(
        columns: &FactorColumns,
        cycles: &[RecordedCycle],
        changes: &[Vec<f64>],
        joint: JointIndex,
    ) -> Option<Self> {
        let own = changes.iter().map(|change| columns.select(joint, change)).collect();
        let problem = JointProblem::new(columns.by_joint().get(joint.index())?, own);
        let parts = problem.parts(cycles, joint);
        if [false, true].iter().any(|loaded| parts.iter().all(|part| part.loaded != *loaded)) {
            return None;
        }
        let column = |k: usize| -> Vec<f64> {
            parts.iter().flat_map(|part| part.factor.upper().col(k).iter().copied()).collect()
        };
        let arm = problem.arm.len();
        let mut basis = OrthonormalBasis::default();
        (0..arm).for_each(|k| basis.add(&column(k), NEW_SHARE));
        let left: Vec<Vec<f64>> = (arm..=problem.columns()).map(|k| basis.rest(&column(k)).vector).collect();
        let height = problem.columns() + 1;
        let of_part = |(at, part): (usize, &LoadedFactor)| {
            let rows = at * height..(at + 1) * height;
            let product = |i: usize, k: usize| dot(&left[i][rows.clone()], &left[k][rows.clone()]);
            let gram = DMatrix::from_fn(LOAD, LOAD, product);
            (part.cycle, part.loaded, gram, DVector::from_fn(LOAD, |i, _| product(i, LOAD)))
        };
        let cycles: Vec<_> = parts.iter().enumerate().map(of_part).collect();
        let gram: DMatrix<f64> = cycles.iter().map(|(_, _, gram, _)| gram).sum();
        let score: DVector<f64> = cycles.iter().map(|(_, _, _, score)| score).sum();
        let (explained, rank) = explained(&gram, &score);
        let spent = basis.rank() + rank + parts.iter().map(|part| part.friction_columns).sum::<usize>();
        let freedom = parts.iter().map(|part| part.independent_rows).sum::<f64>() - spent as f64;
        let squares = dot(&left[LOAD], &left[LOAD]);
        let rest = (squares - explained).max(f64::EPSILON * squares);
        let weight = freedom / rest;
        (freedom >= 1.0 && weight.is_finite() && rank > 0).then_some(Self { cycles, gram, score, weight })
    }
}

/// Squares that the load's columns explain, and the number of independent columns.
fn explained(gram: &DMatrix<f64>, score: &DVector<f64>) -> (f64, usize) {
    let eigen = gram.clone().symmetric_eigen();
    let least = NEW_SHARE * eigen.eigenvalues.max();
    let along = eigen.eigenvectors.transpose() * score;
    let pairs = || eigen.eigenvalues.iter().zip(along.iter()).filter(|(value, _)| **value > least);
    (pairs().map(|(value, along)| along * along / value).sum(), pairs().count())
}

/// Gains of the joints and the load in units of [`LOAD_PRIOR`], `[joints + 10]`.
struct GainFit {
    at: DVector<f64>,
    /// Covariances at a fixed common factor of the gains, with their degrees of freedom: of the cycles without and with
    /// the load, or of all rows; then the part of the ratios that only the bounds determine.
    covariances: Vec<(DMatrix<f64>, f64)>,
    /// Standard deviations of the gains' ratios from the rows alone.
    ratio_errors: Vec<f64>,
}

impl GainFit {
    /// Gauss-Newton fit of the weighted squares of all joints, with a prior of gains at one.
    fn of(joints: &[JointLoad], bound: f64) -> Result<Self, NumericsError> {
        let n = joints.len();
        let prior = 3.0 / (bound * bound);
        let start = joints.iter().fold(DMatrix::identity(LOAD, LOAD), |sum, of| sum + &of.gram * of.weight);
        let right = joints.iter().fold(DVector::zeros(LOAD), |sum, of| sum + &of.score * of.weight);
        let nothing = || NumericsError::NotFinite("the load");
        let load = start.cholesky().ok_or_else(nothing)?.solve(&right);
        let mut at = DVector::from_fn(n + LOAD, |k, _| if k < n { 1.0 } else { load[k - n] });
        for _ in 0..MAX_STEPS {
            let mut slope = DVector::zeros(n + LOAD);
            for (j, of) in joints.iter().enumerate() {
                slope += score(&at, n, j, of.weight, &of.gram, &of.score);
            }
            (0..n).for_each(|j| slope[j] += prior * (1.0 - at[j]));
            (n..n + LOAD).for_each(|k| slope[k] -= at[k]);
            let step = information(joints, &at, prior).cholesky().ok_or_else(nothing)?.solve(&slope);
            at += &step;
            if step.amax() < CONVERGED * at.amax() {
                break;
            }
        }
        if !at.iter().all(|value| value.is_finite()) {
            return Err(nothing());
        }
        let at_fixed_factor = |prior: f64| {
            let mut whole = information(joints, &at, prior);
            let gains = at.rows(0, n).normalize();
            let fixed = whole.trace() + prior;
            for i in 0..n {
                (0..n).for_each(|k| whole[(i, k)] += fixed * gains[i] * gains[k]);
            }
            whole.try_inverse().ok_or_else(nothing)
        };
        let of_rows = information(joints, &at, 0.0);
        let scatter = of_cycles(joints, &at).unwrap_or_else(|| vec![(of_rows, f64::INFINITY)]);
        let seen_in = |inverse: &DMatrix<f64>, scores: &DMatrix<f64>| inverse * scores * inverse;
        let bounds = DMatrix::from_fn(n + LOAD, n + LOAD, |i, k| match i == k {
            true if i < n => prior,
            true => 1.0,
            false => 0.0,
        });
        let inverse = at_fixed_factor(prior)?;
        let free = at_fixed_factor(3.0 / (FREE_BOUNDS * bound).powi(2))?;
        let ratio_error = |j: usize| {
            let own: f64 = scatter.iter().map(|(scores, _)| seen_in(&free, scores)[(j, j)]).sum();
            let of_bounds = free[(j, j)] * free[(j, j)] * 3.0 / (FREE_BOUNDS * bound).powi(2);
            (own + of_bounds).sqrt()
        };
        let ratio_errors = (0..n).map(ratio_error).collect();
        let of_bounds = (bounds, f64::INFINITY);
        let covariances = scatter
            .iter()
            .chain([&of_bounds])
            .map(|(scores, freedom)| (seen_in(&inverse, scores), *freedom))
            .collect();
        Ok(Self { at, covariances, ratio_errors })
    }

    fn payload(
        &self,
        joints: &[JointLoad],
        bound: f64,
        cycles: [usize; 2],
    ) -> Result<Payload, NumericsError> {
        let n = joints.len();
        let gains: Vec<f64> = self.at.iter().take(n).copied().collect();
        // without a load, the ratios of gains are ratios of errors and contradict no bound
        let mass_error = self.covariances.iter().map(|(of, _)| of[(n, n)]).sum::<f64>().sqrt();
        let has_load = self.at[n].abs() > student_quantile(0.5 + 0.5 * LEVEL, f64::INFINITY) * mass_error;
        let mut gain_bound = bound;
        let factors = loop {
            let found = CommonFactor::of(&gains, &self.ratio_errors, gain_bound);
            if found.agreement >= LEAST_AGREEMENT || gain_bound >= LARGEST_BOUND || !has_load {
                break found;
            }
            gain_bound *= WIDER;
        };
        let load: [f64; LOAD] = std::array::from_fn(|k| LOAD_PRIOR[k] * self.at[n + k]);
        let values = quantities(&load);
        let interval = |which: usize| {
            // central differences over a small part of the standard deviation
            let slope = DVector::from_fn(LOAD, |k, _| {
                let variance: f64 = self.covariances.iter().map(|(of, _)| of[(n + k, n + k)]).sum();
                let step = 1e-3 * LOAD_PRIOR[k] * variance.sqrt();
                let moved = |by: f64| {
                    let mut moved = load;
                    moved[k] += by;
                    quantities(&moved)[which]
                };
                if step > 0.0 { LOAD_PRIOR[k] * (moved(step) - moved(-step)) / (2.0 * step) } else { 0.0 }
            });
            let parts = self.covariances.iter().map(|(of, freedom)| {
                let own = of.view((n, n), (LOAD, LOAD));
                ((slope.transpose() * own * &slope)[(0, 0)].max(0.0), *freedom)
            });
            let parts: Vec<(f64, f64)> = parts.collect();
            let variance: f64 = parts.iter().map(|(variance, _)| variance).sum();
            let freedom = variance * variance
                / parts.iter().map(|(variance, freedom)| variance * variance / freedom).sum::<f64>();
            let normal = student_quantile(0.5 + 0.5 * LEVEL, f64::INFINITY);
            let wider =
                if freedom.is_finite() { student_quantile(0.5 + 0.5 * LEVEL, freedom) / normal } else { 1.0 };
            // a centre is a ratio, which does not depend on the common factor of the gains
            let scales = !(1..4).contains(&which);
            factors.interval(values[which], wider * variance.sqrt(), scales)
        };
        let all: [Interval; LOAD] = std::array::from_fn(interval);
        if all.iter().any(|of| of.value.is_nan()) {
            return Err(NumericsError::NotFinite("the load"));
        }
        Ok(shown(all, gain_bound, cycles))
    }
}

/// Slope of the weighted squares of one joint's rows, `[joints + 10]`.
fn score(
    at: &DVector<f64>,
    n: usize,
    j: usize,
    weight: f64,
    gram: &DMatrix<f64>,
    score: &DVector<f64>,
) -> DVector<f64> {
    let load = at.rows(n, LOAD);
    let rest = score - gram * load * at[j];
    let mut slope = DVector::zeros(n + LOAD);
    slope[j] = weight * load.dot(&rest);
    slope.rows_mut(n, LOAD).copy_from(&(rest * (weight * at[j])));
    slope
}

/// Information of all rows, plus `prior` for each gain, `[joints + 10]²`.
fn information(joints: &[JointLoad], at: &DVector<f64>, prior: f64) -> DMatrix<f64> {
    let n = joints.len();
    let load = at.rows(n, LOAD);
    let mut whole = DMatrix::zeros(n + LOAD, n + LOAD);
    for (j, of) in joints.iter().enumerate() {
        let seen = &of.gram * load;
        whole[(j, j)] = of.weight * load.dot(&seen) + prior;
        for k in 0..LOAD {
            let cross = of.weight * at[j] * seen[k];
            whole[(j, n + k)] = cross;
            whole[(n + k, j)] = cross;
            (0..LOAD).for_each(|i| whole[(n + i, n + k)] += of.weight * at[j] * at[j] * of.gram[(i, k)]);
        }
    }
    if prior > 0.0 {
        (n..n + LOAD).for_each(|k| whole[(k, k)] += 1.0);
    }
    whole
}

/// Scatter of the cycles' scores without and with the load, with the degrees of freedom; `None` with too few cycles of
/// either kind.
fn of_cycles(joints: &[JointLoad], at: &DVector<f64>) -> Option<Vec<(DMatrix<f64>, f64)>> {
    let n = joints.len();
    let of_kind = |loaded: bool| {
        let mut scores: Vec<(usize, DVector<f64>)> = Vec::new();
        for (j, of) in joints.iter().enumerate() {
            for (cycle, _, gram, own) in of.cycles.iter().filter(|(_, of, ..)| *of == loaded) {
                let own = score(at, n, j, of.weight, gram, own);
                match scores.iter_mut().find(|(place, _)| place == cycle) {
                    Some((_, sum)) => *sum += own,
                    None => scores.push((*cycle, own)),
                }
            }
        }
        let count = scores.len() as f64;
        let whole =
            scores.iter().fold(DMatrix::zeros(n + LOAD, n + LOAD), |sum, (_, of)| sum + of * of.transpose());
        (scores.len() >= MIN_CYCLES).then(|| (whole * (count / (count - 1.0)), count - 1.0))
    };
    Some(vec![of_kind(false)?, of_kind(true)?])
}

/// Mass, centre and inertia about the centre from the ten parameters of a body.
fn quantities(load: &[f64; LOAD]) -> [f64; LOAD] {
    let body = StandardParameters(*load);
    let centre: Vector3<f64> = body.centre_of_mass();
    let i = body.inertia_about_centre();
    [body.mass(), centre.x, centre.y, centre.z, i.m11, i.m12, i.m13, i.m22, i.m23, i.m33]
}

/// Marks the quantities that the motion shows. An inertia is shown if its interval is narrower than the largest moment.
fn shown(all: [Interval; LOAD], gain_bound: f64, cycles: [usize; 2]) -> Payload {
    let [mass, x, y, z, inertia @ ..] = all;
    let with = |of: Interval, is_shown: bool| Interval { is_shown, ..of };
    let mass = with(mass, mass.half_width() <= SHOWN_MASS.max(mass.value.abs()));
    let has_mass = mass.is_shown && mass.low * mass.high > 0.0;
    let largest = [0, 3, 5].map(|k| inertia[k].value.abs()).into_iter().fold(0.0, f64::max);
    Payload {
        mass,
        centre: [x, y, z].map(|of| with(of, has_mass && of.half_width() <= SHOWN_CENTRE)),
        inertia: inertia.map(|of| with(of, has_mass && of.half_width() <= largest)),
        gain_bound,
        cycles,
    }
}

/// Distributions of the common factor `c` of the gains: for gains with independent errors, and for gains with one error
/// in common if their ratios allow it.
struct CommonFactor {
    /// Values of `c` with their probabilities, which add up to one.
    distributions: Vec<Vec<(f64, f64)>>,
    /// Largest logarithm of the probability that all gains are within their bounds.
    agreement: f64,
}

impl CommonFactor {
    fn of(gains: &[f64], errors: &[f64], bound: f64) -> Self {
        let (low, high) = (1.0 - bound, 1.0 + bound);
        // log probability that all gains are within their bounds at this factor
        let agreement = |c: f64| -> f64 {
            let within = |(gain, error): (&f64, &f64)| {
                let error = error.max(LEAST_BOUND * bound);
                let [from, to] = [low, high].map(|end| (end / c - gain) / error);
                // if both ends have the same sign, the negative tail keeps its digits
                let (from, to) = if from > 0.0 { (-to, -from) } else { (from, to) };
                (normal_probability(to) - normal_probability(from)).max(f64::MIN_POSITIVE).ln()
            };
            gains.iter().zip(errors).map(within).sum()
        };
        let spread = gains.iter().zip(errors).map(|(gain, error)| (gain.abs(), error.min(bound)));
        // range of factors that keeps every gain near its bounds
        let (least, most) = spread.fold((f64::INFINITY, 0.0_f64), |(least, most), (gain, error)| {
            (least.min(gain + 4.0 * error), most.max(gain - 4.0 * error))
        });
        let ends = [low / least, high / most.max(f64::EPSILON)];
        let (from, to) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        let at = |place: u32| from + (to - from) * (f64::from(place) + 0.5) / f64::from(PLACES);
        let rows: Vec<(f64, f64)> = (0..PLACES).map(|place| (at(place), agreement(at(place)))).collect();
        let best = rows.iter().map(|(_, of)| *of).fold(f64::NEG_INFINITY, f64::max);
        let power = gains.len() as f64 - 1.0;
        let weights: Vec<(f64, f64)> =
            rows.iter().map(|(c, of)| (*c, (of - best + power * c.ln()).exp())).collect();
        let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
        let own = weights.into_iter().map(|(c, weight)| (c, weight / sum)).collect();
        let mut distributions = vec![own];
        distributions.extend(Self::in_common(gains, errors, bound));
        Self { distributions, agreement: best }
    }

    /// All factors that keep the mean gain within its bounds; `None` if the gains differ by more than their errors.
    fn in_common(gains: &[f64], errors: &[f64], bound: f64) -> Option<Vec<(f64, f64)>> {
        let weights = || errors.iter().map(|error| error.max(LEAST_BOUND * bound).powi(-2));
        let mean = gains.iter().zip(weights()).map(|(gain, weight)| weight * gain).sum::<f64>()
            / weights().sum::<f64>();
        let squares: f64 =
            gains.iter().zip(weights()).map(|(gain, weight)| weight * (gain - mean).powi(2)).sum();
        let n = gains.len() as f64;
        // three standard deviations of the sum of squares
        (squares <= n + 3.0 * (2.0 * n).sqrt()).then(|| {
            let at = |place: u32| 1.0 - bound + 2.0 * bound * (f64::from(place) + 0.5) / f64::from(PLACES);
            (0..PLACES).map(|place| (at(place) / mean, f64::from(PLACES).recip())).collect()
        })
    }

    /// Interval of a quantity with the value `value` and the error `error` at a factor of one: it contains the
    /// intervals of all distributions.
    fn interval(&self, value: f64, error: f64, scales: bool) -> Interval {
        let all = self.distributions.iter().map(|places| Self::interval_of(places, value, error, scales));
        let joined =
            all.reduce(|all, of| Interval { low: all.low.min(of.low), high: all.high.max(of.high), ..all });
        joined.unwrap_or(Interval { value, low: value, high: value, is_shown: false })
    }

    fn interval_of(places: &[(f64, f64)], value: f64, error: f64, scales: bool) -> Interval {
        let error = error.max(1e-12 * value.abs()).max(f64::MIN_POSITIVE);
        let below = |x: f64| -> f64 {
            let one = |(c, weight): &(f64, f64)| {
                let x = if scales { x * c } else { x };
                weight * normal_probability((x - value) / error)
            };
            places.iter().map(one).sum()
        };
        let ends = places.iter().flat_map(|(c, _)| {
            let by = if scales { 1.0 / c } else { 1.0 };
            [by * (value - 9.0 * error), by * (value + 9.0 * error)]
        });
        let (least, most) = ends
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), end| (least.min(end), most.max(end)));
        let quantile = |probability: f64| {
            let (mut low, mut high) = (least, most);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                *(if below(middle) < probability { &mut low } else { &mut high }) = middle;
            }
            0.5 * (low + high)
        };
        Interval {
            value: quantile(0.5),
            low: quantile(0.5 - 0.5 * LEVEL),
            high: quantile(0.5 + 0.5 * LEVEL),
            is_shown: false,
        }
    }
}

#[cfg(test)]
mod tests;
