//! Tests of the documents: `docs/schema.md` names the views and columns of the database, links have targets, and the
//! queries in `dashboards/` and `examples/` run and answer their questions.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::support::{REFERENCE_NAME, Workshop, example_questions, text};

/// Values that SQL and the program compute from the same stored numbers differ by rounding only.
const ROUNDING: f64 = 1e-9;

pub fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Columns by view, as the sections of `docs/schema.md` name them: a heading with the view in
/// backticks, then table rows that begin with the column, or several, in backticks.
fn documented() -> BTreeMap<String, BTreeSet<String>> {
    let text = fs::read_to_string(repository("docs/schema.md")).expect("docs/schema.md");
    let mut views: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut view = None;
    for line in text.lines() {
        if let Some(heading) = line.strip_prefix("## ") {
            view = heading.strip_prefix('`').and_then(|rest| rest.strip_suffix('`')).map(str::to_owned);
            views.extend(view.clone().map(|name| (name, BTreeSet::new())));
        }
        let columns = line.strip_prefix("| `").and_then(|rest| rest.split("` |").next());
        if let (Some(view), Some(columns)) = (&view, columns) {
            views.entry(view.clone()).or_default().extend(columns.split("`, `").map(str::to_owned));
        }
    }
    views
}

#[test]
fn schema_names_every_view_and_column_and_no_other() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    let stored: BTreeMap<String, BTreeSet<String>> = workshop
        .query("SELECT name FROM sqlite_schema WHERE type = 'view'")
        .into_iter()
        .map(|view| {
            let columns = workshop.query(&format!("SELECT name FROM pragma_table_info('{view}')"));
            (view, columns.into_iter().collect())
        })
        .collect();
    assert!(stored.len() >= 9, "{stored:?}");
    assert_eq!(documented(), stored, "docs/schema.md on the left, the database on the right");
}

/// The oldest promised compiler is enough for every crate, and the README names it.
#[test]
fn no_crate_needs_a_newer_compiler_than_is_promised() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let compiler = Command::new("rustc").arg("-vV").output().expect("a compiler");
    let told = text(&compiler.stdout);
    let host = told.lines().find_map(|line| line.strip_prefix("host: ")).expect("the host");
    let metadata = Command::new(cargo)
        .args(["metadata", "--format-version", "1", "--offline", "--locked", "--filter-platform", host])
        .current_dir(repository(""))
        .output()
        .expect("cargo runs");
    assert!(metadata.status.success(), "{}", text(&metadata.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&metadata.stdout).expect("an object");
    let packages = metadata["packages"].as_array().expect("packages");
    let wanted = |package: &serde_json::Value| -> Option<Vec<u32>> {
        package["rust_version"].as_str()?.split('.').map(|part| part.parse().ok()).collect()
    };
    let own = packages.iter().find(|package| package["name"] == "armwatch").expect("the package");
    let promised = wanted(own).expect("rust-version in Cargo.toml");
    let newer: Vec<String> = packages
        .iter()
        .filter(|package| wanted(package).is_some_and(|version| version > [&promised[..], &[0]].concat()))
        .map(|package| format!("{} {}", package["name"], package["rust_version"]))
        .collect();
    assert!(newer.is_empty(), "rust-version {promised:?} is too low for {newer:?}");
    let readme = fs::read_to_string(repository("README.md")).expect("README.md");
    let said = format!("Rust {}.{} or newer", promised[0], promised[1]);
    assert!(readme.contains(&said), "README.md does not say {said:?}");
}

/// A query file of `dashboards/`.
struct Query {
    name: String,
    text: String,
}

impl Query {
    fn read(name: &str) -> Self {
        let text = fs::read_to_string(repository("dashboards").join(name)).expect("a query");
        Self { name: name.to_owned(), text }
    }

    /// The comment at its beginning.
    fn introduction(&self) -> String {
        self.text.lines().take_while(|line| line.starts_with("--")).collect::<Vec<_>>().join("\n")
    }

    fn body(&self) -> &str {
        &self.text[self.introduction().len()..]
    }

    fn parameters(text: &str) -> BTreeSet<String> {
        parameter().captures_iter(text).map(|found| found[1].to_owned()).collect()
    }

