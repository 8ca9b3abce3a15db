//! The page of a robot.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use serde_json::Value;

use super::cells::{change, count, figure, minute, number, percent, rows, table, text, whole, words};
use super::findings::{is_unsettled, made, of_joints, open_alarms, sentence, worst_first};
use crate::cli::alerts;
use crate::cli::context::CliError;
use crate::cli::shared::joints::{named, reasons};
use crate::cli::shared::life::{RobotLife, index_points};
use crate::cli::shared::plot::{index_limits, rmsd_limits};
use crate::report::figure::day;
use crate::report::friction_index::{IndexPanel, index_figure};
use crate::report::page::{Page, PageBlock, PageSection, TableCell};
use crate::report::rmsd::{RunRmsd, run_rmsd_figure};
use armwatch_config::Config;
use armwatch_method::statistics::descriptive::{mean, median, standard_deviation};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_store::{
    AnomalyRow, ConclusionFault, FaultState, HealthStatus, IndexRow, QuarantineRow, RunRow, SeriesRun, Store,
    ThermalSourceRow,
};

/// Tests in the table; pictures show all.
const TESTS_LISTED: usize = 20;

/// Multiple of the usual spread between tests beyond which a change of a parameter is marked.
const MARKED_SPREADS: f64 = 4.0;

/// Stored data of a robot.
struct RobotData<'a> {
    robot: &'a str,
    runs: Vec<&'a RunRow>,
    life: RobotLife,
    anomalies: Vec<AnomalyRow>,
    evidence: Vec<SeriesRun>,
    indices: Vec<IndexRow>,
    sources: Vec<ThermalSourceRow>,
    baselines: Vec<Value>,
    /// Statistics of parameters, by run.
    statistics: BTreeMap<i64, Vec<Value>>,
    units: Vec<Value>,
    model: String,
    twins: Vec<Twin>,
    quarantine: Vec<QuarantineRow>,
    fault: Option<ConclusionFault>,
}

/// Another arm of the same model with its latest values by joint.
struct Twin {
    robot: String,
    joints: BTreeMap<JointIndex, SeriesRun>,
}

impl<'a> RobotData<'a> {
    async fn read(
        store: &Store,
        robot: &'a str,
        runs: &'a [RunRow],
        now: Timestamp,
    ) -> Result<Self, CliError> {
        let life = RobotLife::read(store, robot).await?;
        let mut anomalies = alerts::anomaly_texts::all(store, now).await?;
        anomalies.retain(|row| row.robot == robot);
        let of_robot = [("robot", robot)];
        let baselines = rows(store, "baselines", &of_robot, "started_at").await?;
        let (model, others) = models(store, robot).await?;
        let mut twins = Vec::new();
        for other in others {
            let joints = latest(&store.evidence(&other).await?);
            twins.push(Twin { robot: other, joints });
        }
        let mut quarantine = store.faults().await?;
        quarantine.retain(|row| row.robot == robot && row.state == FaultState::Open);
        let faults = store.conclusion_faults().await?;
        let mut stored = Self {
            robot,
            runs: runs.iter().filter(|run| run.robot == robot).collect(),
            life,
            anomalies,
            evidence: store.evidence(robot).await?,
            indices: store.friction_indices(robot).await?,
            sources: store.thermal_sources(robot).await?,
            baselines,
            statistics: BTreeMap::new(),
            units: Vec::new(),
            model,
            twins,
            quarantine,
            fault: faults.into_iter().find(|fault| fault.robot == robot),
        };
        stored.read_parameters(store).await?;
        Ok(stored)
    }

    /// Statistics of the latest test and of those of the baselines in force.
    async fn read_parameters(&mut self, store: &Store) -> Result<(), CliError> {
        let Some(latest) = self.tests().last().map(|run| run.run_id) else { return Ok(()) };
        let wanted: BTreeSet<i64> = self.in_force().values().flatten().copied().chain([latest]).collect();
        for run in wanted {
            let of_run = [("run_id", run.to_string())];
            let of_run = of_run.each_ref().map(|(column, value)| (*column, value.as_str()));
            self.statistics.insert(run, rows(store, "parameter_statistics", &of_run, "joint").await?);
        }
        let (run, cycle) = (latest.to_string(), "1".to_string());
        let first = [("run_id", run.as_str()), ("cycle", cycle.as_str())];
        self.units = rows(store, "cycle_parameters", &first, "joint").await?;
        if self.units.is_empty() {
            // the first cycle was refused
            self.units = rows(store, "cycle_parameters", &first[..1], "joint").await?;
        }
        Ok(())
    }

