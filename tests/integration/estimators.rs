//! The configured estimator in every command, and its accuracy compared with another.

use std::path::{Path, PathBuf};

use crate::support::{Workshop, reference};
use armwatch::pipeline::take::cycles::read_cycle;
use armwatch_config::{read_layout, read_robot};
use armwatch_method::analyse::Method;
use armwatch_method::identify::cycle::identify_factors;
use armwatch_method::identify::filtered_columns::filtered_coulomb_columns;
use armwatch_method::identify::joint_factors::{JointFactor, factor_cycle};
use armwatch_method::identify::verify::StageSums;
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_method::signal::filter::{filter_signals, independent_fraction};
use armwatch_model::analysis::Estimator;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::Robot;
use armwatch_model::run::{Cycle, Stage};
use armwatch_simulate::{SimulationSettings, simulate_run};

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

/// Moving relative RMSD of the excitation by joint, from the output of a command.
fn printed(rmsd: &serde_json::Value) -> Vec<f64> {
    let of_excitation = rmsd.as_array().expect("a list").iter().filter(|of| of["stage"] == "excitation");
    of_excitation.map(|of| of["moving_relative_rmsd"].as_f64().expect("a figure")).collect()
}

fn stored(workshop: &Workshop, sql: &str) -> Vec<f64> {
    workshop.query(sql).iter().map(|cell| cell.parse().expect("a number")).collect()
}

fn assert_same(ours: &[f64], theirs: &[f64]) {
    assert_eq!(ours.len(), theirs.len());
    for (ours, theirs) in ours.iter().zip(theirs) {
        assert!((ours / theirs - 1.0).abs() < 1e-6, "{ours} {theirs}");
    }
}

#[test]
fn one_cycle_has_one_figure_on_every_road() {
    for estimator in ["weighted", "ordinary"] {
        let workshop = Workshop::new();
        let config = std::fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
        // the default is weighted and needs no setting
        if estimator != "weighted" {
            let config = format!("{config}\n[analysis]\nestimator = \"{estimator}\"\n");
            std::fs::write(workshop.path("armwatch.toml"), config).expect("written");
        }
        workshop.simulate("inbox", &["--cycles", "1", "--warming-s", "2"]);
        workshop.stdout(&["ingest", "inbox"], 0);
        let own = stored(
            &workshop,
            "SELECT moving_relative_rmsd FROM cycle_rmsd WHERE stage = 'excitation' ORDER BY joint",
        );
        assert_eq!(workshop.query("SELECT DISTINCT estimator FROM cycle_rmsd"), [estimator]);
        let identified = json(&workshop.stdout(&["identify", "--run", "1", "--json"], 0));
        assert_eq!(identified["estimator"], estimator);
        assert_same(&printed(&identified["rmsd"]), &own);
        let verified = json(&workshop.stdout(&["verify", "--robot", "R01", "--store", "--json"], 0));
        assert_same(&printed(&verified["rmsd"]), &own);
        let cross = "SELECT DISTINCT estimator FROM cycle_rmsd WHERE verification = 'cross'";
        assert_eq!(workshop.query(cross), [estimator]);
    }
}

/// Makes the third position of an export stand still.
fn with_a_stuck_channel(export: &Path) {
    let text = std::fs::read_to_string(export).expect("an export");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let stuck = header.split(',').position(|name| name == "pos_3").expect("a position");
    let mut written = vec![header.to_owned()];
    for line in lines {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[stuck] = "0.25";
        written.push(cells.join(","));
    }
    std::fs::write(export, written.join("\n") + "\n").expect("written");
}

