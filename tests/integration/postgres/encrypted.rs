//! A server on a network: encrypted connections, users with a password.

use std::fs;
use std::os::unix::fs::PermissionsExt;

use super::server::Server;
use crate::small;
use crate::support::text;

/// A password with characters that must be escaped in an address.
const PASSWORD: &str = "a b:c/d@e?f";

#[test]
fn a_server_is_asked_encrypted_and_with_a_password() {
    let Some(mut server) = Server::start() else { return };
    let Some((port, authority)) = server.listen_encrypted() else { return };
    // before version 14 the default form of stored passwords was another one
    server.sql(&format!(
        "SET password_encryption = 'scram-sha-256'; CREATE ROLE plant LOGIN PASSWORD '{PASSWORD}'"
    ));
    server.sql("CREATE DATABASE encrypted OWNER plant");
    let workshop = small::workshop();
    let home = workshop.path("home");
    fs::create_dir_all(&home).expect("a folder");
    let ask = |words: &[&str], login: &str, more: &str, password: Option<&str>| {
        let address = format!("postgres://{login}/encrypted?{more}");
        let mut command = workshop.command(&[words, &["--db", &address]].concat());
        command.env("HOME", &home).env_remove("PGPASSWORD");
        if let Some(password) = password {
            command.env("PGPASSWORD", password);
        }
        let output = command.output().expect("it runs");
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    };
    let plant = format!("plant@localhost:{port}");
    let verified = format!("sslmode=verify-full&sslrootcert={}", authority.display());
    let (code, said) = ask(&["ingest", "inbox"], &plant, &verified, Some(PASSWORD));
    assert_eq!(code, Some(0), "{said}");
    let runs = |login: &str, more: &str, password: Option<&str>| ask(&["runs"], login, more, password);
    let (_, shown) = runs(&plant, "sslmode=require", Some(PASSWORD));
    assert_eq!(runs(&plant, &verified, Some(PASSWORD)), (Some(0), shown.clone()));
    let in_address = format!("plant:a%20b%3Ac%2Fd%40e%3Ff@localhost:{port}");
    assert_eq!(runs(&in_address, &verified, None), (Some(0), shown.clone()));
    let pass = home.join(".pgpass");
    fs::write(&pass, format!("localhost:{port}:encrypted:plant:{}\n", PASSWORD.replace(':', "\\:")))
        .expect("written");
    fs::set_permissions(&pass, fs::Permissions::from_mode(0o600)).expect("private");
    assert_eq!(runs(&plant, &verified, None), (Some(0), shown));
    fs::remove_file(pass).expect("removed");
    for (login, more, password, wanted) in [
        (&plant, "sslmode=verify-full", Some(PASSWORD), "sslrootcert=FILE"),
        (&format!("plant@127.0.0.1:{port}"), &verified, Some(PASSWORD), "as its certificate names it"),
        (&plant, "sslmode=disable", Some(PASSWORD), "pg_hba.conf"),
        (&plant, &verified, Some("guessed"), "check name and password"),
        (&plant, &verified, None, "check name and password"),
        (&in_address, "sslmode=verify-full&sslrootcert=nowhere.crt", None, "nowhere.crt"),
    ] {
        let (code, said) = runs(login, more, password);
        assert_eq!(code, Some(74), "{more}: {said}");
        assert!(said.contains(wanted), "{more}: {said}");
        assert!(!said.contains(PASSWORD) && !said.contains("a%20b"), "{said}");
    }
}
