//! HTTP interface of the daemon except for exports: the dashboard, rows of the views, events, actions, and its
//! description.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::http::{self, Answer};
use crate::small::{self, export};
use crate::support::{Daemon, Workshop, wait_until};

pub(crate) const TOKEN: &str = "a-token-of-this-test-0123456789";

/// A daemon that serves, on a database with one alarm of robot A.
pub(crate) struct Served {
    pub(crate) workshop: Workshop,
    daemon: Daemon,
    port: u16,
}

impl Served {
    fn new(token: bool) -> Self {
        Self::with(token, "")
    }

    /// With additional settings in `[serve]`.
    pub(crate) fn with(token: bool, more: &str) -> Self {
        let workshop = small::workshop();
        let port = http::free_port();
        let path = workshop.path("armwatch.toml");
        let config = fs::read_to_string(&path).expect("the configuration");
        let token_file = if token { "token_file = \"token\"\n" } else { "" };
        fs::write(&path, format!("[serve]\nlisten = \"127.0.0.1:{port}\"\n{token_file}{more}\n{config}"))
            .expect("written");
        fs::write(workshop.path("token"), TOKEN).expect("a token");
        fs::write(workshop.path("screen"), "token-of-a-screen-0123").expect("a token");
        workshop.add(&export("A", 1, 5));
        workshop.stdout(&["ingest", "inbox"], 0);
        let daemon = workshop.daemon();
        let served = Self { workshop, daemon, port };
        let is_ready =
            || http::try_send(port, "GET /ready", "", b"").is_some_and(|answer| answer.status == 200);
        wait_until(is_ready, || "the daemon does not listen".to_owned());
        served
    }

    pub(crate) fn ask(&self, line: &str, headers: &str, body: &[u8]) -> Answer {
        http::try_send(self.port, line, headers, body).unwrap_or_else(|| panic!("no answer to {line}"))
    }

    pub(crate) fn get(&self, address: &str) -> Answer {
        self.ask(&format!("GET {address}"), &format!("Authorization: Bearer {TOKEN}\r\n"), b"")
    }

    fn post(&self, address: &str, body: &Value) -> Answer {
        let headers = format!("Authorization: Bearer {TOKEN}\r\nContent-Type: application/json\r\n");
        self.ask(&format!("POST {address}"), &headers, body.to_string().as_bytes())
    }

    pub(crate) fn end(self) {
        self.daemon.signal("TERM");
        assert_eq!(self.daemon.end(), Some(0));
    }
}

#[test]
fn rows_of_the_views_are_those_of_the_database() {
    let served = Served::new(false);
    let views = served.get("/v1/views").json();
    let listed = views["views"].as_array().expect("views").len();
    let known = served.workshop.number("SELECT count(*) FROM sqlite_schema WHERE type = 'view'");
    assert_eq!(i64::try_from(listed).expect("a count"), known);

    let rows = served.get("/v1/views/cycle_parameters?run_id=1&cycle=2&parameter=f1&order=-joint");
    let stored = served.workshop.query(
        "SELECT value FROM cycle_parameters WHERE run_id = 1 AND cycle = 2 AND parameter = 'f1' ORDER BY joint DESC",
    );
    // with all digits, in the requested order
    let places: Vec<Option<usize>> =
        stored.iter().map(|value| rows.body.find(&format!("\"value\":{value}}}"))).collect();
    assert!(!places.is_empty() && places.iter().all(Option::is_some) && places.is_sorted(), "{}", rows.body);

    let cut = served.get("/v1/views/cycles?limit=2").json();
    assert_eq!((cut["rows"].as_array().map(Vec::len), cut["truncated"].as_bool()), (Some(2), Some(true)));
    let none = served.get("/v1/views/runs?superseded_by_run_id=null&robot=nobody").json();
    assert_eq!((none["rows"].as_array().map(Vec::len), none["truncated"].as_bool()), (Some(0), Some(false)));
    for (address, said) in [
        ("/v1/views/run", "there is no view run"),
        ("/v1/views/runs?robots=A", "no column robots"),
        ("/v1/views/runs?order=x%22;--", "no column"),
        ("/v1/views/runs?limit=0", "from 1 to"),
    ] {
        let refused = served.get(address);
        assert_eq!(refused.status, if said.starts_with("there is no view") { 404 } else { 400 }, "{address}");
        assert!(refused.json()["error"].as_str().is_some_and(|text| text.contains(said)), "{}", refused.body);
    }
    served.end();
}

