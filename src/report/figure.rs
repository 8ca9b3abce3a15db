//! What a picture is made of: panels with axes, shaded stretches, lines and points, and one legend.

use jiff::Timestamp;

/// A picture of one or more panels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Figure {
    /// What it shows.
    pub title: String,
    /// A line below the title: which data, which parameters.
    pub subtitle: String,
    /// What the colours and marks of all panels mean.
    pub legend: Vec<Key>,
    /// Panels, row by row.
    pub panels: Vec<Panel>,
    /// Panels beside each other, at least 1.
    pub columns: usize,
}

/// One pair of axes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Panel {
    /// What it shows.
    pub title: String,
    /// Where its subject stands, beside the title.
    pub standing: Option<StatusWord>,
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// What its values are.
    pub x_axis: XAxis,
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// How its values are spaced.
    pub y_axis: YAxis,
    /// Ends of the vertical axis, where panels share one; else those of the data.
    pub y_range: Option<[f64; 2]>,
    /// Whether a linear vertical axis shows zero whatever the data.
    pub with_zero: bool,
    /// Values of the vertical axis that are marked by a line, where the axis comes so far.
    pub limits: Vec<Limit>,
    /// Shaded stretches of the horizontal axis.
    pub bands: Vec<Band>,
    /// Shaded stretches of the vertical axis along the horizontal one, below all lines.
    pub areas: Vec<Area>,
    /// Lines and points, later ones on top.
    pub series: Vec<Series>,
    /// What happened at a value of the horizontal axis.
    pub events: Vec<FigureEvent>,
    /// A second, lower pair of axes on the same horizontal axis.
    pub strip: Option<Strip>,
}

/// A low pair of axes below a panel, with a vertical axis of its own that shows zero.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Strip {
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// Lines and points, later ones on top.
    pub series: Vec<Series>,
}

/// What a horizontal axis shows.
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

/// How the values of a vertical axis are spaced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum YAxis {
    /// Evenly.
    #[default]
    Linear,
    /// By their logarithm; values that are not positive are not drawn.
    Logarithmic,
}

/// A marked value of the vertical axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// The value.
    pub value: f64,
    /// What it means.
    pub level: FigureLevel,
}

/// How things stand, or what a limit is a limit of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureLevel {
    /// Nothing to see; as a limit: what is usual.
    Usual,
    /// Plan a look.
    Warning,
    /// Look before the next shift.
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

/// A word on how the subject of a panel stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StatusWord {
    /// The word.
    pub word: String,
    /// Its colour.
    pub level: FigureLevel,
}

/// Something that happened at a value of the horizontal axis.
#[derive(Debug, Clone, PartialEq)]
pub struct FigureEvent {
    /// When, in values of the axis.
    pub at: f64,
    /// What it was.
    pub kind: FigureEventKind,
    /// What is shown of it to a reader who points at it.
    pub label: String,
}

/// What kind of thing happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureEventKind {
    /// An alarm began.
    Alarm,
    /// Somebody worked on the arm.
    Repair,
}

/// A stretch between two values along the horizontal axis, such as an interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Area {
    /// Which of the colours.
    pub colour: usize,
    /// Horizontal value, lower and upper end; broken at a point that is not finite.
    pub points: Vec<[f64; 3]>,
}

/// A shaded stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// Where it begins on the horizontal axis.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Which of the [`TINTS`].
    pub tint: usize,
}

/// Data of one kind in a panel.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// What it is, shown to a reader who points at it.
    pub name: String,
    /// Which of the [`COLOURS`], or one of [`ramp`].
    pub colour: usize,
    /// How it is drawn.
    pub mark: Mark,
    /// Horizontal and vertical value; a line breaks at a point that is not finite, which is not drawn.
    pub points: Vec<[f64; 2]>,
}

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mark {
    /// A line through the points.
    Line,
    /// A dashed line through the points.
    Dashed,
    /// A thin line through the points.
    Thin,
    /// A pale thin line, for what should stay in the background.
    Pale,
    /// A broad pale line, on which a thin one can be followed.
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
    /// What it means.
    pub label: String,
    /// What it looks like.
    pub look: Look,
}

/// What an entry of the legend looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// As a series of this colour and mark.
    Series(usize, Mark),
    /// As a band of this tint.
    Band(usize),
    /// As an area of this colour.
    Area(usize),
    /// As a limit of this level.
    Limit(FigureLevel),
    /// As an event of this kind.
    Event(FigureEventKind),
}

/// Colours of series as light and dark pages have them, from the palette of Okabe and Ito (2008), which
/// people with colour-blindness tell apart; index them modulo their number.
pub const COLOURS: [(&str, &str); 7] = [
    ("#30343b", "#d5d9e0"),
    ("#d55e00", "#ff8a3d"),
    ("#0072b2", "#56b4e9"),
    ("#009e73", "#2fd6a5"),
    ("#a8518a", "#e39cc6"),
    ("#8a7300", "#f0e442"),
    ("#7a5c3e", "#c9a27a"),
];

/// Colours of ordered things, the first to the last, as light and dark pages have them. Their lightness rises or falls
/// along the order, so that it is seen without colours too.
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

/// Colour of the thing at `place` of `count` ordered ones, from 0.
#[must_use]
pub fn ramp(place: usize, count: usize) -> usize {
    let last = RAMP.len() - 1;
    COLOURS.len() + if count > 1 { (place * last / (count - 1)).min(last) } else { last / 2 }
}

/// Tints of bands as light and dark pages have them.
pub const TINTS: [(&str, &str); 4] =
    [("#f3f4f6", "#1c2026"), ("#e6effa", "#172437"), ("#fdf0dc", "#292114"), ("#e7f4e8", "#16281a")];

/// Colour of what was measured.
pub const MEASURED: usize = 0;
/// Colour of what a model gives.
pub const ESTIMATED: usize = 1;
/// Colour of the difference.
pub const RESIDUAL: usize = 2;

/// A time as a value of an axis of dates: days since the start of 1970.
#[must_use]
pub fn day(time: Timestamp) -> f64 {
    time.as_second() as f64 / 86_400.0
}

/// Smallest and largest finite value; `None` without any.
#[must_use]
pub fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |found, value| match found {
        None => Some((value, value)),
        Some((low, high)) => Some((value.min(low), value.max(high))),
    })
}
