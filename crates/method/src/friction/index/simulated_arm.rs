//! Simulated arms for tests of the index. Their thermal law differs from the law of the program: two heat capacities
//! heated by friction, oil whose viscosity falls exponentially, and a housing that loses heat more than in proportion.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::baseline::{FormedMaps, fit_maps};
use super::run_record::coverage;
use super::{ReferenceMap, run_indices};
use armwatch_model::analysis::friction::{FrictionIndex, FrictionMap};
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};
use armwatch_model::analysis::{CycleTemperatures, FrictionPoint, GravityRemoval};
use armwatch_model::anomaly::baseline_runs::{FULL_RUN_POINTS, REMEMBERED_S, learnt_runs, stages};
use armwatch_model::robot::JointIndex;

/// Friction of a robot over a history without maintenance.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct RobotFriction {
    /// Maps of the joints that have one.
    pub(super) maps: Vec<FrictionMap>,
    /// Indices by run: one for each joint with a map and points in that run.
    pub(super) indices: Vec<Vec<FrictionIndex>>,
    pub(super) remarks: Vec<String>,
}

/// Indices of all runs, and the latest maps. The baseline is the first `baseline_runs` full runs of all joints. Each
/// index uses the map that is held when the run arrives.
pub(super) fn robot_friction(runs: &[MapRun], baseline_runs: usize) -> RobotFriction {
    let is_full = |run: &MapRun| coverage(run).iter().any(|(_, points)| *points >= FULL_RUN_POINTS);
    let full: Vec<usize> = (0..runs.len()).filter(|run| is_full(&runs[*run])).collect();
    let mut found = RobotFriction { indices: vec![Vec::new(); runs.len()], ..RobotFriction::default() };
    let joints: Vec<JointIndex> = (0..JOINTS).map(JointIndex::new).collect();
    let by_stage: Vec<(usize, FormedMaps)> = stages(baseline_runs, full.len())
        .map(|stage| {
            let last = full[stage - 1];
            let learnt = learnt_runs(&full[..stage], baseline_runs);
            (last, fit_maps(&joints, &[], &runs[..=last], &learnt, baseline_runs))
        })
        .collect();
    for (run, indices) in found.indices.iter_mut().enumerate() {
        let held = by_stage.iter().rev().find(|(last, _)| *last <= run).or(by_stage.first());
        let Some((_, formed)) = held else { continue };
        let in_baseline = full[..baseline_runs].contains(&run);
        let references: Vec<ReferenceMap<'_>> =
            formed.maps.iter().map(|held| ReferenceMap { held, in_baseline }).collect();
        let from = runs[run].started_at - REMEMBERED_S;
        let first = runs.partition_point(|before| before.started_at < from);
        *indices = run_indices(&references, &runs[first..run], &runs[run]);
    }
    if let Some((_, formed)) = by_stage.last() {
        found.remarks = formed.remarks.iter().map(|(_, words)| words.clone()).collect();
        found.maps = formed.maps.iter().map(|held| held.map.clone()).collect();
    }
    found
}

pub(super) const JOINTS: usize = 6;
pub(super) const LEVELS: [f64; 6] = [0.05, 0.2, 0.4, 0.6, 0.8, 1.0];
pub(super) const CYCLE_S: f64 = 300.0;
pub(super) const CYCLES: usize = 12;
/// Relative standard deviation of a plateau's mean.
pub(super) const SCATTER: f64 = 0.005;
pub(super) const HOUR: f64 = 3600.0;
pub(super) const BASELINE: usize = 5;

/// Gearbox: friction and its dependence on temperature.
#[derive(Clone, Copy)]
pub(super) struct Gear {
    /// Coulomb, viscous and curvature terms at the largest speed, Nm.
    pub(super) friction: [f64; 3],
    /// Relative fall of viscosity per kelvin.
    pub(super) beta: f64,
    /// Rise of the housing above ambient temperature and of the oil above the housing in a warm gear, K.
    pub(super) rise: [f64; 2],
    /// Time constants of these rises, s.
    pub(super) time: [f64; 2],
}

pub(super) fn gears() -> [Gear; JOINTS] {
    let gear = |friction, beta, rise, time| Gear { friction, beta, rise, time };
    [
        gear([5.7, 30.0, -8.0], 0.020, [16.0, 8.0], [2600.0, 230.0]),
        gear([3.2, 45.0, -12.0], 0.018, [18.0, 9.0], [3200.0, 420.0]),
        gear([4.0, 20.0, -5.0], 0.022, [14.0, 8.0], [1700.0, 180.0]),
        gear([3.0, 12.0, -3.0], 0.020, [17.0, 10.0], [1600.0, 260.0]),
        gear([2.0, 7.0, -1.5], 0.021, [15.0, 9.0], [1500.0, 200.0]),
        gear([1.5, 5.0, -1.0], 0.019, [13.0, 8.0], [1200.0, 150.0]),
    ]
}

