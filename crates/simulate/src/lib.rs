//! Exports of a virtual arm: known motion, dynamics, friction and faults.
//!
//! Nothing here uses the identifier's formulas, so that one checks the other.

pub mod error;
pub mod plan;
pub mod arm;
pub mod run;
pub mod files;
mod settings;
#[cfg(test)]
mod test_arms;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::{fs, io};

use jiff::Timestamp;
use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use self::arm::dynamics::rigid_chain;
use self::arm::fault::in_run::RunFaults;
use self::arm::fault::{Fault, Wear, loads, ripple, warm_up_factor, wear};
use self::arm::friction::{JointFriction, RippleOrder, ThermalState, joint_friction};
use self::arm::load::Load;
use self::arm::unit::unit;
use self::files::export::{ExportWriter, column_count};
use self::plan::trajectory::{PlanSettings, plan_cycle};
use self::run::record::record;
use self::run::recording::{Heating, RecordedRow, Recording};
use self::run::servo::Servo;
use self::run::truth::{CycleTruth, FaultTruth, JointTruth, LoadTruth, RippleTruth, RunTruth, write_truth};

pub use self::settings::SimulationSettings;
use crate::error::SimulateError;
use armwatch_model::robot::{Coupling, Joint, JointIndex, MAX_JOINTS, NominalJoint, Robot, WarmUpShape};

/// Rows between two reports of progress.
const PROGRESS_ROWS: u64 = 10_000;

/// Random stream of the daily scatter of friction, far from those of runs, cycles and individual arms.
const DAY_STREAM: u64 = 1 << 42;
/// Speed of the rise of friction in the truth, as a fraction of the largest: that of thesis Table N.1.
const WEAR_SPEED: f64 = 0.6;

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimulationProgress {
    /// Cycle being written, from 1.
    pub cycle: u32,
    /// Total number of cycles.
    pub cycles: u32,
    /// Rows written.
    pub rows: u64,
    /// Total number of rows.
    pub rows_total: u64,
}

/// Files of a simulated run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunFiles {
    /// The export.
    pub export: PathBuf,
    /// Its truth file.
    pub truth: PathBuf,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// Rows without the header.
    pub rows: u64,
}

/// Writes the export of run `run_index`, counted from 0, and its truth file.
///
/// The truth file is complete before the export appears; for a growing export, when the export has ended. The folder
/// `out_dir` is created if it is missing. `progress` is called every ten thousand rows and at the end; for a growing
/// export ten times per second of its time, when the rows until then are in the file.
///
/// # Errors
/// [`SimulateError`]: a description that cannot be simulated, a setting out of range, a file that cannot be written. No
/// partial export is left behind, except a growing one.
pub fn simulate_run(
    robot: &Robot,
    settings: &SimulationSettings,
    run_index: u32,
    out_dir: &Path,
    progress: &mut dyn FnMut(SimulationProgress),
) -> Result<RunFiles, SimulateError> {
    settings::check(robot, settings)?;
    let started_at = start_of_run(settings, run_index)?;
    let robot = &drawn_unit(robot, settings);
    let recording = recording_of_unit(robot, settings, run_index)?;
    let stem = file_stem(robot.joint_count(), settings, started_at);
    let export = out_dir.join(format!("{stem}.csv{}", if settings.gzip { ".gz" } else { "" }));
    let truth_dir = settings.truth_dir.as_deref().unwrap_or(out_dir);
    let truth = truth_dir.join(format!("{stem}.truth.json"));
    for folder in [out_dir, truth_dir] {
        fs::create_dir_all(folder).map_err(|source| write_error(folder, source))?;
    }
    let writer = match &settings.format {
        Some(format) => ExportWriter::create_in(&export, format.clone()),
        None => ExportWriter::create_with(&export, robot.joint_count(), settings.temperatures.columns),
    };
    let mut writer = writer.map_err(|e| write_error(&export, e))?.with_offsets_of(robot);
    if settings.grows {
        writer.show().map_err(|e| write_error(&export, e))?;
    }
    let cycle_truth = write_rows(&recording, settings, run_index, &mut writer, progress)
        .map_err(|e| write_error(&export, e))?;
    let run_truth = run_truth(robot, settings, &recording, run_index, &export, cycle_truth)?;
    write_truth(&truth, &run_truth).map_err(|e| write_error(&truth, e))?;
    writer.finish().map_err(|e| write_error(&export, e))?;
    Ok(RunFiles { export, truth, started_at, rows: recording.rows() })
}

