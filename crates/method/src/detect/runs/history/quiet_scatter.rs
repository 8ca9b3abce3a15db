//! Scatter of a quantity of a joint from one quiet test to the next, with its autocorrelation, learnt as tests arrive.
//!
//! A test is learnt after [`LAG`] later quiet ones, so that the beginning of a change does not count as scatter.

use std::collections::VecDeque;

use crate::detect::rate::whitening::{Likeness, Prior, Whitener};
use armwatch_model::analysis::Estimate;

/// Quiet tests after one until it is learnt: as many as a drift of half a per cent per test needs to show.
const LAG: usize = 8;

/// Lag-1 autocorrelation before any test, and its standard deviation between joints. Indices of simulated healthy
/// joints have -0.04 (docs/method.md, "Friction index"); real ones also depend on their surroundings.
const CORRELATION: Estimate = Estimate { value: 0.2, std_error: 0.2 };

/// The scatter learnt so far.
pub(in crate::detect::runs) struct QuietScatter {
    whitener: Whitener,
    worth: f64,
    waiting: VecDeque<Estimate>,
    learnt: Vec<Estimate>,
    most: usize,
}

impl QuietScatter {
    /// The state before the first test: a standard deviation that is worth this number of tests. At most `most` tests
    /// are learnt.
    pub(in crate::detect::runs) fn new(deviation: f64, worth: f64, most: usize) -> Self {
        Self {
            whitener: whitener(deviation, worth),
            worth,
            waiting: VecDeque::new(),
            learnt: Vec::new(),
            most,
        }
    }

    /// Replaces the expected standard deviation before the first test.
    pub(in crate::detect::runs) fn expect(&mut self, deviation: f64) {
        self.whitener = whitener(deviation, self.worth);
        for test in &self.learnt {
            self.whitener.learn(test.value, test.std_error);
        }
    }

    /// Learns a test of the baseline.
    pub(in crate::detect::runs) fn learn(&mut self, test: Estimate) {
        self.whitener.learn(test.value, test.std_error);
        self.learnt.push(test);
    }

    /// Adds a quiet test, which is learnt after later ones. Returns true if a test was learnt.
    pub(in crate::detect::runs) fn quiet(&mut self, test: Estimate) -> bool {
        if self.learnt.len() >= self.most {
            return false;
        }
        self.waiting.push_back(test);
        let due = if self.waiting.len() > LAG { self.waiting.pop_front() } else { None };
        due.inspect(|of| self.learn(*of)).is_some()
    }

    /// Drops the waiting tests, since a test is out: they may belong to the same change.
    pub(in crate::detect::runs) fn out(&mut self) {
        self.waiting.clear();
    }

    /// Score of a test that follows one with the value `previous`, standard normal if nothing has changed.
    pub(in crate::detect::runs) fn score(&self, previous: f64, value: f64, std_error: f64) -> f64 {
        self.whitener.score(previous, value, std_error)
    }

    /// Number of learnt tests.
    pub(in crate::detect::runs) fn learnt(&self) -> usize {
        self.learnt.len()
    }

    /// Properties of the learnt tests.
    pub(in crate::detect::runs) fn likeness(&self) -> Likeness {
        self.whitener.likeness()
    }
}

fn whitener(deviation: f64, worth: f64) -> Whitener {
    Whitener::new(Prior { scale: deviation, worth, correlation: CORRELATION })
}
