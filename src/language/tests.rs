use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::*;
use crate::alert::advice::advice;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Keys that the code puts together from a number and a unit, or reads from the database.
const COMPOSED: [&str; 11] = [
    "{0} year",
    "{0} month",
    "{0} day",
    "{0} hour",
    "{0} minute",
    "{0} second",
    "rising",
    "falling",
    "excitation",
    "warming",
    "between",
];

fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            found.extend(files(&path, ending));
        } else if path.extension().is_some_and(|of| of == ending) {
            found.push(path);
        }
    }
    found
}

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The key of a template literal, and what follows it; each `${..}` is a numbered value.
fn template(text: &str) -> (String, &str) {
    let (mut key, mut values, mut rest) = (String::new(), 0, text);
    loop {
        match rest.as_bytes().first().copied() {
            None => return (key, rest),
            Some(b'`') => return (key, &rest[1..]),
            Some(b'$') if rest[1..].starts_with('{') => {
                rest = &rest[2..];
                let mut depth = 1;
                while depth > 0 {
                    let (letter, after) = (rest.as_bytes()[0], &rest[1..]);
                    rest = match letter {
                        b'`' => template(after).1,
                        b'"' => after.split_once('"').expect("the end of a text").1,
                        _ => after,
                    };
                    depth += i32::from(letter == b'{') - i32::from(letter == b'}');
                }
                key += &format!("{{{values}}}");
                values += 1;
            }
            Some(_) => {
                let letter = rest.chars().next().expect("a letter");
                key.push(letter);
                rest = &rest[letter.len_utf8()..];
            }
        }
    }
}

/// Keys of the pages, with the file that has them.
fn keys_of_pages() -> BTreeMap<String, String> {
    let mut keys = BTreeMap::new();
    for path in files(&source().join("serve/page"), "js") {
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        if name.starts_with("uPlot") || name == "messages.js" {
            continue;
        }
        let text = fs::read_to_string(&path).expect("text");
        for (place, _) in text.match_indices("t`") {
            let before = text[..place].chars().next_back().unwrap_or(' ');
            if !before.is_alphanumeric() && before != '_' && before != '.' {
                keys.insert(template(&text[place + 2..]).0, name.clone());
            }
        }
        for (place, _) in text.match_indices("plural(") {
            let arguments = text[place..].lines().next().unwrap_or_default();
            let noun = arguments.split_once(", \"").and_then(|(_, rest)| rest.split_once("\")"));
            keys.extend(noun.map(|(noun, _)| (format!("{{0}} {noun}"), name.clone())));
        }
    }
    let page = fs::read_to_string(source().join("serve/page/index.html")).expect("text");
    let marked = page.split("data-t>").skip(1).filter_map(|rest| rest.split_once('<'));
    keys.extend(marked.map(|(text, _)| (text.to_owned(), "index.html".to_owned())));
    keys
}

/// Keys that follow from lists of the program.
fn keys_of_lists() -> BTreeSet<&'static str> {
    let kinds = AnomalyKind::ALL.into_iter().flat_map(|kind| [kind.label(), advice(kind)]);
    let quantities = Quantity::ALL.into_iter().map(Quantity::label);
    COMPOSED.into_iter().chain(kinds).chain(quantities).chain(Severity::ALL.map(Severity::name)).collect()
}

#[test]
fn every_message_has_a_translation_into_each_language_with_the_same_values() {
    let header: Vec<&str> = FILE.lines().next().expect("a header").split('\t').collect();
    assert_eq!(header, ["English", "Italiano", "Deutsch", "中文"]);
    assert_eq!(rows().count(), TABLE.len(), "a key stands in two rows");
    let values =
        |text: &str| text.split(['{', '}']).skip(1).step_by(2).map(str::to_owned).collect::<BTreeSet<_>>();
    for (key, row) in rows() {
        assert_eq!(row.len(), Language::ALL.len() - 1, "{key}");
        for text in row {
            assert!(!text.trim().is_empty() && text.trim() == text, "{key}: {text:?}");
            assert!(text.split('|').all(|form| values(form) == values(key)), "{key}: {text}");
        }
    }
}

#[test]
fn every_key_of_pages_and_lists_is_in_the_table_and_every_row_is_used() {
    let pages = keys_of_pages();
    assert!(pages.len() > 400, "{}", pages.len());
    let missing: Vec<_> = pages.iter().filter(|(key, _)| !TABLE.contains_key(key.as_str())).collect();
    assert!(missing.is_empty(), "not in the table: {missing:#?}");
    let lists = keys_of_lists();
    let missing: Vec<_> = lists.iter().filter(|key| !TABLE.contains_key(**key)).collect();
    assert!(missing.is_empty(), "not in the table: {missing:#?}");
    // keys of the program stand in its code as they are, or as a pattern of `format!`
    let mut code: String =
        files(&source(), "rs").iter().map(|path| fs::read_to_string(path).expect("text")).collect();
    code += &fs::read_to_string(source().join("../crates/model/src/anomaly.rs")).expect("text");
    let code = code.replace("\\\n", "").split_whitespace().collect::<Vec<_>>().join(" ");
    let is_in_code = |key: &str| {
        let mut pieces = key.split(['{', '}']).step_by(2).filter(|piece| piece.trim().len() > 2);
        pieces.all(|piece| code.contains(piece.trim()))
    };
    let unused: Vec<_> = TABLE
        .keys()
        .filter(|key| !pages.contains_key(**key) && !lists.contains(*key) && !is_in_code(key))
        .collect();
    assert!(unused.is_empty(), "not used: {unused:#?}");
}

#[test]
fn values_stand_where_a_language_wants_them() {
    assert_eq!(say(Language::Chinese, "Run {0} of {1}", &["3", "R{0}"]), "R{0} 的运行 3");
    assert_eq!(say(Language::English, "Run {0} of {1}", &["3", "R01"]), "Run 3 of R01");
}

#[test]
fn a_text_of_a_key_and_its_values_is_translated() {
    let german = |text| translated(Language::German, text).into_owned();
    assert_eq!(german("joint 3"), "Gelenk 3");
    assert_eq!(german("more than a million to 1"), "mehr als eine Million zu 1");
    assert_eq!(german("28 to 1"), "28 zu 1");
    for text in ["R01", "from here to there", "1 cycle"] {
        assert_eq!(german(text), text);
    }
    assert_eq!(translated(Language::English, "joint 3"), "joint 3");
}
