//! Delivery of alarms: a real daemon and real receivers on this machine. Events are written into the database in the
//! same form as by conclusions ([`outbox`]).

pub mod encrypted;
mod kills;
mod outbox;
mod real_receivers;
mod sink;

use std::collections::BTreeSet;
use std::fs;
use std::process::Stdio;
use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use ring::hmac;

use self::outbox::Outbox;
use self::sink::{Posted, Sink};
use crate::no_result;
use crate::support::{Daemon, Workshop, text};

/// A workshop whose daemon retries after a tenth of a second.
fn workshop(alerts: &str) -> Workshop {
    let workshop = Workshop::new();
    configure(&workshop, alerts);
    workshop
}

fn configure(workshop: &Workshop, alerts: &str) {
    workshop.configure(|all| {
        let rest = all.split("# end of alerts\n").last().expect("the rest");
        let head = "[alerts]\nretry_first_s = 0.1\nretry_most_s = 0.3\n";
        format!("{head}{alerts}\n# end of alerts\n{rest}")
    });
}

fn webhook(name: &str, url: &str, more: &str) -> String {
    format!("[[alerts.route]]\nname = \"{name}\"\n{more}\n[alerts.route.webhook]\nurl = \"{url}\"\n")
}

fn end(daemon: Daemon) {
    daemon.stop();
}

fn keys(posted: &[Posted]) -> Vec<String> {
    posted.iter().map(Posted::key).collect()
}

#[test]
fn a_webhook_hears_that_an_alarm_opens_gets_worse_and_ends() {
    let sink = Sink::new();
    let config = webhook("shift", &sink.url(), "sites = [\"Turin\"]") + "signing_secret_file = \"secret\"\n";
    let site =
        "link = \"http://armwatch.example.org\"\n[[alerts.site]]\nname = \"Turin\"\nrobots = [\"R01\"]\n";
    let workshop = workshop(&(site.to_owned() + &config));
    fs::write(workshop.path("secret"), "a secret of the two\n").expect("a secret");
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    let anomaly = outbox.open_anomaly("R01", 3, "warning");
    outbox.open_anomaly("R02", 1, "critical");
    workshop.wait_until(|| sink.posted().len() == 1);
    outbox.event(anomaly, "worse", "critical");
    outbox.event(anomaly, "acknowledged", "critical");
    outbox.event(anomaly, "ended", "critical");
    workshop.wait_until(|| sink.posted().len() == 3);
    end(daemon);
    let posted = sink.posted();
    let told: Vec<String> = posted
        .iter()
        .map(|posted| {
            let told = posted.json();
            let alert = &told["alerts"][0];
            assert_eq!((&told["version"], &told["receiver"]), (&"4".into(), &"shift".into()));
            assert_eq!(told["alerts"].as_array().map(Vec::len), Some(1));
            assert_eq!((&alert["labels"]["robot"], &alert["labels"]["joint"]), (&"R01".into(), &"3".into()));
            assert_eq!(alert["labels"]["site"], "Turin");
            assert_eq!(alert["annotations"]["peak_value"], "1.3");
            assert!(
                alert["annotations"]["onset_at"].as_str().is_some_and(|at| at.starts_with("2026-01-04T"))
            );
            let page = alert["generatorURL"].as_str().expect("an address");
            assert!(page.starts_with("http://armwatch.example.org/#/alarm/"), "{page}");
            format!(
                "{} {}",
                told["status"].as_str().unwrap_or_default(),
                told["title"].as_str().unwrap_or_default()
            )
        })
        .collect();
    assert_eq!(
        told,
        [
            "firing warning: R01 (Turin), joint 3: drift opened",
            "firing critical: R01 (Turin), joint 3: drift is worse",
            "resolved ended: R01 (Turin), joint 3: drift"
        ]
    );
    let fingerprints: Vec<_> = posted.iter().map(|p| p.json()["alerts"][0]["fingerprint"].clone()).collect();
    assert!(fingerprints.windows(2).all(|pair| pair[0] == pair[1]), "{fingerprints:?}");
    let identity = outbox.identity();
    assert_eq!(keys(&posted), ["1", "3", "5"].map(|event| format!("armwatch-{identity}-{event}")));
    let known =
        workshop.query("SELECT key FROM deliveries WHERE route = 'shift' AND state = 'sent' ORDER BY key");
    assert_eq!(known, keys(&posted));
    // signed with the secret, according to Standard Webhooks
    let key = hmac::Key::new(hmac::HMAC_SHA256, b"a secret of the two");
    for Posted { headers, text, .. } in &posted {
        let signed = format!("{}.{}.{text}", headers["webhook-id"], headers["webhook-timestamp"]);
        let tag = STANDARD.decode(headers["webhook-signature"].trim_start_matches("v1,")).expect("base 64");
        hmac::verify(&key, signed.as_bytes(), &tag).expect("the signature");
    }
}

