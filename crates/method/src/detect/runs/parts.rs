//! The parts of a history: tests that are compared with each other, with the findings in their cycles.

use std::borrow::Cow;
use std::collections::BTreeMap;

use jiff::Timestamp;
use nalgebra::DVector;

use super::arm::cause::ArmCause;
use super::arm::{
    ArmEvidence, UsualArm, faults, least_advantage as least_advantage_of_arm, response_of, together,
};
use super::arm_detectors::common_change::{common_parts, thermal_parts};
use super::curve::causes::{RunCauses, UsualCurves, tests_of_usual};
use super::curve::run_cause::{RunCause, least_advantage};
use super::history::friction_history::{FrictionHistory, bound_spreads, learn_before_jumps};
use super::history::like_length::of_like_length;
use super::joint_detectors::warm_up::common_warm_up;
use super::judgement::{Frame, Judged, Judgement, Kept, content, key};
use super::series::friction_history;
use crate::detect::verdict::Verdict;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::robot::JointIndex;

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
    /// Cause of the difference between the common part of all joints and the usual one in each run, and the verdicts
    /// about their warm-up.
    pub(super) common_causes: Vec<Option<RunCause>>,
    pub(super) common_warm_up: Vec<Verdict>,
    /// By joint.
    pub(super) friction: Vec<FrictionHistory>,
}

/// Parts of a history, each evaluated once; most joints have the same.
pub(super) struct Parts<'h> {
    pub(super) history: &'h [RunSummary],
    pub(super) settings: &'h DetectSettings,
    pub(super) joints: usize,
    /// Least advantage of a clear cause of a curve, and of one of the arm.
    least: [f64; 2],
    /// By the places of the tests.
    found: Vec<(Vec<usize>, Part<'h>)>,
    kept: Option<&'h Kept>,
    /// Hash of the cycles and parameters of each test; empty if no judgements are kept.
    contents: Vec<u64>,
    pub(super) judged: Judged,
}

impl<'h> Parts<'h> {
    /// Parts of a history, with the judgements of earlier conclusions.
    pub(super) fn new(
        history: &'h [RunSummary],
        settings: &'h DetectSettings,
        kept: Option<&'h Kept>,
    ) -> Self {
        Self {
            history,
            settings,
            joints: history.iter().map(|run| run.joints.len()).max().unwrap_or(0),
            least: [least_advantage(history, settings), least_advantage_of_arm(history, settings)],
            found: Vec::new(),
            kept,
            contents: kept.map_or_else(Vec::new, |_| history.iter().map(content).collect()),
            judged: Judged::default(),
        }
    }

    /// Adds the part of these tests, unless it is known already.
    pub(super) fn add(&mut self, places: &[usize]) {
        if self.of(places).is_none() {
            let part = self.part(places);
            self.found.push((places.to_vec(), part));
        }
    }

    /// The part of these places.
    pub(super) fn of(&self, places: &[usize]) -> Option<&Part<'h>> {
        self.found.iter().find(|(known, _)| known == places).map(|(_, part)| part)
    }

    fn part(&mut self, places: &[usize]) -> Part<'h> {
        let runs: Cow<'h, [RunSummary]> = match places.len() == self.history.len() {
            true => Cow::Borrowed(self.history),
            false => places.iter().map(|&place| self.history[place].clone()).collect::<Vec<_>>().into(),
        };
        let judged = self.judgements(places, &runs);
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
        let thermal = thermal_parts(&friction, runs.len());
        friction.iter_mut().zip(&thermal).for_each(|(history, shared)| history.with_thermal(shared));
        bound_spreads(&mut friction);
        let moments: Vec<(i64, Timestamp)> = runs.iter().map(|run| (run.run_id, run.started_at)).collect();
        let faults = faults(&arm);
        let common_warm_up = common_warm_up(&common_causes, &faults, self.joints, &moments, self.settings);
        Part { runs, moments, arm, faults, causes, common_causes, common_warm_up, friction }
    }

    /// Findings in the cycles of each test.
    fn judgements(&mut self, places: &[usize], runs: &[RunSummary]) -> Vec<Judgement> {
        let baseline_runs = self.settings.baseline_runs;
        let first = tests_of_usual(runs, self.joints, baseline_runs);
        let groups: Vec<(Vec<usize>, Vec<&RunSummary>)> = of_like_length(runs)
            .into_iter()
            .map(|group| (group.clone(), group.iter().map(|&at| &runs[at]).collect()))
            .collect();
        let response = response_of(runs);
        let usual_arm = |(_, runs): &(Vec<usize>, Vec<&RunSummary>)| {
            let count = UsualArm::tests(runs, self.joints, baseline_runs);
            UsualArm::of(&runs[..count], response, self.joints, baseline_runs)
        };
        let frame = Frame {
            curves: UsualCurves::of(&runs[..first], self.joints, baseline_runs, self.least[0]),
            arms: groups.iter().map(usual_arm).collect(),
        };
        let hashes = self.kept.map_or_else(Vec::new, |kept| frame.hashes(kept));
        let mut found: Vec<(usize, Judgement)> = Vec::with_capacity(runs.len());
        for (number, (group, of_group)) in groups.iter().enumerate() {
            let arm = &frame.arms[number];
            let mut changes: BTreeMap<usize, Option<DVector<f64>>> = BTreeMap::new();
            for (at, run) in of_group.iter().enumerate() {
                let window = together(of_group, at);
                let content = |at: &usize| self.contents[places[group[*at]]];
                let key =
                    hashes.get(number).map(|of| key(*of, run, content(&at), window.iter().map(content)));
                let kept = key.and_then(|key| self.kept?.find(run.run_id, key));
                let judgement = if let Some(kept) = kept {
                    kept.clone().at_least(self.least[0])
                } else {
                    changes.retain(|at, _| window.contains(at));
                    for &at in &window {
                        changes.entry(at).or_insert_with(|| arm.change(of_group[at]));
                    }
                    let of_window = window.iter().map(|at| changes.get(at)?.as_ref()).collect();
                    self.judged.recomputed += 1;
                    Judgement { causes: frame.curves.causes(run), arm: arm.judge(run, of_window) }
                };
                if let Some(key) = key {
                    self.judged.add(run.run_id, key, &judgement);
                }
                found.push((group[at], judgement));
            }
        }
        found.sort_by_key(|(at, _)| *at);
        found.into_iter().map(|(_, judgement)| judgement).collect()
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
