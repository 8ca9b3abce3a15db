//! The dashboards for Grafana: they follow the rules of its linter, every panel's statement has rows in a database of a
//! fleet, and a Prometheus that has scraped a daemon answers every PromQL expression.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use serde_json::Value;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{Column, Connection, Row, TypeInfo, ValueRef};

use crate::http;
use crate::small::{self, export};
use crate::support::wait_until;

/// The displayed time, s since 1970: the year 2026.
const SHOWN: (i64, i64) = (1_767_225_600, 1_798_761_599);

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("dashboards/grafana")
}

/// A dashboard of Grafana.
struct Dashboard {
    name: String,
    json: Value,
}

/// A query of a panel, an annotation or a variable.
struct Target<'d> {
    title: String,
    json: &'d Value,
}

impl Dashboard {
    /// All dashboards for a data source, `sqlite` or `prometheus`.
    fn all(of: &str) -> Vec<Self> {
        let mut found: Vec<Self> = fs::read_dir(folder().join("dashboards").join(of))
            .expect("dashboards")
            .map(|entry| {
                let path = entry.expect("an entry").path();
                let name = format!("{of}/{}", path.file_name().expect("a name").to_string_lossy());
                let json = serde_json::from_str(&fs::read_to_string(&path).expect("text"));
                Self { json: json.unwrap_or_else(|error| panic!("{name}: {error}")), name }
            })
            .collect();
        found.sort_by(|one, other| one.name.cmp(&other.name));
        found
    }

    fn variables(&self) -> &[Value] {
        array(&self.json["templating"]["list"])
    }

    /// Panels with content.
    fn panels(&self) -> impl Iterator<Item = &Value> {
        array(&self.json["panels"]).iter().filter(|panel| panel["type"] != "row")
    }

    /// Queries of panels and annotations.
    fn targets(&self) -> Vec<Target<'_>> {
        let of_panels = self.panels().flat_map(|panel| {
            let title = text(&panel["title"]);
            array(&panel["targets"]).iter().map(move |json| Target { title: title.to_owned(), json })
        });
        let of_annotations = array(&self.json["annotations"]["list"])
            .iter()
            .filter(|annotation| annotation["target"].is_object())
            .map(|annotation| Target {
                title: text(&annotation["name"]).to_owned(),
                json: &annotation["target"],
            });
        of_panels.chain(of_annotations).collect()
    }
}

fn array(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], |array| array)
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}

fn pattern(of: &str) -> regex::Regex {
    regex::Regex::new(of).expect("a pattern")
}

