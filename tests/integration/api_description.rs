//! Checks that answers of the API match its description.

use std::fs;

use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};

use crate::api::{Served, TOKEN, small_alarm};
use crate::http::Answer;
use crate::small::export;

/// The description of the API, for checks of answers.
struct Description(Value);

impl Description {
    /// Panics unless an answer matches the description.
    fn check(&self, line: &str, template: &str, answer: &Answer) {
        let method = line.split(' ').next().expect("a method").to_lowercase();
        let operation = &self.0["paths"][template][&method];
        assert!(operation.is_object(), "{method} {template} is not described");
        let told = &operation["responses"][answer.status.to_string()];
        assert!(told.is_object(), "{line}: {} is not described; it was {}", answer.status, answer.body);
        let media =
            answer.header("content-type").map(|media| media.split(';').next().unwrap_or_default().to_owned());
        let Some(schema) = told["content"].as_object() else { return };
        let media = media.unwrap_or_default();
        let schema = schema.get(&media).unwrap_or_else(|| panic!("{line}: {media} is not described"));
        if media != "application/json" {
            return;
        }
        let mut whole = schema["schema"].clone();
        whole["components"] = self.0["components"].clone();
        closed(&mut whole);
        let (mut schemas, mut compiler) = (boon::Schemas::new(), boon::Compiler::new());
        compiler.set_default_draft(boon::Draft::V2020_12);
        compiler.add_resource("description.json", whole).expect("a schema");
        let index = compiler.compile("description.json", &mut schemas).expect("a schema");
        if let Err(wrong) = schemas.validate(&answer.json(), index) {
            panic!("{line}: {wrong:#} in {}", answer.body);
        }
    }
}

/// A time some hours from now, in the form of request bodies.
fn hours_ahead(hours: i64) -> String {
    (Timestamp::now() + SignedDuration::from_hours(hours)).to_string()
}

/// Forbids properties that are not described, in all objects.
fn closed(schema: &mut Value) {
    if let Some(object) = schema.as_object_mut() {
        if object.get("properties").is_some_and(Value::is_object)
            && object.get("type") == Some(&json!("object"))
        {
            object.entry("additionalProperties").or_insert(json!(false));
        }
        object.values_mut().for_each(closed);
    } else if let Some(items) = schema.as_array_mut() {
        items.iter_mut().for_each(closed);
    }
}

