//! Solution of one run for the random effects of [`super::run_effects`]: its normal equations, solved repeatedly.

use nalgebra::{DMatrix, DVector};

use super::effect_layout::{EffectLayout, JointLayout};
use super::run_effects::{JointScales, PriorScales};
use super::run_points::RunPoints;
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::Estimate;

/// Rounds of linearising a run and adapting its scales of wear and ambient effect.
const INNER_ROUNDS: usize = 4;
/// Rounds of a run with disproportionate wear of a joint: effects grow by a factor with each round.
const SHAPE_ROUNDS: usize = 6;
/// Prior scale of wear relative to the baseline, as a fraction of friction. Most runs have less wear and a few have far
/// more; the run's own effect therefore enters the scale by a half, which gives the prior tails like those of Student's
/// distribution.
pub(super) const WEAR_SCALE: f64 = 0.02;
/// Prior scale of the difference between viscous and Coulomb wear of a joint with disproportionate wear, as a fraction
/// of friction, with the same tails.
pub(super) const SHAPE_SCALE: f64 = 0.01;
/// Prior scale of this difference for other joints: none.
const NO_SHAPE: f64 = 1e-5;
/// Thermal effects of a joint beyond the median of all, as a fraction of friction at the largest speed, that healthy
/// joints do not exceed: a constant, and a share of the median. Healthy joints of 420 robots differed by at most 0.015,
/// and by 0.3 of the median at 5 to 35 °C ambient temperature.
const MOST_OWN: f64 = 0.015;
const MOST_OWN_SHARE: f64 = 0.45;
/// The same for the thermal deficit at the start, in units of its prior scale.
const MOST_OWN_SCALES: f64 = 2.0;
/// Standard deviation of an effect that is held: none.
const HELD: f64 = 1e-5;
/// Smallest number of joints for the comparison of one with the median.
const FEWEST_JOINTS: usize = 3;
/// Standard deviation of a joint's ambient effect about the common one, as a fraction of the common one.
const AMBIENT_SPREAD: f64 = 0.4;
/// Smallest standard deviation of a joint's ambient effect about the common one, as a fraction of friction.
const MIN_AMBIENT_SPREAD: f64 = 0.003;
/// Smallest effective degrees of freedom, of one, of an identified wear. Below it, the estimate without its prior is a
/// ratio of rounding errors.
const MIN_EFFECTIVE_DOF: f64 = 0.01;
/// Smallest friction of a linearisation, as a fraction of the map's.
const MIN_FRICTION: f64 = 0.2;

/// Posterior of the effects of one run.
pub(super) struct RunSolution {
    /// Means in the order of [`EffectLayout`].
    pub(super) effects: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Prior scales of this solution.
    pub(super) scales: RunScales,
    /// Assumed ambient effect of each joint with disproportionate wear.
    pub(super) own: Vec<Option<HeldAmbient>>,
}

/// Ambient effect of a joint, from the other joints of the run.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldAmbient {
    value: f64,
    /// Standard error, as a fraction of friction at the largest speed.
    pub(super) std_error: f64,
}

impl RunSolution {
    pub(super) fn variance(&self, at: usize) -> f64 {
        self.covariance[(at, at)]
    }

    /// Posterior mean of the effect's square: `effect² + variance`.
    pub(super) fn second_moment(&self, at: usize) -> f64 {
        self.effects[at] * self.effects[at] + self.variance(at)
    }

    /// Mean of the second moments of the levels with points of a joint; zero without any.
    fn levels_moment(&self, points: &RunPoints, layout: JointLayout) -> f64 {
        let moments: Vec<f64> =
            points.levels().map(|level| self.second_moment(layout.level(level))).collect();
        mean(&moments).unwrap_or(0.0)
    }

