//! Analysis of one cycle: condition, identify, verify, measure friction.

pub mod friction_choice;
pub mod load_iteration;
mod verdict;

use std::borrow::Cow;

use self::load_iteration::add_load_columns;
use self::verdict::{CycleRecord, identify_excitation, identifying_factors, judge_channels, judge_model};

use super::NumericsError;
use super::buffers::Buffers;
use super::diagnose::model::causes::{reason, sentences, without_consequences};
use super::diagnose::recording::diagnose_samples;
use super::diagnose::recording::view::DiagnoseSettings;
use super::diagnose::refusal;
use super::friction::points::plateaus::{FrictionPoints, friction_points};
use super::identify::carried_torque::subtract_carried;
use super::identify::channel_response::{ObservedCycle, channel_response};
use super::identify::filtered_columns::filtered_coulomb_columns;
use super::identify::joint_factors::{FactorColumns, Factored, FactoredRows, pack};
use super::identify::torque_noise::torque_noise;
use super::identify::verify::{torque_rmsd, warming_contrast};
use super::model::base_parameters::{BaseParameters, base_parameters};
use super::model::dynamics::DynamicModel;
use super::model::regressor::KeptColumns;
use super::signal::filter::{FilteredSignals, carried_cutoff, filter_signals_into};
use super::signal::restore::restore;
use super::signal::temperature::cycle_temperatures;
use super::signal::time_grid::sample_rate;
use super::spare_threads::SpareThreads;
use armwatch_model::analysis::finding::{ACCEPTED, Finding, FindingKinds, FindingSeverity};
use armwatch_model::analysis::refusal::{Channel, NO_POSITIONS, RefusalCause};
use armwatch_model::analysis::response::ChannelResponse;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{
    CycleAnalysis, CycleFactors, FrictionPoint, Identification, IdentifiedParameter, TorqueRmsd,
    WarmingContrast,
};
use armwatch_model::robot::Robot;
use armwatch_model::run::{Cycle, RunKind, Samples, Stage};

/// Robot with all that its analysis needs and no recording changes. Created once.
#[derive(Debug, Clone)]
pub struct Method {
    /// The arm.
    pub robot: Robot,
    /// Its base parameters.
    pub base: BaseParameters,
    /// The columns of each joint's factor.
    pub columns: FactorColumns,
    settings: AnalysisSettings,
}

impl Method {
    /// Analyses the robot's structure.
    ///
    /// # Errors
    /// Those of [`base_parameters`].
    pub fn new(robot: Robot, settings: AnalysisSettings) -> Result<Self, NumericsError> {
        let base = base_parameters(&robot)?;
        let columns = FactorColumns::new(&robot, &base);
        Ok(Self { robot, base, columns, settings })
    }

    /// The same settings for an arm with another structure.
    pub(crate) fn of_other(&self, robot: Robot, base: BaseParameters, columns: FactorColumns) -> Self {
        Self { robot, base, columns, settings: self.settings }
    }

    /// Settings of the analysis.
    pub(crate) fn settings(&self) -> &AnalysisSettings {
        &self.settings
    }
}

/// Number of cycles of a test whose response is computed. The response follows from the motion, which all cycles share;
/// two are used because the first may be refused.
const CYCLES_WITH_RESPONSE: u32 = 2;

/// Analyses one cycle. Never fails: the result contains the reason for each missing part.
#[must_use]
pub fn analyse_cycle(method: &Method, cycle: &Cycle) -> CycleAnalysis {
    let samples = &mut Cow::Borrowed(&cycle.samples);
    analysed(method, cycle.number, samples, &Buffers::default(), &SpareThreads::default())
}

/// Same as [`analyse_cycle`], with memory from `buffers` and with more threads while some are `spare`.
#[must_use]
pub fn analyse_cycle_in(
    method: &Method,
    cycle: Cycle,
    buffers: &Buffers,
    spare: &SpareThreads,
) -> CycleAnalysis {
    let mut samples = Cow::Owned(cycle.samples);
    let analysis = analysed(method, cycle.number, &mut samples, buffers, spare);
    give_back(samples.to_mut().channels_mut(), buffers);
    analysis
}

fn give_back<'a>(channels: impl Iterator<Item = &'a mut Vec<f64>>, buffers: &Buffers) {
    buffers.give_back(channels.map(std::mem::take));
}

