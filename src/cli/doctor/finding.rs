//! Findings of `doctor`, with their remedies.

/// Level of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CheckLevel {
    /// No problem.
    Ok,
    /// The daemon works, but the finding should be known.
    Warning,
    /// The daemon does not work, or will lose or refuse data.
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
    /// The check.
    pub(super) check: &'static str,
    /// Its level.
    pub(super) level: CheckLevel,
    /// A sentence.
    pub(super) said: String,
    /// The remedy; empty if none is needed.
    pub(super) remedy: String,
}

impl DoctorFinding {
    /// A finding that needs no action.
    pub(super) fn ok(check: &'static str, said: impl ToString) -> Self {
        Self { check, level: CheckLevel::Ok, said: said.to_string(), remedy: String::new() }
    }

    /// A finding that should be known.
    pub(super) fn warning(check: &'static str, said: impl ToString, remedy: impl ToString) -> Self {
        Self { check, level: CheckLevel::Warning, said: said.to_string(), remedy: remedy.to_string() }
    }

    /// A finding that prevents the daemon from working.
    pub(super) fn problem(check: &'static str, said: impl ToString, remedy: impl ToString) -> Self {
        Self { level: CheckLevel::Problem, ..Self::warning(check, said, remedy) }
    }

    /// The finding as a line of text.
    pub(super) fn line(&self) -> String {
        let Self { check, level, said, remedy } = self;
        let remedy = if remedy.is_empty() { String::new() } else { format!("; {remedy}") };
        format!("{:7}  {check}: {said}{remedy}", level.name())
    }
}
