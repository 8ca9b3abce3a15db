//! Rules that assign stages to rows.

use super::Stage;

/// Source of a row's stage.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum StageRule {
    /// From the export: it is [`StageReading::Known`](super::StageReading::Known) already.
    #[default]
    Recorded,
    /// From the level of an analogue signal.
    Levels(LevelSettings),
    /// From the motion.
    Motion,
    /// Only from time.
    Schedule(Schedule),
    /// None: a recording without stages is analysed window by window.
    Windows {
        /// Duration of a window, s.
        window: f64,
    },
}

/// Levels of an analogue stage signal, in the unit of the export.
#[derive(Debug, Clone, PartialEq)]
pub struct LevelSettings {
    /// Stages and their ranges, lower and upper end included; ranges do not overlap.
    pub ranges: Vec<(Stage, [f64; 2])>,
    /// Tolerance of the signal outside the range of the present stage.
    pub hysteresis: f64,
    /// Least duration of another level that is another stage, s. The stage then begins at its first row.
    pub debounce: f64,
}

impl LevelSettings {
    /// The stage of a level that follows `present`; `None` if no stage's range contains it.
    #[must_use]
    pub fn stage_of(&self, level: f64, present: Stage) -> Option<Stage> {
        let inside = |stage: Stage, margin: f64| {
            let of_stage = self.ranges.iter().filter(|(of, _)| *of == stage);
            of_stage.into_iter().any(|(_, [low, high])| *low - margin <= level && level <= *high + margin)
        };
        if inside(present, self.hysteresis) {
            return Some(present);
        }
        self.ranges.iter().map(|(stage, _)| *stage).find(|stage| inside(*stage, 0.0))
    }
}

/// A sequence of stages that repeats from the start of the recording on.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    /// Time before the first cycle, s.
    pub start: f64,
    /// Stages with their durations, s, in the order of a cycle.
    pub sequence: Vec<(Stage, f64)>,
}

impl Schedule {
    /// Number of the cycle, from 1, and stage at `time` since the first row, s; before the start cycle 0.
    #[must_use]
    pub fn at(&self, time: f64) -> (u32, Stage) {
        let period: f64 = self.sequence.iter().map(|(_, duration)| duration).sum();
        let since = time - self.start;
        if since < 0.0 || period <= 0.0 {
            return (0, Stage::Between);
        }
        let cycle = (since / period).floor();
        let mut rest = since - cycle * period;
        let stage = self.sequence.iter().find_map(|(stage, duration)| {
            rest -= duration;
            (rest < 0.0).then_some(*stage)
        });
        // the cast saturates; no recording has four thousand million cycles
        (cycle as u32 + 1, stage.unwrap_or(Stage::Between))
    }
}