/// Passes each row of run `run_index`, counted from 0, to `sink`: the numbers that [`simulate_run`] writes, with the
/// positions `q` of the model.
///
/// # Errors
/// Those of [`recording_of_run`].
pub fn rows_of_run(
    robot: &Robot,
    settings: &SimulationSettings,
    run_index: u32,
    mut sink: impl FnMut(&RecordedRow),
) -> Result<(), SimulateError> {
    settings::check(robot, settings)?;
    let recording = recording_of_run(robot, settings, run_index)?;
    record(&recording, robot_seed(settings), noise_stream(run_index), |row| {
        sink(row);
        Ok::<(), SimulateError>(())
    })
    .map(drop)
}

/// File name without extension: `{robot}_{YYYYMMDD}_{HHMM}_Col{columns}_{warming}s_cycle{cycles}`, UTC.
pub fn file_stem(joint_count: usize, settings: &SimulationSettings, started_at: Timestamp) -> String {
    let SimulationSettings { robot_name, warming_s, cycles, .. } = settings;
    let native = || column_count(joint_count) + settings.temperatures.columns.count(joint_count);
    let columns = settings.format.as_ref().map_or_else(native, |format| format.columns.len());
    let start = started_at.strftime("%Y%m%d_%H%M");
    format!("{robot_name}_{start}_Col{columns}_{warming_s:.0}s_cycle{cycles}")
}

/// Torques of an arm that its exports lack because a description has no values for them, one sentence each.
pub fn not_simulated(robot: &Robot) -> Vec<String> {
    let of = |coupling: &Coupling| {
        format!(
            "inertia and friction of the motor of joint {} are simulated only for that joint, not for its motion with \
             joint {}: a description has no values for Iam, fvm and fsm",
            coupling.motor_joint, coupling.joint
        )
    };
    robot.couplings.iter().map(of).collect()
}

/// Everything that determines the rows of a run, except noise.
///
/// # Errors
/// Those of [`simulate_run`], without those of files.
pub fn recording_of_run(
    robot: &Robot,
    settings: &SimulationSettings,
    run_index: u32,
) -> Result<Recording, SimulateError> {
    recording_of_unit(&drawn_unit(robot, settings), settings, run_index)
}

/// The individual arm of these settings.
fn drawn_unit(model: &Robot, settings: &SimulationSettings) -> Robot {
    match settings.unit_spread.is_none() {
        true => model.clone(),
        false => unit(model, robot_seed(settings), &settings.unit_spread),
    }
}

/// The cycle of the test.
fn plan_settings(settings: &SimulationSettings) -> PlanSettings {
    PlanSettings {
        warming_s: settings.warming_s,
        seed: settings.seed,
        levels: settings.levels.clone(),
        excitation: settings.excitation.clone(),
        posture: settings.posture,
        rest_s: settings.rest_s,
    }
}

