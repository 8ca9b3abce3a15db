//! A panel: its axes, title, events and data.

use std::fmt::Write;

use super::picture_text::text;
use super::series::{Axes, draw_area, draw_series, is_finite, is_shown, significant};
use super::sizes::{ABOVE, LETTER, REACH, RIGHT, STRIP_GAP, STRIP_HEIGHT};
use crate::report::figure::{
    Band, FigureEvent, FigureEventKind, FigureLevel, Panel, Series, StatusWord, TINTS, XAxis, YAxis, extent,
};
use crate::report::scale::{Scale, Tick};
use armwatch_model::text::xml;

/// Space left of a plotting area for the vertical axis, px.
const LEFT: f64 = 66.0;
/// Part of the data's range that stays free at either end of the vertical axis.
const MARGIN: f64 = 0.05;
/// The same of a horizontal axis without bands.
const X_MARGIN: f64 = 0.02;
/// Space for a tick of the horizontal axis, px.
const X_TICK_ROOM: f64 = 62.0;
/// Space for a tick of the vertical axis, px.
const Y_TICK_ROOM: f64 = 42.0;

/// Draws a panel at the position 0, 0.
pub(super) fn draw_panel(svg: &mut String, panel: &Panel, width: f64, height: f64) {
    let (left, right, above) = (LEFT, width - RIGHT, ABOVE);
    let below = above + height;
    let strip = panel.strip.iter().flat_map(|strip| &strip.series);
    let x = x_scale(panel, panel.series.iter().chain(strip), left, right);
    let y = y_scale(panel, below, above);
    let bottom = if panel.strip.is_some() { below + STRIP_GAP + STRIP_HEIGHT } else { below };

    for band in &panel.bands {
        draw_band(svg, band, &x, above, bottom);
    }
    let wanted = ((right - left) / X_TICK_ROOM) as usize;
    let ticks = match panel.x_axis {
        XAxis::Number => x.ticks(wanted),
        XAxis::Count => {
            x.ticks(wanted.min((x.to - x.from).ceil() as usize)).into_iter().filter(is_whole).collect()
        }
        XAxis::Date => x.date_ticks(wanted),
    };
    draw_axes(svg, &panel.y_label, &x, &y, &ticks);
    for limit in panel.limits.iter().filter(|limit| y.holds(limit.value)) {
        let at = y.at(limit.value);
        let name = xml(&format!("{}: {}", limit_name(limit.level), significant(limit.value)));
        let _ = writeln!(
            svg,
            "<path class=\"{}\" d=\"M{left:.1} {at:.1}H{right:.1}\"><title>{name}</title></path>",
            limit.level.class()
        );
    }
    draw_title(svg, &panel.title, panel.standing.as_ref(), left, right - left);
    for area in &panel.areas {
        draw_area(svg, area, &x, &y);
    }
    // axes are wide enough for all points: no clipping is needed
    let axes = Axes { panel, y_label: &panel.y_label, y_axis: panel.y_axis, x, y };
    panel.series.iter().for_each(|series| draw_series(svg, series, &axes));
    for event in &panel.events {
        draw_event(svg, event, &x, above, bottom);
    }
    if !panel.series.iter().flat_map(|of| &of.points).any(|point| is_shown(point, panel.y_axis)) {
        text(svg, left + 12.0, above + 24.0, "soft", "no data");
    }
    if let Some(strip) = &panel.strip {
        let points = strip.series.iter().flat_map(|of| &of.points).filter(|point| is_finite(point));
        let of_strip = Scale::over(
            extent(points.map(|point| point[1]).chain([0.0])),
            MARGIN,
            bottom,
            bottom - STRIP_HEIGHT,
        );
        draw_axes(svg, &strip.y_label, &x, &of_strip, &ticks);
        let axes = Axes { panel, y_label: &strip.y_label, y_axis: YAxis::Linear, x, y: of_strip };
        strip.series.iter().for_each(|series| draw_series(svg, series, &axes));
    }
    draw_x_labels(svg, panel, &x, &ticks, bottom);
}

/// Returns true if a tick is at a whole number, which is written without decimals.
fn is_whole(tick: &Tick) -> bool {
    tick.value.fract() == 0.0 && !tick.label.contains('.')
}

fn x_scale<'a>(panel: &Panel, series: impl Iterator<Item = &'a Series>, left: f64, right: f64) -> Scale {
    let points = series.flat_map(|of| &of.points).filter(|point| is_finite(point)).map(|point| point[0]);
    let ends = panel.bands.iter().flat_map(|band| [band.from, band.to]);
    let events = panel.events.iter().map(|event| event.at);
    let extent = extent(points.chain(ends).chain(events));
    match panel.x_axis {
        XAxis::Date => Scale::days(extent, X_MARGIN, left, right),
        // bands fill the axis; single points are not cut in two by its frame
        XAxis::Number | XAxis::Count => {
            Scale::over(extent, if panel.bands.is_empty() { X_MARGIN } else { 0.0 }, left, right)
        }
    }
}

