//! Figures as SVG text: no scripts, no fonts or styles from elsewhere.

use std::fmt::Write;

use super::figure::{Band, COLOURS, Figure, Key, Look, Mark, Panel, Series, TINTS, extent};
use super::scale::Scale;

/// Width of a picture, px.
const WIDTH: f64 = 1280.0;
/// Height of a panel's plotting area, px.
const PLOT_HEIGHT: f64 = 200.0;
/// Space left of a plotting area for the vertical axis, px.
const LEFT: f64 = 66.0;
/// Space right of it, px.
const RIGHT: f64 = 14.0;
/// Space above it for the panel's title, px.
const ABOVE: f64 = 30.0;
/// Space below it for the horizontal axis, px.
const BELOW: f64 = 46.0;
/// Space for title and subtitle, px.
const HEAD: f64 = 58.0;
/// Height of a row of the legend, px.
const LEGEND_ROW: f64 = 20.0;
/// Width of a letter of the legend, px; wide enough for common fonts.
const LETTER: f64 = 7.0;
/// Part of the data's range that stays free at either end of the vertical axis.
const MARGIN: f64 = 0.05;
/// The same of a horizontal axis without bands.
const X_MARGIN: f64 = 0.02;

impl Figure {
    /// The picture as an SVG file that needs no other file and follows the reader's light or dark setting.
    #[must_use]
    pub fn svg(&self) -> String {
        document(self)
    }

    /// The picture on an HTML page that needs no other file.
    #[must_use]
    pub fn html(&self) -> String {
        page(self)
    }
}

/// The whole picture.
fn document(figure: &Figure) -> String {
    let columns = figure.columns.max(1);
    let rows = figure.panels.len().div_ceil(columns);
    let (legend, legend_height) = legend(&figure.legend);
    let top = HEAD + legend_height;
    let height = top + rows as f64 * (ABOVE + PLOT_HEIGHT + BELOW) + 8.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height:.0}\" role=\"img\" \
         font-family=\"system-ui, 'Segoe UI', 'DejaVu Sans', Helvetica, Arial, sans-serif\" font-size=\"12\">\n\
         <title>{}</title>\n<style>\n{}</style>\n<rect class=\"page\" width=\"100%\" height=\"100%\"/>\n",
        escaped(&figure.title),
        style(),
    );
    text(&mut svg, 16.0, 26.0, "title", &figure.title);
    let _ = writeln!(
        svg,
        "<text class=\"soft\" x=\"16\" y=\"46\"{}>{}</text>",
        squeezed(&figure.subtitle),
        escaped(&figure.subtitle)
    );
    svg.push_str(&legend);
    let width = WIDTH / columns as f64;
    for (i, panel) in figure.panels.iter().enumerate() {
        let (column, row) = (i % columns, i / columns);
        let left = column as f64 * width + LEFT;
        let above = top + row as f64 * (ABOVE + PLOT_HEIGHT + BELOW) + ABOVE;
        draw_panel(&mut svg, panel, left, above, width - LEFT - RIGHT);
    }
    svg.push_str("</svg>\n");
    svg
}

/// The picture on a page of its own.
fn page(figure: &Figure) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width\">\n<title>{}</title>\n\
         <style>html {{ color-scheme: light dark }} body {{ margin: 0; background: #ffffff }} \
         @media (prefers-color-scheme: dark) {{ body {{ background: #12151a }} }} \
         svg {{ display: block; width: 100%; max-width: 1600px; margin: 0 auto }}</style>\n</head>\n<body>\n{}</body>\n</html>\n",
        escaped(&figure.title),
        document(figure)
    )
}

/// Colours for light pages, and those that a dark setting puts in their place.
fn style() -> String {
    let mut light = String::from(
        ".page { fill: #ffffff } text { fill: #30343b } .soft, .tick { fill: #68707c } .title { \
         font-size: 17px; font-weight: 600 } .name { font-size: 13px; font-weight: 600 } .tick { font-size: 11px } \
         .frame { fill: none; stroke: #b6bcc6 } .grid { stroke: #dfe3e8 } .zero { stroke: #9aa2ae }\n\
         .line { fill: none; stroke-width: 1.3; stroke-linejoin: round } .dashed { fill: none; stroke-width: 1.3; \
         stroke-dasharray: 5 3 } .thin { fill: none; stroke-width: 0.9 } .pale { fill: none; stroke-width: 0.8; opacity: 0.3 } .broad { fill: \
         none; stroke-width: 2.8; stroke-linejoin: round } .ring { fill: none } .guide { stroke: #c0392b; \
         stroke-dasharray: 2 3 }\n",
    );
    let mut dark = String::from(
        ".page { fill: #12151a } text { fill: #e3e6eb } .soft, .tick { fill: #9aa3b0 } .frame { stroke: \
         #4a515c } .grid { stroke: #2b3038 } .zero { stroke: #68707c }\n",
    );
    for (i, (on_light, on_dark)) in COLOURS.iter().enumerate() {
        let _ = writeln!(light, ".s{i} {{ stroke: {on_light} }} .f{i} {{ fill: {on_light} }}");
        let _ = writeln!(dark, ".s{i} {{ stroke: {on_dark} }} .f{i} {{ fill: {on_dark} }}");
    }
    for (i, (on_light, on_dark)) in TINTS.iter().enumerate() {
        let _ = writeln!(light, ".t{i} {{ fill: {on_light} }}");
        let _ = writeln!(dark, ".t{i} {{ fill: {on_dark} }}");
    }
    format!("{light}@media (prefers-color-scheme: dark) {{\n{dark}}}\n")
}

