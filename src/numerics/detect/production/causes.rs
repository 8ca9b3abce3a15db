//! Which cause explains what a log of ordinary work leaves of the torque that its test leads to expect.
//!
//! Nothing is learnt from other logs: a log is compared with the error that the test itself has. The deviation of joint
//! `j` is taken for
//!
//! ```text
//! (c + c_j) coulomb_j + (v + v_j) viscous_j + what the cause adds + noise
//! ```
//!
//! where `coulomb_j` and `viscous_j` are the parts of the joint's friction torque by the test's parameters. What all joints
//! have in common, `c` and `v`, is how warm the arm was; `c_j` and `v_j` are how its joints differ in that. All are random
//! effects with stated standard deviations. The noise of a joint is what the test leaves of it, or what no cause explains
//! of the log if that is more, and counts as [`EFFECTIVE_ROWS`] independent values, however long the log is: a program
//! repeats itself, and with it what the model does not know.
//!
//! A cause adds torque along its directions ([`WorkDirection`]) with sizes of its own. A load may come with each of the
//! others, since work carries tools. The cost of a hypothesis is the least of the weighted squares that it leaves and of
//! its random effects, in units of chi², plus [`PARAMETER_PRICE`] for each of its parameters and [`CHANNEL_PRICE`] for a torque
//! signal. A cause is clear if the cost
//! without it is higher by twice the logarithm that the rate of false alarms asks for.

use nalgebra::{DMatrix, DVector};

use crate::analysis::work_evidence::{DEVIATION, JointEvidence, WorkDirection};
use crate::anomaly::{Alternative, ProductionSummary};
use crate::numerics::detect::rate::budget::Budget;
use crate::numerics::detect::verdict::{DetectSettings, MOST_ODDS, Why};
use crate::robot::JointIndex;

/// Independent values of a joint that a log counts as.
const EFFECTIVE_ROWS: f64 = 60.0;
/// Part of the torque that a test leaves unexplained where that is not known, and the least that is believed.
const USUAL_REST: f64 = 0.02;
const LEAST_REST: f64 = 0.005;

/// Standard deviations of what warmth does to friction, as fractions of the test's: of all joints in common, and of a
/// joint beside the others. Viscous friction falls with warmth, Coulomb friction hardly.
const COMMON_COULOMB: f64 = 0.2;
const COMMON_VISCOUS: f64 = 0.5;
const OWN_COULOMB: f64 = 0.05;
const OWN_VISCOUS: f64 = 0.10;

/// Prior standard deviations of the sizes of causes: friction, as much again; a gain; an offset, as a fraction of the
/// joint's torque; a load's mass, kg, and first moments, kg m.
const FRICTION_SIZE: f64 = 1.0;
const GAIN_SIZE: f64 = 0.3;
const OFFSET_SIZE: f64 = 1.0;
const MASS_SIZE: f64 = 20.0;
const MOMENT_SIZE: f64 = 5.0;

/// Price of one parameter, in units of chi².
const PARAMETER_PRICE: f64 = 4.0;
/// Further price of a channel that reads wrong: friction of a joint that carries no weight is most of its torque, and wears more
/// often than a signal fails.
const CHANNEL_PRICE: f64 = 20.0;
/// Price of a cause that is not known: it explains anything.
const UNKNOWN_PRICE: f64 = 150.0;
/// Log-likelihood of a cause beyond what the rate of false alarms asks for: random effects and noise are stated.
const MARGIN: f64 = 5.0;

/// Least mass that is called a load, kg, and how many of its standard errors.
const LEAST_MASS: f64 = 0.2;
const MASS_ERRORS: f64 = 5.0;
/// Standard error of a mass, kg, from which on the log says nothing of it: no joint carries the last link's weight.
const UNSEEN_MASS: f64 = 2.0;
/// Least gain, and least friction beyond the other joints', that are named.
pub(super) const LEAST_GAIN: f64 = 0.03;
pub(super) const LEAST_WEAR: f64 = 0.3;

