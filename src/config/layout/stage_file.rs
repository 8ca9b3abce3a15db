//! The section `[stage]` of a layout.

use super::column::Column;
use super::column_names::ColumnNames;
use super::stage_source::{OneHot, StageLevels, StageSignal, StageSource, StageWords};
use crate::config::toml::range::Limits;
use crate::config::toml::table::{Table, Value};
use crate::numerics::segment::stages::{LevelSettings, Schedule};
use crate::run::Stage;

/// Most values of the stage signal that may mean one stage.
const MAX_STAGE_VALUES: usize = 100;

/// Most parts of a declared cycle.
const MAX_SEQUENCE: usize = 100;

/// Levels of an analogue signal, in whatever unit it is recorded.
const LEVEL: Limits = Limits::within(1e9, "");

/// How far a level may leave its range.
const HYSTERESIS: Limits = Limits::between(0.0, 1e9, "");

/// Rows of this time are held back.
const DEBOUNCE: Limits = Limits::between(0.0, 10.0, "s");

/// Parts of a declared cycle.
const DURATION: Limits = Limits::above(0.0, 86_400.0, "s");

/// Time before the first declared cycle.
const START: Limits = Limits::between(0.0, 86_400.0, "s");

/// Windows of production: long enough for the low-pass and a motion, short enough for memory: at 1 kHz
/// ten minutes are 600,000 rows.
const WINDOW: Limits = Limits::between(5.0, 600.0, "s");

/// Window unless configured, s.
const USUAL_WINDOW_S: f64 = 60.0;

/// Debounce unless configured, s: longer than relays chatter, far shorter than a stage.
const USUAL_DEBOUNCE_S: f64 = 0.05;

/// The stages that lists name, with their keys.
const STAGES: [Stage; 4] = [Stage::Between, Stage::Excitation, Stage::Friction, Stage::Warming];

/// Reads where stages come from.
pub(in crate::config) fn read_stage_source(
    table: &Table<'_>,
    names: &mut ColumnNames,
) -> Option<StageSource> {
    if let Some(value) = table.optional("whole_recording") {
        return read_whole(&value).map(StageSource::Whole);
    }
    let Some(kind) = table.optional("kind") else { return read_signal(table, names) };
    match kind.text()? {
        "signal" => read_signal(table, names),
        "one_hot" => read_one_hot(table, names).map(StageSource::OneHot),
        "levels" => read_levels(table, names).map(StageSource::Levels),
        "motion" => Some(StageSource::Motion),
        "schedule" => read_schedule(table).map(StageSource::Schedule),
        "production" => table.number_or("window_s", &WINDOW, USUAL_WINDOW_S).map(StageSource::Production),
        _ => {
            let kinds =
                "must be \"signal\", \"one_hot\", \"levels\", \"motion\", \"schedule\" or \"production\"";
            kind.refuse(kinds.into(), None);
            // the keys of a kind that is not understood are no mistakes of their own
            let keys = STAGES.map(Stage::name).into_iter();
            keys.chain([
                "column",
                "hysteresis",
                "debounce_s",
                "window_s",
                "sequence",
                "durations_s",
                "start_s",
            ])
            .for_each(|key| drop(table.optional(key)));
            None
        }
    }
}

fn read_whole(value: &Value<'_>) -> Option<Stage> {
    let given = value.text()?;
    let found = Stage::ANALYSED.into_iter().find(|stage| stage.name() == given);
    if found.is_none() {
        value.refuse("must be \"excitation\", \"friction\" or \"warming\"".into(), None);
    }
    found
}

/// A column of whole numbers or of words: its lists say which.
fn read_signal(table: &Table<'_>, names: &mut ColumnNames) -> Option<StageSource> {
    let column = table.required("column").and_then(|value| names.take(&value));
    let words = table
        .optional("excitation")
        .and_then(|list| Some(list.is_array() && list.items()?.first()?.peek_text().is_some()));
    match words {
        Some(true) => read_words(table, column).map(StageSource::Words),
        _ => read_numbers(table, column).map(StageSource::Signal),
    }
}