/// From exports to a receiver: a test without result opens an alarm, the next one ends it.
#[test]
fn what_a_test_says_reaches_the_receiver() {
    let sink = Sink::new();
    let (workshop, next) = no_result::watched();
    configure(&workshop, &webhook("shift", &sink.url(), ""));
    let daemon = workshop.daemon();
    workshop.wait_until_idle();
    assert_eq!(sink.posted().len(), 0, "healthy tests");
    let stuck = workshop.inbox("R01_20260214_0800_stuck.csv");
    no_result::altered(&next, &stuck, |name, _| (name == "trq_4").then(|| "0.0".into()));
    workshop.wait_until(|| sink.posted().len() == 1);
    fs::write(workshop.inbox("R01_20260215_0800_healthy.csv"), &next).expect("written");
    workshop.wait_until(|| sink.posted().len() == 2);
    workshop.wait_until_idle();
    end(daemon);
    let told = sink.posted();
    let titles: Vec<_> = told.iter().map(|posted| posted.json()["title"].clone()).collect();
    assert_eq!(titles, ["warning: R01, joint 4: sensor opened", "ended: R01, joint 4: sensor"]);
    let message = told[0].json()["alerts"][0]["annotations"]["description"].to_string();
    assert!(message.contains("joint 4: the torque signal stands at 0"), "{message}");
}

#[test]
fn a_new_route_begins_with_what_is_open_and_a_restart_repeats_nothing() {
    let sink = Sink::new();
    let workshop = workshop("");
    let mut outbox = Outbox::new(&workshop);
    let ended = outbox.open_anomaly("R01", 1, "critical");
    outbox.event(ended, "ended", "critical");
    let open = outbox.open_anomaly("R01", 2, "critical");
    let info = outbox.open_anomaly("R01", 3, "info");
    configure(&workshop, &webhook("shift", &sink.url(), ""));
    let daemon = workshop.daemon();
    workshop.wait_until(|| sink.posted().len() == 1);
    end(daemon);
    let told = sink.posted()[0].json();
    assert!(
        told["alerts"][0]["fingerprint"].as_str().is_some_and(|f| f.ends_with(&format!("-{open}"))),
        "{told}"
    );
    // events without a running daemon are delivered at the next start, and nothing else
    outbox.event(info, "worse", "warning");
    outbox.event(open, "ended", "critical");
    outbox.event(info, "ended", "warning");
    let daemon = workshop.daemon();
    workshop.wait_until(|| sink.posted().len() == 4);
    end(daemon);
    let titles: Vec<_> = sink.posted().iter().map(|posted| posted.json()["title"].clone()).collect();
    assert_eq!(
        titles,
        [
            "critical: R01, joint 2: drift opened",
            "warning: R01, joint 3: drift is worse",
            "ended: R01, joint 2: drift",
            "ended: R01, joint 3: drift"
        ]
    );
    let daemon = workshop.daemon();
    workshop.wait_for_looks_over(Duration::from_secs(3));
    end(daemon);
    assert_eq!(sink.posted().len(), 4);
}