    /// Complete tests, the oldest first.
    fn tests(&self) -> Vec<&'a RunRow> {
        let tests = self.runs.iter().copied();
        tests.filter(|run| run.status == RunStatus::Complete && run.kind == RunKind::Test).collect()
    }

    /// Runs of each joint's baseline in force, that of its latest epoch.
    fn in_force(&self) -> BTreeMap<i64, Vec<i64>> {
        let mut of_joint: BTreeMap<i64, (i64, Vec<i64>)> = BTreeMap::new();
        for row in &self.baselines {
            let (joint, epoch) = (count(row, "joint"), count(row, "epoch"));
            let held = of_joint.entry(joint).or_insert((epoch, Vec::new()));
            if epoch > held.0 {
                *held = (epoch, Vec::new());
            }
            if epoch == held.0 {
                held.1.push(count(row, "run_id"));
            }
        }
        of_joint.into_iter().map(|(joint, (_, runs))| (joint, runs)).collect()
    }
}

/// The model of a robot, and other robots of it.
async fn models(store: &Store, robot: &str) -> Result<(String, Vec<String>), CliError> {
    let list = store.robot_list().await.map_err(crate::cli::shared::rows::as_cli_error)?;
    let all: Vec<Value> = list.objects().collect();
    let model = all.iter().find(|row| text(row, "robot") == robot).map(|row| text(row, "model").to_owned());
    let model = model.unwrap_or_default();
    let others = all.iter().filter(|row| text(row, "robot") != robot && text(row, "model") == model);
    let others = others.map(|row| text(row, "robot").to_owned()).collect();
    Ok(if model.is_empty() { (model, Vec::new()) } else { (model, others) })
}

/// The latest values of each joint.
fn latest(evidence: &[SeriesRun]) -> BTreeMap<JointIndex, SeriesRun> {
    let mut joints: BTreeMap<JointIndex, SeriesRun> = BTreeMap::new();
    for of in evidence {
        match joints.get(&of.joint) {
            Some(known) if known.started_at > of.started_at => {}
            _ => drop(joints.insert(of.joint, of.clone())),
        }
    }
    joints
}

pub(super) async fn page(
    store: &Store,
    config: &Config,
    robot: &str,
    runs: &[RunRow],
    now: Timestamp,
) -> Result<Page, CliError> {
    let stored = RobotData::read(store, robot, runs, now).await?;
    let sections = vec![
        conclusions(&stored),
        history(&stored, config),
        parameters(&stored),
        twins(&stored),
        alarms(&stored),
        maintenance(&stored),
        unknowns(&stored),
    ];
    Ok(Page { title: robot.to_owned(), subtitle: made(now), sections, ..Page::default() })
}

fn conclusions(of: &RobotData<'_>) -> PageSection {
    let tests = of.tests();
    let fact = |name: &str, words: String| (name.to_owned(), words);
    let date = |run: Option<&&RunRow>| {
        run.map_or_else(|| "none".into(), |run| alerts::anomaly_texts::minute(run.started_at))
    };
    let result = of.life.health.iter().filter_map(|row| row.last_result_at).max();
    let cycles: u32 = tests.iter().map(|run| run.cycles).sum();
    let mut blocks = vec![PageBlock::Facts(vec![
        fact("model", if of.model.is_empty() { "not recognised".into() } else { of.model.clone() }),
        fact("complete tests", format!("{}, {cycles} cycles", tests.len())),
        fact("first test", date(tests.first())),
        fact("latest test", date(tests.last())),
        fact("latest result", result.map_or_else(|| "none".into(), alerts::anomaly_texts::minute)),
        fact("work entered", of.life.work.len().to_string()),
    ])];
    blocks.push(PageBlock::Text(in_words(of)));
    if !of.life.health.is_empty() {
        blocks.push(PageBlock::Findings(worst_first(of_joints(&of.life.health))));
    }
    let open: Vec<&AnomalyRow> = of.anomalies.iter().filter(|row| is_unsettled(row)).collect();
    if !open.is_empty() {
        blocks.push(PageBlock::Text("What is open, and what to check:".into()));
    }
    blocks.push(open_alarms(&open, "No alarm is open."));
    if let Some(fault) = &of.fault {
        let tries = fault.tries;
        blocks.push(PageBlock::Text(format!(
            "Nothing new can be concluded of this robot ({tries} attempts failed): {}",
            sentence(&fault.reason)
        )));
    }
    PageSection { heading: "Conclusions".into(), blocks }
}

