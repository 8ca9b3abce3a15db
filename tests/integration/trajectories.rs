//! `armwatch trajectory`: the tutorial `docs/first-arm.md`, from a description to parameters, and violated limits.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{Workshop, text};
use armwatch_config::read_robot;
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::model::dynamics::inverse_dynamics;
use armwatch_method::pooled::nominal_prior::nominal_base;
use armwatch_model::robot::{ParameterId, ParameterKind, Robot, StandardParameters};

fn page(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(name)).expect("the page")
}

/// Blocks of a language in the tutorial.
fn blocks(language: &str) -> Vec<String> {
    let mut found = Vec::new();
    for block in page("first-arm.md").split(&format!("```{language}\n")).skip(1) {
        found.push(block.split("```").next().expect("an end").to_owned());
    }
    found
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

#[test]
fn the_tutorial_leads_from_a_description_to_true_parameters() {
    let workshop = Workshop::new();
    let files = blocks("toml");
    fs::write(workshop.path("mine.toml"), &files[0]).expect("written");
    fs::write(workshop.path("mine-armwatch.toml"), &files[1]).expect("written");
    let commands: Vec<String> = blocks("console").iter().flat_map(|block| lines(block)).collect();
    assert!(commands.len() >= 10, "{commands:?}");
    for command in &commands {
        let words: Vec<&str> = command.split_whitespace().skip(2).collect();
        workshop.stdout(&words, 0);
    }
    assert!(fs::read_to_string(workshop.path("mine.svg")).expect("a picture").contains("</svg>"));

    // the parameters from ingest contain the description's base parameters
    let robot = read_robot(&workshop.path("mine.toml")).expect("the description");
    let base = base_parameters(&robot).expect("base parameters");
    let identified = crate::support::query(
        &workshop.path("mine.db"),
        "SELECT 'J' || joint || '_' || parameter || ' ' || value || ' ' || std_error FROM cycle_parameters",
    );
    let mut off = Vec::new();
    for row in &identified {
        let cells: Vec<&str> = row.split(' ').collect();
        let number = |k: usize| cells[k].parse::<f64>().expect("a number");
        let place = base.kept.iter().position(|id| id.to_string() == cells[0]).expect("a base parameter");
        // an offset of the torque signal is not described: the simulator has none
        let truth = nominal_base(&robot, &base)[place].unwrap_or(0.0);
        off.push((number(1) - truth).abs() / number(2));
    }
    assert_eq!(off.len(), 8 * base.kept.len());
    off.sort_by(f64::total_cmp);
    // half of all errors are within 0.67 standard errors; one of 112 beyond five is not chance
    assert!(off[off.len() / 2] < 1.2 && off[off.len() - 1] < 5.0, "{off:?}\n{identified:?}");

    the_least_addition_is_shorter_than_a_motion_of_its_own(&workshop);
    the_test_has_its_stages(&workshop);
    parts_of_a_test_stand_alone(&workshop);
    sines_alone_make_a_motion_too(&workshop);
    the_same_seed_gives_the_same_file(&workshop);
    broken_limits_are_named_and_not_written(&workshop);
}

/// Checks that parameters shown by a recording need no motion, and that more known ones never make the motion longer.
fn the_least_addition_is_shorter_than_a_motion_of_its_own(workshop: &Workshop) {
    let shape = [
        "trajectory",
        "design",
        "--robot",
        "mine.toml",
        "--harmonics",
        "2",
        "--seconds",
        "6",
        "--starts",
        "1",
    ];
    let beside = ["--beside-run", "1", "--config", "mine-armwatch.toml", "--json", "--precision"];
    let found = |precision: &str, more: &[&str]| {
        json(&workshop.stdout(&[&shape[..], &beside[..], &[precision], more].concat(), 0))
    };
    let (rough, fine) = (found("0.9", &[]), found("0.002", &["--beside-s", "1", "-o", "addition.json"]));
    let of = |value: &serde_json::Value, name: &str| -> Vec<f64> {
        let all = value["beside"]["parameters"].as_array().expect("parameters");
        all.iter().map(|of| of[name].as_f64().unwrap_or(f64::INFINITY)).collect()
    };
    assert_eq!(rough["beside"]["missed"], 0, "{rough}");
    for value in [&rough, &fine] {
        let (alone, together) =
            (of(value, "standard_deviation_alone"), of(value, "standard_deviation_together"));
        assert!(alone.len() > 8 && alone.iter().zip(&together).all(|(alone, with)| with < alone), "{value}");
    }
    // the recording has less weight, by the root of sixty
    let (known, less) = (of(&rough, "standard_deviation_alone"), of(&fine, "standard_deviation_alone"));
    assert!(known.iter().zip(&less).all(|(of60, of1)| (of1 / of60 / 60.0_f64.sqrt() - 1.0).abs() < 1e-6));
    let programme = json(&fs::read_to_string(workshop.path("addition.json")).expect("a programme"));
    assert_eq!(programme["search"]["beside"]["run"], 1);
    let conflicting =
        workshop.run(&[&shape[..], &["--beside-run", "1", "--objective", "condition"]].concat());
    assert_eq!(conflicting.status.code(), Some(2));
}

/// Blocks of the section on space: the shape of the links, and the cell.
fn shape_and_cell() -> [String; 2] {
    let page = page("trajectories.md");
    let section = page.split("## Space").nth(1).expect("the section");
    let mut blocks =
        section.split("```toml\n").skip(1).map(|block| block.split("```").next().expect("an end"));
    [(); 2].map(|()| blocks.next().expect("a block").to_owned())
}

#[test]
fn motions_keep_clear_of_the_arm_and_its_cell_and_keep_jerk_and_peak_torque() {
    let workshop = Workshop::new();
    let [shape, cell] = shape_and_cell();
    let mine = blocks("toml")[0].replacen("[[joint]]", &format!("{shape}\n[[joint]]"), 1);
    let limits = "jerk_max_deg_s3 = 3000\npeak_joint_torque_nm = 60\ngear_ratio = 100";
    fs::write(workshop.path("mine.toml"), mine.replace("gear_ratio = 100", limits)).expect("written");
    fs::write(workshop.path("cell.toml"), &cell).expect("written");
    let in_cell = ["--robot", "mine.toml", "--cell", "cell.toml", "--clearance-m", "0.032"];
    let design = ["trajectory", "design", "--harmonics", "3", "--seconds", "6", "--starts", "2", "--json"];
    let found = json(&workshop.stdout(&[&design[..], &in_cell, &["-o", "mine.json"]].concat(), 0));
    let clearances = found["clearances"].as_array().expect("clearances");
    // one pair of links, one link from three obstacles
    assert_eq!(clearances.len(), 4, "{found}");
    assert!(clearances.iter().all(|of| of["at_least_m"].as_f64() >= Some(0.032)), "{found}");
    for joint in found["limits"].as_array().expect("limits") {
        assert!(joint["jerk_share"].as_f64().is_some_and(|share| share > 0.1 && share <= 1.0), "{joint}");
    }
    for joint in found["torques"].as_array().expect("torques") {
        assert!(joint["torque_peak_nm"].as_f64() <= Some(60.0), "{joint}");
    }
    // without the cell and that distance the best motion is another, and is closer to the obstacles
    let free = ["--robot", "mine.toml", "-o", "free.json"];
    workshop.stdout(&[&design[..], &free].concat(), 0);
    let said = workshop.run(&[&["trajectory", "check", "free.json"], &in_cell[..]].concat());
    let (shown, hints) = (text(&said.stdout), text(&said.stderr));
    assert_eq!(said.status.code(), Some(1), "{shown}{hints}");
    assert!(shown.contains("BROKEN link 2 and ") && shown.contains("mm apart at"), "{shown}");

    let kept = workshop.stdout(&[&["trajectory", "check", "mine.json"], &in_cell[..]].concat(), 0);
    assert!(kept.contains("position, speed, acceleration, jerk, peak torque, clearance"), "{kept}");
    let export = ["trajectory", "export", "mine.json", "--rate-hz", "200", "-o", "mine.csv"];
    workshop.stdout(&[&export[..], &in_cell].concat(), 0);
    let sampled = workshop.stdout(&[&["trajectory", "check", "mine.csv"], &in_cell[..]].concat(), 0);
    assert!(sampled.contains("jerk, peak torque, clearance"), "{sampled}");
    let refused = workshop.run(&[&export[..2], &["free.json", "-o", "free.csv"], &in_cell[..]].concat());
    assert_eq!(refused.status.code(), Some(1));
    assert!(!workshop.path("free.csv").exists());

    // the whole test turns each joint over its range: it hits the post, and is not written
    let test = ["trajectory", "test", "--warming-s", "0", "--trajectory", "mine.json", "-o", "test.csv"];
    let refused = workshop.stderr(&[&test[..], &in_cell].concat(), 1);
    assert!(refused.contains("nothing is written"), "{refused}");
    assert!(!workshop.path("test.csv").exists());
    // without obstacles it keeps the jerk, and clears the column with the arm's own range
    let alone =
        workshop.run(&[&test[..], &["--robot", "mine.toml", "--json", "--despite-broken-limits"]].concat());
    let said = json(&text(&alone.stdout));
    for joint in said["joints"].as_array().expect("joints") {
        assert!(joint["jerk_share"].as_f64().is_some_and(|share| share > 0.5 && share <= 1.0), "{joint}");
    }

    // an arm inside a wall
    fs::write(
        workshop.path("above.toml"),
        "[[plane]]\nname = \"wall\"\npoint_m = [0, 0, 0.4]\nnormal = [0, 0, 1]\n",
    )
    .expect("written");
    let hopeless = ["--harmonics", "2", "--seconds", "4", "--starts", "1", "--cell", "above.toml"];
    let output =
        workshop.run(&[&["trajectory", "design", "--robot", "mine.toml"][..], &hopeless[..]].concat());
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("link 2 and wall (") && said.contains("middles of their ranges"), "{said}");

    for (name, contents, expected) in [
        ("empty.toml", "", "no obstacle"),
        ("wrong.toml", "[[box]]\ncentre_m = [0, 0, 0]\nsize_m = [1, 1]\n", "size_m"),
    ] {
        fs::write(workshop.path(name), contents).expect("written");
        let output =
            workshop.run(&["trajectory", "check", "mine.json", "--robot", "mine.toml", "--cell", name]);
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains(expected), "{}", text(&output.stderr));
    }
    let shapeless =
        workshop.run(&["trajectory", "check", "mine.json", "--robot", "er3a", "--cell", "cell.toml"]);
    assert!(text(&shapeless.stderr).contains("[[capsule]]"), "{}", text(&shapeless.stderr));
}

