//! Recordings and descriptions that are wrong in one way each, through the whole analysis: none may give results that
//! pass as good.

pub mod arms;
mod faults;

use self::arms::{Arm, arms, excitation, shipped};
use self::faults::{DEGREES, RATED, WRONG_DESCRIPTIONS, WRONG_RECORDINGS, Wrong, delayed, scale, units};
use crate::support::{Workshop, reference};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::analysis::{CycleAnalysis, RmsdScope, TorqueRmsd};
use armwatch_model::robot::{MAX_JOINTS, Robot};
use armwatch_model::run::{Cycle, Samples, Stage};
use armwatch_simulate::files::export::ExportWriter;
use armwatch_simulate::run::recording::RecordedRow;

fn analysed(described: &Robot, samples: &Samples) -> CycleAnalysis {
    let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
    analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() })
}

/// Result of a recording, for the printed matrix.
fn verdict(analysis: &CycleAnalysis) -> String {
    let rmsd = || {
        let of = |v: &TorqueRmsd| v.moving_rows.relative;
        let all: Vec<String> = analysis
            .verification
            .iter()
            .filter(|v| v.scope == RmsdScope::Stage(Stage::Excitation))
            .map(|v| format!("{:.3}", of(v)))
            .collect();
        all.join(" ")
    };
    let told: Vec<&String> = analysis.remarks.iter().filter(|r| !r.contains("stage")).collect();
    match &analysis.identification {
        Err(reason) => format!("refused: {reason}"),
        Ok(_) if told.is_empty() => format!("PASSES [{}]", rmsd()),
        Ok(_) => format!("told [{}]: {told:?}", rmsd()),
    }
}

/// Names of wrong descriptions that pass without a remark.
fn passing_descriptions(arm: &Arm, samples: &Samples) -> Vec<&'static str> {
    let passes = |described: Robot| verdict(&analysed(&described, samples)).starts_with("PASSES");
    let wrong = WRONG_DESCRIPTIONS.iter().filter(|wrong| (wrong.spoil)(&arm.robot).is_some_and(passes));
    wrong.map(|wrong| wrong.name).collect()
}

/// Names of wrong recordings that pass without a remark.
fn passing_recordings(arm: &Arm, samples: &Samples) -> Vec<&'static str> {
    let passes = |wrong: &&Wrong| {
        let mut spoilt = samples.clone();
        (wrong.spoil)(&mut spoilt, arm.robot.joint_count());
        verdict(&analysed(&arm.robot, &spoilt)).starts_with("PASSES")
    };
    // without the column there is nothing to change
    let applies = |wrong: &&Wrong| samples.velocity.is_some() || !wrong.name.contains("velocit");
    WRONG_RECORDINGS.iter().filter(applies).filter(passes).map(|wrong| wrong.name).collect()
}

/// The arm of that name and a recording of it.
fn recorded(name: &str) -> (Arm, Samples) {
    let arm = arms().into_iter().find(|arm| arm.name == name).expect("an arm");
    let samples = excitation(&arm.robot, 3, 100.0);
    (arm, samples)
}

/// Asserts which wrong recordings pass, with velocities and without.
#[track_caller]
fn assert_recordings(name: &str, with_velocity: &[&str], without: &[&str]) {
    let (arm, mut samples) = recorded(name);
    assert_eq!(passing_recordings(&arm, &samples), with_velocity, "{name}");
    samples.velocity = None;
    assert_eq!(passing_recordings(&arm, &samples), without, "{name} without velocities");
}

#[test]
#[ignore = "some twenty seconds; the other arms' are quick"]
fn wrong_recordings_of_an_er3a_do_not_pass() {
    assert_recordings("er3a", &[], &[]);
}

/// Vertical axes: gravity, which would reveal a wrong clock, acts on no rotating joint.
#[test]
fn wrong_recordings_of_a_scara_do_not_pass() {
    assert_recordings("scara", &[], &["clock 10 % fast"]);
}

#[test]
#[ignore = "some twenty seconds; the other arms' are quick"]
fn wrong_recordings_of_a_ur10e_do_not_pass() {
    assert_recordings("ur10e, standard DH", &[], &[]);
}

/// Asserts which wrong descriptions pass; the documentation of the method lists them.
#[track_caller]
fn assert_descriptions(name: &str, passing: &[&str]) {
    let (arm, samples) = recorded(name);
    assert_eq!(passing_descriptions(&arm, &samples), passing, "{name}");
}