/// The robot in a sentence.
fn in_words(of: &RobotData<'_>) -> String {
    if of.life.health.is_empty() {
        return "No complete test of this robot is stored, so nothing is known of its joints; the last part of this page \
                says what there is instead."
            .into();
    }
    let of_status = |status: HealthStatus| -> Vec<JointIndex> {
        of.life.health.iter().filter(|row| row.status == status).map(|row| row.joint).collect()
    };
    let said = [
        (HealthStatus::Critical, "inspect before the next shift"),
        (HealthStatus::Warning, "plan an inspection"),
        (HealthStatus::Overdue, "a test is overdue"),
        (HealthStatus::Unknown, "the latest test does not say how they are"),
        (HealthStatus::Learning, "too few tests for a baseline yet"),
        (HealthStatus::Ok, "as their baseline says"),
    ];
    let parts: Vec<String> = said
        .into_iter()
        .map(|(status, meaning)| (of_status(status), status, meaning))
        .filter(|(joints, ..)| !joints.is_empty())
        .map(|(joints, status, meaning)| {
            format!("{}: {} ({meaning})", named(&joints, of.life.health.len()), status.name())
        })
        .collect();
    sentence(&parts.join("; "))
}

fn history(of: &RobotData<'_>, config: &Config) -> PageSection {
    let joints: BTreeSet<JointIndex> = of.indices.iter().map(|row| row.joint).collect();
    let panel = |joint: JointIndex| {
        let rows: Vec<IndexRow> = of.indices.iter().filter(|row| row.joint == joint).cloned().collect();
        IndexPanel {
            title: format!("joint {joint}"),
            standing: of.life.standing(joint),
            runs: index_points(&rows),
            events: of.life.events_of(joint),
            alarms: of.life.alarms_of(joint),
        }
    };
    let mut blocks = Vec::new();
    if joints.is_empty() {
        blocks.push(PageBlock::Text(
            "No joint has a friction index: that takes as many tests as the baseline, of six cycles or more with friction \
             stages, in which friction falls while the joint warms. Warm friction as measured stands in the table."
                .into(),
        ));
    } else {
        let panels: Vec<IndexPanel> = joints.into_iter().map(panel).collect();
        blocks.push(PageBlock::Figure(Box::new(index_figure(
            &panels,
            index_limits(config),
            format!("{}: friction index by run", of.robot),
            "friction against the joint's own baseline at equal speed and thermal state; all joints have the same scale"
                .into(),
        ))));
    }
    let point = |run: &SeriesRun| RunRmsd {
        day: day(run.started_at),
        joint: run.joint,
        relative: run.moving_relative_rmsd.unwrap_or(f64::NAN),
    };
    let rmsd: Vec<RunRmsd> = of.evidence.iter().map(point).collect();
    if rmsd.iter().any(|run| run.relative.is_finite()) {
        blocks.push(PageBlock::Figure(Box::new(run_rmsd_figure(
            &rmsd,
            rmsd_limits(config),
            &of.life.events(),
            format!("{}: RMSD by run", of.robot),
            "estimated against measured torque of the excitation stages, rows in which the joint moves, as a fraction of \
             the measured torque's RMS"
                .into(),
        ))));
    }
    blocks.push(tests_table(of));
    PageSection { heading: "History".into(), blocks }
}

