//! The command line: results on standard output, messages on standard error, a documented exit status.

use std::fs;

use clap::Command;

use crate::small::{self, CYCLES, export};
use crate::support::{self, Workshop, reference, text};
use armwatch::cli::Cli;

/// Words of each command that can be run and is not hidden, with the command.
fn commands(of: &Command, words: &[String], found: &mut Vec<(Vec<String>, Command)>) {
    // `help` is clap's own
    let shown = |command: &&Command| !command.is_hide_set() && command.get_name() != "help";
    for command in of.get_subcommands().filter(shown) {
        let words = [words, &[command.get_name().to_owned()]].concat();
        if command.has_subcommands() {
            commands(command, &words, found);
        } else {
            found.push((words, command.clone()));
        }
    }
}

/// Command lines of a help text, without the parts for the shell.
fn examples(help: &str) -> Vec<String> {
    let after = help.split_once("Examples:\n").map_or("", |(_, after)| after);
    let joined = after.replace("\\\n", " ");
    let lines = joined.lines().take_while(|line| line.starts_with("  "));
    lines.map(|line| line.split(['|', '>', '<']).next().unwrap_or_default().trim().to_owned()).collect()
}

#[test]
fn every_command_has_help_with_examples() {
    let mut found = Vec::new();
    let mut cli = Cli::dressed_command();
    // options of all commands are added to each of them
    cli.build();
    commands(&cli, &["armwatch".to_owned()], &mut found);
    assert!(found.len() >= 19, "{found:?}");
    for (words, mut command) in found {
        let (line, help) = (words.join(" "), command.render_long_help().to_string());
        let examples = examples(&help);
        assert!(!examples.is_empty(), "no examples in the help of {line}:\n{help}");
        for example in examples {
            assert!(example == line || example.starts_with(&format!("{line} ")), "of {line}: {example}");
            let parsed = Cli::dressed_command().try_get_matches_from(support::words(&example));
            assert!(parsed.is_ok(), "{example}\n{}", parsed.expect_err("a fault"));
        }
    }
    let workshop = Workshop::new();
    assert!(workshop.stdout(&["--help"], 0).contains("Exit status:"));
    assert!(workshop.stdout(&["ingest", "--help"], 0).contains("Examples:\n  armwatch ingest "));
}

/// A line of a paragraph that ends too early for the width, as in text wrapped by hand.
fn orphan(help: &str, width: usize) -> Option<String> {
    let lines: Vec<&str> = help.lines().collect();
    let is_prose = |line: &str| !line.is_empty() && !line.starts_with(' ') && !line.ends_with(':');
    lines.windows(2).find_map(|pair| {
        let (line, next) = (pair[0], pair[1]);
        let word = next.split(' ').next().unwrap_or_default();
        let had_room = line.chars().count() + 1 + word.chars().count() <= width;
        (is_prose(line) && is_prose(next) && had_room).then(|| format!("{line}\n{next}"))
    })
}

#[test]
fn help_fits_any_terminal_without_orphans() {
    assert!(orphan("a line that was\nwrapped", 80).is_some() && orphan("a\n\nb\n  c", 80).is_none());
    let mut found = Vec::new();
    let mut cli = Cli::dressed_command();
    cli.build();
    commands(&cli, &["armwatch".to_owned()], &mut found);
    found.push((vec!["armwatch".to_owned()], cli));
    for (words, command) in found {
        for width in [80, 100] {
            let mut command = command.clone().term_width(width);
            for help in [command.render_long_help().to_string(), command.render_help().to_string()] {
                let line = words.join(" ");
                // clap does not wrap the usage
                let mut lines = help.lines().filter(|line| !line.starts_with("Usage: "));
                if let Some(wide) = lines.find(|line| line.chars().count() > width) {
                    panic!("{line} at {width}: {wide}");
                }
                if let Some(orphan) = orphan(&help, width) {
                    panic!("{line} at {width}:\n{orphan}");
                }
            }
        }
        let own = |arg: &&clap::Arg| arg.get_help_heading().is_none() && !arg.is_positional();
        let ungrouped = command.get_arguments().filter(own).count();
        assert!(ungrouped <= 6, "{}: {ungrouped} options without a heading", words.join(" "));
    }
}