#[test]
fn the_fleet_is_told_as_the_views_have_it() {
    let served = Served::new(false);
    let fleet = served.get("/v1/fleet").json();
    assert_eq!(fleet["counts"]["complete_runs"], 1);
    let robot = &fleet["robots"][0];
    assert_eq!((robot["robot"].as_str(), robot["status"].as_str()), (Some("A"), Some("learning")));
    assert_eq!(robot["last_result_at"], "2026-01-05T08:47:00.000Z");
    let joints = robot["joints"].as_array().expect("joints");
    assert_eq!(
        joints.len(),
        usize::try_from(served.workshop.number("SELECT count(*) FROM fleet_health")).expect("a count")
    );
    assert!(joints.iter().all(|joint| joint["status"] == "learning" && joint["history"].is_array()));
    served.end();
}

#[test]
fn the_dashboard_is_served_whole_and_asks_nobody_else() {
    let served = Served::new(true);
    let page = served.ask("GET /", "", b"");
    assert_eq!((page.status, page.header("content-type")), (200, Some("text/html; charset=utf-8")));
    let policy = page.header("content-security-policy").expect("a policy");
    assert!(policy.contains("default-src 'self'"), "{policy}");
    let files: Vec<&str> = page.body.split('"').filter_map(|part| part.strip_prefix("assets/")).collect();
    assert!(!files.is_empty(), "{}", page.body);
    for file in files {
        let asset = served.ask(&format!("GET /assets/{file}"), "", b"");
        assert_eq!(asset.status, 200, "{file}");
        let tag = asset.header("etag").expect("a tag").to_owned();
        let again = served.ask(&format!("GET /assets/{file}"), &format!("If-None-Match: {tag}\r\n"), b"");
        assert_eq!((again.status, again.body.len()), (304, 0), "{file}");
    }
    assert_eq!(served.ask("GET /assets/..%2Fapi.rs", "", b"").status, 404);
    served.end();
}

#[test]
fn a_token_opens_reading_and_acting_and_without_one_nothing_is_changed() {
    let closed = Served::new(true);
    for address in ["/v1/fleet", "/v1/views", "/v1/views/runs", "/v1/events"] {
        assert_eq!(closed.ask(&format!("GET {address}"), "", b"").status, 401, "{address}");
    }
    let session = closed.ask("GET /v1/session", "", b"").json();
    assert_eq!(
        (&session["needs_token"], &session["may_read"], &session["may_act"]),
        (&json!(true), &json!(false), &json!(false))
    );
    assert_eq!(closed.get("/v1/session").json()["may_act"], true);
    let other_page = format!("Authorization: Bearer {TOKEN}\r\nOrigin: https://evil.example\r\n");
    assert_eq!(closed.ask("GET /v1/fleet", &other_page, b"").status, 403);
    closed.end();

    let open = Served::new(false);
    assert_eq!(open.ask("GET /v1/fleet", "", b"").status, 200);
    assert_eq!(open.ask("GET /v1/fleet", "Host: evil.example\r\n", b"").status, 403);
    let refused = open.ask("POST /v1/robots/A/maintenance", "Content-Type: application/json\r\n", b"{}");
    assert_eq!(refused.status, 403);
    assert!(refused.body.contains("token_file"), "{}", refused.body);
    open.end();
}

