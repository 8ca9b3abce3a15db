//! The search for an excitation trajectory as a smooth problem without bounds: variables that represent a series, their
//! cost, and its gradient.
//!
//! A series that starts and ends at rest without acceleration has `2 N - 1` free variables per joint: the last cosine
//! and sine amplitudes follow from the others. A series of sines alone [4.1] has `N` of them: without `b` its
//! acceleration at the start is zero for any amplitudes. Exceeded limits cost the square of the excess; a resulting
//! series is then made to keep them exactly ([`SearchProblem::within_limits`]).

mod penalties;

use faer::Mat;

use super::clearance::ClearanceLimit;
use super::information::Information;
use super::limits::{MotionLimits, TorqueLimits, extremes};
use super::objective::{Objective, Valued};
use super::observation::{JointRows, MotionSlope, ObservationColumns};
use super::series::{Basis, between_instants};
use armwatch_method::NumericsError;
use armwatch_method::lanes::Lanes;
use armwatch_method::model::base_parameters::BaseParameters;
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes};
use armwatch_model::robot::{FourierExcitation, Robot};

/// Instants per period for each harmonic: 50 for the shortest wave, which resolves all extremes.
pub const INSTANTS_PER_HARMONIC: usize = 50;

/// Additional distance from a limit in the final series, so that rounding does not break it.
const CLEARANCE: f64 = 1e-9;

/// Power that makes the smooth condition number equal to the condition number, to a millionth.
const SHARP: f64 = 1e6;

/// Weight of missed limits in a resulting series: missing a limit by 1 % counts as 10 % worse.
const MISSED: f64 = 1e3;

/// Settings of the search, besides the arm itself.
#[derive(Debug, Clone)]
pub struct SearchSettings {
    /// Duration of the period, s.
    pub period: f64,
    /// Harmonics `N`, 2 or more.
    pub harmonics: usize,
    /// Kinds of waves.
    pub form: SeriesForm,
    /// The objective that is minimised.
    pub objective: Objective,
    /// Positions in [`BaseParameters::kept`] of the parameters of the objective.
    pub parameters: Vec<usize>,
    /// Scale of each joint's rows, `[n]`: 1, or the reciprocal of its torque noise.
    pub row_scales: Vec<f64>,
    /// Reference values of the standard deviations, for each of `parameters`; used by [`Objective::StandardDeviation`].
    pub scales: Vec<f64>,
    /// Prior information about all base parameters, weighted for the instants of the search: it is added to the product
    /// of their rows. `parameters` are all of them then.
    pub known: Option<Information>,
    /// Limits of the motion, `[n]`.
    pub limits: Vec<MotionLimits>,
    /// Limits of the torque, if the model is known.
    pub torque: Option<TorqueLimits>,
    /// Distances to keep, if links have a shape.
    pub clearance: Option<ClearanceLimit>,
    /// Share of each velocity in `limits` that the joint must reach at least; 0 for none.
    pub reached_speed: f64,
}

/// Kinds of waves in a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SeriesForm {
    /// Sines and cosines [4.19].
    #[default]
    Fourier,
    /// Sines of the position alone [4.1], about a centre: `b = 0` in [4.19]. Starting at rest requires `sum a_l = 0` of
    /// [4.20], that is `sum k a_k = 0` in the amplitudes of [4.1].
    HarmonicSine,
}

impl SeriesForm {
    /// Number of variables for the series of one joint.
    fn numbers(self, harmonics: usize) -> usize {
        match self {
            Self::Fourier => 2 * harmonics - 1,
            Self::HarmonicSine => harmonics,
        }
    }
}

/// Strictness of a search about condition numbers and limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Strictness {
    /// Power of the smooth condition number: see [`Objective::of_product`].
    pub power: f64,
    /// Weight of the mean square of the excess over limits, relative to them.
    pub penalty: f64,
}

/// The search problem of one arm.
#[derive(Debug, Clone)]
pub struct SearchProblem<'a> {
    robot: &'a Robot,
    settings: SearchSettings,
    basis: Basis,
    objective: ObservationColumns<'a>,
    /// All base parameters, if torques are limited.
    torque: Option<ObservationColumns<'a>>,
    weights: Vec<f64>,
}

