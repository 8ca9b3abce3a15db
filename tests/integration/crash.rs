//! The proof of the exactly-once effect: a daemon is killed at random while it stores many exports, some of them
//! growing. It ends with the same rows as a daemon that was not killed.
//!
//! `ARMWATCH_KILLS` is the number of kills of the long test, `ARMWATCH_SEED` the seed of its random numbers.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::canon::assert_sound;
use crate::small::{self, CYCLES, Export, export, work};
use crate::support::{assert_alike, pass, query, wait_until};

/// Kills of a round before the daemon may finish: enough to hit every phase, few enough for several rounds.
const KILLS_OF_A_ROUND: usize = 25;

/// The kills of a round.
#[derive(Debug, Clone, Copy)]
struct Kills {
    most: usize,
    longest_life: Duration,
}

/// State of every export, to detect the end of a round.
const STATES: &str =
    "SELECT source_name, status, cycles, ifnull(content_hash, '') FROM runs ORDER BY 1, 2, 4";

/// Exports of a round.
struct Material {
    /// Present from the start: plain, compressed, one with a fault in its last cycle, and production logs.
    whole: Vec<Export>,
    /// Written slowly, the second with a fault, the third a production log.
    growing: Vec<Export>,
    /// Present from the start; the first is overwritten with the second when it is stored.
    rewritten: [Export; 2],
    /// Name of a later copy of the first of `whole`.
    copy: String,
    golden: Golden,
}

struct Golden {
    dump: String,
    states: Vec<String>,
}

impl Material {
    fn new() -> Self {
        let whole = vec![
            export("A", 1, 5),
            export("A", 11, 6).gzip(),
            export("A", 12, 7),
            export("B", 2, 5).zstd(),
            export("C", 3, 5).spoiled(),
            // production before the robot's first test, and between its tests
            work("A", 21, 3),
            work("A", 22, 6),
        ];
        let mut material = Self {
            copy: format!("again_{}", whole[0].name),
            whole,
            growing: vec![export("G", 4, 5), export("H", 5, 5).spoiled(), work("A", 23, 8)],
            rewritten: [export("F", 6, 5), export("F", 7, 5)],
            golden: Golden { dump: String::new(), states: Vec::new() },
        };
        material.golden = material.golden();
        material
    }

    /// Result of the one-shot command for the same files, without interruption.
    fn golden(&self) -> Golden {
        let workshop = small::watching_work();
        let [first, second] = &self.rewritten;
        for export in self.whole.iter().chain(&self.growing).chain([first]) {
            workshop.add(export);
        }
        workshop.stdout(&["ingest", "inbox"], 1);
        workshop.add(second);
        fs::copy(workshop.inbox(&self.whole[0].name), workshop.inbox(&self.copy)).expect("copied");
        workshop.stdout(&["ingest", "inbox"], 1);
        let database = workshop.path("armwatch.db");
        let states = query(&database, STATES);
        for (status, count) in [("complete", 9), ("quarantined", 2), ("superseded", 1)] {
            let found = states.iter().filter(|state| state.contains(&format!("|{status}|"))).count();
            assert_eq!(found, count, "{status}: {states:#?}");
        }
        Golden { dump: workshop.canonical_dump(), states }
    }

    /// Runs all writers of a round; returns when all is written, or when the round has ended.
    fn write(&self, inbox: &Path, database: &Path, seed: u64, gone: &AtomicBool) {
        let [first, second] = &self.rewritten;
        for export in self.whole.iter().chain([first]) {
            fs::write(inbox.join(&export.name), &export.bytes).expect("written");
        }
        std::thread::scope(|scope| {
            for (export, seed) in self.growing.iter().zip(seed..) {
                scope.spawn(move || write_slowly(&inbox.join(&export.name), &export.bytes, seed, gone));
            }
            let known = |condition: String| {
                move || query(database, &format!("SELECT 1 FROM runs WHERE {condition}")) == ["1"]
            };
            wait_unless(gone, known(format!("source_name = '{}' AND status = 'complete'", first.name)));
            write_slowly_over(&inbox.join(&second.name), &second.bytes, seed);
            let original = &self.whole[0].name;
            wait_unless(gone, known(format!("source_name = '{original}'")));
            fs::copy(inbox.join(original), inbox.join(&self.copy)).expect("copied");
        });
    }
}

