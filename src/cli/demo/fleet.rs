//! The demo's arms: test times, planted faults, and exports.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use jiff::civil::Date;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;

use crate::cli::context::CliError;
use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::robot::{JointIndex, Robot};
use armwatch_simulate::arm::fault::{Fault, FaultKind, WornPart};
use armwatch_simulate::error::SimulateError;
use armwatch_simulate::{SimulationSettings, simulate_run};

/// Cycles of a test: the friction map needs six.
pub(super) const CYCLES: u32 = 8;
/// Days of the tests.
const DAYS: i64 = 8;
/// Time when all tests of a day have ended, UTC.
const END_OF_TESTS: SignedDuration = SignedDuration::from_hours(11);
/// Rows per second, Hz: a short test programme at a low rate, so that the demo is soon over.
const SAMPLE_RATE_HZ: f64 = 20.0;
/// Warming in each cycle, s.
const WARMING_S: f64 = 5.0;
/// Most exports in the folder that the daemon has not read yet: about a day's.
const EXPORTS_AHEAD: usize = 8;
/// Pieces of an export that visibly grows: several per cycle.
const PIECES: usize = 30;
/// Time between two pieces: below the settle time, and two seconds for an export.
const PIECE_PAUSE: Duration = Duration::from_millis(60);

/// A fault that is planted in an arm, and the expected kind of its alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Planted {
    pub(super) fault: Fault,
    pub(super) kind: AnomalyKind,
}

impl Planted {
    /// The first test with the fault, from 1.
    pub(super) fn test(&self) -> u32 {
        self.fault.start_run
    }

    /// The planted fault in words.
    pub(super) fn words(&self) -> String {
        match self.fault.kind {
            FaultKind::Wear { rate_per_run, .. } => {
                format!("wear: friction grows by {:.0} % with every test", 100.0 * rate_per_run)
            }
            FaultKind::Step { size, cycle } => {
                format!("step: friction jumps by {:.0} % in cycle {cycle}", 100.0 * size)
            }
            FaultKind::Jitter { size } => {
                format!("jitter: friction varies by {:.0} % from cycle to cycle", 100.0 * size)
            }
            FaultKind::Load { mass, .. } => format!("payload: {mass} kg more at the tool"),
            _ => self.fault.to_string(),
        }
    }
}

/// One of the demo's arms.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct DemoArm {
    pub(super) name: &'static str,
    /// Midnight of the day before the first one, UTC.
    day_zero: Timestamp,
    /// Time of day of its tests.
    time: SignedDuration,
    /// Days of its tests, from 1, in increasing order.
    days: &'static [u32],
    pub(super) planted: Option<Planted>,
}

impl DemoArm {
    pub(super) fn tests(&self) -> u32 {
        u32::try_from(self.days.len()).unwrap_or(u32::MAX)
    }

    /// Start of test `test`, from 1.
    pub(super) fn start(&self, test: u32) -> Option<Timestamp> {
        let day = self.days.get(usize::try_from(test.checked_sub(1)?).ok()?)?;
        Some(self.day_zero + SignedDuration::from_hours(24 * i64::from(*day)) + self.time)
    }

    /// The test that started at `at`.
    pub(super) fn test_at(&self, at: Timestamp) -> Option<u32> {
        (1..=self.tests()).find(|test| self.start(*test) == Some(at))
    }

    /// The arm's settings, with a first start that puts run `test` on its day.
    fn settings(&self, test: u32, seed: u64) -> Option<SimulationSettings> {
        let usual = SimulationSettings::default();
        let since_first = usual.interval.checked_mul(test.checked_sub(1)?)?;
        Some(SimulationSettings {
            robot_name: self.name.into(),
            seed,
            sample_rate_hz: SAMPLE_RATE_HZ,
            cycles: CYCLES,
            warming_s: WARMING_S,
            runs: self.tests(),
            first_start: self.start(test)?.checked_sub(since_first).ok()?,
            faults: self.planted.iter().map(|planted| planted.fault).collect(),
            ..usual
        })
    }
}

