//! How much a quantity of a joint scatters from one quiet test to the next, with its autocorrelation, learnt as tests come.
//!
//! A test is learnt when [`LAG`] later ones are quiet, so that a change that begins is not taken for scatter.

use std::collections::VecDeque;

use crate::detect::rate::whitening::{Likeness, Prior, Whitener};
use armwatch_model::analysis::Estimate;

/// Quiet tests after one until it is learnt: as many as a drift of half a per cent a test needs to show.
const LAG: usize = 8;

/// Lag-1 autocorrelation before any test, and its standard deviation between joints. Indices of simulated healthy joints
/// have -0.04 (docs/method.md, "Friction index"); real ones have their surroundings in them too.
const CORRELATION: Estimate = Estimate { value: 0.2, std_error: 0.2 };

/// What is learnt of it until now.
pub(in crate::detect::runs) struct QuietScatter {
    whitener: Whitener,
    waiting: VecDeque<Estimate>,
    learnt: usize,
    most: usize,
}

impl QuietScatter {
    /// Before the first test: a standard deviation that is worth so many tests. Nothing is learnt behind `most` tests.
    pub(in crate::detect::runs) fn new(deviation: f64, worth: f64, most: usize) -> Self {
        let prior = Prior { scale: deviation, worth, correlation: CORRELATION };
        Self { whitener: Whitener::new(prior), waiting: VecDeque::new(), learnt: 0, most }
    }

    /// Learns a test of the baseline.
    pub(in crate::detect::runs) fn learn(&mut self, test: Estimate) {
        self.whitener.learn(test.value, test.std_error);
        self.learnt += 1;
    }

    /// Takes a quiet test, which is learnt when others have followed it. Says whether one was learnt.
    pub(in crate::detect::runs) fn quiet(&mut self, test: Estimate) -> bool {
        if self.learnt >= self.most {
            return false;
        }
        self.waiting.push_back(test);
        let due = if self.waiting.len() > LAG { self.waiting.pop_front() } else { None };
        due.inspect(|of| self.learn(*of)).is_some()
    }

    /// A test is out: the ones before it may belong to what it shows.
    pub(in crate::detect::runs) fn out(&mut self) {
        self.waiting.clear();
    }

    /// Tests learnt.
    pub(in crate::detect::runs) fn learnt(&self) -> usize {
        self.learnt
    }

    /// What they are like.
    pub(in crate::detect::runs) fn likeness(&self) -> Likeness {
        self.whitener.likeness()
    }
}
