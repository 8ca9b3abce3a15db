//! Formats help: paragraphs that fit the terminal, examples as typed, commands grouped by purpose.

use clap::builder::{StyledStr, Styles};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, ArgAction, Command};
use strsim::damerau_levenshtein;

use super::context::GLOBAL_HEADING;

/// Widest line of help, characters.
const MAX_WIDTH: usize = 100;

/// Commands by purpose. A command in no group is listed at the end.
const GROUPS: [(&str, &[&str]); 6] = [
    ("View robots", &["status", "robots", "runs", "cycles", "sql", "snapshot", "export"]),
    ("Answer alarms", &["alerts", "maintenance", "calibrate"]),
    ("Read exports", &["run", "ingest", "explain", "quarantine", "conclude", "run-date", "set-aside"]),
    (
        "Identify, verify, plot",
        &["identify", "parameters", "payload", "verify", "torque", "rmsd", "friction", "report"],
    ),
    (
        "Set up",
        &["config", "robot", "layout", "trajectory", "doctor", "backup", "prune", "completions", "man"],
    ),
    ("Try and simulate", &["demo", "simulate"]),
];

/// Heading of commands in no group.
const UNGROUPED: &str = "More commands";

/// Words that people type for a command of another name, and that name.
const MEANT: [(&[&str], &str); 19] = [
    (&["init", "setup", "configure", "new"], "config init"),
    (&["check", "validate", "lint", "test"], "config check"),
    (&["settings"], "config show"),
    (&["version"], "--version"),
    (&["ls", "list", "fleet", "health", "overview", "dashboard", "info", "summary"], "status"),
    (&["start", "daemon", "watch", "serve", "server", "up"], "run"),
    (&["import", "add", "load", "read", "process", "upload"], "ingest"),
    (&["alarm", "alarms", "alert", "anomaly", "anomalies", "warnings"], "alerts list"),
    (&["ack", "acknowledge"], "alerts ack"),
    (&["shelve", "snooze", "mute"], "alerts shelve"),
    (&["query", "select", "db", "database", "export", "csv"], "sql"),
    (&["copy"], "snapshot"),
    (&["dump", "save"], "backup"),
    (&["repair", "service", "repaired"], "maintenance"),
    (&["errors", "failed", "rejected", "retry", "dismiss"], "quarantine"),
    (&["report", "plot", "graph", "picture"], "friction --robot NAME --index --plot index.html"),
    (&["generate", "fake", "sim"], "simulate"),
    (&["infer"], "layout infer"),
    (&["clean", "cleanup", "vacuum", "purge", "shrink", "retention", "compact"], "prune"),
];

/// Options of other programs that correspond to `--json`.
const MEANT_AS_JSON: [&str; 4] = ["--format", "--output", "--out-format", "--output-format"];

/// Most letters that differ between a mistyped command and the one that is proposed.
const FAR: usize = 2;

/// Lines of a help text that belong together: prose, which is wrapped, and indented lines below it, which are
/// unchanged.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(super) struct HelpBlock {
    /// One line of any length; may be empty.
    pub(super) prose: String,
    /// Each begins with spaces.
    pub(super) lines: Vec<String>,
}

impl HelpBlock {
    pub(super) fn is_examples(&self) -> bool {
        self.prose == "Examples:"
    }

    /// A heading stands alone above its lines and has few words.
    fn is_heading(&self) -> bool {
        !self.lines.is_empty() && self.prose.ends_with(':') && self.prose.split(' ').count() <= 2
    }
}

/// Blocks of a text: blank lines separate them, and lines that begin with spaces end prose.
pub(super) fn blocks(text: &str) -> Vec<HelpBlock> {
    let mut blocks = vec![HelpBlock::default()];
    for line in text.lines() {
        let place = blocks.len() - 1;
        let last = &mut blocks[place];
        if line.trim().is_empty() {
            blocks.push(HelpBlock::default());
        } else if line.starts_with(' ') {
            last.lines.push(line.trim_end().to_owned());
        } else if last.lines.is_empty() {
            let space = if last.prose.is_empty() { "" } else { " " };
            last.prose.push_str(space);
            last.prose.push_str(line.trim_end());
        } else {
            blocks.push(HelpBlock { prose: line.trim_end().to_owned(), lines: Vec::new() });
        }
    }
    blocks.retain(|block| *block != HelpBlock::default());
    blocks
}

