//! A column for each stage.

use super::kind::{StageCells, StageKind};
use crate::layout::column::Column;
use crate::layout::column_names::ColumnNames;
use crate::toml::table::Table;
use armwatch_model::run::{Stage, StageReading};

/// Words for yes and for no, in any case.
const YES: [&str; 4] = ["1", "true", "on", "yes"];
const NO: [&str; 4] = ["0", "false", "off", "no"];

/// A column for each stage; 1 or a word for yes marks the stage. A row without a mark is between stages.
#[derive(Debug, Clone, PartialEq)]
pub struct OneHot {
    /// Stages with their columns.
    pub columns: Vec<(Stage, Column)>,
}

impl OneHot {
    /// Reads the names of the columns.
    pub(super) fn read(table: &Table<'_>, names: &mut ColumnNames) -> Option<Self> {
        let excitation = table.required("excitation");
        let others = [(Stage::Friction, "friction"), (Stage::Warming, "warming")];
        let others = others.map(|(stage, key)| (stage, table.optional(key)));
        let mut columns = vec![(Stage::Excitation, names.take(&excitation?)?)];
        for (stage, value) in others {
            if let Some(value) = value {
                columns.push((stage, names.take(&value)?));
            }
        }
        Some(Self { columns })
    }
}

impl StageKind for OneHot {
    fn columns(&self) -> Vec<&Column> {
        self.columns.iter().map(|(_, column)| column).collect()
    }

    fn has_words(&self) -> bool {
        true
    }

    fn word_number(&self, word: &str) -> Option<f64> {
        let is = |words: &[&str]| words.iter().any(|known| word.eq_ignore_ascii_case(known));
        if is(&YES) || word.parse() == Ok(1.0) {
            Some(1.0)
        } else if is(&NO) || word.parse() == Ok(0.0) {
            Some(0.0)
        } else {
            None
        }
    }

    fn words_wanted(&self) -> String {
        "neither yes nor no: 1, true, on or yes, 0, false, off or no".into()
    }

    fn may_continue(&self, cell: &str) -> bool {
        YES.iter().chain(&NO).any(|word| word.len() > cell.len() && word.starts_with(cell))
    }

    fn is_exclusive(&self) -> bool {
        true
    }

    fn reading(&self, columns: Vec<Vec<f64>>, rows: usize) -> Option<StageReading> {
        let mut stages = vec![Stage::Between; rows];
        for ((of, _), flags) in self.columns.iter().zip(columns) {
            for (stage, flag) in stages.iter_mut().zip(flags) {
                match (flag != 0.0, *stage) {
                    (false, _) => {}
                    (true, Stage::Between) => *stage = *of,
                    (true, _) => return None,
                }
            }
        }
        Some(StageReading::Known(stages))
    }

    fn cells(&self) -> Option<Vec<(&Column, StageCells)>> {
        let texts = |of: Stage| Stage::ALL.map(|stage| u8::from(stage == of).to_string());
        let cells = self.columns.iter().map(|(of, column)| (column, StageCells::Texts(texts(*of))));
        (self.columns.len() >= Stage::ANALYSED.len()).then(|| cells.collect())
    }
}
