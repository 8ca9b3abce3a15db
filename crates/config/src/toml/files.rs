//! Configuration files on disk.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::problem::ConfigErrors;

/// Gives the text of the file at a path.
pub(crate) type ReadText<'r> = dyn Fn(&Path) -> Result<String, ConfigErrors> + 'r;

/// Largest configuration file that is read. Hand-written ones have some kilobytes; an export named
/// by mistake must not fill the memory.
const MAX_BYTES: u64 = 1 << 20;

/// The text of the file at `path`.
///
/// # Errors
///
/// One problem with the reason why the file cannot be read.
pub(crate) fn read_text(path: &Path) -> Result<String, ConfigErrors> {
    let name = path.display().to_string();
    let refuse = |problem: String| ConfigErrors::of_file(&name, problem, None);
    let file = File::open(path).map_err(|error| refuse(format!("cannot be read: {error}")))?;
    let mut bytes = Vec::new();
    file.take(MAX_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| refuse(format!("cannot be read: {error}")))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(refuse(format!("is larger than {MAX_BYTES} bytes and cannot be a configuration")));
    }
    String::from_utf8(bytes).map_err(|error| {
        let line =
            1 + error.as_bytes()[..error.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count();
        let mut errors = refuse("is not UTF-8 text".into());
        for problem in &mut errors.0 {
            problem.line = Some(line);
            problem.hint = Some("save the file as UTF-8".into());
        }
        errors
    })
}