#[test]
fn a_mistyped_command_gets_one_that_makes_sense() {
    let workshop = Workshop::new();
    for (typed, meant) in [
        ("init", "`armwatch config init`"),
        ("version", "`armwatch --version`"),
        ("fleet", "`armwatch status`"),
        ("stauts", "`armwatch status`"),
        ("completion", "`armwatch completions`"),
    ] {
        let said = workshop.stderr(&[typed], 2);
        assert!(said.contains(&format!("did you mean {meant}?")), "{typed}: {said}");
    }
    let said = text(&workshop.run(&["no-such-command"]).stderr);
    assert!(said.contains("unrecognized") && !said.contains("did you mean"), "{said}");
}

/// Checks each page with the programs that read manual pages.
#[test]
fn manual_pages_have_no_warnings() {
    let workshop = Workshop::new();
    let said = workshop.stdout(&["man", "pages/man1"], 0);
    let pages: Vec<std::path::PathBuf> = std::fs::read_dir(workshop.path("pages/man1"))
        .expect("a folder")
        .map(|entry| entry.expect("a file").path())
        .collect();
    assert!(pages.len() >= 35 && said.starts_with(&format!("{} pages", pages.len())), "{said}");
    let ingest = std::fs::read_to_string(workshop.path("pages/man1/armwatch-ingest.1")).expect("a page");
    for part in
        [".TH ARMWATCH-INGEST 1", ".SH EXAMPLES", ".SH \"GLOBAL OPTIONS\"", "armwatch ingest exports/"]
    {
        assert!(ingest.contains(part), "{part} is not in\n{ingest}");
    }
    let checks: [(&str, &[&str]); 2] = [
        ("groff", &["-man", "-ww", "-b", "-z", "-Tutf8", "-K", "utf8"]),
        ("mandoc", &["-T", "lint", "-W", "error"]),
    ];
    for (program, arguments) in checks {
        let mut checked = std::process::Command::new(program);
        match checked.args(arguments).args(&pages).output() {
            Ok(output) => {
                let said = text(&output.stderr) + &text(&output.stdout);
                assert!(output.status.success() && said.is_empty(), "{program}: {said}");
            }
            Err(_) => eprintln!("{program} is not here: pages are not checked with it"),
        }
    }
}

#[test]
fn a_wrong_command_line_or_configuration_is_2() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest"], 2);
    workshop.stdout(&["ingest", "not-there.csv"], 2);
    workshop.stdout(&["no-such-command"], 2);
    workshop.stdout(&["ingest", "inbox", "--config", "not-there.toml"], 2);
    std::fs::write(workshop.path("bad.toml"), "databse = \"x.db\"\n[watch]\nsettle_s = -1\n")
        .expect("written");
    let out = workshop.stdout(&["config", "check", "--config", "bad.toml"], 2);
    assert!(out.contains("bad.toml:1:") && out.contains("database"), "no place or suggestion: {out}");
    assert!(out.contains("bad.toml:3:") && out.contains("settle_s"), "only one problem shown: {out}");
    let output = workshop.stderr(&["ingest", "inbox", "--config", "bad.toml"], 2);
    assert!(output.contains("bad.toml:1:"), "{output}");
}

#[test]
fn commands_say_alike_what_is_missing_on_their_line() {
    let workshop = Workshop::new();
    let said = |arguments: &[&str]| workshop.stderr(arguments, 2);
    let missing = said(&["ingest", "not-there.csv"]);
    assert_eq!(missing, "armwatch: not-there.csv: there is no such file or folder; check the name\n");
    assert_eq!(said(&["explain", "not-there.csv"]), missing);
    assert!(said(&["explain", "inbox"]).contains("is a folder; name exports, such as inbox/*.csv"));
    for command in ["friction", "identify", "verify"] {
        let said = said(&[command]);
        assert!(said.contains("--robot <NAME>"), "{command}: {said}");
    }
    let speed = said(&["friction", "--run", "1", "--speed", "60"]);
    assert!(speed.contains("did you mean 0.6?"), "{speed}");
}

