//! What each run has beyond the friction map: wear, and coldness that the map does not know.
//!
//! One least-squares problem a run over all joints, with priors whose scales the history shows.

use nalgebra::{DMatrix, DVector};

use super::map::{Fitted, mixed, rates, record_coldness};
use super::record::JointRecord;
use super::record::Measured;
use crate::analysis::Estimate;

/// Run effects are solved again with the scales that they showed.
const INNER_ROUNDS: usize = 4;
/// Rounds in which the history shows its scales; each step goes most of the way (MacKay 1992).
const SCALE_ROUNDS: usize = 4;

/// Wear from one run to the baseline is mostly below this fraction, and sometimes far above (the scale is
/// taken half from here, half from the run itself, which makes the prior as wide as Student's).
const WEAR_SCALE: f64 = 0.02;
/// Friction at the largest speed changes with the hall by less than this fraction, mostly: before the history
/// has shown by how much, and what it is never believed to be less than.
const AMBIENT_SCALE: [f64; 2] = [0.3, 0.02];
/// Joints differ from each other in what the hall does to them by this part of it, and at least by the
/// second number as a fraction of friction.
const AMBIENT_SPREAD: [f64; 2] = [0.4, 0.003];
/// Friction at the largest speed of a joint whose motor's temperature is measured differs through a run by this
/// fraction for what the sensor does not show, likewise. The hall is in that temperature, so that it is nothing that
/// joints have in common.
const UNSEEN_SCALE: [f64; 2] = [0.03, 0.003];
/// Coldness at the start beyond the predicted one, likewise.
const START_SCALE: [f64; 2] = [0.3, 0.02];
/// Friction at one level in one run differs by this fraction for reasons of its own, likewise.
const LEVEL_SCALE: [f64; 2] = [0.005, 0.0003];
/// Part of the information on wear that must come from data. With less, what is left after taking out the prior is
/// rounding, and what stands there is the prior: near one whatever the wear.
const LEAST_TOLD: f64 = 0.01;
/// Least scatter of a point, as a fraction of friction.
const MIN_SCATTER: f64 = 1e-4;

/// What one run has beyond the map, of one joint.
#[derive(Debug, Clone)]
pub(super) struct Effect {
    /// Points of the run, and whether they were enough for the map.
    pub points: usize,
    pub full: bool,
    /// Whether the data tell of wear at all; else `wear` is what its prior says.
    pub told: bool,
    /// Friction as a factor, less one, with its variance.
    pub wear: f64,
    pub variance: f64,
    pub ambient: Estimate,
    /// Coldness at the start beyond the predicted one, slow and fast part.
    pub start: [f64; 2],
}

/// What is left, `seconds` into a run, of a unit of coldness at its start, in the slow and the fast part.
pub(super) fn start_decay(fit: &Fitted, seconds: f64) -> [f64; 2] {
    let heating = rates(&fit.law).heating;
    let share = [fit.law[2], 1.0 - fit.law[2]];
    std::array::from_fn(|part| share[part] * (-seconds / heating[part]).exp())
}

/// Scales that the history shows.
#[derive(Debug, Clone)]
pub(super) struct Scales {
    /// Of what the hall does at the largest speed, in common to all joints.
    ambient: f64,
    joints: Vec<JointScales>,
}

#[derive(Debug, Clone)]
struct JointScales {
    /// Scatter of points by level, as a fraction of friction.
    points: Vec<f64>,
    /// Of a level in a run.
    level: f64,
    /// Of the start.
    start: f64,
    /// Of what lasts through a run, where the hall is measured with the motor.
    unseen: Option<f64>,
}

/// A scale in the making: squares of effects, and how many of them the data told rather than their prior.
#[derive(Debug, Clone, Copy, Default)]
struct Shown {
    squares: f64,
    told: f64,
}

impl Shown {
    fn add(&mut self, value: f64, variance: f64, scale: f64) {
        self.squares += value * value;
        self.told += (1.0 - variance / (scale * scale)).clamp(0.0, 1.0);
    }

    /// The scale under which effects are as large as they were, between the bounds, or as it was where
    /// nothing was told.
    fn scale(self, before: f64, [most, least]: [f64; 2]) -> f64 {
        const TOLD: f64 = 0.5;
        if self.told < TOLD { before } else { (self.squares / self.told).sqrt().clamp(least, most) }
    }
}

