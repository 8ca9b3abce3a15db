//! Real receivers from Debian's packages: Alertmanager, mosquitto, an SMTP server of Python's aiosmtpd. If one is not
//! installed, its test prints that and ends; `.ci/run` installs them.

use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use super::outbox::Outbox;
use super::{end, workshop};
use crate::support::{Workshop, end_of, wait_until};

/// Folder of Debian's Python packages, whatever the machine's first Python is.
pub const DEBIAN_PYTHON: &str = "/usr/lib/python3/dist-packages";

/// A server that ends with the test.
pub struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts the first program that exists, and waits until it listens; prints a line and returns `None` if none is
/// installed.
pub fn server(paths: &[&str], log: &Path, port: u16, prepare: impl FnOnce(&mut Command)) -> Option<Server> {
    let Some(program) = paths.iter().find(|path| Path::new(path).exists()) else {
        println!("SKIPPED: {} is not installed; .ci/run installs it", paths[0]);
        return None;
    };
    let file = fs::File::create(log).expect("a log");
    let mut command = Command::new(program);
    prepare(&mut command);
    command.stdin(Stdio::null()).stdout(file.try_clone().expect("a log")).stderr(file);
    let server = Server(command.spawn().expect("it starts"));
    let listens = || TcpStream::connect(("127.0.0.1", port)).is_ok();
    wait_until(listens, || {
        format!("{program} does not listen: {}", fs::read_to_string(log).unwrap_or_default())
    });
    Some(server)
}

/// A port that was just free.
pub fn port() -> u16 {
    TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("an address").port()
}

fn get(port: u16, path: &str) -> Value {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("a connection");
    let request = format!("GET {path} HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("asked");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer");
    let (_, body) = answer.split_once("\r\n\r\n").expect("a body");
    serde_json::from_str(body).unwrap_or_else(|error| panic!("{error}: {answer}"))
}

/// Alerts that an Alertmanager shows, as `joint severity`.
fn shown(port: u16) -> Vec<String> {
    let alerts = get(port, "/api/v2/alerts?active=true");
    let mut shown: Vec<String> = alerts
        .as_array()
        .expect("a list")
        .iter()
        .map(|alert| {
            let text = |name: &str| alert["labels"][name].as_str().unwrap_or_default().to_owned();
            assert_eq!(text("alertname"), "RobotArmAlarm");
            format!("{} {}", text("joint"), text("severity"))
        })
        .collect();
    shown.sort_unstable();
    shown
}

fn alertmanager(workshop: &Workshop, port: u16) -> Option<Server> {
    let config = "route:\n  receiver: nobody\nreceivers:\n  - name: nobody\n";
    fs::write(workshop.path("alertmanager.yml"), config).expect("a configuration");
    let folder = workshop.path("alertmanager");
    server(&["/usr/bin/prometheus-alertmanager"], &workshop.path("alertmanager.log"), port, |command| {
        command.current_dir(workshop.path("")).args([
            "--config.file=alertmanager.yml".to_owned(),
            format!("--storage.path={}", folder.display()),
            format!("--web.listen-address=127.0.0.1:{port}"),
            // alone: no cluster
            "--cluster.listen-address=".to_owned(),
        ]);
    })
}

#[test]
fn an_alertmanager_shows_each_open_alarm_once_and_learns_it_again_after_its_restart() {
    let port = port();
    let workshop = workshop(&format!(
        "[[alerts.route]]\nname = \"manager\"\n[alerts.route.alertmanager]\nurl = \"http://127.0.0.1:{port}\"\n\
         refresh_s = 1\n"
    ));
    let Some(manager) = alertmanager(&workshop, port) else { return };
    let mut outbox = Outbox::new(&workshop);
    let first = outbox.open_anomaly("R01", 3, "warning");
    outbox.open_anomaly("R02", 5, "critical");
    let daemon = workshop.daemon();
    workshop.wait_until(|| shown(port) == ["3 warning", "5 critical"]);
    // another severity is another alert there; the previous one must end
    outbox.event(first, "worse", "critical");
    workshop.wait_until(|| shown(port) == ["3 critical", "5 critical"]);
    let alert = get(port, "/api/v2/alerts");
    let peak = alert.as_array().and_then(|all| all.iter().find(|one| one["labels"]["joint"] == "3"));
    assert_eq!(peak.expect("the alert")["annotations"]["peak_value"], "1.3");
    // an Alertmanager that starts without its data has forgotten all
    drop(manager);
    let folder = workshop.path("alertmanager");
    fs::remove_dir_all(&folder).expect("its memory");
    let _manager = alertmanager(&workshop, port).expect("it is installed");
    workshop.wait_until(|| shown(port) == ["3 critical", "5 critical"]);
    outbox.event(first, "ended", "critical");
    workshop.wait_until(|| shown(port) == ["5 critical"]);
    end(daemon);
    let sent = "SELECT count(*) FROM deliveries WHERE route = 'manager' AND state = 'sent'";
    assert_eq!(workshop.number(sent), 4);
    assert_eq!(workshop.stdout(&["alerts", "test", "manager"], 0).lines().count(), 1);
    workshop.wait_until(|| shown(port) == ["3 warning", "5 critical"]);
}

