use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::*;
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
    let kinds = AnomalyKind::ALL.into_iter().map(AnomalyKind::label);
    let quantities = Quantity::ALL.into_iter().map(Quantity::label);
    COMPOSED.into_iter().chain(kinds).chain(quantities).chain(Severity::ALL.map(Severity::name)).collect()
}

#[test]
fn every_message_has_a_translation_into_each_language_with_the_same_values() {
    for (file, texts) in [(FILE, &MESSAGES), (FINDINGS_FILE, &FINDINGS)] {
        let header: Vec<&str> = file.lines().next().expect("a header").split('\t').collect();
        assert_eq!(header, ["English", "Italiano", "Deutsch", "中文"]);
        assert_eq!(rows(file).count(), texts.rows.len(), "a key stands in two rows");
    }
    let values =
        |text: &str| text.split(['{', '}']).skip(1).step_by(2).map(str::to_owned).collect::<BTreeSet<_>>();
    for (key, row) in rows(FILE).chain(rows(FINDINGS_FILE)) {
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
    let missing: Vec<_> = pages.iter().filter(|(key, _)| !MESSAGES.rows.contains_key(key.as_str())).collect();
    assert!(missing.is_empty(), "not in the table: {missing:#?}");
    let lists = keys_of_lists();
    let missing: Vec<_> = lists.iter().filter(|key| !MESSAGES.rows.contains_key(**key)).collect();
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
    let unused: Vec<_> = MESSAGES
        .rows
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

/// Texts that a source file writes in English: its literals outside of tests, comments and attributes.
fn literals(code: &str) -> Vec<String> {
    let code = code.split("#[cfg(test)]").next().unwrap_or_default();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with(['/', '#']));
    let code = lines.collect::<Vec<_>>().join("\n");
    let pieces: Vec<&str> = code.split('"').collect();
    pieces.iter().skip(1).step_by(2).map(|text| joined_lines(text)).collect()
}

fn joined_lines(text: &str) -> String {
    let mut lines = text.split("\\\n");
    let first = lines.next().unwrap_or_default().to_owned();
    lines.fold(first, |text, line| text + line.trim_start())
}

#[test]
fn every_sentence_of_the_detectors_is_in_the_table() {
    // a form of dates, a reason for this program only, and a text that two rows make
    const NOT_ROWS: [&str; 3] = ["%Y-%m-%d %H:%M", "no history", "latest test: friction index"];
    let is_test = |path: &Path| {
        let name = path.file_name().expect("a name").to_string_lossy();
        name.ends_with("tests.rs") || name == "fixtures.rs"
    };
    let mut missing = BTreeSet::new();
    for path in files(&source().join("../crates/method/src/detect"), "rs") {
        if is_test(&path) {
            continue;
        }
        for text in literals(&fs::read_to_string(path).expect("text")) {
            // pieces between values, of two words or more
            let pieces = text.split(['{', '}']).step_by(2).flat_map(|piece| piece.split("; "));
            let pieces = pieces.map(|piece| piece.trim_matches(|letter| " ,.:;()".contains(letter)));
            let is_missing = |piece: &&str| {
                piece.len() >= 8
                    && piece.contains(' ')
                    && !NOT_ROWS.contains(piece)
                    && !FINDINGS.rows.keys().any(|key| key.contains(piece))
            };
            missing.extend(pieces.filter(is_missing).map(str::to_owned));
        }
    }
    assert!(missing.is_empty(), "not in findings.tsv: {missing:#?}");
}

#[test]
fn a_message_of_a_detector_is_said_in_each_language_with_its_values() {
    let messages = [
        "joint 3: friction at equal speed and temperature, smoothed over the tests, is 15.5 % above the joint's baseline \
         (limit 5 %, over below 3.8 %); latest test, within the limit by itself: friction index 1.045, standard error \
         0.007, of which all joints share +2 %; check lubrication, gearbox and brake; at this rate critical by 2027-01-02 \
         (80 %: 2026-12-01 to 2027-03-01)",
        "joint 2: friction jumped by +25 % with cycle 5 of a test; warm friction, smoothed over the tests, is 9 % below the \
         joint's baseline (limit 5 %); latest test: 12.10 Nm against 13.20 Nm at 60 % speed, as measured since the run has \
         no friction index; a change of grease or a loose transmission lowers friction; check after maintenance",
        "the arm carries 0.80 kg more than in its first tests (standard error 0.005 kg), centre at (0.001, 0.000, 0.000) m of \
         the last link; take the tool or workpiece off for tests, declare it with [[tool]], or record the new tool as \
         maintenance; seen by cycle 3 of a test that is still being written",
        "the arm carries 1.95 kg more than in its first tests (95 % interval 1.75 to 2.34 kg, for drive gains that are off by \
         up to 15 %), centre at (0.001, 0.000, 0.000) m of the tool frame; take the tool or workpiece off for tests, declare \
         it with [[tool]], or record the new tool as maintenance",
        "joint 5: friction varies by 12 % (standard deviation over 8 cycles) from cycle to cycle, where 0.2 % is usual; look \
         for a loose bearing, belt or coupling, or a brake that does not open fully",
        "joints 3 and 4 oscillate together, against each other: friction from cycle to cycle varies (joint 3 by 1.2 %, \
         joint 4 by 2.0 %; correlation -0.91 over 16 cycles of 2 tests); one cause is likelier than two: look at what couples \
         them, a belt, a wrist gear, brakes of one circuit or the supply",
        "warming up takes longer than before, for 4 tests now, about 1.8 times as long, while friction of the first cycle \
         fits; all joints do so, as with another or an aged lubricant",
        "joint 1: the identified model misses 12.5 % of this joint's torque, limit 10 %, as in its baseline; check torque \
         signal, payload and the robot's description",
        "in cycle 4 of this test alone the identified model misses 5.0 % of the torque of joint 1 (1.0 % in the cycles next to \
         it) and 7.0 % of the torque of joint 2 (1.0 % in the cycles next to it); a force on the arm loads the joints before it, \
         so look from link 2 on to the tool",
        "in production 31 % of the torque is not what the last test predicts; the test itself leaves 2.0 %: \
         friction of joint 4 explains most of it",
    ];
    let english = ["friction", "joint ", "check", "test", "torque", "cycle", " the ", " of ", " and "];
    for language in [Language::Italian, Language::German, Language::Chinese] {
        for message in messages {
            let said = finding(language, message);
            assert_eq!(clauses(&said).len(), clauses(message).len(), "{said}");
            // "Test" is a German word
            let left: Vec<&str> = english.into_iter().filter(|word| said.contains(word)).collect();
            assert!(left.is_empty(), "{left:?} in {said}");
            let digits = |text: &str| {
                let mut digits: Vec<char> = text.chars().filter(char::is_ascii_digit).collect();
                digits.sort_unstable();
                digits
            };
            assert_eq!(digits(&said), digits(message), "{said}");
        }
    }
    assert_eq!(
        finding(
            Language::German,
            "joint 3: the torque signal has 2.5 times the usual noise; check sensor, cable and shield"
        ),
        "Gelenk 3: das Drehmomentsignal hat das 2,5-Fache des üblichen Rauschens; Sensor, Kabel und Schirmung prüfen"
    );
    assert_eq!(
        finding(
            Language::Italian,
            "latest test: 12.10 Nm against 13.20 Nm at 60 % speed, as measured since the run has no friction index"
        ),
        "ultima prova: 12,10 Nm rispetto a 13,20 Nm al 60 % della velocità, come misurato, perché l'esecuzione non ha un \
         indice di attrito"
    );
    assert_eq!(
        finding(
            Language::Chinese,
            "in cycle 4 of this test alone the identified model misses 5.0 % of the torque of joint 1 (1.0 % in the cycles next to it)"
        ),
        "仅在本次测试的循环 4 中，辨识模型未能解释关节 1 的 5.0 % 力矩（相邻循环为 1.0 %）"
    );
    // what an earlier program wrote stays as it was
    assert_eq!(finding(Language::Italian, "joint 3: a sentence of before"), "giunto 3: a sentence of before");
    assert_eq!(finding(Language::English, messages[0]), messages[0]);
}
