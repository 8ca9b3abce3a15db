//! Figures as SVG text: no scripts, no fonts or styles from elsewhere.

use std::fmt::Write;

use super::figure::{
    Area, Band, COLOURS, Event, EventKind, Figure, Key, Level, Look, Mark, Panel, RAMP, Series, Standing,
    TINTS, XAxis, YAxis, extent,
};
use super::scale::{Scale, Tick, moment};

/// Width of a picture, px. Text is of one size whatever the width at which a picture is shown, so a picture of this
/// width can still be read at half of it.
const WIDTH: f64 = 960.0;
/// Height of a panel's plotting area, px.
const PLOT_HEIGHT: f64 = 210.0;
/// The same of a panel that stands alone.
const ALONE_HEIGHT: f64 = 420.0;
/// Height of the plotting area of a strip, px.
const STRIP_HEIGHT: f64 = 84.0;
/// Space between a plotting area and its strip, px.
const STRIP_GAP: f64 = 10.0;
/// Space left of a plotting area for the vertical axis, px.
const LEFT: f64 = 66.0;
/// Space right of it, px.
const RIGHT: f64 = 14.0;
/// Space above it for the panel's title, px.
const ABOVE: f64 = 32.0;
/// Space below it for the horizontal axis, px.
const BELOW: f64 = 48.0;
/// Space for the title, px.
const HEAD: f64 = 36.0;
/// Height of a line of the subtitle, px.
const SUBTITLE_LINE: f64 = 18.0;
/// Height of a row of the legend, px.
const LEGEND_ROW: f64 = 22.0;
/// Width of a letter, px; wide enough for common fonts.
const LETTER: f64 = 7.4;
/// Part of the data's range that stays free at either end of the vertical axis.
const MARGIN: f64 = 0.05;
/// The same of a horizontal axis without bands.
const X_MARGIN: f64 = 0.02;
/// Room of a tick of the horizontal axis, px.
const X_TICK_ROOM: f64 = 62.0;
/// Room of a tick of the vertical axis, px.
const Y_TICK_ROOM: f64 = 42.0;
/// Radius of a dot, px; less where dots would cover each other.
const DOT: f64 = 2.6;
/// Points that a reader can point at; a series with more has one word for all.
const MAX_POINTED_AT: usize = 400;
/// How far from a point a reader points at it, px.
const REACH: f64 = 9.0;

impl Figure {
    /// The picture as an SVG file that needs no other file and follows the reader's light or dark setting.
    #[must_use]
    pub fn svg(&self) -> String {
        document(self)
    }

    /// Panels beside each other.
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
        escaped(&figure.title),
        style(),
    );
    let squeeze = squeezed(&figure.title, 1.35);
    let _ =
        writeln!(svg, "<text class=\"title\" x=\"16\" y=\"27\"{squeeze}>{}</text>", escaped(&figure.title));
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

/// A panel as a drawing of its own, for a page that has [`style`] and says what the colours mean.
pub(super) fn panel_svg(figure: &Figure, panel: &Panel) -> String {
    let width = WIDTH / figure.across() as f64;
    let height = panel_height(figure, panel);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width:.0} {height:.0}\" class=\"plot\" role=\"img\" aria-label=\"{}\">\n",
        escaped(&format!("{}; {}: {}", figure.title, panel.title, panel.y_label)),
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