#[test]
fn a_broker_acknowledges_each_message_and_hands_it_on() {
    let port = port();
    let workshop = workshop(&format!(
        "[[alerts.route]]\nname = \"shop floor\"\n[alerts.route.mqtt]\nhost = \"127.0.0.1\"\nport = {port}\n\
         encryption = \"none\"\nuser = \"armwatch\"\npassword_file = \"password\"\n"
    ));
    fs::write(workshop.path("password"), "a password\n").expect("a password");
    let made = Command::new("mosquitto_passwd")
        .args(["-b", "-c", "users", "armwatch", "a password"])
        .current_dir(workshop.path(""))
        .stdout(Stdio::null())
        .status();
    if made.is_err() {
        println!("SKIPPED: mosquitto is not installed; .ci/run installs it");
        return;
    }
    let config = format!(
        "listener {port} 127.0.0.1\nallow_anonymous false\npassword_file {}\nuser root\nlog_type all\n",
        workshop.path("users").display()
    );
    fs::write(workshop.path("mosquitto.conf"), config).expect("a configuration");
    let broker = server(
        &["/usr/sbin/mosquitto", "/usr/bin/mosquitto"],
        &workshop.path("mosquitto.log"),
        port,
        |command| {
            command.args(["-c", "mosquitto.conf"]).current_dir(workshop.path(""));
        },
    );
    let Some(_broker) = broker else { return };
    let heard = workshop.path("heard");
    let mut listener = Command::new("mosquitto_sub")
        .args([
            "-V",
            "mqttv5",
            "-h",
            "127.0.0.1",
            "-p",
            &port.to_string(),
            "-u",
            "armwatch",
            "-P",
            "a password",
        ])
        .args(["-q", "1", "-t", "armwatch/#", "-F", "%t %p", "-C", "2"])
        .stdout(fs::File::create(&heard).expect("a file"))
        .stderr(Stdio::null())
        .spawn()
        .map(Server)
        .expect("mosquitto_sub starts");
    let log = || fs::read_to_string(workshop.path("mosquitto.log")).unwrap_or_default();
    wait_until(|| log().contains("SUBACK"), || format!("nobody listens: {}", log()));
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    let anomaly = outbox.open_anomaly("R01", 3, "critical");
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 1);
    outbox.event(anomaly, "ended", "critical");
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 2);
    end(daemon);
    let prefix = format!("armwatch/alarms/R01/{anomaly} ");
    // it ends after the second message
    end_of(&mut listener.0, || format!("a message is missing: {}", log()));
    let told: Vec<Value> = fs::read_to_string(&heard)
        .expect("what was heard")
        .lines()
        .filter_map(|line| line.strip_prefix(&prefix))
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!((&told[0]["status"], &told[1]["status"]), (&"firing".into(), &"resolved".into()));
    assert_ne!(told[0]["key"], told[1]["key"]);
    assert_eq!(told[1]["alarms"][0]["peak_value"], 1.3);
    // a wrong password is a failed delivery
    fs::write(workshop.path("password"), "another\n").expect("a password");
    let out = workshop.stdout(&["alerts", "test"], 74);
    assert!(out.contains("NOT SENT to mqtt"), "{out}");
}

/// A broker without users, with additional settings; `None` if it is not installed.
fn open_broker(workshop: &Workshop, port: u16, more: &str) -> Option<Server> {
    let config =
        format!("listener {port} 127.0.0.1\nallow_anonymous true\nuser root\nlog_type all\n{more}\n");
    fs::write(workshop.path("mosquitto.conf"), config).expect("a configuration");
    let paths = ["/usr/sbin/mosquitto", "/usr/bin/mosquitto"];
    server(&paths, &workshop.path("mosquitto.log"), port, |command| {
        command.args(["-c", "mosquitto.conf"]).current_dir(workshop.path(""));
    })
}

