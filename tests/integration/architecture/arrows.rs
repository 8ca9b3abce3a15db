//! Arrows between the files of a room: which file names which, and whether the arrows lead in a circle.

use std::collections::{BTreeMap, BTreeSet};

use super::source::{Code, What};

/// A file of a room names another file of it.
#[derive(Debug)]
pub struct Arrow<'a> {
    pub from: &'a Code,
    pub to: &'a Code,
    /// Where it is named first.
    pub line: usize,
    /// What stands there, as a full path.
    pub path: String,
}

impl Arrow<'_> {
    /// As `file:line names path`.
    pub fn told(&self) -> String {
        format!("{}:{} names {}", self.from.file, self.line, self.path)
    }
}

/// All arrows inside rooms, in the order of the files, one for each pair of files. A path leads to the file
/// of the longest module that it begins with: `crate::store::run::Row` to `store/run.rs` where there is one,
/// else to `store/mod.rs`. What a file hands on by `pub use` counts to the file that the path names.
pub fn arrows(codes: &[Code]) -> Vec<Arrow<'_>> {
    let files: BTreeMap<String, &Code> = codes.iter().map(|code| (code.module.join("::"), code)).collect();
    let mut found: BTreeMap<(&str, &str), Arrow<'_>> = BTreeMap::new();
    for from in codes {
        for mention in from.mentions.iter().filter(|mention| mention.needed) {
            let What::Path(path) = &mention.what else { continue };
            if path[0] != "crate" || path.get(1).is_none_or(|room| room != from.room()) {
                continue;
            }
            let mut longest_first = (2..=path.len()).rev();
            let to = longest_first.find_map(|end| files.get(&path[1..end].join("::")));
            let Some(to) = to.filter(|to| to.file != from.file) else { continue };
            let arrow = || Arrow { from, to, line: mention.line, path: path.join("::") };
            found.entry((&from.file, &to.file)).or_insert_with(arrow);
        }
    }
    found.into_values().collect()
}

/// Every set of files of which each leads to each other by arrows, told with the arrows between them.
pub fn circles(codes: &[Code]) -> Vec<String> {
    let arrows = arrows(codes);
    let reached = reached(&arrows);
    let leads = |from: &str, to: &str| reached.get(from).is_some_and(|files| files.contains(to));
    let mut told = Vec::new();
    let mut known: BTreeSet<&str> = BTreeSet::new();
    for code in codes {
        let file = code.file.as_str();
        if !leads(file, file) || known.contains(file) {
            continue;
        }
        let members: Vec<&str> = reached[file].iter().copied().filter(|other| leads(other, file)).collect();
        known.extend(&members);
        let count = members.len();
        told.push(format!("{}: a circle of {count} files: {}", code.room(), members.join(", ")));
        let between = arrows.iter().filter(|arrow| {
            members.contains(&arrow.from.file.as_str()) && members.contains(&arrow.to.file.as_str())
        });
        told.extend(between.map(|arrow| format!("    {}", arrow.told())));
    }
    told
}

/// Files that each file leads to over any number of arrows; itself among them if it lies on a circle.
fn reached<'a>(arrows: &[Arrow<'a>]) -> BTreeMap<&'a str, BTreeSet<&'a str>> {
    let mut direct: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for arrow in arrows {
        direct.entry(&arrow.from.file).or_default().push(&arrow.to.file);
    }
    let from = |file: &'a str| {
        let mut reached = BTreeSet::new();
        let mut next = vec![file];
        while let Some(file) = next.pop() {
            let named = direct.get(file).into_iter().flatten();
            next.extend(named.copied().filter(|named| reached.insert(*named)));
        }
        (file, reached)
    };
    direct.keys().map(|file| from(file)).collect()
}
