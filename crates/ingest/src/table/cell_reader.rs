//! Reads a block cell by cell: slower than in one pass, but with every line and column for messages.
//!
//! It names the first bad cell of a block that could not be read in one pass, skips bad rows if the layout permits it,
//! and checks a file's last line.

use std::path::Path;

use super::channels::RawColumns;
use super::clock::{CHANGE_OF_CLOCKS, ClockOrigin, PreviousTime, TimeColumn};
use super::column_map::{ColumnMap, Role};
use super::fields::fields;
use super::mended::{Mend, MendedRow};
use super::{cell, channels};
use crate::bytes::blocks::{Block, is_blank, narrow, nul};
use crate::bytes::fingerprint;
use crate::rejection::Rejection;
use armwatch_config::{TextTime, duration, forms_of, joined_forms};
use armwatch_model::run::{ContentHash, RawSamples};

/// Reason for a file that ends before its first row is whole.
pub(crate) const CUT: &str = "last line is cut";
pub(crate) const CUT_REMEDY: &str = "wait until the writer has finished, or export again";
const CELL_REMEDY: &str = "export again or correct the cell";
/// Tolerance of a step between two rows at a change of clocks, s.
const HOUR_TOLERANCE: f64 = 5.0;
const STAGE_REMEDY: &str = "add the value to the stage signal of the layout, or export again";

/// The hash of the text of a row, for [`PreviousTime::row`].
pub(crate) fn row_hash(line: &[u8]) -> ContentHash {
    fingerprint::of_bytes(without_return(line))
}

fn without_return(line: &[u8]) -> &[u8] {
    line.strip_suffix(b"\r").unwrap_or(line)
}

/// The rows of a block.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadRows {
    /// The rows, in SI.
    pub samples: RawSamples,
    /// Bad rows that were skipped.
    pub passed_over: PassedOver,
    /// Repairs, in order.
    pub mended: Vec<MendedRow>,
    /// The last row, where times are text.
    pub clock: Option<PreviousTime>,
    /// Hash of the text of the last row.
    pub row: Option<ContentHash>,
}

/// Reads a block whose last line is certainly whole.
///
/// # Errors
/// A rejection of the first cell, in line and then column order, that is not understood.
pub fn read(
    block: &Block,
    map: &ColumnMap,
    previous: Option<PreviousTime>,
    path: &Path,
) -> Result<RawSamples, Rejection> {
    read_passing_over(block, map, previous, path, 0).map(|read| read.samples)
}

/// Bad rows that were skipped.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct PassedOver {
    /// Their number.
    pub rows: u64,
    /// The fault of the first of them.
    pub first: Option<Box<Rejection>>,
}

impl PassedOver {
    /// Counts later ones too.
    pub(crate) fn add(&mut self, later: Self) {
        self.rows += later.rows;
        self.first = self.first.take().or(later.first);
    }
}

