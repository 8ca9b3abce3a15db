//! Load of gravity and springs on a joint that moves alone, separated from its friction [5.3].

use faer::Mat;

use crate::least_squares::factor::TriangularFactor;
use crate::model::dynamics::DynamicModel;
use crate::model::kinematics::joint_axis_in_base;
use crate::signal::filter::FilteredSignals;
use crate::statistics::descriptive::{mean, standard_deviation};
use armwatch_model::analysis::GravityRemoval;
use armwatch_model::robot::{FrictionModel, JointIndex, JointKind, MAX_JOINTS, Robot, Spring, SpringForm};

/// Largest angle to the vertical, rad, of an axis without gravity. Floors tilt by up to 0.5 degrees, which does not
/// change a plateau's mean over both directions.
const VERTICAL_TOLERANCE: f64 = 0.02;

/// Largest scaled condition number of the gravity fit. Sine and cosine of a short travel are nearly parallel, which
/// harms their coefficients but not their sum inside the travel.
const MAX_GRAVITY_CONDITION: f64 = 1e6;

/// Largest scaled condition number of the fit that separates the torque's own constant from the load. If the travel is
/// less than about 0.2 rad in each direction, that constant would be noise, and the load includes it.
const MAX_OFFSET_CONDITION: f64 = 200.0;

/// Largest allowed ratio of the variance of a plateau's friction, after removal of a fitted load, to that of its mean
/// torque. A motion back and forth over one travel has a ratio of one to four.
const MAX_INFLATION: f64 = 10.0;

/// Largest error of the load, as a fraction of friction, if the factor exceeds [`MAX_INFLATION`]: half of the smallest
/// change of friction that matters.
const MAX_LOAD_ERROR: f64 = 0.025;

/// Friction of a plateau after gravity is removed.
pub(super) struct Freed {
    /// Mean torque, Nm (N).
    pub(super) torque: f64,
    /// Same as [`armwatch_model::analysis::FrictionPoint::std`], Nm (N).
    pub(super) std: f64,
    /// Method of removing gravity.
    pub(super) how: GravityRemoval,
}

/// Load of gravity on the joint under test.
pub(super) struct Gravity<'a> {
    robot: &'a Robot,
    filtered: &'a FilteredSignals,
    joint: JointIndex,
    acts: bool,
    fit: Option<GravityFit<'a>>,
    model: Option<&'a DynamicModel>,
}

impl<'a> Gravity<'a> {
    /// Fits the load on the rows `tested` of the joint, at least one.
    pub(super) fn new(
        robot: &'a Robot,
        filtered: &'a FilteredSignals,
        model: Option<&'a DynamicModel>,
        joint: JointIndex,
        tested: &[usize],
    ) -> Self {
        let with_gravity = carries_gravity(robot, filtered, joint, tested[tested.len() / 2]);
        let acts = with_gravity || robot.springs_of(joint).next().is_some();
        let fit_of = |with_offset| {
            GravityFit::new(robot, filtered, (joint, tested), Loaded { with_gravity, with_offset })
        };
        let fit = if acts { fit_of(true).or_else(|| fit_of(false)) } else { None };
        Self { robot, filtered, joint, acts, fit, model }
    }

    /// Friction over the rows of a plateau; `None` if neither its motion nor a model separates it from the load.
    pub(super) fn remove(&self, plateau: &[usize]) -> Option<Freed> {
        if !self.acts {
            return self.less(plateau, |_| 0.0, GravityRemoval::AxisVertical);
        }
        self.fitted(plateau).or_else(|| {
            let model = self.model?;
            self.less(plateau, |row| self.modelled_load(model, row), GravityRemoval::Model)
        })
    }

    fn less(&self, plateau: &[usize], load: impl Fn(usize) -> f64, how: GravityRemoval) -> Option<Freed> {
        let tau = &self.filtered.tau[self.joint.index()];
        let torque: Vec<f64> = plateau.iter().map(|&row| tau[row] - load(row)).collect();
        Some(Freed { torque: mean(&torque)?, std: standard_deviation(&torque).unwrap_or(0.0), how })
    }

