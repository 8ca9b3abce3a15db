//! The time of a layout: `[time]`.

use super::channels::{StartForm, StartSource, TextTime, TimeSource};
use super::column::ScaledColumn;
use super::column_names::{ColumnNames, NamedUnit, named_unit, read_unit};
use crate::moment::MomentFormat;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};

/// Units of numbers since 1970 and their factors to s.
const CLOCK_UNITS: &[NamedUnit] = &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

/// Further units of time and their factors to s; days are those of spreadsheets and MATLAB.
const LONG_UNITS: &[NamedUnit] = &[("min", 60.0), ("h", 3600.0), ("d", 86_400.0)];

/// Unit of cells that are dates and times as text.
const TIMESTAMP: &str = "timestamp";

/// Unit of cells that are elapsed times with units, such as `T#20ms`.
const DURATION: &str = "duration";

/// Unit of counts of a clock whose step is in the layout.
const TICKS: &str = "ticks";

/// Sample rates of exports that count rows instead of recording time.
const SAMPLE_RATE: Limits = Limits::between(0.1, 1e6, "Hz");

/// Step of a clock: from a nanosecond to ten seconds.
const TICK: Limits = Limits::between(1e-9, 10.0, "s");
const TICK_RATE: Limits = Limits::between(0.1, 1e9, "Hz");

/// Values after which a counter restarts: from eight bits to the largest integer that doubles count exactly.
const WRAP: Limits = Limits::between(256.0, 9.007_199_254_740_992e15, "in the column's unit");

/// Reads `[time]`; `None` if it is wrong.
pub(crate) fn read(table: &Table<'_>, names: &mut ColumnNames) -> Option<TimeSource> {
    if let Some(value) = table.optional("sample_rate_hz") {
        return value.number(&SAMPLE_RATE).map(TimeSource::SampleRate);
    }
    let column = table.required("column").and_then(|value| names.take(&value));
    let wraps_at = table.optional("wraps_at");
    let restarts = table.optional("restarts");
    let is_restarting = restarts.as_ref().map_or(Some(false), |value| value.boolean())?;
    let (which, value) = table.one_of(&["unit", "format"])?;
    let form = match (which, value.peek_text()) {
        (1, _) => Some(TextTime::Format(read_format(&value, "the seconds", MomentFormat::gives_seconds)?)),
        (_, Some(TIMESTAMP)) => Some(TextTime::Timestamp),
        (_, Some(DURATION)) => Some(TextTime::Duration),
        _ => None,
    };
    if let (Some(_), Some(value)) = (&form, &wraps_at) {
        value.refuse("is only for numbers; a time of day continues after midnight without it".into(), None);
        return None;
    }
    if let (true, Some(value)) = (is_restarting && (form.is_some() || wraps_at.is_some()), &restarts) {
        value.refuse("is only for numbers without wraps_at".into(), None);
        return None;
    }
    if let Some(form) = form {
        return Some(TimeSource::Text { column: column?, form });
    }
    let column = ScaledColumn { column: column?, to_si: factor(table, &value)? };
    match wraps_at {
        Some(value) => value.number(&WRAP).map(|wraps_at| TimeSource::Counter { column, wraps_at }),
        None if is_restarting => Some(TimeSource::Restarting(column)),
        None => Some(TimeSource::Column(column)),
    }
}

/// Reads `[start]`; `None` if it is wrong.
pub(crate) fn read_start(table: &Table<'_>) -> Option<StartSource> {
    // not among the used columns: the time column may give the start too
    let column = table.required("column").and_then(|value| ColumnNames::default().take(&value));
    let form = match table.at_most_one_of(&["unit", "format"]) {
        Some((1, value)) => {
            const WANTED: &str = "year, month and day, and preferably the time";
            read_format(&value, WANTED, MomentFormat::gives_date).map(StartForm::Format)
        }
        Some((_, unit)) if unit.peek_text() != Some(TIMESTAMP) => {
            let known: Vec<_> = CLOCK_UNITS.iter().copied().chain([(TIMESTAMP, 0.0)]).collect();
            read_unit(&unit, &known).map(StartForm::Since1970)
        }
        _ => Some(StartForm::Timestamp),
    };
    Some(StartSource { column: column?, form: form? })
}

/// A format that gives the `wanted` parts.
fn read_format(value: &Value<'_>, wanted: &str, gives: fn(&MomentFormat) -> bool) -> Option<MomentFormat> {
    let problem = match MomentFormat::new(value.text()?) {
        Ok(format) if gives(&format) => return Some(format),
        Ok(_) => format!("must give {wanted}"),
        Err(problem) => problem,
    };
    let hint = "conversions are those of strptime, such as \"%d/%m/%y %H:%M:%S\" for 05/01/26 08:47:30";
    value.refuse(problem, Some(hint.into()));
    None
}

/// The name of a layout's time unit; `None` if rows are counted.
pub(crate) fn unit_of(time: &TimeSource) -> Option<&'static str> {
    match time {
        TimeSource::Column(column) | TimeSource::Restarting(column) | TimeSource::Counter { column, .. } => {
            let named =
                named_unit(CLOCK_UNITS, column.to_si).or_else(|| named_unit(LONG_UNITS, column.to_si));
            Some(named.unwrap_or(TICKS))
        }
        TimeSource::Text { form: TextTime::Duration, .. } => Some(DURATION),
        TimeSource::Text { .. } => Some(TIMESTAMP),
        TimeSource::SampleRate(_) => None,
    }
}

