//! Random effects of each run: how its friction differs from the map by wear and by a thermal deficit that the map
//! does not predict.
//!
//! The torque of joint `j` at level `l`, `t` seconds into a run, is modelled as
//!
//! `tau = tau_map(l, x + ambient + d_slow(t) start_slow + d_fast(t) start_fast) (1 + r(l))`
//! `r(l) = wear + shape (v(l) - mean v) + level(l)`
//!
//! with the predicted thermal deficit `x` and the decays `d` of a deficit at the start
//! ([`start_decay`](super::run_points::start_decay)). `v(l)` is the part of warm friction that grows with speed
//! ([`viscous_shares`](super::run_points::viscous_shares)): Coulomb and viscous friction wear apart by `shape`. All
//! joints of a run are solved for together, because one ambient effect is common to them. Each effect has a normal
//! prior of mean zero. Its scale is estimated from the history (empirical Bayes), except that of wear and shape.
//!
//! Viscous wear of one joint and its own ambient effect look much alike, and many points overrule any prior. Each run is
//! therefore solved for twice. The first time, friction wears in proportion only (`shape` is zero). A joint whose thermal
//! effects are then further from the median of all joints than healthy joints are has what the others do not share: wear
//! of another shape. It is solved for again with the ambient effect that the others show, and with wear, shape and levels
//! whose priors have heavy tails.

use nalgebra::{DMatrix, DVector};

use super::effect_layout::{EffectLayout, JointLayout};
use super::map::FittedMap;
use super::record::{JointRecord, ThermalSensor};
use super::run_points::{RunPoints, run_points, scatter};
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::Estimate;

/// Rounds in which a run is linearised again and its scales of wear and ambient are adapted.
const INNER_ROUNDS: usize = 4;
/// The same of a run with a joint that wears in a shape of its own: effects grow by a factor with each round.
const SHAPE_ROUNDS: usize = 6;
/// Rounds in which the prior scales are estimated; each goes most of the way to the fixed point (MacKay 1992).
const SCALE_ROUNDS: usize = 4;

/// Prior scale of wear against the baseline, as a fraction of friction. Most runs have less wear and a few have far
/// more; the run's own effect therefore enters the scale by a half, which gives the prior tails like those of
/// Student's distribution.
const WEAR_SCALE: f64 = 0.02;
/// Prior scale of the difference between viscous and Coulomb wear of a joint that wears in a shape of its own, as a fraction
/// of friction, with the same tails.
const SHAPE_SCALE: f64 = 0.01;
/// The same of other joints: none.
const NO_SHAPE: f64 = 1e-5;
/// Thermal effects of a joint beyond the median of all, as a fraction of friction at the largest speed, that healthy joints
/// do not exceed: so much in a hall as usual, and this share of the median. Healthy joints of 420 robots differed by 0.015
/// at most, and by 0.3 of the median in halls of 5 to 35 °C.
const MOST_OWN: f64 = 0.015;
const MOST_OWN_SHARE: f64 = 0.45;
/// The same of the thermal deficit at the start, in its prior scales.
const MOST_OWN_SCALES: f64 = 3.5;
/// Standard deviation of an effect that is held: none.
const HELD: f64 = 1e-5;
/// Fewest joints of which one can differ from the median.
const FEWEST_JOINTS: usize = 3;
/// Scale of the ambient effect that is common to all joints, as a fraction of friction at the largest speed.
const AMBIENT_SCALE: ScaleBounds = ScaleBounds { largest: 0.3, smallest: 0.02 };
/// Standard deviation of a joint's ambient effect about the common one, as a fraction of the common one.
const AMBIENT_SPREAD: f64 = 0.4;
/// Least standard deviation of a joint's ambient effect about the common one, as a fraction of friction.
const MIN_AMBIENT_SPREAD: f64 = 0.003;
/// Scale of the ambient effect of a joint whose motor's temperature is measured, as a fraction of friction at the
/// largest speed. That temperature includes the ambient one, so that such joints have no effect in common.
const OWN_AMBIENT_SCALE: ScaleBounds = ScaleBounds { largest: 0.03, smallest: 0.003 };
/// Scale of the thermal deficit at the start of a run beyond the predicted one.
const START_SCALE: ScaleBounds = ScaleBounds { largest: 0.3, smallest: 0.02 };
/// Scale of the effect of one level in one run, as a fraction of friction.
const LEVEL_SCALE: ScaleBounds = ScaleBounds { largest: 0.005, smallest: 0.0003 };

