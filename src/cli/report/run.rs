//! The page of a run.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use serde_json::Value;

use super::cells::{count, figure, minute, number, percent, rows, table, text, whole, words};
use super::findings::{is_unsettled, made, of_joints, of_run, open_alarms, sentence, worst_first};
use crate::cli::alerts;
use crate::cli::context::CliError;
use crate::cli::shared::life::RobotLife;
use crate::cli::shared::plot::rmsd_limits;
use crate::cli::shared::verification::verified_cycles;
use crate::report::friction::{CyclePoints, friction_figure, friction_speed_figure};
use crate::report::page::{Page, PageBlock, PageFinding, PageSection, TableCell};
use crate::report::residuals::{CycleResidual, residual_figure};
use crate::report::rmsd::{CycleVerification, rmsd_figure};
use armwatch_config::Config;
use armwatch_method::analyse_run::warm_up_fits;
use armwatch_model::analysis::measurements::CyclePoint;
use armwatch_model::analysis::{Decay, Estimate, FrictionPoint, Rmsd, RmsdScope, WarmUpFit};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::{RunKind, RunStatus, Stage};
use armwatch_store::{AlarmState, AnomalyRow, RunRow, Store};

/// Stored data of a run.
struct RunData {
    run: Value,
    cycles: Vec<Value>,
    verified: Vec<CycleVerification>,
    residuals: Vec<Value>,
    statistics: Vec<Value>,
    parameters: Vec<Value>,
    points: Vec<CyclePoint>,
    speed_fits: Vec<Value>,
}

impl RunData {
    async fn read(store: &Store, run: &RunRow) -> Result<Self, CliError> {
        let run_id = run.run_id.to_string();
        let of_run = [("run_id", run_id.as_str())];
        let cycles = rows(store, "cycles", &of_run, "cycle").await?;
        let last = last_cycle(&cycles).to_string();
        let of_cycle = [("run_id", run_id.as_str()), ("cycle", last.as_str())];
        Ok(Self {
            run: rows(store, "runs", &of_run, "run_id").await?.into_iter().next().unwrap_or_default(),
            verified: verified_cycles(store, run.run_id).await?,
            residuals: rows(store, "joint_residuals", &of_run, "cycle").await?,
            statistics: rows(store, "parameter_statistics", &of_run, "joint").await?,
            parameters: rows(store, "cycle_parameters", &of_cycle, "joint").await?,
            points: store.friction_points(run.run_id).await?,
            speed_fits: rows(store, "friction_speed_fits", &of_cycle, "joint").await?,
            cycles,
        })
    }
}

/// The last cycle with parameters, 0 if there is none: the arm is warmest there.
fn last_cycle(cycles: &[Value]) -> i64 {
    let usable = cycles.iter().filter(|row| text(row, "status") == "complete");
    usable.map(|row| count(row, "cycle")).max().unwrap_or_default()
}

pub(super) async fn page(
    store: &Store,
    config: &Config,
    run: &RunRow,
    runs: &[RunRow],
    now: Timestamp,
) -> Result<Page, CliError> {
    let stored = RunData::read(store, run).await?;
    let life = RobotLife::read(store, &run.robot).await?;
    let anomalies = alerts::anomaly_texts::all(store, now).await?;
    let seen: Vec<&AnomalyRow> = anomalies.iter().filter(|row| is_seen_in(row, run)).collect();
    let evidence = store.evidence(&run.robot).await?;
    let findings: Vec<PageFinding> = if is_latest(run, runs) {
        of_joints(&life.health)
    } else {
        evidence.iter().filter(|of| of.run_id == run.run_id).map(|of| of_run(of, &seen)).collect()
    };
    let name = format!("{}, run {}", run.robot, run.run_id);
    let sections = vec![
        conclusions(run, runs, &stored, findings, &seen),
        recorded(&stored),
        parameters(&stored),
        fit(&stored, config, &name),
        friction(&stored, &name),
        unknowns(
            run,
            &stored,
            evidence.iter().any(|of| of.run_id == run.run_id && of.friction_index.is_some()),
        ),
    ];
    Ok(Page {
        title: format!("{name}: {}", run.started_at.strftime("%-d %B %Y")),
        subtitle: made(now),
        sections,
        ..Page::default()
    })
}

