//! What friction over time is fitted to: the runs of a robot, the points of each joint, and what was measured of its
//! temperature.

use super::thermal_state::MotionSpan;
use crate::analysis::{CycleTemperatures, FrictionPoint};
use crate::robot::JointIndex;

/// A stretch of motion of all joints.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleMotion {
    /// Start, s.
    pub start: f64,
    /// End, s.
    pub end: f64,
    /// Mean magnitude of each joint's velocity, rad/s (m/s), `[n]`; empty where it is not known.
    pub speeds: Vec<f64>,
    /// Mean temperatures, where recorded.
    pub temperatures: CycleTemperatures,
}

/// One run, as the map sees it.
#[derive(Debug, Clone, PartialEq)]
pub struct MapRun {
    /// Start of the recording, UTC, s.
    pub started_at: f64,
    /// Motion since the start; rising, not overlapping.
    pub spans: Vec<CycleMotion>,
    /// Plateaus of the friction stages, times since the start, s.
    pub points: Vec<FrictionPoint>,
}

/// One joint's friction over all runs, ready to be fitted. Times rise.
#[derive(Debug, Clone)]
pub(super) struct JointRecord {
    pub joint: JointIndex,
    pub spans: Vec<MotionSpan>,
    pub levels: Vec<f64>,
    pub points: Vec<RecordPoint>,
    pub measured: Measured,
    /// Why something measured is not used, in sentences.
    pub remarks: Vec<String>,
}

/// One friction mean in its run.
#[derive(Debug, Clone, Copy)]
pub(super) struct RecordPoint {
    pub run: usize,
    /// Since the epoch of the history, s.
    pub time: f64,
    /// Place in the levels.
    pub level: usize,
    pub torque: f64,
    /// Whether the run is long enough to take part in the map.
    pub in_map: bool,
    /// What the run has beyond the law: coldness, and friction as a factor.
    pub offset: f64,
    pub factor: f64,
}

impl JointRecord {
    /// Points that the map is made of, each with what belongs to it in `of_points`.
    pub(super) fn in_map<'a, T>(
        &'a self,
        of_points: &'a [T],
    ) -> impl Iterator<Item = (&'a RecordPoint, &'a T)> {
        self.points.iter().zip(of_points).filter(|(p, _)| p.in_map)
    }

    pub(super) fn map_points(&self) -> usize {
        self.points.iter().filter(|p| p.in_map).count()
    }
}

impl RecordPoint {
    /// Torque without the run's own factor.
    pub(super) fn healthy(&self) -> f64 {
        self.torque / self.factor
    }
}

/// What was measured of the thermal state of a joint.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) enum Measured {
    /// Nothing that could be used.
    #[default]
    Nothing,
    /// The motor's temperature.
    Motor(MotorScale),
    /// The hall's.
    Hall(Hall),
}

/// Temperature of a motor as coldness.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MotorScale {
    /// Temperatures that count as warm and as cold, K.
    pub warm: f64,
    pub cold: f64,
    /// Mean temperature of the cycles of each run: middle of the cycle since the epoch of the history, s, and K.
    pub(super) readings: Vec<Vec<[f64; 2]>>,
}

/// The hall in each run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Hall {
    /// The usual temperature, K.
    pub usual: f64,
    /// How far each run's is below it, K; 0 for a run that has none.
    pub colder: Vec<f64>,
}

impl MotorScale {
    /// Coldness at `time` in run `run`: 0 at the warm temperature, 1 at the cold one.
    pub fn coldness(&self, run: usize, time: f64) -> f64 {
        let kelvin = self.readings.get(run).and_then(|readings| reading_at(readings, time));
        kelvin.map_or(f64::NAN, |kelvin| (self.warm - kelvin) / (self.warm - self.cold))
    }
}

/// The temperature at `time` on the line through the readings next to it, beyond the first and last one as well:
/// a first cycle warms all along. By at most one distance of readings.
pub(super) fn reading_at(readings: &[[f64; 2]], time: f64) -> Option<f64> {
    if readings.len() < 2 {
        return readings.first().map(|[_, kelvin]| *kelvin);
    }
    let after = readings.partition_point(|[at, _]| *at < time).clamp(1, readings.len() - 1);
    let ([from, before], [to, next]) = (readings[after - 1], readings[after]);
    let share = ((time - from) / (to - from)).clamp(-1.0, 2.0);
    Some(before + share * (next - before))
}
