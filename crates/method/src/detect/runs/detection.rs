//! What a history says of which some tests are known in brief, or what of it has to be read first.

use armwatch_model::anomaly::brief::Judgements;
use armwatch_model::anomaly::{Findings, RunSummary};

/// The outcome of looking at a history of which some tests are known in brief.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Detection {
    /// What the history says; nothing where cycles have to be read first.
    pub findings: Findings,
    /// Places of all tests whose cycles were asked for, rising; those that were read are among them.
    pub needs: Vec<usize>,
    /// What is found in the cycles of tests, by place, where it is another than their brief has: for these briefs.
    pub judgements: Vec<(usize, Judgements)>,
}

impl Detection {
    /// Whether cycles of these tests have to be read before the history says something.
    #[must_use]
    pub fn lacks(&self, history: &[RunSummary]) -> bool {
        lacks(&self.needs, history)
    }
}

/// Whether the cycles of one of the tests at these places are left out.
pub(super) fn lacks(needs: &[usize], history: &[RunSummary]) -> bool {
    needs.iter().any(|&place| history[place].is_brief)
}
