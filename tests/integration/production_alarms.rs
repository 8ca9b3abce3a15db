//! Rates of false alarms between tests, and delays until wear is found: simulated tests and production logs, analysed
//! as by the daemon, without a database.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use armwatch::pipeline::take::cycles::read_cycle;
use armwatch_config::{Layout, read_layout, read_robot};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_method::detect::production::detect_production;
use armwatch_method::production::reference::{Reference, last_link_shares};
use armwatch_method::production::window::analyse_window;
use armwatch_model::analysis::log_summary::{log_evidence, summarise};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{Estimator, RmsdScope, TorqueRmsd};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, ProductionSummary};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::Stage;
use armwatch_simulate::arm::fault::{Fault, FaultKind, WornPart};
use armwatch_simulate::arm::load::Load;
use armwatch_simulate::{SimulationSettings, simulate_run};

/// Logs after each test.
const LOGS: u32 = 9;

/// An arm, and the layouts of its exports.
struct Arm {
    method: Method,
    test: Layout,
    work: Layout,
}

/// A test that production is compared with.
struct Test {
    reference: Reference,
    /// Moving relative RMSD of its excitation.
    rmsd: Vec<(JointIndex, f64)>,
}

/// State of an arm in a recording.
#[derive(Debug, Clone, Default)]
struct State {
    /// Time since its start, s.
    warm_s: f64,
    /// Difference of the ambient temperature from its mean, K.
    hall_k: f64,
    load_kg: f64,
    faults: Vec<Fault>,
}

impl Arm {
    fn new(model: &str) -> Self {
        let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config");
        let layout = |name: &str| read_layout(&config.join("exports").join(name)).expect("a shipped layout");
        let robot = read_robot(&config.join("robots").join(format!("{model}.toml"))).expect("a shipped arm");
        let method = Method::new(robot, AnalysisSettings::default()).expect("base parameters");
        Self { method, test: layout("native.toml"), work: layout("production.toml") }
    }

    fn record<T>(&self, seed: u64, run: u32, state: &State, read: impl FnOnce(&Path) -> T) -> T {
        let folder = tempfile::tempdir().expect("a folder");
        let settings = SimulationSettings {
            seed,
            robot_name: format!("R{seed}"),
            cycles: 1,
            warming_s: 10.0,
            runs: run + 1,
            initial_warm_s: state.warm_s,
            ambient_offset_k: state.hall_k,
            ambient_std_k: 0.0,
            faults: state.faults.clone(),
            load: (state.load_kg > 0.0).then(|| Load {
                mass: state.load_kg,
                centre: Vector3::new(0.02, 0.0, 0.06),
                inertia: Matrix3::identity() * (0.002 * state.load_kg),
            }),
            ..SimulationSettings::default()
        };
        let files = simulate_run(&self.method.robot, &settings, run, folder.path(), &mut |_| ());
        read(&files.expect("a recording").export)
    }

    fn test(&self, seed: u64, run: u32, state: &State) -> Test {
        let cycle = self.record(seed, run, state, |export| {
            read_cycle(export, &self.test, &self.method.robot, 1).expect("rows").expect("a cycle")
        });
        let found = analyse_cycle(&self.method, &cycle);
        let moving = |of: &&TorqueRmsd| of.scope == RmsdScope::Stage(Stage::Excitation);
        let rmsd =
            found.verification.iter().filter(moving).map(|of| (of.joint, of.moving_rows.relative)).collect();
        let found = found.identification.expect("parameters");
        let parameters = found.parameters.iter().map(|parameter| (parameter.id, parameter.value)).collect();
        let base = &self.method.base;
        let terms = |index: usize| {
            let others = base.grouping[index].iter().map(|of| (of.coefficient, of.id));
            std::iter::once((1.0, base.kept[index])).chain(others).collect::<Vec<_>>()
        };
        let terms: Vec<_> = (0..base.kept.len()).map(|index| (base.kept[index], terms(index))).collect();
        let last_link = last_link_shares(terms.iter().map(|(id, terms)| (*id, &terms[..])));
        let run_id = -1 - i64::from(run);
        let reference = Reference { run_id, estimator: Estimator::default(), parameters, last_link };
        Test { reference, rmsd }
    }

