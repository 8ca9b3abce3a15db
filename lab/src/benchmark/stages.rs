//! `armwatch-lab benchmark stages`: processor time of each stage of processing a cycle, compared with the
//! straightforward form of the same work if there is one.

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;

use clap::Args;
use serde_json::json;

use super::throughput::simulated;
use crate::context::LabOptions;
use crate::plain_read::read_with_polars;
use armwatch::cli::context::{CliError, EXIT_DONE};
use armwatch::cli::shared::output;
use armwatch::pipeline::take::cycles::read_cycle;
use armwatch_config::{Config, Layout};
use armwatch_ingest::bytes::fingerprint::fingerprint;
use armwatch_ingest::bytes::source;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_method::NumericsError;
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::diagnose::model::doubt::{DoubtSettings, JudgedCycle, diagnose_description};
use armwatch_method::diagnose::recording::diagnose_samples;
use armwatch_method::diagnose::recording::view::DiagnoseSettings;
use armwatch_method::friction::points::plateaus::friction_points;
use armwatch_method::identify::channel_response::{ObservedCycle, channel_response};
use armwatch_method::identify::cycle::identify_rows;
use armwatch_method::identify::cycle_rows::CycleRows;
use armwatch_method::identify::filtered_columns::{
    FilteredColumn, filtered_coulomb_columns, write_filtered_columns,
};
use armwatch_method::identify::joint_factors::{embedded, factor_cycle, used_for_identification};
use armwatch_method::lanes::{self, LANES, Lanes};
use armwatch_method::least_squares::dense::dense_factor;
use armwatch_method::least_squares::factor::{FactorBuilder, TriangularFactor};
use armwatch_method::model::regressor::{KeptColumns, Regressor, joint_torque_regressor};
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes, joint_torque_regressors};
use armwatch_method::signal::filter::{FilteredSignals, carried_cutoff, filter_signals};
use armwatch_method::signal::time_grid::sample_rate;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_model::run::{Cycle, Stage as StageOfCycle};

/// A stage is repeated until it has taken this long, s: the system counts processor time in steps of 4 ms.
const LEAST_S: f64 = 0.2;

#[derive(Debug, Args)]
#[command(after_help = "\
Simulates one cycle, takes it through the stages of `ingest` one by one in this process, and prints the processor time
of each, the least of all turns. `reference_cpu_s` is the straightforward form of the same work, where the program has
it: polars alone, the regressor of one instant, dense QR. `mflop` are additions and multiplications counted from the
equations; divisions, roots and sines are left out.

Examples:
  armwatch-lab benchmark stages
  armwatch-lab benchmark stages --rate-hz 50 --rounds 1
  armwatch-lab benchmark stages --any-processor
  armwatch-lab benchmark stages --json")]
pub(crate) struct StagesArgs {
    /// Rows a second, Hz
    #[arg(long, default_value_t = 250.0)]
    rate_hz: f64,
    /// Turns, of which the least counts
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=20))]
    rounds: u32,
    /// Let the program's own kernels run as on a processor without 256-bit registers
    #[arg(long)]
    any_processor: bool,
}

/// Cost of a stage.
#[derive(Debug)]
struct StageTiming {
    name: &'static str,
    cpu_s: f64,
    reference_cpu_s: Option<f64>,
    /// Additions and multiplications.
    flops: Option<f64>,
}

pub(crate) fn stages(global: &LabOptions, args: &StagesArgs) -> Result<u8, CliError> {
    let folder =
        tempfile::tempdir().map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    let export = simulated(folder.path(), 1, args.rate_hz)?;
    let config = Config::shipped()?;
    let entry = config.fleet.first();
    let entry =
        entry.ok_or_else(|| CliError::Internal("the shipped configuration describes no robot".into()))?;
    let robot = Robot::clone(&entry.description);
    let cycle = read_cycle(&export, &entry.layout, &robot, 1).map_err(not_read)?;
    let cycle = cycle.ok_or_else(|| CliError::Internal("the simulated export has no cycle".into()))?;
    let method = Method::new(robot, AnalysisSettings::default()).map_err(not_computed)?;
    if args.any_processor {
        lanes::run_as_on_any_processor(true);
    }

    let mut found = of_reading(&export, &entry.layout, &method.robot, args.rounds)?;
    found.extend(of_analysis(&method, &cycle, args.rounds)?);
    report(global, cycle.samples.rows(), &found);
    Ok(EXIT_DONE)
}