/// Returns true if this is the robot's latest complete test, which its health describes.
fn is_latest(run: &RunRow, runs: &[RunRow]) -> bool {
    let tests = runs.iter().filter(|of| of.robot == run.robot);
    let complete = tests.filter(|of| of.status == RunStatus::Complete && of.kind == RunKind::Test);
    complete.max_by_key(|of| (of.started_at, of.run_id)).is_some_and(|of| of.run_id == run.run_id)
}

fn is_seen_in(row: &AnomalyRow, run: &RunRow) -> bool {
    row.robot == run.robot
        && row.state != AlarmState::FalseAlarm
        && row.first_seen_at <= run.started_at
        && run.started_at <= row.last_seen_at
}

fn conclusions(
    run: &RunRow,
    runs: &[RunRow],
    stored: &RunData,
    findings: Vec<PageFinding>,
    seen: &[&AnomalyRow],
) -> PageSection {
    let mut blocks = vec![facts(run, stored)];
    match run.status {
        RunStatus::Complete => {}
        RunStatus::Streaming => blocks.push(PageBlock::Text(
            "The run is still being read: what follows is of the cycles that are stored so far, and nothing is \
             concluded from it yet."
                .into(),
        )),
        RunStatus::Quarantined | RunStatus::Superseded | RunStatus::SetAside => {
            let reason = run.reason.as_deref().unwrap_or("no reason is stored");
            let status = run.status.name().replace('_', " ");
            blocks.push(PageBlock::Text(format!("The run is {status}: nothing is concluded from it. {}", sentence(reason))));
        }
    }
    if run.kind == RunKind::Production {
        blocks.push(PageBlock::Text(
            "The run is a log of production: it has no parameters of its own. The views production_checks and \
             production_trend compare it with tests."
                .into(),
        ));
    } else if findings.is_empty() {
        blocks.push(PageBlock::Text(
            "Nothing is known of any joint from this run: no cycle gave a result, or nothing has been concluded yet. \
             The last part of this page says why."
                .into(),
        ));
    } else {
        let latest = is_latest(run, runs);
        blocks.push(PageBlock::Text(match latest {
            true => "The robot's latest test: where its joints stand now.".to_owned(),
            false => "An earlier test: what it shows of each joint, and the alarms that were seen in it. The report of \
                      the robot says where its joints stand now."
                .to_owned(),
        }));
        blocks.push(PageBlock::Findings(worst_first(findings)));
    }
    let open: Vec<&AnomalyRow> = seen.iter().copied().filter(|row| is_unsettled(row)).collect();
    if run.status == RunStatus::Complete {
        blocks.push(open_alarms(&open, "No alarm that was seen in this run is still open."));
    }
    PageSection { heading: "Conclusions".into(), blocks }
}

fn facts(run: &RunRow, stored: &RunData) -> PageBlock {
    let usable = stored.cycles.iter().filter(|row| text(row, "status") == "complete").count();
    let seconds: f64 = stored.cycles.iter().filter_map(|row| row["duration_s"].as_f64()).sum();
    let fact = |name: &str, words: String| (name.to_owned(), words);
    let model = text(&stored.run, "model");
    let unknown = || "not known until the run is complete".to_owned();
    let rate = stored.run["sample_rate_hz"]
        .as_f64()
        .map_or_else(unknown, |rate| format!("{} Hz", figure(Some(rate))));
    PageBlock::Facts(vec![
        fact("robot", run.robot.clone()),
        fact("model", if model.is_empty() { "not recognised".into() } else { model.to_owned() }),
        fact("recorded", alerts::anomaly_texts::minute(run.started_at)),
        fact("export", run.source_name.clone()),
        fact("kind, status", format!("{}, {}", run.kind.name(), run.status.name())),
        fact("cycles", format!("{}, {usable} with parameters", stored.cycles.len())),
        fact("length of the cycles", format!("{:.0} min", seconds / 60.0)),
        fact("rows", run.rows.map_or_else(unknown, |rows| rows.to_string())),
        fact("sample rate", rate),
    ])
}

