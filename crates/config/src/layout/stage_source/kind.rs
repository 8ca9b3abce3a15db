//! Interface of stage signals: one file per kind, with the keys that it reads and everything that depends on them.

use crate::layout::column::Column;
use armwatch_model::run::stage_rule::StageRule;
use armwatch_model::run::{RunKind, StageReading};

/// Interface of a stage signal for a layout and the reading of its exports.
///
/// `place` is the index of a column in [`StageKind::columns`].
pub trait StageKind {
    /// The columns of the signal.
    fn columns(&self) -> Vec<&Column> {
        Vec::new()
    }

    /// Rule that gives rows their stage after reading.
    fn rule(&self) -> StageRule {
        StageRule::Recorded
    }

    /// True if the cells of its columns are words; otherwise they are numbers.
    fn has_words(&self) -> bool {
        false
    }

    /// The number of a word without blanks around it; `None` for a word without a meaning.
    fn word_number(&self, _word: &str) -> Option<f64> {
        None
    }

    /// The valid words, as a clause about the value of an invalid one.
    fn words_wanted(&self) -> String {
        String::new()
    }

    /// Why a finite number is invalid in its columns, as a clause about the value.
    fn refusal(&self, _value: f64) -> Option<String> {
        None
    }

    /// True if a cell could be the beginning of another valid one.
    fn may_continue(&self, _cell: &str) -> bool {
        true
    }

    /// True if at most one of its columns may differ from 0 in each row.
    fn is_exclusive(&self) -> bool {
        false
    }

    /// The stages of `rows` rows from its columns, `[columns][rows]`; `None` if any number is refused.
    fn reading(&self, columns: Vec<Vec<f64>>, rows: usize) -> Option<StageReading>;

    /// Remark about a cycle whose stages come from no signal of the controller.
    fn remark(&self) -> Option<&'static str> {
        None
    }

    /// True if stages follow from positions.
    fn needs_positions(&self) -> bool {
        false
    }

    /// Kind of its recordings.
    fn run_kind(&self) -> RunKind {
        RunKind::Test
    }

    /// Cells of each column for an export with all stages; `None` if some stage has no cell.
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
