//! Settings of a simulation, one robot over its runs, and their validity.

use std::path::PathBuf;
use std::time::Duration;

use jiff::Timestamp;

use super::arm::fault::Fault;
use super::arm::friction::{self, FrictionShape, RippleOrder};
use super::arm::hall::{HallSettings, WorkingHours};
use super::arm::load::Load;
use super::arm::unit::UnitSpread;
use super::error::SimulateError;
use super::files::format::ExportFormat;
use super::plan::trajectory::{self, ExcitationParts, FrictionPosture};
use super::run::recording::{Clock, Heating, SensorSettings};
use super::run::servo::ServoSettings;
use super::run::temperatures::TemperatureSettings;
use armwatch_model::robot::{JointIndex, Robot};

/// Sample rates that an export carries: time has four decimals.
const SAMPLE_RATE_HZ: [f64; 2] = [10.0, 5000.0];
/// Start of the first run by default, 2026-01-05T08:47:00Z: file names of 1970 are implausible.
const FIRST_START: Timestamp = Timestamp::constant(1_767_602_820, 0);

/// Settings of a simulation: one robot over its runs.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationSettings {
    /// Name of the individual robot, such as `R01`; begins the file name.
    pub robot_name: String,
    /// Seed of all random values, together with the robot's name and the run.
    pub seed: u64,
    /// Rows per second, Hz; 10 to 5000.
    pub sample_rate_hz: f64,
    /// How the instants of rows follow each other.
    pub clock: Clock,
    /// Cycles of a run.
    pub cycles: u32,
    /// Duration of each warming stage, s; 0 omits it.
    pub warming_s: f64,
    /// Speed levels of the friction stage, from 1; `None` for all of the description. An empty list omits the stage.
    pub levels: Option<Vec<u8>>,
    /// Parts of the excitation stage.
    pub excitation: ExcitationParts,
    /// Posture of the joints that hold still in the friction stage.
    pub posture: FrictionPosture,
    /// Rest at the end of each cycle, s.
    pub rest_s: f64,
    /// Override: speed of all motions as a part of the planned one, above 0 to 1. Warming and rest take longer accordingly.
    pub speed: f64,
    /// How the arm follows its plan.
    pub servo: ServoSettings,
    /// Number of runs.
    pub runs: u32,
    /// Start of the first run.
    pub first_start: Timestamp,
    /// Time from the start of a run to the start of the next; at least a minute, the resolution of
    /// file names.
    pub interval: Duration,
    /// Faults that the robot develops.
    pub faults: Vec<Fault>,
    /// True if exports are compressed.
    pub gzip: bool,
    /// Time between the cold start and the first row of each run, s.
    pub initial_warm_s: f64,
    /// Difference between the mean ambient temperature and the usual one, K.
    pub ambient_offset_k: f64,
    /// Standard deviation of the ambient temperature from run to run, K.
    pub ambient_std_k: f64,
    /// Variation of the ambient temperature over year and day.
    pub hall: HallSettings,
    /// Working hours in addition to tests, which warm the arm; replaces `initial_warm_s`.
    pub work: Option<WorkingHours>,
    /// Spread of this individual arm around its model.
    pub unit_spread: UnitSpread,
    /// Errors of the position and velocity signals.
    pub sensors: SensorSettings,
    /// Folder of the truth files; next to the exports if `None`.
    pub truth_dir: Option<PathBuf>,
    /// Form of the gearboxes' friction.
    pub friction: FrictionShape,
    /// Heat source of the gearboxes.
    pub heating: Heating,
    /// Ripples of the torque with the motor's angle, instead of those of the shape; four at most.
    pub ripples: Option<Vec<RippleOrder>>,
    /// Excess of friction in a joint's positive direction, as a fraction; the negative direction has as much less.
    pub friction_direction: f64,
    /// Friction per Nm (N) that a gear carries.
    pub friction_load: f64,
    /// Fraction of the power that gears transmit to the load at speed, 0.5 to 1, in addition to friction without load.
    pub gear_efficiency: f64,
    /// Standard deviation of the friction of each joint from run to run, as a fraction.
    pub friction_day: f64,
    /// Stiffness of elastic gears, Nm/rad (N/m): see `simulate::elastic`. The planned motion is that of the links then.
    pub stiffness: Vec<(JointIndex, f64)>,
    /// True if the export has its final name from its first row on, like that of a watched controller.
    pub grows: bool,
    /// Body that the tool frame carries.
    pub load: Option<Load>,
    /// Columns of the exports; the native layout if `None`.
    pub format: Option<ExportFormat>,
    /// Temperatures that the controller records; a `format` names their columns itself.
    pub temperatures: TemperatureSettings,
}

