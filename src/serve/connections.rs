//! Limits the open connections, and chooses the one that is closed to make room for another.
//!
//! A new connection is always accepted, because only its request shows whether it asks for the health of the daemon.
//! Instead, the longest idle connection of the network with the most connections is closed.

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use super::network::{Network, Proxies};

/// Connections at once. Each holds a socket, its buffers in the kernel, and at most one request's headers.
pub(super) const CONNECTIONS: usize = 256;

/// The share of one network. Programs of this machine and trusted proxies may have all connections, because a proxy
/// serves many clients.
const CONNECTIONS_OF_ONE: usize = CONNECTIONS / 4;

/// A connection is not closed for another one within this time after its last byte: its request may be on the way.
const SPARED: Duration = Duration::from_millis(250);

/// Open connections. Clones share them.
#[derive(Debug, Clone)]
pub(super) struct Connections {
    proxies: Proxies,
    began: Instant,
    open: Arc<Mutex<Open>>,
}

#[derive(Debug, Default)]
struct Open {
    next: u64,
    by_number: HashMap<u64, Arc<ConnectionPhase>>,
}

/// The place of a connection, until it is dropped.
#[derive(Debug)]
pub(super) struct ConnectionPlace {
    connections: Connections,
    number: u64,
    pub(super) progress: Arc<ConnectionPhase>,
}

/// Progress of a connection.
#[derive(Debug)]
pub(super) struct ConnectionPhase {
    network: Network,
    began: Instant,
    /// Time of the last read or written byte, ms since `began`.
    moved_ms: AtomicU64,
    /// Requests that wait for the daemon, not for their client.
    answering: AtomicUsize,
    /// Cancelled when the connection must make room.
    pub(super) evicted: CancellationToken,
}

/// A request that waits for the daemon, until it is dropped.
#[derive(Debug)]
pub(super) struct Answering(Arc<ConnectionPhase>);

impl Connections {
    /// Starts without connections.
    pub(super) fn new(proxies: Proxies) -> Self {
        Self { proxies, began: Instant::now(), open: Arc::default() }
    }

    /// Gives a new connection a place. If all places are taken, closes another connection.
    pub(super) fn enter(&self, network: Network) -> ConnectionPlace {
        let progress = Arc::new(ConnectionPhase {
            network,
            began: self.began,
            moved_ms: AtomicU64::new(ms(self.began.elapsed())),
            answering: AtomicUsize::new(0),
            evicted: CancellationToken::new(),
        });
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(victim) =
            open.victim(network, self.proxies.serves_many(network), ms(self.began.elapsed()))
            && let Some(evicted) = open.by_number.remove(&victim)
        {
            tracing::debug!(network = %evicted.network, "closed a connection to make room");
            evicted.evicted.cancel();
        }
        let number = open.next;
        open.next += 1;
        open.by_number.insert(number, Arc::clone(&progress));
        ConnectionPlace { connections: self.clone(), number, progress }
    }
}

impl Open {
    /// The connection to close if `network` opens another one at `now`; `None` while there is room.
    fn victim(&self, network: Network, serves_many: bool, now: u64) -> Option<u64> {
        let mut counts: HashMap<Network, usize> = HashMap::new();
        for progress in self.by_number.values() {
            *counts.entry(progress.network).or_default() += 1;
        }
        let own = counts.get(&network).copied().unwrap_or(0);
        let most = counts.values().copied().max().unwrap_or(0);
        let is_crowded = |of: Network| counts.get(&of) == Some(&most);
        let gives_way: &dyn Fn(Network) -> bool = if own >= CONNECTIONS_OF_ONE && !serves_many {
            &|of| of == network
        } else if self.by_number.len() >= CONNECTIONS {
            &is_crowded
        } else {
            return None;
        };
        let candidates = self.by_number.iter().filter(|(_, progress)| gives_way(progress.network));
        candidates.min_by_key(|(_, progress)| progress.rank(now)).map(|(number, _)| *number)
    }
}

impl Drop for ConnectionPlace {
    fn drop(&mut self) {
        let mut open = self.connections.open.lock().unwrap_or_else(PoisonError::into_inner);
        open.by_number.remove(&self.number);
    }
}

