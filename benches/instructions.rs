//! Counts the instructions of the kernels of the analysis. Other programs on the machine do not change the count.
//!
//! `cargo bench --bench instructions` runs each kernel under callgrind (`valgrind`) in a separate process, once and
//! three times, and prints half the difference: for wide registers, and for any processor. The counts of the last run
//! are stored in the folder of this program, and the change since then is printed. Without valgrind nothing is counted.
//! The input is a small simulated export.

#![expect(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a benchmark ends at the first surprise"
)]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use armwatch::pipeline::take::cycles::read_cycle;
use armwatch_config::{Config, FleetEntry};
use armwatch_ingest::bytes::source;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::diagnose::recording::diagnose_samples;
use armwatch_method::diagnose::recording::view::DiagnoseSettings;
use armwatch_method::identify::filtered_columns::filtered_coulomb_columns;
use armwatch_method::identify::joint_factors::factor_cycle;
use armwatch_method::lanes::{LANES, Lanes, run_as_on_any_processor};
use armwatch_method::model::regressor_lanes::{LaneStates, RegressorLanes, joint_torque_regressors};
use armwatch_method::signal::filter::filter_signals;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::Robot;
use armwatch_model::run::{Cycle, Samples};
use armwatch_simulate::{SimulationSettings, simulate_run};

/// Kernels that are counted.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kernel {
    Lines,
    LowPass,
    Jumps,
    Findings,
    Regressor,
    Factors,
    Analysis,
}

const KERNELS: [(Kernel, &str); 7] = [
    (Kernel::Lines, "lines to channels"),
    (Kernel::LowPass, "low-pass and derivatives"),
    (Kernel::Jumps, "low-pass of columns that jump"),
    (Kernel::Findings, "findings about the recording"),
    (Kernel::Regressor, "regressor of all rows"),
    (Kernel::Factors, "triangular factors"),
    (Kernel::Analysis, "whole analysis"),
];