/// Rules of Grafana's dashboard-linter (template-datasource, panel-datasource, panel-title-description, panel-units,
/// panel-no-targets, target-rate-interval, target-job, target-instance, template-job, template-instance,
/// template-on-time-change-reload) and additional ones.
fn complaints(dashboard: &Dashboard, type_of_source: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut must = |holds: bool, what: String| {
        if !holds {
            found.push(format!("{}: {what}", dashboard.name));
        }
    };
    let json = &dashboard.json;
    must(json["schemaVersion"].as_i64() >= Some(39), "schemaVersion is old".into());
    must(json["editable"] == false, "can be edited, which provisioning would undo".into());
    must(!text(&json["description"]).is_empty(), "says not what it is for".into());
    let source = dashboard.variables().first().expect("a variable");
    must(
        source["type"] == "datasource" && source["query"] == type_of_source,
        "no variable for the source".into(),
    );
    let is_source = |value: &Value| value["uid"] == "${datasource}" && value["type"] == type_of_source;
    for variable in dashboard.variables() {
        let name = text(&variable["name"]);
        must(!text(&variable["label"]).is_empty(), format!("variable {name} has no label"));
        if variable["type"] == "query" {
            must(is_source(&variable["datasource"]), format!("variable {name} has another source"));
            must(variable["refresh"] == 2, format!("variable {name} is not asked again for another time"));
        }
    }
    let is_prometheus = type_of_source == "prometheus";
    let names: Vec<&str> = dashboard.variables().iter().map(|variable| text(&variable["name"])).collect();
    if is_prometheus {
        must(names.starts_with(&["datasource", "job", "instance"]), format!("variables {names:?}"));
    }
    let mut ids = BTreeSet::new();
    let mut places: Vec<[i64; 4]> = Vec::new();
    for panel in array(&json["panels"]) {
        let title = text(&panel["title"]);
        must(ids.insert(panel["id"].as_i64()), format!("{title}: a number that another panel has"));
        let side = |name: &str| panel["gridPos"][name].as_i64().unwrap_or(-1);
        let [x, y, w, h] = ["x", "y", "w", "h"].map(side);
        must(x >= 0 && y >= 0 && w > 0 && h > 0 && x + w <= 24, format!("{title}: outside of the grid"));
        let covers = |other: &[i64; 4]| {
            x < other[0] + other[2] && other[0] < x + w && y < other[1] + other[3] && other[1] < y + h
        };
        must(!places.iter().any(covers), format!("{title}: on top of another panel"));
        places.push([x, y, w, h]);
    }
    let rate = pattern(r"\b(?:rate|irate|increase|delta)\([^\[]*\[([^\]]*)\]");
    let variable = pattern(r"\$\{?(\w+)");
    for panel in dashboard.panels() {
        let title = text(&panel["title"]);
        must(
            !title.is_empty() && !text(&panel["description"]).is_empty(),
            format!("{title}: no title or description"),
        );
        must(is_source(&panel["datasource"]), format!("{title}: another source"));
        must(!text(&panel["fieldConfig"]["defaults"]["unit"]).is_empty(), format!("{title}: no unit"));
        must(
            !array(&panel["fieldConfig"]["defaults"]["thresholds"]["steps"]).is_empty(),
            format!("{title}: no thresholds"),
        );
        must(!array(&panel["targets"]).is_empty(), format!("{title}: no query"));
        let mut letters = BTreeSet::new();
        for target in array(&panel["targets"]) {
            must(letters.insert(text(&target["refId"])), format!("{title}: two queries of one letter"));
        }
    }
    for Target { title, json } in dashboard.targets() {
        must(is_source(&json["datasource"]), format!("{title}: a query to another source"));
        must(!text(&json["refId"]).is_empty(), format!("{title}: a query without letter"));
        let query = text(&json[if is_prometheus { "expr" } else { "rawQueryText" }]);
        must(!query.trim().is_empty(), format!("{title}: an empty query"));
        for found in variable.captures_iter(query) {
            let known = names.contains(&&found[1]) || found[1].starts_with("__");
            must(known, format!("{title}: no variable {}", &found[1]));
        }
        if is_prometheus {
            for found in rate.captures_iter(query) {
                must(&found[1] == "$__rate_interval", format!("{title}: a rate over {}", &found[1]));
            }
            let selectors = query.matches("armwatch_").count() + query.matches("process_").count();
            let selected = query.matches("job=~\"$job\", instance=~\"$instance\"").count();
            must(
                selected >= selectors.max(1),
                format!("{title}: not of the chosen job and instance: {query}"),
            );
        } else {
            must(json["queryText"] == json["rawQueryText"], format!("{title}: two different queries"));
        }
    }
    found
}

