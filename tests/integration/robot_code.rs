//! `armwatch robot code`: the code compiles, and its torques agree with those of this program and of another one.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{Workshop, reference, text};
use armwatch::robot_code::code::TorqueCode;
use armwatch::robot_code::language::CodeLanguage;
use armwatch::robot_code::origin::CodeOrigin;
use armwatch::robot_code::torque::CodeParameter;
use armwatch_config::read_robot;
use armwatch_model::robot::{ParameterId, Robot};

/// Rounding of some hundred operations, as a part of the joint's largest torque.
const ROUNDING: f64 = 1e-12;

/// The reference has twelve digits; a sum over the chain loses some of them.
const REFERENCE_DIGITS: f64 = 1e-9;

const LANGUAGES: [&str; 6] = ["--language", "c", "--language", "rust", "--language", "python"];

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

fn shipped(name: &str) -> String {
    format!("{}/config/robots/{name}.toml", env!("CARGO_MANIFEST_DIR"))
}

/// A program of this name, if it can be started.
fn found(program: impl Into<PathBuf>) -> Option<PathBuf> {
    let program = program.into();
    let starts = Command::new(&program).arg("--version").output().is_ok_and(|output| output.status.success());
    starts.then_some(program)
}

/// The Rust compiler next to cargo.
fn rustc() -> Option<PathBuf> {
    let cargo = std::env::var_os("CARGO").map(PathBuf::from).or(option_env!("CARGO").map(PathBuf::from))?;
    found(cargo.with_file_name("rustc")).or_else(|| found("rustc"))
}

/// Compiles and runs the self-check of a folder; prints a line and returns `None` without a compiler.
fn self_check(folder: &Path, language: CodeLanguage) -> Option<(Option<i32>, String)> {
    let compiled = |command: &mut Command| {
        let output = command.current_dir(folder).output().expect("the compiler starts");
        let said = text(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{language:?} in {}: {said}", folder.display());
        Command::new(folder.join("self_check"))
    };
    let mut command = match language {
        CodeLanguage::C => {
            let sources = fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.path());
            let sources: Vec<PathBuf> =
                sources.filter(|path| path.extension().is_some_and(|ending| ending == "c")).collect();
            let flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-o", "self_check"];
            found("cc").map(|cc| compiled(Command::new(cc).args(flags).args(sources).arg("-lm")))
        }
        CodeLanguage::Rust => rustc().map(|rustc| {
            let flags = ["--edition", "2021", "-D", "warnings", "-o", "self_check", "self_check.rs"];
            compiled(Command::new(rustc).args(flags))
        }),
        CodeLanguage::Python => found("python3").map(|python| {
            let mut command = Command::new(python);
            command.args(["-B", "self_check.py"]);
            command
        }),
    }
    .or_else(|| {
        println!("skipped: no compiler or interpreter for {}", language.name());
        None
    })?;
    let output = command.current_dir(folder).output().expect("the self-check starts");
    Some((output.status.code(), text(&output.stdout) + &text(&output.stderr)))
}

/// A value from the output of a self-check.
fn figure(printed: &str, name: &str) -> f64 {
    let line = printed.lines().find_map(|line| line.strip_prefix(name)).expect(name);
    line.trim().parse().expect("a number")
}

/// The self-checks of all languages agree with the vectors.
pub fn assert_agrees(folder: &Path) {
    for language in CodeLanguage::ALL {
        let Some((status, printed)) = self_check(folder, language) else { continue };
        assert_eq!(status, Some(0), "{language:?}: {printed}");
        assert_eq!(figure(&printed, "states"), 320.0);
        let worst = figure(&printed, "largest_relative_difference");
        assert!((0.0..ROUNDING).contains(&worst), "{language:?}: {printed}");
        assert!(figure(&printed, "ns_per_call") > 0.0, "{language:?}: {printed}");
    }
}

fn generated(folder: &Path) -> Vec<(PathBuf, String)> {
    let names = ["er3a_torque.h", "er3a_torque.c", "er3a_torque.rs", "er3a_torque.py", "vectors.csv"];
    names.iter().map(|name| (name.into(), fs::read_to_string(folder.join(name)).expect(name))).collect()
}

