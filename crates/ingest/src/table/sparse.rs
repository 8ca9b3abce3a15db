//! Empty cells of channels that are slower than others.

use super::cell_reader;
use super::column_map::{ColumnMap, Role};
use super::fields::fields;
use crate::bytes::blocks::Block;
use crate::rejection::Rejection;

/// Fewest rows that determine the rate of a channel.
const LEAST_ROWS: u64 = 8;

/// Share of rows with a value; from this share on, cells are missing individually.
const DENSE: f64 = 0.8;

/// Adds the rates of the channel and of the rows, and a remedy, to the rejection of an empty cell in `block`. Returns
/// `false` for other rejections, and if few cells of the column are empty.
pub(super) fn explain(rejection: &mut Rejection, map: &ColumnMap, block: &Block) -> bool {
    let is_empty_cell = &*rejection.reason == "empty cell";
    let column = rejection.column.as_deref().filter(|_| is_empty_cell);
    let Some(at) = column.and_then(|column| map.names.iter().position(|name| name == column)) else {
        return false;
    };
    let seen = Seen::new(map, block, at);
    if seen.rows < LEAST_ROWS || seen.with_value as f64 > DENSE * seen.rows as f64 {
        return false;
    }
    rejection.reason = format!(
        "an empty cell: the column has a value in {} of {} rows{}, so its channel is slower than others",
        seen.with_value,
        seen.rows,
        seen.rates(map.to_si.time)
    )
    .into();
    let skipping = match seen.whole {
        0 => "",
        _ => "; or set skip_bad = 100000 under [rows] in the layout, so that incomplete rows are skipped",
    };
    let filling = match map.roles.get(at) {
        Some(Role::Torque(_)) => "; or set slower = \"hold\" or \"resample\" under [torque] in the layout",
        Some(Role::Velocity(_)) => {
            "; or set slower = \"hold\" or \"resample\" under [velocity] in the layout"
        }
        _ => "",
    };
    rejection.remedy =
        format!("export all channels at the rate of the slowest one{skipping}{filling}").into();
    true
}

/// Counts over the rows of a block.
#[derive(Debug, Default)]
struct Seen {
    rows: u64,
    with_value: u64,
    /// Rows with all values.
    whole: u64,
    /// First and last time, in the export's unit.
    times: Option<(f64, f64)>,
}

impl Seen {
    fn new(map: &ColumnMap, block: &Block, column: usize) -> Self {
        let is_needed = |role: &Role| *role != Role::Ignored && role.temperature_unit().is_none();
        let needed: Vec<usize> = (0..map.roles.len()).filter(|at| is_needed(&map.roles[*at])).collect();
        let mut seen = Self::default();
        for line in cell_reader::lines(&block.bytes) {
            let text = std::str::from_utf8(line).unwrap_or_default();
            let cells: Vec<&str> = fields(text, map.delimiter).collect();
            let has = |at: usize| cells.get(at).is_some_and(|cell| !cell.is_empty());
            seen.rows += 1;
            seen.with_value += u64::from(has(column));
            seen.whole += u64::from(needed.iter().all(|at| has(*at)));
            let time =
                map.time.column().and_then(|at| cell_reader::value(cells.get(at)?, Role::Time, map).ok());
            if let Some(time) = time {
                seen.times = Some((seen.times.map_or(time, |(first, _)| first), time));
            }
        }
        seen
    }

    /// Rates of the channel and of the rows, if times are known; `to_s` is their factor.
    fn rates(&self, to_s: f64) -> String {
        let seconds = self.times.map_or(0.0, |(first, last)| (last - first) * to_s);
        if seconds <= 0.0 || self.rows < 2 {
            return String::new();
        }
        let rows_hz = (self.rows - 1) as f64 / seconds;
        let channel_hz = rows_hz * self.with_value as f64 / self.rows as f64;
        format!(" (about {channel_hz:.1} Hz of {rows_hz:.1} Hz)")
    }
}