impl Default for SimulationSettings {
    /// A small healthy robot: one run of five cycles at 50 Hz with 20 s of warming, on 2026-01-05.
    fn default() -> Self {
        Self {
            robot_name: "R01".into(),
            seed: 1,
            sample_rate_hz: 50.0,
            clock: Clock::Even,
            cycles: 5,
            warming_s: 20.0,
            levels: None,
            excitation: ExcitationParts::default(),
            posture: FrictionPosture::Home,
            rest_s: 0.0,
            speed: 1.0,
            servo: ServoSettings::default(),
            runs: 1,
            first_start: FIRST_START,
            interval: Duration::from_secs(24 * 60 * 60),
            faults: Vec::new(),
            gzip: false,
            initial_warm_s: 0.0,
            ambient_offset_k: 0.0,
            ambient_std_k: 1.0,
            hall: HallSettings::default(),
            work: None,
            unit_spread: UnitSpread::default(),
            sensors: SensorSettings::default(),
            truth_dir: None,
            friction: FrictionShape::Gearbox,
            heating: Heating::Time,
            ripples: None,
            friction_direction: 0.0,
            friction_load: 0.0,
            gear_efficiency: 1.0,
            friction_day: 0.0,
            stiffness: Vec::new(),
            grows: false,
            load: None,
            format: None,
            temperatures: TemperatureSettings::default(),
        }
    }
}

impl SimulationSettings {
    /// A test like that of the source: 24 cycles at 250 Hz with 180 s of warming.
    pub fn full_test() -> Self {
        Self { sample_rate_hz: 250.0, cycles: 24, warming_s: 180.0, ..Self::default() }
    }
}