impl ConnectionPhase {
    /// Notes that bytes were read or written.
    pub(super) fn moved(&self) {
        self.moved_ms.store(ms(self.began.elapsed()), Ordering::Relaxed);
    }

    /// Notes that a request waits for the daemon, so that its client does not count as idle.
    pub(super) fn answering(self: &Arc<Self>) -> Answering {
        self.answering.fetch_add(1, Ordering::Relaxed);
        Answering(Arc::clone(self))
    }

    /// Order in which connections are closed at `now`: spared ones last, otherwise by the time of their last byte.
    fn rank(&self, now: u64) -> (bool, u64) {
        let moved = self.moved_ms.load(Ordering::Relaxed);
        let is_recent = now.saturating_sub(moved) < ms(SPARED);
        (is_recent || self.answering.load(Ordering::Relaxed) > 0, moved)
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.0.answering.fetch_sub(1, Ordering::Relaxed);
        self.0.moved();
    }
}

fn ms(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(text: &str) -> Network {
        Network::of(text.parse().unwrap())
    }

    fn enter(connections: &Connections, text: &str, moved_ms: u64) -> ConnectionPlace {
        let place = connections.enter(network(text));
        place.progress.moved_ms.store(moved_ms, Ordering::Relaxed);
        place
    }

    fn is_open(place: &ConnectionPlace) -> bool {
        !place.progress.evicted.is_cancelled()
    }

    /// Connections that began long ago, so that none is spared.
    fn old() -> Connections {
        let began = Instant::now().checked_sub(Duration::from_secs(3600)).expect("an hour of running time");
        Connections { proxies: Proxies::default(), began, open: Arc::default() }
    }

    #[test]
    fn of_one_network_the_connection_that_stood_still_longest_gives_way() {
        let connections = old();
        // 300 addresses of one network
        let held: Vec<ConnectionPlace> = (0..300)
            .map(|number| enter(&connections, &format!("2001:db8::{number:x}"), 1000 + number))
            .collect();
        let open: Vec<usize> = (0..300).filter(|at| is_open(&held[*at])).collect();
        assert_eq!(open, (300 - CONNECTIONS_OF_ONE..300).collect::<Vec<_>>());
        held[299].progress.moved();
        let other = enter(&connections, "10.0.0.1", 1);
        let mapped = enter(&connections, "::ffff:10.0.0.1", 1);
        assert_eq!(mapped.progress.network, other.progress.network);
        assert!(
            held[300 - CONNECTIONS_OF_ONE..].iter().chain([&other]).all(is_open),
            "others are left alone"
        );
        drop((held, other, mapped));
        assert!(connections.open.lock().unwrap().by_number.is_empty());
    }

    #[test]
    fn when_all_places_are_taken_the_largest_network_gives_way() {
        let connections = old();
        let watcher = enter(&connections, "10.9.9.9", 0);
        let proxy: Vec<ConnectionPlace> =
            (1..CONNECTIONS).map(|_| enter(&connections, "127.0.0.1", 1000)).collect();
        assert!(proxy.iter().all(is_open), "programs of this machine may have all");
        let newcomers: Vec<ConnectionPlace> =
            (0..20).map(|number| enter(&connections, &format!("10.0.0.{number}"), 5)).collect();
        assert_eq!(proxy.iter().filter(|place| !is_open(place)).count(), 20);
        assert!(is_open(&watcher) && newcomers.iter().all(is_open), "no small network gives way");
    }

    #[test]
    fn a_request_that_waits_for_the_daemon_and_a_new_connection_are_spared() {
        let connections = old();
        let mut held: Vec<ConnectionPlace> =
            (0..CONNECTIONS_OF_ONE as u64).map(|number| enter(&connections, "10.0.0.1", number)).collect();
        let answering = held[0].progress.answering();
        let new = connections.enter(network("10.0.0.1"));
        assert!(is_open(&held[0]) && !is_open(&held[1]));
        held.push(connections.enter(network("10.0.0.1")));
        assert!(is_open(&new) && !is_open(&held[2]));
        drop(answering);
        assert!(held[0].progress.rank(ms(connections.began.elapsed())).0, "its answer is still to be read");
    }
}
