//! Exports over HTTP: sent to the real daemon over real connections, interrupted, repeated, refused.

use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::time::Duration;

use crate::http::{self, Answer, answer};
use crate::support::{Daemon, REFERENCE_NAME, Workshop, reference, text, wait_until};

const TOKEN: &str = "a-token-of-this-test-0123456789";
const GREEDY: &str = "a-token-of-a-greedy-client-0123";
const COMPLETE_RUNS: &str = "SELECT count(*) FROM runs WHERE status = 'complete'";

/// A daemon that accepts uploads, and its port.
struct Receiver {
    workshop: Workshop,
    daemon: Option<Daemon>,
    port: u16,
}

impl Receiver {
    fn new(upload: &str) -> Self {
        Self::with("", upload)
    }

    /// With additional settings in `[serve]` and `[serve.upload]`.
    fn with(serve: &str, upload: &str) -> Self {
        let mut receiver = Self::prepared(serve, upload);
        receiver.start();
        receiver
    }

    /// A receiver without a running daemon.
    fn prepared(serve: &str, upload: &str) -> Self {
        let workshop = Workshop::new();
        let port = http::free_port();
        let serve = format!(
            "[serve]\nlisten = \"127.0.0.1:{port}\"\ntoken_file = \"token\"\n{serve}\n\
             [serve.upload]\nspool = \"spool\"\n{upload}\n\n"
        );
        workshop.configure(|config| serve + &config);
        fs::write(workshop.path("token"), TOKEN).expect("a token");
        fs::write(workshop.path("greedy"), GREEDY).expect("a token");
        Self { workshop, daemon: None, port }
    }

    fn start(&mut self) {
        self.daemon = Some(self.workshop.daemon());
        self.wait_until_ready();
    }

    /// Starts a daemon that cannot create files larger than about `kb` kB, like on a full disk.
    fn start_confined(&mut self, kb: u32) {
        let limit = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" run", 2 * kb);
        let child = std::process::Command::new("sh")
            .args(["-c", &limit, env!("CARGO_BIN_EXE_armwatch")])
            .current_dir(self.workshop.path(""))
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn();
        self.daemon = Some(Daemon { child: child.expect("the daemon starts") });
        self.wait_until_ready();
    }

    fn wait_until_ready(&self) {
        let is_ready = || self.try_send("GET /ready", "", b"").is_some_and(|answer| answer.status == 200);
        wait_until(is_ready, || "the daemon does not listen".to_owned());
    }

    fn stop(&mut self, signal: &str) -> Option<i32> {
        let daemon = self.daemon.take().expect("a daemon");
        daemon.signal(signal);
        daemon.end()
    }

    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).expect("a connection");
        stream.set_read_timeout(Some(Duration::from_secs(60))).expect("a timeout");
        stream
    }

    /// Sends a request with the token.
    fn send(&self, line: &str, headers: &str, body: &[u8]) -> Answer {
        let headers = format!("Authorization: Bearer {TOKEN}\r\n{headers}");
        self.try_send(line, &headers, body).unwrap_or_else(|| panic!("no answer to {line}"))
    }

    fn try_send(&self, line: &str, headers: &str, body: &[u8]) -> Option<Answer> {
        http::try_send(self.port, line, headers, body)
    }

    fn put(&self, name: &str, headers: &str, body: &[u8]) -> Answer {
        self.send(&format!("PUT /v1/exports/{name}"), headers, body)
    }

    /// Waits until an upload of this name has this number of bytes.
    fn wait_for_offset(&self, name: &str, wanted: u64) {
        let answer = || self.send(&format!("HEAD /v1/exports/{name}"), "", b"");
        let has_come = || answer().header("upload-offset") == Some(&wanted.to_string());
        wait_until(has_come, || answer().head);
    }

    fn partials(&self) -> usize {
        fs::read_dir(self.workshop.path("spool/.partial")).expect("the folder").count()
    }
}

fn export() -> Vec<u8> {
    fs::read(reference(REFERENCE_NAME)).expect("the reference export")
}

