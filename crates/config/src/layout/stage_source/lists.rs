//! A list of values for each stage, as signals of numbers and of words have them.

use crate::toml::table::{Table, Value};

/// Most values of the stage signal that may mean one stage.
const MAX_STAGE_VALUES: usize = 100;

/// Refuses a value that means another stage already.
pub(super) fn refuse_known<T: PartialEq + Clone>(
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

/// The list of one stage.
pub(super) fn read_list<T>(
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