/// Samples of a programme at 1 kHz over its period: positions, velocities and accelerations `[rows][n]`, from the file.
fn states(programme: &serde_json::Value) -> Vec<[Vec<f64>; 3]> {
    let numbers = |of: &serde_json::Value| -> Vec<f64> {
        of.as_array().expect("a list").iter().map(|of| of.as_f64().expect("a number")).collect()
    };
    let joints: Vec<[Vec<f64>; 3]> = programme["joints"]
        .as_array()
        .expect("joints")
        .iter()
        .map(|joint| {
            let unit = if joint["type"] == "revolute" { "rad" } else { "m" };
            let of = |name: &str| &joint[format!("{name}_{unit}")];
            let per_second = |name: &str| numbers(&joint[format!("{name}_{unit}_s")]);
            [vec![of("centre").as_f64().expect("a centre")], per_second("a"), per_second("b")]
        })
        .collect();
    let frequency = programme["base_frequency_hz"].as_f64().expect("a frequency");
    let at = |t: f64| -> [Vec<f64>; 3] {
        let mut state: [Vec<f64>; 3] = Default::default();
        for [centre, a, b] in &joints {
            let (mut q, mut qd, mut qdd) = (centre[0], 0.0, 0.0);
            for (l, (a, b)) in (1..).zip(a.iter().zip(b)) {
                let w = std::f64::consts::TAU * frequency * f64::from(l);
                let (sine, cosine) = (w * t).sin_cos();
                q += (a * sine - b * cosine) / w;
                qd += a * cosine + b * sine;
                qdd += w * (b * cosine - a * sine);
            }
            state[0].push(q);
            state[1].push(qd);
            state[2].push(qdd);
        }
        state
    };
    (0..=(1000.0 / frequency) as u32).map(|k| at(f64::from(k) * 1e-3)).collect()
}