fn recorded(stored: &RunData) -> PageSection {
    let row = |of: &Value| {
        vec![
            whole(count(of, "cycle")),
            words(minute(text(of, "started_at"))),
            TableCell::Number(format!("{:.0}", of["duration_s"].as_f64().unwrap_or_default())),
            whole(count(of, "rows")),
            words(text(of, "status")),
            number(of["condition_number"].as_f64()),
            number(of["residual_std_nm"].as_f64()),
            words(if text(of, "reason").is_empty() { "" } else { text(of, "reason") }),
        ]
    };
    let header = [
        "cycle",
        "start",
        "length, s",
        "rows",
        "status",
        "condition number",
        "residual, Nm",
        "why it has no parameters",
    ];
    let rows = stored.cycles.iter().map(row).collect();
    PageSection {
        heading: "Recorded cycles".into(),
        blocks: vec![table("Cycles", &header, rows, "No cycle of the run is stored.")],
    }
}

fn parameters(stored: &RunData) -> PageSection {
    // after warm-up if there are enough cycles
    let window =
        if stored.statistics.iter().any(|row| text(row, "window") == "after_5") { "after_5" } else { "all" };
    let mean = |of: &Value| {
        let same = |row: &&Value| {
            text(row, "window") == window
                && row["joint"] == of["joint"]
                && row["parameter"] == of["parameter"]
        };
        stored.statistics.iter().find(same)
    };
    let row = |of: &Value| {
        let statistics = mean(of);
        let grouping = text(of, "grouping");
        vec![
            whole(count(of, "joint")),
            words(text(of, "parameter")),
            words(if grouping == text(of, "parameter") { "" } else { grouping }),
            words(text(of, "unit")),
            number(of["value"].as_f64()),
            number(of["std_error"].as_f64()),
            TableCell::Number(format!(
                "{} to {}",
                figure(of["interval_low"].as_f64()),
                figure(of["interval_high"].as_f64())
            )),
            TableCell::Number(percent(of["relative_std_error"].as_f64())),
            number(statistics.and_then(|row| row["mean"].as_f64())),
            number(statistics.and_then(|row| row["sdv"].as_f64())),
        ]
    };
    let over = if window == "after_5" { "mean, cycles from 6" } else { "mean, all cycles" };
    let header = [
        "joint",
        "parameter",
        "stands for",
        "unit",
        "value",
        "std. error",
        "95 % interval",
        "relative error",
        over,
        "spread",
    ];
    let rows: Vec<Vec<TableCell>> = stored.parameters.iter().map(row).collect();
    let caption =
        format!("Base parameters of cycle {}, the last with parameters", last_cycle(&stored.cycles));
    PageSection {
        heading: "Base parameters".into(),
        blocks: vec![
            PageBlock::Note(
                "Standard errors come from the scatter of blocks of rows. A relative error above 50 % says that this \
                 motion does not show the parameter. Spread is the standard deviation between cycles."
                    .into(),
            ),
            table(&caption, &header, rows, "No cycle of the run has parameters."),
        ],
    }
}

/// Columns of the table of RMSD.
const SCOPES: [(&str, RmsdScope); 4] = [
    ("excitation", RmsdScope::Stage(Stage::Excitation)),
    ("friction", RmsdScope::Stage(Stage::Friction)),
    ("warming", RmsdScope::Stage(Stage::Warming)),
    ("whole cycle", RmsdScope::WholeCycle),
];

