//! `armwatch config init`: the shipped configuration as files to edit.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use crate::cli::context::{CliError, EXIT_DONE, Global};
use crate::cli::shared::output;
use crate::cli::shared::paths::not_written;
use armwatch_config::shipped_files;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch config init
  armwatch config init /etc/armwatch

The command writes armwatch.toml with every setting, descriptions of arms into robots/ and layouts of exports into
exports/. It does not change existing files. `armwatch config check --config DIR/armwatch.toml` checks the files
after you have edited them.")]
pub(in crate::cli) struct InitArgs {
    /// Folder to write to; created if missing
    #[arg(value_name = "DIR", default_value = "config")]
    folder: PathBuf,
}

pub(in crate::cli) fn init(global: &Global, args: &InitArgs) -> Result<u8, CliError> {
    for (name, text) in shipped_files() {
        let path = args.folder.join(name);
        let is_new = write_new(&path, text).map_err(|error| not_written(&path, &error))?;
        if global.json {
            output::json(&json!({"file": path.display().to_string(), "written": is_new}));
        } else {
            let done = if is_new { "written" } else { "kept   " };
            output::line(&format!("{done}  {}", path.display()));
        }
    }
    Ok(EXIT_DONE)
}

/// Writes a file unless it exists; returns true if it was written.
fn write_new(path: &Path, text: &str) -> std::io::Result<bool> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)?;
    }
    match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(mut file) => file.write_all(text.as_bytes()).map(|()| true),
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
        Err(error) => Err(error),
    }
}