fn read_numbers(table: &Table<'_>, column: Option<Column>) -> Option<StageSignal> {
    let mut taken: Vec<(i64, &str)> = Vec::new();
    let mut values = |key| {
        read_list(table, key, |item| {
            let value = item.integer(-1_000_000..=1_000_000)?;
            refuse_known(item, &value, key, &mut taken)
        })
    };
    let (between, excitation) = (values("between"), values("excitation"));
    let (friction, warming) = (values("friction"), values("warming"));
    Some(StageSignal {
        column: column?,
        excitation: excitation?,
        friction: friction?,
        warming: warming?,
        between: between?,
    })
}

fn read_words(table: &Table<'_>, column: Option<Column>) -> Option<StageWords> {
    let mut taken: Vec<(String, &str)> = Vec::new();
    let mut words = Vec::new();
    let lists = STAGES.map(|stage| {
        read_list(table, stage.name(), |item| {
            let word = item.any_text()?.trim().to_owned();
            refuse_known(item, &word, stage.name(), &mut taken)
        })
    });
    for (stage, list) in STAGES.into_iter().zip(lists) {
        words.extend(list?.into_iter().map(|word| (word, stage)));
    }
    Some(StageWords { column: column?, words })
}

/// Refuses a value that means another stage already.
fn refuse_known<T: PartialEq + Clone>(
    item: &Value<'_>,
    value: &T,
    key: &'static str,
    taken: &mut Vec<(T, &'static str)>,
) -> Option<T> {
    if let Some((_, other)) = taken.iter().find(|(known, _)| known == value) {
        item.refuse(format!("this value already means {other}"), None);
        return None;
    }
    taken.push((value.clone(), key));
    Some(value.clone())
}

fn read_list<T>(
    table: &Table<'_>,
    key: &'static str,
    mut read: impl FnMut(&Value<'_>) -> Option<T>,
) -> Option<Vec<T>> {
    let list = table.required_or_else(key, || Some("write [] if the export has no such rows".into()))?;
    let items = list.items()?;
    if items.len() > MAX_STAGE_VALUES {
        list.refuse(format!("has {} entries, must have at most {MAX_STAGE_VALUES}", items.len()), None);
        return None;
    }
    let values: Vec<T> = items.iter().map(&mut read).collect::<Option<_>>()?;
    if key == "excitation" && values.is_empty() {
        list.refuse("must have an entry: parameters are identified on the excitation stage".into(), None);
        return None;
    }
    Some(values)
}

fn read_one_hot(table: &Table<'_>, names: &mut ColumnNames) -> Option<OneHot> {
    let excitation = table.required("excitation");
    let others = [(Stage::Friction, "friction"), (Stage::Warming, "warming")];
    let others = others.map(|(stage, key)| (stage, table.optional(key)));
    let mut columns = vec![(Stage::Excitation, names.take(&excitation?)?)];
    for (stage, value) in others {
        if let Some(value) = value {
            columns.push((stage, names.take(&value)?));
        }
    }
    Some(OneHot { columns })
}

fn read_levels(table: &Table<'_>, names: &mut ColumnNames) -> Option<StageLevels> {
    let column = table.required("column").and_then(|value| names.take(&value));
    let hysteresis = table.number_or("hysteresis", &HYSTERESIS, 0.0);
    let debounce = table.number_or("debounce_s", &DEBOUNCE, USUAL_DEBOUNCE_S);
    let mut ranges: Vec<(Stage, [f64; 2])> = Vec::new();
    let mut sound = true;
    for stage in STAGES {
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
    sound.then_some(StageLevels { column: column?, settings })
}

fn read_schedule(table: &Table<'_>) -> Option<Schedule> {
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
    let found = STAGES.into_iter().find(|stage| stage.name() == given);
    if found.is_none() {
        value.refuse("must be \"between\", \"excitation\", \"friction\" or \"warming\"".into(), None);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::layout::channels::Layout;
    use crate::config::layout::layout_file::parse_layout;

    const NATIVE: &str = include_str!("../../../config/exports/native.toml");

    fn with_stage(section: &str) -> Result<Layout, crate::config::toml::problem::ConfigErrors> {
        let start = NATIVE.find("[stage]").expect("a section");
        let end = NATIVE.find("# Columns that are used if").expect("what follows");
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
        assert_eq!(production, StageSource::Production(USUAL_WINDOW_S));
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
