//! TLS of the daemon's own, with curl as the client.

use std::fs;
use std::process::{Command, Output, Stdio};

use crate::delivery::encrypted::certificates;
use crate::http::{free_port, try_send};
use crate::support::{Workshop, text};

/// Returns true if this machine has the programs of these tests; otherwise prints that the test is skipped.
fn has_programs() -> bool {
    let missing = ["curl", "openssl"].into_iter().find(|program| {
        Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err()
    });
    if let Some(program) = missing {
        println!("SKIPPED: {program} is not installed; .ci/run installs it");
    }
    missing.is_none()
}

fn serve(workshop: &Workshop, port: u16) {
    let head = format!(
        "[serve]\nlisten = \"127.0.0.1:{port}\"\n[serve.tls]\ncertificate = \"server.pem\"\nkey = \"server.key\"\n"
    );
    workshop.configure(|config| head + &config);
}

fn curl(workshop: &Workshop, authority: &str, port: u16, address: &str) -> Output {
    let url = format!("https://127.0.0.1:{port}{address}");
    let ca = workshop.path(authority);
    let arguments = ["--silent", "--show-error", "--fail", "--compressed", "--max-time", "30", "--cacert"];
    Command::new("curl").args(arguments).arg(ca).arg(url).output().expect("curl runs")
}

#[test]
fn a_browser_trusts_the_certificate_which_is_renewed_while_the_daemon_runs() {
    if !has_programs() {
        return;
    }
    let workshop = Workshop::new();
    certificates(&workshop);
    let port = free_port();
    serve(&workshop, port);
    let daemon = workshop.daemon();
    let is_trusted = || curl(&workshop, "ca.pem", port, "/ready").status.success();
    workshop.wait_until(is_trusted);
    let fleet = curl(&workshop, "ca.pem", port, "/v1/fleet");
    assert!(text(&fleet.stdout).starts_with("{\"now\":"), "{}", text(&fleet.stdout));
    assert!(text(&curl(&workshop, "ca.pem", port, "/").stdout).contains("<title>armwatch</title>"));
    let doubted = curl(&workshop, "other.pem", port, "/ready");
    assert_eq!(doubted.status.code(), Some(60), "{}", text(&doubted.stderr));
    assert!(try_send(port, "GET /ready", "", b"").is_none_or(|answer| answer.status != 200), "in clear text");

    // a key without its certificate changes nothing
    let key = fs::read(workshop.path("server.key")).expect("a key");
    fs::copy(workshop.path("other.key"), workshop.path("server.key")).expect("another key");
    daemon.signal("HUP");
    workshop.wait_until(|| workshop.log().contains("the key is not that of the certificate in server.pem"));
    assert!(is_trusted());
    fs::write(workshop.path("server.key"), key).expect("the key");

    // new files of another authority under the same names
    certificates(&workshop);
    assert!(!is_trusted(), "the daemon still has the old certificate");
    daemon.signal("HUP");
    workshop.wait_until(is_trusted);
    daemon.stop();
}

#[test]
fn files_that_cannot_be_used_are_named_with_their_remedy() {
    if !has_programs() {
        return;
    }
    let workshop = Workshop::new();
    certificates(&workshop);
    serve(&workshop, free_port());
    let refused = |what: &str| {
        let output = workshop.run(&["run"]);
        let said = text(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(what), "{:?}\n{said}", output.status.code());
    };
    let certificate = fs::read(workshop.path("server.pem")).expect("a certificate");
    fs::remove_file(workshop.path("server.pem")).expect("deleted");
    refused("serve.tls.certificate = server.pem: No such file");
    fs::write(workshop.path("server.pem"), "no certificate").expect("written");
    refused("serve.tls.certificate = server.pem: holds no certificate; name a PEM file");
    fs::write(workshop.path("server.pem"), certificate).expect("written");
    fs::copy(workshop.path("names"), workshop.path("server.key")).expect("written");
    refused("serve.tls.key = server.key: holds no unencrypted private key; name a PEM file");
}
