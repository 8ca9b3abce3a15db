//! Writes all result files of commands. It replaces an earlier result, but never a database, an export or another file.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{BufWriter, Error, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use clap::builder::{PathBufValueParser, TypedValueParser};

use super::output;
use super::paths::not_written;
use crate::cli::context::CliError;
use armwatch_ingest::bytes::fingerprint::id_of;

/// Start of a database file (SQLite, "Database File Format", 1.3).
const DATABASE: &[u8] = b"SQLite format 3\0";

/// Endings of files that belong to the database next to them: those of SQLite, and the claim of a daemon.
const BESIDE_DATABASE: [&[u8]; 4] = [b"-wal", b"-shm", b"-journal", b".daemon"];

/// Starts of results: pictures, pages, PDF, programmes of test motions, URDF, and the tables of `torque` and
/// `friction`. [`is_motion`] recognises tables of motions.
const RESULTS: [&[u8]; 8] = [
    b"<svg",
    b"<!DOCTYPE html>",
    b"%PDF",
    b"{",
    b"<?xml",
    b"<robot",
    b"time_s,stage,joint,",
    b"robot,run_id,cycle,",
];

/// Bytes that are read: more than the header of a table of motions of nine joints has.
const LOOKED_AT: u64 = 4096;

/// Parser for the name of a result file. Only an earlier result may exist there.
pub(in crate::cli) fn result_file() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| objection(&path).map_or(Ok(path), Err))
}

/// The reason why results must not replace the file at `path`, and the remedy. `None` if there is no file or an earlier
/// result, or if the path is not a regular file, such as a pipe.
pub(in crate::cli) fn objection(path: &Path) -> Option<String> {
    let real = path.canonicalize().ok();
    if let Some(database) = [Some(path), real.as_deref()].into_iter().flatten().find_map(database_beside) {
        return Some(format!(
            "it belongs to the database {}, which results must not touch; name another file",
            database.display()
        ));
    }
    match beginning(path) {
        Ok(None) => None,
        Ok(Some(begin)) if begin.starts_with(DATABASE) => {
            Some("it is a database, which results must not replace; name another file".into())
        }
        Ok(Some(begin)) if is_result(&begin) => None,
        Ok(Some(_)) => Some(
            "it is not an earlier result of this program, so it is not replaced; name another file, or \
            delete this one first"
                .into(),
        ),
        Err(error) => Some(format!("it cannot be read ({error}), so it is not changed; name another file")),
    }
}

/// Refuses to replace a file that is not an earlier result.
///
/// # Errors
/// [`CliError::Usage`] with the [`objection`].
fn refuse_other(path: &Path) -> Result<(), CliError> {
    match objection(path) {
        Some(objection) => Err(CliError::Usage(format!("{}: {objection}", path.display()))),
        None => Ok(()),
    }
}

/// Refuses a database, or a file that belongs to one, even if a user permits replacement.
///
/// # Errors
/// [`CliError::Usage`].
pub(in crate::cli) fn refuse_database(path: &Path) -> Result<(), CliError> {
    if database_beside(path).is_some() || is_database(path) {
        return Err(CliError::Usage(format!(
            "{} is a database or belongs to one, so it is not replaced; name another file",
            path.display()
        )));
    }
    Ok(())
}

/// Refuses to overwrite a source of the results; `what` names it, such as "the export itself".
///
/// # Errors
/// [`CliError::Usage`] if both names refer to one file.
pub(in crate::cli) fn refuse_source(
    target: Option<&Path>,
    source: &Path,
    what: &str,
) -> Result<(), CliError> {
    let Some(target) = target else { return Ok(()) };
    let number = |path: &Path| std::fs::metadata(path).ok().map(|metadata| id_of(&metadata));
    match (number(target), number(source)) {
        (Some(of_target), Some(of_source)) if of_target == of_source => Err(CliError::Usage(format!(
            "{} is {what}, so it is not written to; name another file",
            target.display()
        ))),
        _ => Ok(()),
    }
}