fn report(global: &LabOptions, rows: usize, stages: &[StageTiming]) {
    let rate = |stage: &StageTiming| stage.flops.map(|flops| flops / stage.cpu_s / 1e9);
    if global.json {
        let stages: Vec<_> = stages
            .iter()
            .map(|of| {
                json!({
                    "stage": of.name, "cpu_s": of.cpu_s, "reference_cpu_s": of.reference_cpu_s,
                    "mflop": of.flops.map(|flops| flops / 1e6), "gflop_per_s": rate(of),
                })
            })
            .collect();
        return output::json(&json!({"rows": rows, "stages": stages}));
    }
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.decimals$}"))
    };
    let line = |of: &StageTiming| {
        vec![
            of.name.to_owned(),
            number(Some(of.cpu_s), 4),
            number(of.reference_cpu_s, 4),
            number(of.flops.map(|flops| flops / 1e6), 0),
            number(rate(of), 1),
        ]
    };
    output::line(&format!("one cycle of {rows} rows"));
    let header = ["stage", "cpu_s", "reference_cpu_s", "mflop", "gflop_per_s"];
    output::line(&output::table(&header, &stages.iter().map(line).collect::<Vec<_>>()));
}

/// From bytes to channels in SI units.
fn of_reading(
    export: &Path,
    layout: &Layout,
    robot: &Robot,
    rounds: u32,
) -> Result<Vec<StageTiming>, CliError> {
    let read_rows = || -> Result<usize, Rejection> {
        let bytes = source::open(export)?;
        let mut rows = 0;
        for chunk in ExportReader::new(bytes, export, layout, robot, ReadOptions::default())? {
            rows += chunk?.samples.rows();
        }
        Ok(rows)
    };
    read_rows().map_err(not_read)?;
    read_with_polars(export).map_err(|error| CliError::Usage(error.to_string()))?;
    let stage = |name, cpu_s, reference_cpu_s| StageTiming { name, cpu_s, reference_cpu_s, flops: None };
    Ok(vec![
        stage("hash of the file", least(rounds, || fingerprint(export)), None),
        stage(
            "lines to channels; polars alone",
            least(rounds, read_rows),
            Some(least(rounds, || read_with_polars(export))),
        ),
    ])
}

