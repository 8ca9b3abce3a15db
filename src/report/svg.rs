//! Figures as SVG text: no scripts, no fonts or styles from elsewhere.

mod look;
mod panel;
mod series;
mod sizes;
mod picture_text;

use std::fmt::Write;

use self::look::legend;
pub(super) use self::look::{style, swatch};
use self::panel::draw_panel;
use self::picture_text::{lines_of, squeezed, text};
use self::sizes::{ABOVE, STRIP_GAP, STRIP_HEIGHT, WIDTH};
use super::figure::{Figure, Panel};
use armwatch_model::text::xml;

/// Height of a panel's plotting area, px.
const PLOT_HEIGHT: f64 = 210.0;
/// The same of a single panel.
const ALONE_HEIGHT: f64 = 420.0;
/// Space below a plotting area for the horizontal axis, px.
const BELOW: f64 = 48.0;
/// Space for the title, px.
const HEAD: f64 = 36.0;
/// Height of a line of the subtitle, px.
const SUBTITLE_LINE: f64 = 18.0;

impl Figure {
    /// The picture as an SVG file that needs no other file and follows the reader's light or dark setting.
    pub fn svg(&self) -> String {
        document(self)
    }

    /// Panels per row.
    pub(super) fn across(&self) -> usize {
        self.columns.clamp(1, self.panels.len().max(1))
    }
}

/// The whole picture.
fn document(figure: &Figure) -> String {
    let columns = figure.across();
    let subtitle = lines_of(&figure.subtitle);
    let below_title = HEAD + SUBTITLE_LINE * subtitle.len() as f64;
    let (legend, legend_height) = legend(&figure.legend, below_title + 14.0);
    let heights: Vec<f64> = figure
        .panels
        .chunks(columns)
        .map(|row| row.iter().map(|panel| panel_height(figure, panel)).fold(0.0, f64::max))
        .collect();
    let top = below_title + legend_height + 8.0;
    let height = top + heights.iter().sum::<f64>() + 8.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" width=\"{WIDTH}\" \
         height=\"{height:.0}\" style=\"max-width: 100%; height: auto\" class=\"plot\" role=\"img\">\n\
         <title>{}</title>\n<style>\n{}</style>\n<rect class=\"page\" width=\"100%\" height=\"100%\"/>\n",
        xml(&figure.title),
        style(),
    );
    let squeeze = squeezed(&figure.title, 1.35);
    let _ = writeln!(svg, "<text class=\"title\" x=\"16\" y=\"27\"{squeeze}>{}</text>", xml(&figure.title));
    for (i, line) in subtitle.iter().enumerate() {
        text(&mut svg, 16.0, HEAD + 12.0 + SUBTITLE_LINE * i as f64, "soft", line);
    }
    svg.push_str(&legend);
    let width = WIDTH / columns as f64;
    let mut above = top;
    for (row, height) in figure.panels.chunks(columns).zip(heights) {
        for (column, panel) in row.iter().enumerate() {
            let left = column as f64 * width;
            let _ = writeln!(svg, "<g transform=\"translate({left:.1} {above:.1})\">");
            draw_panel(&mut svg, panel, width, plot_height(figure));
            svg.push_str("</g>\n");
        }
        above += height;
    }
    svg.push_str("</svg>\n");
    svg
}

/// A panel as a separate drawing, for a page that has [`style`] and explains the colours.
pub(super) fn panel_svg(figure: &Figure, panel: &Panel) -> String {
    let width = WIDTH / figure.across() as f64;
    let height = panel_height(figure, panel);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width:.0} {height:.0}\" class=\"plot\" role=\"img\" aria-label=\"{}\">\n",
        xml(&format!("{}; {}: {}", figure.title, panel.title, panel.y_label)),
    );
    draw_panel(&mut svg, panel, width, plot_height(figure));
    svg.push_str("</svg>\n");
    svg
}

fn plot_height(figure: &Figure) -> f64 {
    if figure.panels.len() == 1 { ALONE_HEIGHT } else { PLOT_HEIGHT }
}

fn panel_height(figure: &Figure, panel: &Panel) -> f64 {
    let strip = if panel.strip.is_some() { STRIP_GAP + STRIP_HEIGHT } else { 0.0 };
    ABOVE + plot_height(figure) + strip + BELOW
}

#[cfg(test)]
mod tests;