fn open_broker_route(port: u16) -> String {
    format!(
        "[[alerts.route]]\nname = \"shop floor\"\n[alerts.route.mqtt]\nhost = \"127.0.0.1\"\nport = {port}\n\
         encryption = \"none\"\n"
    )
}

#[test]
fn no_name_of_a_robot_makes_a_broker_hang_up() {
    let port = port();
    let workshop = workshop(&open_broker_route(port));
    let Some(_broker) = open_broker(&workshop, port, "") else { return };
    let long = "L".repeat(70_000);
    let names = [
        "R\u{1b}[31m",
        "R\n\r",
        "R\u{7f}\u{9f}",
        "R\u{ffff}",
        "R\u{202e}",
        "R/1",
        "R+",
        "R#",
        "$SYS",
        "Süd",
        &long,
    ];
    let mut outbox = Outbox::new(&workshop);
    for (name, number) in names.iter().zip(1..) {
        outbox.write(&format!("INSERT INTO robot (name) VALUES ('{name}')"));
        outbox.open_anomaly(name, number, "critical");
    }
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", names.len() as i64);
    end(daemon);
    assert_eq!(workshop.number("SELECT max(attempts) FROM deliveries"), 1);
    let log = fs::read_to_string(workshop.path("mosquitto.log")).unwrap_or_default();
    assert!(log.contains("armwatch/alarms/R%2F1/") && log.contains("armwatch/alarms/Süd/"), "{log}");
}

#[test]
fn a_message_that_a_broker_never_takes_has_failed_at_once_and_lets_others_pass() {
    let port = port();
    let workshop = workshop(&open_broker_route(port));
    let Some(_broker) = open_broker(&workshop, port, "max_packet_size 5000") else { return };
    let mut outbox = Outbox::new(&workshop);
    let large = outbox.open_anomaly("R01", 1, "critical");
    outbox.write(&format!(
        "UPDATE anomaly_event SET message = '{0}' WHERE anomaly_id = {large};
         UPDATE anomaly SET message = '{0}' WHERE anomaly_id = {large}",
        "much ".repeat(2000)
    ));
    outbox.open_anomaly("R02", 2, "critical");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 1);
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'failed'", 1);
    end(daemon);
    let states = workshop.query("SELECT joint, state, attempts FROM deliveries ORDER BY joint");
    assert_eq!(states, ["1|failed|1", "2|sent|1"]);
}

/// A mail server that stores each mail in a file of a folder.
fn mail_server(workshop: &Workshop, port: u16, mails: &Path) -> Option<Server> {
    server(&["/usr/bin/python3"], &workshop.path("smtp.log"), port, |command| {
        command
            .args(["-m", "aiosmtpd", "-n", "-l", &format!("127.0.0.1:{port}")])
            .args(["-c", "aiosmtpd.handlers.Mailbox"])
            .arg(mails)
            .env("PYTHONPATH", DEBIAN_PYTHON);
    })
}

/// Reads mails with Python's `email`.
const READ_MAILS: &str = r#"
import email, email.policy, json, pathlib, sys
def parts(path):
    mail = email.message_from_bytes(path.read_bytes(), policy=email.policy.default)
    pictures = [part for part in mail.walk() if part.get_content_type() == "image/png"]
    return {
        "subject": mail["Subject"], "type": mail.get_content_type(), "text": mail.get_body(("plain",)).get_content(),
        "page": mail.get_body(("html",)).get_content(), "ids": [part["Content-ID"].strip("<>") for part in pictures],
        "sound": [part.get_content().startswith(b"\x89PNG\r\n\x1a\n") for part in pictures],
    }
print(json.dumps([parts(path) for path in pathlib.Path(sys.argv[1], "new").iterdir()]))
"#;