/// Condition number and rank by singular values of a matrix whose columns are torques of the recursive Newton-Euler
/// equations, one parameter 1 and all others 0. It is independent of the regressor and the search.
fn by_singular_values(robot: &Robot, states: &[[Vec<f64>; 3]]) -> (f64, usize) {
    let base = base_parameters(robot).expect("base parameters");
    let n = robot.joint_count();
    let chosen: Vec<_> = base
        .kept
        .iter()
        .filter(|id| matches!(id.kind, ParameterKind::Inertial(_) | ParameterKind::MotorInertia))
        .collect();
    let column = |id: &ParameterId| -> Vec<f64> {
        let mut tau = vec![0.0; n];
        let mut parameters = vec![StandardParameters([0.0; StandardParameters::COUNT]); n];
        let mut rows = Vec::with_capacity(n * states.len());
        for [q, qd, qdd] in states {
            match id.kind {
                ParameterKind::Inertial(k) => {
                    parameters[id.joint.index()].0[usize::from(k)] = 1.0;
                    inverse_dynamics(robot, &parameters, q, qd, qdd, &mut tau);
                }
                _ => {
                    tau.fill(0.0);
                    tau[id.joint.index()] = qdd[id.joint.index()];
                }
            }
            rows.extend_from_slice(&tau);
        }
        rows
    };
    let columns: Vec<_> = chosen.iter().map(|id| nalgebra::DVector::from_vec(column(id))).collect();
    let values = nalgebra::DMatrix::from_columns(&columns).singular_values();
    let (largest, smallest) = (values.max(), values.min());
    (largest / smallest, values.iter().filter(|value| **value > 1e-9 * largest).count())
}

