//! Clients that connect and then do nothing: they read no answer, send half a request, or hold an event stream. The
//! daemon continues to answer others.

use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use tokio::io::AsyncWriteExt;
use tokio::net::{TcpSocket, TcpStream};

use crate::http;
use crate::support::{Daemon, Workshop, pass, wait_until};

const TOKEN: &str = "a-token-of-this-test-0123456789";

/// Set in the process with a separate network.
const INSIDE: &str = "ARMWATCH_TEST_OWN_NETWORK";

/// More than the daemon's limit for one network, and more than its total.
const CROWD: usize = 300;

/// The longest wait for `/health`. It takes less than a second on an idle machine; other tests run on this one.
const PATIENCE: Duration = Duration::from_secs(10);

/// Behaviour of a client.
#[derive(Debug, Clone, Copy)]
enum Kind {
    /// Requests more than fits into all buffers, and reads nothing.
    Reader,
    /// Sends half of the headers.
    Writer,
    /// Sends headers that announce a body, and no body.
    Sender,
    /// Reads nothing of its event stream.
    Stream,
}

const KINDS: [Kind; 4] = [Kind::Reader, Kind::Writer, Kind::Sender, Kind::Stream];

impl Kind {
    fn request(self) -> Vec<u8> {
        let head = format!("HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n");
        match self {
            Self::Reader => format!("GET /assets/uPlot.iife.min.js {head}\r\n").repeat(50),
            Self::Writer => format!("GET / {head}X-Half"),
            Self::Sender => {
                format!("POST /v1/sql {head}Content-Type: application/sql\r\nContent-Length: 900\r\n\r\n")
            }
            Self::Stream => format!("GET /v1/events {head}\r\n"),
        }
        .into_bytes()
    }
}

/// A daemon that serves on all addresses of the machine.
struct Served {
    workshop: Workshop,
    daemon: Daemon,
    port: u16,
}

impl Served {
    fn new(listen: &str) -> Self {
        let workshop = Workshop::new();
        let port = http::free_port();
        let serve = format!("[serve]\nlisten = \"{listen}:{port}\"\ntoken_file = \"token\"\n\n");
        workshop.configure(|config| serve + &config);
        fs::write(workshop.path("token"), TOKEN).expect("a token");
        let daemon = workshop.daemon();
        let served = Self { workshop, daemon, port };
        assert!(served.health().is_some(), "{}", served.workshop.log());
        served
    }

    /// Duration of an answer to `/health`; `None` without one within `PATIENCE`.
    ///
    /// A health check retries if its connection is closed. The daemon closes a connection whose request has not arrived
    /// before 256 others connect, which happens on a busy machine.
    fn health(&self) -> Option<Duration> {
        let began = Instant::now();
        loop {
            if http::try_send(self.port, "GET /health", "", b"").is_some_and(|answer| answer.status == 200) {
                return Some(began.elapsed());
            }
            if began.elapsed() > PATIENCE {
                return None;
            }
            pass(Duration::from_millis(20));
        }
    }

    /// Number of open sockets of the daemon.
    fn sockets(&self) -> usize {
        let folder = format!("/proc/{}/fd", self.daemon.child.id());
        let files = fs::read_dir(folder).expect("files of the daemon").flatten();
        let is_socket = |file: &fs::DirEntry| {
            fs::read_link(file.path()).is_ok_and(|target| target.to_string_lossy().starts_with("socket:"))
        };
        files.filter(is_socket).count()
    }

    /// Holds `count` connections of a kind, the numbered client at `address`, and replaces them one after the other,
    /// while it requests `/health`. Returns the longest time for an answer.
    fn under(
        &self,
        kind: Kind,
        count: usize,
        time: Duration,
        address: impl Fn(usize) -> IpAddr + Sync,
    ) -> Duration {
        let (stop, opened) = (AtomicBool::new(false), AtomicUsize::new(0));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
                runtime.expect("a runtime").block_on(async {
                    let mut pace = tokio::time::interval(Duration::from_millis(5));
                    let mut held: Vec<Option<TcpStream>> = (0..count).map(|_| None).collect();
                    for at in (0..count).cycle() {
                        if stop.load(Ordering::Relaxed) {
                            return;
                        }
                        // the daemon may have closed it at once
                        held[at] = attack(kind, address(at), self.port).await.ok();
                        if opened.fetch_add(1, Ordering::Relaxed) >= count {
                            pace.tick().await;
                        }
                    }
                });
            });
            let (began, mut longest) = (Instant::now(), Some(Duration::ZERO));
            while longest.is_some() && (opened.load(Ordering::Relaxed) < count || began.elapsed() < time) {
                longest = longest.zip(self.health()).map(|(longest, took)| longest.max(took));
                pass(Duration::from_millis(20));
            }
            let answers = || http::try_send(self.port, "GET /ready", "", b"").map(|answer| answer.status);
            let ready = (0..10).find_map(|_| answers());
            stop.store(true, Ordering::Relaxed);
            assert_eq!(ready, Some(200), "{kind:?}: /ready");
            longest.unwrap_or_else(|| panic!("{kind:?}: no answer to /health"))
        })
    }
}

/// Opens a connection from an address of this machine and sends the beginning of the kind's request.
async fn attack(kind: Kind, from: IpAddr, port: u16) -> std::io::Result<TcpStream> {
    let (socket, to) = match from {
        IpAddr::V4(_) => (TcpSocket::new_v4()?, IpAddr::V4(Ipv4Addr::LOCALHOST)),
        IpAddr::V6(_) => (TcpSocket::new_v6()?, from),
    };
    socket.set_recv_buffer_size(4096)?;
    socket.bind(SocketAddr::new(from, 0))?;
    let begun = async {
        let mut stream = socket.connect(SocketAddr::new(to, port)).await?;
        stream.write_all(&kind.request()).await?;
        Ok(stream)
    };
    tokio::time::timeout(Duration::from_secs(10), begun).await.unwrap_or_else(|late| Err(late.into()))
}