/// The legend below the titles, and its height.
fn legend(keys: &[Key]) -> (String, f64) {
    let mut drawn = String::new();
    let (mut x, mut y) = (16.0, HEAD + 8.0);
    for key in keys {
        let width = 34.0 + LETTER * key.label.chars().count() as f64 + 16.0;
        if x + width > WIDTH - RIGHT && x > 16.0 {
            (x, y) = (16.0, y + LEGEND_ROW);
        }
        match key.look {
            Look::Band(tint) => {
                let _ = writeln!(
                    drawn,
                    "<rect class=\"t{}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"26\" height=\"12\"/><rect class=\"frame\" \
                     x=\"{x:.1}\" y=\"{:.1}\" width=\"26\" height=\"12\"/>",
                    tint % TINTS.len(),
                    y - 6.0,
                    y - 6.0
                );
            }
            Look::Series(colour, mark) => {
                let ends: &[[f64; 2]] = match mark {
                    Mark::Dots | Mark::Rings => &[[13.0, 0.0]],
                    _ => &[[0.0, 0.0], [26.0, 0.0]],
                };
                let places: Vec<[f64; 2]> = ends.iter().map(|[dx, dy]| [x + dx, y + dy]).collect();
                draw_marks(&mut drawn, &places, colour, mark);
            }
        }
        text(&mut drawn, x + 34.0, y + 4.0, "soft", &key.label);
        x += width;
    }
    let height = if keys.is_empty() { 0.0 } else { y - HEAD + LEGEND_ROW - 4.0 };
    (drawn, height)
}

fn draw_panel(svg: &mut String, panel: &Panel, left: f64, above: f64, width: f64) {
    let (right, below) = (left + width, above + PLOT_HEIGHT);
    let points = || panel.series.iter().flat_map(|series| &series.points).filter(|p| is_finite(p));
    let ends = panel.bands.iter().flat_map(|band| [band.from, band.to]);
    // bands fill the axis; single points are not cut in two by its frame
    let margin = if panel.bands.is_empty() { X_MARGIN } else { 0.0 };
    let x = Scale::over(extent(points().map(|p| p[0]).chain(ends)), margin, left, right);
    let zero = panel.with_zero.then_some(0.0);
    let y = Scale::over(extent(points().map(|p| p[1]).chain(zero)), MARGIN, below, above);

    for band in &panel.bands {
        draw_band(svg, band, &x, above);
    }
    draw_axes(svg, panel, &x, &y);
    if let Some(guide) = panel.guide.filter(|guide| y.from < *guide && *guide < y.to) {
        let at = y.at(guide);
        let _ = writeln!(svg, "<path class=\"guide\" d=\"M{left:.1} {at:.1}H{right:.1}\"/>");
    }
    text(svg, left, above - 9.0, "name", &panel.title);
    // axes are wide enough for all points: nothing needs to be cut off
    for Series { colour, mark, points } in &panel.series {
        for stretch in points.split(|point| !is_finite(point)).filter(|stretch| !stretch.is_empty()) {
            let places: Vec<[f64; 2]> = stretch.iter().map(|p| [x.at(p[0]), y.at(p[1])]).collect();
            draw_marks(svg, &places, *colour, *mark);
        }
    }
    if points().next().is_none() {
        text(svg, left + 12.0, above + 24.0, "soft", "no data");
    }
}

fn draw_band(svg: &mut String, band: &Band, x: &Scale, above: f64) {
    let (from, to) = (x.at(band.from), x.at(band.to));
    let _ = writeln!(
        svg,
        "<rect class=\"t{}\" x=\"{from:.1}\" y=\"{above:.1}\" width=\"{:.1}\" height=\"{PLOT_HEIGHT}\"/>",
        band.tint % TINTS.len(),
        to - from
    );
}

