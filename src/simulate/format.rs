//! The columns of an export in any layout: what stands in each, in which unit and on which side of the
//! gears.

use std::io::Write;

use super::recording::Row;
use crate::run::Stage;

/// Columns of an export in their order. Numbers are written with all their digits, so that the same run
/// in two formats is the same recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportFormat {
    /// Separator between columns.
    pub delimiter: u8,
    /// Whether the first line names the columns.
    pub header: bool,
    /// The columns.
    pub columns: Vec<ExportColumn>,
}

/// One column.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportColumn {
    /// Name in the header.
    pub name: String,
    /// What stands in it.
    pub cell: Cell,
}

/// What stands in a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Time since the start of the run, in units of which a second has this many.
    Time(f64),
    /// Positions of the joints.
    Position(Weighted),
    /// Their velocities.
    Velocity(Weighted),
    /// Their torques.
    Torque(Weighted),
    /// Stage signal: values for between stages, excitation, friction and warming.
    Stage([i64; 4]),
    /// Cycle counter.
    Cycle,
    /// Joint under friction test, from 1; 0 outside.
    FrictionJoint,
    /// Its speed level, from 1; 0 outside.
    FrictionLevel,
    /// Nothing that anybody reads.
    Unused,
}

/// A weighted sum of the joints' signals: units, signs, gears and couplings in one.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighted {
    /// One weight a joint.
    pub weights: Vec<f64>,
    /// Added to the sum.
    pub constant: f64,
}

impl Weighted {
    fn of(&self, signals: &[f64]) -> f64 {
        self.constant + self.weights.iter().zip(signals).map(|(w, x)| w * x).sum::<f64>()
    }
}

impl ExportFormat {
    /// Appends the header line, if there is to be one.
    pub(super) fn push_header(&self, text: &mut Vec<u8>) {
        if self.header {
            let names: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
            text.extend_from_slice(names.join(&char::from(self.delimiter).to_string()).as_bytes());
            text.push(b'\n');
        }
    }

    /// Appends a row.
    pub(super) fn push_row(&self, text: &mut Vec<u8>, row: &Row) {
        for (place, column) in self.columns.iter().enumerate() {
            if place > 0 {
                text.push(self.delimiter);
            }
            // Writing to memory does not fail.
            let _ = match &column.cell {
                Cell::Time(per_second) => write!(text, "{}", row.time * per_second),
                Cell::Position(sum) => write!(text, "{}", sum.of(&row.position)),
                Cell::Velocity(sum) => write!(text, "{}", sum.of(&row.velocity)),
                Cell::Torque(sum) => write!(text, "{}", sum.of(&row.torque)),
                Cell::Stage(values) => write!(text, "{}", values[stage_index(row.stage)]),
                Cell::Cycle => write!(text, "{}", row.cycle),
                Cell::FrictionJoint => write!(text, "{}", row.signal.map_or(0, |s| s.joint.number())),
                Cell::FrictionLevel => write!(text, "{}", row.signal.map_or(0, |s| s.level)),
                Cell::Unused => write!(text, "0"),
            };
        }
        text.push(b'\n');
    }
}

fn stage_index(stage: Stage) -> usize {
    match stage {
        Stage::Between => 0,
        Stage::Excitation => 1,
        Stage::Friction => 2,
        Stage::Warming => 3,
    }
}