/// Designs for five arms keep their limits at every millisecond, and have the printed condition number, at full rank.
/// `cargo test --test integration -- --ignored designs_for_five_arms`; programmes of longer searches are read from the
/// folder `ARMWATCH_PROGRAMMES`, as `er3a.json`, `tx40.json`, `ur10e.json`, `scara.json`, `seven_joints.json`.
#[test]
#[ignore = "needs programmes of five arms, which take minutes to search: ARMWATCH_PROGRAMMES"]
fn designs_for_five_arms_hold_by_a_second_road() {
    let workshop = Workshop::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let searched = std::env::var_os("ARMWATCH_PROGRAMMES").map(PathBuf::from);
    for name in ["er3a", "tx40", "ur10e", "scara", "seven_joints"] {
        let description = match name {
            "seven_joints" => root.join("tests/reference/seven_joints.toml"),
            _ => root.join(format!("config/robots/{name}.toml")),
        };
        let file = match &searched {
            Some(folder) => folder.join(format!("{name}.json")),
            None => {
                let file = workshop.path(&format!("{name}.json"));
                let (from, to) = (description.to_str().expect("a path"), file.to_str().expect("a path"));
                let budget = ["--budget-s", "20", "--rate-hz", "1000", "--json"];
                workshop
                    .stdout(&[&["trajectory", "design", "--robot", from, "-o", to], &budget[..]].concat(), 0);
                file
            }
        };
        let programme = json(&fs::read_to_string(&file).expect("a programme"));
        let robot = read_robot(&description).expect("a description");
        let states = states(&programme);
        // between samples a sum of N waves exceeds its largest sample by at most the factor 1 / cos(pi N / M) (Ehlich &
        // Zeller 1964)
        let waves =
            programme["joints"][0]["a_rad_s"].as_array().or(programme["joints"][0]["a_m_s"].as_array());
        let waves = waves.expect("amplitudes").len() as f64;
        let beyond = (std::f64::consts::PI * waves / (states.len() - 1) as f64).cos().recip();
        for (j, joint) in robot.joints.iter().enumerate() {
            let limits = &joint.limits;
            let middle = 0.5 * (limits.position_min + limits.position_max);
            for [q, qd, qdd] in &states {
                let off = beyond * (q[j] - middle).abs();
                assert!(off <= 0.5 * (limits.position_max - limits.position_min), "{name} {j} {q:?}");
                assert!(beyond * qd[j].abs() <= limits.velocity, "{name} {j}");
                assert!(beyond * qdd[j].abs() <= limits.acceleration, "{name} {j}");
            }
        }
        let (condition, rank) = by_singular_values(&robot, &states);
        let said = programme["search"]["condition_number"].as_f64().expect("a number");
        let count = programme["search"]["parameters"].as_array().expect("names").len();
        println!("{name}: condition number {condition:.4}, said {said:.4}, rank {rank} of {count}");
        assert_eq!(rank, count, "{name}");
        assert!((condition / said - 1.0).abs() < 2e-3, "{name}: {condition} {said}");
    }
}