/// Colours for light pages, and those that a dark setting puts in their place. Paper is light.
pub(super) fn style() -> String {
    let mut light = String::from(
        ".plot { font: 14px system-ui, 'Segoe UI', 'DejaVu Sans', Helvetica, Arial, sans-serif }\n\
         .plot .page { fill: #ffffff } .plot text { fill: #30343b } .plot .soft, .plot .tick { fill: #5c6470 } \
         .plot .title { font-size: 19px; font-weight: 600 } .plot .name { font-size: 15px; font-weight: 600 } \
         .plot .tick { font-size: 13px } .plot .frame { fill: none; stroke: #b6bcc6 } .plot .grid { stroke: #e3e6eb } \
         .plot .zero { stroke: #9aa2ae }\n\
         .plot .line { fill: none; stroke-width: 1.5; stroke-linejoin: round } .plot .dashed { fill: none; \
         stroke-width: 1.5; stroke-dasharray: 5 3 } .plot .thin { fill: none; stroke-width: 1 } .plot .pale { fill: \
         none; stroke-width: 0.9; opacity: 0.35 } .plot .broad { fill: none; stroke-width: 3.4; opacity: 0.4; stroke-linejoin: round } .plot .ring { fill: none } .plot .area { opacity: 0.2; stroke: none } \
         .plot .hit { fill: none; pointer-events: all }\n\
         .plot path.usual { stroke: #68707c; stroke-width: 1.2 } .plot path.warning { stroke: #b86e00; stroke-width: 1.4; \
         stroke-dasharray: 7 4 } .plot path.critical { stroke: #c0262d; stroke-width: 1.4; stroke-dasharray: 7 4 } \
         .plot .event { stroke: #30343b; stroke-width: 1; stroke-dasharray: 1 3 } .plot .alarm { fill: #c0262d } .plot \
         .repair { fill: #0072b2 }\n\
         .plot tspan.usual { fill: #1d7a4c } .plot tspan.warning { fill: #9a5b00 } .plot tspan.critical { fill: \
         #b3121b } .plot tspan.unknown { fill: #5c6470 }\n",
    );
    let mut dark = String::from(
        ".plot .page { fill: #12151a } .plot text { fill: #e3e6eb } .plot .soft, .plot .tick { fill: #a7b0bd } .plot \
         .frame { stroke: #4a515c } .plot .grid { stroke: #272c34 } .plot .zero { stroke: #68707c } .plot .area { \
         opacity: 0.3 } .plot .pale { opacity: 0.45 }\n\
         .plot path.usual { stroke: #9aa3b0 } .plot path.warning { stroke: #f5b94d } .plot path.critical { stroke: \
         #ff7b72 } .plot .event { stroke: #e3e6eb } .plot .alarm { fill: #ff7b72 } .plot .repair { fill: #56b4e9 }\n\
         .plot tspan.usual { fill: #55d08d } .plot tspan.warning { fill: #f5b94d } .plot tspan.critical { fill: \
         #ff7b72 } .plot tspan.unknown { fill: #a7b0bd }\n",
    );
    for (i, (on_light, on_dark)) in COLOURS.iter().chain(&RAMP).enumerate() {
        let _ = writeln!(light, ".plot .s{i} {{ stroke: {on_light} }} .plot .f{i} {{ fill: {on_light} }}");
        let _ = writeln!(dark, ".plot .s{i} {{ stroke: {on_dark} }} .plot .f{i} {{ fill: {on_dark} }}");
    }
    for (i, (on_light, on_dark)) in TINTS.iter().enumerate() {
        let _ = writeln!(light, ".plot .t{i} {{ fill: {on_light} }}");
        let _ = writeln!(dark, ".plot .t{i} {{ fill: {on_dark} }}");
    }
    format!("{light}@media screen and (prefers-color-scheme: dark) {{\n{dark}}}\n")
}

/// The legend from `y` on, and its height.
fn legend(keys: &[Key], y: f64) -> (String, f64) {
    let mut drawn = String::new();
    let (mut x, mut row) = (16.0, 0.0);
    for key in keys {
        let width = 34.0 + LETTER * key.label.chars().count() as f64 + 16.0;
        if x + width > WIDTH - RIGHT && x > 16.0 {
            (x, row) = (16.0, row + 1.0);
        }
        let middle = y + LEGEND_ROW * row;
        let _ = writeln!(drawn, "<g transform=\"translate({x:.1} {middle:.1})\">{}</g>", swatch(key.look));
        text(&mut drawn, x + 34.0, middle + 5.0, "soft", &key.label);
        x += width;
    }
    (drawn, if keys.is_empty() { 0.0 } else { LEGEND_ROW * (row + 1.0) })
}