#[test]
fn an_identified_arm_becomes_code_that_gives_its_torques() {
    let workshop = Workshop::new();
    workshop.simulate("inbox", &["--cycles", "2", "--warming-s", "0"]);
    workshop.stdout(&["ingest", "inbox"], 0);
    let arguments = [&["robot", "code", "--run", "1", "-o", "code", "--json"], &LANGUAGES[..]].concat();
    let told = json(&workshop.stdout(&arguments, 0));
    assert_eq!((&told["joints"], &told["parameters"]), (&6.into(), &64.into()));
    assert!(told["largest_relative_difference"].as_f64().expect("a number") < ROUNDING, "{told}");
    let folder = workshop.path("code");
    assert_agrees(&folder);
    let files = generated(&folder);
    for said in [
        "robot R01, run 1, recorded 2026-01-05T08:47:00Z, cycles 1-2",
        "armwatch 0.",
        "of friction at minute",
        "a_0 = -gravity",
        "f1 sign(v) + f2 v + f3 v^2 sign(v) + f4 v^3",
    ] {
        assert!([0, 2, 3].iter().all(|&at: &usize| files[at].1.contains(said)), "{said}\n{}", files[0].1);
    }
    assert!(files[1].1.contains("; J2_mPx + 0.27 J3_m"), "{}", files[1].1);

    // a second run, and one from a saved set of the same cycles, give the same bytes
    workshop.stdout(&arguments, 0);
    assert_eq!(generated(&folder), files);
    workshop.stdout(&["identify", "--run", "1", "--save", "both"], 0);
    let of_set = [&["robot", "code", "--parameters", "both", "-o", "set"], &LANGUAGES[..]].concat();
    workshop.stdout(&of_set, 0);
    assert_eq!(generated(&workshop.path("set")), files);

    python_takes_numbers_of_numpy(&folder);
    friction_follows_the_warmth(&workshop);
    a_wrong_constant_is_found(&folder);
    what_cannot_be_is_said(&workshop);
}

/// Comparisons of numpy's numbers give truth values that do not support arithmetic.
fn python_takes_numbers_of_numpy(folder: &Path) {
    const CALL: &str = "
import er3a_torque

class Truth:
    def __init__(self, value): self.value = value
    def __bool__(self): return self.value

class Number(float):
    def __gt__(self, other): return Truth(float(self) > other)
    def __lt__(self, other): return Truth(float(self) < other)

q, v = [0.1] * 6, [0.3, -0.2, 0.0, 0.1, -0.4, 0.5]
assert er3a_torque.torque(q, [Number(x) for x in v], q) == er3a_torque.torque(q, v, q)
";
    let Some(python) = found("python3") else {
        println!("skipped: there is no python3");
        return;
    };
    let output = Command::new(python).args(["-B", "-c", CALL]).current_dir(folder).output().expect("python3");
    assert!(output.status.success(), "{}", text(&output.stderr));
}

/// A value of a constant of generated Rust.
fn constant(source: &str, name: &str) -> f64 {
    let line =
        source.lines().find_map(|line| line.strip_prefix(&format!("const {name}: f64 = "))).expect(name);
    line.split(';').next().expect("a value").parse().expect("a number")
}

fn friction_follows_the_warmth(workshop: &Workshop) {
    let at = [
        "robot",
        "code",
        "--run",
        "1",
        "--language",
        "rust",
        "-o",
        "cold",
        "--friction-minute",
        "0.5",
        "--json",
    ];
    let told = json(&workshop.stdout(&at, 0));
    let usual = fs::read_to_string(workshop.path("code/er3a_torque.rs")).expect("the source");
    let cold = fs::read_to_string(workshop.path("cold/er3a_torque.rs")).expect("the source");
    for joint in 1..=6 {
        let factor = told["friction_factors"][joint - 1].as_f64().expect("a factor");
        assert!((1.0..2.0).contains(&factor), "a cold joint has more friction: {told}");
        for term in 1..=4 {
            let name = format!("J{joint}_F{term}");
            let (usual, cold) = (constant(&usual, &name), constant(&cold, &name));
            assert!((cold - factor * usual).abs() <= 1e-12 * cold.abs(), "{name}: {cold} {usual} {factor}");
        }
    }
    assert_eq!(constant(&usual, "J2_MPX"), constant(&cold, "J2_MPX"));
    assert!(cold.contains("at minute 0.5 of the recording"), "{cold}");
}