fn lines(block: &str) -> Vec<String> {
    block.lines().filter(|line| line.starts_with("$ armwatch ")).map(str::to_owned).collect()
}

/// Checks that the file of a test has every stage with the stated length, every level of every joint, and no jump.
fn the_test_has_its_stages(workshop: &Workshop) {
    let shape =
        ["trajectory", "test", "--robot", "mine.toml", "--trajectory", "mine.json", "--levels", "2,3"];
    let more = ["--warming-s", "12", "--cycles", "2", "--rate-hz", "1000", "-o", "test.csv", "--json"];
    let said = json(&workshop.stdout(&[&shape[..], &more].concat(), 0));
    let mut reader = csv::Reader::from_path(workshop.path("test.csv")).expect("the file");
    let names: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column =
        |name: &str| names.iter().position(|of| of == name).unwrap_or_else(|| panic!("{name}: {names:?}"));
    let rows: Vec<Vec<f64>> = reader
        .records()
        .map(|row| row.expect("a row").iter().map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    let cycle = said["cycle_s"].as_f64().expect("a duration");
    assert!((rows.len() as f64 - 2000.0 * cycle).abs() <= 2.0, "{} rows, {cycle} s", rows.len());
    let of = |name: &'static str| {
        let at = column(name);
        rows.iter().map(move |row| row[at])
    };
    for (stage, number) in [("excitation", 1.0), ("friction", 2.0), ("warming", 3.0)] {
        let found = of("stage").filter(|value| *value == number).count() as f64 / 2000.0;
        let stages = said["stages"].as_array().expect("stages");
        let lasts =
            stages.iter().find(|of| of["stage"] == stage).expect(stage)["lasts_s"].as_f64().expect("s");
        assert!((found - lasts).abs() < 0.1, "{stage}: {found} s of {lasts}");
    }
    let mut signals: Vec<[u8; 3]> = of("cycle")
        .zip(of("joint"))
        .zip(of("level"))
        .filter(|((_, joint), _)| *joint > 0.0)
        .map(|((cycle, joint), level)| [cycle as u8, joint as u8, level as u8])
        .collect();
    signals.dedup();
    assert_eq!(signals.len(), 8, "{signals:?}");
    assert_eq!((signals[0], signals[7]), ([1, 1, 2], [2, 2, 3]));
    // velocities and accelerations match the positions: central differences over 2 ms
    for (q, qd) in [("pos_1_rad", "vel_1_rad_s"), ("vel_2_rad_s", "acc_2_rad_s2")] {
        let (q, qd): (Vec<f64>, Vec<f64>) = (of(q).collect(), of(qd).collect());
        let largest = qd.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let error = (1..q.len() - 1).map(|k| (500.0 * (q[k + 1] - q[k - 1]) - qd[k]).abs());
        assert!(error.fold(0.0, f64::max) < 0.1 * largest, "{largest}");
    }
    let refused = workshop.stderr(&[&shape[..7], &["9"]].concat(), 2);
    assert!(refused.contains("no speed level 9"), "{refused}");
}