#[test]
fn an_upload_becomes_a_run_and_the_same_again_does_nothing() {
    let mut receiver = Receiver::new("");
    let bytes = export();
    let taken = receiver.put(REFERENCE_NAME, "Content-Type: application/gzip\r\n", &bytes);
    assert_eq!(taken.status, 201, "{}{}", taken.head, taken.body);
    let told = taken.json();
    assert_eq!((told["new"].as_bool(), told["bytes"].as_u64()), (Some(true), Some(bytes.len() as u64)));
    let status_at = format!("GET {}", told["status_at"].as_str().expect("an address"));
    assert_eq!(receiver.send(&status_at, "", b"").status, 200, "waiting or known at once");
    let by_name = |name: &str| receiver.send(&format!("GET /v1/exports/{name}"), "", b"");
    let waits = by_name(REFERENCE_NAME);
    assert_eq!(waits.status, 200, "by name as by hash: {}", waits.body);
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);
    let named = by_name(REFERENCE_NAME).json();
    assert_eq!((named["status"].as_str(), named["run_id"].as_i64()), (Some("complete"), Some(1)), "{named}");
    let known = receiver.send(&status_at, "", b"").json();
    assert_eq!((known["status"].as_str(), known["cycles"].as_u64()), (Some("complete"), Some(5)), "{known}");
    assert_eq!(
        receiver.workshop.query("SELECT content_hash FROM runs")[0],
        told["hash"].as_str().expect("it")
    );

    let again = receiver.put(REFERENCE_NAME, "", &bytes);
    assert_eq!((again.status, again.json()["new"].as_bool()), (200, Some(false)), "{}", again.body);
    let renamed = receiver.put("R09_20260105_0847.csv.gz", "", &bytes);
    assert_eq!(renamed.status, 200, "{}", renamed.body);
    let known = by_name("R09_20260105_0847.csv.gz");
    assert_eq!((known.status, known.json()["run_id"].as_i64()), (200, Some(1)), "{}", known.body);
    // a copy on disk, which the ledger knows only by its path
    let copy = "R08_20260105_0847.csv.gz";
    fs::write(receiver.workshop.inbox(copy), &bytes).expect("a copy");
    wait_until(|| by_name(copy).json()["run_id"].as_i64() == Some(1), || by_name(copy).body);
    assert_eq!(by_name("8_20260105_0847.csv.gz").status, 404, "the end of a name is another name");
    assert_eq!(by_name("..%2Farmwatch.toml").status, 404);
    // without any byte of the body, if the client sends the hash of the content first
    let said =
        format!("X-Content-BLAKE3: {}\r\nTransfer-Encoding: chunked\r\n", told["hash"].as_str().expect("it"));
    assert_eq!(receiver.put(REFERENCE_NAME, &said, b"").status, 200);
    assert_eq!(receiver.partials(), 0);
    assert_eq!(receiver.stop("TERM"), Some(0));
    assert_eq!(receiver.workshop.query("SELECT count(*) FROM runs"), ["1"]);
}