#[test]
fn the_log_is_the_route_of_a_configuration_without_one_and_says_at_a_start_what_is_open() {
    let workshop = workshop("");
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    let anomaly = outbox.open_anomaly("R01", 3, "critical");
    let said = || workshop.log().matches("friction rose by 20 %").count();
    workshop.wait_until(|| said() == 1);
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE route = 'log' AND state = 'sent'", 1);
    end(daemon);
    let daemon = workshop.daemon();
    workshop.wait_until(|| said() == 2);
    end(daemon);
    let log = workshop.log();
    let line = log.lines().find(|line| line.contains("friction rose")).expect("a line");
    assert!(line.contains("ERROR") && line.contains(&format!("anomaly_id={anomaly}")), "{line}");
    assert!(log.contains("open since before this start"), "{log}");
}

#[test]
fn a_receiver_that_fails_is_tried_again_with_the_same_key_and_a_refusal_lets_others_pass() {
    // the first alarm is always refused, and the receiver is overloaded twice
    let sink = Sink::answering(|before, posted| {
        let status = match before.len() {
            0 => 503,
            1 => 429,
            _ if posted.text.contains("joint 1") => 422,
            _ => 200,
        };
        (status, Duration::ZERO)
    });
    let workshop = workshop(&webhook("shift", &sink.url(), ""));
    let mut outbox = Outbox::new(&workshop);
    outbox.open_anomaly("R01", 1, "critical");
    outbox.open_anomaly("R01", 2, "critical");
    let daemon = workshop.daemon();
    workshop.wait_until(|| sink.taken().len() == 1);
    let refused = |sink: &Sink| sink.posted().iter().filter(|posted| posted.status == 422).count();
    workshop.wait_until(|| refused(&sink) >= 3);
    end(daemon);
    let posted = sink.posted();
    for joint in ["joint 1", "joint 2"] {
        let mut keys: Vec<String> =
            posted.iter().filter(|posted| posted.text.contains(joint)).map(Posted::key).collect();
        assert!(!keys.is_empty());
        keys.dedup();
        assert_eq!(keys.len(), 1, "{joint}: {keys:?}");
    }
    let states = workshop.query("SELECT joint, state, error, attempts > 2 FROM deliveries ORDER BY joint");
    assert_eq!(states, ["1|pending|HTTP 422 Unprocessable Entity|1", "2|sent||0"]);
    assert!(workshop.log().contains("not delivered; trying again"), "{}", workshop.log());
}

#[test]
fn what_cannot_be_delivered_is_given_up_with_an_error() {
    let workshop = workshop(&format!(
        "give_up_after_h = 0.0003\n{}",
        // no server listens there
        webhook("shift", "http://127.0.0.1:9/hook", "")
    ));
    let mut outbox = Outbox::new(&workshop);
    outbox.open_anomaly("R01", 1, "critical");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'failed'", 1);
    end(daemon);
    let log = workshop.log();
    assert!(log.lines().any(|line| line.contains("ERROR") && line.contains("given up")), "{log}");
    let failed =
        workshop.query("SELECT attempts > 2, error LIKE '127.0.0.1:9: Connection refused%' FROM deliveries");
    assert_eq!(failed, ["1|1"]);
}

#[test]
fn a_slow_receiver_holds_up_neither_the_others_nor_a_stop() {
    let slow = Sink::answering(|_, _| (200, Duration::from_secs(60)));
    let quick = Sink::new();
    let routes = webhook("slow", &slow.url(), "") + &webhook("quick", &quick.url(), "");
    let workshop = workshop(&routes);
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    outbox.open_anomaly("R01", 1, "critical");
    workshop.wait_until(|| slow.posted().len() == 1);
    outbox.open_anomaly("R01", 2, "critical");
    workshop.wait_until(|| quick.posted().len() == 2);
    let asked = Instant::now();
    end(daemon);
    assert!(asked.elapsed() < Duration::from_secs(20), "{:?}", asked.elapsed());
    let states = workshop.query("SELECT state, attempts FROM deliveries WHERE route = 'slow'");
    assert_eq!(states, ["pending|1"], "the other event waits in the history");
}