    /// Sum of effects of a joint as estimated from the data alone, and its effective degrees of freedom, 0 to 1.
    ///
    /// The posterior has the mean `w` and variance `v`, and the prior the variance `p`. The data then have the
    /// information
    /// `i = 1 / v - 1 / p`; they estimate the sum as `w / (v i)` with the variance `1 / i`. `v i = 1 - v / p` is the
    /// effective degrees of freedom. A shrunk estimate would understate wear, and its interval would cover the truth
    /// too often without wear and too rarely with it. The shrunk estimate remains if the data do not determine the sum.
    pub(super) fn by_data(&self, sum: &[(usize, f64)], prior_variance: f64) -> (Estimate, bool) {
        let value: f64 = sum.iter().map(|(at, factor)| factor * self.effects[*at]).sum();
        let products =
            sum.iter().flat_map(|(i, a)| sum.iter().map(move |(k, b)| a * b * self.covariance[(*i, *k)]));
        let variance = products.sum::<f64>().max(f64::MIN_POSITIVE);
        let dof = 1.0 - variance / prior_variance;
        let identified = dof > MIN_EFFECTIVE_DOF;
        let dof = if identified { dof } else { 1.0 };
        (Estimate { value: value / dof, std_error: (variance / dof).sqrt() }, identified)
    }
}

/// Prior scales that are adapted to the run.
#[derive(Debug, Clone)]
pub(super) struct RunScales {
    /// Scales of each joint's effects on friction.
    pub(super) joints: Vec<WearScales>,
    /// Scale of the common ambient effect.
    pub(super) ambient: f64,
}

/// Prior scales of the effects of a run on the friction of one joint, as fractions of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct WearScales {
    pub(super) wear: f64,
    pub(super) shape: f64,
    pub(super) level: f64,
}

impl RunScales {
    /// Scales for a run that is solved for the first time.
    fn initial(scales: &PriorScales) -> Self {
        Self { joints: scales.joints.iter().map(WearScales::usual).collect(), ambient: scales.ambient }
    }

    /// Scales from a solution: the mean of the square of the usual scale and of the effect's second moment. The scale
    /// of the ambient effect is at least the usual one, and larger for a run at an unusual ambient temperature.
    fn adapted(
        solution: &RunSolution,
        joints: &[&RunPoints],
        scales: &PriorScales,
        layout: &EffectLayout,
    ) -> Self {
        let of_joint = |(j, at): (usize, &JointLayout)| {
            let usual = WearScales::usual(&scales.joints[j]);
            let wear = with_tails(usual.wear, solution.second_moment(at.wear()));
            if solution.own[j].is_none() {
                return WearScales { wear, ..usual };
            }
            let level = with_tails(usual.level, solution.levels_moment(joints[j], *at)).max(usual.level);
            WearScales { wear, shape: with_tails(SHAPE_SCALE, solution.second_moment(at.shape())), level }
        };
        let common = solution.second_moment(EffectLayout::COMMON_AMBIENT);
        Self {
            joints: layout.joints.iter().enumerate().map(of_joint).collect(),
            ambient: with_tails(scales.ambient, common).max(scales.ambient),
        }
    }
}

/// Scale of a prior with heavy tails, from the usual one and the second moment of the effect.
fn with_tails(usual: f64, second_moment: f64) -> f64 {
    f64::midpoint(usual * usual, second_moment).sqrt()
}

impl WearScales {
    fn usual(scales: &JointScales) -> Self {
        Self { wear: WEAR_SCALE, shape: NO_SHAPE, level: scales.level }
    }

    /// Prior variance of a sum of effects of a joint, each times its factor.
    pub(super) fn prior_variance(&self, sum: &[(usize, f64)], layout: JointLayout) -> f64 {
        let scale = |at: usize| match at {
            at if at == layout.wear() => self.wear,
            at if at == layout.shape() => self.shape,
            _ => self.level,
        };
        sum.iter().map(|(at, factor)| (factor * scale(*at)).powi(2)).sum()
    }
}

/// Posterior of a run's effects. The normal equations are set up and solved several times, each time linearised about
/// the previous effects and with the scales that follow from them.
pub(super) fn solve_run(joints: &[&RunPoints], scales: &PriorScales, layout: &EffectLayout) -> RunSolution {
    let start = RunSolution {
        effects: DVector::zeros(layout.size),
        covariance: DMatrix::zeros(layout.size, layout.size),
        scales: RunScales::initial(scales),
        own: vec![None; joints.len()],
    };
    let mut solution = solved(start, joints, scales, layout, INNER_ROUNDS);
    solution.own = own_shapes(&solution, joints, scales, layout);
    if solution.own.iter().all(Option::is_none) {
        return solution;
    }
    for (j, at) in layout.joints.iter().enumerate() {
        if let Some(held) = solution.own[j] {
            solution.effects.rows_mut(at.first, at.end() - at.first).fill(0.0);
            solution.effects[at.ambient()] = held.value;
            solution.scales.joints[j] =
                WearScales { shape: SHAPE_SCALE, ..WearScales::usual(&scales.joints[j]) };
        }
    }
    solved(solution, joints, scales, layout, SHAPE_ROUNDS)
}

