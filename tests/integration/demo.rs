//! The demo, and the statements of README, `examples/` and `dashboards/` about its database.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use crate::support::{Workshop, end_of, example_questions, text, words};

/// Folder of a finished demo, for the tests on its database.
const FOLDER: &str = "ARMWATCH_DEMO";

fn page(path: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).expect(path)
}

/// A demo that is stopped after the first line that `is_time` returns true for: exit status, standard output.
fn stopped_demo(arguments: &[&str], is_time: impl Fn(&str) -> bool) -> (Option<i32>, String) {
    let workshop = Workshop::new();
    let mut command = workshop.command(&[&["demo", "--once", "--dir", "show"], arguments].concat());
    let mut child: Child =
        command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("the program starts");
    let pid = child.id().to_string();
    let mut told = String::new();
    let mut is_stopped = false;
    for line in BufReader::new(child.stdout.take().expect("a pipe")).lines().map_while(Result::ok) {
        told += &format!("{line}\n");
        if !is_stopped && is_time(&line) {
            is_stopped = true;
            assert!(Command::new("kill").args(["-INT", &pid]).status().expect("kill runs").success());
        }
    }
    let status = end_of(&mut child, || format!("the demo does not end\n{told}"));
    assert!(workshop.path("show/armwatch.db").exists(), "{told}");
    (status, told)
}

#[test]
fn a_demo_that_is_stopped_says_what_it_took() {
    let (status, told) = stopped_demo(&[], |line| line.contains("jitter"));
    assert_eq!(status, Some(130), "{told}");
    for said in ["Middle  wear", "Right   payload", "Front   step", "Rear    jitter", "Left    stays healthy"]
    {
        assert!(told.contains(said), "{said} is missing:\n{told}");
    }
    let stored = told.lines().filter(|line| line.starts_with("stored ")).count();
    assert!(told.contains(&format!("stopped: {stored} of 31 tests are stored")), "{told}");
    assert!(told.contains("not tested yet") && told.contains("0 of 4 faults were found"), "{told}");
    assert!(told.contains("armwatch status") && told.contains("rm -r"), "{told}");
}

#[test]
fn a_demo_as_json_says_the_same() {
    let (status, told) = stopped_demo(&["--json"], |line| line.contains("planted"));
    assert_eq!(status, Some(130), "{told}");
    let events: Vec<Value> =
        told.lines().map(|line| serde_json::from_str(line).expect("one object a line")).collect();
    let of = |name: &str| events.iter().filter(|event| event["event"] == name).collect::<Vec<_>>();
    assert_eq!(of("planted").len(), 4, "{told}");
    let (stopped, verdict) = (of("stopped"), of("verdict"));
    assert_eq!((stopped[0]["tests"].as_u64(), verdict.len()), (Some(31), 1), "{told}");
    assert_eq!(verdict[0]["as_planted"], false, "{told}");
    assert_eq!(verdict[0]["faults"][0]["tests_with_fault"], 0, "{told}");
}

/// A folder with the database of a finished demo, and without a configuration; `None` if none is named.
fn shown() -> Option<Workshop> {
    let Some(demo) = std::env::var_os(FOLDER).map(PathBuf::from) else {
        println!("SKIPPED: {FOLDER} does not name the folder of a demo that has ended");
        return None;
    };
    let workshop = Workshop::new();
    fs::remove_file(workshop.path("armwatch.toml")).expect("removed");
    fs::copy(demo.join("armwatch.db"), workshop.path("armwatch.db")).expect("the demo's database");
    Some(workshop)
}

/// Fenced blocks of a language.
fn blocks(page: &str, language: &str) -> Vec<String> {
    let fence = format!("```{language}\n");
    page.split(&fence).skip(1).filter_map(|part| Some(part.split_once("```")?.0.to_owned())).collect()
}

/// Commands of console blocks that start with the program, without their comments.
fn commands(page: &str) -> Vec<Vec<String>> {
    let text = blocks(page, "console").concat().replace("\\\n", " ");
    let lines = text.lines().filter_map(|line| line.strip_prefix("$ armwatch "));
    lines.map(|line| words(line.split_once(" #").map_or(line, |(command, _)| command))).collect()
}

/// Statements of SQL blocks.
fn statements(page: &str) -> Vec<String> {
    let blocks = blocks(page, "sql");
    let statements = blocks.iter().flat_map(|block| block.split_inclusive(";\n"));
    statements
        .map(|statement| statement.trim().to_owned())
        .filter(|statement| !statement.is_empty())
        .collect()
}

/// Rows of a statement, each an object.
fn rows(workshop: &Workshop, statement: &str) -> usize {
    workshop.stdout(&["sql", "--json", "--", statement], 0).lines().count()
}

