//! The time of a layout: `[time]`.

use super::channels::{StartForm, StartSource, TimeSource};
use super::column::ScaledColumn;
use super::column_names::{ColumnNames, named_unit, read_unit};
use crate::date_format;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};

/// A unit of time and its factor to s.
const UNITS: &[(&str, f64)] = &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)];

/// Unit of cells that are dates and times as text.
const TIMESTAMP: &str = "timestamp";

/// Unit of counts of a clock whose step the layout gives.
const TICKS: &str = "ticks";

/// Sample rates of exports that count rows instead of recording time.
const SAMPLE_RATE: Limits = Limits::between(0.1, 1e6, "Hz");

/// Step of a clock: from a nanosecond to ten.
const TICK: Limits = Limits::between(1e-9, 10.0, "s");
const TICK_RATE: Limits = Limits::between(0.1, 1e9, "Hz");

/// Values after which a counter begins anew: from eight bits to what doubles count one by one.
const WRAP: Limits = Limits::between(256.0, 9.007_199_254_740_992e15, "in the column's unit");

/// Reads `[time]`; `None` where something is wrong with it.
pub(crate) fn read(table: &Table<'_>, names: &mut ColumnNames) -> Option<TimeSource> {
    if let Some(value) = table.optional("sample_rate_hz") {
        return value.number(&SAMPLE_RATE).map(TimeSource::SampleRate);
    }
    let column = table.required("column").and_then(|value| names.take(&value));
    let unit = table.required("unit")?;
    let wraps_at = table.optional("wraps_at");
    if unit.peek_text() == Some(TIMESTAMP) {
        if let Some(value) = wraps_at {
            value.refuse("timestamps do not begin anew".into(), None);
            return None;
        }
        return Some(TimeSource::Timestamp(column?));
    }
    let column = ScaledColumn { column: column?, to_si: factor(table, &unit)? };
    match wraps_at {
        Some(value) => value.number(&WRAP).map(|wraps_at| TimeSource::Counter { column, wraps_at }),
        None => Some(TimeSource::Column(column)),
    }
}

/// Reads `[start]`; `None` where something is wrong with it.
pub(crate) fn read_start(table: &Table<'_>) -> Option<StartSource> {
    // not among the columns taken: the column of time may say the start too
    let column = table.required("column").and_then(|value| ColumnNames::default().take(&value));
    let (unit, format) = (table.optional("unit"), table.optional("format"));
    let form = match (unit, format) {
        (Some(_), Some(format)) => {
            format.refuse(
                "is for cells of another form than unit says".into(),
                Some("leave one of them out".into()),
            );
            None
        }
        (None, Some(format)) => read_format(&format).map(StartForm::Format),
        (None, None) => Some(StartForm::Timestamp),
        (Some(unit), None) if unit.peek_text() == Some(TIMESTAMP) => Some(StartForm::Timestamp),
        (Some(unit), None) => {
            let known: Vec<_> = UNITS.iter().copied().chain([(TIMESTAMP, 0.0)]).collect();
            read_unit(&unit, &known).map(StartForm::Since1970)
        }
    };
    Some(StartSource { column: column?, form: form? })
}

fn read_format(value: &Value<'_>) -> Option<String> {
    let format = value.text()?;
    if !date_format::gives_date(format) {
        value.refuse(
            "must give year, month and day, and should give the time".into(),
            Some(
                "conversions are those of strptime, such as \"%d/%m/%y %H:%M:%S\" for 05/01/26 08:47:30"
                    .into(),
            ),
        );
        return None;
    }
    Some(format.to_owned())
}

/// The name of the unit that a layout reads time in; `None` where rows are counted.
pub(crate) fn unit_of(time: &TimeSource) -> Option<&'static str> {
    match time {
        TimeSource::Column(column) | TimeSource::Counter { column, .. } => {
            Some(named_unit(UNITS, column.to_si).unwrap_or(TICKS))
        }
        TimeSource::Timestamp(_) => Some(TIMESTAMP),
        TimeSource::SampleRate(_) => None,
    }
}

fn factor(table: &Table<'_>, unit: &Value<'_>) -> Option<f64> {
    if unit.peek_text() != Some(TICKS) {
        let known: Vec<_> = UNITS.iter().copied().chain([(TICKS, 0.0), (TIMESTAMP, 0.0)]).collect();
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
        assert_eq!(with("unit = \"timestamp\""), Ok(TimeSource::Timestamp(Column::Name("time".into()))));
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
            of(StartForm::Format(format.into()))
        );
        for (keys, said) in [
            ("unit = \"s\"", "start.column: is missing"),
            ("column = 1\nformat = \"%H:%M\"", "must give year, month and day"),
            ("column = 1\nunit = \"ticks\"", "unknown unit, must be one of s, ms, us, ns, timestamp"),
            ("column = 1\nunit = \"s\"\nformat = \"%F\"", "leave one of them out"),
        ] {
            let errors = start(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }

    #[test]
    fn what_is_missing_or_too_much_is_said() {
        for (keys, said) in [
            ("unit = \"ticks\"", "time.tick_s or ticks_per_s: is missing"),
            ("unit = \"h\"", "unknown unit, must be one of s, ms, us, ns, ticks, timestamp"),
            ("unit = \"s\"\ntick_s = 0.004", "unknown key"),
            ("unit = \"timestamp\"\nwraps_at = 4294967296", "timestamps do not begin anew"),
            ("unit = \"ticks\"\ntick_s = 0", "must be between"),
            ("unit = \"ms\"\nwraps_at = 1", "must be between"),
        ] {
            let errors = with(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
    }
}