/// Continues `solution` by some more rounds.
fn solved(
    mut solution: RunSolution,
    joints: &[&RunPoints],
    scales: &PriorScales,
    layout: &EffectLayout,
    rounds: usize,
) -> RunSolution {
    let weights: Vec<f64> =
        joints.iter().zip(&scales.joints).map(|(points, of)| points.weight(&of.scatter)).collect();
    let mut adapted = solution.scales.clone();
    for _ in 0..rounds {
        let mut equations = NormalEquations::zeros(layout.size);
        equations.add_priors(joints, scales, &adapted, layout, &solution);
        for (j, points) in joints.iter().enumerate() {
            equations.add_points(points, &scales.joints[j], weights[j], layout.joints[j], &solution.effects);
        }
        let Some(factor) = equations.information.cholesky() else { break };
        solution = RunSolution {
            effects: factor.solve(&equations.score),
            covariance: factor.inverse(),
            scales: adapted,
            own: solution.own,
        };
        adapted = RunScales::adapted(&solution, joints, scales, layout);
    }
    solution
}

/// Thermal effects of a joint in a run, as fractions of friction at the largest speed.
struct OwnThermal {
    joint: usize,
    ambient: f64,
    /// Mean over the points.
    start: f64,
    /// Largest difference of a healthy joint's start from the median.
    most_start: f64,
}

/// Ambient effect from the other joints, for each joint whose thermal effects differ from theirs by more than those of
/// healthy joints.
fn own_shapes(
    solution: &RunSolution,
    joints: &[&RunPoints],
    scales: &PriorScales,
    layout: &EffectLayout,
) -> Vec<Option<HeldAmbient>> {
    let of_joint = |(joint, points): (usize, &&RunPoints)| {
        let at = layout.joints[joint];
        // the effect of a recorded temperature is uncertain by some tenths, which exceeds the bound over a season
        let is_measured = points.has_recorded_ambient || scales.joints[joint].own_ambient.is_some();
        if points.points.is_empty() || is_measured {
            return None;
        }
        let [slow, fast] = at.start().map(|at| solution.effects[at]);
        let mean_of = |of: &dyn Fn([f64; 2]) -> f64| {
            mean(&points.points.iter().map(|p| of(p.decay)).collect::<Vec<f64>>())
        };
        Some(OwnThermal {
            joint,
            ambient: points.top_slope * solution.effects[at.ambient()],
            start: points.top_slope * mean_of(&|[of_slow, of_fast]| slow * of_slow + fast * of_fast)?,
            most_start: MOST_OWN_SCALES
                * points.top_slope
                * scales.joints[joint].start
                * mean_of(&|[of_slow, _]| of_slow)?,
        })
    };
    let all: Vec<OwnThermal> = joints.iter().enumerate().filter_map(of_joint).collect();
    let middle = |of: &dyn Fn(&OwnThermal) -> f64| median(&all.iter().map(of).collect::<Vec<f64>>());
    let mut found = vec![None; joints.len()];
    let (Some(ambient), Some(start)) = (middle(&|of| of.ambient), middle(&|of| of.start)) else {
        return found;
    };
    let most = MOST_OWN + MOST_OWN_SHARE * ambient.abs();
    let is_own = |of: &&OwnThermal| {
        (of.ambient - ambient).abs() > most
            || (of.start - start).abs() > of.most_start + MOST_OWN + MOST_OWN_SHARE * start.abs()
    };
    if all.len() >= FEWEST_JOINTS {
        for of in all.iter().filter(is_own) {
            let value = ambient / joints[of.joint].top_slope;
            found[of.joint] = Some(HeldAmbient { value, std_error: 0.5 * most });
        }
    }
    found
}

/// Normal equations `information effects = score` of one run.
struct NormalEquations {
    information: DMatrix<f64>,
    score: DVector<f64>,
}

impl NormalEquations {
    fn zeros(size: usize) -> Self {
        Self { information: DMatrix::zeros(size, size), score: DVector::zeros(size) }
    }