/// Every command of the README runs in a folder with the demo's database, and has output; every statement has rows.
#[test]
#[ignore = "needs the database of a demo that has ended"]
fn commands_and_queries_of_the_readme_answer() {
    let Some(workshop) = shown() else { return };
    // a reader's exports
    let made = workshop.simulate("exports", &["--name", "Mine", "--cycles", "1", "--warming-s", "0"]);
    fs::copy(&made[0], workshop.path("new.csv")).expect("a copy");
    let readme = page("README.md");
    let commands = commands(&readme);
    assert!(commands.len() >= 20, "{commands:?}");
    for command in commands {
        if command == ["run"] {
            let daemon = workshop.daemon();
            workshop.wait_for_a_look();
            daemon.signal("TERM");
            assert_eq!(daemon.end(), Some(0), "{}", workshop.log());
            continue;
        }
        let arguments: Vec<&str> = command.iter().map(String::as_str).collect();
        let output = workshop.run(&arguments);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(0), "armwatch {arguments:?}\n{out}\n{err}");
        let file = command.iter().position(|word| word == "--plot" || word == "-o");
        assert!(!out.trim().is_empty() || file.is_some(), "armwatch {arguments:?} says nothing\n{err}");
        println!("answered  armwatch {}", command.join(" "));
        if let Some(file) = file {
            assert!(workshop.path(&command[file + 1]).exists(), "armwatch {arguments:?} wrote no file");
        }
    }
    let statements = statements(&readme);
    assert!(statements.len() >= 2, "{statements:?}");
    for statement in statements {
        assert!(rows(&workshop, &statement) > 0, "no rows:\n{statement}");
    }
}

/// Every command of the tutorial, except the demo itself, runs in the folder of a finished demo.
#[test]
#[ignore = "needs the database of a demo that has ended"]
fn commands_of_the_first_alarm_answer() {
    let Some(workshop) = shown() else { return };
    let tutorial = page("docs/first-alarm.md");
    let commands = commands(&tutorial);
    assert!(commands.len() >= 14, "{commands:?}");
    for command in commands.iter().filter(|command| command[0] != "demo") {
        if command.iter().take(2).eq(["alerts", "test"]) {
            let path = workshop.path("config/armwatch.toml");
            let config = fs::read_to_string(&path).expect("the configuration of config init");
            fs::write(path, config + "\n" + &blocks(&tutorial, "toml").concat()).expect("written");
        }
        // a shell would run the date
        let later = jiff::Timestamp::now() + jiff::SignedDuration::from_mins(5);
        let later = later.strftime("%FT%TZ").to_string();
        let arguments: Vec<&str> = command
            .iter()
            .map(|word| if word.starts_with("$(date") { &later } else { word.as_str() })
            .collect();
        let output = workshop.run(&arguments);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(0), "armwatch {arguments:?}\n{out}\n{err}");
    }
    assert!(workshop.path("sent.json").exists());
    let status =
        workshop.stdout(&["sql", "SELECT status FROM fleet_health WHERE robot = 'Middle' AND joint = 3"], 0);
    assert!(status.contains("learning"), "{status}");
}

/// Questions that may have no rows on the demo's database, each with the reason.
const EMPTY: [(&str, &str); 15] = [
    (
        "Which joints will reach the critical limit within 90 days?",
        "the joint that wears is critical already",
    ),
    ("Which joints are on their way to a limit?", "the joint that wears is past its limits"),
    ("Which robots have sent no test for a week?", "the last tests are of today or yesterday"),
    ("What did the repair change?", "nothing was repaired"),
    ("Which cycles were refused, and why?", "every cycle was understood"),
    ("Which exports are in quarantine, and where is the fault?", "every export was understood"),
    ("Does friction follow the temperature?", "the arms record no temperatures"),
    ("How does production compare with the test?", "no production was recorded"),
    ("Which production windows fit the test worst?", "no production was recorded"),
    ("Which complete tests have no friction index?", "all have one"),
    ("Did the recording change?", "it did not"),
    ("Which alarms did not reach their receiver?", "no receiver is configured"),
    ("Which robots have no new conclusions?", "all conclusions are drawn"),
    ("quarantine.sql of NULL", "every export was understood"),
    ("quarantine.sql of 'Middle'", "every export was understood"),
];

/// The questions of `examples/questions.sql`, and the queries of `dashboards/` with their defaults and with the
/// parameters of its README.
#[test]
#[ignore = "needs the database of a demo that has ended"]
fn example_questions_and_queries_for_dashboards_have_rows() {
    let Some(workshop) = shown() else { return };
    let mut empty: Vec<String> = Vec::new();
    for (question, statement) in example_questions() {
        if rows(&workshop, &statement) == 0 {
            empty.push(question);
        }
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("dashboards");
    let parameter = regex::Regex::new(":([a-z_]+)").expect("a pattern");
    for entry in fs::read_dir(folder).expect("dashboards") {
        let path = entry.expect("an entry").path();
        if path.extension().is_none_or(|extension| extension != "sql") {
            continue;
        }
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        let lines = fs::read_to_string(&path).expect("a query");
        let body: Vec<&str> = lines.lines().filter(|line| !line.starts_with("--")).collect();
        for robot in ["NULL", "'Middle'"] {
            let value = |found: &regex::Captures<'_>| match &found[1] {
                "robot" => robot,
                "joint" if robot != "NULL" => "3",
                _ => "NULL",
            };
            let statement = parameter
                .replace_all(&body.join("\n"), |found: &regex::Captures<'_>| value(found).to_owned())
                .into_owned();
            if rows(&workshop, &statement) == 0 {
                empty.push(format!("{name} of {robot}"));
            }
        }
    }
    empty.retain(|question| !EMPTY.iter().any(|(known, _)| known == question));
    assert!(empty.is_empty(), "no rows of {empty:?}");
}
