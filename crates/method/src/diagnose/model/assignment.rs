//! Which torque is which joint's, with which sign, and how the arm is mounted: decided together, by the fit of all joints.
//!
//! A joint's own fit cannot decide: it knows the noise of its torque and not the errors of its model, and a wrong mounting
//! looks like a wrong sign there. The one change that explains most of the torques of all joints is the finding.

use std::f64::consts::FRAC_PI_4;

use nalgebra::{Rotation3, Unit, Vector3};

use super::alternatives::gravity_text;
use super::causes::named;
use super::joint_fit::JointFit;
use super::unmeasured::without_gravity;
use crate::identify::filtered_columns::{FilteredColumn, write_filtered_columns};
use crate::identify::joint_factors::{FactorColumns, Factored, used_for_identification};
use crate::least_squares::factor::{FactorBuilder, TriangularFactor};
use crate::model::regressor::{Regressor, joint_torque_regressor};
use crate::signal::filter::FilteredSignals;
use armwatch_model::analysis::finding::{Evidence, Finding, FindingKind, FindingSeverity};
use armwatch_model::robot::{FrictionTerm, JointIndex, MAX_JOINTS, ParameterId, ParameterKind, Robot};

/// Mean weighted square that a scale of one torque may leave: own fits leave about 1, ripple and tilt some more.
const WELL: f64 = 10.0;
/// Part of the misfit that a change may leave to be the cause.
const CAUSE: f64 = 0.5;
/// The least standard deviation of a torque's error, relative to its RMS: no model is better.
const LEAST_ERROR: f64 = 0.02;
/// The same where a joint has too few rows for a fit of its own.
const UNKNOWN_ERROR: f64 = 0.1;
/// Misfit, relative to that of each joint for itself, below which nothing is looked for: no sign can halve it.
const EXPLAINED: f64 = 2.0;
/// Error of a joint's own fit, relative to its RMS torque, from which on its torque may be another joint's.
const FOREIGN: f64 = 0.2;
/// By how much more a change of one more joint must explain.
const ONE_MORE: f64 = 0.9;
/// Scales of a torque that are tried, evenly in their logarithm.
const SCALES: [f64; 8] = [0.01, 0.03, 0.1, 0.3, 3.0, 10.0, 30.0, 100.0];
/// Factor from which on a scale is another unit or gear: gains of catalogues are good to some ten per cent.
const OTHER_UNIT: f64 = 1.5;
/// Factor of the misfit up to which another arm explains the torques as well: ripple with the posture looks like gravity.
const AS_WELL: f64 = 2.0;
/// Instants that orders and mountings are compared on.
const INSTANTS: usize = 300;
/// Instants that directions of gravity are looked for on.
const COARSE_INSTANTS: usize = 100;
/// Postures that inertias are averaged over.
const POSTURES: usize = 6;
/// Rows needed for each column of a fit of one joint.
const ROWS_PER_COLUMN: usize = 2;
/// Angle, rad, from which on another direction of gravity is another mounting and no floor that is off level.
pub(super) const MOUNTING: f64 = 0.17;
/// Step, rad, to which directions of gravity are settled.
const LEAST_STEP: f64 = 0.01;
/// Part by which the misfit may be larger with gravity along an axis or half-way between two than with the best one.
const ROUNDED: f64 = 1.3;

/// What torques are assigned by.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channels<'a> {
    /// The description.
    pub robot: &'a Robot,
    /// Columns of each joint's factor.
    pub columns: &'a FactorColumns,
    /// Columns `[b]` of the regressor that are identified.
    pub kept_columns: &'a [usize],
    /// The cycle after the low-pass.
    pub filtered: &'a FilteredSignals,
    /// Columns of the regressor that jump, low-passed.
    pub filtered_coulomb_columns: &'a [FilteredColumn],
    /// Factors of the cycle.
    pub factored: &'a Factored,
    /// Usable rows of the excitation, in order.
    pub excitation: &'a [usize],
}

/// One change of channels or mounting.
#[derive(Debug, Clone, PartialEq)]
enum Change {
    Turned(Vec<usize>),
    Swapped(usize, usize),
    Mounted(Vector3<f64>),
    Weightless,
    Scaled(usize, f64),
}

