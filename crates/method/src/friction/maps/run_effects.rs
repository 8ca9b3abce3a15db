//! Random effects of each run: the difference of its friction from the map by wear and by a thermal deficit that the
//! map does not predict.
//!
//! The torque of joint `j` at level `l`, `t` seconds into a run, is modelled as
//!
//! `tau = tau_map(l, x + ambient + d_slow(t) start_slow + d_fast(t) start_fast) (1 + r(l))`
//! `r(l) = wear + shape (v(l) - mean v) + level(l)`
//!
//! with the predicted thermal deficit `x` and the decays `d` of a deficit at the start
//! ([`start_decay`](super::run_points::start_decay)). `v(l)` is the part of warm friction that grows with speed
//! ([`viscous_shares`](super::run_points::viscous_shares)): Coulomb and viscous friction differ in wear by `shape`. All
//! joints of a run are solved together, because they have one ambient effect in common. Each effect has a normal prior
//! of mean zero. Its scale is estimated from the history (empirical Bayes), except that of wear and shape.
//!
//! Viscous wear of one joint resembles an ambient effect of this joint alone, and many points overrule any prior. Each
//! run is therefore solved twice. The first time, friction wears only in proportion (`shape` is zero). A joint has wear
//! of another shape if its thermal effects then differ from the median of all joints by more than those of healthy
//! joints. It is solved again with the ambient effect that the others show, and with heavy-tailed priors of wear, shape
//! and levels.

use super::effect_layout::{EffectLayout, JointLayout};
use super::map::FittedMap;
use super::record::{JointRecord, ThermalSensor};
use super::run_points::{RunPoints, run_points, scatter};
use super::run_solution::{RunSolution, solve_run};
use armwatch_model::analysis::Estimate;

/// Iterations of the prior scales; each covers most of the distance to the fixed point (MacKay 1992).
const SCALE_ROUNDS: usize = 4;

/// Scale of the ambient effect that is common to all joints, as a fraction of friction at the largest speed.
const AMBIENT_SCALE: ScaleBounds = ScaleBounds { largest: 0.3, smallest: 0.02 };
/// Scale of the ambient effect of a joint whose motor's temperature is measured, as a fraction of friction at the
/// largest speed. This temperature includes the ambient one, so such joints have no effect in common.
const OWN_AMBIENT_SCALE: ScaleBounds = ScaleBounds { largest: 0.03, smallest: 0.003 };
/// Scale of the thermal deficit at the start of a run beyond the predicted one.
const START_SCALE: ScaleBounds = ScaleBounds { largest: 0.3, smallest: 0.02 };
/// Scale of the effect of one level in one run, as a fraction of friction.
const LEVEL_SCALE: ScaleBounds = ScaleBounds { largest: 0.005, smallest: 0.0003 };

/// Smallest number of effective degrees of freedom over all runs for the estimate of a prior scale.
const MIN_SCALE_DOF: f64 = 0.5;

/// Random effects of a run on one joint.
#[derive(Debug, Clone)]
pub(in crate::friction) struct RunEffect {
    /// Number of points of the joint in the run.
    pub points: usize,
    /// True if these points enter the map.
    pub in_map: bool,
    /// True if the data determine wear. If not, `wear` and `variance` are shrunk towards the prior.
    pub identified: bool,
    /// Wear: relative difference of friction, mean over the levels of the map.
    pub wear: f64,
    /// Variance of `wear`.
    pub variance: f64,
    /// Relative difference of friction at each level of the map, shrunk towards the prior.
    pub levels: Vec<f64>,
    /// Thermal deficit beyond the predicted one throughout the run.
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

/// Random effects of all runs by joint, with known prior scales.
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
    /// Scale of the common ambient effect, as a fraction of friction at the largest speed.
    pub(super) ambient: f64,
    pub(super) joints: Vec<JointScales>,
}