/// Writes a file of these lines and reports it.
///
/// # Errors
/// [`CliError::Usage`] if the existing file is not an earlier result, [`CliError::Io`] if it cannot be written.
pub(in crate::cli) fn write_lines(path: &Path, lines: impl Iterator<Item = String>) -> Result<(), CliError> {
    refuse_other(path)?;
    let written = || -> Result<(), Error> {
        let mut file = BufWriter::new(File::create(path)?);
        for line in lines {
            writeln!(file, "{line}")?;
        }
        file.flush()
    };
    written().map_err(|error| not_written(path, &error))?;
    output::print_hint(&format!("wrote {}", path.display()));
    Ok(())
}

/// Copies a finished result file to its place and reports it.
///
/// # Errors
/// Those of [`write_lines`].
pub(in crate::cli) fn copy(finished: &Path, path: &Path) -> Result<(), CliError> {
    refuse_other(path)?;
    std::fs::copy(finished, path).map_err(|error| not_written(path, &error))?;
    output::print_hint(&format!("wrote {}", path.display()));
    Ok(())
}

/// The first bytes of the file at `path`; `None` if there is no regular file.
fn beginning(path: &Path) -> Result<Option<Vec<u8>>, Error> {
    // opening a pipe would wait for its writer; other errors are reported by the write
    if !std::fs::metadata(path).is_ok_and(|metadata| metadata.is_file()) {
        return Ok(None);
    }
    let mut begin = Vec::new();
    File::open(path)?.take(LOOKED_AT).read_to_end(&mut begin)?;
    Ok(Some(begin))
}

fn is_database(path: &Path) -> bool {
    matches!(beginning(path), Ok(Some(begin)) if begin.starts_with(DATABASE))
}

/// The database that a file belongs to by its name, whether the file is there or not.
fn database_beside(path: &Path) -> Option<PathBuf> {
    let name = path.file_name()?.as_bytes();
    BESIDE_DATABASE.iter().find_map(|ending| {
        let database = path.with_file_name(OsStr::from_bytes(name.strip_suffix(*ending)?));
        is_database(&database).then_some(database)
    })
}

/// Returns true if a file with this start is an earlier result, or empty.
fn is_result(begin: &[u8]) -> bool {
    begin.is_empty() || RESULTS.iter().any(|result| begin.starts_with(result)) || is_motion(begin)
}

