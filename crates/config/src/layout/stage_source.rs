//! The source of a row's stage: the section `[stage]` of a layout.
//!
//! Each kind of stage signal has one file, which implements [`StageKind`]. In addition, it has its variant, its key and
//! its row in [`StageSource::kind`] here, and its row in `docs/exports.md`.

pub(crate) mod kind;
mod lists;
mod numbers;
mod stage_words;
mod one_hot;
mod levels;
mod unrecorded;

pub use self::kind::{StageCells, StageKind};
pub use self::levels::StageLevels;
pub use self::numbers::StageSignal;
pub use self::one_hot::OneHot;
pub use self::stage_words::StageWords;
pub use self::unrecorded::{FromMotion, WholeRecording, Windows};

use self::unrecorded::{read_schedule, read_whole, read_windows};
use super::column_names::ColumnNames;
use crate::toml::table::Table;
use armwatch_model::run::stage_rule::Schedule;

/// The source of a row's stage.
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
    /// The motion, without a column.
    Motion(FromMotion),
    /// A sequence with durations, without a column.
    Schedule(Schedule),
    /// The whole recording is one stage.
    Whole(WholeRecording),
    /// None: a recording of production, divided into windows.
    Production(Windows),
}

impl StageSource {
    /// The common interface of this signal.
    pub fn kind(&self) -> &dyn StageKind {
        match self {
            Self::Signal(kind) => kind,
            Self::Words(kind) => kind,
            Self::OneHot(kind) => kind,
            Self::Levels(kind) => kind,
            Self::Motion(kind) => kind,
            Self::Schedule(kind) => kind,
            Self::Whole(kind) => kind,
            Self::Production(kind) => kind,
        }
    }
}