#[test]
fn dashboards_keep_the_rules_of_the_linter() {
    let mut names = BTreeSet::new();
    let mut links = BTreeSet::new();
    let link = pattern(r#""url": ?"/d/([\w-]+)"#);
    for (of, type_of_source) in [("sqlite", "frser-sqlite-datasource"), ("prometheus", "prometheus")] {
        let dashboards = Dashboard::all(of);
        assert!(dashboards.len() >= 2, "{of}");
        for dashboard in &dashboards {
            assert_eq!(complaints(dashboard, type_of_source), [""; 0]);
            assert!(names.insert(text(&dashboard.json["uid"]).to_owned()), "{}: uid", dashboard.name);
            let written = dashboard.json.to_string();
            links.extend(link.captures_iter(&written).map(|found| found[1].to_owned()));
        }
        let sources =
            fs::read_to_string(folder().join("provisioning/datasources/armwatch.yaml")).expect("sources");
        assert!(sources.contains(&format!("type: {type_of_source}")), "{type_of_source} is not provisioned");
    }
    assert!(!links.is_empty() && links.is_subset(&names), "links to {links:?} of {names:?}");
}

/// A linter that finds nothing is of no use.
/// Breaks a dashboard.
type Change<'a> = dyn Fn(&mut Value) + 'a;

#[test]
fn the_rules_find_what_breaks_them() {
    let find = |change: &dyn Fn(&mut Value)| {
        let mut dashboard = Dashboard::all("prometheus").remove(1);
        change(&mut dashboard.json);
        complaints(&dashboard, "prometheus").join("\n")
    };
    assert_eq!(find(&|_| ()), "");
    let panel = |json: &mut Value| -> usize {
        array(&json["panels"]).iter().position(|panel| panel["title"] == "Cycles stored").expect("a panel")
    };
    let cases: [(&str, &Change<'_>); 7] = [
        ("no unit", &|json| {
            let at = panel(json);
            json["panels"][at]["fieldConfig"]["defaults"]["unit"] = "".into();
        }),
        ("no title", &|json| {
            let at = panel(json);
            json["panels"][at]["description"] = "".into();
        }),
        ("another source", &|json| {
            let at = panel(json);
            json["panels"][at]["datasource"]["uid"] = "abc".into();
        }),
        ("a rate over 5m", &|json| {
            let at = panel(json);
            let expr = text(&json["panels"][at]["targets"][0]["expr"]).replace("$__rate_interval", "5m");
            json["panels"][at]["targets"][0]["expr"] = expr.into();
        }),
        ("not of the chosen", &|json| {
            let at = panel(json);
            json["panels"][at]["targets"][0]["expr"] = "armwatch_cycles".into();
        }),
        ("a number that another", &|json| {
            let at = panel(json);
            json["panels"][at]["id"] = 1.into();
        }),
        ("on top of", &|json| {
            let at = panel(json);
            json["panels"][at]["gridPos"]["y"] = 0.into();
        }),
    ];
    for (said, change) in cases {
        assert!(find(change).contains(said), "{said}: {}", find(change));
    }
}

/// A cell in the plugin's result.
#[derive(Debug, Clone, PartialEq)]
enum Cell {
    Null,
    Number(f64),
    Text(String),
}

struct Rows {
    columns: Vec<String>,
    rows: Vec<Vec<Cell>>,
}

async fn ask(connection: &mut SqliteConnection, sql: &str) -> Result<Rows, sqlx::Error> {
    let rows = sqlx::query(sqlx::AssertSqlSafe(sql)).fetch_all(&mut *connection).await?;
    let columns = rows.first().map(|row| row.columns().iter().map(|c| c.name().to_owned()).collect());
    let cell = |row: &sqlx::sqlite::SqliteRow, place: usize| {
        let raw = row.try_get_raw(place).expect("a cell");
        // NULL has the type of its column
        match raw.type_info().name() {
            _ if raw.is_null() => Cell::Null,
            "TEXT" => Cell::Text(row.get_unchecked(place)),
            "INTEGER" => Cell::Number(row.get_unchecked::<i64, _>(place) as f64),
            "REAL" => Cell::Number(row.get_unchecked(place)),
            other => panic!("{sql}: a column of type {other}"),
        }
    };
    let rows = rows.iter().map(|row| (0..row.len()).map(|place| cell(row, place)).collect()).collect();
    Ok(Rows { columns: columns.unwrap_or_default(), rows })
}

/// A statement in the form that reaches the database: Grafana replaces variables (`sqlstring` quotes each value and
/// joins them by commas), then the plugin its macros (frser-sqlite-datasource, pkg/plugin/macros.go and variables.go).
fn replaced(statement: &str, chosen: &BTreeMap<String, Vec<String>>) -> String {
    let variable = pattern(r"\$\{(\w+):sqlstring\}");
    let quoted = |value: &String| format!("'{}'", value.replace('\'', "''"));
    let statement = variable.replace_all(statement, |found: &regex::Captures<'_>| {
        let values = chosen.get(&found[1]).unwrap_or_else(|| panic!("no variable {}", &found[1]));
        values.iter().map(quoted).collect::<Vec<_>>().join(",")
    });
    let (from, to) = SHOWN;
    let statement =
        statement.replace("$__from", &(from * 1000).to_string()).replace("$__to", &(to * 1000).to_string());
    let macros = pattern(r"\$__([_a-zA-Z0-9]+)\(([^\)]*)\)");
    let statement = macros.replace_all(&statement, |found: &regex::Captures<'_>| {
        assert_eq!(&found[1], "timeFilter", "a macro that the plugin does not have, or this test");
        let column = &found[2];
        format!(
            "CAST(CASE WHEN typeof({column}) = 'integer' THEN {column} ELSE strftime(\"%s\", {column}) END AS INTEGER) \
             BETWEEN {from} AND {to}"
        )
    });
    assert!(!statement.contains('$'), "not replaced: {statement}");
    statement.into_owned()
}

