//! Global search for a series: many random starts, each improved by L-BFGS (Liu & Nocedal 1989) on the smooth problem
//! of [`SearchProblem`], in stages that come closer to the true condition number and to the limits.
//!
//! A start depends only on the seed and its own number, not on other starts or on threads. So the first `k` starts give
//! the same series on any number of threads, even if a time limit ended the search after `k`.

use std::convert::Infallible;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use basin::{CostFunction, Executor, FirstOrderState, Gradient, Lbfgs};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::problem::{SearchProblem, Strictness};
use armwatch_model::robot::FourierExcitation;

/// Stages of a start: strictness, and most iterations. Early ones include all singular values and may cross limits, so
/// that they are smooth; the last matches the condition number to 1 % and limits to 1e-5.
const STAGES: [(Strictness, u64); 5] = [
    (Strictness { power: 3.0, penalty: 10.0 }, 120),
    (Strictness { power: 8.0, penalty: 1e2 }, 120),
    (Strictness { power: 20.0, penalty: 1e3 }, 150),
    (Strictness { power: 60.0, penalty: 1e4 }, 200),
    (Strictness { power: 200.0, penalty: 1e5 }, 250),
];

/// Final stages for the best starts.
const LAST_STAGES: [(Strictness, u64); 2] =
    [(Strictness { power: 600.0, penalty: 1e6 }, 400), (Strictness { power: 2000.0, penalty: 1e7 }, 600)];

/// Starts that pass the final stages, because only these decide which start is the best.
const FINALISTS: usize = 4;

/// A gradient smaller than this ends a stage, and so does a step that changes the logarithm of the objective by less.
const SLOPE_TOLERANCE: f64 = 1e-6;
const COST_TOLERANCE: f64 = 1e-9;

/// Steps that L-BFGS remembers: more than its usual ten, since an evaluation costs a thousand times a step.
const MEMORY: usize = 20;

/// Standard deviation of amplitudes at the start, in units of the largest velocity, and of centres in units of half
/// the range.
const START_AMPLITUDE: f64 = 0.2;
const START_CENTRE: f64 = 0.3;

/// Cost of variables whose motion does not identify every parameter.
const HOPELESS: f64 = 1e3;

/// Extent of the search.
#[derive(Debug, Clone, Copy)]
pub enum SearchBudget {
    /// A number of starts.
    Starts(u64),
    /// New starts until this time.
    Until(Instant),
}

/// Progress of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SearchProgress {
    /// Completed starts.
    pub starts: u64,
    /// The best value so far.
    pub best: f64,
}

/// Result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct SearchResult {
    /// The best series, inside all limits of the motion.
    pub series: FourierExcitation,
    /// Its start, from 0.
    pub best_start: u64,
    /// Its value: the objective, larger if it misses limits that a smaller motion does not fulfil.
    pub value: f64,
    /// Value of each start before the best ones were improved further, in their order.
    pub values: Vec<f64>,
    /// Evaluations of cost and slope, of all starts.
    pub evaluations: u64,
}

/// Result of one start.
#[derive(Clone)]
struct StartOutcome {
    start: u64,
    numbers: Vec<f64>,
    value: f64,
    series: FourierExcitation,
}

/// Result of an earlier search with the same problem and seed.
#[derive(Debug, Clone, PartialEq)]
pub struct Earlier {
    /// Its best series.
    pub series: FourierExcitation,
    /// The start of that, from 0.
    pub best_start: u64,
    /// Value of each of its starts, in their order.
    pub values: Vec<f64>,
    /// Evaluations of cost and slope.
    pub evaluations: u64,
}