fn analysed(
    method: &Method,
    number: u32,
    samples: &mut Cow<'_, Samples>,
    buffers: &Buffers,
    spare: &SpareThreads,
) -> CycleAnalysis {
    let restored = restore(&method.robot, samples);
    let mut analysis = unanalysed(method, number, samples);
    if without_positions(samples, &mut analysis) {
        return analysis;
    }
    analysis.remarks.extend(restored.remarks);
    analysis.remarks.extend(without_torque(&method.robot));
    if let Some(unsteady) = restored.unsteady {
        take_up(method, accepted(vec![unsteady], method.settings.accept), &mut analysis);
        if is_refused(&analysis) {
            // without valid times, other findings are meaningless
            return analysis;
        }
    }
    let mut filtered = match filter_signals_into(samples, analysis.cutoff, buffers, spare) {
        Ok(filtered) => filtered,
        Err(error) => {
            analysis.identification = Err(error.to_string());
            return analysis;
        }
    };
    analysis.sample_rate = filtered.sample_rate;
    note_gaps(samples, &filtered, &mut analysis.remarks);

    let recorded = &mut *samples;
    let (channels, mut filtered_coulomb_columns) = spare.both(
        || {
            let channels = diagnose_samples(&method.robot, recorded, &filtered, &DiagnoseSettings::default());
            if let Cow::Owned(samples) = recorded {
                // recorded positions and velocities are no longer needed
                give_back(samples.position.iter_mut().chain(samples.velocity.iter_mut().flatten()), buffers);
            }
            channels
        },
        || filtered_coulomb_columns(&method.robot, &filtered),
    );
    subtract_carried(&method.robot, samples, &mut filtered);
    if method.robot.has_load_friction() {
        let settled = add_load_columns(method, &filtered, samples, &mut filtered_coulomb_columns);
        analysis.remarks.extend(settled.remark());
    }
    let rows = FactoredRows {
        robot: &method.robot,
        columns: &method.columns,
        regressor_columns: &method.base.kept_columns,
        filtered: &filtered,
        filtered_coulomb_columns: &filtered_coulomb_columns,
        samples,
    };
    let factored = rows.factored(spare);
    let recorded = CycleRecord {
        samples,
        filtered: &filtered,
        filtered_coulomb_columns: &filtered_coulomb_columns,
        factored: &factored,
    };
    identify_and_verify(method, number, &recorded, channels, (spare, &mut analysis));
    give_back(filtered_coulomb_columns.iter_mut().map(|column| &mut column.values), buffers);
    filtered.end();
    analysis
}

/// Computes parameters, verification and friction from factors. `channels` are the findings about the recording, whose
/// recorded positions and velocities may already be released.
fn identify_and_verify(
    method: &Method,
    number: u32,
    recorded: &CycleRecord<'_>,
    channels: Vec<Finding>,
    (spare, analysis): (&SpareThreads, &mut CycleAnalysis),
) {
    let CycleRecord { samples, filtered, factored, .. } = *recorded;
    let accept = method.settings.accept;
    let mut level = None;
    let channels = judge_channels(method, recorded, channels, &mut level);
    take_up(method, accepted(channels, accept), analysis);
    // also for refused cycles: the fault may become known later, and `verify` compares them with other parameters
    keep_factors(method, factored, analysis);
    if is_refused(analysis) {
        // wrong channels give wrong friction, so nothing of this cycle may count
        return;
    }

    analysis.mean_speeds = mean_speeds(filtered);
    let factors = identifying_factors(method, factored);
    analysis.identification = identify_excitation(method, recorded, &factors);
    let found = analysis.identification.as_ref().ok();
    let (findings, explained) = spare.both(
        || {
            analysis
                .identification
                .as_ref()
                .map_or_else(|_| Vec::new(), |found| judge_model(method, recorded, (&factors, found), level))
        },
        || explained(method, number, recorded, found),
    );
    let had_model = found.is_some();
    take_up(method, accepted(findings, accept), analysis);
    // a model that is refused explains nothing
    let explained = match had_model && analysis.identification.is_err() {
        true => self::explained(method, number, recorded, None),
        false => explained,
    };
    if !explained.verification.is_empty() {
        let rows = recorded.excitation();
        analysis.torque_noise = torque_noise(samples, filtered, &rows, &explained.verification);
    }
    note_unshown(analysis);
    analysis.verification = explained.verification;
    analysis.warming_contrast = explained.warming_contrast;
    analysis.response = explained.response;
    analysis.friction_points = explained.friction.points;
    analysis.remarks.extend(explained.friction.remarks);
    if !samples.stage.contains(&Stage::Excitation) {
        analysis.identification = Err(without_excitation(&analysis.friction_points));
    }
    note_missing_stages(samples, &mut analysis.remarks);
}

