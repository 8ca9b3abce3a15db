//! Random effects of each run: how its friction differs from the map by wear and by a thermal deficit that the map
//! does not predict.
//!
//! The torque of joint `j` at level `l`, `t` seconds into a run, is modelled as
//!
//! `tau = tau_map(l, x + ambient + d_slow(t) start_slow + d_fast(t) start_fast) (1 + wear + level(l))`
//!
//! with the predicted thermal deficit `x` and the decays `d` of a deficit at the start
//! ([`start_decay`](super::run_points::start_decay)). All joints of a run are solved for together, because one ambient
//! effect is common to them. Each effect has a normal prior of mean zero. Its scale is estimated from the history
//! (empirical Bayes), except that of wear.

use nalgebra::{DMatrix, DVector};

use super::effect_layout::{EffectLayout, JointLayout};
use super::map::FittedMap;
use super::record::{JointRecord, ThermalSensor};
use super::run_points::{RunPoints, run_points, scatter};
use armwatch_model::analysis::Estimate;

/// Rounds in which a run is linearised again and its scales of wear and ambient are adapted.
const INNER_ROUNDS: usize = 4;
/// Rounds in which the prior scales are estimated; each goes most of the way to the fixed point (MacKay 1992).
const SCALE_ROUNDS: usize = 4;

/// Prior scale of wear against the baseline, as a fraction of friction. Most runs have less wear and a few have far
/// more; the run's own effect therefore enters the scale by a half, which gives the prior tails like those of
/// Student's distribution.
const WEAR_SCALE: f64 = 0.02;
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
    /// Wear: relative difference of friction.
    pub wear: f64,
    /// Variance of `wear`.
    pub variance: f64,
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
    /// Prior scale of each joint's wear.
    wear_scales: Vec<f64>,
}

impl RunSolution {
    fn variance(&self, at: usize) -> f64 {
        self.covariance[(at, at)]
    }

    /// Posterior mean of the effect's square: `effect² + variance`.
    fn second_moment(&self, at: usize) -> f64 {
        self.effects[at] * self.effects[at] + self.variance(at)
    }
}

/// Prior scales that follow the run itself.
struct RunScales {
    /// Of each joint's wear.
    wear: Vec<f64>,
    /// Of the common ambient effect.
    ambient: f64,
}

impl RunScales {
    /// Scales for a run that is solved for the first time.
    fn initial(scales: &PriorScales) -> Self {
        Self { wear: vec![WEAR_SCALE; scales.joints.len()], ambient: scales.ambient }
    }

    /// Scales from a solution: the mean of the square of the usual scale and of the effect's second moment. The scale
    /// of the ambient effect is the usual one at least, and larger for a run with unusual surroundings.
    fn adapted(solution: &RunSolution, scales: &PriorScales, layout: &EffectLayout) -> Self {
        let adapted = |usual: f64, at| f64::midpoint(usual * usual, solution.second_moment(at)).sqrt();
        Self {
            wear: layout.joints.iter().map(|joint| adapted(WEAR_SCALE, joint.wear())).collect(),
            ambient: adapted(scales.ambient, EffectLayout::COMMON_AMBIENT).max(scales.ambient),
        }
    }
}