impl<'a> SearchProblem<'a> {
    /// The problem of `robot` with its base parameters.
    ///
    /// # Errors
    /// [`NumericsError::Unsupported`] for fewer than two harmonics, limits or scales of another number of joints.
    pub fn new(
        robot: &'a Robot,
        base: &BaseParameters,
        settings: SearchSettings,
    ) -> Result<Self, NumericsError> {
        let n = robot.joint_count();
        if settings.harmonics < 2 {
            return Err(NumericsError::Unsupported(
                "a series with fewer than two harmonics that starts at rest",
            ));
        }
        if settings.limits.len() != n || settings.row_scales.len() != n {
            return Err(NumericsError::Unsupported("limits of another number of joints than the robot has"));
        }
        let all: Vec<usize> = (0..base.kept.len()).collect();
        Ok(Self {
            robot,
            basis: Basis::new(
                1.0 / settings.period,
                settings.harmonics,
                INSTANTS_PER_HARMONIC * settings.harmonics,
            ),
            objective: ObservationColumns::new(robot, base, &settings.parameters),
            torque: settings.torque.as_ref().map(|_| ObservationColumns::new(robot, base, &all)),
            weights: settings.row_scales.iter().map(|scale| scale * scale).collect(),
            settings,
        })
    }

    /// Number of variables for a series.
    pub fn dimension(&self) -> usize {
        self.per_joint() * self.robot.joint_count()
    }

    fn per_joint(&self) -> usize {
        self.settings.form.numbers(self.settings.harmonics)
    }

