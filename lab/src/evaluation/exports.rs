//! Robots whose tests are simulated exports, processed by the whole program: each has its own folder and database.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use jiff::Timestamp;
use tokio_util::sync::CancellationToken;

use crate::evaluate::detectors::{HistoryDetector, LabAlarm};
use crate::evaluate::fleet::DetectorScore;
use crate::evaluate::recorded::{FRICTION_FORMS, JointUnit, RecordedRobot};
use crate::evaluate::scenario::Scenario;
use crate::evaluate::score::{RobotOutcome, Truth, outcome};
use armwatch::cli::context::{CliError, open_store, runtime};
use armwatch::pipeline::context::{Pipeline, Retry};
use armwatch_config::Config;
use armwatch_model::anomaly::Severity;
use armwatch_model::robot::{JointIndex, Robot, StandardParameters};
use armwatch_simulate::arm::fault::{Fault, FaultKind, WornPart};
use armwatch_simulate::arm::friction::FrictionShape;
use armwatch_simulate::arm::hall::HallSettings;
use armwatch_simulate::plan::motion::PerJoint;
use armwatch_simulate::run::record::record;
use armwatch_simulate::run::recording::Clock;
use armwatch_simulate::{SimulationSettings, recording_of_run, simulate_run};
use armwatch_store::{AnomalyRow, Store};

/// Duration of a contact as a share of its cycle, see [`FaultKind::Contact`].
const CONTACT_SHARE: f64 = 0.05;
/// Largest wear, as a fraction of healthy friction.
const WEAR_CAP: f64 = 0.6;
/// Rows per second of the torques that determine an arm's sizes, Hz.
const LOOK_RATE_HZ: f64 = 20.0;
/// Forms of friction, by their number.
const FORMS: [FrictionShape; FRICTION_FORMS] =
    [FrictionShape::Gearbox, FrictionShape::Smooth, FrictionShape::Stiction];

/// Settings of the simulation.
#[derive(Debug, Clone)]
pub(super) struct ExportSettings {
    /// Robots of each scenario.
    pub(super) robots: usize,
    /// Tests of each.
    pub(super) tests: u32,
    /// Seed of all random values.
    pub(super) seed: u64,
    /// Robots at once.
    pub(super) threads: usize,
    /// The scenarios.
    pub(super) scenarios: Vec<Scenario>,
    /// Sizes that replace the drawn ones.
    pub(super) sizes: Vec<(Scenario, f64)>,
}

/// Simulates the fleet, processes its exports and scores the alarms. `on_robot` is called after each robot.
pub(super) fn evaluate_exports(
    settings: &ExportSettings,
    on_robot: &(dyn Fn() + Sync),
) -> Result<DetectorScore, CliError> {
    let total = settings.robots * settings.scenarios.len();
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, Result<RobotOutcome, CliError>)>> = Mutex::new(Vec::with_capacity(total));
    std::thread::scope(|scope| {
        for _ in 0..settings.threads.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= total {
                        return;
                    }
                    let outcome = robot(settings, number);
                    if outcome.is_err() {
                        // robots in progress are finished, further ones are not started
                        next.store(total, Ordering::Relaxed);
                    }
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((number, outcome));
                    on_robot();
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(number, _)| *number);
    let outcomes = done.into_iter().map(|(_, of)| of).collect::<Result<Vec<RobotOutcome>, CliError>>()?;
    let all: Vec<&RobotOutcome> = outcomes.iter().collect();
    Ok(DetectorScore::of(HistoryDetector::Armwatch, &settings.scenarios, &all))
}