/// The numbered address of an IPv4 network with 65,536 addresses, all of this machine.
fn of_this_machine(number: usize) -> IpAddr {
    let [high, low] = u16::try_from(number).expect("a small number").to_be_bytes();
    IpAddr::V4(Ipv4Addr::new(127, 9, high, low))
}

#[test]
fn whatever_others_hold_health_is_answered_and_other_networks_keep_theirs() {
    let served = Served::new("127.0.0.1");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let mut page =
        runtime.block_on(attack(Kind::Stream, Ipv4Addr::new(127, 8, 0, 1).into(), served.port)).expect("it");
    for kind in KINDS {
        let longest = served.under(kind, CROWD, Duration::ZERO, |_| Ipv4Addr::LOCALHOST.into());
        assert!(longest < PATIENCE, "{kind:?} from one address: {longest:?}");
    }
    let mut heard = Vec::new();
    wait_until(
        || {
            let mut bytes = [0; 4096];
            let count = page.try_read(&mut bytes).unwrap_or(0);
            heard.extend_from_slice(&bytes[..count]);
            // the first event is sent at once
            String::from_utf8_lossy(&heard).matches("event: alive").count() > 1
        },
        || "a page of another network hears nothing".to_owned(),
    );
    runtime.block_on(page.shutdown()).expect("it was open");
    for kind in KINDS {
        let longest = served.under(kind, CROWD, Duration::ZERO, of_this_machine);
        assert!(longest < PATIENCE, "{kind:?} from many addresses: {longest:?}");
    }
    served.daemon.signal("TERM");
    assert_eq!(served.daemon.end(), Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn one_network_of_version_6_is_one_client_whatever_its_addresses() {
    if std::env::var_os(INSIDE).is_some() {
        let served = Served::new("[::]");
        let before = served.sockets();
        let address = |number: usize| {
            let last = u16::try_from(number % 300 + 1).expect("a small number");
            IpAddr::V6(Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, last))
        };
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        let held = runtime.block_on(async {
            let mut held = Vec::new();
            for number in 0..CROWD {
                held.push(attack(Kind::Stream, address(number), served.port).await.expect("a connection"));
            }
            held
        });
        // a quarter of the connections; closed ones disappear soon
        wait_until(|| served.sockets() <= before + 64, || format!("{} sockets", served.sockets()));
        drop(held);
        let longest = served.under(Kind::Writer, CROWD, Duration::ZERO, address);
        assert!(longest < PATIENCE, "{longest:?}");
        return;
    }
    const NETWORK: &str = "ip link set lo up && ip -6 route add local 2001:db8::/64 dev lo && \
                           echo 1 >/proc/sys/net/ipv6/ip_nonlocal_bind && exec \"$0\" \"$@\"";
    let is_there = |script: &str| {
        let arguments = ["--user", "--map-root-user", "--net", "sh", "-c"];
        let test = std::env::current_exe().expect("this test");
        let name = "slow_clients::one_network_of_version_6_is_one_client_whatever_its_addresses";
        let mut command = Command::new("unshare");
        command.args(arguments).arg(script).arg(test).args(["--exact", name]).env(INSIDE, "1");
        command.output()
    };
    let probe = is_there(&NETWORK.replace("exec \"$0\" \"$@\"", "true"));
    if !probe.as_ref().is_ok_and(|probe| probe.status.success()) {
        println!("skipped: this machine gives no network of its own ({probe:?})");
        return;
    }
    let inside = is_there(NETWORK).expect("it ran a moment ago");
    assert!(inside.status.success(), "{}", crate::support::text(&inside.stdout));
}

#[cfg(target_os = "linux")]
#[test]
#[ignore = "takes minutes: time limits of a minute, and a thousand clients of each kind"]
fn a_thousand_slow_clients_delay_health_by_less_than_a_second_and_are_cut() {
    let files = rustix::process::getrlimit(rustix::process::Resource::Nofile);
    let raised = rustix::process::Rlimit { current: files.maximum, maximum: files.maximum };
    rustix::process::setrlimit(rustix::process::Resource::Nofile, raised).expect("more open files");
    let served = Served::new("127.0.0.1");
    let before = served.sockets();
    for kind in KINDS {
        for many in [false, true] {
            let address =
                |number: usize| if many { of_this_machine(number % 300) } else { Ipv4Addr::LOCALHOST.into() };
            let longest = served.under(kind, 1000, Duration::from_secs(20), address);
            println!("{kind:?}, from {} addresses: {longest:?}", if many { 300 } else { 1 });
            assert!(longest < Duration::from_secs(1), "{kind:?}: {longest:?}");
        }
        if matches!(kind, Kind::Stream) {
            continue;
        }
        // clients that stay idle lose their connections
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        let held = runtime.block_on(async {
            let mut held = Vec::new();
            for number in 0..200 {
                held.push(attack(kind, of_this_machine(number), served.port).await.expect("a connection"));
            }
            held
        });
        let is_cut = || served.sockets() <= before + 1;
        wait_until(is_cut, || format!("{kind:?}: {} sockets of {before}", served.sockets()));
        drop(held);
    }
    served.daemon.signal("TERM");
    assert_eq!(served.daemon.end(), Some(0));
}
