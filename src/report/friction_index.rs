//! The friction index over the runs of a robot, with its interval and friction as measured: a panel a joint.

use super::figure::{ESTIMATED, Figure, Key, Look, MEASURED, Mark, Panel, Series};

/// Friction of one run against the baseline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexPoint {
    /// Start of the run, days since the first one.
    pub day: f64,
    /// The index, 1 = unchanged.
    pub index: f64,
    /// Ends of its interval.
    pub interval: [f64; 2],
    /// Friction as measured against the baseline, where known.
    pub raw: Option<f64>,
}

/// Draws a panel a joint; each entry is the joint's title and its runs, oldest first.
#[must_use]
pub fn index_figure(joints: &[(String, Vec<IndexPoint>)], title: String, subtitle: String) -> Figure {
    let panel = |(title, runs): &(String, Vec<IndexPoint>)| {
        let along = |of: &dyn Fn(&IndexPoint) -> Option<f64>| -> Vec<[f64; 2]> {
            runs.iter().filter_map(|run| Some([run.day, of(run)?])).collect()
        };
        let series = |colour, mark, points| Series { colour, mark, points };
        Panel {
            title: title.clone(),
            x_label: "days since the first run".into(),
            y_label: "friction against the baseline".into(),
            with_zero: false,
            guide: Some(1.0),
            series: vec![
                series(MEASURED, Mark::Rings, along(&|run| run.raw)),
                series(ESTIMATED, Mark::Thin, along(&|run| Some(run.interval[0]))),
                series(ESTIMATED, Mark::Thin, along(&|run| Some(run.interval[1]))),
                series(ESTIMATED, Mark::LineWithDots, along(&|run| Some(run.index))),
            ],
            ..Panel::default()
        }
    };
    let key = |label: &str, colour, mark| Key { label: label.into(), look: Look::Series(colour, mark) };
    let legend = vec![
        key("friction index", ESTIMATED, Mark::LineWithDots),
        key("its 95 % interval", ESTIMATED, Mark::Thin),
        key("friction as measured", MEASURED, Mark::Rings),
    ];
    Figure { title, subtitle, legend, panels: joints.iter().map(panel).collect(), columns: 2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_without_measured_friction_still_has_its_index() {
        let run = |day: f64, raw| IndexPoint { day, index: 1.01, interval: [0.99, 1.03], raw };
        let runs = vec![run(0.0, Some(1.2)), run(1.0, None), run(2.5, Some(0.9))];
        let figure = index_figure(&[("joint 3".into(), runs)], "R01".into(), String::new());
        let lengths: Vec<usize> = figure.panels[0].series.iter().map(|series| series.points.len()).collect();
        assert_eq!(lengths, [2, 3, 3, 3]);
        assert!(figure.svg().contains("joint 3"));
    }
}