    /// Rows of `select` over the query's rows, named `answer`; missing parameters get `default`.
    fn ask(&self, workshop: &Workshop, select: &str, given: &[(&str, &str)], default: &str) -> Vec<String> {
        for (name, _) in given {
            assert!(Self::parameters(self.body()).contains(*name), "{} has no :{name}", self.name);
        }
        let value = |found: &regex::Captures<'_>| {
            let given = given.iter().find(|(name, _)| *name == &found[1]);
            given.map_or(default, |(_, value)| value).to_owned()
        };
        let body = parameter().replace_all(self.body(), value);
        let body = body.trim_end().strip_suffix(';').expect("a statement ends with a semicolon");
        workshop.query(&format!("SELECT {select} FROM ({body}) AS answer"))
    }

    /// One value; missing parameters are NULL.
    fn number(&self, workshop: &Workshop, select: &str, given: &[(&str, &str)]) -> f64 {
        let rows = self.ask(workshop, select, given, "NULL");
        rows.first().and_then(|cell| cell.parse().ok()).unwrap_or(f64::NAN)
    }
}

fn parameter() -> regex::Regex {
    regex::Regex::new(":([a-z_]+)").expect("a pattern")
}

fn queries() -> Vec<Query> {
    let mut names: Vec<String> = fs::read_dir(repository("dashboards"))
        .expect("dashboards")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".sql"))
        .collect();
    names.sort();
    names.iter().map(|name| Query::read(name)).collect()
}

#[test]
fn every_query_says_what_it_answers_and_what_it_takes() {
    let guide = fs::read_to_string(repository("dashboards/README.md")).expect("dashboards/README.md");
    let queries = queries();
    assert!(queries.len() >= 8, "{}", queries.len());
    for query in queries {
        let Query { name, .. } = &query;
        assert!(guide.contains(&format!("`{name}`")), "{name} is not in dashboards/README.md");
        assert!(query.introduction().contains('?'), "{name} does not say which question it answers");
        let (said, taken) = (Query::parameters(&query.introduction()), Query::parameters(query.body()));
        assert_eq!(said, taken, "{name}: parameters of the comment and of the statement");
    }
}