/// Results that compare a model with its cycle.
#[derive(Default)]
struct ModelComparison {
    verification: Vec<TorqueRmsd>,
    warming_contrast: Vec<WarmingContrast>,
    response: Option<ChannelResponse>,
    friction: FrictionPoints,
}

/// Compares the model `found` with its cycle. Friction is measured without a model, too.
fn explained(
    method: &Method,
    number: u32,
    recorded: &CycleRecord<'_>,
    found: Option<&Identification>,
) -> ModelComparison {
    let CycleRecord { samples, filtered, filtered_coulomb_columns, factored } = *recorded;
    let theta: Option<Vec<f64>> = found.map(|found| found.parameters.iter().map(|p| p.value).collect());
    let theta = theta.as_deref();
    let model = found.map(|found| {
        let parameters = found.parameters.iter().map(|p| (p.id, p.value));
        DynamicModel::from_parameters(&method.robot, parameters)
    });
    let is_whole = |of: &&Identification| of.parameters.iter().all(IdentifiedParameter::is_shown);
    let response = found.filter(|_| number <= CYCLES_WITH_RESPONSE).filter(is_whole).and_then(|found| {
        let columns = KeptColumns::new(&method.base.kept_columns);
        let observed = ObservedCycle {
            robot: &method.robot,
            columns: &columns,
            filtered,
            filtered_coulomb_columns,
            samples,
        };
        channel_response(&observed, found, method.settings.estimator)
    });
    let of_factors = |theta| torque_rmsd(&method.columns, &factored.factors, theta);
    ModelComparison {
        verification: theta.map(of_factors).unwrap_or_default(),
        warming_contrast: theta
            .map(|theta| warming_contrast(&method.columns, factored, theta))
            .unwrap_or_default(),
        response,
        friction: friction_points(&method.robot, samples, filtered, model.as_ref()),
    }
}

/// Returns true if a recording has no positions, and then adds the missing channels and the size of its torques to
/// `analysis`.
pub(super) fn without_positions(samples: &Samples, analysis: &mut CycleAnalysis) -> bool {
    if samples.has_positions() {
        return false;
    }
    let rms = |torque: &Vec<f64>| {
        let squares: f64 = torque.iter().map(|torque| torque * torque).sum();
        format!("{:.4}", (squares / torque.len().max(1) as f64).sqrt())
    };
    let torques: Vec<String> = samples.torque.iter().map(rms).collect();
    analysis.remarks.push(format!("torques, root mean square of each joint: {} Nm (N)", torques.join(", ")));
    let reason = "the log has no positions: parameters and friction need the position of every joint beside its torque; \
                  temperatures are kept";
    analysis.refusal_causes = vec![RefusalCause {
        finding: NO_POSITIONS.into(),
        channel: Channel::Rows,
        joint: None,
        sentence: reason.into(),
    }];
    analysis.identification = Err(reason.into());
    true
}

/// Result of a cycle before anything is computed.
pub(super) fn unanalysed(method: &Method, number: u32, samples: &Samples) -> CycleAnalysis {
    let (temperatures, mut remarks) = cycle_temperatures(samples);
    let asked = method.settings.cutoff;
    let cutoff = sample_rate(&samples.time).map_or(asked, |rate| carried_cutoff(asked, rate));
    if cutoff < asked {
        remarks.push(lowered(asked, cutoff));
    }
    CycleAnalysis {
        cycle: number,
        start: samples.time.first().copied().unwrap_or(0.0),
        duration: duration(samples),
        rows: samples.rows(),
        sample_rate: 0.0,
        cutoff,
        estimator: method.settings.estimator,
        identification: Err(String::new()),
        refusal_causes: Vec::new(),
        verification: Vec::new(),
        warming_contrast: Vec::new(),
        torque_noise: Vec::new(),
        mean_speeds: Vec::new(),
        temperatures,
        friction_points: Vec::new(),
        factors: CycleFactors::default(),
        response: None,
        remarks,
        findings: Vec::new(),
        kind: RunKind::Test,
        production: None,
    }
}

/// Remark that the sample rate is too low for the requested cut-off.
fn lowered(asked: f64, cutoff: f64) -> String {
    format!(
        "the rows are too few for a low-pass at {asked} Hz, which needs four times as many a second; it is analysed \
         at {cutoff} Hz, and faster changes of the torque are not seen: record at {} Hz or more",
        4.0 * asked
    )
}

/// Mean speed of each joint over the rows that remain after the low-pass, rad/s (m/s), `[n]`.
fn mean_speeds(filtered: &FilteredSignals) -> Vec<f64> {
    let usable = || filtered.usable.iter().flat_map(Clone::clone);
    let rows = usable().count().max(1) as f64;
    filtered.qd.iter().map(|qd| usable().map(|row| qd[row].abs()).sum::<f64>() / rows).collect()
}