/// One joint's points of one run with the map's values.
struct RunRows {
    /// Level, friction of the map, its slope over coldness as a fraction of friction, decay of the start.
    rows: Vec<(usize, f64, f64, [f64; 2])>,
    torque: Vec<f64>,
    full: bool,
    /// Slope over coldness, as a fraction of warm friction, at the largest speed.
    top: f64,
}

/// Unknowns of a joint in a run before those of its levels: wear, ambient, start slow and fast.
const EFFECTS: usize = 4;

/// What one run came to.
struct Solved {
    x: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Place of each joint's unknowns.
    first: Vec<usize>,
    /// Prior scale of each joint's wear.
    wear: Vec<f64>,
}

/// Effects of each joint, by run, with the scales that they showed; `known` are those of a map before.
pub(super) fn run_effects(
    records: &[JointRecord],
    fits: &[Fitted],
    starts: &[f64],
    known: Option<Scales>,
) -> (Vec<Vec<Effect>>, Scales) {
    let rows: Vec<Vec<RunRows>> =
        records.iter().zip(fits).map(|(record, fit)| run_rows(record, fit, starts)).collect();
    let of_run = |run: usize| rows.iter().map(|rows| &rows[run]).collect::<Vec<&RunRows>>();
    let joint = |(record, rows): (&JointRecord, &Vec<RunRows>)| JointScales {
        points: scatter(rows, record.levels.len()),
        level: LEVEL_SCALE[0],
        start: START_SCALE[0],
        unseen: matches!(record.measured, Measured::Motor(_)).then_some(UNSEEN_SCALE[0]),
    };
    let rounds = if known.is_some() { 1 } else { SCALE_ROUNDS };
    let mut scales = known.unwrap_or_else(|| Scales {
        ambient: AMBIENT_SCALE[0],
        joints: records.iter().zip(&rows).map(joint).collect(),
    });
    let solve = |scales: &Scales| (0..starts.len()).map(|run| one_run(&of_run(run), scales)).collect();
    for _ in 0..rounds {
        let solved: Vec<Solved> = solve(&scales);
        scales = shown_scales(&rows, &solved, &scales);
    }
    let solved: Vec<Solved> = solve(&scales);
    let effects = (0..records.len())
        .map(|j| (0..starts.len()).map(|run| effect(&rows[j][run], &solved[run], j)).collect())
        .collect();
    (effects, scales)
}

fn shown_scales(rows: &[Vec<RunRows>], solved: &[Solved], scales: &Scales) -> Scales {
    let mut ambient = Shown::default();
    for run in solved {
        ambient.add(run.x[0], run.covariance[(0, 0)], scales.ambient);
    }
    let joint = |(j, before): (usize, &JointScales)| {
        let [mut start, mut level, mut unseen] = <[Shown; 3]>::default();
        for (rows, run) in rows[j].iter().zip(solved).filter(|(rows, _)| !rows.rows.is_empty()) {
            let at = run.first[j];
            let told = |shown: &mut Shown, k: usize, scale| {
                shown.add(run.x[k], run.covariance[(k, k)], scale);
            };
            if let Some(scale) = before.unseen {
                let variance = rows.top * rows.top * run.covariance[(at + 1, at + 1)];
                unseen.add(rows.top * run.x[at + 1], variance, scale);
            }
            (at + 2..at + EFFECTS).for_each(|k| told(&mut start, k, before.start));
            let mut measured: Vec<usize> = rows.rows.iter().map(|(level, ..)| *level).collect();
            measured.sort_unstable();
            measured.dedup();
            measured.iter().for_each(|l| told(&mut level, at + EFFECTS + l, before.level));
        }
        JointScales {
            points: before.points.clone(),
            level: level.scale(before.level, LEVEL_SCALE),
            start: start.scale(before.start, START_SCALE),
            unseen: before.unseen.map(|scale| unseen.scale(scale, UNSEEN_SCALE)),
        }
    };
    Scales {
        ambient: ambient.scale(scales.ambient, AMBIENT_SCALE),
        joints: scales.joints.iter().enumerate().map(joint).collect(),
    }
}

