//! The sections of a layout on stages and cycles, with reasons.

use super::head::{Head, Words};
use super::joints::{Joints, values};
use super::names::ColumnKind;
use super::section::{Section, TomlKey, quoted};
use super::stages::{Meaning, StageValue};
use super::{names, stages};

/// Rows per change of a word, at least, where words are stages: notes change from row to row.
const ROWS_PER_CHANGE: usize = 10;

/// Keys of the stages in a layout, in the order of [`stages::stage_of`].
const STAGES: [&str; 4] = ["between", "excitation", "friction", "warming"];

/// Columns that are not joints' and not time.
pub(super) struct Signals {
    /// Possible stage columns, the most likely first.
    stage: Vec<StageColumn>,
    cycle: Option<usize>,
    friction_joint: Option<usize>,
    friction_level: Option<usize>,
}

impl Signals {
    /// The columns that the layout reads or asks about.
    pub(super) fn columns(&self) -> impl Iterator<Item = usize> {
        let stage = self.stage.iter().map(|of| of.column);
        stage.chain(self.cycle).chain(self.friction_joint).chain(self.friction_level)
    }
}

/// A column of few different values.
struct StageColumn {
    column: usize,
    /// True if the name indicates stages.
    is_named: bool,
    /// The different values, as a layout writes them, and how the joints move under each.
    values: Vec<(String, StageValue)>,
    meaning: Option<Meaning>,
    /// Reason for the meaning.
    reason: &'static str,
    /// The motion or, for words, the words themselves leave no doubt.
    is_sure: bool,
}

impl StageColumn {
    fn shown(&self, head: &Head) -> String {
        let values: Vec<&str> = self.values.iter().map(|(text, _)| text.as_str()).collect();
        format!("column {} ({})", head.reference(self.column), values.join(", "))
    }
}

pub(super) fn signals(head: &Head, joints: &Joints<'_>, is_used: impl Fn(usize) -> bool) -> Signals {
    let free: Vec<usize> = (0..head.columns.len()).filter(|at| !is_used(*at)).collect();
    let kind = |at: usize| match head.header {
        true => names::said(&head.columns[at].name, &head.columns[at].under).kind,
        false => None,
    };
    let alphabet = |at: usize| values(&head.columns[at]).and_then(stages::alphabet);
    let whole = |at: &usize| {
        values(&head.columns[*at]).is_some_and(|values| values.iter().all(|v| v.fract() == 0.0 && *v >= 0.0))
    };
    let named = |wanted: ColumnKind| free.iter().copied().find(|at| kind(*at) == Some(wanted) && whole(at));
    let within = |at: &usize, most: usize| {
        alphabet(*at).is_some_and(|values| values.iter().all(|value| (0..=most as i64).contains(value)))
    };
    let speeds = speeds(joints);
    let candidate = |at: usize| -> Option<StageColumn> {
        let is_named = match kind(at) {
            Some(ColumnKind::Stage) => true,
            None => false,
            Some(_) => return None,
        };
        match alphabet(at) {
            Some(alphabet) if is_named || (2..=8).contains(&alphabet.len()) => {
                Some(of_numbers(at, is_named, values(&head.columns[at])?, &alphabet, &speeds))
            }
            Some(_) => None,
            None => of_words(at, is_named, head.columns[at].words.as_ref()?, &speeds),
        }
    };
    let mut stage: Vec<StageColumn> = free.iter().filter_map(|at| candidate(*at)).collect();
    if stage.iter().any(|of| of.is_named) {
        stage.retain(|of| of.is_named);
    }
    stage.sort_by_key(|of| (!of.is_sure, of.meaning.is_none(), of.column));
    Signals {
        stage,
        cycle: named(ColumnKind::Cycle),
        friction_joint: named(ColumnKind::FrictionJoint).filter(|at| within(at, joints.count)),
        friction_level: named(ColumnKind::FrictionLevel).filter(|at| within(at, 255)),
    }
}

fn of_numbers(
    column: usize,
    is_named: bool,
    signal: &[f64],
    alphabet: &[i64],
    speeds: &[Vec<f64>],
) -> StageColumn {
    let under = stages::values(signal, alphabet, speeds);
    let native = stages::native(alphabet);
    let is_usual = is_named && native.is_some();
    let (meaning, reason) = match native {
        Some(native) => (Some(native), "0 to 3 as in the native layout"),
        None => (stages::by_motion(&under), BY_MOTION),
    };
    let is_sure = is_usual || meaning.as_ref().is_some_and(|meaning| stages::is_confirmed(meaning, &under));
    let values = under.into_iter().map(|value| (value.value.to_string(), value)).collect();
    StageColumn { column, is_named, values, meaning, reason, is_sure }
}

const BY_MOTION: &str =
    "by the motion: single joints are friction, all joints together are excitation and, later, warming";