fn fit(stored: &RunData, config: &Config, name: &str) -> PageSection {
    let residual = |row: &Value| {
        Some(CycleResidual {
            cycle: u32::try_from(count(row, "cycle")).ok()?,
            joint: JointIndex::from_number(usize::try_from(count(row, "joint")).ok()?)?,
            residual_nm: row["residual_std_nm"].as_f64().unwrap_or(f64::NAN),
        })
    };
    let residuals: Vec<CycleResidual> = stored.residuals.iter().filter_map(residual).collect();
    let limits = rmsd_limits(config);
    let rmsd = rmsd_figure(
        &stored.verified,
        limits,
        format!("{name}: RMSD by cycle"),
        "estimated against measured torque with each cycle's own parameters, rows in which the joint moves, as a fraction \
         of the measured torque's RMS; logarithmic scale"
            .into(),
    );
    let left = residual_figure(
        &residuals,
        format!("{name}: residual of the identification by cycle"),
        "torque that identification leaves unexplained: excitation stage, rows in which the joint moves"
            .into(),
    );
    let mut blocks = Vec::new();
    if rmsd.panels.is_empty() {
        blocks.push(PageBlock::Text(
            "No cycle of the run has parameters that could be compared with its torques.".into(),
        ));
    } else {
        blocks.push(PageBlock::Figure(Box::new(rmsd)));
        blocks.push(rmsd_table(&stored.verified));
    }
    if !left.panels.is_empty() {
        blocks.push(PageBlock::Figure(Box::new(left)));
    }
    PageSection { heading: "Model fit".into(), blocks }
}

fn rmsd_table(cycles: &[CycleVerification]) -> PageBlock {
    let joints: BTreeSet<JointIndex> = cycles.iter().flat_map(|of| &of.rmsd).map(|of| of.joint).collect();
    let mean = |joint: JointIndex, of: &dyn Fn(&CycleVerification, JointIndex) -> Option<Rmsd>| {
        let known: Vec<f64> = cycles
            .iter()
            .filter_map(|cycle| of(cycle, joint))
            .filter(|rmsd| rmsd.samples > 0 && rmsd.relative.is_finite())
            .map(|rmsd| rmsd.relative)
            .collect();
        TableCell::Number(percent(
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64),
        ))
    };
    let row = |joint: JointIndex| {
        let mut cells = vec![whole(joint)];
        for (_, scope) in SCOPES {
            cells.push(mean(joint, &|cycle, joint| {
                cycle.rmsd.iter().find(|of| of.joint == joint && of.scope == scope).map(|of| of.moving_rows)
            }));
        }
        let contrast =
            |cycle: &CycleVerification, joint| cycle.contrast.iter().find(|of| of.joint == joint).copied();
        cells.push(mean(joint, &|cycle, joint| contrast(cycle, joint).map(|of| of.start.moving_rows)));
        cells.push(mean(joint, &|cycle, joint| contrast(cycle, joint).map(|of| of.end.moving_rows)));
        cells
    };
    let header: Vec<&str> = ["joint"]
        .into_iter()
        .chain(SCOPES.map(|(name, _)| name))
        .chain(["first third of warming", "last third of warming"])
        .collect();
    let caption = "Relative RMSD in motion by stage, mean over the cycles";
    table(caption, &header, joints.into_iter().map(row).collect(), "No cycle has an RMSD.")
}