/// From channels to the results of a cycle.
fn of_analysis(method: &Method, cycle: &Cycle, rounds: u32) -> Result<Vec<StageTiming>, CliError> {
    let (robot, samples) = (&method.robot, &cycle.samples);
    let n = robot.joint_count();
    let kept = &method.base.kept_columns;
    let asked = AnalysisSettings::default().cutoff;
    let cutoff = sample_rate(&samples.time).map_or(asked, |rate| carried_cutoff(asked, rate));
    let filtered = filter_signals(samples, cutoff).map_err(not_computed)?;
    let jumps = filtered_coulomb_columns(robot, &filtered);
    let factored = factor_cycle(robot, &method.columns, kept, &filtered, &jumps, samples);
    let observed: Vec<usize> = filtered.observed_rows().collect();
    let mut found = Vec::new();
    let mut add = |name, cpu_s, reference_cpu_s, flops| {
        found.push(StageTiming { name, cpu_s, reference_cpu_s, flops });
    };

    let (rows, channels) = (samples.rows() as f64, 3 * n);
    let flops = rows * (channels as f64 * LOW_PASS_FLOPS + n as f64 * DERIVATIVE_FLOPS);
    add("low-pass, derivatives", least(rounds, || filter_signals(samples, cutoff)), None, Some(flops));
    let settings = DiagnoseSettings::default();
    add(
        "findings about the recording",
        least(rounds, || diagnose_samples(robot, samples, &filtered, &settings)),
        None,
        None,
    );
    add(
        "low-pass of columns that jump",
        least(rounds, || filtered_coulomb_columns(robot, &filtered)),
        None,
        Some(rows * jumps.len() as f64 * LOW_PASS_FLOPS),
    );
    add(
        "regressor of observed rows",
        least(rounds, || regressors_in_lanes(robot, &filtered, &observed)),
        Some(least(rounds, || regressors_one_by_one(robot, &filtered, &observed))),
        Some(observed.len() as f64 * regressor_flops(n)),
    );
    let first = method.columns.places(JointIndex::new(0)).iter().map(|&place| kept[place]);
    let columns = columns_of_first_joint(robot, &filtered, &jumps, &observed, &first.collect::<Vec<usize>>());
    add(
        "QR of the first joint's rows",
        least(rounds, || structured_factor(&columns)),
        Some(least(rounds, || dense_factor(&columns))),
        Some(qr_flops(observed.len(), columns.len())),
    );
    let of_factors = factored.factors.iter().map(|of| qr_flops(of.factor.rows(), of.factor.columns() + 1));
    add(
        "triangular factors, with the regressor",
        least(rounds, || factor_cycle(robot, &method.columns, kept, &filtered, &jumps, samples)),
        None,
        Some(of_factors.sum::<f64>() + observed.len() as f64 * regressor_flops(n)),
    );
    let chosen = factored.factors.iter().filter(|of| used_for_identification(of.stage, of.motion));
    let factors = embedded(&method.columns, chosen);
    let kept_columns = KeptColumns::new(kept);
    let source = CycleRows::new(robot, &kept_columns, &filtered, &jumps, samples);
    let estimator = AnalysisSettings::default().estimator;
    add(
        "parameters and their errors",
        least(rounds, || identify_rows(&method.base.kept, &factors, &source, estimator)),
        None,
        None,
    );
    let analysis = analyse_cycle(method, cycle);
    if let Ok(identified) = &analysis.identification {
        let excitation = |row: &usize| samples.stage[*row] == StageOfCycle::Excitation;
        let usable = filtered.usable.iter().flat_map(Clone::clone);
        let excitation: Vec<usize> = usable.filter(excitation).collect();
        let judged = JudgedCycle {
            robot,
            columns: &method.columns,
            kept_columns: kept,
            filtered: &filtered,
            filtered_coulomb_columns: &jumps,
            excitation: &excitation,
            identified,
            verification: &analysis.verification,
        };
        let doubts = || diagnose_description(&judged, &[], &DoubtSettings::default());
        add("late torques, test of the description", least(rounds, doubts), None, None);
        let observed = ObservedCycle {
            robot,
            columns: &kept_columns,
            filtered: &filtered,
            filtered_coulomb_columns: &jumps,
            samples,
        };
        let response = || channel_response(&observed, identified, estimator);
        add("channel responses, first two cycles", least(rounds, response), None, None);
    }
    add("friction points", least(rounds, || friction_points(robot, samples, &filtered, None)), None, None);
    add("whole analysis", least(rounds, || analyse_cycle(method, cycle)), None, None);
    Ok(found)
}

/// Two passes of two sections with five multiplications and four additions each.
const LOW_PASS_FLOPS: f64 = 36.0;
/// Three differences, two multiplications, two sums and a division by the step.
const DERIVATIVE_FLOPS: f64 = 8.0;

/// Operations for one instant and a chain of `n` revolute joints: 103 per link, 42 for each partial velocity that is
/// propagated, 87 for each joint above which a link has columns.
fn regressor_flops(n: usize) -> f64 {
    (0..n).map(|link| 103 + 42 * link + 87 * (link + 1)).sum::<usize>() as f64
}

/// Householder reflections of `rows` rows below a triangle, twice a multiplication and an addition for each number
/// above the diagonal.
fn qr_flops(rows: usize, columns: usize) -> f64 {
    2.0 * (rows * columns * columns) as f64
}

