//! Secrets, read when they are used, so that a changed one takes effect at once. Nothing here shows one.

use std::fs::File;
use std::io::Read;

use armwatch_config::receivers::Secret;

/// Longest secret, bytes.
const LONGEST: u64 = 8192;

/// Reads a secret: the first line of its file, or its variable.
///
/// # Errors
/// A sentence that names the place and what to do.
pub fn read(secret: &Secret) -> Result<String, String> {
    let text = match secret {
        Secret::File(path) => {
            let failed = |error: std::io::Error| format!("{secret}: {error}; make it readable for this user");
            let mut text = String::new();
            File::open(path).map_err(failed)?.take(LONGEST).read_to_string(&mut text).map_err(failed)?;
            text.lines().next().unwrap_or_default().trim().to_owned()
        }
        Secret::Environment(name) => std::env::var(name)
            .map_err(|_| format!("{secret} is not set; set it where the program is started"))?,
    };
    if text.is_empty() { Err(format!("{secret} is empty; write the secret into it")) } else { Ok(text) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_a_line_and_its_absence_names_the_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("password");
        let secret = Secret::File(path.clone());
        assert!(read(&secret).unwrap_err().contains("password"));
        std::fs::write(&path, "\n").unwrap();
        assert!(read(&secret).unwrap_err().contains("is empty"));
        std::fs::write(&path, "s3cret\nnot this\n").unwrap();
        assert_eq!(read(&secret).unwrap(), "s3cret");
        let unset = read(&Secret::Environment("ARMWATCH_NO_SUCH_VARIABLE".into()));
        assert!(unset.unwrap_err().contains("ARMWATCH_NO_SUCH_VARIABLE is not set"));
    }
}