/// Checks each part of the test alone, and refused combinations.
fn parts_of_a_test_stand_alone(workshop: &Workshop) {
    let of = |more: &[&str]| {
        let shape = ["trajectory", "test", "--robot", "mine.toml", "--json", "--parts"];
        json(&workshop.stdout(&[&shape[..], more].concat(), 0))
    };
    let lasts = |of: &serde_json::Value, stage: &str| {
        let stages = of["stages"].as_array().expect("stages");
        stages.iter().find(|of| of["stage"] == stage).and_then(|of| of["lasts_s"].as_f64())
    };
    let additional = of(&["additional", "-o", "additional.csv"]);
    assert!(lasts(&additional, "excitation").is_some_and(|s| s > 1.0), "{additional}");
    assert!(lasts(&additional, "friction").is_none() && lasts(&additional, "warming").is_none());
    // the motion near full speed reaches nearly that speed
    let joints = additional["joints"].as_array().expect("joints");
    assert!(joints.iter().all(|of| of["speed_share"].as_f64() > Some(0.9)), "{additional}");
    workshop.stdout(&["trajectory", "check", "additional.csv", "--robot", "mine.toml"], 0);

    fs::write(workshop.path("points.csv"), "pos_1_deg,pos_2\n-100,0.5\n90,-1\n0,1.2\n").expect("written");
    let points = of(&["points", "--points", "points.csv", "--dead-s", "1.5"]);
    // three rests and two moves of about a second each
    assert!(lasts(&points, "excitation").is_some_and(|s| s > 5.5 && s < 9.0), "{points}");

    let friction = of(&["friction", "--friction-posture", "still"]);
    let tests = friction["friction"].as_array().expect("friction");
    let still: Vec<bool> = tests.iter().map(|of| of["gravity_is_still"] == true).collect();
    assert_eq!(still, [true, false], "the second axis is level wherever the first one turns: {friction}");
    assert_eq!(tests[0]["levels"].as_array().map(Vec::len), Some(3));
    assert!(tests[0]["levels"][0]["plateau_s"].as_f64() > Some(0.3), "{friction}");

    fs::write(workshop.path("far.csv"), "pos_1,pos_2\n0,0\n9,0\n").expect("written");
    for (more, said) in [
        (&["series", "--points", "points.csv"][..], "--points requires the part points"),
        (&["points", "--points", "far.csv"][..], "point 2: joint 1 at 9"),
        (&["other"][..], "possible values"),
    ] {
        let output =
            workshop.run(&[&["trajectory", "test", "--robot", "mine.toml", "--parts"][..], more].concat());
        assert_eq!(output.status.code(), Some(2), "{more:?}");
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    }
}

/// The harmonic sine form [4.1].
fn sines_alone_make_a_motion_too(workshop: &Workshop) {
    let shape = ["trajectory", "design", "--robot", "mine.toml", "--harmonics", "4", "--seconds", "6"];
    let more = ["--starts", "1", "--form", "harmonic-sine", "--json", "-o", "sines.json"];
    let said = json(&workshop.stdout(&[&shape[..], &more].concat(), 0));
    assert_eq!(said["search"]["form"], "harmonic-sine");
    assert!(said["condition_number"].as_f64().is_some_and(|of| of < 100.0), "{said}");
    let changes = &said["smallest_changes"];
    assert_eq!((&changes["wear"]["size"], &changes["load"]["size_kg"]), (&0.04.into(), &0.5.into()));
    // one false alarm per year in daily tests of two joints: 17 channels
    let alpha = changes["false_alarm_probability"].as_f64().expect("a probability");
    assert!((alpha * 365.25 * 17.0 - 1.0).abs() < 1e-9, "{alpha}");
    for seen in changes["wear"]["seen_in_one_test"].as_array().expect("joints") {
        assert!(seen.as_f64().is_some_and(|of| (0.0..=1.0).contains(&of)), "{changes}");
    }
    let programme = json(&fs::read_to_string(workshop.path("sines.json")).expect("a programme"));
    for joint in programme["joints"].as_array().expect("joints") {
        assert!(joint["b_rad_s"].as_array().expect("b").iter().all(|b| b.as_f64() == Some(0.0)), "{joint}");
    }
    workshop.stdout(&["trajectory", "check", "sines.json", "--robot", "mine.toml"], 0);
    let other = workshop.run(&[&shape[..], &["--resume", "sines.json"]].concat());
    assert!(text(&other.stderr).contains("another form"), "{}", text(&other.stderr));
}