/// One robot, tested day after day.
fn robot(settings: &ExportSettings, number: usize) -> Result<RobotOutcome, CliError> {
    let scenario = settings.scenarios[number / settings.robots.max(1)];
    let size = settings.sizes.iter().find(|(of, _)| *of == scenario).map(|(_, size)| *size);
    let mut config = Config::shipped()?;
    let described = config.fleet.first().map(|entry| Robot::clone(&entry.description));
    let described =
        described.ok_or_else(|| CliError::Internal("the shipped configuration describes no robot".into()))?;
    let drawn = RecordedRobot::draw(
        scenario,
        size,
        described.joint_count(),
        settings.tests as usize,
        (settings.seed, number % settings.robots.max(1)),
    );
    let folder = tempfile::Builder::new().prefix("armwatch-evaluate-").tempdir();
    let folder = folder.map_err(|error| CliError::Io(format!("no temporary folder: {error}")))?;
    config.database = folder.path().join("armwatch.db");
    let arm = differing(&described, &drawn.units);
    let simulated = simulation(&arm, &drawn, settings.tests)?;
    runtime()?.block_on(async {
        let store = open_store(&config).await?;
        let pipeline = Pipeline::new(Arc::new(config), store);
        let outcome = watch(&pipeline, &arm, &drawn, &simulated, folder.path()).await;
        pipeline.close().await?;
        outcome
    })
}

/// Simulates one test after the other, processes each and reads the alarms.
async fn watch(
    pipeline: &Pipeline,
    arm: &Robot,
    drawn: &RecordedRobot,
    simulated: &SimulationSettings,
    folder: &Path,
) -> Result<RobotOutcome, CliError> {
    let stop = CancellationToken::new();
    let mut starts = Vec::new();
    // the alarms after each test
    let mut said: Vec<Vec<LabAlarm>> = Vec::new();
    let check = SimulationSettings { cycles: 1, warming_s: 0.0, ..simulated.clone() };
    for run in 0..simulated.runs {
        let usual = if drawn.scenario.is_check(run as usize) { &check } else { simulated };
        let settings = in_run(usual, drawn, run);
        let files = simulate_run(arm, &settings, run, folder, &mut |_| ())
            .map_err(|error| CliError::Internal(error.to_string()))?;
        starts.push(files.started_at);
        pipeline.process(&files.export, Retry::Never, &stop, |_| ()).await?;
        for stale in pipeline.store().stale_robots().await? {
            pipeline.conclude_isolated(&stale.name).await?;
        }
        said.push(alarms(pipeline.store(), &starts).await?);
        let removed = std::fs::remove_file(&files.export).and_then(|()| std::fs::remove_file(&files.truth));
        removed.map_err(|error| CliError::Io(format!("{}: {error}", folder.display())))?;
    }
    let watched = simulated.interval.as_secs_f64() * f64::from(simulated.runs);
    let truth = Truth {
        scenario: drawn.scenario,
        joint: drawn.joint,
        onset: drawn.onset,
        cycle: drawn.cycle,
        size: drawn.size,
        starts,
        years: watched / (365.25 * 86_400.0),
    };
    let last = said.last().cloned().unwrap_or_default();
    Ok(outcome(&truth, &last, |place| said.get(place).cloned().unwrap_or_default()))
}

/// Alarms of the only robot of a database, with indices of the tests that began at `starts`.
async fn alarms(store: &Store, starts: &[Timestamp]) -> Result<Vec<LabAlarm>, CliError> {
    let rows = store.anomalies_after(0).await?;
    Ok(rows.iter().filter(|row| row.severity >= Severity::Warning).map(|row| alarm(row, starts)).collect())
}

fn alarm(row: &AnomalyRow, starts: &[Timestamp]) -> LabAlarm {
    let place = |at: Timestamp| starts.iter().rposition(|start| *start <= at).unwrap_or(0);
    let first = place(row.first_seen_at);
    LabAlarm {
        kind: row.kind,
        joint: row.joint,
        first,
        last: place(row.last_seen_at),
        severity: row.severity,
        odds: row.odds.unwrap_or(0.0),
        onset: (row.onset_at.map_or(first, place), row.onset_cycle),
        value: row.value.unwrap_or(f64::NAN),
    }
}

/// The described arm with individual differences.
fn differing(described: &Robot, units: &[JointUnit]) -> Robot {
    let mut arm = described.clone();
    for (joint, unit) in arm.joints.iter_mut().zip(units) {
        if let Some(nominal) = &mut joint.nominal {
            nominal.inertial = StandardParameters(nominal.inertial.0.map(|of| of * unit.inertial));
            nominal.friction = nominal.friction.map(|of| of * unit.friction);
            nominal.warm_up.b *= unit.cold;
            nominal.warm_up.c *= unit.cold;
            nominal.warm_up.t1 *= unit.warm_up_time;
            nominal.warm_up.t2 *= unit.warm_up_time;
            nominal.torque_noise *= unit.noise;
        }
    }
    arm
}

