//! The rules see what is planted: each of these small programs breaks one, or none.

use std::collections::BTreeSet;

use super::source::{self, Code, Sources};
use super::table::Rules;
use super::{arrows, places, rules};

/// Rooms `robot`, `numerics`, `store`, `simulate`, `cli` and `main`.
const MAP: &str = "
## Rooms

| room | does | may name | outside crates |
|---|---|---|---|
| `robot` | | | `nalgebra` |
| `numerics` | | `robot` | `faer` |
| `store` | | `robot`, `numerics` | `sqlx` |
| `simulate` | | `robot` | `rand-distr` |
| `telemetry` | | | |
| `cli` | | all above | |
| `main` | | `cli` | |

| crates open to several rooms | to |
|---|---|
| `thiserror` | every room |
| `tokio` | every room but `robot`, `numerics` |

## Decisions
";

const CRATES: [&str; 6] = ["nalgebra", "faer", "sqlx", "rand_distr", "thiserror", "tokio"];

/// A program of these files; the rooms that are not given are empty.
fn program(files: &[(&str, &str)]) -> Result<Vec<Code>, Vec<String>> {
    let mut sources: Sources =
        files.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect();
    let rooms = ["robot", "numerics", "store", "simulate", "telemetry", "cli"];
    let mut lib = String::new();
    for room in rooms {
        lib.push_str(&format!("pub mod {room};\n"));
        if !sources.contains_key(&format!("{room}/mod.rs")) {
            sources.entry(format!("{room}.rs")).or_default();
        }
    }
    sources.entry("lib.rs".to_owned()).or_insert(lib);
    source::program(&sources)
}

/// What breaks a rule on rooms, crates or names in a program of these files.
fn broken(files: &[(&str, &str)]) -> Vec<String> {
    let rules = Rules::read(MAP).expect("a map");
    let crates: BTreeSet<String> = CRATES.map(str::to_owned).into();
    match program(files) {
        Ok(codes) => rules::violations(&codes, &rules, &crates),
        Err(problems) => problems,
    }
}

/// Asserts that code in a file breaks exactly one rule, at a line, and that the message has these words.
fn caught(file: &str, code: &str, line: usize, words: &str) {
    let found = broken(&[(file, code)]);
    let expected = format!("{file}:{line}: ");
    assert!(
        found.iter().any(|told| told.starts_with(&expected) && told.contains(words)),
        "{code}\nwanted {expected}{words}, found {found:#?}"
    );
}

fn passes(file: &str, code: &str) {
    let found = broken(&[(file, code)]);
    assert!(found.is_empty(), "{code}\n{found:#?}");
}

#[test]
fn imports_of_another_room_are_seen_in_every_form() {
    for code in [
        "use crate::store::Store;",
        "use crate::{robot::Robot, store::{Store, open}};",
        "use crate::store;",
        "use crate::store as kept;",
        "use crate::{self as all};",
        "use crate::*;",
        "use super::store::Store;",
        "pub use crate::store::Store;",
        "use armwatch_store::Store;",
        "fn f() { use crate::store::Store; }",
    ] {
        caught("simulate.rs", code, 1, "simulate names");
    }
    passes(
        "simulate.rs",
        "use crate::robot::{Robot, joint::{self, Joint}};\nuse self::arm::Arm;\nmod arm { pub struct Arm; }",
    );
    passes("store.rs", "use crate::numerics::base;");
}