/// Table of the latest tests, the newest first.
fn tests_table(of: &RobotData<'_>) -> PageBlock {
    let joints: BTreeSet<JointIndex> = of.evidence.iter().map(|run| run.joint).collect();
    let tests = of.tests();
    let row = |run: &&RunRow| {
        let ours =
            |joint: JointIndex| of.evidence.iter().find(|of| of.run_id == run.run_id && of.joint == joint);
        let mut cells =
            vec![whole(run.run_id), words(alerts::anomaly_texts::minute(run.started_at)), whole(run.cycles)];
        cells.extend(joints.iter().map(|joint| {
            let found = ours(*joint);
            TableCell::Number(match found.and_then(|of| of.friction_index) {
                Some(index) => change(Some(index - 1.0)),
                None => found
                    .and_then(|of| of.warm_friction_nm)
                    .map_or_else(|| "-".into(), |warm| format!("{warm:.2} Nm")),
            })
        }));
        let relative: Vec<f64> =
            joints.iter().filter_map(|joint| ours(*joint).and_then(|of| of.moving_relative_rmsd)).collect();
        cells.push(TableCell::Number(percent(relative.into_iter().reduce(f64::max))));
        cells
    };
    let mut header = vec!["run".to_string(), "start".into(), "cycles".into()];
    header.extend(joints.iter().map(|joint| format!("joint {joint}")));
    header.push("largest RMSD".into());
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let caption = match tests.len() {
        few if few <= TESTS_LISTED => {
            "Tests: change of friction against the baseline, or warm friction".to_owned()
        }
        many => format!(
            "The latest {TESTS_LISTED} of {many} tests: change of friction against the baseline, or warm friction"
        ),
    };
    table(
        &caption,
        &header,
        tests.iter().rev().take(TESTS_LISTED).map(row).collect(),
        "No complete test of this robot is stored.",
    )
}

/// The statistics of a parameter in a run: after warm-up if the run has enough cycles.
fn statistic<'s>(statistics: &'s [Value], joint: i64, parameter: &str) -> Option<&'s Value> {
    let of_window = |window: &str| {
        statistics.iter().find(|row| {
            text(row, "window") == window
                && count(row, "joint") == joint
                && text(row, "parameter") == parameter
        })
    };
    of_window("after_5").or_else(|| of_window("all"))
}

fn parameters(of: &RobotData<'_>) -> PageSection {
    let heading = "Parameters against the baseline".to_owned();
    let Some(latest) = of.tests().last().map(|run| run.run_id) else {
        let nothing = "No complete test of this robot is stored, so it has no parameters.";
        return PageSection { heading, blocks: vec![PageBlock::Text(nothing.into())] };
    };
    let in_force = of.in_force();
    let mut seen = BTreeSet::new();
    let mut changed = 0_usize;
    let mut cells = Vec::new();
    for row in &of.units {
        let (joint, parameter) = (count(row, "joint"), text(row, "parameter"));
        if !seen.insert((joint, parameter.to_owned())) {
            continue;
        }
        let mean_of = |run: &i64| {
            let statistics = of.statistics.get(run)?;
            statistic(statistics, joint, parameter)?["mean"].as_f64()
        };
        let before: Vec<f64> = in_force
            .get(&joint)
            .into_iter()
            .flatten()
            .filter(|run| **run != latest)
            .filter_map(mean_of)
            .collect();
        let (now, usual, spread) = (mean_of(&latest), mean(&before), standard_deviation(&before));
        let difference = now.zip(usual).map(|(now, usual)| now - usual);
        let spreads =
            difference.zip(spread.filter(|spread| *spread > 0.0)).map(|(change, spread)| change / spread);
        let is_marked = spreads.is_some_and(|spreads| spreads.abs() > MARKED_SPREADS);
        changed += usize::from(is_marked);
        cells.push(vec![
            whole(joint),
            words(parameter),
            words(text(row, "unit")),
            number(usual),
            number(now),
            number(difference),
            number(spread),
            TableCell::Number(
                spreads.map_or_else(
                    || "-".into(),
                    |of| format!("{of:+.1}{}", if is_marked { " *" } else { "" }),
                ),
            ),
        ]);
    }
    if cells.is_empty() {
        let nothing = format!(
            "Run {latest}, the latest test, has no parameters, since no cycle of it gave any: there is nothing to compare \
             with the baseline. The page of an earlier run, `armwatch report RUN`, has those of that run."
        );
        return PageSection { heading, blocks: vec![PageBlock::Text(nothing)] };
    }
    let compared = format!("{changed} of {} parameters", cells.len());
    let header =
        ["joint", "parameter", "unit", "baseline", "latest test", "change", "spread", "change in spreads"];
    let caption =
        format!("Means over the cycles of run {latest} against those of the runs of each joint's baseline");
    let mut blocks = Vec::new();
    if cells.iter().any(|row| row[3] != number(None)) {
        blocks.push(PageBlock::Text(format!(
            "{compared} of run {latest} differ from their baseline by more than {MARKED_SPREADS} times the spread between \
             the baseline's own tests (marked *). That spread comes from few tests, so a mark is a place to look at and \
             no alarm; friction coefficients also change with the temperature of the arm."
        )));
    } else {
        blocks.push(PageBlock::Text(
            "There is no baseline of earlier tests to compare with yet: the table has the latest test alone."
                .into(),
        ));
    }
    blocks.push(table(&caption, &header, cells, "The latest test has no parameters."));
    PageSection { heading, blocks }
}

