//! Logs: words for people and machines on standard error; results never go through here.
//!
//! INFO is a step of life, WARN is odd but nothing is lost, ERROR needs a person.
//!
//! An event is one line, whatever its fields contain: the whole line is escaped, so that no field bypasses the escape.

use std::borrow::Cow;
use std::fmt;
use std::io::IsTerminal;

use anstyle::{AnsiColor, Style};
use clap::ValueEnum;
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::{FmtContext, FormatEvent, FormatFields};
use tracing_subscriber::registry::LookupSpan;

use armwatch_model::text;

/// Format of log lines: text for people, or one JSON object per line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
#[expect(missing_docs, reason = "a text of a value would stand in the help of each command")]
pub enum LogFormat {
    #[default]
    Text,
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
    // an escape of this format would not be distinguished from one in a field
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_target(false)
        .with_ansi(false);
    let is_coloured =
        std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|no| no.is_empty());
    // a second start, as in tests, keeps the first
    let _ = match format {
        LogFormat::Text => {
            builder.map_event_format(|inner| OneLine { inner, escape: text::shown, is_coloured }).try_init()
        }
        LogFormat::Json => builder
            .json()
            .flatten_event(true)
            .map_event_format(|inner| OneLine { inner, escape: text::json, is_coloured: false })
            .try_init(),
    };
}

/// Writes an event as another format does, on one escaped line.
struct OneLine<F> {
    inner: F,
    escape: fn(&str) -> Cow<'_, str>,
    /// Colours the name of the level.
    is_coloured: bool,
}

impl<S, N, F> FormatEvent<S, N> for OneLine<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(
        &self,
        context: &FmtContext<'_, S, N>,
        mut writer: Writer<'_>,
        event: &Event<'_>,
    ) -> fmt::Result {
        let mut line = String::new();
        self.inner.format_event(context, Writer::new(&mut line), event)?;
        let line = (self.escape)(line.strip_suffix('\n').unwrap_or(&line));
        let level = *event.metadata().level();
        match line.split_once(level.as_str()).filter(|_| self.is_coloured) {
            // the time before it has no such letters
            Some((time, rest)) => {
                let style = style_of(level);
                writeln!(writer, "{time}{style}{level}{style:#}{rest}")
            }
            None => writeln!(writer, "{line}"),
        }
    }
}

fn style_of(level: Level) -> Style {
    let colour = match level {
        Level::ERROR => AnsiColor::Red,
        Level::WARN => AnsiColor::Yellow,
        Level::INFO => AnsiColor::Green,
        Level::DEBUG => AnsiColor::Blue,
        Level::TRACE => AnsiColor::Magenta,
    };
    colour.on_default()
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::sync::{Arc, Mutex, PoisonError};

    use tracing_subscriber::fmt::MakeWriter;

    use super::*;

    #[derive(Clone, Default)]
    struct LogBuffer(Arc<Mutex<Vec<u8>>>);

    impl LogBuffer {
        fn text(&self) -> String {
            let written = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            String::from_utf8(written.clone()).expect("text")
        }
    }

    impl Write for LogBuffer {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).write(bytes)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    impl<'a> MakeWriter<'a> for LogBuffer {
        type Writer = Self;

        fn make_writer(&'a self) -> Self {
            self.clone()
        }
    }

    const HOSTILE: &str = "R\u{1b}[31m\r\n2026-01-01T00:00:00Z ERROR forged \u{202e}\u{200b}\u{9b}\u{7f}";

    /// An event with such text in every kind of field, of a span too.
    fn log() {
        let error = std::io::Error::other(HOSTILE);
        let _span = tracing::info_span!("at", robot = HOSTILE, file = %HOSTILE).entered();
        tracing::info!(robot = HOSTILE, file = %HOSTILE, debug = ?HOSTILE, %error,
            source = &error as &(dyn std::error::Error + 'static), "stored {HOSTILE}");
    }

    #[test]
    fn no_field_makes_a_line_or_gives_an_order() {
        for is_coloured in [false, true] {
            let written = LogBuffer::default();
            let subscriber = tracing_subscriber::fmt()
                .with_writer(written.clone())
                .with_ansi(false)
                .map_event_format(|inner| OneLine { inner, escape: text::shown, is_coloured })
                .finish();
            tracing::subscriber::with_default(subscriber, log);
            let text = written.text();
            assert_eq!(text.lines().count(), 1, "{text}");
            let colour = style_of(Level::INFO);
            let line = text.trim_end_matches('\n').replacen(&format!("{colour}INFO{colour:#}"), "INFO", 1);
            assert!(!line.contains(text::is_hidden), "{line:?}");
            assert!(line.contains("stored R") && line.contains("\\u{202e}"), "{line}");
        }
    }

    #[test]
    fn json_says_the_same_without_hidden_characters() {
        let written = LogBuffer::default();
        let subscriber = tracing_subscriber::fmt()
            .with_writer(written.clone())
            .json()
            .flatten_event(true)
            .map_event_format(|inner| OneLine { inner, escape: text::json, is_coloured: false })
            .finish();
        tracing::subscriber::with_default(subscriber, log);
        let text = written.text();
        assert!(!text.trim_end_matches('\n').contains(text::is_hidden), "{text:?}");
        let value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(value["robot"], HOSTILE);
        assert_eq!(value["message"], format!("stored {HOSTILE}"));
    }
}
