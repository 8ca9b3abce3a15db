//! `armwatch report`: a run or a robot on one self-contained page.

use std::fs;
use std::process::Command;

use xml::reader::XmlEvent;

use crate::small::{self, export};
use crate::support::{Workshop, text};

/// A name that would be markup if it were not escaped.
const ROBOT: &str = "A<b>&\"c";

/// Two tests of one robot, one of a second robot of the model, and an unreadable export of a third.
fn stored() -> Workshop {
    let workshop = small::workshop();
    for day in [5, 6] {
        let export = export("A", day, day);
        let name = export.name.replacen('A', ROBOT, 1);
        fs::write(workshop.inbox(&name), &export.bytes).expect("written");
    }
    let twin = export("B", 7, 7);
    workshop.add(&twin);
    let name = twin.name.replacen('B', "C", 1);
    workshop.add(&small::Export { name, bytes: export("A", 5, 5).bytes }.spoiled());
    workshop.stdout(&["ingest", "inbox"], 1);
    workshop
}

fn page(workshop: &Workshop, subject: &str) -> String {
    workshop.stdout(&["report", subject, "-o", "report.html"], 0);
    fs::read_to_string(workshop.path("report.html")).expect("a page")
}

/// Parts of a page.
#[derive(Default)]
struct Read {
    /// Names of its elements.
    elements: Vec<String>,
    /// Texts of its headings of the second order.
    headings: Vec<String>,
    /// Rows of its tables, each with the texts of its cells.
    rows: Vec<Vec<String>>,
    /// All its words.
    words: String,
}

/// Reads a page as XML, which is stricter than HTML, and panics if it is not well-formed or requests another resource.
fn read(html: &str) -> Read {
    let mut read = Read::default();
    let mut open: Vec<String> = Vec::new();
    for event in xml::EventReader::from_str(html) {
        match event.unwrap_or_else(|error| panic!("{error}")) {
            XmlEvent::StartElement { name, attributes, .. } => {
                for attribute in &attributes {
                    let outside = ["href", "src", "srcset", "action", "data", "poster"];
                    assert!(!outside.contains(&attribute.name.local_name.as_str()), "{name}: {attribute}");
                    assert!(!attribute.value.contains("url("), "{name}: {attribute}");
                    assert!(!attribute.name.local_name.starts_with("on"), "{name}: {attribute}");
                }
                match name.local_name.as_str() {
                    "h2" => read.headings.push(String::new()),
                    "tr" => read.rows.push(Vec::new()),
                    "td" => read.rows.last_mut().expect("a row").push(String::new()),
                    _ => {}
                }
                read.elements.push(name.local_name.clone());
                open.push(name.local_name);
            }
            XmlEvent::EndElement { .. } => drop(open.pop()),
            XmlEvent::Characters(words) | XmlEvent::Whitespace(words) => {
                if open.iter().any(|element| element == "style") {
                    assert!(!words.contains("url(") && !words.contains("@import"), "{words}");
                    continue;
                }
                if open.iter().any(|element| element == "td") {
                    let cells = read.rows.last_mut().expect("a row");
                    cells.last_mut().expect("a cell").push_str(&words);
                }
                if open.last().is_some_and(|element| element == "h2") {
                    read.headings.last_mut().expect("a heading").push_str(&words);
                }
                read.words.push_str(&words);
            }
            _ => {}
        }
    }
    for element in ["script", "link", "img", "image", "iframe", "object", "use"] {
        assert!(!read.elements.contains(&element.to_owned()), "{element}");
    }
    read
}