/// What beside a load explains a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum WorkCause {
    /// Nothing.
    None,
    /// Friction of one joint, as a fraction of the test's beyond the other joints'.
    Friction(JointIndex, f64),
    /// A torque signal that reads in proportion too much.
    Gain(JointIndex, f64),
    /// A torque signal that reads too much by a constant, Nm (N).
    Offset(JointIndex, f64),
    /// Something else.
    Unknown,
}

/// A body at the last link beyond that of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WorkLoad {
    /// Mass, kg.
    pub(super) mass: f64,
    /// Its standard error, kg.
    pub(super) std_error: f64,
    /// Centre in the frame of the last link, m; means something where the motion shows the mass.
    pub(super) centre: [f64; 3],
}

impl WorkLoad {
    /// Whether the motion shows the mass.
    pub(super) fn has_seen_mass(&self) -> bool {
        self.std_error < UNSEEN_MASS
    }

    fn is_plain(&self) -> bool {
        !self.has_seen_mass() || self.mass.abs() >= LEAST_MASS.max(MASS_ERRORS * self.std_error)
    }
}

/// What a joint of a log comes to under the likeliest causes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JointRest {
    pub(super) joint: JointIndex,
    /// Friction beyond the test's, as a multiple of it.
    pub(super) friction: f64,
    /// Part of the measured torque that is left, root mean square, with and without what friction explains.
    pub(super) with_friction: f64,
    pub(super) left: f64,
}

/// The causes of one log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LogCauses {
    /// Least advantage of a clear cause over none, in units of chi².
    least: f64,
    /// All hypotheses, the likeliest first.
    fits: Vec<Fit>,
    /// What the joints come to under the first of them.
    pub(super) joints: Vec<JointRest>,
}

#[derive(Debug, Clone, PartialEq)]
struct Fit {
    load: Option<WorkLoad>,
    cause: WorkCause,
    cost: f64,
}

impl LogCauses {
    /// The load, where it is clear.
    pub(super) fn load(&self) -> Option<WorkLoad> {
        let load = self.fits.first()?.load.filter(WorkLoad::is_plain)?;
        (self.advantage_of_load() >= self.least).then_some(load)
    }

    /// What beside a load is clear.
    pub(super) fn cause(&self) -> WorkCause {
        let Some(Fit { cause, .. }) = self.fits.first() else { return WorkCause::None };
        let is_large = match cause {
            WorkCause::Friction(_, excess) => *excess >= LEAST_WEAR,
            WorkCause::Gain(_, part) => part.abs() >= LEAST_GAIN,
            _ => true,
        };
        if is_large && self.advantage() >= self.least { *cause } else { WorkCause::None }
    }

    /// How much less than without the cause beside a load is left, in units of chi².
    pub(super) fn advantage(&self) -> f64 {
        self.over(|fit| fit.cause == WorkCause::None)
    }

    fn advantage_of_load(&self) -> f64 {
        self.over(|fit| fit.load.is_none() && fit.cause != WorkCause::Unknown)
    }

    fn over(&self, is_without: impl Fn(&Fit) -> bool) -> f64 {
        match (self.fits.first(), self.fits.iter().find(|fit| is_without(fit))) {
            (Some(best), Some(without)) => without.cost - best.cost,
            _ => 0.0,
        }
    }

    /// Odds of the load against none, or of the cause beside it against the others; with those that were rejected.
    pub(super) fn why(&self, of_load: bool) -> Why {
        let least = self.fits.first().map_or(0.0, |fit| fit.cost);
        let mut weights: Vec<(String, f64)> = Vec::new();
        for fit in &self.fits {
            let words = if of_load { fit.load_words() } else { fit.cause.words() };
            let weight = (-0.5 * (fit.cost - least)).exp();
            match weights.iter_mut().find(|(known, _)| *known == words) {
                Some((_, all)) => *all += weight,
                None => weights.push((words, weight)),
            }
        }
        let all: f64 = weights.iter().map(|(_, weight)| weight).sum();
        let odds = |weight: f64| (weight / (all - weight).max(f64::MIN_POSITIVE)).min(MOST_ODDS);
        let own = weights.first().map(|(_, weight)| odds(*weight));
        let rejected = weights.into_iter().skip(1).take(3);
        let alternatives =
            rejected.map(|(cause, weight)| Alternative { cause, odds: odds(weight) }).collect();
        Why { onset: None, odds: own, alternatives }
    }
}

