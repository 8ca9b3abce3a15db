//! The folders of a row of the matrix, and its runs.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::small::{Export, export};
use crate::support::{Workshop, pass, query};

/// Longest wait for the runs of a row; all rows share two cores.
const PATIENCE: Duration = Duration::from_secs(90);

/// Time without a change until a file is settled.
pub const SETTLE: Duration = Duration::from_millis(400);

/// The runs of all rows, queried a few times per second for all of them.
pub struct Watched {
    database: PathBuf,
    runs: Mutex<HashMap<String, Vec<String>>>,
}

impl Watched {
    pub fn new(workshop: &Workshop) -> Self {
        Self { database: workshop.path("armwatch.db"), runs: Mutex::default() }
    }

    pub fn look_until(&self, end: &AtomicBool) {
        while !end.load(Ordering::Relaxed) {
            self.look();
            pass(Duration::from_millis(150));
        }
    }

    pub fn look(&self) {
        let all = query(
            &self.database,
            "SELECT runs.status, runs.cycles, ifnull(runs.reason, ''), source_path
             FROM runs JOIN run USING (run_id) ORDER BY 1, 2, 3",
        );
        let mut runs: HashMap<String, Vec<String>> = HashMap::new();
        for run in all {
            let (state, path) = run.rsplit_once('|').expect("four cells");
            let row = path.split('/').find(|part| part.starts_with("row_")).unwrap_or_default();
            runs.entry(row.to_owned()).or_default().push(state.to_owned());
        }
        *self.runs.lock().expect("nobody fails with it") = runs;
    }
}

/// The folders of a row and its recordings.
pub struct Stage<'a> {
    workshop: &'a Workshop,
    watched: &'a Watched,
    number: usize,
}

impl<'a> Stage<'a> {
    pub fn new(workshop: &'a Workshop, watched: &'a Watched, number: usize) -> Self {
        let stage = Self { workshop, watched, number };
        fs::create_dir_all(stage.path("")).expect("a folder");
        fs::create_dir_all(stage.outside("")).expect("a folder");
        stage
    }

    fn key(&self) -> String {
        format!("row_{}", self.number)
    }

    /// A path in the watched folder of the row.
    pub fn path(&self, name: impl AsRef<OsStr>) -> PathBuf {
        self.workshop.path("inbox").join(self.key()).join(Path::new(name.as_ref()))
    }

    /// A path that is not watched, on the same file system.
    pub fn outside(&self, name: impl AsRef<OsStr>) -> PathBuf {
        self.workshop.path("outside").join(self.key()).join(Path::new(name.as_ref()))
    }

    /// A watched folder that does not exist at first.
    pub fn watched(&self, folder: &str) -> PathBuf {
        self.workshop.path(folder)
    }

    pub fn row_in(&self, folder: &Path) -> PathBuf {
        folder.join(self.key())
    }

    /// The row's recording of a day: two cycles that no other row has.
    pub fn export(&self, day: u32) -> Export {
        let robot = format!("R{:02}", self.number);
        let whole = export("M", 9, 5);
        let lines = whole.lines();
        let cycle = |line: &[u8]| line.rsplit(|byte| *byte == b',').nth(2) == Some(b"3");
        let mut bytes = lines.iter().filter(|line| !cycle(line)).copied().collect::<Vec<_>>().concat();
        // a digit far after the decimal point of the first time makes it different from the others
        let first = lines[0].len() + lines[1].iter().position(|byte| *byte == b',').expect("a comma");
        let mark = format!("{:03}{day:02}", self.number);
        bytes.splice(first..first, mark.into_bytes());
        Export { name: format!("{robot}_202601{day:02}_0847_x.csv"), bytes }
    }

    /// Writes an export at once.
    pub fn put(&self, export: &Export) -> PathBuf {
        let path = self.path(&export.name);
        fs::write(&path, &export.bytes).expect("written");
        path
    }

    /// Status, cycles and reason of each run of the row.
    pub fn runs(&self) -> Vec<String> {
        let runs = self.watched.runs.lock().expect("nobody fails with it");
        runs.get(&self.key()).cloned().unwrap_or_default()
    }

    /// Returns true if the runs are as wanted, in any order: each `status|cycles|` and a part of the reason.
    pub fn is(&self, wanted: &[&str]) -> bool {
        let runs = self.runs();
        let fits = |run: &String, wanted: &str| {
            let (state, says) = wanted.rsplit_once('|').expect("three cells");
            run.strip_prefix(state).is_some_and(|reason| reason.starts_with('|') && reason.contains(says))
        };
        runs.len() == wanted.len() && wanted.iter().all(|wanted| runs.iter().any(|run| fits(run, wanted)))
    }

    /// Waits until the runs are as wanted; returns true if they are.
    pub fn becomes(&self, wanted: &[&str]) -> bool {
        self.becomes_one_of(&[wanted])
    }

    fn becomes_one_of(&self, wanted: &[&[&str]]) -> bool {
        let start = Instant::now();
        while !wanted.iter().any(|wanted| self.is(wanted)) {
            if start.elapsed() > PATIENCE {
                return false;
            }
            pass(Duration::from_millis(50));
        }
        true
    }

    /// Waits until the runs are as wanted before the row continues.
    pub fn wait(&self, wanted: &[&str]) {
        assert!(self.becomes(wanted), "wanted {wanted:?} in between, found {:?}", self.runs());
    }

    /// Waits until the first cycle is stored, or both after a pause on a busy machine.
    pub fn wait_for_a_cycle(&self) {
        let runs: [&[&str]; 2] = [&["streaming|1|"], &["complete|2|"]];
        assert!(self.becomes_one_of(&runs), "no cycle, but {:?}", self.runs());
    }

    /// Waits until the daemon has scanned the present files, and again after they have settled.
    pub fn pause(&self) {
        self.workshop.wait_for_looks_over(2 * SETTLE);
    }
}

/// Appends to a file in `pieces`, with a pause after each.
pub fn append_slowly(path: &Path, bytes: &[u8], pieces: usize, pause: Duration) {
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    for piece in bytes.chunks(bytes.len() / pieces + 1) {
        file.write_all(piece).expect("written");
        pass(pause);
    }
}