fn recording_of_unit(
    robot: &Robot,
    settings: &SimulationSettings,
    run_index: u32,
) -> Result<Recording, SimulateError> {
    let plan = plan_cycle(robot, &plan_settings(settings))?.at_speed(settings.speed);
    let started_at = start_of_run(settings, run_index)?;
    let run = run_index.saturating_add(1);
    let mut friction = Vec::new();
    let mut torque_noise = Vec::new();
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let nominal = joint.nominal.as_ref().ok_or(SimulateError::NoNominal { joint: index })?;
        let worn = wear(&settings.faults, index, run);
        let mut gearbox =
            joint_friction(joint, nominal, (settings.friction_load, 1.0 - settings.gear_efficiency), &worn);
        gearbox.warm_up = longer_slow_part(gearbox.warm_up, warm_up_factor(&settings.faults, index, run));
        let is_last = index.number() == robot.joint_count();
        let mut gearbox = gearbox.in_shape(settings.friction, is_last, joint.limits.velocity);
        if let Some(orders) = &settings.ripples {
            gearbox = gearbox.with_ripples(orders, joint.gear_ratio);
        }
        gearbox = gearbox.damaged(ripple(&settings.faults, index, run), joint.gear_ratio);
        gearbox.direction = settings.friction_direction;
        friction.push(gearbox.scaled(day_factor(settings, run_index, index)));
        torque_noise.push(nominal.torque_noise);
    }
    let point =
        |(mass, centre): (f64, [f64; 3])| Load { mass, centre: centre.into(), inertia: Matrix3::zeros() };
    let carried = settings.load.into_iter().chain(loads(&settings.faults, run).map(point));
    let mut compliance = [0.0; MAX_JOINTS];
    for &(joint, stiffness) in &settings.stiffness {
        compliance[joint.index()] = 1.0 / stiffness;
    }
    let worked_s = settings.work.as_ref().map(|work| work.worked_s(started_at));
    Ok(Recording {
        plan,
        servo: Servo::new(settings.servo),
        heating: settings.heating,
        compliance,
        chain: carried.fold(rigid_chain(robot)?, |chain, load| chain.carrying(&load, &robot.tool)),
        faults: RunFaults::new(&settings.faults, run, robot_seed(settings), noise_stream(run_index)),
        friction,
        torque_noise,
        sensors: settings.sensors,
        sample_rate_hz: settings.sample_rate_hz,
        clock: settings.clock,
        cycles: settings.cycles,
        initial: ThermalState {
            seconds: worked_s.unwrap_or(settings.initial_warm_s),
            ambient_offset_k: ambient_offset(settings, run_index) + settings.hall.offset(started_at),
        },
        temperatures: settings.temperatures,
    })
}

/// Friction of a joint on the day of a run, as a multiple of its usual friction.
fn day_factor(settings: &SimulationSettings, run_index: u32, joint: JointIndex) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(robot_seed(settings));
    rng.set_stream(DAY_STREAM + u64::from(run_index));
    let deviations = (0..=joint.index()).map(|_| rng.sample::<f64, _>(StandardNormal));
    (1.0 + settings.friction_day * deviations.last().unwrap_or(0.0)).max(0.0)
}

/// The same warm-up with the longer one of its time constants `factor` times as long.
fn longer_slow_part(mut warm_up: WarmUpShape, factor: f64) -> WarmUpShape {
    let slow = if warm_up.t1 >= warm_up.t2 { &mut warm_up.t1 } else { &mut warm_up.t2 };
    *slow *= factor;
    warm_up
}

fn write_rows(
    recording: &Recording,
    settings: &SimulationSettings,
    run_index: u32,
    writer: &mut ExportWriter,
    progress: &mut dyn FnMut(SimulationProgress),
) -> io::Result<Vec<CycleTruth>> {
    let (mut rows, rows_total, cycles) = (0, recording.rows(), recording.cycles);
    let told_rows = match settings.grows {
        true => (0.1 * settings.sample_rate_hz).max(1.0) as u64,
        false => PROGRESS_ROWS,
    };
    record(recording, robot_seed(settings), noise_stream(run_index), |row| {
        writer.push(row)?;
        rows += 1;
        if rows % told_rows == 0 || rows == rows_total {
            if settings.grows {
                writer.write_out()?;
            }
            progress(SimulationProgress { cycle: row.cycle, cycles, rows, rows_total });
        }
        Ok(())
    })
}

fn run_truth(
    robot: &Robot,
    settings: &SimulationSettings,
    recording: &Recording,
    run_index: u32,
    export: &Path,
    cycle_truth: Vec<CycleTruth>,
) -> Result<RunTruth, SimulateError> {
    let run = run_index.saturating_add(1);
    let fault_truth = |f: &Fault| FaultTruth {
        fault: f.to_string(),
        joint: f.joint.map(JointIndex::number),
        size: f.size(run),
    };
    Ok(RunTruth {
        file: export.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default(),
        robot: settings.robot_name.clone(),
        model: robot.model.clone(),
        started_at: start_of_run(settings, run_index)?.to_string(),
        run,
        seed: settings.seed,
        rows: recording.rows(),
        rows_per_cycle: recording.rows_per_cycle(),
        cycles: recording.cycles,
        sample_rate_hz: recording.sample_rate_hz,
        warming_s: settings.warming_s,
        initial_warm_s: recording.initial.seconds,
        ambient_offset_k: recording.initial.ambient_offset_k,
        position_noise_rad: recording.sensors.position_noise,
        velocity_noise_rad_s: recording.sensors.velocity_noise,
        following_lag_s: settings.servo.lag_s,
        command_delay_s: settings.servo.delay_s,
        torque_step_nm: recording.sensors.torque_step,
        torque_hum_hz_nm: recording.sensors.torque_hum,
        heating_by_work: recording.heating == Heating::Work,
        load: settings.load.as_ref().map(|load| LoadTruth {
            mass_kg: load.mass,
            centre_m: [load.centre.x, load.centre.y, load.centre.z],
        }),
        not_simulated: not_simulated(robot),
        joints: joint_truths(robot, settings, recording, run)?,
        faults: settings.faults.iter().map(fault_truth).collect(),
        cycle_truth,
    })
}