/// Settings of one run, from 0, of a robot with these usual ones: the tool that it carries, its speed and its rate.
fn in_run(usual: &SimulationSettings, drawn: &RecordedRobot, run: u32) -> SimulationSettings {
    let mut settings = usual.clone();
    let mass = drawn.size * drawn.scenario.tool(run as usize);
    if mass > 0.0 {
        let kind = FaultKind::Load { mass, centre: [0.0; 3] };
        settings.faults.push(Fault { kind, joint: None, start_run: run + 1, last_run: Some(run + 1) });
    }
    (settings.speed, settings.sample_rate_hz) = drawn.speed_and_rate(run);
    settings
}

/// Settings of its simulation, with the fault of its scenario.
fn simulation(arm: &Robot, drawn: &RecordedRobot, tests: u32) -> Result<SimulationSettings, CliError> {
    use Scenario as S;
    let season = matches!(drawn.scenario, S::Season | S::WideSeason);
    let is_weekly = season || matches!(drawn.scenario, S::ToolPlan | S::Override | S::DayScatter);
    let days = if is_weekly { 7 } else { 1 };
    let mut settings = SimulationSettings {
        robot_name: "R01".into(),
        seed: drawn.seed,
        sample_rate_hz: drawn.sample_rate_hz,
        clock: if drawn.clock_jitter > 0.0 { Clock::Jittering(drawn.clock_jitter) } else { Clock::Even },
        cycles: u32::try_from(drawn.cycles).unwrap_or(u32::MAX),
        warming_s: drawn.warming_s,
        runs: tests,
        // rates of false alarms are of a year
        interval: Duration::from_secs(days * 24 * 3600),
        hall: HallSettings { season_k: if season { drawn.size } else { 0.0 }, day_k: 0.0 },
        friction_day: drawn.friction_day,
        ambient_std_k: drawn.hall_k,
        friction: FORMS[drawn.friction_form],
        ..SimulationSettings::default()
    };
    settings.faults = fault(arm, drawn, &settings)?.into_iter().collect();
    Ok(settings)
}

/// The fault of a robot's scenario; `None` if there is none.
fn fault(
    arm: &Robot,
    drawn: &RecordedRobot,
    settings: &SimulationSettings,
) -> Result<Option<Fault>, CliError> {
    use Scenario as S;
    let size = drawn.size;
    let number = |of: usize| u32::try_from(of + 1).unwrap_or(u32::MAX);
    let start_run = number(drawn.onset);
    let always = |kind: FaultKind| {
        let joint = (!matches!(kind, FaultKind::Load { .. })).then(|| JointIndex::new(drawn.joint));
        Some(Fault { kind, joint, start_run, last_run: None })
    };
    let wear = |part| FaultKind::Wear { part, rate_per_run: size, cap: WEAR_CAP };
    let load = |mass| FaultKind::Load { mass, centre: [0.0; 3] };
    Ok(match drawn.scenario {
        S::Healthy | S::Hall | S::Season | S::ShortTests | S::LongTests | S::MixedTests => None,
        S::WideSeason | S::ToolPlan | S::Override | S::DayScatter => None,
        S::WearByTest => always(wear(WornPart::All)),
        S::WearCoulomb => always(wear(WornPart::Coulomb)),
        S::WearViscous => always(wear(WornPart::Viscous)),
        S::WearLinear => always(wear(WornPart::Linear)),
        S::StepBetween => always(FaultKind::Step { size, cycle: 1 }),
        S::StepInside | S::StepInBaseline => always(FaultKind::Step { size, cycle: number(drawn.cycle) }),
        // a load that is removed was present before
        S::Payload if size < 0.0 => {
            Some(Fault { kind: load(-size), joint: None, start_run: 1, last_run: Some(start_run - 1) })
        }
        S::Payload => always(load(size)),
        S::Jitter => always(FaultKind::Jitter { size }),
        S::WarmUp => always(FaultKind::WarmUp { factor: size }),
        S::Lubricant => {
            Some(Fault { kind: FaultKind::WarmUp { factor: size }, joint: None, start_run, last_run: None })
        }
        S::TorqueOffset => {
            let noise = arm.joints[drawn.joint].nominal.map_or(0.0, |nominal| nominal.torque_noise);
            always(FaultKind::Offset { torque: size * noise })
        }
        S::TorqueGain => always(FaultKind::Gain { size }),
        S::TorqueNoise => always(FaultKind::Noise { factor: size }),
        S::ZeroPosition => always(FaultKind::Zero { position: size }),
        S::Contact => {
            let [rms, _] = torques(arm, drawn.joint, settings)?;
            let kind =
                FaultKind::Contact { torque: size * rms / CONTACT_SHARE.sqrt(), cycle: number(drawn.cycle) };
            Some(Fault {
                kind,
                joint: Some(JointIndex::new(drawn.joint)),
                start_run,
                last_run: Some(start_run),
            })
        }
        S::Backlash => always(FaultKind::Backlash { play: size }),
        S::Ripple => always(FaultKind::Ripple { rate_per_run: size }),
        S::StuckTorque => always(FaultKind::Stuck),
        S::SaturatedTorque => {
            let [_, largest] = torques(arm, drawn.joint, settings)?;
            always(FaultKind::Saturation { torque: size * largest })
        }
        S::LateTorque => always(FaultKind::Delay { seconds: size }),
        S::Weekend | S::Repair | S::Wear | S::CoupledJitter => {
            return Err(CliError::Internal(format!("{} is not simulated as exports", drawn.scenario.name())));
        }
    })
}