/// Repetitions of a kernel in the two processes.
const TIMES: [u32; 2] = [3, 1];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if let [name, times, form, export] = &arguments[..] {
        let kernel = KERNELS.iter().find(|(_, of)| of == name).expect("a kernel").0;
        run_as_on_any_processor(form == "any");
        work(kernel, times.parse().expect("a number"), Path::new(export));
        return ExitCode::SUCCESS;
    }
    match Command::new("valgrind").arg("--version").output() {
        Ok(_) => {}
        Err(error) if error.kind() == ErrorKind::NotFound => {
            println!("valgrind is not installed: no instructions are counted");
            return ExitCode::SUCCESS;
        }
        Err(error) => {
            println!("valgrind: {error}");
            return ExitCode::FAILURE;
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let export = small_export(folder.path());
    let kept_at = std::env::current_exe().expect("a path").with_file_name("instructions.json");
    let before: BTreeMap<String, u64> =
        std::fs::read(&kept_at).ok().and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
    let mut counts = BTreeMap::new();
    println!("{:<32} {:>14} {:>9} {:>14} {:>9}", "kernel", "wide", "change", "any processor", "change");
    for (_, name) in KERNELS.iter().filter(|(_, name)| arguments.iter().all(|part| name.contains(part))) {
        let mut line = format!("{name:<32}");
        for form in ["wide", "any"] {
            let [thrice, once] = TIMES.map(|times| counted(name, times, form, &export));
            let count = (thrice - once) / u64::from(TIMES[0] - TIMES[1]);
            let key = format!("{name}, {form}");
            let change = before.get(&key).map_or_else(String::new, |before| {
                format!("{:+.2} %", 100.0 * (count as f64 / *before as f64 - 1.0))
            });
            line.push_str(&format!(" {count:>14} {change:>9}"));
            counts.insert(key, count);
        }
        println!("{line}");
    }
    let all: BTreeMap<String, u64> = before.into_iter().chain(counts).collect();
    std::fs::write(&kept_at, serde_json::to_vec_pretty(&all).expect("text")).expect("written");
    ExitCode::SUCCESS
}

/// Instructions of a process that runs a kernel `times` times.
fn counted(name: &str, times: u32, form: &str, export: &Path) -> u64 {
    let program = std::env::current_exe().expect("a path");
    let mut command = Command::new("valgrind");
    command.args(["--tool=callgrind", "--callgrind-out-file=/dev/null"]).arg(program);
    let output = command.args([name, &times.to_string(), form]).arg(export).output().expect("valgrind runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let count = said.lines().find_map(|line| line.split_once("Collected : ")?.1.trim().parse().ok());
    count.unwrap_or_else(|| panic!("{name}: no count in\n{said}"))
}

fn small_export(folder: &Path) -> PathBuf {
    let settings = SimulationSettings { cycles: 1, warming_s: 5.0, ..SimulationSettings::default() };
    let robot = Robot::clone(&arm().description);
    simulate_run(&robot, &settings, 0, folder, &mut |_| ()).expect("an export").export
}

fn arm() -> FleetEntry {
    Config::shipped().expect("the shipped configuration").fleet.into_iter().next().expect("the shipped arm")
}

/// Runs a kernel.
fn work(kernel: Kernel, times: u32, export: &Path) {
    let arm = arm();
    let robot = Robot::clone(&arm.description);
    if kernel == Kernel::Lines {
        return again(times, || {
            let bytes = source::open(export).expect("a file");
            let options = ReadOptions::default();
            let reader = ExportReader::new(bytes, export, &arm.layout, &robot, options).expect("a header");
            reader.map(|chunk| chunk.expect("rows").samples.rows()).sum::<usize>()
        });
    }
    let cycle = read_cycle(export, &arm.layout, &robot, 1).expect("readable").expect("a cycle");
    let Cycle { samples, .. } = &cycle;
    let cutoff = AnalysisSettings::default().cutoff;
    if kernel == Kernel::LowPass {
        return again(times, || filter_signals(samples, cutoff));
    }
    let filtered = filter_signals(samples, cutoff).expect("long enough");
    match kernel {
        Kernel::Jumps => again(times, || filtered_coulomb_columns(&robot, &filtered)),
        Kernel::Findings => {
            again(times, || diagnose_samples(&robot, samples, &filtered, &DiagnoseSettings::default()));
        }
        Kernel::Regressor => {
            let states = states(samples, robot.joint_count());
            let mut y = RegressorLanes::new(&robot);
            again(times, || {
                for states in &states {
                    joint_torque_regressors(&robot, black_box(states), &mut y);
                    black_box(&y);
                }
            });
        }
        _ => {
            let method = Method::new(robot, AnalysisSettings::default()).expect("a method");
            if kernel == Kernel::Analysis {
                return again(times, || analyse_cycle(&method, &cycle));
            }
            let (robot, columns, kept) = (&method.robot, &method.columns, &method.base.kept_columns);
            let jumps = filtered_coulomb_columns(robot, &filtered);
            again(times, || factor_cycle(robot, columns, kept, &filtered, &jumps, samples));
        }
    }
}

fn again<T>(times: u32, mut work: impl FnMut() -> T) {
    (0..times).for_each(|_| {
        black_box(work());
    });
}

/// States with one row per lane. Torque over inertia replaces the acceleration.
fn states(samples: &Samples, n: usize) -> Vec<LaneStates> {
    let velocity = samples.velocity.as_ref().expect("velocities");
    let of_rows = |first: usize| {
        let mut states = LaneStates::default();
        for (j, velocity) in velocity.iter().enumerate().take(n) {
            let lanes = |channel: &[f64]| Lanes(std::array::from_fn(|lane| channel[first + lane]));
            states.q[j] = lanes(&samples.position[j]);
            states.qd[j] = lanes(velocity);
            states.qdd[j] = lanes(&samples.torque[j]);
        }
        states
    };
    (0..samples.rows() / LANES).map(|chunk| of_rows(chunk * LANES)).collect()
}