/// One centimetre of the shoulder, and lengths of the wrist, are absorbed by the base parameters or the noise.
#[test]
#[ignore = "some twenty seconds; the other arms' are quick"]
fn wrong_descriptions_of_an_er3a_do_not_pass() {
    let small = ["first length 20 % long", "third length 20 % long", "second d 20 % long"];
    assert_descriptions("er3a", &[&small[..], &["90 deg at joint 5 missing"]].concat());
    assert_descriptions("er3a, URDF", &["90 deg at joint 5 missing"]);
}

/// All axes are parallel: lengths are absorbed by first moments and inertias, gravity by the carried mass.
#[test]
fn wrong_descriptions_of_a_scara_do_not_pass() {
    let lengths =
        ["first length 20 % long", "second length 20 % long", "second d 20 % long", "lengths swapped"];
    let rest = ["90 deg at joint 2 missing", "gravity 20 % small"];
    assert_descriptions("scara", &[&lengths[..], &rest[..]].concat());
}

/// The two lengths differ by 4 cm, which this motion does not distinguish from noise.
#[test]
#[ignore = "some twenty seconds; the other arms' are quick"]
fn wrong_descriptions_of_a_ur10e_do_not_pass() {
    assert_descriptions("ur10e, standard DH", &["second d 20 % long", "lengths swapped"]);
}

#[test]
fn healthy_cold_arms_raise_nothing_at_any_rate() {
    for arm in arms() {
        for (seed, rate) in [(1, 50.0), (2, 100.0), (3, 500.0)] {
            assert_healthy(&arm, seed, rate);
        }
    }
}

#[test]
#[ignore = "minutes: every arm at four rates with 20 seeds, or as many as ARMWATCH_SEEDS says"]
fn healthy_cold_arms_raise_nothing_in_twenty_seeds() {
    let seeds = std::env::var("ARMWATCH_SEEDS").map_or(20, |text| text.parse().expect("a whole number"));
    for arm in arms() {
        for rate in [50.0, 100.0, 250.0, 500.0] {
            (1..=seeds).for_each(|seed| assert_healthy(&arm, seed, rate));
        }
    }
}

#[track_caller]
fn assert_healthy(arm: &Arm, seed: u64, rate: f64) {
    let mut samples = excitation(&arm.robot, seed, rate);
    if seed.is_multiple_of(2) {
        samples.velocity = None;
    }
    let verdict = verdict(&analysed(&arm.robot, &samples));
    assert!(verdict.starts_with("PASSES"), "{} at {rate} Hz, seed {seed}: {verdict}", arm.name);
}

/// Writes a recording of a six-joint arm in the form of a controller's export.
fn export(path: &std::path::Path, samples: &Samples) {
    let mut writer = ExportWriter::create(path, samples.joint_count()).expect("an export");
    for row in 0..samples.rows() {
        let of = |channels: &[Vec<f64>]| {
            let mut values = [0.0; MAX_JOINTS];
            values.iter_mut().zip(channels).for_each(|(value, channel)| *value = channel[row]);
            values
        };
        let row = RecordedRow {
            time: samples.time[row],
            position: of(&samples.position),
            velocity: of(samples.velocity.as_deref().expect("velocities")),
            torque: of(&samples.torque),
            stage: samples.stage[row],
            cycle: 1,
            signal: None,
            motor_temperature: [0.0; MAX_JOINTS],
            ambient_temperature: 0.0,
        };
        writer.push(&row).expect("a row");
    }
    writer.finish().expect("an export");
}