    fn fitted(&self, plateau: &[usize]) -> Option<Freed> {
        let fit = self.fit.as_ref()?;
        let freed = self.less(plateau, |row| fit.load(self.filtered, row), GravityRemoval::Fitted)?;
        let excess = fit.inflation(self.filtered, plateau) - 1.0;
        let independent = plateau.len() as f64 * independent_share(self.filtered);
        let load_error = fit.residual_std * (excess / independent).sqrt();
        let told = excess < MAX_INFLATION || load_error < MAX_LOAD_ERROR * freed.torque.abs();
        told.then(|| Freed { std: freed.std.hypot(fit.residual_std * excess.sqrt()), ..freed })
    }

    fn modelled_load(&self, model: &DynamicModel, row: usize) -> f64 {
        let n = self.robot.joint_count();
        let (mut q, mut torque) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for (q, channel) in q.iter_mut().zip(&self.filtered.q) {
            *q = channel[row];
        }
        let still = [0.0; MAX_JOINTS];
        model.load(self.robot, &q[..n], &still[..n], &still[..n], &mut torque[..n]);
        torque[self.joint.index()]
    }
}

/// Share of all rows (not of every n-th) that are independent: a low-pass at `f_c` leaves `2 f_c` per second.
fn independent_share(filtered: &FilteredSignals) -> f64 {
    (2.0 * filtered.cutoff / filtered.sample_rate).min(1.0)
}

/// Returns true if gravity does work on the joint in the posture of `row`: a rotary axis that is not vertical, a
/// sliding axis that is not horizontal.
fn carries_gravity(robot: &Robot, filtered: &FilteredSignals, joint: JointIndex, row: usize) -> bool {
    let g = robot.gravity.norm();
    if g == 0.0 {
        return false;
    }
    let q: Vec<f64> = filtered.q.iter().map(|channel| channel[row]).collect();
    let axis = joint_axis_in_base(robot, &q, joint);
    let along = (axis.dot(&robot.gravity) / g).clamp(-1.0, 1.0);
    match robot.joints[joint.index()].kind {
        JointKind::Revolute => along.abs().acos() > VERTICAL_TOLERANCE,
        JointKind::Prismatic => along.abs() > VERTICAL_TOLERANCE.sin(),
    }
}

/// Possible loads of a joint in addition to its springs.
#[derive(Clone, Copy)]
struct Loaded {
    with_gravity: bool,
    with_offset: bool,
}

/// Least squares of [5.3] over the moving rows of the joint's friction stage:
/// `tau = -mPx sin(theta) - mPy cos(theta) + I_m qdd + f1 sign(qd) + .. + f4 qd³`, and a constant. The constant is an
/// offset of the torque signal; it is no load and remains in the torque. A sliding joint has a constant load, and so
/// has a spring that no motion distinguishes from an offset.
struct GravityFit<'a> {
    joint: JointIndex,
    kind: JointKind,
    /// Number of gravity columns, which are the first ones.
    of_gravity: usize,
    springs: Vec<&'a Spring>,
    with_offset: bool,
    /// Coefficients of the load, the first among the columns.
    load: Vec<f64>,
    /// `R⁻¹` of the columns `X = Q R`.
    inverse: Mat<f64>,
    /// Standard deviation of the residual, Nm (N).
    residual_std: f64,
}

