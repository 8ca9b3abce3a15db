//! Recordings that are exported in several files: `[parts]`.

use std::sync::LazyLock;
use std::time::Duration;

use regex::Regex;

use crate::toml::range::Limits;
use crate::toml::table::Table;

/// Most names of parts: each part keeps a file open.
const MOST_NAMES: usize = 32;

/// Default time that a recording waits for its last part.
const WAIT_S: f64 = 600.0;
const WAIT: Limits = Limits::between(0.0, 86_400.0, "s");

/// Placeholder of the part in a pattern of file names.
const PART: &str = "{part}";

/// Names of parts that need no `[parts]`: `R01_20260301_0800_part2.csv`, and `R01_20260301_0800_2.mcap` as rosbag2
/// writes them.
static NUMBERED: LazyLock<Option<Regex>> = LazyLock::new(|| {
    let pattern = r"(?i)^.*(?:[_.-]part[_-]?(?<part>\d{1,6})(?:\.(?:csv|parquet|mcap))(?:\.(?:gz|zst))?|_(?<bag>\d{1,6})\.mcap)$";
    Regex::new(pattern).ok()
});

/// Relation between the rows of a recording's parts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PartMatch {
    /// Rows of the same number are joined side by side.
    Row,
    /// Rows of the same time are joined side by side; those of the first part give the times.
    Time,
    /// The rows of one part follow those of another.
    After,
}

/// The files that are the parts of one recording, and the relation of their rows.
#[derive(Debug, Clone)]
pub struct PartRule {
    /// Matches names of parts, with the group `part`.
    pattern: Regex,
    /// The parts in their order; empty if they are numbered.
    pub names: Vec<String>,
    /// Relation of rows.
    pub matching: PartMatch,
    /// Time that a recording waits for its last part.
    pub wait: Duration,
}

impl PartialEq for PartRule {
    fn eq(&self, other: &Self) -> bool {
        let parts = |of: &Self| (of.pattern.as_str().to_owned(), of.names.clone(), of.matching, of.wait);
        parts(self) == parts(other)
    }
}

/// A file name that contains a part of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartName {
    /// Text before the part.
    pub before: String,
    /// The part.
    pub part: String,
    /// Text after the part.
    pub after: String,
    /// All parts in their order; empty if they are numbered.
    pub names: Vec<String>,
    /// Time that the recording waits for its last part.
    pub wait: Duration,
    /// True if the part comes from a layout's rule, and not only from the name.
    pub is_told: bool,
}

impl PartRule {
    /// The part in a file name; `None` if there is none.
    pub(crate) fn part_of(&self, file_name: &str) -> Option<PartName> {
        let part = part_by(&self.pattern, file_name, &self.names, self.wait)?;
        Some(PartName { is_told: true, ..part })
    }
}

/// The numbered part in a file name without a rule.
pub(crate) fn numbered_part(file_name: &str) -> Option<PartName> {
    // few names contain a part, and a search for a text is faster than a pattern
    let may_be = file_name.ends_with(".mcap") || file_name.to_ascii_lowercase().contains("part");
    let pattern = NUMBERED.as_ref().filter(|_| may_be)?;
    part_by(pattern, file_name, &[], Duration::from_secs_f64(WAIT_S))
}

fn part_by(pattern: &Regex, file_name: &str, names: &[String], wait: Duration) -> Option<PartName> {
    let captures = pattern.captures(file_name)?;
    let part = captures.name("part").or_else(|| captures.name("bag"))?;
    Some(PartName {
        before: file_name[..part.start()].to_owned(),
        part: part.as_str().to_owned(),
        after: file_name[part.end()..].to_owned(),
        names: names.to_vec(),
        wait,
        is_told: false,
    })
}

