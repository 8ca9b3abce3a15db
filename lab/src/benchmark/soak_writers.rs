//! Robots that write exports without pause, many times as fast as recorded.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};

use armwatch::cli::context::CliError;
use armwatch::cli::shared::shipped_robot::shipped_robot;
use armwatch_simulate::{SimulationSettings, simulate_run};

/// Simulated tests; all others are copies with another first row.
const DISTINCT: u32 = 8;
/// Start of the first test; each test of a robot is a day later than the one before.
const FIRST_START: &str = "2026-01-05T08:47:00Z";
/// Exports of a robot that stay in the folder; older ones are deleted, like by the controller that wrote them.
const KEPT_EXPORTS: usize = 50;

/// A simulated test.
struct SimulatedTest {
    header: Vec<u8>,
    first_row: String,
    others: Vec<u8>,
    recorded: Duration,
}

/// A test that is written to its end.
pub(super) struct WrittenTest {
    /// Name of its file.
    pub(super) name: String,
    /// When it was marked as ended.
    pub(super) at: Instant,
}

/// Running robots.
pub(super) struct Writers {
    inbox: PathBuf,
    origins: Vec<SimulatedTest>,
    robots: Vec<SoakRobot>,
    speed: f64,
    /// When they began, at the first call of [`Writers::write`].
    began: Option<Instant>,
    /// Written recording time, s.
    pub(super) recorded_s: f64,
}

struct SoakRobot {
    name: String,
    tests: u32,
    /// When the next test begins: at the end of the one before by the robot's speed, not when that was noticed.
    next: Option<Instant>,
    open: Option<OpenExport>,
    /// Exports in the folder, oldest first.
    lying: VecDeque<PathBuf>,
}

struct OpenExport {
    path: PathBuf,
    file: File,
    text: Vec<u8>,
    written: usize,
    began: Instant,
    recorded: Duration,
}

/// Robots and how they write.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pace {
    /// Robots.
    pub(super) robots: u32,
    /// Cycles of each test.
    pub(super) cycles: u32,
    /// Rows per second of recording, Hz.
    pub(super) rate_hz: f64,
    /// Ratio of recording time to writing time.
    pub(super) speed: f64,
}

impl Writers {
    /// Simulates the tests that are then written into `inbox`.
    pub(super) fn new(folder: &Path, inbox: PathBuf, pace: Pace) -> Result<Self, CliError> {
        let first_start: Timestamp =
            FIRST_START.parse().map_err(|error| CliError::Internal(format!("{FIRST_START}: {error}")))?;
        let settings = SimulationSettings {
            cycles: pace.cycles,
            warming_s: 5.0,
            sample_rate_hz: pace.rate_hz,
            first_start,
            ..SimulationSettings::default()
        };
        let robot = shipped_robot()?;
        let mut origins = Vec::new();
        for run in 0..DISTINCT {
            let made = simulate_run(&robot, &settings, run, &folder.join("origins"), &mut |_| ());
            let made = made.map_err(|error| CliError::Usage(error.to_string()))?;
            origins.push(origin(&made.export, pace.rate_hz)?);
        }
        std::fs::create_dir_all(&inbox).map_err(|error| named(&inbox, &error))?;
        let robot = |number| SoakRobot {
            name: format!("R{number:02}"),
            tests: 0,
            next: None,
            open: None,
            lying: VecDeque::new(),
        };
        let robots = (1..=pace.robots).map(robot).collect();
        Ok(Self { inbox, origins, robots, speed: pace.speed, began: None, recorded_s: 0.0 })
    }

    /// Number of started tests.
    pub(super) fn tests(&self) -> u32 {
        self.robots.iter().map(|robot| robot.tests).sum()
    }

    /// When a robot starts its first test: the starts are spread over the duration of one test, since robots of a plant
    /// do not end theirs together.
    fn first_begin(&self, place: usize) -> Duration {
        let of_a_test = self.origins[0].recorded.as_secs_f64() / self.speed;
        Duration::from_secs_f64(of_a_test * place as f64 / self.robots.len() as f64)
    }

    /// Lets every robot write the rows recorded by now; returns the tests that ended.
    pub(super) fn write(&mut self) -> Result<Vec<WrittenTest>, CliError> {
        let began = *self.began.get_or_insert_with(Instant::now);
        let mut written = Vec::new();
        for place in 0..self.robots.len() {
            if self.robots[place].tests == 0 && began.elapsed() < self.first_begin(place) {
                continue;
            }
            if self.robots[place].open.is_none() {
                self.begin(place)?;
            }
            let robot = &mut self.robots[place];
            let Some(open) = &mut robot.open else { continue };
            let share = self.speed * open.began.elapsed().as_secs_f64() / open.recorded.as_secs_f64();
            let end = ((share * open.text.len() as f64) as usize).min(open.text.len());
            let failed = |error: std::io::Error| named(&open.path, &error);
            open.file.write_all(&open.text[open.written..end]).map_err(failed)?;
            open.written = end;
            if end < open.text.len() {
                continue;
            }
            let Some(open) = robot.open.take() else { continue };
            robot.next = Some(open.began + open.recorded.div_f64(self.speed));
            let mut mark = open.path.clone().into_os_string();
            mark.push(".done");
            std::fs::write(&mark, "").map_err(|error| named(Path::new(&mark), &error))?;
            self.recorded_s += open.recorded.as_secs_f64();
            let name = open.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            written.push(WrittenTest { name, at: Instant::now() });
            robot.lying.push_back(open.path);
            if robot.lying.len() > KEPT_EXPORTS
                && let Some(oldest) = robot.lying.pop_front()
            {
                std::fs::remove_file(&oldest).map_err(|error| named(&oldest, &error))?;
                let mark = oldest.with_extension("csv.done");
                std::fs::remove_file(&mark).map_err(|error| named(&mark, &error))?;
            }
        }
        Ok(written)
    }