#[test]
fn answers_are_as_the_description_of_the_api_says() {
    let served = Served::with(true, "[serve.upload]\nspool = \"spool\"\n");
    small_alarm(&served.workshop);
    let description = Description(served.get("/v1/openapi.json").json());
    assert!(description.0["openapi"].as_str().is_some_and(|version| version.starts_with("3.1")));
    assert_eq!(description.0["info"]["version"], env!("CARGO_PKG_VERSION"));
    let token = format!("Authorization: Bearer {TOKEN}\r\n");
    let json_body = format!("{token}Content-Type: application/json\r\n");
    let export = export("A", 2, 6);
    let put = format!("PUT /v1/exports/{}", export.name);
    let hash = "0".repeat(64);
    let deed: &[u8] = br#"{"who": "Lena"}"#;
    let answered: &[u8] = br#"{"who": "Lena", "why": "not an export"}"#;
    let json_type = "Content-Type: application/json\r\n";
    let login = format!(r#"{{"token": "{TOKEN}"}}"#);
    let work: &[u8] = br#"{"who": "Lena", "what": "gearbox changed", "joint": 2}"#;
    let corrected: &[u8] = br#"{"who": "Lena", "what": "gearbox of joint 2 changed", "joint": 2}"#;
    let plan = format!(r#"{{"who": "Lena", "what": "gearbox", "until": "{}"}}"#, hours_ahead(24));
    let (entry, windows) = ("/v1/maintenance/{id}", "/v1/robots/{robot}/windows");
    let (view, name) = ("/v1/views/{view}", "/v1/exports/{name}");
    let answer = "/v1/anomalies/{id}/{action}";
    let torque = "/v1/runs/{run_id}/cycles/{cycle}/torque";
    let requests: &[(&str, &str, &str, &[u8], u16)] = &[
        ("GET /v1/session", "/v1/session", "", b"", 200),
        ("GET /v1/session", "/v1/session", &token, b"", 200),
        ("GET /v1/openapi.json", "/v1/openapi.json", &token, b"", 200),
        ("GET /v1/fleet", "/v1/fleet", &token, b"", 200),
        ("GET /v1/fleet", "/v1/fleet", "", b"", 401),
        ("GET /v1/fleet", "/v1/fleet", "Authorization: Bearer another-token-012345\r\n", b"", 401),
        ("GET /v1/fleet?language=de", "/v1/fleet", &token, b"", 200),
        ("GET /v1/fleet?language=fr", "/v1/fleet", &token, b"", 400),
        ("GET /v1/views/anomalies?language=zh", view, &token, b"", 200),
        ("GET /v1/views", "/v1/views", &token, b"", 200),
        ("GET /v1/views/runs", view, &token, b"", 200),
        ("GET /v1/views/fleet_health?joint=1", view, &token, b"", 200),
        ("GET /v1/views/anomalies", view, &token, b"", 200),
        ("GET /v1/views/nothing", view, &token, b"", 404),
        ("GET /v1/views/runs?x=1", view, &token, b"", 400),
        ("POST /v1/sql", "/v1/sql", &json_body, br#"{"sql": "SELECT * FROM fleet_health"}"#, 200),
        ("POST /v1/sql", "/v1/sql", &json_body, br#"{"sql": "SELECT * FROM run"}"#, 403),
        ("GET /v1/runs/1/cycles/1/torque?points=100", torque, &token, b"", 200),
        ("GET /v1/runs/1/cycles/99/torque", torque, &token, b"", 404),
        ("GET /v1/runs/1/cycles/1/torque?points=1", torque, &token, b"", 400),
        ("GET /v1/runs/1/cycles/one/torque", torque, &token, b"", 400),
        ("GET /v1/runs/1/cycles/1/torque?points=few", torque, &token, b"", 400),
        ("GET /v1/payload?empty=1&loaded=1", "/v1/payload", &token, b"", 404),
        ("GET /v1/payload?empty=1&loaded=none.csv", "/v1/payload", &token, b"", 404),
        ("GET /v1/payload?empty=1", "/v1/payload", &token, b"", 400),
        ("POST /v1/anomalies/1/acknowledge", answer, &json_body, deed, 200),
        ("POST /v1/anomalies/1/acknowledge", answer, &json_body, deed, 409),
        ("POST /v1/anomalies/1/comment", answer, &json_body, answered, 200),
        ("POST /v1/anomalies/1/comment", answer, &json_body, deed, 400),
        ("POST /v1/anomalies/1/assign", answer, &json_body, br#"{"who": "Lena", "to": "Ada"}"#, 200),
        ("POST /v1/anomalies/9/acknowledge", answer, &json_body, deed, 404),
        ("POST /v1/robots/A/maintenance", "/v1/robots/{robot}/maintenance", &json_body, work, 201),
        ("POST /v1/robots/A/maintenance", "/v1/robots/{robot}/maintenance", &json_body, work, 409),
        ("POST /v1/robots/A/maintenance", "/v1/robots/{robot}/maintenance", &json_body, b"{}", 400),
        ("POST /v1/quarantine/1/retry", "/v1/quarantine/{run_id}/retry", &token, b"", 409),
        ("GET /v1/quarantine/1/excerpt", "/v1/quarantine/{run_id}/excerpt", &token, b"", 404),
        ("GET /v1/quarantine/one/file", "/v1/quarantine/{run_id}/file", &token, b"", 400),
        ("PUT /v1/maintenance/1", entry, &json_body, corrected, 200),
        ("PUT /v1/maintenance/1", entry, &json_body, b"{}", 400),
        ("PUT /v1/maintenance/9", entry, &json_body, corrected, 404),
        ("DELETE /v1/maintenance/1", entry, &token, b"", 200),
        ("DELETE /v1/maintenance/1", entry, &token, b"", 404),
        ("DELETE /v1/maintenance/one", entry, &token, b"", 400),
        ("POST /v1/robots/A/windows", windows, &json_body, plan.as_bytes(), 201),
        ("POST /v1/robots/A/windows", windows, &json_body, deed, 400),
        ("POST /v1/robots/none/windows", windows, &json_body, plan.as_bytes(), 404),
        ("DELETE /v1/windows/1", "/v1/windows/{id}", &token, b"", 204),
        ("DELETE /v1/windows/1", "/v1/windows/{id}", &token, b"", 404),
        ("DELETE /v1/windows/one", "/v1/windows/{id}", &token, b"", 400),
        ("POST /v1/quarantine/1/dismiss", "/v1/quarantine/{run_id}/dismiss", &json_body, answered, 409),
        ("POST /v1/quarantine/1/dismiss", "/v1/quarantine/{run_id}/dismiss", &json_body, deed, 400),
        ("POST /v1/session", "/v1/session", json_type, login.as_bytes(), 204),
        ("POST /v1/session", "/v1/session", json_type, br#"{"token": "another-token-012345"}"#, 401),
        ("POST /v1/session", "/v1/session", json_type, b"{}", 400),
        ("DELETE /v1/session", "/v1/session", "", b"", 204),
        ("POST /v1/quarantine/one/retry", "/v1/quarantine/{run_id}/retry", &token, b"", 400),
        (&put, name, &token, &export.bytes, 201),
        (&put, name, &token, &export.bytes, 200),
        (&put, name, &token, b"", 400),
        ("PUT /v1/exports/x.txt", name, &token, b"1", 415),
        ("HEAD /v1/exports/none.csv", name, &token, b"", 404),
        (&format!("GET /v1/exports/{hash}"), name, &token, b"", 404),
        ("GET /health", "/health", "", b"", 200),
        ("GET /ready", "/ready", "", b"", 200),
        ("GET /metrics", "/metrics", &token, b"", 200),
    ];
    let mut asked = std::collections::BTreeSet::new();
    for (line, template, headers, body, status) in requests {
        let answer = served.ask(line, headers, body);
        assert_eq!(answer.status, *status, "{line}: {}", answer.body);
        description.check(line, template, &answer);
        asked.insert((line.split(' ').next().expect("a method").to_lowercase(), (*template).to_owned()));
    }
    let first = served.workshop.query("SELECT source_name FROM runs WHERE run_id = 1");
    let by_name = served.get(&format!("/v1/exports/{}", first[0]));
    description.check("GET /v1/exports/NAME", name, &by_name);
    assert_eq!(by_name.json()["run_id"], 1, "{}", by_name.body);

    // all described operations are requested above, except for the endless stream
    for (template, operations) in description.0["paths"].as_object().expect("paths") {
        for method in operations.as_object().expect("operations").keys() {
            let is_asked = asked.contains(&(method.clone(), template.clone())) || template == "/v1/events";
            assert!(is_asked, "{method} {template} is described and not asked here");
        }
    }
    let page = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/api.md")).expect("docs/api.md");
    for template in description.0["paths"].as_object().expect("paths").keys() {
        let place = template.split('{').next().expect("a beginning");
        assert!(page.contains(place), "docs/api.md says nothing of {template}");
    }
    served.end();
}
