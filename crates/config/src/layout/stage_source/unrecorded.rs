//! Stages without a column: from the motion, from a schedule, the same in the whole recording, or none.

use super::kind::StageKind;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::run::stage_rule::{Schedule, StageRule};
use armwatch_model::run::{RunKind, Stage, StageReading};

/// Most parts of a declared cycle.
const MAX_SEQUENCE: usize = 100;

/// Parts of a declared cycle.
const DURATION: Limits = Limits::above(0.0, 86_400.0, "s");

/// Time before the first declared cycle.
const START: Limits = Limits::between(0.0, 86_400.0, "s");

/// Windows of production: long enough for the low-pass and a motion, short enough for memory: ten minutes at 1 kHz are
/// 600,000 rows.
const WINDOW: Limits = Limits::between(5.0, 600.0, "s");

/// Default window, s.
pub(super) const USUAL_WINDOW_S: f64 = 60.0;

/// Stages from the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FromMotion;

impl StageKind for FromMotion {
    fn rule(&self) -> StageRule {
        StageRule::Motion
    }

    fn reading(&self, _columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        Some(StageReading::Unknown)
    }

    fn remark(&self) -> Option<&'static str> {
        Some("stages come from the motion, not from a signal of the controller")
    }

    fn needs_positions(&self) -> bool {
        true
    }
}

impl StageKind for Schedule {
    fn rule(&self) -> StageRule {
        StageRule::Schedule(self.clone())
    }

    fn reading(&self, _columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        Some(StageReading::Unknown)
    }

    fn remark(&self) -> Option<&'static str> {
        Some("stages come from the layout's schedule, not from a signal of the controller")
    }
}

/// One stage in the whole recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WholeRecording(pub Stage);

impl StageKind for WholeRecording {
    fn reading(&self, _columns: Vec<Vec<f64>>, rows: usize) -> Option<StageReading> {
        Some(StageReading::Known(vec![self.0; rows]))
    }
}

/// A recording of production in windows of this duration, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Windows(pub f64);

impl StageKind for Windows {
    fn rule(&self) -> StageRule {
        StageRule::Windows { window: self.0 }
    }

    fn reading(&self, _columns: Vec<Vec<f64>>, _rows: usize) -> Option<StageReading> {
        Some(StageReading::Unknown)
    }

    fn run_kind(&self) -> RunKind {
        RunKind::Production
    }
}

/// Reads the duration of windows.
pub(super) fn read_windows(table: &Table<'_>) -> Option<Windows> {
    table.number_or("window_s", &WINDOW, USUAL_WINDOW_S).map(Windows)
}

/// Reads the one stage.
pub(super) fn read_whole(value: &Value<'_>) -> Option<WholeRecording> {
    let given = value.text()?;
    let found = Stage::ANALYSED.into_iter().find(|stage| stage.name() == given);
    if found.is_none() {
        value.refuse("must be \"excitation\", \"friction\" or \"warming\"".into(), None);
    }
    found.map(WholeRecording)
}

/// Reads a declared cycle.
pub(super) fn read_schedule(table: &Table<'_>) -> Option<Schedule> {
    let start = table.number_or("start_s", &START, 0.0);
    let list = table.required("sequence");
    let durations = table.required("durations_s");
    let list = list?;
    let items = list.items()?;
    if items.is_empty() || items.len() > MAX_SEQUENCE {
        list.refuse(format!("must have 1 to {MAX_SEQUENCE} entries"), None);
        return None;
    }
    let stages: Vec<Stage> = items.iter().map(read_named).collect::<Option<_>>()?;
    if !stages.contains(&Stage::Excitation) {
        list.refuse("must have \"excitation\": parameters are identified on it".into(), None);
        return None;
    }
    let durations = durations?.numbers(Some(stages.len()), &DURATION)?;
    Some(Schedule { start: start?, sequence: stages.into_iter().zip(durations).collect() })
}

fn read_named(value: &Value<'_>) -> Option<Stage> {
    let given = value.text()?;
    let found = Stage::ALL.into_iter().find(|stage| stage.name() == given);
    if found.is_none() {
        value.refuse("must be \"between\", \"excitation\", \"friction\" or \"warming\"".into(), None);
    }
    found
}
