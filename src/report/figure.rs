//! What a picture is made of: panels with axes, shaded stretches, lines and points, and one legend.

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
    /// Quantity and unit of the horizontal axis.
    pub x_label: String,
    /// Quantity and unit of the vertical axis.
    pub y_label: String,
    /// Whether the vertical axis shows zero whatever the data.
    pub with_zero: bool,
    /// A value of the vertical axis that is marked by a line, where the data come so far.
    pub guide: Option<f64>,
    /// Shaded stretches of the horizontal axis.
    pub bands: Vec<Band>,
    /// Lines and points, later ones on top.
    pub series: Vec<Series>,
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
    /// Which of the [`COLOURS`].
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
    /// A broad line, for what another line runs on.
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

/// Tints of bands as light and dark pages have them.
pub const TINTS: [(&str, &str); 4] =
    [("#f3f4f6", "#1c2026"), ("#e6effa", "#172437"), ("#fdf0dc", "#292114"), ("#e7f4e8", "#16281a")];

/// Colour of what was measured.
pub const MEASURED: usize = 0;
/// Colour of what a model gives.
pub const ESTIMATED: usize = 1;
/// Colour of the difference.
pub const RESIDUAL: usize = 2;

/// Smallest and largest finite value; `None` without any.
#[must_use]
pub fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    values.into_iter().filter(|value| value.is_finite()).fold(None, |found, value| match found {
        None => Some((value, value)),
        Some((low, high)) => Some((value.min(low), value.max(high))),
    })
}
