//! Whole numbers in a column.

use super::kind::{StageCells, StageKind};
use super::lists::{read_list, refuse_known};
use crate::layout::column::Column;
use crate::toml::table::Table;
use armwatch_model::run::{Stage, StageReading};

/// Which values of a column mean which stage; any other value is an error.
#[derive(Debug, Clone, PartialEq)]
pub struct StageSignal {
    /// The column.
    pub column: Column,
    /// Values of the excitation stage.
    pub excitation: Vec<i64>,
    /// Values of the friction stage.
    pub friction: Vec<i64>,
    /// Values of the warming stage.
    pub warming: Vec<i64>,
    /// Values between stages; a value that is in no list is an error.
    pub between: Vec<i64>,
}

impl StageSignal {
    /// Reads a list of values a stage.
    pub(super) fn read(table: &Table<'_>, column: Option<Column>) -> Option<Self> {
        let mut taken: Vec<(i64, &str)> = Vec::new();
        let mut values = |key| {
            read_list(table, key, |item| {
                let value = item.integer(-1_000_000..=1_000_000)?;
                refuse_known(item, &value, key, &mut taken)
            })
        };
        let (between, excitation) = (values("between"), values("excitation"));
        let (friction, warming) = (values("friction"), values("warming"));
        Some(Self {
            column: column?,
            excitation: excitation?,
            friction: friction?,
            warming: warming?,
            between: between?,
        })
    }

    /// The stage that a value means.
    fn stage_of(&self, value: f64) -> Option<Stage> {
        let lists = [
            (&self.between, Stage::Between),
            (&self.excitation, Stage::Excitation),
            (&self.friction, Stage::Friction),
            (&self.warming, Stage::Warming),
        ];
        // whole numbers of six digits at most are doubles
        let has = |list: &[i64]| list.iter().any(|known| *known as f64 == value);
        lists.into_iter().find(|(list, _)| has(list)).map(|(_, stage)| stage)
    }
}

impl StageKind for StageSignal {
    fn columns(&self) -> Vec<&Column> {
        vec![&self.column]
    }

    fn refusal(&self, value: f64) -> Option<String> {
        self.stage_of(value).is_none().then(|| "not a known stage".into())
    }

    fn may_continue(&self, cell: &str) -> bool {
        let lists = [&self.between, &self.excitation, &self.friction, &self.warming];
        let longer = |value: &i64| {
            let text = value.to_string();
            text.len() > cell.len() && text.starts_with(cell)
        };
        lists.into_iter().flatten().any(longer)
    }

    fn reading(&self, columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        // A stage lasts for thousands of rows: the value of the row before is nearly always this one.
        let mut last = None;
        let stage = |value: f64| match last {
            Some((known, stage)) if known == value => Some(stage),
            _ => {
                let stage = self.stage_of(value)?;
                last = Some((value, stage));
                Some(stage)
            }
        };
        columns.into_iter().next()?.into_iter().map(stage).collect::<Option<_>>().map(StageReading::Known)
    }

    fn cells(&self) -> Option<Vec<(&Column, StageCells)>> {
        let first = |list: &[i64]| list.first().map(ToString::to_string);
        let texts =
            [first(&self.between)?, first(&self.excitation)?, first(&self.friction)?, first(&self.warming)?];
        Some(vec![(&self.column, StageCells::Texts(texts))])
    }
}