impl Fit {
    /// What kind of explanation it is of a load: a wear or a gain that would do without it, by name.
    fn load_words(&self) -> String {
        match &self.load {
            Some(load) if load.has_seen_mass() => "a load".into(),
            Some(_) => "a load of unknown mass".into(),
            None => self.cause.words(),
        }
    }
}

impl WorkCause {
    /// What it would be, in words that follow "rather than".
    fn words(&self) -> String {
        match self {
            Self::None => "no change beside warmth".into(),
            Self::Friction(joint, _) => format!("friction of joint {joint}"),
            Self::Gain(joint, part) => {
                format!("a gain of {:+.1} % of the torque signal of joint {joint}", 100.0 * part)
            }
            Self::Offset(joint, torque) => {
                format!("an offset of {torque:+.2} Nm of the torque signal of joint {joint}")
            }
            Self::Unknown => "a change that is not known".into(),
        }
    }
}

/// The causes of each log; `None` for logs without evidence.
pub(super) fn causes(history: &[ProductionSummary], settings: &DetectSettings) -> Vec<Option<LogCauses>> {
    let joints =
        history.iter().flat_map(|log| &log.evidence).map(|of| of.joint.index() + 1).max().unwrap_or(0);
    let starts: Vec<_> = history.iter().map(|log| log.started_at).collect();
    let alpha = Budget::new(settings.false_alarms_per_robot_year, joints, &starts).alpha();
    let least = 2.0 * (MARGIN - alpha.ln());
    history.iter().map(|log| causes_of(log, least)).collect()
}

fn causes_of(log: &ProductionSummary, least: f64) -> Option<LogCauses> {
    if log.evidence.is_empty() {
        return None;
    }
    let system = System::of(log);
    let mut found: Vec<(Fit, Option<Solution>)> = Vec::new();
    for has_load in [false, true] {
        for hypothesis in system.hypotheses() {
            let Some(solution) = system.solve(has_load, hypothesis) else { continue };
            let load = has_load.then(|| system.load(&solution));
            let cause = system.cause(hypothesis, &solution);
            found.push((Fit { load, cause, cost: solution.cost }, Some(solution)));
        }
    }
    let unknown = Fit { load: None, cause: WorkCause::Unknown, cost: system.least_left() + UNKNOWN_PRICE };
    found.push((unknown, None));
    found.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
    // a cause that is not known says nothing of the joints: the likeliest known one does
    let joints = found.iter().find_map(|(_, solution)| Some(system.rest(solution.as_ref()?)))?;
    Some(LogCauses { least, fits: found.into_iter().map(|(fit, _)| fit).collect(), joints })
}

/// What adds torque to some joints with one unknown size.
struct Column {
    /// Places of joints in the evidence, and directions.
    along: Vec<(usize, WorkDirection)>,
    /// Prior variance of the size.
    variance: f64,
    /// Whether it is friction.
    is_friction: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Hypothesis {
    None,
    Friction(usize),
    Gain(usize),
    Offset(usize),
}

struct System<'a> {
    evidence: &'a [JointEvidence],
    /// Effective rows over the variance of the noise, by joint.
    weights: Vec<f64>,
    /// Squares that no cause explains, weighted, by joint.
    left: Vec<f64>,
    /// Random effects of all hypotheses.
    warmth: Vec<Column>,
}

struct Solution {
    columns: Vec<Column>,
    sizes: DVector<f64>,
    covariance: DMatrix<f64>,
    cost: f64,
}