impl Gear {
    /// Oil temperature minus ambient temperature of a warm gear at the usual ambient temperature, K.
    pub(super) fn warm(&self) -> f64 {
        self.rise[0] + self.rise[1]
    }

    /// Viscosity relative to a warm gear at the usual ambient temperature; `oil` is the oil temperature above the usual
    /// ambient temperature, K.
    pub(super) fn viscosity(&self, oil: f64) -> f64 {
        (-self.beta * (oil - self.warm())).exp()
    }

    pub(super) fn friction(&self, u: f64, oil: f64) -> f64 {
        let m = self.viscosity(oil);
        let [coulomb, viscous, curve] = self.friction;
        coulomb * (1.0 + 0.3 * (m - 1.0)) + (viscous * u + curve * u * u) * m
    }

    /// Steps oil and housing by `dt`.
    pub(super) fn step(&self, state: &mut [f64; 2], hall: f64, pace: f64, dt: f64) {
        let [oil, housing] = *state;
        let moving = pace > 0.0;
        // friction at half the speed of the pace, times this speed
        let lost = self.friction(0.5 * pace, oil) * pace;
        let heat = if moving { lost / self.friction(0.5, self.warm()) } else { 0.0 };
        let between = oil - housing;
        // the oil's rise is heat over conductance; the housing's losses grow as a power
        let excess = (housing - hall) / self.rise[0];
        let wind = if moving { 1.0 } else { 0.8 };
        let loss = wind * self.rise[0] * excess * excess.abs().powf(0.25);
        state[0] += dt / self.time[1] * (self.rise[1] * heat - between);
        state[1] += dt / self.time[0] * (self.rise[0] / self.rise[1] * between - loss);
    }
}

/// Temperatures that the controller records.
#[derive(Clone, Copy, Default)]
pub(super) struct Sensors {
    pub(super) motor: bool,
    pub(super) ambient: bool,
    /// Resolution of the recorded temperatures, K.
    pub(super) step: f64,
}

/// Usual ambient temperature, K.
pub(super) const USUAL_HALL: f64 = 295.0;
/// Losses of a motor: its rise above the housing in usual motion, K, and the time constant, s.
const MOTOR_RISE: f64 = 15.0;
const MOTOR_TIME: f64 = 500.0;
/// Noise of a sensor, K.
const SENSOR_NOISE: f64 = 0.2;

/// Arm with its thermal state.
pub(super) struct Arm {
    pub(super) rng: ChaCha8Rng,
    pub(super) gears: [Gear; JOINTS],
    /// Mean speed of each joint's motion as a multiple of the usual one.
    pub(super) pace: [f64; JOINTS],
    pub(super) heat: [[f64; 2]; JOINTS],
    /// Temperature of each motor above the usual ambient temperature, K. It is neither the oil's nor the housing's.
    pub(super) motor: [f64; JOINTS],
    pub(super) sensors: Sensors,
    pub(super) now: f64,
    /// True for short cycles: a third of [`CYCLE_S`].
    pub(super) is_brisk: bool,
    pub(super) runs: Vec<MapRun>,
}

impl Arm {
    pub(super) fn new(seed: u64) -> Self {
        let rng = ChaCha8Rng::seed_from_u64(seed);
        Self {
            rng,
            gears: gears(),
            pace: [1.0; JOINTS],
            heat: [[0.0; 2]; JOINTS],
            motor: [0.0; JOINTS],
            sensors: Sensors::default(),
            now: 0.0,
            is_brisk: false,
            runs: Vec::new(),
        }
    }

    /// Arm with other gears: friction, rises and time constants vary by a third (two sigma).
    pub(super) fn unlike(seed: u64) -> Self {
        let mut arm = Self::new(seed);
        for mut gear in arm.gears {
            let mut by = || (0.15 * arm.rng.sample::<f64, _>(StandardNormal)).exp();
            gear.friction = gear.friction.map(|f| f * by());
            gear.beta *= by();
            gear.rise = gear.rise.map(|rise| rise * by());
            gear.time = gear.time.map(|time| time * by());
            arm.gears.rotate_left(1);
            arm.gears[JOINTS - 1] = gear;
        }
        arm
    }