#[test]
fn what_is_asked_for_by_a_name_or_number_that_is_not_there_is_refused() {
    let workshop = small::workshop();
    workshop.add(&export("Left", 1, 5));
    workshop.stdout(&["ingest", "inbox"], 0);
    let cases: [(&[&str], &str); 7] = [
        (&["runs", "--robot", "Nope"], "there is no robot Nope; there are runs of Left"),
        (&["runs", "--robot", "left", "--json"], "did you mean Left?"),
        (&["cycles", "--robot", "lfet", "--csv"], "did you mean Left?"),
        (&["cycles", "--run", "99"], "there is no run 99; runs known: "),
        (&["cycles", "--run", "-1"], "-1 is not in 1.."),
        (&["runs", "--limit", "-3"], "-3 is not in 1.."),
        (&["ingest", "--again", "-1"], "-1 is not in 1.."),
    ];
    for (arguments, says) in cases {
        let output = workshop.run(arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(says) && !said.contains("to pass"), "{arguments:?}: {said}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
    }
    // an empty result for an existing robot is no error
    let none = workshop.stdout(&["runs", "--robot", "Left", "--status", "quarantined"], 0);
    assert_eq!(none, "no run matches\n");
}

#[test]
fn a_known_export_names_its_robot_and_names_of_files_give_a_terminal_no_orders() {
    let workshop = small::workshop();
    let export = export("Left", 1, 5);
    workshop.add(&export);
    let evil = "R\u{1b}[31m\u{7}_20260105_0847.csv";
    std::fs::write(workshop.inbox(evil), "time,pos_1\n0,1\n").expect("written");
    let first = workshop.run(&["ingest", "inbox"]);
    assert_eq!(first.status.code(), Some(1));
    // the same content with the name of another robot
    let copy = export.name.replace("Left", "Right");
    std::fs::write(workshop.inbox(&copy), &export.bytes).expect("written");
    let again = workshop.run(&["ingest", "inbox"]);
    let said = text(&again.stdout);
    let known = |name: &str| said.lines().any(|line| line.contains(name) && line.ends_with(" of robot Left"));
    assert!(known(&export.name) && known(&copy), "{said}");
    let json = workshop.stdout(&["ingest", &format!("inbox/{copy}"), "--json"], 0);
    let known: serde_json::Value =
        serde_json::from_str(json.lines().next().expect("an object")).expect("an object");
    assert_eq!((&known["outcome"], &known["robot"]), (&"known".into(), &"Left".into()), "{json}");
    let listed = workshop.run(&["quarantine", "list"]);
    let missing = workshop.run(&["ingest", "not\u{1b}[2Jthere.csv"]);
    for output in [&first, &again, &listed, &missing] {
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(said.contains("\\u{1b}[") && !said.contains(['\u{1b}', '\u{7}']), "{said:?}");
    }
}

#[test]
fn an_interrupt_says_what_was_done_and_that_the_same_command_goes_on() {
    let workshop = small::workshop();
    let scara = format!("{}/config/robots/scara.toml", env!("CARGO_MANIFEST_DIR"));
    let shape = ["--cycles", "24", "--warming-s", "2", "--rate-hz", "30", "--robot", &scara];
    workshop.simulate("exports", &shape);
    let file = |name: &str| std::fs::File::create(workshop.path(name)).expect("a file");
    let mut command = workshop.command(&["ingest", "exports", "--json"]);
    let child = command.stdout(file("out")).stderr(file("err")).spawn().expect("it starts");
    let ingest = support::Daemon { child };
    workshop.wait_for("SELECT min(count(*), 1) FROM cycles", 1);
    ingest.signal("INT");
    assert_eq!(ingest.end(), Some(130));
    let read = |name: &str| std::fs::read_to_string(workshop.path(name)).expect("text");
    let (out, err) = (read("out"), read("err"));
    let last = out.lines().last().unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(last).unwrap_or_else(|_| panic!("{out}{err}"));
    assert_eq!(
        ["outcome", "interrupted", "stored", "not_read"].map(|key| summary[key].to_string()),
        ["\"summary\"", "true", "0", "1"],
        "{out}"
    );
    assert!(err.contains("stopped after 0 of 1 export") && err.contains("the same command again"), "{err}");
    let done = workshop.stdout(&["ingest", "exports", "--json"], 0);
    assert!(done.contains("\"interrupted\":false"), "{done}");
    assert_eq!(workshop.query("SELECT status, cycles FROM runs"), ["complete|24"]);
}

/// Regression: one of two aborted with "run 7 in database .. is not being stored", without a summary.
#[test]
fn two_commands_at_once_leave_exports_to_each_other_and_both_come_to_their_summary() {
    let workshop = small::workshop();
    // the seed determines the content
    for (robot, seed) in [("A", 100), ("B", 200)] {
        for day in 5..9 {
            workshop.add(&export(robot, seed + day, day));
        }
    }
    // the database exists already, so that neither waits for the other to create it
    std::fs::create_dir(workshop.path("empty")).expect("a folder");
    workshop.stdout(&["ingest", "empty"], 0);
    let outputs = std::thread::scope(|scope| {
        let both = [(); 2].map(|()| scope.spawn(|| workshop.run(&["ingest", "inbox", "--json"])));
        both.map(|one| one.join().expect("an end"))
    });
    for output in outputs {
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(0), "{out}\n{err}");
        let last = out.lines().last().unwrap_or_default();
        let summary: serde_json::Value = serde_json::from_str(last).unwrap_or_else(|_| panic!("{out}{err}"));
        let count = |key: &str| summary[key].as_u64().expect("a count");
        assert_eq!((count("stored") + count("known"), count("not_read")), (8, 0), "{out}\n{err}");
    }
    let runs = "SELECT status, cycles, count(*) FROM runs GROUP BY status, cycles";
    assert_eq!(workshop.query(runs), [format!("complete|{CYCLES}|8")]);
}