#[test]
fn paths_of_another_room_are_seen_wherever_code_can_name_one() {
    for code in [
        "fn f() { crate::store::open(); }",
        "fn f() -> crate::store::Store { loop {} }",
        "struct A { store: Option<crate::store::Store> }",
        "impl From<crate::store::Store> for A { }",
        "fn f<T: crate::store::Kept>(_: T) {}",
        "fn f() where A: crate::store::Kept {}",
        "fn f() { let crate::store::Store { .. } = g(); }",
        "fn f() { match g() { crate::store::NONE => {} } }",
        "fn f() { let _ = |s: crate::store::Store| s; }",
        "pub(in crate::store) struct A;",
        "const A: usize = crate::store::SIZE;",
        "macro_rules! m { () => { $crate::store::open() }; }",
        "fn f() { vec![crate::store::open(); 3]; }",
        "fn f() { assert!(matches!(g(), Some(crate::store::NONE)), \"{}\", 1); }",
        "fn f() { pick! { a = g() => crate::store::open(a), else => {} } }",
        "#[derive(crate::store::Kept)] struct A;",
        "mod inner { fn f() { super::super::store::open(); } }",
    ] {
        caught("simulate.rs", code, 1, "simulate names crate::store");
    }
    passes(
        "simulate.rs",
        "fn f() { let store = store(); store.open(); let crate_store = \"crate::store\"; }",
    );
    passes("simulate.rs", "//! [`crate::store`]\n/// [`crate::store::Store`] // crate::store\nfn f() {}");
}

#[test]
fn what_follows_a_module_of_tests_is_seen() {
    caught(
        "simulate.rs",
        "#[cfg(test)]\nmod tests { use crate::store::Store; }\nuse crate::store::Store;",
        3,
        "store",
    );
    caught(
        "simulate.rs",
        "#[cfg(test)]\nuse crate::store::Store;\nfn f() { crate::store::open(); }",
        3,
        "store",
    );
    caught("store.rs", "#[cfg(test)] mod tests {}\nfn f() { g().unwrap(); }", 2, "unwrap");
    caught("simulate.rs", "#[cfg(not(test))]\nuse crate::store::Store;", 2, "store");
    caught("simulate.rs", "#[cfg(any(test, unix))]\nuse crate::store::Store;", 2, "store");
}

#[test]
fn what_is_compiled_for_tests_only_is_free() {
    passes("simulate.rs", "#[cfg(test)] use crate::store::Store;\n#[test] fn f() { g().unwrap(); }");
    passes("simulate.rs", "#[cfg(all(test, unix))] fn f() { crate::store::open(); }");
    passes("simulate.rs", "#[tokio::test] async fn f() { panic!(); }");
    passes("simulate.rs", "impl A { #[cfg(test)] fn f(&self) { crate::store::open(); } }");
    passes("simulate.rs", "struct A { #[cfg(test)] store: crate::store::Store }");
    passes("simulate.rs", "fn f() { #[cfg(test)] let a = crate::store::open(); }");
    let of_tests = [
        ("simulate.rs", "#[cfg(test)] mod checks;"),
        ("simulate/checks.rs", "use crate::store::Store; mod more;"),
        ("simulate/checks/more.rs", "fn f() { crate::store::open().unwrap(); }"),
    ];
    assert_eq!(broken(&of_tests), [""; 0]);
}

#[test]
fn files_are_found_by_their_declarations() {
    let deep = [
        ("simulate/mod.rs", "mod arm { pub mod link; }"),
        ("simulate/arm/link.rs", "fn f() { crate::store::open(); }"),
    ];
    assert_eq!(broken(&deep), ["simulate/arm/link.rs:1: simulate names crate::store"]);
    let stray = broken(&[("simulate/stray.rs", "")]);
    assert_eq!(stray, ["simulate/stray.rs is declared by no `mod`"]);
    let gone = broken(&[("simulate.rs", "mod gone;")]);
    assert_eq!(gone, ["simulate.rs: no file for `mod gone`"]);
    let unknown = broken(&[
        ("lib.rs", "mod robot; mod numerics; mod store; mod simulate; mod telemetry; mod cli; mod attic;"),
        ("attic.rs", ""),
    ]);
    assert_eq!(unknown, ["attic.rs: room attic has no row in ARCHITECTURE.md"]);
    assert_eq!(
        broken(&[("main.rs", "fn main() { armwatch_store::open(); }")]),
        ["main.rs:1: main names crate::store"]
    );
    assert!(broken(&[("simulate.rs", "\nfn f( {")])[0].starts_with("simulate.rs:2: "));
}

