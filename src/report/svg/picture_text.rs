//! Text in a picture: escaped, broken into lines, and compressed if it is too long.

use std::fmt::Write;

use super::sizes::{LETTER, WIDTH};
use armwatch_model::text::xml;

pub(super) fn text(svg: &mut String, x: f64, y: f64, class: &str, words: &str) {
    let _ = writeln!(svg, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", xml(words));
}

/// Text broken into lines that fit the picture.
pub(super) fn lines_of(words: &str) -> Vec<String> {
    let most = ((WIDTH - 32.0) / LETTER) as usize;
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut().filter(|line| line.chars().count() + 1 + word.chars().count() <= most) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Compresses a line of text to the page width if it is wider; its letters are `size` times the usual.
pub(super) fn squeezed(words: &str, size: f64) -> String {
    let room = WIDTH - 32.0;
    if LETTER * size * words.chars().count() as f64 <= room {
        return String::new();
    }
    format!(" textLength=\"{room}\" lengthAdjust=\"spacingAndGlyphs\"")
}