impl<'a> System<'a> {
    fn of(log: &'a ProductionSummary) -> Self {
        let evidence = &log.evidence[..];
        let (mut weights, mut left) = (Vec::new(), Vec::new());
        for of in evidence {
            let own = log.joints.iter().find(|joint| joint.joint == of.joint);
            let relative =
                own.and_then(|joint| joint.test_relative_rmsd).unwrap_or(USUAL_REST).max(LEAST_REST);
            let gain = WorkDirection::Gain.place();
            let rest = unexplained(of);
            let used = WorkDirection::ALL.len() as f64;
            let noise = (relative * relative * of.product(gain, gain))
                .max(rest * EFFECTIVE_ROWS / (EFFECTIVE_ROWS - used))
                .max(f64::MIN_POSITIVE);
            weights.push(EFFECTIVE_ROWS / noise);
            left.push(EFFECTIVE_ROWS * rest / noise);
        }
        let all = |direction| (0..evidence.len()).map(|place| (place, direction)).collect::<Vec<_>>();
        let column = |along: Vec<(usize, WorkDirection)>, deviation: f64| Column {
            along,
            variance: deviation * deviation,
            is_friction: true,
        };
        let mut warmth = vec![
            column(all(WorkDirection::Coulomb), COMMON_COULOMB),
            column(all(WorkDirection::Viscous), COMMON_VISCOUS),
        ];
        for place in 0..evidence.len() {
            warmth.push(column(vec![(place, WorkDirection::Coulomb)], OWN_COULOMB));
            warmth.push(column(vec![(place, WorkDirection::Viscous)], OWN_VISCOUS));
        }
        Self { evidence, weights, left, warmth }
    }

    fn hypotheses(&self) -> Vec<Hypothesis> {
        let each = |of: fn(usize) -> Hypothesis| (0..self.evidence.len()).map(of);
        std::iter::once(Hypothesis::None)
            .chain(each(Hypothesis::Friction))
            .chain(each(Hypothesis::Gain))
            .chain(each(Hypothesis::Offset))
            .collect()
    }

    fn least_left(&self) -> f64 {
        self.left.iter().sum()
    }

    /// What the hypothesis adds; `None` where the log shows nothing of it.
    fn added(&self, hypothesis: Hypothesis) -> Option<Vec<Column>> {
        let one = |place: usize, direction: WorkDirection, deviation: f64, is_friction: bool| {
            let seen = self.evidence[place].product(direction.place(), direction.place()) > 0.0;
            let variance = deviation * deviation;
            seen.then(|| Column { along: vec![(place, direction)], variance, is_friction })
        };
        match hypothesis {
            Hypothesis::None => Some(Vec::new()),
            Hypothesis::Friction(place) => {
                let parts = [WorkDirection::Coulomb, WorkDirection::Viscous];
                let parts = parts.into_iter().filter_map(|part| one(place, part, FRICTION_SIZE, true));
                Some(parts.collect()).filter(|parts: &Vec<Column>| !parts.is_empty())
            }
            Hypothesis::Gain(place) => Some(vec![one(place, WorkDirection::Gain, GAIN_SIZE, false)?]),
            Hypothesis::Offset(place) => {
                let size = OFFSET_SIZE * self.torque(place);
                Some(vec![one(place, WorkDirection::Offset, size, false)?])
            }
        }
    }

    /// Root mean square of a joint's torque by the test's parameters.
    fn torque(&self, place: usize) -> f64 {
        let gain = WorkDirection::Gain.place();
        self.evidence[place].product(gain, gain).sqrt()
    }

    fn solve(&self, has_load: bool, hypothesis: Hypothesis) -> Option<Solution> {
        let mut columns = self.added(hypothesis)?;
        if has_load {
            for of in 0..WorkDirection::LOAD {
                let direction = WorkDirection::ALL[WorkDirection::Load(0).place() + of];
                let size: f64 = if of == 0 { MASS_SIZE } else { MOMENT_SIZE };
                let along = (0..self.evidence.len()).map(|place| (place, direction)).collect();
                columns.push(Column { along, variance: size * size, is_friction: false });
            }
        }
        let own = columns.len();
        let shows = |column: &Column| {
            column.along.iter().any(|(place, of)| self.evidence[*place].product(of.place(), of.place()) > 0.0)
        };
        if has_load && !columns[own - WorkDirection::LOAD..].iter().any(shows) {
            return None;
        }
        columns.extend(self.warmth.iter().map(|of| Column { along: of.along.clone(), ..*of }));
        let mut normal =
            DMatrix::from_fn(columns.len(), columns.len(), |a, b| self.with(&columns[a], &columns[b]));
        for (place, column) in columns.iter().enumerate() {
            normal[(place, place)] += column.variance.recip();
        }
        let right = DVector::from_fn(columns.len(), |place, _| self.with_deviation(&columns[place]));
        let covariance = normal.cholesky()?.inverse();
        let sizes = &covariance * &right;
        let all: f64 =
            self.evidence.iter().zip(&self.weights).map(|(of, w)| w * of.product(DEVIATION, DEVIATION)).sum();
        let channel = match hypothesis {
            Hypothesis::Gain(_) | Hypothesis::Offset(_) => CHANNEL_PRICE,
            Hypothesis::None | Hypothesis::Friction(_) => 0.0,
        };
        let cost = all - right.dot(&sizes) + PARAMETER_PRICE * own as f64 + channel;
        cost.is_finite().then_some(Solution { columns, sizes, covariance, cost })
    }