/// Time of a cell, s, as the plugin reads it: a number of seconds, or text of RFC 3339.
fn seconds(title: &str, cell: &Cell) -> Option<f64> {
    match cell {
        Cell::Null => None,
        Cell::Number(seconds) => Some(*seconds),
        Cell::Text(text) => {
            let at: jiff::Timestamp =
                text.parse().unwrap_or_else(|error| panic!("{title}: {text:?}: {error}"));
            Some(at.as_millisecond() as f64 / 1e3)
        }
    }
}

/// Conditions of the plugin for the rows: times must be times. A time series must rise, with numbers as values and
/// texts as names.
fn check_rows(title: &str, target: &Value, answer: &Rows) {
    let times = array(&target["timeColumns"]);
    for name in times {
        let place = answer.columns.iter().position(|column| column == text(name));
        let place = place.unwrap_or_else(|| panic!("{title}: no column {name} in {:?}", answer.columns));
        let at: Vec<Option<f64>> = answer.rows.iter().map(|row| seconds(title, &row[place])).collect();
        if target["queryType"] == "time series" {
            assert!(at.iter().all(Option::is_some), "{title}: a row without time");
            assert!(at.is_sorted(), "{title}: times do not rise");
        }
    }
    if target["queryType"] == "time series" {
        let has_number = answer.rows.iter().any(|row| {
            (0..row.len())
                .any(|place| answer.columns[place] != "time" && matches!(row[place], Cell::Number(_)))
        });
        assert!(has_number, "{title}: a time series without numbers");
    }
    let mut names = BTreeSet::new();
    assert!(answer.columns.iter().all(|name| names.insert(name)), "{title}: {:?}", answer.columns);
}

