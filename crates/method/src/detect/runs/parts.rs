//! The parts of a history: tests that are compared with each other, with what is found in their cycles.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use nalgebra::DVector;

use super::arm::cause::ArmCause;
use super::arm::{
    ArmEvidence, UsualArm, faults, least_advantage as least_advantage_of_arm, response_of, together,
};
use super::arm_detectors::common_change::common_parts;
use super::curve::causes::{RunCauses, UsualCurves, tests_of_usual};
use super::curve::run_cause::{RunCause, least_advantage};
use super::detection::{Detection, lacks};
use super::history::friction_history::{FrictionHistory, bound_spreads, learn_before_jumps};
use super::history::like_length::of_like_length;
use super::joint_detectors::warm_up::common_warm_up;
use super::judgement::{Frame, Judgement, key};
use super::series::friction_history;
use crate::detect::verdict::Verdict;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Findings, RunSummary};
use armwatch_model::robot::JointIndex;

/// Tests that are asked for at once because nothing that holds is kept of them: so many are read, judged and left out
/// again, that a long history of which nothing is kept never lies in memory as a whole.
const MOST_AT_ONCE: usize = 1024;

/// Tests that are compared with each other.
pub(super) struct Part<'h> {
    pub(super) runs: Cow<'h, [RunSummary]>,
    /// Key and start of each.
    pub(super) moments: Vec<(i64, Timestamp)>,
    pub(super) arm: Vec<Option<ArmEvidence>>,
    /// The fault of the arm that each run has.
    pub(super) faults: Vec<Option<ArmCause>>,
    /// By joint and run.
    pub(super) causes: Vec<Vec<Option<RunCause>>>,
    /// Why what all joints share differs from the usual in each run, and what is said of their warm-up.
    pub(super) common_causes: Vec<Option<RunCause>>,
    pub(super) common_warm_up: Vec<Verdict>,
    /// By joint.
    pub(super) friction: Vec<FrictionHistory>,
}

/// Parts of a history, each found once; most joints have the same.
pub(super) struct Parts<'h> {
    history: &'h [RunSummary],
    joints: usize,
    settings: &'h DetectSettings,
    /// Advantage of a cause of a curve that is clear, and of one of the arm.
    least: [f64; 2],
    /// By the places of the tests; `None` where cycles have to be read first.
    found: Vec<(Vec<usize>, Option<Part<'h>>)>,
    /// Whether a test is known in brief, so that judgements are kept.
    is_kept: bool,
    /// Places of all tests whose cycles are asked for, and how many of these are to be judged.
    pub(super) needs: BTreeSet<usize>,
    to_judge: usize,
    judgements: BTreeMap<usize, Vec<(u64, Vec<u8>)>>,
}

impl<'h> Parts<'h> {
    pub(super) fn new(history: &'h [RunSummary], joints: usize, settings: &'h DetectSettings) -> Self {
        Self {
            history,
            joints,
            settings,
            least: [least_advantage(history, settings), least_advantage_of_arm(history, settings)],
            found: Vec::new(),
            is_kept: history.iter().any(|run| run.brief.is_some()),
            needs: BTreeSet::new(),
            to_judge: 0,
            judgements: BTreeMap::new(),
        }
    }

    /// Looks at the tests at these places, unless they were looked at.
    pub(super) fn add(&mut self, places: &[usize]) {
        if !self.found.iter().any(|(known, _)| known == places) {
            let part = self.part(places);
            self.found.push((places.to_vec(), part));
        }
    }