/// Checks that the self-checks can fail.
fn a_wrong_constant_is_found(folder: &Path) {
    let source = folder.join("er3a_torque.py");
    let right = fs::read_to_string(&source).expect("the source");
    let lines = right.lines().map(|line| match line.split_once(" = ") {
        Some(("J2_MPX", _)) => "J2_MPX = 3.25\n".to_owned(),
        _ => format!("{line}\n"),
    });
    fs::write(&source, lines.collect::<String>()).expect("written");
    if let Some((status, printed)) = self_check(folder, CodeLanguage::Python) {
        assert_eq!(status, Some(1), "{printed}");
        assert!(figure(&printed, "largest_relative_difference") > 1e-6, "{printed}");
    }
    fs::write(source, right).expect("written");
    let path = folder.join("vectors.csv");
    let right = fs::read_to_string(&path).expect("the vectors");
    for wrong in ["1.0", "nan"] {
        let lines = right.lines().enumerate().map(|(k, line)| match line.rsplit_once(',') {
            Some((others, _)) if k == 7 => format!("{others},{wrong}\n"),
            _ => format!("{line}\n"),
        });
        fs::write(&path, lines.collect::<String>()).expect("written");
        for language in CodeLanguage::ALL {
            let Some((status, printed)) = self_check(folder, language) else { continue };
            assert_eq!(status, Some(1), "{wrong}, {language:?}: {printed}");
        }
    }
    fs::write(path, right).expect("written");
}

fn what_cannot_be_is_said(workshop: &Workshop) {
    let (scara, ur10e) = (shipped("scara"), shipped("ur10e"));
    fs::create_dir(workshop.path("mine")).expect("a folder");
    fs::write(workshop.path("mine/er3a_torque.c"), "int main(void) { return 0; }\n").expect("written");
    for (arguments, said) in [
        (&["--run", "9", "-o", "none"][..], "there is no run 9; runs with cycles: 1"),
        (&["--run", "1", "--cycles", "7", "-o", "none"], "no cycle 7"),
        (&["--parameters", "cold", "-o", "none"], "not a saved parameter set"),
        (&["--run", "1", "--description", &scara, "-o", "none"], "not the one that the cycles were analysed"),
        (&["--run", "1", "--friction-minute", "5000", "-o", "none"], "give a minute from 0 to this"),
        (
            &["--description-only", "--description", &ur10e, "-o", "none"],
            "no nominal parameters of joints 1, 2",
        ),
        (&["--description-only", "-o", "none"], "--description"),
        (&["--run", "1", "-o", "mine"], "was not written by this command, so nothing is written"),
    ] {
        let output = workshop.stderr(&[&["robot", "code", "--language", "c"], arguments].concat(), 2);
        assert!(output.contains(said), "{arguments:?}: {output}");
    }
    assert!(!workshop.path("none").exists());
    assert_eq!(fs::read_dir(workshop.path("mine")).expect("a folder").count(), 1);
    workshop.stdout(&["robot", "code", "--run", "1", "--language", "c", "-o", "mine", "--force"], 0);
    assert!(workshop.path("mine/vectors.csv").exists());
}

/// Nominal parameters of the shipped ER3A without friction and motors, at the states of torques computed by Pinocchio.
#[test]
fn generated_code_agrees_with_pinocchio() {
    const COMPARE: &str = "\
import csv, sys
import er3a_torque as arm
worst = 0.0
rows = list(csv.DictReader(open(sys.argv[1])))
take = lambda row, name: [float(row[f'{name}_{j}']) for j in range(1, 7)]
inertia = [arm.J1_I_M, arm.J2_I_M, arm.J3_I_M, arm.J4_I_M, arm.J5_I_M, arm.J6_I_M]
scale = [max(abs(take(row, 'tau_nm')[j]) for row in rows) for j in range(6)]
for row in rows:
    q, qd, qdd, expected = (take(row, name) for name in ('q', 'qd', 'qdd', 'tau_nm'))
    friction = arm.friction(qd)
    for j, tau in enumerate(arm.torque(q, qd, qdd)):
        worst = max(worst, abs(tau - friction[j] - inertia[j] * qdd[j] - expected[j]) / scale[j])
print(len(rows), worst)
";
    let workshop = Workshop::new();
    let description = shipped("er3a");
    let arguments = ["robot", "code", "--description-only", "--description", &description, "-o", "nominal"];
    workshop.stdout(&[&arguments, &LANGUAGES[..]].concat(), 0);
    let folder = workshop.path("nominal");
    assert_agrees(&folder);
    let Some(python) = found("python3") else {
        println!("skipped: there is no python3 to compare with the torques of Pinocchio");
        return;
    };
    let table = reference("er3a_inverse_dynamics.csv");
    let output = Command::new(python)
        .args(["-B", "-c", COMPARE])
        .arg(table)
        .current_dir(folder)
        .output()
        .expect("python3");
    let said = text(&output.stdout);
    let (rows, worst) =
        said.trim().split_once(' ').unwrap_or_else(|| panic!("{said}{}", text(&output.stderr)));
    assert!(rows.parse::<usize>().expect("a count") >= 10, "{said}");
    assert!(worst.parse::<f64>().expect("a number") < REFERENCE_DIGITS, "{said}");
}