/// Results of the rounds so far. A kill counts once, by the state of the database after it.
#[derive(Debug, Default)]
struct Counts {
    rounds: usize,
    restarts: usize,
    rows_compared: usize,
    before_the_first_run: usize,
    all_cycles_stored_and_run_not_ended: usize,
    run_ended_in_this_life: usize,
    cycle_stored_in_this_life: usize,
    nothing_stored_in_this_life: usize,
    /// Exports that a later life resumed, and their bytes that it did not parse again.
    resumed: usize,
    bytes_passed: u64,
}

impl Counts {
    fn kills(&self) -> usize {
        self.before_the_first_run
            + self.all_cycles_stored_and_run_not_ended
            + self.run_ended_in_this_life
            + self.cycle_stored_in_this_life
            + self.nothing_stored_in_this_life
    }

    /// Counts the positions of resumed reading in a round, from the log of its daemons.
    fn resumed(&mut self, log: &str) {
        let after = |line: &str| {
            line.split_once("resumed at byte ")?.1.split_whitespace().next()?.parse::<u64>().ok()
        };
        for byte in log.lines().filter_map(after) {
            self.resumed += 1;
            self.bytes_passed += byte;
        }
    }

    /// Counts a kill by the runs before the life of the daemon and after it.
    fn kill(&mut self, before: &[String], after: &[String]) {
        let all_stored = format!("|streaming|{CYCLES}|");
        let ended = |runs: &[String]| runs.iter().filter(|run| !run.contains("|streaming|")).count();
        let phase = if after.is_empty() {
            &mut self.before_the_first_run
        } else if after.iter().any(|run| run.contains(&all_stored)) {
            &mut self.all_cycles_stored_and_run_not_ended
        } else if ended(before) != ended(after) {
            &mut self.run_ended_in_this_life
        } else if before != after {
            &mut self.cycle_stored_in_this_life
        } else {
            &mut self.nothing_stored_in_this_life
        };
        *phase += 1;
    }
}

fn round(material: &Arc<Material>, seed: u64, kills: Kills, counts: &mut Counts) {
    let workshop = small::watching_work();
    let (inbox, database) = (workshop.path("inbox"), workshop.path("armwatch.db"));
    let gone = Arc::new(AtomicBool::new(false));
    let writers = std::thread::spawn({
        let (material, inbox, database, gone) =
            (Arc::clone(material), inbox.clone(), database.clone(), Arc::clone(&gone));
        move || material.write(&inbox, &database, seed, &gone)
    });
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let before = counts.kills();
    let states = || if database.exists() { query(&database, STATES) } else { Vec::new() };
    let done = || writers.is_finished() && states() == material.golden.states;
    while counts.kills() - before < kills.most && !done() {
        let runs = states();
        let mut daemon = workshop.daemon();
        counts.restarts += 1;
        live(&mut random, kills.longest_life, &workshop.path("armwatch.db-wal"));
        kill(&mut daemon.child);
        counts.kill(&runs, &states());
        // some are killed before there is a file
        if database.exists() {
            assert_sound(&database, &format!("seed {seed}, kill {}", counts.kills() - before));
        }
    }
    let daemon = workshop.daemon();
    counts.restarts += 1;
    let missing =
        || format!("seed {seed}: {:#?}\nwanted {:#?}", query(&database, STATES), material.golden.states);
    wait_until(done, missing);
    // another scan changes nothing
    workshop.wait_until_idle();
    gone.store(true, Ordering::Relaxed);
    writers.join().expect("the writers");
    daemon.signal("TERM");
    assert_eq!(daemon.end(), Some(0), "seed {seed}");
    let dump = workshop.canonical_dump();
    assert_alike(&dump, &material.golden.dump, &format!("seed {seed}"));
    assert_sound(&database, &format!("seed {seed}, at the end"));
    counts.rows_compared += dump.lines().count();
    counts.rounds += 1;
    counts.resumed(&workshop.log());
}

/// Lets a daemon live for a random time; every third time until just after it has written.
fn live(random: &mut ChaCha8Rng, longest: Duration, log: &Path) {
    let end = Instant::now() + random.random_range(Duration::from_millis(20)..longest);
    if random.random_range(0..3) > 0 {
        pass(end.saturating_duration_since(Instant::now()));
        return;
    }
    // after the start, otherwise the first write of a life would always be the last
    pass(random.random_range(Duration::ZERO..longest / 2));
    let size = || fs::metadata(log).map_or(0, |metadata| metadata.len());
    let before = size();
    while size() == before && Instant::now() < end {
        pass(Duration::from_micros(200));
    }
    pass(random.random_range(Duration::ZERO..Duration::from_millis(8)));
}

