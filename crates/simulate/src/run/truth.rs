//! The true values behind a simulated export, for comparison in tests and demonstrations.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use serde::Serialize;

/// Truth file of one run. Names end in units; for a prismatic joint read N for Nm and m for rad.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunTruth {
    /// File name of the export.
    pub file: String,
    /// The individual robot.
    pub robot: String,
    /// Model of its description.
    pub model: String,
    /// Start of the recording, RFC 3339.
    pub started_at: String,
    /// Number of the run, from 1.
    pub run: u32,
    /// Seed of the simulation.
    pub seed: u64,
    /// Rows without the header.
    pub rows: u64,
    /// Rows of each cycle.
    pub rows_per_cycle: u32,
    /// Cycles.
    pub cycles: u32,
    /// Sample rate, Hz.
    pub sample_rate_hz: f64,
    /// Duration of each warming stage, s.
    pub warming_s: f64,
    /// Time between the cold start and the first row, s.
    pub initial_warm_s: f64,
    /// Difference between the ambient temperature and the usual one, K.
    pub ambient_offset_k: f64,
    /// Standard deviation of the position signals, rad.
    pub position_noise_rad: f64,
    /// Standard deviation of the velocity signals, rad/s.
    pub velocity_noise_rad_s: f64,
    /// Delay of joints at constant speed behind their plan, s; absent if zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub following_lag_s: f64,
    /// Time from plan and stage signals to the motion, s; absent if zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub command_delay_s: f64,
    /// Step of the torque signals, Nm; absent if there is none.
    #[serde(skip_serializing_if = "is_zero")]
    pub torque_step_nm: f64,
    /// Hum of the torque signals: frequency, Hz, and amplitude, Nm; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub torque_hum_hz_nm: Option<[f64; 2]>,
    /// True if gears warm by the work that they do; absent if they warm with time.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub heating_by_work: bool,
    /// Body at the tool frame; absent if there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load: Option<LoadTruth>,
    /// Torques that the export lacks, as sentences; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub not_simulated: Vec<String>,
    /// Parameters of each joint and its link in this run, without the load.
    pub joints: Vec<JointTruth>,
    /// Faults with their size in this run.
    pub faults: Vec<FaultTruth>,
    /// Friction of each cycle.
    pub cycle_truth: Vec<CycleTruth>,
}

/// Parameters of a joint and the link that it moves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointTruth {
    /// Joint number, from 1.
    pub joint: usize,
    /// `m, mPx, mPy, mPz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz` about the link frame: kg, kg m, kg m².
    pub inertial: [f64; 10],
    /// Motor inertia seen at the joint, kg m².
    pub motor_inertia_kg_m2: f64,
    /// Warm coefficients of [3.10] with wear and daily scatter: Nm, Nm s/rad, Nm s²/rad², Nm s³/rad³.
    pub warm_friction_f1_f4: [f64; 4],
    /// Rise of warm friction by wear at 60 % of the largest speed, a fraction, without loads.
    pub wear: f64,
    /// Height of the bump at low speed once warm, Nm.
    pub stribeck_nm: f64,
    /// Speed of decay of the bump to 1/e, rad/s.
    pub stribeck_rad_s: f64,
    /// Amplitude of the torque ripple at low speed, Nm.
    pub ripple_nm: f64,
    /// All ripples, if they replace that of the friction shape; otherwise absent.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ripples: Vec<RippleTruth>,
    /// Excess of friction in the positive direction, as a fraction; the negative direction has as much less. Absent if
    /// zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub friction_direction: f64,
    /// Friction per Nm that the gear carries; absent if it does not depend on the load.
    #[serde(skip_serializing_if = "is_zero")]
    pub friction_load: f64,
    /// Fraction of the transmitted power that the gear's teeth lose at speed; absent if zero.
    #[serde(skip_serializing_if = "is_zero")]
    pub teeth_loss: f64,
    /// Standard deviation of the torque signal, Nm.
    pub torque_noise_nm: f64,
}

/// A ripple of the torque with the angle of the motor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RippleTruth {
    /// Waves per turn of the motor.
    pub order: f64,
    /// Amplitude at low speed, Nm.
    pub amplitude_nm: f64,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// A body that the tool frame carries.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LoadTruth {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass in the tool frame, m.
    pub centre_m: [f64; 3],
}

/// A fault in one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultTruth {
    /// The fault in the notation of the command line.
    pub fault: String,
    /// Joint number, from 1; null for a fault of the whole arm.
    pub joint: Option<usize>,
    /// Its size in this run, in the unit of its kind; 0 if absent.
    pub size: f64,
}

/// Friction in one cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CycleTruth {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Its start since the start of the run, s.
    pub start_s: f64,
    /// Each joint at the start of the cycle.
    pub joints: Vec<JointThermalTruth>,
    /// Each level of each joint at the time when it is measured.
    pub friction_levels: Vec<FrictionLevelTruth>,
}

/// Friction of a joint at the start of a cycle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointThermalTruth {
    /// Viscous friction relative to warm friction.
    pub multiplier: f64,
    /// Coefficients of [3.10] at that moment, without the bump at low speed.
    pub friction_f1_f4: [f64; 4],
}

/// Mean friction over the rows of the constant-speed plateaus of a level, without ripple.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FrictionLevelTruth {
    /// Joint number, from 1.
    pub joint: usize,
    /// Speed level, from 1.
    pub level: u8,
    /// Mean time of the rows since the start of the run, min; null without rows.
    pub minute: Option<f64>,
    /// Speed of the plateau, rad/s; below the level's own if the range is too short for it.
    pub speed_rad_s: Option<f64>,
    /// Rows of the plateaus in both directions.
    pub rows: u32,
    /// Mean friction moving upwards, Nm.
    pub torque_positive_nm: Option<f64>,
    /// Mean friction moving downwards, Nm; negative.
    pub torque_negative_nm: Option<f64>,
}

/// Writes the truth as JSON.
///
/// # Errors
/// Those of writing the file.
pub fn write_truth(path: &Path, truth: &RunTruth) -> io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    serde_json::to_writer_pretty(&mut file, truth)?;
    file.write_all(b"\n")?;
    file.flush()
}
