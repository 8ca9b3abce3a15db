//! The warm friction index: friction of each run against the robot's own baseline, at equal speed and equal
//! thermal state.
//!
//! In a run, friction of joint `j` at level `l` differs from the map's by the factor `1 + w_j` (wear: at all
//! speeds alike) and by coldness that the map does not know: `ambient_j` all through the run, and what the
//! start had beyond the predicted state, which decays. Cold adds to each level by the map's own cold part,
//! wear does not: that tells them apart inside one joint. All joints stand in one hall: that tells them apart
//! between joints. Both are one least-squares problem with weak priors, solved for each run; its
//! covariance gives the intervals.

use nalgebra::{DMatrix, DVector};

use super::friction_map::{
    Fitted, JointRecord, RecordPoint, fit_map, mixed, published, rates, record_coldness,
};
use super::friction_means::friction_means;
use super::thermal::{MotionSpan, coldness_at};
use crate::analysis::friction::{FrictionIndex, FrictionMap};
use crate::analysis::{Estimate, FrictionPoint};
use crate::robot::JointIndex;

/// Map and run effects are fitted in turn this often; the third time changes the index by less than 0.1 %.
const OUTER_ROUNDS: usize = 3;
/// Run effects are solved again with the scales that they showed.
const INNER_ROUNDS: usize = 4;

/// Wear from one run to the baseline is mostly below this fraction, and sometimes far above (the scale is
/// taken half from here, half from the run itself, which makes the prior as wide as Student's).
const WEAR_SCALE: f64 = 0.02;
/// Friction at the largest speed changes with the hall by less than this fraction, mostly.
const AMBIENT_SCALE: f64 = 0.3;
/// Joints differ from each other in what the hall does to them by this part of it, and at least by the
/// second number as a fraction of friction.
const AMBIENT_SPREAD: [f64; 2] = [0.4, 0.003];
/// Coldness at the start beyond the predicted one.
const START_SCALE: f64 = 0.3;
/// Friction at one level in one run differs by this fraction for reasons of its own, before the history has
/// shown by how much; and it is never believed to be less than the second number.
const LEVEL_SCALE: [f64; 2] = [0.005, 0.001];
/// Least scatter of a point, as a fraction of friction.
const MIN_SCATTER: f64 = 1e-4;

/// Fewest points of a level in a run that count: a run of fewer cycles shows too little of its own warm-up
/// for its thermal state to be told.
const MIN_POINTS_BY_RUN: usize = 6;

/// One run, as the map sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct MapRun {
    /// Start of the recording, UTC, s.
    pub started_at: f64,
    /// Motion since the start, s; rising, not overlapping.
    pub spans: Vec<MotionSpan>,
    /// Plateaus of the friction stages, times since the start, s.
    pub points: Vec<FrictionPoint>,
}

/// Friction of a robot over its history.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RobotFriction {
    /// One map for each joint that has one.
    pub maps: Vec<FrictionMap>,
    /// For each run, in the given order: one index for each joint with a map and points in that run.
    pub indices: Vec<Vec<FrictionIndex>>,
    /// Why a joint has no map, in sentences.
    pub remarks: Vec<String>,
}

/// Fits the maps of all joints over all runs, oldest first, and the index of each run against the first
/// `baseline_runs` runs of its joint.
///
/// A joint needs `baseline_runs` runs (two at least) with six points or more at a level, and friction that falls
/// while it warms. Shorter runs have no index; their motion counts.
/// A run that overlaps the one before it counts as beginning when that ends.
#[must_use]
pub fn robot_friction(runs: &[MapRun], baseline_runs: usize) -> RobotFriction {
    let mut found = RobotFriction { indices: vec![Vec::new(); runs.len()], ..RobotFriction::default() };
    let mut joints: Vec<JointIndex> =
        runs.iter().flat_map(|run| run.points.iter().map(|p| p.joint)).collect();
    joints.sort_unstable();
    joints.dedup();
    let (spans, starts) = timeline(runs);
    let mut records = Vec::new();
    for joint in joints {
        match record(joint, runs, &spans, &starts, baseline_runs.max(2)) {
            Ok(record) => records.push(record),
            Err(reason) => found.remarks.push(reason),
        }
    }
    let mut fits: Vec<Fitted> = records.iter().map(|record| fit_map(record, None)).collect();
    drop_flat(&mut records, &mut fits, &mut found.remarks);
    let mut effects = Vec::new();
    for round in 0..OUTER_ROUNDS {
        effects = run_effects(&records, &fits, &starts);
        for (j, record) in records.iter_mut().enumerate() {
            settle(record, &fits[j], &mut effects[j], &starts, baseline_runs.max(2));
            if round + 1 < OUTER_ROUNDS {
                fits[j] = fit_map(record, Some(fits[j].law));
            }
        }
    }
    for ((record, fit), effects) in records.iter().zip(&fits).zip(&effects) {
        found.maps.extend(published(record, fit, runs.len()));
        let cold = coldness_at(&rates(&fit.law), &record.spans, &starts);
        for (run, effect) in effects.iter().enumerate().filter(|(_, effect)| effect.points > 0) {
            found.indices[run].push(FrictionIndex {
                joint: record.joint,
                index: effect.index,
                ambient: effect.ambient,
                coldness_at_start: mixed(&fit.law, cold[run]),
                points: effect.points,
            });
        }
    }
    found
}

