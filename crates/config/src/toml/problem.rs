//! Problems of a configuration, in words that help to correct them.

use std::fmt;

use serde::Serialize;

/// One mistake in a configuration file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ConfigProblem {
    /// The file with the name given to the reader.
    pub file: String,
    /// Line, from 1; `None` for a problem of the whole file.
    pub line: Option<usize>,
    /// Column in characters, from 1.
    pub column: Option<usize>,
    /// Dotted key; entries of lists have numbers from 1, as in `joint[2].alpha_deg`. Empty for mistakes of syntax.
    pub key: String,
    /// The value in the file, shortened; `None` if there is none.
    pub value: Option<String>,
    /// The fault, with unit and permitted range if there is one.
    pub problem: String,
    /// The remedy, if known.
    pub hint: Option<String>,
}

impl fmt::Display for ConfigProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
            if let Some(column) = self.column {
                write!(f, ":{column}")?;
            }
        }
        f.write_str(": ")?;
        match (&self.key, &self.value) {
            (key, None) if key.is_empty() => {}
            (key, Some(value)) if !key.is_empty() => write!(f, "{key} = {value}: ")?,
            (key, _) => write!(f, "{key}: ")?,
        }
        f.write_str(&self.problem)?;
        match &self.hint {
            Some(hint) => write!(f, "; {hint}"),
            None => Ok(()),
        }
    }
}

/// Every mistake found, file by file in the order of their lines. Displayed one per line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct ConfigErrors(pub Vec<ConfigProblem>);

impl fmt::Display for ConfigErrors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, problem) in self.0.iter().enumerate() {
            if i > 0 {
                f.write_str("\n")?;
            }
            write!(f, "{problem}")?;
        }
        Ok(())
    }
}

impl ConfigErrors {
    /// A single problem of a whole file, such as a failed read.
    pub fn of_file(file: &str, problem: String, hint: Option<String>) -> Self {
        Self(vec![ConfigProblem {
            file: file.to_owned(),
            line: None,
            column: None,
            key: String::new(),
            value: None,
            problem,
            hint,
        }])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_problem_is_shown_with_place_key_value_and_hint() {
        let problem = ConfigProblem {
            file: "config/armwatch.toml".into(),
            line: Some(12),
            column: Some(14),
            key: "watch.settle_s".into(),
            value: Some("-1".into()),
            problem: "must be between 0 and 3600 s".into(),
            hint: Some("3 suits most controllers".into()),
        };
        assert_eq!(
            problem.to_string(),
            "config/armwatch.toml:12:14: watch.settle_s = -1: must be between 0 and 3600 s; 3 suits most controllers"
        );
    }

    #[test]
    fn problems_without_place_or_key_leave_no_empty_colons() {
        let errors = ConfigErrors::of_file("a.toml", "cannot be read".into(), None);
        assert_eq!(errors.to_string(), "a.toml: cannot be read");
    }
}