#[test]
fn work_on_a_robot_is_entered_and_wrong_requests_say_what_is_wrong() {
    let served = Served::new(true);
    let entered = served
        .post("/v1/robots/A/maintenance", &json!({"who": "Lena", "what": "gearbox changed", "joint": 2}));
    assert_eq!(entered.status, 201, "{}", entered.body);
    let row = served.workshop.query("SELECT robot, joint, what, who, at FROM maintenance_log");
    let at = entered.json()["at"].as_str().expect("a time").to_owned();
    assert_eq!(row, [format!("A|2|gearbox changed|Lena|{at}")]);
    // a double click
    let again = served
        .post("/v1/robots/A/maintenance", &json!({"who": "Otto", "what": "gearbox changed", "joint": 2}));
    assert_eq!(again.status, 409, "{}", again.body);
    assert!(again.body.contains("entered already, as number 1: A, joint 2, "), "{}", again.body);
    assert_eq!(served.workshop.number("SELECT count(*) FROM maintenance_log"), 1);
    let other_joint = json!({"who": "Otto", "what": "gearbox changed", "joint": 1});
    assert_eq!(served.post("/v1/robots/A/maintenance", &other_joint).status, 201);
    for (address, body, status, said) in [
        ("/v1/robots/B/maintenance", json!({"who": "Lena", "what": "x"}), 404, "no export of a robot"),
        ("/v1/robots/A/maintenance", json!({"who": "Lena", "what": "x", "joint": 9}), 400, "no joint 9"),
        ("/v1/robots/A/maintenance", json!({"who": " ", "what": "x"}), 400, "give who"),
        (
            "/v1/robots/A/maintenance",
            json!({"who": "Lena", "what": "x", "at": "2999-01-01T00:00:00Z"}),
            400,
            "in the future",
        ),
        ("/v1/robots/A/maintenance", json!({"who": "Lena", "waht": "x"}), 400, "waht"),
        ("/v1/robots/A/maintenance", json!({"what": "x"}), 400, "missing field `who`"),
        ("/v1/robots/A/maintenance", json!({"what": "x"}), 400, "\"what\": \"gearbox changed\""),
        ("/v1/robots/A/maintenance", json!({"who": "Lena", "what": "x", "joint": "y"}), 400, "joint: "),
        ("/v1/robots/A/maintenance", json!({"who": "x".repeat(300_000)}), 413, "larger than 256 KiB"),
        ("/v1/anomalies/x/acknowledge", json!({"who": "Lena"}), 400, "anomaly \"x\" is no whole number"),
        ("/v1/quarantine/x/retry", json!({}), 400, "run \"x\" is no whole number"),
        ("/v1/anomalies/7/acknowledge", json!({"who": "Lena"}), 404, "no anomaly 7"),
        ("/v1/anomalies/7/shelve", json!({"who": "Lena"}), 400, "until"),
        ("/v1/anomalies/7/forget", json!({"who": "Lena"}), 404, "no action forget"),
        ("/v1/quarantine/1/retry", json!({}), 409, "not in quarantine"),
    ] {
        let refused = served.post(address, &body);
        assert_eq!(refused.status, status, "{address} {body}: {}", refused.body);
        assert!(refused.json()["error"].as_str().is_some_and(|text| text.contains(said)), "{}", refused.body);
        assert!(
            !refused.body.contains("deserialize") && !refused.body.contains("Invalid URL"),
            "{}",
            refused.body
        );
    }
    for address in ["/v1/session", "/v1/fleet"] {
        let now = served.get(address).json()["now"].as_str().expect("a time").to_owned();
        assert!(now.len() == "2026-01-05T08:47:00.000Z".len() && now.ends_with('Z'), "{address}: {now}");
    }
    served.end();
}

