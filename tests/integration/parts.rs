//! Recordings in several files, joints without a torque channel, and two arms in one export.

use std::fs;
use std::path::Path;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::canon::assert_sound;
use crate::small::{self, Export, export};
use crate::support::{Workshop, assert_alike, pass, text};

/// Writes the shipped layout with changes, and the configuration that names it.
fn with_layout(workshop: &Workshop, change: impl FnOnce(String) -> String) {
    let native = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/exports/native.toml");
    fs::write(workshop.path("own.toml"), change(fs::read_to_string(native).expect("a layout")))
        .expect("written");
    workshop.use_file("layout", "own.toml");
}

/// Results of a run, independent of the name of its file.
fn results(workshop: &Workshop) -> String {
    let of = |view: &str, columns: &str| {
        workshop.query(&format!("SELECT {columns} FROM {view} ORDER BY {columns}")).join("\n")
    };
    [
        of("runs", "robot, started_at, rows, sample_rate_hz, cycles, status"),
        of("cycles", "cycle, started_at, duration_s, rows, status, reason, remarks"),
        of("cycle_parameters", "cycle, parameter, joint, value, std_error"),
        of("cycle_rmsd", "cycle, joint, stage, verification, rmsd_nm, samples"),
        of("friction_points", "cycle, minute, joint, speed_fraction, direction, torque_nm, std_nm"),
        of("warmup_fits", "joint, speed_fraction, model, a_nm, b_nm, t1_min"),
    ]
    .join("\n")
}

/// Results of the export as one file.
fn results_of_one_file(export: &Export) -> String {
    let workshop = small::workshop();
    workshop.add(export);
    workshop.stdout(&["ingest", "inbox"], 0);
    results(&workshop)
}

/// The export in three parts of its rows, each with the header. The second and third begin within a cycle.
fn rows_in_parts(export: &Export) -> Vec<(String, Vec<u8>)> {
    let lines = export.lines();
    let (header, rows) = lines.split_first().expect("a header");
    let [a, b] = [rows.len() * 2 / 5, rows.len() * 3 / 4];
    let stem = export.name.strip_suffix(".csv").expect("text");
    let part = |(number, rows): (usize, &[&[u8]])| {
        (format!("{stem}_part{number}.csv"), [header, rows.concat().as_slice()].concat())
    };
    [&rows[..a], &rows[a..b], &rows[b..]].into_iter().enumerate().map(part).collect()
}

/// Some columns of an export, by name.
fn columns(export: &Export, is_wanted: impl Fn(&str) -> bool) -> Vec<u8> {
    let all = text(&export.bytes);
    let header: Vec<&str> = all.lines().next().expect("a header").split(',').collect();
    let line = |line: &str| {
        let cells = line.split(',').zip(&header).filter(|(_, name)| is_wanted(name));
        cells.map(|(cell, _)| cell).collect::<Vec<_>>().join(",") + "\n"
    };
    all.lines().map(line).collect::<String>().into_bytes()
}

#[test]
fn a_part_that_continues_a_recording_joins_its_run_and_supersedes_nothing() {
    let export = export("P", 31, 5);
    let expected = results_of_one_file(&export);
    let parts = rows_in_parts(&export);
    // all in one command
    let workshop = small::workshop();
    for (name, bytes) in &parts {
        fs::write(workshop.inbox(name), bytes).expect("written");
    }
    let said = workshop.stdout(&["ingest", "inbox"], 0);
    assert_alike(&results(&workshop), &expected, "all at once");
    assert!(said.contains("1 stored, 0 known"), "{said}");
    assert!(workshop.stdout(&["ingest", "inbox"], 0).contains("0 stored, 1 known"));
    // one command after the other
    let workshop = small::workshop();
    for (name, bytes) in &parts {
        fs::write(workshop.inbox(name), bytes).expect("written");
        workshop.stdout(&["ingest", &format!("inbox/{name}")], 0);
    }
    assert_alike(&results(&workshop), &expected, "one by one");
}