/// Rows that a small fleet does not have: an alarm, an index and temperatures, a baseline after maintenance, a message
/// that waits, an export that is being read, and a cycle without parameters.
const MORE: &str = "
    INSERT INTO anomaly (robot_id, joint, kind, quantity, severity, score, threshold, value, baseline, first_run_id, last_run_id,
                         first_seen_at, last_seen_at, onset_at, state, message)
        SELECT robot_id, 3, 'step', 'friction_index', 'critical', 0.3, 0.06, 1.3, 1.0, max(run_id), max(run_id),
               max(started_at), max(started_at), max(started_at), 'open', 'joint 3: friction is 30 % above the baseline'
        FROM robot JOIN run USING (robot_id) WHERE name = 'Worn';
    INSERT INTO anomaly_event (anomaly_id, what, severity, message) SELECT anomaly_id, 'opened', severity, message FROM anomaly;
    INSERT INTO run_friction_index (run_id, joint, friction_index, friction_index_std_error, ambient_coldness, coldness_at_start, points)
        SELECT run_id, joint, 1.0 + run_id / 100.0, 0.01, 0.0, 0.5, 20 FROM runs JOIN fleet_health USING (robot)
        WHERE robot = 'Worn' AND runs.status = 'complete';
    INSERT INTO cycle_temperature (cycle_id, joint, temperature_degc)
        SELECT cycle_id, joint, 30.0 + joint FROM cycle, (SELECT 0 AS joint UNION SELECT 3)
        WHERE run_id IN (SELECT run_id FROM runs WHERE robot = 'Worn');
    INSERT INTO friction_baseline (robot_id, joint, epoch, cause, begins_at, formed_at, basis, levels)
        SELECT robot_id, 3, 1, 'maintenance', 1767700000000000, 1767700000000000, zeroblob(32), '[]' FROM robot WHERE name = 'Worn';
    INSERT INTO friction_baseline_run SELECT max(friction_baseline_id), 1 FROM friction_baseline;
    INSERT INTO delivery_route (name, seen_event_id) VALUES ('shift', 0);
    INSERT INTO delivery (delivery_route_id, anomaly_event_id, state, created_at, due_at, error)
        SELECT 1, min(anomaly_event_id), 'pending', 1767700000000000, 1767700000000000, 'no answer' FROM anomaly_event;
    INSERT INTO run (robot_id, model, started_at, source_name, source_path, source_bytes, content_hash, status, ingested_at)
        SELECT robot_id, 'er3a', 1767700000000000, 'Worn_20260106_1146.csv', '/inbox/Worn_20260106_1146.csv', 0, randomblob(32), 'streaming', 1767700000000000
        FROM robot WHERE name = 'Worn';
    UPDATE cycle SET status = 'refused', reason = 'the torque of joint 2 stands still' WHERE cycle_id = (SELECT max(cycle_id) FROM cycle);
";

#[test]
fn every_sqlite_panel_has_rows_of_a_fleet() {
    let workshop = small::workshop();
    let fine = [export("Worn", 1, 5), export("Worn", 2, 6), export("Other", 3, 5)];
    for export in fine.iter().chain([&export("Bad", 4, 5).spoiled()]) {
        workshop.add(export);
    }
    workshop.stdout(&["ingest", "inbox"], 1);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(workshop.path("armwatch.db"));
        let mut database = SqliteConnection::connect_with(&options).await.expect("the database");
        sqlx::raw_sql(MORE).execute(&mut database).await.expect("more rows");
        database.close().await.expect("closed");
        let mut database =
            SqliteConnection::connect_with(&options.read_only(true)).await.expect("the database");
        let mut panels = 0;
        for dashboard in Dashboard::all("sqlite") {
            let mut chosen = BTreeMap::new();
            for variable in dashboard.variables().iter().filter(|variable| variable["type"] == "query") {
                let name = text(&variable["name"]);
                let answer = ask(&mut database, &replaced(text(&variable["query"]), &chosen)).await;
                let answer = answer.unwrap_or_else(|error| panic!("{}, {name}: {error}", dashboard.name));
                assert_eq!(answer.columns.len(), 1, "{}: {name} has one column", dashboard.name);
                let values = answer.rows.into_iter().map(|mut row| match row.remove(0) {
                    Cell::Text(text) => text,
                    other => panic!("{name}: {other:?}"),
                });
                let mut values: Vec<String> = values.collect();
                if variable["multi"] == false {
                    values.retain(|value| name != "robot" || value == "Worn");
                    values.truncate(1);
                }
                assert!(!values.is_empty(), "{}: nothing to choose for {name}", dashboard.name);
                chosen.insert(name.to_owned(), values);
            }
            for Target { title, json } in dashboard.targets() {
                let title = format!("{}, {title}", dashboard.name);
                let statement = replaced(text(&json["rawQueryText"]), &chosen);
                let answer = ask(&mut database, &statement).await;
                let answer = answer.unwrap_or_else(|error| panic!("{title}: {error}\n{statement}"));
                assert!(!answer.rows.is_empty(), "{title}: no rows\n{statement}");
                let is_number = |row: &Vec<Cell>| row.iter().any(|cell| *cell != Cell::Null);
                assert!(answer.rows.iter().any(is_number), "{title}: nothing but NULL");
                check_rows(&title, json, &answer);
                panels += 1;
            }
            // a quote in a robot's name must not break a statement
            let hostile =
                chosen.keys().map(|name| (name.clone(), vec!["O'Neill') OR 1=1 --".to_owned()])).collect();
            for Target { title, json } in dashboard.targets() {
                let statement = replaced(text(&json["rawQueryText"]), &hostile);
                let answer = ask(&mut database, &statement).await;
                assert!(answer.is_ok(), "{title}: {:?}\n{statement}", answer.err());
            }
        }
        assert!(panels > 35, "{panels}");
    });
}