/// Lowers the severity of accepted findings that would refuse a cycle or make it doubtful: they only mark it.
fn accepted(findings: Vec<Finding>, accept: FindingKinds) -> Vec<Finding> {
    let weakened = |finding: Finding| match finding.severity {
        FindingSeverity::Refuse | FindingSeverity::Doubt if accept.contains(finding.kind) => {
            Finding { severity: FindingSeverity::Accepted, ..finding }
        }
        _ => finding,
    };
    findings.into_iter().map(weakened).collect()
}

fn is_refused(analysis: &CycleAnalysis) -> bool {
    analysis.findings.iter().any(|finding| finding.severity == FindingSeverity::Refuse)
}

/// Adds findings as remarks, or as the reason for a refusal.
fn take_up(method: &Method, findings: Vec<Finding>, analysis: &mut CycleAnalysis) {
    let known = std::mem::take(&mut analysis.findings);
    let all = without_consequences([known.clone(), findings].concat());
    let of = |severity: FindingSeverity| -> Vec<Finding> {
        let of = |finding: &&Finding| finding.severity == severity && !known.contains(finding);
        all.iter().filter(of).cloned().collect()
    };
    for (severity, mark) in [
        (FindingSeverity::Doubt, "doubtful: "),
        (FindingSeverity::Accepted, ACCEPTED),
        (FindingSeverity::Warn, ""),
    ] {
        let told = sentences(&method.robot, &of(severity)).into_iter();
        analysis.remarks.extend(told.map(|sentence| format!("{mark}{sentence}")));
    }
    let refused = of(FindingSeverity::Refuse);
    if !refused.is_empty() {
        analysis.identification = Err(reason(&method.robot, &refused));
    }
    analysis.findings = all;
    analysis.refusal_causes = refusal::causes(&analysis.findings);
}

fn duration(samples: &Samples) -> f64 {
    match (samples.time.first(), samples.time.last()) {
        (Some(first), Some(last)) => last - first,
        _ => 0.0,
    }
}

/// Reason why a cycle without excitation has no parameters, and its friction points.
fn without_excitation(points: &[FrictionPoint]) -> String {
    let mut joints: Vec<String> = points.iter().map(|point| point.joint.to_string()).collect();
    joints.dedup();
    let kept = match joints.len() {
        0 => String::new(),
        1 => format!("; the friction points of joint {} are kept", joints[0]),
        _ => format!("; the friction points of joints {} are kept", joints.join(", ")),
    };
    format!("the cycle has no excitation stage to identify parameters on{kept}")
}

pub(super) fn keep_factors(method: &Method, factored: &Factored, analysis: &mut CycleAnalysis) {
    let (factors, complete) = pack(&method.columns, &factored.factors);
    analysis.factors = factors;
    if !complete {
        analysis.remarks.push(
            "some rows hold values beyond any measure; their stages take no part in later verification"
                .into(),
        );
    }
}

pub(super) fn note_gaps(samples: &Samples, filtered: &FilteredSignals, remarks: &mut Vec<String>) {
    let (stretches, rows) = filtered.filtered();
    let lost = samples.rows() - rows;
    if stretches != 1 || lost > 0 {
        let parts = if stretches == 1 { "part" } else { "parts" };
        let longest = samples.time.windows(2).max_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])));
        let place = longest.map_or_else(String::new, |pair| {
            format!("; the longest lasts {:.3} s, from {:.3} s on", pair[1] - pair[0], pair[0])
        });
        remarks.push(format!(
            "time has gaps: {stretches} {parts} of the cycle can be filtered, {lost} rows in shorter ones are left \
             out{place}"
        ));
    }
}

/// Remark about joints without a recorded torque.
fn without_torque(robot: &Robot) -> Option<String> {
    let joints = robot.joint_indices().filter(|joint| !robot.joints[joint.index()].has_torque);
    let joints: Vec<String> = joints.map(|joint| joint.to_string()).collect();
    let s = if joints.len() == 1 { "" } else { "s" };
    (!joints.is_empty()).then(|| {
        format!(
            "the export has no torque of joint{s} {}: their friction is unknown, and their other parameters are known only \
             as far as the torques of the joints before show them",
            joints.join(", ")
        )
    })
}