#[test]
fn an_alarm_has_comments_a_person_and_a_window() {
    let served = Served::new(true);
    small_alarm(&served.workshop);
    let row = |answer: Answer| {
        assert_eq!(answer.status, 200, "{}", answer.body);
        let row = answer.json();
        (row["state"].clone(), row["assignee"].clone())
    };
    let said = json!({"who": "Lena", "why": "grease is ordered"});
    assert_eq!(row(served.post("/v1/anomalies/1/comment", &said)), (json!("open"), Value::Null));
    let assigned = served.post("/v1/anomalies/1/assign", &json!({"who": "Lena", "to": "Otto"}));
    assert_eq!(row(assigned), (json!("open"), json!("Otto")));
    let history =
        "SELECT what, who, why FROM anomaly_history WHERE who IS NOT NULL ORDER BY anomaly_event_id";
    let told = ["commented|Lena|grease is ordered", "assigned|Lena|Otto"];
    assert_eq!(served.workshop.query(history), told);
    assert_eq!(row(served.post("/v1/anomalies/1/assign", &json!({"who": "Otto"}))).1, Value::Null);

    let until = (jiff::Timestamp::now() + jiff::SignedDuration::from_hours(2)).to_string();
    let plan = json!({"who": "Lena", "what": "gearbox is changed", "until": until});
    let planned = served.post("/v1/robots/A/windows", &plan);
    assert_eq!(planned.status, 201, "{}", planned.body);
    let state = || served.workshop.query("SELECT state FROM anomalies").join("|");
    assert_eq!(state(), "maintenance");
    let number = planned.json()["maintenance_window_id"].as_i64().expect("a number");
    let cancel = format!("DELETE /v1/windows/{number}");
    let may = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(served.ask(&cancel, &may, b"").status, 204);
    assert_eq!((served.ask(&cancel, &may, b"").status, state()), (404, "open".to_owned()));
    for (address, body, status, words) in [
        ("/v1/anomalies/1/comment", json!({"who": "Lena"}), 400, "why is missing"),
        ("/v1/anomalies/9/assign", json!({"who": "Lena"}), 404, "no anomaly 9"),
        ("/v1/robots/B/windows", plan.clone(), 404, "no export of a robot"),
        (
            "/v1/robots/A/windows",
            json!({"who": "Lena", "what": "x", "until": "2020-01-01T00:00:00Z"}),
            400,
            "in the future",
        ),
        (
            "/v1/robots/A/windows",
            json!({"who": "Lena", "what": "x", "until": "2999-01-01T00:00:00Z"}),
            400,
            "366 days",
        ),
    ] {
        let refused = served.post(address, &body);
        assert_eq!(refused.status, status, "{address} {body}: {}", refused.body);
        assert!(refused.body.contains(words), "{}", refused.body);
    }

    let work = json!({"who": "Lena", "what": "gearbox changed", "joint": 2, "at": "2026-01-05T08:47:00Z"});
    assert_eq!(served.post("/v1/robots/A/maintenance", &work).status, 201);
    let sent = format!("{may}Content-Type: application/json\r\n");
    let corrected =
        json!({"who": "Otto", "what": "grease renewed", "joint": 2, "at": "2026-01-05T08:47:00Z"})
            .to_string();
    let edited = served.ask("PUT /v1/maintenance/1", &sent, corrected.as_bytes());
    assert_eq!((edited.status, edited.json()["maintenance_id"].as_i64()), (200, Some(1)), "{}", edited.body);
    let log = "SELECT maintenance_id, joint, what, who FROM maintenance_log";
    assert_eq!(served.workshop.query(log), ["1|2|grease renewed|Otto"]);
    assert_eq!(served.ask("PUT /v1/maintenance/9", &sent, corrected.as_bytes()).status, 404);
    served.end();
}

#[test]
fn an_alarm_is_answered_and_its_history_says_who_did_it() {
    let served = Served::new(true);
    // written like by a conclusion
    small_alarm(&served.workshop);
    let answered =
        served.post("/v1/anomalies/1/acknowledge", &json!({"who": "Lena", "why": "spare part ordered"}));
    assert_eq!(
        (answered.status, answered.json()["state"].as_str()),
        (200, Some("acknowledged")),
        "{}",
        answered.body
    );
    let fleet = served.get("/v1/fleet").json();
    assert_eq!(fleet["anomalies"][0]["anomaly_id"], 1, "{fleet}");
    let history = served.get("/v1/views/anomaly_history?anomaly_id=1&order=-anomaly_event_id").json();
    assert_eq!(
        (history["rows"][0]["who"].as_str(), history["rows"][0]["why"].as_str()),
        (Some("Lena"), Some("spare part ordered"))
    );
    let again = served.post("/v1/anomalies/1/acknowledge", &json!({"who": "Lena"}));
    assert_eq!(again.status, 409, "{}", again.body);
    let shelved =
        served.post("/v1/anomalies/1/shelve", &json!({"who": "Lena", "until": "2999-01-01T00:00:00Z"}));
    assert_eq!(shelved.json()["state"].as_str(), Some("shelved"), "{}", shelved.body);
    small_anomaly(&served.workshop, 2, "critical");
    let too_long =
        served.post("/v1/anomalies/2/shelve", &json!({"who": "Lena", "until": "2999-01-01T00:00:00Z"}));
    assert_eq!(too_long.status, 400, "{}", too_long.body);
    assert!(
        too_long.body.contains("is critical and can be shelved for 90 days at most"),
        "{}",
        too_long.body
    );
    served.end();
}

