//! An analogue signal in a column.

use super::kind::{StageCells, StageKind};
use crate::layout::column::Column;
use crate::layout::column_names::ColumnNames;
use crate::toml::range::Limits;
use crate::toml::table::Table;
use armwatch_model::run::stage_rule::{LevelSettings, StageRule};
use armwatch_model::run::{Stage, StageReading};

/// Levels of an analogue signal, in whatever unit it is recorded.
const LEVEL: Limits = Limits::within(1e9, "");

/// Margin for leaving the range of a level.
const HYSTERESIS: Limits = Limits::between(0.0, 1e9, "");

/// Debounce time: a changed level must last this long, so that rows wait.
const DEBOUNCE: Limits = Limits::between(0.0, 10.0, "s");

/// Default debounce time, s: longer than relays chatter, far shorter than a stage.
pub(super) const USUAL_DEBOUNCE_S: f64 = 0.05;

/// An analogue signal.
#[derive(Debug, Clone, PartialEq)]
pub struct StageLevels {
    /// The column.
    pub column: Column,
    /// Its levels.
    pub settings: LevelSettings,
}

impl StageLevels {
    /// Reads the column, the ranges, and the conditions for leaving them.
    pub(super) fn read(table: &Table<'_>, names: &mut ColumnNames) -> Option<Self> {
        let column = table.required("column").and_then(|value| names.take(&value));
        let hysteresis = table.number_or("hysteresis", &HYSTERESIS, 0.0);
        let debounce = table.number_or("debounce_s", &DEBOUNCE, USUAL_DEBOUNCE_S);
        let mut ranges: Vec<(Stage, [f64; 2])> = Vec::new();
        let mut sound = true;
        for stage in Stage::ALL {
            let value = match stage {
                Stage::Between | Stage::Excitation => table.required(stage.name()),
                Stage::Friction | Stage::Warming => table.optional(stage.name()),
            };
            let Some(value) = value else { continue };
            let range = value.numbers(Some(2), &LEVEL).and_then(|ends| <[f64; 2]>::try_from(ends).ok());
            let Some([low, high]) = range else {
                sound = false;
                continue;
            };
            let other =
                ranges.iter().find(|(_, [other_low, other_high])| low <= *other_high && *other_low <= high);
            if low >= high {
                value.refuse("must be the lower and then the upper end of the range".into(), None);
                sound = false;
            } else if let Some((other, _)) = other {
                value.refuse(format!("overlaps the range of {other}"), None);
                sound = false;
            }
            ranges.push((stage, [low, high]));
        }
        let settings = LevelSettings { ranges, hysteresis: hysteresis?, debounce: debounce? };
        sound.then_some(Self { column: column?, settings })
    }
}

impl StageKind for StageLevels {
    fn columns(&self) -> Vec<&Column> {
        vec![&self.column]
    }

    fn rule(&self) -> StageRule {
        StageRule::Levels(self.settings.clone())
    }

    fn reading(&self, columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        let levels = columns.into_iter().next()?;
        levels.iter().all(|level| level.is_finite()).then_some(StageReading::Level(levels))
    }

    fn cells(&self) -> Option<Vec<(&Column, StageCells)>> {
        let range =
            |stage: Stage| self.settings.ranges.iter().find(|(of, _)| *of == stage).map(|(_, range)| *range);
        let [between, excitation, friction, warming] = Stage::ALL.map(range);
        let ranges = [between?, excitation?, friction?, warming?];
        let narrowest = ranges.iter().map(|[low, high]| high - low).fold(f64::INFINITY, f64::min);
        let levels = ranges.map(|[low, high]| 0.5 * (low + high));
        Some(vec![(&self.column, StageCells::Levels { levels, narrowest })])
    }
}
