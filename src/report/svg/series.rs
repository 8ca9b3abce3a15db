//! Lines, areas and marks of a series.

use std::fmt::Write;

use super::sizes::{DOT, REACH, colours};
use crate::report::figure::{Area, Mark, Panel, Series, XAxis, YAxis};
use crate::report::scale::{Scale, moment};
use armwatch_model::text::xml;

/// Most points with individual tooltips; a series with more has one tooltip for all.
const MAX_POINTED_AT: usize = 400;

/// A pair of axes with their panel, label and scales.
pub(super) struct Axes<'a> {
    pub(super) panel: &'a Panel,
    pub(super) y_label: &'a str,
    pub(super) y_axis: YAxis,
    pub(super) x: Scale,
    pub(super) y: Scale,
}

pub(super) fn draw_area(svg: &mut String, area: &Area, x: &Scale, y: &Scale) {
    let is_whole = |point: &[f64; 3]| point.iter().all(|value| value.is_finite());
    for stretch in area.points.split(|point| !is_whole(point)).filter(|stretch| !stretch.is_empty()) {
        let colour = area.colour % colours();
        if let [[at, low, high]] = stretch {
            // the interval of a single point is a line
            let _ = writeln!(
                svg,
                "<path class=\"thin s{colour}\" d=\"M{0:.1} {1:.1}V{2:.1}\"/>",
                x.at(*at),
                y.at(*low),
                y.at(*high)
            );
            continue;
        }
        let upper = stretch.iter().map(|[at, _, high]| [x.at(*at), y.at(*high)]);
        let lower = stretch.iter().rev().map(|[at, low, _]| [x.at(*at), y.at(*low)]);
        let places: Vec<[f64; 2]> = upper.chain(lower).collect();
        let _ = writeln!(svg, "<path class=\"area f{colour}\" d=\"{}Z\"/>", path(&places));
    }
}

pub(super) fn draw_series(svg: &mut String, series: &Series, axes: &Axes<'_>) {
    let Axes { x, y, .. } = axes;
    let shown = |point: &[f64; 2]| is_shown(point, axes.y_axis);
    let count = series.points.iter().filter(|point| shown(point)).count();
    // dots that are closer than twice their size would be a band
    let radius = (0.3 * (x.end - x.start) / count.max(1) as f64).clamp(0.9, DOT);
    let _ = writeln!(svg, "<g>");
    if !series.name.is_empty() {
        let _ = writeln!(svg, "<title>{}</title>", xml(&series.name));
    }
    for stretch in series.points.split(|point| !shown(point)).filter(|stretch| !stretch.is_empty()) {
        let places: Vec<[f64; 2]> = stretch.iter().map(|p| [x.at(p[0]), y.at(p[1])]).collect();
        draw_marks(svg, &places, series.colour, series.mark, radius);
    }
    let has_dots = matches!(series.mark, Mark::Dots | Mark::Rings | Mark::LineWithDots);
    if has_dots && count <= MAX_POINTED_AT {
        for point in series.points.iter().filter(|point| shown(point)) {
            let _ = writeln!(
                svg,
                "<circle class=\"hit\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"{REACH}\"><title>{}</title></circle>",
                x.at(point[0]),
                y.at(point[1]),
                xml(&pointed_at(series, axes, *point))
            );
        }
    }
    svg.push_str("</g>\n");
}

/// Tooltip of a point.
fn pointed_at(series: &Series, axes: &Axes<'_>, [x, y]: [f64; 2]) -> String {
    let (panel, y_label) = (axes.panel, axes.y_label);
    let at = match panel.x_axis {
        XAxis::Number | XAxis::Count => format!("{}: {}", panel.x_label, significant(x)),
        XAxis::Date => {
            moment(x).map_or_else(String::new, |time| time.strftime("%Y-%m-%d %H:%MZ").to_string())
        }
    };
    let name = if series.name.is_empty() { String::new() } else { format!("{}\n", series.name) };
    format!("{name}{at}\n{y_label}: {}", significant(y))
}

/// A number with four significant digits, or with all digits before the decimal point.
pub(super) fn significant(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Draws a section of a series, whose positions are finite.
pub(super) fn draw_marks(svg: &mut String, places: &[[f64; 2]], colour: usize, mark: Mark, radius: f64) {
    let colour = colour % colours();
    let class = match mark {
        Mark::Line | Mark::LineWithDots => "line",
        Mark::Dashed => "dashed",
        Mark::Thin => "thin",
        Mark::Pale => "pale",
        Mark::Broad => "broad",
        Mark::Dots | Mark::Rings => "",
    };
    if !class.is_empty() && places.len() > 1 {
        let _ = writeln!(svg, "<path class=\"{class} s{colour}\" d=\"{}\"/>", path(places));
    }
    // a dashed line of one point would not be seen
    let dots = matches!(mark, Mark::Dots | Mark::LineWithDots) || (places.len() == 1 && mark == Mark::Dashed);
    if dots || mark == Mark::Rings {
        let (class, radius) = if dots { ("f", radius) } else { ("ring s", 1.3 * radius) };
        let _ = write!(svg, "<g class=\"{class}{colour}\">");
        for [x, y] in places {
            let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\"/>");
        }
        svg.push_str("</g>\n");
    }
}

/// A path through positions.
pub(super) fn path(places: &[[f64; 2]]) -> String {
    let mut d = String::with_capacity(12 * places.len());
    for (i, [x, y]) in places.iter().enumerate() {
        let _ = write!(d, "{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" });
    }
    d
}

pub(super) fn is_finite(point: &[f64; 2]) -> bool {
    point.iter().all(|value| value.is_finite())
}

/// Returns true if a point has a position on axes of this kind.
pub(super) fn is_shown(point: &[f64; 2], y_axis: YAxis) -> bool {
    is_finite(point) && (y_axis == YAxis::Linear || point[1] > 0.0)
}
