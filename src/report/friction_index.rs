//! The friction index over the runs of a robot, with its interval, its limits and the raw index: one panel per joint,
//! all with the same scale.

use super::figure::{
    Area, Band, ESTIMATED, Figure, FigureEvent, FigureEventKind, FigureLevel, Key, Limit, Look, MEASURED,
    Mark, Panel, Series, StatusWord, XAxis, extent,
};
use super::rmsd::event_keys;

/// Tint of the period with an alarm.
const SEEN: usize = 2;

/// Friction of one run relative to the baseline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexPoint {
    /// Start of the run as a [`day`](super::figure::day).
    pub day: f64,
    /// The index, 1 = unchanged.
    pub index: f64,
    /// Ends of its interval.
    pub interval: [f64; 2],
    /// The raw index, if known.
    pub raw: Option<f64>,
}

/// Data of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct IndexPanel {
    /// Its name.
    pub title: String,
    /// Its status.
    pub standing: Option<StatusWord>,
    /// Its runs, oldest first.
    pub runs: Vec<IndexPoint>,
    /// Its events.
    pub events: Vec<FigureEvent>,
    /// Days between which an alarm was seen.
    pub alarms: Vec<[f64; 2]>,
}

/// Change of friction that needs attention, as fractions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IndexLimits {
    /// An inspection should be planned.
    pub warning: f64,
    /// An inspection is needed before the next shift.
    pub critical: f64,
}

/// Draws one panel per joint.
pub fn index_figure(joints: &[IndexPanel], limits: IndexLimits, title: String, subtitle: String) -> Figure {
    let runs = || joints.iter().flat_map(|joint| &joint.runs);
    let values =
        runs().flat_map(|run| [run.index, run.interval[0], run.interval[1], run.raw.unwrap_or(run.index)]);
    // both limits are visible even if no value is near them
    let marked = [1.0 - limits.warning, 1.0 + limits.critical];
    let range = extent(values.chain(marked)).map(|(low, high)| [low, high]);
    let panels = joints.iter().map(|joint| panel(joint, limits, range)).collect();
    let key = |label: String, look| Key { label, look };
    let percent = |word: &str, sign: &str, fraction: f64| format!("{word} from {sign}{} %", 100.0 * fraction);
    let mut legend = vec![
        key("friction index".into(), Look::Series(ESTIMATED, Mark::LineWithDots)),
        key("its 95 % interval".into(), Look::Area(ESTIMATED)),
    ];
    if runs().any(|run| run.raw.is_some()) {
        legend.push(key("friction as measured".into(), Look::Series(MEASURED, Mark::Rings)));
    }
    legend.extend([
        key("baseline".into(), Look::Limit(FigureLevel::Usual)),
        key(percent("warning", "+", limits.warning), Look::Limit(FigureLevel::Warning)),
        key(percent("critical", "\u{b1}", limits.critical), Look::Limit(FigureLevel::Critical)),
    ]);
    if joints.iter().any(|joint| !joint.alarms.is_empty()) {
        legend.push(key("an alarm was seen".into(), Look::Band(SEEN)));
    }
    let events: Vec<_> =
        joints.iter().flat_map(|joint| &joint.events).map(|event| (None, event.clone())).collect();
    legend.extend(event_keys(&events));
    Figure { title, subtitle, legend, panels, columns: 2 }
}

