//! RMSD of a run by cycle: a panel a joint.

use super::figure::{Figure, Key, Look, Mark, Panel, Series};
use crate::analysis::{Rmsd, RmsdScope, TorqueRmsd, WarmingContrast};
use crate::robot::JointIndex;
use crate::run::Stage;

/// Relative RMSD that the thesis marks.
const MARKED_ABOVE: f64 = 0.10;

/// What the RMSD of a run is shown for, with colours and marks.
const LINES: [(&str, RmsdScope, usize); 4] = [
    ("excitation", RmsdScope::Stage(Stage::Excitation), 0),
    ("friction", RmsdScope::Stage(Stage::Friction), 3),
    ("warming", RmsdScope::Stage(Stage::Warming), 1),
    ("whole cycle", RmsdScope::WholeCycle, 2),
];
const START: usize = 4;
const END: usize = 5;

/// What is known of one cycle of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleVerification {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// RMSD by joint and stage; empty without parameters.
    pub rmsd: Vec<TorqueRmsd>,
    /// Start against end of the warming stage, by joint.
    pub contrast: Vec<WarmingContrast>,
    /// Why there are no parameters, where there are none.
    pub reason: Option<String>,
}

/// Draws the relative RMSD of the moving rows over the cycles, in per cent.
#[must_use]
pub fn rmsd_figure(cycles: &[CycleVerification], title: String, subtitle: String) -> Figure {
    let joints = cycles.iter().flat_map(|of| &of.rmsd).map(|rmsd| rmsd.joint.number()).max().unwrap_or(0);
    let panels = (0..joints).map(JointIndex::new).map(|joint| panel(cycles, joint)).collect();
    let key = |label: &str, colour, mark| Key { label: label.into(), look: Look::Series(colour, mark) };
    let mut legend: Vec<Key> =
        LINES.iter().map(|(name, _, colour)| key(name, *colour, Mark::LineWithDots)).collect();
    legend.push(key("first third of warming", START, Mark::Dashed));
    legend.push(key("last third of warming", END, Mark::Dashed));
    Figure { title, subtitle, legend, panels, columns: 2 }
}

fn panel(cycles: &[CycleVerification], joint: JointIndex) -> Panel {
    let line = |colour, mark, value: &dyn Fn(&CycleVerification) -> Option<Rmsd>| {
        let point = |of: &CycleVerification| {
            let known = value(of).filter(|rmsd| rmsd.samples > 0);
            // a cycle without figures is a break in the line
            [f64::from(of.cycle), known.map_or(f64::NAN, |rmsd| 100.0 * rmsd.relative)]
        };
        Series { colour, mark, points: cycles.iter().map(point).collect() }
    };
    let contrast = |of: &CycleVerification| of.contrast.iter().find(|found| found.joint == joint).copied();
    let mut series = vec![
        line(START, Mark::Dashed, &|of| contrast(of).map(|found| found.start.moving_rows)),
        line(END, Mark::Dashed, &|of| contrast(of).map(|found| found.end.moving_rows)),
    ];
    for (_, scope, colour) in LINES {
        series.push(line(colour, Mark::LineWithDots, &|of| {
            let found = of.rmsd.iter().find(|rmsd| rmsd.joint == joint && rmsd.scope == scope);
            found.map(|rmsd| rmsd.moving_rows)
        }));
    }
    Panel {
        title: format!("joint {joint}{}", marked(cycles, joint)),
        x_label: "cycle".into(),
        y_label: "relative RMSD, %".into(),
        with_zero: true,
        guide: Some(100.0 * MARKED_ABOVE),
        bands: Vec::new(),
        series,
    }
}

/// How many cycles are beyond the mark in the excitation stage, which limits and detectors look at.
fn marked(cycles: &[CycleVerification], joint: JointIndex) -> String {
    let excitation = RmsdScope::Stage(Stage::Excitation);
    let beyond = |of: &&CycleVerification| {
        let of_joint = of.rmsd.iter().filter(|rmsd| rmsd.joint == joint && rmsd.scope == excitation);
        of_joint.map(|rmsd| rmsd.moving_rows.relative).any(|relative| relative > MARKED_ABOVE)
    };
    match cycles.iter().filter(beyond).count() {
        0 => String::new(),
        count => format!(": above {:.0} % in the excitation of {count} cycles", 100.0 * MARKED_ABOVE),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::RmsdPair;

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
        let figure = rmsd_figure(&[cycle(1, 0.05), refused, cycle(3, 0.12)], "run".into(), String::new());
        let panel = &figure.panels[0];
        assert_eq!((figure.panels.len(), panel.series.len(), figure.legend.len()), (1, 6, 6));
        assert!(panel.title.contains("of 1 cycles"), "{}", panel.title);
        let excitation = &panel.series[2].points;
        assert!((excitation[0][1] - 5.0).abs() < 1e-9 && excitation[1][1].is_nan());
        // no moving rows at the end of warming: nothing is drawn there
        assert!(panel.series[1].points.iter().all(|point| point[1].is_nan()));
        assert!(rmsd_figure(&[], "run".into(), String::new()).panels.is_empty());
    }
}