    /// Adds the priors of all effects; `solution` contains the present ones.
    fn add_priors(
        &mut self,
        joints: &[&RunPoints],
        scales: &PriorScales,
        adapted: &RunScales,
        layout: &EffectLayout,
        solution: &RunSolution,
    ) {
        self.add_prior(EffectLayout::COMMON_AMBIENT, adapted.ambient);
        let common = solution.effects[EffectLayout::COMMON_AMBIENT];
        let spread = MIN_AMBIENT_SPREAD.hypot(AMBIENT_SPREAD * common);
        for (j, joint) in layout.joints.iter().enumerate() {
            let (of_joint, of_wear) = (&scales.joints[j], adapted.joints[j]);
            self.add_prior(joint.wear(), of_wear.wear);
            self.add_prior(joint.shape(), of_wear.shape);
            match (solution.own[j], of_joint.own_ambient) {
                (Some(held), _) => self.hold(joint.ambient(), held.value),
                (None, Some(scale)) => self.add_own_ambient(joint.ambient(), joints[j].top_slope, scale),
                (None, None) => self.add_coupled_ambient(joint.ambient(), joints[j].top_slope, spread),
            }
            joint.start().into_iter().for_each(|at| self.add_prior(at, of_joint.start));
            joint.levels().for_each(|at| self.add_prior(at, of_wear.level));
        }
    }

    /// Prior `effect ~ N(0, scale²)`.
    fn add_prior(&mut self, at: usize, scale: f64) {
        self.information[(at, at)] += scale.powi(-2);
    }

    /// Holds an effect at `value`.
    fn hold(&mut self, at: usize, value: f64) {
        self.information[(at, at)] += HELD.powi(-2);
        self.score[at] += value * HELD.powi(-2);
    }

    /// Prior `top_slope ambient ~ N(0, scale²)` of a joint whose ambient effect is its own.
    fn add_own_ambient(&mut self, at: usize, top_slope: f64, scale: f64) {
        self.information[(at, at)] += top_slope * top_slope * scale.powi(-2);
    }

    /// Prior `top_slope ambient - common ~ N(0, spread²)` of a joint whose ambient effect is near the common one.
    fn add_coupled_ambient(&mut self, at: usize, top_slope: f64, spread: f64) {
        let (common, weight) = (EffectLayout::COMMON_AMBIENT, spread.powi(-2));
        self.information[(at, at)] += top_slope * top_slope * weight;
        self.information[(at, common)] += -top_slope * weight;
        self.information[(common, at)] += -top_slope * weight;
        self.information[(common, common)] += weight;
    }

    /// Adds the points of a joint, linearised about the present effects.
    ///
    /// Let `e = ambient + d_slow start_slow + d_fast start_fast` be the extra deficit, `e0` its present value,
    /// `f = predicted + slope e0` friction and `s = slope / f`. Each point gives the equation
    /// `tau / f - 1 + s e0 = wear + shape (v - mean v) + level + s e`, with `weight` times its usual weight.
    fn add_points(
        &mut self,
        points: &RunPoints,
        scales: &JointScales,
        weight: f64,
        layout: JointLayout,
        effects: &DVector<f64>,
    ) {
        let [slow, fast] = layout.start();
        let viscous_mean = points.viscous_mean();
        for p in &points.points {
            let [slow_decay, fast_decay] = p.decay;
            let extra = effects[layout.ambient()] + slow_decay * effects[slow] + fast_decay * effects[fast];
            let friction = p.predicted + p.slope * extra;
            // the first step may overshoot far from the map; friction remains positive
            let least = MIN_FRICTION * p.predicted;
            let friction = if friction > least { friction } else { least };
            let slope = p.slope / friction;
            let target = p.torque / friction - 1.0 + slope * extra;
            let row = [
                (layout.wear(), 1.0),
                (layout.shape(), points.viscous[p.level] - viscous_mean),
                (layout.ambient(), slope),
                (slow, slope * slow_decay),
                (fast, slope * fast_decay),
                (layout.level(p.level), 1.0),
            ];
            self.add_row(&row, target, weight * scales.scatter[p.level].powi(-2));
        }
    }

    /// Adds the observation `row effects = target`; `row` has the indices and values that are not zero.
    fn add_row(&mut self, row: &[(usize, f64)], target: f64, weight: f64) {
        for &(i, a) in row {
            self.score[i] += weight * a * target;
            for &(k, b) in row {
                self.information[(i, k)] += weight * a * b;
            }
        }
    }
}
