//! RMSD of a run by cycle: one panel per joint.

use std::collections::BTreeSet;

use super::figure::{
    ESTIMATED, Figure, FigureEvent, FigureEventKind, FigureLevel, Key, Limit, Look, Mark, Panel, Series,
    XAxis, YAxis, extent,
};
use armwatch_model::analysis::{Rmsd, RmsdScope, TorqueRmsd, WarmingContrast};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::Stage;

/// Relative RMSD that needs attention, as fractions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RmsdLimits {
    /// An inspection should be planned.
    pub warning: f64,
    /// An inspection is needed before the next shift.
    pub critical: f64,
}

/// The scopes of the drawn RMSD, with labels and colours.
const LINES: [(&str, RmsdScope, usize); 4] = [
    ("excitation", RmsdScope::Stage(Stage::Excitation), 0),
    ("friction", RmsdScope::Stage(Stage::Friction), 3),
    ("warming", RmsdScope::Stage(Stage::Warming), 1),
    ("whole cycle", RmsdScope::WholeCycle, 2),
];
const START: usize = 4;
const END: usize = 5;

/// Data of one cycle of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleVerification {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// RMSD by joint and stage; empty without parameters.
    pub rmsd: Vec<TorqueRmsd>,
    /// Comparison of the start and end of the warming stage, by joint.
    pub contrast: Vec<WarmingContrast>,
    /// Why there are no parameters, if so.
    pub reason: Option<String>,
}

/// Draws the relative RMSD of the moving rows over the cycles, in per cent, on a logarithmic axis: a cold first cycle
/// may have ten times the RMSD of the others. All joints have the same scale.
pub fn rmsd_figure(
    cycles: &[CycleVerification],
    limits: RmsdLimits,
    title: String,
    subtitle: String,
) -> Figure {
    let joints: BTreeSet<JointIndex> = cycles.iter().flat_map(|of| &of.rmsd).map(|rmsd| rmsd.joint).collect();
    let mut panels: Vec<Panel> = joints.into_iter().map(|joint| panel(cycles, joint, limits)).collect();
    let points =
        panels.iter().flat_map(|panel| &panel.series).flat_map(|of| &of.points).map(|point| point[1]);
    let marked = [100.0 * limits.warning, 100.0 * limits.critical];
    let range = extent(points.filter(|value| *value > 0.0).chain(marked)).map(|(low, high)| [low, high]);
    panels.iter_mut().for_each(|panel| panel.y_range = range);
    let key = |label: &str, colour, mark| Key { label: label.into(), look: Look::Series(colour, mark) };
    let mut legend: Vec<Key> =
        LINES.iter().map(|(name, _, colour)| key(name, *colour, Mark::LineWithDots)).collect();
    legend.push(key("first third of warming", START, Mark::Dashed));
    legend.push(key("last third of warming", END, Mark::Dashed));
    legend.extend(limit_keys(limits));
    Figure { title, subtitle, legend, panels, columns: 2 }
}

/// Entries of the legend for the limits.
fn limit_keys(limits: RmsdLimits) -> [Key; 2] {
    let key = |word: &str, value: f64, level| Key {
        label: format!("{word} from {} %", 100.0 * value),
        look: Look::Limit(level),
    };
    [
        key("warning", limits.warning, FigureLevel::Warning),
        key("critical", limits.critical, FigureLevel::Critical),
    ]
}

/// The limits as lines of a panel in per cent.
fn limit_lines(limits: RmsdLimits) -> Vec<Limit> {
    vec![
        Limit { value: 100.0 * limits.warning, level: FigureLevel::Warning },
        Limit { value: 100.0 * limits.critical, level: FigureLevel::Critical },
    ]
}