/// What an entry of the legend looks like, 26 px wide, about the height 0.
pub(super) fn swatch(look: Look) -> String {
    let mut drawn = String::new();
    match look {
        Look::Band(tint) => {
            let tint = tint % TINTS.len();
            let _ = write!(
                drawn,
                "<rect class=\"t{tint}\" y=\"-6\" width=\"26\" height=\"12\"/><rect class=\"frame\" y=\"-6\" width=\"26\" \
                 height=\"12\"/>"
            );
        }
        Look::Area(colour) => {
            let _ = write!(
                drawn,
                "<rect class=\"area f{}\" y=\"-6\" width=\"26\" height=\"12\"/>",
                colour % colours()
            );
        }
        Look::Limit(level) => {
            let _ = write!(drawn, "<path class=\"{}\" d=\"M0 0H26\"/>", level.class());
        }
        Look::Event(kind) => drawn.push_str(&event_mark(kind, 13.0, -5.0)),
        Look::Series(colour, mark) => {
            let ends: &[[f64; 2]] = match mark {
                Mark::Dots | Mark::Rings => &[[13.0, 0.0]],
                _ => &[[0.0, 0.0], [26.0, 0.0]],
            };
            draw_marks(&mut drawn, ends, colour, mark, DOT);
        }
    }
    drawn
}

/// How many colours there are.
fn colours() -> usize {
    COLOURS.len() + RAMP.len()
}

/// A pair of axes with what they say and where their values are.
struct Axes<'a> {
    panel: &'a Panel,
    y_label: &'a str,
    y_axis: YAxis,
    x: Scale,
    y: Scale,
}

/// Draws a panel at the place 0, 0.
fn draw_panel(svg: &mut String, panel: &Panel, width: f64, height: f64) {
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
        let name = escaped(&format!("{}: {}", limit_name(limit.level), significant(limit.value)));
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
    // axes are wide enough for all points: nothing needs to be cut off
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

/// Whether a tick stands at a whole number; one of a whole number is written without decimals.
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

fn draw_title(svg: &mut String, title: &str, standing: Option<&Standing>, x: f64, room: f64) {
    let word = standing.map_or_else(String::new, |of| {
        format!("<tspan class=\"{}\"> \u{25cf} {}</tspan>", of.level.class(), escaped(&of.word))
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
        escaped(title)
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
        escaped(y_label),
    );
}

/// What stands below the lowest axis of a panel.
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
        escaped(&label)
    );
}