/// Searches on `threads` threads, after the `earlier` search; `None` if no start gave a motion that identifies every
/// parameter.
pub fn search(
    problem: &SearchProblem<'_>,
    seed: u64,
    budget: SearchBudget,
    threads: usize,
    earlier: Option<&Earlier>,
    progress: &(dyn Fn(SearchProgress) + Sync),
) -> Option<SearchResult> {
    let first = earlier.map_or(0, |earlier| earlier.values.len() as u64);
    let (next, evaluations) = (AtomicU64::new(first), AtomicU64::new(0));
    let done: Mutex<Vec<StartOutcome>> = Mutex::new(Vec::new());
    // a start that is taken is completed, so that the starts are those from 0 on without a gap
    let taken = || match budget {
        SearchBudget::Starts(starts) => {
            Some(next.fetch_add(1, Ordering::Relaxed)).filter(|start| *start < first + starts)
        }
        SearchBudget::Until(end) if Instant::now() < end => Some(next.fetch_add(1, Ordering::Relaxed)),
        // the first start is always completed: an answer is needed
        SearchBudget::Until(_) => {
            next.compare_exchange(first, first + 1, Ordering::Relaxed, Ordering::Relaxed).ok()
        }
    };
    let work = || {
        while let Some(start) = taken() {
            let numbers = random_numbers(problem, seed, start);
            let outcome = improved(problem, start, numbers, &STAGES, &evaluations);
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            done.push(outcome);
            let best = done.iter().map(|outcome| outcome.value).fold(f64::INFINITY, f64::min);
            progress(SearchProgress { starts: done.len() as u64, best });
        }
    };
    on_threads(threads, work);
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|outcome| outcome.start);
    let values: Vec<f64> = done.iter().map(|outcome| outcome.value).collect();
    done.sort_by(|a, b| a.value.total_cmp(&b.value));
    done.truncate(FINALISTS);

    let (next, last): (_, Mutex<Vec<StartOutcome>>) = (AtomicU64::new(0), Mutex::new(Vec::new()));
    let finish = || {
        while let Some(finalist) = done.get(next.fetch_add(1, Ordering::Relaxed) as usize) {
            let numbers = finalist.numbers.clone();
            let outcome = improved(problem, finalist.start, numbers, &LAST_STAGES, &evaluations);
            let better = if outcome.value < finalist.value { outcome } else { finalist.clone() };
            let mut last = last.lock().unwrap_or_else(PoisonError::into_inner);
            last.push(better);
            let best = last.iter().map(|outcome| outcome.value).fold(done[0].value, f64::min);
            progress(SearchProgress { starts: values.len() as u64, best });
        }
    };
    on_threads(threads, finish);
    let last = last.into_inner().unwrap_or_else(PoisonError::into_inner);
    let before = earlier.map(|earlier| StartOutcome {
        start: earlier.best_start,
        numbers: Vec::new(),
        value: problem.value(&earlier.series).map_or(f64::INFINITY, f64::exp),
        series: earlier.series.clone(),
    });
    let all = last.into_iter().chain(before);
    let best = all.min_by(|a, b| a.value.total_cmp(&b.value).then(a.start.cmp(&b.start)))?;
    let (values_before, evaluations_before) =
        earlier.map_or((&[][..], 0), |earlier| (&earlier.values[..], earlier.evaluations));
    best.value.is_finite().then_some(SearchResult {
        series: best.series,
        best_start: best.start,
        value: best.value,
        values: [values_before, &values].concat(),
        evaluations: evaluations_before + evaluations.into_inner(),
    })
}

/// Does the same work on `threads` threads.
fn on_threads(threads: usize, work: impl Fn() + Sync) {
    std::thread::scope(|scope| {
        (1..threads.max(1)).for_each(|_| {
            scope.spawn(&work);
        });
        work();
    });
}

/// Improves a start, from its variables, through stages.
fn improved(
    problem: &SearchProblem<'_>,
    start: u64,
    mut numbers: Vec<f64>,
    stages: &[(Strictness, u64)],
    evaluations: &AtomicU64,
) -> StartOutcome {
    for &(strictness, iterations) in stages {
        let smooth = Smooth { problem, strictness, evaluations };
        let solver = Lbfgs::new()
            .unbounded()
            .with_m_capacity(MEMORY)
            .with_absolute_gradient_tolerance(SLOPE_TOLERANCE)
            .with_absolute_cost_change_tolerance(COST_TOLERANCE);
        let state = FirstOrderState::new(numbers.clone());
        // a line search that finds no better point ends a stage; the next stage is another function
        let Ok(result) = Executor::new(smooth, solver, state).max_iter(iterations).run();
        numbers.clone_from(result.best_param());
    }
    let series = problem.within_limits(problem.series(&numbers));
    let value = problem.value(&series).map_or(f64::INFINITY, f64::exp);
    StartOutcome { start, numbers, value, series }
}

/// Variables of a random series.
fn random_numbers(problem: &SearchProblem<'_>, seed: u64, start: u64) -> Vec<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(start);
    let per_joint = problem.dimension() / problem.robot().joint_count();
    let scale = |k: usize| if (k + 1).is_multiple_of(per_joint) { START_CENTRE } else { START_AMPLITUDE };
    (0..problem.dimension())
        .map(|k| {
            let normal: f64 = rng.sample(StandardNormal);
            scale(k) * normal
        })
        .collect()
}

