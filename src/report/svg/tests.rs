use crate::report::figure::{
    Area, Band, Figure, FigureEvent, FigureEventKind, FigureLevel, Key, Limit, Look, Mark, Panel, Series,
    StatusWord, Strip, XAxis, YAxis,
};

fn figure(points: Vec<[f64; 2]>, mark: Mark) -> Figure {
    let panel = Panel {
        title: "joint 1".into(),
        x_label: "time, s".into(),
        y_label: "torque, Nm".into(),
        bands: vec![Band { from: 0.0, to: 5.0, tint: 1 }],
        areas: vec![Area { colour: 1, points: points.iter().map(|[x, y]| [*x, y - 1.0, y + 1.0]).collect() }],
        limits: vec![Limit { value: 1.5, level: FigureLevel::Warning }],
        events: vec![FigureEvent { at: 1.0, kind: FigureEventKind::Repair, label: "a <gear> & oil".into() }],
        standing: Some(StatusWord { word: "ok".into(), level: FigureLevel::Usual }),
        strip: Some(Strip {
            y_label: "residual".into(),
            series: vec![Series { name: String::new(), colour: 2, mark: Mark::Thin, points: points.clone() }],
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
            assert!(svg.contains("a &lt;b&gt; &amp; &quot;c&quot;\\u{7}</title>"));
            assert_eq!(svg.contains("no data"), points.is_empty());
        }
    }
}

#[test]
fn a_line_breaks_where_a_point_is_missing() {
    let whole = figure(vec![[0.0, 1.0], [1.0, 1.5], [4.0, 2.0], [5.0, 2.0]], Mark::Line).svg();
    let broken =
        figure(vec![[0.0, 1.0], [1.0, 1.5], [2.0, f64::NAN], [4.0, 2.0], [5.0, 2.0]], Mark::Line).svg();
    assert_eq!(whole.matches("class=\"line s1\"").count() + 1, broken.matches("class=\"line s1\"").count());
}

#[test]
fn it_needs_no_other_file_and_has_dark_colours_too() {
    let page = figure(vec![[0.0, 1.0], [1.0, 3.0]], Mark::Line).html();
    for outside in ["http:", "https:", "@import", "<script", "<link", "<image", "src="] {
        assert_eq!(page.replace("http://www.w3.org/2000/svg", "").matches(outside).count(), 0, "{outside}");
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