/// A process that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Metrics without a sample if all is well: no failed answer, no message, and no test that is being written.
const SILENT: [&str; 7] = [
    "armwatch_live_",
    "armwatch_delivery_",
    "armwatch_deliveries",
    "status=~\"5..\"",
    "armwatch_robot_quarantined_exports",
    "armwatch_joint_friction_index_ratio",
    "status=~\"critical|warning|unknown|overdue\"} == 1",
];

/// Name of a metric without the suffixes of histograms.
fn family(name: &str) -> &str {
    ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end)).unwrap_or(name)
}

#[test]
fn every_promql_expression_is_answered_from_figures_of_a_daemon() {
    let workshop = small::workshop();
    let (port, prometheus_port) = (http::free_port(), http::free_port());
    let path = workshop.path("armwatch.toml");
    let config = fs::read_to_string(&path).expect("the configuration");
    let serve = format!("[serve]\nlisten = \"127.0.0.1:{port}\"\n\n[snapshot]\nfile = \"copy.db\"\n\n");
    fs::write(&path, serve + &config).expect("written");
    let daemon = workshop.daemon();
    let export = export("A", 1, 5);
    workshop.add(&export);
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    workshop.wait_until_idle();
    // the first answer is counted in the second
    let [_, figures] =
        [(); 2].map(|()| http::try_send(port, "GET /metrics", "", b"").expect("an answer").body);
    let told: BTreeSet<&str> =
        figures.lines().filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next()).collect();

    // documents and rules name existing metrics, or those of growing files, routes and quarantine
    let source = ["src/metrics.rs", "src/serve/metrics.rs"]
        .map(|file| fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).expect("a source"));
    let named = pattern(r"\b(?:armwatch|process)_[a-z_]*[a-z]\b");
    let rules = folder().join("../prometheus/armwatch.rules.yml");
    let guide = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md");
    let mut written: Vec<String> =
        [rules, guide.clone()].iter().map(|path| fs::read_to_string(path).expect("text")).collect();
    let dashboards = Dashboard::all("prometheus");
    written.extend(dashboards.iter().map(|dashboard| dashboard.json.to_string()));
    for text in &written {
        for found in named.find_iter(text) {
            let name = family(found.as_str());
            let exists =
                told.contains(name) || source.iter().any(|source| source.contains(&format!("\"{name}\"")));
            assert!(exists, "there is no figure {name}");
        }
    }
    let guide = fs::read_to_string(guide).expect("docs/metrics.md");
    for name in &told {
        assert!(guide.contains(&format!("`{name}`")), "docs/metrics.md does not have {name}");
    }
    // stored cycles and exports are counted
    let value = |sample: &str| -> Option<f64> {
        figures.lines().find_map(|line| line.strip_prefix(sample)?.trim().parse().ok())
    };
    assert_eq!(value("armwatch_cycles_stored_total"), Some(3.0), "{figures}");
    assert_eq!(value("armwatch_exports_total{end=\"stored\"}"), Some(1.0), "{figures}");
    for stage in ["read", "analyse", "record"] {
        let count = value(&format!("armwatch_stage_duration_seconds_count{{stage=\"{stage}\"}}"));
        assert_eq!(count, Some(3.0), "{stage}");
    }
    for stage in ["finish", "conclude"] {
        let count = value(&format!("armwatch_stage_duration_seconds_count{{stage=\"{stage}\"}}"));
        assert!(count >= Some(1.0), "{stage}: {count:?}");
    }
    assert_eq!(value("armwatch_read_bytes_total"), Some(export.bytes.len() as f64), "{figures}");

    let scrape = format!(
        "global: {{scrape_interval: 250ms}}\nscrape_configs:\n  - job_name: armwatch\n    static_configs:\n      \
         - targets: ['127.0.0.1:{port}']\n"
    );
    fs::write(workshop.path("prometheus.yml"), scrape).expect("written");
    let mut prometheus = Command::new("prometheus");
    prometheus
        .args(["--config.file=prometheus.yml", "--storage.tsdb.path=tsdb"])
        .arg(format!("--web.listen-address=127.0.0.1:{prometheus_port}"))
        .current_dir(workshop.path(""))
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    let Ok(child) = prometheus.spawn() else {
        println!("skipped: prometheus of Debian's package prometheus is not installed");
        return;
    };
    let _running = Running(child);
    let query = |expression: &str| -> Option<Value> {
        let encoded: String = expression.bytes().map(|byte| format!("%{byte:02X}")).collect();
        let line = format!("GET /api/v1/query?query={encoded}");
        // the answer is plain text while it is not ready
        serde_json::from_str(&chunks(&http::try_send(prometheus_port, &line, "", b"")?)).ok()
    };
    // a rate needs two scrapes
    let scraped = || {
        let count = query("count_over_time(armwatch_build_info[1m])");
        let count = count.as_ref().map(|answer| text(&answer["data"]["result"][0]["value"][1]).to_owned());
        count.and_then(|count| count.parse().ok()).unwrap_or(0) >= 3
    };
    wait_until(scraped, || "prometheus does not scrape".to_owned());
    let mut answered = 0;
    for dashboard in &dashboards {
        for Target { title, json } in dashboard.targets() {
            let expression = ["$job", "$instance", "$robot", "$joint"]
                .iter()
                .fold(text(&json["expr"]).to_owned(), |expression, name| expression.replace(name, ".+"))
                .replace("$__rate_interval", "1m");
            let title = format!("{}, {title}: {expression}", dashboard.name);
            let answer = query(&expression).expect("an answer");
            assert_eq!(answer["status"], "success", "{title}: {answer}");
            let has_rows = !array(&answer["data"]["result"]).is_empty();
            assert!(
                has_rows || SILENT.iter().any(|silent| expression.contains(silent)),
                "{title}: no sample"
            );
            answered += usize::from(has_rows);
        }
    }
    assert!(answered > 35, "{answered}");
    daemon.stop();
}

/// The body of an answer, which may be chunked.
fn chunks(answer: &http::Answer) -> String {
    if answer.header("transfer-encoding") != Some("chunked") {
        return answer.body.clone();
    }
    let (mut whole, mut rest) = (String::new(), answer.body.as_str());
    while let Some((size, after)) = rest.split_once("\r\n") {
        let size = usize::from_str_radix(size.trim(), 16).expect("a size");
        if size == 0 {
            break;
        }
        whole.push_str(&after[..size]);
        rest = after[size..].trim_start_matches("\r\n");
    }
    whole
}