impl<'a> GravityFit<'a> {
    /// Fits the columns; `None` if the motion does not distinguish them, or has too few rows to estimate the residual.
    fn new(
        robot: &'a Robot,
        filtered: &FilteredSignals,
        (joint, tested): (JointIndex, &[usize]),
        Loaded { with_gravity, with_offset }: Loaded,
    ) -> Option<Self> {
        let description = &robot.joints[joint.index()];
        let springs: Vec<&Spring> = robot.springs_of(joint).collect();
        let has_constant = (with_gravity && description.kind == JointKind::Prismatic)
            || springs.iter().any(|spring| spring.form == SpringForm::Direct);
        if with_offset && has_constant {
            return None;
        }
        let qd = &filtered.qd[joint.index()];
        let mut fit = Self {
            joint,
            kind: description.kind,
            of_gravity: match (with_gravity, description.kind) {
                (false, _) => 0,
                (true, JointKind::Revolute) => 2,
                (true, JointKind::Prismatic) => 1,
            },
            springs,
            with_offset,
            load: Vec::new(),
            inverse: Mat::new(),
            residual_std: 0.0,
        };
        // near the start or a reversal of the motion, low-passed friction is between two values
        let margin = (0.5 * filtered.sample_rate / filtered.cutoff).ceil() as usize;
        let goes_on = |row: usize, other: Option<usize>| {
            other
                .and_then(|other| qd.get(other))
                .is_some_and(|v| v * qd[row].signum() > description.low_speed)
        };
        let inside = |row: usize| {
            goes_on(row, Some(row))
                && goes_on(row, row.checked_sub(margin))
                && goes_on(row, Some(row + margin))
        };
        let moving: Vec<usize> = tested.iter().copied().filter(|&row| inside(row)).collect();
        let columns = fit.row(filtered, *moving.first()?).count();
        let mut rows = Mat::<f64>::zeros(moving.len(), columns + 1);
        for (i, &row) in moving.iter().enumerate() {
            let torque = filtered.tau[joint.index()][row];
            fit.row(filtered, row).chain([torque]).enumerate().for_each(|(k, entry)| rows[(i, k)] = entry);
        }
        let mut factor = TriangularFactor::new(columns);
        factor.fold(rows.as_ref());
        let freedom = moving.len() as f64 * independent_share(filtered) - columns as f64;
        let most = if with_offset { MAX_OFFSET_CONDITION } else { MAX_GRAVITY_CONDITION };
        let solved = factor.solve(most, |i| i.to_string()).ok().filter(|_| freedom >= 1.0)?;
        fit.load = solved.theta[..fit.loads()].to_vec();
        fit.inverse = factor.inverse_of_upper().ok()?;
        let independent = solved.residual_sum_of_squares * independent_share(filtered);
        fit.residual_std = (independent / freedom).sqrt();
        Some(fit)
    }

    fn loads(&self) -> usize {
        self.of_gravity + self.springs.iter().map(|spring| self.columns_of(spring)).sum::<usize>()
    }

    /// Number of columns of a spring. For a sliding joint, its constant load coincides with that of gravity.
    fn columns_of(&self, spring: &Spring) -> usize {
        match (self.kind, spring.form) {
            (JointKind::Prismatic, SpringForm::Direct) if self.of_gravity > 0 => 1,
            _ => 2,
        }
    }

    /// Columns of one row: loads, inertia, friction, constant.
    fn row(&self, filtered: &FilteredSignals, row: usize) -> impl Iterator<Item = f64> {
        let j = self.joint.index();
        let q = filtered.q[j][row];
        let gravity = match self.kind {
            JointKind::Revolute => [-q.sin(), -q.cos()],
            JointKind::Prismatic => [1.0, 0.0],
        };
        let springs = self
            .springs
            .iter()
            .flat_map(move |spring| spring.columns(q).into_iter().take(self.columns_of(spring)));
        let friction = FrictionModel::POLYNOMIAL.columns(filtered.qd[j][row]);
        let gravity = gravity.into_iter().take(self.of_gravity);
        gravity
            .chain(springs)
            .chain([filtered.qdd[j][row]])
            .chain(friction.into_iter().take(4))
            .chain(self.with_offset.then_some(1.0))
    }

    fn load(&self, filtered: &FilteredSignals, row: usize) -> f64 {
        self.load.iter().zip(self.row(filtered, row)).map(|(coefficient, entry)| coefficient * entry).sum()
    }