/// Like [`read`], but skips at most `most` bad rows: rows with another number of fields than columns, rows with a cell
/// that is empty or not understood, and rows with the time of the row before. A row is not bad in this sense if its
/// time falls, if it has two stages at once, or if it repeats the header: these are faults of the recording. A row that
/// repeats the one before in every cell is omitted.
///
/// If rows are counted instead of timed, a skipped row counts too.
///
/// # Errors
/// Those of [`read`], for the first bad row beyond `most`.
pub fn read_passing_over(
    block: &Block,
    map: &ColumnMap,
    previous: Option<PreviousTime>,
    path: &Path,
    most: u64,
) -> Result<ReadRows, Rejection> {
    let mut columns: RawColumns = vec![Vec::new(); map.names.len()];
    let mut row = Row {
        map,
        path,
        columns: &mut columns,
        previous,
        passes_over: most > 0,
        stands_still: false,
        kept: Vec::new(),
    };
    let (mut passed, mut repeated) = (PassedOver::default(), Vec::<(usize, MendedRow)>::new());
    let mut line_before: Option<&[u8]> = None;
    // rows before each kept row, including skipped ones
    let mut places: Vec<usize> = Vec::new();
    for (place, (bytes, number)) in lines(&block.bytes).zip(block.first_line..).enumerate() {
        match row.read(bytes) {
            Ok(()) => {
                places.push(place);
                line_before = Some(bytes);
            }
            Err(_) if row.stands_still && repeats(bytes, line_before, previous) => {
                let of = MendedRow { mend: Mend::Repeated, line: number, count: 1, time: 0.0 };
                match repeated.last_mut() {
                    Some((rows, before)) if *rows == places.len() => before.count += 1,
                    _ => repeated.push((places.len(), of)),
                }
            }
            Err(rejection) if rejection.is_bad_row && passed.rows < most => {
                let first = Some(Box::new(rejection.at_line(number)));
                passed.add(PassedOver { rows: 1, first });
            }
            Err(rejection) => return Err(rejection.at_line(number)),
        }
    }
    let (mut samples, clock) = channels::samples_and_clock(columns, map, previous).ok_or_else(|| {
        Rejection::of_file(path, "numbers that cannot be read reliably", CELL_REMEDY)
            .at_line(block.first_line)
    })?;
    let time_before = |rows: usize| match rows.checked_sub(1) {
        Some(row) => samples.time.get(row).copied(),
        None => previous.map(|previous| previous.seconds),
    };
    let mut mended: Vec<MendedRow> = repeated
        .into_iter()
        .map(|(rows, of)| MendedRow { time: time_before(rows).unwrap_or_default(), ..of })
        .collect();
    mended.extend(clock.turns.into_iter().map(|(row, turn)| {
        let place = places.get(row).copied().unwrap_or_default();
        let time = samples.time.get(row).copied().unwrap_or_default();
        MendedRow { mend: Mend::Clock(turn), line: block.first_line + place as u64, count: 1, time }
    }));
    if let TimeColumn::Counted(rate) = map.time
        && passed.rows > 0
    {
        samples.time = channels::counted(places, rate, previous.map(|p| p.seconds));
    }
    Ok(ReadRows { samples, passed_over: passed, mended, clock: clock.last, row: line_before.map(row_hash) })
}

/// Returns true if a line repeats the last row, `before`, or that of the previous block.
fn repeats(line: &[u8], before: Option<&[u8]>, previous: Option<PreviousTime>) -> bool {
    match before {
        Some(before) => without_return(line) == without_return(before),
        None => previous.and_then(|previous| previous.row) == Some(row_hash(line)),
    }
}

/// The rejection of a single bad row; other rejections are faults of the recording.
fn of_row(rejection: Rejection) -> Rejection {
    Rejection { is_bad_row: true, ..rejection }
}

/// Returns true if a line has fewer fields than a row needs.
pub(crate) fn is_short(line: &[u8], map: &ColumnMap) -> bool {
    !line.contains(&0)
        && std::str::from_utf8(line)
            .is_ok_and(|text| fields(text, map.delimiter).take(map.least_fields).count() < map.least_fields)
}

/// State of a last line without a line end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LastLine {
    /// All its cells are whole.
    Whole,
    /// It is valid, but its last number may have had further digits.
    Doubtful,
    /// It has too few fields, or its last cell is empty or not understood: the writer did not complete it.
    Cut,
}

/// Checks the last line of a file that does not end with a line end.
///
/// A line with too few fields, or with a last cell that is empty or not a number, is cut: omitting it is harmless,
/// since nothing follows it. A line with all fields is whole if its last cell allows no longer number, as in a column
/// of stages 0 to 3, or if that column is not needed. Otherwise it is doubtful, since `-12.34` may be the beginning of
/// `-12.345`: omitting one row of a recording is harmless, a wrong torque is not.
///
/// # Errors
/// A rejection of a line that is not text.
pub fn judge_last_line(
    line: &[u8],
    number: u64,
    map: &ColumnMap,
    path: &Path,
) -> Result<LastLine, Rejection> {
    if line.contains(&0) {
        return Err(nul(path).at_line(number));
    }
    let text = match std::str::from_utf8(line) {
        Ok(text) => text,
        // Without a length the text ends inside a character.
        Err(error) if error.error_len().is_none() => return Ok(LastLine::Cut),
        Err(_) => return Err(narrow(path, line).at_line(number)),
    };
    let cells: Vec<&str> = fields(text, map.delimiter).collect();
    let last = map.least_fields.saturating_sub(1);
    let (Some(cell), Some(role)) = (cells.get(last), map.roles.get(last)) else { return Ok(LastLine::Cut) };
    let reads = match channels::is_text(*role, map) {
        true => channels::word_number(cell, map).is_some(),
        // an empty temperature cell is a missing value, not a cut one
        false => {
            *role == Role::Ignored || role.temperature_unit().is_some() || value(cell, *role, map).is_ok()
        }
    };
    if !reads {
        return Ok(LastLine::Cut);
    }
    if cells.len() > map.least_fields {
        return Ok(LastLine::Whole);
    }
    Ok(if channels::may_continue(cell, *role, map) { LastLine::Doubtful } else { LastLine::Whole })
}