    /// The arm.
    pub fn robot(&self) -> &'a Robot {
        self.robot
    }

    /// Settings of the search.
    pub fn settings(&self) -> &SearchSettings {
        &self.settings
    }

    /// The series of the variables `x`: joint by joint the velocity's cosine amplitudes 1 to `N-1`, its sine amplitudes
    /// 1 to `N-1` unless the form has none, in units of the largest velocity, and the centre from -1 to 1 over the
    /// range.
    ///
    /// # Panics
    /// If there are fewer variables than [`SearchProblem::dimension`].
    pub fn series(&self, x: &[f64]) -> FourierExcitation {
        let harmonics = self.settings.harmonics;
        let free = harmonics - 1;
        let mut series = FourierExcitation {
            base_frequency: 1.0 / self.settings.period,
            a: Vec::new(),
            b: Vec::new(),
            centre: Vec::new(),
        };
        for (own, limits) in x.chunks_exact(self.per_joint()).zip(&self.settings.limits) {
            let scaled = |of: &[f64]| of.iter().map(|x| x * limits.velocity).collect::<Vec<f64>>();
            let mut a = scaled(&own[..free]);
            a.push(-a.iter().sum::<f64>());
            let b = match self.settings.form {
                SeriesForm::HarmonicSine => vec![0.0; harmonics],
                SeriesForm::Fourier => {
                    let mut b = scaled(&own[free..2 * free]);
                    let weighted: f64 = (1..).zip(&b).map(|(l, b)| f64::from(l) * b).sum();
                    b.push(-weighted / harmonics as f64);
                    b
                }
            };
            series.a.push(a);
            series.b.push(b);
            series.centre.push(limits.middle() + own[own.len() - 1] * limits.half_range());
        }
        series
    }

    /// Cost of the series of `x`, and its gradient `[dimension]`: the logarithm of the objective plus the penalties of
    /// exceeded limits.
    ///
    /// # Errors
    /// [`NumericsError::NotFinite`] if the motion does not identify every chosen parameter.
    pub fn cost(&self, x: &[f64], strictness: Strictness) -> Result<(f64, Vec<f64>), NumericsError> {
        let series = self.series(x);
        let groups = self.basis.groups();
        let mut regressors = RegressorLanes::new(self.robot);
        let states: Vec<LaneStates> = (0..groups).map(|group| self.basis.states(&series, group)).collect();
        let rows = self.present_rows(&self.objective, &states, &mut regressors);
        let product = self.product(&rows);
        let Valued { logarithm, slope } =
            self.settings.objective.of_product(product.as_ref(), strictness.power, &self.settings.scales)?;

        let mut slopes: Vec<MotionSlope> = (0..groups)
            .map(|group| {
                let of_rows = self.objective.product_slope(&rows[group], slope.as_ref(), &self.weights);
                self.objective.motion_slope(&states[group], &of_rows, &mut regressors)
            })
            .collect();
        for (group, slope) in slopes.iter_mut().enumerate() {
            // if the last group repeats instants of its start, each counts once
            let present = self.basis.present(group);
            for j in 0..self.robot.joint_count() {
                slope.q[j] = slope.q[j] * present;
                slope.qd[j] = slope.qd[j] * present;
                slope.qdd[j] = slope.qdd[j] * present;
            }
        }
        let mut cost = logarithm;
        cost += self.exceeding(&states, strictness.penalty, &mut slopes);
        cost += self.too_slow(&states, strictness.penalty, &mut slopes);
        cost += self.torque_exceeding(&states, strictness.penalty, &mut regressors, &mut slopes);
        cost += self.too_near(&states, strictness.penalty, &mut slopes);
        let mut slope = self.slope_of_numbers(&slopes);
        cost += self.jerk_exceeding(&series, strictness.penalty, &mut slope);
        Ok((cost, slope))
    }

    /// Logarithm of the true objective of a series, plus the penalties of limits that a smaller motion does not fulfil.
    ///
    /// # Errors
    /// Those of [`SearchProblem::cost`].
    pub fn value(&self, series: &FourierExcitation) -> Result<f64, NumericsError> {
        let mut regressors = RegressorLanes::new(self.robot);
        let states: Vec<LaneStates> =
            (0..self.basis.groups()).map(|group| self.basis.states(series, group)).collect();
        let rows = self.present_rows(&self.objective, &states, &mut regressors);
        let product = self.product(&rows);
        let valued = self.settings.objective.of_product(product.as_ref(), SHARP, &self.settings.scales)?;
        let mut slopes = vec![MotionSlope::ZERO; states.len()];
        Ok(valued.logarithm
            + self.too_slow(&states, MISSED, &mut slopes)
            + self.torque_exceeding(&states, MISSED, &mut regressors, &mut slopes)
            + self.nearer_than_allowed(series))
    }

    /// Number of instants per period.
    pub fn instants(&self) -> usize {
        self.basis.instants()
    }

    /// The product of the rows, plus the prior information.
    fn product(&self, rows: &[JointRows]) -> Mat<f64> {
        let product = self.objective.product(rows, &self.weights);
        match &self.settings.known {
            Some(known) => product + known.matrix(),
            None => product,
        }
    }

    /// Rows of all groups; those beyond the last instant are zero.
    fn present_rows(
        &self,
        observation: &ObservationColumns<'_>,
        states: &[LaneStates],
        regressors: &mut RegressorLanes,
    ) -> Vec<JointRows> {
        let groups = states.iter().enumerate();
        groups
            .map(|(group, states)| {
                let mut rows = observation.rows(states, regressors);
                if group + 1 == self.basis.groups() {
                    let present = self.basis.present(group);
                    rows.iter_mut().flatten().for_each(|entry| *entry = *entry * present);
                }
                rows
            })
            .collect()
    }

    /// Converts derivatives along the motion to derivatives along the variables of the search.
    fn slope_of_numbers(&self, slopes: &[MotionSlope]) -> Vec<f64> {
        let mut of_numbers = Vec::with_capacity(self.dimension());
        for j in 0..self.robot.joint_count() {
            let mut by = SeriesSlope::new(self.settings.harmonics);
            for (group, slope) in slopes.iter().enumerate() {
                let (q, qd, qdd) = (slope.q[j], slope.qd[j], slope.qdd[j]);
                by.centre += q;
                for (l, &[sine, cosine]) in self.basis.waves(group).iter().enumerate() {
                    let w = self.basis.angular_frequency(l + 1);
                    by.a[l] += q * sine * (1.0 / w) + qd * cosine - qdd * sine * w;
                    by.b[l] += qd * sine + qdd * cosine * w - q * cosine * (1.0 / w);
                }
            }
            of_numbers.extend(by.along_numbers(&self.settings.limits[j], self.settings.form));
        }
        of_numbers
    }

    /// Makes the series smaller, joint by joint, and shifts it until it keeps every limit of the motion, also between
    /// instants.
    pub fn within_limits(&self, mut series: FourierExcitation) -> FourierExcitation {
        for (j, limits) in self.settings.limits.iter().enumerate() {
            let found = extremes(&series, j);
            let [low, high] = [found.low.value, found.high.value].map(|value| value - series.centre[j]);
            let margin = between_instants(self.settings.harmonics, found.instants);
            let scale = (2.0 * limits.half_range() / (margin * (high - low)))
                .min(limits.velocity / (margin * found.speed.value.abs()))
                .min(limits.acceleration / (margin * found.acceleration.value.abs()))
                .min(limits.jerk.map_or(f64::INFINITY, |jerk| jerk / (margin * found.jerk.value.abs())));
            let scale = if scale < 1.0 { scale * (1.0 - CLEARANCE) } else { 1.0 };
            series.a[j].iter_mut().chain(&mut series.b[j]).for_each(|c| *c *= scale);
            let (low, high) = (scale * low, scale * high);
            // the bound widens the motion about the middle of the range
            let room = limits.half_range() * (1.0 - CLEARANCE) / margin;
            let (lowest, highest) = (limits.middle() - room - low, limits.middle() + room - high);
            series.centre[j] = if lowest <= highest {
                series.centre[j].clamp(lowest, highest)
            } else {
                0.5 * (lowest + highest)
            };
        }
        series
    }
}

