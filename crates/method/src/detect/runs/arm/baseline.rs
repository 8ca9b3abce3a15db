//! The first runs of an arm: usual values of its quantities, and the effect of channel faults on its parameters.

use nalgebra::DVector;

use crate::detect::runs::history::first_level::FirstLevels;
use crate::detect::runs::history::first_tests::first_tests;
use crate::statistics::descriptive::{mean, median, robust_deviation};
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse, STRENGTHS};
use armwatch_model::anomaly::{RunParameter, RunSummary};
use armwatch_model::robot::{JointIndex, ParameterId, shares_of_link};

/// Upper limit of a single squared deviation: beyond it, all models are wrong.
pub(super) const MOST_CHI_SQUARE: f64 = 2000.0;
/// Least standard deviation of a parameter from run to run, as a fraction of it.
const LEAST_DEVIATION: f64 = 1e-3;
/// Least standard deviation of the logarithm of the unexplained torque from run to run.
const LEAST_RMSD_DEVIATION: f64 = 0.05;
/// Least standard deviation of the logarithm of a channel's noise from run to run.
const LEAST_NOISE_DEVIATION: f64 = 0.05;

/// Least mean square of the changes of a first run, as a multiple of the median of these runs, that is more than
/// scatter: the arm was different then, for example with a load.
const ODD_RUN: f64 = 25.0;

/// Least deviation of a value of a torque signal from the usual one that counts, in standard deviations.
pub(super) const SIGNAL_DEVIATIONS: f64 = 8.0;
/// Least offset of a torque signal, as a fraction of the joint's friction.
pub(super) const LEAST_OFFSET: f64 = 0.03;
/// Least ratio of the unexplained torque to the usual one.
pub(in crate::detect::runs) const LEAST_RMSD_RATIO: f64 = 1.6;
/// Least ratio of a channel's noise to the usual one.
pub(in crate::detect::runs) const LEAST_NOISE_RATIO: f64 = 1.5;

/// Least scatter of a parameter over the cycles of a run that widens the deviations, as a multiple of that of the first
/// runs.
const FAR_MORE: f64 = 2.0;

/// Change of the parameters by a fault of size 1, in their standard deviations, that is only rounding: for example of a
/// constant torque if the friction law has an offset column.
const LEAST_DIRECTION: f64 = 1e-6;

/// A value of the first runs: the usual one and its deviation from run to run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Usual {
    pub(super) value: f64,
    pub(super) deviation: f64,
}

impl Usual {
    /// From the first `count` values, or from those before a lasting change, if `is_change` holds for the levels before
    /// and after it; also returns the number of values used. `least` is the least deviation.
    fn of(
        values: impl Iterator<Item = f64>,
        count: usize,
        least: f64,
        is_change: impl Fn(f64, f64) -> bool,
    ) -> Option<(Self, usize)> {
        let first: Vec<f64> = values.take(count).collect();
        if first.len() < count.max(2) {
            return None;
        }
        let tests: Vec<DVector<f64>> = first.iter().map(|of| DVector::from_element(1, of / least)).collect();
        let levels = FirstLevels::of(&tests, SIGNAL_DEVIATIONS * SIGNAL_DEVIATIONS, |before, behind| {
            is_change(least * before[0], least * behind[0])
        });
        let usual = &first[..levels.usual.len()];
        let scatter = match levels.changed {
            [] => robust_deviation(usual).unwrap_or(0.0),
            _ => least * (mean(&levels.mean_squares()).unwrap_or(0.0) / levels.freedom()).sqrt(),
        };
        // the deviation from the median includes that of the median itself
        let own = (1.0 + std::f64::consts::FRAC_PI_2 / usual.len() as f64).sqrt();
        Some((Self { value: median(usual)?, deviation: own * scatter.max(least) }, usual.len()))
    }

    pub(super) fn deviations(&self, value: f64) -> f64 {
        (value - self.value) / self.deviation
    }
}