/// Least effective degrees of freedom, of one, of an identified wear. With fewer, the estimate without its prior
/// is a ratio of rounding errors.
const MIN_EFFECTIVE_DOF: f64 = 0.01;
/// Least effective degrees of freedom over all runs from which a prior scale is estimated.
const MIN_SCALE_DOF: f64 = 0.5;
/// Least friction of a linearisation, as a fraction of the map's.
const MIN_FRICTION: f64 = 0.2;

/// Random effects of a run on one joint.
#[derive(Debug, Clone)]
pub(in crate::friction) struct RunEffect {
    /// Number of points that the run has of the joint.
    pub points: usize,
    /// Whether these points enter the map.
    pub in_map: bool,
    /// Whether the data determine wear. If not, `wear` and `variance` are shrunk towards the prior.
    pub identified: bool,
    /// Wear: relative difference of friction, mean over the levels of the map.
    pub wear: f64,
    /// Variance of `wear`.
    pub variance: f64,
    /// Relative difference of the Coulomb and of the viscous part of friction.
    pub parts: [Estimate; 2],
    /// Relative difference of friction at each level of the map, shrunk towards the prior.
    pub levels: Vec<f64>,
    /// Thermal deficit beyond the predicted one all through the run.
    pub ambient: Estimate,
    /// Thermal deficit at the start beyond the predicted one, slow and fast part.
    pub start: [f64; 2],
}

/// Random effects of all runs by joint, and the prior scales estimated with them.
///
/// `known` are the scales of an earlier call with other maps; the estimation continues from them. Joints with an entry
/// in `held` keep these scales.
pub(in crate::friction) fn run_effects(
    records: &[JointRecord],
    fits: &[FittedMap],
    starts: &[f64],
    known: Option<PriorScales>,
    held: &[Option<&JointScales>],
) -> (Vec<Vec<RunEffect>>, PriorScales) {
    let by_joint = points_by_run(records, fits, starts);
    let layout = EffectLayout::of(records);
    let rounds = if known.is_some() { 1 } else { SCALE_ROUNDS };
    let mut scales = known.unwrap_or_else(|| PriorScales::initial(records, &by_joint).holding(held));
    for _ in 0..rounds {
        let solved = solve_runs(&by_joint, &scales, &layout, starts.len());
        scales = estimated_scales(&by_joint, &solved, &scales, &layout).holding(held);
    }
    let solved = solve_runs(&by_joint, &scales, &layout, starts.len());
    (effects_by_joint(&by_joint, &solved, &layout), scales)
}

/// Random effects of all runs by joint, with prior scales that are known.
pub(in crate::friction) fn held_effects(
    records: &[JointRecord],
    fits: &[FittedMap],
    starts: &[f64],
    scales: &PriorScales,
) -> Vec<Vec<RunEffect>> {
    let by_joint = points_by_run(records, fits, starts);
    let layout = EffectLayout::of(records);
    effects_by_joint(&by_joint, &solve_runs(&by_joint, scales, &layout, starts.len()), &layout)
}

fn points_by_run(records: &[JointRecord], fits: &[FittedMap], starts: &[f64]) -> Vec<Vec<RunPoints>> {
    records.iter().zip(fits).map(|(record, fit)| run_points(record, fit, starts)).collect()
}

fn solve_runs(
    by_joint: &[Vec<RunPoints>],
    scales: &PriorScales,
    layout: &EffectLayout,
    runs: usize,
) -> Vec<RunSolution> {
    let joints_of = |run: usize| by_joint.iter().map(|runs| &runs[run]).collect::<Vec<&RunPoints>>();
    (0..runs).map(|run| solve_run(&joints_of(run), scales, layout)).collect()
}