    fn with(&self, a: &Column, b: &Column) -> f64 {
        let mut sum = 0.0;
        for (place, of_a) in &a.along {
            for (_, of_b) in b.along.iter().filter(|(other, _)| other == place) {
                sum += self.weights[*place] * self.evidence[*place].product(of_a.place(), of_b.place());
            }
        }
        sum
    }

    fn with_deviation(&self, column: &Column) -> f64 {
        let part = |(place, of): &(usize, WorkDirection)| {
            self.weights[*place] * self.evidence[*place].product(of.place(), DEVIATION)
        };
        column.along.iter().map(part).sum()
    }

    fn cause(&self, hypothesis: Hypothesis, solution: &Solution) -> WorkCause {
        match hypothesis {
            Hypothesis::None => WorkCause::None,
            Hypothesis::Friction(place) => {
                let added = solution
                    .sizes
                    .iter()
                    .zip(&solution.columns)
                    .filter(|(_, of)| of.is_friction && of.along.len() == 1 && of.along[0].0 == place);
                let own: Vec<(WorkDirection, f64)> = added.map(|(size, of)| (of.along[0].1, *size)).collect();
                WorkCause::Friction(self.evidence[place].joint, self.friction(place, &own))
            }
            Hypothesis::Gain(place) => WorkCause::Gain(self.evidence[place].joint, solution.sizes[0]),
            Hypothesis::Offset(place) => WorkCause::Offset(self.evidence[place].joint, solution.sizes[0]),
        }
    }

    /// Parts of friction as one multiple of the joint's friction torque.
    fn friction(&self, place: usize, parts: &[(WorkDirection, f64)]) -> f64 {
        let of = &self.evidence[place];
        let both = [WorkDirection::Coulomb.place(), WorkDirection::Viscous.place()];
        let with_all = |part: usize| both.iter().map(|other| of.product(part, *other)).sum::<f64>();
        let square: f64 = both.iter().map(|part| with_all(*part)).sum();
        let sum: f64 = parts.iter().map(|(part, size)| size * with_all(part.place())).sum();
        if square > 0.0 { sum / square } else { 0.0 }
    }

    fn load(&self, solution: &Solution) -> WorkLoad {
        let own = |column: &Column| matches!(column.along[0].1, WorkDirection::Load(0));
        let first = solution.columns.iter().position(own).unwrap_or(0);
        let mass = solution.sizes[first];
        let centre = [1, 2, 3].map(|k| solution.sizes[first + k] / mass);
        WorkLoad { mass, std_error: solution.covariance[(first, first)].sqrt(), centre }
    }