/// A command with all its subcommands as displayed: examples in `-h`, all texts in `--help`.
pub(super) fn dressed(command: Command) -> Command {
    let groups = groups(&command);
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{groups}{}\n{{options}}{{after-help}}",
        headed(GLOBAL_HEADING)
    );
    let help = "Print help; --help prints more than -h";
    let help = Arg::new("help").short('h').long("help").action(ArgAction::Help).help(help);
    let version = "Print the version";
    let version = Arg::new("version").short('V').long("version").action(ArgAction::Version).help(version);
    reflowed(command)
        .max_term_width(MAX_WIDTH)
        .help_template(template)
        .disable_help_flag(true)
        .disable_version_flag(true)
        .arg(help.global(true).help_heading(GLOBAL_HEADING))
        .arg(version.help_heading(GLOBAL_HEADING))
}

fn reflowed(command: Command) -> Command {
    let text = command.get_after_help().map(ToString::to_string).unwrap_or_default();
    let mut command = command;
    if !text.is_empty() {
        let mut blocks = blocks(&text);
        // readers look for examples first
        blocks.sort_by_key(|block| !block.is_examples());
        let examples: Vec<HelpBlock> = blocks.iter().filter(|block| block.is_examples()).cloned().collect();
        command = command.after_long_help(styled(&blocks)).after_help(styled(&examples));
    }
    command.mut_subcommands(reflowed)
}

fn styled(blocks: &[HelpBlock]) -> StyledStr {
    let texts: Vec<String> = blocks
        .iter()
        .map(|block| {
            let title = if block.is_heading() {
                headed(block.prose.trim_end_matches(':'))
            } else {
                block.prose.clone()
            };
            let lines = std::iter::once(title).chain(block.lines.iter().cloned());
            lines.filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
        })
        .collect();
    texts.join("\n\n").into()
}

fn headed(title: &str) -> String {
    let style = Styles::styled();
    let header = style.get_header();
    format!("{header}{title}:{header:#}")
}

/// The commands that are shown, by group.
fn groups(command: &Command) -> String {
    let shown: Vec<&Command> = command.get_subcommands().filter(|command| !command.is_hide_set()).collect();
    let width = shown.iter().map(|command| command.get_name().len()).max().unwrap_or(0);
    let row = |command: &&Command| {
        let (name, about) = (command.get_name(), command.get_about().map(ToString::to_string));
        let literal = *Styles::styled().get_literal();
        format!("  {literal}{name}{literal:#}{:1$}  {2}\n", "", width - name.len(), about.unwrap_or_default())
    };
    let group = |title: &str, rows: String| match rows.is_empty() {
        true => String::new(),
        false => format!("{}\n{rows}\n", headed(title)),
    };
    let mut text = String::new();
    for (title, names) in GROUPS {
        let of = names.iter().filter_map(|name| shown.iter().find(|command| command.get_name() == *name));
        text += &group(title, of.map(row).collect());
    }
    text + &group(UNGROUPED, ungrouped(command).map(|command| row(&command)).collect())
}

/// Commands that are shown and are in no group.
fn ungrouped(command: &Command) -> impl Iterator<Item = &Command> {
    let is_grouped = |name: &str| GROUPS.iter().any(|(_, names)| names.contains(&name));
    command.get_subcommands().filter(move |command| !command.is_hide_set() && !is_grouped(command.get_name()))
}

/// An error of the command line that proposes the command or option that was probably meant, instead of one with a
/// similar spelling.
pub(super) fn with_what_is_meant(error: clap::Error, command: &Command) -> clap::Error {
    match error.kind() {
        ErrorKind::InvalidSubcommand => with_command_meant(error, command),
        ErrorKind::UnknownArgument => with_option_meant(error),
        _ => error,
    }
}

/// Proposes `--json`, which every command has, instead of `--format json` and the like.
fn with_option_meant(mut error: clap::Error) -> clap::Error {
    let Some(ContextValue::String(typed)) = error.get(ContextKind::InvalidArg) else { return error };
    if MEANT_AS_JSON.contains(&typed.as_str()) {
        error.remove(ContextKind::SuggestedArg);
        // it was made for the similar spelling
        error.remove(ContextKind::Usage);
        propose(&mut error, "--json");
    }
    error
}

fn propose(error: &mut clap::Error, meant: &str) {
    let literal = *Styles::styled().get_valid();
    let tip: StyledStr = format!("did you mean `{literal}{meant}{literal:#}`?").into();
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
}