/// Adds a remark about parameters that have no value because the motion does not distinguish them.
fn note_unshown(analysis: &mut CycleAnalysis) {
    let Ok(found) = &analysis.identification else { return };
    let unshown = found.parameters.iter().filter(|of| !of.is_shown());
    let names: Vec<String> = unshown.map(|of| of.id.to_string()).collect();
    if !names.is_empty() {
        analysis.remarks.push(format!(
            "the motion does not show {} of {} parameters on their own, and they have no value: {}; recordings of other \
             motion together may show them (armwatch identify)",
            names.len(),
            found.parameters.len(),
            names.join(", ")
        ));
    }
}

fn note_missing_stages(samples: &Samples, remarks: &mut Vec<String>) {
    for stage in Stage::ANALYSED {
        if !samples.stage.contains(&stage) {
            remarks.push(format!("the cycle has no {stage} stage"));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::lanes::run_as_on_any_processor;
    use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
    use armwatch_testing::cycle::cycle;
    use armwatch_testing::er3a;

    /// A cycle that is identified, and one whose torques no model explains.
    fn cycles() -> Vec<Cycle> {
        let samples = record_excitation(&er3a(), &ExactSettings::default()).expect("a recording");
        vec![Cycle { number: 1, samples }, cycle(2, 1500)]
    }

    /// Parameters of the other joints stay within their errors. Those that only joint 6 shows have no value.
    #[test]
    fn a_joint_without_torque_leaves_the_others_identified() {
        let whole = analyse_cycle(&method(), &cycles()[0]).identification.expect("parameters");
        let (mut robot, mut cycle) = (er3a(), cycles().remove(0));
        robot.joints[5].has_torque = false;
        cycle.samples.torque[5].fill(0.0);
        let method = Method::new(robot, AnalysisSettings::default()).expect("base parameters");
        let found = analyse_cycle(&method, &cycle);
        let part = found.identification.expect("parameters");
        let (shown, unshown): (Vec<_>, Vec<_>) =
            whole.parameters.iter().zip(&part.parameters).partition(|(_, part)| part.is_shown());
        let unshown: Vec<String> = unshown.iter().map(|(_, part)| part.id.to_string()).collect();
        assert!(shown.len() >= 50 && unshown.iter().any(|id| id.contains('6')), "{unshown:?}");
        for (whole, part) in shown {
            let error = whole.std_error.hypot(part.std_error).max(1e-9);
            assert!((whole.value - part.value).abs() < 5.0 * error, "{whole:?} {part:?}");
        }
        assert!(found.verification.iter().all(|of| of.joint.index() < 5) && !found.verification.is_empty());
        assert!(found.friction_points.iter().all(|of| of.joint.index() < 5));
        assert!(found.findings.is_empty(), "{:?}", found.findings);
        assert!(found.remarks.iter().any(|of| of.starts_with("the export has no torque of joint 6")));
    }

    fn method() -> Method {
        Method::new(er3a(), AnalysisSettings::default()).expect("base parameters")
    }

    #[test]
    fn memory_that_goes_round_changes_nothing() {
        let (method, buffers) = (method(), Buffers::going_round());
        for cycle in cycles().into_iter().chain(cycles()) {
            let expected = analyse_cycle(&method, &cycle);
            assert_eq!(analyse_cycle_in(&method, cycle, &buffers, &SpareThreads::default()), expected);
        }
    }

    #[test]
    fn results_do_not_depend_on_how_many_threads_are_spare() {
        let (method, buffers) = (method(), Buffers::going_round());
        // also a cycle that is refused, and one without excitation
        let mut odd = cycles();
        odd[0].samples.torque[1].iter_mut().for_each(|torque| *torque = -*torque);
        odd[1].samples.stage.iter_mut().for_each(|stage| *stage = Stage::Warming);
        for cycle in cycles().into_iter().chain(odd) {
            let expected = analyse_cycle(&method, &cycle);
            let lent = Arc::new(AtomicUsize::new(0));
            let count = Arc::clone(&lent);
            let spare = SpareThreads::lent_by(move |most, work| {
                count.fetch_add(most, Ordering::Relaxed);
                work();
            });
            assert_eq!(analyse_cycle_in(&method, cycle, &buffers, &spare), expected);
            assert!(lent.load(Ordering::Relaxed) > 5, "threads are asked for");
        }
    }

    /// Tests that run at the same time use either form and see no difference.
    #[test]
    fn results_do_not_depend_on_how_wide_the_registers_are() {
        let method = method();
        for cycle in cycles() {
            let wide = analyse_cycle(&method, &cycle);
            run_as_on_any_processor(true);
            let narrow = analyse_cycle(&method, &cycle);
            run_as_on_any_processor(false);
            assert_eq!(narrow, wide);
        }
    }
}