#[test]
fn a_database_that_is_none_or_cannot_be_written_is_74() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    std::fs::write(workshop.path("text.db"), "this is a text and no database, and long enough to be one")
        .expect("written");
    let output = workshop.stderr(&["ingest", "inbox", "--db", "text.db"], 74);
    assert!(output.contains("text.db"), "{output}");
    let output = workshop.run(&["ingest", "inbox", "--db", "/proc/armwatch.db"]);
    assert_eq!(output.status.code(), Some(74), "{}", text(&output.stderr));
}

#[test]
fn an_empty_folder_is_said_and_is_no_error() {
    let workshop = Workshop::new();
    let output = workshop.stderr(&["ingest", "inbox"], 0);
    assert!(output.contains("no exports"), "{output}");
}

#[test]
fn calibrate_says_what_it_has_and_what_is_missing() {
    let workshop = Workshop::new();
    assert!(workshop.stdout(&["calibrate"], 0).contains("there is no database"));
    workshop.run(&["ingest", "inbox"]);
    assert!(workshop.stdout(&["calibrate"], 0).contains("no complete test is stored yet"));
    assert_eq!(workshop.stdout(&["calibrate", "--json"], 0), "");
    let output = workshop.stderr(&["calibrate", "Left"], 2);
    assert!(output.contains("robots with tests: none yet"), "{output}");

    workshop.add_reference("inbox");
    workshop.stdout(&["ingest", "inbox"], 0);
    let out = workshop.stdout(&["calibrate"], 0);
    assert!(out.contains("tests 1, ") && out.contains("no limit yet of joint 1, 2"), "{out}");
    let value: serde_json::Value =
        serde_json::from_str(&workshop.stdout(&["calibrate", "--json"], 0)).expect("one object");
    assert_eq!((&value["tests"], &value["joints"][0]["phase"]), (&1.into(), &"no history".into()));
}

#[test]
fn json_is_one_object_a_line() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    std::fs::write(workshop.inbox("AA_20260101_0000.csv"), "").expect("written");
    let out = workshop.stdout(&["ingest", "inbox", "--json"], 1);
    let objects: Vec<serde_json::Value> =
        out.lines().map(|line| serde_json::from_str(line).expect("an object")).collect();
    assert_eq!(objects.len(), 3);
    let summary = &objects[2];
    assert_eq!(
        ["outcome", "stored", "known", "quarantined", "cycles"].map(|key| summary[key].to_string()),
        ["\"summary\"", "1", "0", "1", "5"]
    );
    assert!(summary["took_s"].as_f64().is_some_and(|took| took > 0.0), "{summary}");
    assert_eq!((&objects[0]["outcome"], &objects[1]["outcome"]), (&"quarantined".into(), &"stored".into()));
    assert_eq!(objects[1]["cycles"], 5);
    let robot: serde_json::Value = serde_json::from_str(&workshop.stdout(
        &["robot", "check", &format!("{}/config/robots/er3a.toml", env!("CARGO_MANIFEST_DIR")), "--json"],
        0,
    ))
    .expect("an object");
    assert_eq!(robot["parameter_count"], 64);
}