/// The lines of a block without their line feeds.
pub(crate) fn lines(bytes: &[u8]) -> impl DoubleEndedIterator<Item = &[u8]> {
    bytes.split_inclusive(|byte| *byte == b'\n').map(|line| line.strip_suffix(b"\n").unwrap_or(line))
}

struct Row<'a> {
    map: &'a ColumnMap,
    path: &'a Path,
    columns: &'a mut RawColumns,
    previous: Option<PreviousTime>,
    /// True if a bad row is skipped: it is then examined to its end, so that a wrong time in it counts as one of its
    /// bad cells.
    passes_over: bool,
    /// True if the row has the time of the row before.
    stands_still: bool,
    /// The row's numbers by column, until all of it is understood.
    kept: Vec<(usize, f64)>,
}

impl Row<'_> {
    fn rejection(&self, reason: impl Into<Box<str>>) -> Rejection {
        Rejection::of_file(self.path, reason, CELL_REMEDY)
    }

    /// Reads a row; keeps no value of a row with a fault.
    fn read(&mut self, line: &[u8]) -> Result<(), Rejection> {
        let text = self.text(line).map_err(of_row)?;
        self.refuse_wrong_shape(text)?;
        let map = self.map;
        let is_exclusive = map.stage_source.kind().is_exclusive();
        let mut stage_on: Option<usize> = None;
        let mut of_recording: Option<Rejection> = None;
        let mut time = None;
        self.stands_still = false;
        self.kept.clear();
        for (column, cell) in fields(text, map.delimiter).enumerate() {
            let role = map.roles.get(column).copied().unwrap_or(Role::Ignored);
            if role == Role::Ignored {
                continue;
            }
            let named =
                |rejection: Rejection| rejection.in_column(map.names.get(column).map_or("", String::as_str));
            let value = self.number(cell, role).map_err(|rejection| of_row(named(rejection)))?;
            let mut refused = None;
            if role == Role::Time {
                match self.next_time(value, cell) {
                    Ok(next) => time = Some(next),
                    Err(rejection) => refused = Some(named(rejection)),
                }
            }
            if is_exclusive && matches!(role, Role::Stage(_)) && value != 0.0 {
                refused = self.refuse_second_stage(stage_on.replace(column), column).err();
            }
            match refused {
                Some(rejection) if !self.passes_over => return Err(rejection),
                refused => of_recording = of_recording.or(refused),
            }
            self.kept.push((column, value));
        }
        if let Some(rejection) = of_recording {
            return Err(rejection);
        }
        self.previous = time.or(self.previous);
        for (column, value) in self.kept.drain(..) {
            if let Some(values) = self.columns.get_mut(column) {
                values.push(value);
            }
        }
        Ok(())
    }

    /// Refuses a row with two stages at once.
    fn refuse_second_stage(&self, first: Option<usize>, second: usize) -> Result<(), Rejection> {
        let Some(first) = first else { return Ok(()) };
        let name = |column: usize| self.map.names.get(column).map_or("", String::as_str);
        let mut rejection =
            self.rejection(format!("two stages at the same time: {} is also on", name(first)));
        rejection.remedy =
            "export again with one stage at a time, or name other columns in the layout's [stage] section"
                .into();
        Err(rejection.in_column(name(second)))
    }

    fn text<'t>(&self, line: &'t [u8]) -> Result<&'t str, Rejection> {
        if line.contains(&0) {
            return Err(nul(self.path));
        }
        std::str::from_utf8(line).map_err(|error| {
            let before = String::from_utf8_lossy(line.get(..error.valid_up_to()).unwrap_or_default());
            let column = fields(&before, self.map.delimiter).count().saturating_sub(1);
            let name = self.map.names.get(column).map_or("", String::as_str);
            narrow(self.path, line).in_column(name)
        })
    }

    fn refuse_wrong_shape(&self, text: &str) -> Result<(), Rejection> {
        let names = &self.map.names;
        let (mut count, mut as_header, mut empty_beyond) = (0, true, true);
        for cell in fields(text, self.map.delimiter) {
            match names.get(count) {
                Some(name) => as_header &= name == cell,
                // Further fields come from delimiters at the end of the line.
                None => empty_beyond &= cell.is_empty(),
            }
            count += 1;
        }
        let is_header = as_header && count >= names.len();
        let fits = count >= self.map.least_fields && empty_beyond;
        if fits && !is_header {
            return Ok(());
        }
        let mut rejection = if text.bytes().all(is_blank) {
            self.rejection("blank line between rows")
        } else if is_header {
            self.rejection("repeated header: two exports in one file")
        } else {
            let size = if count < names.len() { "short" } else { "long" };
            self.rejection(format!("line too {size}: {count} fields, the header has {}", names.len()))
        };
        rejection.remedy = "export again; each line needs one field per column".into();
        Err(if is_header { rejection } else { of_row(rejection) })
    }

    fn number(&self, cell: &str, role: Role) -> Result<f64, Rejection> {
        let refused = |reason: String| self.rejection(reason).with_value(cell);
        if channels::is_text(role, self.map) {
            return channels::word_number(cell, self.map).ok_or_else(|| {
                let mut rejection = refused(self.map.stage_source.kind().words_wanted());
                rejection.remedy = STAGE_REMEDY.into();
                rejection
            });
        }
        if role.temperature_unit().is_some() {
            return Ok(channels::temperature(cell, self.map.decimal));
        }
        if cell.is_empty() && self.map.may_be_empty(role) {
            return Ok(f64::NAN);
        }
        if cell.is_empty() {
            return Err(self.rejection("empty cell"));
        }
        let refused = |reason: String| self.rejection(reason).with_value(cell);
        let value = value(cell, role, self.map).map_err(|no| {
            let mut rejection = refused(no.reason.into());
            no.remedy.into_iter().for_each(|remedy| rejection.remedy = remedy.into());
            rejection
        })?;
        if let Some(reason) = channels::refusal(value, role, self.map) {
            let mut rejection = refused(reason);
            if matches!(role, Role::Stage(_)) {
                rejection.remedy = STAGE_REMEDY.into();
            }
            return Err(rejection);
        }
        Ok(value)
    }

    fn next_time(&mut self, value: f64, cell: &str) -> Result<PreviousTime, Rejection> {
        let next = match self.map.time {
            TimeColumn::Stamped { origin, .. } => origin.next(value, self.previous.as_ref()).0,
            TimeColumn::Restarting(_) => PreviousTime {
                recorded: cell::number(cell, self.map.decimal).unwrap_or(value),
                ..PreviousTime::next_of_recordings(self.previous.as_ref(), self.scaled_time(value)).0
            },
            TimeColumn::Recorded(_) => PreviousTime {
                recorded: cell::number(cell, self.map.decimal).unwrap_or(value),
                seconds: self.scaled_time(value),
                ..PreviousTime::default()
            },
            _ => {
                PreviousTime { recorded: value, seconds: self.scaled_time(value), ..PreviousTime::default() }
            }
        };
        if let Some(before) = self.previous.filter(|before| before.seconds >= next.seconds) {
            self.stands_still = before.seconds <= next.seconds;
            return Err(self.time_does_not_rise(before, &next, cell).with_value(cell));
        }
        Ok(next)
    }

    /// A time in s, with the same conversion as in [`channels::samples`].
    fn scaled_time(&self, value: f64) -> f64 {
        let factor = self.map.to_si.time;
        let counts = match self.map.time {
            TimeColumn::Wrapping { period, .. } => {
                let origin = self.map.time_origin.map_or(0.0, cell::Decimal::to_f64);
                let previous = self.previous.map(|before| before.seconds / factor + origin);
                channels::counted_on(value, period, previous) - origin
            }
            _ => value,
        };
        counts * factor
    }

    fn time_does_not_rise(&self, before: PreviousTime, next: &PreviousTime, cell: &str) -> Rejection {
        let recorded = next.recorded;
        let backwards = before.seconds > next.seconds;
        let is_hour = (before.seconds - next.seconds - CHANGE_OF_CLOCKS).abs() < HOUR_TOLERANCE;
        let last = match self.map.time {
            TimeColumn::Stamped { .. } => "the time".to_owned(),
            // for the row before a block, only the continued count is known
            TimeColumn::Wrapping { .. } => "the count".to_owned(),
            _ => without_rounding(before.recorded).to_string(),
        };
        let mut rejection = self.rejection(if backwards {
            format!("earlier than {last} in the previous row: time runs backwards")
        } else {
            format!("not later than {last} in the previous row: time does not advance")
        });
        let anew = || began_anew(before.recorded, recorded).filter(|_| backwards);
        // rows with falling times are out of order; a single row with the time of another is one bad row
        rejection.is_bad_row = !backwards;
        rejection.remedy = match (&self.map.time, anew()) {
            _ if !backwards && cell.contains(['e', 'E']) => format!(
                "the last digits of the time are lost, because a spreadsheet wrote it as {cell}: format the \
                column as a number with all digits, and export again"
            )
            .into(),
            _ if !backwards => "two rows have the same time but different cells: export again with a finer \
                time".into(),
            (TimeColumn::Recorded(_), None) if is_hour => {
                "the clock was set back by one hour here: export UTC, or the time since the start".into()
            }
            (TimeColumn::Wrapping { period, .. }, _) => {
                format!("check wraps_at = {period} under [time]: the counter must start again there").into()
            }
            (_, Some(period)) => {
                format!("if this is a counter that started again, set wraps_at = {period} under [time]").into()
            }
            (_, None) => "export the recording again in one piece; or set restarts = true under [time] of the layout if the \
                          file holds several recordings"
                .into(),
        };
        rejection
    }
}