    fn log(&self, seed: u64, run: u32, state: &State, test: &Test) -> ProductionSummary {
        let windows = self.record(seed, run, state, |export| {
            let window = |number| read_cycle(export, &self.work, &self.method.robot, number).expect("rows");
            (1..).map_while(window).collect::<Vec<_>>()
        });
        let checks: Vec<_> = (windows.iter())
            .filter_map(|window| analyse_window(&self.method, window, Some(&test.reference)).production)
            .collect();
        let mut joints = summarise(checks.iter().map(|check| &check.joints[..]));
        for of in &mut joints {
            of.test_relative_rmsd =
                test.rmsd.iter().find(|(joint, _)| *joint == of.joint).map(|(_, rmsd)| *rmsd);
        }
        ProductionSummary {
            run_id: i64::from(run),
            started_at: jiff::Timestamp::from_second(i64::from(run) * 28_800).expect("a time"),
            reference_run_id: test.reference.run_id,
            joints,
            evidence: log_evidence(&checks.iter().map(|check| check.evidence.clone()).collect::<Vec<_>>()),
        }
    }

    /// Tests with logs after each; `of` is the state in a recording, numbered from 0.
    fn history(&self, seed: u64, tests: u32, of: impl Fn(u32) -> State) -> Vec<ProductionSummary> {
        let mut history = Vec::new();
        for test in 0..tests {
            let first = test * (LOGS + 1);
            // tests run from cold to warm for two hours, without a load
            let at_test = State { warm_s: 3600.0, load_kg: 0.0, ..of(first) };
            let of_test = self.test(seed, first, &at_test);
            history.extend((first + 1..=first + LOGS).map(|run| self.log(seed, run, &of(run), &of_test)));
        }
        history
    }
}

/// Shifts at any temperature of the arm, and an ambient temperature that differs by a few degrees.
fn weather(seed: u64, run: u32) -> State {
    let mut random = ChaCha8Rng::seed_from_u64(seed * 1000 + u64::from(run));
    let warm_s = [600.0, 3600.0, 14_400.0][random.random_range(0..3)];
    State { warm_s, hall_k: random.random_range(-4.0..4.0), ..State::default() }
}

fn of_kind(found: &[Anomaly], kind: AnomalyKind) -> Vec<&Anomaly> {
    found.iter().filter(|anomaly| anomaly.kind == kind).collect()
}

/// False alarms of friction and reported loads over healthy histories, and the number of joints times logs.
fn alarms(model: &str, seeds: std::ops::Range<u64>, of: impl Fn(u64, u32) -> State) -> [usize; 3] {
    let arm = Arm::new(model);
    let mut counts = [0; 3];
    for seed in seeds {
        let history = arm.history(seed, 2, |run| of(seed, run));
        let found = detect_production(&history, &DetectSettings::default());
        let (wear, load) = (of_kind(&found, AnomalyKind::Drift), of_kind(&found, AnomalyKind::Payload));
        for anomaly in &wear {
            println!(
                "{model} seed {seed}: {} {:.3}: {}",
                anomaly.first_run_id, anomaly.score, anomaly.message
            );
        }
        counts[0] += wear.len();
        counts[1] += load.len();
        counts[2] +=
            history.iter().map(|log| log.joints.len()).sum::<usize>() * (LOGS as usize - 3) / LOGS as usize;
    }
    counts
}

#[test]
#[ignore = "hundreds of simulated recordings, to be looked at by hand"]
fn healthy_arms_at_work_are_not_called_worn() {
    for model in ["er3a", "scara"] {
        let [wear, load, judged] = alarms(model, 500..506, weather);
        println!("{model}: {wear} false alarms of friction, {load} loads said, in {judged} logs of joints");
        assert!(wear * 200 <= judged && load * 50 <= judged, "{model}: {wear} {load} {judged}");
    }
}

#[test]
#[ignore = "hundreds of simulated recordings, to be looked at by hand"]
fn changing_loads_are_said_and_not_called_wear() {
    // two of three shifts have a load
    let loaded = |seed, run| State { load_kg: f64::from(run % 3), ..weather(seed, run) };
    let [wear, load, judged] = alarms("er3a", 520..526, loaded);
    println!(
        "er3a with changing loads: {wear} false alarms of friction, {load} loads said, in {judged} logs of joints"
    );
    assert!(wear * 100 <= judged, "{wear} {judged}");
    // a single load, after the first logs
    let once = |seed, run| State { load_kg: if run % 10 == 6 { 2.0 } else { 0.0 }, ..weather(seed, run) };
    let [wear, load, judged] = alarms("er3a", 530..533, once);
    println!(
        "er3a with one load: {wear} false alarms of friction, {load} loads said, in {judged} logs of joints"
    );
    assert!(wear * 100 <= judged && load >= 2 * 3, "{wear} {load} {judged}");
}