/// The reference arm `R00` with one run, after a first faulty export of that name; an arm `Worn` whose joint 3 wears in
/// the last of four runs; and an arm `Bad` whose only export is empty. A baseline of three runs keeps the history
/// short.
fn fleet() -> Workshop {
    let workshop = Workshop::new();
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    fs::write(workshop.path("armwatch.toml"), config + "\n[detect]\nbaseline_runs = 3\n").expect("written");
    fs::write(workshop.inbox(REFERENCE_NAME), "time,pos_1\n0,0\n").expect("a faulty export");
    fs::write(workshop.inbox("Bad_20260101_0000.csv"), "").expect("an empty export");
    workshop.stdout(&["ingest", "inbox"], 1);
    fs::remove_file(workshop.inbox("Bad_20260101_0000.csv")).expect("removed");
    workshop.add_reference("inbox");
    let shape = ["--runs", "4", "--cycles", "2", "--warming-s", "0", "--name", "Worn"];
    workshop.simulate("inbox", &[&shape[..], &["--fault", "wear:joint=3,from=4,rate=0.5"]].concat());
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

#[test]
fn every_query_answers_its_question() {
    let workshop = fleet();
    // run_id of the runs, in the order of reading: empty 1, faulty 2, R00 3, Worn 4 to 7
    let rows = [
        ("fleet_overview.sql", 3),
        // four runs of two cycles are too short for a friction map, and therefore for an index
        ("friction_index_by_run.sql", 0),
        ("friction_over_speed.sql", 2 * 6 * 4),
        ("friction_over_time.sql", 2 * 6 * 2),
        ("open_anomalies.sql", 1),
        ("parameters_by_cycle.sql", 2 * 64),
        ("quarantine.sql", 2),
        ("rmsd_by_cycle.sql", 2 * 6),
        ("warm_friction_by_run.sql", 4 * 6),
    ];
    for query in queries() {
        let (_, fewest) = rows.iter().find(|(name, _)| *name == query.name).expect("a query with its rows");
        let left_out = query.ask(&workshop, "*", &[], "NULL");
        assert!(left_out.len() >= *fewest, "{}: {} rows of {fewest}", query.name, left_out.len());
        // Datasette and Grafana send the empty text for an empty field
        assert_eq!(query.ask(&workshop, "*", &[], "''"), left_out, "{}", query.name);
        if Query::parameters(query.body()).contains("robot") {
            let nobody = query.ask(&workshop, "*", &[("robot", "'Nobody'")], "NULL");
            assert_eq!(nobody, [""; 0], "{}", query.name);
        }
    }
    the_fleet_is_told_worst_first(&workshop);
    the_ratio_of_warm_friction_is_the_detectors(&workshop);
    the_fitted_curve_is_as_far_from_the_points_as_stored(&workshop);
    choices_are_kept(&workshop);
    a_corrected_export_is_told_from_an_open_one(&workshop);
}

fn the_fleet_is_told_worst_first(workshop: &Workshop) {
    let overview = Query::read("fleet_overview.sql");
    let told =
        overview.ask(workshop, "robot, status, worst_joint, complete_runs, quarantined_runs", &[], "NULL");
    assert_eq!(told, ["Worn|critical|3|4|0", "R00|learning||1|0", "Bad|untested||0|1"]);
    let open = Query::read("open_anomalies.sql").ask(workshop, "robot, joint, kind", &[], "NULL");
    // a rise by a half from one test to the next is no drift
    assert!(open.contains(&"Worn|3|step".to_owned()), "{open:?}");
}

/// The query and the detector compute it from the same points in different ways.
fn the_ratio_of_warm_friction_is_the_detectors(workshop: &Workshop) {
    let ratio = Query::read("warm_friction_by_run.sql");
    for joint in 1..=6 {
        let number = joint.to_string();
        let given = [("joint", number.as_str()), ("baseline_runs", "3")];
        let ours = ratio.number(workshop, "max(CASE WHEN run_id = 7 THEN warm_friction_ratio END)", &given);
        let stored =
            format!("SELECT friction_index FROM fleet_health WHERE robot = 'Worn' AND joint = {joint}");
        let stored: f64 = workshop.query(&stored)[0].parse().expect("an index");
        assert!((ours - stored).abs() < ROUNDING, "joint {joint}: {ours} {stored}");
        // four runs are too few for the shipped baseline of five
        let learning = ratio.number(workshop, "count(warm_friction_ratio)", &[("joint", &number)]);
        assert!(learning.abs() < ROUNDING, "joint {joint}: {learning}");
    }
}

fn the_fitted_curve_is_as_far_from_the_points_as_stored(workshop: &Workshop) {
    let curve = Query::read("friction_over_time.sql");
    let models = curve.ask(workshop, "DISTINCT model", &[("robot", "'R00'")], "NULL");
    assert!(models.iter().any(|model| model != "constant"), "no exponential to look at: {models:?}");
    for joint in 1..=6 {
        let number = joint.to_string();
        let given = [("robot", "'R00'"), ("joint", number.as_str())];
        let squares = "avg((friction_nm - fit_nm) * (friction_nm - fit_nm))";
        let rmsd = curve.number(workshop, squares, &given).sqrt();
        let stored = curve.number(workshop, "max(fit_rmsd_nm)", &given);
        assert!((rmsd - stored).abs() < ROUNDING, "joint {joint}: {rmsd} {stored}");
    }
}

fn choices_are_kept(workshop: &Workshop) {
    let parameters = Query::read("parameters_by_cycle.sql");
    // text in the form of a web form
    let given = [("robot", "'R00'"), ("joint", "'3'"), ("parameter", "'I_m'")];
    let band = "cycle, joint, parameter, low < value AND value < high";
    assert_eq!(
        parameters.ask(workshop, band, &given, "NULL"),
        ["1|3|I_m|1", "2|3|I_m|1", "3|3|I_m|1", "4|3|I_m|1", "5|3|I_m|1"]
    );
    // Student's quantile for 95 % with the 5 to 40 degrees of freedom of a cycle's blocks
    let wide = parameters.number(workshop, "sum(high - low)", &given[..1]);
    let errors = workshop.query("SELECT 2 * sum(std_error) FROM cycle_parameters WHERE robot = 'R00'");
    let quantile = wide / errors[0].parse::<f64>().expect("a sum");
    assert!((2.02..2.6).contains(&quantile), "{quantile}");

    let rmsd = Query::read("rmsd_by_cycle.sql");
    let whole = rmsd.number(workshop, "count(*)", &[("run_id", "4"), ("stage", "'all'"), ("joint", "2")]);
    assert!((whole - 2.0).abs() < ROUNDING, "{whole}");
    let marks = rmsd.ask(workshop, "DISTINCT mark, relative_rmsd > 0.10, relative_rmsd > 0.15", &[], "NULL");
    for mark in marks {
        assert!(["within 10 %|0|0", "over 10 %|1|0", "over 15 %|1|1"].contains(&mark.as_str()), "{mark}");
    }

    let speed = Query::read("friction_over_speed.sql");
    let given = [("robot", "'R00'"), ("cycle", "5"), ("joint", "4")];
    let curve = speed.ask(workshop, "cycle, joint, count(*), min(friction_nm) > 0", &given, "NULL");
    assert_eq!(curve, ["5|4|6|1"]);
}

fn a_corrected_export_is_told_from_an_open_one(workshop: &Workshop) {
    let quarantine = Query::read("quarantine.sql");
    let told = quarantine.ask(workshop, "robot, stored_run_id", &[], "NULL");
    assert_eq!(told, ["R00|3", "Bad|"]);
    assert_eq!(quarantine.ask(workshop, "robot", &[("unresolved", "1")], "NULL"), ["Bad"]);
}

/// Every statement of `examples/questions.sql`, run by `armwatch sql`.
#[test]
fn every_example_question_is_answered() {
    let workshop = fleet();
    let questions = example_questions();
    assert!(questions.len() >= 20, "{} statements", questions.len());
    let mut answered = 0;
    for (_, statement) in questions {
        let rows = workshop.stdout(&["sql", "--json", "--", &statement], 0);
        answered += usize::from(!rows.trim().is_empty());
    }
    // a small fleet has no repairs and no production logs
    assert!(answered >= 10, "{answered} have rows");
}

/// Files below a folder of the repository with one of these endings.
pub fn files_below(folder: &str, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![repository(folder)];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if endings.contains(&ending) {
                found.push(path);
            }
        }
    }
    found
}

