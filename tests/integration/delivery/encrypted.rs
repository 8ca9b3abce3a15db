//! Delivery over TLS, with an authority of the test: only its certificate is trusted.

use std::fs;
use std::io::BufReader;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::thread;

use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::real_receivers::{DEBIAN_PYTHON, port, server};
use super::workshop;
use crate::support::Workshop;

/// Writes `ca.pem`, and `server.pem` with `server.key`, signed by it for 127.0.0.1; `other.pem` is another authority.
pub fn certificates(workshop: &Workshop) {
    let openssl = |arguments: &str| {
        let done = Command::new("openssl")
            .args(arguments.split(' '))
            .current_dir(workshop.path(""))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        assert!(done.expect("openssl runs").success(), "openssl {arguments}");
    };
    let key = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes";
    fs::write(workshop.path("names"), "subjectAltName=IP:127.0.0.1\n").expect("names");
    for authority in ["ca", "other"] {
        openssl(&format!(
            "req -x509 {key} -keyout {authority}.key -out {authority}.pem -days 2 -subj /CN={authority}"
        ));
    }
    openssl(&format!("req {key} -keyout server.key -out server.csr -subj /CN=server"));
    openssl(
        "x509 -req -in server.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out server.pem -days 2 -extfile names",
    );
}

/// Asserts that the route `trusting` delivers and the route `doubting` refuses the certificate.
fn assert_trusts_its_authority_alone(workshop: &Workshop) {
    // an empty database
    workshop.stdout(&["ingest", "inbox"], 0);
    let out = workshop.stdout(&["alerts", "test", "trusting"], 0);
    assert!(out.contains("accepted it"), "{out}");
    let out = workshop.stdout(&["alerts", "test", "doubting"], 74);
    assert!(out.to_lowercase().contains("certificate"), "{out}");
}

/// Answers requests over TLS, without limit.
fn https(workshop: &Workshop, listener: TcpListener) {
    let open = |name: &str| BufReader::new(fs::File::open(workshop.path(name)).expect("a file"));
    let chain = CertificateDer::pem_reader_iter(open("server.pem")).collect::<Result<Vec<_>, _>>();
    let key = PrivateKeyDer::from_pem_reader(open("server.key")).expect("a key");
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("versions")
        .with_no_client_auth()
        .with_single_cert(chain.expect("certificates"), key)
        .expect("a configuration");
    listener.set_nonblocking(true).expect("a listener");
    // ends with the process
    thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).expect("a listener");
            let acceptor = TlsAcceptor::from(Arc::new(config));
            while let Ok((stream, _)) = listener.accept().await {
                let Ok(stream) = acceptor.accept(stream).await else { continue };
                let mut stream = tokio::io::BufReader::new(stream);
                let (mut line, mut length) = (String::new(), 0);
                while stream.read_line(&mut line).await.is_ok_and(|read| read > 2) {
                    if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
                        length = value.trim().parse().expect("a length");
                    }
                    line.clear();
                }
                let mut body = vec![0; length];
                stream.read_exact(&mut body).await.expect("a body");
                let told: serde_json::Value = serde_json::from_slice(&body).expect("JSON");
                assert_eq!(told["version"], "4");
                let answer = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n";
                stream.write_all(answer).await.expect("answered");
                stream.flush().await.expect("answered");
            }
        });
    });
}

fn routes(of: impl Fn(&str) -> String) -> String {
    let route = |(name, authority): (&str, &str)| {
        format!("[[alerts.route]]\nname = \"{name}\"\n{}ca_file = \"{authority}.pem\"\n", of(name))
    };
    [("trusting", "ca"), ("doubting", "other")].map(route).concat()
}

#[test]
fn a_webhook_over_https() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let workshop =
        workshop(&routes(|_| format!("[alerts.route.webhook]\nurl = \"https://127.0.0.1:{port}/hook\"\n")));
    certificates(&workshop);
    https(&workshop, listener);
    assert_trusts_its_authority_alone(&workshop);
}

#[test]
fn mqtt_over_tls() {
    let port = port();
    let workshop =
        workshop(&routes(|_| format!("[alerts.route.mqtt]\nhost = \"127.0.0.1\"\nport = {port}\n")));
    certificates(&workshop);
    let config = format!(
        "listener {port} 127.0.0.1\nallow_anonymous true\nuser root\ncertfile {}\nkeyfile {}\n",
        workshop.path("server.pem").display(),
        workshop.path("server.key").display()
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
    assert_trusts_its_authority_alone(&workshop);
}

#[test]
fn mail_after_starttls() {
    if !Path::new(DEBIAN_PYTHON).join("aiosmtpd").exists() {
        println!("SKIPPED: python3-aiosmtpd is not installed; .ci/run installs it");
        return;
    }
    let port = port();
    let workshop = workshop(&routes(|_| {
        format!(
            "[alerts.route.email]\nhost = \"127.0.0.1\"\nport = {port}\nfrom = \"a@example.org\"\n\
             to = [\"b@example.org\"]\n"
        )
    }));
    certificates(&workshop);
    let mails = workshop.path("mails");
    let python = server(&["/usr/bin/python3"], &workshop.path("smtp.log"), port, |command| {
        command
            .args(["-m", "aiosmtpd", "-n", "-l", &format!("127.0.0.1:{port}")])
            .args(["--tlscert", "server.pem", "--tlskey", "server.key", "-c", "aiosmtpd.handlers.Mailbox"])
            .arg(&mails)
            .current_dir(workshop.path(""))
            .env("PYTHONPATH", DEBIAN_PYTHON);
    });
    let Some(_python) = python else { return };
    assert_trusts_its_authority_alone(&workshop);
    assert_eq!(fs::read_dir(mails.join("new")).expect("mails").count(), 1);
}