    fn begin(&mut self, place: usize) -> Result<(), CliError> {
        let robot = &mut self.robots[place];
        let origin = &self.origins[robot.tests as usize % self.origins.len()];
        let first: Timestamp =
            FIRST_START.parse().map_err(|error| CliError::Internal(format!("{FIRST_START}: {error}")))?;
        let started = first + SignedDuration::from_hours(24 * i64::from(robot.tests));
        let path = self.inbox.join(format!("{}_{}_soak.csv", robot.name, started.strftime("%Y%m%d_%H%M")));
        let mut text = origin.header.clone();
        // another first position, by less than the encoder resolution: another content
        let mut cells: Vec<String> = origin.first_row.split(',').map(str::to_owned).collect();
        if let Some(cell) = cells.get_mut(1) {
            cell.push_str(&format!("{:02}{:06}", place, robot.tests));
        }
        text.extend(cells.join(",").as_bytes());
        text.push(b'\n');
        text.extend(&origin.others);
        let file = OpenOptions::new().create_new(true).append(true).open(&path);
        let file = file.map_err(|error| named(&path, &error))?;
        robot.tests += 1;
        let began = robot.next.unwrap_or_else(Instant::now);
        robot.open = Some(OpenExport { path, file, text, written: 0, began, recorded: origin.recorded });
        Ok(())
    }
}

fn origin(export: &Path, rate_hz: f64) -> Result<SimulatedTest, CliError> {
    let text = std::fs::read_to_string(export).map_err(|error| named(export, &error))?;
    let parts = text.split_once('\n').and_then(|(header, rows)| Some((header, rows.split_once('\n')?)));
    let (header, (first_row, others)) =
        parts.ok_or_else(|| CliError::Internal(format!("{}: no rows", export.display())))?;
    let rows = 1 + others.lines().count();
    Ok(SimulatedTest {
        header: format!("{header}\n").into_bytes(),
        first_row: first_row.to_owned(),
        others: others.as_bytes().to_vec(),
        recorded: Duration::from_secs_f64(rows as f64 / rate_hz),
    })
}

fn named(path: &Path, error: &std::io::Error) -> CliError {
    CliError::Io(format!("{}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_write_tests_of_their_own_and_mark_their_ends() {
        let folder = tempfile::tempdir().expect("a folder");
        let inbox = folder.path().join("inbox");
        let pace = Pace { robots: 2, cycles: 1, rate_hz: 20.0, speed: 1e12 };
        let mut writers = Writers::new(folder.path(), inbox.clone(), pace).expect("robots");
        let mut names: Vec<String> = Vec::new();
        while names.len() < 2 * KEPT_EXPORTS + 6 {
            for written in writers.write().expect("written") {
                assert!(inbox.join(format!("{}.done", written.name)).exists(), "{}", written.name);
                names.push(written.name);
            }
        }
        assert_eq!(writers.tests(), 2 * KEPT_EXPORTS as u32 + 6);
        assert!(writers.recorded_s > 100.0, "{}", writers.recorded_s);
        // all have distinct names and contents, and the oldest are gone
        let lying: Vec<PathBuf> = std::fs::read_dir(&inbox)
            .expect("exports")
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.extension().is_some_and(|end| end == "csv"))
            .collect();
        assert_eq!(lying.len(), 2 * KEPT_EXPORTS);
        let mut texts: Vec<Vec<u8>> = lying.iter().map(|path| std::fs::read(path).expect("text")).collect();
        texts.sort();
        texts.dedup();
        assert_eq!(texts.len(), lying.len());
    }

    #[test]
    fn a_robot_keeps_its_pace_whenever_the_end_of_a_test_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let pace = Pace { robots: 1, cycles: 1, rate_hz: 20.0, speed: 1e4 };
        let mut writers = Writers::new(folder.path(), folder.path().join("inbox"), pace).expect("robots");
        // number of each test and when it began
        let mut begins: Vec<(usize, Instant)> = Vec::new();
        let mut ended = 0;
        while ended < 4 {
            ended += writers.write().expect("written").len();
            let robot = &writers.robots[0];
            begins.extend(robot.open.as_ref().map(|open| (robot.tests as usize, open.began)));
            std::thread::sleep(Duration::from_millis(3));
        }
        begins.dedup();
        let (first, last) = (begins[0], begins[begins.len() - 1]);
        let recorded: Duration = (first.0..last.0).map(|test| writers.origins[test - 1].recorded).sum();
        let error = (last.1 - first.1).abs_diff(recorded.div_f64(1e4));
        assert!(last.0 >= first.0 + 2 && error < Duration::from_micros(1), "{begins:?}: {error:?}");
    }
}