fn factor(table: &Table<'_>, unit: &Value<'_>) -> Option<f64> {
    if unit.peek_text() != Some(TICKS) {
        let others = [(TICKS, 0.0), (TIMESTAMP, 0.0), (DURATION, 0.0)];
        let known: Vec<_> = CLOCK_UNITS.iter().chain(LONG_UNITS).copied().chain(others).collect();
        return read_unit(unit, &known);
    }
    let (which, value) = table.one_of(&["tick_s", "ticks_per_s"])?;
    match which {
        0 => value.number(&TICK),
        _ => value.number(&TICK_RATE).map(f64::recip),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::column::Column;
    use crate::layout::layout_file::parse_layout;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    fn with(keys: &str) -> Result<TimeSource, String> {
        let text = NATIVE.replace("column = \"time\"\nunit = \"s\"", &format!("column = \"time\"\n{keys}"));
        parse_layout("a.toml", &text).map(|layout| layout.time).map_err(|errors| errors.to_string())
    }

    fn column(to_si: f64) -> ScaledColumn {
        ScaledColumn { column: Column::Name("time".into()), to_si }
    }

    #[test]
    fn units_ticks_counters_and_timestamps() {
        assert_eq!(with("unit = \"us\""), Ok(TimeSource::Column(column(1e-6))));
        assert_eq!(with("unit = \"ns\""), Ok(TimeSource::Column(column(1e-9))));
        assert_eq!(with("unit = \"ticks\"\ntick_s = 0.004"), Ok(TimeSource::Column(column(0.004))));
        assert_eq!(with("unit = \"ticks\"\nticks_per_s = 250"), Ok(TimeSource::Column(column(0.004))));
        let counter = TimeSource::Counter { column: column(1e-3), wraps_at: 4_294_967_296.0 };
        assert_eq!(with("unit = \"ms\"\nwraps_at = 4294967296"), Ok(counter));
        for (unit, seconds) in [("min", 60.0), ("h", 3600.0), ("d", 86_400.0)] {
            assert_eq!(with(&format!("unit = \"{unit}\"")), Ok(TimeSource::Column(column(seconds))));
        }
        let text = |form| Ok(TimeSource::Text { column: Column::Name("time".into()), form });
        assert_eq!(with("unit = \"timestamp\""), text(TextTime::Timestamp));
        assert_eq!(with("unit = \"duration\""), text(TextTime::Duration));
        let format = "%m/%d/%Y %I:%M:%S %p";
        let read = MomentFormat::new(format).expect("a format");
        assert_eq!(with(&format!("format = \"{format}\"")), text(TextTime::Format(read)));
    }

    #[test]
    fn the_start_may_stand_in_a_column_of_any_form() {
        let start = |keys: &str| {
            let text = format!("{NATIVE}\n[start]\n{keys}");
            parse_layout("a.toml", &text).map(|layout| layout.start).map_err(|errors| errors.to_string())
        };
        let of = |form| Ok(Some(StartSource { column: Column::Name("time".into()), form }));
        assert_eq!(start("column = \"time\""), of(StartForm::Timestamp));
        assert_eq!(start("column = \"time\"\nunit = \"timestamp\""), of(StartForm::Timestamp));
        assert_eq!(start("column = \"time\"\nunit = \"ms\""), of(StartForm::Since1970(1e-3)));
        let format = "%d/%m/%y %H:%M";
        assert_eq!(
            start(&format!("column = \"time\"\nformat = \"{format}\"")),
            of(StartForm::Format(MomentFormat::new(format).expect("a format")))
        );
        for (keys, said) in [
            ("unit = \"s\"", "start.column: is missing"),
            ("column = 1\nformat = \"%H:%M\"", "must give year, month and day"),
            ("column = 1\nunit = \"ticks\"", "unknown unit, must be one of s, ms, us, ns, timestamp"),
            ("column = 1\nunit = \"s\"\nformat = \"%F\"", "keep one of them"),
        ] {
            let errors = start(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }

    #[test]
    fn what_is_missing_or_too_much_is_said() {
        for (keys, said) in [
            ("unit = \"ticks\"", "time.tick_s or ticks_per_s: is missing"),
            (
                "unit = \"day\"",
                "unknown unit, must be one of s, ms, us, ns, min, h, d, ticks, timestamp, duration",
            ),
            ("", "time.unit or format: is missing"),
            ("unit = \"s\"\nformat = \"%T\"", "keep one of them"),
            ("format = \"%x %T\"", "depends on the country"),
            ("format = \"%d/%m/%Y %H:%M\"", "must give the seconds"),
            ("format = \"%T\"\nwraps_at = 86400", "continues after midnight"),
            ("unit = \"s\"\ntick_s = 0.004", "unknown key"),
            ("unit = \"timestamp\"\nwraps_at = 4294967296", "continues after midnight"),
            ("unit = \"ticks\"\ntick_s = 0", "must be between"),
            ("unit = \"ms\"\nwraps_at = 1", "must be between"),
        ] {
            let errors = with(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }
}
