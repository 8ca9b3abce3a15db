//! What a stage signal is: one file a kind, with the keys that it reads and all that follows from them.

use crate::layout::column::Column;
use armwatch_model::run::stage_rule::StageRule;
use armwatch_model::run::{RunKind, Stage, StageReading};

/// The stages in the order in which cells of every kind list them.
pub(crate) const STAGES: [Stage; 4] = [Stage::Between, Stage::Excitation, Stage::Friction, Stage::Warming];

/// What a layout and the reading of its exports ask a stage signal.
///
/// `place` is that of a column in [`StageKind::columns`].
pub trait StageKind {
    /// The columns that it is read from.
    fn columns(&self) -> Vec<&Column> {
        Vec::new()
    }

    /// How rows get their stage once they are read.
    fn rule(&self) -> StageRule {
        StageRule::Recorded
    }

    /// Whether the cells of its columns are words; else they are numbers.
    fn has_words(&self) -> bool {
        false
    }

    /// The number that stands for a word without blanks around it; `None` for a word that means nothing.
    fn word_number(&self, _word: &str) -> Option<f64> {
        None
    }

    /// What a word that means nothing should have been, as a clause about its value.
    fn words_wanted(&self) -> String {
        String::new()
    }

    /// Why a finite number may not stand in its columns, as a clause about the value.
    fn refusal(&self, _value: f64) -> Option<String> {
        None
    }

    /// Whether a cell that was read could be the beginning of another one that may stand there.
    fn may_continue(&self, _cell: &str) -> bool {
        true
    }

    /// Whether no row may have more than one of its columns different from 0.
    fn is_exclusive(&self) -> bool {
        false
    }

    /// What its columns, `[columns][rows]`, say of the stages of `rows` rows; `None` if any number is refused.
    fn reading(&self, columns: Vec<Vec<f64>>, rows: usize) -> Option<StageReading>;

    /// What is said of a cycle whose stages no signal of the controller tells.
    fn remark(&self) -> Option<&'static str> {
        None
    }

    /// Whether stages follow from positions.
    fn needs_positions(&self) -> bool {
        false
    }

    /// What its recordings are.
    fn run_kind(&self) -> RunKind {
        RunKind::Test
    }

    /// What an export with all stages holds in each column; `None` if some stage has no cell.
    fn cells(&self) -> Option<Vec<(&Column, StageCells)>> {
        Some(Vec::new())
    }
}

/// Cells of a column: between stages, in excitation, in friction and in warming.
#[derive(Debug, Clone, PartialEq)]
pub enum StageCells {
    /// Numbers or words.
    Texts([String; 4]),
    /// Levels of an analogue signal.
    Levels {
        /// Middles of the ranges.
        levels: [f64; 4],
        /// Width of the narrowest range.
        narrowest: f64,
    },
}