fn draw_area(svg: &mut String, area: &Area, x: &Scale, y: &Scale) {
    let is_whole = |point: &[f64; 3]| point.iter().all(|value| value.is_finite());
    for stretch in area.points.split(|point| !is_whole(point)).filter(|stretch| !stretch.is_empty()) {
        let colour = area.colour % colours();
        if let [[at, low, high]] = stretch {
            // the interval of a single point is a stroke
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

fn draw_series(svg: &mut String, series: &Series, axes: &Axes<'_>) {
    let Axes { x, y, .. } = axes;
    let shown = |point: &[f64; 2]| is_shown(point, axes.y_axis);
    let count = series.points.iter().filter(|point| shown(point)).count();
    // dots that are closer than twice their size would be a band
    let radius = (0.3 * (x.end - x.start) / count.max(1) as f64).clamp(0.9, DOT);
    let _ = writeln!(svg, "<g>");
    if !series.name.is_empty() {
        let _ = writeln!(svg, "<title>{}</title>", escaped(&series.name));
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
                escaped(&pointed_at(series, axes, *point))
            );
        }
    }
    svg.push_str("</g>\n");
}

/// What a reader is told who points at a point.
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

/// A number with four significant digits, or all before its point.
fn significant(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let decimals = (3.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

fn limit_name(level: Level) -> &'static str {
    match level {
        Level::Usual | Level::Unknown => "baseline",
        Level::Warning => "warning from",
        Level::Critical => "critical from",
    }
}

fn draw_event(svg: &mut String, event: &Event, x: &Scale, above: f64, below: f64) {
    let at = x.at(event.at);
    let _ = writeln!(
        svg,
        "<g><title>{}</title><path class=\"event\" d=\"M{at:.1} {above:.1}V{below:.1}\"/>{}<circle class=\"hit\" \
         cx=\"{at:.1}\" cy=\"{:.1}\" r=\"{REACH}\"/></g>",
        escaped(&event.label),
        event_mark(event.kind, at, above),
        above + 5.0
    );
}

/// A triangle or a diamond that hangs at a height.
fn event_mark(kind: EventKind, x: f64, top: f64) -> String {
    match kind {
        EventKind::Alarm => format!("<path class=\"alarm\" d=\"M{:.1} {top:.1}h12l-6 10z\"/>", x - 6.0),
        EventKind::Repair => format!("<path class=\"repair\" d=\"M{x:.1} {top:.1}l6 6l-6 6l-6 -6z\"/>"),
    }
}

/// Draws a stretch of a series, whose places are finite.
fn draw_marks(svg: &mut String, places: &[[f64; 2]], colour: usize, mark: Mark, radius: f64) {
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

/// A path through places.
fn path(places: &[[f64; 2]]) -> String {
    let mut d = String::with_capacity(12 * places.len());
    for (i, [x, y]) in places.iter().enumerate() {
        let _ = write!(d, "{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" });
    }
    d
}

fn text(svg: &mut String, x: f64, y: f64, class: &str, words: &str) {
    let _ = writeln!(svg, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escaped(words));
}

/// Words in lines that the picture has room for.
fn lines_of(words: &str) -> Vec<String> {
    let most = ((WIDTH - 32.0) / LETTER) as usize;
    let mut lines: Vec<String> = Vec::new();
    for word in words.split_whitespace() {
        match lines.last_mut().filter(|line| line.chars().count() + 1 + word.chars().count() <= most) {
            Some(line) => {
                line.push(' ');
                line.push_str(word);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Makes a line of text that would leave the page as narrow as the page is; its letters are `size` times the usual.
fn squeezed(words: &str, size: f64) -> String {
    let room = WIDTH - 32.0;
    if LETTER * size * words.chars().count() as f64 <= room {
        return String::new();
    }
    format!(" textLength=\"{room}\" lengthAdjust=\"spacingAndGlyphs\"")
}

fn is_finite(point: &[f64; 2]) -> bool {
    point.iter().all(|value| value.is_finite())
}

/// Whether a point has a place on axes of this kind.
fn is_shown(point: &[f64; 2], y_axis: YAxis) -> bool {
    is_finite(point) && (y_axis == YAxis::Linear || point[1] > 0.0)
}

/// Text as XML holds it; what XML 1.0 has no place for is left out.
pub(super) fn escaped(words: &str) -> String {
    let mut safe = String::with_capacity(words.len());
    for c in words.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\n' | '\t' => safe.push(c),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {}
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::{Limit, Strip};

    fn figure(points: Vec<[f64; 2]>, mark: Mark) -> Figure {
        let panel = Panel {
            title: "joint 1".into(),
            x_label: "time, s".into(),
            y_label: "torque, Nm".into(),
            bands: vec![Band { from: 0.0, to: 5.0, tint: 1 }],
            areas: vec![Area {
                colour: 1,
                points: points.iter().map(|[x, y]| [*x, y - 1.0, y + 1.0]).collect(),
            }],
            limits: vec![Limit { value: 1.5, level: Level::Warning }],
            events: vec![Event { at: 1.0, kind: EventKind::Repair, label: "a <gear> & oil".into() }],
            standing: Some(Standing { word: "ok".into(), level: Level::Usual }),
            strip: Some(Strip {
                y_label: "residual".into(),
                series: vec![Series {
                    name: String::new(),
                    colour: 2,
                    mark: Mark::Thin,
                    points: points.clone(),
                }],
            }),
            series: vec![Series { name: "a \"line\"".into(), colour: 1, mark, points }],
            ..Panel::default()
        };
        let legend = vec![Key { label: "a".into(), look: Look::Series(1, mark) }];
        Figure {
            title: "a <b> & \"c\"\u{7}".into(),
            legend,
            panels: vec![panel],
            columns: 1,
            ..Figure::default()
        }
    }

    const MARKS: [Mark; 8] = [
        Mark::Line,
        Mark::Dashed,
        Mark::Thin,
        Mark::Pale,
        Mark::Broad,
        Mark::Dots,
        Mark::Rings,
        Mark::LineWithDots,
    ];

    fn assert_well_formed(svg: &str) {
        for event in xml::EventReader::from_str(svg) {
            event.unwrap_or_else(|error| panic!("{error}\n{svg}"));
        }
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn a_picture_is_well_formed_whatever_it_shows() {
        for points in [
            vec![[0.0, 1.0], [1.0, 3.0], [f64::NAN, f64::NAN], [4.0, 2.0], [5.0, f64::INFINITY]],
            vec![[0.0, 2.0]],
            vec![],
        ] {
            for mark in MARKS {
                let svg = figure(points.clone(), mark).svg();
                assert_well_formed(&svg);
                assert!(svg.contains("a &lt;b&gt; &amp; &quot;c&quot;</title>"));
                assert_eq!(svg.contains("no data"), points.is_empty());
            }
        }
    }

    #[test]
    fn a_line_breaks_where_a_point_is_missing() {
        let whole = figure(vec![[0.0, 1.0], [1.0, 1.5], [4.0, 2.0], [5.0, 2.0]], Mark::Line).svg();
        let broken =
            figure(vec![[0.0, 1.0], [1.0, 1.5], [2.0, f64::NAN], [4.0, 2.0], [5.0, 2.0]], Mark::Line).svg();
        assert_eq!(
            whole.matches("class=\"line s1\"").count() + 1,
            broken.matches("class=\"line s1\"").count()
        );
    }

    #[test]
    fn it_needs_no_other_file_and_has_dark_colours_too() {
        let page = figure(vec![[0.0, 1.0], [1.0, 3.0]], Mark::Line).html();
        for outside in ["http:", "https:", "@import", "<script", "<link", "<image", "src="] {
            assert_eq!(
                page.replace("http://www.w3.org/2000/svg", "").matches(outside).count(),
                0,
                "{outside}"
            );
        }
        assert!(page.contains("@media screen and (prefers-color-scheme: dark)"));
    }

    #[test]
    fn a_panel_alone_has_the_whole_width_and_twice_the_height() {
        let wide = figure(vec![[0.0, 1.0], [1.0, 3.0]], Mark::Line);
        let alone = |mut figure: Figure| {
            figure.columns = 2;
            figure.panels[0].strip = None;
            figure
        };
        let svg = alone(wide.clone()).svg();
        assert!(
            svg.contains("<rect class=\"frame\" x=\"66.0\" y=\"32.0\" width=\"880.0\" height=\"420.0\"/>"),
            "{svg}"
        );
        let mut two = alone(wide);
        two.panels.push(two.panels[0].clone());
        assert!(two.svg().contains("width=\"400.0\" height=\"210.0\"/>"));
    }

    #[test]
    fn a_logarithmic_axis_leaves_out_what_has_no_place_on_it() {
        let mut figure = figure(vec![[0.0, 1.0], [1.0, 0.0], [2.0, 100.0], [3.0, 10.0]], Mark::Line);
        figure.panels[0].y_axis = YAxis::Logarithmic;
        figure.panels[0].areas.clear();
        figure.panels[0].strip = None;
        let svg = figure.svg();
        assert_well_formed(&svg);
        assert_eq!(svg.matches("class=\"line s1\"").count(), 2, "the legend and one stretch: {svg}");
    }

    #[test]
    fn a_point_tells_its_name_and_its_values() {
        let mut dated = figure(vec![[20_458.5, 1.234_567], [20_459.0, 2.0]], Mark::LineWithDots);
        dated.panels[0].bands.clear();
        dated.panels[0].events.clear();
        dated.panels[0].x_axis = XAxis::Date;
        let svg = dated.svg();
        assert!(svg.contains("a &quot;line&quot;\n2026-01-05 12:00Z\ntorque, Nm: 1.235</title>"), "{svg}");
        assert!(svg.contains(", 2026</text>"), "the year stands below the axis");
    }
}