fn effects_by_joint(
    by_joint: &[Vec<RunPoints>],
    solved: &[RunSolution],
    layout: &EffectLayout,
) -> Vec<Vec<RunEffect>> {
    let of_joint = |(j, runs): (usize, &Vec<RunPoints>)| {
        runs.iter().zip(solved).map(|(points, run)| run_effect(points, run, layout, j)).collect()
    };
    by_joint.iter().enumerate().map(of_joint).collect()
}

/// Prior scales of the random effects.
#[derive(Debug, Clone)]
pub(in crate::friction) struct PriorScales {
    /// Of the common ambient effect, as a fraction of friction at the largest speed.
    ambient: f64,
    joints: Vec<JointScales>,
}

/// Scatter of a joint's points and prior scales of its effects.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::friction) struct JointScales {
    /// Standard deviation of a point by level, as a fraction of friction; no prior, but the weight of the point.
    scatter: Vec<f64>,
    /// Of a level in a run, as a fraction of friction.
    level: f64,
    /// Of the thermal deficit at the start.
    start: f64,
    /// Of the ambient effect where the motor's temperature is measured, as a fraction of friction at the largest
    /// speed; `None` where the effect is coupled to the common one.
    own_ambient: Option<f64>,
}

impl PriorScales {
    /// Scales of joints whose maps hold, each with the scale of the common ambient effect in its baseline. The widest of
    /// the latter counts: a baseline in an even hall does not tell that all halls are even.
    pub(in crate::friction) fn held<'a>(joints: impl Iterator<Item = (&'a JointScales, f64)>) -> Self {
        let (joints, ambient): (Vec<&JointScales>, Vec<f64>) = joints.unzip();
        let widest = ambient.into_iter().fold(AMBIENT_SCALE.smallest, f64::max);
        Self { ambient: widest, joints: joints.into_iter().cloned().collect() }
    }

    /// Scale of the common ambient effect.
    pub(in crate::friction) fn ambient(&self) -> f64 {
        self.ambient
    }

    /// Scales of the joint of the record at `at`.
    pub(in crate::friction) fn of_joint(&self, at: usize) -> JointScales {
        self.joints[at].clone()
    }

    /// The same with the scales in `held`, by joint, in place of its own.
    fn holding(mut self, held: &[Option<&JointScales>]) -> Self {
        for (scales, held) in self.joints.iter_mut().zip(held) {
            if let Some(held) = held {
                scales.clone_from(held);
            }
        }
        self
    }

    fn initial(records: &[JointRecord], by_joint: &[Vec<RunPoints>]) -> Self {
        let joint = |(record, runs): (&JointRecord, &Vec<RunPoints>)| JointScales {
            scatter: scatter(runs, record.levels.len(), LEVEL_SCALE.largest),
            level: LEVEL_SCALE.largest,
            start: START_SCALE.largest,
            own_ambient: matches!(record.sensor, ThermalSensor::Motor(_))
                .then_some(OWN_AMBIENT_SCALE.largest),
        };
        Self { ambient: AMBIENT_SCALE.largest, joints: records.iter().zip(by_joint).map(joint).collect() }
    }
}

/// Bounds of a prior scale; its estimation begins at the largest.
#[derive(Debug, Clone, Copy)]
struct ScaleBounds {
    largest: f64,
    smallest: f64,
}

/// Sums from which a prior scale is estimated.
#[derive(Debug, Clone, Copy, Default)]
struct EmpiricalScale {
    /// Sum of the squared effects.
    squares: f64,
    /// Sum of `1 - variance / scale²` over the effects: 1 for an effect that the data determine, 0 for one that
    /// only its prior does.
    effective_dof: f64,
}

impl EmpiricalScale {
    /// Adds an effect with its posterior variance under the prior scale `scale`.
    fn add(&mut self, value: f64, variance: f64, scale: f64) {
        self.squares += value * value;
        self.effective_dof += (1.0 - variance / (scale * scale)).clamp(0.0, 1.0);
    }

