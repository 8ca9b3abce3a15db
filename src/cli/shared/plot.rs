//! Files of requested pictures, and the limits that they show.

use std::path::{Path, PathBuf};

use super::result_file::{objection, write_lines};
use crate::cli::context::CliError;
use crate::report::figure::Figure;
use crate::report::friction_index::IndexLimits;
use crate::report::rmsd::RmsdLimits;
use armwatch_config::Config;

/// A picture's file, whose ending determines the format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlotFile {
    path: PathBuf,
    as_page: bool,
}

impl PlotFile {
    /// Parses a file name that ends in `.svg` or `.html`. Only an earlier result may exist there.
    pub fn parse(text: &str) -> Result<Self, String> {
        let path = PathBuf::from(text);
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let file = match ending.as_deref() {
            Some("svg") => Self { path, as_page: false },
            Some("html" | "htm") => Self { path, as_page: true },
            _ => return Err("a picture is written as .svg or .html; end the name with one of them".into()),
        };
        objection(&file.path).map_or(Ok(file), Err)
    }

    /// Path of the picture.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes the picture and reports it.
    pub fn write(&self, figure: &Figure) -> Result<(), CliError> {
        let text = if self.as_page { figure.html() } else { figure.svg() };
        write_lines(&self.path, text.lines().map(str::to_owned))
    }
}

/// Limits of the relative RMSD in the configuration.
pub fn rmsd_limits(config: &Config) -> RmsdLimits {
    RmsdLimits { warning: config.detect.accuracy_warning, critical: config.detect.accuracy_critical }
}

/// Limits of the friction index in the configuration.
pub fn index_limits(config: &Config) -> IndexLimits {
    IndexLimits { warning: config.detect.drift_warning, critical: config.detect.drift_critical }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ending_says_what_is_written() {
        let parsed = |text| PlotFile::parse(text).map(|file| file.as_page);
        assert_eq!(parsed("a.svg"), Ok(false));
        assert_eq!(parsed("a b.HTML"), Ok(true));
        assert!(parsed("a.png").is_err() && parsed("svg").is_err());
    }
}