/// The export in two parts that follow each other, the second from within a cycle on, or in two of its channels.
fn two_parts(export: &Export, by_channel: bool) -> [(String, Vec<u8>); 2] {
    let stem = export.name.strip_suffix(".csv").expect("text");
    if by_channel {
        let is_torque = |name: &str| name.starts_with("trq");
        return [
            (format!("{stem}_pos.csv"), columns(export, |name| !is_torque(name))),
            (format!("{stem}_trq.csv"), columns(export, |name| name == "time" || is_torque(name))),
        ];
    }
    let lines = export.lines();
    let half = lines.len() * 2 / 5;
    [
        (format!("{stem}_part0.csv"), lines[..half].concat()),
        (format!("{stem}_part1.csv"), [lines[0], &lines[half..].concat()].concat()),
    ]
}

/// Writes recordings in two parts, piece by piece, while daemons are killed, until there were `kills` kills. All views then
/// have the rows of a command that read the parts undisturbed.
fn kills_between_two_parts(kills: usize, seed: u64, by_channel: bool) {
    /// Kills of a round: two recordings of two parts, each in three pieces.
    const OF_A_ROUND: usize = 12;
    let with_parts = || {
        let workshop = small::workshop();
        if by_channel {
            with_layout(&workshop, |native| {
                format!("{native}\n[parts]\nmatch = \"time\"\nnames = [\"pos\", \"trq\"]\nwait_s = 60\n")
            });
        }
        workshop
    };
    let parts: Vec<(String, Vec<u8>)> = [export("P", 31, 5), export("P", 32, 6)]
        .iter()
        .flat_map(|export| two_parts(export, by_channel))
        .collect();
    let golden = with_parts();
    for (name, bytes) in &parts {
        fs::write(golden.inbox(name), bytes).expect("written");
    }
    golden.stdout(&["ingest", "inbox"], 0);
    let expected = golden.canonical_dump();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    for round in 0..kills.div_ceil(OF_A_ROUND) {
        let workshop = with_parts();
        for (name, bytes) in &parts {
            let mut cuts = [0, 1].map(|_| random.random_range(1..bytes.len()));
            cuts.sort_unstable();
            // channels are read when they have settled; a cut one that settles would be another export
            let cuts = if by_channel { [bytes.len(); 3] } else { [cuts[0], cuts[1], bytes.len()] };
            for cut in cuts {
                fs::write(workshop.inbox(name), &bytes[..cut]).expect("written");
                let mut daemon = workshop.daemon();
                pass(Duration::from_millis(random.random_range(20..1200)));
                daemon.child.kill().expect("killed");
                daemon.child.wait().expect("its end");
            }
        }
        let daemon = workshop.daemon();
        workshop.wait_until_idle();
        workshop.wait_for_conclusions();
        daemon.stop();
        let of = format!("seed {seed}, round {round}, by channel: {by_channel}");
        assert_eq!(workshop.query("SELECT status, cycles FROM runs"), ["complete|3", "complete|3"], "{of}");
        assert_alike(&workshop.canonical_dump(), &expected, &of);
        assert_sound(&workshop.path("armwatch.db"), &of);
    }
}

#[test]
fn a_few_kills_between_two_parts_change_nothing() {
    kills_between_two_parts(12, 7, false);
    kills_between_two_parts(12, 8, true);
}

#[test]
#[ignore = "takes minutes: 108 kills for each way to divide a recording"]
fn a_hundred_kills_between_two_parts_change_nothing() {
    kills_between_two_parts(100, rand::random(), false);
    kills_between_two_parts(100, rand::random(), true);
}