fn kill(child: &mut Child) {
    child.kill().expect("it lives until it is killed");
    let status = child.wait().expect("a child");
    assert_eq!(status.code(), None, "the daemon ended by itself: {status}");
}

/// Waits in a writer as long as the kills continue.
fn wait_unless(gone: &AtomicBool, is_so: impl Fn() -> bool) {
    while !gone.load(Ordering::Relaxed) && !is_so() {
        pass(Duration::from_millis(40));
    }
}

/// Appends an export in pieces of random size. Most pauses are shorter than the time to settle.
fn write_slowly(path: &Path, text: &[u8], seed: u64, gone: &AtomicBool) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    let mut rest = text;
    while !rest.is_empty() {
        let (piece, after) = rest.split_at(random.random_range(1..=rest.len().min(text.len() / 25)));
        file.write_all(piece).expect("written");
        rest = after;
        if !gone.load(Ordering::Relaxed) {
            pass(random.random_range(Duration::from_millis(10)..Duration::from_millis(220)));
        }
    }
}

/// Truncates a file and writes another content into it, in a few pieces.
fn write_slowly_over(path: &Path, text: &[u8], seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut file = fs::File::create(path).expect("truncated");
    for piece in text.chunks(text.len() / 4 + 1) {
        file.write_all(piece).expect("written");
        pass(random.random_range(Duration::ZERO..Duration::from_millis(150)));
    }
}

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{variable}={text} is not a whole number")))
}

/// Runs rounds until there were `kills` kills, with a random seed that is printed.
fn rounds(kills: usize) -> Counts {
    let seed = number("ARMWATCH_SEED").unwrap_or_else(rand::random);
    println!("ARMWATCH_SEED={seed}");
    let material = Arc::new(Material::new());
    let mut counts = Counts::default();
    // one or two cycles are stored in these lives, however fast the machine is
    let longest_life = time_to_a_cycle() * 2;
    let start = Instant::now();
    for seed in (0..).map(|round| seed.wrapping_add(1000 * round)) {
        let most = KILLS_OF_A_ROUND.min(kills - counts.kills());
        round(&material, seed, Kills { most, longest_life }, &mut counts);
        println!("{} kills after {:.0?}: {counts:?}", counts.kills(), start.elapsed());
        if counts.kills() >= kills {
            break;
        }
    }
    counts
}

#[test]
fn a_few_kills_change_nothing() {
    rounds(8);
}

#[test]
#[ignore = "takes minutes: 200 kills, or as many as ARMWATCH_KILLS says"]
fn many_kills_change_nothing() {
    let kills = number("ARMWATCH_KILLS").map_or(200, |kills| usize::try_from(kills).expect("a size"));
    let counts = rounds(kills);
    assert!(
        counts.cycle_stored_in_this_life > 0
            && counts.run_ended_in_this_life > 0
            && counts.all_cycles_stored_and_run_not_ended > 0,
        "phases not met: {counts:?}"
    );
    assert!(counts.resumed > 0, "no daemon went on where another one was killed: {counts:?}");
}

/// Time of a daemon on this machine from its start to the first stored cycle of a settled export.
fn time_to_a_cycle() -> Duration {
    let workshop = small::watching_work();
    workshop.add(&export("A", 1, 5));
    let start = Instant::now();
    let _daemon = workshop.daemon();
    workshop.wait_for("SELECT min(count(*), 1) FROM cycles", 1);
    start.elapsed()
}

#[test]
#[ignore = "takes minutes: kills until the daemon is done in spite of them"]
fn a_storm_of_kills_does_not_keep_the_daemon_from_getting_done() {
    const MOST: usize = 400;
    let seed = number("ARMWATCH_SEED").unwrap_or(1);
    let material = Arc::new(Material::new());
    // only a life longer than this can store anything; most are shorter
    let to_a_cycle = time_to_a_cycle();
    let kills = Kills { most: MOST, longest_life: to_a_cycle * 3 / 2 };
    let mut counts = Counts::default();
    round(&material, seed, kills, &mut counts);
    println!("a cycle after {to_a_cycle:.2?}; done after {} kills: {counts:?}", counts.kills());
    assert!(counts.kills() < MOST, "{counts:?}");
}