#[test]
fn a_run_has_its_parameters_and_figures_and_a_robot_its_history_and_twins() {
    let workshop = stored();
    let run = page(&workshop, "1");
    let read_run = read(&run);
    assert!(
        read_run.words.contains(&format!("{ROBOT}, run 1")) && !run.contains("<b>"),
        "the name is no markup"
    );
    let parts = ["Conclusions", "Recorded cycles", "Base parameters", "Model fit", "Friction"];
    assert_eq!(read_run.headings[..5], parts);
    assert_eq!(read_run.headings[5], "Missing results and remarks");
    // the table has every stored parameter of the last cycle
    let stored = workshop.query(
        "SELECT joint, parameter, unit FROM cycle_parameters WHERE run_id = 1 AND cycle = 3 ORDER BY joint, parameter",
    );
    assert!(stored.len() > 10, "{stored:?}");
    for line in &stored {
        let [joint, parameter, unit] = line.split('|').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let row =
            |row: &&Vec<String>| row.len() == 10 && row[0] == joint && row[1] == parameter && row[3] == unit;
        assert_eq!(read_run.rows.iter().filter(row).count(), 1, "{line}");
    }
    let value = workshop.query(
        "SELECT printf('%.4g', value), printf('%.4g', std_error) FROM cycle_parameters
         WHERE run_id = 1 AND cycle = 3 AND joint = 1 AND parameter = 'f1'",
    );
    let f1 = read_run.rows.iter().find(|row| row.len() == 10 && row[0] == "1" && row[1] == "f1").expect("f1");
    let shown = [4, 5].map(|column: usize| f1[column].parse::<f64>().expect("a figure"));
    let expected: Vec<f64> = value[0].split('|').map(|cell| cell.parse().expect("a figure")).collect();
    for (shown, expected) in shown.iter().zip(&expected) {
        assert!((shown / expected - 1.0).abs() < 1e-3, "{f1:?} {value:?}");
    }
    // one picture per joint of RMSD, residual and friction over time and speed, each with its legend
    let pictures = read_run.elements.iter().filter(|element| *element == "figure").count();
    assert_eq!(pictures, 4);

    let robot = page(&workshop, ROBOT);
    let read_robot = read(&robot);
    assert!(!robot.contains("<b>") && read_robot.words.contains(ROBOT));
    assert!(read_robot.words.contains("too few tests for a baseline yet"), "{}", read_robot.words);
    assert!(read_robot.words.contains("1 other robot of the model"), "{}", read_robot.words);
    assert!(
        read_robot.words.contains("There never was an alarm.")
            && read_robot.words.contains("No work was entered")
    );
    // one column for each of four joints
    let tests = |row: &&Vec<String>| row.len() == 8 && row[1].starts_with("2026-01-0");
    assert_eq!(read_robot.rows.iter().filter(tests).count(), 2, "{:?}", read_robot.rows);

    // for an unreadable export, the page has the reason and no good status
    let broken = workshop.query("SELECT run_id FROM quarantine").remove(0);
    for subject in [broken.as_str(), "C"] {
        let read = read(&page(&workshop, subject));
        assert!(
            read.words.to_lowercase().contains("line ") && read.words.to_lowercase().contains("not a number"),
            "{subject}: {}",
            read.words
        );
        // the page has no status of a joint
        assert!(!read.elements.contains(&"li".to_owned()) || !read.words.contains("Joint 1 "), "{subject}");
        assert!(
            read.words.contains("nothing is known of") || read.words.contains("Nothing is known of"),
            "{subject}"
        );
    }
    let shown = workshop.query("SELECT count(*) FROM runs");
    assert_eq!(shown, ["4"], "a report changes nothing");
    a_pdf_is_printed_where_there_is_a_browser(&workshop);
}

fn a_pdf_is_printed_where_there_is_a_browser(workshop: &Workshop) {
    let without = workshop
        .command(&["report", "B", "-o", "report.pdf"])
        .env("PATH", workshop.path("inbox"))
        .output()
        .expect("it runs");
    assert_eq!(without.status.code(), Some(74));
    assert!(text(&without.stderr).contains("a PDF needs Chromium"), "{}", text(&without.stderr));
    assert!(!workshop.path("report.pdf").exists());
    let has =
        |name: &str| Command::new(name).arg("--version").output().is_ok_and(|done| done.status.success());
    if !["chromium", "google-chrome", "chromium-browser"].into_iter().any(has) {
        eprintln!("skipped: no Chromium on this machine prints a PDF");
        return;
    }
    workshop.stdout(&["report", "B", "-o", "report.pdf"], 0);
    let pdf = fs::read(workshop.path("report.pdf")).expect("a file");
    assert!(pdf.starts_with(b"%PDF-") && pdf.len() > 10_000, "{} bytes", pdf.len());
}

#[test]
fn what_is_not_there_is_said_with_what_is_near() {
    let workshop = small::workshop();
    let refused = |arguments: &[&str], code: i32| workshop.stderr(arguments, code);
    assert!(refused(&["report", "A", "-o", "a.html"], 74).contains("there is no database"));
    assert!(!workshop.path("armwatch.db").exists(), "a report makes no database");
    workshop.stdout(&["ingest", "inbox"], 0);
    for subject in ["A", "1"] {
        assert!(refused(&["report", subject, "-o", "a.html"], 2).contains("no run is stored yet"));
    }
    workshop.add(&export("A", 5, 5));
    workshop.stdout(&["ingest", "inbox"], 0);
    assert!(refused(&["report", "a1", "-o", "a.html"], 2).contains("did you mean A?"));
    assert!(refused(&["report", "9", "-o", "a.html"], 2).contains("the nearest is 1"));
    assert!(refused(&["report", "A", "-o", "a.svg"], 2).contains(".html or .pdf"));
    assert!(refused(&["report", "A", "-o", "none/a.html"], 74).contains("an existing folder"));
    assert!(!workshop.path("a.html").exists());
}