    /// Variance of the friction of a plateau over that of its mean torque, at least 1.
    ///
    /// Let `x` be the mean of the plateau's rows of `X`, `c` its load (the entries of `x` at the loads, zeros
    /// elsewhere) and `g = (XᵀX)⁻¹ c`. Friction is the sum of `w_i tau_i` with `w_i = 1/n - x_i·g` on the plateau
    /// and `-x_i·g` elsewhere, so that `n sum w_i² = 1 + n (c·g - 2 x·g)`.
    fn inflation(&self, filtered: &FilteredSignals, plateau: &[usize]) -> f64 {
        let columns = self.inverse.ncols();
        let n = plateau.len() as f64;
        let mut x = Mat::<f64>::zeros(columns, 1);
        for &row in plateau {
            self.row(filtered, row).enumerate().for_each(|(k, entry)| x[(k, 0)] += entry / n);
        }
        let c = Mat::from_fn(columns, 1, |k, _| if k < self.loads() { x[(k, 0)] } else { 0.0 });
        let g = &self.inverse * (self.inverse.transpose() * &c);
        let along = |of: &Mat<f64>| (0..columns).map(|k| of[(k, 0)] * g[(k, 0)]).sum::<f64>();
        (1.0 + n * (along(&c) - 2.0 * along(&x))).max(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::friction::points::plateaus::tests::{RATE, friction, one_joint, points};
    use armwatch_model::run::{FrictionSignal, Samples, Stage};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// Motion from `-travel / 2` to `travel / 2` at `speed` rad/s, and back if `back`.
    fn moves(travel: f64, speed: f64, back: bool, noise: &mut ChaCha8Rng) -> Samples {
        const ACCELERATION: f64 = 4.0;
        let mut samples = Samples { position: vec![vec![]], torque: vec![vec![]], ..Samples::default() };
        let (mut velocity, mut signal) = (Vec::new(), Vec::new());
        let signs: &[f64] = if back { &[1.0, -1.0] } else { &[1.0] };
        for (level, v) in [(3, speed)] {
            let ramp = v / ACCELERATION;
            let hold = travel / v - ramp;
            for &sign in signs {
                for row in 0..((2.0 * ramp + hold) * RATE) as usize {
                    let t = row as f64 / RATE;
                    let (s, qd, qdd) = if t < ramp {
                        (0.5 * ACCELERATION * t * t, ACCELERATION * t, ACCELERATION)
                    } else if t < ramp + hold {
                        (0.5 * v * ramp + v * (t - ramp), v, 0.0)
                    } else {
                        let left = 2.0 * ramp + hold - t;
                        (travel - 0.5 * ACCELERATION * left * left, ACCELERATION * left, -ACCELERATION)
                    };
                    let q = sign * (s - 0.5 * travel);
                    let load = 11.0 * (q + 0.3).cos();
                    let torque = 0.4 * sign * qdd + friction(sign * qd) + load;
                    samples.time.push(samples.time.len() as f64 / RATE);
                    samples.position[0].push(q);
                    velocity.push(sign * qd);
                    samples.torque[0].push(torque + 0.1 * noise.sample::<f64, _>(StandardNormal));
                    samples.stage.push(Stage::Friction);
                    signal.push(Some(FrictionSignal { joint: JointIndex::new(0), level }));
                }
            }
        }
        samples.velocity = Some(vec![velocity]);
        samples.friction_signal = Some(signal);
        samples
    }

    /// Errors over stated errors of all points in 100 recordings, and the remarks of the last one.
    fn errors(travel: f64, speed: f64, back: bool) -> (Vec<f64>, Vec<String>) {
        let robot = one_joint(true);
        let (mut found, mut remarks) = (Vec::new(), Vec::new());
        for seed in 0..100 {
            let samples = moves(travel, speed, back, &mut ChaCha8Rng::seed_from_u64(seed));
            let of = points(&robot, &samples);
            remarks = of.remarks;
            let share = 2.0 * 12.0 / RATE;
            found.extend(of.points.iter().map(|point| {
                let error = point.torque * f64::from(point.direction) - friction(point.speed);
                error / (point.std / (point.samples as f64 * share).sqrt())
            }));
        }
        (found, remarks)
    }

    fn covered(errors: &[f64]) -> f64 {
        errors.iter().filter(|error| error.abs() < 1.96).count() as f64 / errors.len() as f64
    }

    #[test]
    fn a_short_move_one_way_gives_no_point_and_says_why() {
        for travel in [0.3, 0.5, 0.8] {
            let (found, remarks) = errors(travel, 0.5, false);
            assert!(found.is_empty(), "{travel}: {found:?}");
            assert!(
                remarks.iter().any(|of| of.contains("does not tell friction from the load")),
                "{remarks:?}"
            );
        }
    }

    /// If each of 100 errors is within 1.96 with a probability of 95 %, 86 of them are four standard deviations below
    /// the mean.
    #[test]
    fn stated_errors_cover_the_truth() {
        let back_and_forth = [0.3, 0.5, 1.0, 2.0, 4.0].map(|travel| (travel, true));
        for (travel, back) in back_and_forth.into_iter().chain([(1.5, false), (2.0, false), (4.0, false)]) {
            let (found, _) = errors(travel, 0.5, back);
            assert_eq!(found.len(), if back { 200 } else { 100 }, "{travel}");
            assert!(covered(&found) > 0.86, "{travel} {back}: {}", covered(&found));
        }
    }
}