/// Posterior of a run's effects. The normal equations are set up and solved several times, each time linearised about
/// the effects before and with the scales that follow from them.
fn solve_run(joints: &[&RunPoints], scales: &PriorScales, layout: &EffectLayout) -> RunSolution {
    let mut adapted = RunScales::initial(scales);
    let weights: Vec<f64> =
        joints.iter().zip(&scales.joints).map(|(points, of)| points.weight(&of.scatter)).collect();
    let mut solution = RunSolution {
        effects: DVector::zeros(layout.size),
        covariance: DMatrix::zeros(layout.size, layout.size),
        wear_scales: adapted.wear.clone(),
    };
    for _ in 0..INNER_ROUNDS {
        let mut equations = NormalEquations::zeros(layout.size);
        equations.add_priors(joints, scales, &adapted, layout, &solution.effects);
        for (j, points) in joints.iter().enumerate() {
            equations.add_points(points, &scales.joints[j], weights[j], layout.joints[j], &solution.effects);
        }
        let Some(factor) = equations.information.cholesky() else { break };
        solution = RunSolution {
            effects: factor.solve(&equations.score),
            covariance: factor.inverse(),
            wear_scales: adapted.wear,
        };
        adapted = RunScales::adapted(&solution, scales, layout);
    }
    solution
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

    /// Adds the priors of all effects; `effects` are those found so far.
    fn add_priors(
        &mut self,
        joints: &[&RunPoints],
        scales: &PriorScales,
        adapted: &RunScales,
        layout: &EffectLayout,
        effects: &DVector<f64>,
    ) {
        self.add_prior(EffectLayout::COMMON_AMBIENT, adapted.ambient);
        let common = effects[EffectLayout::COMMON_AMBIENT];
        let spread = MIN_AMBIENT_SPREAD.hypot(AMBIENT_SPREAD * common);
        for (j, joint) in layout.joints.iter().enumerate() {
            let of_joint = &scales.joints[j];
            self.add_prior(joint.wear(), adapted.wear[j]);
            match of_joint.own_ambient {
                Some(scale) => self.add_own_ambient(joint.ambient(), joints[j].top_slope, scale),
                None => self.add_coupled_ambient(joint.ambient(), joints[j].top_slope, spread),
            }
            joint.start().into_iter().for_each(|at| self.add_prior(at, of_joint.start));
            joint.levels().for_each(|at| self.add_prior(at, of_joint.level));
        }
    }

    /// Prior `effect ~ N(0, scale²)`.
    fn add_prior(&mut self, at: usize, scale: f64) {
        self.information[(at, at)] += scale.powi(-2);
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
    /// `tau / f - 1 + s e0 = wear + level + s e`, with `weight` times its usual weight.
    fn add_points(
        &mut self,
        points: &RunPoints,
        scales: &JointScales,
        weight: f64,
        layout: JointLayout,
        effects: &DVector<f64>,
    ) {
        let [slow, fast] = layout.start();
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
    let joints = by_joint.iter().zip(&before.joints).zip(&layout.joints);
    PriorScales {
        ambient: ambient.scale(before.ambient, AMBIENT_SCALE),
        joints: joints.map(|((runs, before), joint)| joint_scales(runs, solved, before, *joint)).collect(),
    }
}

/// Prior scales of a joint from the runs that have points of it. A level counts in the runs that measured it.
fn joint_scales(
    runs: &[RunPoints],
    solved: &[RunSolution],
    before: &JointScales,
    layout: JointLayout,
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
        for at in points.levels().map(|measured| layout.level(measured)) {
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

/// Effects of a run on a joint, with wear as the data alone estimate it.
///
/// With the posterior mean `w` and variance `v` under the prior scale `s`, the data have the information
/// `i = 1 / v - 1 / s²` on wear; they estimate it as `w / (v i)` with the variance `1 / i`. A shrunk estimate would
/// understate wear, and its interval would cover the truth too often in health and too seldom with wear.
fn run_effect(points: &RunPoints, run: &RunSolution, layout: &EffectLayout, joint: usize) -> RunEffect {
    let at = layout.joints[joint];
    let (value, variance) = (run.effects[at.wear()], run.variance(at.wear()).max(f64::MIN_POSITIVE));
    let information = 1.0 / variance - run.wear_scales[joint].powi(-2);
    // `v i = 1 - v / s²`: the effective degrees of freedom
    let identified = information * variance > MIN_EFFECTIVE_DOF;
    let by_data = if identified { 1.0 / information } else { variance };
    let std_error = run.variance(at.ambient()).max(0.0).sqrt();
    RunEffect {
        points: points.points.len(),
        in_map: points.in_map,
        identified,
        wear: value * by_data / variance,
        variance: by_data,
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
        let points = RunPoints { points: vec![point], in_map: true, top_slope: 0.1 };
        let layout = EffectLayout::with_levels(std::iter::once(1));
        let wear = layout.joints[0].wear();
        let mut covariance = DMatrix::identity(layout.size, layout.size);
        covariance[(wear, wear)] = left * WEAR_SCALE * WEAR_SCALE;
        let mut effects = DVector::zeros(layout.size);
        effects[wear] = 0.004;
        (points, RunSolution { effects, covariance, wear_scales: vec![WEAR_SCALE] }, layout)
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
            [joint.wear(), joint.ambient()].into_iter().chain(joint.start()).chain(joint.levels())
        };
        let mut all = vec![EffectLayout::COMMON_AMBIENT];
        all.extend(layout.joints.iter().flat_map(of_joint));
        assert_eq!(all, (0..layout.size).collect::<Vec<usize>>());
        assert_eq!(layout.joints[1].level(2) + 1, layout.size);
    }
}