/// Lines of a page outside its fenced blocks.
fn lines_of_text(page: &Path) -> Vec<String> {
    let text = fs::read_to_string(page).expect("a page");
    let mut is_code = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        if !is_code && !is_fence {
            lines.push(line.to_owned());
        }
    }
    lines
}

/// Anchors of the headings of a page, as GitHub makes them.
fn anchors(page: &Path) -> BTreeSet<String> {
    let link = regex::Regex::new(r"\[([^\]]*)\]\([^)]*\)").expect("a pattern");
    let lines = lines_of_text(page);
    let titles =
        lines.iter().filter(|line| line.starts_with('#')).map(|line| line.trim_start_matches('#').trim());
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    let mut found = BTreeSet::new();
    for title in titles {
        let plain = link.replace_all(title, "$1").to_lowercase().replace(' ', "-");
        let anchor: String = plain.chars().filter(|c| c.is_alphanumeric() || "-_".contains(*c)).collect();
        let count = counts.entry(anchor.clone()).or_default();
        found.insert(if *count == 0 { anchor } else { format!("{anchor}-{count}") });
        *count += 1;
    }
    found
}

#[test]
fn every_link_of_the_documents_has_a_target() {
    let mut pages: Vec<PathBuf> = ["README", "ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY"]
        .map(|name| repository(&format!("{name}.md")))
        .to_vec();
    for folder in ["docs", "dashboards", "fuzz", "tests", "crates"] {
        pages.extend(files_below(folder, &["md"]));
    }
    let code = regex::Regex::new("`[^`]*`").expect("a pattern");
    let link = regex::Regex::new(r"\]\(([^)\s#:]*)(?:#([^)\s]+))?\)").expect("a pattern");
    let mut missing = Vec::new();
    for page in pages {
        for line in lines_of_text(&page) {
            for found in link.captures_iter(&code.replace_all(&line, "")) {
                let target = if found[1].is_empty() { page.clone() } else { page.with_file_name(&found[1]) };
                let is_there = target.exists()
                    && found.get(2).is_none_or(|anchor| anchors(&target).contains(anchor.as_str()));
                if !is_there {
                    missing.push(format!("{}: {}", page.display(), &found[0]));
                }
            }
        }
    }
    assert!(missing.is_empty(), "links without a target:\n{}", missing.join("\n"));
}

/// Help texts, messages, comments and settings name documents that exist.
#[test]
fn every_document_that_the_sources_name_exists() {
    let named = regex::Regex::new(r"docs/[a-z_/-]+\.md").expect("a pattern");
    let mut missing = Vec::new();
    for folder in ["src", "crates", "lab", "config", "packaging", "examples", "dashboards", "tests"] {
        for file in files_below(folder, &["rs", "toml", "sql", "py", "service", "conf"]) {
            let text = fs::read_to_string(&file).expect("text");
            let absent = named.find_iter(&text).filter(|name| !repository(name.as_str()).exists());
            missing.extend(absent.map(|name| format!("{}: {}", file.display(), name.as_str())));
        }
    }
    assert!(missing.is_empty(), "documents that do not exist:\n{}", missing.join("\n"));
}

/// Files that ARCHITECTURE.md names in code exist.
#[test]
fn every_path_of_the_architecture_exists() {
    let text = fs::read_to_string(repository("ARCHITECTURE.md")).expect("the page");
    let path = regex::Regex::new(r"`((?:benches|config|crates|dashboards|docs|examples|fuzz|lab|migrations|packaging|src|tests)/[a-zA-Z0-9_/.-]+)`")
        .expect("a pattern");
    let named: Vec<&str> =
        path.captures_iter(&text).filter_map(|found| found.get(1)).map(|found| found.as_str()).collect();
    assert!(named.len() > 100, "{named:?}");
    let missing: Vec<&str> = named.into_iter().filter(|name| !repository(name).exists()).collect();
    assert!(missing.is_empty(), "paths that do not exist: {missing:?}");
}
