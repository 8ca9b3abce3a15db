//! The columns of an export in any layout: content, unit, and side of the gears.

use std::io::Write;

use crate::run::recording::RecordedRow;
use armwatch_model::run::Stage;

/// Columns of an export in their order. Numbers are written with all digits, so that the same run in two formats is the
/// same recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportFormat {
    /// Separator between columns.
    pub delimiter: u8,
    /// True if the first line names the columns.
    pub header: bool,
    /// The columns.
    pub columns: Vec<ExportColumn>,
}

/// One column.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportColumn {
    /// Name in the header.
    pub name: String,
    /// Its content.
    pub cell: ColumnContent,
}

/// Content of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum ColumnContent {
    /// Time since the start of the run, in units of 1 / this value of a second.
    Time(f64),
    /// Positions of the joints as the controller counts them.
    Position(JointWeights),
    /// Their velocities.
    Velocity(JointWeights),
    /// Their torques.
    Torque(JointWeights),
    /// Stage signal: values for between stages, excitation, friction and warming.
    Stage([i64; 4]),
    /// Stage signal in words, in the same order.
    StageWord([String; 4]),
    /// 1 during a stage, otherwise 0.
    StageFlag(Stage),
    /// Analogue stage signal: levels in the same order, and the largest deviation from them; occasionally a row shows
    /// another level.
    StageLevel {
        /// The levels.
        levels: [f64; 4],
        /// Largest deviation from the level.
        noise: f64,
    },
    /// Cycle counter.
    Cycle,
    /// Joint under friction test, from 1; 0 outside.
    FrictionJoint,
    /// Its speed level, from 1; 0 outside.
    FrictionLevel,
    /// Temperature of a joint's motor.
    MotorTemperature {
        /// Index of the joint, from 0.
        joint: usize,
        /// Unit.
        scale: TemperatureScale,
    },
    /// The ambient temperature.
    AmbientTemperature(TemperatureScale),
    /// Unused content.
    Unused,
}

/// A temperature scale: its value at 0 K, and its degrees per kelvin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemperatureScale {
    /// Value at 0 K.
    pub at_zero: f64,
    /// Degrees per kelvin.
    pub per_kelvin: f64,
}

impl TemperatureScale {
    fn of(self, kelvin: f64) -> f64 {
        self.at_zero + self.per_kelvin * kelvin
    }
}

/// One weight per joint for the sum of their signals: units, signs, gears and couplings in one.
#[derive(Debug, Clone, PartialEq)]
pub struct JointWeights(pub Vec<f64>);

impl JointWeights {
    fn of(&self, signals: &[f64]) -> f64 {
        self.0.iter().zip(signals).map(|(w, x)| w * x).sum::<f64>()
    }
}

impl ExportFormat {
    /// Appends the header line, if there is one.
    pub(super) fn push_header(&self, text: &mut Vec<u8>) {
        if self.header {
            let names: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
            text.extend_from_slice(names.join(&char::from(self.delimiter).to_string()).as_bytes());
            text.push(b'\n');
        }
    }

    /// Appends a row.
    pub(super) fn push_row(&self, text: &mut Vec<u8>, row: &RecordedRow) {
        for (place, column) in self.columns.iter().enumerate() {
            if place > 0 {
                text.push(self.delimiter);
            }
            // Writing to memory does not fail.
            let _ = match &column.cell {
                ColumnContent::Time(per_second) => write!(text, "{}", row.time * per_second),
                ColumnContent::Position(sum) => write!(text, "{}", sum.of(&row.position)),
                ColumnContent::Velocity(sum) => write!(text, "{}", sum.of(&row.velocity)),
                ColumnContent::Torque(sum) => write!(text, "{}", sum.of(&row.torque)),
                ColumnContent::Stage(values) => write!(text, "{}", values[stage_index(row.stage)]),
                ColumnContent::StageWord(words) => write!(text, "{}", words[stage_index(row.stage)]),
                ColumnContent::StageFlag(stage) => write!(text, "{}", u8::from(row.stage == *stage)),
                ColumnContent::StageLevel { levels, noise } => {
                    write!(text, "{:.4}", level(levels, *noise, stage_index(row.stage), row.time))
                }
                ColumnContent::Cycle => write!(text, "{}", row.cycle),
                ColumnContent::FrictionJoint => {
                    write!(text, "{}", row.signal.map_or(0, |s| s.joint.number()))
                }
                ColumnContent::FrictionLevel => write!(text, "{}", row.signal.map_or(0, |s| s.level)),
                ColumnContent::MotorTemperature { joint, scale } => {
                    write!(text, "{:.2}", scale.of(row.motor_temperature[*joint]))
                }
                ColumnContent::AmbientTemperature(scale) => {
                    write!(text, "{:.2}", scale.of(row.ambient_temperature))
                }
                ColumnContent::Unused => write!(text, "0"),
            };
        }
        text.push(b'\n');
    }
}

/// One row in this many shows a level of another stage.
const SPIKE_EVERY: u64 = 400;

/// An analogue level with noise and single spikes, which depend on the time alone: the same run has the same bytes.
fn level(levels: &[f64; 4], noise: f64, stage: usize, time: f64) -> f64 {
    // splitmix64, a mixer of bits without state
    let mut bits = time.to_bits().wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^= bits >> 31;
    let shown = if bits.is_multiple_of(SPIKE_EVERY) { (stage + 1) % levels.len() } else { stage };
    let uniform = (bits >> 11) as f64 / (1_u64 << 53) as f64;
    levels[shown] + noise * (2.0 * uniform - 1.0)
}

fn stage_index(stage: Stage) -> usize {
    match stage {
        Stage::Between => 0,
        Stage::Excitation => 1,
        Stage::Friction => 2,
        Stage::Warming => 3,
    }
}