    /// Next scale, `sqrt(squares / effective_dof)` within the bounds (MacKay 1992); `before` with too few degrees of
    /// freedom.
    fn scale(self, before: f64, bounds: ScaleBounds) -> f64 {
        if self.effective_dof < MIN_SCALE_DOF {
            before
        } else {
            (self.squares / self.effective_dof).sqrt().clamp(bounds.smallest, bounds.largest)
        }
    }
}

/// Posterior of the effects of one run.
struct RunSolution {
    /// Means in the order of [`EffectLayout`].
    effects: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Prior scales that they were found with.
    scales: RunScales,
    /// Of each joint that wears in a shape of its own: the ambient effect that it is taken to have.
    own: Vec<Option<HeldAmbient>>,
}

/// Ambient effect of a joint as the other joints of the run show it.
#[derive(Debug, Clone, Copy)]
struct HeldAmbient {
    value: f64,
    /// Standard error, as a fraction of friction at the largest speed.
    std_error: f64,
}

impl RunSolution {
    fn variance(&self, at: usize) -> f64 {
        self.covariance[(at, at)]
    }

    /// Posterior mean of the effect's square: `effect² + variance`.
    fn second_moment(&self, at: usize) -> f64 {
        self.effects[at] * self.effects[at] + self.variance(at)
    }

    /// Mean of the second moments of the levels that a joint has points of; zero without any.
    fn levels_moment(&self, points: &RunPoints, layout: JointLayout) -> f64 {
        let moments: Vec<f64> =
            points.levels().map(|level| self.second_moment(layout.level(level))).collect();
        mean(&moments).unwrap_or(0.0)
    }