/// A time that was converted to seconds and back, in its recorded form.
fn without_rounding(recorded: f64) -> f64 {
    format!("{recorded:.13e}").parse().unwrap_or(recorded)
}

/// The period of a counter of 16, 31 or 32 bits that was near its end and is near its beginning.
fn began_anew(before: f64, after: f64) -> Option<u64> {
    let near = |period: u64| {
        let period = period as f64;
        before < period && before > 0.99 * period && (0.0..0.01 * period).contains(&after)
    };
    [1 << 16, 1 << 31, 1 << 32].into_iter().find(|period| near(*period))
}

/// The number in a cell; for a time, relative to the first row; for a date and time, in s.
pub(crate) fn value(cell: &str, role: Role, map: &ColumnMap) -> Result<f64, cell::NoNumber> {
    match (role, map.time) {
        (Role::Time, TimeColumn::Stamped { origin, .. }) => {
            stamped(cell, map, origin).ok_or_else(|| no_time(cell, &map.text_time))
        }
        (Role::Time, TimeColumn::Recorded(_) | TimeColumn::Restarting(_)) => {
            let number = match map.time_origin {
                Some(origin) => cell::number_since(cell, map.decimal, origin),
                None => cell::number(cell, map.decimal),
            };
            number.map_err(|no| match form_remedy(cell) {
                Some(remedy) => cell::NoNumber {
                    reason: "a time as text, but the layout has numbers".into(),
                    remedy: Some(remedy.into()),
                },
                None => no,
            })
        }
        _ => cell::number(cell, map.decimal),
    }
}