/// Reads a kind of signal; notes a missing key that it needs.
type Read = fn(&Table<'_>, &mut ColumnNames) -> Option<StageSource>;

/// The kinds that a layout can name, in the order of messages, with all keys that they read.
const KINDS: [(&str, Read, &[&str]); 6] = [
    ("signal", read_signal, &["column", "between", "excitation", "friction", "warming"]),
    (
        "one_hot",
        |table, names| OneHot::read(table, names).map(StageSource::OneHot),
        &["excitation", "friction", "warming"],
    ),
    (
        "levels",
        |table, names| StageLevels::read(table, names).map(StageSource::Levels),
        &["column", "between", "excitation", "friction", "warming", "hysteresis", "debounce_s"],
    ),
    ("motion", |_, _| Some(StageSource::Motion(FromMotion)), &[]),
    (
        "schedule",
        |table, _| read_schedule(table).map(StageSource::Schedule),
        &["sequence", "durations_s", "start_s"],
    ),
    ("production", |table, _| read_windows(table).map(StageSource::Production), &["window_s"]),
];

/// Reads the source of stages.
pub(crate) fn read_stage_source(table: &Table<'_>, names: &mut ColumnNames) -> Option<StageSource> {
    if let Some(value) = table.optional("whole_recording") {
        return read_whole(&value).map(StageSource::Whole);
    }
    let Some(kind) = table.optional("kind") else { return read_signal(table, names) };
    let given = kind.text()?;
    if let Some((_, read, _)) = KINDS.iter().find(|(name, ..)| *name == given) {
        return read(table, names);
    }
    let quoted: Vec<String> = KINDS.iter().map(|(name, ..)| format!("\"{name}\"")).collect();
    let (last, others) = quoted.split_last()?;
    kind.refuse(format!("must be {} or {last}", others.join(", ")), None);
    // the keys of an unknown kind are not separate mistakes
    KINDS.iter().flat_map(|(.., keys)| *keys).for_each(|key| drop(table.optional(key)));
    None
}

/// Reads a column of whole numbers or of words, which its lists distinguish.
fn read_signal(table: &Table<'_>, names: &mut ColumnNames) -> Option<StageSource> {
    let column = table.required("column").and_then(|value| names.take(&value));
    let words = table
        .optional("excitation")
        .and_then(|list| Some(list.is_array() && list.items()?.first()?.peek_text().is_some()));
    match words {
        Some(true) => StageWords::read(table, column).map(StageSource::Words),
        _ => StageSignal::read(table, column).map(StageSource::Signal),
    }
}

#[cfg(test)]
mod tests {
    use super::levels::USUAL_DEBOUNCE_S;
    use super::unrecorded::USUAL_WINDOW_S;
    use super::*;
    use crate::layout::channels::Layout;
    use crate::layout::column::Column;
    use crate::layout::layout_file::parse_layout;
    use armwatch_model::run::Stage;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    fn with_stage(section: &str) -> Result<Layout, crate::toml::problem::ConfigErrors> {
        let start = NATIVE.find("[stage]").expect("a section");
        let end = NATIVE.find("# Optional columns").expect("what follows");
        parse_layout("layout.toml", &format!("{}[stage]\n{section}\n{}", &NATIVE[..start], &NATIVE[end..]))
    }

    fn problems(section: &str) -> Vec<(String, String)> {
        let errors = with_stage(section).expect_err("a problem");
        errors.0.into_iter().map(|problem| (problem.key, problem.problem)).collect()
    }

    #[test]
    fn words_one_hot_columns_and_levels_are_read() {
        let words = "column = \"phase\"\nbetween = [\"\", \"IDLE\"]\nexcitation = [\"EXC\"]\n\
                     friction = [\"FRIC\"]\nwarming = []";
        let StageSource::Words(found) = with_stage(words).expect("no problems").stage else {
            panic!("words")
        };
        assert_eq!(found.words.len(), 4);
        assert_eq!(found.words[3], ("FRIC".to_owned(), Stage::Friction));
        let one_hot = "kind = \"one_hot\"\nexcitation = \"exc\"\nwarming = 21";
        let StageSource::OneHot(found) = with_stage(one_hot).expect("no problems").stage else {
            panic!("one hot")
        };
        let expected =
            [(Stage::Excitation, Column::Name("exc".into())), (Stage::Warming, Column::Number(21))];
        assert_eq!(found.columns, expected);
        let levels = "kind = \"levels\"\ncolumn = \"ai1\"\nbetween = [-1, 1]\nexcitation = [1.5, 3.5]\n\
                      hysteresis = 0.2";
        let StageSource::Levels(found) = with_stage(levels).expect("no problems").stage else {
            panic!("levels")
        };
        assert_eq!(found.settings.ranges, [(Stage::Between, [-1.0, 1.0]), (Stage::Excitation, [1.5, 3.5])]);
        assert_eq!((found.settings.hysteresis, found.settings.debounce), (0.2, USUAL_DEBOUNCE_S));
    }

    #[test]
    fn schedules_and_production_need_no_column() {
        let schedule = "kind = \"schedule\"\nsequence = [\"between\", \"excitation\"]\ndurations_s = [2, 20]";
        let StageSource::Schedule(found) = with_stage(schedule).expect("no problems").stage else {
            panic!("a schedule")
        };
        assert_eq!(found.sequence, [(Stage::Between, 2.0), (Stage::Excitation, 20.0)]);
        let production = with_stage("kind = \"production\"").expect("no problems").stage;
        assert_eq!(production, StageSource::Production(Windows(USUAL_WINDOW_S)));
    }

    #[test]
    fn what_contradicts_itself_is_named() {
        let overlap =
            "kind = \"levels\"\ncolumn = \"a\"\nbetween = [0, 2]\nexcitation = [1, 3]\nfriction = [9, 8]";
        let found = problems(overlap);
        assert!(found[0].0 == "stage.excitation" && found[0].1.contains("overlaps the range of between"));
        assert!(
            found[1].0 == "stage.friction" && found[1].1.contains("lower and then the upper"),
            "{found:?}"
        );
        let mixed = "column = \"a\"\nbetween = [0]\nexcitation = [\"E\"]\nfriction = []\nwarming = [\"E\"]";
        let found = problems(mixed);
        assert_eq!(found[0].0, "stage.between[1]");
        assert_eq!(found[1], ("stage.warming[1]".into(), "this value already means excitation".into()));
        assert_eq!(problems("kind = \"guess\"\ncolumn = \"a\"")[0].0, "stage.kind");
        let short = "kind = \"schedule\"\nsequence = [\"excitation\"]\ndurations_s = [1, 2]";
        assert_eq!(problems(short)[0].0, "stage.durations_s");
    }
}
