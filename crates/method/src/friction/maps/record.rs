//! Input of the friction fit: the runs of a robot, the friction points of each joint, and the temperatures measured
//! with them.

use super::thermal_state::MotionSpan;
use armwatch_model::robot::JointIndex;

/// Friction of one joint over all runs, for the fit of its map.
#[derive(Debug, Clone)]
pub(in crate::friction) struct JointRecord {
    pub joint: JointIndex,
    /// Motion of all runs, ascending.
    pub spans: Vec<MotionSpan>,
    /// Speed levels, as fractions of the joint's largest speed, ascending.
    pub levels: Vec<f64>,
    /// Friction points of all runs, in ascending time.
    pub points: Vec<RecordPoint>,
    pub sensor: ThermalSensor,
    /// Reasons why a recorded temperature is not used, in sentences.
    pub remarks: Vec<String>,
}

/// Mean friction at one level at one time of a run.
#[derive(Debug, Clone, Copy)]
pub(in crate::friction) struct RecordPoint {
    pub run: usize,
    /// Time since the epoch of the history, s.
    pub time: f64,
    /// Index into [`JointRecord::levels`].
    pub level: usize,
    /// Mean of the magnitudes of both directions, scaled by `jump`, Nm.
    pub torque: f64,
    /// Factor in `torque` that corrects for a jump of friction later in the run; one without a jump.
    pub jump: f64,
    /// True if the run is long enough for its points to enter the map.
    pub in_map: bool,
    /// Thermal deficit at this time beyond the law's, from the run's random effects.
    pub offset: f64,
    /// Friction of the run as a multiple of that of the baseline.
    pub factor: f64,
}

impl JointRecord {
    /// Points that enter the map, each with the item of `of_points` at the same index.
    pub(in crate::friction) fn in_map<'a, T>(
        &'a self,
        of_points: &'a [T],
    ) -> impl Iterator<Item = (&'a RecordPoint, &'a T)> {
        self.points.iter().zip(of_points).filter(|(p, _)| p.in_map)
    }

    /// Number of points that enter the map.
    pub(super) fn map_points(&self) -> usize {
        self.points.iter().filter(|p| p.in_map).count()
    }
}

impl RecordPoint {
    /// Torque divided by the run's factor, Nm.
    pub(in crate::friction) fn healthy(&self) -> f64 {
        self.torque / self.factor
    }
}

/// Temperature that determines the thermal state of a joint, in addition to its motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::friction) enum ThermalSensor {
    /// No usable temperature.
    #[default]
    None,
    /// Temperature of the joint's motor.
    Motor(MotorTemperatures),
    /// Ambient temperature.
    Ambient(AmbientTemperatures),
}

/// Temperature of a motor over the history, with the scale of its thermal deficit.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::friction) struct MotorTemperatures {
    /// Temperature of a thermal deficit of 0, K.
    pub warm: f64,
    /// Temperature of a thermal deficit of 1, K.
    pub cold: f64,
    /// Readings of each run, one per cycle: middle of the cycle since the epoch of the history, s, and mean
    /// temperature, K.
    pub readings: Vec<Vec<[f64; 2]>>,
}

/// Ambient temperature of each run.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::friction) struct AmbientTemperatures {
    /// Median over the runs, K.
    pub usual: f64,
    /// Usual temperature minus that of each run, K; 0 for a run without a reading.
    pub below_usual: Vec<f64>,
}

impl ThermalSensor {
    /// Copy with the scale but without the readings of any run.
    pub(in crate::friction) fn without_readings(&self) -> Self {
        match self {
            Self::None => Self::None,
            Self::Motor(motor) => Self::Motor(MotorTemperatures { readings: Vec::new(), ..*motor }),
            Self::Ambient(ambient) => {
                Self::Ambient(AmbientTemperatures { below_usual: Vec::new(), ..*ambient })
            }
        }
    }
}

impl MotorTemperatures {
    /// Thermal deficit `(warm - T) / (warm - cold)` at `time`, s, in run `run`; NaN for a run without readings.
    pub(super) fn thermal_deficit(&self, run: usize, time: f64) -> f64 {
        let kelvin = self.readings.get(run).and_then(|readings| reading_at(readings, time));
        kelvin.map_or(f64::NAN, |kelvin| (self.warm - kelvin) / (self.warm - self.cold))
    }
}

/// Temperature at `time` on the line through the two readings around it; `None` without readings.
///
/// A time outside all readings is extrapolated by at most one distance of readings, because a joint still warms in the
/// first half of its first cycle. A single reading counts at all times.
pub(super) fn reading_at(readings: &[[f64; 2]], time: f64) -> Option<f64> {
    if readings.len() < 2 {
        return readings.first().map(|[_, kelvin]| *kelvin);
    }
    let after = readings.partition_point(|[at, _]| *at < time).clamp(1, readings.len() - 1);
    let ([from, before], [to, next]) = (readings[after - 1], readings[after]);
    let share = ((time - from) / (to - from)).clamp(-1.0, 2.0);
    Some(before + share * (next - before))
}

/// Runs of the points, ascending and unique.
pub(in crate::friction) fn runs_of<'a>(points: impl Iterator<Item = &'a RecordPoint>) -> Vec<usize> {
    let mut runs: Vec<usize> = points.map(|p| p.run).collect();
    runs.sort_unstable();
    runs.dedup();
    runs
}
