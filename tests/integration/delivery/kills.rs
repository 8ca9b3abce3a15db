//! A daemon that is killed while it delivers: every event arrives, and repetitions have the same key.
//!
//! `ARMWATCH_KILLS` is the number of kills of the long test, `ARMWATCH_SEED` the seed of its random numbers.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::outbox::Outbox;
use super::sink::{Posted, Sink};
use super::{end, webhook, workshop};
use crate::support::pass;

/// Longest life of the daemon. It delivers about a tenth of a second after its start, and events are written
/// continuously.
const LONGEST_LIFE: Duration = Duration::from_millis(900);

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text} is not a whole number")))
}

/// Kills the daemon `count` times; returns the number of messages that arrived more than once.
fn kills(count: usize, seed: u64) -> usize {
    println!("ARMWATCH_SEED={seed}");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // each fifth answer is a temporary refusal, and answers take up to 60 ms, so that many daemons die before the
    // answer
    let sink = Sink::answering(|before, _| {
        let status = if before.len() % 5 == 4 { 503 } else { 200 };
        (status, Duration::from_millis(20 * (before.len() as u64 % 4)))
    });
    let workshop = workshop(&webhook("shift", &sink.url(), "most_per_h = 100000"));
    let mut outbox = Outbox::new(&workshop);
    // the route is known: from here on no event may be missing
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM delivery_route", 1);
    end(daemon);
    let mut open = Vec::new();
    for _ in 0..count {
        let mut daemon = workshop.daemon();
        let life = random.random_range(Duration::from_millis(50)..LONGEST_LIFE);
        for _ in 0..3 {
            match open.pop() {
                Some(anomaly) if random.random_bool(0.5) => {
                    outbox.event(anomaly, "ended", "critical");
                }
                _ => open.push(outbox.open_anomaly("R01", random.random_range(1..=6), "critical")),
            }
            pass(life / 3);
        }
        daemon.child.kill().expect("it lives until it is killed");
        assert_eq!(daemon.child.wait().expect("a child").code(), None, "the daemon ended by itself");
    }
    let daemon = workshop.daemon();
    let events = workshop.query("SELECT anomaly_event_id FROM anomaly_history ORDER BY 1");
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE state = 'sent'", events.len() as i64);
    end(daemon);
    let identity = outbox.identity();
    let wanted: BTreeSet<String> =
        events.iter().map(|event| format!("armwatch-{identity}-{event}")).collect();
    let mut by_key: BTreeMap<String, Vec<Posted>> = BTreeMap::new();
    for posted in sink.taken() {
        by_key.entry(posted.key()).or_default().push(posted);
    }
    assert_eq!(by_key.keys().cloned().collect::<BTreeSet<_>>(), wanted, "seed {seed}");
    // one key is one event: repetitions have the same content
    let saying = |posted: &Posted| {
        let told = posted.json();
        (told["title"].clone(), told["alerts"][0]["fingerprint"].clone(), told["alerts"][0]["status"].clone())
    };
    for (key, posted) in &by_key {
        assert!(posted.iter().all(|one| saying(one) == saying(&posted[0])), "{key}: {posted:#?}");
    }
    // the end of an anomaly arrives after its beginning
    let mut first_end: BTreeMap<String, bool> = BTreeMap::new();
    for posted in sink.taken() {
        let told = posted.json();
        let anomaly = told["alerts"][0]["fingerprint"].to_string();
        let is_end = told["status"] == "resolved";
        assert!(!is_end || first_end.contains_key(&anomaly), "{anomaly} ended before it began");
        first_end.insert(anomaly, is_end);
    }
    let repeated = by_key.values().filter(|posted| posted.len() > 1).count();
    println!("{} events, {repeated} came twice", events.len());
    repeated
}

#[test]
fn a_daemon_killed_during_delivery_loses_nothing() {
    kills(15, number("ARMWATCH_SEED").unwrap_or_else(rand::random));
}

#[test]
#[ignore = "takes minutes: 100 kills, or as many as ARMWATCH_KILLS says"]
fn a_daemon_killed_a_hundred_times_during_delivery_loses_nothing() {
    let count = number("ARMWATCH_KILLS").map_or(100, |kills| usize::try_from(kills).expect("a size"));
    let repeated = kills(count, number("ARMWATCH_SEED").unwrap_or_else(rand::random));
    assert!(count < 100 || repeated > 0, "no kill hit a message on its way: the test is too kind");
}
