//! Data of a picture: panels with axes, bands, lines and points, and one legend.

use jiff::Timestamp;

/// A picture of one or more panels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figure {
    /// Title of the picture.
    pub title: String,
    /// A line below the title: which data, which parameters.
    pub subtitle: String,
    /// Entries that explain the colours and marks of all panels.
    pub legend: Vec<Key>,
    /// Panels, row by row.
    pub panels: Vec<Panel>,
    /// Panels per row, at least 1.
    pub columns: usize,
}

/// One pair of axes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// Title of the panel.
    pub title: String,
    /// Status of its subject, shown next to the title.
    pub standing: Option<StatusWord>,
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// Kind of the horizontal values.
    pub x_axis: XAxis,
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// Spacing of its values.
    pub y_axis: YAxis,
    /// Ends of the vertical axis, if panels share one; otherwise those of the data.
    pub y_range: Option<[f64; 2]>,
    /// True if a linear vertical axis always shows zero.
    pub with_zero: bool,
    /// Values of the vertical axis that are marked by a line, if the axis includes them.
    pub limits: Vec<Limit>,
    /// Bands of the horizontal axis.
    pub bands: Vec<Band>,
    /// Shaded areas between two curves, below all lines.
    pub areas: Vec<Area>,
    /// Lines and points, later ones on top.
    pub series: Vec<Series>,
    /// Events at values of the horizontal axis.
    pub events: Vec<FigureEvent>,
    /// A second, lower pair of axes on the same horizontal axis.
    pub strip: Option<Strip>,
}

/// A low pair of axes below a panel, with a separate vertical axis that shows zero.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Strip {
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// Lines and points, later ones on top.
    pub series: Vec<Series>,
}

/// Kind of values of a horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum XAxis {
    /// Numbers.
    #[default]
    Number,
    /// Whole numbers, such as those of cycles.
    Count,
    /// Calendar dates, UTC: values are days since the start of 1970.
    Date,
}

/// Spacing of the values of a vertical axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum YAxis {
    /// Evenly.
    #[default]
    Linear,
    /// Logarithmic; values that are not positive are not drawn.
    Logarithmic,
}

/// A marked value of the vertical axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// The value.
    pub value: f64,
    /// Level that begins there.
    pub level: FigureLevel,
}

/// Status of a subject, or the level of a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureLevel {
    /// Nothing unusual; as a limit: the usual value.
    Usual,
    /// An inspection should be planned.
    Warning,
    /// An inspection is needed before the next shift.
    Critical,
    /// Not known.
    Unknown,
}

impl FigureLevel {
    /// Class of its colours in a picture and on a page.
    pub(super) fn class(self) -> &'static str {
        match self {
            Self::Usual => "usual",
            Self::Warning => "warning",
            Self::Critical => "critical",
            Self::Unknown => "unknown",
        }
    }
}

/// The status of a panel's subject in a word.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StatusWord {
    /// The word.
    pub word: String,
    /// Its colour.
    pub level: FigureLevel,
}

/// An event at a value of the horizontal axis.
#[derive(Debug, Clone, PartialEq)]
pub struct FigureEvent {
    /// Its horizontal value.
    pub at: f64,
    /// Kind of the event.
    pub kind: FigureEventKind,
    /// Text that is shown when the reader points at it.
    pub label: String,
}

/// Kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureEventKind {
    /// An alarm began.
    Alarm,
    /// The arm was repaired.
    Repair,
}

/// An area between two curves along the horizontal axis, such as an interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Area {
    /// Index of the colour.
    pub colour: usize,
    /// Horizontal value, lower and upper end; broken at a point that is not finite.
    pub points: Vec<[f64; 3]>,
}

/// A shaded range of the horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Start on the horizontal axis.
    pub from: f64,
    /// End on the horizontal axis.
    pub to: f64,
    /// Index into [`TINTS`].
    pub tint: usize,
}

/// One set of data in a panel.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name, shown when the reader points at it.
    pub name: String,
    /// Index into [`COLOURS`], or a result of [`ramp`].
    pub colour: usize,
    /// Line style or marker.
    pub mark: Mark,
    /// Horizontal and vertical value; a line breaks at a point that is not finite, which is not drawn.
    pub points: Vec<[f64; 2]>,
}

/// Line style or marker of a series.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// A line through the points.
    Line,
    /// A dashed line through the points.
    Dashed,
    /// A thin line through the points.
    Thin,
    /// A pale thin line, for the background.
    Pale,
    /// A broad pale line; a thin line on top of it remains visible.
    Broad,
    /// A small dot at each point.
    Dots,
    /// A small ring at each point.
    Rings,
    /// A line through the points with a dot at each.
    LineWithDots,
}

/// An entry of the legend.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key {
    /// Its text.
    pub label: String,
    /// Its symbol.
    pub look: Look,
}

/// Symbol of an entry of the legend.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// A series of this colour and mark.
    Series(usize, Mark),
    /// A band of this tint.
    Band(usize),
    /// An area of this colour.
    Area(usize),
    /// A limit of this level.
    Limit(FigureLevel),
    /// An event of this kind.
    Event(FigureEventKind),
}

/// Colours of series for light and dark pages, from the palette of Okabe and Ito (2008), which people with
/// colour-blindness can distinguish; index them modulo their number.
pub const COLOURS: [(&str, &str); 7] = [
    ("#30343b", "#d5d9e0"),
    ("#d55e00", "#ff8a3d"),
    ("#0072b2", "#56b4e9"),
    ("#009e73", "#2fd6a5"),
    ("#a8518a", "#e39cc6"),
    ("#8a7300", "#f0e442"),
    ("#7a5c3e", "#c9a27a"),
];

/// Colours of ordered items, from the first to the last, for light and dark pages. Their lightness increases or
/// decreases along the order, so that it is visible without colours too.
pub const RAMP: [(&str, &str); 9] = [
    ("#1b0c8f", "#5a6cff"),
    ("#4b03a1", "#7f66ff"),
    ("#7301a8", "#a566f5"),
    ("#9511a1", "#c566e0"),
    ("#b42e8d", "#e06ec0"),
    ("#cb4679", "#f07ca0"),
    ("#dd5e5c", "#fb9180"),
    ("#e0733a", "#ffac66"),
    ("#c98a00", "#ffd25c"),
];

/// Colour of the item at index `place` of `count` ordered ones.
pub fn ramp(place: usize, count: usize) -> usize {
    let last = RAMP.len() - 1;
    COLOURS.len() + if count > 1 { (place * last / (count - 1)).min(last) } else { last / 2 }
}

/// Tints of bands for light and dark pages.
pub const TINTS: [(&str, &str); 4] =
    [("#f3f4f6", "#1c2026"), ("#e6effa", "#172437"), ("#fdf0dc", "#292114"), ("#e7f4e8", "#16281a")];

/// Colour of measured values.
pub const MEASURED: usize = 0;
/// Colour of values from a model.
pub const ESTIMATED: usize = 1;
/// Colour of their difference.
pub const RESIDUAL: usize = 2;

/// A time as a value of a date axis: days since the start of 1970.
pub fn day(time: Timestamp) -> f64 {
    time.as_second() as f64 / 86_400.0
}

/// Smallest and largest finite value; `None` if there is none.
pub fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |found, value| match found {
        None => Some((value, value)),
        Some((low, high)) => Some((value.min(low), value.max(high))),
    })
}