/// Seconds from `origin` to a time in text form.
pub(crate) fn stamped(cell: &str, map: &ColumnMap, origin: ClockOrigin) -> Option<f64> {
    Some(cell::text_time(cell, &map.text_time)?.checked_sub(origin.nanoseconds)? as f64 * 1e-9)
}

fn no_time(cell: &str, form: &TextTime) -> cell::NoNumber {
    let (reason, usual) = match form {
        TextTime::Timestamp => (
            "not a date and time".into(),
            "export times as 2026-03-01T08:00:00.004, or give [time] another unit or a format",
        ),
        TextTime::Format(format) => {
            (format!("not in the form {}", format.text()).into(), "correct format under [time] of the layout")
        }
        TextTime::Duration => {
            ("not an elapsed time such as T#1h2m3s4ms".into(), "give [time] another unit or a format")
        }
    };
    cell::NoNumber { reason, remedy: Some(form_remedy(cell).map_or(usual.into(), Into::into)) }
}

/// The setting for reading a time in text form; `None` for a cell of unknown form.
fn form_remedy(cell: &str) -> Option<String> {
    if duration(cell).is_some() {
        return Some("set unit = \"duration\" under [time] of the layout".into());
    }
    let forms = forms_of(cell);
    match forms.as_slice() {
        [] => None,
        [only] => Some(format!("set format = {:?} under [time] of the layout, instead of unit", only.text())),
        _ => Some(format!(
            "set format = {} under [time] of the layout, instead of unit: the one with the export's order \
            of day and month",
            joined_forms(&forms)
        )),
    }
}