#[test]
fn drivers_of_engines_are_named_at_their_door_only() {
    for code in [
        "use sqlx::SqliteConnection;",
        "use sqlx::{Row, sqlite::SqliteRow};",
        "fn f(pool: &sqlx::PgPool) {}",
        "fn f() { sqlx::postgres::PgConnectOptions::new(); }",
    ] {
        caught("store.rs", code, 1, "is named by crate::store::engine alone");
    }
    passes("store.rs", "use sqlx::{QueryBuilder, Row, query::Query};");
}

#[test]
fn outside_crates_are_named_behind_their_door_only() {
    for code in [
        "use faer::Mat;",
        "use ::faer::Mat;",
        "use faer;",
        "use faer as algebra;",
        "extern crate faer;",
        "fn f() -> faer::Mat<f64> { loop {} }",
        "fn f() { write!(s, \"{}\", faer::norm(m)); }",
        "#[derive(faer::Kept)] struct A;",
        "#[faer::kept] fn f() {}",
    ] {
        caught("store.rs", code, 1, "store names the crate faer");
    }
    caught("robot.rs", "fn f() { tokio::spawn(g()); }", 1, "robot names the crate tokio");
    passes(
        "store.rs",
        "use tokio::sync::mpsc;\n#[derive(thiserror::Error)] struct A;\nfn f() { let faer = 1; g(faer); }",
    );
    passes("simulate.rs", "use rand_distr::Normal;");
    passes("numerics.rs", "use faer::Mat;");
}

#[test]
fn the_method_knows_no_world() {
    caught("numerics.rs", "async fn f() {}", 1, "asynchronous");
    caught("numerics.rs", "fn f() { let a = async { 1 }; }", 1, "asynchronous");
    caught("numerics.rs", "fn f() { pick! { a = g().await => {} } }", 1, "asynchronous");
    caught("numerics.rs", "use std::fs;", 1, "std::fs");
    caught("numerics.rs", "use std::{f64, fs::File};", 1, "std::fs");
    caught("numerics.rs", "use std::*;", 1, "std::");
    caught("numerics.rs", "use std::time::*;", 1, "std::time::");
    caught("numerics.rs", "use std::time;\nfn f() { time::Instant::now(); }", 2, "std::time::Instant");
    caught("numerics.rs", "use std as s;\nfn f() { s::env::var(\"A\"); }", 2, "std::env");
    caught("numerics.rs", "fn f() { std::thread::spawn(g); }", 1, "std::thread");
    caught(
        "robot.rs",
        "use jiff::Timestamp;\nfn f() -> Timestamp { Timestamp::now() }",
        2,
        "jiff::Timestamp::now",
    );
    caught("numerics.rs", "mod inner {\nuse std::time::Instant;\nfn f() { Instant::now(); } }", 3, "Instant");
    passes(
        "numerics.rs",
        "use std::time::Duration;\nuse jiff::Timestamp;\nfn f(at: Timestamp) -> Duration { g(at) }",
    );
    passes("store.rs", "use std::fs;\nasync fn f() { fs::read(\"a\").ok(); g().await; }");
}

#[test]
fn statements_stand_in_the_store_only() {
    caught("cli.rs", "const Q: &str = \"SELECT 1\";", 1, "SQL");
    caught("cli.rs", "fn f() { query(\"\n  INSERT INTO a VALUES (1)\"); }", 1, "SQL");
    caught("cli.rs", "fn f() { format!(\"PRAGMA {name}\"); }", 1, "SQL");
    passes("cli.rs", "/// SELECT 1\nfn f() { say(\"Select a robot\"); }");
    passes("store.rs", "const Q: &str = \"SELECT 1\";");
}