    /// The part of these places.
    pub(super) fn of(&self, places: &[usize]) -> Option<&Part<'h>> {
        self.found.iter().find(|(known, _)| known == places)?.1.as_ref()
    }

    /// Whether no cycles have to be read first.
    pub(super) fn are_complete(&self) -> bool {
        self.found.iter().all(|(_, part)| part.is_some())
    }

    /// What came of it: these findings, where nothing has to be read.
    pub(super) fn detection(self, findings: Findings) -> Detection {
        let needs: Vec<usize> = self.needs.into_iter().collect();
        let lacks = lacks(&needs, self.history);
        let changed = |(place, mut found): (usize, Vec<(u64, Vec<u8>)>)| {
            let known =
                self.history[place].brief.as_ref().map(|brief| &brief.judgements[..]).unwrap_or_default();
            if lacks {
                // parts that were not looked at may have theirs
                let has = |key: u64| found.iter().any(|(of, _)| *of == key);
                let others: Vec<(u64, Vec<u8>)> =
                    known.iter().filter(|(key, _)| !has(*key)).cloned().collect();
                found.extend(others);
                found.sort_by_key(|(key, _)| !known.iter().any(|(of, _)| of == key));
            }
            (found != known).then_some((place, found))
        };
        let judgements = self.judgements.into_iter().filter_map(changed).collect();
        let findings = if lacks { Findings::default() } else { findings };
        Detection { findings, needs, judgements }
    }

    fn part(&mut self, places: &[usize]) -> Option<Part<'h>> {
        let runs: Cow<'h, [RunSummary]> = match places.len() == self.history.len() {
            true => Cow::Borrowed(self.history),
            false => places.iter().map(|&place| self.history[place].clone()).collect::<Vec<_>>().into(),
        };
        let judged = self.judged(places, &runs)?;
        let mut causes: Vec<Vec<Option<RunCause>>> = vec![Vec::with_capacity(runs.len()); self.joints];
        let mut arm = Vec::with_capacity(runs.len());
        let mut common_causes = Vec::with_capacity(runs.len());
        for judgement in judged {
            let RunCauses { of_joints, of_arm: shared } = judgement.causes;
            causes.iter_mut().zip(of_joints).for_each(|(causes, cause)| causes.push(cause));
            common_causes.push(shared);
            arm.push(judgement.arm.at_least(self.least[1]));
        }
        let baseline_runs = self.settings.baseline_runs;
        let of_joint = |(joint, causes): (usize, &Vec<Option<RunCause>>)| {
            friction_history(&runs, JointIndex::new(joint), causes, baseline_runs)
        };
        let mut friction: Vec<FrictionHistory> = causes.iter().enumerate().map(of_joint).collect();
        learn_before_jumps(&mut friction);
        let common = common_parts(&friction, runs.len());
        friction.iter_mut().zip(&common).for_each(|(history, common)| history.without_common(common));
        bound_spreads(&mut friction);
        let moments: Vec<(i64, Timestamp)> = runs.iter().map(|run| (run.run_id, run.started_at)).collect();
        let faults = faults(&arm);
        let common_warm_up = common_warm_up(&common_causes, &faults, self.joints, &moments, self.settings);
        Some(Part { runs, moments, arm, faults, causes, common_causes, common_warm_up, friction })
    }

    /// What is found in the cycles of each test; `None` where some have to be read first.
    fn judged(&mut self, places: &[usize], runs: &[RunSummary]) -> Option<Vec<Judgement>> {
        let baseline_runs = self.settings.baseline_runs;
        let first = tests_of_usual(runs, self.joints, baseline_runs);
        let groups = of_like_length(runs);
        let of_group =
            |group: &Vec<usize>| -> Vec<&RunSummary> { group.iter().map(|&at| &runs[at]).collect() };
        let groups: Vec<(Vec<usize>, Vec<&RunSummary>)> =
            groups.into_iter().map(|group| (group.clone(), of_group(&group))).collect();
        let of_arm: Vec<usize> =
            groups.iter().map(|(_, runs)| UsualArm::tests(runs, self.joints, baseline_runs)).collect();
        let mut usual: BTreeSet<usize> = (0..first).collect();
        for ((group, _), count) in groups.iter().zip(&of_arm) {
            usual.extend(&group[..*count]);
        }
        self.needs.extend(usual.iter().map(|&at| places[at]));
        let is_read = usual.iter().all(|&at| !runs[at].is_brief);
        if !is_read {
            // those of which nothing is kept are needed next
            for (group, of_group) in &groups {
                for at in 0..group.len() {
                    let nothing =
                        |run: &RunSummary| run.left_out().is_some_and(|of| of.judgements.is_empty());
                    if nothing(of_group[at]) {
                        self.ask(places, group, at, &together(of_group, at));
                    }
                }
            }
            return None;
        }
        let response = response_of(runs);
        let frame = Frame {
            curves: UsualCurves::of(&runs[..first], self.joints, baseline_runs, self.least[0]),
            arms: groups
                .iter()
                .zip(&of_arm)
                .map(|((_, runs), count)| UsualArm::of(&runs[..*count], response, self.joints, baseline_runs))
                .collect(),
        };
        let hashes = if self.is_kept { frame.hashes() } else { Vec::new() };
        let mut found: Vec<Option<Judgement>> = vec![None; runs.len()];
        for (number, (group, of_group)) in groups.iter().enumerate() {
            let arm = &frame.arms[number];
            let mut changes: BTreeMap<usize, Option<DVector<f64>>> = BTreeMap::new();
            for (at, run) in of_group.iter().enumerate() {
                let window = together(of_group, at);
                let of_window: Vec<&RunSummary> = window.iter().map(|&at| of_group[at]).collect();
                let key = hashes.get(number).map(|frame| key(*frame, run, &of_window));
                let kept = run.brief.as_ref().and_then(|brief| {
                    let bytes = &brief.judgements.iter().find(|(of, _)| Some(*of) == key)?.1;
                    Some((Judgement::unpacked(bytes, &frame.curves)?, bytes.clone()))
                });
                let (judgement, bytes) = match kept {
                    Some(kept) => kept,
                    None if run.is_brief || of_window.iter().any(|of| of.is_brief) => {
                        self.ask(places, group, at, &window);
                        continue;
                    }
                    None => {
                        changes.retain(|at, _| window.contains(at));
                        for &at in &window {
                            changes.entry(at).or_insert_with(|| arm.change(of_group[at]));
                        }
                        let of_window = window.iter().map(|at| changes.get(at)?.as_ref()).collect();
                        let (causes, arm) = (frame.curves.causes(run), arm.judge(run, of_window));
                        let judgement = Judgement { causes, arm };
                        let bytes = if key.is_some() { judgement.packed() } else { Vec::new() };
                        (judgement, bytes)
                    }
                };
                if let Some(key) = key {
                    let of_test = self.judgements.entry(places[group[at]]).or_default();
                    if !of_test.iter().any(|(known, _)| *known == key) {
                        of_test.push((key, bytes));
                    }
                }
                found[group[at]] = Some(judgement);
            }
        }
        found.into_iter().collect()
    }

    /// Asks for the cycles of the test at `at` of a group, and for those of the tests that are looked at together with it.
    fn ask(&mut self, places: &[usize], group: &[usize], at: usize, window: &[usize]) {
        if self.to_judge < MOST_AT_ONCE {
            self.to_judge += 1;
            self.needs.extend(window.iter().chain([&at]).map(|&at| places[group[at]]));
        }
    }
}

/// Places of the runs with the same key, in the order of the keys' first runs.
pub(super) fn grouped<K: PartialEq>(
    history: &[RunSummary],
    key: impl Fn(&RunSummary) -> K,
) -> Vec<Vec<usize>> {
    let mut groups: Vec<(K, Vec<usize>)> = Vec::new();
    for (place, run) in history.iter().enumerate() {
        let key = key(run);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, places)) => places.push(place),
            None => groups.push((key, vec![place])),
        }
    }
    groups.into_iter().map(|(_, places)| places).collect()
}