#[test]
fn the_fleet_counts_alarms_and_what_is_worth_knowing_apart_and_in_all_places_alike() {
    let served = Served::new(true);
    small_anomaly(&served.workshop, 1, "warning");
    small_anomaly(&served.workshop, 2, "info");
    let counted = |of: &Value| ["open_anomalies", "open_alarms", "open_infos"].map(|name| of[name].as_i64());
    let fleet = served.get("/v1/fleet").json();
    assert_eq!(counted(&fleet["counts"]), [Some(2), Some(1), Some(1)], "{fleet}");
    assert_eq!(counted(&fleet["robots"][0]), [Some(2), Some(1), Some(1)], "{fleet}");
    let joints = &fleet["robots"][0]["joints"];
    assert_eq!(counted(&joints[0]), [Some(1), Some(1), Some(0)], "{fleet}");
    assert_eq!(counted(&joints[1]), [Some(1), Some(0), Some(1)], "{fleet}");
    served.end();
}

#[test]
fn work_puts_the_alarms_of_its_joint_into_maintenance_and_says_who_entered_it() {
    let served = Served::new(true);
    small_anomaly(&served.workshop, 1, "warning");
    small_anomaly(&served.workshop, 2, "warning");
    let work = json!({"who": "Lena", "what": "gearbox changed", "joint": 1});
    assert_eq!(served.post("/v1/robots/A/maintenance", &work).status, 201);
    // the robot may have been evaluated again by now, which withdraws an anomaly that was only inserted by the test
    let history = served.get("/v1/views/anomaly_history?what=maintenance").json();
    let rows = history["rows"].as_array().expect("rows");
    let told = |row: &Value| [&row["anomaly_id"], &row["who"], &row["why"]].map(Value::to_string).join(" ");
    assert_eq!(rows.iter().map(told).collect::<Vec<_>>(), ["1 \"Lena\" \"gearbox changed\""]);
    served.end();
}

pub(crate) fn small_alarm(workshop: &Workshop) {
    small_anomaly(workshop, 1, "warning");
}

/// Inserts an anomaly like a conclusion does.
fn small_anomaly(workshop: &Workshop, joint: u8, severity: &str) {
    use sqlx::Connection;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let url = format!("sqlite://{}", workshop.path("armwatch.db").display());
        let mut connection = sqlx::SqliteConnection::connect(&url).await.expect("a connection");
        let statement = format!(
            "INSERT INTO anomaly (robot_id, joint, kind, quantity, severity, score, threshold, value, baseline, first_run_id,
                                  last_run_id, first_seen_at, last_seen_at, state, message)
             SELECT robot_id, {joint}, 'drift', 'friction_index', '{severity}', 0.1, 0.05, 1.1, 1.0, run_id, run_id,
                    started_at, started_at, 'open', 'joint {joint}: friction is 10 % above its baseline'
             FROM run LIMIT 1"
        );
        sqlx::raw_sql(sqlx::AssertSqlSafe(statement)).execute(&mut connection).await.expect("an anomaly");
    });
}

#[test]
fn a_page_hears_of_a_change_and_the_stream_ends_with_the_daemon() {
    let served = Served::new(false);
    let mut stream = TcpStream::connect(("127.0.0.1", served.port)).expect("a connection");
    stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
    stream.write_all(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("sent");
    let mut lines = BufReader::new(stream).lines();
    // a stream with only heartbeats would never end the loop
    let limit = Instant::now() + Duration::from_secs(120);
    let mut heard = |wanted: &str| {
        let until = |_: &String| Instant::now() < limit;
        lines.by_ref().map_while(Result::ok).take_while(until).any(|line| line.contains(wanted))
    };
    assert!(heard("text/event-stream"));
    // proxies pass each event on, and a page can see that at once
    assert!(heard("x-accel-buffering: no"));
    assert!(heard("event: alive"));
    // the first poll only reads the present state of the database
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for day in 6..20 {
                served.workshop.add(&export("A", day, day));
                crate::support::pass(Duration::from_millis(300));
            }
        });
        assert!(heard("event: changed"));
    });
    served.daemon.signal("TERM");
    assert_eq!(served.daemon.end(), Some(0));
}