#[test]
fn one_file_prints() {
    for code in [
        "fn f() { println!(\"a\"); }",
        "fn f() { if a { eprint!(\"a\") } }",
        "fn f() { std::print!(\"a\"); }",
        "fn f() { pick! { a => println!(\"{a}\"), else => {} } }",
    ] {
        caught("cli.rs", code, 1, "prints");
    }
    caught("cli.rs", "use std::io;\nfn f() { io::stdout().write_all(b\"a\"); }", 2, "std::io::stdout");
    caught("cli.rs", "use std::io::stderr;", 1, "std::io::stderr");
    let output = [
        ("cli/mod.rs", "mod shared;"),
        ("cli/shared/mod.rs", "mod output;"),
        ("cli/shared/output.rs", "fn f() { println!(\"a\"); std::io::stdout().lock(); }"),
    ];
    assert_eq!(broken(&output), [""; 0]);
    let debugging = [
        ("cli/mod.rs", "mod shared;"),
        ("cli/shared/mod.rs", "mod output;"),
        ("cli/shared/output.rs", "fn f() { dbg!(1); }"),
    ];
    assert_eq!(broken(&debugging), ["cli/shared/output.rs:1: dbg! prints"]);
    passes("cli.rs", "fn f() -> bool { std::io::stderr().is_terminal() }");
    passes("telemetry.rs", "fn f() { g(std::io::stderr); }");
}

#[test]
fn nothing_panics_on_purpose() {
    for code in [
        "fn f() { g().unwrap(); }",
        "fn f() { g().expect(\"it\"); }",
        "fn f() { g().expect(&format!(\"it\")); }",
        "fn f() { a.map(Result::unwrap); }",
        "fn f() { a.map(std::option::Option::unwrap); }",
        "fn f() { panic!(\"a\"); }",
        "fn f() { std::panic!(\"a\"); }",
        "fn f() { todo!() }",
        "fn f() { unreachable!() }",
        "fn f() { assert_eq!(g().unwrap(), 1); }",
        "fn f() { pick! { a = g() => a.unwrap(), else => {} } }",
        "macro_rules! m { ($a:expr) => { $a.unwrap() }; }",
        "impl A { #[cfg(test)] fn g() {} fn f() { g().unwrap(); } }",
    ] {
        caught("store.rs", code, 1, "panics");
    }
    passes(
        "store.rs",
        "fn f() { g().unwrap_or_default(); g().unwrap_or_else(h); std::panic::catch_unwind(g).ok(); }",
    );
    passes("store.rs", "#[expect(dead_code, reason = \"it\")] fn f() { /* panic!() */ say(\"panic!\"); }");
    caught("store.rs", "#[allow(dead_code)]\nfn f() {}", 1, "#[allow]");
}

#[test]
fn a_map_that_contradicts_itself_is_told() {
    let problems = |rows: &str| {
        let map =
            format!("\n## Rooms\n\n| room | does | may name | outside crates |\n|---|---|---|---|\n{rows}\n");
        Rules::read(&map).map(|rules| rules.problems())
    };
    assert_eq!(problems("| `a` | | | |\n| `b` | | `a` | |"), Ok(Vec::new()));
    let upward = problems("| `a` | | `b` | |\n| `b` | | | |").expect("rules");
    assert_eq!(upward, ["room a may name b, which is no row above it"]);
    let unknown = problems("| `a` | | `attic` | |").expect("rules");
    assert_eq!(unknown, ["room a may name attic, which is no row above it"]);
    assert_eq!(problems("| `a` | | | |\n| `a` | | | |").expect("rules"), ["room a has two rows"]);
    assert!(problems("| `a` | | nouns | |").is_err(), "words that are no names");
    assert!(problems("| `a` | | |").is_err(), "a row of three cells");
    assert!(problems("").is_err(), "no rows");
    assert!(Rules::read("# A\n\n## Other\n").is_err(), "no section");
}

/// The circles in a program of these files.
fn circles(files: &[(&str, &str)]) -> Vec<String> {
    arrows::circles(&program(files).expect("sources"))
}