fn draw_axes(svg: &mut String, panel: &Panel, x: &Scale, y: &Scale) {
    let (left, right, below, above) = (x.start, x.end, y.start, y.end);
    for tick in y.ticks(5) {
        let at = y.at(tick.value);
        let class = if tick.value == 0.0 { "zero" } else { "grid" };
        let _ = writeln!(
            svg,
            "<path class=\"{class}\" d=\"M{left:.1} {at:.1}H{right:.1}\"/><text class=\"tick\" x=\"{:.1}\" \
             y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            left - 6.0,
            at + 4.0,
            tick.label
        );
    }
    for tick in x.ticks(8) {
        let at = x.at(tick.value);
        let _ = writeln!(
            svg,
            "<path class=\"grid\" d=\"M{at:.1} {above:.1}V{below:.1}\"/><text class=\"tick\" x=\"{at:.1}\" \
             y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            below + 16.0,
            tick.label
        );
    }
    let _ = writeln!(
        svg,
        "<rect class=\"frame\" x=\"{left:.1}\" y=\"{above:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
        right - left,
        below - above
    );
    let middle = (below + above) / 2.0;
    let _ = writeln!(
        svg,
        "<text class=\"tick\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
         <text class=\"tick\" transform=\"translate({:.1} {middle:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        (left + right) / 2.0,
        below + 33.0,
        escaped(&panel.x_label),
        left - 50.0,
        escaped(&panel.y_label),
    );
}

/// Draws a stretch of a series, whose places are finite.
fn draw_marks(svg: &mut String, places: &[[f64; 2]], colour: usize, mark: Mark) {
    let colour = colour % COLOURS.len();
    let class = match mark {
        Mark::Line | Mark::LineWithDots => "line",
        Mark::Dashed => "dashed",
        Mark::Thin => "thin",
        Mark::Pale => "pale",
        Mark::Broad => "broad",
        Mark::Dots | Mark::Rings => "",
    };
    if !class.is_empty() && places.len() > 1 {
        let _ = write!(svg, "<path class=\"{class} s{colour}\" d=\"");
        for (i, [x, y]) in places.iter().enumerate() {
            let _ = write!(svg, "{}{x:.1} {y:.1}", if i == 0 { "M" } else { "L" });
        }
        svg.push_str("\"/>\n");
    }
    // a dashed line of one point would not be seen
    let dots = matches!(mark, Mark::Dots | Mark::LineWithDots) || (places.len() == 1 && mark == Mark::Dashed);
    if dots || mark == Mark::Rings {
        let (class, radius) = if dots { ("f", 2.2) } else { ("ring s", 3.0) };
        let _ = write!(svg, "<g class=\"{class}{colour}\">");
        for [x, y] in places {
            let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\"/>");
        }
        svg.push_str("</g>\n");
    }
}

fn text(svg: &mut String, x: f64, y: f64, class: &str, words: &str) {
    let _ = writeln!(svg, "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\">{}</text>", escaped(words));
}

/// Makes a line of text that would leave the page as narrow as the page is.
fn squeezed(words: &str) -> String {
    let room = WIDTH - 32.0;
    if LETTER * words.chars().count() as f64 <= room {
        return String::new();
    }
    format!(" textLength=\"{room}\" lengthAdjust=\"spacingAndGlyphs\"")
}

fn is_finite(point: &[f64; 2]) -> bool {
    point.iter().all(|value| value.is_finite())
}

/// Text as XML holds it; what XML 1.0 has no place for is left out.
fn escaped(words: &str) -> String {
    let mut safe = String::with_capacity(words.len());
    for c in words.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            c if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') => {}
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figure(points: Vec<[f64; 2]>, mark: Mark) -> Figure {
        let panel = Panel {
            title: "joint 1".into(),
            x_label: "time, s".into(),
            y_label: "torque, Nm".into(),
            bands: vec![Band { from: 0.0, to: 5.0, tint: 1 }],
            series: vec![Series { colour: 1, mark, points }],
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

    /// Tags that are opened are closed, and nothing else stands in between.
    fn assert_well_formed(svg: &str) {
        let mut open: Vec<&str> = Vec::new();
        for tag in svg.split('<').skip(1) {
            let (tag, _) = tag.split_once('>').expect("an end of the tag");
            if let Some(name) = tag.strip_prefix('/') {
                assert_eq!(open.pop(), Some(name), "{svg}");
            } else if !tag.ends_with('/') {
                open.push(tag.split_whitespace().next().expect("a name"));
            }
        }
        assert_eq!(open, [""; 0]);
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
        assert_eq!(page.matches("@media (prefers-color-scheme: dark)").count(), 2);
    }
}
