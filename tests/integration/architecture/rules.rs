//! The rules of ARCHITECTURE.md, each a function from code to what breaks it.

use std::collections::BTreeSet;

use super::source::{Code, Mention, What};
use super::table::{Room, Rules};

/// Rooms of the nouns and of the method: without async, files, clock, randomness and logs.
const PURE: [&str; 5] = ["robot", "run", "analysis", "anomaly", "numerics"];

/// What pure rooms do not name.
const WORLD: [&str; 14] = [
    "std::env",
    "std::fs",
    "std::io",
    "std::net",
    "std::os",
    "std::process",
    "std::thread",
    "std::time::Instant",
    "std::time::SystemTime",
    "jiff::Timestamp::now",
    "jiff::Zoned::now",
    "jiff::tz::TimeZone::system",
    "tokio",
    "tracing",
];

/// The file that prints.
const PRINTER: &str = "cli/shared/output.rs";

/// The file that gives the log its stream.
const LOG: &str = "telemetry.rs";

/// Files of the store that name the drivers of engines: the door, and what is of one engine alone.
const OF_DRIVERS: [&str; 7] = [
    "store/engine/",
    "store/server/",
    "store/open.rs",
    "store/schema.rs",
    "store/new_schema.rs",
    "store/snapshot.rs",
    "store/backup.rs",
];

/// Words that an SQL statement begins with.
const STATEMENTS: [&str; 14] = [
    "ALTER ",
    "ATTACH ",
    "BEGIN IMMEDIATE",
    "COMMIT",
    "CREATE ",
    "DELETE FROM ",
    "DROP ",
    "INSERT INTO ",
    "PRAGMA ",
    "ROLLBACK",
    "SELECT ",
    "UPDATE ",
    "VACUUM",
    "WITH RECURSIVE ",
];

/// The room of a file; `main.rs` is a room of its own, `lib.rs` declares rooms and is none.
fn room<'a>(code: &Code, rules: &'a Rules) -> Result<Option<&'a Room>, String> {
    let name = code.room();
    if name == "lib" {
        return Ok(None);
    }
    let row = rules.rooms.iter().find(|room| room.name == name);
    row.map(Some).ok_or_else(|| format!("{}: room {name} has no row in ARCHITECTURE.md", code.file))
}

/// Everything that breaks a rule, as `file:line: what`.
pub fn violations(codes: &[Code], rules: &Rules, dependencies: &BTreeSet<String>) -> Vec<String> {
    let mut found = rules.problems();
    for code in codes {
        let room = match room(code, rules) {
            Ok(room) => room,
            Err(problem) => {
                found.push(problem);
                continue;
            }
        };
        for mention in &code.mentions {
            let broken = [
                room.and_then(|room| other_room(mention, room, rules)),
                room.and_then(|room| outside_crate(mention, room, rules, dependencies)),
                room.and_then(|room| world(mention, room)),
                room.and_then(|room| statement(mention, room)),
                driver(mention, &code.file),
                printing(mention, &code.file),
                panicking(mention),
                silenced(mention),
            ];
            let told = broken.into_iter().flatten();
            found.extend(told.map(|what| format!("{}:{}: {what}", code.file, mention.line)));
        }
    }
    found.dedup();
    found
}

/// Whether a path is, lies in, or (ending in `*`) may lie over, another one.
fn within(path: &[String], outer: &str) -> bool {
    let outer: Vec<&str> = outer.split("::").collect();
    let common = path.iter().zip(&outer).take_while(|(segment, wanted)| segment == wanted).count();
    common == outer.len() || path.get(common).is_some_and(|segment| segment == "*")
}

fn other_room(mention: &Mention, room: &Room, rules: &Rules) -> Option<String> {
    let What::Path(path) = &mention.what else { return None };
    if path[0] != "crate" {
        return None;
    }
    let named = path.get(1).map_or("*", String::as_str);
    if named == "*" || named == "self" {
        return Some(format!("{} names all rooms at once", room.name));
    }
    let is_room = rules.rooms.iter().any(|row| row.name == named);
    let broken = is_room && named != room.name && !room.names.contains(named);
    broken.then(|| format!("{} names crate::{named}", room.name))
}

fn outside_crate(
    mention: &Mention,
    room: &Room,
    rules: &Rules,
    dependencies: &BTreeSet<String>,
) -> Option<String> {
    let What::Path(path) = &mention.what else { return None };
    let broken = dependencies.contains(&path[0]) && !rules.opens(&path[0], room);
    broken.then(|| format!("{} names the crate {}", room.name, path[0]))
}

fn world(mention: &Mention, room: &Room) -> Option<String> {
    if !PURE.contains(&room.name.as_str()) {
        return None;
    }
    match &mention.what {
        What::Async => Some(format!("{} is asynchronous", room.name)),
        What::Path(path) => {
            let named = WORLD.iter().find(|world| within(path, world))?;
            Some(format!("{} names {named}", room.name))
        }
        _ => None,
    }
}

fn statement(mention: &Mention, room: &Room) -> Option<String> {
    let What::Literal(text) = &mention.what else { return None };
    let text = text.trim_start();
    let broken = room.name != "store" && STATEMENTS.iter().any(|statement| text.starts_with(statement));
    let first: String = text.chars().take(40).collect();
    broken.then(|| format!("{} holds SQL: {first:?}", room.name))
}

fn driver(mention: &Mention, file: &str) -> Option<String> {
    let What::Path(path) = &mention.what else { return None };
    let [first, second, ..] = path.as_slice() else { return None };
    let is_of_one =
        ["sqlite", "postgres", "Sqlite", "Postgres", "Pg"].iter().any(|of| second.starts_with(of));
    let broken = first == "sqlx" && is_of_one && !OF_DRIVERS.iter().any(|place| file.starts_with(place));
    broken.then(|| format!("{} is named by crate::store::engine alone", path.join("::")))
}

fn printing(mention: &Mention, file: &str) -> Option<String> {
    match &mention.what {
        What::Macro(name) if ["print", "println", "eprint", "eprintln", "dbg"].contains(&name.as_str()) => {
            (file != PRINTER || name == "dbg").then(|| format!("{name}! prints"))
        }
        What::Path(path) if [PRINTER, LOG].contains(&file) || path.len() < 2 => None,
        What::Path(path) => ["std::io::stdout", "std::io::stderr"]
            .iter()
            .find(|stream| !path.ends_with(&["*".to_owned()]) && within(path, stream))
            .map(|stream| format!("{stream} is written to by {PRINTER} alone")),
        _ => None,
    }
}

fn panicking(mention: &Mention) -> Option<String> {
    match &mention.what {
        What::Macro(name) if ["panic", "todo", "unimplemented", "unreachable"].contains(&name.as_str()) => {
            Some(format!("{name}! panics"))
        }
        What::Method(name) if ends_in_panic(name) => Some(format!(".{name}() panics")),
        What::Path(path) if path.len() > 1 && ends_in_panic(&path[path.len() - 1]) => {
            Some(format!("{} panics", path.join("::")))
        }
        What::Path(path) if within(path, "std::panic::panic_any") && path[path.len() - 1] != "*" => {
            Some("panic_any panics".to_owned())
        }
        _ => None,
    }
}

fn ends_in_panic(name: &str) -> bool {
    ["unwrap", "expect", "unwrap_err", "expect_err", "unwrap_unchecked"].contains(&name)
}

fn silenced(mention: &Mention) -> Option<String> {
    (mention.what == What::Allowed)
        .then(|| "#[allow] silences a lint; #[expect(lint, reason)] tells why".into())
}