/// Motion of the whole history and the start of each run, in seconds since the first run.
fn timeline(runs: &[MapRun]) -> (Vec<MotionSpan>, Vec<f64>) {
    let epoch = runs.first().map_or(0.0, |run| run.started_at);
    let (mut spans, mut end) = (Vec::new(), f64::NEG_INFINITY);
    for run in runs {
        let from = run.started_at - epoch;
        for span in &run.spans {
            let (start, stop) = ((span.start + from).max(end), span.end + from);
            if stop > start {
                spans.push(MotionSpan { start, end: stop, activity: span.activity });
                end = stop;
            }
        }
    }
    (spans, runs.iter().map(|run| run.started_at - epoch).collect())
}

fn record(
    joint: JointIndex,
    runs: &[MapRun],
    spans: &[MotionSpan],
    starts: &[f64],
    needed: usize,
) -> Result<JointRecord, String> {
    let mut levels: Vec<f64> = runs
        .iter()
        .flat_map(|run| &run.points)
        .filter(|p| p.joint == joint)
        .map(|p| p.speed_fraction)
        .collect();
    levels.sort_by(f64::total_cmp);
    levels.dedup();
    let by_level: Vec<(f64, Vec<RecordPoint>)> = levels
        .into_iter()
        .map(|level| {
            let points = runs.iter().zip(starts).enumerate().flat_map(|(run, (of_run, start))| {
                let mut means = friction_means(&of_run.points, joint, level);
                means.retain(|mean| mean.torque.is_finite() && mean.torque > 0.0);
                if means.len() < MIN_POINTS_BY_RUN {
                    means.clear();
                }
                means.into_iter().map(move |mean| RecordPoint {
                    run,
                    time: start + mean.time,
                    level: 0,
                    torque: mean.torque,
                    offset: 0.0,
                    factor: 1.0,
                })
            });
            (level, points.collect())
        })
        .filter(|(_, points): &(f64, Vec<RecordPoint>)| !points.is_empty())
        .collect();
    let levels: Vec<f64> = by_level.iter().map(|(level, _)| *level).collect();
    let mut points: Vec<RecordPoint> = by_level
        .into_iter()
        .enumerate()
        .flat_map(|(level, (_, points))| points.into_iter().map(move |p| RecordPoint { level, ..p }))
        .collect();
    points.sort_by(|a, b| a.time.total_cmp(&b.time));
    let mut with_points: Vec<usize> = points.iter().map(|p| p.run).collect();
    with_points.sort_unstable();
    with_points.dedup();
    if with_points.len() < needed {
        return Err(format!(
            "joint {joint} has no friction map: {} runs with friction at {MIN_POINTS_BY_RUN} times or more, {needed} \
             are needed",
            with_points.len()
        ));
    }
    Ok(JointRecord { joint, spans: spans.to_vec(), levels, points })
}

/// Leaves out joints whose friction does not fall while they warm: coldness means nothing there.
fn drop_flat(records: &mut Vec<JointRecord>, fits: &mut Vec<Fitted>, remarks: &mut Vec<String>) {
    let flat =
        |fit: &Fitted| fit.cold.iter().all(|cold| *cold <= 0.0) || fit.warm.iter().any(|warm| *warm <= 0.0);
    for at in (0..records.len()).rev().filter(|&at| flat(&fits[at])).collect::<Vec<_>>() {
        let record = records.remove(at);
        fits.remove(at);
        remarks.push(format!(
            "joint {} has no friction map: its friction does not fall from cold to warm in these runs",
            record.joint
        ));
    }
}