    fn rest(&self, solution: &Solution) -> Vec<JointRest> {
        let of_joint = |(place, of): (usize, &JointEvidence)| {
            let mut all = [0.0; DEVIATION];
            for (size, column) in solution.sizes.iter().zip(&solution.columns) {
                for (_, direction) in column.along.iter().filter(|(other, _)| *other == place) {
                    all[direction.place()] += size;
                }
            }
            let mut but_friction = all;
            let parts = [WorkDirection::Coulomb, WorkDirection::Viscous];
            parts.iter().for_each(|part| but_friction[part.place()] = 0.0);
            let gain = WorkDirection::Gain.place();
            let measured =
                of.product(gain, gain) + 2.0 * of.product(gain, DEVIATION) + of.product(DEVIATION, DEVIATION);
            let relative =
                |sizes: &[f64; DEVIATION]| (left_by(of, sizes) / measured.max(f64::MIN_POSITIVE)).sqrt();
            JointRest {
                joint: of.joint,
                friction: self.friction(place, &parts.map(|part| (part, all[part.place()]))),
                with_friction: relative(&but_friction),
                left: relative(&all),
            }
        };
        self.evidence.iter().enumerate().map(of_joint).collect()
    }
}

/// Mean square of the deviation that is left by directions of these sizes.
fn left_by(of: &JointEvidence, sizes: &[f64; DEVIATION]) -> f64 {
    let mut sum = of.product(DEVIATION, DEVIATION);
    for (a, size) in sizes.iter().enumerate() {
        sum -= 2.0 * size * of.product(a, DEVIATION);
        sum += sizes.iter().enumerate().map(|(b, other)| size * other * of.product(a, b)).sum::<f64>();
    }
    sum.max(0.0)
}

/// Mean square of a joint's deviation that no direction explains, each with any size.
fn unexplained(of: &JointEvidence) -> f64 {
    let scale: Vec<f64> = (0..DEVIATION).map(|place| of.product(place, place).sqrt()).collect();
    let seen: Vec<usize> = (0..DEVIATION).filter(|place| scale[*place] > 0.0).collect();
    let normal = DMatrix::from_fn(seen.len(), seen.len(), |a, b| {
        let alike = of.product(seen[a], seen[b]) / (scale[seen[a]] * scale[seen[b]]);
        if a == b { alike + RIDGE } else { alike }
    });
    let right =
        DVector::from_fn(seen.len(), |place, _| of.product(seen[place], DEVIATION) / scale[seen[place]]);
    let explained = normal.cholesky().map_or(0.0, |normal| right.dot(&normal.solve(&right)));
    (of.product(DEVIATION, DEVIATION) - explained).max(0.0)
}

