//! Where the stage of a row comes from, as a layout says it.

use super::column::Column;
use crate::numerics::segment::stages::{LevelSettings, Schedule, StageRule};
use crate::run::{RunKind, Stage};

/// Where the stage of a row comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum StageSource {
    /// Whole numbers in a column.
    Signal(StageSignal),
    /// Words in a column.
    Words(StageWords),
    /// A column for each stage.
    OneHot(OneHot),
    /// The level of an analogue signal in a column.
    Levels(StageLevels),
    /// The motion; no column says it.
    Motion,
    /// A sequence with durations; no column says it.
    Schedule(Schedule),
    /// The whole recording is one stage.
    Whole(Stage),
    /// None: a recording of production, taken in windows of this duration, s.
    Production(f64),
}

impl StageSource {
    /// The columns that it is read from.
    #[must_use]
    pub fn columns(&self) -> Vec<&Column> {
        match self {
            Self::Signal(signal) => vec![&signal.column],
            Self::Words(words) => vec![&words.column],
            Self::Levels(levels) => vec![&levels.column],
            Self::OneHot(one_hot) => one_hot.columns.iter().map(|(_, column)| column).collect(),
            Self::Motion | Self::Schedule(_) | Self::Whole(_) | Self::Production(_) => Vec::new(),
        }
    }

    /// Whether a row says its stage, or the layout the stage of all of them; otherwise it is found later.
    #[must_use]
    pub fn is_recorded(&self) -> bool {
        self.rule() == StageRule::Recorded
    }

    /// How rows get their stage once they are read.
    #[must_use]
    pub fn rule(&self) -> StageRule {
        match self {
            Self::Signal(_) | Self::Words(_) | Self::OneHot(_) | Self::Whole(_) => StageRule::Recorded,
            Self::Levels(levels) => StageRule::Levels(levels.settings.clone()),
            Self::Motion => StageRule::Motion,
            Self::Schedule(schedule) => StageRule::Schedule(schedule.clone()),
            Self::Production(window) => StageRule::Windows { window: *window },
        }
    }

    /// What is said of a cycle whose stages no signal of the controller tells.
    #[must_use]
    pub fn remark(&self) -> Option<&'static str> {
        match self {
            Self::Motion => Some("stages come from the motion, not from a signal of the controller"),
            Self::Schedule(_) => {
                Some("stages come from the layout's schedule, not from a signal of the controller")
            }
            _ => None,
        }
    }

    /// What its recordings are.
    #[must_use]
    pub fn run_kind(&self) -> RunKind {
        match self {
            Self::Production(_) => RunKind::Production,
            _ => RunKind::Test,
        }
    }
}

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

/// Which words of a column mean which stage, blanks around them aside; any other word is an error.
#[derive(Debug, Clone, PartialEq)]
pub struct StageWords {
    /// The column.
    pub column: Column,
    /// Words with their stages.
    pub words: Vec<(String, Stage)>,
}

/// A column for each stage, in which 1 or a word for yes says that it goes on; no column: between stages.
#[derive(Debug, Clone, PartialEq)]
pub struct OneHot {
    /// Stages with their columns.
    pub columns: Vec<(Stage, Column)>,
}

/// An analogue signal.
#[derive(Debug, Clone, PartialEq)]
pub struct StageLevels {
    /// The column.
    pub column: Column,
    /// Its levels.
    pub settings: LevelSettings,
}
