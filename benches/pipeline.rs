//! Measures the time of the parts of the pipeline. If the work of another program is the reference, it is in the same
//! group with the same input. Read the ratio of both, which is similar on all machines, not the time.
//!
//! | group | is | compared with |
//! |---|---|---|
//! | `block` | one block of an export to channels in SI | polars alone on the same bytes |
//! | `cycle` | one cycle: filter, identification, verification, friction | a QR of as many rows x 64 |
//! | `sample` | rigid-body torque and regressor, state by state | the regressor of four states at once |
//! | `kernel` | low-pass of all channels, findings about them, triangular factors of all joints | |
//! | `store` | one cycle into a database, a transaction each | |
//!
//! The input is one cycle of the full test of the ER3A (250 Hz, 180 s of warming), simulated.

#![expect(clippy::expect_used, clippy::panic, reason = "a benchmark ends at the first surprise")]

use std::hint::black_box;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use criterion::{Criterion, Throughput};
use faer::Mat;
use jiff::Timestamp;
use polars_core::prelude::{DataFrame, DataType, Field, Schema, SchemaRef};
use polars_io::SerReader;
use polars_io::csv::read::{CsvParseOptions, CsvReadOptions};

use armwatch_config::{Config, FleetEntry};
use armwatch_ingest::bytes::blocks::{BLOCK_BYTES, Block, Blocks, Next};
use armwatch_ingest::table::column_map::map_columns;
use armwatch_ingest::table::parser::Parser;
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::diagnose::recording::diagnose_samples;
use armwatch_method::diagnose::recording::view::DiagnoseSettings;
use armwatch_method::identify::filtered_columns::filtered_coulomb_columns;
use armwatch_method::identify::joint_factors::factor_cycle;
use armwatch_method::lanes::{LANES, Lanes};
use armwatch_method::model::dynamics::inverse_dynamics;
use armwatch_method::model::regressor::{Regressor, joint_torque_regressor};
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes, joint_torque_regressors};
use armwatch_method::signal::filter::filter_signals;
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{Robot, StandardParameters};
use armwatch_model::run::{ContentHash, Cycle, RunHeader, Samples};
use armwatch_simulate::files::export::ExportWriter;
use armwatch_simulate::run::record::record;
use armwatch_simulate::run::recording::RecordedRow;
use armwatch_simulate::{SimulationSettings, recording_of_run};
use armwatch_store::Store;

/// Samples of the groups whose single measurement takes tens of milliseconds.
const FEW_SAMPLES: usize = 20;

/// States of the group `sample`: enough that the processor cannot learn the branches.
const STATES: usize = 1000;

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    let shipped = Config::shipped().expect("the shipped configuration");
    let arm = shipped.fleet.first().expect("the shipped arm");
    let rows = one_cycle(&arm.description);
    let cycle = Cycle { number: 1, samples: samples(&rows, arm.description.joint_count()) };
    let method = Method::new(Robot::clone(&arm.description), AnalysisSettings::default()).expect("a method");
    let analysis = analyse_cycle(&method, &cycle);

    read_block(&mut criterion, arm, &rows);
    analyse(&mut criterion, &method, &cycle, &analysis);
    evaluate_samples(&mut criterion, &arm.description, &rows);
    kernels(&mut criterion, &method, &cycle.samples);
    store_cycle(&mut criterion, &arm.description, &analysis);
    criterion.final_summary();
}

/// One block of the cycle's export: parsed and checked by the product, and parsed by polars alone.
fn read_block(criterion: &mut Criterion, arm: &FleetEntry, rows: &[RecordedRow]) {
    let text = export(rows, arm.description.joint_count());
    let path = Path::new("bench.csv");
    let mut blocks = Blocks::new(&text[..], BLOCK_BYTES, arm.layout.text.encoding);
    let header = blocks.next_line(path).expect("readable").expect("a header").text;
    let Next::Block(block) = blocks.next_block(path).expect("readable") else {
        panic!("an export has a block");
    };
    let map = map_columns(&header, &arm.layout, &arm.description, path).expect("the native layout");
    let parser = Parser::new(map);
    let schema = numbers_only(header.split(',').count());

    let ours = parser.read(&block, None, path).expect("sound rows").rows();
    assert_eq!(ours, polars_alone(&block, &schema, Some(0)).height(), "both read the same rows");
    let mut group = criterion.benchmark_group("block");
    group.throughput(Throughput::Bytes(block.bytes.len() as u64)).sample_size(FEW_SAMPLES);
    group.bench_function("armwatch", |b| b.iter(|| parser.read(black_box(&block), None, path)));
    // With 0 the block stays whole, so that one thread parses it, as in the product.
    group.bench_function("polars on one thread", |b| {
        b.iter(|| polars_alone(black_box(&block), &schema, Some(0)));
    });
    group.bench_function("polars on all threads", |b| {
        b.iter(|| polars_alone(black_box(&block), &schema, None));
    });
    group.finish();
}