/// Settings that no recording can have, or that the arm does not support.
pub(super) fn check(robot: &Robot, settings: &SimulationSettings) -> Result<(), SimulateError> {
    let setting = |key, value: String, hint| Err(SimulateError::Setting { key, value, hint });
    let name = &settings.robot_name;
    if name.is_empty()
        || name.starts_with('.')
        || name.contains(['/', '\\'])
        || name.contains(char::is_control)
    {
        return setting("robot_name", format!("{name:?}"), "it begins a file name");
    }
    let [low, high] = SAMPLE_RATE_HZ;
    if !(low..=high).contains(&settings.sample_rate_hz) {
        return setting("sample_rate_hz", settings.sample_rate_hz.to_string(), "choose 10 to 5000 Hz");
    }
    if settings.cycles == 0 {
        return setting("cycles", "0".into(), "a run has at least one cycle");
    }
    for &(joint, stiffness) in &settings.stiffness {
        if joint.index() >= robot.joint_count() || !(stiffness.is_finite() && stiffness > 0.0) {
            let hint = "give a joint that the arm has a stiffness above 0 Nm/rad (N/m)";
            return setting("stiffness", format!("{stiffness} of joint {joint}"), hint);
        }
    }
    if !(0.0..1.0).contains(&settings.sensors.torque_correlation) {
        let value = settings.sensors.torque_correlation.to_string();
        return setting("torque_correlation", value, "choose 0 to below 1");
    }
    if settings.grows && settings.gzip {
        return setting("gzip", "true".into(), "an export that grows is not compressed");
    }
    let not_negative = [
        ("warming_s", settings.warming_s),
        ("initial_warm_s", settings.initial_warm_s),
        ("ambient_std_k", settings.ambient_std_k),
        ("rest_s", settings.rest_s),
        ("lag_s", settings.servo.lag_s),
        ("delay_s", settings.servo.delay_s),
        ("friction_load", settings.friction_load),
        ("friction_day", settings.friction_day),
        ("unit_spread", settings.unit_spread.friction),
        ("unit_spread", settings.unit_spread.bodies),
        ("position_noise", settings.sensors.position_noise),
        ("position_step", settings.sensors.position_step),
        ("velocity_noise", settings.sensors.velocity_noise),
        ("velocity_step", settings.sensors.velocity_step),
        ("torque_step", settings.sensors.torque_step),
    ];
    if let Some((key, value)) = not_negative.into_iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
        return setting(key, value.to_string(), "it must be 0 or more");
    }
    // the motion of a cycle that began before the previous one is at rest would jump
    let rest_s = trajectory::REST_S + settings.rest_s;
    if settings.servo.settled_after() > rest_s {
        let ServoSettings { lag_s, delay_s } = settings.servo;
        let hint = "four lags and the delay must pass within the rest at the end of a cycle, 0.6 s and what is added";
        return setting("lag_s, delay_s", format!("{lag_s}, {delay_s}"), hint);
    }
    if let Some([hertz, amplitude]) = settings.sensors.torque_hum
        && !(hertz.is_finite() && hertz > 0.0 && amplitude.is_finite() && amplitude >= 0.0)
    {
        let hint = "choose a frequency above 0 Hz and an amplitude of 0 Nm (N) or more";
        return setting("torque_hum", format!("{hertz}, {amplitude}"), hint);
    }
    if !(settings.speed > 0.0 && settings.speed <= 1.0) {
        return setting("speed", settings.speed.to_string(), "choose above 0 to 1");
    }
    if !(0.5..=1.0).contains(&settings.gear_efficiency) {
        let value = settings.gear_efficiency.to_string();
        return setting("gear_efficiency", value, "choose 0.5 to 1");
    }
    if settings.friction_direction.is_nan() || settings.friction_direction.abs() >= 1.0 {
        let value = settings.friction_direction.to_string();
        return setting("friction_direction", value, "choose above -1 and below 1");
    }
    if settings.ripples.as_ref().is_some_and(|orders| orders.len() > 1 + friction::MORE_RIPPLES) {
        return setting("ripples", "more than four".into(), "a joint has four ripples at most");
    }
    let TemperatureSettings { step_k, noise_k, lag_s, .. } = settings.temperatures;
    let sensors = [("temperature_step_k", step_k, 1e-3), ("temperature_lag_s", lag_s, 1.0)];
    if let Some((key, value, _)) = sensors.into_iter().find(|(_, v, least)| !(v.is_finite() && v >= least)) {
        return setting(
            key,
            value.to_string(),
            "steps of at least 0.001 K and lags of at least 1 s are possible",
        );
    }
    if !(noise_k.is_finite() && noise_k >= 0.0) {
        return setting("temperature_noise_k", noise_k.to_string(), "it must be 0 or more");
    }
    if settings.runs > 1 && settings.interval < Duration::from_secs(60) {
        let hint = "file names have a resolution of one minute, so runs must start at least 60 s apart";
        return setting("interval", format!("{} s", settings.interval.as_secs_f64()), hint);
    }
    if let Some(load) = settings.load.filter(|load| !(load.mass.is_finite() && load.mass > 0.0)) {
        return setting("load", format!("{} kg", load.mass), "a load has a mass above 0");
    }
    match settings.faults.iter().find(|f| f.joint.is_some_and(|joint| joint.index() >= robot.joint_count())) {
        Some(fault) => setting("fault", fault.to_string(), "the robot has no such joint"),
        None => Ok(()),
    }
}