/// Whether code in `numerics/a.rs` names `numerics/b.rs`, which names `a`.
fn leads_to_b(code: &str) -> bool {
    let room = ("numerics/mod.rs", "pub mod a;\npub mod b;\npub struct Refused;");
    !circles(&[room, ("numerics/a.rs", code), ("numerics/b.rs", "use super::a::A;")]).is_empty()
}

#[test]
fn a_circle_of_files_is_seen() {
    let two = [
        ("numerics/mod.rs", "pub mod a;\npub mod b;\npub mod c;"),
        ("numerics/a.rs", "\nuse super::b::B;\nuse super::c::C;\nfn f() { super::b::f(); }"),
        ("numerics/b.rs", "fn g() { crate::numerics::a::f(); }"),
        ("numerics/c.rs", ""),
    ];
    let expected = [
        "numerics: a circle of 2 files: numerics/a.rs, numerics/b.rs",
        "    numerics/a.rs:2 names crate::numerics::b::B",
        "    numerics/b.rs:1 names crate::numerics::a::f",
    ];
    assert_eq!(circles(&two), expected);
    let three = [
        ("numerics/mod.rs", "pub mod a;\npub mod b;\npub struct Refused;"),
        ("numerics/a.rs", "use super::b::c::C;"),
        ("numerics/b/mod.rs", "pub mod c;\nuse super::a::A;"),
        ("numerics/b/c.rs", "use super::B;\nuse crate::numerics::Refused;"),
    ];
    let files = "numerics/a.rs, numerics/b/c.rs, numerics/b/mod.rs";
    assert_eq!(circles(&three)[0], format!("numerics: a circle of 3 files: {files}"));
    let rooms = [("robot.rs", "use crate::numerics::A;"), ("numerics.rs", "use crate::robot::B;")];
    assert_eq!(circles(&rooms), [""; 0]);
}

#[test]
fn a_room_that_needs_its_children_is_in_a_circle_with_them() {
    for code in [
        "pub mod a;\nfn f() { a::f(); }",
        "fn f() { a::f(); }\npub mod a;",
        "mod a;\nuse a::a;\nfn f() { a(1); }",
        "mod a;\nuse self::a::A;",
        "mod a;\npub use a::A;\nfn f(_: A) {}",
        "mod a;\nfn f() { let kept: Vec<a::A> = vec![a::f(); 3]; }",
    ] {
        let found = circles(&[("numerics.rs", code), ("numerics/a.rs", "use super::Refused;")]);
        assert!(!found.is_empty(), "{code}");
    }
    for code in ["pub mod a;", "mod a;\npub use a::{A, f as g};", "mod a;\nfn f() { let a = 1; g(a); }"] {
        let found = circles(&[("numerics.rs", code), ("numerics/a.rs", "use super::Refused;")]);
        assert_eq!(found, [""; 0], "{code}");
    }
}

#[test]
fn every_form_of_naming_a_file_is_an_arrow() {
    for code in [
        "use super::b;",
        "use super::b::*;",
        "use super::{Refused, b::{self, B}};",
        "use crate::numerics::b::B as Other;",
        "use super as room;\nfn f() { room::b::f(); }",
        "fn f() { super::b::f(); }",
        "impl From<super::b::B> for A {}",
        "mod inner { use super::super::b::B; }",
        "macro_rules! m { () => { $crate::numerics::b::f() }; }",
        "#[cfg(not(test))]\nuse super::b;",
        "#[cfg(test)]\nmod tests {}\nuse super::b;",
    ] {
        assert!(leads_to_b(code), "{code}");
    }
}

#[test]
fn what_needs_nothing_of_a_file_is_no_arrow() {
    for code in [
        "pub use super::b::B;",
        "pub use super::b::*;",
        "pub(super) use super::b::{self, B};",
        "pub(in crate::numerics::b) struct A;",
        "//! [`super::b`]\n/// [`super::b::B`]\nfn f() {}",
        "mod b {}\nfn f() { b::f(); }",
        "use super::Refused;\nfn f(b: f64) -> f64 { super::f(b) }",
    ] {
        assert!(!leads_to_b(code), "{code}");
    }
}