    /// A sum of effects of a joint as the data alone estimate it, and its effective degrees of freedom, 0 to 1.
    ///
    /// With the posterior mean `w` and variance `v` under the prior variance `p`, the data have the information
    /// `i = 1 / v - 1 / p`; they estimate the sum as `w / (v i)` with the variance `1 / i`. `v i = 1 - v / p` is the
    /// effective degrees of freedom. A shrunk estimate would understate wear, and its interval would cover the truth
    /// too often in health and too seldom with wear. Where the data do not determine it, the shrunk estimate remains.
    fn by_data(&self, sum: &[(usize, f64)], prior_variance: f64) -> (Estimate, bool) {
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

/// Prior scales that follow the run itself.
#[derive(Debug, Clone)]
struct RunScales {
    /// Of each joint's effects on friction.
    joints: Vec<WearScales>,
    /// Of the common ambient effect.
    ambient: f64,
}

/// Prior scales of the effects of a run on the friction of one joint, as fractions of it.
#[derive(Debug, Clone, Copy)]
struct WearScales {
    wear: f64,
    shape: f64,
    level: f64,
}

impl RunScales {
    /// Scales for a run that is solved for the first time.
    fn initial(scales: &PriorScales) -> Self {
        Self { joints: scales.joints.iter().map(WearScales::usual).collect(), ambient: scales.ambient }
    }

    /// Scales from a solution: the mean of the square of the usual scale and of the effect's second moment. The scale
    /// of the ambient effect is the usual one at least, and larger for a run with unusual surroundings.
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
    fn prior_variance(&self, sum: &[(usize, f64)], layout: JointLayout) -> f64 {
        let scale = |at: usize| match at {
            at if at == layout.wear() => self.wear,
            at if at == layout.shape() => self.shape,
            _ => self.level,
        };
        sum.iter().map(|(at, factor)| (factor * scale(*at)).powi(2)).sum()
    }
}

/// Posterior of a run's effects. The normal equations are set up and solved several times, each time linearised about
/// the effects before and with the scales that follow from them.
fn solve_run(joints: &[&RunPoints], scales: &PriorScales, layout: &EffectLayout) -> RunSolution {
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

/// `solution` after some more rounds.
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
    /// Most that a healthy joint's start differs from the median.
    most_start: f64,
}

/// For each joint: the ambient effect that the others show, where its own thermal effects are further from them than those
/// of healthy joints are.
fn own_shapes(
    solution: &RunSolution,
    joints: &[&RunPoints],
    scales: &PriorScales,
    layout: &EffectLayout,
) -> Vec<Option<HeldAmbient>> {
    let of_joint = |(joint, points): (usize, &&RunPoints)| {
        let at = layout.joints[joint];
        if points.points.is_empty() || scales.joints[joint].own_ambient.is_some() {
            return None;
        }
        let [slow, fast] = at.start().map(|at| solution.effects[at]);
        let mean_of = |of: &dyn Fn([f64; 2]) -> f64| mean(&points.points.iter().map(|p| of(p.decay)).collect::<Vec<f64>>());
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
    let (Some(ambient), Some(start)) = (middle(&|of| of.ambient), middle(&|of| of.start)) else { return found };
    let most = MOST_OWN + MOST_OWN_SHARE * ambient.abs();
    let is_own = |of: &&OwnThermal| {
        (of.ambient - ambient).abs() > most
            || (of.start - start).abs() > of.most_start + MOST_OWN_SHARE * start.abs()
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

    /// Adds the priors of all effects; `solution` has those found so far.
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

    /// Adds the points of a joint, linearised about the effects found so far.
    ///
    /// With the extra deficit `e = ambient + d_slow start_slow + d_fast start_fast`, its value `e0` so far, friction
    /// `f = predicted + slope e0` and `s = slope / f`, each point gives the equation
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
            // the first step may overshoot far away from the map; friction stays positive
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

/// Prior scales estimated from the solutions of all runs.
fn estimated_scales(
    by_joint: &[Vec<RunPoints>],
    solved: &[RunSolution],
    before: &PriorScales,
    layout: &EffectLayout,
) -> PriorScales {
    let mut ambient = EmpiricalScale::default();
    for run in solved {
        let at = EffectLayout::COMMON_AMBIENT;
        ambient.add(run.effects[at], run.variance(at), before.ambient);
    }
    let joints = by_joint.iter().zip(&before.joints).zip(&layout.joints).enumerate();
    PriorScales {
        ambient: ambient.scale(before.ambient, AMBIENT_SCALE),
        joints: joints
            .map(|(j, ((runs, before), layout))| joint_scales(runs, solved, before, (j, *layout)))
            .collect(),
    }
}

/// Prior scales of a joint from the runs that have points of it. A level counts in the runs that measured it.
fn joint_scales(
    runs: &[RunPoints],
    solved: &[RunSolution],
    before: &JointScales,
    (joint, layout): (usize, JointLayout),
) -> JointScales {
    let [mut start, mut level, mut own_ambient] = <[EmpiricalScale; 3]>::default();
    for (points, run) in runs.iter().zip(solved).filter(|(points, _)| !points.points.is_empty()) {
        if let Some(scale) = before.own_ambient {
            let (at, top_slope) = (layout.ambient(), points.top_slope);
            own_ambient.add(top_slope * run.effects[at], top_slope * top_slope * run.variance(at), scale);
        }
        for at in layout.start() {
            start.add(run.effects[at], run.variance(at), before.start);
        }
        for at in points.levels().map(|measured| layout.level(measured)).filter(|_| run.own[joint].is_none()) {
            level.add(run.effects[at], run.variance(at), before.level);
        }
    }
    JointScales {
        scatter: before.scatter.clone(),
        level: level.scale(before.level, LEVEL_SCALE),
        start: start.scale(before.start, START_SCALE),
        own_ambient: before.own_ambient.map(|scale| own_ambient.scale(scale, OWN_AMBIENT_SCALE)),
    }
}

/// Effects of a run on a joint, with wear and its parts as the data alone estimate them.
///
/// Wear of the Coulomb part is `r` where `v` is zero, that of the viscous part where it is one, less the effects of levels.
fn run_effect(points: &RunPoints, run: &RunSolution, layout: &EffectLayout, joint: usize) -> RunEffect {
    let (at, scales) = (layout.joints[joint], run.scales.joints[joint]);
    let by_data = |sum: &[(usize, f64)]| run.by_data(sum, scales.prior_variance(sum, at));
    let share = (at.levels as f64).recip();
    let all: Vec<(usize, f64)> =
        [(at.wear(), 1.0)].into_iter().chain(at.levels().map(|level| (level, share))).collect();
    let (wear, identified) = by_data(&all);
    let mean = points.viscous_mean();
    let part = |viscous: f64| by_data(&[(at.wear(), 1.0), (at.shape(), viscous - mean)]).0;
    // an error of the ambient effect that the other joints show moves friction at all levels
    let of_ambient = run.own[joint].map_or(0.0, |held| held.std_error);
    let std_error = run.variance(at.ambient()).max(0.0).sqrt().hypot(of_ambient / points.top_slope);
    let of_level = |(level, viscous): (usize, &f64)| {
        run.effects[at.wear()] + run.effects[at.shape()] * (viscous - mean) + run.effects[at.level(level)]
    };
    RunEffect {
        points: points.points.len(),
        in_map: points.in_map,
        identified,
        wear: wear.value,
        variance: wear.std_error * wear.std_error + (points.mean_slope() * of_ambient / points.top_slope).powi(2),
        parts: [part(0.0), part(1.0)],
        levels: points.viscous.iter().enumerate().map(of_level).collect(),
        ambient: Estimate { value: run.effects[at.ambient()], std_error },
        start: at.start().map(|part| run.effects[part]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::maps::effect_layout::JointLayout;
    use crate::friction::maps::run_points::RunPoint;

    /// A run of one joint in which the posterior variance of wear is the fraction `left` of the prior's.
    fn solved(left: f64) -> (RunPoints, RunSolution, EffectLayout) {
        let point = RunPoint { level: 0, torque: 10.0, predicted: 10.0, slope: 1.0, decay: [0.5, 0.5] };
        let points = RunPoints { points: vec![point], in_map: true, top_slope: 0.1, viscous: vec![0.0] };
        let layout = EffectLayout::with_levels(std::iter::once(1));
        let wear = layout.joints[0].wear();
        let mut covariance = DMatrix::identity(layout.size, layout.size);
        covariance[(wear, wear)] = left * WEAR_SCALE * WEAR_SCALE;
        covariance[(layout.joints[0].level(0), layout.joints[0].level(0))] = 0.0;
        let mut effects = DVector::zeros(layout.size);
        effects[wear] = 0.004;
        let scales = WearScales { wear: WEAR_SCALE, shape: SHAPE_SCALE, level: 0.0 };
        let scales = RunScales { joints: vec![scales], ambient: 0.1 };
        (points, RunSolution { effects, covariance, scales, own: vec![None] }, layout)
    }

    #[test]
    fn wear_that_only_the_prior_determines_is_not_identified() {
        for left in [1.0, 0.995, 1.000_001] {
            let (points, run, layout) = solved(left);
            let found = run_effect(&points, &run, &layout, 0);
            assert!(!found.identified, "{left}: {found:?}");
        }
        for left in [0.9, 0.1] {
            let (points, run, layout) = solved(left);
            let found = run_effect(&points, &run, &layout, 0);
            assert!(found.identified, "{left}: {found:?}");
            // the prior is taken out of value and variance
            let by_data = 1.0 / (1.0 / left - 1.0) * WEAR_SCALE * WEAR_SCALE;
            assert!((found.variance / by_data - 1.0).abs() < 1e-9);
            assert!((found.wear - 0.004 / (1.0 - left)).abs() < 1e-9);
        }
    }

    #[test]
    fn the_effects_of_all_joints_fill_the_vector_of_a_run_without_overlap() {
        let layout = EffectLayout::with_levels([2, 3].into_iter());
        let of_joint = |joint: &JointLayout| {
            [joint.wear(), joint.shape(), joint.ambient()]
                .into_iter()
                .chain(joint.start())
                .chain(joint.levels())
        };
        let mut all = vec![EffectLayout::COMMON_AMBIENT];
        all.extend(layout.joints.iter().flat_map(of_joint));
        assert_eq!(all, (0..layout.size).collect::<Vec<usize>>());
        assert_eq!(layout.joints[1].level(2) + 1, layout.size);
    }
}