/// Scatter of a joint's points and prior scales of its effects.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::friction) struct JointScales {
    /// Standard deviation of a point by level, as a fraction of friction. It is not a prior, but determines the weight
    /// of the point.
    pub(super) scatter: Vec<f64>,
    /// Scale of the effect of a level in a run, as a fraction of friction.
    pub(super) level: f64,
    /// Scale of the thermal deficit at the start.
    pub(super) start: f64,
    /// Scale of the ambient effect if the motor's temperature is measured, as a fraction of friction at the largest
    /// speed; `None` if the effect is coupled to the common one.
    pub(super) own_ambient: Option<f64>,
}

impl PriorScales {
    /// Scales of joints with held maps, each with the scale of the common ambient effect in its baseline. The largest
    /// of the latter is used: a baseline at constant ambient temperature does not show that it is always constant.
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

    /// Replaces scales by those in `held`, by joint.
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

/// Sums for the estimate of a prior scale.
#[derive(Debug, Clone, Copy, Default)]
struct EmpiricalScale {
    /// Sum of the squared effects.
    squares: f64,
    /// Sum of `1 - variance / scale²` over the effects: 1 for an effect that the data determine, 0 for one that only
    /// its prior determines.
    effective_dof: f64,
}

impl EmpiricalScale {
    /// Adds an effect with its posterior variance under the prior scale `scale`.
    fn add(&mut self, value: f64, variance: f64, scale: f64) {
        self.squares += value * value;
        self.effective_dof += (1.0 - variance / (scale * scale)).clamp(0.0, 1.0);
    }

    /// Next scale, `sqrt(squares / effective_dof)` within the bounds (MacKay 1992); `before` if there are too few
    /// degrees of freedom.
    fn scale(self, before: f64, bounds: ScaleBounds) -> f64 {
        if self.effective_dof < MIN_SCALE_DOF {
            before
        } else {
            (self.squares / self.effective_dof).sqrt().clamp(bounds.smallest, bounds.largest)
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

/// Prior scales of a joint from the runs with points of it. A level counts in the runs that measured it.
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
        for at in points.levels().map(|measured| layout.level(measured)).filter(|_| run.own[joint].is_none())
        {
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

/// Effects of a run on a joint, with wear estimated from the data alone.
fn run_effect(points: &RunPoints, run: &RunSolution, layout: &EffectLayout, joint: usize) -> RunEffect {
    let (at, scales) = (layout.joints[joint], run.scales.joints[joint]);
    let share = (at.levels as f64).recip();
    let all: Vec<(usize, f64)> =
        [(at.wear(), 1.0)].into_iter().chain(at.levels().map(|level| (level, share))).collect();
    let (wear, identified) = run.by_data(&all, scales.prior_variance(&all, at));
    let mean = points.viscous_mean();
    // an error of the other joints' ambient effect changes friction at all levels
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
        variance: wear.std_error * wear.std_error
            + (points.mean_slope() * of_ambient / points.top_slope).powi(2),
        levels: points.viscous.iter().enumerate().map(of_level).collect(),
        ambient: Estimate { value: run.effects[at.ambient()], std_error },
        start: at.start().map(|part| run.effects[part]),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;
    use crate::friction::maps::effect_layout::JointLayout;
    use crate::friction::maps::run_points::RunPoint;
    use crate::friction::maps::run_solution::{RunScales, SHAPE_SCALE, WEAR_SCALE, WearScales};

    /// Run of one joint with a posterior variance of wear that is the fraction `left` of the prior's.
    fn solved(left: f64) -> (RunPoints, RunSolution, EffectLayout) {
        let point = RunPoint { level: 0, torque: 10.0, predicted: 10.0, slope: 1.0, decay: [0.5, 0.5] };
        let points = RunPoints {
            points: vec![point],
            in_map: true,
            top_slope: 0.1,
            viscous: vec![0.0],
            has_recorded_ambient: false,
        };
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
            // value and variance are those without the prior
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