#[test]
fn an_alarm_that_nobody_answers_speaks_again_until_somebody_does() {
    let sink = Sink::new();
    let workshop = workshop(&format!("remind_after_h = 0.0002\n{}", webhook("shift", &sink.url(), "")));
    let mut outbox = Outbox::new(&workshop);
    let anomaly = outbox.open_anomaly("R01", 1, "warning");
    let daemon = workshop.daemon();
    workshop.wait_until(|| sink.posted().len() >= 3);
    assert_eq!(sink.posted()[2].json()["title"], "warning: R01, joint 1: drift is still unanswered");
    workshop.stdout(&["alerts", "ack", &anomaly.to_string()], 0);
    let overdue = || workshop.number("SELECT count(*) FROM anomaly_history WHERE what = 'overdue'");
    let before = overdue();
    workshop.wait_for_looks_over(Duration::from_secs(2));
    end(daemon);
    assert_eq!(overdue(), before, "one reminder may have come before the answer");
}

#[test]
fn a_flood_is_held_and_the_view_says_so() {
    let sink = Sink::new();
    let workshop = workshop(&webhook("shift", &sink.url(), "most_per_h = 2"));
    let mut outbox = Outbox::new(&workshop);
    for joint in 1..=5 {
        outbox.open_anomaly("R01", joint, "critical");
    }
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE held = 'flood'", 3);
    workshop.wait_for_looks_over(Duration::from_secs(3));
    end(daemon);
    assert_eq!(sink.posted().len(), 2);
    let late = "SELECT count(*) FROM deliveries WHERE held = 'flood' AND state = 'pending'
                    AND due_at > strftime('%Y-%m-%dT%H:%M:%fZ', 'now', '+50 minutes')";
    assert_eq!(workshop.number(late), 3);
    assert!(workshop.log().contains("2 messages within an hour; the others wait"), "{}", workshop.log());
}

/// Regression: the clock was a year ahead when the receiver did not answer.
#[test]
fn a_clock_that_was_ahead_does_not_silence_a_route() {
    let sink = Sink::new();
    let workshop = workshop(&webhook("shift", &sink.url(), ""));
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM delivery_route", 1);
    end(daemon);
    outbox.write(
        "UPDATE delivery_route SET failures = 3, retry_at = (CAST(unixepoch('subsec') AS INTEGER) + 31536000) * 1000000",
    );
    outbox.open_anomaly("R01", 3, "critical");
    let daemon = workshop.daemon();
    workshop.wait_until(|| sink.posted().len() == 1);
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 1);
    end(daemon);
    assert_eq!(workshop.log().matches("the clock was ahead").count(), 1, "{}", workshop.log());
}

#[test]
fn a_command_gets_the_message_and_its_status_decides() {
    let workshop = workshop(
        "[[alerts.route]]\nname = \"page\"\n[alerts.route.command]\nrun = [\"/bin/sh\", \"page.sh\", \"shift\"]\n",
    );
    let script = "echo tried >>tries\n[ $(wc -l <tries) -gt 2 ] || { echo not yet >&2; exit 3; }\n\
                  { echo $1 $ARMWATCH_STATUS $ARMWATCH_SEVERITY; cat; } >paged\nenv >environment\n";
    fs::write(workshop.path("page.sh"), script).expect("a script");
    let mut outbox = Outbox::new(&workshop);
    outbox.open_anomaly("R01", 4, "critical");
    let log = fs::OpenOptions::new().create(true).append(true).open(workshop.path("daemon.log"));
    let mut command = workshop.command(&["run"]);
    command.envs([("ARMWATCH_TOKEN", "a secret of the daemon"), ("PGPASSWORD", "another"), ("TZ", "UTC")]);
    command.env("ARMWATCH_LOG", "warn").stdout(Stdio::null()).stderr(log.expect("a log"));
    let daemon = Daemon { child: command.spawn().expect("the daemon starts") };
    workshop.wait_for("SELECT attempts FROM deliveries WHERE state = 'sent'", 3);
    end(daemon);
    let environment = fs::read_to_string(workshop.path("environment")).expect("what the program saw");
    // variables of the shell itself
    let own = ["PWD", "SHLVL", "_", "OLDPWD"];
    let names: BTreeSet<&str> =
        environment.lines().filter_map(|line| Some(line.split_once('=')?.0)).collect();
    let seen: Vec<&str> = names.into_iter().filter(|name| !own.contains(name)).collect();
    let passed_on = |name: &&&str| !["HOME", "LANG", "PATH"].contains(*name);
    let told: Vec<&str> = seen.iter().filter(passed_on).copied().collect();
    assert_eq!(
        told,
        ["ARMWATCH_KEY", "ARMWATCH_SEVERITY", "ARMWATCH_STATUS", "ARMWATCH_TITLE", "TZ"],
        "{environment}"
    );
    assert!(seen.contains(&"PATH"), "{environment}");
    let paged = fs::read_to_string(workshop.path("paged")).expect("what was paged");
    let (first, message) = paged.split_once('\n').expect("two lines");
    assert_eq!(first, "shift firing critical");
    let message: serde_json::Value = serde_json::from_str(message).expect("JSON");
    assert_eq!(message["alarms"][0]["joint"], 4);
    assert_eq!(message["alarms"][0]["peak_value"], 1.3);
    assert!(workshop.log().contains("ended with exit status: 3: not yet"), "{}", workshop.log());
}