#[test]
fn refused_cycles_are_passed_over_with_their_reason() {
    let workshop = Workshop::new();
    let exports = workshop.simulate("inbox", &["--runs", "3", "--cycles", "1", "--warming-s", "2"]);
    with_a_stuck_channel(&exports[1]);
    workshop.run(&["ingest", "inbox"]);
    assert_eq!(workshop.query("SELECT run_id FROM cycles WHERE status = 'refused'"), ["2"]);
    for arguments in [
        &["verify", "--robot", "R01"][..],
        &["verify", "--parameters", "1", "--against", "R01"],
        &["identify", "--robot", "R01"],
    ] {
        let said = workshop.stderr(arguments, 0);
        assert!(
            said.contains("skipped: run 2, cycle 1: refused when it was read: "),
            "{arguments:?}: {said}"
        );
    }
    let together = json(&workshop.stdout(&["identify", "--robot", "R01", "--json"], 0));
    assert_eq!(together["sources"].as_array().map(Vec::len), Some(2));
    // a named run is used, and its reason is printed
    for arguments in [&["identify", "--run", "2"][..], &["verify", "--parameters", "2", "--against", "1"]] {
        let said = workshop.stderr(arguments, 0);
        assert!(said.contains("run 2, cycle 1: "), "{said}");
        assert!(said.contains("used in spite of findings") && !said.contains("older program"), "{said}");
    }
}

/// Relative deviations of the torque by joint, with parameters from other rows.
struct Crossed {
    name: String,
    by_joint: [Vec<f64>; 2],
}

const ESTIMATORS: [Estimator; 2] = [Estimator::Ordinary, Estimator::Weighted];

/// Identifies on all parts except one and verifies on that one, for each part. A part is the factors of some rows.
fn crossed(name: &str, method: &Method, parts: &[Vec<JointFactor>], rate: f64, cutoff: f64) -> Crossed {
    let by_joint = ESTIMATORS.map(|estimator| {
        let mut sums = StageSums::default();
        for left_out in 0..parts.len() {
            let mut union = PooledFactors::new(method.columns.clone());
            let shares = vec![independent_fraction(cutoff, rate); method.robot.joint_count()];
            for (_, part) in parts.iter().enumerate().filter(|(place, _)| *place != left_out) {
                union.add(&method.columns, part, &shares).expect("the same columns");
            }
            let factors = union.embedded_by_joint();
            let found = identify_factors(union.columns().kept(), &factors, &shares, estimator);
            let found = found.expect("a motion that shows every parameter");
            let theta: Vec<f64> = found.parameters.iter().map(|parameter| parameter.value).collect();
            sums.add(&method.columns, &parts[left_out], &theta);
        }
        let whole = sums.rmsd().into_iter().filter(|of| of.scope.name() == "all");
        whole.map(|of| of.moving_rows.relative).collect()
    });
    Crossed { name: name.into(), by_joint }
}

/// Factors of a cycle. Its rows of excitation outside a part of its time count as rows between stages, or are omitted.
fn part(method: &Method, cycle: &Cycle, [from, to]: [f64; 2], cutoff: f64) -> Vec<JointFactor> {
    let filtered = filter_signals(&cycle.samples, cutoff).expect("long enough");
    let filtered_coulomb_columns = filtered_coulomb_columns(&method.robot, &filtered);
    let mut samples = cycle.samples.clone();
    let rows = samples.rows() as f64;
    for (row, stage) in samples.stage.iter_mut().enumerate() {
        if !(from..to).contains(&(row as f64 / rows)) {
            *stage = Stage::Between;
        }
    }
    let kept = &method.base.kept_columns;
    let factored =
        factor_cycle(&method.robot, &method.columns, kept, &filtered, &filtered_coulomb_columns, &samples);
    let is_whole = from <= 0.0 && to >= 1.0;
    let is_part = |of: &JointFactor| is_whole || of.stage == Stage::Excitation;
    factored.factors.into_iter().filter(is_part).collect()
}

fn shipped(kind: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(kind).join(format!("{name}.toml"))
}