fn friction(stored: &RunData, name: &str) -> PageSection {
    let heading = "Friction".to_owned();
    if stored.points.is_empty() {
        let words = "No cycle of the run has a friction stage with plateaus of constant speed, so there are no friction \
                     points, no warm-up curves and no friction over speed.";
        return PageSection { heading, blocks: vec![PageBlock::Text(words.into())] };
    }
    let bare: Vec<FrictionPoint> = stored.points.iter().map(|of| of.point).collect();
    let fits = warm_up_fits(&bare);
    let mut by_cycle: BTreeMap<u32, Vec<FrictionPoint>> = BTreeMap::new();
    for of in &stored.points {
        by_cycle.entry(of.cycle).or_default().push(of.point);
    }
    let cycles: Vec<CyclePoints> = by_cycle
        .iter()
        .map(|(cycle, points)| CyclePoints { label: format!("cycle {cycle}"), points: points.clone() })
        .collect();
    let plateaus = "mean friction on constant-speed plateaus, gravity removed";
    let over_time = friction_figure(
        &bare,
        &fits,
        format!("{name}: friction over time"),
        format!(
            "{plateaus}; curves a + b exp(-t/t1) + c exp(-t/t2) fitted as far as the points support them"
        ),
    );
    let over_speed = friction_speed_figure(
        &cycles,
        format!("{name}: friction over speed, cold to warm"),
        format!("{plateaus}, both directions together"),
    );
    let blocks = vec![
        PageBlock::Figure(Box::new(over_time)),
        warm_up_table(&fits),
        PageBlock::Figure(Box::new(over_speed)),
        speed_table(&by_cycle),
        speed_fit_table(&stored.speed_fits, last_cycle(&stored.cycles)),
    ];
    PageSection { heading, blocks }
}

fn warm_up_table(fits: &[WarmUpFit]) -> PageBlock {
    let estimate = |of: Estimate| {
        TableCell::Number(format!("{} ({})", figure(Some(of.value)), figure(Some(of.std_error))))
    };
    let decay = |of: &Option<Decay>| match of {
        Some(of) => [estimate(of.amplitude), estimate(of.time_constant)],
        None => [TableCell::Number("-".into()), TableCell::Number("-".into())],
    };
    let row = |fit: &WarmUpFit| {
        let mut cells =
            vec![whole(fit.joint), TableCell::Number(format!("{:.0} %", 100.0 * fit.speed_fraction))];
        cells.extend([words(fit.model.name()), estimate(fit.a)]);
        cells.extend(decay(&fit.slow).into_iter().chain(decay(&fit.fast)));
        cells.extend([number(Some(fit.rmsd)), whole(fit.samples)]);
        cells
    };
    let header =
        ["joint", "speed", "form", "a, Nm", "b, Nm", "t1, min", "c, Nm", "t2, min", "RMSD, Nm", "points"];
    let caption = "Warm-up curves a + b exp(-t/t1) + c exp(-t/t2), standard errors in brackets";
    table(caption, &header, fits.iter().map(row).collect(), "Too few friction points for warm-up curves.")
}

