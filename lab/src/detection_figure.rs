//! Probability and delay of detection over the size of the event: two panels per fault.

use armwatch::report::figure::{Area, ESTIMATED, Figure, Key, Look, Mark, Panel, Series};

/// Detection of one fault by size.
#[derive(Debug, Clone, PartialEq)]
pub struct DetectionCurve {
    /// Name of the fault.
    pub fault: String,
    /// Meaning of its size, with its unit.
    pub size: String,
    /// Events of similar size, the smallest first.
    pub points: Vec<DetectionPoint>,
}

/// Events of similar size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectionPoint {
    /// The size.
    pub size: f64,
    /// Share of them with an alarm.
    pub detected: f64,
    /// 95 % interval of that.
    pub detected_95: [f64; 2],
    /// Median delay of the alarms, tests; NaN if there are none.
    pub delay_tests: f64,
}

/// Draws, for each fault, detection in per cent with its interval, and the delay, over size.
pub fn detection_figure(curves: &[DetectionCurve], title: String, subtitle: String) -> Figure {
    let panels = curves.iter().flat_map(|curve| {
        let line = |name: &str, of: &dyn Fn(&DetectionPoint) -> f64| Series {
            name: name.into(),
            colour: ESTIMATED,
            mark: Mark::LineWithDots,
            points: curve.points.iter().map(|point| [point.size, of(point)]).collect(),
        };
        let interval =
            |point: &DetectionPoint| [point.size, 100.0 * point.detected_95[0], 100.0 * point.detected_95[1]];
        let panel = |what: &str, y_label: &str, areas, series| Panel {
            title: format!("{}: {what}", curve.fault),
            x_label: curve.size.clone(),
            y_label: y_label.into(),
            with_zero: true,
            areas,
            series: vec![series],
            ..Panel::default()
        };
        [
            panel(
                "detection",
                "robots with an alarm, %",
                vec![Area { colour: ESTIMATED, points: curve.points.iter().map(interval).collect() }],
                line("robots with an alarm", &|point| 100.0 * point.detected),
            ),
            panel(
                "delay",
                "median delay, tests",
                Vec::new(),
                line("median delay", &|point| point.delay_tests),
            ),
        ]
    });
    let legend = vec![
        Key {
            label: "of the robots, or median delay".into(),
            look: Look::Series(ESTIMATED, Mark::LineWithDots),
        },
        Key { label: "95 % interval".into(), look: Look::Area(ESTIMATED) },
    ];
    Figure { title, subtitle, legend, panels: panels.collect(), columns: 2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_without_detection_breaks_the_line_of_the_delay() {
        let point = |size, detected, delay_tests| DetectionPoint {
            size,
            detected,
            detected_95: [0.0, 1.0],
            delay_tests,
        };
        let curve = DetectionCurve {
            fault: "wear".into(),
            size: "fraction".into(),
            points: vec![point(0.05, 0.0, f64::NAN), point(0.1, 0.5, 9.0), point(0.3, 1.0, 4.0)],
        };
        let figure = detection_figure(&[curve], "title".into(), "subtitle".into());
        assert_eq!(figure.panels.len(), 2);
        let svg = figure.svg();
        assert!(svg.contains("wear: detection") && svg.contains("wear: delay") && !svg.contains("NaN"));
    }
}