#[test]
fn routes_are_tried_by_hand() {
    let sink = Sink::new();
    let routes = webhook("shift", &sink.url(), "severity = \"critical\"\nquiet = \"00:00-23:59\"")
        + &webhook("gone", "http://127.0.0.1:9/hook", "");
    let workshop = workshop(&routes);
    // an empty database: a message names its installation
    workshop.stdout(&["ingest", "inbox"], 0);
    let out = workshop.stdout(&["alerts", "test", "shift"], 0);
    assert!(out.starts_with("shift: webhook accepted it in "), "{out}");
    let told = sink.posted()[0].json();
    assert_eq!(told["alerts"][0]["labels"]["robot"], "TEST");
    assert!(
        told["alerts"][0]["annotations"]["description"]
            .as_str()
            .is_some_and(|text| text.contains("test of the route"))
    );
    let out = workshop.stdout(&["alerts", "test", "--severity", "critical"], 74);
    assert!(out.contains("gone: NOT SENT to webhook (http://127.0.0.1:9/hook): 127.0.0.1:9: "), "{out}");
    let out = workshop.stdout(&["--json", "alerts", "test", "gone"], 74);
    let told: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!((&told["sent"], &told["took_s"]), (&false.into(), &serde_json::Value::Null));
    let unknown = workshop.stderr(&["alerts", "test", "shft"], 2);
    assert!(unknown.contains("the configuration has shift, gone"), "{unknown}");
    assert_eq!(workshop.number("SELECT count(*) FROM deliveries"), 0, "a try is no delivery");
}

#[test]
fn a_secret_that_is_not_there_is_told_before_it_is_needed_and_never_shown() {
    let workshop = workshop(
        "[[alerts.route]]\nname = \"shift\"\n[alerts.route.webhook]\nurl = \"http://127.0.0.1:9/\"\n\
         bearer_token_env = \"ARMWATCH_TEST_NO_SUCH\"\nsigning_secret_file = \"secret\"\n",
    );
    let refused = workshop.run(&["config", "check"]);
    assert_eq!(refused.status.code(), Some(2));
    let said = text(&refused.stdout) + &text(&refused.stderr);
    assert!(said.contains("alerts.route shift") && said.contains("secret: No such file"), "{said}");
    fs::write(workshop.path("secret"), "whsec_very-secret\n").expect("a secret");
    let refused = workshop.run(&["run"]);
    assert_eq!(refused.status.code(), Some(2));
    let said = text(&refused.stdout) + &text(&refused.stderr);
    assert!(said.contains("no base 64") && !said.contains("very-secret"), "{said}");
}

#[test]
fn routes_change_when_the_configuration_is_read_again() {
    let (before, after) = (Sink::new(), Sink::new());
    let workshop = workshop(&webhook("before", &before.url(), ""));
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    outbox.open_anomaly("R01", 1, "critical");
    workshop.wait_until(|| before.posted().len() == 1);
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 1);
    configure(&workshop, &webhook("after", &after.url(), ""));
    daemon.signal("HUP");
    workshop.wait_until(|| after.posted().len() == 1);
    outbox.open_anomaly("R01", 2, "critical");
    workshop.wait_until(|| after.posted().len() == 2);
    end(daemon);
    assert_eq!(before.posted().len(), 1);
}