/// Friction of the first and the last cycle by speed.
fn speed_table(by_cycle: &BTreeMap<u32, Vec<FrictionPoint>>) -> PageBlock {
    let (Some((first, cold)), Some((last, warm))) = (by_cycle.first_key_value(), by_cycle.last_key_value())
    else {
        return PageBlock::Note("No friction points.".into());
    };
    let levels: BTreeSet<(usize, u64)> = by_cycle
        .values()
        .flatten()
        .map(|point| (point.joint.number(), point.speed_fraction.to_bits()))
        .collect();
    let mean = |points: &[FrictionPoint],
                level: (usize, u64),
                direction: Option<i8>,
                of: fn(&FrictionPoint) -> f64| {
        let ours =
            points.iter().filter(|point| (point.joint.number(), point.speed_fraction.to_bits()) == level);
        let values: Vec<f64> =
            ours.filter(|point| direction.is_none_or(|wanted| wanted == point.direction)).map(of).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let torque = |point: &FrictionPoint| point.torque.abs();
    let row = |level: (usize, u64)| {
        vec![
            whole(level.0),
            TableCell::Number(format!("{:.0} %", 100.0 * f64::from_bits(level.1))),
            number(mean(warm, level, None, |point| point.speed)),
            number(mean(cold, level, None, torque)),
            number(mean(warm, level, None, torque)),
            number(mean(warm, level, Some(1), torque)),
            number(mean(warm, level, Some(-1), torque)),
        ]
    };
    let (cold_name, warm_name) = (format!("cycle {first}, Nm"), format!("cycle {last}, Nm"));
    let (forwards, backwards) = (format!("cycle {last} forwards, Nm"), format!("cycle {last} backwards, Nm"));
    let header = ["joint", "speed", "rad/s", &cold_name, &warm_name, &forwards, &backwards];
    let caption = "Friction by speed, of the first and the last cycle with friction points";
    table(caption, &header, levels.into_iter().map(row).collect(), "No friction points.")
}

fn speed_fit_table(fits: &[Value], cycle: i64) -> PageBlock {
    let mut by_fit: BTreeMap<(i64, i64), Vec<&Value>> = BTreeMap::new();
    for row in fits {
        by_fit.entry((count(row, "joint"), -count(row, "direction"))).or_default().push(row);
    }
    let row = |((joint, direction), rows): ((i64, i64), Vec<&Value>)| {
        let coefficient = |row: &&Value| {
            let error =
                if count(row, "at_bound") == 1 { "held".into() } else { figure(row["std_error"].as_f64()) };
            format!("{} = {} ({error})", text(row, "coefficient"), figure(row["value"].as_f64()))
        };
        let first = rows[0];
        vec![
            whole(joint),
            words(if direction < 0 { "forwards" } else { "backwards" }),
            words(text(first, "model").replace('_', " ")),
            words(rows.iter().map(coefficient).collect::<Vec<_>>().join(", ")),
            TableCell::Number(format!(
                "{} to {}",
                figure(first["slowest_rad_s"].as_f64()),
                figure(first["fastest_rad_s"].as_f64())
            )),
            number(first["rmsd_nm"].as_f64()),
        ]
    };
    let header = [
        "joint",
        "direction",
        "form",
        "coefficients (standard errors), Nm and rad/s",
        "speeds, rad/s",
        "RMSD, Nm",
    ];
    let caption = format!("Friction over speed of cycle {cycle}");
    let nothing = "Friction over speed was not fitted: too few speeds, or conclusions are not drawn yet.";
    table(&caption, &header, by_fit.into_iter().map(row).collect(), nothing)
}

fn unknowns(run: &RunRow, stored: &RunData, has_index: bool) -> PageSection {
    let mut unknown: Vec<Vec<TableCell>> = Vec::new();
    let mut say = |what: String, why: &str| unknown.push(vec![words(what), words(sentence(why))]);
    let cycles = |numbers: &[i64]| match numbers {
        [one] => format!("cycle {one}"),
        many => format!("cycles {}", many.iter().map(i64::to_string).collect::<Vec<_>>().join(", ")),
    };
    for column in ["reason", "remarks"] {
        let mut said: BTreeMap<&str, Vec<i64>> = BTreeMap::new();
        for row in &stored.cycles {
            for line in text(row, column).lines().filter(|line| !line.trim().is_empty()) {
                said.entry(line).or_default().push(count(row, "cycle"));
            }
        }
        for (why, numbers) in said {
            let of = if column == "reason" { "parameters of" } else { "remark on" };
            say(format!("{of} {}", cycles(&numbers)), why);
        }
    }
    if run.kind == RunKind::Test && run.status == RunStatus::Complete && !has_index {
        say(
            "friction index".into(),
            "a run has one once its joints have a baseline and a map of friction: as many runs as the baseline, of six \
             cycles or more with friction stages",
        );
    }
    let skipped = count(&stored.run, "rows_skipped");
    if skipped > 0 {
        say(format!("{skipped} rows"), "they were not understood and were skipped, as the layout allows");
    }
    if let Some(reason) = &run.reason {
        say("the run".into(), reason);
    }
    let nothing = "Nothing: every cycle gave parameters, and there is no remark on any.";
    PageSection {
        heading: "Missing results and remarks".into(),
        blocks: vec![table("Gaps and remarks", &["what", "why"], unknown, nothing)],
    }
}