#[test]
fn a_recording_waits_for_its_last_part_and_a_missing_one_is_named() {
    let export = export("P", 31, 5);
    let expected = results_of_one_file(&export);
    let workshop = small::workshop();
    with_layout(&workshop, |native| {
        format!("{native}\n[parts]\nmatch = \"time\"\nnames = [\"pos\", \"trq\"]\nwait_s = 0.5\n")
    });
    let stem = export.name.strip_suffix(".csv").expect("text");
    let [pos, trq] = ["pos", "trq"].map(|part| format!("{stem}_{part}.csv"));
    let of_torques = columns(&export, |name| name == "time" || name.starts_with("trq"));
    fs::write(workshop.inbox(&pos), columns(&export, |name| !name.starts_with("trq"))).expect("written");
    let explained = workshop.stdout(&["explain", &format!("inbox/{pos}")], 1);
    assert!(explained.contains(&format!("without its part {trq}")), "{explained}");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'quarantined'", 1);
    let reason = workshop.query("SELECT robot, reason FROM runs").concat();
    assert!(reason.starts_with("P|") && reason.contains(&trq), "{reason}");
    assert!(workshop.log().contains(&trq));
    fs::write(workshop.inbox(&trq), &of_torques).expect("written");
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    workshop.wait_until_idle();
    daemon.stop();
    assert_alike(&results(&workshop), &expected, "by time");
    assert_eq!(workshop.number("SELECT count(*) FROM quarantine"), 0);
    let explained = workshop.stdout(&["explain", &format!("inbox/{trq}")], 0);
    assert!(explained.contains("2 parts"), "{explained}");
}

#[test]
fn a_joint_without_a_torque_channel_is_unknown_with_the_reason_and_the_others_are_identified() {
    let export = export("P", 31, 5);
    let workshop = small::workshop();
    with_layout(&workshop, |native| {
        native.replacen("column = \"trq_{joint}\"", "column = \"trq_{joint}\"\nnot_recorded = [4]", 1)
    });
    fs::write(workshop.inbox(&export.name), columns(&export, |name| name != "trq_4")).expect("written");
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.query("SELECT DISTINCT status FROM cycles"), ["complete"]);
    assert_eq!(workshop.query("SELECT DISTINCT joint FROM cycle_rmsd ORDER BY joint"), ["1", "2", "3"]);
    assert_eq!(workshop.query("SELECT DISTINCT joint FROM friction_points ORDER BY joint"), ["1", "2", "3"]);
    let health = workshop.query("SELECT joint, status, reason FROM fleet_health ORDER BY joint");
    assert_eq!(health.len(), 4, "{health:?}");
    assert!(health[..3].iter().all(|of| of.contains("|learning|")), "{health:?}");
    assert!(health[3].starts_with("4|unknown|its torque is not recorded"), "{health:?}");
    let remarks = workshop.query("SELECT DISTINCT remarks FROM cycles").concat();
    assert!(remarks.contains("the export has no torque of joint 4"), "{remarks}");
    let explained = workshop.stdout(&["explain", &format!("inbox/{}", export.name)], 0);
    assert!(explained.contains("no torque of joint 4"), "{explained}");
    workshop.stdout(&["report", "P", "-o", "p.html"], 0);
    let page = fs::read_to_string(workshop.path("p.html")).expect("a page");
    assert!(page.contains("ts torque is not recorded"));
}