/// Returns true if a file with this start is a table of a motion, which has no torques; an export of such a motion has
/// them.
fn is_motion(begin: &[u8]) -> bool {
    let header = String::from_utf8_lossy(begin);
    let header = header.lines().next().unwrap_or_default();
    let is_of_motion = |name: &str| {
        ["pos_", "vel_", "acc_"].iter().any(|quantity| name.starts_with(quantity))
            || ["time_s", "stage", "cycle", "joint", "level"].contains(&name)
    };
    header.starts_with("time_s,pos_1_") && header.split(',').all(is_of_motion)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::context::{EXIT_IO, EXIT_USAGE};

    fn lines(text: &str) -> impl Iterator<Item = String> {
        text.lines().map(str::to_owned)
    }

    #[test]
    fn earlier_results_are_replaced_and_nothing_else_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.csv");
        assert_eq!(objection(&path), None, "nothing lies there");
        for result in [
            "",
            "<svg xmlns=\"http://www.w3.org/2000/svg\">",
            "<!DOCTYPE html>\n<html>",
            "%PDF-1.4\n%\u{e2}",
            "{\n  \"format\": \"armwatch-trajectory\"",
            "<?xml version=\"1.0\"?>\n<robot>",
            "time_s,stage,joint,q_rad\n0,excitation,1,0",
            "robot,run_id,cycle,minute\nLeft,1,1,0.5",
            "time_s,pos_1_rad,vel_1_rad_s,acc_1_rad_s2,stage,cycle,joint,level\n0,0,0,0,0,1,0,0",
            "time_s,pos_1_m,vel_1_m_s",
        ] {
            std::fs::write(&path, result).expect("written");
            assert_eq!(objection(&path), None, "{result}");
        }
        let others: [&[u8]; 7] = [
            b"SQLite format 3\0\x10\0",
            b"time,pos_1,pos_2,vel_1,vel_2,trq_1,trq_2,stage,cycle,joint,level\n0,0,0,0,0,0,0,0,1,0,0\n",
            b"time_s,pos_1_rad,vel_1_rad_s,trq_1_nm\n0,0,0,0\n",
            b"\x1f\x8b\x08\0\0",
            b"\x28\xb5\x2f\xfd",
            b"[watch]\nfolders = [\"inbox\"]\n",
            b"\xff\xfe",
        ];
        for other in others {
            std::fs::write(&path, other).expect("written");
            let said = objection(&path).expect("an objection");
            assert!(said.contains("name another file"), "{said}");
            let error = write_lines(&path, lines("x")).expect_err("refused");
            assert!(error.to_string().contains("a.csv: it is") && error.exit_code() == EXIT_USAGE, "{error}");
            assert_eq!(std::fs::read(&path).expect("as it was"), other);
        }
        std::fs::write(&path, "robot,run_id,cycle,minute\nLeft,1,1,0.5\n").expect("written");
        write_lines(&path, lines("robot,run_id,cycle,minute")).expect("replaced");
        assert_eq!(std::fs::read(&path).expect("a file"), b"robot,run_id,cycle,minute\n");
        let error = write_lines(&folder.path().join("none/a.csv"), lines("x")).expect_err("no folder");
        assert_eq!(error.exit_code(), EXIT_IO);
        assert_eq!(objection(Path::new("/dev/null")), None, "no file");
    }

    #[test]
    fn what_belongs_to_a_database_is_left_alone_by_whatever_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |name: &str| folder.path().join(name);
        std::fs::write(of("fleet.db"), DATABASE).expect("written");
        std::os::unix::fs::symlink(of("fleet.db"), of("link.svg")).expect("a link");
        for name in ["fleet.db", "fleet.db-wal", "fleet.db-shm", "fleet.db-journal", "fleet.db.daemon"] {
            let said = objection(&of(name)).expect("an objection");
            assert!(said.contains("database"), "{name}: {said}");
            assert!(refuse_database(&of(name)).is_err(), "{name}");
        }
        assert!(objection(&of("link.svg")).is_some_and(|said| said.contains("database")));
        // a name alone is no evidence
        for name in ["other.db-wal", "-wal", "fleet.svg", "fleet.db.svg"] {
            assert_eq!(objection(&of(name)), None, "{name}");
            assert!(refuse_database(&of(name)).is_ok(), "{name}");
        }
        let text = of("notes.txt");
        std::fs::write(&text, "to do").expect("written");
        assert!(objection(&text).is_some() && refuse_database(&text).is_ok());
    }

    #[test]
    fn a_source_is_known_by_whatever_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let of = |name: &str| folder.path().join(name);
        std::fs::write(of("a.json"), "{}").expect("written");
        std::fs::write(of("b.json"), "{}").expect("written");
        std::fs::hard_link(of("a.json"), of("hard.json")).expect("a link");
        std::os::unix::fs::symlink(of("a.json"), of("soft.json")).expect("a link");
        let source = of("a.json");
        let refused = |name: &str| refuse_source(Some(&of(name)), &source, "the programme itself");
        for name in ["a.json", "./a.json", "hard.json", "soft.json"] {
            let error = refused(name).expect_err("refused");
            assert!(
                error.to_string().contains("is the programme itself, so it is not written to"),
                "{error}"
            );
        }
        assert!(refused("b.json").is_ok() && refused("none.json").is_ok());
        assert!(refuse_source(None, &source, "the programme itself").is_ok());
    }
}