/// The change that explains the torques of all joints, if there is one: findings about signs, order or mounting.
pub(crate) fn assign(channels: &Channels<'_>) -> Vec<Finding> {
    let fits = channels.own_fits();
    if fits.iter().all(Option::is_none) || channels.excitation.is_empty() {
        return Vec::new();
    }
    let as_recorded: Vec<usize> = channels.robot.joint_indices().map(JointIndex::index).collect();
    let bounds = channels.bounds(channels.kept_columns);
    let described = channels.stored_fit(&fits, &bounds).misfit(|_| 1.0);
    let least: f64 = fits.iter().flatten().map(|of| of.misfit).sum();
    let foreign = fits.iter().flatten().any(|of| of.relative > FOREIGN);
    if described <= EXPLAINED * least && !foreign {
        return Vec::new();
    }
    let rows = channels.rows(INSTANTS);
    let factors = channels.factors(&rows);
    let errors = channels.errors(&factors);
    let sigma = errors.least();
    if sigma.iter().any(|sigma| !sigma.is_finite()) {
        return Vec::new();
    }
    let fit = channels.ordered_fit(&factors, &sigma, &as_recorded, &vec![1.0; as_recorded.len()], &bounds);
    let gravity = GravityFits::new(channels, &rows, &sigma);
    // a floor off level is no fault of a channel, and none may explain what it leaves
    let described = fit.misfit(|_| 1.0).min(gravity.level.1);
    let count = (rows.len() * as_recorded.len()) as f64;
    let changes = turned(&fit, as_recorded.len())
        .into_iter()
        .chain(channels.swapped(&factors, (&errors, &sigma), &bounds))
        // where several torques are in another unit, no single scale explains them
        .chain(channels.scaled(&factors, &sigma, &bounds).filter(|(_, misfit)| *misfit <= WELL * count))
        .chain(gravity.mounted())
        .chain(gravity.weightless);
    match changes.min_by(|a, b| a.1.total_cmp(&b.1)) {
        Some((change, misfit)) if misfit <= CAUSE * described => findings(&change, misfit / described),
        _ => Vec::new(),
    }
}

/// Whether an arm without gravity explains the torques as well as the description.
pub(crate) fn is_weightless(channels: &Channels<'_>) -> bool {
    let rows = channels.rows(INSTANTS);
    let sigma = channels.errors(&channels.factors(&rows)).least();
    let bounds = channels.bounds(&channels.whole());
    let described = channels.misfit(channels.robot, &rows, &sigma, &bounds);
    channels.misfit(&channels.under(Vector3::zeros()), &rows, &sigma, &bounds) <= AS_WELL * described
}

/// The set of turned torques that explains most; a further joint counts if it explains a good part more.
fn turned(fit: &JointFit, n: usize) -> Option<(Change, f64)> {
    let sign = |set: u32, joint: usize| if set & (1 << joint) == 0 { 1.0 } else { -1.0 };
    let misfit = |set: u32| fit.misfit(|joint| sign(set, joint));
    let price = |set: u32| misfit(set) * ONE_MORE.powi(-(set.count_ones() as i32));
    let best = (1..1_u32 << n).min_by(|&a, &b| price(a).total_cmp(&price(b)))?;
    Some((Change::Turned((0..n).filter(|j| best & (1 << j) != 0).collect()), misfit(best)))
}

/// What a joint's torque leaves beside its own columns.
#[derive(Debug, Clone, Copy)]
struct OwnFit {
    /// Standard deviation of the error, Nm (N).
    sigma: f64,
    /// The same relative to the RMS torque.
    relative: f64,
    /// Weighted squares that are left.
    misfit: f64,
}

/// Error of a fit of one joint: `left` squares of `rows` rows with `columns` columns, beside `all` squares of the torque.
fn own_fit(left: f64, all: f64, rows: f64, columns: usize) -> Option<OwnFit> {
    let rms = (all / rows).sqrt();
    let judged = rows >= (ROWS_PER_COLUMN * columns) as f64;
    let error = if judged { (left / (rows - columns as f64)).sqrt() } else { UNKNOWN_ERROR * rms };
    let sigma = error.max(LEAST_ERROR * rms);
    let relative = if judged { error / rms } else { 0.0 };
    (rms > 0.0 && sigma.is_finite()).then(|| OwnFit {
        sigma,
        relative,
        misfit: rows.min(left.max(0.0) / sigma.powi(2)),
    })
}

/// Rows of one joint in a fit of all.
struct Part<'a> {
    factor: &'a TriangularFactor,
    /// Column of its torque.
    torque: usize,
    /// Standard deviation of the torque's error, Nm (N), as recorded.
    sigma: f64,
    /// How many times as large as it is the torque was recorded.
    scale: f64,
}