fn regressors_in_lanes(robot: &Robot, filtered: &FilteredSignals, rows: &[usize]) {
    let mut y = RegressorLanes::new(robot);
    let mut states = LaneStates::default();
    for rows in rows.chunks_exact(LANES) {
        let lanes =
            |channel: &[f64]| Lanes([channel[rows[0]], channel[rows[1]], channel[rows[2]], channel[rows[3]]]);
        for j in 0..robot.joint_count() {
            states.q[j] = lanes(&filtered.q[j]);
            states.qd[j] = lanes(&filtered.qd[j]);
            states.qdd[j] = lanes(&filtered.qdd[j]);
        }
        joint_torque_regressors(robot, &states, &mut y);
        black_box(&y);
    }
}

fn regressors_one_by_one(robot: &Robot, filtered: &FilteredSignals, rows: &[usize]) {
    let n = robot.joint_count();
    let mut y = Regressor::new(robot);
    let [mut q, mut qd, mut qdd, mut tau] = [(); 4].map(|()| vec![0.0; n]);
    for &row in rows {
        filtered.row(row, &mut q, &mut qd, &mut qdd, &mut tau);
        joint_torque_regressor(robot, &q, &qd, &qdd, &mut y);
        black_box(&y);
    }
}

/// `[w | tau]` of the first joint in the observed rows, column after column.
fn columns_of_first_joint(
    robot: &Robot,
    filtered: &FilteredSignals,
    jumps: &[FilteredColumn],
    rows: &[usize],
    kept: &[usize],
) -> Vec<Vec<f64>> {
    let n = robot.joint_count();
    let mut y = Regressor::new(robot);
    let mut columns = vec![Vec::with_capacity(rows.len()); kept.len() + 1];
    let [mut q, mut qd, mut qdd, mut tau] = [(); 4].map(|()| vec![0.0; n]);
    for &row in rows {
        filtered.row(row, &mut q, &mut qd, &mut qdd, &mut tau);
        joint_torque_regressor(robot, &q, &qd, &qdd, &mut y);
        write_filtered_columns(jumps, row, &mut y);
        let entries = kept.iter().map(|&column| y.column(column)[0]).chain([tau[0]]);
        columns.iter_mut().zip(entries).for_each(|(column, entry)| column.push(entry));
    }
    columns
}

fn structured_factor(columns: &[Vec<f64>]) -> TriangularFactor {
    let rows = columns.first().map_or(0, Vec::len);
    let mut builder = FactorBuilder::new(columns.len().saturating_sub(1));
    for first in (0..rows).step_by(LANES) {
        let lanes = |column: &Vec<f64>| {
            let at = |lane: usize| column.get(first + lane).copied().unwrap_or(0.0);
            Lanes([at(0), at(1), at(2), at(3)])
        };
        builder.push_lanes(columns.iter().map(lanes), std::array::from_fn(|lane| first + lane < rows));
    }
    builder.take()
}

/// The least processor time of all turns, s.
fn least<T>(rounds: u32, mut work: impl FnMut() -> T) -> f64 {
    (0..rounds).map(|_| time_of(&mut work)).fold(f64::INFINITY, f64::min)
}

/// Processor time of one execution of `work`, s, all threads of this process; the wall time if the system does not
/// report it.
fn time_of<T>(work: &mut impl FnMut() -> T) -> f64 {
    let (started, before) = (Instant::now(), cpu_s());
    let mut times = 0;
    while started.elapsed().as_secs_f64() < LEAST_S {
        black_box(work());
        times += 1;
    }
    let cpu = cpu_s() - before;
    (if cpu > 0.0 { cpu } else { started.elapsed().as_secs_f64() }) / f64::from(times)
}

/// Processor time of this process's threads, s: the first field of `/proc/self/task/*/schedstat`, in nanoseconds
/// (Documentation/scheduler/sched-stats of Linux). Zero if there is none.
fn cpu_s() -> f64 {
    let threads = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let of_thread = |path: std::path::PathBuf| {
        let text = std::fs::read_to_string(path.join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    threads.filter_map(|thread| of_thread(thread.path())).sum::<f64>() / 1e9
}

fn not_read(rejection: Rejection) -> CliError {
    CliError::Internal(format!("the simulated export: {rejection}"))
}

fn not_computed(error: NumericsError) -> CliError {
    CliError::Internal(format!("the simulated cycle: {error}"))
}