/// What the data say of a joint, its own wear's prior taken out again: an index that leant towards one would
/// understate wear, and its interval would hold the truth too often in health and too seldom in wear.
fn effect(rows: &RunRows, run: &Solved, joint: usize) -> Effect {
    let at = run.first[joint];
    let (value, variance) = (run.x[at], run.covariance[(at, at)].max(f64::MIN_POSITIVE));
    let told = 1.0 / variance - run.wear[joint].powi(-2);
    let is_told = told * variance > LEAST_TOLD;
    let free = if is_told { 1.0 / told } else { variance };
    Effect {
        points: rows.rows.len(),
        full: rows.full,
        told: is_told,
        wear: value * free / variance,
        variance: free,
        ambient: Estimate {
            value: run.x[at + 1],
            std_error: run.covariance[(at + 1, at + 1)].max(0.0).sqrt(),
        },
        start: [run.x[at + 2], run.x[at + 3]],
    }
}

fn run_rows(record: &JointRecord, fit: &Fitted, starts: &[f64]) -> Vec<RunRows> {
    let top = record.levels.len() - 1;
    let top = fit.cold[top].max(f64::MIN_POSITIVE) / fit.warm[top];
    let empty = || RunRows { rows: Vec::new(), torque: Vec::new(), full: false, top };
    let mut found: Vec<RunRows> = starts.iter().map(|_| empty()).collect();
    for (p, x) in record.points.iter().zip(record_coldness(record, &fit.law)) {
        let friction = fit.warm[p.level] + fit.cold[p.level] * mixed(&fit.law, x);
        let decay = start_decay(fit, p.time - starts[p.run]);
        found[p.run].rows.push((p.level, friction, fit.cold[p.level], decay));
        found[p.run].torque.push(p.torque);
        found[p.run].full |= p.in_map;
    }
    found
}

/// Scatter of points about a smooth course, by level: from second differences inside runs (their variance is
/// six times that of a point), which warm-up and offsets leave alone.
fn scatter(runs: &[RunRows], levels: usize) -> Vec<f64> {
    (0..levels)
        .map(|level| {
            let (mut squares, mut count) = (0.0, 0.0);
            for run in runs {
                let of_level = run.rows.iter().zip(&run.torque).filter(|((l, ..), _)| *l == level);
                let relative: Vec<f64> =
                    of_level.map(|((_, friction, ..), torque)| torque / friction).collect();
                for w in relative.windows(3) {
                    squares += (w[0] - 2.0 * w[1] + w[2]).powi(2) / 6.0;
                    count += 1.0;
                }
            }
            if count > 0.0 { (squares / count).sqrt().max(MIN_SCATTER) } else { LEVEL_SCALE[0] }
        })
        .collect()
}

/// Solves one run.
fn one_run(joints: &[&RunRows], scales: &Scales) -> Solved {
    let (mut first, mut size) = (Vec::new(), 1);
    for joint in &scales.joints {
        first.push(size);
        size += EFFECTS + joint.points.len();
    }
    let mut solved = Solved {
        x: DVector::zeros(size),
        covariance: DMatrix::zeros(size, size),
        first,
        wear: vec![WEAR_SCALE; joints.len()],
    };
    let mut next = solved.wear.clone();
    let mut ambient = scales.ambient;
    for _ in 0..INNER_ROUNDS {
        let (mut information, mut score) =
            priors(joints, scales, &solved.first, &next, (solved.x[0], ambient));
        for (j, rows) in joints.iter().enumerate() {
            add_rows(rows, &scales.joints[j], solved.first[j], &solved.x, &mut information, &mut score);
        }
        let Some(factor) = information.cholesky() else { break };
        solved.x = factor.solve(&score);
        solved.covariance = factor.inverse();
        solved.wear.clone_from(&next);
        let shown = |k: usize| solved.x[k] * solved.x[k] + solved.covariance[(k, k)];
        for (scale, at) in next.iter_mut().zip(&solved.first) {
            *scale = f64::midpoint(WEAR_SCALE * WEAR_SCALE, shown(*at)).sqrt();
        }
        // a hall as it never was is believed where the run shows it
        ambient = f64::midpoint(scales.ambient * scales.ambient, shown(0)).sqrt().max(scales.ambient);
    }
    solved
}