fn panel(cycles: &[CycleVerification], joint: JointIndex, limits: RmsdLimits) -> Panel {
    let line = |name: &str, colour, mark, value: &dyn Fn(&CycleVerification) -> Option<Rmsd>| {
        let point = |of: &CycleVerification| {
            let known = value(of).filter(|rmsd| rmsd.samples > 0);
            // a cycle without values breaks the line
            [f64::from(of.cycle), known.map_or(f64::NAN, |rmsd| 100.0 * rmsd.relative)]
        };
        Series { name: name.into(), colour, mark, points: cycles.iter().map(point).collect() }
    };
    let contrast = |of: &CycleVerification| of.contrast.iter().find(|found| found.joint == joint).copied();
    let mut series = vec![
        line("first third of warming", START, Mark::Dashed, &|of| {
            contrast(of).map(|found| found.start.moving_rows)
        }),
        line("last third of warming", END, Mark::Dashed, &|of| {
            contrast(of).map(|found| found.end.moving_rows)
        }),
    ];
    for (name, scope, colour) in LINES {
        series.push(line(name, colour, Mark::LineWithDots, &|of| {
            let found = of.rmsd.iter().find(|rmsd| rmsd.joint == joint && rmsd.scope == scope);
            found.map(|rmsd| rmsd.moving_rows)
        }));
    }
    Panel {
        title: format!("joint {joint}{}", marked(cycles, joint, limits)),
        x_label: "cycle".into(),
        x_axis: XAxis::Count,
        y_label: "relative RMSD, %".into(),
        y_axis: YAxis::Logarithmic,
        limits: limit_lines(limits),
        series,
        ..Panel::default()
    }
}

/// Number of cycles beyond the first limit in the excitation stage, which the limits and detectors refer to.
fn marked(cycles: &[CycleVerification], joint: JointIndex, limits: RmsdLimits) -> String {
    let excitation = RmsdScope::Stage(Stage::Excitation);
    let beyond = |of: &&CycleVerification| {
        let of_joint = of.rmsd.iter().filter(|rmsd| rmsd.joint == joint && rmsd.scope == excitation);
        of_joint.map(|rmsd| rmsd.moving_rows.relative).any(|relative| relative > limits.warning)
    };
    match cycles.iter().filter(beyond).count() {
        0 => String::new(),
        count => format!(
            ": above {:.0} % in the excitation of {count} cycle{}",
            100.0 * limits.warning,
            if count == 1 { "" } else { "s" }
        ),
    }
}

/// The median RMSD of a run's excitation stages.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunRmsd {
    /// Start of the run as a [`day`](super::figure::day).
    pub day: f64,
    /// The joint.
    pub joint: JointIndex,
    /// Moving relative RMSD, a fraction; NaN if the run has none.
    pub relative: f64,
}

/// Draws the relative RMSD of the excitation stages over the runs of a robot: one panel per joint, all with the same
/// scale.
pub fn run_rmsd_figure(
    runs: &[RunRmsd],
    limits: RmsdLimits,
    events: &[(Option<JointIndex>, FigureEvent)],
    title: String,
    subtitle: String,
) -> Figure {
    let joints: BTreeSet<JointIndex> = runs.iter().map(|run| run.joint).collect();
    let highest = runs.iter().map(|run| run.relative).chain([limits.critical]).fold(0.0, f64::max);
    let panel = |joint: JointIndex| Panel {
        title: format!("joint {joint}"),
        x_label: "start of the run, UTC".into(),
        x_axis: XAxis::Date,
        y_label: "relative RMSD, %".into(),
        y_range: Some([0.0, 100.0 * highest]),
        limits: limit_lines(limits),
        series: vec![Series {
            name: format!("joint {joint}"),
            colour: ESTIMATED,
            mark: Mark::LineWithDots,
            points: (runs.iter().filter(|run| run.joint == joint))
                .map(|run| [run.day, 100.0 * run.relative])
                .collect(),
        }],
        events: events_of(events, joint),
        ..Panel::default()
    };
    let median = "median over the cycles of a run";
    let mut legend = vec![Key { label: median.into(), look: Look::Series(ESTIMATED, Mark::LineWithDots) }];
    legend.extend(limit_keys(limits));
    legend.extend(event_keys(events));
    Figure { title, subtitle, legend, panels: joints.into_iter().map(panel).collect(), columns: 2 }
}

/// Events of a joint and of the whole arm.
pub(super) fn events_of(events: &[(Option<JointIndex>, FigureEvent)], joint: JointIndex) -> Vec<FigureEvent> {
    let of_joint = events.iter().filter(|(of, _)| of.is_none_or(|of| of == joint));
    of_joint.map(|(_, event)| event.clone()).collect()
}