    pub(super) fn normal(&mut self) -> f64 {
        self.rng.sample(StandardNormal)
    }

    pub(super) fn rest(&mut self, seconds: f64, hall: f64) {
        for _ in 0..(seconds / 30.0) as usize {
            self.step(hall, [0.0; JOINTS], 30.0);
        }
        self.now += seconds;
    }

    pub(super) fn step(&mut self, hall: f64, pace: [f64; JOINTS], dt: f64) {
        for ((gear, heat), pace) in self.gears.iter().zip(&mut self.heat).zip(pace) {
            gear.step(heat, hall, pace, dt);
        }
        for ((motor, heat), pace) in self.motor.iter_mut().zip(&self.heat).zip(pace) {
            *motor += dt / MOTOR_TIME * (MOTOR_RISE * pace * pace - (*motor - heat[1]));
        }
    }

    /// Temperatures that the sensors report now, K.
    pub(super) fn readings(&mut self, hall: f64) -> CycleTemperatures {
        let Sensors { motor, ambient, step } = self.sensors;
        let mut reading = |above: f64| {
            let noisy = USUAL_HALL + above + SENSOR_NOISE * self.rng.sample::<f64, _>(StandardNormal);
            (noisy / step).round() * step
        };
        CycleTemperatures {
            motor: if motor {
                self.motor.iter().map(|above| Some(reading(*above))).collect()
            } else {
                Vec::new()
            },
            ambient: ambient.then(|| reading(hall)),
        }
    }

    /// Present friction of each joint at a level, without wear, Nm.
    pub(super) fn friction_now(&self, level: usize) -> Vec<f64> {
        self.gears.iter().zip(&self.heat).map(|(gear, heat)| gear.friction(LEVELS[level], heat[0])).collect()
    }

    /// Increase of friction at the largest speed per kelvin of colder air, Nm/K: first of each gear in lasting motion,
    /// which heats itself more in colder air, then of each gear at ambient temperature.
    pub(super) fn friction_per_kelvin(&self) -> [Vec<f64>; 2] {
        let lasting = |gear: &Gear, hall: f64| {
            let mut state = [gear.warm() + hall, gear.rise[0] + hall];
            (0..8 * 720).for_each(|_| gear.step(&mut state, hall, 1.0, 5.0));
            gear.friction(1.0, state[0])
        };
        let of = |friction: &dyn Fn(&Gear, f64) -> f64| {
            self.gears.iter().map(|gear| friction(gear, -0.5) - friction(gear, 0.5)).collect()
        };
        [of(&lasting), of(&|gear, hall| gear.friction(1.0, hall))]
    }

    /// Appends a run with wear by joint. The air is `hall` K warmer than usual.
    pub(super) fn run(&mut self, hall: f64, wear: [f64; JOINTS]) {
        self.run_of(CYCLES, hall, wear);
    }

    pub(super) fn run_of(&mut self, cycles: usize, hall: f64, wear: [f64; JOINTS]) {
        let started_at = self.now;
        // a row of the programme takes two seconds, or one if cycles are short
        let (cycle_s, row_s) = if self.is_brisk { (CYCLE_S / 3.0, 1) } else { (CYCLE_S, 2) };
        let (mut points, mut readings) = (Vec::new(), Vec::new());
        for cycle in 0..cycles {
            for second in 0..cycle_s as usize {
                if second % 5 == 0 {
                    self.step(hall, self.pace, 5.0);
                }
                if self.sensors.step > 0.0 && second % 60 == 30 {
                    readings.push((cycle, self.readings(hall)));
                }
                let Some(place) = second.checked_sub(20 * row_s).filter(|s| s % row_s == 0) else { continue };
                let (joint, rest) = (place / row_s / 12, place / row_s % 12);
                if joint < JOINTS {
                    let (level, direction) = (LEVELS[rest / 2], if rest % 2 == 0 { 1 } else { -1 });
                    let noise = 1.0 + SCATTER * std::f64::consts::SQRT_2 * self.normal();
                    let friction = self.gears[joint].friction(level, self.heat[joint][0]);
                    points.push(FrictionPoint {
                        joint: JointIndex::new(joint),
                        time: cycle as f64 * cycle_s + second as f64,
                        speed_fraction: level,
                        speed: 4.0 * level,
                        direction,
                        torque: f64::from(direction) * friction * (1.0 + wear[joint]) * noise,
                        std: 0.1,
                        samples: 100,
                        gravity: GravityRemoval::AxisVertical,
                        load: None,
                    });
                }
            }
        }
        let end = cycles as f64 * cycle_s;
        self.now += end;
        let speeds = self.pace.map(|pace| 1.5 * pace).to_vec();
        let span =
            |start, end, temperatures| CycleMotion { start, end, speeds: speeds.clone(), temperatures };
        let spans = match self.sensors.step > 0.0 {
            false => vec![span(0.0, end, CycleTemperatures::default())],
            true => (0..cycles)
                .map(|cycle| {
                    let start = cycle as f64 * cycle_s;
                    span(start, start + cycle_s, mean_readings(&readings, cycle))
                })
                .collect(),
        };
        self.runs.push(MapRun { started_at, spans, points });
    }