fn y_scale(panel: &Panel, below: f64, above: f64) -> Scale {
    let points = panel.series.iter().flat_map(|of| &of.points).filter(|point| is_shown(point, panel.y_axis));
    let areas =
        panel.areas.iter().flat_map(|of| &of.points).filter(|p| p.iter().all(|value| value.is_finite()));
    let zero = (panel.with_zero && panel.y_axis == YAxis::Linear).then_some(0.0);
    let own = points.map(|point| point[1]).chain(areas.flat_map(|point| [point[1], point[2]])).chain(zero);
    let extent = match panel.y_range {
        Some([low, high]) => Some((low, high)),
        None => extent(own),
    };
    match panel.y_axis {
        YAxis::Linear => Scale::over(extent, MARGIN, below, above),
        YAxis::Logarithmic => Scale::logarithmic(extent, MARGIN, below, above),
    }
}

fn draw_title(svg: &mut String, title: &str, standing: Option<&StatusWord>, x: f64, room: f64) {
    let word = standing.map_or_else(String::new, |of| {
        format!("<tspan class=\"{}\"> \u{25cf} {}</tspan>", of.level.class(), xml(&of.word))
    });
    let letters = title.chars().count() + standing.map_or(0, |of| 3 + of.word.chars().count());
    let squeeze = if LETTER * 1.07 * letters as f64 <= room {
        String::new()
    } else {
        format!(" textLength=\"{room:.0}\" lengthAdjust=\"spacingAndGlyphs\"")
    };
    let _ = writeln!(
        svg,
        "<text class=\"name\" x=\"{x:.1}\" y=\"{:.1}\"{squeeze}>{}{word}</text>",
        ABOVE - 10.0,
        xml(title)
    );
}

fn draw_band(svg: &mut String, band: &Band, x: &Scale, above: f64, below: f64) {
    let (from, to) = (x.at(band.from), x.at(band.to));
    let _ = writeln!(
        svg,
        "<rect class=\"t{}\" x=\"{from:.1}\" y=\"{above:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
        band.tint % TINTS.len(),
        (to - from).max(1.0),
        below - above
    );
}

fn draw_axes(svg: &mut String, y_label: &str, x: &Scale, y: &Scale, x_ticks: &[Tick]) {
    let (left, right, below, above) = (x.start, x.end, y.start, y.end);
    for tick in y.ticks(((below - above) / Y_TICK_ROOM).max(3.0) as usize) {
        let at = y.at(tick.value);
        let class = if tick.value == 0.0 { "zero" } else { "grid" };
        let _ = writeln!(
            svg,
            "<path class=\"{class}\" d=\"M{left:.1} {at:.1}H{right:.1}\"/><text class=\"tick\" x=\"{:.1}\" \
             y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 6.0,
            at + 4.5,
            tick.label
        );
    }
    for tick in x_ticks {
        let at = x.at(tick.value);
        let _ = writeln!(svg, "<path class=\"grid\" d=\"M{at:.1} {above:.1}V{below:.1}\"/>");
    }
    let middle = (below + above) / 2.0;
    let _ = writeln!(
        svg,
        "<rect class=\"frame\" x=\"{left:.1}\" y=\"{above:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>\
         <text class=\"tick\" transform=\"translate({:.1} {middle:.1}) rotate(-90)\" text-anchor=\"middle\"{}>{}</text>",
        right - left,
        below - above,
        left - 50.0,
        if LETTER * y_label.chars().count() as f64 > below - above + 50.0 {
            format!(" textLength=\"{:.0}\" lengthAdjust=\"spacingAndGlyphs\"", below - above + 40.0)
        } else {
            String::new()
        },
        xml(y_label),
    );
}

/// Draws the labels below the lowest axis of a panel.
fn draw_x_labels(svg: &mut String, panel: &Panel, x: &Scale, ticks: &[Tick], bottom: f64) {
    for tick in ticks {
        let _ = writeln!(
            svg,
            "<text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            x.at(tick.value),
            bottom + 17.0,
            tick.label
        );
    }
    let label = match panel.x_axis {
        XAxis::Number | XAxis::Count => panel.x_label.clone(),
        XAxis::Date => format!("{}, {}", panel.x_label, x.years()),
    };
    let _ = writeln!(
        svg,
        "<text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        (x.start + x.end) / 2.0,
        bottom + 36.0,
        xml(&label)
    );
}

fn limit_name(level: FigureLevel) -> &'static str {
    match level {
        FigureLevel::Usual | FigureLevel::Unknown => "baseline",
        FigureLevel::Warning => "warning from",
        FigureLevel::Critical => "critical from",
    }
}

fn draw_event(svg: &mut String, event: &FigureEvent, x: &Scale, above: f64, below: f64) {
    let at = x.at(event.at);
    let _ = writeln!(
        svg,
        "<g><title>{}</title><path class=\"event\" d=\"M{at:.1} {above:.1}V{below:.1}\"/>{}<circle class=\"hit\" \
         cx=\"{at:.1}\" cy=\"{:.1}\" r=\"{REACH}\"/></g>",
        xml(&event.label),
        event_mark(event.kind, at, above),
        above + 5.0
    );
}

/// A triangle or a diamond that hangs at a height.
pub(super) fn event_mark(kind: FigureEventKind, x: f64, top: f64) -> String {
    match kind {
        FigureEventKind::Alarm => format!("<path class=\"alarm\" d=\"M{:.1} {top:.1}h12l-6 10z\"/>", x - 6.0),
        FigureEventKind::Repair => format!("<path class=\"repair\" d=\"M{x:.1} {top:.1}l6 6l-6 6l-6 -6z\"/>"),
    }
}