#[test]
fn figures_for_prometheus_are_those_of_the_views_and_promtool_has_nothing_to_say() {
    let served = Served::new(true);
    assert_eq!(served.ask("GET /metrics", "", b"").status, 401);
    let metrics = served.get("/metrics");
    assert_eq!(metrics.header("content-type"), Some("text/plain; version=0.0.4; charset=utf-8"));
    for sample in [
        "armwatch_runs{status=\"complete\"} 1",
        "armwatch_cycles 3",
        "armwatch_joint_status{joint=\"1\",robot=\"A\",status=\"learning\"} 1",
        "armwatch_joint_status{joint=\"1\",robot=\"A\",status=\"critical\"} 0",
        "armwatch_robot_last_result_timestamp_seconds{robot=\"A\"} 1767602820.0",
        "armwatch_anomalies{severity=\"critical\",state=\"open\"} 0",
    ] {
        assert!(metrics.body.lines().any(|line| line == sample), "{sample} is not in\n{}", metrics.body);
    }
    served.end();

    let rules = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("dashboards/prometheus");
    for arguments in [["check", "metrics"], ["check", "rules"], ["test", "rules"]] {
        let mut promtool = std::process::Command::new("promtool");
        promtool.args(arguments).current_dir(&rules).stdin(std::process::Stdio::piped());
        match arguments {
            ["check", "metrics"] => {}
            ["check", _] => drop(promtool.arg("armwatch.rules.yml")),
            _ => drop(promtool.arg("armwatch.test.yml")),
        }
        promtool.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        let Ok(mut child) = promtool.spawn() else {
            println!("skipped: promtool of Debian's package prometheus is not installed");
            return;
        };
        let mut stdin = child.stdin.take().expect("its input");
        // promtool may have ended without reading
        let _ = stdin.write_all(metrics.body.as_bytes());
        drop(stdin);
        let output = child.wait_with_output().expect("an end");
        let said = crate::support::text(&[output.stdout, output.stderr].concat());
        assert!(output.status.success(), "promtool {arguments:?}: {said}");
    }
}

#[test]
fn statements_read_the_views_and_nothing_else() {
    let served = Served::new(false);
    let ask = |body: &Value| {
        served.ask("POST /v1/sql", "Content-Type: application/json\r\n", body.to_string().as_bytes())
    };
    let statement = "SELECT joint, value FROM cycle_parameters WHERE run_id = ?1 AND parameter = ?2 ORDER BY joint, cycle";
    let answer = ask(&json!({"sql": statement, "parameters": [1, "f1"], "limit": 3}));
    let told = answer.json();
    assert_eq!((&told["columns"], &told["truncated"]), (&json!(["joint", "value"]), &json!(true)));
    let stored = served.workshop.query("SELECT joint, value FROM cycle_parameters WHERE run_id = 1 AND parameter = 'f1' ORDER BY joint, cycle LIMIT 3");
    let rows: Vec<String> =
        told["rows"].as_array().expect("rows").iter().map(|row| format!("{}|{}", row[0], row[1])).collect();
    assert_eq!(rows, stored);

    let csv = "Content-Type: application/sql\r\nAccept: text/csv\r\n";
    let csv = served.ask(
        "POST /v1/sql",
        csv,
        b"SELECT 'a, \"b\"' AS text, NULL AS missing, 0.1 AS number, x'00ff' AS bytes",
    );
    assert_eq!(csv.header("content-type"), Some("text/csv; charset=utf-8"), "{}", csv.body);
    assert_eq!(csv.body, "text,missing,number,bytes\n\"a, \"\"b\"\"\",,0.1,00ff\n");
    for (statement, status, said) in [
        ("SELECT robo\nFROM runs", 400, "line 1, column 8: no such column: robo"),
        ("SELECT * FROM run", 403, "run is not public"),
        ("DELETE FROM run", 403, "begins with SELECT"),
        (" \n", 400, "the statement is empty"),
        ("SELECT 1; SELECT 2", 400, "several statements"),
        ("SELECT printf('%.*c', 1000000, 'x') FROM cycle_parameters", 422, "larger than"),
    ] {
        let refused = ask(&json!({"sql": statement}));
        assert_eq!(refused.status, status, "{statement}: {}", refused.body);
        assert!(refused.json()["error"].as_str().is_some_and(|text| text.contains(said)), "{}", refused.body);
    }
    assert_eq!(ask(&json!({"sql": "SELECT 1", "limit": 0})).status, 400);
    assert_eq!(ask(&json!({"sql": "SELECT 1", "x": 0})).status, 400);
    assert_eq!(served.ask("POST /v1/sql", "", b"SELECT 1").status, 415);
    assert_eq!(served.ask("POST /v1/sql", "Content-Type: application/sql\r\n", &[b' '; 300_000]).status, 413);
    served.end();
}