/// The arms: five tests each to learn, unless the fault shows without them; then the fault, and time to detect it. They
/// are tested from `first_day` on.
pub(super) fn fleet(first_day: Date) -> Result<Vec<DemoArm>, jiff::Error> {
    let day_zero = first_day.yesterday()?.to_zoned(TimeZone::UTC)?.timestamp();
    let joint = |number: usize| Some(JointIndex::new(number - 1));
    let planted = |kind: FaultKind, joint: Option<JointIndex>, start_run: u32, found_as: AnomalyKind| {
        Some(Planted { fault: Fault { kind, joint, start_run, last_run: None }, kind: found_as })
    };
    let arm = |name, minutes: i64, days, planted| DemoArm {
        name,
        day_zero,
        time: SignedDuration::from_mins(8 * 60 + 47 + minutes),
        days,
        planted,
    };
    let wear = FaultKind::Wear { part: WornPart::All, rate_per_run: 0.05, cap: 1.0 };
    let step = FaultKind::Step { size: 0.25, cycle: 5 };
    let jitter = FaultKind::Jitter { size: 0.12 };
    let load = FaultKind::Load { mass: 0.8, centre: [0.0; 3] };
    Ok(vec![
        arm("Left", 0, &[1, 2, 4, 5, 7, 8], None),
        arm("Middle", 20, &[1, 2, 3, 4, 5, 6, 7, 8], planted(wear, joint(3), 6, AnomalyKind::Drift)),
        arm("Right", 40, &[1, 2, 3, 5, 6, 8], planted(load, None, 6, AnomalyKind::Payload)),
        arm("Front", 60, &[1, 3, 4, 6, 7], planted(step, joint(2), 4, AnomalyKind::Step)),
        arm("Rear", 80, &[1, 2, 4, 5, 6, 7], planted(jitter, joint(5), 6, AnomalyKind::Oscillation)),
    ])
}

/// The first day that puts the last tests on today, or on yesterday if today's would not have ended.
pub(super) fn latest_first_day(now: Timestamp) -> Result<Date, jiff::Error> {
    let last_day = (now - END_OF_TESTS).to_zoned(TimeZone::UTC).date();
    last_day.checked_sub(jiff::Span::new().days(DAYS - 1))
}

/// Arm and number of every test, in the order of their starts.
pub(super) fn schedule(fleet: &[DemoArm]) -> Vec<(DemoArm, u32)> {
    let mut tests: Vec<(DemoArm, u32)> =
        fleet.iter().flat_map(|arm| (1..=arm.tests()).map(|test| (arm.clone(), test))).collect();
    tests.sort_by_key(|(arm, test)| arm.start(*test));
    tests
}

/// Folders of exports.
#[derive(Debug, Clone)]
pub(super) struct DemoFolders {
    /// Folder for unfinished exports.
    pub(super) made: PathBuf,
    /// Truth files.
    pub(super) truth: PathBuf,
    /// The watched folder.
    pub(super) inbox: PathBuf,
}

/// Writes the fleet's exports in the order of their starts, like controllers: the first one piece by piece, so that it
/// is read while it grows; the others appear as a whole. Each takes a permit of `room` permanently, and writing ends
/// when `room` is closed.
pub(super) fn write_exports(
    robot: Robot,
    tests: Vec<(DemoArm, u32)>,
    folders: DemoFolders,
    seed: u64,
    room: Arc<Semaphore>,
) -> JoinHandle<Result<(), CliError>> {
    let runtime = Handle::current();
    tokio::task::spawn_blocking(move || {
        for (place, (arm, test)) in tests.iter().enumerate() {
            let grows = place == 0;
            let settings = arm.settings(*test, seed).ok_or_else(|| beyond_calendar(arm))?;
            let settings =
                SimulationSettings { truth_dir: Some(folders.truth.clone()), gzip: !grows, ..settings };
            if room.is_closed() {
                break;
            }
            let files = simulate_run(&robot, &settings, test - 1, &folders.made, &mut |_| ());
            let export = files.map_err(as_cli_error)?.export;
            let Ok(permit) = runtime.block_on(room.acquire()) else { break };
            permit.forget();
            let target = folders.inbox.join(export.file_name().unwrap_or_default());
            let put = if grows { append_slowly(&export, &target) } else { std::fs::rename(&export, &target) };
            put.map_err(|error| CliError::Io(format!("{}: {error}", target.display())))?;
        }
        // a leftover file does no harm
        let _ = std::fs::remove_dir_all(&folders.made);
        Ok(())
    })
}

