//! Wording of comments and documents: phrases that make readers read twice stay rare. A hit is a place to reread, not
//! an error, so the limits are rates.

use std::fs;
use std::path::Path;

use regex::Regex;

use crate::docs::{files_below, repository};

/// Phrases, and the usual way to write them.
const PHRASES: [(&str, &str); 9] = [
    (r"\bwhat (is|are|was|were|it|they|each|a|an|the|people|others)\b", "name the thing"),
    (r"(^|[.:;] )(Who|Whoever|Whatever|Where|Whether|What|That|Of|As|With) [a-z]", "begin with the subject"),
    (r"\b(of|by|to|from|at|in|on|for) (which|whom|what)\b", "two sentences"),
    (r"\bwhere (it|they|there|one|nobody|nothing|a|an|the)\b", "if, when"),
    (
        r"\b(anew|nobody|whoever|beside|thereof|meanwhile|by itself|of its own)\b",
        "again, no one, next to, until then",
    ),
    (
        r"\b(is|are|was|were|be|been) (taken|held|looked|told|left|drawn|kept) (for|to|against|at|through|from|out|away|apart)\b",
        "the exact verb",
    ),
    (r"\b(stands?|lies?|goes|comes?) (for|in|at|on|beside|from|there|round|by)\b", "is, contains, continues"),
    (r"\b(but for|but one|none but|no other|need not)\b", "except, only"),
    (r"\b(warmth|hall|ordinary work|figures? of|take away|told apart)\b", "the term of docs/glossary.md"),
];

/// Hits per 1,000 words of all texts together, and of one file.
const MOST_TOGETHER: f64 = 4.0;
const MOST_IN_FILE: f64 = 8.0;

/// Hits that any file may have: a rate says nothing about a few sentences.
const FREE: usize = 4;

/// Prose of a file, a line each: documents outside code, and comments of their own line.
fn prose(path: &Path, text: &str) -> Vec<(usize, String)> {
    let is_document = path.extension().is_some_and(|extension| extension == "md");
    let code = Regex::new(r"`[^`]*`|\[[^\]]*\]\([^)]*\)").expect("a pattern");
    let comment = Regex::new(r"^\s*(?://[/!]?|#|--)\s?(.*)$").expect("a pattern");
    let mut in_fence = false;
    let mut lines = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let said = if is_document {
            let fence = line.trim_start().starts_with("```");
            in_fence ^= fence;
            (!fence && !in_fence).then_some(line)
        } else {
            comment.captures(line).and_then(|found| found.get(1)).map(|found| found.as_str())
        };
        lines.extend(said.map(|said| (number + 1, code.replace_all(said, "x").into_owned())));
    }
    lines
}

#[test]
fn comments_and_documents_need_one_reading() {
    let phrases = PHRASES.map(|(phrase, usual)| (Regex::new(phrase).expect("a pattern"), usual));
    let planted =
        prose(Path::new("a.rs"), "    // Where a test is taken for what it is not.\n    let x = 1;");
    assert!(phrases.iter().filter(|(phrase, _)| phrase.is_match(&planted[0].1)).count() >= 3);
    let mut files = ["README", "ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY"]
        .map(|name| repository(&format!("{name}.md")))
        .to_vec();
    for folder in ["src", "crates", "lab", "docs", "config", "tests", "benches"] {
        files.extend(files_below(folder, &["rs", "md", "toml"]));
    }
    let (mut all_words, mut all_hits, mut dense) = (0, 0, Vec::new());
    for file in files.iter().filter(|file| !file.ends_with("wording.rs") && !file.ends_with("glossary.md")) {
        let text = fs::read_to_string(file).expect("text");
        let (mut words, mut hits) = (0, Vec::new());
        for (number, line) in prose(file, &text) {
            words += line.split_whitespace().filter(|word| word.starts_with(char::is_alphabetic)).count();
            for (phrase, usual) in &phrases {
                hits.extend(
                    phrase.find_iter(&line).map(|hit| {
                        format!("{}:{number}: \"{}\": {usual}", file.display(), hit.as_str().trim())
                    }),
                );
            }
        }
        if hits.len() > FREE && hits.len() as f64 > MOST_IN_FILE * words as f64 / 1000.0 {
            dense.extend(hits.iter().cloned());
        }
        all_words += words;
        all_hits += hits.len();
    }
    assert!(all_words > 200_000, "{all_words} words");
    let rate = all_hits as f64 * 1000.0 / all_words as f64;
    assert!(rate <= MOST_TOGETHER, "{rate:.1} per 1,000 words");
    assert!(dense.is_empty(), "files with more than {MOST_IN_FILE} per 1,000 words:\n{}", dense.join("\n"));
}