#[test]
fn an_upload_that_was_cut_goes_on_after_a_kill_and_a_restart() {
    let mut receiver = Receiver::new("");
    let bytes = export();
    let (first, rest) = bytes.split_at(100_000);
    let head = |range: &str, length: usize| {
        format!(
            "PUT /v1/exports/{REFERENCE_NAME} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\
             {range}Content-Length: {length}\r\n\r\n"
        )
    };
    let mut cut = receiver.connect();
    cut.write_all(head("", bytes.len()).as_bytes()).expect("sent");
    cut.write_all(first).expect("sent");
    receiver.wait_for_offset(REFERENCE_NAME, 100_000);
    let under_way = receiver.put(REFERENCE_NAME, "", &bytes);
    assert_eq!(under_way.status, 409, "{}", under_way.body);
    drop(cut);
    // the next part is interrupted by a kill
    let (second, last) = rest.split_at(50_000);
    let total = bytes.len();
    let range = |from: usize, to: usize| format!("Content-Range: bytes {from}-{}/{total}\r\n", to - 1);
    // until the receiver has noticed the end of the first connection, it refuses another one
    let mut killed = None;
    let is_taken = || {
        let stream = killed.insert(receiver.connect());
        stream.write_all(head(&range(100_000, total), rest.len()).as_bytes()).expect("sent");
        stream.write_all(second).expect("sent");
        let offset = receiver.send(&format!("HEAD /v1/exports/{REFERENCE_NAME}"), "", b"");
        offset.header("upload-offset") != Some("100000")
    };
    wait_until(is_taken, || "the second part is not taken".to_owned());
    receiver.wait_for_offset(REFERENCE_NAME, 150_000);
    assert_eq!(receiver.stop("KILL"), None);
    let _ = killed.expect("a connection").write_all(b"lost");
    receiver.start();
    receiver.wait_for_offset(REFERENCE_NAME, 150_000);
    assert_eq!(receiver.workshop.number("SELECT count(*) FROM runs"), 0, "nothing half is read");

    let wrong = receiver.put(REFERENCE_NAME, &range(140_000, total), &bytes[140_000..]);
    assert_eq!((wrong.status, wrong.header("upload-offset")), (409, Some("150000")), "{}", wrong.body);
    let (third, end) = last.split_at(1000);
    let part = receiver.put(REFERENCE_NAME, &range(150_000, 151_000), third);
    assert_eq!((part.status, part.header("upload-offset")), (202, Some("151000")), "{}", part.body);
    let done = receiver.put(REFERENCE_NAME, &range(151_000, total), end);
    assert_eq!(done.status, 201, "{}", done.body);
    assert_eq!(fs::read(receiver.workshop.path("spool").join(REFERENCE_NAME)).expect("it"), bytes);
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn ready_says_what_is_missing_and_that_it_is_back() {
    let mut receiver = Receiver::new("");
    let ask = || {
        let answer = receiver.try_send("GET /ready", "", b"").expect("an answer without a token");
        (answer.status, answer.json())
    };
    let (status, told) = ask();
    assert_eq!((status, &told["ready"], &told["spool"]), (200, &true.into(), &true.into()), "{told}");
    // without a token that may read, the answer has the number of folders but not their names
    wait_until(|| ask().1["folders_watched"] == 2, || format!("{}", ask().1));
    let (_, told) = ask();
    assert_eq!((&told["folders_silent"], told.to_string().contains('/')), (&0.into(), false), "{told}");
    let named = receiver.send("GET /ready", "", b"").json();
    assert!(named["folders"][0]["folder"].as_str().is_some_and(|folder| folder.starts_with('/')), "{named}");
    // a file in place of the folder of uploads: writing fails
    let (spool, aside) = (receiver.workshop.path("spool"), receiver.workshop.path("aside"));
    fs::rename(&spool, &aside).expect("moved");
    fs::write(&spool, b"").expect("written");
    wait_until(|| ask().0 == 503, || format!("{}", ask().1));
    let (_, told) = ask();
    assert_eq!(
        (&told["ready"], &told["spool"], &told["database"]),
        (&false.into(), &false.into(), &true.into())
    );
    assert_eq!(
        receiver.try_send("GET /health", "", b"").expect("an answer").status,
        200,
        "the process lives"
    );
    fs::remove_file(&spool).expect("removed");
    fs::rename(&aside, &spool).expect("moved back");
    wait_until(|| ask().0 == 200, || format!("{}", ask().1));
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn what_is_not_an_upload_is_refused_with_a_sentence() {
    let mut receiver = Receiver::new("max_bytes = 1000\nidle_timeout_s = 1");
    let small = b"time,pos_1\n0,1\n";
    let refused = |answer: Answer, status: u16, word: &str| {
        assert_eq!(answer.status, status, "{word}: {}{}", answer.head, answer.body);
        let said = answer.json()["error"].as_str().unwrap_or_default().to_owned();
        assert!(said.contains(word), "{word}: {said}");
        assert!(!answer.body.contains(TOKEN));
    };
    let name = "R00_20260105_0847.csv";
    let line = format!("PUT /v1/exports/{name}");
    refused(receiver.try_send(&line, "", small).expect("an answer"), 401, "Bearer");
    let wrong = "Authorization: Bearer a-token-of-this-test-0123456780\r\n";
    refused(receiver.try_send(&line, wrong, small).expect("an answer"), 401, "none of the daemon's");
    refused(receiver.put("..%2Finbox%2FR00.csv", "", small), 400, "without folders");
    refused(receiver.put(".R00.csv", "", small), 400, "hidden");
    refused(receiver.put("R00%00.csv", "", small), 400, "control");
    refused(receiver.put(&format!("{}.csv", "R".repeat(252)), "", small), 400, "255");
    refused(receiver.put("R00.xlsx", "", small), 415, ".csv.gz");
    refused(receiver.put(name, "Content-Type: multipart/form-data; boundary=x\r\n", small), 415, "alone");
    refused(receiver.put(name, "Content-Encoding: gzip\r\n", small), 415, "Content-Encoding");
    refused(receiver.put("R00_20261399_0847.csv", "", small), 422, "date");
    refused(receiver.put(name, "X-Content-BLAKE3: 12\r\n", small), 400, "64");
    let other = format!("X-Content-BLAKE3: {}\r\n", "0".repeat(64));
    refused(receiver.put(name, &other, small), 400, "send them again");
    refused(receiver.put(name, "", &[b'1'; 1001]), 413, "max_bytes");
    let chunked = [b"3e9\r\n".to_vec(), vec![b'1'; 1001], b"\r\n0\r\n\r\n".to_vec()].concat();
    refused(receiver.put(name, "Transfer-Encoding: chunked\r\n", &chunked), 413, "max_bytes");
    refused(receiver.put(name, "Content-Range: bytes 5-2/9\r\n", small), 400, "FIRST-LAST");
    refused(receiver.put(name, "", b""), 400, "empty");
    refused(receiver.send(&format!("POST /v1/exports/{name}"), "", small), 405, "PUT");
    refused(receiver.send("GET /v1/exports/12", "", b""), 404, "64");
    refused(receiver.send(&format!("GET /v1/exports/{}", "0".repeat(64)), "", b""), 404, "known");
    refused(receiver.send("GET /exports", "", b""), 404, "/v1/");

    // almost no data, for longer than permitted
    let mut slow = receiver.connect();
    let head = format!(
        "{line} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\nContent-Length: 900\r\n\r\nt"
    );
    slow.write_all(head.as_bytes()).expect("sent");
    refused(answer(&mut slow).expect("an answer"), 408, "slow");
    assert!(!receiver.workshop.path("inbox/R00.csv").exists());
    assert_eq!(fs::read_dir(receiver.workshop.path("spool")).expect("the spool").count(), 1, "only .partial");
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn an_export_is_explained_before_it_is_sent_and_not_kept() {
    let mut receiver = Receiver::new("");
    let made = receiver.workshop.simulate("made", &["--cycles", "2", "--warming-s", "5", "--name", "R00"]);
    let (name, bytes) = (made[0].file_name().expect("a name").to_string_lossy(), fs::read(&made[0]));
    let (asked, bytes) = (format!("{name}?explain=true"), bytes.expect("an export"));
    let explain = |bytes: &[u8]| {
        let answer = receiver.put(&asked, "", bytes);
        assert_eq!(answer.status, 200, "{}", answer.body);
        answer.json()
    };
    let sound = explain(&bytes);
    assert_eq!(sound["next"], "store", "{sound}");
    assert_eq!((&sound["robot"], &sound["kind"]), (&"R00".into(), &"test".into()), "{sound}");
    assert_eq!((&sound["cycles"], &sound["cycles_identified"]), (&2.into(), &2.into()), "{sound}");
    let rows = bytes.iter().filter(|byte| **byte == b'\n').count() - 1;
    assert_eq!(sound["rows"], rows, "{sound}");
    assert_eq!(sound["problems"].as_array().map(Vec::len), Some(0), "{sound}");

    let mut lines: Vec<String> = text(&bytes).lines().map(str::to_owned).collect();
    lines[99] = lines[99].replacen(',', ",abc", 1);
    let broken = explain(lines.join("\n").as_bytes());
    assert_eq!(broken["next"], "quarantine", "{broken}");
    let problem = broken["problems"][0].as_str().expect("a problem");
    assert!(problem.starts_with("line 100, column ") && problem.contains("abc"), "{problem}");

    receiver.workshop.wait_until_idle();
    assert_eq!(receiver.workshop.number("SELECT count(*) FROM runs"), 0);
    assert_eq!(receiver.partials(), 0);
    assert_eq!(receiver.put(&name, "", &bytes).status, 201);
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);
    let known = explain(&bytes);
    let run_id = receiver.workshop.number("SELECT run_id FROM runs");
    assert_eq!((&known["next"], &known["run_id"]), (&"nothing".into(), &run_id.into()), "{known}");

    let large = receiver.put(&asked, "Content-Range: bytes 0-9/99999999\r\n", b"0123456789");
    assert_eq!(large.status, 413, "{}", large.body);
    let without_token = receiver.try_send(&format!("PUT /v1/exports/{asked}"), "", &bytes);
    assert_eq!(without_token.map(|answer| answer.status), Some(401));
    assert_eq!(receiver.put(&format!("{name}?explains=true"), "", &bytes).status, 400);
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn a_name_holds_one_content_unless_the_sender_wants_it_otherwise() {
    let mut receiver = Receiver::new("");
    let first = export();
    let second = fs::read(
        receiver.workshop.simulate("elsewhere", &["--cycles", "2", "--warming-s", "5", "--name", "R00"])[0]
            .clone(),
    );
    let second = second.expect("an export");
    let name = "R00_20260105_0847.csv";
    // two at once: one is accepted, the other one refused or told that the export is known
    let answers: Vec<u16> = std::thread::scope(|scope| {
        let sending: Vec<_> = (0..2).map(|_| scope.spawn(|| receiver.put(name, "", &first).status)).collect();
        sending.into_iter().map(|thread| thread.join().expect("an answer")).collect()
    });
    assert!(answers.contains(&201), "{answers:?}");
    assert!(answers.iter().all(|status| [200, 201, 409].contains(status)), "{answers:?}");
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);

    let conflict = receiver.put(name, "", &second);
    assert_eq!(conflict.status, 409, "{}", conflict.body);
    assert!(conflict.body.contains("supersede=true"), "{}", conflict.body);
    assert_eq!(fs::read(receiver.workshop.path("spool").join(name)).expect("it"), first);
    let wanted = receiver.put(&format!("{name}?supersede=true"), "", &second);
    assert_eq!(wanted.status, 201, "{}", wanted.body);
    receiver.workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'superseded'", 1);
    assert_eq!(
        receiver.workshop.query("SELECT status, cycles FROM runs ORDER BY run_id"),
        ["superseded|5", "complete|2"]
    );
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn a_faulty_upload_is_told_and_corrected_under_its_name() {
    let mut receiver = Receiver::new("unknown_robots = \"take\"");
    let faulty = receiver.put("R00_20260105_0847.csv", "", b"time,pos_1\n0,1\n");
    assert_eq!(faulty.status, 201, "{}", faulty.body);
    receiver.workshop.wait_for("SELECT count(*) FROM quarantine WHERE state = 'open'", 1);
    let told =
        receiver.send(&format!("GET {}", faulty.json()["status_at"].as_str().expect("it")), "", b"").json();
    assert_eq!(told["status"].as_str(), Some("quarantined"), "{told}");
    assert!(told["reason"].as_str().is_some_and(|reason| reason.contains("wrong joint count")), "{told}");
    let corrected = receiver.put("R00_20260105_0847.csv", "", &export());
    assert_eq!(corrected.status, 201, "{}", corrected.body);
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);
    assert_eq!(receiver.workshop.number("SELECT count(*) FROM quarantine WHERE state = 'open'"), 0);
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn a_part_of_another_total_is_refused_and_makes_no_cut_export() {
    let mut receiver = Receiver::new("");
    let bytes = export();
    let put = |range: &str, body: &[u8]| {
        receiver.put(REFERENCE_NAME, &format!("Content-Range: bytes {range}\r\n"), body)
    };
    let total = bytes.len();
    assert_eq!(put(&format!("0-999/{total}"), &bytes[..1000]).status, 202);
    for (range, body) in [("1000-1999/2000", &bytes[1000..2000]), ("*/1000", &[][..])] {
        let refused = put(range, body);
        assert_eq!(
            (refused.status, refused.header("upload-offset")),
            (409, Some("1000")),
            "{}",
            refused.body
        );
        assert!(refused.body.contains(&format!("one of {total} bytes")), "{}", refused.body);
    }
    // the request of an interrupted export also has its length
    let mut cut = receiver.connect();
    let head = format!(
        "PUT /v1/exports/{REFERENCE_NAME} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\
         Content-Length: {total}\r\n\r\n"
    );
    cut.write_all(&[head.as_bytes(), &bytes[..3000]].concat()).expect("sent");
    receiver.wait_for_offset(REFERENCE_NAME, 3000);
    drop(cut);
    let mut refused = None;
    wait_until(
        || refused.insert(put("3000-3999/4000", &bytes[3000..4000])).body.contains("one of"),
        || "the cut upload does not end".to_owned(),
    );
    assert_eq!(refused.expect("an answer").status, 409);
    assert_eq!(put(&format!("3000-{}/{total}", total - 1), &bytes[3000..]).status, 201);
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn a_client_that_begins_uploads_and_ends_none_leaves_room_for_others() {
    let greedy =
        "requests_per_s = 0\n[[serve.token]]\nname = \"greedy\"\nfile = \"greedy\"\nscopes = [\"upload\"]";
    let mut receiver = Receiver::with(greedy, "unknown_robots = \"take\"");
    let part = |token: &str, name: &str| {
        let headers = format!("Authorization: Bearer {token}\r\nContent-Range: bytes 0-0/900\r\n");
        let sent = receiver.try_send(&format!("PUT /v1/exports/{name}"), &headers, b"t").expect("an answer");
        assert_eq!(sent.status, 202, "{name}: {}", sent.body);
    };
    part(TOKEN, "honest.csv");
    for number in 0..300 {
        part(GREEDY, &format!("greedy{number}.csv"));
    }
    assert_eq!(receiver.partials(), 1 + 256);
    let offset = |name: &str| receiver.send(&format!("HEAD /v1/exports/{name}"), "", b"").status;
    assert_eq!(["honest.csv", "greedy0.csv", "greedy299.csv"].map(offset), [200, 404, 200]);
    let whole = receiver.put(REFERENCE_NAME, "", &export());
    assert_eq!(whole.status, 201, "{}", whole.body);
    assert_eq!(receiver.stop("TERM"), Some(0));
}

/// The daemon with a spool on a separate disk that is full until the file `free` exists; it ends with 99 if the machine
/// has no such disk.
const FULL_SPOOL: &str = r#"
mkdir spool
mount -t tmpfs -o size=8m tmpfs spool || exit 99
mkdir spool/.partial
dd if=/dev/zero of=spool/.partial/filler bs=4096 count=100000
(until [ -e free ]; do sleep 0.1; done; rm spool/.partial/filler) &
exec "$ARMWATCH" run
"#;

#[cfg(target_os = "linux")]
#[test]
fn a_full_spool_stops_uploads_and_nothing_else() {
    let mut receiver = Receiver::prepared("", "");
    let log = fs::File::create(receiver.workshop.path("daemon.log")).expect("a log");
    let child = std::process::Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount", "sh", "-c", FULL_SPOOL])
        .current_dir(receiver.workshop.path(""))
        .env("ARMWATCH", env!("CARGO_BIN_EXE_armwatch"))
        .env("ARMWATCH_LOG", crate::support::LOG_LEVELS)
        .env_remove("ARMWATCH_CONFIG")
        .stdout(std::process::Stdio::null())
        .stderr(log)
        .spawn();
    receiver.daemon = Some(Daemon { child: child.expect("unshare starts") });
    let port = receiver.port;
    let listens = || http::try_send(port, "GET /health", "", b"").is_some();
    let mut ended = None;
    let daemon = receiver.daemon.as_mut().expect("a daemon");
    wait_until(
        || {
            ended = daemon.child.try_wait().expect("a child");
            ended.is_some() || listens()
        },
        || "the daemon neither listens nor ends".to_owned(),
    );
    if ended.is_some_and(|status| status.code() != Some(74)) {
        println!("skipped: this machine gives no file system of its own ({ended:?})");
        return;
    }
    assert!(listens(), "{ended:?} {}", receiver.workshop.log());
    let ready = || receiver.send("GET /ready", "", b"");
    let said = ready().json();
    assert_eq!(
        (ready().status, &said["spool"], &said["database"]),
        (503, &false.into(), &true.into()),
        "{said}"
    );
    assert!(said["uploads_refused"].as_str().is_some_and(|why| why.contains("disk of the spool")), "{said}");
    let told = receiver.try_send("GET /ready", "", b"").expect("an answer without a token").json();
    assert_eq!(told["uploads_refused"], serde_json::Value::Null, "{told}");
    let refused = receiver.put(REFERENCE_NAME, "", &export());
    assert_eq!(refused.status, 507, "{}", refused.body);
    assert!(refused.body.contains("free space"), "{}", refused.body);
    assert!(receiver.workshop.log().contains("uploads are refused"), "{}", receiver.workshop.log());
    let figures = || receiver.send("GET /metrics", "", b"").body;
    assert!(figures().contains("armwatch_uploads_up 0"), "{}", figures());
    assert_eq!(receiver.send("GET /", "", b"").status, 200, "the dashboard");
    // watched folders are still read
    receiver.workshop.add_reference("inbox");
    receiver.workshop.wait_for(COMPLETE_RUNS, 1);

    fs::write(receiver.workshop.path("free"), b"").expect("written");
    wait_until(|| ready().status == 200, || format!("{}", ready().json()));
    // 8.4 MB, and 5 % must stay free
    let mut large = receiver.connect();
    let head = format!(
        "PUT /v1/exports/R01_20260106_0847.csv HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\
         Content-Length: 8200000\r\n\r\n"
    );
    large.write_all(head.as_bytes()).expect("sent");
    let refused = answer(&mut large).expect("an answer");
    assert!(refused.status == 507 && refused.body.contains("reserved"), "{}{}", refused.head, refused.body);
    let name = "R01_20260107_0847.csv";
    assert_eq!(receiver.put(name, "Content-Range: bytes 0-3/9\r\n", b"time").status, 202);
    assert!(figures().contains("armwatch_uploads_up 1"), "{}", figures());
    assert_eq!(receiver.stop("TERM"), Some(0));
}

#[test]
fn a_full_disk_is_told_and_leaves_nothing_behind() {
    let mut receiver = Receiver::new("");
    assert_eq!(receiver.stop("TERM"), Some(0));
    receiver.start_confined(4000);
    // for shells with blocks of 1024 bytes, twice as many
    let full = receiver.put("R00_20260105_0847.csv", "", &vec![b'1'; 9_000_000]);
    assert_eq!(full.status, 507, "{}{}", full.head, full.body);
    assert!(
        full.header("retry-after").is_some() && full.body.contains("no space"),
        "{}{}",
        full.head,
        full.body
    );
    assert_eq!(receiver.partials(), 0);
    let small = receiver.put(REFERENCE_NAME, "", &export());
    assert_eq!(small.status, 201, "{}", small.body);
    assert_eq!(receiver.try_send("GET /health", "", b"").map(|answer| answer.status), Some(200));
    receiver.stop("KILL");
}

#[test]
fn without_a_token_other_machines_are_not_listened_to() {
    let workshop = Workshop::new();
    workshop.configure(|config| format!("[serve]\nlisten = \"0.0.0.0:0\"\n\n{config}"));
    let refused = workshop.command(&["run"]).env_remove("ARMWATCH_TOKEN").output().expect("it runs");
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    assert!(text(&refused.stderr).contains("token_file"), "{}", text(&refused.stderr));
    let checked = workshop.stdout(&["config", "check"], 2);
    assert!(checked.contains("token_file"), "{checked}");
    let with_token = workshop.command(&["config", "check"]).env("ARMWATCH_TOKEN", TOKEN).output();
    let checked = text(&with_token.expect("it runs").stdout);
    assert!(checked.contains("HTTP                      0.0.0.0:0; no token file; no uploads"), "{checked}");
    workshop.configure(|config| config.replace("0.0.0.0:0\"", "here\"\n[serve.upload]\nmax_bytes = 0"));
    let checked = workshop.stdout(&["config", "check"], 2);
    assert!(checked.contains("serve.listen") && checked.contains("serve.upload.max_bytes"), "{checked}");
}
