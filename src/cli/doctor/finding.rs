//! What was found, and what to do about it.

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CheckLevel {
    /// As it should be.
    Ok,
    /// The daemon works, and somebody should know.
    Warning,
    /// The daemon does not work, or will lose or refuse something.
    Problem,
}

impl CheckLevel {
    /// Name in output.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Warning => "warning",
            Self::Problem => "problem",
        }
    }
}

/// One finding.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct DoctorFinding {
    /// What was looked at.
    pub(super) check: &'static str,
    /// How bad it is.
    pub(super) level: CheckLevel,
    /// A sentence.
    pub(super) said: String,
    /// What to do; empty where nothing is to be done.
    pub(super) remedy: String,
}

impl DoctorFinding {
    /// Nothing is to be done.
    pub(super) fn ok(check: &'static str, said: impl ToString) -> Self {
        Self { check, level: CheckLevel::Ok, said: said.to_string(), remedy: String::new() }
    }

    /// Somebody should know.
    pub(super) fn warning(check: &'static str, said: impl ToString, remedy: impl ToString) -> Self {
        Self { check, level: CheckLevel::Warning, said: said.to_string(), remedy: remedy.to_string() }
    }

    /// The daemon does not work with it.
    pub(super) fn problem(check: &'static str, said: impl ToString, remedy: impl ToString) -> Self {
        Self { level: CheckLevel::Problem, ..Self::warning(check, said, remedy) }
    }

    /// As people read it.
    pub(super) fn line(&self) -> String {
        let Self { check, level, said, remedy } = self;
        let remedy = if remedy.is_empty() { String::new() } else { format!("; {remedy}") };
        format!("{:7}  {check}: {said}{remedy}", level.name())
    }
}