fn ripple_truth(asked: &RippleOrder, friction: &JointFriction) -> RippleTruth {
    RippleTruth { order: asked.order, amplitude_nm: asked.part * friction.warm[0].abs() }
}

/// Increase of warm friction by wear, a fraction, at [`WEAR_SPEED`] of the largest speed, without that by loads.
fn worn_by(joint: &Joint, nominal: &NominalJoint, worn: &Wear) -> f64 {
    let speed = WEAR_SPEED * joint.limits.velocity;
    let at = |worn: &Wear| joint_friction(joint, nominal, (0.0, 0.0), worn).warm_torque(speed);
    if *worn == Wear::default() { 0.0 } else { at(worn) / at(&Wear::default()) - 1.0 }
}

fn joint_truths(
    robot: &Robot,
    settings: &SimulationSettings,
    recording: &Recording,
    run: u32,
) -> Result<Vec<JointTruth>, SimulateError> {
    let joints = robot.joints.iter().zip(robot.joint_indices()).zip(&recording.friction);
    joints
        .map(|((joint, index), friction)| {
            let nominal = joint.nominal.ok_or(SimulateError::NoNominal { joint: index })?;
            Ok(JointTruth {
                joint: index.number(),
                inertial: nominal.inertial.0,
                motor_inertia_kg_m2: nominal.motor_inertia,
                warm_friction_f1_f4: friction.warm,
                wear: worn_by(joint, &nominal, &wear(&settings.faults, index, run)),
                stribeck_nm: friction.bump * friction.warm[0],
                stribeck_rad_s: friction.stribeck_speed,
                ripple_nm: friction.ripple,
                ripples: settings.ripples.iter().flatten().map(|of| ripple_truth(of, friction)).collect(),
                friction_direction: friction.direction,
                friction_load: friction.load,
                teeth_loss: friction.teeth.loss,
                torque_noise_nm: nominal.torque_noise,
            })
        })
        .collect()
}

fn start_of_run(settings: &SimulationSettings, run_index: u32) -> Result<Timestamp, SimulateError> {
    let start = settings.interval.checked_mul(run_index);
    start.and_then(|after| settings.first_start.checked_add(after).ok()).ok_or(SimulateError::Setting {
        key: "interval",
        value: format!("{} s", settings.interval.as_secs_f64()),
        hint: "the last run would start beyond the calendar",
    })
}

/// Streams of the random generator: one for noise and one for ambient temperature per run.
fn noise_stream(run_index: u32) -> u64 {
    2 * u64::from(run_index)
}

fn ambient_offset(settings: &SimulationSettings, run_index: u32) -> f64 {
    let mut rng = ChaCha8Rng::seed_from_u64(robot_seed(settings));
    rng.set_stream(noise_stream(run_index) + 1);
    let deviation: f64 = rng.sample(StandardNormal);
    settings.ambient_offset_k + settings.ambient_std_k * deviation
}

/// Separates the noise of robots with the same seed. FNV-1a is the same in all versions and on all machines, which the
/// standard hasher does not guarantee.
fn robot_seed(settings: &SimulationSettings) -> u64 {
    let fnv = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    settings.seed ^ settings.robot_name.bytes().fold(0xcbf2_9ce4_8422_2325, fnv)
}

fn write_error(path: &Path, source: io::Error) -> SimulateError {
    SimulateError::Write { path: path.to_owned(), source }
}
