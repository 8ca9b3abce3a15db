//! A proposal as the text of a layout file.

use std::path::Path;

use super::decide::Decided;
use super::head::Head;
use super::proposal::Proposed;
use super::section::{Section, TomlKey, quoted};
use armwatch_config::{BLANKS, DecimalMark};
use armwatch_model::text;

/// Longest line of a comment, characters.
const COMMENT_WIDTH: usize = 110;

/// The layout file of a proposal.
pub(super) fn layout(name: &str, path: &Path, head: &Head, decided: &Decided) -> Proposed {
    let Decided { sections, joints, shipped } = decided;
    let keys = || sections.iter().flat_map(|section| &section.keys);
    let is_answered = keys().all(|key| !key.is_open);
    Proposed {
        toml: file(name, path, head, sections, *shipped),
        questions: keys().filter(|key| key.question.is_some()).count(),
        answered: is_answered.then(|| {
            let answered = |section: &Section| {
                let keys = section.keys.iter().map(|key| TomlKey { question: None, ..key.clone() }).collect();
                Section { keys, ..section.clone() }
            };
            file(name, path, head, &sections.iter().map(answered).collect::<Vec<_>>(), *shipped)
        }),
        rows: head.rows,
        shipped: *shipped,
        joints: *joints,
    }
}

fn file(name: &str, path: &Path, head: &Head, sections: &[Section], shipped: Option<&str>) -> String {
    let mut text = String::new();
    let file = text::of_file_name(path);
    comment(&mut text, &format!("Layout proposed from the first {} rows of {file}.", head.rows));
    if let Some(shipped) = shipped {
        let said = format!("It is an export of the shipped layout {shipped} (exports/{shipped}.toml).");
        comment(&mut text, &said);
    }
    comment(
        &mut text,
        "Each choice has its reason above it. Check it, then name this file in armwatch.toml.",
    );
    text.push('\n');
    section(&mut text, &format_section(name, head));
    for one in sections {
        text.push('\n');
        section(&mut text, one);
    }
    text
}

fn format_section(name: &str, head: &Head) -> Section {
    let mut keys = vec![TomlKey::decided("name", quoted(name))];
    let delimiter = match head.delimiter {
        BLANKS => quoted("blank"),
        sign => quoted(&char::from(sign).to_string()),
    };
    keys.push(
        TomlKey::decided("delimiter", delimiter)
            .because("it gives the most numbers, in rows of equal length"),
    );
    if head.decimal == DecimalMark::Comma {
        keys.push(TomlKey::decided("decimal", quoted(",")).because("numbers have decimal commas"));
    }
    let encoding = head.encoding.declared().name();
    let reason = format!("this file is {encoding}; \"auto\" would find that too, file by file");
    keys.push(TomlKey::decided("encoding", quoted("auto")).because(&reason));
    let has_header = head.header && head.by_number.is_none();
    if head.skip_lines > 0 {
        let what = if has_header { "the header is" } else { "the rows begin with" };
        let reason = format!("{what} line {}", head.skip_lines + 1);
        keys.push(TomlKey::decided("skip_lines", head.skip_lines.to_string()).because(&reason));
    }
    let by_number = head.by_number.map(|reason| format!("{reason}; columns are numbered"));
    let header = match (&by_number, head.header, head.commented_header) {
        (Some(reason), ..) => reason,
        (None, true, true) => "the names follow a comment sign, above the first row",
        (None, true, false) => "the names are above the first row",
        (None, false, _) => "no line above the first row has as many fields; columns are numbered",
    };
    keys.push(TomlKey::decided("header", has_header.to_string()).because(header));
    if head.skip_after_header > 0 {
        let reason = "lines of words between names and numbers, such as units";
        keys.push(TomlKey::decided("skip_after_header", head.skip_after_header.to_string()).because(reason));
    }
    Section { title: None, comments: Vec::new(), keys }
}

fn section(text: &mut String, section: &Section) {
    section.comments.iter().for_each(|line| comment(text, line));
    if let Some(title) = section.title {
        text.push_str(&format!("[{title}]\n"));
    }
    for key in &section.keys {
        key.reasons.iter().for_each(|reason| comment(text, reason));
        match &key.question {
            Some(question) => {
                comment(text, &format!("? {question}"));
                text.push_str(&format!("# {} = {}\n", key.name, key.value));
            }
            None => text.push_str(&format!("{} = {}\n", key.name, key.value)),
        }
    }
}

/// Sentences as comment lines above a layout.
pub fn comments(sentences: &[String]) -> String {
    let mut text = String::new();
    sentences.iter().for_each(|sentence| comment(&mut text, sentence));
    text
}

fn comment(text: &mut String, words: &str) {
    let mut line = String::from("#");
    for word in words.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COMMENT_WIDTH {
            text.push_str(&line);
            text.push('\n');
            line = String::from("#");
        }
        line.push(' ');
        // names come from the file and may contain anything; TOML allows no control characters in comments
        line.push_str(&text::shown(word));
    }
    text.push_str(&line);
    text.push('\n');
}