#[test]
fn a_sliding_joint_and_seven_joints_in_dh_tables_become_code() {
    let workshop = Workshop::new();
    fs::write(workshop.path("seven.toml"), seven_joints()).expect("written");
    let standard = reference("urdf/standard_dh.toml");
    let er3a = fs::read_to_string(shipped("er3a")).expect("a description");
    let palletiser = format!("{er3a}{}", include_str!("../fixtures/palletiser.toml"));
    fs::write(workshop.path("palletiser.toml"), palletiser).expect("written");
    for (folder, description) in [
        ("scara", Path::new(&shipped("scara"))),
        ("seven", Path::new("seven.toml")),
        ("standard", &standard),
        ("palletiser", Path::new("palletiser.toml")),
    ] {
        let description = description.to_str().expect("a path");
        let arguments = ["robot", "code", "--description-only", "--description", description, "-o", folder];
        workshop.stdout(&[&arguments, &LANGUAGES[..]].concat(), 0);
        assert_agrees(&workshop.path(folder));
    }
    let vectors = fs::read_to_string(workshop.path("scara/vectors.csv")).expect("vectors");
    assert!(vectors.lines().next().expect("a header").contains("q_3_m,"), "{vectors}");
    assert!(vectors.lines().next().expect("a header").contains("tau_3_n,tau_4_nm"), "{vectors}");
}

/// Seven joints with invented bodies, with some axes turned against each other by unusual angles.
fn seven_joints() -> String {
    fs::read_to_string(reference("seven_joints.toml")).expect("a description")
}

/// Every friction law, a motor that turns with two joints, and sensors after the gears, with invented parameters.
#[test]
fn every_friction_law_and_coupled_motors_become_code() {
    let workshop = Workshop::new();
    let tx40 = reads("config/robots/tx40.toml");
    assert!(!tx40.couplings.is_empty(), "the wrist of the TX40 is coupled");
    let laws = [
        "smooth\"\nsmooth_speed_rad_s = 0.1",
        "smooth\"\nsmooth_speed_rad_s = 0.2\nasymmetric = true",
        "viscous_coulomb\"\nload_friction = \"linear\"",
        "viscous_coulomb\"\nasymmetric = true\nload_friction = \"quadratic\"",
        "none",
        "polynomial\"\nload_friction = \"directional\"",
        "viscous_coulomb\"\nload_friction = \"stribeck\"\nload_speed_rad_s = 0.3",
    ];
    let text = seven_joints();
    let mut parts = text.split("\n[[joint]]\n");
    let mut mixed = parts.next().expect("a head").to_owned();
    for (part, law) in parts.zip(laws.into_iter().cycle()) {
        let law = if law.contains('"') { law.to_owned() } else { format!("{law}\"") };
        mixed += &format!("\n[[joint]]\nfriction_model = \"{law}\n{part}");
    }
    fs::write(workshop.path("mixed.toml"), &mixed).expect("written");
    fs::write(workshop.path("link.toml"), format!("torque_sensors = \"link\"\n{mixed}")).expect("written");
    let mixed = read_robot(&workshop.path("mixed.toml")).unwrap_or_else(|errors| panic!("{errors}"));
    let link = read_robot(&workshop.path("link.toml")).unwrap_or_else(|errors| panic!("{errors}"));
    for (name, robot) in [("tx40", tx40), ("mixed", mixed), ("link", link)] {
        let values = (1_u32..).map(|k| (f64::from(k) * 2_f64.sqrt()).fract() - 0.4);
        let parameter = |(id, value): (ParameterId, f64)| {
            let value = if value.abs() < 0.1 { 0.0 } else { value };
            CodeParameter { id, value, std_error: None, stands_for: None }
        };
        let parameters: Vec<CodeParameter> =
            ParameterId::natural_order(&robot).into_iter().zip(values).map(parameter).collect();
        let origin = CodeOrigin { program: "a test".into(), parameters: Vec::new(), friction: Vec::new() };
        let code = TorqueCode::new(&robot, &parameters, name, &origin);
        let folder = workshop.path(name);
        fs::create_dir(&folder).expect("a folder");
        for file in CodeLanguage::ALL.into_iter().flat_map(|language| code.files(language)) {
            fs::write(folder.join(file.name), file.text).expect("written");
        }
        assert_agrees(&folder);
    }
}

fn reads(path: &str) -> Robot {
    read_robot(&Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap_or_else(|errors| panic!("{errors}"))
}
