//! A proposal as the text of a layout file.

use std::path::Path;

use super::head::Head;
use super::proposal::Proposed;
use super::section::{Section, TomlKey};
use crate::infer::section::quoted;
use armwatch_config::DecimalMark;
use armwatch_model::text;

/// Longest line of a comment, characters.
const COMMENT_WIDTH: usize = 110;

/// The layout file of a proposal.
pub(super) fn layout(name: &str, path: &Path, head: &Head, sections: &[Section]) -> Proposed {
    let mut text = String::new();
    let file = text::of_file_name(path);
    comment(&mut text, &format!("Layout proposed from the first {} rows of {file}.", head.rows));
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
    let keys = sections.iter().flat_map(|section| &section.keys);
    Proposed { toml: text, questions: keys.filter(|key| key.question.is_some()).count(), rows: head.rows }
}

fn format_section(name: &str, head: &Head) -> Section {
    let mut keys = vec![TomlKey::decided("name", quoted(name))];
    let delimiter = quoted(&char::from(head.delimiter).to_string());
    keys.push(
        TomlKey::decided("delimiter", delimiter).because("it makes the most numbers, in rows of one length"),
    );
    if head.decimal == DecimalMark::Comma {
        keys.push(TomlKey::decided("decimal", quoted(",")).because("numbers have decimal commas"));
    }
    let encoding = head.encoding.declared().name();
    let reason = format!("this file is {encoding}; \"auto\" would find that too, file by file");
    keys.push(TomlKey::decided("encoding", quoted("auto")).because(&reason));
    if head.skip_lines > 0 {
        let reason = format!("the header is line {}", head.skip_lines + 1);
        keys.push(TomlKey::decided("skip_lines", head.skip_lines.to_string()).because(&reason));
    }
    let header = match (head.header, head.commented_header) {
        (true, true) => "names stand behind the sign of a comment, above the first row",
        (true, false) => "names stand above the first row",
        (false, _) => "no line above the first row has as many fields; columns go by number",
    };
    keys.push(TomlKey::decided("header", head.header.to_string()).because(header));
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

fn comment(text: &mut String, words: &str) {
    let mut line = String::from("#");
    for word in words.split_whitespace() {
        if line.chars().count() + 1 + word.chars().count() > COMMENT_WIDTH {
            text.push_str(&line);
            text.push('\n');
            line = String::from("#");
        }
        line.push(' ');
        // names come from the file and may hold anything; TOML takes no control characters in comments
        line.push_str(&text::shown(word));
    }
    text.push_str(&line);
    text.push('\n');
}