fn the_same_seed_gives_the_same_file(workshop: &Workshop) {
    let shape = ["trajectory", "design", "--robot", "mine.toml", "--harmonics", "2", "--seconds", "6"];
    let run = |more: &[&str]| json(&workshop.stdout(&[&shape[..], more, &["--json"]].concat(), 0));
    let one = run(&["--starts", "2", "--threads", "1", "-o", "one.json"]);
    run(&["--starts", "2", "--threads", "2", "-o", "two.json"]);
    let read = |name: &str| fs::read_to_string(workshop.path(name)).expect("a programme");
    assert_eq!(read("one.json"), read("two.json"));
    assert_eq!(one["search"]["starts"], 2);
    assert!(one["parameters"].as_array().is_some_and(|of| of.len() > 8), "{one}");
    assert!(one["smallest_changes"]["load_kg"].as_f64().is_some_and(|load| load > 0.0), "{one}");
    // by time: at least one start, and the file has their number
    let timed = run(&["--budget-s", "0", "-o", "timed.json"]);
    assert_eq!(timed["search"]["starts"], 1);
    run(&["--starts", "1", "-o", "again.json"]);
    assert_eq!(read("timed.json"), read("again.json"));
}

fn broken_limits_are_named_and_not_written(workshop: &Workshop) {
    let slow = fs::read_to_string(workshop.path("mine.toml")).expect("a description");
    let slow = slow.replacen("velocity_max_deg_s = 180", "velocity_max_deg_s = 20", 1);
    fs::write(workshop.path("slow.toml"), slow).expect("written");
    for file in ["mine.json", "mine.csv"] {
        let found =
            json(&workshop.stdout(&["trajectory", "check", file, "--robot", "slow.toml", "--json"], 1));
        let broken = found["broken"].as_array().expect("a list");
        assert_eq!(broken.len(), 1, "{found}");
        assert_eq!((&broken[0]["joint"], &broken[0]["quantity"]), (&1.into(), &"speed".into()));
        let limit = 20.0_f64.to_radians();
        assert!((broken[0]["limit"].as_f64().expect("a limit").abs() - limit).abs() < 1e-9, "{found}");
        let (value, excess) = (broken[0]["value"].as_f64(), broken[0]["excess"].as_f64());
        assert!((value.expect("a value").abs() - limit - excess.expect("an excess")).abs() < 1e-9);
        let shown = workshop.stdout(&["trajectory", "check", file, "--robot", "slow.toml"], 1);
        assert!(shown.contains("BROKEN joint 1: speed") && shown.contains("rad/s"), "{shown}");
    }
    let export = ["trajectory", "export", "mine.json", "--robot", "slow.toml", "-o", "slow.csv"];
    let refused = workshop.stderr(&export, 1);
    assert!(refused.contains("--despite-broken-limits"), "{refused}");
    assert!(!workshop.path("slow.csv").exists());
    workshop.stdout(&[&export[..], &["--despite-broken-limits", "--waypoints"]].concat(), 0);
    let written = fs::read_to_string(workshop.path("slow.csv")).expect("a file");
    assert!(written.starts_with("time_s,pos_1_rad,vel_1_rad_s,pos_2_rad,vel_2_rad_s\n"), "{written}");
    // another arm, and a name that matches only the pattern of every robot
    for (arguments, said) in [
        (["trajectory", "check", "mine.json", "--robot", "er3a"], "has 6 joints"),
        (["trajectory", "check", "mine.json", "--robot", "er3b"], "write its model, --robot er3a"),
        (["trajectory", "check", "nothing.json", "--robot", "er3a"], "there is no such file or folder"),
    ] {
        let output = workshop.stderr(&arguments, 2);
        assert!(output.contains(said), "{output}");
    }
    let programme = fs::read_to_string(workshop.path("mine.json")).expect("a programme");
    let over =
        workshop.run(&["trajectory", "export", "mine.json", "--robot", "mine.toml", "-o", "mine.json"]);
    assert_eq!(over.status.code(), Some(2));
    assert!(text(&over.stderr).contains("is the programme itself"), "{}", text(&over.stderr));
    assert_eq!(fs::read_to_string(workshop.path("mine.json")).expect("as it was"), programme);
}