#[test]
fn code_for_tests_draws_no_arrow() {
    for code in [
        "#[cfg(test)]\nuse super::b::B;",
        "#[cfg(test)]\nmod tests { use crate::numerics::b::B; }",
        "#[test]\nfn f() { super::b::f(); }",
        "impl A { #[cfg(test)] fn f() { super::b::f(); } }",
    ] {
        assert!(!leads_to_b(code), "{code}");
    }
    let of_tests = [
        ("numerics/mod.rs", "pub mod a;\n#[cfg(test)]\nmod checks;"),
        ("numerics/a.rs", "#[cfg(test)]\nuse super::checks::f;"),
        ("numerics/checks.rs", "use super::a::A;"),
    ];
    assert_eq!(circles(&of_tests), [""; 0]);
}

/// A room with the folder `a/`, the file `b.rs`, which names it, and the file `c.rs`, which names both.
const INSIDE: [(&str, &str); 5] = [
    ("numerics/mod.rs", "pub mod c;\npub mod b;\npub mod a;\npub use c::C;"),
    ("numerics/a/mod.rs", "//! The first.\npub mod inner;\nuse super::Refused;"),
    ("numerics/a/inner.rs", "use crate::robot::Robot;"),
    ("numerics/b.rs", "//! The second, in\n//! two lines. More of it.\n\nuse super::a::inner::A;"),
    ("numerics/c.rs", "use super::{a::A, b::B};"),
];

/// The head of a room's table.
const HEADER: &str = "| place | does | may name |\n|---|---|---|";

/// The rows that fit `INSIDE`.
const ROWS: &str = "| `a/` | The first | |
| `b.rs` | The second, in two lines | `a/` |
| `c.rs` | | `a/`, `b.rs` |";

/// What a table of `numerics` with these rows finds in `INSIDE`, and in more files that take the place of its
/// own.
fn misplaced(rows: &str, more: &[(&str, &str)]) -> Vec<String> {
    let files = [&INSIDE, more].concat();
    let map = format!("# A\n\n## Inside the rooms\n\n### numerics\n\n{HEADER}\n{rows}\n\n## Decisions\n");
    let tables = places::read(&map).expect("tables");
    places::violations(&program(&files).expect("sources"), &tables)
}

#[test]
fn an_arrow_that_the_table_of_a_room_does_not_allow_is_seen() {
    assert_eq!(misplaced(ROWS, &[]), [""; 0]);
    assert_eq!(misplaced(&ROWS.replace("`a/`, `b.rs` |", "all above |"), &[]), [""; 0]);
    let upward = misplaced(ROWS, &[("numerics/a/inner.rs", "\nuse crate::numerics::b::B;")]);
    assert_eq!(upward[0], "numerics/a/inner.rs:2 names crate::numerics::b::B: a/ may not name b.rs");
    let order = "No order fits a/, b.rs, c.rs, of these arrows some lead back:
    a/ to b.rs: numerics/a/inner.rs:2 names crate::numerics::b::B";
    assert!(upward[1].contains(order), "{}", upward[1]);
    let silent = misplaced(&ROWS.replace("two lines | `a/` |", "two lines | |"), &[]);
    assert_eq!(silent[0], "numerics/b.rs:4 names crate::numerics::a::inner::A: b.rs may not name a/");
    assert_eq!(silent[1..], [format!("\n### numerics\n\n{HEADER}\n{ROWS}")]);
    let re_export = misplaced(ROWS, &[("numerics/a/inner.rs", "pub use super::super::c::C;")]);
    assert_eq!(re_export, [""; 0]);
    let of_tests = misplaced(ROWS, &[("numerics/a/inner.rs", "#[cfg(test)]\nuse crate::numerics::c::C;")]);
    assert_eq!(of_tests, [""; 0]);
}