/// Directions that are alike to one in a million count as one.
const RIDGE: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use jiff::Timestamp;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::analysis::work_evidence::PRODUCTS;

    const JOINTS: usize = 6;

    /// What happens to a joint's torque, by size of each direction.
    type Effect<'a> = &'a dyn Fn(usize) -> [f64; DEVIATION];

    /// A log of drawn torques. The joints' torques are some ten Nm, of which the test leaves 2 % unexplained.
    fn log(seed: u64, effect: Effect<'_>) -> ProductionSummary {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = move || rng.sample::<f64, _>(StandardNormal);
        let warmth = (0.1 * draw(), 0.3 * draw());
        let joint = |j: usize| {
            let mut products = [0.0; PRODUCTS];
            let sizes = effect(j);
            let own = (warmth.0 + 0.03 * draw(), warmth.1 + 0.08 * draw());
            for _ in 0..2000 {
                let (sign, speed) = (draw().signum(), draw());
                // outer joints carry less of a load
                let reach = 1.0 - 0.15 * j as f64;
                let load = [3.0 * draw() * reach, 9.0 * draw(), 9.0 * draw(), 9.0 * draw()];
                let mut along = [0.0; DEVIATION + 1];
                along[0] = 2.0 * sign;
                along[1] = 3.0 * speed;
                along[2] = 8.0 * draw() + along[0] + along[1];
                along[3] = 1.0;
                along[4..8].copy_from_slice(&load);
                let effect: f64 = along.iter().zip(sizes).map(|(torque, size)| torque * size).sum();
                along[DEVIATION] = effect + own.0 * along[0] + own.1 * along[1] + 0.2 * draw();
                for (a, of_a) in along.iter().enumerate() {
                    for (b, of_b) in along.iter().enumerate().skip(a) {
                        products[JointEvidence::index(a, b)] += of_a * of_b / 2000.0;
                    }
                }
            }
            JointEvidence { joint: JointIndex::new(j), windows: 30, samples: 60_000, products }
        };
        let evidence = (0..JOINTS).map(joint).collect();
        ProductionSummary {
            run_id: 1,
            started_at: Timestamp::UNIX_EPOCH,
            reference_run_id: 2,
            joints: Vec::new(),
            evidence,
        }
    }

    fn found(seed: u64, effect: Effect<'_>) -> LogCauses {
        let found = causes(&[log(seed, effect)], &DetectSettings::default()).remove(0);
        found.expect("evidence")
    }

    fn of(direction: WorkDirection, size: f64) -> [f64; DEVIATION] {
        let mut sizes = [0.0; DEVIATION];
        sizes[direction.place()] = size;
        sizes
    }

    #[test]
    fn warmth_of_the_arm_is_no_cause() {
        for seed in 0..20 {
            let found = found(seed, &|_| [0.0; DEVIATION]);
            assert_eq!((found.load(), found.cause()), (None, WorkCause::None), "{seed}: {found:?}");
        }
    }

    #[test]
    fn each_cause_is_named_with_its_joint_and_size() {
        for seed in 20..26 {
            let at = |joint: usize| JointIndex::new(joint);
            let joint = usize::try_from(seed).expect("small") % JOINTS;
            let one = |direction: WorkDirection, size: f64| {
                found(seed, &|j| if j == joint { of(direction, size) } else { [0.0; DEVIATION] })
            };
            let worn = found(seed, &|j| match j == joint {
                true => [0.6, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                false => [0.0; DEVIATION],
            });
            assert!(
                matches!(worn.cause(), WorkCause::Friction(of, size) if of == at(joint) && (size - 0.6).abs() < 0.15),
                "{worn:?}"
            );
            let gain = one(WorkDirection::Gain, 0.08);
            assert!(
                matches!(gain.cause(), WorkCause::Gain(of, size) if of == at(joint) && (size - 0.08).abs() < 0.02),
                "{gain:?}"
            );
            let offset = one(WorkDirection::Offset, -1.0);
            assert!(
                matches!(offset.cause(), WorkCause::Offset(of, size) if of == at(joint) && (size + 1.0).abs() < 0.1),
                "{offset:?}"
            );
            for found in [worn, gain, offset] {
                let why = found.why(false);
                assert!(why.odds.is_some_and(|odds| odds > 100.0) && why.alternatives.len() == 3, "{why:?}");
                assert_eq!(found.load(), None);
            }
        }
    }

    #[test]
    fn a_load_is_one_cause_of_the_arm_and_hides_no_other() {
        for seed in 30..36 {
            let load = |also: Option<usize>| {
                found(seed, &|j| {
                    let mut sizes = [0.0, 0.0, 0.0, 0.0, 0.8, 0.01, 0.0, 0.05];
                    sizes[WorkDirection::Gain.place()] = if also == Some(j) { 0.08 } else { 0.0 };
                    sizes
                })
            };
            let alone = load(None);
            let mass = alone.load().expect("a load").mass;
            assert!((mass / 0.8 - 1.0).abs() < 0.15 && alone.cause() == WorkCause::None, "{alone:?}");
            assert!(alone.joints.iter().all(|of| of.left < 0.05), "{alone:?}");
            let both = load(Some(2));
            assert!(both.load().is_some(), "{both:?}");
            assert!(matches!(both.cause(), WorkCause::Gain(joint, _) if joint.index() == 2), "{both:?}");
        }
    }

    #[test]
    fn a_rarer_alarm_needs_more_evidence_and_a_log_without_any_has_no_causes() {
        let at = |rate: f64| {
            let settings = DetectSettings { false_alarms_per_robot_year: rate, ..DetectSettings::default() };
            causes(&[log(1, &|_| [0.0; DEVIATION])], &settings).remove(0).expect("evidence").least
        };
        assert!((at(0.2) - at(20.0) - 2.0 * 100.0_f64.ln()).abs() < 1e-9);
        let without = ProductionSummary { evidence: Vec::new(), ..log(1, &|_| [0.0; DEVIATION]) };
        assert_eq!(causes(&[without], &DetectSettings::default()), [None]);
    }
}