/// Standard deviation of the error of each torque in the rows of each joint, `[joints][torques]`, Nm (N).
struct Errors(Vec<Vec<f64>>);

impl Errors {
    /// Of each torque beside the columns of the joint that explains it best.
    fn least(&self) -> Vec<f64> {
        let n = self.0.len();
        (0..n).map(|torque| self.0.iter().map(|of| of[torque]).fold(f64::INFINITY, f64::min)).collect()
    }

    /// Whether the joints' own columns explain the other's torque better.
    fn are_swapped(&self, a: usize, b: usize) -> bool {
        let of = &self.0;
        of[a][b] * of[b][a] < of[a][a] * of[b][b]
    }
}

impl Channels<'_> {
    fn factor(&self, joint: JointIndex) -> Option<&TriangularFactor> {
        let of = |of: &&crate::identify::joint_factors::JointFactor| {
            of.joint == joint && used_for_identification(of.stage, of.motion)
        };
        self.factored
            .factors
            .iter()
            .find(of)
            .map(|of| &of.factor)
            .filter(|of| of.is_finite() && of.rows() > 0)
    }

    fn own_fits(&self) -> Vec<Option<OwnFit>> {
        let fit = |joint: JointIndex| {
            let factor = self.factor(joint)?;
            let b = factor.columns();
            let left = factor.upper()[(b, b)].powi(2);
            own_fit(left, factor.torque_sum_of_squares(), factor.rows() as f64, b)
        };
        self.robot.joint_indices().map(fit).collect()
    }

    /// The fit of all joints to their own torques, from stored factors.
    fn stored_fit(&self, fits: &[Option<OwnFit>], bounds: &[Vec<f64>]) -> JointFit {
        let own = |joint: JointIndex| {
            let factor = self.factor(joint)?;
            Some(Part { factor, torque: factor.columns(), sigma: fits[joint.index()]?.sigma, scale: 1.0 })
        };
        self.stacked(&self.robot.joint_indices().map(own).collect::<Vec<_>>(), bounds)
    }

    /// The fit of all joints, to each the torque that `order` gives it, recorded `scales` times as large as it is.
    fn ordered_fit(
        &self,
        factors: &[TriangularFactor],
        sigma: &[f64],
        order: &[usize],
        scales: &[f64],
        bounds: &[Vec<f64>],
    ) -> JointFit {
        let n = order.len();
        let parts: Vec<Option<Part<'_>>> = factors
            .iter()
            .zip(order)
            .zip(scales)
            .map(|((factor, &torque), &scale)| {
                let column = factor.columns() + 1 - n + torque;
                Some(Part { factor, torque: column, sigma: sigma[torque], scale })
            })
            .collect();
        self.stacked(&parts, bounds)
    }

    /// Factors of single joints together, each with the column of its torque and the standard deviation of the error.
    fn stacked(&self, parts: &[Option<Part<'_>>], bounds: &[Vec<f64>]) -> JointFit {
        let (b, n) = (self.kept_columns.len(), parts.len());
        let mut builder = FactorBuilder::new(b + n - 1);
        let mut row = vec![0.0; b + n];
        for (joint, part) in self.robot.joint_indices().zip(parts) {
            let Some(Part { factor, torque, sigma, scale }) = part else { continue };
            let (upper, places) = (factor.upper(), self.columns.places(joint));
            for i in 0..upper.nrows() {
                row.fill(0.0);
                places.iter().enumerate().for_each(|(k, &place)| row[place] = upper[(i, k)] * scale / sigma);
                row[b + joint.index()] = upper[(i, *torque)] / sigma;
                builder.push(row.iter().copied());
            }
        }
        JointFit::new(&builder.take(), b, n, bounds)
    }

    /// Rows of the excitation, so many at most.
    fn rows(&self, instants: usize) -> Vec<usize> {
        let apart = (self.filtered.sample_rate / (2.0 * self.filtered.cutoff)).ceil().max(1.0) as usize;
        let stride = apart.max(self.excitation.len().div_ceil(instants));
        self.excitation.iter().copied().step_by(stride).collect()
    }

    /// Mean power of friction and mean inertia of each joint as sums of the parameters of `columns`.
    fn bounds(&self, columns: &[usize]) -> Vec<Vec<f64>> {
        let n = self.robot.joint_count();
        let order = ParameterId::natural_order(self.robot);
        let place = |column: usize| match order[column].kind {
            // an offset of the torque signal is no friction, whatever its sign
            ParameterKind::Friction(term) if term != FrictionTerm::Offset => {
                Some(order[column].joint.index())
            }
            _ => None,
        };
        let mut bounds = vec![vec![0.0; columns.len()]; 2 * n];
        let mut y = Regressor::new(self.robot);
        let mut state = State::default();
        for &row in &self.rows(COARSE_INSTANTS) {
            self.regressor(self.robot, row, &mut state, &mut y);
            for (k, &column) in columns.iter().enumerate() {
                let Some(j) = place(column) else { continue };
                if state.qd[j].abs() >= self.robot.joints[j].low_speed {
                    bounds[j][k] += state.qd[j] * y.column(column)[j];
                }
            }
        }
        let mut resting = Regressor::new(self.robot);
        let still = [0.0; MAX_JOINTS];
        for &row in &self.rows(POSTURES) {
            self.filtered.row(row, &mut state.q, &mut state.qd, &mut state.qdd, &mut state.tau);
            let q = &state.q[..n];
            joint_torque_regressor(self.robot, q, &still[..n], &still[..n], &mut resting);
            for j in 0..n {
                let mut unit = still;
                unit[j] = 1.0;
                joint_torque_regressor(self.robot, q, &still[..n], &unit[..n], &mut y);
                for (sum, &column) in bounds[n + j].iter_mut().zip(columns) {
                    *sum += y.column(column)[j] - resting.column(column)[j];
                }
            }
        }
        bounds
    }

    fn regressor(&self, robot: &Robot, row: usize, state: &mut State, y: &mut Regressor) {
        let n = robot.joint_count();
        let State { q, qd, qdd, tau } = state;
        self.filtered.row(row, q, qd, qdd, tau);
        joint_torque_regressor(robot, &q[..n], &qd[..n], &qdd[..n], y);
        write_filtered_columns(self.filtered_coulomb_columns, row, y);
    }

    /// Factor of each joint's columns with the torques of all joints, over its moving rows.
    fn factors(&self, rows: &[usize]) -> Vec<TriangularFactor> {
        let n = self.robot.joint_count();
        let mut y = Regressor::new(self.robot);
        let mut state = State::default();
        let mut builders: Vec<(Vec<usize>, FactorBuilder)> = self
            .robot
            .joint_indices()
            .map(|joint| {
                let columns: Vec<usize> =
                    self.columns.places(joint).iter().map(|&place| self.kept_columns[place]).collect();
                let builder = FactorBuilder::new(columns.len() + n - 1);
                (columns, builder)
            })
            .collect();
        for &row in rows {
            self.regressor(self.robot, row, &mut state, &mut y);
            for (j, (columns, builder)) in builders.iter_mut().enumerate() {
                if state.qd[j].abs() >= self.robot.joints[j].low_speed {
                    let entries = columns.iter().map(|&column| y.column(column)[j]);
                    builder.push(entries.chain(state.tau[..n].iter().copied()));
                }
            }
        }
        builders.iter_mut().map(|(_, builder)| builder.take()).collect()
    }

    fn errors(&self, factors: &[TriangularFactor]) -> Errors {
        let n = factors.len();
        let of_joint = |factor: &TriangularFactor| -> Vec<f64> {
            let (upper, b) = (factor.upper(), factor.columns() + 1 - n);
            let squares = |torque: usize, from: usize| -> f64 {
                (from..=b + torque).map(|i| upper[(i, b + torque)].powi(2)).sum()
            };
            let error = |torque| own_fit(squares(torque, b), squares(torque, 0), factor.rows() as f64, b);
            (0..n).map(|torque| error(torque).map_or(f64::INFINITY, |of| of.sigma)).collect()
        };
        Errors(factors.iter().map(of_joint).collect())
    }

    /// The two torques that explain most when they are swapped, among those that the other joint's columns explain better.
    fn swapped(
        &self,
        factors: &[TriangularFactor],
        (errors, sigma): (&Errors, &[f64]),
        bounds: &[Vec<f64>],
    ) -> Option<(Change, f64)> {
        let n = factors.len();
        let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
        let judged = pairs.filter(|&(a, b)| errors.are_swapped(a, b)).map(|(a, b)| {
            let mut order: Vec<usize> = (0..n).collect();
            order.swap(a, b);
            let fit = self.ordered_fit(factors, sigma, &order, &vec![1.0; n], bounds);
            (Change::Swapped(a, b), fit.misfit(|_| 1.0))
        });
        judged.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Weighted squares that a description with the friction and the joints of this one leaves over `rows`.
    fn misfit(&self, robot: &Robot, rows: &[usize], sigma: &[f64], bounds: &[Vec<f64>]) -> f64 {
        let (n, b) = (robot.joint_count(), robot.parameter_count());
        let mut builder = FactorBuilder::new(b + n - 1);
        let mut y = Regressor::new(robot);
        let mut state = State::default();
        for &row in rows {
            self.regressor(robot, row, &mut state, &mut y);
            for (j, sigma) in sigma.iter().enumerate() {
                if state.qd[j].abs() >= robot.joints[j].low_speed {
                    let entries = (0..b).map(|column| y.column(column)[j] / sigma);
                    let torques = (0..n).map(|of| if of == j { state.tau[j] / sigma } else { 0.0 });
                    builder.push(entries.chain(torques));
                }
            }
        }
        JointFit::new(&builder.take(), b, n, bounds).misfit(|_| 1.0)
    }

    /// All columns of the regressor.
    fn whole(&self) -> Vec<usize> {
        (0..self.robot.parameter_count()).collect()
    }

    /// The arm under another gravity, m/s².
    fn under(&self, gravity: Vector3<f64>) -> Robot {
        Robot { gravity, ..self.robot.clone() }
    }

    /// The scale of one torque that explains most, where it is another unit and no gain that is a little off.
    fn scaled(
        &self,
        factors: &[TriangularFactor],
        sigma: &[f64],
        bounds: &[Vec<f64>],
    ) -> Option<(Change, f64)> {
        let n = factors.len();
        let order: Vec<usize> = (0..n).collect();
        let misfit = |joint: usize, scale: f64| {
            let mut weights = vec![1.0; n];
            weights[joint] = scale;
            self.ordered_fit(factors, sigma, &order, &weights, bounds).misfit(|_| 1.0)
        };
        let tried = order.iter().flat_map(|&joint| SCALES.map(|scale| (joint, scale)));
        let judged = tried.map(|(joint, scale)| (joint, scale, misfit(joint, scale)));
        let (joint, mut scale, mut least) = judged.min_by(|a, b| a.2.total_cmp(&b.2))?;
        let mut step = SCALES[1] / SCALES[0];
        while step > 1.01 {
            step = step.sqrt();
            for tried in [scale * step, scale / step] {
                let found = misfit(joint, tried);
                if found < least {
                    (scale, least) = (tried, found);
                }
            }
        }
        (scale.max(1.0 / scale) > OTHER_UNIT).then_some((Change::Scaled(joint, scale), least))
    }
}

/// What directions of gravity leave of the torques.
struct GravityFits {
    described: Vector3<f64>,
    /// The best direction near the described one: a floor off level.
    level: (Vector3<f64>, f64),
    /// The best direction of all.
    best: (Vector3<f64>, f64),
    /// No gravity, as torques show it of which the controller has subtracted gravity.
    weightless: Option<(Change, f64)>,
}

impl GravityFits {
    fn new(channels: &Channels<'_>, rows: &[usize], sigma: &[f64]) -> Self {
        let described = channels.robot.gravity;
        let g = described.norm();
        let bounds = channels.bounds(&channels.whole());
        let misfit = |rows: &[usize], gravity: &Vector3<f64>| {
            channels.misfit(&channels.under(*gravity), rows, sigma, &bounds)
        };
        if g <= 0.0 {
            let found = (described, misfit(rows, &described));
            return Self { described, level: found, best: found, weightless: None };
        }
        let coarse = channels.rows(COARSE_INSTANTS);
        let settled = |mut best: Vector3<f64>, first_step: f64, farthest: f64| {
            let (mut least, mut step) = (misfit(&coarse, &best), first_step);
            while step > LEAST_STEP {
                let side = best.cross(&across(&best)).normalize();
                let axes = [side, best.cross(&side)];
                let near =
                    axes.iter().flat_map(|axis| [step, -step].map(|angle| turned_about(axis, angle) * best));
                let near = near.filter(|towards| described.angle(towards) <= farthest);
                let nearest = near
                    .map(|towards| (towards, misfit(&coarse, &towards)))
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                match nearest {
                    Some((towards, found)) if found < least => (best, least) = (towards, found),
                    _ => step *= 0.5,
                }
            }
            best
        };
        let of = |gravity: Vector3<f64>| (gravity, misfit(rows, &gravity));
        let level = of(settled(described, MOUNTING / 4.0, MOUNTING));
        let grid = directions()
            .into_iter()
            .map(|towards| g * towards)
            .map(|gravity| (gravity, misfit(&coarse, &gravity)));
        let rounded = grid.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(described, |(gravity, _)| gravity);
        let (rounded, settled) = (of(rounded), of(settled(rounded, 0.5 * FRAC_PI_4, f64::INFINITY)));
        let best = if rounded.1 <= ROUNDED * settled.1 { rounded } else { settled };
        let weightless = Some((Change::Weightless, misfit(rows, &Vector3::zeros())));
        Self { described, level, best, weightless }
    }

    /// The best direction, where it is another mounting.
    fn mounted(&self) -> Option<(Change, f64)> {
        // first moments that turn with gravity may make a floor off level look like a wall
        let is_floor =
            self.described.angle(&self.level.0) <= MOUNTING && self.level.1 <= ROUNDED * self.best.1;
        let is_other = self.described.norm() > 0.0 && self.described.angle(&self.best.0) > MOUNTING;
        (is_other && !is_floor).then_some((Change::Mounted(self.best.0), self.best.1))
    }
}

/// A direction that is not along `of`.
fn across(of: &Vector3<f64>) -> Vector3<f64> {
    if of.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }
}

