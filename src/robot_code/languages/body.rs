//! Parts shared by the writers of all languages.

use crate::robot_code::expression::{Expression, Function, Node};
use crate::robot_code::listing::{CodeLine, LINE_WIDTH, Listing, listing, wrapped, wrapped_code};
use crate::robot_code::torque::{Constant, TorquePrograms};
use armwatch_model::text;

/// Syntax that differs between the languages.
pub(super) struct Syntax {
    /// Name of a function.
    pub(super) function_name: fn(Function) -> &'static str,
    /// Before a line of comment.
    pub(super) comment: &'static str,
    /// After it.
    pub(super) comment_end: &'static str,
    /// Between code and a comment on its line.
    pub(super) comment_gap: &'static str,
    /// Before the name of a variable.
    pub(super) variable: &'static str,
    /// Before the name of a constant.
    pub(super) constant: &'static str,
    /// Between the name of a constant and its value.
    pub(super) is: &'static str,
    /// After a value.
    pub(super) end: &'static str,
    /// Around a value of several lines.
    pub(super) parentheses: [&'static str; 2],
}

/// Both functions and the constants that they read.
pub(super) struct Functions<'a> {
    pub(super) friction: Listing,
    pub(super) torque: Listing,
    /// Constants that are read.
    pub(super) constants: Vec<&'a Constant>,
    /// True if the torque reads the friction.
    pub(super) has_friction: bool,
}

impl<'a> Functions<'a> {
    pub(super) fn of(programs: &'a TorquePrograms, syntax: &Syntax) -> Self {
        let of = |program| listing(program, &programs.constants, syntax.function_name);
        let (friction, torque) = (of(&programs.friction), of(&programs.torque));
        let is_read = |at: usize| friction.constants[at] || torque.constants[at];
        let read = programs.constants.iter().enumerate().filter(|(at, _)| is_read(*at));
        let constants = read.map(|(_, constant)| constant).collect();
        let reads = |node: &Node| matches!(node, Node::Friction(_));
        let has_friction = programs.torque.graph.nodes().iter().any(reads)
            && programs.friction.outputs.iter().any(|of| *of != Expression::Zero);
        Self { friction, torque, constants, has_friction }
    }

    /// Returns true if either calls a function.
    pub(super) fn calls(&self, function: Function) -> bool {
        [&self.friction, &self.torque].into_iter().any(|of| of.functions.contains(&function))
    }

    /// The definitions `of` functions that are called.
    pub(super) fn definitions<const N: usize>(&self, of: [(Function, &'static str); N]) -> String {
        of.into_iter().filter(|(function, _)| self.calls(*function)).map(|(_, text)| text).collect()
    }
}

/// Definitions of constants with their comments.
pub(super) fn constants(of: &[&Constant], syntax: &Syntax) -> String {
    let mut text = String::new();
    for Constant { name, value, about } in of {
        let definition = format!("{}{name}{}{value:?}{}", syntax.constant, syntax.is, syntax.end);
        let about = safe(about);
        let Syntax { comment, comment_end, comment_gap, .. } = syntax;
        let line = format!("{definition}{comment_gap}{comment}{about}{comment_end}");
        if line.chars().count() <= LINE_WIDTH {
            text += &format!("{line}\n");
            continue;
        }
        let width = LINE_WIDTH - syntax.comment.len() - syntax.comment_end.len();
        for line in wrapped(&about, width) {
            text += &format!("{}{line}{}\n", syntax.comment, syntax.comment_end);
        }
        text += &format!("{definition}\n");
    }
    text
}

/// Assignments of a function's body, indented by four blanks.
pub(super) fn assignments(of: &Listing, syntax: &Syntax) -> String {
    let mut text = String::new();
    for line in &of.lines {
        match line {
            CodeLine::Title(title) => {
                text += &format!("\n    {}{title}{}\n", syntax.comment, syntax.comment_end);
            }
            CodeLine::Assignment { name, value } => {
                text += &value_lines(&format!("{}{name} = ", syntax.variable), value, syntax.end, syntax);
            }
        }
    }
    text
}

/// `before`, a value and `end` in lines that are not too long, indented by four blanks.
pub(super) fn value_lines(before: &str, value: &str, end: &str, syntax: &Syntax) -> String {
    let [open, close] = syntax.parentheses;
    let fits = 4 + before.len() + value.len() + end.len() <= LINE_WIDTH;
    let (open, close) = if fits { ("", "") } else { (open, close) };
    let first = LINE_WIDTH.saturating_sub(4 + before.len() + open.len() + close.len() + end.len());
    let lines = wrapped_code(value, first, LINE_WIDTH - 8 - close.len() - end.len());
    format!("    {before}{open}{}{close}{end}\n", lines.join("\n        "))
}

/// Names of the joints' inputs in order, `_` for those that are not read.
pub(super) fn names_read(prefix: &str, read: &[bool]) -> Vec<Option<String>> {
    read.iter().enumerate().map(|(j, read)| read.then(|| format!("{prefix}{}", j + 1))).collect()
}

/// Text for a comment of any language: no end of a comment or string, no hidden characters, no backslashes.
pub(super) fn safe(text: &str) -> String {
    text::shown(text)
        // first, since `*\` becomes `*/`
        .replace('\\', "/")
        .replace("*/", "* /")
        .replace("/*", "/ *")
        .replace("\"\"\"", "'''")
        .replace("```", "'''")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_ends_a_comment() {
        for (text, expected) in [
            ("R01 ü", "R01 ü"),
            ("*/ int x;", "* / int x;"),
            ("*\\ int x;", "* / int x;"),
            ("/*/", "/ * /"),
            ("\\*\\", "/ * /"),
            ("a\nb\u{2028}\u{202e}", "a/nb/u{2028}/u{202e}"),
            ("*\u{202e}", "* /u{202e}"),
            ("\"\"\" ```", "''' '''"),
        ] {
            assert_eq!(safe(text), expected);
        }
    }
}
