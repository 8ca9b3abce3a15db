//! Findings from a history of which the cycles of few tests are read.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use armwatch_method::detect::runs::detect_in_brief;
use armwatch_model::anomaly::peer::Peer;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Findings, RunSummary};
use armwatch_store::{ConclusionTransaction, StoreError};

/// Rounds of reading after which all cycles are read, beside one for every so many tests: each round judges a thousand tests
/// of which nothing is kept, and few rounds find out what baselines stand on.
const MOST_ROUNDS: usize = 32;
const TESTS_OF_A_ROUND: usize = 500;

/// What a history says, and what it took.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Detected {
    /// What it says.
    pub findings: Findings,
    /// Time of the detectors.
    pub computing: Duration,
    /// Tests whose cycles were read.
    pub read: usize,
}

/// What the complete tests of a robot say, whose cycles are left out: those are read that the detectors ask for, and what
/// was found in them is kept.
///
/// # Errors
/// Those of the store.
pub async fn detected(
    conclusion: &mut ConclusionTransaction,
    tests: &mut [RunSummary],
    peers: &[Peer],
    settings: &DetectSettings,
) -> Result<Detected, StoreError> {
    let mut changed: BTreeSet<usize> = BTreeSet::new();
    let mut round = 0;
    let (mut computing, mut read) = (Duration::ZERO, 0);
    let findings = loop {
        let began = Instant::now();
        let detection = detect_in_brief(tests, peers, settings);
        computing += began.elapsed();
        let lacks = detection.lacks(tests);
        for (place, judgements) in detection.judgements {
            if let Some(brief) = &mut tests[place].brief {
                Arc::make_mut(brief).judgements = judgements;
                changed.insert(place);
            }
        }
        if !lacks {
            break detection.findings;
        }
        round += 1;
        let needs = match round > MOST_ROUNDS + tests.len() / TESTS_OF_A_ROUND {
            true => (0..tests.len()).collect(),
            false => detection.needs,
        };
        for (place, test) in tests.iter_mut().enumerate() {
            if needs.binary_search(&place).is_err() {
                test.leave_out();
            }
        }
        read += needs.iter().filter(|&&place| tests[place].is_brief).count();
        conclusion.read_cycles(tests, &needs).await?;
    };
    for place in changed {
        conclusion.keep_judgements(&tests[place]).await?;
    }
    Ok(Detected { findings, computing, read })
}
