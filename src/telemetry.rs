//! Logs: words for people and machines on standard error; results never go through here.
//!
//! INFO is a step of life, WARN is odd but nothing is lost, ERROR needs a person.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Starts logging to standard error. `verbosity` 0 shows INFO, each step more shows one level more,
/// each step less one less. The environment variable `ARMWATCH_LOG` overrides it with a filter such
/// as `armwatch=debug,sqlx=warn`.
pub fn start(format: LogFormat, verbosity: i8) {
    let level = match verbosity {
        ..=-2 => "error",
        -1 => "warn",
        0 => "info",
        1 => "debug",
        2.. => "trace",
    };
    let usual = format!("warn,armwatch={level}");
    let filter = EnvFilter::try_from_env("ARMWATCH_LOG").unwrap_or_else(|_| EnvFilter::new(usual));
    let builder =
        tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false);
    // a second start, as in tests, keeps the first
    let _ = match format {
        LogFormat::Text => builder.with_ansi(std::io::stderr().is_terminal()).try_init(),
        LogFormat::Json => builder.json().flatten_event(true).try_init(),
    };
}