fn twins(of: &RobotData<'_>) -> PageSection {
    let heading = "Comparison with other arms of this model".to_owned();
    let twins: Vec<&Twin> = of.twins.iter().filter(|twin| !twin.joints.is_empty()).collect();
    if twins.is_empty() {
        let nothing = match of.model.is_empty() {
            true => "The model of this robot was not recognised, so it is compared with no other.".to_owned(),
            false => format!("No other robot of the model {} has a complete test.", of.model),
        };
        return PageSection { heading, blocks: vec![PageBlock::Text(nothing)] };
    }
    let names: Vec<&str> = twins.iter().map(|twin| twin.robot.as_str()).collect();
    let compared = |joint: JointIndex, own: Option<f64>, figure_of: fn(&SeriesRun) -> Option<f64>| {
        let others: Vec<f64> =
            twins.iter().filter_map(|twin| twin.joints.get(&joint).and_then(figure_of)).collect();
        let middle = median(&others);
        let ratio = own.zip(middle.filter(|middle| *middle > 0.0)).map(|(own, middle)| own / middle - 1.0);
        let low = others.iter().copied().reduce(f64::min);
        (middle, low.zip(others.iter().copied().reduce(f64::max)), change(ratio))
    };
    let row = |(joint, own): (&JointIndex, &SeriesRun)| {
        let (warm, warm_range, warm_change) =
            compared(*joint, own.warm_friction_nm, |of| of.warm_friction_nm);
        let (rmsd, _, _) = compared(*joint, own.moving_relative_rmsd, |of| of.moving_relative_rmsd);
        let range = warm_range.map_or_else(
            || "-".into(),
            |(low, high)| format!("{} to {}", figure(Some(low)), figure(Some(high))),
        );
        vec![
            whole(joint),
            number(own.warm_friction_nm),
            number(warm),
            TableCell::Number(range),
            TableCell::Number(warm_change),
            TableCell::Number(percent(own.moving_relative_rmsd)),
            TableCell::Number(percent(rmsd)),
        ]
    };
    let own = latest(&of.evidence);
    let header = [
        "joint",
        "warm friction, Nm",
        "median of the others, Nm",
        "their range, Nm",
        "difference",
        "RMSD",
        "median of the others",
    ];
    let text = format!(
        "Latest tests of {} other robot{} of the model {}: {}. Arms of a model differ by tens of per cent in friction when \
         new, so a difference alone is no fault; a joint that moves away from the others is one.",
        twins.len(),
        if twins.len() == 1 { "" } else { "s" },
        of.model,
        names.join(", ")
    );
    let rows = own.iter().map(row).collect();
    let table =
        table("Latest test next to those of the others", &header, rows, "No test of this robot has figures.");
    PageSection { heading, blocks: vec![PageBlock::Text(text), table] }
}