fn with_command_meant(mut error: clap::Error, command: &Command) -> clap::Error {
    let Some(ContextValue::String(typed)) = error.get(ContextKind::InvalidSubcommand) else { return error };
    let typed = typed.to_lowercase();
    // clap proposes subcommands itself, such as for `alerts lst`
    let words: Vec<String> = std::env::args().collect();
    if words
        .iter()
        .skip(1)
        .find(|word| !word.starts_with('-'))
        .is_none_or(|word| word.to_lowercase() != typed)
    {
        return error;
    }
    error.remove(ContextKind::SuggestedSubcommand);
    if let Some(meant) = meant(&typed, command) {
        propose(&mut error, &format!("armwatch {meant}"));
    }
    error
}

/// The most probable command for a word.
fn meant(typed: &str, command: &Command) -> Option<String> {
    if let Some((_, meant)) = MEANT.iter().find(|(words, _)| words.contains(&typed)) {
        return Some((*meant).to_owned());
    }
    let names = command.get_subcommands().filter(|command| !command.is_hide_set()).map(Command::get_name);
    let distance = |name: &str| damerau_levenshtein(typed, name);
    let near = |name: &&str| {
        let far = FAR.min(typed.chars().count() / 2);
        distance(name) <= far || (typed.len() >= 3 && name.starts_with(typed))
    };
    names.filter(near).min_by_key(|name| distance(name)).map(str::to_owned)
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;
    use crate::cli::Cli;

    #[test]
    fn prose_becomes_one_line_and_indented_lines_stay() {
        let text = "Examples:\n  a b\n  c \\\n      d\n\nOne\nparagraph:\n    e  f\nand another";
        let block = |prose: &str, lines: &[&str]| HelpBlock {
            prose: prose.into(),
            lines: lines.iter().map(|line| (*line).to_owned()).collect(),
        };
        let expected = [
            block("Examples:", &["  a b", "  c \\", "      d"]),
            block("One paragraph:", &["    e  f"]),
            block("and another", &[]),
        ];
        assert_eq!(blocks(text), expected);
        assert!(expected[0].is_heading() && expected[1].is_heading() && !expected[2].is_heading());
    }

    #[test]
    fn every_command_has_a_group_and_every_group_only_commands() {
        let command = Cli::command();
        let left: Vec<&str> = ungrouped(&command).map(Command::get_name).collect();
        assert!(left.is_empty(), "name a group of {left:?} in GROUPS");
        for name in GROUPS.iter().flat_map(|(_, names)| *names) {
            assert!(command.find_subcommand(name).is_some(), "{name} is no command");
        }
    }

    #[test]
    fn what_is_proposed_is_a_command() {
        for (words, meant) in MEANT {
            let mut line = vec!["armwatch"];
            line.extend(meant.split(' '));
            let refused = dressed(Cli::command()).try_get_matches_from(line).err().map(|error| error.kind());
            let is_known = matches!(
                refused,
                None | Some(
                    ErrorKind::MissingRequiredArgument
                        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand
                        | ErrorKind::DisplayVersion
                )
            );
            assert!(is_known, "{words:?} -> {meant}: {refused:?}");
        }
    }

    #[test]
    fn a_format_that_other_programs_have_is_json() {
        let told = |line: &str| {
            let parsed = dressed(Cli::command()).try_get_matches_from(line.split(' '));
            with_option_meant(parsed.expect_err("no option of ours")).to_string()
        };
        assert!(told("armwatch alerts list --format json").contains("did you mean `--json`?"));
        assert!(!told("armwatch alerts list --format json").contains("--log-format"));
        assert!(!told("armwatch alerts ack 1 --frmat json").contains("--json`"));
    }

    #[test]
    fn mistyped_commands_are_understood_by_meaning_before_spelling() {
        let command = Cli::command();
        let found = |typed: &str| meant(typed, &command);
        for (typed, expected) in [
            ("init", "config init"),
            ("version", "--version"),
            ("completion", "completions"),
            ("stauts", "status"),
            ("statsu", "status"),
            ("quar", "quarantine"),
            ("simulat", "simulate"),
            ("robto", "robot"),
        ] {
            assert_eq!(found(typed).as_deref(), Some(expected), "{typed}");
        }
        assert_eq!((found("xyz"), found("no-such-command")), (None, None));
    }
}