/// Entries of the legend for the kinds of events that occur.
pub(super) fn event_keys(events: &[(Option<JointIndex>, FigureEvent)]) -> Vec<Key> {
    let kinds = [(FigureEventKind::Alarm, "an alarm began"), (FigureEventKind::Repair, "maintenance")];
    kinds
        .into_iter()
        .filter(|(kind, _)| events.iter().any(|(_, event)| event.kind == *kind))
        .map(|(kind, label)| Key { label: label.into(), look: Look::Event(kind) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::RmsdPair;

    const LIMITS: RmsdLimits = RmsdLimits { warning: 0.10, critical: 0.15 };

    fn cycle(number: u32, relative: f64) -> CycleVerification {
        let rmsd = Rmsd { value: 10.0 * relative, relative, samples: 100 };
        let of_scope = |(_, scope, _): &(&str, RmsdScope, usize)| TorqueRmsd {
            joint: JointIndex::new(0),
            scope: *scope,
            all_rows: rmsd,
            moving_rows: rmsd,
        };
        let pair = RmsdPair { all_rows: rmsd, moving_rows: rmsd };
        let contrast = WarmingContrast { joint: JointIndex::new(0), start: pair, end: RmsdPair::default() };
        CycleVerification {
            cycle: number,
            rmsd: LINES.iter().map(of_scope).collect(),
            contrast: vec![contrast],
            reason: None,
        }
    }

    #[test]
    fn cycles_without_parameters_break_the_lines_and_large_figures_are_counted() {
        let refused = CycleVerification {
            rmsd: Vec::new(),
            contrast: Vec::new(),
            reason: Some("poor".into()),
            ..cycle(2, 0.0)
        };
        let figure =
            rmsd_figure(&[cycle(1, 0.05), refused, cycle(3, 0.12)], LIMITS, "run".into(), String::new());
        let panel = &figure.panels[0];
        assert_eq!((figure.panels.len(), panel.series.len(), figure.legend.len()), (1, 6, 8));
        assert!(panel.title.contains("of 1 cycle"), "{}", panel.title);
        let excitation = &panel.series[2].points;
        assert!((excitation[0][1] - 5.0).abs() < 1e-9 && excitation[1][1].is_nan());
        // no moving rows at the end of warming: nothing is drawn there
        assert!(panel.series[1].points.iter().all(|point| point[1].is_nan()));
        assert_eq!(figure.legend[6].label, "warning from 10 %");
        assert_eq!(panel.y_range.map(|[low, _]| low), Some(5.0));
        assert!(rmsd_figure(&[], LIMITS, "run".into(), String::new()).panels.is_empty());
    }

    #[test]
    fn one_joint_alone_has_one_panel() {
        let mut one = cycle(1, 0.05);
        one.rmsd.iter_mut().for_each(|rmsd| rmsd.joint = JointIndex::new(3));
        let figure = rmsd_figure(&[one], LIMITS, "run".into(), String::new());
        assert_eq!((figure.panels.len(), figure.panels[0].title.as_str()), (1, "joint 4"));
    }

    #[test]
    fn runs_of_all_joints_share_a_scale_and_the_marks_of_the_arm() {
        let run = |day, joint, relative| RunRmsd { day, joint: JointIndex::new(joint), relative };
        let runs = [run(0.0, 0, 0.02), run(0.0, 1, 0.3), run(1.0, 0, f64::NAN), run(1.0, 1, 0.2)];
        let event = |kind| FigureEvent { at: 0.5, kind, label: String::new() };
        let events = [
            (None, event(FigureEventKind::Repair)),
            (Some(JointIndex::new(1)), event(FigureEventKind::Alarm)),
        ];
        let figure = run_rmsd_figure(&runs, LIMITS, &events, "R01".into(), String::new());
        let events: Vec<usize> = figure.panels.iter().map(|panel| panel.events.len()).collect();
        assert_eq!((events, figure.legend.len()), (vec![1, 2], 5));
        assert!(figure.panels.iter().all(|panel| panel.y_range == Some([0.0, 30.0])));
        assert!(!figure.svg().contains("NaN"));
    }
}