/// Derivatives along the variables of one joint's series, lanes to be summed.
struct SeriesSlope {
    a: Vec<Lanes>,
    b: Vec<Lanes>,
    centre: Lanes,
}

impl SeriesSlope {
    fn new(harmonics: usize) -> Self {
        Self { a: vec![Lanes::ZERO; harmonics], b: vec![Lanes::ZERO; harmonics], centre: Lanes::ZERO }
    }

    /// Derivatives along the variables of the search: the last amplitudes follow from the others.
    fn along_numbers(&self, limits: &MotionLimits, form: SeriesForm) -> Vec<f64> {
        let free = self.a.len() - 1;
        let (last_a, last_b) = (self.a[free].sum(), self.b[free].sum());
        let part = |l: u32| f64::from(l) / self.a.len() as f64;
        let by_a = self.a[..free].iter().map(|by| limits.velocity * (by.sum() - last_a));
        let sines = if form == SeriesForm::Fourier { &self.b[..free] } else { &[] };
        let by_b = (1..).zip(sines).map(|(l, by)| limits.velocity * (by.sum() - part(l) * last_b));
        by_a.chain(by_b).chain([limits.half_range() * self.centre.sum()]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clearance::Clearance;
    use crate::limits::{Shares, broken_by_series};
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_method::pooled::nominal_prior::nominal_base;
    use armwatch_model::robot::{ArmShape, Capsule, Cell, Obstacle, ObstacleForm};
    use armwatch_testing::er3a_of;
    use nalgebra::{DMatrix, Vector3};

    /// Step of difference quotients, whose error is its square, for sums of some thousand terms.
    const DIFFERENCES: f64 = 1e-5;

    fn settings(robot: &Robot, base: &BaseParameters) -> SearchSettings {
        let shares = Shares { position: 0.9, velocity: 0.8, acceleration: 0.7 };
        SearchSettings {
            period: 5.0,
            harmonics: 3,
            form: SeriesForm::Fourier,
            objective: Objective::Condition,
            parameters: (0..base.kept.len()).collect(),
            row_scales: vec![1.0; robot.joint_count()],
            scales: vec![1.0; base.kept.len()],
            known: None,
            limits: robot.joints.iter().map(|joint| MotionLimits::of(joint, &shares)).collect(),
            torque: None,
            clearance: None,
            reached_speed: 0.0,
        }
    }

    /// A wall near the second link.
    fn wall(robot: &Robot) -> ClearanceLimit {
        let ends = [Vector3::zeros(), Vector3::new(0.3, 0.0, 0.0)];
        let shape = ArmShape { capsules: vec![Capsule { link: 2, ends, radius: 0.05 }], pairs: Vec::new() };
        let form = ObstacleForm::Plane { point: Vector3::new(0.0, 0.25, 0.0), normal: -Vector3::y() };
        let cell = Cell { obstacles: vec![Obstacle { name: "wall".into(), form }] };
        let clearance = Clearance::new(&Robot { shape, ..robot.clone() }, &cell);
        ClearanceLimit { clearance, distance: 0.05 }
    }

    fn numbers(count: usize, size: f64) -> Vec<f64> {
        (0..count).map(|k| size * (1.0 + 2.3 * k as f64).sin()).collect()
    }

    #[test]
    fn slopes_are_those_of_differences_whatever_is_exceeded() {
        let robot = er3a_of(2);
        let base = base_parameters(&robot).expect("base parameters");
        let nominal: Option<Vec<f64>> = nominal_base(&robot, &base).into_iter().collect();
        let torque = TorqueLimits {
            parameters: nominal.expect("nominal parameters"),
            duty: DMatrix::from_row_slice(2, 2, &[1.0, -0.4, 0.0, 1.0]),
            mean_square_root: vec![Some(10.0), Some(12.0)],
            peak: vec![None, Some(20.0)],
        };
        let strictness = Strictness { power: 5.0, penalty: 3.0 };
        // the smaller motion is too slow, the larger ones beyond every limit
        let (fourier, sines) = (SeriesForm::Fourier, SeriesForm::HarmonicSine);
        for (size, limited, reached, form) in
            [(0.1, false, 0.7, fourier), (1.2, true, 0.0, fourier), (1.2, true, 0.0, sines)]
        {
            for objective in [Objective::Condition, Objective::ScaledCondition, Objective::StandardDeviation]
            {
                let mut settings = settings(&robot, &base);
                settings.objective = objective;
                settings.form = form;
                settings.torque = limited.then(|| torque.clone());
                settings.limits[0].jerk = limited.then_some(20.0);
                settings.clearance = limited.then(|| wall(&robot));
                settings.reached_speed = reached;
                let problem = SearchProblem::new(&robot, &base, settings).expect("a problem");
                let x = numbers(problem.dimension(), size);
                let (_, slope) = problem.cost(&x, strictness).expect("a cost");
                for k in [0, 3, 4, problem.dimension() - 1] {
                    let at = |step: f64| {
                        let mut moved = x.clone();
                        moved[k] += step;
                        problem.cost(&moved, strictness).expect("a cost").0
                    };
                    let measured = (at(1e-5) - at(-1e-5)) / 2e-5;
                    assert!(
                        (measured - slope[k]).abs() < DIFFERENCES * slope[k].abs().max(1.0),
                        "{objective:?} {size} {k}: {measured} {}",
                        slope[k]
                    );
                }
            }
        }
    }

    #[test]
    fn any_numbers_stand_for_a_series_from_rest_to_rest_that_can_be_brought_inside_the_limits() {
        let mut robot = er3a_of(3);
        robot.joints[1].limits.jerk = Some(15.0);
        let base = base_parameters(&robot).expect("base parameters");
        for (size, form) in [0.01, 0.3, 5.0]
            .into_iter()
            .flat_map(|size| [SeriesForm::Fourier, SeriesForm::HarmonicSine].map(|form| (size, form)))
        {
            let settings = SearchSettings { form, ..settings(&robot, &base) };
            let problem = SearchProblem::new(&robot, &base, settings).expect("a problem");
            let wild = problem.series(&numbers(problem.dimension(), size));
            let tame = problem.within_limits(wild.clone());
            for series in [&wild, &tame] {
                for state in super::super::series::state_at(series, 0.0) {
                    assert!(state[1].abs() < 1e-12 * size.max(1.0), "{state:?}");
                    assert!(state[2].abs() < 1e-9 * size.max(1.0), "{state:?}");
                }
            }
            // sines of these variables stay inside longer
            let beyond = if form == SeriesForm::Fourier { 0.1 } else { 1.0 };
            assert_eq!(!broken_by_series(&robot, &wild).is_empty(), size > beyond);
            if form == SeriesForm::HarmonicSine {
                assert!(tame.b.iter().flatten().all(|b| *b == 0.0), "{tame:?}");
            }
            assert!(broken_by_series(&robot, &tame).is_empty(), "{size}");
            // the shares of the search, at 1 kHz
            for (j, limits) in problem.settings().limits.iter().enumerate() {
                for k in 0..5000 {
                    let [q, qd, qdd] = super::super::series::state_at(&tame, f64::from(k) * 1e-3)[j];
                    assert!((limits.position_min..=limits.position_max).contains(&q));
                    assert!(qd.abs() <= limits.velocity && qdd.abs() <= limits.acceleration);
                    let jerk = super::super::series::jerk_at(&tame, j, f64::from(k) * 1e-3).abs();
                    assert!(limits.jerk.is_none_or(|limit| jerk <= limit));
                }
            }
            // a series inside the limits is unchanged
            assert_eq!(problem.within_limits(tame.clone()), tame, "{size}");
        }
    }

    #[test]
    fn too_few_harmonics_and_limits_of_another_arm_are_refused() {
        let robot = er3a_of(2);
        let base = base_parameters(&robot).expect("base parameters");
        let mut short = settings(&robot, &base);
        short.harmonics = 1;
        assert!(SearchProblem::new(&robot, &base, short).is_err());
        let mut other = settings(&robot, &base);
        other.limits.pop();
        assert!(SearchProblem::new(&robot, &base, other).is_err());
    }
}