/// Two `[[robot]]` entries read the columns of their arms from the same export.
#[test]
fn an_export_of_two_arms_is_a_run_of_each() {
    let [left, right] = [export("P", 31, 5), export("P", 32, 5)];
    let side = |export: &Export, side: &str| {
        let all = text(&export.bytes);
        let (header, rows) = all.split_once('\n').expect("a header");
        let is_joint = |name: &str| ["pos", "vel", "trq"].iter().any(|of| name.starts_with(of));
        let named = |name: &str| if is_joint(name) { format!("{side}_{name}") } else { name.to_owned() };
        format!("{}\n{rows}", header.split(',').map(named).collect::<Vec<_>>().join(","))
    };
    let [of_left, of_right] = [side(&left, "L"), side(&right, "R")];
    let of_right = Export { name: String::new(), bytes: of_right.into_bytes() };
    let of_right = text(&columns(&of_right, |name| name.starts_with("R_")));
    let both: String =
        of_left.lines().zip(of_right.lines()).map(|(left, right)| format!("{left},{right}\n")).collect();
    let workshop = small::workshop();
    let native = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/exports/native.toml"));
    let native = native.expect("a layout");
    let mut config = "[watch]\nfolders = [\"inbox\"]\n".to_owned();
    for (robot, side) in [("left", "L"), ("right", "R")] {
        let layout = ["pos", "vel", "trq"]
            .iter()
            .fold(native.clone(), |text, of| text.replace(&format!("\"{of}_"), &format!("\"{side}_{of}_")));
        fs::write(workshop.path(&format!("{robot}.toml")), layout).expect("written");
        config += &format!(
            "\n[[robot]]\nname = \"{robot}\"\ndescription = \"{}/config/robots/scara.toml\"\nlayout = \"{robot}.toml\"\n",
            env!("CARGO_MANIFEST_DIR")
        );
    }
    fs::write(workshop.path("armwatch.toml"), config).expect("written");
    for robot in ["left", "right"] {
        fs::write(workshop.inbox(&format!("{robot}_20260105_0847.csv")), &both).expect("written");
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    let runs = || workshop.query("SELECT robot, status, cycles FROM runs ORDER BY robot");
    assert_eq!(runs(), ["left|complete|3", "right|complete|3"]);
    assert_eq!(workshop.number("SELECT count(DISTINCT content_hash) FROM runs"), 1);
    let rmsd =
        |robot: &str| workshop.query(&format!("SELECT rmsd_nm FROM cycle_rmsd WHERE robot = '{robot}'"));
    assert!(rmsd("left") != rmsd("right") && rmsd("left").len() == rmsd("right").len());
    // a copy with another name of the same robot is known
    fs::write(workshop.inbox("right_20260105_0847_copy.csv"), &both).expect("written");
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(runs(), ["left|complete|3", "right|complete|3"]);
}

/// Torques in every fourth row of a slow motion: interpolated, they are nearly those of all rows.
#[test]
fn a_slower_channel_is_held_or_resampled_and_explain_gives_its_delay() {
    let export = export("P", 31, 5);
    let sparse = export.with(|all| {
        let line = |(at, line): (usize, &str)| {
            let cells: Vec<&str> = line.split(',').collect();
            let keep = |column: usize| at == 0 || at % 4 == 1 || !(9..13).contains(&column);
            let cells: Vec<&str> =
                cells.iter().enumerate().map(|(column, cell)| if keep(column) { cell } else { "" }).collect();
            cells.join(",") + "\n"
        };
        all.lines().enumerate().map(line).collect()
    });
    let ingested = |slower: &str| {
        let workshop = small::workshop();
        with_layout(&workshop, |native| {
            native.replacen("\"trq_{joint}\"", &format!("\"trq_{{joint}}\"{slower}"), 1)
        });
        workshop.add(&sparse);
        // so slow a channel may give no parameters
        workshop.run(&["ingest", "inbox"]);
        workshop
    };
    let refused = ingested("");
    let reason = refused.query("SELECT reason FROM runs").concat();
    assert!(reason.contains("slower than others") && reason.contains("slower = \"hold\""), "{reason}");
    for (slower, said) in
        [("hold", "held, so it is 50.0 ms late on average"), ("resample", "without a delay")]
    {
        let workshop = ingested(&format!("\nslower = \"{slower}\""));
        assert_eq!(workshop.query("SELECT status, cycles FROM runs"), ["complete|3"]);
        let explained = workshop.stdout(&["explain", &format!("inbox/{}", sparse.name)], 0);
        assert!(explained.contains("torque has a value in") && explained.contains(said), "{explained}");
        assert!(explained.contains("7.5 Hz"), "{explained}");
    }
}
