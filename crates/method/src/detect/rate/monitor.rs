//! Monitor of one series: evidence, statistic and limit, by how much is known about the series.
//!
//! | phase | evidence | limit | mean number of values between false alarms |
//! |---|---|---|---|
//! | no history | ranks | without a distribution | at least the set one, if all orders are equally likely |
//! | short | whitened scores | without the overshoot | at least the set one, if values follow [`super::whitening`] |
//! | own | whitened scores | with the overshoot | the set one with normal values; more with heavy tails |

use std::collections::VecDeque;

use super::chart::{SequentialChart, normal_limit, sure_limit};
use super::ranks::Ranks;
use super::whitening::{Prior, Whitener};

/// Fewest values for whitening: the series' own plus the worth of the prior.
const WHITENED_FROM: f64 = 8.0;
/// Fewest own values for a limit without margin.
pub const OWN_FROM: usize = 40;

/// Most values that wait before they are learnt, in a series without memory. Otherwise a large shift would be learnt,
/// and count as heavy tails, before it is found. In a series with memory, outdated estimates leave correlated errors,
/// so fewer may wait.
const MOST_WAITING: f64 = 6.0;
/// Learnt values per waiting one: estimates need most of the values.
const WAITING_SHARE: f64 = 40.0;

/// Amount of knowledge about a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Almost none.
    NoHistory,
    /// A prior, or few values.
    Short,
    /// Its own history.
    Own,
}

impl Phase {
    /// Name for users and in JSON.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NoHistory => "no history",
            Self::Short => "short",
            Self::Own => "own",
        }
    }
}

/// Result of one value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// True if the statistic has reached its limit. The chart restarts then.
    pub is_out: bool,
    /// Score of the value, in standard deviations.
    pub score: f64,
    /// Knowledge that the limit is based on.
    pub phase: Phase,
}

/// A series and its chart. All values are learnt, with a delay.
#[derive(Debug, Clone)]
pub struct Monitor {
    whitener: Whitener,
    ranks: Ranks,
    chart: SequentialChart,
    prior: Prior,
    count: usize,
    previous: f64,
    waiting: VecDeque<(f64, f64)>,
    sure: f64,
    normal: f64,
}

impl Monitor {
    /// A monitor before its first value; `run_length` is the mean number of values between false alarms.
    #[must_use]
    pub fn new(prior: Prior, run_length: f64) -> Self {
        Self {
            whitener: Whitener::new(prior),
            ranks: Ranks::default(),
            chart: SequentialChart::default(),
            prior,
            count: 0,
            previous: 0.0,
            waiting: VecDeque::new(),
            sure: sure_limit(run_length),
            normal: normal_limit(run_length),
        }
    }

    /// Knowledge about the series before its next value.
    #[must_use]
    pub fn phase(&self) -> Phase {
        if self.count >= OWN_FROM {
            Phase::Own
        } else if self.count as f64 + self.prior.worth >= WHITENED_FROM {
            Phase::Short
        } else {
            Phase::NoHistory
        }
    }

    /// Adds a value with its standard error, 0 if unknown.
    pub fn add(&mut self, value: f64, std_error: f64) -> Reading {
        let phase = self.phase();
        let score = self.whitener.score(self.previous, value, std_error);
        self.previous = value;
        self.count += 1;
        self.waiting.push_back((value, std_error));
        let independent = 1.0 - self.whitener.likeness().correlation;
        let most = (MOST_WAITING * independent).min(self.count as f64 / WAITING_SHARE);
        while self.waiting.len() as f64 > most
            && let Some((value, std_error)) = self.waiting.pop_front()
        {
            self.whitener.learn(value, std_error);
        }
        let (statistic, limit) = match phase {
            Phase::NoHistory => {
                let standing = self.ranks.add(value);
                (self.chart.add_evidence(|shift| standing.evidence(shift)), self.sure)
            }
            Phase::Short => (self.chart.add(score), self.sure),
            Phase::Own => (self.chart.add(score), self.normal),
        };
        let is_out = statistic >= limit;
        if is_out {
            self.chart.restart();
        }
        Reading { is_out, score, phase }
    }

    /// Restarts the chart and keeps the estimates of the series.
    pub fn restart(&mut self) {
        self.chart.restart();
    }
}

#[cfg(test)]
mod tests;