fn turned_about(axis: &Vector3<f64>, angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Unit::new_normalize(*axis), angle)
}

/// The axes of the base and the directions half-way between two of them, 18 in all.
fn directions() -> Vec<Vector3<f64>> {
    let steps = [-1.0, 0.0, 1.0];
    let all =
        steps.iter().flat_map(|&x| steps.iter().flat_map(move |&y| steps.map(|z| Vector3::new(x, y, z))));
    all.filter(|of| (1.0..2.5).contains(&of.norm_squared())).map(|of| of.normalize()).collect()
}

/// One instant of all joints.
#[derive(Debug, Clone, Copy, Default)]
struct State {
    q: [f64; MAX_JOINTS],
    qd: [f64; MAX_JOINTS],
    qdd: [f64; MAX_JOINTS],
    tau: [f64; MAX_JOINTS],
}

/// Findings of a change that leaves `ratio` of the squares of the torque error.
fn findings(change: &Change, ratio: f64) -> Vec<Finding> {
    let left = 100.0 * ratio.sqrt();
    let finding = |kind, joint: Option<usize>, sentence: String| Finding {
        kind,
        severity: FindingSeverity::Refuse,
        joint: joint.map(JointIndex::new),
        sentence,
        evidence: vec![Evidence { name: "residual_ratio", value: ratio }],
    };
    match change {
        Change::Turned(joints) => {
            let of_joint = |&joint: &usize| {
                let sentence = format!(
                    "joint {}: its torque has the wrong sign: with the sign turned, the torque error of the arm would be \
                     {left:.0} % of what it is; turn the sign of the torque in the export layout",
                    JointIndex::new(joint)
                );
                finding(FindingKind::TorqueSign, Some(joint), sentence)
            };
            joints.iter().map(of_joint).collect()
        }
        Change::Swapped(a, b) => {
            let sentence = format!(
                "{}: the torque of each follows the motion of the other; with the two exchanged, the torque error of the arm \
                 would be {left:.0} % of what it is: the torque columns, or position and velocity together, are swapped",
                named(&[JointIndex::new(*a), JointIndex::new(*b)])
            );
            vec![finding(FindingKind::TorqueSwapped, Some(*a), sentence)]
        }
        Change::Scaled(joint, scale) => {
            let sentence = format!(
                "the torques contradict the description: with the scale of the torque of joint {} = {scale:.3} in place of \
                 1.000 the torque error would be {left:.0} % of what it is: check the unit (percent of rated, motor side, \
                 current), gain and gear ratio of that torque first",
                JointIndex::new(*joint)
            );
            vec![finding(FindingKind::Description, Some(*joint), sentence)]
        }
        Change::Weightless => {
            let words = format!("without it, the torque error of the arm would be {left:.0} % of what it is");
            vec![without_gravity(&words, ("residual_ratio", ratio))]
        }
        Change::Mounted(gravity) => {
            let sentence = format!(
                "the torques contradict the description: with {} (how the arm is mounted) the torque error would be \
                 {left:.0} % of what it is: check that first",
                gravity_text(gravity)
            );
            vec![finding(FindingKind::Description, None, sentence)]
        }
    }
}