    /// Arm with sensors.
    pub(super) fn with_sensors(seed: u64, motor: bool, ambient: bool, step: f64) -> Self {
        Self { sensors: Sensors { motor, ambient, step }, ..Self::new(seed) }
    }

    /// History of healthy runs with random rests (0.5 to 36 h); `spread` is the standard deviation of ambient
    /// temperature, K.
    pub(super) fn healthy(seed: u64, runs: usize, spread: f64) -> Self {
        let mut arm = Self::new(seed);
        arm.go_on(runs, spread, [0.0; JOINTS]);
        arm
    }

    /// Appends runs with random rests and the given wear.
    pub(super) fn go_on(&mut self, runs: usize, spread: f64, wear: [f64; JOINTS]) {
        for _ in 0..runs {
            let hall = spread * self.normal();
            let rest = HOUR * (0.5 + 35.5 * self.rng.random::<f64>().powi(2));
            self.rest(rest, hall);
            self.run(hall, wear);
        }
    }

    pub(super) fn friction(&self) -> RobotFriction {
        robot_friction(&self.runs, BASELINE)
    }
}

/// Means of the readings of a cycle.
fn mean_readings(readings: &[(usize, CycleTemperatures)], cycle: usize) -> CycleTemperatures {
    let of_cycle = || readings.iter().filter(|(of, _)| *of == cycle).map(|(_, found)| found);
    let mean = |of: &dyn Fn(&CycleTemperatures) -> Option<f64>| {
        let values: Option<Vec<f64>> = of_cycle().map(of).collect();
        crate::statistics::descriptive::mean(&values?)
    };
    let motors = of_cycle().next().map_or(0, |found| found.motor.len());
    CycleTemperatures {
        motor: (0..motors).map(|j| mean(&|found| found.motor[j])).collect(),
        ambient: mean(&|found| found.ambient),
    }
}

/// Indices of the last run, minus one.
pub(super) fn last_changes(found: &RobotFriction) -> Vec<f64> {
    let last = found.indices.last().expect("runs");
    assert_eq!(last.len(), JOINTS, "{:?}", found.remarks);
    last.iter().map(|i| i.index.value - 1.0).collect()
}

/// Relative change of raw friction at 60 % of the largest speed, from the baseline runs to the last third of the last
/// run.
pub(super) fn raw_changes(arm: &Arm) -> Vec<f64> {
    let level = |run: &MapRun, j: usize| {
        let late =
            run.points.iter().filter(|p| p.joint.index() == j && (p.speed_fraction - 0.6).abs() < 1e-9);
        let late: Vec<f64> =
            late.filter(|p| p.time > 0.66 * CYCLE_S * CYCLES as f64).map(|p| p.torque.abs()).collect();
        late.iter().sum::<f64>() / late.len() as f64
    };
    (0..JOINTS)
        .map(|j| {
            let baseline = arm.runs[..BASELINE].iter().map(|r| level(r, j)).sum::<f64>() / BASELINE as f64;
            level(&arm.runs[arm.runs.len() - 1], j) / baseline - 1.0
        })
        .collect()
}

pub(super) fn largest(changes: &[f64]) -> f64 {
    changes.iter().fold(0.0, |worst, change| worst.max(change.abs()))
}

/// Kelvin of colder air that increase the cold part of friction of joint 1 by half.
pub(super) fn half_colder() -> f64 {
    let gear = gears()[0];
    let cold_part = gear.viscosity(0.0) - 1.0;
    (1.0 + 1.5 * cold_part).ln() / gear.beta - gear.warm()
}

/// Tolerated errors of the index: without wear, half the change that raises an alarm; with wear of 4 %, small enough to
/// distinguish it from none.
pub(super) const ADMITTED: f64 = 0.02;
pub(super) const WEAR_TOLERANCE: f64 = 0.015;
/// Tolerated error of the index without wear, in air colder than the held map has learnt.
pub(super) const ADMITTED_OF_THE_UNKNOWN: f64 = 0.025;
