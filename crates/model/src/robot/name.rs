//! Names of robots: one spelling each, and names that read as another robot's.

use std::borrow::Cow;

use unicode_normalization::{UnicodeNormalization, is_nfc};

/// A name in the composed form of Unicode (NFC), which file systems and programs write in several forms.
#[must_use]
pub fn composed(name: &str) -> Cow<'_, str> {
    if name.is_ascii() || is_nfc(name) { Cow::Borrowed(name) } else { Cow::Owned(name.nfc().collect()) }
}

/// Reason why a new name may be that of a known robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NameLikeness {
    /// It differs from this known name only in case, blanks or the form of characters.
    Spelling(String),
    /// It is a name that file managers and copying programs give to copies of this robot's exports.
    Copy(String),
}

/// The robot whose name a new one may be, if any: a known one, or the original of a name that only copies have.
#[must_use]
pub fn likeness<'a>(new: &str, known: impl IntoIterator<Item = &'a str>) -> Option<NameLikeness> {
    let known: Vec<&str> = known.into_iter().filter(|name| *name != new).collect();
    let named = |wanted: &str| {
        let wanted = bare(wanted);
        known.iter().find(|name| bare(name) == wanted).map(|name| (*name).to_owned())
    };
    if let Some(same) = named(new) {
        return Some(NameLikeness::Spelling(same));
    }
    let (mut rest, mut is_certain) = (new, false);
    while let Some((original, certain)) = without_mark(rest) {
        if let Some(original) = named(original) {
            return Some(NameLikeness::Copy(original));
        }
        (rest, is_certain) = (original, is_certain || certain);
    }
    is_certain.then(|| NameLikeness::Copy(rest.to_owned()))
}

/// The name of the original if this name has the mark of a copy; `None` without the mark.
#[must_use]
pub fn original_of(name: &str) -> Option<&str> {
    let mut rest = None;
    while let Some((original, _)) = without_mark(rest.unwrap_or(name)) {
        rest = Some(original);
    }
    rest
}

/// A name without case, blanks and forms of characters.
fn bare(name: &str) -> String {
    let is_blank = |c: char| c.is_whitespace() || crate::text::is_hidden(c);
    name.nfkc().filter(|c| !is_blank(*c)).flat_map(char::to_lowercase).nfc().collect()
}

/// Marks of a copy before the name of the original.
const BEFORE: [&str; 8] =
    ["copy of ", "kopie von ", "copia di ", "copia de ", "copie de ", "~$", ".~lock.", "~"];

/// Words for a copy after the name.
const WORDS: [&str; 8] =
    ["conflicted copy", "copy", "kopie", "copia", "copie", "sync-conflict", "conflict", "konflikt"];

/// A name without one mark of a copy, and true if only copies have that mark: robots have numbers too. `None` without a
/// mark.
fn without_mark(name: &str) -> Option<(&str, bool)> {
    let name = name.trim();
    for mark in BEFORE {
        if let Some((start, rest)) = name.split_at_checked(mark.len())
            && start.eq_ignore_ascii_case(mark)
        {
            return original(rest, true);
        }
    }
    // Copy (2) of R01
    if let Some((start, rest)) = name.split_at_checked("copy (".len())
        && start.eq_ignore_ascii_case("copy (")
        && let Some((number, rest)) = rest.split_once(") of ")
        && is_number(number)
    {
        return original(rest, true);
    }
    if let Some(rest) = name.strip_suffix('~') {
        return original(rest, true);
    }
    if let Some((rest, inner)) = name.strip_suffix(')').and_then(|inside| inside.rsplit_once('(')) {
        let inner = inner.to_ascii_lowercase();
        let is_copy = WORDS.iter().any(|word| inner.contains(word));
        return if is_copy || is_number(&inner) { original(rest, is_copy) } else { None };
    }
    let lower = name.to_ascii_lowercase();
    WORDS.iter().find_map(|word| {
        let at = lower.rfind(word)?;
        let (before, behind) = (&name[..at], &lower[at + word.len()..]);
        let is_parted = before.ends_with([' ', '-', '_', '.', '#']);
        // a number or a time may follow
        let is_end =
            behind.chars().all(|c| c.is_ascii_digit() || " -_.".contains(c)) || *word == "sync-conflict";
        if is_parted && is_end { original(before, true) } else { None }
    })
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.len() <= 3 && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// The rest of a name without a mark and the characters between them.
fn original(rest: &str, is_certain: bool) -> Option<(&str, bool)> {
    let rest = rest.trim_matches([' ', '-', '_', '.']);
    (!rest.is_empty()).then_some((rest, is_certain))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_name_in_two_forms_is_one() {
        let decomposed: String = "Größe".nfd().collect();
        assert_ne!(decomposed, "Größe");
        assert_eq!(composed(&decomposed), "Größe");
        assert!(matches!(composed("R01"), Cow::Borrowed("R01")));
    }

    #[test]
    fn names_that_differ_in_case_or_blanks_are_alike() {
        for new in ["r01", "R 01", " R01", "R01\u{a0}", "Ｒ01", "R01\u{200b}"] {
            assert_eq!(likeness(new, ["R02", "R01"]), Some(NameLikeness::Spelling("R01".into())), "{new:?}");
        }
        for new in ["R01", "R03", "R011", "R0-1", "R_01"] {
            assert_eq!(likeness(new, ["R02", "R01"]), None, "{new:?}");
        }
    }

    #[test]
    fn copies_of_file_managers_are_known() {
        for new in [
            "R01 (1)",
            "R01(2)",
            "R01 - Copy",
            "R01 - Copy (2)",
            "R01 - Kopie",
            "R01 copy",
            "R01 copy 3",
            "Copy of R01",
            "Copy (2) of R01",
            "Kopie von R01",
            "Kopie von R01 (1)",
            "R01_conflict",
            "R01_conflict-20260105-084700",
            "~R01",
            "~$R01",
            "R01~",
            "R01.sync-conflict-20260105-084700-ABCDEF7",
            "r01 (1)",
            "R01 (Anna's conflicted copy 2026-01-05)",
            "R01 - Copia",
            "copia di R01",
            ".~lock.R01",
        ] {
            assert_eq!(likeness(new, ["R01"]), Some(NameLikeness::Copy("R01".into())), "{new:?}");
            let certain = (!["R01 (1)", "R01(2)", "r01 (1)"].contains(&new)).then_some(());
            let alone = likeness(new, ["R02"]);
            assert_eq!(alone.map(|_| ()), certain, "{new:?}: robots have numbers");
            assert!(original_of(new).is_some_and(|name| name.eq_ignore_ascii_case("R01")), "{new:?}");
        }
        for new in [
            "R01b",
            "R01_left",
            "R01 (left)",
            "Copycat R01",
            "R01 (1234)",
            "R01_copy_arm",
            "R01copy",
            "~",
            "(1)",
        ] {
            assert_eq!(likeness(new, ["R01"]), None, "{new:?}");
        }
    }
}