fn of_words(column: usize, is_named: bool, words: &Words, speeds: &[Vec<f64>]) -> Option<StageColumn> {
    let changes = words.rows.windows(2).filter(|pair| pair[0] != pair[1]).count();
    if words.words.len() < 2 || changes * ROWS_PER_CHANGE > words.rows.len() {
        return None;
    }
    // from 1: zero would be between stages
    let codes: Vec<f64> = words.rows.iter().map(|code| f64::from(*code) + 1.0).collect();
    let alphabet: Vec<i64> = (1..=words.words.len() as i64).collect();
    let under = stages::values(&codes, &alphabet, speeds);
    let said: Option<Vec<usize>> = words.words.iter().map(|word| stages::stage_of(word)).collect();
    let of_stage = |stages: &[usize], wanted: usize| {
        alphabet.iter().zip(stages).filter(|(_, stage)| **stage == wanted).map(|(value, _)| *value).collect()
    };
    let is_sure = said.as_ref().is_some_and(|said| said.contains(&1));
    let (meaning, reason) = match said.filter(|_| is_sure) {
        Some(said) => {
            let [between, excitation, friction, warming] = [0, 1, 2, 3].map(|stage| of_stage(&said, stage));
            (Some(Meaning { between, excitation, friction, warming }), "from the words")
        }
        None => (stages::by_motion(&under), BY_MOTION),
    };
    let values = words.words.iter().map(|word| quoted(word)).zip(under).collect();
    Some(StageColumn { column, is_named, values, meaning, reason, is_sure })
}

pub(super) fn stage_section(head: &Head, joints: &Joints<'_>, signals: &Signals) -> Section {
    let mut section = Section { title: Some("stage"), ..Section::default() };
    let Some((best, rivals)) = signals.stage.split_first() else {
        let reason = "no column with few different values can mark the stages: all rows count as \
            excitation. If a column marks the stages, write its name here, with the values of each stage";
        section.keys.push(TomlKey::decided("whole_recording", quoted("excitation")).because(reason));
        return section;
    };
    let seen = |(text, value): &(String, StageValue)| {
        format!("{text} in {} rows, {:.1} joints moving", value.rows, value.moving)
    };
    let seen: Vec<String> = best.values.iter().map(seen).collect();
    let why = match (best.is_named, rivals.is_empty()) {
        (true, _) => "from the name",
        (false, true) => "the only column with few different values",
        (false, false) => "a column with few different values",
    };
    let mut question = Vec::new();
    if !rivals.is_empty() {
        let rivals: Vec<String> = rivals.iter().map(|of| of.shown(head)).collect();
        question.push(format!(
            "{} or {} may mark the stages. Which one does?",
            best.shown(head),
            rivals.join(", ")
        ));
    } else if !best.is_sure && (best.meaning.is_some() || !best.is_named) {
        question.push(format!(
            "{} may mark the stages, but the motion does not confirm it. Does it?",
            best.shown(head)
        ));
    }
    if !question.is_empty() && !best.is_named {
        question.push(
            "If the whole recording is excitation, whole_recording = \"excitation\" replaces \
            these keys"
                .into(),
        );
    }
    let question = (!question.is_empty()).then(|| question.join(" "));
    section.keys.push(
        TomlKey::decided("column", head.reference(best.column))
            .because(&format!("{why}; it has {}", seen.join("; ")))
            .asked_if(question.as_ref()),
    );
    section.keys.extend(meaning_keys(best, joints));
    section
}

fn meaning_keys(of: &StageColumn, joints: &Joints<'_>) -> Vec<TomlKey> {
    let text =
        |value: &i64| of.values.iter().find(|(_, known)| known.value == *value).map(|(text, _)| text.clone());
    let list = |values: &[i64]| {
        let texts: Vec<String> =
            values.iter().map(|value| text(value).unwrap_or_else(|| value.to_string())).collect();
        format!("[{}]", texts.join(", "))
    };
    match &of.meaning {
        Some(meaning) => {
            let lists = [&meaning.between, &meaning.excitation, &meaning.friction, &meaning.warming];
            let mut keys: Vec<TomlKey> = STAGES
                .into_iter()
                .zip(lists)
                .map(|(name, values)| TomlKey::decided(name, list(values)))
                .collect();
            keys[0].reasons.push(of.reason.to_owned());
            keys
        }
        None => {
            let all: Vec<i64> = of.values.iter().map(|(_, value)| value.value).collect();
            let why =
                if joints.position.is_some() { "The motion does not decide" } else { "No motion decides" };
            let question = format!("what does each of {} mean? {why}", list(&all));
            STAGES.map(|name| TomlKey::decided(name, "[]").open(&question)).into()
        }
    }
}

/// Speeds of the joints `[n][rows]`, from positions where none are recorded.
fn speeds(joints: &Joints<'_>) -> Vec<Vec<f64>> {
    match (&joints.velocity, &joints.position) {
        (Some(velocity), _) => velocity.values.iter().map(|values| values.to_vec()).collect(),
        (None, Some(position)) => position
            .values
            .iter()
            .map(|values| {
                let change = values.windows(2).map(|pair| pair[1] - pair[0]);
                change.chain([0.0]).collect()
            })
            .collect(),
        (None, None) => Vec::new(),
    }
}

pub(super) fn optional_section(head: &Head, signals: &Signals) -> Option<Section> {
    let columns = [
        ("cycle", signals.cycle),
        ("friction_joint", signals.friction_joint),
        ("friction_level", signals.friction_level),
    ];
    let key = |(name, at): (&'static str, Option<usize>)| {
        Some(TomlKey::decided(name, head.reference(at?)).because("from its name, and it holds whole numbers"))
    };
    let keys: Vec<TomlKey> = columns.into_iter().filter_map(key).collect();
    (!keys.is_empty()).then(|| Section { title: Some("if_present"), comments: Vec::new(), keys })
}
