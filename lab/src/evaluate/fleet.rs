//! Fleets: many robots of each scenario, on all cores.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::arm::LabArm;
use super::design::Design;
use super::detectors::HistoryDetector;
use super::draws::Draws;
use super::history::{History, history};
use super::scenario::Scenario;
use super::score::{RobotOutcome, ScenarioScore, Truth, macro_f1, outcome};
use armwatch_method::NumericsError;

/// Designs of arms in a fleet; robots of one design differ individually.
const DESIGNS: usize = 24;
/// Streams of random numbers of the robots begin here; designs have the earlier ones.
const FIRST_ROBOT: u64 = 1 << 32;

/// A fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetSettings {
    /// Robots of each scenario.
    pub robots: usize,
    /// Years of each robot's history.
    pub years: f64,
    /// Seed of all random values.
    pub seed: u64,
    /// The scenarios.
    pub scenarios: Vec<Scenario>,
    /// Sizes of events that replace the drawn ones, in the unit of [`Scenario::size`].
    pub sizes: Vec<(Scenario, f64)>,
    /// Threads.
    pub threads: usize,
}

/// Scores of one detector on a fleet.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectorScore {
    /// The detector.
    pub detector: HistoryDetector,
    /// One entry per scenario.
    pub scenarios: Vec<ScenarioScore>,
    /// See [`macro_f1`].
    pub macro_f1: f64,
}

/// Draws a fleet and evaluates every detector on it. The same settings give the same scores for any number of threads.
/// `on_robot` is called after each robot.
///
/// # Errors
/// [`NumericsError`] if a drawn design has no base parameters.
pub fn evaluate(
    settings: &FleetSettings,
    on_robot: &(dyn Fn() + Sync),
) -> Result<Vec<DetectorScore>, NumericsError> {
    let count = DESIGNS.min(settings.robots.max(1));
    let designs = (0..count)
        .map(|of| Design::draw(&mut Draws::new(settings.seed, of as u64)))
        .collect::<Result<Vec<Design>, NumericsError>>()?;
    let total = settings.robots * settings.scenarios.len();
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, Vec<RobotOutcome>)>> = Mutex::new(Vec::with_capacity(total));
    std::thread::scope(|scope| {
        for _ in 0..settings.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= total {
                        return;
                    }
                    let outcomes = robot(settings, &designs, number);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((number, outcomes));
                    on_robot();
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(number, _)| *number);
    Ok(HistoryDetector::ALL
        .into_iter()
        .enumerate()
        .map(|(place, detector)| {
            let all: Vec<&RobotOutcome> = done.iter().map(|(_, of)| &of[place]).collect();
            DetectorScore::of(detector, &settings.scenarios, &all)
        })
        .collect())
}

impl DetectorScore {
    /// Computes the scores from the outcomes of robots with any of `scenarios`.
    pub fn of(detector: HistoryDetector, scenarios: &[Scenario], all: &[&RobotOutcome]) -> Self {
        let of = |scenario: Scenario| {
            let own: Vec<&RobotOutcome> = all.iter().copied().filter(|of| of.scenario == scenario).collect();
            ScenarioScore::of(scenario, &own)
        };
        Self {
            detector,
            scenarios: scenarios.iter().map(|scenario| of(*scenario)).collect(),
            macro_f1: macro_f1(all),
        }
    }
}

/// One robot with all detectors.
fn robot(settings: &FleetSettings, designs: &[Design], number: usize) -> Vec<RobotOutcome> {
    let history = drawn(settings, designs, number);
    let truth = Truth::from(&history);
    let of = |detector: HistoryDetector| {
        let first_said = |place: usize| detector.alarms(&history.runs[..=place]);
        outcome(&truth, &detector.alarms(&history.runs), first_said)
    };
    HistoryDetector::ALL.map(of).to_vec()
}

/// The history of robot `number`; robots are numbered scenario after scenario.
pub(super) fn drawn(settings: &FleetSettings, designs: &[Design], number: usize) -> History {
    let scenario = settings.scenarios[number / settings.robots.max(1)];
    let (arm, mut draws) = drawn_arm(settings, designs, number);
    let size = settings.sizes.iter().find(|(of, _)| *of == scenario).map(|(_, size)| *size);
    history(arm, scenario, size, settings.years, &mut draws)
}

/// The arm of that robot, and the random numbers for its event.
pub(super) fn drawn_arm<'a>(
    settings: &FleetSettings,
    designs: &'a [Design],
    number: usize,
) -> (LabArm<'a>, Draws) {
    let scenario = settings.scenarios[number / settings.robots.max(1)];
    // a scenario's robots do not depend on the other requested scenarios
    let own = Scenario::ALL.iter().position(|of| *of == scenario).unwrap_or(0);
    let unit = number % settings.robots.max(1);
    let stream = FIRST_ROBOT * (1 + own as u64) + unit as u64;
    let mut draws = Draws::new(settings.seed, stream);
    let arm = LabArm::draw(&designs[unit % designs.len()], &mut draws);
    (arm, draws)
}