/// A name, a change of a good recording, and the expected words of the cycle.
type Told = (&'static str, fn(&mut Samples), &'static [&'static str]);

const REFUSED: &[Told] = &[
    ("Late", |s| delayed(s, 0.04), &["torques come", "ms after the motion", "record all channels"]),
    ("Swapped", |s| s.torque.swap(0, 1), &["joints 1 and 2", "swapped"]),
    ("Degrees", |s| units(s, DEGREES, DEGREES), &["joint 1", "degrees read as radians", "export layout"]),
    ("Tiny", |s| units(s, 1.0 / DEGREES, 1.0 / DEGREES), &["radians read as degrees", "export layout"]),
    ("Percent", |s| percent(s), &["each torque has a unit of its own", "percent of rated"]),
    ("Marker", |s| s.torque[3][700] = -9999.0, &["joint 4", "torque is -9999 Nm at 7.000 s"]),
    ("Ceiling", shortened, &["contradict the description", "gravity_m_s2 = [0.00, 0.00, -9.81]"]),
];

fn percent(samples: &mut Samples) {
    samples.torque.iter_mut().zip(RATED).for_each(|(t, rated)| scale(t, 100.0 / rated));
}

/// Removes the last row: one content is one run, and the sound recording is another.
fn shortened(samples: &mut Samples) {
    *samples = samples.take_front(samples.rows() - 1);
}

/// Every row twice, as from a logger that is faster than the controller.
fn doubled(samples: &mut Samples) {
    let twice = |channels: &mut Vec<Vec<f64>>| {
        channels.iter_mut().for_each(|channel| {
            (1..channel.len()).step_by(2).for_each(|row| channel[row] = channel[row - 1])
        });
    };
    twice(&mut samples.position);
    twice(&mut samples.torque);
    samples.velocity.iter_mut().for_each(twice);
}

#[test]
fn refusals_and_doubts_are_sentences_in_the_view_of_cycles() {
    let workshop = Workshop::new();
    let description =
        std::fs::read_to_string(format!("{}/config/robots/er3a.toml", env!("CARGO_MANIFEST_DIR")));
    let ceiling = description
        .expect("a description")
        .replace("gravity_m_s2 = [0, 0, -9.81]", "gravity_m_s2 = [0, 0, 9.81]");
    std::fs::write(workshop.path("ceiling.toml"), ceiling).expect("a description");
    let layout = format!("{}/config/exports/native.toml", env!("CARGO_MANIFEST_DIR"));
    let special =
        format!("[[robot]]\nname = \"Ceiling\"\ndescription = \"ceiling.toml\"\nlayout = \"{layout}\"\n\n");
    workshop.configure(|config| config.replacen("[[robot]]", &format!("{special}[[robot]]"), 1));
    let healthy = excitation(&shipped("er3a"), 3, 100.0);
    let sound: [Told; 2] = [("Doubled", doubled, &["rows repeat the row before"]), ("Sound", |_| {}, &[])];
    for (name, spoil, _) in REFUSED.iter().chain(&sound) {
        let mut samples = healthy.clone();
        spoil(&mut samples);
        export(&workshop.inbox(&format!("{name}_20260105_0847.csv")), &samples);
    }
    let out = workshop.stdout(&["ingest", "inbox"], 1);
    let told = format!(" {} without result; ", REFUSED.len());
    assert!(out.contains(&told), "{out}");
    let cell = |robot: &str, column: &str| {
        workshop.query(&format!("SELECT COALESCE({column}, '') FROM cycles WHERE robot = '{robot}'")).concat()
    };
    let parameters = |robot: &str| {
        workshop.number(&format!("SELECT COUNT(*) FROM cycle_parameters WHERE robot = '{robot}'"))
    };
    for (name, _, said) in REFUSED {
        let reason = cell(name, "reason");
        said.iter().for_each(|said| assert!(reason.contains(said), "{name}: \"{said}\" is not in {reason}"));
        assert_eq!(parameters(name), 0, "{name}");
    }
    assert!(
        cell("Doubled", "remarks").contains("rows repeat the row before"),
        "{}",
        cell("Doubled", "remarks")
    );
    assert_eq!((cell("Sound", "reason").as_str(), parameters("Sound")), ("", 64));
    assert!(!cell("Sound", "remarks").contains("joint"), "{}", cell("Sound", "remarks"));
}

#[test]
fn accepted_cycles_count_and_are_marked() {
    let workshop = Workshop::new();
    let mut samples = excitation(&shipped("er3a"), 3, 100.0);
    export(&workshop.inbox("Sound_20260105_0847.csv"), &samples);
    delayed(&mut samples, 0.04);
    export(&workshop.inbox("Late_20260105_0847.csv"), &samples);
    let wrong = workshop.stderr(&["ingest", "inbox", "--accept", "late_torq"], 2);
    assert!(wrong.contains("'late_torque'"), "a name that was meant");
    workshop.stdout(&["ingest", "inbox", "--accept", "late_torque"], 0);
    let count = |table: &str, robot: &str| {
        workshop.number(&format!("SELECT COUNT(*) FROM {table} WHERE robot = '{robot}'"))
    };
    let row = |robot: &str| {
        workshop.query(&format!("SELECT status, remarks FROM cycles WHERE robot = '{robot}'")).concat()
    };
    assert!(row("Sound").starts_with("complete"), "{}", row("Sound"));
    let late = row("Late");
    assert!(late.starts_with("complete") && late.contains("accepted: the torques come 40 ms"), "{late}");
    assert_eq!((count("cycle_parameters", "Late"), count("cycle_parameters", "Sound")), (64, 64));
    assert_eq!(count("cycle_rmsd", "Late"), count("cycle_rmsd", "Sound"));
    let watched = |robot: &str| {
        count("fleet_health", &format!("{robot}' AND moving_relative_rmsd IS NOT NULL AND '' = '"))
    };
    assert_eq!((watched("Late"), watched("Sound")), (6, 6));
    assert_eq!(count("anomalies", "Late' AND message LIKE '%gave no result%"), 0);
    let run = workshop.number("SELECT run_id FROM runs WHERE robot = 'Late'").to_string();
    assert_taken(&workshop, &run, "accepted: the torques come 40 ms");
}

/// Asserts that every command with a run accepts this one and prints the reason for the doubt.
fn assert_taken(workshop: &Workshop, run: &str, why: &str) {
    let commands: [&[&str]; 5] = [
        &["identify", "--run", run],
        &["identify", "--run", run, "--each-cycle"],
        &["verify", "--parameters", run, "--against", run],
        &["robot", "urdf", "--run", run, "-o", "arm.urdf"],
        &["robot", "code", "--run", run, "--language", "python", "-o", "code"],
    ];
    for command in commands {
        let out = workshop.run(command);
        let told = String::from_utf8_lossy(&out.stderr);
        assert!(matches!(out.status.code(), Some(0 | 1)), "{command:?}: {told}");
        assert!(told.contains("used in spite of findings") && told.contains(why), "{command:?}: {told}");
    }
}

#[test]
fn a_refused_run_is_used_if_it_is_named() {
    let workshop = Workshop::new();
    let mut samples = excitation(&shipped("er3a"), 3, 100.0);
    delayed(&mut samples, 0.04);
    export(&workshop.inbox("Late_20260105_0847.csv"), &samples);
    workshop.stdout(&["ingest", "inbox"], 1);
    assert_taken(&workshop, "1", "the torques come 40 ms");
    let out = workshop.run(&["identify", "--robot", "Late"]);
    let told = String::from_utf8_lossy(&out.stderr);
    assert!(told.contains("no usable cycle is left") && told.contains("the torques come 40 ms"), "{told}");
}

#[test]
fn real_recordings_raise_no_doubt() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    workshop.stdout(&["ingest", "inbox"], 0);
    let (export, config) = (reference("tx40/TX40_0000-4000ms_5kHz.csv.gz"), reference("tx40/armwatch.toml"));
    let [export, config] = [&export, &config].map(|path| path.to_str().expect("a path"));
    workshop.stdout(&["ingest", export, "--config", config, "--db", "armwatch.db"], 0);
    let doubted = workshop.query(
        "SELECT remarks FROM cycles WHERE remarks LIKE '%contradict%' OR remarks LIKE '%torques come%'",
    );
    assert_eq!(doubted, [""; 0]);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycles WHERE reason IS NULL OR reason = ''"), 6);
}

/// Most wrong recordings and descriptions of all arms and rates that pass without a remark: those of
/// docs/estimators.md. Recordings without velocity columns cannot have wrong ones and do not count.
const MOST_UNNOTICED: usize = 53;

/// Prints the result of each wrong recording and description, and checks the number of those that pass:
/// `cargo test --test integration -- --ignored --nocapture wrong_recordings::matrix`.
#[test]
#[ignore = "a minute: 780 analyses of all arms and rates"]
fn matrix() {
    let mut unnoticed = 0;
    for arm in arms() {
        for (rate, with_velocity) in [(50.0, true), (100.0, false), (250.0, true), (500.0, false)] {
            let mut samples = excitation(&arm.robot, 1, rate);
            if !with_velocity {
                samples.velocity = None;
            }
            println!("# {}, {rate} Hz, velocity columns: {with_velocity}", arm.name);
            let healthy = verdict(&analysed(&arm.robot, &samples));
            println!("healthy | {healthy}");
            assert!(healthy.starts_with("PASSES"), "{}, {rate} Hz: {healthy}", arm.name);
            let mut tell = |name: &str, said: String| {
                println!("{name} | {said}");
                let is_there = with_velocity || !name.to_lowercase().contains("velocit");
                unnoticed += usize::from(is_there && said.starts_with("PASSES"));
            };
            for wrong in WRONG_DESCRIPTIONS {
                let Some(described) = (wrong.spoil)(&arm.robot) else { continue };
                tell(wrong.name, verdict(&analysed(&described, &samples)));
            }
            for wrong in WRONG_RECORDINGS {
                let mut spoilt = samples.clone();
                (wrong.spoil)(&mut spoilt, arm.robot.joint_count());
                tell(wrong.name, verdict(&analysed(&arm.robot, &spoilt)));
            }
        }
    }
    assert!(unnoticed <= MOST_UNNOTICED, "{unnoticed} pass without a word");
}