#[test]
#[ignore = "hundreds of simulated recordings, to be looked at by hand"]
fn wear_between_tests_is_found() {
    let arm = Arm::new("er3a");
    for (step, worn) in [(0.25, 540..543), (0.5, 543..546)] {
        for seed in worn {
            let joint = usize::try_from(seed).expect("small") % 6;
            // wear begins with the fifth log after the first test
            let faults = vec![Fault {
                kind: FaultKind::Wear { part: WornPart::All, rate_per_run: step, cap: step },
                joint: Some(JointIndex::new(joint)),
                start_run: 6,
                last_run: None,
            }];
            let history = arm.history(seed, 1, |run| State { faults: faults.clone(), ..weather(seed, run) });
            let found = detect_production(&history, &DetectSettings::default());
            let wear = of_kind(&found, AnomalyKind::Drift);
            let first = wear
                .iter()
                .map(|anomaly| (anomaly.joint.expect("one").index(), anomaly.first_run_id))
                .collect::<Vec<_>>();
            println!(
                "seed {seed}: {step} more friction in joint {} from log 5 on: found {first:?}",
                joint + 1
            );
            if step >= 0.5 {
                assert!(
                    matches!(first[..], [(of, run)] if of == joint && (5..=7).contains(&run)),
                    "{first:?}"
                );
            }
        }
    }
}

/// The first log with a fault; the test and the log before it have none.
const FIRST_FAULTY: u32 = 2;

/// A fault of a joint from that log on; the simulator counts runs from 1.
fn fault(kind: FaultKind, joint: usize) -> Fault {
    Fault { kind, joint: Some(JointIndex::new(joint)), start_run: FIRST_FAULTY + 1, last_run: None }
}

/// Anomalies in logs with a fault that the test before them did not have.
fn said(what: &str, history: &[ProductionSummary]) -> Vec<Anomaly> {
    let found = detect_production(history, &DetectSettings::default());
    for of in &found {
        let place = of.joint.map_or_else(|| "the arm".to_owned(), |joint| format!("joint {joint}"));
        println!("{what}: {} of {place} from log {}: {:.3}", of.kind, of.first_run_id, of.value);
    }
    found
}

/// Returns true if an anomaly of this kind and joint begins with the first log with a fault.
fn named(found: &[Anomaly], kind: AnomalyKind, joint: usize) -> bool {
    let begins = |of: &Anomaly| of.first_run_id == i64::from(FIRST_FAULTY);
    found.iter().any(|of| of.kind == kind && of.joint == Some(JointIndex::new(joint)) && begins(of))
}

#[test]
#[ignore = "some two hundred simulated recordings: minutes"]
fn causes_of_work_are_named_from_the_first_log_on() {
    let arm = Arm::new("er3a");
    let of_joint = |kind: Option<FaultKind>, seed: u64| {
        let joint = usize::try_from(seed).expect("small") % 6;
        let faults: Vec<Fault> = kind.iter().map(|kind| fault(*kind, joint)).collect();
        let history = arm.history(seed, 1, |run| State { faults: faults.clone(), ..weather(seed, run) });
        (joint, said(&format!("{kind:?}, joint {}", joint + 1), &history))
    };
    for seed in 600..606 {
        let (_, found) = of_joint(None, seed);
        assert_eq!(found, [], "a healthy arm, seed {seed}");
        let (joint, found) =
            of_joint(Some(FaultKind::Wear { part: WornPart::All, rate_per_run: 0.5, cap: 0.5 }), seed);
        assert!(named(&found, AnomalyKind::Drift, joint), "friction of joint {}: {found:?}", joint + 1);
        // joints 2 and 3 carry weight; in the joints after them nearly all torque is friction
        let (joint, found) = of_joint(Some(FaultKind::Gain { size: 0.1 }), seed);
        let is_named = named(&found, AnomalyKind::Sensor, joint);
        assert!(is_named || ![1, 2].contains(&joint), "gain of joint {}: {found:?}", joint + 1);
        let others = found.iter().filter(|of| of.joint.is_some_and(|of| of != JointIndex::new(joint)));
        assert_eq!(others.count(), 0, "gain of joint {}: {found:?}", joint + 1);
    }
    for (load_kg, seed) in [(0.8, 606), (0.8, 607), (2.0, 608)] {
        let history = arm.history(seed, 1, |run| State {
            load_kg: if run >= FIRST_FAULTY { load_kg } else { 0.0 },
            ..weather(seed, run)
        });
        let found = said(&format!("load of {load_kg} kg"), &history);
        let [load] = &found[..] else { panic!("one anomaly: {found:?}") };
        let begins = i64::from(FIRST_FAULTY);
        assert_eq!(
            (load.kind, load.joint, load.first_run_id),
            (AnomalyKind::Payload, None, begins),
            "{found:?}"
        );
        assert!((load.value / load_kg - 1.0).abs() < 0.15, "{found:?}");
    }
}
