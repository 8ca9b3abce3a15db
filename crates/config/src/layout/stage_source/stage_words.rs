//! Words in a column.

use super::kind::{StageCells, StageKind};
use super::lists::{read_list, refuse_known};
use crate::layout::column::Column;
use crate::toml::table::Table;
use armwatch_model::run::{Stage, StageReading};

/// Which words of a column mean which stage, blanks around them aside; any other word is an error.
#[derive(Debug, Clone, PartialEq)]
pub struct StageWords {
    /// The column.
    pub column: Column,
    /// Words with their stages.
    pub words: Vec<(String, Stage)>,
}

impl StageWords {
    /// Reads a list of words a stage.
    pub(super) fn read(table: &Table<'_>, column: Option<Column>) -> Option<Self> {
        let mut taken: Vec<(String, &str)> = Vec::new();
        let mut words = Vec::new();
        let lists = Stage::ALL.map(|stage| {
            read_list(table, stage.name(), |item| {
                let word = item.any_text()?.trim().to_owned();
                refuse_known(item, &word, stage.name(), &mut taken)
            })
        });
        for (stage, list) in Stage::ALL.into_iter().zip(lists) {
            words.extend(list?.into_iter().map(|word| (word, stage)));
        }
        Some(Self { column: column?, words })
    }
}

impl StageKind for StageWords {
    fn columns(&self) -> Vec<&Column> {
        vec![&self.column]
    }

    fn has_words(&self) -> bool {
        true
    }

    fn word_number(&self, word: &str) -> Option<f64> {
        self.words.iter().find(|(known, _)| known == word).map(|(_, stage)| f64::from(*stage as u8))
    }

    fn words_wanted(&self) -> String {
        let words: Vec<String> = self.words.iter().map(|(word, _)| format!("\"{word}\"")).collect();
        format!("not a known stage: the layout has {}", words.join(", "))
    }

    fn may_continue(&self, cell: &str) -> bool {
        self.words.iter().any(|(word, _)| word.len() > cell.len() && word.starts_with(cell))
    }

    fn reading(&self, columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        let stage = |number: f64| Stage::ALL.into_iter().find(|of| f64::from(*of as u8) == number);
        columns.into_iter().next()?.into_iter().map(stage).collect::<Option<_>>().map(StageReading::Known)
    }

    fn cells(&self) -> Option<Vec<(&Column, StageCells)>> {
        let word =
            |stage: Stage| self.words.iter().find(|(_, of)| *of == stage).map(|(word, _)| word.clone());
        let [between, excitation, friction, warming] = Stage::ALL.map(word);
        let texts = [between?, excitation?, friction?, warming?];
        Some(vec![(&self.column, StageCells::Texts(texts))])
    }
}