/// The first runs of an arm, of similar length.
#[derive(Debug, Clone, Default)]
pub(super) struct Baseline {
    /// Number of tests whose median is the usual parameter.
    tests: usize,
    /// Usual value and deviation of each inertial parameter, with its shares of the last link's parameters.
    pub(super) parameters: Vec<(ParameterId, Usual, [f64; 10])>,
    /// Variance of the parameters over the first runs, as a multiple of their squared deviations.
    inflation: f64,
    /// Changes of the parameters in groups of the first runs, for example of alternating tools; empty if all are alike.
    /// A run is compared with the nearest group.
    groups: Vec<DVector<f64>>,
    /// Friction of each joint, Nm (N).
    pub(super) friction: Vec<Option<f64>>,
    pub(super) offsets: Vec<Option<Usual>>,
    /// RMS torque of each joint, Nm (N). Unexplained torque and noise of every run are fractions of it: friction
    /// changes with the season, and a constant torque must not seem to change with it.
    torque: Vec<Option<f64>>,
    pub(super) rmsd: Vec<Option<Usual>>,
    /// Logarithm of the noise of the torque channels, if all first runs have it.
    pub(super) noise: Vec<Option<Usual>>,
    /// Effects of channel faults on the parameters; empty if no test has them. Faults without an effect are omitted.
    pub(super) directions: Vec<Direction>,
}

/// Effect of one fault of a channel, per size 1.
#[derive(Debug, Clone)]
pub(super) struct Direction {
    pub(super) joint: JointIndex,
    pub(super) fault: ChannelFault,
    /// Place in [`armwatch_model::analysis::response::STRENGTHS`].
    pub(super) strength: usize,
    /// Change of the parameters, in their standard deviations.
    pub(super) change: DVector<f64>,
    /// Change by a fault of this strength that does not depend on its size and sign, in the same unit; zero if unknown.
    pub(super) shift: DVector<f64>,
    /// Unexplained torque of each joint, as a fraction of its torque.
    pub(super) unexplained: Vec<f64>,
}

impl Baseline {
    /// The baseline of these tests; only the first [`Self::tests`] are used.
    pub(super) fn of(
        history: &[&RunSummary],
        response: Option<&ChannelResponse>,
        joints: usize,
        baseline_runs: usize,
    ) -> Self {
        let count = baseline_runs.max(2);
        let parameters = usual_parameters(history, count);
        let mut found = Self { parameters, inflation: 1.0, tests: count, ..Self::default() };
        let first: Vec<DVector<f64>> =
            history.iter().filter_map(|run| found.change(run)).take(count).collect();
        let found_groups = groups(&first);
        let about_group = |run: &DVector<f64>| run - nearest(&found_groups, run);
        let rests: Vec<DVector<f64>> = match found_groups[..] {
            [] => first,
            _ => first.iter().map(about_group).collect(),
        };
        let levels = FirstLevels::of(&rests, ODD_RUN, |_, _| true);
        let own = levels.mean_squares();
        let most = ODD_RUN * median(&own).unwrap_or(1.0).max(1.0);
        let inflation = own.iter().copied().filter(|of| *of <= most).fold(1.0, f64::max) / levels.freedom();
        if !levels.changed.is_empty() {
            found.tests = levels.usual.len();
            found.parameters = usual_parameters(history, found.tests);
        }
        found.inflation = inflation;
        found.groups = found_groups;
        for joint in (0..joints).map(JointIndex::new) {
            let offset = Usual::of_offsets(history, joint, count);
            found.friction.push(usual_friction(history, joint, offset.map_or(count, |(_, tests)| tests)));
            found.offsets.push(offset.map(|(usual, _)| usual));
            found.torque.push(usual_torque(history, joint, count));
            found.rmsd.push(found.usual_rmsd(history, joint, count));
            found.noise.push(found.usual_noise(history, joint, count));
        }
        found.directions = response.map(|of| found.directions(of)).unwrap_or_default();
        found
    }