/// Information and score of what is known before the run is looked at.
fn priors(
    joints: &[&RunRows],
    scales: &Scales,
    first: &[usize],
    wear: &[f64],
    (common, ambient): (f64, f64),
) -> (DMatrix<f64>, DVector<f64>) {
    let size = 1 + scales.joints.iter().map(|joint| EFFECTS + joint.points.len()).sum::<usize>();
    let mut information = DMatrix::zeros(size, size);
    information[(0, 0)] = ambient.powi(-2);
    let spread = AMBIENT_SPREAD[1].hypot(AMBIENT_SPREAD[0] * common);
    for (j, rows) in joints.iter().enumerate() {
        let at = first[j];
        information[(at, at)] = wear[j].powi(-2);
        // top * ambient_j - common has the spread among joints
        let weight = scales.joints[j].unseen.unwrap_or(spread).powi(-2);
        information[(at + 1, at + 1)] = rows.top * rows.top * weight;
        if scales.joints[j].unseen.is_none() {
            information[(at + 1, 0)] = -rows.top * weight;
            information[(0, at + 1)] = -rows.top * weight;
            information[(0, 0)] += weight;
        }
        for k in [at + 2, at + 3] {
            information[(k, k)] = scales.joints[j].start.powi(-2);
        }
        for level in 0..scales.joints[j].points.len() {
            let k = at + EFFECTS + level;
            information[(k, k)] = scales.joints[j].level.powi(-2);
        }
    }
    (information, DVector::zeros(size))
}

/// Adds a joint's points, linearised about the coldness found so far.
fn add_rows(
    rows: &RunRows,
    scale: &JointScales,
    at: usize,
    x: &DVector<f64>,
    information: &mut DMatrix<f64>,
    score: &mut DVector<f64>,
) {
    for ((level, friction, cold, decay), torque) in rows.rows.iter().zip(&rows.torque) {
        let offset = x[at + 1] + decay[0] * x[at + 2] + decay[1] * x[at + 3];
        let shifted = friction + cold * offset;
        // far out of the map, a first step may overshoot; friction stays friction
        let shifted = if shifted > 0.2 * friction { shifted } else { 0.2 * friction };
        let slope = cold / shifted;
        let target = torque / shifted - 1.0 + slope * offset;
        let entries = [
            (at, 1.0),
            (at + 1, slope),
            (at + 2, slope * decay[0]),
            (at + 3, slope * decay[1]),
            (at + EFFECTS + level, 1.0),
        ];
        let weight = scale.points[*level].powi(-2);
        for (i, a) in entries {
            score[i] += weight * a * target;
            for (k, b) in entries {
                information[(i, k)] += weight * a * b;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One joint of which the data leave `left` of the prior's variance of wear.
    fn solved(left: f64) -> (RunRows, Solved) {
        let rows =
            RunRows { rows: vec![(0, 10.0, 1.0, [0.5, 0.5])], torque: vec![10.0], full: true, top: 0.1 };
        let mut covariance = DMatrix::identity(1 + EFFECTS + 1, 1 + EFFECTS + 1);
        covariance[(1, 1)] = left * WEAR_SCALE * WEAR_SCALE;
        let mut x = DVector::zeros(1 + EFFECTS + 1);
        x[1] = 0.004;
        (rows, Solved { x, covariance, first: vec![1], wear: vec![WEAR_SCALE] })
    }

    #[test]
    fn what_the_prior_alone_says_of_wear_is_not_told() {
        for left in [1.0, 0.995, 1.000_001] {
            let (rows, run) = solved(left);
            let found = effect(&rows, &run, 0);
            assert!(!found.told, "{left}: {found:?}");
        }
        for left in [0.9, 0.1] {
            let (rows, run) = solved(left);
            let found = effect(&rows, &run, 0);
            assert!(found.told, "{left}: {found:?}");
            // the prior is taken out of value and variance
            let free = 1.0 / (1.0 / left - 1.0) * WEAR_SCALE * WEAR_SCALE;
            assert!((found.variance / free - 1.0).abs() < 1e-9);
            assert!((found.wear - 0.004 / (1.0 - left)).abs() < 1e-9);
        }
    }
}