#[test]
fn tokens_have_scopes_and_an_address_a_rate() {
    let more = "requests_per_s = 0.001\n[[serve.token]]\nname = \"screen\"\nfile = \"screen\"\nscopes = [\"read\"]\n";
    let served = Served::with(true, more);
    let screen = "Authorization: Bearer token-of-a-screen-0123\r\n";
    assert_eq!(served.ask("GET /v1/fleet", screen, b"").status, 200);
    let refused = served.ask("POST /v1/quarantine/1/retry", screen, b"");
    assert_eq!(refused.status, 403);
    assert!(refused.body.contains("screen") && refused.body.contains("act"), "{}", refused.body);
    assert_eq!(served.ask("GET /v1/exports/1", screen, b"").status, 404);
    let session = served.ask("GET /v1/session", screen, b"").json();
    assert_eq!(
        (&session["may_read"], &session["may_act"], &session["may_upload"]),
        (&json!(true), &json!(false), &json!(false))
    );
    let wrong = served.ask("GET /v1/fleet", "Authorization: Bearer another-token-012345\r\n", b"");
    assert!(wrong.status == 401 && wrong.body.contains("none of the daemon's"), "{}", wrong.body);

    // twenty at once, and one more each 1000 s
    let answers: Vec<Answer> = (0..40).map(|_| served.ask("GET /v1/session", "", b"")).collect();
    let late = answers.iter().find(|answer| answer.status == 429);
    assert!(
        late.is_some_and(|answer| answer.header("retry-after").is_some_and(|after| after.len() >= 3)),
        "no request was refused"
    );
    assert_eq!(served.ask("GET /ready", "", b"").status, 200);
    served.end();
}

#[test]
fn torques_of_a_cycle_are_those_of_the_command_and_a_missing_export_is_said() {
    let served = Served::new(false);
    let (run, cycle) = (1, 2);
    let told = served.get(&format!("/v1/runs/{run}/cycles/{cycle}/torque?points=200")).json();
    let joints = told["joints"].as_array().expect("joints");
    let line = ["torque", "--run", "1", "--cycle", "2", "--all-rows", "--points", "200", "--json"];
    let printed = served.workshop.stdout(&line, 0);
    let printed: Vec<Value> = printed.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect();
    assert_eq!(joints.len(), printed.len());
    for (of_page, of_command) in joints.iter().zip(&printed) {
        for column in ["time_s", "measured_nm", "estimated_nm", "residual_nm"] {
            let (here, there) = (&of_page[column], &of_command["rows"][column]);
            let pairs = here.as_array().expect("numbers").iter().zip(there.as_array().expect("numbers"));
            assert_eq!(here.as_array().map(Vec::len), there.as_array().map(Vec::len), "{column}");
            for (here, there) in pairs {
                let (here, there) = (here.as_f64().expect("a number"), there.as_f64().expect("a number"));
                assert!((here - there).abs() <= 1e-5 * there.abs().max(1.0), "{column}: {here}, {there}");
            }
        }
    }
    let stored = served.workshop.query(
        "SELECT rmsd_nm FROM cycle_rmsd WHERE run_id = 1 AND cycle = 2 AND joint = 1 AND stage = 'all' AND verification = 'self'",
    );
    let stored: f64 = stored[0].parse().expect("a number");
    assert!((joints[0]["rmsd_nm"].as_f64().expect("a number") - stored).abs() < 1e-9 * stored, "{stored}");

    let name = &served.workshop.query("SELECT source_name FROM runs WHERE run_id = 1")[0];
    fs::remove_file(served.workshop.inbox(name)).expect("removed");
    let gone = served.get("/v1/runs/1/cycles/2/torque");
    assert_eq!(gone.status, 410, "{}", gone.body);
    assert!(gone.body.contains("is not available"), "{}", gone.body);
    served.end();
}