/// The problem at one strictness, in the optimiser's interface.
struct Smooth<'a, 'b> {
    problem: &'b SearchProblem<'a>,
    strictness: Strictness,
    evaluations: &'b AtomicU64,
}

impl Smooth<'_, '_> {
    fn both(&self, numbers: &[f64]) -> (f64, Vec<f64>) {
        self.evaluations.fetch_add(1, Ordering::Relaxed);
        match self.problem.cost(numbers, self.strictness) {
            Ok((cost, slope)) if cost.is_finite() && slope.iter().all(|of| of.is_finite()) => (cost, slope),
            _ => (HOPELESS, vec![0.0; numbers.len()]),
        }
    }
}

impl basin::Constraints for Smooth<'_, '_> {
    type Set = basin::NoConstraints;

    fn constraints(&self) -> <Self::Set as basin::ConstraintDescription>::Borrowed<'_> {
        basin::ConstraintSet::new()
    }
}

impl CostFunction for Smooth<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = Infallible;

    fn cost(&self, numbers: &Vec<f64>) -> Result<f64, Infallible> {
        Ok(self.both(numbers).0)
    }
}

impl Gradient for Smooth<'_, '_> {
    type Gradient = Vec<f64>;

    fn gradient(&self, numbers: &Vec<f64>) -> Result<Vec<f64>, Infallible> {
        Ok(self.both(numbers).1)
    }

    fn cost_and_gradient(&self, numbers: &Vec<f64>) -> Result<(f64, Vec<f64>), Infallible> {
        Ok(self.both(numbers))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::{MotionLimits, Shares, broken_by_series, extremes};
    use crate::objective::Objective;
    use crate::prediction::conditioning;
    use crate::problem::{SearchSettings, SeriesForm};
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_testing::er3a_of;

    #[test]
    fn a_search_is_the_same_on_any_number_of_threads_and_its_value_that_of_the_whole_matrix() {
        let robot = er3a_of(1);
        let base = base_parameters(&robot).expect("base parameters");
        let shares = Shares { position: 0.9, velocity: 0.95, acceleration: 1.0 };
        let settings = SearchSettings {
            period: 4.0,
            harmonics: 2,
            form: SeriesForm::Fourier,
            objective: Objective::ScaledCondition,
            parameters: (0..base.kept.len()).collect(),
            row_scales: vec![1.0],
            scales: vec![1.0; base.kept.len()],
            known: None,
            limits: vec![MotionLimits::of(&robot.joints[0], &shares)],
            torque: None,
            clearance: None,
            reached_speed: 0.9 / shares.velocity,
        };
        let problem = SearchProblem::new(&robot, &base, settings).expect("a problem");
        let run = |seed: u64, starts: u64, threads: usize| {
            search(&problem, seed, SearchBudget::Starts(starts), threads, None, &|_| ()).expect("a series")
        };
        let one = run(5, 2, 1);
        assert_eq!(one, run(5, 2, 2));
        assert_ne!(one.series, run(6, 2, 1).series);
        assert_eq!(one.values.len(), 2);
        let best = one.value;
        assert!(one.values.iter().all(|value| *value >= best), "{one:?}");
        // the same instants as the search has
        let all: Vec<usize> = (0..base.kept.len()).collect();
        let found = conditioning(&robot, &base, &all, &one.series, 25.0).expect("condition numbers");
        assert!((best / found.scaled_condition_number - 1.0).abs() < 0.01, "{best} {found:?}");
        assert!(broken_by_series(&robot, &one.series).is_empty());
        let speed = extremes(&one.series, 0).speed.value.abs() / robot.joints[0].limits.velocity;
        assert!((0.89..=0.95).contains(&speed), "{speed}");
        // a time limit in the past still gives one start
        let past =
            search(&problem, 5, SearchBudget::Until(Instant::now()), 2, None, &|_| ()).expect("a series");
        assert_eq!(past.values.len(), 1);
        assert_eq!(past.values[0], one.values[0]);
        // continuing with the second start tries it; the first one's series stays unless it is beaten
        let earlier = Earlier {
            series: past.series.clone(),
            best_start: past.best_start,
            values: past.values.clone(),
            evaluations: past.evaluations,
        };
        let on = search(&problem, 5, SearchBudget::Starts(1), 1, Some(&earlier), &|_| ()).expect("a series");
        assert_eq!(on.values, one.values);
        assert!((on.value / best - 1.0).abs() < 1e-9 && on.evaluations > past.evaluations, "{on:?}");
    }
}