/// Reads `[parts]`; `None` if it is wrong.
pub(crate) fn read(table: &Table<'_>) -> Option<PartRule> {
    let matching = table.required("match").and_then(|value| match value.text()? {
        "row" => Some(PartMatch::Row),
        "time" => Some(PartMatch::Time),
        "after" => Some(PartMatch::After),
        _ => {
            value.refuse("must be \"row\", \"time\" or \"after\"".into(), None);
            None
        }
    });
    let names = match table.optional("names") {
        None => Some(Vec::new()),
        Some(value) => {
            let names: Option<Vec<String>> =
                value.items()?.iter().map(|item| item.text().map(str::to_owned)).collect();
            let names = names?;
            let is_odd = |name: &String| name.contains(['{', '}', '|', '/']);
            let twice = (1..names.len()).any(|at| names[..at].contains(&names[at]));
            if names.len() < 2 || names.len() > MOST_NAMES || twice || names.iter().any(is_odd) {
                let problem = format!("must be 2 to {MOST_NAMES} different names without {{ }} | /");
                value.refuse(problem, None);
                return None;
            }
            Some(names)
        }
    };
    let pattern = match table.optional("file_name") {
        None => Some("*_{part}"),
        Some(value) => {
            let text = value.text()?;
            if text.matches(PART).count() != 1 {
                let hint = "write it like \"*_{part}\"; * matches any characters";
                value.refuse(format!("must contain {PART} once"), Some(hint.into()));
                return None;
            }
            Some(text)
        }
    };
    let wait = table.number_or("wait_s", &WAIT, WAIT_S);
    let (matching, names, pattern) = (matching?, names?, pattern?);
    if names.is_empty() && matching != PartMatch::After {
        let hint = "write names = [\"pos\", \"trq\"], in the order of the columns";
        table.refuse("needs the names of the parts, because none may be missing".into(), Some(hint.into()));
        return None;
    }
    let pattern = regex_of(pattern, &names)?;
    Some(PartRule { pattern, names, matching, wait: Duration::from_secs_f64(wait?) })
}

/// The pattern over whole file names, including endings.
fn regex_of(pattern: &str, names: &[String]) -> Option<Regex> {
    let (before, after) = pattern.split_once(PART)?;
    let literal = |text: &str| regex::escape(text).replace(r"\*", ".*");
    let alternatives: Vec<String> = names.iter().map(|name| regex::escape(name)).collect();
    let part = if names.is_empty() { r"\d{1,6}".to_owned() } else { alternatives.join("|") };
    let endings = r"(?i:\.(?:csv|parquet|mcap)(?:\.(?:gz|zst))?)?";
    Regex::new(&format!("^{}(?<part>{part}){}{endings}$", literal(before), literal(after))).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::layout_file::parse_layout;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    fn rule(keys: &str) -> Result<PartRule, String> {
        let layout = parse_layout("a.toml", &format!("{NATIVE}\n[parts]\n{keys}"));
        layout.map_err(|errors| errors.to_string()).map(|layout| layout.parts.expect("a rule"))
    }

    #[test]
    fn a_file_name_says_its_part_and_what_stands_around_it() {
        let of = |rule: &PartRule, name: &str| {
            rule.part_of(name).map(|of| format!("{}<{}>{}", of.before, of.part, of.after))
        };
        let by_name = rule("match = \"row\"\nnames = [\"pos\", \"trq\"]").expect("a rule");
        assert_eq!(
            of(&by_name, "R01_20260301_0800_pos.csv.gz").as_deref(),
            Some("R01_20260301_0800_<pos>.csv.gz")
        );
        assert_eq!(of(&by_name, "R01_20260301_0800_vel.csv"), None);
        let first =
            rule("match = \"time\"\nnames = [\"q\", \"tau\"]\nfile_name = \"{part}-*\"").expect("a rule");
        assert_eq!(of(&first, "tau-R01.parquet").as_deref(), Some("<tau>-R01.parquet"));
        let numbered = rule("match = \"after\"\nwait_s = 5").expect("a rule");
        assert_eq!(of(&numbered, "R01_007.mcap").as_deref(), Some("R01_<007>.mcap"));
        assert_eq!(numbered.wait, Duration::from_secs(5));
        let unasked = |name: &str| numbered_part(name).map(|of| of.part);
        assert_eq!(unasked("R01_20260105_0847_part12.csv").as_deref(), Some("12"));
        assert_eq!(unasked("R01_20260105_0847_3.mcap").as_deref(), Some("3"));
        for name in ["R01_20260105_0847_3.csv", "R01_parts.csv", "part_of_7.csv"] {
            assert_eq!(unasked(name), None, "{name}");
        }
    }

    #[test]
    fn what_is_missing_or_too_much_is_said() {
        for (keys, said) in [
            ("names = [\"a\", \"b\"]", "parts.match: is missing"),
            ("match = \"side\"", "must be \"row\", \"time\" or \"after\""),
            ("match = \"row\"", "needs the names of the parts"),
            ("match = \"row\"\nnames = [\"a\"]", "must be 2 to 32 different names"),
            ("match = \"row\"\nnames = [\"a\", \"a\"]", "must be 2 to 32 different names"),
            ("match = \"after\"\nfile_name = \"*\"", "must contain {part} once"),
            ("match = \"after\"\nwait_s = -1", "must be between"),
            ("match = \"after\"\nwait = 1", "unknown key"),
        ] {
            let errors = rule(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }
}