/// RMS and largest magnitude of a joint's torque over a healthy cycle, Nm (N).
fn torques(arm: &Robot, joint: usize, settings: &SimulationSettings) -> Result<[f64; 2], CliError> {
    let look = SimulationSettings {
        cycles: 1,
        sample_rate_hz: LOOK_RATE_HZ,
        faults: Vec::new(),
        ..settings.clone()
    };
    let failed = |error: String| CliError::Internal(error);
    let recording = recording_of_run(arm, &look, 0).map_err(|error| failed(error.to_string()))?;
    let (mut squares, mut largest, mut rows) = (0.0, 0.0_f64, 0_u32);
    let mut take = |torque: &PerJoint| {
        squares += torque[joint].powi(2);
        largest = largest.max(torque[joint].abs());
        rows += 1;
    };
    record(&recording, look.seed, 0, |row| {
        take(&row.torque);
        Ok::<(), std::convert::Infallible>(())
    })
    .map_err(|error| failed(error.to_string()))?;
    Ok([(squares / f64::from(rows.max(1))).sqrt(), largest])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(scenario: Scenario, size: Option<f64>) -> ExportSettings {
        ExportSettings {
            robots: 1,
            tests: 10,
            seed: 3,
            threads: 1,
            scenarios: vec![scenario],
            sizes: size.map(|size| (scenario, size)).into_iter().collect(),
        }
    }

    #[test]
    fn every_scenario_of_exports_has_its_fault_on_its_joint_from_its_test_on() {
        let arm = armwatch_testing::er3a();
        for scenario in Scenario::ALL.into_iter().filter(|of| of.has_exports()) {
            let drawn = RecordedRobot::draw(scenario, None, 6, 10, (1, 0));
            let arm = differing(&arm, &drawn.units);
            let simulated = simulation(&arm, &drawn, 10).unwrap();
            assert_eq!(simulated.faults.len(), usize::from(scenario.kind().is_some()), "{}", scenario.name());
            for fault in &simulated.faults {
                let begins = fault.start_run == drawn.onset as u32 + 1;
                assert!(begins || fault.last_run == Some(drawn.onset as u32), "{fault}");
                assert!(
                    fault.joint.is_none() || fault.joint == Some(JointIndex::new(drawn.joint)),
                    "{fault}"
                );
            }
        }
    }

    #[test]
    fn a_large_load_is_found_through_exports_with_its_mass() {
        let score = evaluate_exports(&settings(Scenario::Payload, Some(2.0)), &|| ()).unwrap();
        let of = &score.scenarios[0];
        assert_eq!(
            (of.detected, of.right_kind, of.right_joint, of.right_figure),
            (1, 1, 1, (1, 1)),
            "{of:?}"
        );
    }
}
