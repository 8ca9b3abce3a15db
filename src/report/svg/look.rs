//! Colours of a picture and their legend.

use std::fmt::Write;

use super::panel::event_mark;
use super::picture_text::text;
use super::series::draw_marks;
use super::sizes::{DOT, LETTER, RIGHT, WIDTH, colours};
use crate::report::figure::{COLOURS, Key, Look, Mark, RAMP, TINTS};

/// Height of a row of the legend, px.
const LEGEND_ROW: f64 = 22.0;

/// Colours for light pages, and their replacements in a dark setting. Print is light.
pub(in crate::report) fn style() -> String {
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
pub(super) fn legend(keys: &[Key], y: f64) -> (String, f64) {
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

/// Symbol of an entry of the legend, 26 px wide, centred at the height 0.
pub(in crate::report) fn swatch(look: Look) -> String {
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
