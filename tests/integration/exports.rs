//! Every export of `tests/fixtures/exports`, sound or broken, in the real program: exit status, database and messages
//! agree, and it never panics.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{Workshop, text};

/// Fixtures, by name.
fn fixtures() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/exports");
    let entries = fs::read_dir(folder).expect("fixtures").map(|entry| entry.expect("an entry").path());
    let mut found: Vec<PathBuf> =
        entries.filter(|path| path.extension().is_some_and(|extension| extension == "csv")).collect();
    found.sort();
    assert!(found.len() > 40, "{}", found.len());
    found
}

/// Stores an export in a separate database, and returns the contradictions.
fn problem(workshop: &Workshop, fixture: &Path) -> Option<String> {
    let stem = fixture.file_stem()?.to_str()?;
    let (name, database) = (format!("R00_20260105_0847_{stem}.csv"), format!("{stem}.db"));
    fs::copy(fixture, workshop.path(&name)).expect("a copy");
    let before = fs::read(fixture).expect("the fixture");
    let explained = workshop.run(&["explain", &name, "--db", &database]);
    let taken = workshop.run(&["ingest", &name, "--db", &database]);
    for (of, output) in [("explain", &explained), ("ingest", &taken)] {
        let said = text(&output.stdout) + &text(&output.stderr);
        if !matches!(output.status.code(), Some(0 | 1)) || said.contains("panicked") {
            return Some(format!("{of} ends with {:?}: {said}", output.status.code()));
        }
    }
    let runs = crate::support::query(
        &workshop.path(&database),
        "SELECT runs.status, count(problem), count(remedy)
         FROM runs LEFT JOIN quarantine USING (run_id) GROUP BY runs.run_id",
    );
    let fits = match runs.first().and_then(|run| run.split('|').next()) {
        // both commands report a refusal with its remedy
        Some("quarantined") => {
            runs == ["quarantined|1|1"]
                && taken.status.code() == Some(1)
                && explained.status.code() == Some(1)
                && !text(&taken.stdout).is_empty()
        }
        Some("complete") => runs == ["complete|0|0"],
        _ => false,
    };
    if fs::read(workshop.path(&name)).expect("the export") != before {
        return Some("the export was changed".into());
    }
    (!fits).then(|| format!("{runs:?}, exit status {:?}: {}", taken.status.code(), text(&taken.stdout)))
}

#[test]
fn every_fixture_has_an_outcome_that_all_agree_on() {
    let workshop = Workshop::new();
    let problems: Vec<String> = fixtures()
        .iter()
        .filter_map(|fixture| Some(format!("{}: {}", fixture.display(), problem(&workshop, fixture)?)))
        .collect();
    assert!(problems.is_empty(), "{} fixtures:\n{}", problems.len(), problems.join("\n"));
}