fn alarms(of: &RobotData<'_>) -> PageSection {
    let row = |row: &AnomalyRow| {
        vec![
            whole(row.anomaly_id),
            words(alerts::anomaly_texts::place(row)),
            words(row.kind.name()),
            words(row.severity.name()),
            words(alerts::anomaly_texts::state(row)),
            words(alerts::anomaly_texts::minute(row.onset_at.unwrap_or(row.first_seen_at))),
            words(alerts::anomaly_texts::minute(row.last_seen_at)),
            words(sentence(&row.message)),
        ]
    };
    let header = ["number", "place", "kind", "severity", "state", "since", "seen last", "what"];
    let rows = of.anomalies.iter().rev().map(row).collect();
    PageSection {
        heading: "Alarms".into(),
        blocks: vec![table(
            "Every alarm of this robot, the newest first",
            &header,
            rows,
            "There never was an alarm.",
        )],
    }
}

fn maintenance(of: &RobotData<'_>) -> PageSection {
    let row = |row: &armwatch_store::MaintenanceRow| {
        vec![
            words(alerts::anomaly_texts::minute(row.work.at)),
            words(row.work.joint.map_or_else(|| "whole arm".to_owned(), |joint| format!("joint {joint}"))),
            words(row.work.what.as_str()),
            words(row.work.who.as_deref().unwrap_or("not said")),
        ]
    };
    let rows = of.life.work.iter().rev().map(row).collect();
    let nothing = "No work was entered; `armwatch maintenance` enters it, and begins a new baseline.";
    PageSection {
        heading: "Maintenance".into(),
        blocks: vec![table(
            "Work on this robot, the newest first",
            &["when", "where", "what", "who"],
            rows,
            nothing,
        )],
    }
}

fn unknowns(of: &RobotData<'_>) -> PageSection {
    let mut unknown: Vec<Vec<TableCell>> = Vec::new();
    let mut say = |what: String, why: String| unknown.push(vec![words(what), words(sentence(&why))]);
    let joints = of.life.health.len();
    for status in HealthStatus::WORST_FIRST {
        let is_unknown =
            matches!(status, HealthStatus::Unknown | HealthStatus::Learning | HealthStatus::Overdue);
        let of_status = of.life.health.iter().filter(|row| row.status == status);
        let gaps = of_status.filter(|row| is_unknown || row.friction_index.is_none());
        let said = gaps.map(|row| (row.joint, row.reason.as_deref().unwrap_or("no reason is stored")));
        for alike in reasons(said) {
            say(format!("{}: {}", named(&alike.joints, joints), status.name()), alike.why.to_owned());
        }
    }
    let mapped: BTreeSet<JointIndex> = of.sources.iter().map(|source| source.joint).collect();
    let remarks: BTreeMap<i64, &str> = of
        .baselines
        .iter()
        .filter(|row| !text(row, "remark").is_empty())
        .map(|row| (count(row, "joint"), text(row, "remark")))
        .collect();
    let unmapped = of.life.health.iter().filter(|row| !mapped.contains(&row.joint)).map(|row| {
        let number = i64::try_from(row.joint.number()).unwrap_or_default();
        let few = "too few tests of six cycles or more with friction stages";
        (row.joint, remarks.get(&number).copied().unwrap_or(few))
    });
    for alike in reasons(unmapped) {
        say(format!("{}: friction at equal temperature", named(&alike.joints, joints)), alike.why.to_owned());
    }
    for source in &of.sources {
        for line in source.remarks.as_deref().unwrap_or_default().lines() {
            say(format!("joint {}: map of friction", source.joint), line.to_owned());
        }
    }
    for row in &of.quarantine {
        let place = row.line.map(|line| format!(", line {line}")).unwrap_or_default();
        say(format!("export {}{place}", row.source_name), format!("{}; {}", row.problem, row.remedy));
    }
    for run in of.runs.iter().filter(|run| run.status == RunStatus::Streaming) {
        let words = format!("{} cycles are stored; it is still being read", run.cycles);
        say(format!("run {}, {}", run.run_id, minute(&run.started_at.to_string())), words);
    }
    if let Some(fault) = &of.fault {
        say("conclusions".into(), fault.reason.clone());
    }
    let nothing = "Nothing: every joint has a result of the latest test, and no export of this robot waits in quarantine.";
    PageSection {
        heading: "Missing results and remarks".into(),
        blocks: vec![table("Gaps and remarks", &["what", "why"], unknown, nothing)],
    }
}