fn panel(joint: &IndexPanel, limits: IndexLimits, y_range: Option<[f64; 2]>) -> Panel {
    // an index before a repair has another baseline than one after it
    let repairs: Vec<f64> =
        joint.events.iter().filter(|of| of.kind == FigureEventKind::Repair).map(|of| of.at).collect();
    let stretches =
        || joint.runs.chunk_by(|a, b| !repairs.iter().any(|repair| a.day < *repair && *repair <= b.day));
    let interval = |run: &IndexPoint| [run.day, run.interval[0], run.interval[1]];
    let intervals = stretches().map(|runs| runs.iter().map(interval).collect::<Vec<_>>());
    let indices = stretches().map(|runs| runs.iter().map(|run| [run.day, run.index]).collect::<Vec<_>>());
    let series = |name: &str, colour, mark, points| Series { name: name.into(), colour, mark, points };
    let limit = |value, level| Limit { value, level };
    Panel {
        title: joint.title.clone(),
        standing: joint.standing.clone(),
        x_label: "start of the run, UTC".into(),
        x_axis: XAxis::Date,
        y_label: "friction index".into(),
        y_range,
        limits: vec![
            limit(1.0, FigureLevel::Usual),
            limit(1.0 + limits.warning, FigureLevel::Warning),
            limit(1.0 + limits.critical, FigureLevel::Critical),
            limit(1.0 - limits.critical, FigureLevel::Critical),
        ],
        bands: joint.alarms.iter().map(|[from, to]| Band { from: *from, to: *to, tint: SEEN }).collect(),
        areas: vec![Area { colour: ESTIMATED, points: intervals.collect::<Vec<_>>().join(&[f64::NAN; 3]) }],
        series: vec![
            series(
                "friction as measured",
                MEASURED,
                Mark::Rings,
                joint.runs.iter().filter_map(|run| Some([run.day, run.raw?])).collect(),
            ),
            series(
                "friction index",
                ESTIMATED,
                Mark::LineWithDots,
                indices.collect::<Vec<_>>().join(&[f64::NAN; 2]),
            ),
        ],
        events: joint.events.clone(),
        ..Panel::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: IndexLimits = IndexLimits { warning: 0.05, critical: 0.15 };

    fn joint(title: &str, runs: &[(f64, f64, Option<f64>)]) -> IndexPanel {
        let run = |&(day, index, raw): &(f64, f64, Option<f64>)| IndexPoint {
            day,
            index,
            interval: [index - 0.02, index + 0.02],
            raw,
        };
        IndexPanel {
            title: title.into(),
            standing: Some(StatusWord::new("critical", FigureLevel::Critical)),
            runs: runs.iter().map(run).collect(),
            events: Vec::new(),
            alarms: Vec::new(),
        }
    }

    #[test]
    fn a_run_without_measured_friction_still_has_its_index() {
        let runs = [(20_000.0, 1.01, Some(1.2)), (20_001.0, 1.01, None), (20_002.5, 1.01, Some(0.9))];
        let figure = index_figure(&[joint("joint 3", &runs)], LIMITS, "R01".into(), String::new());
        let lengths: Vec<usize> = figure.panels[0].series.iter().map(|series| series.points.len()).collect();
        assert_eq!((lengths, figure.panels[0].areas[0].points.len()), (vec![2, 3], 3));
        assert!(figure.svg().contains("joint 3<tspan class=\"critical\">"));
    }

    #[test]
    fn joints_share_a_scale_that_shows_both_limits() {
        let mut worn = joint("joint 3", &[(20_000.0, 1.0, None), (20_001.0, 1.3, None)]);
        worn.alarms.push([20_000.5, 20_001.0]);
        worn.events.push(FigureEvent { at: 20_000.5, kind: FigureEventKind::Alarm, label: "drift".into() });
        let quiet = joint("joint 1", &[(20_000.0, 1.0, None), (20_001.0, 1.001, None)]);
        let figure = index_figure(&[quiet.clone(), worn], LIMITS, "R01".into(), String::new());
        let ranges: Vec<_> = figure.panels.iter().map(|panel| panel.y_range).collect();
        assert_eq!(ranges, [Some([0.95, 1.32]); 2]);
        let labels: Vec<&str> = figure.legend.iter().map(|key| key.label.as_str()).collect();
        let expected = [
            "friction index",
            "its 95 % interval",
            "baseline",
            "warning from +5 %",
            "critical from \u{b1}15 %",
        ];
        assert_eq!(labels[..5], expected);
        assert_eq!(labels[5..], ["an alarm was seen", "an alarm began"]);
        let alone = index_figure(&[quiet], LIMITS, "R01".into(), String::new());
        assert_eq!(alone.panels[0].y_range, Some([0.95, 1.15]));
        assert_eq!(alone.legend.len(), 5);
    }

    #[test]
    fn the_line_breaks_where_work_began_a_new_baseline() {
        let mut repaired =
            joint("joint 3", &[(20_000.0, 1.3, None), (20_001.0, 1.0, None), (20_002.0, 1.0, None)]);
        repaired.events.push(FigureEvent {
            at: 20_001.0,
            kind: FigureEventKind::Repair,
            label: "gearbox".into(),
        });
        let figure = index_figure(&[repaired], LIMITS, "R01".into(), String::new());
        let points = &figure.panels[0].series[1].points;
        assert_eq!((points.len(), points[1][0].is_nan(), points[2]), (4, true, [20_001.0, 1.0]));
        assert!(figure.panels[0].areas[0].points[1][0].is_nan());
    }
}
