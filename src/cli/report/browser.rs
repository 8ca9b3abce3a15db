//! Converts a page to a PDF file with a Chromium of this machine.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

use tokio::process::Command;

use crate::cli::context::CliError;
use crate::cli::shared::result_file;

/// Names of programs that print pages; the first that is found is used.
const NAMES: [&str; 8] = [
    "chromium",
    "chromium-browser",
    "google-chrome-stable",
    "google-chrome",
    "chrome",
    "chrome-headless-shell",
    "microsoft-edge",
    "msedge",
];

/// A page of a year of tests is printed in a few seconds; a browser that takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// Prints a page to a PDF file and reports it.
///
/// # Errors
/// [`CliError::Io`] if there is no browser, or it fails.
pub(super) async fn print(html: &str, path: &Path, browser: Option<&Path>) -> Result<(), CliError> {
    let browser = find(browser, std::env::var_os("PATH").as_deref())?;
    let failed = |what: &str| {
        CliError::Io(format!(
            "{} does not print {}: {what}; end the name with .html and print that page from a browser",
            browser.display(),
            path.display()
        ))
    };
    let folder = tempfile::tempdir().map_err(|error| failed(&error.to_string()))?;
    let page = folder.path().join("report.html");
    let written = std::fs::File::create(&page).and_then(|mut file| file.write_all(html.as_bytes()));
    written.map_err(|error| failed(&error.to_string()))?;
    let printed = folder.path().join("report.pdf");
    let mut said = String::new();
    // its sandbox does not work in containers or as root; the page comes from this program and has no script
    for sandbox in [None, Some("--no-sandbox")] {
        let mut command = Command::new(&browser);
        command.args(["--headless", "--disable-gpu", "--no-first-run", "--no-pdf-header-footer"]);
        command.arg(format!("--user-data-dir={}", folder.path().join("profile").display()));
        command.arg(format!("--print-to-pdf={}", printed.display())).args(sandbox).arg(&page);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).kill_on_drop(true);
        let done = tokio::time::timeout(PATIENCE, command.output()).await;
        let done =
            done.map_err(|_| failed(&format!("it has not finished after {} s", PATIENCE.as_secs())))?;
        let done = done.map_err(|error| failed(&error.to_string()))?;
        if std::fs::metadata(&printed).is_ok_and(|file| file.len() > 0) {
            // a rename to another file system is impossible
            return result_file::copy(&printed, path);
        }
        said = String::from_utf8_lossy(&done.stderr).lines().last().unwrap_or("no word").trim().to_owned();
    }
    Err(failed(&said))
}

/// The browser that was named, or the first of [`NAMES`] in the folders of `path`.
fn find(named: Option<&Path>, path: Option<&std::ffi::OsStr>) -> Result<PathBuf, CliError> {
    if let Some(named) = named {
        return Ok(named.to_owned());
    }
    let folders: Vec<PathBuf> = path.map(|path| std::env::split_paths(path).collect()).unwrap_or_default();
    let places = NAMES.iter().flat_map(|name| folders.iter().map(move |folder| folder.join(name)));
    places.into_iter().find(|place| place.is_file()).ok_or_else(|| {
        CliError::Io(format!(
            "a PDF needs Chromium, but none of {} is in PATH; name a program with --browser, or end the \
            name with .html and print that page from any browser",
            NAMES.join(", ")
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_browser_the_error_says_what_to_do() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = find(None, Some(folder.path().as_os_str())).expect_err("no browser");
        assert!(error.to_string().contains("--browser") && error.to_string().contains(".html"), "{error}");
        assert_eq!(error.exit_code(), crate::cli::context::EXIT_IO);
        std::fs::write(folder.path().join("google-chrome"), "").expect("a file");
        let found = find(None, Some(folder.path().as_os_str())).expect("a browser");
        assert_eq!(found.file_name().and_then(|name| name.to_str()), Some("google-chrome"));
        assert_eq!(find(Some(Path::new("/x")), None).expect("named"), Path::new("/x"));
    }
}