fn polars_alone(block: &Block, schema: &SchemaRef, threads: Option<usize>) -> DataFrame {
    CsvReadOptions::default()
        .with_has_header(false)
        .with_schema(Some(schema.clone()))
        .with_n_threads(threads)
        .with_parse_options(CsvParseOptions::default().with_separator(b','))
        .into_reader_with_file_handle(Cursor::new(&block.bytes[..]))
        .finish()
        .expect("polars reads its own")
}

fn numbers_only(columns: usize) -> SchemaRef {
    let field = |column: usize| Field::new(column.to_string().into(), DataType::Float64);
    Arc::new((0..columns).map(field).collect::<Schema>())
}

/// The whole analysis of a cycle, and the least cost of its identification: a QR of as many rows as the identification
/// used, with as many columns as there are parameters.
fn analyse(criterion: &mut Criterion, method: &Method, cycle: &Cycle, analysis: &CycleAnalysis) {
    let identified = analysis.identification.as_ref().expect("parameters");
    let (rows, columns) = (identified.samples * method.robot.joint_count(), identified.parameters.len());
    // Any full-rank matrix costs the same; this one needs no generator.
    let matrix =
        Mat::from_fn(rows, columns, |i, j| ((i * 7919 + j * 104_729) as f64 * 0.618_034).fract() - 0.5);

    let mut group = criterion.benchmark_group("cycle");
    group.sample_size(FEW_SAMPLES);
    group.bench_function(format!("analysis of {} rows", cycle.samples.rows()), |b| {
        b.iter(|| analyse_cycle(method, black_box(cycle)));
    });
    group.bench_function(format!("QR of {rows} x {columns}"), |b| b.iter(|| black_box(&matrix).qr()));
    group.finish();
}

/// Rigid-body torque and regressor of one state, averaged over states of the cycle.
fn evaluate_samples(criterion: &mut Criterion, robot: &Robot, rows: &[RecordedRow]) {
    let n = robot.joint_count();
    let links: Vec<StandardParameters> =
        robot.joints.iter().map(|joint| joint.nominal.expect("nominal parameters").inertial).collect();
    // Torque over inertia replaces the acceleration, because the cost does not depend on its value.
    let states: Vec<&RecordedRow> = rows.iter().step_by((rows.len() / STATES).max(1)).take(STATES).collect();
    let mut tau = vec![0.0; n];
    let mut y = Regressor::new(robot);
    let lane_states: Vec<LaneStates> = states.chunks_exact(LANES).map(|rows| in_lanes(rows, n)).collect();
    let mut lanes = RegressorLanes::new(robot);

    let mut group = criterion.benchmark_group("sample");
    group.throughput(Throughput::Elements(states.len() as u64));
    group.bench_function("inverse dynamics", |b| {
        b.iter(|| {
            for row in &states {
                let (q, qd, qdd) = (&row.position[..n], &row.velocity[..n], &row.torque[..n]);
                inverse_dynamics(robot, &links, black_box(q), qd, qdd, &mut tau);
                black_box(&tau);
            }
        });
    });
    group.bench_function("regressor", |b| {
        b.iter(|| {
            for row in &states {
                let (q, qd, qdd) = (&row.position[..n], &row.velocity[..n], &row.torque[..n]);
                joint_torque_regressor(robot, black_box(q), qd, qdd, &mut y);
                black_box(&y);
            }
        });
    });
    group.bench_function("regressor, a lane each", |b| {
        b.iter(|| {
            for states in &lane_states {
                joint_torque_regressors(robot, black_box(states), &mut lanes);
                black_box(&lanes);
            }
        });
    });
    group.finish();
}

fn in_lanes(rows: &[&RecordedRow], n: usize) -> LaneStates {
    let mut states = LaneStates::default();
    for j in 0..n {
        let lanes = |of: fn(&RecordedRow, usize) -> f64| Lanes(std::array::from_fn(|lane| of(rows[lane], j)));
        states.q[j] = lanes(|row, j| row.position[j]);
        states.qd[j] = lanes(|row, j| row.velocity[j]);
        states.qdd[j] = lanes(|row, j| row.torque[j]);
    }
    states
}