/// What one run has beyond the map, of one joint.
#[derive(Debug, Clone)]
struct Effect {
    points: usize,
    /// Friction as a factor, less one, with its variance.
    wear: f64,
    variance: f64,
    ambient: Estimate,
    /// Coldness at the start beyond the predicted one, slow and fast part.
    start: [f64; 2],
    index: Estimate,
}

/// Takes the baseline out of the effects and gives each point its run's offset and factor.
fn settle(
    record: &mut JointRecord,
    fit: &Fitted,
    effects: &mut [Effect],
    starts: &[f64],
    baseline_runs: usize,
) {
    let baseline: Vec<usize> =
        (0..effects.len()).filter(|&run| effects[run].points > 0).take(baseline_runs).collect();
    let n = baseline.len() as f64;
    let mean = |of: &dyn Fn(&Effect) -> f64| baseline.iter().map(|&run| of(&effects[run])).sum::<f64>() / n;
    let (wear, ambient) = (mean(&|e| e.wear), mean(&|e| e.ambient.value));
    let variance = mean(&|e| e.variance) / n;
    for effect in effects.iter_mut() {
        let value = (1.0 + effect.wear) / (1.0 + wear);
        effect.index = Estimate { value, std_error: (effect.variance + variance).sqrt() };
        effect.ambient.value -= ambient;
    }
    for p in &mut record.points {
        let effect = &effects[p.run];
        let [slow, fast] = start_decay(fit, p.time - starts[p.run]);
        p.offset = effect.ambient.value + slow * effect.start[0] + fast * effect.start[1];
        p.factor = effect.index.value;
    }
}

/// What is left, `seconds` into a run, of a unit of coldness at its start, in the slow and the fast part.
fn start_decay(fit: &Fitted, seconds: f64) -> [f64; 2] {
    let heating = rates(&fit.law).heating;
    let share = [fit.law[2], 1.0 - fit.law[2]];
    std::array::from_fn(|part| share[part] * (-seconds / heating[part]).exp())
}

/// Scales that the history shows, by joint.
#[derive(Debug, Clone)]
struct Scales {
    /// Scatter of points by level, as a fraction of friction.
    points: Vec<f64>,
    /// Of a level in a run.
    level: f64,
}

/// One joint's points of one run with the map's values.
struct RunRows {
    /// Level, friction of the map, its slope over coldness as a fraction of friction, decay of the start.
    rows: Vec<(usize, f64, f64, [f64; 2])>,
    torque: Vec<f64>,
    /// Slope over coldness, as a fraction of warm friction, at the largest speed.
    top: f64,
}

/// Unknowns of a joint in a run before those of its levels: wear, ambient, start slow and fast.
const EFFECTS: usize = 4;

fn run_effects(records: &[JointRecord], fits: &[Fitted], starts: &[f64]) -> Vec<Vec<Effect>> {
    let runs = starts.len();
    let rows: Vec<Vec<RunRows>> =
        records.iter().zip(fits).map(|(record, fit)| run_rows(record, fit, starts)).collect();
    let mut scales: Vec<Scales> = records
        .iter()
        .zip(&rows)
        .map(|(record, rows)| Scales { points: scatter(rows, record.levels.len()), level: LEVEL_SCALE[0] })
        .collect();
    let mut effects: Vec<Vec<Effect>> = Vec::new();
    for _ in 0..2 {
        let mut levels = vec![(0.0, 0.0); records.len()];
        effects = vec![Vec::with_capacity(runs); records.len()];
        for run in 0..runs {
            let of_run: Vec<&RunRows> = rows.iter().map(|rows| &rows[run]).collect();
            for (j, (effect, squares, count)) in one_run(&of_run, &scales).into_iter().enumerate() {
                effects[j].push(effect);
                levels[j].0 += squares;
                levels[j].1 += count;
            }
        }
        for (scale, (squares, count)) in scales.iter_mut().zip(levels) {
            if count > 0.0 {
                scale.level = (squares / count).sqrt().max(LEVEL_SCALE[1]);
            }
        }
    }
    effects
}

