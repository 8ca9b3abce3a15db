//! Values shared by several tables of `[alerts]`.

use crate::toml::table::Value;

/// Outer `None` after a problem, inner if nothing was given.
pub(super) fn given<T>(read: Option<Option<T>>) -> Option<Option<T>> {
    match read {
        Some(read) => read.map(Some),
        None => Some(None),
    }
}

/// A list of texts, with one entry or more.
pub(super) fn texts(value: &Value<'_>) -> Option<Vec<String>> {
    let items = value.items()?;
    if items.is_empty() {
        value.refuse("has no entry".into(), Some("remove it, or name one".into()));
        return None;
    }
    let texts: Vec<_> = items.iter().map(|item| item.text().map(str::to_owned)).collect();
    texts.into_iter().collect()
}