#[test]
fn rows_and_places_belong_to_each_other() {
    let table = format!("\n### numerics\n\n{HEADER}\n{ROWS}");
    let without = misplaced(ROWS.rsplit_once('\n').expect("rows").0, &[]);
    assert_eq!(without, ["numerics: c.rs has no row", &table]);
    let empty = ["c.rs", "b.rs", "a/"].map(|place| format!("numerics: {place} has no row"));
    assert_eq!(misplaced("", &[])[..3], empty);
    assert_eq!(misplaced("", &[])[3..], [table]);
    let gone = misplaced(&format!("{ROWS}\n| `d/` | | |"), &[]);
    assert_eq!(gone[0], "numerics: d/ has a row and is no place");
    let upward = misplaced(&ROWS.replace("The first | |", "The first | `b.rs` |"), &[]);
    assert_eq!(upward[0], "numerics: a/ may name b.rs, which is no row above it");
    let twice = misplaced(&format!("{ROWS}\n| `a/` | | |"), &[]);
    assert_eq!(twice[0], "numerics: a/ has two rows");
}

#[test]
fn the_file_of_a_room_has_a_row_where_it_names_places() {
    let wiring = ("numerics/mod.rs", "pub mod a;\npub mod b;\npub mod c;\nfn f() { c::f(); }");
    assert_eq!(misplaced(ROWS, &[wiring])[0], "numerics: mod.rs has no row");
    assert_eq!(misplaced(&format!("{ROWS}\n| `mod.rs` | | `c.rs` |"), &[wiring]), [""; 0]);
    let silent = misplaced(&format!("{ROWS}\n| `mod.rs` | | |"), &[wiring]);
    assert_eq!(silent[0], "numerics/mod.rs:4 names crate::numerics::c::f: mod.rs may not name c.rs");
}

#[test]
fn a_folder_of_a_room_may_have_a_table_too() {
    let files = |low: &'static str| {
        [
            ("numerics/mod.rs", "pub mod a;\npub mod b;"),
            ("numerics/a/mod.rs", "pub mod low;\npub mod high;"),
            ("numerics/a/low.rs", low),
            ("numerics/a/high/mod.rs", "pub mod inner;\nuse crate::numerics::a::low::L;"),
            ("numerics/a/high/inner.rs", "use crate::numerics::b::B;"),
            ("numerics/b.rs", ""),
        ]
    };
    let rows = "| `low.rs` | | |\n| `high/` | | `low.rs` |";
    let map = format!("# A\n\n## Inside the rooms\n\n### numerics/a\n\n{HEADER}\n{rows}\n");
    let tables = places::read(&map).expect("tables");
    let found = |low| places::violations(&program(&files(low)).expect("sources"), &tables);
    // what lies outside the folder is not its table's business
    assert_eq!(found("use crate::numerics::b::B;"), [""; 0]);
    let upward = found("use super::high::inner::H;");
    let told = "numerics/a/low.rs:1 names crate::numerics::a::high::inner::H: low.rs may not name high/";
    assert_eq!(upward[0], told);
}

#[test]
fn tables_of_the_inside_that_cannot_be_read_are_told() {
    let read = |tables: &str| places::read(&format!("# A\n\n## Inside the rooms\n\n{tables}\n"));
    assert_eq!(read("No table.").map(|tables| tables.len()), Ok(0));
    assert!(read("### a\n\n| place | may name |\n|---|---|\n| `b` | |").is_err(), "two columns");
    assert!(read(&format!("### a\n\n{HEADER}\n| `b` | |")).is_err(), "a row of two cells");
    assert!(read(&format!("### a\n\n{HEADER}\n| b | | |")).is_err(), "a place without backticks");
    assert!(read(&format!("### a\n\n{HEADER}\n| `b/` | | c |")).is_err(), "words that are no names");
    assert!(places::read("# A\n\n## Rooms\n").is_err(), "no section");
    let tables = read("### attic\n\n### robot\n\n### robot").expect("tables");
    let found = places::violations(&program(&[]).expect("sources"), &tables);
    assert_eq!(found[0], "attic has a table and is no room");
    assert_eq!(found[1], "robot has two tables");
}