#[test]
fn a_mail_has_text_page_and_picture_in_the_language_of_its_route() {
    if !Path::new(DEBIAN_PYTHON).join("aiosmtpd").exists() {
        println!("SKIPPED: python3-aiosmtpd is not installed; .ci/run installs it");
        return;
    }
    let port = port();
    let workshop = workshop(&format!(
        "link = \"https://example.org/\"\n[[alerts.site]]\nname = \"Zürich\"\nrobots = [\"TEST\"]\n\
         [[alerts.route]]\nname = \"mail\"\nlanguage = \"de\"\n[alerts.route.email]\nhost = \"127.0.0.1\"\n\
         port = {port}\nencryption = \"none\"\nfrom = \"armwatch@example.org\"\nto = [\"wartung@example.org\"]\n"
    ));
    let mails = workshop.path("mails");
    let Some(_python) = mail_server(&workshop, port, &mails) else { return };
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop.stdout(&["alerts", "test", "mail"], 0);
    let read =
        Command::new("/usr/bin/python3").args(["-c", READ_MAILS]).arg(&mails).output().expect("python");
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let found: Value = serde_json::from_slice(&read.stdout).expect("JSON");
    let mail = &found[0];
    assert_eq!(mail["type"], "multipart/alternative");
    assert_eq!(mail["subject"], "[armwatch] Warnung: TEST (Zürich), Gelenk 3: Drift der Reibung, neu");
    let (text, page) = (mail["text"].as_str().expect("text"), mail["page"].as_str().expect("a page"));
    for line in [
        "dies ist ein Test der Route und betrifft keinen Roboter; Reibung bei gleicher Geschwindigkeit und Temperatur läge 24 % über der Referenz des Gelenks",
        "Dringlichkeit: Prüfung einplanen",
        "letzter Test: 1,24, erwartet 1",
    ] {
        assert!(text.lines().any(|found| found.trim() == line), "{line}\nnot in\n{text}");
    }
    // the page has the content of the text, and shows the attached picture
    for words in [
        "<html lang=\"de\">",
        "TEST (Zürich), Gelenk 3",
        "Prüfung einplanen",
        "https://example.org/#/alarm/0",
    ] {
        assert!(page.contains(words), "{words}\nnot in\n{page}");
    }
    let id = mail["ids"][0].as_str().expect("a picture");
    assert!(page.contains(&format!("src=\"cid:{id}\"")), "{id}\nnot in\n{page}");
    assert_eq!(mail["sound"], serde_json::json!([true]));
}

#[test]
fn a_mail_server_takes_a_mail_for_each_event() {
    if !Path::new(DEBIAN_PYTHON).join("aiosmtpd").exists() {
        println!("SKIPPED: python3-aiosmtpd is not installed; .ci/run installs it");
        return;
    }
    let port = port();
    let workshop = workshop(&format!(
        "[[alerts.route]]\nname = \"mail\"\n[alerts.route.email]\nhost = \"127.0.0.1\"\nport = {port}\n\
         encryption = \"none\"\nfrom = \"armwatch <armwatch@example.org>\"\n\
         to = [\"Wartung <wartung@example.org>\", \"shift@example.org\"]\n"
    ));
    let mails = workshop.path("mails");
    let Some(_python) = mail_server(&workshop, port, &mails) else { return };
    let mut outbox = Outbox::new(&workshop);
    let daemon = workshop.daemon();
    let anomaly = outbox.open_anomaly("R01", 3, "critical");
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 1);
    outbox.event(anomaly, "ended", "critical");
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", 2);
    end(daemon);
    let mut found: Vec<String> = fs::read_dir(mails.join("new"))
        .expect("mails")
        .map(|entry| fs::read_to_string(entry.expect("a mail").path()).expect("text"))
        .collect();
    found.sort_by_key(|mail| mail.contains("ended: R01"));
    assert_eq!(found.len(), 2, "{found:#?}");
    let identity = outbox.identity();
    for (place, mail) in (1..).zip(&found) {
        for line in [
            format!("Message-ID: <armwatch-{identity}-{place}@example.org>"),
            format!("X-Armwatch-Key: armwatch-{identity}-{place}"),
            format!("References: <armwatch-{identity}-anomaly-{anomaly}@example.org>"),
            "From: armwatch <armwatch@example.org>".to_owned(),
            "X-RcptTo: wartung@example.org, shift@example.org".to_owned(),
            "MIME-Version: 1.0".to_owned(),
            "Content-Type: text/plain; charset=utf-8".to_owned(),
        ] {
            assert!(mail.lines().any(|found| found == line), "{line}\nnot in\n{mail}");
        }
        assert!(mail.contains("peak: 1.3, out by 30 %"), "{mail}");
    }
    assert!(found[0].contains("Subject: [armwatch] critical: R01, joint 3: drift opened"), "{}", found[0]);
    assert!(found[1].contains("Subject: [armwatch] ended: R01, joint 3: drift"), "{}", found[1]);
    // a missing server is reported as a failure in time
    drop(_python);
    let asked = std::time::Instant::now();
    let out = workshop.stdout(&["alerts", "test", "mail"], 74);
    assert!(out.contains("NOT SENT to email") && asked.elapsed() < Duration::from_secs(30), "{out}");
}