/// Permits for the exports that may be in the folder.
pub(super) fn room() -> Arc<Semaphore> {
    Arc::new(Semaphore::new(EXPORTS_AHEAD))
}

fn append_slowly(from: &Path, to: &Path) -> std::io::Result<()> {
    let text = std::fs::read(from)?;
    let mut export = File::options().create_new(true).append(true).open(to)?;
    for piece in text.chunks(text.len() / PIECES + 1) {
        export.write_all(piece)?;
        std::thread::sleep(PIECE_PAUSE);
    }
    std::fs::remove_file(from)
}

fn beyond_calendar(arm: &DemoArm) -> CliError {
    CliError::Internal(format!("the tests of {} are beyond the calendar", arm.name))
}

fn as_cli_error(error: SimulateError) -> CliError {
    match error {
        SimulateError::Write { .. } => CliError::Io(error.to_string()),
        _ => CliError::Internal(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arms() -> Vec<DemoArm> {
        fleet(jiff::civil::date(2026, 1, 5)).unwrap()
    }

    #[test]
    fn the_last_tests_are_the_latest_that_can_have_ended() {
        for (now, first_day) in [
            ("2026-11-28T23:00:00Z", "2026-11-21"),
            ("2026-11-28T11:00:00Z", "2026-11-21"),
            ("2026-11-28T10:59:59Z", "2026-11-20"),
        ] {
            let now: Timestamp = now.parse().unwrap();
            let day = latest_first_day(now).unwrap();
            assert_eq!(day.to_string(), first_day);
            let arms = fleet(day).unwrap();
            let last = arms.iter().filter_map(|arm| arm.start(arm.tests())).max().unwrap();
            assert!(last < now && now.duration_since(last) < SignedDuration::from_hours(26), "{last}");
        }
    }

    #[test]
    fn four_faults_are_planted_after_five_tests_or_inside_one() {
        let planted: Vec<Planted> = arms().iter().filter_map(|arm| arm.planted).collect();
        let mut kinds: Vec<AnomalyKind> = planted.iter().map(|planted| planted.kind).collect();
        kinds.dedup();
        assert_eq!(kinds.len(), 4, "{kinds:?}");
        for arm in arms() {
            assert!(arm.days.is_sorted_by(|a, b| a < b) && arm.days.first() >= Some(&1), "{arm:?}");
            if let Some(planted) = arm.planted {
                assert!(planted.test() <= arm.tests(), "{arm:?}");
                assert!(
                    planted.test() > 5 || matches!(planted.fault.kind, FaultKind::Step { .. }),
                    "{arm:?}"
                );
            }
        }
        assert!(arms().iter().any(|arm| arm.planted.is_none()));
    }

    #[test]
    fn tests_follow_each_other_and_keep_their_numbers() {
        let tests = schedule(&arms());
        let starts: Vec<Timestamp> = tests.iter().filter_map(|(arm, test)| arm.start(*test)).collect();
        assert!(starts.len() == tests.len() && starts.is_sorted_by(|a, b| a < b));
        assert_eq!(starts[0].to_string(), "2026-01-05T08:47:00Z");
        for (arm, test) in &tests {
            let start = arm.start(*test).unwrap();
            assert_eq!(arm.test_at(start), Some(*test));
            let settings = arm.settings(*test, 1).unwrap();
            assert_eq!(settings.first_start + settings.interval * (*test - 1), start);
        }
        assert_eq!(tests[0].0.test_at(starts[1]), None);
    }
}