    /// Number of these tests, from the first on, that are used.
    pub(super) fn tests(history: &[&RunSummary], joints: usize, baseline_runs: usize) -> usize {
        let properties = |run: &RunSummary, has_all: bool| -> Vec<bool> {
            let of_joint = |joint| [offsets(run, joint).len() > 1, rmsd(run, joint).is_some()];
            [has_all].into_iter().chain((0..joints).map(JointIndex::new).flat_map(of_joint)).collect()
        };
        let mut wanted: Option<Vec<ParameterId>> = None;
        first_tests(
            history.len(),
            baseline_runs.max(2),
            |test| properties(history[test], !history[test].parameters.is_empty()),
            |test| {
                let run = history[test];
                let has = |id: &ParameterId| run.parameters.iter().any(|of| of.id == *id);
                if wanted.is_none() && !run.parameters.is_empty() {
                    wanted = Some(run.parameters.iter().map(|of| of.id).collect());
                }
                properties(run, wanted.as_ref().is_some_and(|wanted| wanted.iter().all(has)))
            },
        )
    }

    fn usual_rmsd(&self, history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<Usual> {
        let values = history.iter().filter_map(|run| self.rmsd_of(run, joint)).map(f64::ln);
        let is_change = |before: f64, behind: f64| behind - before >= LEAST_RMSD_RATIO.ln();
        Usual::of(values, count, LEAST_RMSD_DEVIATION, is_change).map(|(usual, _)| usual)
    }

    /// Usual noise in the first runs with an RMSD; `None` if one of them has no noise, since an earlier version did not
    /// measure it.
    fn usual_noise(&self, history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<Usual> {
        let first = history.iter().filter(|run| rmsd(run, joint).is_some()).take(count);
        let noises: Option<Vec<f64>> = first.map(|run| self.noise_of(run, joint)).collect();
        let is_change = |before: f64, behind: f64| behind - before >= LEAST_NOISE_RATIO.ln();
        Usual::of(noises?.into_iter().map(f64::ln), count, LEAST_NOISE_DEVIATION, is_change)
            .map(|(usual, _)| usual)
    }

    /// RMSD of a joint in a run, as a fraction of its usual torque.
    pub(super) fn rmsd_of(&self, run: &RunSummary, joint: JointIndex) -> Option<f64> {
        Some(rmsd(run, joint)? * self.torque_ratio(run, joint))
    }

    /// Noise of a joint's torque channel in a run, as a fraction of its usual torque.
    pub(super) fn noise_of(&self, run: &RunSummary, joint: JointIndex) -> Option<f64> {
        Some(noise(run, joint)? * self.torque_ratio(run, joint))
    }

    /// Torque of a joint in a run as a multiple of the usual; 1 if one of the two is unknown.
    fn torque_ratio(&self, run: &RunSummary, joint: JointIndex) -> f64 {
        let usual = self.torque.get(joint.index()).copied().flatten();
        torque(run, joint).zip(usual).map_or(1.0, |(torque, usual)| torque / usual)
    }

    /// Variance of the usual parameters relative to the variances of a run.
    pub(super) fn own_variance(&self) -> f64 {
        std::f64::consts::FRAC_PI_2 / self.tests.max(2) as f64
    }

    /// Returns no directions if the response lacks a parameter, as that of another description does.
    fn directions(&self, response: &ChannelResponse) -> Vec<Direction> {
        let place =
            |(id, ..): &(ParameterId, Usual, [f64; 10])| response.parameters.iter().position(|of| of == id);
        let places: Option<Vec<usize>> = self.parameters.iter().map(place).collect();
        let Some(places) = places.filter(|places| !places.is_empty()) else { return Vec::new() };
        let scaled = |of: &FaultResponse| Direction {
            joint: of.joint,
            fault: of.fault,
            strength: of.strength.min(STRENGTHS.len() - 1),
            change: DVector::from_fn(places.len(), |row, _| of.change[places[row]] / self.deviation(row)),
            shift: DVector::from_fn(places.len(), |row, _| {
                of.shift.get(places[row]).map_or(0.0, |shift| shift / self.deviation(row))
            }),
            unexplained: of.unexplained.clone(),
        };
        response.faults.iter().map(scaled).filter(|of| of.change.norm() > LEAST_DIRECTION).collect()
    }

    /// Standard deviation of a parameter of a run.
    pub(super) fn deviation(&self, row: usize) -> f64 {
        self.parameters[row].1.deviation * self.inflation.sqrt()
    }

    /// The baseline for a run whose cycles disagree about a parameter by far more than those of the first runs, with
    /// the factor on the standard deviation of each parameter; `None` for other runs. A joint with a wrong torque
    /// signal has little weight in the estimate, so its parameters are uncertain: their differences are no pattern of a
    /// fault.
    pub(super) fn widened(&self, run: &RunSummary) -> Option<(Self, DVector<f64>)> {
        let by = |(id, usual, _): &(ParameterId, Usual, [f64; 10])| {
            let of = run.parameters.iter().find(|of| of.id == *id);
            let own = of.map(|of| of.std_dev / f64::from(of.cycles).sqrt() / usual.deviation);
            own.filter(|own| own.is_finite() && *own >= FAR_MORE).unwrap_or(1.0)
        };
        let by = DVector::from_iterator(self.parameters.len(), self.parameters.iter().map(by));
        if by.iter().all(|by| *by == 1.0) {
            return None;
        }
        let mut widened = self.clone();
        for ((_, usual, _), by) in widened.parameters.iter_mut().zip(&by) {
            usual.deviation *= by;
        }
        for of in &mut widened.directions {
            of.change.component_div_assign(&by);
            of.shift.component_div_assign(&by);
        }
        Some((widened, by))
    }

    /// Deviations of the inertial parameters of a run, in standard deviations; `None` if it lacks one.
    pub(super) fn change(&self, run: &RunSummary) -> Option<DVector<f64>> {
        if self.parameters.is_empty() {
            return None;
        }
        let value = |(id, usual, _): &(ParameterId, Usual, [f64; 10])| {
            let of = run.parameters.iter().find(|of| of.id == *id)?;
            Some(usual.deviations(of.mean))
        };
        let values: Option<Vec<f64>> = self.parameters.iter().map(value).collect();
        let change = DVector::from_vec(values?);
        let change = if self.groups.is_empty() { change } else { &change - nearest(&self.groups, &change) };
        Some(change / self.inflation.sqrt())
    }
}

impl Usual {
    /// Usual offset of a joint, and the number of tests used.
    fn of_offsets(history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<(Self, usize)> {
        let runs: Vec<Vec<f64>> =
            history.iter().map(|run| offsets(run, joint)).filter(|of| of.len() > 1).take(count).collect();
        let within: Vec<f64> =
            runs.iter().filter_map(|run| Some(robust_deviation(run)? / (run.len() as f64).sqrt())).collect();
        let friction = history.iter().find_map(|run| friction(run, joint)).unwrap_or(0.0);
        let least = median(&within).unwrap_or(0.0).max(1e-3 * friction).max(f64::MIN_POSITIVE);
        let is_change = |before: f64, behind: f64| (behind - before).abs() >= LEAST_OFFSET * friction;
        Self::of(runs.iter().filter_map(|run| mean(run)), count, least, is_change)
    }
}

/// Usual value, deviation and shares of the last link of each parameter of the first run that has parameters, if
/// `count` runs have it.
fn usual_parameters(history: &[&RunSummary], count: usize) -> Vec<(ParameterId, Usual, [f64; 10])> {
    let last = history.iter().flat_map(|run| &run.parameters).map(|of| of.id.joint).max();
    let first = history.iter().find(|run| !run.parameters.is_empty());
    let usual = |of: &RunParameter| {
        let own: Vec<&RunParameter> = history
            .iter()
            .filter_map(|run| run.parameters.iter().find(|other| other.id == of.id))
            .take(count)
            .collect();
        let scatter: Vec<f64> =
            own.iter().map(|of| of.std_dev / f64::from(of.cycles).sqrt()).filter(|s| s.is_finite()).collect();
        let least =
            median(&scatter).unwrap_or(0.0).max(LEAST_DEVIATION * of.mean.abs()).max(f64::MIN_POSITIVE);
        // errors of single runs are exact enough, deviations of a few runs are not: these are pooled
        let means: Vec<f64> = own.iter().map(|of| of.mean).collect();
        let value = median(&means).filter(|_| means.len() == count)?;
        let usual =
            Usual { value, deviation: least * (1.0 + std::f64::consts::FRAC_PI_2 / count as f64).sqrt() };
        Some((of.id, usual, shares_of_link(&of.terms, last?)))
    };
    first.map(|run| run.parameters.iter().filter_map(usual).collect()).unwrap_or_default()
}

/// Means of the groups of the first runs. Runs whose changes differ by less than [`ODD_RUN`] in the mean square are one
/// group. Empty in three cases: fewer than two groups have two runs (scatter, or one odd run), no group recurs (a
/// lasting change), or one group has most runs (the usual one).
fn groups(first: &[DVector<f64>]) -> Vec<DVector<f64>> {
    let is_near =
        |a: &DVector<f64>, b: &DVector<f64>| (a - b).norm_squared() <= ODD_RUN * a.len().max(1) as f64;
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (run, change) in first.iter().enumerate() {
        match groups.iter_mut().find(|group| is_near(&first[group[0]], change)) {
            Some(group) => group.push(run),
            None => groups.push(vec![run]),
        }
    }
    let returns = |group: &Vec<usize>| group.windows(2).any(|pair| pair[1] > pair[0] + 1);
    let is_usual = |group: &Vec<usize>| 2 * group.len() > first.len();
    let repeated = groups.iter().filter(|group| group.len() > 1).count();
    if repeated < 2 || !groups.iter().any(returns) || groups.iter().any(is_usual) {
        return Vec::new();
    }
    let mean = |group: &Vec<usize>| {
        let zero = DVector::zeros(first[group[0]].len());
        group.iter().fold(zero, |sum, run| sum + &first[*run]) / group.len() as f64
    };
    groups.iter().map(mean).collect()
}

/// The group nearest to a change; `groups` is not empty.
fn nearest<'g>(groups: &'g [DVector<f64>], change: &DVector<f64>) -> &'g DVector<f64> {
    let distance = |group: &&DVector<f64>| (change - *group).norm_squared();
    groups.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(&groups[0])
}

pub(super) fn offsets(run: &RunSummary, joint: JointIndex) -> Vec<f64> {
    let own = run.cycle_friction.iter().filter(|of| of.friction.joint == joint);
    own.map(|of| of.friction.offset).collect()
}

/// Mean friction of a joint, Nm (N).
pub(super) fn friction(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    let own = run.cycle_friction.iter().filter(|of| of.friction.joint == joint);
    mean(&own.map(|of| of.friction.ln_torque).collect::<Vec<f64>>()).map(f64::exp)
}

/// Median friction of a joint in the first runs, Nm (N).
fn usual_friction(history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<f64> {
    median(&history.iter().filter_map(|run| friction(run, joint)).take(count).collect::<Vec<f64>>())
}

/// RMS torque of a joint, Nm (N).
fn torque(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    run.joints.iter().find(|of| of.joint == joint)?.torque_rms.filter(|torque| *torque > 0.0)
}

/// Median RMS torque of a joint in the first runs with an RMSD, Nm (N); `None` if one of them lacks it.
fn usual_torque(history: &[&RunSummary], joint: JointIndex, count: usize) -> Option<f64> {
    let first = history.iter().filter(|run| rmsd(run, joint).is_some()).take(count);
    median(&first.map(|run| torque(run, joint)).collect::<Option<Vec<f64>>>()?)
}

fn rmsd(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    run.joints.iter().find(|of| of.joint == joint)?.relative_rmsd.filter(|rmsd| *rmsd > 0.0)
}

/// Noise of a joint's torque channel, as a fraction of the torque.
fn noise(run: &RunSummary, joint: JointIndex) -> Option<f64> {
    run.joints.iter().find(|of| of.joint == joint)?.relative_noise.filter(|noise| *noise > 0.0)
}