fn run_rows(record: &JointRecord, fit: &Fitted, starts: &[f64]) -> Vec<RunRows> {
    let top = record.levels.len() - 1;
    let top = fit.cold[top].max(f64::MIN_POSITIVE) / fit.warm[top];
    let empty = || RunRows { rows: Vec::new(), torque: Vec::new(), top };
    let mut found: Vec<RunRows> = starts.iter().map(|_| empty()).collect();
    for (p, x) in record.points.iter().zip(record_coldness(record, &fit.law)) {
        let friction = fit.warm[p.level] + fit.cold[p.level] * mixed(&fit.law, x);
        let decay = start_decay(fit, p.time - starts[p.run]);
        found[p.run].rows.push((p.level, friction, fit.cold[p.level], decay));
        found[p.run].torque.push(p.torque);
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

/// Solves one run: for each joint its effect, and the squares and number of its level deviations.
fn one_run(joints: &[&RunRows], scales: &[Scales]) -> Vec<(Effect, f64, f64)> {
    let first: Vec<usize> = joints
        .iter()
        .zip(scales)
        .scan(1, |at, (_, scale)| {
            let first = *at;
            *at += EFFECTS + scale.points.len();
            Some(first)
        })
        .collect();
    let size = first.last().zip(scales.last()).map_or(1, |(at, scale)| at + EFFECTS + scale.points.len());
    let mut x = DVector::zeros(size);
    let mut covariance = DMatrix::zeros(size, size);
    let mut wear = vec![WEAR_SCALE; joints.len()];
    for _ in 0..INNER_ROUNDS {
        let (mut information, mut score) = priors(joints, scales, &first, &wear, x[0], size);
        for (j, rows) in joints.iter().enumerate() {
            add_rows(rows, &scales[j], first[j], &x, &mut information, &mut score);
        }
        let Some(factor) = information.cholesky() else { break };
        x = factor.solve(&score);
        covariance = factor.inverse();
        for (j, scale) in wear.iter_mut().enumerate() {
            let at = first[j];
            let shown = x[at] * x[at] + covariance[(at, at)];
            *scale = f64::midpoint(WEAR_SCALE * WEAR_SCALE, shown).sqrt();
        }
    }
    joints
        .iter()
        .enumerate()
        .map(|(j, rows)| {
            let (at, levels) = (first[j], scales[j].points.len());
            let effect = Effect {
                points: rows.rows.len(),
                wear: x[at],
                variance: covariance[(at, at)].max(0.0),
                ambient: Estimate {
                    value: x[at + 1],
                    std_error: covariance[(at + 1, at + 1)].max(0.0).sqrt(),
                },
                start: [x[at + 2], x[at + 3]],
                index: Estimate { value: 1.0, std_error: f64::NAN },
            };
            let measured = if rows.rows.is_empty() { 0 } else { levels };
            let squares = (at + EFFECTS..at + EFFECTS + measured)
                .map(|k| x[k] * x[k] + covariance[(k, k)])
                .sum::<f64>();
            (effect, squares, measured as f64)
        })
        .collect()
}

/// Information and score of what is known before the run is looked at.
fn priors(
    joints: &[&RunRows],
    scales: &[Scales],
    first: &[usize],
    wear: &[f64],
    common: f64,
    size: usize,
) -> (DMatrix<f64>, DVector<f64>) {
    let mut information = DMatrix::zeros(size, size);
    information[(0, 0)] = AMBIENT_SCALE.powi(-2);
    let spread = AMBIENT_SPREAD[1].hypot(AMBIENT_SPREAD[0] * common);
    for (j, rows) in joints.iter().enumerate() {
        let at = first[j];
        information[(at, at)] = wear[j].powi(-2);
        // top * ambient_j - common has the spread among joints
        let weight = spread.powi(-2);
        information[(at + 1, at + 1)] = rows.top * rows.top * weight;
        information[(at + 1, 0)] = -rows.top * weight;
        information[(0, at + 1)] = -rows.top * weight;
        information[(0, 0)] += weight;
        for k in [at + 2, at + 3] {
            information[(k, k)] = START_SCALE.powi(-2);
        }
        for level in 0..scales[j].points.len() {
            let k = at + EFFECTS + level;
            information[(k, k)] = scales[j].level.powi(-2);
        }
    }
    (information, DVector::zeros(size))
}

/// Adds a joint's points, linearised about the coldness found so far.
fn add_rows(
    rows: &RunRows,
    scale: &Scales,
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