#[test]
fn the_er3a_has_the_64_parameters_of_the_thesis_and_agrees_with_the_reference() {
    let workshop = Workshop::new();
    let description = format!("{}/config/robots/er3a.toml", env!("CARGO_MANIFEST_DIR"));
    let table = reference("er3a_inverse_dynamics.csv");
    let arguments = ["robot", "check", &description, "--reference", table.to_str().expect("a path")];
    let out = workshop.stdout(&arguments, 0);
    for said in ["64", "36", "40", "J1_Izz", "J6_I_m"] {
        assert!(out.contains(said), "{said} is not in {out}");
    }
    // a reference of another arm is detected
    let text = std::fs::read_to_string(&table).expect("the table");
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let mut cells: Vec<String> = lines[7].split(',').map(str::to_owned).collect();
    cells[18] = "1.5".into();
    lines[7] = cells.join(",");
    std::fs::write(workshop.path("other.csv"), lines.join("\n")).expect("written");
    workshop.stdout(&["robot", "check", &description, "--reference", "other.csv"], 1);
}

#[test]
fn the_shipped_configuration_becomes_files_to_edit_and_none_is_written_over() {
    let workshop = Workshop::new();
    std::fs::create_dir_all(workshop.path("etc/robots")).expect("a folder");
    std::fs::write(workshop.path("etc/robots/scara.toml"), "# mine\n").expect("a file");
    let said = workshop.stdout(&["config", "init", "etc"], 0);
    assert!(
        said.contains("written  etc/armwatch.toml") && said.contains("kept     etc/robots/scara.toml"),
        "{said}"
    );
    assert_eq!(std::fs::read_to_string(workshop.path("etc/robots/scara.toml")).expect("it"), "# mine\n");
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/config");
    for folder in ["robots", "exports"] {
        for entry in std::fs::read_dir(format!("{shipped}/{folder}")).expect("a folder") {
            let name = entry.expect("a file").file_name();
            assert!(workshop.path("etc").join(folder).join(&name).is_file(), "{name:?}");
        }
    }
    let config = ["--config", "etc/armwatch.toml"];
    workshop.stdout(&[&["config", "check"], &config[..]].concat(), 0);
    let shown = workshop.stdout(&[&["config", "show"], &config[..]].concat(), 0);
    assert!(shown.contains("etc/armwatch.toml") && shown.contains("armwatch.db"), "{shown}");
}

#[test]
fn bash_completes_commands_robots_runs_and_alarms() {
    let workshop = Workshop::new();
    fs::create_dir(workshop.path("bin")).expect("a folder");
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_armwatch"), workshop.path("bin/armwatch"))
        .expect("a link");
    let script = workshop.stdout(&["completions", "bash"], 0);
    fs::write(workshop.path("armwatch.bash"), script).expect("written");
    workshop.add_reference("inbox");
    workshop.stdout(&["ingest", "inbox"], 0);
    let run = workshop.query("SELECT run_id FROM runs").remove(0);
    let robot = workshop.query("SELECT robot FROM runs").remove(0);
    // the candidates for the last of the words
    let offered = |words: &[&str]| {
        let line = "source ./armwatch.bash; COMP_WORDS=(\"$@\"); COMP_CWORD=$(($# - 1)); \
            _clap_complete_armwatch armwatch \"${!#}\" \"\"; printf '%s\\n' \"${COMPREPLY[@]}\"";
        let path = format!("{}:{}", workshop.path("bin").display(), std::env::var("PATH").expect("a path"));
        let mut bash = std::process::Command::new("bash");
        let bash =
            bash.current_dir(workshop.path("")).env("PATH", path).args(["-c", line, "bash"]).args(words);
        let output = bash.output().expect("bash");
        assert!(output.stderr.is_empty(), "{}", text(&output.stderr));
        text(&output.stdout).lines().map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(offered(&["armwatch", "quar"]), ["quarantine"]);
    assert_eq!(offered(&["armwatch", "runs", "--robot", ""]), [&*robot]);
    assert_eq!(offered(&["armwatch", "cycles", "--run", ""]), [&*run]);
    // there is no alarm, only options
    assert!(offered(&["armwatch", "alerts", "ack", ""]).iter().all(|word| word.starts_with("--")));
    assert_eq!(offered(&["armwatch", "runs", "--db", "none.db", "--robot", ""]), [""]);
    assert!(!workshop.path("none.db").exists());
}

#[test]
fn every_shell_has_completions() {
    let workshop = Workshop::new();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = workshop.stdout(&["completions", shell], 0);
        assert!(script.contains("ARMWATCH_COMPLETE"), "{shell}: {script}");
    }
}