/// The recording of a real arm: each quarter of its four seconds against the other three.
fn tx40() -> Crossed {
    let robot = read_robot(&shipped("robots", "tx40")).expect("a shipped arm");
    let layout = read_layout(&shipped("exports", "motor_side")).expect("a shipped layout");
    let export = reference("tx40/TX40_0000-4000ms_5kHz.csv.gz");
    let cycle = read_cycle(&export, &layout, &robot, 1).expect("rows").expect("a cycle");
    let settings = AnalysisSettings::default();
    let method = Method::new(robot, settings).expect("base parameters");
    let parts: Vec<Vec<JointFactor>> = (0..4)
        .map(|quarter| [0.25 * f64::from(quarter), 0.25 * f64::from(quarter + 1)])
        .map(|share| part(&method, &cycle, share, settings.cutoff))
        .collect();
    crossed("TX40, recorded", &method, &parts, 5000.0, settings.cutoff)
}

/// Two runs of a simulated arm, a day apart, whose gearboxes have a bump at low speed and a ripple: each against the
/// other, excitation, friction and warming stages.
fn simulated(name: &str, robot: Robot, seed: u64) -> Crossed {
    let layout = read_layout(&shipped("exports", "native")).expect("a shipped layout");
    let settings = AnalysisSettings::default();
    let method = Method::new(robot, settings).expect("base parameters");
    let folder = tempfile::tempdir().expect("a folder");
    let parts: Vec<Vec<JointFactor>> = (0..2)
        .map(|run| {
            let simulation = SimulationSettings {
                seed,
                cycles: 1,
                runs: 2,
                initial_warm_s: 3600.0,
                ..SimulationSettings::default()
            };
            let files = simulate_run(&method.robot, &simulation, run, folder.path(), &mut |_| ());
            let export = files.expect("a recording").export;
            let cycle = read_cycle(&export, &layout, &method.robot, 1).expect("rows").expect("a cycle");
            part(&method, &cycle, [0.0, 1.0], settings.cutoff)
        })
        .collect();
    crossed(name, &method, &parts, 50.0, settings.cutoff)
}

/// The arm with the torque noise of each joint multiplied.
fn noise(mut robot: Robot, factors: &[f64]) -> Robot {
    for (joint, factor) in robot.joints.iter_mut().zip(factors) {
        if let Some(nominal) = joint.nominal.as_mut() {
            nominal.torque_noise *= factor;
        }
    }
    robot
}

/// `cargo test --test integration -- --ignored --nocapture cross_errors_of_ordinary_and_weighted` prints the table of
/// docs/evidence/method.md.
#[test]
#[ignore = "a table for the documentation: half a minute"]
fn cross_errors_of_ordinary_and_weighted_estimates() {
    let arm = |name: &str| read_robot(&shipped("robots", name)).expect("a shipped arm");
    let table = [
        tx40(),
        simulated("ER3A", arm("er3a"), 1),
        simulated(
            "ER3A, wrist torques ten times finer",
            noise(arm("er3a"), &[1.0, 1.0, 1.0, 0.1, 0.1, 0.1]),
            2,
        ),
        simulated(
            "ER3A, base torques five times coarser",
            noise(arm("er3a"), &[5.0, 5.0, 5.0, 1.0, 1.0, 1.0]),
            3,
        ),
        simulated("SCARA", arm("scara"), 4),
        simulated(
            "SCARA, first two joints five times coarser",
            noise(arm("scara"), &[5.0, 5.0, 1.0, 1.0]),
            5,
        ),
    ];
    for Crossed { name, by_joint: [ordinary, weighted] } in &table {
        let cells: Vec<String> = ordinary
            .iter()
            .zip(weighted)
            .map(|(ordinary, weighted)| format!("{:.2} / {:.2}", 100.0 * ordinary, 100.0 * weighted))
            .collect();
        println!("| {name} | {} |", cells.join(" | "));
        assert!(ordinary.iter().chain(weighted).all(|error| error.is_finite()), "{name}");
    }
    // over the joints of all arms, weighted is better if the two differ
    let ratios: Vec<f64> = table
        .iter()
        .flat_map(|of| of.by_joint[0].iter().zip(&of.by_joint[1]).map(|(o, w)| (w / o).ln()))
        .collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    println!("mean of weighted over ordinary: {:.3}", mean.exp());
    assert!(mean < 0.0, "{mean}");
}