/// The single passes over all rows of a cycle.
fn kernels(criterion: &mut Criterion, method: &Method, samples: &Samples) {
    let cutoff = AnalysisSettings::default().cutoff;
    let filtered = filter_signals(samples, cutoff).expect("long enough");
    let jumps = filtered_coulomb_columns(&method.robot, &filtered);
    let mut group = criterion.benchmark_group("kernel");
    group.throughput(Throughput::Elements(samples.rows() as u64)).sample_size(FEW_SAMPLES);
    group.bench_function("low-pass and derivatives", |b| {
        b.iter(|| filter_signals(black_box(samples), cutoff));
    });
    group.bench_function("low-pass of columns that jump", |b| {
        b.iter(|| filtered_coulomb_columns(&method.robot, black_box(&filtered)));
    });
    group.bench_function("findings about the recording", |b| {
        b.iter(|| {
            diagnose_samples(&method.robot, samples, black_box(&filtered), &DiagnoseSettings::default())
        });
    });
    group.bench_function("factors", |b| {
        let kept = &method.base.kept_columns;
        b.iter(|| factor_cycle(&method.robot, &method.columns, kept, black_box(&filtered), &jumps, samples));
    });
    group.finish();
}

/// One cycle into a database on disk: parameters, deviations, friction points and mark of progress.
fn store_cycle(criterion: &mut Criterion, robot: &Robot, analysis: &CycleAnalysis) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let folder = tempfile::tempdir().expect("a folder");
    let (store, run_id) = runtime.block_on(async {
        let store = Store::open(&folder.path().join("bench.db")).await.expect("a database");
        let run = store.begin_run(&run_header(robot)).await.expect("a run");
        (store, run.run_id)
    });
    // Each cycle has a new number, because a known cycle is not written.
    let mut analysis = analysis.clone();
    analysis.cycle = 0;

    let mut group = criterion.benchmark_group("store");
    group.sample_size(FEW_SAMPLES);
    group.bench_function("one cycle", |b| {
        b.iter(|| {
            analysis.cycle += 1;
            let stored = runtime.block_on(store.record_cycle(run_id, &analysis, robot)).expect("stored");
            assert!(stored, "cycle {} is new", analysis.cycle);
        });
    });
    group.finish();
    runtime.block_on(store.close()).expect("closed");
}

fn run_header(robot: &Robot) -> RunHeader {
    RunHeader {
        robot: "R01".into(),
        model: robot.model.clone(),
        started_at: Timestamp::UNIX_EPOCH,
        source_name: "bench.csv".into(),
        source_path: "bench.csv".into(),
        content_hash: ContentHash([7; 32]),
        source_bytes: 0,
    }
}

fn one_cycle(robot: &Robot) -> Vec<RecordedRow> {
    let settings = SimulationSettings { cycles: 1, ..SimulationSettings::full_test() };
    let recording = recording_of_run(robot, &settings, 0).expect("a recording");
    let mut rows = Vec::new();
    record(&recording, settings.seed, 0, |row| {
        rows.push(*row);
        Ok::<(), std::convert::Infallible>(())
    })
    .expect("memory does not fail");
    rows
}

fn samples(rows: &[RecordedRow], joints: usize) -> Samples {
    let channel = |of: fn(&RecordedRow, usize) -> f64| -> Vec<Vec<f64>> {
        (0..joints).map(|j| rows.iter().map(|row| of(row, j)).collect()).collect()
    };
    Samples {
        time: rows.iter().map(|row| row.time).collect(),
        position: channel(|row, j| row.position[j]),
        velocity: Some(channel(|row, j| row.velocity[j])),
        torque: channel(|row, j| row.torque[j]),
        stage: rows.iter().map(|row| row.stage).collect(),
        cycle: Some(rows.iter().map(|row| row.cycle).collect()),
        friction_signal: Some(rows.iter().map(|row| row.signal).collect()),
        temperatures: None,
    }
}

/// The rows as the simulator writes them.
fn export(rows: &[RecordedRow], joints: usize) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("bench.csv");
    let mut writer = ExportWriter::create(&path, joints).expect("an export");
    for row in rows {
        writer.push(row).expect("written");
    }
    writer.finish().expect("finished");
    std::fs::read(&path).expect("read")
}
